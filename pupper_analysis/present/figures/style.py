"""What all figures share: sizes, colours, titles, legends, panels, and how they are saved."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from pupper_analysis.base.files import whole_file
from pupper_analysis.base.kinds import GENERATOR, PICTURE
from pupper_analysis.base.provenance import find_provenance

DPI = 180
FONT = 8  # pt

# Okabe and Ito's colours, which the colour-blind can tell apart.
BLUE, ORANGE, GREEN, RED, SKY, BLACK, GREY = (
    "#0072B2",
    "#E69F00",
    "#009E73",
    "#D55E00",
    "#56B4E9",
    "#000000",
    "#6B7280",
)

GRID = "#E3E6EB"
COLOURS = (BLUE, RED, GREEN, ORANGE, SKY, BLACK)

WIDTH = 178 / 25.4
"""A page's text (inch)."""


def page_figure(
    title: str,
    height: float,
    *,
    width: float = WIDTH,
    layout: Literal["constrained"] | None = None,
) -> Figure:
    """Returns an empty figure with a title (inch); ``layout`` is Matplotlib's."""
    figure = Figure(figsize=(width, height), dpi=DPI, layout=layout)
    figure.suptitle(title, x=0.012, ha="left", size=FONT + 2, weight="bold", parse_math=False)
    return figure


def title_panel(axes: Axes, title: str) -> None:
    """Gives a panel its title, and the look of all panels."""
    axes.set_title(title, size=FONT, weight="bold", loc="left", pad=4, parse_math=False)
    axes.tick_params(labelsize=FONT)
    for spine in ("top", "right"):
        axes.spines[spine].set_visible(False)


_CROWDED_LEGEND = 8
"""Entries of a legend that need less room between them to stand in one line."""


def put_legend(figure: Figure, handles: Sequence[Artist], *, columns: int | None = None) -> None:
    """Puts a legend under a figure, in one line or in columns."""
    figure.legend(
        handles=list(handles),
        loc="outside lower center" if figure.get_layout_engine() else "lower center",
        ncols=columns or len(handles),
        fontsize=FONT,
        frameon=False,
        handletextpad=0.5,
        columnspacing=1.4 if len(handles) < _CROWDED_LEGEND else 0.8,
        handlelength=2.0 if len(handles) < _CROWDED_LEGEND else 1.6,
    )


def save_figure(figure: Figure, path: str | Path, *, force: bool = False) -> None:
    """Writes a figure as a PNG, and its folder if need be; no half-written file is ever there.

    Args:
        figure: The figure.
        path: The file.
        force: Replace what is no figure of ours, too.

    Raises:
        OutputError: If the file cannot be written, or is no figure of ours.
    """
    from pupper_analysis import __version__

    FigureCanvasAgg(figure)
    made = {
        "Software": f"{GENERATOR} {__version__}",
        "Source": "\n".join(find_provenance().lines()),
    }
    with whole_file(Path(path), PICTURE, force=force) as file:
        figure.savefig(file, format="png", metadata=made)
