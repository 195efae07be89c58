"""Dry friction that lifts a base most, or least."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.stance.sag.solution import Solution

if TYPE_CHECKING:
    from pupper_analysis.stance.sag.equilibrium import SagEquilibrium


def apply_coulomb_friction(system: SagEquilibrium, solution: Solution, share: float) -> bool:
    """Moves friction, by a share, to what lifts the base most, or least; tells if it can."""
    derivative = system.derivative(solution.qpos, system.stacked(solution))
    height = np.zeros(len(derivative))
    height[2] = np.sign(system.lift)
    try:
        effect = np.array(np.linalg.solve(derivative.T, height), float)[: system.robot.nv]
    except np.linalg.LinAlgError:
        return False
    config = Configuration(system.robot, solution.qpos)
    size = abs(system.lift)
    joints = size * system.friction.torques(effect[6:])
    system.joint_friction = (1 - share) * system.joint_friction + share * joints
    for foot, force in solution.forces.items():
        turns = system.frame @ config.frame_jacobian(system.robot.contact_frames[foot])[3:]
        moment = size * system.friction.moment(foot, force, turns @ effect)
        before = system.moments.get(foot, np.zeros(3))
        system.moments[foot] = (1 - share) * before + share * moment
    return True
