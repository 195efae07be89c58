"""Where the numbers of a difference stand, in both files."""

from __future__ import annotations

from pupper_analysis.checks.differences import Difference
from pupper_analysis.checks.matching import Match
from pupper_analysis.models.mjcf_file import MjcfFile
from pupper_analysis.models.places import Place
from pupper_analysis.models.urdf_file import UrdfFile

_URDF_CHILD = {
    "mass": "inertial/mass",
    "com": "inertial/origin",
    "inertia": "inertial/inertia",
    "zero": "origin",
    "position": "origin",
    "rotation": "origin",
    "axis": "axis",
    "lower limit": "limit",
    "upper limit": "limit",
    "effort": "limit",
    "velocity": "limit",
    "damping": "dynamics",
    "friction": "dynamics",
    "armature": "dynamics",
    "mimic": "mimic",
}

_MJCF_SECTION = {
    "tendon": "tendon",
    "actuator": "actuator",
    "equality": "equality",
    "flex": "deformable",
}
"""Sections of an MJCF whose elements a URDF has none of."""

_WHOLE = {"fluid": ("density", "viscosity"), "gravity": ("gravity",), "flag": (), "plugin": ()}
"""Kinds that concern the whole of a URDF, and the options of the MJCF that state them."""


def path_of(place: Place) -> str:
    """Returns the whole path, by which a CI service finds the file."""
    return f"{place.file}" if place.line is None else f"{place.file}:{place.line}"


def urdf_place(difference: Difference, matched: Match, file: UrdfFile) -> Place:
    """Returns where a difference stands in the URDF."""
    child = _URDF_CHILD.get(difference.kind)
    movers = {body: mover for mover, body in matched.mjcf_body.items()}
    if difference.kind == "gravity compensation":
        mover = movers.get(difference.element)
        return Place(file.path) if mover is None else file.place("link", matched.urdf_link[mover])
    if difference.kind in _MJCF_SECTION or difference.kind in _WHOLE:
        return Place(file.path)
    if difference.kind in ("mass", "com", "inertia") or difference.element == matched.robot.base:
        return file.place("link", matched.urdf_link[difference.element], child)
    if difference.kind == "frame":
        link = matched.robot.description.frames[difference.element][0]
        joint = next(
            (
                element
                for element in file.root.findall("joint")
                if element.find("child") is not None and element.find("child").get("link") == link
            ),
            None,
        )
        if joint is None:
            return file.place("link", link)
        return file.place("joint", str(joint.get("name")), "origin")
    return file.place("joint", matched.urdf_joint[difference.element], child)


def mjcf_place(difference: Difference, matched: Match, file: MjcfFile) -> Place:
    """Returns where a difference stands in the MJCF."""
    element, kind = difference.element, difference.kind
    if kind in _MJCF_SECTION:
        if not element.startswith("#"):
            return file.place(_MJCF_SECTION[kind], element)
        if matched.only_mjcf:  # the numbers are those of what was left
            return Place(file.path)
        return file.numbered(_MJCF_SECTION[kind], int(element[1:]))
    if kind in _WHOLE:
        words = {"flag": (element,)}.get(kind, _WHOLE[kind])
        tag = "flag" if kind == "flag" or not words else "option"
        stated = (at for found, at in file.elements(tag) if set(words) & set(found))
        return next(stated, Place(file.path))
    if kind in ("gravity compensation", "plugin"):
        return file.place("body", element)
    if difference.kind == "base frame":
        return file.place("body", matched.mjcf_body[element])
    if difference.kind in ("mass", "com", "inertia"):
        return file.place("body", matched.mjcf_body[element], "inertial")
    if element == matched.robot.base:
        return file.place("body", matched.mjcf_body[element], "joint")
    if difference.kind in ("zero", "position", "rotation", "parent"):
        return file.place("body", matched.mjcf_body[element])
    body = matched.mjcf_body.get(element, "")
    tries = [("joint", element, None), ("body", body, "joint")]
    if difference.kind == "effort":
        tries.insert(0, ("actuator", element, None))
    if difference.kind == "frame":
        name = matched.robot.description.frames[element][1]
        tries = [("site", name, None), ("body", name, None), ("geom", name, None)]
    places = [file.place(*one) for one in tries]
    return next((place for place in places if place.line is not None), places[0])
