"""Documents of `walk`: gaits, tracked intervals, responses, traces, rankings of interpretations.

Inputs are results of `walk` (`Walk`, `TrackedIntervals`, `ResponseMap`, `TraceCheck`, `Orders`);
outputs are documents that are independent of the output format, with values in printed units.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Severity
from pupper_analysis.base.units import find_common_units
from pupper_analysis.present import document as doc
from pupper_analysis.present.document import join_words, text
from pupper_analysis.present.documents.loads import limit_cell
from pupper_analysis.present.documents.motors import describe_motor_energy
from pupper_analysis.present.documents.registry import build_document
from pupper_analysis.present.documents.standing import robot_notes
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.walk.contract import PolicyContract
from pupper_analysis.tools.walk.gait import Gait, Walk
from pupper_analysis.tools.walk.intervals import TrackedInterval, TrackedIntervals
from pupper_analysis.tools.walk.orders import MIN_COST_RATIO, Candidate, Orders
from pupper_analysis.tools.walk.response import ResponseAxis, ResponseMap
from pupper_analysis.tools.walk.trace import TraceCheck


@build_document.register(Walk)
def walk_document(walk: Walk, robot: Robot | None = None) -> doc.Document:
    """Create the report of the gaits of a policy: view, motors, runs, contract and torques."""
    fallen = [gait for gait in walk.gaits if gait.fall is not None]
    speed, torque, *details = _list_figures(walk)
    if fallen:
        word = "walk-falls"
    elif not all(gait.tracks for gait in walk.gaits):
        word = "walk-does-not-follow"
    else:
        word = "walk-follows" if walk.passed else "UNKNOWN"
        word = word if walk.within_region else "walk-beyond"
    causes = (*_list_limit_warnings(walk), *map(doc.diagnostic_text, walk.remarks))
    return doc.Document(
        text("walk-title"),
        text("walk-of", robot=doc.Name(walk.name), policy=doc.Name(walk.policy)),
        (
            _make_view(walk, robot),
            _make_motor_table(walk),
            _make_run_table(walk),
            make_key_table(walk.contract),
            walk_torque_plot(walk),
        ),
        passed=walk.passed,
        verdict=text(word),
        failures=(
            *(doc.diagnostic_text(gait.fall) for gait in fallen[:1] if gait.fall is not None),
            *(() if walk.within_region else _describe_region(walk)),
        ),
        findings=(
            *(_list_causes_of_fall(walk) if fallen else ()),
            speed,
            *_describe_missing_steps(walk),
            *(() if fallen else _report_zero_torque_limits(walk)),
            *_describe_tested_orders(walk),
            torque,
            *_describe_policy_gains(walk),
            *(_describe_region(walk) if walk.within_region else ()),
            *describe_motor_energy(walk.gaits[0].energy),
            *_list_warnings(walk),
            *(() if fallen else causes),
        ),
        details=(*details, text(f"walk-evidence-{walk.evidence}")),
        brief=True,
        notes=robot_notes(robot),
        next_step=_select_next_step(walk),
    )


def _select_next_step(walk: Walk) -> doc.NextStep:
    """Return the command that the report proposes to run next."""
    if all(gait.tracks for gait in walk.gaits):
        return doc.NextStep("walk", ("--vary", "mass,kp,delay"))
    prevented = {test.quantity for test in walk.fall_tests if not test.falls}
    if "command" in prevented:
        return doc.NextStep("walk", ("--response",))
    if prevented & {"kp", "kd"}:
        return doc.NextStep("gains")
    if _is_still(walk):
        return doc.NextStep("walk", ("--response",))
    return doc.NextStep("walk", ("--orders",), omitted=("--command", "--seeds"))


def _is_still(walk: Walk) -> bool:
    """Return True if the actions of the policy are zero in all runs."""
    return all(gait.largest_action == 0 for gait in walk.gaits)


def _describe_tested_orders(walk: Walk) -> Iterable[doc.Words]:
    """Yield the reason for the next command ``walk --orders``, if it is proposed."""
    if "--orders" in _select_next_step(walk).words:
        yield text("walk-test-orders")


def _describe_policy_gains(walk: Walk) -> Iterable[doc.Words]:
    """Yield the range of kp and kd that the policy or its files state, if any."""
    kp, kd = walk.contract.kp, walk.contract.kd
    if kp is not None and kd is not None:
        yield text("walk-gains", kp=_format_range(kp), kd=_format_range(kd))


def _describe_missing_steps(walk: Walk) -> Iterable[doc.Words]:
    """Yield a text if no run tracks the command and all feet are on the ground in all samples."""
    gaits = walk.gaits
    if not any(gait.tracks or min(gait.duty.values(), default=0.0) < 1 for gait in gaits):
        yield text("walk-without-steps", still=_is_still(walk), count=len(walk.joints))


def _list_causes_of_fall(walk: Walk) -> Iterable[doc.Words]:
    """Yield texts of possible causes of a fall, such as unknown torque limits and file errors."""
    yield from _report_zero_torque_limits(walk)
    yield from _list_limit_warnings(walk)
    errors = [remark for remark in walk.remarks if remark.severity is Severity.ERROR]
    yield from map(doc.diagnostic_text, errors)
    if walk.fall_tests:
        prevented = [test for test in walk.fall_tests if not test.falls]
        factors: dict[str, list[str]] = {}
        for test in prevented or walk.fall_tests:
            factors.setdefault(test.quantity, []).append(f"{test.value:g}")
        changes = [
            text(f"walk-fall-{quantity}", value=doc.Name(" / ".join(values)))
            for quantity, values in factors.items()
        ]
        key = "walk-fall-prevented" if prevented else "walk-falls-anyway"
        yield text(key, changes=join_words(changes))
    yield from (doc.diagnostic_text(remark) for remark in walk.remarks if remark not in errors)


_MAX_SHOWN_CONFIGURATIONS = 75
"""Largest number of recorded configurations at the end of a run that the 3-D view of the report
shows: about 3 s.
"""


def _make_view(walk: Walk, robot: Robot | None) -> doc.SceneView:
    """Create the 3-D view of the first run: the first configuration, and the motion at the end.

    The horizontal position of the base is set to zero.
    """
    gait, motions = walk.gaits[0], []
    for name, selection in (
        ("walk-begins", slice(0, 1)),
        ("walk-end-of-run", slice(-_MAX_SHOWN_CONFIGURATIONS, None)),
    ):
        qpos = gait.motion[selection].copy()
        qpos[:, :2] = 0.0
        motions.append(doc.Motion(text(name), gait.motion_time[selection], qpos))
    scene = None if robot is None else doc.MotionScene(robot, motions)
    return doc.SceneView(text("walk-view"), scene, text("walk-view-note"))


def _list_figures(walk: Walk) -> Iterable[doc.Words]:
    """Yield four texts with key figures: velocity, largest torque, power and cost, duty factors."""
    first, gaits = walk.gaits[0], walk.gaits
    forward, left = (f"{speed:z.2f}" for speed in first.velocity[:2])
    turning = f"{first.turning:z.2f}"
    yield text(
        "walk-speed-line",
        forward=forward,
        short_forward=f"{float(forward):g}",
        asked=f"{first.command[0]:g}",
        left=left,
        short_left=f"{float(left):g}",
        moves_left=bool(first.command[1]),
        asked_left=f"{first.command[1]:g}",
        turning=turning,
        short_turning=f"{float(turning):g}",
        turns=bool(first.command[2]),
        asked_turning=f"{first.command[2]:g}",
    )
    yield _describe_largest_torque(walk)
    yield text(
        "walk-power-line",
        power=f"{first.power:.1f}",
        cost="-" if first.transport is None else f"{first.transport:.2f}",
        margin=f"{min(gait.margin for gait in gaits):.2f}",
    )
    duty = ", ".join(f"{foot} {100 * share:.0f} %" for foot, share in first.duty.items())
    yield text("walk-duty", feet=doc.Name(duty))


def _list_warnings(walk: Walk) -> Iterable[doc.Words]:
    """Yield texts on tracking, falls, and bodies that touch the ground."""
    gaits = walk.gaits
    if len(gaits) > 1:
        yield text(
            "walk-against",
            tracking=sum(gait.tracks for gait in gaits),
            count=len(gaits),
            fallen=sum(gait.fall is not None for gait in gaits),
        )
    if touching := sorted({body for gait in gaits for body in gait.touching}):
        yield text("walk-touching", bodies=doc.Name(", ".join(touching)))


def _describe_largest_torque(walk: Walk) -> doc.Words:
    """Return the text of the motor with the largest rms torque / torque limit.

    The largest rms torque replaces a limit that is infinite or zero.
    """
    rms, peak = _max_over_runs(walk, "torque_rms"), _max_over_runs(walk, "torque_peak")
    limited = np.isfinite(walk.limits) & (walk.limits > 0)
    limits = np.where(limited, walk.limits, rms.max(initial=_MIN_TORQUE))
    hardest = int(np.argmax(rms / limits))
    form = doc.widen_format(".2f", [float(rms[hardest])])
    return text(
        "walk-torque-line",
        joint=doc.Name(walk.joints[hardest]),
        rms=format(rms[hardest], form),
        peak=format(peak[hardest], form),
        unit=walk.torque_units[hardest],
        limit=f"{walk.limits[hardest]:.3g}" if np.isfinite(walk.limits[hardest]) else "",
        share=f"{100 * _max_over_runs(walk, 'at_limit')[hardest]:.1f}",
    )


def _describe_region(walk: Walk) -> Iterable[doc.Words]:
    """Yield a text that compares a motor with its torque-speed region, if motors are assigned."""
    peaks, beyond = _max_over_runs(walk, "region_peak"), walk.beyond_region
    if np.isnan(peaks).all():
        return
    ranks = peaks if walk.within_region else beyond
    joint = int(np.nanargmax(ranks))
    yield text(
        "walk-within-motors" if walk.within_region else "walk-beyond-motors",
        joint=doc.Name(walk.joints[joint]),
        motor=doc.Name(walk.motors[walk.joints[joint]]),
        peak=f"{100 * peaks[joint]:.0f}",
        share=f"{100 * beyond[joint]:.1f}",
    )


def _report_zero_torque_limits(walk: Walk) -> Iterable[doc.Words]:
    """Yield a warning on motors with a torque limit of zero, if any."""
    null = [joint for joint, limit in zip(walk.joints, walk.limits, strict=True) if limit <= 0]
    if null:
        yield text("walk-without-torque", joints=tuple(null))


def _list_limit_warnings(walk: Walk) -> Iterable[doc.Words]:
    """Yield a warning on used motors without a torque limit, if any."""
    peak = _max_over_runs(walk, "torque_peak")
    unknown = np.flatnonzero(np.isinf(walk.limits) & (peak > 0))
    if unknown.size:
        largest = int(unknown[np.argmax(peak[unknown])])
        yield text(
            "walk-limits-unknown",
            count=len(unknown),
            peak=doc.format_widened(float(peak[largest]), ".2f"),
            unit=walk.torque_units[largest],
            joint=doc.Name(walk.joints[largest]),
        )


_MIN_TORQUE = 1e-9
"""Lower bound of the divisor [N m, N] that replaces a missing or zero torque limit in the selection
of the most loaded motor. The bound prevents a division by zero. Chosen, not tuned.
"""


def _max_over_runs(walk: Walk, name: str) -> Array:
    """Return the maximum over all runs of a gait's attribute ``name``, (nu,), ignoring NaN."""
    worst: Array = np.fmax.reduce([getattr(gait, name) for gait in walk.gaits])
    return worst


def _make_motor_table(walk: Walk) -> doc.Table:
    """Create the table of motors: a row per joint, with the largest values of all runs.

    The static torques belong to the first run.
    """
    units = find_common_units(walk.torque_units)
    rms, peak, share, speed = (
        _max_over_runs(walk, name)
        for name in ("torque_rms", "torque_peak", "at_limit", "speed_peak")
    )
    static = walk.gaits[0].static
    form = doc.widen_format(".2f", rms.tolist())
    rows = tuple(
        (
            doc.Name(joint),
            doc.number_cell(rms[index], form),
            doc.number_cell(peak[index], form),
            doc.number_cell(None if static is None else static[index], form),
            limit_cell(float(walk.limits[index]), form),
            doc.number_cell(
                100 * share[index] if np.isfinite(share[index]) else None,
                ".1f",
                "warn" if share[index] > 0 else "",
            ),
            doc.number_cell(speed[index], ".1f"),
        )
        for index, joint in enumerate(walk.joints)
    )
    columns = (
        doc.Column(text("walk-joint"), left=True),
        doc.Column(text("walk-rms"), units.effort),
        doc.Column(text("walk-peak"), units.effort),
        doc.Column(text("walk-standing"), units.effort),
        doc.Column(text("walk-limit"), units.effort),
        doc.Column(text("walk-share"), "%"),
        doc.Column(text("walk-fastest"), units.velocity),
    )
    notes = (text("walk-statics-how"),)
    return doc.Table(text("walk-joints"), columns, rows, notes, (_describe_simulation(walk),))


def _describe_simulation(walk: Walk) -> doc.Text:
    """Describe the simulation: rate, gains, integrator, time step, warm-up."""
    contract = walk.contract
    gains = text("walk-own-gains")
    if contract.kp is not None and contract.kd is not None:
        gains = text(
            "walk-given-gains", kp=_format_range(contract.kp), kd=_format_range(contract.kd)
        )
    same = abs(walk.rate - contract.rate) <= 1e-6 * contract.rate
    rate = f"{walk.rate:.6g}" if same else f"{walk.rate:.6g} ({contract.rate:g})"
    return text("walk-how", rate=rate, gains=gains, integrator=walk.integrator,
                timestep=f"{1e3 * walk.timestep:g}", warm_up=f"{walk.warm_up:g}")  # fmt: skip


def _format_range(values: Array) -> str:
    """Return a range of values as text, such as ``-2..5``; one value if both texts are equal."""
    return "..".join(dict.fromkeys(f"{float(value):g}" for value in (values.min(), values.max())))


def _describe_outcome(gait: Gait) -> doc.Words:
    """Return the outcome of a run as text: the fall, or whether the command was tracked."""
    if gait.fall is not None:
        return doc.diagnostic_text(gait.fall, "bad")
    return text("walk-tracks" if gait.tracks else "walk-tracks-not")


def _make_run_table(walk: Walk) -> doc.Table:
    """Create the table of the simulated runs, a row per seed: velocities, power, sway, margin."""
    rows = tuple(
        (
            doc.Name(str(gait.seed)),
            doc.number_cell(float(gait.velocity[0]), ".3f"),
            doc.number_cell(float(gait.velocity[1]), ".3f"),
            doc.number_cell(gait.turning, ".3f"),
            doc.number_cell(gait.power, ".1f"),
            doc.number_cell(gait.transport, ".2f"),
            doc.Name(f"{np.degrees(gait.roll):.1f}, {np.degrees(gait.pitch):.1f}"),
            doc.number_cell(1e3 * gait.bounce, ".1f"),
            doc.number_cell(gait.margin, ".2f"),
            _describe_outcome(gait),
        )
        for gait in walk.gaits
    )
    columns = (
        doc.Column(text("walk-seed")),
        doc.Column(text("walk-forward"), "m/s"),
        doc.Column(text("walk-left"), "m/s"),
        doc.Column(text("walk-turning"), "rad/s"),
        doc.Column(text("walk-power"), "W"),
        doc.Column(text("walk-transport")),
        doc.Column(text("walk-sway"), "°"),
        doc.Column(text("walk-bounce"), "mm"),
        doc.Column(text("walk-margin")),
        doc.Column(text("walk-outcome"), left=True),
    )
    return doc.Table(text("walk-runs"), columns, rows)


_NEUTRAL_VALUES = {"clip": math.inf, "action-clip": math.inf, "history": 1}
"""{key: value without effect}. The table omits a key with this value that no file states."""


def make_key_table(contract: PolicyContract) -> doc.Table:
    """Create the table of a policy contract: main keys with value, origin and source.

    A key that no file states, and that has the value of `_NEUTRAL_VALUES`, is left out.
    """
    values: dict[str, Any] = {
        "observation": ", ".join(
            f"{term.name} x {term.history}" if term.history else term.name
            for term in contract.terms
        ),
        "joints": ", ".join(contract.joints[:3]) + (" ..." if len(contract.joints) > 3 else ""),
        "default": contract.default,
        "action-offset": contract.offset,
        "action-scale": contract.action_scale,
        "kp": contract.kp,
        "kd": contract.kd,
        "effort": contract.effort,
        "rate": contract.rate,
        "latency": contract.latency,
        "clip": contract.clip,
        "action-clip": contract.action_clip,
        "history": contract.history,
        "layout": contract.layout,
    }
    rows = []
    for key, value in values.items():
        origin, place = contract.origins[key], contract.sources[key]
        is_neutral = not place and (value is None or value == _NEUTRAL_VALUES.get(key))
        if is_neutral and origin != "unknown":
            continue
        if isinstance(value, np.ndarray):
            value = _format_range(value)
        shown = "-" if value is None else f"{value:g}" if isinstance(value, float) else str(value)
        is_file = bool(place) and origin != "default"
        where = Path(place).name if is_file else place or "-"
        mark = "warn" if origin == "unknown" else ""
        rows.append(
            (
                doc.Name(key),
                doc.Name(shown),
                text(f"walk-origin-{origin}").with_mark(mark),
                doc.Name(where),
            )
        )
    columns = tuple(
        doc.Column(text(name), left=True)
        for name in ("walk-key", "walk-value", "walk-origin", "walk-place-of-key")
    )
    return doc.Table(text("walk-keys"), columns, tuple(rows), (text("walk-keys-note"),))


_NUM_DRAWN_MOTORS = 4
"""Maximum number of motors whose torques are drawn: the motors with the largest rms torque. Chosen,
not tuned.
"""


def walk_torque_plot(walk: Walk) -> doc.LinePlot:
    """Create the plot of motor torques [N m, N for slides] in the last second of the first run.

    The motors with the largest rms torques are drawn.
    """
    gait = walk.gaits[0]
    hardest = np.argsort(-gait.torque_rms, kind="stable")[:_NUM_DRAWN_MOTORS]
    lines = [
        doc.Series(
            doc.Name(walk.joints[index]),
            gait.torque_time,
            gait.torques[:, index],
            note=text(
                "walk-motor-limit", limit=f"{walk.limits[index]:.3g}", unit=walk.torque_units[index]
            )
            if math.isfinite(walk.limits[index])
            else None,
        )
        for index in hardest
    ]
    time = doc.Axis(text("walk-time"), "s", ".1f")
    unit = find_common_units(walk.torque_units[index] for index in hardest).effort
    torque = doc.Axis(text("walk-torque"), unit, ".1f")
    return doc.LinePlot(text("walk-torques"), time, torque, lines)


@build_document.register(TrackedIntervals)
def intervals_document(result: TrackedIntervals, robot: Robot | None = None) -> doc.Document:
    """Create the report of the intervals of quantities in which a policy tracks the command."""
    outside = [interval for interval in result.intervals if interval.inside is False]
    if not result.seeds:
        word = "walk-does-not-follow"
    elif outside:
        word = "walk-outside"
    elif len(result.seeds) < result.requested_seeds:
        word = "walk-follows-in-part"
    else:
        word = "walk-follows" if result.passed else "UNKNOWN"
    names = [_name_quantity(interval.quantity) for interval in outside]
    reasons = [text("walk-outside-of", names=join_words(names))] if outside else []
    if len(result.seeds) < result.requested_seeds:
        count = result.requested_seeds - len(result.seeds)
        reasons.append(text("walk-unchanged-fails", count=count, asked=result.requested_seeds))
    return doc.Document(
        text("walk-intervals-title"),
        text("walk-of", robot=doc.Name(result.name), policy=doc.Name(result.policy)),
        (_make_interval_table(result),) if result.intervals else (),
        passed=result.passed,
        verdict=text(word),
        warned=result.passed and bool(result.narrow),
        failures=tuple(reasons),
        findings=(
            *_list_narrow_margins(result),
            *_list_absolute_limits(result),
            text("walk-commanded", command=_format_command(result.command)),
            *_describe_nominal_margins(result),
            *map(doc.diagnostic_text, result.remarks),
        ),
        notes=robot_notes(robot),
        next_step=_select_step_after_intervals(result, outside=bool(outside)),
    )


def _select_step_after_intervals(result: TrackedIntervals, *, outside: bool) -> doc.NextStep:
    """Return the command line to suggest after a search for tracked intervals.

    ``outside``: an interval measured on the real robot is not inside the tracked interval.
    """
    omitted = ("--vary", "--fit")
    if not result.seeds:
        return doc.NextStep("walk", ("--orders",), omitted=("--command", "--seeds", *omitted))
    if outside or not result.passed or result.narrow:
        return doc.NextStep("walk", ("--seeds", "20"), omitted=(*omitted, "--seeds"))
    return doc.NextStep("walk", ("--response",), omitted=("--command", *omitted))


def _list_narrow_margins(result: TrackedIntervals) -> Iterable[doc.Words]:
    """Yield a warning for each criterion whose margin is narrow (`TrackedIntervals.narrow`)."""
    for name in result.narrow:
        margins = getattr(result, f"{name}_margins")[list(result.seeds)]
        yield text(
            "walk-narrow",
            criterion=text(f"walk-ends-{name}"),
            margin=f"{100 * margins.min():.0f}",
            spread=f"{100 * np.ptp(margins):.0f}",
        ).with_mark("warn")


def _describe_nominal_margins(result: TrackedIntervals) -> Iterable[doc.Words]:
    """Yield a text of the smallest margins [%] of the unchanged robot for speed and turning."""
    if result.seeds:
        speed, turning = (
            margins[list(result.seeds)].min()
            for margins in (result.speed_margins, result.turning_margins)
        )
        yield text(
            "walk-nominal-margins", speed=f"{100 * speed:.0f}", turning=f"{100 * turning:.0f}"
        )


def _describe_ends(failures: tuple[str, ...]) -> doc.Words:
    """Return the text of the reasons why an interval ends, the most frequent reason first.

    ``failures`` contains ``falls``, ``speed``, ``turning`` or "" (none) for each seed.
    """
    names = Counter(name for name in failures if name)
    words = [text(f"walk-ends-{name}") for name, _ in names.most_common()]
    return join_words(words) if words else doc.Name("-")


def _list_absolute_limits(result: TrackedIntervals) -> Iterable[doc.Words]:
    """Yield texts of the largest payload [kg] and impulses [N s] with which all seeds track."""
    for interval in result.intervals:
        if interval.quantity == "payload":
            yield text(
                "walk-carries",
                mass=f"{interval.common[1] * result.mass:.3g}",
                upright=f"{interval.upright[1] * result.mass:.3g}",
                cause=_describe_ends(interval.ended_above),
            )
        elif interval.quantity.startswith("push"):
            low, high = (f"{abs(value) * result.mass:.3g}" for value in interval.common)
            yield text(f"walk-{interval.quantity}", low=low, high=high)


def _format_command(command: Array) -> doc.Name:
    """Return a velocity command (forward [m/s], left [m/s], turning left [rad/s]) as text."""
    return doc.Name(f"{command[0]:g}, {command[1]:g} m/s, {command[2]:g} rad/s")


def _name_quantity(name: str) -> doc.Text:
    """Return the readable name of a quantity, from its key in `VARIED_QUANTITIES`."""
    return text(f"walk-quantity-{name}")


def _make_interval_table(result: TrackedIntervals) -> doc.Table:
    """Create the table of the intervals of varied quantities in which the policy tracks."""
    rows = tuple(
        (
            _name_quantity(interval.quantity),
            doc.Name("x" if interval.unit == "x" else interval.unit),
            _make_bound_cell(interval, interval.least.max(), interval.below),
            _describe_ends(interval.ended_below),
            _make_bound_cell(interval, interval.most.min(), interval.above),
            _describe_ends(interval.ended_above),
            doc.Name(f"{interval.upright[0]:.3g} - {interval.upright[1]:.3g}"),
            doc.Name(f"{interval.least.min():.3g}, {interval.most.max():.3g}"),
            *(
                _make_measured_cells(interval)
                if any(interval.measured for interval in result.intervals)
                else ()
            ),
        )
        for interval in result.intervals
    )
    columns = [
        doc.Column(text("walk-quantity"), left=True),
        doc.Column(text("walk-unit"), left=True),
        doc.Column(text("walk-least")),
        doc.Column(text("walk-ended-by"), left=True),
        doc.Column(text("walk-most")),
        doc.Column(text("walk-ended-by"), left=True),
        doc.Column(text("walk-upright")),
        doc.Column(text("walk-spread"), detail=True),
    ]
    if any(interval.measured for interval in result.intervals):
        columns += [doc.Column(text("walk-measured")), doc.Column(text("walk-inside"), left=True)]
    how = text("walk-intervals-how", count=result.rollouts, seconds=f"{result.seconds:g}",
               seeds=len(result.seeds))  # fmt: skip
    note = text("walk-intervals-note")
    return doc.Table(text("walk-intervals"), tuple(columns), rows, (note,), (how,))


def _make_bound_cell(interval: TrackedInterval, tracked: float, beyond: Array) -> doc.Number:
    """Create the cell of one end of an interval of values at which the policy tracks the command.

    The cell is marked with ``*`` if the range ended before an untracked value was found.
    ``beyond``, shape (seeds,), is the nearest untracked value, NaN without.
    """
    open_end = tracked != interval.nominal and bool(np.isnan(beyond).all())
    return doc.Number(f"{tracked:.3g}{' *' if open_end else ''}", float(tracked))


def _make_measured_cells(interval: TrackedInterval) -> tuple[doc.Cell, doc.Cell]:
    """Return two cells: measured interval, and whether it is inside the tracked interval."""
    if interval.measured is None:
        return doc.Name("-"), doc.Name("-")
    low, high = interval.measured
    key, mark = ("walk-inside-yes", "good") if interval.inside else ("walk-inside-no", "bad")
    return doc.Name(f"{low:.3g} - {high:.3g}"), text(key).with_mark(mark)


@build_document.register(ResponseMap)
def response_document(result: ResponseMap, robot: Robot | None = None) -> doc.Document:
    """Create the report of the achieved velocities for a grid of commands."""
    zones = [axis for axis in result.axes if any(axis.dead_zone)]
    fallen = [axis for axis in result.axes if axis.fallen.any()]
    word = "walk-response-good" if result.passed else "walk-response-gaps"
    if fallen:
        word = "walk-falls"
    units = {axis.axis: "rad/s" if axis.axis == "turning" else "m/s" for axis in result.axes}
    findings = [
        text(
            "walk-dead-zone",
            axis=text(f"walk-{axis.axis}"),
            low=f"{axis.dead_zone[0]:g}",
            high=f"{axis.dead_zone[1]:g}",
            unit=units[axis.axis],
        )
        for axis in zones
    ]
    findings += [
        text(
            "walk-falls-at",
            axis=text(f"walk-{axis.axis}"),
            values=tuple(f"{value:g}" for value in axis.commanded[axis.fallen > 0]),
            unit=units[axis.axis],
        )
        for axis in fallen
    ]
    blocks: list[doc.Block] = []
    for axis in result.axes:
        blocks += [_make_response_table(axis, units[axis.axis], result), response_plot(axis)]
    return doc.Document(
        text("walk-response-title"),
        text("walk-of", robot=doc.Name(result.name), policy=doc.Name(result.policy)),
        tuple(blocks),
        passed=result.passed,
        verdict=text(word),
        findings=(
            *(findings or [text("walk-response-all")]),
            *map(doc.diagnostic_text, result.remarks),
        ),
        brief=True,
        notes=robot_notes(robot),
        next_step=doc.NextStep("walk", omitted=("--response",)),
    )


def _make_response_table(axis: ResponseAxis, unit: str, result: ResponseMap) -> doc.Table:
    """Create the table of commanded and achieved velocities along an axis."""
    rows = tuple(
        (
            doc.number_cell(float(commanded), ".3g"),
            doc.number_cell(float(achieved) if np.isfinite(achieved) else None, ".3f"),
            doc.number_cell(float(spread) if np.isfinite(spread) else None, ".3f"),
            doc.number_cell(float(count), ".0f", "bad" if count else ""),
        )
        for commanded, achieved, spread, count in zip(
            axis.commanded, axis.achieved, axis.spread, axis.fallen, strict=True
        )
    )
    columns = (
        doc.Column(text("walk-commanded-velocity"), unit),
        doc.Column(text("walk-achieved-velocity"), unit),
        doc.Column(text("walk-spread-of-seeds"), unit),
        doc.Column(text("walk-fallen")),
    )
    how = text("walk-response-how", seeds=result.seeds, seconds=f"{result.seconds:g}")
    return doc.Table(text(f"walk-{axis.axis}"), columns, rows, (how,))


def response_plot(axis: ResponseAxis) -> doc.LinePlot:
    """Create the plot of the achieved over the commanded velocity, with the ideal line."""
    unit = "rad/s" if axis.axis == "turning" else "m/s"
    ends = axis.commanded[[0, -1]]
    known = np.isfinite(axis.achieved)
    lines = [
        doc.Series(text("walk-ideal"), ends, ends),
        doc.Series(text("walk-achieved-velocity"), axis.commanded[known], axis.achieved[known]),
    ]
    return doc.LinePlot(
        text(f"walk-{axis.axis}"),
        doc.Axis(text("walk-commanded-velocity"), unit, ".2f"),
        doc.Axis(text("walk-achieved-velocity"), unit, ".2f"),
        lines,
    )


@build_document.register(TraceCheck)
def trace_document(result: TraceCheck, robot: Robot | None = None) -> doc.Document:
    """Create the report of the comparison of a policy's contract with a recorded trace."""
    wrong = [check for check in result.checks if check.mistake not in ("", "unchecked")]
    terms = result.signal_checks
    agreeing = [check for check in terms if check.mistake == ""]
    word = "walk-trace-differs" if wrong else "walk-trace-matches"
    if not wrong and not agreeing:
        word = "walk-trace-nothing"
    unchecked = [check.term for check in terms if check.mistake == "unchecked"]
    summary = text(
        "walk-trace-checked",
        count=len(agreeing),
        all=len(terms),
        names=doc.Name(", ".join(unchecked) or "-"),
    )
    mistakes = tuple(
        text(
            "walk-trace-mistake",
            term=doc.Name(check.term),
            mistake=text(f"walk-mistake-{check.mistake}"),
            detail=check.detail,
        )
        for check in wrong
    )
    rows = tuple(
        (
            doc.Name(check.term),
            doc.Name("-" if check.first < 0 else f"{check.first}-{check.first + check.size - 1}"),
            doc.number_cell(check.error, ".2g"),
            text(f"walk-mistake-{check.mistake or 'none'}").with_mark(
                "bad" if check in wrong else ""
            ),
            doc.Name(check.detail),
        )
        for check in result.checks
    )
    columns = (
        doc.Column(text("walk-trace-term"), left=True),
        doc.Column(text("walk-trace-elements"), left=True),
        doc.Column(text("walk-trace-error")),
        doc.Column(text("walk-trace-result"), left=True),
        doc.Column(text("walk-trace-detail"), left=True),
    )
    how = text("walk-trace-how", samples=result.samples, period=f"{1e3 * result.period:.3g}")
    return doc.Document(
        text("walk-trace-title"),
        text(
            "walk-trace-of",
            robot=doc.Name(result.name),
            policy=doc.Name(result.policy),
            trace=doc.Name(result.trace),
        ),
        (doc.Table(text("walk-trace-title"), columns, rows, (how,)),),
        passed=result.passed,
        verdict=text(word),
        failures=mistakes,
        findings=(summary,),
        brief=True,
        notes=robot_notes(robot),
        next_step=doc.NextStep("walk", omitted=("--trace",)),
    )


@build_document.register(Orders)
def orders_document(result: Orders, robot: Robot | None = None) -> doc.Document:
    """Create the report of a ranking of joint orders, signs, scales and histories of a policy."""
    best, stated = result.candidates[0], result.candidates[result.stated]
    if not best.tracked:
        word, line = "walk-of-none", text("walk-none-tracks", count=len(result.candidates))
    elif result.stated not in result.alike:
        word = "walk-of-another"
        line = text(
            "walk-better",
            change=_describe_change(best),
            torque=f"{best.torque:.2f}",
            own=f"{stated.torque:.2f}",
            tracked=best.tracked,
            own_tracked=stated.tracked,
            count=len(result.commands),
        )
    elif result.determined:
        word, line = "walk-of-this", text("walk-best-is-stated", torque=f"{stated.torque:.2f}")
    else:
        other_places = [place for place in result.alike if place != result.stated]
        word = "walk-not-determined"
        line = text(
            "walk-as-well",
            names=join_words(_describe_change(result.candidates[place]) for place in other_places),
        )
    if result.stated in result.alike and not result.passed:
        word = "UNKNOWN"
    return doc.Document(
        text("walk-orders-title"),
        text("walk-of", robot=doc.Name(result.name), policy=doc.Name(result.policy)),
        (_make_candidate_table(result),),
        passed=result.passed,
        verdict=text(word),
        warned=result.passed and not result.determined,
        failures=() if result.passed else (line,),
        findings=(
            *((line,) if result.passed else ()),
            *map(doc.diagnostic_text, result.remarks),
            text("walk-orders-not"),
        ),
        notes=robot_notes(robot),
        next_step=_select_step_after_orders(result),
    )


TEMPLATE_STEP = doc.NextStep(
    "walk",
    ("--init",),
    omitted=(
        "--command", "--seeds", "--seconds", "--vary", "--fit", "--effort", "--motor", "--orders",
        "--contract", "--trace", "--response",
    ),
)  # fmt: skip
"""Next command that writes a template of the TOML file of a policy, without the typed options that
``--init`` refuses."""


def _select_step_after_orders(result: Orders) -> doc.NextStep:
    """Return the next command after a ranking of interpretations of a policy."""
    if not result.candidates[0].tracked:
        return doc.NextStep("audit")
    if result.stated not in result.alike:
        return TEMPLATE_STEP
    if not result.passed:
        return doc.NextStep("audit")
    if result.determined:
        return doc.NextStep("walk", ("--vary", "mass,kp,delay"), omitted=("--orders",))
    return doc.NextStep("walk", ("--response",), omitted=("--orders",))


def _describe_change(candidate: Candidate) -> doc.Words:
    """Describe how a tested interpretation of the policy differs from the stated contract."""
    if candidate.change == "stated":
        return text("walk-change-stated")
    if candidate.change == "sign":
        return text("walk-change-sign", joints=join_words(map(doc.Name, candidate.flipped)))
    if candidate.change == "by-kind" and not candidate.detail:
        return text("walk-change-kinds")
    return text(f"walk-change-{candidate.change}", detail=doc.Name(candidate.detail))


_MAX_SHOWN_CANDIDATES = 12
"""Maximum number of interpretations of a policy in the table, in addition to the stated
interpretation. Chosen, not tuned.
"""


def _make_candidate_table(result: Orders) -> doc.Table:
    """Create the table of the best interpretations of a policy, with the stated interpretation."""
    places = sorted({*range(min(_MAX_SHOWN_CANDIDATES, len(result.candidates))), result.stated})
    rows = []
    for place in places:
        candidate = result.candidates[place]
        mark = "good" if place in result.alike else ""
        rows.append(
            (
                doc.Name(str(place + 1)),
                _describe_change(candidate),
                doc.number_cell(candidate.tracked, ".0f", mark),
                doc.number_cell(candidate.fallen, ".0f", "bad" if candidate.fallen else ""),
                doc.number_cell(candidate.torque, ".2f"),
                doc.number_cell(candidate.error, ".2f"),
                doc.number_cell(candidate.cost, ".2f"),
            )
        )
    columns = (
        doc.Column(text("walk-place")),
        doc.Column(text("walk-change"), left=True),
        doc.Column(text("walk-tracked")),
        doc.Column(text("walk-fallen")),
        doc.Column(text("walk-rms"), "N m"),
        doc.Column(text("walk-error"), "1"),
        doc.Column(text("walk-cost"), "N m"),
    )
    commands = join_words(map(_format_command, result.commands), "semicolon")
    how = text(
        "walk-orders-how",
        count=len(result.candidates),
        commands=commands,
        seconds=f"{result.seconds:g}",
        clear=f"{100 * (MIN_COST_RATIO - 1):.0f}",
    )
    return doc.Table(text("walk-orders"), columns, tuple(rows), (how,))
