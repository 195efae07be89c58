"""``Result.plot``: axes and data of new figures, and results without plots."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import pupper_analysis as pa
from pupper_analysis.base.results import Result
from pupper_analysis.present.document import (
    Axis,
    BarPlot,
    LinePlot,
    Name,
    Plot,
    Series,
    get_english,
)
from pupper_analysis.present.figures.drawing import make_plots_figure
from pupper_analysis.present.figures.pose import make_skeleton_figure
from pupper_analysis.present.html.plots import round_ticks
from pupper_analysis.present.plots import Canvas, draw_plots, make_figure_title
from tests.support.arm import load_arm
from tests.support.engines import with_efforts
from tests.support.repository import ROOT
from tests.support.stubs import REPORTS
from tests.support.variants import load, stand_of


@dataclass(frozen=True, eq=False)
class Fixed(Result):
    """Result without a document."""

    value: float


@pytest.fixture(autouse=True)
def headless(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    plt.switch_backend("agg")
    yield
    plt.close("all")


def test_plot_of_a_stand_has_the_two_views_of_its_figure() -> None:
    """Reference: Pinocchio's CoM [m] in the view from above."""
    robot, stand = load("v3"), stand_of("v3")
    axes = stand.plot(robot)
    titles = [panel.get_title(loc="left") for panel in axes]
    assert titles == ["from the front, forces up to 7.77 N", "from above"]
    assert axes[0].figure.number in plt.get_fignums()  # notebooks show figures of pyplot
    com = pa.Configuration(robot, stand.qpos).center_of_mass()
    # From above, +x is up and +y is left.
    places = np.array([line.get_xydata() for line in axes[1].lines if len(line.get_xydata()) == 1])
    assert np.linalg.norm(places[:, 0] - [-com[1], com[0]], axis=1).min() < 1e-9


@pytest.mark.parametrize("junk", [3, "v3", object()])
def test_plot_for_no_robot_names_the_valid_inputs(junk: object) -> None:
    """The argument of ``plot`` is often taken for the axes to draw in."""
    stand = stand_of("v3")
    statics = pa.gravity_compensation(pa.Configuration(load("v3"), stand.qpos))
    for result in (stand, statics):
        with pytest.raises(pa.ConfigurationError, match=r"not a Robot.*returns the Axes"):
            result.plot(junk)
    assert not plt.get_fignums()


def test_plot_of_a_comparison_contains_each_deviation() -> None:
    """Reference: deviations and tolerance of the comparison, on a logarithmic axis."""
    files = [
        ROOT / folder / f"pupper_v3.{kind}" for folder, kind in (("urdf", "urdf"), ("mjcf", "xml"))
    ]
    comparison = pa.compare_models(*files, configurations=2)
    (axes,) = comparison.plot()
    drawn = {value for line in axes.lines for value in np.asarray(line.get_xdata()) if value > 0}
    expected = {
        value
        for quantity in comparison.check.quantities
        for value in quantity.edge_deviations.values()
    }
    assert drawn == {*filter(None, expected), comparison.check.tolerance}
    assert axes.get_xscale() == "log"
    # No mark covers another mark: equal deviations were drawn at the same place.
    places = [place for line in axes.lines[:-1] for place in map(tuple, line.get_xydata())]
    assert len({*places}) == len(places)
    rows = {round(float(place[1])) for place in places}
    assert rows == {*range(len(axes.get_yticklabels()))}


@pytest.mark.slow
def test_plot_of_a_verification_shows_the_height() -> None:
    """Reference: base height of the recorded configurations [mm].

    The axes are in pixels: two tick labels give the scale, and the line of the requested height
    gives the offset.
    """
    stand = stand_of("v3")
    report = pa.verify_stand(load("v3"), stand, feedforward=False, duration=4.0)
    (axes,) = report.plot()
    lines = [np.asarray(line.get_xydata()) for line in axes.lines]
    curve, requested = max(lines, key=len), lines[-1]
    rows = {label.get_text(): label.get_position()[1] for label in axes.texts}
    millimetres = (130 - 120) / (rows["130"] - rows["120"])  # per pixel, negative
    time = np.interp(curve[:, 0], requested[:, 0], (0.0, report.time[-1]))
    height = 1e3 * stand.qpos[2] + (curve[:, 1] - requested[0, 1]) * millimetres
    drawn = np.interp(report.motion_time, time, height)
    # 0.01 mm: pixels have one digit. The first second is left out: the base falls between samples.
    later = report.motion_time > 1.0
    np.testing.assert_allclose(drawn[later], 1e3 * report.motion[later, 2], atol=1e-2)
    assert np.ptp(drawn) > 1.0


def test_plot_of_a_result_names_verdict_robot_and_panels() -> None:
    """Reference: verdict and title of the document; the page's plots, one below the other."""
    document = REPORTS["analysis"]().documents[0]
    plots = [block for block in document.blocks if isinstance(block, Plot)]
    assert get_english(make_figure_title(document)) == "FAILED stub: Analysis"
    figure = make_plots_figure(plots, max_columns=1)
    first, second = (axes.get_subplotspec().rowspan.start for axes in figure.axes)
    assert (first, second) == (0, 1)
    payload = REPORTS["payload"]().documents[0]
    (plot,) = (block for block in payload.blocks if isinstance(block, BarPlot))
    assert [bar.value for bar in plot.bars] == sorted(bar.value for bar in plot.bars)
    assert not make_plots_figure([plot]).axes[0].get_legend()  # it would repeat the axis


def test_ticks_of_angles_are_parts_of_a_turn() -> None:
    """Reference: quarters of a turn, and multiples of 15 deg; short ranges have decimal ticks."""
    assert round_ticks(0.0, 360.0, 6, degrees=True) == [0.0, 90.0, 180.0, 270.0, 360.0]
    assert round_ticks(-40.0, 44.0, 6, degrees=True) == [-30.0, -15.0, 0.0, 15.0, 30.0]
    assert round_ticks(0.0, 4.0, 6, degrees=True) == round_ticks(0.0, 4.0, 6)
    assert round_ticks(0.0, 1000.0, 5, degrees=True) == [0.0, 270.0, 540.0, 810.0]


def test_plot_of_statics_has_a_bar_per_motor_with_its_utilisation() -> None:
    """Reference: joint torques [N m]; utilisation as torque divided by the limit of 3 N m."""
    robot, stand = load("v3"), stand_of("v3")
    statics = pa.stance.stand_statics(robot, stand)
    (axes,) = statics.plot()
    widths = [patch.get_width() for patch in axes.patches]
    np.testing.assert_allclose(widths, statics.joint_torques)
    assert [label.get_text() for label in axes.get_yticklabels()] == list(robot.joint_names)
    expected = [f"{100 * abs(torque) / 3:.0f} %" for torque in statics.joint_torques]
    assert [text.get_text() for text in axes.texts] == expected
    assert axes.get_xlabel().endswith("with the utilisation of the torque limit")
    (named,) = statics.plot(robot)
    figure = named.get_figure()
    assert isinstance(figure, Figure)
    assert figure.get_suptitle() == "v3: static motor torques"
    # With names of 40 letters, the words below the axis were cut.
    named.set_yticks(range(robot.nu), ["x" * 40] * robot.nu)
    figure.draw_without_rendering()
    assert named.xaxis.label.get_window_extent().x1 <= figure.bbox.x1


@pytest.mark.parametrize(
    ("known", "label"),
    [(0, "no torque limit is known"), (3, "with the utilisation of each known torque limit")],
)
def test_plot_of_statics_states_whether_torque_limits_are_known(known: int, label: str) -> None:
    """A known limit is 3 N m; the utilisation of a motor with an unknown limit is NaN."""
    robot, stand = load("v3"), stand_of("v3")
    limits = np.where(np.arange(robot.nu) < known, 3.0, np.inf)
    config = pa.Configuration(with_efforts(robot, limits), stand.qpos)
    (axes,) = pa.gravity_compensation(config).plot()
    assert axes.get_xlabel().endswith(label)
    assert sum(bool(text.get_text()) for text in axes.texts) == known


def test_completion_offers_plot_only_for_results_with_a_plot() -> None:
    """Reference: `plot` itself."""
    stand = stand_of("v3")
    statics = pa.gravity_compensation(pa.Configuration(load("v3"), stand.qpos))
    for shown in (stand, statics):
        assert "plot" in dir(shown)
    for plotless in (
        pa.stance.Interval(0.1, 0.2),
        Fixed(1.0),
        pa.audit_model(ROOT / "urdf" / "pupper_v3.urdf"),
    ):
        assert "plot" not in dir(plotless)
        assert {"to_dict", "to_json"} <= set(dir(plotless))
        with pytest.raises(pa.ConfigurationError, match=f"this {type(plotless).__name__} has no"):
            plotless.plot()


def test_plot_of_pushes_contains_the_impulse_in_each_direction() -> None:
    """Reference: ratios of the impulses [N s] of the result."""
    options = {"directions": 4, "resolution": 1.0, "duration": 2.0}
    pushed = pa.push_recovery(load("v3"), stand_of("v3"), **options)  # type: ignore[arg-type]
    (axes,) = pushed.plot()
    lines = [np.asarray(line.get_xydata()) for line in axes.lines]
    zero = max(line[:, 1].max() for line in lines)  # the vertical axis starts at 0 N s
    heights = [zero - line[:4, 1] for line in lines if len(line) == 5]
    ratios = pushed.impulses / pushed.impulses[0]
    assert any(np.allclose(height / height[0], ratios, rtol=5e-3) for height in heights)


def test_missing_robot_and_result_without_plot_are_refused() -> None:
    stand = stand_of("v3")
    assert len(stand.plot()) == 2  # a solved stand references its robot
    plt.close("all")
    with pytest.raises(pa.ConfigurationError, match=r"result\.plot\(robot\)"):
        pickle.loads(pickle.dumps(stand)).plot()
    with pytest.raises(pa.ConfigurationError):
        stand.plot(load("original"))
    with pytest.raises(pa.ConfigurationError, match="Fixed has no plot"):
        Fixed(1.0).plot()
    assert not plt.get_fignums()


def test_plot_of_a_posture_is_that_of_its_stand_or_its_links(tmp_path: Path) -> None:
    """Reference: CoM [m] of the posture, and the joint axes of MuJoCo's kinematics [m]."""
    robot, stand = load("v3"), stand_of("v3")
    posture = pa.solve_posture(robot, [pa.stance.CoMTask((0, 0, 0.1))], start=stand)
    assert "forces up to" in posture.plot()[0].get_title(loc="left")
    drawn = np.concatenate(
        [line.get_xydata() for line in make_skeleton_figure(robot, stand.qpos).axes[1].lines]
    )
    for x, y, _ in pa.Configuration(robot, stand.qpos).foot_positions().values():
        assert np.linalg.norm(drawn / 1e3 - [-y, x], axis=1).min() < 1e-9
    near = stand.for_task(replace(stand.task, ground_clearance=0.2))
    (message,) = near.blocked
    title = replace(posture, stand=near).plot(robot)[0].figure.get_suptitle()
    assert (
        " ".join(title.split())
        == f"v3: stance and static contact forces on rigid ground; {message}"
    )
    arm = load_arm(tmp_path)
    posture = pa.solve_posture(arm, [pa.stance.JointsTask({arm.joint_names[0]: 0.3})])
    axes = posture.plot()
    data = arm.compute_kinematics(posture.qpos)
    drawn = np.concatenate([line.get_xydata() for line in axes[1].lines])
    for x, y, _ in data.xanchor:
        assert np.linalg.norm(drawn / 1e3 - [-y, x], axis=1).min() < 1e-9
    with pytest.raises(pa.ConfigurationError, match=r"result\.plot\(robot\)"):
        pickle.loads(pickle.dumps(posture)).plot()
    assert posture.stand is not None
    assert len(posture.stand.plot(arm)) == 2


@pytest.mark.parametrize("kind", ["torques", "lines", "bars"])
def test_plot_in_given_axes_opens_no_figure(kind: str) -> None:
    """References: the data of the results; other axes and the size of the figure are unchanged."""
    robot, stand = load("v3"), stand_of("v3")
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 4))
    if kind == "torques":
        statics = pa.stand_statics(robot, stand)
        drawn = statics.plot(ax=right)
        widths = [bar.get_width() for bar in right.patches]
        assert widths == pytest.approx(statics.joint_torques.tolist())
        assert right.get_xlabel().startswith("torque (N m; slides: N)")
        assert right.get_title(loc="left") == "Static motor torques"
    elif kind == "lines":
        run = pa.verify_stand(robot, stand, duration=2.0, nudged=0)
        drawn = run.plot(ax=right)
        line, task = right.lines
        assert line.get_xdata() == pytest.approx(run.time)
        assert line.get_ydata() == pytest.approx(1e3 * run.height)
        assert task.get_ydata() == pytest.approx(1e3 * (run.base_height + run.height_loss))
        assert (right.get_xlabel(), right.get_ylabel()) == ("time (s)", "base height (mm)")
        legend = right.get_legend()
        assert legend is not None
        assert legend.get_texts()[0].get_text().startswith("with feed-forward")
    else:
        (plot,) = (plot for plot in make_bar_plots() if isinstance(plot, BarPlot))
        drawn = draw_plots([plot], Name("bars"), Canvas(axes=right))
        words = [text.get_text() for text in right.texts]
        assert any(text.endswith(f"({plot.axis.unit})") for text in words)
        assert len(right.patches) >= len(plot.bars)
    assert drawn == (right,)
    assert plt.get_fignums() == [figure.number]
    assert tuple(figure.axes) == (left, right)
    assert [*left.lines, *left.patches, *left.texts, *figure.texts, *figure.legends] == []
    assert left.get_title(loc="left") == figure.get_suptitle() == ""
    assert figure.get_size_inches().tolist() == [9, 4]


def make_bar_plots() -> list[Plot]:
    """Return the first bar plot among the documents of the stubs."""
    documents = (document for make in REPORTS.values() for document in make().documents)
    plots = (block for document in documents for block in document.blocks)
    return [next(plot for plot in plots if isinstance(plot, BarPlot))]


def test_lines_in_given_axes_have_the_scales_of_the_plot() -> None:
    """Reference: a line plot with an area, a logarithmic axis, and a point that is not finite."""
    x, y = np.array([1.0, 10.0, 100.0]), np.array([1.0, np.nan, 3.0])
    series = [
        Series(Name("area"), x, np.array([0.5, 4.0, 2.0]), shaded=True),
        Series(Name("line"), x, y, points=True, marked_index=2),
    ]
    axis = Axis(Name("stiffness"), "N m/rad", ".2f", logarithmic=True)
    plot = LinePlot(Name("plot"), axis, Axis(Name("damping"), "1", ".2f", low=0.0), series)
    (panel,) = draw_plots([plot], Name("title"), Canvas(axes=plt.figure().add_subplot()))
    assert (panel.get_xscale(), panel.get_ylim()[0]) == ("log", 0.0)
    line, *points = panel.lines
    assert line.get_xydata().tolist() == [[1.0, 1.0], [100.0, 3.0]]
    assert [point.get_xydata().tolist() for point in points] == [[[1.0, 1.0]], [[100.0, 3.0]]]
    assert points[1].get_markersize() > points[0].get_markersize()
    assert len(panel.patches) == 1
    assert panel.get_xlabel() == "stiffness (N m/rad)"


def test_plot_of_a_comparison_in_given_axes_has_its_legend_there() -> None:
    files = [ROOT / "urdf/pupper_v3.urdf", ROOT / "mjcf/pupper_v3.xml"]
    comparison = pa.compare_models(*files, configurations=2)
    figure, axes = plt.subplots()
    assert comparison.plot(ax=axes) == (axes,)
    assert axes.get_legend() is not None
    assert not figure.legends


def test_plot_in_a_subfigure_keeps_the_other_subfigure_empty() -> None:
    """A stand has two panels, in the left half of the figure."""
    robot, stand = load("v3"), stand_of("v3")
    figure = plt.figure(figsize=(14, 5))
    left, right = figure.subfigures(1, 2)
    panels = stand.plot(robot, figure=left)
    assert tuple(left.axes) == panels
    assert [panel.get_title(loc="left")[:8] for panel in panels] == ["from the", "from abo"]
    assert all(panel.get_position().x1 <= 1.0 for panel in panels)
    assert max(panel.get_window_extent().x1 for panel in panels) < figure.bbox.width / 2
    assert not right.axes
    assert plt.get_fignums() == [figure.number]
    torques = pa.stand_statics(robot, stand).plot(figure=right)
    assert tuple(right.axes) == torques
    assert right.get_suptitle() == "Static motor torques"


def test_plot_in_a_given_figure_keeps_its_size() -> None:
    figure = plt.figure(figsize=(5, 3))
    (axes,) = pa.stand_statics(load("v3"), stand_of("v3")).plot(figure=figure)
    assert figure.axes == [axes]
    assert figure.get_size_inches().tolist() == [5, 3]
    assert figure.get_layout_engine() is not None


@pytest.mark.parametrize("layout", ["tight", "constrained", None])
def test_panels_of_a_stand_are_drawn_without_a_warning_of_the_layout(layout: str | None) -> None:
    """Pytest turns warnings of Matplotlib into errors."""
    figure = plt.figure(figsize=(8, 5), layout=layout)
    panels = stand_of("v3").plot(load("v3"), figure=figure)
    places = [panel.get_position().bounds for panel in panels]
    figure.canvas.draw()
    assert [panel.get_position().bounds for panel in panels] == places


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (lambda axes: {"ax": 3}, "ax: 3 is not an Axes"),
        (lambda axes: {"ax": axes.figure}, "is not an Axes"),
        (lambda axes: {"figure": axes}, "is not a Figure or a SubFigure"),
        (lambda axes: {"ax": axes, "figure": plt.figure()}, "either ax= or figure="),
        (lambda axes: {"figure": axes.figure}, "the figure has axes already"),
        (lambda axes: {"ax": axes}, "several panels: pass figure="),
    ],
)
def test_invalid_axes_or_figure_of_a_plot_are_refused(
    options: Callable[[Axes], dict[str, Any]], message: str
) -> None:
    axes = plt.figure().add_subplot()
    given = options(axes)
    opened = plt.get_fignums()
    with pytest.raises(pa.ConfigurationError, match=message):
        stand_of("v3").plot(load("v3"), **given)
    assert plt.get_fignums() == opened
    assert [*axes.lines, *axes.patches] == []
