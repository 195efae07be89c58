"""Search for wrong wiring: servos that are exchanged, or rotate in the opposite direction.

A `Wiring` assigns the measured columns to joints, with signs. `find_wiring` examines wirings that
differ from the given assignment by one or two errors. The wirings are ranked by the evidence of the
measurements, and the most probable wirings are fitted. The result is the first wiring with which
the model explains the stands.
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
"""Upper bound of the number of wirings that are ranked by the evidence of all stands, after a
ranking by a few contradictory stands. A robot with four legs of three joints has 84 wirings with
one error. Chosen, not tuned.
"""

_MAX_FITTED_WIRINGS = 3
"""Largest number of wirings (assignments of measured columns to joints, with signs) of a ranking
that are fitted, because a fit is slow. Chosen, not tuned.
"""


_MAX_EXTENDED_WIRINGS = 1
"""Upper bound of the number of most probable wirings with one error to which a second error is
added, if no wiring with one error explains the stands. Chosen, not tuned.
"""


_MIN_EVIDENCE_GAIN = 10.0
"""Required increase of the log evidence by each of two errors of the wiring. Chosen, not tuned:
above log(84), the number of candidates, and below the hundreds of an exchange of v3.
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

    def combine(self, second: Wiring) -> Wiring:
        """Return the wiring with the errors of this wiring, then the errors of ``second``."""
        return Wiring(
            tuple(self.order[column] for column in second.order),
            tuple(
                sign * self.signs[column]
                for sign, column in zip(second.signs, second.order, strict=True)
            ),
            diagnose(
                "two-wiring-errors",
                first=_shorten_message(self.found),
                second=_shorten_message(second.found),
            ),
        )


def _shorten_message(found: Diagnostic) -> Diagnostic:
    """Return the message about a wiring error, without the claim that it explains all stands."""
    return replace(found, values={**found.values, "alone": None})


def generate_wirings(robot: Robot) -> Iterator[Wiring]:
    """Yield wirings with one error, as candidates for the search of wrong wiring.

    An error is a joint with the wrong sign, two exchanged joints, or two exchanged legs. Two legs
    can be exchanged if they have no joint in common and the same number of joints, more than one.
    """
    names, identity, positive = robot.joint_names, tuple(range(robot.nu)), (1.0,) * robot.nu
    for joint, name in enumerate(names):
        signs = tuple(-1.0 if column == joint else 1.0 for column in identity)
        yield Wiring(identity, signs, diagnose("joint-turns-the-other-way", joint=name, alone=1))
    for joint, partner in itertools.combinations(identity, 2):
        message = diagnose(
            "joints-exchanged", joints=[names[joint]], others=[names[partner]], alone=1
        )
        yield Wiring(_exchange_entries(identity, [joint], [partner]), positive, message)
    legs = [[names.index(name) for name in leg_joints(robot, p)] for p in robot.contact_points]
    legs = [leg for number, leg in enumerate(legs) if leg not in legs[:number]]
    for first, second in itertools.combinations(legs, 2):
        if len(first) == len(second) > 1 and not set(first) & set(second):
            message = diagnose(
                "joints-exchanged",
                joints=[names[joint] for joint in first],
                others=[names[joint] for joint in second],
                alone=1,
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

    Candidates are wirings that differ from the present wiring by one error (`generate_wirings`), or
    by two errors. The candidates are ranked by the log evidence of the measurements, linearised
    about the stated values. The most probable candidates are fitted.

    Args:
        robot: Robot.
        stands: Stands, joints in actuator order.
        evidence: Function that returns the log evidence of stands.
        fit: Function that fits stands.
        doubted: Rows of stands that contradict the present wiring, if the wiring explains the other
            stands. The candidates, with one error, are then ranked by a few stands first, which is
            faster.

    Returns:
        First fitted wiring whose fit has no failures; None without such a wiring.
    """

    def evaluate(candidate: MeasuredStands) -> float:
        """Return the log evidence of stands; minus infinity if it cannot be computed."""
        try:
            return evidence(candidate)
        except (PupperAnalysisError, np.linalg.LinAlgError):  # unreachable or not balanced
            return -math.inf

    def rank(
        wirings: Iterable[Wiring], weighed: MeasuredStands, least: float
    ) -> list[tuple[float, Wiring]]:
        """Return evidence and wiring, if the evidence is above ``least``, most probable first."""
        ranked = [(evaluate(wiring.apply(weighed)), wiring) for wiring in wirings]
        return sorted((item for item in ranked if item[0] > least), key=lambda item: -item[0])

    wirings: Iterable[Wiring] = generate_wirings(robot)
    if doubted:
        other_rows = [row for row in range(len(stands)) if row not in doubted]
        num_others = max(0, MIN_STANDS - len(doubted))
        few = stands.select_rows([*doubted, *other_rows[:num_others]])
        ranked = rank(wirings, few, evaluate(few))
        wirings = [wiring for _, wiring in ranked[:_MAX_WEIGHED_WIRINGS]]

    def find_explanation(ranked: Sequence[tuple[float, Wiring]]) -> Wiring | None:
        """Return the first of the most probable wirings whose fit has no failures."""
        for _, wiring in ranked[:_MAX_FITTED_WIRINGS]:
            try:
                if fit(wiring.apply(stands)).explained:
                    return wiring
            except (PupperAnalysisError, np.linalg.LinAlgError):
                continue
        return None

    present = evaluate(stands)
    ranked = rank(wirings, stands, present)
    found = find_explanation(ranked)
    for likely, first in () if found or doubted else ranked[:_MAX_EXTENDED_WIRINGS]:
        if likely > present + _MIN_EVIDENCE_GAIN:
            pairs = [first.combine(second) for second in generate_wirings(robot)]
            found = find_explanation(rank(pairs, stands, likely + _MIN_EVIDENCE_GAIN))
    return found
