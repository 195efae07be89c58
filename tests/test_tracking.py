"""Paths in MuJoCo: how well its servos follow them, and what is said if they do not."""

from __future__ import annotations

from itertools import pairwise

import pytest
from conftest import load
from test_path import SECONDS, lift, path_of, stances

import pupper_analysis as pa
from pupper_analysis.path import stance_path
from pupper_analysis.tracking import track_path

# What MuJoCo makes of them, with a margin of about a half: joint (rad), height (m), base (rad).
# v3's servos are soft (5 N m/rad), and its feet resist rolling, which the path does not know.
BOUNDS = {
    ("v3", "squat"): (0.045, 1.5e-3, 0.02),
    ("v3", "sway"): (0.04, 1.0e-3, 0.015),
    ("v3", "circle"): (0.025, 1.0e-3, 0.02),
    ("v3", "lift"): (0.06, 2.5e-3, 0.035),
    ("original", "squat"): (0.0025, 2e-4, 1e-4),
    ("original", "sway"): (0.002, 5e-5, 5e-4),
    ("original", "circle"): (0.0035, 5e-5, 1.5e-3),
    ("original", "lift"): (0.0025, 1e-4, 1.2e-3),
}


@pytest.mark.parametrize(("name", "kind"), BOUNDS)
def test_mujoco_tracks_a_path(name: str, kind: str) -> None:
    tracking = track_path(load(name), path_of(name, kind))
    assert tracking.passed, tracking.failures
    joint, height, angle = BOUNDS[name, kind]
    assert 0 < tracking.joint_error_rms < tracking.joint_error < joint
    assert tracking.height_error < height
    assert tracking.orientation_error < angle
    assert max(tracking.foot_slip.values()) < (6e-3 if name == "v3" else 1e-3)
    assert tracking.torque_error < 1.0
    assert tracking.time[-1] == pytest.approx(SECONDS[kind], abs=0.021)
    assert tracking.joints.shape == (len(tracking.time), load(name).nu)
    assert tracking.to_dict()["passed"] is True


@pytest.mark.parametrize("kind", ["circle", "lift"])
def test_feet_that_roll_are_where_the_path_has_them(kind: str) -> None:
    """Centres that stay are a wish that friction does not grant."""
    rolling, pinned = (
        track_path(load("original"), path_of("original", kind, free)) for free in (True, False)
    )
    assert max(rolling.foot_slip.values()) < 0.4 * max(pinned.foot_slip.values())
    assert rolling.orientation_error < 0.9 * pinned.orientation_error


def test_slower_is_more_accurate() -> None:
    for name in ("v3", "original"):
        robot = load(name)
        errors = [
            track_path(
                robot, stance_path(robot, stances(name, "squat"), seconds, rate=50 / seconds)
            )
            for seconds in (1.0, 2.5, 8.0)
        ]
        for fast, slow in pairwise(errors):
            assert slow.joint_error < fast.joint_error
            assert slow.torque_error < fast.torque_error


def test_what_fails_is_said() -> None:
    robot = load("v3")
    path = path_of("v3", "lift")
    limp = track_path(robot, path, kp=0.3, kd=0.01)
    assert not limp.passed
    assert any("a joint is off" in failure for failure in limp.failures)
    fast = track_path(robot, stance_path(robot, lift("v3", "FL", 0.03), 0.5))
    assert not fast.passed
    with pytest.raises(pa.ConfigurationError, match="path"):
        track_path(load("original"), path)
    with pytest.raises(pa.ConfigurationError, match="integrator"):
        track_path(robot, path, integrator="magic")
