"""``Diagnostic``: a reported fact, with a stable code, a subject, values with units, and sources.

`diagnose` creates a diagnostic from a code and values. The catalogue contains severity, group and
texts in both languages, under the code. `fill_template` inserts the values into a text. Programs
read the code and the values, users read the text.
"""

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
    """Severity of a diagnostic: error, warning or note."""

    ERROR = "error"
    """Impossible, rejected or failed."""
    WARNING = "warning"
    """Very likely unintended, or a verdict depends on the finding."""
    NOTE = "note"
    """Information."""

    @classmethod
    def _missing_(cls, value: object) -> Severity | None:
        """Return NOTE for "info", the name in older audits and settings; None for other values."""
        return cls.NOTE if value == "info" else None  # name in older audits and configurations

    @property
    def rank(self) -> int:
        """Rank of the severity for sorting: 0 for errors, 1 for warnings, 2 for notes."""
        return list(Severity).index(self)


class Group(StrEnum):
    """Group of diagnostics that require the same action of the user; in display order."""

    WRONG = "wrong"
    """Must be repaired."""
    ASSUMED = "assumed"
    """Added or modified by the package, because not specified in the files: must be checked."""
    FOUND = "found"
    """Read from the files: for information."""


@dataclass(frozen=True)
class Subject:
    """Element that a diagnostic concerns, such as a joint.

    Attributes:
        kind: Type of the element, a term: ``"joint"``, ``"link"``, ``"geom"``, ``"foot"``,
            ``"file"`` ...
        name: Name of the element.
    """

    kind: str
    name: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "name", to_unicode(self.name))


@dataclass(frozen=True)
class Source:
    """Location of a value in a file.

    Attributes:
        file: The file.
        line: Line number, from 1; None for the whole file or if unknown.
        element: Element, such as ``"joint/limit"``; "" if unknown.
        attribute: Attribute; "" for the whole element.
    """

    file: str
    line: int | None = None
    element: str = ""
    attribute: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "file", to_unicode(self.file))


@dataclass(frozen=True)
class Diagnostic:
    """Reported fact as data: code, severity, subject, values with units, and sources.

    ``str`` returns the English text. Diagnostics are compared by all fields.

    Attributes:
        code: Key of the catalogue entry, such as ``"mesh-missing"``. Codes are stable.
        severity: Severity of the catalogue, unless `diagnose` received another severity.
        subject: Element that the diagnostic concerns; None for the whole robot or task.
        values: {name: value of a type in `Value`}, for example a number with unit, a name, a term,
            a tuple or another diagnostic.
        sources: Locations of the values.
    """

    code: str
    severity: Severity
    subject: Subject | None = None
    values: Mapping[str, Value] = field(default_factory=FrozenDict)
    sources: tuple[Source, ...] = ()

    @property
    def group(self) -> Group:
        """Group of this diagnostic, by the required action of the user."""
        return Group(entry(self.code).group)

    def text(self, language: str = "en") -> str:
        """Return the text of this diagnostic in a language, with the values inserted.

        Args:
            language: ``"en"`` or ``"zh"``.
        """
        return fill_template(entry(self.code).templates[language], self._template_values, language)

    @property
    def short(self) -> str:
        """Short English text of this diagnostic for a terminal; empty if the catalogue has none."""
        return self._fill_short_template("en")

    @property
    def short_zh(self) -> str:
        """Short Chinese text of this diagnostic for a terminal; empty if the catalogue has none."""
        return self._fill_short_template("zh")

    def get_short_form(self, language: str) -> str:
        """Return the short text in a language ("en", "zh"), or the full text if there is none."""
        return self._fill_short_template(language) or self.text(language)

    def _fill_short_template(self, language: str) -> str:
        """Return the short text in a language; empty if the catalogue has none."""
        template = entry(self.code).short_templates[language]
        if not template:
            return ""
        values = {
            name: _shorten_diagnostics(value, language)
            for name, value in self._template_values.items()
        }
        return fill_template(template, values, language)

    @property
    def _template_values(self) -> dict[str, Any]:
        """Values for the placeholders of a template: ``values``, and the subject with its name."""
        values: dict[str, Any] = dict(self.values)
        if self.subject is not None:
            values.update(subject=self.subject, name=self.subject.name)
        return values

    def __str__(self) -> str:
        return self.text()

    def with_names(self, change: Callable[[str], str]) -> Diagnostic:
        """Return a copy with changed names of the subject, of text values, and of source files.

        Args:
            change: Function that maps an old name or text to the new name or text. Terms and
                phrases are not changed.
        """
        subject = self.subject
        return replace(
            self,
            subject=None if subject is None else Subject(subject.kind, change(subject.name)),
            values=FrozenDict(
                {name: _change_names(value, change) for name, value in self.values.items()}
            ),
            sources=tuple(replace(source, file=change(source.file)) for source in self.sources),
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the fields of this diagnostic for JSON, with the English text as ``message``."""
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
"""Types of the values of a diagnostic; lists are stored as tuples."""


def diagnose(
    code: str,
    /,
    *,
    subject: Subject | tuple[str, str] | None = None,
    sources: Iterable[Source] | Source | str | PathLike[str] = (),
    severity: Severity | None = None,
    **values: object,
) -> Diagnostic:
    """Create a diagnostic from a code of the catalogue and values.

    Args:
        code: Key of the catalogue entry.
        subject: Element that the diagnostic concerns, or its (kind, name).
        sources: Locations of the values. A path represents the whole file.
        severity: Severity, if it differs from the severity in the catalogue.
        **values: Values for the text, and for programs that read the diagnostic. NumPy numbers
            become Python numbers, iterables become tuples.

    Raises:
        KeyError: If the catalogue does not contain the code, and no ``severity`` is given.
        TypeError: If a value has a type that a diagnostic cannot store.
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
        FrozenDict({name: _to_value(value) for name, value in values.items()}),
        tuple(sources),
    )


def merge_diagnostics(diagnostics: Iterable[Diagnostic]) -> tuple[Diagnostic, ...]:
    """Return diagnostics without duplicates, sorted by group, then by severity (errors first).

    The order of the groups is: wrong (to repair), assumed (to check), found (information).
    """
    order = list(Group)
    return tuple(
        sorted(
            dict.fromkeys(diagnostics),
            key=lambda diagnostic: (order.index(diagnostic.group), diagnostic.severity.rank),
        )
    )


def contains_error(diagnostics: Iterable[Diagnostic]) -> bool:
    """Return True if the severity of at least one diagnostic is ERROR."""
    return any(diagnostic.severity is Severity.ERROR for diagnostic in diagnostics)


def _shorten_diagnostics(value: Any, language: str) -> Any:
    """Replace each diagnostic in a value by its short text in a language, if there is one."""
    if isinstance(value, tuple):
        return tuple(_shorten_diagnostics(item, language) for item in value)
    if not isinstance(value, Diagnostic):
        return value
    return value._fill_short_template(language) or value


def _change_names(value: Value, change: Callable[[str], str]) -> Value:
    """Apply a function to the texts in a value of a diagnostic, except terms and phrases."""
    if isinstance(value, tuple):
        return tuple(_change_names(item, change) for item in value)
    if isinstance(value, Diagnostic):
        return value.with_names(change)
    if isinstance(value, Term | Phrase) or not isinstance(value, str):
        return value
    return change(value)


def _to_value(value: Any) -> Any:
    """Convert a value to a type that a diagnostic can store; raise TypeError for other types."""
    if hasattr(value, "tolist"):  # NumPy array or scalar
        value = value.tolist()
    if value is None or isinstance(
        value, bool | int | float | Quantity | Vector | Diagnostic | Term | Phrase
    ):
        return value
    if isinstance(value, str | PathLike):
        return to_unicode(str(value))
    if isinstance(value, Iterable):
        return tuple(_to_value(item) for item in value)
    raise TypeError(f"{type(value).__name__} is no value of a diagnostic")
