"""Rules about single values that are impossible or probably wrong.

Input is the model of a file, or the elements of the file. The rules check, for example, the signs
of sizes and passive joint terms, the ranges of MuJoCo's options, and the units of rotations.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from lxml import etree

from pupper_analysis.base.diagnostics import (
    Severity,
    Vector,
    diagnose,
)
from pupper_analysis.models.attributes import JOINT_ATTRIBUTES
from pupper_analysis.models.loading import CheckFinding
from pupper_analysis.models.mjcf import TIMESTEP_RANGE
from pupper_analysis.models.places import Place
from pupper_analysis.models.stated.mjcf import find_element_place
from pupper_analysis.models.stated.model import MjcfModel, RobotModel, UrdfModel
from pupper_analysis.models.xml import parse_numbers
from pupper_analysis.tools.audit.registry import rule
from pupper_analysis.tools.audit.rules.files import find_first_place

_SHAPE_SIZES = {
    "sphere": ("radius",),
    "cylinder": ("radius", "length"),
    "capsule": ("radius", "length"),
}
"""{round shape of a URDF: attributes with a size [m]}. Boxes and meshes are checked separately."""


@rule
def value_impossible(robot: RobotModel) -> Iterator[CheckFinding]:
    """Find shapes of size <= 0, and negative damping, friction, armature, stiffness and limits.

    Sizes are only checked in a URDF; a cylinder or capsule may have the length 0. Of MuJoCo's
    polynomials the first coefficient is checked, because this coefficient dominates at small speeds
    and deflections.
    """
    for joint in robot.joints.values():
        for joint_attribute in JOINT_ATTRIBUTES:
            value = joint.stated.get(joint_attribute.kind, 0.0)
            is_limit = joint_attribute.kind in ("effort", "velocity")
            by_another_rule = isinstance(robot, UrdfModel) and is_limit
            if value < 0 and not joint_attribute.signed and not by_another_rule:  # effort-negative
                word, child = robot.locate_parameter(joint_attribute)
                message = diagnose("value-impossible", attribute=word, value=value)
                yield CheckFinding("joint", joint.name, message, child)
    if isinstance(robot, UrdfModel):
        yield from _find_impossible_sizes(robot)
        return
    if not isinstance(robot, MjcfModel):
        return
    for geom in robot.file.spec.geoms:
        if min(geom.friction) < 0:
            place = None if geom.name else find_element_place(robot.file, geom, geom.parent.name)
            message = diagnose("friction-negative", friction=Vector(tuple(geom.friction), "1"))
            yield CheckFinding("geom", geom.name, message, place=place)


def _find_impossible_sizes(robot: UrdfModel) -> Iterator[CheckFinding]:
    """Yield findings for sizes <= 0, lengths below 0 and mesh scales of 0 in a URDF."""
    for link, _, shape in _list_shapes(robot):
        tag = str(shape.tag)
        if tag == "box":
            sizes = {"size": parse_numbers(shape.get("size"), "1 1 1")}
        elif tag == "mesh":
            # Negative factors mirror the mesh, see mesh_mirrored.
            sizes = {"scale": np.abs(parse_numbers(shape.get("scale"), "1 1 1"))}
        else:
            sizes = {
                name: parse_numbers(shape.get(name), "1") for name in _SHAPE_SIZES.get(tag, ())
            }
        for name, values in sizes.items():
            bad = values < 0 if name == "length" else values <= 0
            if bad.any():
                message = diagnose(
                    "size-impossible", attribute=name, shape=tag, stated=shape.get(name)
                )
                yield CheckFinding(
                    "link", link, message, place=Place(robot.file.path, shape.sourceline)
                )


def _list_shapes(robot: UrdfModel) -> Iterator[tuple[str, etree._Element, etree._Element]]:
    """Yield the shapes of a URDF: link, <geometry>, and the shape element, such as <box>."""
    for name, link in robot.file.tree.links.items():
        for _, shape, _ in link.shapes:
            geometry = shape.find("geometry")
            for form in geometry.iterchildren(tag=etree.Element):
                yield name, geometry, form


@rule
def geometry_empty(robot: UrdfModel) -> Iterator[CheckFinding]:
    """Find <geometry> elements without a shape."""
    for name, link in robot.file.tree.links.items():
        for tag, shape, form in link.shapes:
            if form is None:
                place = Place(robot.file.path, shape.find("geometry").sourceline)
                message = diagnose("geometry-empty", tag=tag)
                yield CheckFinding("link", name, message, place=place)


@rule
def mesh_mirrored(robot: UrdfModel) -> Iterator[CheckFinding]:
    """Find mesh scales with three negative factors; a single finding per file.

    A single negative factor is often intended.
    """
    found = [
        (link, shape)
        for link, _, shape in _list_shapes(robot)
        if shape.tag == "mesh" and (parse_numbers(shape.get("scale"), "1 1 1") < 0).all()
    ]
    for link, shape in found[:1]:
        message = diagnose(
            "mesh-mirrored",
            mesh=shape.get("filename"),
            scale=shape.get("scale"),
            others=len(found) - 1,
        )
        yield CheckFinding("link", link, message, place=Place(robot.file.path, shape.sourceline))


_OPTION_RANGES: dict[str, tuple[float, float, Severity, str]] = {
    "timestep": (*TIMESTEP_RANGE, Severity.ERROR, "s"),
    "impratio": (1e-3, 1e6, Severity.ERROR, ""),
    "iterations": (1, math.inf, Severity.ERROR, ""),
    "ls_iterations": (1, math.inf, Severity.ERROR, ""),
    # Larger tolerances stop the solver before the contact forces converge.
    "tolerance": (0, 1e-2, Severity.ERROR, ""),
    "ls_tolerance": (0, 1.0, Severity.WARNING, ""),
    "noslip_tolerance": (0, 1e-2, Severity.WARNING, ""),
    "ccd_tolerance": (0, 1e-2, Severity.ERROR, "m"),
    "density": (0, 2e4, Severity.ERROR, "kg/m^3"),
    "viscosity": (0, 1e3, Severity.ERROR, "Pa s"),
}
"""{option of an MJCF: (minimum, maximum, severity of the finding, unit)}. Values outside are
reported, because the simulation of a robot would be useless or too slow. Chosen, not tuned."""


@rule
def option_out_of_range(robot: MjcfModel) -> Iterator[CheckFinding]:
    """Find time steps, solver settings and fluid properties of an MJCF outside `_OPTION_RANGES`."""
    option = robot.file.spec.option
    for name, (least, greatest, severity, unit) in _OPTION_RANGES.items():
        value = float(getattr(option, name))
        if not least <= value <= greatest:
            message = diagnose(
                "option-out-of-range",
                option=name,
                value=value,
                unit=unit,
                least=least,
                greatest=greatest,
                below=value < least,
            )
            place = find_first_place(robot.file, "option", name)
            yield CheckFinding("option", "", message, place=place, severity=severity)


# Rules about the notation of rotations.

FULL_TURN = 2 * math.pi + 1e-3
"""Largest magnitude of an angle of ``rpy`` [rad] that is not reported: a turn, with a tolerance for
rounding."""


@rule
def rpy_in_degrees(robot: UrdfModel) -> Iterator[CheckFinding]:
    """Find <origin> elements of a URDF with an ``rpy`` above `FULL_TURN` in magnitude [rad]."""
    for element in robot.file.root.iter("origin"):
        rpy = parse_numbers(element.get("rpy"), "0 0 0")
        if np.abs(rpy).max() > FULL_TURN:
            owner = element.getparent()
            while owner.tag not in ("link", "joint") and owner.getparent() is not None:
                owner = owner.getparent()
            line = Place(robot.file.path, element.sourceline)
            message = diagnose("rpy-in-degrees", angles=Vector(tuple(rpy), "rad"))
            yield CheckFinding(str(owner.tag), str(owner.get("name")), message, place=line)
