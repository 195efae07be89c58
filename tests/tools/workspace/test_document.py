"""Document of a workspace: texts of intervals and of their limits."""

from __future__ import annotations

import io
from types import SimpleNamespace

import pytest

import pupper_analysis as pa
from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.present.document import NextStep, get_english
from pupper_analysis.present.plots import Canvas
from pupper_analysis.present.terminal import SafeConsole, print_head
from pupper_analysis.tools.workspace.document import (
    _abbreviate_limits,
    _format_rounded_range,
    plot_workspace,
    workspace_document,
)
from tests.support.stubs import workspace


def test_height_without_range_is_not_printed_as_symmetric_about_zero() -> None:
    """Reference: an interval of heights from 0.0951 m to 0.0951 m, which does not contain 0."""
    result = workspace()
    result.intervals["height"] = SimpleNamespace(low=0.0951, high=0.0951)
    ranges = get_english(workspace_document(result).findings[0])
    assert "height 95.1 to 95.1 mm" in ranges
    assert "±95.1" not in ranges


def test_files_with_different_com_are_reported_before_the_limits() -> None:
    result = workspace()
    urdf, mjcf = Quantity(4.664, "kg"), Quantity(3.17, "kg")
    distance = Quantity(0.0075, "m")
    result.mismatch = diagnose("range-of-two-robots", urdf=urdf, mjcf=mjcf, distance=distance)
    head = io.StringIO()
    print_head(SafeConsole(file=head, width=100), workspace_document(result))
    words = "the files describe two robots: URDF 4.664 kg, MJCF 3.170 kg, CoM 7.5 mm apart"
    assert head.getvalue().splitlines()[1].startswith(f"  {words}")
    assert workspace_document(result).next_step == NextStep("crosscheck")


def test_limits_of_each_direction_are_listed_with_their_links() -> None:
    """Reference: the links of each limit. Only those of the first direction were printed."""
    result = workspace()
    ground = [diagnose("workspace-ends-at-ground", links=(link,)) for link in ("belly", "calf")]
    pairs = [
        diagnose("workspace-ends-at-links", links=links)
        for links in (("calf", "thigh"), ("foot", "belly"))
    ]
    result.limits = {"height": (ground[0], pairs[0]), "roll": (ground[1], pairs[1])}
    result.limits["x"] = (ground[0], pairs[0])
    limits = (
        "ground clearance (belly, calf) in height, roll, x; "
        "clearance between links (calf, thigh) in height, x; "
        "clearance between links (foot, belly) in roll"
    )
    assert limits in get_english(workspace_document(result).findings[1])


def test_short_answer_has_one_unit_for_lengths_and_one_for_angles() -> None:
    """The line of all directions with a unit each had 150 characters."""
    result = workspace()
    result.intervals["yaw"] = SimpleNamespace(low=-0.5, high=0.5)
    result.limits["yaw"] = result.limits["roll"][:1]
    head = io.StringIO()
    print_head(SafeConsole(file=head, width=200), workspace_document(result))
    answer, limits = head.getvalue().splitlines()[:2]
    by_direction = "joints and reach (all but yaw), joints (yaw)"
    assert limits == f"  torques, collisions not tested; limits: {by_direction}"
    assert answer.startswith("RANGE stub: height 92..192, x ")
    assert " mm; roll " in answer
    assert answer.count(" mm") == answer.count(" deg") == 1
    assert answer.endswith("yaw ±28 deg")


def test_plot_has_a_bar_per_direction_between_its_ends() -> None:
    """Reference: the ends of the intervals, in mm and in degrees."""
    pytest.importorskip("matplotlib").use("Agg")
    result = workspace()
    lengths, angles = plot_workspace(result, None, Canvas())
    assert lengths.get_xlabel().endswith("(mm)")
    assert angles.get_xlabel().endswith("(deg)")
    names = [label.get_text() for label in lengths.get_yticklabels()]
    for name, bar in zip(names, lengths.patches, strict=True):
        interval = result.intervals[name]
        ends = bar.get_x(), bar.get_x() + bar.get_width()
        assert ends == pytest.approx((1e3 * interval.low, 1e3 * interval.high))
    figure = lengths.figure
    figure.draw_without_rendering()
    for words in (*lengths.texts, *angles.texts):
        extent = words.get_window_extent()
        assert words.axes.bbox.x0 < extent.x0 < extent.x1 < figure.bbox.x1  # beside the names
    pytest.importorskip("matplotlib.pyplot").close(figure)


def test_limits_that_are_too_wide_are_abbreviated() -> None:
    """Reference: the line has 100 columns, of which 42 precede the limits."""
    ends = [diagnose(f"workspace-ends-at-{reason}") for reason in ("reach", "support", "full-turn")]
    names = ("height", "x", "y", "roll", "pitch", "yaw")
    result = SimpleNamespace(limits=dict.fromkeys(names, (ends[0], ends[0])))
    result.limits |= {"x": (ends[1], ends[1]), "roll": (ends[2], ends[2])}
    expected = "reach (all but x, roll), support (x), end of search (roll)"
    assert _abbreviate_limits(result, "en") == expected
    chinese = "可达范围（除 x 方向、横滚 外全部），支撑多边形（x 方向），全部范围（横滚）"
    assert _abbreviate_limits(result, "zh") == chinese
    result.limits["y"] = result.limits["x"]
    expected = "support (x, y), end of search (roll), else reach"
    assert _abbreviate_limits(result, "en") == expected
    assert _abbreviate_limits(result, "zh").startswith("支撑多边形（x 方向、y 方向），全部范围")
    ground = diagnose("workspace-ends-at-ground", links=("foot",))
    result.limits["pitch"] = (ends[0], ground)
    assert (
        _abbreviate_limits(result, "en")
        == "reach, support, end of search, ground (by direction: -v)"
    )


def test_ends_of_short_ranges_are_within_reach() -> None:
    """By hand. 191.9 mm must not become 192 mm, a height that is refused."""
    for low, high, expected in (
        (79.02, 191.9, "79..191"),
        (-90.6, 82.7, "-90..82"),
        (-47.9, 47.9, "±47"),
        (-0.4, 0.4, "0..0"),
        (95.1, 95.2, "95..95"),
    ):
        assert _format_rounded_range(low, high) == expected


def test_base_that_turns_to_the_end_of_the_search_is_searched_with_link_clearance() -> None:
    """A base that rolls by 180 degrees on planted feet has its legs in its trunk.

    With a stated clearance, the links cannot intersect, and the text does not mention them.
    """
    result = workspace()
    assert workspace_document(result).next_step == NextStep("best", ("margin",))
    end = diagnose("workspace-ends-at-full-turn")
    result.limits["roll"] = (end, end)
    document = workspace_document(result)
    assert document.next_step == NextStep("workspace", ("--self-clearance", "5mm"))
    assert "links may intersect" in get_english(document.findings[1])
    cleared = SimpleNamespace(**vars(result.start))  # other tests use the same stub
    cleared.task = pa.StandTask(self_clearance=0.005)
    result.start = cleared
    document = workspace_document(result)
    assert document.next_step == NextStep("best", ("margin",))
    assert "links may intersect" not in get_english(document.findings[1])


def test_missing_masses_precede_the_limits() -> None:
    result = workspace()
    result.passed = False
    result.missing_masses = diagnose("link-masses-unknown", links=["FL_thigh"], count=1)
    document = workspace_document(result)
    assert get_english(document.verdict) == "UNKNOWN"
    assert "FL_thigh" in get_english(document.findings[1])
    assert document.next_step == NextStep("audit")
