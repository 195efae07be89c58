"""The MJCF as it was published, put where the prepared robot stands, and held by its own drives.

Nothing in it is edited; it is given a floor if it has none, and where it has torque motors (or
nothing) at a joint, the law of the servos that were made up there, through its own motors.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

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
from pupper_analysis.models.mjcf import compile_spec, name_elements, scalar_joints, silence_mujoco
from pupper_analysis.models.mjcf_file import MjcfFile, compile_with_shells
from pupper_analysis.models.places import one_line
from pupper_analysis.models.spec_tree import SpecTree
from pupper_analysis.models.transmission import (
    Drive,
    MadeServo,
    classify_joint_drive,
    is_at_one_joint,
    list_joint_actuators,
    read_actuator_law,
)
from pupper_analysis.robot.fall import was_reset_by_mujoco
from pupper_analysis.robot.floor import disable_ground
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import (
    make_neutral_commands,
    model_with_servos,
    write_position_servos,
)
from pupper_analysis.simulation.rollout import settled_activations

Array = NDArray[np.float64]

_PLACED = 1e-10  # m, rad: to which the base is placed; its joints are few, and Newton's steps exact

_STEPS = 20  # of Newton's, of which a free joint takes two

_COMMAND = 1e-6  # to a motor, within any limit of it

_LEAST_STIFFNESS = 1e-9  # N m (or N) that a motor makes of a command of 1: less is none

MAX_SETTLED_TIME_CONSTANT = 0.5
"""A servo's filter that is slower is where the file has it at first (s): no command of a stand
brings it there, as ``timeconst="1e5"``; a faster one is where its command has brought it."""


@dataclass(frozen=True, eq=False)
class PublishedModel:
    """The MJCF as it was published.

    Attributes:
        model: What MuJoCo compiles it to.
        ground_height: The height of its level ground (m); None if it has another.
        base_body: Its body that is the robot's base.
        drives: (nu,) what moves each of the robot's joints in it.
    """

    model: mujoco.MjModel
    ground_height: float | None
    base_body: int
    drives: tuple[Drive, ...]

    @classmethod
    def of(cls, model: mujoco.MjModel, robot: Robot) -> PublishedModel:
        """Finds a robot's base and joints in a model that has them."""
        drives = tuple(
            classify_joint_drive(model, model.joint(name).id) for name in robot.joint_names
        )
        base = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, robot.mj_base)
        return cls(model, _ground(model), max(base, 0), drives)  # one that is held may be the world

    @property
    def floating(self) -> bool:
        """Whether joints leave its base free to move."""
        return int(self.model.body_dofnum[self.base_body]) >= 6


_STEPPING = ("timestep", "integrator")
"""Attributes of an MJCF's ``<option>`` that servos of our choice need."""


_NOT_POSITION_SERVOS = (Drive.MOTOR, Drive.NONE, Drive.VELOCITY, Drive.FORCE)
"""Drives that are not meant to hold a position. A position servo whose stiffness is zero or
negative is meant to, and its file fails because of it (``Drive.bad``)."""


def has_few_servos(published: PublishedModel) -> bool:
    """Return True if most joints have a torque motor, a velocity servo or no actuator."""
    others = sum(drive in _NOT_POSITION_SERVOS for drive in published.drives)
    return 2 * others > len(published.drives)


def with_unstated_options(published: PublishedModel, robot: Robot) -> PublishedModel:
    """Return a published model with the time step and integrator chosen for the added servos.

    Servos of our choice need a time step and an integrator. If the file has few servos, and states
    neither, MuJoCo's defaults (2 ms, Euler) are nobody's choice. Each attribute that the file
    states is kept, as are all options of a file with servos of its own.

    Args:
        published: Published model.
        robot: Prepared robot, with the added servos.
    """
    file = None if robot.published is None else robot.published.file
    if file is None or not robot.description.made_servos or not has_few_servos(published):
        return published
    stated = {name for attributes, _ in file.elements("option") for name in attributes}
    model = copy.copy(published.model)
    for name in _STEPPING:
        if name not in stated:
            setattr(model.opt, name, getattr(robot.mj_model.opt, name))
    return replace(published, model=model)


def with_requested_gains(
    published: PublishedModel, robot: Robot, kp: ArrayLike | None, kd: ArrayLike | None
) -> tuple[PublishedModel, Robot]:
    """Return a published model, and its robot, whose joints have the requested servo gains.

    An actuator of the file becomes a position servo by the rule of ``model_with_servos``. A joint
    with a torque motor, or without actuator, is held by the external law of ``HoldCommands``. The
    returned robot is for comparisons only: its MuJoCo model has gains that its description lacks.

    Args:
        published: Published model.
        robot: Prepared robot.
        kp: Requested stiffness [N m/rad], one or (nu,); None: that of the prepared robot.
        kd: Requested damping [N m s/rad], one or (nu,); None: that of the prepared robot.

    Raises:
        ConfigurationError: See ``model_with_servos``.
        ModelError: See ``model_with_servos``.
    """
    drive, model = model_with_servos(robot, kp, kd), copy.copy(published.model)
    added = []
    for index, name in enumerate(robot.joint_names):
        stiffness, damping = float(drive.kp[index]), float(drive.kd[index])
        if stiffness == 0:  # the joint follows others
            continue
        kind, actuators = published.drives[index], list_joint_actuators(model, model.joint(name).id)
        if kind in _NOT_POSITION_SERVOS or len(actuators) != 1:
            added.append(MadeServo(name, stiffness, damping, kind))
        else:
            write_position_servos(model, np.array(actuators), stiffness, damping)
    described = replace(robot.description, made_servos=tuple(added))
    changed = replace(robot, description=described, mj_model=drive.model)
    return PublishedModel.of(model, robot), changed


def compile_published_model(mjcf: MjcfFile, robot: Robot) -> mujoco.MjModel | None:
    """Returns the model of an MJCF as it was published; None if it lacks the robot's base.

    It has names, and a floor if it is to stand, if it has none: nothing else is put into it. What
    is only seen stays: the geoms of a body have the order that they have in the robot's. A base
    that is held, and free in the file, is held in it, too.
    """
    model = mjcf.model
    grounded = not robot.floating or _ground(model) is not None or len(_fixed_geoms(model)) > 0
    free = None if robot.floating or not _has(model, robot) else _free_joint(model, robot.mj_base)
    if grounded and free is None and _has(model, robot):
        return mjcf.model
    spec = mjcf.spec.copy()
    name_elements(spec, set())
    if not grounded:
        SpecTree(spec).add_floor()
    if free is not None:
        _hold_base(spec, robot.mj_base, model, free)
    model = compile_spec(spec, mjcf.path)
    return model if _has(model, robot) else None


def compile_urdf_import(own: UrdfImport, robot: Robot) -> mujoco.MjModel:
    """Returns the model of a URDF as MuJoCo itself imports it, with what no URDF can state.

    That is a free base, and what the robot was given: a floor, how MuJoCo steps, and contacts and
    couplings hold, which bodies overlap and do not touch, and servos. Its shapes are the file's.

    Raises:
        ModelError: If MuJoCo refuses it.
    """
    spec = own.spec()
    base = spec.body(robot.mj_base)
    while robot.floating and not list(base.joints):
        if base.parent.name == spec.worldbody.name:
            base.add_freejoint()
        else:
            base = base.parent
    kinds = Floor | Options | Servo | ContactExclusion
    given = (one for one in robot.description.added if isinstance(one, kinds))
    apply_additions(given, SpecTree(spec))
    SpecTree(spec).stiffen_couplings()
    try:
        return compile_with_shells(spec.copy)[0]
    except (ValueError, RuntimeError) as error:
        problem = diagnose("urdf-not-imported", message=one_line(error))
        raise ModelError(own.path, problem) from error


def _free_joint(model: mujoco.MjModel, base: str) -> int | None:
    """Returns the free joint that carries a body; None if none does."""
    body = model.body(base).id
    joint = int(model.body_jntadr[model.body_rootid[body]])
    kind = None if joint < 0 else int(model.jnt_type[joint])
    return joint if kind == mujoco.mjtJoint.mjJNT_FREE.value else None


def _hold_base(spec: mujoco.MjSpec, base: str, model: mujoco.MjModel, free: int) -> None:
    """Removes a base's free joint and its numbers in keyframes, in place; the ground lets go."""
    qpos = np.arange(7) + model.jnt_qposadr[free]
    qvel = np.arange(6) + model.jnt_dofadr[free]
    body = spec.body(base)
    while not (joints := [one for one in body.joints if one.type == mujoco.mjtJoint.mjJNT_FREE]):
        body = body.parent
    spec.delete(joints[0])
    for key in spec.keys:
        for name, own in (("qpos", qpos), ("qvel", qvel)):
            numbers = np.asarray(getattr(key, name))
            if numbers.size:
                setattr(key, name, np.delete(numbers, own[own < numbers.size]))
    disable_ground(spec)


def _has(model: mujoco.MjModel, robot: Robot) -> bool:
    names = {model.joint(joint).name for joint in range(model.njnt)}
    base = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, robot.mj_base)
    return base >= 0 and set(robot.joint_names) <= names


def _fixed_geoms(model: mujoco.MjModel) -> NDArray[np.intp]:
    """Returns the geoms that stand in the world and may be touched."""
    touch = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    still = model.body_weldid[model.geom_bodyid] == 0
    return np.flatnonzero(touch & still & (model.body_mocapid[model.geom_bodyid] < 0))


def _ground(model: mujoco.MjModel) -> float | None:
    """Returns the height of the level plane in the world (m)."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    plane = mujoco.mjtGeom.mjGEOM_PLANE.value
    for geom in np.flatnonzero(model.geom_type == plane):
        fixed = model.body_weldid[model.geom_bodyid[geom]] == 0
        if fixed and data.geom_xmat[geom][8] > 1 - 1e-9:
            return float(data.geom_xpos[geom][2])
    return None


def place_published(published: PublishedModel, robot: Robot, qpos: Array) -> mujoco.MjData | None:
    """Returns the published model's data in a configuration of the robot; None if it cannot be.

    Args:
        published: The published model.
        robot: The robot.
        qpos: (nq,) its configuration, above ground at z = 0.
    """
    there = mujoco.MjData(robot.mj_model)
    robot.mj_convention.set_state(there, qpos)
    return place_at_state(published, robot, there)


def place_at_state(
    published: PublishedModel, robot: Robot, there: mujoco.MjData
) -> mujoco.MjData | None:
    """Returns the published model's data with everything where the robot's model has it."""
    mujoco.mj_kinematics(robot.mj_model, there)
    model, same = published.model, robot.mj_model.body(robot.mj_base)
    base = int(same.jntadr[0]) if same.jntnum[0] == 1 else -1
    data = mujoco.MjData(model)
    for joint in range(model.njnt):
        if int(model.jnt_bodyid[joint]) == published.base_body or model.jnt_type[joint] < 2:
            if base >= 0 and model.jnt_type[joint] == robot.mj_model.jnt_type[base] == 0:
                place, other = model.jnt_qposadr[joint], robot.mj_model.jnt_qposadr[base]
                data.qpos[place : place + 7] = there.qpos[other : other + 7]  # mostly it is there
            continue
        name, place = model.joint(joint).name, int(model.jnt_qposadr[joint])
        same = mujoco.mj_name2id(robot.mj_model, mujoco.mjtObj.mjOBJ_JOINT, name)
        known = same >= 0 and robot.mj_model.jnt_type[same] == model.jnt_type[joint]
        data.qpos[place] = there.qpos[robot.mj_model.jnt_qposadr[same]] if known else 0.0
    return data if _base_placed(published, robot, there, data) else None


def place_fixed_base(published: PublishedModel, robot: Robot, qpos: Array) -> mujoco.MjData:
    """Returns the data of a published model whose base is held, at joint positions (nu,)."""
    data = mujoco.MjData(published.model)
    for name, angle in zip(robot.joint_names, qpos.tolist(), strict=True):
        data.qpos[published.model.jnt_qposadr[published.model.joint(name).id]] = angle
    return data


def _base_placed(
    published: PublishedModel, robot: Robot, there: mujoco.MjData, data: mujoco.MjData
) -> bool:
    """Puts the base where the first joint's body is as it is in the robot's model, in place.

    The base's own frame may be elsewhere on it. By Newton's method on the base's joints, as they
    may be three slides and three hinges as well as a free joint.
    """
    model, name = published.model, robot.joint_names[0]
    anchor = int(model.jnt_bodyid[model.joint(name).id])
    goal = int(robot.mj_model.jnt_bodyid[robot.mj_model.joint(name).id])
    first, count = (
        int(model.body_dofadr[published.base_body]),
        int(model.body_dofnum[published.base_body]),
    )
    moved, turned, step = np.zeros((3, model.nv)), np.zeros((3, model.nv)), np.zeros(model.nv)
    turn, back, whole = np.zeros(4), np.zeros(4), np.zeros(3)
    target = there.xpos[goal] + (0.0, 0.0, published.ground_height or 0.0)
    for _ in range(_STEPS):
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mju_negQuat(back, data.xquat[anchor])
        mujoco.mju_mulQuat(turn, there.xquat[goal], back)
        mujoco.mju_quat2Vel(whole, turn, 1.0)
        error = np.concatenate([target - data.xpos[anchor], whole])
        if np.abs(error).max() < _PLACED:
            return True
        if not count:
            return False
        mujoco.mj_jacBody(model, data, moved, turned, anchor)
        directions = np.vstack([moved, turned])[:, first : first + count]
        step[first : first + count] = np.linalg.lstsq(directions, error, rcond=None)[0]
        mujoco.mj_integratePos(model, data.qpos, step, 1.0)
    return False


@dataclass(frozen=True, eq=False)
class HoldCommands:
    """What the drives of a published model are given, so that they hold a configuration.

    Attributes:
        ctrl: (model.nu,) of its own servos; zero for the others.
        act: (model.na,) the state of their filters.
        external: (dofs, kp, kd, targets, torques) of the joints that a law from outside holds.
        motor_laws: {dof: (control, lever, offset)} of those of them with an actuator whose force at
            the joint is lever x ctrl + offset at rest (N m).
    """

    ctrl: Array
    act: Array
    external: tuple[NDArray[np.intp], Array, Array, Array, Array]
    motor_laws: dict[int, tuple[int, float, float]]


def compute_hold_commands(
    published: PublishedModel,
    robot: Robot,
    data: mujoco.MjData,
    torques: Array | None,
    targets: Array,
) -> HoldCommands:
    """Works out what holds joints at targets (nu,) with torques (nu,) ahead, or none.

    Args:
        published: The published model.
        robot: The robot, with the servos that were made up.
        data: The model's data, which are not changed.
        torques: (nu,) N m; None: positions alone are commanded.
        targets: (nu,) rad.
    """
    model = published.model
    at_joints = np.setdiff1d(np.arange(model.nactuator), list_uncommanded_actuators(model))
    ctrl = make_neutral_commands(model, data.qpos, at_joints)
    made = {servo.joint: servo for servo in robot.description.made_servos}
    rows: list[tuple[float, ...]] = []
    motors: dict[int, tuple[int, float, float]] = {}
    for index, name in enumerate(robot.joint_names):
        joint, drive = model.joint(name).id, published.drives[index]
        torque = 0.0 if torques is None else float(torques[index])
        goal = float(targets[index])
        if drive in _COMMANDED or _is_unequal(model, list_joint_actuators(model, joint), drive):
            _command(model, list_joint_actuators(model, joint), ctrl, goal, torque)
        elif name in made:
            dof = int(model.jnt_dofadr[joint])
            rows.append((dof, made[name].kp, made[name].kd, goal, torque))
            lever = _lever(model, data, dof, list_joint_actuators(model, joint))
            if lever is not None:
                motors[dof] = lever
    dofs, kp, kd, goals, ahead = np.array(rows, dtype=float).reshape(-1, 5).T
    outside = (dofs.astype(np.intp), kp, kd, goals, ahead)
    return HoldCommands(
        ctrl, settled_activations(model, ctrl, MAX_SETTLED_TIME_CONSTANT), outside, motors
    )


_COMMANDED = (Drive.SERVO, Drive.WRONG_SIGN, Drive.NO_STIFFNESS)
"""Drives that are told a position."""


def _is_unequal(model: mujoco.MjModel, motors: list[int], drive: Drive) -> bool:
    """Tells whether a joint's one actuator is a servo but for a gain that is not its stiffness."""
    if not drive.has_other_law or len(motors) != 1:
        return False
    fixed = model.actuator_gaintype[motors[0]] == mujoco.mjtGain.mjGAIN_FIXED.value
    law = read_actuator_law(model, motors[0])
    return bool(fixed and law.gain > 0 and law.stiffness > 0)


def _command(
    model: mujoco.MjModel, motors: list[int], ctrl: Array, goal: float, torque: float
) -> None:
    """Tells the servos at a joint to hold it, each its part of the torque by its stiffness.

    As whoever takes them for position servos does: ctrl = q* + tau / kp. A bias beside, or a gain
    that is not the stiffness, is not made up for: it is what the file does.
    """
    laws = {motor: read_actuator_law(model, motor) for motor in motors}
    whole = sum(law.at_joint[0] for law in laws.values())
    for motor, law in laws.items():
        if law.gain == 0 or law.at_joint[0] == 0:
            continue
        share = torque * law.at_joint[0] / whole if whole else 0.0
        ahead = law.gear * goal + share / (law.gear * law.stiffness)
        ctrl[int(model.actuator_ctrladr[motor])] = ahead


FORCE_WINDOW = 1.0
"""Of a simulation (s), in which it is looked at what drives give."""


_STEPS = 25
"""Steps after which it is looked at whether MuJoCo began anew."""


def simulate_published(
    published: PublishedModel, data: mujoco.MjData, hold: HoldCommands, seconds: float
) -> tuple[Array, Array]:
    """Simulates the published model from its data on, in place, until MuJoCo loses it.

    Returns:
        (model.nv,) each: the least and the most that its drives gave in the ``FORCE_WINDOW``
        second (N m).
    """
    model = published.model
    dofs, kp, kd, goals, ahead = hold.external
    steps = max(1, round(seconds / float(model.opt.timestep)))
    last = max(1, min(steps, round(FORCE_WINDOW / float(model.opt.timestep))))
    low, high = np.full(model.nv, np.inf), np.full(model.nv, -np.inf)
    outside = np.zeros(model.nv)
    places = model.jnt_qposadr[model.dof_jntid[dofs]] if len(dofs) else dofs
    # What motors give against gravity beside their commands is not what they are asked for.
    relief = model.jnt_actgravcomp[model.dof_jntid] != 0
    damping = model.dof_damping[dofs].copy()
    model.dof_damping[dofs] += kd  # taken implicitly, as the servos' own is
    data.ctrl[:], data.act[:] = hold.ctrl, hold.act
    with silence_mujoco():
        at_once = 0 if len(dofs) else steps - last  # with nothing to be done between steps
        for begin in range(0, at_once, _STEPS):
            if not was_reset_by_mujoco(data):
                mujoco.mj_step(model, data, nstep=min(_STEPS, at_once - begin))
        for step in range(at_once, steps):
            if len(dofs):
                torque = ahead + kp * (goals - data.qpos[places])
                outside[:] = 0.0
                for dof, wanted in zip(dofs.tolist(), torque.tolist(), strict=True):
                    if dof in hold.motor_laws:
                        control, lever, offset = hold.motor_laws[dof]
                        data.ctrl[control] = (wanted - offset) / lever
                    else:
                        outside[dof] = wanted
                data.qfrc_applied[:] = outside
            mujoco.mj_step(model, data)
            lost = was_reset_by_mujoco(data)
            if lost or step >= steps - last:
                given = data.qfrc_actuator + outside - relief * data.qfrc_gravcomp
                np.minimum(low, given, out=low)
                np.maximum(high, given, out=high)
            if lost:  # each further step may take as long as a second of others
                break
    model.dof_damping[dofs] = damping
    return low, high


def _lever(
    model: mujoco.MjModel, data: mujoco.MjData, dof: int, drives: list[int]
) -> tuple[int, float, float] | None:
    """Returns what an actuator at a joint makes of its command; None if it makes nothing of it."""
    if not drives:
        return None
    control, trial, forces = int(model.actuator_ctrladr[drives[0]]), mujoco.MjData(model), []
    for command in (0.0, _COMMAND):
        trial.qpos[:], trial.ctrl[control] = data.qpos, command
        mujoco.mj_forward(model, trial)
        forces.append(float(trial.qfrc_actuator[dof]))
    lever = (forces[1] - forces[0]) / _COMMAND
    return (control, lever, forces[0]) if abs(lever) > _LEAST_STIFFNESS else None


def find_self_controlled_joints(published: PublishedModel, robot: Robot) -> tuple[str, ...]:
    """Returns the joints whose actuator has a controller of its own, as MuJoCo's ``pid``.

    It has several commands, or a state: no law from outside makes it hold a pose.
    """
    model, found = published.model, []
    for name, drive in zip(robot.joint_names, published.drives, strict=True):
        motors = list_joint_actuators(model, model.joint(name).id) if drive.has_other_law else []
        if any(model.actuator_ctrlnum[m] > 1 or model.actuator_actnum[m] for m in motors):
            found.append(name)
    return tuple(found)


def list_unmatched_joints(published: PublishedModel, robot: Robot) -> list[int]:
    """Returns the published model's joints that the robot holds at zero."""
    model = published.model
    return [
        joint
        for joint in scalar_joints(model).tolist()
        if int(model.jnt_bodyid[joint]) != published.base_body
        and mujoco.mj_name2id(robot.mj_model, mujoco.mjtObj.mjOBJ_JOINT, model.joint(joint).name)
        < 0
    ]


def list_uncommanded_actuators(model: mujoco.MjModel) -> list[int]:
    """Returns the actuators that drive no hinge or slide of their own."""
    return [motor for motor in range(model.nactuator) if not is_at_one_joint(model, motor)]
