"""Audit public robots, and draw findings to be judged by eye.

    python benchmarks/public_findings.py FOLDER --seed N

FOLDER contains clones of repositories and packages of robots, one folder each. URDFs and MJCFs are
selected at random, one of each repository in turn, so that large collections do not dominate.
Files with equal content count once. The number of findings per rule is printed, and written with
`--rules FILE`. `--draw FILE` writes findings drawn at random from the errors and warnings, with
columns for the judgement. Missing meshes are counted, but not drawn: whether a mesh is missing
depends on the clone. `--outcomes FILE` keeps all findings as JSON, from which `--from FILE` draws
again.
"""

from __future__ import annotations

import hashlib
import json
import random
import signal
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import Any

import click
from tables import write_csv

import pupper_analysis as pa

FORMATS = {"urdf": 560, "mjcf": 120}
"""{format: number of files to audit, unless an option states another}."""

NOT_DRAWN = ("mesh-missing", "mesh-unreadable")
"""Rules whose findings depend on the clone."""

MAX_SECONDS = 60
"""Time after which the audit of a file is stopped [s]. Chosen, to bound the time of the run."""


def list_sources(folder: Path) -> Iterator[Path]:
    """Yield the folders of the repositories: subfolders of FOLDER; of ``pip``, its subfolders."""
    for path in sorted(folder.iterdir()):
        if path.name == "pip":
            yield from sorted(path.iterdir())
        elif path.is_dir():
            yield path


def is_robot(path: Path, format: str) -> bool:
    """Return True for URDFs, and for MJCFs that contain bodies and are no included fragments."""
    if format == "urdf":
        return path.suffix.lower() == ".urdf"
    if path.suffix.lower() != ".xml":
        return False
    text = path.read_bytes()
    return b"<mujoco" in text and b"<worldbody" in text and b"<joint" in text


def choose_files(folder: Path, format: str, count: int, seed: int) -> list[tuple[Path, Path]]:
    """Return (repository, file) of ``count`` random files, one of each repository in turn."""
    dice, seen, piles = random.Random(f"{format} {seed}"), set(), []
    for source in list_sources(folder):
        pile = []
        for path in sorted(source.rglob("*")):
            if not path.is_file() or not is_robot(path, format):
                continue
            digest = hashlib.sha256(path.read_bytes()).hexdigest()
            if digest not in seen:
                seen.add(digest)
                pile.append((source, path))
        dice.shuffle(pile)
        piles.append(pile)
    chosen = []
    while len(chosen) < count and any(piles):
        for pile in piles:
            if pile and len(chosen) < count:
                chosen.append(pile.pop())
    return chosen


def list_packages(path: Path, top: Path) -> dict[str, Path]:
    """Return {name: folder} of all folders above a file and of all ROS packages of the clone."""
    packages = {file.parent.name: file.parent for file in top.rglob("package.xml")}
    return packages | {folder.name: folder for folder in path.parents if folder != top.parent}


def stop_audit(_signum: int, _frame: FrameType | None) -> None:
    """Raise TimeoutError when the time of a file is over."""
    raise TimeoutError


def audit_file(path: Path, top: Path) -> list[dict[str, Any]] | str:
    """Return the findings of a file, or the first words of its refusal."""
    signal.alarm(MAX_SECONDS)
    try:
        audit = pa.audit_model(path, packages=list_packages(path, top))
    except (pa.PupperAnalysisError, TimeoutError) as error:
        return f"{type(error).__name__}: {error!s:.200}"
    finally:
        signal.alarm(0)
    return [
        {
            "line": finding.line,
            "rule": finding.rule,
            "severity": str(finding.severity),
            "element": finding.element,
            "message": finding.message,
        }
        for finding in audit.findings
    ]


@click.command()
@click.argument("folder", type=click.Path(path_type=Path, exists=True))
@click.option("--seed", type=int, required=True, help="Of the choice of files and findings.")
@click.option("--urdfs", type=int, default=FORMATS["urdf"], show_default=True)
@click.option("--mjcfs", type=int, default=FORMATS["mjcf"], show_default=True)
@click.option("--count", type=int, default=40, show_default=True, help="Findings to draw.")
@click.option("--outcomes", type=click.Path(path_type=Path), help="Write all findings as JSON.")
@click.option("--from", "earlier", type=click.Path(path_type=Path, exists=True))
@click.option("--draw", "drawn", type=click.Path(path_type=Path), help="Write drawn findings.")
@click.option("--rules", type=click.Path(path_type=Path), help="Write the findings per rule.")
def main(
    folder: Path,
    seed: int,
    urdfs: int,
    mjcfs: int,
    count: int,
    outcomes: Path | None,
    earlier: Path | None,
    drawn: Path | None,
    rules: Path | None,
) -> None:
    """Audit random public files, count findings per rule, and draw some to be judged."""
    if earlier is not None:
        results = json.loads(earlier.read_text())
    else:
        signal.signal(signal.SIGALRM, stop_audit)
        results = {}
        for format, number in (("urdf", urdfs), ("mjcf", mjcfs)):
            for top, path in choose_files(folder, format, number, seed):
                name = str(path.relative_to(folder)).removeprefix("pip/")
                results[name] = audit_file(path, top)
                if outcomes is not None:
                    outcomes.write_text(json.dumps(results, indent=1))
    findings = [
        (name, finding)
        for name, found in results.items()
        if not isinstance(found, str)
        for finding in found
    ]
    counts: Counter[tuple[str, str]] = Counter()
    files: dict[tuple[str, str], set[str]] = {}
    for name, finding in findings:
        key = (finding["rule"], finding["severity"])
        counts[key] += 1
        files.setdefault(key, set()).add(name)
    rows = [(*key, number, len(files[key])) for key, number in counts.most_common()]
    for row in rows:
        click.echo("{:32s} {:8s} {:5d} {:4d}".format(*row))
    refused = sum(isinstance(found, str) for found in results.values())
    click.echo(f"{len(results)} files, {refused} refused, {len(findings)} findings")
    if rules is not None:
        write_csv(rules, ("rule", "severity", "findings", "files"), rows)
    if drawn is not None:
        pool = [
            (name, finding)
            for name, finding in findings
            if finding["severity"] != "note" and finding["rule"] not in NOT_DRAWN
        ]
        chosen = random.Random(seed).sample(pool, min(count, len(pool)))
        write_csv(
            drawn,
            ("file and line", "rule", "element", "finding", "judged", "reason", "seed"),
            (
                (f"{name}:{f['line']}", f["rule"], f["element"], f["message"], "", "", seed)
                for name, f in chosen
            ),
        )


if __name__ == "__main__":
    main()
