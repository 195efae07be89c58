"""Plant faults in a copy of the package and count those that the tests detect.

    python benchmarks/mutations.py --count 200 --seed 1 --csv docs/data/mutations.csv

Each fault changes one operator, number, index, called function or order of two arguments or
elements in one module. The first run records with coverage.py which quick test executes which line
(``Coverage``). Then each fault runs the tests that can detect it, until one fails, in these tiers:

- ``near``: quick tests of the mirrored file, and of files that import the module, that execute the
  statement;
- ``executing``: all other quick tests that execute the statement;
- ``file``: the other quick tests of the files of ``executing``, since a test may use a result that
  an earlier test of its process has computed;
- ``slow``: slow tests of the near files.

By default, the first two tiers run. A surviving fault is then one that no quick test detects on its
own: the result of a test that does not execute a statement does not depend on it. A statement that
runs at import, such as the value of a constant, is executed by all tests; here the tests are those
that execute a statement with the name of the constant (``executing_statements``).

A fault that no test detects has survived: a test is missing, or the change does not alter any
result. The column ``reason`` is written by hand and kept.

The tests run in a forked process that has already imported the packages that this package requires,
so that a fault costs the time of its tests. Linux and macOS only.

The choice depends on the seed and on the faulty lines only: if another line of the source changes,
the same faults are chosen. A row of the CSV is kept if the source still contains its line, and
counts towards ``--count``; an interrupted run can be continued, and so can the recording of lines.
``--again`` repeats the faults that are not killed. The checkout is not touched.
"""

from __future__ import annotations

import argparse
import ast
import csv
import hashlib
import importlib
import json
import math
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise, zip_longest
from pathlib import Path
from typing import IO, Any, NoReturn

PROJECT_FOLDER = Path(__file__).resolve().parent.parent
"""Root folder of this project."""

PACKAGE = "pupper_analysis"
"""Name of the package in which faults are planted."""

MAX_TEST_FILES = 3
"""Upper bound of test files that count as near to a module. Chosen: seconds of processor."""

MIN_PROCESSOR_LIMIT = 40.0
"""Processor time [s] that a run of tests has at least. Chosen: imports and collection of all test
files take 10 s."""

PROCESSOR_LIMIT_FACTOR = 5.0
"""Processor time after which a run of tests is stopped, relative to the sum of the durations of its
tests without a fault. The fault is then ``killed``, since the tests do not end. Processor time does
not depend on the load of the machine. Chosen, not tuned."""

MAX_TEST_SECONDS = 600
"""Duration [s] after which a waiting test fails, as in ``make test``."""

TIERS = ("near", "executing", "file", "slow")
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


def executing_statements(fault: Fault, trees: Mapping[str, ast.Module]) -> dict[str, set[int]]:
    """Return {file: lines} of the statements that a test must execute to detect a fault.

    In a function this is the faulty statement. A statement of a module or a class runs at import:
    its value takes effect in the functions that contain a name that it assigns. The default of an
    argument takes effect in the body of the function.

    Args:
        fault: The fault.
        trees: {file: syntax tree} of all modules of the package.
    """
    found: dict[str, set[int]] = {}
    todo = [(fault.file, fault.line)]
    visited = set(todo)
    while todo:
        file, line = todo.pop()
        parents = _statements_around(trees[file], line)
        if not parents:
            continue
        found.setdefault(file, set()).update(_own_lines(parents[-1]), [line])
        if any(isinstance(parent, _FUNCTIONS) for parent in parents[:-1]):
            continue
        names = _assigned_names(parents)
        if isinstance(parents[-1], _FUNCTIONS):
            found[file].update(_own_lines(parents[-1].body[0]))
        for other, tree in trees.items():
            places = [
                (other, node.lineno)
                for node in ast.walk(tree)
                if (isinstance(node, ast.Name) and node.id in names)
                or (isinstance(node, ast.Attribute) and node.attr in names)
            ]
            todo += [place for place in places if place not in visited]
            visited.update(places)
    return found


_FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)


def _statements_around(tree: ast.Module, line: int) -> list[ast.stmt]:
    """Return the statements that contain a line, the outermost first."""
    nested: list[ast.stmt] = [
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.stmt) and node.lineno <= line <= (node.end_lineno or node.lineno)
    ]
    return sorted(nested, key=lambda node: (node.lineno, -(node.end_lineno or 0), node.col_offset))


def _own_lines(statement: ast.stmt) -> range:
    """Return the lines of a statement without the statements that it contains."""
    end = statement.end_lineno or statement.lineno
    body = getattr(statement, "body", None)
    return range(statement.lineno, max(statement.lineno + 1, body[0].lineno) if body else end + 1)


def _assigned_names(statements: Sequence[ast.stmt]) -> set[str]:
    """Return the names that the innermost of nested statements assigns."""
    match statements[-1]:
        case ast.Assign(targets=targets):
            pass
        case ast.AnnAssign(target=target) | ast.AugAssign(target=target):
            targets = [target]
        case _:
            return set()
    return {node.id for one in targets for node in ast.walk(one) if isinstance(node, ast.Name)}


class Chosen:
    """Plugin of pytest that runs chosen tests, and records their results.

    Args:
        tests: Names of the tests in the order in which they run; None: all.

    Attributes:
        failed: The first test, or file, that fails; empty if there is none.
        seconds: {test: duration [s]} of set-up, call and tear-down.
    """

    def __init__(self, tests: Sequence[str] | None) -> None:
        self._places = None if tests is None else {name: i for i, name in enumerate(tests)}
        self.failed = ""
        self.seconds: Counter[str] = Counter()

    def pytest_collection_modifyitems(self, items: list[Any]) -> None:
        """Sort the tests, and leave out those that are not chosen."""
        if self._places is not None:
            items[:] = [item for item in items if item.nodeid in self._places]
            items.sort(key=lambda item: self._places[item.nodeid])

    def pytest_runtest_logreport(self, report: Any) -> None:
        """Record the duration of a test, and its name if it is the first that fails."""
        self.seconds[report.nodeid] += report.duration
        self.failed = self.failed or (report.nodeid if report.failed else "")

    def pytest_collectreport(self, report: Any) -> None:
        """Record a file that cannot be collected."""
        self.failed = self.failed or (report.nodeid if report.failed else "")


class ContextPerTest(Chosen):
    """Plugin of pytest that labels executed lines with the test, its fixtures included."""

    def __init__(self, coverage: Any) -> None:
        super().__init__(None)
        self._coverage = coverage

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        """Label the following lines with a test."""
        self._coverage.switch_context(nodeid)


COVERAGE_SETTINGS = """\
[run]
include = {source}/*
data_file = {data}
parallel = true
concurrency = thread, multiprocessing
context = ${{PYTEST_CURRENT_TEST-}}
disable_warnings = no-data-collected, module-not-imported, module-not-measured, couldnt-parse
"""
"""Settings of coverage.py. pytest sets the environment variable to the name of the current test:
processes that a test starts record their lines under this name."""

SITE_CODE = "import coverage\ncoverage.process_startup()\n"
"""Module ``sitecustomize``, which Python imports at the start of each process."""


class Coverage:
    """Record of the quick tests that execute a line.

    Each test file runs in a process of its own. Its record is a folder, which is valid for one
    state of package and tests: its name contains a hash of their texts.

    Args:
        bench: The copy without a fault.
        folder: Folder of the records.
    """

    def __init__(self, bench: Bench, folder: Path) -> None:
        self._package = bench.folder / PACKAGE
        digest = hashlib.sha256()
        for path in sorted([*self._package.rglob("*.py"), *(bench.folder / "tests").rglob("*.py")]):
            digest.update(path.read_bytes())
        self._folder = folder / digest.hexdigest()[:12]
        files = sorted((bench.folder / "tests").rglob("test_*.py"))
        self._records: dict[str, Path] = {}
        self.seconds: dict[str, float] = {}
        for number, path in enumerate(files, start=1):
            name = path.relative_to(bench.folder).as_posix()
            record = self._folder / name.replace("/", ".")
            if not (record / "seconds.json").exists():
                self._record(bench, name, record)
                print(f"recorded {number}/{len(files)}: {name}", flush=True)
            self._records[name] = record
            self.seconds |= json.loads((record / "seconds.json").read_text(encoding="utf-8"))

    def _record(self, bench: Bench, name: str, record: Path) -> None:
        """Run the quick tests of a file with coverage.py."""
        shutil.rmtree(record, ignore_errors=True)
        (record / "site").mkdir(parents=True)
        (record / "site/sitecustomize.py").write_text(SITE_CODE, encoding="utf-8")
        settings = COVERAGE_SETTINGS.format(source=self._package, data=record / "lines")
        (record / "coveragerc").write_text(settings, encoding="utf-8")
        os.environ["COVERAGE_PROCESS_START"] = str(record / "coveragerc")

        def measure(run: Callable[[Chosen], int]) -> tuple[int, str]:
            import coverage

            sys.path.insert(1, str(record / "site"))
            os.environ["PYTHONPATH"] += os.pathsep + str(record / "site")
            measured = coverage.Coverage(config_file=str(record / "coveragerc"))
            measured.start()
            plugin = ContextPerTest(measured)
            status = run(plugin)
            measured.stop()
            measured.save()
            seconds = json.dumps(plugin.seconds)
            (record / "seconds.json").write_text(seconds, encoding="utf-8")
            return status, ""

        bench.run(["-m", "not slow", name], math.inf, measure)
        del os.environ["COVERAGE_PROCESS_START"]
        parts = [str(path) for path in record.glob("lines.*")]
        if parts:
            import coverage

            whole = coverage.Coverage(config_file=False, data_file=str(record / "lines"))
            whole.combine(parts)
            whole.save()
        if not (record / "seconds.json").exists():  # the process of the tests was ended
            (record / "seconds.json").write_text("{}", encoding="utf-8")

    def executing_tests(self, statements: Mapping[str, set[int]]) -> set[str]:
        """Return the quick tests that execute a line of {file: lines}."""
        import coverage

        found: set[str] = set()
        root = self._package.parent
        for record in self._records.values():
            if not (record / "lines").exists():
                continue
            data = coverage.CoverageData(str(record / "lines"))
            data.read()
            for file, lines in statements.items():
                contexts = data.contexts_by_lineno(str(root / file))
                for line in lines:
                    found.update(contexts.get(line, ()))
        names = {name.rpartition("|")[2].rpartition(" (")[0] or name for name in found}
        return (found | names) & self.seconds.keys()


class Bench:
    """Copy of the repository in which faults are planted.

    Args:
        folder: Folder of the copy; replaced if it exists.
    """

    def __init__(self, folder: Path) -> None:
        os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
        sys.dont_write_bytecode = False
        self.folder = folder
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

    def passes(self, test: str) -> bool:
        """Return whether a test passes without a fault; each test runs once.

        True if the file of the test does not exist, for example for "timeout".
        """
        if test not in self._passing:
            file = test.partition("::")[0]
            if not (self.folder / file).exists():  # "timeout", for example
                return True
            only = [test] if "::" in test else None
            self._passing[test] = self.run([file], math.inf, stop_at_failure(only)) == ""
        return self._passing[test]

    @contextmanager
    def plant(self, fault: Fault) -> Iterator[None]:
        """Change the faulty text in the copy during the context.

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
            yield
        finally:
            path.write_text(source, encoding="utf-8")
            os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))

    def run(self, arguments: Sequence[str], limit: float, judge: Judge) -> str:
        """Run pytest in a forked process.

        Args:
            arguments: Files, and options of pytest.
            limit: Upper bound of the processor time [s].
            judge: Called in the process with a function that runs pytest with a plugin; returns
                the exit status, and the name of the failed test.

        Returns:
            The name of the failed test, "timeout", "exit status N" without a failed test, or "" if
            all tests pass.
        """
        with tempfile.TemporaryFile("w+") as result:
            child = os.fork()
            if child == 0:
                self._run_in_child(arguments, limit, judge, result)
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
        self, arguments: Sequence[str], limit: float, judge: Judge, result: IO[str]
    ) -> NoReturn:
        """Run tests in a forked process, write the name of the failed one, and exit."""
        if math.isfinite(limit):
            resource.setrlimit(resource.RLIMIT_CPU, (math.ceil(limit), math.ceil(limit) + 10))
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
        options = ["-n", "0", "-q", "--tb=no", "-p", "no:cacheprovider"]
        options += [f"--timeout={MAX_TEST_SECONDS}", *arguments]
        try:
            pytest = sys.modules["pytest"]
            status, failed = judge(lambda plugin: int(pytest.main(options, [plugin])))
            result.write(failed)
        finally:
            result.flush()
            os._exit(status)


Judge = Callable[[Callable[[Chosen], int]], tuple[int, str]]


def stop_at_failure(tests: Sequence[str] | None) -> Judge:
    """Return a judge that runs chosen tests until one fails; None: all."""

    def judge(run: Callable[[Chosen], int]) -> tuple[int, str]:
        plugin = Chosen(tests)
        return run(plugin), plugin.failed

    return judge


def detecting_test(bench: Bench, fault: Fault, tests: Sequence[str], limit: float) -> str:
    """Return the first of some tests that fails with a fault only; "timeout", or "".

    Tests that fail without the fault, too, are left out.

    Args:
        bench: The copy.
        fault: The fault.
        tests: Names of the tests in the order in which they run.
        limit: Upper bound of the processor time of all tests [s].
    """
    left = list(tests)
    while left:
        files = sorted({name.partition("::")[0] for name in left})
        with bench.plant(fault):
            failed = bench.run(["-x", *files], limit, stop_at_failure(left))
        if not failed or bench.passes(failed):
            return failed
        left = [name for name in left if name != failed and name.partition("::")[0] != failed]
    return ""


def run_fault(
    bench: Bench, fault: Fault, *, tiers: Sequence[str], coverage: Coverage,
    trees: Mapping[str, ast.Module],
) -> tuple[set[str], str, str]:  # fmt: skip
    """Return the tiers that ran for a fault, its outcome, and the test that detects it.

    The outcome is ``killed``, ``survived``, or ``not executed`` if no quick test executes the
    statement and no slow test ran.

    Args:
        bench: The copy.
        fault: The fault.
        tiers: Tiers of ``TIERS``, in the order in which they run.
        coverage: Record of executed lines.
        trees: {file: syntax tree} of all modules of the package.
    """
    module = Path(fault.file).relative_to(PACKAGE)
    near = {
        path.relative_to(bench.folder).as_posix()
        for path in near_tests(module, bench.folder / "tests")
    }
    executing = coverage.executing_tests(executing_statements(fault, trees))
    files = {name.partition("::")[0] for name in executing}
    others = {name for name in coverage.seconds if name.partition("::")[0] in files} - executing
    first = {name for name in executing if name.partition("::")[0] in near}
    chosen = {"near": first, "executing": executing - first, "file": others}
    run: set[str] = set()
    for tier in tiers:
        if tier == "slow":
            with bench.plant(fault):
                limit = PROCESSOR_LIMIT_FACTOR * MAX_TEST_SECONDS
                failed = bench.run(["-x", "-m", "slow", *near], limit, stop_at_failure(None))
            failed = failed if failed and bench.passes(failed) else ""
        else:
            tests = sorted(chosen[tier], key=coverage.seconds.__getitem__)
            total = sum(coverage.seconds[name] for name in tests)
            limit = MIN_PROCESSOR_LIMIT + PROCESSOR_LIMIT_FACTOR * total
            failed = detecting_test(bench, fault, tests, limit)
        run.add(tier)
        if failed:
            return run, "killed", failed
    return run, "survived" if executing or "slow" in run else "not executed", ""


def main() -> int:
    """Plant faults, write the table, and print the counts."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=200, help="number of faults (200)")
    parser.add_argument("--seed", type=int, default=1, help="seed of the choice (1)")
    parser.add_argument("--csv", type=Path, default=PROJECT_FOLDER / "build/mutations.csv")
    parser.add_argument(
        "--tiers", nargs="+", choices=TIERS, default=TIERS[:2],
        help="tests that run, in this order (near, executing)",
    )  # fmt: skip
    parser.add_argument("--again", action="store_true", help="repeat faults that are not killed")
    parser.add_argument("--folder", type=Path, default=PROJECT_FOLDER / "build/mutations")
    parser.add_argument(
        "--lines", type=Path, default=PROJECT_FOLDER / "build/mutations-lines",
        help="folder of the records of executed lines",
    )  # fmt: skip
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
    bench = Bench(given.folder.resolve())
    coverage = Coverage(bench, given.lines.resolve())
    trees = {
        path.relative_to(bench.folder).as_posix(): ast.parse(path.read_text(encoding="utf-8"))
        for path in (bench.folder / PACKAGE).rglob("*.py")
    }
    for number, fault in enumerate(todo, start=1):
        run, outcome, detected_by = run_fault(
            bench, fault, tiers=given.tiers, coverage=coverage, trees=trees
        )
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
