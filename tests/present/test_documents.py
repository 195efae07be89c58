"""Documents of results equal golden Markdown files.

``golden/*.md`` contain results whose numbers are all different (``stubs``), so that exchanged
fields are visible. ``python -m tests.present.test_documents`` writes the files anew; read the diff.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache

import pytest

from pupper_analysis.present.document import Report
from pupper_analysis.present.markdown import write_markdown
from tests.support.repository import ROOT
from tests.support.stubs import REPORTS

GOLDEN = ROOT / "tests" / "golden"


@cache
def report(name: str) -> Report:
    return REPORTS[name]()


@pytest.mark.parametrize("name", REPORTS)
def test_documents_equal_the_golden_files(name: str) -> None:
    assert write_markdown(report(name)) == (GOLDEN / f"{name}.md").read_text(encoding="utf-8")


def write(names: Iterable[str]) -> None:
    """Writes the golden documents anew."""
    for name in names:
        (GOLDEN / f"{name}.md").write_text(write_markdown(report(name)), encoding="utf-8")


if __name__ == "__main__":
    GOLDEN.mkdir(exist_ok=True)
    write(REPORTS)
