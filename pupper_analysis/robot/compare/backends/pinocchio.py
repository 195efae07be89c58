"""Pinocchio's evaluation of a robot's model."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.models.multibody import joint_placements
from pupper_analysis.robot.compare.backends.quantities import (
    Evaluation,
    model_quantities,
    state_quantities,
)
from pupper_analysis.robot.compare.states import States
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]


def pinocchio_evaluation(robot: Robot, states: States, moved: Mapping[str, Array]) -> Evaluation:
    """Evaluates the robot's Pinocchio model.

    Args:
        robot: The robot.
        states: Where to evaluate what depends on the configuration.
        moved: {joint: (3,) where its position is taken, from its origin, in its body's axes}.
    """
    model, convention = robot.pin_model, robot.pin_convention
    rest = Configuration(robot, robot.neutral())
    placements = joint_placements(model, convention.q(rest.qpos))
    ids = [int(model.getJointId(name)) for name in robot.joint_names]
    base = 1 if robot.floating else 0
    bodies = [placements[joint].act(model.inertias[joint]) for joint in (base, *ids)]
    v = convention.v_index
    evaluation = model_quantities(
        robot,
        masses=[body.mass for body in bodies],
        coms=[np.array(body.lever) for body in bodies],
        inertias=[np.array(body.inertia) for body in bodies],
        anchors=[
            rest.joint_position(name) + placements[joint].rotation @ moved.get(name, np.zeros(3))
            for name, joint in zip(robot.joint_names, ids, strict=True)
        ],
        axes=[rest.joint_axis(name) for name in robot.joint_names],
        lower=robot.lower_limits,
        upper=robot.upper_limits,
        # Of 0, a habit of exporters, it is none: MuJoCo's reader of URDFs says so, and `effort_of`.
        effort=np.where(model.effortLimit[v] == 0, np.inf, model.effortLimit[v]),
        armature=model.armature[v],
        damping=model.damping[v],
        friction=model.friction[v],
    )
    base_rows = robot.nv - robot.nu
    damping = np.concatenate([model.damping[:base_rows], model.damping[v]])
    rows: dict[str, list[Array]] = {}
    del rest  # Pinocchio's data of hundreds of joints take a second to make: its serve all states
    for qpos, qvel, torques in zip(states.qpos, states.qvel, states.torques, strict=True):
        config = Configuration(robot, qpos, qvel)
        force = -damping * qvel
        force[robot.nv - robot.nu :] += torques
        qacc = config.forward_dynamics(force)
        values = {
            "com": config.center_of_mass()[None],
            "com Jacobian": config.com_jacobian()[None],
            "mass matrix": config.mass_matrix(),
            "bias forces": config.bias_forces()[:, None],
            "gravity": config.gravity()[:, None],
            "forward dynamics": qacc[:, None],
        }
        if robot.contact_points:
            values["foot positions"] = np.array(list(config.foot_positions().values()))
            values["foot Jacobians"] = np.array(list(config.foot_jacobians().values()))
        if robot.imu is not None:
            gyro, accelerometer = config.imu(qacc)
            values["gyro"] = gyro[None]
            values["accelerometer"] = accelerometer[None]
        for name, value in values.items():
            rows.setdefault(name, []).append(value)
        del config
    return evaluation | state_quantities(robot, rows)
