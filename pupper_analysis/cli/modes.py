"""Modes of a command, such as ``fit --plan``: refuse options that have no effect in a mode."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping

import click
from click.core import ParameterSource

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError


def refuse_unused(mode: str, uses: Mapping[str, Collection[str]]) -> None:
    """Refuse options that the user typed, and that the selected mode of the command does not use.

    The options are those of the running command; arguments are refused in the same way.

    Args:
        mode: Option that selects the mode, such as ``--plan``.
        uses: {mode: names of the parameters that the mode uses}.

    Raises:
        ConfigurationError: If such an option was typed.
    """
    for name, option in _list_typed_parameters():
        if name not in uses[mode]:
            modes = tuple(used_by for used_by, names in uses.items() if name in names)
            raise ConfigurationError(option, diagnose("option-unused", mode=mode, others=modes))


def refuse_idle(mode: str, *idle: str) -> None:
    """Refuse options that the user typed, and that have no effect in the selected mode.

    The options are those of the running command. This function is for modes that use all options
    except a few; `refuse_unused` is for other modes.

    Args:
        mode: Option or robot that selects the mode, such as ``--dry-run``.
        *idle: Names of the parameters without effect.

    Raises:
        ConfigurationError: If such an option was typed.
    """
    for name, option in _list_typed_parameters():
        if name in idle:
            raise ConfigurationError(option, diagnose("option-unused", mode=mode, others=()))


def refuse_alone(needed: Collection[str], *idle: str) -> None:
    """Refuse typed options that have no effect without another option, which was not typed.

    The options are those of the running command. The caller must call this function only if the
    other option was not typed.

    Args:
        needed: Options that were not typed, any of which would give ``idle`` an effect, such as
            ``--payload``.
        *idle: Names of the parameters without effect, such as ``payload_at``.

    Raises:
        ConfigurationError: If a parameter in ``idle`` was typed.
    """
    for name, option in _list_typed_parameters():
        if name in idle:
            raise ConfigurationError(option, diagnose("option-alone", needed=tuple(needed)))


def _list_typed_parameters() -> Iterator[tuple[str, str]]:
    """Yield (name, spelling) of the options and arguments on the typed command line.

    The spelling of an option is the longest, for example ("payload", "--payload").
    """
    context = click.get_current_context()
    for parameter in context.command.params:
        name = str(parameter.name)
        typed = context.get_parameter_source(name) is ParameterSource.COMMANDLINE
        if typed and parameter.expose_value:
            is_option = isinstance(parameter, click.Option)
            yield name, max(parameter.opts, key=len) if is_option else parameter.human_readable_name
