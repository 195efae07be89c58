"""What a fall is: of a base that was seen to move."""

from __future__ import annotations

import copy
import math

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FALLEN_TILT = 0.5
"""A base that leans by more than this against its task has fallen over (rad)."""

SUNKEN = 0.3
"""A base that has lost this share of its height has collapsed: what sags on servos that carry it
loses a tenth (v3 at kp 5: 9 %), what lies on its shanks a half. One that has gained it was thrown
up."""


def lean_between(one: Array, other: Array) -> float:
    """Returns the angle between the verticals of two rotations (3, 3) (rad)."""
    return math.acos(min(1.0, max(-1.0, float(one[2] @ other[2]))))


OWN_SECONDS = 2.0
"""Of a run from a keyframe (s): it drops by a few centimetres, and servos catch it."""

LONGER = 3
"""Times as long, if it still moves then."""

MOVES = 0.02
"""m/s of the base that still moves."""

_DROP = 1.0
"""s in which what hangs in the air has touched the ground: 5 m."""


def height_of_keyframe(
    model: mujoco.MjModel, start: mujoco.MjData, end: mujoco.MjData, base: int
) -> float:
    """Returns the height of a base (m) that a simulation is to keep.

    Many keyframes are in the air, to be dropped from: what is lost until the robot first touches
    the world is none, unless it ends lying on its base.

    Args:
        model: MuJoCo's model.
        start: Of the simulation; it stays as it is, and its commands are kept up.
        end: Of the simulation.
        base: The base's body.
    """
    height, trial = float(start.xpos[base][2]), copy.copy(start)
    if base in _touching(model, end):
        return height
    for _ in range(round(_DROP / model.opt.timestep)):
        mujoco.mj_step(model, trial)
        if _touching(model, trial):
            return min(height, float(trial.xpos[base][2]))
    return height


def _touching(model: mujoco.MjModel, data: mujoco.MjData) -> set[int]:
    """Returns the bodies that touch the world."""
    bodies = model.geom_bodyid[data.contact.geom]
    return set(bodies[(bodies == 0).any(axis=1)].ravel().tolist()) - {0}


def still_moves(model: mujoco.MjModel, data: mujoco.MjData, base: int) -> bool:
    """Tells whether a base has not come to rest."""
    velocity = np.zeros(6)
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_BODY, base, velocity, 0)
    return not float(np.abs(velocity[3:]).max()) <= MOVES


def has_collapsed(leaning: float, start: float, end: float) -> bool:
    """Tells whether a robot has fallen over, sunk on to itself, or was thrown off the ground.

    Args:
        leaning: How far it leans (rad); not a number of what has diverged, like the next two.
        start: Its base's height where it began, above the ground (m).
        end: The same at the end.
    """
    return not (abs(end - start) <= SUNKEN * start and leaning <= FALLEN_TILT)
