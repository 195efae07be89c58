"""Compile, place and hold the published model of a robot.

The published model is the robot's MJCF, or MuJoCo's own import of the URDF, without the feet and
start pose of the preparation. The model is placed at a configuration of the prepared robot, and
held there by the file's own actuators. A joint with a torque motor or no actuator can be held by an
external servo (`HoldCommands`), whose torque the simulation computes in each step.
"""

from __future__ import annotations

import contextlib
import copy
from collections.abc import Iterator
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.models.additions import (
    ContactExclusion,
    Floor,
    Options,
    Servo,
    apply_additions,
)
from pupper_analysis.models.conversion import UrdfImport
from pupper_analysis.models.mjcf import JointKind, compile_spec, name_elements, silence_mujoco
from pupper_analysis.models.mjcf_file import MjcfFile, compile_with_shells
from pupper_analysis.models.places import one_line
from pupper_analysis.models.spec_tree import SpecTree
from pupper_analysis.models.transmission import (
    Drive,
    MadeServo,
    classify_joint_drive,
    is_at_one_joint,
    list_joint_actuators,
    list_tendon_servos,
    measure_actuator_levers,
    read_actuator_law,
)
from pupper_analysis.robot.fall import count_resets, was_reset_by_mujoco
from pupper_analysis.robot.floor import disable_ground
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import (
    make_neutral_commands,
    model_with_servos,
    write_position_servos,
)
from pupper_analysis.simulation.rollout import settled_activations

_BASE_POSE_ATOL = 1e-10
"""Upper bound of each component of the position and orientation error [m, rad], below which
`place_at_state` accepts the pose of the base. Chosen, not tuned."""

_MAX_NEWTON_STEPS = 20
"""Upper bound of the Newton steps in `place_at_state`. Chosen, not tuned."""

_TRIAL_COMMAND = 1e-6
"""Step of ctrl, in its own unit, in the finite difference of `_measure_command_law`. Chosen small
against commands that change a torque noticeably."""

_MIN_COMMAND_GAIN = 1e-9
"""Lower bound of the magnitude of the joint torque per unit of ctrl [N m or N per unit] with which
a command has an effect. Below the bound, an external servo acts on the joint directly, not through
the actuator. Chosen, not tuned."""

MAX_SETTLED_TIME_CONSTANT = 0.5
"""Upper bound of the time constant [s] of an actuator filter whose state starts at the settled
value. A slower filter starts at zero, and may be the cause of a deviation from the predicted
equilibrium (`prepare.causes`). Chosen, not tuned.
"""


@dataclass(frozen=True, eq=False)
class PublishedModel:
    """Compiled model of the user's file, with ground height, base body and types of actuators.

    Attributes:
        model: Compiled model.
        ground_height: Height of the first level plane of the world [m]; None if there is none.
        base_body: Id of the robot's base body; 0 (the world) if the model has no body of that name.
        drives: Actuator type of each joint of the robot, in actuator order, length nu.
    """

    model: mujoco.MjModel
    ground_height: float | None
    base_body: int
    drives: tuple[Drive, ...]

    @classmethod
    def from_model(cls, model: mujoco.MjModel, robot: Robot) -> PublishedModel:
        """Create the `PublishedModel` of a compiled model: find ground, base and joint drives."""
        drives = tuple(
            classify_joint_drive(model, model.joint(name).id) for name in robot.joint_names
        )
        base = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, robot.mj_base)
        return cls(
            model, _find_plane_height(model), max(base, 0), drives
        )  # a fixed base may be the world

    @property
    def floating(self) -> bool:
        """Whether the base is free in the file: its body has at least six degrees of freedom."""
        return int(self.model.body_dofnum[self.base_body]) >= 6


_STEPPING_ATTRIBUTES = ("timestep", "integrator")
"""Attributes of an MJCF's ``<option>`` on which the gains of added servos depend. If a file with
few servos lacks such an attribute, its simulation may use the value of the prepared robot
(`with_unstated_options`).
"""


_NOT_POSITION_SERVOS = (Drive.MOTOR, Drive.NONE, Drive.VELOCITY, Drive.FORCE)
"""Actuator types that are not meant to hold a position. A position servo with a stiffness of zero
or below is not in the list: it is a defect of the file (``Drive.has_invalid_stiffness``), because a
servo should hold a position."""


def has_few_servos(published: PublishedModel) -> bool:
    """Return True if more than half of the joints have no actuator that can hold a position.

    A position servo with a stiffness of zero or below counts as able to hold: such a servo is a
    defect of the file.
    """
    count = sum(drive in _NOT_POSITION_SERVOS for drive in published.drives)
    return 2 * count > len(published.drives)


def with_unstated_options(published: PublishedModel, robot: Robot) -> PublishedModel:
    """Use the prepared robot's time step and integrator, if a file with few servos states none.

    Reason: MuJoCo's defaults (2 ms, Euler) may be too coarse for the servos that the preparation
    added.
    """
    file = None if robot.published is None else robot.published.file
    if file is None or not robot.description.made_servos or not has_few_servos(published):
        return published
    stated = {name for attributes, _ in file.elements("option") for name in attributes}
    model = copy.copy(published.model)
    for name in _STEPPING_ATTRIBUTES:
        if name not in stated:
            setattr(model.opt, name, getattr(robot.mj_model.opt, name))
    return replace(published, model=model)


def with_requested_gains(
    published: PublishedModel, robot: Robot, kp: ArrayLike | None, kd: ArrayLike | None
) -> tuple[PublishedModel, Robot]:
    """Return a published model, and a robot, whose driven joints have the requested servo gains.

    If the actuator of a joint is not meant to hold a position, such as a torque motor, the joint
    gets an external servo (`HoldCommands`).

    Args:
        published: Published model: the user's file as compiled.
        robot: Prepared robot.
        kp: Requested stiffness [N m/rad, N/m], scalar or (nu,); None: value of the prepared robot.
        kd: Requested damping [N m s/rad, N s/m], scalar or (nu,); None: value of the prepared
            robot.

    Returns:
        Published model with the gains; robot with the same gains. The robot is for comparisons
        only: the MuJoCo model has gains that the description lacks.

    Raises:
        ConfigurationError: If a gain is not valid, for example negative.
        ModelError: If a joint has no motor, for example.
    """
    drive, model = model_with_servos(robot, kp, kd), copy.copy(published.model)
    added = []
    for index, name in enumerate(robot.joint_names):
        stiffness, damping = float(drive.kp[index]), float(drive.kd[index])
        # Dependent joints have a stiffness of zero.
        if stiffness == 0 or name in robot.description.passive_joints:
            continue
        kind, actuators = published.drives[index], list_joint_actuators(model, model.joint(name).id)
        if kind in _NOT_POSITION_SERVOS or len(actuators) != 1:
            added.append(MadeServo(name, stiffness, damping, kind))
        else:
            write_position_servos(model, np.array(actuators), stiffness, damping)
    described = replace(robot.description, made_servos=tuple(added))
    changed = replace(robot, description=described, mj_model=drive.model)
    return PublishedModel.from_model(model, robot), changed


def compile_published_model(mjcf: MjcfFile, robot: Robot) -> mujoco.MjModel | None:
    """Compile an MJCF as published, with the changes that a simulation needs, such as a floor.

    Returns:
        Model; None if the model lacks the base body or a joint of the robot.

    Raises:
        ModelError: If MuJoCo refuses the changed model.
    """
    spec, model = mjcf.spec.copy(), mjcf.model
    if not _contains_robot(model, robot):
        name_elements(spec, set())
        model = compile_spec(spec, mjcf.path)
        if not _contains_robot(model, robot):
            return None
    has_ground = (
        not robot.floating
        or _find_plane_height(model) is not None
        or len(_list_ground_geoms(model)) > 0
    )
    free = None if robot.floating else _find_free_joint(model, robot.mj_base)
    if has_ground and free is None:
        return model
    name_elements(spec, set())
    if not has_ground:
        SpecTree(spec).add_floor()
    if free is not None:
        _hold_base(spec, robot.mj_base, model, free)
    return compile_spec(spec, mjcf.path)


def compile_urdf_import(urdf_import: UrdfImport, robot: Robot) -> mujoco.MjModel:
    """Compile a URDF by MuJoCo's own importer, with floor and servos as in the prepared robot.

    Raises:
        ModelError: If MuJoCo refuses the URDF.
    """
    spec = urdf_import.spec()
    base = spec.body(robot.mj_base)
    while robot.floating and not list(base.joints):
        if base.parent.name == spec.worldbody.name:
            base.add_freejoint()
        else:
            base = base.parent
    kinds = Floor | Options | Servo | ContactExclusion
    additions = (addition for addition in robot.description.added if isinstance(addition, kinds))
    apply_additions(additions, SpecTree(spec))
    SpecTree(spec).stiffen_couplings()
    try:
        return compile_with_shells(spec.copy)[0]
    except (ValueError, RuntimeError) as error:
        problem = diagnose("urdf-not-imported", message=one_line(error))
        raise ModelError(urdf_import.path, problem) from error


def _find_free_joint(model: mujoco.MjModel, base: str) -> int | None:
    """Return the id of the free joint that moves the kinematic tree of a body; None without one."""
    body = model.body(base).id
    joint = int(model.body_jntadr[model.body_rootid[body]])
    kind = None if joint < 0 else int(model.jnt_type[joint])
    return joint if kind == mujoco.mjtJoint.mjJNT_FREE.value else None


def _hold_base(spec: mujoco.MjSpec, base: str, model: mujoco.MjModel, free: int) -> None:
    """Fix the base of a spec to the world, in place, and disable contacts with the ground.

    The free joint, with id ``free`` in the compiled ``model``, is removed, also from keyframes.
    """
    qpos = np.arange(7) + model.jnt_qposadr[free]
    qvel = np.arange(6) + model.jnt_dofadr[free]
    body = spec.body(base)
    while not (
        joints := [joint for joint in body.joints if joint.type == mujoco.mjtJoint.mjJNT_FREE]
    ):
        body = body.parent
    spec.delete(joints[0])
    for key in spec.keys:
        for name, entries in (("qpos", qpos), ("qvel", qvel)):
            values = np.asarray(getattr(key, name))
            if values.size:
                setattr(key, name, np.delete(values, entries[entries < values.size]))
    disable_ground(spec)


def _contains_robot(model: mujoco.MjModel, robot: Robot) -> bool:
    """Return True if a model has the base body and all joints of a robot."""
    names = {model.joint(joint).name for joint in range(model.njnt)}
    base = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, robot.mj_base)
    return base >= 0 and set(robot.joint_names) <= names


def _list_ground_geoms(model: mujoco.MjModel) -> NDArray[np.intp]:
    """Return the ids of the collidable geoms that are fixed in the world, without mocap bodies."""
    collidable = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    fixed = model.body_weldid[model.geom_bodyid] == 0
    return np.flatnonzero(collidable & fixed & (model.body_mocapid[model.geom_bodyid] < 0))


def _find_plane_height(model: mujoco.MjModel) -> float | None:
    """Return the height of the first level plane in the world [m]; None if there is none."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    plane = mujoco.mjtGeom.mjGEOM_PLANE.value
    for geom in np.flatnonzero(model.geom_type == plane):
        fixed = model.body_weldid[model.geom_bodyid[geom]] == 0
        if fixed and data.geom_xmat[geom][8] > 1 - 1e-9:
            return float(data.geom_xpos[geom][2])
    return None


def lay_on_tilted_floor(published: PublishedModel, data: mujoco.MjData) -> bool:
    """Rotate a robot on level ground at z = 0 to the tilted floor of a published model, in place.

    The floor is the first plane that is fixed to the world. The robot keeps its pose relative to
    the floor. False if the model has no plane, or the robot no free joint.
    """
    model = published.model
    mujoco.mj_kinematics(model, data)
    fixed = model.body_weldid[model.geom_bodyid] == 0
    planes = np.flatnonzero(fixed & (model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE.value))
    free = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE.value)
    roots = model.body_rootid
    of_base = roots[model.jnt_bodyid[free]] == roots[published.base_body]
    if not len(planes) or not of_base.any():
        return False
    address = int(model.jnt_qposadr[free[of_base][0]])
    turned, rotation, plane = np.zeros(4), np.zeros(4), planes[0]
    pose = data.qpos[address : address + 7]
    mujoco.mju_mat2Quat(turned, data.geom_xmat[plane])
    mujoco.mju_mulQuat(rotation, turned, pose[3:])
    pose[:3] = data.geom_xpos[plane] + data.geom_xmat[plane].reshape(3, 3) @ pose[:3]
    pose[3:] = rotation
    return True


def place_published(published: PublishedModel, robot: Robot, qpos: Array) -> mujoco.MjData | None:
    """Place a published model at a configuration of the robot, and return the MuJoCo data.

    Args:
        published: Published model: the user's file as compiled.
        robot: Prepared robot.
        qpos: Configuration of the robot, shape (nq,), above a ground at z = 0.

    Returns:
        Data, above the ground of the published model; None if the base cannot be placed there.
    """
    state = mujoco.MjData(robot.mj_model)
    robot.mj_convention.set_state(state, qpos)
    return place_at_state(published, robot, state)


def place_at_state(
    published: PublishedModel, robot: Robot, state: mujoco.MjData
) -> mujoco.MjData | None:
    """Place a published model at a state of the prepared robot's model; return the MuJoCo data.

    The base is placed so that the body of the robot's first joint has the same pose as in the
    robot's model, raised by `ground_height`. Hinges and slides outside of the base body are matched
    by name; those without a match are at zero.

    Args:
        published: Published model: the user's file as compiled.
        robot: Prepared robot.
        state: Data of ``robot.mj_model``; the kinematics are evaluated here.

    Returns:
        Data; None if the base cannot be placed there, for example if it is fixed elsewhere.
    """
    mujoco.mj_kinematics(robot.mj_model, state)
    model, body = published.model, robot.mj_model.body(robot.mj_base)
    base_joint = int(body.jntadr[0]) if body.jntnum[0] == 1 else -1
    data, roots = mujoco.MjData(model), model.body_rootid
    for joint in range(model.njnt):
        joint_body = int(model.jnt_bodyid[joint])
        if joint_body == published.base_body or model.jnt_type[joint] < 2:
            robot_type = robot.mj_model.jnt_type[base_joint]
            is_of_base = roots[joint_body] == roots[published.base_body]
            if base_joint >= 0 and model.jnt_type[joint] == robot_type == 0 and is_of_base:
                address = model.jnt_qposadr[joint]
                robot_address = robot.mj_model.jnt_qposadr[base_joint]
                pose = state.qpos[robot_address : robot_address + 7]
                data.qpos[address : address + 7] = pose  # good initial guess of the base pose
            continue
        name, address = model.joint(joint).name, int(model.jnt_qposadr[joint])
        robot_joint = mujoco.mj_name2id(robot.mj_model, mujoco.mjtObj.mjOBJ_JOINT, name)
        matches = robot_joint >= 0 and robot.mj_model.jnt_type[robot_joint] == model.jnt_type[joint]
        robot_address = robot.mj_model.jnt_qposadr[robot_joint]
        data.qpos[address] = state.qpos[robot_address] if matches else 0.0
    return data if _place_base(published, robot, state, data) else None


def place_fixed_base(published: PublishedModel, robot: Robot, qpos: Array) -> mujoco.MjData:
    """Place a published model with a fixed base at joint positions, and return the MuJoCo data.

    Args:
        published: Published model with a fixed base.
        robot: Robot that was loaded from the same file.
        qpos: Joint positions, shape (nu,) [rad, m], in actuator order.
    """
    data = mujoco.MjData(published.model)
    for name, angle in zip(robot.joint_names, qpos.tolist(), strict=True):
        data.qpos[published.model.jnt_qposadr[published.model.joint(name).id]] = angle
    return data


def _place_base(
    published: PublishedModel, robot: Robot, state: mujoco.MjData, data: mujoco.MjData
) -> bool:
    """Move the base until the body of the first joint has the same pose as in the robot's model.

    The pose is raised by `ground_height`. Newton's method is used, because the base may move by
    slides and hinges. ``data`` is changed in place. True if the pose error is below
    `_BASE_POSE_ATOL`.
    """
    model, name = published.model, robot.joint_names[0]
    body = int(model.jnt_bodyid[model.joint(name).id])
    goal = int(robot.mj_model.jnt_bodyid[robot.mj_model.joint(name).id])
    first, count = (
        int(model.body_dofadr[published.base_body]),
        int(model.body_dofnum[published.base_body]),
    )
    jac_pos, jac_rot, step = np.zeros((3, model.nv)), np.zeros((3, model.nv)), np.zeros(model.nv)
    rotation, inverse, rotation_error = np.zeros(4), np.zeros(4), np.zeros(3)
    target = state.xpos[goal] + (0.0, 0.0, published.ground_height or 0.0)
    for _ in range(_MAX_NEWTON_STEPS):
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mju_negQuat(inverse, data.xquat[body])
        mujoco.mju_mulQuat(rotation, state.xquat[goal], inverse)
        mujoco.mju_quat2Vel(rotation_error, rotation, 1.0)
        error = np.concatenate([target - data.xpos[body], rotation_error])
        if np.abs(error).max() < _BASE_POSE_ATOL:
            return True
        if not count:
            return False
        mujoco.mj_jacBody(model, data, jac_pos, jac_rot, body)
        directions = np.vstack([jac_pos, jac_rot])[:, first : first + count]
        step[first : first + count] = np.linalg.lstsq(directions, error, rcond=None)[0]
        mujoco.mj_integratePos(model, data.qpos, step, 1.0)
    return False


@dataclass(frozen=True, eq=False)
class HoldCommands:
    """Actuator commands, and external servos, with which a published model is simulated.

    An external servo is computed by the simulation in each step. Such servos hold joints without a
    position servo in the file.

    Attributes:
        ctrl: Controls of all actuators, shape (model.nu,).
        act: Initial states of the actuator filters, shape (model.na,).
        external: External servos of n joints, as five arrays of shape (n,): degrees of freedom
            (indices in qvel), kp [N m/rad, N/m], kd [N m s/rad, N s/m], target positions [rad, m],
            feed-forward torques [N m, N].
        motor_laws: {degree of freedom: (index of the control, lever, offset)}, for joints with an
            external servo and an actuator. The actuator then exerts the torque of the external
            servo. At rest the joint torque [N m] is lever * ctrl + offset.
    """

    ctrl: Array
    act: Array
    external: tuple[NDArray[np.intp], Array, Array, Array, Array]
    motor_laws: dict[int, tuple[int, float, float]]


NO_EXTERNAL_SERVOS = (
    np.zeros(0, dtype=np.intp),
    np.zeros(0),
    np.zeros(0),
    np.zeros(0),
    np.zeros(0),
)
"""Value of ``HoldCommands.external`` without external servos: five arrays of length 0, for degrees
of freedom, kp, kd, target positions and torques."""


def compute_hold_commands(
    published: PublishedModel,
    robot: Robot,
    data: mujoco.MjData,
    torques: Array | None,
    targets: Array,
) -> HoldCommands:
    """Compute the commands with which the joints of a published model hold target positions.

    Joints with a position servo in the file are commanded through this servo. Other joints may get
    an external servo.

    Args:
        published: Published model: the user's file as compiled.
        robot: Prepared robot, with the gains of the added servos.
        data: State of the published model; not modified.
        torques: Feed-forward torques, shape (nu,) [N m, N]; None for position commands alone.
        targets: Target positions, shape (nu,) [rad, m].
    """
    model = published.model
    at_joints = np.setdiff1d(np.arange(model.nactuator), list_uncommanded_actuators(model))
    ctrl = make_neutral_commands(model, data.qpos, at_joints)
    added = {servo.joint: servo for servo in robot.description.made_servos}
    rows: list[tuple[float, ...]] = []
    motors: dict[int, tuple[int, float, float]] = {}
    wanted = np.zeros(robot.nu) if torques is None else np.array(torques)
    at_tendons = _set_tendon_commands(published, robot, data.qpos, ctrl, targets, wanted)
    for index, name in enumerate(robot.joint_names):
        joint, drive = model.joint(name).id, published.drives[index]
        torque = float(wanted[index])
        target = float(targets[index])
        if index in at_tendons:
            continue
        if drive in _POSITION_DRIVES or _has_unequal_gain(
            model, list_joint_actuators(model, joint), drive
        ):
            _set_position_commands(model, list_joint_actuators(model, joint), ctrl, target, torque)
        elif name in added:
            dof = int(model.jnt_dofadr[joint])
            rows.append((dof, added[name].kp, added[name].kd, target, torque))
            law = _measure_command_law(model, data, dof, list_joint_actuators(model, joint))
            if law is not None:
                motors[dof] = law
    dofs, *columns = np.array(rows, dtype=float).reshape(-1, len(NO_EXTERNAL_SERVOS)).T
    kp, kd, target_positions, feedforward = columns
    outside = (dofs.astype(np.intp), kp, kd, target_positions, feedforward)
    return HoldCommands(
        ctrl, settled_activations(model, ctrl, MAX_SETTLED_TIME_CONSTANT), outside, motors
    )


def _set_tendon_commands(
    published: PublishedModel,
    robot: Robot,
    qpos: Array,
    ctrl: Array,
    targets: Array,
    torques: Array,
) -> set[int]:
    """Command position servos at tendons to hold the joints that have no actuator themselves.

    The tendon forces are the least-squares solution for ``torques``, shape (nu,) [N m, N], of these
    joints. The joint torques of the tendons are subtracted from ``torques``, and ``ctrl``, shape
    (model.nu,), is set, both in place.

    Returns:
        Indices of the joints that these servos drive.
    """
    model = published.model
    joints = [model.joint(name).id for name in robot.joint_names]
    servos_by_joint = {
        index: servos
        for index, drive in enumerate(published.drives)
        if drive is Drive.TENDON and (servos := list_tendon_servos(model, joints[index]))
    }
    servos = sorted({servo for group in servos_by_joint.values() for servo in group})
    if not servos:
        return set()
    commanded = qpos.copy()
    commanded[model.jnt_qposadr[joints]] = targets
    lengths, levers = measure_actuator_levers(model, commanded, servos)
    matrix = levers[:, model.jnt_dofadr[joints]].T
    rows = list(servos_by_joint)
    forces = np.linalg.lstsq(matrix[rows], torques[rows], rcond=None)[0]
    for servo, force, length in zip(servos, forces.tolist(), lengths.tolist(), strict=True):
        law = read_actuator_law(model, servo)
        command = (force + law.stiffness * length) / law.gain
        ctrl[int(model.actuator_ctrladr[servo])] = command
    torques -= matrix @ forces
    return set(rows)


_POSITION_DRIVES = (Drive.SERVO, Drive.WRONG_SIGN, Drive.NO_STIFFNESS, Drive.NO_GEAR)
"""Types of actuators at joints that get no external servo in a simulation of the published model:
position servos, also with a negative or zero stiffness, and actuators with gear 0.
"""


def _has_unequal_gain(model: mujoco.MjModel, actuators: list[int], drive: Drive) -> bool:
    """Return True if a joint has a single position servo whose gain on ctrl is not its stiffness.

    Gain and stiffness must be positive, and the gain constant. The force is
    gain * ctrl - stiffness * length: a position command does not hold exactly this position.
    """
    if not drive.has_other_law or len(actuators) != 1:
        return False
    fixed = model.actuator_gaintype[actuators[0]] == mujoco.mjtGain.mjGAIN_FIXED.value
    law = read_actuator_law(model, actuators[0])
    return bool(fixed and law.gain > 0 and law.stiffness > 0)


def _set_position_commands(
    model: mujoco.MjModel, actuators: list[int], ctrl: Array, target: float, torque: float
) -> None:
    """Set the controls with which the servos at a joint hold a target position under a torque.

    ctrl = gear * q + tau / (gear * stiffness), with the joint position q (``target`` [rad, m]), and
    the servo's part tau of ``torque`` [N m, N]. A bias, or a gain unequal to the stiffness, is not
    compensated: its effect is part of the published model.
    """
    laws = {actuator: read_actuator_law(model, actuator) for actuator in actuators}
    stiffness_sum = sum(law.joint_gains[0] for law in laws.values())
    for actuator, law in laws.items():
        if law.gain == 0 or law.joint_gains[0] == 0:
            continue
        torque_share = torque * law.joint_gains[0] / stiffness_sum if stiffness_sum else 0.0
        command = law.gear * target + torque_share / (law.gear * law.stiffness)
        ctrl[int(model.actuator_ctrladr[actuator])] = command


FORCE_WINDOW = 1.0
"""Duration [s] of the last part of a simulation, in which the extreme actuator torques are
recorded. Chosen, not tuned."""


_STEPS_PER_CHECK = 25
"""Simulation steps between two tests of whether MuJoCo has reset the state, in the part of a
simulation whose forces are not recorded. Chosen, not tuned.
"""


def simulate_published(
    published: PublishedModel,
    data: mujoco.MjData,
    hold: HoldCommands,
    seconds: float,
    *,
    record_forces: bool = True,
) -> tuple[Array, Array]:
    """Simulate a user's model whose actuators are commanded to hold a configuration.

    This function computes the torques of external servos in each step. A reset of the state by
    MuJoCo, after a divergence, ends the simulation.

    Args:
        published: Published model: the user's file as compiled. During the call, the damping of the
            model includes the damping of the external servos.
        data: Initial state, whose ctrl and activations are replaced by the values in ``hold``;
            changed to the final state.
        hold: Commands of the actuators, and gains and targets of the external servos.
        seconds: Duration [s].
        record_forces: Whether to record the extreme forces.

    Returns:
        Minimum and maximum force of actuators and external servos on each degree of freedom, shape
        (model.nv,) each [N m, N]. Forces near the end are recorded (`FORCE_WINDOW`), without the
        damping of external servos and the gravity compensation by actuators (``actuatorgravcomp``).
        Without ``record_forces``, the minimum is inf and the maximum -inf.
    """
    model = published.model
    dofs, kp, kd, targets, feedforward = hold.external
    num_steps = max(1, round(seconds / float(model.opt.timestep)))
    num_recorded = max(1, min(num_steps, round(FORCE_WINDOW / float(model.opt.timestep))))
    low, high = np.full(model.nv, np.inf), np.full(model.nv, -np.inf)
    outside = np.zeros(model.nv)
    addresses = model.jnt_qposadr[model.dof_jntid[dofs]] if len(dofs) else dofs
    # Servos whose torque a motor of the file exerts; the others act on the joints directly.
    by_motor = [index for index, dof in enumerate(dofs.tolist()) if dof in hold.motor_laws]
    direct = np.setdiff1d(np.arange(len(dofs)), by_motor)
    direct_dofs = dofs[direct]
    laws = [hold.motor_laws[dof] for dof in dofs[by_motor].tolist()]
    controls, levers, offsets = np.array(laws, dtype=float).reshape(-1, 3).T
    controls = controls.astype(np.intp)
    # Gravity compensation of actuators is no effect of their commands.
    has_gravcomp = model.jnt_actgravcomp[model.dof_jntid] != 0
    compensates = bool(has_gravcomp.any())
    data.ctrl[:], data.act[:] = hold.ctrl, hold.act
    reset_counts = count_resets(data)
    # Views of the data, which mj_step changes in place.
    ctrl, qpos, applied_forces = data.ctrl, data.qpos, data.qfrc_applied
    actuator_forces, gravcomp_forces = data.qfrc_actuator, data.qfrc_gravcomp
    # The damping is integrated implicitly, like that of MuJoCo's servos.
    with _add_temporary_damping(model, dofs, kd), silence_mujoco():
        num_unrecorded = 0 if len(dofs) else num_steps - num_recorded  # no control between steps
        for begin in range(0, num_unrecorded, _STEPS_PER_CHECK):
            if not was_reset_by_mujoco(data):
                mujoco.mj_step(model, data, nstep=min(_STEPS_PER_CHECK, num_unrecorded - begin))
        for step in range(num_unrecorded, num_steps):
            if len(dofs):
                torque = feedforward + kp * (targets - qpos[addresses])
                if by_motor:
                    ctrl[controls] = (torque[by_motor] - offsets) / levers
                outside[direct_dofs] = torque[direct]
                applied_forces[:] = outside
            mujoco.mj_step(model, data)
            was_reset = any(reset_counts.tolist())  # seven times as fast as the array's method
            if record_forces and (was_reset or step >= num_steps - num_recorded):
                applied = actuator_forces + outside
                if compensates:
                    applied -= has_gravcomp * gravcomp_forces
                np.minimum(low, applied, out=low)
                np.maximum(high, applied, out=high)
            if was_reset:  # a further step may take as long as a second of simulation
                break
    return low, high


@contextlib.contextmanager
def _add_temporary_damping(
    model: mujoco.MjModel, dofs: NDArray[np.intp], kd: Array
) -> Iterator[None]:
    """Add damping ``kd`` [N m s/rad, N s/m] to degrees of freedom of a model, within a context.

    ``dofs`` are indices in qvel. The original damping is restored at the end, also after an error.
    """
    damping = model.dof_damping[dofs].copy()
    model.dof_damping[dofs] += kd
    try:
        yield
    finally:
        model.dof_damping[dofs] = damping


def _measure_command_law(
    model: mujoco.MjModel, data: mujoco.MjData, dof: int, actuators: list[int]
) -> tuple[int, float, float] | None:
    """Measure how the torque at a joint depends on the ctrl of its actuator, at zero velocity.

    The law is torque = offset + lever * ctrl. MuJoCo's clamping of ctrl is off during the
    measurement, since zero may be at the end of a ctrlrange, or outside.

    Returns:
        Index of the control, lever [N m or N per unit of ctrl], offset [N m, N]; None without an
        actuator, or if the lever is negligible (`_MIN_COMMAND_GAIN`).
    """
    if not actuators:
        return None
    index, trial, forces = int(model.actuator_ctrladr[actuators[0]]), mujoco.MjData(model), []
    flags = model.opt.disableflags
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL
    try:
        for command in (0.0, _TRIAL_COMMAND):
            trial.qpos[:], trial.ctrl[index] = data.qpos, command
            mujoco.mj_forward(model, trial)
            forces.append(float(trial.qfrc_actuator[dof]))
    finally:
        model.opt.disableflags = flags
    lever = (forces[1] - forces[0]) / _TRIAL_COMMAND
    return (index, lever, forces[0]) if abs(lever) > _MIN_COMMAND_GAIN else None


def find_self_controlled_joints(published: PublishedModel, robot: Robot) -> tuple[str, ...]:
    """Return the names of joints with an actuator of another control law, such as ``pid``.

    These are actuators with several controls or an internal state, for which
    ``drive.has_other_law`` is True.
    """
    model, names = published.model, []
    for name, drive in zip(robot.joint_names, published.drives, strict=True):
        actuators = list_joint_actuators(model, model.joint(name).id) if drive.has_other_law else []
        if any(
            model.actuator_ctrlnum[actuator] > 1 or model.actuator_actnum[actuator]
            for actuator in actuators
        ):
            names.append(name)
    return tuple(names)


def list_unmatched_joints(published: PublishedModel, robot: Robot) -> list[int]:
    """Return the ids, in the user's MJCF, of joints that the prepared robot's model lacks.

    These joints are fixed in the prepared robot. Free joints and joints of the base body are not
    listed. Joints are matched by name.
    """
    model = published.model
    return [
        joint
        for joint in np.flatnonzero(model.jnt_type != JointKind.FREE).tolist()
        if int(model.jnt_bodyid[joint]) != published.base_body
        and mujoco.mj_name2id(robot.mj_model, mujoco.mjtObj.mjOBJ_JOINT, model.joint(joint).name)
        < 0
    ]


def list_uncommanded_actuators(model: mujoco.MjModel) -> list[int]:
    """Return the ids of the actuators that do not act on a single hinge or slide.

    Examples are actuators at a tendon or a site.
    """
    return [actuator for actuator in range(model.nactuator) if not is_at_one_joint(model, actuator)]
