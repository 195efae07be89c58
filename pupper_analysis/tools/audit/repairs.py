"""Repairs of findings: the values of a file that would pass, and the reason.

A repair replaces attributes of a single element. A finding has one repair if the right value is
known, several candidates if a few values are possible, and none otherwise. The new value is
derived from the mirrored element or from the joint of an actuator, or it is the old value with
another unit or decimal point.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping
from typing import Final

import mujoco
import numpy as np
from lxml import etree

from pupper_analysis.base.arrays import INERTIA_ENTRIES
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.models.loading import CheckFinding
from pupper_analysis.models.sides import find_mirror_pairs
from pupper_analysis.models.stated.model import Array, Link, MjcfModel, RobotModel, UrdfModel
from pupper_analysis.tools.audit.registry import ValueRepair
from pupper_analysis.tools.audit.rules.mirror import find_mirror_plane, list_joint_pairs


def find_repairs(robot: RobotModel, rule: str, found: CheckFinding) -> tuple[ValueRepair, ...]:
    """Return the attribute values that would remove a finding: one repair, candidates, or none.

    Args:
        robot: Model of the file.
        rule: Id of the rule.
        found: Finding of the check of the rule.
    """
    propose = _PROPOSALS.get(rule)
    return () if propose is None else tuple(propose(robot, found))


def _make_urdf_repair(
    robot: UrdfModel, tag: str, name: str, child: str, new: Mapping[str, str], reason: Diagnostic
) -> Iterator[ValueRepair]:
    """Yield the repair of an element of a URDF: new values of its attributes.

    The element is the ``child`` of the link or joint (``tag``) with this ``name``. Nothing is
    yielded if no or several elements fit, or if the element lacks one of the attributes or already
    has the new values.
    """
    element = _find_element(robot, tag, name, child)
    if element is None or any(element.get(attribute) is None for attribute in new):
        return
    old = {attribute: str(element.get(attribute)) for attribute in new}
    if old != dict(new):
        yield ValueRepair(str(robot.file.path), tag, name, child, old, dict(new), reason)


def _find_element(robot: UrdfModel, tag: str, name: str, child: str) -> etree._Element | None:
    """Return the element ``child`` of a link or joint; None if absent or the name is not unique."""
    found = [one for one in robot.file.root.iterfind(tag) if one.get("name") == name]
    return found[0].find(child) if len(found) == 1 else None


def _format_value(value: float) -> str:
    """Format a converted number with at most six digits."""
    return f"{value:.6g}"


def _repair_limits_in_degrees(robot: RobotModel, found: CheckFinding) -> Iterator[ValueRepair]:
    """Convert limits of a URDF from degrees to radians."""
    if isinstance(robot, UrdfModel) and found.message.code == "limits-look-like-degrees":
        joint = robot.joints[found.name]
        ends = {"lower": joint.lower, "upper": joint.upper}
        new = {word: _format_value(math.radians(value)) for word, value in ends.items()}
        reason = diagnose("repair-degrees-to-radians")
        yield from _make_urdf_repair(robot, "joint", found.name, "limit", new, reason)


def _repair_command_range(robot: RobotModel, found: CheckFinding) -> Iterator[ValueRepair]:
    """Replace a command range in degrees by the range of the joint.

    Nothing is proposed for a servo with a gear, or with a gain other than the stiffness: the unit
    of the command is then not the unit of the joint position.
    """
    if not isinstance(robot, MjcfModel) or robot.mj_model is None:
        return
    model = robot.mj_model
    servo = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_ACTUATOR, found.name)
    if servo < 0 or model.actuator_gear[servo, 0] != 1:
        return
    if model.actuator_gainprm[servo, 0] != -model.actuator_biasprm[servo, 1]:
        return
    ends = [found.message.values[word].value for word in ("lower", "upper")]  # type: ignore[union-attr]
    matches = [
        (tag, attributes, place)
        for tag in ("position", "general")
        for attributes, place in robot.file.elements(tag)
        if attributes.get("name") == found.name and "ctrlrange" in attributes
    ]
    if len(matches) == 1:
        ((tag, attributes, place),) = matches
        old, new = attributes["ctrlrange"], " ".join(map(_format_value, ends))
        reason = diagnose("repair-range-of-joint", joint=str(found.message.values["joint"]))
        values = {"ctrlrange": old}, {"ctrlrange": new}
        yield ValueRepair(str(place.file), tag, found.name, "", *values, reason)


def _repair_effort(robot: RobotModel, found: CheckFinding) -> Iterator[ValueRepair]:
    """Yield the repair of a zero or negative effort of a URDF: the effort of the mirrored joint."""
    effort = robot.joints[found.name].stated.get("effort")
    if not isinstance(robot, UrdfModel) or effort is None or effort > 0:
        return
    for _, first, second in list_joint_pairs(robot):
        for joint, twin in ((first, second), (second, first)):
            if joint.name == found.name and 0 < twin.stated.get("effort", 0.0) < math.inf:
                limit = _find_element(robot, "joint", twin.name, "limit")
                new = {"effort": "" if limit is None else str(limit.get("effort"))}
                reason = diagnose("repair-of-twin", other=twin.name)
                yield from _make_urdf_repair(robot, "joint", joint.name, "limit", new, reason)


_LIMB_SHORT_NAMES: Final = ("fl", "fr", "rl", "rr", "hl", "hr", "bl", "br", "lf", "rf", "lh", "rh")
"""Two-letter names of limbs: front, rear, hind or back, and left or right."""
_SIDE_TOKENS: Final = frozenset(
    {*_LIMB_SHORT_NAMES, "l", "r", "lr", "left", "right", "front", "rear", "hind", "back", "middle"}
)
"""Words in names that distinguish limbs. `strip_sides` removes these words from names to find the
equal links or joints of several limbs."""


def strip_sides(name: str) -> str:
    """Return a name in lower case without the words that distinguish limbs.

    Underscores, hyphens, points, spaces and capitals separate words; underscores join the others:
    ``FL_calf`` becomes ``calf``.
    """
    words = re.split(r"[_\-. ]+", re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower())
    return "_".join(word for word in words if word not in _SIDE_TOKENS)


MIN_SIBLINGS = 2
"""Smallest number of further limbs whose equal value decides which of two mirrored links or joints
has the wrong value. Chosen, not tuned."""


def _repair_mirrored_mass(robot: RobotModel, found: CheckFinding) -> Iterator[ValueRepair]:
    """Yield the repairs of the masses of two mirrored links (`_repair_number`)."""
    if isinstance(robot, UrdfModel):
        partner = str(found.message.values["other"])
        yield from _repair_number(
            robot, (found.name, partner), "link", "inertial/mass", "value",
            {name: link.mass for name, link in robot.links.items() if link.mass},
        )  # fmt: skip


def _repair_mirrored_effort(robot: RobotModel, found: CheckFinding) -> Iterator[ValueRepair]:
    """Yield the repairs of the efforts of two mirrored joints of a URDF (`_repair_number`)."""
    if isinstance(robot, UrdfModel) and found.message.code == "mirror-effort":
        partner = str(found.message.values["other"])
        efforts = {
            name: joint.stated["effort"]
            for name, joint in robot.joints.items()
            if "effort" in joint.stated
        }
        yield from _repair_number(robot, (found.name, partner), "joint", "limit", "effort", efforts)


def _repair_number(
    robot: UrdfModel,
    pair: tuple[str, str],
    tag: str,
    child: str,
    attribute: str,
    values: Mapping[str, float],
) -> Iterator[ValueRepair]:
    """Yield repairs of a number that differs between two mirrored links or joints, the partners.

    If at least `MIN_SIBLINGS` other limbs have the same number, only a partner that deviates from
    it gets the number of the other partner; there is no repair if both or neither deviate. If the
    other limbs are fewer or disagree, there are two candidates: each partner with the number of the
    other. Only positive numbers are proposed.

    Args:
        robot: Model of the URDF.
        pair: Names of both partners.
        tag: Tag of the partners.
        child: Path to the element with the number.
        attribute: Attribute with the number.
        values: {name: number} of all links or all joints.
    """
    kind = strip_sides(pair[0])
    others = [
        value for name, value in values.items() if name not in pair and strip_sides(name) == kind
    ]
    agreeing = len(others) >= MIN_SIBLINGS and np.allclose(others, others[0], rtol=1e-3)
    wrong = [
        name
        for name in pair
        if agreeing and not math.isclose(values.get(name, math.nan), others[0], rel_tol=0.01)
    ]
    targets = wrong if len(wrong) == 1 else pair if not agreeing else ()
    for name in targets:
        other = pair[1] if name == pair[0] else pair[0]
        source = _find_element(robot, tag, other, child)
        if source is not None and source.get(attribute) is not None and values.get(other, 0) > 0:
            new = {attribute: str(source.get(attribute))}
            reason = (
                diagnose("repair-of-siblings", other=other, count=len(others))
                if agreeing
                else diagnose("repair-of-twin", other=other)
            )
            yield from _make_urdf_repair(robot, tag, name, child, new, reason)


def _repair_tensor(robot: RobotModel, found: CheckFinding) -> Iterator[ValueRepair]:
    """Yield the possible repairs of an inertia tensor of a URDF.

    These are the tensor with one decimal point moved, and the mirror image of the tensor of the
    link on the other side. If exactly one moved decimal point agrees with the mirror image, only
    this repair is yielded.
    """
    if not isinstance(robot, UrdfModel):
        return
    moved, mirrored = (
        list(candidates(robot, found.name)) for candidates in (_move_decimal_points, _mirror_tensor)
    )
    confirmed = [
        repair
        for repair in moved
        if mirrored
        and all(
            math.isclose(float(text), float(mirrored[0].new[word]), rel_tol=_MIRROR_RTOL)
            for word, text in repair.new.items()
        )
    ]
    yield from confirmed if len(confirmed) == 1 else (*moved, *mirrored)


_MIRROR_RTOL = 0.02
"""Largest relative difference with which two repairs of an inertia tensor agree: a moved decimal
point, and the mirror image of the tensor on the other side. If both agree, only the moved decimal
point is proposed. Chosen, not tuned."""


MAX_DECIMAL_SHIFT = 6
"""Largest number of places by which a repair moves the decimal point of a moment of inertia.
Chosen: a larger factor, such as 1e9 for g mm^2, is a wrong unit, and concerns all moments of a
tensor instead of one."""


def _move_decimal_points(robot: UrdfModel, name: str) -> Iterator[ValueRepair]:
    """Yield repairs of a nearly diagonal tensor: one moment is multiplied by a power of ten.

    Only tensors that satisfy the triangle inequality are yielded.
    """
    element = _find_element(robot, "link", name, "inertial/inertia")
    words = ("ixx", "iyy", "izz")
    if element is None or any(element.get(word) is None for word in words):
        return
    moments = [float(str(element.get(word))) for word in words]
    products = [float(element.get(word) or 0.0) for word in ("ixy", "ixz", "iyz")]
    if np.abs(products).max() > 0.01 * np.abs(moments).max() or min(moments) <= 0:
        return
    for place, word in enumerate(words):
        for shift in range(-MAX_DECIMAL_SHIFT, MAX_DECIMAL_SHIFT + 1):
            changed = [*moments]
            changed[place] *= 10.0**shift
            smallest, middle, largest = sorted(changed)
            if shift and smallest + middle >= largest:
                new = {word: _format_value(changed[place])}
                reason = diagnose("repair-decimal-point", shift=shift)
                yield from _make_urdf_repair(robot, "link", name, "inertial/inertia", new, reason)


def _mirror_tensor(robot: UrdfModel, name: str) -> Iterator[ValueRepair]:
    """Yield a repair that replaces a link's inertia tensor by the mirrored tensor of the twin link.

    Nothing if there is no twin on the other side, if the twin's tensor is physically impossible, or
    if the masses differ by more than 1 %.
    """
    mirror = find_mirror_plane(robot)
    twin = None if mirror is None else _find_twin(robot, name)
    link = robot.links[name]
    if mirror is None or twin is None or link.inertial is None or twin.inertial is None:
        return
    smallest, middle, largest = twin.inertial.moments
    is_possible = smallest > 0 and smallest + middle >= largest * (1 - 1e-5)
    if not is_possible or not math.isclose(link.mass, twin.mass, rel_tol=0.01):
        return
    turn = robot.file.tree.links[name].inertial_rotation
    in_base = mirror.matrix @ _rotate(twin.inertial.inertia, twin.pose.rotation) @ mirror.matrix
    tensor = _rotate(in_base, (link.pose.rotation @ turn).T)
    scale = float(np.abs(tensor).max())
    new = {
        word: _format_value(0.0 if abs(tensor[index]) < 1e-9 * scale else float(tensor[index]))
        for word, index in INERTIA_ENTRIES.items()
    }
    reason = diagnose("repair-mirrored", other=twin.name)
    yield from _make_urdf_repair(robot, "link", name, "inertial/inertia", new, reason)


def _find_twin(robot: RobotModel, name: str) -> Link | None:
    """Return the mirrored link of a link; None without one."""
    for first, second in find_mirror_pairs(robot.links):
        if name in (first, second):
            return robot.links[second if name == first else first]
    return None


def _rotate(tensor: Array, rotation: Array) -> Array:
    """Rotate a tensor, shape (3, 3): R T R^T."""
    rotated: Array = rotation @ tensor @ rotation.T
    return rotated


_PROPOSALS: Final[Mapping[str, Callable[[RobotModel, CheckFinding], Iterator[ValueRepair]]]] = {
    "limits-in-wrong-unit": _repair_limits_in_degrees,
    "command-range-in-degrees": _repair_command_range,
    "effort-or-velocity-zero": _repair_effort,
    "effort-negative": _repair_effort,
    "mirror-mass": _repair_mirrored_mass,
    "mirror-limits": _repair_mirrored_effort,
    "triangle-inequality": _repair_tensor,
    "inertia-not-positive-definite": _repair_tensor,
}
"""{rule: function that proposes repairs of its findings}."""
