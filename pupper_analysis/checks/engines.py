"""The same quantities from both models in both engines, side by side.

The four opinions form a square: along two sides the engine is the same and the models differ, along
the other two the model is the same and the engines differ. So a deviation tells whose it is.

    URDF in Pinocchio --- models --- MJCF in Pinocchio
           |                                |
        engines                          engines
           |                                |
    URDF in MuJoCo ------ models --- MJCF in MuJoCo --- extras --- MJCF as it is

What a URDF cannot state (springs, tendons, fluid ...; see `extras`) is taken out of the MJCF for
the square, so that both engines are given the same model; the last side tells what it does.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.checks.passive import (
    Mimics,
    Reference,
    as_it_is,
    extras,
    split_mimics,
    urdf_mimics,
    without,
)
from pupper_analysis.errors import ConfigurationError, ModelError
from pupper_analysis.models.conversion import (
    effort_limit,
    joint_armature,
    joint_damping,
    mujoco_from_urdf,
    pinocchio_from_mujoco,
)
from pupper_analysis.models.xml import parse_text
from pupper_analysis.results import Result
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.coordinates import MujocoConvention, PinocchioConvention
from pupper_analysis.robot.feet import foot_site
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]

TOLERANCE = 1e-9
"""Deviation, relative to a quantity's scale, up to which two opinions agree."""

URDF_PINOCCHIO = "URDF in Pinocchio"
MJCF_PINOCCHIO = "MJCF in Pinocchio"
URDF_MUJOCO = "URDF in MuJoCo"
MJCF_MUJOCO = "MJCF in MuJoCo"
MJCF_AS_IT_IS = "MJCF as it is"
URDF_YOURDFPY = "URDF in yourdfpy"

EXTRAS = "extras (MJCF)"
"""The side of springs, tendons, fluid and others that a URDF has no words for."""

EDGES = {
    (URDF_PINOCCHIO, MJCF_PINOCCHIO): "models (Pinocchio)",
    (URDF_MUJOCO, MJCF_MUJOCO): "models (MuJoCo)",
    (URDF_PINOCCHIO, URDF_MUJOCO): "engines (URDF)",
    (MJCF_PINOCCHIO, MJCF_MUJOCO): "engines (MJCF)",
    (URDF_PINOCCHIO, URDF_YOURDFPY): "yourdfpy (URDF)",
    (MJCF_MUJOCO, MJCF_AS_IT_IS): EXTRAS,
}
"""What a deviation between two opinions is a deviation of."""


@dataclass(frozen=True, eq=False)
class Quantity:
    """One quantity's values in one opinion.

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


Opinion = dict[str, Quantity]

_NOTES = (
    "armature: the MJCF's, in all; URDF cannot state it",
    "gravity: the MJCF's, in all; URDF cannot state it",
    "forward dynamics: joint damping of each file, and the same torques in place of the motors' "
    "control; no dry friction, limits or contacts",
)


@dataclass(frozen=True, eq=False)
class QuantityCheck(Result):
    """How far the opinions on one quantity deviate.

    Attributes:
        name: The quantity.
        unit: Its unit.
        scale: What the deviation is relative to: the greatest absolute value.
        deviation: The worst absolute deviation.
        relative: The worst relative deviation.
        between: The two opinions that deviate most.
        whose: What it is a deviation of: the models, or the engines.
        where: The body, joint or foot where it occurs, and the configuration's number.
        edges: {whose: worst relative deviation}.
        passed: Whether ``relative`` is within the tolerance.
    """

    name: str
    unit: str
    scale: float
    deviation: float
    relative: float
    between: tuple[str, str]
    whose: str
    where: str
    edges: dict[str, float]
    passed: bool


@dataclass(frozen=True, eq=False)
class CrossCheck(Result):
    """The comparison of a robot's two models in two engines, and of yourdfpy's kinematics.

    Attributes:
        passed: Whether all quantities agree.
        tolerance: Relative.
        configurations: Number of random configurations.
        seed: Of the random numbers.
        quantities: Per quantity.
        worst: The name of the quantity with the greatest relative deviation.
        notes: Where values come from that one of the files cannot state.
    """

    passed: bool
    tolerance: float
    configurations: int
    seed: int
    quantities: tuple[QuantityCheck, ...]
    worst: str
    notes: tuple[str, ...]


def cross_check(
    robot: Robot,
    *,
    configurations: int = 20,
    tolerance: float = TOLERANCE,
    seed: int = 0,
    mimics: Mimics | None = None,
) -> CrossCheck:
    """Compares the URDF and the MJCF, in Pinocchio and in MuJoCo.

    Configurations are random: joints inside their limits, the base anywhere (if it is free), with
    velocities and joint torques.

    Args:
        robot: The robot.
        configurations: How many.
        tolerance: Relative deviation that is let pass.
        seed: For the random numbers, 0 or more.
        mimics: The joints that follow others in the URDF; those of its text by default. A joint
            equality of the MJCF that says the same does not act here.

    Returns:
        The worst deviation of each quantity, where it occurs, and the verdict.

    Raises:
        ConfigurationError: If an argument is out of its range.
    """
    if configurations < 1:
        raise ConfigurationError("configurations", f"{configurations} is less than 1")
    if not tolerance > 0:
        raise ConfigurationError("tolerance", f"{tolerance} is not positive")
    states = random_states(robot, configurations, seed)
    description = robot.description
    reference = Reference(robot.mj_model, robot.mj_model, robot.joint_names, robot.mj_base)
    found = extras(reference)
    if mimics is None:
        mimics = urdf_mimics(parse_text(description.urdf))
    coupled, _ = split_mimics(found, reference, mimics, tolerance)
    notes = list(_NOTES)
    in_mujoco: mujoco.MjModel | None = None
    try:
        in_mujoco = mujoco_from_urdf(
            description.urdf, description.urdf_source, robot.mj_model, robot.mj_base, robot.imu
        )
    except ModelError as error:
        notes.insert(0, f"left out: {URDF_MUJOCO}: {error.problem}")
    in_pinocchio = pinocchio_from_mujoco(robot.mj_model)
    # Whatever frames both files have are compared as the feet are.
    pairs = {**description.feet, **description.frames}
    urdf_frames = {name: pair[0] for name, pair in pairs.items()}
    mjcf_frames = {name: pair[1] for name, pair in pairs.items()}
    robot = replace(robot, feet=tuple(pairs), foot_frames=urdf_frames)
    mjcf_robot = replace(
        robot,
        pin_model=in_pinocchio,
        pin_convention=PinocchioConvention.of(in_pinocchio, robot.joint_names),
        base=robot.mj_base,
        foot_frames=mjcf_frames,
    )
    opinions = {
        URDF_PINOCCHIO: _pinocchio_opinion(robot, states),
        MJCF_PINOCCHIO: _pinocchio_opinion(mjcf_robot, states),
        MJCF_MUJOCO: _backend_evaluation(
            robot, without(robot.mj_model, found), robot.mj_base, mjcf_frames, states
        ),
        MJCF_AS_IT_IS: _backend_evaluation(
            robot, without(robot.mj_model, coupled), robot.mj_base, mjcf_frames, states
        ),
    }
    if in_mujoco is not None:
        in_mujoco = as_it_is(in_mujoco)
        # MuJoCo's importer makes equalities of mimic joints, which Pinocchio leaves independent.
        in_mujoco.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT.value
        opinions[URDF_MUJOCO] = _backend_evaluation(
            robot, in_mujoco, robot.base, urdf_frames, states
        )
    if pairs:
        opinions[URDF_YOURDFPY] = _yourdfpy_opinion(robot, states)
    checks = tuple(_compare(name, opinions, tolerance) for name in opinions[URDF_PINOCCHIO])
    return CrossCheck(
        passed=all(check.passed for check in checks),
        tolerance=tolerance,
        configurations=configurations,
        seed=seed,
        quantities=checks,
        worst=max(checks, key=lambda check: check.relative).name,
        notes=tuple(notes),
    )


@dataclass(frozen=True, eq=False)
class States:
    """States and motor torques.

    Attributes:
        qpos: (n, nq).
        qvel: (n, nv).
        torques: (n, nu) (N m).
    """

    qpos: Array
    qvel: Array
    torques: Array


def random_states(robot: Robot, count: int, seed: int) -> States:
    """Draws states: joints inside their limits, the base anywhere, with velocities and torques.

    Raises:
        ConfigurationError: If the seed is not a whole number from 0.
    """
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise ConfigurationError("seed", f"{seed!r} is not a whole number from 0")
    rng = np.random.default_rng(seed)
    lower = np.where(np.isfinite(robot.lower_limits), robot.lower_limits, -np.pi)
    upper = np.where(np.isfinite(robot.upper_limits), robot.upper_limits, np.pi)
    # A file may have them the wrong way round; that is for the comparison to find.
    ends = np.minimum(lower, upper), np.maximum(lower, upper)
    qpos = rng.uniform(*ends, (count, robot.nu))
    if robot.floating:
        quaternion = rng.normal(size=(count, 4))
        quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
        qpos = np.concatenate([rng.uniform(-1, 1, (count, 3)), quaternion, qpos], axis=1)
    efforts = np.where(np.isfinite(robot.effort_limits), robot.effort_limits, 1.0)
    return States(
        qpos=qpos,
        qvel=rng.normal(size=(count, robot.nv)),
        torques=rng.uniform(-efforts, efforts, (count, robot.nu)),
    )


# ------------------------------------------------------------------------------------- Pinocchio


def _pinocchio_opinion(robot: Robot, states: States) -> Opinion:
    model, convention = robot.pin_model, robot.pin_convention
    rest = Configuration(robot, robot.neutral())
    data = model.createData()
    pin.forwardKinematics(model, data, convention.q(rest.qpos))
    ids = [int(model.getJointId(name)) for name in robot.joint_names]
    base = 1 if robot.floating else 0
    bodies = [data.oMi[joint].act(model.inertias[joint]) for joint in (base, *ids)]
    v = convention.v_index
    opinion = _model_quantities(
        robot,
        masses=[body.mass for body in bodies],
        coms=[np.array(body.lever) for body in bodies],
        inertias=[np.array(body.inertia) for body in bodies],
        anchors=[rest.joint_position(name) for name in robot.joint_names],
        axes=[rest.joint_axis(name) for name in robot.joint_names],
        lower=robot.lower_limits,
        upper=robot.upper_limits,
        effort=model.effortLimit[v],
        armature=model.armature[v],
        damping=model.damping[v],
        friction=model.friction[v],
    )
    base_rows = robot.nv - robot.nu
    damping = np.concatenate([model.damping[:base_rows], model.damping[v]])
    rows: dict[str, list[Array]] = {}
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
        if robot.feet:
            values["foot positions"] = np.array(list(config.foot_positions().values()))
            values["foot Jacobians"] = np.array(list(config.foot_jacobians().values()))
        if robot.imu is not None:
            gyro, accelerometer = config.imu(qacc)
            values["gyro"] = gyro[None]
            values["accelerometer"] = accelerometer[None]
        for name, value in values.items():
            rows.setdefault(name, []).append(value)
    return opinion | _state_quantities(robot, rows)


# ------------------------------------------------------------------------------------- MuJoCo


def _backend_evaluation(
    robot: Robot,
    model: mujoco.MjModel,
    base: str,
    frames: Mapping[str, str],
    states: States,
) -> Opinion:
    data = mujoco.MjData(model)
    convention = MujocoConvention.of(model, robot.joint_names)
    convention.set_state(data, robot.neutral())
    mujoco.mj_forward(model, data)
    joints = [model.joint(name).id for name in robot.joint_names]
    carriers = [model.body(base).id, *(int(model.jnt_bodyid[joint]) for joint in joints)]
    bodies = _lumped(model, data, carriers)
    dofs = convention.qvel_index[robot.nv - robot.nu :]
    limited = model.jnt_limited[joints].astype(bool)
    opinion = _model_quantities(
        robot,
        masses=[body.mass for body in bodies],
        coms=[np.array(body.lever) for body in bodies],
        inertias=[np.array(body.inertia) for body in bodies],
        anchors=[np.array(data.xanchor[joint]) for joint in joints],
        axes=[np.array(data.xaxis[joint]) for joint in joints],
        lower=np.where(limited, model.jnt_range[joints, 0], -np.inf),
        upper=np.where(limited, model.jnt_range[joints, 1], np.inf),
        effort=np.array([effort_limit(model, joint) for joint in joints]),
        armature=joint_armature(model)[dofs],
        damping=joint_damping(model)[dofs],
        friction=model.dof_frictionloss[dofs],
    )
    sensors = _imu_sensors(model)
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
        if robot.feet:
            values["foot positions"] = np.array(positions)
            values["foot Jacobians"] = np.array(jacobians)
        if sensors is not None:
            for name, address in zip(("gyro", "accelerometer"), sensors, strict=True):
                values[name] = data.sensordata[address : address + 3][None].copy()
        for name, value in values.items():
            rows.setdefault(name, []).append(value)
    return opinion | _state_quantities(robot, rows)


def _lumped(
    model: mujoco.MjModel, data: mujoco.MjData, carriers: Sequence[int]
) -> list[pin.Inertia]:
    """Returns the inertia, in the world's axes, of each body with the static ones fixed to it."""
    total = {carrier: pin.Inertia.Zero() for carrier in carriers}
    for body in range(1, model.nbody):
        carrier = body
        while carrier not in total and carrier != 0:
            carrier = int(model.body_parentid[carrier])
        if carrier == 0:
            continue
        axes = data.ximat[body].reshape(3, 3)
        total[carrier] += pin.Inertia(
            float(model.body_mass[body]),
            np.array(data.xipos[body]),
            axes @ np.diag(model.body_inertia[body]) @ axes.T,
        )
    return [total[carrier] for carrier in carriers]


def _imu_sensors(model: mujoco.MjModel) -> tuple[int, int] | None:
    """Returns the addresses of gyro and accelerometer in sensordata."""
    addresses = []
    for kind in (mujoco.mjtSensor.mjSENS_GYRO, mujoco.mjtSensor.mjSENS_ACCELEROMETER):
        found = np.flatnonzero(model.sensor_type == kind.value)
        if not len(found):
            return None
        addresses.append(int(model.sensor_adr[found[0]]))
    return addresses[0], addresses[1]


# ------------------------------------------------------------------------------------- yourdfpy


def _yourdfpy_opinion(robot: Robot, states: States) -> Opinion:
    """Returns the feet's positions by yourdfpy's forward kinematics of the URDF."""
    import yourdfpy  # slow to import

    urdf = yourdfpy.URDF.load(
        io.BytesIO(robot.description.urdf.encode()), build_scene_graph=True, load_meshes=False
    )
    order = [robot.joint_names.index(name) for name in urdf.actuated_joint_names]
    rows = []
    for qpos in states.qpos:
        urdf.update_cfg(qpos[robot.nq - robot.nu :][order])
        config = Configuration(robot, qpos)
        origin, rotation = config.frame_position(robot.base), config.base_rotation()
        rows.append(
            np.array(
                [
                    origin + rotation @ urdf.get_transform(frame, robot.base)[:3, 3]
                    for frame in robot.foot_frames.values()
                ]
            )
        )
    return _state_quantities(robot, {"foot positions": rows})


# ------------------------------------------------------------------------------------- comparison


def _model_quantities(
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
) -> Opinion:
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
        name: Quantity(np.array(values, dtype=float).reshape(len(labels), -1), labels, unit, each)
        for name, values, labels, unit, each in rows
    }


def _state_quantities(robot: Robot, rows: Mapping[str, list[Array]]) -> Opinion:
    """Collects what was computed at each configuration."""
    base = (
        ()
        if not robot.floating
        else ("base x", "base y", "base z", "about x", "about y", "about z")
    )
    dofs = (*base, *robot.joint_names)
    about: dict[str, tuple[tuple[str, ...], str]] = {
        "foot positions": (robot.feet, "m"),
        "foot Jacobians": (robot.feet, "m, m/rad"),
        "com": (("com",), "m"),
        "com Jacobian": (("com",), "m, m/rad"),
        "mass matrix": (dofs, "kg, kg m, kg m^2"),
        "bias forces": (dofs, "N, N m"),
        "gravity": (dofs, "N, N m"),
        "forward dynamics": (dofs, "m/s^2, rad/s^2"),
        "gyro": (("IMU",), "rad/s"),
        "accelerometer": (("IMU",), "m/s^2"),
    }
    result: Opinion = {}
    for name, values in rows.items():
        labels, unit = about[name]
        array = np.array(values).reshape(len(values), len(labels), -1)
        result[name] = Quantity(array, labels, unit, of_state=True)
    return result


def _compare(name: str, opinions: Mapping[str, Opinion], tolerance: float) -> QuantityCheck:
    """Compares one quantity along every edge."""
    edges: dict[str, float] = {}
    worst: tuple[float, float, float, tuple[str, str], str] | None = None
    for pair, whose in EDGES.items():
        if any(name not in opinions.get(opinion, {}) for opinion in pair):
            continue
        one, two = (opinions[opinion][name] for opinion in pair)
        found = _deviation(one, two)
        edges[whose] = found[0]
        if worst is None or found[0] > worst[0]:
            worst = (*found[:3], pair, found[3])
    assert worst is not None
    relative, deviation, scale, between, where = worst
    return QuantityCheck(
        name=name,
        unit=opinions[URDF_PINOCCHIO][name].unit,
        scale=scale,
        deviation=deviation,
        relative=relative,
        between=between,
        whose=EDGES[between],
        where=where,
        edges=edges,
        passed=bool(relative <= tolerance),
    )


def _deviation(one: Quantity, two: Quantity) -> tuple[float, float, float, str]:
    """Returns the worst relative and absolute deviation, the scale, and the place."""
    same = one.values == two.values  # infinite limits, too
    with np.errstate(invalid="ignore"):
        difference = np.where(same, 0.0, np.abs(one.values - two.values))
    difference = np.nan_to_num(difference, nan=np.inf, posinf=np.inf)
    greatest = np.maximum(np.abs(one.values), np.abs(two.values))
    greatest = np.where(np.isfinite(greatest), greatest, 0.0)
    if one.per_row:
        scale = greatest.max(axis=-1, keepdims=True) + np.zeros_like(difference)
    else:
        scale = np.full_like(difference, greatest.max())
    with np.errstate(over="ignore", invalid="ignore"):
        relative = np.divide(
            difference, scale, out=np.where(difference > 0, np.inf, 0.0), where=scale > 0
        )
    place = np.unravel_index(int(np.argmax(relative)), relative.shape)
    where = one.labels[int(place[-2])]
    if one.of_state:
        where += f", #{place[0]}"
    return float(relative[place]), float(difference[place]), float(scale[place]), where
