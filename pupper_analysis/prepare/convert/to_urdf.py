"""An MJCF as a URDF: what MuJoCo compiles of it, link by link."""

from __future__ import annotations

import math
import os
from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
from lxml import etree
from numpy.typing import NDArray

from pupper_analysis.base.arrays import INERTIA_ENTRIES, make_placement
from pupper_analysis.base.diagnostics import (
    Diagnostic,
    Quantity,
    Term,
    diagnose,
)
from pupper_analysis.base.errors import ModelError, UnknownNameError
from pupper_analysis.models.attributes import PASSIVE_ATTRIBUTES, UNSTATED
from pupper_analysis.models.conversion import inertia_of_body, places_of_joint
from pupper_analysis.models.efforts import find_max_effort
from pupper_analysis.models.mjcf import JointKind, compile_spec, free_joints, has_free_joint
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.shapes import read_shape
from pupper_analysis.models.spec_tree import join_free_base
from pupper_analysis.models.urdf_file import MAX_SLIDE_POSITION
from pupper_analysis.models.urdf_tree import UrdfJoint, UrdfLink, UrdfTree, set_origin
from pupper_analysis.models.xml import (
    NUM_DIGITS,
    add_element,
    make_unique_name,
    new_file_text,
    write_numbers,
)

Array = NDArray[np.float64]

_UNKNOWN_VELOCITY = 100.0
"""Velocity limit of joints (rad/s): no MJCF states one, and every URDF must; beyond any motor's."""


@dataclass
class UrdfLinks:
    """Makes the links and joints of a URDF from a compiled MuJoCo model.

    A link's frame is at the joint that moves it, with the body's axes: a URDF's joints turn about
    the origin of what they move.

    Attributes:
        file: The MJCF.
        model: What MuJoCo compiles it to.
        tree: The URDF.
        shapes: Makes its shapes.
        fix_balls: Whether ball joints are fixed at rest; else they are refused.
        left: What a URDF cannot say.
        links: {body: (its link, where the body's frame is in the link's)}.
    """

    file: MjcfFile
    model: mujoco.MjModel
    tree: UrdfTree
    shapes: UrdfShapes
    fix_balls: bool = False
    left: list[Diagnostic] = field(default_factory=list)
    links: dict[int, tuple[str, pin.SE3]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._names: set[str] = set()
        self._joint_names: set[str] = set()
        self.unlimited = 0

    def add(self, base: int) -> None:
        """Adds the links of a body and all below it.

        Args:
            base: The body's id: the base.

        Raises:
            ModelError: If it has a ball joint, or a free one that is not the base's.
        """
        model = self.model
        name = self._link_name(base)
        free = base in model.jnt_bodyid[free_joints(model)]
        if free or model.body_jntnum[base] == 0:
            placed = make_placement(model.body_quat[base], model.body_pos[base])
            if not free and not placed.isIdentity(1e-12):
                world = make_unique_name("world", self._names)
                self._frame(world)
                self._joint(f"{world}_to_{name}", "fixed", world, name, placed)
            self._link(base, name, pin.SE3.Identity())
        else:
            world = make_unique_name("world", self._names)
            self._frame(world)
            self._moved(base, name, world, pin.SE3.Identity())
        for body in range(base + 1, model.nbody):
            parent = int(model.body_parentid[body])
            if parent in self.links:
                link, inside = self.links[parent]
                self._moved(body, self._link_name(body), link, inside)

    def _moved(self, body: int, name: str, parent: str, inside: pin.SE3) -> None:
        """Adds a body's joints and its link.

        Args:
            body: The body.
            name: Its link.
            parent: The link that carries it.
            inside: Where the parent body's frame is in that link.
        """
        model = self.model
        placement = inside * make_placement(model.body_quat[body], model.body_pos[body])
        first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        fixed = self.fix_balls and count == 1 and model.jnt_type[first] == JointKind.BALL
        if count == 0 or fixed:
            self._joint(self._joint_name(f"{name}_fixed"), "fixed", parent, name, placement)
            self._link(body, name, pin.SE3.Identity())
            return
        for joint in range(first, first + count):
            last = joint == first + count - 1
            child = name if last else self._free(f"{name}_{joint - first + 1}")
            kind = int(model.jnt_type[joint])
            if kind in (JointKind.FREE, JointKind.BALL):
                moved = "body", model.body(body).name
                problem = diagnose("joint-not-in-urdf", subject=moved, ball=kind == JointKind.BALL)
                raise ModelError(self.file.path, problem)
            at_zero, within = places_of_joint(model, joint)
            self._movable(joint, parent, child, placement * at_zero)
            placement, parent = within, child
            if not last:
                self._frame(child)
        self._link(body, name, placement)

    def _movable(self, joint: int, parent: str, child: str, placed: pin.SE3) -> None:
        model = self.model
        limited = bool(model.jnt_limited[joint])
        hinge = int(model.jnt_type[joint]) == JointKind.HINGE
        kind = ("revolute" if limited else "continuous") if hinge else "prismatic"
        name = self._joint_name(model.joint(joint).name or f"{child}_joint")
        made = self._joint(name, kind, parent, child, placed)
        made.set_axis(model.jnt_axis[joint], NUM_DIGITS)
        node = made.element
        effort = find_max_effort(model, joint)
        limit = add_element(
            node,
            "limit",
            effort=write_numbers(effort if math.isfinite(effort) else UNSTATED),
            velocity=write_numbers(_UNKNOWN_VELOCITY),
        )
        if limited:
            low, high = model.jnt_range[joint].tolist()
            limit.set("lower", write_numbers(low))
            limit.set("upper", write_numbers(high))
        elif kind == "prismatic":
            limit.set("lower", write_numbers(-MAX_SLIDE_POSITION))
            limit.set("upper", write_numbers(MAX_SLIDE_POSITION))
            most = Quantity(MAX_SLIDE_POSITION, "m")
            self.left.append(diagnose("slide-without-limits", subject=("joint", name), limit=most))
        dof = int(model.jnt_dofadr[joint])
        passive = {
            one.urdf[1]: float(getattr(model, one.mujoco)[dof])
            for one in PASSIVE_ATTRIBUTES
            if one.urdf and one.mujoco
        }
        if any(passive.values()):
            stated = {word: write_numbers(value) for word, value in passive.items()}
            add_element(node, "dynamics", **stated)
        if not math.isfinite(effort):
            self.unlimited += 1

    def _link(self, body: int, name: str, inside: pin.SE3) -> None:
        """Adds a body's link, with the body's frame inside the link's."""
        model = self.model
        self.links[body] = name, inside
        link = self.tree.new_link(name)
        if model.body_mass[body] > 0:
            link.set_inertia(inside.act(inertia_of_body(model, body)), NUM_DIGITS)
        else:
            _weigh_nothing(link)
        self.shapes.add(link.element, body, inside)

    def add_sites(self) -> None:
        """Adds a link without mass for every site that has a name of its own."""
        model = self.model
        for site in range(model.nsite):
            name, body = str(model.site(site).name), int(model.site_bodyid[site])
            if not name or body not in self.links:
                continue
            if name in self._names:
                self.left.append(diagnose("site-named-like-link", subject=("site", name)))
                continue
            self._names.add(name)
            link, inside = self.links[body]
            placed = inside * make_placement(model.site_quat[site], model.site_pos[site])
            self._frame(name)
            self._joint(self._joint_name(f"{name}_fixed"), "fixed", link, name, placed)

    def _frame(self, name: str) -> None:
        """Adds a link that is a frame alone."""
        _weigh_nothing(self.tree.new_link(name))

    def _joint(self, name: str, kind: str, parent: str, child: str, placed: pin.SE3) -> UrdfJoint:
        return self.tree.new_joint(name, kind, parent, child, placed, NUM_DIGITS)

    def _link_name(self, body: int) -> str:
        return self._free(str(self.model.body(body).name) or f"body_{body}")

    def _free(self, wanted: str) -> str:
        return make_unique_name(wanted, self._names)

    def _joint_name(self, wanted: str) -> str:
        return make_unique_name(wanted, self._joint_names)


@dataclass(frozen=True)
class ConvertedUrdf:
    """An MJCF's links, shapes and couplings as a URDF.

    Attributes:
        source: The MJCF's name.
        model: What MuJoCo compiles the MJCF to.
        tree: The URDF.
        bodies: The bodies that are links.
        notes: What was assumed.
        left: What a URDF cannot say of them.
    """

    source: str
    model: mujoco.MjModel
    tree: UrdfTree
    bodies: frozenset[int]
    notes: tuple[Diagnostic, ...]
    left: tuple[Diagnostic, ...]

    @staticmethod
    def of(file: MjcfFile, output: Path, *, fix_balls: bool = False) -> ConvertedUrdf:
        """Makes the URDF of an MJCF.

        Args:
            file: The MJCF.
            output: Where the URDF shall be: the paths of its meshes start there.
            fix_balls: Fix ball joints at rest; else they are refused.

        Raises:
            ModelError: If a URDF cannot have the robot.
        """
        spec = file.spec.copy()
        joined = join_free_base(spec)
        notes = [*file.notes, *([joined] if joined else [])]
        model = compile_spec(spec, file.path) if joined else file.model
        tree = UrdfTree(etree.Element("robot", name=str(file.spec.modelname) or file.path.stem))
        shapes = UrdfShapes(file, model, output.resolve().parent)
        links = UrdfLinks(file, model, tree, shapes, fix_balls)
        links.add(find_root(file, model))
        links.add_sites()
        left = [*links.left, *shapes.left, *_couplings(tree, model)]
        if links.unlimited:
            left.append(diagnose("joints-without-effort-limit", count=links.unlimited))
        if has_free_joint(model):
            notes.append(diagnose("free-base-not-in-urdf"))
        bodies = frozenset(links.links)
        return ConvertedUrdf(file.path.name, model, tree, bodies, tuple(notes), tuple(left))

    @property
    def text(self) -> str:
        """The URDF, as it is written."""
        return new_file_text(self.tree.root, f"Converted from {self.source} by pupper-analysis.")


def _weigh_nothing(link: UrdfLink) -> None:
    """States a mass of 0: PyBullet gives 1 kg to a link that states none."""
    inertial = add_element(link.element, "inertial")
    add_element(inertial, "mass", value="0")
    add_element(inertial, "inertia", **dict.fromkeys(INERTIA_ENTRIES, "0"))


def _couplings(tree: UrdfTree, model: mujoco.MjModel) -> list[Diagnostic]:
    """Writes joints that follow others as <mimic>; returns what no URDF can say."""
    left, joints = [], tree.joints
    for index in range(model.neq):
        kind = mujoco.mjtEq(int(model.eq_type[index]))
        name = kind.name.removeprefix("mjEQ_").lower()
        one, two = int(model.eq_obj1id[index]), int(model.eq_obj2id[index])
        line = np.array(model.eq_data[index, :5])
        plain = kind == mujoco.mjtEq.mjEQ_JOINT and two >= 0 and not line[2:].any()
        if plain and model.eq_active0[index]:
            follower, leader = str(model.joint(one).name), str(model.joint(two).name)
            if (
                follower in joints
                and leader in joints
                and follower != leader
                and joints[follower].mimic is None
            ):
                rest = model.qpos0[model.jnt_qposadr[[one, two]]]
                offset = float(rest[0] + line[0] - line[1] * rest[1])
                joints[follower].follow(leader, line[1], offset, NUM_DIGITS)
                continue
        left.append(diagnose("equality-not-in-urdf", number=index + 1, kind=Term(name)))
    return left


ShapeGeometry = tuple[str, dict[str, str], pin.SE3]

_SHOWN = 3
"""Geom groups below this are shown by MuJoCo's viewer by default."""


class UrdfShapes:
    """Makes the shapes of links.

    Attributes:
        left: What was left out.
    """

    def __init__(self, file: MjcfFile, model: mujoco.MjModel, folder: Path) -> None:
        """Knows the model's meshes.

        Args:
            file: The MJCF.
            model: What MuJoCo compiles it to.
            folder: Where the URDF shall be.
        """
        self.model, self.left = model, list[Diagnostic]()
        self._materials: dict[tuple[float, ...], str] = {}
        self._names: set[str] = set()
        self._files: dict[str, str] = {}
        self._moved: set[str] = set()
        self._lost: dict[str, str] = {}
        for mesh in file.spec.meshes:
            found, name = _path_of(file, mesh), mesh.name or Path(mesh.file).stem
            if found is None and mesh.file:
                self._lost[name] = mesh.file
            if found is not None:
                if np.any(mesh.refpos) or np.any(mesh.refquat[1:]):
                    self._moved.add(name)
                self._files[name] = Path(os.path.relpath(found, folder)).as_posix()

    def add(self, link: etree._Element, body: int, inside: pin.SE3) -> None:
        """Adds the shapes of a body to its link: what touches as collision, what is seen as visual.

        Args:
            link: The link's element.
            body: The body.
            inside: Where the body's frame is in the link's.
        """
        model = self.model
        first = int(model.body_geomadr[body])
        for geom in range(first, first + int(model.body_geomnum[body])):
            touches = bool(model.geom_contype[geom] or model.geom_conaffinity[geom])
            seen = int(model.geom_group[geom]) < _SHOWN or not touches
            for tag, attributes, placed in self._geometries(geom):
                for kind in (("visual",) if seen else ()) + (("collision",) if touches else ()):
                    shape = add_element(link, kind)
                    set_origin(shape, inside * placed, NUM_DIGITS)
                    add_element(add_element(shape, "geometry"), tag, **attributes)
                    if kind == "visual":
                        self._paint(shape, geom)

    def _geometries(self, geom: int) -> list[ShapeGeometry]:
        """Returns what a geom is made of in a URDF, with its placement in the body's frame."""
        shape = read_shape(self.model, geom)
        placed, size = shape.pose.placed, np.array(shape.size)
        match shape.kind:
            case "sphere":
                return [("sphere", {"radius": write_numbers(size[0])}, placed)]
            case "box":
                return [("box", {"size": write_numbers(2 * size)}, placed)]
            case "cylinder" | "capsule":  # a URDF has no capsule: their sum is the same
                radius = write_numbers(size[0])
                tube = {"radius": radius, "length": write_numbers(2 * size[1])}
                ends = (-size[1], size[1]) if shape.kind == "capsule" else ()
                balls = [placed * pin.SE3(np.eye(3), np.array([0.0, 0.0, end])) for end in ends]
                caps = [("sphere", {"radius": radius}, ball) for ball in balls]
                return [("cylinder", tube, placed), *caps]
            case "mesh":
                return self._mesh(geom, placed)
        subject = ("geom", shape.name or f"{geom}")
        self.left.append(diagnose("shape-not-in-urdf", subject=subject, kind=Term(shape.kind)))
        return []

    def _mesh(self, geom: int, placed: pin.SE3) -> list[ShapeGeometry]:
        model = self.model
        mesh = int(model.geom_dataid[geom])
        name = str(model.mesh(mesh).name)
        if name not in self._files:
            lost = self._lost.get(name)  # MuJoCo does not tell the folder of an <attach>ed model
            self.left.append(diagnose("mesh-without-file", subject=("mesh", name), file=lost))
            return []
        if name in self._moved:
            self.left.append(diagnose("mesh-moved", subject=("mesh", name)))
            return []
        # MuJoCo moves a mesh to its com and principal axes, and the geom along.
        own = make_placement(model.mesh_quat[mesh], model.mesh_pos[mesh])
        scale = np.array(model.mesh_scale[mesh])
        attributes = {"filename": self._files[name]}
        if not np.array_equal(scale, np.ones(3)):
            attributes["scale"] = write_numbers(scale)
        where = placed * own.inverse()
        return [("mesh", attributes, where)]

    def _paint(self, shape: etree._Element, geom: int) -> None:
        """Adds a visual's color: a material is defined where it is first used."""
        model = self.model
        material = int(model.geom_matid[geom])
        rgba = model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]
        key = tuple(float(f"{value:.4g}") for value in rgba)
        known = key in self._materials
        if not known:
            wanted = str(model.mat(material).name) if material >= 0 else "color"
            self._materials[key] = make_unique_name(wanted or "color", self._names)
        node = add_element(shape, "material", name=self._materials[key])
        if not known:
            add_element(node, "color", rgba=write_numbers(key))


def _path_of(file: MjcfFile, mesh: mujoco.MjsMesh) -> Path | None:
    """Returns the file of a mesh; None where there is none."""
    if not mesh.file:
        return None
    name = Path(mesh.file).name if file.spec.strippath else mesh.file
    path = file.path.resolve().parent / mesh.compiler.meshdir / name
    return path if path.is_file() else None


# One robot of an MJCF that may hold more.


def find_root(file: MjcfFile, model: mujoco.MjModel) -> int:
    """Returns the id of the body that is the robot's base, or carries all its joints.

    A body that only floats is a ball or a box to play with, if there is anything else; and one
    robot on a free base goes before what else moves in the world: doors, drawers.

    Raises:
        ModelError: If there are several robots, or none.
    """
    joints = Counter(int(model.body_rootid[body]) for body in model.jnt_bodyid)
    floating = model.jnt_bodyid[model.jnt_type == JointKind.FREE]
    free = Counter(int(model.body_rootid[body]) for body in floating)
    robots = {root: count - free[root] for root, count in joints.items() if count > free[root]}
    walking = {root: count for root, count in robots.items() if free[root]}
    found = sorted(walking if len(walking) == 1 else robots or free)
    if not found:
        raise ModelError(file.path, diagnose("no-joints"))
    if not robots and len(found) > 1:
        raise ModelError(file.path, diagnose("several-free-bodies"))
    if len(found) > 1:
        some = [
            diagnose(
                "robot-of-several", subject=("body", model.body(root).name), joints=robots[root]
            )
            for root in found
        ]
        raise ModelError(file.path, diagnose("several-robots", robots=some))
    [root] = found
    carried = [int(body) for body in floating if model.body_rootid[body] == root]
    return carried[0] if carried else root


def with_one_robot(file: MjcfFile, body: str | None = None) -> MjcfFile:
    """Returns an MJCF in which nothing moves but one robot.

    What is left out goes with its joints, actuators, sensors and couplings, and out of the
    keyframes, as MuJoCo sees to it; what stands fast in the world stays.

    Args:
        file: The MJCF, not changed.
        body: The robot's root, or any body of it; None: it is found, see ``find_root``.

    Raises:
        ModelError: If there are several robots, or none.
        UnknownNameError: If there is no such body.
    """
    model = file.model
    if body is None:
        root = int(model.body_rootid[find_root(file, model)])
    else:
        names = [model.body(index).name for index in range(1, model.nbody)]
        if body not in names:
            raise UnknownNameError(str(file.path), "body", body, names)
        root = int(model.body_rootid[model.body(body).id])
        own = model.body_rootid[model.jnt_bodyid[model.jnt_type != JointKind.FREE]]
        if root not in own:
            raise ModelError(file.path, diagnose("body-without-joints", subject=("body", body)))
    moving = {int(model.body_rootid[index]) for index in model.jnt_bodyid}
    others = sorted(moving - {root})
    if not others:
        return file
    spec = file.spec.copy()
    tops = {index: top for index, top in _tops(spec, model).items() if index in others}
    kind = mujoco.mjtObj.mjOBJ_BODY
    gone = {body.name for top in tops.values() for body in (top, *top.find_all(kind))}
    for seeing in (*spec.cameras, *spec.lights):
        if seeing.targetbody in gone:  # MuJoCo takes away what else refers to a body
            spec.delete(seeing)
    for top in tops.values():
        spec.delete(top)
    message = diagnose("others-left-out", bodies=[model.body(index).name for index in others])
    notes: tuple[Diagnostic, ...] = (*file.notes, message)
    return replace(file, spec=spec, notes=notes, _model=compile_spec(spec.copy(), file.path))


def _tops(spec: mujoco.MjSpec, model: mujoco.MjModel) -> dict[int, mujoco.MjsBody]:
    """Returns {id: body} of those that stand in the world, in the order in which both have them."""
    ids = np.flatnonzero(model.body_parentid[1:] == 0) + 1
    return dict(zip(map(int, ids), spec.worldbody.bodies, strict=True))
