"""Terminal output of documents as text."""

from __future__ import annotations

import io

from pupper_analysis.base.results import Result
from pupper_analysis.present.document import Document, Report
from pupper_analysis.present.documents.registry import make_document
from pupper_analysis.present.terminal import SafeConsole, print_document, print_report


def printed(
    shown: Result | Document | Report,
    *,
    width: int = 80,
    everything: bool = True,
    language: str = "en",
) -> str:
    """Return what the terminal shows of a result, a document or a report."""
    file = io.StringIO()
    out = SafeConsole(language=language, file=file, width=width, highlight=False, emoji=False)
    if isinstance(shown, Report):
        print_report(out, shown, everything=everything)
    else:
        made = shown if isinstance(shown, Document) else make_document(shown)
        print_document(out, made, everything=everything)
    return file.getvalue()
