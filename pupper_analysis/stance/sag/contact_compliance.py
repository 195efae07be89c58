"""How far pinned feet give, where equations that let none give would say the same several times."""

from __future__ import annotations

from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.problem import can_move_com
from pupper_analysis.stance.sag.units import Units

_PLIANT = 2.5e-6
"""How far contact points, pinned, give under a tangential force of the robot's weight (heights): a
biped of 10 kg by some micrometre."""


def contact_compliance(robot: Robot, units: Units) -> tuple[dict[str, float], dict[str, float]]:
    """Returns how far the points of soles give, and all contact points, {point: m/N}.

    A sole's move as one body: if none gave, the equations would say the same several times. A foot
    with one point gives nothing, but where legs cannot place feet in all directions: the two of a
    pair of legs that swing in planes keep their distance as the points of a sole do.

    Args:
        robot: The robot.
        units: Its weight, and its height.
    """
    give = _PLIANT * units.length / units.weight
    flat: dict[str, float] = {}
    for points in robot.feet.values():
        flat |= dict.fromkeys(points, give if len(points) > 1 else 0.0)
    return flat, flat if can_move_com(robot) else dict.fromkeys(robot.contact_points, give)
