"""Search for wrong wiring: servos that are exchanged, or rotate in the opposite direction.

A `Wiring` assigns the measured columns to joints, with signs. `find_wiring` examines wirings that
differ from the given assignment by one error. The wirings are ranked by the evidence of the
measurements, and the most probable ones are fitted. The result is the first wiring with which the
model explains the stands.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import PupperAnalysisError
from pupper_analysis.robot.joints import leg_joints
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.fit.measurements.stands import MIN_STANDS, MeasuredStands
from pupper_analysis.tools.fit.result import Fit

_MAX_WEIGHED_WIRINGS = 12
"""Upper bound of the number of wirings that are ranked by the evidence of all stands, if only some
stands contradict the given wiring. A robot with four legs of three joints has 84 wirings with one
error. Chosen, not tuned.
"""

_MAX_FITTED_WIRINGS = 3
"""Upper bound of the number of wirings (assignments of measured columns to joints, with signs) that
are fitted, because a fit is slow. Usually the true wiring is ranked first, or second if an encoder
offset is large as well.
"""


@dataclass(frozen=True)
class Wiring:
    """Assignment of measured columns to joints, with signs, for robots with exchanged plugs.

    Attributes:
        order: Index of the measured column from which each joint's values are taken, shape (nu,).
        signs: 1, or -1 for a joint that rotates in the opposite direction, shape (nu,).
        found: Message that describes the wiring.
    """

    order: tuple[int, ...]
    signs: tuple[float, ...]
    found: Diagnostic

    def apply(self, stands: MeasuredStands) -> MeasuredStands:
        """Return measured stands with permuted and negated columns, as this wiring specifies.

        The columns are those of commands and positions, with joints in actuator order.
        """
        order, signs = list(self.order), np.array(self.signs)
        return replace(
            stands,
            command=signs * stands.command[:, order],
            position=signs * stands.position[:, order],
        )


def generate_wirings(robot: Robot) -> Iterator[Wiring]:
    """Yield wirings with one error, as candidates for the search of wrong wiring.

    An error is a joint with the wrong sign, two exchanged joints, or two exchanged legs. Two legs
    can be exchanged if they have no joint in common and the same number of joints, more than one.
    """
    names, identity, positive = robot.joint_names, tuple(range(robot.nu)), (1.0,) * robot.nu
    for joint, name in enumerate(names):
        signs = tuple(-1.0 if column == joint else 1.0 for column in identity)
        yield Wiring(identity, signs, diagnose("joint-turns-the-other-way", joint=name))
    for joint, partner in itertools.combinations(identity, 2):
        message = diagnose("joints-exchanged", joints=[names[joint]], others=[names[partner]])
        yield Wiring(_exchange_entries(identity, [joint], [partner]), positive, message)
    legs = [[names.index(name) for name in leg_joints(robot, p)] for p in robot.contact_points]
    legs = [leg for number, leg in enumerate(legs) if leg not in legs[:number]]
    for first, second in itertools.combinations(legs, 2):
        if len(first) == len(second) > 1 and not set(first) & set(second):
            message = diagnose(
                "joints-exchanged",
                joints=[names[joint] for joint in first],
                others=[names[joint] for joint in second],
            )
            yield Wiring(_exchange_entries(identity, first, second), positive, message)


def _exchange_entries(
    order: tuple[int, ...], first: list[int], second: list[int]
) -> tuple[int, ...]:
    """Return ``order`` with the entries at the indices ``first`` and ``second`` exchanged."""
    exchanged = list(order)
    for first_entry, second_entry in zip(first, second, strict=True):
        exchanged[first_entry], exchanged[second_entry] = (
            exchanged[second_entry],
            exchanged[first_entry],
        )
    return tuple(exchanged)


def find_wiring(
    robot: Robot,
    stands: MeasuredStands,
    evidence: Callable[[MeasuredStands], float],
    fit: Callable[[MeasuredStands], Fit],
    doubted: Sequence[int] = (),
) -> Wiring | None:
    """Find the wiring (assignment and signs of the joints) with which the model explains stands.

    The search has these steps:

    1. Candidates are wirings that differ from the present wiring by one error (`generate_wirings`).
    2. The candidates are ranked by the log evidence of the measurements, linearised about the
    stated values.
    3. The three most probable candidates are fitted, if they are more probable than the present
    wiring.

    Args:
        robot: Robot.
        stands: Stands, joints in actuator order.
        evidence: Function that returns the log evidence of stands.
        fit: Function that fits stands.
        doubted: Rows of stands that contradict the present wiring, if the wiring explains the other
            stands. If given, the candidates are first ranked by these stands alone (with other
            stands, up to `MIN_STANDS`). Only the best `_MAX_WEIGHED_WIRINGS` candidates are then
            ranked by all stands, which is faster.

    Returns:
        First fitted wiring whose fit has no failures; None without such a wiring.
    """

    def evaluate(candidate: MeasuredStands) -> float:
        """Return the log evidence of stands; minus infinity if it cannot be computed."""
        try:
            return evidence(candidate)
        except (PupperAnalysisError, np.linalg.LinAlgError):  # unreachable or not balanced
            return -math.inf

    def rank(wirings: Iterable[Wiring], weighed: MeasuredStands) -> list[Wiring]:
        """Return the wirings that are more probable than the present one, most probable first."""
        present = evaluate(weighed)
        ranked = [(evaluate(wiring.apply(weighed)), wiring) for wiring in wirings]
        better = [item for item in ranked if item[0] > present]
        return [wiring for _, wiring in sorted(better, key=lambda item: -item[0])]

    wirings: Iterable[Wiring] = generate_wirings(robot)
    if doubted:
        others = [row for row in range(len(stands)) if row not in doubted]
        num_others = max(0, MIN_STANDS - len(doubted))
        few = stands.select_rows([*doubted, *others[:num_others]])
        wirings = rank(wirings, few)[:_MAX_WEIGHED_WIRINGS]
    for wiring in rank(wirings, stands)[:_MAX_FITTED_WIRINGS]:
        try:
            if fit(wiring.apply(stands)).explained:
                return wiring
        except (PupperAnalysisError, np.linalg.LinAlgError):
            continue
    return None
