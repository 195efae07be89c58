"""Figures that compare robots: the numbers that are drawn, and axes that can be compared."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import matplotlib
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.text import Text

import pupper_analysis as pa
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.present.figures import drawing
from pupper_analysis.tools.analyze import comparison_figures
from pupper_analysis.tools.analyze.analysis import compute_leg_jacobians
from pupper_analysis.tools.analyze.comparison_figures import FIGURES
from tests.support.variants import load, stand_of

CELLS = {"kp": (5.0, 20.0, 60.0), "kd": (0.1, 0.5)}
"""Gains of a small sweep, with v3's own pair."""


@cache
def analysis_of(name: str) -> Any:
    """Return the fields of an analysis that figures read, from short simulations."""
    robot, stand = load(name), stand_of(name)
    limits = zip(robot.joint_names, robot.effort_limits, strict=True)
    config = pa.Configuration(robot, stand.qpos)
    return SimpleNamespace(
        name=name,
        joints=tuple(SimpleNamespace(name=joint, effort=float(limit)) for joint, limit in limits),
        stand=stand,
        statics=pa.gravity_compensation(config),
        foot_jacobians=compute_leg_jacobians(config),
        verification=pa.verify_stand(robot, stand, duration=2.0, nudged=0),
        sagging=pa.verify_stand(robot, stand, duration=2.0, feedforward=False, nudged=0),
        sweep=pa.simulation.sweep_gains(robot, stand, **CELLS, amplitude=0.0, duration=2.0),
    )


def change_analysis(analysis: Any, **fields: Any) -> Any:
    """Return an analysis with other values of some fields."""
    return SimpleNamespace(**{**vars(analysis), **fields})


@pytest.fixture
def figures(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """Return the list to which figures are added instead of being written."""
    kept: list[Figure] = []
    monkeypatch.setattr(drawing, "save_figure", lambda figure, path: kept.append(figure))
    return kept


def panels(figure: Figure) -> list[Axes]:
    """Return the panels of a figure, in the order of the robots."""
    return [axes for axes in figure.axes if axes.get_title(loc="left")]


def limb_styles(figure: Figure) -> dict[str, tuple[Any, Any]]:
    """Return {label: (colour, marker)} of the legs or sides in the legend of a torque figure."""
    (legend,) = figure.legends
    handles = dict(zip((text.get_text() for text in legend.get_texts()), legend.legend_handles,
                       strict=True))  # fmt: skip
    return {
        label: (line.get_color(), line.get_marker())
        for label, line in handles.items()
        if isinstance(line, Line2D) and line.get_color() not in ("0.3", "k") and line.get_marker()
        not in ("None", None, "")
    }  # fmt: skip


@pytest.mark.parametrize("name", FIGURES)
def test_a_figure_is_refused_without_robots(name: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="no robot"):
        FIGURES[name]([], tmp_path / name)


@pytest.mark.slow
@pytest.mark.parametrize("name", FIGURES)
def test_a_figure_of_three_robots_is_written_with_white_edges(name: str, tmp_path: Path) -> None:
    FIGURES[name]([analysis_of(robot) for robot in ("original", "v3", "v3-heavy")], tmp_path / name)
    pixels = imread(tmp_path / name)
    assert pixels.shape[1] == pytest.approx(drawing.PAGE_WIDTH * drawing.FIGURE_DPI, abs=1)
    for edge in (pixels[0], pixels[-1], pixels[:, 0], pixels[:, -1]):
        assert (edge[:, :3] == 1.0).all()  # nothing is cut off


FORMULA = "a$b_c$ $\\frac$ ^"
"""Name that Matplotlib refuses as a formula."""


@pytest.mark.slow
def test_names_of_joints_and_feet_are_written_without_formulas(tmp_path: Path) -> None:
    analysis = analysis_of("v3")
    joints = [SimpleNamespace(name=f"{FORMULA}{joint.name}", effort=joint.effort)
              for joint in analysis.joints]  # fmt: skip
    jacobians = {
        f"{FORMULA}{foot}": SimpleNamespace(
            foot=f"{FORMULA}{one.foot}", joints=[f"{FORMULA}{name}" for name in one.joints]
        )
        for foot, one in analysis.foot_jacobians.items()
    }
    named = change_analysis(analysis, name=FORMULA, joints=joints, foot_jacobians=jacobians)
    FIGURES["torques.png"]([named], tmp_path / "torques.png")
    assert (tmp_path / "torques.png").read_bytes().startswith(b"\x89PNG")


def test_figure_of_a_sweep_in_which_all_gains_fall_states_no_height(
    figures: list[Figure],
) -> None:
    analysis = analysis_of("v3")
    shape = analysis.sweep.height_deviation.shape
    sweep = change_analysis(
        analysis.sweep, height_deviation=np.full(shape, np.inf), lasts=np.zeros(shape, bool)
    )
    FIGURES["gains.png"]([change_analysis(analysis, sweep=sweep)], Path("unused.png"))
    (axes,) = panels(figures[0])
    assert {text.get_text() for text in axes.texts} == {"falls"}


def test_figures_leave_the_settings_of_matplotlib_unchanged(figures: list[Figure]) -> None:
    before = dict(matplotlib.rcParams)
    for write_figure in FIGURES.values():
        write_figure([analysis_of("v3")], Path("unused.png"))
    assert len(figures) == len(FIGURES)
    assert dict(matplotlib.rcParams) == before


def test_height_figure_shows_positive_losses_below_the_task(figures: list[Figure]) -> None:
    """Reference: height of the stand less the simulated heights [mm]; the sign of `height_loss`."""
    analysis = analysis_of("v3")
    FIGURES["heights.png"]([analysis], Path("unused.png"))
    (axes,) = panels(figures[0])
    final = {str(line.get_label()).split(":")[0]: float(np.asarray(line.get_ydata())[-1])
             for line in axes.lines if ":" in str(line.get_label())}  # fmt: skip
    loss = final["position commands only"]
    assert loss == pytest.approx(
        1e3 * (analysis.stand.qpos[2] - analysis.sagging.height[-1]), abs=1e-9
    )
    assert loss > 1.0
    assert analysis.sagging.height_loss > 1e-3
    assert abs(final["with feed-forward"]) < 0.5 * loss
    # The axis points downwards; its name states the sign.
    bottom, top = axes.get_ylim()
    assert bottom > loss > 0 > top
    assert axes.get_ylabel() == "height lost (mm)"


def test_height_figure_names_task_and_nudge(figures: list[Figure]) -> None:
    """Reference: time [s] and speed of the nudge in the simulation. The curve with feed-forward
    lies on the task, and must not hide it: the band of the task is wider.
    """
    robot, stand = load("v3"), stand_of("v3")
    run = pa.verify_stand(robot, stand, duration=2.4)
    assert run.nudge is not None
    FIGURES["heights.png"]([change_analysis(analysis_of("v3"), verification=run)], Path("unused"))
    (legend,) = figures[0].legends
    labels = [text.get_text() for text in legend.get_texts()]
    assert labels == ["task", f"nudge at {run.nudge.time:g} s: velocities up to "
                      f"{run.nudge.speed:g} m/s or rad/s"]  # fmt: skip
    (axes,) = panels(figures[0])
    times = [line.get_xdata() for line in axes.lines if line.get_linestyle() == ":"]
    np.testing.assert_allclose(times, [[run.nudge.time] * 2])
    widths = {str(line.get_label()).split(":")[0]: line.get_linewidth() for line in axes.lines}
    band = max(line.get_linewidth() for line in axes.lines if set(line.get_ydata()) == {0.0})
    assert band >= 3 * widths["with feed-forward"]


def test_torque_figure_draws_the_share_of_the_limit_in_a_row_per_joint_of_a_leg(
    figures: list[Figure],
) -> None:
    """Reference: 100 |tau| / limit of each motor, from the statics and the simulation."""
    analysis = analysis_of("v3")
    efforts = np.linspace(1.0, 3.0, 12)
    limits = [
        SimpleNamespace(name=joint.name, effort=effort)
        for joint, effort in zip(analysis.joints, efforts, strict=True)
    ]
    FIGURES["torques.png"]([change_analysis(analysis, joints=limits)], Path("unused.png"))
    (axes,) = panels(figures[0])
    for markers, torques in (
        ("os^D", analysis.statics.joint_torques),
        ("|", analysis.verification.joint_torques),
    ):
        drawn = [float(np.asarray(line.get_xdata())[0]) for line in axes.lines
                 if line.get_marker() in markers]  # fmt: skip
        np.testing.assert_allclose(sorted(drawn), sorted(100 * np.abs(torques) / efforts))
    assert [label.get_text() for label in axes.get_yticklabels()] == ["leg_1", "leg_2", "leg_3"]
    # Legs differ without colours.
    assert {limb: marker for limb, (_, marker) in limb_styles(figures[0]).items()} == {
        "FL": "o", "FR": "s", "RL": "^", "RR": "D"}  # fmt: skip


def test_torque_figure_has_one_colour_and_name_per_leg_with_several_contact_points(
    figures: list[Figure],
) -> None:
    """A biped with four contact points per foot, a common waist, and a toe on the left leg only.

    The arms have the colours of the legs on their side, and one row for both elbows. The torque of
    a joint is its index, so that a mark is that of the joint.
    """
    names = ("waist", "left_hip", "right_hip", "left_knee", "right_knee", "left_toe", "head",
             "right_elbow", "left_elbow")  # fmt: skip
    legs = {
        "right_sole": ("waist", "right_hip", "right_knee"),
        "left_sole": ("waist", "left_hip", "left_knee", "left_toe"),
    }
    torques = SimpleNamespace(joint_torques=np.arange(9.0), torque_units=("N m",) * 9)
    analysis = SimpleNamespace(
        name="walker",
        joints=[SimpleNamespace(name=name, effort=100.0) for name in names],
        statics=torques,
        verification=torques,
        foot_jacobians={
            f"{foot}_{point}": SimpleNamespace(foot=foot, joints=joints)
            for foot, joints in legs.items()
            for point in range(4)
        },
    )
    FIGURES["torques.png"]([analysis], Path("unused.png"))
    (axes,) = panels(figures[0])
    styles = limb_styles(figures[0])
    assert list(styles) == ["left", "right"]
    left, right = (colour for colour, _ in styles.values())
    assert left != right
    marks = [line for line in axes.lines if line.get_marker() in ("o", "s")]
    colours = {int(np.asarray(line.get_xdata())[0] + 0.5): line.get_color() for line in marks}
    assert colours == {0: "0.3", 1: left, 2: right, 3: left, 4: right, 5: left, 6: "0.3",
                       7: right, 8: left}  # fmt: skip
    rows = [label.get_text() for label in axes.get_yticklabels()]
    assert rows == ["waist", "hip", "knee", "left_toe", "head", "elbow"]


def test_legend_states_the_robots_if_the_names_of_their_limbs_differ(
    figures: list[Figure],
) -> None:
    analysis = analysis_of("v3")
    feet = {"FL": "left_front_foot", "FR": "right_front_foot", "RL": "left_hind_foot",
            "RR": "right_hind_foot"}  # fmt: skip
    jacobians = {
        point: SimpleNamespace(foot=feet[one.foot], joints=one.joints)
        for point, one in analysis.foot_jacobians.items()
    }
    renamed = change_analysis(analysis, name="dog", foot_jacobians=jacobians)
    FIGURES["torques.png"]([analysis, renamed], Path("unused.png"))
    assert list(limb_styles(figures[0])) == [
        "FL (v3), left_front (dog)", "FR (v3), left_hind (dog)",
        "RL (v3), right_front (dog)", "RR (v3), right_hind (dog)"]  # fmt: skip


def test_texts_of_a_torque_figure_with_long_names_do_not_overlap(figures: list[Figure]) -> None:
    """Names as in Go2: the title of a panel covered the names of the feet."""
    analysis = analysis_of("v3")
    jacobians = {
        point: SimpleNamespace(foot=f"{one.foot}_foot", joints=one.joints)
        for point, one in analysis.foot_jacobians.items()
    }
    limits = zip(analysis.joints, [23.7, 23.7, 45.43] * 4, strict=True)
    joints = [SimpleNamespace(name=joint.name, effort=effort) for joint, effort in limits]
    named = change_analysis(
        analysis, name="go2_description", joints=joints, foot_jacobians=jacobians
    )
    FIGURES["torques.png"]([named, named, named], Path("unused.png"))
    (figure,) = figures
    figure.draw_without_rendering()
    texts = [text for text in figure.findobj(Text)
             if text.get_text().strip() and text.get_visible()]  # fmt: skip
    assert {"FL", "FR", "RL", "RR"} <= {text.get_text() for text in texts}
    boxes = [text.get_window_extent() for text in texts]
    page = figure.bbox
    for index, box in enumerate(boxes):
        inside = page.x0 <= box.x0 and box.x1 <= page.x1 and page.y0 <= box.y0 and box.y1 <= page.y1
        assert inside, texts[index].get_text()
        for other, text in zip(boxes[:index], texts, strict=False):
            overlap = min(box.x1, other.x1) > max(box.x0, other.x0) + 1 and min(
                box.y1, other.y1) > max(box.y0, other.y0) + 1  # fmt: skip
            assert not overlap, (text.get_text(), texts[index].get_text())


def test_torque_figure_states_the_torque_of_a_motor_without_limit(figures: list[Figure]) -> None:
    """Reference: largest knee torque [N m] of the statics."""
    analysis = analysis_of("v3")
    limits = [SimpleNamespace(name=joint.name, effort=np.inf) for joint in analysis.joints]
    FIGURES["torques.png"]([change_analysis(analysis, joints=limits)], Path("unused.png"))
    (axes,) = panels(figures[0])
    texts = [text.get_text() for text in axes.texts]
    knee = np.abs(analysis.statics.joint_torques[2::3]).max()
    assert f"{knee:.3f} N m, no limit" in texts


@pytest.mark.slow
def test_panels_of_robots_with_equal_joints_share_axes(figures: list[Figure]) -> None:
    names = ("v3", "original", "v3-heavy")
    for name in ("torques.png", "heights.png"):
        FIGURES[name]([analysis_of(robot) for robot in names], Path("unused.png"))
    torque, height = map(panels, figures)
    assert torque[0].get_xlim() == torque[2].get_xlim() != torque[1].get_xlim()
    assert height[0].get_ylim() == height[2].get_ylim() != height[1].get_ylim()


def test_height_figure_states_the_mean_of_the_last_second(figures: list[Figure]) -> None:
    """Reference: height of the stand less the simulation's mean height in the last second [mm]."""
    analysis = analysis_of("v3")
    FIGURES["heights.png"]([analysis], Path("unused.png"))
    (axes,) = panels(figures[0])
    legend = axes.get_legend()
    assert legend is not None
    sagging = analysis.sagging
    last = sagging.height[sagging.time > sagging.time[-1] - 1.0].mean()
    expected = f"position commands only: {1e3 * (analysis.stand.qpos[2] - last):.2f} mm"
    assert expected in [text.get_text() for text in legend.get_texts()]


@pytest.mark.slow
def test_height_figure_marks_the_first_contact_of_a_robot_that_fails(
    figures: list[Figure],
) -> None:
    """Reference: the simulation's failure with link and time. v3-long-leg sinks onto its shanks
    on its own servos."""
    robot = load("v3-long-leg")
    stand = pa.solve_stand_as_simulated(robot)
    sagging = pa.verify_stand(robot, stand, feedforward=False, duration=12.0)
    contacts = [failure for failure in sagging.failures if failure.code == "body-touches-ground"]
    analysis = change_analysis(
        analysis_of("v3"), stand=stand, verification=sagging, sagging=sagging
    )
    FIGURES["heights.png"]([analysis], Path("unused.png"))
    (axes,) = panels(figures[0])
    shown = " ".join(text.get_text() for text in axes.texts)
    time = min(contact.values["time"].value for contact in contacts)  # type: ignore[union-attr]
    assert f"touch the ground at {time:.2f} s" in shown
    assert contacts[0].subject is not None
    assert contacts[0].subject.name in shown
    # The ring around the point does not reach the axis.
    figure = figures[0]
    figure.draw_without_rendering()
    (ring, *_) = (line for line in axes.lines if line.get_marker() == "o")
    assert ring.get_markerfacecolor() == "none"
    place = axes.transData.transform(np.asarray(ring.get_xydata())[0])
    radius = ring.get_markersize() / 2 * figure.dpi / 72
    assert place[1] - radius > axes.get_window_extent().y0


def test_heat_map_states_each_deviation_on_one_scale_and_marks_falls(
    figures: list[Figure],
) -> None:
    """Cells are at (kd, kp); reference: the numbers of the sweep, in mm."""
    analysis = analysis_of("v3")
    deviation = np.array([[1.5e-3, np.inf], [2e-5, 3e-3], [1e-9, 4e-4]])
    lasts = np.array([[True, False], [True, False], [True, True]])
    sweep = change_analysis(analysis.sweep, height_deviation=deviation, lasts=lasts)
    FIGURES["gains.png"](
        [change_analysis(analysis, sweep=sweep), analysis_of("original")], Path("unused.png")
    )
    first, second = panels(figures[0])
    written = {text.get_position(): text.get_text() for text in first.texts}
    assert written == {(0, 0): "1.5", (1, 0): "falls", (0, 1): "0.02", (1, 1): "3",
                       (0, 2): "<0.0001", (1, 2): "0.4"}  # fmt: skip
    assert [label.get_text() for label in first.get_xticklabels()] == ["0.1", "0.5"]
    assert [label.get_text() for label in first.get_yticklabels()] == ["5", "20", "60"]
    cells = [patch for patch in first.patches if isinstance(patch, Rectangle)]
    hatched = {cell.get_xy() for cell in cells if cell.get_hatch()}
    assert hatched == {(0.5, 0.5)}  # kp 20, kd 0.5
    (hatching,) = (cell for cell in cells if cell.get_hatch())
    (number,) = (text for text in first.texts if text.get_position() == (1, 1))
    assert to_rgba(hatching.get_edgecolor()) == to_rgba(number.get_color())
    # The hatching does not cross the number: a box in the colour of the cell is between them.
    colours = {cell.get_xy(): cell.get_facecolor() for cell in cells if cell.get_fill()}
    for text in first.texts:
        box = text.get_bbox_patch()
        assert box is not None
        x, y = text.get_position()
        assert box.get_facecolor() == colours[x - 0.5, y - 0.5]
        # The colour of the number, black or white, has the higher contrast (WCAG 2.1).
        red, green, blue, _ = (
            c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in box.get_facecolor()
        )
        luminance = 0.2126 * red + 0.7152 * green + 0.0722 * blue
        is_black = (luminance + 0.05) / 0.05 > 1.05 / (luminance + 0.05)
        assert text.get_color() == ("black" if is_black else "white")
    (bar,) = (axes for axes in figures[0].axes if "deviation" in axes.get_ylabel())
    assert "cut off at 0.0001 mm" in bar.get_ylabel()
    labels = [text.get_text() for text in figures[0].legends[0].get_texts()]
    assert any("grows within 12 s" in label for label in labels)
    figures[0].draw_without_rendering()
    label = bar.yaxis.label.get_window_extent()
    assert figures[0].bbox.y0 < label.y0 < label.y1 < figures[0].bbox.y1
    own = [cell.get_xy() for cell in cells if cell.get_linewidth() == 2]
    assert own == [(-0.5, -0.5)]  # v3's own kp 5 and kd 0.1
    faces = [{cell.get_facecolor() for cell in axes.patches if cell.get_fill()}
             for axes in (first, second)]  # fmt: skip
    lowest = comparison_figures.ScalarMappable(None, "viridis").cmap(0)
    assert all(lowest in colours for colours in faces)  # one scale for both panels


@pytest.mark.slow
def test_height_deviation_is_smaller_without_disturbance() -> None:
    """Reference: the same sweep under a force of 2 N at 1.2 Hz, the default of ``sweep_gains``."""
    robot, stand = load("original"), stand_of("original")
    calm, pushed = (
        pa.simulation.sweep_gains(robot, stand, kp=[60.0], kd=[1.0], amplitude=force)
        for force in (0.0, 2.0)
    )
    assert calm.height_deviation[0, 0] < 1e-3 * pushed.height_deviation[0, 0]
