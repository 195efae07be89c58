"""Parts that one file has and the other lacks: a gripper, a tail, a head."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path

from pupper_analysis.base.diagnostics import (
    Diagnostic,
    Quantity,
    Term,
    diagnose,
)
from pupper_analysis.models.model_tree import ModelTree
from pupper_analysis.models.spec_tree import SpecTree
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.robot.matching.mjcf import mjcf_tree
from pupper_analysis.robot.matching.urdf import urdf_tree

_KINDS = (
    ("gripper", re.compile(r"finger|grip|jaw|claw|pinch", re.IGNORECASE)),
    ("hand", re.compile(r"hand|thumb|palm", re.IGNORECASE)),
    ("head", re.compile(r"head|neck", re.IGNORECASE)),
    ("tail", re.compile(r"tail", re.IGNORECASE)),
    ("arm", re.compile(r"(^|_)arm", re.IGNORECASE)),
)


@dataclass(frozen=True)
class RemovablePart:
    """A subtree with joints that the other file lacks, as it may be taken off.

    Attributes:
        root: The link or body that goes, with all below it.
        carrier: The moving joint that carries it, by its name in the file; "" for the base.
        joints: The joints in it.
        mass: Of all of it (kg).
    """

    root: str
    carrier: str
    joints: tuple[str, ...]
    mass: float


def tell_lacking(part: RemovablePart, has: str, lacks: str) -> Diagnostic:
    """Tells what one file has and the other lacks."""
    names = [part.root, *part.joints]
    kind = next(
        (word for word, pattern in _KINDS if any(pattern.search(name) for name in names)), "part"
    )
    return diagnose(
        "part-of-one-file",
        subject=("link" if has == "URDF" else "body", part.root),
        has=has,
        lacks=lacks,
        kind=Term(kind),
        arm=kind == "arm",
        carrier=part.carrier,
        mass=Quantity(part.mass, "kg"),
        joints=part.joints,
    )


def best_parts(candidates: list[list[RemovablePart]], short: float) -> list[RemovablePart]:
    """Chooses how much to take off a carrier, so that its mass becomes the other file's.

    Args:
        candidates: Ways to take off the joints that one file lacks, the least first.
        short: How much heavier the carrier is than in the other file with all of it left on (kg).

    Returns:
        The parts to be taken off; none if the mass fits best with them left on, at rest.
    """
    best: list[RemovablePart] = []
    least = abs(short)
    for parts in candidates:
        off = abs(short - sum(part.mass for part in parts))
        if off < least - 1e-6:
            best, least = parts, off
    return best


def parts_of(tree: ModelTree, extra: Collection[str]) -> dict[str, list[list[RemovablePart]]]:
    """Returns {carrier: ways to take off the joints of a file that the other one lacks}."""

    def part(link: str) -> RemovablePart | None:
        inside = list(tree.subtree(link))
        joints = tuple(joint for name in inside for joint in tree.movers(name))
        if any(joint not in extra for joint in joints):
            return None
        carrier = tree.parent(link)
        while carrier is not None and not tree.movers(carrier):
            carrier = tree.parent(carrier)
        mover = tree.movers(carrier)[-1] if carrier is not None else ""
        return RemovablePart(link, mover, joints, sum(map(tree.weight, inside)))

    def holder(link: str) -> str | None:
        up = tree.parent(link)
        return up if up is not None and not tree.movers(up) and tree.parent(up) else None

    tops = [part(link) for link in tree.names if set(tree.movers(link)) & set(extra)]
    return _ways([top for top in tops if top is not None], part, holder)


def _ways(
    tops: list[RemovablePart],
    part: Callable[[str], RemovablePart | None],
    parent: Callable[[str], str | None],
) -> dict[str, list[list[RemovablePart]]]:
    """Returns {carrier: the parts as they move, and then with more and more of what holds them}."""
    largest = [
        top for top in tops if not any(set(top.joints) < set(other.joints) for other in tops)
    ]
    ways: dict[str, list[list[RemovablePart]]] = {}
    for carrier in dict.fromkeys(top.carrier for top in largest):
        level = [top for top in largest if top.carrier == carrier]
        ways[carrier] = [level]
        while True:
            higher: dict[str, RemovablePart] = {}
            for each in level:
                up = parent(each.root)
                found = part(up) if up is not None else None
                higher[found.root if found else each.root] = found or each
            if set(higher) == {each.root for each in level}:
                break
            level = [
                each
                for each in higher.values()
                if not any(set(each.joints) < set(other.joints) for other in higher.values())
            ]
            ways[carrier].append(level)
    return ways


Ways = Mapping[str, list[list[RemovablePart]]]


def removable_subtrees(
    trees: tuple[UrdfTree, SpecTree], only_urdf: Collection[str], only_mjcf: Collection[str]
) -> tuple[Ways, Ways]:
    """Returns the ways to take off the joints that one file lacks, of the URDF and of the MJCF."""
    return parts_of(trees[0], only_urdf), parts_of(trees[1], only_mjcf)


def take_off(
    trees: tuple[UrdfTree, SpecTree],
    files: tuple[Path, Path],
    ways: tuple[Ways, Ways],
    pairs: Mapping[str, str],
) -> list[Diagnostic]:
    """Takes off what one file has and the other lacks, where masses say so; returns what it is."""
    if not any(ways):
        return []
    one, two = urdf_tree(trees[0].root, files[0]), mjcf_tree(trees[1].spec, files[1])
    said = []
    for tree, candidates, here, there, words in (
        (trees[0], ways[0], one, two, ("URDF", "MJCF")),
        (trees[1], ways[1], two, one, ("MJCF", "URDF")),
    ):
        for carrier, way in candidates.items():
            name = pairs.get(carrier, carrier) if words[0] == "URDF" else carrier
            if name not in here.bodies or name not in there.bodies:
                continue
            short = here.bodies[name].mass - there.bodies[name].mass
            for part in best_parts(way, short):
                said.append(tell_lacking(part, *words))
                tree.remove_subtree(part.root)
    return said
