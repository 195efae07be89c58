"""Is a policy this robot's: orders and signs of joints, ranked by how well it walks with each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.walk.gait import follow, joint_torques
from pupper_analysis.tools.walk.intervals import SECONDS, WARM_UP
from pupper_analysis.tools.walk.policy import Policy
from pupper_analysis.tools.walk.runs import joint_indices, simulate_cases, stage_of

Array = NDArray[np.float64]

COMMANDS = ((0.5, 0.0, 0.0), (0.0, 0.3, 0.0), (0.0, 0.0, 0.8))
"""Forward, to the left, and turning: one alone is walked with wrong orders, too."""

CLEAR = 1.1
"""The best is distinguished from the next where that costs so many times as much: a choice. On v3
the next to Pupper's own costs 1.2 times as much."""

_MOST_LIMBS = 4
"""Limbs of which all orders are tried; of more, only exchanged pairs."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """An order and signs of joints, and how a policy walks with them.

    Attributes:
        change: What is other than the policy states: ``stated``, ``limbs``, ``by-kind``, ``sign``.
        joints: The robot's joints in the policy's order.
        flipped: Those that turn the other way than stated.
        tracked: How many of the three commands are tracked.
        fallen: In how many it falls.
        torque: Root of the mean square of all motors' torques, in all three (N m).
        error: How far speed and turning are off, as a share of the command; mean of the three.
        cost: torque (1 + error): what ranks those that track as many.
    """

    change: str
    joints: tuple[str, ...]
    flipped: tuple[str, ...]
    tracked: int
    fallen: int
    torque: float
    error: float
    cost: float


@dataclass(frozen=True, eq=False)
class Orders:
    """Orders and signs of joints, ranked by how a policy walks with each.

    What is not asked: an offset of a zero, a scale that is wrong a little. A policy walks with 0.3
    rad of the first.

    Attributes:
        name: The robot's name.
        policy: The name of the policy's file.
        commands: (3, 3) those that were tried.
        candidates: The best first: most commands tracked, then the least cost.
        stated: The place of what the policy states among them, from 0.
        lead: The cost of the next that tracks as many over that of the first; None where none does.
    """

    name: str
    policy: str
    commands: Array
    candidates: tuple[Candidate, ...]
    stated: int
    lead: float | None

    @property
    def determined(self) -> bool:
        """Whether the first is clearly the best."""
        return bool(self.candidates[0].tracked) and (self.lead is None or self.lead > CLEAR)

    @property
    def passed(self) -> bool:
        """Whether what the policy states is the best, or as good as that."""
        own, best = self.candidates[self.stated], self.candidates[0]
        return own.tracked > 0 and own.tracked == best.tracked and own.cost <= CLEAR * best.cost


@check_arguments
def rank_orders(robot: Robot, policy: Policy, *, workers: int | None = None) -> Orders:
    """Ranks orders and signs of joints by how a policy walks a robot with each.

    Tried are all orders of limbs that have as many joints, each also with the joints by kind (all
    first ones, then all second ones) instead of by limb, and the other sign of each joint, and of
    all joints of a kind. Each walks forward, to the left, and turns.

    Args:
        robot: The robot.
        policy: The policy.
        workers: Threads; by default one per core.

    Raises:
        ConfigurationError: If the base is fixed.
        ModelError: If the policy does not fit the robot.
    """
    stated = tuple(robot.joint_names[index] for index in joint_indices(robot, policy))
    found = [
        _walked(robot, policy, change, order, flipped, workers)
        for change, order, flipped in _candidates(robot, stated)
    ]
    own = found[0]
    ranked = sorted(found, key=lambda one: (-one.tracked, one.cost))
    lead = None
    if len(ranked) > 1 and ranked[1].tracked == ranked[0].tracked:
        lead = ranked[1].cost / ranked[0].cost
    return Orders(
        robot.name, policy.name, np.array(COMMANDS), tuple(ranked), ranked.index(own), lead
    )


def limbs_of(robot: Robot, joints: Sequence[str]) -> list[list[int]]:
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


def _candidates(
    robot: Robot, stated: tuple[str, ...]
) -> Iterator[tuple[str, tuple[str, ...], tuple[int, ...]]]:
    """Yields what is changed, the joints in the policy's order, and the places that are flipped."""
    limbs = limbs_of(robot, stated)
    seen = {stated}
    yield "stated", stated, ()
    sizes = Counter(len(limb) for limb in limbs)
    for size, count in sizes.items():
        alike = [limb for limb in limbs if len(limb) == size]
        for order in _orders(count):
            joints = list(stated)
            for limb, other in zip(alike, order, strict=True):
                for place, from_place in zip(limb, alike[other], strict=True):
                    joints[place] = stated[from_place]
            by_kind = _by_kind(joints, alike)
            for change, one in (("limbs", tuple(joints)), ("by-kind", by_kind)):
                if one not in seen:
                    seen.add(one)
                    yield change, one, ()
    for place in range(len(stated)):
        yield "sign", stated, (place,)
    for kind in range(max(sizes)):
        places = tuple(limb[kind] for limb in limbs if len(limb) > kind)
        if len(places) > 1:
            yield "sign", stated, places


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
    change: str,
    joints: tuple[str, ...],
    flipped: tuple[int, ...],
    workers: int | None,
) -> Candidate:
    """Returns how a policy walks with an order and signs."""
    signs = policy.contract.signs.copy()
    signs[list(flipped)] *= -1.0
    stage = stage_of(robot, policy.with_contract(joints=joints, signs=signs))
    cases = [stage.case(np.array(command)) for command in COMMANDS]
    tracked = fallen = 0
    squares, errors = [], []
    for run in simulate_cases(stage, cases, SECONDS, WARM_UP, workers):
        followed, command = follow(stage, run, WARM_UP), run.case.command
        tracked += followed.tracks
        fallen += run.fallen
        squares.append(np.nan_to_num(joint_torques(stage, run)) ** 2)
        off = np.array([*(followed.velocity - command[:2]), followed.turning - command[2]])
        errors.append(1.0 if run.fallen else float(np.linalg.norm(off) / np.linalg.norm(command)))
    torque = float(np.sqrt(np.mean([square.mean() for square in squares])))
    error = float(np.mean(errors))
    names = tuple(joints[place] for place in flipped)
    return Candidate(change, joints, names, tracked, fallen, torque, error, torque * (1 + error))
