"""Remarks of a check with identities that remain valid between runs, and the baseline.

The baseline is a text file with known remarks, so that only new remarks fail.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from operator import itemgetter
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np

from pupper_analysis.base.arguments import is_finite_number
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, Severity, Vector, diagnose
from pupper_analysis.base.errors import InputError, ModelError, PupperAnalysisError
from pupper_analysis.base.files import Writing, write_all
from pupper_analysis.base.inputs import MAX_TEXT_BYTES, decode_input, is_input, read_input
from pupper_analysis.base.kinds import OutputKind
from pupper_analysis.base.results import Result
from pupper_analysis.models.places import source_name
from pupper_analysis.robot.compare.compare import FilesCompared
from pupper_analysis.tools.audit.audit import RULES, Audit
from pupper_analysis.tools.check.config import GuardedPair

NUM_DIGITS = 9
"""Significant digits of values in the baseline. Further digits may be rounding errors. Chosen, not
tuned."""


REFUSED_KIND = "refused"
"""Value of ``Remark.kind`` if a file cannot be read, or if the comparison or check of another tool
ended with an error. The baseline (file of accepted findings) never accepts such a remark."""


@dataclass(frozen=True, eq=False)
class Remark(Result):
    """Difference between two files, finding in a file, or change since a revision.

    Attributes:
        check: ``crosscheck``, ``audit``, ``diff`` for changes since a revision, or the name of
            another tool, such as ``contract``.
        pair: Name of the pair; "" for an audit finding, which belongs to the file.
        kind: Kind of the difference, change or finding; ``joint``, ``part`` or ``agreement``; audit
            rule; ``simulation`` for the effect of all changes; or ``refused`` if the file could not
            be read or compared.
        element: Joint, body, frame or other element; "" if the remark concerns the whole file; name
            of the pair if the file could not be read or compared.
        file: File; for a difference, the URDF. Path relative to the configuration, with ``/``.
        values: Values in the baseline: both values of a difference, or code and values of the
            diagnostic.
        severity: Severity.
        diagnostic: Message.
        place: ``file:line``, a path that can be opened, without the line if unknown; None if no
            place is known.
        other_place: Second place: of a difference in the MJCF, or of another tool's finding; None
            if there is none.
        known: Whether the baseline contains the remark with the same values.
        fails: Whether the remark makes the check fail: not known, and severe enough.
        cause: Mistake that explains this difference together with others.
        consequences: Effects of a change since a revision, in a simulation, or effects that another
            tool states.
        repairable: Whether ``audit --fix`` can repair the finding of an audit rule.
    """

    check: str
    pair: str
    kind: str
    element: str
    file: str
    values: Mapping[str, Any]
    severity: Severity
    diagnostic: Diagnostic
    place: str | None
    other_place: str | None = None
    known: bool = False
    fails: bool = False
    cause: Diagnostic | None = None
    consequences: tuple[Diagnostic, ...] = ()
    repairable: bool = False

    _reported = ("message",)

    @property
    def message(self) -> str:
        """English message of the remark, with effects of a change or the repair of a finding."""
        if self.check != "audit" or self.kind not in RULES:
            return "; ".join(map(str, (self.diagnostic, *self.consequences)))
        finding = str(self.diagnostic).rstrip(".")
        return f"{self.element}: {finding}. {RULES[self.kind].todo}"

    @property
    def identity(self) -> tuple[str, str, str, str, str]:
        """Key that remains equal if values or lines change: check, pair, file, kind and element."""
        return self.check, self.pair, self.file, self.kind, self.element

    @property
    def finding(self) -> tuple[object, ...]:
        """Key of the finding to which this remark belongs; equal keys are counted once."""
        what = (self.kind, str(self.values)) if self.cause is None else (str(self.cause),)
        return self.check, self.pair, self.file, self.known, *what


def list_comparison_remarks(
    comparison: FilesCompared, pair: GuardedPair, folder: Path
) -> Iterator[Remark]:
    """Yield a remark for each result of the comparison of a URDF with an MJCF.

    The files of the remarks are relative to ``folder``.
    """
    file = relative_path(comparison.urdf, folder)
    causes = {
        number: cause.diagnostic for cause in comparison.causes for number in cause.differences
    }
    for number, difference in enumerate(comparison.differences):
        values = {"urdf": difference.urdf, "mjcf": difference.mjcf}
        yield Remark(
            "crosscheck",
            pair.name,
            difference.kind,
            difference.element,
            file,
            {side: to_rounded_plain(value) for side, value in values.items() if value is not None},
            Severity.ERROR,
            difference.diagnostic,
            difference.urdf_place,
            difference.mjcf_place,
            cause=causes.get(number),
        )
    messages = [("part", "", part, comparison.urdf) for part in comparison.parts]
    for joints, path, lacking_path in (
        (comparison.only_urdf, comparison.urdf, comparison.mjcf),
        (comparison.only_mjcf, comparison.mjcf, comparison.urdf),
    ):
        for name in joints:
            lacks = diagnose(
                "joint-not-in-file",
                subject=("joint", name),
                lacks=Path(lacking_path).name,
                sources=path,
            )
            messages.append(("joint", name, lacks, path))
    messages += [
        ("agreement", "", objection, comparison.mjcf) for objection in comparison.objections
    ]
    for kind, element, diagnostic, place in messages:
        yield make_remark(
            "crosscheck", pair.name, kind, element, file, diagnostic, Severity.ERROR, place
        )


def list_audit_remarks(audit: Audit, folder: Path) -> Iterator[Remark]:
    """Yield a remark for each finding of an audit, with the file relative to ``folder``."""
    for finding in audit.findings:
        remark = make_remark(
            "audit",
            "",
            finding.rule,
            finding.element,
            relative_path(finding.file, folder),
            finding.diagnostic,
            finding.severity,
            finding.place.path,
        )
        is_repairable = len(finding.repairs) == 1 and not finding.repairs[0].is_estimate
        yield replace(remark, repairable=is_repairable)


def list_guard_remarks(
    tool: str, findings: Iterable[Any], pair: GuardedPair, folder: Path
) -> Iterator[Remark]:
    """Convert the findings of another tool, such as ``contract``, to remarks of ``check``.

    Findings have ``kind``, ``joints``, ``severity``, ``diagnostic``, ``effects`` and ``places``
    (``file:line``; two for a difference). Files of the remarks are relative to ``folder``.
    """
    for finding in findings:
        file, _, line = finding.places[0].rpartition(":")
        plain = line.isdecimal() or line.startswith("<")
        named = relative_path(file if plain else finding.places[0], folder)
        yield make_remark(
            tool,
            pair.name,
            finding.kind,
            ", ".join(finding.joints),
            named,
            finding.diagnostic,
            finding.severity,
            finding.places[0],
            next(iter(finding.places[1:]), None),
            finding.effects,
        )


def make_error_remark(
    error: PupperAnalysisError, check: str, pair: GuardedPair, path: Path, folder: Path
) -> Remark:
    """Create the remark about a file that cannot be read, or a check that ended with an error.

    ``check`` is ``audit``, ``crosscheck`` or the name of another tool. The file of the remark is
    relative to ``folder``.
    """
    place = str(getattr(error, "source", path))
    file, _, line = place.rpartition(":")
    known = is_input(Path(file if line.isdecimal() else place))
    return make_remark(
        check,
        pair.name,
        REFUSED_KIND,
        pair.name,
        relative_path(path, folder),
        error.cause if known and isinstance(error, ModelError) else error.diagnostic,
        Severity.ERROR,
        place if known else str(path),
    )


def make_remark(
    check: str,
    pair: str,
    kind: str,
    element: str,
    file: str,
    message: Diagnostic,
    bad: Severity,
    place: str | None,
    other_place: str | None = None,
    consequences: tuple[Diagnostic, ...] = (),
) -> Remark:
    """Create a remark from a diagnostic, whose code and values the baseline stores.

    Args:
        check: Tool that found the remark (``Remark.check``), such as ``"audit"``.
        pair: Name of the pair; "" for a finding that belongs to a file.
        kind: Kind of the finding (``Remark.kind``).
        element: Element of the model with the finding (``Remark.element``).
        file: File, relative to the configuration.
        message: Diagnostic.
        bad: Severity.
        place: ``file:line``, or a path without the line; None if unknown.
        other_place: ``file:line`` in the second file of a difference; None if there is none.
        consequences: Effects (``Remark.consequences``).
    """
    return Remark(
        check,
        pair,
        kind,
        element,
        file,
        to_rounded_plain(message),
        bad,
        message,
        place,
        other_place,
        consequences=consequences,
    )


def relative_path(file: str | Path, folder: Path) -> str:
    """Return the path of a file relative to a folder, with ``/``; may begin with ``..``.

    Symbolic links are resolved.
    """
    return Path(os.path.relpath(Path(file).resolve(), folder.resolve())).as_posix()


def to_rounded_plain(value: Any) -> Any:
    """Convert a value to JSON types, with floats rounded to `NUM_DIGITS` significant digits.

    The baseline, a file with known remarks, contains the result. A diagnostic becomes a table with
    its code and values, in SI units.
    """
    if isinstance(value, Diagnostic):
        values = {
            name: to_rounded_plain(item) for name, item in value.values.items() if item is not None
        }
        return {"code": value.code, **({"values": values} if values else {})}
    if isinstance(value, Quantity):
        return to_rounded_plain(value.value)
    if isinstance(value, Vector):
        return to_rounded_plain(np.array(value.values))
    if isinstance(value, np.ndarray):
        largest = float(np.abs(value).max(initial=0.0))
        # Values below 1e-12 of the largest may be rounding errors, which depend on the machine.
        return to_rounded_plain(np.where(np.abs(value) > 1e-12 * largest, value, 0.0).tolist())
    if isinstance(value, np.generic):
        return to_rounded_plain(value.item())
    if isinstance(value, Mapping):
        return {str(key): to_rounded_plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [to_rounded_plain(item) for item in value]
    if isinstance(value, float):
        return float(f"{value:.{NUM_DIGITS}g}") + 0.0
    return value if isinstance(value, bool | int | str) or value is None else str(value)


_HEADER_TEXT: Final = """\
# Accepted findings of `pupper-analysis check`. A finding that is new or has another value fails.
# Written by `pupper-analysis check --update-baseline`; review its diff. One finding per line:
# ["check", "pair", "file", "kind", "element", {values}]
"""
"""Comment at the top of a baseline."""

_HEADER_LINES: Final = _HEADER_TEXT.splitlines()
"""Lines of the comment at the top of a baseline."""

_VALUE_RTOL: Final = 1e-6
"""Largest relative difference of two numbers with which a finding has the same value as in the
baseline. `values_agree` defines the divisor. Chosen, not tuned."""


@dataclass(frozen=True)
class BaselineEntry(Result):
    """Accepted remark in the baseline.

    Attributes:
        identity: Identity of the remark.
        values: Values of the remark.
    """

    identity: tuple[str, ...]
    values: Mapping[str, Any]

    def __str__(self) -> str:
        check, pair, file, kind, element = self.identity
        return f"{check} of {pair or file}: {kind}{f' of {element}' if element else ''}"


@dataclass(frozen=True, eq=False)
class Baseline:
    """The content of a baseline file.

    Attributes:
        entries: Known remarks, in the order of the file.
        content: The file's bytes; None if there is no file.
        top: Lines of the user between the package's header and the first entry, as far as a blank
            line separates them from that entry.
        comments: (entry, the comment lines directly above it) of each entry that has some.
        end: Comment lines below the last entry.
    """

    entries: tuple[BaselineEntry, ...] = ()
    content: bytes | None = None
    top: tuple[str, ...] = ()
    comments: tuple[tuple[BaselineEntry, tuple[str, ...]], ...] = ()
    end: tuple[str, ...] = ()

    def format_text(self, entries: Iterable[BaselineEntry]) -> str:
        """Return the text of this baseline with other entries, sorted, and the user's comments.

        A comment stays above its entry, if this still exists.
        """
        written = sorted(
            ((_format_baseline_line(entry), entry) for entry in entries), key=itemgetter(0)
        )
        above: list[list[str]] = [[] for _ in written]
        end: list[str] = []
        for old, comment in self.comments:
            same_identity = [
                row for row, (_, new) in enumerate(written) if new.identity == old.identity
            ]
            same_value = [
                row for row in same_identity if values_agree(written[row][1].values, old.values)
            ]
            row = next(iter((*same_value, *same_identity)), None)
            (end if row is None else above[row]).extend(comment)
        body = [
            text
            for comments, (line, _) in zip(above, written, strict=True)
            for text in (*comments, line)
        ]
        return "\n".join([*_HEADER_LINES, *self.top, "", *body, *end, *self.end, ""])


def read_baseline(path: Path) -> Baseline:
    """Read the accepted remarks and the comments of a baseline; empty if the file does not exist.

    Raises:
        ModelError: If the file cannot be read, or a line is not valid.
    """
    try:
        content = read_input(path, MAX_TEXT_BYTES)
        text = decode_input(path, content)
    except InputError as error:
        if error.cause.code == "no-such-file":
            return Baseline()
        raise ModelError(source_name(path, error.line), error.cause) from error
    entries: list[BaselineEntry] = []
    comments: list[tuple[BaselineEntry, tuple[str, ...]]] = []
    top: tuple[str, ...] = ()
    block: list[str] = []
    for number, line in enumerate(map(str.rstrip, text.split("\n")), start=1):
        if not line or line.startswith("#"):
            block.append(line)
            continue
        entry = _parse_baseline_line(line)
        if entry is None:
            raise ModelError(source_name(path, number), diagnose("baseline-line-unknown"))
        if not entries:
            top, block = _split_top(block)
        if comment := tuple(filter(None, block)):
            comments.append((entry, comment))
        entries.append(entry)
        block = []
    if not entries:
        top, block = _split_top([*block, ""])
    return Baseline(tuple(entries), content, top, tuple(comments), tuple(filter(None, block)))


def _split_top(lines: list[str]) -> tuple[tuple[str, ...], list[str]]:
    """Split the lines above a baseline's first entry, and leave out the header of the file.

    Returns:
        The user's text at the top of the file, and the comment of the first entry.
    """
    own = [*lines]
    for line in _HEADER_LINES:
        if line in own:
            own.remove(line)
    blank = max((at for at, line in enumerate(own) if not line), default=0)
    top = "\n".join(own[:blank]).rstrip("\n")
    return tuple(top.split("\n")) if top.strip() else (), own[blank:]


def _parse_baseline_line(line: str) -> BaselineEntry | None:
    """Return the entry that a line of the baseline file contains; None for other lines."""
    try:
        found = json.loads(line, parse_int=float)  # integers of any number of digits
    except (ValueError, RecursionError):
        return None
    match found:
        case [str(), str(), str(), str(), str(), dict() as values]:
            return BaselineEntry(tuple(found[:5]), values)
    return None


def _format_baseline_line(entry: BaselineEntry) -> str:
    """Return an entry as a line of the baseline: a JSON list of identity and values."""
    return json.dumps([*entry.identity, entry.values], default=dict, ensure_ascii=False)


def _is_baseline(file: BinaryIO) -> bool:
    """Return True if a file is a baseline: a list of accepted remarks written by this package.

    The first line is the header of a baseline, or a line can be read as an entry of a baseline.
    """
    lines = file.read(MAX_TEXT_BYTES).decode("utf-8-sig", errors="replace").splitlines()
    return lines[:1] == [_HEADER_LINES[0]] or any(
        _parse_baseline_line(line) is not None for line in lines if line.startswith("[")
    )


BASELINE_FILE: Final = OutputKind("baseline", _is_baseline, edits=True)
"""Kind of the baseline file (list of accepted findings). The same run may read and rewrite this
file. An existing file that is not empty, and has neither the header nor an entry of a baseline, is
not overwritten."""


def write_baseline(path: Path, before: Baseline, entries: Iterable[BaselineEntry]) -> None:
    """Write a baseline in place of the one that was read (``before``), with the user's comments.

    Raises:
        OutputError: If the file cannot be written, is not a baseline, or has changed since reading.
    """
    content = before.format_text(entries).encode(errors="replace")
    write_all([Writing(path, content, BASELINE_FILE, before=before.content)])


def mark_known_remarks(
    remarks: Iterable[Remark], entries: Iterable[BaselineEntry]
) -> tuple[tuple[Remark, ...], tuple[BaselineEntry, ...]]:
    """Mark the remarks of a check that the baseline (list of accepted remarks) contains.

    Each entry of the baseline matches at most one remark. A remark about a file that cannot be
    read, or about a failed comparison or check (`REFUSED_KIND`), is never known.

    Returns:
        All remarks with ``known`` set, and the stale entries, which match no remark.
    """
    waiting: dict[tuple[str, ...], list[BaselineEntry]] = {}
    for entry in entries:
        waiting.setdefault(entry.identity, []).append(entry)
    result = []
    for remark in remarks:
        candidates = waiting.get(remark.identity, [])
        match = next(
            (entry for entry in candidates if values_agree(entry.values, remark.values)), None
        )
        if match is not None:
            candidates.remove(match)
        # The content of an unreadable file is unknown.
        result.append(replace(remark, known=match is not None and remark.kind != REFUSED_KIND))
    return tuple(result), tuple(entry for candidates in waiting.values() for entry in candidates)


def count_findings(remarks: Iterable[Remark]) -> int:
    """Count the distinct findings of remarks; remarks with an equal `Remark.finding` count once."""
    return len({remark.finding for remark in remarks})


def values_agree(first: Any, second: Any) -> bool:
    """Return True if the values of two remarks agree, for example of a finding and the baseline.

    Numbers may differ by `_VALUE_RTOL`, mostly relative to the largest magnitude in both lists.
    """
    if isinstance(first, Mapping) and isinstance(second, Mapping):
        return first.keys() == second.keys() and all(
            values_agree(first[key], second[key]) for key in first
        )
    first_leaves, second_leaves = _flatten_value(first), _flatten_value(second)
    sizes = [abs(leaf) for leaf in (*first_leaves, *second_leaves) if is_finite_number(leaf)]
    if any(isinstance(leaf, str) for leaf in first_leaves):
        sizes = []  # mixed content: each number has its own scale
    return len(first_leaves) == len(second_leaves) and all(
        abs(a - b) <= _VALUE_RTOL * max([*sizes, abs(a), abs(b)])
        if is_finite_number(a) and is_finite_number(b)
        else repr(a) == repr(b)
        for a, b in zip(first_leaves, second_leaves, strict=True)
    )


def _flatten_value(value: Any) -> list[Any]:
    """List the numbers and texts in nested lists and tables, with markers for their ends."""
    if isinstance(value, list | tuple):
        return [(), *(leaf for item in value for leaf in _flatten_value(item)), ()]
    if isinstance(value, Mapping):
        return [
            {},
            *(leaf for key in sorted(value) for leaf in (key, *_flatten_value(value[key]))),
            {},
        ]
    return [value]
