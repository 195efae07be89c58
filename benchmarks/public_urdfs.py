"""Read public URDFs, and count the causes of refusals: `python benchmarks/public_urdfs.py FOLDER`.

FOLDER contains clones of repositories and packages of robots, one folder each. Files with equal
content count once. Pinocchio and MuJoCo read each file as well, without meshes. `--json` writes the
outcome of each file. An earlier revision is measured with
`PYTHONPATH=OLD_CHECKOUT python -P benchmarks/public_urdfs.py FOLDER --json before.json`; then
`--before before.json --table` writes docs/data/public-urdfs.csv.
"""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import click
import mujoco
import pinocchio as pin
from tables import write_csv

from pupper_analysis.base.errors import ModelError
from pupper_analysis.models.loading import read_model
from pupper_analysis.models.mjcf import silence_mujoco

ROOT = Path(__file__).parents[1]

ENGINES = ("Pinocchio", "MuJoCo")
"""Engines that read each file as well."""

READ = "read"
"""Outcome of a file that is not refused."""


def list_files(folder: Path) -> Iterator[Path]:
    """Yield the path of each URDF with a content of its own."""
    seen = set()
    for path in sorted(folder.rglob("*")):
        if path.suffix.lower() == ".urdf" and path.is_file():
            digest = hashlib.sha256(path.read_bytes()).hexdigest()
            if digest not in seen:
                seen.add(digest)
                yield path


def describe_outcome(path: Path) -> str:
    """Return `READ`, or the code of the refusal and its text without the file name."""
    try:
        read_model(path)
    except ModelError as error:
        problem = error.cause
        return f"{problem.code}: {problem}"
    return READ


def list_refusing_engines(path: Path) -> list[str]:
    """Return the engines that refuse a URDF. Neither needs the meshes to read the file."""
    refusing = []
    try:
        pin.buildModelFromUrdf(str(path))
    except Exception:  # of Pinocchio's reader
        refusing.append("Pinocchio")
    try:
        with silence_mujoco():
            mujoco.MjSpec.from_file(str(path))
    except Exception:  # of MuJoCo's reader
        refusing.append("MuJoCo")
    return refusing


@click.command()
@click.argument("folder", type=click.Path(path_type=Path, exists=True))
@click.option("--json", "output", type=click.Path(path_type=Path), help="Outcome of each file.")
@click.option("--before", type=click.Path(path_type=Path, exists=True), help="An earlier --json.")
@click.option("--table", is_flag=True, help="Write the table in docs/data; needs --before.")
def main(folder: Path, output: Path | None, before: Path | None, *, table: bool) -> None:
    """Read all URDFs in a folder, and print the number of files for each outcome."""
    outcomes = {
        str(path.relative_to(folder)): describe_outcome(path) for path in list_files(folder)
    }
    if output is not None:
        output.write_text(json.dumps(outcomes, indent=1))
    engines = {name: list_refusing_engines(folder / name) for name in outcomes}
    now = Counter(outcome.partition(":")[0] for outcome in outcomes.values())
    earlier = {} if before is None else json.loads(before.read_text())
    then = Counter(outcome.partition(":")[0] for outcome in earlier.values())
    rows = []
    for code in sorted(now | then, key=lambda code: -max(now[code], then[code])):
        found = [pair for pair in outcomes.items() if pair[1].startswith(f"{code}:")]
        example = f"{Path(found[0][0]).name}: {found[0][1].partition(': ')[2]}" if found else ""
        refused = [
            sum(engine in engines[name] for name, outcome in outcomes.items()
                if outcome.partition(":")[0] == code)
            for engine in ENGINES
        ]  # fmt: skip
        rows.append((code, then[code], now[code], *refused, example))
        print(f"{then[code]:4d} {now[code]:4d} {refused[0]:4d} {refused[1]:4d} {code}")
    if table:
        columns = (
            "outcome",
            "files before",
            "files now",
            *(f"refused by {e}" for e in ENGINES),
            "example",
        )
        write_csv(ROOT / "docs" / "data" / "public-urdfs.csv", columns, rows)


if __name__ == "__main__":
    main()
