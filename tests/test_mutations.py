"""Mutation test: one thing is changed in one of two agreeing files, and must be named as cause.

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
from pupper_analysis.comparison import Comparison, compare_models
from pupper_analysis.explain import Difference

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
        """A link with mass that moves by a joint of its own, or the base."""
        fixed = {
            child.get("link")
            for joint in self.urdf.iter("joint")
            if joint.get("type") == "fixed"
            for child in joint.iter("child")
        }
        links = [link for link in self.urdf.iter("link") if link.find("inertial") is not None]
        return self.choose.choice([link for link in links if link.get("name") not in fixed])

    def mover(self, link: Element) -> str:
        """The joint that moves a link; the base by its own name."""
        name = link.get("name")
        for joint in self.urdf.iter("joint"):
            if joint.find("child").get("link") == name:
                return joint.get("name")
        return name

    def mjcf_joint(self) -> Element:
        joints = [j for body in self.mjcf.iter("body") for j in body.findall("joint")]
        return self.choose.choice([joint for joint in joints if joint.get("type") != "free"])

    def mjcf_body(self) -> Element:
        """A body with a hinge."""
        bodies = list(self.mjcf.iter("body"))
        return self.choose.choice([body for body in bodies if body.get("name") != "base_link"])


Expected = tuple[set[str], set[str]]  # kinds, elements: of the first difference
Mutation = Callable[[Files], Expected | None]
MUTATIONS: dict[str, Mutation] = {}


def mutation(function: Mutation) -> Mutation:
    MUTATIONS[function.__name__] = function
    return function


def numbers(element: Element, name: str, default: str = "0 0 0") -> list[float]:
    return [float(text) for text in element.get(name, default).split()]


def write(element: Element, name: str, values: list[float]) -> None:
    element.set(name, " ".join(repr(value) for value in values))


# ------------------------------------------------------------------------------------- inertials


def _inertia_entry(entry: str) -> Mutation:
    def change(files: Files) -> Expected:
        link = files.heavy_link()
        inertia = link.find("inertial/inertia")
        if entry in ("ixx", "iyy", "izz"):
            inertia.set(entry, repr(1.1 * float(inertia.get(entry))))
        else:
            least = min(float(inertia.get(name)) for name in ("ixx", "iyy", "izz"))
            inertia.set(entry, repr(float(inertia.get(entry)) + 0.1 * least))
        return {"inertia"}, {files.mover(link)}

    return change


for _entry in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz"):
    MUTATIONS[f"inertia_{_entry}"] = _inertia_entry(_entry)


def _com(axis: int) -> Mutation:
    def change(files: Files) -> Expected:
        link = files.heavy_link()
        origin = link.find("inertial/origin")
        xyz = numbers(origin, "xyz")
        xyz[axis] += files.choose.choice([-1, 1]) * 0.004
        write(origin, "xyz", xyz)
        return {"com"}, {files.mover(link)}

    return change


def _joint_origin(axis: int) -> Mutation:
    def change(files: Files) -> Expected:
        joint = files.moving_joint()
        origin = joint.find("origin")
        xyz = numbers(origin, "xyz")
        xyz[axis] += files.choose.choice([-1, 1]) * 0.003
        write(origin, "xyz", xyz)
        return {"position"}, {joint.get("name")}

    return change


def _joint_turn(axis: int) -> Mutation:
    def change(files: Files) -> Expected:
        joint = files.moving_joint()
        origin = joint.find("origin")
        rpy = numbers(origin, "rpy")
        rpy[axis] += 0.05
        write(origin, "rpy", rpy)
        return {"rotation"}, {joint.get("name")}

    return change


for _index, _axis in enumerate("xyz"):
    MUTATIONS[f"com_{_axis}"] = _com(_index)
    MUTATIONS[f"joint_origin_{_axis}"] = _joint_origin(_index)
    MUTATIONS[f"joint_rotation_{_axis}"] = _joint_turn(_index)


@mutation
def mass(files: Files) -> Expected:
    link = files.heavy_link()
    value = link.find("inertial/mass")
    value.set("value", repr(1.05 * float(value.get("value"))))
    return {"mass"}, {files.mover(link)}


@mutation
def grams_for_kilograms(files: Files) -> Expected:
    link = files.heavy_link()
    value = link.find("inertial/mass")
    value.set("value", repr(1000 * float(value.get("value"))))
    return {"mass"}, {files.mover(link)}


@mutation
def missing_base_mass(files: Files) -> Expected:
    link = next(link for link in files.urdf.iter("link") if link.get("name") == "base_link")
    link.remove(link.find("inertial"))
    return {"mass"}, {"base_link"}


@mutation
def inertial_turned(files: Files) -> Expected | None:
    link = files.heavy_link()
    inertia = link.find("inertial/inertia")
    moments = [float(inertia.get(name)) for name in ("ixx", "iyy", "izz")]
    if max(moments) < 1.2 * min(moments):
        return None  # a sphere may be turned
    origin = link.find("inertial/origin")
    write(origin, "rpy", [0.4, 0.3, 0.2])
    return {"inertia"}, {files.mover(link)}


@mutation
def inertia_axes_swapped(files: Files) -> Expected | None:
    link = files.heavy_link()
    inertia = link.find("inertial/inertia")
    one, two = inertia.get("ixx"), inertia.get("izz")
    if abs(float(one) - float(two)) < 0.1 * float(one):
        return None
    inertia.set("ixx", two)
    inertia.set("izz", one)
    return {"inertia"}, {files.mover(link)}


@mutation
def mirrored_sign(files: Files) -> Expected | None:
    """The y of a hip has the other sign, as when a leg is copied from the other side."""
    joint = files.moving_joint()
    origin = joint.find("origin")
    xyz = numbers(origin, "xyz")
    if abs(xyz[1]) < 1e-3:
        return None
    xyz[1] *= -1
    write(origin, "xyz", xyz)
    return {"position"}, {joint.get("name")}


@mutation
def swapped_legs(files: Files) -> Expected:
    hips = [j for j in files.urdf.iter("joint") if j.find("parent").get("link") == "base_link"]
    one, two = files.choose.sample([j for j in hips if j.get("type") != "fixed"], 2)
    for tag in ("xyz",):
        a, b = one.find("origin").get(tag), two.find("origin").get(tag)
        one.find("origin").set(tag, b)
        two.find("origin").set(tag, a)
    return {"position"}, {one.get("name"), two.get("name")}


@mutation
def dropped_link(files: Files) -> Expected | None:
    """A foot, or another link on a fixed joint, is missing with its mass."""
    links = {link.get("name"): link for link in files.urdf.iter("link")}
    feet = [
        joint
        for joint in files.urdf.iter("joint")
        if joint.get("type") == "fixed"
        and links[joint.find("child").get("link")].find("inertial") is not None
    ]
    if not feet:
        return None
    joint = files.choose.choice(feet)
    parent = links[joint.find("parent").get("link")]
    files.urdf.remove(links[joint.find("child").get("link")])
    files.urdf.remove(joint)
    return {"mass", "com"}, {files.mover(parent)}


# ------------------------------------------------------------------------------------- joints


@mutation
def axis_sign(files: Files) -> Expected:
    joint = files.moving_joint()
    write(joint.find("axis"), "xyz", [-value for value in numbers(joint.find("axis"), "xyz")])
    return {"axis"}, {joint.get("name")}


@mutation
def axis_direction(files: Files) -> Expected:
    joint = files.moving_joint()
    x, y, z = numbers(joint.find("axis"), "xyz")
    write(joint.find("axis"), "xyz", [y, z, x])
    return {"axis"}, {joint.get("name")}


def _limit(name: str, kind: str, change: Callable[[float], float]) -> Mutation:
    def apply(files: Files) -> Expected:
        joint = files.moving_joint()
        limit = joint.find("limit")
        limit.set(name, repr(change(float(limit.get(name)))))
        return {kind}, {joint.get("name")}

    return apply


MUTATIONS["lower_limit"] = _limit("lower", "lower limit", lambda value: value - 0.1)
MUTATIONS["upper_limit"] = _limit("upper", "upper limit", lambda value: value + 0.1)
MUTATIONS["effort"] = _limit("effort", "effort", lambda value: 1.2 * value)
MUTATIONS["limit_in_degrees"] = _limit("upper", "upper limit", lambda value: math.degrees(value))


@mutation
def rotation_in_degrees(files: Files) -> Expected | None:
    joint = files.moving_joint()
    origin = joint.find("origin")
    rpy = numbers(origin, "rpy")
    if not any(rpy):
        return None
    write(origin, "rpy", [math.degrees(value) for value in rpy])
    return {"rotation"}, {joint.get("name")}


@mutation
def joint_damping(files: Files) -> Expected:
    joint = files.moving_joint()
    joint.find("dynamics").set("damping", "0.08")
    return {"damping"}, {joint.get("name")}


@mutation
def joint_friction(files: Files) -> Expected:
    joint = files.moving_joint()
    joint.find("dynamics").set("friction", "0.08")
    return {"friction"}, {joint.get("name")}


@mutation
def limits_lost(files: Files) -> Expected:
    joint = files.moving_joint()
    joint.set("type", "continuous")
    del joint.find("limit").attrib["lower"], joint.find("limit").attrib["upper"]
    return {"lower limit", "upper limit"}, {joint.get("name")}


@mutation
def revolute_made_prismatic(files: Files) -> Expected:
    joint = files.moving_joint()
    joint.set("type", "prismatic")
    return {"type"}, {joint.get("name")}


@mutation
def foot_frame(files: Files) -> Expected:
    feet = [j for j in files.urdf.iter("joint") if "foot" in j.get("name")]
    joint = files.choose.choice(feet)
    origin = joint.find("origin")
    xyz = numbers(origin, "xyz")
    xyz[2] += 0.002
    write(origin, "xyz", xyz)
    # A foot with mass takes it along.
    links = {link.get("name"): link for link in files.urdf.iter("link")}
    foot = joint.find("child").get("link")
    parent = links[joint.find("parent").get("link")]
    if links[foot].find("inertial") is None:
        return {"frame"}, {foot}
    return {"frame", "com", "inertia"}, {foot, files.mover(parent)}


# ------------------------------------------------------------------------------------- the MJCF


@mutation
def mjcf_mass(files: Files) -> Expected | None:
    body = files.mjcf_body()
    inertial = body.find("inertial")
    if inertial is not None:
        inertial.set("mass", repr(0.9 * float(inertial.get("mass"))))
        return {"mass"}, {body.find("joint").get("name")}
    geom = next((geom for geom in body.findall("geom") if geom.get("mass")), None)
    if geom is None:
        return None
    geom.set("mass", repr(0.9 * float(geom.get("mass"))))
    return {"mass"}, {body.find("joint").get("name")}


@mutation
def mjcf_body_position(files: Files) -> Expected:
    body = files.mjcf_body()
    x, y, z = numbers(body, "pos")
    write(body, "pos", [x + 0.003, y - 0.002, z + 0.001])
    return {"position"}, {body.find("joint").get("name")}


@mutation
def mjcf_body_rotation(files: Files) -> Expected:
    body = files.mjcf_body()
    w, x, y, z = numbers(body, "quat", "1 0 0 0")
    c, s = math.cos(0.05), math.sin(0.05)  # 0.1 rad more about its own x
    write(body, "quat", [w * c - x * s, w * s + x * c, y * c + z * s, z * c - y * s])
    return {"rotation"}, {body.find("joint").get("name")}


@mutation
def mjcf_quaternion_order(files: Files) -> Expected | None:
    """(x, y, z, w) is written for (w, x, y, z)."""
    body = files.mjcf_body()
    w, x, y, z = numbers(body, "quat", "1 0 0 0")
    if body.get("quat") is None or max(abs(w), abs(x), abs(y), abs(z)) > 0.99:
        return None
    write(body, "quat", [x, y, z, w])
    return {"rotation"}, {body.find("joint").get("name")}


@mutation
def mjcf_axis(files: Files) -> Expected:
    joint = files.mjcf_joint()
    kind = joint.get("class")
    axis = {"HAA": [-1.0, 0, 0], "HFE": [0, -1.0, 0], "KFE": [0, -1.0, 0]}
    write(joint, "axis", axis.get(str(kind), [0, 0, -1.0]))
    return {"axis"}, {joint.get("name")}


@mutation
def mjcf_range(files: Files) -> Expected:
    joint = files.mjcf_joint()
    joint.set("range", "-0.2 0.3")
    return {"lower limit", "upper limit"}, {joint.get("name")}


@mutation
def mjcf_force_range(files: Files) -> Expected:
    motor = files.choose.choice(list(files.mjcf.find("actuator")))
    motor.set("forcerange", "-7 7")
    return {"effort"}, {motor.get("joint")}


@mutation
def mjcf_damping(files: Files) -> Expected:
    joint = files.mjcf_joint()
    joint.set("damping", "0.3")
    return {"damping"}, {joint.get("name")}


@mutation
def mjcf_friction_loss(files: Files) -> Expected:
    joint = files.mjcf_joint()
    joint.set("frictionloss", "0.3")
    return {"friction"}, {joint.get("name")}


@mutation
def mjcf_armature(files: Files) -> Expected:
    joint = files.mjcf_joint()
    joint.set("armature", "0.02")
    return {"armature"}, {joint.get("name")}


@mutation
def mjcf_degrees(files: Files) -> Expected | None:
    """The file is read in degrees: all its ranges shrink."""
    if not any(
        joint.get("range") for body in files.mjcf.iter("body") for joint in body.iter("joint")
    ):
        return None  # ranges in default classes are converted as well, but so are none here
    files.mjcf.find("compiler").set("angle", "degree")
    names = {j.get("name") for j in files.mjcf.iter("joint")}
    return {"lower limit", "upper limit"}, {str(name) for name in names}


@mutation
def mjcf_mesh_that_weighs(files: Files) -> Expected | None:
    """A drawn shape is given mass: its body gets heavier where inertias come from shapes."""
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
    """The compiler ignores the inertials, and takes the shapes' instead."""
    if next(files.mjcf.iter("inertial"), None) is None:
        return None
    files.mjcf.find("compiler").set("inertiafromgeom", "true")
    names = {str(joint.get("name")) for joint in files.mjcf.iter("joint")} | {"base_link"}
    return {"mass", "com", "inertia"}, names


@mutation
def mjcf_free_joint_with_damping(files: Files) -> Expected:
    """A default class that is meant for the hinges reaches <joint type="free">."""
    base = next(body for body in files.mjcf.iter("body") if body.get("name") == "base_link")
    base.find("joint").set("damping", "0.5")
    return {"damping"}, {"base_link"}


# ------------------------------------------------------------------------------------- the test


@cache
def sources(name: str) -> tuple[str, str]:
    """The texts of an agreeing pair; the MJCF in one file, with paths to its meshes taken out."""
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        urdf, mjcf = pa.write_variant(name, folder)
        root = ElementTree.parse(mjcf).getroot()
        for parent in root.iter():
            for child in list(parent):
                if child.get("mesh") or child.tag == "mesh":
                    parent.remove(child)
        for key in root.findall("keyframe"):
            root.remove(key)
        return urdf.read_text(), ElementTree.tostring(root, encoding="unicode")


def mutate(name: str, kind: str, seed: int, folder: Path) -> tuple[Comparison, Expected] | None:
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
    paths = folder / "robot.urdf", folder / "robot.xml"
    for path, root in zip(paths, (files.urdf, files.mjcf), strict=True):
        path.write_text(ElementTree.tostring(root, encoding="unicode"))
    return compare_models(*paths, configurations=3), expected


def is_named_first(comparison: Comparison, expected: Expected) -> bool:
    first: Difference | None = next(iter(comparison.differences), None)
    return first is not None and first.kind in expected[0] and first.element in expected[1]


def test_the_unchanged_pairs_agree(tmp_path: Path) -> None:
    for name in ("v3", "original"):
        urdf, mjcf = sources(name)
        (tmp_path / "robot.urdf").write_text(urdf)
        (tmp_path / "robot.xml").write_text(mjcf)
        comparison = compare_models(tmp_path / "robot.urdf", tmp_path / "robot.xml")
        assert comparison.agree
        assert comparison.complete


@pytest.mark.parametrize("kind", MUTATIONS)
def test_a_change_is_found_named_first_and_explained(kind: str, tmp_path: Path) -> None:
    tried = 0
    for name in ("v3", "v3-long-leg", "original"):
        for seed in range(PLACES):
            outcome = mutate(name, kind, seed, tmp_path)
            if outcome is None:
                continue
            tried += 1
            comparison, expected = outcome
            messages = [difference.message for difference in comparison.differences[:4]]
            assert not comparison.agree, (name, expected)
            assert is_named_first(comparison, expected), (name, expected, messages)
            assert comparison.complete, (name, expected, comparison.left)
            first = comparison.differences[0]
            assert first.urdf_place is not None
            assert first.mjcf_place is not None
    assert tried >= PLACES, f"{kind} was tried at {tried} places"


def test_there_are_many_kinds() -> None:
    assert len(MUTATIONS) >= 25


def test_a_renamed_joint_is_matched_by_structure_and_said_so(tmp_path: Path) -> None:
    urdf, mjcf = sources("v3")
    (tmp_path / "robot.urdf").write_text(urdf.replace('"leg_back_l_2"', '"left_hind_roll"'))
    (tmp_path / "robot.xml").write_text(mjcf)
    comparison = compare_models(tmp_path / "robot.urdf", tmp_path / "robot.xml")
    assert comparison.guessed == {"left_hind_roll": "leg_back_l_2"}
    assert comparison.agree


def test_a_joint_that_is_fixed_in_one_file_is_named(tmp_path: Path) -> None:
    urdf, mjcf = sources("original")
    root = ElementTree.fromstring(urdf.encode())
    joint = next(joint for joint in root.iter("joint") if joint.get("name") == "RL_KFE")
    joint.set("type", "fixed")
    (tmp_path / "robot.urdf").write_text(ElementTree.tostring(root, encoding="unicode"))
    (tmp_path / "robot.xml").write_text(mjcf)
    comparison = compare_models(tmp_path / "robot.urdf", tmp_path / "robot.xml")
    assert not comparison.agree
    assert comparison.only_mjcf == ("RL_KFE",)
    assert not comparison.differences  # with the knee fixed in both, they agree
    assert comparison.complete


def main() -> None:
    """Prints the score: ``python tests/test_mutations.py``."""
    import tempfile

    total = found = 0
    for kind in MUTATIONS:
        outcomes = []
        for name in ("v3", "v3-long-leg", "original"):
            for seed in range(PLACES):
                with tempfile.TemporaryDirectory() as folder:
                    outcome = mutate(name, kind, seed, Path(folder))
                if outcome is not None:
                    comparison, expected = outcome
                    named = is_named_first(comparison, expected)
                    outcomes.append(not comparison.agree and named and comparison.complete)
        total, found = total + len(outcomes), found + sum(outcomes)
        print(f"{kind:32s} {sum(outcomes)} of {len(outcomes)}")
    print(f"{len(MUTATIONS)} kinds: {found} of {total} found, named first and explained in full")


if __name__ == "__main__":
    main()
