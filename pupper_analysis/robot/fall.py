"""What a fall is: of a robot that was seen to move.

Lengths are measured at a centre of mass, and against how high that is above what carries it: where
a file puts its base's frame (on the ground, below it) says nothing of how large a robot is.
"""

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
"""What has lost this share of its height has collapsed: what sags on servos that carry it
loses a tenth (v3 at kp 5: 9 %), what lies on its shanks a half. One that has gained it was thrown
up."""


def lean_between(one: Array, other: Array) -> float:
    """Returns the angle between the verticals of two rotations (3, 3) (rad)."""
    return math.acos(min(1.0, max(-1.0, float(one[2] @ other[2]))))


OWN_SECONDS = 5.0
"""Of a run from a keyframe (s): it drops by a few centimetres, servos catch it, and what gives way
slowly (a knee whose servo has no force: 2 cm/s after 2 s) has done so."""

_MOST_STEPS = 5000
"""Of such a run: a model of shorter steps is simulated for less time, but not for less than ..."""

_LEAST_SECONDS = 2.0
"""... this (s), in which what falls from its own height lies."""

GONE = 1.0
"""Heights that what stands does not travel: on feet that stay where they are, no robot
gets so far; what slides, rolls or flies does. (Gravity that is sideways moves it 20 m in 2 s.)"""

NUDGE = 1e-3
"""Greatest speed in a nudge, of each coordinate (m/s, rad/s). Equilibria that shake to pieces at
the next touch have basins of 1e-7, and survive 1e-9; those that stand forget 1e-2."""

_DROP = 1.0
"""s in which what hangs in the air has touched the ground: 5 m."""


_LOST = (
    mujoco.mjtWarning.mjWARN_BADQPOS.value,
    mujoco.mjtWarning.mjWARN_BADQVEL.value,
    mujoco.mjtWarning.mjWARN_BADQACC.value,
)
"""What MuJoCo warns of as it resets a state."""


def nudge_velocity(model: mujoco.MjModel) -> Array:
    """Returns velocities (nv,) that nudge everything, base and joints, by ``NUDGE`` at most."""
    # Seeded: the same robot is nudged alike. No mode is orthogonal to what is random.
    nudge = np.random.default_rng(0).uniform(-1.0, 1.0, model.nv)
    return np.asarray(NUDGE * nudge / np.abs(nudge).max(initial=0.5))


def own_seconds(model: mujoco.MjModel) -> float:
    """Returns for how long a run from a keyframe is simulated (s)."""
    affordable = _MOST_STEPS * float(model.opt.timestep)
    return min(OWN_SECONDS, max(_LEAST_SECONDS, affordable))


@dataclass(frozen=True)
class BodyMotion:
    """What became of a robot that was to stay where it was.

    Attributes:
        duration: Of the simulation (s).
        height: Which its centre of mass was to keep, above what carries it (m).
        end_height: Which that has at the end (m).
        lean: Angle between the base's verticals at both ends (rad).
        away: How far the centre of mass has travelled, as seen from above (m).
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
        lost = self.height - self.end_height
        return self.diverged or has_collapsed(self.lean, lost, self.away, self.height)

    @property
    def gone(self) -> bool:
        """Whether it has left the place where it stood, and that is all."""
        stands = not has_collapsed(self.lean, self.height - self.end_height, 0.0, self.height)
        return self.collapses and not self.diverged and stands


def own_motion(
    model: mujoco.MjModel,
    start: mujoco.MjData,
    base: int,
    ground: float,
    advance: Callable[[mujoco.MjData, float], object],
) -> tuple[BodyMotion, mujoco.MjData]:
    """Simulates a keyframe for ``own_seconds``: nudged, nudged the other way, and not at all.

    What a drop leaves on an edge between two falls, or a fall and a stand, goes to one of them by a
    nudge of one sign, and to the other by one of the other: the first run that collapses counts.

    Args:
        model: MuJoCo's model.
        start: The keyframe with its commands; it stays as it is.
        base: The base's body.
        ground: Height of the ground (m).
        advance: Simulates data for some seconds, in place.

    Returns:
        What became of the robot, and the data at the end.
    """
    seconds, before, runs = own_seconds(model), _placed(model, start), []
    for sign in (1.0, -1.0, 0.0):
        data, diverged = copy.copy(start), False
        data.qvel[:] += sign * nudge_velocity(model)
        try:
            advance(data, seconds)
        except mujoco.FatalError:  # a contact of shapes without directions, say
            diverged = True
        kept = _height_to_keep(model, start, data, base, ground)
        moved = body_moved(model, before, data, base, seconds, kept)
        runs.append((replace(moved, diverged=moved.diverged or diverged), data))
        if runs[-1][0].collapses:
            return runs[-1]
    return runs[0]


def held_motion(
    model: mujoco.MjModel,
    start: mujoco.MjData,
    advance: Callable[[mujoco.MjData, float], object],
) -> tuple[BodyMotion, mujoco.MjData]:
    """Simulates what is held in the world, nudged, for ``own_seconds``: it cannot fall."""
    data, seconds = copy.copy(start), own_seconds(model)
    data.qvel[:] += nudge_velocity(model)
    diverged = False
    try:
        advance(data, seconds)
    except mujoco.FatalError:
        diverged = True
    return BodyMotion(seconds, 0.0, 0.0, 0.0, 0.0, diverged or began_anew(data)), data


def began_anew(data: mujoco.MjData) -> bool:
    """Tells whether MuJoCo reset a state on its way, as it does where numbers are no longer any.

    It counts that; the time tells nothing of one that was lost in its first step.
    """
    return any(data.warning[kind].number > 0 for kind in _LOST)


def _placed(model: mujoco.MjModel, data: mujoco.MjData) -> mujoco.MjData:
    """Returns a copy of data that knows where its bodies and their centres of mass are."""
    placed = copy.copy(data)
    mujoco.mj_kinematics(model, placed)
    mujoco.mj_comPos(model, placed)
    return placed


def body_moved(
    model: mujoco.MjModel,
    start: mujoco.MjData,
    end: mujoco.MjData,
    base: int,
    seconds: float,
    kept: tuple[float, float],
) -> BodyMotion:
    """Returns what became of a robot in a simulation.

    Args:
        model: MuJoCo's model.
        start: Of the simulation.
        end: Of the simulation.
        base: The base's body.
        seconds: How long it was to take.
        kept: The height of its centre of mass that it was to keep, and that of what carries it (m).
    """
    first, last = (_placed(model, data) for data in (start, end))
    there, here = first.subtree_com[base], last.subtree_com[base]
    height, floor = kept
    return BodyMotion(
        duration=seconds,
        height=height - floor,
        end_height=float(here[2]) - floor,
        lean=lean_between(first.xmat[base].reshape(3, 3), last.xmat[base].reshape(3, 3)),
        away=horizontal_distance(there, here),
        diverged=began_anew(end),
    )


def _height_to_keep(
    model: mujoco.MjModel, start: mujoco.MjData, end: mujoco.MjData, base: int, ground: float
) -> tuple[float, float]:
    """Returns the height of a centre of mass that a simulation is to keep, and of what carries it.

    Many keyframes are in the air, to be dropped from: what is lost until the robot first touches
    the world is none, unless it ends lying on its base or on what joins its legs to it, or stands
    on no end of a limb.

    Args:
        model: MuJoCo's model.
        start: Of the simulation; it stays as it is, and its commands are kept up.
        end: Of the simulation.
        base: The base's body.
        ground: Of what carries it (m), where it touches nothing in time.
    """
    trial = _placed(model, start)
    height, lies = float(trial.subtree_com[base][2]), _lies(model, end, base)
    for _ in range(round(_DROP / model.opt.timestep)):
        mujoco.mj_step(model, trial)
        touching = _world_contacts(model, trial)
        if touching.any():
            carrier = float(trial.contact.pos[touching, 2].min())
            landed = height if lies else min(height, float(trial.subtree_com[base][2]))
            return landed, carrier
    return height, ground


def _world_contacts(model: mujoco.MjModel, data: mujoco.MjData) -> NDArray[np.bool_]:
    bodies = model.body_weldid[model.geom_bodyid[data.contact.geom]].reshape(-1, 2)
    return np.asarray((bodies == 0).any(axis=1))


def _touching(model: mujoco.MjModel, data: mujoco.MjData) -> set[int]:
    """Returns the bodies that touch the world, each by the one to which it is welded."""
    bodies = model.body_weldid[model.geom_bodyid[data.contact.geom]].reshape(-1, 2)
    return set(bodies[_world_contacts(model, data)].ravel().tolist()) - {0}


def _lies(model: mujoco.MjModel, data: mujoco.MjData, base: int) -> bool:
    """Tells whether a robot touches the world with its base or hips, or with no end of a limb."""
    own, above = int(model.body_weldid[base]), model.body_weldid[model.body_parentid]
    moving = [body for body in range(1, model.nbody) if model.body_weldid[body] == body]
    carrying = {int(above[body]) for body in moving}
    trunk = {own} | {body for body in moving if above[body] == own and body in carrying}
    touching = _touching(model, data)
    return bool(touching & trunk) or (bool(touching) and touching <= carrying)


def horizontal_distance(start: Array, end: Array) -> float:
    """Returns how far a position (3,) is from another, as seen from above (m)."""
    return float(np.linalg.norm((end - start)[:2]))


def has_collapsed(leaning: float, lost: float, away: float, size: float) -> bool:
    """Tells whether a robot has fallen over, sunk on to itself, or left where it stood.

    Args:
        leaning: How far it leans (rad); not a number of what has diverged, like the next two.
        lost: By how much it is lower than it was (m).
        away: How far it has travelled, as seen from above (m).
        size: The height of its centre of mass, where it stood, above what carries it (m).
    """
    upright = abs(lost) <= SUNKEN * size and leaning <= FALLEN_TILT
    return not (upright and away <= GONE * size)
