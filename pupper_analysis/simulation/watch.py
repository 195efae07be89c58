"""A close look at a simulated stand: what touches the ground, and what its motors and feet hold."""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.results import Result
from pupper_analysis.robot.robot import Robot
from pupper_analysis.simulation import monitor
from pupper_analysis.stance.stand import Stand

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SimulationSettings(Result):
    """What a stand was simulated with.

    Attributes:
        feedforward: Whether ctrl = q* + tau / kp (otherwise ctrl = q*).
        integrator: MuJoCo's integrator.
        timestep: s.
        duration: s.
        kp: (nu,) N m/rad.
        kd: (nu,) N m s/rad.
    """

    feedforward: bool
    integrator: str
    timestep: float
    duration: float
    kp: Array
    kd: Array


_SAMPLE_TIME = 0.02  # s between the states that are looked at

TOUCH = 1e-3
"""Parts that push on each other by less of the weight only just touch."""

_WORLD = "world"  # MuJoCo's name of body 0, the ground's

LAST = 1.0
"""Time in which what a stand settles at is measured (s)."""


@dataclass(frozen=True, eq=False)
class Watch:
    """What a close look at some states of a rollout shows.

    Attributes:
        failures: What touches the ground, and should not; or should, and does not.
        touching: Pairs of its bodies that push on each other, settled.
        torques: (nu,) of motors, settled (N m).
        forces: Of each foot (3,) (N).
        feet_settled: Where each is (3,) (m).
    """

    failures: tuple[Diagnostic, ...]
    touching: tuple[tuple[str, str], ...]
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
    count, touching = 0, set[tuple[str, str]]()
    least = TOUCH * robot.total_mass * float(np.linalg.norm(robot.gravity))
    last_second = range(settling - round(LAST / model.opt.timestep), settling)
    # Backwards: the first moment stays. Both parts end with their last state.
    for index in (*range(len(states) - 1, settling - 1, -step), *range(settling - 1, -1, -step)):
        seen = watcher.look(states[index], ctrl)
        touched |= dict.fromkeys(seen.bodies, seen.time)
        touched |= {foot: seen.time for foot in seen.forces if foot not in carrying}
        lost |= {foot: seen.time for foot in seen.idle(carrying) if foot in loaded}
        if index in last_second:
            count += 1
            pushing = pushing_bodies(model, watcher.data, least)
            touching |= {pair for pair in pushing if _WORLD not in pair}
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
        touching=tuple(sorted(touching)),
        torques=torques / count,
        forces={foot: force / count for foot, force in total.items()},
        feet_settled={foot: position / count for foot, position in feet.items()},
    )


def pushing_bodies(
    model: mujoco.MjModel, data: mujoco.MjData, least: float
) -> set[tuple[str, str]]:
    """Returns the pairs of bodies that push on each other by so much (N), or on the world's."""
    pairs, force = set(), np.zeros(6)
    for number, bodies in enumerate(model.geom_bodyid[data.contact.geom].tolist()):
        mujoco.mj_contactForce(model, data, number, force)
        if force[0] > least:
            first, second = sorted(model.body(body).name for body in bodies)
            pairs.add((first, second))
    return pairs
