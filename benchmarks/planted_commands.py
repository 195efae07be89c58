"""Plant one defect of each kind in public URDFs, and count which commands notice it.

    python benchmarks/planted_commands.py --robots FOLDER --seed 1 --csv FILE

The kinds are those of `planted.py`. One of two files has the defect: the published URDF, or the
MJCF that MuJoCo converts from it (`planted_mjcf.py`). `audit` gets this file, `crosscheck` and
`stand` get the pair. A command *notices* a defect if

- ``audit``: a finding that the published file does not have names the edited link or joint;
- ``crosscheck``: a difference, cause, note or error that the published pair does not have names it
  (for a defect of the whole file: there is such a text);
- ``stand``: the command refuses the pair or fails, and the published pair does not, or a new note
  or statement names it.
"""

from __future__ import annotations

import contextlib
import io
import random
import re
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import click
import planted_mjcf
from corpus import DATA, convert_with_mujoco
from lxml import etree
from planted import (
    KINDS,
    PACKAGE,
    ROBOTS,
    Site,
    audit_sound,
    copy_root,
    is_about,
    name_places,
    read_sizes,
    run_audit,
)
from tables import write_csv

import pupper_analysis as pa
from pupper_analysis.prepare.judge import judge_stand
from pupper_analysis.present.verdict import verdict_clauses

DEFAULT_ROBOTS = ("a1", "solo", "go2")
"""Robots of `ROBOTS` without the option ``--only``. MuJoCo must be able to convert them."""

DEFAULT_STANDS = ("a1",)
"""Robots that also stand, without the option ``--stand``: these runs take the longest."""


def names_place(texts: Iterable[str], places: set[str]) -> bool:
    """Return True if a text contains the name of one of the places."""
    return any(
        re.search(rf"(?<![\w-]){re.escape(place)}(?![\w-])", text)
        for text in texts
        for place in places
    )


def compare(urdf: Path, mjcf: Path, share: Path) -> list[str]:
    """Return the differences, causes and notes that `crosscheck` reports, or its error."""
    try:
        found = pa.compare_models(urdf, mjcf, packages={PACKAGE: share})
    except pa.PupperAnalysisError as error:
        return [str(error)]
    return [str(each) for each in (*found.differences, *found.causes, *found.notes)]


@dataclass(frozen=True)
class StandAnswer:
    """Answer of `stand`: whether the robot stands, and all texts."""

    passed: bool
    texts: frozenset[str]


def answer_stand(urdf: Path, mjcf: Path, share: Path) -> StandAnswer:
    """Return the verdict of the nominal stand of a pair with its statements and notes."""
    try:
        robot = pa.load_robot(urdf, mjcf, packages={PACKAGE: share})
        verdict = judge_stand(robot, pa.solve_stand(robot))
    except pa.PupperAnalysisError as error:
        return StandAnswer(passed=False, texts=frozenset({str(error)}))
    texts = (*map(str, robot.notes), *(str(one) for one in verdict_clauses(verdict)))
    return StandAnswer(verdict.passed, frozenset(texts))


COLUMNS = ("kind", "defect in", "planted", "audit", "crosscheck", "neither", "with stand", "stand",
           "none")  # fmt: skip
"""Columns of the table: the file with the defect, and numbers of planted defects, and of those that
the commands notice. ``with stand`` is the number that `stand` was given, ``none`` of these the
number that nothing notices."""


def write_defect(
    file: str, kind: str, pair: tuple[Path, Path], source: Path, share: Path, seed: str
) -> tuple[str, Path] | None:
    """Write a copy of one file of a pair with a defect.

    Args:
        file: ``"URDF"`` or ``"MJCF"``.
        kind: Kind of the defect.
        pair: Published URDF, and its MJCF; the copy is written beside the URDF.
        source: Published URDF in its own folder.
        share: Folder of the package with the meshes.
        seed: Seed.

    Returns:
        Name of the edited element, and path of the copy; None if the robot has no such element.
    """
    rng, sizes = random.Random(seed), read_sizes(source, share)
    if file == "URDF":
        root, path = copy_root(source), pair[0].with_name("robot.urdf")
        edited = KINDS[kind].plant(Site(root, rng, sizes))
    else:
        root, path = etree.parse(str(pair[1])).getroot(), pair[0].with_name("robot.xml")
        edited = planted_mjcf.KINDS[kind](planted_mjcf.Site(root, rng, sizes))
    if edited is None:
        return None
    path.write_bytes(etree.tostring(root, pretty_print=True))
    return edited, path


@click.command()
@click.option("--robots", type=click.Path(path_type=Path, exists=True), required=True)
@click.option("--seed", type=int, required=True)
@click.option("--only", multiple=True, type=click.Choice([*ROBOTS]), default=DEFAULT_ROBOTS)
@click.option("--stand", multiple=True, type=click.Choice([*ROBOTS]), default=DEFAULT_STANDS)
@click.option("--csv", "to", type=click.Path(path_type=Path), help="Write the counts here.")
def main(
    robots: Path, seed: int, only: tuple[str, ...], stand: tuple[str, ...], to: Path | None
) -> None:
    """Plant one defect of each kind in each file, and count the commands that notice it."""
    share = (robots / DATA).parent.resolve()
    cases = [(kind, file) for kind in KINDS for file in ("URDF", "MJCF")]
    counts = {case: dict.fromkeys(COLUMNS[2:], 0) for case in cases}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for robot in only:
            source = robots / ROBOTS[robot]
            sound = audit_sound(source, share, folder)
            with contextlib.redirect_stderr(io.StringIO()):
                mjcf = convert_with_mujoco(source.resolve(), share.parent, folder)
            pair = folder / "sound.urdf", mjcf
            audits = {"URDF": sound, "MJCF": run_audit(mjcf, share)}
            known = {
                file: {(finding.rule, finding.element) for finding in audit.findings}
                for file, audit in audits.items()
            }
            stated = frozenset(compare(*pair, share))
            stands = answer_stand(*pair, share) if robot in stand else None
            for kind, file in cases:
                written = write_defect(file, kind, pair, source, share, f"{seed} {robot} {kind}")
                if written is None:
                    continue
                edited, path = written
                files = (path, mjcf) if file == "URDF" else (pair[0], path)
                places = name_places(copy_root(source), edited) - {""}
                findings = [
                    finding
                    for finding in run_audit(path, share).findings
                    if (finding.rule, finding.element) not in known[file]
                ]
                texts = frozenset(compare(*files, share)) - stated
                noticed = {
                    "audit": bool(findings)
                    and (not edited or any(is_about(each, places) for each in findings)),
                    "crosscheck": names_place(texts, places) if edited else bool(texts),
                }
                row = counts[kind, file]
                row["planted"] += 1
                row["neither"] += not any(noticed.values())
                if stands is not None:
                    answer = answer_stand(*files, share)
                    fresh = answer.texts - stands.texts
                    fails = stands.passed and not answer.passed
                    noticed["stand"] = fails or names_place(fresh, places)
                    row["with stand"] += 1
                    row["none"] += not any(noticed.values())
                for command, found in noticed.items():
                    row[command] += found
                click.echo(f"{robot} | {kind} | {file} | {edited} | {noticed}", err=True)
    table: list[tuple[str | int, ...]] = [
        (*case, *row.values()) for case, row in counts.items() if row["planted"]
    ]
    for file in ("URDF", "MJCF"):
        rows = [row for case, row in counts.items() if case[1] == file]
        table.append(("all", file, *(sum(row[column] for row in rows) for column in COLUMNS[2:])))
    for line in table:
        click.echo(" | ".join(map(str, line)))
    if to is not None:
        write_csv(to, COLUMNS, table)


if __name__ == "__main__":
    main()
