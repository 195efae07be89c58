"""How hard a stance can be pushed, as it stands in the simulation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from numpy.typing import ArrayLike

from pupper_analysis.base.results import Result
from pupper_analysis.prepare.judge import judge
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.stability import LASTING
from pupper_analysis.simulation.verdict import Asked, Verdict
from pupper_analysis.simulation.verify import verify_stand
from pupper_analysis.stance.soft_ground import solve_stand_as_simulated
from pupper_analysis.stance.stand import Stand, solve_stand, stand_statics
from pupper_analysis.stance.task import StandTask
from pupper_analysis.tools.push.recovery import PushRecovery, push_recovery


@dataclass(frozen=True, eq=False)
class PushedStance(Result):
    """A stance, and the largest pushes from which it recovers.

    Attributes:
        name: The robot's name.
        stand: What is pushed: the stand with its feet sunk into MuJoCo's soft ground; the one on
            rigid ground where that is out of reach.
        recovery: The largest pushes.
        verdict: Whether it holds unpushed, with feed-forward: that of ``study_stance``. What stands
            and does not hold (another robot's torques, say) is pushed all the same.
    """

    name: str
    stand: Stand
    recovery: PushRecovery
    verdict: Verdict

    @property
    def passed(self) -> bool:
        """Whether it holds unpushed, by its verdict."""
        return self.verdict.passed


def study_pushes(
    robots: Sequence[Robot],
    task: StandTask,
    *,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
    directions: int = 12,
    resolution: float = 0.02,
) -> dict[str, PushedStance]:
    """Finds out how hard robots can be pushed in a stance (some three seconds each).

    Args:
        robots: The robots, of different names; all are solved before the first is pushed.
        task: The stance of each.
        kp: Servo stiffness (N m/rad), one or (nu,); the model's own by default.
        kd: Servo damping (N m s/rad), one or (nu,); the model's own by default.
        directions: How many, evenly spaced, the first one forward; 3 to 360.
        resolution: Of the impulses (N s).

    Raises:
        StanceUnreachableError: If the stance is out of reach.
        StaticsInfeasibleError: If it is reached, but slides or tips.
        ConfigurationError: If the task, or another argument, makes no sense for a robot.
        ModelError: If a robot has no position servos, and kp and kd are not both given.
    """
    stands = [solve_stand(robot, task) for robot in robots]
    found = {}
    for robot, stand in zip(robots, stands, strict=True):
        held = solve_stand_as_simulated(robot, stand)
        fed = verify_stand(robot, held, kp=kp, kd=kd, duration=LASTING)
        recovery = push_recovery(
            robot,
            held,
            kp=kp,
            kd=kd,
            directions=directions,
            resolution=resolution,
            verification=fed,
        )
        statics = stand_statics(robot, held)
        verdict = judge(robot, stand, fed, statics=statics, asked=Asked.LASTS, kp=kp, kd=kd)
        found[robot.name] = PushedStance(robot.name, held, recovery, verdict)
    return found
