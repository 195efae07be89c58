"""Compares two files of a robot, and evaluates both in both engines.

The four evaluations form a square: along two sides the engine is the same and the models differ,
along the other two the model is the same and the engines differ. So a deviation tells whose it is.

    URDF in Pinocchio --- models --- MJCF in Pinocchio
           |                                |
        engines                          engines
           |                                |
    URDF in MuJoCo ------ models --- MJCF in MuJoCo --- extras --- MJCF as it is

What a URDF cannot state (springs, tendons, fluid ...; see `passive`) is taken out of the MJCF for
the square, so that both engines are given the same model; the last side tells what it does.

A backend evaluation is one quantity of a robot's model by Pinocchio, by MuJoCo or by yourdfpy.
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
from pupper_analysis.base.arrays import rotation_from_quaternion
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, Term, diagnose
from pupper_analysis.base.errors import ConfigurationError, ModelError
from pupper_analysis.base.results import Result
from pupper_analysis.base.units import EARTH_GRAVITY
from pupper_analysis.models.conversion import (
    UrdfImport,
    acting_gravity,
    joint_armature,
    joint_damping,
    pinocchio_from_mujoco,
)
from pupper_analysis.models.efforts import find_max_effort
from pupper_analysis.models.mjcf import (
    compile_spec,
    free_joints,
    has_free_joint,
    silence_mujoco,
)
from pupper_analysis.models.multibody import joint_placements
from pupper_analysis.models.spec_tree import SpecTree
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.models.xml import parse_text, to_text
from pupper_analysis.robot.compare.behaviour import (
    States,
    affordable_states,
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
from pupper_analysis.robot.matching.sources import Sources
from pupper_analysis.robot.matching.tolerances import Tolerances
from pupper_analysis.robot.matching.trees import Mimics, Reference, urdf_mimics
from pupper_analysis.robot.robot import Robot

ENGINE_RTOL = 1e-8
"""How far the two engines may deviate on one model, relative to a quantity's scale."""


@dataclass(frozen=True, eq=False)
class Comparison(FilesCompared):
    """What became of the comparison of a URDF with an MJCF, and of the cross-check.

    Attributes:
        check: The cross-check: both models in both engines.
        engines: Quantities on which the engines deviate for one and the same model.
    """

    check: CrossCheck
    engines: tuple[Diagnostic, ...]


@check_arguments
@silence_mujoco()
def compare_models(
    urdf: str | Path,
    mjcf: str | Path,
    *,
    names: Mapping[str, str] | None = None,
    packages: Mapping[str, Path] | None = None,
    feet: Sequence[str] = (),
    tolerances: Tolerances | None = None,
    strict_names: bool = False,
    configurations: int = 20,
    seed: int = 0,
) -> Comparison:
    """Compares a URDF with an MJCF of the same robot, and explains how they differ.

    A file of another format (`base.tools.formats`) may stand in the place of either.

    Args:
        urdf: Path of the URDF, or what stands for it.
        mjcf: Path of the MJCF, or what stands for it.
        names: {name in the URDF: name in the MJCF} of joints and frames whose names differ.
        packages: {ROS package: its folder}, for ``package://`` paths.
        feet: Frames, by their names in the MJCF, that count as feet; by default all frames that
            both files have are compared.
        tolerances: What counts as a difference; by default for files of 5 to 6 digits.
        strict_names: Joints that are matched by structure, not by their name or by ``names``, are
            a difference; otherwise `guessed` alone tells of them. So are damping and dry friction
            that the URDF does not state; otherwise a note tells of them. And a fixed base that is
            tilted against the URDF's; otherwise `mount` alone tells of it.
        configurations: Number of random configurations of the cross-check.
        seed: Of the random numbers, 0 or more.

    Returns:
        The comparison.

    Raises:
        ModelError: If a file cannot be read, or the two cannot be matched.
        MissingPackageError: If what reads the format of one is not installed.
        UnknownNameError: If a name is not in its file.
        ConfigurationError: If an argument is out of its range.
    """
    validate_state_request(configurations, seed)
    tolerances = tolerances or Tolerances()
    compared = compare_files(
        urdf,
        mjcf,
        names=names,
        packages=packages,
        feet=feet,
        tolerances=tolerances,
        strict_names=strict_names,
    )
    check = cross_check(
        compared.matched.robot,
        configurations=configurations,
        tolerance=tolerances.dynamics,
        seed=seed,
        mimics=compared.matched.mimics,
    )
    own = {
        field_info.name: getattr(compared.result, field_info.name)
        for field_info in fields(compared.result)
    }
    own["differences"] = tuple(
        replace(difference, made_of=list_mass_shares(difference, *compared.sources))
        for difference in own["differences"]
    )
    return Comparison(**own, check=check, engines=_engines(check, compared.explanation))


def list_mass_shares(
    difference: Difference, urdf: Sources, mjcf: Sources
) -> tuple[Diagnostic, ...]:
    """Says of which links or bodies a mass, a com or an inertia is made, the heaviest first."""
    if difference.kind not in INERTIAL_KINDS:
        return ()
    made_of = []
    for file, sources in (("URDF", urdf), ("MJCF", mjcf)):
        heavy = [(name, mass) for name, mass in sources.members(difference.element) if mass]
        if len(heavy) > 1:
            members = [
                diagnose("mass-of-a-member", subject=("body", name), mass=Quantity(mass, "kg"))
                for name, mass in sorted(heavy, key=lambda member: -member[1])
            ]
            made_of.append(diagnose("body-is-made-of", file=file, members=members))
    return tuple(made_of)


def _engines(check: CrossCheck, explanation: Explanation) -> tuple[Diagnostic, ...]:
    """Says where the engines deviate for one and the same model."""
    return tuple(
        diagnose(
            "engines-deviate",
            subject=("quantity", quantity.name),
            relative=relative,
            edge=Term(whose),
        )
        for quantity in check.quantities
        for whose, relative in quantity.edges.items()
        if whose in ENGINE_EDGES
        and relative > ENGINE_RTOL
        # With what no difference explains, the two got different models.
        and (explanation.complete or whose not in MJCF_ENGINE_EDGES)
    )


Array = NDArray[np.float64]


Evaluation = dict[str, Array]
"""{quantity: (n, ...) of the model, or (configurations, n, ...) of states}."""

BODIES, JOINTS, DOFS, FEET = "bodies", "joints", "dofs", "feet"

QUANTITIES = {
    "body masses": (BODIES, "kg"),
    "body coms": (BODIES, "m"),
    "body inertias": (BODIES, "kg m^2"),
    "joint axes": (JOINTS, ""),
    "lower joint limits": (JOINTS, "rad"),
    "upper joint limits": (JOINTS, "rad"),
    "effort limits": (JOINTS, "N m"),
    "armature": (JOINTS, "kg m^2"),
    "joint damping": (JOINTS, "N m s/rad"),
    "joint friction": (JOINTS, "N m"),
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
"""{quantity: what its rows belong to, its unit}. What does not depend on the configuration is in
the base's axes at zero angles."""

ROW_SCALED_QUANTITIES = ("body masses", "body inertias")
"""What is judged on each row's own scale, instead of on the greatest of all."""


def list_row_labels(robot: Robot, quantity: str) -> tuple[str, ...]:
    """Returns what each row of a quantity belongs to."""
    base = tuple(f"base {axis}" for axis in "xyz") + tuple(f"about {axis}" for axis in "xyz")
    rows = {
        BODIES: (robot.base, *robot.joint_names),
        JOINTS: robot.joint_names,
        DOFS: (*(base if robot.floating else ()), *robot.joint_names),
        FEET: robot.contact_points,
    }
    of = QUANTITIES[quantity][0]
    return rows.get(of, (of,))


def collect_evaluation(
    robot: Robot, at_rest: Mapping[str, ArrayLike], of_states: Sequence[Mapping[str, ArrayLike]]
) -> Evaluation:
    """Collects what does not depend on the configuration, and what was computed at each."""
    found: Evaluation = {
        name: np.array(values, dtype=float).reshape(len(list_row_labels(robot, name)), -1)
        for name, values in at_rest.items()
    }
    for name in of_states[0]:
        rows = np.array([values[name] for values in of_states])
        found[name] = rows.reshape(len(rows), len(list_row_labels(robot, name)), -1)
    return found


def evaluate_in_pinocchio(robot: Robot, states: States) -> Evaluation:
    """Evaluates the robot's Pinocchio model, at states what depends on them."""
    model, convention = robot.pin_model, robot.pin_convention
    rest = Configuration(robot, robot.neutral())
    placements = joint_placements(model, convention.q(rest.qpos))
    ids = [int(model.getJointId(name)) for name in robot.joint_names]
    base = 1 if robot.floating else 0
    bodies = [placements[joint].act(model.inertias[joint]) for joint in (base, *ids)]
    v = convention.v_index
    at_rest = {
        **_of_bodies(bodies),
        "joint axes": [rest.joint_axis(name) for name in robot.joint_names],
        "lower joint limits": robot.lower_limits,
        "upper joint limits": robot.upper_limits,
        # Of 0, a habit of exporters, it is none: MuJoCo's reader of URDFs says so, and
        # `resolve_effort_limit`.
        "effort limits": np.where(model.effortLimit[v] == 0, np.inf, model.effortLimit[v]),
        "armature": model.armature[v],
        "joint damping": model.damping[v],
        "joint friction": model.friction[v],
    }
    base_rows = robot.nv - robot.nu
    damping = np.concatenate([model.damping[:base_rows], model.damping[v]])
    of_states = []
    del rest  # Pinocchio's data of hundreds of joints take a second to make: its serve all states
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


def _of_bodies(bodies: Sequence[pin.Inertia]) -> dict[str, ArrayLike]:
    return {
        "body masses": [body.mass for body in bodies],
        "body coms": [np.array(body.lever) for body in bodies],
        "body inertias": [np.array(body.inertia) for body in bodies],
    }


def evaluate_in_mujoco(
    robot: Robot,
    model: mujoco.MjModel,
    base: str,
    frames: Mapping[str, str],
    states: States,
) -> Evaluation:
    """Evaluates a model of the robot in MuJoCo.

    Args:
        robot: The robot; its joints and feet are evaluated.
        model: Its URDF or MJCF, compiled.
        base: The body that is the base there.
        frames: {foot or frame: its name there}.
        states: Where to evaluate what depends on the configuration.
    """
    data = mujoco.MjData(model)
    convention = MujocoConvention.of(model, robot.joint_names)
    convention.set_state(data, robot.neutral())
    mujoco.mj_forward(model, data)
    dofs = convention.qvel_index[robot.nv - robot.nu :]
    at_rest = _at_rest(robot, model, data, base, dofs)
    sensors = _imu_sensors(model, robot.imu)
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


def _at_rest(
    robot: Robot,
    model: mujoco.MjModel,
    data: mujoco.MjData,
    base: str,
    dofs: NDArray[np.int64],
) -> dict[str, ArrayLike]:
    """Evaluates what does not depend on the state; the data are those of zero angles."""
    joints = [model.joint(name).id for name in robot.joint_names]
    carriers = [model.body(base).id, *(int(model.jnt_bodyid[joint]) for joint in joints)]
    bodies = _lumped(model, data, carriers)
    limited = model.jnt_limited[joints].astype(bool)
    return {
        **_of_bodies(bodies),
        "joint axes": data.xaxis[joints],
        "lower joint limits": np.where(limited, model.jnt_range[joints, 0], -np.inf),
        "upper joint limits": np.where(limited, model.jnt_range[joints, 1], np.inf),
        "effort limits": [find_max_effort(model, joint) for joint in joints],
        "armature": joint_armature(model)[dofs],
        "joint damping": joint_damping(model)[dofs],
        "joint friction": model.dof_frictionloss[dofs],
    }


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


def evaluate_in_yourdfpy(robot: Robot, states: States) -> Evaluation:
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
        frames = robot.contact_frames.values()
        places = [urdf.get_transform(frame, robot.base)[:3, 3] for frame in frames]
        rows.append({"foot positions": [origin + rotation @ place for place in places]})
    return collect_evaluation(robot, {}, rows)


def _with_unit_axes(text: str) -> bytes:
    """Returns a URDF whose axes are of length 1.

    The engines take an axis for a direction; yourdfpy moves a slide by its length times q. Its
    shapes are left out: yourdfpy knows no capsules.
    """
    tree = UrdfTree.of(text)
    tree.remove_shapes()
    for axis in tree.root.iter("axis"):
        direction = np.array([float(word) for word in str(axis.get("xyz", "1 0 0")).split()])
        unit = direction / np.linalg.norm(direction)
        axis.set("xyz", " ".join(map(repr, unit.tolist())))
    return to_text(tree.root).encode()


def _base(robot: Robot, qpos: NDArray[np.float64]) -> pin.SE3:
    """Returns where the base's frame is in the world, which takes no kinematics."""
    model = robot.pin_model
    frame = model.frames[model.getFrameId(robot.base, pin.FrameType.BODY)]
    if not robot.floating:
        return frame.placement
    return pin.SE3(rotation_from_quaternion(qpos[3:7]), qpos[:3]) * frame.placement


DEFAULT_RTOL = 1e-9
"""Deviation, relative to a quantity's scale, up to which two evaluations agree."""

URDF_PINOCCHIO = "URDF in Pinocchio"

MJCF_PINOCCHIO = "MJCF in Pinocchio"

URDF_MUJOCO = "URDF in MuJoCo"

MJCF_MUJOCO = "MJCF in MuJoCo"

MJCF_AS_IT_IS = "MJCF as it is"

URDF_YOURDFPY = "URDF in yourdfpy"

EXTRAS_EDGE = "extras (MJCF)"
"""The side of springs, tendons, fluid and others that a URDF has no words for."""

EDGE_NAMES = {
    (URDF_PINOCCHIO, MJCF_PINOCCHIO): "models (Pinocchio)",
    (URDF_MUJOCO, MJCF_MUJOCO): "models (MuJoCo)",
    (URDF_PINOCCHIO, URDF_MUJOCO): "engines (URDF)",
    (MJCF_PINOCCHIO, MJCF_MUJOCO): "engines (MJCF)",
    (URDF_PINOCCHIO, URDF_YOURDFPY): "yourdfpy (URDF)",
    (MJCF_MUJOCO, MJCF_AS_IT_IS): EXTRAS_EDGE,
}
"""What a deviation between two evaluations is a deviation of."""

ENGINE_EDGES = ("engines (URDF)", "engines (MJCF)", "yourdfpy (URDF)")
"""Deviations of engines, which read one and the same model."""

MJCF_ENGINE_EDGES = ("engines (MJCF)",)
"""Those of them in which MuJoCo's model is the MJCF's."""


@dataclass(frozen=True, eq=False)
class QuantityCheck(Result):
    """How far the evaluations on one quantity deviate.

    Attributes:
        name: The quantity.
        unit: Its unit.
        scale: What the deviation is relative to: the greatest absolute value.
        deviation: The worst absolute deviation.
        relative: The worst relative deviation.
        between: The two evaluations that deviate most.
        whose: What it is a deviation of: the models, or the engines.
        where: The body, joint or foot where it occurs, and the configuration's number.
        edges: {whose: worst relative deviation}.
        passed: Whether ``relative`` is within the tolerance.
    """

    name: str
    unit: str
    scale: float = field(metadata={"unit": "varies"})
    deviation: float = field(metadata={"unit": "varies"})
    relative: float = field(metadata={"unit": "1"})
    between: tuple[str, str]
    whose: str
    where: str
    edges: dict[str, float] = field(metadata={"unit": "1"})
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
    tolerance: float = field(metadata={"unit": "1"})
    configurations: int
    seed: int
    quantities: tuple[QuantityCheck, ...]
    worst: str
    notes: tuple[Diagnostic, ...]


MAX_CONFIGURATIONS = 100_000
"""Configurations that are compared: more find nothing, and fill the memory."""


def validate_state_request(count: int, seed: int) -> None:
    """Checks what random states are asked for.

    Raises:
        ConfigurationError: If there are none or too many, or the seed is not a whole number from 0.
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
    """Yields what is left out of the comparison of a large robot at so many states."""
    if is_large(robot):
        states = affordable_states(robot, count)
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
    validate_state_request(configurations, seed)
    if not tolerance > 0:
        raise ConfigurationError("tolerance", diagnose("not-positive", value=tolerance))
    configurations, asked = affordable_states(robot, configurations), configurations
    states = random_states(robot, configurations, seed)
    reference = Reference(robot.mj_model, robot.mj_model, robot.joint_names, robot.mj_base)
    found = mjcf_only_effects(reference)
    if mimics is None:
        mimics = urdf_mimics(parse_text(robot.description.urdf))
    coupled, _ = split_mimics(found, reference, mimics, tolerance)
    evaluations, left_out, robot = _evaluations(
        robot,
        states,
        without_effects(robot.mj_model, found),
        without_effects(robot.mj_model, coupled),
    )
    first = URDF_MUJOCO if is_large(robot) else URDF_PINOCCHIO
    checks = tuple(
        _compare(name, evaluations, evaluations[first], list_row_labels(robot, name), tolerance)
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
            *list_size_notes(robot, asked),
            diagnose("armature-is-the-mjcfs"),
            diagnose("gravity-is-the-mjcfs"),
            diagnose("forces-in-forward-dynamics"),
        ),
    )


def _evaluations(
    robot: Robot,
    states: States,
    square: mujoco.MjModel,
    whole: mujoco.MjModel,
) -> tuple[dict[str, Evaluation], list[Diagnostic], Robot]:
    """Evaluates both models in all backends.

    Args:
        robot: The robot.
        states: Where.
        square: MuJoCo's model of the MJCF, without what a URDF cannot state.
        whole: The same as it is, but for couplings that the URDF has, too.

    Returns:
        {backend: its evaluation}, what was left out and why, and the robot with the frames that
        both files have in the place of its feet.
    """
    description = robot.description
    left_out = []
    in_mujoco: mujoco.MjModel | None = None
    try:
        in_mujoco = import_urdf_to_mujoco(
            description.urdf, description.urdf_source, robot.mj_model, robot.mj_base, robot.imu
        )
    except ModelError as error:
        if is_large(robot):
            raise  # which no other engine evaluates
        message = error.diagnostic.values["problem"]
        left_out.append(diagnose("urdf-not-in-mujoco", problem=message))
    pairs = {**description.contact_points, **description.frames}  # of both files
    urdf_frames = {name: pair[0] for name, pair in pairs.items()}
    mjcf_frames = {name: pair[1] for name, pair in pairs.items()}
    robot = replace(robot, contact_points=tuple(pairs), contact_frames=urdf_frames)
    base = robot.mj_base
    evaluations = {}
    if not is_large(robot):
        in_pinocchio = pinocchio_from_mujoco(robot.mj_model)
        mjcf_robot = replace(
            robot,
            pin_model=in_pinocchio,
            pin_convention=PinocchioConvention.of(in_pinocchio, robot.joint_names),
            base=base,
            contact_frames=mjcf_frames,
        )
        evaluations = {
            URDF_PINOCCHIO: evaluate_in_pinocchio(robot, states),
            MJCF_PINOCCHIO: evaluate_in_pinocchio(mjcf_robot, states),
        }
    evaluations |= {
        MJCF_MUJOCO: evaluate_in_mujoco(robot, square, base, mjcf_frames, states),
        MJCF_AS_IT_IS: evaluate_in_mujoco(robot, whole, base, mjcf_frames, states),
    }
    if in_mujoco is not None:
        in_mujoco = make_passive_model(in_mujoco)
        # MuJoCo's importer makes equalities of mimic joints, which Pinocchio leaves independent.
        in_mujoco.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT.value
        evaluations[URDF_MUJOCO] = evaluate_in_mujoco(
            robot, in_mujoco, robot.base, urdf_frames, states
        )
    if pairs and not is_large(robot):
        evaluations[URDF_YOURDFPY] = evaluate_in_yourdfpy(robot, states)
    return evaluations, left_out, robot


_ROOT = "__root__"


def import_urdf_to_mujoco(
    text: str,
    source: Path,
    like: mujoco.MjModel,
    base: str,
    imu: str | None,
) -> mujoco.MjModel:
    """Imports a URDF into MuJoCo, with the base's mass and the inertias of fixed children kept.

    Shapes are left out. Gravity is taken from ``like``, and so is the armature of the joints, which
    URDF cannot state; a gyro and an accelerometer are put on the link ``imu``.

    Args:
        text: The URDF.
        source: Where it came from, for messages.
        like: MuJoCo's model of the MJCF of the same robot.
        base: The base's body in ``like``: if it is fixed there, it is fixed in the same pose.
        imu: The link with the IMU, if any.

    Raises:
        ModelError: If MuJoCo refuses it.
    """
    tree = UrdfTree.of(text)
    tree.remove_shapes()
    root_link = tree.base.name
    spec = UrdfImport(source, to_text(tree.root)).spec()
    spec.option.gravity = acting_gravity(like)
    if has_free_joint(like):
        spec.body(root_link).add_freejoint(name=_ROOT)
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
        twin = free_joints(like)[0] if name == _ROOT else like.joint(name).id
        start, first = int(model.jnt_dofadr[index]), int(like.jnt_dofadr[twin])
        count = 6 if name == _ROOT else 1
        model.dof_armature[start : start + count] = armature[first : first + count]
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def _compare(
    name: str,
    evaluations: Mapping[str, Evaluation],
    first: Evaluation,
    labels: Sequence[str],
    tolerance: float,
) -> QuantityCheck:
    """Compares one quantity along every edge; the first evaluation gives the scale."""
    edges: dict[str, float] = {}
    least = _least_scale(name, first)
    worst: tuple[float, float, float, tuple[str, str], str] | None = None
    for pair, whose in EDGE_NAMES.items():
        if any(name not in evaluations.get(evaluation, {}) for evaluation in pair):
            continue
        one, two = (evaluations[evaluation][name] for evaluation in pair)
        relative, deviation, scale, place = _deviation(
            one, two, least, per_row=name in ROW_SCALED_QUANTITIES
        )
        edges[whose] = relative
        if worst is None or relative > worst[0]:
            where = labels[place[-2]] + (f", #{place[0]}" if len(place) == 3 else "")
            worst = relative, deviation, scale, pair, where
    assert worst is not None
    relative, deviation, scale, between, where = worst
    return QuantityCheck(
        name=name,
        unit=QUANTITIES[name][1],
        scale=scale,
        deviation=deviation,
        relative=relative,
        between=between,
        whose=EDGE_NAMES[between],
        where=where,
        edges=edges,
        passed=bool(relative <= tolerance),
    )


def _least_scale(name: str, evaluation: Evaluation) -> float:
    """Returns below what a quantity is rounding alone: a ratio of that is no deviation."""
    if name in ("gravity", "bias forces"):  # a millionth of what the robot weighs
        return 1e-6 * EARTH_GRAVITY * float(np.abs(evaluation["mass matrix"]).max())
    return {"body masses": 1e-12, "body inertias": 1e-15, "mass matrix": 1e-15}.get(name, 1e-6)


def _deviation(
    one: Array, two: Array, least: float, *, per_row: bool
) -> tuple[float, float, float, tuple[int, ...]]:
    """Returns the worst relative and absolute deviation, the scale, and the place."""
    with np.errstate(invalid="ignore"):
        difference = np.abs(one - two)
    difference[one == two] = 0.0  # infinite limits, too
    difference[~np.isfinite(difference)] = np.inf
    greatest = np.maximum(np.abs(one), np.abs(two))
    greatest[~np.isfinite(greatest)] = 0.0
    scale = greatest.max(axis=-1, keepdims=True) if per_row else greatest.max()
    scale = np.maximum(scale + np.zeros_like(difference), least)
    with np.errstate(over="ignore", invalid="ignore"):
        relative = difference / scale
    place = tuple(map(int, np.unravel_index(int(np.argmax(relative)), relative.shape)))
    return float(relative[place]), float(difference[place]), float(scale[place]), place
