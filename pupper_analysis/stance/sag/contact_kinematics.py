"""Feet that touch at one configuration: where they are, how they push, and how both change."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.robot.configuration import Configuration

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Anchor:
    """Where a foot touched the ground first: if it is pinned, it has rolled from there.

    Attributes:
        place: (3,) of the sphere's centre (m).
        turned: (3, 3) of the foot's frame.
    """

    place: Array
    turned: Array


@dataclass(frozen=True, eq=False)
class Solution:
    """A solution of the equations.

    Attributes:
        qpos: (nq,).
        forces: {foot that touches: (3,)} in the ground's frame there, whose z is its normal (N).
        residuals: The largest element left after each Newton step (N, N m, m).
    """

    qpos: Array
    forces: dict[str, Array]
    residuals: tuple[float, ...] = ()

    def force(self, foot: str) -> Array:
        """Returns the force (3,) on a foot, zero if it does not touch (N)."""
        return self.forces.get(foot, np.zeros(3))


def integrate_step(qpos: Array, step: Array) -> Array:
    """Returns the qpos (nq,) after a step (nv,) in the directions of qvel."""
    moved = qpos.copy()
    moved[:3] += step[:3]
    moved[7:] += step[6:]
    turned = pin.Quaternion(*qpos[3:7].tolist()) * pin.Quaternion(pin.exp3(step[3:6]))
    moved[3:7] = turned.coeffs()[[3, 0, 1, 2]]
    return moved


class ContactKinematics:
    """The feet that touch, at a configuration.

    Args:
        config: The configuration.
        anchors: {foot that touches: where it did so first}.
        centres: (n, 3) where they are (m).
        frames: (n, 3, 3) rotations from the world to the frame of the ground under each, whose z is
            out of it.
        crosses: (n, 3, 3) what takes x to z x x, of these z in the world.
        depths: {foot: how deep it is in the ground (m)}, of those that do not touch as well.

    Attributes:
        config: The configuration.
        depths: As given.
        places: (n, 3) slips along the ground's two tangents, less what the sphere has rolled, and
            depths (m).
        jacobians: (n, 3, nv) of the material point at each contact, in the ground's frame.
        turning: (n, 3, nv) of each foot's rotation, in the world.
    """

    def __init__(
        self,
        config: Configuration,
        anchors: Mapping[str, Anchor],
        centres: Array,
        frames: Array,
        crosses: Array,
        depths: Mapping[str, float],
    ) -> None:
        self.config, self._frames, self._normals = config, frames, frames[:, 2]
        self.depths, self._crosses = depths, crosses
        radius, feet, held = config.robot.contact_radius, tuple(anchors), anchors.values()
        deep = np.array([depths[foot] for foot in feet])
        # MuJoCo has the contact half way into the penetration.
        self._reach = (np.array([radius[foot] for foot in feet]) - deep / 2)[:, None]
        self._offsets = self._reach[:, None] * crosses  # arms from the contact to the centre
        self._twists = config.foot_twists(feet)
        self._centre, self.turning = self._twists[:, :3], self._twists[:, 3:]
        self.jacobians = frames @ (self._centre + self._offsets @ self.turning)
        before = np.array([anchor.turned for anchor in held]).reshape(-1, 3, 3)
        self._turned = config.foot_rotations(feet) @ before.transpose(0, 2, 1)
        self._turns = np.array([pin.log3(turned) for turned in self._turned]).reshape(-1, 3)
        begun = np.array([anchor.place for anchor in held]).reshape(-1, 3)
        self._leant = crosses @ self._turns[:, :, None]  # normal x turn
        rolled = self._reach * self._leant[:, :, 0]
        self.places = (frames @ (centres - begun + rolled)[:, :, None])[:, :, 0]
        self.places[:, 2] = deep

    def place_rates(self) -> Array:
        """Returns the derivative (n, 3, nv) of ``places`` by a step in the directions of qvel."""
        deeper = self._deeper
        # What rotates a foot changes its rotation vector by the inverse of the left Jacobian.
        logs = np.array([pin.Jlog3(turned) for turned in self._turned]).reshape(-1, 3, 3)
        turns = logs.transpose(0, 2, 1) @ self.turning
        rates: Array = self._centre + self._offsets @ turns
        # The arm gets shorter by half of what the foot goes deeper.
        rates -= self._leant / 2 * deeper[:, None, :]
        rates = self._frames @ rates
        rates[:, 2] = deeper
        return rates

    @cached_property
    def _deeper(self) -> Array:
        """The derivative (n, nv) of the depths."""
        deeper: Array = -(self._normals[:, None] @ self._centre)[:, 0]
        return deeper

    def push(self, forces: Array) -> Array:
        """Returns the generalised force (nv,) of forces (n, 3), in the ground's frame."""
        pushed: Array = forces.ravel() @ self.jacobians.reshape(forces.size, -1)
        return pushed

    def balance_rates(self, forces: Array) -> Array:
        """Returns the derivative (nv, nv) of gravity less ``push`` by a step.

        Args:
            forces: (n, 3) in the ground's frame (N), which keep their direction.
        """
        pushing = (forces[:, None] @ self._frames)[:, 0]
        wrenches = np.empty((len(forces), 6))
        wrenches[:, :3] = pushing
        across = (pushing[:, None] @ self._crosses)[:, 0]  # pushing x normal
        wrenches[:, 3:] = self._reach * across
        rates = self.config.pushed_rates(self._twists, wrenches)
        # As a foot goes deeper its contact comes nearer to the centre.
        moved = (across[:, None] @ self.turning)[:, 0]
        change: Array = rates + moved.T @ (self._deeper / 2)
        return change
