"""One slip that explains many differences: a lost tensor, a link that is missing, a decimal point.

Each is tried out: the slip is undone, and what is gone of the differences is what it explains.

Links on fixed joints are folded into the body that carries them before two files are compared: the
fold says that a body differs, and only the links which one. Masses and moments add up, so the
difference of two folded bodies is that of their links. A slip is undone link by link; it is a cause
only if nothing of the body's differences is left then.
"""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.base.arrays import INERTIA_ENTRIES, inertia_tensor
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.models.conversion import inertia_of_body, pinocchio_from_mujoco
from pupper_analysis.models.efforts import effort_of
from pupper_analysis.models.multibody import MultibodyTree, TreeBody
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.robot.compare.differences import (
    OF_INERTIALS,
    Difference,
    PatternCause,
    body_changes,
)
from pupper_analysis.robot.matching.tolerances import Tolerances
from pupper_analysis.robot.matching.trees import kinematic_trees, poses_at_zero
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ComparedLink:
    """One link's inertial, in the frame of the body that it is a part of.

    Attributes:
        name: The URDF's link, or the MJCF's body.
        body: Its mass (kg), com (m) and inertia about that (kg m^2).
        axes: (3, 3) from the link's own axes to the body's.
    """

    name: str
    body: TreeBody
    axes: Array


Links = Mapping[str, tuple[ComparedLink, ...]]
"""{base or joint: the links with mass that move with it}."""


def urdf_links(robot: Robot) -> Links:
    """Returns the links of the URDF's bodies, in the frames of its own tree."""
    model = robot.pin_model
    found: dict[str, list[ComparedLink]] = {}
    for name, link in UrdfTree.of(robot.description.urdf).links.items():
        own = link.inertia
        if own is None or not own.mass or not model.existFrame(name, pin.FrameType.BODY):
            continue
        frame = model.frames[model.getFrameId(name, pin.FrameType.BODY)]
        body = TreeBody.of(own).moved(frame.placement)
        mover = _mover(robot, model, int(frame.parentJoint))
        found.setdefault(mover, []).append(
            ComparedLink(name, body, np.array(frame.placement.rotation))
        )
    return {mover: tuple(links) for mover, links in found.items()}


def mjcf_links(robot: Robot, raw: MultibodyTree, aligned: MultibodyTree) -> Links:
    """Returns the links of the MJCF's bodies, in the frames to which its tree was aligned.

    Args:
        robot: The robot.
        raw: The MJCF's tree, in its own link frames.
        aligned: The same in others.
    """
    model, mujoco_model = pinocchio_from_mujoco(robot.mj_model), robot.mj_model
    here, there = poses_at_zero(raw), poses_at_zero(aligned)
    found: dict[str, list[ComparedLink]] = {}
    for index in np.flatnonzero(mujoco_model.body_mass > 0):
        name = str(mujoco_model.body(index).name)
        frame = model.frames[model.getFrameId(name, pin.FrameType.BODY)]
        mover = _mover(robot, model, int(frame.parentJoint))
        pose = there[mover].actInv(here[mover]) * frame.placement
        own = TreeBody.of(inertia_of_body(mujoco_model, index)).moved(pose)
        found.setdefault(mover, []).append(ComparedLink(name, own, np.array(pose.rotation)))
    return {mover: tuple(links) for mover, links in found.items()}


def _mover(robot: Robot, model: pin.Model, joint: int) -> str:
    """Returns the joint that moves a frame's body, or the base."""
    name = str(model.names[joint])
    return name if name in robot.joint_names else robot.base


def fold_bodies(*bodies: TreeBody) -> TreeBody:
    """Returns one body that is made of some, all in the same frame."""
    return from_moments(sum((body_moments(body) for body in bodies), start=np.zeros(10)))


def body_moments(body: TreeBody) -> Array:
    """Returns a body's mass, first and second moments about its frame's origin (10,).

    They add up when bodies are combined: the mass (kg), the first moments (kg m), and the six
    entries of the inertia about the origin (kg m^2).
    """
    c = body.com
    about = body.inertia + body.mass * (float(c @ c) * np.eye(3) - np.outer(c, c))
    entries = [about[place] for place in INERTIA_ENTRIES.values()]
    return np.array([body.mass, *(body.mass * c), *entries])


def from_moments(values: Array) -> TreeBody:
    """Returns the body of some moments, which `moments` returns."""
    mass = float(values[0])
    com = values[1:4] / mass if mass else np.zeros(3)
    shift = mass * (float(com @ com) * np.eye(3) - np.outer(com, com))
    return TreeBody(mass, com, inertia_tensor(values[4:]) - shift)


Key = tuple[str, str]
"""The kind and the element of a difference."""


@dataclass(frozen=True, eq=False)
class PatternCase:
    """Two trees that differ.

    Attributes:
        robot: The robot.
        first: The URDF's tree.
        second: The MJCF's, in the URDF's link frames.
        keys: The differences.
        tolerances: What counts as one.
        urdf: The links of which the URDF's bodies are made, in the frames of ``first``.
        mjcf: Those of the MJCF's, in the frames of ``second``.
        from_geoms: The MJCF's bodies that take their mass from their geoms.
        taken: Those that a cause explains already.
    """

    robot: Robot
    first: MultibodyTree
    second: MultibodyTree
    keys: Sequence[Key]
    tolerances: Tolerances
    urdf: Links
    mjcf: Links
    from_geoms: Collection[str] = ()
    taken: Collection[Key] = ()

    @property
    def open(self) -> list[Key]:
        """The differences that no cause explains yet."""
        return [key for key in self.keys if key not in self.taken]


@dataclass(frozen=True, eq=False)
class PatternFinding:
    """A slip that explains differences.

    Attributes:
        kind: A cause's.
        diagnostic: What it is, with its numbers.
        explained: The differences.
    """

    kind: str
    diagnostic: Diagnostic
    explained: set[Key]


Found = Iterator[PatternFinding]


def before_gears(case: PatternCase) -> Found:
    """Finds efforts that are the MJCF's once they are multiplied by the gears there."""
    model = case.robot.mj_model
    found: dict[tuple[float, float], list[str]] = defaultdict(list)
    for kind, name in case.open:
        if kind == "effort":
            effort = case.first.joints[name].effort
            gear = effort_of(model, model.joint(name).id, effort).gear
            if gear != 1.0:
                found[effort, gear].append(name)
    if not found:
        return
    efforts = [
        diagnose("effort-times-gear", effort=effort, gear=gear, product=effort * gear, joints=names)
        for (effort, gear), names in found.items()
    ]
    joints = [name for names in found.values() for name in names]
    yield PatternFinding(
        "gears",
        diagnose("efforts-before-gears", count=len(joints), efforts=efforts),
        {("effort", name) for name in joints},
    )


def dropped_products(case: PatternCase, lacking: str) -> Found:
    """Finds that one file has no products of inertia at all.

    They are dropped in the other file, in each link's own axes or, had they been folded before, in
    those of the body that carries it: then the two are alike.

    Args:
        case: The two trees.
        lacking: The file that is to have none, ``URDF`` or ``MJCF``.
    """
    if sum(kind == "inertia" for kind, _ in case.open) < 2:
        return
    bare, full = (case.urdf, case.mjcf) if lacking == "URDF" else (case.mjcf, case.urdf)
    tree, other = (case.second, case.first) if lacking == "URDF" else (case.first, case.second)
    if not all(_is_diagonal(_own(link)) for links in bare.values() for link in links):
        return
    in_links = {
        name: tuple(_without_products(link) for link in links) for name, links in full.items()
    }
    of_links = {
        name: fold_bodies(*(link.body for link in in_links.get(name, ()))) for name in tree.bodies
    }
    of_folds = {
        name: replace(body, inertia=_diagonal(body.inertia)) for name, body in tree.bodies.items()
    }
    for bodies in (of_links, of_folds):
        left = {
            (change.kind, name)
            for name, body in bodies.items()
            for change in body_changes(name, body, other.bodies[name], case.tolerances)
            if change.kind == "inertia"
        }
        gone = {key for key in case.open if key[0] == "inertia"} - left
        if len(gone) > 1 and left <= set(case.keys):
            count = sum(not _is_diagonal(_own(link)) for group in full.values() for link in group)
            yield PatternFinding(
                "products",
                diagnose("products-of-inertia-dropped", file=lacking, count=count),
                gone,
            )
            return


def _own(link: ComparedLink) -> Array:
    """Returns the inertia of a link in its own axes."""
    return link.axes.T @ link.body.inertia @ link.axes


def _without_products(link: ComparedLink) -> ComparedLink:
    bare = link.axes @ _diagonal(_own(link)) @ link.axes.T
    return replace(link, body=replace(link.body, inertia=bare))


def _diagonal(inertia: Array) -> Array:
    return np.diag(np.diag(inertia))


def _is_diagonal(inertia: Array) -> bool:
    off = inertia - _diagonal(inertia)
    return float(np.abs(off).max()) <= 1e-9 * max(float(np.abs(inertia).max()), 1e-300)


def find_dropped(case: PatternCase) -> Found:
    """Finds what one file has left out of its inertials."""
    for file in ("URDF", "MJCF"):
        yield from dropped_products(case, file)


_MOST_SUBSET_LINKS = 12
"""Links of one body of which every subset is tried: 4096 of them, in a millisecond."""

_MOST_RESIDUAL = 0.02
"""Share of a body's difference that may be left where a slip is undone.

Files of 5 to 6 digits leave some thousandths of a link that is a hundredth of its body. A wrong set
of links leaves about as much as it takes away.
"""


_ALWAYS = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE


def masses_of_geoms(case: PatternCase) -> Found:
    """Finds bodies without <inertial>, which MuJoCo weighs by their geoms."""
    made = {
        mover: [link.name for link in links if link.name in case.from_geoms]
        for mover, links in case.mjcf.items()
    }
    found = {key for key in case.open if key[0] in OF_INERTIALS and made.get(key[1])}
    movers = list(dict.fromkeys(name for _, name in case.open if name in {n for _, n in found}))
    if found:
        urdf, mjcf = (
            Quantity(sum(tree.bodies[name].mass for name in movers), "kg")
            for tree in (case.first, case.second)
        )
        bodies = [body for name in movers for body in made[name]]
        over = case.robot.description.mjcf.compiler.inertiafromgeom == _ALWAYS
        message = diagnose("masses-of-geoms", bodies=bodies, overruled=over, urdf=urdf, mjcf=mjcf)
        yield PatternFinding("geoms", message, found)


def closed_loops(case: PatternCase) -> Found:
    """Combines what an MJCF alone holds by equality constraints."""
    found = [name for kind, name in case.open if kind == "equality"]
    if len(found) > 1:
        message = diagnose("equalities-of-the-mjcf-alone", names=found)
        yield PatternFinding("equalities", message, {("equality", name) for name in found})


@dataclass(frozen=True, eq=False)
class _Slip:
    """What is wrong with some links of one body, and what is gone if it is undone.

    Attributes:
        mover: The joint that moves the body, or the base.
        links: The links.
        lacks: The file that lacks them, ``URDF`` or ``MJCF``; empty if they weigh a multiple.
        factor: What they weigh in the MJCF, relative to the URDF.
        inertia: Whether their inertias are that multiple, too.
    """

    mover: str
    links: tuple[ComparedLink, ...]
    lacks: str
    factor: float = 0.0
    inertia: bool = False


def other_links(case: PatternCase) -> Found:
    """Finds links that one file lacks, or that weigh another multiple, as many as alike at once."""
    differ = dict.fromkeys(name for kind, name in case.open if kind in OF_INERTIALS)
    if not differ:
        return
    slips = [slip for name in differ if (slip := _slip(case, name)) is not None]
    groups: dict[tuple[str, float, bool], list[_Slip]] = defaultdict(list)
    for slip in slips:
        groups[slip.lacks, float(f"{slip.factor:.3g}"), slip.inertia].append(slip)
    for (lacks, *_), group in groups.items():
        movers = {slip.mover for slip in group}
        explained = {key for key in case.open if key[0] in OF_INERTIALS and key[1] in movers}
        if lacks:
            yield PatternFinding("links", _lacking(group), explained)
        else:
            yield PatternFinding("scaled links", _scaled(group), explained)


def _slip(case: PatternCase, name: str) -> _Slip | None:
    """Returns the one slip that explains how a body differs, if any does."""
    one, two = case.first.bodies[name], case.second.bodies[name]
    apart = body_moments(one) - body_moments(two)
    if not one.mass or not two.mass or not apart[0]:
        return None
    lacks, links = ("MJCF", case.urdf) if apart[0] > 0 else ("URDF", case.mjcf)
    own = [link for link in links.get(name, ()) if link.body.mass <= 1.01 * abs(apart[0])]
    if len(own) < len(links.get(name, ())):  # a body of which all links are gone is another thing
        for chosen in _subsets(own, abs(apart[0])):
            extra = sum((body_moments(link.body) for link in chosen), start=np.zeros(10))
            less = from_moments(body_moments(one if lacks == "MJCF" else two) - extra)
            if _is_it(case, name, less, two if lacks == "MJCF" else one, extra, apart):
                return _Slip(name, chosen, lacks)
    kinds = {kind for kind, element in case.open if element == name}
    alone = len(case.urdf.get(name, ())) == len(case.mjcf.get(name, ())) == 1
    if alone and not kinds & {"com", "inertia"} and not _is_power(two.mass / one.mass):
        return None  # one number of one link: the difference says it all
    # What another cause explains of the inertia says nothing of the link's.
    both = (False,) if ("inertia", name) in case.taken else (True, False)
    for link, inertia in product(case.urdf.get(name, ()), both):
        factor = 1.0 - float(apart[0]) / link.body.mass
        if factor <= 0:
            continue
        changed = TreeBody(
            factor * link.body.mass,
            link.body.com,
            (factor if inertia else 1.0) * link.body.inertia,
        )
        extra = body_moments(link.body) - body_moments(changed)
        if _is_it(case, name, from_moments(body_moments(one) - extra), two, extra, apart):
            return _Slip(name, (link,), "", factor, inertia)
    return None


def _subsets(links: Sequence[ComparedLink], mass: float) -> Iterator[tuple[ComparedLink, ...]]:
    """Yields sets of links of a mass, the smallest first; of many links those alike in name."""
    if len(links) > _MOST_SUBSET_LINKS:
        named = {link.name: link for link in links}
        alike = [[named[name] for name in names] for names in by_pattern(list(named)).values()]
        tries = [*alike, *([link] for link in links), list(links)]
    else:
        masses = np.array([link.body.mass for link in links])
        choices = np.array(list(product((False, True), repeat=len(links))))
        near = np.abs(choices @ masses - mass) <= 1.5 * _MOST_RESIDUAL * mass if len(links) else []
        tries = [
            [link for link, taken in zip(links, choice, strict=True) if taken]
            for choice in choices[near]
        ]
    for chosen in sorted(tries, key=len):
        if chosen:
            yield tuple(chosen)


def _is_it(
    case: PatternCase, name: str, one: TreeBody, two: TreeBody, extra: Array, apart: Array
) -> bool:
    """Tells whether two bodies are the same, and what was undone is what they differed by.

    But for an inertia that another cause explains already: what is left of it says nothing.
    """
    taken = {kind for kind, element in case.taken if element == name}
    changes = {change.kind for change in body_changes(name, one, two, case.tolerances)}
    if not one.mass > 0 or changes - taken:
        return False
    scale = _scale(case.first.bodies[name], case.second.bodies[name])
    if "inertia" in taken:
        scale[4:] = math.inf
    extra = extra if float(extra[0] * apart[0]) >= 0 else -extra
    left, whole = (float(np.linalg.norm(each / scale)) for each in (apart - extra, apart))
    return left <= _MOST_RESIDUAL * whole


def _scale(one: TreeBody, two: TreeBody) -> Array:
    """Returns what moments are weighed by (10,): lengths by a body's radius of gyration."""
    mass = max(one.mass, two.mass)
    turning = max(float(np.trace(body.inertia)) for body in (one, two))
    far = max(float(np.linalg.norm(body.com)) for body in (one, two))
    length = max(math.sqrt(max(turning, 0.0) / mass), far, 1e-6)
    return np.array([1.0, *(length,) * 3, *(length**2,) * 6])


def _lacking(slips: Sequence[_Slip]) -> Diagnostic:
    """Says which links a file lacks, those of one name pattern at once."""
    links = {link.name: link.body.mass for slip in slips for link in slip.links}
    other = "URDF" if slips[0].lacks == "MJCF" else "MJCF"
    groups = sorted(
        by_pattern(list(links)).items(), key=lambda group: -sum(links[name] for name in group[1])
    )
    messages = []
    for pattern, names in groups:
        masses = [links[name] for name in names]
        alike = len(names) > 1 and math.isclose(min(masses), max(masses), rel_tol=1e-6)
        messages.append(
            diagnose(
                "links-of-a-pattern",
                pattern=pattern,
                count=len(names) if len(names) > 1 else None,
                mass=Quantity(masses[0] if alike else sum(masses), "kg"),
                each=alike,
            )
        )
    mass = Quantity(sum(links.values()), "kg")
    return diagnose("links-lacking", lacks=slips[0].lacks, has=other, mass=mass, links=messages)


def _scaled(slips: Sequence[_Slip]) -> Diagnostic:
    """Says which links weigh a multiple in the MJCF."""
    factor = float(f"{slips[0].factor:.6g}")
    links = [
        diagnose(
            "mass-of-a-link",
            subject=("link", link.name),
            urdf=Quantity(link.body.mass, "kg"),
            mjcf=Quantity(slip.factor * link.body.mass, "kg"),
        )
        for slip in slips
        for link in slip.links
    ]
    return diagnose("links-scaled", links=links, factor=factor, inertia=slips[0].inertia)


def _is_power(factor: float) -> bool:
    """Whether a factor is a power of ten, and not 1."""
    power = math.log10(factor)
    return math.isclose(power, round(power), abs_tol=1e-3) and round(power) != 0


def by_pattern(names: Sequence[str]) -> dict[str, list[str]]:
    """Returns {``*_rotor`` or ``sensor_*``, or a name by itself: the names}, the largest first."""
    left, found = list(names), dict[str, list[str]]()
    while left:
        alike: dict[str, list[str]] = defaultdict(list)
        for name in left:
            for place in (match.start() for match in re.finditer(r"[^A-Za-z0-9]", name)):
                alike[f"*{name[place:]}"].append(name)
                alike[f"{name[: place + 1]}*"].append(name)
        pattern, group = max(
            alike.items(), key=lambda each: (len(each[1]), len(each[0])), default=("", [])
        )
        if len(group) < 2:
            return found | {name: [name] for name in left}
        found[pattern] = group
        left = [name for name in left if name not in group]
    return found


_OTHER_BODYS_MASS = 0.1
"""How far a mass is off, at least, that is taken for another body's: not a screw more or less."""


def other_inertials(case: PatternCase) -> Found:
    """Finds bodies of which nothing is the other file's."""
    kinds = ("mass", "com", "inertia")
    others = []
    for name, one in case.first.bodies.items():
        two = case.second.bodies[name]
        if not {(kind, name) for kind in kinds} <= set(case.open):
            continue
        if one.mass and two.mass and abs(two.mass - one.mass) >= _OTHER_BODYS_MASS * one.mass:
            others.append(name)
    if others:
        links = [case.first.bodies[name].link or name for name in others]
        yield PatternFinding(
            "inertial",
            diagnose("inertials-of-another-robot", bodies=links, several=len(links) > 1),
            {(kind, name) for kind in kinds for name in others},
        )


def find_causes(
    robot: Robot,
    second: MultibodyTree,
    differences: Sequence[Difference],
    tolerances: Tolerances,
    from_geoms: Collection[str] = (),
) -> tuple[PatternCause, ...]:
    """Finds slips that explain several differences each.

    Args:
        robot: The robot.
        second: The MJCF's tree, in the URDF's link frames.
        differences: All differences.
        tolerances: What counts as one.
        from_geoms: The MJCF's bodies that take their mass from their geoms.
    """
    if len(differences) < 2:
        return ()
    first, raw = kinematic_trees(robot)
    keys = [(each.kind, each.element) for each in differences]
    bodies = any(kind in OF_INERTIALS for kind, _ in keys)
    urdf = urdf_links(robot) if bodies else {}
    mjcf = mjcf_links(robot, raw, second) if bodies else {}
    case = PatternCase(robot, first, second, keys, tolerances, urdf, mjcf, from_geoms)
    found: list[PatternCause] = []
    taken: set[int] = set()
    for look in _LOOKS:
        for each in look(replace(case, taken={keys[n] for n in taken})):
            numbers = tuple(
                n for n, key in enumerate(keys) if key in each.explained and n not in taken
            )
            if len(numbers) > 1:
                taken |= set(numbers)
                found.append(PatternCause(each.kind, each.diagnostic, numbers))
    return tuple(sorted(found, key=lambda cause: (not cause.leads, cause.differences)))


_LOOKS = (
    before_gears,
    find_dropped,
    masses_of_geoms,
    closed_loops,
    other_links,
    other_inertials,
)
"""From what explains most at once to what explains a single body."""
