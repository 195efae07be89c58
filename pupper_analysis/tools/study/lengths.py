"""Links of another length: geometry and mass of a robot's links, in its URDF and its MJCF alike.

A link is stretched along the line from its own joint to the next one, or to the foot that it
carries, within the plane normal to the axis there: a sideways offset stays. With the unit vector u
along that line, s the factor, and A = 1 + (s - 1) u u^T, positions become p' = A p, and, as the
density stays, m' = s m and the second moments S' = s A S A^T, where S = tr(I)/2 1 - I and
I' = tr(S') 1 - S'. What is fixed to a link is stretched with it. A shape that lies along u gets
longer; another keeps its size and moves.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import mujoco
import numpy as np
import pinocchio as pin
from lxml import etree
from numpy.typing import NDArray

from pupper_analysis.base.arrays import inertia_entries, make_inertia
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError, ModelError
from pupper_analysis.models.conversion import inertia_of_body
from pupper_analysis.models.mjcf import compile_spec
from pupper_analysis.models.spec_tree import SpecTree
from pupper_analysis.models.urdf_tree import UrdfLink, UrdfTree, origin_of, set_origin
from pupper_analysis.models.xml import parse_numbers, write_numbers
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.contact import foot_site, stand_height
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]

_ALONG = 1 - 1e-9
"""Cosine: an axis of a shape lies along the stretch, but for rounding of six printed digits."""

_SHORTEST = 1e-6
"""m: a link whose ends are nearer than this has no direction to be stretched in."""


@dataclass(frozen=True)
class Stretch:
    """A stretch in the world, at the pose of zeros.

    Attributes:
        origin: (3,) the point that stays: the origin of the URDF's link (m).
        along: (3,) the unit vector u.
        factor: s.
    """

    origin: Array
    along: Array
    factor: float

    def matrix(self, rotation: Array) -> Array:
        """Returns A (3, 3) in a frame of this rotation in the world."""
        along = rotation.T @ self.along
        made: Array = np.eye(3) + (self.factor - 1.0) * np.outer(along, along)
        return made

    def local(self, rotation: Array, position: Array) -> tuple[Array, Array]:
        """Returns A (3, 3) and b (3,) of p' = A p + b in a frame that stays where it is."""
        matrix = self.matrix(rotation)
        return matrix, (np.eye(3) - matrix) @ rotation.T @ (self.origin - position)


def find_stretch(robot: Robot, joint: str, factor: float) -> Stretch:
    """Returns the stretch of the link that a joint moves.

    Raises:
        ConfigurationError: If the link ends at no joint and no single foot, or at several joints.
    """
    urdf = UrdfTree.of(robot.description.urdf)
    name = f"length:{joint}" if joint else "length"
    if not joint:
        raise ConfigurationError(name, diagnose("base-has-no-length", base=robot.base))
    link = urdf.moved_links[joint]
    group = urdf.fixed_group(link)
    config = Configuration(robot, robot.neutral())
    own = _placed(config, link)
    ends = [one for part in group for one in urdf.below.get(part, ()) if one.moves]
    feet = [point for point, frame in robot.contact_frames.items() if frame in group]
    if len(ends) + len(feet) != 1:
        found = [*(one.name for one in ends), *feet]
        raise ConfigurationError(name, diagnose("link-without-one-end", link=link, ends=found))
    if ends:
        carrier, turning = _placed(config, ends[0].parent) * ends[0].origin, ends[0]
        end = carrier.translation
    else:
        carrier, turning = own, urdf.joints[joint]
        end = config.frame_position(robot.contact_frames[feet[0]])
    stated = turning.element.find("axis")
    axis = parse_numbers(None if stated is None else stated.get("xyz"), "1 0 0")
    normal = carrier.rotation @ _unit(axis)
    line = end - own.translation
    line = line - normal * (normal @ line)
    if np.linalg.norm(line) < _SHORTEST:
        raise ConfigurationError(name, diagnose("link-without-length", link=link))
    return Stretch(np.array(own.translation), _unit(line), factor)


def _placed(config: Configuration, link: str) -> pin.SE3:
    return pin.SE3(config.frame_rotation(link), config.frame_position(link))


def _unit(vector: Array) -> Array:
    unit: Array = np.array(vector) / np.linalg.norm(vector)
    return unit


def stretch_links(
    robot: Robot, trees: tuple[UrdfTree, SpecTree], factors: Mapping[str, float]
) -> float:
    """Stretches links in both files, in place; keyframes keep their clearance of the ground.

    Args:
        robot: The robot of which the files are.
        trees: Of the URDF and of the MJCF.
        factors: {joint: factor on the length of the link that it moves}.

    Returns:
        The base's height in the nominal stand (m): with all joints where they were in it, or, where
        it is not the keyframe's, in the same proportion.

    Raises:
        ConfigurationError: If a link has no length.
        ModelError: If a mesh cannot be stretched so.
    """
    urdf, mjcf = trees
    source = robot.description.mjcf_source
    config, data = Configuration(robot, robot.neutral()), mujoco.MjData(robot.mj_model)
    robot.mj_convention.set_state(data, robot.neutral())
    mujoco.mj_kinematics(robot.mj_model, data)
    weighed = compile_spec(mjcf.spec.copy(), source)  # masses may have changed before
    meshes: dict[str, list[tuple[mujoco.MjsGeom, Array]]] = {}
    for joint, factor in factors.items():
        stretch = find_stretch(robot, joint, factor)
        link = urdf.moved_links[joint]
        for part in urdf.fixed_group(link):
            at = _placed(config, part)
            matrix, shift = stretch.local(at.rotation, at.translation)
            if part != link:  # its frame has moved with what carries it
                shift = np.zeros(3)
            _stretch_link(urdf, part, matrix, shift, factor)
        body = mjcf.moved_by(joint)
        assert body is not None
        for part in mjcf.fixed_group(body):
            at = data.body(part)
            rotation = at.xmat.reshape(3, 3)
            matrix, shift = stretch.local(rotation, at.xpos)
            if part != body:
                shift = np.zeros(3)
            inertia = inertia_of_body(weighed, weighed.body(part).id)
            _stretch_body(mjcf.spec.body(part), inertia, (matrix, shift), factor, meshes)
    _stretch_meshes(mjcf.spec, meshes)
    return _raise_keyframes(robot, mjcf.spec)


def stretch_inertia(inertia: pin.Inertia, matrix: Array, shift: Array, s: float) -> pin.Inertia:
    """Returns what a link weighs that is stretched, p' = A p + b, at the same density."""
    tensor = np.array(inertia.inertia)
    second = s * matrix @ (np.trace(tensor) / 2 * np.eye(3) - tensor) @ matrix.T
    lever = matrix @ inertia.lever + shift
    return make_inertia(s * inertia.mass, lever, np.trace(second) * np.eye(3) - second)


def _sizes(matrix: Array, rotation: Array) -> Array | None:
    """Returns by how much a shape grows along each of its axes; None: it has none along u."""
    local = rotation.T @ matrix @ rotation
    growth = np.diag(local)
    return growth if np.abs(local - np.diag(growth)).max() < 1e-9 else None


# In a URDF.


def _stretch_link(urdf: UrdfTree, name: str, matrix: Array, shift: Array, factor: float) -> None:
    link: UrdfLink = urdf.links[name]
    inertia = link.inertia
    if inertia is not None:
        link.set_inertia(stretch_inertia(inertia, matrix, shift, factor))
    for joint in urdf.below.get(name, ()):
        _move(joint.element, matrix, shift)
    for _, shape, form in link.shapes:
        if form is not None:
            _stretch_form(form, _sizes(matrix, np.array(origin_of(shape).rotation)), name)
        _move(shape, matrix, shift)


def _move(element: etree._Element, matrix: Array, shift: Array) -> None:
    placed = origin_of(element)
    set_origin(element, pin.SE3(placed.rotation, matrix @ placed.translation + shift))


def _stretch_form(form: etree._Element, growth: Array | None, link: str) -> None:
    words: dict[object, tuple[str, Callable[[Array], Array]]] = {
        "box": ("size", lambda one: one),
        "mesh": ("scale", lambda one: one),
        "cylinder": ("length", lambda one: one[2:]),
        "capsule": ("length", lambda one: one[2:]),
    }
    if form.tag not in words:
        return
    if growth is None:
        if form.tag == "mesh":
            raise ModelError(
                form.get("filename") or link, diagnose("mesh-without-axis", along=link)
            )
        return
    word, part = words[form.tag]
    old = parse_numbers(form.get(word) or None, "1 1 1")
    form.set(word, write_numbers(old * part(growth), digits=None))


# In an MJCF.


def _stretch_body(
    body: mujoco.MjsBody,
    inertia: pin.Inertia,
    moved: tuple[Array, Array],
    factor: float,
    meshes: dict[str, list[tuple[mujoco.MjsGeom, Array]]],
) -> None:
    matrix, shift = moved
    if inertia.mass > 0:
        made = stretch_inertia(inertia, matrix, shift, factor)
        body.explicitinertial, body.mass = True, float(made.mass)
        body.ipos, body.iquat = np.array(made.lever), (1.0, 0.0, 0.0, 0.0)
        body.inertia = np.zeros(3)  # MuJoCo takes either, and not both
        body.fullinertia = inertia_entries(np.array(made.inertia))
    for part in (*body.bodies, *body.sites, *body.cameras):
        part.pos = matrix @ np.array(part.pos) + shift
    for geom in body.geoms:
        _stretch_geom(geom, matrix, shift, meshes)


def _stretch_geom(
    geom: mujoco.MjsGeom,
    matrix: Array,
    shift: Array,
    meshes: dict[str, list[tuple[mujoco.MjsGeom, Array]]],
) -> None:
    if not np.isnan(geom.fromto[0]):
        ends = np.array(geom.fromto)
        geom.fromto = np.concatenate([matrix @ end + shift for end in (ends[:3], ends[3:])])
        return
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, _unit(geom.quat))
    growth = _sizes(matrix, rotation.reshape(3, 3))
    kinds = mujoco.mjtGeom
    if geom.type == kinds.mjGEOM_MESH:
        if growth is None:
            finding = diagnose("mesh-without-axis", along=geom.parent.name)
            raise ModelError(geom.meshname, finding)
        meshes.setdefault(geom.meshname, []).append((geom, growth.copy()))
    elif growth is not None and geom.type == kinds.mjGEOM_BOX:
        geom.size = np.array(geom.size) * growth
    elif growth is not None and geom.type in (kinds.mjGEOM_CAPSULE, kinds.mjGEOM_CYLINDER):
        geom.size = np.array(geom.size) * (1.0, growth[2], 1.0)
    geom.pos = matrix @ np.array(geom.pos) + shift


def _stretch_meshes(
    spec: mujoco.MjSpec, meshes: Mapping[str, list[tuple[mujoco.MjsGeom, Array]]]
) -> None:
    """Gives each stretch of a mesh an asset of its own, unless all that is made of it has one."""
    for name, users in meshes.items():
        mesh = spec.mesh(name)
        scale, file = np.array(mesh.scale), mesh.file
        count = sum(geom.meshname == name for geom in spec.geoms)
        kinds = {tuple(growth): growth for _, growth in users}
        if len(kinds) == 1 and count == len(users):
            mesh.scale = scale * next(iter(kinds.values()))
            continue
        for number, (key, growth) in enumerate(kinds.items()):
            own = f"{name}_stretched{number or ''}"
            made = spec.add_mesh(name=own, file=file, scale=scale * growth)
            made.refpos, made.refquat = np.array(mesh.refpos), np.array(mesh.refquat)
            made.inertia = mesh.inertia
            for geom, one in users:
                if tuple(one) == key:
                    geom.meshname = own


def _raise_keyframes(robot: Robot, spec: mujoco.MjSpec) -> float:
    """Keeps keyframes' clearance of the ground; returns the new height of the nominal stand."""
    description = robot.description
    before, after = robot.mj_model, compile_spec(spec.copy(), description.mjcf_source)

    def height(model: mujoco.MjModel, qpos: Array) -> float:
        places = {
            point: foot_site(model, frame, description.mjcf_source)
            for point, (_, frame) in description.contact_points.items()
        }
        return stand_height(model, robot.mj_base, places, robot.contact_radius, qpos, None)

    if not robot.floating or not robot.contact_points:
        return robot.stand_height
    free = int(before.jnt_qposadr[np.flatnonzero(before.jnt_type == 0)[0]])
    base = spec.body(robot.mj_base)  # where it is without a keyframe
    raised = height(after, before.qpos0) - height(before, before.qpos0)
    base.pos = np.array(base.pos) + np.array([0.0, 0.0, raised])
    for key in spec.keys:
        if len(key.qpos) == before.nq:
            qpos = np.array(key.qpos)
            qpos[free + 2] += height(after, qpos) - height(before, qpos)
            key.qpos = qpos
    data = mujoco.MjData(before)
    robot.mj_convention.set_state(data, robot.home)
    radius = max(robot.contact_radius.values())
    old, new = (height(model, np.array(data.qpos)) - radius for model in (before, after))
    return radius + (robot.stand_height - radius) * new / old
