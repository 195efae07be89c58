"""Simulate the published robot file from a keyframe, independently of the computed stand.

A verdict is computed for the prepared robot: loading may have added servos, a floor or a start
pose, and may have disabled contacts. The simulation of the published file from a keyframe (called
own run) shows if the file alone stands in MuJoCo. A URDF without MJCF is simulated as MuJoCo's
import, with an added free base, floor and servos if needed.
"""

from __future__ import annotations

import contextlib
import copy
import itertools
import math
from dataclasses import asdict, dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import ConfigurationError, ModelError
from pupper_analysis.models.mjcf import JointKind, silence_mujoco
from pupper_analysis.models.transmission import (
    Drive,
    list_joint_actuators,
    list_tendon_servos,
    read_actuator_law,
    read_gears,
)
from pupper_analysis.prepare.published_model import (
    NO_EXTERNAL_SERVOS,
    HoldCommands,
    PublishedModel,
    compile_published_model,
    compile_urdf_import,
    compute_hold_commands,
    find_self_controlled_joints,
    has_few_servos,
    place_fixed_base,
    place_published,
    simulate_published,
    with_unstated_options,
)
from pupper_analysis.prepare.servo_tuning import TIMESTEP_DIVISORS
from pupper_analysis.prepare.start import is_standing_pose
from pupper_analysis.robot.as_published import (
    MAX_POSTURE_DEVIATION,
    MIN_UNHELD_DISPLACEMENT,
    JointOff,
    OwnCommands,
    OwnRun,
)
from pupper_analysis.robot.fall import (
    FALLEN_TILT,
    BodyMotion,
    find_bodies_near_world,
    horizontal_distance,
    initial_height,
    keyframe_duration,
    measure_motion,
    nudge_velocity,
    simulate_held_keyframe,
    simulate_keyframe,
    tilt_between,
    was_reset_by_mujoco,
)
from pupper_analysis.robot.joints import joint_unit, leg_joints
from pupper_analysis.robot.robot import Robot, get_loaded_robot
from pupper_analysis.stance.posture import close_posture

_CTRL_ANGLE_RTOL = 0.1
"""Upper bound [1] of ``|ctrl - angles| / |angles|`` with which the ctrl of a keyframe counts as
joint angles, not torques. The norms are over all actuators at joints; angles are multiplied by the
gear. Chosen, not tuned: position commands differ from the angles by the static deflection."""

_CTRL_DEGREE_RTOL = 1e-3
"""Upper bound [1] of ``|ctrl - angles| / |angles|``, with hinge angles in degrees, with which the
ctrl of a keyframe counts as joint angles in degrees. Chosen as a bound of rounding, and small since
torques of tens of N m may be near angles in degrees by chance.
"""

_SETTLING_TIME = 2.0
"""Simulated time [s] after which a nudged model that stands must be at rest. Chosen, not tuned."""

_MAX_GROUND_DISTANCE_RATIO = 0.05
"""Upper bound of the distance of a leg from the ground, relative to the CoM height [1], with which
the leg counts as on the ground (`_list_lifted_legs`). Chosen, not tuned.
"""

_MAX_RESTING_SPEED = 5e-3
"""Upper bound of the speeds of a robot at rest [m/s, rad/s]. Chosen between two measured speeds:
feet of ANYmal B that creep apart move at 1e-3; robots that shake oscillate with 2e-2 or more.
"""


def own_run(robot: Robot) -> OwnRun | None:
    """Simulate the published file from its keyframe; the result is cached per loaded robot.

    Without a keyframe, the simulation starts at the robot's start pose (``Robot.home``).

    Returns:
        Simulation result; None if the file cannot be simulated, for example with a fixed base.
    """
    return get_loaded_robot(robot).compute_once(_simulate_from_keyframe)


def get_published_model(robot: Robot) -> mujoco.MjModel | None:
    """Return the compiled model of the published file, with the MuJoCo options that the caller set.

    The published file is usually the MJCF of the user, or MuJoCo's import of a URDF without MJCF.

    Returns:
        Model, with a floor if necessary (`compile_published_model`). None, for example, if MuJoCo
        cannot import the URDF.
    """
    if robot.published is None:
        return None
    if robot.published.is_unchanged:
        return robot.mj_model
    if robot.published.file is None:
        found, _ = robot.compute_once(_import_urdf)
        model = None if isinstance(found, Diagnostic) else found
    else:
        model = compile_published_model(robot.published.file, robot)
    if model is not None and robot.published.options:
        model = copy.copy(model)
        for name, value in robot.published.options:
            setattr(model.opt, name, value)
    return model


def describe_import_failure(robot: Robot) -> tuple[Diagnostic, ...]:
    """Create the message that states why MuJoCo cannot import the URDF of a robot, as a tuple.

    Empty without such a failure.
    """
    found, _ = get_loaded_robot(robot).compute_once(_import_urdf)
    return (diagnose("own-import-refused", problem=found),) if isinstance(found, Diagnostic) else ()


@dataclass(frozen=True, eq=False)
class _NudgedStates:
    """Recorded states of a nudged simulation, reused by a later simulation of the same model.

    Attributes:
        model: Published model: the user's file as compiled.
        hold: Commands of the actuators, and external servos.
        initial: Initial state with the nudge, a small velocity (mjSTATE_INTEGRATION).
        reached: Later states, at increasing times.
    """

    model: mujoco.MjModel
    hold: HoldCommands
    initial: Array
    reached: tuple[mujoco.MjData, ...]

    def advance(
        self, model: mujoco.MjModel, state: mujoco.MjData, hold: HoldCommands, seconds: float
    ) -> float:
        """Advance ``state`` in place to a recorded state, if it repeats the recorded simulation.

        Returns:
            Part of ``seconds`` that the caller must still simulate [s].
        """
        if model is not self.model or not _are_equal_commands(hold, self.hold):
            return seconds
        known = (self.initial, *(_get_integration_state(model, data) for data in self.reached))
        current = _get_integration_state(model, state)
        if not any(np.array_equal(current, values) for values in known):
            return seconds
        begin, timestep = state.time, float(model.opt.timestep)
        for data in self.reached:
            if begin < data.time <= begin + seconds + timestep / 2:
                mujoco.mj_copyData(state, model, data)
        return seconds - float(state.time - begin)


def _find_nudged_run(robot: Robot) -> _NudgedStates | None:
    """Return the recorded simulation in which the imported URDF comes to rest; None without one."""
    published = robot.published
    if published is None or published.is_unchanged or published.file is not None:
        return None
    _, run = get_loaded_robot(robot).compute_once(_import_urdf)
    return run


def _get_integration_state(model: mujoco.MjModel, data: mujoco.MjData) -> Array:
    """Return the full state (mjSTATE_INTEGRATION) that determines MuJoCo's next steps, (n,)."""
    kind = mujoco.mjtState.mjSTATE_INTEGRATION
    values = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, values, kind)
    return values


def _are_equal_commands(first: HoldCommands, second: HoldCommands) -> bool:
    """Return True if actuator commands and external servos of the same model are equal."""
    pairs = zip(
        (first.ctrl, first.act, *first.external),
        (second.ctrl, second.act, *second.external),
        strict=True,
    )
    return first.motor_laws == second.motor_laws and all(
        np.array_equal(first_values, second_values) for first_values, second_values in pairs
    )


def _import_urdf(
    robot: Robot,
) -> tuple[mujoco.MjModel | Diagnostic | None, _NudgedStates | None]:
    """Import a URDF by MuJoCo's importer, with a time step at which the robot settles, if any.

    Returns:
        Model; or the error message if MuJoCo refuses the URDF; or None without a URDF to import.
        And the simulation in which the robot settles, or None.
    """
    if robot.published is None or robot.published.imported is None:
        return None, None
    try:
        model = compile_urdf_import(robot.published.imported, robot)
    except ModelError as error:
        return error.cause, None
    # Servos and time step were tuned for the collision shapes of the prepared robot. The shapes of
    # the file may have more contact points, and may then need a smaller time step.
    step = float(model.opt.timestep)
    for divisor in TIMESTEP_DIVISORS if robot.floating and robot.feet else ():
        model.opt.timestep = step / divisor
        settles, run = _simulate_settling(model, robot, robot.home)
        if settles:
            return model, run
    model.opt.timestep = step
    return model, None


def settles_in_place(model: mujoco.MjModel, robot: Robot, qpos: Array) -> bool:
    """Return True if a nudged model still stands, and is at rest, after 2 s (``_SETTLING_TIME``).

    The nudge is a small initial velocity.

    Args:
        model: Published model: the user's file as compiled.
        robot: Prepared robot, with the gains of the added servos.
        qpos: Configuration of the stand, shape (nq,). The joint positions are commanded.
    """
    return _simulate_settling(model, robot, qpos)[0]


def _simulate_settling(
    model: mujoco.MjModel, robot: Robot, qpos: Array
) -> tuple[bool, _NudgedStates | None]:
    """Simulate a nudged model for 2 s (`_SETTLING_TIME`), to find out if it comes to rest.

    The joint positions in ``qpos``, shape (nq,), are commanded.

    Returns:
        True if the robot still stands and is at rest; and the recorded simulation, or None if the
        base cannot be placed.
    """
    published = with_unstated_options(PublishedModel.from_model(model, robot), robot)
    start = place_published(published, robot, qpos)
    if start is None:
        return False, None
    data = copy.copy(start)
    data.qvel[:] = nudge_velocity(published.model)
    hold = compute_hold_commands(
        published, robot, data, None, data.qpos[joint_qpos_addresses(published, robot)]
    )
    data.ctrl[:], data.act[:] = hold.ctrl, hold.act
    initial, reached = _get_integration_state(model, data), []
    timestep = float(model.opt.timestep)
    halfway = round(keyframe_duration(model) / timestep) // 2 * timestep
    times = (halfway, _SETTLING_TIME) if halfway < _SETTLING_TIME else (_SETTLING_TIME,)
    for begin, end in itertools.pairwise((0.0, *times)):
        if not was_reset_by_mujoco(data):  # a reset ends the simulation
            simulate_published(published, data, hold, end - begin, record_forces=False)
            reached.append(copy.copy(data))
    run = _NudgedStates(published.model, hold, initial, tuple(reached))
    if not np.abs(data.qvel).max() < _MAX_RESTING_SPEED:
        return False, run
    height = initial_height(
        published.model, start, published.base_body, published.ground_height or 0.0
    )
    motion = measure_motion(
        published.model, start, data, published.base_body, _SETTLING_TIME, height
    )
    return not motion.collapses, run


def _simulate_from_keyframe(robot: Robot) -> OwnRun | None:
    """Simulate the published file of a loaded robot from its keyframe (`own_run`, uncached)."""
    if not robot.floating or not robot.feet or robot.published is None:
        return None
    model = robot.compute_once(get_published_model)
    if model is None:
        return None
    return simulate_model_from_keyframe(PublishedModel.from_model(model, robot), robot)


def simulate_model_from_keyframe(published: PublishedModel, robot: Robot) -> OwnRun | None:
    """Simulate a published model from a keyframe, to find out if the file alone stands.

    Without a keyframe, the simulation starts at the robot's start pose (``Robot.home``).

    Args:
        published: Model of the unmodified file, or a copy with modifications.
        robot: Prepared robot.

    Returns:
        Simulation result; None, for example, if the base is not free in the model.
    """
    if robot.published is None or not published.floating:
        return None
    name = _select_keyframe(published.model, robot, robot.published.keyframe)
    return (
        _simulate_nominal_stand(published, robot)
        if name is None
        else _simulate_key(published, robot, name)
    )


def _select_keyframe(model: mujoco.MjModel, robot: Robot, wanted: str | None) -> int | None:
    """Return the index of the keyframe from which a published model is simulated, or None.

    ``wanted`` is the name of a requested keyframe. If None, a standing pose is preferred.
    """
    names = [keyframe_name(model, key) for key in range(model.nkey)]
    if wanted is not None:
        return names.index(wanted) if wanted in names else None
    joints = [model.joint(name).id for name in robot.joint_names]
    places = model.jnt_qposadr[joints]
    ranks = {}
    for key, name in enumerate(names):
        values = dict(zip(robot.joint_names, model.key_qpos[key, places].tolist(), strict=True))
        ranks[key] = (not is_standing_pose(robot, values), name != "home")
    return min(ranks, key=ranks.__getitem__, default=None)


@silence_mujoco()
def _simulate_key(
    published: PublishedModel, robot: Robot, key: int, reference: Array | None = None
) -> OwnRun:
    """Simulate a published model from a keyframe, with the ctrl of the keyframe (zeros if absent).

    If ctrl is absent, a second run may command the joint positions of the keyframe
    (``OwnRun.held``). For ``reference``, see `_simulate_commands`.
    """
    model, data = published.model, mujoco.MjData(published.model)
    mujoco.mj_resetDataKeyframe(model, data, key)
    stated = bool(model.key_ctrl[key].any()) or _xml_has_ctrl(robot, key)
    limp = has_few_servos(published)
    run = _simulate_commands(
        published,
        robot,
        data,
        HoldCommands(data.ctrl.copy(), data.act.copy(), NO_EXTERNAL_SERVOS, {}),
        reference,
    )
    run = replace(
        run,
        keyframe=keyframe_name(model, key),
        commands=OwnCommands.STATED if stated else OwnCommands.ABSENT,
        limp=limp and not _is_ctrl_angles(model, key),
    )
    if stated or limp or find_self_controlled_joints(published, robot):
        return run
    return replace(
        run, held=replace(_simulate_holding(published, robot, data), keyframe=run.keyframe)
    )


def _simulate_holding(published: PublishedModel, robot: Robot, data: mujoco.MjData) -> OwnRun:
    """Simulate a published model that is commanded to hold the joint positions in ``data``."""
    pose = data.qpos[joint_qpos_addresses(published, robot)].copy()
    run = _simulate_commands(
        published, robot, data, _commands_to_hold(published, robot, data, pose)
    )
    return replace(run, commands=OwnCommands.ANGLES)


def _xml_has_ctrl(robot: Robot, key: int) -> bool:
    """Return True if the XML of a keyframe has the attribute ``ctrl``.

    The compiled model does not distinguish a missing attribute from explicit zeros.
    """
    assert robot.published is not None
    file = robot.published.file
    keys = (robot.description.mjcf if file is None else file.spec).keys
    return key < len(keys) and len(keys[key].ctrl) > 0


@silence_mujoco()
def _simulate_nominal_stand(published: PublishedModel, robot: Robot) -> OwnRun | None:
    """Simulate a published model from the start pose (``Robot.home``), which is commanded.

    None, for example, if the world has no level plane.
    """
    published = with_unstated_options(published, robot)
    data = place_published(published, robot, robot.home)
    if (
        data is None
        or published.ground_height is None
        or find_self_controlled_joints(published, robot)
    ):
        return None
    return _simulate_holding(published, robot, data)


def _commands_to_hold(
    published: PublishedModel, robot: Robot, data: mujoco.MjData, pose: Array
) -> HoldCommands:
    """Compute commands with which a published model holds joint positions (nu,) [rad, m].

    External servos are used if most joints of the file have no servo.
    """
    hold = compute_hold_commands(published, robot, data, None, pose)
    return (
        hold
        if has_few_servos(published)
        else replace(hold, external=NO_EXTERNAL_SERVOS, motor_laws={})
    )


def joint_qpos_addresses(published: PublishedModel, robot: Robot) -> NDArray[np.intp]:
    """Return the indices of the robot's joints in ``qpos``, shape (nu,), in actuator order."""
    joints = [published.model.joint(joint).id for joint in robot.joint_names]
    return np.asarray(published.model.jnt_qposadr[joints])


_SAME_POSTURE_ATOL = 1e-6
"""Tolerance [rad, m] of each joint with which a posture counts as the posture of a keyframe; the
ctrl of the keyframe, if stated, is then used. Chosen, not tuned.
"""


@dataclass(frozen=True, eq=False)
class PostureKeyframe:
    """Keyframe from which a posture was computed.

    Attributes:
        key: Index of the keyframe in the published model.
        name: Name of the keyframe.
        moved: Displacement of each joint when loops and couplings are closed, shape (nu,) [rad, m]:
            position in the posture minus position in the keyframe. 0 for dependent joints, which
            servos do not hold.
        reference: Joint positions of the keyframe, shape (nu,) [rad, m], with dependent joints as
            in the posture.
    """

    key: int
    name: str
    moved: Array
    reference: Array


def find_posture_keyframe(robot: Robot, joints: Array) -> PostureKeyframe | None:
    """Find the keyframe of the published file from which a posture was computed.

    Args:
        robot: Prepared robot.
        joints: Joint positions of the posture, shape (nu,) [rad, m], with closed loops.

    Returns:
        First keyframe whose joint positions equal the posture after its loops and couplings are
        closed; None without such a keyframe.
    """
    model = robot.compute_once(get_published_model)
    if model is None:
        return None
    places = joint_qpos_addresses(PublishedModel.from_model(model, robot), robot)
    for key, qpos in enumerate(model.key_qpos):
        start = qpos[places]
        with contextlib.suppress(ConfigurationError):
            closed = close_posture(robot, start, np.zeros(0, np.int64), keeps_driven=True)
            if np.abs(closed - joints).max(initial=0.0) < _SAME_POSTURE_ATOL:
                reference = start.copy()
                if robot.closure is not None:
                    dependent = robot.closure.dependent_joints
                    reference[dependent] = joints[dependent]
                return PostureKeyframe(
                    key, keyframe_name(model, key), joints - reference, reference
                )
    return None


def simulate_fixed_base(robot: Robot, joints: Array) -> OwnRun | None:
    """Simulate the published file of a robot with a fixed base, to find out if a posture is held.

    If a keyframe with ctrl leads to this posture (`find_posture_keyframe`), the simulation starts
    at the keyframe, with its ctrl. Otherwise the simulation starts at the posture, and commands the
    joint positions.

    Args:
        robot: Prepared robot.
        joints: Joint positions of the posture, shape (nu,) [rad, m].

    Returns:
        Simulation result; None if the file cannot be simulated, for example with a free base.
    """
    model = None if robot.floating else robot.compute_once(get_published_model)
    if model is None:
        return None
    published = PublishedModel.from_model(model, robot)
    if published.floating or find_self_controlled_joints(published, robot):
        return None
    found = find_posture_keyframe(robot, joints)
    run = (
        _simulate_key(published, robot, found.key, found.reference)
        if found is not None and _xml_has_ctrl(robot, found.key)
        else simulate_posture(published, robot, joints)
    )
    return replace(run, limp=has_few_servos(published))


def simulate_posture(published: PublishedModel, robot: Robot, joints: Array) -> OwnRun:
    """Simulate a published model with a fixed base, commanded to a posture in which it starts.

    Args:
        published: Model of the unmodified file, or a copy with modifications.
        robot: Prepared robot.
        joints: Joint positions of the posture, shape (nu,) [rad, m].
    """
    return _simulate_holding(published, robot, place_fixed_base(published, robot, joints))


def keyframe_name(model: mujoco.MjModel, key: int) -> str:
    """Return the name of a keyframe; "keyframe 1" etc. for keyframes without a name."""
    return model.key(key).name or f"keyframe {key + 1}"


def _simulate_commands(
    published: PublishedModel,
    robot: Robot,
    data: mujoco.MjData,
    hold: HoldCommands,
    reference: Array | None = None,
) -> OwnRun:
    """Simulate a published model with constant commands, and measure the joint displacements.

    The initial state ``data`` is not modified. The displacements are relative to the joint
    positions ``reference``, shape (nu,) [rad, m]; default: those of ``data``.
    """
    start = copy.copy(data)
    start.ctrl[:], start.act[:] = hold.ctrl, hold.act
    known = _find_nudged_run(robot)

    def advance(state: mujoco.MjData, seconds: float) -> None:
        """Advance a state of the published model by ``seconds`` [s], in place."""
        if not was_reset_by_mujoco(state):  # a reset ends the simulation
            rest = (
                seconds if known is None else known.advance(published.model, state, hold, seconds)
            )
            if rest > 0.5 * float(published.model.opt.timestep):
                simulate_published(published, state, hold, rest, record_forces=False)

    if robot.floating:
        motion, end = simulate_keyframe(
            published.model, start, published.base_body, published.ground_height or 0.0, advance
        )
        motion = _measure_lean_from_upright(published, robot, motion, end)
    else:
        motion, end = simulate_held_keyframe(published.model, start, advance)
    if reference is None:
        reference = start.qpos[joint_qpos_addresses(published, robot)]
    joints = _joint_deviations(published, robot, reference, end, hold.ctrl)
    unheld = _find_unheld_joints(published, robot, joints)
    lifted = (
        [] if motion.diverged else _list_lifted_legs(published, robot, joints, start, end, motion)
    )
    imported = robot.published is not None and robot.published.imported is not None
    timestep = float(published.model.opt.timestep)
    is_finer = imported and timestep < robot.mj_model.opt.timestep
    return OwnRun(
        **asdict(motion),
        imported=imported,
        timestep=timestep if is_finer else None,
        worst=None if motion.diverged else max(joints, key=_absolute_displacement, default=None),
        unheld=None if motion.diverged else max(unheld, key=_absolute_displacement, default=None),
        standing=robot.floating,
        missing=_missing_files(robot),
        redirected=max(
            (joint for joint in joints if not motion.diverged and joint.commanded_away),
            key=_absolute_displacement,
            default=None,
        ),
        lifted_leg=max(lifted, key=_absolute_displacement, default=None),
        stance_travel=min(motion.away, _measure_base_travel(published, start, end)),
    )


def _measure_base_travel(
    published: PublishedModel, start: mujoco.MjData, end: mujoco.MjData
) -> float:
    """Return the horizontal distance of the base body's CoM between two states [m]."""
    states = copy.copy(start), copy.copy(end)
    for state in states:
        mujoco.mj_kinematics(published.model, state)
    first, last = (state.xipos[published.base_body] for state in states)
    return horizontal_distance(first, last)


def _list_lifted_legs(
    published: PublishedModel,
    robot: Robot,
    joints: list[JointOff],
    start: mujoco.MjData,
    end: mujoco.MjData,
    motion: BodyMotion,
) -> list[JointOff]:
    """Return the joints of moved legs that are on the ground at reset, but not at the end of a run.

    A leg is on the ground if a body of the leg is near a fixed geom, for example a heel behind a
    toe.
    """
    offsets = {joint.joint: joint for joint in joints}
    legs = (
        [leg_joints(robot, points[0]) for points in robot.feet.values()] if robot.floating else []
    )
    moved = [
        leg
        for leg in legs
        if leg and math.hypot(*(offsets[name].off for name in leg)) > MAX_POSTURE_DEVIATION
    ]
    if not moved:
        return []
    model, margin = published.model, _MAX_GROUND_DISTANCE_RATIO * max(motion.height, 0.0)
    before = find_bodies_near_world(model, start, margin, lowered=max(motion.clearance, 0.0))
    after = find_bodies_near_world(model, end, margin)
    lifted: list[JointOff] = []
    for leg in moved:
        shared = {name for other_leg in legs if other_leg is not leg for name in other_leg}
        first = next((name for name in leg if name not in shared), leg[-1])
        bodies = _list_descendants(model, model.joint(first).bodyid[0])
        if before & bodies and not after & bodies:
            lifted += [offsets[name] for name in leg]
    return lifted


def _list_descendants(model: mujoco.MjModel, body: int) -> set[int]:
    """Return the ids of a body and of all its descendants."""
    found = {int(body)}
    for child in range(int(body) + 1, model.nbody):  # parents have smaller ids than children
        if int(model.body_parentid[child]) in found:
            found.add(child)
    return found


def _measure_lean_from_upright(
    published: PublishedModel, robot: Robot, motion: BodyMotion, end: mujoco.MjData
) -> BodyMotion:
    """Replace the final tilt of a motion, so that a tilted keyframe does not decide about a fall.

    Reason: a humanoid whose keyframe bends the base forward has not fallen.
    """
    upright = place_published(published, robot, robot.home)
    if upright is None or motion.diverged:
        return motion
    last = copy.copy(end)
    for data in (upright, last):
        mujoco.mj_kinematics(published.model, data)
    base = published.base_body
    lean = tilt_between(upright.xmat[base].reshape(3, 3), last.xmat[base].reshape(3, 3))
    has_fallen = lean > FALLEN_TILT and (motion.lies or lean > math.pi / 2)
    return replace(motion, lean=lean if has_fallen else min(lean, motion.lean))


def _missing_files(robot: Robot) -> tuple[str, ...]:
    """Return the names of missing files, such as meshes, that the published MJCF requires."""
    file = None if robot.published is None else robot.published.file
    notes = () if file is None or file.of_urdf else file.notes
    missing = [note.values["files"] for note in notes if note.code == "files-missing"]
    return tuple(str(name) for names in missing if isinstance(names, tuple) for name in names)


def _joint_deviations(
    published: PublishedModel, robot: Robot, reference: Array, end: mujoco.MjData, ctrl: Array
) -> list[JointOff]:
    """Return the displacement of each joint from ``reference`` (nu,) to ``end`` [rad, m]."""
    displacement = end.qpos[joint_qpos_addresses(published, robot)] - reference
    return [
        JointOff(
            name,
            float(displacement[index]),
            published.drives[index],
            _command_offset(published, name, ctrl, float(reference[index])),
            joint_unit(robot, name),
        )
        for index, name in enumerate(robot.joint_names)
    ]


def _find_unheld_joints(
    published: PublishedModel, robot: Robot, joints: list[JointOff]
) -> list[JointOff]:
    """Return the joints that moved because no position servo holds them.

    Joints without actuator that need no servo (passive, coupled) are left out. The result is empty
    unless more than half of the joints have a position servo.
    """
    num_servos = sum(joint.drive is Drive.SERVO for joint in joints)
    if 2 * num_servos <= len(joints):
        return []
    added = {servo.joint for servo in robot.description.made_servos}
    return [
        joint
        for joint in joints
        if joint.drive is not Drive.SERVO
        and (joint.drive is not Drive.NONE or joint.joint in added)
        and not (
            joint.drive is Drive.TENDON
            and list_tendon_servos(published.model, published.model.joint(joint.joint).id)
        )
        and _absolute_displacement(joint) > MIN_UNHELD_DISPLACEMENT
    ]


def _absolute_displacement(joint: JointOff) -> float:
    """Return the absolute displacement of a joint [rad, m]."""
    return abs(joint.off)


def _command_offset(
    published: PublishedModel, joint: str, ctrl: Array, position: float
) -> float | None:
    """Compute the position commanded by a servo's ctrl, minus the joint's ``position`` [rad, m].

    The commanded position is gain * ctrl / (stiffness * gear): an actuator without bias exerts no
    force there. None unless the joint has a single actuator, with positive stiffness.
    """
    actuators = list_joint_actuators(published.model, published.model.joint(joint).id)
    laws = [read_actuator_law(published.model, actuator) for actuator in actuators]
    if len(actuators) != 1 or laws[0].joint_gains[0] <= 0:
        return None
    force = laws[0].gain * float(ctrl[published.model.actuator_ctrladr[actuators[0]]])
    return force / (laws[0].stiffness * laws[0].gear) - position


def _is_ctrl_angles(model: mujoco.MjModel, key: int) -> bool:
    """Return True if the values of a keyframe's ctrl count as joint angles, not torques.

    A file with torque motors may contain such a ctrl by mistake.
    """
    at_joint = np.flatnonzero(model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT.value)
    ctrl = model.key_ctrl[key, model.actuator_ctrladr[at_joint]]
    if not ctrl.any():
        return False
    joints = model.actuator_trnid[at_joint, 0]
    gear = read_gears(model, at_joint)
    angles = model.key_qpos[key, model.jnt_qposadr[joints]] * gear
    is_hinge = model.jnt_type[joints] == JointKind.HINGE
    degrees = np.where(is_hinge, np.degrees(angles), angles)
    return any(
        float(np.linalg.norm(ctrl - values)) <= tolerance * float(np.linalg.norm(values))
        for values, tolerance in ((angles, _CTRL_ANGLE_RTOL), (degrees, _CTRL_DEGREE_RTOL))
    )
