"""Spreads of numbers, written for the domain randomisation of those who train policies."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pupper_analysis.base.arguments import check_type
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.files import whole_file
from pupper_analysis.base.kinds import RANGES
from pupper_analysis.tools.study.parameters import AXES, Named

_DIGITS = 12
"""Significant digits: what is beyond is rounding, as in 0.39999999999999997."""


def write_randomisation(
    spreads: Mapping[str, Mapping[str, Any]], path: str | Path, *, force: bool = False
) -> None:
    """Writes spreads for the domain randomisation of those who train policies, as YAML.

    Each entry has the number, how it acts (``scale`` on the model's value, ``add`` to it, or
    ``absolute``), the distribution, and its numbers.

    Args:
        spreads: {variable: {kind: numbers}}, as ``Tolerance.spreads`` or ``Study.spreads``.
            ``KIND:each:PATTERN`` is drawn for each that matches, ``KIND:PATTERN`` once for all.
        path: The file.
        force: Replace what is no such file, too.

    Raises:
        ConfigurationError: If a spread is none.
        OutputError: If it cannot be written, or is no such file.
    """
    check_type("path", path, str | Path)
    text = randomisation_text(spreads)
    with whole_file(Path(path), RANGES, force=force) as file:
        file.write(text.encode())


def randomisation_text(spreads: Mapping[str, Mapping[str, Any]]) -> str:
    """Returns what ``write_randomisation`` writes.

    Raises:
        ConfigurationError: If a spread is none.
    """
    check_type("spreads", spreads, Mapping[str, Mapping[str, Any]])
    for name, given in spreads.items():
        if not isinstance(given, Mapping) or len(given) != 1:
            told = diagnose("no-spread", name=name, given=repr(given))
            raise ConfigurationError("spreads", told)
    return "\n".join(_yaml(spreads)) + "\n"


def _yaml(spreads: Mapping[str, Mapping[str, Any]]) -> Iterator[str]:
    yield "# Domain randomization. scale: a factor on the model's value; add: to it; absolute: it."
    for name, given in spreads.items():
        ((kind, numbers),) = given.items()
        keys = {"normal": ("mean", "std"), "values": (), "linspace": ("low", "high", "count")}
        listed = keys.get(kind, ("low", "high"))
        acts = "scale" if ":" in name or name.endswith("_scale") else "absolute"
        acts = "add" if name.partition(":")[0] in AXES else acts
        yield f'- name: "{name}"'
        yield f"  operation: {acts}"
        if named := Named.of(name):
            yield f"  drawn: {'for each' if named.each else 'once'}"
        yield f"  distribution: {kind}"
        if not listed:
            yield f"  values: [{', '.join(map(_short, numbers))}]"
        for key, value in zip(listed, numbers, strict=False):
            yield f"  {key}: {_short(value)}"


def _short(value: Any) -> str:
    """Returns a number without the digits of rounding."""
    return repr(float(f"{float(value):.{_DIGITS}g}"))
