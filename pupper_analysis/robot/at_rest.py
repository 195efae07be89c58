"""What acts on a robot at rest besides weight, motors and contacts: springs of the MJCF.

A URDF states none of it. Springs of joints and tendons, gravity compensation and wind push in
MuJoCo (``qfrc_passive`` at rest); what is left of the weight is held by motors and contacts.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.robot.coordinates import MujocoConvention

if TYPE_CHECKING:
    from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]

_DIFFERENCE_STEP = 1e-6
"""Step of central differences (rad, m): springs are linear, and weights' levers are sines."""


def acts_at_rest(model: mujoco.MjModel) -> bool:
    """Tells whether a model has anything that pushes at rest, and is no weight and no motor."""
    arrays = ("jnt_stiffness", "jnt_stiffnesspoly", "tendon_stiffness", "tendon_stiffnesspoly")
    return (
        any(getattr(model, name).any() for name in (*arrays, "body_gravcomp"))
        or bool(np.any(model.opt.wind) and (model.opt.density or model.opt.viscosity))
        or model.nflex > 0
        or bool((model.body_plugin >= 0).any())
    )


class AtRest:
    """The forces of a model's springs, gravity compensation and wind, in public coordinates.

    Args:
        model: The robot's, in MuJoCo.
        convention: Its maps.
    """

    def __init__(self, model: mujoco.MjModel, convention: MujocoConvention) -> None:
        self._model, self._convention = model, convention
        self._data = mujoco.MjData(model)

    @classmethod
    def of(cls, robot: Robot) -> AtRest:
        """Makes it of a robot; it is to be lent, for MuJoCo's data takes 50 times as long to make.

        Args:
            robot: The robot.
        """
        return cls(robot.mj_model, robot.mj_convention)

    def forces(self, qpos: Array) -> Array:
        """Returns the generalised forces (nv,) at a configuration (nq,), at rest (N, N m)."""
        self._convention.set_state(self._data, qpos)
        return self._now()

    def rates(self, qpos: Array) -> Array:
        """Returns their derivative (nv, nv) by steps in the directions of qvel."""
        data, index = self._data, self._convention.qvel_index
        self._convention.set_state(data, qpos)
        here = data.qpos.copy()
        columns = []
        for dof in index:
            step, ends = np.zeros(self._model.nv), []
            step[dof] = 1.0
            for way in (_DIFFERENCE_STEP, -_DIFFERENCE_STEP):
                data.qpos[:] = here
                mujoco.mj_integratePos(self._model, data.qpos, step, way)
                ends.append(self._now())
            columns.append((ends[0] - ends[1]) / (2 * _DIFFERENCE_STEP))
        return np.array(columns).T

    def _now(self) -> Array:
        mujoco.mj_fwdPosition(self._model, self._data)
        mujoco.mj_fwdVelocity(self._model, self._data)
        forces: Array = self._data.qfrc_passive[self._convention.qvel_index]
        return forces.copy()
