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
    ],
)
def test_left_and_right_names_are_mirror_images(left: str, right: str) -> None:
    """Names of published robots."""
    assert mirror_name(left) == right
    assert mirror_name(right) == left
    assert find_mirror_pairs([left, "base", right]) == [(left, right)]


@pytest.mark.parametrize("name", ["base", "roll", "floor", "world", "RRR", "calf"])
def test_name_without_a_side_is_its_own_mirror_name(name: str) -> None:
    assert mirror_name(name) == name
