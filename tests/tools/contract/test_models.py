"""Joints that one of several models lacks are named, for models of each format in any order.

Reference: the models are written with known joints, from one table, as URDF and MJCF.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from itertools import chain, permutations
from pathlib import Path

import pytest

from pupper_analysis.tools.contract import Contract, read_contract
from tests.tools.contract.sources import URDF, write_all

LEGS = {"left": 0.1, "right": -0.1}
BODY_JOINTS = ("left_hip", "left_knee", "right_hip", "right_knee")
INERTIA = 'ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"'
FREE_BASE = "<freejoint/>"
SIX_JOINTS = "".join(
    f'<joint name="base_{kind}{axis}" type="{kind}" axis="{axis}"/>'
    for kind in ("slide", "hinge")
    for axis in ("1 0 0", "0 1 0", "0 0 1")
)
DOOR = '<body name="door" pos="1 0 0"><joint name="door_hinge"/><geom size="0.1"/></body>'


def list_chains(hands: bool) -> list[list[tuple[str, float, float]]]:
    """Return the joints of both limbs, from the base outwards: name, y and z [m] in the parent."""
    return [
        [(f"{side}_hip", y, 0.0), (f"{side}_knee", 0.0, -0.2)]
        + ([(f"{side}_finger", 0.0, -0.1)] if hands else [])
        for side, y in LEGS.items()
    ]


def write_urdf(path: Path, *, hands: bool = False, names: Mapping[str, str] | None = None) -> Path:
    """Write a robot with two legs as a URDF; ``names`` renames joints."""
    inertial = f'<inertial><mass value="1"/><inertia {INERTIA}/></inertial>'
    lines = [f'<robot name="robot"><link name="torso">{inertial}</link>']
    for limb in list_chains(hands):
        parent = "torso"
        for joint, y, z in limb:
            lines.append(
                f'<link name="{joint}_link">{inertial}</link>'
                f'<joint name="{(names or {}).get(joint, joint)}" type="revolute">'
                f'<parent link="{parent}"/><child link="{joint}_link"/>'
                f'<origin xyz="0 {y} {z}"/><axis xyz="0 1 0"/>'
                '<limit lower="-1" upper="1" effort="5" velocity="9"/></joint>'
            )
            parent = f"{joint}_link"
    path.write_text("\n".join([*lines, "</robot>"]))
    return path


def write_mjcf(
    path: Path,
    *,
    hands: bool = False,
    names: Mapping[str, str] | None = None,
    base: str = FREE_BASE,
    objects: str = "",
) -> Path:
    """Write the robot of `write_urdf` as an MJCF; ``objects`` are further bodies of the world."""
    inertial = '<inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>'
    lines = ['<mujoco><compiler angle="radian"/><worldbody>', objects]
    lines.append(f'<body name="torso">{base}{inertial}')
    for limb in list_chains(hands):
        for joint, y, z in limb:
            lines.append(
                f'<body name="{joint}_link" pos="0 {y} {z}">{inertial}'
                f'<joint name="{(names or {}).get(joint, joint)}" axis="0 1 0" range="-1 1" '
                'actuatorfrcrange="-5 5"/>'
            )
        lines.append("</body>" * len(limb))
    path.write_text("\n".join([*lines, "</body></worldbody></mujoco>"]))
    return path


def compare(*models: Path) -> Contract:
    return read_contract(*models, stand=False)


def list_missing(found: Contract) -> list[tuple[str, str, Sequence[str]]]:
    """Return (model that lacks joints, model that contains these joints, names of the joints)."""
    assert {message.code for message in found.unread} <= {"contract-joints-missing"}
    return [
        (str(values["file"]), str(values["other"]), values["names"])
        for values in (message.values for message in found.unread)
    ]


WRITERS = {"urdf": write_urdf, "mjcf": write_mjcf}


@pytest.mark.parametrize("formats", [("urdf", "urdf"), ("mjcf", "mjcf"), ("urdf", "mjcf"),
                                     ("mjcf", "urdf")])  # fmt: skip
@pytest.mark.parametrize("suffix", [".xml", ""])
def test_joints_that_a_model_lacks_are_named_in_both_orders(
    tmp_path: Path, formats: tuple[str, str], suffix: str
) -> None:
    """Only the second model has the two finger joints. ``.xml`` is valid for both formats."""
    endings = [suffix or {"urdf": ".urdf", "mjcf": ".xml"}[name] for name in formats]
    bare = WRITERS[formats[0]](tmp_path / f"bare{endings[0]}")
    handed = WRITERS[formats[1]](tmp_path / f"handed{endings[1]}", hands=True)
    for models in permutations((bare, handed)):
        found = compare(*models)
        expected = [(bare.name, handed.name, ("left_finger", "right_finger"))]
        assert list_missing(found) == expected
        assert not found.passed
        assert found.findings == found.notes == ()


@pytest.mark.parametrize("name", list(WRITERS))
def test_equal_models_of_one_format_agree(tmp_path: Path, name: str) -> None:
    models = [WRITERS[name](tmp_path / f"{stem}.xml", hands=True) for stem in "ab"]
    found = compare(*models)
    assert found.passed
    assert found.unread == found.notes == found.findings == ()


@pytest.mark.parametrize("name", list(WRITERS))
def test_joints_with_other_names_are_matched_by_position_in_two_models_of_one_format(
    tmp_path: Path, name: str
) -> None:
    """The second model has the same joints at the same positions, with numbers as names."""
    first = WRITERS[name](tmp_path / "first.xml", hands=True)
    numbers = {
        joint: f"m{number}"
        for number, (joint, *_) in enumerate(chain.from_iterable(list_chains(True)))
    }
    second = WRITERS[name](tmp_path / "second.xml", hands=True, names=numbers)
    for models in permutations((first, second)):
        found = compare(*models)
        assert [note.code for note in found.notes] == ["contract-matched"]
        assert found.unread == ()
        assert found.passed
        # Each source states the same number of limits of the six joints.
        counts = [
            len([fact for fact in found.facts if fact.source == model.name]) for model in models
        ]
        assert counts[0] == counts[1] >= 12


def test_each_of_two_models_can_lack_joints_of_the_other(tmp_path: Path) -> None:
    """A foreign joint of another axis matches no joint; the option --map is proposed."""
    first = write_urdf(tmp_path / "first.urdf", hands=True)
    second = tmp_path / "second.urdf"
    text = write_urdf(second, hands=True).read_text()
    for side in LEGS:
        old, axis = f'name="{side}_finger"', 'xyz="0 1 0"'
        place = text.index(axis, text.index(old))
        text = text[:place] + 'xyz="1 0 0"' + text[place + len(axis) :]
        text = text.replace(old, f'name="{side}_wheel"')
    second.write_text(text)
    for models in permutations((first, second)):
        found = compare(*models)
        assert sorted(list_missing(found)) == [
            ("first.urdf", "second.urdf", ("left_wheel", "right_wheel")),
            ("second.urdf", "first.urdf", ("left_finger", "right_finger")),
        ]
        target = f"--map NAME=JOINT (JOINT of {models[0].name})"
        assert all(target in str(message) for message in found.unread)
        stems = ("wheel", "finger") if models[0] is first else ("finger", "wheel")
        names = {f"{side}_{stems[0]}": f"{side}_{stems[1]}" for side in LEGS}
        assert read_contract(*models, names=names, stand=False).unread == ()


def test_three_models_of_two_formats_have_the_same_result_in_any_order(tmp_path: Path) -> None:
    """One URDF lacks the fingers; the knees of the MJCF, which comes first, have other names."""
    models = (
        write_urdf(tmp_path / "a.urdf"),
        write_urdf(tmp_path / "b.urdf", hands=True),
        write_mjcf(tmp_path / "c.xml", hands=True, names={"left_knee": "m1", "right_knee": "m2"}),
    )
    for ordered in permutations(models):
        found = compare(*ordered)
        assert list_missing(found) == [("a.urdf", "c.xml", ("left_finger", "right_finger"))]
        assert [note.code for note in found.notes] == ["contract-matched"]


def test_missing_joint_is_not_repeated_if_the_other_name_is_probably_this_joint(
    tmp_path: Path,
) -> None:
    first = write_urdf(tmp_path / "first.urdf")
    second = tmp_path / "second.urdf"
    text = first.read_text().replace('"left_knee"', '"wheel"', 1)
    place = text.index('xyz="0 1 0"', text.index('"wheel"'))
    second.write_text(text[:place] + 'xyz="1 0 0"' + text[place + len('xyz="0 1 0"') :])
    (message,) = compare(first, second).unread
    assert message.code == "contract-names-unknown"
    assert (message.values["names"], message.values["joint"]) == (("wheel",), "left_knee")


@pytest.mark.parametrize("base", [FREE_BASE, SIX_JOINTS])
def test_joints_of_a_free_base_and_of_other_objects_need_no_counterpart(
    tmp_path: Path, base: str
) -> None:
    """A URDF contains neither the six joints of a free base nor the door of an MJCF's scene."""
    urdf = write_urdf(tmp_path / "robot.urdf")
    scene = write_mjcf(tmp_path / "scene.xml", base=base, objects=DOOR)
    robot = write_mjcf(tmp_path / "robot.xml")
    for models in ((urdf, scene), (scene, urdf), (robot, scene), (scene, robot)):
        found = compare(*models)
        assert found.unread == ()
        assert found.passed
    handed = write_urdf(tmp_path / "handed.urdf", hands=True)
    assert list_missing(compare(scene, handed)) == [
        ("scene.xml", "handed.urdf", ("left_finger", "right_finger"))
    ]


def test_joint_of_another_object_beside_a_fixed_robot_is_named(tmp_path: Path) -> None:
    """Without a free base, the second tree could be an arm of the robot."""
    urdf = write_urdf(tmp_path / "robot.urdf")
    scene = write_mjcf(tmp_path / "scene.xml", base="", objects=DOOR)
    assert list_missing(compare(urdf, scene)) == [("robot.urdf", "scene.xml", ("door_hinge",))]


def test_configuration_may_contain_the_actuated_joints_alone(tmp_path: Path) -> None:
    """A policy that moves the legs is no model that lacks the fingers."""
    model = write_urdf(tmp_path / "robot.urdf", hands=True)
    config = tmp_path / "deploy.yaml"
    config.write_text(
        f"joint_names: [{', '.join(BODY_JOINTS)}]\njoint_lower_limits: [-1, -1, -1, -1]\n"
    )
    found = compare(model, config)
    assert found.unread == ()
    assert found.passed


@pytest.mark.slow
def test_default_pose_is_that_of_the_first_of_two_urdfs(tmp_path: Path) -> None:
    """Reference: each model alone. The thighs of the second model are 10 mm longer."""
    config = write_all(tmp_path)["policy.json"]
    longer = tmp_path / "longer.urdf"
    text, count = re.subn(
        r'(<joint name="leg_\w+_3" type="revolute">\s*<origin xyz="\S+ \S+) 0\.0685"',
        r'\1 0.0785"',
        URDF.read_text(),
    )
    assert count == 4
    longer.write_text(text)
    heights = [read_contract(model, config).poses[0].height for model in (URDF, longer)]
    assert None not in heights
    assert abs(heights[1] - heights[0]) > 0.002
    for models, height in (((URDF, longer), heights[0]), ((longer, URDF), heights[1])):
        found = read_contract(*models, config)
        assert [pose.height for pose in found.poses] == [height]
