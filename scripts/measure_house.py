"""Prints of each folder of the package how large it is, and who imports it from outside.

    python scripts/measure_house.py

Code lines are those with a token that is no comment and no docstring. A folder of ``tools`` is a
line of its own.
"""

from __future__ import annotations

import ast
import io
import tokenize
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "pupper_analysis"
NO_CODE = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENCODING,
    tokenize.ENDMARKER,
}


def code_lines(text: str) -> int:
    """Returns how many lines have code: neither blank, nor a comment, nor a docstring."""
    said: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        match node:
            case ast.Expr(ast.Constant(str())):
                said |= set(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    found: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in NO_CODE:
            found |= set(range(token.start[0], token.end[0] + 1))
    return len(found - said)


def place(parts: tuple[str, ...]) -> str:
    """Returns the folder of a module of the package: ``robot``, ``tools/payload``."""
    return "/".join(parts[:2] if parts[0] == "tools" and len(parts) > 2 else parts[:1])


def measure() -> dict[str, tuple[int, int, list[str]]]:
    """Returns {folder: (files, code lines, the folders that import it)}."""
    files: dict[str, int] = defaultdict(int)
    lines: dict[str, int] = defaultdict(int)
    importers: dict[str, set[str]] = defaultdict(set)
    for path in sorted(PACKAGE.glob("*/**/*.py")):
        here = place(path.relative_to(PACKAGE).parts)
        text = path.read_text(encoding="utf-8")
        files[here] += 1
        lines[here] += code_lines(text)
        for node in ast.walk(ast.parse(text)):
            names = []
            if isinstance(node, ast.ImportFrom) and node.module:
                names = [f"{node.module}.{one.name}" for one in node.names]
            elif isinstance(node, ast.Import):
                names = [one.name for one in node.names]
            for name in names:
                parts = tuple(name.split("."))
                if parts[0] == PACKAGE.name and len(parts) > 1:
                    there = place((*parts[1:], "")[:3])
                    if there != here:
                        importers[there].add(here)
    return {one: (files[one], lines[one], sorted(importers[one])) for one in sorted(files)}


def main() -> None:
    """Prints the table."""
    table = measure()
    for folder, (files, lines, importers) in table.items():
        print(f"{folder:20} {files:4} files {lines:6} lines of code  <- {', '.join(importers)}")
    tests = sum(
        len(path.read_text("utf-8").splitlines()) for path in (ROOT / "tests").rglob("*.py")
    )
    print(
        f"all: {sum(one[0] for one in table.values())} files, "
        f"{sum(one[1] for one in table.values())} lines of code; {tests} lines of tests"
    )


if __name__ == "__main__":
    main()
