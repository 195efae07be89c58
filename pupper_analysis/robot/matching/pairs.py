"""Which joints of two files are the same: by name, by part of it, by link, by structure."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
from lxml import etree

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.models.multibody import MultibodyTree
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.robot.matching.structure import match_by_structure


@dataclass(frozen=True, eq=False)
class Pairs:
    """Which joints are the same, which of them were matched otherwise than by name, and notes."""

    pairs: dict[str, str]
    guessed: dict[str, str]
    notes: list[Diagnostic]


def pair_up(
    root: etree._Element,
    spec: mujoco.MjSpec,
    tree: MultibodyTree,
    files: tuple[Path, Path],
    joints: tuple[Sequence[str], Sequence[str]],
    wanted: Mapping[str, str],
) -> Pairs:
    """Matches the joints: by ``wanted``, by name, by part of it, by link, and by structure.

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
    by_link = _by_link(root, spec, pairs)
    guessed |= by_link
    pairs |= by_link
    guess = match_by_structure(root, files[0], tree, pairs)
    guessed |= guess.pairs
    pairs |= guess.pairs
    choices = {one: others for one, others in guess.choices.items() if one not in pairs}
    fewer = min(len(mine), len(theirs))
    if not pairs and not choices:
        problem = diagnose("no-joint-paired", other=files[1], urdf=mine, mjcf=theirs)
        raise ModelError(files[0], problem)
    if (2 * len(pairs) < fewer and len(pairs) > told) or not pairs:
        partners = set(pairs.values())
        raise ModelError(
            files[0],
            diagnose(
                "too-few-joints-in-common",
                count=len(pairs),
                joints=fewer,
                other=files[1],
                choices=[_options(one, others) for one, others in choices.items()],
                alone=[name for name in mine if name not in {*pairs, *choices}],
                free=[name for name in theirs if name not in partners],
            ),
        )
    notes = [
        diagnose(
            "joint-matches-several",
            subject=("joint", one),
            candidates=others,
            options=_options(one, others),
        )
        for one, others in choices.items()
    ]
    return Pairs(pairs, guessed, notes)


def _options(one: str, others: Sequence[str]) -> Diagnostic:
    """Returns the options by which a user says which joint another is."""
    options = [f"--map {one}={other}" for other in others]
    return diagnose("ways-to-map", subject=("joint", one), options=options)


def _by_link(root: etree._Element, spec: mujoco.MjSpec, pairs: Mapping[str, str]) -> dict[str, str]:
    """Matches joints by what they move: links and bodies of one name, but for affixes.

    Exporters make up the joints' names (``dof_1``, ``A_to_B``) where the links have their own.
    """
    mine = {joint.name: joint.child for joint in UrdfTree(root).moving}
    movers = [body for body in spec.bodies if len(list(body.joints)) == 1]
    theirs = {body.joints[0].name: body.name for body in movers}
    known = {mine[one]: theirs[two] for one, two in pairs.items() if one in mine and two in theirs}
    links, bodies = list(mine.values()), list(theirs.values())
    taken = set(known.values())
    known |= {name: name for name in links if name in bodies and name not in {*known, *taken}}
    known |= without_affixes(links, bodies, known)
    of_body = {body: joint for joint, body in theirs.items()}
    return {
        joint: of_body[known[link]]
        for joint, link in mine.items()
        if joint not in pairs and link in known
    }


_EMPTY = {"joint", "jnt", "link"}
"""Words that say nothing about which joint it is."""


def without_affixes(
    mine: Sequence[str], theirs: Sequence[str], pairs: Mapping[str, str]
) -> dict[str, str]:
    """Matches names that are equal but for prefixes (``panda_``) and suffixes (``_joint``).

    What begins or ends most names of one file is left out, and so are words like ``joint``; upper
    and lower case, and how words are joined, do not count. Each is the only one of its kind.

    Args:
        mine: The names in the URDF.
        theirs: The names in the MJCF.
        pairs: What is matched already.

    Returns:
        {name in the URDF: name in the MJCF}.
    """
    one = _cores([name for name in mine if name not in pairs], mine)
    taken = set(pairs.values())
    two = _cores([name for name in theirs if name not in taken], theirs)
    return {one[core]: two[core] for core in one if core in two}


def _cores(names: Collection[str], every: Sequence[str]) -> dict[tuple[str, ...], str]:
    """Returns {what is left of a name: the name}, where that is one alone."""
    words = {name: _words(name) for name in every}
    usual = [_usual(list(words.values())), _usual([each[::-1] for each in words.values()])]
    cores: dict[tuple[str, ...], list[str]] = {}
    for name in names:
        core = words[name]
        for ends in usual:  # what begins it, and then, backwards, what ends it
            for word in ends:
                if len(core) > 1 and core[0] == word:
                    core = core[1:]
            core = core[::-1]
        kept = tuple(word for word in core if word not in _EMPTY)
        cores.setdefault(kept or core, []).append(name)
    return {core: found[0] for core, found in cores.items() if len(found) == 1}


def _usual(words: Sequence[tuple[str, ...]]) -> list[str]:
    """Returns the words, one after the other, with which most names begin."""
    found: list[str] = []
    while True:
        begun = [each for each in words if list(each[: len(found)]) == found]
        next_ones = Counter(each[len(found)] for each in begun if len(each) > len(found) + 1)
        word, count = next_ones.most_common(1)[0] if next_ones else ("", 0)
        if count < max(2, 0.6 * len(words)):
            return found
        found.append(word)


def _words(name: str) -> tuple[str, ...]:
    return tuple(word for word in re.split(r"[^A-Za-z0-9]+", name.lower()) if word) or (name,)
