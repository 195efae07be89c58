"""The document of a search for the best stance."""

from __future__ import annotations

from pupper_analysis.present.document import Document, Table, get_english
from pupper_analysis.tools.best.document import best_document
from pupper_analysis.tools.stand.document import stance_document
from tests.support.stubs import best, stance


def list_titles(document: Document) -> set[str]:
    """Return the titles of the tables."""
    return {get_english(block.title) for block in document.blocks if isinstance(block, Table)}


def test_best_stance_is_described_as_a_stance_alone() -> None:
    """All tables, findings and details of the document of a stance occur."""
    found, alone = best_document(best()), stance_document(stance())
    assert list_titles(alone)
    assert list_titles(alone) < list_titles(found)
    texts, expected = (
        {get_english(line) for line in (*document.findings, *document.details)}
        for document in (found, alone)
    )
    assert expected <= texts
