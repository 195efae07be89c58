"""Files as they are found in the wild: other endings, pointers for meshes, blocks of MuJoCo's."""

from __future__ import annotations

from pathlib import Path

import pytest

from pupper_analysis.base.errors import ModelError
from pupper_analysis.models.mjcf_file import read_mjcf
from pupper_analysis.models.urdf_file import MAX_DEPTH, read_urdf
from pupper_analysis.tools.audit.audit import audit_model
from pupper_analysis.tools.crosscheck.crosscheck import URDF_MUJOCO, compare_models
from tests.support.robots import (
    Files,
    changed,
    compared,
    found,
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


def test_a_urdf_with_a_block_for_mujoco_keeps_its_column(tmp_path: Path) -> None:
    block = '<mujoco><compiler meshdir="meshes" balanceinertia="true"/></mujoco></robot>'
    comparison = compared(write(tmp_path, URDF.replace("</robot>", block), MJCF))
    assert comparison.agree
    assert not [note for note in comparison.check.notes if URDF_MUJOCO in str(note)]
    assert "engines (URDF)" in comparison.check.quantities[0].edges


def test_an_mjcf_may_be_called_so(tmp_path: Path) -> None:
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
    files = Files(tmp_path / "robot.urdf", tmp_path / "robot.mjcf")
    files.urdf.write_text(URDF)
    files.mjcf.write_text(text)
    model = read_mjcf(files.mjcf).model
    assert model.opt.timestep == 0.003
    assert model.nmesh == 1
    assert compared(files).agree


def test_pointers_of_git_lfs_are_missing_meshes(tmp_path: Path) -> None:
    (tmp_path / "shell.stl").write_text(POINTER)
    text = MJCF.replace(
        "<worldbody>", '<asset><mesh name="shell" file="shell.stl"/></asset><worldbody>'
    ).replace("<freejoint/>", '<freejoint/><geom type="mesh" mesh="shell" contype="0"/>')
    comparison = compared(write(tmp_path, URDF, text))
    assert comparison.agree
    values = {note.code: note for note in comparison.notes if not isinstance(note, str)}
    assert values["files-are-lfs-pointers"].values["files"] == ("shell.stl",)
    (finding,) = [
        f for f in audit_model(tmp_path / "robot.xml").findings if f.rule == "mesh-missing"
    ]
    assert "is a pointer of Git LFS, not the mesh: git lfs pull brings it" in finding.message


# ------------------------------------------------------------------------------------- unstated


def without_damping(text: str) -> str:
    return text.replace('damping="0.1" ', "")


def test_damping_that_the_urdf_does_not_state_is_a_note(tmp_path: Path) -> None:
    files = write(tmp_path, without_damping(URDF), MJCF)
    comparison = compared(files)
    assert comparison.agree
    (note,) = [str(note) for note in comparison.notes if str(note).startswith("damping")]
    assert note.startswith("damping (0.1 N m s/rad on 8 joints) is stated by")
    strict = compare_models(*files, configurations=2, strict_names=True)
    assert {kind for kind, _ in found(strict)} == {"damping"}
    assert not strict.agree


def test_gravity_that_is_rounding_is_no_deviation(tmp_path: Path) -> None:
    """A table with two upright axes: gravity does nothing, and its ratio means nothing."""
    from tests.support.robots import Part

    parts = {
        "base": Part("base", mass=2.0),
        "one": Part("one", "base", "j1", position=(0, 0, 0.3), axis=(0, 0, 1), com=(0.1, 0, 0)),
        "two": Part("two", "one", "j2", position=(0.2, 0, 0), axis=(0, 0, 1), com=(0.1, 0, 0)),
    }
    mjcf = changed(parts, "two", com=(0.1, 0.0, 0.00002), quaternion=(1.0, 1e-12, 0.0, 0.0))
    comparison = compared(write(tmp_path, urdf_text(parts), mjcf_text(mjcf, free=False)))
    assert comparison.deviations["gravity"] < 1e-3
    assert all(q.relative < 1e-3 for q in comparison.check.quantities if q.name == "gravity")


@pytest.mark.parametrize("begin", [0.0, 0.5, 0.99])
def test_the_longest_chain_is_read_in_any_order(begin: float, tmp_path: Path) -> None:
    """250 joints in a row are; one more is not, wherever in the file it stands."""
    for count in (MAX_DEPTH, MAX_DEPTH + 1):
        links = [f'<link name="l{number}"/>' for number in range(count + 1)]
        joints = [
            f'<joint name="j{number}" type="fixed"><parent link="l{number}"/>'
            f'<child link="l{number + 1}"/></joint>'
            for number in range(count)
        ]
        first = int(begin * count)  # chains that are looked at later end at those looked at before
        path = tmp_path / f"{count}.urdf"
        turned = "".join([*links[first:], *links[:first], *joints])
        path.write_text(f'<robot name="r">{turned}</robot>')
        if count == MAX_DEPTH:
            assert len(read_urdf(path).root.findall("link")) == count + 1
        else:
            with pytest.raises(ModelError, match="more than 250 joints"):
                read_urdf(path)
