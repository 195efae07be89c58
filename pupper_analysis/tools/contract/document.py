"""Document of a contract: each disagreement with both lines, and tables of all numbers.

Input is a ``Contract``. Outputs are blocks with the quoted lines of both sources and the effects,
tables of default poses, sources, joint numbers, settings and observations, and annotations for CI
services.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence, Set
from dataclasses import replace
from itertools import filterfalse, zip_longest
from pathlib import Path

from pupper_analysis.base.diagnostics import Diagnostic, Severity, format_pair
from pupper_analysis.base.frozen import FrozenDict
from pupper_analysis.present import document as doc
from pupper_analysis.present.document import (
    SEVERITY_MARKS,
    get_english,
    join_words,
    text,
    word,
)
from pupper_analysis.present.documents.registry import build_document
from pupper_analysis.present.documents.sources import cite_page, quote_line
from pupper_analysis.present.formats import ANNOTATION_LEVELS, Annotation
from pupper_analysis.pupper.named_robots import is_variant
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.contract.contract import (
    Contract,
    find_compared_numbers,
    is_uncompared,
)
from pupper_analysis.tools.contract.deployment import SOURCE_SUFFIXES
from pupper_analysis.tools.contract.facts import QUANTITIES, Fact, Role, find_quantity_kind
from pupper_analysis.tools.contract.findings import Disagreement, make_unread_finding
from pupper_analysis.tools.contract.reading import split_arguments

MAX_SHOWN_FINDINGS = 25
"""Largest number of disagreements whose lines are shown in the short view. Chosen, not tuned."""


@build_document.register(Contract)
def contract_document(contract: Contract, _: Robot | None = None) -> doc.Document:
    """Create the report of a contract: disagreements of the sources, and tables of all numbers.

    `build_document` calls this function for a `Contract`.
    """
    is_asymmetric = _has_asymmetries_only(contract)
    is_alone = len(contract.sources) == 1
    uncompared = is_uncompared(contract.facts, contract.sources)
    poseless = not any(fact.quantity == "default angle" for fact in contract.facts)
    evidence = text(f"contract-evidence-{contract.evidence}", poseless=poseless)
    unread = tuple(map(doc.diagnostic_text, contract.unread))
    falls = tuple(_describe_falls(contract))
    worst = tuple(_describe_worst_disagreement(contract))
    has_findings = bool(contract.findings)
    list_notes = tuple(_describe_unread_lists(contract))
    messages: tuple[doc.Words, ...]
    if uncompared and not unread:
        verdict = text("contract-not-compared")
        lists, two = _count_lists_not_read(contract), len(contract.sources) == 2
        counted = text(
            "contract-not-compared-count",
            two=two,
            findings=len(contract.findings) or None,
            lists=lists or None,
            both=two and not lists,
            several=not (two or lists),
        )
        messages = (counted, *list_notes, *_list_uncompared(contract))
        list_notes = ()
    elif is_asymmetric:
        verdict = text("contract-asymmetric")
        compared = () if is_alone else (_list_compared(contract),)
        messages = (_count_asymmetries(contract), *compared, *worst)
    elif (
        has_findings
        and not (uncompared and unread)
        and any(f.severity is not Severity.NOTE for f in contract.findings)
    ):
        verdict = text("contract-agree-but" if contract.passed else "contract-differ")
        messages = (_count_differences(contract), *worst, *unread)
    elif unread:
        verdict = text("contract-agree-but" if contract.passed else "contract-incomplete")
        messages = (*unread, _count_differences(contract), *worst)
    else:
        is_noted = has_findings or bool(falls)
        verdict = text("contract-agree-but" if is_noted else "contract-agree")
        count = _count_asymmetries if is_alone and not has_findings else _count_differences
        messages = (count(contract), *worst)
    is_brief = has_findings or bool(unread) or uncompared
    return doc.Document(
        text("contract"),
        _name_sources(contract),
        tuple(_list_blocks(contract)),
        passed=contract.passed,
        verdict=verdict,
        warned=contract.passed and (is_brief or bool(falls)),
        findings=(
            messages[0],
            *falls,
            *messages[1:],
            *list_notes,
            *(() if is_brief else (_list_compared(contract),)),
            *(() if is_brief or falls else (evidence,)),
        ),
        details=(evidence,) if is_brief or falls else (),
        next_step=select_next_step(contract),
        notes=tuple(map(doc.diagnostic_text, filterfalse(_is_list_note, contract.notes))),
    )


def _is_list_note(note: Diagnostic) -> bool:
    """Return True for the note on lists of joint numbers that were not read."""
    return note.code == "contract-lists-not-read"


def _describe_unread_lists(contract: Contract) -> Iterable[doc.Words]:
    """Yield the notes on lists that were not read; the short form names the file by its suffix."""
    for note in filter(_is_list_note, contract.notes):
        place = get_english(_shorten_source(contract, str(note.values["file"])))
        values = FrozenDict({**note.values, "place": place})
        yield doc.diagnostic_text(replace(note, values=values))


def _count_lists_not_read(contract: Contract) -> int:
    """Return the number of lists of joint numbers that were not read."""
    names = (note.values["keys"] for note in contract.notes if _is_list_note(note))
    return sum(len(keys) for keys in names if isinstance(keys, tuple))


def _name_sources(contract: Contract) -> doc.Words:
    """Return the file names of model and other source, or of the model and the number of others.

    The name of a variant stands for its files.
    """
    first = Path(contract.model).name
    other_paths = dict.fromkeys(
        source.path
        for source in contract.sources
        if source.path != contract.model
        and not (is_variant(contract.model) and source.role == Role.MODEL)
    )
    if not other_paths:
        return doc.Name(first)
    if len(other_paths) > 1:
        return text("contract-names-of-many", first=doc.Name(first), count=len(other_paths))
    second = Path(next(iter(other_paths))).name
    return text("contract-names-of-two", first=doc.Name(first), second=doc.Name(second))


def _describe_falls(contract: Contract) -> Iterable[doc.Words]:
    """Yield a text for each source in whose default pose the robot does not stay up."""
    for pose in contract.poses:
        if pose.stays is False:
            yield text("contract-pose-falls", source=doc.Name(pose.source.partition(":")[0]))


def _has_asymmetries_only(contract: Contract) -> bool:
    """Return True if all findings are left-right asymmetries, and everything was compared."""
    mirrored = [finding.probable_mistake == "mirror" for finding in contract.findings]
    return bool(mirrored) and all(mirrored) and not contract.unread


def _count_differences(contract: Contract) -> doc.Words:
    """Return the text of the number of differences, of compared numbers and of sources.

    A single source is compared with its mirror image: all of its numbers count.
    """
    is_single = len(contract.sources) == 1
    compared = contract.facts if is_single else find_compared_numbers(contract.facts)
    mirrored = sum(finding.probable_mistake == "mirror" for finding in contract.findings)
    return text(
        "contract-count",
        differing=sum(
            max(len(finding.joints), 1)
            for finding in contract.findings
            if finding.probable_mistake != "mirror"
        ),
        facts=len(compared),
        several=not is_single or None,
        sources=len(contract.sources),
        mirrored=mirrored or None,
    )


def _count_asymmetries(contract: Contract) -> doc.Words:
    """Return the text of the number of left-right differences in the sources that have them."""
    sources = {name for finding in contract.findings for name in finding.sources}
    sources = sources or {source.name for source in contract.sources}
    return text(
        "contract-asymmetric-count",
        findings=len(contract.findings),
        facts=sum(fact.source in sources for fact in contract.facts),
        source=doc.Name(next(iter(sources)) if len(sources) == 1 else ""),
        sources=len(sources) if len(sources) > 1 else None,
        shared=len(find_compared_numbers(contract.facts)) or None,
    )


def _list_uncompared(contract: Contract) -> Iterable[doc.Words]:
    """Yield the text of quantities that a single source states, if the sources share no number.

    The source with the fewest quantities is named.
    """
    quantities_by_source: dict[str, dict[str, None]] = {}
    for fact in contract.facts:
        quantities_by_source.setdefault(fact.source, {})[fact.quantity] = None
    if len(contract.sources) > 1:
        source, quantities = min(quantities_by_source.items(), key=lambda item: len(item[1]))
        yield text(
            "contract-uncompared",
            source=_shorten_source(contract, source),
            quantities=_join_quantities(quantities),
        )


def _shorten_source(contract: Contract, name: str) -> doc.Words:
    """Return ``the .py``, for example, if a single source has this suffix; otherwise the name."""
    suffixes = [Path(source.path).suffix for source in contract.sources]
    suffix = next(Path(source.path).suffix for source in contract.sources if source.name == name)
    is_unique = bool(suffix) and suffixes.count(suffix) == 1
    return text("contract-file-of-suffix", suffix=suffix) if is_unique else doc.Name(name)


def select_next_step(contract: Contract, typed: Sequence[str] = ()) -> doc.NextStep:
    """Return the command to suggest next.

    Possible commands: `crosscheck` of the models, `contract` with ``-v`` for lists that were not
    read, `walk` with the files of the deployment, `gains` with the gains of a source, `stand` and
    `hold`. `gains` is suggested, for example, if these gains do not hold the default pose.

    Args:
        contract: Contract.
        typed: Typed sources; ``FILE:NAME`` selects a configuration for `walk` as well.
    """
    models = [source.path for source in contract.sources if source.role == Role.MODEL]
    urdfs = [path for path in models if path.lower().endswith(".urdf")]
    others = {source.path for source in contract.sources if source.role != Role.MODEL}
    differ = any(_is_between_models(finding, others) for finding in contract.findings)
    if differ and is_variant(contract.model):
        return doc.NextStep("crosscheck", (contract.model,), robot_typed=False)
    differ = differ or _has_asymmetries_only(contract)  # masses are not compared
    if differ and urdfs and contract.model not in urdfs:
        return doc.NextStep("crosscheck", (urdfs[0], contract.model), robot_typed=False)
    policies = [source.path for source in contract.sources if source.role == Role.POLICY]
    files = _list_deployment_files(contract, typed)
    if contract.findings and contract.floating and len(policies) == 1 and files is not None:
        words = (contract.model, *files, "--policy", policies[0])
        return doc.NextStep("walk", words, robot_typed=False)
    is_uncompared_pair = is_uncompared(contract.facts, contract.sources)
    if is_uncompared_pair and not contract.unread and _count_lists_not_read(contract):
        return doc.NextStep("contract", (*typed, "-v"))
    gains = _format_shared_gains(contract)
    falls = any(pose.stays is False for pose in contract.poses)
    omitted = ("--map",)  # names that only other sources contain
    is_one_sided = contract.findings and is_uncompared_pair
    if gains and contract.floating and (falls or is_one_sided):
        model_and_gains = (contract.model, *gains)
        return doc.NextStep("gains", model_and_gains, robot_typed=False, omitted=omitted)
    command = "stand" if contract.floating else "hold"
    return doc.NextStep(command, (contract.model,), robot_typed=False, omitted=omitted)


def _list_deployment_files(contract: Contract, typed: Sequence[str]) -> tuple[str, ...] | None:
    """Return the words of the deployment and trainer files for `walk`; None if `walk` refuses one.

    `walk` reads YAML and Python, and one configuration of each role per file.
    """
    stating = [s for s in contract.sources if s.role not in (Role.MODEL, Role.POLICY)]
    roles = Counter((source.path, source.role) for source in stating)
    if any(
        count > 1 or Path(path).suffix not in SOURCE_SUFFIXES for (path, _), count in roles.items()
    ):
        return None
    requests, _ = split_arguments(typed)
    names = {str(request.path): request.name for request in requests if request.name}
    return tuple(
        f"{path}:{names[path]}" if path in names else path
        for path in dict.fromkeys(source.path for source in stating)
    )


def list_proposed_matches(contract: Contract) -> dict[str, str]:
    """Return {name in a source without a match: the only joint of the robot that it can name}."""
    matches: dict[str, str] = {}
    for message in contract.unread:
        joint, names = message.values.get("joint"), message.values.get("names")
        if message.code == "contract-names-unknown" and joint and isinstance(names, tuple):
            matches[str(names[0])] = str(joint)
    return matches


def _format_shared_gains(contract: Contract) -> tuple[str, ...]:
    """Return the options for the kp and kd of all joints; empty unless all joints share them.

    For example, ("--kp", "20", "--kd", "1.5") in SI units.
    """
    words: list[str] = []
    for quantity in ("kp", "kd"):
        facts = [fact for fact in contract.facts if fact.quantity == quantity and fact.joint]
        values = {fact.value for fact in facts}
        value = values.pop() if len(values) == 1 else None
        if value is None or {fact.joint for fact in facts} != set(contract.joints):
            return ()
        words += [f"--{quantity}", f"{value:.6g}"]
    return tuple(words)


def _is_between_models(finding: Disagreement, others: Set[str]) -> bool:
    """Return True if a finding compares a URDF with a model of another format.

    ``others`` are the paths of the sources that are no models.
    """
    files = {place.rpartition(":")[0] for place in finding.places}
    urdfs = {file for file in files if file.lower().endswith(".urdf")}
    return bool(urdfs) and urdfs < files and files.isdisjoint(others)


def _describe_worst_disagreement(contract: Contract) -> Iterable[doc.Words]:
    """Yield the text of the most severe disagreement between the sources, if any.

    The short form has the name of a variant in place of its file.
    """
    if not contract.findings:
        return
    finding = contract.findings[0]
    diagnostic = finding.diagnostic
    models = {source.name for source in contract.sources if source.role == Role.MODEL}
    if is_variant(contract.model) and len(models.intersection(finding.sources)) == 1:
        shown = {
            key: contract.model
            for key in ("short_first", "short_second")
            if diagnostic.values.get(key) in models
        }
        diagnostic = replace(diagnostic, values=FrozenDict({**diagnostic.values, **shown}))
    yield text("contract-first", finding=doc.diagnostic_text(diagnostic))


def _find_compared_quantities(contract: Contract) -> list[str]:
    """Return the quantities that at least two sources state for the same joint or setting."""
    return list(dict.fromkeys(quantity for quantity, _ in find_compared_numbers(contract.facts)))


def _list_compared(contract: Contract) -> doc.Words:
    """Return the text of the compared quantities; without any, of orders and observations."""
    quantities = _find_compared_quantities(contract)
    if not quantities:
        is_alone = len(contract.sources) == 1
        return text("contract-compared-none" if is_alone else "contract-compared-orders")
    return text("contract-compared", quantities=_join_quantities(quantities))


def _join_quantities(quantities: Iterable[str]) -> doc.Words:
    """Join the names of quantities; the short form has `_MAX_NAMED_QUANTITIES` names."""
    words = [word(quantity) for quantity in quantities]
    named = join_words(words[:_MAX_NAMED_QUANTITIES])
    more = max(len(words) - _MAX_NAMED_QUANTITIES, 0)
    return join_words(words).with_short_form(text("contract-quantities", named=named, more=more))


_MAX_NAMED_QUANTITIES = 5
"""Largest number of quantities that the short answer names. Chosen, not tuned."""


def _list_blocks(contract: Contract) -> Iterable[doc.Block]:
    """Yield the disagreements, then the tables of poses, sources, numbers and observations."""
    for number, finding in enumerate(contract.findings):
        yield _make_disagreement_block(finding, detail=number >= MAX_SHOWN_FINDINGS)
    if contract.poses:
        yield _tabulate_poses(contract)
    yield _tabulate_sources(contract)
    for quantity in QUANTITIES:
        stating = [fact for fact in contract.facts if fact.quantity == quantity and fact.joint]
        if stating:
            yield _tabulate_facts(
                contract, stating, word(quantity), find_quantity_kind(quantity).unit
            )
    settings = [fact for fact in contract.facts if not fact.joint]
    if settings:
        yield _tabulate_facts(contract, settings, text("contract-settings"))
    if any(source.observations for source in contract.sources):
        yield _tabulate_observations(contract)


def _make_disagreement_block(finding: Disagreement, *, detail: bool) -> doc.FileFinding:
    """Create the block of a disagreement, with the quoted lines of the sources.

    ``detail`` marks the block as a detail, which the short view in the terminal omits.
    """
    numbers = {place: number for number, place in enumerate(finding.places)}
    columns = tuple(
        doc.FilePlace(
            doc.Name(_shorten_place(place)),
            doc.Name(quote_line(place) or _format_value(finding, number)),
            place,
        )
        for place, number in numbers.items()
    )
    tag: doc.Words = word(str(finding.severity))
    if finding.probable_mistake:
        tag = text("severity-rule", severity=tag, rule=word(finding.probable_mistake))
    tag = tag.with_mark(SEVERITY_MARKS[finding.severity]) if isinstance(tag, doc.Text) else tag
    return doc.FileFinding(
        doc.diagnostic_text(finding.diagnostic),
        columns,
        tuple(map(doc.diagnostic_text, finding.effects)),
        tag,
        detail,
    )


def _format_value(finding: Disagreement, number: int) -> str:
    """Format the value of the first (0) or second (1) source of a disagreement, with its unit."""
    value, other = finding.values[number], finding.values[1 - number]
    if value is None:
        return "-"
    shown, _ = format_pair(value, value if other is None else other, ".6g")
    return f"{shown} {finding.unit}".rstrip()


def _make_column(key: str, unit: str = "", *, detail: bool = False) -> doc.Column:
    """Create a column with a header from the catalogue, left-aligned without a unit."""
    return doc.Column(text(key), unit, left=not unit, detail=detail)


def _tabulate_poses(contract: Contract) -> doc.Table:
    """Create the table of the stands in the default poses of the sources, a row per pose."""
    columns = (
        _make_column("contract-source"),
        _make_column("contract-height", "mm"),
        _make_column("contract-sag", "mm"),
        _make_column("contract-utilisation", "%"),
        _make_column("contract-stays"),
    )
    ends: dict[bool | None, doc.Cell] = {
        None: doc.Name("-"),
        True: text("contract-stays-up"),
        False: text("contract-falls").with_mark("bad"),
    }
    rows = tuple(
        (
            doc.Name(pose.source),
            doc.number_cell(pose.height, ".1f", scale=1e3),
            doc.number_cell(pose.sag, ".1f", scale=1e3),
            doc.number_cell(pose.utilisation, ".1f", scale=100.0),
            ends[pose.stays],
        )
        for pose in contract.poses
    )
    notes = tuple(
        text("contract-pose-note", source=pose.source, why=doc.diagnostic_text(pose.problem))
        for pose in contract.poses
        if pose.problem is not None
    )
    source = (cite_page("how-to/contract.md", "The default poses"),)
    return doc.Table(text("contract-poses"), columns, rows, notes, source)


def _tabulate_sources(contract: Contract) -> doc.Table:
    """Create the table of sources: role, number of values, and how the joint order is known."""
    columns = (
        _make_column("contract-source"),
        _make_column("contract-role"),
        _make_column("contract-numbers", "1"),
        _make_column("contract-order-how"),
    )
    count = Counter(fact.source for fact in contract.facts)
    rows = tuple(
        (
            doc.Name(source.name),
            word(source.role),
            doc.number_cell(count[source.name], ".0f"),
            text(f"contract-order-{source.order_source or 'none'}"),
        )
        for source in contract.sources
    )
    return doc.Table(text("contract-sources"), columns, rows, detail=True)


def _tabulate_facts(
    contract: Contract, facts: Sequence[Fact], title: doc.Words, unit: str = ""
) -> doc.Table:
    """Create the table of a quantity, or of all settings, with a column per source.

    ``facts`` are the stated numbers that the table contains, in ``unit``.
    """
    facts_by_cell = {(fact.joint or fact.quantity, fact.source): fact for fact in facts}
    names = [
        source.name for source in contract.sources if any(f.source == source.name for f in facts)
    ]
    shown_findings = [
        finding
        for finding in contract.findings
        if finding.kind in {fact.quantity for fact in facts}
    ]
    # If sources differ as well, a violated symmetry follows from one of the differences.
    shown_findings = [
        finding for finding in shown_findings if finding.probable_mistake != "mirror"
    ] or shown_findings
    marked_cells = {
        (row, finding.sources[1])
        for finding in shown_findings
        for row in finding.joints or [finding.kind]
    }
    rows: list[tuple[doc.Cell, ...]] = []
    for row in dict.fromkeys([*contract.joints, *(row for row, _ in facts_by_cell)]):
        row_facts = [facts_by_cell.get((row, name)) for name in names]
        if any(row_facts):
            marks = ["bad" if (row, name) in marked_cells else "" for name in names]
            head = doc.Name(row) if row in contract.joints else word(row)
            stated = [fact.value for fact in row_facts if fact and fact.value is not None]
            rows.append(
                (head, *(_make_cell(*cell, stated) for cell in zip(row_facts, marks, strict=True)))
            )
    columns = [_make_column("joint" if facts[0].joint else "contract-setting")]
    columns += [doc.Column(doc.Name(name), unit) for name in names]
    notes = (
        join_words(
            text("contract-places", source=name, places=doc.Name(_list_places(facts, name)))
            for name in names
        ),
        *_explain_origins(facts),
    )
    return doc.Table(title, tuple(columns), tuple(rows), notes, detail=True)


def _list_places(facts: Sequence[Fact], source: str) -> str:
    """List the places in which a source states numbers, as ``env.py:3-5, 9; robot.py:2``."""
    lines_by_file: dict[str, set[int]] = {}
    for place in dict.fromkeys(fact.place for fact in facts if fact.source == source):
        shown = _shorten_place(place)
        file, _, line = shown.rpartition(":")
        if line.isdecimal():
            lines_by_file.setdefault(file, set()).add(int(line))
        else:
            lines_by_file.setdefault(shown, set())
    return "; ".join(
        f"{file}:{_format_ranges(lines)}" if lines else file
        for file, lines in lines_by_file.items()
    )


def _shorten_place(place: str) -> str:
    """Return a place without folders: ``env.py:3``, or ``robot.usda:</Robot/hip>`` for a prim."""
    file, colon, element = place.partition(":<")
    return f"{Path(file).name}{colon}{element}"


def _format_ranges(lines: Iterable[int]) -> str:
    """Format line numbers as ranges: ``3-5, 9``."""
    ranges = list[list[int]]()
    for line in sorted(lines):
        if ranges and line == ranges[-1][1] + 1:
            ranges[-1][1] = line
        else:
            ranges.append([line, line])
    return ", ".join(f"{low}" if low == high else f"{low}-{high}" for low, high in ranges)


_ORIGIN_MARKS = {"default": "d", "derived": "c", "assumed": "a"}
"""{origin of a number: letter behind the number in a table}: a default value of a framework, a
value derived from other numbers, or an assumed value. A stated number has no letter."""


def _explain_origins(facts: Sequence[Fact]) -> Iterable[doc.Words]:
    """Yield the meaning of each letter behind the numbers of a table, with the frameworks."""
    for origin, letter in _ORIGIN_MARKS.items():
        bases = {fact.basis for fact in facts if fact.origin == origin}
        if bases:
            names = ", ".join(sorted(filter(None, bases)))
            yield text(f"contract-origin-{origin}", letter=letter, basis=doc.Name(names))


def _make_cell(fact: Fact | None, mark: str, stated: Sequence[float]) -> doc.Cell:
    """Create a table cell with the number of a source, the text of an expression, or nothing.

    ``stated`` are the numbers of all sources. The number is printed with enough digits to differ
    from another of these numbers.
    """
    if fact is None:
        return doc.Name("")
    if fact.value is None:
        return text("contract-no-constant", expression=fact.expression)
    other = next((value for value in stated if value != fact.value), fact.value)
    shown = format_pair(fact.value, other, ".5g")[0]
    letter = _ORIGIN_MARKS.get(fact.origin)
    return doc.Number(f"{shown} {letter}" if letter else shown, fact.value, mark)


def _tabulate_observations(contract: Contract) -> doc.Table:
    """Create the table of the observations of each source, in order."""
    terms_by_source = {
        source.name: source.observations for source in contract.sources if source.observations
    }
    named = [doc.Column(doc.Name(name), left=True) for name in terms_by_source]
    rows: list[tuple[doc.Cell, ...]] = []
    for number, row in enumerate(zip_longest(*terms_by_source.values(), fillvalue=""), start=1):
        rows.append((doc.number_cell(number, ".0f"), *map(doc.Name, row)))
    columns = (_make_column("ordinal", "1"), *named)
    return doc.Table(text("contract-observations"), columns, tuple(rows), detail=True)


# Annotations for machines.


def make_contract_annotations(contract: Contract) -> list[Annotation]:
    """Create annotations for a CI service: each disagreement at the line of each source.

    Sources and quantities that were not compared come first.
    """
    return [
        Annotation(
            ANNOTATION_LEVELS[finding.severity],
            f"{finding.probable_mistake or finding.kind}: "
            f"{', '.join(finding.joints[:3]) or finding.kind}",
            f"{finding.message} [{finding.places[1 - number]}]"
            if len(finding.places) > 1
            else finding.message,
            place,
            about=finding.kind,
            rule=f"contract/{finding.kind.replace(' ', '-')}",
            diagnostic=finding.diagnostic,
        )
        for finding in (*map(make_unread_finding, contract.unread), *contract.findings)
        for place, number in {place: n for n, place in enumerate(finding.places)}.items()
    ]
