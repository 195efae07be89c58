"""Given numbers are written into both files, each in its own frames; both engines read them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest

import pupper_analysis as pa
from pupper_analysis.base.files import write_all
from pupper_analysis.models.mjcf_file import read_mjcf
from pupper_analysis.models.urdf_file import read_urdf
from pupper_analysis.robot.matching.match import match_models
from pupper_analysis.robot.matching.tolerances import Tolerances
from pupper_analysis.tools.sync.numbers import WrittenNumbers, write_numbers
from tests.support.robots import (
    Files,
    Part,
    Parts,
    change_part,
    mjcf_text,
    quadruped,
    turned_frames,
    urdf_text,
    write,
)

SERVO = '<position kp="20" kv="0.5" gear="2"'


def robot_of(files: Files) -> pa.Robot:
    return match_models(read_urdf(files.urdf), read_mjcf(files.mjcf)).robot


def in_folder(written: WrittenNumbers, folder: Path) -> Files:
    write_all(written.make_writings(folder))
    assert written.urdf is not None
    assert written.mjcf is not None
    return Files(folder / written.urdf, folder / written.mjcf)


def differences(files: Files) -> set[tuple[str, str]]:
    found = pa.compare_models(
        files.urdf, files.mjcf, configurations=1, tolerances=Tolerances.strict()
    )
    return {(difference.kind, difference.element) for difference in found.differences}


def in_urdf(path: Path, link: str) -> pin.Inertia:
    """Return Pinocchio's inertia of a link with all links fixed to it."""
    model = pin.buildModelFromXML(path.read_text(), pin.JointModelFreeFlyer())
    frame = model.frames[model.getFrameId(link, pin.FrameType.BODY)]
    return frame.placement.actInv(model.inertias[frame.parentJoint])


def other_lines(one: Path, two: Path) -> int:
    lines = zip(one.read_text().splitlines(), two.read_text().splitlines(), strict=True)
    return sum(a != b for a, b in lines)


@pytest.fixture
def turned(tmp_path: Path) -> Files:
    """Write a pair whose MJCF has other link frames than the URDF, and geared servos."""
    text = turned_frames(quadruped(), 4).replace("<motor", SERVO)
    return write(tmp_path, urdf_text(quadruped()), text)


@pytest.fixture
def plain(tmp_path: Path) -> Files:
    """Return a pair in the same frames."""
    text = mjcf_text(quadruped()).replace("<motor", SERVO)
    return write(tmp_path, urdf_text(quadruped()), text)


@pytest.mark.slow
def test_numbers_go_into_both_files_in_their_own_frames(turned: Files, tmp_path: Path) -> None:
    """References: inertias of Pinocchio's model [kg, m, kg m^2], and damping, friction, armature
    and gains of MuJoCo's; servo gains count with the gear squared, 4. Seven lines of each file
    change.
    """
    tensor = np.array([[1.6e-3, 2e-5, -1e-5], [2e-5, 1.5e-3, 3e-6], [-1e-5, 3e-6, 4e-4]])
    numbers = {
        ("mass", "base"): 7.25,
        ("com", "base"): (0.02, -0.004, 0.001),
        ("com", "shank2"): (0.001, 0.003, -0.1),
        ("inertia", "shank2"): tensor,
        ("damping", "knee1"): 0.07,
        ("friction", "hip0"): 0.31,
        ("armature", "hip3"): 0.017,
        ("kp", "hip1"): 90.0,
        ("kd", "knee2"): 2.5,
    }
    written = write_numbers(robot_of(turned), numbers)
    new = in_folder(written, tmp_path / "fitted")
    base, shank = in_urdf(new.urdf, "base"), in_urdf(new.urdf, "shank2")
    old = in_urdf(turned.urdf, "base")
    assert base.mass == pytest.approx(7.25, rel=1e-12)
    np.testing.assert_allclose(base.lever, (0.02, -0.004, 0.001), atol=1e-12)
    np.testing.assert_allclose(base.inertia, old.inertia * 7.25 / 6.0, atol=1e-12)  # as dense
    np.testing.assert_allclose(shank.lever, (0.001, 0.003, -0.1), atol=1e-12)
    np.testing.assert_allclose(shank.inertia, tensor, atol=1e-12)
    model = mujoco.MjModel.from_xml_path(str(new.mjcf))
    dof = {name: model.joint(name).dofadr[0] for name in ("knee1", "hip0", "hip3")}
    assert model.dof_damping[dof["knee1"]] == pytest.approx(0.07)
    assert model.dof_frictionloss[dof["hip0"]] == pytest.approx(0.31)
    assert model.dof_armature[dof["hip3"]] == pytest.approx(0.017)
    gains = {
        model.joint(int(model.actuator_trnid[i, 0])).name: (
            4 * model.actuator_gainprm[i, 0], -4 * model.actuator_biasprm[i, 2],
        )
        for i in range(model.nu)
    }  # fmt: skip
    assert gains["hip1"] == pytest.approx((90.0, 2.0))
    assert gains["knee2"] == pytest.approx((80.0, 2.5))
    assert gains["hip2"] == pytest.approx((80.0, 2.0))
    assert {kind for kind, _ in differences(new)} <= {"effort", "armature"}  # as before
    assert other_lines(turned.urdf, new.urdf) == 7
    assert other_lines(turned.mjcf, new.mjcf) == 7


def shank_of_three(thin: float) -> Parts:
    """Return a quadruped with two heavy thin rods fixed to a shank.

    The inertials of shank and rods cannot absorb a large change.
    """
    rod = Part("rod", "shank0", "to_rod", "fixed", (0.0, 0.01, -0.1), mass=0.3)
    rod = replace(rod, inertia=(thin, 1e-3, 1e-3, 0, 0, 0), com=(0.05, 0.0, 0.0))
    other = replace(rod, link="other", joint="to_other", position=(0.0, -0.02, -0.05))
    return {**change_part(quadruped(), "shank0", mass=0.05), "rod": rod, "other": other}


def test_change_of_merged_links_is_written_to_one_link_or_refused(tmp_path: Path) -> None:
    """Reference: mass, CoM and inertia of the merged links in Pinocchio's model."""
    parts = shank_of_three(1e-6)
    files = write(tmp_path, urdf_text(parts), mjcf_text(parts))
    old = in_urdf(files.urdf, "shank0")
    new = in_folder(write_numbers(robot_of(files), {("mass", "shank0"): 1.2 * old.mass,
                    ("inertia", "shank0"): 2 * old.inertia}), tmp_path / "fitted")  # fmt: skip
    after = in_urdf(new.urdf, "shank0")
    assert after.mass == pytest.approx(1.2 * old.mass)
    np.testing.assert_allclose(after.lever, old.lever, atol=1e-12)
    np.testing.assert_allclose(after.inertia, 2 * old.inertia, atol=1e-12)
    assert not differences(new)
    with pytest.raises(
        pa.ModelError, match="mass knee0: no change of a single body gives the correct sum"
    ):
        write_numbers(robot_of(files), {("mass", "shank0"): 0.6 * old.mass})


def test_unwritable_number_is_named_and_no_file_is_changed(plain: Files, tmp_path: Path) -> None:
    text = plain.mjcf.read_text()
    plain.mjcf.write_text(text.replace(f'{SERVO} name="m_hip1"', '<motor name="m_hip1"'))
    with pytest.raises(pa.ModelError) as refused:
        write_numbers(robot_of(plain), {("kp", "hip1"): 5.0, ("mass", "base"): 5.0})
    assert "kp hip1: no unique gain: the MJCF drives this joint by" in str(refused.value)
    with pytest.raises(pa.UnknownNameError, match="shank9"):
        write_numbers(robot_of(plain), {("mass", "shank9"): 5.0})
    with pytest.raises(pa.OutputError):
        in_folder(write_numbers(robot_of(plain), {("mass", "base"): 5.0}), tmp_path)
    heavier = robot_of(plain)
    plain.urdf.write_text(plain.urdf.read_text().replace('mass value="6.0"', 'mass value="6.5"'))
    with pytest.raises(pa.ModelError) as refused:
        write_numbers(heavier, {("friction", "knee1"): 0.05})  # these are another robot's files
    assert refused.value.cause.code == "robot-is-not-its-files"


def test_unknown_kind_of_number_is_refused_by_name(plain: Files) -> None:
    """`frictionloss` is the word of an MJCF; the kind is `friction`, as the error lists."""
    with pytest.raises(pa.UnknownNameError, match="frictionloss") as refused:
        write_numbers(robot_of(plain), {("frictionloss", "knee1"): 0.05, ("mass", "base"): 5.0})
    assert "friction" in refused.value.known


def test_files_of_a_variant_are_found_from_their_copies(tmp_path: Path) -> None:
    """Of includes, default classes, meshes of another folder."""
    robot = pa.load_variant("v3")
    joint = robot.joint_names[0]
    numbers = {("mass", robot.base): 2.0, ("kp", joint): 6.5, ("friction", joint): 0.04}
    written = write_numbers(robot, numbers)
    new = in_folder(written, tmp_path)
    model = mujoco.MjModel.from_xml_path(str(new.mjcf))
    assert model.body_mass[model.body(robot.mj_base).id] == 2.0
    assert model.dof_frictionloss[model.joint(joint).dofadr[0]] == 0.04
    assert sorted(set(model.actuator_gainprm[:, 0])) == [5.0, 6.5]
    assert in_urdf(new.urdf, robot.base).mass == 2.0
    urdf = read_urdf(new.urdf)
    meshes = {mesh.get("filename") for mesh in urdf.root.iter("mesh")}
    found = [urdf.resolve_mesh(name) for name in meshes]
    assert meshes
    assert all(path is not None and tmp_path in path.parents for path in found)


def test_numbers_of_a_single_file_robot_are_written_to_that_file(
    plain: Files, tmp_path: Path
) -> None:
    for path, converted in ((plain.urdf, "mjcf"), (plain.mjcf, "urdf")):
        robot = robot_of(plain)
        alone = replace(robot, description=replace(robot.description, converted=converted))
        written = write_numbers(alone, {("mass", "thigh1"): 1.75})
        write_all(written.make_writings(tmp_path / converted))
        assert list(written.contents) == [Path(path.name)]
    assert in_urdf(tmp_path / "mjcf" / "robot.urdf", "thigh1").mass == 1.75
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "urdf" / "robot.xml"))
    assert model.body("thigh1").mass[0] == 1.75
