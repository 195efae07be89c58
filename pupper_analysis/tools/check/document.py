"""The document of a check: what of a repository's models fails, and how much is known."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.present import document as doc
from pupper_analysis.present.document import Name, Text, join_words, text, word
from pupper_analysis.present.documents.registry import build_document
from pupper_analysis.present.documents.sources import quote_line
from pupper_analysis.present.formats import Annotation, from_root
from pupper_analysis.robot.compare.differences import about_kind
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.audit.audit import RULES
from pupper_analysis.tools.audit.document import LEVELS, MARKS, element_text, rule_words
from pupper_analysis.tools.check.check import PairCheck, RepositoryCheck
from pupper_analysis.tools.check.remarks import Remark, RemarkState, count_findings


@build_document.register(RepositoryCheck)
def check_document(check: RepositoryCheck, _: Robot | None = None) -> doc.Document:
    """Returns what fails, with its place, and how much is known; see ``build``."""
    groups = _groups(check.remarks)
    blocks: list[doc.Block] = [_group(group) for group in groups if not _is_known(group)]
    if known := tuple(_known(group) for group in groups if _is_known(group)):
        title = text("count-known", count=len(known))
        blocks.append(doc.Lines(known, title=title, detail=True))
    if check.stale:
        blocks.append(doc.Lines(tuple(map(doc.tell, stale_entries(check))), "warn", text("stale")))
    blocks.append(_pairs(check.pairs))
    notes = tuple(
        text("name-note", name=doc.Name(pair.name), note=doc.tell(note))
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
        findings=(summarise_check(check),),
    )


def _groups(remarks: Iterable[Remark]) -> list[list[Remark]]:
    """Combines what one slip explains, and what has the same values, old and new."""
    groups: dict[tuple[str, ...], list[Remark]] = {}
    for remark in remarks:
        same = (remark.state, remark.kind, str(remark.values), str(remark.before))
        key = (remark.check, remark.file, *same) if remark.check == "audit" else remark.finding
        groups.setdefault(key, []).append(remark)
    return list(groups.values())


def _is_known(group: list[Remark]) -> bool:
    return group[0].state is RemarkState.KNOWN


def _known(group: list[Remark]) -> Text:
    place = group[0].place or group[0].file
    name = doc.Name(from_the_root(place) or place)
    return text("name-note", name=name, note=_message(group[0]))


def _message(first: Remark) -> doc.Words:
    message = doc.tell(first.diagnostic if first.cause is None else first.cause)
    if not _by_rule(first):
        return message
    return text("element-message", element=element_text(first.diagnostic), message=message)


def _by_rule(remark: Remark) -> bool:
    return remark.check == "audit" and remark.kind in RULES


def _group(group: list[Remark]) -> doc.Sides:
    first, *others = group
    notes: list[doc.Words] = []
    if first.cause is not None:
        notes.append(text("this-alone-makes-count-differences", count=len(group)))
        notes.append(doc.tell(first.diagnostic))
    elif others:
        names = join_words(doc.Name(remark.element) for remark in others)
        notes.append(text("likewise-on-count-more-names", count=len(others), names=names))
    if first.before is not None:
        notes.append(before_in_words(first))
    notes += map(doc.tell, first.consequences)
    tag = text(
        "severity-check-kind-state",
        severity=word(str(first.severity)),
        check=first.check,
        kind=first.kind if first.cause is None else "cause",
        state=word(str(first.state)),
    ).marked(MARKS[first.severity])
    places = [first.place or first.file, *([first.other_place] if first.other_place else [])]
    columns = tuple(
        doc.FilePlace(
            doc.Name(from_the_root(place) or place),
            doc.Name(quote_line(place, first.file)),
            from_the_root(place) or place,
        )
        for place in places
    )
    if _by_rule(first):
        notes.append(rule_words(first.kind, "todo"))
    sides = doc.Sides(_message(first), columns, tuple(notes), tag)
    return replace(sides, detail=not any(remark.fails for remark in group))


def _pairs(pairs: Iterable[PairCheck]) -> doc.Table:
    listed = list(pairs)
    agree: dict[bool | None, doc.Cell] = {
        True: text("they-agree"),
        False: text("they-differ"),
        None: doc.Name(""),
    }
    rows: list[tuple[doc.Cell, ...]] = [
        (
            doc.Name(pair.name),
            text("FAILED").marked("bad") if pair.failures else text("all-ok").marked("good"),
            doc.number_cell(pair.failures, "g"),
            doc.number_cell(pair.known, "g"),
            agree[pair.agree],
            doc.Name(", ".join(pair.files)),
        )
        for pair in listed
    ]
    off = tuple(
        text("name-rule-is-switched-off", name=doc.Name(pair.name),
             rule=doc.Name(rule), reason=doc.Name(reason))
        for pair in listed
        for rule, reason in pair.disabled.items()
    )  # fmt: skip
    return doc.Table(
        text("what-was-checked"),
        (
            doc.Column(text("pair"), left=True),
            doc.Column(text("verdict"), left=True),
            doc.Column(text("to-fix"), "1"),
            doc.Column(text("known"), "1"),
            doc.Column(text("the-files"), left=True),
            doc.Column(text("files"), left=True),
        ),
        tuple(rows),
        off,
    )


# The check of a repository's models, in a line and for machines.


def summarise_check(check: RepositoryCheck) -> Text:
    """Returns how much was found, in a line."""
    new = [r for r in check.remarks if r.state is not RemarkState.KNOWN]
    known = count_findings(r for r in check.remarks if r.state is RemarkState.KNOWN)
    minor = count_findings(r for r in new if not r.fails)
    parts = [text("count-to-fix", count=check.failures)]
    if minor:
        parts.append(text("count-of-less-severity-than", count=minor))
    if known:
        parts.append(text("count-known", count=known))
    if check.stale:
        parts.append(text("count-stale", count=len(check.stale)))
    found = join_words(parts)
    if check.updated:
        baseline = Name(str(check.baseline))
        return text("found-the-baseline-is-written", found=found, file=baseline)
    return found


def before_in_words(remark: Remark) -> Text:
    """Returns what the baseline has of a remark."""
    before = remark.before or {}
    known = before.get("values", before)
    if "code" in before:
        now = remark.values.get("values", {})
        known = {name: value for name, value in known.items() if now.get(name) != value}
    values = ", ".join(f"{name} {value}" for name, value in known.items())
    return text("the-baseline-has-values", values=values or before.get("code", ""))


def from_the_root(place: str | None) -> str:
    """Returns ``file:line`` with the file as CI services find it."""
    file, line = Annotation("", "", "", place).file_and_line
    if not file:
        return ""
    return from_root(file) if line is None else f"{from_root(file)}:{line}"


def check_remarks(check: RepositoryCheck, *, in_a_change: bool = False) -> list[Annotation]:
    """Returns the remarks as annotations; what fails is an error, whatever its severity.

    Args:
        check: The check.
        in_a_change: For the page of a change, where what is reported of the lines that it touches
            alone is seen: a difference is reported where its value is another one than the
            baseline's, or in both files.
    """
    found = [
        _annotation(group, place)
        for group in _findings(check.remarks)
        for place in (_places(group[0]) if in_a_change or _guarded(group[0]) else [group[0].place])
    ]
    found += [_of_baseline("stale", message, check) for message in stale_entries(check)]
    return found


def _guarded(remark: Remark) -> bool:
    """Whether a tool that guards found it: it is reported at each of its lines."""
    return remark.check not in ("crosscheck", "audit", "diff")


def _of_baseline(kind: str, message: Diagnostic, check: RepositoryCheck) -> Annotation:
    return Annotation(
        "notice",
        f"{kind} baseline",
        str(message),
        check.baseline,
        rule=f"check/{kind}",
        about=about_kind(kind),
        known=False,
        diagnostic=message,
    )


def stale_entries(check: RepositoryCheck) -> list[Diagnostic]:
    """Returns the entries of the baseline that do not occur any more."""
    return [
        diagnose("baseline-entry-stale", entry=str(entry), out=check.updated)
        for entry in check.stale
    ]


def _places(remark: Remark) -> list[str | None]:
    """Returns where a change may have brought a remark in."""
    places = [place for place in (remark.place, remark.other_place) if place]
    before, now = remark.before or {}, remark.values
    moved = [side for side in ("urdf", "mjcf") if before and before.get(side) != now.get(side)]
    if len(places) == 2 and len(moved) == 1:
        return [places[0] if moved == ["urdf"] else places[1]]
    return [*places] or [None]


def _findings(remarks: Iterable[Remark]) -> Iterable[list[Remark]]:
    """Combines what one slip explains."""
    groups: dict[tuple[str, ...], list[Remark]] = {}
    for remark in remarks:
        alone = () if remark.cause else (str(len(groups)),)
        groups.setdefault((*remark.finding, *alone), []).append(remark)
    return groups.values()


def _annotation(group: list[Remark], place: str | None) -> Annotation:
    remark = group[0]
    both = (remark.place, remark.other_place)
    others = [from_the_root(one) for one in both if one and one != place]
    other = f" [{others[0]}]" if others else ""
    before = f"; {before_in_words(remark).en}" if remark.before is not None else ""
    level = "error" if remark.fails else LEVELS[remark.severity]
    known = remark.state is RemarkState.KNOWN
    if remark.cause is not None:
        made = text("this-alone-makes-count-differences", count=len(group)).en
        return Annotation(
            level,
            f"cause of {len(group)} differences",
            f"{remark.cause}. {made} {remark.message}{other}{before}",
            place,
            rule=f"{remark.check}/cause",
            about=about_kind("cause"),
            known=known,
            diagnostic=remark.cause,
        )
    return Annotation(
        level,
        remark.subject,
        f"{remark.message}{other}{before}",
        place,
        rule=f"{remark.check}/{remark.kind}",
        about=remark.about,
        known=known,
        diagnostic=remark.diagnostic,
    )
