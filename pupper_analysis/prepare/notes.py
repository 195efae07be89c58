"""Messages about changes by the preparation: matched joints, feet, couplings, added servos.

Inputs are the results of preparation passes; outputs are diagnostics.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from pupper_analysis.base.diagnostics import Diagnostic, Quantity, Term, diagnose
from pupper_analysis.base.units import JointUnits
from pupper_analysis.models.transmission import (
    Drive,
    MadeServo,
    classify_joint_drive,
    fixed_tendon_levers,
    is_at_one_joint,
    list_play_joints,
    list_tendon_joints,
)
from pupper_analysis.prepare.feet import Foot, has_ellipsoids, is_ball
from pupper_analysis.robot.joints import (
    joint_unit,
)
from pupper_analysis.robot.matching.match import Match
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.problem import can_move_com


def report_joint_matching(matched: Match) -> Iterator[Diagnostic]:
    """Yield messages about differences between URDF and MJCF that the matching of joints removed.

    Examples are joints with different names, and joints that a single file contains.
    """
    renamed = [
        diagnose("names-of-joint", urdf=old, mjcf=new)
        for new, old in matched.urdf_joint.items()
        if old != new
    ]
    if renamed:
        yield diagnose("joints-named-otherwise", joints=renamed)
    conventions = matched.conventions
    if conventions.zeros:
        offsets = [
            diagnose(
                "zero-moved",
                subject=("joint", name),
                offset=Quantity(offset, joint_unit(matched.robot, name)),
            )
            for name, offset in conventions.zeros.items()
        ]
        yield diagnose("zeros-elsewhere", joints=offsets)
    if conventions.base is not None and matched.robot.floating:
        yield diagnose("base-frame-taken")
    for names, where in ((matched.only_urdf, "URDF"), (matched.only_mjcf, "MJCF")):
        if names:
            yield diagnose("joints-held-at-zero", joints=names, file=where)


def report_passive_joints(robot: Robot) -> Iterator[Diagnostic]:
    """Yield a message about the passive joints of a robot, if there are any.

    A passive joint has no actuator in the MJCF, and an effort limit of zero
    (`Description.passive_joints`).
    """
    if robot.description.passive_joints:
        yield diagnose("joints-passive", joints=robot.description.passive_joints)


def report_joints_without_actuator(robot: Robot) -> Iterator[Diagnostic]:
    """Yield a message about joints without actuator in an MJCF with actuators at other joints.

    The prepared robot has a servo at each of these joints. Passive joints, and MJCFs in which no
    joint of the robot has an actuator, are not reported.
    """
    file = None if robot.published is None else robot.published.file
    undriven = [
        servo.joint for servo in robot.description.made_servos if servo.instead_of is Drive.NONE
    ]
    if file is None or file.of_urdf or not undriven:
        return
    model = file.model
    others = [
        name
        for name in robot.joint_names
        if (joint := mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name)) >= 0
        and classify_joint_drive(model, joint) is not Drive.NONE
    ]
    if others:
        yield diagnose("joints-without-actuator", joints=undriven, count=len(others))


def report_tendon_joints(robot: Robot) -> Iterator[Diagnostic]:
    """Yield a message about joints that the MJCF drives only through tendons.

    The prepared robot has a servo at each of these joints.
    """
    file = None if robot.published is None else robot.published.file
    driven = [
        servo.joint for servo in robot.description.made_servos if servo.instead_of is Drive.TENDON
    ]
    if file is None or not driven:
        return
    model, moved = file.model, list_tendon_joints(file.model)
    joints = [model.joint(name).id for name in driven]
    actuators = [actuator for actuator, others in moved.items() if others & set(joints)]
    dependence = np.array([[joint in moved[cable] for cable in actuators] for joint in joints])
    # Levers of spatial tendons depend on the configuration. Random numbers give the generic rank.
    numbers = np.random.default_rng(0).uniform(0.5, 1.5, dependence.shape)
    fixed = fixed_tendon_levers(model)
    matrix = np.where(dependence, numbers, 0.0)
    spatial = [actuator for actuator in actuators if not fixed[actuator]]
    for column, actuator in enumerate(actuators):
        if actuator not in spatial:
            matrix[:, column] = [fixed[actuator].get(joint, 0.0) for joint in joints]
    yield diagnose(
        "joints-at-tendons",
        joints=driven,
        actuators=[model.actuator(actuator).name or f"#{actuator}" for actuator in actuators],
        tendons=list(
            dict.fromkeys(
                model.tendon(int(model.actuator_trnid[actuator, 0])).name or f"#{actuator}"
                for actuator in actuators
            )
        ),
        too_few=int(np.linalg.matrix_rank(matrix)) < len(driven),
        spatial=[model.actuator(actuator).name or f"#{actuator}" for actuator in spatial],
    )


def report_feet(robot: Robot, feet: Sequence[Foot], *, given: bool) -> Diagnostic:
    """Create the message that lists the feet of a robot, with their bodies.

    The number of contact points is stated for a foot with several points.

    Args:
        robot: Robot.
        feet: Feet.
        given: True if the user named the feet, False if they were detected.
    """
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
    """Create the messages about feet whose collision shapes are replaced by spheres.

    There are three kinds of feet: ellipsoids, soles (several contact points), and others. All feet
    of a kind share a message with the names of the feet.

    Returns:
        {foot: message}; feet without replaced shapes are omitted.
    """
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
    """Yield a message if the legs cannot move the CoM in both horizontal directions.

    The default stand of such a robot requires the CoM only inside of the support polygon.
    """
    if not can_move_com(robot):
        yield diagnose("com-anywhere-inside")


def report_coupled_joints(robot: Robot) -> Iterator[Diagnostic]:
    """Yield a message about the joints whose positions follow from closed loops or couplings."""
    if robot.closure is not None:
        yield robot.closure.describe()


def report_added_servos(
    servos: Sequence[MadeServo], own: int, timestep: float, units: Sequence[JointUnits]
) -> Iterator[Diagnostic]:
    """Yield messages about servos that the preparation added, and about servos that they replace.

    Defective servos of the MJCF, with a stiffness of zero or below, are replaced.

    Args:
        servos: Added servos, at least one.
        own: Number of joints with a servo in the MJCF, which the preparation keeps.
        timestep: Time step of the model with the added servos [s].
        units: Units of the gains of each added servo.
    """
    bad: dict[str, list[str]] = {}
    for servo in servos:
        if servo.instead_of.has_invalid_stiffness:
            bad.setdefault(str(servo.instead_of.value), []).append(servo.joint)
    for what, names in bad.items():
        yield diagnose("servos-replaced", what=Term(what), joints=names)
    yield diagnose(
        "servos-added",
        count=len(servos),
        bad=bool(bad),
        some=bool(own) and not bad,
        kp=describe_spans([servo.kp for servo in servos], [unit.stiffness for unit in units]),
        kd=describe_spans([servo.kd for servo in servos], [unit.damping for unit in units]),
        timestep=Quantity(timestep, "s"),
    )


def report_uncommanded_actuators(robot: Robot) -> Iterator[Diagnostic]:
    """Yield a message about actuators that do not act on a single hinge or slide.

    Examples are actuators at a tendon or a site.
    """
    model = robot.mj_model
    actuators = [
        actuator for actuator in range(model.nactuator) if not is_at_one_joint(model, actuator)
    ]
    if not actuators:
        return
    names = [model.actuator(actuator).name or f"#{actuator}" for actuator in actuators]
    yield diagnose("motors-commanded-zero", motors=names)


def report_play_joints(robot: Robot) -> Iterator[Diagnostic]:
    """Yield a message about the hinges that model the play of gears (`list_play_joints`)."""
    model = robot.mj_model
    names = tuple(model.joint(joint).name for joint in list_play_joints(model))
    if names:
        yield diagnose("joints-are-play", joints=names)


def describe_spans(values: Sequence[float], units: Sequence[str]) -> Diagnostic:
    """Create the part of a message that states the range of values of each unit.

    For example "50 to 2700 N m/rad and 2000 N/m", for hinges and slides.

    Args:
        values: Values, at least one.
        units: Unit of each value: at most two different units.
    """
    spans = [
        describe_span(
            [value for value, own in zip(values, units, strict=True) if own == unit], unit
        )
        for unit in dict.fromkeys(units)
    ]
    return spans[0] if len(spans) == 1 else diagnose("spans", first=spans[0], second=spans[1])


def describe_span(values: ArrayLike, unit: str) -> Diagnostic:
    """Create the part of a message that states the range of values, such as "5 to 20 N m/rad".

    Args:
        values: Values, at least one.
        unit: Unit of the values.
    """
    low, high = float(np.min(values)), float(np.max(values))
    return diagnose("span", least=low, most=Quantity(high, unit), wide=low != high)
