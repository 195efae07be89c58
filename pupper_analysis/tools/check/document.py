"""Document and annotations of a repository check: failures, and the number of known findings.

Input is a ``RepositoryCheck``. Remarks with the same cause or the same values form a group, with
the quoted lines of both files. Groups of remarks that the baseline contains have one line each.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from pupper_analysis.base.diagnostics import Diagnostic, Severity, diagnose
from pupper_analysis.present import document as doc
from pupper_analysis.present.document import SEVERITY_MARKS, Name, Text, join_words, text, word
from pupper_analysis.present.documents.registry import build_document
from pupper_analysis.present.documents.sources import quote_line
from pupper_analysis.present.formats import ANNOTATION_LEVELS, Annotation, relative_to_checkout
from pupper_analysis.robot.compare.differences import describe_kind
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.audit.audit import RULES
from pupper_analysis.tools.audit.document import (
    describe_counts,
    format_element,
    get_rule_text,
    summarise_finding,
)
from pupper_analysis.tools.check.check import PairCheck, RepositoryCheck, list_pair_remarks
from pupper_analysis.tools.check.remarks import REFUSED_KIND, Remark, count_findings


@build_document.register(RepositoryCheck)
def check_document(check: RepositoryCheck, _: Robot | None = None) -> doc.Document:
    """Create the report of the check of a repository: groups of findings, and pairs of files."""
    groups = group_findings(check.remarks)
    blocks: list[doc.Block] = [_make_remark_block(group) for group in groups if not group[0].known]
    if known := tuple(_describe_known_group(group) for group in groups if group[0].known):
        title = text("count-known", count=len(known))
        blocks.append(doc.Lines(known, title=title, detail=True))
    if check.stale:
        blocks.append(
            doc.Lines(
                tuple(map(doc.diagnostic_text, describe_stale_entries(check))),
                "warn",
                text("stale"),
            )
        )
    blocks.append(_tabulate_pairs(check))
    notes = tuple(
        text("name-note", name=doc.Name(pair.name), note=doc.diagnostic_text(note))
        for pair in check.pairs
        for note in pair.notes
    )
    if notes:
        blocks.append(doc.Lines(notes, title=text("notes-title"), detail=True))
    return doc.Document(
        text("check-of-a-repository"),
        doc.Name(Path(check.config).name),
        tuple(blocks),
        passed=check.passed,
        verdict=text("passed") if check.passed else text("FAILED"),
        findings=(_summarise_comparison(check), *_describe_first_cause(check)),
        next_step=_select_next_step(check),
    )


def _summarise_comparison(check: RepositoryCheck) -> doc.Words:
    """Return the numbers of findings, and that nothing was compared if there is no pair."""
    if not _is_uncompared(check):
        return summarise_check(check)
    remark = text("nothing-compared", files=str(len(check.pairs)))
    return join_words([summarise_check(check), remark], "semicolon")


def _is_uncompared(check: RepositoryCheck) -> bool:
    """Return True if a passed check has at least two files, and no pair of a URDF and an MJCF."""
    is_single = [len(pair.files) == 1 for pair in check.pairs]
    return not check.failures and len(is_single) > 1 and all(is_single)


def _describe_first_cause(check: RepositoryCheck) -> Iterable[doc.Words]:
    """Return the first finding to fix; if no finding fails, the first warning and what was checked.

    Files that were not compared precede the warning. What was checked is omitted if nothing was
    compared.
    """
    first = check.remarks[0] if check.failures else _find_first_warning(check)
    findings = () if first is None else (_describe_placed_finding(check, first),)
    if check.failures:
        return findings
    if findings and _is_uncompared(check):  # the summary states the number of files
        return findings
    files = {file for pair in check.pairs for file in pair.files}
    single = [Path(pair.files[0]) for pair in check.pairs if len(pair.files) == 1]
    mjcfs = [file.name for file in single if file.suffix.lower() != ".urdf"]
    unpaired = tuple(mjcfs) if len(single) < len(check.pairs) else ()
    checked = text(
        "checked-pairs-and-files",
        pairs=len(check.pairs),
        files=len(files),
        unpaired=unpaired or None,
    )
    return (checked, *findings) if unpaired else (*findings, checked)


def _describe_placed_finding(check: RepositoryCheck, remark: Remark) -> doc.Words:
    """Return the text of a finding with its place."""
    place = doc.Name(relative_to_root(remark.place or remark.file))
    finding = _describe_remark(remark)
    if _is_audit_rule(remark):
        alike = [item for item in check.remarks if item.finding == remark.finding]
        finding = summarise_finding(remark.kind, remark.diagnostic, len(alike) - 1)
    return text("first-to-fix", place=place, finding=finding)


def _find_first_warning(check: RepositoryCheck) -> Remark | None:
    """Return the first new warning of a check; None without warnings."""
    return next(filter(_is_new_warning, check.remarks), None)


def _is_new_warning(remark: Remark) -> bool:
    """Return True for a warning that the baseline does not list."""
    return not remark.known and remark.severity is Severity.WARNING


def _select_next_step(check: RepositoryCheck) -> doc.NextStep | None:
    """Return the command to suggest next, such as ``audit`` of the first failing file, or None."""
    if check.stale and not check.updated and not check.failures:
        return doc.NextStep("check", ("--update-baseline",))
    if not check.failures:
        new = [remark for remark in check.remarks if not remark.known and _is_audit_rule(remark)]
        warned = [remark for remark in new if remark.severity is Severity.WARNING]
        if warned:
            return _run_on_files(check, "audit", (warned[0].file,))
        pair = next((pair for pair in check.pairs if len(pair.files) == 2), None)
        if pair is None:
            pair = next((pair for pair in check.pairs if pair.floating is not None), None)
        if pair is None:
            return None
        if len(pair.files) == 1:
            return _run_on_files(check, "stand" if pair.floating else "hold", pair.files)
        command = "crosscheck" if not pair.agree else "stand" if pair.floating else "hold"
        return _run_on_files(check, command, pair.files)
    first = check.remarks[0]
    if first.kind == REFUSED_KIND or _is_audit_rule(first):
        step = _run_on_files(check, "audit", (first.file,))
        return replace(step, words=(*step.words, "--fix")) if first.repairable else step
    if first.check == "crosscheck":
        files = next(pair.files for pair in check.pairs if pair.name == first.pair)
        return _run_on_files(check, "crosscheck", files)
    return None


def _run_on_files(check: RepositoryCheck, command: str, files: Iterable[str]) -> doc.NextStep:
    """Return the suggestion to run a command on files, with the ROS packages of the configuration.

    The paths of ``files`` are relative to the folder of the configuration.
    """
    folder, named = Path(check.config).parent, tuple(files)
    paths = [os.path.relpath(folder / file) for file in named]
    packages = {
        name: os.path.relpath(place)
        for pair in check.pairs
        if set(named) <= set(pair.files)
        for name, place in pair.packages.items()
    }
    options = [
        word for name, place in packages.items() for word in ("--package", f"{name}={place}")
    ]
    return doc.NextStep(command, (*paths, *options), robot_typed=False)


def group_findings(remarks: Iterable[Remark]) -> list[list[Remark]]:
    """Group remarks that have the same cause, or the same values at several elements."""
    groups: dict[tuple[object, ...], list[Remark]] = {}
    for remark in remarks:
        groups.setdefault(remark.finding, []).append(remark)
    return list(groups.values())


def _describe_known_group(group: list[Remark]) -> Text:
    """Return the place and message of the first of a group of remarks in the baseline."""
    place = group[0].place or group[0].file
    return text(
        "name-note", name=doc.Name(relative_to_root(place)), note=_describe_remark(group[0])
    )


def _describe_remark(first: Remark) -> doc.Words:
    """Return the text of a remark: the common cause of several differences, else the message."""
    message = doc.diagnostic_text(first.diagnostic if first.cause is None else first.cause)
    if not _is_audit_rule(first):
        return message
    return text("element-message", element=format_element(first.diagnostic), message=message)


def _is_audit_rule(remark: Remark) -> bool:
    """Return True if a remark is the finding of an audit rule."""
    return remark.check == "audit" and remark.kind in RULES


def _make_remark_block(group: list[Remark]) -> doc.FileFinding:
    """Create the block of a group of remarks: message, quoted lines, effects and repair.

    The first remark of the group defines the message.
    """
    first, *others = group
    notes: list[doc.Words] = []
    if first.cause is not None:
        notes.append(text("this-alone-makes-count-differences", count=len(group)))
        notes.append(doc.diagnostic_text(first.diagnostic))
    elif others:
        names = join_words(doc.Name(remark.element) for remark in others)
        notes.append(text("likewise-on-count-more-names", count=len(others), names=names))
    notes += map(doc.diagnostic_text, first.consequences)
    tag = text(
        "severity-check-kind",
        severity=word(str(first.severity)),
        check=first.check,
        kind=first.kind if first.cause is None else "cause",
    ).with_mark(SEVERITY_MARKS[first.severity])
    places = [first.place or first.file, *([first.other_place] if first.other_place else [])]
    named = [(relative_to_root(place), place) for place in places]
    columns = tuple(
        doc.FilePlace(doc.Name(shown), doc.Name(quote_line(place, first.file)), shown)
        for shown, place in named
    )
    if _is_audit_rule(first):
        notes.append(get_rule_text(first.kind, "todo"))
    sides = doc.FileFinding(_describe_remark(first), columns, tuple(notes), tag)
    return replace(sides, detail=not any(remark.fails for remark in group))


def _name_verdict(check: RepositoryCheck, pair: PairCheck) -> Text:
    """Return the verdict of a pair: FAILED, WARNINGS for new warnings that pass, or OK."""
    if pair.failures:
        return text("FAILED").with_mark("bad")
    suspect = any(map(_is_new_warning, list_pair_remarks(pair, check.remarks)))
    return text("audit-warnings" if suspect else "all-ok").with_mark("warn" if suspect else "good")


def _tabulate_pairs(check: RepositoryCheck) -> doc.Table:
    """Create the table of the checked pairs, with numbers of failing and known findings."""
    columns = (
        doc.Column(text("pair"), left=True),
        doc.Column(text("verdict"), left=True),
        doc.Column(text("to-fix"), "1"),
        doc.Column(text("known"), "1"),
        doc.Column(text("files"), left=True),
    )
    rows: list[tuple[doc.Cell, ...]] = [
        (
            doc.Name(pair.name),
            _name_verdict(check, pair),
            doc.number_cell(pair.failures, "g"),
            doc.number_cell(pair.known, "g"),
            doc.Name(", ".join(pair.files)),
        )
        for pair in check.pairs
    ]
    return doc.Table(text("what-was-checked"), columns, tuple(rows))


# Summary in a line, and annotations for machines.


def summarise_check(check: RepositoryCheck) -> Text:
    """Return a line with the numbers of failing, known and stale findings, and others by severity.

    For example, ``1 to fix, 2 warnings``; ``0 errors, 2 warnings, 3 notes`` if no finding fails.
    """
    passing = [remark for remark in check.remarks if not remark.known and not remark.fails]
    counts: dict[str, int] = {
        severity: count_findings(remark for remark in passing if remark.severity is severity)
        for severity in Severity
    }
    parts: list[doc.Words] = []
    if check.failures or not passing:
        parts.append(text("count-to-fix", count=check.failures))
        counts = {severity: count for severity, count in counts.items() if count}
    if counts:
        parts.append(describe_counts(counts))
    if known := count_findings(remark for remark in check.remarks if remark.known):
        parts.append(text("count-known", count=known))
    if check.stale:
        parts.append(text("count-stale", count=len(check.stale)))
    found = join_words(parts)
    if check.updated:
        baseline = Name(str(check.baseline))
        return text("found-the-baseline-is-written", found=found, file=baseline)
    return found


def relative_to_root(place: str) -> str:
    """Make the path in ``file:line`` relative to the checkout, as CI services expect.

    The checkout is that of `relative_to_checkout`.
    """
    file, line = Annotation("", "", "", place).file_and_line
    return relative_to_checkout(file) if line is None else f"{relative_to_checkout(file)}:{line}"


def make_check_annotations(
    check: RepositoryCheck, *, in_a_change: bool = False
) -> list[Annotation]:
    """Create annotations for a CI service from the remarks of a check.

    Remarks that make the check fail have the level "error", whatever their severity. Of remarks
    with a common cause, only the first is annotated. ``in_a_change`` annotates each difference in
    both files, for the page of a pull request, which shows changed lines only.
    """
    found = []
    for group in group_findings(check.remarks):
        for remark in group if group[0].cause is None else group[:1]:
            # Findings of other tools are annotated at all lines.
            both = in_a_change or remark.check not in ("crosscheck", "audit", "diff")
            places: list[str | None] = [
                location for location in (remark.place, remark.other_place) if location
            ]
            found += [
                _make_annotation(group, remark, location)
                for location in places[: 1 + both] or [None]
            ]
    about = describe_kind("stale")
    found += [
        Annotation(
            "notice",
            "stale baseline",
            str(entry),
            check.baseline,
            "check/stale",
            about,
            known=False,
            diagnostic=entry,
        )
        for entry in describe_stale_entries(check)
    ]
    return found


def describe_stale_entries(check: RepositoryCheck) -> list[Diagnostic]:
    """Return a message about each entry of the baseline that no longer occurs in the models."""
    return [
        diagnose("baseline-entry-stale", entry=str(entry), out=check.updated)
        for entry in check.stale
    ]


def _make_annotation(group: list[Remark], remark: Remark, place: str | None) -> Annotation:
    """Create the annotation of a remark at a place (``file:line``).

    The number of remarks in ``group`` is stated with a common cause.
    """
    both = (remark.place, remark.other_place)
    other_locations = [
        relative_to_root(location) for location in both if location and location != place
    ]
    message = " ".join([remark.message, *(f"[{location}]" for location in other_locations)])
    kind, joint = remark.kind, " of " if remark.check == "crosscheck" else ": "
    title = f"{kind}{joint}{remark.element}" if remark.element else kind
    about = RULES[kind].title if _is_audit_rule(remark) else describe_kind(kind)
    if remark.cause is not None:
        made = text("this-alone-makes-count-differences", count=len(group)).en
        message = f"{remark.cause}. {made} {message}"
        kind, title, about = "cause", f"cause of {len(group)} differences", describe_kind("cause")
    return Annotation(
        "error" if remark.fails else ANNOTATION_LEVELS[remark.severity],
        title,
        message,
        place,
        rule=f"{remark.check}/{kind}",
        about=about,
        known=remark.known,
        diagnostic=remark.cause or remark.diagnostic,
    )
