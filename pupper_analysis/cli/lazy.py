"""Commands of the tools, imported when they are used: each needs modules that the others do not."""

from __future__ import annotations

from importlib import import_module

import click

from pupper_analysis.base.tools import other_tools, own_tools


def list_tools() -> list[str]:
    """Returns the names of all tools, ours and others'."""
    return sorted([*own_tools(), *other_tools()])


class LazyGroup(click.Group):
    """A group of the tools' commands, which imports one that is asked for."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        """Returns the names of all commands, as click asks for them."""
        return list_tools()

    def get_command(
        self,
        ctx: click.Context | None,  # noqa: ARG002
        cmd_name: str,
    ) -> click.Command | None:
        """Returns a command; None if there is none of that name."""
        tool = own_tools().get(cmd_name) or other_tools().get(cmd_name)
        if tool is None:
            return None
        command: click.Command = import_module(f"{tool.package}.command").command
        return command

    def format_commands(
        self,
        ctx: click.Context,  # noqa: ARG002
        formatter: click.HelpFormatter,
    ) -> None:
        """Writes the list of all commands, and imports none."""
        tools = {**own_tools(), **other_tools()}
        with formatter.section("Commands"):
            formatter.write_dl([(name, tools[name].question) for name in sorted(tools)])
