"""Comparison of a URDF with an MJCF, and evaluation of both in Pinocchio and MuJoCo.

The four evaluations form a square. Along two edges the engine is the same and the models differ;
along the other two the model is the same and the engines differ. So a deviation is attributed to
the models or to an engine.

    URDF in Pinocchio --- models --- MJCF in Pinocchio
           |                                |
        engines                          engines
           |                                |
    URDF in MuJoCo ------ models --- MJCF in MuJoCo --- extras --- MJCF as it is

Terms that a URDF cannot express (springs, tendons, fluid ...; see `mjcf_only`) are removed from the
MJCF for the square, so that both engines use the same model. The last edge shows the effect of
the removed terms. yourdfpy evaluates the foot positions of the URDF as well, unless the robot is
large or both files have no common frames. Large robots are evaluated in MuJoCo only.
"""

from __future__ import annotations

import copy
import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.arrays import rotation_from_quaternion
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, Term, diagnose
from pupper_analysis.base.errors import ConfigurationError, ModelError
from pupper_analysis.base.results import Result, shorten_memory_paths
from pupper_analysis.base.units import (
    EARTH_GRAVITY,
    JointUnits,
)
from pupper_analysis.models.attributes import known_limits
from pupper_analysis.models.conversion import (
    UrdfImport,
    acting_gravity,
    joint_armature,
    joint_damping,
    pinocchio_from_mujoco,
)
from pupper_analysis.models.efforts import find_effort
from pupper_analysis.models.mjcf import (
    compile_spec,
    has_free_joint,
    list_free_joints,
    silence_mujoco,
)
from pupper_analysis.models.multibody import joint_placements
from pupper_analysis.models.objects import ModelObject
from pupper_analysis.models.published import make_xacro_request
from pupper_analysis.models.spec_tree import SpecTree
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.models.xml import parse_text, to_text
from pupper_analysis.pupper.named_robots import find_model_pair
from pupper_analysis.pupper.variants import VariantSpec
from pupper_analysis.robot.compare.behaviour import (
    States,
    count_affordable_states,
    is_large,
    random_states,
)
from pupper_analysis.robot.compare.compare import FilesCompared, compare_files
from pupper_analysis.robot.compare.differences import INERTIAL_KINDS, Difference, Explanation
from pupper_analysis.robot.compare.mjcf_only import (
    make_passive_model,
    mjcf_only_effects,
    split_mimics,
    without_effects,
)
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.contact import foot_site
from pupper_analysis.robot.coordinates import MujocoConvention, PinocchioConvention
from pupper_analysis.robot.joints import get_common_units
from pupper_analysis.robot.matching.sources import Sources
from pupper_analysis.robot.matching.tolerances import Tolerances
from pupper_analysis.robot.matching.trees import Mimics, Reference, urdf_mimics
from pupper_analysis.robot.robot import Robot

ENGINE_RTOL = 1e-8
"""Largest accepted deviation of Pinocchio from MuJoCo (or yourdfpy) on the same model, relative to
the scale of the quantity. A larger deviation counts as a deviation of the engines. Chosen, not
tuned.
"""


@dataclass(frozen=True, eq=False)
class Comparison(FilesCompared):
    """Comparison of a URDF with an MJCF, with the cross-check in both engines.

    Attributes:
        check: Cross-check of both models in both engines.
        engines: Quantities for which the engines deviate on the same model.
    """

    check: CrossCheck
    engines: tuple[Diagnostic, ...]


@check_arguments
@silence_mujoco()
def compare_models(
    urdf: str | Path | ModelObject | VariantSpec,
    mjcf: str | Path | ModelObject | VariantSpec | None = None,
    *,
    names: Mapping[str, str] | None = None,
    packages: Mapping[str, Path] | None = None,
    feet: Sequence[str] = (),
    tolerances: Tolerances | None = None,
    strict_names: bool = False,
    configurations: int = 20,
    seed: int = 0,
    xacro: bool = False,
    xacro_args: Mapping[str, str] | None = None,
) -> Comparison:
    """Compare a URDF with an MJCF of the same robot, and explain the differences.

    Files of registered formats, such as USD, are accepted in place of either file.

    Args:
        urdf: Path of the URDF or the replacement; name of a published robot; a variant, whose URDF
            is used; or a robot in memory that is a URDF: text, ``yourdfpy.URDF`` or ``pin.Model``.
            Differences of scaled variants and of robots in memory have no lines.
        mjcf: Path of the MJCF or the replacement; name of a published robot; a variant, whose MJCF
            is used; or a robot in memory that is an MJCF: text, ``mujoco.MjSpec`` or
            ``mujoco.MjModel``. By default the MJCF of the variant ``urdf``.
        names: {name in the URDF: name in the MJCF} of joints and frames whose names differ.
        packages: {ROS package: folder}, for ``package://`` paths.
        feet: Frames that count as feet, named as in the MJCF; by default all frames in both files.
        tolerances: Largest accepted differences; the default is for files with 5 to 6 digits.
        strict_names: If True, these count as disagreement: different joint names that ``names``
            does not contain, damping and friction that the URDF does not state, and a fixed base
            that is tilted against the URDF. Otherwise the assumptions are reported in ``guessed``,
            ``notes`` and ``mount``.
        configurations: Number of random configurations of the cross-check, at least 1. Large robots
            may be evaluated at fewer configurations.
        seed: Seed of the random numbers, at least 0.
        xacro: True to expand a xacro file, which evaluates the Python expressions in the file.
        xacro_args: {argument of the xacro file: value}, with ``xacro=True``.

    Returns:
        Differences with causes, lines and effects; deviations of models and engines; verdict.

    Raises:
        ModelError: If a file cannot be read, the files cannot be matched, the robot has no mass, or
            MuJoCo refuses the URDF of a large robot, for example.
        MissingPackageError: If the package that reads the format of a file is not installed.
        UnknownNameError: If a name does not occur in the file.
        ConfigurationError: If an argument is out of range, or if there is no ``mjcf`` and ``urdf``
            is no variant.
        VariantError: If a model is probably a misspelled variant name.
    """
    validate_state_request(configurations, seed)
    urdf, mjcf = find_model_pair(urdf, mjcf)
    tolerances = tolerances or Tolerances()
    compared = compare_files(
        urdf,
        mjcf,
        names=names,
        packages=packages,
        feet=feet,
        tolerances=tolerances,
        strict_names=strict_names,
        xacro=make_xacro_request([urdf], packages, xacro=xacro, arguments=xacro_args),
    )
    check = cross_check(
        compared.matched.robot,
        configurations=configurations,
        tolerance=tolerances.dynamics,
        seed=seed,
    )
    values = {
        field_info.name: getattr(compared.result, field_info.name)
        for field_info in fields(compared.result)
    }
    values["differences"] = tuple(
        replace(difference, made_of=list_mass_shares(difference, *compared.sources))
        for difference in values["differences"]
    )
    comparison = Comparison(
        **values, check=check, engines=_list_engine_deviations(check, compared.explanation)
    )
    return shorten_memory_paths(comparison, Path(comparison.urdf), Path(comparison.mjcf))


def list_mass_shares(
    difference: Difference, urdf: Sources, mjcf: Sources
) -> tuple[Diagnostic, ...]:
    """List the masses of the links that form a body with different inertials, a message per file.

    Empty for other kinds of differences, or if neither file has several links with mass.
    """
    if difference.kind not in INERTIAL_KINDS:
        return ()
    heavy = {
        file: sorted(
            ((name, mass) for name, mass in sources.list_masses(difference.element) if mass),
            key=lambda member: -member[1],
        )
        for file, sources in (("URDF", urdf), ("MJCF", mjcf))
    }
    if all(len(members) <= 1 for members in heavy.values()):
        return ()
    return tuple(
        diagnose(
            "body-is-made-of",
            file=file,
            mass=Quantity(sum(mass for _, mass in members), "kg"),
            members=[
                diagnose("mass-of-a-member", subject=("body", name), mass=Quantity(mass, "kg"))
                for name, mass in members
            ]
            if len(members) > 1
            else None,
        )
        for file, members in heavy.items()
    )


def _list_engine_deviations(check: CrossCheck, explanation: Explanation) -> tuple[Diagnostic, ...]:
    """List deviations above `ENGINE_RTOL` between two engines that evaluate the same model.

    Deviations of the MJCF are omitted if the list of differences is incomplete.
    """
    return tuple(
        diagnose(
            "engines-deviate",
            subject=("quantity", quantity.name),
            relative=relative,
            edge=Term(whose),
        )
        for quantity in check.quantities
        for whose, relative in quantity.edge_deviations.items()
        if whose in ENGINE_EDGES
        and relative > ENGINE_RTOL
        # If differences are missing in the list, the engines did not get the same model.
        and (explanation.complete or whose not in MJCF_ENGINE_EDGES)
    )


Evaluation = dict[str, Array]
"""{quantity: values} of a model in an engine, as arrays.

The shape is (rows, k) for parameters of the model, and (configurations, rows, k) for quantities
that depend on the state.
"""

BODIES, JOINTS, DOFS, FEET = "bodies", "joints", "dofs", "feet"
"""Kinds of objects that the rows of a quantity describe, in `COMPARED_QUANTITIES`."""

COMPARED_QUANTITIES = {
    "body masses": (BODIES, "kg"),
    "body coms": (BODIES, "m"),
    "body inertias": (BODIES, "kg m^2"),
    "joint axes": (JOINTS, ""),
    "lower joint limits": (JOINTS, "position"),
    "upper joint limits": (JOINTS, "position"),
    "effort limits": (JOINTS, "effort"),
    "armature": (JOINTS, "armature"),
    "joint damping": (JOINTS, "damping"),
    "joint friction": (JOINTS, "effort"),
    "com": ("com", "m"),
    "com Jacobian": ("com", "m, m/rad"),
    "mass matrix": (DOFS, "kg, kg m, kg m^2"),
    "bias forces": (DOFS, "N, N m"),
    "gravity": (DOFS, "N, N m"),
    "forward dynamics": (DOFS, "m/s^2, rad/s^2"),
    "foot positions": (FEET, "m"),
    "foot Jacobians": (FEET, "m, m/rad"),
    "gyro": ("IMU", "rad/s"),
    "accelerometer": ("IMU", "m/s^2"),
}
"""{compared quantity: (kind of object that each row describes, unit)}. The unit of a quantity of
joints is a field name of `JointUnits`; axes have no unit. Masses, CoMs, inertias and axes are
expressed in the world frame at zero angles, with a floating base at the origin.
"""

ROW_SCALED_QUANTITIES = ("body masses", "body inertias")
"""Quantities with a row per body, whose deviation is divided by the largest magnitude in the row of
the body instead of the largest magnitude in all rows."""


def list_row_labels(robot: Robot, quantity: str) -> tuple[str, ...]:
    """Return the labels of the rows of a compared quantity, in an evaluation by any engine.

    The label of a body is the joint that moves the body, or the name of the base.
    """
    base = tuple(f"base {axis}" for axis in "xyz") + tuple(f"about {axis}" for axis in "xyz")
    rows = {
        BODIES: (robot.base, *robot.joint_names),
        JOINTS: robot.joint_names,
        DOFS: (*(base if robot.floating else ()), *robot.joint_names),
        FEET: robot.contact_points,
    }
    owner = COMPARED_QUANTITIES[quantity][0]
    return rows.get(owner, (owner,))


def collect_evaluation(
    robot: Robot, at_rest: Mapping[str, ArrayLike], of_states: Sequence[Mapping[str, ArrayLike]]
) -> Evaluation:
    """Convert the values of an evaluation to arrays with a row per label (`list_row_labels`).

    Args:
        robot: Robot.
        at_rest: {quantity: values} that do not depend on the state.
        of_states: {quantity: values} at each state; not empty.

    Returns:
        {quantity: values}, shape (rows, k) for values at rest, (states, rows, k) for values of
        states.
    """
    evaluation: Evaluation = {
        name: np.array(values, dtype=float).reshape(len(list_row_labels(robot, name)), -1)
        for name, values in at_rest.items()
    }
    for name in of_states[0]:
        rows = np.array([values[name] for values in of_states])
        evaluation[name] = rows.reshape(len(rows), len(list_row_labels(robot, name)), -1)
    return evaluation


def evaluate_in_pinocchio(robot: Robot, states: States) -> Evaluation:
    """Evaluate a robot's Pinocchio model at states in MuJoCo's coordinates, for the cross-check.

    Returns:
        {quantity: values}, in the units of `COMPARED_QUANTITIES`.
    """
    model, convention = robot.pin_model, robot.pin_convention
    rest = Configuration(robot, robot.neutral())
    placements = joint_placements(model, convention.q(rest.qpos))
    ids = [int(model.getJointId(name)) for name in robot.joint_names]
    base = 1 if robot.floating else 0
    bodies = [placements[joint].act(model.inertias[joint]) for joint in (base, *ids)]
    v = convention.v_index
    at_rest = {
        **_collect_body_values(bodies),
        "joint axes": [rest.joint_axis(name) for name in robot.joint_names],
        "lower joint limits": robot.lower_limits,
        "upper joint limits": robot.upper_limits,
        # An effort of 0 means no limit in a URDF, as in MuJoCo's importer.
        "effort limits": np.where(
            model.effortLimit[v] == 0, np.inf, known_limits(model.effortLimit[v])
        ),
        "armature": model.armature[v],
        "joint damping": model.damping[v],
        "joint friction": model.friction[v],
    }
    base_rows = robot.nv - robot.nu
    damping = np.concatenate([model.damping[:base_rows], model.damping[v]])
    of_states = []
    del rest  # release Pinocchio's data for reuse: creating data takes 1 s for hundreds of joints
    for qpos, qvel, torques in zip(states.qpos, states.qvel, states.torques, strict=True):
        config = Configuration(robot, qpos, qvel)
        force = -damping * qvel
        force[robot.nv - robot.nu :] += torques
        qacc = config.forward_dynamics(force)
        values = {
            "com": config.center_of_mass(),
            "com Jacobian": config.com_jacobian(),
            "mass matrix": config.mass_matrix(),
            "bias forces": config.bias_forces(),
            "gravity": config.gravity(),
            "forward dynamics": qacc,
        }
        if robot.contact_points:
            values["foot positions"] = np.array(list(config.foot_positions().values()))
            values["foot Jacobians"] = np.array(list(config.foot_jacobians().values()))
        if robot.imu is not None:
            values["gyro"], values["accelerometer"] = config.imu(qacc)
        of_states.append(values)
        del config
    return collect_evaluation(robot, at_rest, of_states)


def _collect_body_values(bodies: Sequence[pin.Inertia]) -> dict[str, ArrayLike]:
    """Collect masses [kg], CoMs, (n, 3) [m], and inertias, (n, 3, 3) [kg m^2]: {name: values}.

    The CoM of a body without mass is undefined; 0 takes its place.
    """
    return {
        "body masses": [body.mass for body in bodies],
        "body coms": [np.array(body.lever) if body.mass else np.zeros(3) for body in bodies],
        "body inertias": [np.array(body.inertia) for body in bodies],
    }


def evaluate_in_mujoco(
    robot: Robot,
    model: mujoco.MjModel,
    base: str,
    frames: Mapping[str, str],
    states: States,
) -> Evaluation:
    """Evaluate the compared quantities of a MuJoCo model of a robot, for the cross-check.

    Args:
        robot: Robot that defines joints and feet.
        model: Compiled URDF or MJCF.
        base: Name of the base body in ``model``.
        frames: {foot or frame: name in ``model``}.
        states: Configurations, velocities and joint torques, in MuJoCo's coordinates.

    Returns:
        {quantity: values}, in the units of `COMPARED_QUANTITIES`.
    """
    data = mujoco.MjData(model)
    convention = MujocoConvention.from_model(model, robot.joint_names)
    convention.set_state(data, robot.neutral())
    mujoco.mj_forward(model, data)
    dofs = convention.qvel_index[robot.nv - robot.nu :]
    at_rest = _evaluate_at_rest(robot, model, data, base, dofs)
    sensors = _find_imu_sensors(model, robot.imu)
    places = [foot_site(model, frame, robot.name) for frame in frames.values()]
    root = model.body(base).id
    public = convention.qvel_index
    full, jacobian = np.zeros((model.nv, model.nv)), np.zeros((3, model.nv))
    of_states = []
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
            "com": data.subtree_com[root].copy(),
            "com Jacobian": jacobian[:, public],
            "mass matrix": full[np.ix_(public, public)],
            "bias forces": data.qfrc_bias[public],
            "gravity": gravity,
            "forward dynamics": data.qacc[public],
        }
        if robot.contact_points:
            values["foot positions"] = np.array(positions)
            values["foot Jacobians"] = np.array(jacobians)
        if sensors is not None:
            for name, address in zip(("gyro", "accelerometer"), sensors, strict=True):
                values[name] = data.sensordata[address : address + 3].copy()
        of_states.append(values)
    return collect_evaluation(robot, at_rest, of_states)


def _evaluate_at_rest(
    robot: Robot,
    model: mujoco.MjModel,
    data: mujoco.MjData,
    base: str,
    dofs: NDArray[np.int64],
) -> dict[str, ArrayLike]:
    """Return body and joint parameters of a MuJoCo model, {quantity: a row per body or joint}.

    ``data`` contains the kinematics at zero angles, ``dofs`` the joints' indices in ``qvel``.
    """
    joints = [model.joint(name).id for name in robot.joint_names]
    moving_bodies = [model.body(base).id, *(int(model.jnt_bodyid[joint]) for joint in joints)]
    bodies = _lump_fixed_bodies(model, data, moving_bodies)
    limited = model.jnt_limited[joints].astype(bool)
    return {
        **_collect_body_values(bodies),
        "joint axes": data.xaxis[joints],
        "lower joint limits": np.where(limited, model.jnt_range[joints, 0], -np.inf),
        "upper joint limits": np.where(limited, model.jnt_range[joints, 1], np.inf),
        "effort limits": [find_effort(model, joint) for joint in joints],
        "armature": joint_armature(model)[dofs],
        "joint damping": joint_damping(model)[dofs],
        "joint friction": model.dof_frictionloss[dofs],
    }


def _lump_fixed_bodies(
    model: mujoco.MjModel, data: mujoco.MjData, moving_bodies: Sequence[int]
) -> list[pin.Inertia]:
    """Return the world-frame inertias of bodies (ids), including the bodies fixed to them.

    If the base is fixed to the world, the base includes all bodies fixed to the world, as in
    Pinocchio.
    """
    total = {moving_body: pin.Inertia.Zero() for moving_body in moving_bodies}
    fixed = model.body_weldid[moving_bodies[0]] == 0
    for body in range(1, model.nbody):
        moving_body = body
        while moving_body not in total and moving_body != 0:
            moving_body = int(model.body_parentid[moving_body])
        if moving_body == 0:
            if not fixed:
                continue
            moving_body = moving_bodies[0]
        axes = data.ximat[body].reshape(3, 3)
        total[moving_body] += pin.Inertia(
            float(model.body_mass[body]),
            np.array(data.xipos[body]),
            axes @ np.diag(model.body_inertia[body]) @ axes.T,
        )
    return [total[moving_body] for moving_body in moving_bodies]


def _find_imu_sensors(model: mujoco.MjModel, site: str | None) -> tuple[int, int] | None:
    """Return the addresses of gyro and accelerometer in ``sensordata``, None if one is missing."""
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


def evaluate_in_yourdfpy(robot: Robot, states: States) -> Evaluation:
    """Compute the foot positions by yourdfpy's forward kinematics of the URDF.

    Returns:
        {"foot positions": positions of the robot's contact points in the world, shape (states,
        feet, 3) [m]}.
    """
    import yourdfpy  # slow to import

    file = io.BytesIO(_normalise_axes(robot.description.urdf))
    urdf = yourdfpy.URDF.load(file, build_scene_graph=True, load_meshes=False)
    order = [robot.joint_names.index(name) for name in urdf.actuated_joint_names]
    rows = []
    for qpos in states.qpos:
        urdf.update_cfg(qpos[robot.nq - robot.nu :][order])
        base = _compute_base_pose(robot, qpos)
        origin, rotation = base.translation, base.rotation
        frames = robot.contact_frames.values()
        places = [urdf.get_transform(frame, robot.base)[:3, 3] for frame in frames]
        rows.append({"foot positions": [origin + rotation @ place for place in places]})
    return collect_evaluation(robot, {}, rows)


def _normalise_axes(text: str) -> bytes:
    """Return a URDF for yourdfpy, with unit joint axes and without shapes.

    The engines use the direction of an axis only; yourdfpy moves a slide by q times the length of
    the axis, and does not read capsules.
    """
    tree = UrdfTree.of(text)
    tree.remove_shapes()
    for axis in tree.root.iter("axis"):
        direction = np.array([float(word) for word in str(axis.get("xyz", "1 0 0")).split()])
        unit = direction / np.linalg.norm(direction)
        axis.set("xyz", " ".join(map(repr, unit.tolist())))
    return to_text(tree.root).encode()


def _compute_base_pose(robot: Robot, qpos: NDArray[np.float64]) -> pin.SE3:
    """Return the pose of the base frame in the world, from ``qpos`` without forward kinematics."""
    model = robot.pin_model
    frame = model.frames[model.getFrameId(robot.base, pin.FrameType.BODY)]
    if not robot.floating:
        return frame.placement
    return pin.SE3(rotation_from_quaternion(qpos[3:7]), qpos[:3]) * frame.placement


DEFAULT_RTOL = 1e-9
"""Default of the largest deviation between two evaluations that counts as agreement, relative to
the scale of the quantity. Chosen, not tuned.
"""

URDF_PINOCCHIO = "URDF in Pinocchio"
"""Name of the evaluation of the URDF with Pinocchio."""

MJCF_PINOCCHIO = "MJCF in Pinocchio"
"""Name of the evaluation of the MJCF's tree with Pinocchio."""

URDF_MUJOCO = "URDF in MuJoCo"
"""Name of the evaluation of the URDF with MuJoCo."""

MJCF_MUJOCO = "MJCF in MuJoCo"
"""Name of the evaluation of the MJCF with MuJoCo, without the terms that a URDF cannot express."""

MJCF_AS_IT_IS = "MJCF as it is"
"""Name of the evaluation of the passive MJCF (`make_passive_model`) with MuJoCo. It includes terms
that a URDF cannot express, for example springs.
"""

URDF_YOURDFPY = "URDF in yourdfpy"
"""Name of the evaluation of the URDF with yourdfpy (forward kinematics only)."""

EXTRAS_EDGE = "extras (MJCF)"
"""Name of an edge (pair of evaluations that are compared): the MJCF in MuJoCo without and with
springs, tendons, fluid and other terms that a URDF cannot express."""

EDGE_NAMES = {
    (URDF_PINOCCHIO, MJCF_PINOCCHIO): "models (Pinocchio)",
    (URDF_MUJOCO, MJCF_MUJOCO): "models (MuJoCo)",
    (URDF_PINOCCHIO, URDF_MUJOCO): "engines (URDF)",
    (MJCF_PINOCCHIO, MJCF_MUJOCO): "engines (MJCF)",
    (URDF_PINOCCHIO, URDF_YOURDFPY): "yourdfpy (URDF)",
    (MJCF_MUJOCO, MJCF_AS_IT_IS): EXTRAS_EDGE,
}
"""{pair of evaluations that are compared (edge): name of this pair}."""

ENGINE_EDGES = ("engines (URDF)", "engines (MJCF)", "yourdfpy (URDF)")
"""Names of the pairs of evaluations (edges) of the same model in two engines."""

MJCF_ENGINE_EDGES = ("engines (MJCF)",)
"""Names in `ENGINE_EDGES` of pairs in which both engines evaluate the MJCF."""


@dataclass(frozen=True, eq=False)
class QuantityCheck(Result):
    """Largest deviation of a quantity between two models or between two engines.

    Attributes:
        name: Quantity.
        unit: Unit of the quantity.
        scale: Denominator of ``relative``: the largest absolute value of the quantity, or the lower
            bound of the scale if this is larger. For body masses and inertias, the largest absolute
            value in the row.
        deviation: Absolute deviation at the place of the worst relative deviation.
        relative: Largest relative deviation.
        evaluations: Pair of evaluations (model and engine) with the largest relative deviation.
        edge: Name of the pair of evaluations with the largest relative deviation, for example
            ``models (MuJoCo)``.
        location: Row with the largest relative deviation (for example a body, joint or foot), and
            number of the configuration if the quantity depends on the configuration.
        edge_deviations: {name of a pair of evaluations: largest relative deviation}.
        passed: Whether ``relative`` is within the tolerance.
    """

    name: str
    unit: str
    scale: float = field(metadata={"unit": "varies"})
    deviation: float = field(metadata={"unit": "varies"})
    relative: float = field(metadata={"unit": "1"})
    evaluations: tuple[str, str]
    edge: str
    location: str
    edge_deviations: dict[str, float] = field(metadata={"unit": "1"})
    passed: bool


@dataclass(frozen=True, eq=False)
class CrossCheck(Result):
    """Comparison of both models of a robot in both engines, and of yourdfpy's kinematics.

    Attributes:
        passed: Whether all quantities agree.
        tolerance: Largest accepted relative deviation.
        configurations: Number of random configurations.
        seed: Seed of the random numbers.
        quantities: Result for each quantity.
        worst: Quantity with the largest relative deviation.
        notes: Sources of values that a file cannot state, and evaluations that were left
            out.
    """

    passed: bool
    tolerance: float = field(metadata={"unit": "1"})
    configurations: int
    seed: int
    quantities: tuple[QuantityCheck, ...]
    worst: str
    notes: tuple[Diagnostic, ...]


MAX_CONFIGURATIONS = 100_000
"""Largest number of configurations, which bounds the memory. Chosen, not tuned."""


def validate_state_request(count: int, seed: int) -> None:
    """Validate number and seed of random states.

    Raises:
        ConfigurationError: If ``count`` is below 1 or above `MAX_CONFIGURATIONS`, or the seed is
            not an integer of at least 0.
    """
    if count < 1:
        raise ConfigurationError("configurations", diagnose("less-than", value=count, least=1))
    if count > MAX_CONFIGURATIONS:
        raise ConfigurationError(
            "configurations", diagnose("more-than", value=count, most=MAX_CONFIGURATIONS)
        )
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise ConfigurationError("seed", diagnose("no-whole-number", value=repr(seed)))


def list_size_notes(robot: Robot, count: int) -> Iterator[Diagnostic]:
    """Yield a note for a large robot, which is compared in MuJoCo only, possibly at fewer states.

    ``count`` is the requested number of states.
    """
    if is_large(robot):
        states = count_affordable_states(robot, count)
        yield diagnose("large-without-pinocchio", dofs=robot.nv, states=states, count=count)


@check_arguments
@silence_mujoco()
def cross_check(
    robot: Robot,
    *,
    configurations: int = 20,
    tolerance: float = DEFAULT_RTOL,
    seed: int = 0,
    mimics: Mimics | None = None,
) -> CrossCheck:
    """Compare the dynamics of a robot's URDF and MJCF, each evaluated in Pinocchio and in MuJoCo.

    Large robots (`is_large`) are evaluated in MuJoCo only. A URDF that MuJoCo refuses is evaluated
    without MuJoCo, with a note. States are random: `random_states` defines the ranges of the
    configuration, the velocities and the torques.

    If the robot was loaded from an MJCF alone, terms of the MJCF that a URDF cannot express are not
    compared, for example springs: there is no second file.

    Args:
        robot: Robot.
        configurations: Number of states. Large robots may be evaluated at fewer states.
        tolerance: Largest accepted relative deviation; also the tolerance with which joint
            equalities are equivalent to ``mimics`` (`split_mimics`).
        seed: Seed of the random numbers, at least 0.
        mimics: Mimic joints of the URDF; by default read from the robot's description. An
            equivalent joint equality of the MJCF is disabled.

    Returns:
        Largest deviation of each quantity, with its joint or body, and the verdict.

    Raises:
        ConfigurationError: If an argument is out of range.
        ModelError: If MuJoCo refuses the URDF of a large robot, for example.
    """
    validate_state_request(configurations, seed)
    if not tolerance > 0:
        raise ConfigurationError("tolerance", diagnose("not-positive", value=tolerance))
    configurations, requested = count_affordable_states(robot, configurations), configurations
    states = random_states(robot, configurations, seed)
    reference = Reference(robot.mj_model, robot.mj_model, robot.joint_names, robot.mj_base)
    effects = mjcf_only_effects(reference)
    if mimics is None:
        described = urdf_mimics(parse_text(robot.description.urdf))
        mimics = {**described, **robot.description.mimics}
    coupled, _ = split_mimics(effects, reference, mimics, tolerance)
    evaluations, left_out, robot = _evaluate_all(
        robot,
        states,
        without_effects(robot.mj_model, effects),
        # A URDF that was converted from the MJCF is no file that could disagree with these terms.
        None if robot.description.converted == "urdf" else without_effects(robot.mj_model, coupled),
    )
    first = URDF_MUJOCO if is_large(robot) else URDF_PINOCCHIO
    units = get_common_units(robot, robot.joint_names)
    checks = tuple(
        _compare_evaluations(
            name, evaluations, evaluations[first], list_row_labels(robot, name), tolerance, units
        )
        for name in evaluations[first]
    )
    return CrossCheck(
        passed=all(check.passed for check in checks),
        tolerance=tolerance,
        configurations=configurations,
        seed=seed,
        quantities=checks,
        worst=max(checks, key=lambda check: check.relative).name,
        notes=(
            *left_out,
            *list_size_notes(robot, requested),
            diagnose("armature-is-the-mjcfs"),
            diagnose("gravity-is-the-mjcfs"),
            diagnose("forces-in-forward-dynamics"),
        ),
    )


def _evaluate_all(
    robot: Robot,
    states: States,
    reduced: mujoco.MjModel,
    full: mujoco.MjModel | None,
) -> tuple[dict[str, Evaluation], list[Diagnostic], Robot]:
    """Evaluate both models in the engines that read them; a large robot in MuJoCo only.

    ``reduced`` is the MJCF without terms that a URDF cannot express; ``full`` contains these terms
    (None: not evaluated).

    Returns:
        {evaluation name: values}, messages about evaluations that were left out, and the robot with
        the common frames of both files as contact points.
    """
    description = robot.description
    left_out = []
    urdf_in_mujoco: mujoco.MjModel | None = None
    try:
        urdf_in_mujoco = import_urdf_to_mujoco(
            description.urdf, description.urdf_source, robot.mj_model, robot.mj_base, robot.imu
        )
    except ModelError as error:
        if is_large(robot):
            raise  # no other engine evaluates large robots
        message = error.diagnostic.values["problem"]
        left_out.append(diagnose("urdf-not-in-mujoco", problem=message))
    pairs = {**description.contact_points, **description.frames}  # frames in both files
    urdf_frames = {name: pair[0] for name, pair in pairs.items()}
    mjcf_frames = {name: pair[1] for name, pair in pairs.items()}
    robot = replace(robot, contact_points=tuple(pairs), contact_frames=urdf_frames)
    base = robot.mj_base
    evaluations = {}
    if not is_large(robot):
        mjcf_in_pinocchio = pinocchio_from_mujoco(robot.mj_model)
        mjcf_robot = replace(
            robot,
            pin_model=mjcf_in_pinocchio,
            pin_convention=PinocchioConvention.from_model(mjcf_in_pinocchio, robot.joint_names),
            base=base,
            contact_frames=mjcf_frames,
        )
        evaluations = {
            URDF_PINOCCHIO: evaluate_in_pinocchio(robot, states),
            MJCF_PINOCCHIO: evaluate_in_pinocchio(mjcf_robot, states),
        }
    for name, model in ((MJCF_MUJOCO, reduced), (MJCF_AS_IT_IS, full)):
        if model is not None:
            evaluations[name] = evaluate_in_mujoco(robot, model, base, mjcf_frames, states)
    if urdf_in_mujoco is not None:
        urdf_in_mujoco = make_passive_model(urdf_in_mujoco)
        # MuJoCo imports mimic joints as equalities; in Pinocchio they are independent.
        urdf_in_mujoco.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT.value
        evaluations[URDF_MUJOCO] = evaluate_in_mujoco(
            robot, urdf_in_mujoco, robot.base, urdf_frames, states
        )
    if pairs and not is_large(robot):
        evaluations[URDF_YOURDFPY] = evaluate_in_yourdfpy(robot, states)
    return evaluations, left_out, robot


_ROOT_JOINT = "__root__"
"""Name of the free joint that is added to an imported URDF if the MJCF has a free joint."""


def import_urdf_to_mujoco(
    text: str,
    source: Path,
    like: mujoco.MjModel,
    base: str,
    imu: str | None,
) -> mujoco.MjModel:
    """Import a URDF into MuJoCo, keeping the mass of the base and the inertias of fixed links.

    Shapes are removed. Gravity and joint armature, which a URDF cannot state, are copied from
    ``like``. A gyro and an accelerometer are added to the link ``imu``.

    Args:
        text: URDF.
        source: Path for messages.
        like: MuJoCo model of the MJCF of the same robot.
        base: Base body in ``like``. If the base is fixed there, the URDF is fixed in the same pose.
        imu: Link with the IMU; None without IMU.

    Raises:
        ModelError: If MuJoCo refuses the URDF.
    """
    tree = UrdfTree.of(text)
    tree.remove_shapes()
    root_link = tree.base.name
    spec = UrdfImport(source, to_text(tree.root)).spec()
    spec.option.gravity = acting_gravity(like)
    if has_free_joint(like):
        spec.body(root_link).add_freejoint(name=_ROOT_JOINT)
    else:
        data = mujoco.MjData(like)
        mujoco.mj_kinematics(like, data)
        spec.body(root_link).pos = data.body(base).xpos
        spec.body(root_link).quat = data.body(base).xquat
    if imu is not None:
        SpecTree(spec).add_imu(imu, imu)
    model = copy.copy(compile_spec(spec, source))
    armature = joint_armature(like)
    for index in range(model.njnt):
        name = model.joint(index).name
        twin = list_free_joints(like)[0] if name == _ROOT_JOINT else like.joint(name).id
        start, first = int(model.jnt_dofadr[index]), int(like.jnt_dofadr[twin])
        count = 6 if name == _ROOT_JOINT else 1
        model.dof_armature[start : start + count] = armature[first : first + count]
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def _compare_evaluations(
    name: str,
    evaluations: Mapping[str, Evaluation],
    first: Evaluation,
    labels: Sequence[str],
    tolerance: float,
    units: JointUnits,
) -> QuantityCheck:
    """Compare a quantity between the evaluations of each pair in `EDGE_NAMES`.

    ``first`` is the evaluation from which the lower bound of the divisor of deviations is computed.
    """
    edges: dict[str, float] = {}
    least = _find_min_scale(name, first)
    worst: tuple[float, float, float, tuple[str, str], str] | None = None
    for pair, whose in EDGE_NAMES.items():
        if any(name not in evaluations.get(evaluation, {}) for evaluation in pair):
            continue
        first_values, second_values = (evaluations[evaluation][name] for evaluation in pair)
        relative, deviation, scale, place = _compute_deviation(
            first_values, second_values, least, per_row=name in ROW_SCALED_QUANTITIES
        )
        edges[whose] = relative
        if worst is None or relative > worst[0]:
            where = labels[place[-2]] + (f", #{place[0]}" if len(place) == 3 else "")
            worst = relative, deviation, scale, pair, where
    assert worst is not None
    relative, deviation, scale, between, where = worst
    return QuantityCheck(
        name=name,
        unit=getattr(units, COMPARED_QUANTITIES[name][1], COMPARED_QUANTITIES[name][1]),
        scale=scale,
        deviation=deviation,
        relative=relative,
        evaluations=between,
        edge=EDGE_NAMES[between],
        location=where,
        edge_deviations=edges,
        passed=bool(relative <= tolerance),
    )


def _find_min_scale(name: str, evaluation: Evaluation) -> float:
    """Return the lower bound of the divisor of a quantity's deviations, in the quantity's unit."""
    if name in ("gravity", "bias forces"):  # of a free base, about a millionth of the weight
        return 1e-6 * EARTH_GRAVITY * float(np.abs(evaluation["mass matrix"]).max())
    return {"body masses": 1e-12, "body inertias": 1e-15, "mass matrix": 1e-15}.get(name, 1e-6)


def _compute_deviation(
    first: Array, second: Array, least: float, *, per_row: bool
) -> tuple[float, float, float, tuple[int, ...]]:
    """Return the largest relative deviation of two arrays of equal shape, element by element.

    The absolute deviation is divided by a scale: the largest finite magnitude in both arrays, or in
    the same row of both if ``per_row``; at least ``least``.

    Returns:
        Relative deviation; absolute deviation, scale and indices of the same element.
    """
    with np.errstate(invalid="ignore"):
        difference = np.abs(first - second)
    difference[first == second] = 0.0  # includes equal infinite limits
    difference[~np.isfinite(difference)] = np.inf
    greatest = np.maximum(np.abs(first), np.abs(second))
    greatest[~np.isfinite(greatest)] = 0.0
    scale = greatest.max(axis=-1, keepdims=True) if per_row else greatest.max()
    scale = np.maximum(scale + np.zeros_like(difference), least)
    with np.errstate(over="ignore", invalid="ignore"):
        relative = difference / scale
    place = tuple(map(int, np.unravel_index(int(np.argmax(relative)), relative.shape)))
    return float(relative[place]), float(difference[place]), float(scale[place]), place
