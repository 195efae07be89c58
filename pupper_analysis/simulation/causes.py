"""Why a simulation does not come to rest: what grows, contacts that chatter, feet that creep."""

from __future__ import annotations

import math

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.robot.compliance import GroundLaw
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import Servos
from pupper_analysis.robot.stability import Mode, Stability
from pupper_analysis.simulation.monitor import Watcher
from pupper_analysis.simulation.stability import LEFT, Nudge
from pupper_analysis.stance.stand import Stand
from pupper_analysis.statics.equilibrium import GravityCompensation

Array = NDArray[np.float64]

_JOLTS = 50
"""States at the end of a rollout at whose contact forces are looked, one by one."""

_EVEN = 0.05
"""The ground's force on a robot that stands varies by less of its weight from step to step."""

CREEPING = 1e-3
"""Feet that creep faster are said to (m/s): 5 mm in the 5 s of a simulation."""


_NOISE = 0.2
"""Part of the nudge up to which what goes on is the solver's error, where no mode grows: with CG
and PGS, as MuJoCo sets them, a robot at rest moves by 0.02 to 0.12 of it for ever, and stays."""


def find_instability(stability: Stability, nudge: Nudge | None) -> list[Diagnostic]:
    """Says so if a stand would not last, or a nudge did not decay.

    Args:
        stability: Of where it settled; what still moves there is not judged by it.
        nudge: What became of the nudge, if it was given.
    """
    leaving = stability.modes_growing_within() if stability.at_rest else ()
    messages = [describe_growth(mode) for mode in leaving[:1]]
    quiet = nudge is not None and nudge.left <= _NOISE * nudge.speed
    if nudge is not None and not nudge.decayed and not quiet and not messages:
        after = Quantity(nudge.duration, "s")
        messages.append(
            diagnose("nudge-does-not-decay", speed=nudge.speed, after=after, left=nudge.left)
        )
    if nudge is not None and not nudge.moved < LEFT:
        after, moved = Quantity(nudge.duration, "s"), Quantity(nudge.moved, "rad")
        messages.append(diagnose("joint-left-by-nudge", after=after, moved=moved))
    elif nudge is not None and not nudge.stays:
        way = Quantity(nudge.farthest, "rad")
        messages.append(diagnose("joint-left-and-came-back", way=way))
    return messages


def describe_refuted(stability: Stability) -> tuple[Diagnostic, ...]:
    """Describe the fastest mode of the spectrum that the nudged simulation refutes."""
    if not stability.refuted:
        return ()
    mode = stability.refuted[0]
    return (
        diagnose(
            "mode-refuted",
            doubling_time=Quantity(mode.doubling_time or math.inf, "s"),
            frequency=Quantity(mode.frequency, "Hz") if mode.shakes else None,
            differs=not mode.repeated,
        ),
    )


def describe_growth(mode: Mode) -> Diagnostic:
    """Describe the growth of a mode, and the nudge with which it was simulated."""
    return diagnose(
        "mode-shakes" if mode.shakes else "mode-buckles",
        frequency=Quantity(mode.frequency, "Hz"),
        freed=mode.freed,
        joints=mode.joints,
        doubling_time=None if mode.doubling_time is None else Quantity(mode.doubling_time, "s"),
        nudge=None if mode.nudge is None else Quantity(mode.nudge, "rad"),
    )


def find_chatter(robot: Robot, drive: Servos, states: Array, ctrl: Array) -> list[Diagnostic]:
    """Says so if the ground pushes by jolts, from step to step, where it should push evenly.

    MuJoCo's solver meets the edges of pyramidal cones with an ``impratio`` above 1 only so far, and
    hard ground answers each step's error.

    Args:
        robot: The robot.
        drive: Its servos, and what was simulated.
        states: (n, ...) of a rollout, to its end.
        ctrl: What was commanded.
    """
    watcher = Watcher(robot, drive.model)
    pushed = []
    for state in states[-_JOLTS:]:
        seen = watcher.look(state, ctrl)
        pushed.append(sum(float(force[2]) for force in seen.forces.values()))
    share = float(np.std(pushed)) / robot.usual_weight
    if not share > _EVEN:
        return []
    option = drive.model.opt
    pyramidal = option.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL.value
    impratio = option.impratio if pyramidal and option.impratio > 1 else None
    return [diagnose("contacts-rattle", share=share, impratio=impratio)]


def creep_speeds(robot: Robot, stand: Stand, prediction: GravityCompensation) -> dict[str, float]:
    """Returns how fast feet creep, as MuJoCo's friction, which is viscous, lets them (m/s).

    Args:
        robot: The robot.
        stand: The stand.
        prediction: Its contact forces.
    """
    speeds: dict[str, float] = {}
    for foot, force in prediction.contact_forces.items():
        normal = stand.normals[foot]
        tangential = float(np.linalg.norm(force - (force @ normal) * normal))
        viscosity = GroundLaw.of(robot, foot).viscosity(stand.depths[foot])
        speeds[foot] = tangential / viscosity if viscosity > 0 else np.inf
    return speeds


def find_creep(robot: Robot, stand: Stand, prediction: GravityCompensation) -> list[Diagnostic]:
    """Says so if feet creep; see ``creep_speeds``."""
    speeds = creep_speeds(robot, stand, prediction)
    foot = max(speeds, key=speeds.__getitem__, default="")
    if not speeds.get(foot, 0.0) > CREEPING:
        return []
    option = robot.mj_model.opt
    elliptic = option.cone == mujoco.mjtCone.mjCONE_ELLIPTIC.value
    message = diagnose(
        "foot-creeps",
        subject=("foot", foot),
        speed=Quantity(speeds[foot], "m/s"),
        used=Quantity(max(prediction.friction_utilisation.values()), "1"),
        cone="elliptic" if elliptic else "pyramidal",
        impratio=float(option.impratio),
    )
    return [message]
