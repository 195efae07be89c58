"""Which joints of two files are the same: by name, by part of it, by where they are."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from lxml import etree

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.models.multibody import MultibodyTree
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.robot.matching.trees import at_zero, urdf_tree


@dataclass(frozen=True, eq=False)
class Pairs:
    """Which joints are the same, which of them were matched otherwise than by name, and notes."""

    pairs: dict[str, str]
    guessed: dict[str, str]
    notes: list[Diagnostic]


def pair_up(
    root: etree._Element,
    tree: MultibodyTree,
    files: tuple[Path, Path],
    joints: tuple[Sequence[str], Sequence[str]],
    wanted: Mapping[str, str],
) -> Pairs:
    """Matches the joints: by ``wanted``, by name, by part of it, and by structure.

    Raises:
        ModelError: If fewer than half of the joints have a partner.
    """
    mine, theirs = joints
    pairs = {old: new for old, new in wanted.items() if old in mine and new in theirs}
    message = len(pairs)
    taken = set(pairs.values())
    known, used = set(theirs), {*pairs, *taken}
    pairs |= {name: name for name in mine if name in known and name not in used}
    guessed = without_affixes(mine, theirs, pairs)
    pairs |= guessed
    guess = guess_of_trees(urdf_tree(root, files[0]), tree, pairs)
    guessed |= guess.pairs
    pairs |= guess.pairs
    choices = {one: others for one, others in guess.choices.items() if one not in pairs}
    fewer = min(len(mine), len(theirs))
    if not pairs and not choices:
        problem = diagnose("no-joint-paired", other=files[1], urdf=mine, mjcf=theirs)
        raise ModelError(files[0], problem)
    if (2 * len(pairs) < fewer and len(pairs) > message) or not pairs:
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


_PARALLEL = 0.99  # least |cosine| between the axes of joints that may be one
_POSITION_TOLERANCE = (
    0.25  # greatest distance of joints that may be one, relative to the robot's size
)


def common_frames(
    root: etree._Element, spec: mujoco.MjSpec, names: Mapping[str, str]
) -> dict[str, tuple[str, str]]:
    """Returns the frames of both: links on fixed joints, and sites or bodies without joints.

    A fixed base's body is none of them: where its frame is, is a convention of its own.
    """
    places = {site.name for site in spec.sites if site.name}
    base = _of_base(spec)
    places |= {
        body.name
        for body in spec.bodies
        # MuJoCo makes one body of those that nothing moves, where the file asks for it.
        if not spec.compiler.fusestatic
        and body.name
        and body.name not in base
        and not list(body.joints)
    }
    frames = {}
    for joint in UrdfTree(root).joints.values():
        link = joint.child
        place = names.get(link, link)
        if joint.is_fixed and place in places:
            frames[place] = (link, place)
    return frames


def _of_base(spec: mujoco.MjSpec) -> set[str]:
    """Returns the bodies that stand in the world and carry joints: a fixed base's."""
    found, waiting = set(), list(spec.worldbody.bodies)
    while waiting:
        body = waiting.pop()
        if not list(body.joints) and body.find_all(mujoco.mjtObj.mjOBJ_JOINT):
            found.add(body.name)
            waiting += body.bodies
    return found


@dataclass(frozen=True, eq=False)
class Guess:
    """Joints that structure matches.

    Attributes:
        pairs: {joint in the URDF: joint in the MJCF}.
        choices: {joint in the URDF: joints in the MJCF} where it leaves a choice.
    """

    pairs: Mapping[str, str]
    choices: Mapping[str, tuple[str, ...]]


def guess_of_trees(one: MultibodyTree, two: MultibodyTree, pairs: Mapping[str, str]) -> Guess:
    """Matches the joints of two trees that ``pairs`` lack, by structure.

    Below the same parent, with parallel axes at zero angles, each the nearest to the other. Where
    no name is in common and not all joints match, the base's frame may be turned in one of the
    files, and legs exchanged: what matches is a choice then, and nothing is guessed.
    """
    free, rest = len(set(one.joints) - set(pairs)), len(set(two.joints) - set(pairs.values()))
    if not free or not rest:
        return Guess({}, {})
    best = _in_place(one, two, pairs)
    if pairs or len(best.pairs) == min(free, rest):
        return best
    return Guess({}, {**{name: (other,) for name, other in best.pairs.items()}, **best.choices})


def _in_place(one: MultibodyTree, two: MultibodyTree, pairs: Mapping[str, str]) -> Guess:
    """Matches the joints of two trees where they are."""
    free_one, free_two = set(one.joints) - set(pairs), set(two.joints) - set(pairs.values())
    place_one, place_two = at_zero(one), at_zero(two)
    size = max(float(np.linalg.norm(place[0])) for place in place_one.values())
    partner = {one.base: two.base, **pairs}
    guessed: dict[str, str] = {}
    choices: dict[str, tuple[str, ...]] = {}

    def likeness(name: str, other: str) -> float:
        (here, axis), (there, other_axis) = place_one[name], place_two[other]
        distance = float(np.linalg.norm(here - there))
        parallel = abs(float(axis @ other_axis)) > _PARALLEL
        return distance if parallel and distance < _POSITION_TOLERANCE * size else np.inf

    for parent in (one.base, *one.joints):  # parents first
        twin = partner.get(parent)
        mine = [name for name in one.children(parent) if name in free_one]
        theirs = [other for other in two.children(twin or "") if other in free_two]
        if twin is None or not mine or not theirs:
            continue
        table = np.array([[likeness(name, other) for other in theirs] for name in mine])
        for row, name in enumerate(mine):
            column = int(np.argmin(table[row]))
            least = table[row, column]
            rivals = np.concatenate(
                [np.delete(table[row], column), np.delete(table[:, column], row)]
            )
            if np.isfinite(least) and (least < 0.5 * rivals).all():
                guessed[name] = partner[name] = theirs[column]
            elif np.isfinite(least):
                choices[name] = tuple(
                    other for other, far in zip(theirs, table[row], strict=True) if np.isfinite(far)
                )
    taken = set(guessed.values())
    left = {
        name: tuple(other for other in others if other not in taken)
        for name, others in choices.items()
    }
    return Guess(guessed, {name: others for name, others in left.items() if others})
