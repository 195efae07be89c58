"""Findings of `audit` in public robots, read by hand in the files; see ``test_real_robots``."""

from __future__ import annotations

import shutil
from collections import Counter
from pathlib import Path

import pytest

from pupper_analysis.models.stated.urdf import read_urdf_model
from pupper_analysis.models.urdf_file import read_urdf
from pupper_analysis.tools.audit.audit import Audit, Severity, audit_model
from pupper_analysis.tools.audit.registry import CHECKS
from tests.robots.test_real_robots import MJCF, URDF, file
from tests.support.repository import benchmark

symmetric = benchmark("symmetric_slips")

PLACEHOLDERS = (
    "so_arm_description/urdf/so100",
    "so_arm_description/urdf/so101",
    "solo_description/robots/solo",
    "solo_description/robots/solo12",
    "bolt_description/robots/bolt",
    "quadruped_description/urdf/quadruped",
    "finger_edu_description/robots/finger_edu",
    "allegro_hand_description/urdf/allegro_left_hand",
    "baxter_description/urdf/baxter",
    "talos_data/robots/talos_full_v2",
    "ur_description/urdf/ur3_robot",  # which has the efforts of a UR10
)
REAL_EFFORTS = (
    *("a1_description/urdf/a1", "go1_description/urdf/go1", "go2_description/urdf/go2"),
    *("b1_description/urdf/b1", "g1_description/urdf/g1_29dof_rev_1_0", "z1_description/urdf/z1"),
    *("anymal_b_simple_description/robots/anymal", "hyq_description/robots/hyq_no_sensors"),
    *("panda_description/urdf/panda", "ur_description/urdf/ur5_robot"),
    *("xarm_description/urdf/xarm7", "talos_data/robots/talos_reduced"),
)


@pytest.mark.parametrize("name", PLACEHOLDERS + REAL_EFFORTS)
def test_placeholder_efforts_of_public_robots_are_found(name: str) -> None:
    """Reference: lists by hand of robots with placeholder efforts, and of robots whose efforts are
    real.
    """
    model = read_urdf_model(read_urdf(file(URDF, f"{name}.urdf")))
    assert bool(list(CHECKS["effort-placeholder"](model))) == (name in PLACEHOLDERS)


BALLS = (
    "alex_description/urdf/alex_sake_hands",
    "asr_twodof_description/urdf/TwoDofs",
    "baxter_description/urdf/baxter",
    "pr2_description/urdf/pr2",
    "simple_humanoid_description/urdf/simple_humanoid",
    "tiago_description/robots/tiago",
)
TURNS = (
    "anymal_b_simple_description/robots/anymal",  # 3 pi either way
    "bolt_description/robots/bolt",
    "iris_description/robots/iris",
    "solo_description/robots/solo12",
    "ur_description/urdf/ur5_joint_limited_robot",
)


@pytest.mark.parametrize("name", sorted({*BALLS, *TURNS, *REAL_EFFORTS}))
def test_placeholder_inertias_and_ranges_of_public_robots_are_found(name: str) -> None:
    """Reference: lists by hand of robots with spherical placeholder inertias, and with ranges of
    whole turns.
    """
    model = read_urdf_model(read_urdf(file(URDF, f"{name}.urdf")))
    assert bool(list(CHECKS["inertial-placeholder"](model))) == (name in BALLS)
    assert bool(list(CHECKS["range-placeholder"](model))) == (name in TURNS)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("go1", set()),
        ("mini_cheetah", {"mirror-inertia", "mirror-shapes", "keyframe-feet-in-air"}),
        # The commanded angles are torques, so that the robot falls, as `stand` states.
        ("spot", {"mirror-limits", "keyframe-torques-are-angles", "keyframe-falls"}),
        ("b2", {"mirror-com", "mirror-shapes"}),
    ],
)
def test_faults_of_one_leg_are_the_only_warnings(name: str, expected: set[str]) -> None:
    """Reference: faults of single legs and keyframes, read by hand in the MJCF."""
    result = audit_model(file(MJCF, f"{name}/{name}.xml"))
    assert result.passed
    assert {
        finding.rule for finding in result.findings if finding.severity == Severity.WARNING
    } == expected


FLIPPED = "com y flipped"  # an offset of 1 to 3 cm, in shapes that do not show the side
LEGGED = [f"{name}_description/urdf/{name}" for name in ("a1", "go1", "go2", "b1", "laikago")]


def _count_findings(audit: Audit) -> Counter[tuple[str, str]]:
    return Counter((found.rule, found.element) for found in audit.findings)


@pytest.mark.slow
@pytest.mark.parametrize("name", LEGGED)
def test_slips_that_all_legs_share_are_found(name: str, tmp_path: Path) -> None:
    """Each slip of `symmetric_slips.SLIPS` adds a finding, except a CoM with flipped y of 1 to 3
    cm.
    """
    source = file(URDF, f"{name}.urdf")
    packages = {"example-robot-data": file(URDF, "").parent}
    slips = {
        slip: symmetric.write_slip(source, slip, tmp_path / f"{slip}.urdf")
        for slip in symmetric.SLIPS
    }
    sound = _count_findings(
        audit_model(shutil.copy(source, tmp_path / "sound.urdf"), packages=packages)
    )
    found = {
        slip: _count_findings(audit_model(path, packages=packages)) for slip, path in slips.items()
    }
    unseen = {slip for slip in slips if not found[slip] - sound}
    assert unseen == {FLIPPED}
