"""Plant one defect of each kind in public URDFs, and count which commands notice it.

    python benchmarks/planted_commands.py --robots FOLDER --seed 1 --csv FILE

The kinds are those of `planted.py`. `crosscheck` compares the URDF with the defect with the MJCF
that MuJoCo converts from the published URDF, as if only one of two files had the defect. `stand`
gets the URDF alone. A command *notices* a defect if

- ``audit``: a finding that the published file does not have names the edited link or joint;
- ``crosscheck``: a difference, cause, note or error that the published pair does not have names it
  (for a defect of the whole file: there is such a text);
- ``stand``: the command refuses the file or fails, and the published file does not, or a new note
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


def answer_stand(urdf: Path, share: Path) -> StandAnswer:
    """Return the verdict of the nominal stand of a URDF with its statements and notes."""
    try:
        robot = pa.load_robot(urdf, packages={PACKAGE: share})
        verdict = judge_stand(robot, pa.solve_stand(robot))
    except pa.PupperAnalysisError as error:
        return StandAnswer(passed=False, texts=frozenset({str(error)}))
    texts = (*map(str, robot.notes), *(str(one) for one in verdict_clauses(verdict)))
    return StandAnswer(verdict.passed, frozenset(texts))


COLUMNS = ("kind", "planted", "audit", "crosscheck", "neither", "with stand", "stand", "none")
"""Columns of the table: numbers of planted defects, and of those that the commands notice. ``with
stand`` is the number that `stand` was given, ``none`` of these the number that nothing notices."""


@click.command()
@click.option("--robots", type=click.Path(path_type=Path, exists=True), required=True)
@click.option("--seed", type=int, required=True)
@click.option("--only", multiple=True, type=click.Choice([*ROBOTS]), default=DEFAULT_ROBOTS)
@click.option("--stand", multiple=True, type=click.Choice([*ROBOTS]), default=DEFAULT_STANDS)
@click.option("--csv", "to", type=click.Path(path_type=Path), help="Write the counts here.")
def main(
    robots: Path, seed: int, only: tuple[str, ...], stand: tuple[str, ...], to: Path | None
) -> None:
    """Plant one defect of each kind in each robot, and count the commands that notice it."""
    share = (robots / DATA).parent.resolve()
    counts = {kind: dict.fromkeys(COLUMNS[1:], 0) for kind in KINDS}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for robot in only:
            source = robots / ROBOTS[robot]
            sound = audit_sound(source, share, folder)
            known = {(finding.rule, finding.element) for finding in sound.findings}
            with contextlib.redirect_stderr(io.StringIO()):
                mjcf = convert_with_mujoco(source.resolve(), share.parent, folder)
            pair = frozenset(compare(folder / "sound.urdf", mjcf, share))
            stands = answer_stand(folder / "sound.urdf", share) if robot in stand else None
            for kind, plant in KINDS.items():
                root = copy_root(source)
                rng = random.Random(f"{seed} {robot} {kind}")
                edited = plant.plant(Site(root, rng, read_sizes(source, share)))
                if edited is None:
                    continue
                path = folder / "robot.urdf"
                path.write_bytes(etree.tostring(root, pretty_print=True))
                places = name_places(copy_root(source), edited) - {""}
                findings = [
                    finding
                    for finding in run_audit(path, share).findings
                    if (finding.rule, finding.element) not in known
                ]
                texts = frozenset(compare(path, mjcf, share)) - pair
                noticed = {
                    "audit": any(not edited or is_about(each, places) for each in findings),
                    "crosscheck": names_place(texts, places) if edited else bool(texts),
                }
                row = counts[kind]
                row["planted"] += 1
                row["neither"] += not any(noticed.values())
                if stands is not None:
                    answer = answer_stand(path, share)
                    fresh = answer.texts - stands.texts
                    fails = stands.passed and not answer.passed
                    noticed["stand"] = fails or names_place(fresh, places)
                    row["with stand"] += 1
                    row["none"] += not any(noticed.values())
                for command, found in noticed.items():
                    row[command] += found
                click.echo(f"{robot} | {kind} | {edited} | {noticed}", err=True)
    table: list[tuple[str | int, ...]] = [
        (kind, *row.values()) for kind, row in counts.items() if row["planted"]
    ]
    table.append(("all", *(sum(row[column] for row in counts.values()) for column in COLUMNS[1:])))
    for line in table:
        click.echo(" | ".join(map(str, line)))
    if to is not None:
        write_csv(to, COLUMNS, table)


if __name__ == "__main__":
    main()
