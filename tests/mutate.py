"""Slips made on purpose: do the tests notice them? Mutants by Cosmic Ray, a sample per room.

Each mutant changes one operator, number or condition of one module. The quick tests that run the
changed line, as coverage has recorded, run until one fails, the module's own first; then the slow
ones of the module's own test. A mutant that none notices has survived: a test is missing, or the
code does not need what was changed. ::

    python tests/mutate.py statics robot --sample 40    # make mutate ROOM="statics robot" SAMPLE=40

The checkout is not touched: all of it happens in a copy, build/mutants (or in the folder that
``MUTANTS`` names). Which rooms, and which
kinds of slips, says `pyproject.toml`. What survived and changes nothing has its reason in
`docs/data/mutants-equivalent.csv`; `--csv` writes the scores of all rooms beside it.
"""

from __future__ import annotations

import argparse
import ast
import compileall
import csv
import datetime
import json
import os
import py_compile
import random
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
BUILD = Path(os.environ.get("MUTANTS", ROOT / "build")).resolve()
FOLDER = BUILD / "mutants"
"""The copy in which all happens."""

EQUIVALENT = ROOT / "docs/data/mutants-equivalent.csv"
PACKAGE = "pupper_analysis"
SETTINGS = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["mutate"]

SECONDS = 10.0
"""Of the tests of a mutant, as long as they take without it; the quickest are taken."""

ENDLESS = 10
"""Times as long with the mutant: it does not end, and has been noticed."""

STARTING = 20.0
"""Seconds more: pytest starts, and imports the engines."""

SLOW = "slow and not longest"
"""Which tests of the module's own come last."""

NONE_IS_FINE = '; code=$?; [ "$code" -ne 5 ] || code=0; exit "$code"'
"""pytest ends with 5 where no test is marked so."""

WAITING = 300.0
"""Of waiting: others compute, too, and some mutants wait for ever."""


# ------------------------------------------------------------------- the copy, and what tests run


def copied() -> None:
    """Copies what git knows of the checkout, and what is new in it; compiles it once.

    What is compiled is taken by its content, not by its time: a mutant that is as long as what it
    replaces, within the same second, is another module.
    """
    shutil.rmtree(FOLDER, ignore_errors=True)
    listing = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(listing, cwd=ROOT, capture_output=True, check=True, text=True).stdout
    for name in filter(None, listed.split("\0")):
        if (ROOT / name).is_file():
            (FOLDER / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, FOLDER / name)
    by_content = py_compile.PycInvalidationMode.CHECKED_HASH
    compileall.compile_dir(FOLDER / PACKAGE, quiet=1, invalidation_mode=by_content)


def pytest(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "pytest", "-n", "0", "--dist", "no", "-q", *arguments]


def record(tests: Sequence[str], mark: str) -> None:
    """Runs tests in the copy, and records which lines each runs and how long it takes."""
    settings = FOLDER / "build-coverage.ini"
    settings.write_text(f"[run]\nsource = {PACKAGE}\n")
    options = [f"--cov={PACKAGE}", f"--cov-config={settings}", "--cov-context=test"]
    options += ["--cov-report=", "--junitxml=build-tests.xml", "-o", "junit_family=xunit1"]
    subprocess.run(
        pytest("-m", mark, *options, *tests), cwd=FOLDER, stdout=subprocess.DEVNULL, check=False
    )


@cache
def seconds() -> Mapping[str, float]:
    """Returns how long each test takes that passes without any mutant (s)."""
    found = {}
    for case in ET.parse(FOLDER / "build-tests.xml").getroot().iter("testcase"):
        if not {part.tag for part in case} & {"failure", "error", "skipped"}:
            file = case.get("file") or f"{str(case.get('classname')).replace('.', '/')}.py"
            found[f"{file}::{case.get('name')}"] = float(case.get("time", "0"))
    return found


@cache
def lines_of(path: str) -> Mapping[int, frozenset[str]]:
    """Returns {line of a module: the tests that run it}."""
    from coverage import CoverageData

    data = CoverageData(str(FOLDER / ".coverage"))
    data.read()
    return {
        line: frozenset(name.rpartition("|")[0] for name in names) & seconds().keys()
        for line, names in data.contexts_by_lineno(str(FOLDER / path)).items()
    }


def judges(path: str, first: int, last: int) -> list[str]:
    """Returns the tests that run some lines of a module, those first that tell soonest.

    What is run as the module is imported is judged by all that run anything of it.
    """
    lines = lines_of(path)
    own = [lines[line] for line in range(first, last + 1) if line in lines]
    if not any(own):
        own = list(lines.values()) if own or not _in_function(path, first) else []
    name = f"/{test_name(path)}.py::"
    near = sorted(frozenset().union(*own), key=lambda test: (name not in test, seconds()[test]))
    taken, spent = [], 0.0
    for test in near:
        spent += seconds()[test]
        if taken and spent > SECONDS:
            break
        taken.append(test)
    return taken


def statement(path: str, line: int) -> tuple[int, int]:
    """Returns the first and the last line of the least statement about a line, without its body."""
    spans = [(line, line)]
    for node in ast.walk(_tree(path)):
        if isinstance(node, ast.stmt) and node.lineno <= line <= (node.end_lineno or 0):
            body = getattr(node, "body", None)
            last = body[0].lineno - 1 if body else node.end_lineno or line
            if line <= last:
                spans.append((node.lineno, last))
    return min(spans[1:] or spans, key=lambda span: span[1] - span[0])


@cache
def _tree(path: str) -> ast.Module:
    return ast.parse((FOLDER / path).read_text())


def test_name(path: str) -> str:
    """Returns the name of a module's own test."""
    return f"test_{Path(path).stem}"


def _in_function(path: str, line: int) -> bool:
    return any(
        node.body[0].lineno <= line <= (node.end_lineno or 0)
        for node in ast.walk(_tree(path))
        if isinstance(node, ast.FunctionDef)
    )


# ------------------------------------------------------------------------------------- the mutants


@dataclass(frozen=True)
class Outcome:
    """What became of a mutant.

    Attributes:
        path: The module's file.
        line: Where it is changed.
        change: The changed lines, before and after.
        killed: Whether a test noticed it.
        by: The tests that failed, by their ids; none if they ended otherwise, or not in time.
        tests: How many tests were run.
    """

    path: str
    line: int
    change: str
    killed: bool
    by: tuple[str, ...]
    tests: int

    @property
    def equivalent(self) -> bool:
        return not self.killed and (self.path, self.change) in equivalents()


@cache
def equivalents() -> frozenset[tuple[str, str]]:
    """Returns the mutants of which somebody has argued that they change nothing."""
    with EQUIVALENT.open(newline="") as file:
        return frozenset((row["module"], row["change"]) for row in csv.DictReader(file))


def no_slips(path: str) -> Iterator[tuple[int, int, int, int]]:
    """Yields where a change is no slip of what is computed, as (line, column, line, column).

    Annotations, what only types are checked for, decorators, the words of an error, and whether
    two sequences are checked for one length.
    """
    for node in ast.walk(_tree(path)):
        inner: list[ast.AST | None] = []
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            inner = [*node.decorator_list]
        if isinstance(node, ast.FunctionDef):
            inner += [node.returns]
            yield from stars(node)
        elif isinstance(node, ast.arg | ast.AnnAssign):
            inner = [node.annotation]
        elif isinstance(node, ast.Raise) or (
            isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
        ):
            inner = [node]
        elif isinstance(node, ast.Call):
            inner = [word.value for word in node.keywords if word.arg == "strict"]
        for one in filter(None, inner):
            yield one.lineno, one.col_offset, one.end_lineno, one.end_col_offset  # type: ignore[attr-defined]


def stars(function: ast.FunctionDef) -> Iterator[tuple[int, int, int, int]]:
    """Yields where a function's head is, but for its defaults: its * and / are no operators."""
    place = function.lineno, function.col_offset
    for one in (*function.args.defaults, *function.args.kw_defaults, function.body[0]):
        if one is not None:
            yield *place, one.lineno, one.col_offset
            place = one.end_lineno, one.end_col_offset  # type: ignore[assignment]


def drawn(paths: Sequence[str], sample: int, seed: int) -> list[Any]:
    """Returns mutations drawn at random: a module by its size, then a place in it, each once."""
    import cosmic_ray.commands
    from cosmic_ray.work_db import use_db

    choose = random.Random(seed)
    weights = [(FOLDER / path).stat().st_size for path in paths]
    wanted = Counter(choose.choices(paths, weights, k=sample))
    kinds = re.compile("|".join(SETTINGS["operators"]))
    found: list[Any] = []
    for path in sorted(wanted):
        with use_db(":memory:") as db:
            cosmic_ray.commands.init([Path(path)], db, {})
            items = [item.mutations[0] for item in db.work_items]
        skipped = list(no_slips(path))
        items = [
            item
            for item in items
            if kinds.fullmatch(item.operator_name)
            and not any((a, b) <= item.start_pos < (c, d) for a, b, c, d in skipped)
        ]
        items.sort(key=lambda item: (item.start_pos, item.operator_name, item.occurrence))
        choose.shuffle(items)
        places = list({item.start_pos: item for item in items}.values())
        found += places[: wanted[path]]
    choose.shuffle(found)
    return found


def outcome(path: str, line: int, run: Callable[[str], tuple[bool, str]]) -> Outcome:
    """Returns what became of a mutant.

    Args:
        path: The module.
        line: Where it is changed.
        run: Makes the mutant and runs words of a shell; returns whether that failed, and the
            changed lines.
    """
    tests = judges(path, *statement(path, line))
    listed, failed = Path("build-judges.txt"), Path(".pytest_cache/v/cache/lastfailed")
    listed.write_text("".join(f"{test}\n" for test in tests))
    failed.unlink(missing_ok=True)
    limit = int(STARTING + ENDLESS * sum(seconds()[test] for test in tests))
    killed, change = run(shell(pytest("-x", f"@{listed}"), limit) if tests else "true")
    own = [str(file) for file in Path("tests", Path(path).parts[1]).rglob(f"{test_name(path)}.py")]
    if own and not killed:
        limit = int(STARTING + ENDLESS * SECONDS)
        killed, change = run(shell(pytest("-x", "-m", SLOW, *own), limit) + NONE_IS_FINE)
    by = tuple(json.loads(failed.read_text())) if killed and failed.exists() else ()
    return Outcome(path, line, change, killed, by, len(tests))


def shell(command: Sequence[str], limit: int) -> str:
    """Returns a shell's words for a command that takes so many seconds of processor at most."""
    words = ["timeout", f"{WAITING:g}", command[0], "-B", *command[1:]]
    return f"ulimit -t {limit}; {shlex.join(words)}"


def by_cosmic_ray(mutation: Any) -> Outcome:
    """Makes a mutant that was drawn, in the current folder, and judges it."""
    from cosmic_ray.mutating import mutate_and_test
    from cosmic_ray.work_item import WorkerOutcome

    def run(command: str) -> tuple[bool, str]:
        result = mutate_and_test([mutation], shlex.join(["sh", "-c", command]), 3 * WAITING)
        if result.worker_outcome != WorkerOutcome.NORMAL:
            raise RuntimeError(result.output)
        rows = (result.diff or "").splitlines()
        change = [row for row in rows if row[:1] in "-+" and row[:3] not in ("---", "+++")]
        return result.is_killed, "\n".join(change)

    return outcome(str(mutation.module_path), mutation.start_pos[0], run)


# -------------------------------------------------------------------------------- rooms and scores


def rooms_modules(room: str) -> list[str]:
    """Returns the modules of a room, relative to the copy."""
    files = sorted((FOLDER / PACKAGE).rglob("*.py"))
    names = [file.relative_to(FOLDER).as_posix() for file in files]
    found = [name for name in names if name.split("/")[1].removesuffix(".py") == room]
    if not found:
        sys.exit(f"there is no room {room!r}")
    return found


def report(found: Outcome) -> None:
    said = "killed" if found.killed else "equal" if found.equivalent else "SURVIVED"
    print(f"{said:8} {found.path}:{found.line} {found.tests} tests", *found.by[:1], flush=True)
    if said == "SURVIVED":
        print(found.change, flush=True)


COLUMNS = ("room", "mutants", "killed", "equivalent", "left", "seed", "date")


def score(room: str, sample: int, seed: int) -> tuple[object, ...]:
    """Draws a sample of a room's mutants, judges each, and returns a row of `COLUMNS`."""
    outcomes = []
    for mutation in drawn(rooms_modules(room), sample, seed):
        outcomes.append(by_cosmic_ray(mutation))
        report(outcomes[-1])
    killed, equal = (sum(getattr(o, kind) for o in outcomes) for kind in ("killed", "equivalent"))
    left = len(outcomes) - killed - equal
    return room, len(outcomes), killed, equal, left, seed, datetime.date.today().isoformat()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("rooms", nargs="*", help="by default all that compute")
    parser.add_argument("--sample", type=int, default=30, help="mutants of each room")
    parser.add_argument("--seed", type=int, default=0, help="of the sample")
    parser.add_argument("--tests", nargs="+", default=SETTINGS["tests"], help="that judge")
    parser.add_argument("--mark", default="not slow", help="which of these (pytest -m)")
    parser.add_argument("--keep", action="store_true", help="the copy, and what tests run in it")
    parser.add_argument("--csv", type=Path, help="write the scores here")
    parser.add_argument("--least", type=float, default=0.0, help="share killed, or it fails")
    given = parser.parse_args()
    rooms = given.rooms or SETTINGS["rooms"]
    target = given.csv.resolve() if given.csv else None
    os.environ |= {"PYTHONPATH": str(FOLDER), "OMP_NUM_THREADS": "1"}
    if not given.keep:
        copied()
        record(given.tests, given.mark)
    os.chdir(FOLDER)
    rows = [score(room, given.sample, given.seed) for room in rooms]
    mutants, killed, equal, left = (sum(row[at] for row in rows) for at in range(1, 5))  # type: ignore[misc]
    rows.append(("all", mutants, killed, equal, left, "", ""))
    for row in [COLUMNS, *rows]:
        print(*(f"{cell!s:>12}" for cell in row))
    if target:
        with target.open("w", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows([COLUMNS, *rows])
    sys.exit(killed + equal < given.least * mutants)


if __name__ == "__main__":
    main()
