"""What is to be known of a robot as it was loaded, and what was made up for."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import ArrayLike

from pupper_analysis.base.diagnostics import Diagnostic, Quantity, Term, diagnose
from pupper_analysis.models.transmission import MadeServo, is_at_one_joint
from pupper_analysis.prepare.feet import Foot, has_ellipsoids, is_ball
from pupper_analysis.robot.joints import joint_unit
from pupper_analysis.robot.matching.match import Match
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.problem import can_move_com


def report_joint_matching(matched: Match) -> Iterator[Diagnostic]:
    """Tells what became of joints whose names differ, or which only one file has."""
    renamed = [
        diagnose("names-of-joint", urdf=old, mjcf=new)
        for new, old in matched.urdf_joint.items()
        if old != new
    ]
    if renamed:
        yield diagnose("joints-named-otherwise", joints=renamed)
    meant = matched.conventions
    if meant.zeros:
        moved = [
            diagnose(
                "zero-moved",
                subject=("joint", name),
                offset=Quantity(offset, joint_unit(matched.robot, name)),
            )
            for name, offset in meant.zeros.items()
        ]
        yield diagnose("zeros-elsewhere", joints=moved)
    if meant.base is not None and matched.robot.floating:
        yield diagnose("base-frame-taken")
    for names, where in ((matched.only_urdf, "URDF"), (matched.only_mjcf, "MJCF")):
        if names:
            yield diagnose("joints-held-at-zero", joints=names, file=where)


def report_feet(robot: Robot, feet: Sequence[Foot], *, given: bool) -> Diagnostic:
    """Tells which feet there are, and with how many contact points."""
    messages = [
        diagnose(
            "foot-on-body",
            subject=("foot", foot.name),
            body=robot.mj_model.body(foot.body).name,
            points=len(foot.points),
            several=len(foot.points) > 1,
        )
        for foot in feet
    ]
    return diagnose("feet-named" if given else "feet-found", feet=messages)


def report_balls(robot: Robot, feet: Sequence[Foot]) -> dict[str, Diagnostic]:
    """Tells of which feet balls take the place, {foot: why}; feet of a kind have one reason."""
    soles, others, ellipsoids = list[str](), list[str](), list[str]()
    for foot in feet:
        if has_ellipsoids(robot, [foot]):
            ellipsoids.append(foot.name)
        elif any(is_ball(robot.mj_model, point) for point in foot.points):
            (soles if len(foot.points) > 1 else others).append(foot.name)
    return {
        **dict.fromkeys(ellipsoids, diagnose("balls-for-ellipsoids", feet=ellipsoids)),
        **dict.fromkeys(soles, diagnose("balls-for-soles", feet=soles)),
        **dict.fromkeys(others, diagnose("balls-for-feet", feet=others)),
    }


def report_planar_legs(robot: Robot) -> Iterator[Diagnostic]:
    """Tells so if the legs cannot move the com to every place over the feet."""
    if not can_move_com(robot):
        yield diagnose("com-anywhere-inside")


def report_coupled_joints(robot: Robot) -> Iterator[Diagnostic]:
    """Tells which joints follow others."""
    if robot.closure is not None:
        yield robot.closure.describe()


def report_added_servos(
    servos: Sequence[MadeServo], own: int, timestep: float
) -> Iterator[Diagnostic]:
    """Tells which servos were made up, and instead of what.

    Args:
        servos: Those that were made up.
        own: How many joints have one of the MJCF's.
        timestep: Of the model that has them (s).
    """
    bad: dict[str, list[str]] = {}
    for servo in servos:
        if servo.instead_of.bad:
            bad.setdefault(str(servo.instead_of.value), []).append(servo.joint)
    for what, names in bad.items():
        yield diagnose("servos-replaced", what=Term(what), joints=names)
    yield diagnose(
        "servos-added",
        count=len(servos),
        bad=bool(bad),
        some=bool(own) and not bad,
        kp=describe_span([servo.kp for servo in servos], "N m/rad"),
        kd=describe_span([servo.kd for servo in servos], "N m s/rad"),
        timestep=Quantity(timestep, "s"),
    )


def report_uncommanded_actuators(robot: Robot) -> Iterator[Diagnostic]:
    """Tells which motors drive no joint of their own: a tendon, a site, a ball joint."""
    model = robot.mj_model
    others = [motor for motor in range(model.nactuator) if not is_at_one_joint(model, motor)]
    if not others:
        return
    names = [model.actuator(motor).name or f"#{motor}" for motor in others]
    yield diagnose("motors-commanded-zero", motors=names)


def describe_span(values: ArrayLike, unit: str) -> Diagnostic:
    """Tells the least and the greatest of some numbers, or the one that all are."""
    low, high = float(np.min(values)), float(np.max(values))
    return diagnose("span", least=low, most=Quantity(high, unit), wide=low != high)
