"""The side of a URDF in matching: its base, its joints, its links."""

from __future__ import annotations

import copy
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
from lxml import etree

from pupper_analysis.checks.matching_places import at_zero
from pupper_analysis.diagnostics import Diagnostic, Quantity, Term, diagnose
from pupper_analysis.errors import ModelError
from pupper_analysis.models import parameters
from pupper_analysis.models.capsules import for_engines
from pupper_analysis.models.places import one_line
from pupper_analysis.robot.robot import Robot

MOVING = ("revolute", "continuous", "prismatic")


def without_shapes(urdf: etree._Element) -> etree._Element:
    """Returns a copy of a URDF's XML without visuals and collision shapes."""
    root = copy.deepcopy(urdf)
    for link in root.iter("link"):
        for tag in ("visual", "collision"):
            for shape in link.findall(tag):
                link.remove(shape)
    return root


def root_link(root: etree._Element) -> etree._Element:
    """Returns the link that is no joint's child."""
    children = {child.get("link") for child in root.findall("joint/child")}
    return next(link for link in root.findall("link") if link.get("name") not in children)


def strip_roots(
    root: etree._Element, source: Path, other: parameters.Parameters
) -> tuple[etree._Element, list[Diagnostic]]:
    """Takes out root links without mass, as long as they carry one fixed or floating joint.

    Where such a link's frame, not that of the base on it, is the one that the MJCF has, the link
    stays: whichever brings the joints nearer to the MJCF's.
    """
    candidates: list[tuple[etree._Element, list[Diagnostic]]] = [(root, [])]
    while True:
        tree, said = copy.deepcopy(candidates[-1][0]), list(candidates[-1][1])
        link = root_link(tree)
        name = link.get("name")
        mass = link.find("inertial/mass")
        heavy = mass is not None and float(mass.get("value")) > 0
        joints = [joint for joint in tree.findall("joint") if end_link(joint, "parent") == name]
        if heavy or len(joints) != 1 or joints[0].get("type") not in ("fixed", "floating"):
            break
        left = "link", str(name)
        said.append(diagnose("root-link-left-out", subject=left, file=source.name, sources=source))
        tree.remove(link)
        tree.remove(joints[0])
        if joints[0].get("type") == "floating":
            candidates.clear()  # the base cannot stay on a joint that floats by itself
        candidates.append((tree, said))
    there = at_zero(other)

    def distance(tree: etree._Element) -> float:
        here = at_zero(urdf_tree(tree, source))
        common = [name for name in here if name in there]
        apart = sum(float(np.linalg.norm(here[name][0] - there[name][0])) for name in common)
        return round(apart, 6)

    if len(candidates) == 1 or not other.floating:
        return candidates[-1]  # a fixed base is put where the MJCF has it
    # The last of the equally good: no needless root.
    best = min(reversed(candidates), key=lambda candidate: distance(candidate[0]))
    return best[0], best[1]


def take_mass_of_base(root: etree._Element, source: Path) -> list[Diagnostic]:
    """Takes the inertials off the base and what is fixed to it, in place; tells what they weighed.

    For an MJCF whose base is the world, which has no mass: a fixed base's has no effect either.
    """
    waiting, masses = [str(root_link(root).get("name"))], {}
    while waiting:
        name = waiting.pop()
        for link in root.findall("link"):
            inertial = link.find("inertial") if link.get("name") == name else None
            if inertial is not None:
                masses[name] = float(inertial.find("mass").get("value"))
                link.remove(inertial)
        waiting += [
            end_link(joint, "child")
            for joint in root.findall("joint")
            if joint.get("type") == "fixed" and end_link(joint, "parent") == name
        ]
    if not any(masses.values()):
        return []
    heaviest, mass = max(masses, key=masses.__getitem__), Quantity(sum(masses.values()), "kg")
    base = "link", heaviest
    return [diagnose("mass-of-base-left-out", subject=base, mass=mass, file=source.name)]


def end_link(joint: etree._Element, tag: str) -> str:
    """Returns the link at one end of a joint: ``parent`` or ``child``."""
    return str(joint.find(tag).get("link"))


def moving_joints(root: etree._Element) -> tuple[list[str], list[str], list[Diagnostic]]:
    """Returns the names of the hinges and slides, and of other joints, which are fixed, in place.

    These are floating and planar ones inside the tree: what they carry is compared as at rest. The
    third says so.
    """
    moving, others, notes = [], [], []
    for joint in root.findall("joint"):
        kind, name = joint.get("type"), str(joint.get("name"))
        if kind in MOVING:
            moving.append(name)
        elif kind != "fixed":
            others.append(name)
            joint.set("type", "fixed")
            notes.append(diagnose("joint-fixed", subject=("joint", name), kind=Term(kind)))
    return moving, others, notes


def fix_joints(root: etree._Element, names: Iterable[str]) -> None:
    """Makes joints fixed, in place."""
    fixed = set(names)
    for joint in root.findall("joint"):
        if joint.get("name") in fixed:
            joint.set("type", "fixed")


def links_of(root: etree._Element, robot: Robot) -> dict[str, str]:
    """Returns {base or joint: the link that it moves}."""
    links = {robot.base: str(root_link(root).get("name"))}
    for joint in root.findall("joint"):
        if joint.get("name") in robot.joint_names:
            links[str(joint.get("name"))] = end_link(joint, "child")
    return links


def urdf_tree(
    root: etree._Element, source: Path, base: str = "", frames: Iterable[str] = ()
) -> parameters.Parameters:
    """Returns the parameters of a URDF's joints and bodies, with a free base.

    Args:
        root: Its XML; all its joints are fixed, hinges or slides.
        source: Where it came from, for messages.
        base: What its base is called.
        frames: Links whose places count.

    Raises:
        ModelError: If Pinocchio cannot read it.
    """
    text = for_engines(root)
    try:
        model = pin.buildModelFromXML(text, pin.JointModelFreeFlyer())
    except (ValueError, RuntimeError) as error:
        raise ModelError(source, diagnose("urdf-not-valid", message=one_line(error))) from error
    names = list(model.names)[2:]
    return parameters.from_pinocchio(model, base, names, {name: name for name in frames})


@dataclass(frozen=True, eq=False)
class FixedLinks:
    """What of a URDF's links moves as one.

    Attributes:
        masses: {link: kg}, of those with a mass.
        children: {link: the links that are fixed to it}, in the file's order.
    """

    masses: dict[str, float]
    children: dict[str, list[str]]


def fixed_links(root: etree._Element) -> FixedLinks:
    """Returns which links are fixed to which, and what they weigh."""
    masses = {
        str(link.get("name")): float(link.find("inertial/mass").get("value"))
        for link in root.findall("link")
        if link.find("inertial/mass") is not None
    }
    children: dict[str, list[str]] = {}
    for joint in root.findall("joint"):
        if joint.get("type") == "fixed":
            parent = str(joint.find("parent").get("link"))
            children.setdefault(parent, []).append(str(joint.find("child").get("link")))
    return FixedLinks(masses, children)
