"""Document of stable gains: bounds of stiffness and damping, by joint class and as a plot.

Input is a `GainStudy`; output is a document that is independent of the output format.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import format_number
from pupper_analysis.base.units import round_up
from pupper_analysis.present import document as doc
from pupper_analysis.present.document import NextStep, join_words, text
from pupper_analysis.present.documents.registry import build_document
from pupper_analysis.present.documents.servos import format_bound, make_bound_cell
from pupper_analysis.present.documents.standing import robot_notes, task_text
from pupper_analysis.present.verdict import (
    clause_text,
    make_replaced_clauses,
    make_servo_clause,
    split_ties,
)
from pupper_analysis.robot.as_published import ServoSource
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.gains.gains import GAIN_MARGIN, MAX_NOISE_RATIO, GainBound, GainStudy

_VERDICT_KEYS = {
    (True, True): "gains-stable",
    (True, False): "gains-beyond",
    (False, False): "gains-unstable",
}
"""{(whether all modes are stable at the present gains, `GainStudy.stands_stably`): catalogue key of
the verdict's text, if no mass was assumed}."""


@build_document.register(GainStudy)
def gains_document(study: GainStudy, robot: Robot | None = None) -> doc.Document:
    """Create the report of a gain study: verdict, tables of the bounds, and plot."""
    _, broken, ties = split_ties(study.ties)
    gains, failures = _describe_stable_gains(study), tuple(_describe_failures(study))
    failures = (*broken, *_order_failures(study, gains, failures))
    return doc.Document(
        text("gains"),
        doc.Name(study.name),
        (_make_class_table(study), _make_bound_table(study), gain_plot(study)),
        passed=study.passed,
        verdict=text(_select_verdict(study)),
        failures=failures,
        findings=(
            *(() if gains in failures else (gains,)),
            *ties,
            *(
                doc.diagnostic_text(message).with_mark("warn")
                for message in study.placeholder_inertias
            ),
            *_order_conditions(study, failed=bool(failures)),
            *_describe_added_servos(study),
        ),
        details=(
            task_text(study.stand.task),
            text("gains-damping-ratio", ratio=f"{study.damping_ratio:.2f}"),
        ),
        brief=True,
        notes=robot_notes(robot),
        next_step=_select_next_step(study),
    )


def _select_verdict(study: GainStudy) -> str:
    """Return the catalogue key of the verdict."""
    if study.stands_stably and not study.passed:
        return split_ties(study.ties)[0] or "UNKNOWN"
    if study.holds_with_friction:
        return "gains-unstable-without-friction"
    return _VERDICT_KEYS[study.worst.stable, study.stands_stably]


def _order_conditions(study: GainStudy, *, failed: bool) -> tuple[doc.Words, ...]:
    """Return the texts of controller and recommended gains; the latter first after a failure."""
    controller, recommended = _describe_controller(study), _describe_recommended_gains(study)
    return (*recommended, controller) if failed else (controller, *recommended)


def _order_failures(
    study: GainStudy, gains: doc.Words, failures: tuple[doc.Words, ...]
) -> tuple[doc.Words, ...]:
    """Return the texts of the failures, with the range of stable gains; assumed masses first.

    The range precedes the reasons, unless it does not contain the present gains.
    """
    if not failures:
        return ()
    num_first = (study.missing_masses is not None) + study.by_inertia
    return (*failures[:num_first], gains, *failures[num_first:])


def _describe_failures(study: GainStudy) -> Iterable[doc.Words]:
    """Yield the reasons why the present gains fail."""
    if study.missing_masses is not None:
        yield doc.diagnostic_text(study.missing_masses)
    yield from map(clause_text, make_replaced_clauses(study.servos.replacement_servos))
    if not study.worst.stable:
        joints = study.worst.joints
        time = format_number(1e3 * math.log(2) / study.worst.growth_rate, ".3g")
        if study.worst.frequency:
            frequency = format_number(study.worst.frequency, ".3g")
            yield text(
                "gains-oscillate",
                present=_format_present_gains(study) if study.by_inertia else "",
                joints=joints,
                first=doc.Name(joints[0]),
                frequency=frequency,
                time=time,
                rate=f"{1 / study.period:.4g}",
                delay=format_number(1e3 * study.delay, ".3g"),
                delayed=study.delay > 0,
            )
        else:
            yield text(
                "gains-buckle", joints=joints, time=time, held=study.holds_with_friction is True
            )
    if study.sag_failure is not None:
        yield text("gains-sag", failure=doc.diagnostic_text(study.sag_failure))
    for joint_class in study.exceeded:
        if (
            joint_class.largest_kp_of_torque is not None
            and joint_class.kp > joint_class.largest_kp_of_torque
        ):
            yield text(
                "gains-above-torque",
                joints=doc.Name(joint_class.name),
                kp=f"{format_bound(joint_class.largest_kp_of_torque, joint_class.kp, upper=True)} "
                f"{joint_class.units.stiffness}",
            )
        if (
            joint_class.largest_kd_of_encoder is not None
            and joint_class.kd > joint_class.largest_kd_of_encoder
        ):
            yield text(
                "gains-above-noise",
                joints=doc.Name(joint_class.name),
                kd=f"{format_bound(joint_class.largest_kd_of_encoder, joint_class.kd, upper=True)} "
                f"{joint_class.units.damping}",
            )


def _format_present_gains(study: GainStudy) -> doc.Text:
    """Return the ranges of the present kp and kd, without units."""
    return text(
        "gains-present-values",
        added=bool(study.servos.made),
        kp=_format_range((joint_class.kp for joint_class in study.classes), "").rstrip(),
        kd=_format_range((joint_class.kd for joint_class in study.classes), "").rstrip(),
    )


def _describe_added_servos(study: GainStudy) -> Iterable[doc.Words]:
    """Yield a statement if the present gains belong to servos that were added on loading."""
    if study.servos.made:
        yield clause_text(make_servo_clause(study.servos, good=study.passed)).with_mark("warn")


def _describe_stable_gains(study: GainStudy) -> doc.Words:
    """Return a sentence on the range of stable gains, as gains or as factors."""
    largest = study.largest_kd.factor
    if study.by_inertia:
        is_recommended = study.recommended_kp_factor is not None
        stiffnesses = [
            joint_class.recommended_kp or joint_class.reference_kp for joint_class in study.classes
        ]
        dampings = [
            joint_class.recommended_kd or joint_class.reference_kd for joint_class in study.classes
        ]
        return text(
            "gains-by-inertia-recommended" if is_recommended else "gains-by-inertia",
            kp=_format_range(stiffnesses, study.units.stiffness),
            kd=_format_range(dampings, study.units.damping),
        )
    if study.uniform:
        kp, kd = study.classes[0].kp, study.classes[0].kd
        least = _find_least_stiffness(study)
        kp_text, kd_text = format_number(kp, ".3g"), format_number(kd, ".3g")
        return text(
            "gains-range" if largest is not None else "gains-range-open",
            added=bool(study.servos.made),
            kp=f"{kp_text} {study.units.stiffness}",
            kd=f"{kd_text} {study.units.damping}",
            # Beside the verdict "UNSTABLE without dry friction" the short form has no more room.
            short_kd=kd_text if study.holds_with_friction else f"{kd_text} {study.units.damping}",
            least=format_bound(least, kp, upper=False),
            most="" if largest is None else format_bound(kd * largest, kd, upper=True),
        )
    least_factor = study.least_kp.factor
    return text(
        "gains-factors" if largest is not None else "gains-factors-open",
        added=bool(study.servos.made),
        kp=_format_range((joint_class.kp for joint_class in study.classes), study.units.stiffness),
        kd=_format_range((joint_class.kd for joint_class in study.classes), study.units.damping),
        stiffnesses=_format_range(
            (joint_class.kp for joint_class in study.classes), study.units.stiffness, ".."
        ),
        least="" if least_factor is None else format_bound(least_factor, 1.0, upper=False),
        most="" if largest is None else format_bound(largest, 1.0, upper=True),
    )


def _find_least_stiffness(study: GainStudy) -> float:
    """Return the smallest kp of a study with equal gains [N m/rad, N/m]; 0 without a bound.

    The stand is stable with feed-forward, and a free-base robot also stands without feed-forward.
    """
    bound = study.classes[0].reference_kp * (study.least_kp.factor or 0.0)
    return max(bound, study.least_kp_alone or 0.0)


def _format_range(gains: Iterable[float], unit: str = "", between: str = " to ") -> str:
    """Return the range of the positive gains with three digits, and the unit: "1 to 2 N m/rad"."""
    used = sorted(gain for gain in gains if gain > 0)
    if not used:
        return f"0 {unit}".rstrip()
    texts = dict.fromkeys(format_number(gain, ".3g") for gain in (used[0], used[-1]))
    return f"{between.join(texts)} {unit}".rstrip()


def _describe_controller(study: GainStudy) -> doc.Words:
    """Return the text of the controller's rate and delay, and of the mode that bounds kd."""
    implicit = study.integrator.startswith("implicit")
    return text(
        "gains-controller-implicit" if implicit else "gains-controller",
        rate=f"{1 / study.period:.4g}",
        delay=format_number(1e3 * study.delay, ".3g"),
        joints=join_words([doc.Name(name) for name in study.largest_kd.joints[:1]]),
        frequency=format_number(study.largest_kd.frequency, ".3g"),
        integrator=doc.Name(study.integrator),
    )


def _describe_recommended_gains(study: GainStudy) -> Iterable[doc.Words]:
    """Yield the recommended kp and kd if they are equal at all joints."""
    if recommended := _get_uniform_recommendation(study):
        kp, kd = recommended
        yield text("gains-recommended-gains", kp=kp, kd=kd)


def _get_uniform_recommendation(study: GainStudy) -> tuple[str, str] | None:
    """Return recommended kp and kd with three digits if all joints have equal gains, else None."""
    first = study.classes[0]
    if not study.uniform or first.recommended_kp is None or first.recommended_kd is None:
        return None
    return format_number(first.recommended_kp, ".3g"), format_number(first.recommended_kd, ".3g")


def _select_next_step(study: GainStudy) -> NextStep:
    """Return the suggested next command: `stand`, or `gains` to get the recommended gains.

    `stand` has the recommended gains as options if these are equal at all joints. `gains` is
    suggested if the recommended gains differ between joints, and the present gains fail.
    """
    if recommended := _get_uniform_recommendation(study):
        kp, kd = recommended
        return NextStep("stand", ("--kp", kp, "--kd", kd))
    if not study.stands_stably and study.recommended_kp_factor is not None:
        in_file = study.servos.source is ServoSource.FILE  # the files state no gains of others
        return NextStep("gains", ("--write", "tuned") if in_file else ("-v",))
    return NextStep("stand")


def _make_class_table(study: GainStudy) -> doc.Table:
    """Create the table of present gains, bounds and recommended gains, a row per joint class."""
    rows: list[tuple[doc.Cell, ...]] = [
        (
            doc.Name(joint_class.name),
            doc.number_cell(joint_class.kp, ".4g"),
            *_reference_cells(study, joint_class.reference_kp),
            make_bound_cell(joint_class.least_kp, joint_class.kp, upper=False),
            make_bound_cell(joint_class.largest_kp_of_torque, joint_class.kp, upper=True),
            doc.number_cell(joint_class.recommended_kp, ".3g"),
            doc.number_cell(joint_class.kd, ".4g"),
            *_reference_cells(study, joint_class.reference_kd),
            make_bound_cell(joint_class.largest_kd, joint_class.kd, upper=True),
            make_bound_cell(joint_class.largest_kd_alone, joint_class.kd, upper=True),
            make_bound_cell(joint_class.largest_kd_of_encoder, joint_class.kd, upper=True),
            doc.number_cell(joint_class.recommended_kd, ".3g"),
        )
        for joint_class in study.classes
    ]
    stiffness, damping = study.units.stiffness, study.units.damping
    return doc.Table(
        text("gains-by-joint"),
        (
            doc.Column(text("gains-joints"), left=True),
            doc.Column(doc.Name("kp"), stiffness),
            *_reference_columns(study, stiffness),
            doc.Column(text("gains-least"), stiffness),
            doc.Column(text("gains-torque"), stiffness),
            doc.Column(text("gains-recommended"), stiffness),
            doc.Column(doc.Name("kd"), damping),
            *_reference_columns(study, damping),
            doc.Column(text("gains-largest"), damping),
            doc.Column(text("gains-largest-alone"), damping),
            doc.Column(text("gains-encoder"), damping),
            doc.Column(text("gains-recommended"), damping),
        ),
        tuple(rows),
        tuple(_list_column_notes(study)),
    )


def _reference_columns(study: GainStudy, unit: str) -> tuple[doc.Column, ...]:
    """Return the column of reference gains; none if these are the present gains."""
    return (doc.Column(text("gains-reference"), unit),) if study.by_inertia else ()


def _reference_cells(study: GainStudy, gain: float) -> tuple[doc.Cell, ...]:
    """Return the cell of a reference gain; none if this is the present gain."""
    return (doc.number_cell(gain, ".3g"),) if study.by_inertia else ()


def _list_column_notes(study: GainStudy) -> Iterable[doc.Words]:
    """Yield the explanations of the columns of the table of joint classes."""
    if study.by_inertia:
        yield text("gains-note-reference")
    yield text("gains-note-together")
    if study.error is not None:
        yield text("gains-note-torque", error=format_number(math.degrees(study.error), ".3g"))
    if study.encoder_bits is not None:
        yield text(
            "gains-note-encoder", bits=study.encoder_bits, ratio=f"{100 * MAX_NOISE_RATIO:.0f}"
        )
    yield text("gains-note-recommended", margin=f"{GAIN_MARGIN:g}")


def _make_bound_table(study: GainStudy) -> doc.Table:
    """Create the table of three bounds: smallest kp, largest kp and largest kd."""
    bounds = (
        ("gains-least-kp", study.least_kp),
        ("gains-largest-kp", study.largest_kp),
        ("gains-largest-kd", study.largest_kd),
    )
    rows: list[tuple[doc.Cell, ...]] = [
        (
            text(key),
            doc.number_cell(bound.factor, ".3g"),
            doc.number_cell(bound.simulated, ".3g"),
            doc.number_cell(bound.frequency if bound.joints else None, ".3g"),
            _name_first_joints(bound),
        )
        for key, bound in bounds
    ]
    notes = [text("gains-note-simulated")]
    if study.least_kp_alone is not None:
        notes.append(
            text(
                "gains-note-alone",
                kp=f"{format_number(round_up(study.least_kp_alone, 3), '.3g')} "
                f"{study.units.stiffness}",
            )
        )
    return doc.Table(
        text("gains-bounds"),
        (
            doc.Column(text("gains-bound"), left=True),
            doc.Column(text("gains-factor"), "1"),
            doc.Column(text("gains-simulated"), "1"),
            doc.Column(text("gains-frequency"), "Hz"),
            doc.Column(text("gains-joints"), left=True),
        ),
        tuple(rows),
        tuple(notes),
    )


def _name_first_joints(bound: GainBound) -> doc.Words:
    """Return the names of the two joints that move most in a bound's growing mode, or a dash."""
    return (
        join_words([doc.Name(name) for name in bound.joints[:2]]) if bound.joints else doc.Name("-")
    )


def gain_plot(study: GainStudy) -> doc.LinePlot:
    """Create the plot of stable stiffness and damping, with the reference and recommended gains.

    Axes are absolute if all joints have equal gains, otherwise factors on the reference gains.
    """
    first = study.classes[0]
    kp, kd = (first.reference_kp, first.reference_kd) if study.uniform else (1.0, 1.0)
    known = np.isfinite(study.curve_dampings)
    stiffnesses, dampings = kp * study.curve_factors[known], kd * study.curve_dampings[known]
    points = [
        (text("gains-reference" if study.by_inertia else "gains-present"), kp, kd),
    ]
    if study.recommended_kp_factor is not None and study.recommended_kd_factor is not None:
        recommended = kp * study.recommended_kp_factor, kd * study.recommended_kd_factor
        points.append((text("gains-recommended"), *recommended))
    values = np.array([point[1:] for point in points])
    least = _find_least_stiffness(study) if study.uniform else (study.least_kp.factor or 0.0)
    across = np.concatenate([stiffnesses, values[:, 0], [least] if least else []])
    up = np.concatenate([dampings, values[:, 1]])
    bottom, top = float(up.min()) / _BOTTOM_RATIO, float(up.max())
    series = [
        doc.Series(text("gains-largest-kd"), stiffnesses, dampings),
        *(
            doc.Series(name, [across], [up], points=True, marked_index=0)
            for name, across, up in points
        ),
    ]
    units = (study.units.stiffness, study.units.damping) if study.uniform else ("1", "1")
    if least:
        note = doc.Name(
            f"{format_number(least, '.3g')} {units[0] if study.uniform else ''}".strip()
        )
        series.append(doc.Series(text("gains-least-kp"), [least] * 2, [bottom, top], note=note))
    lower = np.maximum(kd * study.curve_least_dampings[known], bottom)
    region = _make_stable_region(stiffnesses, lower, dampings, least)
    if len(region):
        series.append(doc.Series(text("gains-region"), region[:, 0], region[:, 1], shaded=True))
    return doc.LinePlot(
        text(
            "gains-plot",
            rate=f"{1 / study.period:.4g}",
            delay=format_number(1e3 * study.delay, ".3g"),
        ),
        doc.Axis(doc.Name("kp"), units[0], ".3g", logarithmic=bool((across > 0).all())),
        doc.Axis(doc.Name("kd"), units[1], ".3g", logarithmic=bool((up > 0).all())),
        series,
        None if study.uniform else text("gains-plot-factors"),
    )


def _make_stable_region(stiffnesses: Array, lower: Array, upper: Array, least: float) -> Array:
    """Return the polygon of stable gains (kp, kd), shape (n, 2); empty if there is none.

    ``lower`` and ``upper`` are the bounds of kd at ascending ``stiffnesses``, shape (m,) each;
    ``least`` is the smallest kp.
    """
    if not len(stiffnesses) or least >= stiffnesses[-1]:
        return np.empty((0, 2))
    start = max(least, float(stiffnesses[0]))
    inside = stiffnesses > start
    kps = np.append(start, stiffnesses[inside])
    bounds = [np.interp(kps, stiffnesses, bound) for bound in (lower, upper)]
    edges = [np.column_stack([kps, bound]) for bound in bounds]
    return np.concatenate([edges[1], edges[0][::-1]])


_BOTTOM_RATIO = 2.0
"""Smallest damping of the curve and the points, divided by the smallest damping that is drawn [1].
Down to the latter, the stable region is drawn if no damping is too small. Chosen, not tuned."""
