"""The notebook of the examples runs from top to bottom, and its cells show tables and figures."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.support.repository import ROOT

NOTEBOOK = ROOT / "examples" / "first_look.ipynb"


def outputs(cell: dict[str, Any]) -> Iterator[str]:
    """Yield the MIME types of the outputs of a cell."""
    for output in cell.get("outputs", ()):
        assert output["output_type"] != "error", output
        yield from output.get("data", ())


@pytest.mark.slow
def test_notebook_shows_tables_and_figures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Executed by a kernel of this Python, as Jupyter does."""
    # Commands that ran in this process chose the backend for files.
    monkeypatch.delenv("MPLBACKEND", raising=False)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of Jupyter's own packages
        nbclient = pytest.importorskip("nbclient")
        nbformat = pytest.importorskip("nbformat")
        pytest.importorskip("ipykernel")
        notebook = nbformat.read(NOTEBOOK, as_version=4)
        resources = {"metadata": {"path": str(tmp_path)}}
        nbclient.NotebookClient(notebook, timeout=300, resources=resources).execute()
    shown = {cell["source"]: set(outputs(cell)) for cell in notebook.cells}
    figures = [source for source, kinds in shown.items() if "image/png" in kinds]
    assert figures == [source for source in shown if ".plot(" in source or ".show(" in source]
    assert len(figures) == 3
    tables = [source for source, kinds in shown.items() if "text/html" in kinds]
    assert len(tables) == 4  # the animation is HTML, too


def test_notebook_is_stored_without_outputs() -> None:
    """Outputs change with each run, and would make differences of the notebook unreadable."""
    text = NOTEBOOK.read_text(encoding="utf-8")
    assert '"outputs": []' in text
    assert '"output_type"' not in text
    assert '"execution_count": 1' not in text
