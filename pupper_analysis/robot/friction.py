"""Dry friction that may hold a robot at rest: in its joints, and of feet that roll or spin."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class DryFriction:
    """The limits of a robot's dry friction, as its MJCF has them.

    A joint at rest holds any torque in [-F, F], its ``frictionloss``. A contact of ``condim`` 4 or
    6 holds any moment m about its normal (4, 6) and its two tangents (6) that is, together with its
    tangential force, in MuJoCo's elliptic cone

        |f_t|^2 / mu^2 + m_n^2 / mu_n^2 + (m_1^2 + m_2^2) / mu_r^2 <= f_n^2

    Source: MuJoCo documentation, "Computation: Friction loss" and "Computation: Contact". (A
    pyramidal cone holds no more than that in any one direction.)

    Attributes:
        joints: (nu,) F (N m).
        sliding: {foot: mu}.
        turning: {foot: (3,)} mu_r, mu_r, mu_n: about the two tangents and the normal (m).
    """

    joints: Array
    sliding: dict[str, float]
    turning: dict[str, Array]

    @staticmethod
    def of(robot: Robot) -> DryFriction:
        """Returns a robot's friction; a contact's is that of foot and ground together."""
        turning = {}
        for foot, contact in robot.contacts.items():
            spin = contact.friction[2] if contact.condim >= 4 else 0.0
            roll = contact.friction[3] if contact.condim >= 6 else 0.0
            turning[foot] = np.array([roll, roll, spin])
        joints = robot.mj_model.dof_frictionloss[robot.mj_convention.qvel_index[6:]]
        sliding = {foot: contact.sliding_friction for foot, contact in robot.contacts.items()}
        return DryFriction(np.array(joints), sliding, turning)

    def torques(self, direction: Array) -> Array:
        """Returns the joints' torques t (nu,) for which t . direction (nu,) is greatest (N m)."""
        most: Array = self.joints * np.sign(direction)
        return most

    def moment(self, foot: str, force: Array, direction: Array) -> Array:
        """Returns the moment m (3,) on a foot for which m . direction (3,) is greatest (N m).

        Args:
            foot: The foot.
            force: (3,) its contact force, two tangents and the normal (N).
            direction: (3,) about the same axes.
        """
        mu, limits = self.sliding[foot], self.turning[foot]
        taken = float(np.linalg.norm(force[:2])) / mu if mu > 0 else math.inf
        room = max(0.0, float(force[2])) ** 2 - taken**2
        # Of an ellipsoid with these half axes: scaled to a sphere, and back.
        scaled = limits * direction
        length = float(np.linalg.norm(scaled))
        if room <= 0 or length == 0:
            return np.zeros(3)
        most: Array = math.sqrt(room) * limits * scaled / length
        return most
