"""Feet that slide or creep in the simulation of a stand."""

from __future__ import annotations

import math
from pathlib import Path

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.tool import with_payload
from pupper_analysis.simulation.rollout import STATE_SPEC, make_stand_start, with_stand_contacts
from pupper_analysis.simulation.stability import (
    measure_response,
    moves_equally_without_nudge,
    simulate_nudge,
)
from tests.support.variants import load

_MODELS = Path(__file__).parents[2]


@pytest.fixture
def slippery(tmp_path: Path) -> Robot:
    """Pupper v3 with the friction coefficient 0.12 between feet and floor."""
    for source in (*_MODELS.glob("mjcf/pupper_v3*.xml"), _MODELS / "urdf/pupper_v3.urdf"):
        text = source.read_text().replace('friction="0.8 0.02', 'friction="0.12 0.02')
        text = text.replace('geom name="floor"', 'geom name="floor" friction="0.12 0.005 1e-4"')
        (tmp_path / source.name).write_text(text)
    (tmp_path / "meshes").symlink_to(_MODELS / "mjcf/meshes")
    return pa.load_robot(tmp_path / "pupper_v3.urdf", tmp_path / "pupper_v3.xml")


@pytest.mark.slow
@pytest.mark.parametrize(("slope", "slides"), [(6.5, True), (2.0, False)])
def test_feet_that_slide_without_feedforward_are_reported(
    slippery: Robot, slope: float, slides: bool
) -> None:
    """Reference: foot positions in bare MuJoCo after 5 s. tan(6.5 deg) = 0.95 mu: feet just hold.

    Without feed-forward the legs spread, the feet slide 90 mm down the slope until the robot rests,
    and the stand passed without a note.
    """
    task = pa.StandTask(ground=pa.Ground(slope=math.radians(slope), uphill=0.3))
    stand = pa.solve_stand_as_simulated(slippery, task)
    held = make_stand_start(slippery, stand, feedforward=False)
    model = held.drive.model
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, held.start, STATE_SPEC)
    mujoco.mj_kinematics(model, data)
    feet = list(held.robot.foot_geoms)
    before = data.geom_xpos[feet].copy()
    data.ctrl[:] = held.ctrl
    mujoco.mj_step(model, data, nstep=round(5 / model.opt.timestep))
    slip = float(np.linalg.norm(data.geom_xpos[feet] - before, axis=1).max())
    assert (slip > 0.05) == slides
    run = pa.verify_stand(slippery, stand, feedforward=False)
    assert max(run.foot_slip.values()) == pytest.approx(slip, abs=2e-3)
    assert ("foot-slid" in {note.code for note in run.notes}) is slides
    verdict = pa.judge_stand(slippery, stand)
    assert ("foot-slid" in {note.code for note in verdict.notes}) is slides
    assert not pa.verify_stand(slippery, stand).notes


@pytest.mark.slow
def test_creep_that_changes_its_speed_is_no_effect_of_a_nudge() -> None:
    """Reference: bare MuJoCo with and without the nudge; after 7 s the velocities agree to 1e-6.

    Two feet on slopes creep, and the pitch rate changes from -0.45 to 0.55 mrad/s in both
    simulations. The stand failed with "a nudge does not decay".
    """
    robot = with_payload(load("v3"), 1.0, (-0.05, 0.0, 0.1))
    slopes = {"FR": pa.Slope(0.35, uphill=0.0), "FL": pa.Slope(0.35, uphill=3.1)}
    task = pa.StandTask(contacts={foot: pa.Contact(slope) for foot, slope in slopes.items()})
    stand = pa.solve_stand_as_simulated(robot, task)
    run = pa.verify_stand(robot, stand, feedforward=False)
    assert run.nudge is not None
    assert not run.nudge.decayed
    held = make_stand_start(with_stand_contacts(robot, stand), stand, feedforward=False)
    model = held.drive.model
    ends = []
    for nudge in (0.0, run.nudge.speed):
        data = mujoco.MjData(model)
        mujoco.mj_setState(model, data, held.start, STATE_SPEC)
        data.ctrl[:] = held.ctrl
        mujoco.mj_step(model, data, nstep=round(5 / model.opt.timestep))
        data.qvel += nudge
        mujoco.mj_step(model, data, nstep=round(7 / model.opt.timestep))
        ends.append(data.qvel.copy())
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-6)
    assert run.passed, run.failures


def test_velocity_that_a_base_keeps_is_an_effect_of_the_nudge() -> None:
    """Reference: without forces, m v' = 0."""
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><option gravity="0 0 0"/><worldbody><body><freejoint/>'
        '<geom size="0.1" mass="1"/></body></worldbody></mujoco>'
    )
    before = np.zeros(mujoco.mj_stateSize(model, STATE_SPEC))
    before[4] = 1.0
    states = simulate_nudge(model, before, np.zeros(0), 3.0)
    nudge = measure_response(
        model, before, states, np.vstack([before - np.eye(len(before))[0], before])
    )
    assert not nudge.decayed
    assert not moves_equally_without_nudge(model, before, np.zeros(0), nudge, states)
