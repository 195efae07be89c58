"""How near the feet can come to targets that are out of reach."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.stance.clearance import Shapes
from pupper_analysis.stance.constraints import place_of
from pupper_analysis.stance.judge import Stand, measure
from pupper_analysis.stance.problem import Goal

Array = NDArray[np.float64]


def nearest(shapes: Shapes, goal: Goal, start: Array) -> Stand:
    """Finds how near the feet can come to targets that are out of reach.

    The sum of the squared distances is minimised over the base's place and the joints, inside their
    limits, with the base's orientation and height and the com's place as the task has them. PlaCo's
    Gauss-Newton steps, made for errors that vanish, stop short of that minimum.
    """
    from scipy import optimize  # slow to import

    programme = _Programme(shapes, goal, start)
    outcome = optimize.minimize(
        programme.distances,
        programme.start,
        jac=True,
        method="SLSQP",
        bounds=programme.bounds,
        constraints=programme.places(),
        options={"ftol": 1e-14, "maxiter": 200},
    )
    return measure(shapes, goal, programme.at(outcome.x).qpos, 0)


class _Programme:
    """What SLSQP is told, in the base's x and y and the joints.

    Attributes:
        start: (2 + nu,) where it begins.
        bounds: Least and most of each; none of the base's.
    """

    def __init__(self, shapes: Shapes, goal: Goal, start: Array) -> None:
        robot = shapes.robot
        self._shapes, self._goal, self._qpos = shapes, goal, start
        self._last: tuple[Array, Configuration] | None = None
        self._free = [0, 1, *range(7, robot.nq)]
        self._columns = [0, 1, *range(6, robot.nv)]
        self.start = start[self._free]
        limits = zip(goal.lower, goal.upper, strict=True)
        self.bounds = [(None, None), (None, None), *limits]

    def at(self, values: Array) -> Configuration:
        """Returns the robot there; it is asked for by each constraint in turn, and made once."""
        if self._last is None or not np.array_equal(self._last[0], values):
            qpos = self._qpos.copy()
            qpos[self._free] = values
            self._last = values.copy(), Configuration(self._shapes.robot, qpos)
        return self._last[1]

    def distances(self, values: Array) -> tuple[float, Array]:
        """Returns the sum of the feet's squared distances (m^2), and its gradient."""
        config = self.at(values)
        positions, jacobians = config.foot_positions(), config.foot_jacobians()
        total, gradient = 0.0, np.zeros(len(self._free))
        for foot, target in self._goal.targets.items():
            error = positions[foot] - target
            total += float(error @ error)
            gradient += 2 * error @ jacobians[foot][:, self._columns]
        return total, gradient

    def places(self) -> list[dict[str, object]]:
        """Says where the com, or the base, shall be."""
        return [
            {
                "type": "eq" if one.equal else "ineq",
                "fun": lambda values, one=one: one.residual(self._goal, self.at(values)),
                "jac": lambda values, one=one: one.rates(self._goal, self.at(values))[
                    :, self._columns
                ],
            }
            for one in place_of(self._goal)
        ]
