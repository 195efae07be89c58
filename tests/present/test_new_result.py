"""A result that is added as the page on architecture says is shown everywhere, in two languages."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest
from matplotlib.image import imread
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import catalogue
from pupper_analysis.base.results import Result
from pupper_analysis.base.tools import Tool, own_tools
from pupper_analysis.present.document import LinePlot
from pupper_analysis.present.documents import registry
from pupper_analysis.present.documents.registry import build_report, document
from pupper_analysis.present.figures.drawing import write_plots
from pupper_analysis.present.html.write import write_report
from pupper_analysis.present.markdown import write_markdown
from tests.support import printing
from tests.support.html_page import Page, shown
from tests.support.repository import ROOT


@dataclass(frozen=True, eq=False)
class FootWear(Result):
    """How fast feet wear off.

    Attributes:
        name: The robot's name.
        rates: {foot: mm/h}.
        time: (n,) h.
        depth: {foot: (n,) mm}.
        passed: Whether they last a day.
    """

    name: str
    rates: dict[str, float]
    time: NDArray[np.float64]
    depth: dict[str, NDArray[np.float64]]
    passed: bool


WORDS = {
    "wear": ("wear", "磨损"),
    "wear-title": ("Wear", "磨损报告"),
    "wear-of-feet": ("Wear of the feet", "各足的磨损"),
    "wear-over-time": ("Wear over time", "磨损随时间的变化"),
}
IMPORTS = """
from tests.present.test_new_result import FootWear
from pupper_analysis.present import document as doc
from pupper_analysis.present.documents.registry import build_document
from pupper_analysis.present.document import text
from pupper_analysis.robot.robot import Robot
"""


@pytest.fixture
def wear(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[FootWear]:
    """A result of the core whose builder is the example, in the tool that shows it."""
    page = (ROOT / "docs/explanation/architecture.md").read_text()
    (code,) = re.findall(r"```python\n(# tools/wear/document\.py.*?)```", page, re.DOTALL)
    folder = tmp_path / "wear_of_feet"
    folder.mkdir()
    text = f"from __future__ import annotations\n{IMPORTS}\n{code}"
    (folder / "document.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    tools = {**own_tools(), "wear": Tool(folder.name, folder)}
    monkeypatch.setattr(registry, "own_tools", lambda: tools)
    known = catalogue.list_entries("texts.toml")
    entries = {key: f'{{ en = "{en}", zh = "{zh}" }}' for key, (en, zh) in WORDS.items()}
    both = MappingProxyType({**known, **entries})
    real = catalogue.list_entries
    monkeypatch.setattr(
        catalogue, "list_entries", lambda file: both if file == "texts.toml" else real(file)
    )
    time = np.array([0.0, 10.0, 20.0])
    rates = {"FL": 0.25, "RR": 0.75}
    yield FootWear("v9", rates, time, {foot: rate * time for foot, rate in rates.items()}, True)
    for name in (folder.name, f"{folder.name}.document"):
        sys.modules.pop(name, None)


def test_one_builder_shows_it_everywhere(wear: FootWear, tmp_path: Path) -> None:
    terminal = printing.printed(wear)
    assert terminal.startswith("WITHSTANDS v9")
    assert re.search(
        r"Wear of the feet\n +wear\nfoot +\(mm/h\)\n─+\nFL +0\.25\nRR +0\.75\n", terminal
    )
    said = write_markdown(build_report([("", wear)]))
    assert "### ✅ WITHSTANDS v9" in said
    assert "| foot | wear (mm/h) |\n| :--- | ---: |\n| FL | 0.25 |\n| RR | 0.75 |" in said
    write_report(wear, tmp_path / "wear.html")
    page = Page((tmp_path / "wear.html").read_text(encoding="utf-8"))
    assert page.tables()["Wear of the feet"][1] == {"foot": "RR", "wear (mm/h)": "0.75"}
    chinese = shown(page.root.find("body"), "zh")
    assert all(zh in chinese for _, zh in WORDS.values() if zh != WORDS["wear-title"][1])
    assert "承受得住" in chinese
    lines = [line.get("data-labels") for line in page.root.iter("polyline")]
    assert lines[1] == "0 h, 0.00 mm|10 h, 7.50 mm|20 h, 15.00 mm"


def test_the_plot_of_a_new_result_is_a_figure_too(wear: FootWear, tmp_path: Path) -> None:
    (plot,) = (one for one in document(wear).blocks if isinstance(one, LinePlot))
    write_plots([plot], tmp_path / "wear.png")
    drawn = imread(tmp_path / "wear.png")[..., :3].min(axis=-1) < 0.9
    assert 0.01 < drawn.mean() < 0.5
