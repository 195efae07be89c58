"""Makes a URDF and an MJCF agree: numbers of a file are written into the other file, in place.

Inputs are two files, and for each difference the file whose value is taken. Outputs are the changed
files and a `Sync`. Changes are planned, verified by comparing changed copies of the models, and
written together.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import ClassVar, Final

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import ConfigurationError, ModelError
from pupper_analysis.base.files import Writing, remove_stale_files, resolve_target, write_all
from pupper_analysis.base.inputs import MAX_FILE_BYTES, read_input
from pupper_analysis.base.kinds import EDITED_KIND
from pupper_analysis.base.patches import make_patch
from pupper_analysis.base.results import Result, shorten_paths
from pupper_analysis.models.attributes import JOINT_ATTRIBUTES
from pupper_analysis.models.git import refuse_uncommitted
from pupper_analysis.models.mjcf import silence_mujoco
from pupper_analysis.models.objects import require_path
from pupper_analysis.models.published import find_file
from pupper_analysis.pupper.named_robots import find_files, find_model_pair, is_variant
from pupper_analysis.pupper.variants import VariantSpec
from pupper_analysis.robot.compare.compare import FilesCompared, compare_files
from pupper_analysis.robot.compare.differences import SERVO_GAIN_KINDS, Difference, PropertyKey
from pupper_analysis.robot.matching.sources import BODY_KINDS
from pupper_analysis.robot.matching.tolerances import Tolerances
from pupper_analysis.tools.sync.plan import (
    Edit,
    Files,
    Plan,
    UnwrittenCause,
    make_plan,
    write_temporary_files,
)


@dataclass(frozen=True)
class Unmended(Result):
    """Difference between a URDF and an MJCF that remains after a sync, with the reason.

    Attributes:
        difference: Name: ``link base: mass``.
        reason: Reason.
        cause: Kind of reason.
    """

    difference: str
    reason: Diagnostic
    cause: UnwrittenCause


@dataclass(frozen=True, eq=False)
class Sync(Result):
    """Result of making a URDF and an MJCF agree: written changes, remaining differences.

    Attributes:
        differences: All differences, in the order of repair.
        taken: {name of a difference: ``"urdf"`` or ``"mjcf"``}: source of the value.
        edits: Written or planned changes of attributes.
        not_mended: Remaining differences, with reasons.
        notes: {name of a difference: note on the change}.
        diff: Changes of the files in the format of ``diff -u``.
        written: Files that were replaced.
        backups: Copies of the old files.
        withheld: True if nothing is written because a chosen difference cannot be removed. With
            other changes alone, the files would describe a mixture of two robots.
        agree: True if the files agree after the edits.
        floating: Whether the MJCF has a free base, or a base with at least two limbs.
        left_by_side: {``"urdf"`` or ``"mjcf"``: number of differences that remain if all values are
            taken from this file}; empty if values were chosen, or without differences.
    """

    _key_fields: ClassVar[tuple[str, ...]] = ("agree", "written")

    differences: tuple[Difference, ...]
    taken: dict[str, str]
    edits: tuple[Edit, ...]
    not_mended: tuple[Unmended, ...]
    notes: dict[str, Diagnostic]
    diff: str
    written: tuple[str, ...]
    backups: tuple[str, ...]
    withheld: bool
    agree: bool
    floating: bool
    left_by_side: dict[str, int]


@check_arguments
@silence_mujoco()
def sync_models(
    urdf: str | Path | VariantSpec,
    mjcf: str | Path | VariantSpec | None = None,
    *,
    take: str | Sequence[str] = (),
    partial: bool = False,
    dry_run: bool = False,
    backup: bool = False,
    force: bool = False,
    names: Mapping[str, str] | None = None,
    packages: Mapping[str, Path] | None = None,
    tolerances: Tolerances | None = None,
) -> Sync:
    """Make a URDF and an MJCF of the same robot agree: write numbers of a file into the other.

    Only attributes with different numbers, and attributes that the format requires beside them, are
    written; all other bytes are unchanged. Changes are first verified on copies. A change that does
    not remove the difference is not written. Without ``partial``, nothing at all is written in this
    case, or if a chosen number cannot be written.

    Two kinds of chosen differences are not written, and do not prevent other changes:

    - differences that are no numbers of both formats;
    - numbers that the chosen file does not state.

    Args:
        urdf: Path of the URDF; name of a published robot; or a variant, such as ``"v3"``, whose
            URDF is used.
        mjcf: Path of the MJCF; name of a published robot; or a variant, whose MJCF is used. By
            default the MJCF of the variant ``urdf``.
        take: File whose values are taken: ``"urdf"`` (the MJCF is changed) or ``"mjcf"`` (the URDF
            is changed). A text after a colon selects differences, for example ``"mjcf:mass"``,
            ``"urdf:link base: mass"`` or ``"mjcf:3"`` (see `choose_files`). Differences that are
            not selected remain.
        partial: Write the changes that are possible, even if other chosen changes are impossible.
        dry_run: Write nothing; return the planned changes.
        backup: Keep the old files as ``NAME.bak``.
        force: Write to files with uncommitted changes in a git repository.
        names: {name in the URDF: name in the MJCF} of joints and frames whose names differ.
        packages: {ROS package: folder}, for ``package://`` paths.
        tolerances: Differences within the tolerances are ignored. The default is the same as in
            `compare_models`. ``Tolerances.strict()`` only ignores rounding of floating-point
            numbers.

    Returns:
        Written or planned changes, and remaining differences.

    Raises:
        ModelError: If a file cannot be read, or the files cannot be matched, for example.
        ConfigurationError: If a choice is not valid or matches no difference, a model has no file
            (a robot in memory, or a text), or a value would be written to a scaled variant, for
            example.
        VariantError: If a model is probably a misspelled variant name, or the scales of a variant
            give no valid model.
        UnknownNameError: If MuJoCo Menagerie has no robot with the name of a model.
        OutputError: If a file cannot be written, or, without ``force``, has uncommitted changes.
    """
    # The files of scaled variants are compared, and never written.
    with TemporaryDirectory() as name:
        folder = Path(name).resolve()
        urdf_file, mjcf_file = _find_paths(urdf, mjcf, folder)
        paths = find_file(urdf_file, packages), find_file(mjcf_file, packages)
        files = Files(*paths, dict(names or {}), dict(packages or {}))
        result = _sync_files(
            files,
            take,
            tolerances or Tolerances(),
            temporary=folder,
            partial=partial,
            dry_run=dry_run,
            backup=backup,
            force=force,
        )
        return shorten_paths(result, f"{folder}{os.sep}")


def _find_paths(
    urdf: str | Path | VariantSpec, mjcf: str | Path | VariantSpec | None, folder: Path
) -> tuple[str | Path, str | Path]:
    """Return the paths of both models; write the files of a scaled variant to ``folder``.

    Raises:
        ConfigurationError: If a model is an object in memory, for example.
        VariantError: If the scales of a variant give no valid model.
        ModelError: If a base file or a mesh of a variant is missing or damaged.
    """
    paths = list[str | Path]()
    given = (urdf, urdf if mjcf is None else mjcf)
    for side, (argument, model) in enumerate(zip(given, find_model_pair(urdf, mjcf), strict=True)):
        if is_variant(argument) and not isinstance(model, str | Path):
            paths.append(find_files(argument, folder)[side])
            continue
        require_path(("urdf", "mjcf")[side], model)
        paths.append(model)
    return paths[0], paths[1]


def _sync_files(
    files: Files,
    take: str | Sequence[str],
    tolerances: Tolerances,
    *,
    temporary: Path,
    partial: bool,
    dry_run: bool,
    backup: bool,
    force: bool,
) -> Sync:
    """Compare two files, and write the chosen values; see `sync_models`.

    Raises:
        ConfigurationError: If a file in the folder ``temporary`` would have to be written.
    """
    comparison = _compare_files(files, tolerances)
    choices = choose_files(comparison.differences, take)
    keys = {
        (difference.kind, difference.element): side
        for difference, side in zip(comparison.differences, choices, strict=True)
        if side is not None
    }
    plan, after = _make_verified_plan(files, tolerances, comparison, keys)
    withheld = not partial and any(
        plan.find_cause(key) == UnwrittenCause.NOT_MENDED for key in plan.left
    )
    is_dry = dry_run or withheld
    changed = [d.path for d in plan.documents() if d.render() != d.data]
    if not is_dry and any(path.is_relative_to(temporary) for path in changed):
        raise ConfigurationError("take", diagnose("object-without-file"))
    written, backups = ((), ()) if is_dry else _write_files(plan, backup=backup, force=force)
    labels = {(d.kind, d.element): format_difference_label(d) for d in comparison.differences}
    return Sync(
        differences=comparison.differences,
        taken={labels[key]: side for key, side in keys.items()},
        edits=plan.edits(),
        not_mended=tuple(_list_unmended(plan, comparison, after, keys, labels)),
        notes={labels[key]: note for key, note in plan.notes.items() if key not in plan.left},
        diff="".join(make_patch(d.path, d.data, d.render()) for d in plan.documents()),
        written=written,
        backups=backups,
        withheld=withheld,
        agree=after.agree,
        floating=comparison.floating,
        left_by_side={} if take else _count_left_differences(files, tolerances, comparison),
    )


def _count_left_differences(
    files: Files, tolerances: Tolerances, comparison: FilesCompared
) -> dict[str, int]:
    """Return {side: number of differences that remain if all values of this file are taken}.

    A plan that cannot be written as a whole leaves all differences. Empty without differences.
    """
    left = dict[str, int]()
    keys = [(difference.kind, difference.element) for difference in comparison.differences]
    for side in FILE_SIDES if keys else ():
        plan, after = _make_verified_plan(files, tolerances, comparison, dict.fromkeys(keys, side))
        is_withheld = any(plan.find_cause(key) == UnwrittenCause.NOT_MENDED for key in plan.left)
        left[side] = len(keys) if is_withheld else len(after.differences)
    return left


def _compare_files(files: Files, tolerances: Tolerances) -> FilesCompared:
    """Compare a URDF with an MJCF; return the differences that exceed the tolerances."""
    return compare_files(
        files.urdf,
        files.mjcf,
        names=files.names,
        packages=files.packages,
        tolerances=tolerances,
    ).result


def _make_verified_plan(
    files: Files, tolerances: Tolerances, comparison: FilesCompared, keys: Mapping[PropertyKey, str]
) -> tuple[Plan, FilesCompared]:
    """Return a plan whose changes remove the differences, and the comparison after the changes.

    Changes that do not remove the difference in copies of the files are removed from the plan. If
    an engine refuses a copy, all changes are removed.
    """
    refused: dict[PropertyKey, Diagnostic] = {}
    while True:
        remaining = {key: side for key, side in keys.items() if key not in refused}
        plan = make_plan(files, tolerances, remaining)
        plan.left.update(refused)
        planned = keys.keys() - plan.left.keys()
        if not plan.edits():
            plan.left.update(dict.fromkeys(planned, diagnose("no-attribute-states-it")))
            return plan, comparison
        try:
            after = _compare_planned(plan, tolerances)
        except ModelError as error:
            refused |= dict.fromkeys(planned, diagnose("file-refused-with-it", problem=error.cause))
            continue
        unchanged = {(d.kind, d.element) for d in after.differences} & planned
        if not unchanged:
            return plan, after
        refused |= dict.fromkeys(unchanged, diagnose("change-mends-nothing"))


def _compare_planned(plan: Plan, tolerances: Tolerances) -> FilesCompared:
    """Compare copies of both files after the planned changes, to verify the plan.

    Raises:
        ModelError: If an engine refuses a copy.
    """
    documents = {**plan.urdf, **plan.mjcf}
    contents = {
        place: documents[file].render() if file in documents else read_input(file, MAX_FILE_BYTES)
        for copies in plan.copies
        for file, place in copies.copy_paths.items()
    }
    with write_temporary_files(contents) as folder:
        urdf, mjcf = (folder / copies.copy_paths[copies.main] for copies in plan.copies)
        try:
            return _compare_files(replace(plan.files, urdf=urdf, mjcf=mjcf), tolerances)
        except ModelError as error:
            cause = error.cause.with_names(lambda text: text.replace(f"{folder}/", ""))
            raise ModelError(error.source, cause) from error


def _write_files(
    plan: Plan, *, backup: bool, force: bool
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Replace all changed files, or none; return the paths of files and backups.

    Raises:
        OutputError: If a file cannot be written, was changed after reading, or (unless ``force``)
            has uncommitted changes in git.
    """
    for document in plan.documents():
        remove_stale_files(resolve_target(document.path)[0].parent)
    changed = [d for d in plan.documents() if d.render() != d.data]
    if not force:
        for document in changed:
            refuse_uncommitted(document.path)
    writings = [Writing(d.path, d.render(), EDITED_KIND, before=d.data) for d in changed]
    backup_paths = write_all(writings, backup=backup)
    return tuple(str(d.path) for d in changed), tuple(map(str, backup_paths))


def _list_unmended(
    plan: Plan,
    before: FilesCompared,
    after: FilesCompared,
    keys: Mapping[PropertyKey, str],
    labels: Mapping[PropertyKey, str],
) -> Iterable[Unmended]:
    """Yield the differences that remain after the changes of a plan, each with the reason.

    ``keys`` is {chosen difference: side whose value is taken}; ``labels`` is {difference: name}.
    """
    remaining = {(d.kind, d.element): d for d in after.differences}
    for key, name in labels.items():
        if key in plan.left and key in remaining:  # another change may have mended it
            yield Unmended(name, plan.left[key], plan.find_cause(key))
        elif key not in keys and key in remaining:
            yield Unmended(name, diagnose("nothing-chosen"), UnwrittenCause.NOT_CHOSEN)
    for key, difference in remaining.items():
        if key not in labels:
            reason = diagnose("there-since", difference=difference.diagnostic)
            yield Unmended(format_difference_label(difference), reason, UnwrittenCause.NEW)
    for part in before.parts:
        yield Unmended("part", diagnose("part-unwritten", part=part), UnwrittenCause.NO_WORDS)
    for joints, stating, lacking in (
        (before.only_urdf, "URDF", "MJCF"),
        (before.only_mjcf, "MJCF", "URDF"),
    ):
        for joint in joints:
            reason = diagnose("one-file-alone-has-it", one=stating, other=lacking)
            yield Unmended(f"joint {joint}", reason, UnwrittenCause.NO_WORDS)
    if not after.differences:
        for objection in after.objections:
            yield Unmended("agreement", objection, UnwrittenCause.NO_WORDS)


# Choice of the source of the value, per difference.

FILE_SIDES: Final = ("urdf", "mjcf")
"""Names of the files whose value the user can choose for a difference, as in ``urdf: mass``."""

_JOINT_PROPERTIES: Final = (
    "position",
    "rotation",
    "axis",
    *(attribute.kind for attribute in JOINT_ATTRIBUTES),
    "zero",
    "type",
    "parent",
    "mimic",
    "name",
    "damping polynomial",
    *SERVO_GAIN_KINDS,
)
"""Kinds of differences whose element `format_owner_name` calls a joint."""


def format_owner_name(difference: Difference) -> str:
    """Format kind and name of the element that differs between URDF and MJCF.

    Examples: ``link FL_hip``, ``joint FL_knee``, ``frame FL_foot``. The name of any other element
    is returned without a kind.
    """
    if difference.kind in BODY_KINDS:
        return f"link {find_subject_link(difference)}"
    if difference.kind in _JOINT_PROPERTIES:
        return f"joint {difference.element}"
    if difference.kind == "frame":
        return f"frame {difference.element}"
    return difference.element


def find_subject_link(difference: Difference) -> str:
    """Return the name of the link, or of another element, that a difference concerns.

    Args:
        difference: Difference between URDF and MJCF.
    """
    subject = difference.diagnostic.subject
    return subject.name if subject is not None and subject.kind == "link" else difference.element


def format_difference_label(difference: Difference) -> str:
    """Format the name of a difference between URDF and MJCF, such as ``link FL_hip: mass``."""
    kind = "position" if difference.kind == "frame" else difference.kind
    return f"{format_owner_name(difference)}: {kind}"


def choose_files(
    differences: Sequence[Difference], take: str | Iterable[str]
) -> tuple[str | None, ...]:
    """Choose for each difference the file whose value is taken, from the user's choices.

    Args:
        differences: Differences, numbered from 1.
        take: Choices of the form ``FILE`` or ``FILE:SELECTION``, where FILE is ``urdf`` or
            ``mjcf``. A selection is a list of numbers (``3``, ``1,4-6``), a kind (``mass``), an
            owner (``base``, ``joint FL_hip``), or owner and kind (``link FL_hip: mass``). The most
            specific choice has precedence, then the last.

    Returns:
        ``"urdf"``, ``"mjcf"`` or None (not chosen) for each difference.

    Raises:
        ConfigurationError: If a choice is not valid or matches no difference.
    """
    result: list[str | None] = [None] * len(differences)
    rank = [0] * len(differences)
    for text in [take] if isinstance(take, str) else take:
        side, colon, which = text.partition(":")
        side, which = side.strip().lower(), which.strip().strip("\"'").strip()
        if side not in FILE_SIDES or (colon and not which):
            raise ConfigurationError("take", diagnose("take-not-valid", given=text))
        for index, weight in _match_choice(differences, which):
            if weight >= rank[index]:
                result[index], rank[index] = side, weight
    return tuple(result)


def _match_choice(differences: Sequence[Difference], which: str) -> Iterator[tuple[int, int]]:
    """Yield index and rank of the differences that a choice selects; empty ``which``: all.

    ``which`` is a label, a link, an element, a kind, or a list of numbers such as ``1,3-5``. More
    specific choices have a higher rank.

    Raises:
        ConfigurationError: If ``which`` matches no difference, or a number is not valid.
    """
    if not which:
        yield from ((index, 0) for index in range(len(differences)))
        return
    names = [
        (
            format_difference_label(difference),
            format_owner_name(difference),
            find_subject_link(difference),
            difference.element,
            difference.kind,
        )
        for difference in differences
    ]
    ranks = (3, 2, 2, 2, 1)
    if not any(which in labels for labels in names) and re.fullmatch(r"[\d,\s-]+", which):
        yield from ((number - 1, 4) for number in _parse_number_ranges(which, len(differences)))
        return
    is_matched = False
    for index, labels in enumerate(names):
        if which in labels:
            is_matched = True
            yield index, ranks[labels.index(which)]
    if not is_matched:
        valid_names = dict.fromkeys(labels[0] for labels in names)
        raise ConfigurationError(
            "take", diagnose("no-such-difference", given=which, known=valid_names)
        )


def _parse_number_ranges(text: str, count: int) -> Iterator[int]:
    """Yield the numbers, from 1 to ``count``, of a list such as ``1,4-6``.

    Raises:
        ConfigurationError: If the text is no such list.
    """
    for part in text.split(","):
        match = re.fullmatch(r"\s*(\d+)\s*(?:-\s*(\d+)\s*)?", part)
        if match is None:
            raise ConfigurationError("take", diagnose("no-list-of-numbers", given=text))
        first, last = int(match[1]), int(match[2] or match[1])
        if not 1 <= first <= last <= count:
            message = diagnose("no-such-number", given=part.strip(), most=count)
            raise ConfigurationError("take", message)
        yield from range(first, last + 1)
