"""Find the start pose of a robot: a keyframe of the MJCF, or a stand that is searched.

Input is a robot with feet; output is a robot with a start pose. The start pose defines the nominal
stand (the solution of the default `StandTask`) and the keyframe of the prepared model.
`find_start_pose` tries three sources, in this order:

1. A keyframe whose feet are level, whose joints are within the limits, and with which the nominal
   stand exists.
2. A keyframe from which the unmodified file stands in a simulation, and with which the nominal
   stand exists.
3. A stand near the middle of the reachable base heights.
"""

from __future__ import annotations

import copy
import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, Subject, diagnose
from pupper_analysis.base.errors import (
    PupperAnalysisError,
    StanceUnreachableError,
    UnknownNameError,
)
from pupper_analysis.base.frozen import FrozenDict
from pupper_analysis.models.additions import StartKeyframe
from pupper_analysis.models.description import Description
from pupper_analysis.models.mjcf import JointKind, compile_spec, list_free_joints, silence_mujoco
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.spec_tree import SpecTree
from pupper_analysis.prepare.feet import report_sideways_limbs
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.contact import find_acting_contacts, list_contact_bodies
from pupper_analysis.robot.fall import simulate_keyframe
from pupper_analysis.robot.joints import joint_unit
from pupper_analysis.robot.robot import Robot, borrow
from pupper_analysis.robot.servos import model_with_servos
from pupper_analysis.stance.branches import combine_branches, find_branches, find_limbs
from pupper_analysis.stance.problem import StandTargets, compute_targets, select_stance_feet
from pupper_analysis.stance.search import (
    NEAR_MISS,
    make_initial_configuration,
    search_from_joints,
    solve_constraints,
)
from pupper_analysis.stance.soft_ground import solve_stand_on_soft_ground
from pupper_analysis.stance.solver import SearchContext
from pupper_analysis.stance.stand import Stand, solve_stand, stand_statics
from pupper_analysis.stance.task import StandTask
from pupper_analysis.statics.contacts import make_contacts

_LEVEL_COSINE_ATOL = 1e-6
"""Upper bound of 1 - cos(a) [1] with which a base counts as level in `compute_resting_depths`. a is
the angle between the vertical and the nearest axis of the base; the bound is 1.4 mrad. Chosen, not
tuned."""

_WEIGHT_RTOL = 0.01
"""Upper bound of |sum of the contacts' normal forces - weight| / weight [1] with which a keyframe
counts as at rest. Chosen, not tuned.
"""


def list_keyframes(spec: mujoco.MjSpec, source: Path) -> dict[str, dict[str, float]]:
    """Return the joint positions of all keyframes of an MJCF.

    Args:
        spec: Spec of the MJCF, in which every joint has a name; not modified.
        source: File of the MJCF, for errors.

    Returns:
        {keyframe: {joint: position [rad, m]}}, without free joints. The value of a ball joint is
        the first element of the quaternion. A keyframe without a name is called "keyframe 1" etc.

    Raises:
        ModelError: If MuJoCo refuses the spec, for example.
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
    """Compute the ground penetration in keyframes whose contact forces balance the weight.

    Keyframes with a ctrl of zero, or in which no axis of the base is vertical, are omitted.

    Args:
        model: Unmodified model of the MJCF.

    Returns:
        {keyframe: largest penetration of a contact with the world [m]}. Empty unless the model has
        exactly one free joint.
    """
    found, free = {}, list_free_joints(model)
    for key in range(model.nkey) if len(free) == 1 else ():
        if not model.key_ctrl[key].any():
            continue
        data, force = mujoco.MjData(model), np.zeros(6)
        mujoco.mj_resetDataKeyframe(model, data, key)
        mujoco.mj_forward(model, data)
        base = int(model.jnt_bodyid[free[0]])
        carried, depth = 0.0, 0.0
        bodies = list_contact_bodies(model, data)
        for number, touch in enumerate(data.contact):
            if 0 in bodies[number]:
                mujoco.mj_contactForce(model, data, number, force)
                carried += float(force[0])
                depth = max(depth, -float(touch.dist))
        weight = float(model.body_subtreemass[base] * np.linalg.norm(model.opt.gravity))
        level = (
            float(np.abs(data.xmat[base][6:]).max()) > 1 - _LEVEL_COSINE_ATOL
        )  # any axis: the z axis may be horizontal if the frame is not placed yet
        if level and abs(carried - weight) < _WEIGHT_RTOL * weight:
            found[model.key(key).name or f"keyframe {key + 1}"] = depth
    return found


def choose_keyframes(
    mjcf: MjcfFile, known: Mapping[str, Mapping[str, float]], wanted: str | None
) -> dict[str, Mapping[str, float]]:
    """Select the keyframes to try as start pose: a requested keyframe, or all, `home` first.

    Args:
        mjcf: MJCF, for errors.
        known: {keyframe: {joint: position [rad, m]}} of all keyframes of the MJCF.
        wanted: Name of the keyframe that the user requests; None to select all.

    Returns:
        {keyframe: {joint: position [rad, m]}}, in the order in which the keyframes are tried.

    Raises:
        UnknownNameError: If the MJCF does not have the requested keyframe.
    """
    if wanted is not None:
        if wanted not in known:
            raise UnknownNameError(mjcf.path, "keyframe", wanted, tuple(known))
        return {wanted: known[wanted]}
    return dict(sorted(known.items(), key=lambda item: item[0] != "home"))


def with_keyframes(
    description: Description, known: Mapping[str, Mapping[str, float]]
) -> Description:
    """Return a description with keyframes added to its MJCF.

    ``known`` is {keyframe: {joint: position [rad, m]}}; joints without a position are at ``qpos0``.
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


_LIMIT_ATOL = 1e-3
"""Tolerance [rad, m] of joint limits in a keyframe that may be a standing pose: keyframes are
rounded. Chosen, not tuned.
"""

_MAX_FOOT_HEIGHT_SPREAD = 0.1
"""Upper bound of the height difference between the feet of a standing pose, relative to the
height of the base above the lowest foot. Chosen, not tuned."""

_MAX_BRANCHES = 3
"""Upper bound of the number of combinations of the legs' IK branches that are tried as initial
guesses per call of `_solve_near_pose`. Chosen, not tuned.
"""

_NUM_HEIGHTS = 12
"""Number of base heights at which a stand is searched per pose, between folded and straight legs
(`_MIN_HEIGHT_FRACTION`, `_MAX_HEIGHT_FRACTION`). Chosen, not tuned.
"""

_MIN_GROUND_CLEARANCE = 0.01
"""Lower bound of the height above the ground [m] of all bodies without feet
(`is_clear_of_ground`). A clearance is needed since feet penetrate the ground. Chosen, not tuned."""

_EQUAL_MISS_RTOL = 1e-3
"""Relative tolerance [1] with which the minimum foot errors from two initial guesses count as the
same minimum (`_solve_first_guess`). Chosen between measured values, of 238 minima of three random
bipeds: equal minima differ by up to 3e-5, different minima by 8e-3 or more."""

_MAX_RESET_PASSES = 3
"""Upper bound of the number of successive solves of a stand. Before each solve after the first, the
joints outside the legs (arms, waist) are reset to the requested pose. Chosen, not tuned."""

_JOINT_MARGINS = (0.2, 0.05, 0.0)
"""Wanted distances of the joints from their limits [rad, m], tried in this order until a start
pose is found that remains within reach on soft ground. Chosen, not tuned."""

_MIN_SIDE_DISTANCE, _MAX_SIDE_DISTANCE = 0.1, 0.6
"""Bounds of the horizontal distance of a foot from the hip, divided by the distance between foot
and hip [1]. Outside of the bounds, the foot is moved to `_TARGET_SIDE_DISTANCE`. Chosen, not
tuned."""

_TARGET_SIDE_DISTANCE, _TARGET_FOOT_DEPTH = 0.4, 0.5
"""Horizontal distance of a moved foot from the hip, and least depth of a foot's target below the
hip, divided by the distance between foot and hip [1]. Chosen, not tuned.
"""

_NUM_KEYFRAME_DIGITS = 6
"""Decimals of a written keyframe's joint positions [rad, m], base height [m] and ctrl. Chosen, not
tuned.
"""

_POSE_WEIGHT = 1e-3
"""Weight of a joint's distance from the pose [rad, m] in a least-squares problem, relative to the
other residuals, which are lengths divided by the base height. The small weight selects among the
postures in which the soles lie flat. Chosen, not tuned.
"""

_MAX_SOLE_ERROR = 1e-3
"""Upper bound of the height error of a contact point, and of the horizontal CoM offset, both
divided by the base height [1], with which `_level_soles` accepts joint positions. Chosen, not
tuned: the stand is solved afterwards.
"""

_LIMIT_CLEARANCE = 1e-9
"""Distance of an initial guess from the bounds of the least-squares problem [rad, m]. Chosen small:
SciPy requires a guess strictly inside of the bounds."""

_FRICTION_ATOL = 1e-6
"""Tolerance of the friction coefficient [1]. A stand is searched if the horizontal part of gravity,
divided by the vertical part, exceeds the friction coefficient by at most this tolerance. Chosen
above the tolerances of contact forces, 1e-9 of the weight."""

_MIN_CONTACT_RATE = 1e-9
"""Lower bound of the magnitude of a Jacobian's element [m/rad, 1] with which a joint counts as
moving a contact point. Smaller elements are rounding. Chosen, not tuned.
"""

_MIN_HEIGHT_FRACTION, _MAX_HEIGHT_FRACTION = 0.25, 0.98
"""Lowest and highest base height at which a stand is searched, as fractions of the leg length
(`compute_leg_length`). Chosen, not tuned."""


def clip_to_limits(robot: Robot, joints: Mapping[str, float] | None = None) -> Array:
    """Convert named joint positions to an array, shape (nu,) [rad, m], clipped to the joint limits.

    Args:
        robot: Robot.
        joints: {joint: position [rad, m]}; joints without a position are at zero before clipping.
    """
    values = np.array([(joints or {}).get(name, 0.0) for name in robot.joint_names])
    return np.clip(values, robot.lower_limits, robot.upper_limits)


def is_standing_pose(robot: Robot, joints: Mapping[str, float]) -> bool:
    """Return True if a pose may be a stand: joints within limits, feet at about the same height.

    The feet must also be below the origin of the base, which is level.

    Args:
        robot: Robot with feet.
        joints: {joint: position [rad, m]}; joints without a position are at zero.
    """
    values = np.array([joints.get(name, 0.0) for name in robot.joint_names])
    if np.abs(values - clip_to_limits(robot, joints)).max() > _LIMIT_ATOL:
        return False
    qpos = robot.make_qpos(values)
    centres = Configuration(robot, qpos).foot_positions()
    heights = [
        min(float(centres[point][2]) - robot.contact_radius[point] for point in points)
        for points in robot.feet.values()
    ]
    return max(heights) < 0 and float(np.ptp(heights)) < _MAX_FOOT_HEIGHT_SPREAD * -min(heights)


def solve_nominal_stand(robot: Robot) -> Stand | None:
    """Solve the nominal stand of a robot: the stand of the default `StandTask`.

    Returns:
        The stand; None if no stand in static equilibrium is found.
    """
    try:
        stand = solve_stand(robot, explain=False)
        stand_statics(robot, stand)  # the CoM may be just outside the polygon
    except PupperAnalysisError:
        return None
    return stand


def search_start(robot: Robot, poses: Iterable[Array]) -> Robot | None:
    """Search for a start pose near the middle of the base heights that the legs can reach.

    Args:
        robot: Robot with feet.
        poses: Joint positions near which a stand is searched, shape (nu,) each [rad, m].

    Returns:
        Copy of the robot with this start pose. None if no stand is found, for example if the joints
        do not move the contact points, as with wheels.
    """
    if not _can_carry_weight(robot):
        return None
    poses = list(poses)
    if poses and not _can_move_contacts(robot, poses[0]):
        return None
    return (
        _search_poses(robot, poses)
        or _search_poses(robot, [_spread_feet(robot, pose) for pose in poses])
        or next(filter(None, (_find_level_soles(robot, pose) for pose in poses)), None)
    )


def _can_carry_weight(robot: Robot) -> bool:
    """Return True unless contact forces cannot carry the weight at any joint positions.

    For example, gravity does not point downward, fewer than three contact points touch the ground,
    or the horizontal part of gravity exceeds the friction: ``|g_xy| > max(mu) |g_z|``.
    """
    try:
        stance_feet = select_stance_feet(robot, StandTask())
        contacts = make_contacts(robot, stance_feet, None, None, None)
    except PupperAnalysisError:
        return False
    if robot.fixed_parts:
        return True
    friction = float(contacts.friction.max(initial=0.0))
    sideways, down = math.hypot(*robot.gravity[:2].tolist()), -float(robot.gravity[2])
    # Passive forces, such as that of a spring between base and world, may carry a part.
    is_too_slippery = sideways > (friction + _FRICTION_ATOL) * down and not robot.acts_at_rest
    return not ((contacts.friction < 0).all() or (is_too_slippery and contacts.is_level))


def _can_move_contacts(robot: Robot, pose: Array) -> bool:
    """Return True if a joint moves a contact point relative to the base at ``pose`` (nu,) [rad, m].

    The contact point of a wheel is on the axis of its joint.
    """
    jacobians = Configuration(robot, robot.make_qpos(pose)).foot_jacobians().values()
    return any((np.abs(jacobian[:, 6:]) > _MIN_CONTACT_RATE).any() for jacobian in jacobians)


def _find_level_soles(robot: Robot, pose: Array) -> Robot | None:
    """Find a start pose with flat soles, at free horizontal foot positions; None if not found.

    A bent leg with few joints may not reach a level sole at prescribed positions: bending moves and
    tilts the sole sideways. ``pose`` is the initial guess, joint positions (nu,) [rad, m].
    """
    length = compute_leg_length(robot, robot.make_qpos(pose))
    heights = np.round(
        length * np.linspace(_MAX_HEIGHT_FRACTION, _MIN_HEIGHT_FRACTION, _NUM_HEIGHTS), 3
    )
    heights = heights[heights > 0]

    def level_at_heights(margin: float, *, centred: bool) -> list[Robot]:
        """Return a robot per base height at which the joints can lay all soles flat.

        ``margin`` [rad, m] is the wanted distance of the joints from the limits.
        """
        guesses = [
            (height, _level_soles(robot, pose, height, margin, centred=centred))
            for height in heights
        ]
        return [
            _set_start(replace(robot, nominal=joints), joints, float(height))
            for height, joints in guesses
            if joints is not None
        ]

    found = _choose_start(level_at_heights(margin, centred=True) for margin in _JOINT_MARGINS)
    if found is None and len(robot.feet) >= _MIN_FEET_OF_POLYGON:
        return _choose_start(level_at_heights(margin, centred=False) for margin in _JOINT_MARGINS)
    return found


_MIN_FEET_OF_POLYGON = 3
"""Number of feet from which a start pose is also searched with the CoM off the centre of the feet:
three point feet can have a support polygon.
"""

_REFINED_TOLERANCE, _MAX_REFINEMENTS = 1e-15, 4
"""Tolerance [1] (SciPy's ``xtol``, ``ftol`` and ``gtol``) and largest number of evaluations of the
second least-squares problem of `_level_soles`, which has no regularisation. Chosen, not tuned."""


def _level_soles(
    robot: Robot, pose: Array, height: float, margin: float, *, centred: bool = True
) -> Array | None:
    """Compute joint positions (nu,) [rad, m] that place all contact points on level ground.

    Small distances from ``pose``, (nu,) [rad, m], are preferred. The base is ``height`` [m] above
    the ground. The wanted distance of the joints from the limits is ``margin`` [rad, m]. If
    ``centred``, the CoM is above the centre of the contact points. None if no accurate solution is
    found.
    """
    from scipy import optimize  # slow to import

    lower = np.clip(robot.lower_limits, -np.pi, np.pi)
    upper = np.clip(robot.upper_limits, -np.pi, np.pi)
    inset = np.minimum(margin, 0.4 * (upper - lower)) - _LIMIT_CLEARANCE
    points = list(robot.contact_radius)
    radii = np.array(list(robot.contact_radius.values()))

    @lru_cache(maxsize=1)  # least_squares evaluates errors and derivative at the same positions
    def configure(joints: bytes) -> Configuration:
        """Return the configuration at joint positions, the bytes of an array (nu,) [rad, m]."""
        return Configuration(robot, robot.make_qpos(np.frombuffer(joints)))

    def errors(joints: Array) -> Array:
        """Compute the contact points' heights, then the CoM's offset x, y if ``centred`` [m]."""
        config = configure(joints.tobytes())
        touching = config.foot_centres(points)
        com_offset = (config.center_of_mass() - touching.mean(axis=0))[: 2 * centred]
        return np.concatenate([touching[:, 2] - radii + height, com_offset])

    def derivative(joints: Array) -> Array:
        """Compute the Jacobian of ``errors``, shape (number of errors, nu) [m/rad, 1]."""
        config = configure(joints.tobytes())
        touching = config.foot_twist_jacobians(points)[:, :3, 6:]
        rows = slice(2 * centred)
        com_offset = config.com_jacobian()[rows, 6:] - touching.mean(axis=0)[rows]
        return np.concatenate([touching[:, 2], com_offset])

    found = optimize.least_squares(
        lambda joints: np.concatenate([errors(joints) / height, _POSE_WEIGHT * (joints - pose)]),
        np.clip(pose, lower + inset + _LIMIT_CLEARANCE, upper - inset - _LIMIT_CLEARANCE),
        lambda joints: np.concatenate(
            [derivative(joints) / height, _POSE_WEIGHT * np.eye(len(joints))]
        ),
        bounds=(lower + inset, upper - inset),
    ).x
    if np.abs(errors(found)).max() >= _MAX_SOLE_ERROR * height:
        return None
    # The regularisation leaves 1e-8 m, which a leg of two joints cannot remove at these positions.
    refined: Array = optimize.least_squares(
        lambda joints: errors(joints) / height,
        found,
        lambda joints: derivative(joints) / height,
        bounds=(lower + inset - _LIMIT_CLEARANCE, upper - inset + _LIMIT_CLEARANCE),
        max_nfev=_MAX_REFINEMENTS,
        xtol=_REFINED_TOLERANCE,
        ftol=_REFINED_TOLERANCE,
        gtol=_REFINED_TOLERANCE,
    ).x
    return refined


def _set_start(robot: Robot, joints: Array, height: float) -> Robot:
    """Return a robot with start joint positions (nu,) [rad, m] and a nominal base height [m]."""
    return replace(robot, home=np.concatenate([robot.home[:7], joints]), stand_height=height)


def _choose_start(runs: Iterable[Sequence[Robot]]) -> Robot | None:
    """Choose a start pose from series of robots at successive base heights, near the middle height.

    A start pose that remains within reach on soft ground is preferred. None if no robot has a
    nominal stand.
    """
    on_rigid_ground: Robot | None = None
    for starts in runs:
        middle = len(starts) // 2
        for number in sorted(range(len(starts)), key=lambda number: abs(number - middle)):
            stand = solve_nominal_stand(starts[number])
            if stand is None:
                continue
            if _is_within_reach_on_soft_ground(starts[number], stand):
                return starts[number]
            on_rigid_ground = on_rigid_ground or starts[number]
    return on_rigid_ground


def _is_within_reach_on_soft_ground(robot: Robot, stand: Stand) -> bool:
    """Return True if a stand remains within reach on soft ground, into which the feet sink.

    Other errors on soft ground, such as depths that do not converge, do not count.
    """
    try:
        solve_stand_on_soft_ground(robot, stand, explain=False)
    except StanceUnreachableError:
        return False
    except PupperAnalysisError:
        return True
    return True


def _search_poses(robot: Robot, poses: Sequence[Array]) -> Robot | None:
    """Search for a start pose near the middle of the base heights that are reached from poses.

    The poses are joint positions, (nu,) each [rad, m]. None if no stand is found.
    """

    def find_run(margin: float) -> list[Robot]:
        """Return a robot per stand of the longest series, with this stand as start pose.

        ``margin`` [rad, m] is the distance of the joints from the limits.
        """
        best: tuple[list[Stand], Robot] = [], robot
        for pose in poses:
            placed = _set_start(replace(robot, nominal=pose), pose, robot.stand_height)
            stands = _find_longest_run(placed, pose, margin, len(best[0]))
            best = max(best, (stands, placed), key=lambda found: len(found[0]))
        stands, placed = best
        return [
            _set_start(
                placed, stand.joint_positions(robot), round(float(stand.task.height or 0.0), 3)
            )
            for stand in stands
        ]

    return _choose_start(find_run(margin) for margin in _JOINT_MARGINS)


def _spread_feet(robot: Robot, pose: Array) -> Array:
    """Compute joint positions (nu,) [rad, m] with the feet below and beside the hips.

    Legs that are straight to the side, such as a spider's at zero angles, cannot reach the ground
    below their feet. The result is ``pose`` if inverse kinematics finds no solution.
    """
    qpos = robot.make_qpos(pose)
    config = Configuration(robot, qpos)
    feet = config.foot_positions()
    targets, drops, moved = dict(feet), [], set[str]()
    for limb in find_limbs(robot):
        if not len(limb.joints):  # a foot on the base
            continue
        names = {robot.joint_names[index] for index in limb.joints}
        first = next(name for name in robot.pin_model.names if name in names)
        hip = config.joint_position(first)
        for foot in limb.feet:
            out = feet[foot] - hip
            length = float(np.linalg.norm(out))
            aside = math.hypot(*out[:2])
            if not _MIN_SIDE_DISTANCE * length < aside < _MAX_SIDE_DISTANCE * length:
                outward = (
                    out
                    if aside > _MIN_SIDE_DISTANCE * length
                    else hip - np.mean([*feet.values()], axis=0)
                )
                targets[foot] = hip + _TARGET_SIDE_DISTANCE * length * outward / max(
                    math.hypot(*outward[:2]), 1e-9
                )
            drops.append(float(hip[2]) - _TARGET_FOOT_DEPTH * length)
        moved.update(limb.feet)
    for foot in moved:
        targets[foot] = np.array([*targets[foot][:2], min(drops)])
    found = find_branches(robot, qpos, targets, robot.lower_limits, robot.upper_limits)
    return next(combine_branches(found, pose), pose)


def _find_longest_run(robot: Robot, pose: Array, margin: float, known: int) -> list[Stand]:
    """Find the longest series of stands at successive base heights, from high to low.

    Args:
        robot: Robot.
        pose: Preferred joint positions, shape (nu,) [rad, m].
        margin: Distance of the joints from the limits [rad, m].
        known: Number of stands in the longest series for other poses. A series that is not longer
            may be returned incomplete.
    """
    length = compute_leg_length(robot, robot.make_qpos(pose))
    heights = [
        float(h)
        for h in length * np.linspace(_MAX_HEIGHT_FRACTION, _MIN_HEIGHT_FRACTION, _NUM_HEIGHTS)
        if h > 0
    ]

    def stand_at(height: float, guess: Stand | None = None) -> Stand | None:
        """Solve a stand at a base height [m] that is clear of the ground; None if not found."""
        joints = None if guess is None else guess.joint_positions(robot).tolist()
        task = StandTask(height=height, ik_seed=joints, joint_margin=margin)
        stand = _solve_near_pose(robot, task, pose)
        return stand if stand is not None and is_clear_of_ground(robot, stand) else None

    # Each longer run contains one of these heights.
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


def find_non_foot_contacts(robot: Robot, stand: Stand, sinkage: float) -> set[int]:
    """Return the ids of the geoms, except foot geoms, that touch the ground if a stand is lowered.

    Args:
        robot: Robot.
        stand: Stand.
        sinkage: Distance by which the base is lowered before contacts are evaluated [m].
    """
    qpos = stand.qpos.copy()
    qpos[2] -= sinkage
    model, data = robot.mj_model, robot.compute_kinematics(qpos)
    mujoco.mj_collision(model, data)
    touching = data.contact.geom[find_acting_contacts(data)]
    pairs = [pair for pair in touching if 0 in model.geom_bodyid[pair]]
    return {
        int(geom)
        for pair in pairs
        for geom in pair
        if model.geom_bodyid[geom] != 0 and geom not in robot.foot_geoms
    }


def list_foot_bodies(robot: Robot) -> set[int]:
    """Return the MuJoCo ids (``body_weldid``) of the bodies that carry the feet."""
    weld = robot.mj_model.body_weldid
    return {int(weld[body]) for body, _ in robot.contact_places.values()}


def is_clear_of_ground(robot: Robot, stand: Stand) -> bool:
    """Return True if no body is near the ground in a stand, except the bodies of the feet.

    A body is near the ground if it touches the ground with the base lowered by 1 cm.
    """
    model = robot.mj_model
    foot_bodies = list_foot_bodies(robot)
    return all(
        int(model.body_weldid[model.geom_bodyid[geom]]) in foot_bodies
        for geom in find_non_foot_contacts(robot, stand, _MIN_GROUND_CLEARANCE)
    )


def _solve_near_pose(robot: Robot, task: StandTask, pose: Array) -> Stand | None:
    """Solve a stand whose joints outside the legs (arms, waist) are near ``pose`` (nu,) [rad, m].

    These joints are reset between successive solves. None if no stand is found.
    """
    legs = np.concatenate([limb.joints for limb in find_limbs(robot)])
    try:
        robot.check_bodies()
        targets, found = compute_targets(robot, task, {}), None
    except PupperAnalysisError:  # empty joint range, or an invalid body
        return None
    first = [pose if task.ik_seed is None else np.array(task.ik_seed)]
    guesses: Iterable[Array] = itertools.chain(first, _yield_bent_legs(robot, targets, pose))
    with borrow(robot, SearchContext) as context:
        for _ in range(_MAX_RESET_PASSES):
            stand = _solve_first_guess(context, targets, guesses)
            if stand is None:
                return found
            found = stand
            joints = pose.copy()
            joints[legs] = found.joint_positions(robot)[legs]
            guesses = [joints]
    return found


def _yield_bent_legs(robot: Robot, targets: StandTargets, pose: Array) -> Iterator[Array]:
    """Yield initial guesses of joint positions (nu,) [rad, m] from inverse kinematics of the legs.

    The guesses combine IK branches of the legs, for example with the knee forwards or backwards.
    """
    qpos = robot.make_qpos(pose)
    qpos[:3] = (*targets.place, targets.height)
    found = find_branches(robot, qpos, targets.foot_targets, targets.lower, targets.upper)
    yield from itertools.islice(combine_branches(found, pose), _MAX_BRANCHES)


def _solve_first_guess(
    context: SearchContext, targets: StandTargets, guesses: Iterable[Array]
) -> Stand | None:
    """Solve a stand from the first initial guess (nu,) [rad, m] that succeeds; None without one.

    Two guesses that end at the same minimum of the foot errors may end the search.
    """
    misses: list[float] = []
    for joints in guesses:
        if (stand := search_from_joints(context, targets, joints)) is not None:
            return stand
        if not targets.com_is_free:
            continue
        stand, miss = solve_constraints(
            context,
            targets,
            make_initial_configuration(context.robot, targets, joints, targets.place),
        )
        if stand is not None and is_clear_of_ground(context.robot, stand):
            return stand
        if stand is None and miss > NEAR_MISS:
            if any(math.isclose(miss, known, rel_tol=_EQUAL_MISS_RTOL) for known in misses):
                return None
            misses.append(miss)
    return None


def compute_leg_length(robot: Robot, qpos: Array) -> float:
    """Compute the largest base height above the ground at which a leg would be straight.

    The height of a leg is about the length of the chain from its first joint to the contact point,
    plus the height of the base above this joint in ``qpos``, plus the radius of the contact sphere.

    Args:
        robot: Robot with feet.
        qpos: Configuration, shape (nq,), with a level base.

    Returns:
        Largest height of the legs [m].
    """
    config, model = Configuration(robot, qpos), robot.pin_model
    lengths = []
    for point, frame in robot.contact_frames.items():
        joint = model.frames[model.getFrameId(frame, pin.FrameType.BODY)].parentJoint
        radius, places = robot.contact_radius[point], [config.foot_positions()[point]]
        for index in reversed(list(model.supports[joint])):
            if model.names[index] in robot.joint_names:
                places.append(config.joint_position(model.names[index]))
        if len(places) > 1 and np.linalg.norm(places[0] - places[1]) < radius:
            places[0], radius = places[0] - (0.0, 0.0, radius), 0.0
        links = np.linalg.norm(np.diff(places, axis=0), axis=1).sum()
        lengths.append(float(links) - float(places[-1][2] - qpos[2]) + radius)
    return max(lengths)


def with_foot_contacts_only(robot: Robot) -> Robot:
    """Return a robot whose foot bodies collide with their foot geoms only, in the MuJoCo model.

    Contacts of a ``<pair>`` remain.
    """
    model, foot_bodies = copy.copy(robot.mj_model), list_foot_bodies(robot)
    for geom in range(model.ngeom):
        if (
            int(model.body_weldid[model.geom_bodyid[geom]]) in foot_bodies
            and geom not in robot.foot_geoms
        ):
            model.geom_contype[geom] = model.geom_conaffinity[geom] = 0
    return replace(robot, mj_model=model)


def rest_depth_from_keyframe(model: mujoco.MjModel, name: str) -> float | None:
    """Simulate an unmodified model from a keyframe; return its ground penetration at the end [m].

    Args:
        model: Model of the unmodified MJCF.
        name: Name of the keyframe; "keyframe 1" etc. for keyframes without a name.

    Returns:
        Largest penetration of a contact with the world. None if the model collapses, for example.
    """
    names = [model.key(key).name or f"keyframe {key + 1}" for key in range(model.nkey)]
    free = list_free_joints(model)
    if name not in names or len(free) != 1:
        return None
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, names.index(name))

    def advance(state: mujoco.MjData, seconds: float) -> None:
        """Simulate the model for ``seconds`` [s], in place."""
        mujoco.mj_step(model, state, nstep=round(seconds / float(model.opt.timestep)))

    with silence_mujoco():
        motion, end = simulate_keyframe(model, data, int(model.jnt_bodyid[free[0]]), 0.0, advance)
    if motion.collapses:
        return None
    grounded = (list_contact_bodies(model, end) == 0).any(axis=1)
    return max(0.0, -float(end.contact.dist[grounded].min(initial=0.0)))


def _list_objections(
    robot: Robot, name: str, joints: Mapping[str, float], *, stands: bool
) -> tuple[Diagnostic, ...]:
    """Return the reason why a keyframe is not used as the start pose: at most one message.

    Args:
        robot: Robot with feet.
        name: Name of the keyframe.
        joints: {joint: position [rad, m]} of the keyframe.
        stands: Whether the unmodified file stands from the keyframe. If not, only joints beyond
            their limits are reported.
    """
    subject = ("keyframe", name)
    values = np.array([joints.get(joint, 0.0) for joint in robot.joint_names])
    excess = np.abs(values - clip_to_limits(robot, joints))
    beyond = np.flatnonzero(excess > _LIMIT_ATOL)
    if not beyond.size:
        if not stands:
            return ()
        even = is_standing_pose(robot, joints)
        note_code = "keyframe-without-stand" if even else "keyframe-feet-uneven"
        return (diagnose(note_code, subject=subject),)
    names = [robot.joint_names[joint] for joint in beyond]
    worst = int(np.argmax(excess))
    most = Quantity(float(excess[worst]), joint_unit(robot, robot.joint_names[worst]))
    return (
        diagnose(
            "keyframe-beyond-limits",
            subject=subject,
            joints=names,
            excess=most,
            stands=stands,
            used=False,
        ),
    )


def find_start_pose(
    robot: Robot,
    known: Mapping[str, Mapping[str, float]],
    sunk: Mapping[str, float],
    rest_depth: Callable[[str], float | None] | None = None,
) -> tuple[Robot, list[Diagnostic]]:
    """Choose the start pose (`Robot.home`) of a robot: a keyframe, or else a searched pose.

    A keyframe with level feet and a nominal stand is preferred, then a keyframe from which the
    unmodified file stands in a simulation. If no pose is found, a note reports the failure.

    Args:
        robot: Robot with feet.
        known: {keyframe: {joint: position [rad, m]}}, in the order of the trials.
        sunk: {keyframe: penetration of the feet [m] at rest}, by which the base is lowered
            (`compute_resting_depths`).
        rest_depth: Function that returns the penetration of the feet [m] with which the unmodified
            file stands from a keyframe, or None if the file falls.

    Returns:
        Robot with the start pose, and notes on the choice of the pose.
    """
    whole, robot = robot, with_foot_contacts_only(robot)
    standing = {name: pose for name, pose in known.items() if is_standing_pose(robot, pose)}
    found = _find_keyframe_stand(robot, standing, sunk)
    against: list[Diagnostic] = []
    if found is None and rest_depth is not None:
        depths = {name: depth for name in known if (depth := rest_depth(name)) is not None}
        against = [
            note
            for number, (name, joints) in enumerate(known.items())
            if name in depths or number == 0  # other keyframes may be no stands, such as "down"
            for note in _list_objections(robot, name, joints, stands=name in depths)
        ]
        clipped = {
            name: dict(
                zip(robot.joint_names, clip_to_limits(robot, known[name]).tolist(), strict=True)
            )
            for name in depths
        }
        # A penetration bends straight legs slightly, so that they are not singular. A joint at its
        # limit may not let the feet sink in.
        sunk = {**sunk, **depths}
        found = _find_keyframe_stand(robot, clipped, sunk, also_without_depth=True)
        standing |= clipped
    if found is not None:
        name, tried = found
        notes = [diagnose("start-pose-is-keyframe", subject=("keyframe", name))]
        notes += [
            note
            for note in _mark_used_keyframe(against, name)
            if note.subject == notes[0].subject and note.code != "keyframe-without-stand"
        ]
        if tried.nominal.any():
            notes.append(diagnose("feet-placed-by-start-pose"))
        return _copy_start_pose(whole, tried), notes
    poses = [*(clip_to_limits(robot, pose) for pose in known.values()), clip_to_limits(robot)]
    bounded = np.isfinite(robot.lower_limits) & np.isfinite(robot.upper_limits)
    low, high = (np.where(bounded, x, 0.0) for x in (robot.lower_limits, robot.upper_limits))
    middle = (low + high) / 2
    searched = search_start(robot, [*poses, middle])
    if searched is None:  # keep the pose of the last keyframe, and report why it is rejected
        kept = whole
        if standing:
            name, pose = list(standing.items())[-1]
            home = np.array([pose.get(joint, 0.0) for joint in robot.joint_names])
            at_home = _set_start_pose(robot, home, sunk.get(name, 0.0))
            kept = _copy_start_pose(whole, replace(at_home, nominal=home))
            against = _mark_used_keyframe(against, name)
        return kept, [diagnose("no-start-pose"), *against, *report_sideways_limbs(whole)]
    height = Quantity(searched.stand_height, "m")
    notes = [diagnose("start-pose-found", height=height, keyframes=bool(known))]
    return _copy_start_pose(whole, searched), [*notes, *against]


def _mark_used_keyframe(notes: Iterable[Diagnostic], name: str) -> list[Diagnostic]:
    """Return notes in which keyframe ``name`` is marked as used if its joints exceed the limits."""
    return [
        replace(note, values=FrozenDict({**note.values, "used": True}))
        if note.code == "keyframe-beyond-limits" and note.subject == Subject("keyframe", name)
        else note
        for note in notes
    ]


def _find_keyframe_stand(
    robot: Robot,
    poses: Mapping[str, Mapping[str, float]],
    sunk: Mapping[str, float],
    *,
    also_without_depth: bool = False,
) -> tuple[str, Robot] | None:
    """Find a keyframe with whose joint positions the nominal stand exists; None without one.

    Args:
        robot: Robot with feet.
        poses: {keyframe: {joint: position [rad, m]}}, in the order of the trials.
        sunk: {keyframe: penetration of the feet [m] at rest}.
        also_without_depth: Whether keyframes in ``sunk`` are also tried without penetration.

    Returns:
        Name of the keyframe, and robot with the start pose.
    """
    for name, pose in poses.items():
        home = np.array([pose.get(joint, 0.0) for joint in robot.joint_names])
        at_home = _set_start_pose(robot, home, sunk.get(name, 0.0))
        starts = [replace(at_home, nominal=home)]
        if name not in sunk:
            starts.insert(0, replace(at_home, nominal=np.zeros(robot.nu)))
        elif also_without_depth:
            starts.append(replace(_set_start_pose(robot, home, 0.0), nominal=home))
        for start in starts:
            if solve_nominal_stand(start) is not None:
                return name, start
    return None


def make_start_keyframe(
    robot: Robot, stand: Stand, reason: Diagnostic, kp: Array | None = None, kd: Array | None = None
) -> StartKeyframe:
    """Create the keyframe of a stand: qpos, and the ctrl with which servos hold the stand.

    The ctrl contains the static torques as feed-forward. The base is moved to x = y = 0.

    Args:
        robot: Robot with servos.
        stand: Stand on soft ground.
        reason: Note that explains the keyframe.
        kp: Servo stiffness, shape (nu,) [N m/rad, N/m]; None: value of the robot.
        kd: Servo damping, shape (nu,) [N m s/rad, N s/m]; None: value of the robot.

    Raises:
        ModelError: If a joint has no servo or motor, for example.
        StaticsInfeasibleError: If no contact forces balance the stand.
    """
    qpos = round_start_configuration(robot, stand)
    torques = stand_statics(robot, stand).joint_torques
    drive, data = model_with_servos(robot, kp, kd), mujoco.MjData(robot.mj_model)
    robot.mj_convention.set_state(data, qpos)
    ctrl = np.round(drive.command(robot, qpos[-robot.nu :], torques), _NUM_KEYFRAME_DIGITS)
    return StartKeyframe(reason, tuple(data.qpos.tolist()), tuple(ctrl.tolist()))


def round_start_configuration(robot: Robot, stand: Stand) -> Array:
    """Return the rounded configuration of a stand for a keyframe, shape (nq,), with x = y = 0.

    Base height [m] and joint positions [rad, m] are rounded to six decimals
    (`_NUM_KEYFRAME_DIGITS`). The quaternion is not rounded.
    """
    qpos = stand.qpos.copy()
    qpos[:2] = 0.0
    qpos[2] = round(float(qpos[2]), _NUM_KEYFRAME_DIGITS)
    qpos[-robot.nu :] = np.round(qpos[-robot.nu :], _NUM_KEYFRAME_DIGITS)
    return qpos


def _set_start_pose(robot: Robot, joints: Array, sunk: float) -> Robot:
    """Set joint positions (nu,) [rad, m] as start pose, with the lowest foot ``sunk`` [m] deep.

    The base is level; its height in the nominal stand is set accordingly.
    """
    qpos = robot.make_qpos(joints)
    places = Configuration(robot, qpos).foot_positions()
    height = max(robot.contact_radius[foot] - float(place[2]) for foot, place in places.items())
    return replace(robot, home=qpos, stand_height=round(height - sunk, 9) if sunk else height)


def _copy_start_pose(source: Robot, posed: Robot) -> Robot:
    """Return a copy of ``source`` with the start pose and nominal joint positions of ``posed``.

    The start pose becomes a keyframe of the MJCF. Both robots must have the same joints.
    """
    spec = source.description.mjcf.copy()
    data = mujoco.MjData(source.mj_model)
    home = posed.home.copy()
    home[:7] = (0.0, 0.0, posed.stand_height, 1.0, 0.0, 0.0, 0.0)
    source.mj_convention.set_state(data, home)
    SpecTree(spec).set_home(data.qpos)
    nominal = dict(zip(posed.joint_names, posed.nominal.tolist(), strict=True))
    return replace(
        source,
        description=replace(source.description, mjcf=spec, nominal=nominal),
        home=home,
        nominal=posed.nominal,
        stand_height=posed.stand_height,
    )
