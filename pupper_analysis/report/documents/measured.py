"""The document of what a study has measured, without what follows from it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from pupper_analysis.report import document as doc
from pupper_analysis.report.words import join_words, text, word
from pupper_analysis.study.cells import column_label, metrics_in

if TYPE_CHECKING:
    import pandas as pd


def measured_document(
    name: str, variables: Mapping[str, object], table: pd.DataFrame
) -> doc.Document:
    """Returns the range of each metric, and failures by kind: what is known without an outcome.

    Args:
        name: What was studied.
        variables: Of the study, by name.
        table: Of the study.
    """
    rows: list[tuple[doc.Cell, ...]] = []
    for metric in metrics_in(table, tuple(variables)):
        column = table[metric].dropna()
        ends = (column.min(), column.median(), column.max())
        numbers = (doc.number_cell(float(value), ".5g") for value in ends)
        rows.append((doc.Name(column_label(metric)), *numbers, doc.number_cell(len(column), ".0f")))
    measured = doc.Table(
        text("what-was-measured"),
        (
            doc.Column(text("metric"), left=True),
            doc.Column(text("least")),
            doc.Column(text("median")),
            doc.Column(text("greatest")),
            doc.Column(text("designs"), "1"),
        ),
        tuple(rows),
    )
    kinds = table["failure"].dropna().value_counts().to_dict()
    ordered = sorted(kinds.items(), key=lambda item: (-int(item[1]), str(item[0])))
    told = text(
        "count-designs-of-which-failed",
        count=len(table),
        failed=sum(int(count) for _, count in ordered),
    )
    if ordered:
        named = join_words(
            text("count-kind", count=int(count), kind=word(str(kind))) for kind, count in ordered
        )
        told = text("designs-kinds", designs=told, kinds=named)
    return doc.Document(text("study-of-designs"), doc.Name(name), (measured,), told=(told,))
