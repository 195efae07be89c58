"""A fact: a stable code, its subject, its values with units, and where they come from."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from os import PathLike
from typing import Any, TypeAlias

from pupper_analysis.base.diagnostics.catalogue import entry
from pupper_analysis.base.diagnostics.templates import (
    Phrase,
    Quantity,
    Term,
    Vector,
    fill_template,
    to_unicode,
)
from pupper_analysis.base.frozen import FrozenDict


class Severity(StrEnum):
    """How bad it is."""

    ERROR = "error"
    """It is impossible, refused, or fails."""
    WARNING = "warning"
    """It is very likely not what is meant, or a verdict rests on it."""
    NOTE = "note"
    """Worth knowing."""

    @classmethod
    def _missing_(cls, value: object) -> Severity | None:
        return cls.NOTE if value == "info" else None  # as audits, and configurations, had it before

    @property
    def rank(self) -> int:
        """0 for the worst."""
        return list(Severity).index(self)


class Group(StrEnum):
    """What a reader has to do with it; in the order in which it is shown."""

    WRONG = "wrong"
    """To be mended."""
    ASSUMED = "assumed"
    """Made up or altered by the package, for want of it in the files: to be checked."""
    FOUND = "found"
    """Read from the files: to be known."""


@dataclass(frozen=True)
class Subject:
    """What a diagnostic is about.

    Attributes:
        kind: A term: ``"joint"``, ``"link"``, ``"geom"``, ``"foot"``, ``"file"`` ...
        name: Its name.
    """

    kind: str
    name: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "name", to_unicode(self.name))


@dataclass(frozen=True)
class Source:
    """Where a value is stated.

    Attributes:
        file: The file.
        line: Its line, from 1; None where the file as a whole is meant.
        element: The element, such as ``"joint/limit"``; "" where that is not known.
        attribute: Its attribute; "" for all of it.
    """

    file: str
    line: int | None = None
    element: str = ""
    attribute: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "file", to_unicode(self.file))


@dataclass(frozen=True)
class Diagnostic:
    """One fact that is reported.

    ``str`` says it in English. Two are equal if code, subject, values and sources are.

    Attributes:
        code: Its entry of the catalogue, such as ``"mesh-missing"``. Codes stay as they are.
        severity: The catalogue's, or a lesser one where the case is less bad.
        subject: What it is about; None where that is the whole robot or task.
        values: {name: number with a unit, name, word, or several of them, or another diagnostic}.
        sources: Where its values are stated.
    """

    code: str
    severity: Severity
    subject: Subject | None = None
    values: Mapping[str, Value] = field(default_factory=FrozenDict)
    sources: tuple[Source, ...] = ()

    @property
    def group(self) -> Group:
        """What a reader has to do with it."""
        return Group(entry(self.code).group)

    def text(self, language: str = "en") -> str:
        """Returns it in words.

        Args:
            language: ``"en"`` or ``"zh"``.
        """
        values: dict[str, Any] = dict(self.values)
        if self.subject is not None:
            values.update(subject=self.subject, name=self.subject.name)
        return fill_template(entry(self.code).templates[language], values, language)

    def __str__(self) -> str:
        return self.text()

    def with_names(self, change: Callable[[str], str]) -> Diagnostic:
        """Returns it with other names: of files that are shown under the name that is known.

        Args:
            change: Returns the name, or the text, that is shown for one; terms stay.
        """
        subject = self.subject
        return replace(
            self,
            subject=None if subject is None else Subject(subject.kind, change(subject.name)),
            values=FrozenDict({name: _named(one, change) for name, one in self.values.items()}),
            sources=tuple(replace(one, file=change(one.file)) for one in self.sources),
        )

    def to_dict(self) -> dict[str, Any]:
        """Returns it as JSON has it: its fields, and its English words as ``message``."""
        return {
            "code": self.code,
            "severity": self.severity.value,
            "message": self.text(),
            "subject": self.subject,
            "values": self.values,
            "sources": self.sources,
        }


Value: TypeAlias = (
    str
    | int
    | float
    | bool
    | Quantity
    | Vector
    | Term
    | Phrase
    | Diagnostic
    | tuple["Value", ...]
    | None
)
"""What a diagnostic may carry: lists are tuples."""


def diagnose(
    code: str,
    /,
    *,
    subject: Subject | tuple[str, str] | None = None,
    sources: Iterable[Source] | Source | str | PathLike[str] = (),
    severity: Severity | None = None,
    **values: object,
) -> Diagnostic:
    """Makes a diagnostic of a code of the catalogue.

    Args:
        code: The catalogue's.
        subject: What it is about, as (kind, name).
        sources: Where its values are stated; a file may be given by its path.
        severity: If less bad than the catalogue says.
        **values: What the words need, and what a program may want to know. Numbers of numpy become
            Python's, lists tuples.

    Raises:
        KeyError: If the catalogue has no such code.
    """
    if isinstance(subject, tuple):
        subject = Subject(*subject)
    if isinstance(sources, Source):
        sources = (sources,)
    elif isinstance(sources, str | PathLike):
        sources = (Source(str(sources)),)
    return Diagnostic(
        code,
        severity or Severity(entry(code).severity),
        subject,
        FrozenDict({name: _plain(value) for name, value in values.items()}),
        tuple(sources),
    )


def merge_diagnostics(diagnostics: Iterable[Diagnostic]) -> tuple[Diagnostic, ...]:
    """Returns diagnostics in the order in which they are shown, each once.

    What is wrong first, then what was assumed, then what was found; of each the worst first.
    """
    order = list(Group)
    return tuple(
        sorted(
            dict.fromkeys(diagnostics),
            key=lambda one: (order.index(one.group), one.severity.rank),
        )
    )


def _named(value: Value, change: Callable[[str], str]) -> Value:
    if isinstance(value, tuple):
        return tuple(_named(one, change) for one in value)
    if isinstance(value, Diagnostic):
        return value.with_names(change)
    if isinstance(value, Term | Phrase) or not isinstance(value, str):
        return value
    return change(value)


def _plain(value: Any) -> Any:
    """Returns a value as a diagnostic carries it."""
    if hasattr(value, "tolist"):  # numpy's float64 is a float, too
        value = value.tolist()
    if value is None or isinstance(
        value, bool | int | float | Quantity | Vector | Diagnostic | Term | Phrase
    ):
        return value
    if isinstance(value, str | PathLike):
        return to_unicode(str(value))
    if isinstance(value, Iterable):
        return tuple(_plain(one) for one in value)
    raise TypeError(f"{type(value).__name__} is no value of a diagnostic")
