"""Comparison of two versions of a model: each change is found with its lines and its effect."""

from __future__ import annotations

import hashlib
import json
import os
import pickle
import re
import subprocess
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest

import pupper_analysis as pa
from pupper_analysis import cli
from pupper_analysis.models.multibody import from_pinocchio
from pupper_analysis.robot.matching.trees import kinematic_trees
from pupper_analysis.tools.diff.compare import RandomStates, fix_joint, rename_joints
from tests.support.commands import Answer, answer
from tests.support.engines import to_pinocchio
from tests.support.repository import ROOT
from tests.support.robots import (
    FEET,
    Parts,
    arm,
    change_part,
    mjcf_text,
    pendulum,
    quadruped,
    turned_about,
    turned_frames,
    urdf_text,
)
from tests.support.variants import load

ROBOT = quadruped()
TEXT = {"urdf": urdf_text, "xml": mjcf_text}


def write_both(folder: Path, old: str, new: str, kind: str) -> tuple[Path, Path]:
    files = folder / f"old.{kind}", folder / f"new.{kind}"
    for file, text in zip(files, (old, new), strict=True):
        file.write_text(text)
    return files


def diff_of(
    folder: Path, old: Parts, new: Parts, kind: str, **options: Any
) -> pa.analysis.ModelDiff:
    return pa.diff_models(*write_both(folder, TEXT[kind](old), TEXT[kind](new), kind), **options)


def list_changes(diff: pa.analysis.ModelDiff) -> list[tuple[str, str]]:
    return [(change.kind, change.element) for change in diff.changes]


def line_at(place: str) -> str:
    file, _, line = place.rpartition(":")
    return Path(file).read_text().splitlines()[int(line) - 1]


CHANGES: dict[str, tuple[str, dict[str, Any], list[tuple[str, str]], str]] = {
    "mass": ("base", {"mass": 6.5}, [("mass", "base")], "6.5"),
    "com": ("thigh1", {"com": (0.01, 0.02, -0.04)}, [("com", "hip1")], "-0.04"),
    "inertia": (
        "shank2",
        {"inertia": (0.002, 0.002, 3e-4, 0, 0, 0)},
        [("inertia", "knee2")],
        "0.002",
    ),
    "position": ("shank0", {"position": (0, 0.08, -0.25)}, [("position", "knee0")], "-0.25"),
    "axis": ("thigh3", {"axis": (-1.0, 0.0, 0.0)}, [("axis", "hip3")], "-1.0 0.0 0.0"),
    "lower": ("thigh0", {"lower": -0.7}, [("lower limit", "hip0")], "-0.7"),
    "upper": ("thigh0", {"upper": 0.7}, [("upper limit", "hip0")], "0.7"),
    "damping": ("shank1", {"damping": 0.3}, [("damping", "knee1")], "0.3"),
    "friction": ("shank1", {"friction": 0.35}, [("friction", "knee1")], "0.35"),
}
FELT = {"mass", "com", "inertia", "position", "axis", "damping"}


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["urdf", "xml"])
@pytest.mark.parametrize("name", CHANGES)
def test_change_is_found_with_the_lines_of_both_versions(
    tmp_path: Path, name: str, kind: str
) -> None:
    """The changed value is on the reported line of the new version only.

    Changes without effect on the dynamics have a deviation of exactly zero.
    """
    link, values, expected, text = CHANGES[name]
    diff = diff_of(tmp_path, ROBOT, change_part(ROBOT, link, **values), kind)
    assert not diff.same
    assert list_changes(diff) == expected
    (change,) = diff.changes
    assert change.old_place.startswith(f"{tmp_path}/old.{kind}:")
    assert text in line_at(change.new_place)
    assert text not in line_at(change.old_place)
    assert bool(change.effects) is (name in FELT)
    assert diff.complete, diff.residual
    if name in FELT:
        assert max(diff.deviations.values()) > 1e-6
        assert all(effect.share == pytest.approx(1.0) for effect in change.effects.values())
    else:
        assert max(diff.deviations.values()) == 0


@pytest.mark.parametrize(
    ("kind", "old", "new"),
    [
        ("urdf", 2.0, 2.00000004),
        ("xml", 2.0, 2.00000004),
        ("urdf", 1.99999997, 2.00000003),
    ],
)
def test_small_change_is_printed_with_the_digits_that_differ(
    tmp_path: Path, kind: str, old: float, new: float
) -> None:
    """Reference: the masses in the files; with six digits, both are 2 kg."""
    files = write_both(tmp_path, *(TEXT[kind](pendulum(mass=mass)) for mass in (old, new)), kind)
    lines = answer("diff", *map(str, files), "-v").stdout.splitlines()
    found = [re.findall(r"([0-9.]+) kg", line) for line in lines if " kg" in line]
    assert [len(masses) for masses in found] == [2, 2], lines
    for first, second in found:
        change = float(second) - float(first)
        assert change == pytest.approx(new - old, rel=0.5)


def test_old_and_new_are_not_exchanged(tmp_path: Path) -> None:
    other = change_part(ROBOT, "base", mass=9.0)
    diff = diff_of(tmp_path, ROBOT, other, "urdf")
    assert (diff.changes[0].old, diff.changes[0].new) == (6.0, 9.0)
    assert diff.changes[0].message == (
        "link base: mass 6 kg in the old file, 9 kg in the new file (+50 %)"
    )
    assert diff.mass[1] - diff.mass[0] == pytest.approx(3.0, abs=1e-12)
    lines = answer("diff", *(str(tmp_path / f"{version}.urdf") for version in ("old", "new")))
    first, second, *_ = lines.stdout.splitlines()  # short names, and both masses
    assert first.startswith("DIFFERENT old.urdf and new.urdf: base mass 6 -> 9 kg (+50 %)")
    old, new = diff.mass
    assert second.startswith(f"  total mass {old:.6g} -> {new:.6g} kg (+")
    back = diff_of(tmp_path, other, ROBOT, "urdf")
    assert back.mass == diff.mass[::-1]


def test_moved_lines_and_other_digits_are_no_change(tmp_path: Path) -> None:
    text = urdf_text(ROBOT)
    other = text.replace(">\n", ">\n\n").replace('value="6.0"', 'value="6.00000000000"')
    assert pa.diff_models(*write_both(tmp_path, text, other, "urdf")).same


def test_a_moved_base_frame_is_one_change(tmp_path: Path) -> None:
    """Everything on the base moves with its frame.

    A joint with another zero, and limits moved by as much, is one change as well.
    """
    moved = change_part(ROBOT, "base", com=(0.01, 0.002, 0.045))
    for leg in range(4):
        x, y, z = ROBOT[f"thigh{leg}"].position
        moved = change_part(moved, f"thigh{leg}", position=(x, y, z + 0.05))
    (change,) = diff_of(tmp_path, ROBOT, moved, "urdf").changes
    assert (change.kind, change.element) == ("base frame", "base")
    assert (
        "the frame of the old file is at (0, 0, 0.05) m, relative to the frame of the new file"
        in change.message
    )
    thigh = ROBOT["thigh1"]
    turned = turned_about(thigh, thigh.axis, 0.3)
    new = change_part(ROBOT, "thigh1", quaternion=turned, lower=thigh.lower - 0.3, upper=0.6)
    diff = diff_of(tmp_path, ROBOT, new, "urdf")
    assert list_changes(diff) == [("zero", "hip1")]
    assert "q of the old file = q of the new file + 0.3 rad" in diff.changes[0].message
    assert diff.complete


@pytest.mark.parametrize("kind", ["urdf", "xml"])
def test_removed_joint_is_reported_and_the_rest_compared_at_zero(tmp_path: Path, kind: str) -> None:
    new = change_part(ROBOT, "shank2", kind="fixed", mass=0.3)
    diff = diff_of(tmp_path, ROBOT, new, kind)
    assert ("joint", "knee2") in list_changes(diff)
    message = next(change for change in diff.changes if change.kind == "joint")
    assert "only in the old file" in message.message
    assert ("mass", "hip2") in list_changes(diff)  # of thigh and shank together
    assert diff.mass[1] - diff.mass[0] == pytest.approx(0.3 - ROBOT["shank2"].mass)
    assert diff.complete
    back = diff_of(tmp_path, new, ROBOT, kind)
    message = next(change for change in back.changes if change.kind == "joint")
    assert "only in the new file" in message.message
    same = change_part(ROBOT, "shank2", kind="fixed")
    others = [kind for kind, _ in list_changes(diff_of(tmp_path, ROBOT, same, kind))]
    assert set(others) <= {"joint", "motor"}


def test_tendon_and_site_motors_are_matched_by_target_name(tmp_path: Path) -> None:
    """An additional site, which shifts the ids, is no change of the motors."""
    extra = (
        '<tendon><fixed name="cable"><joint joint="hip0" coef="1"/></fixed></tendon>'
        '<actuator><motor name="winch" tendon="cable" gear="2"/>'
        '<motor name="thruster" site="foot2" gear="0 0 1 0 0 0"/></actuator>'
    )
    text = mjcf_text(ROBOT, extra=extra)
    more = text.replace('<site name="foot0"', '<site name="mark"/><site name="foot0"')
    assert pa.diff_models(*write_both(tmp_path, text, more, "xml")).same
    null = pa.diff_models(*write_both(tmp_path, text, text.replace('gear="2"', 'gear="0"'), "xml"))
    assert [change.message for change in null.changes] == [
        "motor winch: gear (2) in the old file, gear (0) in the new file"  # it was "gear ()"
    ]
    new = text.replace('site="foot2"', 'site="foot3"').replace('gear="2"', 'gear="2.5"')
    diff = pa.diff_models(*write_both(tmp_path, text, new, "xml"))
    assert [change.message for change in diff.changes] == [
        "motor winch: gear (2) in the old file, gear (2.5) in the new file",
        "motor thruster: at site foot2 in the old file, at site foot3 in the new file",
    ]


TURN = """<mujoco><worldbody><body><joint name="turn" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 .3 0 0" size=".01" mass="1"/></body></worldbody>
<actuator><motor name="turn" {}/></actuator></mujoco>"""


@pytest.mark.parametrize(
    ("old", "new", "reported"),
    [
        ('joint="turn" forcerange="-9 9"', 'joint="turn" forcerange="-9 2"', "forcerange (-9, 2)"),
        ('joint="turn" forcerange="-2 9"', 'joint="turn" forcerange="-9 2"', "forcerange (-9, 2)"),
        ('joint="turn"', 'joint="turn" forcerange="-9 2"', "forcerange (-9, 2)"),
        ('site="tip" forcerange="-9 9"', 'site="tip" forcerange="-7 7"', "forcerange (-7, 7)"),
    ],
)
def test_changed_force_range_of_one_direction_is_reported(
    tmp_path: Path, old: str, new: str, reported: str
) -> None:
    """Reference: the ranges of the compiled models differ; `diff` compared the larger ends."""
    text = TURN.replace("<geom", '<site name="tip"/><geom')
    files = write_both(tmp_path, text.format(old), text.format(new), "xml")
    ranges = [mujoco.MjModel.from_xml_path(str(file)).actuator_forcerange for file in files]
    assert not np.array_equal(*ranges)
    diff = pa.diff_models(*files)
    assert not diff.same
    messages = [change.message for change in diff.changes if change.kind == "motor"]
    assert [reported in message for message in messages] == [True]


def test_changed_torque_range_of_a_joint_in_one_direction_is_reported(tmp_path: Path) -> None:
    text = TURN.replace('axis="0 1 0"', 'axis="0 1 0" actuatorfrcrange="{}"').replace("{}/", "/")
    old, new = (text.replace("{}", ends) for ends in ("-9 9", "-9 2"))
    old, new = (text.replace("<motor ", '<motor joint="turn" ') for text in (old, new))
    diff = pa.diff_models(*write_both(tmp_path, old, new, "xml"))
    assert [change.message for change in diff.changes if change.kind == "motor"] == [
        "motor turn: actuatorfrcrange (-9, 9) in the old file, "
        "actuatorfrcrange (-9, 2) in the new file"
    ]


TWO_ARMS = """<mujoco><worldbody><body name="base">{bodies}</body></worldbody>
<actuator>{motors}</actuator>
<keyframe><key name="home" qpos="{qpos}" qvel="{qvel}" ctrl="{ctrl}"/></keyframe></mujoco>"""
ARMS = {
    name: f'<body pos="{place} 0 1"><joint name="{name}" axis="0 1 0" damping="1"/>'
    '<geom type="capsule" fromto="0 0 0 .3 0 0" size=".01" mass="1"/></body>'
    for name, place in (("a", 0), ("b", 1))
}
MOTORS = {name: f'<position name="{name}" joint="{name}" kp="50"/>' for name in ARMS}


def write_two_arms(order: str, motors: str, qpos: str, ctrl: str) -> str:
    """Return two arms with joints and motors in an order, and a keyframe."""
    return TWO_ARMS.format(
        bodies="".join(ARMS[name] for name in order),
        motors="".join(MOTORS[name] for name in motors),
        qpos=qpos,
        qvel=qpos,
        ctrl=ctrl,
    )


def test_numbers_of_a_keyframe_are_compared_by_joint_and_actuator(tmp_path: Path) -> None:
    """References: equal numbers for other joints or actuators are another pose or command; the same
    numbers for the same joints in another order are no change.
    """
    old = write_two_arms("ab", "ab", "0.1 0.5", "0.2 0.6")
    for changed, words in {
        ("ba", "ab", "0.1 0.5", "0.2 0.6"): {"qpos", "qvel"},
        ("ab", "ba", "0.1 0.5", "0.2 0.6"): {"ctrl"},
        ("ba", "ba", "0.5 0.1", "0.6 0.2"): set(),
    }.items():
        diff = pa.diff_models(*write_both(tmp_path, old, write_two_arms(*changed), "xml"))
        assert {str(change.diagnostic.values["what"]) for change in diff.changes} == words
        assert diff.same is (not words)


def test_base_that_became_fixed_is_a_change(tmp_path: Path) -> None:
    text = mjcf_text(ROBOT)
    diff = pa.diff_models(*write_both(tmp_path, text, mjcf_text(ROBOT, free=False), "xml"))
    assert list_changes(diff) == [("type", "base")]
    assert diff.changes[0].message == "base base: free in the old file, fixed in the new file"


def test_versions_without_a_common_joint_are_refused() -> None:
    with pytest.raises(pa.ModelError, match=r"no common joint with .* and 9 more; diff"):
        pa.diff_models(ROOT / "urdf/pupper_v3.urdf", ROOT / "urdf/pupper_skeleton.urdf")


def test_changed_and_removed_mimic_are_reported_with_their_values(tmp_path: Path) -> None:
    text = urdf_text(ROBOT)
    mimic = '<mimic joint="hip0" multiplier="2" offset="0.1"/>'
    old = text.replace('<axis xyz="0.0 1.0 0.0"/>', f'<axis xyz="0.0 1.0 0.0"/>{mimic}', 1)
    new = old.replace('multiplier="2"', 'multiplier="3"')
    diff = pa.diff_models(*write_both(tmp_path, old, new, "urdf"))
    assert list_changes(diff) == [("mimic", "knee0")]
    assert "(hip0, 2, 0.1) in the old file, (hip0, 3, 0.1) in the new file" in (
        diff.changes[0].message
    )
    removed = pa.diff_models(*write_both(tmp_path, old, text, "urdf"))
    assert (removed.changes[0].kind, removed.changes[0].new) == ("mimic", None)
    assert pa.diff_models(*write_both(tmp_path, old, old, "urdf")).same


# ------------------------------------------------------------------------------------- physics


def test_gravity_torques_equal_the_pendulum_in_closed_form(tmp_path: Path) -> None:
    """Closed form m g l |sin q|, the largest value at the evaluated positions."""
    old, new = pendulum(), pendulum(mass=3.0, com=(0.0, 0.0, -0.7))
    diff = diff_of(tmp_path, old, new, "urdf")
    first, second = diff.torques["swing"]
    assert second / first == pytest.approx(3.0 * 0.7 / (2.0 * 0.5), rel=1e-12)
    files = write_both(tmp_path, urdf_text(old, []), urdf_text(new, []), "urdf")
    tree = from_pinocchio(pin.buildModelFromUrdf(str(files[0])), "base", ["swing"], {})
    positions = RandomStates(tree).qpos[:, 0]
    assert len(positions) == 10
    assert np.ptp(positions) > 1.0
    assert first == pytest.approx(2.0 * 9.81 * 0.5 * np.abs(np.sin(positions)).max(), rel=1e-12)


def test_base_mass_of_a_urdf_arm_changes_neither_mass_matrix_nor_gravity(tmp_path: Path) -> None:
    """The base of an arm is fixed: Pinocchio with a fixed base returns equal mass matrices.

    With a free base, the mass of the base would be part of the mass matrix.
    """
    old, new = arm(), change_part(arm(), "base", mass=4.0)
    diff = diff_of(tmp_path, old, new, "urdf")
    assert not diff.floating
    assert list_changes(diff) == [("mass", "base")]
    assert set(diff.changes[0].effects) == {"com"}
    models = [pin.buildModelFromUrdf(str(tmp_path / f"{name}.urdf")) for name in ("old", "new")]
    q = pin.neutral(models[0])
    first, second = (pin.crba(model, model.createData(), q) for model in models)
    np.testing.assert_array_equal(first, second)
    # A load on the last link does change the mass matrix, with a fixed base as well.
    loaded = diff_of(tmp_path, old, change_part(old, "rod", mass=0.6), "urdf")
    assert {"mass matrix", "gravity", "bias forces"} <= set(loaded.changes[0].effects)


@pytest.mark.parametrize(("root", "is_free"), [("trunk", True), ("world", False)])
def test_base_of_a_urdf_with_two_limbs_is_free_unless_it_is_the_world(
    tmp_path: Path, root: str, is_free: bool
) -> None:
    """`convert` decides likewise: with legs the base is free, a root link `world` is fixed."""
    parts = quadruped()
    text = urdf_text(parts).replace('"base"', f'"{root}"')
    new = urdf_text(change_part(parts, "base", mass=6.5)).replace('"base"', f'"{root}"')
    diff = pa.diff_models(*write_both(tmp_path, text, new, "urdf"))
    assert diff.floating is is_free
    assert ("mass matrix" in diff.changes[0].effects) is is_free


@pytest.mark.parametrize("name", ["v3", "original"])
def test_behaviour_is_that_of_configurations(name: str) -> None:
    """Reference: Pinocchio's `Configuration` of the file; MuJoCo evaluates the tree."""
    robot = load(name)
    tree, _ = kinematic_trees(robot)
    trial = RandomStates(tree)
    behaviour = trial.evaluate_tree(tree)
    order = [list(tree.joints).index(joint) for joint in robot.joint_names]
    places, dofs = ([*range(base), *(base + at for at in order)] for base in (7, 6))
    damping = np.array([0.0] * 6 + [tree.joints[joint].damping for joint in robot.joint_names])
    assert damping.any()
    for number in (0, 9):
        qpos, qvel = trial.qpos[number, places], trial.qvel[number, dofs]
        config = pa.Configuration(robot, qpos, qvel)
        mass = behaviour["mass matrix"][number][np.ix_(dofs, dofs)]
        np.testing.assert_allclose(mass, config.mass_matrix(), atol=1e-12)
        np.testing.assert_allclose(behaviour["gravity"][number][dofs], config.gravity(), atol=1e-12)
        np.testing.assert_allclose(
            behaviour["bias forces"][number][dofs],
            config.bias_forces() + damping * qvel,
            atol=1e-12,
        )
        np.testing.assert_allclose(behaviour["com"][number], config.center_of_mass(), atol=1e-12)
        for index, joint in enumerate(tree.joints):
            position = behaviour["joint positions"][number][index]
            np.testing.assert_allclose(position, config.joint_position(joint), atol=1e-12)


def test_renamed_joint_keeps_its_place_in_the_tree() -> None:
    """Reference: the tree before; renamed and renamed back, it has equal parents."""
    tree, _ = kinematic_trees(load("v3"))
    renamed = rename_joints(tree, {"leg_front_l_2": "x"})
    assert renamed.joints["leg_front_l_3"].parent == "x"
    assert "x" in renamed.bodies
    back = rename_joints(renamed, {"x": "leg_front_l_2"})
    assert back.joints.keys() == tree.joints.keys()
    for name, joint in tree.joints.items():
        assert back.joints[name].parent == joint.parent


def test_fixed_joint_equals_the_reduced_model_of_pinocchio(tmp_path: Path) -> None:
    """A joint fixed at zero in the tree, and in Pinocchio's own reduced model."""
    path = tmp_path / "arm.urdf"
    path.write_text(urdf_text(arm(), FEET))
    model = pin.buildModelFromUrdf(str(path), pin.JointModelFreeFlyer())
    names = ["turn", "lift", "push"]
    tree = fix_joint(from_pinocchio(model, "base", names, {"rod": "rod"}), "lift")
    q = pin.neutral(model)
    reduced = pin.buildReducedModel(model, [model.getJointId("lift")], q)
    ours = to_pinocchio(tree)
    assert sorted(ours.names) == sorted([*reduced.names[:1], "__free__", "turn", "push"])
    for name in ("turn", "push"):
        first, second = (
            ours.inertias[ours.getJointId(name)],
            reduced.inertias[reduced.getJointId(name)],
        )
        assert first.isApprox(second, 1e-12)
        here = ours.jointPlacements[ours.getJointId(name)]
        assert here.isApprox(reduced.jointPlacements[reduced.getJointId(name)], 1e-12)


# ------------------------------------------------------------------------------------- git


@pytest.fixture
def repository(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a repository with a robot in a folder, whose MJCF has an include and a mesh."""
    monkeypatch.setenv("GIT_CONFIG_GLOBAL", os.devnull)
    for name in ("GIT_DIR", "GIT_WORK_TREE", "GIT_INDEX_FILE"):
        monkeypatch.delenv(name, raising=False)
    robots = tmp_path / "robots"
    (robots / "parts").mkdir(parents=True)
    (robots / "robot.urdf").write_text(urdf_text(ROBOT))
    text = mjcf_text(ROBOT, scene='<include file="parts/floor.xml"/>')
    text = text.replace(
        "<worldbody>", '<asset><mesh name="m" file="../meshes/m.obj"/></asset><worldbody>'
    )
    text = text.replace(
        '<site name="foot0"', '<geom type="mesh" mesh="m" mass="0.01"/><site name="foot0"'
    )
    (robots / "robot.xml").write_text(text)
    (robots / "parts" / "floor.xml").write_text(
        '<mujocoinclude><geom type="plane" size="1 1 1"/></mujocoinclude>'
    )
    (tmp_path / "meshes").mkdir()
    corners = ["0 0 0", "0.1 0 0", "0 0.1 0", "0 0 0.1"]
    faces = ["1 3 2", "1 2 4", "2 3 4", "1 4 3"]
    lines = [f"v {c}" for c in corners] + [f"f {f}" for f in faces]
    (tmp_path / "meshes" / "m.obj").write_text("\n".join(lines) + "\n")
    git(tmp_path, "init", "--quiet")
    git(tmp_path, "add", ".")
    who = ["-c", "user.name=a", "-c", "user.email=a@example.com"]
    git(tmp_path, *who, "commit", "--quiet", "--message", "robot")
    monkeypatch.chdir(robots)
    return robots


def git(folder: Path, *arguments: str) -> None:
    subprocess.run(["git", *arguments], cwd=folder, check=True)


def run(folder: Path, *arguments: str) -> Answer:
    return answer("diff", *arguments, folder=folder)


@pytest.mark.parametrize("given", ["HEAD:robots/robot.urdf", "HEAD:./robot.urdf"])
def test_a_revision_is_read_from_git(repository: Path, given: str) -> None:
    assert run(repository, given, "robot.urdf").returncode == 0
    text = (repository / "robot.urdf").read_text()
    (repository / "robot.urdf").write_text(text.replace('value="6.0"', 'value="6.5"'))
    line = text[: text.index('value="6.0"')].count("\n") + 1
    result = run(repository, given, "robot.urdf")
    assert result.returncode == 1
    assert f"DIFFERENT {given} and robot.urdf: base mass 6 -> 6.5 kg" in result.stdout
    assert f"HEAD:robots/robot.urdf:{line}   robot.urdf:{line}" in result.stdout


@pytest.mark.slow
def test_revision_uses_its_own_includes_and_meshes(repository: Path) -> None:
    """Not the files of the working tree, which are changed or deleted."""
    assert run(repository, "HEAD:./robot.xml", "robot.xml").returncode == 0
    (repository / "parts" / "floor.xml").unlink()
    assert run(repository, "HEAD:./robot.xml", "HEAD:robots/robot.xml").returncode == 0
    assert "note" not in run(repository, "HEAD:./robot.xml", "HEAD:./robot.xml").stdout
    result = run(repository.parent, "HEAD:robots/robot.xml", "HEAD:./robots/robot.xml")
    assert result.returncode == 0


@pytest.mark.parametrize("link", ["/etc/hosts", "../../outside.xml"])
def test_links_that_lead_out_of_a_revision_are_not_followed(repository: Path, link: str) -> None:
    (repository / "odd.xml").symlink_to(link)
    _commit_all(repository)
    assert run(repository, "@:./robot.urdf", "robot.urdf").returncode == 0


def test_xacro_of_a_revision_is_expanded_with_its_included_files(repository: Path) -> None:
    """Reference: the masses [kg] in the included file, at the revision and now."""
    pytest.importorskip("xacro")
    part, robot = repository / "mass.xacro", repository / "robot.urdf.xacro"
    space = 'xmlns:xacro="http://ros.org/wiki/xacro"'
    part.write_text(f'<robot {space}><xacro:property name="extra" value="0"/></robot>')
    text = urdf_text(ROBOT)
    mass = re.findall(r'<mass value="([^"]+)"', text)[0]
    text = text.replace("<robot", f"<robot {space}", 1)
    text = text.replace("<link", '<xacro:include filename="mass.xacro"/><link', 1)
    robot.write_text(text.replace(f'<mass value="{mass}"', f'<mass value="${{{mass} + extra}}"', 1))
    git(repository, "add", ".")
    _commit_all(repository)
    part.write_text(part.read_text().replace('"0"', '"2"'))
    found = pa.diff_models("HEAD:./robot.urdf.xacro", "robot.urdf.xacro", xacro=True)
    assert found.mass[1] - found.mass[0] == pytest.approx(2)
    with pytest.raises(pa.ModelError, match="--xacro"):
        pa.diff_models("HEAD:./robot.urdf.xacro", "robot.urdf.xacro")


def _commit_all(repository: Path) -> None:
    git(repository, "add", ".")
    git(repository, "-c", "user.name=a", "-c", "user.email=a@b.c", "commit", "-qm", "odd")


def test_file_with_the_name_of_a_revision_is_read_as_a_file(repository: Path) -> None:
    (repository / "HEAD:robot.urdf").write_text(urdf_text(change_part(ROBOT, "base", mass=9.0)))
    assert run(repository, "HEAD:robot.urdf", "robot.urdf").returncode == 1


REFUSED = {
    "a folder": ("HEAD:./", "HEAD:robots: the path is a folder"),
    "no such path": ("HEAD:./none.urdf", "git cannot read it: path 'robots/none.urdf' does not"),
    "no such revision": ("v9:./robot.urdf", "git cannot read it: "),
    "an option": ("--output=x:robot.urdf", "No such option"),
    "no such file": ("none.urdf", "no such file"),
    "another format": ("HEAD:./robot.xml", "format differs from robot.xml; crosscheck"),
}


@pytest.mark.parametrize(("given", "said"), REFUSED.values(), ids=REFUSED)
def test_invalid_version_is_refused(repository: Path, given: str, said: str) -> None:
    result = run(repository, given, "robot.urdf")
    assert result.returncode == cli.EXIT_BAD_INPUT
    assert result.stdout == ""
    assert said in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1


def test_revision_that_begins_with_a_dash_is_refused(repository: Path) -> None:
    with pytest.raises(pa.ModelError, match="'--output=x' is not a revision") as caught:
        pa.diff_models("--output=x:robot.urdf", "robot.urdf")
    assert str(pickle.loads(pickle.dumps(caught.value))) == str(caught.value)


def test_revision_is_refused_outside_a_repository_and_without_git(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    monkeypatch.chdir(tmp_path)
    with pytest.raises(pa.ModelError, match="not a git repository"):
        pa.diff_models("HEAD:a.urdf", "b.urdf")
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(pa.ModelError, match="git is not installed"):
        pa.diff_models("HEAD:a.urdf", "b.urdf")


RUNS = {
    "filter.x.clean": "sh -c 'touch {}; cat'",
    "filter.x.smudge": "sh -c 'touch {}; cat'",
    "core.fsmonitor": "touch {}",
    "core.sshCommand": "touch {}",
    "diff.external": "touch {}",
    "core.pager": "touch {}",
}
"""Commands that the configuration of a repository may let git execute."""


def test_no_code_of_a_repository_is_executed(repository: Path, tmp_path: Path) -> None:
    """Filters, hooks, monitors, transports: the folder may be somebody else's."""
    proof = tmp_path / "run"
    for key, command in RUNS.items():
        git(repository, "config", key, command.format(proof))
    (tmp_path / ".git" / "info" / "attributes").write_text("* filter=x\n")
    for hook in ("post-index-change", "post-checkout", "reference-transaction"):
        file = tmp_path / ".git" / "hooks" / hook
        file.write_text(f"#!/bin/sh\ntouch {proof}\n")
        file.chmod(0o755)
    git(repository, "status", "--porcelain")
    assert proof.exists(), "git itself runs none of them: this test is worth nothing"
    proof.unlink()
    os.utime(repository / "robot.urdf")  # so that git reads the file again
    assert run(repository, "HEAD:./robot.urdf", "robot.urdf").returncode == 0
    assert not proof.exists()


def test_file_of_git_lfs_is_read_from_its_store_or_refused(repository: Path) -> None:
    """The commit contains a pointer; the content is in the store of Git LFS, or absent."""
    urdf = repository / "robot.urdf"
    text = urdf.read_bytes()
    name = hashlib.sha256(text).hexdigest()
    pointer = f"version https://git-lfs.github.com/spec/v1\noid sha256:{name}\nsize {len(text)}\n"
    urdf.write_text(pointer)
    _commit_all(repository)
    urdf.write_bytes(text)
    assert run(repository, "HEAD:./robot.urdf", "robot.urdf").returncode == cli.EXIT_BAD_INPUT
    store = repository.parent / ".git" / "lfs" / "objects" / name[:2] / name[2:4]
    store.mkdir(parents=True)
    (store / name).write_bytes(text)
    assert run(repository, "HEAD:./robot.urdf", "robot.urdf").returncode == 0


# ------------------------------------------------------------------------------------- command


def test_a_link_without_mass_is_compared(tmp_path: Path) -> None:
    """The acceleration of a massless link is undefined; all other quantities are compared."""
    old = change_part(ROBOT, "shank2", mass=0.0)
    diff = diff_of(tmp_path, old, old, "urdf")
    assert diff.same
    assert diff.complete
    assert list_changes(diff_of(tmp_path, old, change_part(old, "base", mass=7.0), "urdf")) == [
        ("mass", "base")
    ]


def test_file_that_is_excluded_from_exports_is_read(repository: Path) -> None:
    (repository / ".gitattributes").write_text("*.urdf export-ignore\n")
    _commit_all(repository)
    assert run(repository, "HEAD:./robot.urdf", "robot.urdf").returncode == 0


@pytest.mark.slow
def test_changed_spec_in_memory_is_compared_with_its_file() -> None:
    """The caller changes a mass of the spec [kg]; the old value has a line, the new value none."""
    path = ROOT / "mjcf" / "pupper_v3.xml"
    spec = mujoco.MjSpec.from_file(str(path))
    assert pa.diff_models(path, spec).same
    spec.body("base_link").mass = 2.0
    found = pa.diff_models(path, spec.compile())
    [change] = found.changes
    assert (change.kind, change.element, change.new) == ("mass", "base_link", pytest.approx(2.0))
    assert change.old_place.endswith("pupper_v3_body.xml:3")
    assert (found.new, change.new_place) == ("<MjModel pupper_v3>", "<MjModel pupper_v3>")


@pytest.mark.parametrize("kind", ["urdf", "xml"])
def test_text_of_a_model_equals_its_file(kind: str, tmp_path: Path) -> None:
    text = TEXT[kind](ROBOT)
    file = tmp_path / f"robot.{kind}"
    file.write_text(text)
    assert pa.diff_models(file, text).same
    assert pa.diff_models(text, TEXT[kind](change_part(ROBOT, "thigh0", mass=9.0))).changes


def test_objects_of_two_formats_are_refused_in_one_line() -> None:
    text = urdf_text(ROBOT)
    with pytest.raises(pa.ModelError, match=r"<XML text>.*format differs.*<MjSpec") as error:
        pa.diff_models(mujoco.MjSpec.from_string(mjcf_text(ROBOT)), text)
    assert "\n" not in str(error.value)


def test_equal_versions_have_no_change(tmp_path: Path) -> None:
    write_both(tmp_path, urdf_text(ROBOT), urdf_text(ROBOT), "urdf")
    result = run(tmp_path, "old.urdf", "new.urdf")
    assert result.returncode == 0
    assert result.stdout.startswith("SAME old.urdf and new.urdf: no change\n")


def test_tolerance_of_diff_is_used_and_options_are_checked(tmp_path: Path) -> None:
    """A mass that differs by 1e-4 relative is no change with a tolerance of 1e-3."""
    new = change_part(ROBOT, "base", mass=6.0006)
    write_both(tmp_path, urdf_text(ROBOT), urdf_text(new), "urdf")
    assert run(tmp_path, "old.urdf", "new.urdf").returncode == 1
    assert run(tmp_path, "old.urdf", "new.urdf", "--tolerance", "mass=1e-3").returncode == 0
    for option, message in (
        (("--tolerance", "mas=1"), "unknown kind 'mas'"),
        (("--package", "x=nowhere"), "is not a folder"),
    ):
        result = run(tmp_path, "old.urdf", "new.urdf", *option)
        assert result.returncode == cli.EXIT_BAD_INPUT
        assert message in result.stderr


@pytest.mark.slow
def test_variants_are_compared_by_name() -> None:
    """v3-heavy has twice the mass of v3's torso; the answer contains no temporary path."""
    found = answer("diff", "v3", "v3-heavy", "-v")
    assert found.returncode == 1
    assert found.stdout.startswith("DIFFERENT v3 and v3-heavy: ")
    assert "mass 1.506 kg in the old file, 3.012 kg in the new file" in found.stdout
    assert "next: pupper-analysis stand v3-heavy" in found.stdout
    assert "v3-heavy.xml" not in found.stdout
    assert answer("diff", "v3", str(ROOT / "urdf" / "pupper_v3.urdf")).returncode == 0
    misspelled = answer("diff", "v3", "v3-heavvy")
    assert misspelled.returncode == 2
    assert "did you mean v3-heavy" in misspelled.stderr


@pytest.mark.slow
@pytest.mark.parametrize("name", ["urdf/pupper_v3.urdf", "mjcf/pupper_v3.xml"])
def test_file_has_no_change_to_itself(name: str) -> None:
    """Reference: 3.17 kg, and the joints of v3."""
    diff = pa.diff_models(ROOT / name, ROOT / name)
    assert diff.same
    assert diff.changes == ()
    assert diff.complete
    assert max(diff.deviations.values()) == 0
    assert diff.mass[0] == pytest.approx(3.17, abs=1e-3)
    assert all(old == new for old, new in diff.torques.values())
    assert set(diff.torques) == set(load("v3").joint_names)


@pytest.mark.parametrize("kind", ["urdf", "xml"])
def test_effort_of_both_versions_is_reported_with_its_line(tmp_path: Path, kind: str) -> None:
    diff = diff_of(tmp_path, ROBOT, change_part(ROBOT, "thigh1", effort=30.0), kind)
    changes = {change.kind: change for change in diff.changes}
    assert (changes["effort"].old, changes["effort"].new) == (21.0, 30.0)
    assert "30.0" in line_at(changes["effort"].new_place)


@pytest.mark.parametrize("kind", TEXT)
def test_changes_are_ordered_by_effect_and_explain_the_whole_deviation(
    tmp_path: Path, kind: str
) -> None:
    new = change_part(ROBOT, "base", mass=6.6)
    new = change_part(new, "shank0", position=(0, 0.08, -0.21))
    new = change_part(change_part(new, "thigh2", upper=0.8), "shank3", damping=0.1001)
    diff = diff_of(tmp_path, ROBOT, new, kind)
    assert list_changes(diff)[-2:] == [("upper limit", "hip2"), ("damping", "knee3")]
    assert set(list_changes(diff)[:2]) == {("mass", "base"), ("position", "knee0")}
    assert diff.complete
    assert max(diff.residual.values()) < 1e-12


@pytest.mark.parametrize("kind", TEXT)
def test_renamed_joint_is_a_change_and_its_values_are_compared(tmp_path: Path, kind: str) -> None:
    new = change_part(ROBOT, "shank2", joint="shin2", mass=0.3)
    diff = diff_of(tmp_path, ROBOT, new, kind)
    assert {("name", "knee2"), ("mass", "knee2")} <= set(list_changes(diff))
    assert ("joint", "knee2") not in list_changes(diff)
    (mass,) = (change for change in diff.changes if change.kind == "mass")
    assert '="0.3"' in line_at(mass.new_place)
    assert diff.complete


def test_longer_leg_changes_the_torque_of_its_hip_only(tmp_path: Path) -> None:
    """The torques of the knee and of another leg do not depend on the length of the thigh."""
    longer = change_part(ROBOT, "shank1", position=(0.0, 0.16, -0.4))
    diff = diff_of(tmp_path, ROBOT, longer, "urdf")
    for joint in ("knee1", "hip2"):
        assert diff.torques[joint][0] == pytest.approx(diff.torques[joint][1], rel=1e-12)
    assert diff.torques["hip1"][1] > diff.torques["hip1"][0]
    assert diff.mass[0] == pytest.approx(diff.mass[1])


def test_places_of_a_revision_contain_its_name(
    repository: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In both orders; the temporary folder of the revision is not shown."""
    monkeypatch.chdir(repository)
    Path("robot.urdf").write_text(urdf_text(change_part(ROBOT, "base", mass=7.0)))
    for names in (("HEAD:./robot.urdf", "robot.urdf"), ("robot.urdf", "HEAD:./robot.urdf")):
        (change,) = pa.diff_models(*names).changes
        places = [place.rpartition(":")[0] for place in (change.old_place, change.new_place)]
        assert ["HEAD:" in place for place in places] == ["HEAD:" in name for name in names]
        assert all(Path(place).name == "robot.urdf" for place in places)


def test_error_in_a_revision_states_its_name_and_line(repository: Path) -> None:
    text = (repository / "robot.urdf").read_text().replace('value="6.0"', 'value="heavy"')
    (repository / "robot.urdf").write_text(text)
    line = text[: text.index('value="heavy"')].count("\n") + 1
    _commit_all(repository)
    result = run(repository, "HEAD:./robot.urdf", "HEAD~1:./robot.urdf")
    assert result.returncode == cli.EXIT_BAD_INPUT
    assert result.stderr.startswith(f"error: HEAD:robots/robot.urdf:{line}: ")


def test_robot_without_joints_is_compared(tmp_path: Path) -> None:
    alone = {"base": ROBOT["base"]}
    diff = diff_of(tmp_path, alone, change_part(alone, "base", mass=7.0), "urdf")
    assert list_changes(diff) == [("mass", "base")]
    assert diff.complete
    assert diff.torques == {}
    assert "joint positions" not in diff.deviations


def test_robots_of_one_link_without_mass_are_compared(tmp_path: Path) -> None:
    """Neither a mass nor a joint confirms the base frame."""
    for name in ("old.urdf", "new.urdf"):
        (tmp_path / name).write_text('<robot name="r"><link name="a"/></robot>')
    diff = pa.diff_models(tmp_path / "old.urdf", tmp_path / "new.urdf")
    assert list_changes(diff) == []


def test_rotated_link_frames_are_no_change(tmp_path: Path) -> None:
    """The frames of all links are turned at random; the robot is the same."""
    text = mjcf_text(ROBOT)
    diff = pa.diff_models(*write_both(tmp_path, text, turned_frames(ROBOT, seed=3), "xml"))
    assert list_changes(diff) == []
    assert diff.complete
    assert max(diff.deviations.values()) < 1e-9


@pytest.mark.slow
def test_command_prints_changes_and_torques(tmp_path: Path) -> None:
    """By hand: the knee carries the shank alone, whose mass is twice as large."""
    new = change_part(change_part(ROBOT, "shank0", mass=0.4), "thigh3", upper=0.8)
    write_both(tmp_path, urdf_text(ROBOT), urdf_text(new), "urdf")
    result = run(tmp_path, "old.urdf", "new.urdf", "-v", "--json", "diff.json")
    assert result.returncode == 1
    assert "DIFFERENT old.urdf and new.urdf: 2 changes" in result.stdout
    assert "1. link shank0: mass 0.2 kg in the old file, 0.4 kg in the new file" in result.stdout
    content = json.loads((tmp_path / "diff.json").read_text())
    before, after = content["torques"]["knee0"]
    assert after == pytest.approx(2 * before, rel=1e-9)
    lines = result.stdout.splitlines()
    row = next(line for line in lines if line.startswith("knee0"))
    assert row.split() == ["knee0", f"{before:.4g}", f"{after:.4g}", "+100", "%"]
    assert not any(line.startswith("knee1") for line in lines)
    assert content["same"] is False


BALL = """<mujoco><worldbody><body name="base"><freejoint/><geom size="0.1"/>
<body name="arm" pos="0.2 0 0">{joint}<geom size="0.05" pos="0 0 -0.2"/>
<body name="fore" pos="0 0 -0.2"><joint name="elbow" axis="0 1 0"/><geom size="0.05"/></body>
</body></body></worldbody></mujoco>"""


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('<joint name="j" type="ball"/>', "", "type ball in the old file, none in the new"),
        ("", '<joint name="j" type="ball"/>', "none in the old file, type ball in the new"),
        (
            '<joint name="j" type="ball"/>',
            '<joint name="j" axis="1 0 0"/>',
            "type ball in the old file, type hinge in the new",
        ),
        (
            '<joint name="j" type="ball"/>',
            '<joint name="j" type="ball" damping="2" range="0 90"/>',
            "nothing in the old file, damping 2, range 1.5708 in the new",
        ),
    ],
)
def test_changed_ball_joint_is_named(tmp_path: Path, old: str, new: str, told: str) -> None:
    """The trees of both versions hold ball joints at rest, and are equal."""
    files = tmp_path / "old.xml", tmp_path / "new.xml"
    for file, joint in zip(files, (old, new), strict=True):
        file.write_text(BALL.format(joint=joint))
    diff = pa.diff_models(*files)
    first = next(change for change in diff.changes if change.element == "j")
    assert told in str(first.diagnostic)
    place = files[0] if old else files[1]
    assert f"{place.name}:2" in (first.old_place + first.new_place)
    assert pa.diff_models(files[1], files[1]).same


@pytest.mark.parametrize(
    ("old", "new"), [("floating", "fixed"), ("planar", "floating"), ("revolute", "floating")]
)
def test_changed_joint_that_a_tree_cannot_move_is_named(tmp_path: Path, old: str, new: str) -> None:
    inertial = (
        '<inertial><mass value="1"/>'
        '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    )
    links = "".join(f'<link name="{name}">{inertial}</link>' for name in "abc")
    limit = '<limit lower="-1" upper="1" effort="3" velocity="3"/>'
    joint = '<joint name="{}" type="{}"><parent link="{}"/><child link="{}"/>{}</joint>'
    files = tmp_path / "old.urdf", tmp_path / "new.urdf"
    for file, kind in zip(files, (old, new), strict=True):
        middle = joint.format("j", kind, "a", "b", limit if kind == "revolute" else "")
        file.write_text(
            f'<robot name="r">{links}{middle}'
            f"{joint.format('k', 'revolute', 'b', 'c', limit)}</robot>"
        )
    diff = pa.diff_models(*files)
    assert not diff.same
    assert [change.element for change in diff.changes] == ["j"]
    assert pa.diff_models(files[0], files[0]).same
