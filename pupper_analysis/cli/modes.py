"""Modes of a command, such as ``fit --plan``: what is typed and does nothing in one is refused."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping

import click
from click.core import ParameterSource

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError


def refuse_unused(mode: str, uses: Mapping[str, Collection[str]]) -> None:
    """Refuses what was typed for the running command and is not used in its mode.

    A new option is refused in each mode until it is said that the mode uses it.

    Args:
        mode: The option that chooses it, as ``--plan``.
        uses: {mode: names of the parameters that it uses}.

    Raises:
        ConfigurationError: If there is one.
    """
    for name, shown in _typed():
        if name not in uses[mode]:
            others = tuple(other for other, names in uses.items() if name in names)
            raise ConfigurationError(shown, diagnose("option-unused", mode=mode, others=others))


def refuse_idle(mode: str, *idle: str) -> None:
    """Refuses what was typed for the running command and does nothing in its mode.

    For modes that use all but a few options.

    Args:
        mode: What chooses it, as ``--dry-run``.
        *idle: Names of the parameters that do nothing then.

    Raises:
        ConfigurationError: If one was typed.
    """
    for name, shown in _typed():
        if name in idle:
            raise ConfigurationError(shown, diagnose("option-unused", mode=mode, others=()))


def refuse_alone(needed: Collection[str], *idle: str) -> None:
    """Refuses what was typed for the running command and does nothing without another option.

    Args:
        needed: The options of which it would need one, as ``--payload``.
        *idle: Names of the parameters that do nothing without it.

    Raises:
        ConfigurationError: If one was typed.
    """
    for name, shown in _typed():
        if name in idle:
            raise ConfigurationError(shown, diagnose("option-alone", needed=tuple(needed)))


def _typed() -> Iterator[tuple[str, str]]:
    """Yields name and longest spelling of what was typed; what a stance's file says was not."""
    context = click.get_current_context()
    for parameter in context.command.params:
        name = str(parameter.name)
        typed = context.get_parameter_source(name) is ParameterSource.COMMANDLINE
        if typed and parameter.expose_value:
            option = isinstance(parameter, click.Option)
            yield name, max(parameter.opts, key=len) if option else parameter.human_readable_name
