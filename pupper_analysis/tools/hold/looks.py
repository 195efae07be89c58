"""What is held in one posture of thousands: for searches, without what a configuration sets up."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.robot.configuration import AtRest, Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.tool import Tool, carrying_link

Array = NDArray[np.float64]

ROUNDING = 1e-8
"""N m per N of weight: by which two ways to compute a torque may differ."""


class Looks:
    """Looks at what motors and couplings of joints hold in postures (5 us each).

    Gravity, by Pinocchio; springs of joints and gravity compensation, which are gravity on lighter
    links; and only where a MJCF has more that acts at rest, such as springs of tendons, MuJoCo.

    Args:
        robot: A robot whose base is held.
        postures: (n, nu) some, at which ``Configuration.load`` is compared.

    Attributes:
        stiffness: (nu,) of joints' springs (N m/rad, N/m).
        rest: (nu,) where these pull to (rad, m).
        springs_alone: Whether nothing but these and gravity acts.
    """

    def __init__(self, robot: Robot, postures: Iterable[Array]) -> None:
        self._robot, self._structure = robot, robot.structure
        self._model, self._lifted = robot.structure.model, _compensation(robot)
        self._data = self._model.createData()
        self._lift = None if self._lifted is None else self._lifted.createData()
        self._others: AtRest | None = None
        model = robot.mj_model
        joints = [model.joint(name).id for name in robot.joint_names]
        self.stiffness = np.array(model.jnt_stiffness[joints])
        self.rest = np.array(model.qpos_spring[model.jnt_qposadr[joints]])
        self._sprung = bool(self.stiffness.any())
        if robot.acts_at_rest:
            most = ROUNDING * robot.total_mass * float(np.linalg.norm(robot.gravity))
            off = [self.load(qpos) - Configuration(robot, qpos).load() for qpos in postures]
            if np.abs(off).max(initial=0.0) > most:
                self._others = AtRest(robot)
        self.springs_alone = self._others is None

    def with_mass(self, tool: Tool, mass: float) -> Looks:
        """Returns the same of the robot with a point mass at a tool (kg)."""
        loaded = object.__new__(Looks)
        vars(loaded).update(vars(self))
        model = self._model.copy()
        frame = model.frames[self._structure.links[tool.link]]
        weight = pin.Inertia(mass, frame.placement.act(tool.offset), np.zeros((3, 3)))
        model.inertias[frame.parentJoint] = model.inertias[frame.parentJoint] + weight
        loaded._model = model
        return loaded

    def load(self, qpos: Array) -> Array:
        """Returns what is held in a posture (nu,) at rest (N m, N): ``Configuration.load``."""
        q = self._structure.convention.unit_q(qpos)
        forces = pin.computeGeneralizedGravity(self._model, self._data, q)
        if self._others is not None:
            return self._structure.dual(forces) - self._others.forces(qpos)
        if self._lifted is not None:
            forces = forces - pin.computeGeneralizedGravity(self._lifted, self._lift, q)
        load = self._structure.dual(forces)
        return load + self.spring_load(qpos) if self._sprung else load

    def spring_load(self, qpos: Array) -> Array:
        """Returns what springs of joints leave to motors (nu,) in a posture."""
        pulled: Array = self.stiffness * (qpos - self.rest)
        return pulled


def compensated(robot: Robot) -> Iterable[tuple[str, Array, float]]:
    """Yields what gravity compensation carries: a link, a place in it (3,) (m), and mass (kg)."""
    model = robot.mj_model
    for body in np.flatnonzero(model.body_gravcomp).tolist():
        link, place = carrying_link(robot, body, model.body_ipos[body])
        yield link, place, float(model.body_gravcomp[body] * model.body_mass[body])


def _compensation(robot: Robot) -> pin.Model | None:
    """Returns the model of a robot that has the masses that gravity compensation carries."""
    carried = list(compensated(robot))
    if not carried:
        return None
    model, none = robot.structure.model.copy(), pin.Inertia(0.0, np.zeros(3), np.zeros((3, 3)))
    for joint in range(model.njoints):
        model.inertias[joint] = none
    for link, place, mass in carried:
        frame = model.frames[robot.structure.links[link]]
        weight = pin.Inertia(mass, frame.placement.act(place), np.zeros((3, 3)))
        own = model.inertias[frame.parentJoint]
        model.inertias[frame.parentJoint] = own + weight if own.mass else weight
    return model
