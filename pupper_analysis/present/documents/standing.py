"""What documents of stands share: the robot, what is asked, the ground, units, simulations."""

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
from pupper_analysis.robot.robot import Robot
from pupper_analysis.simulation.monitor import MEASURING_TIME
from pupper_analysis.simulation.verify import StandVerification
from pupper_analysis.stance.stand import Stand
from pupper_analysis.stance.task import StandTask
from pupper_analysis.statics.equilibrium import GravityCompensation


def quantity_columns(*values: Words, of: str = "quantity") -> tuple[Column, ...]:
    """Returns the columns of such a table.

    Args:
        *values: Of which runs or files the values are; ``value`` alone where none is given.
        of: What each row is; a key of the catalogue.
    """
    named = values or (text("value"),)
    middle = (Column(name) for name in named)
    return (Column(text(of), left=True), *middle, Column(text("unit"), left=True))


def task_text(task: StandTask) -> Text:
    """Returns what is asked of a stand, as the task itself says it."""
    return Text(str(task), lambda: task.describe("zh"))


def robot_notes(robot: Robot | None) -> tuple[Words, ...]:
    """Returns a robot's files, and what was assumed of it."""
    return (
        ()
        if robot is None
        else (files_text(robot), *map(diagnostic_text, merge_diagnostics(robot.notes)))
    )


def ground_text(depths: Iterable[float]) -> Text:
    """Says on which ground it was simulated, of feet that sink in by ``depths`` (m), or do not."""
    deepest = max(depths, default=0.0)
    if not deepest:
        return text("feet-sunk-into-mujocos-soft")
    return text(
        "all-this-is-on-mujocos",
        depth=f"{1e3 * deepest:.2f}",
    )


def ground_word(depths: Iterable[float]) -> Text:
    """Says of which ground numbers are: of feet that sink in by ``depths`` (m), or do not."""
    return text("on-simulated-ground" if max(depths, default=0.0) else "on-rigid-ground")


def stand_table(stand: Stand, statics: GravityCompensation | None) -> doc.Table:
    """Returns how high a stand is, and how far from falling, from touching and from slipping."""
    near, links = stand.ground_clearance, stand.self_clearance
    loads = statics.foot_loads.values() if statics is not None else ()
    known: tuple[tuple[str, float | None, str, float, str], ...] = (
        ("height-of-the-base", stand.task.height, "mm", 1e3, ".1f"),
        ("com-margin", stand.com_margin, "mm", 1e3, ".1f"),
        ("ground-clearance", near.distance if near else None, "mm", 1e3, ".1f"),
        ("distance-between-links", links.distance if links else None, "mm", 1e3, ".1f"),
        (
            "friction-used",
            max((one.friction_utilisation for one in loads), default=None),
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
    """Draws the base's height over the simulated time, with feed-forward and without.

    Args:
        runs: The simulations.
        task: The height that was asked for (m).
    """
    series = [
        doc.Series(
            text("with-feed-forward") if run.feedforward else text("without"),
            run.time,
            1e3 * run.height,
            note=_mean_loss(run, task),
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


def _mean_loss(run: StandVerification, task: float) -> doc.Words:
    """Return the height loss, averaged over the last second of the curve, as the caption states.

    ``run.height_loss`` is the mean over the second before the nudge instead.
    """
    last = run.time > run.time[-1] - MEASURING_TIME
    loss = task - float(np.mean(run.height[last]))
    shown = doc.number_cell(loss, ".2f", scale=1e3).text
    return text("loss-fails", loss=shown) if run.failures else doc.Name(f"{shown} mm")


def list_motions(runs: Sequence[StandVerification]) -> list[doc.Motion]:
    """Returns the simulated motions."""
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
    """Returns what simulations made of a stand: a row per quantity, a column per run.

    Args:
        runs: ``StandVerification`` each, or what else has the quantities, such as ``SteadyState``.
        names: Keys of the quantities; by default all.
    """
    return tuple(
        (
            text(name),
            *(doc.number_cell(of(run), format, scale=scale) for run in runs),
            doc.Name(unit),
        )
        for name, unit, of, format, scale in _QUANTITIES
        if names is None or name in names
    )


def simulated_table(run: StandVerification) -> doc.Table:
    """Returns what one simulation made of a stand."""
    return doc.Table(
        text("simulation", seconds=f"{run.duration:g}"),
        quantity_columns(text("with-feed-forward") if run.feedforward else text("without")),
        run_rows([run]),
        (),
        (cite_page("explanation/verification.md", "Random stances"), proof_text(run)),
        detail=True,
    )


SAG_QUANTITIES = ("loss-of-height", "of-it-servo-sag", "of-it-contact-softness")
"""Quantities of a run that are predicted, too."""

_QUANTITIES: tuple[
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
    ("joint-error", "°", lambda run: math.degrees(run.joint_error), ".2g", 1.0),
    ("torque-off-prediction-of-the-largest", "%", lambda run: run.torque_error, ".3f", 100.0),
    ("vertical-foot-force-off-prediction", "%", lambda run: run.force_error, ".3f", 100.0),
)
"""What is shown of a run: name, unit, value in SI units, its format, and what it is scaled by."""
