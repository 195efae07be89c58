"""Limbs that are alike: what some of them carry, and others do not.

Structure is a witness that no number is. Limbs with the same joints and the same masses are made to
do the same; where most end in a foot on the ground and one does not, a digit of its file is wrong,
or a shape is missing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.robot.contact import limb_ends
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]

_ALIKE = 0.05
"""Masses of links that are alike differ by no more than this part of them, and the ways from joint
to joint by no more than this part of a limb: left and right ones of published robots are within
1 %. One of the two is enough: a digit that is wrong is in one of them."""


@dataclass(frozen=True, eq=False)
class Limb:
    """A limb, from the base outwards.

    Attributes:
        bodies: The ids of its moving bodies.
        kinds: Its joints' kinds.
        masses: What its bodies weigh, with what is fixed to them (kg).
        lengths: From one joint to the next (m), which no mirror changes.
        turns: |cos| between their axes, likewise.
    """

    bodies: tuple[int, ...]
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
        found.append(Limb(tuple(bodies), kinds, np.array(masses), lengths, turns))
    return found


def structure(robot: Robot) -> tuple[Diagnostic, ...]:
    """Tells of limbs that have no foot, where limbs that are alike have one.

    Feet that were named are as they were named, and no limb is missed.
    """
    if not any(note.code == "feet-found" for note in robot.notes):
        return ()
    model, messages, limbs = robot.mj_model, [], limbs_of(robot)
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
        messages.append(
            diagnose(
                "limb-without-foot",
                subject=("body", model.body(limb.bodies[-1]).name),
                feet=len(alike),
                alike=len(every),
            )
        )
    return tuple(messages)
