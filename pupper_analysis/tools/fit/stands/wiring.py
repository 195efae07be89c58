"""Which servos answer to another's name, or turn the other way: plugs and signs that are wrong."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import PupperAnalysisError
from pupper_analysis.robot.joints import leg_joints
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.fit.measurements.stands import MeasuredStands
from pupper_analysis.tools.fit.result import Fit

Array = NDArray[np.float64]

_TRIED = 3
"""Wirings that are fitted whole: the true one is the first as a rule, and the second where a knee's
zero is far off, too."""


@dataclass(frozen=True)
class Wiring:
    """Joints whose columns of measurements are exchanged, or have the other sign.

    Attributes:
        order: (nu,) from which column each joint's numbers are taken.
        signs: (nu,) 1, or -1 of a joint that turns the other way.
        found: What is said of it.
    """

    order: tuple[int, ...]
    signs: tuple[float, ...]
    found: Diagnostic

    def apply(self, stands: MeasuredStands) -> MeasuredStands:
        """Returns stands, with a robot's joints in its order, as this wiring has them."""
        order, signs = list(self.order), np.array(self.signs)
        return replace(
            stands,
            command=signs * stands.command[:, order],
            position=signs * stands.position[:, order],
        )


def generate_wirings(robot: Robot) -> Iterator[Wiring]:
    """Yields one sign that is wrong, two plugs or two legs that are exchanged: each alone."""
    names, same, plain = robot.joint_names, tuple(range(robot.nu)), (1.0,) * robot.nu
    for joint, name in enumerate(names):
        signs = tuple(-1.0 if other == joint else 1.0 for other in same)
        yield Wiring(same, signs, diagnose("joint-turns-the-other-way", joint=name))
    for one, other in itertools.combinations(same, 2):
        found = diagnose("joints-exchanged", joints=[names[one]], others=[names[other]])
        yield Wiring(_exchange(same, [one], [other]), plain, found)
    legs = [[names.index(name) for name in leg_joints(robot, p)] for p in robot.contact_points]
    legs = [leg for number, leg in enumerate(legs) if leg not in legs[:number]]
    for first, second in itertools.combinations(legs, 2):
        if len(first) == len(second) > 1 and not set(first) & set(second):
            found = diagnose(
                "joints-exchanged",
                joints=[names[joint] for joint in first],
                others=[names[joint] for joint in second],
            )
            yield Wiring(_exchange(same, first, second), plain, found)


def _exchange(order: tuple[int, ...], first: list[int], second: list[int]) -> tuple[int, ...]:
    found = list(order)
    for one, other in zip(first, second, strict=True):
        found[one], found[other] = found[other], found[one]
    return tuple(found)


def find_wiring(
    robot: Robot,
    stands: MeasuredStands,
    evidence: Callable[[MeasuredStands], float],
    fit: Callable[[MeasuredStands], Fit],
) -> Wiring | None:
    """Returns the wiring with which the model explains stands that it does not explain as they are.

    Wirings are ranked by the evidence of the measurements, linear about the file's numbers. Those
    that are more likely than the stands as they are, the first ones, are fitted whole: what is
    otherwise with the robot may leave less with plugs exchanged, and hardly anything leaves none.
    None is named that leaves anything unexplained.

    Args:
        robot: The robot.
        stands: Its stands, with its joints in its order.
        evidence: Returns the logarithm of how likely stands are; raises where they cannot be.
        fit: Fits them.
    """

    def likely(given: MeasuredStands) -> float:
        try:
            return evidence(given)
        except (PupperAnalysisError, np.linalg.LinAlgError):  # out of reach, or of balance
            return -math.inf

    as_is = likely(stands)
    ranked = [(likely(wiring.apply(stands)), wiring) for wiring in generate_wirings(robot)]
    ranked = sorted((one for one in ranked if one[0] > as_is), key=lambda one: -one[0])
    for _, wiring in ranked[:_TRIED]:
        try:
            if fit(wiring.apply(stands)).explained:
                return wiring
        except (PupperAnalysisError, np.linalg.LinAlgError):
            continue
    return None
