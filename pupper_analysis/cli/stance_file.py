"""``--stance FILE``: options of a stance from a file, which the live page saves."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError, InputError
from pupper_analysis.base.inputs import read_toml
from pupper_analysis.cli.stance_fields import TYPED

_OF_ROBOT = ("payload", "payload_at", "kp", "kd", "integrator", "cone", "impratio")
"""Options besides those of the stance: the load, and the servos that hold it."""


def _take_options(context: click.Context, _option: click.Parameter, path: Path | None) -> None:
    """Makes what a file says the options' defaults: what is typed goes first."""
    if path is not None:
        context.default_map = {**(context.default_map or {}), **read_stance_file(path)}


stance_option = click.option(
    "--stance",
    type=click.Path(path_type=Path),
    is_eager=True,  # before the options whose defaults it gives
    expose_value=False,
    callback=_take_options,
    help="TOML file of such options, as the live page saves it; e.g. a line height = '12cm'. What "
    "is typed goes first.",
)


def read_stance_file(path: Path) -> dict[str, Any]:
    """Returns {parameter: value as it would be typed} of a stance's file.

    Raises:
        ConfigurationError: If it cannot be read, or has what is no option of a stance.
    """
    try:
        _, given = read_toml(path)
    except InputError as error:
        raise ConfigurationError(str(path), error.cause) from error
    known = {field.option: name for name, field in TYPED.items()}
    known |= {name.replace("_", "-"): name for name in _OF_ROBOT}
    options = {}
    for key, value in given.items():
        option = key.replace("_", "-")
        if option not in known:
            unknown = diagnose("no-option-of-a-stance", given=key, known=sorted(known))
            raise ConfigurationError(str(path), unknown)
        typed = _typed(path, key, value)
        several = option in ("kp", "kd") and not isinstance(typed, list)
        options[known[option]] = [typed] if several else typed
    return options


def _typed(path: Path, key: str, value: Any) -> Any:
    """Returns a value as it is typed: a point with commas, of several feet or joints a list.

    Raises:
        ConfigurationError: If none is typed so.
    """
    if isinstance(value, Mapping):
        return [f"{name}={_typed(path, key, one)}" for name, one in value.items()]
    if isinstance(value, list):
        return ",".join(str(_typed(path, key, one)) for one in value)
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise ConfigurationError(str(path), diagnose("no-value-of-a-stance", given=key))
    return value
