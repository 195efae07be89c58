"""MuJoCo's evaluation of a robot's model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.models.conversion import joint_armature, joint_damping
from pupper_analysis.models.efforts import effort_limit
from pupper_analysis.robot.compare.backends.quantities import (
    Evaluation,
    model_quantities,
    state_quantities,
)
from pupper_analysis.robot.compare.behaviour import offsets_in_world
from pupper_analysis.robot.compare.states import States
from pupper_analysis.robot.coordinates import MujocoConvention
from pupper_analysis.robot.feet import foot_site
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]


def mujoco_evaluation(
    robot: Robot,
    model: mujoco.MjModel,
    base: str,
    frames: Mapping[str, str],
    states: States,
    moved: Mapping[str, Array],
) -> Evaluation:
    """Evaluates a model of the robot in MuJoCo.

    Args:
        robot: The robot; its joints and feet are evaluated.
        model: Its URDF or MJCF, compiled.
        base: The body that is the base there.
        frames: {foot or frame: its name there}.
        states: Where to evaluate what depends on the configuration.
        moved: {joint: (3,) where its position is taken, from its anchor, in its body's axes}.
    """
    data = mujoco.MjData(model)
    convention = MujocoConvention.of(model, robot.joint_names)
    convention.set_state(data, robot.neutral())
    mujoco.mj_forward(model, data)
    dofs = convention.qvel_index[robot.nv - robot.nu :]
    evaluation = _at_rest(robot, model, data, base, dofs, moved)
    sensors = _imu_sensors(model, robot.imu)
    places = [foot_site(model, frame, robot.name) for frame in frames.values()]
    root = model.body(base).id
    public = convention.qvel_index
    full, jacobian = np.zeros((model.nv, model.nv)), np.zeros((3, model.nv))
    rows: dict[str, list[Array]] = {}
    for qpos, qvel, torques in zip(states.qpos, states.qvel, states.torques, strict=True):
        convention.set_state(data, qpos)
        data.qfrc_applied[dofs] = 0.0
        mujoco.mj_forward(model, data)
        gravity = data.qfrc_bias[public].copy()
        convention.set_state(data, qpos, qvel)
        data.qfrc_applied[dofs] = torques
        mujoco.mj_forward(model, data)
        positions, jacobians = [], []
        for body, local in places:
            point = data.xpos[body] + data.xmat[body].reshape(3, 3) @ local
            mujoco.mj_jac(model, data, jacobian, None, point, body)
            positions.append(point)
            jacobians.append(jacobian[:, public].copy())
        mujoco.mj_fullM(model, data, full)
        mujoco.mj_jacSubtreeCom(model, data, jacobian, root)
        values = {
            "com": data.subtree_com[root][None].copy(),
            "com Jacobian": jacobian[:, public][None].copy(),
            "mass matrix": full[np.ix_(public, public)],
            "bias forces": data.qfrc_bias[public][:, None].copy(),
            "gravity": gravity[:, None],
            "forward dynamics": data.qacc[public][:, None].copy(),
        }
        if robot.contact_points:
            values["foot positions"] = np.array(positions)
            values["foot Jacobians"] = np.array(jacobians)
        if sensors is not None:
            for name, address in zip(("gyro", "accelerometer"), sensors, strict=True):
                values[name] = data.sensordata[address : address + 3][None].copy()
        for name, value in values.items():
            rows.setdefault(name, []).append(value)
    return evaluation | state_quantities(robot, rows)


def _at_rest(
    robot: Robot,
    model: mujoco.MjModel,
    data: mujoco.MjData,
    base: str,
    dofs: NDArray[np.int64],
    moved: Mapping[str, Array],
) -> Evaluation:
    """Evaluates what does not depend on the state; the data are those of zero angles."""
    joints = [model.joint(name).id for name in robot.joint_names]
    carriers = [model.body(base).id, *(int(model.jnt_bodyid[joint]) for joint in joints)]
    bodies = _lumped(model, data, carriers)
    local = np.array([moved.get(name, np.zeros(3)) for name in robot.joint_names])
    anchors = data.xanchor[joints] + offsets_in_world(model, data, joints, local)
    limited = model.jnt_limited[joints].astype(bool)
    return model_quantities(
        robot,
        masses=[body.mass for body in bodies],
        coms=[np.array(body.lever) for body in bodies],
        inertias=[np.array(body.inertia) for body in bodies],
        anchors=list(anchors),
        axes=[np.array(data.xaxis[joint]) for joint in joints],
        lower=np.where(limited, model.jnt_range[joints, 0], -np.inf),
        upper=np.where(limited, model.jnt_range[joints, 1], np.inf),
        effort=np.array([effort_limit(model, joint) for joint in joints]),
        armature=joint_armature(model)[dofs],
        damping=joint_damping(model)[dofs],
        friction=model.dof_frictionloss[dofs],
    )


def _lumped(
    model: mujoco.MjModel, data: mujoco.MjData, carriers: Sequence[int]
) -> list[pin.Inertia]:
    """Returns the inertia, in the world's axes, of each body with the static ones fixed to it.

    All that stands in the world is a fixed base's, the first of the carriers, as in Pinocchio.
    """
    total = {carrier: pin.Inertia.Zero() for carrier in carriers}
    fixed = model.body_weldid[carriers[0]] == 0
    for body in range(1, model.nbody):
        carrier = body
        while carrier not in total and carrier != 0:
            carrier = int(model.body_parentid[carrier])
        if carrier == 0:
            if not fixed:
                continue
            carrier = carriers[0]
        axes = data.ximat[body].reshape(3, 3)
        total[carrier] += pin.Inertia(
            float(model.body_mass[body]),
            np.array(data.xipos[body]),
            axes @ np.diag(model.body_inertia[body]) @ axes.T,
        )
    return [total[carrier] for carrier in carriers]


def _imu_sensors(model: mujoco.MjModel, site: str | None) -> tuple[int, int] | None:
    """Returns the addresses of the gyro and the accelerometer at a site, in sensordata."""
    addresses = []
    for kind in (mujoco.mjtSensor.mjSENS_GYRO, mujoco.mjtSensor.mjSENS_ACCELEROMETER):
        found = [
            int(model.sensor_adr[sensor])
            for sensor in np.flatnonzero(model.sensor_type == kind.value)
            if model.site(int(model.sensor_objid[sensor])).name == site
        ]
        if not found:
            return None
        addresses.append(found[0])
    return addresses[0], addresses[1]
