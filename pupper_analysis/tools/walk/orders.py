"""Is a policy this robot's: orders, signs, scales, histories, ranked by how it walks with each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import permutations
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.results import Result
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.walk.contract import BY_FRAME, BY_TERM, Contract
from pupper_analysis.tools.walk.gait import (
    SPEED_ATOL,
    check_command,
    check_runs,
    evaluate_tracking,
    joint_torques,
)
from pupper_analysis.tools.walk.intervals import DEFAULT_SECONDS, WARM_UP_SECONDS
from pupper_analysis.tools.walk.policy import Policy
from pupper_analysis.tools.walk.runs import find_joint_indices, prepare_stage, simulate_cases

Array = NDArray[np.float64]

DEFAULT_COMMANDS = ((0.5, 0.0, 0.0), (0.0, 0.3, 0.0), (0.0, 0.0, 0.8))
"""Forward, to the left, and turning: one alone is walked with wrong orders, too."""

MIN_COST_RATIO = 1.1
"""The best is distinguished from the next where that costs so many times as much: a choice. On v3
the next to Pupper's own costs 1.2 times as much."""

SCALE_FACTORS = (0.5, 2.0)
"""Times the stated scale of actions: what is off by less walks as well."""

_MOST_LIMBS = 4
"""Limbs of which all orders are tried; of more, only exchanged pairs."""


@dataclass(frozen=True, eq=False)
class Candidate(Result):
    """A reading of a policy, and how it walks so.

    Attributes:
        change: What is other than the policy states: ``stated``, ``limbs``, ``by-kind``, ``sign``,
            ``scale``, ``history``.
        detail: To what a scale or a history is changed; of limbs whose first joints are taken for
            which; else empty.
        joints: The robot's joints in the policy's order.
        flipped: Those that turn the other way than stated.
        tracked: How many of the commands are tracked.
        fallen: In how many it falls.
        torque: Root of the mean square of all motors' torques, in all runs (N m).
        error: How far speed and turning are off, as a share of the command; mean of all.
        cost: torque (1 + error): what ranks those that track as many.
    """

    change: str
    detail: str
    joints: tuple[str, ...]
    flipped: tuple[str, ...]
    tracked: int
    fallen: int
    torque: float = field(metadata={"unit": "N m"})
    error: float = field(metadata={"unit": "1"})
    cost: float = field(metadata={"unit": "N m"})


@dataclass(frozen=True, eq=False)
class Orders(Result):
    """Readings of a policy (orders and signs of joints, scales, histories), the best first.

    Not tried is an offset of a zero: a policy walks with 0.3 rad of it.

    Attributes:
        name: The robot's name.
        policy: The name of the policy's file.
        commands: (n, 3) those that were tried (m/s, m/s, rad/s).
        candidates: The best first: most commands tracked, then the least cost.
        stated: The place of what the policy states among them, from 0.
        lead: The cost of the next that tracks as many over that of the first; None where none does.
        seconds: Simulated in each run.
    """

    name: str
    policy: str
    commands: Array = field(metadata={"unit": "m/s or rad/s"})
    candidates: tuple[Candidate, ...]
    stated: int
    lead: float | None = field(metadata={"unit": "1"})
    seconds: float = field(metadata={"unit": "s"})
    _reported: ClassVar[tuple[str, ...]] = ("passed", "determined", "alike")

    @property
    def determined(self) -> bool:
        """Whether the first is clearly the best."""
        return bool(self.candidates[0].tracked) and (
            self.lead is None or self.lead > MIN_COST_RATIO
        )

    @property
    def alike(self) -> tuple[int, ...]:
        """Places of those that walk as well as the first, itself among them."""
        best = self.candidates[0]
        return tuple(
            place
            for place, one in enumerate(self.candidates)
            if best.tracked
            and one.tracked == best.tracked
            and one.cost <= MIN_COST_RATIO * best.cost
        )

    @property
    def passed(self) -> bool:
        """Whether what the policy states is the best, or as good as that."""
        return self.stated in self.alike


@check_arguments
def rank_orders(
    robot: Robot,
    policy: Policy,
    *,
    commands: ArrayLike = DEFAULT_COMMANDS,
    seconds: float = DEFAULT_SECONDS,
    workers: int | None = None,
) -> Orders:
    """Ranks readings of a policy by how it walks a robot with each.

    Tried are all orders of limbs that have as many joints, each also with the joints by kind (all
    first ones, then all second ones) instead of by limb; the other sign of each joint, and of
    all joints of a kind; half and twice the scale of actions; the history the other way round, and
    laid out the other way. Each walks forward, to the left, and turns.

    Args:
        robot: The robot.
        policy: The policy.
        commands: (n, 3) what it is commanded (m/s, m/s, rad/s).
        seconds: Of each run, 3 to 600.
        workers: Threads; by default one per core.

    Raises:
        ConfigurationError: If an argument is out of its range, or the base is fixed.
        ModelError: If the policy does not fit the robot.
    """
    wanted = np.array([check_command(command) for command in np.atleast_2d(commands)])
    check_runs(1, seconds, WARM_UP_SECONDS)
    contract = policy.contract
    stated = tuple(robot.joint_names[index] for index in find_joint_indices(robot, policy))
    contract = replace(contract, joints=stated)
    found = [
        _walked(robot, replace(policy, contract=read), wanted, seconds, change, workers)
        for change, read in _readings(robot, contract)
    ]
    own = found[0]
    ranked = sorted(found, key=lambda one: (-one.tracked, one.cost))
    lead = None
    if len(ranked) > 1 and ranked[1].tracked == ranked[0].tracked:
        lead = ranked[1].cost / ranked[0].cost
    return Orders(
        name=robot.name,
        policy=policy.name,
        commands=wanted,
        candidates=tuple(ranked),
        stated=ranked.index(own),
        lead=lead,
        seconds=float(seconds),
    )


def group_limbs(robot: Robot, joints: Sequence[str]) -> list[list[int]]:
    """Returns the limbs, each as the places of its joints: those below one child of the base."""
    model = robot.mj_model
    base = model.body(robot.mj_base).id
    limbs: dict[int, list[int]] = {}
    for place, name in enumerate(joints):
        body = int(model.jnt_bodyid[model.joint(name).id])
        while int(model.body_parentid[body]) not in (0, base):
            body = int(model.body_parentid[body])
        limbs.setdefault(body, []).append(place)
    return list(limbs.values())


Change = tuple[str, str, tuple[str, ...]]


def _readings(robot: Robot, contract: Contract) -> Iterator[tuple[Change, Contract]]:
    """Yields what is changed (what, to what, which joints are flipped), and the contract then."""
    stated = contract.joints
    limbs = group_limbs(robot, stated)
    yield ("stated", "", ()), contract
    for change, detail, joints in _permuted(stated, limbs):
        yield (change, detail, ()), replace(contract, joints=joints)
    kinds = max(len(limb) for limb in limbs)
    flips = [(place,) for place in range(len(stated))]
    of_kind = [tuple(limb[kind] for limb in limbs if len(limb) > kind) for kind in range(kinds)]
    for places in (*flips, *(places for places in of_kind if len(places) > 1)):
        signs = contract.signs.copy()
        signs[list(places)] *= -1.0
        names = tuple(stated[place] for place in places)
        yield ("sign", "", names), replace(contract, signs=signs)
    for scale in SCALE_FACTORS:
        changed = replace(contract, action_scale=scale * contract.action_scale)
        yield ("scale", f"x {scale:g}", ()), changed
    if contract.history > 1:
        turned = not contract.newest_first
        other = BY_TERM if contract.layout == BY_FRAME else BY_FRAME
        first = "newest first" if turned else "oldest first"
        yield ("history", first, ()), replace(contract, newest_first=turned)
        yield ("history", other, ()), replace(contract, layout=other)


def _permuted(
    stated: tuple[str, ...], limbs: Sequence[Sequence[int]]
) -> Iterator[tuple[str, str, tuple[str, ...]]]:
    """Yields other orders of joints, what was exchanged, and which limbs by their first joints."""
    seen = {stated}
    for size, count in Counter(len(limb) for limb in limbs).items():
        alike = [limb for limb in limbs if len(limb) == size]
        for order in _orders(count):
            joints = list(stated)
            for limb, other in zip(alike, order, strict=True):
                for place, from_place in zip(limb, alike[other], strict=True):
                    joints[place] = stated[from_place]
            pairs = [(stated[limb[0]], joints[limb[0]]) for limb in alike]
            detail = ", ".join(f"{one} > {other}" for one, other in pairs if one != other)
            by_kind = _by_kind(joints, alike)
            for change, one in (("limbs", tuple(joints)), ("by-kind", by_kind)):
                if one not in seen:
                    seen.add(one)
                    yield change, detail, one


def _orders(count: int) -> Iterator[tuple[int, ...]]:
    if count <= _MOST_LIMBS:
        yield from permutations(range(count))
        return
    for one in range(count):
        for other in range(one):
            order = list(range(count))
            order[one], order[other] = other, one
            yield tuple(order)


def _by_kind(joints: Sequence[str], limbs: Sequence[Sequence[int]]) -> tuple[str, ...]:
    """Returns joints of limbs that are alike, all first ones first; back if they are so."""
    places = sorted(place for limb in limbs for place in limb)
    grouped = [place for limb in limbs for place in limb]
    if grouped == places:  # by limb
        grouped = [place for kind in zip(*limbs, strict=True) for place in kind]
    ordered = list(joints)
    for place, from_place in zip(places, grouped, strict=True):
        ordered[place] = joints[from_place]
    return tuple(ordered)


def _walked(
    robot: Robot,
    policy: Policy,
    commands: Array,
    seconds: float,
    change: Change,
    workers: int | None,
) -> Candidate:
    stage = prepare_stage(robot, policy)
    cases = [stage.case(command) for command in commands]
    tracked = fallen = 0
    squares, errors = [], []
    for run in simulate_cases(stage, cases, seconds, WARM_UP_SECONDS, workers):
        followed, command = evaluate_tracking(stage, run, WARM_UP_SECONDS), run.case.command
        tracked += followed.tracks
        fallen += run.fallen
        squares.append(np.nan_to_num(joint_torques(stage, run)) ** 2)
        off = np.array([*(followed.velocity - command[:2]), followed.turning - command[2]])
        asked = max(float(np.linalg.norm(command)), SPEED_ATOL)  # a stand is commanded 0
        errors.append(1.0 if run.fallen else float(np.linalg.norm(off)) / asked)
    torque = float(np.sqrt(np.mean([square.mean() for square in squares])))
    error = float(np.mean(errors))
    what, detail, flipped = change
    return Candidate(
        change=what,
        detail=detail,
        joints=policy.contract.joints,
        flipped=flipped,
        tracked=tracked,
        fallen=fallen,
        torque=torque,
        error=error,
        cost=torque * (1 + error),
    )
