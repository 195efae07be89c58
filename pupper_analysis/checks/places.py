"""Where the numbers of a difference stand, in both files."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from pupper_analysis.checks.differences import Difference
from pupper_analysis.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.matching.match import Match
from pupper_analysis.models.attributes import IN_A_TREE, JOINT_ATTRIBUTES
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.places import Place
from pupper_analysis.models.urdf_file import UrdfFile
from pupper_analysis.models.urdf_tree import UrdfTree

URDF_CHILD = {
    "mass": "inertial/mass",
    "com": "inertial/origin",
    "inertia": "inertial/inertia",
    "zero": "origin",
    "position": "origin",
    "rotation": "origin",
    "axis": "axis",
    "mimic": "mimic",
    # Where it would stand, of what a URDF has no words for.
    **{one.kind: one.urdf[0] if one.urdf else "dynamics" for one in IN_A_TREE},
}

MJCF_SECTION = {
    "tendon": "tendon",
    "actuator": "actuator",
    "equality": "equality",
    "flex": "deformable",
}
"""Sections of an MJCF whose elements a URDF has none of."""

WHOLE = {"fluid": ("density", "viscosity"), "gravity": ("gravity",), "flag": (), "plugin": ()}
"""Kinds that concern the whole of a URDF, and the options of the MJCF that state them."""


MJCF_ATTRIBUTES = {
    "axis": ("axis",),
    **{one.kind: one.mjcf for one in JOINT_ATTRIBUTES},
}
"""The attributes that state a kind of number, in an element or in a default class."""


def urdf_members(matched: Match, mover: str) -> list[tuple[str, float]]:
    """Returns (link, kg) of the links with mass that move with a joint, or are the base.

    The link that the joint moves comes first, though it may have none.
    """
    return links_moving_with(matched.urdf_tree, matched.urdf_link[mover])


def links_moving_with(tree: UrdfTree, top: str) -> list[tuple[str, float]]:
    """Returns (link, kg) of a URDF's link, and of those with mass on fixed joints below it."""
    masses = [(name, tree.links[name].mass or 0.0) for name in tree.fixed_group(top)]
    return [masses[0], *((name, mass) for name, mass in masses[1:] if mass)]


def mjcf_members(matched: Match, mover: str) -> list[tuple[str, float]]:
    """Returns (body, kg) of the bodies with mass that move with a joint, or are the base.

    The body that the joint moves comes first, though it may have none.
    """
    return bodies_moving_with(matched.robot.mj_model, matched.mjcf_body[mover])


def bodies_moving_with(model: mujoco.MjModel, body: str) -> list[tuple[str, float]]:
    """Returns (body, kg) of an MJCF's body, and of those with mass that are welded to it."""
    top = model.body(body).id
    welded = np.flatnonzero(model.body_weldid == model.body_weldid[top]).tolist()
    group = [each for each in welded if model.body_mass[each] > 0 or each == top]
    group.sort(key=lambda each: each != top)
    return [(str(model.body(each).name), float(model.body_mass[each])) for each in group]


def shares(
    difference: Difference, matched: Match, urdf: UrdfFile, mjcf: MjcfFile
) -> tuple[Diagnostic, ...]:
    """Says of which links or bodies a mass, a com or an inertia is made, with their lines."""
    if difference.kind not in ("mass", "com", "inertia"):
        return ()
    told = []
    for file, members, place in (
        (
            "URDF",
            urdf_members(matched, difference.element),
            lambda name: urdf.place("link", name, URDF_CHILD[difference.kind]),
        ),
        ("MJCF", mjcf_members(matched, difference.element), mjcf.weighing),
    ):
        heavy = [(name, mass) for name, mass in members if mass]
        if len(heavy) < 2:
            continue
        total = sum(mass for _, mass in heavy)
        heavy.sort(key=lambda member: -member[1])
        members_told = [
            diagnose(
                "share-of-a-body",
                subject=("body", name),
                mass=Quantity(mass, "kg"),
                share=Quantity(mass / total, "1"),
                place=str(place(name)),
            )
            for name, mass in heavy[:_LISTED]
        ]
        rest = total - sum(mass for _, mass in heavy[:_LISTED])
        told.append(
            diagnose(
                "body-is-made-of",
                file=file,
                members=members_told,
                more=len(heavy[_LISTED:]),
                rest=Quantity(rest, "kg"),
            )
        )
    return tuple(told)


_LISTED = 6
"""Links of a body that are listed, the heaviest first."""


def path_of(place: Place) -> str:
    """Returns the whole path, by which a CI service finds the file."""
    return f"{place.file}" if place.line is None else f"{place.file}:{place.line}"


def urdf_place(difference: Difference, matched: Match, file: UrdfFile) -> Place:
    """Returns where a difference stands in the URDF."""
    child = URDF_CHILD.get(difference.kind)
    movers = {body: mover for mover, body in matched.mjcf_body.items()}
    if difference.kind == "gravity compensation":
        mover = movers.get(difference.element)
        return Place(file.path) if mover is None else file.place("link", matched.urdf_link[mover])
    if difference.kind in MJCF_SECTION or difference.kind in WHOLE:
        return Place(file.path)
    if difference.kind in ("mass", "com", "inertia"):
        heaviest = max(urdf_members(matched, difference.element), key=lambda member: member[1])[0]
        return file.place("link", heaviest, child)
    if difference.element in (matched.robot.base, matched.reference.base):
        return file.place("link", matched.urdf_link[matched.robot.base], child)
    if difference.kind == "frame":
        link = matched.robot.description.frames[difference.element][0]
        joint = file.tree.above.get(link)
        if joint is None:
            return file.place("link", link)
        return file.place("joint", joint.name, "origin")
    return file.place("joint", matched.urdf_joint[difference.element], child)


def mjcf_place(difference: Difference, matched: Match, file: MjcfFile) -> Place:
    """Returns where a difference stands in the MJCF."""
    element, kind = difference.element, difference.kind
    if kind in MJCF_SECTION:
        if not element.startswith("#"):
            return file.place(MJCF_SECTION[kind], element)
        if matched.only_mjcf:  # the numbers are those of what was left
            return Place(file.path)
        return file.numbered(MJCF_SECTION[kind], int(element[1:]))
    if kind in WHOLE:
        words = {"flag": (element,)}.get(kind, WHOLE[kind])
        tag = "flag" if kind == "flag" or not words else "option"
        stated = (at for found, at in file.elements(tag) if set(words) & set(found))
        return next(stated, Place(file.path))
    if kind in ("gravity compensation", "plugin"):
        return file.place("body", element)
    if difference.kind == "base frame":
        return file.place("body", matched.mjcf_body[element])
    if difference.kind in ("mass", "com", "inertia"):
        heaviest = max(mjcf_members(matched, element), key=lambda member: member[1])[0]
        return file.weighing(heaviest)
    if element in (matched.robot.base, matched.reference.base):
        return file.place("body", matched.mjcf_body[matched.robot.base], "joint")
    if difference.kind in ("zero", "position", "rotation", "parent"):
        return file.place("body", matched.mjcf_body[element])
    body = matched.mjcf_body.get(element, "")
    tries = [("joint", element, None), ("body", body, "joint")]
    if difference.kind == "effort":
        tries.insert(0, ("actuator", element, None))
    if difference.kind == "frame":
        name = matched.robot.description.frames[element][1]
        tries = [("site", name, None), ("body", name, None), ("geom", name, None)]
    return first_place(file, kind, tries)


def first_place(file: MjcfFile, kind: str, tries: Sequence[tuple[str, str, str | None]]) -> Place:
    """Returns where a kind of number is stated, or else the first of its elements that is there.

    Args:
        file: The MJCF.
        kind: Of the difference.
        tries: Tag, name and child of the elements that may state it.
    """
    for tag, name, below in tries:
        place = None if below else file.stated(tag, name, MJCF_ATTRIBUTES.get(kind, ()))
        if place is not None:
            return place
    places = [file.place(*one) for one in tries]
    return next((place for place in places if place.line is not None), places[0])
