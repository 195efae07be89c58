"""Names of left and right parts."""

from __future__ import annotations

import pytest

from pupper_analysis.models.sides import find_mirror_pairs, mirror_name


@pytest.mark.parametrize(
    ("left", "right"),
    [
        ("FL_hip", "FR_hip"),
        ("RL_calf_joint", "RR_calf_joint"),
        ("LF_HAA", "RF_HAA"),
        ("LH_FOOT", "RH_FOOT"),
        ("leg_front_l_1", "leg_front_r_1"),
        ("left_hip_yaw", "right_hip_yaw"),
        ("LeftKnee", "RightKnee"),
        ("LHipYaw", "RHipYaw"),
        ("fl.hx", "fr.hx"),
        ("fl_caster_l_wheel", "fr_caster_r_wheel"),
        ("leftshin", "rightshin"),
        ("frontleft_hip", "frontright_hip"),
        ("FL_upright_link", "FR_upright_link"),
        ("LeftUpright", "RightUpright"),
        ("upright_left", "upright_right"),
        ("L_lf_j1", "R_lf_j1"),
    ],
)
def test_left_and_right_names_are_mirror_images(left: str, right: str) -> None:
    """Names of published robots."""
    assert mirror_name(left) == right
    assert mirror_name(right) == left
    assert find_mirror_pairs([left, "base", right]) == [(left, right)]


@pytest.mark.parametrize("part", ["gripper", "camera", "realsense", "imu_sensor"])
def test_parts_that_are_copied_to_both_sides_are_no_pairs(part: str) -> None:
    """As the cameras at both wrists of Galaxea's R1."""
    assert find_mirror_pairs([f"left_{part}_link", f"right_{part}_link"]) == []


def test_fingers_of_both_hands_are_not_exchanged() -> None:
    """Little finger (lf) and ring finger (rf) of Dexmate's hands."""
    names = ["L_lf_j1", "L_rf_j1", "R_lf_j1", "R_rf_j1"]
    assert find_mirror_pairs(names) == [("L_lf_j1", "R_lf_j1"), ("L_rf_j1", "R_rf_j1")]


@pytest.mark.parametrize(
    "name",
    [
        *("base", "roll", "floor", "world", "RRR", "calf"),
        *("upright_link", "bright", "Upright", "mastUpright", "UPRIGHT", "cleft", "self_righting"),
    ],
)
def test_name_without_a_side_is_its_own_mirror_name(name: str) -> None:
    assert mirror_name(name) == name


def test_each_name_has_at_most_one_partner() -> None:
    """A planar walker has ``foot`` and ``foot_left``; here both feet have their own names."""
    assert find_mirror_pairs(["foot", "foot_left"]) == [("foot", "foot_left")]
    assert find_mirror_pairs(["L_foot", "R_foot", "L_foot_left"]) == [("L_foot", "R_foot")]


def test_short_name_of_a_wheel_is_paired_although_it_is_a_word() -> None:
    assert find_mirror_pairs(["fright_wheel", "fleft_wheel"]) == [("fright_wheel", "fleft_wheel")]
