"""Checkers of robot files side by side: `python benchmarks/checkers.py --robots FOLDER`.

FOLDER is a site-packages folder with robots of others (see benchmarks/corpus.py). With `--others`
BIN, other checkers are tried, too; BIN is the `bin` of an environment that has them:

    python -m venv VENV && VENV/bin/pip install simcheck==0.2.0 pybullet \\
        urdf-validator==1.6.0 isaaclab-robot-doctor==0.1.0 truerig==0.1.1

Each slip is written into one leg of a quadruped, then into all four alike. The slips are this
project's own suite. One is noticed if a checker has an error or a warning that it has not of the
file as published, and found if such a one names a link or joint that was edited, or the joint or
link next to it that moves with it; a checker that runs out of time or ends in a traceback has not
noticed it. What is reported of the files as published is counted beside it. A robot's results are
kept in `--folder`; what is there is not run again, and with `--kept` nothing else is: a checker
that was not run on all files of a robot has no row of it.
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
from symmetric_slips import SLIPS, written
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

LIMIT = 120
"""Seconds of processor time that a checker may take for a file, in each of its processes."""

PATIENCE = 3600
"""Seconds after which one that waits, rather than computes, is ended: other processes may work."""

Said = Counter[str]
"""Errors and warnings: which check, of which element. Numbers in messages are left out."""

PACKAGE = "example-robot-data"


def ours(path: Path, share: Path, _: Path) -> Said:
    """This package's audit."""
    found = pa.audit_model(path, packages={PACKAGE: share}).findings
    return Counter(f"{one.rule} {one.element}" for one in found if one.severity != "info")


def _run(words: list[str], share: Path, within: Path) -> str:
    done = subprocess.run(
        words,
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, (LIMIT, LIMIT + 5)),
        check=False,
        cwd=within,
        env={"ROS_PACKAGE_PATH": str(share.parent), "PATH": "/usr/bin:/bin"},
    )
    if done.returncode < 0:
        raise RuntimeError(f"ended by signal {-done.returncode}")
    if "Traceback" in done.stderr:
        raise RuntimeError(done.stderr.strip().splitlines()[-1])
    return done.stdout


def simcheck(path: Path, share: Path, bins: Path) -> Said:
    """Its static checks, and those in MuJoCo and PyBullet."""
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
    return re.sub(r"[-+]?\d[\d.]*(e[-+]?\d+)?%?", "#", text)


def urdf_validator(path: Path, share: Path, bins: Path) -> Said:
    """Its critical issues and warnings, and joints whose motors do not hold them."""
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


def robot_doctor(path: Path, share: Path, bins: Path) -> Said:
    """Errors and warnings of Isaac Lab's doctor."""
    output = _run(
        [str(bins / "isaaclab-robot-doctor"), "check", "--json", str(path)], share, path.parent
    )
    return Counter(
        _without_numbers(json.dumps({key: one.get(key) for key in ("id", "message")}))
        for one in _findings(json.loads(output))
        if str(one.get("severity", one.get("level"))).lower() in ("error", "warn", "warning")
    )


def truerig(path: Path, share: Path, bins: Path) -> Said:
    """Errors and warnings of its validation."""
    output = _run(
        [str(bins / "truerig"), "validate", "--report", "json", str(path)], share, path.parent
    )
    return Counter(
        _without_numbers(json.dumps(one, sort_keys=True))
        for one in _findings(json.loads(output))
        if str(one.get("severity", one.get("level"))).lower() in ("error", "warn", "warning")
    )


def _findings(message: Any) -> list[dict[str, Any]]:
    """All objects in a report that state how bad they are."""
    if isinstance(message, list):
        return [one for each in message for one in _findings(each)]
    if not isinstance(message, dict):
        return []
    own = [message] if isinstance(message.get("severity", message.get("level")), str) else []
    return own + [one for each in message.values() for one in _findings(each)]


CHECKERS: dict[str, Callable[[Path, Path, Path], Said]] = {
    "pupper-analysis": ours,
    "simcheck 0.2.0": simcheck,
    "urdf-validator 1.6.0": urdf_validator,
    "isaaclab-robot-doctor 0.1.0": robot_doctor,
    "truerig 0.1.1": truerig,
}


def answer_of(checker: str, path: Path, kept: Path) -> Path:
    """Returns where it is kept what a checker says of a file."""
    return kept / f"{path.stem} {checker}.json"


def said(checker: str, path: Path, share: Path, bins: Path, kept: Path) -> Said | None:
    """What a checker says of a file; None if it does not come to an end."""
    file = answer_of(checker, path, kept)
    if not file.exists():
        try:
            found: Said | None = CHECKERS[checker](path, share, bins)
        except (subprocess.TimeoutExpired, RuntimeError, ValueError, OSError) as error:
            click.echo(f"{path.stem}: {checker}: {error!s:.100}", err=True)
            found = None
        file.write_text(json.dumps(found))
    content = json.loads(file.read_text())
    return None if content is None else Counter(content)


def edited(source: Path, slipped: Path) -> set[str]:
    """Returns the links and joints of which a number is another, with their joint or link."""
    before, after = (UrdfTree.of(path.read_text(encoding="utf-8")) for path in (source, slipped))
    found = set()
    for name, joint in after.joints.items():
        of = [
            (tree.joints[name].element, tree.links[joint.child].element) for tree in (before, after)
        ]
        if any(_stated(old) != _stated(new) for old, new in zip(*of, strict=True)):
            found |= {name, joint.child}
    return found


def _stated(element: etree._Element) -> list[tuple[str, list[str | float]]]:
    """Returns what an element and those in it state, with numbers for what is one."""
    return [
        (word, [float(each) if _NUMBER.fullmatch(each) else each for each in text.split()])
        for one in element.iter(etree.Element)
        for word, text in one.attrib.items()
    ]


_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?", re.IGNORECASE)


COLUMNS = (
    "robot", "checker", "found in one leg", "found in all four", "noticed in one leg",
    "noticed in all four", "of", "reported of the file as published", "not ended",
)  # fmt: skip


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
    """Counts what checkers find of the same slips in the same files."""
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
            if kept_alone and not all(answer_of(checker, file, kept).exists() for file in files):
                click.echo(f"{checker}: {name}: not run on all files", err=True)
                continue
            found, noticed, ended = Counter[int](), Counter[int](), Counter[bool]()
            tried = 0
            bins = (others or Path()).absolute()
            before = said(checker, sound, share, bins, kept)
            ended[before is not None] += 1
            for number in (1, 4):
                for slip in SLIPS:
                    path = written(source, slip, kept / f"{name} {slip} {number}.urdf", number)
                    places = edited(source, path)
                    if not places:  # limits of +-10 rad have no other sign
                        continue
                    tried += number == 4
                    after = said(checker, path, share, bins, kept)
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
