"""Draw docs/images/architecture.svg from the code: the folders in layers, and their imports.

    python docs/draw_architecture.py

The layer of a folder follows from the imports: a folder is above all folders that it imports.
Imports are counted with ``ast``, also those within functions. A dot in the row of a folder means
that it imports the folder of that column; the box of a tool lists the other tools that it imports.
"""

from __future__ import annotations

import ast
import json
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from graphlib import TopologicalSorter
from html import unescape
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # matplotlib is imported where it draws: the tests only count imports
    from matplotlib.axes import Axes

PACKAGE = Path(__file__).resolve().parents[1] / "pupper_analysis"
"""Folder of the package."""

PICTURE = Path(__file__).resolve().parent / "images" / "architecture.svg"
"""The picture."""

TOOLS = "tools"
"""Name of the folder of the tools."""

Graph = Mapping[str, Mapping[str, int]]

_MANY, _SOME = 30, 8  # imports of one folder by another that make a large dot, and a middling one
"""Minimum numbers of imports between two folders for a large and a middle-sized dot."""

_BLUE, _PALE, _GREY = "#33567a", "#eaf1f8", "#8e9dae"
"""Colours of lines, boxes and small dots."""

_TOOLS_PER_ROW = 5  # tools in a row
"""Number of tools in a row."""


def iterate_statements(body: Sequence[ast.stmt]) -> Iterator[ast.stmt]:
    """Yield all statements of a block, with those in nested blocks, but no expressions."""
    for statement in body:
        yield statement
        for part in ("body", "orelse", "finalbody", "handlers", "cases"):
            yield from iterate_statements(getattr(statement, part, ()))


@cache
def list_imports(path: Path) -> tuple[tuple[str, ...], ...]:
    """Return the modules of the package that a module imports, as parts, each once."""
    modules = set()
    for node in iterate_statements(ast.parse(path.read_text(encoding="utf-8")).body):
        if isinstance(node, ast.ImportFrom) and node.level == 0:
            names = [alias.name for alias in node.names]
            here = node.module == PACKAGE.name
            modules |= {f"{PACKAGE.name}.{name}" for name in names} if here else {str(node.module)}
        elif isinstance(node, ast.Import):
            modules |= {alias.name for alias in node.names}
    parts = (module.split(".") for module in sorted(modules))
    return tuple(
        tuple(rest)
        for package, *rest in parts
        if package == PACKAGE.name and rest and (PACKAGE / rest[0]).is_dir()
    )


def folder_graph() -> dict[str, Counter[str]]:
    """Return {folder: {imported folder: number of imports, one per pair of modules}}."""
    graph: dict[str, Counter[str]] = {}
    for path in sorted(PACKAGE.glob("*/**/*.py")):
        folder = path.relative_to(PACKAGE).parts[0]
        below = (there[0] for there in list_imports(path) if there[0] != folder)
        graph.setdefault(folder, Counter()).update(below)
    return graph


def tool_graph() -> dict[str, list[str]]:
    """Return {tool: other tools that it imports}."""
    graph: dict[str, list[str]] = {}
    for folder in sorted(path.parent for path in (PACKAGE / TOOLS).glob("*/__init__.py")):
        known = {
            there[1]
            for path in folder.rglob("*.py")
            for there in list_imports(path)
            if there[0] == TOOLS and len(there) > 1
        }
        graph[folder.name] = sorted(known - {folder.name})
    return graph


def sort_layers(graph: Graph) -> list[str]:
    """Return the folders from the lowest layer up, each after the folders that it imports.

    Folders without such an order are sorted by the number of folders that import them, then by
    name.

    Raises:
        graphlib.CycleError: If folders import each other.
    """
    sorter = TopologicalSorter(graph)
    sorter.prepare()
    found: list[str] = []
    while sorter.is_active():
        ready = sorter.get_ready()
        found += sorted(
            ready, key=lambda one: (-sum(one in below for below in graph.values()), one)
        )
        sorter.done(*ready)
    return found


def read_purpose(folder: str) -> str:
    """Return the first sentence of the docstring of a folder, without its full stop."""
    text = ast.get_docstring(ast.parse((PACKAGE / folder / "__init__.py").read_text())) or ""
    return re.split(r"\.(?:\s|$)|\n", text)[0]


def collect_facts(graph: Graph, tools: Mapping[str, list[str]]) -> dict[str, object]:
    """Return the content of the picture as JSON, which is embedded in the picture."""
    return {
        "layers": sort_layers(graph),
        "arrows": {folder: dict(sorted(graph[folder].items())) for folder in sorted(graph)},
        "purposes": {folder: read_purpose(folder) for folder in sorted(graph)},
        "tools": tools,
    }


def read_embedded_facts() -> dict[str, object]:
    """Return the content that is embedded in the committed picture."""
    found = re.search(r"<dc:description>(.*?)</dc:description>", PICTURE.read_text(), re.DOTALL)
    if found is None:
        raise ValueError(f"{PICTURE.name} has no description: it was not drawn by this script")
    shown: dict[str, object] = json.loads(unescape(found[1]))
    return shown


def draw_architecture(graph: Graph, tools: Mapping[str, list[str]], path: Path) -> None:
    """Draw the folders with their imports, and the tools."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    order = sort_layers(graph)
    core = [folder for folder in order if folder != TOOLS]
    rows = -(-len(tools) // _TOOLS_PER_ROW)
    # A fixed salt, no date: what has not changed gives the same file, byte for byte.
    settings = {"svg.hashsalt": "architecture", "svg.fonttype": "none", "font.family": "sans-serif"}
    with rc_context(settings):
        height = 0.62 * (len(order) + rows) + 1.9
        figure = Figure(figsize=(12, height))
        FigureCanvasSVG(figure)
        axes = figure.add_axes((0, 0, 1, 1))
        axes.set_axis_off()
        axes.set_xlim(0, 12)
        axes.set_ylim(0, height)
        for index, (name, known) in enumerate(sorted(tools.items())):
            x, y = (
                0.15 + 2.35 * (index % _TOOLS_PER_ROW),
                height - 1.3 - 0.62 * (index // _TOOLS_PER_ROW),
            )
            _draw_box(axes, (x, y), 2.25, name, f"knows {', '.join(known)}" if known else "")
        words = {"fontsize": 11, "verticalalignment": "center"}
        axes.text(0.15, height - 0.35, f"{TOOLS}/", fontweight="bold", **words)
        axes.text(1.0, height - 0.35, read_purpose(TOOLS) if TOOLS in graph else "", **words)
        shown = [*core, *([TOOLS] if TOOLS in graph else [])]
        for row, folder in enumerate(shown):
            y = 0.1 + 0.62 * row
            if folder == TOOLS:
                axes.text(7.0, y + 0.25, f"{TOOLS}/", horizontalalignment="right", **words)
            else:
                _draw_box(axes, (0.15, y), 7.0, f"{folder}/", read_purpose(folder))
            for column, below in enumerate(core):
                if graph[folder].get(below):
                    _draw_dot(axes, (7.5 + 0.42 * column, y + 0.25), graph[folder][below])
        for column, below in enumerate(core):
            place = (7.45 + 0.42 * column, 0.1 + 0.62 * len(shown))
            axes.text(*place, below, fontsize=10, rotation=45, verticalalignment="bottom")
        description = json.dumps(collect_facts(graph, tools), sort_keys=True)
        metadata = {"Date": None, "Title": "Folders of the package", "Description": description}
        figure.savefig(path, metadata=metadata if path.suffix == ".svg" else None)


def _draw_box(axes: Axes, corner: tuple[float, float], width: float, name: str, words: str) -> None:
    """Draw a box with a name and a description."""
    from matplotlib.patches import FancyBboxPatch

    x, y = corner
    style = "round,pad=0,rounding_size=0.08"
    box = FancyBboxPatch(corner, width, 0.5, boxstyle=style, facecolor=_PALE, edgecolor=_BLUE)
    axes.add_patch(box)
    axes.text(x + 0.12, y + 0.35, name, fontsize=11, fontweight="bold", verticalalignment="center")
    axes.text(x + 0.12, y + 0.14, words, fontsize=9, verticalalignment="center")


def _draw_dot(axes: Axes, centre: tuple[float, float], imports: int) -> None:
    """Draw a dot whose size depends on the number of imports."""
    from matplotlib.patches import Circle

    radius = 0.15 if imports >= _MANY else 0.1 if imports >= _SOME else 0.06
    axes.add_patch(Circle(centre, radius, color=_BLUE if imports >= _SOME else _GREY))


if __name__ == "__main__":
    draw_architecture(folder_graph(), tool_graph(), PICTURE)
