"""Check of all models listed in a repository's configuration against the baseline.

With a revision, changes since this revision are reported as well.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from importlib import import_module
from pathlib import Path
from typing import ClassVar

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.diagnostics import Diagnostic, Severity
from pupper_analysis.base.errors import OutputError, PupperAnalysisError
from pupper_analysis.base.files import check_writable
from pupper_analysis.base.progress import report_progress
from pupper_analysis.base.results import Result
from pupper_analysis.base.runs import ensure_run
from pupper_analysis.base.tools import find_tool_modules
from pupper_analysis.models.objects import require_path
from pupper_analysis.robot.compare.compare import compare_files
from pupper_analysis.tools.audit.audit import RULES, audit_model
from pupper_analysis.tools.check.config import (
    GuardConfig,
    GuardedPair,
    find_config,
    read_config,
)
from pupper_analysis.tools.check.remarks import (
    BASELINE_FILE,
    REFUSED_KIND,
    BaselineEntry,
    Remark,
    count_findings,
    list_audit_remarks,
    list_comparison_remarks,
    list_guard_remarks,
    make_error_remark,
    make_remark,
    mark_known_remarks,
    read_baseline,
    relative_path,
    write_baseline,
)
from pupper_analysis.tools.diff.compare import diff_models
from pupper_analysis.tools.diff.version import open_revision

SIMULATION_KIND = "simulation"
"""Value of ``Remark.kind`` for a remark on the effect, in a simulation, of all changes of a file
together."""


def list_history_remarks(
    file: Path, before: Callable[[Path], Path], pair: GuardedPair, folder: Path
) -> Iterator[Remark]:
    """Yield a remark (finding of `check`) for each change of a model file since an old version.

    Remarks on the effect of all changes together, found by simulation, follow. Nothing is yielded
    for a new file, for example. ``before`` returns the path of a file's old version; ``folder`` is
    that of the configuration.
    """
    old = before(file)
    if not old.is_file():
        return
    try:
        diff = diff_models(old, file, packages=pair.packages)
    except PupperAnalysisError:
        return
    relative = relative_path(file, folder)
    for change in diff.changes:
        effect_severity = _get_effect_severity(bool(change.effects))
        severity = min(
            _get_change_severity(change.consequences), effect_severity, key=lambda level: level.rank
        )
        yield make_remark(
            "diff",
            pair.name,
            change.kind,
            change.element,
            relative,
            change.diagnostic,
            severity,
            change.new_place or str(file),
            consequences=change.consequences,
        )
    for message in diff.combined:
        yield make_remark(
            "diff",
            pair.name,
            SIMULATION_KIND,
            "",
            relative,
            message,
            _get_change_severity((message,)),
            str(file),
        )


def _get_effect_severity(has_effect: bool) -> Severity:
    """Return the severity of a change: WARNING with an effect on the robot, otherwise NOTE."""
    return Severity.WARNING if has_effect else Severity.NOTE


def _get_change_severity(consequences: tuple[Diagnostic, ...]) -> Severity:
    """Return the severity of a change's effects: ERROR for a fall or a divergence.

    WARNING for other effects, NOTE without effects.
    """
    felt = [message for message in consequences if message.code != "simulation-unchanged"]
    if any(message.values.get("falls") or message.values.get("diverges") for message in felt):
        return Severity.ERROR
    return _get_effect_severity(bool(felt))


@dataclass(frozen=True, eq=False)
class PairCheck(Result):
    """Result of the check of one pair of models (URDF, MJCF or both).

    Attributes:
        name: Name of the pair.
        files: Files that were audited, and compared if both exist.
        agree: Whether the files agree within the tolerances; None for a single file, or if the
            files cannot be read or compared.
        failures: Number of failing findings in the pair and the files. Differences with the same
            cause or the same values count once.
        known: Number of findings in the baseline.
        notes: Assumptions, and ignored content.
        floating: Whether the MJCF, or else the URDF, has a free base, or a base with at least two
            limbs; None if the file cannot be read.
        packages: {ROS package: folder} of the configuration.
    """

    _key_fields: ClassVar[tuple[str, ...]] = ("agree", "name")

    name: str
    files: tuple[str, ...]
    agree: bool | None
    failures: int
    known: int
    notes: tuple[Diagnostic, ...]
    floating: bool | None = None
    packages: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class RepositoryCheck(Result):
    """Result of the check of a repository.

    Attributes:
        config: Path of the configuration.
        baseline: Path of the baseline; None if there is no file.
        pairs: Result for each pair.
        remarks: All remarks, failing remarks first, with the state in the baseline.
        failures: Number of failing findings: not in the baseline, and at least as severe as
            ``fail-on``. Differences with the same cause or the same values count once.
        stale: Entries of the baseline that no longer occur; removed if the baseline was rewritten.
            Empty if a file cannot be read or compared, or another check ends with an error.
        updated: Whether the baseline was rewritten.
        passed: Whether there are no failures.
    """

    _key_fields: ClassVar[tuple[str, ...]] = ("passed", "failures")

    config: str
    baseline: str | None
    pairs: tuple[PairCheck, ...]
    remarks: tuple[Remark, ...]
    failures: int
    stale: tuple[BaselineEntry, ...]
    updated: bool
    passed: bool


@check_arguments
@ensure_run()
def check_repository(
    config: str | Path | None = None, *, update_baseline: bool = False, since: str | None = None
) -> RepositoryCheck:
    """Compare and audit all models listed in a ``pupper-analysis.toml``.

    The baseline is the file of accepted findings: a finding that it contains with the same value
    passes. A file that cannot be read or compared is a failure; the other files are checked
    nevertheless.

    Args:
        config: Configuration; by default the file in the current folder or a folder above.
        update_baseline: Whether to write all findings to the baseline, except changes since a
            revision. Nothing is written if the check is incomplete, for example because a file
            cannot be read.
        since: Revision of git. Changes since this revision are reported with their effects.

    Returns:
        Result for each pair, and all remarks.

    Raises:
        ConfigurationError: If no configuration is found, or ``config`` is the text of a model, for
            example.
        ModelError: If the configuration or the baseline is invalid, or the files of the revision
            cannot be read, for example without git or repository.
        OutputError: If the baseline cannot be written, or this run of the command line also writes
            a file to be checked.
    """
    require_path("config", config)
    settings = read_config(Path(config) if config is not None else find_config())
    before = read_baseline(settings.baseline)
    if update_baseline:
        check_writable(settings.baseline, BASELINE_FILE)
    pairs, all_remarks = [], []
    for count, pair in enumerate(settings.pairs):
        report_progress("models", count, len(settings.pairs))
        done, remarks = _check_pair_files(pair, settings.path.parent)
        pairs.append(done)
        all_remarks += remarks
    if since is not None:
        all_remarks += _list_changes_since(settings, since, all_remarks)
    known, stale = mark_known_remarks(_drop_repeated(all_remarks), before.entries)
    # If a file cannot be read or compared, no entry is stale and no baseline is written.
    is_complete = not _has_refusal(known)
    if update_baseline and is_complete:
        known = tuple(replace(remark, known=remark.check != "diff") for remark in known)
        entries = [
            BaselineEntry(remark.identity, remark.values) for remark in known if remark.known
        ]
        write_baseline(settings.baseline, before, entries)
    ordered = sorted(
        (replace(remark, fails=_is_failure(remark, settings)) for remark in known),
        key=lambda remark: (not remark.fails, remark.severity.rank, not _is_cause(remark)),
    )
    failures = count_findings(remark for remark in ordered if remark.fails)
    return RepositoryCheck(
        config=str(settings.path),
        baseline=str(settings.baseline) if settings.baseline.exists() else None,
        pairs=tuple(_count_pair_remarks(pair, ordered) for pair in pairs),
        remarks=tuple(ordered),
        failures=failures,
        stale=stale if is_complete else (),
        updated=update_baseline and is_complete,
        passed=not failures,
    )


def _is_cause(remark: Remark) -> bool:
    """Return True for the finding of an audit rule that causes other findings or differences.

    For example, the limits of a joint are exchanged.
    """
    is_rule = remark.check == "audit" and remark.kind in RULES
    return is_rule and RULES[remark.kind].precedence == 0


def list_pair_remarks(pair: PairCheck, remarks: Iterable[Remark]) -> list[Remark]:
    """Return the remarks on a pair of files, or on one of its files."""
    return [
        remark
        for remark in remarks
        if remark.pair == pair.name or (not remark.pair and remark.file in pair.files)
    ]


def _count_pair_remarks(pair: PairCheck, remarks: Iterable[Remark]) -> PairCheck:
    """Return the result of a pair of files with the numbers of its failing and known findings."""
    pair_remarks = list_pair_remarks(pair, remarks)
    known = count_findings(remark for remark in pair_remarks if remark.known)
    return replace(
        pair,
        failures=count_findings(remark for remark in pair_remarks if remark.fails),
        known=known,
    )


def _list_changes_since(
    config: GuardConfig, since: str, found: Iterable[Remark]
) -> Iterator[Remark]:
    """Yield changes of the files since a git revision, as remarks.

    Changes that ``found``, the remarks on the present files, already report, and pairs with a
    refused file are left out.
    """
    messages, folder, done = list(found), config.path.parent, set()
    refused = {remark.pair for remark in messages if remark.kind == REFUSED_KIND}
    differences = {
        (remark.pair, remark.kind, remark.element)
        for remark in messages
        if remark.check == "crosscheck"
    }
    with open_revision(since, folder.absolute()) as before:
        for pair in config.pairs:
            for file in (pair.urdf, pair.mjcf):
                if file is None or pair.name in refused or file in done:
                    continue
                done.add(file)
                for remark in list_history_remarks(file, before, pair, folder):
                    if (pair.name, remark.kind, remark.element) not in differences:
                        yield remark


def _is_failure(remark: Remark, config: GuardConfig) -> bool:
    """Return True if a remark is not in the baseline and has at least the severity ``fail-on``."""
    return not remark.known and remark.severity.rank <= config.fail_on.rank


def _check_pair_files(pair: GuardedPair, folder: Path) -> tuple[PairCheck, list[Remark]]:
    """Audit and compare the files of a pair, and run the checks of other tools (module ``guard``).

    Returns:
        Result of the pair, without the numbers of findings; remarks on the findings.
    """
    files = [file for file in (pair.urdf, pair.mjcf) if file is not None]
    remarks: list[Remark] = []
    notes: tuple[Diagnostic, ...] = ()
    agree = floating = None
    for file in files:
        try:
            audit = audit_model(file, packages=pair.packages, disabled=tuple(pair.disabled))
        except OutputError:  # concerns an output file, not the model
            raise
        except PupperAnalysisError as error:
            remarks.append(make_error_remark(error, "audit", pair, file, folder))
        else:
            remarks += list_audit_remarks(audit, folder)
            floating = audit.floating
    # A file that cannot be read is reported once.
    if pair.urdf is not None and pair.mjcf is not None and not _has_refusal(remarks):
        try:
            comparison = compare_files(
                pair.urdf,
                pair.mjcf,
                names=pair.names,
                packages=pair.packages,
                feet=pair.feet,
                tolerances=pair.tolerances,
                strict_names=pair.strict,
            ).result
        except PupperAnalysisError as error:
            remarks.append(make_error_remark(error, "crosscheck", pair, pair.urdf, folder))
        else:
            agree, notes, floating = comparison.agree, comparison.notes, comparison.floating
            remarks = [*list_comparison_remarks(comparison, pair, folder), *remarks]
    packages = find_tool_modules("guard")
    for tool, sources in pair.guards.items() if not _has_refusal(remarks) else ():
        try:
            found = import_module(f"{packages[tool]}.guard").guard(files, sources, pair.names)
        except PupperAnalysisError as error:
            remarks.append(make_error_remark(error, tool, pair, files[0], folder))
        else:
            remarks += list_guard_remarks(tool, found, pair, folder)
    names = tuple(relative_path(file, folder) for file in files)
    packages = {name: str(path) for name, path in pair.packages.items()}
    return PairCheck(pair.name, names, agree, 0, 0, notes, floating, packages), remarks


def _has_refusal(remarks: Iterable[Remark]) -> bool:
    """Return True if a file cannot be read, or a comparison or another tool ended with an error."""
    return any(remark.kind == REFUSED_KIND for remark in remarks)


def _drop_repeated(remarks: Iterable[Remark]) -> Iterator[Remark]:
    """Yield remarks without duplicates, which occur if a file belongs to several pairs.

    Remarks of a comparison are never dropped.
    """
    seen = set()
    for remark in remarks:
        key = (remark.identity, str(remark.values), remark.place)
        if remark.check == "crosscheck" or key not in seen:
            yield remark
        seen.add(key)
