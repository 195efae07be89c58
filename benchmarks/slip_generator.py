"""Draws one plausible slip, in an MJCF or a URDF: a sign, a power of ten, a unit, a swapped pair.

The file is a tree; the same tree and the same random numbers make the same slip.
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
"""Attributes of words, or without any effect."""

LOOKS = {"visual", "asset", "statistic", "camera", "light", "material", "texture", "color", "size"}
"""Elements that are looked at alone."""


def one(change: Callable[[float], float]) -> Change:
    """Changes one of several numbers."""

    def changed(values: list[float], random: np.random.Generator) -> list[float]:
        at = int(random.integers(len(values)))
        return [change(v) if i == at else v for i, v in enumerate(values)]

    return changed


def each(change: Callable[[float], float]) -> Change:
    return lambda values, _: [change(value) for value in values]


def _swapped(values: list[float], random: np.random.Generator) -> list[float]:
    if len(values) < 2:
        return values
    first, second = (int(i) for i in random.choice(len(values), 2, replace=False))
    values[first], values[second] = values[second], values[first]
    return values


def _rolled(values: list[float], _: np.random.Generator) -> list[float]:
    """The last first, or the other way round: x y z w for w x y z."""
    return [*values[1:], values[0]]


def _without_digit(value: float) -> float:
    text = f"{value:.9g}"
    try:
        return float(text[:-1])
    except ValueError:  # it has one alone
        return value / 10


CHANGES: dict[str, Change] = {
    "sign of one": one(lambda v: -v),
    "sign of all": each(lambda v: -v),
    "ten times": one(lambda v: 10 * v),
    "a tenth": one(lambda v: v / 10),
    "a hundred times": each(lambda v: 100 * v),
    "a thousand times": each(lambda v: 1000 * v),
    "a thousandth": each(lambda v: v / 1000),
    "a millionth": each(lambda v: v / 1e6),
    "degrees": each(math.degrees),
    "radians": each(math.radians),
    "inches": each(lambda v: v / 0.0254),
    "zero": one(lambda _: 0.0),
    "one": one(lambda _: 1.0),
    "swapped": _swapped,
    "rolled": _rolled,
    "reversed": lambda values, _: values[::-1],
    "twice": each(lambda v: 2 * v),
    "half": each(lambda v: v / 2),
    "inverse": each(lambda v: 1 / v if v else v),
    "one is missing": lambda values, _: values[:-1] or values,
    "one too many": lambda values, _: [*values, values[-1]],
    "a digit is lost": one(_without_digit),
}

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
"""Attributes that somebody adds, or puts another value into, by element."""

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


def draw_slip(root: Element, random: np.random.Generator) -> Slip:
    """Makes one slip in a tree, of any of the kinds.

    Returns:
        What it is; "" if the kind that was drawn has nothing to change there.
    """
    kinds = [_number, _number, _number, _number, _added, _exchanged, _structural]
    return kinds[int(random.integers(len(kinds)))](root, random)


def _pick(items: list[object], random: np.random.Generator) -> object:
    return items[int(random.integers(len(items)))]


def _physical(root: Element) -> list[Element]:
    return [
        element
        for element in root.iter(etree.Element)
        if element.tag not in LOOKS and not any(a.tag in LOOKS for a in element.iterancestors())
    ]


def _numbers(text: str) -> list[float] | None:
    try:
        return [float(word) for word in text.split()] or None
    except ValueError:
        return None


def _stated(root: Element) -> dict[tuple[str, str], list[tuple[Element, list[float]]]]:
    """Returns all numbers of a file, by element and attribute."""
    found: dict[tuple[str, str], list[tuple[Element, list[float]]]] = {}
    for element in _physical(root):
        for name, text in element.attrib.items():
            values = None if name in NAMES else _numbers(text)
            if values is not None:
                found.setdefault((str(element.tag), name), []).append((element, values))
    return found


def _number(root: Element, random: np.random.Generator) -> Slip:
    """Another number in the place of one that is there; once, or wherever it is stated."""
    stated = _stated(root)
    tag, attribute = sorted(stated)[int(random.integers(len(stated)))]
    places = stated[tag, attribute]
    name = list(CHANGES)[int(random.integers(len(CHANGES)))]
    everywhere = bool(random.integers(3) == 0)
    at = int(random.integers(len(places)))
    for element, values in places if everywhere else [places[at]]:
        new = CHANGES[name](list(values), random)
        element.set(attribute, " ".join(f"{value:.9g}" for value in new))
    return f"{name}: {tag}/{attribute} ({'all' if everywhere else at})"


def _added(root: Element, random: np.random.Generator) -> Slip:
    """An attribute that is added, or has another value, once or in all elements of a kind."""
    present: dict[str, list[Element]] = {}
    for element in _physical(root):
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


def _exchanged(root: Element, random: np.random.Generator) -> Slip:
    """Two elements of a kind have each other's value of an attribute."""
    pairs = {}
    for element in _physical(root):
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


def _structural(root: Element, random: np.random.Generator) -> Slip:
    """An element or an attribute is lost, there twice, elsewhere, or a block is added."""
    elements = [element for element in _physical(root) if element.getparent() is not None]
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
