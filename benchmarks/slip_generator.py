"""Draw a random plausible mistake in an MJCF or a URDF: a sign, a power of ten, a unit, a swapped
pair.

The file is an XML tree; equal trees and random numbers give equal mistakes.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from lxml import etree

Element = etree._Element
Change = Callable[[list[float], np.random.Generator], list[float]]

Slip = str
"""What was done, in words: the change, the element, the attribute."""

NAMES = {
    "name",
    "class",
    "childclass",
    "joint",
    "site",
    "body",
    "material",
    "mesh",
    "geom",
    "model",
    "file",
    "filename",
    "texture",
    "link",
    "user",
    "rgba",
    "objtype",
    "objname",
    "target",
    "tendon",
}
"""Attributes whose numbers are not edited: most contain names, or have no effect."""

VISUAL_TAGS = {
    "visual",
    "asset",
    "statistic",
    "camera",
    "light",
    "material",
    "texture",
    "color",
    "size",
}
"""Elements that are not edited: most affect only the appearance."""


def change_one(change: Callable[[float], float]) -> Change:
    """Return a change of one random number of several."""

    def changed(values: list[float], random: np.random.Generator) -> list[float]:
        at = int(random.integers(len(values)))
        return [change(v) if i == at else v for i, v in enumerate(values)]

    return changed


def change_each(change: Callable[[float], float]) -> Change:
    """Return a change of each of several numbers."""
    return lambda values, _: [change(value) for value in values]


def _swap_two(values: list[float], random: np.random.Generator) -> list[float]:
    """Exchange two random numbers."""
    if len(values) < 2:
        return values
    first, second = (int(i) for i in random.choice(len(values), 2, replace=False))
    values[first], values[second] = values[second], values[first]
    return values


def _roll(values: list[float], _: np.random.Generator) -> list[float]:
    """Move the first number to the end: w x y z becomes x y z w."""
    return [*values[1:], values[0]]


def _drop_last_digit(value: float) -> float:
    """Return a number without its last digit; a tenth of a number with a single digit."""
    text = f"{value:.9g}"
    try:
        return float(text[:-1])
    except ValueError:  # it has one alone
        return value / 10


CHANGES: dict[str, Change] = {
    "sign of one": change_one(lambda v: -v),
    "sign of all": change_each(lambda v: -v),
    "ten times": change_one(lambda v: 10 * v),
    "a tenth": change_one(lambda v: v / 10),
    "a hundred times": change_each(lambda v: 100 * v),
    "a thousand times": change_each(lambda v: 1000 * v),
    "a thousandth": change_each(lambda v: v / 1000),
    "a millionth": change_each(lambda v: v / 1e6),
    "degrees": change_each(math.degrees),
    "radians": change_each(math.radians),
    "inches": change_each(lambda v: v / 0.0254),
    "zero": change_one(lambda _: 0.0),
    "one": change_one(lambda _: 1.0),
    "swapped": _swap_two,
    "rolled": _roll,
    "reversed": lambda values, _: values[::-1],
    "twice": change_each(lambda v: 2 * v),
    "half": change_each(lambda v: v / 2),
    "inverse": change_each(lambda v: 1 / v if v else v),
    "one is missing": lambda values, _: values[:-1] or values,
    "one too many": lambda values, _: [*values, values[-1]],
    "a digit is lost": change_one(_drop_last_digit),
}
"""{name: change of the numbers of an attribute}."""

ADDED: dict[str, dict[str, tuple[str, ...]]] = {
    "joint": {
        "damping": ("-1", "50", "1000"),
        "frictionloss": ("-1", "5", "100"),
        "armature": ("-0.01", "1"),
        "stiffness": ("100", "-100"),
        "springref": ("1",),
        "ref": ("0.5",),
        "type": ("slide", "ball"),
        "range": ("0 0", "-1 1", "-90 90", "1 -1"),
        "actuatorfrcrange": ("-0.1 0.1", "1 -1", "1 2"),
        "margin": ("1",),
        "limited": ("false", "true"),
        "pos": ("0 0 0.1", "0.05 0 0"),
        "actuatorgravcomp": ("true",),
        "solreflimit": ("1 1", "-1 -1"),
    },
    "geom": {
        "contype": ("0", "2"),
        "conaffinity": ("0", "2"),
        "condim": ("1", "6"),
        "friction": ("0.01", "0", "-1"),
        "solref": ("1 1", "0.001 1", "-100 -1"),
        "solimp": ("0 0 1", "0.5 0.5 0.1"),
        "margin": ("0.1", "-0.1"),
        "gap": ("0.1",),
        "priority": ("1",),
        "mass": ("10", "-1", "0"),
        "density": ("-1", "1e5", "0"),
        "pos": ("0 0 0.1", "0 0 -100"),
        "group": ("3",),
        "type": ("ellipsoid", "plane", "box", "mesh"),
        "size": ("0.001", "-0.02", "1 1 1"),
        "euler": ("90 0 0", "0 0.5 0"),
        "quat": ("0 0 0 1", "0 0 0 0"),
        "solmix": ("0", "100"),
        "surfacevel": ("1 0 0 0 0 0",),
        "adhesion": ("1",),
        "shellinertia": ("true",),
    },
    "body": {
        "gravcomp": ("1", "-1", "10"),
        "mocap": ("true",),
        "pos": ("0 0 0", "0 0 1"),
        "quat": ("0 1 0 0", "0 0 0 0"),
        "euler": ("0 0 90", "180 0 0", "0 90 0"),
        "childclass": ("none",),
    },
    "inertial": {"euler": ("0 0 90",), "quat": ("0 0 0 0", "0.7 0 0.7 0")},
    "position": {
        "gear": ("-1", "10", "0.1", "0"),
        "ctrlrange": ("-1 1", "1 -1", "0 0", "-90 90", "5 6"),
        "forcerange": ("-0.1 0.1", "0 30", "5 25", "30 -30", "0 0"),
        "timeconst": ("20", "1e5", "0.02"),
        "kv": ("-5", "0", "1000"),
        "kp": ("-100", "0", "1"),
        "dampratio": ("1", "-1", "100"),
        "inheritrange": ("1", "0.1"),
        "delay": ("0.1", "10"),
        "group": ("1",),
        "damping": ("-5", "50"),
        "armature": ("-0.1", "10"),
        "actlimited": ("true",),
        "ctrllimited": ("false",),
        "forcelimited": ("false", "true"),
        "interp": ("linear",),
        "nsample": ("5",),
    },
    "general": {
        "gear": ("-1", "10", "0.1"),
        "ctrlrange": ("-1 1", "1 -1", "-90 90"),
        "forcerange": ("-0.1 0.1", "5 25"),
        "dyntype": ("integrator", "filter"),
        "biastype": ("none",),
        "gaintype": ("affine",),
        "biasprm": ("0 5 1", "0 0 0", "1 -5 -1"),
        "gainprm": ("-5", "0"),
        "group": ("1",),
        "delay": ("0.1",),
    },
    "option": {
        "timestep": ("0.01", "0.02", "0.05", "0", "-0.002", "2", "1e-7"),
        "gravity": ("0 0 9.81", "0 0 -981", "0 -9.81 0", "0 0 0", "9.81 0 0"),
        "integrator": ("Euler", "RK4", "implicit"),
        "solver": ("PGS", "CG"),
        "iterations": ("0", "1", "5"),
        "tolerance": ("1", "1e-2", "1e9"),
        "impratio": ("0", "-1", "100", "1e-3"),
        "cone": ("elliptic",),
        "density": ("1000", "-1"),
        "viscosity": ("10", "-1"),
        "wind": ("50 0 0",),
        "noslip_iterations": ("10",),
        "actuatorgroupdisable": ("0",),
        "o_margin": ("0.1",),
        "magnetic": ("0 0 0",),
        "ls_iterations": ("0", "1"),
        "jacobian": ("sparse",),
        "ccd_iterations": ("0",),
    },
    "compiler": {
        "angle": ("degree", "radian"),
        "autolimits": ("false",),
        "inertiafromgeom": ("true",),
        "eulerseq": ("zyx", "XYZ"),
        "boundmass": ("1",),
        "boundinertia": ("1",),
        "settotalmass": ("1", "1000"),
        "balanceinertia": ("true",),
        "coordinate": ("local",),
        "fusestatic": ("true",),
        "discardvisual": ("true",),
        "alignfree": ("true",),
    },
    "flag": dict.fromkeys(
        (
            "contact",
            "gravity",
            "actuation",
            "limit",
            "clampctrl",
            "constraint",
            "spring",
            "damper",
            "frictionloss",
            "equality",
            "refsafe",
            "filterparent",
            "warmstart",
            "eulerdamp",
        ),
        ("disable",),
    )
    | {"override": ("enable",), "multiccd": ("enable",), "sleep": ("enable",)},
    "key": {"time": ("1", "-1"), "act": ("1",), "qvel": ("1",)},
    "limit": {
        "lower": ("1", "-90", "0"),
        "upper": ("-1", "90", "0"),
        "effort": ("0", "-1", "0.1", "1e5"),
        "velocity": ("0", "-1"),
    },
    "dynamics": {"damping": ("-1", "100", "0.1"), "friction": ("-1", "100", "0.1")},
    "mimic": {},
    "origin": {
        "rpy": ("0 0 90", "1.5708 0 0", "0 0 3.14159", "0 nan 0"),
        "xyz": ("0 0 1", "100 0 0", "0,0,1"),
    },
}
"""{element: {attribute: values}} of attributes that are added or overwritten."""

MJCF_BLOCKS = (
    '<contact><exclude body1="world" body2="{body}"/></contact>',
    '<equality><weld body1="{body}"/></equality>',
    '<equality><connect body1="{body}" anchor="0 0 0"/></equality>',
    '<equality><joint joint1="{joint}"/></equality>',
    '<equality><joint joint1="{joint}" joint2="{other}"/></equality>',
    '<actuator><position joint="{joint}" kp="20"/></actuator>',
    '<actuator><motor joint="{joint}" gear="5"/></actuator>',
    '<actuator><velocity joint="{joint}" kv="10"/></actuator>',
    '<actuator><damper joint="{joint}" kv="10" ctrlrange="0 1"/></actuator>',
    '<actuator><general joint="{joint}" biastype="affine" biasprm="5 0 0"/></actuator>',
    '<tendon><fixed stiffness="50"><joint joint="{joint}" coef="1"/></fixed></tendon>',
    '<tendon><fixed range="-0.1 0.1"><joint joint="{joint}" coef="1"/></fixed></tendon>',
    '<tendon><fixed frictionloss="-5"><joint joint="{joint}" coef="1"/></fixed></tendon>',
    '<tendon><fixed damping="-5"><joint joint="{joint}" coef="1"/></fixed></tendon>',
    '<tendon><fixed stiffness="-50"><joint joint="{joint}" coef="1"/></fixed></tendon>',
    '<default><joint damping="-3"/></default>',
    '<default><geom contype="0" conaffinity="0"/></default>',
    '<default><geom friction="0.01"/></default>',
    '<default><joint range="-0.1 0.1"/></default>',
    '<default><position kp="-10"/></default>',
    '<default><joint axis="0 1 0"/></default>',
    '<worldbody><geom type="box" size="1 1 0.1"/></worldbody>',
    '<worldbody><geom type="plane" size="0 0 1" euler="0 10 0"/></worldbody>',
    '<worldbody><geom type="plane" size="0 0 1" pos="0 0 0.1"/></worldbody>',
    '<worldbody><body name="ball" pos="0 0 2"><freejoint/><geom size="0.1"/></body></worldbody>',
    '<keyframe><key name="zero"/></keyframe>',
)
"""Sections that are added to an MJCF, with placeholders for names."""


def draw_slip(root: Element, random: np.random.Generator) -> Slip:
    """Make a random mistake in an XML tree, in place.

    Returns:
        Description of the mistake; "" if the tree has no element for the kind that was drawn.
    """
    kinds = [
        _change_number,
        _change_number,
        _change_number,
        _change_number,
        _add_attribute,
        _exchange_values,
        _change_structure,
    ]
    return kinds[int(random.integers(len(kinds)))](root, random)


def _pick(items: list[object], random: np.random.Generator) -> object:
    """Return a random item of a list."""
    return items[int(random.integers(len(items)))]


def _list_physical_elements(root: Element) -> list[Element]:
    """Return the elements that may be edited: those outside of `VISUAL_TAGS`."""
    return [
        element
        for element in root.iter(etree.Element)
        if element.tag not in VISUAL_TAGS
        and not any(a.tag in VISUAL_TAGS for a in element.iterancestors())
    ]


def _parse_numbers(text: str) -> list[float] | None:
    """Return the numbers of a text; None if a word is no number."""
    try:
        return [float(word) for word in text.split()] or None
    except ValueError:
        return None


def _list_numbers(root: Element) -> dict[tuple[str, str], list[tuple[Element, list[float]]]]:
    """Return {(element, attribute): elements with their numbers} of a file."""
    found: dict[tuple[str, str], list[tuple[Element, list[float]]]] = {}
    for element in _list_physical_elements(root):
        for name, text in element.attrib.items():
            values = None if name in NAMES else _parse_numbers(text)
            if values is not None:
                found.setdefault((str(element.tag), name), []).append((element, values))
    return found


def _change_number(root: Element, random: np.random.Generator) -> Slip:
    """Change the numbers of an attribute, in one element or in all of a kind."""
    stated = _list_numbers(root)
    tag, attribute = sorted(stated)[int(random.integers(len(stated)))]
    places = stated[tag, attribute]
    name = list(CHANGES)[int(random.integers(len(CHANGES)))]
    everywhere = bool(random.integers(3) == 0)
    at = int(random.integers(len(places)))
    for element, values in places if everywhere else [places[at]]:
        new = CHANGES[name](list(values), random)
        element.set(attribute, " ".join(f"{value:.9g}" for value in new))
    return f"{name}: {tag}/{attribute} ({'all' if everywhere else at})"


def _add_attribute(root: Element, random: np.random.Generator) -> Slip:
    """Add or overwrite an attribute, in one element or in all of a kind."""
    present: dict[str, list[Element]] = {}
    for element in _list_physical_elements(root):
        present.setdefault(str(element.tag), []).append(element)
    if root.tag == "mujoco":
        for tag, parent in (("flag", "option"), ("compiler", ".")):
            above = root.find(parent)
            if above is not None and root.find(f".//{tag}") is None:
                present.setdefault(tag, []).append(etree.SubElement(above, tag))
    tags = sorted(tag for tag in present if ADDED.get(tag))
    tag = str(_pick(list(tags), random))
    attribute = str(_pick(sorted(ADDED[tag]), random))
    value = str(_pick(list(ADDED[tag][attribute]), random))
    everywhere = bool(random.integers(2))
    at = int(random.integers(len(present[tag])))
    for element in present[tag] if everywhere else [present[tag][at]]:
        element.set(attribute, value)
    return f'added: {tag}/{attribute}="{value}" ({"all" if everywhere else at})'


def _exchange_values(root: Element, random: np.random.Generator) -> Slip:
    """Exchange the values of an attribute between two elements of a kind."""
    pairs = {}
    for element in _list_physical_elements(root):
        for name in element.attrib:
            if name not in ("class", "childclass", "material"):
                pairs.setdefault((str(element.tag), name), []).append(element)
    pairs = {key: found for key, found in pairs.items() if len({e.get(key[1]) for e in found}) > 1}
    tag, attribute = sorted(pairs)[int(random.integers(len(pairs)))]
    found = pairs[tag, attribute]
    one, two = (int(i) for i in random.choice(len(found), 2, replace=False))
    first, second = found[one].get(attribute), found[two].get(attribute)
    if first == second:
        return ""
    found[one].set(attribute, second)
    found[two].set(attribute, first)
    return f"exchanged: {tag}/{attribute} ({one}, {two})"


def _change_structure(root: Element, random: np.random.Generator) -> Slip:
    """Remove, duplicate or add an element, remove an attribute, or change a name."""
    elements = [
        element for element in _list_physical_elements(root) if element.getparent() is not None
    ]
    tags = sorted({str(element.tag) for element in elements})
    tag = str(_pick(list(tags), random))
    of_tag = [element for element in elements if element.tag == tag]
    element = of_tag[int(random.integers(len(of_tag)))]
    kind = int(random.integers(5))
    if kind == 0:
        element.getparent().remove(element)
        return f"lost: {tag}"
    if kind == 1:
        names = sorted(element.attrib)
        if not names:
            return ""
        name = str(_pick(list(names), random))
        del element.attrib[name]
        return f"lost: {tag}/{name}"
    if kind == 2:
        copied = etree.fromstring(etree.tostring(element))
        if random.integers(2):
            for one in copied.iter():
                one.attrib.pop("name", None)
        element.addnext(copied)
        return f"twice: {tag}"
    if kind == 3 and root.tag == "mujoco":
        joints = [j.get("name") for j in root.iter("joint") if j.get("name")]
        bodies = [b.get("name") for b in root.iter("body") if b.get("name")]
        text = str(_pick(list(MJCF_BLOCKS), random)).format(
            body=_pick(list(bodies), random),
            joint=_pick(list(joints), random),
            other=_pick(list(joints), random),
        )
        block = etree.fromstring(text)
        if block.tag == "default" and root.find("default") is not None:
            root.find("default").extend(list(block))
        else:
            root.append(block)
        return f"added: {text}"
    names = sorted(name for name in element.attrib if name in NAMES or name == "type")
    if not names:
        return ""
    name = str(_pick(list(names), random))
    values = sorted({str(other.get(name)) for other in root.iter(etree.Element) if other.get(name)})
    element.set(name, str(_pick(list(values), random)))
    return f"another: {tag}/{name}={element.get(name)}"
