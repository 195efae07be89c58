"""Fills the catalogue's templates.

In a template may stand

- ``{mass}``, ``{mass:.3g}``: a value, with a format of Python's; a ``Quantity`` comes with its
  unit, and ``{gap:mm:.1f}`` shows it in another one (mm, deg, g, ms, %), ``{gap::.1f}`` in none;
- ``{name!r}``: a text in quotes;
- ``{names}``: several, with commas between them, at most eight; ``{names:3}`` at most three. What
  is left out is counted: "a, b, c and 2 more". ``{parts:;}`` has semicolons, ``{ways:or}`` " or ",
  ``{both:and}`` " and "; ``{masses:3|.2f}`` gives the format of each;
- ``{subject}``: "joint FL_knee", ``{subject!r}``: "joint 'FL_knee'"; ``{name}``: its name alone;
- ``{count|foot|feet}``: a word that depends on a number: the first for 1;
- ``[limit? beyond {limit}]``: words that stand only where a value is (not None, empty or false);
  ``[!limit? ...]`` where it is not. They are not nested.

Words in values (``Term``, another ``Diagnostic``) are said in the same language.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from string import Formatter
from typing import Any

from pupper_analysis.base.diagnostics.catalogue import term
from pupper_analysis.base.diagnostics.values import Term

_OPTIONAL = re.compile(r"\[(!?)(\w+)\?((?:[^\[\]])*)\]")
_LIST = re.compile(r"(,or|or|and|,|;|)(\d*)(?:\|(.*))?$")

_MOST_NAMES = 8
"""Names in a list: a page of names hides what is said of them."""

_BETWEEN = {
    "en": {",": ", ", ";": "; ", "or": " or ", ",or": ", or ", "and": " and "},
    "zh": {",": "、", ";": "；", "or": "或", ",or": "，或 ", "and": "和"},  # noqa: RUF001
}
_MORE = {"en": "{listed} and {left} more", "zh": "{listed}，另有 {left} 个"}  # noqa: RUF001


def fill_template(template: str, values: Mapping[str, Any], language: str) -> str:
    """Returns a template with its values.

    Args:
        template: The template.
        values: {name: value}.
        language: ``"en"`` or ``"zh"``.

    Raises:
        KeyError: If a value is missing.
    """
    whole = _OPTIONAL.sub(
        lambda part: part[3] if bool(values.get(part[2])) != bool(part[1]) else "", template
    )
    return _Filler(language).vformat(whole, (), values)


class _Filler(Formatter):
    """Python's formatter, with lists, words that depend on numbers, and a language."""

    def __init__(self, language: str) -> None:
        self.language = language

    def get_field(self, field_name: str, _args: Any, kwargs: Any) -> tuple[Any, str]:
        name, *forms = field_name.split("|")
        value = kwargs[name]
        if forms:
            one, many = forms
            count = value if isinstance(value, int | float) else len(value)
            return (one if count == 1 else many), name
        return value, name

    def convert_field(self, value: Any, conversion: str | None) -> Any:
        if conversion == "r" and isinstance(value, tuple):
            return tuple(repr(one) for one in value)
        if conversion == "r" and hasattr(value, "kind"):
            return f"{term(value.kind, self.language)} {value.name!r}"
        return super().convert_field(value, conversion)

    def format_field(self, value: Any, format_spec: str) -> str:
        if isinstance(value, tuple):
            return self._listed(value, format_spec)
        if isinstance(value, Term):
            return term(str(value), self.language)
        if hasattr(value, "text"):  # another diagnostic, or a phrase
            return str(value.text(self.language))
        if hasattr(value, "kind"):  # a subject
            return f"{term(value.kind, self.language)} {value.name}"
        return format(value, format_spec)

    def _listed(self, values: tuple[Any, ...], spec: str) -> str:
        found = _LIST.match(spec)
        if found is None:
            raise ValueError(f"{spec!r} is no format of a list")
        mark, most, each = found[1] or ",", int(found[2] or _MOST_NAMES), found[3] or ""
        shown = values if len(values) <= most + 1 else values[:most]  # "and 1 more" saves nothing
        listed = _BETWEEN[self.language][mark].join(self.format_field(one, each) for one in shown)
        left = len(values) - len(shown)
        return _MORE[self.language].format(listed=listed, left=left) if left else listed
