"""One slip that explains many differences: units, an Euler sequence, left for right, a lost tensor.

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
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, islice, product
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.base.arrays import INERTIA_ENTRIES, inertia_tensor
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, Term, diagnose
from pupper_analysis.models.conversion import inertia_of_body, pinocchio_from_mujoco
from pupper_analysis.models.multibody import MultibodyTree, TreeBody, TreeJoint
from pupper_analysis.models.transmission import actuator_gear, list_joint_actuators
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.models.xml import MAX_NUMBER
from pupper_analysis.robot.compare.differences import (
    INERTIAL_KINDS,
    Difference,
    PatternCause,
    body_changes,
    changes_between,
)
from pupper_analysis.robot.matching.alignment import align_frames, in_body_frame
from pupper_analysis.robot.matching.tolerances import Tolerances
from pupper_analysis.robot.matching.trees import compute_poses_at_zero, kinematic_trees
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


def list_urdf_links(robot: Robot) -> Links:
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


def list_mjcf_links(robot: Robot, raw: MultibodyTree, aligned: MultibodyTree) -> Links:
    """Returns the links of the MJCF's bodies, in the frames to which its tree was aligned.

    Args:
        robot: The robot.
        raw: The MJCF's tree, in its own link frames.
        aligned: The same in others.
    """
    model, mujoco_model = pinocchio_from_mujoco(robot.mj_model), robot.mj_model
    here, there = compute_poses_at_zero(raw), compute_poses_at_zero(aligned)
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
    return body_from_moments(sum((compute_moments(body) for body in bodies), start=np.zeros(10)))


def compute_moments(body: TreeBody) -> Array:
    """Returns a body's mass, first and second moments about its frame's origin (10,).

    They add up when bodies are combined: the mass (kg), the first moments (kg m), and the six
    entries of the inertia about the origin (kg m^2).
    """
    c = body.com
    about = body.inertia + body.mass * (float(c @ c) * np.eye(3) - np.outer(c, c))
    entries = [about[place] for place in INERTIA_ENTRIES.values()]
    return np.array([body.mass, *(body.mass * c), *entries])


def body_from_moments(values: Array) -> TreeBody:
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
        raw: The MJCF's, as it is.
        second: The MJCF's, in the URDF's link frames.
        keys: The differences.
        tolerances: What counts as one.
        urdf: The links of which the URDF's bodies are made, in the frames of ``first``.
        mjcf: Those of the MJCF's, in the frames of ``second``.
        from_geoms: The MJCF's bodies that take their mass from their geoms.
        explained: Those that a cause explains already.
    """

    robot: Robot
    first: MultibodyTree
    raw: MultibodyTree
    second: MultibodyTree
    keys: Sequence[Key]
    tolerances: Tolerances
    urdf: Links
    mjcf: Links
    from_geoms: Collection[str] = ()
    explained: Collection[Key] = ()

    @property
    def unexplained(self) -> list[Key]:
        """The differences that no cause explains yet."""
        return [key for key in self.keys if key not in self.explained]

    def find_remaining(
        self, second: MultibodyTree, only: Collection[str] | None = None
    ) -> set[Key]:
        """Returns the differences to another tree in place of the MJCF's.

        Args:
            second: The other tree.
            only: The joints that are compared, with what they carry; by default all and the base.
        """
        first = self.first if only is None else self.first.part(only)
        try:
            both = align_frames(second, first, self.tolerances).values
            found = {(c.kind, c.element) for c in changes_between(first, both, self.tolerances)}
        except (ValueError, KeyError):  # not the same joints any more
            return set(self.keys)
        return found

    def find_explained(self, second: MultibodyTree) -> set[Key]:
        """Returns the differences that another tree in place of the MJCF's does not have.

        None if it has others instead, or if most of them are left.
        """
        left = self.find_remaining(second)
        gone = set(self.keys) - left
        return gone if not left - set(self.keys) and len(gone) > 1 else set()


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


PatternFindings = Iterator[PatternFinding]


_SEQUENCES = ("xyz", "xzy", "yxz", "yzx", "zxy", "zyx")


def find_angle_settings(case: PatternCase) -> PatternFindings:
    """Finds another eulerseq, or degrees for radians, that ends differences."""
    if not {"rotation", "axis", "lower limit", "upper limit", "zero", "base frame"} & {
        kind for kind, _ in case.keys
    }:
        return
    spec = case.robot.description.mjcf
    said = "".join(
        chr(letter) if isinstance(letter, int) else letter for letter in (spec.compiler.eulerseq)
    )
    degree = bool(spec.compiler.degree)
    unit, other_unit = ("degree", "radian") if degree else ("radian", "degree")
    tries: list[tuple[tuple[str, str, str], str, Any]] = [
        (("eulerseq", order, said), "eulerseq", list(order))
        for order in (*_SEQUENCES, *(sequence.upper() for sequence in _SEQUENCES))
        if _has_euler(spec) and order != said
    ]
    if _has_euler(spec) or {"lower limit", "upper limit"} & {kind for kind, _ in case.keys}:
        tries.append((("angle", other_unit, unit), "degree", not degree))
    best: tuple[tuple[str, str, str], set[Key]] = (("", "", ""), set())
    for setting, name, new in tries:
        other = spec.copy()
        setattr(other.compiler, name, new)
        try:
            model = other.compile()
        except (ValueError, RuntimeError):
            continue
        tree = kinematic_trees(replace(case.robot, mj_model=model))[1]
        gone = case.find_explained(replace(tree, gravity=case.first.gravity))
        if len(gone) > len(best[1]):
            best = (setting, gone)
    (attribute, value, stated), gone = best
    turned = [key for key in case.keys if key[0] in ("rotation", "axis")]
    limits = [key for key in case.keys if key[0] in ("lower limit", "upper limit")]
    concerned = turned or limits
    if concerned and sum(key in gone for key in concerned) >= 0.6 * len(concerned):
        yield PatternFinding(
            "angles",
            diagnose(
                "angles-meant-otherwise",
                attribute=attribute,
                value=value,
                stated=stated,
                count=len(gone),
                total=len(case.keys),
            ),
            gone,
        )


def _has_euler(spec: mujoco.MjSpec) -> bool:
    kind = mujoco.mjtOrientation.mjORIENTATION_EULER
    return any(body.alt.type == kind or body.ialt.type == kind for body in spec.bodies)


def find_exchanged(case: PatternCase) -> PatternFindings:
    """Finds limbs whose names are exchanged."""
    tops = case.first.children(case.first.base)
    limbs = {top: [top, *case.first.below(top)] for top in tops}
    concerned = {
        case.first.frames[element][0] if kind == "frame" else element for kind, element in case.keys
    }
    shaken = [top for top, names in limbs.items() if concerned & set(names)]
    pairs: list[tuple[str, str]] = []
    second, gone = case.raw, set[Key]()
    tries = ((a, b) for a, b in combinations(shaken, 2) if len(limbs[a]) == len(limbs[b]))
    for one, two in islice(tries, _EXCHANGES):
        if any({one, two} & set(pair) for pair in pairs):
            continue
        own = [*limbs[one], *limbs[two]]
        exchange = dict(zip(limbs[one], limbs[two], strict=True))
        carried = {*own, *(frame for name in own for frame in case.first.carried_by(name))}
        before = {key for key in case.keys if key[1] in carried}
        both = replace(second.part(own), frames=second.frames)
        after = {
            key for key in case.find_remaining(_renamed(both, exchange), own) if key[1] in carried
        }
        if len(before) > 1 and len(after) <= _STAY * len(before):
            pairs.append((one, two))
            second, gone = _renamed(second, exchange), gone | (before - after)
    if pairs:
        listed_limbs = [diagnose("limbs-of-a-pair", one=one, two=two) for one, two in pairs]
        yield PatternFinding(
            "exchanged",
            diagnose("limbs-exchanged", pairs=listed_limbs, count=len(gone), total=len(case.keys)),
            gone,
        )


_STAY = 0.2
"""Share of the differences of two limbs that may stay where they are exchanged."""

_EXCHANGES = 60
"""Pairs of limbs that are tried: all of eleven limbs."""


def _renamed(values: MultibodyTree, names: Mapping[str, str]) -> MultibodyTree:
    """Exchanges joints of a tree, with all that they move."""
    new = {**names, **{two: one for one, two in names.items()}}
    joints = {
        new.get(name, name): replace(joint, parent=new.get(joint.parent, joint.parent))
        for name, joint in values.joints.items()
    }
    return replace(
        values,
        joints=joints,
        bodies={new.get(name, name): body for name, body in values.bodies.items()},
        frames={
            frame: (new.get(owner, owner), place) for frame, (owner, place) in values.frames.items()
        },
    )


_MASS = {
    1e3: ("g", "kg"),
    1e-3: ("kg", "g"),
    2.20462: ("pounds", "kg"),
    0.453592: ("kg", "pounds"),
}
_ANGLE = {math.degrees(1.0): ("degrees", "radians")}
_LENGTH = {1e3: ("mm", "m"), 1e2: ("cm", "m"), 39.3701: ("inches", "m")}
_INERTIA = {
    1e3: ("g m^2", "kg m^2"),
    1e4: ("kg cm^2", "kg m^2"),
    1e6: ("kg mm^2", "kg m^2"),
    1e7: ("g cm^2", "kg m^2"),
    1e9: ("g mm^2", "kg m^2"),
}


def find_scaled_quantities(case: PatternCase) -> PatternFindings:
    """Finds masses, lengths or inertias that are all the same multiple of the other file's."""
    first, raw = case.first, case.raw
    bodies = [(one, raw.bodies[name]) for name, one in first.bodies.items() if one.mass]
    masses = _factor([(np.array([a.mass]), np.array([b.mass])) for a, b in bodies])
    inertias = _factor(
        [(a.inertia, case.second.bodies[n].inertia) for n, a in first.bodies.items()]
    )
    places = [(one.position, raw.joints[name].position) for name, one in first.joints.items()]
    lengths = _factor(places)
    hinges = [(one, raw.joints[name]) for name, one in first.joints.items() if not one.slides]
    bounds = [tuple(np.array([j.lower, j.upper]) for j in pair) for pair in hinges]
    limits = _factor((a, b) for a, b in bounds if np.abs([a, b]).max() <= MAX_NUMBER)
    for what, factor, units, kinds in (
        ("limits", limits, _ANGLE, ("lower limit", "upper limit")),
        ("masses", masses, _MASS, ("mass",)),
        ("lengths", lengths, _LENGTH, ("position", "com", "frame")),
        ("inertias", inertias, _INERTIA, ("inertia",)),
    ):
        if factor is None:
            continue
        yield PatternFinding(
            "units",
            diagnose("all-scaled", what=Term(what), factor=factor, guess=_unit(factor, units)),
            {key for key in case.keys if key[0] in kinds},
        )


def _factor(pairs: Iterable[tuple[Array, Array]]) -> float | None:
    """Returns the one factor between all pairs of arrays; None if there is none, or it is 1."""
    ratios = []
    for one, two in pairs:
        size = float(np.linalg.norm(one))
        if size < 1e-12:
            continue
        ratio = float(np.sum(one * two)) / size**2
        if float(np.linalg.norm(two - ratio * one)) > 1e-3 * abs(ratio) * size:
            return None
        ratios.append(ratio)
    if len(ratios) < 2 or min(ratios) <= 0 or max(ratios) > 1.001 * min(ratios):
        return None
    factor = float(np.median(ratios))
    return None if math.isclose(factor, 1.0, rel_tol=1e-2) else factor


def _unit(factor: float, units: Mapping[float, tuple[str, str]]) -> Diagnostic | None:
    for size, (meant, right) in units.items():
        for file, times in (("MJCF", size), ("URDF", 1 / size)):
            if math.isclose(factor, times, rel_tol=2e-3):
                return diagnose("guess-unit", meant=Term(meant), right=Term(right), file=file)
    decimal = math.isclose(abs(math.log10(factor)), 1, abs_tol=1e-3)
    return diagnose("guess-decimal-point") if decimal else None


def find_efforts_before_gears(case: PatternCase) -> PatternFindings:
    """Finds efforts that are the MJCF's once they are multiplied by the gears there."""
    model = case.robot.mj_model
    found: dict[tuple[float, float], list[str]] = defaultdict(list)
    for kind, name in case.unexplained:
        if kind == "effort":
            effort = case.first.joints[name].effort
            motors = list_joint_actuators(model, model.joint(name).id)
            gear = abs(float(actuator_gear(model, motors[0])[0])) if len(motors) == 1 else 1.0
            own = case.second.joints[name].effort
            if gear != 1.0 and math.isclose(effort * gear, own, rel_tol=1e-6):
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


def find_dropped_products(case: PatternCase, lacking: str) -> PatternFindings:
    """Finds that one file has no products of inertia at all.

    They are dropped in the other file, in each link's own axes or, had they been folded before, in
    those of the body that carries it: then the two are alike.

    Args:
        case: The two trees.
        lacking: The file that is to have none, ``URDF`` or ``MJCF``.
    """
    if sum(kind == "inertia" for kind, _ in case.unexplained) < 2:
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
        gone = {key for key in case.unexplained if key[0] == "inertia"} - left
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


def find_products_dropped_by_either(case: PatternCase) -> PatternFindings:
    """Finds what one file has left out of its inertials."""
    for file in ("URDF", "MJCF"):
        yield from find_dropped_products(case, file)


_MOST_SUBSET_LINKS = 12
"""Links of one body of which every subset is tried: 4096 of them, in a millisecond."""

_MOST_RESIDUAL = 0.02
"""Share of a body's difference that may be left where a slip is undone.

Files of 5 to 6 digits leave some thousandths of a link that is a hundredth of its body. A wrong set
of links leaves about as much as it takes away.
"""


_ALWAYS = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE


def find_masses_of_geoms(case: PatternCase) -> PatternFindings:
    """Finds bodies without <inertial>, which MuJoCo weighs by their geoms."""
    made = {
        mover: [link.name for link in links if link.name in case.from_geoms]
        for mover, links in case.mjcf.items()
    }
    found = {key for key in case.unexplained if key[0] in INERTIAL_KINDS and made.get(key[1])}
    movers = list(
        dict.fromkeys(name for _, name in case.unexplained if name in {n for _, n in found})
    )
    if found:
        urdf, mjcf = (
            Quantity(sum(tree.bodies[name].mass for name in movers), "kg")
            for tree in (case.first, case.second)
        )
        bodies = [body for name in movers for body in made[name]]
        over = case.robot.description.mjcf.compiler.inertiafromgeom == _ALWAYS
        message = diagnose("masses-of-geoms", bodies=bodies, overruled=over, urdf=urdf, mjcf=mjcf)
        yield PatternFinding("geoms", message, found)


def find_closed_loops(case: PatternCase) -> PatternFindings:
    """Combines what an MJCF alone holds by equality constraints."""
    found = [name for kind, name in case.unexplained if kind == "equality"]
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


def find_link_slips(case: PatternCase) -> PatternFindings:
    """Finds links that one file lacks, or that weigh another multiple, as many as alike at once."""
    differ = dict.fromkeys(name for kind, name in case.unexplained if kind in INERTIAL_KINDS)
    if not differ:
        return
    slips = [slip for name in differ if (slip := _slip(case, name)) is not None]
    groups: dict[tuple[str, float, bool], list[_Slip]] = defaultdict(list)
    for slip in slips:
        groups[slip.lacks, float(f"{slip.factor:.3g}"), slip.inertia].append(slip)
    for (lacks, *_), group in groups.items():
        movers = {slip.mover for slip in group}
        explained = {
            key for key in case.unexplained if key[0] in INERTIAL_KINDS and key[1] in movers
        }
        if lacks:
            yield PatternFinding("links", _lacking(group), explained)
        else:
            yield PatternFinding("scaled links", _scaled(group), explained)


def _slip(case: PatternCase, name: str) -> _Slip | None:
    """Returns the one slip that explains how a body differs, if any does."""
    one, two = case.first.bodies[name], case.second.bodies[name]
    apart = compute_moments(one) - compute_moments(two)
    if not one.mass or not two.mass or not apart[0]:
        return None
    lacks, links = ("MJCF", case.urdf) if apart[0] > 0 else ("URDF", case.mjcf)
    own = [link for link in links.get(name, ()) if link.body.mass <= 1.01 * abs(apart[0])]
    if len(own) < len(links.get(name, ())):  # a body of which all links are gone is another thing
        for chosen in _subsets(own, abs(apart[0])):
            extra = sum((compute_moments(link.body) for link in chosen), start=np.zeros(10))
            less = body_from_moments(compute_moments(one if lacks == "MJCF" else two) - extra)
            if _is_it(case, name, less, two if lacks == "MJCF" else one, extra, apart):
                return _Slip(name, chosen, lacks)
    kinds = {kind for kind, element in case.unexplained if element == name}
    alone = len(case.urdf.get(name, ())) == len(case.mjcf.get(name, ())) == 1
    if alone and not kinds & {"com", "inertia"} and not _is_power(two.mass / one.mass):
        return None  # one number of one link: the difference says it all
    # What another cause explains of the inertia says nothing of the link's.
    both = (False,) if ("inertia", name) in case.explained else (True, False)
    for link, inertia in product(case.urdf.get(name, ()), both):
        factor = 1.0 - float(apart[0]) / link.body.mass
        if factor <= 0:
            continue
        changed = TreeBody(
            factor * link.body.mass,
            link.body.com,
            (factor if inertia else 1.0) * link.body.inertia,
        )
        extra = compute_moments(link.body) - compute_moments(changed)
        if _is_it(case, name, body_from_moments(compute_moments(one) - extra), two, extra, apart):
            return _Slip(name, (link,), "", factor, inertia)
    return None


def _subsets(links: Sequence[ComparedLink], mass: float) -> Iterator[tuple[ComparedLink, ...]]:
    """Yields sets of links of a mass, the smallest first; of many links, of the heaviest."""
    heaviest = sorted(links, key=lambda link: -link.body.mass)[:_MOST_SUBSET_LINKS]
    masses = np.array([link.body.mass for link in heaviest])
    choices = np.array(list(product((False, True), repeat=len(heaviest))))
    near = np.abs(choices @ masses - mass) <= 1.5 * _MOST_RESIDUAL * mass
    for choice in sorted(choices[near].tolist(), key=sum):
        if any(choice):
            yield tuple(link for link, taken in zip(heaviest, choice, strict=True) if taken)


def _is_it(
    case: PatternCase, name: str, one: TreeBody, two: TreeBody, extra: Array, apart: Array
) -> bool:
    """Tells whether two bodies are the same, and what was undone is what they differed by.

    But for an inertia that another cause explains already: what is left of it says nothing.
    """
    taken = {kind for kind, element in case.explained if element == name}
    changes = {change.kind for change in body_changes(name, one, two, case.tolerances)}
    if not one.mass > 0 or changes - taken:
        return False
    scale = _scale(case.first.bodies[name], case.second.bodies[name])
    if "inertia" in taken:
        scale[4:] = math.inf
    extra = extra if float(extra[0] * apart[0]) >= 0 else -extra
    left, whole = (float(np.linalg.norm(moments / scale)) for moments in (apart - extra, apart))
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
        group_by_pattern(list(links)).items(),
        key=lambda group: -sum(links[name] for name in group[1]),
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


def group_by_pattern(names: Sequence[str]) -> dict[str, list[str]]:
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


def find_foreign_inertials(case: PatternCase) -> PatternFindings:
    """Finds bodies of which nothing is the other file's."""
    kinds = ("mass", "com", "inertia")
    others = []
    for name, one in case.first.bodies.items():
        two = case.second.bodies[name]
        if not {(kind, name) for kind in kinds} <= set(case.unexplained):
            continue
        if one.mass and two.mass and abs(two.mass - one.mass) >= _OTHER_BODYS_MASS * one.mass:
            others.append(name)
    if others:
        links = [case.first.bodies[name].link or name for name in others]
        yield PatternFinding(
            "inertial",
            diagnose("inertials-of-another-robot", bodies=links),
            {(kind, name) for kind in kinds for name in others},
        )


_PARALLEL = 1e-9  # sine of an angle

_MOST_MOVED_JOINTS = 20
"""Joints elsewhere of which no single one is looked at: it is another robot, and each look takes as
long as a comparison."""


def find_moved_axes(case: PatternCase) -> PatternFindings:
    """Finds joints whose axis alone is elsewhere.

    A body is drawn from its joint on: if that is moved, com, children and frames all are at other
    places as seen from it, though none of them has moved in the robot.
    """
    names = [element for kind, element in case.keys if kind == "position"]
    for name in names if len(names) <= _MOST_MOVED_JOINTS else ():
        moved = copy_joint_axis(case.second, case.first, name)
        gone = case.find_explained(moved)
        if ("position", name) not in gone:
            continue
        away, angle = _apart(case.first.joints[name], case.second.joints[name])
        yield PatternFinding(
            "line",
            diagnose(
                "axis-elsewhere",
                subject=("joint", name),
                distance=Quantity(away, "m") if away > case.tolerances.position else None,
                angle=Quantity(angle, "rad") if angle > case.tolerances.axis else None,
            ),
            gone,
        )


def copy_joint_axis(values: MultibodyTree, other: MultibodyTree, name: str) -> MultibodyTree:
    """Returns a robot in which a joint turns about another's axis; its body stays at zero.

    Args:
        values: The robot.
        other: A robot with that joint, in the same frame of the parent's.
        name: The joint.
    """
    mine, new = values.joints[name], other.joints[name]
    put = new.placement.actInv(mine.placement)
    joint = replace(mine, position=new.position, rotation=new.rotation, axis=new.axis)
    turned = in_body_frame(values, name, np.array(put.rotation), np.array(put.translation))
    return replace(turned, joints={**turned.joints, name: joint})


def _apart(one: TreeJoint, two: TreeJoint) -> tuple[float, float]:
    """Returns the distance (m) of two joints' axes, and the angle (rad) between them.

    In the frame of the parent, at zero; an axis of the opposite sign is the same line.
    """
    first, second = one.rotation @ one.axis, two.rotation @ two.axis
    between, across = two.position - one.position, np.cross(first, second)
    sine = float(np.linalg.norm(across))
    if sine > _PARALLEL:
        away = abs(float(between @ across)) / sine
    else:
        away = float(np.linalg.norm(np.cross(between, first)))
    return away, float(np.arctan2(sine, abs(float(first @ second))))


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
    keys = [(difference.kind, difference.element) for difference in differences]
    bodies = any(kind in INERTIAL_KINDS for kind, _ in keys)
    urdf = list_urdf_links(robot) if bodies else {}
    mjcf = list_mjcf_links(robot, raw, second) if bodies else {}
    raw = replace(raw, gravity=first.gravity)
    case = PatternCase(robot, first, raw, second, keys, tolerances, urdf, mjcf, from_geoms)
    found: list[PatternCause] = []
    taken: set[int] = set()
    for look in _LOOKS:
        for finding in look(replace(case, explained={keys[n] for n in taken})):
            numbers = tuple(
                n for n, key in enumerate(keys) if key in finding.explained and n not in taken
            )
            if len(numbers) > 1:
                taken |= set(numbers)
                found.append(PatternCause(finding.kind, finding.diagnostic, numbers))
    return tuple(sorted(found, key=lambda cause: (not cause.leads, cause.differences)))


_LOOKS = (
    find_angle_settings,
    find_exchanged,
    find_scaled_quantities,
    find_efforts_before_gears,
    find_products_dropped_by_either,
    find_masses_of_geoms,
    find_closed_loops,
    find_link_slips,
    find_foreign_inertials,
    find_moved_axes,
)
"""From what explains most at once to what explains a single body."""
