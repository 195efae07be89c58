"""A verdict on a page: its sentences in both languages."""

from __future__ import annotations

from pupper_analysis.report import verdict as words
from pupper_analysis.report.html import document as doc
from pupper_analysis.report.html.sentences import said
from pupper_analysis.report.html.words import text
from pupper_analysis.simulation.verdict import Verdict


def verdict_lines(verdict: Verdict) -> tuple[doc.Words, ...]:
    """Returns what a verdict says, a line each."""
    return tuple(
        text(clause.sentence, **{name: said(value) for name, value in clause.values.items()})
        for clause in words.clauses(verdict)
    )


def verdict_word(verdict: Verdict) -> doc.Words:
    """Returns a verdict in a word or two."""
    return text(words.word(verdict))
