"""Loads a robot from its two files, as they are, or made ready in memory."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.arguments import checked
from pupper_analysis.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.errors import ConfigurationError, ModelError
from pupper_analysis.matching.match import match
from pupper_analysis.matching.mimics import urdf_mimics
from pupper_analysis.matching.mjcf import name_all
from pupper_analysis.models.description import Description
from pupper_analysis.models.joint_drives import Drive, MadeServo, drive_of
from pupper_analysis.models.joint_kinds import JointKind
from pupper_analysis.models.mjcf import quiet
from pupper_analysis.models.mjcf_file import MjcfFile, read_mjcf
from pupper_analysis.models.urdf_file import UrdfFile, read_urdf
from pupper_analysis.prepare import drives, notes, start, touching
from pupper_analysis.prepare.base import free_base, free_of_friction
from pupper_analysis.prepare.base_frame import lift_base_frame
from pupper_analysis.prepare.feet import (
    Foot,
    apart_at,
    find_feet,
    named_foot,
    with_feet,
)
from pupper_analysis.prepare.limits import bounded, within_both
from pupper_analysis.prepare.mimics import coupled
from pupper_analysis.prepare.motors import one_at_each_joint, several
from pupper_analysis.prepare.parts import with_parts
from pupper_analysis.prepare.self_check import self_checked
from pupper_analysis.prepare.simulable import check_masses, check_simulable
from pupper_analysis.prepare.solver import inexact, solvable
from pupper_analysis.prepare.start_pose import started
from pupper_analysis.robot.build import build_robot
from pupper_analysis.robot.feet import limb_ends
from pupper_analysis.robot.floor import level_ground
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import own_servos

Array = NDArray[np.float64]

_FREE_IN_PARTS = 4
"""Joints of a base that is free by three slides and a ball joint, or more."""

_APART = 2e-3
"""Joints whose axes are further apart are not rounded, but different (m)."""

Feet = Sequence[str] | Mapping[str, str | tuple[str, str]]


@checked
@quiet()
def load_robot(
    *,
    urdf: str | Path,
    mjcf: str | Path,
    feet: Feet | None = None,
    fixed_base: bool = False,
    name: str | None = None,
    joints: Mapping[str, str] | None = None,
    keyframe: str | None = None,
    packages: Mapping[str, str | Path] | None = None,
    self_check: bool = True,
    as_is: bool = False,
) -> Robot:
    """Loads a robot from a URDF and an MJCF, as they were published.

    What the files lack is made up for in memory, and each such thing is said in ``notes``: joints
    whose names differ are matched, those that only one file has are held at zero, a floor, a free
    base and position servos are added, and where the MJCF has no keyframe in which the robot
    stands, a stand is looked for.

    Args:
        urdf: Path of the URDF.
        mjcf: Path of the MJCF.
        feet: The feet's frames, or {foot: its frame}; a frame is a link of the URDF, or a geom,
            site or body of the MJCF, or a pair of both. By default the feet are the collision geoms
            at the ends of the limbs that are lowest in the start pose; an empty list: no feet.
        fixed_base: Fix the base in the world, at the pose that the MJCF gives it.
        name: The robot's name; by default the MJCF's.
        joints: {joint in the URDF: joint in the MJCF}, of those that are not matched by name.
        keyframe: The MJCF's keyframe to start from; by default ``home``, or another in which the
            robot stands.
        packages: {ROS package: its folder}, for ``package://`` paths of the URDF.
        self_check: Simulate the MJCF as it was published, too: from its own keyframe on its own
            actuators (``own_run``), and from the nominal stand, against the prediction
            (``published``). It takes less than the rest.
        as_is: Add no servos, and alter no shapes: what the file has is to hold the robot.

    Returns:
        The robot.

    Raises:
        ConfigurationError: If an argument is of another kind.
        ModelError: If a file cannot be read, the two have no joints in common, or no feet are
            found.
        UnknownNameError: If a foot, joint or keyframe is not there; the message lists what is.
    """
    folders = {name: Path(folder) for name, folder in (packages or {}).items()}
    return robot_of(
        read_urdf(urdf, folders),
        read_mjcf(mjcf),
        feet=feet,
        fixed_base=fixed_base,
        name=name,
        joints=joints,
        keyframe=keyframe,
        self_check=self_check,
        as_is=as_is,
    )


def robot_of(
    urdf: UrdfFile,
    mjcf: MjcfFile,
    *,
    feet: Feet | None = None,
    fixed_base: bool = False,
    name: str | None = None,
    joints: Mapping[str, str] | None = None,
    keyframe: str | None = None,
    self_check: bool = True,
    as_is: bool = False,
) -> Robot:
    """Makes a robot of two files that have been read; see ``load_robot``."""
    files = urdf, mjcf
    check_simulable(mjcf)
    frames = None if feet is None else _frames(feet)
    if frames is not None and not joints and keyframe is None:
        robot = _as_it_is(*files, frames, fixed_base=fixed_base, name=name)
    else:
        robot = None
    if robot is None:
        prepared = partial(
            _prepared, *files, frames, name=name, joints=joints, keyframe=keyframe, as_is=as_is
        )
        robot = prepared(fixed_base=True) if fixed_base else _free_if_it_stands(mjcf, prepared)
    return self_checked(robot, mjcf, keyframe) if self_check else robot


def _frames(feet: Feet) -> dict[str, tuple[str, str]]:
    """Returns {foot: its frames in URDF and MJCF}.

    Raises:
        ConfigurationError: If a frame is neither a name nor a pair of names, or named twice.
    """
    named = dict(feet) if isinstance(feet, Mapping) else {foot: foot for foot in feet}
    if len(named) < len(feet):
        raise ConfigurationError("feet", diagnose("feet-named-twice", feet=map(str, feet)))
    frames = {}
    for foot, frame in named.items():
        pair = (frame, frame) if isinstance(frame, str) else tuple(np.atleast_1d(frame).tolist())
        if len(pair) != 2 or not all(isinstance(name, str) for name in pair):
            problem = diagnose("foot-frame-not-valid", subject=("foot", foot), frame=repr(frame))
            raise ConfigurationError("feet", problem)
        frames[foot] = (str(pair[0]), str(pair[1]))
    return frames


def _as_it_is(
    urdf: UrdfFile,
    mjcf: MjcfFile,
    feet: Mapping[str, tuple[str, str]],
    *,
    fixed_base: bool,
    name: str | None,
) -> Robot | None:
    """Builds the robot if both files are ready: the same joints, and the feet's frames in both."""
    tree = urdf.tree
    moving = {
        joint.name for joint in tree.joints.values() if joint.kind not in ("fixed", "floating")
    }
    spec = mjcf.spec
    places = {element.name for element in (*spec.sites, *spec.bodies, *spec.geoms)}
    hinges = {j.name for j in spec.joints if j.type != JointKind.FREE}
    known = all(one in tree.links and other in places for one, other in feet.values())
    free = sum(joint.type == JointKind.FREE for joint in spec.joints)
    if moving != hinges or not known or free > 1:
        return None  # beside the robot, something else lies in the scene
    if free and not fixed_base and _ground_to_mend(spec):
        return None
    if urdf_mimics(urdf.root) and not fixed_base:
        return None  # which the MJCF may not state
    description = Description(
        name=name or spec.modelname,
        urdf=urdf.text,
        urdf_source=urdf.path,
        mjcf=spec,
        mjcf_source=mjcf.path,
        feet=feet,
    )
    try:
        robot = build_robot(description, fixed_base=fixed_base)
    except ModelError:
        if fixed_base or not all(
            other in {body.name for body in spec.bodies} for _, other in feet.values()
        ):
            raise
        return None  # a body that is named for its sole, which is no sphere around its frame
    if robot.floating and robot.closure is not None and robot.pin_convention.unbounded.any():
        return None  # joints that turn round and round, which are given limits
    if robot.floating and (several(robot.mj_model) or inexact(robot) is not None):
        return None
    said = (*notes.bound(robot), *notes.uncommanded(robot))
    return replace(robot, notes=(*urdf.notes, *mjcf.notes, *said, *robot.notes))


def _free_if_it_stands(mjcf: MjcfFile, prepared: Callable[..., Robot]) -> Robot:
    """Returns a robot with a free base; with its base as published where that is held, as a hand's.

    Args:
        mjcf: Its file.
        prepared: Makes it, with ``fixed_base`` or without.

    Raises:
        ModelError: If it can be made neither way.
    """
    tops = [len(list(body.joints)) for body in mjcf.spec.worldbody.bodies]
    kinds = {joint.type for joint in mjcf.spec.joints}
    held = JointKind.FREE not in kinds and max(tops, default=0) < _FREE_IN_PARTS
    try:
        robot = prepared(fixed_base=False)
    except ModelError as error:
        if not held:
            raise
        with contextlib.suppress(ModelError):
            return _kept_in_the_world(prepared, error.cause)
        raise
    if held and robot.floating and start.first_stand(robot) is None:
        return _kept_in_the_world(prepared, diagnose("stands-on-no-feet"))
    return robot


def _kept_in_the_world(prepared: Callable[..., Robot], why: Diagnostic) -> Robot:
    """Returns a robot with its base where the MJCF has it, and tells why."""
    robot = prepared(fixed_base=True)
    return replace(robot, notes=(*robot.notes, diagnose("base-kept-in-the-world", why=why)))


def _ground_to_mend(spec: mujoco.MjSpec) -> bool:
    """Tells whether there is a ground, but not a level one at z = 0 with nothing else on it.

    Or a base that hangs by its free joint's friction.
    """
    mine = spec.copy()
    changed = [*level_ground(mine), *free_of_friction(mine)]
    return any(change.code != "ground-added" for change in changed)


def _prepared(
    urdf: UrdfFile,
    mjcf: MjcfFile,
    frames: Mapping[str, tuple[str, str]] | None,
    *,
    fixed_base: bool,
    name: str | None,
    joints: Mapping[str, str] | None,
    keyframe: str | None,
    as_is: bool,
) -> Robot:
    """Builds the robot from files that may not be ready."""
    spec = mjcf.spec.copy()
    name_all(spec, set())
    known = start.chosen(mjcf, start.keyframes(spec), keyframe)
    told: list[Diagnostic] = []
    if not fixed_base:
        spec, told = free_base(urdf, spec)
        told += lift_base_frame(spec)
    matched = match(urdf, replace(mjcf, spec=spec), names=joints, complete=True)
    whole, weighed = with_parts(matched, spec)
    named = replace(whole or matched.robot.description, name=name or spec.modelname)
    description, bound = coupled(matched, named)
    told += [*matched.notes, *notes.joints(matched), *weighed, *bound]
    if fixed_base or not matched.robot.floating:
        if frames:
            raise ModelError(mjcf.path, diagnose("feet-of-fixed-base"))
        robot = build_robot(description, fixed_base=fixed_base)
        return replace(robot, notes=(*told, *robot.notes))
    ready = description.mjcf.copy()
    told += [*level_ground(ready), *free_of_friction(ready)]
    told += one_at_each_joint(ready, mjcf.path)
    bare = build_robot(replace(description, mjcf=ready))
    ended = bounded(bare)
    bare = bare if ended is None else build_robot(ended)
    limited, narrowed = within_both(bare)
    bare = bare if limited is None else build_robot(limited)
    told += narrowed
    check_masses(bare, urdf)
    poses = [start.inside(bare, pose) for pose in (*known.values(), None)]
    try:
        feet = _feet(bare, frames, poses)
    except ModelError as error:
        gone = [note for note in mjcf.notes if note.code == "files-missing"]
        gone = [note for note in gone if note.values["kind"] == "mesh"]
        if not gone:
            raise
        pointers = [note for note in mjcf.notes if note.code == "files-are-lfs-pointers"]
        problem = diagnose(
            "no-feet-as-files-are-missing", problem=error.cause, missing=gone, pointers=pointers
        )
        raise ModelError(mjcf.path, problem) from error
    if not feet:
        return replace(bare, notes=(*told, *bare.notes))
    told.append(notes.named(bare, feet, given=frames is not None))
    apart = {foot.name: apart_at(bare, foot) for foot in feet}
    worst = max(apart, key=apart.__getitem__)
    if apart[worst] > _APART:
        off = Quantity(apart[worst], "m")
        told.append(diagnose("last-joint-elsewhere", subject=("foot", worst), off=off))
    told += notes.balls(bare, feet)
    robot = build_robot(with_feet(bare, feet))
    robot, completed = _completed(robot, mjcf, known, as_is=as_is)
    return replace(robot, notes=tuple(dict.fromkeys((*told, *completed, *robot.notes))))


def _completed(
    robot: Robot,
    mjcf: MjcfFile,
    known: Mapping[str, Mapping[str, float]],
    *,
    as_is: bool,
) -> tuple[Robot, list[Diagnostic]]:
    """Gives a robot with feet what else it needs to stand: a start pose, and servos.

    As it is, it is given a start pose alone.
    """
    if not as_is:
        robot = drives.with_motors(robot)
    told = list(notes.planar(robot))
    robot, pose = started(robot, known)
    told += pose
    for step in () if as_is else (touching.on_feet_alone, touching.apart, solvable):
        robot, done = step(robot)
        told += done
    told += (*notes.bound(robot), *notes.uncommanded(robot))
    if as_is:
        return robot, told
    idle = {robot.joint_names[joint] for joint in drives.following(robot)}
    if not set(robot.joint_names) <= own_servos(robot).keys() | idle:
        robot, made = _driven(robot, mjcf)
        return robot, told + made
    stand = start.first_stand(robot)
    advice = None if stand is None else drives.advice(robot, stand)
    return robot, told if advice is None else [*told, advice]


def _feet(
    robot: Robot, frames: Mapping[str, tuple[str, str]] | None, poses: Sequence[Array]
) -> tuple[Foot, ...]:
    if frames is None:
        return find_feet(robot, poses) if limb_ends(robot.mj_model) else ()
    return tuple(named_foot(robot, foot, places, poses[0]) for foot, places in frames.items())


def _driven(robot: Robot, mjcf: MjcfFile) -> tuple[Robot, list[Diagnostic]]:
    """Gives a robot position servos with suggested gains, if it stands."""
    stand = start.first_stand(robot)
    if stand is None:
        return robot, []
    own = own_servos(robot)
    built, kp, kd, rests = drives.driven(robot, stand)
    idle = drives.following(robot)
    model = mjcf.compile()
    made = []
    for index, name in enumerate(robot.joint_names):
        if name not in own and index not in idle:
            joint = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name)
            what = Drive.NONE if joint < 0 else drive_of(model, joint)
            made.append(MadeServo(name, float(kp[index]), float(kd[index]), what))
    told = [*notes.made(made, len(own), built.mj_model.opt.timestep)]
    if not rests:
        told.append(diagnose("no-servos-bring-it-to-rest"))
    elif rests == 1:
        told.append(diagnose("rests-with-feed-forward-alone"))
    described = replace(built.description, made_servos=tuple(made))
    return replace(built, description=described), told
