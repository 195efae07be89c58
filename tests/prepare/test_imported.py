"""MuJoCo's own import of a URDF, simulated beside the converted model; each verdict has a line on
it.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh

import pupper_analysis as pa
from pupper_analysis.prepare import own_run as own_run_module
from pupper_analysis.prepare.own_run import get_published_model, own_run
from pupper_analysis.present.verdict import format_verdict, verdict_clauses
from pupper_analysis.robot import fall
from pupper_analysis.simulation.verdict import Verdict, VerdictCode
from tests.support.legged import biped, quadruped, rewrite_file


def add_collision_shapes(urdf: Path, *shapes: tuple[str, str]) -> Path:
    """Add (link, content of a <geometry>) as collision shapes to a URDF. Shapes other than meshes
    are 0.2 m below the frame of the link.
    """
    for link, shape in shapes:
        begin = f'<link name="{link}">'
        low = "" if "mesh" in shape else '<origin xyz="0 0 -0.2"/>'
        collision = f"<collision>{low}<geometry>{shape}</geometry></collision>"
        rewrite_file(urdf, (begin, begin + collision))
    return urdf


def four_legs(folder: Path) -> Path:
    feet = ((f"{leg}_calf", '<sphere radius="0.02"/>') for leg in ("FL", "FR", "RL", "RR"))
    return add_collision_shapes(quadruped(folder).urdf, *feet)


def two_legs(folder: Path) -> Path:
    """Write a biped on soles of 60 mm x 60 mm with 49 vertices, which are level within 10 um."""
    places = np.linspace(-0.03, 0.03, 7)
    grid = np.array([(x, y) for x in places for y in places])
    bottom = -0.05 + 1e-5 * (grid**2).sum(axis=1) / (2 * 0.03**2)
    points = np.vstack(
        [np.column_stack([grid, bottom]), np.column_stack([grid, np.full(49, -0.03)])]
    )
    trimesh.convex.convex_hull(points + np.array([0.02, 0, 0])).export(folder / "sole.stl")
    soles = ((f"{side}_tilt_link", '<mesh filename="sole.stl"/>') for side in ("left", "right"))
    return add_collision_shapes(biped(folder).urdf, *soles)


def verdict_of(robot: pa.Robot) -> Verdict:
    return pa.judge_stand(robot, pa.solve_stand(robot))


@pytest.mark.slow
def test_mujoco_import_of_a_correct_urdf_agrees_with_the_prediction(tmp_path: Path) -> None:
    """Reference: MuJoCo's own import of the URDF, independent of our conversion."""
    robot = pa.load_robot(four_legs(tmp_path))
    verdict = verdict_of(robot)
    assert verdict.code is VerdictCode.HOLDS_ON_ADDED_SERVOS
    assert verdict.keyframe_run is not None
    assert verdict.keyframe_run.imported
    assert not verdict.keyframe_run.falls
    assert verdict.keyframe_run.timestep is None
    assert verdict.keyframe_run.worst is not None
    assert "MuJoCo's import of the URDF, from the computed pose" in format_verdict(verdict)
    assert "rests-on-made-up" not in {clause.message.code for clause in verdict_clauses(verdict)}
    assert verdict.published is not None
    assert not verdict.published.differs
    for run in verdict.published.runs:
        assert abs(run.height_error) < 1e-6
        assert run.torque_error < 1e-3  # feet stick where the nudge left them


@pytest.mark.slow
def test_imported_model_has_a_free_joint_a_ground_and_servos(tmp_path: Path) -> None:
    """MuJoCo's import of the URDF has none of them.

    Its total mass [kg] equals that of the robot, and a pickled robot has the same run.
    """
    robot = pa.load_robot(four_legs(tmp_path))
    model = get_published_model(robot)
    assert model is not None
    assert model is not robot.mj_model
    assert model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE.value
    assert sum(model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE.value) == 1
    assert model.nu == 12
    assert model.body_mass.sum() == pytest.approx(robot.total_mass, rel=1e-12)
    again = pickle.loads(pickle.dumps(robot))
    assert own_run(again) == own_run(robot)


@pytest.mark.slow
@pytest.mark.parametrize("make", [four_legs, two_legs])
@pytest.mark.parametrize("steps", [5000, 1500])
def test_own_run_continues_the_settling_simulation_with_the_same_result(
    make: Callable[[Path], Path], steps: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reference: the run without the states of the settling simulation, to the last bit.

    With 1500 steps, the state halfway lies before the end of the settling simulation.
    """
    monkeypatch.setattr(fall, "_MAX_KEYFRAME_STEPS", steps)
    robot = pa.load_robot(make(tmp_path))
    assert get_published_model(robot) is not None  # has settled
    num_steps, step = 0, mujoco.mj_step

    def count_step(model: mujoco.MjModel, data: mujoco.MjData, nstep: int = 1) -> None:
        nonlocal num_steps
        num_steps += nstep
        step(model, data, nstep=nstep)

    monkeypatch.setattr(mujoco, "mj_step", count_step)
    continued = own_run_module._simulate_from_keyframe(robot)
    num_continued, num_steps = num_steps, 0
    monkeypatch.setattr(own_run_module, "_find_nudged_run", lambda _: None)
    assert own_run_module._simulate_from_keyframe(robot) == continued
    model = get_published_model(robot)
    assert model is not None
    assert num_steps - num_continued == round(2.0 / model.opt.timestep)


@pytest.mark.slow
def test_verdict_fails_if_the_mujoco_import_falls(tmp_path: Path) -> None:
    """Two feet of the import have a radius of 2 mm in place of 20 mm."""
    robot = pa.load_robot(four_legs(tmp_path))
    assert robot.published is not None
    own = robot.published.imported
    assert own is not None
    short = replace(own, text=own.text.replace('radius="0.02"', 'radius="0.002"', 2))
    other = replace(robot, published=replace(robot.published, imported=short))
    verdict = verdict_of(other)
    assert verdict.with_feedforward == "holds"
    assert verdict.code is VerdictCode.DIFFERS_AS_PUBLISHED, format_verdict(verdict)
    assert not verdict.passed


@pytest.mark.slow
def test_time_step_of_the_import_suits_the_soles_of_the_file(tmp_path: Path) -> None:
    """The added servos and the time step suit spheres. With them, meshes oscillate at 2 ms, and do
    not at 1 ms.
    """
    verdict = verdict_of(pa.load_robot(two_legs(tmp_path)))
    assert verdict.passed, format_verdict(verdict)
    assert "on-balls-for-soles" in {clause.message.code for clause in verdict_clauses(verdict)}
    assert verdict.keyframe_run is not None
    assert verdict.keyframe_run.timestep == 1e-3
    assert "at a time step of 1 ms (it shakes at longer ones)" in format_verdict(verdict)


@pytest.mark.slow
def test_refused_mujoco_import_is_stated_in_the_verdict(tmp_path: Path) -> None:
    """A cone is left out by the conversion and refused by MuJoCo's importer."""
    urdf = add_collision_shapes(four_legs(tmp_path), ("trunk", '<cone radius="0.1" length="0.1"/>'))
    verdict = verdict_of(pa.load_robot(urdf))
    assert verdict.keyframe_run is None
    assert verdict.passed
    assert "the result of MuJoCo's own import of the URDF is unknown" in format_verdict(verdict)
