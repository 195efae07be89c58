"""The segments of a path: from one stance to the next, and the task of each moment between."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.base.errors import (
    ConfigurationError,
    Infeasibility,
    StanceUnreachableError,
    StaticsInfeasibleError,
)
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.joints import placed_joints
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.fields import FIELDS
from pupper_analysis.stance.stand import Stand, solve_stand
from pupper_analysis.stance.task import StandTask
from pupper_analysis.statics.support_polygon import com_margin

Array = NDArray[np.float64]
_T = TypeVar("_T", float, NDArray[np.float64])

_PLACES = ("base-height", "base-place", "com-place", "support-margin", "footholds")
"""Constraints whose numbers a path works out itself; all others' are between its stances'."""

TOUCHING = 1e-12
"""The height of a foot that does not carry, but is on the ground (m)."""


@dataclass(frozen=True, eq=False)
class Key:
    """A stance in world coordinates.

    Attributes:
        task: The task, with its height filled in.
        base: (3,) place of the base (m).
        com: (3,) centre of mass (m).
        feet: {foot: (3,) centre of its sphere (m)}.
        joints: (nu,) joint positions (rad, m).
    """

    task: StandTask
    base: Array
    com: Array
    feet: dict[str, Array]
    joints: Array

    def margin(self, feet: Sequence[str]) -> float:
        """Returns how far inside these feet the com's projection is (m)."""
        return com_margin(self.com, {foot: self.feet[foot] for foot in feet})


@dataclass(frozen=True, eq=False)
class Segment:
    """From one stance to the next.

    Attributes:
        start: Where it begins.
        end: Where it ends.
        stance_feet: The feet that carry all along it.
        before: Those that carry on the segment before.
        after: Those that carry on the segment after.
    """

    start: Key
    end: Key
    stance_feet: tuple[str, ...]
    before: tuple[str, ...]
    after: tuple[str, ...]

    def placed(self, robot: Robot) -> list[int]:
        """Returns the numbers of the joints that one of the stances puts in their places."""
        tasks = self.start.task, self.end.task
        names = {joint for task in tasks for joint in placed_joints(robot, task.posture)}
        return sorted(map(robot.joint_names.index, names))


def segments_of(
    robot: Robot, stances: Sequence[StandTask]
) -> tuple[list[Segment], tuple[Stand, ...]]:
    """Solves the stances, and checks that they can follow each other.

    Raises:
        ConfigurationError: If they cannot; says which.
        StanceUnreachableError: If one is out of reach; says which.
        UnknownNameError: If a task names a foot that the robot does not have.
    """
    if any(task.ground != stances[0].ground for task in stances):
        raise ConfigurationError("stances", diagnose("grounds-differ"))
    fixed = any(task.offset is not None or not isinstance(task.com, str | None) for task in stances)
    if fixed and any(task.com == "inside" for task in stances):
        raise ConfigurationError("stances", diagnose("com-inside-mixed"))
    solved: list[Stand] = []
    keys = []
    for number, task in enumerate(stances, 1):
        if solved:
            task = replace(task, ik_seed=tuple(solved[-1].joint_positions(robot)))
        try:
            solved.append(solve_stand(robot, task))
        except StanceUnreachableError as error:
            raise error.at(diagnose("of-stance", number=number)) from None
        com = Configuration(robot, solved[-1].qpos).center_of_mass()
        base, joints = solved[-1].qpos[:3], solved[-1].joint_positions(robot)
        keys.append(Key(solved[-1].task, base, com, solved[-1].foot_targets, joints))
    sets = []
    for number, (one, two) in enumerate(pairwise(keys), 1):
        swinging = one.task.swing.keys() | two.task.swing.keys()
        idle = {point for foot in swinging for point in robot.feet[foot]}
        sets.append(tuple(foot for foot in robot.contact_points if foot not in idle))
        where = diagnose("between-stances", one=number, two=number + 1)
        if len(sets[-1]) < 3:
            problem = diagnose("too-few-feet-carry", count=len(sets[-1]), where=where)
            raise ConfigurationError("stances", problem)
        for foot in sets[-1]:
            if np.abs(one.feet[foot] - two.feet[foot]).max() > 1e-9:
                problem = diagnose("carrying-foot-moves", subject=("foot", foot), where=where)
                raise ConfigurationError("stances", problem)
        if number > 1 and not (set(sets[-1]) <= set(sets[-2]) or set(sets[-1]) >= set(sets[-2])):
            problem = diagnose("lands-as-another-lifts", number=number)
            raise ConfigurationError("stances", problem)
    sets = [sets[0], *sets, sets[-1]]
    segments = [
        Segment(one, two, sets[number], sets[number - 1], sets[number + 1])
        for number, (one, two) in enumerate(pairwise(keys), 1)
    ]
    return segments, tuple(solved)


def task_between(
    robot: Robot,
    segment: Segment,
    stance_feet: Sequence[str],
    share: float,
    ik_seed: Array,
    away: Mapping[str, Array],
) -> StandTask:
    """Returns the task of a moment, in world coordinates.

    Args:
        robot: The robot.
        segment: The segment of the path.
        stance_feet: The feet that carry.
        share: Of the segment's way, from 0 to 1.
        ik_seed: (nu,) joint positions to start from (rad).
        away: {foot: (2,) how far it has rolled from its place (m)}.

    Raises:
        StaticsInfeasibleError: If the com is less inside the feet than the tasks demand.
    """
    one, two = segment.start.task, segment.end.task

    def between(start: _T, end: _T) -> _T:
        return start + share * (end - start)

    ground, normal = one.ground, one.ground.normal()
    places = {foot: segment.start.feet[foot] for foot in robot.contact_points}
    places |= {foot: p + share * (segment.end.feet[foot] - p) for foot, p in places.items()}
    points = {point: place[:2] + away[point] for point, place in places.items()}
    feet = {}
    for foot, own in robot.feet.items():
        x, y = np.mean([points[point] for point in own], axis=0)
        feet[foot] = float(x), float(y)
    contacts = {
        point: ground.centre(robot.foot_of(point), points[point], robot.contact_radius[point])
        - robot.contact_radius[point] * normal
        for point in stance_feet
    }
    centre = np.mean(list(contacts.values()), axis=0)
    base = segment.start.base + share * (segment.end.base - segment.start.base)
    com = segment.start.com + share * (segment.end.com - segment.start.com)
    by_base = one.offset is not None or two.offset is not None
    needed = max(1e-6, between(one.com_margin, two.com_margin) - 1e-9)
    margin = com_margin(com, contacts)
    if not by_base and margin < needed:
        raise StaticsInfeasibleError(
            Infeasibility.COM_OUTSIDE,
            diagnose(
                "com-off-the-feet",
                margin=Quantity(margin, "m"),
                feet=contacts,
                needed=Quantity(needed, "m"),
            ),
            margin=margin,
            feet=contacts,
        )
    last = two.values()
    others: dict[str, Any] = {
        name: None if None in (first, last[name]) else between(first, last[name])
        for name, first in one.values().items()
        if FIELDS[name].constraint not in _PLACES and not FIELDS[name].per
    }
    joints = between(segment.start.joints, segment.end.joints).tolist()
    posture = {robot.joint_names[index]: joints[index] for index in segment.placed(robot)}
    heights = {
        foot: between(one.swing.get(foot, 0.0), two.swing.get(foot, 0.0)) for foot in robot.feet
    }
    carrying = robot.feet_with(stance_feet)
    return StandTask(
        height=float(base[2] - centre[2]),
        offset=(float(base[0] - centre[0]), float(base[1] - centre[1])) if by_base else None,
        feet=feet,
        swing={f: max(TOUCHING, h) for f, h in heights.items() if f not in carrying},
        ground=ground,
        com="centre" if by_base else (float(com[0]), float(com[1])),
        com_margin=max(0.0, between(one.com_margin, two.com_margin) - 1e-9) if by_base else 0.0,
        posture=posture,
        ik_seed=tuple(ik_seed),
        **others,
    )
