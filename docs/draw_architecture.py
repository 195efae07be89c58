"""Draws docs/images/architecture.svg from the code: the rooms by floor, and who imports whom.

    python docs/draw_architecture.py

A room is a folder of the package. Its floor follows from the imports: a room stands one floor above
the highest room that it imports. Imports are counted by ``ast``, so that those within functions
count too. The modules at the package's top (errors, results, ...) serve all rooms and are one box.
"""

from __future__ import annotations

import ast
import json
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from graphlib import TopologicalSorter
from html import unescape
from pathlib import Path

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

PACKAGE = Path(__file__).resolve().parents[1] / "pupper_analysis"
PICTURE = Path(__file__).resolve().parent / "images" / "architecture.svg"

SHARED = "shared"
"""What the modules at the package's top are called together."""

_WIDTH, _HEIGHT = 5.9, 0.62  # of a room
_COLUMN, _FLOOR = 7.2, 1.0  # from room to room, and from floor to floor
_MANY = 10  # imports of one room by another that make a thick arrow


def imported(path: Path) -> Iterator[str]:
    """Yields the rooms from which a module imports something, once for each module there."""
    modules = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.level == 0:
            names = [alias.name for alias in node.names]
            here = node.module == PACKAGE.name
            modules |= {f"{PACKAGE.name}.{name}" for name in names} if here else {str(node.module)}
        elif isinstance(node, ast.Import):
            modules |= {alias.name for alias in node.names}
    for module in modules:
        package, *rest = module.split(".")
        if package == PACKAGE.name and rest:
            yield _room(rest[0]) if (PACKAGE / rest[0]).is_dir() else SHARED


def _room(folder: str) -> str:
    return SHARED if folder == "diagnostics" else folder  # which errors use


def room_graph() -> dict[str, Counter[str]]:
    """Returns {room: {room that it imports: number of imports, one per pair of modules}}."""
    graph: dict[str, Counter[str]] = {SHARED: Counter()}
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE).parts
        if parts[0] in ("__init__.py", "__main__.py"):  # the door: it names what all rooms have
            continue
        room = _room(parts[0]) if len(parts) > 1 else SHARED
        graph.setdefault(room, Counter()).update(there for there in imported(path) if there != room)
    return graph


def floors(graph: Mapping[str, Mapping[str, int]]) -> dict[str, int]:
    """Returns {room: floor}, 0 for those that import none.

    Raises:
        graphlib.CycleError: If rooms import each other.
    """
    floor: dict[str, int] = {}
    for room in TopologicalSorter(graph).static_order():
        floor[room] = 1 + max((floor[below] for below in graph[room]), default=-1)
    return floor


def purpose(room: str) -> str:
    """Returns the first sentence of a room's docstring, without its full stop."""
    if room == SHARED:
        parts = [*PACKAGE.glob("*.py"), *PACKAGE.glob("diagnostics")]
        return ", ".join(sorted(p.stem for p in parts if not p.stem.startswith("_")))
    text = ast.get_docstring(ast.parse((PACKAGE / room / "__init__.py").read_text())) or ""
    return text.splitlines()[0].removesuffix(".")


def facts(graph: Mapping[str, Mapping[str, int]]) -> dict[str, object]:
    """Returns what the picture shows, as JSON has it; it is embedded in the picture."""
    return {
        "floors": dict(sorted(floors(graph).items())),
        "arrows": {room: sorted(graph[room]) for room in sorted(graph)},
        "purposes": {room: purpose(room) for room in sorted(graph)},
    }


def embedded() -> dict[str, object]:
    """Returns what the committed picture shows."""
    found = re.search(r"<dc:description>(.*?)</dc:description>", PICTURE.read_text(), re.DOTALL)
    if found is None:
        raise ValueError(f"{PICTURE.name} has no description: it was not drawn by this script")
    shown: dict[str, object] = json.loads(unescape(found[1]))
    return shown


LEGEND = f"""Arrows point to what is imported.
thick: {_MANY} imports or more
grey: past a room that imports it too
All rooms import the package's top:
these arrows are left out."""


def places(floor: Mapping[str, int]) -> dict[str, tuple[float, float]]:
    """Returns the centre of each room: those of one floor side by side, in order of their names.

    The last of a floor is in the first column, where what is above and below it is.
    """
    centres: dict[str, tuple[float, float]] = {}
    for room in sorted(floor, reverse=True):
        column = sum(floor[other] == floor[room] for other in centres)
        centres[room] = (column * _COLUMN, floor[room] * _FLOOR)
    return centres


def needed(graph: Mapping[str, Mapping[str, int]], room: str, below: str) -> bool:
    """Says whether an arrow is the only way down from a room to another."""
    return not any(
        below in _all_below(graph, between) for between in graph[room] if between != below
    )


def _all_below(graph: Mapping[str, Mapping[str, int]], room: str) -> set[str]:
    return set(graph[room]).union(*(_all_below(graph, below) for below in graph[room]))


def draw(graph: Mapping[str, Mapping[str, int]], path: Path) -> None:
    """Draws the rooms, and the arrows from each to those that it imports."""
    floor = floors(graph)
    centres = places(floor)
    # A fixed salt, no date: what has not changed gives the same file, byte for byte.
    settings = {"svg.hashsalt": "architecture", "svg.fonttype": "none", "font.family": "sans-serif"}
    with rc_context(settings):
        figure = Figure(figsize=(11.5, 8.6))
        FigureCanvasSVG(figure)
        axes = figure.add_axes((0, 0, 1, 1))
        axes.set_axis_off()
        axes.set_xlim(-_WIDTH / 2 - 2.6, _COLUMN + _WIDTH / 2 + 0.2)
        axes.set_ylim(-0.5, max(floor.values()) * _FLOOR + 0.6)
        for room, centre in centres.items():
            _box(axes, room, centre)
            for rank, below in enumerate(sorted(graph[room], key=lambda other: -floor[other])):
                if below != SHARED:
                    only = needed(graph, room, below)
                    _arrow(axes, centre, centres[below], graph[room][below], rank, only)
        axes.text(_COLUMN - _WIDTH / 2, 0.5, LEGEND, fontsize=9, verticalalignment="center")
        description = json.dumps(facts(graph), sort_keys=True)
        metadata = {"Date": None, "Title": "Rooms of the package", "Description": description}
        figure.savefig(path, metadata=metadata if path.suffix == ".svg" else None)


def _box(axes: Axes, room: str, centre: tuple[float, float]) -> None:
    x, y = centre
    corner = (x - _WIDTH / 2, y - _HEIGHT / 2)
    style = "round,pad=0,rounding_size=0.08"
    box = FancyBboxPatch(
        corner, _WIDTH, _HEIGHT, boxstyle=style, facecolor="#eaf1f8", edgecolor="#33567a", zorder=3
    )
    axes.add_patch(box)
    name = "the package's top" if room == SHARED else f"{room}/"
    text = {"horizontalalignment": "center", "verticalalignment": "center", "zorder": 4}
    axes.text(x, y + 0.13, name, fontsize=12, fontweight="bold", **text)
    axes.text(x, y - 0.15, purpose(room), fontsize=8.5, **text)


def _arrow(
    axes: Axes,
    start: tuple[float, float],
    end: tuple[float, float],
    imports: int,
    rank: int,
    only: bool,
) -> None:
    """Draws an arrow: down to the next floor, past others on the left, or to another column."""
    same = start[0] == end[0]
    down = start[1] - end[1]
    if same and down > 1.5 * _FLOOR:
        side = start[0] - _WIDTH / 2
        # Arrows leave a room one below the other, and arrive above those from further up.
        tail = (side, start[1] + 0.2 - 0.06 * rank)
        tip = (side, end[1] + 0.25 - 0.05 * down)
        bend = f"arc3,rad={0.26 + 0.008 * down:.3f}"
    elif same:
        tail, tip = (start[0], start[1] - _HEIGHT / 2), (end[0], end[1] + _HEIGHT / 2)
        bend = "arc3,rad=0"
    elif start[0] < end[0]:  # to the next column, from above: the furthest goes furthest out
        tail = (start[0] + _WIDTH / 2, start[1])
        tip = (end[0] + (down - 3 * _FLOOR) * 0.25 * _FLOOR, end[1] + _HEIGHT / 2)
        bend = "arc3,rad=-0.2"
    else:
        tail = (start[0] - 1.5 + 0.5 * down, start[1] - _HEIGHT / 2)
        tip = (end[0] + _WIDTH / 2, end[1])
        bend = "arc3,rad=-0.2"
    arrow = FancyArrowPatch(
        tail,
        tip,
        connectionstyle=bend,
        arrowstyle="-|>",
        mutation_scale=11,
        linewidth=2.2 if imports >= _MANY else 1.0,
        color="#33567a" if only else "#8e9dae",
        zorder=2 if only else 1,
        shrinkA=0,
        shrinkB=0,
    )
    axes.add_patch(arrow)


if __name__ == "__main__":
    draw(room_graph(), PICTURE)
