"""What a fall is: of a base that was seen to move."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import dataclass, replace

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

GONE = 1.0
"""Heights of its base that what stands does not travel: on feet that stay where they are, no base
gets so far; what slides, rolls or flies does. (Gravity that is sideways moves it 20 m in 2 s.)"""

LONGER = 3
"""Times as long, if it still moves then."""

MOVES = 1e-3
"""m/s of the base that still moves: what stands is slower than 1e-4 after 2 s; a knee whose servo
has no force gave way at 2e-2, and took the robot down in the second after."""

_DROP = 1.0
"""s in which what hangs in the air has touched the ground: 5 m."""


@dataclass(frozen=True)
class BaseMotion:
    """What became of a base that was to stay where it was.

    Attributes:
        duration: Of the simulation (s).
        height: Which it was to keep, above the ground (m).
        end_height: Which it has at the end (m).
        lean: Angle between its verticals at both ends (rad).
        away: How far it has travelled, as seen from above (m).
        diverged: Whether MuJoCo began anew, as it does where numbers are no longer any.
    """

    duration: float
    height: float
    end_height: float
    lean: float
    away: float
    diverged: bool

    @property
    def collapses(self) -> bool:
        """Whether it has fallen, sunk, left its place or diverged."""
        return self.diverged or has_collapsed(self.lean, self.height, self.end_height, self.away)


def base_motion(
    model: mujoco.MjModel,
    start: mujoco.MjData,
    base: int,
    ground: float,
    advance: Callable[[mujoco.MjData, float], object],
) -> tuple[BaseMotion, mujoco.MjData]:
    """Simulates a keyframe until its base has come to rest, or for ``LONGER * OWN_SECONDS``.

    Args:
        model: MuJoCo's model.
        start: The keyframe with its commands, after ``mj_kinematics``; it stays as it is.
        base: The base's body.
        ground: Height of the ground (m).
        advance: Simulates data for some seconds, in place.

    Returns:
        What became of the base, and the data at the end.
    """
    data, seconds = copy.copy(start), OWN_SECONDS
    try:
        advance(data, seconds)
        if still_moves(model, data, base):
            advance(data, (LONGER - 1) * seconds)
            seconds *= LONGER
    except mujoco.FatalError:  # a contact of shapes without directions, say
        moved = base_moved(model, start, data, base, ground, seconds)
        return replace(moved, diverged=True), data
    height = height_of_keyframe(model, start, data, base)
    return base_moved(model, start, data, base, ground, seconds, height), data


def base_moved(
    model: mujoco.MjModel,
    start: mujoco.MjData,
    end: mujoco.MjData,
    base: int,
    ground: float,
    seconds: float,
    height: float | None = None,
) -> BaseMotion:
    """Returns what became of a base in a simulation.

    Args:
        model: MuJoCo's model.
        start: Of the simulation.
        end: Of the simulation.
        base: The base's body.
        ground: Height of the ground (m).
        seconds: How long it was to take.
        height: Of the base (m) that it was to keep; that of the start by default.
    """
    height = float(start.xpos[base][2]) if height is None else height
    return BaseMotion(
        duration=seconds,
        height=height - ground,
        end_height=float(end.xpos[base][2]) - ground,
        lean=lean_between(start.xmat[base].reshape(3, 3), end.xmat[base].reshape(3, 3)),
        away=horizontal_distance(start.xpos[base], end.xpos[base]),
        # MuJoCo begins anew where numbers are no longer any.
        diverged=not end.time - start.time > seconds - 1.5 * model.opt.timestep,
    )


def height_of_keyframe(
    model: mujoco.MjModel, start: mujoco.MjData, end: mujoco.MjData, base: int
) -> float:
    """Returns the height of a base (m) that a simulation is to keep.

    Many keyframes are in the air, to be dropped from: what is lost until the robot first touches
    the world is none, unless it ends lying on its base or on what joins its legs to it, or stands
    on no end of a limb.

    Args:
        model: MuJoCo's model.
        start: Of the simulation; it stays as it is, and its commands are kept up.
        end: Of the simulation.
        base: The base's body.
    """
    height, trial = float(start.xpos[base][2]), copy.copy(start)
    if _lies(model, end, base):
        return height
    for _ in range(round(_DROP / model.opt.timestep)):
        mujoco.mj_step(model, trial)
        if _touching(model, trial):
            return min(height, float(trial.xpos[base][2]))
    return height


def _touching(model: mujoco.MjModel, data: mujoco.MjData) -> set[int]:
    """Returns the bodies that touch the world, each by the one to which it is welded."""
    bodies = model.body_weldid[model.geom_bodyid[data.contact.geom]]
    return set(bodies[(bodies == 0).any(axis=1)].ravel().tolist()) - {0}


def _lies(model: mujoco.MjModel, data: mujoco.MjData, base: int) -> bool:
    """Tells whether a robot touches the world with its base or hips, or with no end of a limb."""
    own, above = int(model.body_weldid[base]), model.body_weldid[model.body_parentid]
    moving = [body for body in range(1, model.nbody) if model.body_weldid[body] == body]
    carrying = {int(above[body]) for body in moving}
    trunk = {own} | {body for body in moving if above[body] == own and body in carrying}
    touching = _touching(model, data)
    return bool(touching & trunk) or (bool(touching) and touching <= carrying)


def still_moves(model: mujoco.MjModel, data: mujoco.MjData, base: int) -> bool:
    """Tells whether a base has not come to rest."""
    velocity = np.zeros(6)
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_BODY, base, velocity, 0)
    return not float(np.abs(velocity[3:]).max()) <= MOVES


def horizontal_distance(start: Array, end: Array) -> float:
    """Returns how far a position (3,) is from another, as seen from above (m)."""
    return float(np.linalg.norm((end - start)[:2]))


def has_collapsed(leaning: float, start: float, end: float, away: float) -> bool:
    """Tells whether a robot has fallen over, sunk on to itself, or left where it stood.

    Args:
        leaning: How far it leans (rad); not a number of what has diverged, like the next three.
        start: Its base's height where it began, above the ground (m).
        end: The same at the end.
        away: How far its base has travelled, as seen from above (m).
    """
    upright = abs(end - start) <= SUNKEN * start and leaning <= FALLEN_TILT
    return not (upright and away <= GONE * start)
