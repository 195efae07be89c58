"""Paths in MuJoCo: how well its servos follow them, and what is said if they do not."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import load
from test_path import SECONDS, path_of, stances

import pupper_analysis as pa
from pupper_analysis.simulation.tracking import track_path
from pupper_analysis.stance.path.stance_path import stance_path

# What MuJoCo makes of them, with a margin of about a half: joint (rad), height (m), base (rad).
# v3's servos are soft (5 N m/rad), and a foot that rolls has no grip left: it creeps.
BOUNDS = {
    ("v3", "squat"): (0.01, 1.0e-3, 0.01),
    ("v3", "sway"): (0.01, 1.0e-3, 0.01),
    ("v3", "circle"): (0.01, 1.0e-3, 0.01),
    ("v3", "lift"): (0.012, 1.0e-3, 0.015),
    ("original", "squat"): (0.0025, 2e-4, 1e-4),
    ("original", "sway"): (0.002, 5e-5, 5e-4),
    ("original", "circle"): (0.0035, 5e-5, 1.5e-3),
    ("original", "lift"): (0.0025, 1e-4, 1.2e-3),
}


@pytest.mark.slow
@pytest.mark.parametrize(("name", "kind"), BOUNDS)
def test_mujoco_tracks_a_path(name: str, kind: str) -> None:
    tracking = track_path(load(name), path_of(name, kind))
    assert tracking.passed, tracking.failures
    joint, height, angle = BOUNDS[name, kind]
    assert 0 < tracking.joint_error_rms < tracking.joint_error < joint
    assert tracking.height_error < height
    assert tracking.orientation_error < angle
    assert max(tracking.foot_slip.values()) < (6e-3 if name == "v3" else 1e-3)
    assert tracking.torque_error < 0.05
    assert tracking.time[-1] == pytest.approx(SECONDS[kind], abs=0.021)
    assert tracking.joints.shape == (len(tracking.time), load(name).nu)
    assert tracking.to_dict()["passed"] is True


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["circle", "lift"])
def test_feet_that_roll_are_where_the_path_has_them(kind: str) -> None:
    """Centres that stay are a wish that friction does not grant."""
    rolling, pinned = (
        track_path(load("original"), path_of("original", kind, free)) for free in (True, False)
    )
    assert max(rolling.foot_slip.values()) < 0.4 * max(pinned.foot_slip.values())
    assert rolling.orientation_error < 0.9 * pinned.orientation_error


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [0.4, 1.0, 4.0])
@pytest.mark.parametrize("name", ["v3", "original"])
def test_torques_in_motion_are_confirmed_at_any_speed(name: str, seconds: float) -> None:
    """Without inertia the fast ones would be off by more than they may."""
    robot = load(name)
    path = stance_path(robot, stances(name, "squat"), seconds, rate=50 / seconds)
    tracking = track_path(robot, path)
    assert tracking.passed, tracking.failures
    assert tracking.joint_error < (0.008 if name == "v3" else 0.001)
    still = stance_path(robot, stances(name, "squat"), 1e3, rate=50 / 1e3)
    inertia = np.abs(path.torques - still.torques).max() / np.abs(path.torques).max()
    if seconds < 0.5:
        assert inertia > 4 * tracking.torque_error


@pytest.mark.slow
def test_an_integrators_own_error_is_kept_small() -> None:
    """The skeleton's 4 ms, implicit, are good for standing, and not for a fast path."""
    robot = load("original")
    path = stance_path(robot, stances("original", "sway"), 1.0, rate=100)
    fine, coarse = track_path(robot, path), track_path(robot, path, timestep=4e-3)
    assert coarse.timestep == 4e-3
    assert fine.timestep == pytest.approx(2.5e-4)
    assert fine.torque_error < 0.5 * coarse.torque_error
    explicit = track_path(robot, path, integrator="Euler")
    assert explicit.torque_error == pytest.approx(fine.torque_error, abs=0.02)


@pytest.mark.slow
def test_what_fails_is_said() -> None:
    robot = load("v3")
    path = path_of("v3", "lift")
    limp = track_path(robot, path, kp=0.3, kd=0.01)
    assert not limp.passed
    assert any("a joint is off" in failure for failure in limp.failures)
    fast = track_path(robot, stance_path(robot, stances("v3", "sway"), 0.35, beyond=True))
    assert not fast.passed
    assert any("carries nothing" in failure for failure in fast.failures)
    assert any("no contact forces do from" in failure for failure in fast.failures)
    weak = track_path(robot, path, kp=5.0, kd=0.1, integrator="implicitfast")
    assert weak.integrator == "implicitfast"
    with pytest.raises(pa.ConfigurationError, match="timestep"):
        track_path(robot, path, timestep=0.0)
    with pytest.raises(pa.ConfigurationError, match="path"):
        track_path(load("original"), path)
    with pytest.raises(pa.ConfigurationError, match="integrator"):
        track_path(robot, path, integrator="magic")
