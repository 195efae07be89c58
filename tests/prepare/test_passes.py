"""Preparation passes of a pair of files: order, notes and effects of single passes."""

from __future__ import annotations

import gc
from pathlib import Path

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.models.mjcf_file import read_mjcf
from pupper_analysis.models.urdf_file import read_urdf
from pupper_analysis.prepare.passes import PREPARATION_PASSES, LoadRequest, PassRun, prepare_robot
from pupper_analysis.stance.stand import stand_statics
from tests.support.legged import BIPED_FEET, Pair, biped, quadruped, rewrite_file, sole_mesh


def prepare_pair(pair: Pair, **options: object) -> tuple[pa.Robot, list[PassRun]]:
    return prepare_robot(read_urdf(pair.urdf), read_mjcf(pair.mjcf), LoadRequest(**options))  # type: ignore[arg-type]


def test_pass_names_are_distinct_and_files_are_unchanged(tmp_path: Path) -> None:
    """The spec in memory and both files are equal to the last byte after preparation.

    The pass ``remove-free-joint-friction`` changes the dry friction of the robot's free joint only.
    """
    assert len({preparation_pass.name for preparation_pass in PREPARATION_PASSES}) == len(
        PREPARATION_PASSES
    )
    pair = quadruped(tmp_path)
    rewrite_file(pair.mjcf, ("<freejoint/>", '<joint type="free" frictionloss="0.3"/>'))
    before = (pair.urdf.read_bytes(), pair.mjcf.read_bytes())
    mjcf = read_mjcf(pair.mjcf)
    bodies = mjcf.spec.to_xml()
    prepare_robot(read_urdf(pair.urdf), mjcf, LoadRequest())
    assert mjcf.spec.to_xml() == bodies
    assert (pair.urdf.read_bytes(), pair.mjcf.read_bytes()) == before


def test_each_note_is_reported_by_one_preparation_step(tmp_path: Path) -> None:
    """Notes of the robot begin with the notes of all passes, in order."""
    robot, runs = prepare_pair(quadruped(tmp_path))
    done = {run.name: [note.code for note in run.done] for run in runs}
    assert done["level-ground"] == ["ground-added"]
    assert done["find-feet"] == ["feet-found"]
    assert done["find-start-pose"][-1].startswith("start-pose")
    assert done["add-servos"][0] == "servos-added"
    assert done["free-base"] == done["narrow-limits"] == done["choose-solver"] == []
    of_passes = [note for run in runs for note in run.done]
    assert list(robot.notes[: len(of_passes)]) == of_passes


def test_base_without_feet_is_held_as_in_the_file(tmp_path: Path) -> None:
    """The robot is built with a fixed base, and the note gives the missing feet as the reason."""
    robot, runs = prepare_pair(quadruped(tmp_path, foot="", free=False, keyframe=""))
    assert not robot.floating
    assert runs[-1].name == "fix-base"
    (held,) = runs[-1].done
    assert (held.code, held.values["why"].code) == ("base-kept-in-the-world", "no-feet-found")
    assert "build-with-fixed-base" in {run.name for run in runs}
    assert "find-feet" not in {run.name for run in runs}


def test_a_requested_fixed_base_gets_no_ground(tmp_path: Path) -> None:
    """With a free base, the pass ``level-ground`` adds a floor to the same files."""
    robot, runs = prepare_pair(quadruped(tmp_path), fixed_base=True)
    names = {run.name for run in runs}
    assert not robot.floating
    assert "build-with-fixed-base" in names
    assert "level-ground" not in names


def test_a_free_base_without_feet_is_refused(tmp_path: Path) -> None:
    pair = quadruped(tmp_path, foot="", free=True, keyframe="")
    with pytest.raises(pa.ModelError, match="no feet were found"):
        prepare_pair(pair)


def test_nothing_is_added_with_as_is(tmp_path: Path) -> None:
    """The actuators of MuJoCo's model remain torque motors."""
    robot, runs = prepare_pair(quadruped(tmp_path), as_is=True)
    names = {run.name for run in runs}
    assert not names & {
        "add-servos",
        "add-loop-motors",
        "exclude-overlaps",
        "disable-shapes-beside-feet",
    }
    motors = robot.mj_model.actuator_biastype == mujoco.mjtBias.mjBIAS_NONE.value
    assert motors.all()


@pytest.mark.slow
def test_mesh_soles_keep_their_contacts_with_as_is(tmp_path: Path) -> None:
    """Reference: the geoms of the file. Without as_is, 16 balls replace the two meshes."""
    pair = sole_mesh(biped(tmp_path), BIPED_FEET["box"])
    robot = pa.load_robot(*pair, as_is=True)
    published = mujoco.MjModel.from_xml_path(str(pair.mjcf))
    assert not any(note.code == "balls-for-soles" for note in robot.notes)
    assert robot.mj_model.ngeom == published.ngeom + 1  # the floor is added
    meshes = robot.mj_model.geom_type == mujoco.mjtGeom.mjGEOM_MESH.value
    assert meshes.sum() == 2
    assert robot.mj_model.geom_contype[meshes].all()
    assert set(robot.foot_geoms) == set(np.flatnonzero(meshes).tolist())
    stand = pa.solve_stand(robot)
    assert stand.foot_error < 1e-6
    assert len(stand_statics(robot, stand).contact_forces) == 16


@pytest.mark.slow
def test_existing_site_with_the_name_of_a_foot_is_not_changed(tmp_path: Path) -> None:
    """A file that was saved from memory has such sites, and may have been moved since."""
    pair = quadruped(tmp_path)
    plain = pa.load_robot(pair.urdf, pair.mjcf)
    point, (link, frame) = next(iter(plain.description.contact_points.items()))
    assert link == frame == f"{point} (contact)"
    site = f'<site name="{frame}" pos="0.3 0.2 0.1"/>'
    rewrite_file(pair.mjcf, ("<freejoint", f"{site}<freejoint"))
    other = pa.load_robot(pair.urdf, pair.mjcf)
    assert other.description.contact_points[point] == (f"{frame}_2", f"{frame}_2")
    np.testing.assert_allclose(other.mj_model.site(frame).pos, (0.3, 0.2, 0.1))
    first, second = pa.solve_stand(plain), pa.solve_stand(other)
    np.testing.assert_allclose(first.qpos, second.qpos, atol=1e-9)


def write_stiff_quadruped(folder: Path) -> Path:
    """Write a quadruped whose legs hardly move, and of which one is 10 % shorter."""
    inertial = (
        '<inertial><mass value="{}"/><inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" '
        'iyz="0"/></inertial>'
    )
    parts = f'<link name="body">{inertial.format(1)}</link>'
    legs = {"fl": (0.1, 0.1, 0.18), "fr": (0.1, -0.1, 0.2), "hl": (-0.1, 0.1, 0.2)}
    for name, (x, y, length) in {**legs, "hr": (-0.1, -0.1, 0.2)}.items():
        parts += (
            f'<link name="{name}">{inertial.format(0.1)}<collision><origin xyz="0 0 {-length}"/>'
            '<geometry><sphere radius="0.01"/></geometry></collision></link>'
            f'<joint name="{name}_hip" type="revolute"><origin xyz="{x} {y} 0"/>'
            f'<parent link="body"/><child link="{name}"/><axis xyz="0 1 0"/>'
            '<limit lower="-0.01" upper="0.01" effort="20" velocity="9"/></joint>'
        )
    path = folder / "robot.urdf"
    path.write_text(f'<robot name="stiff">{parts}</robot>')
    return path


def test_robot_with_feet_but_without_stand_is_not_reported_without_feet(tmp_path: Path) -> None:
    """Reference: the geometry; one leg is 20 mm shorter than the others, at any joint position."""
    path = write_stiff_quadruped(tmp_path)
    fixed = pa.load_robot(path)
    (note,) = [note for note in fixed.notes if note.code == "base-kept-in-the-world"]
    assert not fixed.floating
    assert "no stand was found on fl, fr, hl, hr" in str(note)
    assert "no feet" not in str(note)
    robot = pa.load_robot(path, feet=["fl", "fr", "hl", "hr"])
    assert robot.floating
    assert list(robot.feet) == ["fl", "fr", "hl", "hr"]
    with pytest.raises(pa.StanceUnreachableError) as refusal:
        pa.solve_stand(robot)
    assert max(refusal.value.shortfall.values()) > 5e-3


def test_loading_releases_the_robots_of_intermediate_steps(tmp_path: Path) -> None:
    """Each holds a compiled model: 180 MB for a robot with 0.5 million vertices. The two are the
    loaded robot, and the robot before the postponed steps.
    """
    mjcf = quadruped(tmp_path, actuators="position", floor=True).mjcf
    before = _list_robots()
    robot = pa.load_robot(mjcf)
    gc.collect()
    assert len([robot for robot in _list_robots() if all(robot is not old for old in before)]) == 2
    pa.solve_stand(robot)  # the robot without postponed steps also stands


def _list_robots() -> list[pa.Robot]:
    return [instance for instance in gc.get_objects() if type(instance) is pa.Robot]
