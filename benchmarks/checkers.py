r"""Compare checkers of robot files: `python benchmarks/checkers.py --robots FOLDER`.

FOLDER is a site-packages folder with public robots (see benchmarks/corpus.py). With `--others` BIN,
other checkers are run, too; BIN is the `bin` folder of an environment that contains them:

    python -m venv VENV && VENV/bin/pip install simcheck==0.2.0 pybullet \\
        urdf-validator==1.6.0 isaaclab-robot-doctor==0.1.0 truerig==0.1.1

Each mistake of this project's test suite is written into one leg of a quadruped, and into all four
legs. A mistake is noticed if a checker reports an error or a warning that it does not report for
the published file. It is found if such a report names an edited link or joint, or the joint or link
that moves with it. A checker that exceeds the time limit or ends with a traceback has noticed
nothing. The number of reports about the published file is listed, too.

Results are stored in `--folder`, and stored results are not computed again. With `--kept`, only
stored results are used; a checker without results for all files of a robot gets no row for the
robot.
"""

from __future__ import annotations

import json
import re
import resource
import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
from corpus import DATA
from lxml import etree
from symmetric_slips import SLIPS, write_slip
from tables import write_csv

import pupper_analysis as pa

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from pupper_analysis.models.urdf_tree import UrdfTree

ROBOTS = {
    "a1": "a1_description/urdf/a1.urdf",
    "laikago": "laikago_description/urdf/laikago.urdf",
    "go1": "go1_description/urdf/go1.urdf",
    "solo12": "solo_description/robots/solo12.urdf",
    "anymal_b": "anymal_b_simple_description/robots/anymal.urdf",
}
"""{robot: URDF in the folder of the package example-robot-data}."""

MAX_CPU_TIME = 120
"""Maximum processor time [s] of each process of a checker, per file. Chosen, not tuned."""

MAX_ELAPSED_TIME = 3600
"""Elapsed time [s] after which a checker is stopped, for processes that wait. Chosen, not tuned."""

Said = Counter[str]
"""Errors and warnings: which check, of which element. Numbers in messages are left out."""

PACKAGE = "example-robot-data"
"""Name of the ROS package with the robots."""


def run_audit(path: Path, share: Path, _: Path) -> Said:
    """Return the errors and warnings of this package's ``audit``."""
    found = pa.audit_model(path, packages={PACKAGE: share}).findings
    return Counter(f"{one.rule} {one.element}" for one in found if one.severity != "note")


def _run(words: list[str], share: Path, within: Path) -> str:
    """Run a checker with limited time, and return its standard output.

    Raises:
        RuntimeError: If a signal or a traceback ends the process.
    """
    done = subprocess.run(
        words,
        capture_output=True,
        text=True,
        timeout=MAX_ELAPSED_TIME,
        preexec_fn=lambda: resource.setrlimit(
            resource.RLIMIT_CPU, (MAX_CPU_TIME, MAX_CPU_TIME + 5)
        ),
        check=False,
        cwd=within,
        env={"ROS_PACKAGE_PATH": str(share.parent), "PATH": "/usr/bin:/bin"},
    )
    if done.returncode < 0:
        raise RuntimeError(f"ended by signal {-done.returncode}")
    if "Traceback" in done.stderr:
        raise RuntimeError(done.stderr.strip().splitlines()[-1])
    return done.stdout


def run_simcheck(path: Path, share: Path, bins: Path) -> Said:
    """Return the errors and warnings of simcheck: static checks, MuJoCo and PyBullet."""
    words = [str(bins / "simcheck"), "check", str(path), "--robot", "--no-config", "--no-cache"]
    output = _run(
        [*words, "--package-path", f"{PACKAGE}={share}", "--json", "-"], share, path.parent
    )
    found = [one for result in json.loads(output)["results"] for one in result["findings"]]
    return Counter(
        f"{one['check']} {one['target']}"
        for one in found
        if one["severity"] in ("error", "warning")
    )


def _without_numbers(text: str) -> str:
    """Return a text with all numbers replaced by "#"."""
    return re.sub(r"[-+]?\d[\d.]*(e[-+]?\d+)?%?", "#", text)


def run_urdf_validator(path: Path, share: Path, bins: Path) -> Said:
    """Return critical issues, warnings and too weak motors that urdf-validator reports."""
    _run(
        [str(bins / "urdf_validate"), "--output-dir", str(path.parent), str(path)],
        share,
        path.parent,
    )
    content = json.loads((path.parent / f"{path.stem}_validation.json").read_text())
    weak = [
        f"effort {one['name']}" for one in content["statics"]["joints"] if one["status"] == "FAIL"
    ]
    found = [*content["critical_issues"], *content["warnings"], *weak]
    return Counter(_without_numbers(str(one)) for one in found)


def run_robot_doctor(path: Path, share: Path, bins: Path) -> Said:
    """Return the errors and warnings of isaaclab-robot-doctor."""
    output = _run(
        [str(bins / "isaaclab-robot-doctor"), "check", "--json", str(path)], share, path.parent
    )
    return Counter(
        _without_numbers(json.dumps({key: one.get(key) for key in ("id", "message")}))
        for one in _list_findings(json.loads(output))
        if str(one.get("severity", one.get("level"))).lower() in ("error", "warn", "warning")
    )


def run_truerig(path: Path, share: Path, bins: Path) -> Said:
    """Return the errors and warnings of truerig."""
    output = _run(
        [str(bins / "truerig"), "validate", "--report", "json", str(path)], share, path.parent
    )
    return Counter(
        _without_numbers(json.dumps(one, sort_keys=True))
        for one in _list_findings(json.loads(output))
        if str(one.get("severity", one.get("level"))).lower() in ("error", "warn", "warning")
    )


def _list_findings(message: Any) -> list[dict[str, Any]]:
    """Return all objects with a severity in a JSON report."""
    if isinstance(message, list):
        return [one for each in message for one in _list_findings(each)]
    if not isinstance(message, dict):
        return []
    own = [message] if isinstance(message.get("severity", message.get("level")), str) else []
    return own + [one for each in message.values() for one in _list_findings(each)]


CHECKERS: dict[str, Callable[[Path, Path, Path], Said]] = {
    "pupper-analysis": run_audit,
    "simcheck 0.2.0": run_simcheck,
    "urdf-validator 1.6.0": run_urdf_validator,
    "isaaclab-robot-doctor 0.1.0": run_robot_doctor,
    "truerig 0.1.1": run_truerig,
}
"""{checker: function that returns its errors and warnings}."""


def result_file(checker: str, path: Path, kept: Path) -> Path:
    """Return the file in which the result of a checker for a robot file is stored."""
    return kept / f"{path.stem} {checker}.json"


def run_checker(checker: str, path: Path, share: Path, bins: Path, kept: Path) -> Said | None:
    """Return the errors and warnings of a checker for a file; None if it did not finish.

    Args:
        checker: Key of `CHECKERS`.
        path: Robot file.
        share: Folder of the ROS package.
        bins: Folder with the programs of other checkers.
        kept: Folder of stored results.
    """
    file = result_file(checker, path, kept)
    if not file.exists():
        try:
            found: Said | None = CHECKERS[checker](path, share, bins)
        except (subprocess.TimeoutExpired, RuntimeError, ValueError, OSError) as error:
            click.echo(f"{path.stem}: {checker}: {error!s:.100}", err=True)
            found = None
        file.write_text(json.dumps(found))
    content = json.loads(file.read_text())
    return None if content is None else Counter(content)


def find_edited_elements(source: Path, slipped: Path) -> set[str]:
    """Return the links and joints with a changed number, each with the joint or link that moves
    with it.
    """
    before, after = (UrdfTree.of(path.read_text(encoding="utf-8")) for path in (source, slipped))
    found = set()
    for name, joint in after.joints.items():
        of = [
            (tree.joints[name].element, tree.links[joint.child].element) for tree in (before, after)
        ]
        if any(
            _read_attributes(old) != _read_attributes(new) for old, new in zip(*of, strict=True)
        ):
            found |= {name, joint.child}
    return found


def _read_attributes(element: etree._Element) -> list[tuple[str, list[str | float]]]:
    """Return the attributes of an element and its descendants, with numbers as floats."""
    return [
        (word, [float(each) if _NUMBER.fullmatch(each) else each for each in text.split()])
        for one in element.iter(etree.Element)
        for word, text in one.attrib.items()
    ]


_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?", re.IGNORECASE)
"""Pattern of a decimal number."""


COLUMNS = (
    "robot", "checker", "found in one leg", "found in all four", "noticed in one leg",
    "noticed in all four", "of", "reported of the file as published", "not ended",
)  # fmt: skip
"""Columns of the table."""


@click.command()
@click.option("--robots", type=click.Path(path_type=Path, exists=True), required=True)
@click.option("--others", type=click.Path(path_type=Path, exists=True), help="Their bin folder.")
@click.option("--only", multiple=True, type=click.Choice([*ROBOTS]), help="Repeatable.")
@click.option("--folder", type=click.Path(path_type=Path), default=Path("build/checkers"))
@click.option("--kept", "kept_alone", is_flag=True, help="Run nothing; count what is kept.")
@click.option("--csv", "to", type=click.Path(path_type=Path), help="Write the counts here.")
def main(
    robots: Path,
    others: Path | None,
    only: tuple[str, ...],
    folder: Path,
    kept_alone: bool,
    to: Path | None,
) -> None:
    """Count the mistakes that checkers find in the same files."""
    share = (robots / DATA).parent.resolve()
    package = folder.resolve() / PACKAGE  # some look for meshes above the file alone
    package.mkdir(parents=True, exist_ok=True)
    if not (package / "robots").exists():
        (package / "robots").symlink_to(share / "robots")
    rows = []
    for name in only or ROBOTS:
        kept = package / name
        kept.mkdir(parents=True, exist_ok=True)
        source = share / "robots" / ROBOTS[name]
        sound = kept / f"{name}.urdf"
        sound.write_bytes(source.read_bytes())
        for checker in CHECKERS if others else ("pupper-analysis",):
            files = [
                sound,
                *(kept / f"{name} {one} {legs}.urdf" for legs in (1, 4) for one in SLIPS),
            ]
            if kept_alone and not all(result_file(checker, file, kept).exists() for file in files):
                click.echo(f"{checker}: {name}: not run on all files", err=True)
                continue
            found, noticed, ended = Counter[int](), Counter[int](), Counter[bool]()
            tried = 0
            bins = (others or Path()).absolute()
            before = run_checker(checker, sound, share, bins, kept)
            ended[before is not None] += 1
            for number in (1, 4):
                for slip in SLIPS:
                    path = write_slip(source, slip, kept / f"{name} {slip} {number}.urdf", number)
                    places = find_edited_elements(source, path)
                    if not places:  # limits of +-10 rad have no other sign
                        continue
                    tried += number == 4
                    after = run_checker(checker, path, share, bins, kept)
                    ended[after is not None] += 1
                    if after is None or before is None:
                        continue
                    new = " ".join(after - before)
                    noticed[number] += bool(new)
                    found[number] += any(
                        re.search(rf"(?<!\w){re.escape(place)}(?!\w)", new) for place in places
                    )
            plain = "-" if before is None else before.total()
            each = (found[1], found[4], noticed[1], noticed[4], tried, plain, ended[False])
            rows.append((name, checker, *each))
            click.echo(" | ".join(map(str, rows[-1])), err=True)
    for row in [COLUMNS, *rows]:
        click.echo(" | ".join(map(str, row)))
    if to is not None:
        write_csv(to, COLUMNS, rows)


if __name__ == "__main__":
    main()
