"""Limbs that are alike: what some of them carry, and others do not.

Structure is a witness that no number is. Limbs with the same joints and the same masses are made to
do the same; where most end in a foot on the ground and one does not, a digit of its file is wrong,
or a shape is missing.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.robot.contact import limb_ends
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]

_ALIKE = 0.05
"""Masses of links that are alike differ by no more than this part of them, and the ways from joint
to joint by no more than this part of a limb: left and right ones of published robots are within
1 %. One of the two is enough: a digit that is wrong is in one of them."""

_APART = 2e-3
"""Bodies that are further from the place of a mirror image are somewhere else (m)."""

_UNLIKE = {"armature": 3.0, "damping": 3.0, "frictionloss": 3.0, "range": 1.5, "effort": 1.5}
"""{attribute: the factor by which a joint differs from its like}. What was measured joint by joint
differs by up to 2.1 in published robots (Aliengo's damping), what was designed by nothing."""

_IMAGES = tuple(np.diag([x, y, 1.0]) for x, y in itertools.product((1.0, -1.0), repeat=2))
"""Left and right, front and rear, both: where a limb's like may be, in the base's axes."""


@dataclass(frozen=True, eq=False)
class Limb:
    """A limb, from the base outwards.

    Attributes:
        bodies: The ids of its moving bodies.
        joints: The ids of its joints.
        kinds: Its joints' kinds.
        masses: What its bodies weigh, with what is fixed to them (kg).
        lengths: From one joint to the next (m), which no mirror changes.
        turns: |cos| between their axes, likewise.
    """

    bodies: tuple[int, ...]
    joints: tuple[int, ...]
    kinds: tuple[int, ...]
    masses: Array
    lengths: Array
    turns: Array

    def like(self, other: Limb) -> bool:
        """Tells whether two limbs have the same joints, and are of one weight or one shape."""
        if self.kinds != other.kinds:
            return False
        size = np.maximum(self.lengths, other.lengths).sum()
        long = np.abs(self.lengths - other.lengths) <= _ALIKE * size
        if size and long.all() and (np.abs(self.turns - other.turns) <= _ALIKE).all():
            return True
        if len(self.masses) != len(other.masses):
            return False
        most = np.maximum(self.masses, other.masses)
        return bool((np.abs(self.masses - other.masses) <= _ALIKE * most).all())


def limbs_of(robot: Robot) -> list[Limb]:
    """Returns the limbs of a robot, each to an end that carries nothing that moves."""
    model, data = robot.mj_model, robot.placed()
    weld, base = model.body_weldid, int(model.body_weldid[model.body(robot.mj_base).id])
    found = []
    for end in limb_ends(model):
        bodies: list[int] = []
        body = int(end)
        while body not in (0, base):
            if int(weld[body]) == body:
                bodies.insert(0, body)
            body = int(model.body_parentid[body])
        if body != base or not bodies:
            continue
        joints = np.flatnonzero(np.isin(model.jnt_bodyid, bodies))
        joints = joints[
            np.argsort([bodies.index(at) for at in model.jnt_bodyid[joints]], kind="stable")
        ]
        masses = [float(model.body_mass[weld == body].sum()) for body in bodies]
        kinds = tuple(model.jnt_type[joints].tolist())
        lengths = np.linalg.norm(np.diff(data.xanchor[joints], axis=0), axis=1)
        axes = data.xaxis[joints]
        turns = np.abs((axes[1:] * axes[:-1]).sum(axis=1))
        own = tuple(bodies), tuple(joints.tolist()), kinds
        found.append(Limb(*own, np.array(masses), lengths, turns))
    return found


def structure(robot: Robot) -> tuple[Diagnostic, ...]:
    """Tells of limbs without a foot, and of what else of a limb is unlike those that are alike."""
    limbs = limbs_of(robot)
    lacking = limbs_without_feet(robot, limbs)
    displaced = {str(message.values["displaced"]) for message in lacking}
    findings = [*_displaced_bodies(robot, limbs, displaced), *_joints_unlike(robot, limbs)]
    return (*lacking, *((diagnose("limbs-unlike", findings=findings),) if findings else ()))


def limbs_without_feet(robot: Robot, limbs: list[Limb]) -> list[Diagnostic]:
    """Tells of limbs that have no foot, where limbs that are alike have one.

    Feet that were named are as they were named, and no limb is missed.
    """
    if not any(note.code == "feet-found" for note in robot.notes):
        return []
    model, messages = robot.mj_model, []
    own = (body for point, (body, _) in robot.contact_places.items() if point not in robot.hands)
    carrying = {int(model.body_weldid[body]) for body in own}
    footed = [limb for limb in limbs if limb.bodies[-1] in carrying]
    for limb in limbs:
        alike = [other for other in footed if other.like(limb)]
        if limb in footed or not alike:
            continue
        every = [other for other in limbs if other.like(limb)]
        if len(alike) * 2 < len(every):
            continue
        body, gap = _displaced(robot, limb, alike)
        messages.append(
            diagnose(
                "limb-without-foot",
                subject=("body", model.body(limb.bodies[-1]).name),
                feet=len(alike),
                alike=len(every),
                displaced=body,
                gap=None if body is None else Quantity(gap, "m"),
            )
        )
    return messages


def _displaced_bodies(robot: Robot, limbs: list[Limb], displaced: set[str]) -> Iterator[Diagnostic]:
    """Yields other bodies that are no image of limbs that are alike, three of each other.

    Of fewer it cannot be known which is meant: fingers, arms and middle legs are each in a place of
    its own.
    """
    images = {
        limb: [
            other
            for other in limbs
            if other is not limb and other.like(limb) and not _displaced(robot, limb, [other])[0]
        ]
        for limb in limbs
    }
    for limb, own in images.items():
        alike = [other for other in limbs if other.like(limb) and len(images[other]) > 1]
        if own or not alike:
            continue
        body, gap = _displaced(robot, limb, alike)
        if body is not None and body not in displaced:
            yield diagnose("body-unlike", subject=("body", body), gap=Quantity(gap, "m"))


def _joints_unlike(robot: Robot, limbs: list[Limb]) -> Iterator[Diagnostic]:
    """Yields joints whose numbers are others than those of their like in each limb that is alike.

    Where two limbs are alike and differ, which of them is meant cannot be known: the one with the
    greater number is named.
    """
    numbers = _numbers_of(robot)
    for limb in limbs:
        others = [other for other in limbs if other is not limb and other.like(limb)]
        for joint, *like in zip(limb.joints, *(other.joints for other in others), strict=True):
            for attribute, values in numbers.items():
                own, theirs = values[joint], values[like]
                if not len(like) or theirs.max() > _UNLIKE[attribute] * theirs.min():
                    continue  # alone, or these are not alike either
                low, high = sorted((own, float(theirs.max())))
                if high <= _UNLIKE[attribute] * low or (len(like) == 1 and own == low):
                    continue
                yield diagnose(
                    "joint-unlike",
                    subject=("joint", robot.mj_model.joint(joint).name),
                    attribute=attribute,
                    value=own,
                    usual=float(theirs.max()),
                    like=robot.mj_model.joint(like[0]).name,
                )


def _numbers_of(robot: Robot) -> dict[str, Array]:
    """Returns {attribute: (njnt,) number} of what alike joints have alike; inf of no limit."""
    model = robot.mj_model
    at = model.jnt_dofadr
    found = {
        "armature": model.dof_armature[at],
        "damping": model.dof_damping[at],
        "frictionloss": model.dof_frictionloss[at],
        "range": np.where(model.jnt_limited, np.ptp(model.jnt_range, axis=1), np.inf),
        "effort": np.zeros(model.njnt),
    }
    for name, limit in zip(robot.joint_names, robot.effort_limits, strict=True):
        found["effort"][model.joint(name).id] = limit
    return found


def _displaced(robot: Robot, limb: Limb, alike: list[Limb]) -> tuple[str | None, float]:
    """Returns the first body of a limb that is not where those alike have theirs, and by how much.

    Of all images of limbs that are alike the one that begins nearest counts.
    """
    model, data = robot.mj_model, robot.placed()
    own = data.xpos[list(limb.bodies)]
    gaps = []
    for other in alike:
        there = data.xpos[list(other.bodies)]
        images = (*_IMAGES, _turned(there[0], own[0]))  # of a ring, the next one's
        gaps += [np.linalg.norm(own - there @ image.T, axis=1) for image in images]
    off = min(gaps, key=lambda gap: (float(np.round(gap[0], 3)), float(gap.max())))
    first = next((number for number, gap in enumerate(off) if gap > _APART), None)
    if first is None:
        return None, 0.0
    return str(model.body(limb.bodies[first]).name), float(off[first])


def _turned(start: Array, end: Array) -> Array:
    """Returns the rotation (3, 3) about the vertical that brings a place (3,) towards another."""
    angle = np.arctan2(end[1], end[0]) - np.arctan2(start[1], start[0])
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
