"""Derives a variant: of a URDF through yourdfpy, of an MJCF through MuJoCo's spec."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator, Sequence
from pathlib import Path

import mujoco
import numpy as np
import yourdfpy
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ModelError, UnknownNameError
from pupper_analysis.models.mjcf import compile_spec
from pupper_analysis.pupper.variants import BASE_MODELS, VariantSpec

Array = NDArray[np.float64]


def derive_urdf(text: str, variant: VariantSpec, *, source: Path) -> str:
    """Derives the URDF of a variant from that of its base model.

    What is scaled, and how, is documented at ``derive_mjcf``; this is the other, independent route.

    Args:
        text: The base URDF.
        variant: Names the base and the scales.
        source: Where the text came from, for messages.

    Returns:
        The variant's URDF.

    Raises:
        ModelError: If the text is no URDF, or a leg is not of the expected make.
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
        _stretch(robot, links[knee.parent], _origin(knee), _origin(knee)[:3, :3] @ axis, variant)
        _stretch(robot, links[knee.child], _origin(foot), axis, variant)
    root = next(link for link in robot.links if link.name not in parent_joint)
    root.inertial.mass *= variant.torso_mass_scale
    root.inertial.inertia = variant.torso_mass_scale * root.inertial.inertia
    robot.name = variant.name
    written = io.BytesIO()
    model.write_xml().write(written, xml_declaration=True, encoding="utf-8", pretty_print=True)
    return written.getvalue().decode()


def _origin(element: object) -> Array:
    origin = getattr(element, "origin", None)
    return np.eye(4) if origin is None else np.array(origin, dtype=float)


def _stretch(
    robot: yourdfpy.Robot, link: yourdfpy.Link, end: Array, normal: Array, variant: VariantSpec
) -> None:
    """Stretches a link along the way to ``end``, within the plane of the given normal."""
    factor = variant.leg_scale
    across = end[:3, 3] - normal * (normal @ end[:3, 3]) / (normal @ normal)
    axis = across / np.linalg.norm(across)
    matrix = np.eye(3) + (factor - 1.0) * np.outer(axis, axis)
    capsule = _capsule(link, axis)  # before its shapes change
    for joint in robot.joints:
        if joint.parent == link.name:
            joint.origin = _moved(joint, matrix)
    for shape in (*link.visuals, *link.collisions):
        rotation = _origin(shape)[:3, :3]
        shape.origin = _moved(shape, matrix)
        cylinder, mesh = shape.geometry.cylinder, shape.geometry.mesh
        if cylinder is not None and abs(rotation[:, 2] @ axis) > 1 - 1e-9:
            cylinder.length *= factor
        if mesh is not None:
            stretched = rotation.T @ matrix @ rotation
            if np.abs(stretched - np.diag(np.diag(stretched))).max() > 1e-9:
                raise ModelError(mesh.filename, diagnose("mesh-without-axis", along=link.name))
            mesh.scale = np.diag(stretched) * (1.0 if mesh.scale is None else mesh.scale)
    inertial = link.inertial
    rotation = _origin(inertial)[:3, :3]
    tensor = rotation @ np.asarray(inertial.inertia, dtype=float) @ rotation.T
    solid = capsule is not None and np.allclose(
        tensor, compute_capsule_inertia(inertial.mass, *capsule, axis), rtol=1e-6, atol=1e-12
    )
    if capsule is not None and solid:
        radius, length = capsule
        tensor = compute_capsule_inertia(factor * inertial.mass, radius, factor * length, axis)
    else:
        second = matrix @ (np.trace(tensor) / 2 * np.eye(3) - tensor) @ matrix.T * factor
        tensor = np.trace(second) * np.eye(3) - second
    inertial.mass *= factor
    inertial.inertia = tensor
    inertial.origin = _moved(inertial, matrix)
    inertial.origin[:3, :3] = np.eye(3)


def _moved(element: object, matrix: Array) -> Array:
    origin = _origin(element)
    origin[:3, 3] = matrix @ origin[:3, 3]
    return origin


def _capsule(link: yourdfpy.Link, axis: Array) -> tuple[float, float] | None:
    """Returns radius and length (m) if the link's shape is a capsule along the axis."""
    shapes = list(_primitives(link))
    cylinders = [(geometry.cylinder, at) for geometry, at in shapes if geometry.cylinder]
    spheres = [(geometry.sphere, at) for geometry, at in shapes if geometry.sphere]
    if len(cylinders) != 1 or len(spheres) != 2:
        return None
    cylinder, at = cylinders[0]
    if abs(at[:3, 2] @ axis) < 1 - 1e-9:
        return None
    half = axis * cylinder.length / 2
    for end in (at[:3, 3] + half, at[:3, 3] - half):
        if not any(
            np.allclose(end, where[:3, 3]) and np.isclose(sphere.radius, cylinder.radius)
            for sphere, where in spheres
        ):
            return None
    return cylinder.radius, cylinder.length


def _primitives(link: yourdfpy.Link) -> Iterator[tuple[yourdfpy.Geometry, Array]]:
    for collision in link.collisions:
        yield collision.geometry, _origin(collision)


def compute_capsule_inertia(mass: float, radius: float, length: float, axis: Array) -> Array:
    """Returns the inertia of a solid capsule about its centre: a cylinder and two hemispheres.

    With the cylinder's mass m_c and that of both hemispheres m_s (in proportion to their volumes):
    I_axial = m_c r^2 / 2 + m_s 2 r^2 / 5 and
    I_lateral = m_c (r^2 / 4 + l^2 / 12) + m_s (2 r^2 / 5 + l^2 / 4 + 3 l r / 8).

    Args:
        mass: kg.
        radius: m.
        length: Distance of the hemispheres' centres (m).
        axis: (3,) unit vector.

    Returns:
        (3, 3) tensor (kg m^2) in the axes in which ``axis`` is given.
    """
    share = length / (length + 4 * radius / 3)
    cylinder, spheres = mass * share, mass * (1 - share)
    axial = cylinder * radius**2 / 2 + spheres * 0.4 * radius**2
    lateral = cylinder * (radius**2 / 4 + length**2 / 12) + spheres * (
        0.4 * radius**2 + length**2 / 4 + 3 * length * radius / 8
    )
    along = np.outer(axis, axis)
    tensor: Array = lateral * (np.eye(3) - along) + axial * along
    return tensor


def derive_mjcf(spec: mujoco.MjSpec, variant: VariantSpec) -> None:
    """Turns the spec of a base model, in place, into that of a variant.

    A leg's last joint is its knee; the bodies on its two sides are thigh and calf. Both are
    stretched by ``leg_scale`` along the line to the next joint (to the foot), taken in the plane
    normal to the knee's axis: the leg's sideways offset stays. Mass grows in proportion. A shape
    that spans the link gets longer, another one keeps its size and moves. The base body's mass and
    inertia are multiplied by ``torso_mass_scale``. Keyframes keep their clearance of the ground.

    Args:
        spec: The base model's spec.
        variant: Names the base and the scales.
    """
    base = BASE_MODELS[variant.base]
    before = _keyframe_depths(spec, base.feet.values())
    torso = spec.site(next(iter(base.feet.values()))).parent
    while torso.parent.name != "world":
        torso = torso.parent
    stretched_meshes: dict[str, Array] = {}
    for frame in base.feet.values():
        site = spec.site(frame)
        calf = site.parent
        thigh = calf.parent
        knee_in_calf = _unit(calf.joints[0].axis)
        knee_in_thigh = _rotation(calf.quat) @ knee_in_calf
        along_thigh = _in_plane(np.array(calf.pos), knee_in_thigh)
        along_calf = _in_plane(np.array(site.pos), knee_in_calf)
        _stretch_body(thigh, along_thigh, variant.leg_scale, stretched_meshes)
        _stretch_body(calf, along_calf, variant.leg_scale, stretched_meshes)
    for name, factor in stretched_meshes.items():
        mesh = spec.mesh(name)
        mesh.scale = np.array(mesh.scale) * factor
    _scale_torso(torso, variant.torso_mass_scale)
    spec.modelname = variant.name
    _raise_keyframes(spec, torso, before, _keyframe_depths(spec, base.feet.values()))


def _unit(vector: object) -> Array:
    array = np.array(vector, dtype=float)
    unit: Array = array / np.linalg.norm(array)
    return unit


def _rotation(quat: object) -> Array:
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, _unit(quat))
    return matrix.reshape(3, 3)


def _in_plane(offset: Array, normal: Array) -> Array:
    return _unit(offset - (offset @ normal) * normal)


def _stretch_body(
    body: mujoco.MjsBody, axis: Array, factor: float, meshes: dict[str, Array]
) -> None:
    """Stretches all that is fixed to a body by ``factor`` along the unit vector ``axis``."""
    stretch = np.eye(3) + (factor - 1.0) * np.outer(axis, axis)
    for part in (*body.bodies, *body.sites, *body.joints):
        part.pos = stretch @ np.array(part.pos)
    for geom in body.geoms:
        _stretch_geom(geom, axis, factor, stretch, meshes)
    if body.explicitinertial:
        _stretch_inertial(body, stretch, factor)


def _stretch_geom(
    geom: mujoco.MjsGeom, axis: Array, factor: float, stretch: Array, meshes: dict[str, Array]
) -> None:
    ends = np.array(geom.fromto)
    rotation = _rotation(geom.quat)
    spans = False
    if geom.type == mujoco.mjtGeom.mjGEOM_MESH:
        local = rotation.T @ stretch @ rotation
        if not np.allclose(local, np.diag(np.diag(local)), atol=1e-9):
            raise ModelError(geom.meshname, diagnose("mesh-without-axis", along=axis))
        meshes[geom.meshname] = np.diag(local).copy()
    elif not math.isnan(ends[0]):
        spans = bool(abs(_unit(ends[3:] - ends[:3]) @ axis) > 1 - 1e-9)
        geom.fromto = np.concatenate([stretch @ ends[:3], stretch @ ends[3:]])
    elif geom.type in (mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_CYLINDER):
        spans = bool(abs(rotation[:, 2] @ axis) > 1 - 1e-9)
        if spans:
            geom.size = np.array(geom.size) * (1.0, factor, 1.0)
    geom.pos = stretch @ np.array(geom.pos)
    if spans and not math.isnan(geom.mass):
        geom.mass = geom.mass * factor


def _stretch_inertial(body: mujoco.MjsBody, stretch: Array, factor: float) -> None:
    """Stretches a body of constant density, given by its inertial.

    The body is replaced by six equal point masses on its principal axes that have its mass,
    centre and inertia (an equimomental system); these are moved, and their inertia is summed up.
    """
    rotation = _rotation(body.iquat)
    full = np.array(body.fullinertia)
    if math.isnan(full[0]):
        tensor = rotation @ np.diag(body.inertia) @ rotation.T
    else:
        xx, yy, zz, xy, xz, yz = full
        tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    moments, axes = np.linalg.eigh(tensor)
    second = np.maximum(moments.sum() / 2 - moments, 0.0)  # integral of x_i^2 dm, per axis
    arms = axes * np.sqrt(3.0 * second / body.mass)
    points = stretch @ np.concatenate([arms, -arms], axis=1)
    mass = factor * body.mass
    tensor = mass / 6 * (np.eye(3) * np.sum(points**2) - points @ points.T)
    body.mass = mass
    body.ipos = stretch @ np.array(body.ipos)
    body.iquat = (1.0, 0.0, 0.0, 0.0)
    body.fullinertia = tensor[(0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)]


def _scale_torso(body: mujoco.MjsBody, factor: float) -> None:
    if body.explicitinertial:
        body.mass = factor * body.mass
        body.fullinertia = factor * np.array(body.fullinertia)
        body.inertia = factor * np.array(body.inertia)
        return
    for geom in body.geoms:
        geom.density = factor * geom.density
        if not math.isnan(geom.mass):
            geom.mass = factor * geom.mass


def _keyframe_depths(spec: mujoco.MjSpec, sites: object) -> list[float]:
    """Returns how far the lowest foot is below the base: at zero angles, then at each keyframe."""
    model = compile_spec(_bones(spec), Path(spec.modelname))
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


def _bones(spec: mujoco.MjSpec) -> mujoco.MjSpec:
    """Returns a copy that moves alike, without what takes time to compile: shapes, textures."""
    bones = spec.copy()
    for element in (*bones.geoms, *bones.meshes, *bones.materials, *bones.textures):
        bones.delete(element)
    for body in bones.bodies[1:]:
        if not body.explicitinertial:  # its mass was that of its shapes; any is as good
            body.explicitinertial, body.mass, body.inertia = True, 1.0, (1.0, 1.0, 1.0)
    return bones


def _raise_keyframes(
    spec: mujoco.MjSpec, torso: mujoco.MjsBody, before: Sequence[float], after: Sequence[float]
) -> None:
    torso.pos = np.array(torso.pos) + np.array([0.0, 0.0, after[0] - before[0]])
    for key, old, new in zip(spec.keys, before[1:], after[1:], strict=True):
        qpos = np.array(key.qpos)
        qpos[2] += new - old
        key.qpos = qpos
