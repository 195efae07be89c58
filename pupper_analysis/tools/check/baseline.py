"""The baseline: what is known of a repository's models, so that only what is new fails."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.base.files import whole_file
from pupper_analysis.base.kinds import EDITED
from pupper_analysis.base.results import Result
from pupper_analysis.models.places import source_name
from pupper_analysis.tools.check.remarks import REFUSED, Remark, RemarkState
from pupper_analysis.tools.check.toml import read_toml, toml_table

_IDENTITY: Final = ("check", "pair", "file", "kind", "element")
_VALUES: Final = ("urdf", "mjcf", "code", "values")
_VERSION: Final = 2

_HEADER: Final = """\
# What `pupper-analysis check` knows of the models: only what is not here, or has changed, fails.
# Written by `pupper-analysis check --update-baseline`; its diff is what is let pass.
version = 2
"""

_VALUE_TOLERANCE: Final = 1e-6
"""How far numbers may be apart, relative to the largest beside them, and count as the same.

What is kept has 9 digits; angles and inertias that went through rotations have some 12 in common on
different machines.
"""


@dataclass(frozen=True)
class BaselineEntry(Result):
    """One remark that is known.

    Attributes:
        identity: The remark's.
        values: The remark's.
        note: Its message when it was written, as a comment for people.
    """

    identity: tuple[str, ...]
    values: Mapping[str, Any]
    note: str = field(default="", compare=False)

    def is_of(self, remark: Remark) -> bool:
        """Whether it has the values of a remark of its identity."""
        return is_same(self.values, remark.values)

    def __str__(self) -> str:
        check, pair, file, kind, element = self.identity
        return f"{check} of {pair or file}: {kind}{f' of {element}' if element else ''}"


def read_baseline(path: Path) -> tuple[BaselineEntry, ...]:
    """Reads a baseline; one that does not exist is empty.

    Raises:
        ModelError: If it cannot be read, or holds what is not valid; it tells the line.
    """
    try:
        file = read_toml(path)
    except ModelError as error:
        if error.cause.code == "no-such-file":
            return ()
        raise
    version = file.values.get("version")
    if version != _VERSION or isinstance(version, bool):
        told = diagnose("baseline-version-unknown", version=repr(version), known=_VERSION)
        raise ModelError(source_name(path, file.line_of(("version",))), told)
    for name in file.values.keys() - {"version", "known"}:
        raise file.error(
            (name,), diagnose("key-unknown", key=name, within="", known=("version", "known"))
        )
    known, entries = file.values.get("known", []), []
    if not isinstance(known, list):
        raise file.error(("known",), diagnose("baseline-without-tables"))
    for number, values in enumerate(known):
        key = ("known", number)
        if not isinstance(values, dict):
            raise file.error(("known",), diagnose("baseline-entry-no-table"))
        for name, value in values.items():
            if name not in (*_IDENTITY, *_VALUES):
                valid = (*_IDENTITY, *_VALUES)
                told = diagnose("key-unknown", key=name, within="known", known=valid)
                raise file.error((*key, name), told)
            if name in _IDENTITY and not isinstance(value, str):
                told = diagnose("baseline-value-no-text", key=name, value=repr(value))
                raise file.error((*key, name), told)
        identity = tuple(values.get(name, "") for name in _IDENTITY)
        entries.append(BaselineEntry(identity, {k: v for k, v in values.items() if k in _VALUES}))
    return tuple(entries)


def write_baseline(path: Path, entries: Iterable[BaselineEntry]) -> None:
    """Writes a baseline in place of the one that was read: sorted, whole or not at all.

    Raises:
        OutputError: If it cannot be written.
    """
    ordered = sorted(entries, key=lambda entry: (entry.identity, str(entry.values)))
    tables = [_HEADER]
    for entry in ordered:
        names = dict(zip(_IDENTITY, entry.identity, strict=True))
        values = {**{name: text for name, text in names.items() if text}, **entry.values}
        notes = [entry.note] if entry.note else []
        tables.append(toml_table("known", values, notes))
    with whole_file(path, EDITED) as file:
        file.write("\n".join(tables).encode())


def entry_of(remark: Remark) -> BaselineEntry:
    """Returns what a baseline keeps of a remark."""
    return BaselineEntry(remark.identity, remark.values, str(remark.diagnostic))


def judge_remarks(
    remarks: Iterable[Remark], entries: Iterable[BaselineEntry]
) -> tuple[tuple[Remark, ...], tuple[BaselineEntry, ...]]:
    """Tells which remarks are known, which have changed, and which are new.

    Returns:
        The remarks with their states; and the stale entries, to which there is no remark any more.
    """
    waiting: dict[tuple[str, ...], list[BaselineEntry]] = {}
    for entry in entries:
        if entry.identity[3] == REFUSED:
            continue  # nobody can know what is in a file that cannot be read
        waiting.setdefault(entry.identity, []).append(entry)
    result = list(remarks)
    for number, remark in enumerate(result):
        here = waiting.get(remark.identity, [])
        found = next((entry for entry in here if entry.is_of(remark)), None)
        if found is not None:
            here.remove(found)
            result[number] = replace(remark, state=RemarkState.KNOWN)
    # Only what is the same nowhere has changed: there may be several of one identity.
    for number, remark in enumerate(result):
        here = waiting.get(remark.identity, [])
        if remark.state is RemarkState.NEW and here:
            before = here.pop(0).values
            result[number] = replace(remark, state=RemarkState.CHANGED, before=before)
    return tuple(result), tuple(entry for here in waiting.values() for entry in here)


def is_same(one: Any, two: Any) -> bool:
    """Whether two values are the same but for rounding."""
    if isinstance(one, Mapping) and isinstance(two, Mapping):
        return one.keys() == two.keys() and all(is_same(one[key], two[key]) for key in one)
    if isinstance(one, list | tuple) and isinstance(two, list | tuple):
        here, there = _numbers(one), _numbers(two)
        if here is None or there is None:
            return len(one) == len(two) and all(map(is_same, one, two))
        return _near(here, there)
    numbers = _numbers([one]), _numbers([two])
    if numbers[0] is None or numbers[1] is None:
        return bool(one == two) and isinstance(one, bool) == isinstance(two, bool)
    return _near(*numbers)  # type: ignore[arg-type]


def _numbers(values: Iterable[Any]) -> list[float] | None:
    """Returns all numbers of nested lists; None if there is anything else."""
    found: list[float] = []
    for value in values:
        if isinstance(value, list | tuple):
            inner = _numbers(value)
            if inner is None:
                return None
            found += inner
        elif isinstance(value, int | float) and not isinstance(value, bool):
            found.append(float(value))
        else:
            return None
    return found


def _near(here: list[float], there: list[float]) -> bool:
    finite = [abs(value) for value in (*here, *there) if math.isfinite(value)]
    allowed = _VALUE_TOLERANCE * max(finite, default=0.0)
    return len(here) == len(there) and all(
        a == b or abs(a - b) <= allowed or (math.isnan(a) and math.isnan(b))
        for a, b in zip(here, there, strict=True)
    )
