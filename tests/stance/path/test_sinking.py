"""Paths on soft ground: what the ground gives is what moves the robot, feet that sink included."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

import pupper_analysis as pa
from pupper_analysis.robot.configuration import UP
from pupper_analysis.simulation.tracking import TORQUE_TOLERANCE, track_path
from pupper_analysis.stance.path.creeping import _past_an_edge
from pupper_analysis.stance.path.fastest import fastest_path
from pupper_analysis.stance.path.sinking import find_sunk_motion
from pupper_analysis.stance.path.stance_path import stance_path
from tests.stance.path.test_stance_path import stances
from tests.support.engines import changed
from tests.support.variants import load


def test_ground_forces_accelerate_the_centre_of_mass_of_sunk_legs() -> None:
    """Newton's law, by a spline of the com: the legs' own motion as feet sink is in the forces."""
    robot = soft(load("v3"))
    path = stance_path(robot, stances("v3", "squat")[:2], 0.16, rate=300)
    found = find_sunk_motion(robot, path)
    com = [pa.Configuration(robot, qpos).center_of_mass() for qpos in found.qpos]
    spline = make_interp_spline(path.time, np.array(com), k=5)
    inner = slice(4, -4)
    wanted = robot.total_mass * (spline(path.time[inner], 2) + 9.81 * UP)
    weight = robot.total_mass * 9.81
    np.testing.assert_allclose(found.forces[inner].sum(axis=1), wanted, atol=2e-3 * weight)
    legs = np.abs(path.forces[inner].sum(axis=1) - wanted).max()
    assert legs > 0.02 * weight  # on rigid ground they would be others


def test_past_an_edge_of_a_pyramidal_cone_a_push_moves_more_and_lifts() -> None:
    """A ball that cannot turn, pushed along an edge, in MuJoCo: its speed, and its depth."""
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><option cone="pyramidal" timestep="0.0005"/>
        <worldbody><geom type="plane" size="1 1 1" solimp="0.9 0.9 0.1"/><body pos="0 0 0.05">
        <joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>
        <joint type="slide" axis="0 0 1"/>
        <geom type="sphere" size="0.05" mass="1" condim="3" friction="0.5" solimp="0.9 0.9 0.1"/>
        </body></worldbody></mujoco>"""
    )
    data = mujoco.MjData(model)
    friction = float(np.maximum(*model.geom_friction[:2, 0])) * 9.81

    def moved(share: float) -> tuple[float, float]:
        mujoco.mj_resetData(model, data)
        data.qfrc_applied[1] = share * friction
        mujoco.mj_step(model, data, nstep=1000)
        return float(data.qvel[1]), -float(data.qpos[2])

    slow, deep = moved(0.4)
    for share in (0.5, 0.6, 0.8):
        speed, depth = moved(share)
        assert speed / slow == pytest.approx(share / 0.4 * _past_an_edge(share), rel=0.01)
        assert depth / deep == pytest.approx(min(1.0, 2 * (1 - share)), rel=0.01)


def soft(robot: pa.Robot) -> pa.Robot:
    """Feet sink by 16 of the 20 mm of their radius, and joints have dampers."""
    solimp = (0.015, 1.0, 0.031, 0.5, 2.0)

    def change(model: mujoco.MjModel) -> None:
        model.geom_solimp[:] = solimp
        model.dof_damping[6:] *= 3

    contacts = {foot: replace(own, solimp=solimp) for foot, own in robot.contacts.items()}
    return replace(changed(robot, change), contacts=contacts)


@pytest.mark.longest
@pytest.mark.parametrize("kind", ["squat", "sway"])
def test_fast_paths_are_tracked_where_feet_sink_deep(kind: str) -> None:
    robot = soft(load("v3"))
    tracking = track_path(robot, fastest_path(robot, stances("v3", kind)).path)
    assert tracking.passed, tracking.failures
    assert tracking.torque_error < 0.6 * TORQUE_TOLERANCE
