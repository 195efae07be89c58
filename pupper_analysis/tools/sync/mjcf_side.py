"""Planning of changes to an MJCF and the included files: positions, limits, gains, masses.

Inputs are target values from the URDF, converted to the frames of the MJCF, and selected
differences. Elements are changed in memory, with as few changed attributes as possible; a
difference that cannot be written gets a reason.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

import mujoco
import numpy as np
import pinocchio as pin

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.arrays import (
    inertia_entries,
    make_placement,
    quaternion_from_rotation,
    rotation_from_quaternion,
)
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.models.conversion import inertia_of_body, joint_armature, joint_damping
from pupper_analysis.models.efforts import (
    find_effort,
    read_actuator_efforts,
    read_joint_effort,
)
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.transmission import actuator_gear, list_joint_actuators
from pupper_analysis.models.xml import parse_numbers
from pupper_analysis.models.xml_bytes import XmlElement
from pupper_analysis.robot.compare.differences import PropertyKey
from pupper_analysis.robot.servos import list_position_servos
from pupper_analysis.tools.sync.digits import (
    NUMBER_RTOL,
    format_numbers,
)
from pupper_analysis.tools.sync.frames import Side, is_same_body, list_single_part_changes
from pupper_analysis.tools.sync.mjcf_in_place import EditableMjcf

_NEW_INERTIAL_COST = 100
"""Additional cost of a change that adds an <inertial> to a body. The cost of a change is the number
of changed attributes, and the cheapest change is made. Chosen larger than the number of attributes
of an <inertial>.
"""

_ORIENTATION_ATTRIBUTES = ("axisangle", "euler", "xyaxes", "zaxis")
"""Orientation attributes of an <inertial> that cannot be rewritten. An <inertial> with such an
attribute is not changed.
"""


def plan_inertial(side: MjcfSide, mover: str, keys: list[PropertyKey]) -> None:
    """Plan the changes of <inertial> that give a group of bodies the target inertia.

    The bodies of a group are fixed to each other. At most one of them is changed.

    Args:
        side: MJCF with the target values; the plan is stored in its elements.
        mover: Joint that moves the group, or the base.
        keys: Differences (kind, element) of the group; recorded in ``side.unwritten`` if the change
            is refused.
    """
    keys = [key for key in keys if key[0] in ("mass", "com", "inertia")]
    model = side.model
    frame = side.sides.mjcf_frames[mover].inverse()
    targets = [frame.act(body.spatial_inertia) for body in side.list_body_targets(mover)]
    top = model.body(side.sides.matched.mjcf_body[mover]).id
    group = [b for b in range(1, model.nbody) if model.body_weldid[b] == model.body_weldid[top]]
    poses = {body: side.sides.bodies[str(model.body(body).name)] for body in group}
    inertias = {body: pose.act(inertia_of_body(model, body)) for body, pose in poses.items()}
    heavy_parts = {body: part for body, part in inertias.items() if part.mass > 0}
    if is_same_body(sum(heavy_parts.values(), pin.Inertia.Zero()), targets[0]):
        return
    plans = []
    for body, part in (
        way for target in targets for way in list_single_part_changes(heavy_parts, target, top)
    ):
        element = side.elements.find_body(str(model.body(body).name))
        if element is None:
            side.unwritten.update(dict.fromkeys(keys, COPIED_BODY))
            return
        inertial, cost = element.find("inertial"), 0
        if inertial is None:
            inertial = XmlElement("inertial", {}, element.file, -1, element.line, element)
            cost = _NEW_INERTIAL_COST
        if not any(word in inertial.attributes for word in _ORIENTATION_ATTRIBUTES):
            changes = make_inertial_changes(inertial, poses[body].actInv(part))
            plans.append((cost + len(changes), inertial, changes))
    if not plans:
        side.unwritten.update(dict.fromkeys(keys, diagnose("no-body-to-change")))
        return
    _, inertial, changes = min(plans, key=lambda plan: plan[0])
    if inertial.start < 0 and inertial.parent is not None:
        inertial.parent.children.insert(0, inertial)
    inertial.changes.update(changes)


def make_inertial_changes(element: XmlElement, target: pin.Inertia) -> dict[str, str]:
    """Compute the attributes of an ``<inertial>`` that must change to state a target inertia.

    The present form (principal moments with axes, or full matrix) is kept.

    Args:
        element: The ``<inertial>``.
        target: Inertia in the frame of the body [kg, m, kg m^2].

    Returns:
        {attribute: new text}.
    """
    numbers = {"pos": target.lever, "mass": target.mass}
    if element.get("diaginertia") is None:
        numbers["fullinertia"] = inertia_entries(target.inertia)
    else:
        numbers |= _make_principal_numbers(element, target.inertia)
    floors = {"pos": 1.0, "quat": 1.0}
    words = {
        name: format_numbers((element.get(name) or "").split(), value, floors.get(name, 0.0))
        for name, value in numbers.items()
    }
    return {name: text for name, text in words.items() if text is not None}


def _make_principal_numbers(element: XmlElement, target: Array) -> dict[str, Array]:
    """Return ``diaginertia`` (and ``quat``) of an <inertial> for a target tensor [kg m^2].

    ``target``, shape (3, 3), is in the axes of the body.
    """
    moments = parse_numbers(element.get("diaginertia"), "")
    stated_quat = parse_numbers(element.get("quat"), "1 0 0 0")
    stated_axes = rotation_from_quaternion(stated_quat / np.linalg.norm(stated_quat))
    size = float(np.abs(target).max())
    in_stated_axes = stated_axes.T @ target @ stated_axes
    if float(np.abs(in_stated_axes - np.diag(np.diag(in_stated_axes))).max()) <= 1e-11 * size:
        return {"diaginertia": np.diag(in_stated_axes)}
    values, axes = np.linalg.eigh(target)
    order = list(np.argsort(np.argsort(moments)))
    values, axes = values[order], axes[:, order]
    # Signs of the axes: as near as possible to the stated axes.
    axes = axes * np.where(np.sum(axes * stated_axes, axis=0) < 0, -1.0, 1.0)
    if np.linalg.det(axes) < 0:
        axes[:, int(np.argmin(np.abs(np.sum(axes * stated_axes, axis=0))))] *= -1
    quaternion = quaternion_from_rotation(axes)
    return {
        "diaginertia": values,
        "quat": -quaternion if float(quaternion @ stated_quat) < 0 else quaternion,
    }


COPIED_BODY = diagnose("body-is-a-copy")
"""Reason why a change of a body or its joint is not written to the MJCF: the file contains no
element of the body. For example, MuJoCo copies the body from another element.
"""


@dataclass(eq=False, kw_only=True)
class MjcfSide(Side):
    """MJCF that receives numbers: planner of the changes.

    Attributes:
        file: MJCF.
        elements: Elements of the MJCF.
        gains: {("kp" or "kd", joint): gain of the position servo, at the joint [N m/rad, N/m; N m
            s/rad, N s/m]}.
        robot: Matched robot.
        model: MuJoCo model of the robot.
    """

    file: MjcfFile
    elements: EditableMjcf
    gains: Mapping[PropertyKey, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.robot = self.sides.matched.robot
        self.model: mujoco.MjModel = self.robot.mj_model

    def plan(self, taken: Collection[PropertyKey]) -> None:
        """Plan the changes of the MJCF for selected differences and for `gains`, in memory.

        ``taken`` contains (kind, element) of each difference. The reason for a difference that
        cannot be written is recorded in `unwritten`.
        """
        for key in taken:
            if key[0] == "position":
                self._plan_position(key)
        for key in taken:
            kind, name = key
            if kind in ("lower limit", "upper limit"):
                self._plan_limits(key)
            elif kind == "effort":
                plan_effort(self, key)
            elif kind == "damping":
                self._plan_damping(key)
            elif kind == "friction":
                value = self.target.joints[name].friction
                self._plan_number(key, "frictionloss", [value])
            elif kind == "armature":
                self._plan_armature(key)
        for name in dict.fromkeys(joint for _, joint in self.gains):
            plan_gains(self, name, {key: k for key, k in self.gains.items() if key[1] == name})
        for name in dict.fromkeys(e for k, e in taken if k in ("mass", "com", "inertia")):
            plan_inertial(self, name, [key for key in taken if key[1] == name])

    def _compute_body_pose(self, body: int) -> pin.SE3:
        """Return the pose of a body in the frame of the moved body to which the body is fixed."""
        name = str(self.model.body(body).name)
        return pin.SE3.Identity() if body == 0 else self.sides.bodies[name]

    def _plan_position(self, key: PropertyKey) -> None:
        """Plan to move the body of a joint, with the child bodies, to the URDF's joint position.

        ``key`` is the difference (kind, joint).
        """
        name = key[1]
        index = self.model.joint(name).id
        body = int(self.model.jnt_bodyid[index])
        if index != int(self.model.body_jntadr[body]):
            self.unwritten[key] = diagnose("joint-shares-its-place")
            return
        if self.model.jnt_pos[index].any():
            self.unwritten[key] = diagnose("joint-off-its-body")
            return
        parent = self.sides.own.joints[name].parent
        parent_frame = self.sides.mjcf_frames[parent].inverse()
        frame = self._compute_body_pose(int(self.model.body_parentid[body]))
        old_pose = make_placement(self.model.body_quat[body], self.model.body_pos[body])
        joint = parent_frame * self.target.joints[name].placement * self.sides.mjcf_frames[name]
        own_placement = self.sides.own.joints[name].placement
        target_pose = frame.inverse() * joint * own_placement.inverse() * frame * old_pose
        element = self.elements.find_body(str(self.model.body(body).name))
        if element is None:
            self.unwritten[key] = COPIED_BODY
        elif self.elements.is_in_frame_element(element):
            self.unwritten[key] = diagnose("place-in-a-frame")
        elif (
            float(np.abs(np.array(target_pose.translation) - old_pose.translation).max())
            > NUMBER_RTOL
        ):
            self.elements.write(element, "pos", target_pose.translation, 1.0)

    def find_joint_element(self, name: str) -> XmlElement | None:
        """Return the XML element of a joint in the files of the MJCF; None if absent."""
        body = int(self.model.jnt_bodyid[self.model.joint(name).id])
        return self.elements.find_joint(name, str(self.model.body(body).name))

    def _plan_limits(self, key: PropertyKey) -> None:
        """Plan to set a joint's range in the MJCF to the limits of the URDF, in the file's unit.

        ``key`` is the difference (kind, joint).
        """
        name = key[1]
        element, joint = self.find_joint_element(name), self.target.joints[name]
        if element is None:
            self.unwritten[key] = COPIED_BODY
            return
        if not (math.isfinite(joint.lower) and math.isfinite(joint.upper)):
            self.unwritten[key] = diagnose("mjcf-one-limit-unwritten")
            return
        factor = 1.0 if joint.slides else self.elements.angle
        values = [joint.lower / factor, joint.upper / factor]
        index = self.model.joint(name).id
        limited = self.robot.description.mjcf.joint(name).limited
        auto = limited == mujoco.mjtLimited.mjLIMITED_AUTO.value and self.elements.autolimits
        if not (self.model.jnt_limited[index] or auto):
            self.elements.write(element, "limited", "true")
        self.elements.write(element, "range", values, 1.0)

    def _plan_damping(self, key: PropertyKey) -> None:
        """Plan to set the damping of a joint to the target, minus the damping of the actuators.

        Higher polynomial coefficients are kept. ``key`` is the difference (kind, joint).
        """
        name = key[1]
        if name not in self.target.joints:
            self.unwritten[key] = diagnose("base-without-joint")
            return
        index = self.model.joint(name).id
        dof = int(self.model.jnt_dofadr[index])
        of_joint = float(self.model.dof_damping[dof])
        of_motors = float(joint_damping(self.model)[dof]) - of_joint
        target = self.target.joints[name].damping - of_motors
        if target < 0:
            self.unwritten[key] = diagnose("motors-have-more")
            return
        element = self.find_joint_element(name)
        stated_higher = ([] if element is None else (element.get("damping") or "").split())[1:]
        higher = [float(word) for word in stated_higher]
        self._plan_number(key, "damping", [target, *higher])

    def _plan_armature(self, key: PropertyKey) -> None:
        """Plan to set the armature of a joint to the target, minus the armature of the actuators.

        ``key`` is the difference (kind, joint).
        """
        index = self.model.joint(key[1]).id
        dof = int(self.model.jnt_dofadr[index])
        of_joint = float(self.model.dof_armature[dof])
        of_motors = float(joint_armature(self.model)[dof]) - of_joint
        target = self.target.joints[key[1]].armature - of_motors
        if target < 0:
            self.unwritten[key] = diagnose("motors-have-more")
            return
        self._plan_number(key, "armature", [target])

    def _plan_number(self, key: PropertyKey, attribute: str, values: list[float]) -> None:
        """Plan to set an attribute of a joint's element in the MJCF to ``values`` in SI units.

        ``key`` is the difference (kind, joint).
        """
        element = self.find_joint_element(key[1])
        if element is None:
            self.unwritten[key] = COPIED_BODY
            return
        self.elements.write(element, attribute, values)


# Gains of position servos, in the attributes that the MJCF uses.


def plan_gains(side: MjcfSide, name: str, target_gains: dict[PropertyKey, float]) -> None:
    """Plan the changes of the MJCF that give a joint's servo the target gains.

    Gains that cannot be written are recorded in ``side.unwritten``, with the reason.

    Args:
        side: MJCF.
        name: Name of the joint.
        target_gains: Target gains at the joint: {("kp", joint): stiffness [N m/rad, N/m], ("kd",
            joint): damping [N m s/rad, N s/m]}.
    """
    model = side.model
    actuators = list_joint_actuators(model, model.joint(name).id)
    elements = side.elements.find_actuators(name)
    old_gains = list_position_servos(side.robot).get(name)
    if old_gains is None or len(actuators) != 1:
        side.unwritten.update(dict.fromkeys(target_gains, diagnose("joint-without-one-servo")))
        return
    if len(elements) != 1:
        side.unwritten.update(dict.fromkeys(target_gains, diagnose("actuators-are-copies")))
        return
    squared = float(actuator_gear(model, actuators[0])[0]) ** 2
    stiffness = target_gains.get(("kp", name), old_gains[0]) / squared
    damping = target_gains.get(("kd", name), old_gains[1]) / squared
    (element,) = elements
    if element.tag == "position":
        _plan_position_servo(side, element, name, target_gains, stiffness, damping)
    elif element.tag == "general":
        gain = _keep_trailing_parameters(element, "gainprm", [stiffness])
        side.elements.write(element, "gainprm", gain)
        side.elements.write(
            element,
            "biasprm",
            _keep_trailing_parameters(element, "biasprm", [0, -stiffness, -damping]),
        )
    else:
        message = diagnose("servo-without-words", tag=element.tag)
        side.unwritten.update(dict.fromkeys(target_gains, message))


def _plan_position_servo(
    side: MjcfSide,
    element: XmlElement,
    name: str,
    target_gains: dict[PropertyKey, float],
    stiffness: float,
    damping: float,
) -> None:
    """Plan the changes of the attributes ``kp`` and ``kv`` of a <position> actuator.

    ``target_gains`` is {("kp" or "kd", joint): gain}; ``stiffness`` and ``damping`` are divided by
    the square of the gear.
    """
    if ("kp", name) in target_gains:
        side.elements.write(element, "kp", stiffness)
    if ("kd", name) in target_gains:
        text = format_numbers((element.get("kv") or "").split(), damping)
        if text is not None:  # kv replaces dampratio
            element.rename_or_set("dampratio", "kv", text)


def _keep_trailing_parameters(
    element: XmlElement, attribute: str, values: list[float]
) -> list[float]:
    """Return ``values``, followed by the later numbers of the attribute in the file."""
    old_values = [float(word) for word in (element.get(attribute) or "").split()]
    return [*values, *old_values[len(values) :]]


# Torque limit of a joint, in the attributes that state it.


def plan_effort(side: MjcfSide, key: PropertyKey) -> None:
    """Plan the changes of the MJCF that give a joint the target torque limit.

    The present limit is the smallest of the stated bounds, for example of joint and actuator. If
    the limit cannot be written, the reason is recorded in ``side.unwritten``.

    Args:
        side: MJCF.
        key: Difference: ("effort", joint).
    """
    name, model = key[1], side.model
    target = side.target.joints[name].effort
    joint = model.joint(name).id
    element = side.find_joint_element(name)
    actuators, motors = list_joint_actuators(model, joint), side.elements.find_actuators(name)
    if element is None or len(motors) != len(actuators):
        side.unwritten[key] = diagnose("actuators-are-copies")
        return
    if len(actuators) > 1:
        side.unwritten[key] = diagnose("actuators-share-it")
        return
    stated_limits = [(element, limit) for limit in read_joint_effort(model, joint)]
    for motor, actuator in zip(motors, actuators, strict=True):
        stated_limits += [
            (motor, limit) for limit in read_actuator_efforts(model, actuator) if limit.factor
        ]
    old_effort = find_effort(model, joint)
    for owner, limit in stated_limits:
        # A bound looser than the smallest one is kept, unless it is below the target.
        differs = abs(limit.effort - target) > NUMBER_RTOL * max(target, limit.effort)
        if differs and (limit.effort < target or limit.effort <= old_effort * (1 + NUMBER_RTOL)):
            value, bounds = target / abs(limit.factor), np.array(limit.stated)
            pair = bounds * (value / float(np.abs(bounds).max()))  # of one direction only
            is_two_sided = limit.symmetric_torque > 0
            side.elements.write(owner, limit.attribute, [-value, value] if is_two_sided else pair)
    null = side.robot.description.null_efforts.get(name)
    if null is not None:  # a range with equal or inverted ends, which the compiled model lacks
        owner, factor = element, 1.0
        if null.element == "actuator":
            owner, factor = motors[0], float(actuator_gear(model, actuators[0])[0])
            if null.attribute == "ctrlrange":
                factor *= float(model.actuator_gainprm[actuators[0], 0])
        value = target / abs(factor)
        side.elements.write(owner, null.attribute, [-value, value])
    elif not stated_limits:
        side.elements.write(element, "actuatorfrcrange", [-target, target])
        limited = side.robot.description.mjcf.joint(name).actfrclimited
        automatic = limited == mujoco.mjtLimited.mjLIMITED_AUTO.value and side.elements.autolimits
        if limited != mujoco.mjtLimited.mjLIMITED_TRUE.value and not automatic:
            side.elements.write(element, "actuatorfrclimited", "true")
