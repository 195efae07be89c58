"""Plots of results with Matplotlib, for notebooks: ``Result.plot`` calls `plot_result`.

The plot of a result type is a function that is registered with ``@draw_result.register``. For other
results, the plots of the document are drawn. Matplotlib is imported at the first plot.
"""

from __future__ import annotations

import reprlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import singledispatch
from importlib import import_module
from typing import TYPE_CHECKING, Any

from pupper_analysis.base.arguments import check_type
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError, PupperAnalysisError
from pupper_analysis.present.document import Document, Name, Plot, get_english
from pupper_analysis.present.documents.registry import load_builder, make_document
from pupper_analysis.robot.robot import Robot

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

SCREEN_DPI = 100
"""Resolution of figures in notebooks [1/inch]: 700 pixels for the width of a page. Chosen, not
tuned.
"""


@dataclass(frozen=True)
class Canvas:
    """Place of a plot: a new figure of ``pyplot``, an existing empty figure, or existing axes.

    Attributes:
        axes: Axes of a plot with a single panel; None to create the axes.
        figure: Figure or subfigure without axes; None to create a figure.
    """

    axes: Axes | None = None
    figure: Figure | SubFigure | None = None

    @classmethod
    def from_arguments(cls, axes: object, figure: object) -> Canvas:
        """Create the canvas of the arguments ``ax`` and ``figure`` of ``Result.plot``.

        Raises:
            ConfigurationError: If an argument has another type, both are given, or the figure has
                axes.
        """
        if axes is None and figure is None:
            return cls()
        from matplotlib.axes import Axes
        from matplotlib.figure import Figure, SubFigure

        check_type("ax", axes, Axes | None)
        check_type("figure", figure, Figure | SubFigure | None)
        if axes is not None and figure is not None:
            raise ConfigurationError("ax", diagnose("plot-in-axes-and-figure"))
        if isinstance(figure, Figure | SubFigure) and figure.axes:
            raise ConfigurationError("figure", diagnose("plot-in-used-figure"))
        return cls(
            axes if isinstance(axes, Axes) else None,
            figure if isinstance(figure, Figure | SubFigure) else None,
        )

    def create_figure(self, **options: Any) -> Figure | SubFigure:
        """Return the figure, or a new figure of ``pyplot`` with `SCREEN_DPI` pixels per inch.

        ``options`` are arguments of ``pyplot.figure``, including ``layout``; ``dpi`` is replaced.
        Of an existing figure, only the layout changes: a figure without a layout gets ``layout``.
        If ``layout`` is None, the layout of the figure is removed, because the plot places its
        panels itself.

        Raises:
            ConfigurationError: If the canvas consists of axes: the plot has several panels.
        """
        if self.axes is not None:
            raise ConfigurationError("ax", diagnose("plot-of-several-axes"))
        if self.figure is None:
            import matplotlib.pyplot as plt

            return plt.figure(**{**options, "dpi": SCREEN_DPI})
        set_layout = getattr(self.figure, "set_layout_engine", None)  # a subfigure has no layout
        if set_layout is not None and options["layout"] is None:
            set_layout("none")
        elif set_layout is not None and self.figure.get_layout_engine() is None:
            set_layout(options["layout"])
        return self.figure

    def add_legend(self, axes: Axes, columns: int) -> None:
        """Add a legend of axes: below the panels of a figure, or inside of existing axes."""
        if self.axes is not None:
            axes.legend(fontsize="small")
            return
        handles, labels = axes.get_legend_handles_labels()
        axes.figure.legend(
            handles, labels, loc="outside lower center", ncols=columns, fontsize="small"
        )


def plot_result(
    result: Any, robot: object = None, *, ax: object = None, figure: object = None
) -> tuple[Axes, ...]:
    """Draw a result, and return the axes of its panels: ``ax``, or axes in ``figure``.

    By default, the figure is a new figure of ``pyplot``.

    Raises:
        ConfigurationError: If the result has no plot, the robot is missing or is no `Robot`, or a
            stand belongs to another robot. Also if ``ax`` or ``figure`` is not valid, or ``ax`` is
            given for a plot with several panels.
        StaticsInfeasibleError: If no contact forces balance a stand that is drawn.
        TypeError: If ``result`` is no result.
    """
    if robot is not None and not isinstance(robot, Robot):
        given = " ".join(reprlib.repr(robot).split())
        raise ConfigurationError("robot", diagnose("plot-of-no-robot", value=given))
    canvas = Canvas.from_arguments(ax, figure)
    import_module("pupper_analysis.present.stand_plots")  # registers its plots

    from pupper_analysis.present.figures.drawing import set_fallback_fonts

    load_builder(type(result))
    panels = draw_result(result, robot, canvas)
    owner = panels[0].get_figure()
    if owner is not None:
        drawn: Artist = owner if canvas.axes is None else canvas.axes
        set_fallback_fonts(owner, drawn)
    return panels


@singledispatch
def draw_result(result: Any, robot: Robot | None, canvas: Canvas) -> tuple[Axes, ...]:
    """Draw the plots of a result's document on a canvas, and return the axes of its panels.

    Raises:
        ConfigurationError: If the document has no plots.
        TypeError: If ``result`` is no result.
    """
    document = make_document(result, robot)
    plots = [block for block in document.blocks if isinstance(block, Plot)]
    if not plots:
        kind = type(result).__name__
        raise ConfigurationError("plot", diagnose("result-without-plot", kind=kind))
    return draw_plots(plots, make_figure_title(document), canvas)


def has_plot(result: Any) -> bool:
    """Return whether `plot_result` draws a result, without drawing.

    True as well if no document is possible without the robot: it may have plots.
    """
    import_module("pupper_analysis.present.stand_plots")  # registers its plots
    load_builder(type(result))
    if draw_result.dispatch(type(result)) is not draw_result.dispatch(object):
        return True
    try:
        document = make_document(result)
    except PupperAnalysisError:  # for example because the document needs the robot
        return True
    return any(isinstance(block, Plot) for block in document.blocks)


def draw_plots(
    plots: Sequence[Plot], title: Name, canvas: Canvas, *, named: bool = True
) -> tuple[Axes, ...]:
    """Draw plots on a canvas, below each other; return the axes of the panels.

    If ``named``, each panel of a figure has the title of its plot.

    Raises:
        ConfigurationError: If the canvas consists of axes, and there are several plots.
    """
    from pupper_analysis.present.figures.drawing import draw_panel, make_plots_figure

    if canvas.axes is not None and len(plots) == 1:
        draw_panel(plots[0], canvas.axes, get_english(title))
        return (canvas.axes,)
    figure = make_plots_figure(
        plots,
        title=title,
        names=[get_english(plot.title) for plot in plots] if named else (),
        max_columns=1,  # half as wide, the words are illegible on a screen
        create=canvas.create_figure,
    )
    return tuple(figure.axes)


def make_figure_title(document: Document) -> Name:
    """Return the title of a result's figure: verdict, name of the robot or files, kind of result.

    For example: ``HOLDS v3: Stance``.
    """
    verdict = "" if document.verdict is None else f"{get_english(document.verdict)} "
    return Name(f"{verdict}{get_english(document.title)}: {get_english(document.kind)}")


def make_joint_title(documents: Sequence[Document]) -> Name:
    """Return the common title of a figure with one or several results of the same kind.

    For example: ``WITHSTANDS v3, FAILS v3-heavy: Pushes``.
    """
    titles = [get_english(make_figure_title(document)) for document in documents]
    ending = f": {get_english(documents[0].kind)}"
    return Name(", ".join(title.removesuffix(ending) for title in titles) + ending)


def make_panels(
    title: str, height: float, canvas: Canvas, rows: Sequence[float] = (1.0,)
) -> tuple[Axes, ...]:
    """Return the axes of panels below each other, with the title of the figure or of the axes.

    ``height`` is the height of a new figure, in inches; ``rows`` are the relative heights of the
    panels.

    Raises:
        ConfigurationError: If the canvas consists of axes, and there are several panels.
    """
    from pupper_analysis.present.figures.drawing import make_page_figure, title_panel

    if canvas.axes is not None and len(rows) == 1:
        title_panel(canvas.axes, title)
        return (canvas.axes,)
    figure = make_page_figure(title, height, layout="constrained", create=canvas.create_figure)
    panels = figure.subplots(len(rows), squeeze=False, height_ratios=rows)[:, 0]
    return tuple(panels)
