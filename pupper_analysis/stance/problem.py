"""Convert a stand task to numeric targets and limits for one robot.

Targets are foot positions, base pose and CoM position; limits are joint limits.

`compute_targets` combines a robot and a `StandTask` into `StandTargets`. The function places the
contact points on the ground and determines the support region. It rejects some tasks that no stand
can satisfy, for example with a CoM outside the support region. Positions are in the world frame.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from pupper_analysis.base import lapack
from pupper_analysis.base.arguments import suggest_degrees, suggest_millimetres
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Quantity, Vector, diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.frozen import FrozenDict, freeze_arrays
from pupper_analysis.robot.configuration import UP, Configuration
from pupper_analysis.robot.ground import Ground
from pupper_analysis.robot.joints import check_in_range, resolve_posture, with_units
from pupper_analysis.robot.plane import Bar
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.touching import with_contacts
from pupper_analysis.stance.task import StandTask
from pupper_analysis.statics.contacts import list_grips, prescribed_forces
from pupper_analysis.statics.support_polygon import Corner, margin_of_position, support_corners

_MIN_SUPPORT_WIDTH = 1e-3
"""Width of the support region [m], below which the contacts count as collinear, and the task is
rejected. The width is the smaller singular value of the corners minus their mean. Chosen, not
tuned."""


_FIXED_COORDINATES = {1: 3, 2: 5}
"""{number of contact points of a foot: number of degrees of freedom of the foot that planted points
fix}; 6 for three or more points."""


_NUM_RANDOM_POSES = 3
"""Upper bound of the number of random joint positions at which `can_move_com` tests the mobility of
the CoM, if each foot is a single point. A single configuration may be singular. Chosen, not
tuned."""

_MIN_COM_RATE = 1e-6
"""Horizontal CoM displacement [m] per unit displacement of base and joints (norm, rad and m mixed),
above which a robot with planted feet can move the CoM in a direction. Chosen, not tuned."""

_MIN_COM_RATE_RATIO = 1e-3
"""Ratio [1] of the CoM displacements per unit displacement in two horizontal directions, above
which a robot with planted feet can move the CoM in both directions. Soles that are a microradian
off level cause smaller ratios. Chosen, not tuned."""


def has_redundant_joints(robot: Robot) -> bool:
    """Return True if nv exceeds the number of coordinates that held poses of base and feet fix.

    Loops and couplings are ignored.
    """
    fixed = sum(_FIXED_COORDINATES.get(len(points), 6) for points in robot.feet.values())
    return 6 + fixed < robot.nv


def can_move_com(robot: Robot) -> bool:
    """Return True if the legs can move the CoM in both horizontal directions, with planted feet.

    The base keeps height and orientation. Joints that move no foot (neck, arms) do not count. Also
    True for a robot without contact points.
    """
    return robot.compute_once(_compute_com_mobility)


def _compute_com_mobility(robot: Robot) -> bool:
    """Return the result of `can_move_com`, uncached."""
    if not robot.contact_points:
        return True
    if len(robot.feet) < len(robot.contact_points):
        # In random poses soles and wheels would not lie on the ground.
        poses = robot.nominal, robot.home[-robot.nu :]
        return any(_count_com_directions(robot, pose) == 2 for pose in poses)
    random = np.random.default_rng(0)
    low, high = np.maximum(robot.lower_limits, -np.pi), np.minimum(robot.upper_limits, np.pi)
    random_poses = (random.uniform(low, np.maximum(low, high)) for _ in range(_NUM_RANDOM_POSES))
    return any(_count_com_directions(robot, pose) == 2 for pose in random_poses)


def _count_com_directions(robot: Robot, joints: Array) -> int:
    """Return the number (0 to 2) of horizontal directions in which planted legs move the CoM."""
    config = Configuration(robot, robot.make_qpos(joints))
    held = np.eye(4, robot.nv, k=2)  # base height and orientation
    feet = np.vstack(list(config.foot_jacobians().values()))
    moving = feet.any(axis=0)
    free = lapack.null_space(np.vstack([held, feet])[:, moving], rcond=1e-9)
    moved = config.com_jacobian()[:2, moving] @ free
    sizes = np.linalg.svd(moved, compute_uv=False)
    smallest = max(_MIN_COM_RATE, _MIN_COM_RATE_RATIO * float(sizes.max(initial=0.0)))
    return int((sizes > smallest).sum())


class Support:
    """Support region of contacts (`support_corners`), computed at first access.

    Several `StandTargets` may share an object of this class.

    Args:
        contacts: Contact points, shape (n, 3) [m].
        normals: Unit normals out of the ground, shape (n, 3).
        friction: Sliding friction coefficients, shape (n,); empty if unknown.
        stated: Prescribed contact forces: groups of contact points, and the total normal force of
            each group (argument of `support_corners`).
        grips: Positions and force limits of grips (argument of `support_corners`).
    """

    def __init__(
        self,
        contacts: Array,
        normals: Array,
        friction: Sequence[float],
        stated: tuple[Array, Array] | None = None,
        grips: Array | None = None,
    ) -> None:
        self._arguments = contacts, normals, friction, stated, grips

    @cached_property
    def corners(self) -> tuple[Corner, ...]:
        """Points (x, y) [m], in the world frame, whose convex hull is the support region."""
        return support_corners(*self._arguments)


@dataclass(frozen=True, eq=False)
class StandTargets:
    """Stand task converted to numbers for one robot: targets, base pose and joint limits.

    Do not change the arrays, since objects of this class share arrays.

    Attributes:
        task: Task, with height and CoM filled in.
        foot_targets: {contact point: target of the sphere centre, shape (3,) [m]}.
        depths: {stance foot: penetration of the ground at the target [m]}.
        stance_feet: Contact points that carry load. They are the keys of ``depths``,
            ``contact_by_foot`` and ``normals``.
        contacts: Positions of the contacts of the n stance feet, shape (n, 3) [m].
        contact_by_foot: {stance foot: position of the contact, shape (3,) [m]}.
        normals: {stance foot: unit normal out of the ground, shape (3,)}.
        support: Support region.
        centre: Reference point of the stand, shape (3,) [m]: in general the mean of the contacts
            (`feet_centre`).
        height: Height of the base frame [m].
        base_quaternion: Orientation of the base (w, x, y, z).
        place: Horizontal target of the CoM, or of the base if ``by_base``, shape (2,) [m].
        by_base: Whether ``place`` is the target of the base.
        lower: Lower joint limits plus margin, shape (nu,) [rad, m]. For a joint in the task's
            posture, both limits are the position in the posture.
        upper: Upper joint limits minus margin, shape (nu,) [rad, m].
        loop_opening: Opening of closed loops by static deflection, one value per equation [m, rad];
            None if loops are closed exactly.
    """

    task: StandTask
    foot_targets: FrozenDict[str, Array]
    depths: FrozenDict[str, float]
    stance_feet: tuple[str, ...]
    contacts: Array
    contact_by_foot: FrozenDict[str, Array]
    normals: FrozenDict[str, Array]
    support: Support
    centre: Array
    height: float
    base_quaternion: tuple[float, float, float, float]
    place: Array
    by_base: bool
    lower: Array
    upper: Array
    loop_opening: Array | None = None

    @property
    def corners(self) -> tuple[Corner, ...]:
        """Points (x, y) [m], in the world frame, whose convex hull is the support region."""
        return self.support.corners

    @property
    def rigid_targets(self) -> Mapping[str, Array]:
        """Targets of the contact points, from which the ground below the feet is computed.

        {contact point: target of the sphere centre, shape (3,) [m], in the world frame}. If a foot
        has a separate plane, the targets are those without penetration (`remove_penetration`).
        """
        return remove_penetration(self.task.ground, self.foot_targets, self.depths, self.normals)

    @property
    def com_is_free(self) -> bool:
        """Whether neither CoM nor base has a required horizontal position."""
        return self.task.com == "inside" and not self.by_base


def compute_targets(
    robot: Robot,
    task: StandTask | None,
    depths: Mapping[str, float],
    like: StandTargets | None = None,
    *,
    checked: bool = True,
) -> StandTargets:
    """Compute the targets and limits of a stand task for a robot: feet, base pose, CoM and joints.

    Args:
        robot: Robot.
        task: Stand task. Default: the nominal stand, ``StandTask()``.
        depths: {contact point that carries load: penetration of the ground [m]}; 0 for points that
            are not included.
        like: Targets of the same robot with the same depths. Parts are reused if the task has equal
            requirements, which saves time. Default: targets of the nominal stand, if possible.
        checked: If True, also reject tasks with, for example, a CoM outside the support region.

    Raises:
        ConfigurationError: If the base is fixed, or the task is rejected, for example.
        UnknownNameError: If the task contains an unknown foot or joint.
    """
    com, nominal, limits = robot.compute_once(_make_defaults)
    # A caller may have changed the limits of the model.
    if like is None and not depths and limits == _list_position_limits(robot):
        like = nominal
        if task is None and like is not None:
            return like
    if task is None:
        task = StandTask()
    if task.ik_seed is not None and len(task.ik_seed) != robot.nu:
        raise ConfigurationError("ik_seed", diagnose("seed-length-wrong", joints=robot.nu))
    return _build_targets(robot, task, com, depths, like, checked=checked)


def _list_position_limits(robot: Robot) -> list[list[float]]:
    """Return Pinocchio's position limits as lists, which compare faster than arrays."""
    model = robot.pin_model
    return [model.lowerPositionLimit.tolist(), model.upperPositionLimit.tolist()]


class _Defaults(NamedTuple):
    """Values of a robot's default stand task (nominal stand), computed once per robot.

    Attributes:
        com: CoM requirement: ``centre`` or ``inside``.
        targets: Targets of the nominal stand; None if they cannot be computed.
        limits: Pinocchio's position limits when the targets were computed.
    """

    com: str
    targets: StandTargets | None
    limits: list[list[float]]


def _make_defaults(robot: Robot) -> _Defaults:
    """Compute a robot's default CoM requirement, targets of the nominal stand, and joint limits."""
    com = "centre" if not robot.floating or can_move_com(robot) else "inside"
    limits = _list_position_limits(robot)
    try:
        return _Defaults(com, _build_targets(robot, StandTask(), com, {}, None), limits)
    except ConfigurationError:
        return _Defaults(com, None, limits)


def _build_targets(
    robot: Robot,
    task: StandTask,
    com: str,
    depths: Mapping[str, float],
    like: StandTargets | None,
    *,
    checked: bool = True,
) -> StandTargets:
    """Convert a task to targets for a robot, and reuse parts of existing targets ``like``.

    ``com`` is the CoM requirement if the task specifies neither CoM nor offset: "centre" or
    "inside".
    """
    if task.contacts:
        task = _add_planes(robot, task)
    if like is not None and _have_equal_feet(like.task, task):
        stance_feet, contacts, foot_targets = like.stance_feet, like.contacts, like.foot_targets
        contact_by_foot, normals, deep = like.contact_by_foot, like.normals, like.depths
        support, centre = like.support, like.centre
    else:
        stance_feet = select_stance_feet(robot, task)
        out = ground_normals(robot, task.ground)
        places = compute_foot_targets(robot, task)
        contacts = np.array(
            [places[foot] - robot.contact_radius[foot] * out[foot] for foot in stance_feet]
        ).reshape(-1, 3)
        deep = FrozenDict({foot: float(depths.get(foot, 0.0)) for foot in stance_feet})
        foot_targets = freeze_arrays(add_penetration(robot, places, deep, out))
        contact_by_foot = freeze_arrays(dict(zip(stance_feet, contacts, strict=True)))
        normals = freeze_arrays({foot: out[foot] for foot in stance_feet})
        grip = [robot.contacts[foot].sliding_friction for foot in stance_feet if robot.contacts]
        stated = prescribed_forces(robot, stance_feet)
        held = list_grips(robot, foot_targets) if robot.grips else None
        support = Support(contacts, np.array([*normals.values()]), grip, stated, held)
        if checked and not robot.is_welded:  # a weld holds any CoM
            _check_support_area(robot, np.array(support.corners), stance_feet)
        centre = feet_centre(robot, task.ground, contact_by_foot, foot_targets)
    task = _fill_task(robot, task, com)
    assert task.height is not None
    assert task.com is not None
    if like is not None and _have_equal_limits(like.task, task):
        lower, upper = like.lower, like.upper
    else:
        lower, upper = _compute_joint_limits(robot, task, checked=checked)
    armed = len(robot.hands) == len(robot.feet)  # the base of an arm has a fixed position
    place, by_base = centre[:2], armed and isinstance(task.com, str)
    if task.offset is not None:
        place, by_base = place + task.offset, True
    elif not isinstance(task.com, str):
        place = np.array(task.com)
    # The centre is not checked: on a common plane it is inside the support region.
    at_centre = by_base or (isinstance(task.com, str) and task.com_margin == 0.0)
    if checked and not at_centre and not robot.is_welded:
        _check_com_place(task, place, support.corners)
    return StandTargets(
        task=task,
        foot_targets=foot_targets,
        depths=deep,
        stance_feet=stance_feet,
        contacts=contacts,
        contact_by_foot=contact_by_foot,
        normals=normals,
        support=support,
        centre=centre,
        height=float(centre[2]) + task.height,
        base_quaternion=task.base_quaternion(),
        place=place,
        by_base=by_base,
        lower=lower,
        upper=upper,
    )


def feet_centre(
    robot: Robot,
    ground: Ground,
    contact_by_foot: Mapping[str, Array],
    foot_targets: Mapping[str, Array],
) -> Array:
    """Compute the reference point (3,) [m] of a stand: mean of the stance contacts, world frame.

    Welded and gripping feet count as contacts. If other contacts remain, hands and feet on steep
    planes are left out, and feet on separate planes do not count for the height. If all feet are
    lifted, the point is the horizontal mean of all targets, at z = 0. For an arm (a robot with a
    weld or grip, and without feet other than hands), it is the point at z = 0 below the base in the
    home pose.

    Args:
        robot: Robot.
        ground: Ground.
        contact_by_foot: {contact point that carries load: position of the contact, shape (3,) [m]}.
        foot_targets: {contact point: target of the sphere centre, shape (3,) [m]}.
    """
    if robot.fixed_parts:
        if len(robot.hands) == len(robot.feet):
            return np.array([*robot.home[:2], 0.0])
        held = (point for foot in robot.fixed_parts for point in robot.feet.get(foot, ()))
        radius = robot.contact_radius
        contact_by_foot = {
            **contact_by_foot,
            **{point: foot_targets[point] - radius[point] * UP for point in held},
        }
    stance_feet, contacts = [*contact_by_foot], np.array([*contact_by_foot.values()])
    if not contact_by_foot:  # all feet are lifted
        return np.array([*np.mean([*foot_targets.values()], axis=0)[:2], 0.0])
    centre: Array = contacts.mean(axis=0)
    steep = [foot for foot in ground.planes if ground.normal(foot)[2] < MIN_SUPPORT_NORMAL_Z]
    for left_out, parts in (((*robot.hands, *steep), slice(None)), (ground.planes, slice(2, 3))):
        kept = [robot.foot_of(foot) not in left_out for foot in stance_feet] if left_out else []
        if any(kept) and not all(kept):  # a foot high on a wall does not raise the base
            centre[parts] = contacts[kept, parts].mean(axis=0)
    return centre


def _compute_joint_limits(robot: Robot, task: StandTask, *, checked: bool) -> tuple[Array, Array]:
    """Return the lower and upper joint limits (nu,) [rad, m] of a task, narrowed by its margin.

    If a joint is in the task's posture, both limits are its position in the posture.
    """
    lower = robot.lower_limits + task.joint_margin
    upper = robot.upper_limits - task.joint_margin
    if checked and (lower > upper).any():
        name = robot.joint_names[int(np.argmax(lower - upper))]
        margin = Quantity(task.joint_margin, "rad")
        written = suggest_degrees(task.joint_margin, 0.0, math.pi)
        problem = diagnose("margin-leaves-no-range", margin=margin, joint=name, written=written)
        raise ConfigurationError("joint_margin", problem)
    for joint, position in resolve_posture(robot, task.posture).items():
        index = robot.joint_names.index(joint)
        if checked:
            ends = float(lower[index]), float(upper[index])
            check_in_range(robot, joint, position, ends, "posture")
        lower[index] = upper[index] = position
    return lower, upper


_PROPOSED_INSET = 1e-4
"""Distance [m], in addition to the required margin, of the CoM position that an error message
proposes from the edge of the support region, if the region is large enough. Chosen, not tuned."""


def _check_com_place(task: StandTask, place: Array, corners: tuple[Corner, ...]) -> None:
    """Raise an error if a CoM target (x, y) [m] has less margin than the task requires."""
    inside = margin_of_position((float(place[0]), float(place[1])), corners)
    if inside < min(task.com_margin, 0.0):
        there, outside = Vector((place[0], place[1]), "m"), Quantity(-inside, "m")
        import shapely.ops  # slow to import

        hull = shapely.MultiPoint(corners).convex_hull
        kept = hull.buffer(-max(task.com_margin, 0.0) - _PROPOSED_INSET)
        near, _ = shapely.ops.nearest_points(
            hull.centroid if kept.is_empty else kept, shapely.Point(place[:2])
        )
        inner = Vector((round(near.x, 5), round(near.y, 5)), "m")
        problem = diagnose(
            "place-outside-polygon",
            place=there,
            distance=outside,
            nearest=inner,
            written=suggest_millimetres(*place[:2]),
        )
        raise ConfigurationError("com", problem)
    if inside < task.com_margin:
        margin, most = Quantity(task.com_margin, "m"), Quantity(math.floor(1e5 * inside) / 1e5, "m")
        written = suggest_millimetres(task.com_margin)
        problem = diagnose("margin-exceeds-polygon", margin=margin, most=most, written=written)
        raise ConfigurationError("com_margin", problem)


def _fill_task(robot: Robot, task: StandTask, com: str) -> StandTask:
    """Complete a task with default height, CoM requirement, and units of the posture.

    ``com`` is the default CoM requirement of a task without offset.
    """
    if task.posture:
        task = replace(task, posture=with_units(robot, task.posture)).replace_unchecked(
            ground=task.ground
        )
    if task.height is None:
        task = replace(task, height=robot.base_height).replace_unchecked(ground=task.ground)
    return (
        task if task.com else task.replace_unchecked(com=com if task.offset is None else "centre")
    )


def _have_equal_limits(first: StandTask, second: StandTask) -> bool:
    """Return True if two tasks have equal joint margins, and equal postures in equal order."""
    postures = [*first.posture.items()] == [*second.posture.items()]
    return first.joint_margin == second.joint_margin and postures


def _have_equal_feet(first: StandTask, second: StandTask) -> bool:
    """Return True if two tasks have equal ground, contacts, foot positions and swing heights."""
    return (first.ground, first.feet, first.foot_offsets, first.swing, first.contacts) == (
        second.ground,
        second.feet,
        second.foot_offsets,
        second.swing,
        second.contacts,
    )


def _check_support_area(robot: Robot, corners: Array, stance_feet: Sequence[str]) -> None:
    """Raise an error if the support region with corners (n, 2) [m] is too narrow."""
    # A robot on grips alone has no corners if the grips cannot carry the weight.
    seen = corners - corners.mean(axis=0) if len(corners) > 1 else np.zeros((2, 2))
    if np.linalg.svd(seen, compute_uv=False)[1] < _MIN_SUPPORT_WIDTH:
        if not stance_feet:
            problem = diagnose("grips-without-area", robot=robot.name, grips=[*robot.grips])
            raise ConfigurationError("contacts", problem)
        raise ConfigurationError(
            "swing" if len(stance_feet) < len(robot.contact_points) else "robot",
            diagnose("touches-along-line", robot=robot.name, feet=stance_feet),
        )


def select_stance_feet(robot: Robot, task: StandTask) -> tuple[str, ...]:
    """Select the contact points that carry load in a task, after checks of robot and names.

    Raises:
        ConfigurationError: If the base is fixed, or fewer than three contact points carry load and
            the robot has no weld or grip, for example.
        ModelError: If the base is fixed due to a fault in a model file.
        UnknownNameError: If the task contains an unknown foot.
    """
    robot.check_floating()
    if not (robot.contact_points or robot.fixed_parts):
        notes = (note for note in robot.notes if note.code == "base-free-without-feet")
        why = next((note.values["why"] for note in notes), None)
        raise ConfigurationError("robot", diagnose("no-feet", robot=robot.name, why=why))
    if not robot.gravity[2] < 0:
        gravity = Vector(tuple(robot.gravity), "m/s^2")
        raise ConfigurationError("robot", diagnose("gravity-not-down", gravity=gravity))
    if task.contacts and with_contacts(robot, task.contacts) is not robot:
        raise ConfigurationError("contacts", diagnose("made-for-other-contacts", robot=robot.name))
    for foot in (*task.feet, *task.foot_offsets, *task.swing, *task.ground.heights):
        robot.points_of(foot)
    swinging = {point for foot in task.swing for point in robot.feet[foot]}
    stance_feet = tuple(foot for foot in robot.bearing_points if foot not in swinging)
    if robot.fixed_parts:
        return stance_feet
    if len(robot.contact_points) < 3:
        raise ConfigurationError(
            "robot",
            diagnose(
                "too-few-points",
                robot=robot.name,
                count=len(robot.contact_points),
                feet=tuple(robot.contact_points),
            ),
        )
    if len(stance_feet) < 3:
        raise ConfigurationError("swing", diagnose("three-feet-must-carry", count=len(stance_feet)))
    return stance_feet


_NUM_FIT_ITERATIONS = 4
"""Number of iterations of the fit of a plane to the contact points of a sole. Iterations are needed
since the contact points of spheres with unequal radii depend on the normal of the plane. Chosen,
not tuned."""

MIN_SUPPORT_NORMAL_Z = 0.5
"""Lower bound of the vertical component [1] of the unit normal of a plane that supports a foot: 60
deg from level ground. Feet on steeper planes are left out of the mean position of the feet, if
possible. Chosen, not tuned."""

_COLLINEAR_TOLERANCE = 1e-9
"""Extent [m] of a sole's contact points perpendicular to a fitted line, below which the points
count as collinear: second singular value of the centred points. Chosen, not tuned."""


def nominal_point_positions(robot: Robot) -> dict[str, Array]:
    """Return {contact point: sphere centre (3,) [m]} in the nominal pose, in the world frame.

    The base is upright at the origin, and the joints are at ``robot.nominal``.
    """
    return {point: place.copy() for point, place in robot.compute_once(_compute_nominal_points)}


def _compute_nominal_points(robot: Robot) -> tuple[tuple[str, Array], ...]:
    """Return (contact point, sphere centre (3,) [m]) in the nominal pose, base at the origin."""
    qpos = robot.make_qpos(robot.nominal)
    return tuple(Configuration(robot, qpos).foot_positions().items())


def nominal_foot_positions(robot: Robot) -> dict[str, Array]:
    """Return {foot: horizontal position in the nominal pose, shape (2,) [m]}, in the world frame.

    The position is the mean of the foot's sphere centres, with the base upright at the origin.
    """
    places = nominal_point_positions(robot)
    return {
        foot: (
            np.mean([places[point][:2] for point in points], axis=0)
            if len(points) > 1
            else places[points[0]][:2]
        )
        for foot, points in robot.feet.items()
    }


def foot_positions_of_task(robot: Robot, task: StandTask) -> dict[str, Array]:
    """Return {foot: horizontal position (2,) [m], in the world frame} that a task requires.

    The position is that in the ``feet`` of the task, or else the position in the nominal pose
    (`nominal_foot_positions`), plus the ``foot_offsets`` of the task.
    """
    nominal = nominal_foot_positions(robot)
    return {
        foot: np.array(task.feet.get(foot, place)) + task.foot_offsets.get(foot, 0.0)
        for foot, place in nominal.items()
    }


def compute_foot_targets(robot: Robot, task: StandTask) -> dict[str, Array]:
    """Compute {contact point: target of its sphere centre, (3,) [m]} for a task on rigid ground.

    Targets are in the world frame. A sole is laid on its plane or slope by the shortest rotation
    from the nominal pose. Swing feet are raised by the heights in the task's ``swing``.
    """
    nominal, ground = nominal_point_positions(robot), task.ground
    foot_targets: dict[str, Array] = {}
    for foot, place in foot_positions_of_task(robot, task).items():
        points = robot.feet[foot]
        if foot in ground.planes:
            foot_targets |= _place_on_plane(robot, task, foot, place)
            continue
        if foot in robot.hands and foot in task.contacts:  # welded
            foot_targets[points[0]] = _requested_position(robot, task, foot, place)
        elif len(points) == 1:
            foot_targets[points[0]] = ground.centre(foot, place, robot.contact_radius[points[0]])
        else:
            sole = np.array([nominal[point] for point in points])
            radii = np.array([robot.contact_radius[point] for point in points])
            out = ground.normal(foot)
            laid = _lay_sole(sole, radii, out)
            on = laid.mean(axis=0)
            shift = np.array([*(place - on[:2]), ground.height(place, foot) - ground.height(on)])
            foot_targets |= dict(zip(points, laid + shift, strict=True))
        for point in points:
            foot_targets[point] += task.swing.get(foot, 0.0) * UP
    return {point: foot_targets[point] for point in robot.contact_points}


def _place_on_plane(robot: Robot, task: StandTask, foot: str, place: Array) -> dict[str, Array]:
    """Compute {contact point: target of its sphere centre, (3,) [m]} at a foot's separate plane."""
    points = robot.feet[foot]
    on = task.ground.planes[foot].project(_requested_position(robot, task, foot, place))
    out = task.ground.normal(foot)
    radii = np.array([robot.contact_radius[point] for point in points])
    on += task.swing.get(foot, 0.0) * out
    if len(points) == 1:
        return {points[0]: on + radii[0] * out}
    nominal = nominal_point_positions(robot)
    laid = _lay_sole(np.array([nominal[point] for point in points]), radii, out)
    middle: Array = (laid - radii[:, None] * out).mean(axis=0)
    return dict(zip(points, laid + on - middle, strict=True))


def _requested_position(robot: Robot, task: StandTask, foot: str, place: Array) -> Array:
    """Return the requested position (3,) [m] of a contact on a separate plane, or of a welded hand.

    ``place`` is the horizontal position of the foot in the task, shape (2,) [m].
    """
    if task.contacts[foot].place is not None or foot in robot.hands:
        near = np.array(task.contacts[foot].place or default_contact_position(robot, foot).tolist())
        near[:2] += place - nominal_foot_positions(robot)[foot]
        return near
    if isinstance(bar := task.contacts[foot].plane, Bar):
        return np.array(bar.point_above(*place.tolist()))
    return np.array((*place, task.ground.height(place, foot)))


def _add_planes(robot: Robot, task: StandTask) -> StandTask:
    """Return a copy of a task in which the ground contains the separate planes of the contacts."""
    planes = {}
    for foot, place in foot_positions_of_task(robot, task).items():
        plane = task.contacts[foot].plane if foot in task.contacts else None
        if plane is not None:
            planes[foot] = plane.contact_plane(
                _requested_position(robot, task, foot, place).tolist()
            )
    return task.replace_unchecked(ground=task.ground.with_planes(planes))


def default_contact_position(robot: Robot, foot: str) -> Array:
    """Return the default position (3,) [m] of a foot's contact, or of a hand.

    Positions are in the world frame. The contact of a foot is at z = 0. The position of a hand is
    its sphere centre in the home pose at the default base height.
    """
    if foot in robot.hands:
        return robot.compute_once(_compute_home_points)[robot.feet[foot][0]].copy()
    return np.array((*nominal_foot_positions(robot)[foot], 0.0))


def _compute_home_points(robot: Robot) -> dict[str, Array]:
    """Return {contact point: sphere centre (3,) [m]} with the joints of the home pose.

    The base is above the world origin at the default height, without rotation.
    """
    qpos = robot.make_qpos(robot.home[robot.nq - robot.nu :])
    qpos[2] = robot.base_height
    return Configuration(robot, qpos).foot_positions()


def _lay_sole(sole: Array, radii: Array, normal: Array) -> Array:
    """Lay a sole, as a rigid body, on a plane through the origin.

    ``normal`` is the unit normal of the plane. ``sole`` and the result are sphere centres, shape
    (n, 3) [m].
    """
    out = UP
    for _ in range(_NUM_FIT_ITERATIONS):
        out = _fit_upward_normal(sole - radii[:, None] * out)
    turn = pin.Quaternion.FromTwoVectors(out, normal).matrix()
    middle = sole.mean(axis=0)
    turned: Array = (sole - middle) @ turn.T
    lifted: Array = turned - (turned @ normal - radii).mean() * normal
    return lifted


def _fit_upward_normal(points: Array) -> Array:
    """Fit a plane, or a line, to points (n, 3), and return the upward unit normal (3,)."""
    _, sizes, axes = np.linalg.svd(points - points.mean(axis=0))
    if sizes[1] < _COLLINEAR_TOLERANCE:  # a line: the upward normal nearest to vertical
        normal = UP - (UP @ axes[0]) * axes[0]
    else:
        normal = axes[2] * np.sign(axes[2][2] or 1.0)
    result: Array = normal / np.linalg.norm(normal)
    return result


def ground_normals(robot: Robot, ground: Ground) -> dict[str, Array]:
    """Return {contact point: unit normal (3,) out of the ground at the point}, world frame."""
    if not ground.planes:
        return dict.fromkeys(robot.contact_points, ground.normal())
    out = {point: ground.normal(foot) for foot, points in robot.feet.items() for point in points}
    return {point: out[point] for point in robot.contact_points}


def add_penetration(
    robot: Robot,
    foot_targets: Mapping[str, Array],
    depths: Mapping[str, float],
    normals: Mapping[str, Array],
) -> dict[str, Array]:
    """Move the targets of contact sphere centres into the ground by given penetrations.

    A sole moves as a rigid body, by the least-squares fit to the depths of its contact points.

    Args:
        robot: Robot.
        foot_targets: {contact point: target on rigid ground, shape (3,) [m]}.
        depths: {contact point: penetration [m]}; 0 for points that are not included.
        normals: {contact point: unit normal out of the ground, shape (3,)}.

    Returns:
        {contact point: moved target, shape (3,) [m]}.
    """
    sunk = {
        point: foot_targets[point] - depths.get(point, 0.0) * normals[point]
        for point in foot_targets
    }
    for points in robot.feet.values():
        if len(points) > 1 and any(depths.get(point) for point in points):
            before = np.array([foot_targets[point] for point in points])
            after = move_rigidly(before, np.array([sunk[point] for point in points]))
            sunk |= dict(zip(points, after, strict=True))
    return sunk


def remove_penetration(
    ground: Ground,
    foot_targets: Mapping[str, Array],
    depths: Mapping[str, float],
    normals: Mapping[str, Array],
) -> Mapping[str, Array]:
    """Convert targets of feet in soft ground to targets on rigid ground, to place separate planes.

    If no foot has a separate plane, the targets are returned unchanged: on a slope, the horizontal
    displacement by the penetration is neglected.

    Args:
        ground: Ground.
        foot_targets: {contact point: target of the sphere centre in soft ground, shape (3,) [m], in
            the world frame}.
        depths: {contact point that carries load: penetration [m]}.
        normals: {contact point that carries load: unit normal out of the ground, shape (3,), world
            frame}.
    """
    if not ground.planes:
        return foot_targets
    return {
        point: place + depths[point] * normals[point] if point in normals else place
        for point, place in foot_targets.items()
    }


def move_rigidly(before: Array, after: Array) -> Array:
    """Rotate and translate points as a rigid body, with the least-squares fit to given points.

    Args:
        before: Points to be moved, shape (n, 3) [m].
        after: Points to which ``before`` is fitted, shape (n, 3) [m], in the same order and frame.

    Returns:
        Moved points, shape (n, 3) [m].

    Source: Kabsch, "A solution for the best rotation to relate two sets of vectors", 1976.
    """
    old_centre, new_centre = before.mean(axis=0), after.mean(axis=0)
    left, _, right = np.linalg.svd((before - old_centre).T @ (after - new_centre))
    flip = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    moved: Array = (before - old_centre) @ left @ flip @ right + new_centre
    return moved
