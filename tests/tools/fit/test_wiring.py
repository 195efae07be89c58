"""Exchanged joints and wrong signs in a log, from the torques of the servos."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import mujoco
import numpy as np
import pytest

from pupper_analysis.base.errors import MeasurementError
from pupper_analysis.robot.servos import model_with_servos
from pupper_analysis.tools.fit.measurements.log import Log
from pupper_analysis.tools.fit.measurements.log_quality import inspect_log
from pupper_analysis.tools.fit.motions.fit import fit_motion
from pupper_analysis.tools.fit.motions.rollouts import split_runs
from pupper_analysis.tools.fit.motions.wiring import find_log_wiring
from tests.support.arm import arm


@cache
def log() -> Log:
    """Motion whose lags are the torques of MuJoCo's inverse dynamics divided by 0.9 kp.

    The upper arm is 10 % heavier than in the file.
    """
    robot, servos = arm(), model_with_servos(arm())
    time = 0.005 * np.arange(1200)
    rates, size = np.array([4.1, 5.3, 3.2, 2.4]), np.array([0.4, 0.05, 0.4, 0.4])
    phases = rates * time[:, None] + np.arange(4)
    centre = np.array([0.8, 0.1, -0.5, 0.0])
    position, velocity = centre + size * np.sin(phases), size * rates * np.cos(phases)
    acceleration = -size * rates**2 * np.sin(phases)
    model, data = servos.model, mujoco.MjData(servos.model)
    model.body("upper").mass *= 1.1
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT.value
    torque, dofs = np.zeros_like(position), robot.mj_convention.qvel_index
    for row in range(len(time)):
        robot.mj_convention.set_state(data, position[row], velocity[row])
        data.qacc[dofs] = acceleration[row]
        mujoco.mj_inverse(model, data)
        torque[row] = data.qfrc_inverse[dofs] + servos.kd * velocity[row]
    command = position + torque / (0.9 * servos.kp)
    return Log("arm.csv", time, robot.joint_names, command, position)


def exchange(first: str, second: str) -> Log:
    """Return the log with exchanged names of two joints."""
    names = {first: second, second: first}
    return replace(log(), joints=tuple(names.get(name, name) for name in log().joints))


def test_correct_log_is_not_reported() -> None:
    robot = arm()
    runs = [*split_runs(log().order_joints(robot), robot.home, 0.0)]
    assert find_log_wiring(robot, model_with_servos(robot), runs) is None


def test_exchanged_names_of_joints_are_refused() -> None:
    """Commands and positions are exchanged alike, so that they agree with each other."""
    wrong = exchange("shoulder", "elbow")
    inspect_log(arm(), wrong)
    with pytest.raises(MeasurementError, match="exchanged columns") as refused:
        fit_motion(arm(), [wrong])
    values = refused.value.cause.values
    assert {*values["joints"], *values["others"]} == {"shoulder", "elbow"}


def test_opposite_sign_of_commands_and_positions_is_refused() -> None:
    sign = np.where(np.array(log().joints) == "shoulder", -1.0, 1.0)
    wrong = replace(log(), position=sign * log().position, command=sign * log().command)
    inspect_log(arm(), wrong)
    with pytest.raises(MeasurementError, match="negate both columns") as refused:
        fit_motion(arm(), [wrong])
    assert refused.value.cause.values["joint"] == "shoulder"
