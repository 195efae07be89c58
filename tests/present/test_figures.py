"""Figures: drawn positions, compared with Pinocchio and the model files."""

from __future__ import annotations

import errno
import io
import math
import re
import warnings
from collections.abc import Callable
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pytest
import shapely
from matplotlib import font_manager
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyArrowPatch
from matplotlib.text import Text
from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar  # type: ignore[import-untyped]

import pupper_analysis as pa
from pupper_analysis.base.errors import OutputError
from pupper_analysis.present import colours
from pupper_analysis.present.document import Axis, LinePlot, Name, Series, get_english
from pupper_analysis.present.documents.standing import height_plot
from pupper_analysis.present.figures import drawing, pose
from pupper_analysis.present.figures.pose import (
    compute_skeleton,
    make_pose_figure,
    write_pose_figure,
)
from pupper_analysis.present.html.plots import (
    DOT_RADIUS,
    LEFT_MARGIN,
    NUM_SERIES_STYLES,
    PLOT_WIDTH,
    RIGHT_MARGIN,
    draw_svg,
    round_log_ticks,
)
from pupper_analysis.present.scene import describe_scene
from pupper_analysis.simulation.verify import verify_stand
from tests.support.legged import ARM, quadruped, rewrite_file, with_arm
from tests.support.repository import ROOT
from tests.support.variants import load, stand_of


def draw_figure(
    monkeypatch: pytest.MonkeyPatch, draw: Callable[..., None], *arguments: Any
) -> Figure:
    """Return the figure that a function draws, without saving it."""
    kept: list[Figure] = []
    monkeypatch.setattr(drawing, "save_figure", lambda figure, path: kept.append(figure))
    draw(*arguments, Path("unused.png"))
    return kept[0]


# ------------------------------------------------------------------------------------- geometry


@pytest.mark.parametrize("name", pa.VARIANTS)
def test_skeleton_legs_end_at_the_feet_of_the_urdf(name: str) -> None:
    """Reference: Pinocchio's foot positions [m]."""
    robot, qpos = load(name), stand_of(name).qpos
    feet = pa.Configuration(robot, qpos).foot_positions()
    legs = compute_skeleton(robot, qpos).legs
    assert set(legs) == set(robot.contact_points)
    for foot, leg in legs.items():
        assert leg.shape == (4, 3)  # three joints and the foot
        np.testing.assert_allclose(leg[-1], feet[foot], atol=1e-9)


@pytest.mark.parametrize(
    ("name", "thigh", "calf"), [("original", 0.08, 0.11), ("long-leg", 0.12, 0.165)]
)
def test_skeleton_legs_have_the_lengths_of_the_model(name: str, thigh: float, calf: float) -> None:
    """Reference: the tutorial's lengths [m], times 1.5 for the long legs; no distance between the
    two hip axes.
    """
    leg = compute_skeleton(load(name), stand_of(name).qpos).legs["FL"]
    lengths = np.linalg.norm(np.diff(leg, axis=0), axis=1)
    np.testing.assert_allclose(lengths, (0.0, thigh, calf), atol=1e-12)


FROM_ABOVE = np.eye(3)[:2]
"""Projection onto the x-y plane."""


def test_silhouette_of_the_base_is_that_of_its_mesh() -> None:
    """Reference: union of all triangles of the STL file, whose vertices are in the base frame.

    Vertices in cells of 4 mm were merged.
    """
    triangle = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    content = (ROOT / "mjcf/meshes/torso.stl").read_bytes()[84:]
    corners = np.frombuffer(content, triangle)["corners"].astype(float)
    robot = load("v3")
    qpos = robot.neutral()
    qpos[:7] = (0, 0, 0, 1, 0, 0, 0)
    skeleton = compute_skeleton(robot, qpos)
    assert skeleton.has_visuals
    (part,) = skeleton.base
    for projection in (FROM_ABOVE, np.eye(3)[[0, 2]]):
        expected = shapely.union_all(shapely.polygons(corners @ projection.T))
        drawn = part.silhouette(lambda points, projection=projection: points @ projection.T)
        assert drawn.symmetric_difference(expected).area < 0.03 * expected.area
        np.testing.assert_allclose(drawn.bounds, expected.bounds, atol=4e-3)
        assert drawn.area < 0.95 * drawn.convex_hull.area


@pytest.mark.parametrize("name", ["original", "heavy"])
def test_silhouettes_of_the_base_are_those_of_its_boxes(name: str) -> None:
    """Reference: edge lengths [m] of the boxes in the model file."""
    robot = load(name)
    qpos = robot.neutral()
    qpos[:7] = (0, 0, 0, 1, 0, 0, 0)
    parts = compute_skeleton(robot, qpos).base
    assert len(parts) == {"original": 1, "heavy": 2}[name]
    outline = parts[0].silhouette(lambda points: points @ FROM_ABOVE.T)
    assert outline.area == pytest.approx(0.2 * 0.11, rel=1e-9)


def test_base_without_visual_shapes_is_drawn_by_its_collision_shapes(tmp_path: Path) -> None:
    """Reference: box of the trunk, and the three links of the arm, in the MJCF [m].

    MuJoCo's viewer hides group 3.
    """
    pair = with_arm(quadruped(tmp_path))
    rewrite_file(pair.mjcf, ('<geom type="box" size="0.2', '<geom group="3" type="box" size="0.2'))
    robot = pa.load_robot(*pair)
    stand = pa.solve_stand(robot)
    skeleton = compute_skeleton(robot, stand.qpos)
    assert not skeleton.has_visuals
    (part,) = skeleton.base
    outline = part.silhouette(lambda points: points @ FROM_ABOVE.T)
    x, y = stand.qpos[:2]
    np.testing.assert_allclose(outline.bounds, (x - 0.2, y - 0.1, x + 0.2, y + 0.1), atol=1e-6)
    assert len(skeleton.links) == len(ARM)
    assert set(skeleton.legs) == set(robot.contact_points)
    figure = make_pose_figure(robot, stand, pa.stance.stand_statics(robot, stand))
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert {"base (collision shapes)", "other link"} <= set(labels)


def test_silhouettes_include_links_outside_of_base_and_legs(tmp_path: Path) -> None:
    """Reference: radius of the sphere on the last link of the arm, in the MJCF [m]."""
    robot = pa.load_robot(*with_arm(quadruped(tmp_path)))
    skeleton = compute_skeleton(robot, pa.solve_stand(robot).qpos)
    (hand,) = skeleton.others
    for projection in (FROM_ABOVE, np.eye(3)[[0, 2]]):
        outline = hand.silhouette(lambda points, projection=projection: points @ projection.T)
        assert outline.area == pytest.approx(math.pi * 0.025**2, rel=0.03)
    for own in hand.points:
        assert (skeleton.points() == own).all(axis=1).any()


def test_forward_direction_is_the_heading_of_the_base() -> None:
    """Reference: cosine and sine of the yaw of the task [rad]."""
    robot = load("v3")
    stand = pa.solve_stand(robot, pa.StandTask(yaw=0.3, pitch=0.1))
    forward = compute_skeleton(robot, stand.qpos).forward
    np.testing.assert_allclose(forward, (math.cos(0.3), math.sin(0.3), 0), atol=1e-6)


# ------------------------------------------------------------------------------------- figures


def test_each_view_of_a_pose_has_scale_bar_front_and_names_of_feet() -> None:
    """The bars are as long as their labels state [mm], in the units of the view [m]."""
    robot, stand = load("v3"), stand_of("v3")
    figure = make_pose_figure(robot, stand, pa.stance.stand_statics(robot, stand))
    figure.draw_without_rendering()
    assert len(figure.axes) == 2
    for axes, direction in zip(figure.axes, ((1, -1), (0, 1)), strict=True):
        (bar,) = (part for part in axes.artists if isinstance(part, AnchoredSizeBar))
        (line,) = bar.size_bar.get_children()
        assert bar.txt_label.get_text() == f"{1e3 * line.get_width():g} mm"
        texts = {text.get_text(): text.get_window_extent() for text in axes.texts}
        assert {"front", "FL", "FR", "RL", "RR"} <= set(texts)
        boxes = [box for name, box in texts.items() if name]
        for box in boxes:
            assert figure.bbox.x0 < box.x0 < box.x1 < figure.bbox.x1
            assert sum(box.overlaps(second_box) for second_box in boxes) == 1  # itself
        # +x points to the lower right in the oblique view, and upwards from above.
        (arrow,) = (part for part in axes.patches if isinstance(part, FancyArrowPatch))
        tail, tip = np.array(arrow._posA_posB)  # type: ignore[attr-defined]
        np.testing.assert_array_equal(np.sign(np.round(tip - tail, 6)), direction)


def test_title_of_a_pose_states_what_was_computed() -> None:
    robot, stand = load("v3"), stand_of("v3")
    statics = pa.stance.stand_statics(robot, stand)
    soft = pa.solve_stand_as_simulated(robot)
    for planned, ground in ((stand, "on rigid ground"), (soft, "on the simulated ground")):
        title = make_pose_figure(robot, planned, statics).get_suptitle()
        assert title == f"v3: stance and static contact forces {ground}"
    title = make_pose_figure(robot, stand, statics, subject="best stance").get_suptitle()
    assert title == "v3: best stance on rigid ground"
    title = make_pose_figure(robot, stand, statics, verdict=Name("FAILS")).get_suptitle()
    assert title == "FAILS v3: stance and static contact forces on rigid ground"


@pytest.mark.parametrize(
    ("names", "short"),
    [
        (["FL_foot", "FR_foot"], ["FL", "FR"]),
        (["left_ankle_roll_link", "right_ankle_roll_link"], ["left", "right"]),
        (["foot", "foot_left"], ["foot", "foot_left"]),
        (["a_x", "x_a"], ["a_x", "x_a"]),
        (["foot"], ["foot"]),
        (["leg__x", "leg_y"], ["x", "y"]),
    ],
)
def test_short_names_omit_common_parts_if_they_remain_distinct(
    names: list[str], short: list[str]
) -> None:
    assert drawing.shorten_names(names) == short


def test_pose_figure_of_a_welded_base_with_all_feet_lifted_has_no_arrow() -> None:
    robot = load("v3")
    task = pa.StandTask(contacts={"base": pa.Weld()}, swing=dict.fromkeys(robot.feet, 0.02))
    stand = pa.solve_stand(robot, task)
    statics = pa.stance.stand_statics(robot, stand)
    figure = make_pose_figure(stand.check(robot), stand, statics)
    texts = [text.get_text() for axes in figure.axes for text in axes.texts]
    assert not [text for text in texts if "forces up to" in text]


def test_pose_figure_draws_lifted_feet_and_a_scene_has_its_steps(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The step reaches from the plane to the contact point; three feet have a force arrow."""
    robot = load("v3")
    ground = pa.Ground(slope=0.15, uphill=0.8, heights={"FR": 0.02})
    task = pa.StandTask(ground=ground, swing={"RL": 0.02}, com="inside", com_margin=0.01)
    stand = pa.solve_stand(robot, task)
    # The step's top is where the foot touches it, its bottom in the plane.
    (step,) = describe_scene(robot, stand, None).steps.values()
    low, high = (float((step.centre + side * step.half[2] * ground.normal()) @ ground.normal())
                 for side in (-1, 1))  # fmt: skip
    assert high == pytest.approx(stand.contact_points["FR"] @ ground.normal(), abs=1e-9)
    assert low == pytest.approx(0, abs=1e-9)
    figure = draw_figure(
        monkeypatch, write_pose_figure, robot, stand, pa.stance.stand_statics(robot, stand)
    )
    labels = [text.get_text() for legend in figure.legends for text in legend.get_texts()]
    assert "swing foot" in labels
    # The task of this stand has two lines, and the legend eight symbols.
    figure.canvas.draw()
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    boxes = [part.get_window_extent() for part in (*figure.texts, *figure.legends)]
    boxes += [axes._left_title.get_window_extent() for axes in figure.axes]  # type: ignore[attr-defined]
    assert len(boxes) >= len(titles) + 2
    for box in boxes:
        assert figure.bbox.x0 <= box.x0 < box.x1 <= figure.bbox.x1
        assert figure.bbox.y0 <= box.y0 < box.y1 <= figure.bbox.y1
        assert sum(box.overlaps(second_box) for second_box in boxes) == 1  # itself
    # The forces are vertical: from above, their arrows have no length.
    for axes, count in zip(figure.axes, (3, 0), strict=True):
        arrows = [text for text in axes.texts if text.arrow_patch is not None]  # type: ignore[attr-defined]
        assert len(arrows) == count


FORMULA = "a$b_c$ $\\frac$ ^"
"""Name that Matplotlib refuses as a formula."""


@pytest.mark.slow
def test_names_in_a_pose_figure_and_a_legend_are_not_formulas(tmp_path: Path) -> None:
    """A task and the entry of a legend contain such a name."""
    robot, stand = load("v3"), stand_of("v3")
    statics = pa.stance.stand_statics(robot, stand)
    named = replace(stand, task=pa.StandTask(foot_offsets={FORMULA: (0.01, 0.0)}))
    write_pose_figure(robot, named, statics, tmp_path / "pose.png")
    axes = Axis(Name("time"), "s", ".1f"), Axis(Name("height"), "mm", ".1f")
    lines = [Series(Name(f"{FORMULA}{number}"), [0, 1], [number, 1.0]) for number in range(2)]
    drawing.write_plots([LinePlot(Name("t"), *axes, lines)], tmp_path / "plot.png")
    for path in tmp_path.iterdir():
        assert path.read_bytes().startswith(b"\x89PNG")


def test_figure_that_cannot_be_written_leaves_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(figure: Figure, target: io.BytesIO, **_: Any) -> None:
        target.write(b"half of it")
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Figure, "savefig", fail)
    with pytest.raises(OutputError, match="No space left"):
        drawing.save_figure(Figure(), tmp_path / "heights.png")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_height_legend_states_the_mean_of_the_last_second() -> None:
    """v3-long-leg loses 26 mm in the second before the nudge, and 32 mm in the last second."""
    robot = load("v3-long-leg")
    stand = pa.solve_stand_as_simulated(robot)
    height = stand.task.height
    assert height is not None
    run = verify_stand(robot, stand, feedforward=False)
    curve, _ = height_plot([run], height).series
    assert curve.note is not None
    times, heights = np.asarray(curve.x), np.asarray(curve.y)
    expected = 1e3 * height - heights[times > times[-1] - 1.0].mean()
    assert f"{expected:.2f}" in get_english(curve.note)


def test_height_plot_states_the_contact_penetration_of_a_stand_on_rigid_ground() -> None:
    """Reference: mean of radius less height of the four feet at the end, by Pinocchio [m].

    The stand was planned for rigid ground: with feed-forward, nothing else lowers the base.
    """
    robot = load("v3")
    stand = pa.solve_stand(robot, pa.StandTask(height=0.12))
    run = verify_stand(robot, stand, duration=3.0)
    assert run.passed
    axes = run.plot()
    legend = axes[0].get_legend()
    assert legend is not None
    entry = next(text for text in legend.get_texts() if "with feed-forward" in text.get_text())
    penetration = re.search(r"of which ([\d.]+) mm contact penetration", entry.get_text())
    assert penetration is not None
    feet = pa.Configuration(robot, run.motion[-1]).foot_positions()
    depths = [robot.contact_radius[foot] - centre[2] for foot, centre in feet.items()]
    assert min(depths) > 1e-3
    assert float(penetration[1]) == pytest.approx(1e3 * np.mean(depths), rel=0.02)
    assert f"{1e3 * run.height_loss:.2f} mm, of which" in entry.get_text()
    plt.close("all")


@pytest.mark.parametrize("letters", [5, 60])
def test_legend_of_a_plot_is_inside_the_figure(letters: int) -> None:
    """Two columns of long entries were wider than the page, and the plot shrank to half of it."""
    names = (Name("a" * letters), Name("b" * letters))
    series = [Series(name, [0.0, 1.0], [0.0, 1.0]) for name in names]
    dot = Series(Name("point"), [0.5], [0.5], points=True, marked_index=0)
    axis = Axis(Name("x"), "m", ".1f")
    plot = LinePlot(Name("title"), axis, axis, [*series, dot], Name("n" * letters))
    figure = drawing.make_plots_figure([plot])
    figure.draw_without_rendering()
    (axes,) = figure.axes
    legend = axes.get_legend()
    assert legend is not None
    inside, page = legend.get_window_extent(), figure.bbox
    assert page.x0 <= inside.x0 < inside.x1 <= page.x1
    assert page.y0 <= inside.y0
    assert axes.get_window_extent().width > 0.9 * page.width
    points = [line for line in axes.lines if line.get_marker() != "None"]
    assert len(points) == 1
    (name_of_y,) = (words for words in axes.texts if words.get_rotation() == 90)
    extent = axes.transData.inverted().transform(name_of_y.get_window_extent())
    assert abs(extent[:, 1].mean() - name_of_y.get_position()[1]) < 1.0
    grid = [line for line in axes.lines if line.get_color() == colours.GRID_COLOUR]
    assert max(line.get_zorder() for line in grid) < Circle((0, 0), 1).get_zorder()  # below bars
    lines = max(line.get_zorder() for line in axes.lines if line not in points)
    assert points[0].get_zorder() > lines  # a grid line crossed a point
    markers = [
        handle.get_marker() for handle in legend.legend_handles if hasattr(handle, "get_marker")
    ]
    assert markers.count(points[0].get_marker()) == 1  # the series without a line


def test_points_differ_in_shape_and_lie_inside_the_axes() -> None:
    """Without colours, points of two series were equal; the outermost lay on the axis."""
    axis = Axis(Name("x"), "m", ".1f")
    series = [Series(Name(name), [0.0, 1.0], [0.0, 1.0], points=True) for name in "ab"]
    (axes,) = drawing.make_plots_figure([LinePlot(Name("title"), axis, axis, series)]).axes
    points = [line for line in axes.lines if line.get_marker() != "None"]
    assert len({line.get_marker() for line in points}) == len(series)
    xs = [float(np.min(np.asarray(line.get_xdata()))) for line in points]
    assert min(xs) > LEFT_MARGIN + 2 * DOT_RADIUS


@pytest.mark.parametrize("count", [1, 2])
def test_references_are_grey_and_use_no_colour_of_a_series(count: int) -> None:
    """Reference: order of the palette. The task of a single run had the colour of a second run."""
    axis = Axis(Name("x"), "m", ".1f")
    lines = [Series(Name(f"run {index}"), [0.0, 1.0], [0.0, 1.0]) for index in range(count)]
    task = Series(Name("task"), [0.0, 1.0], [0.5, 0.5], reference=True)
    for series in ([*lines, task], [task, *lines]):
        (axes,) = drawing.make_plots_figure([LinePlot(Name("title"), axis, axis, series)]).axes
        legend = axes.get_legend()
        assert legend is not None
        entries = zip(legend.get_texts(), legend.get_lines(), strict=True)
        found = {text.get_text(): line.get_color() for text, line in entries}
        runs = {f"run {index}": colours.PLOT_COLOURS[index] for index in range(count)}
        assert found == {"task": colours.GREY_COLOUR, **runs}
        drawn = [line.get_color() for line in axes.lines if line.get_linewidth() == 1.3]
        assert sorted(drawn) == sorted([*colours.PLOT_COLOURS[:count], colours.GREY_COLOUR])


def test_colours_of_a_plot_are_equal_in_figures_and_pages() -> None:
    """Reference: the variables of the style sheet. A motor was green in one, and black in one."""
    sheet = files("pupper_analysis.present.html").joinpath("templates/style.css").read_text("utf-8")
    light = sheet[: sheet.index("prefers-color-scheme")]
    found = {name: colour.upper() for name, colour in re.findall(r"--(\w+): (#\w+)", light)}
    series = [found[f"c{index}"] for index in range(NUM_SERIES_STYLES)]
    assert series == list(colours.PLOT_COLOURS)
    concepts = dict(re.findall(r"--(force|support|com): var\(--(\w+)\)", light))
    assert {name: found[variable] for name, variable in concepts.items()} == {
        "force": colours.FORCE_COLOUR,
        "support": colours.SUPPORT_COLOUR,
        "com": colours.COM_COLOUR,
    }
    viewer = files("pupper_analysis.present.html").joinpath("templates/view.js").read_text("utf-8")
    assert {name for name in concepts if f'color("--{name}")' in viewer} == {*concepts}
    dashes = [re.search(rf"svg \.s{index} .*dasharray: ([\d ]+)", sheet) for index in range(1, 6)]
    for index, found in enumerate(dashes, start=1):
        assert found
        pattern = drawing._CLASS_DASHES[f"s{index}"][1]
        assert tuple(map(int, found[1].split())) == pattern


def test_a_curve_over_time_fills_the_axis() -> None:
    axis = Axis(Name("x"), "s", ".1f")
    plot = LinePlot(Name("title"), axis, axis, [Series(Name("a"), [0.0, 1.0], [0.0, 1.0])])
    (curve,) = [mark for mark in draw_svg(plot).marks if mark["tag"] == "polyline"]
    assert [x for x, _ in curve["points"]] == [LEFT_MARGIN, PLOT_WIDTH - RIGHT_MARGIN]


def test_long_caption_of_a_pose_does_not_cover_the_panels() -> None:
    """The third row covered the title of a panel, and the second was cut at the right edge."""
    robot, stand = load("v3"), stand_of("v3")
    moved = dict.fromkeys(robot.feet, (0.0481, -0.0123))
    task = pa.StandTask(foot_offsets=moved, offset=(-0.0435, 0.0), pitch=math.radians(14.44))
    statics = pa.stance.stand_statics(robot, stand)
    figure = make_pose_figure(robot, replace(stand, task=task), statics)
    figure.draw_without_rendering()
    caption = figure.texts[-1].get_window_extent()
    rows = figure.texts[-1].get_text().split("\n")
    assert len(rows) >= 3
    for row in rows:  # no pair of coordinates is divided
        assert row.count("(") == row.count(")")
    assert all(row[-1] in ",;" for row in rows[:-1])
    assert caption.x1 < figure.bbox.x1
    for axes in figure.axes:
        title = axes._left_title  # type: ignore[attr-defined]
        assert title.get_window_extent().y1 < caption.y0


def test_long_names_of_feet_are_inside_the_panels(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reference: bounding boxes in pixels. Long names were cut at the edge of the figure."""
    robot, stand = load("v3"), stand_of("v3")
    names = [f"{letter}_foot_with_a_long_name_{letter}" for letter in "abcd"]
    monkeypatch.setattr(drawing, "shorten_names", lambda _: names)
    figure = make_pose_figure(robot, stand, pa.stance.stand_statics(robot, stand))
    figure.draw_without_rendering()
    panels = [axes.get_position(original=True).transformed(figure.transFigure)
              for axes in figure.axes]  # fmt: skip
    for axes, panel in zip(figure.axes, panels, strict=True):
        texts = [text for text in axes.texts if "_a_long_name_" in text.get_text()]
        assert len(texts) == 4
        for text in texts:
            box = text.get_window_extent()
            assert panel.x0 - 0.5 <= box.x0 < box.x1 <= panel.x1 + 0.5


@pytest.mark.parametrize(
    ("names", "short"),
    [
        (["abcdef", "abc"], ["…def", "abc"]),
        (["abcdef", "xyzdef"], ["abcdef", "xyzdef"]),
        (["abcd"], ["abcd"]),
    ],
)
def test_long_names_are_cut_at_the_start_if_they_remain_distinct(
    names: list[str], short: list[str]
) -> None:
    assert drawing.cut_long_names(names, 4) == short


def test_letters_without_a_font_are_stated_in_the_figure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Matplotlib drew boxes, and printed a warning with a path of this package for each letter.

    The second case has a letter that STIX, a font of Matplotlib, contains and DejaVu does not.
    """
    default, stix = (
        font_manager.get_font(font_manager.findfont(name)).get_charmap()
        for name in ("DejaVu Sans", "STIXGeneral")
    )
    letter = chr(min(code for code in {*stix} - {*default} if code > 0x2000))
    for fallbacks, word, missing in (((), "四足", True), (("STIXGeneral",), letter, False)):
        monkeypatch.setattr(drawing, "FALLBACK_FONTS", (*fallbacks, "Noto Sans CJK SC"))
        drawing._list_fonts.cache_clear()
        figure = drawing.make_page_figure(word, 2.0)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            drawing.save_figure(figure, tmp_path / "figure.png")
        notes = [text.get_text() for text in figure.texts if "boxes" in text.get_text()]
        installed = any("CJK" in entry.name for entry in font_manager.fontManager.ttflist)
        assert bool(notes) == (missing and not installed)
        assert figure.findobj(Text)[0].get_fontfamily()[: 1 + len(fallbacks)] == [
            "DejaVu Sans", *fallbacks
        ]  # fmt: skip
    drawing._list_fonts.cache_clear()


@pytest.mark.parametrize(
    ("low", "high", "ticks"),
    [
        (3.6, 18.0, [5, 7, 10, 15]),
        (0.2, 100.0, [0.2, 0.5, 1, 2, 5, 10, 20, 50, 100]),
        (0.01, 1e4, [0.01, 0.1, 1, 10, 100, 1e3, 1e4]),
        (0.55, 0.65, [0.56, 0.58, 0.6, 0.62, 0.64]),
        (1e-6, 2.2e-6, [1e-6, 1.5e-6, 2e-6]),
    ],
)
def test_logarithmic_axes_have_at_least_three_round_ticks(
    low: float, high: float, ticks: list[float]
) -> None:
    """Reference: by hand. An axis from 3.6 to 18 had the ticks 5 and 10 only."""
    assert round_log_ticks(low, high) == pytest.approx(ticks)


@pytest.mark.parametrize(
    ("longest", "length"), [(0.0021, 0.002), (0.3, 0.2), (0.5, 0.5), (7.0, 5.0), (1e-4, 1e-4)]
)
def test_scale_bar_has_a_round_length_for_each_size_of_robot(longest: float, length: float) -> None:
    """Reference: by hand. The longest bar was 1 m, the shortest 1 mm."""
    assert drawing.choose_bar_length(longest) == pytest.approx(length)


def test_forces_and_scale_of_a_robot_with_a_small_support_polygon_are_visible() -> None:
    """Reference: lengths relative to the view. The arrows of a humanoid were hidden by the feet.

    The second support polygon is ten times smaller.
    """
    robot, stand = load("v3"), stand_of("v3")
    statics = pa.stance.stand_statics(robot, stand)
    seen = describe_scene(robot, stand, statics)
    for factor in (1.0, 0.1):
        narrow = replace(seen, polygon=factor * seen.polygon)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(pose, "describe_scene", lambda *_, narrow=narrow: narrow)
            figure = make_pose_figure(robot, stand, statics)
        axes = figure.axes[0]
        height = float(np.ptp(axes.get_ylim()))
        arrows = [text for text in axes.texts if text.arrow_patch is not None]  # type: ignore[attr-defined]
        tails, tips = (
            np.array([place for arrow in arrows for place in (getattr(arrow, name),)])
            for name in ("xyann", "xy")
        )
        assert np.linalg.norm(tips - tails, axis=1).min() > 0.05 * height
        (bar,) = (part for part in axes.artists if isinstance(part, AnchoredSizeBar))
        (line,) = bar.size_bar.get_children()
        assert line.get_width() > 0.1 * float(np.ptp(axes.get_xlim()))
