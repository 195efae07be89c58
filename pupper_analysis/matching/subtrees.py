"""Parts that one file has and the other lacks: a gripper, a tail, a head."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path

import mujoco
from lxml import etree

from pupper_analysis.diagnostics import Diagnostic, Quantity, Term, diagnose
from pupper_analysis.matching.mjcf import mjcf_tree
from pupper_analysis.matching.urdf import urdf_tree
from pupper_analysis.models.free_base import delete_joint
from pupper_analysis.models.joint_kinds import JointKind
from pupper_analysis.models.urdf_tree import UrdfTree

_KINDS = (
    ("gripper", re.compile(r"finger|grip|jaw|claw|pinch", re.IGNORECASE)),
    ("hand", re.compile(r"hand|thumb|palm", re.IGNORECASE)),
    ("head", re.compile(r"head|neck", re.IGNORECASE)),
    ("tail", re.compile(r"tail", re.IGNORECASE)),
    ("arm", re.compile(r"(^|_)arm", re.IGNORECASE)),
)


@dataclass(frozen=True)
class Part:
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


def lacking(part: Part, has: str, lacks: str) -> Diagnostic:
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


def best_parts(candidates: list[list[Part]], short: float) -> list[Part]:
    """Chooses how much to take off a carrier, so that its mass becomes the other file's.

    Args:
        candidates: Ways to take off the joints that one file lacks, the least first.
        short: How much heavier the carrier is than in the other file with all of it left on (kg).

    Returns:
        The parts to be taken off; none if the mass fits best with them left on, at rest.
    """
    best: list[Part] = []
    least = abs(short)
    for parts in candidates:
        off = abs(short - sum(part.mass for part in parts))
        if off < least - 1e-6:
            best, least = parts, off
    return best


def urdf_parts(root: etree._Element, extra: Collection[str]) -> dict[str, list[list[Part]]]:
    """Returns {carrier: ways to take off the joints of a URDF that the MJCF lacks}."""
    tree = UrdfTree(root)

    def part(link: str) -> Part | None:
        inside = list(tree.subtree(link))
        above = [tree.above[name] for name in inside if name in tree.above]
        joints = tuple(joint.name for joint in above if not joint.is_fixed)
        if any(joint not in extra for joint in joints):
            return None
        movers = [joint.name for joint in list(tree.chain(link))[1:] if not joint.is_fixed]
        mass = sum(tree.links[name].mass or 0.0 for name in inside)
        return Part(link, movers[0] if movers else "", joints, mass)

    tops = []
    for link, joint in tree.above.items():
        if joint.name in extra:
            found = part(link)
            if found is not None:
                tops.append(found)

    def parent(link: str) -> str | None:
        up = tree.above[link].parent
        return up if up in tree.above and tree.above[up].is_fixed else None

    return _ways(tops, part, parent)


def mjcf_parts(
    spec: mujoco.MjSpec, model: mujoco.MjModel, extra: Collection[str]
) -> dict[str, list[list[Part]]]:
    """Returns {carrier: ways to take off the joints of an MJCF that the URDF lacks}."""

    def joints_of(body: mujoco.MjsBody) -> list[str]:
        return [joint.name for joint in body.joints]

    def part(name: str) -> Part | None:
        body = spec.body(name)
        every = [body, *body.find_all(mujoco.mjtObj.mjOBJ_BODY)]
        joints = tuple(joint for each in every for joint in joints_of(each))
        if any(joint not in extra for joint in joints):
            return None
        up = body.parent
        while up.name != spec.worldbody.name and not joints_of(up):
            up = up.parent
        carrier = joints_of(up)[-1] if joints_of(up) else ""
        if model.body(name).id and up.name != spec.worldbody.name:
            free = model.body(up.name).jntadr[0]
            if model.jnt_type[free] == JointKind.FREE:
                carrier = ""
        return Part(name, carrier, joints, float(model.body(name).subtreemass[0]))

    tops = []
    for body in spec.bodies:
        if body.name != spec.worldbody.name and set(joints_of(body)) & set(extra):
            found = part(body.name)
            if found is not None:
                tops.append(found)

    def parent(name: str) -> str | None:
        up = spec.body(name).parent
        fixed = up.name != spec.worldbody.name and not joints_of(up)
        return up.name if fixed and up.parent.name != spec.worldbody.name else None

    return _ways(tops, part, parent)


def take_off_mjcf(spec: mujoco.MjSpec, name: str) -> None:
    """Takes a body and all below it out of an MJCF, in place."""
    body = spec.body(name)
    for each in (body, *body.find_all(mujoco.mjtObj.mjOBJ_BODY)):
        for joint in list(each.joints):
            delete_joint(spec, joint)
    spec.delete(body)


def _ways(
    tops: list[Part],
    part: Callable[[str], Part | None],
    parent: Callable[[str], str | None],
) -> dict[str, list[list[Part]]]:
    """Returns {carrier: the parts as they move, and then with more and more of what holds them}."""
    largest = [
        top for top in tops if not any(set(top.joints) < set(other.joints) for other in tops)
    ]
    ways: dict[str, list[list[Part]]] = {}
    for carrier in dict.fromkeys(top.carrier for top in largest):
        level = [top for top in largest if top.carrier == carrier]
        ways[carrier] = [level]
        while True:
            higher: dict[str, Part] = {}
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


Ways = Mapping[str, list[list[Part]]]


def removable(
    root: etree._Element,
    spec: mujoco.MjSpec,
    only_urdf: Collection[str],
    only_mjcf: Collection[str],
) -> tuple[Ways, Ways]:
    """Returns the ways to take off the joints that one file lacks, of the URDF and of the MJCF."""
    mjcf = mjcf_parts(spec, spec.copy().compile(), only_mjcf) if only_mjcf else {}
    return urdf_parts(root, only_urdf), mjcf


def take_off(
    root: etree._Element,
    spec: mujoco.MjSpec,
    files: tuple[Path, Path],
    ways: tuple[Ways, Ways],
    pairs: Mapping[str, str],
) -> list[Diagnostic]:
    """Takes off what one file has and the other lacks, where masses say so; returns what it is."""
    if not any(ways):
        return []
    one, two = urdf_tree(root, files[0]), mjcf_tree(spec, files[1])
    said = []
    for candidates, here, there, words in (
        (ways[0], one, two, ("URDF", "MJCF")),
        (ways[1], two, one, ("MJCF", "URDF")),
    ):
        for carrier, way in candidates.items():
            name = pairs.get(carrier, carrier) if words[0] == "URDF" else carrier
            if name not in here.bodies or name not in there.bodies:
                continue
            short = here.bodies[name].mass - there.bodies[name].mass
            for part in best_parts(way, short):
                said.append(lacking(part, *words))
                if words[0] == "URDF":
                    UrdfTree(root).remove_subtree(part.root)
                else:
                    take_off_mjcf(spec, part.root)
    return said
