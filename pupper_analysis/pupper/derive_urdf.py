"""Derives a variant from a URDF, through yourdfpy."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import yourdfpy
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ModelError, UnknownNameError
from pupper_analysis.pupper.variants import BASES, Box, VariantSpec

Array = NDArray[np.float64]


def derive_urdf(text: str, variant: VariantSpec, *, source: Path) -> str:
    """Derives the URDF of a variant from that of its base model.

    What is scaled, and how, is told in ``mjcf.derive``; this is the other, independent route.

    Args:
        text: The base URDF.
        variant: Names the base and the scales.
        source: Where the text came from, for messages.

    Returns:
        The variant's URDF.

    Raises:
        ModelError: If the text is no URDF, or a leg is not of the expected make.
    """
    base = BASES[variant.base]
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
    if variant.ballast:
        root.visuals.append(_ballast(variant.ballast))
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
        tensor, capsule_inertia(inertial.mass, *capsule, axis), rtol=1e-6, atol=1e-12
    )
    if capsule is not None and solid:
        radius, length = capsule
        tensor = capsule_inertia(factor * inertial.mass, radius, factor * length, axis)
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


def capsule_inertia(mass: float, radius: float, length: float, axis: Array) -> Array:
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


def _ballast(ballast: Box) -> yourdfpy.Visual:
    origin = np.eye(4)
    origin[:3, 3] = ballast.position
    return yourdfpy.Visual(
        name="ballast",
        origin=origin,
        geometry=yourdfpy.Geometry(box=yourdfpy.Box(size=2 * np.array(ballast.half_size))),
        material=yourdfpy.Material(
            name="ballast", color=yourdfpy.Color(rgba=np.array([0.16, 0.17, 0.20, 1.0]))
        ),
    )
