"""Diagnostics as plain data, and back: what is told today can be said tomorrow, in any language."""

from __future__ import annotations

from typing import Any

from pupper_analysis.base.diagnostics.catalogue import entry
from pupper_analysis.base.diagnostics.diagnostic import (
    Diagnostic,
    Phrase,
    Quantity,
    Severity,
    Source,
    Subject,
    Term,
    Value,
    Vector,
)
from pupper_analysis.base.frozen import FrozenDict


def to_record(told: Diagnostic) -> dict[str, Any]:
    """Returns a diagnostic as JSON can hold it, from which ``from_record`` makes it again."""
    subject, sources = told.subject, told.sources
    return {
        "code": told.code,
        "severity": told.severity.value,
        "subject": None if subject is None else [subject.kind, subject.name],
        "values": {name: _recorded(value) for name, value in told.values.items()},
        "sources": [[one.file, one.line, one.element, one.attribute] for one in sources],
    }


def from_record(kept: dict[str, Any]) -> Diagnostic:
    """Returns the diagnostic of a record.

    Raises:
        KeyError: If the catalogue has its code no more.
    """
    entry(kept["code"])
    return Diagnostic(
        kept["code"],
        Severity(kept["severity"]),
        None if kept["subject"] is None else Subject(*kept["subject"]),
        FrozenDict({name: _restored(value) for name, value in kept["values"].items()}),
        tuple(Source(*one) for one in kept["sources"]),
    )


def _recorded(value: Value) -> Any:
    """Returns a value; what is no plain one is a dict with its kind as the key."""
    if isinstance(value, tuple):
        return [_recorded(one) for one in value]
    if isinstance(value, Diagnostic):
        return {"told": to_record(value)}
    if isinstance(value, Quantity):
        return {"quantity": [value.value, value.unit]}
    if isinstance(value, Vector):
        return {"vector": [list(value.values), value.unit]}
    if isinstance(value, Phrase):
        return {"phrase": [str(value), value.chinese]}
    return {"term": str(value)} if isinstance(value, Term) else value


def _restored(kept: Any) -> Value:
    if isinstance(kept, list):
        return tuple(map(_restored, kept))
    if not isinstance(kept, dict):
        return kept  # type: ignore[no-any-return]  # a number, a text, true or false, None
    ((kind, value),) = kept.items()
    if kind == "told":
        return from_record(value)
    if kind == "quantity":
        return Quantity(*value)
    if kind == "phrase":
        return Phrase(*value)
    return Vector(tuple(value[0]), value[1]) if kind == "vector" else Term(value)
