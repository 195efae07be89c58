"""What a terminal shows of documents."""

from __future__ import annotations

import io

from pupper_analysis.report.document import Document, Report
from pupper_analysis.report.documents.registry import document
from pupper_analysis.report.terminal import SafeConsole, print_document, print_report
from pupper_analysis.results import Result


def printed(shown: Result | Document | Report, *, width: int = 80, everything: bool = True) -> str:
    """What is printed of a result, of its document, or of a report."""
    file = io.StringIO()
    out = SafeConsole(file=file, width=width, highlight=False, emoji=False)
    if isinstance(shown, Report):
        print_report(out, shown, everything=everything)
    else:
        made = shown if isinstance(shown, Document) else document(shown)
        print_document(out, made, everything=everything)
    return file.getvalue()
