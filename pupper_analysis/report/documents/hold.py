"""The document of a posture that is held: what it costs, and whether it holds."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.analysis.hold import Hold
from pupper_analysis.report import document as doc
from pupper_analysis.report.documents.loads import origins_text, torque_plot, torque_table
from pupper_analysis.report.documents.registry import build_document
from pupper_analysis.report.documents.standing import robot_notes
from pupper_analysis.report.verdict import verdict_lines, verdict_word
from pupper_analysis.report.words import text
from pupper_analysis.robot.robot import Robot


@build_document.register(Hold)
def hold_document(hold: Hold, robot: Robot | None = None) -> doc.Document:
    """Returns what a posture that is held costs, and whether it holds; see ``build``."""
    limits, run = hold.limits.tolist(), hold.verification
    verdict = verdict_lines(hold.verdict)
    return doc.Document(
        text("held-posture"),
        doc.Name(hold.name),
        (
            _torques(hold, limits),
            torque_plot(hold.statics, run.joint_torques.tolist(), limits),
            _tool(hold),
        ),
        passed=hold.passed,
        verdict=verdict_word(hold.verdict),
        failures=() if hold.passed else tuple(line for line in verdict if line.mark != "good"),
        told=(
            _posture(hold),
            *(line for line in verdict if hold.passed or line.mark == "good"),
            *_told(hold),
        ),
        notes=(_agreement(hold), *robot_notes(robot)),
    )


def _torques(hold: Hold, limits: list[float]) -> doc.Table:
    """Returns what every motor holds, and how far its joint sags."""
    none = [float("nan")] * len(limits)
    sag = none if hold.sagged is None else hold.sagged.joint_sag.tolist()
    simulated = (hold.sagging.joint_positions - hold.posture.qpos).tolist()
    table = torque_table(
        hold.statics,
        limits,
        {
            doc.Column(text("simulated"), "N m"): hold.verification.joint_torques.tolist(),
            doc.Column(text("position"), "rad"): hold.posture.qpos.tolist(),
            doc.Column(text("joint-sag"), "rad"): sag,
            doc.Column(text("joint-sag-simulated"), "rad"): simulated,
        },
    )
    notes: list[doc.Words] = [text("limit-origins", origins=origins_text(hold.limit_origins))]
    if "m" in hold.units:
        slides = [
            name
            for name, unit in zip(hold.posture.joint_names, hold.units, strict=True)
            if unit == "m"
        ]
        notes.append(text("units-of-slides", joints=", ".join(slides)))
    return replace(table, notes=tuple(notes))


def _tool(hold: Hold) -> doc.Table:
    """Returns where the tool is, and how far it sags."""
    sagged = None if hold.sagged is None else hold.sagged.tool_sag
    places = (
        ("tool-position", hold.tool_position, "+.1f"),
        ("tool-sag", sagged, "+.2f"),
        ("tool-sag-simulated", hold.sagging.tool_sag, "+.2f"),
    )
    rows = tuple((text(name), *_millimetres(place, form)) for name, place, form in places)
    columns = (
        doc.Column(text("quantity"), left=True),
        *(doc.Column(doc.Name(axis), "mm") for axis in "xyz"),
        doc.Column(text("length"), "mm"),
    )
    return doc.Table(text("tool-of-link", tool=doc.Name(hold.tool.name)), columns, rows)


def _millimetres(place: NDArray[np.float64] | None, form: str) -> Iterable[doc.Cell]:
    """Returns the cells of a vector (3,) and its length; dashes where there is none."""
    if place is None:
        return (doc.number_cell(None, form),) * 4
    parts = (doc.number_cell(value, form, scale=1e3) for value in place.tolist())
    return (*parts, doc.number_cell(float(np.linalg.norm(place)), form[1:], scale=1e3))


def _posture(hold: Hold) -> doc.Words:
    given = ", ".join(hold.posture.given)
    if hold.posture.keyframe:
        return text("posture-of-keyframe", keyframe=hold.posture.keyframe, given=given)
    return text("posture-of-middle", given=given)


def _told(hold: Hold) -> Iterable[doc.Words]:
    used = hold.statics.motor_utilisation
    limited = np.isfinite(hold.limits) & np.isfinite(used)
    if limited.any():
        worst = int(np.argmax(np.where(limited, used, -1.0)))
        yield text(
            "motor-that-holds-most",
            joint=doc.Name(hold.statics.joint_names[worst]),
            share=f"{used[worst]:.1%}",
            torque=f"{hold.statics.joint_torques[worst]:.3g}",
            limit=f"{hold.limits[worst]:.3g}",
        )
    if hold.sagged is not None:
        yield text(
            "tool-sags-by",
            tool=doc.Name(hold.tool.name),
            predicted=f"{1e3 * float(np.linalg.norm(hold.sagged.tool_sag)):.2f}",
            simulated=f"{1e3 * float(np.linalg.norm(hold.sagging.tool_sag)):.2f}",
        )
    elif hold.unsettled is not None:
        yield text("no-sag-predicted", why=doc.tell(hold.unsettled))


def _agreement(hold: Hold) -> doc.Words:
    return text("gravity-by-both-engines", residual=f"{hold.verification.mujoco_residual:.1e}")
