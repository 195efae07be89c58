"""What has changed in a repository's models since a revision, as remarks.

What an MJCF states of contacts, options, keyframes and motors no URDF can contradict, so that the
last version is the only witness.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from pupper_analysis.base.diagnostics import Diagnostic, Severity
from pupper_analysis.base.errors import PupperAnalysisError
from pupper_analysis.robot.compare.differences import about_kind
from pupper_analysis.tools.check.config import GuardedPair
from pupper_analysis.tools.check.remarks import Remark, relative_path, to_baseline
from pupper_analysis.tools.diff.compare import diff_models

TOGETHER = "simulation"
"""The kind of a remark on what all changes of a file do together."""


def of_history(
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

    def remark(
        kind: str, element: str, told: Diagnostic, does: tuple[Diagnostic, ...], bad: Severity,
        place: str,
    ) -> Remark:  # fmt: skip
        return Remark(
            "diff", pair.name, kind, element, named, to_baseline(told), bad, told, about_kind(kind),
            place or str(file), consequences=does,
        )  # fmt: skip

    for change in diff.changes:
        bad = max(_severity(change.consequences), _of_effects(bool(change.effects)), key=_badness)
        yield remark(
            change.kind, change.element, change.diagnostic, change.consequences, bad,
            change.new_place,
        )  # fmt: skip
    for told in diff.together:
        yield remark(TOGETHER, "", told, (), _severity((told,)), "")


def _badness(severity: Severity) -> int:
    return -severity.rank


def _of_effects(felt: bool) -> Severity:
    return Severity.WARNING if felt else Severity.NOTE


def _severity(consequences: tuple[Diagnostic, ...]) -> Severity:
    """Returns how bad a change is: who meant one tells why; a robot that falls nobody means."""
    felt = [told for told in consequences if told.code != "simulation-unchanged"]
    if any(told.values.get("falls") or told.values.get("diverges") for told in felt):
        return Severity.ERROR
    return _of_effects(bool(felt))
