"""Document of a path to a stance: plan, simulation and verdict.

Input is a simulated path; output is a document that is independent of the output format, with an
animated 3-D view of the plan.
"""

from __future__ import annotations

import math

from pupper_analysis.base.diagnostics import Quantity
from pupper_analysis.base.units import convert_to_display
from pupper_analysis.present import document as doc
from pupper_analysis.present.document import join_words, text
from pupper_analysis.present.documents.loads import format_share, format_share_values, view_block
from pupper_analysis.present.documents.motors import describe_motor_energy
from pupper_analysis.present.documents.registry import build_document
from pupper_analysis.present.documents.servos import exceeds_explicit_damping
from pupper_analysis.present.documents.standing import quantity_columns, robot_notes, task_text
from pupper_analysis.present.verdict import (
    judged_document,
    select_step_after_failure,
    verdict_word,
)
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.path.plan import StancePath
from pupper_analysis.tools.path.tracking import PathThere, PathTracking


@build_document.register(PathThere)
def path_document(there: PathThere, robot: Robot | None = None) -> doc.Document:
    """Create the report of a planned path and its simulation, with an animated 3-D view."""
    path, tracking = there.path, there.tracking
    used = path.peak_utilisation
    ideal = exceeds_explicit_damping(there)
    good_step = "gains" if ideal else "payload" if path.has_motion else "workspace"
    motion = doc.Motion(text("the-path"), path.time, path.qpos)
    place = f" of the limit ({path.peak_joint})"
    answer = (
        text(
            "path-in-short",
            error=format(Quantity(tracking.joint_error, tracking.joint_error_unit), "read:.2g"),
            place="" if path.has_motion or not math.isfinite(used) else place,
            height=f"{1e3 * tracking.height_error:.1f}",
            seconds=f"{path.time[-1]:.4g}",
            still=not path.has_motion,
            **format_share_values(used),
            joint=doc.Name(path.peak_joint),
            time=f"{path.peak_time:.2f}",
        ),
        text(
            "tracking-in-short",
            torque=f"{100 * tracking.torque_error:.1f}",
            slip=f"{1e3 * max(tracking.foot_slip.values()):.1f}",
        ),
    )
    loads = doc.LinePlot(
        text("load-of-the-feet-along"),
        doc.Axis(text("time"), "s", ".2f"),
        doc.Axis(text("load"), "N", ".2f"),
        [
            doc.Series(doc.Name(foot), path.time, path.loads[:, index])
            for index, foot in enumerate(path.feet)
        ],
    )
    return judged_document(
        text("path-to-a-stance"),
        there,
        (
            view_block(robot, there.stand, None, [motion]),
            _make_plan_table(path),
            _make_tracking_table(tracking),
            loads,
        ),
        answer,
        word=verdict_word(there.verdict, ideal_servos=ideal),
        limit=_describe_limit(path),
        details=(
            task_text(there.stand.task),
            *_describe_motor_regions(path),
            *describe_motor_energy(tracking.energy),
        ),
        notes=robot_notes(robot),
        next_step=doc.NextStep(good_step)
        if there.passed
        else select_step_after_failure(there.verdict, doc.NextStep("stand")),
    )


def _describe_limit(path: StancePath) -> doc.Words | None:
    """Return the text of the motor with the largest load; without motion, of the missing goal.

    None if no torque limit is stated.
    """
    if not path.has_motion:
        return text("path-without-goal")
    if not math.isfinite(path.peak_utilisation):
        return None
    return text(
        "path-load-in-short",
        share=format_share(path.peak_utilisation),
        joint=doc.Name(path.peak_joint),
        time=f"{path.peak_time:.2f}",
    )


def _describe_motor_regions(path: StancePath) -> list[doc.Words]:
    """Return the text with the motors whose torque-speed regions define the utilisation, if any."""
    names = dict.fromkeys(path.motors.values())
    return [text("path-of-motors", motors=join_words(map(doc.Name, names)))] if names else []


def _make_plan_table(path: StancePath) -> doc.Table:
    """Create the table of the planned path: duration [s], peak utilisations [%], margins [mm]."""
    peak = text(
        "greatest-torque-of-motors",
        joint=doc.Name(path.peak_joint),
        time=f"{path.peak_time:.2f}",
    )
    return _make_quantity_table(
        text("the-path-title"),
        (text("time"), "s", float(path.time[-1]), ".4g"),
        *_make_utilisation_row(peak, path.peak_utilisation),
        *_make_utilisation_row(text("greatest-speed-of-joints"), path.peak_speed_utilisation),
        (text("least-com-margin"), "mm", 1e3 * float(path.com_margin.min()), ".1f"),
        (
            text("least-margin-of-the-zero"),
            "mm",
            1e3 * float(path.zmp_margin.min()),
            ".1f",
        ),
        note=text("torques-and-speeds"),
    )


def _make_utilisation_row(name: doc.Text, share: float) -> list[tuple[doc.Text, str, float, str]]:
    """Return the table row of a utilisation (value / limit) [1], or no row for NaN."""
    return [] if math.isnan(share) else [(name, "%", 100 * share, ".1f")]


def _make_tracking_table(tracking: PathTracking) -> doc.Table:
    """Create the table of the simulated path, with the largest value of each error."""
    joint_error = convert_to_display(tracking.joint_error, tracking.joint_error_unit)
    return _make_quantity_table(
        text("how-it-is-followed"),
        (text("torque-error-of-the-largest"), "%", 100 * tracking.torque_error, ".1f"),
        (text("joint-error"), *joint_error, ".2f"),
        (text("error-of-height"), "mm", 1e3 * tracking.height_error, ".1f"),
        (text("error-of-orientation"), "°", math.degrees(tracking.orientation_error), ".2f"),
        (text("foot-slip"), "mm", 1e3 * max(tracking.foot_slip.values()), ".1f"),
    )


def _make_quantity_table(
    title: doc.Words, *quantities: tuple[doc.Words, str, float, str], note: doc.Words | None = None
) -> doc.Table:
    """Create a table of quantities from tuples (name, unit, value, number format)."""
    return doc.Table(
        title,
        quantity_columns(),
        tuple(
            (name, doc.number_cell(value, number_format), doc.Name("" if unit == "1" else unit))
            for name, unit, value, number_format in quantities
        ),
        () if note is None else (note,),
    )
