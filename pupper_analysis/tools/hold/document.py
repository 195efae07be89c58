"""Document of a posture of a robot with a fixed base: statics, simulation, verdict, tool limits.

Input is a `Hold`; output is a document that is independent of the output format, with angles in
degrees and lengths in mm.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import LANGUAGES, Quantity
from pupper_analysis.base.diagnostics.templates import format_number
from pupper_analysis.base.units import round_down
from pupper_analysis.present import document as doc
from pupper_analysis.present.document import join_words, text
from pupper_analysis.present.documents.loads import (
    describe_slides,
    format_example_efforts,
    format_peak_load,
    get_display_scales,
    limit_cell,
    origins_text,
    torque_plot,
    torque_table,
    utilisation_cell,
)
from pupper_analysis.present.documents.registry import build_document
from pupper_analysis.present.documents.servos import split_servo_statement
from pupper_analysis.present.documents.standing import robot_notes
from pupper_analysis.present.verdict import (
    OVERLOAD_CODE,
    clause_text,
    judged_document,
    qualify_verdict_word,
    select_step_after_failure,
    verdict_clauses,
    verdict_word,
)
from pupper_analysis.robot.robot import Robot
from pupper_analysis.simulation.verdict import IMPOSSIBLE_CODES, VerdictCode
from pupper_analysis.simulation.verify import JOINT_TOLERANCE
from pupper_analysis.statics.equilibrium import GravityCompensation
from pupper_analysis.tools.hold.force import ToolForce
from pupper_analysis.tools.hold.hold import Hold, ReachLoad
from pupper_analysis.tools.hold.worst import WorstPostures

_NUM_DISTANCE_BINS = 12
"""Number of bins of the tool's distance in the plot over the reach. Chosen, not tuned."""


MIN_FURTHER_SHARE = 0.1
"""Further payload, divided by the present payload [1], above which a further payload is proposed. A
smaller further payload may be the amount that the last proposal lost by rounding. Chosen, not
tuned."""


@build_document.register(Hold)
def hold_document(hold: Hold, robot: Robot | None = None) -> doc.Document:
    """Create the report of a held posture: torques, worst postures, tool limits and verdict."""
    limits = hold.limits.tolist()
    qualified = hold.verdict.code is VerdictCode.HOLDS_WITH_FEEDFORWARD
    soft = tuple(_describe_soft_servos(hold)) if qualified else ()
    document = judged_document(
        text("held-posture"),
        hold,
        (
            _make_torque_table(hold, limits),
            hold_torque_plot(hold),
            _make_tool_table(hold),
            _make_worst_table(hold.worst, get_display_scales(hold.units)),
            reach_plot(hold.reach),
            _make_payload_table(hold),
            _make_force_table(hold),
            *force_plots(hold.force),
        ),
        (
            _describe_worst_posture(hold),
            *(() if soft or not qualified else (_describe_worst_payload(hold),)),
            *_describe_loads(hold),
            *_list_warnings(hold),
        ),
        # Line 2 is the reason for a qualified verdict: soft servos, or a text of the verdict.
        limits=() if qualified and not soft else (*soft, _describe_worst_payload(hold)),
        leading=map(doc.diagnostic_text, hold.weak_motors[:1]),
        details=(*_list_findings(hold),),
        word=_select_verdict_word(hold),
        notes=robot_notes(robot),
        next_step=_select_next_step(hold),
    )
    document = _state_overload_first(document, hold)
    if not _states_added_servos(hold):
        return document
    kept, moved = split_servo_statement(document.findings, hold.verdict.servos)
    return replace(document, findings=kept, details=(*document.details, *moved))


def _state_overload_first(document: doc.Document, hold: Hold) -> doc.Document:
    """Move overloaded motors to the start of the failures, after the motor with the most load.

    The document is unchanged if a motor named by the caller is too weak, or if a mass or an inertia
    is impossible: these reasons come first.
    """
    verdict = hold.verdict
    overloaded = tuple(
        clause_text(clause)
        for clause in verdict_clauses(verdict)
        if clause.message.code == OVERLOAD_CODE
    )
    impossible = any(remark.code in IMPOSSIBLE_CODES for remark in verdict.remarks)
    if verdict.passed or not overloaded or hold.weak_motors or impossible:
        return document
    load = text("most-overloaded-motor", **format_peak_load(hold.statics)).with_mark("bad")
    others = (failure for failure in document.failures if failure not in overloaded)
    return replace(document, failures=(load, *overloaded, *others))


def _select_verdict_word(hold: Hold) -> doc.Text | None:
    """Return the verdict word "holds in this posture only", or None if it does not apply."""
    if hold.passed and _find_overloaded_motors(hold):
        return qualify_verdict_word("holds-in-one-posture", hold.verdict.converted)
    return None


def _is_payload_simulated(hold: Hold) -> bool:
    """Return True if the simulation of the posture limits the payload, and no motor."""
    return hold.simulated_mass < hold.payload.worst_posture_mass


def _find_overloaded_motors(hold: Hold) -> list[str]:
    """Return the joints whose motors exceed their limits in the worst posture of a search."""
    return [
        name
        for name, share in zip(hold.worst.joint_names, hold.worst.utilisation, strict=True)
        if share > 1
    ]


def _select_next_step(hold: Hold) -> doc.NextStep:
    """Return the command to suggest next, for example `hold` with the largest payload.

    If no payload is left to propose, it is `gains`.
    """
    payload = hold.largest_mass
    overloaded = hold.carried > 0 and bool(_find_overloaded_motors(hold))
    if not hold.passed:
        step = doc.NextStep("audit")
        if hold.carried > 0:
            step = doc.NextStep("hold", omitted=("--payload",))
        return select_step_after_failure(hold.verdict, step)
    if overloaded:
        return doc.NextStep("hold", omitted=("--payload",))
    if math.isnan(payload) and (efforts := _format_example_efforts(hold)):
        return doc.NextStep("hold", efforts)
    if not math.isfinite(payload) or payload <= MIN_FURTHER_SHARE * hold.carried:
        return doc.NextStep("gains", ("--contact", "base=weld"), omitted=("--payload",))
    carried = hold.carried + round_down(payload, 2)
    return doc.NextStep("hold", ("--payload", f"{carried:.6g}kg"))


def _format_example_efforts(hold: Hold) -> tuple[str, ...]:
    """Return options ``--effort`` with an example for the motors without a stated limit.

    The torques belong to the worst postures. Empty if they are zero.
    """
    worst = hold.worst
    torques = dict(zip(worst.joint_names, worst.joint_torques.tolist(), strict=True))
    units = dict(zip(worst.joint_names, hold.statics.torque_units, strict=True))
    return format_example_efforts(hold.payload.unknown, torques, units)


def _describe_worst_posture(hold: Hold) -> doc.Words:
    """Return the text of the largest motor utilisation, or torque, over all postures found.

    If the first line has no room, the utilisation is stated without "of the limit".
    """
    word = _select_verdict_word(hold) or verdict_word(hold.verdict)
    line = _format_worst_posture(hold, full=True)
    if doc.fits_first_line(word, hold.name, line):
        return line
    return _format_worst_posture(hold, full=False)


def _format_worst_posture(hold: Hold, *, full: bool) -> doc.Text:
    """Return the text of `_describe_worst_posture`; in short with "of the limit" if ``full``."""
    worst = hold.worst
    known = np.isfinite(worst.limits) & ~np.isnan(worst.utilisation)
    torques = np.abs(worst.joint_torques)
    index = int(np.argmax(np.where(known, worst.utilisation, -1.0) if known.any() else torques))
    share = float(worst.utilisation[index]) if known.any() else math.nan
    return text(
        "worst-posture-in-short",
        torque=format_number(float(torques[index]), ".3g"),
        unit=hold.statics.torque_units[index],
        share=f"{100 * share:.3g}" if math.isfinite(share) else "",
        full=full and math.isfinite(share),
        joint=doc.Name(worst.joint_names[index]),
        hangs=hold.hangs,
    )


def _describe_soft_servos(hold: Hold) -> Iterator[doc.Words]:
    """Yield the sag of the tool [mm] without feed-forward, as the effect of a stiffness too low.

    Nothing is yielded if the predicted sag of each joint is within the tolerance of a verified
    posture (`JOINT_TOLERANCE`), or if there is no prediction.
    """
    if hold.settled is None or hold.tool_sag is None:
        return
    if np.abs(hold.settled.qpos - hold.posture.qpos).max() <= JOINT_TOLERANCE:
        return
    servos = hold.verdict.servos
    lowest, highest = servos.kp
    yield text(
        "posture-servos-too-soft",
        kp=format_number(lowest, ".3g") if lowest == highest > 0 else "",
        unit=servos.stiffness_unit,
        tool=doc.Name(hold.tool.name),
        sag=format_number(1e3 * float(np.linalg.norm(hold.tool_sag)), ".3g"),
    )


def _describe_worst_payload(hold: Hold) -> doc.Words:
    """Return the text of the payload limit over all postures found."""
    payload, joint = hold.largest_mass, hold.payload.worst_posture_joint
    simulated = _is_payload_simulated(hold)
    alone = hold.mass_by_commands_alone
    if math.isnan(payload) and (efforts := _format_example_efforts(hold)):
        tool, example = doc.Name(hold.tool.name), ", ".join(efforts[1::2])
        return text("worst-payload-unknown", tool=tool, example=example)
    return text(
        "worst-posture-payload",
        tool=doc.Name(hold.tool.name),
        payload=_format_payload_limit(payload),
        joint=doc.Name(joint) if joint else "",
        worst=not (hold.hangs or simulated),
        motor=bool(joint) and not simulated,
        # The line with this mass has no room for the statement on the added servos.
        added=_states_added_servos(hold),
        alone="" if math.isnan(alone) else _format_payload_limit(alone),
        simulated=simulated,
        motors=_format_payload_limit(hold.payload.worst_posture_mass),
        loaded=hold.carried > 0,
        unstated=math.isnan(payload),
    )


def _states_added_servos(hold: Hold) -> bool:
    """Return True if the payload limit contains the words that servos were added."""
    return bool(hold.verdict.servos.made) and not math.isnan(hold.mass_by_commands_alone)


def _format_payload_limit(payload: float) -> doc.Words:
    """Return the text of a payload limit [kg] with its unit; a word if unlimited or unknown."""
    if math.isfinite(payload):
        return doc.Name(f"{_format_limit(payload)} kg")
    return text("limit-unknown") if math.isnan(payload) else text("no-tool-limit")


def _describe_loads(hold: Hold) -> Iterator[doc.Words]:
    """Yield a line with the posture, its most utilised motor (if known), and the payload limit."""
    loads = tuple(describe_hardest_motor(hold.statics, hold.limits))
    posture = _describe_posture(hold)
    yield text(
        "posture-and-load",
        posture=posture,
        load=loads[0] if loads else "",
        payload=_format_payload_limit(hold.largest_mass_here),
        loaded=hold.carried > 0,
        tool=doc.Name(hold.tool.name),
    )


def _make_torque_table(hold: Hold, limits: list[float]) -> doc.Table:
    """Create the table of motor torques, effort limits [N m, N] and joint deflections."""
    sag: list[float | None] = [None] * len(limits)
    scales = get_display_scales(hold.units)
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
    notes += describe_slides(hold.posture.joint_names, hold.units)
    return replace(table, notes=tuple(notes))


def _make_tool_table(hold: Hold) -> doc.Table:
    """Create the table of the tool's position, and of its predicted and simulated sag [mm]."""
    vectors = (
        ("tool-position", hold.tool_position, "+.1f"),
        ("tool-sag", hold.tool_sag, "+.2f"),
        ("tool-sag-simulated", hold.simulated_tool_sag, "+.2f"),
    )
    rows = [
        (
            text(name),
            doc.vector_cell(1e3 * vector, form),
            doc.number_cell(float(np.linalg.norm(vector)), form[1:], scale=1e3),
        )
        for name, vector, form in vectors
        if vector is not None
    ]
    columns = (
        doc.Column(text("quantity"), left=True),
        doc.Column(doc.Name("x y z"), "mm", left=True),
        doc.Column(text("length"), "mm"),
    )
    return doc.Table(text("tool-of-link", tool=doc.Name(hold.tool.name)), columns, tuple(rows))


def _make_worst_table(worst: WorstPostures, scales: NDArray[np.float64]) -> doc.Table:
    """Create the table of the worst posture that was found for each motor, a row per motor.

    ``scales``, shape (nu,), convert joint positions [rad, m] to deg and mm.
    """
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


def _make_payload_table(hold: Hold) -> doc.Table:
    """Create the table of the payload limits at the tool [kg], with the limiting joints."""
    payload = hold.payload
    limits = (
        ("payload-here", payload.mass, payload.joint),
        ("payload-by-servos", payload.servos, payload.servo),
        ("payload-somewhere", payload.worst_posture_mass, payload.worst_posture_joint),
    )
    rows = [(text(name), mass, joint) for name, mass, joint in limits]
    return _make_limit_table(
        text("payload-at-the-tool"),
        doc.Column(text("quantity"), left=True),
        doc.Column(text("mass"), "kg"),
        rows,
        (*_describe_payload_simulation(hold),),
    )


def _make_limit_table(
    title: doc.Text,
    quantity_column: doc.Column,
    limit_column: doc.Column,
    rows: Iterable[tuple[doc.Cell, float, str]],
    notes: tuple[doc.Text, ...],
) -> doc.Table:
    """Create a table of limits, each with the joint that reaches the effort or command limit.

    Each of ``rows`` is (quantity, limit, joint); the joint is "" if no joint limits the quantity.
    """
    cells = tuple(
        (quantity, _make_limit_cell(limit), doc.Name(joint or "-"))
        for quantity, limit, joint in rows
    )
    joint_column = doc.Column(text("motor-at-its-limit"), left=True)
    return doc.Table(title, (quantity_column, limit_column, joint_column), cells, notes=notes)


def _make_limit_cell(value: float) -> doc.Cell:
    """Create a table cell with a limit, such as a payload [kg], rounded down to four digits.

    The cell contains a word if the limit is unknown.
    """
    if math.isnan(value):
        return text("limit-unknown")
    return replace(doc.number_cell(round_down(value, 4), ".4g"), value=value)


def _describe_payload_simulation(hold: Hold) -> Iterator[doc.Text]:
    """Yield the result of the simulation with a payload; nothing if none was simulated."""
    trial, mass = hold.payload_trial, _format_payload_limit(hold.simulated_mass)
    if trial is not None and trial.passed:
        yield text("payload-trial-holds", mass=mass)
    elif trial is not None:
        reasons = join_words(map(doc.diagnostic_text, trial.failures), "semicolon")
        yield text("payload-trial-fails", mass=mass, why=reasons)


def _make_force_table(hold: Hold) -> doc.Table:
    """Create the table of the largest forces [N] on the tool that the motors withstand."""
    force = hold.force
    limits = (
        *zip(force.directions, force.forces.tolist(), force.joints, strict=True),
        (force.weakest_direction, force.weakest, force.weakest_joint),
    )
    rows = [
        (doc.vector_cell(direction, "+.2f"), limit, joint) for direction, limit, joint in limits
    ]
    return _make_limit_table(
        text("force-on-the-tool"),
        doc.Column(text("direction-x-y-z"), left=True),
        doc.Column(text("force"), "N"),
        rows,
        (text("last-row-is-the-weakest"),),
    )


def hold_torque_plot(hold: Hold) -> doc.BarPlot:
    """Create the plot of the motor utilisation in the posture, and in the worst postures."""
    posture = _describe_posture(hold)
    short = doc.Text(*(doc.translate(posture, language, short=True) for language in LANGUAGES))
    return torque_plot(
        hold.statics,
        hold.verification.joint_torques.tolist(),
        hold.limits.tolist(),
        title=text("torques-in-posture", posture=short),
        worst=hold.worst.utilisation.tolist(),
    )


def force_plots(force: ToolForce) -> tuple[doc.LinePlot, doc.LinePlot]:
    """Create the plots of the largest forces [N] on a tool that the motors withstand.

    Closed curves in the planes of the world axes show the force by direction: a plot of the
    horizontal plane, and a plot of the two vertical planes.
    """
    x, y, z, horizontal = (
        doc.Axis(text(f"force-along-{name}"), "N", ".0f") for name in ("x", "y", "z", "x-or-y")
    )
    flat = _make_force_curve("section-x-y", force.horizontal, force)
    upright = (
        _make_force_curve("section-x-z", force.sagittal, force),
        _make_force_curve("section-y-z", force.frontal, force),
    )
    titles = text("forces-in-horizontal-plane"), text("forces-in-vertical-planes")
    return (
        doc.LinePlot(titles[0], x, y, [flat], equal_scales=True),
        doc.LinePlot(titles[1], horizontal, z, upright, equal_scales=True),
    )


def _make_force_curve(key: str, radii: NDArray[np.float64], force: ToolForce) -> doc.Series:
    """Create a closed curve of forces [N] with lengths ``radii``, shape (n,), by direction."""
    closed = np.append(np.arange(len(radii)), 0)  # the curve ends at its first point
    lengths = np.where(np.isfinite(radii), radii, np.nan)[closed]
    angles = force.angles[closed]
    return doc.Series(text(key), lengths * np.cos(angles), lengths * np.sin(angles))


def reach_plot(reach: ReachLoad) -> doc.LinePlot:
    """Create the plot of motor utilisation [%] over the tool's distance from the first joint [mm].

    The distance is horizontal. The plot shows the maximum and the mean over the random postures in
    bins of the distance.
    """
    edges = np.linspace(0.0, float(reach.distances.max(initial=1e-9)), _NUM_DISTANCE_BINS + 1)
    bins = np.clip(np.digitize(reach.distances, edges) - 1, 0, _NUM_DISTANCE_BINS - 1)
    filled = np.unique(bins)
    centres = 1e3 * (edges[filled] + edges[filled + 1]) / 2
    shares = np.where(np.isfinite(reach.utilisation), reach.utilisation, np.nan)
    bin_shares = [100 * shares[bins == index] for index in filled]
    distance_axis = doc.Axis(text("distance-from-the-first-joint"), "mm", ".0f")
    share_axis = doc.Axis(text("utilisation"), "%", ".1f")
    lines = (
        doc.Series(text("greatest-found"), centres, np.array([part.max() for part in bin_shares])),
        doc.Series(
            text("mean-of-postures"), centres, np.array([part.mean() for part in bin_shares])
        ),
    )
    return doc.LinePlot(text("utilisation-over-the-reach"), distance_axis, share_axis, lines)


def _describe_posture(hold: Hold) -> doc.Words:
    """Return the text of the posture: source, given joint positions, hanging robot, and payload."""
    posture = hold.posture
    positions = {
        joint: format(Quantity(position, unit), "read:.4g")
        for joint, position, unit in zip(posture.joint_names, posture.qpos, hold.units, strict=True)
    }
    parts = [
        text("joint-at", joint=joint, position=positions[joint])
        for joint in posture.requested_joints
    ]
    given = join_words(parts) if parts else ""
    if posture.keyframe:
        description = text("posture-of-keyframe", keyframe=posture.keyframe, given=given)
    else:
        description = text("posture-of-middle", given=given)
    if hold.hangs:
        description = text("posture-hanging", where=description)
    if not hold.carried:
        return description
    return text("posture-with-payload", where=description, mass=f"{hold.carried:g}")


def describe_hardest_motor(
    statics: GravityCompensation, limits: NDArray[np.float64]
) -> Iterable[doc.Words]:
    """Yield the text of the motor with the largest torque relative to its limit, if known.

    Nothing is yielded if a limit is zero. ``limits`` contains the effort limits, shape (nu,) [N m,
    or N for a slide].
    """
    shares = statics.motor_utilisation
    limited = np.isfinite(limits) & np.isfinite(shares)
    if limited.any() and not (limits == 0).any():
        worst = int(np.argmax(np.where(limited, shares, -1.0)))
        yield text(
            "motor-that-holds-most",
            joint=doc.Name(statics.joint_names[worst]),
            share=format_number(shares[worst], ".1%"),
            torque=format_number(float(statics.joint_torques[worst]), ".3g"),
            limit=format_number(float(limits[worst]), ".3g"),
            unit=statics.torque_units[worst],
        )


def _list_findings(hold: Hold) -> Iterable[doc.Words]:
    """Yield the texts of findings: sag of the tool [mm], payload [kg] and force limits [N]."""
    if hold.tool_sag is not None:
        yield text(
            "tool-sags-by",
            tool=doc.Name(hold.tool.name),
            predicted=f"{1e3 * float(np.linalg.norm(hold.tool_sag)):.2f}",
            simulated=f"{1e3 * float(np.linalg.norm(hold.simulated_tool_sag)):.2f}",
        )
    elif hold.unsettled is not None:
        yield text("no-sag-predicted", why=doc.diagnostic_text(hold.unsettled))
    if not hold.payload.unknown:
        yield text(
            "carries-and-withstands",
            tool=doc.Name(hold.tool.name),
            here=_format_limit(hold.payload.mass),
            somewhere=_format_limit(hold.payload.worst_posture_mass),
            force=_format_limit(hold.force.weakest),
        )


def _list_warnings(hold: Hold) -> Iterator[doc.Words]:
    """Yield the warnings on motors, effort limits, servos and payload."""
    if weak := _find_overloaded_motors(hold):
        yield text("motors-weak-somewhere", joints=", ".join(weak)).with_mark("warn")
    if hold.payload.unknown:
        yield _describe_unknown_limits(hold).with_mark("warn")
        return
    if hold.payload.servos < hold.payload.mass:
        yield text(
            "servos-too-soft-for-payload",
            tool=doc.Name(hold.tool.name),
            mass=_format_limit(hold.payload.servos),
            joint=hold.payload.servo,
        ).with_mark("warn")
    if hold.payload_trial is not None and not hold.payload_trial.passed:
        yield from (words.with_mark("warn") for words in _describe_payload_simulation(hold))


def _describe_unknown_limits(hold: Hold) -> doc.Text:
    """State which motors have unknown effort limits, and their largest torque [N m, N]."""
    worst = np.abs(hold.worst.joint_torques)
    joints = [hold.worst.joint_names.index(name) for name in hold.payload.unknown]
    most_loaded = max(joints, key=lambda joint: float(worst[joint]))
    here = np.abs(hold.statics.joint_torques)
    most_here = max(joints, key=lambda joint: float(here[joint]))
    return text(
        "tool-payload-unknown",
        tool=doc.Name(hold.tool.name),
        count=len(joints),
        joints=join_words(map(doc.Name, hold.payload.unknown)),
        here=format_number(float(here[most_here]), ".3g"),
        worst=format_number(float(worst[most_loaded]), ".3g"),
        here_unit=hold.statics.torque_units[most_here],
        worst_unit=hold.statics.torque_units[most_loaded],
        hardest=doc.Name(hold.worst.joint_names[most_loaded]),
    )


def _format_limit(limit: float) -> str:
    """Return a limit, rounded down to three significant digits; "" if the limit is not finite."""
    return format_number(round_down(limit, 3), ".3g") if math.isfinite(limit) else ""
