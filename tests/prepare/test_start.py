"""Where searches for a start begin."""

from __future__ import annotations

import numpy as np

from pupper_analysis.prepare.start import clip_to_limits
from tests.support.variants import load


def test_what_a_pose_leaves_out_is_zero_or_as_near_as_limits_let_it() -> None:
    robot = load("original")
    low, high = robot.lower_limits, robot.upper_limits
    np.testing.assert_array_equal(clip_to_limits(robot), np.clip(0.0, low, high))
    first, second = robot.joint_names[:2]
    expected = np.clip(0.0, low, high)
    expected[:2] = high[0], np.clip(0.1, low[1], high[1])
    np.testing.assert_array_equal(clip_to_limits(robot, {first: 99.0, second: 0.1}), expected)
