"""Mutation test: one thing is changed in one of two agreeing files, and must be named as cause.

What a URDF cannot state is put into an MJCF by `test_mjcf_only`.

Each kind of change is made at randomly chosen places. It counts as found if the comparison says
that the models differ, names the changed number first, and explains the whole deviation.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from xml.etree import ElementTree

import pytest

import pupper_analysis as pa
from pupper_analysis.robot.compare.compare import FilesCompared, compare_files
from pupper_analysis.robot.compare.differences import Difference
from pupper_analysis.tools.crosscheck.crosscheck import Comparison, compare_models
from tests.support import robots

Element = ElementTree.Element
PLACES = 3  # randomly chosen places per kind and pair


@dataclass
class Files:
    """A pair of files as trees, and the random choices of a mutation."""

    urdf: Element
    mjcf: Element
    choose: random.Random

    def moving_joint(self) -> Element:
        return self.choose.choice([j for j in self.urdf.iter("joint") if j.get("type") != "fixed"])

    def heavy_link(self) -> Element:
        """Return a link with mass that moves by a joint of its own, or the base."""
        fixed = {
            child.get("link")
            for joint in self.urdf.iter("joint")
            if joint.get("type") == "fixed"
            for child in joint.iter("child")
        }
        links = [link for link in self.urdf.iter("link") if link.find("inertial") is not None]
        return self.choose.choice([link for link in links if link.get("name") not in fixed])

    def mover(self, link: Element) -> str:
        """Return the joint that moves a link; the base by its own name."""
        name = link.get("name")
        for joint in self.urdf.iter("joint"):
            if joint.find("child").get("link") == name:
                return joint.get("name")
        return name

    def mjcf_joints(self) -> list[Element]:
        joints = [j for body in self.mjcf.iter("body") for j in body.findall("joint")]
        return [joint for joint in joints if joint.get("type") != "free"]

    def mjcf_joint(self) -> Element:
        return self.choose.choice(self.mjcf_joints())

    def mjcf_body(self) -> Element:
        """Return a body with a hinge."""
        bodies = list(self.mjcf.iter("body"))
        return self.choose.choice([body for body in bodies if body.get("name") != "base_link"])


Expected = tuple[set[str], set[str]]  # kinds, elements: of the first difference
Mutation = Callable[[Files], Expected | None]
Values = list[float]
Change = Callable[[Values, random.Random], Values | None]
"""Function that changes the numbers of an attribute; returns None if that would be no
difference.
"""


def numbers(element: Element, name: str, default: str = "0 0 0") -> Values:
    return [float(text) for text in element.get(name, default).split()]


def write(element: Element, name: str, values: Values) -> None:
    element.set(name, " ".join(repr(value) for value in values))


def link(files: Files) -> tuple[Element, str]:
    found = files.heavy_link()
    return found, files.mover(found)


def joint(files: Files) -> tuple[Element, str]:
    found = files.moving_joint()
    return found, found.get("name")


def hinge(files: Files) -> tuple[Element, str]:
    found = files.mjcf_joint()
    return found, found.get("name")


def body(files: Files) -> tuple[Element, str]:
    found = files.mjcf_body()
    return found, found.find("joint").get("name")


def option(files: Files) -> tuple[Element, str]:
    found = files.mjcf.find("option")
    return ElementTree.SubElement(files.mjcf, "option") if found is None else found, "option"


Pick = Callable[[Files], tuple[Element, str]]


def mutate_numbers(pick: Pick, path: str, attribute: str, kind: str, change: Change) -> Mutation:
    """Return a mutation of the numbers of an attribute of an element or of one below it."""

    def apply(files: Files) -> Expected | None:
        owner, name = pick(files)
        element = owner.find(path) if path else owner
        default = "1 0 0 0" if attribute == "quat" else "0 0 0"
        values = change(numbers(element, attribute, default), files.choose)
        if values is None:
            return None
        write(element, attribute, values)
        return {kind}, {name}

    return apply


def state_attributes(pick: Pick, kinds: str, **attributes: str) -> Mutation:
    """Return a mutation that states attributes of an element."""

    def apply(files: Files) -> Expected:
        element, name = pick(files)
        for attribute, value in attributes.items():
            element.set(attribute, value)
        return set(kinds.split(", ")), {name}

    return apply


def times(factor: float) -> Change:
    return lambda values, _: [factor * value for value in values]


def shift_number(index: int, step: float, *, either: bool = True) -> Change:
    def apply(values: Values, choose: random.Random) -> Values:
        sign = choose.choice([-1, 1]) if either else 1
        return [value + sign * step * (at == index) for at, value in enumerate(values)]

    return apply


def in_degrees(values: Values, _: random.Random) -> Values | None:
    return [math.degrees(value) for value in values] if any(values) else None


def other_side(values: Values, _: random.Random) -> Values | None:
    """Negate the y of a hip, as if a leg was copied from the opposite side."""
    return [values[0], -values[1], values[2]] if abs(values[1]) >= 1e-3 else None


def turn_quaternion(values: Values, _: random.Random) -> Values:
    (w, x, y, z), c, s = values, math.cos(0.05), math.sin(0.05)  # 0.1 rad more about its own x
    return [w * c - x * s, w * s + x * c, y * c + z * s, z * c - y * s]


def other_order(values: Values, _: random.Random) -> Values | None:
    """(x, y, z, w) is written for (w, x, y, z)."""
    return [*values[1:], values[0]] if max(map(abs, values)) <= 0.99 else None


MUTATIONS: dict[str, Mutation] = {
    **{
        f"{name}_{axis}": mutate_numbers(
            pick, path, word, kind, shift_number(index, step, either=either)
        )
        for name, pick, path, word, kind, step, either in (
            ("com", link, "inertial/origin", "xyz", "com", 0.004, True),
            ("joint_origin", joint, "origin", "xyz", "position", 0.003, True),
            ("joint_rotation", joint, "origin", "rpy", "rotation", 0.05, False),
        )
        for index, axis in enumerate("xyz")
    },
    **{
        f"inertia_{entry}": mutate_numbers(link, "inertial/inertia", entry, "inertia", times(1.1))
        for entry in ("ixx", "iyy", "izz")
    },
    "mass": mutate_numbers(link, "inertial/mass", "value", "mass", times(1.05)),
    "grams_for_kilograms": mutate_numbers(link, "inertial/mass", "value", "mass", times(1000.0)),
    "mirrored_sign": mutate_numbers(joint, "origin", "xyz", "position", other_side),
    "axis_sign": mutate_numbers(joint, "axis", "xyz", "axis", times(-1.0)),
    "axis_direction": mutate_numbers(joint, "axis", "xyz", "axis", lambda v, _: [v[1], v[2], v[0]]),
    "lower_limit": mutate_numbers(
        joint, "limit", "lower", "lower limit", lambda v, _: [v[0] - 0.1]
    ),
    "upper_limit": mutate_numbers(
        joint, "limit", "upper", "upper limit", lambda v, _: [v[0] + 0.1]
    ),
    "effort": mutate_numbers(joint, "limit", "effort", "effort", times(1.2)),
    "limit_in_degrees": mutate_numbers(joint, "limit", "upper", "upper limit", in_degrees),
    "rotation_in_degrees": mutate_numbers(joint, "origin", "rpy", "rotation", in_degrees),
    "joint_damping": mutate_numbers(joint, "dynamics", "damping", "damping", lambda *_: [0.08]),
    "joint_friction": mutate_numbers(joint, "dynamics", "friction", "friction", lambda *_: [0.08]),
    "revolute_made_prismatic": state_attributes(joint, "type", type="prismatic"),
    "mjcf_body_position": mutate_numbers(
        body, "", "pos", "position", lambda v, _: [v[0] + 0.003, v[1] - 0.002, v[2] + 0.001]
    ),
    "mjcf_body_rotation": mutate_numbers(body, "", "quat", "rotation", turn_quaternion),
    "mjcf_quaternion_order": mutate_numbers(body, "", "quat", "rotation", other_order),
    "mjcf_range": state_attributes(hinge, "lower limit, upper limit", range="-0.2 0.3"),
    "mjcf_damping": state_attributes(hinge, "damping", damping="0.3"),
    "mjcf_friction_loss": state_attributes(hinge, "friction", frictionloss="0.3"),
    "mjcf_armature": state_attributes(hinge, "armature", armature="0.02"),
    "gravity_of_the_moon": state_attributes(option, "gravity", gravity="0 0 -1.62"),
}


def mutation(function: Mutation) -> Mutation:
    MUTATIONS[function.__name__] = function
    return function


def _product_of_inertia(entry: str) -> Mutation:
    def change(files: Files) -> Expected:
        owner, name = link(files)
        inertia = owner.find("inertial/inertia")
        least = min(float(inertia.get(moment)) for moment in ("ixx", "iyy", "izz"))
        inertia.set(entry, repr(float(inertia.get(entry)) + 0.1 * least))
        return {"inertia"}, {name}

    return change


MUTATIONS |= {f"inertia_{entry}": _product_of_inertia(entry) for entry in ("ixy", "ixz", "iyz")}


@mutation
def missing_base_mass(files: Files) -> Expected:
    link = next(link for link in files.urdf.iter("link") if link.get("name") == "base_link")
    link.remove(link.find("inertial"))
    return {"mass"}, {"base_link"}


@mutation
def inertial_turned(files: Files) -> Expected | None:
    found, name = link(files)
    inertia = found.find("inertial/inertia")
    moments = [float(inertia.get(moment)) for moment in ("ixx", "iyy", "izz")]
    if max(moments) < 1.2 * min(moments):
        return None  # a sphere may be turned
    write(found.find("inertial/origin"), "rpy", [0.4, 0.3, 0.2])
    return {"inertia"}, {name}


@mutation
def inertia_axes_swapped(files: Files) -> Expected | None:
    link = files.heavy_link()
    moments = link.find("inertial/inertia").attrib
    first, second = float(moments["ixx"]), float(moments["izz"])
    if abs(first - second) < 0.1 * first:
        return None
    moments["ixx"], moments["izz"] = moments["izz"], moments["ixx"]
    return {"inertia"}, {files.mover(link)}


@mutation
def swapped_legs(files: Files) -> Expected:
    hips = [j for j in files.urdf.iter("joint") if j.find("parent").get("link") == "base_link"]
    first, second = files.choose.sample([j for j in hips if j.get("type") != "fixed"], 2)
    a, b = first.find("origin"), second.find("origin")
    a.attrib["xyz"], b.attrib["xyz"] = b.get("xyz"), a.get("xyz")
    return {"position"}, {first.get("name"), second.get("name")}


def _read_mass(link: Element) -> float:
    mass = link.find("inertial/mass")
    return 0.0 if mass is None else float(mass.get("value"))


@mutation
def dropped_link(files: Files) -> Expected | None:
    """Remove a foot, or another link with mass on a fixed joint."""
    links = {link.get("name"): link for link in files.urdf.iter("link")}
    feet = [
        joint
        for joint in files.urdf.iter("joint")
        if joint.get("type") == "fixed" and _read_mass(links[joint.find("child").get("link")]) > 0
    ]
    if not feet:
        return None
    joint = files.choose.choice(feet)
    parent = links[joint.find("parent").get("link")]
    files.urdf.remove(links[joint.find("child").get("link")])
    files.urdf.remove(joint)
    return {"mass", "com"}, {files.mover(parent)}


@mutation
def limits_lost(files: Files) -> Expected:
    found, name = joint(files)
    found.set("type", "continuous")
    del found.find("limit").attrib["lower"], found.find("limit").attrib["upper"]
    return {"lower limit", "upper limit"}, {name}


@mutation
def foot_frame(files: Files) -> Expected:
    feet = [j for j in files.urdf.iter("joint") if "foot" in j.get("name")]
    joint = files.choose.choice(feet)
    x, y, z = numbers(joint.find("origin"), "xyz")
    write(joint.find("origin"), "xyz", [x, y, z + 0.002])
    # A foot with mass takes it along.
    links = {link.get("name"): link for link in files.urdf.iter("link")}
    foot = joint.find("child").get("link")
    parent = links[joint.find("parent").get("link")]
    if links[foot].find("inertial") is None:
        return {"frame"}, {foot}
    return {"frame", "com", "inertia"}, {foot, files.mover(parent)}


@mutation
def mjcf_mass(files: Files) -> Expected | None:
    found, name = body(files)
    inertial = found.findall("inertial")
    weighing = inertial or [geom for geom in found.findall("geom") if geom.get("mass")]
    if not weighing:
        return None
    weighing[0].set("mass", repr(0.9 * float(weighing[0].get("mass"))))
    return {"mass"}, {name}


@mutation
def mjcf_axis(files: Files) -> Expected:
    joint, name = hinge(files)
    axis = {"HAA": [-1.0, 0, 0], "HFE": [0, -1.0, 0], "KFE": [0, -1.0, 0]}
    write(joint, "axis", axis.get(str(joint.get("class")), [0, 0, -1.0]))
    return {"axis"}, {name}


@mutation
def mjcf_force_range(files: Files) -> Expected:
    motor = files.choose.choice(list(files.mjcf.find("actuator")))
    motor.set("forcerange", "-7 7")
    return {"effort"}, {motor.get("joint")}


@mutation
def mjcf_degrees(files: Files) -> Expected | None:
    """Set the angle unit of the MJCF to degrees, which shrinks all ranges."""
    if not any(
        joint.get("range") for body in files.mjcf.iter("body") for joint in body.iter("joint")
    ):
        return None  # ranges in default classes are converted as well, but so are none here
    files.mjcf.find("compiler").set("angle", "degree")
    names = {j.get("name") for j in files.mjcf.iter("joint")}
    return {"lower limit", "upper limit"}, {str(name) for name in names}


@mutation
def mjcf_mesh_that_weighs(files: Files) -> Expected | None:
    """Add a shape of 50 g to a body whose inertia comes from its shapes."""
    bodies = [
        body
        for body in files.mjcf.iter("body")
        if body.find("inertial") is None and body.get("name") != "base_link"
    ]
    if not bodies:
        return None
    body = files.choose.choice(bodies)
    ElementTree.SubElement(
        body, "geom", type="box", size="0.02 0.02 0.02", contype="0", conaffinity="0", mass="0.05"
    )
    return {"mass"}, {body.find("joint").get("name")}


@mutation
def mjcf_inertia_from_geoms(files: Files) -> Expected | None:
    """Let the compiler ignore the ``inertial`` elements and use the shapes."""
    if next(files.mjcf.iter("inertial"), None) is None:
        return None
    files.mjcf.find("compiler").set("inertiafromgeom", "true")
    names = {str(joint.get("name")) for joint in files.mjcf.iter("joint")} | {"base_link"}
    return {"mass", "com", "inertia"}, names


def text_of(root: Element) -> str:
    return ElementTree.tostring(root, encoding="unicode")


def compare_texts(folder: Path, urdf: str, mjcf: str, **options: int) -> Comparison:
    return compare_models(*robots.write(folder, urdf, mjcf), **options)


@cache
def sources(name: str) -> tuple[str, str]:
    """Return URDF and MJCF of an agreeing pair, without meshes and keyframes."""
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        urdf, mjcf = pa.pupper.write_variant(name, folder)
        root = ElementTree.parse(mjcf).getroot()
        for parent in root.iter():
            for child in list(parent):
                if child.get("mesh") or child.tag == "mesh":
                    parent.remove(child)
        for key in root.findall("keyframe"):
            root.remove(key)
        return urdf.read_text(), text_of(root)


def mutate(
    name: str, kind: str, seed: int, folder: Path, *, cross_check: bool
) -> tuple[FilesCompared, Expected] | None:
    """Return the comparison of a pair with a change, and the expected first difference.

    None if no place suits the change. The engines are compared as well if ``cross_check``: this
    takes a third of the time, and neither adds nor removes a difference of the files.
    """
    urdf, mjcf = sources(name)
    # The URDF as bytes: its declaration names the encoding.
    choose = random.Random(f"{name} {kind} {seed}")
    files = Files(ElementTree.fromstring(urdf.encode()), ElementTree.fromstring(mjcf), choose)
    expected = None
    for _ in range(20):  # some places do not suit
        expected = MUTATIONS[kind](files)
        if expected is not None:
            break
    if expected is None:
        return None
    texts = text_of(files.urdf), text_of(files.mjcf)
    if cross_check:
        return compare_texts(folder, *texts, configurations=3), expected
    return compare_files(*robots.write(folder, *texts)).result, expected


def is_named_first(comparison: FilesCompared, expected: Expected) -> bool:
    first: Difference | None = next(iter(comparison.differences), None)
    return first is not None and first.kind in expected[0] and first.element in expected[1]


def test_the_unchanged_pairs_agree(tmp_path: Path) -> None:
    """Control of the mutation test: without a change there is nothing to find."""
    for name in ("v3", "original"):
        comparison = compare_texts(tmp_path, *sources(name))
        assert comparison.agree
        assert comparison.complete


@pytest.mark.slow
@pytest.mark.parametrize("kind", MUTATIONS)
def test_a_change_is_found_named_first_and_explained(kind: str, tmp_path: Path) -> None:
    """Three robots, three random places each: the files disagree, the changed number is the first
    difference, with its line in both files, and the explanation is complete. The first place is
    compared by all engines.
    """
    tried = 0
    for name in ("v3", "v3-long-leg", "original"):
        for seed in range(PLACES):
            outcome = mutate(name, kind, seed, tmp_path, cross_check=not tried)
            if outcome is None:
                continue
            tried += 1
            comparison, expected = outcome
            messages = [difference.message for difference in comparison.differences[:4]]
            assert not comparison.agree, (name, expected)
            assert is_named_first(comparison, expected), (name, expected, messages)
            assert comparison.complete, (name, expected, comparison.residual)
            first = comparison.differences[0]
            assert first.urdf_place is not None
            assert first.mjcf_place is not None
    assert tried >= PLACES, f"{kind} was tried at {tried} places"


def test_renamed_joint_is_matched_by_structure(tmp_path: Path) -> None:
    urdf, mjcf = sources("v3")
    comparison = compare_texts(tmp_path, urdf.replace('"leg_back_l_2"', '"left_hind_roll"'), mjcf)
    assert comparison.guessed == {"left_hind_roll": "leg_back_l_2"}
    assert comparison.agree


def test_joint_that_is_fixed_in_one_file_is_reported(tmp_path: Path) -> None:
    """With the knee fixed in both, all else agrees; the verdict does not."""
    urdf, mjcf = sources("original")
    root = ElementTree.fromstring(urdf.encode())
    joint = next(joint for joint in root.iter("joint") if joint.get("name") == "RL_KFE")
    joint.set("type", "fixed")
    comparison = compare_texts(tmp_path, text_of(root), mjcf)
    assert not comparison.agree
    assert comparison.only_mjcf == ("RL_KFE",)
    assert not comparison.differences  # with the knee fixed in both, they agree
    assert comparison.complete


def test_exchanged_limbs_are_no_half_turn_of_the_base(tmp_path: Path) -> None:
    """v3's hips are symmetric: a half turn about x brings them into place as well, but not the
    base's CoM [m] and inertia. With the names exchanged all differences are gone.
    """
    urdf, mjcf = sources("v3")
    for end in ("front", "back"):
        for joint in (1, 2, 3):
            left, right = (f'"leg_{end}_{side}_{joint}"' for side in "lr")
            urdf = urdf.replace(left, "@").replace(right, left).replace("@", right)
    comparison = compare_texts(tmp_path, urdf, mjcf, configurations=2)
    assert "base frame" not in {difference.kind for difference in comparison.differences}
    (cause,) = comparison.causes
    assert (cause.kind, len(cause.differences)) == ("exchanged", len(comparison.differences))
    assert "leg_back_l_1 and leg_back_r_1, leg_front_l_1 and leg_front_r_1" in cause.message
