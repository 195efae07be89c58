"""Plant faults in a copy of the package and count those that the tests detect.

    make test PYTEST_ADDOPTS=--junit-xml=build/quick.xml
    python benchmarks/mutations.py --count 200 --seed 1 --csv docs/data/mutations.csv \\
      --junit build/quick.xml

Each fault changes one operator, number, index or argument order of one module. Tests run in tiers,
until one fails:

- ``near``: quick tests of the mirrored file, and of files that import the module;
- ``folder``: quick tests of the mirrored folder, for at most 30 s;
- ``slow``: slow tests of the near files;
- ``quick``: all quick tests.

A fault that no test detects has survived: a test is missing, or the change does not alter any
result. The column ``reason`` is written by hand and kept. ``--junit`` names the file of a run of
the quick tests; their durations sort the tests of a tier, the shortest first.

The tests run in a forked process that has already imported the packages that this package requires,
so that a fault costs the time of its tests. Linux and macOS only.

The choice depends on the seed and on the faulty lines only: if another line of the source changes,
the same faults are chosen. A row of the CSV is kept if the source still contains its line, and
counts towards ``--count``; an interrupted run can be continued. ``--again`` repeats the faults that
have survived. The checkout is not touched.
"""

from __future__ import annotations

import argparse
import ast
import csv
import hashlib
import importlib
import math
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise, zip_longest
from pathlib import Path
from typing import IO, Any, NoReturn
from xml.etree import ElementTree

PROJECT_FOLDER = Path(__file__).resolve().parent.parent
"""Root folder of this project."""

PACKAGE = "pupper_analysis"
"""Name of the package in which faults are planted."""

MAX_TEST_FILES = 3
"""Upper bound of test files that count as near to a module. Chosen: seconds of processor."""

MAX_PROCESSOR_SECONDS = {"near": 300, "folder": 300, "slow": 1200, "quick": 2400}
"""Processor time [s] after which the tests of a tier are stopped. The fault is then ``killed``,
since the tests do not end. At least four times the time without a fault: all quick tests take
350 s. Processor time does not depend on the load of the machine."""

MAX_FOLDER_SECONDS = 30.0
"""Upper bound of the sum of the recorded durations of the tests of a folder [s]. Chosen: the folder
of the commands has 100 s of tests, most of which do not execute the module."""

TIERS = tuple(MAX_PROCESSOR_SECONDS)
"""Names of the tiers, in the order in which they run."""

PRELOADED = (
    *("pytest", "numpy", "scipy.optimize", "scipy.spatial", "mujoco", "pinocchio"),
    *("coal", "placo", "lxml.etree", "yourdfpy", "trimesh", "matplotlib.pyplot", "clarabel"),
    *("shapely", "click", "rich.console", "orjson", "jinja2", "yaml"),
)
"""Modules that the parent process imports: together 1.5 s of processor."""

COLUMNS = (
    *("file", "line", "kind", "before", "after", "code", "occurrence"),
    *("tiers", "outcome", "detected_by", "reason"),
)
"""Columns of the table of faults."""

_OPERATORS: dict[type[ast.AST], tuple[str, str, str]] = {
    ast.Add: ("sign", "+", "-"),
    ast.Sub: ("sign", "-", "+"),
    ast.Mult: ("unit", "*", "/"),
    ast.Div: ("unit", "/", "*"),
    ast.Lt: ("off-by-one", "<", "<="),
    ast.LtE: ("off-by-one", "<=", "<"),
    ast.Gt: ("off-by-one", ">", ">="),
    ast.GtE: ("off-by-one", ">=", ">"),
    ast.Eq: ("condition", "==", "!="),
    ast.And: ("condition", "and", "or"),
    ast.Or: ("condition", "or", "and"),
}
"""{operator: (kind of the fault, text, replacing text)}."""

_CALLS = {
    "radians": "degrees",
    "degrees": "radians",
    "sin": "cos",
    "cos": "sin",
    "min": "max",
    "max": "min",
    "minimum": "maximum",
    "maximum": "minimum",
}
"""{called function: replacing function}."""


@dataclass(frozen=True)
class Fault:
    """One change of a source file.

    Attributes:
        file: Path in the repository.
        line: Line number, from 1.
        kind: ``sign``, ``unit``, ``index``, ``off-by-one``, ``condition``, ``extremum`` or
            ``swap``.
        start: Offset of the replaced text in the file's characters.
        before: Replaced text.
        after: New text.
        code: The line without indentation, before the change.
        occurrence: Number among the faults of the file with equal line and texts, from 1.
    """

    file: str
    line: int
    kind: str
    start: int
    before: str
    after: str
    code: str
    occurrence: int = 1

    @property
    def key(self) -> tuple[str, ...]:
        """Texts that identify the fault while other lines of the source change."""
        return self.file, self.code, self.before, self.after, str(self.occurrence)


def find_faults(path: Path) -> list[Fault]:
    """Return all faults that can be planted in a module, in the order of the source."""
    return _Finder(path).faults


class _Finder:
    """Faults of one module."""

    def __init__(self, path: Path) -> None:
        self.faults: list[Fault] = []
        self._file = Path(*path.parts[path.parts.index(PACKAGE) :]).as_posix()
        self._source = path.read_text(encoding="utf-8")
        self._lines = self._source.splitlines(keepends=True)
        self._starts = [0, *accumulate(map(len, self._lines))]
        for node in _list_computing_nodes(ast.parse(self._source)):
            self._visit_operators(node)
            self._visit_numbers(node)
            self._visit_calls(node)

    def _offset(self, line: int, column: int) -> int:
        """Return the offset in characters; ``ast`` counts columns in UTF-8 bytes."""
        return self._starts[line - 1] + len(self._lines[line - 1].encode()[:column].decode())

    def _range(self, node: ast.expr) -> tuple[int, int]:
        """Return the offsets of the first character of an expression, and of the character after
        it.
        """
        end = self._offset(node.end_lineno or 1, node.end_col_offset or 0)
        return self._offset(node.lineno, node.col_offset), end

    def _text(self, node: ast.expr) -> str:
        """Return the source text of an expression."""
        return self._source[slice(*self._range(node))]

    def _add(self, line: int, kind: str, start: int, before: str, after: str) -> None:
        """Record a fault that replaces the text ``before`` at an offset."""
        code = self._lines[line - 1].strip()
        self.faults.append(Fault(self._file, line, kind, start, before, after, code))

    def _replace(self, node: ast.expr, kind: str, after: str) -> None:
        """Record a fault that replaces an expression."""
        self._add(node.lineno, kind, self._range(node)[0], self._text(node), after)

    def _visit_operators(self, node: ast.AST) -> None:
        """Record faults that exchange or remove the operator of a node."""
        match node:
            case ast.BinOp(left=left, op=operator, right=right):
                pass
            case ast.Compare(left=left, ops=[operator], comparators=[right]):
                pass
            case ast.BoolOp(op=operator, values=[left, right, *_]):
                pass
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                self._replace(node, "sign", self._text(operand))
                return
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                self._replace(node, "condition", f"({self._text(operand)})")
                return
            case _:
                return
        text = isinstance(left, ast.Constant) and isinstance(left.value, str)
        if type(operator) not in _OPERATORS or text:
            return
        kind, sign, other = _OPERATORS[type(operator)]
        begin = self._range(left)[1]
        gap = self._source[begin : self._range(right)[0]]
        if sign in gap and "#" not in gap:
            line = left.end_lineno or left.lineno
            self._add(line, kind, begin + gap.index(sign), sign, other)

    def _visit_numbers(self, node: ast.AST) -> None:
        """Record faults that change the number or index of a node."""
        match node:
            case ast.Subscript(slice=ast.Constant(value=int(number)) as at) if number in (0, 1, 2):
                self._replace(at, "index", str((number + 1) % 3))
            case ast.Slice(lower=lower, upper=upper):
                for end in (lower, upper):
                    if isinstance(end, ast.Constant) and isinstance(end.value, int):
                        self._replace(end, "off-by-one", str(end.value + 1))
            case ast.Constant(value=float(number)) if number not in (0.0, 1.0):
                self._replace(node, "unit", f"({self._text(node)} * 1000)")

    def _visit_calls(self, node: ast.AST) -> None:
        """Record faults that exchange a called function, or two arguments or elements."""
        match node:
            case ast.Call(func=ast.Name(id=called) | ast.Attribute(attr=called) as function):
                if called in _CALLS:
                    begin = self._range(function)[1] - len(called)
                    kind = "extremum" if called.startswith("m") else "unit"
                    self._add(node.lineno, kind, begin, called, _CALLS[called])
                self._add_swaps(node.args)
            case ast.Tuple(elts=elements, ctx=ast.Load()):
                self._add_swaps(elements)

    def _add_swaps(self, elements: Sequence[ast.expr]) -> None:
        """Add the exchanges of two neighbouring names, attributes or subscripts."""
        for one, two in pairwise(elements):
            if not isinstance(one, _PLAIN) or not isinstance(two, _PLAIN):
                continue
            first, second = self._text(one), self._text(two)
            start, end = self._range(one)[0], self._range(two)[1]
            before = f"{first}, {second}"
            if first != second and self._source[start:end] == before:
                self._add(one.lineno, "swap", start, before, f"{second}, {first}")


_PLAIN = (ast.Name, ast.Attribute, ast.Subscript)
"""Types of expressions that may be exchanged."""


def _list_computing_nodes(tree: ast.AST) -> Iterator[ast.AST]:
    """Yield the nodes of a module without annotations, decorators, imports and strings."""
    for name, value in ast.iter_fields(tree):
        if name in ("annotation", "returns", "decorator_list", "type_params", "names"):
            continue
        for node in value if isinstance(value, list) else [value]:
            if not isinstance(node, ast.AST) or isinstance(node, ast.JoinedStr | ast.Import):
                continue
            yield node
            yield from _list_computing_nodes(node)


def list_faults(package: Path) -> list[Fault]:
    """Return the faults of all modules of a package, sorted by file and offset."""
    faults = [fault for path in sorted(package.rglob("*.py")) for fault in find_faults(path)]
    seen: Counter[tuple[str, ...]] = Counter()
    numbered = []
    for fault in sorted(faults, key=lambda fault: (fault.file, fault.start, fault.after)):
        seen[fault.key] += 1
        numbered.append(replace(fault, occurrence=seen[fault.key]))
    return numbered


def sort_faults(faults: Sequence[Fault], seed: int) -> list[Fault]:
    """Return the faults in a random order in which the kinds of faults take turns.

    The place of a fault among those of its kind is a hash of its texts and the seed. It does not
    depend on other lines of the source.
    """

    def place(fault: Fault) -> str:
        return hashlib.sha256("\0".join((str(seed), *fault.key)).encode()).hexdigest()

    kinds: dict[str, list[Fault]] = {}
    for fault in sorted(faults, key=place):
        kinds.setdefault(fault.kind, []).append(fault)
    turns = zip_longest(*(kinds[kind] for kind in sorted(kinds)))
    return [fault for row in turns for fault in row if fault is not None]


def near_tests(module: Path, tests: Path) -> list[Path]:
    """Return the test files nearest to a module, at most ``MAX_TEST_FILES``.

    First the mirrored file, then files that import the module, those in the mirrored folder first;
    if there is none, the files of the nearest folder that exists.

    Args:
        module: Path in the package, without the package's name.
        tests: Folder of the tests.
    """
    dotted = ".".join((PACKAGE, *module.with_suffix("").parts))
    folder = tests / module.parent
    mirrored = folder / f"test_{module.stem}.py"
    importing = [
        path
        for path in sorted(tests.rglob("test_*.py"))
        if path != mirrored
        and (
            f"from {dotted} import" in (text := path.read_text(encoding="utf-8"))
            or f"from {dotted.rpartition('.')[0]} import {module.stem}\n" in text
        )
    ]
    importing.sort(key=lambda path: (path.parent != folder, len(path.parts), path))
    found = [mirrored] * mirrored.exists() + importing
    while not found and folder != tests.parent:
        found = sorted(folder.glob("test_*.py"))
        folder = folder.parent
    return found[:MAX_TEST_FILES]


def read_durations(junit: Path) -> dict[str, float]:
    """Return {test: duration [s]} of a JUnit file of pytest."""
    cases = ElementTree.parse(junit).getroot().iter("testcase")
    return {
        f"{case.get('classname', '').replace('.', '/')}.py::{case.get('name')}": float(
            case.get("time", 0.0)
        )
        for case in cases
    }


class ShortestFirst:
    """Plugin of pytest that sorts the tests by duration, and records the first that fails.

    Args:
        durations: {test: duration [s]}; unknown tests run first.
        limit: Maximum sum of the durations; the tests beyond are left out.
        only: The only test or file that runs; empty: all tests.

    Attributes:
        failed: The first test, or file, that fails; empty if there is none.
    """

    def __init__(self, durations: Mapping[str, float], limit: float, only: str) -> None:
        self._durations, self._limit, self._only = durations, limit, only
        self.failed = ""

    def pytest_collection_modifyitems(self, items: list[Any]) -> None:
        """Sort the tests, and leave out the longest ones."""
        items.sort(key=lambda item: self._durations.get(item.nodeid, 0.0))
        sums = accumulate(self._durations.get(item.nodeid, 0.0) for item in items)
        del items[sum(total <= self._limit for total in sums) :]
        items[:] = [item for item in items if item.nodeid.startswith(self._only)]

    def pytest_runtest_logreport(self, report: Any) -> None:
        """Record a failed test."""
        self.failed = self.failed or (report.nodeid if report.failed else "")

    pytest_collectreport = pytest_runtest_logreport


class Bench:
    """Copy of the repository in which faults are planted.

    Args:
        folder: Folder of the copy; replaced if it exists.
        durations: {test: duration [s]}, which sort the tests.
    """

    def __init__(self, folder: Path, durations: Mapping[str, float]) -> None:
        self.folder, self._durations = folder, durations
        shutil.rmtree(folder, ignore_errors=True)
        listed = subprocess.run(
            ["git", "ls-files", "-z"],
            cwd=PROJECT_FOLDER,
            capture_output=True,
            check=True,
            text=True,
        )
        for name in filter(None, listed.stdout.split("\0")):
            if (PROJECT_FOLDER / name).is_file():
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(PROJECT_FOLDER / name, folder / name)
        self._passing: dict[str, bool] = {}
        self._planted = 0
        for name in PRELOADED:
            importlib.import_module(name)

    def passes(self, test: str, tier: str) -> bool:
        """Return whether a test passes without a fault; it runs once."""
        if test not in self._passing:
            file = test.partition("::")[0]
            exists = (self.folder / file).exists()  # not "timeout", for example
            self._passing[test] = not exists or self._run(tier, [file], only=test) == ""
        return self._passing[test]

    def detecting_test(self, fault: Fault, tier: str, arguments: Sequence[str]) -> str:
        """Return the first test that fails with a fault, "timeout", or "" if all pass.

        Each faulty file has its own modification time, so that no bytecode of another fault is
        used; the original file keeps its time, so that its bytecode stays valid.
        """
        path = self.folder / fault.file
        source, stat = path.read_text(encoding="utf-8"), path.stat()
        end = fault.start + len(fault.before)
        assert source[fault.start : end] == fault.before
        self._planted += 1
        path.write_text(source[: fault.start] + fault.after + source[end:], encoding="utf-8")
        os.utime(path, (stat.st_atime, int(stat.st_mtime) + 10 * self._planted))
        try:
            return self._run(tier, arguments)
        finally:
            path.write_text(source, encoding="utf-8")
            os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))

    def _run(self, tier: str, arguments: Sequence[str], *, only: str = "") -> str:
        """Run tests until one fails; return its name, "timeout", or "" if all pass."""
        with tempfile.TemporaryFile("w+") as result:
            child = os.fork()
            if child == 0:
                self._run_in_child(tier, arguments, only, result)
            _, wait_status = os.waitpid(child, 0)
            result.seek(0)
            failed = result.read()
        status = os.waitstatus_to_exitcode(wait_status)
        if status == -signal.SIGXCPU:
            return "timeout"
        if status in (0, 5):  # 5: no test is selected
            return ""
        return failed or f"exit status {status}"

    def _run_in_child(
        self, tier: str, arguments: Sequence[str], only: str, result: IO[str]
    ) -> NoReturn:
        """Run tests in a forked process, write the name of the failed one, and exit."""
        seconds = MAX_PROCESSOR_SECONDS[tier]
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 10))
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, 1)
        os.dup2(null, 2)
        os.chdir(self.folder)
        os.environ["PYTHONPATH"] = str(self.folder)
        sys.path[:] = [
            str(self.folder),
            *(path for path in sys.path if path != str(PROJECT_FOLDER)),
        ]
        status = 1
        try:
            limit = MAX_FOLDER_SECONDS if tier == "folder" else math.inf
            plugin = ShortestFirst(self._durations, limit, only)
            options = ["-n", "0", "-x", "-q", "--tb=no", "-p", "no:cacheprovider"]
            status = int(sys.modules["pytest"].main([*options, *arguments], [plugin]))
            result.write(plugin.failed)
        finally:
            result.flush()
            os._exit(status)


def run_fault(bench: Bench, fault: Fault, *, tiers: Sequence[str]) -> tuple[set[str], str, str]:
    """Return the tiers that ran for a fault, its outcome, and the test that detects it.

    The outcome is ``killed``, ``survived``, or ``untested`` if the tests fail without the fault,
    too, or there are none.

    Args:
        bench: The copy.
        fault: The fault.
        tiers: Tiers of ``TIERS``, in the order in which they run.
    """
    module = Path(fault.file).relative_to(PACKAGE)
    near = [
        str(path.relative_to(bench.folder)) for path in near_tests(module, bench.folder / "tests")
    ]
    folder = bench.folder / "tests" / module.parent
    while not any(folder.glob("test_*.py")):
        folder = folder.parent
    others = [f"--ignore={path}" for path in near]
    selections = {"near": ["-m", "not slow", *near], "slow": ["-m", "slow", *near],
                  "folder": ["-m", "not slow", *others, str(folder.relative_to(bench.folder))],
                  "quick": ["-m", "not slow", "tests"]}  # fmt: skip
    outcome, run = "untested", set()
    for tier in tiers:
        if not near and tier in ("near", "slow"):
            continue
        run.add(tier)
        if not (failed := bench.detecting_test(fault, tier, selections[tier])):
            outcome = "survived"
        elif bench.passes(failed, tier):
            return run, "killed", failed
    return run, outcome, ""


def main() -> int:
    """Plant faults, write the table, and print the counts."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=200, help="number of faults (200)")
    parser.add_argument("--seed", type=int, default=1, help="seed of the choice (1)")
    parser.add_argument("--csv", type=Path, default=PROJECT_FOLDER / "build/mutations.csv")
    parser.add_argument(
        "--tiers", nargs="+", choices=TIERS, default=TIERS,
        help="tests that run, in this order",
    )  # fmt: skip
    parser.add_argument("--junit", type=Path, help="JUnit file of the quick tests")
    parser.add_argument("--again", action="store_true", help="repeat faults that are not killed")
    parser.add_argument("--folder", type=Path, default=PROJECT_FOLDER / "build/mutations")
    parser.add_argument("modules", nargs="*", help="beginnings of paths, e.g. statics robot/fall")
    given = parser.parse_args()
    faults = list_faults(PROJECT_FOLDER / PACKAGE)
    known = {fault.key: fault for fault in faults}
    if given.modules:
        chosen = tuple(f"{PACKAGE}/{one}" for one in given.modules)
        faults = [fault for fault in faults if fault.file.startswith(chosen)]
    faults = sort_faults(faults, given.seed)
    rows: dict[tuple[str, ...], dict[str, str]] = {}
    for row in read_rows(given.csv):
        key = row["file"], row["code"], row["before"], row["after"], row["occurrence"]
        if key in known:
            rows[key] = row | {"line": str(known[key].line)}
    write_rows(given.csv, [*rows.values()])
    again = [
        fault
        for fault in faults
        if rows.get(fault.key, {"outcome": "killed"})["outcome"] != "killed"
    ]
    unknown = [fault for fault in faults if fault.key not in rows]
    todo = again if given.again else unknown[: max(0, given.count - len(rows))]
    bench = Bench(given.folder, read_durations(given.junit) if given.junit else {})
    for number, fault in enumerate(todo, start=1):
        run, outcome, detected_by = run_fault(bench, fault, tiers=given.tiers)
        earlier = rows.get(fault.key, {})
        run |= set(earlier.get("tiers", "").split())
        tiers = " ".join(tier for tier in TIERS if tier in run)
        reason = earlier.get("reason", "")
        values = (fault.file, fault.line, fault.kind, fault.before, fault.after, fault.code,
                  fault.occurrence, tiers, outcome, detected_by)  # fmt: skip
        rows[fault.key] = dict(zip(COLUMNS, (*map(str, values), reason), strict=True))
        write_rows(given.csv, [*rows.values()])
        print(f"{number}/{len(todo)} {outcome:9} {fault.file}:{fault.line} {fault.kind}: "
              f"{fault.before} -> {fault.after} {detected_by}", flush=True)  # fmt: skip
    counts = Counter(row["outcome"] for row in rows.values())
    print(", ".join(f"{count} {outcome}" for outcome, count in sorted(counts.items())))
    return 0


def read_rows(path: Path) -> list[dict[str, str]]:
    """Return the rows of a table of outcomes; none if the file does not exist."""
    if not path.exists():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def write_rows(path: Path, rows: Sequence[dict[str, str]]) -> None:
    """Write a table of outcomes."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


if __name__ == "__main__":
    raise SystemExit(main())
