"""Diagnostics of stands that do not come to rest: growing modes, contact chatter, creeping feet.

A mode is an eigenvector of MuJoCo's simulation step, linearised at rest. A growing mode is found in
the spectrum of the step, and in the response to a nudge (a small velocity). Chatter is found in the
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
"""Number of states (time steps) at the end of a rollout whose contact forces `find_chatter`
evaluates. Chosen, not tuned."""

_MAX_FORCE_VARIATION = 0.05
"""Upper bound [1] of the standard deviation of the total vertical ground force on the feet, divided
by the robot's weight. Beyond the bound, contacts chatter. Chosen, not tuned.
"""

MAX_CREEP_SPEED = 1e-3
"""Largest creep speed of a foot [m/s] that is not reported with the failures of a stand, 5 mm in 5
s. In nudged simulations (``trial``), only creep up to this speed is no slip. Creep is the slow slip
of a loaded contact. Chosen, not tuned.
"""


_SOLVER_NOISE_RATIO = 0.2
"""Upper bound [1] of the ratio (remaining speed after a nudge) / (speed of the nudge) of motion
that counts as an error of the constraint solver. Chosen above the motion of some robots at rest
with the solvers CG and PGS, 0.02 to 0.12 of the nudge.
"""


def lacks_decay(nudge: Nudge) -> bool:
    """Return True if motion after a nudge does not decay, and is faster than solver errors."""
    return not (nudge.decayed or nudge.left <= _SOLVER_NOISE_RATIO * nudge.speed)


def find_instability(
    stability: Stability, nudge: Nudge | None, *, is_harmless: bool = False
) -> list[Diagnostic]:
    """Create the messages that state why a stand is not stable: growing mode, or effect of a nudge.

    A mode is an eigenvector of MuJoCo's linearised simulation step. A nudge is a small velocity of
    all coordinates. A growing mode explains that the motion after the nudge does not decay, which
    is then not reported.

    Args:
        stability: Modes at the settled state of the simulation.
        nudge: Response to the nudge; None if the stand was not nudged.
        is_harmless: Whether the remaining motion is small and has a known harmless cause: a foot
            with almost no load that bounces, or an error of MuJoCo's constraint solver
            (`is_solver_error`). If True, missing decay is not reported.
    """
    leaving = stability.modes_growing_within() if stability.at_rest else ()
    messages = [describe_growth(mode) for mode in leaving[:1]]
    if nudge is not None and lacks_decay(nudge) and not (is_harmless or messages):
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
    """Return True if the response to a nudge (a small velocity) alone proves a stand unstable.

    Proofs are a displaced joint (`MAX_JOINT_DISPLACEMENT`), and motion that does not decay. Slow
    motion without decay is no proof, since a foot with almost no load may bounce.
    """
    if not (nudge.moved < MAX_JOINT_DISPLACEMENT and nudge.stays):
        return True
    return lacks_decay(nudge) and not max(nudge.motion, nudge.left) < MAX_RESTING_SPEED


def describe_refuted(stability: Stability) -> tuple[Diagnostic, ...]:
    """Create the message that a simulation does not confirm a mode which grows in the linear model.

    A mode is an eigenvector of MuJoCo's simulation step, linearised at rest. The message describes
    the first element of `Stability.refuted_modes`.

    Returns:
        The message as a tuple; empty without refuted modes.
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
    """Create the message about a growing mode: doubling time [s], joints that move most.

    A mode is an eigenvector of MuJoCo's simulation step, linearised at rest.
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

    Chatter is reported if the standard deviation of the total vertical force on the feet exceeds 5
    % of the weight (`_MAX_FORCE_VARIATION`) over the last states (`_CHATTER_STATES`).

    Args:
        robot: Robot.
        drive: Servos and MuJoCo model that were simulated.
        states: States of a rollout up to the end (mjSTATE_FULLPHYSICS), shape (n, size).
        ctrl: Actuator commands, shape (model.nu,).

    Returns:
        List with a message; empty without chatter, or if the deviation is not a number.
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
    """Compute the creep speed of the contact points in a stand: |f_t| / c [m/s].

    Creep is the slow slip that MuJoCo's regularised friction permits. f_t is the tangential force
    [N] in ``prediction``. c is the viscosity [N s/m] of the friction (`GroundLaw`) at the depth of
    the point in the stand.

    Returns:
        {contact point: creep speed [m/s]}; infinite if the viscosity is zero.
    """
    speeds: dict[str, float] = {}
    for foot, force in prediction.contact_forces.items():
        normal = stand.normals[foot]
        tangential = float(np.linalg.norm(force - (force @ normal) * normal))
        viscosity = GroundLaw.of_contact(robot, foot).viscosity(stand.depths[foot])
        speeds[foot] = tangential / viscosity if viscosity > 0 else np.inf
    return speeds


def find_creep(robot: Robot, stand: Stand, prediction: GravityCompensation) -> list[Diagnostic]:
    """Report the contact point with the largest creep speed, if above `MAX_CREEP_SPEED`.

    Creep is the slow slip of a loaded contact (`compute_creep_speeds`). A contact point without
    friction slides freely, and does not count. The list contains at most one message.
    """
    speeds = {
        foot: speed
        for foot, speed in compute_creep_speeds(robot, stand, prediction).items()
        if robot.contacts[foot].sliding_friction > 0
    }
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
