"""From stance to stance: a smooth, quasi-static path through them."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from numbers import Real
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.configuration import Configuration
from pupper_analysis.errors import (
    ConfigurationError,
    Infeasibility,
    StanceUnreachableError,
    StaticsInfeasibleError,
)
from pupper_analysis.files import whole_file
from pupper_analysis.results import Result
from pupper_analysis.robot import Robot
from pupper_analysis.stand import Stand, solve_stand
from pupper_analysis.statics import LoadSharing, com_margin, gravity_compensation
from pupper_analysis.task import StandTask

Array = NDArray[np.float64]

MAX_SAMPLES = 20_000
"""The most samples that a path may have."""

MAX_JUMP = 0.5
"""A joint that moves by more than this from one sample to the next has jumped (rad)."""

_ROLLED = 1e-8  # m: two iterations of how far a foot rolls that agree
_MAX_ITERATIONS = 50
_TOUCHING = 1e-12  # m: the height of a foot that does not carry, but is on the ground


@dataclass(frozen=True, eq=False)
class StancePath(Result):
    """A path through stances, each of its samples in balance.

    Attributes:
        stances: The stances, solved.
        joint_names: In actuator order.
        feet: The robot's feet.
        time: (n,) from 0 (s), evenly spaced; every stance is at a sample.
        qpos: (n, nq) the configurations.
        torques: (n, nu) feed-forward torques: what the motors hold at rest (N m).
        carrying: (n, feet) which feet carry.
        loads: (n, feet) vertical force of the ground on each foot at rest (N).
        clearance: (n, feet) height of each foot above the ground (m); zero where it carries.
        com_margin: (n,) distance of the com's projection from the edge of the support polygon (m).
        peak_utilisation: The largest torque / effort limit; above 1 the motors are too weak.
    """

    stances: tuple[Stand, ...]
    joint_names: tuple[str, ...]
    feet: tuple[str, ...]
    time: Array
    qpos: Array
    torques: Array
    carrying: NDArray[np.bool_]
    loads: Array
    clearance: Array
    com_margin: Array
    peak_utilisation: float

    def joint_positions(self) -> Array:
        """Returns the joints' part (n, nu) of ``qpos`` (rad)."""
        return self.qpos[:, self.qpos.shape[1] - len(self.joint_names) :]

    def to_csv(self, path: str | Path) -> None:
        """Writes time, joint positions and torques, with a header line that names the units.

        Raises:
            OutputError: If the file cannot be written.
        """
        header = ["time (s)", *(f"q {name} (rad)" for name in self.joint_names)]
        header += [f"tau {name} (N m)" for name in self.joint_names]
        rows = np.column_stack([self.time, self.joint_positions(), self.torques])
        with (
            whole_file(Path(path)) as temporary,
            temporary.open("w", newline="", encoding="utf-8") as file,
        ):
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(header)
            writer.writerows(rows.tolist())

    def to_npz(self, path: str | Path) -> None:
        """Writes the arrays under their names, and ``joints``, (n, nu), beside ``qpos``.

        Raises:
            OutputError: If the file cannot be written.
        """
        names = ("joint_names", "feet", "time", "qpos", "torques", "carrying", "loads")
        arrays = {key: np.array(getattr(self, key)) for key in (*names, "clearance", "com_margin")}
        arrays["joints"] = self.joint_positions()
        with whole_file(Path(path)) as temporary, temporary.open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, **arrays)


@dataclass(frozen=True, eq=False)
class _Key:
    """A stance in world coordinates; ``base`` and ``com`` are (3,), ``feet`` are targets (m)."""

    task: StandTask
    base: Array
    com: Array
    feet: dict[str, Array]

    def margin(self, feet: Sequence[str]) -> float:
        return com_margin(self.com, {foot: self.feet[foot] for foot in feet})


@dataclass(frozen=True, eq=False)
class _Leg:
    """From one stance to the next; ``before`` and ``after`` carry in the legs beside it."""

    start: _Key
    end: _Key
    carrying: tuple[str, ...]
    before: tuple[str, ...]
    after: tuple[str, ...]


def stance_path(
    robot: Robot,
    stances: Sequence[StandTask],
    seconds: float,
    *,
    rate: float = 50.0,
    rolling: bool = True,
) -> StancePath:
    """Finds a smooth path through stances, solved on the whole body at every sample.

    All numbers of the tasks move along a minimum-jerk law, which is at rest, without velocity or
    acceleration, in every stance; each leg of the path takes the same time. The place that moves
    evenly is the com's or, next to a stance that has an offset, the base's.

    A foot that is lifted in a stance carries nothing from the stance before to the one after: the
    com must be over the other feet there already. On a leg before or after, its load fades out or
    in, so that the torques are continuous.

    A foot that carries stays where it is, but a sphere that friction holds rolls as its leg turns:
    its centre moves with omega x r n, by 2 mm as v3 squats by a fifth of its height. So after the
    first one the feet are beside their places in the stances by what they have rolled, while base
    and com are where the stances have them.

    Args:
        robot: A robot with a floating base.
        stances: The tasks, at least two, on one ground; to stay in one, give it twice. The posture
            of the first counts, the others follow from it.
        seconds: Time for all (s).
        rate: Least number of samples per second (Hz).
        rolling: Whether the feet roll; otherwise their centres stay, and their soles must slip.

    Raises:
        ConfigurationError: If an argument is out of its range; or the stances cannot follow each
            other: a foot that carries moves, fewer than three carry, a joint jumps, feet roll away.
        UnknownNameError: If a task names a foot that the robot does not have.
        StanceUnreachableError: If a sample is out of reach; says when.
        StaticsInfeasibleError: If a sample cannot be held; says when.
    """
    per_leg = _samples(seconds, rate, stances)
    legs, solved = _legs(robot, stances)
    count = per_leg * len(legs) + 1
    time = np.linspace(0.0, float(seconds), count)
    qpos, torques = np.empty((count, robot.nq)), np.empty((count, robot.nu))
    carrying = np.zeros((count, len(robot.feet)), dtype=np.bool_)
    loads, clearance = np.empty(carrying.shape), np.empty(carrying.shape)
    margins, peak = np.empty(count), 0.0
    posture = np.array(solved[0].joint_positions(robot))
    roll = _Roll(robot, solved[0])
    for index in range(count):
        number = max(0, (index - 1) // per_leg)
        leg, share = legs[number], _law(index / per_leg - number)
        feet = leg.carrying
        if index == per_leg * (number + 1):  # in a stance only what carries on both sides
            feet = tuple(foot for foot in feet if foot in leg.after)
        try:
            stand = roll.solve(leg, feet, share, posture, rolling=rolling)
            torques[index], forces, margins[index] = _even(robot, leg, stand, share)
        except (StanceUnreachableError, StaticsInfeasibleError) as error:
            where = f"at {time[index]:.2f} s, between stances {number + 1} and {number + 2}"
            error.args = (f"{where}: {error}",)
            raise
        qpos[index] = stand.qpos
        if index and qpos[index, 3:7] @ qpos[index - 1, 3:7] < 0:
            qpos[index, 3:7] *= -1  # the same rotation, without a jump
        jumps = np.abs(stand.joint_positions(robot) - posture)
        if jumps.max() > MAX_JUMP:
            raise ConfigurationError(
                "stances",
                f"joint {robot.joint_names[int(jumps.argmax())]} jumps by {jumps.max():.2f} rad at "
                f"{time[index]:.2f} s, between stances {number + 1} and {number + 2}; "
                "bring them nearer to each other, or raise the rate",
            )
        posture = stand.joint_positions(robot)
        with np.errstate(divide="ignore", invalid="ignore"):
            peak = max(peak, float(np.nanmax(np.abs(torques[index]) / robot.effort_limits)))
        for column, foot in enumerate(robot.feet):
            carrying[index, column] = foot in feet
            loads[index, column] = forces.get(foot, 0.0)
            low = stand.task.lifted.get(foot, 0.0)
            clearance[index, column] = 0.0 if low <= _TOUCHING else low
    return StancePath(
        stances=solved,
        joint_names=robot.joint_names,
        feet=robot.feet,
        time=time,
        qpos=qpos,
        torques=torques,
        carrying=carrying,
        loads=loads,
        clearance=clearance,
        com_margin=margins,
        peak_utilisation=peak,
    )


class _Roll:
    """Feet that roll without slipping, from sample to sample."""

    def __init__(self, robot: Robot, start: Stand) -> None:
        self.robot = robot
        self.away = {foot: np.zeros(2) for foot in robot.feet}  # from their places (m)
        self.step = dict(self.away)  # of the last sample
        self.turned = self._rotations(start)

    def _rotations(self, stand: Stand) -> dict[str, Array]:
        config = Configuration(self.robot, stand.qpos)
        return {foot: config.frame_rotation(self.robot.foot_frames[foot]) for foot in self.away}

    def solve(
        self, leg: _Leg, carrying: Sequence[str], share: float, posture: Array, *, rolling: bool
    ) -> Stand:
        """Solves a sample; how far the feet roll and the legs' angles determine each other."""
        robot, normal = self.robot, leg.start.task.ground.normal()
        away = {foot: place + self.step[foot] for foot, place in self.away.items()}
        for _ in range(_MAX_ITERATIONS):
            task = _task(robot, leg, carrying, share, posture, away)
            stand = solve_stand(robot, task, explain=False)
            if not rolling:
                return stand
            rotations = self._rotations(stand)
            last, away = away, dict(self.away)
            for foot in carrying:
                turn = pin.log3(rotations[foot] @ self.turned[foot].T)
                away[foot] = away[foot] + np.cross(turn, robot.foot_radius[foot] * normal)[:2]
            if max(np.abs(away[foot] - last[foot]).max() for foot in away) < _ROLLED:
                self.step = {foot: away[foot] - self.away[foot] for foot in away}
                self.away, self.turned = away, rotations
                return stand
        raise ConfigurationError(
            "rolling",
            "how far the feet roll does not settle; bring the stances nearer, or set it off",
        )


def _law(share: float) -> float:
    """Returns the minimum-jerk law from 0 to 1: neither velocity nor acceleration at the ends."""
    return share**3 * (10 - 15 * share + 6 * share**2)


def _samples(seconds: float, rate: float, stances: Sequence[StandTask]) -> int:
    """Checks the arguments' kinds; returns how many samples a leg has."""
    if isinstance(stances, StandTask) or len(stances) < 2:
        raise ConfigurationError("stances", "a path goes through at least 2")
    for task in stances:
        if not isinstance(task, StandTask):
            raise ConfigurationError("stances", f"{task!r} is not a StandTask")
    given: dict[str, object] = {"seconds": seconds, "rate": rate}
    for name, value in given.items():
        number = float(value) if isinstance(value, Real) else math.nan
        if isinstance(value, bool) or not 0 < number < math.inf:
            raise ConfigurationError(name, f"{value!r} is not a finite number above 0")
    if max(seconds * rate, 2 * len(stances)) > MAX_SAMPLES:
        raise ConfigurationError("seconds, rate", f"that is more than {MAX_SAMPLES} samples")
    return max(2, math.ceil(seconds * rate / (len(stances) - 1) - 1e-9))


def _legs(robot: Robot, stances: Sequence[StandTask]) -> tuple[list[_Leg], tuple[Stand, ...]]:
    """Solves the stances, and checks that they can follow each other."""
    if any(task.ground != stances[0].ground for task in stances):
        raise ConfigurationError("stances", "they are on different grounds; a path is on one")
    fixed = any(task.offset is not None or not isinstance(task.com, str) for task in stances)
    if fixed and any(task.com == "inside" for task in stances):
        raise ConfigurationError("stances", "com 'inside' cannot be mixed with points or offsets")
    solved: list[Stand] = []
    keys = []
    for number, task in enumerate(stances, 1):
        if solved:
            task = replace(task, posture=tuple(solved[-1].joint_positions(robot)))
        try:
            solved.append(solve_stand(robot, task))
        except StanceUnreachableError as error:
            error.args = (f"stance {number}: {error}",)
            raise
        com = Configuration(robot, solved[-1].qpos).center_of_mass()
        keys.append(_Key(solved[-1].task, solved[-1].qpos[:3], com, solved[-1].foot_targets))
    sets = []
    for number, (one, two) in enumerate(pairwise(keys), 1):
        idle = one.task.lifted.keys() | two.task.lifted.keys()
        sets.append(tuple(foot for foot in robot.feet if foot not in idle))
        where = f"between stances {number} and {number + 1}"
        if len(sets[-1]) < 3:
            problem = f"only {len(sets[-1])} feet carry {where}; put one down before the next lifts"
            raise ConfigurationError("stances", problem)
        for foot in sets[-1]:
            if np.abs(one.feet[foot] - two.feet[foot]).max() > 1e-9:
                problem = f"foot {foot} carries {where}, and cannot move; lift it in a stance"
                raise ConfigurationError("stances", problem)
        if number > 1 and not (set(sets[-1]) <= set(sets[-2]) or set(sets[-1]) >= set(sets[-2])):
            problem = f"one foot lands and another lifts in stance {number}; give it twice"
            raise ConfigurationError("stances", f"{problem}, the load needs time to shift")
    sets = [sets[0], *sets, sets[-1]]
    legs = [
        _Leg(one, two, sets[number], sets[number - 1], sets[number + 1])
        for number, (one, two) in enumerate(pairwise(keys), 1)
    ]
    return legs, tuple(solved)


def _task(
    robot: Robot,
    leg: _Leg,
    carrying: Sequence[str],
    share: float,
    posture: Array,
    away: Mapping[str, Array],
) -> StandTask:
    """Returns the task of a moment, in world coordinates; the feet are beside their places."""
    one, two = leg.start.task, leg.end.task

    def between(start: float, end: float) -> float:
        return start + share * (end - start)

    ground, normal = one.ground, one.ground.normal()
    places = {foot: leg.start.feet[foot] for foot in robot.feet}
    places |= {foot: p + share * (leg.end.feet[foot] - p) for foot, p in places.items()}
    feet = {
        foot: (float(place[0] + away[foot][0]), float(place[1] + away[foot][1]))
        for foot, place in places.items()
    }
    contacts = {
        foot: ground.centre(foot, feet[foot], robot.foot_radius[foot])
        - robot.foot_radius[foot] * normal
        for foot in carrying
    }
    centre = np.mean(list(contacts.values()), axis=0)
    base = leg.start.base + share * (leg.end.base - leg.start.base)
    com = leg.start.com + share * (leg.end.com - leg.start.com)
    by_base = one.offset is not None or two.offset is not None
    needed = max(1e-6, between(one.com_margin, two.com_margin) - 1e-9)
    margin = com_margin(com, contacts)
    if not by_base and margin < needed:
        raise StaticsInfeasibleError(
            Infeasibility.COM_OUTSIDE,
            f"its projection is {1e3 * margin:.1f} mm inside that of {', '.join(contacts)}, and "
            f"must be {1e3 * needed:.1f} mm; insert a stance with the com over these feet",
            margin=margin,
            feet=contacts,
        )
    apart = None
    if one.self_clearance is not None and two.self_clearance is not None:
        apart = between(one.self_clearance, two.self_clearance)
    heights = {
        foot: between(one.lifted.get(foot, 0.0), two.lifted.get(foot, 0.0)) for foot in robot.feet
    }
    return StandTask(
        height=float(base[2] - centre[2]),
        roll=between(one.roll, two.roll),
        pitch=between(one.pitch, two.pitch),
        yaw=between(one.yaw, two.yaw),
        offset=(float(base[0] - centre[0]), float(base[1] - centre[1])) if by_base else None,
        feet=feet,
        lifted={f: max(_TOUCHING, h) for f, h in heights.items() if f not in carrying},
        ground=ground,
        com="centre" if by_base else (float(com[0]), float(com[1])),
        joint_margin=between(one.joint_margin, two.joint_margin),
        ground_clearance=between(one.ground_clearance, two.ground_clearance),
        self_clearance=apart,
        posture=tuple(posture),
    )


def _even(
    robot: Robot, leg: _Leg, stand: Stand, share: float
) -> tuple[Array, dict[str, float], float]:
    """Returns torques, vertical forces and com margin, the feet sharing the load evenly.

    Towards a leg of the path on which fewer feet carry, the load passes to those: a mean of two
    sets of forces that balance the robot does so too.
    """
    config = Configuration(robot, stand.qpos)

    def balance(feet: Sequence[str]) -> tuple[Array, dict[str, Array], float | None]:
        normals = {foot: stand.task.ground.normal() for foot in feet}
        result = gravity_compensation(config, feet, normals=normals, sharing=LoadSharing.EVEN)
        return result.joint_torques, result.contact_forces, result.com_margin

    torques, forces, margin = balance(stand.carrying)
    assert margin is not None
    parts = [(1.0, torques, forces)]
    for feet, key, near in ((leg.before, leg.start, 1 - share), (leg.after, leg.end, share)):
        if not set(feet) < set(stand.carrying):
            continue
        points = {foot: stand.contact_points[foot] for foot in feet}
        inside, full = com_margin(config.center_of_mass(), points), key.margin(feet)
        if min(inside, full) > 0:
            weight = near * _law(min(1.0, inside / full))
            parts.append((weight, *balance(feet)[:2]))
    first = 1.0 - sum(weight for weight, _, _ in parts[1:])
    parts[0] = (first, torques, forces)
    mixed = np.sum([weight * part for weight, part, _ in parts], axis=0)
    loads = {
        foot: sum(float(weight * part[foot][2]) for weight, _, part in parts if foot in part)
        for foot in stand.carrying
    }
    return mixed, loads, margin
