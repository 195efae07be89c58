"""The best stance, what it costs, and whether it holds."""

from __future__ import annotations

from dataclasses import dataclass

from numpy.typing import ArrayLike

from pupper_analysis.analysis.payload import LoadedStance, try_payload
from pupper_analysis.analysis.stance import Stance, study_stance
from pupper_analysis.results import Result
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.tool import Place
from pupper_analysis.stance.optimize.best import BestStance, best_stance
from pupper_analysis.stance.optimize.search import Objective
from pupper_analysis.stance.task import StandTask


@dataclass(frozen=True, eq=False)
class BestStudy(Result):
    """The best stance that a search finds, and what is found out about it.

    Attributes:
        best: How it was found.
        stance: What it costs, and whether it holds.
        loaded: What it carries, if the payload is the objective.
    """

    best: BestStance
    stance: Stance
    loaded: LoadedStance | None

    @property
    def passed(self) -> bool:
        """Whether it holds, with its payload too if that is the objective."""
        return self.stance.passed and (self.loaded is None or self.loaded.passed)


def study_best(
    robot: Robot,
    objective: Objective,
    task: StandTask,
    point: Place = (0.0, 0.0, 0.0),
    *,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
) -> BestStudy:
    """Searches for the best stance, and finds out what it costs and whether it holds.

    Args:
        robot: The robot.
        objective: What shall be best.
        task: Where the search begins, and all that is not searched over.
        point: Where the payload is, as in ``with_payload``.
        kp: Servo stiffness (N m/rad), one or (nu,); the model's own by default.
        kd: Servo damping (N m s/rad), one or (nu,); the model's own by default.

    Raises:
        StanceUnreachableError: If the task itself is out of reach.
        StaticsInfeasibleError: If the task itself slides or tips.
        ConfigurationError: If the task, or another argument, makes no sense for the robot.
        ModelError: If the robot has no position servos, and kp and kd are not both given.
        NoEquilibriumError: If the payload is sought, and servos do not hold the task itself.
    """
    best = best_stance(robot, objective, task=task, point=point, kp=kp)
    loaded = None
    if best.payload is not None:
        loaded = try_payload(robot, best.stand, best.payload, kp=kp, kd=kd)
    return BestStudy(best, study_stance(robot, best.stand, kp=kp, kd=kd), loaded)
