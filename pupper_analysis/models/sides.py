"""Left-right symmetry of joints and links, derived from names such as ``FL_knee``.

`find_mirror_pairs` pairs the names that differ only in a word for left or right. One of the two
names may lack the word. `find_unlike_pairs` selects pairs with an unexpected difference of motor
parameters, which indicates an error in a file.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Final

_SIDE_WORDS = (
    *(("left", "right"), ("Left", "Right"), ("LEFT", "RIGHT")),
    *(("FL", "FR"), ("RL", "RR"), ("HL", "HR"), ("BL", "BR"), ("LF", "RF"), ("LH", "RH")),
    *(("fl", "fr"), ("rl", "rr"), ("hl", "hr"), ("bl", "br"), ("lf", "rf"), ("lh", "rh")),
    *(("L", "R"), ("l", "r")),
)
"""(left, right) words in names of joints and links."""

_OPPOSITE_SIDE = {a: b for left, right in _SIDE_WORDS for a, b in ((left, right), (right, left))}
"""{word of a side: word of the opposite side}."""

_FULL_WORD = re.compile("left|right|Left|Right|LEFT|RIGHT")
"""Pattern of a written-out side, which has priority over abbreviations."""

_OTHER_WORD = re.compile(
    r"(?:(?<![A-Za-z])|(?<=[a-z])(?=[A-Z]))"
    "(?i:(?:up|b|f|w|a|al|out|down|forth|birth|copy|eye|play|wheel)right"
    "|right(?:ing|ful|eous)|cleft|leftover)"
)
"""Pattern of words that contain ``left`` or ``right``, but name no side, at the start of a word."""

_SIDE_PATTERN = re.compile(
    rf"(?<![A-Za-z])({'|'.join(sorted(_OPPOSITE_SIDE, key=len, reverse=True))})(?![A-Za-z])"
    "|^[LR](?=[A-Z][a-z])"
)
"""Pattern of the word for a side (such as left) in a name. No letter may be directly before or
after the word. Exception: a capitalised word may follow L or R at the start."""

ASYMMETRIC_PART_NAME = re.compile(
    "gripper|finger|camera|realsense|kinect|lidar|imu|sensor", re.IGNORECASE
)
"""Pattern in the names of parts that are often not mounted as mirror images of each other, such as
cameras.
"""


LEG_JOINT_NAME = re.compile("hip|thigh|knee|calf|shank|ankle|foot|wheel", re.IGNORECASE)
"""Pattern of the names of leg joints."""

_MOTOR_PARAMETER_RTOL = 0.02
"""Relative tolerance for equal motor parameters. Chosen, not tuned: in published models, motors of
the same type have identical values."""

_MIN_EQUAL_PAIRS_PER_UNEQUAL = 3
"""Ratio (pairs with equal left and right motor) / (unequal pairs), from which each unequal pair is
reported: the model then has a single set of values per motor type. Chosen, not tuned.
"""

_MIN_REPORTED_RATIO = 20.0
"""Ratio between the values of left and right motor, from which a pair is reported in any case.
Chosen: in five published robots, individually identified armatures differ by a factor of at most
13.
"""


def mirror_name(name: str) -> str:
    """Return a name with left and right exchanged, for example ``FR_knee`` for ``FL_knee``.

    Written-out sides have priority over abbreviations: ``R_lf_j1`` is a joint of the little finger
    of the right hand. A name without a side, such as ``upright``, is returned unchanged.
    """
    word_spans = [match.span() for match in _OTHER_WORD.finditer(name)]

    def is_side(match: re.Match[str]) -> bool:
        """Return True if a match is no part of another word."""
        return not any(start <= match.start() and match.end() <= end for start, end in word_spans)

    for pattern in (_FULL_WORD, _SIDE_PATTERN):
        sides = [match for match in pattern.finditer(name) if is_side(match)]
        if pattern is _SIDE_PATTERN:
            sides = [match for match in sides if match[0].isupper() == sides[0][0].isupper()]
        if sides:
            for match in reversed(sides):
                name = name[: match.start()] + _OPPOSITE_SIDE[match[0]] + name[match.end() :]
            return name
    return name


def _list_mirror_names(name: str) -> tuple[str, str]:
    """Return the possible names of the partner of a link or joint, the most probable first.

    The second exchanges each ``left`` and ``right``, also in ``fright_wheel``: front right.
    """
    return mirror_name(name), _FULL_WORD.sub(lambda match: _OPPOSITE_SIDE[match[0]], name)


def find_mirror_pairs(names: Iterable[str]) -> list[tuple[str, str]]:
    """Return the pairs of names that differ only in the word for left or right.

    ``foot`` of a planar walker may be paired with ``foot_left`` or ``foot_right``. Names of
    asymmetric parts, such as cameras, are excluded (``ASYMMETRIC_PART_NAME``).
    """
    names_in_order = dict.fromkeys(names)
    pairs: dict[str, str] = {}
    paired: set[str] = set()
    for name in names_in_order:
        for mirrored in _list_mirror_names(name):
            if (
                mirrored != name
                and mirrored in names_in_order
                and not paired & {name, mirrored}
                and not ASYMMETRIC_PART_NAME.search(name)
            ):
                pairs[name] = mirrored
                paired |= {name, mirrored}
    for name in names_in_order:
        for side, other in (("left", "right"), ("right", "left")):
            sided = f"{name}_{side}"
            is_paired = sided in names_in_order and f"{name}_{other}" not in names_in_order
            if is_paired and not paired & {name, sided} and not ASYMMETRIC_PART_NAME.search(name):
                pairs[name] = sided
                paired |= {name, sided}
    return list(pairs.items())


def find_unlike_pairs(
    pairs: Iterable[tuple[str, str]], numbers: Mapping[str, float]
) -> list[tuple[str, str]]:
    """Return the left-right pairs of joints whose values of one parameter differ unexpectedly.

    Pairs that differ by a factor of at least ``_MIN_REPORTED_RATIO`` are returned. Other unequal
    pairs are returned if at least ``_MIN_EQUAL_PAIRS_PER_UNEQUAL`` times as many pairs are equal.
    They are also returned if the unequal pairs have no more distinct values than pairs: the motors
    of a type then have a single set of values.

    Args:
        pairs: Pairs of a left and a right joint, in any order.
        numbers: {joint: value} of one parameter, for example armature, in a common unit. Pairs
            without both values are skipped.
    """
    complete = [(a, b) for a, b in pairs if a in numbers and b in numbers]
    unequal = [(a, b) for a, b in complete if not _are_equal(numbers[a], numbers[b])]
    few_unequal = len(complete) - len(unequal) >= _MIN_EQUAL_PAIRS_PER_UNEQUAL * len(unequal)
    distinct = {numbers[name] for pair in unequal for name in pair}
    shared = len(distinct) <= len(unequal)
    ranges = [(pair, sorted(abs(numbers[name]) for name in pair)) for pair in unequal]
    return [
        pair
        for pair, (smaller, larger) in ranges
        if few_unequal or shared or smaller * _MIN_REPORTED_RATIO <= larger
    ]


def _are_equal(first: float, second: float) -> bool:
    """Return True if two motor parameters agree within ``_MOTOR_PARAMETER_RTOL`` (relative)."""
    return first == second or abs(first - second) <= _MOTOR_PARAMETER_RTOL * abs(second)


_LIMB_SHORT_NAMES: Final = ("fl", "fr", "rl", "rr", "hl", "hr", "bl", "br", "lf", "rf", "lh", "rh")
"""Two-letter names of limbs: front, rear, hind or back, and left or right."""
_SIDE_TOKENS: Final = frozenset(
    {*_LIMB_SHORT_NAMES, "l", "r", "lr", "left", "right", "front", "rear", "hind", "back", "middle"}
)
"""Words in names that distinguish limbs, in lower case, which `strip_sides` removes."""


def strip_sides(name: str) -> str:
    """Return a name without the words that distinguish limbs: ``calf`` for ``FL_calf``.

    The result is in lower case, with underscores between the remaining words.
    """
    words = re.split(r"[_\-. ]+", re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower())
    return "_".join(word for word in words if word not in _SIDE_TOKENS)
