"""How near the feet can come to targets that are out of reach."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.stance.clearance import Shapes
from pupper_analysis.stance.problem import Goal
from pupper_analysis.stance.solver import TOUCHING, Stand, measure
from pupper_analysis.statics.support_polygon import polygon_sides

Array = NDArray[np.float64]


def nearest(shapes: Shapes, goal: Goal, start: Array, *, clear: bool = False) -> Stand:
    """Finds how near the feet can come to targets that are out of reach.

    The sum of the squared distances is minimised over the base's place and the joints, inside their
    limits, with the base's orientation and height and the com's place as the task has them. PlaCo's
    Gauss-Newton steps, made for errors that vanish, stop short of that minimum. If ``clear``, no
    part but the feet may be lower than the task allows.
    """
    from scipy import optimize  # slow to import

    robot = shapes.robot
    free = [0, 1, *range(7, robot.nq)]
    columns = [0, 1, *range(6, robot.nv)]

    def at(values: Array) -> Configuration:
        qpos = start.copy()
        qpos[free] = values
        return Configuration(robot, qpos)

    def distances(values: Array) -> tuple[float, Array]:
        config = at(values)
        positions, jacobians = config.foot_positions(), config.foot_jacobians()
        total, gradient = 0.0, np.zeros(len(free))
        for foot, target in goal.targets.items():
            error = positions[foot] - target
            total += float(error @ error)
            gradient += 2 * error @ jacobians[foot][:, columns]
        return total, gradient

    constraints = [_com_constraint(goal, at, columns)]
    if clear:
        ground = goal.task.ground, goal.targets, goal.depths

        looked_at = np.isfinite(shapes.heights(start, *ground))  # feet are not

        def room(values: Array) -> Array:
            heights = shapes.heights(at(values).qpos, *ground)[looked_at]
            above: Array = heights - (goal.task.ground_clearance + TOUCHING)
            return above

        def room_rates(values: Array) -> Array:
            rates: Array = shapes.height_rates(at(values).qpos, *ground)[looked_at]
            return rates

        constraints.append({"type": "ineq", "fun": room, "jac": room_rates})
    outcome = optimize.minimize(
        distances,
        start[free],
        jac=True,
        method="SLSQP",
        bounds=[(None, None), (None, None), *zip(goal.lower, goal.upper, strict=True)],
        constraints=constraints,
        options={"ftol": 1e-14, "maxiter": 200},
    )
    return measure(shapes, goal, at(outcome.x).qpos, 0)


def _com_constraint(
    goal: Goal, at: Callable[[Array], Configuration], columns: Sequence[int]
) -> dict[str, object]:
    """Says to SLSQP where the com, or the base, shall be.

    Args:
        goal: What shall hold.
        at: The configuration of the free values.
        columns: The columns of Jacobians that belong to them.
    """
    if goal.task.com == "inside":
        sides = polygon_sides(goal.contacts)
        return {
            "type": "ineq",
            "fun": lambda values: (
                sides[:, :2] @ at(values).center_of_mass()[:2] + sides[:, 2] - goal.task.com_margin
            ),
            "jac": lambda values: sides[:, :2] @ at(values).com_jacobian()[:2, columns],
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
        "jac": lambda values: at(values).com_jacobian()[:2, columns],
    }
