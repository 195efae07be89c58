"""A payload to first order: what motors, contacts, servos and ground bear, in closed form.

It guides the search for the best stance alone, smoothly and in a millisecond; what a stance carries
says ``payload_limit``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

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
from pupper_analysis.statics.equilibrium import borne_by_motors, hold_loads

Array = NDArray[np.float64]

SMALL = 0.1
"""A payload, in parts of the robot's mass: with one that tips it there is no line to follow."""


@dataclass(frozen=True, eq=False)
class Loads:
    """Torques and contact forces that last, as linear functions of a payload's mass m.

    tau = torques + m torque_rates, f = forces + m force_rates: exact on level ground, steps or
    not, for as long as every f_n > 0. There the forces are vertical, and their least sum of squares
    under three equations of balance, in which m stands on the right, is linear in m.

    Attributes:
        torques: (nu,) without payload (N m).
        torque_rates: (nu,) (N m/kg).
        forces: (n, 3) on the feet that carry, in the world, without payload (N).
        force_rates: (n, 3) (N/kg).
        normals: (n,) of the forces (N).
        normal_rates: (n,) (N/kg).
    """

    torques: Array
    torque_rates: Array
    forces: Array
    force_rates: Array
    normals: Array
    normal_rates: Array

    @staticmethod
    def of(config: Configuration, stand: Stand, point: Tool, mass: float) -> Loads:
        """Returns the line through two equilibria, without and with a mass.

        Args:
            config: Where the robot, a tree, is: in the stand.
            stand: The stand.
            point: Where the payload is.
            mass: kg.

        Raises:
            StaticsInfeasibleError: If no contact forces balance one of them.
        """
        own, carrying = config.load(), stand_contacts(config.robot, stand)
        both = np.array([own, own + mass * point.load_per_mass(config)])
        (forces, laden), (torques, held) = hold_loads(config, both, carrying)
        rates = (laden - forces) / mass
        outwards = [np.einsum("ni,ni->n", one, carrying.normals) for one in (forces, rates)]
        return Loads(torques, (held - torques) / mass, forces, rates, *outwards)

    def motor_limit(self, limits: Array) -> float:
        """Returns the greatest mass (kg) that motors with limits (nu,) (N m) hold."""
        return borne_by_motors(self.torques, self.torque_rates, limits)

    def contact_limit(self) -> float:
        """Returns the mass (kg) at which the first foot lets go; infinite if none does."""
        with np.errstate(divide="ignore", invalid="ignore"):
            room = np.where(self.normal_rates < 0, -self.normals / self.normal_rates, math.inf)
        return float(np.min(room))


@dataclass(frozen=True, eq=False)
class FirstOrder:
    """What bears a payload in a stand, to first order in its mass m.

    Attributes:
        loads: Torques and loads of the feet.
        strongest: (n,) the load under which each foot that carries sinks so deep that the lowest
            other part of the robot touches the ground (N); infinite if no part can.
        modes: (k,) reciprocals of the masses at which the servos buckle (1/kg).
    """

    loads: Loads
    strongest: Array
    modes: Array

    def limit(self, limits: Array) -> float:
        """Returns the greatest mass (kg) that all bear, with efforts limits (nu,) (N m)."""
        loads = self.loads
        with np.errstate(divide="ignore", invalid="ignore"):
            sinking = (self.strongest - loads.normals) / loads.normal_rates
        sinking = np.where(loads.normal_rates > 0, np.maximum(sinking, 0.0), math.inf)
        buckling = 1 / self.modes[0] if self.modes[0] > 0 else math.inf
        return min(loads.motor_limit(limits), loads.contact_limit(), float(sinking.min()), buckling)


class SmallPayload:
    """A payload of ``SMALL`` that tells what bears larger ones.

    Args:
        robot: The robot.
        point: Where it is.
        kp: (nu,) servo stiffness at the joints (N m/rad).

    Attributes:
        mass: kg.
    """

    def __init__(self, robot: Robot, point: Tool, kp: Array) -> None:
        self._robot, self._point, self._kp = robot, point, kp
        self.mass = SMALL * robot.total_mass
        loaded = with_payload(robot, self.mass, point)
        self._laws = {foot: GroundLaw.of(loaded, foot) for foot in robot.contact_points}
        share = robot.weight / len(self._laws)
        self._usual = {foot: law.depth(share) for foot, law in self._laws.items()}

    def borne(self, stand: Stand) -> FirstOrder | None:
        """Returns what bears larger ones in a stand; None if that is not stable without payload.

        Raises:
            StaticsInfeasibleError: If no contact forces balance the stand, with or without.
        """
        config = Configuration(self._robot, stand.qpos)
        laws = [self._laws[foot] for foot in stand.stance_feet]
        loads = Loads.of(config, stand, self._point, self.mass)
        pressed = np.maximum(loads.normals + self.mass * loads.normal_rates, 0.0)
        near = [self._usual[foot] for foot in stand.stance_feet]
        deep = np.array([law.depth(*at) for law, *at in zip(laws, pressed, near, strict=True)])
        modes = _buckling_modes(
            config, stand, self._kp, (loads.forces, loads.force_rates), self._point, laws, deep
        )
        if modes is None:
            return None
        strongest, lowest = np.full(len(laws), math.inf), stand.ground_clearance
        if lowest is not None:
            depths = [max(0.0, lowest.distance) + stand.depths[foot] for foot in stand.stance_feet]
            strongest = np.array([law.force(d) for law, d in zip(laws, depths, strict=True)])
        return FirstOrder(loads, strongest, modes)


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
