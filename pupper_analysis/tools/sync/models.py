"""Makes a URDF and an MJCF agree: the numbers of one are written into the other, in place."""

from __future__ import annotations

import difflib
import re
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import ConfigurationError, ModelError, OutputError
from pupper_analysis.base.files import Writing, remove_stale_files, resolve_target, write_all
from pupper_analysis.base.inputs import MAX_FILE_BYTES, MAX_TEXT_BYTES, read_input
from pupper_analysis.base.kinds import EDITED_KIND
from pupper_analysis.base.results import Result
from pupper_analysis.models.attributes import JOINT_ATTRIBUTES
from pupper_analysis.models.git import SAFE_OPTIONS, run_git
from pupper_analysis.models.mjcf import silence_mujoco
from pupper_analysis.robot.compare.compare import FilesCompared, compare_files
from pupper_analysis.robot.compare.differences import SERVO_GAIN_KINDS, Difference
from pupper_analysis.robot.matching.tolerances import Tolerances
from pupper_analysis.tools.sync.frames import Key
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
    """A difference that is not mended.

    Attributes:
        difference: Its name: ``link base: mass``.
        reason: Why.
        cause: The kind of reason.
    """

    difference: str
    reason: Diagnostic
    cause: UnwrittenCause


@dataclass(frozen=True, eq=False)
class Sync(Result):
    """What became of making two files agree.

    Attributes:
        differences: All that were found, in the order of mending.
        taken: {name of a difference: ``"urdf"`` or ``"mjcf"``}: whose value was taken.
        edits: What was written, or would be.
        not_mended: What was not mended, and why.
        notes: {name of a difference: what is to be said of how it was mended}.
        diff: The changes of the files, as ``diff -u`` has them.
        written: The files that were replaced.
        backups: Copies of the files as they were.
        withheld: Whether nothing is written because not all of what was chosen can be: what is
            left ``not mended`` would make a robot of two versions.
        agree: Whether the files agree, with these edits.
    """

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


@check_arguments
@silence_mujoco()
def sync_models(
    urdf: str | Path,
    mjcf: str | Path,
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
    """Makes a URDF and an MJCF of one robot agree, by writing numbers of one into the other.

    Only attributes whose numbers differ are written; no other byte of a file is. What is to be
    written is tried first, beside the files: what does not mend its difference is not written.
    All that was chosen is written, in both files, or nothing is.

    Args:
        urdf: Path of the URDF.
        mjcf: Path of the MJCF.
        take: Whose values are taken: ``"urdf"`` (then the MJCF is changed) or ``"mjcf"``, for all,
            or for some (``"mjcf:mass"``, ``"urdf:link base: mass"``, ``"mjcf:3"``). Of what is
            not named, nothing is changed; and what is not stated overwrites nothing.
        partial: Write what can be, if not all that was chosen can.
        dry_run: Write nothing, and say what would be written.
        backup: Keep the old files, as ``NAME.bak``.
        force: Write to files of a git repository with changes that are not committed.
        names: {name in the URDF: name in the MJCF} of joints and frames whose names differ.
        packages: {ROS package: its folder}, for ``package://`` paths.
        tolerances: What counts as a difference; by default what does for `compare_models`, so that
            numbers of 5 or 6 digits stay as they are written. ``Tolerances.strict()`` is for all
            but the rounding of floating-point numbers.

    Returns:
        What was, or would be, written, and what is left.

    Raises:
        ModelError: If a file cannot be read, or the two cannot be matched.
        ConfigurationError: If a choice means nothing.
        OutputError: If a file cannot be written, or has changes that are not committed.
    """
    files = Files(Path(urdf), Path(mjcf), dict(names or {}), dict(packages or {}))
    tolerances = tolerances or Tolerances()
    comparison = _compared(files, tolerances)
    choices = choose_files(comparison.differences, take)
    keys = {
        (difference.kind, difference.element): side
        for difference, side in zip(comparison.differences, choices, strict=True)
        if side is not None
    }
    plan, after = _tried(files, tolerances, comparison, keys)
    withheld = not partial and any(
        plan.find_cause(key) == UnwrittenCause.NOT_MENDED for key in plan.left
    )
    idle = dry_run or withheld
    written, backups = ((), ()) if idle else _written(plan, backup=backup, force=force)
    labels = {(d.kind, d.element): format_difference_label(d) for d in comparison.differences}
    return Sync(
        differences=comparison.differences,
        taken={labels[key]: side for key, side in keys.items()},
        edits=plan.edits(),
        not_mended=tuple(_unmended(plan, comparison, after, keys, labels)),
        notes={labels[key]: note for key, note in plan.notes.items() if key not in plan.left},
        diff="".join(make_unified_diff(d.path, d.data, d.render()) for d in plan.documents()),
        written=written,
        backups=backups,
        withheld=withheld,
        agree=after.agree,
    )


def _compared(files: Files, tolerances: Tolerances) -> FilesCompared:
    return compare_files(
        files.urdf,
        files.mjcf,
        names=files.names,
        packages=files.packages,
        tolerances=tolerances,
    ).result


def _tried(
    files: Files, tolerances: Tolerances, comparison: FilesCompared, keys: Mapping[Key, str]
) -> tuple[Plan, FilesCompared]:
    """Returns a plan that does what it says, and the comparison of the files after it.

    What was planned is written elsewhere, and compared. What still differs then is left as it was,
    and so is all of it, if an engine refuses to read a file.
    """
    refused: dict[Key, Diagnostic] = {}
    while True:
        waiting = {key: side for key, side in keys.items() if key not in refused}
        plan = make_plan(files, tolerances, waiting)
        plan.left.update(refused)
        tried = keys.keys() - plan.left.keys()
        if not plan.edits():
            plan.left.update(dict.fromkeys(tried, diagnose("no-attribute-states-it")))
            return plan, comparison
        try:
            after = _after(plan, tolerances)
        except ModelError as error:
            refused |= dict.fromkeys(tried, diagnose("file-refused-with-it", problem=error.cause))
            continue
        still = {(d.kind, d.element) for d in after.differences} & tried
        if not still:
            return plan, after
        refused |= dict.fromkeys(still, diagnose("change-mends-nothing"))


def _after(plan: Plan, tolerances: Tolerances) -> FilesCompared:
    """Compares the files as they would be.

    Raises:
        ModelError: If one is refused then.
    """
    documents = {**plan.urdf, **plan.mjcf}
    contents = {
        place: documents[file].render() if file in documents else read_input(file, MAX_FILE_BYTES)
        for copies in plan.copies
        for file, place in copies.places.items()
    }
    with write_temporary_files(contents) as folder:
        urdf, mjcf = (folder / copies.places[copies.main] for copies in plan.copies)
        try:
            return _compared(replace(plan.files, urdf=urdf, mjcf=mjcf), tolerances)
        except ModelError as error:
            cause = error.cause.with_names(lambda text: text.replace(f"{folder}/", ""))
            raise ModelError(error.source, cause) from error


def _written(plan: Plan, *, backup: bool, force: bool) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Replaces all files, or none; returns them, and the copies of the old ones."""
    for document in plan.documents():
        remove_stale_files(resolve_target(document.path)[0].parent)
    changed = [d for d in plan.documents() if d.render() != d.data]
    if not force:
        for document in changed:
            refuse_uncommitted(document.path)
    writings = [Writing(d.path, d.render(), EDITED_KIND, before=d.data) for d in changed]
    kept = write_all(writings, backup=backup)
    return tuple(str(d.path) for d in changed), tuple(map(str, kept))


def refuse_uncommitted(path: Path) -> None:
    """Refuses a file of a git repository that has changes which are not committed.

    A file that git does not track has none, nor has one that differs in its ends of lines alone.

    Raises:
        OutputError: If it has.
    """
    path = path.resolve()
    if shutil.which("git") is None or not any((one / ".git").exists() for one in path.parents):
        return
    here = path.parent
    if not _asked(here, "ls-files", "-z", "--", f":(literal){path.name}"):
        return
    committed = _asked(here, "cat-file", "blob", f"HEAD:./{path.name}")
    content = read_input(path, MAX_TEXT_BYTES)
    if committed is None or content.replace(b"\r\n", b"\n") != committed.replace(b"\r\n", b"\n"):
        raise OutputError(path, diagnose("uncommitted-changes"))


def _asked(folder: Path, *arguments: str) -> bytes | None:
    """Returns git's answer; None if it gives none."""
    found = run_git(["git", *SAFE_OPTIONS, *arguments], folder)
    return found.stdout if found.returncode == 0 else None


def _unmended(
    plan: Plan,
    before: FilesCompared,
    after: FilesCompared,
    keys: Mapping[Key, str],
    labels: Mapping[Key, str],
) -> Iterable[Unmended]:
    """Yields what is not mended: not chosen, not to be written, new, or no number at all."""
    still = {(d.kind, d.element): d for d in after.differences}
    for key, name in labels.items():
        if key in plan.left and key in still:  # others may have mended it along with them
            yield Unmended(name, plan.left[key], plan.find_cause(key))
        elif key not in keys and key in still:
            yield Unmended(name, diagnose("nothing-chosen"), UnwrittenCause.NOT_CHOSEN)
    for key, difference in still.items():
        if key not in labels:
            reason = diagnose("there-since", difference=difference.diagnostic)
            yield Unmended(format_difference_label(difference), reason, UnwrittenCause.NEW)
    for part in before.parts:
        yield Unmended("part", diagnose("part-unwritten", part=part), UnwrittenCause.NO_WORDS)
    for joints, there, other in (
        (before.only_urdf, "URDF", "MJCF"),
        (before.only_mjcf, "MJCF", "URDF"),
    ):
        for joint in joints:
            reason = diagnose("one-file-alone-has-it", one=there, other=other)
            yield Unmended(f"joint {joint}", reason, UnwrittenCause.NO_WORDS)
    if not after.differences:
        for objection in after.objections:
            yield Unmended("agreement", objection, UnwrittenCause.NO_WORDS)


def make_unified_diff(path: Path, before: bytes, after: bytes) -> str:
    """Returns what would change in a file, as ``diff -u`` and ``patch`` have it."""
    one, two = (text.decode("utf-8").split("\n") for text in (before, after))
    lines = difflib.unified_diff(one, two, f"a/{path.name}", f"b/{path.name}", lineterm="")
    return "\n".join(lines) + "\n" if before != after else ""


# Which file's value is taken in which difference.

FILE_SIDES: Final = ("urdf", "mjcf")

_OF_BODY: Final = ("mass", "com", "inertia")

_OF_JOINT: Final = (
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


def format_owner_name(difference: Difference) -> str:
    """Names what a difference is of: ``link FL_hip``, ``joint FL_hip_joint``, ``frame FL_foot``."""
    if difference.kind in _OF_BODY:
        return f"link {find_subject_link(difference)}"
    if difference.kind in _OF_JOINT:
        return f"joint {difference.element}"
    if difference.kind == "frame":
        return f"frame {difference.element}"
    return difference.element


def find_subject_link(difference: Difference) -> str:
    """Returns the link that a difference is of; its element, where it is not of a link."""
    subject = difference.diagnostic.subject
    return subject.name if subject is not None and subject.kind == "link" else difference.element


def format_difference_label(difference: Difference) -> str:
    """Names a difference: ``link FL_hip: mass``."""
    kind = "position" if difference.kind == "frame" else difference.kind
    return f"{format_owner_name(difference)}: {kind}"


def choose_files(
    differences: Sequence[Difference], take: str | Iterable[str]
) -> tuple[str | None, ...]:
    """Says whose value is taken, per difference; None where nothing was chosen.

    Args:
        differences: The differences, numbered from 1.
        take: ``"urdf"``, ``"mjcf"``, or either with a colon and what it is taken for: numbers
            (``3``, ``1,4-6``), a kind (``mass``), what it is of (``base``, ``joint FL_hip``), or
            both (``link FL_hip: mass``). What is more particular counts, whatever the order; of
            two that are as particular, the last.

    Raises:
        ConfigurationError: If a choice is not of that form, or meets no difference.
    """
    result: list[str | None] = [None] * len(differences)
    rank = [0] * len(differences)
    for text in [take] if isinstance(take, str) else take:
        side, colon, which = text.partition(":")
        side, which = side.strip().lower(), which.strip().strip("\"'").strip()
        if side not in FILE_SIDES or (colon and not which):
            raise ConfigurationError("take", diagnose("take-not-valid", given=text))
        for index, weight in _meant(differences, which):
            if weight >= rank[index]:
                result[index], rank[index] = side, weight
    return tuple(result)


def _meant(differences: Sequence[Difference], which: str) -> Iterator[tuple[int, int]]:
    """Yields the places of the differences that are meant, and how particular that is."""
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
    if not any(which in of_one for of_one in names) and re.fullmatch(r"[\d,\s-]+", which):
        yield from ((number - 1, 4) for number in _numbers(which, len(differences)))
        return
    found = False
    for index, of_one in enumerate(names):
        if which in of_one:
            found = True
            yield index, ranks[of_one.index(which)]
    if not found:
        known = dict.fromkeys(of_one[0] for of_one in names)
        raise ConfigurationError("take", diagnose("no-such-difference", given=which, known=known))


def _numbers(text: str, most: int) -> Iterator[int]:
    for part in text.split(","):
        found = re.fullmatch(r"\s*(\d+)\s*(?:-\s*(\d+)\s*)?", part)
        if found is None:
            raise ConfigurationError("take", diagnose("no-list-of-numbers", given=text))
        first, last = int(found[1]), int(found[2] or found[1])
        if not 1 <= first <= last <= most:
            message = diagnose("no-such-number", given=part.strip(), most=most)
            raise ConfigurationError("take", message)
        yield from range(first, last + 1)
