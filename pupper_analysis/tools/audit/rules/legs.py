"""Rules about legs: what all of them share, no mirror shows."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.models.loading import Found
from pupper_analysis.models.stated.model import (
    HINGE,
    Array,
    Joint,
    Link,
    RobotModel,
)
from pupper_analysis.tools.audit.registry import rule

PARALLEL, LEVEL = 0.99, 0.3
"""Cosine of axes that count as parallel; and the most that an axis of pitch points up."""

REACHED = 0.75
"""Share of a knee's range in which the foot comes below the hip: of less, limits are looked at."""

SAMPLES = 61
"""Angles of a knee over its range."""


@dataclass(frozen=True, eq=False)
class Leg:
    """A hip and a knee whose axes are parallel, at zero angles in the base frame.

    Attributes:
        hip: The joint.
        knee: The next one.
        thigh: (3,) from the hip to the knee, across the axis (m).
        shank: (3,) from the knee to the next joint, or the foot, across the axis (m).
        axis: (3,) the hip's.
        same: 1 if the knee turns the same way round for the same sign, else -1.
    """

    hip: Joint
    knee: Joint
    thigh: Array
    shank: Array
    axis: Array
    same: float

    def reached(self, hip: tuple[float, float], knee: tuple[float, float]) -> float:
        """Returns the share of a knee's range in which the foot can be straight below the hip."""
        down = np.array([0.0, 0.0, -1.0]) - self.axis * -self.axis[2]
        side = np.cross(self.axis, down)
        angles, inside, counted = np.linspace(*knee, SAMPLES), 0, 0
        for angle in self.same * angles:
            turned = _turn(self.shank, self.axis, angle) + self.thigh
            length = float(np.linalg.norm(self.thigh) + np.linalg.norm(self.shank))
            if np.linalg.norm(turned) < 0.2 * length:
                continue  # folded: the foot is at the hip, wherever that turns
            needed = -math.atan2(float(turned @ side), float(turned @ down))
            first = needed + 2 * math.pi * math.ceil((hip[0] - needed) / (2 * math.pi) - 1e-9)
            counted += 1
            inside += first <= hip[1] + 1e-9
        return inside / counted if counted else 1.0


def _turn(vector: Array, axis: Array, angle: float) -> Array:
    """Returns a vector (3,) across an axis turned about it."""
    turned: Array = math.cos(angle) * vector + math.sin(angle) * np.cross(axis, vector)
    return turned


def _across(vector: Array, axis: Array) -> Array:
    across: Array = vector - (vector @ axis) * axis
    return across


def legs_of(robot: RobotModel) -> Iterator[Leg]:
    """Yields the limbs that hang down: a hip and a knee that bend in one plane."""
    for link in robot.links.values():
        if not link.moving or link.joints[-1].kind != HINGE:
            continue
        knee = link.joints[-1]
        above = robot.links.get(robot.carrier(knee.parent))
        end = _end(robot, link)
        if above is None or not above.moving or above.joints[-1].kind != HINGE or end is None:
            continue
        hip = above.joints[-1]
        cosine = float(hip.axis @ knee.axis)
        if abs(cosine) < PARALLEL or abs(hip.axis[2]) > LEVEL:
            continue
        thigh, shank = (
            _across(vector, hip.axis)
            for vector in (knee.position - hip.position, end - knee.position)
        )
        lengths = [float(np.linalg.norm(vector)) for vector in (thigh, shank)]
        if min(lengths) > 0.4 * max(lengths) and any(_ends_low(robot, link)):
            yield Leg(hip, knee, thigh, shank, hip.axis, math.copysign(1.0, cosine))


def _end(robot: RobotModel, shank: Link) -> Array | None:
    """Returns where a shank ends: at its next joint, or its foot (3,) in the base frame (m)."""
    group = robot.fixed_group(shank.name)
    moving = [c for part in group for c in robot.children(part.name) if c.moving]
    if len(moving) == 1:
        return moving[0].joints[0].position
    if moving:
        return None
    points = [part.pose.position for part in group if part is not shank]
    points += [part.pose.point(f.position) for part in group for f in part.frames]
    points += [p.pose.point(s.pose.position) for p in group for s in p.shapes if s.kind == "sphere"]
    start = shank.joints[-1].position
    return max(points, key=lambda p: float(np.linalg.norm(p - start)), default=None)


def _ends_low(robot: RobotModel, link: Link) -> Iterator[bool]:
    """Yields whether a link, or one that it carries, is said to be a foot, a calf or an ankle."""
    for part in (link, *robot.descendants(link.name)):
        words = (part.name, *(frame.name for frame in part.frames), *(j.name for j in part.joints))
        yield any(word in name.lower() for name in words for word in LEG_WORDS)


LEG_WORDS = (
    "foot",
    "calf",
    "shank",
    "ankle",
    "knee",
    "kfe",
    "lower_leg",
    "lowerleg",
    "leg_",
    "toe",
)
"""In names of what a robot stands on; arms hang down, too, and bend otherwise."""


@rule
def limits_away_from_stand(robot: RobotModel) -> Iterator[Found]:
    """Finds knees that bend away from what their hips allow: the foot does not come below the hip.

    In most of the knee's range it can, in robots that stand. Told where it could if the knee's, or
    the hip's, limits (or its axis) had the other sign.
    """
    for leg in legs_of(robot):
        hip, knee = ((joint.lower, joint.upper) for joint in (leg.hip, leg.knee))
        if not all(map(math.isfinite, (*hip, *knee))) or hip[0] >= hip[1] or knee[0] >= knee[1]:
            continue
        share = leg.reached(hip, knee)
        if share >= REACHED:
            continue
        others = {
            leg.knee.name: leg.reached(hip, (-knee[1], -knee[0])),
            leg.hip.name: leg.reached((-hip[1], -hip[0]), knee),
        }
        name = max(others, key=lambda one: others[one])
        if others[name] > 0.95:
            message = diagnose(
                "limits-away-from-stand",
                share=Quantity(share, "1"),
                knee=leg.knee.name,
                turned=name,
                other=Quantity(others[name], "1"),
            )
            yield Found("joint", leg.knee.name, message, "limit")
