"""What colour says how hard a motor works: blue, yellow, red, which all eyes tell apart."""

from __future__ import annotations

import math
from itertools import pairwise

from pupper_analysis.tools.live.shapes import Colour

SCALE: tuple[tuple[float, Colour], ...] = (
    (0.0, (52, 108, 176)),
    (0.25, (120, 170, 214)),
    (0.5, (250, 214, 90)),
    (0.75, (240, 138, 52)),
    (1.0, (208, 28, 40)),
)
"""Parts of a motor's limit, and their colours."""

BEYOND: Colour = (138, 0, 110)
"""Above the limit."""

UNLIMITED: Colour = (150, 150, 150)
"""Of a motor without a limit."""


def colour_of(utilisation: float | None) -> Colour:
    """Returns the colour of a motor's utilisation, in parts of its limit; None without a limit."""
    if utilisation is None or not math.isfinite(utilisation):
        return UNLIMITED
    if utilisation > 1.0:
        return BEYOND
    for (low, one), (high, other) in pairwise(SCALE):
        if utilisation <= high:
            share = (utilisation - low) / (high - low)
            red, green, blue = (round(a + share * (b - a)) for a, b in zip(one, other, strict=True))
            return red, green, blue
    return BEYOND


def to_css(colour: Colour) -> str:
    """Returns a colour as pages write it."""
    return f"rgb({colour[0]},{colour[1]},{colour[2]})"
