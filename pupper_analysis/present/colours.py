"""Colours of figures, HTML reports and the live page: one colour per concept.

A colour is a text such as ``#0072B2``: red, green and blue, 0 to 255, as hexadecimal numbers. The
style sheet of the HTML report repeats the colours of series and concepts as custom properties, such
as ``--force``, with lighter colours in the dark theme.
"""

from __future__ import annotations

# Okabe and Ito's colours, which the colour-blind can tell apart.
BLUE_COLOUR = "#0072B2"
"""Blue of Okabe and Ito's palette for colour-blind readers."""
ORANGE_COLOUR = "#E69F00"
"""Orange of Okabe and Ito's palette for colour-blind readers."""
GREEN_COLOUR = "#009E73"
"""Green of Okabe and Ito's palette for colour-blind readers."""
RED_COLOUR = "#D55E00"
"""Red (vermilion) of Okabe and Ito's palette for colour-blind readers."""
SKY_BLUE_COLOUR = "#56B4E9"
"""Light blue of Okabe and Ito's palette for colour-blind readers."""
BLACK_COLOUR = "#000000"
"""Black of Okabe and Ito's palette for colour-blind readers."""
GREY_COLOUR = "#6B7280"
"""Grey of axes, and of lines without another colour."""

# One colour per concept in all figures, in the viewer of the HTML report and in the live page.
FORCE_COLOUR = RED_COLOUR
"""Colour of contact forces."""
COM_COLOUR = GREEN_COLOUR
"""Colour of the centre of mass and its projection."""
SUPPORT_COLOUR = BLUE_COLOUR
"""Colour of the edges of the support polygon."""
FEEDFORWARD_COLOUR = BLUE_COLOUR
"""Colour of a simulation with feed-forward."""
COMMANDS_COLOUR = RED_COLOUR
"""Colour of a simulation with position commands only."""

GRID_COLOUR = "#E3E6EB"
"""Colour of grid lines."""
SERIES_COLOURS = (
    BLUE_COLOUR,
    RED_COLOUR,
    GREEN_COLOUR,
    ORANGE_COLOUR,
    SKY_BLUE_COLOUR,
    BLACK_COLOUR,
)
"""Colours of series, such as the lines of a plot or the legs of a robot, in plotting order."""

PLOT_COLOURS = (BLUE_COLOUR, RED_COLOUR, "#1B1F24", GREEN_COLOUR, "#B0568C", "#8A6D00")
"""Colours of the series ``s0`` to ``s5`` of plots: those of the light theme of the HTML report."""


def split_colour(colour: str) -> tuple[int, int, int]:
    """Convert a colour such as ``#0072B2`` to red, green and blue, 0 to 255."""
    red, green, blue = bytes.fromhex(colour.removeprefix("#"))
    return red, green, blue
