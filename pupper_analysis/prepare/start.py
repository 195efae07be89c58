"""A pose to start from: the MJCF's keyframe, or one that is found."""

from __future__ import annotations

import copy
import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import PupperAnalysisError, UnknownNameError
from pupper_analysis.models.additions import StartKeyframe
from pupper_analysis.models.description import Description
from pupper_analysis.models.mjcf import JointKind, compile_spec, free_joints, silence_mujoco
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.spec_tree import SpecTree
from pupper_analysis.prepare.feet import report_sideways_limbs
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.fall import simulate_keyframe
from pupper_analysis.robot.robot import Robot, lend
from pupper_analysis.robot.servos import model_with_servos
from pupper_analysis.stance.branches import combine_branches, find_branches, find_limbs
from pupper_analysis.stance.problem import Goal, make_goal
from pupper_analysis.stance.search import make_seed, meet_constraints, search_from_joints
from pupper_analysis.stance.solver import SearchContext
from pupper_analysis.stance.stand import Stand, solve_stand, stand_statics
from pupper_analysis.stance.task import StandTask

_UPRIGHT = 1e-6
"""1 - cosine of the tilt up to which a base is level: 1.4 mrad."""

_CARRIED = 0.01
"""Of the weight: by less than that the ground's force is off where a robot rests; where one was put
by hand it is off by as much as it is."""


def list_keyframes(spec: mujoco.MjSpec, source: Path) -> dict[str, dict[str, float]]:
    """Returns an MJCF's keyframes, {name: {joint: position}}; those without a name are numbered.

    Args:
        spec: A copy of its spec, in which every joint has a name.
        source: The file.

    Raises:
        ModelError: If MuJoCo refuses the spec.
    """
    if not len(spec.keys):
        return {}
    model = compile_spec(spec.copy(), source)
    found = {}
    for number in range(model.nkey):
        name = model.key(number).name or f"keyframe {number + 1}"
        found[name] = {
            str(model.joint(joint).name): float(model.key_qpos[number, model.jnt_qposadr[joint]])
            for joint in range(model.njnt)
            if model.jnt_type[joint] != JointKind.FREE
        }
    return found


def compute_resting_depths(model: mujoco.MjModel) -> dict[str, float]:
    """Returns how deep the ground has a robot's feet in keyframes in which it carries the robot.

    With the legs as they are there the feet are below the ground, as they sink in, and the base is
    as high as it is to be. A keyframe in which a robot falls, or is thrown up, was put there by
    hand: its height says nothing.

    Args:
        model: The MJCF's, as it is.

    Returns:
        {keyframe: m}.
    """
    found, free = {}, free_joints(model)
    for key in range(model.nkey) if len(free) == 1 else ():
        if not model.key_ctrl[key].any():
            continue
        data, force = mujoco.MjData(model), np.zeros(6)
        mujoco.mj_resetDataKeyframe(model, data, key)
        mujoco.mj_forward(model, data)
        base = int(model.jnt_bodyid[free[0]])
        carried, depth = 0.0, 0.0
        for number, touch in enumerate(data.contact):
            if 0 in model.geom_bodyid[touch.geom]:
                mujoco.mj_contactForce(model, data, number, force)
                carried += float(force[0])
                depth = max(depth, -float(touch.dist))
        weight = float(model.body_subtreemass[base] * np.linalg.norm(model.opt.gravity))
        level = float(np.abs(data.xmat[base][6:]).max()) > 1 - _UPRIGHT  # see ``place_base_frame``
        if level and abs(carried - weight) < _CARRIED * weight:
            found[model.key(key).name or f"keyframe {key + 1}"] = depth
    return found


def choose_keyframes(
    mjcf: MjcfFile, known: Mapping[str, Mapping[str, float]], wanted: str | None
) -> dict[str, Mapping[str, float]]:
    """Returns the keyframes to begin with: the one that is wanted, or ``home`` and then the others.

    Raises:
        UnknownNameError: If the MJCF has no such keyframe.
    """
    if wanted is not None:
        if wanted not in known:
            raise UnknownNameError(mjcf.path, "keyframe", wanted, tuple(known))
        return {wanted: known[wanted]}
    return dict(sorted(known.items(), key=lambda item: item[0] != "home"))


def with_keyframes(
    description: Description, known: Mapping[str, Mapping[str, float]]
) -> Description:
    """Returns a robot's files with keyframes, which were lost where the two were matched.

    Args:
        description: Both files, made alike.
        known: {keyframe: {joint: position}}; where they have none, a joint is at its reference.
    """
    if not known:
        return description
    spec = description.mjcf.copy()
    model = compile_spec(spec.copy(), description.mjcf_source)
    for name, pose in known.items():
        qpos = model.qpos0.copy()
        for joint in range(model.njnt):
            place = model.jnt_qposadr[joint]
            qpos[place] = pose.get(model.joint(joint).name, qpos[place])
        spec.add_key(name=name, qpos=qpos)
    return replace(description, mjcf=spec)


Array = NDArray[np.float64]

_SLACK = 1e-3  # rad: keyframes are rounded, and may be that much outside of a limit

_UNEVEN = 0.1
"""Feet of a start pose that stands differ in height by no more than this part of the base's height
above the lowest."""

_BRANCHES = 3  # to bend the legs that are tried at each height: the first are nearest to the pose

_HEIGHTS = 12  # tried between a leg that is folded and one that is stretched

_CLEAR = 0.01
"""Everything but the feet is as high above the ground in a start pose (m): feet sink in."""

_CALMING = 3
"""How often arms and waist are put back where the pose has them, and the stand solved again."""

_MARGINS = (0.2, 0.05, 0.0)
"""How far a start pose has its joints off their limits (rad); the first with which there is one."""

_BELOW, _ASIDE, _SPREAD, _BENT = 0.1, 0.4, 0.6, 0.5
"""Feet that are not aside from their hips by a part of their distance between the first and the
third are put aside by the second, and stand below the hips by the fourth."""

_KEY_DIGITS = 6
"""Decimals of a keyframe's angles and height: a micrometre, which the servos make up for."""

_POSE_WEIGHT = 1e-3
"""Weight of the distance from the pose [rad] beside a contact point's height error, in parts of the
base height, and the CoM's offset, likewise. It selects among the postures that lay the soles."""

_MAX_SOLE_ERROR = 1e-3
"""Largest height error of a contact point, and offset of the CoM, in parts of the base height, with
which joint positions are an initial guess of a stand. Chosen: the stand is solved exactly."""

_LIMIT_CLEARANCE = 1e-9
"""Distance of an initial guess from the bounds of the least-squares problem [rad]: SciPy requires
it to be strictly inside."""

_LOWEST, _HIGHEST = 0.25, 0.98  # parts of a leg's length


def clip_to_limits(robot: Robot, joints: Mapping[str, float] | None = None) -> Array:
    """Returns joint positions (nu,), zero where not given, cut to the limits."""
    values = np.array([(joints or {}).get(name, 0.0) for name in robot.joint_names])
    return np.clip(values, robot.lower_limits, robot.upper_limits)


def is_standing_pose(robot: Robot, joints: Mapping[str, float]) -> bool:
    """Tells whether a robot stands in a pose: within its limits, its feet at about one height."""
    values = np.array([joints.get(name, 0.0) for name in robot.joint_names])
    if np.abs(values - clip_to_limits(robot, joints)).max() > _SLACK:
        return False
    qpos = robot.posed(values)
    centres = Configuration(robot, qpos).foot_positions()
    heights = [
        min(float(centres[point][2]) - robot.contact_radius[point] for point in points)
        for points in robot.feet.values()
    ]
    return max(heights) < 0 and float(np.ptp(heights)) < _UNEVEN * -min(heights)


def solve_nominal_stand(robot: Robot) -> Stand | None:
    """Returns the robot's nominal stand, or None if it is out of reach, or in no balance."""
    try:
        stand = solve_stand(robot, explain=False)
        stand_statics(robot, stand)  # a com that may be anywhere inside may be a hair outside
    except PupperAnalysisError:
        return None
    return stand


def search_start(robot: Robot, poses: Iterable[Array]) -> Robot | None:
    """Finds a stand in the middle of the heights that the legs can reach.

    The horizontal positions of the feet are those of one of the poses; else beside the hips; else
    those of legs that are bent until their soles are level: see ``_find_level_soles``.

    Args:
        robot: The robot with feet.
        poses: Joint positions (nu,).

    Returns:
        The robot with that as its nominal stand; None if it stands nowhere.
    """
    poses = list(poses)
    return (
        _found(robot, poses)
        or _found(robot, [_put_aside(robot, pose) for pose in poses])
        or next(filter(None, (_find_level_soles(robot, pose) for pose in poses)), None)
    )


def _find_level_soles(robot: Robot, pose: Array) -> Robot | None:
    """Find a nominal stand whose feet are level and wherever the bent legs have them.

    Legs with fewer than six joints, and axes that are not parallel, move a sole sideways and turn
    it while they bend: at the horizontal positions of the straight legs the sole is never level.

    Returns:
        Robot with this nominal stand. None if there is none, or if no joint moves a contact point
        (wheels).
    """
    jacobians = Configuration(robot, robot.posed(pose)).foot_jacobians().values()
    if not any((np.abs(jacobian[:, 6:]) > _LIMIT_CLEARANCE).any() for jacobian in jacobians):
        return None
    length = compute_leg_length(robot, robot.posed(pose))
    heights = np.round(length * np.linspace(_HIGHEST, _LOWEST, _HEIGHTS), 3)
    heights = heights[heights > 0]
    for margin in _MARGINS:
        guesses = [(height, _level_soles(robot, pose, height, margin)) for height in heights]
        found = _from_middle(
            [
                _starting(replace(robot, nominal=joints), joints, float(height))
                for height, joints in guesses
                if joints is not None
            ]
        )
        if found is not None:
            return found
    return None


def _level_soles(robot: Robot, pose: Array, height: float, margin: float) -> Array | None:
    """Bend the joints until all contact points are on the ground and the CoM above their centre.

    Least squares over the joint positions with a level base; the distance from the pose is a small
    regularisation. The horizontal positions and the yaw of the feet are free.

    Args:
        robot: Robot with feet.
        pose: Joint positions that the solution is close to, shape (nu,) [rad or m].
        height: Height of the base above the ground [m].
        margin: Distance of the joints from their limits [rad]; at most 40 % of a joint's range.

    Returns:
        Joint positions, shape (nu,) [rad or m]; None if an error exceeds ``_MAX_SOLE_ERROR``.
    """
    from scipy import optimize  # slow to import

    lower = np.clip(robot.lower_limits, -np.pi, np.pi)
    upper = np.clip(robot.upper_limits, -np.pi, np.pi)
    inset = np.minimum(margin, 0.4 * (upper - lower)) - _LIMIT_CLEARANCE
    radii = np.array(list(robot.contact_radius.values()))

    def errors(joints: Array) -> Array:
        config = Configuration(robot, robot.posed(joints))
        places = config.foot_positions()
        touching = np.array([places[point] for point in robot.contact_radius])
        com_offset = (config.center_of_mass() - touching.mean(axis=0))[:2]
        return np.concatenate([touching[:, 2] - radii + height, com_offset])

    found = optimize.least_squares(
        lambda joints: np.concatenate([errors(joints) / height, _POSE_WEIGHT * (joints - pose)]),
        np.clip(pose, lower + inset + _LIMIT_CLEARANCE, upper - inset - _LIMIT_CLEARANCE),
        bounds=(lower + inset, upper - inset),
    ).x
    return found if np.abs(errors(found)).max() < _MAX_SOLE_ERROR * height else None


def _starting(robot: Robot, joints: Array, height: float) -> Robot:
    """Returns a robot whose nominal stand begins at joint positions (nu,), so high (m)."""
    return replace(robot, home=np.concatenate([robot.home[:7], joints]), stand_height=height)


def _from_middle(starts: Sequence[Robot]) -> Robot | None:
    """Returns the first that stands, from the middle outwards; None if none does.

    Legs that are straight where the search began may move the com once they are bent: the nominal
    stand then has it in the centre, which may be out of reach here.
    """
    middle = len(starts) // 2
    ordered = sorted(range(len(starts)), key=lambda number: abs(number - middle))
    return next((starts[n] for n in ordered if solve_nominal_stand(starts[n]) is not None), None)


def _found(robot: Robot, poses: Sequence[Array]) -> Robot | None:
    for margin in _MARGINS:
        best: tuple[list[Stand], Robot] = [], robot
        for pose in poses:
            placed = _starting(replace(robot, nominal=pose), pose, robot.stand_height)
            stands = _longest_run(placed, pose, margin, len(best[0]))
            best = max(best, (stands, placed), key=lambda found: len(found[0]))
        stands, placed = best
        found = _from_middle(
            [
                _starting(
                    placed, one.joint_positions(robot), round(float(one.task.height or 0.0), 3)
                )
                for one in stands
            ]
        )
        if found is not None:
            return found
    return None


def _put_aside(robot: Robot, pose: Array) -> Array:
    """Returns joint positions (nu,) with each foot aside from its hip, neither far nor below it.

    Legs that are straight to the side, as a spider's at zero angles, reach no ground where they
    end. A leg that first turns about the vertical has to point to where its foot is: to anywhere,
    if that is below the axis and the base moves aside.
    """
    qpos = robot.posed(pose)
    config = Configuration(robot, qpos)
    feet = config.foot_positions()
    targets, drops = dict(feet), []
    for limb in find_limbs(robot):
        names = {robot.joint_names[index] for index in limb.joints}
        first = next(name for name in robot.pin_model.names if name in names)
        hip = config.joint_position(first)
        for foot in limb.feet:
            out = feet[foot] - hip
            length = float(np.linalg.norm(out))
            aside = math.hypot(*out[:2])
            if not _BELOW * length < aside < _SPREAD * length:
                way = out if aside > _BELOW * length else hip - np.mean([*feet.values()], axis=0)
                targets[foot] = hip + _ASIDE * length * way / max(math.hypot(*way[:2]), 1e-9)
            drops.append(float(hip[2]) - _BENT * length)
    for foot, place in targets.items():
        targets[foot] = np.array([*place[:2], min(drops)])
    found = find_branches(robot, qpos, targets, robot.lower_limits, robot.upper_limits)
    return next(combine_branches(found, pose), pose)


def _longest_run(robot: Robot, pose: Array, margin: float, known: int) -> list[Stand]:
    """Returns stands at heights, from high to low, without one between them out of reach.

    Args:
        robot: The robot.
        pose: (nu,) where its joints are to be, as far as its feet let them.
        margin: How far off their limits (rad).
        known: As many stands as this are known: fewer are of no use.
    """
    length = compute_leg_length(robot, robot.posed(pose))
    heights = [float(h) for h in length * np.linspace(_HIGHEST, _LOWEST, _HEIGHTS) if h > 0]

    def stand_at(height: float, seed: Stand | None = None) -> Stand | None:
        joints = None if seed is None else seed.joint_positions(robot).tolist()
        task = StandTask(height=height, ik_seed=joints, joint_margin=margin)
        stand = _calm(robot, task, pose)
        return stand if stand is not None and is_clear_of_ground(robot, stand) else None

    # A longer run has one of these heights in it.
    if known and not any(stand_at(height) for height in heights[known :: known + 1]):
        return []
    longest, current = list[Stand](), list[Stand]()
    for number, height in enumerate(heights):
        if len(current) + len(heights) - number <= max(len(longest), known):
            break
        stand = stand_at(height, current[-1] if current else None)
        current = [] if stand is None else [*current, stand]
        longest = max(longest, current, key=len)
    return longest


def find_non_foot_contacts(robot: Robot, stand: Stand, deeper: float) -> set[int]:
    """Returns the geoms, but for those of the feet, that touch the ground in a stand that sank.

    Args:
        robot: The robot.
        stand: The stand.
        deeper: By how much (m).
    """
    qpos = stand.qpos.copy()
    qpos[2] -= deeper
    model, data = robot.mj_model, robot.placed(qpos)
    mujoco.mj_collision(model, data)
    pairs = [pair for pair in data.contact.geom if 0 in model.geom_bodyid[pair]]
    return {
        int(geom)
        for pair in pairs
        for geom in pair
        if model.geom_bodyid[geom] != 0 and geom not in robot.foot_geoms
    }


def list_foot_bodies(robot: Robot) -> set[int]:
    """Returns the ids of the moving bodies that carry the feet."""
    weld = robot.mj_model.body_weldid
    return {int(weld[body]) for body, _ in robot.contact_places.values()}


def is_clear_of_ground(robot: Robot, stand: Stand) -> bool:
    """Tells whether only the feet, and the links that carry them, are near the ground."""
    model = robot.mj_model
    own = list_foot_bodies(robot)
    return all(
        int(model.body_weldid[model.geom_bodyid[geom]]) in own
        for geom in find_non_foot_contacts(robot, stand, _CLEAR)
    )


def _calm(robot: Robot, task: StandTask, pose: Array) -> Stand | None:
    """Solves a stand with all but the legs as in a pose, as far as the com allows."""
    legs = np.concatenate([limb.joints for limb in find_limbs(robot)])
    try:
        robot.check_bodies()
        goal, found = make_goal(robot, task, {}), None
    except PupperAnalysisError:  # the margin leaves nothing of a joint's range, or no body is so
        return None
    first = [pose if task.ik_seed is None else np.array(task.ik_seed)]
    seeds: Iterable[Array] = itertools.chain(first, _bent(robot, goal, pose))
    with lend(robot, SearchContext) as context:
        for _ in range(_CALMING):
            stand = _first_solved(context, goal, seeds)
            if stand is None:
                return found
            found = stand
            joints = pose.copy()
            joints[legs] = found.joint_positions(robot)[legs]
            seeds = [joints]
    return found


def _bent(robot: Robot, goal: Goal, pose: Array) -> Iterator[Array]:
    """Yields joint positions (nu,) with the legs bent in the first ways that reach the ground.

    Nothing is looked for before the first is asked for: mostly the pose itself will do.
    """
    qpos = robot.posed(pose)
    qpos[:3] = (*goal.place, goal.height)
    found = find_branches(robot, qpos, goal.targets, goal.lower, goal.upper)
    yield from itertools.islice(combine_branches(found, pose), _BRANCHES)


def _first_solved(context: SearchContext, goal: Goal, seeds: Iterable[Array]) -> Stand | None:
    """Returns the first solved stand from some joint positions (nu,); not all that there may be.

    With the com anywhere inside it may be over the edge, and parts next to the ground: from another
    start they need not be.
    """
    for joints in seeds:
        if (stand := search_from_joints(context, goal, joints)) is not None:
            return stand
        if not goal.com_is_free:
            continue
        stand = meet_constraints(context, goal, make_seed(context.robot, goal, joints, goal.place))
        if stand is not None and is_clear_of_ground(context.robot, stand):
            return stand
    return None


def compute_leg_length(robot: Robot, qpos: Array) -> float:
    """Returns how far the base can be above the ground with the longest leg straight down (m).

    The lengths from joint to joint do not depend on how they are bent.
    """
    config, model = Configuration(robot, qpos), robot.pin_model
    lengths = []
    for point, frame in robot.contact_frames.items():
        joint = model.frames[model.getFrameId(frame, pin.FrameType.BODY)].parentJoint
        places = [config.foot_positions()[point]]
        for index in reversed(list(model.supports[joint])):
            if model.names[index] in robot.joint_names:
                places.append(config.joint_position(model.names[index]))
        links = np.linalg.norm(np.diff(places, axis=0), axis=1).sum()
        lengths.append(float(links) - float(places[-1][2] - qpos[2]) + robot.contact_radius[point])
    return max(lengths)


def with_foot_contacts_only(robot: Robot) -> Robot:
    """Returns a robot whose MuJoCo model lets nothing on the feet's bodies touch but the feet.

    In which it is seen how a robot stands before ``touching`` knows what is in the
    way. What is built from its description has it all again.
    """
    model, own = copy.copy(robot.mj_model), list_foot_bodies(robot)
    for geom in range(model.ngeom):
        if int(model.body_weldid[model.geom_bodyid[geom]]) in own and geom not in robot.foot_geoms:
            model.geom_contype[geom] = model.geom_conaffinity[geom] = 0
    return replace(robot, mj_model=model)


def rest_depth_from_keyframe(model: mujoco.MjModel, name: str) -> float | None:
    """Return the penetration of the feet [m] at which an unmodified model stands from a keyframe.

    Args:
        model: Model of the file.
        name: Name of the keyframe; "keyframe 1" etc. for keyframes without a name.

    Returns:
        Largest penetration of a contact with the world at the end of the simulation. None if the
        model collapses with the ctrl of the keyframe, or if it has not exactly one free joint.
    """
    names = [model.key(key).name or f"keyframe {key + 1}" for key in range(model.nkey)]
    free = free_joints(model)
    if name not in names or len(free) != 1:
        return None
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, names.index(name))

    def advance(state: mujoco.MjData, seconds: float) -> None:
        mujoco.mj_step(model, state, nstep=round(seconds / float(model.opt.timestep)))

    with silence_mujoco():
        motion, end = simulate_keyframe(model, data, int(model.jnt_bodyid[free[0]]), 0.0, advance)
    if motion.collapses:
        return None
    grounded = (model.geom_bodyid[end.contact.geom] == 0).any(axis=1)
    return max(0.0, -float(end.contact.dist[grounded].min(initial=0.0)))


def _objections(robot: Robot, name: str, joints: Mapping[str, float]) -> tuple[Diagnostic, ...]:
    """Return the reasons why ``is_standing_pose`` rejects a keyframe: joint limits, uneven feet."""
    subject = ("keyframe", name)
    values = np.array([joints.get(joint, 0.0) for joint in robot.joint_names])
    excess = np.abs(values - clip_to_limits(robot, joints))
    beyond = np.flatnonzero(excess > _SLACK)
    if not beyond.size:
        return (diagnose("keyframe-feet-uneven", subject=subject),)
    names = [robot.joint_names[joint] for joint in beyond]
    angle = Quantity(float(excess.max()), "rad")
    return (diagnose("keyframe-beyond-limits", subject=subject, joints=names, excess=angle),)


def find_start_pose(
    robot: Robot,
    known: Mapping[str, Mapping[str, float]],
    sunk: Mapping[str, float],
    rest_depth: Callable[[str], float | None] | None = None,
) -> tuple[Robot, list[Diagnostic]]:
    """Give a robot a start pose: that of a keyframe, or one that is found.

    A keyframe is taken if the feet are level, the joints within their limits, and the nominal stand
    exists. If no keyframe has level feet within the limits, a keyframe from which the unmodified
    file stands is taken, with its joints clipped to the limits. Shapes beside the feet are ignored
    here: see ``touching``.

    Args:
        robot: Robot with feet.
        known: {keyframe: {joint: position}}, in order of priority.
        sunk: {keyframe: penetration of the feet [m]}; see ``compute_resting_depths``.
        rest_depth: Returns the penetration of the feet [m] at which the unmodified file stands
            from a keyframe, or None if it falls. It is called only if needed.

    Returns:
        Robot, and notes: which pose was taken, and what speaks against a keyframe.
    """
    whole, robot = robot, with_foot_contacts_only(robot)
    standing = {name: pose for name, pose in known.items() if is_standing_pose(robot, pose)}
    against: list[Diagnostic] = []
    sunk = dict(sunk)
    if not standing and rest_depth is not None:
        for name, pose in known.items():
            depth = rest_depth(name)
            if depth is not None:
                standing[name] = dict(
                    zip(robot.joint_names, clip_to_limits(robot, pose).tolist(), strict=True)
                )
                against += _objections(robot, name, pose)
                sunk[name] = depth  # straight legs are then a little bent, and not singular
    for name, pose in standing.items():
        home = np.array([pose.get(joint, 0.0) for joint in robot.joint_names])
        at_home = _at(robot, home, sunk.get(name, 0.0))
        starts = [replace(at_home, nominal=home)]
        if name not in sunk:
            starts.insert(0, replace(at_home, nominal=np.zeros(robot.nu)))
        elif against:  # a joint at its limit may not let the feet sink in
            starts.append(replace(_at(robot, home, 0.0), nominal=home))
        for tried in starts:
            if solve_nominal_stand(tried) is not None:
                notes = [diagnose("start-pose-is-keyframe", subject=("keyframe", name))]
                notes += [note for note in against if note.subject == notes[0].subject]
                if tried.nominal is home:
                    notes.append(diagnose("feet-placed-by-start-pose"))
                return _kept(whole, tried), notes
    poses = [*(clip_to_limits(robot, pose) for pose in known.values()), clip_to_limits(robot)]
    bounded = np.isfinite(robot.lower_limits) & np.isfinite(robot.upper_limits)
    low, high = (np.where(bounded, x, 0.0) for x in (robot.lower_limits, robot.upper_limits))
    middle = (low + high) / 2
    found = search_start(robot, [*poses, middle])
    if found is None:  # refused are then the pose that the file asks for, and why that is none
        kept = _kept(whole, replace(at_home, nominal=home)) if standing else whole
        return kept, [diagnose("no-start-pose"), *against, *report_sideways_limbs(whole)]
    height = Quantity(found.stand_height, "m")
    notes = [diagnose("start-pose-found", height=height, keyframes=bool(known))]
    return _kept(whole, found), [*notes, *against]


def make_start_keyframe(
    robot: Robot, stand: Stand, reason: Diagnostic, kp: Array | None = None, kd: Array | None = None
) -> StartKeyframe:
    """Returns the pose to start from: a stand, and the commands with which servos hold it.

    Args:
        robot: The robot, with servos.
        stand: As it rests on soft ground.
        reason: Why it starts there.
        kp: (nu,) stiffness of the servos (N m/rad); the robot's own by default.
        kd: (nu,) damping (N m s/rad); likewise.
    """
    qpos = stand.qpos.copy()
    qpos[:2] = 0.0
    qpos[2] = round(float(qpos[2]), _KEY_DIGITS)
    qpos[-robot.nu :] = np.round(qpos[-robot.nu :], _KEY_DIGITS)
    torques = stand_statics(robot, stand).joint_torques
    drive, data = model_with_servos(robot, kp, kd), mujoco.MjData(robot.mj_model)
    robot.mj_convention.set_state(data, qpos)
    ctrl = np.round(drive.command(robot, qpos[-robot.nu :], torques), _KEY_DIGITS)
    return StartKeyframe(reason, tuple(data.qpos.tolist()), tuple(ctrl.tolist()))


def _at(robot: Robot, joints: Array, sunk: float) -> Robot:
    """Returns the robot with a start pose whose lowest foot has sunk so far into the ground (m)."""
    qpos = robot.posed(joints)
    places = Configuration(robot, qpos).foot_positions()
    height = max(robot.contact_radius[foot] - float(place[2]) for foot, place in places.items())
    return replace(robot, home=qpos, stand_height=round(height - sunk, 9) if sunk else height)


def _kept(whole: Robot, posed: Robot) -> Robot:
    """Returns a robot with the start pose of one that is posed, also in its description."""
    spec = whole.description.mjcf.copy()
    data = mujoco.MjData(whole.mj_model)
    home = posed.home.copy()
    home[:7] = (0.0, 0.0, posed.stand_height, 1.0, 0.0, 0.0, 0.0)
    whole.mj_convention.set_state(data, home)
    SpecTree(spec).set_home(data.qpos)
    nominal = dict(zip(posed.joint_names, posed.nominal.tolist(), strict=True))
    return replace(
        whole,
        description=replace(whole.description, mjcf=spec, nominal=nominal),
        home=home,
        nominal=posed.nominal,
        stand_height=posed.stand_height,
    )
