"""Compares any robot's URDF with its MJCF: whether they agree, and which number is to blame."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.diagnostics import (
    Diagnostic,
    Quantity,
    Term,
    diagnose,
)
from pupper_analysis.base.errors import ModelError
from pupper_analysis.base.results import Tabular
from pupper_analysis.models.missing import gives_mass
from pupper_analysis.models.mjcf import silence_mujoco
from pupper_analysis.models.mjcf_file import MjcfFile, read_mjcf
from pupper_analysis.models.readers import reader_of
from pupper_analysis.models.urdf_file import UrdfFile, read_urdf
from pupper_analysis.robot.compare.attribution import (
    EXPLAINED,
    align_robot,
    armature_notes,
    explain_differences,
    unstated_notes,
)
from pupper_analysis.robot.compare.changes import convention_changes
from pupper_analysis.robot.compare.collisions import compare_collisions
from pupper_analysis.robot.compare.differences import (
    CONVENTIONS,
    FORMATS,
    SERVO_GAINS,
    Difference,
    Explanation,
    in_degrees,
    number_pair,
    with_names_of_models,
)
from pupper_analysis.robot.compare.engines import (
    OF_ONE_MODEL,
    OF_THE_MJCF,
    CrossCheck,
    cross_check,
)
from pupper_analysis.robot.compare.links import mass_shares
from pupper_analysis.robot.compare.mount import Mount, mount_of
from pupper_analysis.robot.compare.patterns import PatternCause, find_causes
from pupper_analysis.robot.compare.states import check_states
from pupper_analysis.robot.matching.conventions import Conventions
from pupper_analysis.robot.matching.match import Match, match_models
from pupper_analysis.robot.matching.tolerances import Tolerances
from pupper_analysis.robot.matching.trees import kinematic_trees
from pupper_analysis.robot.servos import own_servos

ENGINES_AGREE = 1e-8
"""How far the two engines may deviate on one model, relative to a quantity's scale."""


@dataclass(frozen=True, eq=False)
class Comparison(Tabular):
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
        check: The cross-check: both models in both engines.
        differences: Of the files, the one with the greatest effect first.
        causes: Slips that explain several differences each.
        deviations: {quantity: relative deviation between the models}.
        residual: {quantity: relative deviation that is left when all differences are taken away}.
        explained: Share of the worst deviation that the differences explain (1 is all).
        complete: Whether nothing is left unexplained.
        engines: Quantities on which the engines deviate for one and the same model.
        mount: How a fixed base is tilted in one file, and what that does to gravity; None if it is
            not, or the base is free.
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
    check: CrossCheck
    differences: tuple[Difference, ...]
    causes: tuple[PatternCause, ...]
    deviations: dict[str, float]
    residual: dict[str, float]
    explained: float
    complete: bool
    engines: tuple[Diagnostic, ...]
    mount: Mount | None
    objections: tuple[Diagnostic, ...]
    agree: bool
    same_robot: bool

    def _columns(self) -> dict[str, list[object]]:
        names = ("kind", "element", "urdf", "mjcf", "unit", "message", "urdf_place", "mjcf_place")
        return {name: [getattr(found, name) for found in self.differences] for name in names}


@check_arguments
@silence_mujoco()
def compare_models(
    urdf: str | Path,
    mjcf: str | Path,
    *,
    names: Mapping[str, str] | None = None,
    packages: Mapping[str, Path] | None = None,
    feet: Sequence[str] = (),
    tolerances: Tolerances | None = None,
    strict_names: bool = False,
    any_coordinates: bool = False,
    same_mount: bool = False,
    configurations: int = 20,
    seed: int = 0,
) -> Comparison:
    """Compares a URDF with an MJCF of the same robot, and explains how they differ.

    A file of another format (`base.tools.formats`) may stand in the place of either.

    Args:
        urdf: Path of the URDF, or what stands for it.
        mjcf: Path of the MJCF, or what stands for it.
        names: {name in the URDF: name in the MJCF} of joints and frames whose names differ.
        packages: {ROS package: its folder}, for ``package://`` paths.
        feet: Frames, by their names in the MJCF, that count as feet; by default all frames that
            both files have are compared.
        tolerances: What counts as a difference; by default for files of 5 to 6 digits.
        strict_names: Joints that are matched by structure, not by their name or by ``names``, are
            a difference; otherwise `guessed` alone tells of them. So are damping and dry friction
            that the URDF does not state; otherwise a note tells of them.
        any_coordinates: Joints' zeros, moved with their limits, and a free base's frame may be
            elsewhere: notes tell of them. By default they are differences, because qpos means
            another pose.
        same_mount: A fixed base that is tilted against the URDF's is an objection; otherwise
            `mount` alone tells of it.
        configurations: Number of random configurations of the cross-check.
        seed: Of the random numbers, 0 or more.

    Returns:
        The comparison.

    Raises:
        ModelError: If a file cannot be read, or the two cannot be matched.
        MissingPackageError: If what reads the format of one is not installed.
        UnknownNameError: If a name is not in its file.
        ConfigurationError: If an argument is out of its range.
    """
    check_states(configurations, seed)
    tolerances = tolerances or Tolerances()
    urdf_file, mjcf_file = _first(urdf, packages), _second(mjcf)
    matched = match_models(
        urdf_file, mjcf_file, names=names, feet=feet, tolerances=tolerances, strict=strict_names
    )
    mount = mount_of(matched, urdf_file.root, tolerances)
    if any_coordinates:
        matched = _in_any_coordinates(matched)
    robot = matched.robot
    if not robot.total_mass > 0:
        mass = Quantity(robot.total_mass, "kg")
        raise ModelError(urdf_file.path, diagnose("robot-without-mass", mass=mass))
    alignment = align_robot(robot, tolerances)
    check = cross_check(
        robot,
        configurations=configurations,
        tolerance=tolerances.dynamics,
        seed=seed,
        mimics=matched.mimics,
        moved=alignment.moved,
    )
    explanation = explain_differences(
        robot,
        tolerances=tolerances,
        reference=matched.reference,
        mimics=matched.mimics,
        alignment=alignment,
        conventions=matched.conventions,
        undamped=matched.unstated.get("damping", ()),
    )
    names_too = matched.guessed if strict_names else {}
    placed = tuple(_placed(explanation, names_too, matched, urdf_file, mjcf_file, tolerances))
    touching, untold = _touching(matched, urdf_file, mjcf_file, placed)
    differences = tuple(sorted((*placed, *touching), key=lambda difference: difference.rank))
    unmatched = matched.only_urdf or matched.only_mjcf
    objections = (*_legs_without_base(matched), *_objections(explanation, tolerances))
    if mount is not None and same_mount:
        objections = (*objections, mount.diagnostic)
    return Comparison(
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
            *armature_notes(explanation),
            *unstated_notes(matched, explanation),
            *untold,
        ),
        check=check,
        differences=differences,
        causes=find_causes(
            robot, alignment.values, differences, tolerances, _weighed_by_geoms(mjcf_file)
        ),
        deviations=explanation.deviations,
        residual=explanation.residual,
        explained=_explained(explanation),
        complete=explanation.complete,
        engines=_engines(check, explanation),
        mount=mount,
        objections=objections,
        agree=not (differences or unmatched or objections),
        same_robot=not (_mechanical(differences) or unmatched or objections),
    )


def _weighed_by_geoms(mjcf: MjcfFile) -> set[str]:
    """Returns the bodies that take their mass from their geoms."""
    spec = mjcf.spec
    return {geom.parent.name for geom in spec.geoms if gives_mass(spec, geom)}


_LEGS = re.compile("hip|thigh|knee|calf|shank|ankle|foot|wheel", re.IGNORECASE)
"""In names of joints that are not those of an arm or a hand, whose base is bolted down."""


def _legs_without_base(matched: Match) -> Iterator[Diagnostic]:
    """Yields that an MJCF lacks the base of its legs; that of an arm has no effect."""
    left = [note for note in matched.notes if note.code == "mass-of-base-left-out"]
    legs = [name for name in matched.robot.joint_names if _LEGS.search(name)]
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


def _in_any_coordinates(matched: Match) -> Match:
    """Makes notes of the files' conventions of coordinates: then they are no differences."""
    changes = convention_changes(matched.conventions, kinematic_trees(matched.robot)[0])
    notes = (*matched.notes, *(difference.diagnostic for difference, _ in changes))
    return replace(matched, conventions=Conventions(), notes=notes)


def _mechanical(differences: Iterable[Difference]) -> bool:
    """Tells whether any difference is more than one of coordinates."""
    return any(difference.kind not in CONVENTIONS for difference in differences)


def _placed(
    explanation: Explanation,
    names: Mapping[str, str],
    matched: Match,
    urdf: UrdfFile,
    mjcf: MjcfFile,
    tolerances: Tolerances,
) -> Iterator[Difference]:
    """Yields the differences, names that are another, and gains, with where they stand."""
    one, two = matched.sources(urdf, mjcf)
    others = {
        term: Term(file.stands_for)
        for term, file in (("the URDF", urdf), ("the MJCF", mjcf))
        if file.stands_for
    }
    servos = _servo_gains(matched, urdf, mjcf, tolerances)
    renamed = (_name(*pair) for pair in names.items())
    for difference in (*explanation.differences, *renamed, *servos):
        yield replace(
            difference,
            diagnostic=with_names_of_models(difference.diagnostic, others),
            urdf_place=one.place(difference.kind, difference.element).path,
            mjcf_place=two.place(difference.kind, difference.element).path,
            made_of=mass_shares(difference, one, two),
        )


def _engines(check: CrossCheck, explanation: Explanation) -> tuple[Diagnostic, ...]:
    """Says where the engines deviate for one and the same model."""
    return tuple(
        diagnose(
            "engines-deviate",
            subject=("quantity", quantity.name),
            relative=relative,
            edge=Term(whose),
        )
        for quantity in check.quantities
        for whose, relative in quantity.edges.items()
        if whose in OF_ONE_MODEL
        and relative > ENGINES_AGREE
        # With forces of MuJoCo's that a tree of joints has not, the two got different models.
        and not (explanation.remains and whose in OF_THE_MJCF)
    )


def _explained(explanation: Explanation) -> float:
    """Returns the share of the worst deviation that is explained."""
    worst, left = (max(each.values()) for each in (explanation.deviations, explanation.residual))
    if worst <= EXPLAINED:
        return 1.0 if left <= EXPLAINED else 0.0
    return max(0.0, 1.0 - left / worst) if math.isfinite(left) else 0.0


def _name(urdf: str, mjcf: str) -> Difference:
    told = diagnose("joint-name-differs", subject=("joint", mjcf), urdf=urdf, mjcf=mjcf)
    return Difference("name", mjcf, urdf, mjcf, "", told, {})


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
                told = diagnose(
                    "joint-number-differs",
                    subject=("joint", name),
                    what=Term(kind),
                    guess=in_degrees(one, two),
                    **number_pair(one, two, unit),
                    **FORMATS.named,
                )
                yield Difference(kind, name, one, two, unit, told, {})


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
            remains=explanation.remains,
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
