"""Document of a workspace: range of the base in each direction, with planted feet."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from rich.cells import cell_len

from pupper_analysis.base.diagnostics import LANGUAGES, Diagnostic
from pupper_analysis.base.frozen import FrozenDict
from pupper_analysis.present import document as doc
from pupper_analysis.present.colours import BLACK_COLOUR, SKY_BLUE_COLOUR
from pupper_analysis.present.document import get_english, join_words, text
from pupper_analysis.present.documents.loads import view_block
from pupper_analysis.present.documents.registry import build_document
from pupper_analysis.present.documents.standing import quantity_columns, robot_notes, task_text
from pupper_analysis.present.plots import Canvas, draw_result, make_figure_title, make_panels
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.workspace import ANGLE_COORDINATES, BaseWorkspace

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MERGED_NAMES = {
    "workspace-ends-at-joint-limits": "joints",
    "workspace-ends-at-ground": "links",
}
"""{code of a limit of the base workspace: key of the diagnostic's value with joint or link names}.
The names of all directions are listed together.
"""


def _join_limits(workspace: BaseWorkspace) -> doc.Text:
    """Return the reasons why the base cannot move farther, and the directions, as a text.

    The reason that limits most directions comes first.
    """
    limits: dict[tuple[str, object], Diagnostic] = {}
    directions: dict[tuple[str, object], list[str]] = {}
    for direction, ends in workspace.limits.items():
        for limit in ends:
            merged = _MERGED_NAMES.get(limit.code)
            key = limit.code, None if merged else limit.values.get("links")
            if merged and key in limits:
                names = dict.fromkeys((*_list_names(limits[key]), *_list_names(limit)))
                values = FrozenDict({**limit.values, merged: tuple(names)})
                limits[key] = replace(limit, values=values)
            limits.setdefault(key, limit)
            limited = directions.setdefault(key, [])
            if direction not in limited:
                limited.append(direction)
    parts = [
        text(
            "limit-of-directions",
            limit=doc.diagnostic_text(limits[key]),
            directions=join_words(map(text, directions[key])),
        )
        for key in sorted(limits, key=lambda key: -len(directions[key]))
    ]
    short, short_zh = (_abbreviate_limits(workspace, language) for language in LANGUAGES)
    return replace(join_words(parts, "semicolon"), short=short, short_zh=short_zh)


def _abbreviate_limits(workspace: BaseWorkspace, language: str) -> str:
    """Return each kind of limit with the directions, for the short answer, most directions first.

    Names of joints and links are omitted. The result is the first of these forms that is at most
    `_MAX_LIMITS_WIDTHS` wide; the last form may be wider.

    1. Each direction once, with the limits at both ends:
       ``joints (all but x), joints and ground (pitch)``.
    2. The first limit of form 1 at the end, without its directions:
       ``joints and ground (pitch), else joints``.
    3. Each limit with all its directions, the first limit at the end, as in form 2.
    4. The limits without directions.
    """
    by_ends: dict[str, list[str]] = {}
    by_limit: dict[str, list[str]] = {}
    for direction, ends in workspace.limits.items():
        limits = dict.fromkeys(limit.get_short_form(language) for limit in ends)
        at_ends = doc.translate(join_words(map(doc.Name, sorted(limits)), "and"), language)
        by_ends.setdefault(at_ends, []).append(direction)
        for limit in limits:
            by_limit.setdefault(limit, []).append(direction)
    listed = join_words(map(doc.Name, _sort_by_length(by_limit)), "limits-separator")
    forms = (
        _format_limits(workspace, by_ends),
        _format_limits(workspace, by_ends, has_else=True),
        _format_limits(workspace, by_limit, has_else=True),
        text("limits-by-direction", limits=listed),
    )
    printed = [doc.translate(form, language) for form in forms]
    width = _MAX_LIMITS_WIDTHS[language]
    return next((form for form in printed if cell_len(form) <= width), printed[-1])


def _sort_by_length(groups: Mapping[str, Sequence[str]]) -> list[str]:
    """Return the keys of a mapping, longest value first."""
    return sorted(groups, key=lambda name: -len(groups[name]))


def _format_limits(
    workspace: BaseWorkspace, groups: Mapping[str, Sequence[str]], *, has_else: bool = False
) -> doc.Text:
    """Format {limit: directions}, most directions first.

    With ``has_else``, the first of several limits comes last, as ``else``, without directions. The
    directions of a limit are the shorter of their list and ``all but`` the other directions.
    """
    limits = _sort_by_length(groups)
    parts = list[doc.Text]()
    for limit in limits:
        others = [direction for direction in workspace.limits if direction not in groups[limit]]
        listed = join_words(map(text, groups[limit]))
        all_but = text("limit-everywhere", other=join_words(map(text, others)) if others else "")
        directions = min(all_but, listed, key=lambda form: len(form.en))
        parts.append(text("limit-in-directions", limit=limit, directions=directions))
    if has_else and len(limits) > 1:
        parts = [*parts[1:], text("limit-otherwise", limit=limits[0])]
    return join_words(parts, "limits-separator")


_MAX_LIMITS_WIDTHS = {"en": 58, "zh": 74}
"""{language: largest width of all limits in the short answer [columns]}. The words before the
limits take 42 of the 100 columns of a line in English, and 26 in Chinese."""


def _list_names(limit: Diagnostic) -> tuple[str, ...]:
    """Return the names in a limit of the base: joints at a limit, or lowest links."""
    names = limit.values[_MERGED_NAMES[limit.code]]
    return tuple(map(str, names)) if isinstance(names, tuple) else ()


def _format_rounded_range(low: float, high: float) -> str:
    """Return a range of whole mm or degrees for the short answer: ``-40..43``, or ``±40``.

    The ends are rounded to 0.1, then inwards to whole numbers, if possible.
    """
    ends = math.ceil(round(low, 1)), math.floor(round(high, 1))
    first, last = map(str, ends if ends[0] <= ends[1] else (round(low), round(high)))
    return f"±{last}" if first == f"-{last}" else f"{first}..{last}"


def _select_scale(direction: str) -> tuple[float, str]:
    """Return the displayed unit of a direction, and the factor from SI units: mm or degrees."""
    return (math.degrees(1.0), "deg") if direction in ANGLE_COORDINATES else (1e3, "mm")


def _format_ends(workspace: BaseWorkspace, direction: str) -> tuple[doc.Number, doc.Number]:
    """Return both ends of the range of a direction as table cells, in the displayed unit."""
    interval, (scale, _) = workspace.intervals[direction], _select_scale(direction)
    form = ".1f" if direction == "height" else "+.1f"
    low, high = (doc.number_cell(end, form, scale=scale) for end in (interval.low, interval.high))
    return low, high


def _make_row(workspace: BaseWorkspace, direction: str) -> tuple[doc.Cell, ...]:
    """Create the row of a direction: both ends, unit, and the limit at each end."""
    limits = map(doc.diagnostic_text, workspace.limits[direction])
    unit = doc.Name(_select_scale(direction)[1])
    return text(direction), *_format_ends(workspace, direction), unit, *limits


def _describe_range(workspace: BaseWorkspace, direction: str, *, is_last: bool) -> doc.Text:
    """Create the text of the range of a direction; a symmetric range has a single number.

    The short form contains the unit only if the direction ``is_last`` of its unit.
    """
    interval, (scale, unit) = workspace.intervals[direction], _select_scale(direction)
    low, high = (cell.text for cell in _format_ends(workspace, direction))
    values: dict[str, object] = {"low": low, "high": high, "unit": unit, "last": is_last}
    values["ends"] = _format_rounded_range(scale * interval.low, scale * interval.high)
    key = "range-of-direction"
    if high.startswith("+") and low == high.replace("+", "-"):
        key = "symmetric-range-of-direction"
        values["high"] = high.removeprefix("+")
    return text(key, direction=text(direction), **values)


@build_document.register(BaseWorkspace)
def workspace_document(workspace: BaseWorkspace, robot: Robot | None = None) -> doc.Document:
    """Create the report of a base workspace: reachable range of each direction [mm, deg].

    `build_document` calls this function for a `BaseWorkspace`.
    """
    rows: list[tuple[doc.Cell, ...]] = []
    ranges = list[doc.Words]()
    # Lengths come first, since the answer begins with the height.
    for angles in (False, True):
        group = [name for name in workspace.intervals if (name in ANGLE_COORDINATES) == angles]
        rows += [_make_row(workspace, direction) for direction in group]
        if group:
            texts = [
                _describe_range(workspace, direction, is_last=direction == group[-1])
                for direction in group
            ]
            ranges.append(join_words(texts))
    table = doc.Table(
        text("how-far-the-base"),
        (
            *quantity_columns(text("from"), text("to"), of="direction"),
            doc.Column(text("lower-limit"), left=True),
            doc.Column(text("upper-limit"), left=True),
        ),
        tuple(rows),
        (text("of-reach-and-balance-alone"),),
    )
    return doc.Document(
        text("workspace"),
        doc.Name(workspace.name),
        (table, view_block(robot, workspace.start, None)),
        findings=(
            text("range-in-short", ranges=join_words(ranges, "semicolon")),
            *map(doc.diagnostic_text, filter(None, [workspace.missing_masses, workspace.mismatch])),
            text(
                "workspace-limits",
                limits=_join_limits(workspace),
                intersect=workspace.start.task.self_clearance is None,
            ),
        ),
        passed=workspace.passed,
        verdict=text("RANGE" if workspace.passed else "UNKNOWN"),
        details=(task_text(workspace.start.task),),
        brief=True,
        notes=robot_notes(robot),
        next_step=_select_next_step(workspace),
    )


def _select_next_step(workspace: BaseWorkspace) -> doc.NextStep:
    """Return the command to suggest next, by default ``best margin``.

    `audit` if the files do not state all masses, `crosscheck` if the CoMs of both files differ. If
    the base turns to the end of the search, links intersect: `workspace` with a clearance.
    """
    if not workspace.passed:
        return doc.NextStep("audit")
    if workspace.mismatch is not None:
        return doc.NextStep("crosscheck")
    codes = {limit.code for ends in workspace.limits.values() for limit in ends}
    if "workspace-ends-at-full-turn" in codes and workspace.start.task.self_clearance is None:
        return doc.NextStep("workspace", ("--self-clearance", "5mm"))
    return doc.NextStep("best", ("margin",))


@draw_result.register(BaseWorkspace)
def plot_workspace(workspace: BaseWorkspace, _: Robot | None, canvas: Canvas) -> tuple[Axes, ...]:
    """Plot the range of each direction as a bar between both ends, with the limit at each end.

    Lengths [mm] and angles [deg] have a panel each.
    """
    from pupper_analysis.present.figures.drawing import FONT_SIZE, title_panel

    groups = [
        (
            get_english(text(title)),
            unit,
            scale,
            [name for name in workspace.intervals if chosen(name)],
        )
        for title, unit, scale, chosen in (
            ("workspace-lengths", "mm", 1e3, lambda name: name not in ANGLE_COORDINATES),
            ("workspace-angles", "deg", math.degrees(1.0), ANGLE_COORDINATES.__contains__),
        )
    ]
    groups = [group for group in groups if group[-1]]
    rows = [len(names) for *_, names in groups]
    title = get_english(make_figure_title(workspace_document(workspace)))
    height = _ROW_HEIGHT * sum(rows) + _PANEL_HEIGHT * len(rows)
    panels = make_panels(title, height, canvas, rows)
    for axes, (name, unit, scale, directions) in zip(panels, groups, strict=True):
        labels = [get_english(text(direction)) for direction in directions]
        ends = [
            (
                scale * workspace.intervals[direction].low,
                scale * workspace.intervals[direction].high,
            )
            for direction in directions
        ]
        widths = [high - low for low, high in ends]
        axes.barh(labels, widths, left=[low for low, _ in ends], color=SKY_BLUE_COLOUR, height=0.5)
        for row, (direction, pair) in enumerate(zip(directions, ends, strict=True)):
            for end, limit, side in zip(pair, workspace.limits[direction], (-1, 1), strict=True):
                words = f"{end:z.0f} ({doc.diagnostic_text(limit).short})"
                axes.annotate(words, (end, row), xytext=(3 * side, 0), va="center",
                              ha="right" if side < 0 else "left", textcoords="offset points",
                              size=FONT_SIZE - 1, color=BLACK_COLOUR)  # fmt: skip
        axes.use_sticky_edges = False  # otherwise the leftmost bar has no margin
        axes.margins(x=_LABEL_MARGIN)
        axes.invert_yaxis()
        if canvas.axes is None:
            title_panel(axes, "")
        axes.set_xlabel(f"{name} ({unit})", size=FONT_SIZE)
    return panels


_ROW_HEIGHT, _PANEL_HEIGHT = 0.3, 0.7
"""Height of a direction, and of title and axis of a panel [inch]. Chosen, not tuned."""

_LABEL_MARGIN = 0.3
"""Free width on each side of the bars of a panel for the labels of the limits, relative to the
common range of the bars. Chosen, not tuned.
"""
