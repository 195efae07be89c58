"""Document of a payload limit: largest mass, table of the bounds, and nudged simulation.

Input is a `PayloadLimit`; output is a document that is independent of the output format, with
masses in kg and positions in mm.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from pupper_analysis.base.diagnostics.templates import format_number
from pupper_analysis.present import document as doc
from pupper_analysis.present.document import NextStep, join_words, text, word
from pupper_analysis.present.documents.loads import (
    format_example_efforts,
    format_required_effort,
    mass_text,
    round_mass,
    view_block,
)
from pupper_analysis.present.documents.registry import build_document
from pupper_analysis.present.documents.standing import (
    ground_text,
    ground_word,
    is_base_bolted,
    robot_notes,
    task_text,
)
from pupper_analysis.present.verdict import (
    TOUCH_CODE,
    join_ground_touches,
    judged_document,
    name_only_format,
    qualify_verdict_word,
    select_step_after_failure,
)
from pupper_analysis.robot.robot import Robot
from pupper_analysis.simulation.trial import Failure
from pupper_analysis.tools.payload.limit import Bound, PayloadLimit, PayloadTrial


@build_document.register(PayloadLimit)
def payload_document(limit: PayloadLimit, robot: Robot | None = None) -> doc.Document:
    """Create the document of a payload limit: mass, bounds and simulations.

    Without ``robot``, the 3-D view is empty.
    """
    trial_texts = () if limit.trial is None else (_describe_nudged_trials(limit.trial),)
    return judged_document(
        text("payload-title"),
        limit,
        (view_block(robot, limit.stand, None), payload_table(limit), *_make_bound_plots(limit)),
        (payload_text(limit),),
        limits=tuple(_list_limits(limit)),
        leading=map(doc.diagnostic_text, limit.weak_motors[:1]),
        number_first=True,
        details=(
            task_text(limit.stand.task),
            *(trial_texts if limit.passed else ()),
            text(
                "base-of-the-loaded-stand",
                place=", ".join(f"{1e3 * value:z.1f}" for value in limit.offset),
            ),
            ground_text(limit.stand.depths.values()),
        ),
        failures=() if limit.passed else trial_texts,
        word=_select_verdict_word(limit),
        notes=robot_notes(robot),
        next_step=_select_next_step(limit),
    )


_NEXT_STEPS = {
    "stance": NextStep("best", ("payload",)),
    "motors": NextStep("best", ("payload",)),
    "servos": NextStep("gains"),
    "simulation": NextStep("push"),
}
"""{name of the bound that limits the payload: command to suggest next}."""


def _select_next_step(limit: PayloadLimit) -> NextStep:
    """Return the command to suggest next, such as `best` with the objective payload."""
    if limit.unknown_limits and limit.upper_bound > 0:
        efforts = _format_example_efforts(limit)
        return NextStep("payload", efforts) if efforts else NextStep("audit")
    if not limit.passed or not limit.bounds:
        loaded = limit.carried > 0
        step = NextStep("payload", omitted=("--payload",)) if loaded else NextStep("stand")
        return select_step_after_failure(limit.verdict, step)
    step = _NEXT_STEPS.get(_find_limiting_bound(limit), NextStep("push"))
    mass = limit.upper_bound
    if step.command == "best" or not 0 < mass < math.inf:
        return step
    payload = limit.carried + round_mass(mass)
    return replace(step, words=(*step.words, "--payload", f"{payload:.6g}kg"))


def _format_example_efforts(limit: PayloadLimit) -> tuple[str, ...]:
    """Return options ``--effort`` with an example for the motors without a stated limit.

    The torques belong to the stand with the largest payload of the other bounds.
    """
    torques = {joint: float(torque) for joint, torque in limit.torque_by_joint.items()}
    return format_example_efforts(
        limit.unknown_limits, torques, {joint: limit.get_torque_unit(joint) for joint in torques}
    )


def _find_limiting_bound(limit: PayloadLimit) -> str:
    """Return the name of the smallest payload bound.

    If this is the bound of the simulation, and the next larger bound is finite and has the same
    failure, the name of this larger bound.
    """
    (name, smallest), *larger = limit.bounds.items()
    if name == "simulation" and larger and math.isfinite(larger[0][1].mass):
        return larger[0][0] if larger[0][1].failure is smallest.failure else name
    return name


def _select_verdict_word(limit: PayloadLimit) -> doc.Text:
    """Return the verdict word: UNKNOWN, FAILS, or CARRIES with the kind of torque limits."""
    if math.isnan(limit.mass) or not limit.passed:
        key = "UNKNOWN" if math.isnan(limit.mass) else "FAILS"
        return qualify_verdict_word(key, limit.verdict.converted)
    file, torque_limits = name_only_format(limit.verdict.converted), _describe_torque_limits(limit)
    kind = "peak" if torque_limits["peak"] else "continuous"
    alone = _describe_mass_by_commands_alone(limit)
    # The short form has no room beside a file, a place or a second mass.
    shown = "" if file or torque_limits["part"] or np.any(limit.point) or alone else kind
    brief = bool(torque_limits["peak"]) and not shown
    return text(
        "carries-with-limits",
        file=file,
        compensated=_carries_only_with_feedforward(limit),
        shown=shown,
        brief=brief,
        moments=not brief and not torque_limits["continuous"],
        **torque_limits,
    )


def _carries_only_with_feedforward(limit: PayloadLimit) -> bool:
    """Return True if the payload needs gravity compensation and no mass without it is computed."""
    return limit.depends_on_feedforward and math.isnan(limit.mass_by_commands_alone)


def _describe_mass_by_commands_alone(limit: PayloadLimit) -> doc.Words | str:
    """Return the mass that is carried without gravity compensation; "" if not computed."""
    mass = limit.mass_by_commands_alone
    return "" if math.isnan(mass) else mass_text(mass)


def _describe_torque_limits(limit: PayloadLimit) -> dict[str, object]:
    """Return the conditions of a payload as values of a text, such as the kind of torque limits."""
    count = len(limit.joint_torques) - len(limit.continuous) if limit.continuous else 0
    return {
        "continuous": bool(limit.continuous) and not count,
        "peak": not limit.continuous,
        "part": bool(count),
        "count": count,
    }


def payload_text(limit: PayloadLimit) -> doc.Text:
    """Return the text of the largest payload [kg], or its upper bound, and its position [mm]."""
    if limit.unknown_limits and limit.upper_bound > 0:
        return _describe_upper_bound(limit)
    line = _format_payload(limit)
    if doc.fits_first_line(_select_verdict_word(limit), limit.name, line):
        return line
    return _format_payload(limit, brief=True)


def _format_payload(limit: PayloadLimit, *, brief: bool = False) -> doc.Text:
    """Return the text of `payload_text` for known torque limits."""
    alone = _describe_mass_by_commands_alone(limit)
    return text(
        "payload-at-place",
        how=text("payload-uncompensated") if brief else text("payload-without-compensation"),
        place=_format_point(limit),
        link=limit.link,
        mass=mass_text(limit.upper_bound),
        alone=alone,
        ground=ground_word(limit.stand.depths.values()),
        # A line with two masses has no more room: line 2 states the place (`payload-limited`).
        placed=bool(np.any(limit.point)) and not alone,
        none=limit.upper_bound == 0,
        loaded=limit.carried > 0 and limit.upper_bound > 0,
        posture=is_base_bolted(limit.stand),
        only=limit.passed and _carries_only_with_feedforward(limit),
    )


def _format_point(limit: PayloadLimit) -> str:
    """Return the position of a payload in its link, in mm: ``0, 0, 150``."""
    return ", ".join(f"{1e3 * value:.0f}" for value in limit.point)


def _list_limits(limit: PayloadLimit) -> Iterator[doc.Words]:
    """Yield the failures with and without gravity compensation, and the load of the motors.

    Nothing if the payload depends on unknown torque limits.
    """
    if limit.unknown_limits and limit.upper_bound > 0:
        return
    name, following = _find_following_bound(limit)
    is_same = _fails_alone_alike(limit)
    yield _describe_limiting_failure(limit, alone_alike=is_same)
    if limit.failures_alone and not is_same:
        mass = mass_text(limit.mass_by_commands_alone)
        yield text("payload-alone-limited", mass=mass, failure=_describe_failure_alone(limit))
    motors = () if "motors" in limit.binding else tuple(_describe_motor_utilisation(limit))
    if following is not None:
        cause, bound = word(following.failure.value), text(_BOUND_KEYS[name])
        next_mass = mass_text(following.mass)
        bound_text = text("payload-next-bound", next=next_mass, cause=cause, bound=bound)
        if name == "motors":  # in short the utilisation, as if no mass saturates a motor
            for line in motors:
                bound_text = bound_text.with_short_form(line)
        yield bound_text
    if name != "motors":
        yield from motors


def _fails_alone_alike(limit: PayloadLimit) -> bool:
    """Return True if the same body touches the ground at the limits with and without feed-forward.

    The limits are ``upper_bound`` and ``mass_by_commands_alone``.
    """
    touching = {
        failure.subject.name
        for failure in limit.failures_alone[:1]
        if failure.code == TOUCH_CODE and failure.subject is not None
    }
    return limit.failure is Failure.GROUND and not touching.isdisjoint(limit.failing_parts)


def _describe_failure_alone(limit: PayloadLimit) -> doc.Text:
    """Return the text of the failure without gravity compensation; without time for the ground."""
    failure = join_ground_touches(limit.failures_alone)[0]
    touching = [
        failure_alone for failure_alone in limit.failures_alone if failure_alone.code == TOUCH_CODE
    ]
    names = tuple(touch.subject.name for touch in touching if touch.subject is not None)
    if limit.failures_alone[0].code == TOUCH_CODE and names:
        return text("ground-touched-by", failure=word(Failure.GROUND.value), where=names)
    return doc.diagnostic_text(failure)


def _describe_motor_utilisation(limit: PayloadLimit) -> Iterator[doc.Text]:
    """Yield the torque and the limit of the motor that is loaded most at the largest payload."""
    shares = limit.motor_utilisation
    if not np.isfinite(shares).any():
        return
    hardest = int(np.nanargmax(np.where(np.isfinite(shares), shares, -1.0)))
    torque = abs(float(limit.joint_torques[hardest]))
    if torque > 0:
        yield text(
            "payload-of-motors",
            torque=format_number(torque, ".3g"),
            share=format_number(100 * float(shares[hardest]), ".2g"),
            limit=format_number(torque / float(shares[hardest]), ".3g"),
            unit=limit.torque_units[hardest],
            joint=doc.Name(limit.joint_names[hardest]),
        )


def _find_following_bound(limit: PayloadLimit) -> tuple[str, Bound | None]:
    """Return name and value of the next larger finite bound with another failure, if any."""
    return next(
        (
            (name, bound)
            for name, bound in limit.bounds.items()
            if limit.mass < bound.mass < math.inf and bound.failure is not limit.failure
        ),
        ("", None),
    )


def _describe_limiting_failure(limit: PayloadLimit, *, alone_alike: bool) -> doc.Words:
    """Return the text of the failure that limits the payload.

    ``alone_alike`` states that the same failure limits the payload without gravity compensation.
    """
    alone = limit.passed and not math.isnan(limit.mass_by_commands_alone)
    return text(
        "payload-limited",
        mass=mass_text(limit.upper_bound),
        alone=alone and not alone_alike,
        both=alone_alike,
        place=_format_point(limit) if alone and np.any(limit.point) else "",
        failure=_describe_failure(limit.failure, limit.failing_parts),
    )


def _describe_upper_bound(limit: PayloadLimit) -> doc.Text:
    """Return the text of the upper bound of the mass if torque limits are unknown."""
    torques = limit.torque_by_joint
    hardest = max(limit.unknown_limits, key=lambda joint: abs(float(torques[joint])))
    torque = format_required_effort(float(torques[hardest]))
    return text(
        "payload-unknown",
        place=_format_point(limit),
        link=limit.link,
        mass=mass_text(limit.upper_bound),
        bounded=math.isfinite(limit.upper_bound),
        torque=f"{torque} {limit.get_torque_unit(hardest)}",
        hardest=doc.Name(hardest),
    )


def payload_table(limit: PayloadLimit) -> doc.Table:
    """Create the table of payload bounds [kg], smallest first, and of the failure above a bound.

    The bound of the simulation is omitted if it is infinite or NaN.
    """
    rows: list[tuple[doc.Cell, ...]] = [
        (text(_BOUND_KEYS[name]), mass_text(bound.mass), _describe_bound_failure(bound))
        for name, bound in limit.bounds.items()
        if name != "simulation" or math.isfinite(bound.mass)
    ]
    notes: list[doc.Words] = [text("payload-is-static")]
    if limit.unknown_limits:
        notes.append(
            text(
                "motors-without-effort-limit",
                count=len(limit.unknown_limits),
                joints=join_words(map(doc.Name, limit.unknown_limits)),
            )
        )
    return doc.Table(
        text("what-bounds-the-payload"),
        (
            doc.Column(text("bound"), left=True),
            doc.Column(text("payload")),
            doc.Column(text("what-then-fails"), left=True),
        ),
        tuple(rows),
        tuple(notes),
    )


def _make_bound_plots(limit: PayloadLimit) -> Iterator[doc.BarPlot]:
    """Yield the bar plot of the finite bounds of the payload [kg], if there is such a bound."""
    bars = [
        doc.PlotBar(text(_BOUND_KEYS[name]), bound.mass, label=mass_text(bound.mass))
        for name, bound in limit.bounds.items()
        if math.isfinite(bound.mass)
    ]
    if bars:
        axis = doc.Axis(text("payload"), "kg", ".2f")
        yield doc.BarPlot(text("payload-by-bound"), axis, bars, (axis.name, None, None))


_BOUND_KEYS = {
    "stance": "loaded-stance",
    "motors": "motors",
    "servos": "servos-stiffness",
    "simulation": "payload-nudged",
}
"""{bound of the payload: key of the bound's name in the catalogue}."""


def _describe_bound_failure(bound: Bound) -> doc.Words:
    """Return the text of the failure above a bound; a dash if the bound is infinite."""
    if math.isinf(bound.mass):
        return doc.Name("-")
    return _describe_failure(bound.failure, bound.failing_parts)


def _describe_failure(failure: Failure, where: Iterable[str]) -> doc.Words:
    """Return the text of a failure with the names ``where`` of motors, joints, feet or bodies."""
    failure_text, names = word(failure.value), tuple(where)
    if not names:
        return failure_text
    key = "ground-touched-by" if failure is Failure.GROUND else "failure-where"
    return text(key, failure=failure_text, where=names)


def _describe_nudged_trials(trial: PayloadTrial) -> doc.Text:
    """Return the text that the robot with the payload holds or fails in nudged simulations."""
    mass, seconds = mass_text(trial.mass), f"{trial.duration:g}"
    if trial.failure is None:
        return text(
            "simulated-with-mass",
            mass=mass,
            seconds=seconds,
            simulated=f"{trial.simulated:.3g}",
            count=trial.nudges,
        )
    return text(
        "simulated-with-mass-on-it-seconds",
        mass=mass,
        seconds=seconds,
        time=f"{trial.time:.2f}",
        failure=_describe_failure(trial.failure, trial.failing_parts),
    )
