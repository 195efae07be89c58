"""Commands that are imported when they are used: each needs modules that the others do not."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Any, NamedTuple

import click


class Place(NamedTuple):
    """Where a command is.

    Attributes:
        module: Its module.
        attribute: Its name there.
        short_help: What it does, in the list of all.
    """

    module: str
    attribute: str
    short_help: str


class LazyGroup(click.Group):
    """A group that knows its commands' names and what they do, and imports one that is asked for.

    Args:
        places: {name: where the command is}.
    """

    def __init__(self, *args: Any, places: Mapping[str, Place], **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.places = places

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        """Returns the names of all commands, as click asks for them."""
        return sorted(self.places)

    def get_command(
        self,
        ctx: click.Context | None,  # noqa: ARG002
        cmd_name: str,
    ) -> click.Command | None:
        """Returns a command; None if there is none of that name."""
        place = self.places.get(cmd_name)
        if place is None:
            return None
        command: click.Command = getattr(import_module(place.module), place.attribute)
        return command

    def format_commands(
        self,
        ctx: click.Context,  # noqa: ARG002
        formatter: click.HelpFormatter,
    ) -> None:
        """Writes the list of all commands, and imports none."""
        with formatter.section("Commands"):
            formatter.write_dl(
                [(name, place.short_help) for name, place in sorted(self.places.items())]
            )
