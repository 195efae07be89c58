"""Stretched links: geometry, mass and inertia of the links of a robot, in the URDF and the MJCF.

A link is stretched along the line from the joint of the link to the end: the next joint, or the
foot. The component of this line along a joint axis is removed, so that a lateral offset remains.
This axis belongs to the next joint, or to the link's own joint if the line ends at a foot.

With the unit vector u of the line, the factor s and A = 1 + (s - 1) u u^T, positions become
p' = A p. The density is constant. Therefore the mass becomes m' = s m, and the second moments
become S' = s A S A^T, where S = tr(I)/2 1 - I and I' = tr(S') 1 - S'.

Links that are fixed to a stretched link are stretched as well. Boxes and meshes with a principal
axis along u, and cylinders and capsules with the axis along u, are lengthened. A mesh without such
an axis is refused. Any other primitive shape keeps the size and is moved. A geom with ``fromto`` is
different: both ends are moved, for any direction of the axis.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import mujoco
import numpy as np
import pinocchio as pin
from lxml import etree

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.arrays import inertia_entries, make_inertia
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError, ModelError
from pupper_analysis.models.conversion import inertia_of_body
from pupper_analysis.models.mjcf import compile_spec
from pupper_analysis.models.spec_tree import SpecTree
from pupper_analysis.models.urdf_tree import UrdfLink, UrdfTree, origin_of, set_origin
from pupper_analysis.models.xml import join_numbers, parse_numbers
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.contact import foot_site, stand_height
from pupper_analysis.robot.robot import Robot

_MIN_LINK_LENGTH = 1e-6
"""Minimum length [m], across the joint axis, of a link that can be stretched. A shorter link has no
defined direction. Chosen, not tuned."""


@dataclass(frozen=True)
class Stretch:
    """Linear stretch of a link, expressed in the world frame with all joints at zero.

    Attributes:
        origin: Fixed point, shape (3,) [m]: origin of the URDF's link.
        along: Unit vector u, shape (3,).
        factor: Factor s.
    """

    origin: Array
    along: Array
    factor: float

    def compute_matrix(self, rotation: Array) -> Array:
        """Compute the matrix A, shape (3, 3), of a stretch p' = A p + b in the axes of a frame.

        Args:
            rotation: Rotation from the frame to the world, shape (3, 3).
        """
        along = rotation.T @ self.along
        matrix: Array = np.eye(3) + (self.factor - 1.0) * np.outer(along, along)
        return matrix

    def express_in_frame(self, rotation: Array, position: Array) -> tuple[Array, Array]:
        """Express the stretch p' = A p + b of points p in the coordinates of a given frame.

        The frame itself is not stretched: p and p' are both coordinates in the same frame.

        Args:
            rotation: Rotation from the frame to the world, shape (3, 3).
            position: Origin of the frame in the world, shape (3,) [m].

        Returns:
            A, shape (3, 3); b, shape (3,) [m].
        """
        matrix = self.compute_matrix(rotation)
        return matrix, (np.eye(3) - matrix) @ rotation.T @ (self.origin - position)


def find_stretch(robot: Robot, joint: str, factor: float) -> Stretch:
    """Find the origin and the direction in which the link below a joint is stretched by ``factor``.

    The direction points from the joint to the end of the link: the next joint, or the foot. The
    component along an axis is removed: the axis of the next joint, or the axis of ``joint`` if the
    end is a foot.

    Raises:
        ConfigurationError: If the link has no unique end or no length, for example.
    """
    urdf = UrdfTree.of(robot.description.urdf)
    name = f"length:{joint}" if joint else "length"
    if not joint:
        raise ConfigurationError(name, diagnose("base-has-no-length", base=robot.base))
    link = urdf.moved_links[joint]
    group = urdf.fixed_group(link)
    config = Configuration(robot, robot.neutral())
    link_pose = _link_pose(config, link)
    ends = [below for part in group for below in urdf.child_joints.get(part, ()) if below.moves]
    feet = [point for point, frame in robot.contact_frames.items() if frame in group]
    if len(ends) + len(feet) != 1:
        end_names = [*(below.name for below in ends), *feet]
        raise ConfigurationError(name, diagnose("link-without-one-end", link=link, ends=end_names))
    if ends:
        end_frame, end_joint = _link_pose(config, ends[0].parent) * ends[0].origin, ends[0]
        end = end_frame.translation
    else:
        end_frame, end_joint = link_pose, urdf.joints[joint]
        end = config.frame_position(robot.contact_frames[feet[0]])
    axis_element = end_joint.element.find("axis")
    axis = parse_numbers(None if axis_element is None else axis_element.get("xyz"), "1 0 0")
    normal = end_frame.rotation @ _normalize_vector(axis)
    offset = end - link_pose.translation
    offset = offset - normal * (normal @ offset)
    if np.linalg.norm(offset) < _MIN_LINK_LENGTH:
        raise ConfigurationError(name, diagnose("link-without-length", link=link))
    return Stretch(np.array(link_pose.translation), _normalize_vector(offset), factor)


def _link_pose(config: Configuration, link: str) -> pin.SE3:
    """Return the pose of a URDF link's frame in the world: rotation, and position [m]."""
    return pin.SE3(config.frame_rotation(link), config.frame_position(link))


def _normalize_vector(vector: Array) -> Array:
    """Scale a vector to unit norm."""
    normalised: Array = np.array(vector) / np.linalg.norm(vector)
    return normalised


def evaluate_neutral_poses(robot: Robot) -> tuple[Configuration, mujoco.MjData]:
    """Evaluate the poses of all links with all joints at zero, in both engines.

    Returns:
        Pinocchio's configuration; MuJoCo's data, with kinematics.
    """
    config, data = Configuration(robot, robot.neutral()), mujoco.MjData(robot.mj_model)
    robot.mj_convention.set_state(data, robot.neutral())
    mujoco.mj_kinematics(robot.mj_model, data)
    return config, data


def stretch_links(
    robot: Robot, trees: tuple[UrdfTree, SpecTree], factors: Mapping[str, float]
) -> float:
    """Stretch links in the URDF and the MJCF in place, and return the new base height.

    The base heights of the keyframes are changed, so that the clearance above the ground is kept.

    Args:
        robot: Robot of the files.
        trees: Trees of the URDF and of the MJCF.
        factors: {joint: factor on the length of the link that the joint moves}.

    Returns:
        New base height h' of the nominal stand [m]: h' = r + (h - r) (H' - r) / (H - r). h is the
        old height, r the largest foot radius. H and H' are the base heights before and after the
        stretch, with the joints in the start pose (``Robot.home``). The height is unchanged for a
        fixed base, or without feet.

    Raises:
        ConfigurationError: If a link has no unique end or no length, for example.
        ModelError: If no axis of a mesh is along the stretch.
    """
    urdf, mjcf = trees
    source = robot.description.mjcf_source
    config, data = evaluate_neutral_poses(robot)
    model = compile_spec(
        mjcf.spec.copy(), source
    )  # compiled again: earlier factors may have changed masses
    meshes: dict[str, list[tuple[mujoco.MjsGeom, Array]]] = {}
    for joint, factor in factors.items():
        stretch = find_stretch(robot, joint, factor)
        link = urdf.moved_links[joint]
        for part in urdf.fixed_group(link):
            pose = _link_pose(config, part)
            matrix, shift = stretch.express_in_frame(pose.rotation, pose.translation)
            if part != link:  # the joint above has moved this frame already
                shift = np.zeros(3)
            _stretch_link(urdf, part, matrix, shift, factor)
        body = mjcf.moved_by(joint)
        assert body is not None
        for part in mjcf.fixed_group(body):
            pose = data.body(part)
            rotation = pose.xmat.reshape(3, 3)
            matrix, shift = stretch.express_in_frame(rotation, pose.xpos)
            if part != body:
                shift = np.zeros(3)
            inertia = inertia_of_body(model, model.body(part).id)
            _stretch_body(mjcf.spec.body(part), inertia, (matrix, shift), factor, meshes)
    _stretch_meshes(mjcf.spec, meshes)
    return _keep_ground_clearance(robot, mjcf.spec)


def stretch_inertia(
    inertia: pin.Inertia, matrix: Array, shift: Array, factor: float
) -> pin.Inertia:
    """Compute the inertia of a link whose points p move to A p + b.

    The mass is multiplied by ``factor``. The fraction of the mass at each point is unchanged.

    Args:
        inertia: Inertia before the stretch, in the frame of p. The result is in the same frame.
        matrix: A, shape (3, 3).
        shift: b, shape (3,) [m].
        factor: Factor on the mass; independent of A.
    """
    tensor = np.array(inertia.inertia)
    second_moments = factor * matrix @ (np.trace(tensor) / 2 * np.eye(3) - tensor) @ matrix.T
    lever = matrix @ inertia.lever + shift
    return make_inertia(
        factor * inertia.mass, lever, np.trace(second_moments) * np.eye(3) - second_moments
    )


def _find_axis_factors(matrix: Array, rotation: Array) -> Array | None:
    """Return the stretch factors (3,) along the axes of a shape, the columns of ``rotation``.

    None if the stretch ``matrix``, shape (3, 3), is not diagonal in the axes of the shape.
    """
    local = rotation.T @ matrix @ rotation
    factors = np.diag(local)
    return factors if np.abs(local - np.diag(factors)).max() < 1e-9 else None


# URDF.


def _stretch_link(urdf: UrdfTree, name: str, matrix: Array, shift: Array, factor: float) -> None:
    """Stretch a link of the URDF in place, with inertial, shapes and child joint origins.

    Points p of the link frame [m] move to A p + b, with A = ``matrix`` and b = ``shift``. Spheres,
    and some shapes at an angle to the stretch, are only moved. The mass is multiplied by
    ``factor``.
    """
    link: UrdfLink = urdf.links[name]
    inertia = link.inertia
    if inertia is not None:
        link.set_inertia(stretch_inertia(inertia, matrix, shift, factor))
    for joint in urdf.child_joints.get(name, ()):
        _move_origin(joint.element, matrix, shift)
    for _, shape, form in link.shapes:
        if form is not None:
            _stretch_form(
                form, _find_axis_factors(matrix, np.array(origin_of(shape).rotation)), name
            )
        _move_origin(shape, matrix, shift)


def _move_origin(element: etree._Element, matrix: Array, shift: Array) -> None:
    """Move the <origin> p of a URDF element to A p + b; ``matrix`` is A, ``shift`` is b [m]."""
    origin = origin_of(element)
    set_origin(element, pin.SE3(origin.rotation, matrix @ origin.translation + shift))


def _stretch_form(form: etree._Element, factors: Array | None, link: str) -> None:
    """Scale the size of a URDF shape by factors along the axes of the shape, shape (3,).

    ``factors`` is None if the stretch is along none of the axes; a mesh is then refused.
    """
    attributes: dict[object, tuple[str, Callable[[Array], Array]]] = {
        "box": ("size", lambda factors: factors),
        "mesh": ("scale", lambda factors: factors),
        "cylinder": ("length", lambda factors: factors[2:]),
        "capsule": ("length", lambda factors: factors[2:]),
    }
    if form.tag not in attributes:
        return
    if factors is None:
        if form.tag == "mesh":
            raise ModelError(
                form.get("filename") or link, diagnose("mesh-without-axis", along=link)
            )
        return
    attribute, select = attributes[form.tag]
    old = parse_numbers(form.get(attribute) or None, "1 1 1")
    form.set(attribute, join_numbers(old * select(factors), digits=None))


# MJCF.


def _stretch_body(
    body: mujoco.MjsBody,
    inertia: pin.Inertia,
    transform: tuple[Array, Array],
    factor: float,
    meshes: dict[str, list[tuple[mujoco.MjsGeom, Array]]],
) -> None:
    """Stretch a body of the MJCF in place, with geoms, sites, cameras and child body positions.

    ``inertia`` is expressed in the body frame. ``transform`` is (A, b): points p of the body frame
    [m] move to A p + b. Mesh geoms are appended to ``meshes`` (`_stretch_geom`).
    """
    matrix, shift = transform
    if inertia.mass > 0:
        stretched = stretch_inertia(inertia, matrix, shift, factor)
        body.explicitinertial, body.mass = True, float(stretched.mass)
        body.ipos, body.iquat = np.array(stretched.lever), (1.0, 0.0, 0.0, 0.0)
        body.inertia = np.zeros(3)  # MuJoCo accepts one of the two only
        body.fullinertia = inertia_entries(np.array(stretched.inertia))
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
    """Stretch a geom of the MJCF in place: points p of the body frame [m] move to A p + b.

    ``matrix`` is A, ``shift`` is b. Spheres, for example, are only moved. Mesh geoms are appended
    to ``meshes``: {mesh name: [(geom, factors along the geom's axes)]}.
    """
    if not np.isnan(geom.fromto[0]):
        ends = np.array(geom.fromto)
        geom.fromto = np.concatenate([matrix @ end + shift for end in (ends[:3], ends[3:])])
        return
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, _normalize_vector(geom.quat))
    factors = _find_axis_factors(matrix, rotation.reshape(3, 3))
    geom_types = mujoco.mjtGeom
    if geom.type == geom_types.mjGEOM_MESH:
        if factors is None:
            finding = diagnose("mesh-without-axis", along=geom.parent.name)
            raise ModelError(geom.meshname, finding)
        meshes.setdefault(geom.meshname, []).append((geom, factors.copy()))
    elif factors is not None and geom.type == geom_types.mjGEOM_BOX:
        geom.size = np.array(geom.size) * factors
    elif factors is not None and geom.type in (
        geom_types.mjGEOM_CAPSULE,
        geom_types.mjGEOM_CYLINDER,
    ):
        geom.size = np.array(geom.size) * (1.0, factors[2], 1.0)
    geom.pos = matrix @ np.array(geom.pos) + shift


def _stretch_meshes(
    spec: mujoco.MjSpec, meshes: Mapping[str, list[tuple[mujoco.MjsGeom, Array]]]
) -> None:
    """Scale the mesh assets of an MJCF in place; add assets if geoms of a mesh differ in stretch.

    ``meshes`` is {mesh name: [(geom, stretch factors along the mesh axes, shape (3,))]}.
    """
    for name, users in meshes.items():
        mesh = spec.mesh(name)
        scale, file = np.array(mesh.scale), mesh.file
        count = sum(geom.meshname == name for geom in spec.geoms)
        stretches = {tuple(factors): factors for _, factors in users}
        if len(stretches) == 1 and count == len(users):
            mesh.scale = scale * next(iter(stretches.values()))
            continue
        for index, (key, factors) in enumerate(stretches.items()):
            asset_name = f"{name}_stretched{index or ''}"
            asset = spec.add_mesh(name=asset_name, file=file, scale=scale * factors)
            asset.refpos, asset.refquat = np.array(mesh.refpos), np.array(mesh.refquat)
            asset.inertia = mesh.inertia
            for geom, geom_factors in users:
                if tuple(geom_factors) == key:
                    geom.meshname = asset_name


def _keep_ground_clearance(robot: Robot, spec: mujoco.MjSpec) -> float:
    """Change the base heights of a stretched robot in ``spec``, to keep the ground clearance.

    Returns:
        New base height of the nominal stand [m].
    """
    description = robot.description
    before, after = robot.mj_model, compile_spec(spec.copy(), description.mjcf_source)

    def height(model: mujoco.MjModel, qpos: Array) -> float:
        """Return the base height [m] above the ground if the lowest foot touches the ground."""
        sites = {
            point: foot_site(model, frame, description.mjcf_source)
            for point, (_, frame) in description.contact_points.items()
        }
        return stand_height(model, robot.mj_base, sites, robot.contact_radius, qpos, None)

    if not robot.floating or not robot.contact_points:
        return robot.stand_height
    free = int(before.jnt_qposadr[np.flatnonzero(before.jnt_type == 0)[0]])
    base = spec.body(robot.mj_base)  # initial pose without a keyframe
    height_change = height(after, before.qpos0) - height(before, before.qpos0)
    base.pos = np.array(base.pos) + np.array([0.0, 0.0, height_change])
    for key in spec.keys:
        if len(key.qpos) == before.nq:
            qpos = np.array(key.qpos)
            qpos[free + 2] += height(after, qpos) - height(before, qpos)
            key.qpos = qpos
    data = mujoco.MjData(before)
    robot.mj_convention.set_state(data, robot.home)
    radius = max(robot.contact_radius.values())
    old_height, new_height = (
        height(model, np.array(data.qpos)) - radius for model in (before, after)
    )
    return radius + (robot.stand_height - radius) * new_height / old_height
