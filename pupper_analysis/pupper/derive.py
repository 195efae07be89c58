"""Derive a variant: the URDF with yourdfpy, the MJCF with MuJoCo's spec.

Inputs are the URDF or MJCF of a base model, and the scale factors of the legs and the torso mass.
Thighs and calves are stretched along their length by a linear map of positions. Masses, inertias,
shapes and keyframes are changed accordingly. `derive_urdf` and `derive_mjcf` are independent
implementations; a comparison of both results tests them.
"""

from __future__ import annotations

import io
import math
from collections.abc import Iterator, Sequence
from pathlib import Path

import mujoco
import numpy as np
import yourdfpy

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ModelError, UnknownNameError
from pupper_analysis.models.mjcf import compile_spec
from pupper_analysis.pupper.variants import BASE_MODELS, VariantSpec

BALLAST_COLOUR = (0.13, 0.14, 0.16, 1.0)
"""Colour of the block that marks a heavier torso (red, green, blue, opacity). Chosen, not tuned."""
_VISUAL_GROUP = 1
"""Geom group of the block that marks a heavier torso: the group of visual meshes in the v3 MJCF."""


def derive_urdf(text: str, variant: VariantSpec, *, source: Path) -> str:
    """Derive the URDF of a variant: the URDF of the base model with scaled legs and torso mass.

    `derive_mjcf` describes the scaling; this function is an independent implementation.

    Args:
        text: XML text of the base URDF.
        variant: Scale factors and name of the variant.
        source: Path of the base URDF, for errors.

    Returns:
        XML text of the variant's URDF.

    Raises:
        UnknownNameError: If the link of a foot does not exist.
        ModelError: If a mesh cannot be stretched along its own axes.
    """
    base = BASE_MODELS[variant.base]
    model = yourdfpy.URDF.load(
        io.BytesIO(text.encode()),
        build_scene_graph=False,
        load_meshes=False,
        filename_handler=lambda name: name,
    )
    robot = model.robot
    links = {link.name: link for link in robot.links}
    parent_joint = {joint.child: joint for joint in robot.joints}
    for frame in base.feet.values():
        if frame not in parent_joint:
            raise UnknownNameError(source, "link (for a foot)", frame, links)
        foot = parent_joint[frame]
        knee = parent_joint[foot.parent]
        axis = np.asarray(knee.axis, dtype=float)
        _stretch_link(
            robot,
            links[knee.parent],
            _read_origin(knee),
            _read_origin(knee)[:3, :3] @ axis,
            variant,
        )
        _stretch_link(robot, links[knee.child], _read_origin(foot), axis, variant)
    root = next(link for link in robot.links if link.name not in parent_joint)
    root.inertial.mass *= variant.torso_mass_scale
    root.inertial.inertia = variant.torso_mass_scale * root.inertial.inertia
    if variant.torso_mass_scale > 1:
        root.visuals.append(_make_ballast_visual(variant))
    robot.name = variant.name
    written = io.BytesIO()
    model.write_xml().write(written, xml_declaration=True, encoding="utf-8", pretty_print=True)
    return written.getvalue().decode()


def _make_ballast_visual(variant: VariantSpec) -> yourdfpy.Visual:
    """Create the dark block that marks a heavier torso, a visual of the base link without mass."""
    centre, size = BASE_MODELS[variant.base].ballast
    origin = np.eye(4)
    origin[:3, 3] = centre
    colour = yourdfpy.Color(rgba=np.array(BALLAST_COLOUR))
    return yourdfpy.Visual(
        name="ballast",
        origin=origin,
        geometry=yourdfpy.Geometry(box=yourdfpy.Box(size=np.array(size))),
        material=yourdfpy.Material(name="ballast", color=colour),
    )


def _read_origin(element: object) -> Array:
    """Return the origin of a URDF element as a homogeneous matrix (4, 4); identity if missing."""
    origin = getattr(element, "origin", None)
    return np.eye(4) if origin is None else np.array(origin, dtype=float)


def _stretch_link(
    robot: yourdfpy.Robot, link: yourdfpy.Link, end: Array, normal: Array, variant: VariantSpec
) -> None:
    """Stretch a link in place by ``variant.leg_scale`` along the direction to its end.

    ``end`` is the pose (4, 4) of the next joint in the link frame. The direction is projected into
    the plane with the normal ``normal``, the knee axis (3,) in the link frame. Spheres keep their
    size, for example.
    """
    factor = variant.leg_scale
    in_plane = end[:3, 3] - normal * (normal @ end[:3, 3]) / (normal @ normal)
    axis = in_plane / np.linalg.norm(in_plane)
    matrix = np.eye(3) + (factor - 1.0) * np.outer(axis, axis)
    capsule = _find_capsule(link, axis)  # before its shapes change
    for joint in robot.joints:
        if joint.parent == link.name:
            joint.origin = _transform_origin(joint, matrix)
    for shape in (*link.visuals, *link.collisions):
        rotation = _read_origin(shape)[:3, :3]
        shape.origin = _transform_origin(shape, matrix)
        cylinder, mesh = shape.geometry.cylinder, shape.geometry.mesh
        if cylinder is not None and abs(rotation[:, 2] @ axis) > 1 - 1e-9:
            cylinder.length *= factor
        if mesh is not None:
            stretched = rotation.T @ matrix @ rotation
            if np.abs(stretched - np.diag(np.diag(stretched))).max() > 1e-9:
                raise ModelError(mesh.filename, diagnose("mesh-without-axis", along=link.name))
            mesh.scale = np.diag(stretched) * (1.0 if mesh.scale is None else mesh.scale)
    inertial = link.inertial
    rotation = _read_origin(inertial)[:3, :3]
    tensor = rotation @ np.asarray(inertial.inertia, dtype=float) @ rotation.T
    is_capsule = capsule is not None and np.allclose(
        tensor, compute_capsule_inertia(inertial.mass, *capsule, axis), rtol=1e-6, atol=1e-12
    )
    if capsule is not None and is_capsule:
        radius, length = capsule
        tensor = compute_capsule_inertia(factor * inertial.mass, radius, factor * length, axis)
    else:
        second = matrix @ (np.trace(tensor) / 2 * np.eye(3) - tensor) @ matrix.T * factor
        tensor = np.trace(second) * np.eye(3) - second
    inertial.mass *= factor
    inertial.inertia = tensor
    inertial.origin = _transform_origin(inertial, matrix)
    inertial.origin[:3, :3] = np.eye(3)


def _transform_origin(element: object, matrix: Array) -> Array:
    """Return the origin (4, 4) of an element, with the position multiplied by a matrix (3, 3)."""
    origin = _read_origin(element)
    origin[:3, 3] = matrix @ origin[:3, 3]
    return origin


def _find_capsule(link: yourdfpy.Link, axis: Array) -> tuple[float, float] | None:
    """Return (radius, length of the cylinder) [m] of a link's collision capsule along an axis.

    A capsule is one cylinder along ``axis``, a unit vector (3,) in the link frame, with a sphere of
    the same radius at each end. None if the link has no capsule, for example.
    """
    shapes = list(_yield_collision_shapes(link))
    cylinders = [(geometry.cylinder, pose) for geometry, pose in shapes if geometry.cylinder]
    spheres = [(geometry.sphere, pose) for geometry, pose in shapes if geometry.sphere]
    if len(cylinders) != 1 or len(spheres) != 2:
        return None
    cylinder, pose = cylinders[0]
    if abs(pose[:3, 2] @ axis) < 1 - 1e-9:
        return None
    half = axis * cylinder.length / 2
    for end in (pose[:3, 3] + half, pose[:3, 3] - half):
        if not any(
            np.allclose(end, sphere_pose[:3, 3]) and np.isclose(sphere.radius, cylinder.radius)
            for sphere, sphere_pose in spheres
        ):
            return None
    return cylinder.radius, cylinder.length


def _yield_collision_shapes(link: yourdfpy.Link) -> Iterator[tuple[yourdfpy.Geometry, Array]]:
    """Yield the geometry of each collision shape of a link, and its pose (4, 4) in the link."""
    for collision in link.collisions:
        yield collision.geometry, _read_origin(collision)


def compute_capsule_inertia(mass: float, radius: float, length: float, axis: Array) -> Array:
    """Compute the inertia of a solid capsule about the centre: a cylinder and two hemispheres.

    With the masses m_c of the cylinder and m_s of both hemispheres, in proportion to their
    volumes, and the length l of the cylinder:
    I_axial = m_c r^2 / 2 + m_s 2 r^2 / 5,
    I_lateral = m_c (r^2 / 4 + l^2 / 12) + m_s (2 r^2 / 5 + l^2 / 4 + 3 l r / 8).

    Args:
        mass: Mass [kg].
        radius: Radius [m].
        length: Distance between the centres of the hemispheres [m].
        axis: Unit vector of the axis, shape (3,).

    Returns:
        Inertia tensor, shape (3, 3) [kg m^2], expressed in the frame of ``axis``.
    """
    share = length / (length + 4 * radius / 3)
    cylinder, spheres = mass * share, mass * (1 - share)
    axial = cylinder * radius**2 / 2 + spheres * 0.4 * radius**2
    lateral = cylinder * (radius**2 / 4 + length**2 / 12) + spheres * (
        0.4 * radius**2 + length**2 / 4 + 3 * length * radius / 8
    )
    projection = np.outer(axis, axis)
    tensor: Array = lateral * (np.eye(3) - projection) + axial * projection
    return tensor


def derive_mjcf(spec: mujoco.MjSpec, variant: VariantSpec) -> None:
    """Scale the legs and the torso mass of a base model's MuJoCo spec, in place.

    The last joint of a leg is the knee, between thigh and calf. Both bodies are stretched by
    ``leg_scale`` along the direction to the next body (or the foot), and their inertia is changed
    accordingly. This direction is projected into the plane normal to the knee axis, so the lateral
    offset of the leg is unchanged. Spheres, such as the foot, keep their size.

    Mass and inertia of the base body are multiplied by ``torso_mass_scale``. The base, also in the
    keyframes, is raised or lowered. With a horizontal base, the lowest foot then has the same
    height above the ground as before.

    Args:
        spec: Spec of the base model; becomes the spec of the variant.
        variant: Scale factors and name of the variant.

    Raises:
        ModelError: If a mesh cannot be stretched along its own axes, for example.
    """
    base = BASE_MODELS[variant.base]
    before = _measure_foot_depths(spec, base.feet.values())
    torso = spec.site(next(iter(base.feet.values()))).parent
    while torso.parent.name != "world":
        torso = torso.parent
    stretched_meshes: dict[str, Array] = {}
    for frame in base.feet.values():
        site = spec.site(frame)
        calf = site.parent
        thigh = calf.parent
        knee_in_calf = _normalize_vector(calf.joints[0].axis)
        knee_in_thigh = _convert_quaternion(calf.quat) @ knee_in_calf
        along_thigh = _project_in_plane(np.array(calf.pos), knee_in_thigh)
        along_calf = _project_in_plane(np.array(site.pos), knee_in_calf)
        _stretch_body(thigh, along_thigh, variant.leg_scale, stretched_meshes)
        _stretch_body(calf, along_calf, variant.leg_scale, stretched_meshes)
    for name, factor in stretched_meshes.items():
        mesh = spec.mesh(name)
        mesh.scale = np.array(mesh.scale) * factor
    _scale_torso(torso, variant.torso_mass_scale)
    if variant.torso_mass_scale > 1:
        _add_ballast_geom(torso, variant)
    spec.modelname = variant.name
    _raise_keyframes(spec, torso, before, _measure_foot_depths(spec, base.feet.values()))


def _normalize_vector(vector: object) -> Array:
    """Return a vector (n,) divided by its Euclidean norm."""
    array = np.array(vector, dtype=float)
    unit: Array = array / np.linalg.norm(array)
    return unit


def _convert_quaternion(quat: object) -> Array:
    """Return the rotation matrix (3, 3) of a quaternion (w, x, y, z), which is normalised first."""
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, _normalize_vector(quat))
    return matrix.reshape(3, 3)


def _project_in_plane(offset: Array, normal: Array) -> Array:
    """Project a vector (3,) into the plane with a unit normal (3,), and normalise the result."""
    return _normalize_vector(offset - (offset @ normal) * normal)


def _stretch_body(
    body: mujoco.MjsBody, axis: Array, factor: float, meshes: dict[str, Array]
) -> None:
    """Stretch a body of an MJCF by ``factor`` along an axis, in place, except for its meshes.

    ``axis`` is a unit vector (3,) in the body frame. ``meshes`` receives {mesh: scale factors (3,)
    along the axes of the mesh}; the caller must scale the meshes. Spheres keep their size, for
    example.
    """
    matrix = np.eye(3) + (factor - 1.0) * np.outer(axis, axis)
    for part in (*body.bodies, *body.sites, *body.joints):
        part.pos = matrix @ np.array(part.pos)
    for geom in body.geoms:
        _stretch_geom(geom, axis, factor, matrix, meshes)
    if body.explicitinertial:
        _stretch_inertial(body, matrix, factor)


def _stretch_geom(
    geom: mujoco.MjsGeom, axis: Array, factor: float, matrix: Array, meshes: dict[str, Array]
) -> None:
    """Apply the stretch of `_stretch_body` to a geom of an MJCF, in place, except for its mesh.

    ``matrix`` is the stretch I + (factor - 1) axis axis^T, shape (3, 3).
    """
    ends = np.array(geom.fromto)
    rotation = _convert_quaternion(geom.quat)
    spans = False
    if geom.type == mujoco.mjtGeom.mjGEOM_MESH:
        local = rotation.T @ matrix @ rotation
        if not np.allclose(local, np.diag(np.diag(local)), atol=1e-9):
            raise ModelError(geom.meshname, diagnose("mesh-without-axis", along=axis))
        meshes[geom.meshname] = np.diag(local).copy()
    elif not math.isnan(ends[0]):
        spans = bool(abs(_normalize_vector(ends[3:] - ends[:3]) @ axis) > 1 - 1e-9)
        geom.fromto = np.concatenate([matrix @ ends[:3], matrix @ ends[3:]])
    elif geom.type in (mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_CYLINDER):
        spans = bool(abs(rotation[:, 2] @ axis) > 1 - 1e-9)
        if spans:
            geom.size = np.array(geom.size) * (1.0, factor, 1.0)
    geom.pos = matrix @ np.array(geom.pos)
    if spans and not math.isnan(geom.mass):
        geom.mass = geom.mass * factor


def _stretch_inertial(body: mujoco.MjsBody, matrix: Array, factor: float) -> None:
    """Stretch mass, centre of mass and inertia of a body in place; the mass is times ``factor``.

    The body is replaced by an equimomental system: six equal point masses on its principal axes
    with the same mass, centre and inertia. Their positions are multiplied by ``matrix``, shape (3,
    3).
    """
    rotation = _convert_quaternion(body.iquat)
    full = np.array(body.fullinertia)
    if math.isnan(full[0]):
        tensor = rotation @ np.diag(body.inertia) @ rotation.T
    else:
        xx, yy, zz, xy, xz, yz = full
        tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    moments, axes = np.linalg.eigh(tensor)
    second = np.maximum(moments.sum() / 2 - moments, 0.0)  # integral of x_i^2 dm, per axis
    arms = axes * np.sqrt(3.0 * second / body.mass)
    points = matrix @ np.concatenate([arms, -arms], axis=1)
    mass = factor * body.mass
    tensor = mass / 6 * (np.eye(3) * np.sum(points**2) - points @ points.T)
    body.mass = mass
    body.ipos = matrix @ np.array(body.ipos)
    body.iquat = (1.0, 0.0, 0.0, 0.0)
    body.fullinertia = tensor[(0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)]


def _scale_torso(body: mujoco.MjsBody, factor: float) -> None:
    """Multiply mass and inertia of a body by a factor, in place."""
    if body.explicitinertial:
        body.mass = factor * body.mass
        body.fullinertia = factor * np.array(body.fullinertia)
        body.inertia = factor * np.array(body.inertia)
        return
    for geom in body.geoms:
        geom.density = factor * geom.density
        if not math.isnan(geom.mass):
            geom.mass = factor * geom.mass


def _add_ballast_geom(torso: mujoco.MjsBody, variant: VariantSpec) -> None:
    """Add the dark block that marks a heavier torso: a geom without mass that touches nothing."""
    centre, size = BASE_MODELS[variant.base].ballast
    torso.add_geom(
        name="ballast",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=centre,
        size=np.array(size) / 2,
        rgba=BALLAST_COLOUR,
        group=_VISUAL_GROUP,
        mass=0.0,
        contype=0,
        conaffinity=0,
    )


def _measure_foot_depths(spec: mujoco.MjSpec, sites: object) -> list[float]:
    """Measure the vertical distance [m] from a horizontal base down to the lowest foot.

    The list has a value for ``qpos0``, then for each keyframe. ``sites`` are names of the foot
    sites.
    """
    model = compile_spec(_copy_skeleton(spec), Path(spec.modelname))
    data = mujoco.MjData(model)
    ids = [model.site(name).id for name in sites]  # type: ignore[attr-defined]
    depths = []
    for qpos in (None, *model.key_qpos):
        if qpos is not None:
            data.qpos[:] = qpos
        data.qpos[:7] = (0, 0, 0, 1, 0, 0, 0)
        mujoco.mj_kinematics(model, data)
        depths.append(-float(data.site_xpos[ids, 2].min()))
    return depths


def _copy_skeleton(spec: mujoco.MjSpec) -> mujoco.MjSpec:
    """Copy a spec without shapes and textures: same kinematics, but faster to compile."""
    bones = spec.copy()
    for element in (*bones.geoms, *bones.meshes, *bones.materials, *bones.textures):
        bones.delete(element)
    for body in bones.bodies[1:]:
        if not body.explicitinertial:  # arbitrary: the mass of the shapes is lost
            body.explicitinertial, body.mass, body.inertia = True, 1.0, (1.0, 1.0, 1.0)
    return bones


def _raise_keyframes(
    spec: mujoco.MjSpec, torso: mujoco.MjsBody, before: Sequence[float], after: Sequence[float]
) -> None:
    """Raise the base and all keyframes, in place, so that the lowest foot keeps its height.

    The base is assumed to be horizontal. ``before`` and ``after`` are the results of
    `_measure_foot_depths` [m] before and after the scaling.
    """
    torso.pos = np.array(torso.pos) + np.array([0.0, 0.0, after[0] - before[0]])
    for key, old, new in zip(spec.keys, before[1:], after[1:], strict=True):
        qpos = np.array(key.qpos)
        qpos[2] += new - old
        key.qpos = qpos
