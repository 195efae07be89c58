"""Matching of joints and links of two files with different names and structure, or refusal."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from pupper_analysis.base.errors import ModelError, UnknownNameError
from pupper_analysis.models.mjcf_file import read_mjcf
from pupper_analysis.models.urdf_file import read_urdf
from pupper_analysis.robot.matching.match import match_models
from pupper_analysis.robot.matching.trees import kinematic_trees
from pupper_analysis.tools.crosscheck.crosscheck import Comparison
from tests.support.corpus import INERTIAL, format_link
from tests.support.robots import (
    FEET,
    Frame,
    Part,
    Parts,
    arm,
    change_part,
    compare_files,
    list_differences,
    match_files,
    mjcf_text,
    pendulum,
    quadruped,
    urdf_text,
    without_base,
    write,
    write_parts,
)
from tests.support.tiny import TINY_MJCF, TINY_URDF

URDF, MJCF = urdf_text(quadruped()), mjcf_text(quadruped())
JOINTS = {f"{kind}{leg}" for kind in ("hip", "knee") for leg in range(4)}


def compare_texts(folder: Path, urdf: str, mjcf: str, **options: Any) -> Comparison:
    return compare_files(write(folder, urdf, mjcf), **options)


def make_light_part(name: str, parent: str, **values: Any) -> Part:
    part = Part(name, parent, f"to_{name}", position=(-0.3, 0.0, 0.02), mass=0.1)
    return replace(part, inertia=(1e-4, 1e-4, 1e-4, 0, 0, 0), **values)


def twins_at_one_place() -> Parts:
    return {
        side: make_light_part(side, "base", position=(0.3, y, 0.0))
        for side, y in (("left", 0.005), ("right", -0.005))
    }


def with_root(kind: str, origin: str = "", urdf: str = URDF) -> str:
    joint = f'<joint name="anchor" type="{kind}">{origin}<parent link="world"/>'
    head = f'<link name="world"/>\n{joint}<child link="base"/></joint>'
    return urdf.replace('<robot name="machine">', f'<robot name="machine">\n{head}')


# ------------------------------------------------------------------------------------- the root


@pytest.mark.parametrize("kind", ["fixed", "floating"])
def test_massless_root_link_is_left_out_with_a_note(tmp_path: Path, kind: str) -> None:
    comparison = compare_texts(tmp_path, with_root(kind), MJCF)
    assert comparison.agree
    assert "robot.urdf: root link 'world' has no mass and is ignored" in map(str, comparison.notes)


def test_a_root_link_with_mass_is_part_of_the_robot(tmp_path: Path) -> None:
    """Its mass is folded into the base, and so is a difference."""
    heavy = INERTIAL.replace('="1"', '="1e-3"').replace('value="1e-3"', 'value="0.5"')
    text = with_root("fixed").replace('<link name="world"/>', format_link("world", heavy))
    comparison = compare_texts(tmp_path, text, MJCF)
    assert list_differences(comparison)[0] == ("mass", "world")
    assert comparison.differences[0].urdf == pytest.approx(6.5)


# ------------------------------------------------------------------------------------- refused


@pytest.mark.parametrize("kind", ["floating", "planar"])
def test_floating_or_planar_joint_of_the_urdf_is_fixed_at_rest_with_a_note(
    tmp_path: Path, kind: str
) -> None:
    """All else is compared; the files do not agree."""
    text = URDF.replace('<joint name="hip1" type="revolute">', f'<joint name="hip1" type="{kind}">')
    comparison = compare_texts(tmp_path, text, MJCF)
    assert comparison.only_urdf == comparison.only_mjcf == ("hip1",)
    assert list_differences(comparison) == []  # all else is compared, with the leg at rest
    assert not comparison.agree
    (note,) = [note for note in comparison.notes if "hip1" in str(note)]
    assert str(note).startswith(f"joint 'hip1' of the URDF is {kind} and was fixed at rest;")


def test_robots_without_a_common_joint_are_refused(tmp_path: Path) -> None:
    """Names and structure differ: no guess, but a hint at mappings."""
    other = {name: replace(part, joint=f"x{part.joint}") for name, part in arm().items()}
    with pytest.raises(ModelError, match=r"no joint in common .*pair the joints with --map"):
        compare_files(write_parts(tmp_path, quadruped(), other))


# ------------------------------------------------------------------------------------- the scene

BALL = '<body name="ball" pos="2 0 0"><freejoint/><geom size="0.1"/></body>'
DOOR = '<body name="door"><joint name="hinge" axis="0 0 1"/><geom size="1"/></body>'


def test_loose_objects_and_a_floor_are_no_part_of_the_robot(tmp_path: Path) -> None:
    """A ball and a door, to which sensors, exclusions and a keyframe refer: the files agree, with a
    note per object.
    """
    scene = f'<geom type="plane" size="1 1 1"/>{BALL}{DOOR}'
    references = (
        '<sensor><framepos objtype="body" objname="ball"/></sensor>'
        '<contact><exclude body1="ball" body2="base"/></contact>'
        '<keyframe><key name="home" qpos="' + "0 " * 23 + '"/></keyframe>'
    )
    mjcf = mjcf_text(quadruped(), scene=scene, extra=references)
    comparison = compare_texts(tmp_path, URDF, mjcf)
    assert comparison.agree
    reported = " ".join(map(str, comparison.notes))
    assert all(f"body '{body}' is not part of the robot" in reported for body in ("ball", "door"))


# ------------------------------------------------------------------------------------- left over


@pytest.mark.parametrize("where", ["urdf", "mjcf"])
def test_joint_of_one_file_alone_is_fixed_at_zero_and_reported(tmp_path: Path, where: str) -> None:
    """The other file has the tail on a fixed joint: no difference is left, but the verdict is not
    AGREE.
    """
    tail = {"tail": make_light_part("tail", "base")}
    still = {"tail": replace(tail["tail"], kind="fixed")}
    urdf = quadruped() | (tail if where == "urdf" else still)
    mjcf = quadruped() | (tail if where == "mjcf" else still)
    comparison = compare_files(write_parts(tmp_path, urdf, mjcf))
    assert (comparison.only_urdf, comparison.only_mjcf) == (
        (("to_tail",), ()) if where == "urdf" else ((), ("to_tail",))
    )
    assert list_differences(comparison) == []  # what moves in both is alike
    assert not comparison.agree  # but the joints are not


@pytest.mark.slow
@pytest.mark.parametrize(
    "extra",
    [
        '<equality><joint joint1="to_tail" joint2="hip0"/></equality>',
        '<sensor><jointpos joint="to_tail"/><actuatorfrc actuator="m_to_tail"/></sensor>',
        '<tendon><fixed><joint joint="to_tail" coef="1"/></fixed></tendon>',
        '<tendon><fixed name="t"><joint joint="to_tail" coef="1"/><joint joint="hip0" coef="1"/>'
        '</fixed></tendon><actuator><motor tendon="t"/></actuator>',
        f'<keyframe><key name="home" qpos="{"0 " * 16}"/></keyframe>',
        "",
    ],
)
def test_references_to_a_joint_of_the_mjcf_alone_are_removed_with_the_joint(
    tmp_path: Path, extra: str
) -> None:
    """Equalities, sensors, tendons, motors and keyframes that refer to the removed tail; the part
    is reported with its mass [kg].
    """
    mjcf = mjcf_text(quadruped() | {"tail": make_light_part("tail", "base")}, extra=extra)
    comparison = compare_texts(tmp_path, URDF, mjcf)
    assert comparison.only_mjcf == ("to_tail",)
    (part,) = comparison.parts
    assert "has the part body tail on the base (0.1 kg), with" in str(part)
    assert list_differences(comparison) == []  # with it taken off
    assert not comparison.agree
    assert comparison.complete


# ------------------------------------------------------------------------------------- by structure


def rename_joints(urdf: Parts, **names: str) -> Parts:
    return {
        name: replace(part, joint=names.get(part.joint, part.joint)) for name, part in urdf.items()
    }


def rename_links(parts: Parts) -> Parts:
    """Return the parts with other link names, by which no link can be matched."""
    names = {name: f"body{chr(97 + number)}" for number, name in enumerate(parts)}
    return {
        names[name]: replace(part, link=names[name], parent=names.get(part.parent, ""))
        for name, part in parts.items()
    }


def test_joints_are_matched_by_structure_if_all_names_differ(tmp_path: Path) -> None:
    """Reference: the mapping by which the joints were renamed."""
    names = {name: f"joint_{number}" for number, name in enumerate(sorted(JOINTS, reverse=True))}
    files = write_parts(tmp_path, rename_joints(quadruped(), **names), rename_links(quadruped()))
    comparison = compare_files(files)
    assert comparison.guessed == {new: old for old, new in names.items()}
    assert comparison.agree
    assert set(comparison.joints) == JOINTS


def test_ambiguous_partial_match_without_common_names_is_left_open(tmp_path: Path) -> None:
    """As Cassie's two models: turned by half a turn about z, its legs match as well, exchanged."""

    def walker(x: float, words: tuple[str, ...], last: tuple[float, float, float]) -> Parts:
        parts = {"base": quadruped()["base"]}
        axes = [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), last]
        for side, y in (("near", 0.13), ("far", -0.13)):
            places, parent = [(x, y, 0.0), (0.0, 0.0, -0.3), (0.0, 0.0, -0.4)], "base"
            for word, place, axis in zip(words, places, axes, strict=True):
                joint = word.replace("*", side)
                parts[f"{joint} link"] = replace(
                    make_light_part(f"{joint} link", parent, position=place, axis=axis), joint=joint
                )
                parent = f"{joint} link"
        return parts

    one = walker(-0.05, ("abduction_*", "flexion_*", "end_*"), (0.0, 1.0, 0.0))
    two = walker(0.01, ("*-roll", "*-pitch", "*-tip"), (0.0, 0.0, 1.0))
    with pytest.raises(ModelError, match="--map abduction_near=near-roll"):
        compare_files(write(tmp_path, urdf_text(one, []), mjcf_text(two, [])))


def test_joints_far_apart_are_not_matched(tmp_path: Path) -> None:
    """Two unmatched joints, half of the robot's length apart."""
    urdf = quadruped() | {"tail": make_light_part("tail", "base", position=(-0.3, 0.0, 0.0))}
    mjcf = quadruped() | {"neck": make_light_part("neck", "base", position=(0.3, 0.0, 0.0))}
    comparison = compare_files(write_parts(tmp_path, urdf, mjcf))
    assert comparison.guessed == {}
    assert (comparison.only_urdf, comparison.only_mjcf) == (("to_tail",), ("to_neck",))


def test_joints_are_matched_without_common_prefix_and_suffix(tmp_path: Path) -> None:
    """Two joints at one position are matched as well, so structure alone is not sufficient."""
    urdf = {
        name: replace(part, joint=f"rh_{part.joint}_joint" if part.joint else "")
        for name, part in quadruped().items()
    }
    # Twins at the same place: the structure does not distinguish the twins.
    twins = twins_at_one_place()
    named = rename_joints(twins, to_left="rh_to_left_joint", to_right="rh_to_right_joint")
    comparison = compare_files(write_parts(tmp_path, urdf | named, quadruped() | twins))
    assert comparison.agree
    assert comparison.guessed == {
        f"rh_{name}_joint": name for name in (*JOINTS, "to_left", "to_right")
    }


def test_ambiguous_match_prints_mapping_lines_to_paste(tmp_path: Path) -> None:
    """Two joints, 2 mm above and below the place of two others: no guess, one line with --map per
    joint.
    """
    twins = twins_at_one_place()
    middle = {
        "left": replace(twins["left"], position=(0.3, 0.0, 0.002)),
        "right": replace(twins["right"], position=(0.3, 0.0, -0.002)),
    }
    urdf = quadruped() | rename_joints(twins, to_left="one", to_right="two")
    comparison = compare_files(write_parts(tmp_path, urdf, rename_links(quadruped() | middle)))
    reported = [str(note) for note in comparison.notes if "may be" in str(note)]
    assert comparison.guessed == {}
    assert (comparison.only_urdf, comparison.only_mjcf) == (("one", "two"), ("to_left", "to_right"))
    assert "select one: --map one=to_left or --map one=to_right" in reported[0]
    assert len(reported) == 2


def test_a_match_that_drops_most_joints_is_refused(tmp_path: Path) -> None:
    """One name in common is no robot in common."""
    urdf = {
        name: replace(part, joint=part.joint if part.joint in ("", "hip0") else f"x{part.joint}")
        for name, part in quadruped().items()
    }
    mjcf = {
        name: replace(part, axis=(0.0, 0.0, 1.0)) if name != "thigh0" and part.parent else part
        for name, part in quadruped().items()
    }
    with pytest.raises(ModelError, match="only 1 of 8 joints match a joint") as raised:
        compare_files(write_parts(tmp_path, urdf, rename_links(mjcf)))
    assert "..." not in str(raised.value)  # the printed words can be pasted
    assert "without likely match: xknee0, xhip1" in str(raised.value)


@pytest.mark.parametrize("where", ["URDF", "MJCF"])
def test_gripper_of_one_file_alone_is_reported_as_a_part(tmp_path: Path, where: str) -> None:
    """A hand with two fingers is fixed to the rod in one file."""
    hand = make_light_part("hand", "rod", kind="fixed", position=(0.2, 0.0, 0.0))
    fingers = {
        f"finger{n}": make_light_part(
            f"finger{n}", "hand", kind="prismatic", position=(0.02, y, 0.0)
        )
        for n, y in enumerate((0.03, -0.03))
    }
    full, bare = arm() | {"hand": replace(hand, mass=0.5)} | fingers, arm()
    urdf, mjcf = (full, bare) if where == "URDF" else (bare, full)
    comparison = compare_files(write_parts(tmp_path, urdf, mjcf, free=False))
    (part,) = comparison.parts
    assert f"only the {where} has the part " in str(part)
    assert "hand on push (0.7 kg), with joints to_finger0, to_finger1" in str(part)
    assert list_differences(comparison) == []
    assert not comparison.agree


# ------------------------------------------------------------------------------------- mappings


def test_mapping_takes_precedence_over_equal_names(tmp_path: Path) -> None:
    """The files have swapped the names of two legs."""
    swapped = rename_joints(quadruped(), hip0="hip1", knee0="knee1", hip1="hip0", knee1="knee0")
    files = write_parts(tmp_path, swapped, quadruped())
    assert not compare_files(files).agree
    names = {"hip0": "hip1", "hip1": "hip0", "knee0": "knee1", "knee1": "knee0"}
    assert compare_files(files, names=names).agree


@pytest.mark.parametrize(
    ("one", "other", "file"),
    [("hop", "hip0", "urdf"), ("hip0", "hop", "xml"), ("hip0", "foot0", "xml")],
)
def test_unknown_name_in_a_mapping_is_refused_with_the_valid_names(
    tmp_path: Path, one: str, other: str, file: str
) -> None:
    """A name of a frame in place of a joint is refused as well."""
    wrong = other if file == "xml" else one
    with pytest.raises(
        UnknownNameError, match=rf"robot.{file}: no joint .*'{wrong}'; there are: hip0"
    ):
        compare_texts(tmp_path, URDF, MJCF, names={one: other})


# ------------------------------------------------------------------------------------- fused


def test_base_mass_is_no_cause_if_the_base_is_fused_with_the_world(tmp_path: Path) -> None:
    """MuJoCo's conversion of a URDF fuses a base without free joint.

    All legs are matched; the files do not agree, because only the URDF has the mass of the base.
    """
    fused = without_base(mjcf_text(quadruped(), [], free=False))
    comparison = compare_texts(tmp_path, URDF, fused)
    assert comparison.differences == ()
    assert not comparison.agree
    assert set(comparison.joints) == JOINTS
    note = next(str(note) for note in comparison.notes if "fused with the world" in str(note))
    assert "6 kg, 'base'" in note
    # A difference in the legs is still found; the base is not compared.
    heavier = fused.replace('mass="0.2"', 'mass="0.3"')
    assert list_differences(compare_texts(tmp_path, URDF, heavier)) == [("mass", "knee0")]
    # Other things in the scene are not: they have no name of the URDF's.
    other = '<body name="door"><joint name="hinge"/><geom size="0.1"/></body></worldbody>'
    comparison = compare_texts(tmp_path, URDF, fused.replace("</worldbody>", other))
    assert comparison.differences == ()
    assert "'door' is not part of the robot" in " ".join(map(str, comparison.notes))


def test_mjcf_base_in_the_frame_of_the_massless_root_link_agrees(tmp_path: Path) -> None:
    """The URDF's base is 0.1 m above its root link; the MJCF's base body has the root's frame."""
    lift = np.array([0.0, 0.0, 0.1])
    lifted = {
        name: replace(
            part,
            position=tuple(part.position + lift) if part.parent == "base" else part.position,
            com=tuple(part.com + lift) if name == "base" else part.com,
        )
        for name, part in quadruped().items()
    }
    text = with_root("fixed", '<origin xyz="0 0 0.1"/>')
    mjcf = mjcf_text(lifted).replace('<body name="base"', '<body name="world_"')
    assert list_differences(compare_texts(tmp_path, text, mjcf)) == []


def test_two_unnamed_hinges_of_one_body_match_two_joints_of_the_urdf(tmp_path: Path) -> None:
    """A universal joint: two hinges in one body, and a massless link between them in the URDF."""
    fork = Part("fork", "base", "roll", position=(0.3, 0.0, 0.0), mass=0.0)
    wheel = replace(
        make_light_part("wheel", "fork", axis=(0.0, 1.0, 0.0)), position=(0.0, 0.0, 0.0)
    )
    urdf = urdf_text(quadruped() | {"fork": fork, "wheel": wheel})
    body = (
        '<body pos="0.3 0 0"><joint axis="1 0 0" range="-1 1" damping="0.1" armature="0.01" '
        'frictionloss="0.2"/><joint axis="0 1 0" range="-1 1" damping="0.1" armature="0.02" '
        'frictionloss="0.2"/><inertial pos="0 0 0" mass="0.1" diaginertia="1e-4 1e-4 1e-4"/></body>'
    )
    comparison = compare_texts(tmp_path, urdf, MJCF.replace("<freejoint/>", f"<freejoint/>{body}"))
    assert set(comparison.guessed) == {"roll", "to_wheel"}
    assert {kind for kind, _ in list_differences(comparison)} <= {"effort"}


def test_joints_match_that_are_mutually_nearest(tmp_path: Path) -> None:
    """A joint of the URDF alone is 30 mm from a renamed joint, and stays unmatched."""
    hip = quadruped()["thigh0"]
    near = tuple(np.array(hip.position) + np.array([0.03, 0.0, 0.0]))
    extra = make_light_part("aid", "base", quaternion=hip.quaternion, axis=hip.axis, position=near)
    urdf = {
        "base": quadruped()["base"],
        "aid": replace(extra, joint="a_first"),
        **{name: part for name, part in quadruped().items() if name != "base"},
    }
    mjcf = rename_joints(quadruped(), hip0="front_hip")
    comparison = compare_files(write_parts(tmp_path, urdf, mjcf))
    assert comparison.guessed == {"hip0": "front_hip"}
    assert comparison.only_urdf == ("a_first",)


def split_shank(parts: Parts) -> Parts:
    """Return the parts with the shank of leg 0 as two bodies on a fixed joint, of the same mass."""
    whole = parts["shank0"]
    com, half = np.array(whole.com), 0.5 * np.array(whole.inertia)
    shared = {"mass": whole.mass / 2, "inertia": tuple(half)}
    below = Part("toe0", "shank0", "toe", "fixed", position=(0.0, 0.0, -0.2), **shared)
    below = replace(below, com=tuple(com - (0.0, 0.0, -0.2)))
    return {**change_part(parts, "shank0", **shared), "toe0": below}


@pytest.mark.parametrize("where", ["urdf", "mjcf"])
def test_fixed_children_merged_in_one_file_agree(tmp_path: Path, where: str) -> None:
    urdf = split_shank(quadruped()) if where == "urdf" else quadruped()
    mjcf = split_shank(quadruped()) if where == "mjcf" else quadruped()
    comparison = compare_files(write_parts(tmp_path, urdf, mjcf))
    assert list_differences(comparison) == []
    assert comparison.agree


def test_joints_in_reverse_order_are_listed_in_the_order_of_the_actuators(tmp_path: Path) -> None:
    files = write_parts(tmp_path, quadruped(), quadruped(), backwards=True)
    comparison = compare_files(files)
    assert comparison.agree
    assert set(comparison.joints) == JOINTS
    assert comparison.joints[0] == "knee3"
    assert comparison.guessed == {}
    assert comparison.only_urdf == comparison.only_mjcf == ()
    match = match_files(files)
    assert match.urdf_joint == {name: name for name in JOINTS}
    assert match.urdf_link["knee2"] == match.mjcf_body["knee2"] == "shank2"
    assert match.urdf_link["base"] == match.mjcf_body["base"] == "base"


def test_bodies_without_names_are_matched(tmp_path: Path) -> None:
    """The base alone, and all bodies."""
    mjcf = MJCF
    for name in quadruped():
        mjcf = mjcf.replace(f'<body name="{name}"', "<body")
        if name == "base":
            assert compare_texts(tmp_path, URDF, mjcf).agree
    assert compare_texts(tmp_path, URDF, mjcf).agree


def test_missing_fixed_child_is_a_difference_of_its_mass(tmp_path: Path) -> None:
    """Reference: 1.05 kg of the thigh and 0.4 kg of the child."""
    pack = replace(make_light_part("pack", "thigh1"), kind="fixed", mass=0.4)
    comparison = compare_files(write_parts(tmp_path, quadruped() | {"pack": pack}, quadruped()))
    assert list_differences(comparison)[0] == ("mass", "hip1")
    assert comparison.differences[0].urdf == pytest.approx(1.05 + 0.4)
    assert comparison.complete


def test_ball_joint_of_the_mjcf_is_fixed_at_rest_with_a_note(tmp_path: Path) -> None:
    text = MJCF.replace('name="hip1" type="hinge"', 'name="hip1" type="ball" limited="false"')
    motor = next(line for line in text.splitlines() if 'joint="hip1"' in line)
    comparison = compare_texts(tmp_path, URDF, text.replace(motor, ""))
    assert comparison.only_urdf == comparison.only_mjcf == ("hip1",)
    assert list_differences(comparison) == []
    assert not comparison.agree
    assert any("ball" in str(note) and "hip1" in str(note) for note in comparison.notes)


def test_mjcf_without_joints_is_refused(tmp_path: Path) -> None:
    text = '<mujoco><worldbody><body><geom size="1"/></body></worldbody></mujoco>'
    with pytest.raises(ModelError, match="the robot has no joints"):
        compare_texts(tmp_path, URDF, text)


def test_values_of_included_default_classes_are_compared(tmp_path: Path) -> None:
    lines = MJCF.replace('damping="0.1" frictionloss="0.2"', 'class="joints"')
    included = tmp_path / "defaults.xml"
    included.write_text(
        '<mujocoinclude><default><default class="joints">'
        '<joint damping="0.1" frictionloss="0.2" limited="true"/></default></default>'
        "</mujocoinclude>"
    )
    text = lines.replace("<worldbody>", '<include file="defaults.xml"/><worldbody>', 1)
    assert compare_texts(tmp_path, URDF, text).agree
    included.write_text(included.read_text().replace("0.1", "0.3"))
    comparison = compare_texts(tmp_path, URDF, text)
    assert [kind for kind, _ in list_differences(comparison)] == ["damping"] * 8


def test_inertia_of_a_box_equals_the_closed_form_in_the_urdf(tmp_path: Path) -> None:
    """A box of 1000 kg/m^3 in place of an inertial: m (x^2 + y^2) / 12."""
    a, b, c = 0.1, 0.2, 0.04
    mass = 1000 * a * b * c
    moments = [mass / 12 * (x * x + y * y) for x, y in ((b, c), (a, c), (a, b))]
    inertial = {"mass": mass, "com": (0.1, 0, 0), "inertia": (*moments, 0, 0, 0)}
    text = mjcf_text(change_part(quadruped(), "base", mass=0.0))
    geom = f'<geom type="box" size="{a / 2} {b / 2} {c / 2}" pos="0.1 0 0"/>'
    text = text.replace("<freejoint/>", f"<freejoint/>{geom}")
    urdf = urdf_text(change_part(quadruped(), "base", **inertial))
    assert list_differences(compare_texts(tmp_path, urdf, text)) == []


def test_frames_are_matched_by_a_mapping_and_chosen_as_feet(tmp_path: Path) -> None:
    frames = [frame._replace(name=f"toe_{frame.name}") for frame in FEET]
    files = write(tmp_path, urdf_text(quadruped(), frames), MJCF)
    assert "foot positions" not in compare_files(files).deviations
    names = {f"toe_foot{leg}": f"foot{leg}" for leg in range(4)}
    comparison = compare_files(files, names=names)
    assert comparison.deviations["foot positions"] < 1e-12
    assert comparison.agree
    moved = [f._replace(position=(0, 0, -0.3)) if f.name == "foot1" else f for f in FEET]
    files = write(tmp_path, urdf_text(quadruped(), moved), MJCF)
    assert list_differences(compare_files(files)) == [("frame", "foot1")]
    assert compare_files(files, feet=["foot0", "foot2"]).agree
    with pytest.raises(UnknownNameError, match=r"'toe'.*foot0, foot1, foot2, foot3"):
        compare_files(files, feet=["toe"])


def test_common_frames_are_fixed_links_and_sites_or_bodies(tmp_path: Path) -> None:
    """foot0 is a site, foot1 a body without joints; lidar is in the URDF only."""
    urdf = urdf_text(quadruped(), [*FEET, Frame("lidar", "base", (0.2, 0, 0))])
    site = '<site name="foot1" pos="0.002 0.0 -0.2"/>'
    assert site in MJCF
    files = write(tmp_path, urdf, MJCF.replace(site, '<body name="foot1" pos="0.002 0 -0.21"/>'))
    assert set(match_files(files).robot.description.frames) == {f"foot{leg}" for leg in range(4)}
    assert list_differences(compare_files(files)) == [("frame", "foot1")]


def test_joints_are_matched_by_a_mapping_of_their_names(tmp_path: Path) -> None:
    """Two of eight joints are renamed; the mapping is the reference, so none is guessed."""
    files = write_parts(tmp_path, rename_joints(quadruped(), hip1="A", knee1="B"), quadruped())
    comparison = compare_files(files, names={"A": "hip1", "B": "knee1"})
    assert comparison.agree
    assert comparison.guessed == {}


def test_mapping_of_two_joints_to_one_is_refused(tmp_path: Path) -> None:
    """The refusal names the joint of the MJCF, hip0."""
    with pytest.raises((ModelError, UnknownNameError), match="hip0"):
        compare_texts(tmp_path, URDF, MJCF, names={"hip1": "hip0", "hip0": "hip0"})


@pytest.mark.slow
def test_joint_of_the_urdf_alone_may_have_the_name_of_a_mapped_joint(tmp_path: Path) -> None:
    """``old`` is the MJCF's hip0; another joint of the URDF is called hip0, and is unmatched."""
    urdf = rename_joints(quadruped(), hip0="old") | {"tail": make_light_part("tail", "base")}
    urdf = change_part(urdf, "tail", joint="hip0")
    still = quadruped() | {"tail": replace(make_light_part("tail", "base"), kind="fixed")}
    comparison = compare_files(write_parts(tmp_path, urdf, still), names={"old": "hip0"})
    assert comparison.only_urdf == ("hip0",)
    assert list_differences(comparison) == []


# ------------------------------------------------------------------------------------- bases


@pytest.mark.slow
@pytest.mark.parametrize(
    "free", ["<freejoint/>", '<freejoint name="root"/>', '<joint type="free"/>']
)
def test_free_joint_with_or_without_a_name_agrees(tmp_path: Path, free: str) -> None:
    """Three notations of one free joint; the URDF, which has none, is the reference."""
    assert compare_texts(tmp_path, URDF, MJCF.replace("<freejoint/>", free)).agree


@pytest.mark.slow
def test_two_massless_root_links_are_left_out(tmp_path: Path) -> None:
    """A chain of two links without mass above the base; the MJCF starts at the base."""
    text = with_root("fixed").replace(
        '<link name="world"/>',
        '<link name="map"/><joint name="m" type="floating"><parent link="map"/>'
        '<child link="world"/></joint><link name="world"/>',
    )
    comparison = compare_texts(tmp_path, text, MJCF)
    assert comparison.agree
    reported = " ".join(map(str, comparison.notes))
    assert all(f"root link '{link}' has no mass" in reported for link in ("map", "world"))


def test_massless_root_link_displaced_from_the_base_is_left_out(tmp_path: Path) -> None:
    """The base is 0.1 m above its root link; the MJCF's base body has the frame of the base."""
    assert compare_texts(tmp_path, with_root("fixed", '<origin xyz="0 0 0.1"/>'), MJCF).agree


def test_base_fixed_in_both_files_agrees_at_any_place(tmp_path: Path) -> None:
    """The MJCF's base is at (0.3, 0.2, 0.1) m, the URDF's at the origin; 3 joints are left."""
    files = write_parts(tmp_path, arm(), arm(), free=False, base_position=(0.3, 0.2, 0.1))
    assert compare_files(files).agree
    robot = match_files(files).robot
    assert not robot.floating
    assert robot.nv == 3


def test_fixed_base_of_several_bodies_agrees(tmp_path: Path) -> None:
    """A tower fixed to a foot: both are the base, whose frame is that of the root link.

    Reference: the engines' check of both files, which finds no deviation.
    """
    foot = Part("foot", mass=0.9, com=(0.0, 0.02, 0.01))
    tower = replace(
        arm()["base"], parent="foot", joint="tower", kind="fixed", position=(0.0, 0.1, 0.05),
        quaternion=(0.8, 0.0, 0.6, 0.0),
    )  # fmt: skip
    parts = {"foot": foot, **arm(), "base": tower}
    prefixed = {
        f"left_{name}": replace(
            part, link=f"left_{part.link}", parent=part.parent and f"left_{part.parent}"
        )
        for name, part in parts.items()
    }
    text = mjcf_text(prefixed, (), free=False, base_position=(0.3, 0.0, 0.2))
    comparison = compare_files(write(tmp_path, urdf_text(parts, ()), text))
    assert comparison.agree
    assert comparison.engines == ()
    assert comparison.check.passed


def test_robot_of_one_joint_is_compared(tmp_path: Path) -> None:
    """A pendulum on a fixed base; the engines' check of both files is the reference."""
    tip = [Frame("tip", "bob", (0.0, 0.0, -0.5))]
    urdf, mjcf = urdf_text(pendulum(), tip), mjcf_text(pendulum(), tip, free=False)
    comparison = compare_texts(tmp_path, urdf, mjcf)
    assert comparison.agree
    assert comparison.check.passed
    assert comparison.joints == ("swing",)


@pytest.mark.slow
def test_static_object_is_no_part_of_a_fixed_base(tmp_path: Path) -> None:
    """A table on the world is left out with a note; the base's mass is compared without it."""
    table = '<body name="table" pos="1 0 0"><geom size="0.1"/></body>'
    mjcf = mjcf_text(arm(), free=False, scene=table)
    comparison = compare_texts(tmp_path, urdf_text(arm()), mjcf)
    assert comparison.agree
    assert comparison.engines == ()
    reported = " ".join(map(str, comparison.notes))
    assert "body 'table' is not part of the robot" in reported
    heavier = mjcf_text(change_part(arm(), "base", mass=3.5), free=False, scene=table)
    comparison = compare_texts(tmp_path, urdf_text(arm()), heavier)
    assert list_differences(comparison) == [("mass", "base")]


def test_loose_object_without_a_name_is_no_part_of_the_robot(tmp_path: Path) -> None:
    """Neither the ball nor the base has a name; the URDF without the ball is the reference."""
    scene = BALL.replace(' name="ball"', "")
    mjcf = mjcf_text(quadruped(), scene=scene).replace('<body name="base"', "<body")
    assert compare_texts(tmp_path, URDF, mjcf).agree


# ------------------------------------------------------------------------------------- joints


def test_values_beside_a_ball_joint_are_compared(tmp_path: Path) -> None:
    """The shank below the ball joint has 0.4 kg: the only difference."""
    text = mjcf_text(change_part(quadruped(), "shank1", mass=0.4))
    text = text.replace('name="hip1" type="hinge"', 'name="hip1" type="ball" limited="false"')
    motor = next(line for line in text.splitlines() if 'joint="hip1"' in line)
    comparison = compare_texts(tmp_path, URDF, text.replace(motor, ""))
    assert list_differences(comparison) == [("mass", "knee1")]
    assert comparison.complete


def test_mass_in_a_closed_loop_is_compared_beside_its_equality(tmp_path: Path) -> None:
    """References: the equality and the mass of 0.4 kg that were added to the MJCF."""
    loop = '<equality><connect body1="shank0" body2="shank1" anchor="0 0 0"/></equality>'
    mjcf = mjcf_text(change_part(quadruped(), "shank1", mass=0.4), extra=loop)
    comparison = compare_texts(tmp_path, URDF, mjcf)
    assert sorted(kind for kind, _ in list_differences(comparison)) == ["equality", "mass"]
    assert comparison.complete


def test_mimic_joint_without_equality_in_the_mjcf_is_a_difference(tmp_path: Path) -> None:
    """The message states the factor and the offset of the URDF."""
    mimic = '<mimic joint="hip0" multiplier="2"/>\n<axis xyz="0.0 1.0 0.0"/>'
    comparison = compare_texts(tmp_path, URDF.replace('<axis xyz="0.0 1.0 0.0"/>', mimic, 1), MJCF)
    assert "knee0" in comparison.joints
    assert list_differences(comparison) == [("mimic", "knee0")]
    assert comparison.differences[0].message.startswith(
        "joint knee0: mimics hip0 in the URDF (times 2, plus 0)"
    )


@pytest.mark.slow
def test_continuous_joint_lacks_the_limits_of_a_revolute_joint(tmp_path: Path) -> None:
    """Continuous joints of both files agree; one of the URDF alone differs in both limits."""
    assert compare_files(write_parts(tmp_path, arm(), arm())).agree
    free = change_part(quadruped(), "thigh0", kind="continuous")
    comparison = compare_files(write_parts(tmp_path, free, quadruped()))
    assert list_differences(comparison) == [("lower limit", "hip0"), ("upper limit", "hip0")]


def test_joints_with_different_axes_are_not_matched(tmp_path: Path) -> None:
    """The renamed joint has axis z in the URDF and the original axis in the MJCF."""
    urdf = change_part(quadruped(), "shank3", joint="other", axis=(0.0, 0.0, 1.0))
    comparison = compare_files(write_parts(tmp_path, urdf, rename_links(quadruped())))
    assert comparison.guessed == {}
    assert (comparison.only_urdf, comparison.only_mjcf) == (("other",), ("knee3",))


def remove_joint_name(text: str, joint: str) -> str:
    """Return the MJCF with the joint without its name, and therefore without its motor."""
    text = text.replace(f'<joint name="{joint}" ', "<joint ")
    return "\n".join(line for line in text.splitlines() if f'<motor name="m_{joint}"' not in line)


def test_hinge_without_a_name_is_named_after_its_body(tmp_path: Path) -> None:
    """Its effort is the only difference, because a motor cannot refer to an unnamed joint."""
    comparison = compare_texts(tmp_path, URDF, remove_joint_name(MJCF, "knee2"))
    assert comparison.guessed == {"knee2": "shank2_joint"}
    assert any("without a name" in str(n) and "'shank2_joint'" in str(n) for n in comparison.notes)
    assert list_differences(comparison) == [("effort", "shank2_joint")]
    assert comparison.differences[0].mjcf_place is not None


def test_name_given_to_a_hinge_differs_from_those_of_the_file(tmp_path: Path) -> None:
    """Another joint already has the name shank2_joint; all eight joints are compared."""
    mjcf = remove_joint_name(MJCF, "knee2").replace('"knee1"', '"shank2_joint"')
    comparison = compare_texts(tmp_path, URDF.replace('"knee1"', '"shank2_joint"'), mjcf)
    assert len(comparison.joints) == 8
    assert {kind for kind, _ in list_differences(comparison)} <= {"effort"}


# ------------------------------------------------------------------------------------- files


def test_files_that_were_read_can_be_matched_twice(tmp_path: Path) -> None:
    """Matching changes copies: the second match equals the first, and the MJCF keeps its joints.

    Each file has a joint that the other lacks, half of the robot's length apart.
    """
    tail = make_light_part("tail", "base")
    neck = make_light_part("neck", "base", position=(0.3, 0.0, 0.0))
    mjcf_parts = quadruped() | {"neck": neck}
    files = write_parts(tmp_path, quadruped() | {"tail": tail}, mjcf_parts)
    urdf, mjcf = read_urdf(files.urdf), read_mjcf(files.mjcf)
    first, second = match_models(urdf, mjcf), match_models(urdf, mjcf)
    assert first.only_urdf == second.only_urdf == ("to_tail",)
    assert first.only_mjcf == second.only_mjcf == ("to_neck",)
    assert [joint.name for joint in mjcf.spec.joints if joint.name] == [
        part.joint for part in mjcf_parts.values() if part.joint
    ]
    assert len(mjcf.spec.bodies) == 11
    assert isinstance(mjcf.model, mujoco.MjModel)


def test_bodies_merged_by_mujoco_are_no_common_frames(tmp_path: Path) -> None:
    """With ``fusestatic`` MuJoCo's compiled model lacks the fixed body ``foot``."""
    urdf, mjcf = tmp_path / "tiny.urdf", tmp_path / "tiny.xml"
    urdf.write_text(TINY_URDF)
    body = '<body name="foot" pos="0 0 -0.1"/>'
    kept = TINY_MJCF.replace('<site name="foot" pos="0 0 -0.1"/>', body)
    assert body in kept
    for text, frames in (
        (kept, {"foot"}),
        (kept.replace("<compiler ", '<compiler fusestatic="true" '), set()),
    ):
        mjcf.write_text(text)
        robot = match_models(read_urdf(urdf), read_mjcf(mjcf)).robot
        assert set(robot.description.frames) == frames
        first, second = kinematic_trees(robot)
        assert first.joints.keys() == second.joints.keys() == {"turn", "bend", "push"}


def test_single_joint_at_the_origin_of_the_base_is_matched_by_its_axis(tmp_path: Path) -> None:
    """All joints have distance 0 from the base, and from each other."""
    urdf = pendulum(position=(0.0, 0.0, 0.0))
    mjcf = change_part(urdf, "bob", joint="revolution")
    assert match_files(write_parts(tmp_path, urdf, mjcf)).guessed == {"swing": "revolution"}
