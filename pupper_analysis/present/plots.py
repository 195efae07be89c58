"""Plots of results in figures of ``pyplot``, for notebooks: ``Result.plot`` calls `plot_result`.

The plot of a result type is a function that is registered with ``@draw_result.register``. For other
results, the plots of the document are drawn. Matplotlib is imported at the first plot.
"""

from __future__ import annotations

import reprlib
from collections.abc import Sequence
from functools import singledispatch
from importlib import import_module
from typing import TYPE_CHECKING, Any

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError, PupperAnalysisError
from pupper_analysis.present.document import Document, Name, Plot, get_english
from pupper_analysis.present.documents.registry import load_builder, make_document
from pupper_analysis.robot.robot import Robot

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SCREEN_DPI = 100
"""Resolution of figures in notebooks [1/inch]: 700 pixels for the width of a page. Chosen, not
tuned.
"""


def plot_result(result: Any, robot: object = None) -> tuple[Axes, ...]:
    """Draw a result in a new figure of ``pyplot``, and return the axes of its panels.

    Raises:
        ConfigurationError: If the result has no plot, the robot is missing or is no `Robot`, or a
            stand belongs to another robot.
        StaticsInfeasibleError: If no contact forces balance a stand that is drawn.
        TypeError: If ``result`` is no result.
    """
    if robot is not None and not isinstance(robot, Robot):
        given = " ".join(reprlib.repr(robot).split())
        raise ConfigurationError("robot", diagnose("plot-of-no-robot", value=given))
    import_module("pupper_analysis.present.stand_plots")  # registers its plots

    from pupper_analysis.present.figures.drawing import set_fallback_fonts

    load_builder(type(result))
    axes = draw_result(result, robot)
    for figure in {axis.get_figure(root=True) for axis in axes}:
        if figure is not None:
            set_fallback_fonts(figure)
    return axes


@singledispatch
def draw_result(result: Any, robot: Robot | None = None) -> tuple[Axes, ...]:
    """Draw the plots of a result's document in a new figure, and return the axes of its panels.

    Raises:
        ConfigurationError: If the document has no plots.
        TypeError: If ``result`` is no result.
    """
    document = make_document(result, robot)
    plots = [block for block in document.blocks if isinstance(block, Plot)]
    if not plots:
        kind = type(result).__name__
        raise ConfigurationError("plot", diagnose("result-without-plot", kind=kind))
    return draw_plots(plots, make_figure_title(document))


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


def draw_plots(plots: Sequence[Plot], title: Name) -> tuple[Axes, ...]:
    """Draw plots below each other in a new figure of ``pyplot``; return the axes of the panels."""
    from pupper_analysis.present.figures.drawing import make_plots_figure

    figure = make_plots_figure(
        plots,
        title=title,
        names=[get_english(plot.title) for plot in plots],
        max_columns=1,  # half as wide, the words are illegible on a screen
        create=create_figure,
    )
    return tuple(figure.axes)


def make_figure_title(document: Document) -> Name:
    """Return the title of a result's figure: verdict, name of the robot or files, kind of result.

    For example: ``HOLDS v3: Stance``.
    """
    verdict = "" if document.verdict is None else f"{get_english(document.verdict)} "
    return Name(f"{verdict}{get_english(document.title)}: {get_english(document.kind)}")


def make_joint_title(documents: Sequence[Document]) -> Name:
    """Return the title of a figure with several results of the same kind, or with a single result.

    For example: ``WITHSTANDS v3, FAILS v3-heavy: Pushes``.
    """
    titles = [get_english(make_figure_title(document)) for document in documents]
    ending = f": {get_english(documents[0].kind)}"
    return Name(", ".join(title.removesuffix(ending) for title in titles) + ending)


def make_axes(title: str, height: float) -> Axes:
    """Create a new figure of ``pyplot``, as wide as a page, with a single panel; return its axes.

    ``height`` is in inches.
    """
    from pupper_analysis.present.figures.drawing import make_page_figure

    figure = make_page_figure(title, height, layout="constrained", create=create_figure)
    return figure.add_subplot()


def create_figure(**options: Any) -> Figure:
    """Create a figure of ``pyplot``, which notebooks show, with `SCREEN_DPI` pixels per inch.

    ``options`` are arguments of ``pyplot.figure``; ``dpi`` is replaced.
    """
    import matplotlib.pyplot as plt

    return plt.figure(**{**options, "dpi": SCREEN_DPI})
