"""What elements of a new MJCF share, as default classes."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence

from lxml import etree

from pupper_analysis.models.xml import free_name

_SHARED = {
    "joint": ("type", "axis", "range", "damping", "frictionloss", "armature"),
    "position": ("kp", "kv", "forcerange"),
}
"""Attributes that several elements of a kind may share."""


def put_defaults(root: etree._Element) -> None:
    """Moves what elements share into default classes, and takes it off the elements.

    What more than half of a kind have goes into the top class, if all have some of it. Joints that
    have the rest in common get a class, named after what their names have in common.
    """
    top = root.find("default")
    assert top is not None
    taken = {str(default.get("class")) for default in root.iter("default")} | {
        "main"
    }  # MuJoCo's own
    for tag, attributes in _SHARED.items():
        elements = [found for found in root.iter(tag) if found.getparent().tag != "default"]
        if len(elements) < 2:
            continue
        common = _common(elements, attributes)
        if common:
            place = etree.Element(tag, common)
            top.insert(len(top.findall("joint")), place)
            for element in elements:
                for name in common:
                    if element.get(name) == common[name]:
                        del element.attrib[name]
        _put_classes(top, elements, attributes, taken)


def _common(elements: Sequence[etree._Element], attributes: Sequence[str]) -> dict[str, str]:
    """Returns {attribute: its value in most elements}, of attributes that all of them have."""
    common = {}
    for name in attributes:
        values = Counter(element.get(name) for element in elements)
        if None in values:
            continue
        value, count = values.most_common(1)[0]
        if 2 * count > len(elements):
            common[name] = str(value)
    return common


def _put_classes(
    top: etree._Element,
    elements: Sequence[etree._Element],
    attributes: Sequence[str],
    taken: set[str],
) -> None:
    groups: dict[tuple[tuple[str, str], ...], list[etree._Element]] = {}
    for element in elements:
        rest = tuple((name, element.get(name)) for name in attributes if element.get(name))
        groups.setdefault(rest, []).append(element)
    for rest, members in groups.items():
        if len(members) < 2 or not rest:
            continue
        names = [str(member.get("joint") or member.get("name")) for member in members]
        # A class of joints and one of their servos may share a name, and are one class then.
        name = _shared_part(names)
        twin = next(
            (d for d in top if d.get("class") == name and not d.findall(members[0].tag)), None
        )
        if twin is None:
            twin = etree.SubElement(top, "default", {"class": free_name(name, taken)})
        etree.SubElement(twin, members[0].tag, dict(rest))
        for member in members:
            for attribute, _ in rest:
                del member.attrib[attribute]
            member.set("class", str(twin.get("class")))


def _shared_part(names: Sequence[str]) -> str:
    """Returns what names have in common: ``hip`` of ``FL_hip_joint`` and ``FR_hip_joint``."""
    parts = [[part for part in re.split(r"[^A-Za-z0-9]+", name) if part] for name in names]
    shared = [part for part in parts[0] if all(part in other for other in parts[1:])]
    kept = [part for part in shared if part.lower() not in ("joint", "servo")] or shared
    if kept:
        return "_".join(kept)
    return _shared_ending(names) or "shared"


def _shared_ending(names: Sequence[str]) -> str:
    """Returns the letters that all names end in, if there are two or more."""
    ending = ""
    for letters in zip(*(reversed(name) for name in names), strict=False):
        if len(set(letters)) > 1:
            break
        ending = letters[0] + ending
    ending = ending.strip("_- ")
    return ending if len(ending) > 1 else ""
