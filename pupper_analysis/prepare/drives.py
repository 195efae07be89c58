"""Position servos for a robot whose MJCF has torque motors, or none."""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import PupperAnalysisError
from pupper_analysis.models.additions import (
    Addition,
    Options,
    Servo,
)
from pupper_analysis.models.attributes import BY_KIND, UNSTATED
from pupper_analysis.models.mjcf import JointKind
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.spec_tree import SpecTree
from pupper_analysis.models.transmission import Drive, MadeServo, classify_joint_drive
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.models.xml import to_text
from pupper_analysis.prepare import notes, start
from pupper_analysis.prepare.notes import describe_span
from pupper_analysis.prepare.own_run import settles_in_place
from pupper_analysis.prepare.published_model import compile_published_model
from pupper_analysis.prepare.servo_tuning import (
    TIMESTEP_DIVISORS,
    suggest_fixed_base_gains,
    suggest_standing_gains,
)
from pupper_analysis.prepare.touching import copy_visual_option
from pupper_analysis.robot.build import rebuild_robot
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import list_position_servos
from pupper_analysis.simulation.settling import comes_to_rest
from pupper_analysis.simulation.verify import ANOTHER_ROBOT, StandVerification, verify_stand
from pupper_analysis.stance.soft_ground import solve_stand_on_soft_ground
from pupper_analysis.stance.stand import Stand, stand_statics

Array = NDArray[np.float64]

_SAGS = (0.02, 0.05, 0.1)
"""What the suggested stiffness lets the joint that holds most give way in the nominal stand (rad),
the first with which it comes to rest. Stiffer servos hold the shape better, and shake on contacts
that are not as stiff; softer ones let a biped's ankles tip over."""

_LIGHT = 0.25
"""Part of the usual damping that is tried where a file's time step stands: what a step takes of the
speed is bounded, and of a light leg it is all (a random tripod's: at kd 130 N m s/rad it shakes at
2 ms, at 25 not)."""

_SAGS_OF_LIGHT = (0.02, 0.035, 0.05)
"""What ``_SAGS`` is, with so little damping."""

_BRIEF = 2.0
"""Simulated time after which what holds exactly as computed has done so for a second (s)."""


def list_dependent_joints(robot: Robot) -> list[int]:
    """Returns the numbers of the joints that follow others: no servo is theirs."""
    return [] if robot.closure is None else robot.closure.following.tolist()


def add_loop_motors(robot: Robot) -> Robot:
    """Gives joints that have no motor, and follow none, one that does nothing yet.

    Motors come first in the order of joints: where some joints follow others, that order is to be
    the last one before a stand is solved.
    """
    lacking = set(np.flatnonzero(robot.mj_convention.actuator_index < 0)) - set(
        list_dependent_joints(robot)
    )
    if robot.closure is None or not lacking:
        return robot
    spec = robot.description.mjcf.copy()
    for joint in sorted(lacking):
        SpecTree(spec).add_motor(robot.joint_names[joint])
    return rebuild_robot(robot, mjcf=spec)


def add_position_servos(
    robot: Robot, stand: Stand, original: MjcfFile
) -> tuple[Robot, Array, Array, int]:
    """Gives the joints without a position servo one, with which the robot comes to rest in a stand.

    Of those with which it does, the first with which it is then as predicted: light feet on stiff
    servos may come to rest against each other, in friction, with other torques. And of those the
    first with which its MJCF does so too, as it is: at its own time step, on its own shapes.

    Args:
        robot: The robot.
        stand: Its stand.
        original: Its file, which says whether it is compiled with what is only seen.

    Returns:
        The robot, with the stiffest servos tried if it comes to rest with none; the stiffness (nu,)
        (N m/rad) and damping (nu,) (N m s/rad) of all its servos; and in how many ways it comes to
        rest: 2 with feed-forward and without, 1 with feed-forward alone, or 0.
    """
    own = list_position_servos(robot)
    torques = stand_statics(robot, stand).joint_torques
    stated = {limit.joint: limit for limit in robot.efforts}

    def built(parts: int, kp: Array, kd: Array) -> Robot:
        timestep = float(robot.description.mjcf.option.timestep) / parts
        given = robot.description.given(*make_missing_servos(robot, kp, kd, timestep))
        copy_visual_option(given.mjcf, original.spec)
        return rebuild_robot(robot, mjcf=given.mjcf, added=given.added, efforts=stated)

    light = (
        []
        if original.of_urdf
        else list(itertools.product(TIMESTEP_DIVISORS[:1], _SAGS_OF_LIGHT, (_LIGHT,)))
    )
    usual = list(itertools.product(TIMESTEP_DIVISORS, _SAGS, (1.0,)))
    candidates = []
    for parts, sag, part in [*usual[: len(_SAGS)], *light, *usual[len(_SAGS) :]]:
        gains = suggest_standing_gains(robot, stand, torques, sag, parts, part)
        candidates.append((parts, *_kept(robot, own, *gains)))
    file = None if original.of_urdf else compile_published_model(original, robot)

    timestep = float(robot.mj_model.opt.timestep)
    first_tried = robot.description.given(*make_missing_servos(robot, *candidates[0][1:], timestep))
    trial = rebuild_robot(robot, mjcf=first_tried.mjcf, efforts=stated)

    seen: dict[tuple[int, bool], bool] = {}

    def rests(number: int, *, fed: bool) -> bool:
        """Tells whether it comes to rest with a candidate, which is looked at once."""
        parts, kp, kd = candidates[number]
        trial.mj_model.opt.timestep = timestep / parts
        if (number, fed) not in seen:
            seen[number, fed] = comes_to_rest(trial, stand, feedforward=fed, kp=kp, kd=kd)
        return seen[number, fed]

    def first(*directions: bool) -> Iterator[tuple[int, Array, Array]]:
        """Yields the candidates with which it comes to rest, fed forward or not.

        Most that fall do so without feed-forward, within a second or two: that comes first.
        """
        for number, candidate in enumerate(candidates):
            if all(rests(number, fed=way) for way in sorted(directions)):
                yield candidate

    resting = good = None
    for parts, kp, kd in first(False, True):
        if good and parts > 1:
            break  # of the file's step there are no more
        resting = resting or (parts, kp, kd)
        if not _as_predicted(trial, stand, kp, kd):
            continue
        good = good or (parts, kp, kd)
        made = built(parts, kp, kd)
        if parts > 1 or file is None:
            return made, kp, kd, 2
        if settles_in_place(file, _driven(made, kp, kd, original), stand.qpos):
            return made, kp, kd, 2
    fed = None if resting else next(first(True), None)
    parts, kp, kd = good or resting or fed or candidates[0]
    return built(parts, kp, kd), kp, kd, 2 if resting else int(fed is not None)


def add_suggested_servos(robot: Robot, mjcf: MjcfFile) -> tuple[Robot, list[Diagnostic]]:
    """Gives a robot position servos with suggested gains; as if it were held, if it stands nowhere.

    Who asks for a stand of their own then needs none of theirs. Gains are chosen without limits of
    zero, which hold in the robot that is returned.
    """
    made, messages = _with_chosen_servos(_lift_null_efforts(robot), mjcf)
    return _restore_null_efforts(made, robot), messages


def _lift_null_efforts(robot: Robot) -> Robot:
    """Return the robot without torque limits of zero; the robot itself if it has none."""
    null = [limit.joint for limit in robot.efforts if limit.without_torque]
    if not null:
        return robot
    urdf = UrdfTree.of(robot.description.urdf)
    for name in null:
        urdf.joints[name].state(BY_KIND["effort"], UNSTATED)
    return rebuild_robot(robot, urdf=to_text(urdf.root), null_efforts={})


def _restore_null_efforts(made: Robot, robot: Robot) -> Robot:
    """Return a robot with servos and the torque limits of the robot that it was made of."""
    if not any(limit.without_torque for limit in robot.efforts):
        return made
    return rebuild_robot(
        made,
        urdf=robot.description.urdf,
        efforts={limit.joint: limit for limit in robot.efforts},
        null_efforts=robot.description.null_efforts,
    )


def _with_chosen_servos(robot: Robot, mjcf: MjcfFile) -> tuple[Robot, list[Diagnostic]]:
    """Give a robot position servos with suggested gains; see ``add_suggested_servos``."""
    stand = start.solve_nominal_stand(robot)
    if stand is None:
        return add_fixed_base_servos(robot, mjcf)
    built, kp, kd, rests = add_position_servos(robot, stand, mjcf)
    made, messages = _tell_made(robot, built, mjcf, kp, kd)
    if not rests:
        messages.append(diagnose("no-servos-bring-it-to-rest"))
    elif rests == 1:
        messages.append(diagnose("rests-with-feed-forward-alone"))
    return made, messages


def list_fixed_base_gains(robot: Robot) -> tuple[Array, Array]:
    """Return kp and kd of `suggest_fixed_base_gains`, shape (nu,), in actuator order."""
    model = robot.mj_model
    ids = np.array([model.joint(name).id for name in robot.joint_names])
    others = np.flatnonzero(model.jnt_type != JointKind.FREE)  # those that gains are for
    order = np.searchsorted(others, ids)
    kp, kd = suggest_fixed_base_gains(model)
    return kp[order], kd[order]


def add_fixed_base_servos(robot: Robot, mjcf: MjcfFile) -> tuple[Robot, list[Diagnostic]]:
    """Gives a robot whose base is held position servos where it has none."""
    made, messages = _with_held_servos(_lift_null_efforts(robot), mjcf)
    return _restore_null_efforts(made, robot), messages


def _with_held_servos(robot: Robot, mjcf: MjcfFile) -> tuple[Robot, list[Diagnostic]]:
    """Give a robot whose base is held position servos; see ``add_fixed_base_servos``."""
    kp, kd = list_fixed_base_gains(robot)
    timestep = float(robot.mj_model.opt.timestep)
    given = robot.description.given(*make_missing_servos(robot, kp, kd, timestep))
    stated = {limit.joint: limit for limit in robot.efforts}
    built = rebuild_robot(robot, mjcf=given.mjcf, added=given.added, efforts=stated)
    return _tell_made(robot, built, mjcf, kp, kd)


def _tell_made(
    robot: Robot, built: Robot, mjcf: MjcfFile, kp: Array, kd: Array
) -> tuple[Robot, list[Diagnostic]]:
    """Returns the robot with servos, which knows them, and tells which were made up.

    Args:
        robot: The robot without.
        built: The same with servos.
        mjcf: Its file.
        kp: (nu,) their stiffness (N m/rad).
        kd: (nu,) their damping (N m s/rad).
    """
    known = _driven(built, kp, kd, mjcf)
    made = known.description.made_servos
    own = robot.nu - len(made) - len(list_dependent_joints(robot))
    return known, [*notes.report_added_servos(made, own, built.mj_model.opt.timestep)]


def _driven(built: Robot, kp: Array, kd: Array, mjcf: MjcfFile) -> Robot:
    """Returns a robot with servos that were added to its file, which knows them."""
    added = {each.joint for each in built.description.added if isinstance(each, Servo)}
    made = []
    for index, name in enumerate(built.joint_names):
        if name in added:
            joint = mujoco.mj_name2id(mjcf.model, mujoco.mjtObj.mjOBJ_JOINT, name)
            what = Drive.NONE if joint < 0 else classify_joint_drive(mjcf.model, joint)
            made.append(MadeServo(name, float(kp[index]), float(kd[index]), what))
    described = replace(built.description, made_servos=tuple(made))
    return replace(built, description=described)


def _kept(
    robot: Robot, own: Mapping[str, tuple[float, float]], kp: Array, kd: Array
) -> tuple[Array, Array]:
    """Returns gains (nu,) with those of the robot's own servos in them."""
    given = zip(robot.joint_names, kp.tolist(), kd.tolist(), strict=True)
    both = np.array([own.get(name, (stiffness, damping)) for name, stiffness, damping in given])
    both[list_dependent_joints(robot)] = 0.0
    return both[:, 0], both[:, 1]


def _as_predicted(robot: Robot, stand: Stand, kp: Array, kd: Array) -> bool:
    """Tells whether a robot holds a stand on its servos as computed, as far as gains matter.

    It is known to come to rest: what it settles at mostly tells after two seconds, and otherwise
    after as long as any stand is given.
    """
    with contextlib.suppress(PupperAnalysisError):
        stand = solve_stand_on_soft_ground(robot, stand, explain=False)
    brief = verify_stand(robot, stand, kp=kp, kd=kd, duration=_BRIEF, nudged=0.0)
    if brief.passed or _another(robot, brief):
        return True
    return verify_stand(robot, stand, kp=kp, kd=kd).passed


def _another(robot: Robot, seen: StandVerification) -> bool:
    """Tells whether the two files are not of one robot: then no gains make them stand alike."""
    weight = robot.weight
    return seen.mujoco_residual > ANOTHER_ROBOT * weight


def make_missing_servos(
    robot: Robot,
    kp: Array,
    kd: Array,
    timestep: float,
    own: Collection[str] | None = None,
) -> list[Addition]:
    """Returns what gives every joint without a position servo one, whose limit is the motor's.

    The integrator is ``implicitfast``, with which a servo's damping does not shake light joints.

    Args:
        robot: The robot.
        kp: (nu,) stiffness (N m/rad); of joints with a servo nothing is used.
        kd: (nu,) damping (N m s/rad), likewise.
        timestep: s.
        own: Joints that have one; by default those with a servo in the robot's model.
    """
    idle = {robot.joint_names[joint] for joint in list_dependent_joints(robot)}
    left = {*(list_position_servos(robot) if own is None else own), *idle}
    missing = [index for index, name in enumerate(robot.joint_names) if name not in left]
    stiffness = describe_span(kp[missing], "N m/rad")
    message = diagnose(
        "servos-made",
        kp=stiffness,
        kd=describe_span(kd[missing], "N m s/rad"),
        timestep=Quantity(timestep, "s"),
    )
    made: list[Addition] = [
        Options(message, {"integrator": "implicitfast", "timestep": timestep}),
    ]
    for index in missing:
        limit = robot.efforts[index]
        # A range from 0 to 0 does not compile; the simulation applies it to the compiled model.
        bounded = math.isfinite(limit.lower) and limit.lower < limit.upper < math.inf
        limits = (limit.lower, limit.upper) if bounded else None
        name = robot.joint_names[index]
        made.append(Servo(message, name, float(kp[index]), float(kd[index]), limits))
    return made
