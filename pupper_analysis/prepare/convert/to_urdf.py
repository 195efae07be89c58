"""Convert an MJCF, as compiled by MuJoCo, to a URDF; select a robot of an MJCF with several.

Input is an MJCF; output is a `ConvertedUrdf` with links, shapes and mimic joints. A link frame of
the URDF is at the last hinge or slide of the body, if any, because a joint of a URDF moves about
the origin of the child link. Notes report parts that a URDF cannot contain, such as equalities.
"""

from __future__ import annotations

import math
import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
from lxml import etree

from pupper_analysis.base.arrays import INERTIA_ENTRIES, make_placement
from pupper_analysis.base.diagnostics import (
    Diagnostic,
    Quantity,
    Severity,
    Term,
    diagnose,
)
from pupper_analysis.base.errors import ModelError, UnknownNameError
from pupper_analysis.models.attributes import MIN_UNSTATED_LIMIT, PASSIVE_ATTRIBUTES
from pupper_analysis.models.conversion import inertia_of_body, split_joint_placement
from pupper_analysis.models.efforts import find_effort, resolve_effort_limit
from pupper_analysis.models.mjcf import JointKind, compile_spec, has_free_joint, list_free_joints
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.shapes import read_shape
from pupper_analysis.models.spec_tree import join_free_base
from pupper_analysis.models.urdf_file import MAX_SLIDE_POSITION
from pupper_analysis.models.urdf_tree import UrdfJoint, UrdfLink, UrdfTree, set_origin
from pupper_analysis.models.xml import (
    NUM_DIGITS,
    add_element,
    join_numbers,
    make_unique_name,
    new_file_text,
)

_DEFAULT_VELOCITY_LIMIT = 100.0
"""Velocity limit that is written for each joint that moves [rad/s, m/s]: a URDF requires a limit,
and an MJCF has none. Chosen, not tuned."""


@dataclass
class UrdfLinks:
    """Converter from the bodies and joints of a MuJoCo model to links and joints of a URDF.

    A joint of a URDF moves about the origin of the child link. The frame of a link is therefore at
    the last hinge or slide of the body, with the axes of the body; without any, the body's frame.

    Attributes:
        file: MJCF.
        model: Compiled model.
        tree: URDF; links and joints are added in place.
        shapes: Converter of the shapes.
        fix_balls: True to fix a ball joint at the reference position, if the body has no other
            joint. False to refuse ball joints.
        left: Notes on parts of the MJCF that were left out, since a URDF cannot express them.
        links: {body id: (name of the link, pose of the body's frame in the link's frame)}.
        unlimited: Number of joints without a finite effort limit.
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
        """Convert the bodies of a robot, from the base on, to links and joints of the URDF.

        A link ``world`` may be added above the base.

        Args:
            base: Id of the base body.

        Raises:
            ModelError: If a descendant has a free joint, for example.
        """
        model = self.model
        name = self._make_link_name(base)
        free = base in model.jnt_bodyid[list_free_joints(model)]
        if free or model.body_jntnum[base] == 0:
            placed = make_placement(model.body_quat[base], model.body_pos[base])
            if not free and not placed.isIdentity(1e-12):
                world = make_unique_name("world", self._names)
                self._add_frame(world)
                self._add_joint(f"{world}_to_{name}", "fixed", world, name, placed)
            self._add_link(base, name, pin.SE3.Identity())
        else:
            world = make_unique_name("world", self._names)
            self._add_frame(world)
            self._add_body(base, name, world, pin.SE3.Identity())
        for body in range(base + 1, model.nbody):
            parent = int(model.body_parentid[body])
            if parent in self.links:
                link, inside = self.links[parent]
                self._add_body(body, self._make_link_name(body), link, inside)

    def _add_body(self, body: int, name: str, parent: str, inside: pin.SE3) -> None:
        """Add the link of a body to the URDF, and the joints that connect it to the parent link.

        ``name`` is the name of the link. ``inside`` is the pose of the parent body's frame in the
        parent link's frame.
        """
        model = self.model
        placement = inside * make_placement(model.body_quat[body], model.body_pos[body])
        first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        fixed = self.fix_balls and count == 1 and model.jnt_type[first] == JointKind.BALL
        if count == 0 or fixed:
            self._add_joint(
                self._make_joint_name(f"{name}_fixed"), "fixed", parent, name, placement
            )
            self._add_link(body, name, pin.SE3.Identity())
            return
        for joint in range(first, first + count):
            last = joint == first + count - 1
            child = name if last else self._make_free_name(f"{name}_{joint - first + 1}")
            kind = int(model.jnt_type[joint])
            if kind in (JointKind.FREE, JointKind.BALL):
                subject = "body", model.body(body).name
                problem = diagnose(
                    "joint-not-in-urdf", subject=subject, ball=kind == JointKind.BALL
                )
                raise ModelError(self.file.path, problem)
            at_zero, within = split_joint_placement(model, joint)
            self._add_movable_joint(joint, parent, child, placement * at_zero)
            placement, parent = within, child
            if not last:
                self._add_frame(child)
        self._add_link(body, name, placement)

    def _add_movable_joint(self, joint: int, parent: str, child: str, placed: pin.SE3) -> None:
        """Add a hinge or slide to the URDF, with limits, damping and friction.

        ``joint`` is the MuJoCo id. ``placed`` is the pose of the child link's frame in the parent
        link's frame.
        """
        model = self.model
        limited = bool(model.jnt_limited[joint])
        hinge = int(model.jnt_type[joint]) == JointKind.HINGE
        kind = ("revolute" if limited else "continuous") if hinge else "prismatic"
        name = self._make_joint_name(model.joint(joint).name or f"{child}_joint")
        urdf_joint = self._add_joint(name, kind, parent, child, placed)
        urdf_joint.add_axis(model.jnt_axis[joint], NUM_DIGITS)
        node = urdf_joint.element
        effort = find_effort(model, joint)
        limit = add_element(
            node,
            "limit",
            effort=join_numbers(effort if math.isfinite(effort) else MIN_UNSTATED_LIMIT),
            velocity=join_numbers(_DEFAULT_VELOCITY_LIMIT),
        )
        efforts = resolve_effort_limit(model, joint)
        if math.isfinite(effort) and not math.isclose(-efforts.lower, efforts.upper):
            note = diagnose(
                "range-becomes-effort",
                subject=("joint", name),
                lower=Quantity(efforts.lower, efforts.unit),
                upper=Quantity(efforts.upper, efforts.unit),
                effort=Quantity(effort, efforts.unit),
            )
            self.left.append(note)
        if limited:
            low, high = model.jnt_range[joint].tolist()
            limit.set("lower", join_numbers(low))
            limit.set("upper", join_numbers(high))
        elif kind == "prismatic":
            limit.set("lower", join_numbers(-MAX_SLIDE_POSITION))
            limit.set("upper", join_numbers(MAX_SLIDE_POSITION))
            limit_position = Quantity(MAX_SLIDE_POSITION, "m")
            self.left.append(
                diagnose("slide-without-limits", subject=("joint", name), limit=limit_position)
            )
        dof = int(model.jnt_dofadr[joint])
        passive = {
            attribute.urdf[1]: float(getattr(model, attribute.mujoco)[dof])
            for attribute in PASSIVE_ATTRIBUTES
            if attribute.urdf and attribute.mujoco
        }
        if any(passive.values()):
            stated = {word: join_numbers(value) for word, value in passive.items()}
            add_element(node, "dynamics", **stated)
        if not math.isfinite(effort):
            self.unlimited += 1

    def _add_link(self, body: int, name: str, inside: pin.SE3) -> None:
        """Add the link of a body to the URDF, with inertial and shapes.

        ``inside`` is the pose of the body frame in the link frame.
        """
        model = self.model
        self.links[body] = name, inside
        link = self.tree.new_link(name)
        if model.body_mass[body] > 0:
            link.set_inertia(inside.act(inertia_of_body(model, body)), NUM_DIGITS)
        else:
            _set_zero_inertial(link)
        self.shapes.add(link.element, body, inside)

    def add_sites(self) -> None:
        """Add the named sites of the converted bodies to the URDF, as links without mass.

        A site with the name of a link is left out, with a note.
        """
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
            self._add_frame(name)
            self._add_joint(self._make_joint_name(f"{name}_fixed"), "fixed", link, name, placed)

    def _add_frame(self, name: str) -> None:
        """Add a link without mass and shapes to the URDF, which serves as a frame."""
        _set_zero_inertial(self.tree.new_link(name))

    def _add_joint(
        self, name: str, kind: str, parent: str, child: str, placed: pin.SE3
    ) -> UrdfJoint:
        """Add a joint of type ``kind``, such as ``revolute``, to the URDF.

        ``placed`` is the pose of the child link's frame in the parent link's frame.
        """
        return self.tree.new_joint(name, kind, parent, child, placed, NUM_DIGITS)

    def _make_link_name(self, body: int) -> str:
        """Return a unique link name for a body: the body's name, or ``body_ID`` without a name."""
        return self._make_free_name(str(self.model.body(body).name) or f"body_{body}")

    def _make_free_name(self, wanted: str) -> str:
        """Reserve a unique link name: ``wanted``, with a suffix if a link of this name exists."""
        return make_unique_name(wanted, self._names)

    def _make_joint_name(self, wanted: str) -> str:
        """Reserve a unique joint name: ``wanted``, with a suffix if a joint of this name exists."""
        return make_unique_name(wanted, self._joint_names)


@dataclass(frozen=True)
class ConvertedUrdf:
    """URDF that was converted from an MJCF: links, shapes and couplings, with notes.

    Attributes:
        source: File name of the MJCF.
        model: Compiled model of the MJCF.
        tree: URDF.
        bodies: Ids of the bodies that became links.
        notes: Notes on assumptions.
        left: Notes on parts that a URDF cannot express.
    """

    source: str
    model: mujoco.MjModel
    tree: UrdfTree
    bodies: frozenset[int]
    notes: tuple[Diagnostic, ...]
    left: tuple[Diagnostic, ...]

    @staticmethod
    def from_mjcf(file: MjcfFile, output: Path, *, fix_balls: bool = False) -> ConvertedUrdf:
        """Convert the links, shapes and couplings of an MJCF to a URDF.

        Args:
            file: MJCF.
            output: Path of the URDF; mesh paths are relative to the folder of this path.
            fix_balls: True to fix a ball joint at the reference position, if the body has no other
                joint. False to refuse ball joints.

        Raises:
            ModelError: If a URDF cannot represent the robot, for example.
        """
        spec = file.spec.copy()
        joined = join_free_base(spec)
        notes = [*file.notes, *([joined] if joined else [])]
        model = compile_spec(spec, file.path) if joined else file.model
        tree = UrdfTree(etree.Element("robot", name=str(file.spec.modelname) or file.path.stem))
        shapes = UrdfShapes(file, model, output.resolve().parent)
        links = UrdfLinks(file, model, tree, shapes, fix_balls)
        links.add(find_root_body(file, model))
        links.add_sites()
        left = [*links.left, *shapes.left, *_add_couplings(tree, model)]
        if links.unlimited:
            left.append(diagnose("joints-without-effort-limit", count=links.unlimited))
        if has_free_joint(model):
            notes.append(diagnose("free-base-not-in-urdf"))
        bodies = frozenset(links.links)
        return ConvertedUrdf(file.path.name, model, tree, bodies, tuple(notes), tuple(left))

    @property
    def text(self) -> str:
        """XML text of the converted URDF."""
        return new_file_text(self.tree.root, f"Converted from {self.source} by pupper-analysis.")


def _set_zero_inertial(link: UrdfLink) -> None:
    """Add an inertial with zero mass to a link.

    Reason: PyBullet assumes 1 kg for a link without inertial.
    """
    inertial = add_element(link.element, "inertial")
    add_element(inertial, "mass", value="0")
    add_element(inertial, "inertia", **dict.fromkeys(INERTIA_ENTRIES, "0"))


def _add_couplings(tree: UrdfTree, model: mujoco.MjModel) -> list[Diagnostic]:
    """Add a <mimic> for active linear joint equalities; return notes on the other equalities."""
    left, joints = [], tree.joints
    for index in range(model.neq):
        kind = mujoco.mjtEq(int(model.eq_type[index]))
        name = kind.name.removeprefix("mjEQ_").lower()
        first, second = int(model.eq_obj1id[index]), int(model.eq_obj2id[index])
        polynomial = np.array(model.eq_data[index, :5])
        is_linear = kind == mujoco.mjtEq.mjEQ_JOINT and second >= 0 and not polynomial[2:].any()
        if is_linear and model.eq_active0[index]:
            follower, leader = str(model.joint(first).name), str(model.joint(second).name)
            if (
                follower in joints
                and leader in joints
                and follower != leader
                and joints[follower].mimic is None
            ):
                references = model.qpos0[model.jnt_qposadr[[first, second]]]
                offset = float(references[0] + polynomial[0] - polynomial[1] * references[1])
                joints[follower].add_mimic(leader, polynomial[1], offset, NUM_DIGITS)
                continue
        left.append(diagnose("equality-not-in-urdf", number=index + 1, kind=Term(name)))
    return left


ShapeGeometry = tuple[str, dict[str, str], pin.SE3]
"""Geometry of a URDF shape: tag, such as ``box``; attributes of the tag; and pose of the shape,
expressed in the frame of the MJCF body."""

_NUM_VISIBLE_GROUPS = 3
"""Number of geom groups that MuJoCo's viewer shows by default: groups 0, 1 and 2. The geoms of
these groups become visual shapes.
"""


class UrdfShapes:
    """Converter from geoms of a MuJoCo model to shapes of URDF links.

    Attributes:
        model: Compiled model.
        left: Notes on shapes that were left out.
    """

    def __init__(self, file: MjcfFile, model: mujoco.MjModel, folder: Path) -> None:
        """Prepare the conversion of geoms: collect the mesh files of a model.

        Args:
            file: MJCF.
            model: Compiled model.
            folder: Folder of the URDF, to which paths of mesh files are relative.
        """
        self.model, self.left = model, list[Diagnostic]()
        self._materials: dict[tuple[float, ...], str] = {}
        self._names: set[str] = set()
        self._files: dict[str, str] = {}
        self._moved_meshes: set[str] = set()
        self._lost: dict[str, str] = {}
        for mesh in file.spec.meshes:
            found, name = _find_mesh_path(file, mesh), mesh.name or Path(mesh.file).stem
            if found is None and mesh.file:
                self._lost[name] = mesh.file
            if found is not None:
                if np.any(mesh.refpos) or np.any(mesh.refquat[1:]):
                    self._moved_meshes.add(name)
                self._files[name] = Path(os.path.relpath(found, folder)).as_posix()

    def add(self, link: etree._Element, body: int, inside: pin.SE3) -> None:
        """Add the geoms of a body to a ``<link>`` as collision shapes, visual shapes, or both.

        Geoms that a URDF cannot express are left out, with a note.

        Args:
            link: Element of the link; extended in place.
            body: Id of the body.
            inside: Pose of the body's frame in the link's frame.
        """
        model = self.model
        first = int(model.body_geomadr[body])
        for geom in range(first, first + int(model.body_geomnum[body])):
            touches = bool(model.geom_contype[geom] or model.geom_conaffinity[geom])
            seen = int(model.geom_group[geom]) < _NUM_VISIBLE_GROUPS or not touches
            for tag, attributes, placed in self._convert_geom(geom):
                for kind in (("visual",) if seen else ()) + (("collision",) if touches else ()):
                    shape = add_element(link, kind)
                    set_origin(shape, inside * placed, NUM_DIGITS)
                    add_element(add_element(shape, "geometry"), tag, **attributes)
                    if kind == "visual":
                        self._add_material(shape, geom)

    def _convert_geom(self, geom: int) -> list[ShapeGeometry]:
        """Convert a geom to URDF shapes, with poses in the body frame; a capsule becomes three.

        Empty, with a note, if the geom has no equivalent in a URDF, for example.
        """
        shape = read_shape(self.model, geom)
        placed, size = shape.pose.placement, np.array(shape.size)
        match shape.kind:
            case "sphere":
                return [("sphere", {"radius": join_numbers(size[0])}, placed)]
            case "box":
                return [("box", {"size": join_numbers(2 * size)}, placed)]
            case "cylinder" | "capsule":  # a URDF has no capsule: cylinder and two spheres
                radius = join_numbers(size[0])
                tube = {"radius": radius, "length": join_numbers(2 * size[1])}
                ends = (-size[1], size[1]) if shape.kind == "capsule" else ()
                balls = [placed * pin.SE3(np.eye(3), np.array([0.0, 0.0, end])) for end in ends]
                caps = [("sphere", {"radius": radius}, ball) for ball in balls]
                return [("cylinder", tube, placed), *caps]
            case "mesh":
                return self._convert_mesh(geom, placed)
        subject = ("geom", shape.name or f"{geom}")
        self.left.append(diagnose("shape-not-in-urdf", subject=subject, kind=Term(shape.kind)))
        return []

    def _convert_mesh(self, geom: int, placed: pin.SE3) -> list[ShapeGeometry]:
        """Convert the mesh of a geom to a URDF shape; ``placed`` is the geom's pose in the body.

        Empty, with a note, if the mesh file is unknown, for example.
        """
        model = self.model
        mesh = int(model.geom_dataid[geom])
        name = str(model.mesh(mesh).name)
        if name not in self._files:
            lost = self._lost.get(name)  # the folder of an <attach>ed model is unknown
            self.left.append(diagnose("mesh-without-file", subject=("mesh", name), file=lost))
            return []
        if name in self._moved_meshes:
            self.left.append(diagnose("mesh-moved", subject=("mesh", name)))
            return []
        # MuJoCo moves a mesh to its com and principal axes, and the geom along.
        own = make_placement(model.mesh_quat[mesh], model.mesh_pos[mesh])
        scale = np.array(model.mesh_scale[mesh])
        attributes = {"filename": self._files[name]}
        if not np.array_equal(scale, np.ones(3)):
            attributes["scale"] = join_numbers(scale)
        where = placed * own.inverse()
        return [("mesh", attributes, where)]

    def _add_material(self, shape: etree._Element, geom: int) -> None:
        """Add the colour of a geom to a visual shape of the URDF, as a ``<material>``."""
        model = self.model
        material = int(model.geom_matid[geom])
        rgba = model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]
        key = tuple(float(f"{value:.4g}") for value in rgba)
        is_defined = key in self._materials
        if not is_defined:
            name = str(model.mat(material).name) if material >= 0 else "color"
            self._materials[key] = make_unique_name(name or "color", self._names)
        node = add_element(shape, "material", name=self._materials[key])
        if not is_defined:
            add_element(node, "color", rgba=join_numbers(key))


def _find_mesh_path(file: MjcfFile, mesh: mujoco.MjsMesh) -> Path | None:
    """Return the path of the file of an MJCF's mesh; None if there is no such file."""
    if not mesh.file:
        return None
    name = Path(mesh.file).name if file.spec.strippath else mesh.file
    path = file.path.resolve().parent / mesh.compiler.meshdir / name
    return path if path.is_file() else None


# Selection of one robot in an MJCF with several.


def find_root_body(file: MjcfFile, model: mujoco.MjModel) -> int:
    """Find the robot in a model: return the id of the base body, or 0 if the base is the world.

    Objects, whose only joint is a free joint, are ignored if there is a robot. A robot with a free
    base has priority over, for example, doors and drawers. Bodies of the world that are coupled
    (`_are_coupled`), such as a linkage with two fixed pivots, may be a single robot whose base is
    the world.

    Raises:
        ModelError: If there are several robots, or no joints, for example.
    """
    joints = Counter(int(model.body_rootid[body]) for body in model.jnt_bodyid)
    floating = model.jnt_bodyid[model.jnt_type == JointKind.FREE]
    free = Counter(int(model.body_rootid[body]) for body in floating)
    robots = {root: count - free[root] for root, count in joints.items() if count > free[root]}
    free_base_robots = {root: count for root, count in robots.items() if free[root]}
    found = sorted(free_base_robots if len(free_base_robots) == 1 else robots or free)
    if not found:
        raise ModelError(file.path, diagnose("no-joints"))
    if not robots and len(found) > 1:
        raise ModelError(file.path, diagnose("several-free-bodies"))
    if len(found) > 1 and _are_coupled(model, found):
        return 0
    if len(found) > 1:
        candidates = [
            diagnose(
                "robot-of-several", subject=("body", model.body(root).name), joints=robots[root]
            )
            for root in found
        ]
        raise ModelError(file.path, diagnose("several-robots", robots=candidates))
    [root] = found
    floating_bodies = [int(body) for body in floating if model.body_rootid[body] == root]
    return floating_bodies[0] if floating_bodies else root


def _are_coupled(model: mujoco.MjModel, roots: Sequence[int]) -> bool:
    """Return True if active <connect> and <weld> equalities between bodies join all ``roots``."""
    groups = {root: {root} for root in roots}
    for equality in range(model.neq):
        is_body = model.eq_objtype[equality] == mujoco.mjtObj.mjOBJ_BODY.value
        kind = mujoco.mjtEq(int(model.eq_type[equality]))
        is_rigid = kind in (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD)
        if not (is_body and is_rigid and model.eq_active0[equality]):
            continue
        ends = (model.eq_obj1id[equality], model.eq_obj2id[equality])
        first, second = (int(model.body_rootid[end]) for end in ends)
        if first in groups and second in groups:
            joined = groups[first] | groups[second]
            groups |= dict.fromkeys(joined, joined)
    return len(groups[roots[0]]) == len(roots)


def with_one_robot(file: MjcfFile, body: str | None = None) -> MjcfFile:
    """Return an MJCF with a single robot: remove the other robots and moving objects of a scene.

    Elements that refer to the removed bodies are removed, too. Bodies fixed in the world remain. If
    the base of the robot is the world, ``file`` is returned.

    Args:
        file: MJCF; not modified.
        body: Root body of the robot, or any body of the robot; None to detect the robot
            (`find_root_body`).

    Raises:
        ModelError: If ``body`` is None and there are several robots, for example.
        UnknownNameError: If there is no such body.
    """
    model = file.model
    if body is None:
        root = int(model.body_rootid[find_root_body(file, model)])
    else:
        names = [model.body(index).name for index in range(1, model.nbody)]
        if body not in names:
            raise UnknownNameError(str(file.path), "body", body, names)
        root = int(model.body_rootid[model.body(body).id])
        roots_with_joints = model.body_rootid[model.jnt_bodyid[model.jnt_type != JointKind.FREE]]
        if root not in roots_with_joints:
            raise ModelError(file.path, diagnose("body-without-joints", subject=("body", body)))
    moving = {int(model.body_rootid[index]) for index in model.jnt_bodyid}
    # A robot whose base is the world consists of all roots that move in the world.
    other_roots = sorted(moving - {root}) if root else []
    if not other_roots:
        return file
    spec = file.spec.copy()
    removed_tops = {
        index: top for index, top in _list_top_bodies(spec, model).items() if index in other_roots
    }
    kind = mujoco.mjtObj.mjOBJ_BODY
    removed_names = {
        body.name for top in removed_tops.values() for body in (top, *top.find_all(kind))
    }
    for element in (*spec.cameras, *spec.lights):
        if element.targetbody in removed_names:  # MuJoCo removes all other references
            spec.delete(element)
    for top in removed_tops.values():
        spec.delete(top)
    severity = Severity.WARNING if body is None else None  # a choice of the user is no surprise
    names = [model.body(index).name for index in other_roots]
    message = diagnose("others-left-out", bodies=names, severity=severity)
    notes: tuple[Diagnostic, ...] = (*file.notes, message)
    return replace(file, spec=spec, notes=notes, _model=compile_spec(spec.copy(), file.path))


def _list_top_bodies(spec: mujoco.MjSpec, model: mujoco.MjModel) -> dict[int, mujoco.MjsBody]:
    """Return {body id in the model: body of the spec} of the children of the world."""
    ids = np.flatnonzero(model.body_parentid[1:] == 0) + 1
    return dict(zip(map(int, ids), spec.worldbody.bodies, strict=True))
