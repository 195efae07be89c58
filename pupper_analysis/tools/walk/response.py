"""Response of a walking policy: mean velocity for a grid of commands, and dead zones.

Inputs are a robot, a policy and the largest commands; output is a `ResponseMap`. The map has a
`ResponseAxis` each for forward speed, speed to the left and turning rate, unless the largest
command of the axis is 0. Along an axis the other two commands are zero.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.results import Result
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.walk.gait import (
    check_command,
    check_runs,
    evaluate_tracking,
    has_unknown_masses,
    list_walk_remarks,
)
from pupper_analysis.tools.walk.intervals import DEFAULT_SECONDS, WARM_UP_SECONDS
from pupper_analysis.tools.walk.policy import Policy
from pupper_analysis.tools.walk.runs import prepare_stage, simulate_cases

DEFAULT_LIMITS = (1.0, 0.5, 1.0)
"""Largest commands of a map: forward [m/s], to the left [m/s], turning [rad/s]. Chosen: ranges of
public deployments are 0.3 to 1 m/s and 0.2 to 1 rad/s."""

NUM_STEPS = 5
"""Number of commands on each side of zero. Chosen, not tuned: a dead zone is resolved to a fifth of
the largest command."""

MIN_RESPONSE = 0.25
"""Lower bound of the ratio of achieved to commanded velocity. Below the bound, the policy ignores
the command (dead zone). Chosen, not tuned: half of `MIN_FOLLOWED_FRACTION`.
"""

AXIS_NAMES = ("forward", "left", "turning")
"""Names of the commands: forward speed, speed to the left, turning rate to the left."""


@dataclass(frozen=True, eq=False)
class ResponseAxis(Result):
    """Achieved velocities of a walking policy for commands along an axis.

    Attributes:
        axis: ``forward``, ``left`` or ``turning``.
        commanded: Commands, ascending, shape (n,).
        achieved: Mean velocity of the same axis over the seeds, shape (n,); NaN if a run falls.
        spread: Largest minus smallest velocity over the seeds, shape (n,); NaN if a run falls.
        fallen: Number of runs that fall at each command, shape (n,).
    """

    axis: str
    commanded: Array = field(metadata={"unit": "m/s or rad/s"})
    achieved: Array = field(metadata={"unit": "m/s or rad/s"})
    spread: Array = field(metadata={"unit": "m/s or rad/s"})
    fallen: NDArray[np.int64]
    _reported: ClassVar[tuple[str, ...]] = ("dead_zone",)

    @property
    def dead_zone(self) -> tuple[float, float]:
        """Range of commands around zero that the policy ignores: (lower, upper) end.

        A command is ignored if the ratio of achieved to commanded velocity is below `MIN_RESPONSE`,
        without a fall.
        """
        ends = []
        for side in (-1.0, 1.0):
            end = 0.0
            order = np.argsort(np.abs(self.commanded), kind="stable")
            for index in order[side * self.commanded[order] > 0]:
                ratio = self.achieved[index] / self.commanded[index]
                if not ratio < MIN_RESPONSE:
                    break
                end = float(self.commanded[index])
            ends.append(end)
        return ends[0], ends[1]


@dataclass(frozen=True, eq=False)
class ResponseMap(Result):
    """Achieved velocities of a policy on a robot for a grid of commands.

    Attributes:
        name: Name of the robot.
        policy: File name of the policy.
        axes: Forward speed, speed to the left, turning rate; without axes whose limit is 0.
        seeds: Number of initial states per command.
        seconds: Duration of each run.
        remarks: Errors and assumptions of the robot's files and the deployment behind the result.
    """

    _key_fields: ClassVar[tuple[str, ...]] = ("passed", "name")

    name: str
    policy: str
    axes: tuple[ResponseAxis, ...]
    seeds: int
    seconds: float = field(metadata={"unit": "s"})
    remarks: tuple[Diagnostic, ...]
    _reported: ClassVar[tuple[str, ...]] = ("passed",)

    @property
    def passed(self) -> bool:
        """Whether no run falls, no axis has a dead zone, and no link mass is unknown."""
        sound = all(not axis.fallen.any() and not any(axis.dead_zone) for axis in self.axes)
        return sound and not has_unknown_masses(self.remarks)


@check_arguments
def map_response(
    robot: Robot,
    policy: Policy,
    limits: ArrayLike = DEFAULT_LIMITS,
    *,
    seeds: int = 1,
    seconds: float = DEFAULT_SECONDS,
    workers: int | None = None,
) -> ResponseMap:
    """Measure the velocities that a policy achieves, for commands along each axis.

    Args:
        robot: Robot.
        policy: Policy.
        limits: Largest forward speed, speed to the left [m/s], and turning rate [rad/s]; an axis
            with the limit 0 is left out.
        seeds: Number of initial states per command, as in `simulate_walk`.
        seconds: Duration of each run [s], 3 to 600.
        workers: Number of threads; by default the number of cores.

    Raises:
        ConfigurationError: If an argument is out of range, the base is fixed, or the robot has no
            feet, for example.
        ModelError: If the policy does not fit the robot.
    """
    checked = np.abs(check_command(limits))
    if not checked.any():  # a map without axes would pass
        problem = diagnose("not-between", given=0, low="0 (exclusive)", high=100)
        raise ConfigurationError("command", problem)
    check_runs(seeds, seconds, WARM_UP_SECONDS)
    stage = prepare_stage(robot, policy)
    fractions = np.arange(-NUM_STEPS, NUM_STEPS + 1) / NUM_STEPS
    grid = [(index, fractions * limit) for index, limit in enumerate(checked) if limit]
    cases = [
        stage.make_case(value * np.eye(3)[index], seed)
        for index, values in grid
        for value in values
        for seed in range(seeds)
    ]
    runs = simulate_cases(stage, cases, seconds, WARM_UP_SECONDS, workers)
    outcomes = [evaluate_tracking(stage, run, WARM_UP_SECONDS) for run in runs]
    axes = []
    for place, (index, values) in enumerate(grid):
        count = len(values) * seeds
        own = outcomes[place * count : (place + 1) * count]
        fallen = np.array([outcome.failure == "falls" for outcome in own]).reshape(-1, seeds)
        speeds = np.array([[*outcome.velocity, outcome.turning][index] for outcome in own])
        speeds = np.where(fallen, np.nan, speeds.reshape(-1, seeds))
        axes.append(
            ResponseAxis(
                AXIS_NAMES[index],
                commanded=values,
                achieved=speeds.mean(axis=1),
                spread=np.ptp(speeds, axis=1),
                fallen=fallen.sum(axis=1),
            )
        )
    return ResponseMap(
        name=robot.name,
        policy=policy.name,
        axes=tuple(axes),
        seeds=seeds,
        seconds=float(seconds),
        remarks=(*list_walk_remarks(stage.robot), *policy.notes),
    )
