"""A payload to first order: what motors, contacts, servos and ground bear, in closed form."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.robot.compliance import GroundLaw
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.payload.buckling import find_buckling_modes
from pupper_analysis.stance.stand import Stand, stand_statics
from pupper_analysis.statics.equilibrium import ForceDistribution, GravityCompensation

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Loads:
    """Torques and contact forces that last, as linear functions of a payload's mass m.

    tau = torques + m torque_rates, f_n = normals + m normal_rates: exact on level ground, steps or
    not, for as long as every f_n > 0. There the forces are vertical, and their least sum of squares
    under three equations of balance, in which m stands on the right, is linear in m.

    Attributes:
        torques: (nu,) without payload (N m).
        torque_rates: (nu,) (N m/kg).
        normals: (n,) of the feet that carry, without payload (N).
        normal_rates: (n,) (N/kg).
    """

    torques: Array
    torque_rates: Array
    normals: Array
    normal_rates: Array

    @staticmethod
    def of(
        empty: GravityCompensation, laden: GravityCompensation, mass: float, stand: Stand
    ) -> Loads:
        """Returns the line through two equilibria, without and with a mass (kg)."""
        one, two = (
            np.array(
                [held.contact_forces[foot] @ stand.normals[foot] for foot in stand.stance_feet]
            )
            for held in (empty, laden)
        )
        return Loads(
            torques=empty.joint_torques,
            torque_rates=(laden.joint_torques - empty.joint_torques) / mass,
            normals=one,
            normal_rates=(two - one) / mass,
        )

    def motor_limit(self, limits: Array) -> float:
        """Returns the greatest mass (kg) with |tau| <= limits (nu,) (N m); 0 if none has."""
        with np.errstate(divide="ignore", invalid="ignore"):
            room = (np.copysign(limits, self.torque_rates) - self.torques) / self.torque_rates
        return float(np.min(np.where(np.isfinite(room), np.maximum(room, 0.0), math.inf)))

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

    @staticmethod
    def of(robot: Robot, loaded: Robot, stand: Stand, kp: Array) -> FirstOrder | None:
        """Returns what bears; None if the stand is not stable without payload.

        Args:
            robot: The robot.
            loaded: The same with some payload where it shall be.
            stand: How it stands, without payload.
            kp: (nu,) servo stiffness at the joints (N m/rad).

        Raises:
            StaticsInfeasibleError: If no contact forces balance the stand, with or without.
        """
        empty, laden = (
            stand_statics(one, stand, distribution=ForceDistribution.MIN_TANGENTIAL)
            for one in (robot, loaded)
        )
        modes = find_buckling_modes(robot, loaded, stand, kp, empty, laden)
        if modes is None:
            return None
        mass = loaded.total_mass - robot.total_mass
        strongest = np.full(len(stand.stance_feet), math.inf)
        near = stand.ground_clearance
        if near is not None:
            laws = [GroundLaw.of(loaded, foot) for foot in stand.stance_feet]
            depths = [max(0.0, near.distance) + stand.depths[foot] for foot in stand.stance_feet]
            strongest = np.array([law.force(d) for law, d in zip(laws, depths, strict=True)])
        return FirstOrder(Loads.of(empty, laden, mass, stand), strongest, modes)

    def limit(self, limits: Array) -> float:
        """Returns the greatest mass (kg) that all bear, with efforts limits (nu,) (N m)."""
        loads = self.loads
        with np.errstate(divide="ignore", invalid="ignore"):
            sinking = (self.strongest - loads.normals) / loads.normal_rates
        sinking = np.where(loads.normal_rates > 0, np.maximum(sinking, 0.0), math.inf)
        buckling = 1 / self.modes[0] if self.modes[0] > 0 else math.inf
        return min(loads.motor_limit(limits), loads.contact_limit(), float(sinking.min()), buckling)
