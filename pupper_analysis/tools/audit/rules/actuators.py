"""Rules about actuators on joints.

Force of a MuJoCo actuator: F = gain * ctrl + bias, clipped to ``forcerange``; joint torque: gear *
F. A position servo has gain = kp and bias = -kp * l - kd * dl/dt, with the length l = gear * q.
Source: MuJoCo documentation, "Computation: Actuation model". The rules check the actuators that
`list_drives` yields: actuators with constant gain on a single hinge or slide.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import asdict, dataclass

import mujoco
import numpy as np

from pupper_analysis.base.diagnostics import (
    Quantity,
    Term,
    diagnose,
)
from pupper_analysis.base.units import JointUnits, select_joint_units
from pupper_analysis.models.loading import CheckFinding
from pupper_analysis.models.mjcf import JointKind
from pupper_analysis.models.stated.mjcf import joint_name
from pupper_analysis.models.stated.model import MjcfModel
from pupper_analysis.models.transmission import ActuatorLaw, is_at_one_joint, read_actuator_law
from pupper_analysis.tools.audit.registry import rule


@dataclass(frozen=True)
class ActuatorDrive(ActuatorLaw):
    """Actuator of an MJCF with constant gain on a single hinge or slide.

    Attributes:
        name: Name of the actuator; for an actuator without name, the name of the joint.
        id: Index of the actuator.
        control: Index of the first control.
        joint: Index of the joint.
        joint_name: Name of the joint.
        units: Units of the joint.
    """

    name: str
    id: int
    control: int
    joint: int
    joint_name: str
    units: JointUnits

    @property
    def is_servo(self) -> bool:
        """Whether the force depends on the joint position, as for a position servo."""
        return self.stiffness != 0


def list_drives(model: mujoco.MjModel) -> Iterator[ActuatorDrive]:
    """Yield the actuators with constant gain on a single hinge or slide."""
    constant = model.actuator_gaintype == mujoco.mjtGain.mjGAIN_FIXED.value
    for actuator in np.flatnonzero(constant).tolist():
        joint = int(model.actuator_trnid[actuator, 0])
        if is_at_one_joint(model, actuator):
            yield ActuatorDrive(
                **asdict(read_actuator_law(model, actuator)),
                name=model.actuator(actuator).name or joint_name(model, joint),
                id=actuator,
                control=int(model.actuator_ctrladr[actuator]),
                joint=joint,
                joint_name=joint_name(model, joint),
                units=select_joint_units(slides=model.jnt_type[joint] == JointKind.SLIDE),
            )


def _list_robot_drives(robot: MjcfModel) -> Iterator[tuple[mujoco.MjModel, ActuatorDrive]]:
    """Yield (compiled model, actuator) of the actuators that `list_drives` finds in a robot."""
    if robot.mj_model is not None:
        for drive in list_drives(robot.mj_model):
            yield robot.mj_model, drive


@rule
def actuator_without_effect(robot: MjcfModel) -> Iterator[CheckFinding]:
    """Find joint actuators (`list_drives`) whose control has no effect: gain or gear ratio is 0."""
    for _, drive in _list_robot_drives(robot):
        if drive.gain == 0 or drive.gear == 0:
            message = diagnose("actuator-without-effect", gain=drive.gain, gear=drive.gear)
            yield CheckFinding("actuator", drive.name, message)


@rule
def servo_drives_away(robot: MjcfModel) -> Iterator[CheckFinding]:
    """Find actuators with a stiffness or damping below zero: dF/dl > 0 or dF/d(dl/dt) > 0."""
    for _, drive in _list_robot_drives(robot):
        if drive.stiffness < 0:
            stiffness = Quantity(drive.stiffness, drive.units.stiffness)
            message = diagnose("servo-drives-away", stiffness=stiffness)
            yield CheckFinding("actuator", drive.name, message)
        if drive.damping < 0:
            damping = Quantity(drive.damping, drive.units.damping)
            yield CheckFinding("actuator", drive.name, diagnose("damping-drives", damping=damping))


@rule
def servos_compete(robot: MjcfModel) -> Iterator[CheckFinding]:
    """Find joints with two or more position servos."""
    holding: dict[str, list[ActuatorDrive]] = {}
    for _, drive in _list_robot_drives(robot):
        if drive.stiffness > 0:
            holding.setdefault(drive.joint_name, []).append(drive)
    for joint, several in holding.items():
        if len(several) > 1:
            gains = [Quantity(drive.stiffness, drive.units.stiffness) for drive in several]
            message = diagnose("servos-compete", joint=joint, servos=len(several), gains=gains)
            yield CheckFinding("actuator", several[1].name, message)


MIN_SERVOS = 5
"""Smallest number of regular actuators in an MJCF with which a single exception, such as a negative
gear, is reported as a probable mistake. Chosen, not tuned.
"""


@rule
def drive_of_another_kind(robot: MjcfModel) -> Iterator[CheckFinding]:
    """Find a single actuator without position feedback among `MIN_SERVOS` or more servos.

    The actuator must drive a hinge with limits.
    """
    found = list(_list_robot_drives(robot))
    other_actuators = [(model, drive) for model, drive in found if not drive.is_servo]
    if len(other_actuators) != 1 or len(found) - 1 < MIN_SERVOS:
        return
    model, drive = other_actuators[0]
    hinge = model.jnt_type[drive.joint] == mujoco.mjtJoint.mjJNT_HINGE.value
    if hinge and model.jnt_limited[drive.joint]:
        message = diagnose("drive-of-another-kind", gain=drive.gain, servos=len(found) - 1)
        yield CheckFinding("actuator", drive.name, message)


MAX_COMMAND_RANGE_ERROR, MIN_DEGREES = 0.1, 12.0
"""Bounds with which `command_range_in_degrees` reports a command range. First: largest difference
from the joint's range after conversion from degrees, relative to the width of the joint's range.
Second: magnitude that an end of the command range must exceed; 12 rad are nearly two turns. Chosen,
not tuned.
"""


@rule
def gear_sign_odd(robot: MjcfModel) -> Iterator[CheckFinding]:
    """Find the only negative gear among `MIN_SERVOS` or more positive gears."""
    found = [drive for _, drive in _list_robot_drives(robot) if drive.gear]
    negative = [drive for drive in found if drive.gear < 0]
    if len(negative) == 1 and len(found) > MIN_SERVOS:
        message = diagnose(
            "gear-sign-odd",
            gear=negative[0].gear,
            joint=negative[0].joint_name,
            others=len(found) - 1,
        )
        yield CheckFinding("actuator", negative[0].name, message)


_NAME_PARTS = re.compile(
    r"(^|[_\-/])(joint|motor|actuator|servo|act|pos|position|ctrl|torque)(?=$|[_\-/])"
)
"""Regular expression of the words in names of joints and actuators that do not name the joint."""


@rule
def actuator_of_another_joint(robot: MjcfModel) -> Iterator[CheckFinding]:
    """Find actuators with the name of a joint that they do not drive.

    Names are compared without words such as joint and motor.
    """
    short: dict[str, list[str]] = {}
    for name in robot.joints:
        short.setdefault(_NAME_PARTS.sub("", name.lower()), []).append(name)
    short.pop("", None)  # such as "joint" alone, which names no joint
    for model, drive in _list_robot_drives(robot):
        named = short.get(_NAME_PARTS.sub("", model.actuator(drive.id).name.lower()), [])
        if len(named) == 1 and named[0] != drive.joint_name:
            message = diagnose("actuator-of-another-joint", joint=drive.joint_name, named=named[0])
            yield CheckFinding("actuator", drive.name, message)


@rule
def command_range_in_degrees(robot: MjcfModel) -> Iterator[CheckFinding]:
    """Find position servos of hinges with a ctrlrange that is the joint's range in degrees."""
    for model, drive in _list_robot_drives(robot):
        hinge = model.jnt_type[drive.joint] == mujoco.mjtJoint.mjJNT_HINGE.value
        ranged = model.jnt_limited[drive.joint] and model.actuator_ctrllimited[drive.control]
        if not (hinge and ranged and drive.stiffness > 0 and drive.gear):
            continue
        factor = drive.gain / drive.stiffness / drive.gear
        commands = np.sort(factor * model.actuator_ctrlrange[drive.control])
        ends = model.jnt_range[drive.joint]
        gap = float(np.abs(np.deg2rad(commands) - ends).max())
        if np.abs(commands).max() > MIN_DEGREES and gap <= MAX_COMMAND_RANGE_ERROR * np.ptp(ends):
            message = diagnose(
                "command-range-in-degrees",
                low=float(model.actuator_ctrlrange[drive.control, 0]),
                high=float(model.actuator_ctrlrange[drive.control, 1]),
                joint=drive.joint_name,
                lower=Quantity(ends[0], "rad"),
                upper=Quantity(ends[1], "rad"),
            )
            yield CheckFinding("actuator", drive.name, message)


@rule
def actuator_unlimited(robot: MjcfModel) -> Iterator[CheckFinding]:
    """Find joint actuators (`list_drives`) without a torque limit.

    Limits are forcerange, actuatorfrcrange and, for actuators without position feedback, ctrlrange.
    """
    for model, drive in _list_robot_drives(robot):
        limited = model.actuator_forcelimited[drive.id] or model.jnt_actfrclimited[drive.joint]
        by_input = not drive.is_servo and model.actuator_ctrllimited[drive.control]
        if not limited and not by_input:
            kind = Term("position servo" if drive.is_servo else "motor")
            message = diagnose("actuator-unlimited", kind=kind, gain=drive.gain)
            yield CheckFinding("actuator", drive.name, message)


@rule
def forcerange_above_joint(robot: MjcfModel) -> Iterator[CheckFinding]:
    """Find actuators whose forcerange times gear exceeds actuatorfrcrange by more than 1 %.

    The largest magnitudes of both ranges at the joint are compared [N m, N].
    """
    for model, drive in _list_robot_drives(robot):
        if not (model.actuator_forcelimited[drive.id] and model.jnt_actfrclimited[drive.joint]):
            continue
        force = float(np.abs(model.actuator_forcerange[drive.id]).max()) * abs(drive.gear)
        joint = float(np.abs(model.jnt_actfrcrange[drive.joint]).max())
        unit = robot.joints[drive.joint_name].units.effort
        if force > 1.01 * joint:
            message = diagnose(
                "forcerange-above-joint",
                force=Quantity(force, unit),
                joint=drive.joint_name,
                through=Quantity(joint, unit),
            )
            yield CheckFinding("actuator", drive.name, message)
