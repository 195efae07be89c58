"""A stand task in numbers: where one robot's feet, base and com shall be."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy import linalg

from pupper_analysis.base.diagnostics import Quantity, Vector, diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.frozen import FrozenDict, freeze_arrays
from pupper_analysis.robot.configuration import UP, Configuration
from pupper_analysis.robot.ground import Ground
from pupper_analysis.robot.joints import check_in_range, placed_joints, with_units
from pupper_analysis.robot.plane import Bar
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.touching import touching
from pupper_analysis.stance.task import StandTask
from pupper_analysis.statics.contacts import gripped_places, stated_forces
from pupper_analysis.statics.support_polygon import Corner, margin_of_place, support_corners

Array = NDArray[np.float64]


_LINE = 1e-3
"""Contact points that are no further from a line, taken together, are on it (m): no polygon of that
width holds anything."""


_FIXED = {1: 3, 2: 5}
"""Coordinates of a foot that one or two contact points fix; more of them fix all 6."""


_POSES = 3
"""How many random poses are looked at: the first may be singular."""

_LEAST_COM_RATE = 1e-6
"""A com that moves by less against the base, per unit of joint rates, does not move (m/rad)."""

_SIDEWAYS = 1e-3
"""Nor does one that moves by less of how it moves the other way: soles that are a microradian off
level let it."""


def has_spare_joints(robot: Robot) -> bool:
    """Tells whether joints are left to move where base and feet are in their places.

    Given are the base's turn, height and place, and of each foot what its points fix: a line may
    still turn about itself.
    """
    return 6 + sum(_FIXED.get(len(points), 6) for points in robot.feet.values()) < robot.nv


def can_move_com(robot: Robot) -> bool:
    """Tells whether a robot can move its com in x and in y with its feet where they are.

    The base keeps its height and orientation. Legs of three joints or more can do it; legs of two,
    that swing in a plane, cannot move it sideways, unless arms or a waist do.
    """
    return robot.once(_moves_com)


def _moves_com(robot: Robot) -> bool:
    if not robot.contact_points:
        return True
    if len(robot.feet) < len(robot.contact_points):
        # Soles and wheels lie on the ground: in other poses other motions are free.
        return any(
            _com_freedom(robot, pose) == 2 for pose in (robot.nominal, robot.home[-robot.nu :])
        )
    random = np.random.default_rng(0)
    low, high = np.maximum(robot.lower_limits, -np.pi), np.minimum(robot.upper_limits, np.pi)
    return any(
        _com_freedom(robot, random.uniform(low, np.maximum(low, high))) == 2 for _ in range(_POSES)
    )


def _com_freedom(robot: Robot, joints: Array) -> int:
    """Returns in how many directions the com can move, seen from above, at positions (nu,)."""
    config = Configuration(robot, robot.posed(joints))
    held = np.eye(4, robot.nv, k=2)  # the base's height and its three turns
    feet = np.vstack(list(config.foot_jacobians().values()))
    free = linalg.null_space(np.vstack([held, feet]), rcond=1e-9)
    moved = config.com_jacobian()[:2] @ free
    sizes = np.linalg.svd(moved, compute_uv=False)
    return int((sizes > max(_LEAST_COM_RATE, _SIDEWAYS * float(sizes.max(initial=0.0)))).sum())


class Support:
    """Where a com is in balance on contacts: found when it is asked for, and shared by goals.

    Args:
        contacts: (n, 3) points (m).
        normals: (n, 3) out of the ground.
        friction: (n,) coefficients, if they are known.
        stated: Forces that contacts are to press with; see ``support_corners``.
        grips: Where something is gripped, and up to which force, likewise.
    """

    def __init__(
        self,
        contacts: Array,
        normals: Array,
        friction: Sequence[float],
        stated: tuple[Array, Array] | None = None,
        grips: Array | None = None,
    ) -> None:
        self._given = contacts, normals, friction, stated, grips

    @cached_property
    def corners(self) -> tuple[Corner, ...]:
        """Its corners, seen from above."""
        return support_corners(*self._given)


@dataclass(frozen=True, eq=False)
class Goal:
    """A task in numbers, for one robot. Goals may share arrays, which nobody changes.

    Attributes:
        task: The task, with its height and com filled in.
        targets: {foot: (3,)} of the feet's centres.
        depths: {foot that carries: m} how deep these are in the ground.
        stance_feet: The feet that carry.
        contacts: (n, 3) contact points of these.
        contact_by_foot: {foot that carries: (3,) its contact point}.
        normals: {foot that carries: (3,) out of the ground}.
        support: Where the com is in balance.
        centre: (3,) the mean of the feet's contact points, without hands and feet on walls; its
            height that of those on no slope or plane of their own, if there are any.
        height: z of the base frame.
        base_quaternion: Its orientation, a unit quaternion (w, x, y, z).
        place: (2,) of the com, or of the base frame.
        by_base: Whether ``place`` is the base frame's.
        lower: (nu,) joint limits, less the margin; a joint in a posture has no room between them.
        upper: (nu,) likewise.
        give: (m,) by how much closed loops are open, where they give way; None if they do not.
    """

    task: StandTask
    targets: FrozenDict[str, Array]
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
    give: Array | None = None

    @property
    def corners(self) -> tuple[Corner, ...]:
        """Between which the com is in balance, seen from above: (x, y) of each."""
        return self.support.corners

    @property
    def rigid_targets(self) -> Mapping[str, Array]:
        """Where the feet's centres (3,) are on rigid ground (m): over the middle of their steps."""
        return raise_feet(self.task.ground, self.targets, self.depths, self.normals)

    @property
    def com_is_free(self) -> bool:
        """Whether the com may be anywhere inside the support polygon."""
        return self.task.com == "inside" and not self.by_base


def make_goal(
    robot: Robot,
    task: StandTask | None,
    depths: Mapping[str, float],
    like: Goal | None = None,
    *,
    checked: bool = True,
) -> Goal:
    """Works out what a task means for a robot.

    Args:
        robot: The robot.
        task: How to stand; the nominal stand if None.
        depths: {foot that carries: how deep it sinks into the ground (m)}; 0 where not given.
        like: Another goal of the robot, as it is, with these depths: if its feet are to be in the
            same places, they are not worked out again; nor are equal limits. By default the nominal
            stand, if there are no depths.
        checked: Refuse what leaves nothing at once, such as a com outside the support polygon.

    Raises:
        ConfigurationError: If the robot's base is fixed, or it has no feet; or if the margins leave
            nothing.
        UnknownNameError: If the task names a foot that the robot does not have.
    """
    com, nominal, limits = robot.once(_usual)
    # Who wants other limits of its joints may change those of its model.
    if like is None and not depths and limits == _limits(robot):
        like = nominal
        if task is None and like is not None:
            return like
    if task is None:
        task = StandTask()
    if task.ik_seed is not None and len(task.ik_seed) != robot.nu:
        raise ConfigurationError("ik_seed", diagnose("seed-length-wrong", joints=robot.nu))
    return _goal_of(robot, task, com, depths, like, checked=checked)


def _limits(robot: Robot) -> list[list[float]]:
    """Returns Pinocchio's limits; in lists, which are compared in no time."""
    model = robot.pin_model
    return [model.lowerPositionLimit.tolist(), model.upperPositionLimit.tolist()]


class _Usual(NamedTuple):
    """What a robot's tasks have by default: the com's place, the nominal stand, joint limits."""

    com: str
    goal: Goal | None
    limits: list[list[float]]


def _usual(robot: Robot) -> _Usual:
    com = "centre" if not robot.floating or can_move_com(robot) else "inside"
    limits = _limits(robot)
    try:
        return _Usual(com, _goal_of(robot, StandTask(), com, {}, None), limits)
    except ConfigurationError:
        return _Usual(com, None, limits)


def _goal_of(
    robot: Robot,
    task: StandTask,
    com: str,
    depths: Mapping[str, float],
    like: Goal | None,
    *,
    checked: bool = True,
) -> Goal:
    if task.contacts:
        task = _with_planes(robot, task)
    if like is not None and _same_feet(like.task, task):
        stance_feet, contacts, targets = like.stance_feet, like.contacts, like.targets
        contact_by_foot, normals, deep = like.contact_by_foot, like.normals, like.depths
        support, centre = like.support, like.centre
    else:
        stance_feet = _stance_feet(robot, task)
        out = ground_normals(robot, task.ground)
        places = compute_foot_targets(robot, task)
        contacts = np.array(
            [places[foot] - robot.contact_radius[foot] * out[foot] for foot in stance_feet]
        ).reshape(-1, 3)
        deep = FrozenDict({foot: float(depths.get(foot, 0.0)) for foot in stance_feet})
        targets = freeze_arrays(sink_feet(robot, places, deep, out))
        contact_by_foot = freeze_arrays(dict(zip(stance_feet, contacts, strict=True)))
        normals = freeze_arrays({foot: out[foot] for foot in stance_feet})
        grip = [robot.contacts[foot].sliding_friction for foot in stance_feet if robot.contacts]
        stated = stated_forces(robot, stance_feet)
        held = gripped_places(robot, targets) if robot.grips else None
        support = Support(contacts, np.array([*normals.values()]), grip, stated, held)
        if checked and not robot.welded:  # which hold any com
            _check_area(robot, np.array(support.corners), stance_feet)
        centre = feet_centre(robot, task.ground, contact_by_foot, targets)
    task = _filled(robot, task, com)
    assert task.height is not None
    assert task.com is not None
    if like is not None and _limited_alike(like.task, task):
        lower, upper = like.lower, like.upper
    else:
        lower, upper = _joint_limits(robot, task, checked=checked)
    armed = len(robot.hands) == len(robot.feet)  # an arm's base is where it is bolted
    place, by_base = centre[:2], armed and isinstance(task.com, str)
    if task.offset is not None:
        place, by_base = place + task.offset, True
    elif not isinstance(task.com, str):
        place = np.array(task.com)
    # The centre, of which no margin is asked, always is inside.
    at_centre = by_base or (isinstance(task.com, str) and task.com_margin == 0.0)
    if checked and not at_centre and not robot.welded:
        _check_inside(task, place, support.corners)
    return Goal(
        task=task,
        targets=targets,
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
    robot: Robot, ground: Ground, contact_by_foot: Mapping[str, Array], targets: Mapping[str, Array]
) -> Array:
    """Returns the centre (3,) of the feet that carry, without hands or walls; see ``Goal`` (m).

    Of an arm, below where its file has its base.
    """
    if robot.welds:
        if len(robot.hands) == len(robot.feet):
            return np.array([*robot.home[:2], 0.0])
        held = (point for foot in robot.welds for point in robot.feet.get(foot, ()))
        radius = robot.contact_radius
        contact_by_foot = {
            **contact_by_foot,
            **{one: targets[one] - radius[one] * UP for one in held},
        }
    stance_feet, contacts = [*contact_by_foot], np.array([*contact_by_foot.values()])
    if not contact_by_foot:  # all feet are lifted
        return np.array([*np.mean([*targets.values()], axis=0)[:2], 0.0])
    centre: Array = contacts.mean(axis=0)
    steep = [foot for foot in ground.planes if ground.normal(foot)[2] < MIN_SUPPORT_NORMAL_Z]
    for left_out, parts in (((*robot.hands, *steep), slice(None)), (ground.planes, slice(2, 3))):
        kept = [robot.foot_of(foot) not in left_out for foot in stance_feet] if left_out else []
        if any(kept) and not all(kept):  # a foot high on a wall lifts no base
            centre[parts] = contacts[kept, parts].mean(axis=0)
    return centre


def _joint_limits(robot: Robot, task: StandTask, *, checked: bool) -> tuple[Array, Array]:
    """Returns between which positions (nu,) joints may be; both are the same in a posture."""
    lower = robot.lower_limits + task.joint_margin
    upper = robot.upper_limits - task.joint_margin
    if checked and (lower > upper).any():
        name = robot.joint_names[int(np.argmax(lower - upper))]
        margin = Quantity(task.joint_margin, "rad")
        problem = diagnose("margin-leaves-no-range", margin=margin, joint=name)
        raise ConfigurationError("joint_margin", problem)
    for joint, position in placed_joints(robot, task.posture).items():
        index = robot.joint_names.index(joint)
        if checked:
            ends = float(lower[index]), float(upper[index])
            check_in_range(robot, joint, position, ends, "posture")
        lower[index] = upper[index] = position
    return lower, upper


_INSIDE = 1e-4
"""How far inside of where a com is in balance a place is that is proposed (m)."""


def _check_inside(task: StandTask, place: Array, corners: tuple[Corner, ...]) -> None:
    """Checks that the com shall be inside the support polygon, with the task's margin."""
    inside = margin_of_place((float(place[0]), float(place[1])), corners)
    if inside < min(task.com_margin, 0.0):
        there, outside = Vector((place[0], place[1]), "m"), Quantity(-inside, "m")
        import shapely.ops  # slow to import

        hull = shapely.MultiPoint(corners).convex_hull
        kept = hull.buffer(-max(task.com_margin, 0.0) - _INSIDE)
        near, _ = shapely.ops.nearest_points(
            hull.centroid if kept.is_empty else kept, shapely.Point(place[:2])
        )
        inner = Vector((round(near.x, 5), round(near.y, 5)), "m")
        problem = diagnose("place-outside-polygon", place=there, distance=outside, nearest=inner)
        raise ConfigurationError("com", problem)
    if inside < task.com_margin:
        margin, most = Quantity(task.com_margin, "m"), Quantity(math.floor(1e5 * inside) / 1e5, "m")
        problem = diagnose("margin-exceeds-polygon", margin=margin, most=most)
        raise ConfigurationError("com_margin", problem)


def _filled(robot: Robot, task: StandTask, com: str) -> StandTask:
    """Returns a task with the robot's own height and com, where it leaves them open, and units."""
    if task.posture:
        task = replace(task, posture=with_units(robot, task.posture)).replace_unchecked(
            ground=task.ground
        )
    if task.height is None:
        task = replace(task, height=robot.base_height).replace_unchecked(ground=task.ground)
    return (
        task if task.com else task.replace_unchecked(com=com if task.offset is None else "centre")
    )


def _limited_alike(one: StandTask, other: StandTask) -> bool:
    """Whether the same is asked of joints; of patterns the last counts, so their order does."""
    postures = [*one.posture.items()] == [*other.posture.items()]
    return one.joint_margin == other.joint_margin and postures


def _same_feet(one: StandTask, other: StandTask) -> bool:
    """Whether two tasks have the feet in the same places, and the same ones carry."""
    return (one.ground, one.feet, one.foot_offsets, one.swing, one.contacts) == (
        other.ground,
        other.feet,
        other.foot_offsets,
        other.swing,
        other.contacts,
    )


def _check_area(robot: Robot, corners: Array, stance_feet: Sequence[str]) -> None:
    """Refuses corners (n, 2) of balance that are on one line, seen from above."""
    seen = corners - corners.mean(axis=0)
    if np.linalg.svd(seen, compute_uv=False)[1] < _LINE:
        raise ConfigurationError(
            "swing" if len(stance_feet) < len(robot.contact_points) else "robot",
            diagnose("touches-along-line", robot=robot.name, feet=stance_feet),
        )


def _stance_feet(robot: Robot, task: StandTask) -> tuple[str, ...]:
    """Returns the contact points that carry, if a task is one for this robot; see ``make_goal``."""
    robot.check_floating()
    if not (robot.contact_points or robot.welds):
        raise ConfigurationError("robot", diagnose("no-feet", robot=robot.name))
    if not robot.gravity[2] < 0:
        gravity = Vector(tuple(robot.gravity), "m/s^2")
        raise ConfigurationError("robot", diagnose("gravity-not-down", gravity=gravity))
    if task.contacts and touching(robot, task.contacts) is not robot:
        raise ConfigurationError("contacts", diagnose("made-for-other-contacts", robot=robot.name))
    for foot in (*task.feet, *task.foot_offsets, *task.swing, *task.ground.heights):
        robot.points_of(foot)
    swinging = {point for foot in task.swing for point in robot.feet[foot]}
    stance_feet = tuple(foot for foot in robot.bearing if foot not in swinging)
    if robot.welds:
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


_MAX_ITERATIONS = 4  # of fitting a plane to spheres of unequal size: each depends on the other

MIN_SUPPORT_NORMAL_Z = 0.5
"""Vertical part of the normal of a plane that bears no weight: friction holds nothing on 60 deg."""

_COINCIDENT = 1e-9  # m: contact points that are nearer to each other, or to a line, are on it


def nominal_point_positions(robot: Robot) -> dict[str, Array]:
    """Returns the contact points' centres, {point: (3,)}, where they are by default (m).

    Seen from above they stand there; the base is at the origin, upright.
    """
    return {point: place.copy() for point, place in robot.once(_nominal)}


def _nominal(robot: Robot) -> tuple[tuple[str, Array], ...]:
    qpos = robot.posed(robot.nominal)
    return tuple(Configuration(robot, qpos).foot_positions().items())


def nominal_foot_positions(robot: Robot) -> dict[str, Array]:
    """Returns each foot's place, {foot: (2,)}: the middle of its contact points (m)."""
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
    """Returns where a task has each foot, seen from above, {foot: (2,)} (m)."""
    nominal = nominal_foot_positions(robot)
    return {
        foot: np.array(task.feet.get(foot, place)) + task.foot_offsets.get(foot, 0.0)
        for foot, place in nominal.items()
    }


def compute_foot_targets(robot: Robot, task: StandTask) -> dict[str, Array]:
    """Returns where the contact points' centres shall be, {point: (3,)}, on rigid ground (m).

    A sole lies flat on the slope, turned out of its default orientation by the shortest way; a foot
    that swings is higher, and otherwise likewise.
    """
    nominal, ground = nominal_point_positions(robot), task.ground
    targets: dict[str, Array] = {}
    for foot, place in foot_positions_of_task(robot, task).items():
        points = robot.feet[foot]
        if foot in ground.planes:
            targets |= _on_plane(robot, task, foot, place)
            continue
        if foot in robot.hands and foot in task.contacts:  # it is welded
            targets[points[0]] = _asked_place(robot, task, foot, place)
        elif len(points) == 1:
            targets[points[0]] = ground.centre(foot, place, robot.contact_radius[points[0]])
        else:
            sole = np.array([nominal[point] for point in points])
            radii = np.array([robot.contact_radius[point] for point in points])
            out = ground.normal(foot)
            laid = _laid(sole, radii, out)
            on = laid.mean(axis=0)
            shift = np.array([*(place - on[:2]), ground.height(place, foot) - ground.height(on)])
            targets |= dict(zip(points, laid + shift, strict=True))
        for point in points:
            targets[point] += task.swing.get(foot, 0.0) * UP
    return {point: targets[point] for point in robot.contact_points}


def _on_plane(robot: Robot, task: StandTask, foot: str, place: Array) -> dict[str, Array]:
    """Returns the centres {point: (3,)} of a foot, or a hand, on a plane of its own (m).

    It touches in the plane's point that is nearest to where it is asked to be, or stands by
    default; of a hand nearest to where it is in the home pose.
    """
    points = robot.feet[foot]
    on = task.ground.planes[foot].nearest(_asked_place(robot, task, foot, place))
    out, radii = task.ground.normal(foot), np.array([robot.contact_radius[one] for one in points])
    on += task.swing.get(foot, 0.0) * out
    if len(points) == 1:
        return {points[0]: on + radii[0] * out}
    nominal = nominal_point_positions(robot)
    laid = _laid(np.array([nominal[point] for point in points]), radii, out)
    middle: Array = (laid - radii[:, None] * out).mean(axis=0)
    return dict(zip(points, laid + on - middle, strict=True))


def _asked_place(robot: Robot, task: StandTask, foot: str, place: Array) -> Array:
    """Returns next to where (3,) a foot, or a hand, shall touch a plane of its own (m).

    A foot that is at a place (2,), or a hand that is moved as far from where it is by default.
    """
    if task.contacts[foot].place is not None or foot in robot.hands:
        near = np.array(task.contacts[foot].place or default_contact_position(robot, foot).tolist())
        near[:2] += place - nominal_foot_positions(robot)[foot]
        return near
    if isinstance(bar := task.contacts[foot].plane, Bar):
        return np.array(bar.top(*place.tolist()))
    return np.array((*place, task.ground.height(place, foot)))


def _with_planes(robot: Robot, task: StandTask) -> StandTask:
    """Returns a task whose ground has the planes that feet touch, or that slopes are there."""
    planes = {}
    for foot, place in foot_positions_of_task(robot, task).items():
        plane = task.contacts[foot].plane if foot in task.contacts else None
        if plane is not None:
            planes[foot] = plane.through(_asked_place(robot, task, foot, place).tolist())
    return task.replace_unchecked(ground=task.ground.with_planes(planes))


def default_contact_position(robot: Robot, foot: str) -> Array:
    """Returns where a foot touches the ground by default, or a hand is in the home pose (3,)."""
    if foot in robot.hands:
        return robot.once(_home_places)[robot.feet[foot][0]].copy()
    return np.array((*nominal_foot_positions(robot)[foot], 0.0))


def _home_places(robot: Robot) -> dict[str, Array]:
    """Returns the contact points' centres, {point: (3,)}, of a robot that stands at home (m)."""
    qpos = robot.posed(robot.home[robot.nq - robot.nu :])
    qpos[2] = robot.base_height
    return Configuration(robot, qpos).foot_positions()


def _laid(sole: Array, radii: Array, normal: Array) -> Array:
    """Turns a sole's centres (n, 3) so that it rests on the plane through the origin."""
    out = UP
    for _ in range(_MAX_ITERATIONS):
        out = _upwards(sole - radii[:, None] * out)
    turn = pin.Quaternion.FromTwoVectors(out, normal).matrix()
    middle = sole.mean(axis=0)
    turned: Array = (sole - middle) @ turn.T
    lifted: Array = turned - (turned @ normal - radii).mean() * normal
    return lifted


def _upwards(points: Array) -> Array:
    """Returns the upward normal (3,) of the plane, or of the line, on which points (n, 3) are."""
    _, sizes, axes = np.linalg.svd(points - points.mean(axis=0))
    if sizes[1] < _COINCIDENT:  # a line: as upright as its direction lets it be
        normal = UP - (UP @ axes[0]) * axes[0]
    else:
        normal = axes[2] * np.sign(axes[2][2] or 1.0)
    result: Array = normal / np.linalg.norm(normal)
    return result


def ground_normals(robot: Robot, ground: Ground) -> dict[str, Array]:
    """Returns the direction {contact point: (3,)} out of the ground under each."""
    if not ground.planes:
        return dict.fromkeys(robot.contact_points, ground.normal())
    out = {point: ground.normal(foot) for foot, points in robot.feet.items() for point in points}
    return {point: out[point] for point in robot.contact_points}


def sink_feet(
    robot: Robot,
    targets: Mapping[str, Array],
    depths: Mapping[str, float],
    normals: Mapping[str, Array],
) -> dict[str, Array]:
    """Returns the targets (3,) of contact points that are in the ground by some depths (m).

    A sole sinks as a whole and tilts: by the depths' best fit.
    """
    sunk = {point: targets[point] - depths.get(point, 0.0) * normals[point] for point in targets}
    for points in robot.feet.values():
        if len(points) > 1 and any(depths.get(point) for point in points):
            before = np.array([targets[point] for point in points])
            after = move_rigidly(before, np.array([sunk[point] for point in points]))
            sunk |= dict(zip(points, after, strict=True))
    return sunk


def raise_feet(
    ground: Ground,
    targets: Mapping[str, Array],
    depths: Mapping[str, float],
    normals: Mapping[str, Array],
) -> Mapping[str, Array]:
    """Returns where sunk feet would be on rigid ground; as they are, if no step has a slope.

    (Level steps are under them at any depth. Of a sole the middle is where it would be.)
    """
    if not ground.planes:
        return targets
    return {
        point: place + depths[point] * normals[point] if point in normals else place
        for point, place in targets.items()
    }


def move_rigidly(before: Array, after: Array) -> Array:
    """Moves points (n, 3) as one body, as near to others (n, 3) as that goes.

    Source: Kabsch, "A solution for the best rotation to relate two sets of vectors", 1976.
    """
    one, two = before.mean(axis=0), after.mean(axis=0)
    left, _, right = np.linalg.svd((before - one).T @ (after - two))
    flip = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    moved: Array = (before - one) @ left @ flip @ right + two
    return moved
