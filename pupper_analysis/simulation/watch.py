"""A close look at a simulated stand: what touches the ground, and what its motors and feet hold."""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.robot.robot import Robot
from pupper_analysis.simulation import monitor
from pupper_analysis.stance.stand import Stand

Array = NDArray[np.float64]

_SAMPLE_TIME = 0.02  # s between the states that are looked at

LAST = 1.0
"""Time in which what a stand settles at is measured (s)."""


@dataclass(frozen=True, eq=False)
class Watch:
    """What a close look at some states of a rollout shows."""

    failures: tuple[Diagnostic, ...]
    torques: Array
    forces: dict[str, Array]
    feet_settled: dict[str, Array]

    def drops(self, stand: Stand) -> dict[str, Array]:
        """Returns by what (3,) the stance feet ended below, or beside, where they should be (m)."""
        return {
            foot: stand.foot_targets[foot] - self.feet_settled[foot] for foot in stand.stance_feet
        }


def watch_contacts(
    robot: Robot,
    model: mujoco.MjModel,
    stand: Stand,
    states: Array,
    ctrl: Array,
    settling: int,
    loaded: Container[str],
) -> Watch:
    """Looks at contacts all along, and at torques and forces in the last second of settling.

    The feet in ``loaded`` must not let go; others are hardly predicted to touch.
    """
    watcher = monitor.Watcher(robot, model)
    step = max(1, round(_SAMPLE_TIME / model.opt.timestep))
    touched: dict[str, float] = {}
    lost: dict[str, float] = {}
    torques = np.zeros(robot.nu)
    total = {foot: np.zeros(3) for foot in robot.feet}
    carrying = robot.feet_with(stand.stance_feet)
    feet = {foot: np.zeros(3) for foot in robot.contact_points}
    count = 0
    last_second = range(settling - round(LAST / model.opt.timestep), settling)
    # Backwards: the first moment stays. Both parts end with their last state.
    for index in (*range(len(states) - 1, settling - 1, -step), *range(settling - 1, -1, -step)):
        seen = watcher.look(states[index], ctrl)
        touched |= dict.fromkeys(seen.bodies, seen.time)
        touched |= {foot: seen.time for foot in seen.forces if foot not in carrying}
        lost |= {foot: seen.time for foot in seen.idle(carrying) if foot in loaded}
        if index in last_second:
            count += 1
            torques += watcher.data.qfrc_actuator[robot.mj_convention.qvel_index[6:]]
            for foot in total:
                total[foot] += seen.forces.get(foot, np.zeros(3))
            for foot, centre in watcher.foot_centres().items():
                feet[foot] += centre
    failures = [
        diagnose("body-touches-ground", subject=("body", body), time=Quantity(moment, "s"))
        for body, moment in sorted(touched.items())
    ]
    failures += [
        diagnose("foot-idle", subject=("foot", foot), time=Quantity(moment, "s"))
        for foot, moment in sorted(lost.items())
    ]
    return Watch(
        failures=tuple(failures),
        torques=torques / count,
        forces={foot: force / count for foot, force in total.items()},
        feet_settled={foot: position / count for foot, position in feet.items()},
    )
