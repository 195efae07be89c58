"""What parameters say of a robot and its surroundings, and how gravity pulls on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Numbers:
    """What a vector of parameters says of a robot and its surroundings.

    Attributes:
        robot: The robot, with these masses in Pinocchio's model.
        bodies: (link, number of its joint, mass (kg), com (3,) in its frame (m)) of each.
        kp: (nu,) N m/rad.
        friction: (nu,) N m.
        offset: (nu,) rad.
        softness: {foot: factor on how far it sinks}.
        moment: {foot: (3,) moment on it, in parts of the force on it (m)}.
        down: (3,) gravity in the ground's axes (m/s^2).
        tilts: (2, 3) its derivatives by the slope.
        imu: (2,) roll and pitch of the IMU in the base (rad).
        mass: Of the whole robot (kg).
        heaviness: The mass at which noise is taken (kg), as ``stiff`` is the kp.
        stiff: (nu,) kp, by which an encoder's noise becomes torque.
        rubbing: (nu,) friction, that nobody knows the place in.
    """

    robot: Robot
    bodies: tuple[tuple[str, int, float, Array], ...]
    kp: Array
    friction: Array
    offset: Array
    softness: dict[str, float]
    moment: dict[str, Array]
    down: Array
    tilts: Array
    imu: Array
    mass: float
    heaviness: float
    stiff: Array
    rubbing: Array


class GravityRegressor:
    """Generalised forces of gravity, linear in masses and first moments, whichever way it pulls.

    Args:
        robot: The robot.
    """

    def __init__(self, robot: Robot) -> None:
        self._structure = robot.structure
        self._model = robot.structure.model.copy()
        self._data, self._rest = self._model.createData(), np.zeros(self._model.nv)

    def at(
        self, config: Configuration, numbers: Numbers
    ) -> tuple[Array, list[Array], list[Array], list[Array]]:
        """Returns gravity's forces (nv,), and their derivatives.

        By each body's mass (nv,), by its com (nv, 3), and by the slope along x and y (nv,).
        """
        q, found = self._structure.convention.unit_q(config.qpos), []
        for pull in (numbers.down, *numbers.tilts):
            self._model.gravity.linear = pull
            rows = pin.computeJointTorqueRegressor(
                self._model, self._data, q, self._rest, self._rest
            )
            found.append(self._structure.columns(rows.T).T)
        columns = [10 * (number - 1) + np.arange(4) for _, number, *_ in numbers.bodies]
        moments = [np.array([m, *(m * com)]) for *_, m, com in numbers.bodies]
        forces = [
            np.sum([rows[:, at] @ own for at, own in zip(columns, moments, strict=True)], axis=0)
            for rows in found
        ]
        level = [found[0][:, at] for at in columns]
        by_mass = [
            rows[:, 0] + rows[:, 1:] @ com
            for rows, (*_, com) in zip(level, numbers.bodies, strict=True)
        ]
        by_com = [
            mass * rows[:, 1:] for rows, (*_, mass, _) in zip(level, numbers.bodies, strict=True)
        ]
        return forces[0], by_mass, by_com, forces[1:]
