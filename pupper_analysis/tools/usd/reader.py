"""USD model as a URDF or an MJCF in memory, for the tools that compare files.

The results refer to the prims of the USD file.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import mujoco
import numpy as np
import pinocchio as pin
from lxml import etree

from pupper_analysis.base.arrays import quaternion_from_rotation
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, Severity, Term, Vector, diagnose
from pupper_analysis.models.attributes import BY_KIND, JOINT_ATTRIBUTES
from pupper_analysis.models.loading import Check, CheckFinding
from pupper_analysis.models.mjcf import compile_spec
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.places import Place, make_file_error
from pupper_analysis.models.shapes import Pose
from pupper_analysis.models.spec_tree import (
    MIN_RANGE,
    SpecTree,
    set_inertia,
    write_joint_parameter,
)
from pupper_analysis.models.stated.mjcf import JOINT_KIND_NAMES
from pupper_analysis.models.stated.model import (
    BALL_JOINT,
    FIXED_JOINT,
    FREE_JOINT,
    HINGE_JOINT,
    SLIDE_JOINT,
    Inertial,
    Joint,
    Link,
)
from pupper_analysis.models.urdf_file import MAX_SLIDE_POSITION, UrdfFile, urdf_from
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.models.xml import to_text
from pupper_analysis.tools.usd.file import PrimPlaces, UsdFile
from pupper_analysis.tools.usd.file import read_usd as read_file
from pupper_analysis.tools.usd.model import Edge, MassOrigin, UsdModel
from pupper_analysis.tools.usd.model import read_usd_model as read_model

__all__ = ["CHECKS", "read_as_mjcf", "read_as_urdf", "read_file", "read_model"]

REPLACED_FORMAT: Final = "the USD"
"""Words in messages that replace the name of the generated model, since the user only knows the
USD.
"""


@dataclass(frozen=True, eq=False)
class UsdAsUrdf(PrimPlaces, UrdfFile):
    """URDF generated from a USD file; findings are located at the prims of the USD file.

    Attributes:
        usd: USD file.
    """

    usd: UsdFile | None = None


def read_as_urdf(path: Path) -> UsdAsUrdf:
    """Convert a USD file to a URDF in memory, with the same links, joints and inertials.

    Bodies outside of the tree of the base, shapes, and joints that close loops are left out.
    ``unknown`` of the result lists the joints whose effort the USD does not state.

    Raises:
        ModelError: If the file has no readable robot, a joint has no equivalent in a URDF, or
            engines would derive a mass property from shapes, for example.
        MissingPackageError: If usd-core is not installed.
    """
    file = read_file(path)
    model = read_model(file)
    root = make_urdf_tree(model).root
    generated = urdf_from(path, to_text(root), root, {})
    notes: list[Diagnostic] = [diagnose("usd-compared-as-urdf", file=path.name), *model.notes]
    notes += list_notes(model)
    if model.loops:
        notes.append(diagnose("usd-loops-left-out", joints=[edge.name for edge in model.loops]))
    unknown = {"effort": list_joints_without(model, "effort")}
    if unknown["effort"]:
        notes.append(diagnose("usd-efforts-unknown", joints=unknown["effort"]))
    messages = (
        *notes,
        *(note for note in generated.notes if note.code != "effort-or-velocity-unstated"),
    )
    return UsdAsUrdf(
        path,
        generated.text,
        generated.root,
        {},
        messages,
        unknown,
        REPLACED_FORMAT,
        model.gains,
        usd=file,
    )


def make_urdf_tree(model: UsdModel) -> UrdfTree:
    """Convert a model to a URDF tree: links, joints, inertials of the base's tree, without shapes.

    Raises:
        ModelError: If a joint is a ball or free joint within the tree.
    """
    tree = UrdfTree(etree.Element("robot", name=model.file.path.stem))
    names = [model.base, *(link.name for link in model.descendants(model.base))]
    poses: dict[str, Pose] = {}
    # A joint moves the base relative to the world.
    if any(joint.moves for joint in model.links[model.base].joints):
        tree.new_link("world")
        poses["world"] = model.mount.inverse()
    # In a URDF, a joint is at the origin of the link that it moves.
    poses |= {name: _get_joint_frame(model.links[name]) for name in names}
    for name in names:
        link, added_link = model.links[name], tree.new_link(name)
        if link.inertial is not None:
            added_link.set_inertia(
                (poses[name].inverse() * link.pose).placement.act(link.inertial.spatial_inertia)
            )
        for joint in link.joints:
            if joint.parent not in poses:
                continue  # a free base has no joint
            if joint.kind in (BALL_JOINT, FREE_JOINT):
                place = model.file.place("joint", joint.name)
                raise make_file_error(place, diagnose("usd-joint-of-several-axes"))
            _add_urdf_joint(tree, model, joint, poses)
    return tree


def _get_joint_frame(link: Link) -> Pose:
    """Return the URDF frame of a link: at the origin of the moving joint, else the link pose."""
    joints = [joint for joint in link.joints if joint.moves]
    return Pose(joints[0].position, link.pose.rotation) if joints else link.pose


def _add_urdf_joint(
    tree: UrdfTree, model: UsdModel, joint: Joint, poses: Mapping[str, Pose]
) -> None:
    """Add a joint of a USD model to a URDF tree, in place.

    ``poses`` are {link: pose of the link frame of the URDF in the base frame [m]}.
    """
    frame = poses[joint.child]
    is_unlimited = not (math.isfinite(joint.lower) or math.isfinite(joint.upper))
    urdf_types = {
        HINGE_JOINT: "continuous" if is_unlimited else "revolute",
        SLIDE_JOINT: "prismatic",
        FIXED_JOINT: "fixed",
    }
    placement = (poses[joint.parent].inverse() * frame).placement
    element = tree.new_joint(
        joint.name, urdf_types[joint.kind], joint.parent, joint.child, placement
    )
    if not joint.moves:
        return
    element.add_axis(frame.rotation.T @ joint.axis)
    stated: Mapping[str, float] = joint.stated
    if not (is_unlimited and joint.kind == HINGE_JOINT):
        limits = np.clip((joint.lower, joint.upper), -MAX_SLIDE_POSITION, MAX_SLIDE_POSITION)
        stated = {**stated, "lower limit": float(limits[0]), "upper limit": float(limits[1])}
    for attribute in JOINT_ATTRIBUTES:
        if attribute.urdf is not None and attribute.kind in stated:
            element.set_parameter(attribute, stated[attribute.kind])
    mimic = model.edges[joint.name].mimic
    if mimic is not None:
        element.add_mimic(*mimic)


_JOINT_TYPES = {kind: mujoco.mjtJoint(int(number)) for number, kind in JOINT_KIND_NAMES.items()}
"""{joint kind: type in MuJoCo}."""


@dataclass(frozen=True, eq=False)
class UsdAsMjcf(PrimPlaces, MjcfFile):
    """MJCF generated from a USD file.

    Attributes:
        usd: USD file, whose prims the places refer to.
    """

    usd: UsdFile | None = None

    def find_attribute(self, kind: str, name: str, attributes: Collection[str]) -> Place | None:
        """Return the prim of an element as the location of the attributes; None without a prim."""
        del attributes
        found = self.place(kind, name)
        return None if found.element is None else found

    def elements(self, tag: str) -> Iterator[tuple[Mapping[str, str], Place]]:
        """Yield nothing, because a USD contains no MJCF elements such as ``<option>``."""
        del tag
        yield from ()

    def place_by_number(self, section: str, number: int) -> Place:
        """Return the location of an element without a name: the USD file, without a prim."""
        del section, number
        return Place(self.path)


def read_as_mjcf(path: Path) -> UsdAsMjcf:
    """Convert a USD file to an MJCF in memory, with the same bodies and joints.

    Shapes are left out. The inertials of fixed bodies are merged into the moving or root bodies.
    Joints that close loops become equality constraints. ``unknown`` of the result lists the joints
    whose effort, damping or friction the USD does not state.

    Raises:
        ModelError: If the file has no readable robot, MuJoCo has no equivalent of a joint, or
            engines would derive a mass property from shapes, for example.
        MissingPackageError: If usd-core is not installed.
    """
    file = read_file(path)
    model = read_model(file)
    spec = make_mjspec(model)
    notes = (diagnose("usd-compared-as-mjcf", file=path.name), *model.notes, *list_notes(model))
    unknown = {kind: list_joints_without(model, kind) for kind in ("effort", "damping", "friction")}
    return UsdAsMjcf(
        path=path,
        spec=spec,
        files=(path,),
        notes=notes,
        unknown={kind: names for kind, names in unknown.items() if names},
        _model=compile_spec(spec.copy(), path),
        stands_for=REPLACED_FORMAT,
        gains=model.gains,
        usd=file,
    )


def list_joints_without(model: UsdModel, kind: str) -> tuple[str, ...]:
    """List the moving joints of a USD file that lack a stated parameter.

    Args:
        model: Model of the USD file.
        kind: Parameter: ``effort``, ``damping`` or ``friction``.
    """
    return tuple(
        name for name, joint in model.joints.items() if joint.moves and kind not in joint.stated
    )


def make_mjspec(model: UsdModel) -> mujoco.MjSpec:
    """Convert a model to a MuJoCo spec: bodies, joints, inertials, couplings, gravity; no shapes.

    Raises:
        ModelError: If MuJoCo has no equivalent of a joint, or refuses an inertia, for example.
    """
    spec = mujoco.MjSpec()
    spec.modelname = model.file.path.stem
    spec.compiler.degree = False
    if model.gravity is not None:
        spec.option.gravity = model.gravity
    inertials = _merge_fixed_inertials(model)
    bodies: dict[str, mujoco.MjsBody] = {}
    for name, link in model.links.items():
        parent_body = bodies.get(link.parent or "", spec.worldbody)
        parent_pose = model.links[link.parent].pose if link.parent else model.mount.inverse()
        pose = parent_pose.inverse() * link.pose
        body = parent_body.add_body(
            name=name, pos=pose.position, quat=quaternion_from_rotation(pose.rotation)
        )
        bodies[name] = body
        inertial = inertials.get(name)
        if inertial is not None:
            if not _is_accepted(inertial):
                message = diagnose(
                    "usd-inertia-of-no-body", moments=Vector(tuple(inertial.moments), "kg m^2")
                )
                raise make_file_error(model.file.place("body", name), message)
            set_inertia(body, inertial.spatial_inertia)
        _add_joints(model, link, body)
    for edge in model.loops:
        _add_loop_constraint(model, spec, edge)
    for edge in model.edges.values():
        if edge.mimic is not None and edge.mimic[0] in model.joints:
            SpecTree(spec).add_coupling(edge.name, *edge.mimic).name = f"{edge.name}_mimic"
    return spec


def _add_joints(model: UsdModel, link: Link, body: mujoco.MjsBody) -> None:
    """Add the movable joints of a link to the body in MuJoCo's spec, in the frame of the body.

    Raises:
        ModelError: If a joint is free, and the link has a parent.
    """
    inverse = link.pose.inverse()
    for joint in link.joints:
        if joint.kind == FIXED_JOINT:
            continue
        if joint.kind == FREE_JOINT and link.parent is not None:
            place = model.file.place("joint", joint.name)
            raise make_file_error(place, diagnose("usd-joint-of-several-axes"))
        mj_joint = body.add_joint(name=joint.name, type=_JOINT_TYPES[joint.kind])
        if not joint.moves:
            continue
        mj_joint.pos = inverse.point(joint.position)
        mj_joint.axis = inverse.rotation @ joint.axis
        if math.isfinite(joint.lower) or math.isfinite(joint.upper):
            mj_joint.limited = mujoco.mjtLimited.mjLIMITED_TRUE
            lower, upper = np.clip((joint.lower, joint.upper), -_MAX_RANGE, _MAX_RANGE)
            mj_joint.range = lower, upper + (MIN_RANGE if lower == upper else 0.0)
        for kind in ("armature", "damping", "friction", "spring", "effort"):
            if kind in joint.stated:
                write_joint_parameter(mj_joint, BY_KIND[kind], joint.stated[kind])


_MAX_RANGE = 1e6
"""Largest magnitude of a limit of a limited joint [rad, m]. A larger or infinite limit is replaced
by this value: a range in MuJoCo requires two finite limits. Chosen, not tuned.
"""


def _merge_fixed_inertials(model: UsdModel) -> dict[str, Inertial]:
    """Return the inertials of root and moving bodies with mass, each merged with the fixed bodies.

    Reason: MuJoCo refuses a degenerate ``fullinertia``, for example of a thin rod, also of a fixed
    body.
    """
    inertials: dict[str, Inertial] = {}
    for name, link in model.links.items():
        if link.parent is not None and not link.moving:
            continue
        parts = [
            (part, part.inertial)
            for part in model.fixed_group(name)
            if part.inertial is not None and part.inertial.mass != 0
        ]
        if len(parts) == 1 and parts[0][0] is link:
            inertials[name] = _restore_triangle_inequality(parts[0][1])
        elif parts:
            inverse = link.pose.inverse()
            rigid = [
                (inverse * part.pose).placement.act(inertial.spatial_inertia)
                for part, inertial in parts
            ]
            total = sum(rigid, pin.Inertia.Zero())
            inertials[name] = _restore_triangle_inequality(Inertial.of(total, stated=True))
    return inertials


def _restore_triangle_inequality(inertial: Inertial) -> Inertial:
    """Correct the moments of an inertial if rounding alone violates the triangle inequality.

    A thin plate has I1 + I2 = I3, and in single precision I3 may be larger by the last digit.
    """
    moments, axes = np.linalg.eigh(inertial.inertia)
    excess = moments[2] - moments[0] - moments[1]
    if not 0 < excess <= _TRIANGLE_INEQUALITY_RTOL * moments[2]:
        return inertial
    moments[:2] += excess
    return replace(inertial, inertia=axes @ np.diag(moments) @ axes.T)


_TRIANGLE_INEQUALITY_RTOL = 1e-6
"""Bound of (I3 - I1 - I2) / I3 [1], where I3 is the largest principal moment of inertia. Up to the
bound, an excess is a rounding error and is removed. Chosen as some units of the last digit in
single precision, below the tolerance of file comparisons.
"""


def _is_accepted(inertial: Inertial) -> bool:
    """Return True if MuJoCo accepts an inertia: positive, and with the triangle inequality."""
    smallest, middle, largest = inertial.moments
    min_value = 1e-15  # mjMINVAL
    return bool(inertial.mass > min_value and smallest > min_value and smallest + middle >= largest)


def _add_loop_constraint(model: UsdModel, spec: mujoco.MjSpec, edge: Edge) -> None:
    """Add the equality constraint of a joint that closes a loop.

    A fixed joint becomes a weld; a joint that moves becomes a connection at a point.

    Raises:
        ModelError: If MuJoCo has no such constraint, for example for a slide.
    """
    first_body, second_body = edge.bodies
    if not (first_body and second_body) or edge.kind in (SLIDE_JOINT, FREE_JOINT):
        raise make_file_error(model.file.place("joint", edge.name), diagnose("usd-loop-of-slide"))
    weld = edge.kind == FIXED_JOINT
    equality = spec.add_equality(name=edge.name, name1=first_body, name2=second_body)
    equality.objtype = mujoco.mjtObj.mjOBJ_BODY
    equality.type = mujoco.mjtEq.mjEQ_WELD if weld else mujoco.mjtEq.mjEQ_CONNECT
    if weld:
        relative_pose = edge.frames[0] * edge.frames[1].inverse()
        equality.data[3:6] = relative_pose.position
        equality.data[6:10] = quaternion_from_rotation(relative_pose.rotation)
    else:
        equality.data[:3] = edge.frames[0].position


def _list_bodies_by_origin(model: UsdModel, *origins: MassOrigin) -> list[str]:
    """Return the names of the bodies whose mass properties have one of the origins."""
    return [name for name, body_mass in model.body_masses.items() if body_mass.origin in origins]


def list_notes(model: UsdModel) -> Iterator[Diagnostic]:
    """Yield a note on the bodies of a USD file that have neither a mass nor collision shapes.

    Raises:
        ModelError: If another body lacks a stated mass, CoM or inertia: engines may derive the
            missing property from shapes.
    """
    by_shapes = _list_bodies_by_origin(model, MassOrigin.WATER, MassOrigin.SHAPES)
    if by_shapes:
        place = model.file.place("body", by_shapes[0])
        raise make_file_error(place, diagnose("usd-weighed-by-shapes", names=by_shapes))
    if by_default := _list_bodies_by_origin(model, MassOrigin.DEFAULT):
        place = model.file.place("body", by_default[0])
        raise make_file_error(place, diagnose("usd-inertia-by-default", names=by_default))
    unknown = [name for name, body_mass in model.body_masses.items() if body_mass.inertial is None]
    if unknown:
        yield diagnose("usd-masses-unknown", names=unknown)


CONTRADICTION_RTOL = 1e-3
"""Bound of the relative difference between the numbers of two USD schemas [1], above which the
numbers are reported as a contradiction. Smaller differences may be rounding: some schemas use
single precision (1e-7), and some writers use five digits. Chosen, not tuned.
"""


def mass_of_water(robot: UsdModel) -> Iterator[CheckFinding]:
    """Yield a finding for each body whose mass includes a shape without a stated mass or density.

    USD then assumes the density of water, hence the name of the rule.
    """
    for name, body_mass in robot.body_masses.items():
        if body_mass.origin is MassOrigin.WATER:
            yield CheckFinding(robot.link_tag, name, diagnose("mass-of-water"))


def mass_unstated(robot: UsdModel) -> Iterator[CheckFinding]:
    """Yield a finding for each body that has neither a mass nor collision shapes.

    The severity is NOTE if the body is fixed to another body.
    """
    for name, body_mass in robot.body_masses.items():
        if body_mass.origin is MassOrigin.UNKNOWN:
            is_separate = robot.links[name].moving or robot.links[name].parent is None
            message = diagnose("mass-unstated")
            yield CheckFinding(
                robot.link_tag, name, message, severity=None if is_separate else Severity.NOTE
            )


def inertia_unstated(robot: UsdModel) -> Iterator[CheckFinding]:
    """Yield findings for bodies without mass, CoM or inertia, which engines may derive from shapes.

    The severity is WARNING if only the CoM is missing, or if engines use defaults, because there
    are no shapes.
    """
    for name, body_mass in robot.body_masses.items():
        if body_mass.origin in (MassOrigin.SHAPES, MassOrigin.DEFAULT):
            has_shapes = body_mass.origin is MassOrigin.SHAPES
            message = diagnose(
                "inertia-unstated",
                lacks=[Term(property_name) for property_name in body_mass.lacks],
                shapes=has_shapes,
            )
            is_com = body_mass.lacks == ("com",)
            severity = Severity.WARNING if is_com or not has_shapes else None
            yield CheckFinding(robot.link_tag, name, message, severity=severity)


def joint_numbers_contradict(robot: UsdModel) -> Iterator[CheckFinding]:
    """Yield findings for joint values, such as damping, that USD schemas state differently.

    Efforts are not compared: motor and joint may have separate limits.
    """
    for name, edge in robot.edges.items():
        for kind, stated in edge.stated.items():
            values = np.array(list(stated.values()))
            if kind == "effort":
                continue  # separate limits of motor and joint
            if np.ptp(values) <= CONTRADICTION_RTOL * np.abs(values).max():
                continue
            smallest, largest = (
                min(stated, key=stated.__getitem__),
                max(stated, key=stated.__getitem__),
            )
            unit = BY_KIND[kind].unit(edge.kind == SLIDE_JOINT)
            message = diagnose(
                "joint-numbers-contradict",
                one=smallest,
                first=Quantity(stated[smallest], unit),
                two=largest,
                last=Quantity(stated[largest], unit),
            )
            yield CheckFinding("joint", name, message)


CHECKS: Final[Mapping[str, Check]] = {
    check.__name__.replace("_", "-"): check
    for check in (
        mass_of_water,
        mass_unstated,
        inertia_unstated,
        joint_numbers_contradict,
    )
}
"""{id of an audit rule: function that yields the findings}, for rules of USD files."""
