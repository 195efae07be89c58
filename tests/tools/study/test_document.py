"""Results of a study and their page: each number equals that of the table, in its own column."""

from __future__ import annotations

import math
import re
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import pupper_analysis as pa
from pupper_analysis.present.document import LinePlot, Report, Table, get_english
from pupper_analysis.present.documents.registry import build_report
from pupper_analysis.present.html.write import render_page
from pupper_analysis.present.markdown import write_markdown
from pupper_analysis.tools.study import document
from pupper_analysis.tools.study.document import study_document
from pupper_analysis.tools.study.outcome import Failures, MetricSummary, compute_main_effects
from tests.present.test_html import EVIL
from tests.support.commands import answer
from tests.support.html_page import Page, read_text
from tests.support.repository import ROOT

VARY = {"leg_scale": [0.8, 1.0, 1.2], "kp": [5.0, 10.0], "height": [0.12, 0.15, 0.5]}
METRICS = ["peak_utilisation", "servo_sag", "com_margin", "stands"]


@cache
def outcome() -> pa.study.StudyOutcome:
    """Return the outcome of 18 designs, a third of which are out of reach."""
    import tempfile

    study = pa.Study("v3", VARY, METRICS)
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(1) as thread:
        study.run(folder, executor=thread)
        return pa.study.study_outcome(study, folder, minimise=["peak_utilisation", "servo_sag"])


# The outcome


@pytest.mark.slow
def test_study_report_counts_equal_the_table() -> None:
    found = outcome()
    table = found.table
    assert len(table) == found.designs == 18
    assert sum(failure.designs for failure in found.failures) == table["failure"].notna().sum() >= 6
    unreachable = next(failure for failure in found.failures if failure.kind == "unreachable")
    assert unreachable.designs == 6  # of one height
    assert unreachable.share == pytest.approx(1 / 3)
    assert "500.0 mm" in unreachable.reason
    sag = next(
        metric_result for metric_result in found.measured if metric_result.metric == "servo_sag"
    )
    known = table["servo_sag"].dropna()
    assert (sag.minimum, sag.median, sag.maximum) == (known.min(), known.median(), known.max())
    assert sag.designs == len(known) == 12
    assert sag.unit == "m"
    assert found.robot == "v3"


@pytest.mark.slow
def test_front_contains_only_standing_designs() -> None:
    found = outcome()
    assert found.objectives == {"peak_utilisation": "min", "servo_sag": "min"}
    assert (found.front["stands"] == 1).all()
    expected = pa.study.pareto_front(found.table[found.table["stands"] == 1], found.objectives)
    pd.testing.assert_frame_equal(found.front, expected)


def test_main_effects_on_a_full_grid_equal_the_closed_form(tmp_path: Path) -> None:
    """Reference: y = a + 2 a b with a and b from 0 to 1: main effects in the ratio 4 to 1, and
    an interaction of 4 / 36."""
    axes = np.array([0.0, 0.5, 1.0])
    a, b = (values.ravel() for values in np.meshgrid(axes, axes))
    table = pd.DataFrame({"a": a, "b": b, "y": a + 2 * a * b})
    shares = compute_main_effects(table, ("a", "b"), "y", sampled=False)
    # By hand: y = (a + 2 a b), means over b: 2 a; over a: 1/2 + b; variances of the axes are 1/6.
    variance = float(table["y"].var(ddof=0))
    assert shares == pytest.approx({"a": 4 / 6 / variance, "b": 1 / 6 / variance}, rel=1e-12)
    assert 1 - sum(shares.values()) == pytest.approx(4 / 36 / variance, rel=1e-12)
    study = pa.Study("v3", {"kp": [4.0, 8.0], "leg_scale": [0.9, 1.1]}, ["servo_sag"])
    found = study_with(tmp_path, study)
    (sag,) = found.measured
    assert sag.interaction == pytest.approx(1 - sum(sag.main_effects.values()), abs=1e-12)
    assert sag.main_effects["kp"] > sag.main_effects["leg_scale"] > 0.05
    missing = replace(found, measured=(replace(sag, designs=3, interaction=None),))
    rows = [write_markdown(Report("", (study_document(outcome),))) for outcome in (found, missing)]
    assert "interaction" in rows[0]
    assert "4 of 4" in rows[0]
    assert "3 of 4" in rows[1]


@pytest.mark.slow
@pytest.mark.parametrize("height", [0.15, 0.5])
def test_verdict_of_a_study_report_agrees_with_the_exit_status(
    tmp_path: Path, height: float
) -> None:
    """The second height is out of reach, so that no design has a value of the metric."""
    file, page = tmp_path / "study.toml", tmp_path / "study.html"
    file.write_text(f'robot = "v3"\nmeasure = ["servo_sag"]\n[vary]\nheight = [{height}]\n')
    given = ["study", str(file), "-o", str(tmp_path / "out"), "--report", str(page)]
    measured = height == 0.15
    assert answer(*given, "--workers", "1").returncode == (0 if measured else 1)
    badges = Page(page.read_text(encoding="utf-8")).root.xpath(
        "//span[starts-with(@class, 'verdict')]"
    )
    expected = "verdict good" if measured else "verdict bad"
    assert {badge.get("class") for badge in badges} == {expected}


def study_with(tmp_path: Path, study: pa.Study, **options: list[str]) -> pa.study.StudyOutcome:
    with ThreadPoolExecutor(1) as thread:
        study.run(tmp_path / "there", executor=thread)
    return pa.study.study_outcome(study, tmp_path / "there", **options)


# The page


@cache
def outcome_page() -> Page:
    """Return the page of the outcome."""
    return Page(render_page(build_report([("", outcome())])))


@pytest.mark.slow
def test_page_has_the_numbers_of_the_table_in_their_columns() -> None:
    """Reference: the table of the outcome. Metrics are in mm and %, variables as in the file."""
    found, tables = outcome(), outcome_page().tables()
    designs = tables["Designs"]
    assert len(designs) == 18
    for row, (_, design) in zip(designs, found.table.iterrows(), strict=True):
        assert float(row["leg_scale"]) == design["leg_scale"]
        assert float(row["height (m)"]) == design["height"]
        if np.isfinite(design["servo_sag"]):
            sag, share = 1e3 * design["servo_sag"], 100 * design["peak_utilisation"]
            assert float(row["servo_sag (mm)"]) == pytest.approx(sag, rel=1e-4)
            assert float(row["peak_utilisation (%)"]) == pytest.approx(share, rel=1e-4)
        else:
            assert row["servo_sag (mm)"] == "-"
            assert row["failure"] == design["failure"]
    failed = {row["failure"]: row for row in tables["Failed designs by kind of failure"]}
    assert failed["unreachable"]["designs (–)"] == "6"
    assert failed["unreachable"]["share (–)"].startswith("33.3%")
    assert "18 designs, 6 failed" in outcome_page().shown()
    values = {row["metric"]: row for row in tables["Metrics"]}
    sags = 1e3 * found.table["servo_sag"].dropna()
    for column, value in (("least", sags.min()), ("median", sags.median()),
                          ("greatest", sags.max())):  # fmt: skip
        assert float(values["servo_sag (mm)"][column]) == pytest.approx(value, rel=1e-4)


@pytest.mark.slow
def test_page_has_each_main_effect_beside_its_variable() -> None:
    found = outcome()
    effects = next(
        rows for title, rows in outcome_page().tables().items() if title.startswith("Sensitivity")
    )
    (sag,) = (
        metric_result for metric_result in found.measured if metric_result.metric == "servo_sag"
    )
    assert len({f"{share:.1%}" for share in sag.main_effects.values()}) == len(sag.main_effects)
    for name, share in sag.main_effects.items():
        (row,) = (r for r in effects if (r["metric"], r["parameter"]) == ("servo_sag", name))
        assert row["alone (–)"].startswith(f"{share:.1%}")


@pytest.mark.slow
def test_reason_of_a_failure_is_in_both_languages() -> None:
    """The reason of an older version, which kept the English text only, stays as it is."""
    found = outcome()
    old = replace(found, failures=(replace(found.failures[0], diagnostic=None),))
    for one, chinese in ((found, "站姿不可达"), (old, "stance out of reach")):
        (row,) = (
            row
            for row in Page(render_page(build_report([("", one)]))).root.iter("tr")
            if "stance out of reach" in read_text(row, "en")
        )
        assert chinese in read_text(row, "zh")


@pytest.mark.slow
def test_markup_in_the_names_of_a_study_is_escaped() -> None:
    """Names of the robot, of variables and metrics, and reasons of failures."""
    found = outcome()
    names = {"leg_scale": EVIL[0], "kp": EVIL[1], "servo_sag": EVIL[2]}
    evil = replace(
        found,
        robot=EVIL[0],
        table=found.table.rename(columns=names),
        front=found.front.rename(columns=names),
        variables={names.get(name, name): given for name, given in found.variables.items()},
        objectives={names.get(name, name): sense for name, sense in found.objectives.items()},
        measured=tuple(
            replace(metric_result, metric=names.get(metric_result.metric, metric_result.metric))
            for metric_result in found.measured
        ),
        failures=tuple(
            replace(failure, kind=EVIL[1], reason=EVIL[0]) for failure in found.failures
        ),
    )
    page = Page(render_page(build_report([("", evil)])))
    assert len(page.strict.scripts) == len(outcome_page().strict.scripts)
    assert "img" not in {tag for tag, _ in page.strict.tags}
    assert not [a for _, a in page.strict.tags for name in a if name.startswith("on")]
    for name in EVIL[:3]:
        assert name in page.shown()


@pytest.mark.parametrize(
    ("failed", "values", "verdict"),
    [(2, 0, "NONE MEASURED"), (1, 1, "MEASURED"), (2, 1, "MEASURED"), (0, 2, "MEASURED")],
)
def test_verdict_of_a_study_states_whether_a_design_has_values(
    failed: int, values: int, verdict: str
) -> None:
    """A failed design may have values of metrics that need no servos."""
    table = pd.DataFrame({"design": ["a", "b"], "kp": [1.0, 2.0], "m": [math.nan] * 2})
    summary = MetricSummary("m", "1", 0.0, 0.0, 0.0, values, {}, None)
    failures = (Failures("unreachable", None, failed, failed / 2, "far", None),) * bool(failed)
    found = pa.study.StudyOutcome(
        "v3", "", (), {"kp": {"values": [1.0, 2.0]}}, table, {}, 2, (summary,), failures, {},
        table[:0], {}, 0,
    )  # fmt: skip
    title = study_document(found).verdict
    assert title is not None
    assert get_english(title) == verdict
    assert found.is_measured == (verdict == "MEASURED")


def test_extreme_designs_with_equal_values_have_the_shared_variables() -> None:
    """Reference: the table. The smallest value does not depend on kp; the largest does."""
    table = pd.DataFrame(
        {
            "design": ["a", "b", "c", "d"],
            "scale": [0.8, 0.8, 1.0, 1.0],
            "kp": [5.0, 10.0, 5.0, 10.0],
            "m": [1.0, 1.0, 2.0, 3.0],
        }
    )
    found = pa.study.StudyOutcome(
        "v3", "", (), {"scale": {"values": [0.8, 1.0]}, "kp": {"values": [5.0, 10.0]}}, table,
        {"kp": "N m/rad"}, 4, (MetricSummary("m", "1", 1.0, 1.5, 3.0, 4, {}, None),), (), {},
        table[:0], {}, 0,
    )  # fmt: skip
    line = study_document(found).findings[1]
    expected = "m: 1 to 3; smallest at scale 0.8, any kp, largest at scale 1, kp 10"
    assert get_english(line) == f"{expected} N m/rad"
    assert get_english(study_document(found).findings[0]) == "4 designs, none failed"
    table["stands"] = [1.0, 1.0, 0.0, math.nan]
    count = study_document(found).findings[0]
    assert get_english(count) == "4 designs, none failed; 2 of 4 stand"
    table["m"] = [1.0, 3.0, 3.0, 1.0]
    line = study_document(found).findings[1]
    assert "smallest in 2 designs with different values" in get_english(line)


@pytest.mark.slow
def test_study_of_one_design_without_failure_has_a_page(tmp_path: Path) -> None:
    """No spread, no objectives, no failures."""
    study = pa.Study("v3", {"kp": [8.0]}, ["com_margin"])
    with ThreadPoolExecutor(1) as thread:
        study.run(tmp_path / "study", executor=thread)
    one = pa.study.study_outcome(study, tmp_path / "study")
    assert one.objectives == {}
    page = Page(render_page(build_report([("", one)])))
    assert "1 design, none failed" in page.shown()
    assert {*page.tables()} == {"Metrics", "Designs"}


@pytest.mark.slow
def test_pareto_front_is_plotted_and_listed() -> None:
    """Both objectives in % and mm, as in other commands, and the number of each design."""
    found = outcome()
    document = study_document(found)
    (plot,) = (block for block in document.blocks if isinstance(block, LinePlot))
    (line,) = plot.series
    np.testing.assert_allclose(line.x, 100 * found.front["peak_utilisation"], rtol=1e-14)
    np.testing.assert_allclose(line.y, 1e3 * found.front["servo_sag"], rtol=1e-14)
    assert [axis.unit for axis in (plot.x, plot.y)] == ["%", "mm"]
    (table,) = (block for block in document.blocks if "Pareto" in str(getattr(block, "title", ""))
                and isinstance(block, Table))  # fmt: skip
    numbers = [found.table["design"].tolist().index(design) + 1 for design in found.front["design"]]
    assert [row[0].value for row in table.rows] == numbers
    sags = [row[2].value for row in table.rows]
    assert sags == pytest.approx((1e3 * found.front["servo_sag"]).tolist())


@pytest.mark.slow
def test_study_command_writes_its_report(tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text(
        'robot = "v3"\nmeasure = ["servo_sag", "peak_utilisation"]\n'
        "[vary]\nleg_scale = [1.0, 1.1]\nkp = [5, 10]\n"
    )
    options = ("study", "s.toml", "-o", "out", "--workers", "1")
    refused = answer(*options, "--maximise", "leg", folder=tmp_path)
    assert refused.returncode == 2
    assert (
        "no column 'leg'; columns of the study: servo_sag, peak_utilisation, leg_scale, kp"
        in refused.stderr
    )
    assert not (tmp_path / "out").exists()
    objectives = ("--maximise", "leg_scale", "--minimise", "servo_sag")
    done = answer(*options, *objectives, "--report", "r.html", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    page = Page((tmp_path / "r.html").read_text())
    assert any("servo_sag (min), leg_scale (max)" in title for title in page.tables())


@pytest.mark.slow
def test_page_lists_the_first_of_many_designs() -> None:
    """Of 30 x 18 designs, 300 are listed."""
    many = pd.concat([outcome().table] * 30, ignore_index=True)
    one = replace(outcome(), table=many, designs=len(many))
    page = Page(render_page(build_report([("", one)])))
    assert len(page.tables()["Designs"]) == 300
    assert "240 more designs are in the folder of the study" in page.shown()


@pytest.mark.slow
def test_page_of_a_study_is_in_both_languages() -> None:
    """Without names and quoted text, the English page has no Chinese text; titles have both."""
    root = outcome_page().root.find("body")
    for element in [e for e in root.iter() if (e.get("class") or "") in ("name", "said")]:
        element.clear(keep_tail=True)
    root.find(".//button[@id='language']").text = ""
    assert not re.search(r"[\u4e00-\u9fff]", read_text(root, "en"))
    for tag in ("h1", "h3", "summary"):
        for title in (read_text(heading, "zh") for heading in root.iter(tag)):
            assert not title or re.search(r"[\u4e00-\u9fff]", title), title


@pytest.mark.slow
def test_outcome_of_unknown_objectives_or_without_designs_is_refused(tmp_path: Path) -> None:
    study, folder = pa.Study("v3", {"kp": [5.0, 10.0]}, ["sag"]), tmp_path / "study"
    with pytest.raises(pa.StudyError, match="not the folder of a study"):
        pa.study.study_outcome(study, tmp_path)
    with ThreadPoolExecutor(1) as thread:
        study.run(folder, executor=thread)
    with pytest.raises(
        pa.ConfigurationError, match="no column 'mass'; columns of the study: sag, kp"
    ):
        pa.study.study_outcome(study, folder, minimise=["mass"])
    with pytest.raises(pa.ConfigurationError, match="once"):
        pa.study.study_outcome(study, folder, minimise=["sag"], maximise=["sag"])
    with pytest.raises(pa.ConfigurationError, match="no design of this study yet"):
        pa.study.study_outcome(pa.Study("v3", {"kp": [6.0, 11.0]}, ["sag"]), folder)


@pytest.mark.slow
def test_outcome_of_one_file_states_the_converted_file(tmp_path: Path) -> None:
    files = {"base": str(ROOT / "mjcf" / "pupper_v3.xml"), "keyframe": "home"}
    study = pa.Study(files, {"payload": [0.0]}, ["peak_utilisation"])
    with ThreadPoolExecutor(1) as thread:
        study.run(tmp_path, executor=thread)
    one = pa.study.study_outcome(study, tmp_path)
    assert (one.robot, one.converted) == ("pupper_v3.xml", "urdf")
    assert "from a single file" in write_markdown(build_report([("", one)]))


def test_best_design_is_named_in_the_units_of_the_tables() -> None:
    """12.8 % and 11.71 mm in the tables were 0.128 and 0.01171 m in the first line."""
    design = pd.Series({"kp": 5.0, "peak_utilisation": 0.128, "servo_sag": 0.01171})
    units = {"kp": "N m/rad", "peak_utilisation": "1", "servo_sag": "m"}
    words = document._format_design(design, units)
    assert words == "kp 5 N m/rad, peak_utilisation 12.8 %, servo_sag 11.71 mm"
