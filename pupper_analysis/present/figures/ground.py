"""The ground in a figure in space: its plane, as far as the robot stands on it, and its steps."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from mpl_toolkits.mplot3d.art3d import Poly3DCollection  # type: ignore[import-untyped]
from numpy.typing import NDArray

from pupper_analysis.present.figures.skeleton import BOX_FACES

if TYPE_CHECKING:
    from pupper_analysis.present.scene import StandingScene
    from pupper_analysis.stance.stand import Stand

Array = NDArray[np.float64]

_AROUND = 0.25
"""How far the plane is drawn beyond the feet, in parts of their distance."""

_PLANE, _STEP, _EDGE = "#ECEEF1", "#D5D9DF", "#8A929E"


def ground_corners(stand: Stand) -> Array:
    """Returns the corners (4, 3) of the piece of the ground's plane that is drawn (m)."""
    places = np.array([place[:2] for place in stand.foot_targets.values()])
    low, high = places.min(axis=0), places.max(axis=0)
    margin = _AROUND * float((high - low).max())
    low, high = low - margin, high + margin
    ground = stand.task.ground
    around = [(low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1])]
    return np.array([[x, y, ground.height((x, y))] for x, y in around])


def step_corners(seen: StandingScene) -> list[Array]:
    """Returns the corners (8, 3) of each step's box (m), in the order of ``BOX_FACES``."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    turn = seen.ground.rotation()
    return [step.centre + (signs * step.half) @ turn.T for step in seen.steps]


def draw_ground(axes: Any, stand: Stand, seen: StandingScene) -> None:
    """Draws the plane, where it is no level one, and the steps on it (mm)."""
    if seen.ground.slope:
        corners = [1e3 * ground_corners(stand)]
        axes.add_collection3d(
            Poly3DCollection(
                corners, facecolor=_PLANE, alpha=0.8, edgecolor=_EDGE, lw=0.8, zorder=0
            )
        )
    for box in step_corners(seen):
        faces = [1e3 * box[list(face)] for face in BOX_FACES]
        axes.add_collection3d(
            Poly3DCollection(faces, facecolor=_STEP, alpha=0.8, edgecolor=_EDGE, lw=0.7, zorder=0.5)
        )
