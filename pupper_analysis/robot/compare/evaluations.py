"""Backend evaluations: one quantity of a robot's model by Pinocchio, by MuJoCo and by yourdfpy."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.base.arrays import rotation_from_quaternion
from pupper_analysis.models.conversion import joint_armature, joint_damping
from pupper_analysis.models.efforts import effort_limit
from pupper_analysis.models.multibody import joint_placements
from pupper_analysis.models.xml import parse_text, to_text
from pupper_analysis.robot.compare.behaviour import offsets_in_world
from pupper_analysis.robot.compare.states import States
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.contact import foot_site
from pupper_analysis.robot.coordinates import MujocoConvention
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class QuantityValues:
    """One quantity's values in one evaluation.

    Attributes:
        values: (n, ...) of the model, or (configurations, n, ...) of states.
        labels: (n,) what each row belongs to.
        unit: The unit.
        per_row: Whether each row is judged on its own scale (masses, inertias) instead of on the
            greatest of all.
        of_state: Whether there is one set of rows per configuration.
    """

    values: Array
    labels: tuple[str, ...]
    unit: str
    per_row: bool = False
    of_state: bool = False


Evaluation = dict[str, QuantityValues]


def model_quantities(
    robot: Robot,
    *,
    masses: Sequence[float],
    coms: Sequence[Array],
    inertias: Sequence[Array],
    anchors: Sequence[Array],
    axes: Sequence[Array],
    lower: Array,
    upper: Array,
    effort: Array,
    armature: Array,
    damping: Array,
    friction: Array,
) -> Evaluation:
    """Collects what does not depend on the configuration, in the base's axes at zero angles."""
    bodies = (robot.base, *robot.joint_names)
    joints = robot.joint_names
    rows: list[tuple[str, object, tuple[str, ...], str, bool]] = [
        ("body masses", masses, bodies, "kg", True),
        ("body coms", coms, bodies, "m", False),
        ("body inertias", inertias, bodies, "kg m^2", True),
        ("joint positions", anchors, joints, "m", False),
        ("joint axes", axes, joints, "", False),
        ("lower joint limits", lower, joints, "rad", False),
        ("upper joint limits", upper, joints, "rad", False),
        ("effort limits", effort, joints, "N m", False),
        ("armature", armature, joints, "kg m^2", False),
        ("joint damping", damping, joints, "N m s/rad", False),
        ("joint friction", friction, joints, "N m", False),
    ]
    return {
        name: QuantityValues(
            np.array(values, dtype=float).reshape(len(labels), -1), labels, unit, each
        )
        for name, values, labels, unit, each in rows
    }


def state_quantities(robot: Robot, rows: Mapping[str, list[Array]]) -> Evaluation:
    """Collects what was computed at each configuration."""
    base = (
        ()
        if not robot.floating
        else ("base x", "base y", "base z", "about x", "about y", "about z")
    )
    dofs = (*base, *robot.joint_names)
    about: dict[str, tuple[tuple[str, ...], str]] = {
        "foot positions": (robot.contact_points, "m"),
        "foot Jacobians": (robot.contact_points, "m, m/rad"),
        "com": (("com",), "m"),
        "com Jacobian": (("com",), "m, m/rad"),
        "mass matrix": (dofs, "kg, kg m, kg m^2"),
        "bias forces": (dofs, "N, N m"),
        "gravity": (dofs, "N, N m"),
        "forward dynamics": (dofs, "m/s^2, rad/s^2"),
        "gyro": (("IMU",), "rad/s"),
        "accelerometer": (("IMU",), "m/s^2"),
    }
    result: Evaluation = {}
    for name, values in rows.items():
        labels, unit = about[name]
        array = np.array(values).reshape(len(values), len(labels), -1)
        result[name] = QuantityValues(array, labels, unit, of_state=True)
    return result


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


def yourdfpy_evaluation(robot: Robot, states: States) -> Evaluation:
    """Returns the feet's positions by yourdfpy's forward kinematics of the URDF."""
    import yourdfpy  # slow to import

    file = io.BytesIO(_with_unit_axes(robot.description.urdf))
    urdf = yourdfpy.URDF.load(file, build_scene_graph=True, load_meshes=False)
    order = [robot.joint_names.index(name) for name in urdf.actuated_joint_names]
    rows = []
    for qpos in states.qpos:
        urdf.update_cfg(qpos[robot.nq - robot.nu :][order])
        base = _base(robot, qpos)
        origin, rotation = base.translation, base.rotation
        rows.append(
            np.array(
                [
                    origin + rotation @ urdf.get_transform(frame, robot.base)[:3, 3]
                    for frame in robot.contact_frames.values()
                ]
            )
        )
    return state_quantities(robot, {"foot positions": rows})


def _with_unit_axes(text: str) -> bytes:
    """Returns a URDF whose axes are of length 1.

    The engines take an axis for a direction; yourdfpy moves a slide by its length times q.
    """
    root = parse_text(text)
    for axis in root.iter("axis"):
        direction = np.array([float(word) for word in str(axis.get("xyz", "1 0 0")).split()])
        unit = direction / np.linalg.norm(direction)
        axis.set("xyz", " ".join(map(repr, unit.tolist())))
    return to_text(root).encode()


def _base(robot: Robot, qpos: NDArray[np.float64]) -> pin.SE3:
    """Returns where the base's frame is in the world, which takes no kinematics."""
    model = robot.pin_model
    frame = model.frames[model.getFrameId(robot.base, pin.FrameType.BODY)]
    if not robot.floating:
        return frame.placement
    return pin.SE3(rotation_from_quaternion(qpos[3:7]), qpos[:3]) * frame.placement
