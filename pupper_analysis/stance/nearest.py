"""How near the feet can come to targets, and stands at the edge of what is possible."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.stance.clearance import Shapes
from pupper_analysis.stance.judge import TOUCHING, Stand, measure
from pupper_analysis.stance.problem import Goal
from pupper_analysis.stance.tasks import TASK_TOLERANCE
from pupper_analysis.statics.support_polygon import polygon_sides

Array = NDArray[np.float64]


_MOST_CLEAR = 120
"""Steps with the ground kept clear: where there is a way it takes some ten, in hard cases 80, and
where a part cannot be lifted out SLSQP stalls at each of them."""


def nearest(shapes: Shapes, goal: Goal, start: Array, *, clear: bool = False) -> Stand:
    """Finds how near the feet can come to targets that are out of reach.

    The sum of the squared distances is minimised over the base's place and the joints, inside their
    limits, with the base's orientation and height and the com's place as the task has them. PlaCo's
    Gauss-Newton steps, made for errors that vanish, stop short of that minimum. If ``clear``, no
    part but the feet may be lower than the task allows.
    """
    from scipy import optimize  # slow to import

    programme = _Programme(shapes, goal, start)
    constraints = [programme.com(0.0)]
    if clear:
        constraints.append(programme.room(TOUCHING))
    outcome = optimize.minimize(
        programme.distances,
        programme.start,
        jac=True,
        method="SLSQP",
        bounds=programme.bounds,
        constraints=constraints,
        options={"ftol": 1e-14, "maxiter": _MOST_CLEAR if clear else 200},
    )
    return measure(shapes, goal, programme.at(outcome.x).qpos, 0)


def in_place_and_clear(shapes: Shapes, goal: Goal, start: Array) -> Stand:
    """Finds the stand nearest to a configuration, with the feet in place and the ground clear.

    Both at once, to rounding, and the com with its margin: what is left of a stand at the edge of
    what is possible may be micrometres wide, and by turns each is had at the other's expense.

    Args:
        shapes: The robot with its shapes.
        goal: The goal, whose com may be anywhere inside.
        start: (nq,) where feet miss by a millimetre or less.

    Returns:
        The stand, or what came of it.
    """
    from scipy import optimize  # slow to import

    programme = _Programme(shapes, goal, start)
    feet = {"type": "eq", "fun": programme.misses, "jac": programme.miss_rates}
    outcome = optimize.minimize(
        lambda values: (
            0.5 * float((values - programme.start) @ (values - programme.start)),
            values - programme.start,
        ),
        programme.start,
        jac=True,
        method="SLSQP",
        bounds=programme.bounds,
        constraints=[feet, programme.com(TASK_TOLERANCE), programme.room(0.0)],
        options={"ftol": 1e-13, "maxiter": 50},
    )
    config = programme.at(outcome.x)
    return measure(shapes, replace(goal, place=config.center_of_mass()[:2]), config.qpos, 0)


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

    def misses(self, values: Array) -> Array:
        """Returns by how much the feet are off (3 feet,) (m)."""
        positions = self.at(values).foot_positions()
        return np.concatenate(
            [positions[foot] - target for foot, target in self._goal.targets.items()]
        )

    def miss_rates(self, values: Array) -> Array:
        jacobians = self.at(values).foot_jacobians()
        return np.concatenate([jacobians[foot][:, self._columns] for foot in self._goal.targets])

    def com(self, more: float) -> dict[str, object]:
        """Says where the com, or the base, shall be; inside by so much more than asked (m)."""
        goal, at = self._goal, self.at
        if goal.task.com == "inside":
            sides, margin = polygon_sides(goal.contacts), goal.task.com_margin + more
            return {
                "type": "ineq",
                "fun": lambda values: (
                    sides[:, :2] @ at(values).center_of_mass()[:2] + sides[:, 2] - margin
                ),
                "jac": lambda values: sides[:, :2] @ at(values).com_jacobian()[:2, self._columns],
            }
        if goal.by_base:
            return {
                "type": "eq",
                "fun": lambda values: values[:2] - goal.place,
                "jac": lambda values: np.eye(2, len(values)),
            }
        return {
            "type": "eq",
            "fun": lambda values: at(values).center_of_mass()[:2] - goal.place,
            "jac": lambda values: at(values).com_jacobian()[:2, self._columns],
        }

    def room(self, more: float) -> dict[str, object]:
        """Says that parts shall be above the ground, by so much more than asked (m)."""
        shapes, goal = self._shapes, self._goal
        ground = goal.task.ground, goal.targets, goal.depths
        looked_at = np.isfinite(shapes.heights(self._qpos, *ground))  # feet are not
        least = goal.task.ground_clearance + more
        return {
            "type": "ineq",
            "fun": lambda v: shapes.heights(self.at(v).qpos, *ground)[looked_at] - least,
            "jac": lambda v: shapes.height_rates(self.at(v).qpos, *ground)[looked_at],
        }
