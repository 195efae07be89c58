"""Documents of walks: how a command is followed, how far a robot may change, whose a policy is."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.present import document as doc
from pupper_analysis.present.document import join_words, text
from pupper_analysis.present.documents.registry import build_document
from pupper_analysis.present.documents.standing import robot_notes
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.walk.gait import Gait, Walk
from pupper_analysis.tools.walk.intervals import TrackedInterval, TrackedIntervals
from pupper_analysis.tools.walk.orders import MIN_COST_RATIO, Candidate, Orders

Array = NDArray[np.float64]


@build_document.register(Walk)
def walk_document(walk: Walk, robot: Robot | None = None) -> doc.Document:
    """Returns how a policy walks a robot; see ``build_document``."""
    fallen = [gait for gait in walk.gaits if gait.fall is not None]
    word = "walk-follows" if walk.passed else "walk-falls" if fallen else "walk-does-not-follow"
    return doc.Document(
        text("walk-title"),
        text("walk-of", robot=doc.Name(walk.name), policy=doc.Name(walk.policy)),
        (
            _view(walk, robot),
            _motors(walk),
            _runs(walk),
            torque_plot(walk),
        ),
        passed=walk.passed,
        verdict=text(word),
        failures=tuple(doc.tell(gait.fall) for gait in fallen[:1] if gait.fall is not None),
        findings=(*_findings(walk), *map(doc.tell, walk.remarks)),
        notes=robot_notes(robot),
    )


_SEEN = 75
"""Configurations of the end of a run that are shown: 3 s, as many as a page has of a motion."""


def _view(walk: Walk, robot: Robot | None) -> doc.View:
    """Returns the first run's last seconds in three dimensions, the base kept where it is."""
    gait, motions = walk.gaits[0], []
    for name, kept in (("walk-begins", slice(0, 1)), ("walk-end-of-run", slice(-_SEEN, None))):
        qpos = gait.motion[kept].copy()
        qpos[:, :2] = 0.0
        motions.append(doc.Motion(text(name), gait.motion_time[kept], qpos))
    scene = None if robot is None else doc.MotionScene(robot, motions)
    return doc.View(text("walk-view"), scene, text("walk-view-note"))


def _findings(walk: Walk) -> Iterable[doc.Words]:
    first, gaits = walk.gaits[0], walk.gaits
    yield text(
        "walk-speed-line",
        forward=f"{first.velocity[0]:.2f}",
        asked=f"{first.command[0]:g}",
        left=f"{first.velocity[1]:.2f}",
        asked_left=f"{first.command[1]:g}",
        turning=f"{first.turning:.2f}",
        asked_turning=f"{first.command[2]:g}",
    )
    rms = _worst(walk, "torque_rms")
    share = np.where(np.isfinite(walk.limits), rms / walk.limits, rms / rms.max(initial=1e-9))
    most = int(np.argmax(share))
    yield text(
        "walk-torque-line",
        joint=doc.Name(walk.joints[most]),
        rms=f"{rms[most]:.2f}",
        peak=f"{_worst(walk, 'torque_peak')[most]:.2f}",
        share=f"{100 * _worst(walk, 'at_limit')[most]:.1f}",
    )
    yield text(
        "walk-power-line",
        power=f"{first.power:.1f}",
        cost="-" if first.transport is None else f"{first.transport:.2f}",
        margin=f"{min(gait.margin for gait in gaits):.2f}",
    )
    duty = ", ".join(f"{foot} {100 * share:.0f} %" for foot, share in first.duty.items())
    yield text("walk-duty", feet=doc.Name(duty))
    if len(gaits) > 1:
        yield text(
            "walk-against",
            tracking=sum(gait.tracks for gait in gaits),
            count=len(gaits),
            fallen=sum(gait.fall is not None for gait in gaits),
        )
    if touching := sorted({body for gait in gaits for body in gait.touching}):
        yield text("walk-touching", bodies=doc.Name(", ".join(touching)))


def _worst(walk: Walk, name: str) -> Array:
    """Returns the greatest of all runs, for each motor."""
    worst: Array = np.max([getattr(gait, name) for gait in walk.gaits], axis=0)
    return worst


def _motors(walk: Walk) -> doc.Table:
    rms, peak, share, speed = (
        _worst(walk, name) for name in ("torque_rms", "torque_peak", "at_limit", "speed_peak")
    )
    static = walk.gaits[0].static
    rows = tuple(
        (
            doc.Name(joint),
            doc.number_cell(rms[index], ".2f"),
            doc.number_cell(peak[index], ".2f"),
            doc.number_cell(None if static is None else static[index], ".2f"),
            doc.number_cell(walk.limits[index], ".2f"),
            doc.number_cell(100 * share[index], ".1f", "warn" if share[index] > 0 else ""),
            doc.number_cell(speed[index], ".1f"),
        )
        for index, joint in enumerate(walk.joints)
    )
    columns = (
        doc.Column(text("walk-joint"), left=True),
        doc.Column(text("walk-rms"), "N m"),
        doc.Column(text("walk-peak"), "N m"),
        doc.Column(text("walk-standing"), "N m"),
        doc.Column(text("walk-limit"), "N m"),
        doc.Column(text("walk-share"), "%"),
        doc.Column(text("walk-fastest"), "rad/s"),
    )
    notes = (text("walk-statics-how"),)
    return doc.Table(text("walk-joints"), columns, rows, notes, (_how(walk),))


def _how(walk: Walk) -> doc.Text:
    contract = walk.contract
    gains = text("walk-own-gains")
    if contract.kp is not None and contract.kd is not None:
        gains = text("walk-given-gains", kp=_range(contract.kp), kd=_range(contract.kd))
    same = abs(walk.rate - contract.rate) <= 1e-6 * contract.rate
    rate = f"{walk.rate:.6g}" if same else f"{walk.rate:.6g} ({contract.rate:g})"
    return text("walk-how", rate=rate, gains=gains, integrator=walk.integrator,
                timestep=f"{1e3 * walk.timestep:g}", warm_up=f"{walk.warm_up:g}")  # fmt: skip


def _range(values: Array) -> str:
    low, high = float(values.min()), float(values.max())
    return f"{low:g}" if low == high else f"{low:g}-{high:g}"


def _outcome(gait: Gait) -> doc.Words:
    if gait.fall is not None:
        return doc.tell(gait.fall, "bad")
    return text("walk-tracks" if gait.tracks else "walk-tracks-not")


def _runs(walk: Walk) -> doc.Table:
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
            _outcome(gait),
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


_DRAWN = 4
"""Motors whose torques are drawn: those with the largest rms."""


def torque_plot(walk: Walk) -> doc.LinePlot:
    """Returns the torques of the motors that are asked most, in the first run's last second."""
    gait = walk.gaits[0]
    most = np.argsort(-gait.torque_rms, kind="stable")[:_DRAWN]
    lines = [
        doc.Series(doc.Name(walk.joints[index]), gait.torque_time, gait.torques[:, index])
        for index in most
    ]
    time = doc.Axis(text("walk-time"), "s", ".1f")
    torque = doc.Axis(text("walk-torque"), "N m", ".1f")
    return doc.LinePlot(text("walk-torques"), time, torque, lines)


@build_document.register(TrackedIntervals)
def intervals_document(found: TrackedIntervals, robot: Robot | None = None) -> doc.Document:
    """Returns how far a robot may change; see ``build_document``."""
    outside = [one for one in found.intervals if one.inside is False]
    if not found.seeds:
        word = "walk-does-not-follow"
    elif outside:
        word = "walk-outside"
    else:
        word = "walk-follows" if found.passed else "walk-follows-in-part"
    against = [_quantity(one.quantity) for one in outside]
    reasons = [text("walk-outside-of", names=join_words(against))] if outside else []
    if len(found.seeds) < found.asked:
        count = found.asked - len(found.seeds)
        reasons.append(text("walk-unchanged-fails", count=count, asked=found.asked))
    return doc.Document(
        text("walk-intervals-title"),
        text("walk-of", robot=doc.Name(found.name), policy=doc.Name(found.policy)),
        (_intervals(found),) if found.intervals else (),
        passed=found.passed,
        verdict=text(word),
        failures=tuple(reasons),
        findings=(
            text("walk-commanded", command=_command(found.command)),
            *_absolute(found),
            *map(doc.tell, found.remarks),
        ),
        notes=robot_notes(robot),
    )


def _absolute(found: TrackedIntervals) -> Iterable[doc.Words]:
    """Yields what payload (kg) and pushes (N s) are that the runs of all starts still track."""
    for one in found.intervals:
        if one.quantity == "payload":
            yield text("walk-carries", mass=f"{one.common[1] * found.mass:.3g}")
        elif one.quantity.startswith("push"):
            low, high = (f"{abs(value) * found.mass:.3g}" for value in one.common)
            yield text(f"walk-{one.quantity}", low=low, high=high)


def _command(command: Array) -> doc.Name:
    return doc.Name(f"{command[0]:g}, {command[1]:g} m/s, {command[2]:g} rad/s")


def _quantity(name: str) -> doc.Text:
    return text(f"walk-quantity-{name}")


def _intervals(found: TrackedIntervals) -> doc.Table:
    rows = tuple(
        (
            _quantity(one.quantity),
            doc.Name("x" if one.unit == "x" else one.unit),
            _end(one, one.least.max(), one.below),
            _end(one, one.most.min(), one.above),
            doc.Name(f"{one.least.min():.3g}, {one.most.max():.3g}"),
            *(_measured(one) if any(one.measured for one in found.intervals) else ()),
        )
        for one in found.intervals
    )
    columns = [
        doc.Column(text("walk-quantity"), left=True),
        doc.Column(text("walk-unit"), left=True),
        doc.Column(text("walk-least")),
        doc.Column(text("walk-most")),
        doc.Column(text("walk-spread"), detail=True),
    ]
    if any(one.measured for one in found.intervals):
        columns += [doc.Column(text("walk-measured")), doc.Column(text("walk-inside"), left=True)]
    how = text("walk-intervals-how", count=found.rollouts, seconds=f"{found.seconds:g}",
               seeds=len(found.seeds))  # fmt: skip
    note = text("walk-intervals-note")
    return doc.Table(text("walk-intervals"), tuple(columns), rows, (note,), (how,))


def _end(one: TrackedInterval, tracked: float, beyond: Array) -> doc.Number:
    """Returns an end up to which all runs track; marked where it is that of what was tried."""
    open_end = tracked != one.nominal and bool(np.isnan(beyond).all())
    return doc.Number(f"{tracked:.3g}{' *' if open_end else ''}", float(tracked))


def _measured(one: TrackedInterval) -> tuple[doc.Cell, doc.Cell]:
    if one.measured is None:
        return doc.Name("-"), doc.Name("-")
    low, high = one.measured
    key, mark = ("walk-inside-yes", "good") if one.inside else ("walk-inside-no", "bad")
    return doc.Name(f"{low:.3g} - {high:.3g}"), text(key).marked(mark)


@build_document.register(Orders)
def orders_document(found: Orders, robot: Robot | None = None) -> doc.Document:
    """Returns which reading of a policy walks best; see ``build_document``."""
    best, own = found.candidates[0], found.candidates[found.stated]
    if not best.tracked:
        word, line = "walk-of-none", text("walk-none-tracks", count=len(found.candidates))
    elif not found.passed:
        word = "walk-of-another"
        line = text(
            "walk-better",
            change=_change(best),
            torque=f"{best.torque:.2f}",
            own=f"{own.torque:.2f}",
            tracked=best.tracked,
            own_tracked=own.tracked,
            count=len(found.commands),
        )
    elif found.determined:
        word, line = "walk-of-this", text("walk-best-is-stated", torque=f"{own.torque:.2f}")
    else:
        others = [place for place in found.alike if place != found.stated]
        word = "walk-not-determined"
        line = text(
            "walk-as-well", names=join_words(_change(found.candidates[one]) for one in others)
        )
    return doc.Document(
        text("walk-orders-title"),
        text("walk-of", robot=doc.Name(found.name), policy=doc.Name(found.policy)),
        (_candidates(found),),
        passed=found.passed,
        verdict=text(word),
        warned=found.passed and not found.determined,
        failures=() if found.passed else (line,),
        findings=(*((line,) if found.passed else ()), text("walk-orders-not")),
        notes=robot_notes(robot),
    )


def _change(one: Candidate) -> doc.Words:
    """Says what of a reading is other than the policy states."""
    if one.change == "stated":
        return text("walk-change-stated")
    if one.change == "sign":
        return text("walk-change-sign", joints=join_words(map(doc.Name, one.flipped)))
    if one.change == "by-kind" and not one.detail:
        return text("walk-change-kinds")
    return text(f"walk-change-{one.change}", detail=doc.Name(one.detail))


_MOST_SHOWN = 12
"""Readings in a table: the best, and what the policy states."""


def _candidates(found: Orders) -> doc.Table:
    places = sorted({*range(min(_MOST_SHOWN, len(found.candidates))), found.stated})
    rows = []
    for place in places:
        one = found.candidates[place]
        mark = "good" if place in found.alike else ""
        rows.append(
            (
                doc.Name(str(place + 1)),
                _change(one),
                doc.number_cell(one.tracked, ".0f", mark),
                doc.number_cell(one.fallen, ".0f", "bad" if one.fallen else ""),
                doc.number_cell(one.torque, ".2f"),
                doc.number_cell(one.error, ".2f"),
                doc.number_cell(one.cost, ".2f"),
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
    commands = join_words(map(_command, found.commands), "semicolon")
    how = text(
        "walk-orders-how",
        count=len(found.candidates),
        commands=commands,
        seconds=f"{found.seconds:g}",
        clear=f"{100 * (MIN_COST_RATIO - 1):.0f}",
    )
    return doc.Table(text("walk-orders"), columns, tuple(rows), (how,))
