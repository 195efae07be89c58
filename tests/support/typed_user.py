"""Script of a user, for type checkers: mypy fails if it infers another type, or `Any`.

``make types`` checks this file; `tests.robot.test_engine_types` compares the types with the
engines, and runs the script.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import assert_type

import numpy as np
from numpy.typing import NDArray

import pupper_analysis as pa
from pupper_analysis.robot.engine_types import (
    MujocoModel,
    MujocoSpec,
    PinocchioData,
    PinocchioGeometryModel,
    PinocchioModel,
)

Vector = NDArray[np.float64]


def use_models(robot: pa.Robot) -> None:
    """Use the models of a robot as the guides do."""
    model, data = robot.pin_model, robot.pin_data()
    q, v = robot.to_pinocchio(robot.home, [0.0] * robot.nv)
    assert_type(model, PinocchioModel)
    assert_type(data, PinocchioData)
    assert_type(q, Vector)
    assert_type(v, Vector)
    assert_type(model.nq, int)
    assert_type(model.names, Sequence[str])
    assert_type(model.upperPositionLimit, Vector)
    assert_type(model.getFrameId(robot.base), int)
    assert_type(model.createData(), PinocchioData)
    assert_type(data.M, Vector)
    assert_type(robot.collision_model, PinocchioGeometryModel)
    assert_type(robot.collision_model.ngeoms, int)
    assert_type(robot.mj_model, MujocoModel)
    assert_type(robot.mj_model.nu, int)
    assert_type(robot.mj_model.body_mass, Vector)
    assert_type(robot.mj_model.jnt_limited, NDArray[np.bool_])
    assert_type(robot.mj_model.geom_bodyid, NDArray[np.int32])
    assert_type(robot.mj_spec(), MujocoSpec)
    assert_type(robot.mj_spec().compile(), MujocoModel)


def use_stand(robot: pa.Robot) -> None:
    """Use a stand and its configuration as the guides do."""
    stand = pa.solve_stand(robot)
    config = pa.Configuration(robot, stand.qpos)
    assert_type(stand, pa.Stand)
    assert_type(stand.ctrl, Vector)
    assert_type(stand.q_pin, Vector)
    assert_type(config.mass_matrix(), Vector)
    assert_type(config.frame_jacobian(robot.base, reference="local"), Vector)
    assert_type(pa.gravity_compensation(config).joint_torques, Vector)
