"""Documents of a stance, and of the preparation of a robot from the files.

Inputs are a `Stance` or a preparation; outputs are documents that are independent of the output
format, with values in printed units.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from pupper_analysis.base.arguments import match_names
from pupper_analysis.base.diagnostics import format_number, merge_diagnostics
from pupper_analysis.base.units import find_common_units, round_up
from pupper_analysis.prepare.causes import STIFFNESS_FACTOR
from pupper_analysis.prepare.passes import PassRun
from pupper_analysis.present import document as doc
from pupper_analysis.present.document import NextStep, join_words, text, word
from pupper_analysis.present.documents.loads import (
    format_peak_load,
    get_display_scales,
    load_blocks,
    view_block,
)
from pupper_analysis.present.documents.registry import build_document
from pupper_analysis.present.documents.servos import (
    describe_servo_gains,
    exceeds_explicit_damping,
    format_bound,
    make_bound_cell,
    split_servo_statement,
)
from pupper_analysis.present.documents.standing import (
    ground_text,
    ground_word,
    height_plot,
    is_base_bolted,
    list_motions,
    robot_notes,
    simulated_table,
    stand_table,
    task_text,
)
from pupper_analysis.present.verdict import is_support_disabled, judged_document, verdict_word
from pupper_analysis.robot.robot import Robot
from pupper_analysis.simulation.servo_bounds import ServoBounds
from pupper_analysis.simulation.verdict import (
    TIE_MESSAGE_CODES,
    TWO_ROBOTS_CODE,
    Ending,
    VerdictCode,
)
from pupper_analysis.simulation.verify import StandVerification
from pupper_analysis.stance.sag.steady_state import RELEASE_MARGIN, SteadyState
from pupper_analysis.tools.stand.stance import Preparation, Stance


@build_document.register(Preparation)
def preparation_document(loading: Preparation, _: Robot | None = None) -> doc.Document:
    """Create the report of how a robot was loaded: preparation passes and their changes."""
    robot = text(
        "robot-free" if loading.floating else "robot-held",
        mass=doc.format_widened(loading.mass, ".3f"),
        joints=len(loading.joints),
        feet=loading.feet,
    )
    changing = [run for run in loading.passes if run.done]
    idle = [run for run in loading.passes if not run.done]
    changes = text(
        "passes-that-changed",
        count=len(changing),
        passes=len(loading.passes),
        names=tuple(run.name for run in changing),
    )
    tables = [
        *([_make_pass_table(text("passes-run"), changing)] if changing else []),
        *([_make_pass_table(text("passes-idle"), idle, detail=True)] if idle else []),
    ]
    shown = {note for run in loading.passes for note in run.done}
    return doc.Document(
        text("loading-title"),
        doc.Name(loading.name),
        tuple(tables),
        passed=True,
        verdict=text("READY"),
        findings=(robot, changes if loading.passes else text("files-are-ready")),
        next_step=NextStep("stand" if loading.floating else "hold", omitted=("--explain",)),
        notes=tuple(
            map(
                doc.diagnostic_text,
                merge_diagnostics([note for note in loading.notes if note not in shown]),
            )
        ),
    )


def _make_pass_table(
    title: doc.Words, passes: Iterable[PassRun], *, detail: bool = False
) -> doc.Table:
    """Create the table of preparation passes: name, purpose, and a row per change of each pass."""
    rows: list[tuple[doc.Cell, ...]] = []
    for run in passes:
        done = tuple(map(doc.diagnostic_text, run.done)) or (text("nothing-to-do"),)
        rows += [(doc.Name(run.name), word(run.does), done[0])]
        rows += [(doc.Name(""), doc.Name(""), change) for change in done[1:]]
    columns = tuple(
        doc.Column(text(key), left=True)
        for key in ("pass-of-loading", "what-it-does", "what-it-did")
    )
    return doc.Table(title, columns, tuple(rows), detail=detail)


MAX_UNREPORTED_RESIDUAL = 1e-4
"""Bound of the residual of the static balance in MuJoCo (`StandVerification.mujoco_residual`) [N, N
m]. Above the bound, the report warns that the two models differ. Chosen, not tuned.
"""


@build_document.register(Stance)
def stance_document(stance: Stance, robot: Robot | None = None) -> doc.Document:
    """Create the report of a stance: torques, contact forces, simulation and verdict.

    Without ``robot``, the 3-D view is empty.
    """
    run = stance.verification
    stand = stance.stand
    positions = get_display_scales(stance.units) * stance.joint_positions
    soft = tuple(_describe_soft_servos(stance))
    gains = tuple(describe_servo_gains(stance.servos, stance.verdict.servos))
    requested = tuple(_describe_minimum_stiffness(stance))
    # Line 2 is the reason for a qualified verdict: texts of the verdict, before the gains.
    qualified = stance.verdict.code is VerdictCode.HOLDS_WITH_FEEDFORWARD and not soft
    # If the first finding does not fit into line 2 after the gains, the base height takes its room.
    preceding = (*requested, *soft, *gains)
    findings = tuple(_list_findings(stance, preceding))
    fits = _fits_second_line(*preceding, *findings[:1])
    height_first = stance.passed and not qualified and not fits
    # The cause of a failure of the unmodified file is part of the verdict.
    own_soft = _has_soft_drives(stance)
    # A file that ties the robot to the world explains a failure, unlike soft servos.
    skipped = own_soft or _is_tied(stance)
    causes = () if skipped else (*soft, *(gains if _is_damping_excessive(stance) else ()))
    blocks = [
        view_block(robot, stand, stance.statics, list_motions([run])),
        *load_blocks(
            stance.statics,
            stance.min_max_torque,
            run,
            stance.limits.tolist(),
            stance.limit_origins,
            stance.units,
            {doc.Column(text("position"), "°"): positions.tolist()},
        ),
        stand_table(stand, stance.statics),
        simulated_table(run),
        height_plot([run], float(stand.qpos[2])),
        *([] if stance.servos is None else [_make_servo_table(stance.servos)]),
    ]
    word_of_verdict = verdict_word(
        stance.verdict, ideal_servos=exceeds_explicit_damping(stance.servos)
    )
    document = judged_document(
        text("stance"),
        stance,
        blocks,
        (
            _describe_peak_torque(stance, word_of_verdict),
            *_warn_of_model_mismatch(run),
            *(requested if qualified else ()),
            *(gains if qualified else ()),
            *(soft if skipped else ()),
            *findings,
            *(() if height_first else _describe_base(stance)),
        ),
        limits=()
        if qualified
        else (
            *requested,
            *(soft if stance.passed else ()),
            *(() if gains and gains[0] in causes else gains),
            *(_describe_base(stance) if height_first else ()),
        ),
        causes=causes,
        details=tuple(_list_details(stance)),
        word=word_of_verdict,
        notes=robot_notes(robot),
        next_step=_select_next_step(stance),
    )
    return _omit_repeated_servos(document, stance)


def _omit_repeated_servos(document: doc.Document, stance: Stance) -> doc.Document:
    """Move the statement on added or given servos to the details if the gains are stated as well.

    The statement on given servos is kept if the gains of the joints differ: the other statement
    then contains factors, not gains.
    """
    servos = stance.verdict.servos
    if stance.servos is None or not any(describe_servo_gains(stance.servos, servos)):
        return document
    if not servos.made and not stance.servos.uniform:
        return document
    kept, moved = split_servo_statement(document.findings, servos)
    return replace(document, findings=kept, details=(*document.details, *moved))


_NEXT_STEPS = {
    VerdictCode.HOLDS_WITH_FEEDFORWARD: NextStep("stand", ("--minimum-stiffness",)),
    VerdictCode.IN_BALANCE: NextStep("best", ("margin",)),
    VerdictCode.UNSTABLE: NextStep("best", ("margin",)),
    VerdictCode.OVERLOADED: NextStep("best", ("utilisation",)),
    VerdictCode.LIMITS_UNKNOWN: NextStep("audit"),
    VerdictCode.MASSES_UNKNOWN: NextStep("audit"),
    VerdictCode.LIMB_WITHOUT_FOOT: NextStep("stand", ("--explain",)),
    VerdictCode.DIFFERS_AS_PUBLISHED: NextStep("crosscheck"),
    VerdictCode.OWN_DRIVES_FAIL: NextStep("audit", of_mjcf=True),
    VerdictCode.DISAGREES: NextStep("crosscheck"),
    VerdictCode.FAILS: NextStep("best", ("margin",)),
}
"""{verdict code: command to run next, unless `_select_next_step` finds a more specific one}."""


def _is_tied(stance: Stance) -> bool:
    """Return True if the file ties the base or another link to the world."""
    return any(remark.code in TIE_MESSAGE_CODES for remark in stance.verdict.remarks)


def _select_next_step(stance: Stance) -> NextStep:
    """Return the command to run next: on the cause of a failure, otherwise mostly `payload`.

    After a failure under a payload, the next command is `payload` without this payload.
    """
    verdict = stance.verdict
    step = _NEXT_STEPS.get(verdict.code, NextStep("payload"))
    mismatch = stance.verification.mujoco_residual > MAX_UNREPORTED_RESIDUAL
    two_robots = any(failure.code == TWO_ROBOTS_CODE for failure in verdict.failures)
    if mismatch or two_robots:
        step = NextStep("crosscheck")
    if step.command == "crosscheck" and verdict.converted:
        step = NextStep("audit")
    if any(failure.code == "height-lost" for failure in verdict.failures):
        run, height = stance.verification, stance.stand.task.height or 0.0
        step = NextStep("stand", ("--height", f"{math.floor(1e3 * (height - run.height_loss))}mm"))
    if _has_soft_drives(stance):
        step = _stiffen_servos(stance.verification)
    if verdict.code is VerdictCode.FAILS and (_is_tied(stance) or is_support_disabled(verdict)):
        step = NextStep("audit", of_mjcf=True)
    elif verdict.code is VerdictCode.FAILS and stance.soft_servos is not None:
        step = _stiffen_soft_servos(stance) or step
    elif _is_damping_excessive(stance):
        step = NextStep("gains")
    elif not verdict.passed and step.command == "best" and stance.added_mass > 0:
        step = NextStep("payload", omitted=("--payload",))
    if step.command == "payload" and exceeds_explicit_damping(stance.servos):
        step = NextStep("gains")
    if "--minimum-stiffness" in step.words:
        known = stance.minimum_stiffness is not None
        step = NextStep("gains") if known else _stiffen_to_holding_gains(stance) or step
    return step


def _stiffen_to_holding_gains(stance: Stance) -> NextStep | None:
    """Return the command ``stand`` with gains with which the robot stands without feed-forward.

    None if no such gains are known, or if the gains of the joints differ.
    """
    servos = stance.servos
    if servos is None or not servos.uniform or servos.holding_kp_factor is None:
        return None
    factor, gains = servos.holding_kp_factor, servos.classes[0]
    kd = round_up(max(1.0, factor) * gains.kd, 3)
    least = format_bound(factor * gains.kp, gains.kp, upper=False)
    return NextStep("stand", ("--kp", least, "--kd", f"{kd:g}"))


def _is_damping_excessive(stance: Stance) -> bool:
    """Return True if the stand fails with kd above the bound of an explicit PD controller."""
    return stance.verdict.code is VerdictCode.FAILS and exceeds_explicit_damping(stance.servos)


def _has_soft_drives(stance: Stance) -> bool:
    """Return True if the simulated unmodified file falls because the file's servos are too soft."""
    own = stance.verdict.keyframe_run
    soft = own is not None and any(cause.code == "soft-servos" for cause in own.causes)
    return stance.verdict.code is VerdictCode.OWN_DRIVES_FAIL and soft


def _stiffen_servos(run: StandVerification) -> NextStep:
    """Return the command to run if servos are too soft, such as `stand` with larger gains."""
    if np.ptp(run.kp) or np.ptp(run.kd):
        return NextStep("stand", ("--minimum-stiffness",))
    kp, kd = (f"{STIFFNESS_FACTOR * values[0]:g}" for values in (run.kp, run.kd))
    return NextStep("stand", ("--kp", kp, "--kd", kd))


def _stiffen_soft_servos(stance: Stance) -> NextStep | None:
    """Return the command ``stand`` with gains with which a failing stand stays upright, or None."""
    servos, soft = stance.servos, stance.soft_servos
    if servos is None or soft is None:
        return None
    classes = [
        joint_class for joint_class in servos.classes if set(joint_class.joints) <= set(soft.joints)
    ]
    words: list[str] = []
    for joint_class in classes:
        matching = match_names(joint_class.name, stance.statics.joint_names)
        if sorted(matching) != sorted(joint_class.joints):
            return None
        words += ["--kp", f"{joint_class.name}={soft.factor * joint_class.kp:g}"]
        words += (
            ["--kd", f"{joint_class.name}={soft.factor * joint_class.kd:g}"]
            if joint_class.kd > 0
            else []
        )
    return NextStep("stand", tuple(words))


def _warn_of_model_mismatch(run: StandVerification) -> Iterable[doc.Words]:
    """Yield a warning that the models differ if the predicted forces do not balance in MuJoCo."""
    if run.mujoco_residual > MAX_UNREPORTED_RESIDUAL:
        yield text("the-two-models-disagree", residual=f"{run.mujoco_residual:.2g}").with_mark(
            "warn"
        )


def _describe_peak_torque(stance: Stance, word_of_verdict: doc.Text) -> doc.Text:
    """Return a text with the most loaded motor, the torque or force, and the utilisation [%].

    If the first line has no room, the utilisation is stated without "of the limit".
    """
    values = format_peak_load(stance.statics)
    line = text("load-of-motors", **values, full=bool(values["share"]))
    if doc.fits_first_line(word_of_verdict, stance.name, line):
        return line
    return text("load-of-motors", **values, full=False)


def _describe_base(stance: Stance) -> Iterable[doc.Words]:
    """Yield the stance with the base height, or that the base is bolted; nothing if unknown."""
    if is_base_bolted(stance.stand):
        yield text("base-is-bolted")
    elif (height := describe_height(stance)) is not None:
        yield height


def describe_height(stance: Stance) -> doc.Text | None:
    """Return the text of the stance with the base height; None if the task has no height."""
    height = stance.stand.task.height
    if height is None:
        return None
    return text(
        "base-height-of-stance",
        task=task_text(stance.stand.task),
        height=f"{1e3 * height:.1f}",
        ground=ground_word(stance.stand.depths.values(), stance.verification),
    )


def _describe_soft_servos(stance: Stance) -> Iterable[doc.Words]:
    """Yield the servos that alone make the stand fail, and the smallest sufficient stiffness."""
    servos, soft = stance.servos, stance.soft_servos
    if soft is not None:
        yield text(
            "servos-too-soft-alone",
            joints=soft.name,
            kp=format_number(soft.kp, ".3g"),
            unit=soft.units.stiffness,
            factor=f"{soft.factor:g}",
        )
    if servos is None or stance.sagging.stays or servos.least_kp_factor is None:
        return
    if servos.least_kp_factor <= 1:
        return
    factor, least = servos.holding_kp_factor, servos.least_kp_factor
    kp = servos.classes[0].kp if servos.uniform else 1.0
    yield text(
        "servos-below-least-kp" if servos.uniform else "servos-below-least-factor",
        kp=format_number(kp, ".3g"),
        unit=servos.units.stiffness,
        least=format_bound(least * kp, kp, upper=False),
        tried="" if factor is None else format_bound(factor * kp, kp, upper=False),
    )


def _make_servo_table(servos: ServoBounds) -> doc.Table:
    """Create the table of servo gains, with the lower bound of kp and the upper bound of kd.

    A row is a class of joints with equal gains.
    """
    rows: list[tuple[doc.Cell, ...]] = [
        (
            doc.Name(bounds.name),
            doc.number_cell(bounds.kp, ".4g"),
            make_bound_cell(bounds.least_kp, bounds.kp, upper=False),
            doc.number_cell(bounds.kd, ".4g"),
            make_bound_cell(bounds.largest_kd, bounds.kd, upper=True),
        )
        for bounds in servos.classes
    ]
    stiffness, damping = servos.units.stiffness, servos.units.damping
    return doc.Table(
        text("servo-gains-by-joint"),
        (
            doc.Column(text("servo-joints"), left=True),
            doc.Column(doc.Name("kp"), stiffness),
            doc.Column(text("least-kp"), stiffness),
            doc.Column(doc.Name("kd"), damping),
            doc.Column(text("largest-kd"), damping),
        ),
        tuple(rows),
        (
            text("servo-bounds-of-factors"),
            text(
                "servo-bounds-of-controller",
                step=format_number(1e3 * servos.timestep, ".3g"),
                integrator=doc.Name(servos.integrator),
            ),
        ),
    )


def _get_stiffness_unit(stance: Stance) -> str:
    """Return the unit of a stiffness that is equal at all joints; N m/rad if all are hinges."""
    return find_common_units(stance.statics.torque_units).stiffness


def _describe_minimum_stiffness(stance: Stance) -> Iterable[doc.Words]:
    """Yield the minimum kp, or the reason why no kp suffices; nothing if not requested."""
    if stance.minimum_stiffness is not None:
        yield text(
            "minimum-stiffness-of-servos",
            kp=f"{format_number(round_up(stance.minimum_stiffness, 3), '.3g')} "
            f"{_get_stiffness_unit(stance)}",
        )
    if stance.no_stiffness is not None:
        yield doc.diagnostic_text(stance.no_stiffness).with_mark("warn")


def _list_findings(stance: Stance, preceding: tuple[doc.Words, ...]) -> Iterable[doc.Words]:
    """Yield the findings of a stance, such as the sag and the largest force of each hand.

    The texts ``preceding`` are before the findings in line 2.
    """
    settled = stance.settled
    if stance.unsettled is not None and not _is_failure_without_feedforward_stated(stance):
        yield text("no-sag-predicted", why=doc.diagnostic_text(stance.unsettled))
    elif settled is not None and not _is_settled_state_detail(stance, settled):
        yield _describe_settled_state(stance, settled, *preceding)
    for press in stance.presses:
        yield text("presses-with", hand=doc.Name(press.hand), force=f"{press.force:.1f}")


def _is_settled_state_detail(stance: Stance, settled: SteadyState) -> bool:
    """Return True if the report lists the equilibrium without feed-forward only as a detail."""
    if settled.failures:
        return _is_failure_without_feedforward_stated(stance)
    lasting = settled.release_margin >= RELEASE_MARGIN
    stated = lasting or _is_failure_without_feedforward_stated(stance)
    return stated and is_base_bolted(stance.stand)


def _is_failure_without_feedforward_stated(stance: Stance) -> bool:
    """Return True if a simulation without feed-forward does not hold, as the verdict states."""
    return stance.verdict.commands_alone not in (None, Ending.HOLDS)


def _describe_settled_state(
    stance: Stance, settled: SteadyState, *preceding: doc.Words
) -> doc.Words:
    """Return the text of the equilibrium without feed-forward: height, sag [mm], reservations.

    The short form is abbreviated if it does not fit into line 2 after the texts ``preceding``.
    """
    full = _format_settled_state(stance, settled, full=True)
    if _fits_second_line(*preceding, full):
        return full
    return _format_settled_state(stance, settled, full=False)


def _fits_second_line(*texts: doc.Words) -> bool:
    """Return True if the short forms of texts fit into line 2 of the short answer."""
    line = "; ".join(doc.translate(words, "en", short=True) for words in texts)
    return len(line) + _INDENT <= doc.MAX_ANSWER_WIDTH


_INDENT = 2
"""Number of spaces before line 2 of a short answer."""


def _format_settled_state(stance: Stance, settled: SteadyState, *, full: bool) -> doc.Words:
    """Return the text of `_describe_settled_state`; in short "uncompensated" unless ``full``."""
    description = text(
        "settles-at",
        full=full,
        # Height above the ground as in the task; on a slope, not the world's z.
        height=f"{1e3 * ((stance.stand.task.height or 0.0) - settled.height_loss):.2f}",
        loss=f"{1e3 * settled.height_loss:z.2f}",
        short_loss=f"{1e3 * settled.height_loss:z.1f}",
        servo=f"{1e3 * settled.servo_sag:z.2f}",
        contact=f"{1e3 * settled.contact_sag:z.2f}",
    )
    if settled.failures:
        reasons = join_words(map(doc.diagnostic_text, settled.failures), "semicolon")
        description = text("settles-but", settles=description, why=reasons)
    elif settled.release_margin < RELEASE_MARGIN:
        description = text(
            "settles-if-let-down-slowly",
            settles=description,
        )
    if settled.rolling_feet:
        description = text("settles-except-rolling", settles=description)
    return description


def _list_details(stance: Stance) -> Iterable[doc.Words]:
    """Yield details that are no findings: stance, equilibrium without feed-forward, ground."""
    settled, task = stance.settled, stance.stand.task
    if is_base_bolted(stance.stand) or task.height is None:  # not in the findings
        yield task_text(task)
    if settled is not None and _is_settled_state_detail(stance, settled):
        yield _describe_settled_state(stance, settled)
    if stance.unsettled is not None and _is_failure_without_feedforward_stated(stance):
        yield text("no-sag-predicted", why=doc.diagnostic_text(stance.unsettled))
    yield ground_text(stance.stand.depths.values())
