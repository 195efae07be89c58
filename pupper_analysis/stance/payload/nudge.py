"""What a nudge asks of motors that have little left, and whether the rest hold without them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from pupper_analysis.models.conversion import joint_damping
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.sag.homotopy_path import HomotopyPath
from pupper_analysis.stance.sag.stiffness import Compliance, compliance_at

Array = NDArray[np.float64]

NUDGE = 0.01
"""Speed with which the base begins, in each of the directions tried (m/s; at the height of the base
for a turn). An equilibrium that is not stable needs a reason to be left; one that is, even by a few
percent, survives this."""

_STEPS = 400
"""Instants at which a swing is looked at, over two periods of its slowest mode or so: of the fast
ones, of contacts, few are met at their peak, and these are the least."""

_DAMPED_PERIODS = 2.0 * 2.0 * np.pi  # two periods, by the angular frequency


def nudge_velocities(robot: Robot, height: float) -> Array:
    """Returns the velocities (8, nv) that nudge a base at a height (m): along and about z."""
    speeds = np.zeros((8, robot.nv))
    for axis, column in enumerate((0, 1, 2, 5)):
        size = NUDGE if column < 3 else NUDGE / height
        speeds[2 * axis : 2 * axis + 2, column] = size, -size
    return speeds


def find_saturating_motors(way: HomotopyPath, kd: Array) -> tuple[str, ...]:
    """Finds motors that a nudge saturates in an equilibrium that does not last without them.

    A saturated servo has no stiffness. Those whose torque swings beyond its limit, to first order,
    are taken out; what is left then swings further, and may saturate others; until no more do, or
    the equilibrium is not stable any more. A quadruped loses a knee's servo and stands; a biped
    stands by those of its ankles.

    Args:
        way: At its end, in a stable equilibrium.
        kd: (nu,) servo damping (N m s/rad).

    Returns:
        The joints of these motors; none if it lasts.
    """
    system, solution = way.system, way.solution
    robot = system.robot
    derivative, _ = way.look(solution)
    compliance = compliance_at(system, solution, derivative)
    passive = joint_damping(robot.mj_model)[robot.mj_convention.qvel_index[6:]]
    torques = system.torques(solution.qpos)
    room = np.minimum(system.upper - torques, torques - system.lower)
    speeds = nudge_velocities(robot, float(solution.qpos[2]))
    out = np.zeros(robot.nu, dtype=bool)
    while True:
        held, damped = np.where(out, 0.0, system.kp), np.where(out, 0.0, kd)
        without = np.concatenate([np.zeros(6), system.kp - held])
        if not compliance.stiffness(without) > 0:
            return tuple(robot.joint_names[joint] for joint in np.flatnonzero(out))
        more = ~out & (_swing(compliance, without, held, damped, passive, speeds) > room)
        if not more.any():
            return ()
        out |= more


def _swing(
    compliance: Compliance, without: Array, kp: Array, kd: Array, passive: Array, speeds: Array
) -> Array:
    """Returns the greatest change (nu,) of each servo's torque after any of some nudges (N m).

    Args:
        compliance: Of the equilibrium.
        without: (nv,) stiffness that is not there.
        kp: (nu,) of the servos.
        kd: (nu,) likewise.
        passive: (nu,) damping of the joints.
        speeds: (m, nv) of the nudges. What of them the feet do not let move is gone at once.
    """
    free = compliance.free
    joints = free[6:]
    stiff, mass = compliance.reduced(without)
    damped = joints.T @ ((kd + passive)[:, None] * joints)
    begin = np.linalg.solve(mass, free.T @ compliance.mass @ speeds.T)
    size = len(mass)
    rates = np.zeros((2 * size, 2 * size))
    rates[:size, size:] = np.eye(size)
    rates[size:] = -np.linalg.solve(mass, np.hstack([stiff, damped]))
    slowest = np.sqrt(max(compliance.stiffness(without), 0.0))
    step = linalg.expm(rates * (_DAMPED_PERIODS / slowest / _STEPS))
    state = np.vstack([np.zeros_like(begin), begin])
    given = np.hstack([kp[:, None] * joints, kd[:, None] * joints])
    most: Array = np.abs(given @ state).max(axis=1)
    for _ in range(_STEPS):
        state = step @ state
        most = np.maximum(most, np.abs(given @ state).max(axis=1))
    return most
