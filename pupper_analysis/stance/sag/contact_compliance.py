"""How far pinned feet give, where equations that let none give would say the same several times."""

from __future__ import annotations

from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.com_reach import can_move_com

_PLIANT = 2.5e-6
"""How far contact points, pinned, give under a tangential force of the robot's weight (heights): a
biped of 10 kg by some micrometre."""


def sole_compliance(robot: Robot, per_force: float) -> dict[str, float]:
    """Returns how far the contact points of soles give, {point: m/N}; 0 for a foot with one.

    They move as one body: if none gave, the equations would say the same several times.

    Args:
        robot: The robot.
        per_force: Its height per weight (m/N).
    """
    return {
        point: _PLIANT * per_force if len(points) > 1 else 0.0
        for points in robot.soles.values()
        for point in points
    }


def contact_compliance(robot: Robot, per_force: float) -> dict[str, float]:
    """Returns how far all contact points give, {point: m/N}.

    Feet of legs that cannot place them in all directions, the two of a pair of legs that swing in
    planes, keep their distance as the points of a sole do.

    Args: as ``sole_compliance``.
    """
    if can_move_com(robot):
        return sole_compliance(robot, per_force)
    return dict.fromkeys(robot.feet, _PLIANT * per_force)
