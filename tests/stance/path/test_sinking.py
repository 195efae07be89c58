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
from pupper_analysis.stance.path.fastest import fastest_path
from pupper_analysis.stance.path.sinking import sunk_motion
from pupper_analysis.stance.path.stance_path import stance_path
from tests.stance.path.test_stance_path import stances
from tests.support.engines import changed
from tests.support.variants import load


def test_ground_forces_accelerate_the_centre_of_mass_of_sunk_legs() -> None:
    """Newton's law, by a spline of the com: the legs' own motion as feet sink is in the forces."""
    robot = soft(load("v3"))
    path = stance_path(robot, stances("v3", "squat")[:2], 0.16, rate=300)
    found = sunk_motion(robot, path)
    com = [pa.Configuration(robot, qpos).center_of_mass() for qpos in found.qpos]
    spline = make_interp_spline(path.time, np.array(com), k=5)
    inner = slice(4, -4)
    wanted = robot.total_mass * (spline(path.time[inner], 2) + 9.81 * UP)
    weight = robot.total_mass * 9.81
    np.testing.assert_allclose(found.forces[inner].sum(axis=1), wanted, atol=2e-3 * weight)
    legs = np.abs(path.forces[inner].sum(axis=1) - wanted).max()
    assert legs > 0.02 * weight  # on rigid ground they would be others


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
