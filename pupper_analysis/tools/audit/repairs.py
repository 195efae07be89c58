"""Repairs of findings: new values of a file that should pass, and the reason.

A repair replaces or adds attributes of elements, and may add the elements. A finding has a single
repair if only a single value is proposed, several candidates if a few values are possible, and
otherwise no repair. The rule is not run again with the new values. The new value is, for example,
derived from the mirrored element, from equal limbs or from the joint of an actuator. The new value
may also be the old value with another unit or decimal point.
"""

from __future__ import annotations

import functools
import math
import operator
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final

import mujoco
import numpy as np
import pinocchio as pin
from lxml import etree

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.arrays import INERTIA_ENTRIES
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, Term, diagnose
from pupper_analysis.models.loading import CheckFinding
from pupper_analysis.models.shapes import Pose
from pupper_analysis.models.sides import find_mirror_pairs, strip_sides
from pupper_analysis.models.stated.model import Link, MjcfModel, RobotModel, UrdfModel
from pupper_analysis.tools.audit.registry import (
    ValueRepair,
    compute_hull_distance,
    list_known_points,
    list_link_points,
)
from pupper_analysis.tools.audit.rules.mirror import (
    MIN_SIBLINGS,
    POSITION_TOLERANCE,
    MirrorPlane,
    find_mirror_plane,
    get_com_tolerance,
    list_joint_pairs,
    select_deviating_pairs,
)
from pupper_analysis.tools.audit.rules.shapes import (
    MAX_DENSITY,
    MIN_DENSITY,
    compute_median_density,
)


def find_repairs(robot: RobotModel, rule: str, found: CheckFinding) -> tuple[ValueRepair, ...]:
    """Propose new attribute values that should remove a finding of a rule.

    Args:
        robot: Model of the file.
        rule: Id of the rule.
        found: Finding of the check of the rule.

    Returns:
        A single repair if unique, otherwise several candidates; empty without a proposal.
    """
    propose = _PROPOSALS.get(rule)
    return () if propose is None else tuple(propose(robot, found))


def _make_urdf_repair(
    robot: UrdfModel, tag: str, name: str, child: str, new: Mapping[str, str], reason: Diagnostic
) -> Iterator[ValueRepair]:
    """Yield at most one repair that sets existing attributes of an element of a URDF.

    The element is at the path ``child`` below the link or joint (``tag``) with the name ``name``.
    """
    element = _find_unique_child(robot, tag, name, child)
    if element is None or any(element.get(attribute) is None for attribute in new):
        return
    old = {attribute: str(element.get(attribute)) for attribute in new}
    if old != dict(new):
        yield ValueRepair(str(robot.file.path), tag, name, child, old, dict(new), reason)


def _make_change(
    robot: UrdfModel, name: str, child: str, new: Mapping[str, str], reason: Diagnostic
) -> ValueRepair | None:
    """Return the change of an element below a link of a URDF; None if the values are equal."""
    element = _find_unique_child(robot, "link", name, child)
    old = {word: "" if element is None else str(element.get(word) or "") for word in new}
    if old == dict(new):
        return None
    return ValueRepair(str(robot.file.path), "link", name, child, old, dict(new), reason)


def _join_changes(changes: Iterable[ValueRepair | None]) -> Iterator[ValueRepair]:
    """Yield a single repair that consists of several changes; nothing without a change."""
    found = [change for change in changes if change is not None]
    if found:
        yield replace(found[0], further=tuple(found[1:]))


def _find_unique_child(robot: UrdfModel, tag: str, name: str, child: str) -> etree._Element | None:
    """Return the first element ``child`` of a link or joint; None if absent or name not unique."""
    found = [element for element in robot.file.root.iterfind(tag) if element.get("name") == name]
    return found[0].find(child) if len(found) == 1 else None


def _format_converted(value: float) -> str:
    """Format a converted number with at most six significant digits."""
    return f"{value:.6g}"


def _format_moved(value: float) -> str:
    """Format a number whose decimal point was moved, with at most twelve significant digits."""
    return f"{value:.12g}"


def _repair_limits_in_degrees(robot: RobotModel, found: CheckFinding) -> Iterator[ValueRepair]:
    """Yield the repair of URDF joint limits in degrees: the limits in radians."""
    if isinstance(robot, UrdfModel) and found.message.code == "limits-look-like-degrees":
        joint = robot.joints[found.name]
        ends = {"lower": joint.lower, "upper": joint.upper}
        new = {word: _format_converted(math.radians(value)) for word, value in ends.items()}
        reason = diagnose("repair-degrees-to-radians")
        yield from _make_urdf_repair(robot, "joint", found.name, "limit", new, reason)


def _repair_command_range(robot: RobotModel, found: CheckFinding) -> Iterator[ValueRepair]:
    """Yield the repair of a servo's command range in degrees: the range of the joint."""
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
        old, new = attributes["ctrlrange"], " ".join(map(_format_converted, ends))
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
                limit = _find_unique_child(robot, "joint", twin.name, "limit")
                new = {"effort": "" if limit is None else str(limit.get("effort"))}
                reason = diagnose("repair-of-twin", other=twin.name)
                yield from _make_urdf_repair(robot, "joint", joint.name, "limit", new, reason)


def _repair_mirrored_mass(robot: RobotModel, found: CheckFinding) -> Iterator[ValueRepair]:
    """Yield repairs of the different masses of two mirrored links of a URDF.

    The inertia tensor is scaled with the mass if it probably contains the same factor.
    """
    if isinstance(robot, UrdfModel):
        partner = str(found.message.values["other"])
        links = robot.links
        for repair in _repair_number(
            robot, (found.name, partner), "link", "inertial/mass", "value",
            {name: link.mass for name, link in links.items() if link.mass},
        ):  # fmt: skip
            own = links[repair.name]
            partner_link = links[partner if repair.name == found.name else found.name]
            factor = partner_link.mass / own.mass if own.mass > 0 else math.nan
            is_scaled = (
                own.inertial is not None
                and partner_link.inertial is not None
                and abs(math.log10(factor)) > 0.5
                and np.allclose(
                    factor * own.inertial.moments, partner_link.inertial.moments, rtol=_MOMENT_RTOL
                )
            )
            if is_scaled:
                tensor = _scale_tensor(robot, own.name, factor)
                yield from _join_changes(
                    [
                        repair,
                        _make_change(robot, own.name, "inertial/inertia", tensor, repair.reason),
                    ]
                )
            else:
                yield repair


_MOMENT_RTOL = 0.05
"""Relative tolerance of the test whether the moments of inertia of two mirrored links have the
ratio of the masses; a repair of the mass then may also scale the tensor. Chosen, not tuned.
"""


def _repair_mirrored_effort(robot: RobotModel, found: CheckFinding) -> Iterator[ValueRepair]:
    """Yield repairs of the different efforts of two mirrored joints of a URDF."""
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

    A partner gets the number of the other partner; other limbs may decide which partner is wrong.
    The number is the ``attribute`` of the element ``child``; ``values`` is {link or joint: number}.
    """
    kind = strip_sides(pair[0])
    sibling_values = [
        value for name, value in values.items() if name not in pair and strip_sides(name) == kind
    ]
    agreeing = len(sibling_values) >= MIN_SIBLINGS and np.allclose(
        sibling_values, sibling_values[0], rtol=1e-3
    )
    wrong = [
        name
        for name in pair
        if agreeing
        and not math.isclose(values.get(name, math.nan), sibling_values[0], rel_tol=0.01)
    ]
    targets = wrong if len(wrong) == 1 else pair if not agreeing else ()
    for name in targets:
        partner = pair[1] if name == pair[0] else pair[0]
        source = _find_unique_child(robot, tag, partner, child)
        if source is not None and source.get(attribute) is not None and values.get(partner, 0) > 0:
            new = {attribute: str(source.get(attribute))}
            reason = (
                diagnose("repair-of-siblings", other=partner, count=len(sibling_values))
                if agreeing
                else diagnose("repair-of-twin", other=partner)
            )
            yield from _make_urdf_repair(robot, tag, name, child, new, reason)


def _repair_tensor(robot: RobotModel, found: CheckFinding) -> Iterator[ValueRepair]:
    """Yield repairs of the inertia tensor of a URDF link.

    For example, the tensor is mirrored, gets another decimal point, or is computed from the shapes.
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
    proposed = confirmed if len(confirmed) == 1 else (mirrored or moved)
    yield from proposed or _fill_shapes(robot, found.name)


def _repair_implausible_tensor(robot: RobotModel, found: CheckFinding) -> Iterator[ValueRepair]:
    """Yield other tensors for a link of a URDF whose tensor is possible, but implausible.

    Nothing is proposed if the masses of both sides differ by more than 1 %, since the mass may be
    wrong.
    """
    link, twin = robot.links[found.name], _find_twin(robot, found.name)
    if not isinstance(robot, UrdfModel) or link.inertial is None:
        return
    if twin is not None and not math.isclose(link.mass, twin.mass, rel_tol=0.01):
        return
    smallest, middle, largest = link.inertial.moments
    if smallest > 0 and smallest + middle >= largest * (1 - _TRIANGLE_RTOL):
        wrong_axis = found.message.code == "inertia-about-wrong-axis"
        ordered = list(_reorder_moments(robot, found.name)) if wrong_axis else []
        mirrored = list(_mirror_tensor(robot, found.name))
        yield from mirrored or ordered or _fill_shapes(robot, found.name)


MIN_MOMENT_RATIO = 1.1
"""Smallest ratio between two moments of the box around the shapes with which the order of these
moments decides the order of the stated moments. Chosen, not tuned.
"""


def _reorder_moments(robot: UrdfModel, name: str) -> Iterator[ValueRepair]:
    """Yield the nearly diagonal tensor of a link with its moments in the order of the shapes.

    Nearly equal moments of the box around the shapes may give further candidates.
    """
    link = robot.links[name]
    element = _find_unique_child(robot, "link", name, "inertial/inertia")
    points, _ = list_known_points(robot.fixed_group(name), link)
    words = ("ixx", "iyy", "izz")
    if element is None or points is None or any(element.get(word) is None for word in words):
        return
    if not np.allclose(robot.file.tree.links[name].inertial_rotation, np.eye(3), atol=1e-6):
        return
    moments = [float(str(element.get(word))) for word in words]
    products = [float(element.get(word) or 0.0) for word in ("ixy", "ixz", "iyz")]
    if np.abs(products).max() > 0.1 * max(moments):
        return
    squares = np.ptp(points, axis=0) ** 2
    expected = squares.sum() - squares
    texts = sorted((str(element.get(word)) for word in words), key=float)
    orders = [np.argsort(expected).tolist()]
    low, middle, high = sorted(expected.tolist())
    for first, second, place in ((low, middle, 0), (middle, high, 1)):
        if second < MIN_MOMENT_RATIO * first and texts[place] != texts[place + 1]:
            swapped = [*orders[0]]
            swapped[place], swapped[place + 1] = swapped[place + 1], swapped[place]
            orders.append(swapped)
    for order in orders:
        new = {words[axis]: text for axis, text in zip(order, texts, strict=True)}
        reason = diagnose("repair-axis-order")
        yield from _make_urdf_repair(robot, "link", name, "inertial/inertia", new, reason)


_TRIANGLE_RTOL = 1e-5
"""Violation of the triangle inequality, relative to the largest moment, up to which a tensor counts
as possible: rounding of printed numbers. Chosen, not tuned."""


def _fill_shapes(robot: UrdfModel, name: str) -> Iterator[ValueRepair]:
    """Yield the tensor of the solid shapes of a link, with the stated mass and a uniform density.

    A CoM that is missing or far outside of the shapes may be replaced, too.
    """
    link, tags = robot.links[name], robot.file.tree.links.get(name)
    if (
        tags is None
        or link.mass <= 0
        or _find_unique_child(robot, "link", name, "inertial") is None
    ):
        return
    shapes = [shape for shape in link.shapes if shape.collides] or list(link.shapes)
    solids = [shape.compute_solid_inertia() for shape in shapes]
    known = [solid for solid in solids if solid is not None]
    points = [shape.points for shape in shapes]
    if (
        not known
        or len(known) < len(solids)
        or any(points_of_shape is None for points_of_shape in points)
    ):
        return
    solid = functools.reduce(operator.add, known)
    if not solid.mass:  # a sphere of radius 0
        return
    density = link.mass / float(solid.mass)
    if not MIN_DENSITY <= density <= MAX_DENSITY:
        return
    reason = diagnose("repair-solid", shapes=dict.fromkeys(Term(shape.kind) for shape in shapes))
    changes, turn = list[ValueRepair | None](), tags.inertial_rotation
    com = None if link.inertial is None else link.inertial.com
    hull = np.concatenate(
        [points_of_shape for points_of_shape in points if points_of_shape is not None]
    )
    size = float(np.ptp(hull, axis=0).max())
    if com is None or compute_hull_distance(hull, com) > _MAX_OUTSIDE * size:
        ends = list_link_points(robot, link)
        if min(compute_hull_distance(hull, end) for end in ends) > size:
            return
        turn = np.eye(3)
        new = {"xyz": _format_vector(np.round(solid.lever, 7)), "rpy": "0 0 0"}
        changes.append(_make_change(robot, name, "inertial/origin", new, reason))
    tensor = _rotate_tensor(density * np.array(solid.inertia), turn.T)
    scale = float(np.abs(tensor).max())
    element = _find_unique_child(robot, "link", name, "inertial/inertia")
    entries = {
        word: 0.0 if abs(tensor[index]) < _ZERO_RTOL * scale else float(tensor[index])
        for word, index in INERTIA_ENTRIES.items()
    }
    texts = {
        word: _format_converted(entry)
        for word, entry in entries.items()
        if element is None or entry or float(element.get(word) or 0.0)
    }
    changes.append(_make_change(robot, name, "inertial/inertia", texts, reason))
    yield from _join_changes(changes)


_ZERO_RTOL = 1e-6
"""Lower bound of an entry of the tensor of a solid, relative to the largest entry. A smaller entry
is written as zero. Chosen: coordinates of STL files are in single precision.
"""

_MAX_OUTSIDE = 0.1
"""Largest distance (`compute_hull_distance`) of a CoM from the convex hull of the link's shapes,
relative to the extent of the shapes. At a larger distance `_fill_shapes` replaces the CoM together
with the tensor, or proposes nothing. Chosen, not tuned.
"""


_MIRROR_RTOL = 0.02
"""Relative tolerance between a moment with moved decimal point and the same moment of the tensor
that `_mirror_tensor` proposes, to confirm the moved decimal point. Chosen, not tuned.
"""


MAX_DECIMAL_SHIFT = 6
"""Largest number of places by which a repair moves the decimal point of a moment of inertia or a
mass. Chosen: a larger factor, such as 1e9 for g mm^2, is rather a wrong unit.
"""


def _move_decimal_points(robot: UrdfModel, name: str) -> Iterator[ValueRepair]:
    """Yield repairs of a nearly diagonal tensor: one moment is multiplied by a power of ten."""
    element = _find_unique_child(robot, "link", name, "inertial/inertia")
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
                new = {word: _format_moved(changed[place])}
                reason = diagnose("repair-decimal-point", shift=shift)
                yield from _make_urdf_repair(robot, "link", name, "inertial/inertia", new, reason)


def _mirror_tensor(robot: UrdfModel, name: str) -> Iterator[ValueRepair]:
    """Yield the repair of a link's inertia tensor: the mirrored tensor of the other side.

    If the other limbs share a tensor, and all limbs share a CoM, the tensor is copied instead.
    """
    twin, link = _find_twin(robot, name), robot.links[name]
    if twin is None or not math.isclose(link.mass, twin.mass, rel_tol=0.01):
        return
    new = _compute_mirrored_tensor(robot, link, twin)
    if new is not None:
        reason = diagnose("repair-mirrored", other=twin.name)
        stated = _find_common_attributes(robot, name, "inertial/inertia")
        if stated and _find_common_attributes(robot, name, "inertial/origin", own=True):
            reason, new = diagnose("repair-of-limb", other=twin.name), stated
        yield from _make_urdf_repair(robot, "link", name, "inertial/inertia", new, reason)


def _compute_mirrored_tensor(robot: UrdfModel, link: Link, twin: Link) -> dict[str, str] | None:
    """Return the mirror image of the tensor of ``twin`` as {attribute of <inertia>: text}.

    The tensor [kg m^2] is in the axes of the inertial frame of ``link``, the link on the other
    side. None if the mirror image is unknown or physically impossible.
    """
    mirror = find_mirror_plane(robot)
    if mirror is None or twin.inertial is None:
        return None
    smallest, middle, largest = twin.inertial.moments
    if not (smallest > 0 and smallest + middle >= largest * (1 - _TRIANGLE_RTOL)):
        return None
    turn = (
        np.eye(3) if link.inertial is None else robot.file.tree.links[link.name].inertial_rotation
    )
    in_base = (
        mirror.matrix @ _rotate_tensor(twin.inertial.inertia, twin.pose.rotation) @ mirror.matrix
    )
    tensor = _rotate_tensor(in_base, (link.pose.rotation @ turn).T)
    scale = float(np.abs(tensor).max())
    return {
        word: _format_converted(0.0 if abs(tensor[index]) < 1e-9 * scale else float(tensor[index]))
        for word, index in INERTIA_ENTRIES.items()
    }


def _find_common_attributes(
    robot: UrdfModel, name: str, child: str, *, own: bool = False
) -> dict[str, str] | None:
    """Return the {attribute: text} of an element that the corresponding links of other limbs share.

    None if the attributes differ, for example. Links that share attributes are often copies of a
    part, not mirror images. With ``own``, the link ``name`` must have the attributes, too.
    ``child`` is the path of the element below a link.
    """
    kind = strip_sides(name)
    names = [
        link_name
        for link_name in robot.links
        if link_name != name and strip_sides(link_name) == kind
    ]
    stated = []
    for link_name in [*names, *([name] if own else [])]:
        element = _find_unique_child(robot, "link", link_name, child)
        if element is None:
            return None
        texts = {"xyz": "0 0 0", "rpy": "0 0 0"} if element.tag == "origin" else {}
        stated.append(texts | {word: str(text) for word, text in element.attrib.items()})
    if len(names) <= MIN_SIBLINGS:
        return None
    values = [{word: text.split() for word, text in texts.items()} for texts in stated]
    numbers = [{word: [*map(float, parts)] for word, parts in texts.items()} for texts in values]
    return stated[0] if all(values_of_link == numbers[0] for values_of_link in numbers) else None


def _find_twin(robot: RobotModel, name: str) -> Link | None:
    """Return the corresponding link on the other side of a robot; None for a link without pair."""
    for first, second in find_mirror_pairs(robot.links):
        if name in (first, second):
            return robot.links[second if name == first else first]
    return None


def _rotate_tensor(tensor: Array, rotation: Array) -> Array:
    """Return a tensor T in rotated axes: R T R^T, with the rotation matrix R, shape (3, 3) each."""
    rotated: Array = rotation @ tensor @ rotation.T
    return rotated


def _repair_exchanged_limits(robot: RobotModel, found: CheckFinding) -> Iterator[ValueRepair]:
    """Yield the repair of a URDF joint with lower > upper: both limits exchanged."""
    limit = (
        _find_unique_child(robot, "joint", found.name, "limit")
        if isinstance(robot, UrdfModel)
        else None
    )
    if not isinstance(robot, UrdfModel) or limit is None or found.message.code != "range-empty":
        return
    lower, upper = limit.get("lower", "0"), limit.get("upper", "0")
    if float(lower) > float(upper):
        new = {"lower": upper, "upper": lower}
        reason = diagnose("repair-exchanged")
        yield from _make_urdf_repair(robot, "joint", found.name, "limit", new, reason)


def _repair_mass(robot: RobotModel, found: CheckFinding) -> Iterator[ValueRepair]:
    """Yield the repair of a URDF link without positive mass: the mass of the other side.

    A link without <mass> gets the CoM and the tensor as well.
    """
    if not isinstance(robot, UrdfModel) or found.message.code == "hardly-any-mass":
        return
    twin = _find_twin(robot, found.name)
    link = robot.links.get(found.name)
    if link is None or twin is None or twin.mass <= 0:
        return
    reason = diagnose("repair-of-twin", other=twin.name)
    mass = _find_unique_child(robot, "link", twin.name, "inertial/mass")
    if mass is None:
        return
    if _find_unique_child(robot, "link", link.name, "inertial/mass") is not None:
        new = {"value": str(mass.get("value"))}
        yield from _join_changes([_make_change(robot, link.name, "inertial/mass", new, reason)])
        return
    children = ("inertial/origin", "inertial/mass", "inertial/inertia")
    stated = {child: _find_common_attributes(robot, link.name, child) for child in children}
    copied = {child: new for child, new in stated.items() if new is not None}
    if len(copied) == len(children):
        reason = diagnose("repair-of-limb", other=twin.name)
        yield from _join_changes(
            _make_change(robot, link.name, child, new, reason) for child, new in copied.items()
        )
        return
    com, tensor = _mirror_com(robot, link, twin), _compute_mirrored_tensor(robot, link, twin)
    if com is not None and tensor is not None:
        changes = (
            ("inertial/origin", {"xyz": _format_vector(com), "rpy": "0 0 0"}),
            ("inertial/mass", {"value": str(mass.get("value"))}),
            ("inertial/inertia", tensor),
        )
        yield from _join_changes(
            _make_change(robot, link.name, child, new, reason) for child, new in changes
        )


def _format_vector(vector: Array) -> str:
    """Format a vector with at most six significant digits; magnitudes below 1e-9 are zero."""
    return " ".join("0" if abs(part) < 1e-9 else _format_converted(float(part)) for part in vector)


def _mirror_com(robot: RobotModel, link: Link, twin: Link) -> Array | None:
    """Return the mirror image of the CoM of ``twin`` in the frame of ``link``, shape (3,) [m].

    None if the robot has no mirror plane, or ``twin`` has no inertial.
    """
    mirror = find_mirror_plane(robot)
    if mirror is None or twin.inertial is None:
        return None
    return link.pose.inverse().point(mirror.reflect_point(twin.pose.point(twin.inertial.com)))


def _repair_com(robot: RobotModel, found: CheckFinding) -> Iterator[ValueRepair]:
    """Yield repairs of a URDF link's CoM: mm converted to m, or the CoM of the mirrored link."""
    link = robot.links.get(found.name)
    twin = None if link is None else _find_twin(robot, found.name)
    if not isinstance(robot, UrdfModel) or link is None:
        return
    metres = list(_read_com_in_metres(robot, found))
    if metres or twin is None:
        yield from metres
        return
    wrong = [(link, twin)]
    if found.message.code == "mirror-com":
        kind = strip_sides(link.name)
        wrong = select_deviating_pairs(
            [(link, twin), (twin, link)],
            {
                name: np.abs(link_alike.inertial.com)
                for name, link_alike in robot.links.items()
                if link_alike.inertial is not None and strip_sides(name) == kind
            },
        )
    for own, partner in wrong:
        stated = _find_common_attributes(robot, own.name, "inertial/origin")
        com = _mirror_com(robot, own, partner)
        if stated or com is not None:
            reason = diagnose("repair-mirrored-com", other=partner.name)
            new = {"xyz": _replace_deviating_coordinates(own, com)} if com is not None else {}
            if stated:
                reason = diagnose("repair-of-limb", other=partner.name)
                new = {"xyz": stated["xyz"]}
            yield from _join_changes(
                [_make_change(robot, own.name, "inertial/origin", new, reason)]
            )


def _replace_deviating_coordinates(link: Link, image: Array) -> str:
    """Format the CoM of a link with the most deviating coordinates replaced by those of ``image``.

    ``image`` is the mirror image of the partner's CoM in the frame of the link, shape (3,) [m].
    """
    if link.inertial is None:
        return _format_vector(image)
    repaired = np.array(link.inertial.com)
    tolerance = get_com_tolerance(link.pose.point(image))
    for coordinate in np.argsort(-np.abs(repaired - image)):
        if np.linalg.norm(repaired - image) > tolerance:
            repaired[coordinate] = image[coordinate]
    return _format_vector(repaired)


def _read_com_in_metres(robot: UrdfModel, found: CheckFinding) -> Iterator[ValueRepair]:
    """Yield the repair of a CoM that is probably in mm: the CoM in m.

    A thousandth of the CoM must be in or near the convex hull of shapes, frames and child joints.
    """
    link = robot.links[found.name]
    element = _find_unique_child(robot, "link", link.name, "inertial/origin")
    if found.message.code == "mirror-com" or element is None or link.inertial is None:
        return
    points, is_complete = list_known_points(robot.fixed_group(link.name), link)
    ends = list_link_points(robot, link)
    points = ends if points is None else np.concatenate([points, ends])
    size, com = float(np.ptp(points, axis=0).max()), link.inertial.com
    is_far = compute_hull_distance(points, com) > _MIN_MM_OFFSET * size > 0
    if is_far and compute_hull_distance(points, com / 1000) <= 0.05 * size and is_complete:
        texts = [float(text) / 1000 for text in str(element.get("xyz")).split()]
        new = {"xyz": " ".join(_format_moved(value) for value in texts)}
        reason = diagnose("repair-metres")
        yield from _make_urdf_repair(robot, "link", link.name, "inertial/origin", new, reason)


_MIN_MM_OFFSET = 5.0
"""Distance of a CoM from the convex hull of shapes, frames and child joints, relative to the extent
of the hull, above which the CoM may be in mm. Chosen, not tuned.
"""

MAX_DENSITY_RATIO = 3.0
"""Largest ratio between the density of a repaired link and the median density of the other links,
in either direction. Derived from sqrt(10), rounded down: at most a single mass among masses that
differ by powers of ten is within this bound.
"""


def _repair_dense_mass(robot: RobotModel, found: CheckFinding) -> Iterator[ValueRepair]:
    """Yield repairs of the mass of a URDF link that is too dense.

    Candidates are the mass divided by a power of ten, and the mass with the density of other links.
    """
    link = robot.links.get(found.name)
    if not isinstance(robot, UrdfModel) or link is None or link.inertial is None:
        return
    if found.message.code not in ("denser-than-metal", "denser-than-others"):
        return
    mass, density = (found.message.values[word].value for word in ("mass", "density"))  # type: ignore[union-attr]
    typical = compute_median_density(robot, found.name)
    twin = _find_twin(robot, found.name)
    shifts = range(1, MAX_DECIMAL_SHIFT + 1)
    if twin is not None and 0 < twin.mass < 0.5 * link.mass:
        agreeing = [n for n in shifts if math.isclose(link.mass / 10**n, twin.mass, rel_tol=0.01)]
    elif typical is not None:
        agreeing = [
            n
            for n in shifts
            if 1 / MAX_DENSITY_RATIO < density / 10**n / typical < MAX_DENSITY_RATIO
        ]
    else:
        agreeing = []
    for shift in agreeing:
        reason = diagnose("repair-decimal-point", shift=-shift)
        factor = 10.0**-shift
        new = {"value": _format_moved(link.mass * factor)}
        changes = [_make_change(robot, link.name, "inertial/mass", new, reason)]
        if _fits_shapes(robot, link):
            tensor = _scale_tensor(robot, link.name, factor)
            changes.append(_make_change(robot, link.name, "inertial/inertia", tensor, reason))
        yield from _join_changes(changes)
    if typical is not None and density < 10 * MAX_DENSITY and link.mass == mass:
        value = link.mass * typical / density
        reason = diagnose("repair-density", density=Quantity(typical, "kg/m^3"))
        new = {"value": _format_converted(value)}
        yield from _join_changes([_make_change(robot, link.name, "inertial/mass", new, reason)])


def _fits_shapes(robot: RobotModel, link: Link) -> bool:
    """Return True if a link's inertia tensor probably fits the stated mass m.

    The largest principal moment must be positive and at most 2 m R^2. R is the largest distance [m]
    from the CoM to the shapes (fixed links included), frames and child links.
    """
    assert link.inertial is not None
    points, _ = list_known_points(robot.fixed_group(link.name), link)
    ends = list_link_points(robot, link)
    points = ends if points is None else np.concatenate([points, ends])
    reach = float(np.linalg.norm(points - link.inertial.com, axis=1).max())
    return 0 < float(link.inertial.moments[-1]) <= 2 * link.mass * reach**2


def _scale_tensor(robot: UrdfModel, name: str, factor: float) -> dict[str, str]:
    """Multiply the entries of a link's <inertia> by a factor: {attribute: new text}."""
    element = _find_unique_child(robot, "link", name, "inertial/inertia")
    return {
        word: _format_converted(factor * float(str(element.get(word))))
        for word in INERTIA_ENTRIES
        if element is not None and element.get(word) is not None
    }


def _repair_mesh_path(robot: RobotModel, found: CheckFinding) -> Iterator[ValueRepair]:
    """Yield the repairs of missing mesh files of a URDF: existing files with similar names."""
    if not isinstance(robot, UrdfModel) or found.message.code != "mesh-missing":
        return
    names = found.message.values["meshes"]
    link = robot.file.tree.links.get(found.name)
    if not isinstance(names, tuple) or link is None:
        return
    slashed = {str(name): str(name).replace("\\", "/") for name in names}
    if all(name != new and robot.file.resolve_mesh(new) for name, new in slashed.items()):
        reason = diagnose("repair-slashes")
        yield from _join_changes(
            _make_change(robot, user, place, {"filename": new}, reason)
            for name, new in slashed.items()
            for user, element in robot.file.tree.links.items()
            for place in _list_mesh_elements(element.element, name)
        )
        return
    if len(names) != 1:
        return
    name = str(names[0])
    places = _list_mesh_elements(link.element, name)
    users = [mesh for mesh in robot.file.root.iter("mesh") if mesh.get("filename") == name]
    if len(places) != len(users):
        return
    folder, _, last = name.rpartition("/")
    prefix = f"{folder}/" if folder else ""
    for alternative in _list_similar_files(robot, prefix, last):
        reason = diagnose("repair-existing-file")
        new = {"filename": alternative}
        yield from _join_changes(
            _make_change(robot, found.name, path, new, reason) for path in places
        )


def _list_mesh_elements(link: etree._Element, filename: str) -> list[str]:
    """Return the XML paths below a link of the meshes with a ``filename``."""
    return [
        f"{tag}[{number}]/geometry/mesh"
        for tag in ("visual", "collision")
        for number, shape in enumerate(link.iterfind(tag), start=1)
        for mesh in shape.iterfind("geometry/mesh")
        if mesh.get("filename") == filename
    ]


def _list_similar_files(robot: UrdfModel, prefix: str, name: str) -> list[str]:
    """Return the paths of existing files with names similar to a missing file ``prefix + name``."""
    stem = name.rpartition(".")[0]
    if stem and robot.file.resolve_mesh(prefix + stem) is not None:
        return [prefix + stem]
    sample = next(
        (
            path
            for mesh in robot.file.root.iter("mesh")
            if mesh.get("filename", "").rpartition("/")[0] == prefix.rstrip("/")
            and (path := robot.file.resolve_mesh(mesh.get("filename", ""))) is not None
        ),
        robot.file.path.parent / prefix / "_" if "://" not in prefix else None,
    )
    folder = None if sample is None else Path(sample).parent
    if folder is None or not folder.is_dir():
        return []
    files = sorted(path.name for path in folder.iterdir() if path.is_file())
    same = [prefix + file for file in files if file.lower() == name.lower()]
    same_stem = [
        prefix + file for file in files if stem and Path(file).stem.lower() == stem.lower()
    ]
    return same or same_stem


def _repair_axis_length(robot: RobotModel, found: CheckFinding) -> Iterator[ValueRepair]:
    """Yield the repair of a URDF axis that is not a unit vector: the normalized axis."""
    if isinstance(robot, UrdfModel):
        axis = robot.joints[found.name].raw_axis
        new = {"xyz": _format_vector(axis / float(np.linalg.norm(axis)))}
        reason = diagnose("repair-unit-vector")
        yield from _make_urdf_repair(robot, "joint", found.name, "axis", new, reason)


def _repair_mimic(robot: RobotModel, found: CheckFinding) -> Iterator[ValueRepair]:
    """Yield the repair of a <mimic> of a missing joint: the joint with the most similar name."""
    alike = found.message.values["alike"]
    if isinstance(robot, UrdfModel) and alike:
        reason = diagnose("repair-similar-name")
        new = {"joint": str(alike)}
        yield from _make_urdf_repair(robot, "joint", found.name, "mimic", new, reason)


def _repair_joint_type(robot: RobotModel, found: CheckFinding) -> Iterator[ValueRepair]:
    """Yield the repair of a fixed joint of a URDF: the type of the left or right partner."""
    partner = str(found.message.values["other"])
    if not isinstance(robot, UrdfModel):
        return
    kind = robot.file.tree.joints[partner].kind
    has_limit = _find_unique_child(robot, "joint", found.name, "limit") is not None
    if has_limit or kind == "continuous":
        reason = diagnose("repair-of-twin", other=partner)
        old, new = {"type": robot.file.tree.joints[found.name].kind}, {"type": kind}
        yield ValueRepair(str(robot.file.path), "joint", found.name, "", old, new, reason)


def _repair_mirrored_tensor(robot: RobotModel, found: CheckFinding) -> Iterator[ValueRepair]:
    """Yield the repairs of a URDF link's tensor that differs from side to side: mirror images."""
    link = robot.links.get(found.name)
    twin = None if link is None else _find_twin(robot, found.name)
    if not isinstance(robot, UrdfModel) or link is None or twin is None:
        return
    kind = strip_sides(link.name)
    entries = {
        name: np.abs(link_alike.inertial.inertia).ravel()
        for name, link_alike in robot.links.items()
        if link_alike.inertial is not None and strip_sides(name) == kind
    }
    scale = max((float(values.max()) for values in entries.values()), default=0.0)
    for own, _ in select_deviating_pairs(
        [(link, twin), (twin, link)],
        {name: values / scale for name, values in entries.items() if scale},
    ):
        yield from _mirror_tensor(robot, own.name)


def _repair_axis_of_zeros(robot: RobotModel, found: CheckFinding) -> Iterator[ValueRepair]:
    """Yield the repairs of a URDF axis of zeros: the axes of corresponding joints of other limbs.

    Each axis is copied as expressed in the frame of the other joint.
    """
    if not isinstance(robot, UrdfModel) or found.name not in robot.joints:
        return
    kind = strip_sides(found.name)
    texts: dict[str, str] = {}
    for name, joint in robot.joints.items():
        axis = _find_unique_child(robot, "joint", name, "axis")
        alike = name != found.name and strip_sides(name) == kind and joint.moves
        if alike and axis is not None and joint.raw_axis.any():
            texts.setdefault(_format_vector(joint.raw_axis), name)
    for text, name in texts.items():
        reason = diagnose("repair-of-limb", other=name)
        yield from _make_urdf_repair(robot, "joint", found.name, "axis", {"xyz": text}, reason)


def _repair_axis_sense(robot: RobotModel, found: CheckFinding) -> Iterator[ValueRepair]:
    """Yield the repair of a reversed axis in a left-right pair of URDF joints: the negated axis.

    If the finding leaves open which joint of the pair is wrong, both joints are candidates.
    """
    if not isinstance(robot, UrdfModel) or found.message.code != "mirror-axis-reversed":
        return
    reason = diagnose("repair-of-limb", other=str(found.message.values["like"]))
    names = (
        (found.name,)
        if found.message.values["certain"]
        else (
            found.name,
            str(found.message.values["other"]),
        )
    )
    for name in names:
        new = {"xyz": _format_vector(-robot.joints[name].raw_axis)}
        yield from _make_urdf_repair(robot, "joint", name, "axis", new, reason)


def _repair_joint_place(robot: RobotModel, found: CheckFinding) -> Iterator[ValueRepair]:
    """Yield the repair of a URDF joint origin: the mirror image of the partner joint's origin.

    If the rotation of a joint nearer to the base explains the displacement, that rotation is
    repaired instead.
    """
    mirror = find_mirror_plane(robot)
    partner = next(
        (
            pair[0] if pair[1] == found.name else pair[1]
            for pair in find_mirror_pairs(robot.joints)
            if found.name in pair
        ),
        None,
    )
    if not isinstance(robot, UrdfModel) or mirror is None or partner is None:
        return
    places = [robot.joints[name].position for name in (found.name, partner)]
    if np.linalg.norm(mirror.reflect_point(places[0]) - places[1]) <= POSITION_TOLERANCE:
        return
    turned = _turn_ancestors(robot, mirror, found.name, partner)
    if turned:
        yield from turned
        return
    kind = strip_sides(found.name)
    origins = {
        name: np.abs(robot.file.tree.joints[name].origin.translation)
        for name in robot.joints
        if strip_sides(name) == kind
    }
    sibling_values = [value for name, value in origins.items() if name not in (found.name, partner)]
    agreeing = len(sibling_values) >= MIN_SIBLINGS and np.allclose(
        sibling_values, sibling_values[0], atol=1e-3
    )
    wrong = [
        name
        for name in (found.name, partner)
        if agreeing and not np.allclose(origins[name], sibling_values[0], atol=1e-3)
    ]
    for name in wrong if len(wrong) == 1 else () if agreeing else (found.name, partner):
        partner_name = partner if name == found.name else found.name
        joint = robot.joints[name]
        place = mirror.reflect_point(robot.joints[partner_name].position)
        local = robot.links[joint.parent].pose.inverse().point(place)
        reason = diagnose("repair-mirrored-place", other=partner_name)
        new = {"xyz": _format_vector(local)}
        yield from _make_urdf_repair(robot, "joint", name, "origin", new, reason)


def _turn_ancestors(
    robot: UrdfModel, mirror: MirrorPlane, name: str, partner: str
) -> list[ValueRepair]:
    """Return repairs of an ancestor's rotation that would mirror the positions of the links below.

    Returns:
        A single repair, or a candidate for the ancestor on each side; otherwise empty.
    """
    joints = robot.file.tree.joints
    for below, beside in ((name, partner), (partner, name)):
        if strip_sides(below) != strip_sides(beside):
            return []
    chains = [list(_list_joints_above(robot, joint)) for joint in (name, partner)]
    if len(chains[0]) != len(chains[1]):
        return []
    for own, partner_joint in reversed(list(zip(*chains, strict=True))):
        if own == partner_joint or strip_sides(own) != strip_sides(partner_joint):
            continue
        repairs = [
            repair
            for joint, twin in ((own, partner_joint), (partner_joint, own))
            for repair in _turn_joint(robot, mirror, joint, twin)
        ]
        angles = {
            joint: np.abs(pin.rpy.matrixToRpy(np.array(joints[joint].origin.rotation)))
            for joint in joints
            if strip_sides(joint) == strip_sides(own)
        }
        sibling_values = [
            value for joint, value in angles.items() if joint not in (own, partner_joint)
        ]
        if len(sibling_values) >= MIN_SIBLINGS:
            repairs = [
                repair
                for repair in repairs
                if not np.allclose(angles[repair.name], sibling_values[0], atol=1e-3)
            ]
        if repairs:
            return repairs
    return []


def _list_joints_above(robot: UrdfModel, name: str) -> Iterator[str]:
    """Yield the joints between a joint and the base, without this joint, the nearest first."""
    above = {joint.child: joint_name for joint_name, joint in robot.joints.items()}
    link = robot.joints[name].parent
    while link in above:
        yield above[link]
        link = robot.joints[above[link]].parent


def _turn_joint(
    robot: UrdfModel, mirror: MirrorPlane, name: str, twin: str
) -> Iterator[ValueRepair]:
    """Yield at most one repair: a joint rotation that mirrors the positions of the links below."""
    joint, links = robot.file.tree.joints[name], robot.links
    child = robot.joints[name].child
    base = links[robot.joints[name].parent].pose
    stated = np.array(robot.file.tree.joints[twin].origin.rotation)
    below = {child, *(link.name for link in robot.descendants(child))}
    pairs = [pair for pair in find_mirror_pairs(links) if below & {*pair}]
    for rotation in (mirror.matrix @ stated @ mirror.matrix, stated):
        if np.allclose(rotation, np.array(joint.origin.rotation), atol=1e-6):
            continue
        moved = base * Pose(joint.origin.translation, rotation) * links[child].pose.inverse()
        gaps = []
        for pair in pairs:
            own, partner_link = pair if pair[0] in below else pair[::-1]
            place = (moved * links[own].pose).position
            image = mirror.reflect_point(links[partner_link].pose.position)
            gaps.append(float(np.linalg.norm(place - image)))
        if len(gaps) > 1 and max(gaps) <= POSITION_TOLERANCE:
            angles = pin.rpy.matrixToRpy(rotation)
            new = {"rpy": _format_vector(angles)}
            reason = diagnose("repair-mirrored-rotation", other=twin)
            origin = _find_unique_child(robot, "joint", name, "origin")
            old = {"rpy": "" if origin is None else str(origin.get("rpy") or "")}
            yield ValueRepair(str(robot.file.path), "joint", name, "origin", old, new, reason)
            return


def _repair_collision(robot: RobotModel, found: CheckFinding) -> Iterator[ValueRepair]:
    """Yield the repairs of a missing or displaced collision shape of a URDF link.

    Shape or origin are copied from a link of another limb, or from the visual shape.
    """
    link = robot.file.tree.links.get(found.name) if isinstance(robot, UrdfModel) else None
    if not isinstance(robot, UrdfModel) or link is None:
        return
    own = [etree.tostring(shape, method="c14n") for shape in link.element.iterfind("visual")]
    shapes = link.element.findall("collision")
    if not own or len(shapes) > 1:
        return
    kind = strip_sides(found.name)
    candidates: dict[tuple[tuple[str, str], ...], ValueRepair] = {}
    for name, link_alike in robot.file.tree.links.items():
        shapes_alike = link_alike.element.findall("collision")
        if name == found.name or strip_sides(name) != kind or len(shapes_alike) != 1:
            continue
        drawn = [
            etree.tostring(shape, method="c14n") for shape in link_alike.element.iterfind("visual")
        ]
        if _strip_space(own) == _strip_space(drawn):
            reason = diagnose("repair-of-limb", other=name)
            _add_shape(candidates, robot, found.name, shapes_alike[0], reason)
    if not candidates and len(own) == 1:
        visual = link.element.find("visual")
        meshes = [shape.find("geometry/mesh") for shape in (visual, *shapes)]
        if shapes and all(m is not None for m in meshes) and _is_same_mesh(*meshes):
            _add_shape(candidates, robot, found.name, visual, diagnose("repair-of-visual"))
    yield from candidates.values()


def _strip_space(texts: Iterable[bytes]) -> list[bytes]:
    """Remove all white space from serialised XML elements, to compare elements without layout."""
    return [re.sub(rb"\s+", b"", text) for text in texts]


def _is_same_mesh(first: etree._Element, second: etree._Element) -> bool:
    """Return True if two <mesh> elements have equal texts of ``scale`` and equal file stems."""
    stems = {Path(mesh.get("filename", "")).stem for mesh in (first, second)}
    return len(stems) == 1 and first.get("scale", "1 1 1") == second.get("scale", "1 1 1")


def _add_shape(
    candidates: dict[tuple[tuple[str, str], ...], ValueRepair],
    robot: UrdfModel,
    name: str,
    example: etree._Element,
    reason: Diagnostic,
) -> None:
    """Add to ``candidates`` the repair that copies a collision shape from ``example`` to a link.

    If the link ``name`` has a collision shape, the repair only copies the origin.
    """
    origin, geometry = example.find("origin"), example.find("geometry")
    texts = {"xyz": "0 0 0", "rpy": "0 0 0"}
    texts |= {} if origin is None else {word: str(text) for word, text in origin.attrib.items()}
    changes = [("collision/origin", texts)]
    if _find_unique_child(robot, "link", name, "collision") is None:
        for shape in geometry.iterchildren(tag=etree.Element):
            new = {word: str(text) for word, text in shape.attrib.items()}
            changes.append((f"collision/geometry/{shape.tag}", new))
    key = tuple(sorted((child, str(sorted(new.items()))) for child, new in changes))
    found = [_make_change(robot, name, child, new, reason) for child, new in changes]
    for repair in _join_changes(found):
        candidates.setdefault(key, repair)


_PROPOSALS: Final[Mapping[str, Callable[[RobotModel, CheckFinding], Iterator[ValueRepair]]]] = {
    "limits-in-wrong-unit": _repair_limits_in_degrees,
    "command-range-in-degrees": _repair_command_range,
    "effort-or-velocity-zero": _repair_effort,
    "effort-negative": _repair_effort,
    "mirror-mass": _repair_mirrored_mass,
    "mirror-limits": _repair_mirrored_effort,
    "range-empty": _repair_exchanged_limits,
    "mass-not-positive": _repair_mass,
    "moving-body-without-mass": _repair_mass,
    "link-without-inertial": _repair_mass,
    "density-implausible": _repair_dense_mass,
    "com-outside-shapes": _repair_com,
    "mirror-com": _repair_com,
    "shape-off-link": _repair_collision,
    "mesh-missing": _repair_mesh_path,
    "axis-zero": _repair_axis_of_zeros,
    "mirror-axis": _repair_axis_sense,
    "axis-not-unit": _repair_axis_length,
    "mimic-invalid": _repair_mimic,
    "mirror-type": _repair_joint_type,
    "mirror-inertia": _repair_mirrored_tensor,
    "mirror-position": _repair_joint_place,
    "joint-off-links": _repair_joint_place,
    "mirror-shapes": _repair_collision,
    "collision-off-visual": _repair_collision,
    "moving-link-without-collision": _repair_collision,
    "triangle-inequality": _repair_tensor,
    "inertia-not-positive-definite": _repair_tensor,
    "inertia-implausible": _repair_implausible_tensor,
}
"""{rule: function that proposes repairs of the findings of the rule}."""
