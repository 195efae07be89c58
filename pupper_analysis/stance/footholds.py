"""Where the feet shall stand: contact points in their places, and soles laid flat on the ground."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.robot.configuration import UP, Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.task import StandTask

Array = NDArray[np.float64]

_MAX_ITERATIONS = 4  # of fitting a plane to spheres of unequal size: each depends on the other

_COINCIDENT = 1e-9  # m: contact points that are nearer to each other, or to a line, are on it


def nominal_places(robot: Robot) -> dict[str, Array]:
    """Returns the contact points' centres, {point: (3,)}, where they are by default (m).

    Seen from above they stand there; the base is at the origin, upright.
    """
    return {point: place.copy() for point, place in robot.once(_nominal)}


def _nominal(robot: Robot) -> tuple[tuple[str, Array], ...]:
    qpos = robot.posed(robot.nominal)
    return tuple(Configuration(robot, qpos).foot_positions().items())


def nominal_feet(robot: Robot) -> dict[str, Array]:
    """Returns each foot's place, {foot: (2,)}: the middle of its contact points (m)."""
    places = nominal_places(robot)
    return {
        foot: (
            np.mean([places[point][:2] for point in points], axis=0)
            if len(points) > 1
            else places[points[0]][:2]
        )
        for foot, points in robot.feet.items()
    }


def feet_places(robot: Robot, task: StandTask) -> dict[str, Array]:
    """Returns where a task has each foot, seen from above, {foot: (2,)} (m)."""
    nominal = nominal_feet(robot)
    return {
        foot: np.array(task.feet.get(foot, place)) + task.foot_offsets.get(foot, 0.0)
        for foot, place in nominal.items()
    }


def place_feet(robot: Robot, task: StandTask) -> dict[str, Array]:
    """Returns where the contact points' centres shall be, {point: (3,)}, on rigid ground (m).

    A sole lies flat on the slope, turned out of its default orientation by the shortest way; a foot
    that swings is higher, and otherwise likewise.
    """
    nominal, ground = nominal_places(robot), task.ground
    targets: dict[str, Array] = {}
    for foot, place in feet_places(robot, task).items():
        points = robot.feet[foot]
        if len(points) == 1:
            targets[points[0]] = ground.centre(foot, place, robot.contact_radius[points[0]])
        else:
            sole = np.array([nominal[point] for point in points])
            radii = np.array([robot.contact_radius[point] for point in points])
            laid = _laid(sole, radii, ground.normal())
            aside = place - laid[:, :2].mean(axis=0)
            shift = np.array([*aside, ground.height(aside, foot)])  # along the plane, onto a step
            targets |= dict(zip(points, laid + shift, strict=True))
        for point in points:
            targets[point][2] += task.swing.get(foot, 0.0)
    return {point: targets[point] for point in robot.contact_points}


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


def sink_feet(
    robot: Robot, targets: Mapping[str, Array], depths: Mapping[str, float], normal: Array
) -> dict[str, Array]:
    """Returns the targets (3,) of contact points that are in the ground by some depths (m).

    A sole sinks as a whole and tilts: by the depths' best fit.
    """
    sunk = {point: targets[point] - depths.get(point, 0.0) * normal for point in targets}
    for points in robot.feet.values():
        if len(points) > 1 and any(depths.get(point) for point in points):
            before = np.array([targets[point] for point in points])
            after = move_rigidly(before, np.array([sunk[point] for point in points]))
            sunk |= dict(zip(points, after, strict=True))
    return sunk


def move_rigidly(before: Array, after: Array) -> Array:
    """Moves points (n, 3) as one body, as near to others (n, 3) as that goes.

    Source: Kabsch, "A solution for the best rotation to relate two sets of vectors", 1976.
    """
    one, two = before.mean(axis=0), after.mean(axis=0)
    left, _, right = np.linalg.svd((before - one).T @ (after - two))
    flip = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    moved: Array = (before - one) @ left @ flip @ right + two
    return moved
