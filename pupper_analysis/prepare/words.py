"""What was taken for feet, in words."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from pupper_analysis.prepare.feet import Foot, is_ball
from pupper_analysis.prepare.soles import BALL
from pupper_analysis.robot.robot import Robot


def named(robot: Robot, feet: Sequence[Foot], *, given: bool) -> str:
    """Says which feet there are, and with how many contact points."""
    texts = []
    for foot in feet:
        count = len(foot.points)
        body = robot.mj_model.body(foot.body).name
        texts.append(f"{foot.name} on {body}" + (f", {count} contact points" if count > 1 else ""))
    how = "feet" if given else "no feet were named; taken were the lowest limbs' ends"
    return f"{how}: {'; '.join(texts)}"


def balls(robot: Robot, feet: Sequence[Foot]) -> Iterator[str]:
    """Says which meshes balls take the place of."""
    kinds: dict[str, list[str]] = {}
    for foot in feet:
        if any(is_ball(robot.mj_model, point) for point in foot.points):
            edgy = len(foot.points) == 1 and foot.points[0].radius == BALL
            kind = "soles" if len(foot.points) > 1 else "edges" if edgy else "round"
            kinds.setdefault(kind, []).append(foot.name)
    why = "as MuJoCo's contacts of a mesh jump from vertex to vertex"
    for kind, names in kinds.items():
        which = ", ".join(names)
        if kind == "round":
            yield (
                f"round meshes of {which}: balls that fit to them touch the ground instead, {why}"
            )
        elif kind == "soles":
            yield (
                f"soles of {which} are meshes: small balls at their corners touch the ground "
                f"instead, {why}"
            )
        else:
            yield (
                f"feet {which} are meshes that are not round: small balls where they are lowest in "
                f"the start pose touch the ground instead, {why}; a sphere as collision geom would "
                "be the robot's own"
            )
