"""Printed documents in cases that no golden document contains."""

from __future__ import annotations

import re
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from types import SimpleNamespace as Stub

import numpy as np
import pytest
from matplotlib.image import imread

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.results import Result
from pupper_analysis.base.units import round_down
from pupper_analysis.present.document import (
    Axis,
    Column,
    Document,
    LinePlot,
    Name,
    Series,
    Table,
    Text,
    get_english,
    number_cell,
)
from pupper_analysis.present.documents import loads
from pupper_analysis.present.documents.registry import build_document, build_report
from pupper_analysis.present.documents.standing import run_rows
from pupper_analysis.present.figures.drawing import write_plots
from pupper_analysis.present.html.write import write_report
from pupper_analysis.present.markdown import write_markdown
from pupper_analysis.present.verdict import (
    make_published_clauses,
    qualify_verdict_word,
    verdict_word,
)
from pupper_analysis.robot.as_published import Published, PublishedRun
from pupper_analysis.simulation.verdict import judge_stance
from pupper_analysis.tools.analyze import document as comparison
from pupper_analysis.tools.stand.document import stance_document
from tests.support import printing
from tests.support.html_page import Page, read_text
from tests.support.stubs import ANALYSIS, SERVOS, STAND, problem, run, stance


def print_words(shown: Document) -> list[str]:
    """Return the words that are printed, without rules and bars."""
    text = printing.printed(shown, width=240)
    return [word for word in text.split() if word.strip("─█▏▎▍▌▋▊▉")]


def test_comparison_row_fields_come_from_the_analysis() -> None:
    """Reference: a stub with distinct values, so exchanged fields and inverted ratios are found."""
    stub = Stub(**{**vars(ANALYSIS), "stand": Stub(task=Stub(height=0.1234))})
    found = vars(comparison.compare_with_base(stub, "v3", 1.5, 0.05))
    words = {"name": "stub", "base": "v3", "stands_without": False, "verified": False}
    words |= {"converted": "", "peak_torque_unit": "N m"}
    numbers = {
        **{"total_mass": 3.171, "mass_ratio": 2.114, "thigh_ratio": 1.622},
        **{"height": 0.1234, "peak_torque": 0.2222},
        **{"peak_utilisation": 0.952, "servo_sag": 0.011555},
    }
    assert {key: found[key] for key in found if key not in numbers} == words
    assert {key: found[key] for key in numbers} == pytest.approx(numbers)


def test_leg_with_one_joint_has_no_thigh_length() -> None:
    stub = Stub(**{**vars(ANALYSIS), "thigh_length": None})
    text = " ".join(print_words(comparison.analysis_document(stub)))
    assert "thigh -, calf 112.2 mm" in text


def test_stance_document_states_why_a_stance_fails() -> None:
    failing = stance(
        passed=False,
        verification=run(0.0, passed=False),
        stand=STAND,
        settled=None,
        unsettled=problem("why"),
        verdict=judge_stance(run(0.0, passed=False), None, SERVOS),
        minimum_stiffness=None,
        servos=None,
        soft_servos=None,
        presses=(),
    )
    text = " ".join(print_words(stance_document(failing)))
    assert text.startswith(
        "FAILS stub: FAILS in MuJoCo: it sank "
        "largest motor load 0.22 N m = 95.2 % of the limit (knee) "
        "without feed-forward, no sag is predicted: why"
    )
    assert "base on rigid" in text
    assert "with compensated contact penetration is out of reach: simulated with the joint" in text
    assert "HOLDS" not in text


def test_report_of_a_stance_states_sag_and_height_once() -> None:
    """Two lines stated the sag, as 7.4 and 7.39 mm, and two the height of the base."""
    document = stance_document(stance())
    lines = [get_english(line_text) for line_text in (*document.findings, *document.details)]
    assert sum("settles" in line for line in lines) == 1
    assert sum("104.4 mm" in line for line in lines) == 1


@dataclass(frozen=True, eq=False)
class FootWear(Result):
    """Wear of feet: a result with a document of its own, as in docs/how-to/write-a-tool.md."""

    name: str
    rates: dict[str, float]
    time: np.ndarray
    depth: dict[str, np.ndarray]
    passed: bool


def make_wear_document(wear: FootWear, _: object = None) -> Document:
    """Create a document with a table [mm/h] and a plot [mm] over time [h]."""
    table = Table(
        Text("Wear of the feet", "各足的磨损"),
        (Column(Text("foot", "足"), left=True), Column(Text("wear", "磨损"), "mm/h")),
        tuple((Name(foot), number_cell(rate, ".2f")) for foot, rate in wear.rates.items()),
    )
    axes = Axis(Text("time", "时间"), "h", ".0f"), Axis(Text("depth", "深度"), "mm", ".1f")
    lines = [Series(Name(foot), wear.time, depth) for foot, depth in wear.depth.items()]
    plot = LinePlot(Text("Wear over time", "磨损随时间的变化"), *axes, lines)
    verdict = Text("LASTS", "耐用")
    return Document(Text("Wear", "磨损报告"), Name(wear.name), (table, plot), wear.passed, verdict)


@pytest.fixture
def wear() -> FootWear:
    """Return a result whose document is registered."""
    build_document.register(FootWear, make_wear_document)
    time, rates = np.array([0.0, 10.0, 20.0]), {"FL": 0.25, "RR": 0.75}
    return FootWear("v9", rates, time, {foot: rate * time for foot, rate in rates.items()}, True)


def test_document_of_a_new_result_is_shown_by_each_writer(wear: FootWear, tmp_path: Path) -> None:
    """References: the two rates, in the terminal, in Markdown and in both languages of a page."""
    terminal = printing.printed(wear)
    assert terminal.startswith("LASTS v9")
    assert re.search(r"foot +\(mm/h\)\n─+\nFL +0\.25\nRR +0\.75\n", terminal)
    markdown = write_markdown(build_report([("", wear)]))
    assert "### ✅ LASTS v9" in markdown
    assert "| foot | wear (mm/h) |\n| :--- | ---: |\n| FL | 0.25 |\n| RR | 0.75 |" in markdown
    write_report(wear, tmp_path / "wear.html")
    page = Page((tmp_path / "wear.html").read_text(encoding="utf-8"))
    assert page.tables()["Wear of the feet"][1] == {"foot": "RR", "wear (mm/h)": "0.75"}
    chinese = read_text(page.root.find("body"), "zh")
    for words in ("各足的磨损", "磨损随时间的变化", "足", "深度"):
        assert words in chinese
    lines = [line.get("data-labels") for line in page.root.iter("polyline")]
    assert any("20 h, 15.0 mm" in (labels or "") for labels in lines)


def test_plot_of_a_new_result_is_drawn_as_a_figure(wear: FootWear, tmp_path: Path) -> None:
    """Between 1 and 50 % of the pixels are drawn."""
    (plot,) = (block for block in make_wear_document(wear).blocks if isinstance(block, LinePlot))
    write_plots([plot], tmp_path / "wear.png")
    drawn = imread(tmp_path / "wear.png")[..., :3].min(axis=-1) < 0.9
    assert 0.01 < drawn.mean() < 0.5


def test_joint_error_of_a_slide_is_a_length() -> None:
    """The stub deviates by 0.091 mm; another run deviates at a hinge, by 0.091 mrad."""
    slides = run(0.0, passed=True)
    slides.joint_error_unit = "m"
    assert _joint_error_rows(slides) == ["0.091 mm"]
    assert _joint_error_rows(slides, run(0.0, passed=True)) == ["- 0.0052 °", "0.091 - mm"]
    published = PublishedRun(True, 5.0, 0.5, None, 0.02, False, True, joint_error_unit="m")
    (clause,) = make_published_clauses(Published((published,), (), True))
    assert str(clause.message) == "as published, torques are off by 50 %, a joint by 20 mm"


def _joint_error_rows(*runs: Stub) -> list[str]:
    """Return the printed rows of joint errors, without the name of the quantity."""
    columns = tuple(Column(Name(str(index))) for index in range(len(runs) + 2))
    table = Table(Name("runs"), columns, run_rows(runs, ("joint-error",)))
    lines = printing.printed(Document(Name(""), Name(""), (table,))).splitlines()
    return [
        re.sub(" +", " ", line[len("joint error") :]).strip()
        for line in lines
        if line.startswith("joint error")
    ]


@pytest.mark.parametrize(
    ("mass", "shown"), [(0.57, "0.57 kg"), (0.579, "0.57 kg"), (2.28999999, "2.28 kg")]
)
def test_largest_payload_is_rounded_down(mass: float, shown: str) -> None:
    """Reference: decimal digits; 100 * 0.57 is 56.99999999999999."""
    assert loads.mass_text(mass) == Name(shown)
    assert round_down(0.57, 2) == 0.57
    assert round_down(0.579, 2) == 0.57


@pytest.mark.parametrize("scale", [1e-322, 1e-307, 1e-9, 1e-3, 1.0, 1e5, 1e307])
@pytest.mark.parametrize("digits", [2, 3, 4])
def test_limits_are_rounded_down_to_significant_digits(scale: float, digits: int) -> None:
    """Reference: Python's exact decimal arithmetic; 0 and infinity have no digits."""
    random = np.random.default_rng(7)
    for limit in scale * 10 ** random.uniform(-1, 1, 40):
        exact = Decimal(float(limit))
        step = Decimal(1).scaleb(exact.adjusted() + 1 - digits)
        assert round_down(limit, digits) == float(exact // step * step)
    assert round_down(0.0, digits) == 0.0
    assert round_down(np.inf, digits) == np.inf


def test_restricted_verdict_has_a_short_form_that_leaves_room_for_the_answer() -> None:
    """With the format of the only file, the long form has 48 characters."""
    word = qualify_verdict_word("HOLDS with feed-forward", "mjcf")
    assert word.en == "HOLDS only with gravity compensation (URDF only)"
    assert word.short == "HOLDS if compensated (URDF only)"
    assert word.short_zh == "仅在有重力补偿时保持稳定（仅据 URDF）"
    assert qualify_verdict_word("HOLDS with feed-forward", "").short == ""


@pytest.mark.parametrize(
    ("key", "converted", "english", "chinese"),
    [
        ("HOLDS", "mjcf", "HOLDS (URDF only; ideal servos)", "保持稳定（仅据 URDF；理想伺服）"),
        ("HOLDS", "", "HOLDS (ideal servos)", "保持稳定（理想伺服）"),
        ("FAILS", "mjcf", "FAILS", "未能保持"),
    ],
)
def test_good_verdict_states_ideal_servos(
    key: str, converted: str, english: str, chinese: str
) -> None:
    word = qualify_verdict_word(key, converted, ideal_servos=True)
    assert (get_english(word), word.zh) == (english, chinese)


@pytest.mark.parametrize(
    ("key", "ideal", "english", "chinese"),
    [
        (
            "HOLDS",
            True,
            "HOLDS (URDF only; ideal servos; placeholder limits)",
            "保持稳定（仅据 URDF；理想伺服；占位力矩上限）",
        ),
        (
            "HOLDS",
            False,
            "HOLDS (URDF only; placeholder limits)",
            "保持稳定（仅据 URDF；占位力矩上限）",
        ),
        ("FAILS", False, "FAILS", "未能保持"),
    ],
)
def test_good_verdict_states_placeholder_limits(
    key: str, ideal: bool, english: str, chinese: str
) -> None:
    """solo12 states 1000 N m at each joint: a load of 0.07 % of it has no meaning."""
    word = qualify_verdict_word(key, "mjcf", ideal_servos=ideal, placeholder_limits=True)
    assert (get_english(word), word.zh) == (english, chinese)
    alone = qualify_verdict_word("HOLDS", "", placeholder_limits=True)
    assert get_english(alone) == "HOLDS (placeholder limits)"


def test_verdict_on_placeholder_limits_states_them() -> None:
    remark = diagnose("rests-on-placeholder-efforts", joints=["knee"], count=1)
    verdict = judge_stance(run(0.0, passed=True), None, SERVOS, remarks=(remark,))
    assert get_english(verdict_word(verdict)) == "HOLDS (placeholder limits)"
