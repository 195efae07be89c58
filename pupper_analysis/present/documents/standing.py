"""Parts that documents of stands share: task, ground, quantities of the stand, simulations.

Inputs are a stand, its static equilibrium and its simulations; outputs are texts, tables, plots and
motions of `document`. Lengths are in m in results, and in mm in tables and plots.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Sequence
from typing import Any

import numpy as np

from pupper_analysis.base.diagnostics import merge_diagnostics
from pupper_analysis.present import document as doc
from pupper_analysis.present.document import Column, Text, Words, diagnostic_text, text
from pupper_analysis.present.documents.loads import proof_text
from pupper_analysis.present.documents.sources import cite_page, files_text
from pupper_analysis.robot.plane import Weld
from pupper_analysis.robot.robot import Robot
from pupper_analysis.simulation.monitor import MEASURING_TIME
from pupper_analysis.simulation.verify import StandVerification
from pupper_analysis.stance.stand import Stand
from pupper_analysis.stance.task import StandTask
from pupper_analysis.statics.equilibrium import GravityCompensation


def quantity_columns(*values: Words, of: str = "quantity") -> tuple[Column, ...]:
    """Create the columns of a table that has a quantity per row: name, values, unit.

    ``values`` are the headers of the value columns, ``of`` is the catalogue key of the first
    header.
    """
    named = values or (text("value"),)
    middle = (Column(name) for name in named)
    return (Column(text(of), left=True), *middle, Column(text("unit"), left=True))


def task_text(task: StandTask) -> Text:
    """Return the description of a stand task in both languages."""
    return Text(str(task), lambda: task.describe("zh"))


def robot_notes(robot: Robot | None) -> tuple[Words, ...]:
    """Create the notes of a report on a robot: its files, and changes by the preparation."""
    return (
        ()
        if robot is None
        else (files_text(robot), *map(diagnostic_text, merge_diagnostics(robot.notes)))
    )


def is_base_bolted(stand: Stand) -> bool:
    """Return True if a weld fixes the base or a link rigidly joined to it, and no foot bears load.

    A weld of a foot, or of a link behind joints, does not count: it has a contact point.
    """
    points = set(stand.foot_targets)
    parts = points | {point.rpartition("/")[0] for point in points}  # a sole: left/1, left/2 ...
    welds = [name for name, contact in stand.task.contacts.items() if isinstance(contact, Weld)]
    return any(name not in parts for name in welds) and not stand.stance_feet


def ground_text(depths: Iterable[float]) -> Text:
    """Create the sentence that states for which ground a stand was solved: soft or rigid.

    ``depths`` are penetrations of the feet into MuJoCo's soft ground [m]; all zero for rigid
    ground.
    """
    deepest = max(depths, default=0.0)
    if not deepest:
        return text("feet-sunk-into-mujocos-soft")
    return text(
        "all-this-is-on-mujocos",
        depth=f"{1e3 * deepest:.2f}",
    )


def ground_word(depths: Iterable[float], run: StandVerification | None = None) -> Text:
    """Create the short text that states for which ground a stand was solved: soft or rigid.

    ``depths`` are penetrations of the feet into MuJoCo's soft ground [m]; all zero for rigid
    ground. For rigid ground, the text states the height loss of the base in ``run``, if any.
    """
    if max(depths, default=0.0):
        return text("on-simulated-ground")
    is_lower = run is not None and not run.collapses and run.height_loss > 0
    return text("on-rigid-ground", loss=f"{1e3 * run.height_loss:.1f}" if run and is_lower else "")


def stand_table(stand: Stand, statics: GravityCompensation | None) -> doc.Table:
    """Create the table of a stand: height, CoM margin, clearances, largest friction utilisation.

    Quantities that are unknown or not finite are omitted.
    """
    near, links = stand.ground_clearance, stand.self_clearance
    loads = statics.foot_loads.values() if statics is not None else ()
    known: tuple[tuple[str, float | None, str, float, str], ...] = (
        ("height-of-the-base", stand.task.height, "mm", 1e3, ".1f"),
        ("com-margin", stand.com_margin, "mm", 1e3, ".1f"),
        ("ground-clearance", near.distance if near else None, "mm", 1e3, ".1f"),
        ("distance-between-links", links.distance if links else None, "mm", 1e3, ".1f"),
        (
            "friction-used",
            max((load.friction_utilisation for load in loads), default=None),
            "%",
            100.0,
            ".1f",
        ),
    )
    rows = tuple(
        (text(name), doc.number_cell(value, form, scale=scale), doc.Name(unit))
        for name, value, unit, scale, form in known
        if value is not None and math.isfinite(value)
    )
    columns = quantity_columns()
    return doc.Table(text("stance"), columns, rows, detail=True)


def height_plot(runs: Sequence[StandVerification], task: float) -> doc.LinePlot:
    """Create the plot of the simulated base height [mm] over time [s], with the requested height.

    Each of ``runs`` is a line; ``task`` is the requested height [m].
    """
    series = [
        doc.Series(
            text("with-feed-forward") if run.feedforward else text("without"),
            run.time,
            1e3 * run.height,
            note=_format_mean_loss(run, task),
        )
        for run in runs
    ]
    ends = np.array([runs[0].time[0], max(run.time[-1] for run in runs)])
    asked = doc.Name(f"{1e3 * task:.1f} mm")
    series.append(
        doc.Series(text("task"), ends, np.full(2, 1e3 * task), note=asked, reference=True)
    )
    return doc.LinePlot(
        text("height-of-the-simulated-base"),
        doc.Axis(text("time"), "s", ".2f"),
        doc.Axis(text("base-height"), "mm", ".2f"),
        series,
        text("plot-height-lost"),
    )


def _format_mean_loss(run: StandVerification, task: float) -> doc.Words:
    """Format the mean height loss of the base [mm] in the last second of a simulation.

    The loss is the requested height ``task`` [m] minus the mean height. The part by which the
    contacts sink in (`StandVerification.contact_sag`) is added if the robot holds and the part is
    not 0.00 mm.
    """
    last = run.time > run.time[-1] - MEASURING_TIME
    loss = task - float(np.mean(run.height[last]))
    shown = doc.number_cell(loss, ".2f", scale=1e3).text
    if run.failures:
        return text("loss-fails", loss=shown)
    if 1e3 * run.contact_sag >= _MIN_SHOWN_PENETRATION:
        return text("loss-by-penetration", loss=shown, part=f"{1e3 * run.contact_sag:.2f}")
    return doc.Name(f"{shown} mm")


_MIN_SHOWN_PENETRATION = 0.005
"""Smallest part of a height loss [mm] that is stated: the smallest that is not rounded to 0."""


def list_motions(runs: Sequence[StandVerification]) -> list[doc.Motion]:
    """Convert the recorded configurations of simulations to motions that a 3-D view can play."""
    return [
        doc.Motion(
            text("simulated-with-feed-forward")
            if run.feedforward
            else text("simulated-without-feed-forward"),
            run.motion_time,
            run.motion,
        )
        for run in runs
    ]


def run_rows(
    runs: Sequence[Any], names: Collection[str] | None = None
) -> tuple[tuple[doc.Cell, ...], ...]:
    """Create the rows of a table of simulated quantities, with a column per simulation.

    ``runs`` may also be other results with the same quantities, such as ``SteadyState``. ``names``
    are catalogue keys of the quantities; by default all.
    """
    rows: list[tuple[doc.Cell, ...]] = []
    for name, unit, of, format, scale in _RUN_QUANTITIES:
        if names is not None and name not in names:
            continue
        values = [of(run) for run in runs]
        if name == _JOINT_ERROR and values.count(None) == len(values):
            continue  # the joints that are off the most are hinges, or slides
        cells = (doc.number_cell(value, format, scale=scale) for value in values)
        rows.append((text(name), *cells, doc.Name(unit)))
    return tuple(rows)


def _get_joint_error(run: StandVerification, unit: str) -> float | None:
    """Return the joint error of a simulation [rad, m]; None if the error has another unit."""
    return run.joint_error if run.joint_error_unit == unit else None


_JOINT_ERROR = "joint-error"
"""Catalogue key of the joint error, whose unit is that of a hinge [deg] or a slide [mm]."""


def simulated_table(run: StandVerification) -> doc.Table:
    """Create the table of the quantities of a simulation: height losses, tilt, slip, errors."""
    return doc.Table(
        text("simulation", seconds=f"{run.duration:g}"),
        quantity_columns(text("with-feed-forward") if run.feedforward else text("without")),
        run_rows([run]),
        (),
        (cite_page("explanation/verification.md", "Random stances"), proof_text(run)),
        detail=True,
    )


SAG_QUANTITIES = ("loss-of-height", "of-it-servo-sag", "of-it-contact-softness")
"""Catalogue keys of the height losses: total, from the servos, and from soft contacts."""

_RUN_QUANTITIES: tuple[
    tuple[str, str, Callable[[StandVerification], float | None], str, float], ...
] = (
    ("base-height", "mm", lambda run: run.base_height, ".2f", 1e3),
    ("loss-of-height", "mm", lambda run: run.height_loss, ".3f", 1e3),
    ("of-it-servo-sag", "mm", lambda run: run.servo_sag, ".3f", 1e3),
    ("of-it-contact-softness", "mm", lambda run: run.contact_sag, "+.3f", 1e3),
    (
        "deviation-of-height-last-second",
        "mm",
        lambda run: run.height_deviation,
        ".5f",
        1e3,
    ),
    ("drift-of-height-last-second", "mm/s", lambda run: run.height_drift, "+.4f", 1e3),
    ("tilt-against-the-task", "°", lambda run: math.degrees(run.tilt), ".4f", 1.0),
    ("foot-slip", "mm", lambda run: max(run.foot_slip.values(), default=0.0), ".4f", 1e3),
    (_JOINT_ERROR, "°", lambda run: _get_joint_error(run, "rad"), ".2g", math.degrees(1.0)),
    (_JOINT_ERROR, "mm", lambda run: _get_joint_error(run, "m"), ".2g", 1e3),
    ("torque-off-prediction-of-the-largest", "%", lambda run: run.torque_error, ".3f", 100.0),
    ("vertical-foot-force-off-prediction", "%", lambda run: run.force_error, ".3f", 100.0),
)
"""Rows of the table of a simulated stand: catalogue key of the quantity, displayed unit, value,
format of numbers, and factor from the value to the displayed number."""
