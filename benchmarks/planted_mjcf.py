"""Defects of the kinds of `planted.py`, written into an MJCF.

The MJCF is one that MuJoCo converts from a URDF: angles are in rad, and each body of a link has the
name of the link. `KINDS` contains one planting function for each kind of `planted.KINDS`.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from planted import Element, read_numbers, write_numbers


@dataclass(frozen=True)
class Site:
    """Copy of an MJCF, and the element that is edited.

    Attributes:
        root: Root element of the copy.
        rng: Random numbers.
        sizes: {link: largest extent of its shapes [m]} of the published URDF.
    """

    root: Element
    rng: random.Random
    sizes: Mapping[str, float]

    def choose_joint(self, attribute: str = "name") -> Element | None:
        """Return a random hinge or slide with an attribute; None without such a joint."""
        joints = [
            joint
            for joint in self.root.iter("joint")
            if joint.get("type", "hinge") in ("hinge", "slide") and joint.get(attribute)
        ]
        return self.rng.choice(joints) if joints else None

    def choose_body(self, *paths: str) -> Element | None:
        """Return a random body with a hinge or slide and with elements at all paths."""
        bodies = [
            body
            for body in self.root.iter("body")
            if any(joint.get("type", "hinge") != "free" for joint in body.findall("joint"))
            and all(body.find(path) is not None for path in paths)
        ]
        return self.rng.choice(bodies) if bodies else None

    def get_size(self, body: Element) -> float:
        """Return the largest extent of the shapes of a body [m]; 0.1 if it is unknown."""
        return self.sizes.get(str(body.get("name")), 0.1)


Planter = Callable[[Site], str | None]
"""Function that edits a copy, and returns the name of the edited body, joint or mesh ("" for the
whole file); None if the robot has no such element."""


def scale_lengths(site: Site, factor: float) -> str | None:
    """Scale all positions, sizes and meshes."""
    for element in site.root.iter():
        if element.tag in ("body", "inertial", "geom", "joint", "site") and element.get("pos"):
            write_numbers(
                element, "pos", [factor * value for value in read_numbers(element, "pos")]
            )
        if element.tag in ("geom", "site") and element.get("size"):
            write_numbers(
                element, "size", [factor * value for value in read_numbers(element, "size")]
            )
        if element.tag == "mesh":
            write_numbers(
                element,
                "scale",
                [factor * value for value in read_numbers(element, "scale", "1 1 1")],
            )
    return ""


def edit_joint(attribute: str, edit: Callable[[list[float]], list[float]]) -> Planter:
    """Return a defect that edits the axis or range of a joint."""

    def plant(site: Site) -> str | None:
        joint = site.choose_joint("name" if attribute == "axis" else attribute)
        if joint is None:
            return None
        write_numbers(joint, attribute, edit(read_numbers(joint, attribute, "0 0 1")))
        return str(joint.get("name"))

    return plant


def edit_moments(edit: Callable[[list[float]], list[float]]) -> Planter:
    """Return a defect that edits the principal moments of a moving body."""

    def plant(site: Site) -> str | None:
        body = site.choose_body("inertial")
        if body is None:
            return None
        inertial = body.find("inertial")
        if inertial.get("diaginertia") is None:
            return None
        write_numbers(inertial, "diaginertia", edit(read_numbers(inertial, "diaginertia")))
        return str(body.get("name"))

    return plant


def edit_body(*paths: str) -> Callable[[Callable[[Site, Element], None]], Planter]:
    """Return a decorator that makes a defect of a function that edits a moving body."""

    def decorate(edit: Callable[[Site, Element], None]) -> Planter:
        def plant(site: Site) -> str | None:
            body = site.choose_body(*paths)
            if body is None:
                return None
            edit(site, body)
            return str(body.get("name"))

        return plant

    return decorate


@edit_body("inertial")
def write_grams(_: Site, body: Element) -> None:
    """Write mass and moments of a moving body in g and g m^2."""
    inertial = body.find("inertial")
    for word in ("mass", "diaginertia"):
        write_numbers(inertial, word, [1000 * value for value in read_numbers(inertial, word)])


@edit_body("inertial")
def clear_mass(_: Site, body: Element) -> None:
    """Write a mass of zero, and keep the moments."""
    body.find("inertial").set("mass", "0")


@edit_body("inertial")
def remove_inertial(_: Site, body: Element) -> None:
    """Remove <inertial> from a moving body."""
    body.remove(body.find("inertial"))


@edit_body("geom")
def remove_collision(_: Site, body: Element) -> None:
    """Remove the geoms of a moving body."""
    for geom in body.findall("geom"):
        body.remove(geom)


@edit_body("geom")
def displace_collision(site: Site, body: Element) -> None:
    """Translate the geoms of a moving body by 1.5 times its size along x."""
    for geom in body.findall("geom"):
        shift(geom, 0, 1.5 * site.get_size(body))


@edit_body("inertial")
def displace_com(site: Site, body: Element) -> None:
    """Translate the CoM of a moving body by twice its size along z."""
    shift(body.find("inertial"), 2, 2.0 * site.get_size(body))


def shift(element: Element, axis: int, distance: float) -> None:
    """Translate the position of an element along an axis [m]."""
    position = read_numbers(element, "pos")
    position[axis] += distance
    write_numbers(element, "pos", position)


def break_mesh_path(site: Site) -> str | None:
    """Append an extension to the path of a mesh that a geom uses."""
    bodies = [body for body in site.root.iter("body") if body.find("geom[@mesh]") is not None]
    if not bodies:
        return None
    body = site.rng.choice(bodies)
    name = body.find("geom[@mesh]").get("mesh")
    mesh = site.root.find(f"asset/mesh[@name='{name}']")
    mesh.set("file", f"{mesh.get('file')}.missing")
    return str(name)


def displace_joint(site: Site) -> str | None:
    """Translate a body with a slide or hinge into its parent, as `planted.displace_joint`."""
    slides = [joint for joint in site.root.iter("joint") if joint.get("type") == "slide"]
    body = site.rng.choice(slides).getparent() if slides else site.choose_body("joint")
    if body is None:
        return None
    joint = body.find("joint")
    direction = np.array(read_numbers(joint, "axis", "0 0 1") if slides else [1.0, 0.0, 0.0])
    for index in np.flatnonzero(direction).tolist():
        step = -0.6 * site.get_size(body) * direction[index] / float(np.linalg.norm(direction))
        shift(body, index, step)
    return str(joint.get("name"))


KINDS: dict[str, Planter] = {
    "lengths in mm": lambda site: scale_lengths(site, 1000.0),
    "lengths in km": lambda site: scale_lengths(site, 1e-3),
    "axis reversed": edit_joint("axis", lambda axis: [0.0 - value for value in axis]),
    "axis of zeros": edit_joint("axis", lambda _: [0.0, 0.0, 0.0]),
    "limits exchanged": edit_joint("range", lambda ends: ends[::-1]),
    "limits in degrees": edit_joint("range", lambda ends: [math.degrees(end) for end in ends]),
    "inertia of zeros": edit_moments(lambda _: [0.0, 0.0, 0.0]),
    "moment too large": edit_moments(lambda each: [*each[:2], 3 * (each[0] + each[1])]),
    "moment negative": edit_moments(lambda each: [-each[0], *each[1:]]),
    "mass in g": write_grams,
    "mass of zero": clear_mass,
    "no inertial": remove_inertial,
    "no collision shape": remove_collision,
    "collision shape displaced": displace_collision,
    "CoM outside": displace_com,
    "mesh path broken": break_mesh_path,
    "joint displaced": displace_joint,
}
"""{name of the kind: planting function}."""
