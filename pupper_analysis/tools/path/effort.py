"""What a sample of a path takes at a speed: torques, contact forces, the zero-moment point."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.errors import StaticsInfeasibleError
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.statics.cone_program import BALANCE_TOLERANCE
from pupper_analysis.statics.support_polygon import com_margin
from pupper_analysis.tools.path.dynamics import InverseDynamics, inverse_dynamics
from pupper_analysis.tools.path.geometry import PathPlace, minimum_jerk

Array = NDArray[np.float64]


FAINT = 1e-3
"""Share of the load that is too small to pass on: where it begins, the zero-moment point is so near
the edge that moments of resistance decide whether fewer feet can carry."""


@dataclass(frozen=True, eq=False)
class Effort:
    """What a sample of a path takes.

    Attributes:
        qvel: (nv,) generalised velocity.
        qacc: (nv,) generalised acceleration.
        torques: (nu,) of the motors (N m).
        forces: {foot that carries: (3,) of the ground, in world axes (N)}.
        moments: {foot that carries: (3,) with which the ground resists its turning (N m)}.
        friction: {foot that carries: tangential force / (friction coefficient x normal force)}.
        zero_moment_point: (3,) on the ground (m).
        zmp_margin: Of its projection from the edge of the support polygon (m).
        com_margin: Of the com's (m).
        infeasible: Why no contact forces do, or None.
    """

    qvel: Array
    qacc: Array
    torques: Array
    forces: dict[str, Array]
    moments: dict[str, Array]
    friction: dict[str, float]
    zero_moment_point: Array
    zmp_margin: float
    com_margin: float
    infeasible: StaticsInfeasibleError | None


def path_effort(
    robot: Robot,
    place: PathPlace,
    rate: float,
    acceleration: float,
    *,
    beyond: bool = False,
) -> Effort:
    """Returns what a sample of a path takes, with minimum tangential forces.

    Towards a segment of the path on which fewer feet carry, the load passes to those: a mean of two
    sets of forces that balance the robot does so too.

    Args:
        robot: The robot.
        place: The sample.
        rate: Of the segment's share (1/s).
        acceleration: Of it (1/s^2).
        beyond: Where no contact forces do, return those of feet that are held to the ground.

    Raises:
        StaticsInfeasibleError: If no contact forces do, unless ``beyond``.
    """
    qvel, qacc = place.motion(rate, acceleration)
    config, stand = Configuration(robot, place.qpos, qvel), place.stand

    def balance(feet: Sequence[str], *, held: bool = False) -> InverseDynamics:
        return inverse_dynamics(config, qacc, feet, normals=stand.normals, held=held)

    infeasible = None
    try:
        whole = balance(stand.stance_feet)
    except StaticsInfeasibleError as error:
        if not beyond:
            raise
        infeasible, whole = error, balance(stand.stance_feet, held=True)
    parts = [(1.0, whole)]
    for feet, near, full in _fading(place) if infeasible is None else ():
        # Fewer feet can carry only where the zero-moment point is between them; so their share
        # grows with its distance from the edge, and with the way.
        inside = max(0.0, balance(feet, held=True).zmp_margin or 0.0)
        share = near * minimum_jerk(min(1.0, inside / full))[0] if full > 0 else 0.0
        if share > FAINT:
            parts.append((share, balance(feet)))
    parts[0] = (1.0 - sum(share for share, _ in parts[1:]), whole)

    def mean(tables: Sequence[Mapping[str, Array]]) -> dict[str, Array]:
        weighted = list(zip([share for share, _ in parts], tables, strict=True))
        none = np.zeros(3)
        return {
            foot: np.sum([share * table.get(foot, none) for share, table in weighted], axis=0)
            for foot in stand.stance_feet
        }

    forces = mean([part.contact_forces for _, part in parts])
    points = whole.contact_points
    return Effort(
        qvel=qvel,
        qacc=qacc,
        torques=np.sum([share * part.joint_torques for share, part in parts], axis=0),
        forces=forces,
        moments=mean([part.contact_moments for _, part in parts]),
        friction=_friction(robot, forces, stand.normals),
        zero_moment_point=whole.zero_moment_point,
        zmp_margin=com_margin(whole.zero_moment_point, points),
        com_margin=com_margin(config.center_of_mass(), points),
        infeasible=infeasible,
    )


def _fading(place: PathPlace) -> list[tuple[tuple[str, ...], float, float]]:
    """Returns feet that are left carrying beside the segment, how near that is, and its margin.

    Near is from 0 to 1; the margin is that of the com in the stance between the segments (m).
    """
    segment, stance_feet = place.segment, place.stand.stance_feet
    return [
        (feet, near, key.margin(feet))
        for feet, key, near in (
            (segment.before, segment.start, 1 - place.share),
            (segment.after, segment.end, place.share),
        )
        if set(feet) < set(stance_feet)
    ]


def _friction(
    robot: Robot, forces: Mapping[str, Array], normals: Mapping[str, Array]
) -> dict[str, float]:
    """Returns how much of its friction each foot uses; none where it carries none of the load."""
    found = {}
    nothing = BALANCE_TOLERANCE * sum(float(np.linalg.norm(force)) for force in forces.values())
    for foot, force in forces.items():
        normal = float(force @ normals[foot])
        tangential = float(np.linalg.norm(force - normal * normals[foot]))
        limit = robot.contacts[foot].sliding_friction * abs(normal)
        if tangential <= nothing:
            found[foot] = 0.0
        else:
            found[foot] = tangential / limit if limit else math.inf
    return found
