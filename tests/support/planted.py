"""One oddity, planted in an MJCF whose robot stands or is held: what does it is known.

Each is an edit of the file's tree, with the codes of which one must be told first of what it does,
if it does anything.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from lxml import etree

from tests.support import arm, random_legged, slips

ROOT = Path(__file__).parents[2]

Element = etree._Element
Plant = Callable[[Element], None]

Codes = tuple[str, ...]


def flattened(path: Path) -> Element:
    """Reads an MJCF with what it includes, and with its meshes found from anywhere."""
    root = etree.parse(str(path)).getroot()
    for include in list(root.iter("include")):
        parent, at = include.getparent(), include.getparent().index(include)
        other = flattened(path.parent / include.get("file"))
        parent[at : at + 1] = list(other)
    first, *others = root.findall("worldbody") or [None]
    for other in others:
        first.extend(list(other))
        root.remove(other)
    for compiler in root.iter("compiler"):
        if compiler.get("meshdir"):
            compiler.set("meshdir", str((path.parent / compiler.get("meshdir")).resolve()))
    return root


def quad(folder: Path) -> tuple[Path, Element]:
    """Returns the URDF and the MJCF of ``slips.standing``."""
    pair = slips.standing(folder)
    return pair.urdf, flattened(pair.mjcf)


def pupper(folder: Path) -> tuple[Path, Element]:
    """Returns those of Pupper v3, whose servos state their gains, from where it stands."""
    del folder
    root = flattened(ROOT / "mjcf" / "pupper_v3.xml")
    for of in root.iter("default"):
        for one in of.findall("general"):
            of.remove(one)
    for servo in section(root, "actuator"):
        servo.tag = "position"
        servo.attrib.update({"kp": "5", "kv": "0.1", "forcerange": "-3 3"})
    for key in root.iter("key"):
        key.set("qpos", key.get("qpos").replace("0 0 0.28", "0 0 0.135", 1))
    return ROOT / "urdf" / "pupper_v3.urdf", root


def ring(folder: Path) -> tuple[Path, Element]:
    """Returns those of a random robot of six legs, on a floor and from a keyframe."""
    drawn = replace(random_legged.ring(11, motors="position"), keyframe=True)
    pair = random_legged.written(drawn, folder)
    root = flattened(pair.mjcf)
    for key in root.iter("key"):
        key.set("ctrl", " ".join(key.get("qpos").split()[7:]))
    root.find("worldbody").insert(0, etree.Element("geom", type="plane", size="0 0 1"))
    return pair.urdf, root


def held(folder: Path) -> tuple[Path, Element]:
    """Returns those of an arm."""
    files = folder / "arm.urdf", folder / "arm.xml"
    for file, text in zip(files, (arm.URDF, arm.MJCF), strict=True):
        file.write_text(text, encoding="utf-8")
    return files[0], flattened(files[1])


ROBOTS = {"quad": quad, "pupper": pupper, "ring": ring, "arm": held}


def servos(root: Element) -> list[Element]:
    """Returns the servos, in the order of the file."""
    found = [one for part in root.iter("actuator") for one in part]
    return [one for one in found if one.tag == "position"]


def moving(root: Element) -> list[Element]:
    """Returns the hinges and slides, in the order of the file."""
    return [
        joint
        for body in root.iter("body")
        for joint in body.findall("joint")
        if joint.get("type") != "free"
    ]


def base(root: Element) -> Element:
    """Returns the body that stands in the world, and moves."""
    return next(iter(root.find("worldbody").iter("body")))


def section(root: Element, tag: str) -> Element:
    """Returns a section of a file, a new one if there is none."""
    found = root.find(tag)
    return etree.SubElement(root, tag) if found is None else found


def stated(root: Element, tag: str, **words: str) -> Element:
    """Adds an element to a section."""
    return etree.SubElement(section(root, tag.split("/")[0]), tag.split("/")[1], words)


def option(**words: str) -> Plant:
    def plant(root: Element) -> None:
        for name, value in words.items():
            section(root, "option").set(name, value)

    return plant


def each_servo(**words: str) -> Plant:
    def plant(root: Element) -> None:
        for servo in servos(root):
            for name, value in words.items():
                servo.set(name, value)

    return plant


def each_joint(**words: str) -> Plant:
    def plant(root: Element) -> None:
        for joint in moving(root):
            for name, value in words.items():
                joint.set(name, value)

    return plant


def _gains(root: Element, servo: Element) -> tuple[float, float]:
    """Returns kp and kv of a servo, its own or its class's."""
    del root
    return float(servo.get("kp")), float(servo.get("kv", "0"))


def general(bias: float = 0.0, gain: float = 1.0, kind: str = "fixed", one: bool = False) -> Plant:
    """Writes servos as general actuators, with something beside.

    Args:
        bias: Added to the force, as if the target were moved by so much (rad, m).
        gain: Of the command / the stiffness.
        kind: Of the gain; an affine one has a share of the velocity.
        one: Whether of one servo alone.
    """

    def plant(root: Element) -> None:
        for servo in servos(root)[2 : 3 if one else None] if one else servos(root):
            kp, kv = _gains(root, servo)
            servo.tag = "general"
            for word in ("kp", "kv"):
                servo.attrib.pop(word, None)
            extra = f" {0.5 * kp:g} 0" if kind == "affine" else ""
            servo.set("gaintype", kind)
            servo.set("gainprm", f"{gain * kp:g}{extra}")
            servo.set("biastype", "affine")
            servo.set("biasprm", f"{bias * kp:g} {-kp:g} {-kv:g}")

    return plant


def _foot(root: Element) -> Element:
    """Returns the body at the end of the first limb that has a shape which touches."""
    body = base(root).find("body")
    while body.find("body") is not None:
        body = body.find("body")
    return body


def _floor(root: Element) -> Element:
    return next(geom for geom in root.find("worldbody").iter("geom") if geom.get("type") == "plane")


def _floor_of(**words: str) -> Plant:
    return lambda root: _floor(root).attrib.update(words)


def _feet_of(**words: str) -> Plant:
    """States words of each shape at the end of a limb."""

    def plant(root: Element) -> None:
        for body in root.iter("body"):
            if body.find("body") is None:
                for geom in body.findall("geom"):
                    geom.attrib.update(words)

    return plant


def _name_of(root: Element, body: Element) -> str:
    del root
    if body.get("name") is None:
        body.set("name", "planted")
    return str(body.get("name"))


def _weld(root: Element) -> None:
    stated(root, "equality/weld", name="hung", body1=_name_of(root, base(root)))


def _weld_foot(root: Element) -> None:
    stated(root, "equality/weld", name="glued", body1=_name_of(root, _foot(root)))


def _connect(root: Element) -> None:
    stated(root, "equality/connect", name="hung", body1=_name_of(root, base(root)), anchor="0 0 0")


def _exclude(root: Element) -> None:
    stated(root, "contact/exclude", body1="world", body2=_name_of(root, _foot(root)))


def _override(root: Element) -> None:
    option(o_solref="0.1 1")(root)
    etree.SubElement(section(root, "option"), "flag", {"override": "enable"})


def _block(*, mocap: bool) -> Plant:
    """Puts a box of 3 cm where it lifts what stands on the left in front."""

    def plant(root: Element) -> None:
        world = root.find("worldbody")
        here = {"name": "block", "pos": "0.6 0.6 0"}
        body = etree.SubElement(world, "body", here | ({"mocap": "true"} if mocap else {}))
        words = {"type": "box", "size": "0.6 0.6 0.015", "contype": "1", "conaffinity": "1"}
        etree.SubElement(body, "geom", words)

    return plant


def _one_is(tag: str, **words: str) -> Plant:
    def plant(root: Element) -> None:
        servo = servos(root)[2]
        servo.tag = tag
        for word in ("kp", "kv", "forcerange"):
            servo.attrib.pop(word, None)
        servo.attrib.update(words)

    return plant


def _negative_gear(*, one: bool) -> Plant:
    def plant(root: Element) -> None:
        for servo in servos(root)[2:3] if one else servos(root):
            servo.set("gear", "-1")

    return plant


def _gravcomp(root: Element) -> None:
    base(root).set("gravcomp", "1")


def _range_cuts(root: Element) -> None:
    """The third joint cannot be as bent as it is in the keyframe."""
    joint = moving(root)[2]
    low, high = (float(word) for word in (joint.get("range") or "-3 3").split())
    here = float(root.find("keyframe/key").get("qpos").split()[9])
    joint.set(
        "range", f"{low} {here - 0.3:g}" if here - low > high - here else f"{here + 0.3:g} {high}"
    )
    joint.set("limited", "true")


def _loose(root: Element) -> None:
    """A tail on a hinge that neither the other file nor an actuator knows."""
    words = {"name": "tail", "pos": "-0.05 0 0.05"}
    body = etree.SubElement(base(root), "body", words)
    etree.SubElement(
        body, "joint", {"name": "wag", "axis": "0 1 0", "type": "hinge", "range": "-3 3"}
    )
    inertial = {
        "pos": "-0.2 0 0",
        "mass": f"{0.05 * _mass(root):g}",
        "diaginertia": "1e-3 1e-3 1e-3",
    }
    etree.SubElement(body, "inertial", inertial)
    for key in root.iter("key"):
        key.set("qpos", key.get("qpos") + " 0")


def _mass(root: Element) -> float:
    return sum(float(one.get("mass")) for one in base(root).iter("inertial"))


def _heavier(root: Element) -> None:
    inertial = base(root).find("inertial")
    inertial.set("mass", f"{1.3 * float(inertial.get('mass')):g}")


def _thruster(root: Element) -> None:
    etree.SubElement(base(root), "site", {"name": "nozzle"})
    pull = f"{0.2 * 9.81 * _mass(root):g}"
    words = {"name": "jet", "site": "nozzle", "gear": "0 0 1 0 0 0", "biastype": "affine"}
    words |= {"gainprm": "0", "biasprm": f"{pull} 0 0"}
    stated(root, "actuator/general", **words)
    for key in root.iter("key"):
        if key.get("ctrl"):
            key.set("ctrl", key.get("ctrl") + " 0")


def _tendon_spring(root: Element) -> None:
    first, second = (joint.get("name") for joint in moving(root)[1:3])
    spring = {"name": "cord", "stiffness": f"{0.3 * _gains(root, servos(root)[1])[0]:g}"}
    fixed = stated(root, "tendon/fixed", springlength="1", **spring)
    for joint in (first, second):
        etree.SubElement(fixed, "joint", {"joint": joint, "coef": "1"})


def _spring(root: Element) -> None:
    joint = moving(root)[2]
    joint.set("stiffness", f"{0.5 * _gains(root, servos(root)[2])[0]:g}")
    joint.set("springref", "1")


def _pull(stiffness: str, way: float) -> Plant:
    """Springs turn all rolls to one side, by half of a servo's stiffness (N m) at first.

    Args:
        stiffness: MJCF's, of parts of a servo's stiffness: "c1 c2 c3" pulls by c1 x + c2 x^2 + ...
        way: By which they are drawn (rad).
    """

    def plant(root: Element) -> None:
        for joint, servo in list(zip(moving(root), servos(root), strict=True))[::3]:
            kp = _gains(root, servo)[0]
            parts = " ".join(f"{kp * float(part):g}" for part in stiffness.split())
            joint.attrib.update({"stiffness": parts, "springref": f"{way:g}"})

    return plant


def _cord(root: Element) -> None:
    """A tendon that stiffens as it is drawn does the same."""
    kp = _gains(root, servos(root)[0])[0]
    words = {"name": "cord", "springlength": "10", "stiffness": f"0 0 {5e-4 * kp:g}"}
    cord = stated(root, "tendon/fixed", **words)
    for joint in moving(root)[::3]:
        etree.SubElement(cord, "joint", {"joint": joint.get("name"), "coef": "1"})


def _disabled(root: Element) -> None:
    servos(root)[2].set("group", "3")
    option(actuatorgroupdisable="3")(root)


def _sign(root: Element) -> None:
    servo = servos(root)[2]
    servo.set("kp", f"{-float(servo.get('kp')):g}")


def _tilted(root: Element) -> None:
    _floor(root).set("quat", f"{math.cos(0.05)} 0 {math.sin(0.05)} 0")


def _mute_foot(root: Element) -> None:
    for geom in _foot(root).findall("geom"):
        geom.attrib.update({"contype": "0", "conaffinity": "0"})


def _command_elsewhere(root: Element) -> None:
    for key in root.iter("key"):
        message = key.get("ctrl").split()
        message[2] = f"{float(message[2]) + 0.6:g}"
        key.set("ctrl", " ".join(message))


def _pair_friction(root: Element) -> None:
    """Feet are slippery along one axis."""
    floor = _floor(root)
    floor.set("name", floor.get("name", "ground"))
    leaves = [body for body in root.iter("body") if body.find("body") is None]
    for number, geom in enumerate(geom for body in leaves for geom in body.findall("geom")):
        geom.set("name", geom.get("name", f"planted{number}"))
        ends = {"geom1": str(floor.get("name")), "geom2": str(geom.get("name"))}
        stated(root, "contact/pair", friction="0.01 0.8 0.005 1e-4 1e-4", **ends)


def _clamped(share: float, where: str) -> Plant:
    """Limits what servos give to a share of their weight on a lever of 0.1 m."""

    def plant(root: Element) -> None:
        most = share * 0.1 * 9.81 * _mass(root) / 4
        for one in servos(root) if where == "forcerange" else moving(root):
            one.set(where, f"{-most:g} {most:g}")
            one.set("forcelimited" if where == "forcerange" else "actuatorfrclimited", "true")

    return plant


def _commands(root: Element) -> None:
    """The third servos cannot be told where the keyframe has them."""
    here = float(root.find("keyframe/key").get("qpos").split()[9])
    for servo in servos(root)[2::3]:
        low, high = sorted((here - 0.3 * (1 if here > 0 else -1), here - (2 if here > 0 else -2)))
        servo.set("ctrlrange", f"{low:g} {high:g}")
        servo.set("ctrllimited", "true")


_UNEVEN = ("gain-is-no-stiffness", "own-run")

PLANTS: dict[str, tuple[Plant, Codes]] = {
    "a bias beside all servos": (general(bias=0.07), ("servos-are-biased",)),
    "a bias beside one servo": (general(bias=0.1, one=True), ("servos-are-biased",)),
    "a gain 1.2 times the stiffness": (general(gain=1.2), ("gain-is-no-stiffness",)),
    "a gain of one, 1.4 times": (general(gain=1.4, one=True), _UNEVEN),
    "affine gains": (
        general(kind="affine"),
        ("gain-is-not-fixed", "own-run", "servos-for-actuators"),
    ),
    "a tendon's spring": (_tendon_spring, ("springs-pull",)),
    "a joint's spring": (_spring, ("springs-pull",)),
    "springs": (_pull("0.02", 25.0), ("springs-pull",)),
    "springs that stiffen": (_pull("0 0 5e-4", 10.0), ("springs-pull",)),
    "a tendon that stiffens": (_cord, ("springs-pull",)),
    "a mocap obstacle": (_block(mocap=True), ("obstacles-touch",)),
    "an obstacle": (_block(mocap=False), ("obstacles-touch",)),
    "a delay": (each_servo(delay="0.1", nsample="101"), ("servos-are-late",)),
    "a step of 10 ms": (option(timestep="0.01"), ("timestep-too-long",)),
    "a step of 20 ms": (option(timestep="0.02"), ("timestep-too-long",)),
    "PGS, 3 iterations": (option(solver="PGS", iterations="3"), ("solver-too-rough",)),
    "CG, 1 iteration": (option(solver="CG", iterations="1"), ("solver-too-rough",)),
    "forcerange": (_clamped(0.2, "forcerange"), ("forcerange-cuts-off", "motors-overloaded")),
    "actuatorfrcrange": (
        _clamped(0.2, "actuatorfrcrange"),
        ("actuatorfrcrange-cuts-off", "motors-overloaded"),
    ),
    "ctrlrange": (_commands, ("ctrlrange-cuts-off",)),
    "a weld of the base": (_weld, ("weld-holds-it",)),
    "a weld of a foot": (_weld_foot, ("weld-holds-it",)),
    "a connection": (_connect, ("connect-holds-it",)),
    "a foot is excluded": (_exclude, ("excluded-from-touching",)),
    "contacts are overridden": (_override, ("contacts-overridden",)),
    "a tilted floor": (_tilted, ("ground-not-level-as-published",)),
    "one velocity servo": (_one_is("velocity", kv="1"), ("own-run", "servos-for-actuators")),
    "one motor": (_one_is("motor"), ("own-run",)),
    "a gear of -1": (_negative_gear(one=True), ("gear-is-negative", "own-run")),
    "gears of -1": (_negative_gear(one=False), ("gear-is-negative", "own-run")),
    "a stiffness below zero": (_sign, ("own-servos-fail", "own-run")),
    "a group is disabled": (_disabled, ("actuators-disabled",)),
    "a base without weight": (_gravcomp, ("files-differ",)),
    "a range that cuts the pose": (_range_cuts, ("range-stops",)),
    "a margin of contacts": (_feet_of(margin="0.02"), ("files-differ",)),
    "condim 1": (_floor_of(condim="1", priority="9"), ("feet-without-friction",)),
    "friction of 0.01": (_floor_of(friction="0.01 0.005 0.0001", priority="9"), ("contacts-slip",)),
    "soft contacts": (_floor_of(solref="0.3 1", priority="9"), ("contacts-give-way",)),
    "a loose tail": (_loose, ("loose-joints-move", "files-differ", "own-run")),
    "a heavier base": (_heavier, ("files-differ",)),
    "a thruster": (_thruster, ("motors-elsewhere-push",)),
    "a filter of 20 s": (each_servo(timeconst="20"), ("timeconst-too-long",)),
    "a fluid": (option(density="1000", viscosity="1"), ("fluid-drags",)),
    "wind": (option(density="1.2", wind="30 0 0"), ("fluid-drags",)),
    "damping below zero": (
        each_joint(damping="-0.5"),
        ("joints-damped-negatively", "rests-on-made-up"),
    ),
    "gravity aside": (option(gravity="4 0 -9"), ("gravity-aside", "files-differ")),
    "a foot that does not touch": (_mute_foot, ("limb-without-foot",)),
    "a command elsewhere": (_command_elsewhere, ("own-run",)),
    "a pair's friction": (_pair_friction, ("pair-friction-uneven", "contacts-slip")),
}
"""{what: (how it is planted, what may be told of it)}; ``own-run`` where its joint's drive is."""

HELD = (
    *("a bias beside all servos", "a bias beside one servo", "a gain 1.2 times the stiffness"),
    *("a gain of one, 1.4 times", "affine gains", "a step of 20 ms", "one velocity servo"),
    *("one motor", "a stiffness below zero", "a group is disabled", "a filter of 20 s", "a delay"),
)
"""Those that can be planted in an arm."""


def planted(folder: Path, robot: str, plant: str | None) -> tuple[Path, Path]:
    """Returns the URDF and the MJCF of a robot in which something is planted, or nothing."""
    urdf, root = ROBOTS[robot](folder)
    root = copy.deepcopy(root)
    if plant is not None:
        PLANTS[plant][0](root)
    mjcf = folder / "planted.xml"
    mjcf.write_bytes(etree.tostring(root, pretty_print=True))
    return urdf, mjcf
