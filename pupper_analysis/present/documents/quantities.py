"""Tables of quantities whose units differ: a row for each, with its unit in a column."""

from __future__ import annotations

from pupper_analysis.present.document import Column, Words
from pupper_analysis.present.words import text


def quantity_columns(*values: Words, of: str = "quantity") -> tuple[Column, ...]:
    """Returns the columns of such a table.

    Args:
        *values: Of which runs or files the values are; ``value`` alone where none is given.
        of: What each row is; a key of the catalogue.
    """
    named = values or (text("value"),)
    middle = (Column(name) for name in named)
    return (Column(text(of), left=True), *middle, Column(text("unit"), left=True))
