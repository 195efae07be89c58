"""Modes of a command, such as ``fit --plan``: what is typed and does nothing in one is refused."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import click
from click.core import ParameterSource

from pupper_analysis.diagnostics import diagnose
from pupper_analysis.errors import ConfigurationError


def refuse_unused(mode: str, uses: Mapping[str, Collection[str]]) -> None:
    """Refuses what was typed for the running command and is not used in its mode.

    A new option is refused in each mode until it is said that the mode uses it.

    Args:
        mode: The option that chooses it, as ``--plan``.
        uses: {mode: names of the parameters that it uses}.

    Raises:
        ConfigurationError: If there is one.
    """
    context = click.get_current_context()
    for parameter in context.command.params:
        name = str(parameter.name)
        typed = context.get_parameter_source(name) is ParameterSource.COMMANDLINE
        if typed and parameter.expose_value and name not in uses[mode]:
            shown = str(parameter.human_readable_name)
            if isinstance(parameter, click.Option):
                shown = max(parameter.opts, key=len)
            others = tuple(other for other, names in uses.items() if name in names)
            raise ConfigurationError(shown, diagnose("option-unused", mode=mode, others=others))
