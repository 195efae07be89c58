"""Names and patterns of joints in a posture."""

from __future__ import annotations

from pathlib import Path

from pupper_analysis.robot.joints import named_positions
from tests.support.arm import MJCF, URDF, load_arm


def test_name_of_a_joint_with_brackets_selects_the_joint(tmp_path: Path) -> None:
    """In a pattern, brackets are alternatives of a single character."""
    urdf, mjcf = (text.replace('"elbow"', '"arm[0]"') for text in (URDF, MJCF))
    robot = load_arm(tmp_path, urdf=urdf, mjcf=mjcf)
    assert named_positions(robot, {"arm[0]": 0.5}) == {"arm[0]": 0.5}
    assert named_positions(robot, {"arm*": 0.4, "sho[ou]lder": 0.1}) == {
        "arm[0]": 0.4,
        "shoulder": 0.1,
    }
