"""The path to a stance, and how MuJoCo follows it."""

from __future__ import annotations

from dataclasses import dataclass, replace

from numpy.typing import ArrayLike

from pupper_analysis.base.results import Result
from pupper_analysis.prepare.judge import judge
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.simulation.verdict import Asked, Outcome, Verdict
from pupper_analysis.stance.stand import Stand, solve_stand
from pupper_analysis.stance.task import StandTask
from pupper_analysis.tools.path.plan import StancePath, stance_path
from pupper_analysis.tools.path.tracking import PathTracking, track_path


@dataclass(frozen=True, eq=False)
class PathThere(Result):
    """The path from the nominal stand to a stance, and how MuJoCo follows it.

    Attributes:
        name: The robot's name.
        stand: Where it leads.
        path: The path.
        tracking: The simulation of it.
        verdict: Whether it is followed, and what that rests on.
    """

    name: str
    stand: Stand
    path: StancePath
    tracking: PathTracking
    verdict: Verdict

    @property
    def passed(self) -> bool:
        """Whether it is followed, by its verdict."""
        return self.verdict.passed


def study_path(
    robot: Robot,
    task: StandTask,
    seconds: float,
    *,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
) -> PathThere:
    """Moves from the nominal stand to a stance, and simulates that.

    Args:
        robot: The robot.
        task: The stance.
        seconds: How long it takes (s).
        kp: Servo stiffness (N m/rad), one or (nu,); the model's own by default.
        kd: Servo damping (N m s/rad), one or (nu,); the model's own by default.

    Raises:
        StanceUnreachableError: If a sample is out of reach; says where.
        StaticsInfeasibleError: If a sample cannot be held; says where.
        ConfigurationError: If the task, or another argument, makes no sense for the robot.
        ModelError: If the robot has no position servos, and kp and kd are not both given.
    """
    stand = solve_stand(robot, task)
    path = stance_path(robot, way_to(robot, stand), seconds)
    tracking = track_path(robot, path, kp=kp, kd=kd)
    ran = Outcome(
        tracking.passed,
        tracking.failures,
        float(path.time[-1]),
        torque_error=tracking.torque_error,
    )
    return PathThere(
        name=robot.name,
        stand=stand,
        path=path,
        tracking=tracking,
        verdict=judge(robot, stand, ran, asked=Asked.TRACKED, kp=kp, kd=kd),
    )


def way_to(robot: Robot, stand: Stand) -> list[StandTask]:
    """Returns the stances that lead to a stand: the nominal one, with its feet where they are.

    Where a foot is lifted, the weight is first shifted on to the others.
    """
    task = stand.task
    x, y, _ = Configuration(robot, stand.qpos).center_of_mass()
    over = replace(task, com=(float(x), float(y)), com_margin=0.0, offset=None)
    nominal = StandTask(
        feet=task.feet, foot_offsets=task.foot_offsets, ground=task.ground, ik_seed=task.ik_seed
    )
    return [nominal, *([replace(over, swing={})] if task.swing else []), over]
