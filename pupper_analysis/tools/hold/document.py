"""The document of a posture that is held: what it costs, and whether it holds."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import Quantity
from pupper_analysis.base.units import READ_IN
from pupper_analysis.present import document as doc
from pupper_analysis.present.document import join_words, text
from pupper_analysis.present.documents.loads import (
    limit_cell,
    origins_text,
    torque_plot,
    torque_table,
    utilisation_cell,
)
from pupper_analysis.present.documents.registry import build_document
from pupper_analysis.present.documents.standing import robot_notes
from pupper_analysis.present.verdict import judged_document
from pupper_analysis.robot.robot import Robot
from pupper_analysis.statics.equilibrium import GravityCompensation
from pupper_analysis.tools.hold.force import ToolForce
from pupper_analysis.tools.hold.hold import VERIFIED_FRACTION, Hold, ReachLoad
from pupper_analysis.tools.hold.worst import WorstPostures

_RINGS = 12
"""Distances of the tool that are told apart: some 50 random postures each."""


@build_document.register(Hold)
def hold_document(hold: Hold, robot: Robot | None = None) -> doc.Document:
    """Create the report of a held posture: torques, worst postures, payload, push force, verdict.

    `build_document` calls this function for a `Hold`.

    Args:
        hold: Result.
        robot: Robot of the result, for notes; None if it is not available.
    """
    limits, run = hold.limits.tolist(), hold.verification
    return judged_document(
        text("held-posture"),
        hold,
        (
            _torques(hold, limits),
            torque_plot(hold.statics, run.joint_torques.tolist(), limits),
            _tool(hold),
            _worst(hold.worst, shown_scales(hold.units)),
            reach_plot(hold.reach),
            _payload(hold),
            _force(hold),
            force_plot(hold.force),
        ),
        (_posture(hold), *_findings(hold)),
        notes=robot_notes(robot),
    )


def _torques(hold: Hold, limits: list[float]) -> doc.Table:
    """Returns what every motor holds, and how far its joint sags."""
    sag: list[float | None] = [None] * len(limits)
    scales = shown_scales(hold.units)
    if hold.settled is not None:
        sag = (scales * (hold.settled.qpos - hold.posture.qpos)).tolist()
    simulated = (scales * (hold.sagging.joint_positions - hold.posture.qpos)).tolist()
    table = torque_table(
        hold.statics,
        limits,
        {
            doc.Column(text("simulated"), "N m"): hold.verification.joint_torques.tolist(),
            doc.Column(text("position"), "°"): (scales * hold.posture.qpos).tolist(),
            doc.Column(text("joint-sag"), "°"): sag,
            doc.Column(text("joint-sag-simulated"), "°"): simulated,
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
    places = (
        ("tool-position", hold.tool_position, "+.1f"),
        ("tool-sag", hold.tool_sag, "+.2f"),
        ("tool-sag-simulated", hold.simulated_tool_sag, "+.2f"),
    )
    rows = [
        (
            text(name),
            doc.vector_cell(1e3 * place, form),
            doc.number_cell(float(np.linalg.norm(place)), form[1:], scale=1e3),
        )
        for name, place, form in places
        if place is not None
    ]
    columns = (
        doc.Column(text("quantity"), left=True),
        doc.Column(doc.Name("x y z"), "mm", left=True),
        doc.Column(text("length"), "mm"),
    )
    return doc.Table(text("tool-of-link", tool=doc.Name(hold.tool.name)), columns, tuple(rows))


def shown_scales(units: Iterable[str]) -> NDArray[np.float64]:
    """Return factors, shape (nu,), that convert joint positions to the displayed units.

    Args:
        units: Unit of each joint position: rad (displayed in degrees) or m (displayed in mm).
    """
    return np.array([READ_IN[unit][0] for unit in units])


def _worst(worst: WorstPostures, scales: NDArray[np.float64]) -> doc.Table:
    rows: list[tuple[doc.Cell, ...]] = [
        (
            doc.Name(name),
            doc.number_cell(worst.joint_torques[index], "+.4g"),
            limit_cell(float(worst.limits[index])),
            utilisation_cell(float(worst.utilisation[index]), float(worst.limits[index])),
            doc.vector_cell(scales * worst.postures[index], ".1f"),
        )
        for index, name in enumerate(worst.joint_names)
    ]
    columns = (
        doc.Column(text("joint"), left=True),
        doc.Column(text("worst-torque"), "N m"),
        doc.Column(text("limit"), "N m"),
        doc.Column(text("utilisation"), "%"),
        doc.Column(text("worst-posture"), "°", left=True, detail=True),
    )
    notes = (text("worst-found"),)
    if worst.endless is not None:
        notes = (text("worst-not-bounded", why=doc.diagnostic_text(worst.endless)),)
    return doc.Table(text("worst-postures"), columns, tuple(rows), notes=notes)


def _payload(hold: Hold) -> doc.Table:
    payload = hold.payload
    known = (
        ("payload-here", payload.mass, payload.joint),
        ("payload-by-servos", payload.servos, payload.servo),
        ("payload-somewhere", payload.somewhere, payload.weakest),
    )
    rows = [(text(name), mass, joint) for name, mass, joint in known]
    first, most = doc.Column(text("quantity"), left=True), doc.Column(text("mass"), "kg")
    return _limits(text("payload-at-the-tool"), first, most, rows, (*_tried(hold),))


def _limits(
    title: doc.Text,
    first: doc.Column,
    most: doc.Column,
    rows: Iterable[tuple[doc.Cell, float, str]],
    notes: tuple[doc.Text, ...],
) -> doc.Table:
    """Returns a table of greatest values, and whose motor is at its limit with each."""
    cells = tuple((what, _limit_cell(value), doc.Name(joint or "-")) for what, value, joint in rows)
    last = doc.Column(text("motor-at-its-limit"), left=True)
    return doc.Table(title, (first, most, last), cells, notes=notes)


def _limit_cell(value: float) -> doc.Cell:
    """Return a greatest value; a word if torque limits that it depends on are unknown."""
    return text("limit-unknown") if math.isnan(value) else doc.number_cell(value, ".4g")


def _tried(hold: Hold) -> Iterator[doc.Text]:
    """Yields what became of the payload that was simulated, if one was."""
    trial, share = hold.payload_trial, f"{VERIFIED_FRACTION:.0%}"
    if trial is not None and trial.passed:
        yield text("payload-trial-holds", share=share)
    elif trial is not None:
        why = join_words(map(doc.diagnostic_text, trial.failures), "semicolon")
        yield text("payload-trial-fails", share=share, why=why)


def _force(hold: Hold) -> doc.Table:
    """Returns how hard the tool can be pushed, each way."""
    force = hold.force
    ways = (
        *zip(force.directions, force.forces.tolist(), force.joints, strict=True),
        (force.weakest_direction, force.weakest, force.weakest_joint),
    )
    rows = [(doc.vector_cell(way, "+.2f"), limit, joint) for way, limit, joint in ways]
    first, most = doc.Column(text("direction-x-y-z"), left=True), doc.Column(text("force"), "N")
    return _limits(text("force-on-the-tool"), first, most, rows, (text("last-row-is-the-weakest"),))


def force_plot(force: ToolForce) -> doc.LinePlot:
    """Create the plot of the largest forces on a tool in three sections, in N, world axes."""
    sections = (("section-x-y", force.horizontal), ("section-x-z", force.sagittal))
    series = []
    for name, radii in (*sections, ("section-y-z", force.frontal)):
        around = np.append(np.arange(len(radii)), 0)
        lengths = np.where(np.isfinite(radii), radii, np.nan)[around]
        turned = force.angles[around]
        across, up = lengths * np.cos(turned), lengths * np.sin(turned)
        series.append(doc.Series(text(name), across, up))
    axis = doc.Axis(text("force-along-first-axis"), "N", ".0f")
    other = doc.Axis(text("force-along-second-axis"), "N", ".0f")
    return doc.LinePlot(text("forces-withstood"), axis, other, series)


def reach_plot(reach: ReachLoad) -> doc.LinePlot:
    """Create the plot of motor utilisation over the tool's distance from the first joint.

    It shows the maximum and the mean over random postures, in percent over mm.
    """
    edges = np.linspace(0.0, float(reach.distances.max(initial=1e-9)), _RINGS + 1)
    ring = np.clip(np.digitize(reach.distances, edges) - 1, 0, _RINGS - 1)
    full = np.unique(ring)
    middle = 1e3 * (edges[full] + edges[full + 1]) / 2
    shares = np.where(np.isfinite(reach.utilisation), reach.utilisation, np.nan)
    per_ring = [100 * shares[ring == one] for one in full]
    axis = doc.Axis(text("distance-from-the-first-joint"), "mm", ".0f")
    share = doc.Axis(text("utilisation"), "%", ".1f")
    lines = (
        doc.Series(text("greatest-found"), middle, np.array([one.max() for one in per_ring])),
        doc.Series(text("mean-of-postures"), middle, np.array([one.mean() for one in per_ring])),
    )
    return doc.LinePlot(text("utilisation-over-the-reach"), axis, share, lines)


def _posture(hold: Hold) -> doc.Words:
    posture = hold.posture
    at = {
        joint: format(Quantity(position, unit), "read:.4g")
        for joint, position, unit in zip(posture.joint_names, posture.qpos, hold.units, strict=True)
    }
    places = [text("joint-at", joint=joint, position=at[joint]) for joint in posture.given]
    given = join_words(places) if places else ""
    if posture.keyframe:
        where = text("posture-of-keyframe", keyframe=posture.keyframe, given=given)
    else:
        where = text("posture-of-middle", given=given)
    if hold.hangs:
        where = text("posture-hanging", where=where)
    if not hold.carried:
        return where
    return text("posture-with-payload", where=where, mass=f"{hold.carried:g}")


def hardest_motor(statics: GravityCompensation, limits: NDArray[np.float64]) -> Iterable[doc.Words]:
    """Yield a sentence that names the motor with the largest utilisation.

    Nothing is yielded if no motor has a limit, or if a motor has no torque.

    Args:
        statics: Torques of the motors.
        limits: Effort limits, shape (nu,) [N m].
    """
    used = statics.motor_utilisation
    limited = np.isfinite(limits) & np.isfinite(used)
    if limited.any() and limits[limited].all():
        worst = int(np.argmax(np.where(limited, used, -1.0)))
        yield text(
            "motor-that-holds-most",
            joint=doc.Name(statics.joint_names[worst]),
            share=f"{used[worst]:.1%}",
            torque=f"{statics.joint_torques[worst]:.3g}",
            limit=f"{limits[worst]:.3g}",
        )


def _findings(hold: Hold) -> Iterable[doc.Words]:
    yield from hardest_motor(hold.statics, hold.limits)
    if hold.tool_sag is not None:
        yield text(
            "tool-sags-by",
            tool=doc.Name(hold.tool.name),
            predicted=f"{1e3 * float(np.linalg.norm(hold.tool_sag)):.2f}",
            simulated=f"{1e3 * float(np.linalg.norm(hold.simulated_tool_sag)):.2f}",
        )
    elif hold.unsettled is not None:
        yield text("no-sag-predicted", why=doc.diagnostic_text(hold.unsettled))
    weak = [
        name
        for name, used in zip(hold.worst.joint_names, hold.worst.utilisation, strict=True)
        if used > 1
    ]
    if weak:
        yield text("motors-weak-somewhere", joints=", ".join(weak)).with_mark("warn")
    if hold.payload.unknown:
        yield _unknown(hold).with_mark("warn")
        return
    if hold.payload.servos < hold.payload.mass:
        yield text(
            "servos-too-soft-for-payload",
            tool=doc.Name(hold.tool.name),
            mass=f"{hold.payload.servos:.3g}",
            joint=hold.payload.servo,
        ).with_mark("warn")
    yield text(
        "carries-and-withstands",
        tool=doc.Name(hold.tool.name),
        here=_limit(hold.payload.mass),
        somewhere=_limit(hold.payload.somewhere),
        force=_limit(hold.force.weakest),
    )
    if hold.payload_trial is not None and not hold.payload_trial.passed:
        yield from (words.with_mark("warn") for words in _tried(hold))


def _unknown(hold: Hold) -> doc.Text:
    """Return that no file states what the motors carry, and the torques that they need."""
    worst = np.abs(hold.worst.joint_torques)
    joints = [hold.worst.joint_names.index(name) for name in hold.payload.unknown]
    hardest = max(joints, key=lambda joint: float(worst[joint]))
    return text(
        "tool-payload-unknown",
        tool=doc.Name(hold.tool.name),
        count=len(joints),
        joints=join_words(map(doc.Name, hold.payload.unknown)),
        here=f"{float(np.abs(hold.statics.joint_torques[joints]).max()):.3g}",
        worst=f"{float(worst[hardest]):.3g}",
        hardest=doc.Name(hold.worst.joint_names[hardest]),
    )


def _limit(most: float) -> str:
    """Writes a limit; nothing where there is none."""
    return (f"{most:.3g}" if most < 1e3 else f"{most:.0f}") if math.isfinite(most) else ""
