"""Random states to compare models at, and how much of a large robot is compared there."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class States:
    """States and motor torques.

    Attributes:
        qpos: (n, nq).
        qvel: (n, nv).
        torques: (n, nu) (N m).
    """

    qpos: Array
    qvel: Array
    torques: Array


MOST = 100_000
"""Configurations that are compared: more find nothing, and fill the memory."""


def check_states(count: int, seed: int) -> None:
    """Checks what random states are asked for.

    Raises:
        ConfigurationError: If there are none or too many, or the seed is not a whole number from 0.
    """
    if count < 1:
        raise ConfigurationError("configurations", diagnose("less-than", value=count, least=1))
    if count > MOST:
        raise ConfigurationError("configurations", diagnose("more-than", value=count, most=MOST))
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise ConfigurationError("seed", diagnose("no-whole-number", value=repr(seed)))


_LARGEST_ANGLE = 1e3
"""rad or m. Files state limits like 1e16 for none; such an angle has no digit after the point."""

_STRONG = 1e6
"""N m or N. Likewise."""


def random_states(robot: Robot, count: int, seed: int) -> States:
    """Draws states: joints inside their limits, the base anywhere, with velocities and torques."""
    rng = np.random.default_rng(seed)
    lower = np.where(np.isfinite(robot.lower_limits), robot.lower_limits, -np.pi)
    upper = np.where(np.isfinite(robot.upper_limits), robot.upper_limits, np.pi)
    # A file may have them the wrong way round; that is for the comparison to find.
    ends = np.clip(
        [np.minimum(lower, upper), np.maximum(lower, upper)], -_LARGEST_ANGLE, _LARGEST_ANGLE
    )
    qpos = rng.uniform(ends[0], ends[1], (count, robot.nu))
    if robot.floating:
        quaternion = rng.normal(size=(count, 4))
        quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
        qpos = np.concatenate([rng.uniform(-1, 1, (count, 3)), quaternion, qpos], axis=1)
    efforts = np.where(np.isfinite(robot.effort_limits), robot.effort_limits, 1.0)
    efforts = np.clip(efforts, -_STRONG, _STRONG)
    return States(
        qpos=qpos,
        qvel=rng.normal(size=(count, robot.nv)),
        torques=rng.uniform(-np.abs(efforts), np.abs(efforts), (count, robot.nu)),
    )


IntArray = NDArray[np.int64]

MOST_IN_PINOCCHIO: Final = 200
"""Degrees of freedom of the largest robot that is evaluated in Pinocchio.

Pinocchio's data hold four tensors of second derivatives, nv x nv x nv each, that nothing here asks
for: 32 nv^3 bytes, 0.26 GB at 200 and 256 GB at 2000, and as long as it takes to write them.
"""

_STATES: Final = 80e6
"""Bytes of the mass matrices of all states (nv x nv each), one evaluation's; there are five.

A robot of 306 degrees of freedom is compared at 106 states, one of 1000 at 10.
"""

_LEAST_STATES: Final = 2
"""States at which a robot of any size is compared: one may happen to be singular."""

_FRAMES: Final = 100
"""Frames whose Jacobians (3 x nv each) are compared in a large robot."""


def is_large(robot: Robot) -> bool:
    """Says whether a robot is too large for Pinocchio's data."""
    return robot.nv > MOST_IN_PINOCCHIO


def affordable_states(robot: Robot, count: int) -> int:
    """Returns at how many of so many states a robot is compared: all, unless it is large."""
    if not is_large(robot):
        return count
    return min(count, max(_LEAST_STATES, int(_STATES / (8 * robot.nv**2))))


def some_of(robot: Robot, frames: Mapping[str, tuple[str, str]]) -> dict[str, tuple[str, str]]:
    """Returns the frames that are compared in detail: all, unless the robot is large."""
    if not is_large(robot) or len(frames) <= _FRAMES:
        return dict(frames)
    chosen = np.linspace(0, len(frames) - 1, _FRAMES).astype(int)
    names = list(frames)
    return {names[place]: frames[names[place]] for place in chosen}


def size_notes(
    robot: Robot, count: int, frames: Mapping[str, tuple[str, str]]
) -> Iterator[Diagnostic]:
    """Yields what is left out of the comparison of a large robot.

    Args:
        robot: The robot.
        count: The number of states that was asked for.
        frames: All that could be compared.
    """
    if not is_large(robot):
        return
    gigabytes, most = 32e-9 * robot.nv**3, MOST_IN_PINOCCHIO
    yield diagnose("large-without-pinocchio", count=robot.nv, gigabytes=gigabytes, most=most)
    states = affordable_states(robot, count)
    if states < count:
        yield diagnose("large-at-fewer-states", states=states, count=count)
    some = len(some_of(robot, frames))
    if some < len(frames):
        yield diagnose("large-at-fewer-frames", frames=some, count=len(frames))


class Entries:
    """The elements of a large robot's mass matrices that can be other than zero.

    Those of a joint with itself and with the joints that carry it, in any of some trees.
    """

    def __init__(self, nv: int, models: Iterable[tuple[mujoco.MjModel, IntArray]]) -> None:
        """Finds the elements that any of some models has.

        Args:
            nv: Degrees of freedom.
            models: Models, and where the public degrees of freedom are in each.
        """
        found = [_elements(nv, model, public) for model, public in models]
        self.rows, self.columns = np.divmod(np.unique(np.concatenate(found)), nv)

    def in_model(self, model: mujoco.MjModel, public: IntArray) -> IntArray:
        """Returns where the elements (n,) are in a model's sparse mass matrix ``data.M``.

        What a model does not have is said to be one place behind its end.

        Args:
            model: The model.
            public: Where the public degrees of freedom are in it.
        """
        here = np.repeat(np.arange(model.nv), model.M_rownnz) * model.nv + model.M_colind
        order = np.argsort(here)
        rows, columns = public[self.rows], public[self.columns]
        wanted = np.maximum(rows, columns) * model.nv + np.minimum(rows, columns)
        places = order[np.minimum(np.searchsorted(here, wanted, sorter=order), len(here) - 1)]
        found: IntArray = np.where(here[places] == wanted, places, len(here))
        return found


def _elements(nv: int, model: mujoco.MjModel, public: IntArray) -> IntArray:
    """Returns row * nv + column of the elements in a model's mass matrix, in public numbers."""
    number = np.full(model.nv, -1)
    number[public] = np.arange(nv)
    rows = number[np.repeat(np.arange(model.nv), model.M_rownnz)]
    columns = number[model.M_colind]
    kept = (rows >= 0) & (columns >= 0)
    rows, columns = rows[kept], columns[kept]
    flat: IntArray = np.concatenate([rows * nv + columns, columns * nv + rows])
    return flat
