"""A payload to first order: what motors, contacts, servos and ground bear, in closed form.

It guides the search for the best stance alone, smoothly and in a millisecond; what a stance carries
says ``payload_limit``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy import linalg

from pupper_analysis.base.arrays import cross_matrices
from pupper_analysis.robot.compliance import GroundLaw
from pupper_analysis.robot.configuration import UP, Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.tool import Tool, with_payload
from pupper_analysis.stance.sag.equilibrium import Anchor, ContactKinematics
from pupper_analysis.stance.stand import Stand, stand_contacts
from pupper_analysis.statics.equilibrium import hold_loads

Array = NDArray[np.float64]

SMALL_PAYLOAD_RATIO = 0.1
"""A payload, in parts of the robot's mass: with one that tips it there is no line to follow."""


class SmallPayload:
    """A payload of ``SMALL_PAYLOAD_RATIO`` that tells what bears larger ones.

    Args:
        robot: The robot.
        point: Where it is.
        kp: (nu,) servo stiffness at the joints (N m/rad).

    Attributes:
        mass: kg.
    """

    def __init__(self, robot: Robot, point: Tool, kp: Array) -> None:
        self._robot, self._point, self._kp = robot, point, kp
        self.mass = SMALL_PAYLOAD_RATIO * robot.total_mass
        loaded = with_payload(robot, self.mass, point)
        self._laws = {foot: GroundLaw.of(loaded, foot) for foot in robot.contact_points}

    def rows(self, stand: Stand) -> Array | None:
        """Returns rows (k, 2): a + b m >= 0 is what a mass m must leave; first where it buckles.

        Torques and contact forces that last are linear in m: exact on level ground, steps or not,
        for as long as every f_n > 0. There the forces are vertical, and their least sum of squares
        under three equations of balance, in which m stands on the right, is linear in m. So they
        are on the line through two equilibria, without and with a mass. A foot that carries must
        not sink so deep that the lowest other part of the robot touches the ground.

        Args:
            stand: The stand.

        Returns:
            The rows, in parts of the motors' limits and of the weight; None if the stand is not
            stable without payload.

        Raises:
            StaticsInfeasibleError: If no contact forces balance the stand, with or without.
        """
        robot, mass = self._robot, self.mass
        config, carrying = Configuration(robot, stand.qpos), stand_contacts(robot, stand)
        own = config.load()
        both = np.array([own, own + mass * self._point.load_per_mass(config)])
        (forces, laden), (torques, held) = hold_loads(config, both, carrying)
        more, limits = (laden - forces) / mass, robot.effort_limits
        bears = np.isfinite(limits)
        use = np.column_stack([torques, (held - torques) / mass])[bears] / limits[bears, None]
        normals, growth = (np.einsum("ni,ni->n", one, carrying.normals) for one in (forces, more))
        laws = [self._laws[foot] for foot in stand.stance_feet]
        pressed = np.maximum(normals + mass * growth, 0.0)
        deep = np.array([law.depth(load) for law, load in zip(laws, pressed, strict=True)])
        modes = _buckling_modes(config, stand, self._kp, (forces, more), self._point, laws, deep)
        if modes is None:
            return None
        pressing = np.column_stack([normals, growth]) / robot.weight
        whole = np.array([1.0, 0.0])
        rows = [np.column_stack([np.ones(len(modes)), -modes]), whole - use, whole + use, pressing]
        if (lowest := stand.ground_clearance) is not None:
            depths = [max(0.0, lowest.distance) + stand.depths[foot] for foot in stand.stance_feet]
            strongest = [law.force(depth) for law, depth in zip(laws, depths, strict=True)]
            rows.append(np.column_stack([strongest, np.zeros(len(laws))]) / robot.weight - pressing)
        found: Array = np.concatenate(rows)
        return found


def largest_feasible_mass(rows: Array) -> float:
    """Returns the greatest mass (kg) that satisfies rows of a payload; infinite if none binds."""
    binding = rows[rows[:, 1] < 0]
    return float(np.min(-binding[:, 0] / binding[:, 1], initial=math.inf))


def _buckling_modes(
    config: Configuration,
    stand: Stand,
    kp: Array,
    lines: tuple[Array, Array],
    point: Tool,
    laws: Sequence[GroundLaw],
    deep: Array,
) -> Array | None:
    """Finds at which payloads a stand held with feed-forward for the load loses its stability.

    In the stand, gravity and the contact forces that last are linear in the payload's mass m, and
    so is the stiffness: K(m) = K_0 + m G, with K_0 that of servos, ground, and the robot's own
    weight, on all motions for which the material contact points do not slip. The stand buckles in
    a mode v where K(m) v = 0, that is, -G v = mu K_0 v with mu = 1 / m. The
    payload's weight is a force at its point that keeps its direction.

    On level ground this is exact for the configuration, but that the ground is as stiff as it is
    ``deep``; on a slope K is made symmetric.

    Args:
        config: Where the robot is: in the stand.
        stand: How it stands.
        kp: (nu,) servo stiffness at the joints (N m/rad).
        lines: (n, 3) contact forces without payload (N), and how they grow with it (N/kg).
        point: Where it is.
        laws: The ground's, of each foot that carries.
        deep: (n,) how deep these are in the ground (m).

    Returns:
        The mu of all modes, the greatest first (1/kg): none buckles below a mass of 1 / mu[0] if
        that is positive, and none at all if not. None if the stand is not stable without payload.
    """
    robot, feet = config.robot, stand.stance_feet
    turns = [pin.Quaternion.FromTwoVectors(stand.normals[foot], UP) for foot in feet]
    frames = np.array([turn.matrix() for turn in turns])
    centres = config.foot_places(feet)
    held = zip(feet, centres, config.foot_rotations(feet), strict=True)
    anchors = {foot: Anchor(place, turned) for foot, place, turned in held}
    depths = dict(zip(feet, deep.tolist(), strict=True))
    crosses = cross_matrices(frames[:, 2])
    touch = ContactKinematics(config, anchors, centres, frames, crosses, depths)
    across = touch.jacobians[:, :2].reshape(-1, robot.nv)
    along = touch.jacobians[:, 2]
    rates = np.array([law.rate(depth) for law, depth in zip(laws, depths.values(), strict=True)])
    forces, more = ((frames @ line[:, :, None])[:, :, 0] for line in lines)
    bare = touch.balance_rates(forces)
    softer = bare - touch.balance_rates(forces + more)  # by a payload of 1 kg
    twists, weight = point.twist_jacobian(config)[None], np.zeros((1, 6))
    softer += config.pushed_rates(twists, weight)
    weight[0, :3] = robot.gravity
    softer -= config.pushed_rates(twists, weight)
    stiff = bare + along.T @ (rates[:, None] * along)
    stiff[6:, 6:] += np.diag(kp)
    free = linalg.null_space(across)
    one, other = (free.T @ matrix @ free for matrix in (stiff, softer))
    try:
        modes: Array = linalg.eigh((other + other.T) / 2, (one + one.T) / 2, eigvals_only=True)
    except np.linalg.LinAlgError:
        return None
    return modes[::-1]
