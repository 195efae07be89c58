"""Diagnostics of stands that do not come to rest: growing modes, contact chatter, creeping feet.

Growing modes are found in the spectrum and in the response to a nudge. Chatter is found in the
states of a simulation, creep in the predicted contact forces. Most functions return diagnostics.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.robot.compliance import GroundLaw
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import Servos
from pupper_analysis.robot.stability import Mode, Stability
from pupper_analysis.simulation.monitor import ContactSampler
from pupper_analysis.simulation.stability import (
    MAX_JOINT_DISPLACEMENT,
    MAX_RESTING_SPEED,
    Nudge,
)
from pupper_analysis.stance.stand import Stand
from pupper_analysis.statics.equilibrium import GravityCompensation

_CHATTER_STATES = 50
"""Number of states at the end of a rollout of which ``find_chatter`` evaluates the contact forces.
Chosen, not tuned."""

_MAX_FORCE_VARIATION = 0.05
"""Bound [1] of the standard deviation of the total vertical ground force on the feet, divided by
the robot's weight. Above the bound, ``find_chatter`` reports contact chatter. The deviation is
taken over the last `_CHATTER_STATES` states of a rollout. Chosen, not tuned.
"""

MAX_CREEP_SPEED = 1e-3
"""Creep speed of a foot above which ``find_creep`` reports the foot [m/s]: 5 mm in 5 s.
`simulate_nudges` subtracts creep up to this speed from the slip of a foot. Chosen, not tuned."""


_SOLVER_NOISE_RATIO = 0.2
"""Largest remaining speed after a nudge, relative to the speed of the nudge, that is attributed to
the constraint solver. Measured: with the solvers CG and PGS and MuJoCo's default settings, robots
at rest move at 0.02 to 0.12 of the nudge without end."""


def find_instability(
    stability: Stability, nudge: Nudge | None, *, bounces: bool = False
) -> list[Diagnostic]:
    """Report the fastest growing mode (within ``HOLD_DURATION``), else a nudge without decay.

    A joint is reported as well if the nudge displaces it by ``MAX_JOINT_DISPLACEMENT`` or more, at
    the end or temporarily. A remaining speed of at most ``_SOLVER_NOISE_RATIO`` times the speed of
    the nudge is not reported. The result is empty if there is nothing to report.

    Args:
        stability: Stability at the settled state. Modes are reported only if the state is at rest.
        nudge: Response to the nudge; None if the stand was not nudged.
        bounces: Whether the remaining motion comes from a foot with almost no load that bounces,
            and does not grow. If True, the missing decay is not reported.
    """
    leaving = stability.modes_growing_within() if stability.at_rest else ()
    messages = [describe_growth(mode) for mode in leaving[:1]]
    is_noise = nudge is not None and nudge.left <= _SOLVER_NOISE_RATIO * nudge.speed
    if nudge is not None and not (nudge.decayed or is_noise or bounces or messages):
        after = Quantity(nudge.duration, "s")
        messages.append(
            diagnose("nudge-does-not-decay", speed=nudge.speed, after=after, left=nudge.left)
        )
    if nudge is not None and not nudge.moved < MAX_JOINT_DISPLACEMENT:
        after, moved = Quantity(nudge.duration, "s"), Quantity(nudge.moved, nudge.moved_unit)
        messages.append(diagnose("joint-left-by-nudge", after=after, moved=moved))
    elif nudge is not None and not nudge.stays:
        distance = Quantity(nudge.farthest, nudge.farthest_unit)
        messages.append(diagnose("joint-left-and-came-back", way=distance))
    return messages


def proves_unrest(nudge: Nudge) -> bool:
    """Return True if the response to a nudge alone shows that the stand is not stable.

    There are two such responses. A joint moved by `MAX_JOINT_DISPLACEMENT` or more; or the
    remaining motion does not decay, reaches `MAX_RESTING_SPEED`, and is faster than
    ``_SOLVER_NOISE_RATIO`` times the nudge. A slow motion proves nothing, since a foot with almost
    no load may bounce.
    """
    if not (nudge.moved < MAX_JOINT_DISPLACEMENT and nudge.stays):
        return True
    is_noise = nudge.left <= _SOLVER_NOISE_RATIO * nudge.speed
    is_slow = max(nudge.motion, nudge.left) < MAX_RESTING_SPEED
    return not (nudge.decayed or is_noise or is_slow)


def describe_refuted(stability: Stability) -> tuple[Diagnostic, ...]:
    """Create the message about a growing mode that a nudged simulation does not confirm.

    A mode is an eigenvector of MuJoCo's simulation step at rest. The message describes the first
    element of `Stability.refuted_modes`. The result is empty if there are no such modes.
    """
    if not stability.refuted_modes:
        return ()
    mode = stability.refuted_modes[0]
    return (
        diagnose(
            "mode-refuted",
            doubling_time=Quantity(mode.doubling_time or math.inf, "s"),
            frequency=Quantity(mode.frequency, "Hz") if mode.shakes else None,
            differs=not mode.repeated_at_second_step,
        ),
    )


def describe_growth(mode: Mode) -> Diagnostic:
    """Create the message about a growing mode.

    A mode is an eigenvector of MuJoCo's simulation step at rest. The message states, for example,
    the frequency [Hz] of an oscillating mode, the joints that move most, and the doubling time [s].
    """
    nudge = Quantity(mode.nudge, mode.nudge_unit) if mode.nudge else None
    is_length = mode.nudge_unit == "m"
    return diagnose(
        "mode-shakes" if mode.shakes else "mode-buckles",
        frequency=Quantity(mode.frequency, "Hz"),
        freed=mode.without_dry_friction,
        joints=mode.joints,
        doubling_time=None if mode.doubling_time is None else Quantity(mode.doubling_time, "s"),
        nudge=None if is_length else nudge,
        distance=nudge if is_length else None,
    )


def find_chatter(robot: Robot, drive: Servos, states: Array, ctrl: Array) -> list[Diagnostic]:
    """Report contact chatter: ground forces on a standing robot that vary from step to step.

    The result is empty if the standard deviation of the total vertical force on the feet, over the
    last ``_CHATTER_STATES`` states, is at most ``_MAX_FORCE_VARIATION`` times the weight, or is not
    a number.

    One possible cause is a pyramidal friction cone with an ``impratio`` above 1: MuJoCo's solver
    resolves its edges to a limited accuracy. Another is stiff ground: it amplifies the error of
    each step.

    Args:
        robot: The robot.
        drive: Servos and MuJoCo model that were simulated.
        states: States of a rollout up to the end, shape (n, size).
        ctrl: Actuator commands, shape (model.nu,).
    """
    sampler = ContactSampler(robot, drive.model)
    forces = []
    for state in states[-_CHATTER_STATES:]:
        sample = sampler.sample(state, ctrl)
        forces.append(sum(float(force[2]) for force in sample.forces.values()))
    variation = float(np.std(forces)) / robot.usual_weight
    if not variation > _MAX_FORCE_VARIATION:
        return []
    option = drive.model.opt
    pyramidal = option.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL.value
    impratio = option.impratio if pyramidal and option.impratio > 1 else None
    return [diagnose("contacts-rattle", share=variation, impratio=impratio)]


def compute_creep_speeds(
    robot: Robot, stand: Stand, prediction: GravityCompensation
) -> dict[str, float]:
    """Compute the creep speed of the loaded contact points: {point: |f_t| / c [m/s]}.

    f_t is the predicted tangential force [N], and c the viscosity [N s/m] of MuJoCo's friction
    (``GroundLaw``) at the depth of the point in the stand. The speed is infinite if the viscosity
    is zero. The points are those of ``prediction.contact_forces``.

    Args:
        robot: The robot.
        stand: The stand.
        prediction: Statics of the stand, with the contact forces.
    """
    speeds: dict[str, float] = {}
    for foot, force in prediction.contact_forces.items():
        normal = stand.normals[foot]
        tangential = float(np.linalg.norm(force - (force @ normal) * normal))
        viscosity = GroundLaw.of_contact(robot, foot).viscosity(stand.depths[foot])
        speeds[foot] = tangential / viscosity if viscosity > 0 else np.inf
    return speeds


def find_creep(robot: Robot, stand: Stand, prediction: GravityCompensation) -> list[Diagnostic]:
    """Report the contact point with the largest creep speed, if above ``MAX_CREEP_SPEED`` [m/s]."""
    speeds = compute_creep_speeds(robot, stand, prediction)
    foot = max(speeds, key=speeds.__getitem__, default="")
    if not speeds.get(foot, 0.0) > MAX_CREEP_SPEED:
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
