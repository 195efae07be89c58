"""A robot model as a URDF, or as an MJCF, in memory: what compares files compares these.

They name the places in the file that they are from.
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
    state_number,
)
from pupper_analysis.models.stated.mjcf import JOINT_KINDS
from pupper_analysis.models.stated.model import (
    BALL,
    FIXED,
    FREE,
    HINGE,
    SLIDE,
    Inertial,
    Joint,
    Link,
)
from pupper_analysis.models.urdf_file import MAX_SLIDE_POSITION, UrdfFile, urdf_from
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.models.xml import to_text
from pupper_analysis.tools.usd.file import PrimPlaces, UsdFile
from pupper_analysis.tools.usd.file import read_usd as read_file
from pupper_analysis.tools.usd.model import Edge, Origin, UsdModel
from pupper_analysis.tools.usd.model import read_usd_model as read_model

__all__ = ["CHECKS", "read_as_mjcf", "read_as_urdf", "read_file", "read_model"]

STANDS_FOR: Final = "the USD"


@dataclass(frozen=True, eq=False)
class UsdAsUrdf(PrimPlaces, UrdfFile):
    """A USD that can be asked what a URDF is asked.

    Attributes:
        usd: The file, to whose prims the places lead.
    """

    usd: UsdFile | None = None


def read_as_urdf(path: Path) -> UsdAsUrdf:
    """Reads a USD as a URDF of the same numbers.

    Raises:
        ModelError: If it cannot be read, or says what no URDF can.
        MissingPackageError: If usd-core is not installed.
    """
    file = read_file(path)
    model = read_model(file)
    root = urdf_of(model).root
    made = urdf_from(path, to_text(root), root, {})
    notes: list[Diagnostic] = [diagnose("usd-compared-as-urdf", file=path.name), *model.notes]
    notes += notes_of(model)
    if model.loops:
        notes.append(diagnose("usd-loops-left-out", joints=[edge.name for edge in model.loops]))
    unknown = {"effort": joints_without(model, "effort")}
    if unknown["effort"]:
        notes.append(diagnose("usd-efforts-unknown", joints=unknown["effort"]))
    messages = (
        *notes,
        *(note for note in made.notes if note.code != "effort-or-velocity-unstated"),
    )
    return UsdAsUrdf(
        path, made.text, made.root, {}, messages, unknown, STANDS_FOR, model.gains, usd=file
    )


def urdf_of(model: UsdModel) -> UrdfTree:
    """Writes a model as a URDF: links, joints and inertials of the base's tree; no shapes.

    Raises:
        ModelError: If a joint moves in a way that no URDF's joint does.
    """
    tree = UrdfTree(etree.Element("robot", name=model.file.path.stem))
    names = [model.base, *(link.name for link in model.descendants(model.base))]
    poses: dict[str, Pose] = {}
    if any(joint.moves for joint in model.links[model.base].joints):  # the world holds it so
        tree.new_link("world")
        poses["world"] = model.mount.inverse()
    # A URDF's joint is at the origin of the link that it moves: the frames are put there.
    poses |= {name: _frame(model.links[name]) for name in names}
    for name in names:
        link, added = model.links[name], tree.new_link(name)
        if link.inertial is not None:
            added.set_inertia((poses[name].inverse() * link.pose).placed.act(link.inertial.rigid))
        for joint in link.joints:
            if joint.parent not in poses:
                continue  # a free base has no joint
            if joint.kind in (BALL, FREE):
                place = model.file.place("joint", joint.name)
                raise make_file_error(place, diagnose("usd-joint-of-several-axes"))
            _add_joint(tree, model, joint, poses)
    return tree


def _frame(link: Link) -> Pose:
    joints = [joint for joint in link.joints if joint.moves]
    return Pose(joints[0].position, link.pose.rotation) if joints else link.pose


def _add_joint(tree: UrdfTree, model: UsdModel, joint: Joint, poses: Mapping[str, Pose]) -> None:
    """Adds a joint, of where the links' frames are in the base's."""
    frame = poses[joint.child]
    endless = not (math.isfinite(joint.lower) or math.isfinite(joint.upper))
    kinds = {HINGE: "continuous" if endless else "revolute", SLIDE: "prismatic", FIXED: "fixed"}
    placed = (poses[joint.parent].inverse() * frame).placed
    added = tree.new_joint(joint.name, kinds[joint.kind], joint.parent, joint.child, placed)
    if not joint.moves:
        return
    added.set_axis(frame.rotation.T @ joint.axis)
    stated: Mapping[str, float] = joint.stated
    if not (endless and joint.kind == HINGE):
        ends = np.clip((joint.lower, joint.upper), -MAX_SLIDE_POSITION, MAX_SLIDE_POSITION)
        stated = {**stated, "lower limit": float(ends[0]), "upper limit": float(ends[1])}
    for one in JOINT_ATTRIBUTES:
        if one.urdf is not None and one.kind in stated:
            added.state(one, stated[one.kind])
    mimic = model.edges[joint.name].mimic
    if mimic is not None:
        added.follow(*mimic)


_TYPES = {kind: mujoco.mjtJoint(int(number)) for number, kind in JOINT_KINDS.items()}


@dataclass(frozen=True, eq=False)
class UsdAsMjcf(PrimPlaces, MjcfFile):
    """A USD that can be asked what an MJCF is asked.

    Attributes:
        usd: The file, to whose prims the places lead.
    """

    usd: UsdFile | None = None

    def stated(self, kind: str, name: str, attributes: Collection[str]) -> Place | None:
        """Returns the prim of a joint: what it states, it states itself."""
        del attributes
        found = self.place(kind, name)
        return None if found.element is None else found

    def weighing(self, body: str) -> Place:
        """Returns the prim of a body."""
        return self.place("body", body)

    def elements(self, tag: str) -> Iterator[tuple[Mapping[str, str], Place]]:
        """Yields nothing: options of a scene are not of the robot."""
        del tag
        yield from ()

    def numbered(self, section: str, number: int) -> Place:
        """Returns the file: what has no name has no prim of its own."""
        del section, number
        return Place(self.path)


def read_as_mjcf(path: Path) -> UsdAsMjcf:
    """Reads a USD as an MJCF of the same numbers.

    Raises:
        ModelError: If it cannot be read, or MuJoCo refuses its numbers.
        MissingPackageError: If usd-core is not installed.
    """
    file = read_file(path)
    model = read_model(file)
    spec = mjspec_of(model)
    notes = (diagnose("usd-compared-as-mjcf", file=path.name), *model.notes, *notes_of(model))
    unknown = {kind: joints_without(model, kind) for kind in ("effort", "damping", "friction")}
    return UsdAsMjcf(
        path=path,
        spec=spec,
        files=(path,),
        notes=notes,
        unknown={kind: names for kind, names in unknown.items() if names},
        _model=compile_spec(spec.copy(), path),
        stands_for=STANDS_FOR,
        gains=model.gains,
        usd=file,
    )


def joints_without(model: UsdModel, kind: str) -> tuple[str, ...]:
    """Returns the joints of which a number is not known."""
    return tuple(n for n, joint in model.joints.items() if joint.moves and kind not in joint.stated)


def mjspec_of(model: UsdModel) -> mujoco.MjSpec:
    """Writes a model as a spec: bodies, joints, inertials, couplings and gravity; no shapes.

    Raises:
        ModelError: If a joint moves in a way that MuJoCo has no joint for.
    """
    spec = mujoco.MjSpec()
    spec.modelname = model.file.path.stem
    spec.compiler.degree = False
    if model.gravity is not None:
        spec.option.gravity = model.gravity
    inertials = _acceptable(model)
    bodies: dict[str, mujoco.MjsBody] = {}
    for name, link in model.links.items():
        above = bodies.get(link.parent or "", spec.worldbody)
        outer = model.links[link.parent].pose if link.parent else model.mount.inverse()
        pose = outer.inverse() * link.pose
        body = above.add_body(
            name=name, pos=pose.position, quat=quaternion_from_rotation(pose.rotation)
        )
        bodies[name] = body
        inertial = inertials.get(name)
        if inertial is not None:
            if not _is_taken(inertial):
                message = diagnose(
                    "usd-inertia-of-no-body", moments=Vector(tuple(inertial.moments), "kg m^2")
                )
                raise make_file_error(model.file.place("body", name), message)
            set_inertia(body, inertial.rigid)
        _add_joints(model, link, body)
    for edge in model.loops:
        _close(model, spec, edge)
    for edge in model.edges.values():
        if edge.mimic is not None and edge.mimic[0] in model.joints:
            SpecTree(spec).add_coupling(edge.name, *edge.mimic).name = f"{edge.name}_mimic"
    return spec


def _add_joints(model: UsdModel, link: Link, body: mujoco.MjsBody) -> None:
    inverse = link.pose.inverse()
    for joint in link.joints:
        if joint.kind == FIXED:
            continue
        if joint.kind == FREE and link.parent is not None:
            place = model.file.place("joint", joint.name)
            raise make_file_error(place, diagnose("usd-joint-of-several-axes"))
        added = body.add_joint(name=joint.name, type=_TYPES[joint.kind])
        if not joint.moves:
            continue
        added.pos = inverse.point(joint.position)
        added.axis = inverse.rotation @ joint.axis
        if math.isfinite(joint.lower) or math.isfinite(joint.upper):
            added.limited = mujoco.mjtLimited.mjLIMITED_TRUE
            lower, upper = np.clip((joint.lower, joint.upper), -_NO_LIMIT, _NO_LIMIT)
            added.range = lower, upper + (MIN_RANGE if lower == upper else 0.0)
        for kind in ("armature", "damping", "friction", "spring", "effort"):
            if kind in joint.stated:
                state_number(added, BY_KIND[kind], joint.stated[kind])


_NO_LIMIT = 1e6
"""rad, m: where MuJoCo wants two limits, and a joint has one."""


def _acceptable(model: UsdModel) -> dict[str, Inertial]:
    """Returns the inertials of bodies, such that MuJoCo takes them.

    MuJoCo refuses the inertia of a rod without width even on a body that is fixed to the trunk:
    what is fixed together has one inertia, on the body that moves it.
    """
    found: dict[str, Inertial] = {}
    for name, link in model.links.items():
        if link.parent is not None and not link.moving:
            continue
        parts = [
            (part, part.inertial)
            for part in model.fixed_group(name)
            if part.inertial is not None and part.inertial.mass != 0
        ]
        if len(parts) == 1 and parts[0][0] is link:
            found[name] = _rounded(parts[0][1])
        elif parts:
            inverse = link.pose.inverse()
            rigid = [(inverse * part.pose).placed.act(one.rigid) for part, one in parts]
            whole = sum(rigid, pin.Inertia.Zero())
            found[name] = _rounded(Inertial.of(whole, stated=True))
    return found


def _rounded(inertial: Inertial) -> Inertial:
    """Returns an inertial whose moments keep the triangle inequality, if but for rounding.

    A thin plate has I1 + I2 = I3, and in single precision one that is greater by a last digit.
    """
    moments, axes = np.linalg.eigh(inertial.inertia)
    excess = moments[2] - moments[0] - moments[1]
    if not 0 < excess <= _PLATE * moments[2]:
        return inertial
    moments[:2] += excess
    return replace(inertial, inertia=axes @ np.diag(moments) @ axes.T)


_PLATE = 1e-6
"""Relative: some last digits in single precision, and less than files are compared by."""


def _is_taken(inertial: Inertial) -> bool:
    """Says whether MuJoCo takes an inertia: positive, and of a body that there can be."""
    least, middle, greatest = inertial.moments
    tiny = 1e-15  # mjMINVAL
    return bool(inertial.mass > tiny and least > tiny and least + middle >= greatest)


def _close(model: UsdModel, spec: mujoco.MjSpec, edge: Edge) -> None:
    """Adds what a joint holds together that closes a loop: a frame, or, if it moves, a point.

    No URDF has it, so that it is a difference in any case.
    """
    one, two = edge.bodies
    if not (one and two) or edge.kind in (SLIDE, FREE):
        raise make_file_error(model.file.place("joint", edge.name), diagnose("usd-loop-of-slide"))
    weld = edge.kind == FIXED
    equality = spec.add_equality(name=edge.name, name1=one, name2=two)
    equality.objtype = mujoco.mjtObj.mjOBJ_BODY
    equality.type = mujoco.mjtEq.mjEQ_WELD if weld else mujoco.mjtEq.mjEQ_CONNECT
    if weld:
        between = edge.frames[0] * edge.frames[1].inverse()
        equality.data[3:6] = between.position
        equality.data[6:10] = quaternion_from_rotation(between.rotation)
    else:
        equality.data[:3] = edge.frames[0].position


def notes_of(model: UsdModel) -> Iterator[Diagnostic]:
    """Yields what a comparison rests on that the file does not state.

    Raises:
        ModelError: If what a body weighs would follow from its shapes.
    """
    by_shapes = [n for n, w in model.weights.items() if w.origin in (Origin.WATER, Origin.SHAPES)]
    if by_shapes:
        place = model.file.place("body", by_shapes[0])
        raise make_file_error(place, diagnose("usd-weighed-by-shapes", names=by_shapes))
    unknown = [name for name, one in model.weights.items() if one.inertial is None]
    if unknown:
        yield diagnose("usd-masses-unknown", names=unknown)


CONTRADICTION = 1e-3
"""Relative: one schema has single precision, 1e-7, and some writers five digits."""


def mass_of_water(robot: UsdModel) -> Iterator[CheckFinding]:
    """Finds bodies whose mass, or some of it, is of shapes without any stated density."""
    for name, weighed in robot.weights.items():
        if weighed.origin is Origin.WATER:
            yield CheckFinding(robot.link_tag, name, diagnose("mass-of-water"))


def mass_unstated(robot: UsdModel) -> Iterator[CheckFinding]:
    """Finds bodies of whose mass nothing is known; NOTE of those that are fixed to another."""
    for name, weighed in robot.weights.items():
        if weighed.origin is Origin.UNKNOWN:
            alone = robot.links[name].moving or robot.links[name].parent is None
            message = diagnose("mass-unstated")
            yield CheckFinding(
                robot.link_tag, name, message, severity=None if alone else Severity.NOTE
            )


def inertia_unstated(robot: UsdModel) -> Iterator[CheckFinding]:
    """Finds bodies that leave mass, com or inertia to their shapes; WARNING of a com alone."""
    for name, weighed in robot.weights.items():
        if weighed.origin is Origin.SHAPES:
            message = diagnose("inertia-unstated", lacks=[Term(what) for what in weighed.lacks])
            severity = Severity.WARNING if weighed.lacks == ("com",) else None
            yield CheckFinding(robot.link_tag, name, message, severity=severity)


def joint_numbers_contradict(robot: UsdModel) -> Iterator[CheckFinding]:
    """Compares the numbers of a joint that several schemas state."""
    for name, edge in robot.edges.items():
        for kind, stated in edge.stated.items():
            values = np.array(list(stated.values()))
            if kind == "effort":
                continue  # each is a limit: of a motor, of the joint
            if np.ptp(values) <= CONTRADICTION * np.abs(values).max():
                continue
            first, last = min(stated, key=stated.__getitem__), max(stated, key=stated.__getitem__)
            unit = BY_KIND[kind].unit(edge.kind == SLIDE)
            message = diagnose(
                "joint-numbers-contradict",
                one=first,
                first=Quantity(stated[first], unit),
                two=last,
                last=Quantity(stated[last], unit),
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
"""{rule: what looks for it}."""
