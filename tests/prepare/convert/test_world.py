"""Floor and servos that a lone URDF gets in memory equal those that `convert` writes."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh

import pupper_analysis as pa
from pupper_analysis.models.additions import Floor, Options, Servo, StartKeyframe
from pupper_analysis.stance.stand import stand_statics
from pupper_analysis.stance.task import StandTask
from tests.support.conversions import write_standing_urdf
from tests.support.legged import quadruped as legged
from tests.support.legged import rewrite_file
from tests.support.repository import ROOT

GEOM = (
    *("friction", "solref", "solimp", "solmix", "condim", "contype", "conaffinity", "priority"),
    *("margin", "gap", "type"),
)
OPTIONS = (
    *("cone", "impratio", "timestep", "integrator", "solver", "jacobian", "iterations"),
    *("noslip_iterations", "tolerance", "gravity", "disableflags", "o_solref", "o_solimp"),
)
MOTOR = ("gainprm", "biasprm", "forcerange", "forcelimited", "ctrllimited", "gear", "biastype")


def write_random_quadruped(folder: Path, seed: int) -> Path:
    """Write a quadruped with random masses and foot radii; odd seeds have round meshes as feet."""
    random = np.random.default_rng(seed)
    text = write_standing_urdf(folder).read_text()

    def heavier(found: re.Match[str]) -> str:
        return f'mass value="{float(found[1]) * random.uniform(0.8, 1.25):.4f}"'

    text = re.sub(r'mass value="([^"]+)"', heavier, text)
    radius = random.uniform(0.012, 0.03)
    foot = f'<sphere radius="{radius:.4f}"/>'
    if seed % 2:
        trimesh.creation.icosphere(subdivisions=3, radius=radius).export(folder / "foot.stl")
        foot = '<mesh filename="foot.stl"/>'
    path = folder / "drawn.urdf"
    path.write_text(text.replace('<sphere radius="0.02"/>', foot))
    return path


def load_both(urdf: Path, folder: Path) -> tuple[pa.Robot, mujoco.MjModel, Path]:
    """Return the robot loaded from a URDF, MuJoCo's model of the MJCF that `convert` writes, and
    the file of this MJCF.
    """
    output = folder / f"{urdf.stem}_written.xml"
    assert pa.convert_model(urdf, output).passed
    return pa.load_robot(urdf), mujoco.MjModel.from_xml_path(str(output)), output


def list_touching_geoms(model: mujoco.MjModel) -> list[int]:
    """Return the colliding geoms, sorted by body name and index; names of geoms may differ."""
    touch = np.flatnonzero(model.geom_contype | model.geom_conaffinity)
    return sorted(touch, key=lambda geom: (model.body(model.geom_bodyid[geom]).name, geom))


def assert_equal_worlds(memory: mujoco.MjModel, file: mujoco.MjModel) -> None:
    """Assert that options and contact parameters of two models are equal to the last bit, and
    servos and keyframes within 1e-9.
    """
    for name in OPTIONS:
        np.testing.assert_array_equal(
            getattr(memory.opt, name), getattr(file.opt, name), err_msg=name
        )
    ours, theirs = list_touching_geoms(memory), list_touching_geoms(file)
    assert len(ours) == len(theirs)
    for name in GEOM:
        first, second = (
            getattr(model, f"geom_{name}")[some] for model, some in ((memory, ours), (file, theirs))
        )
        np.testing.assert_array_equal(first, second, err_msg=name)
    np.testing.assert_allclose(memory.geom_rbound[ours], file.geom_rbound[theirs], atol=1e-9)
    for name in MOTOR:
        first, second = getattr(memory, f"actuator_{name}"), getattr(file, f"actuator_{name}")
        np.testing.assert_allclose(first, second, rtol=1e-9, err_msg=name)
    assert memory.nexclude == file.nexclude
    assert memory.nkey == file.nkey == 1
    np.testing.assert_allclose(memory.key_qpos, file.key_qpos, atol=1e-9)
    np.testing.assert_allclose(memory.key_ctrl, file.key_ctrl, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [70201, 70208, 70209])
def test_converted_urdf_has_the_verdicts_of_its_source(seed: int, tmp_path: Path) -> None:
    """Random quadrupeds: stand height within 2 um, verdict on a slope of 0.14 rad, and torques [N
    m] of the nominal stand. The tolerances are the rounding of the written file.
    """
    urdf = write_random_quadruped(tmp_path, seed)
    robot, file, output = load_both(urdf, tmp_path)
    assert_equal_worlds(robot.mj_model, file)
    again = pa.load_robot(output)
    assert again.stand_height == pytest.approx(robot.stand_height, abs=2e-6)
    ground = pa.Ground(slope=0.14, uphill=1.0)
    verdicts = []
    for loaded in (robot, again):
        stand = pa.solve_stand(loaded, StandTask(ground=ground))
        seen = pa.verify_stand(loaded, stand)
        verdicts.append((seen.passed, seen.collapses, tuple(f.code for f in seen.failures)))
    assert verdicts[0] == verdicts[1]
    np.testing.assert_allclose(
        stand_statics(robot, pa.solve_stand(robot)).joint_torques,
        stand_statics(again, pa.solve_stand(again)).joint_torques,
        atol=1e-4 * robot.total_mass,
    )


@pytest.mark.slow
def test_each_added_element_has_a_reason(tmp_path: Path) -> None:
    """A servo per joint, one floor and one keyframe. The reasons are notes of the robot as well;
    one note states all servos.
    """
    robot = pa.load_robot(write_random_quadruped(tmp_path, 70201))
    added = robot.description.added
    kinds = [type(addition) for addition in added]
    assert kinds.count(Servo) == robot.nu
    assert kinds.count(Floor) == kinds.count(StartKeyframe) == 1
    reasons = {addition.reason.code for addition in added}
    assert {"ground-added", "contacts-made-to-hold", "servos-made", "start-pose-found"} <= reasons
    messages = {note.code for note in robot.notes}
    assert reasons - {"servos-made"} <= messages
    assert "servos-added" in messages


@pytest.mark.slow
@pytest.mark.parametrize("stated", ["", '<option impratio="5"/>'])
def test_freed_base_and_added_ground_state_their_friction(stated: str, tmp_path: Path) -> None:
    """The written MJCF states impratio, unless the file states it; without it, the robot creeps on
    a slope on which the URDF stands."""
    pair = legged(tmp_path, free=False)
    rewrite_file(pair.mjcf, ("<worldbody>", f"{stated}<worldbody>"))
    robot = pa.load_robot(mjcf=pair.mjcf)
    assert robot.floating
    gripped = any(note.code == "contacts-made-to-hold" for note in robot.notes)
    assert gripped is not bool(stated)
    assert robot.mj_model.opt.impratio == (5 if stated else 100)


@pytest.mark.slow
def test_freed_robot_is_written_with_the_servos_of_its_stand(
    tmp_path: Path,
) -> None:
    """The URDF is fixed to the world.

    The written model stays fixed, with servos for the stand; servos for the hanging robot are too
    weak to stand on.
    """
    tie = '<joint name="tie" type="fixed"><parent link="world"/><child link="trunk"/></joint>'
    tied = ("</robot>", f'<link name="world"/>{tie}</robot>')
    free, written, output = load_both(rewrite_file(write_standing_urdf(tmp_path), tied), tmp_path)
    assert written.nkey == 0
    assert not (written.jnt_type == mujoco.mjtJoint.mjJNT_FREE).any()
    for name in MOTOR:
        first, second = (getattr(model, f"actuator_{name}") for model in (free.mj_model, written))
        np.testing.assert_allclose(first, second, rtol=1e-9, err_msg=name)
    for slope in (0.0, 0.14):
        task = StandTask(ground=pa.Ground(slope=slope))
        for robot in (free, pa.load_robot(output)):
            assert pa.verify_stand(robot, pa.solve_stand(robot, task)).passed


@pytest.mark.slow
def test_urdf_of_pupper_is_written_with_the_world_of_the_loaded_robot(tmp_path: Path) -> None:
    robot, file, _ = load_both(ROOT / "urdf/pupper_v3.urdf", tmp_path)
    assert_equal_worlds(robot.mj_model, file)


@pytest.mark.slow
def test_contact_options_of_an_mjcf_are_kept(tmp_path: Path) -> None:
    """A floor is added. Reference: the options of the file, which are MuJoCo's defaults."""
    pair = legged(tmp_path)
    robot = pa.load_robot(pair.urdf, pair.mjcf)
    stated = mujoco.MjModel.from_xml_path(str(pair.mjcf)).opt
    assert robot.mj_model.opt.cone == stated.cone
    assert robot.mj_model.opt.impratio == stated.impratio
    options = [addition for addition in robot.description.added if isinstance(addition, Options)]
    assert not any("cone" in option.values for option in options)
