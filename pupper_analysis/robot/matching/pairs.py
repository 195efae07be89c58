"""Matching of the joints of two files: by name, by name without affixes, and by position and axis.

Input: joints of a URDF and of an MJCF. Output: ``Pairs``. Requested pairs have priority, then equal
names, then names that are equal without common prefixes and suffixes. Finally, joints below matched
parents are matched if their axes are parallel, and their distance is small.
"""

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
from pupper_analysis.base.inputs import name_files
from pupper_analysis.models.multibody import MultibodyTree
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.robot.matching.trees import list_joint_axes_at_zero, urdf_tree


@dataclass(frozen=True, eq=False)
class Pairs:
    """Matched joints of a URDF and an MJCF.

    Attributes:
        pairs: {joint in the URDF: joint in the MJCF}.
        guessed: The entries of ``pairs`` that are neither requested nor have equal names.
        notes: Diagnostics of unmatched joints with candidates in the other file.
    """

    pairs: dict[str, str]
    guessed: dict[str, str]
    notes: list[Diagnostic]


def match_joints(
    root: etree._Element,
    tree: MultibodyTree,
    files: tuple[Path, Path],
    joints: tuple[Sequence[str], Sequence[str]],
    wanted: Mapping[str, str],
) -> Pairs:
    """Match the joints of a URDF and an MJCF by request, by name, and by structure.

    Args:
        root: Root element of the URDF.
        tree: Tree of the MJCF.
        files: Paths of the URDF and the MJCF.
        joints: Names of the joints of the URDF, and of the MJCF.
        wanted: {joint in the URDF: joint in the MJCF} requested by the user. Entries with other
            names, for example of frames, are ignored.

    Raises:
        ModelError: If too few joints are matched, or Pinocchio cannot read the URDF.
    """
    urdf_joints, mjcf_joints = joints
    pairs = {old: new for old, new in wanted.items() if old in urdf_joints and new in mjcf_joints}
    num_requested = len(pairs)
    taken = set(pairs.values())
    mjcf_names, used = set(mjcf_joints), {*pairs, *taken}
    pairs |= {name: name for name in urdf_joints if name in mjcf_names and name not in used}
    guessed = match_without_affixes(urdf_joints, mjcf_joints, pairs)
    pairs |= guessed
    guess = match_by_structure(urdf_tree(root, files[0]), tree, pairs)
    guessed |= guess.pairs
    pairs |= guess.pairs
    choices = {
        urdf_joint: candidates
        for urdf_joint, candidates in guess.choices.items()
        if urdf_joint not in pairs
    }
    num_joints = min(len(urdf_joints), len(mjcf_joints))
    if not pairs and not choices:
        urdf, mjcf = name_files(*files)
        problem = diagnose("no-joint-paired", other=mjcf, urdf=urdf_joints, mjcf=mjcf_joints)
        raise ModelError(urdf, problem)
    if (2 * len(pairs) < num_joints and len(pairs) > num_requested) or not pairs:
        partners = set(pairs.values())
        raise ModelError(
            files[0],
            diagnose(
                "too-few-joints-in-common",
                count=len(pairs),
                joints=num_joints,
                other=files[1],
                choices=[
                    _list_map_options(urdf_joint, candidates)
                    for urdf_joint, candidates in choices.items()
                ],
                alone=[name for name in urdf_joints if name not in {*pairs, *choices}],
                free=[name for name in mjcf_joints if name not in partners],
            ),
        )
    notes = [
        diagnose(
            "joint-matches-several",
            subject=("joint", urdf_joint),
            candidates=candidates,
            options=_list_map_options(urdf_joint, candidates),
        )
        for urdf_joint, candidates in choices.items()
    ]
    return Pairs(pairs, guessed, notes)


def _list_map_options(urdf_joint: str, candidates: Sequence[str]) -> Diagnostic:
    """Return a diagnostic with an option ``--map URDF_JOINT=CANDIDATE`` for each candidate."""
    options = [f"--map {urdf_joint}={candidate}" for candidate in candidates]
    return diagnose("ways-to-map", subject=("joint", urdf_joint), options=options)


_GENERIC_WORDS = {"joint", "jnt", "link"}
"""Words that are ignored when the joint names of two files are compared, unless a name has no other
words."""


def match_without_affixes(
    urdf_names: Sequence[str], mjcf_names: Sequence[str], pairs: Mapping[str, str]
) -> dict[str, str]:
    """Match names that are equal except for prefixes (``panda_``) and suffixes (``_joint``).

    Upper and lower case, and separators, are ignored. Names match if the remaining words are equal,
    and unique among the unmatched names of each file.

    Args:
        urdf_names: Names in the URDF.
        mjcf_names: Names in the MJCF.
        pairs: {name in the URDF: name in the MJCF} of names that are matched already.

    Returns:
        {name in the URDF: name in the MJCF} of the new matches.
    """
    urdf_cores = _find_cores([name for name in urdf_names if name not in pairs], urdf_names)
    taken = set(pairs.values())
    mjcf_cores = _find_cores([name for name in mjcf_names if name not in taken], mjcf_names)
    return {urdf_cores[core]: mjcf_cores[core] for core in urdf_cores if core in mjcf_cores}


def _find_cores(names: Collection[str], every: Sequence[str]) -> dict[tuple[str, ...], str]:
    """Return {words without prefix and suffix common in ``every``: name}, for unique words."""
    words = {name: _split_words(name) for name in every}
    affixes = [
        _find_common_prefix(list(words.values())),
        _find_common_prefix([name_words[::-1] for name_words in words.values()]),
    ]
    cores: dict[tuple[str, ...], list[str]] = {}
    for name in names:
        core = words[name]
        for affix in affixes:  # prefix, then the suffix on the reversed words
            for word in affix:
                if len(core) > 1 and core[0] == word:
                    core = core[1:]
            core = core[::-1]
        kept = tuple(word for word in core if word not in _GENERIC_WORDS)
        cores.setdefault(kept or core, []).append(name)
    return {core: matching[0] for core, matching in cores.items() if len(matching) == 1}


def _find_common_prefix(words: Sequence[tuple[str, ...]]) -> list[str]:
    """Return the first words that at least 60 % of the names, and at least two, have in common.

    A name that consists of these words alone is not counted.
    """
    prefix: list[str] = []
    while True:
        with_prefix = [
            name_words for name_words in words if list(name_words[: len(prefix)]) == prefix
        ]
        next_words = Counter(
            name_words[len(prefix)]
            for name_words in with_prefix
            if len(name_words) > len(prefix) + 1
        )
        word, count = next_words.most_common(1)[0] if next_words else ("", 0)
        if count < max(2, 0.6 * len(words)):
            return prefix
        prefix.append(word)


def _split_words(name: str) -> tuple[str, ...]:
    """Return the alphanumeric words of a name in lower case; the name itself if it has none."""
    return tuple(word for word in re.split(r"[^A-Za-z0-9]+", name.lower()) if word) or (name,)


_MIN_AXIS_COSINE = 0.99
"""|cosine| of the angle between two joint axes [1] above which the axes count as parallel: 8 deg.
Only joints with parallel axes are matched by position. Chosen, not tuned."""

_MAX_RELATIVE_DISTANCE = 0.25
"""Maximum distance between two joints that may be matched by position, relative to the largest
distance of a joint of the URDF from its base [1]. Chosen, not tuned."""


def common_frames(
    root: etree._Element, spec: mujoco.MjSpec, names: Mapping[str, str]
) -> dict[str, tuple[str, str]]:
    """Find the frames, such as feet, that both URDF and MJCF contain.

    A frame is a link on a fixed joint in the URDF, and a site, or a body without joints, in the
    MJCF. The bodies of a fixed base are excluded, because each file may choose the frame of the
    base freely.

    Args:
        root: Root element of the URDF.
        spec: The MJCF. With ``fusestatic``, its bodies are no frames, because MuJoCo merges fixed
            bodies.
        names: {link in the URDF: name in the MJCF} of frames whose names differ.

    Returns:
        {name in the MJCF: (link of the URDF, name in the MJCF)}.
    """
    places = {site.name for site in spec.sites if site.name}
    base = _find_base_bodies(spec)
    places |= {
        body.name
        for body in spec.bodies
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


def _find_base_bodies(spec: mujoco.MjSpec) -> set[str]:
    """Find the bodies of a fixed base: static bodies, with joints in their subtrees."""
    names, pending = set(), list(spec.worldbody.bodies)
    while pending:
        body = pending.pop()
        if not list(body.joints) and body.find_all(mujoco.mjtObj.mjOBJ_JOINT):
            names.add(body.name)
            pending += body.bodies
    return names


@dataclass(frozen=True, eq=False)
class Guess:
    """Joints of a URDF and an MJCF that were matched by structure.

    Attributes:
        pairs: {joint in the URDF: joint in the MJCF}.
        choices: {joint in the URDF: candidates in the MJCF} of ambiguous joints.
    """

    pairs: Mapping[str, str]
    choices: Mapping[str, tuple[str, ...]]


def match_by_structure(urdf: MultibodyTree, mjcf: MultibodyTree, pairs: Mapping[str, str]) -> Guess:
    """Match the unmatched joints of two trees by position and axis below matched parents.

    If ``pairs`` is empty, and the base frames of the files are rotated relative to each other, each
    leg may be matched with a wrong leg. Uncertain matches are returned as candidates
    (`Guess.choices`).

    Args:
        urdf: Tree of the URDF.
        mjcf: Tree of the MJCF.
        pairs: {joint in the URDF: joint in the MJCF} of joints that are matched already.
    """
    num_unmatched, num_candidates = (
        len(set(urdf.joints) - set(pairs)),
        len(set(mjcf.joints) - set(pairs.values())),
    )
    if not num_unmatched or not num_candidates:
        return Guess({}, {})
    best = _match_by_position(urdf, mjcf, pairs)
    if pairs or len(best.pairs) == min(num_unmatched, num_candidates):
        return best
    return Guess(
        {}, {**{name: (candidate,) for name, candidate in best.pairs.items()}, **best.choices}
    )


def _match_by_position(urdf: MultibodyTree, mjcf: MultibodyTree, pairs: Mapping[str, str]) -> Guess:
    """Match unmatched joints of two trees at zero angles, from the base outwards.

    Joints match if their parents match, their axes are parallel, and no other candidate is
    similarly near. Ambiguous joints are returned as `Guess.choices`.
    """
    unmatched, candidates = set(urdf.joints) - set(pairs), set(mjcf.joints) - set(pairs.values())
    urdf_places, mjcf_places = list_joint_axes_at_zero(urdf), list_joint_axes_at_zero(mjcf)
    size = max(float(np.linalg.norm(place[0])) for place in urdf_places.values())
    partner = {urdf.base: mjcf.base, **pairs}
    guessed: dict[str, str] = {}
    choices: dict[str, tuple[str, ...]] = {}

    def joint_distance(name: str, other: str) -> float:
        """Return the distance [m] of two joints; infinite if too far, or axes not parallel."""
        (position, axis), (other_position, other_axis) = urdf_places[name], mjcf_places[other]
        distance = float(np.linalg.norm(position - other_position))
        parallel = abs(float(axis @ other_axis)) > _MIN_AXIS_COSINE
        return distance if parallel and distance <= _MAX_RELATIVE_DISTANCE * size else np.inf

    for parent in (urdf.base, *urdf.joints):  # parents first
        partner_parent = partner.get(parent)
        urdf_joints = [name for name in urdf.children(parent) if name in unmatched]
        mjcf_joints = [
            joint for joint in mjcf.children(partner_parent or "") if joint in candidates
        ]
        if partner_parent is None or not urdf_joints or not mjcf_joints:
            continue
        distances = np.array(
            [
                [joint_distance(name, mjcf_joint) for mjcf_joint in mjcf_joints]
                for name in urdf_joints
            ]
        )
        for row, name in enumerate(urdf_joints):
            column = int(np.argmin(distances[row]))
            minimum = distances[row, column]
            rivals = np.concatenate(
                [np.delete(distances[row], column), np.delete(distances[:, column], row)]
            )
            if np.isfinite(minimum) and (minimum < 0.5 * rivals).all():
                guessed[name] = partner[name] = mjcf_joints[column]
            elif np.isfinite(minimum):
                choices[name] = tuple(
                    mjcf_joint
                    for mjcf_joint, distance in zip(mjcf_joints, distances[row], strict=True)
                    if np.isfinite(distance)
                )
    used = set(guessed.values())
    remaining_choices = {
        name: tuple(joint for joint in mjcf_joints_left if joint not in used)
        for name, mjcf_joints_left in choices.items()
    }
    return Guess(guessed, {name: joints for name, joints in remaining_choices.items() if joints})
