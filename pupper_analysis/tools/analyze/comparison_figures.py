"""Figures that compare analyses, a panel per robot: motor torques, base heights and servo gains.

Inputs are the results of ``analyze_variant``; output is a PNG per figure. Robots with the same
joints (the variants of a base model) share the axes, so that panels can be compared by eye.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.diagnostics.diagnostic import Diagnostic
from pupper_analysis.base.diagnostics.templates import Quantity
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.units import (
    JointUnits,
    find_common_units,
)
from pupper_analysis.models.sides import find_mirror_pairs
from pupper_analysis.present import colours
from pupper_analysis.present.figures import drawing
from pupper_analysis.robot.stability import HOLD_DURATION

if TYPE_CHECKING:
    from pupper_analysis.simulation.verify import StandVerification
    from pupper_analysis.tools.analyze.analysis import Analysis
    from pupper_analysis.tools.analyze.gain_sweep import GainSweep

NUM_COLUMNS = 2
"""Largest number of panels in a row of a figure. Chosen, not tuned."""

MIN_SHOWN_DEVIATION = 1e-4
"""Height deviation [mm] at the lower end of the colour scale of the heat maps. All smaller
deviations have the same colour. Chosen, not tuned.
"""

MIN_SHOWN_LOSS = 0.1
"""Smallest height loss [mm] at which the vertical axis of the height figure ends, so that
rounding errors are not enlarged. Chosen, not tuned.
"""

_LOSS_WINDOW = 1.0
"""Length [s] of the interval at the end of a simulation. The legend states the mean difference
between height of the stand and base height in this interval. Chosen, not tuned.
"""


def write_torque_figure(analyses: Sequence[Analysis], path: str | Path) -> None:
    """Draw predicted and simulated motor torques, in percent of the effort limits, as a PNG file.

    Magnitudes are drawn, in a panel per robot.

    Raises:
        ConfigurationError: If there is no robot.
        OutputError: If the file cannot be written.
    """
    groups = [_group_joints(analysis, _list_legs(analysis)) for analysis in analyses]
    most = max((len(group.rows) for group in groups), default=0)
    title = "Motor torque, in percent of each motor's limit\nnumbers: largest prediction of the row"
    figure, panels = _make_panels(analyses, title, 0.45, most * _MIN_ROW_HEIGHT)
    for (analysis, axes), group in zip(panels, groups, strict=True):
        rows = list(group.rows.items())
        limits = np.array([joint.effort for joint in analysis.joints], float)
        units = analysis.statics.torque_units
        predicted = np.abs(np.asarray(analysis.statics.joint_torques, float))
        simulated = np.abs(np.asarray(analysis.verification.joint_torques, float))
        limited = np.isfinite(limits) & (limits > 0)
        percent = np.where(limited, 100 / np.where(limited, limits, 1.0), np.nan)
        for row, (_, joints_and_limbs) in enumerate(rows):
            joints = [joint for joint, _ in joints_and_limbs]
            offsets = np.linspace(-0.24, 0.24, len(joints)) if len(joints) > 1 else np.zeros(1)
            for (joint, limb), offset in zip(joints_and_limbs, offsets, strict=True):
                style = {"color": "0.3", "marker": "o"} if limb is None else _get_limb_style(limb)
                place = row + offset
                style |= {"clip_on": False}  # a torque of zero lies on the axis
                axes.plot(percent[joint] * predicted[joint], place, ls="", ms=5, **style)
                axes.plot(
                    percent[joint] * simulated[joint], place, "|", color="k", ms=8, clip_on=False
                )
            peak = max(joints, key=lambda joint: predicted[joint])
            share = f" = {percent[peak] * predicted[peak]:.1f} %" if limited[peak] else ", no limit"
            axes.annotate(f"{predicted[peak]:.3f} {units[peak]}{share}", (1, row),
                          ha="left", va="center", xycoords=axes.get_yaxis_transform(),
                          size=drawing.FONT_SIZE - 1, xytext=(6, 0),
                          textcoords="offset points")  # fmt: skip
        axes.set_yticks(range(len(rows)), [name for name, _ in rows], parse_math=False)
        axes.set_ylim(len(rows) - 0.5, -0.5)
        axes.set_xlabel("torque (% of the limit)", size=drawing.FONT_SIZE)
        axes.grid(axis="x", color=colours.GRID_COLOUR)
        limit = f"{_format_range(limits[limited])} {find_common_units(units).effort}"
        title = f"{analysis.name}: limit {limit}"
        if len(title) > _TITLE_LETTERS and len(panels) > 1:
            title = f"{analysis.name}\nlimit {limit}"
        drawing.title_panel(axes, title)
        axes.set_xlim(0, 1.1 * max(1e-3, np.nanmax(np.append(percent * predicted, 0.0))))
    _share_limits(panels, "x")
    handles = [
        Line2D([], [], marker="o", ls="", color="0.3", label="predicted (Pinocchio)"),
        Line2D([], [], marker="|", ls="", color="k", ms=8, label="simulated, with feed-forward"),
        *(
            Line2D([], [], ls="", label=label, **_get_limb_style(limb))
            for limb, label in _label_limbs([analysis.name for analysis in analyses], groups)
        ),
    ]
    _save_with_legend(figure, handles, path)


def write_height_figure(analyses: Sequence[Analysis], path: str | Path) -> None:
    """Draw the height that the base loses [mm] over the simulated time [s] as a PNG file.

    The loss is the height of the stand minus the height of the base; it is positive downwards. The
    legend of a panel states the mean over the last second of each curve.

    Raises:
        ConfigurationError: If there is no robot.
        OutputError: If the file cannot be written.
    """
    title = (
        "Height that the simulated base loses, relative to the task\n"
        f"numbers: mean of the last {_LOSS_WINDOW:g} s"
    )
    figure, panels = _make_panels(analyses, title, 0.5)
    nudges = dict[str, None]()  # as an ordered set
    for analysis, axes in panels:
        task = float(analysis.stand.qpos[2])
        axes.axhline(0.0, **_TASK_STYLE)
        for run, name, style in (
            (analysis.verification, "with feed-forward", {"color": colours.FEEDFORWARD_COLOUR}),
            (
                analysis.sagging,
                "position commands only",
                {"color": colours.COMMANDS_COLOUR, "ls": (0, (6, 2))},
            ),
        ):
            losses = 1e3 * (task - np.asarray(run.height, float))
            last = losses[run.time > run.time[-1] - _LOSS_WINDOW].mean()
            label = f"{name}: {round(last, 2) + 0.0:.2f} mm{' (FAILS)' if run.failures else ''}"
            axes.plot(run.time, losses, lw=1.4, label=label, **style)
            _mark_first_contact(axes, run, losses)
            if run.nudge is not None:
                speed = f"velocities up to {run.nudge.speed:g} m/s or rad/s"
                nudges[f"nudge at {run.nudge.time:g} s: {speed}"] = None
                axes.axvline(run.nudge.time, ymax=1 / (1 + _LEGEND_SHARE), **_NUDGE_STYLE)
        axes.set_xlabel("time (s)", size=drawing.FONT_SIZE)
        axes.set_ylabel("height lost (mm)", size=drawing.FONT_SIZE)
        axes.grid(color=colours.GRID_COLOUR)
        axes.legend(fontsize=drawing.FONT_SIZE - 1, frameon=False, loc="upper right")
        # Losses grow downwards, as the base does. The legend is above the curves.
        least, largest = sorted(axes.get_ylim())
        largest = max(1.05 * largest, MIN_SHOWN_LOSS)
        axes.set_ylim(largest, min(least, 0.0) - _LEGEND_SHARE * largest)
        drawing.title_panel(axes, f"{analysis.name}: task {1e3 * task:.1f} mm")
    _share_limits(panels, "y")
    handles = [Line2D([], [], label="task", **_TASK_STYLE)]
    handles += [Line2D([], [], label=label, **_NUDGE_STYLE) for label in nudges]
    _save_with_legend(figure, handles, path)


_LEGEND_SHARE = 0.35
"""Height of the strip for the legend above the task in a panel of the height figure, relative to
the largest shown loss [1]. Chosen, not tuned."""
_TASK_STYLE: dict[str, Any] = {"color": colours.GREEN_COLOUR, "alpha": 0.35, "lw": 5.0, "zorder": 1}
"""Options of Matplotlib for the height of the task: a wide band below the curves, which do not hide
it."""
_NUDGE_STYLE: dict[str, Any] = {"color": colours.GREY_COLOUR, "ls": ":", "lw": 1.0, "zorder": 1.5}
"""Options of Matplotlib for the line at the time of the nudge."""


def write_gain_figure(analyses: Sequence[Analysis], path: str | Path) -> None:
    """Draw heat maps of the gain sweeps as a PNG file: height deviation [mm] by kp and kd.

    Analyses without a gain sweep are not drawn.

    Raises:
        ConfigurationError: If there is no robot with a gain sweep.
        OutputError: If the file cannot be written.
    """
    analyses = [analysis for analysis in analyses if analysis.sweep is not None]
    sweeps = [analysis.sweep for analysis in analyses if analysis.sweep is not None]
    figure, panels = _make_panels(analyses, _make_sweep_title(sweeps), 0.6)
    shown = np.concatenate([1e3 * sweep.height_deviation.ravel() for sweep in sweeps])
    shown = np.append(shown[np.isfinite(shown)], MIN_SHOWN_DEVIATION)
    # At least one decade, so that the scale has two ends.
    scale = LogNorm(MIN_SHOWN_DEVIATION, max(10 * MIN_SHOWN_DEVIATION, float(shown.max())))
    for (analysis, axes), sweep in zip(panels, sweeps, strict=True):
        units = find_common_units(analysis.statics.torque_units)
        _draw_heat_map(axes, sweep, scale, units)
        own = tuple(float(np.median(gain)) for gain in
                    (analysis.verification.kp, analysis.verification.kd))  # fmt: skip
        _mark_own_gains(axes, sweep, *own)
        drawing.title_panel(axes, analysis.name)
    mapping = ScalarMappable(scale, _COLOUR_MAP)
    bar = figure.colorbar(mapping, ax=[axes for _, axes in panels], shrink=0.6, extend="min")
    bar.set_label(
        f"standard deviation of the base height (mm),\ncut off at {MIN_SHOWN_DEVIATION:g} mm",
        size=drawing.FONT_SIZE,
    )
    bar.ax.tick_params(labelsize=drawing.FONT_SIZE)
    handles = [
        Patch(facecolor="0.8", label="falls"),
        Patch(facecolor="white", edgecolor="0.3", hatch="////", label=_RESTLESS_LABEL),
        Patch(facecolor="none", edgecolor=colours.RED_COLOUR, lw=2, label="the model's own gains"),
    ]
    _save_with_legend(figure, handles, path)


_RESTLESS_LABEL = (
    f"does not stay at rest: no equilibrium, or a deviation grows within {HOLD_DURATION:g} s"
)
"""Legend of the cells without `GainSweep.lasts`. The deviation in a cell covers only the last
second of a shorter simulation, and can be small."""

_COLOUR_MAP = "viridis"
"""Matplotlib colour map of the deviation of the base height in the heat maps of servo gains."""


def _make_panels(
    analyses: Sequence[Analysis], title: str, aspect: float, min_height: float = 0.0
) -> tuple[Figure, list[tuple[Analysis, Axes]]]:
    """Return a titled figure and a panel for each analysis; ``aspect`` is height by width.

    ``min_height`` is the smallest height of the axes of a panel [inch].

    Raises:
        ConfigurationError: If there is no analysis.
    """
    if not analyses:
        raise ConfigurationError("plots", diagnose("no-robot-to-draw"))
    columns = min(len(analyses), NUM_COLUMNS)
    num_rows = -(-len(analyses) // columns)
    height = num_rows * (max(aspect * drawing.PAGE_WIDTH / columns, min_height) + 0.45) + 0.7
    figure = drawing.make_page_figure(title, height, layout="constrained")
    grid = figure.subplots(num_rows, columns, squeeze=False).ravel()
    for unused in grid[len(analyses) :]:
        unused.set_axis_off()
    assert isinstance(figure, Figure)
    return figure, list(zip(analyses, grid[: len(analyses)], strict=True))


def _list_legs(analysis: Analysis) -> dict[str, tuple[str, ...]]:
    """Return {feet of a leg: joints of the leg, in order from the base}, sorted by feet.

    Several feet at the same joints are one leg. Feet without joints are omitted.
    """
    feet: dict[tuple[str, ...], set[str]] = {}
    for jacobian in analysis.foot_jacobians.values():
        if jacobian.joints:
            feet.setdefault(tuple(jacobian.joints), set()).add(jacobian.foot)
    return dict(sorted((" + ".join(sorted(names)), joints) for joints, names in feet.items()))


@dataclass(frozen=True)
class _JointGroups:
    """Rows of a panel of the torque figure, and the limbs that have a colour and a marker.

    Attributes:
        rows: {row title: (joint index, limb index) of each joint}. The limb index is None for a
            joint that has no counterpart on another limb, for example.
        limbs: Name of each limb: of a leg, or of a side such as ``left``.
    """

    rows: dict[str, list[tuple[int, int | None]]]
    limbs: tuple[str, ...]


def _group_joints(analysis: Analysis, legs: Mapping[str, Sequence[str]]) -> _JointGroups:
    """Group joints for the torque figure: a row contains the corresponding joints of the limbs.

    These are joints at the same place in the legs (`_list_legs`), or pairs of other joints whose
    names differ only in the word for left or right (`find_mirror_pairs`). A limb is named without
    the parts that all legs, or both joints of a pair, have in common.
    """
    names = [joint.name for joint in analysis.joints]
    by_depth: defaultdict[int, dict[int, int | None]] = defaultdict(dict)
    depths: dict[int, int] = {}
    for leg, joints in enumerate(legs.values()):
        for depth, name in enumerate(joints):
            index = names.index(name)
            is_shared = len(legs) == 1 or index in depths
            by_depth[depths.setdefault(index, depth)][index] = None if is_shared else leg
    limbs = drawing.shorten_names(list(legs)) if len(legs) > 1 else []
    other_indices = [index for index in range(len(names)) if index not in depths]
    partners = dict(find_mirror_pairs(names[index] for index in other_indices))
    second = {*partners.values()}
    other_rows: list[dict[int, int | None]] = []
    for index in other_indices:
        if names[index] in second:
            continue
        pair = [names[index], *(partners[name] for name in [names[index]] if name in partners)]
        sides = drawing.shorten_names(pair) if len(pair) > 1 else []
        limbs += [side for side in sorted(sides) if side not in limbs]
        places = map(limbs.index, sides) if sides else [None]
        other_rows.append(dict(zip(map(names.index, pair), places, strict=True)))
    rows = [*by_depth.values(), *other_rows]
    titles = [_join_common_parts([names[index] for index in row]) for row in rows]
    if len({*titles}) < len(titles):
        numbered = [f"joint {depth + 1}" for depth in by_depth]
        titles = [*numbered, *(names[min(row)] for row in other_rows)]
    return _JointGroups(
        {title: list(row.items()) for title, row in zip(titles, rows, strict=True)}, tuple(limbs)
    )


def _join_common_parts(names: Sequence[str]) -> str:
    """Return the common parts of joint names, joined; the first name if there are none.

    For ``leg_front_l_1`` and ``leg_back_r_1`` the result is ``leg_1``.
    """
    parts = [name.split("_") for name in names]
    shared = [part for part in parts[0] if all(part in name_parts for name_parts in parts)]
    return "_".join(shared) or names[0]


_LIMB_MARKERS = ("o", "s", "^", "D", "v", "P")
"""Matplotlib's markers of the limbs."""


def _get_limb_style(limb: int) -> dict[str, Any]:
    """Return colour and marker of the limb with index ``limb``; both repeat after the last one."""
    colour = colours.SERIES_COLOURS[limb % len(colours.SERIES_COLOURS)]
    return {"color": colour, "marker": _LIMB_MARKERS[limb % len(_LIMB_MARKERS)]}


def _label_limbs(
    robots: Sequence[str], groups: Sequence[_JointGroups]
) -> Iterator[tuple[int, str]]:
    """Yield (limb index, label) of the limbs of all robots, for a common legend.

    The label is the name of the limb. If the names of limbs with this index differ between robots,
    the label contains each name with its robots. Robots with more limbs than colours are omitted.
    """
    names: defaultdict[int, defaultdict[str, list[str]]]
    names = defaultdict(lambda: defaultdict(list))
    for robot, group in zip(robots, groups, strict=True):
        if len(group.limbs) <= len(colours.SERIES_COLOURS):
            for limb, name in enumerate(group.limbs):
                names[limb][name].append(robot)
    for limb, owners in sorted(names.items()):
        if len(owners) == 1:
            yield limb, next(iter(owners))
        else:
            yield limb, ", ".join(f"{name} ({', '.join(own)})" for name, own in owners.items())


_TITLE_LETTERS = 32
"""Largest number of characters in a row of a panel's title, if a figure has two columns. Chosen for
the bold font of the title."""

_MIN_ROW_HEIGHT = 0.17
"""Smallest height of a row of the torque figure [inch], so that the markers of two limbs fit.
Chosen, not tuned."""


def _share_limits(panels: Sequence[tuple[Analysis, Axes]], axis: str) -> None:
    """Set an axis, ``x`` or ``y``, to the same range in the panels of robots with equal joints."""
    groups: defaultdict[tuple[str, ...], list[Axes]] = defaultdict(list)
    for analysis, axes in panels:
        groups[tuple(joint.name for joint in analysis.joints)].append(axes)
    for group in groups.values():
        limits = np.array([getattr(axes, f"get_{axis}lim")() for axes in group])
        ends = limits.min(axis=0), limits.max(axis=0)
        inverted = int(limits[0, 0] > limits[0, 1])
        for axes in group:
            getattr(axes, f"set_{axis}lim")(ends[inverted][0], ends[1 - inverted][1])


def _format_range(values: Array) -> str:
    """Format values as ``1`` if all are equal, else as ``1 to 3``; "unknown" without values."""
    if len(values) == 0:
        return "unknown"
    low, high = float(values.min()), float(values.max())
    return f"{low:g}" if low == high else f"{low:g} to {high:g}"


def _mark_first_contact(axes: Axes, run: StandVerification, losses: Array) -> None:
    """Mark the first contact of a link with the ground, a failure, in a plot of height losses.

    ``losses`` are those at the times of ``run.time`` [mm].
    """
    contacts = list(_list_ground_contacts(run.failures))
    if not contacts:
        return
    time = min(contacts)[0]
    links = [link for at, link in contacts if at == time]
    loss = float(np.interp(time, run.time, losses))
    axes.plot(time, loss, "o", color=colours.BLACK_COLOUR, mfc="none", mew=1.2, ms=7)
    lines = [*links[:2], f"and {len(links) - 2} more"] if len(links) > 2 else links
    axes.annotate("\n".join([*lines, f"touch the ground at {time:.2f} s"]), (time, loss),
                  xytext=(-4, 34), textcoords="offset points", ha="center", va="bottom",
                  size=drawing.FONT_SIZE - 1, parse_math=False,
                  bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.0},
                  arrowprops={"arrowstyle": "-", "lw": 0.6, "shrinkB": 3.5})  # fmt: skip


def _list_ground_contacts(failures: Sequence[Diagnostic]) -> Iterator[tuple[float, str]]:
    """Yield (time [s], link) of each contact of a link with the ground among the failures."""
    for failure in failures:
        time = failure.values.get("time")
        if failure.code == "body-touches-ground" and isinstance(time, Quantity):
            yield float(time.value), "" if failure.subject is None else failure.subject.name


def _make_sweep_title(sweeps: Sequence[GainSweep]) -> str:
    """Return the title of the gain figure, with disturbance and duration of the first sweep."""
    if not sweeps:
        return ""
    first = sweeps[0]
    disturbance = "undisturbed"
    if first.amplitude:
        disturbance = f"vertical force of {first.amplitude:g} N at {first.frequency:g} Hz"
    return (
        "Deviation of the base height by servo gains\n"
        f"position commands only, {disturbance}, last second of {first.duration:g} s"
    )


def _draw_heat_map(axes: Axes, sweep: GainSweep, scale: LogNorm, units: JointUnits) -> None:
    """Draw a heat map of a gain sweep: a cell per pair of gains, a row per kp, a column per kd.

    A cell has the colour and the number of the height deviation in the last second [mm], or the
    word "falls".
    """
    deviation = 1e3 * np.asarray(sweep.height_deviation, float)
    mapping = ScalarMappable(scale, _COLOUR_MAP)
    for row, column in np.ndindex(deviation.shape):
        value = float(deviation[row, column])
        falls = not np.isfinite(value)
        shown = max(value, MIN_SHOWN_DEVIATION)
        face = "0.8" if falls else mapping.cmap(float(scale(shown)))
        corner = (column - 0.5, row - 0.5)
        axes.add_patch(Rectangle(corner, 1, 1, facecolor=face, edgecolor="white", lw=0.8))
        bright = falls or float(scale(shown)) > _MIN_BRIGHT_FRACTION
        ink = "black" if bright else "white"
        if not falls and not sweep.lasts[row, column]:
            axes.add_patch(Rectangle(corner, 1, 1, fill=False, hatch="////", edgecolor=ink, lw=0))
        # The box keeps the hatching off the number.
        axes.text(column, row, "falls" if falls else _format_deviation(value), ha="center",
                  va="center", size=drawing.FONT_SIZE - 1.5,
                  bbox={"facecolor": face, "edgecolor": "none", "pad": 2.5},
                  color=ink)  # fmt: skip
    axes.set(xlim=(-0.5, len(sweep.kd) - 0.5), ylim=(-0.5, len(sweep.kp) - 0.5))
    axes.set_xticks(range(len(sweep.kd)), [f"{kd:g}" for kd in sweep.kd])
    axes.set_yticks(range(len(sweep.kp)), [f"{kp:g}" for kp in sweep.kp])
    axes.set_xlabel(f"kd ({units.damping})", size=drawing.FONT_SIZE)
    axes.set_ylabel(f"kp ({units.stiffness})", size=drawing.FONT_SIZE)


_MIN_BRIGHT_FRACTION = 0.44
"""Position on the colour scale of the heat map, 0 to 1, above which the number in a cell is written
in black instead of white. Above this position, black has the higher contrast ratio (WCAG 2.1) on
viridis.
"""


def _format_deviation(value: float) -> str:
    """Return a deviation [mm] to two digits, or a mark for a value below the colour scale."""
    return f"{value:.2g}" if value >= MIN_SHOWN_DEVIATION else f"<{MIN_SHOWN_DEVIATION:g}"


def _mark_own_gains(axes: Axes, sweep: GainSweep, kp: float, kd: float) -> None:
    """Outline the cell of the model's own gains ``kp``, ``kd``, if the sweep contains this pair."""
    rows, columns = np.isclose(sweep.kp, kp), np.isclose(sweep.kd, kd)
    for row in np.flatnonzero(rows):
        for column in np.flatnonzero(columns):
            # The white line is visible on dark cells, the red line on light cells.
            for colour, width in (("white", 4), (colours.RED_COLOUR, 2)):
                axes.add_patch(Rectangle((column - 0.5, row - 0.5), 1, 1, fill=False,
                                         edgecolor=colour, lw=width, zorder=3))  # fmt: skip


def _save_with_legend(figure: Figure, handles: Sequence[Any], path: str | Path) -> None:
    """Put a legend below the panels, and write the figure."""
    drawing.add_legend(figure, handles, outside=True)
    drawing.save_figure(figure, path)


FIGURES: dict[str, Callable[[Sequence[Analysis], str | Path], None]] = {
    "torques.png": write_torque_figure,
    "heights.png": write_height_figure,
    "gains.png": write_gain_figure,
}
"""{file name: drawing function} of the figures in which ``analyze`` compares robots by plots."""
