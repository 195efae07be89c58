"""Which joints of two files are the same: by name, by part of the name, by structure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
from lxml import etree

from pupper_analysis.checks.matching_names import without_affixes
from pupper_analysis.checks.matching_structure import guess as guess_by_structure
from pupper_analysis.errors import ModelError


@dataclass(frozen=True, eq=False)
class Pairs:
    """Which joints are the same, which of them were matched otherwise than by name, and notes."""

    pairs: dict[str, str]
    guessed: dict[str, str]
    notes: list[str]


def pair_up(
    root: etree._Element,
    spec: mujoco.MjSpec,
    files: tuple[Path, Path],
    joints: tuple[Sequence[str], Sequence[str]],
    wanted: Mapping[str, str],
) -> Pairs:
    """Matches the joints: by ``wanted``, by name, by name without affixes, and by structure.

    Raises:
        ModelError: If fewer than half of the joints have a partner.
    """
    mine, theirs = joints
    pairs = {old: new for old, new in wanted.items() if old in mine and new in theirs}
    told = len(pairs)
    taken = set(pairs.values())
    known, used = set(theirs), {*pairs, *taken}
    pairs |= {name: name for name in mine if name in known and name not in used}
    guessed = without_affixes(mine, theirs, pairs)
    pairs |= guessed
    guess = guess_by_structure(root, spec, *files, pairs)
    guessed |= guess.pairs
    pairs |= guess.pairs
    choices = {one: others for one, others in guess.choices.items() if one not in pairs}
    lines = [
        " or ".join(f"--map {one}={other}" for other in others) for one, others in choices.items()
    ]
    fewer = min(len(mine), len(theirs))
    if not pairs and not choices:
        raise ModelError(
            files[0],
            f"no joint in common with {files[1]}: {', '.join(mine[:6])} … against "
            f"{', '.join(theirs[:6])} …; name the pairs with a mapping",
        )
    if (2 * len(pairs) < fewer and len(pairs) > told) or not pairs:
        partners = set(pairs.values())
        free = [name for name in theirs if name not in partners]
        hints = [f"--map {name}=..." for name in mine if name not in {*pairs, *choices}]
        raise ModelError(
            files[0],
            f"only {len(pairs)} of {fewer} joints have a partner in {files[1]}, too few to call it "
            f"the same robot; say which are the same: {'; '.join([*lines, *hints])} "
            f"(the MJCF's are {', '.join(free)})",
        )
    notes = [
        f"joint {one} of the URDF may be {' or '.join(choices[one])} of the MJCF; say which: {line}"
        for one, line in zip(choices, lines, strict=True)
    ]
    return Pairs(pairs, guessed, notes)
