"""The joints of two files: limits that both keep, one motor at each, couplings, parts of loops."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin

from pupper_analysis.base.arrays import placement_of
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.models.conversion import inertia_of_body
from pupper_analysis.models.description import Description
from pupper_analysis.models.mjcf import compile_spec
from pupper_analysis.models.spec_tree import SpecTree
from pupper_analysis.models.transmission import actuator_gear, drives_by_joint, law_of
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.models.xml import to_text
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.matching.match import Match
from pupper_analysis.robot.robot import Robot

_NARROWER = 1e-3
"""A limit that is further in by more is another one (rad, m): keyframes and files are rounded."""

_TURNS = 2 * math.pi
"""What a joint without limits may turn, either way, where loops bind it (rad): round."""


def bound_turning_joints(robot: Robot) -> Description | None:
    """Returns the description with limits for joints that turn round and round; None without loops.

    Where loops bind joints, PlaCo's constraints on joints know no others. No note tells, as the
    limits are further away than such a joint has to turn.
    """
    if robot.closure is None or not robot.pin_convention.unbounded.any():
        return None
    tree = UrdfTree.of(robot.description.urdf)
    for name, joint in tree.joints.items():
        if joint.kind != "continuous" or name not in robot.joint_names:
            continue
        number = robot.mj_model.joint(name).id
        limited = bool(robot.mj_model.jnt_limited[number])
        ends = robot.mj_model.jnt_range[number].tolist() if limited else (-_TURNS, _TURNS)
        joint.set_range(*ends)
    return replace(robot.description, urdf=to_text(tree.root))


def narrow_limits(robot: Robot) -> tuple[Description | None, list[Diagnostic]]:
    """Returns the description with the URDF's limits narrowed to the MJCF's; None if they are.

    A stand at an angle that MuJoCo's limit excludes is thrown out of it by the first step.
    """
    model, narrower = robot.mj_model, {}
    for name, low, high in zip(
        robot.joint_names, robot.lower_limits, robot.upper_limits, strict=True
    ):
        joint = model.joint(name).id
        if not model.jnt_limited[joint]:
            continue
        first, last = (float(value) for value in model.jnt_range[joint])
        inside = max(first, float(low)), min(last, float(high))
        if inside[0] < inside[1] and (first > low + _NARROWER or last < high - _NARROWER):
            narrower[name] = inside
    if not narrower:
        return None, []
    tree = UrdfTree.of(robot.description.urdf)
    for name, ends in narrower.items():
        tree.joints[name].set_range(*ends)
    messages = [
        diagnose("joint-range", subject=("joint", name), lower=low, upper=high)
        for name, (low, high) in narrower.items()
    ]
    noted = [diagnose("narrower-limits-kept", joints=messages)]
    return replace(robot.description, urdf=to_text(tree.root)), noted


def couple_mimics(matched: Match, description: Description) -> tuple[Description, list[Diagnostic]]:
    """Returns the description with the URDF's ``<mimic>`` in its MJCF, where that says nothing.

    A joint that has a motor of its own in the MJCF, or is bound there, stays as it is; so does one
    whose coupling is there and switched off.

    Args:
        matched: The two files.
        description: What is to be built of them.

    Returns:
        The description, and what was done.
    """
    spec = description.mjcf.copy()
    driven = {actuator.target for actuator in spec.actuators}
    closure, names = matched.robot.closure, matched.robot.joint_names
    bound = {names[joint] for joint in closure.following} if closure is not None else set()
    stated = {
        name
        for equality in spec.equalities
        if equality.type == mujoco.mjtEq.mjEQ_JOINT
        for name in (equality.name1, equality.name2)
    }
    joints = {joint.name for joint in spec.joints}
    added, free = [], []
    for name, (leader, multiplier, offset) in matched.mimics.items():
        if name in bound:
            continue
        if name in stated or name in driven or leader not in joints or name not in joints:
            free.append(name)
            continue
        SpecTree(spec).add_coupling(name, leader, multiplier, offset)
        added.append(name)
    notes = [diagnose("mimics-coupled", joints=added)] if added else []
    notes += [diagnose("mimics-taken-as-free", joints=free)] if free else []
    return (replace(description, mjcf=spec) if added else description), notes


def one_at_each_joint(spec: mujoco.MjSpec, source: Path) -> list[Diagnostic]:
    """Takes the motors at a joint together, in place.

    A stand has one command per joint, from which all of them would have to be determined: MuJoCo
    adds up what position and velocity servos do, and so are their gains added. Motors beside a
    servo, and all but one of several, are left out: they are not commanded.

    Args:
        spec: The MJCF's; it has no keyframes.
        source: Its file.

    Returns:
        What was done.
    """
    joint = mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT
    driven = [actuator.target for actuator in spec.actuators if actuator.trntype in joint]
    if len(driven) == len(set(driven)):
        return []
    model = compile_spec(spec.copy(), source)
    joints = joints_of_several_motors(model)
    if not joints:
        return []
    actuators = list(spec.actuators)
    gone = set[int]()
    for drives in joints.values():
        kept = _kept(model, drives)
        _take_gains(model, actuators[kept], kept, [drive for drive in drives if drive != kept])
        gone |= set(drives) - {kept}
    for index in sorted(gone, reverse=True):
        _delete(spec, actuators[index])
    names = [str(model.joint(joint).name) for joint in joints]
    return [diagnose("motors-taken-together", joints=names)]


def joints_of_several_motors(model: mujoco.MjModel) -> dict[int, list[int]]:
    """Returns {hinge or slide: its motors} of those that have several."""
    return {joint: motors for joint, motors in drives_by_joint(model).items() if len(motors) > 1}


def _kept(model: mujoco.MjModel, drives: list[int]) -> int:
    """Returns the motor that stays: a position servo, else a plain motor, else the first."""

    def rank(motor: int) -> int:
        law = law_of(model, motor)
        if law.at_joint[0] > 0:
            return 0
        plain = model.actuator_gaintype[motor] == mujoco.mjtGain.mjGAIN_FIXED.value
        return 1 if plain and not law.at_joint[1] else 2

    return min(drives, key=rank)


def _take_gains(
    model: mujoco.MjModel, servo: mujoco.MjsActuator, kept: int, others: list[int]
) -> None:
    """Adds other servos' gains, and their limits, to a servo."""
    law = law_of(model, kept)
    gear = law.gear
    if not (law.at_joint[0] > 0 and gear):
        return
    given = [law_of(model, motor).at_joint for motor in others]
    more = sum(each[0] for each in given) / gear**2
    bias = np.array(servo.biasprm)
    bias[1] -= more
    bias[2] -= sum(each[1] for each in given) / gear**2
    servo.biasprm = bias
    if more:
        gain = np.array(servo.gainprm)
        gain[0] += more
        servo.gainprm = gain
    acting = [m for m, each in zip(others, given, strict=True) if each[0] or each[1]]
    if not acting:
        return
    if model.actuator_forcelimited[[kept, *acting]].all():
        gears = [abs(float(actuator_gear(model, motor)[0]) / gear) for motor in acting]
        limits = np.array(servo.forcerange)
        for motor, ratio in zip(acting, gears, strict=True):
            most = float(np.abs(model.actuator_forcerange[motor]).max()) * ratio
            limits += (-most, most)
        servo.forcerange = limits
    else:
        servo.forcelimited = mujoco.mjtLimited.mjLIMITED_FALSE


def _delete(spec: mujoco.MjSpec, actuator: mujoco.MjsActuator) -> None:
    """Deletes an actuator with the sensors of it."""
    for sensor in list(spec.sensors):
        if sensor.objtype == mujoco.mjtObj.mjOBJ_ACTUATOR and sensor.objname == actuator.name:
            spec.delete(sensor)
    spec.delete(actuator)


_MASS_TOLERANCE = 1e-3
"""Share of the weight within which the parts are what the URDF lacks; rounded files have 1e-4."""


def with_parts(matched: Match, spec: mujoco.MjSpec) -> tuple[Description | None, list[Diagnostic]]:
    """Returns the description with the weight of loops' parts, the MJCF's alone, in the URDF too.

    Rods and cranks behind motors, which a tree cannot close, are held at zero: they weigh there.
    Only where the two files then weigh the same, as a URDF may have their weight in other links.
    (A head that it lacks stays a difference of the files.)

    Args:
        matched: The two files.
        spec: The MJCF with all its joints.

    Returns:
        The description; None if there are no such parts, or the files differ otherwise. And what
        was done.
    """
    robot, model = matched.robot, matched.robot.mj_model
    names = [name for name in _part_bodies(spec, matched.cut_joints) if _known(model, name)]
    bodies = [model.body(name).id for name in names if model.body(name).mass[0] > 0]
    mass = float(sum(model.body_mass[body] for body in bodies))
    whole = float(model.body_subtreemass[model.body(robot.mj_base).id])
    if (
        mass <= _MASS_TOLERANCE * whole
        or abs(robot.total_mass + mass - whole) > _MASS_TOLERANCE * whole
    ):
        return None, []
    carriers = {
        int(model.body_weldid[model.body(body).id]): matched.urdf_link[moved]
        for moved, body in matched.mjcf_body.items()
    }
    if any(int(model.body_weldid[body]) not in carriers for body in bodies):
        return None, []
    data, config = robot.placed(), Configuration(robot, robot.neutral())
    tree = UrdfTree.of(robot.description.urdf)
    for body in bodies:
        link = carriers[int(model.body_weldid[body])]
        inside = pin.SE3(config.frame_rotation(link), config.frame_position(link))
        place = placement_of(data.xquat[body], data.xpos[body])
        part = f"{model.body(body).name} (MJCF)"
        weight = inside.actInv(place.act(inertia_of_body(model, body)))
        tree.add_link(part, link, f"{part} (held)", np.zeros(3), weight)
    noted = [diagnose("parts-weigh-in-both", bodies=names, mass=Quantity(mass, "kg"))]
    return replace(robot.description, urdf=to_text(tree.root)), noted


def _part_bodies(spec: mujoco.MjSpec, joints: Sequence[str]) -> list[str]:
    """Returns the bodies that move with some joints, and with no others beyond these."""
    found: list[str] = []
    for name in joints:
        joint = spec.joint(name)
        ahead = [] if joint is None else [joint.parent]
        while ahead:
            body = ahead.pop()
            found.append(body.name)
            ahead += [
                child
                for child in body.bodies
                if all(other.name in joints for other in child.joints)
            ]
    return list(dict.fromkeys(found))


def _known(model: mujoco.MjModel, body: str) -> bool:
    return bool(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, body) >= 0)
