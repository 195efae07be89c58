"""What a segment of a path demands of motors, feet and ground: the programme of its least time."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.path.geometry import PathPlace
from pupper_analysis.stance.path.path_limits import PathLimits
from pupper_analysis.stance.path.time_optimum import Demands
from pupper_analysis.statics.contacts import make_contacts
from pupper_analysis.statics.dynamics import (
    joint_resistance,
    rolling_levers,
    share_left_to_turn,
)

Array = NDArray[np.float64]

_LEAST_TRAVEL = 1e-9
"""A joint that turns by less along the whole way does not move (rad)."""


class SegmentMotion:
    """Places of a segment, in motion along a parameter of it.

    Args:
        limits: What must not be exceeded.
        places: The places.
        rates: (K, 2) the first two derivatives of the path's share by the parameter.
    """

    def __init__(self, limits: PathLimits, places: Sequence[PathPlace], rates: Array) -> None:
        robot: Robot = limits.robot
        self.limits, self.places, self.feet = limits, places, places[-1].segment.stance_feet
        self._directions = [
            (first * place.tangent, first**2 * place.curvature + second * place.tangent)
            for place, (first, second) in zip(places, rates, strict=True)
        ]
        normal = places[0].segment.start.task.ground.normal()
        self._normals = dict.fromkeys(self.feet, normal)
        self._contacts = make_contacts(robot, self.feet, limits.friction, self._normals, None)
        self._motions, self._jacobians = [], []
        for place, (tangent, curvature) in zip(places, self._directions, strict=True):
            config = Configuration(robot, place.qpos)
            mass, rest = config.mass_matrix(), config.bias_forces()
            moving = Configuration(robot, place.qpos, tangent).bias_forces() - rest
            still = rest - config.passive()
            self._motions.append(
                np.column_stack([mass @ tangent, mass @ curvature + moving, still])
            )
            self._jacobians.append(self._contacts.jacobian(config))
        bounds = [limits.bounds(place, self.feet) for place in places]
        self._least = np.array([bound.least for bound in bounds]) / limits.weight
        self._most = np.array([bound.most for bound in bounds]) / limits.weight

    def demands(self, acceleration: Array, square: Array, forces: Array | None) -> Demands:
        """Returns what the places demand.

        Dampers, dry friction and the ground's resistance to feet that roll are those of the given
        motion: the last in proportion to the feet's loads.

        Args:
            acceleration: (K,) a at the places (1/s^2).
            square: (K,) b there.
            forces: (K, 3 n) contact forces of it, in units of the weight; None if not known.
        """
        robot, weight = self.limits.robot, self.limits.weight
        first = robot.nv - robot.nu
        # Moments are about as large as forces times the legs' length.
        unit = np.repeat([weight, weight * robot.stand_height], 3)[:, None]
        torque = self.limits.torques
        rated = np.isfinite(torque) & (torque > 0)
        tables: tuple[list[Array], ...] = ([], [], [], [])
        for index, place in enumerate(self.places):
            known = None if forces is None else forces[index].reshape(-1, 3) * weight
            motion, jacobian = self._motions[index].copy(), self._jacobians[index].copy()
            speed = math.sqrt(max(0.0, float(square[index])))
            tangent, curvature = self._directions[index]
            qacc = acceleration[index] * tangent + square[index] * curvature
            motion[:, 2] += joint_resistance(robot, speed * tangent, qacc)
            config = Configuration(robot, place.qpos, speed * tangent)
            self._resist(config, qacc, known, jacobian)
            motion, jacobian = config.by_motors(motion), config.by_motors(jacobian)
            tables[0].append(motion[:first] / unit)
            tables[1].append(jacobian[:first] * weight / unit)
            tables[2].append(motion[first:][rated] / torque[rated, None])
            tables[3].append(jacobian[first:][rated] * weight / torque[rated, None])
        base, base_forces, motors, motor_forces = map(np.array, tables)
        contacts = self._contacts
        return Demands(
            base=base,
            base_forces=base_forces,
            motors=motors,
            motor_forces=motor_forces,
            fastest=self._fastest(),
            normals=contacts.normals,
            friction=contacts.friction,
            least=self._least,
            most=self._most,
        )

    def _resist(
        self, config: Configuration, qacc: Array, forces: Array | None, jacobian: Array
    ) -> None:
        """Adds the moments with which the ground resists feet that roll to those of their loads."""
        robot = self.limits.robot
        levers = rolling_levers(config, qacc, self._normals)
        for column, foot in enumerate(self.feet):
            if foot not in levers:
                continue
            normal, lever, left = self._normals[foot], levers[foot], 1.0
            if forces is not None:
                moment = max(0.0, float(forces[column] @ normal)) * lever
                left = share_left_to_turn(robot, foot, forces[column], moment, normal)
            turning = config.frame_jacobian(robot.contact_frames[foot])[3:]
            block = slice(3 * column, 3 * column + 3)
            jacobian[:, block] += np.outer(turning.T @ (left * lever), normal)

    def _fastest(self) -> Array:
        """Returns the largest square (K,) of the parameter's speed that joints' speeds allow."""
        robot = self.limits.robot
        found = []
        for tangent, _ in self._directions:
            rates = np.abs(tangent[robot.nv - robot.nu :])
            turning = rates > _LEAST_TRAVEL
            speeds = self.limits.velocities[turning] / rates[turning]
            found.append(float(speeds.min(initial=math.inf)) ** 2)
        return np.array(found)
