"""Tests of the cause of a fall: the run is repeated with a single changed quantity.

`find_fall_tests` repeats the first run of a walk that falls. If the robot does not fall with a
change, the changed quantity is a possible cause. If the robot falls with each change, the policy
may read or drive the joints wrongly.
"""

from __future__ import annotations

import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.walk.gait import DEFAULT_SECONDS, FallTest, Walk
from pupper_analysis.tools.walk.intervals import make_changed_case
from pupper_analysis.tools.walk.policy import Policy
from pupper_analysis.tools.walk.runs import Case, Stage, prepare_stage, simulate_cases

_FACTORS = (
    ("strength", 10.0),
    ("friction", 2.0),
    *(("kp", 0.5), ("kp", 2.0), ("kd", 0.5), ("kd", 2.0)),
)
"""(quantity of `VARIED_QUANTITIES`, factor) of the tested changes. Chosen, not tuned."""


def find_fall_tests(
    robot: Robot, policy: Policy, walk: Walk, seconds: float = DEFAULT_SECONDS
) -> tuple[FallTest, ...]:
    """Find possible causes of a fall: repeat the run with a single changed quantity.

    ``seconds`` is the duration of each run without a fall [s].

    Returns:
        A test per change, of the first run of the walk that falls. Empty if no run falls. A zero
        command, a zero delay and infinite torque limits are not changed.
    """
    fallen = next((gait for gait in walk.gaits if gait.fall is not None), None)
    if fallen is None:
        return ()
    stage = prepare_stage(robot, policy)
    changes = _list_effective_changes(stage, fallen.command, fallen.seed)
    runs = simulate_cases(stage, list(changes.values()), seconds, walk.warm_up)
    return tuple(
        FallTest(quantity, value, run.fallen, len(run.states) * stage.timestep)
        for (quantity, value), run in zip(changes, runs, strict=True)
    )


def _list_effective_changes(
    stage: Stage, command: Array, seed: int
) -> dict[tuple[str, float], Case]:
    """Create the runs with a single change: {(quantity, value): run}."""
    changes: dict[tuple[str, float], Case] = {}
    latency = stage.policy.contract.latency
    if np.any(command):
        changes["command", 0.0] = Case(stage.model, np.zeros(3), latency, seed)
    if latency:
        changes["delay", 0.0] = Case(stage.model, command, 0.0, seed)
    limited = bool(np.isfinite(stage.robot.effort_limits).any())
    for quantity, factor in _FACTORS:
        if quantity != "strength" or limited:
            case = make_changed_case(stage, quantity, factor, command, seed)
            changes[quantity, factor] = case
    return changes
