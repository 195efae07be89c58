"""Unusual files of public robots: MuJoCo blocks in URDFs, Git LFS pointers in place of meshes, long
chains.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from pupper_analysis.base.errors import ModelError
from pupper_analysis.models.mjcf_file import read_mjcf
from pupper_analysis.models.urdf_file import MAX_DEPTH, read_urdf
from pupper_analysis.tools.audit.audit import audit_model
from pupper_analysis.tools.crosscheck.crosscheck import URDF_MUJOCO, compare_models
from tests.support.robots import (
    Part,
    change_part,
    compare_files,
    list_differences,
    mjcf_text,
    quadruped,
    urdf_text,
    write,
)

URDF, MJCF = urdf_text(quadruped()), mjcf_text(quadruped())
POINTER = (
    "version https://git-lfs.github.com/spec/v1\n"
    "oid sha256:4665a5ea423c2713d436b5ee50593a9640e0018c1550b5a0002f74190d6caea8\nsize 12345\n"
)


def test_urdf_with_a_mujoco_block_is_compared_in_mujoco(tmp_path: Path) -> None:
    block = '<mujoco><compiler meshdir="meshes" balanceinertia="true"/></mujoco></robot>'
    comparison = compare_files(write(tmp_path, URDF.replace("</robot>", block), MJCF))
    assert comparison.agree
    assert not [note for note in comparison.check.notes if URDF_MUJOCO in str(note)]
    assert "engines (URDF)" in comparison.check.quantities[0].edge_deviations


def test_file_with_the_ending_mjcf_is_read_with_its_parts(tmp_path: Path) -> None:
    """The included file and the mesh are found beside it."""
    (tmp_path / "part.xml").write_text('<mujocoinclude><option timestep="0.003"/></mujocoinclude>')
    mesh = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "shell.obj").write_bytes(mesh)
    text = MJCF.replace(
        "<worldbody>",
        '<include file="part.xml"/><asset><mesh name="shell" file="shell.obj"/></asset><worldbody>',
    )
    text = text.replace('angle="radian"', 'angle="radian" meshdir="meshes"')
    text = text.replace("<freejoint/>", '<freejoint/><geom type="mesh" mesh="shell" mass="0"/>')
    (tmp_path / "robot.urdf").write_text(URDF)
    (tmp_path / "robot.mjcf").write_text(text)
    model = read_mjcf(tmp_path / "robot.mjcf").model
    assert model.opt.timestep == 0.003
    assert model.nmesh == 1
    assert compare_models(tmp_path / "robot.urdf", tmp_path / "robot.mjcf").agree


@pytest.mark.parametrize("suffixes", [(".URDF", ".XML"), (".XACRO", ".Mjcf")])
def test_suffix_in_capitals_is_that_of_the_same_format(
    tmp_path: Path, suffixes: tuple[str, str]
) -> None:
    """MuJoCo's loader of files accepts ``.XML``, its parser of specs only ``.xml``."""
    urdf, mjcf = (tmp_path / f"robot{suffix}" for suffix in suffixes)
    urdf.write_text(URDF)
    mjcf.write_text(MJCF)
    assert compare_models(urdf, mjcf).agree
    assert audit_model(mjcf).passed


def test_pointers_of_git_lfs_are_missing_meshes(tmp_path: Path) -> None:
    (tmp_path / "shell.stl").write_text(POINTER)
    asset = '<asset><mesh name="shell" file="shell.stl"/></asset><worldbody>'
    seen = '<freejoint/><geom type="mesh" mesh="shell" contype="0"/>'
    text = MJCF.replace("<worldbody>", asset).replace("<freejoint/>", seen)
    comparison = compare_files(write(tmp_path, URDF, text))
    assert comparison.agree
    values = {note.code: note for note in comparison.notes if not isinstance(note, str)}
    assert values["files-missing"].values["files"] == ("shell.stl",)
    findings = audit_model(tmp_path / "robot.xml").findings
    (finding,) = (finding for finding in findings if finding.rule == "mesh-missing")
    assert "is a pointer of Git LFS, not a mesh: git lfs pull downloads the mesh" in finding.message


# ------------------------------------------------------------------------------------- unstated


@pytest.mark.parametrize("begin", [0.0, 0.5, 0.99])
def test_chain_of_joints_is_limited_to_250_in_any_order_of_links(
    begin: float, tmp_path: Path
) -> None:
    """250 joints are read; 251 are refused, wherever the first link is in the file."""
    for count in (MAX_DEPTH, MAX_DEPTH + 1):
        links = [f'<link name="l{number}"/>' for number in range(count + 1)]
        joints = [
            f'<joint name="j{number}" type="fixed"><parent link="l{number}"/>'
            f'<child link="l{number + 1}"/></joint>'
            for number in range(count)
        ]
        first = int(begin * count)  # later chains end at links of chains that were followed before
        path = tmp_path / f"{count}.urdf"
        turned = "".join([*links[first:], *links[:first], *joints])
        path.write_text(f'<robot name="r">{turned}</robot>')
        if count == MAX_DEPTH:
            assert len(read_urdf(path).root.findall("link")) == count + 1
        else:
            with pytest.raises(ModelError, match="more than 250 joints"):
                read_urdf(path)


def test_gravity_of_vertical_axes_is_no_deviation(tmp_path: Path) -> None:
    """A table with two vertical axes: ratios of rounding errors are ignored."""
    parts = {
        "base": Part("base", mass=2.0),
        "one": Part("one", "base", "j1", position=(0, 0, 0.3), axis=(0, 0, 1), com=(0.1, 0, 0)),
        "two": Part("two", "one", "j2", position=(0.2, 0, 0), axis=(0, 0, 1), com=(0.1, 0, 0)),
    }
    mjcf = change_part(parts, "two", com=(0.1, 0.0, 0.00002), quaternion=(1.0, 1e-12, 0.0, 0.0))
    comparison = compare_files(write(tmp_path, urdf_text(parts), mjcf_text(mjcf, free=False)))
    assert comparison.deviations["gravity"] < 1e-3
    assert all(q.relative < 1e-3 for q in comparison.check.quantities if q.name == "gravity")


def test_gyro_and_accelerometer_of_one_site_are_the_imu(tmp_path: Path) -> None:
    """Another site has both sensors, too, and is listed first."""
    imu = '<link name="imu"/><joint name="to_imu" type="fixed"><origin xyz="0.1 0.02 0.03"/>'
    urdf = URDF.replace(
        "</robot>", imu + '<parent link="base"/><child link="imu"/></joint></robot>'
    )
    sites = '<site name="a" pos="-0.2 0 0"/><site name="imu" pos="0.1 0.02 0.03"/>'
    order = [("a", "gyro"), ("imu", "accelerometer"), ("a", "accelerometer"), ("imu", "gyro")]
    sensors = "".join(f'<{kind} site="{site}"/>' for site, kind in order)
    mjcf = MJCF.replace("<freejoint/>", "<freejoint/>" + sites)
    mjcf = mjcf.replace("</mujoco>", f"<sensor>{sensors}</sensor></mujoco>")
    comparison = compare_files(write(tmp_path, urdf, mjcf))
    assert comparison.agree
    (check,) = [q for q in comparison.check.quantities if q.name == "accelerometer"]
    assert check.relative < 1e-9


def test_zero_damping_of_the_urdf_is_a_difference(tmp_path: Path) -> None:
    comparison = compare_files(write(tmp_path, URDF.replace('damping="0.1"', 'damping="0"'), MJCF))
    assert {kind for kind, _ in list_differences(comparison)} == {"damping"}


def test_damping_that_the_urdf_does_not_state_is_a_note(tmp_path: Path) -> None:
    files = write(tmp_path, URDF.replace('damping="0.1" ', ""), MJCF)
    comparison = compare_files(files)
    assert comparison.agree
    (note,) = [str(note) for note in comparison.notes if str(note).startswith("damping")]
    assert "0.1 N m s/rad" in note


def test_differences_are_ordered_by_their_effect(tmp_path: Path) -> None:
    """An effort of a third of the other, and 1 g of 6 kg."""
    mjcf = change_part(change_part(quadruped(), "base", mass=6.001), "shank0", effort=7.0)
    found = list_differences(compare_files(write(tmp_path, URDF, mjcf_text(mjcf))))
    assert [kind for kind, _ in found] == ["effort", "mass"]
