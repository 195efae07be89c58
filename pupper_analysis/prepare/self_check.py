"""What the MJCF does by itself, before anything that was changed on loading is believed.

From its own keyframe, on its own actuators (``own_run``); and from the stand that was computed,
held there, against the prediction (``as_published``). One short run each: less than the load costs.
"""

from __future__ import annotations

import contextlib
import copy
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.errors import PupperAnalysisError
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.transmission import Drive
from pupper_analysis.prepare.bare import (
    Bare,
    Hold,
    hold_of,
    place_published,
    published_model,
    self_controlled,
    simulate_published,
)
from pupper_analysis.prepare.causes import altered_on_loading, candidate_causes, with_line
from pupper_analysis.prepare.start import stands_at
from pupper_analysis.robot.as_published import (
    Cause,
    OwnRun,
    Published,
    PublishedRun,
    ServoSource,
    ServosUsed,
)
from pupper_analysis.robot.fall import (
    base_motion,
    base_moved,
)
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import own_servos
from pupper_analysis.stance.sag.steady_state import steady_state
from pupper_analysis.stance.soft_ground import solve_stand_on_soft_ground
from pupper_analysis.stance.stand import Stand, solve_stand, stand_statics

Array = NDArray[np.float64]

SECONDS = 1.0
"""Of the run from the computed stand (s): servos of some hertz have come to rest, and what slides
has slid."""

SAME = 0.01
"""Share of the largest torque within which the file does as predicted: a verified stand's."""

ALIKE = 0.1
"""Of a keyframe's angles: a ctrl that is off by less, leads for the weight, is of angles. Torques
of as many joints are not by chance."""

SAME_HEIGHT = 1e-3
"""Share of its height within which the base is where it is predicted (v3: 0.13 mm)."""


def self_checked(robot: Robot, mjcf: MjcfFile, keyframe: str | None) -> Robot:
    """Returns a robot that knows what its MJCF does as it was published.

    Args:
        robot: The robot, with feet and a free base.
        mjcf: Its file.
        keyframe: The one that was asked for.
    """
    if not robot.floating or not robot.feet:
        return robot
    model = published_model(mjcf, robot)
    if model is None:
        held = Published((), (Cause("base-held", (robot.mj_base,)),), differs=True)
        return replace(robot, published=held)
    bare = Bare.of(model, robot)
    published = None
    with contextlib.suppress(PupperAnalysisError):
        published = as_published(bare, robot, solve_stand(robot, explain=False))
    if published is not None:
        causes = tuple(with_line(cause, mjcf) for cause in published.causes)
        published = replace(published, causes=causes)
    own = own_run(bare, robot, _keyframes(model, robot, keyframe))
    return replace(robot, own_run=own, published=published, published_model=model)


def as_published_in(robot: Robot, stand: Stand, servos: ServosUsed) -> Published | None:
    """Returns how the MJCF differs in a stand; in the nominal one where it cannot be told of it.

    That is on other ground than the level one, and of a robot that was changed since it was loaded.

    Args:
        robot: The robot.
        stand: The stand.
        servos: On which it is asked for: if their gains were given, what is wrong with the MJCF's
            does not count.
    """
    bad = any(servo.instead_of.bad for servo in robot.description.made_servos)
    if servos.source is ServoSource.GIVEN and bad:
        return None
    if robot.published_model is None or not stand.task.ground.level:
        return robot.published
    known = {} if robot.published is None else {one.code: one for one in robot.published.causes}
    found = as_published(Bare.of(robot.published_model, robot), robot, stand)
    if found is None:
        return robot.published
    causes = tuple(known.get(cause.code, cause) for cause in found.causes)
    return replace(found, causes=causes)


def _keyframes(model: mujoco.MjModel, robot: Robot, wanted: str | None) -> list[str]:
    """Returns the keyframes to take one of: the wanted one, or those in which it stands first."""
    if wanted is not None:
        return [wanted]
    joints = [model.joint(name).id for name in robot.joint_names]
    places = model.jnt_qposadr[joints]
    ranks = {}
    for key in range(model.nkey):
        name = model.key(key).name or f"keyframe {key + 1}"
        values = dict(zip(robot.joint_names, model.key_qpos[key, places].tolist(), strict=True))
        ranks[name] = (not stands_at(robot, values), name != "home")
    return sorted(ranks, key=ranks.__getitem__)


def own_run(bare: Bare, robot: Robot, keyframes: Sequence[str]) -> OwnRun | None:
    """Simulates the MJCF from its keyframe, with its own actuators and ctrl.

    Args:
        bare: The MJCF as it was published.
        robot: The robot.
        keyframes: Of those of these that it has, the first is taken.

    Returns:
        What it does; None if it has no keyframe, no free base, or no servos at most joints: motors
        that nothing controls let all fall. Unless the keyframe commands them angles.
    """
    model = bare.model
    names = {model.key(key).name or f"keyframe {key + 1}": key for key in range(model.nkey)}
    name = next((name for name in keyframes if name in names), None)
    holding = sum(drive not in (Drive.MOTOR, Drive.NONE) for drive in bare.drives)
    if name is None or not bare.floating:
        return None
    if 2 * holding < len(bare.drives) and not _commands_angles(model, names[name]):
        return None
    key, data = names[name], mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, key)
    mujoco.mj_kinematics(model, data)
    places = [int(model.jnt_qposadr[model.joint(joint).id]) for joint in robot.joint_names]
    pose = data.qpos[places].copy()
    hold = hold_of(bare, robot, data, None, pose)
    own_ctrl = bool(model.key_ctrl[key].any())
    if not own_ctrl and self_controlled(bare, robot):
        return None
    if own_ctrl:
        nothing = np.zeros(0)
        outside = (nothing.astype(int), nothing, nothing, nothing, nothing)
        hold = Hold(model.key_ctrl[key].copy(), model.key_act[key].copy(), outside, {})
    data.ctrl[:], data.act[:] = hold.ctrl, hold.act
    motion, end = base_motion(
        model,
        data,
        bare.base,
        bare.ground or 0.0,
        lambda run, time: simulate_published(bare, run, hold, time),
    )
    return OwnRun(
        keyframe=name,
        own_ctrl=own_ctrl,
        **asdict(motion),
        collapses=motion.collapses,
        joint_error=float(np.abs(end.qpos[places] - pose).max()),
    )


def _commands_angles(model: mujoco.MjModel, key: int) -> bool:
    """Tells whether a keyframe's ctrl are its joints' angles: of servos, whatever it has."""
    hinged = model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT.value
    places = model.jnt_qposadr[model.actuator_trnid[hinged, 0]]
    angles = model.key_qpos[key, places] * model.actuator_gear[hinged, 0]
    off = float(np.linalg.norm(model.key_ctrl[key, hinged] - angles))
    return bool(off < ALIKE * float(np.linalg.norm(angles)))


def as_published(bare: Bare, robot: Robot, stand: Stand) -> Published | None:
    """Simulates the MJCF as it was published from a stand, and finds what makes it differ.

    Args:
        bare: The MJCF as it was published.
        robot: The robot.
        stand: The stand, on level ground.

    Returns:
        What comes of it; None if nothing is predicted of the stand.
    """
    wanted = predict_stand(robot, stand)
    if not wanted:
        return None
    if not bare.floating:
        return Published((), (Cause("base-held", (robot.mj_base,)),), differs=True)
    if controlled := self_controlled(bare, robot):
        return Published((), (Cause("other-drive", controlled),), differs=True)
    if bare.ground is None:
        return Published((), (Cause("ground", ()),), differs=True)
    found = [(one, run_as_published(bare, robot, one)) for one in wanted]
    runs = tuple(run for _, run in found if run is not None)
    off = [(one, run) for one, run in found if run is not None and run.differs]
    causes: tuple[Cause, ...] = ()
    if off:
        causes = causes_of(bare, robot, *off[0]) or _of_the_pair(robot, *off[0])
    return Published(runs, causes, differs=bool(off))


def _of_the_pair(robot: Robot, wanted: Predicted, run: PublishedRun) -> tuple[Cause, ...]:
    """Returns that the two files differ, if what was computed of the MJCF is as far off.

    The prediction is the URDF's.
    """
    computed = run_as_published(Bare.of(copy.copy(robot.mj_model), robot), robot, wanted)
    if computed is None or abs(computed.torque_error - run.torque_error) > SAME:
        return ()
    return (Cause("pair", ()),)


@dataclass(frozen=True, eq=False)
class Predicted:
    """What a stand is predicted to be at rest.

    Attributes:
        feedforward: Whether its servos are told its torques, too.
        qpos: (nq,) where it rests, sunk into the ground.
        torques: (nu,) N m.
        targets: (nu,) the positions that are commanded (rad).
    """

    feedforward: bool
    qpos: Array
    torques: Array
    targets: Array


def predict_stand(robot: Robot, stand: Stand) -> list[Predicted]:
    """Returns what is predicted of a stand, with feed-forward and on position commands alone."""
    try:
        held = solve_stand_on_soft_ground(robot, stand, explain=False)
    except PupperAnalysisError:
        return []  # where it comes to rest is not predicted
    torques = stand_statics(robot, held).joint_torques
    found = [Predicted(True, held.qpos, torques, held.joint_positions(robot))]
    if len(own_servos(robot)) < robot.nu:
        return found
    with contextlib.suppress(PupperAnalysisError):
        # Feet that are predicted pinned creep, by fractions of a millimetre, to where these are.
        rest = steady_state(robot, held, feet="sliding")
        if not rest.failures:
            targets = held.joint_positions(robot)
            found.append(Predicted(False, rest.qpos, rest.joint_torques, targets))
    return found


def run_as_published(bare: Bare, robot: Robot, wanted: Predicted) -> PublishedRun | None:
    """Simulates the MJCF from where it is predicted to rest, and compares.

    Returns:
        What comes of it; None if its base cannot be put there, as where it is held in the world.
    """
    model = bare.model
    qpos = wanted.qpos
    data = place_published(bare, robot, qpos)
    if data is None:
        return None
    mujoco.mj_kinematics(model, data)
    start = copy.copy(data)
    ahead = wanted.torques if wanted.feedforward else None
    hold = hold_of(bare, robot, data, ahead, wanted.targets)
    given = simulate_published(bare, data, hold, SECONDS)
    joints = [model.joint(name).id for name in robot.joint_names]
    dofs, places = model.jnt_dofadr[joints], model.jnt_qposadr[joints]
    driven = robot.mj_convention.actuator_index >= 0
    off = np.abs(given[dofs] - wanted.torques)[driven]
    largest = float(np.abs(wanted.torques).max())
    motion = base_moved(model, start, data, bare.base, bare.ground or 0.0, SECONDS)
    lost = motion.height - motion.end_height
    moved = data.qpos[places] - qpos[robot.nq - robot.nu :]
    torque = float(off.max(initial=0.0)) / largest if largest else 0.0
    differs = not (abs(lost) <= SAME_HEIGHT * motion.height and torque <= SAME)
    return PublishedRun(
        feedforward=wanted.feedforward,
        duration=SECONDS,
        torque_error=torque,
        height_error=-lost,
        joint_error=float(np.abs(moved).max()),
        collapses=motion.collapses,
        differs=motion.collapses or differs,
    )


def causes_of(bare: Bare, robot: Robot, wanted: Predicted, run: PublishedRun) -> tuple[Cause, ...]:
    """Finds what makes the MJCF differ: by switching off, in copies, what may.

    One alone if that makes it as predicted; else, with all of them off, each that alone makes it
    differ again.
    """
    known = candidate_causes(bare, robot)
    without = {}
    for candidate in known:
        model = copy.copy(bare.model)
        candidate.switch_off(model)
        seen = run_as_published(replace(bare, model=model), robot, wanted)
        without[candidate] = math.inf if seen is None else seen.torque_error
        if seen is not None and not seen.differs:
            return (candidate.cause(seen.torque_error),)
    all_off = copy.copy(bare.model)
    for candidate in known:
        candidate.switch_off(all_off)
    best = run_as_published(replace(bare, model=all_off), robot, wanted)
    found = []
    for candidate in known if best is not None and not best.differs else ():
        model = copy.copy(bare.model)
        for other in known:
            if other is not candidate:
                other.switch_off(model)
        seen = run_as_published(replace(bare, model=model), robot, wanted)
        if seen is None or seen.differs:
            found.append(candidate.cause(without[candidate]))
    if found:
        return tuple(found)
    helping = [one for one in known if without[one] < 0.5 * run.torque_error]
    return (*(one.cause(without[one]) for one in helping), *altered_on_loading(bare, robot))
