"""Motors as a variable of a study: mass, effort, speed, rotor inertia and gains change together.

Input is a robot and {joint: motor}; output is a robot with the numbers of the motors in the URDF
and the MJCF (`with_motors`). A motor is stored in tables as a number (`encode_motor`).
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import fields, replace

import numpy as np
import pinocchio as pin

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.models.attributes import BY_KIND
from pupper_analysis.models.description import ModelTree
from pupper_analysis.models.motors.assignment import list_motor_efforts
from pupper_analysis.models.motors.motor import Motor
from pupper_analysis.models.motors.reading import find_motor
from pupper_analysis.models.spec_tree import SpecTree, set_inertia, write_joint_parameter
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.models.xml import to_text
from pupper_analysis.robot.build import rebuild_robot, with_efforts
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.joints import check_motor_joints
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import resolve_servo_gains
from pupper_analysis.robot.tool import find_tool
from pupper_analysis.tools.study.parameters import VariablePattern, find_moving_joints, with_gains
from pupper_analysis.tools.study.variables import Variable

MOTOR_KIND = "motor"
"""Name of the study variable whose values are motors, and kind in the name ``motor:PATTERN``."""

_CODE_DIGITS = 13
"""Number of hexadecimal digits of the hash with which tables identify a motor (`encode_motor`). 13
digits are 52 bits, which a double represents exactly.
"""


def is_motor_variable(name: str) -> bool:
    """Return True if the values of a study variable are motors: ``motor`` or ``motor:PATTERN``."""
    return name.partition(":")[0] == MOTOR_KIND


def encode_motor(motor: Motor) -> float:
    """Compute the number with which a table identifies a motor: a hash of name and numbers."""
    parts = [
        repr(getattr(motor, item.name)) for item in fields(Motor) if item.name not in _SOURCE_FIELDS
    ]
    digest = hashlib.sha256("\0".join(parts).encode()).hexdigest()
    return float(int(digest[:_CODE_DIGITS], 16))


_SOURCE_FIELDS = ("source", "sources")
"""Fields of `Motor` that `encode_motor` leaves out: sources of numbers do not affect a design."""


def make_motor_variable(name: str, requested: object) -> tuple[Variable, dict[float, Motor]]:
    """Create the study variable whose values are the motors of a list.

    Args:
        name: Name of the variable, for messages.
        requested: Name of a motor or of a motor file, a list of names, or {"values": list}.

    Returns:
        Variable; {code of the variable: motor}.

    Raises:
        ConfigurationError: If the value is no list of different motors.
        UnknownNameError: If no motor has the name.
    """
    if isinstance(requested, Mapping) and list(requested) == ["values"]:
        requested = requested["values"]
    texts = [requested] if isinstance(requested, str) else requested
    if not isinstance(texts, list | tuple) or not all(isinstance(item, str) for item in texts):
        problem = diagnose("motors-of-variable", given=repr(requested))
        raise ConfigurationError(f"vary[{name!r}]", problem)
    motors = {text: find_motor(text) for text in texts}
    codes = {encode_motor(motor): motor for motor in motors.values()}
    if not texts or len(codes) < len(texts):
        problem = diagnose("motor-there-twice", names=list(texts))
        raise ConfigurationError(f"vary[{name!r}]", problem)
    return Variable("motors", tuple(codes), tuple(texts)), codes


def assign_motors(
    robot: Robot, numbers: Mapping[str, float], motors: Mapping[float, Motor]
) -> dict[str, Motor]:
    """Select the motors of joints in a design, from the values of the motor variables.

    A variable ``motor:PATTERN`` has priority over ``motor``.

    Args:
        robot: Robot of the design.
        numbers: {variable: value} of all variables; the values of motor variables are codes.
        motors: {code: motor}.

    Returns:
        {joint: motor}; empty without motor variables.

    Raises:
        ConfigurationError: If a selected joint cannot have a motor, or if two patterns select the
            same joint.
        UnknownNameError: If a pattern matches no joint.
    """
    assigned: dict[str, Motor] = {}
    owners: dict[str, str] = {}
    for name in sorted(filter(is_motor_variable, numbers), key=lambda name: ":" in name):
        pattern = VariablePattern.parse(name)
        joints = robot.joint_names if pattern is None else find_moving_joints(robot, pattern)
        check_motor_joints(robot, joints, f"vary[{name!r}]")
        if pattern is not None:
            for joint in joints:
                if owners.setdefault(joint, name) != name:
                    problem = diagnose("motors-overlap", joint=joint, first=owners[joint])
                    raise ConfigurationError(f"vary[{name!r}]", problem)
        assigned |= dict.fromkeys(joints, motors[numbers[name]])
    return assigned


def with_motors(robot: Robot, motors: Mapping[str, Motor], present: Motor) -> Robot:
    """Return a robot with other motors at joints, in the URDF and the MJCF.

    Changed numbers of each joint:

    - Effort limit: largest torque of the motor at rest.
    - Velocity limit: speed of the motor without load.
    - Armature: inertia of the rotor at the output.
    - Servo gains: gains that the motor states.
    - Mass of the parent link, or of the heaviest link that is fixed to the parent link. The mass
      difference to the motor ``present`` is added as a point mass at the origin of the joint.

    Velocity limits, armatures and gains that the motor does not state are kept.

    Args:
        robot: Robot.
        motors: {joint: motor}; no slides.
        present: Motor at the joints of ``motors`` whose mass the files include.

    Raises:
        ModelError: If mass or largest torque of a motor are unknown, or a model cannot be built.
        ConfigurationError: If a link would have no positive mass, or no valid inertia.
    """
    if not motors:
        return robot
    trees = robot.description.trees()
    differences = {
        joint: motor.get("mass") - present.get("mass") for joint, motor in motors.items()
    }
    _add_masses(robot, trees, differences)
    urdf, mjcf = trees
    efforts = list_motor_efforts(motors)
    for joint, motor in motors.items():
        if motor.no_load_speed is not None:
            urdf.joints[joint].set_parameter(BY_KIND["velocity"], motor.no_load_speed)
        if motor.rotor_inertia is not None and motor.gear_ratio is not None:
            element = mjcf.spec.joint(joint)
            write_joint_parameter(element, BY_KIND["armature"], motor.reflected_inertia)
    built = rebuild_robot(robot, urdf=to_text(urdf.root), mjcf=mjcf.spec)
    built = with_efforts(replace(built, stand_height=robot.stand_height), efforts)
    return _with_motor_gains(built, motors)


def _with_motor_gains(robot: Robot, motors: Mapping[str, Motor]) -> Robot:
    """Return a robot with the servo gains that the motors state; other gains are unchanged."""
    if all(motor.kp is None and motor.kd is None for motor in motors.values()):
        return robot
    gains = resolve_servo_gains(robot)
    kp, kd = gains.kp.copy(), gains.kd.copy()
    for joint, motor in motors.items():
        index = robot.joint_names.index(joint)
        kp[index] = kp[index] if motor.kp is None else motor.kp
        kd[index] = kd[index] if motor.kd is None else motor.kd
    return with_gains(robot, kp, kd, {})


def _add_masses(
    robot: Robot, trees: tuple[UrdfTree, SpecTree], differences: Mapping[str, float]
) -> None:
    """Add point masses [kg], which may be negative, at joints to the parent links, in place.

    A parent link may be a frame without mass, fixed to the body that contains the motor. Therefore
    the heaviest of the links that are fixed to each other gets the mass.
    """
    urdf, mjcf = trees
    config, data = Configuration(robot, robot.neutral()), robot.compute_kinematics()
    by_link: dict[tuple[ModelTree, str], list[tuple[float, Array]]] = {}
    for joint, mass in differences.items():
        element = urdf.joints[joint]
        place = find_tool(robot, element.parent).translated(element.origin.translation)
        world = place.position(config)
        link = _find_heaviest_link(urdf, element.parent)
        at_link = config.frame_rotation(link).T @ (world - config.frame_position(link))
        body = _find_heaviest_link(mjcf, place.locate_in_mjcf(robot)[0])
        number = robot.mj_model.body(body).id
        at_body = data.xmat[number].reshape(3, 3).T @ (world - data.xpos[number])
        by_link.setdefault((urdf, link), []).append((mass, at_link))
        by_link.setdefault((mjcf, body), []).append((mass, at_body))
    for (tree, link), masses in by_link.items():
        total = _add_point_masses(link, _read_inertia(tree, link), masses)
        if isinstance(tree, UrdfTree):
            tree.links[link].set_inertia(total)
        else:
            set_inertia(tree.spec.body(link), total)


def _find_heaviest_link(tree: ModelTree, link: str) -> str:
    """Return the heaviest of the links that are fixed to a link, or the link itself."""
    root = link
    while not tree.movers(root):
        parent = tree.parent(root)
        if parent is None:
            break
        root = parent
    group = tree.fixed_group(root)
    return max([link, *group], key=tree.link_mass)


def _read_inertia(tree: ModelTree, link: str) -> pin.Inertia:
    """Return the spatial inertia of a link or body in the link frame [kg, m, kg m^2]."""
    if isinstance(tree, UrdfTree):
        return tree.links[link].inertia or pin.Inertia.Zero()
    assert isinstance(tree, SpecTree)
    return tree.read_inertia(link)


def _add_point_masses(
    link: str, inertia: pin.Inertia, masses: list[tuple[float, Array]]
) -> pin.Inertia:
    """Return the inertia of a link with added point masses, in the same frame.

    ``masses`` are (mass [kg], position (3,) [m]) of each point; a mass may be negative.
    """
    total = float(inertia.mass) + sum(mass for mass, _ in masses)
    problem = diagnose("motor-mass-negative", link=link, mass=Quantity(total, "kg"))
    if total <= 0:
        raise ConfigurationError(MOTOR_KIND, problem)
    moment = float(inertia.mass) * np.array(inertia.lever)
    centre = (moment + sum(mass * place for mass, place in masses)) / total
    tensor = np.array(inertia.inertia)
    for mass, place in ((float(inertia.mass), np.array(inertia.lever)), *masses):
        offset = place - centre
        tensor += mass * (offset @ offset * np.eye(3) - np.outer(offset, offset))
    moments = np.linalg.eigvalsh(tensor)
    if moments[0] <= 0 or moments[2] > moments[0] + moments[1]:
        raise ConfigurationError(MOTOR_KIND, problem)
    return pin.Inertia(total, centre, tensor)
