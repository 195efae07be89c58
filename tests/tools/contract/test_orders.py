"""Patterns of joint names, which may come from a file that someone else has written."""

from __future__ import annotations

import re

import pytest

from pupper_analysis.tools.contract.orders import is_pattern, matches_name

NAMES = ("FL_hip_joint", "FL_thigh_joint", "RR_calf_joint", "left arm?", "a" * 40)

HOSTILE = (
    "(a|a)" * 40 + "b",  # 2^40 paths, without a quantifier
    "(a|aa)(a|aa)" * 15 + "b",
    "(?x)(a+) +b",  # (a+)+b with the flag that ignores spaces
    "(?i-m:(?x: (a+) +b))",
    "(a+)+b",
    "a?" * 40 + "a" * 40,
    "(.*)(.*)(.*)(.*)(.*)(.*)b",
    "(a|b)" * 10_000,
    "{" * 10_000,
)


@pytest.mark.parametrize("pattern", HOSTILE)
def test_pattern_with_too_many_paths_matches_nothing(pattern: str) -> None:
    """Without the bound, each of the first seven needs from seconds to years for 40 letters."""
    assert not is_pattern(pattern)
    assert not matches_name(pattern, "a" * 40)
    assert matches_name(pattern, pattern)  # a joint may have this name


def test_pattern_is_not_matched_with_a_name_that_is_too_long() -> None:
    """Four quantifiers divide a name of 4,000 letters in 10^13 ways."""
    pattern = "(.*)(.*)(.*)(.*)b"
    assert matches_name(pattern, "a" * 90 + "b")
    assert not matches_name(pattern, "a" * 4000 + "b")


@pytest.mark.parametrize(
    "pattern",
    [
        "(FL|FR|RL|RR)_(hip|thigh|calf)_joint",
        ".*_(hip|calf)_.*",
        "^(?!.*calf)(?!.*arm).*$",
        ".*L_.*_.*j.*",
        r"left\sarm\?",
        "[FR][LR]_(?:hip|calf)?_?joint",
        "[^]?+*({|]+",
        "(?P<side>F.|R.)_.*?joint",
    ],
)
def test_pattern_of_trainers_matches_as_in_python(pattern: str) -> None:
    assert is_pattern(pattern)
    matched = [bool(re.fullmatch(pattern, name)) for name in NAMES]
    assert any(matched)
    assert [matches_name(pattern, name) for name in NAMES] == matched
