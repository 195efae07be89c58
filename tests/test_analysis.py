"""An analysis gathers what the modules find; here, what it adds of its own."""

from __future__ import annotations

import copy
import json
from dataclasses import replace

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.analysis.robot import (
    joint_summaries,
    leg_jacobians,
    leg_joints,
    leg_lengths,
    thigh_shape_length,
)


@pytest.mark.parametrize("name", pa.VARIANTS)
def test_every_variant_verifies(name: str) -> None:
    analysis = pa.analyze_variant(pa.load_variant(name))
    assert analysis.verified, analysis.failures
    assert analysis.stand.foot_error < 1e-9
    assert analysis.verification.mujoco_foot_error < 1e-9
    assert analysis.verification.joint_error < 1e-3
    assert analysis.verification.torque_error < 0.01
    assert analysis.verification.force_error < 0.01
    assert analysis.verification.height_deviation < 5e-5
    assert analysis.check.passed
    json.loads(analysis.to_json())


def test_motions_are_what_the_axes_do() -> None:
    """The tutorial's names say roll, pitch, pitch; v3's axes say pitch, roll, pitch."""
    v3 = joint_summaries(pa.load_variant("v3"))
    assert [joint.motion for joint in v3] == ["pitch", "roll", "pitch"] * 4
    skeleton = joint_summaries(pa.load_variant("original"))
    assert [joint.motion for joint in skeleton] == ["roll", "pitch", "pitch"] * 4


def test_leg_joints() -> None:
    robot = pa.load_variant("v3")
    assert leg_joints(robot, "RL") == ("leg_back_l_1", "leg_back_l_2", "leg_back_l_3")
    with pytest.raises(pa.UnknownNameError, match="FR, FL, RR, RL"):
        leg_joints(robot, "XX")


@pytest.mark.parametrize(
    ("name", "thigh", "calf"),
    [
        ("original", 0.08, 0.11),
        ("long-leg", 0.12, 0.165),
        ("v3", np.hypot(0.0494, 0.0685), np.hypot(0.06231, 0.06216)),
        ("v3-long-leg", 1.5 * np.hypot(0.0494, 0.0685), 1.5 * np.hypot(0.06231, 0.06216)),
    ],
)
def test_leg_lengths(name: str, thigh: float, calf: float) -> None:
    assert leg_lengths(pa.load_variant(name)) == pytest.approx((thigh, calf), rel=1e-12)


@pytest.mark.parametrize(("base", "long"), [("original", "long-leg"), ("v3", "v3-long-leg")])
def test_thigh_ratio_by_distance_and_by_shape(base: str, long: str) -> None:
    one, two = pa.load_variant(base), pa.load_variant(long)
    assert leg_lengths(two)[0] / leg_lengths(one)[0] == pytest.approx(1.5, rel=1e-12)
    shapes = thigh_shape_length(two), thigh_shape_length(one)
    assert shapes[0] is not None
    assert shapes[1] is not None
    # Mesh vertices are kept in single precision.
    assert shapes[0] / shapes[1] == pytest.approx(1.5, rel=1e-6)


def test_leg_jacobian_of_a_planar_leg() -> None:
    """Straight down, a leg of length l moves its foot by l in x per pitch: and not along itself."""
    robot = pa.load_variant("original")
    jacobians = leg_jacobians(pa.Configuration(robot, robot.neutral()))
    expected = np.array([[0, -0.19, -0.11], [0.19, 0, 0], [0, 0, 0]])
    np.testing.assert_allclose(jacobians["FL"].matrix, expected, atol=1e-15)
    assert jacobians["FL"].condition > 1e12
    bent = pa.Configuration(robot, np.concatenate([robot.neutral()[:7], [0, 0.9, -1.5] * 4]))
    for jacobian in leg_jacobians(bent).values():
        assert jacobian.condition == pytest.approx(np.linalg.cond(jacobian.matrix))


def test_a_failed_verification_and_a_failed_check_are_told() -> None:
    robot = pa.load_variant("original")
    weak = copy.copy(robot.mj_model)
    weak.actuator_forcerange[:] = (-0.2, 0.2)  # the knees hold 0.36 N m
    analysis = pa.analyze_variant(replace(robot, mj_model=weak))
    assert not analysis.verified
    assert not analysis.verification.passed
    assert any("fell over" in failure for failure in analysis.failures)
    assert any("effort limits" in failure for failure in analysis.failures)

    heavy = copy.copy(robot.mj_model)
    heavy.body_mass[1] += 0.01
    analysis = pa.analyze_variant(replace(robot, mj_model=heavy))
    assert not analysis.verified
    assert any("body masses" in failure for failure in analysis.failures)


def test_a_stance_out_of_reach_is_no_analysis() -> None:
    with pytest.raises(pa.StanceUnreachableError):
        pa.analyze_variant(pa.load_variant("v3"), pa.StandTask(height=0.4))
