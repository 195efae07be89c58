"""Slips made on purpose: do the tests notice them? Mutants by Cosmic Ray, a sample per room.

Each mutant changes one operator, number or condition of one module; the tests nearest to the module
run until one fails. A mutant that none notices has survived: a test is missing, or the code does
not need what was changed. ::

    python tests/mutate.py statics robot --sample 40    # make mutate ROOM="statics robot" SAMPLE=40

The checkout is not touched: all of it happens in a copy, build/mutants. Which rooms, and which
kinds of slips, says `pyproject.toml`. A test has noticed a mutant only if it passes without it.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import random
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
BUILD = ROOT / "build"
PACKAGE = "pupper_analysis"
SETTINGS = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["mutate"]

SECONDS = 180
"""Of processor for the tests of a mutant: one that never ends has been noticed."""

WAITING = 20 * SECONDS
"""Of waiting: others compute, too."""

ABOUT_THE_TEXT = {"test_architecture", "test_docs", "test_house", "test_layers"}
"""Tests that read the code, and do not run it."""


# ------------------------------------------------------------------------- which tests are nearest


def module_name(path: Path) -> str:
    """Returns a module's name from its path in the checkout."""
    parts = path.with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@cache
def modules() -> Mapping[str, Path]:
    """Returns {name of a module: its file, relative to the checkout}."""
    files = sorted((ROOT / PACKAGE).rglob("*.py"))
    return {module_name(p): p for p in (file.relative_to(ROOT) for file in files)}


@cache
def public() -> Mapping[str, str]:
    """Returns {public name: the module where it is at home}."""
    tree = ast.parse((ROOT / PACKAGE / "__init__.py").read_text())
    return {
        alias.name: node.module
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module
        for alias in node.names
        if node.module.startswith(PACKAGE)
    }


def imported(tree: ast.AST) -> Iterator[str]:
    """Yields the package's modules that a file imports, or reaches through the package's door."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                yield inner if inner in modules() else node.module
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.Attribute) and ast.unparse(node.value) in ("pa", PACKAGE):
            yield public().get(node.attr, PACKAGE)


@cache
def used(path: Path) -> frozenset[str]:
    """Returns the package's modules that a file uses itself."""
    tree = ast.parse((ROOT / path).read_text())
    return frozenset(name for name in imported(tree) if name in modules() and name != PACKAGE)


@cache
def users() -> Mapping[str, frozenset[str]]:
    """Returns {module: those that import it}."""
    found: dict[str, set[str]] = {name: set() for name in modules()}
    for name, path in modules().items():
        for other in used(path):
            found[other].add(name)
    return {name: frozenset(those) for name, those in found.items()}


def words_of(name: str) -> frozenset[str]:
    """Returns the words of a dotted name, without their plurals."""
    return frozenset(word.rstrip("s") for word in re.split(r"[._]", name))


def nearest(module: str, most: int) -> list[Path]:
    """Returns the test files nearest to a module, relative to the checkout.

    Those of its name come first, then those that use it themselves, then those whose names share
    the most words with its path; of several, those from which the fewest imports lead to it, and
    which use the fewest modules.
    """
    away, waiting = {module: 0}, deque([module])
    while waiting:
        name = waiting.popleft()
        for user in users()[name] - away.keys():
            away[user] = away[name] + 1
            waiting.append(user)
    words, stem, ranked = words_of(module), words_of(module.rpartition(".")[2]), []
    for file in sorted((ROOT / "tests").rglob("test_*.py")):
        path = file.relative_to(ROOT)
        steps = [away[name] for name in used(path) if name in away]
        if steps and path.stem not in ABOUT_THE_TEXT:
            own = words_of(path.stem) - {"test"}
            shared, direct = len(own & words), 0 in steps
            ranked.append((own != stem, not direct, -shared, min(steps), len(used(path)), path))
    return [path for *_, path in sorted(ranked)[:most]]


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
        tests: The files whose tests were run.
    """

    path: str
    line: int
    change: str
    killed: bool
    by: tuple[str, ...]
    tests: tuple[str, ...]


def command(tests: Iterable[str], mark: str) -> str:
    """Returns the shell's command that runs some tests within their time, in the current folder."""
    pytest = [sys.executable, "-B", "-m", "pytest", "-n", "0", "-q", "-x", "-m", mark, *tests]
    return shlex.join(["sh", "-c", f"ulimit -t {SECONDS}; exec {shlex.join(pytest)}"])


def copied(folder: Path) -> None:
    """Copies what git knows of the checkout, and what is new in it."""
    shutil.rmtree(folder, ignore_errors=True)
    listing = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(listing, cwd=ROOT, capture_output=True, check=True, text=True).stdout
    for name in filter(None, listed.split("\0")):
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)


def drawn(paths: Sequence[Path], sample: int, seed: int) -> list[object]:
    """Returns mutations drawn at random: a module by its size, then a place in it, each once."""
    import cosmic_ray.commands
    from cosmic_ray.work_db import use_db

    choose = random.Random(seed)
    weights = [path.stat().st_size for path in paths]
    wanted = Counter(choose.choices(paths, weights, k=sample))
    kinds = re.compile("|".join(SETTINGS["operators"]))
    found: list[object] = []
    for path in sorted(wanted):
        with use_db(":memory:") as db:
            cosmic_ray.commands.init([path], db, {})
            items = [item.mutations[0] for item in db.work_items]
        items = [item for item in items if kinds.fullmatch(item.operator_name)]
        items.sort(key=lambda item: (item.start_pos, item.operator_name, item.occurrence))
        choose.shuffle(items)
        places = list({item.start_pos: item for item in items}.values())
        found += places[: wanted[path]]
    choose.shuffle(found)
    return found


def outcome(mutation: object, most: int, mark: str) -> Outcome | None:
    """Makes a mutant in the current folder, and runs the tests nearest to it."""
    from cosmic_ray.mutating import mutate_and_test
    from cosmic_ray.work_item import WorkerOutcome

    path = Path(mutation.module_path)  # type: ignore[attr-defined]
    tests = tuple(str(test) for test in nearest(module_name(path), most))
    failed = Path(".pytest_cache/v/cache/lastfailed")
    failed.unlink(missing_ok=True)
    result = mutate_and_test([mutation], command(tests, mark), WAITING)
    if result.worker_outcome != WorkerOutcome.NORMAL:
        return None
    rows = (result.diff or "").splitlines()
    change = [row for row in rows if row[:1] in "-+" and row[:3] not in ("---", "+++")]
    by = tuple(json.loads(failed.read_text())) if failed.exists() else ()
    line = mutation.start_pos[0]  # type: ignore[attr-defined]
    return Outcome(str(path), line, "\n".join(change), result.is_killed, by, tests)


def passes(tests: Sequence[str], mark: str) -> bool:
    """Tells whether tests pass in the current folder, without a mutant."""
    run = subprocess.run(shlex.split(command(tests, mark)), capture_output=True, check=False)
    return run.returncode == 0


def judged(outcomes: Sequence[Outcome], mark: str) -> list[Outcome]:
    """Returns only those mutants whose killers are innocent: they pass without the mutant."""
    broken = set()
    for tests in {found.by or found.tests for found in outcomes if found.killed}:
        if not passes(tests, mark if not any("::" in test for test in tests) else ""):
            broken.add(tests)
            print("fails without any mutant:", *tests, flush=True)
    return [
        found for found in outcomes if not (found.killed and (found.by or found.tests) in broken)
    ]


def mutate(room: str, sample: int, seed: int, most: int, mark: str) -> list[Outcome]:
    """Returns what became of a sample of a room's mutants."""
    folder = BUILD / "mutants"
    copied(folder)
    os.chdir(folder)
    os.environ |= {"PYTHONPATH": str(folder), "OMP_NUM_THREADS": "1"}
    paths = [path for path in modules().values() if path.parts[1].removesuffix(".py") == room]
    if not paths:
        sys.exit(f"there is no room {room!r}")
    outcomes = []
    for mutation in drawn(paths, sample, seed):
        found = outcome(mutation, most, mark)
        if found is not None:
            outcomes.append(found)
            said = "killed" if found.killed else "SURVIVED"
            print(f"{said:8} {found.path}:{found.line}", *found.by[:1], flush=True)
            if not found.killed:
                print(found.change, flush=True)
    return judged(outcomes, mark)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("rooms", nargs="*", help="by default all that compute")
    parser.add_argument("--sample", type=int, default=40, help="mutants of each room")
    parser.add_argument("--seed", type=int, default=0, help="of the sample")
    parser.add_argument("--files", type=int, default=6, help="test files, of the nearest, for each")
    parser.add_argument("--mark", default="not longest", help="which of their tests (pytest -m)")
    parser.add_argument("--least", type=float, default=0.0, help="share killed, or it fails")
    given = parser.parse_args()
    scores: dict[str, Counter[bool]] = {}
    for room in given.rooms or SETTINGS["rooms"]:
        outcomes = mutate(room, given.sample, given.seed, given.files, given.mark)
        scores[room] = Counter(found.killed for found in outcomes)
        (BUILD / f"mutants-{room}.json").write_text(
            json.dumps([found.__dict__ for found in outcomes], indent=1)
        )
    print("\nroom         killed  of")
    for room, score in scores.items():
        print(f"{room:12} {score[True]:6} {score.total():3}  {score[True] / score.total():.0%}")
    total = sum(scores.values(), Counter())
    sys.exit(total[True] < given.least * total.total())


if __name__ == "__main__":
    main()
