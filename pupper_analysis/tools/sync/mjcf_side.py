"""Writes numbers into an MJCF, and into what it includes; masses into inertials or geoms."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.base.arrays import (
    inertia_entries,
    make_placement,
    quaternion_from_rotation,
    rotation_from_quaternion,
)
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.models.conversion import inertia_of_body, joint_armature, joint_damping
from pupper_analysis.models.efforts import (
    find_max_effort,
    read_actuator_efforts,
    read_joint_effort,
)
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.transmission import actuator_gear, list_joint_actuators
from pupper_analysis.models.xml import parse_numbers
from pupper_analysis.robot.servos import list_position_servos
from pupper_analysis.tools.sync.digits import (
    NUMBER_RTOL,
    format_numbers,
)
from pupper_analysis.tools.sync.frames import Key, Side, is_same_body, list_single_part_changes
from pupper_analysis.tools.sync.mjcf_in_place import EditableMjcf
from pupper_analysis.tools.sync.xml_bytes import Element

Array = NDArray[np.float64]

_NEW_INERTIAL_COST = 100
"""What a new <inertial> counts, in attributes: any change of what is there goes before it."""

_AXES = ("axisangle", "euler", "xyaxes", "zaxis")
"""Words for the axes of an <inertial> that are not written."""


def plan_inertial(side: MjcfSide, mover: str, keys: list[Key]) -> None:
    """Notes the changes that give what moves with a joint, or the base, another mass."""
    keys = [key for key in keys if key[0] in ("mass", "com", "inertia")]
    model = side.model
    wanted = side.sides.mjcf_frames[mover].actInv(side.target.bodies[mover].rigid)
    top = model.body(side.sides.matched.mjcf_body[mover]).id
    group = [b for b in range(1, model.nbody) if model.body_weldid[b] == model.body_weldid[top]]
    poses = {body: side.sides.bodies[str(model.body(body).name)] for body in group}
    placed = {body: pose.act(inertia_of_body(model, body)) for body, pose in poses.items()}
    heavy = {body: part for body, part in placed.items() if part.mass > 0}
    if is_same_body(sum(heavy.values(), pin.Inertia.Zero()), wanted):
        return
    plans = []
    for body, part in list_single_part_changes(heavy, wanted, top):
        element = side.elements.body(str(model.body(body).name))
        if element is None:
            side.unwritten.update(dict.fromkeys(keys, COPIED_BODY))
            return
        inertial, cost = element.find("inertial"), 0
        if inertial is None:
            inertial = Element("inertial", {}, element.file, -1, element.line, element)
            cost = _NEW_INERTIAL_COST
        if not any(word in inertial.attributes for word in _AXES):
            changes = make_inertial_changes(inertial, poses[body].actInv(part))
            plans.append((cost + len(changes), inertial, changes))
    if not plans:
        side.unwritten.update(dict.fromkeys(keys, diagnose("no-body-to-change")))
        return
    _, inertial, changes = min(plans, key=lambda plan: plan[0])
    if inertial.start < 0 and inertial.parent is not None:
        inertial.parent.children.insert(0, inertial)
    inertial.changes.update(changes)


def make_inertial_changes(element: Element, wanted: pin.Inertia) -> dict[str, str]:
    """Returns the fewest changes by which an <inertial> states a mass, in the form that it has."""
    numbers = {"pos": wanted.lever, "mass": wanted.mass}
    if element.get("diaginertia") is None:
        numbers["fullinertia"] = inertia_entries(wanted.inertia)
    else:
        numbers |= _principal(element, wanted.inertia)
    floors = {"pos": 1.0, "quat": 1.0}
    words = {
        name: format_numbers((element.get(name) or "").split(), value, floors.get(name, 0.0))
        for name, value in numbers.items()
    }
    return {name: text for name, text in words.items() if text is not None}


def _principal(element: Element, wanted: Array) -> dict[str, Array]:
    """Returns the principal moments, and their axes if they are others than are stated."""
    moments = parse_numbers(element.get("diaginertia"), "")
    stated = parse_numbers(element.get("quat"), "1 0 0 0")
    own = rotation_from_quaternion(stated / np.linalg.norm(stated))
    size = float(np.abs(wanted).max())
    inside = own.T @ wanted @ own
    if float(np.abs(inside - np.diag(np.diag(inside))).max()) <= 1e-11 * size:
        return {"diaginertia": np.diag(inside)}
    values, axes = np.linalg.eigh(wanted)
    order = list(np.argsort(np.argsort(moments)))
    values, axes = values[order], axes[:, order]
    # Of the axes and their opposites, those near to the file's own.
    axes = axes * np.where(np.sum(axes * own, axis=0) < 0, -1.0, 1.0)
    if np.linalg.det(axes) < 0:
        axes[:, int(np.argmin(np.abs(np.sum(axes * own, axis=0))))] *= -1
    quaternion = quaternion_from_rotation(axes)
    return {
        "diaginertia": values,
        "quat": -quaternion if float(quaternion @ stated) < 0 else quaternion,
    }


COPIED_BODY = diagnose("body-is-a-copy")


@dataclass(eq=False, kw_only=True)
class MjcfSide(Side):
    """An MJCF that gets numbers of a URDF.

    Attributes:
        file: The file.
        elements: Its elements.
        gains: {("kp" or "kd", joint): of its position servo, at the joint (N m/rad, N m s/rad)}.
    """

    file: MjcfFile
    elements: EditableMjcf
    gains: Mapping[Key, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.robot = self.sides.matched.robot
        self.model: mujoco.MjModel = self.robot.mj_model

    def plan(self, taken: Collection[Key]) -> None:
        """Notes all changes in the documents: places first, for what is on them moves along."""
        for key in taken:
            if key[0] == "position":
                self._place(key)
        for key in taken:
            kind, name = key
            if kind in ("lower limit", "upper limit"):
                self._limits(key)
            elif kind == "effort":
                plan_effort(self, key)
            elif kind == "damping":
                self._damping(key)
            elif kind == "friction":
                value = self.target.joints[name].friction
                self._number(key, "frictionloss", [value])
            elif kind == "armature":
                self._armature(key)
        for name in dict.fromkeys(joint for _, joint in self.gains):
            plan_gains(self, name, {key: k for key, k in self.gains.items() if key[1] == name})
        for name in dict.fromkeys(e for k, e in taken if k in ("mass", "com", "inertia")):
            plan_inertial(self, name, [key for key in taken if key[1] == name])

    def _body_pose(self, body: int) -> pin.SE3:
        """Returns where a body is in the frame of the body that a joint moves."""
        name = str(self.model.body(body).name)
        return pin.SE3.Identity() if body == 0 else self.sides.bodies[name]

    def _place(self, key: Key) -> None:
        """Moves the body of a joint, with all that is on it."""
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
        before = self.sides.mjcf_frames[parent].inverse()
        frame = self._body_pose(int(self.model.body_parentid[body]))
        now = make_placement(self.model.body_quat[body], self.model.body_pos[body])
        joint = before * self.target.joints[name].placement * self.sides.mjcf_frames[name]
        own = self.sides.own.joints[name].placement
        wanted = frame.inverse() * joint * own.inverse() * frame * now
        element = self.elements.body(str(self.model.body(body).name))
        if element is None:
            self.unwritten[key] = COPIED_BODY
        elif self.elements.is_framed(element):
            self.unwritten[key] = diagnose("place-in-a-frame")
        elif float(np.abs(np.array(wanted.translation) - now.translation).max()) > NUMBER_RTOL:
            self.elements.write(element, "pos", wanted.translation, 1.0)

    def joint_in_file(self, name: str) -> Element | None:
        """Returns the element of a joint."""
        body = int(self.model.jnt_bodyid[self.model.joint(name).id])
        return self.elements.joint(name, str(self.model.body(body).name))

    def _limits(self, key: Key) -> None:
        name = key[1]
        element, joint = self.joint_in_file(name), self.target.joints[name]
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

    def _damping(self, key: Key) -> None:
        name = key[1]
        if name not in self.target.joints:
            self.unwritten[key] = diagnose("base-without-joint")
            return
        index = self.model.joint(name).id
        dof = int(self.model.jnt_dofadr[index])
        of_joint = float(self.model.dof_damping[dof])
        of_motors = float(joint_damping(self.model)[dof]) - of_joint
        wanted = self.target.joints[name].damping - of_motors
        if wanted < 0:
            self.unwritten[key] = diagnose("motors-have-more")
            return
        element = self.joint_in_file(name)
        stated = ([] if element is None else (element.get("damping") or "").split())[1:]
        higher = [float(word) for word in stated]
        self._number(key, "damping", [wanted, *higher])

    def _armature(self, key: Key) -> None:
        index = self.model.joint(key[1]).id
        dof = int(self.model.jnt_dofadr[index])
        of_joint = float(self.model.dof_armature[dof])
        of_motors = float(joint_armature(self.model)[dof]) - of_joint
        wanted = self.target.joints[key[1]].armature - of_motors
        if wanted < 0:
            self.unwritten[key] = diagnose("motors-have-more")
            return
        self._number(key, "armature", [wanted])

    def _number(self, key: Key, attribute: str, values: list[float]) -> None:
        element = self.joint_in_file(key[1])
        if element is None:
            self.unwritten[key] = COPIED_BODY
            return
        self.elements.write(element, attribute, values)


# Writes the gains of position servos into an MJCF, in the words in which it states them.


def plan_gains(side: MjcfSide, name: str, wanted: dict[Key, float]) -> None:
    """Notes the changes that give the servo of a joint other gains.

    Args:
        side: The MJCF.
        name: The joint.
        wanted: {("kp", joint): stiffness at the joint (N m/rad), ("kd", joint): damping there}.
    """
    model = side.model
    drives = list_joint_actuators(model, model.joint(name).id)
    elements = side.elements.find_actuators(name)
    now = list_position_servos(side.robot).get(name)
    if now is None or len(drives) != 1:
        side.unwritten.update(dict.fromkeys(wanted, diagnose("joint-without-one-servo")))
        return
    if len(elements) != 1:
        side.unwritten.update(dict.fromkeys(wanted, diagnose("actuators-are-copies")))
        return
    squared = float(actuator_gear(model, drives[0])[0]) ** 2
    stiffness = wanted.get(("kp", name), now[0]) / squared
    damping = wanted.get(("kd", name), now[1]) / squared
    (element,) = elements
    if element.tag == "position":
        _position(side, element, name, wanted, stiffness, damping)
    elif element.tag == "general":
        gain = _padded(element, "gainprm", [stiffness])
        side.elements.write(element, "gainprm", gain)
        side.elements.write(
            element, "biasprm", _padded(element, "biasprm", [0, -stiffness, -damping])
        )
    else:
        message = diagnose("servo-without-words", tag=element.tag)
        side.unwritten.update(dict.fromkeys(wanted, message))


def _position(
    side: MjcfSide,
    element: Element,
    name: str,
    wanted: dict[Key, float],
    stiffness: float,
    damping: float,
) -> None:
    if ("kp", name) in wanted:
        side.elements.write(element, "kp", stiffness)
    if ("kd", name) in wanted:
        text = format_numbers((element.get("kv") or "").split(), damping)
        if text is not None:  # a ratio of damping gives way to a damping
            element.rename_or_set("dampratio", "kv", text)


def _padded(element: Element, attribute: str, values: list[float]) -> list[float]:
    """Returns the parameters of an actuator with those behind them that the file states."""
    stated = [float(word) for word in (element.get(attribute) or "").split()]
    return [*values, *stated[len(values) :]]


# Writes the greatest torque of a joint into an MJCF: where it is stated, in whichever words.


def plan_effort(side: MjcfSide, key: Key) -> None:
    """Notes the changes that give a joint another greatest torque.

    It is the least of what the joint's ``actuatorfrcrange``, the actuator's ``forcerange`` and the
    ``ctrlrange`` of a plain motor allow: whichever is stated and is not right, is changed.
    """
    name, model = key[1], side.model
    wanted = side.target.joints[name].effort
    joint = model.joint(name).id
    element = side.joint_in_file(name)
    drives, motors = list_joint_actuators(model, joint), side.elements.find_actuators(name)
    if element is None or len(motors) != len(drives):
        side.unwritten[key] = diagnose("actuators-are-copies")
        return
    if len(drives) > 1:
        side.unwritten[key] = diagnose("actuators-share-it")
        return
    stated = [(element, one) for one in read_joint_effort(model, joint)]
    for motor, drive in zip(motors, drives, strict=True):
        stated += [(motor, one) for one in read_actuator_efforts(model, drive) if one.factor]
    now = find_max_effort(model, joint)
    for owner, one in stated:
        # What is looser than the least bound does no harm, unless it is below what is wanted.
        off = abs(one.greatest - wanted) > NUMBER_RTOL * max(wanted, one.greatest)
        if off and (one.greatest < wanted or one.greatest <= now * (1 + NUMBER_RTOL)):
            value, ends = wanted / abs(one.factor), np.array(one.stated)
            pair = ends * (value / float(np.abs(ends).max()))  # one-sided ranges keep their shape
            symmetric = abs(ends.sum()) <= NUMBER_RTOL
            side.elements.write(owner, one.attribute, [-value, value] if symmetric else pair)
    null = side.robot.description.null_efforts.get(name)
    if null is not None:  # a range from 0 to 0, which the compiled model lacks
        owner, factor = element, 1.0
        if null.element == "actuator":
            owner, factor = motors[0], float(actuator_gear(model, drives[0])[0])
            if null.attribute == "ctrlrange":
                factor *= float(model.actuator_gainprm[drives[0], 0])
        value = wanted / abs(factor)
        side.elements.write(owner, null.attribute, [-value, value])
    elif not stated:
        side.elements.write(element, "actuatorfrcrange", [-wanted, wanted])
        limited = side.robot.description.mjcf.joint(name).actfrclimited
        automatic = limited == mujoco.mjtLimited.mjLIMITED_AUTO.value and side.elements.autolimits
        if limited != mujoco.mjtLimited.mjLIMITED_TRUE.value and not automatic:
            side.elements.write(element, "actuatorfrclimited", "true")
