"""Checks all models that a repository's configuration names, against its baseline.

And since a revision, what has changed: of contacts, options, keyframes and motors no URDF can
contradict an MJCF, so that the last version is the only witness.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.diagnostics import Diagnostic, Severity
from pupper_analysis.base.errors import OutputError, PupperAnalysisError
from pupper_analysis.base.files import check_writable
from pupper_analysis.base.results import Result
from pupper_analysis.base.runs import ensure_run
from pupper_analysis.base.tools import find_tool_modules
from pupper_analysis.robot.compare.compare import compare_files
from pupper_analysis.tools.audit.audit import audit_model
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
"""The kind of a remark on what all changes of a file do together."""


def list_history_remarks(
    file: Path, before: Callable[[Path], Path], pair: GuardedPair, folder: Path
) -> Iterator[Remark]:
    """Yields a remark per change of a file, and one on what they do together.

    None of a file that is new, or that could not be read before.

    Args:
        file: The file.
        before: Returns where its old version is.
        pair: Whose file it is.
        folder: The configuration's.
    """
    old = before(file)
    if not old.is_file():
        return
    try:
        diff = diff_models(old, file, packages=pair.packages)
    except PupperAnalysisError:
        return
    named = relative_path(file, folder)
    for change in diff.changes:
        felt = _of_effects(bool(change.effects))
        bad = min(_severity(change.consequences), felt, key=lambda one: one.rank)
        yield make_remark(
            "diff",
            pair.name,
            change.kind,
            change.element,
            named,
            change.diagnostic,
            bad,
            change.new_place or str(file),
            consequences=change.consequences,
        )
    for message in diff.combined:
        yield make_remark(
            "diff", pair.name, SIMULATION_KIND, "", named, message, _severity((message,)), str(file)
        )


def _of_effects(felt: bool) -> Severity:
    return Severity.WARNING if felt else Severity.NOTE


def _severity(consequences: tuple[Diagnostic, ...]) -> Severity:
    """Returns how bad a change is: who meant one tells why; a robot that falls nobody means."""
    felt = [message for message in consequences if message.code != "simulation-unchanged"]
    if any(message.values.get("falls") or message.values.get("diverges") for message in felt):
        return Severity.ERROR
    return _of_effects(bool(felt))


@dataclass(frozen=True, eq=False)
class PairCheck(Result):
    """What was checked of one pair.

    Attributes:
        name: The pair's name.
        files: The files that were audited for it, and compared if there are two.
        agree: Whether they agree within the tolerances; None of one file, or where one cannot be
            read.
        failures: How many remarks on it fail: differences, as one those that one slip explains
            or that have the same values, and findings in its files.
        known: How many the baseline knows.
        notes: What was assumed or left out, as messages.
    """

    name: str
    files: tuple[str, ...]
    agree: bool | None
    failures: int
    known: int
    notes: tuple[Diagnostic, ...]


@dataclass(frozen=True, eq=False)
class RepositoryCheck(Result):
    """What was found in a repository's models.

    Attributes:
        config: The file that says what is checked.
        baseline: The file of what is known; None if there is none.
        pairs: What was checked.
        remarks: What was found, what fails first, with what the baseline knows of it.
        failures: How many of them fail: not known, and as bad as the configuration's ``fail-on``;
            those that one slip explains, or that have the same values, are one.
        stale: Entries of the baseline that do not occur any more; they were taken out if it was
            written anew. None of them while a file cannot be read.
        updated: Whether the baseline was written anew.
        passed: Whether nothing fails.
    """

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
    """Compares and audits all models that a ``pupper-analysis.toml`` names.

    What its baseline has with the same value is known, and passes. A file that cannot be read
    fails, and the others are checked all the same.

    Args:
        config: The configuration; by default that of the current folder, or of one above it.
        update_baseline: Write what is found to the baseline, so that all of it is known; not while
            a file cannot be read.
        since: A revision of git: what has changed since then is reported, with what it does; it
            fails where the robot falls or MuJoCo diverges, and where ``fail-on`` says so. No
            baseline knows it.

    Raises:
        ConfigurationError: If there is no configuration.
        ModelError: If it, or the baseline, is not valid; it tells the line. If git does not have
            the revision.
        OutputError: If the baseline cannot be written.
    """
    settings = read_config(Path(config) if config is not None else find_config())
    before = read_baseline(settings.baseline)
    if update_baseline:
        check_writable(settings.baseline, BASELINE_FILE)
    pairs, found = [], []
    for pair in settings.pairs:
        done, remarks = _check_pair(pair, settings.path.parent)
        pairs.append(done)
        found += remarks
    if since is not None:
        found += _changed(settings, since, found)
    known, left = mark_known_remarks(_distinct(found), before.entries)
    # Of what cannot be read nobody knows what occurs in it: then nothing is stale, nor written.
    whole = not _refused(known)
    if update_baseline and whole:
        known = tuple(replace(remark, known=remark.check != "diff") for remark in known)
        taken = [BaselineEntry(remark.identity, remark.values) for remark in known if remark.known]
        write_baseline(settings.baseline, before, taken)
    ordered = sorted(
        (replace(remark, fails=_fails(remark, settings)) for remark in known),
        key=lambda remark: (not remark.fails, remark.severity.rank),
    )
    failures = count_findings(remark for remark in ordered if remark.fails)
    return RepositoryCheck(
        config=str(settings.path),
        baseline=str(settings.baseline) if settings.baseline.exists() else None,
        pairs=tuple(_counted(pair, ordered) for pair in pairs),
        remarks=tuple(ordered),
        failures=failures,
        stale=left if whole else (),
        updated=update_baseline and whole,
        passed=not failures,
    )


def _counted(pair: PairCheck, remarks: Iterable[Remark]) -> PairCheck:
    """Returns what was checked of a pair, with its results."""
    own = [
        remark
        for remark in remarks
        if remark.pair == pair.name or (not remark.pair and remark.file in pair.files)
    ]
    known = count_findings(remark for remark in own if remark.known)
    return replace(
        pair, failures=count_findings(remark for remark in own if remark.fails), known=known
    )


def _changed(config: GuardConfig, since: str, found: Iterable[Remark]) -> Iterator[Remark]:
    """Yields what has changed since a revision, but for what the comparison says itself."""
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


def _fails(remark: Remark, config: GuardConfig) -> bool:
    return not remark.known and remark.severity.rank <= config.fail_on.rank


def _check_pair(pair: GuardedPair, folder: Path) -> tuple[PairCheck, list[Remark]]:
    """Compares a pair's files, and audits each."""
    files = [file for file in (pair.urdf, pair.mjcf) if file is not None]
    remarks: list[Remark] = []
    notes: tuple[Diagnostic, ...] = ()
    agree = None
    for file in files:
        try:
            audit = audit_model(file, packages=pair.packages, disabled=tuple(pair.disabled))
        except OutputError:  # it is to be written, too: nothing of a model
            raise
        except PupperAnalysisError as error:
            remarks.append(make_error_remark(error, "audit", pair, file, folder))
        else:
            remarks += list_audit_remarks(audit, folder)
    # What cannot be read by itself is not refused once more.
    if pair.urdf is not None and pair.mjcf is not None and not _refused(remarks):
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
            agree, notes = comparison.agree, comparison.notes
            remarks = [*list_comparison_remarks(comparison, pair, folder), *remarks]
    packages = find_tool_modules("guard")
    for tool, sources in pair.guards.items() if not _refused(remarks) else ():
        try:
            found = import_module(f"{packages[tool]}.guard").guard(files, sources, pair.names)
        except PupperAnalysisError as error:
            remarks.append(make_error_remark(error, tool, pair, files[0], folder))
        else:
            remarks += list_guard_remarks(tool, found, pair, folder)
    names = tuple(relative_path(file, folder) for file in files)
    return PairCheck(pair.name, names, agree, 0, 0, notes), remarks


def _refused(remarks: Iterable[Remark]) -> bool:
    return any(remark.kind == REFUSED_KIND for remark in remarks)


def _distinct(remarks: Iterable[Remark]) -> Iterator[Remark]:
    """Leaves out findings in files that several pairs have, and that were audited before."""
    seen = set()
    for remark in remarks:
        key = (remark.identity, str(remark.values), remark.place)
        if remark.check == "crosscheck" or key not in seen:
            yield remark
        seen.add(key)
