"""Print the size of each folder of the package and the folders that import it.

    python scripts/measure_packages.py

A code line contains at least one token that is neither a comment nor part of a docstring. Each
folder of ``tools`` has a line of its own.
"""

from __future__ import annotations

import ast
import io
import tokenize
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "pupper_analysis"
NON_CODE_TOKENS = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENCODING,
    tokenize.ENDMARKER,
}
"""Types of tokens that do not make a line a code line."""


def count_code_lines(text: str) -> int:
    """Count the code lines of a module's text."""
    docstring_lines: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        match node:
            case ast.Expr(ast.Constant(str())):
                docstring_lines |= set(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    token_lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in NON_CODE_TOKENS:
            token_lines |= set(range(token.start[0], token.end[0] + 1))
    return len(token_lines - docstring_lines)


def name_folder(parts: tuple[str, ...]) -> str:
    """Return the folder of a module, for example ``robot`` or ``tools/payload``.

    Args:
        parts: Parts of the module's path or dotted name below the package.
    """
    return "/".join(parts[:2] if parts[0] == "tools" and len(parts) > 2 else parts[:1])


def measure_folders() -> dict[str, tuple[int, int, list[str]]]:
    """Return {folder: (number of files, number of code lines, folders that import it)}."""
    files: dict[str, int] = defaultdict(int)
    lines: dict[str, int] = defaultdict(int)
    importers: dict[str, set[str]] = defaultdict(set)
    for path in sorted(PACKAGE.glob("*/**/*.py")):
        folder = name_folder(path.relative_to(PACKAGE).parts)
        text = path.read_text(encoding="utf-8")
        files[folder] += 1
        lines[folder] += count_code_lines(text)
        for node in ast.walk(ast.parse(text)):
            names = []
            if isinstance(node, ast.ImportFrom) and node.module:
                names = [f"{node.module}.{alias.name}" for alias in node.names]
            elif isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            for name in names:
                parts = tuple(name.split("."))
                if parts[0] == PACKAGE.name and len(parts) > 1:
                    imported = name_folder((*parts[1:], "")[:3])
                    if imported != folder:
                        importers[imported].add(folder)
    return {
        folder: (files[folder], lines[folder], sorted(importers[folder]))
        for folder in sorted(files)
    }


def main() -> None:
    """Print the size and the importing folders of each folder, and the sums of the sizes."""
    table = measure_folders()
    for folder, (files, lines, importers) in table.items():
        print(f"{folder:20} {files:4} files {lines:6} lines of code  <- {', '.join(importers)}")
    tests = sum(
        len(path.read_text("utf-8").splitlines()) for path in (ROOT / "tests").rglob("*.py")
    )
    print(
        f"all: {sum(row[0] for row in table.values())} files, "
        f"{sum(row[1] for row in table.values())} lines of code; {tests} lines of tests"
    )


if __name__ == "__main__":
    main()
