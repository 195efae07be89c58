"""What a robot's file does as it was published, against what is computed of it.

From the stand that was computed, held there. Made when a verdict is first asked for, as is what
the file does by itself (``own_run``).
"""

from __future__ import annotations

import contextlib
import copy
import math
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.errors import PupperAnalysisError
from pupper_analysis.prepare.bare import (
    Bare,
    hold_of,
    place_published,
    self_controlled,
    simulate_published,
)
from pupper_analysis.prepare.causes import altered_on_loading, candidate_causes, with_line
from pupper_analysis.prepare.own_run import as_loaded, raw_model
from pupper_analysis.robot.as_published import (
    Cause,
    Published,
    PublishedRun,
    ServoSource,
    ServosUsed,
)
from pupper_analysis.robot.fall import body_moved, nudge_velocity
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import own_servos
from pupper_analysis.stance.sag.steady_state import steady_state
from pupper_analysis.stance.soft_ground import solve_stand_on_soft_ground
from pupper_analysis.stance.stand import Stand, solve_stand, stand_statics

Array = NDArray[np.float64]

SETTLING = 1.0
"""Of the run from the computed stand before it is nudged (s): servos of some hertz have come to
rest, and what slides has slid."""

NUDGED = 4.0
"""Of it after the nudge (s), which is forgotten by then or never."""

SAME = 0.01
"""Share of the largest torque within which the file does as predicted: a verified stand's."""

SAME_HEIGHT = 1e-3
"""Share of its height within which the base is where it is predicted (v3: 0.13 mm)."""


def as_published_in(robot: Robot, stand: Stand, servos: ServosUsed) -> Published | None:
    """Returns how the file differs in a stand; in the nominal one where it cannot be told of it.

    That is on other ground than the level one, and of a robot that was changed since it was loaded.

    Args:
        robot: The robot.
        stand: The stand.
        servos: On which it is asked for: if their gains were given, what is wrong with the file's
            does not count.
    """
    bad = any(servo.instead_of.bad for servo in robot.description.made_servos)
    if robot.published is None or (servos.source is ServoSource.GIVEN and bad):
        return None
    if robot.published.file is None:
        return None  # it is what is simulated
    if robot.published.loaded is not None or not stand.task.ground.level:
        return as_loaded(robot).once(published_nominal)
    return _published_in(robot, stand)


def published_nominal(robot: Robot) -> Published | None:
    """Returns how the file differs in the nominal stand; None where there is none."""
    with contextlib.suppress(PupperAnalysisError):
        return _published_in(robot, solve_stand(robot, explain=False))
    return None


def _published_in(robot: Robot, stand: Stand) -> Published | None:
    """Returns how the file differs in a stand, with the lines of what makes it differ."""
    file = None if robot.published is None else robot.published.file
    if not robot.floating or not robot.feet or file is None:
        return None
    model = robot.once(raw_model)
    if model is None:
        return Published((), (Cause("base-held", (robot.mj_base,)),), differs=True)
    found = as_published(Bare.of(model, robot), robot, stand)
    if found is None:
        return None
    return replace(found, causes=tuple(with_line(cause, file) for cause in found.causes))


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
    mujoco.mj_comPos(model, data)
    start = copy.copy(data)
    ahead = wanted.torques if wanted.feedforward else None
    hold = hold_of(bare, robot, data, ahead, wanted.targets)
    simulate_published(bare, data, hold, SETTLING)
    data.qvel[:] += nudge_velocity(model)
    low, high = simulate_published(bare, data, hold, NUDGED)
    joints = [model.joint(name).id for name in robot.joint_names]
    dofs, places = model.jnt_dofadr[joints], model.jnt_qposadr[joints]
    driven = robot.mj_convention.actuator_index >= 0
    off = np.maximum(high[dofs] - wanted.torques, wanted.torques - low[dofs])[driven]
    largest = float(np.abs(wanted.torques).max())
    ground = bare.ground or 0.0
    kept = float(start.subtree_com[bare.base][2]), ground
    motion = body_moved(model, start, data, bare.base, SETTLING + NUDGED, kept)
    lost = motion.height - motion.end_height
    moved = data.qpos[places] - qpos[robot.nq - robot.nu :]
    torque = float(off.max(initial=0.0)) / largest if largest else 0.0
    differs = not (abs(lost) <= SAME_HEIGHT * motion.height and torque <= SAME)
    return PublishedRun(
        feedforward=wanted.feedforward,
        duration=motion.duration,
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
