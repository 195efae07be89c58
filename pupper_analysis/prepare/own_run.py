"""What a robot's file does by itself, before anything that was changed on loading is believed.

From its own keyframe, exactly as MuJoCo's reset leaves it, for some seconds, nudged. Made when a
verdict is first asked for.
"""

from __future__ import annotations

import copy
from dataclasses import asdict, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.models.mjcf import silence_mujoco
from pupper_analysis.models.transmission import Drive, drives_of, law_of
from pupper_analysis.prepare.bare import (
    Bare,
    Hold,
    has_few_servos,
    hold_of,
    imported_model,
    place_held,
    place_published,
    published_model,
    self_controlled,
    simulate_published,
    with_unstated_options,
)
from pupper_analysis.prepare.servo_tuning import FINER
from pupper_analysis.prepare.start import stands_at
from pupper_analysis.robot.as_published import (
    GIVES_WAY,
    JointOff,
    OwnCommands,
    OwnRun,
)
from pupper_analysis.robot.fall import held_motion, nudge_velocity, own_motion
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]

ALIKE = 0.1
"""Of a keyframe's angles: a ctrl that is off by less, leads for the weight, is of angles. Torques
of as many joints are not by chance."""


NOTHING = (np.zeros(0, dtype=np.intp), np.zeros(0), np.zeros(0), np.zeros(0), np.zeros(0))
"""No joints that a law from outside holds; see ``Hold``."""

_WHILE = 2.0
"""s in which what stands has come to rest."""

_STILL = 5e-3
"""Speed of what has (m/s, rad/s): feet that part creep by 1e-3 (ANYmal B's), what shakes goes to
and fro by 2e-2 or more."""


def as_loaded(robot: Robot) -> Robot:
    """Returns the robot as its files have it, of one that may have been changed since.

    And without the contacts of a task: of the parts that are welded nothing else would carry.
    """
    published = robot.published
    loaded = robot if published is None or published.loaded is None else published.loaded
    return loaded if loaded.bare is None else loaded.bare


def own_run(robot: Robot) -> OwnRun | None:
    """Returns what a robot's file does by itself, from its keyframe; made once.

    Returns:
        What it does; None of a robot without a file, without feet, or whose file has its base held.
    """
    return as_loaded(robot).once(_own_run)


def raw_model(robot: Robot) -> mujoco.MjModel | None:
    """Returns the file's model, with what every robot needs to stand; see ``published_model``."""
    if robot.published is None:
        return None
    if robot.published.as_prepared:
        return robot.mj_model
    if robot.published.file is None:
        found = robot.once(_imported)
        model = None if isinstance(found, Diagnostic) else found
    else:
        model = published_model(robot.published.file, robot)
    if model is not None and robot.published.options:
        model = copy.copy(model)
        for name, value in robot.published.options:
            setattr(model.opt, name, value)
    return model


def import_refused(robot: Robot) -> tuple[Diagnostic, ...]:
    """Tells why MuJoCo does not import a robot's URDF, if it does not."""
    found = as_loaded(robot).once(_imported)
    return (diagnose("own-import-refused", problem=found),) if isinstance(found, Diagnostic) else ()


def _imported(robot: Robot) -> mujoco.MjModel | Diagnostic | None:
    """Returns what MuJoCo makes of a URDF that is alone, or why it refuses it."""
    if robot.published is None or robot.published.imported is None:
        return None
    try:
        model = imported_model(robot.published.imported, robot)
    except ModelError as error:
        return error.cause
    # Servos and time step were chosen for shapes that may be others: the step is as short as the
    # file's own shapes need, of which MuJoCo's contact may have more points.
    step = float(model.opt.timestep)
    for parts in FINER if robot.floating and robot.feet else ():
        model.opt.timestep = step / parts
        if rests_by_itself(model, robot, robot.home):
            return model
    model.opt.timestep = step
    return model


def rests_by_itself(model: mujoco.MjModel, robot: Robot, qpos: Array) -> bool:
    """Tells whether a file, held at the angles of a stand (nq,), is still in a while."""
    bare = with_unstated_options(Bare.of(model, robot), robot)
    model = bare.model
    data = place_published(bare, robot, qpos)
    if data is None:
        return False
    data.qvel[:] = nudge_velocity(model)
    hold = hold_of(bare, robot, data, None, data.qpos[joint_places(bare, robot)])
    simulate_published(bare, data, hold, _WHILE)
    return bool(np.abs(data.qvel).max() < _STILL)


def _own_run(robot: Robot) -> OwnRun | None:
    if not robot.floating or not robot.feet or robot.published is None:
        return None
    model = robot.once(raw_model)
    if model is None:
        return None
    return own_run_of(Bare.of(model, robot), robot)


def own_run_of(bare: Bare, robot: Robot) -> OwnRun | None:
    """Returns what a robot's file does by itself, of a copy in which something may be changed."""
    if robot.published is None or not bare.floating:
        return None
    name = _keyframe(bare.model, robot, robot.published.keyframe)
    return _from_stand(bare, robot) if name is None else _from_keyframe(bare, robot, name)


def _keyframe(model: mujoco.MjModel, robot: Robot, wanted: str | None) -> int | None:
    """Returns the keyframe to begin in: the wanted one, or one in which it stands, or ``home``."""
    names = [_name_of(model, key) for key in range(model.nkey)]
    if wanted is not None:
        return names.index(wanted) if wanted in names else None
    joints = [model.joint(name).id for name in robot.joint_names]
    places = model.jnt_qposadr[joints]
    ranks = {}
    for key, name in enumerate(names):
        values = dict(zip(robot.joint_names, model.key_qpos[key, places].tolist(), strict=True))
        ranks[key] = (not stands_at(robot, values), name != "home")
    return min(ranks, key=ranks.__getitem__, default=None)


@silence_mujoco()
def _from_keyframe(bare: Bare, robot: Robot, key: int) -> OwnRun:
    """Simulates a file from a keyframe as a reset leaves it, and held at its angles."""
    model, data = bare.model, mujoco.MjData(bare.model)
    mujoco.mj_resetDataKeyframe(model, data, key)
    stated = bool(model.key_ctrl[key].any()) or states_ctrl(robot, key)
    limp = has_few_servos(bare)
    run = run_alone(bare, robot, data, Hold(data.ctrl.copy(), data.act.copy(), NOTHING, {}))
    run = replace(
        run,
        keyframe=_name_of(model, key),
        commands=OwnCommands.STATED if stated else OwnCommands.ABSENT,
        limp=limp and not _commands_angles(model, key),
    )
    if stated or limp or self_controlled(bare, robot):
        return run
    return replace(run, held=replace(_at_angles(bare, robot, data), keyframe=run.keyframe))


def _at_angles(bare: Bare, robot: Robot, data: mujoco.MjData) -> OwnRun:
    """Simulates a file from some data on, its servos told their angles."""
    pose = data.qpos[joint_places(bare, robot)].copy()
    run = run_alone(bare, robot, data, hold_of_angles(bare, robot, data, pose))
    return replace(run, commands=OwnCommands.ANGLES)


def states_ctrl(robot: Robot, key: int) -> bool:
    """Tells whether the XML of a keyframe states its ctrl: zeros are stated as well as absent."""
    assert robot.published is not None
    file = robot.published.file
    keys = (robot.description.mjcf if file is None else file.spec).keys
    return key < len(keys) and len(keys[key].ctrl) > 0


@silence_mujoco()
def _from_stand(bare: Bare, robot: Robot) -> OwnRun | None:
    """Simulates a file that has no keyframe from the nominal stand, held at its angles."""
    bare = with_unstated_options(bare, robot)
    data = place_published(bare, robot, robot.home)
    if data is None or bare.ground is None or self_controlled(bare, robot):
        return None
    return _at_angles(bare, robot, data)


def hold_of_angles(bare: Bare, robot: Robot, data: mujoco.MjData, pose: Array) -> Hold:
    """Returns what holds a pose: its servos are commanded it.

    Servos that were added help where most joints have none; a motor among servos holds nothing.
    """
    hold = hold_of(bare, robot, data, None, pose)
    return hold if has_few_servos(bare) else replace(hold, outside=NOTHING, motors={})


def joint_places(bare: Bare, robot: Robot) -> NDArray[np.intp]:
    """Returns where the robot's joints are in the file's qpos."""
    joints = [bare.model.joint(joint).id for joint in robot.joint_names]
    return np.asarray(bare.model.jnt_qposadr[joints])


_THERE = 1e-6
"""A posture that is so near to a keyframe's is its (rad, m)."""


def own_run_held(robot: Robot, joints: Array) -> OwnRun | None:
    """Returns what the file of a robot whose base is held does by itself in a posture (nu,).

    With a keyframe's ctrl where it is that keyframe's posture, and the XML states one; else with
    its servos told the posture.

    Returns:
        What it does; None where its base is free in the file, or commands of its own control it.
    """
    model = None if robot.floating else robot.once(raw_model)
    if model is None:
        return None
    bare = Bare.of(model, robot)
    if bare.floating or self_controlled(bare, robot):
        return None
    for key, qpos in enumerate(model.key_qpos):
        off = np.abs(qpos[joint_places(bare, robot)] - joints)
        if off.max(initial=0.0) < _THERE and states_ctrl(robot, key):
            run = _from_keyframe(bare, robot, key)
            break
    else:
        run = _at_angles(bare, robot, place_held(bare, robot, joints))
    return replace(run, limp=has_few_servos(bare))


def _name_of(model: mujoco.MjModel, key: int) -> str:
    return model.key(key).name or f"keyframe {key + 1}"


def run_alone(bare: Bare, robot: Robot, data: mujoco.MjData, hold: Hold) -> OwnRun:
    """Simulates a file from some data on, told something; neither knows of a keyframe."""
    start = copy.copy(data)
    start.ctrl[:], start.act[:] = hold.ctrl, hold.act
    places = joint_places(bare, robot)

    def advance(run: mujoco.MjData, time: float) -> None:
        simulate_published(bare, run, hold, time)

    if robot.floating:
        motion, end = own_motion(bare.model, start, bare.base, bare.ground or 0.0, advance)
    else:
        motion, end = held_motion(bare.model, start, advance)
    off = end.qpos[places] - start.qpos[places]
    imported = robot.published is not None and robot.published.imported is not None
    joints = [
        JointOff(
            name,
            float(off[index]),
            bare.drives[index],
            _servo_lead(bare, name, hold.ctrl, float(start.qpos[places[index]])),
        )
        for index, name in enumerate(robot.joint_names)
    ]
    whole = not motion.diverged
    made = {servo.joint for servo in robot.description.made_servos}
    loose = [
        one
        for one in joints
        if one.drive is not Drive.SERVO
        and (one.drive is not Drive.NONE or one.joint in made)  # else it follows others
        and abs(one.off) > GIVES_WAY
    ]
    most = 2 * sum(one.drive is Drive.SERVO for one in joints) > len(joints)
    step = float(bare.model.opt.timestep)
    return OwnRun(
        **asdict(motion),
        imported=imported,
        timestep=step if imported and step < robot.mj_model.opt.timestep else None,
        worst=max(joints, key=_far, default=None) if whole else None,
        unheld=max(loose, key=_far, default=None) if whole and most else None,
        standing=robot.floating,
    )


def _far(joint: JointOff) -> float:
    return abs(joint.off)


def _servo_lead(bare: Bare, joint: str, ctrl: Array, angle: float) -> float | None:
    """Returns a joint's command less its angle; None where it has no one servo.

    By its law at rest: its gain's part of ctrl balances its stiffness's.
    """
    motors = drives_of(bare.model, bare.model.joint(joint).id)
    laws = [law_of(bare.model, motor) for motor in motors]
    if len(motors) != 1 or laws[0].at_joint[0] <= 0:
        return None
    message = laws[0].gain * float(ctrl[bare.model.actuator_ctrladr[motors[0]]])
    return message / (laws[0].stiffness * laws[0].gear) - angle


def _commands_angles(model: mujoco.MjModel, key: int) -> bool:
    """Tells whether a keyframe's ctrl are its joints' angles: of servos, whatever it has."""
    hinged = model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT.value
    places = model.jnt_qposadr[model.actuator_trnid[hinged, 0]]
    angles = model.key_qpos[key, places] * model.actuator_gear[hinged, 0]
    off = float(np.linalg.norm(model.key_ctrl[key, hinged] - angles))
    return bool(off < ALIKE * float(np.linalg.norm(angles)))
