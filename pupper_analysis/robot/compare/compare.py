"""Compares any robot's URDF with its MJCF: whether they agree, and which number is to blame.

Where a robot is mounted is no difference of robots: for the comparison the URDF is put where the
MJCF stands. But who loads the URDF as it is computes other torques, if that is tilted.

What a foot stands on is part of the robot: a radius that is another one raises it, a shape that
touches nothing lets it fall. What else touches, and a foot of another shape that stands as high (a
ball for a mesh, say), is chosen otherwise in most pairs of files, and moves no stand.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from importlib import import_module
from pathlib import Path

import mujoco
import numpy as np
from lxml import etree
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import (
    Diagnostic,
    Quantity,
    Term,
    diagnose,
)
from pupper_analysis.base.errors import ModelError
from pupper_analysis.base.results import Tabular
from pupper_analysis.base.tools import offering
from pupper_analysis.base.units import DOWN
from pupper_analysis.models.loading import reader_of
from pupper_analysis.models.mjcf import silence_mujoco, start_data
from pupper_analysis.models.mjcf_file import MjcfFile, gives_mass, read_mjcf
from pupper_analysis.models.places import Place
from pupper_analysis.models.shapes import COMPARISON_DIRECTIONS, Pose, Shape, read_shape
from pupper_analysis.models.sides import LEG_JOINT_NAME
from pupper_analysis.models.stated.mjcf import place_of_geom, read_mjcf_model, touching_geoms
from pupper_analysis.models.stated.model import RobotModel
from pupper_analysis.models.stated.urdf import read_urdf_model
from pupper_analysis.models.urdf_file import UrdfFile, read_urdf
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.robot.compare.attribution import (
    EXPLAINED,
    align_robot,
    explain_differences,
)
from pupper_analysis.robot.compare.differences import (
    CONVENTIONS,
    FORMATS,
    SERVO_GAINS,
    Difference,
    Effect,
    Explanation,
    PatternCause,
    change_of,
    in_degrees,
    with_names_of_models,
)
from pupper_analysis.robot.contact import limb_ends
from pupper_analysis.robot.matching.match import Match, match_models
from pupper_analysis.robot.matching.sources import Sources
from pupper_analysis.robot.matching.tolerances import Tolerances
from pupper_analysis.robot.matching.trees import base_pose, kinematic_trees
from pupper_analysis.robot.servos import own_servos
from pupper_analysis.robot.shapes import may_touch

Array = NDArray[np.float64]

SAME_CONTACT = 2e-4
"""m: surfaces that are no further apart are one. (Meshes are cut to a tenth of a millimetre, and
files give radii as 0.02 for 19.95 mm.)"""

_AS_LOW = 0.15
"""Ends of limbs that are no higher than this above the lowest, in parts of the com's height above
it, are feet: hands are higher."""


@dataclass(frozen=True, eq=False)
class _Placed:
    """A shape in MuJoCo's world, as its robot begins.

    Attributes:
        shape: As its file has it.
        world: The same, placed in the world.
        place: Returns where it is stated.
    """

    shape: Shape
    world: Shape
    place: Callable[[], Place]


def compare_collisions(
    matched: Match, urdf: UrdfFile, mjcf: MjcfFile, moved: Collection[str]
) -> tuple[list[Difference], list[Diagnostic]]:
    """Compares what touches, in the pose in which the MJCF's robot begins.

    Args:
        matched: Both as one robot.
        urdf: The URDF.
        mjcf: The MJCF.
        moved: Joints (or the base) that are placed otherwise in the two files: what they carry
            touches elsewhere for that reason, and is not compared.

    Returns:
        Differences of feet, and a note where they are not compared.
    """
    meant = matched.conventions
    one, two = read_urdf_model(urdf), read_mjcf_model(mjcf)
    stated = any(shape.collides for link in one.links.values() for shape in link.shapes)
    if two.mj_model is None or not stated or not two.mj_model.geom_bodyid.any():
        return [], []  # one of them is of joints and masses alone
    if meant.base is not None or meant.zeros:
        return [], [diagnose("collisions-not-compared")]
    data = start_data(mjcf.model)
    elsewhere = {matched.mjcf_body[name] for name in moved if name in matched.mjcf_body}
    ends = limb_ends(mjcf.model)
    tried = {
        name: _of_limb(name, matched, (one, urdf), (two, mjcf), data)
        for name, body in matched.mjcf_body.items()
        if body in two.links
        and elsewhere.isdisjoint((body, *two.ancestors(body)))
        and mjcf.model.body_weldid[mjcf.model.body(body).id] in ends
    }
    limbs = {name: pair for name, pair in tried.items() if pair is not None}
    feet = _feet(limbs, matched, data) if matched.robot.floating else []
    return list(_of_feet({name: limbs[name] for name in feet}, matched, urdf, mjcf)), []


Limb = tuple[tuple[_Placed, ...], tuple[_Placed, ...]]
"""What touches of all that moves with a joint: in the URDF, in the MJCF."""


def _of_limb(
    name: str,
    matched: Match,
    of_urdf: tuple[RobotModel, UrdfFile],
    of_mjcf: tuple[RobotModel, MjcfFile],
    data: mujoco.MjData,
) -> Limb | None:
    """Returns what touches of all that moves with a joint; None where its extent is not known."""
    (one, urdf_file), (two, mjcf_file) = of_urdf, of_mjcf
    body, link, base = matched.mjcf_body[name], matched.urdf_link[name], matched.robot.base
    ends = matched.mjcf_body.get(base), matched.urdf_link.get(base)
    if not ({body, ends[0]} <= two.links.keys() and {link, ends[1]} <= one.links.keys()):
        return None
    model = data.model
    carrier = model.body(body).id
    # At zero angles, from the base's frame to the body's: in it the URDF's links are placed.
    to_body = (two.links[str(ends[0])].pose.inverse() * two.links[body].pose).inverse()
    to_base = one.links[str(ends[1])].pose.inverse()
    place = Pose.of_body(data, carrier) * to_body * to_base
    urdf = tuple(
        _Placed(
            shape,
            shape.placed_in(place * part.pose),
            partial(urdf_file.nth, part.name, "collision", number),
        )
        for part in one.fixed_group(link)
        for number, shape in enumerate(shape for shape in part.shapes if shape.collides)
    )
    moving = model.body_weldid[model.geom_bodyid] == model.body_weldid[carrier]
    mjcf = tuple(
        _Placed(
            shape := read_shape(model, geom),
            shape.placed_in(Pose.of_body(data, int(model.geom_bodyid[geom]))),
            partial(place_of_geom, mjcf_file, geom, "shape"),
        )
        for geom in _touching_the_world(model)
        if moving[geom]
    )
    points = any(not any(one.shape.size) and one.shape.kind != "mesh" for one in urdf)
    if points or any(
        placed.world.support(COMPARISON_DIRECTIONS[:1]) is None for placed in (*urdf, *mjcf)
    ):
        return None
    return urdf, mjcf


def _touching_the_world(model: mujoco.MjModel) -> list[int]:
    """Returns the geoms that can touch what stands in the world; of a world that is empty, all."""
    ids = sorted(touching_geoms(model))
    world = [geom for geom in ids if model.body_weldid[model.geom_bodyid[geom]] == 0]
    if not world:
        return ids
    return [geom for geom in ids if any(may_touch(model, geom, other) for other in world)]


def _feet(limbs: Mapping[str, Limb], matched: Match, data: mujoco.MjData) -> list[str]:
    """Returns the joints that move the feet: the ends of limbs that are as low as the lowest."""
    model = data.model
    ends = {
        name: min(float(-one.world.support(_DOWN)[0]) for one in (*urdf, *mjcf))  # type: ignore[index]
        for name, (urdf, mjcf) in limbs.items()
        if urdf or mjcf
    }
    if not ends:
        return []
    lowest = min(ends.values())
    base = model.body(matched.mjcf_body[matched.robot.base]).id
    above = float(data.subtree_com[base][2]) - lowest
    return [name for name, height in ends.items() if height - lowest <= _AS_LOW * above]


_DOWN = np.array([[0.0, 0.0, -1.0]])


def _of_feet(
    feet: Mapping[str, Limb], matched: Match, urdf: UrdfFile, mjcf: MjcfFile
) -> Iterator[Difference]:
    for name, (one, two) in feet.items():
        subject, sides = ("joint", name), (_lowest(one), _lowest(two))
        here, there = sides[0][2], sides[1][2]
        link, body = matched.urdf_link[name], matched.mjcf_body[name]
        stated = mjcf.place("body", body) if there is None else there.place()
        at = ((urdf.place("link", link) if here is None else here.place()).path, stated.path)
        both = {"one": sides[0][1], "two": sides[1][1], **FORMATS.named}
        if not (one and two):
            message = diagnose("foot-touches-in-one-file", subject=subject, **both)
            found = [None if not side else "there" for side in (one, two)]
            yield Difference("collision", name, found[0], found[1], "", message, {}, *at)
            continue
        lower = sides[0][0] - sides[1][0]  # of the MJCF's
        if abs(lower) > SAME_CONTACT:
            message = diagnose(
                "foot-surface-differs",
                subject=subject,
                lower=Quantity(lower, "m") if lower > 0 else None,
                higher=Quantity(-lower, "m") if lower < 0 else None,
                **both,
            )
            effects = {"contact surface": Effect(abs(lower), abs(lower), math.inf)}
            yield Difference(
                "collision",
                name,
                sides[0][0],
                sides[1][0],
                "m",
                message,
                effects,
                *at,
            )


def _lowest(shapes: Sequence[_Placed]) -> tuple[float, Diagnostic | Term, _Placed | None]:
    """Returns the height (m) of the lowest point of shapes, and the shape that has it."""
    if not shapes:
        return math.nan, Term("none"), None
    heights = [float(-shape.world.support(_DOWN)[0]) for shape in shapes]  # type: ignore[index]
    first = int(np.argmin(heights))
    return heights[first], shapes[first].shape.diagnostic, shapes[first]


def mount_of(matched: Match, urdf: etree._Element, tolerances: Tolerances) -> Diagnostic | None:
    """Says how the base of the MJCF is tilted against the URDF's; None if it is not.

    Args:
        matched: The files.
        urdf: The URDF as it is.
        tolerances: What counts as a difference.
    """
    robot = matched.robot
    if robot.floating:
        return None
    stands = base_pose(robot).rotation
    if matched.conventions.base is not None:
        stands = stands @ matched.conventions.base.rotation
    turn = stands @ _in_root(urdf, matched.urdf_link[robot.base]).T
    down, gravity = turn @ DOWN, kinematic_trees(robot)[1].gravity
    tilt = math.atan2(float(np.linalg.norm(np.cross(down, gravity))), float(down @ gravity))
    if not gravity.any() or tilt <= tolerances.rotation:
        return None
    return diagnose("base-tilted", subject=("body", robot.mj_base), tilt=Quantity(tilt, "rad"))


def _in_root(urdf: etree._Element, link: str) -> Array:
    """Returns the axes (3, 3) of a link on fixed joints, as seen from the URDF's root."""
    axes = np.eye(3)
    for joint in UrdfTree(urdf).chain(link):
        axes = joint.origin.rotation @ axes
    return axes


@dataclass(frozen=True, eq=False)
class FilesCompared(Tabular):
    """What became of the comparison of a URDF with an MJCF.

    Attributes:
        urdf: The URDF's path.
        mjcf: The MJCF's path.
        base: The base's name.
        joints: The joints that both have, by the MJCF's names.
        guessed: {joint in the URDF: joint in the MJCF} matched by structure, or by names that are
            the same but for prefixes and suffixes.
        only_urdf: Joints of the URDF alone, fixed at zero for the comparison.
        only_mjcf: Joints of the MJCF alone, likewise.
        parts: What one file has and the other lacks, as a whole with its joints; it was taken off
            to compare the rest.
        notes: What was assumed or left out.
        differences: Of the files, the one with the greatest effect first.
        causes: Slips that explain several differences each.
        deviations: {quantity: relative deviation between the models}.
        residual: {quantity: relative deviation that is left when all differences are taken away}.
        explained: Share of the worst deviation that the differences explain (1 is all).
        complete: Whether nothing is left unexplained.
        mount: How a fixed base is tilted in one file, and what that does to the torque that differs
            most; None if it is not, or the base is free.
        objections: Why the files do not agree, besides the differences: what no difference
            explains, and what differences within the tolerances add up to.
        agree: Whether the models agree, within the tolerances: no difference, no joint in one file
            only, and no objection.
        same_robot: Whether they agree, but for coordinates: joints' zeros, the base's frame.
    """

    urdf: str
    mjcf: str
    base: str
    joints: tuple[str, ...]
    guessed: dict[str, str]
    only_urdf: tuple[str, ...]
    only_mjcf: tuple[str, ...]
    parts: tuple[Diagnostic, ...]
    notes: tuple[Diagnostic, ...]
    differences: tuple[Difference, ...]
    causes: tuple[PatternCause, ...]
    deviations: dict[str, float] = field(metadata={"unit": "1"})
    residual: dict[str, float] = field(metadata={"unit": "1"})
    explained: float = field(metadata={"unit": "1"})
    complete: bool
    mount: Diagnostic | None
    objections: tuple[Diagnostic, ...]
    agree: bool
    same_robot: bool

    @property
    def unexplained(self) -> list[list[Difference]]:
        """The differences that no cause explains, those of one kind and the same values in one."""
        explained = {number for cause in self.causes for number in cause.differences}
        groups: dict[tuple[str, str, str], list[Difference]] = {}
        for number, one in enumerate(self.differences):
            if number not in explained:
                groups.setdefault((one.kind, str(one.urdf), str(one.mjcf)), []).append(one)
        return list(groups.values())

    @property
    def first_to_mend(self) -> Diagnostic:
        """What is to be mended first."""
        causes, groups = self.causes, self.unexplained
        if causes and causes[0].leads:
            return causes[0].diagnostic
        if self.parts:
            return self.parts[0]
        if causes and (causes[0].differences[0] == 0 or not groups):
            return causes[0].diagnostic
        if groups:
            return groups[0][0].diagnostic
        if self.objections:
            return self.objections[0]
        if self.agree and self.mount is not None:
            return diagnose("agree-but-tilted", tilt=self.mount)
        return diagnose("agree" if self.agree else "joints-not-the-same")

    def _columns(self) -> dict[str, list[object]]:
        names = ("kind", "element", "urdf", "mjcf", "unit", "message", "urdf_place", "mjcf_place")
        return {name: [getattr(found, name) for found in self.differences] for name in names}


@dataclass(frozen=True, eq=False)
class Compared:
    """Two files that were compared.

    Attributes:
        result: How they differ.
        matched: Both as one robot.
        explanation: Every number in which they differ, and the proof that none is missing.
        sources: Where the numbers of both stand.
    """

    result: FilesCompared
    matched: Match
    explanation: Explanation
    sources: tuple[Sources, Sources]


@silence_mujoco()
def compare_files(
    urdf: str | Path,
    mjcf: str | Path,
    *,
    names: Mapping[str, str] | None = None,
    packages: Mapping[str, Path] | None = None,
    feet: Sequence[str] = (),
    tolerances: Tolerances | None = None,
    strict_names: bool = False,
) -> Compared:
    """Compares a URDF with an MJCF of the same robot, and explains how they differ.

    The arguments are those of ``compare_models``, which cross-checks both engines, too.

    Raises:
        ModelError: If a file cannot be read, or the two cannot be matched.
        MissingPackageError: If what reads the format of one is not installed.
        UnknownNameError: If a name is not in its file.
        ConfigurationError: If an argument is out of its range.
    """
    tolerances = tolerances or Tolerances()
    urdf_file, mjcf_file = _first(urdf, packages), _second(mjcf)
    matched = match_models(
        urdf_file, mjcf_file, names=names, feet=feet, tolerances=tolerances, strict=strict_names
    )
    mount = mount_of(matched, urdf_file.root, tolerances)
    robot = matched.robot
    if not robot.total_mass > 0:
        mass = Quantity(robot.total_mass, "kg")
        raise ModelError(urdf_file.path, diagnose("robot-without-mass", mass=mass))
    alignment = align_robot(robot, tolerances)
    explanation = explain_differences(
        robot,
        tolerances=tolerances,
        reference=matched.reference,
        mimics=matched.mimics,
        alignment=alignment,
        conventions=matched.conventions,
        unstated=matched.unstated,
    )
    names_too = matched.guessed if strict_names else {}
    sources = matched.sources(urdf_file, mjcf_file)
    servos = _servo_gains(matched, urdf_file, mjcf_file, tolerances)
    renamed = (_name(*pair) for pair in names_too.items())
    found = (*explanation.differences, *renamed, *servos)
    placed = tuple(_placed(found, sources, urdf_file, mjcf_file))
    touching, untold = _touching(matched, urdf_file, mjcf_file, placed)
    differences = tuple(sorted((*placed, *touching), key=lambda difference: difference.rank))
    unmatched = matched.only_urdf or matched.only_mjcf
    objections = (*_legs_without_base(matched), *_objections(explanation, tolerances))
    if mount is not None and strict_names:
        objections = (*objections, mount)
    result = FilesCompared(
        urdf=str(urdf_file.path),
        mjcf=str(mjcf_file.path),
        base=robot.base,
        joints=robot.joint_names,
        guessed=dict(matched.guessed),
        only_urdf=matched.only_urdf,
        only_mjcf=matched.only_mjcf,
        parts=matched.parts,
        notes=(
            *matched.notes,
            *explanation.notes,
            *untold,
        ),
        differences=differences,
        causes=_causes(
            robot, alignment.values, differences, tolerances, _weighed_by_geoms(mjcf_file)
        ),
        deviations=explanation.deviations,
        residual=explanation.residual,
        explained=_explained(explanation),
        complete=explanation.complete,
        mount=mount,
        objections=objections,
        agree=not (differences or unmatched or objections),
        same_robot=not (_mechanical(differences) or unmatched or objections),
    )
    return Compared(result, matched, explanation, sources)


def _causes(*of: object) -> tuple[PatternCause, ...]:
    """Returns what several differences come from at once: ``find_causes`` of tools' ``causes.py``.

    Args:
        *of: The robot, the MJCF's tree in the URDF's link frames, all differences, what counts as
            one, and the MJCF's bodies that take their mass from their geoms.
    """
    modules = (import_module(f"{package}.causes") for package in offering("causes").values())
    return next((tuple(module.find_causes(*of)) for module in modules), ())


def _weighed_by_geoms(mjcf: MjcfFile) -> set[str]:
    """Returns the bodies that take their mass from their geoms."""
    spec = mjcf.spec
    return {geom.parent.name for geom in spec.geoms if gives_mass(spec, geom)}


def _legs_without_base(matched: Match) -> Iterator[Diagnostic]:
    """Yields that an MJCF lacks the base of its legs; that of an arm has no effect."""
    left = [note for note in matched.notes if note.code == "mass-of-base-left-out"]
    legs = [name for name in matched.robot.joint_names if LEG_JOINT_NAME.search(name)]
    if left and len(legs) > 1:
        yield diagnose("base-of-legs-left-out", mass=left[0].values["mass"], joints=legs)


def _touching(
    matched: Match, urdf: UrdfFile, mjcf: MjcfFile, found: Iterable[Difference]
) -> tuple[list[Difference], list[Diagnostic]]:
    """Compares what the robot stands on; other formats' shapes are not read for that."""
    if urdf.stands_for or mjcf.stands_for:
        return [], []
    moved = {difference.element for difference in found if difference.kind in _PLACED}
    return compare_collisions(matched, urdf, mjcf, moved)


_PLACED = ("type", "parent", "base frame", "zero", "position", "rotation", "axis")
"""Kinds of differences after which what a joint carries is elsewhere."""


def _first(path: str | Path, packages: Mapping[str, Path] | None) -> UrdfFile:
    """Reads the first file: a URDF, or what stands for one."""
    reader = reader_of(Path(path))
    return read_urdf(path, packages) if reader is None else reader.read_as_urdf(Path(path))


def _second(path: str | Path) -> MjcfFile:
    """Reads the second file: an MJCF, or what stands for one."""
    reader = reader_of(Path(path))
    return read_mjcf(path) if reader is None else reader.read_as_mjcf(Path(path))


def _mechanical(differences: Iterable[Difference]) -> bool:
    """Tells whether any difference is more than one of coordinates."""
    return any(difference.kind not in CONVENTIONS for difference in differences)


def _placed(
    differences: Iterable[Difference],
    sources: tuple[Sources, Sources],
    urdf: UrdfFile,
    mjcf: MjcfFile,
) -> Iterator[Difference]:
    """Yields differences with where they stand, and in the names of what stands for the files."""
    others = {
        term: Term(file.stands_for)
        for term, file in (("the URDF", urdf), ("the MJCF", mjcf))
        if file.stands_for
    }
    for one in differences:
        here, there = (source.place(one.kind, one.element).path for source in sources)
        told = with_names_of_models(one.diagnostic, others)
        yield replace(one, diagnostic=told, urdf_place=here, mjcf_place=there)


def _explained(explanation: Explanation) -> float:
    """Returns the share of the worst deviation that is explained."""
    worst, left = (max(each.values()) for each in (explanation.deviations, explanation.residual))
    if worst <= EXPLAINED:
        return 1.0 if left <= EXPLAINED else 0.0
    return max(0.0, 1.0 - left / worst) if math.isfinite(left) else 0.0


def _name(urdf: str, mjcf: str) -> Difference:
    message = diagnose("joint-name-differs", subject=("joint", mjcf), urdf=urdf, mjcf=mjcf)
    return Difference("name", mjcf, urdf, mjcf, "", message, {})


def _servo_gains(
    matched: Match, urdf: UrdfFile, mjcf: MjcfFile, tolerances: Tolerances
) -> Iterator[Difference]:
    """Yields gains of servos that both files state and that differ; a URDF states none."""
    if urdf.gains is None:
        return
    theirs = own_servos(matched.robot) if mjcf.gains is None else mjcf.gains
    joints = kinematic_trees(matched.robot)[0].joints
    for name in matched.robot.joint_names:
        mine = urdf.gains.get(matched.urdf_joint[name])
        if mine is None or name not in theirs:
            continue
        units = (("N m/rad", "N m s/rad"), ("N/m", "N s/m"))[joints[name].slides]
        for kind, one, two, unit in zip(SERVO_GAINS, mine, theirs[name], units, strict=True):
            if abs(two - one) > tolerances.damping * max(abs(one), abs(two)):
                said = {"what": Term(kind), "guess": in_degrees(one, two)}
                code, subject = "joint-number-differs", ("joint", name)
                change = change_of(code, kind, subject, (one, two), unit, FORMATS, said)
                yield change.difference({})


def _objections(explanation: Explanation, tolerances: Tolerances) -> Iterator[Diagnostic]:
    """Yields what keeps two files from agreeing although they may have no difference."""
    left = {name: value for name, value in explanation.residual.items() if value > EXPLAINED}
    if left:
        name = max(left, key=lambda quantity: left[quantity])
        yield diagnose(
            "deviation-unexplained",
            subject=("quantity", name),
            left=left[name],
            what=Term(name),
        )
        return
    if _mechanical(explanation.differences):
        return
    # Who lets a mass differ by 1e-2 lets what follows from it differ as much.
    allowed = max(getattr(tolerances, kind) for kind in _DYNAMIC_KINDS)
    for name, value in explanation.deviations.items():
        if value > allowed:
            yield diagnose(
                "tolerances-add-up",
                subject=("quantity", name),
                deviation=value,
                what=Term(name),
                allowed=allowed,
            )


_DYNAMIC_KINDS = ("mass", "com", "inertia", "position", "rotation", "axis", "damping", "dynamics")
"""Kinds of tolerance that the dynamics feel."""
