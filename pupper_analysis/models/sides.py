"""What names of links and joints say: which are each other's mirror image, which are of legs."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

_SIDES = (
    *(("left", "right"), ("Left", "Right"), ("LEFT", "RIGHT")),
    *(("FL", "FR"), ("RL", "RR"), ("HL", "HR"), ("BL", "BR"), ("LF", "RF"), ("LH", "RH")),
    *(("fl", "fr"), ("rl", "rr"), ("hl", "hr"), ("bl", "br"), ("lf", "rf"), ("lh", "rh")),
    *(("L", "R"), ("l", "r")),
)
_OPPOSITE_SIDE = {a: b for left, right in _SIDES for a, b in ((left, right), (right, left))}
_WORD = re.compile("left|right|Left|Right|LEFT|RIGHT")
_SIDE_PATTERN = re.compile(
    rf"(?<![A-Za-z])({'|'.join(sorted(_OPPOSITE_SIDE, key=len, reverse=True))})(?![A-Za-z])"
    "|^[LR](?=[A-Z][a-z])"
)

NOT_MIRRORED = re.compile("gripper|finger|camera|imu|sensor", re.IGNORECASE)
"""Parts that are mounted as they are, or turned, on both sides."""


OF_LEGS = re.compile("hip|thigh|knee|calf|shank|ankle|foot|wheel", re.IGNORECASE)
"""In names of joints that are not those of an arm or a hand, whose base is bolted down."""

DRIVE = 0.02
"""Relative: published motors of one kind are stated alike to the digit."""

ALIKE = 3
"""Pairs that agree for each one that does not: where motors were identified one by one, none do."""

ANY_MOTOR = 20.0
"""Times: what no two motors of one place of two legs differ by. Identified one by one, those of
five published robots differ by 13 in armature."""


def mirror_name(name: str) -> str:
    """Returns a name with left and right exchanged, wherever it says so."""
    pattern = _WORD if _WORD.search(name) else _SIDE_PATTERN
    return pattern.sub(lambda match: _OPPOSITE_SIDE[match[0]], name)


def mirror_pairs(names: Iterable[str]) -> list[tuple[str, str]]:
    """Returns the pairs of names that differ only in saying left and right, in their order."""
    known = dict.fromkeys(names)
    pairs: dict[str, str] = {}
    for name in known:
        other = mirror_name(name)
        if (
            other != name
            and other in known
            and other not in pairs
            and not NOT_MIRRORED.search(name)
        ):
            pairs[name] = other
    return list(pairs.items())


def unlike_pairs(
    pairs: Iterable[tuple[str, str]], numbers: Mapping[str, float]
) -> list[tuple[str, str]]:
    """Returns the pairs of joints of which one has another motor, damper or spring.

    Those that differ where most are alike; where motors were identified one by one, those that
    differ by more than any two motors do.

    Args:
        pairs: Left and right.
        numbers: {joint: what is compared}; of a pair, both or it is passed over.
    """
    known = [(a, b) for a, b in pairs if a in numbers and b in numbers]
    apart = [(a, b) for a, b in known if not _near(numbers[a], numbers[b])]
    few = len(known) - len(apart) >= ALIKE * len(apart)
    ends = [(pair, sorted(abs(numbers[name]) for name in pair)) for pair in apart]
    return [pair for pair, (least, most) in ends if few or least * ANY_MOTOR <= most]


def _near(one: float, two: float) -> bool:
    return one == two or abs(one - two) <= DRIVE * abs(two)
