"""Draw plots as PNG files with Matplotlib, from the SVG elements of the HTML page.

``html.plots`` converts a plot to lines, points and words in CSS pixels. This module draws these
elements in panels of a Matplotlib figure, so that page and PNG show the same plot. The module also
contains parts that other figures share.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib import font_manager
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon, Rectangle
from matplotlib.text import Text

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.files import write_atomically
from pupper_analysis.base.kinds import GENERATOR_NAME, PICTURE_KIND
from pupper_analysis.base.provenance import collect_provenance
from pupper_analysis.present.colours import (
    BLACK_COLOUR,
    BLUE_COLOUR,
    GREY_COLOUR,
    GRID_COLOUR,
    PLOT_COLOURS,
    RED_COLOUR,
    SKY_BLUE_COLOUR,
)
from pupper_analysis.present.document import LinePlot, Plot, Words, get_english
from pupper_analysis.present.html.plots import (
    AREA_CLASS,
    DOT_RADIUS,
    MARKED_DOT_RADIUS,
    REFERENCE_CLASS,
    Drawing,
    Mark,
    draw_svg,
    select_styles,
)

FIGURE_DPI = 180
"""Resolution of figures in PNG files [pixels per inch]. Chosen, not tuned."""
FONT_SIZE = 8
"""Base font size of figures [pt]. Chosen, not tuned."""

TITLE_PLACE = 0.006
"""Left end of the title of a figure [1], relative to the width of the figure. Chosen, not tuned."""

PAGE_WIDTH = 178 / 25.4
"""Width of a figure [inch]: the text width of a printed page, 178 mm."""

_CLASS_COLOURS = {
    **{f"s{index}": colour for index, colour in enumerate(PLOT_COLOURS)},
    "bar": SKY_BLUE_COLOUR,
    "other": BLACK_COLOUR,
    "limit": RED_COLOUR,
    "axis": GREY_COLOUR,
    REFERENCE_CLASS: GREY_COLOUR,
    "grid": GRID_COLOUR,
    "empty": "0.93",
}
"""{class of the HTML report's style sheet: colour in Matplotlib of a mark with this class}."""

_AREA_STYLE: dict[str, Any] = {"facecolor": BLUE_COLOUR, "alpha": 0.14, "lw": 0}
"""Options of Matplotlib for a shaded area."""

_CLASS_DASHES = {"s1": (0, (8, 3)), "s2": (0, (2, 3)), "s3": (0, (12, 3, 2, 3)), "s4": (0, (5, 2)),
           "s5": (0, (1, 2)), "limit": (0, (3, 2)), REFERENCE_CLASS: (0, (6, 3))}  # fmt: skip
"""{class of the HTML report's style sheet: line style of a mark in Matplotlib}."""
_CLASS_MARKERS = {"s1": "s", "s2": "^", "s3": "D", "s4": "v", "s5": "P"}
"""{class of the HTML report's style sheet: shape of points in Matplotlib}; ``s0`` has circles."""
_DOT_ZORDER = 3.0
"""Order in which Matplotlib draws a point: after all lines (`_LINE_ZORDER`)."""
_GRID_ZORDER = 0.5
"""Order in which Matplotlib draws a grid line: before bars, which have 1."""
_LINE_ZORDER = 2.0
"""Order in which Matplotlib draws other lines; the default of Matplotlib."""
_TICK_CLASSES = ("other", "limit")
"""Classes of the HTML report's style sheet for the marks of a bar that are upright ticks."""
_CLASS_WIDTHS = {"limit": 1.6, "other": 2.0}
"""{class of the HTML report's style sheet: line width of a mark [pt]}. Other classes have the
default width.
"""
_TEXT_ALIGNMENTS = {"start": "left", "middle": "center", "end": "right"}
"""{text anchor of SVG: horizontal alignment of Matplotlib}."""

_LETTER_HEIGHT = 12.0
"""Font size of the plots in HTML reports [CSS pixels]."""

_NUM_COLUMNS = 2
"""Default of the largest number of panels in a row of a figure. Chosen, not tuned."""


def write_plots(
    plots: Sequence[Plot],
    path: str | Path,
    *,
    title: Words | None = None,
    names: Sequence[str] = (),
    max_columns: int = _NUM_COLUMNS,
) -> None:
    """Write plots as a PNG file: a figure with a panel per plot.

    Args:
        plots: Plots.
        path: PNG file.
        title: Title of the figure. Default: the title of the first plot.
        names: Title of each panel. Default: the titles of the plots, if there are several.
        max_columns: Largest number of panels in a row.

    Raises:
        ConfigurationError: If there is no plot.
        OutputError: If the file cannot be written, or is an existing file of another kind.
    """
    if not plots:
        raise ConfigurationError("plots", diagnose("no-robot-to-draw"))
    figure = make_plots_figure(plots, title=title, names=names, max_columns=max_columns)
    assert isinstance(figure, Figure)
    save_figure(figure, path)


def make_plots_figure(
    plots: Sequence[Plot],
    *,
    title: Words | None = None,
    names: Sequence[str] = (),
    max_columns: int = _NUM_COLUMNS,
    create: Callable[..., Figure | SubFigure] = Figure,
) -> Figure | SubFigure:
    """Draw plots in a figure with a panel per plot.

    Default of ``title``: the title of the first plot. Default of ``names``, the titles of the
    panels: the titles of the plots, if there are several. ``create`` returns an empty figure, as
    ``pyplot.figure`` does.
    """
    drawings = [draw_svg(plot) for plot in plots]
    columns = min(len(plots), max_columns)
    rows = [drawings[at : at + columns] for at in range(0, len(drawings), columns)]
    heights = [max(drawing.height / drawing.width for drawing in row) for row in rows]
    across, several = PAGE_WIDTH / columns, bool(names or len(plots) > 1)
    sizes = [_LETTER_HEIGHT * 72 * across / drawing.width for drawing in drawings]
    legends = [_make_legend(drawing) for drawing in drawings]
    legend_columns = [
        _count_legend_columns(drawing, size / (72 * across))
        for drawing, size in zip(drawings, sizes, strict=True)
    ]
    legend_lines = [
        -(-len(legend) // count) for legend, count in zip(legends, legend_columns, strict=True)
    ]
    row_lines = [max(legend_lines[at : at + columns]) for at in range(0, len(drawings), columns)]
    extra_height = 0.4 + sum(0.15 * several + 0.19 * lines for lines in row_lines)
    figure = make_page_figure(
        get_english(title or plots[0].title),
        across * sum(heights) + extra_height,
        layout="constrained",
        create=create,
    )
    grid = figure.add_gridspec(len(rows), columns, height_ratios=heights)
    titles = names or [get_english(drawing.title) if several else "" for drawing in drawings]
    for index, (drawing, legend, name) in enumerate(zip(drawings, legends, titles, strict=True)):
        axes = figure.add_subplot(grid[divmod(index, columns)])
        _draw_marks(drawing, axes, sizes[index])
        title_panel(axes, name)
        _add_panel_legend(axes, legend, legend_columns[index], sizes[index])
    return figure


def draw_panel(plot: Plot, axes: Axes, title: str) -> None:
    """Draw a plot in existing axes, with a title.

    Lines are in the units of the data, so that further data can be drawn in the axes. The
    coordinates of a bar plot are CSS pixels; its letters fit the present size of the axes.
    """
    drawing, size = draw_svg(plot), float(FONT_SIZE)
    if isinstance(plot, LinePlot):
        _draw_lines(plot, axes)
    else:
        figure, extent = axes.get_figure(root=True), axes.get_window_extent()
        assert figure is not None
        scale = min(extent.width / drawing.width, extent.height / drawing.height)
        size = _LETTER_HEIGHT * 72 * scale / figure.dpi
        _draw_marks(drawing, axes, size)
    title_panel(axes, title)
    if isinstance(plot, LinePlot):
        if legend := _make_legend(drawing):
            for entry in axes.legend(handles=legend, fontsize=size).get_texts():
                entry.set_parse_math(False)
    else:
        columns = _count_legend_columns(drawing, _LETTER_HEIGHT / drawing.width)
        _add_panel_legend(axes, _make_legend(drawing), columns, size)


def _draw_lines(plot: LinePlot, axes: Axes) -> None:
    """Draw the series of a line plot in axes with the units of the data."""
    for series, style in zip(plot.series, select_styles(plot.series), strict=True):
        points = np.column_stack([np.asarray(series.x, float), np.asarray(series.y, float)])
        finite = np.isfinite(points).all(axis=1)
        x, y = points[finite].T
        if series.shaded:
            axes.fill(x, y, **_AREA_STYLE, zorder=_GRID_ZORDER)
            continue
        axes.plot(x, y, **_make_line_style(style, 1.3))
        for index in np.flatnonzero(finite) if series.points else []:
            radius = MARKED_DOT_RADIUS if index == series.marked_index else DOT_RADIUS
            diameter = 2 * radius * FONT_SIZE / _LETTER_HEIGHT
            axes.plot(*points[index], ls="", ms=diameter, zorder=_DOT_ZORDER, **_make_dot(style))
    for name, axis in (("x", plot.x), ("y", plot.y)):
        unit = f" ({axis.unit})" if axis.unit else ""
        axes.set(**{f"{name}label": f"{get_english(axis.name)}{unit}"})
        if axis.logarithmic:
            axes.set(**{f"{name}scale": "log"})
        elif axis.low is not None:
            axes.set(**{f"{name}lim": (axis.low, None)})
    for label in (axes.xaxis.label, axes.yaxis.label):
        label.set(size=FONT_SIZE, parse_math=False)
    if plot.equal_scales:
        axes.set_aspect("equal", adjustable="datalim")
    axes.grid(color=GRID_COLOUR)
    axes.set_axisbelow(True)


def _add_panel_legend(axes: Axes, legend: list[Artist], columns: int, size: float) -> None:
    """Add a legend with the font size ``size`` [pt] below a panel, if it has entries."""
    if not legend:
        return
    entries = axes.legend(handles=legend, loc="upper center", bbox_to_anchor=(0.5, 0.0),
                          ncols=columns, fontsize=size,
                          frameon=False, handlelength=_LEGEND_LINE_LENGTH)  # fmt: skip
    for entry in entries.get_texts():
        entry.set_parse_math(False)


def _draw_marks(drawing: Drawing, axes: Axes, size: float) -> None:
    """Draw the SVG elements of a report's plot into axes whose unit is the CSS pixel.

    ``size`` is the font size of words [pt].
    """
    axes.set(xlim=(0, drawing.width), ylim=(drawing.height, 0), aspect="equal", anchor="N")
    axes.set_axis_off()
    for mark in drawing.marks:
        kind = mark["class"].split()[-1]
        match mark["tag"]:
            case "rect":
                place, sides = (mark["x"], mark["y"]), (mark["width"], mark["height"])
                fill, opacity = mark.get("fill") or _CLASS_COLOURS[kind], mark.get("opacity", 1.0)
                axes.add_patch(Rectangle(place, *sides, color=fill, alpha=opacity, lw=0))
            case "line":
                axes.plot(
                    [mark["x1"], mark["x2"]],
                    [mark["y1"], mark["y2"]],
                    **_make_line_style(kind, 0.7),
                )
            case "polyline":
                axes.plot(*np.array(mark["points"]).T, **_make_line_style(kind, 1.3))
            case "polygon":
                axes.add_patch(Polygon(mark["points"], **_AREA_STYLE, zorder=_GRID_ZORDER))
            case "dot":
                diameter = 2 * mark["r"] * size / _LETTER_HEIGHT
                place = mark["cx"], mark["cy"]
                axes.plot(*place, ls="", ms=diameter, zorder=_DOT_ZORDER, **_make_dot(kind))
            case "text":
                _write_words(mark, axes, size)
    # All of it is inside the drawing's own frame: laying out need not measure each word.
    for artist in axes.get_children():
        artist.set_in_layout(False)


def _make_dot(kind: str) -> dict[str, Any]:
    """Return the options of Matplotlib for a point: colour, shape, and a white edge."""
    marker = _CLASS_MARKERS.get(kind, "o")
    return {"marker": marker, "color": _CLASS_COLOURS.get(kind, kind), "mec": "white", "mew": 0.5}


def _make_line_style(kind: str, width: float) -> dict[str, Any]:
    """Return the options of Matplotlib for a line: ``color``, ``ls``, ``lw`` [pt] and ``zorder``.

    ``kind`` is a class of the HTML report's style sheet; ``width`` is the default line width [pt].
    """
    colour = _CLASS_COLOURS.get(kind, GREY_COLOUR)
    return {
        "color": colour,
        "ls": _CLASS_DASHES.get(kind, "-"),
        "lw": _CLASS_WIDTHS.get(kind, width),
        "zorder": _GRID_ZORDER if kind == "grid" else _LINE_ZORDER,
    }


def _write_words(mark: Mark, axes: Axes, size: float) -> None:
    """Write a text element of a drawing, and its unit in brackets, with font size ``size`` [pt]."""
    words = get_english(mark["words"]) + (f" ({mark['unit']})" if mark["unit"] else "")
    turned = 90.0 if "transform" in mark else 0.0
    axes.text(mark["x"], mark["y"], words, ha=_TEXT_ALIGNMENTS[mark["anchor"]], rotation=turned,
              rotation_mode="anchor", size=size, parse_math=False)  # fmt: skip


def _collect_legend(drawing: Drawing) -> dict[str, str]:
    """Return the legend of a drawing as {text: class of the style sheet}, with its note (class "").

    A single entry that repeats another text of the drawing, such as the name of an axis, is
    omitted.
    """
    entries = {get_english(words): kind for words, kind in drawing.legend}
    words = {get_english(mark["words"]) for mark in drawing.marks if mark["tag"] == "text"}
    if len(entries) == 1 and words.issuperset(entries):
        entries = {}  # the only entry repeats the name of an axis
    return entries if drawing.note is None else {**entries, get_english(drawing.note): ""}


_LEGEND_LINE_LENGTH = 3.6
"""Length of the line of a legend entry, as a multiple of the font size. Chosen, not tuned."""

_LEGEND_LETTER_WIDTH, _LEGEND_SYMBOL_WIDTH = 0.6, 5.6
"""Mean width of a letter of a legend, and width of a symbol with the gaps, as fractions of the font
size (measured with DejaVu Sans). The widths decide whether two entries fit side by side.
"""


def _count_legend_columns(drawing: Drawing, size: float) -> int:
    """Return the number of columns of a panel's legend: 2 if they fit into the width, else 1.

    ``size`` is the font size, relative to the width of the panel.
    """
    longest = max(map(len, _collect_legend(drawing)), default=0)
    width = 2 * size * (_LEGEND_LETTER_WIDTH * longest + _LEGEND_SYMBOL_WIDTH)
    return 2 if width <= 1 else 1


def _make_legend(drawing: Drawing) -> list[Artist]:
    """Create the entries of a plot's legend; a point without a line has a marker."""
    return [_make_handle(name, kind) for name, kind in _collect_legend(drawing).items()]


def _make_handle(name: str, kind: str) -> Artist:
    """Create a legend entry of Matplotlib: a text with a line, a dot or a patch as symbol.

    ``kind`` is a class of the style sheet, or a colour; empty for a text without a symbol.
    """
    if not kind:
        return Line2D([], [], ls="", label=name)
    if kind.startswith("dot "):
        return Line2D([], [], ls="", label=name, **_make_dot(kind.split()[-1]))
    if kind == AREA_CLASS:
        return Patch(**_AREA_STYLE, label=name)
    if kind in _TICK_CLASSES:  # upright, as drawn
        colour, width = _CLASS_COLOURS[kind], _CLASS_WIDTHS[kind]
        return Line2D([], [], ls="", label=name, marker="|", color=colour, mew=width, ms=9)
    if kind in _CLASS_DASHES or kind == "s0":
        return Line2D([], [], label=name, **_make_line_style(kind, 1.3))
    return Patch(color=_CLASS_COLOURS.get(kind, kind), label=name)


def make_page_figure(
    title: str,
    height: float,
    *,
    layout: Literal["constrained"] | None = None,
    create: Callable[..., Figure | SubFigure] = Figure,
) -> Figure | SubFigure:
    """Create an empty figure with a title, as wide as a page.

    ``height`` is in inches. ``create`` returns an empty figure, as ``pyplot.figure`` does.
    """
    figure = create(figsize=(PAGE_WIDTH, height), dpi=FIGURE_DPI, layout=layout)
    figure.suptitle(
        title, x=TITLE_PLACE, ha="left", size=FONT_SIZE + 2, weight="bold", parse_math=False
    )
    return figure


def title_panel(axes: Axes, title: str) -> None:
    """Set title and tick font size of a panel, and hide the top and right border."""
    axes.set_title(title, size=FONT_SIZE, weight="bold", loc="left", pad=4, parse_math=False)
    axes.tick_params(labelsize=FONT_SIZE)
    for spine in ("top", "right"):
        axes.spines[spine].set_visible(False)


def choose_bar_length(longest: float) -> float:
    """Return the length of a scale bar [m]: 1, 2 or 5 times a power of 10, at most ``longest``."""
    power = 10.0 ** math.floor(math.log10(longest))
    return max(factor * power for factor in (1, 2, 5) if factor * power <= longest)


def shorten_names(names: Sequence[str]) -> list[str]:
    """Remove the parts that all names contain: ``FL`` and ``FR`` for ``FL_foot`` and ``FR_foot``.

    Parts are separated by underscores. The names are returned unchanged if the short names would be
    empty or equal.
    """
    parts = [name.split("_") for name in names]
    short = [
        "_".join(
            part for part in own if part and not all(part in name_parts for name_parts in parts)
        )
        for own in parts
    ]
    return short if all(short) and len({*short}) == len(names) else list(names)


@contextmanager
def silence_missing_letters() -> Iterator[None]:
    """Suppress Matplotlib's warnings about letters that no font contains.

    `set_fallback_fonts` adds a remark to the figure instead.
    """
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing from")
        yield


FALLBACK_FONTS = (
    "Noto Sans CJK SC",
    "Noto Sans SC",
    "Source Han Sans SC",
    "WenQuanYi Zen Hei",
    "WenQuanYi Micro Hei",
    "Microsoft YaHei",
    "SimHei",
    "PingFang SC",
    "Hiragino Sans GB",
    "Arial Unicode MS",
)
"""Fonts with Chinese letters, in order of preference: of Linux, Windows and macOS."""

MISSING_LETTERS_NOTE = "boxes: letters that no font contains; install {font}, for example"
"""Remark in the lower left corner of a figure with letters that are not in any installed font."""


def set_fallback_fonts(figure: Figure | SubFigure, drawn: Artist | None = None) -> None:
    """Select an installed font for letters that are not in the default font, such as Chinese.

    If no font contains the letters, which are then drawn as boxes, a remark is added to the figure.
    ``drawn`` is the part of the figure whose texts are changed; by default all.
    """
    default, *fallbacks = _list_fonts()
    missing = False
    for text in (drawn or figure).findobj(Text):
        letters = {ord(letter) for letter in text.get_text() if letter.isprintable()}
        letters -= default[1]
        if not letters:
            continue
        text.set_fontfamily([name for name, _ in (default, *fallbacks)])
        missing |= any(all(letter not in codes for _, codes in fallbacks) for letter in letters)
    if missing:
        note = MISSING_LETTERS_NOTE.format(font=FALLBACK_FONTS[0])
        figure.text(TITLE_PLACE, 0.002, note, size=_NOTE_SIZE, color=GREY_COLOUR)


_NOTE_SIZE = 5.5
"""Font size of the remark on missing letters [pt]. Chosen, not tuned."""


@cache
def _list_fonts() -> tuple[tuple[str, frozenset[int]], ...]:
    """List (name, Unicode numbers) of the default font and the installed fallback fonts."""
    installed = {entry.name for entry in font_manager.fontManager.ttflist}
    names = ("DejaVu Sans", *(name for name in FALLBACK_FONTS if name in installed))
    fonts = [font_manager.get_font(font_manager.findfont(name)) for name in names]
    return tuple(
        (name, frozenset(font.get_charmap())) for name, font in zip(names, fonts, strict=True)
    )


def cut_long_names(names: Sequence[str], length: int) -> list[str]:
    """Replace the start of long names by an ellipsis, unless the short names would be equal.

    ``length`` is the largest number of letters.
    """
    short = [name if len(name) <= length else f"…{name[1 - length :]}" for name in names]
    return short if len({*short}) == len(short) else list(names)


@silence_missing_letters()
def add_legend(
    figure: Figure | SubFigure, handles: Sequence[Artist], *, outside: bool = False
) -> None:
    """Add a legend with the given symbols at the lower edge of a figure, in as few rows as fit.

    If ``outside`` is True, the constrained layout of the figure reserves the space of the legend.
    """
    for rows in range(1, len(handles) + 1):
        legend = figure.legend(handles=list(handles),
                               loc="outside lower center" if outside else "lower center",
                               ncols=-(-len(handles) // rows), fontsize=FONT_SIZE,
                               frameon=False, handletextpad=0.5, columnspacing=0.8,
                               handlelength=1.6)  # fmt: skip
        for entry in legend.get_texts():
            entry.set_parse_math(False)
        if legend.get_window_extent().width <= figure.bbox.width or rows == len(handles):
            return
        legend.remove()


@silence_missing_letters()
def save_figure(figure: Figure, path: str | Path, *, force: bool = False) -> None:
    """Write a figure as a PNG file atomically, and create a missing folder.

    Args:
        figure: Figure.
        path: PNG file.
        force: True to replace an existing file of any kind, except files that this run reads. If
            False, only an empty file or a picture of this package is replaced.

    Raises:
        OutputError: If the file cannot be written, or if the file exists and must not be replaced.
    """
    from pupper_analysis import __version__

    FigureCanvasAgg(figure)
    set_fallback_fonts(figure)
    made = {
        "Software": f"{GENERATOR_NAME} {__version__}",
        "Source": "\n".join(collect_provenance().lines()),
    }
    with write_atomically(Path(path), PICTURE_KIND, force=force) as file:
        figure.savefig(file, format="png", metadata=made)
