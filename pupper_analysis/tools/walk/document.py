"""The document of a walk: how it follows its command, and what it asks of the motors."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.present import document as doc
from pupper_analysis.present.documents.registry import build_document
from pupper_analysis.present.documents.standing import robot_notes
from pupper_analysis.present.words import text
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.walk.gait import Gait, Walk

Array = NDArray[np.float64]


@build_document.register(Walk)
def walk_document(walk: Walk, robot: Robot | None = None) -> doc.Document:
    """Returns how a policy walks a robot; see ``build_document``."""
    fallen = [gait for gait in walk.gaits if gait.fall is not None]
    word = "walk-follows" if walk.passed else "walk-falls" if fallen else "walk-does-not-follow"
    return doc.Document(
        text("walk-title"),
        text("walk-of", robot=doc.Name(walk.name), policy=doc.Name(walk.policy)),
        (_motors(walk), _runs(walk), _feet(walk), torque_plot(walk)),
        passed=walk.passed,
        verdict=text(word),
        failures=tuple(doc.tell(gait.fall) for gait in fallen[:1] if gait.fall is not None),
        told=tuple(_told(walk)),
        notes=robot_notes(robot),
    )


def _told(walk: Walk) -> Iterable[doc.Words]:
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
    rows = tuple(
        (
            doc.Name(joint),
            doc.number_cell(rms[index], ".2f"),
            doc.number_cell(peak[index], ".2f"),
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
        doc.Column(text("walk-limit"), "N m"),
        doc.Column(text("walk-share"), "%"),
        doc.Column(text("walk-fastest"), "rad/s"),
    )
    return doc.Table(text("walk-joints"), columns, rows, (), (_how(walk),))


def _how(walk: Walk) -> doc.Text:
    contract = walk.contract
    gains = text("walk-own-gains")
    if contract.kp is not None and contract.kd is not None:
        gains = text("walk-given-gains", kp=_range(contract.kp), kd=_range(contract.kd))
    return text(
        "walk-how",
        rate=f"{walk.rate:g}",
        gains=gains,
        integrator=walk.integrator,
        timestep=f"{1e3 * walk.timestep:g}",
        warm_up=f"{walk.warm_up:g}",
    )


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


def _feet(walk: Walk) -> doc.Table:
    duty = walk.gaits[0].duty
    rows = tuple(
        (doc.Name(foot), doc.number_cell(100 * share, ".0f")) for foot, share in duty.items()
    )
    columns = (doc.Column(text("walk-foot"), left=True), doc.Column(text("walk-duty"), "%"))
    return doc.Table(text("walk-feet"), columns, rows)


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
    time, torque = (
        doc.Axis(text("walk-time"), "s", ".1f"),
        doc.Axis(text("walk-torque"), "N m", ".1f"),
    )
    return doc.LinePlot(text("walk-torques"), time, torque, lines)
