"""At which payload a stand buckles on servos of finite stiffness: a linear eigenvalue problem."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy import linalg

from pupper_analysis.robot.compliance import GroundLaw
from pupper_analysis.robot.configuration import UP, Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.sag.contact_kinematics import ContactKinematics
from pupper_analysis.stance.sag.solution import Anchor
from pupper_analysis.stance.stand import Stand
from pupper_analysis.statics.equilibrium import GravityCompensation

Array = NDArray[np.float64]


def find_buckling_modes(
    robot: Robot,
    loaded: Robot,
    stand: Stand,
    kp: Array,
    empty: GravityCompensation,
    laden: GravityCompensation,
) -> Array | None:
    """Finds at which payloads a stand held with feed-forward for the load loses its stability.

    In the stand, gravity and the contact forces that last are linear in the payload's mass m, and
    so is the stiffness: K(m) = K_0 + m G, with K_0 that of servos, ground, and the robot's own
    weight, on all motions for which the material contact points do not slip. The stand buckles in
    a mode v where K(m) v = 0, that is, -G v = mu K_0 v with mu = 1 / m.

    The ground's stiffness is that under ``laden``: it is greater under more, which matters little.
    On level ground all else is exact for the configuration; on a slope K is made symmetric.

    Args:
        robot: The robot.
        loaded: The same with some payload.
        stand: How it stands.
        kp: (nu,) servo stiffness at the joints (N m/rad).
        empty: What holds ``robot`` in the stand.
        laden: What holds ``loaded`` there.

    Returns:
        The mu of all modes, the greatest first (1/kg): none buckles below a mass of 1 / mu[0] if
        that is positive, and none at all if not. None if the stand is not stable without payload.
    """
    feet, normal = stand.stance_feet, stand.task.ground.normal()
    laws = [GroundLaw.of(loaded, foot) for foot in feet]
    pressed = [max(float(laden.contact_forces[foot] @ normal), 0.0) for foot in feet]
    deep = [law.depth(force) for law, force in zip(laws, pressed, strict=True)]
    frame = pin.Quaternion.FromTwoVectors(normal, UP).matrix()

    def touching(one: Robot) -> ContactKinematics:
        config = Configuration(one, stand.qpos)
        centres = config.foot_places(feet)
        held = zip(feet, centres, config.foot_rotations(feet), strict=True)
        anchors = {foot: Anchor(place, turned) for foot, place, turned in held}
        return ContactKinematics(
            config, anchors, centres, frame, dict(zip(feet, deep, strict=True))
        )

    def stiffness(touch: ContactKinematics, balance: GravityCompensation) -> Array:
        forces = np.array([balance.contact_forces[foot] for foot in feet]) @ frame.T
        return touch.balance_rates(forces, None) + stiff

    bare, carrying = touching(robot), touching(loaded)
    jacobians = carrying.jacobians
    across, along = jacobians[:, :2].reshape(-1, robot.nv), jacobians[:, 2]
    rates = np.array([law.rate(depth) for law, depth in zip(laws, deep, strict=True)])
    stiff = along.T @ (rates[:, None] * along)
    stiff[6:, 6:] += np.diag(kp)
    free = linalg.null_space(across)
    one, two = (
        free.T @ stiffness(touch, balance) @ free
        for touch, balance in ((bare, empty), (carrying, laden))
    )
    softer = (one - two) / (loaded.total_mass - robot.total_mass)
    try:
        modes: Array = linalg.eigh((softer + softer.T) / 2, (one + one.T) / 2, eigvals_only=True)
    except np.linalg.LinAlgError:
        return None
    return modes[::-1]
