"""At which payload a stand buckles on servos of finite stiffness: a linear eigenvalue problem."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy import linalg

from pupper_analysis.robot.compliance import GroundLaw
from pupper_analysis.robot.configuration import UP, Configuration
from pupper_analysis.robot.tool import Tool
from pupper_analysis.stance.sag.contact_kinematics import ContactKinematics
from pupper_analysis.stance.sag.solution import Anchor
from pupper_analysis.stance.stand import Stand

Array = NDArray[np.float64]


def find_buckling_modes(
    config: Configuration,
    stand: Stand,
    kp: Array,
    lines: tuple[Array, Array],
    point: Tool,
    laws: Sequence[GroundLaw],
    deep: Array,
) -> Array | None:
    """Finds at which payloads a stand held with feed-forward for the load loses its stability.

    In the stand, gravity and the contact forces that last are linear in the payload's mass m, and
    so is the stiffness: K(m) = K_0 + m G, with K_0 that of servos, ground, and the robot's own
    weight, on all motions for which the material contact points do not slip. The stand buckles in
    a mode v where K(m) v = 0, that is, -G v = mu K_0 v with mu = 1 / m. The
    payload's weight is a force at its point that keeps its direction.

    On level ground this is exact for the configuration, but that the ground is as stiff as it is
    ``deep``; on a slope K is made symmetric.

    Args:
        config: Where the robot is: in the stand.
        stand: How it stands.
        kp: (nu,) servo stiffness at the joints (N m/rad).
        lines: (n, 3) contact forces without payload (N), and how they grow with it (N/kg).
        point: Where it is.
        laws: The ground's, of each foot that carries.
        deep: (n,) how deep these are in the ground (m).

    Returns:
        The mu of all modes, the greatest first (1/kg): none buckles below a mass of 1 / mu[0] if
        that is positive, and none at all if not. None if the stand is not stable without payload.
    """
    robot, feet = config.robot, stand.stance_feet
    frame = pin.Quaternion.FromTwoVectors(stand.task.ground.normal(), UP).matrix()
    centres = config.foot_places(feet)
    held = zip(feet, centres, config.foot_rotations(feet), strict=True)
    anchors = {foot: Anchor(place, turned) for foot, place, turned in held}
    depths = dict(zip(feet, deep.tolist(), strict=True))
    touch = ContactKinematics(config, anchors, centres, frame, depths)
    across = touch.jacobians[:, :2].reshape(-1, robot.nv)
    along = touch.jacobians[:, 2]
    rates = np.array([law.rate(depth) for law, depth in zip(laws, depths.values(), strict=True)])
    forces, more = (line @ frame.T for line in lines)
    bare = touch.balance_rates(forces, None)
    softer = bare - touch.balance_rates(forces + more, None)  # by a payload of 1 kg
    twists, weight = point.twist_jacobian(config)[None], np.zeros((1, 6))
    softer += config.pushed_rates(twists, weight)
    weight[0, :3] = robot.gravity
    softer -= config.pushed_rates(twists, weight)
    stiff = bare + along.T @ (rates[:, None] * along)
    stiff[6:, 6:] += np.diag(kp)
    free = linalg.null_space(across)
    one, other = (free.T @ matrix @ free for matrix in (stiff, softer))
    try:
        modes: Array = linalg.eigh((other + other.T) / 2, (one + one.T) / 2, eigvals_only=True)
    except np.linalg.LinAlgError:
        return None
    return modes[::-1]
