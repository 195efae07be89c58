"""Random states of a robot: hypothesis strategies, and one state from a seed."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import pupper_analysis as pa


def numbers(size: int, limit: float) -> st.SearchStrategy[np.ndarray]:
    """Return a strategy for vectors with ``size`` elements between -limit and limit."""
    element = st.floats(-limit, limit, allow_subnormal=False)
    return st.lists(element, min_size=size, max_size=size).map(np.array)


def quaternion(rotation_vector: np.ndarray) -> np.ndarray:
    """Return the unit quaternion (w, x, y, z) of a rotation vector [rad]."""
    return np.asarray(Rotation.from_rotvec(rotation_vector).as_quat(scalar_first=True))


def qpos_of(robot: pa.Robot, place: np.ndarray, turn: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Return qpos from the base's position [m], its rotation vector [rad] and the joints'
    positions.

    Args:
        robot: Robot; without a floating base only the joints are used.
        place: Position of the base [m].
        turn: Rotation vector of the base [rad].
        share: Joint positions between the limits: -1 for the lower limit, 1 for the upper
            limit.
    """
    lower = np.maximum(robot.lower_limits, -3.0)
    upper = np.minimum(robot.upper_limits, 3.0)
    joints = (lower + upper) / 2 + share * (upper - lower) / 2
    return np.concatenate([place, quaternion(turn), joints]) if robot.floating else joints


def positions(robot: pa.Robot) -> st.SearchStrategy[np.ndarray]:
    """Return a strategy for qpos: position up to 2 m, rotation vector up to 1.8 rad per axis.

    The joints are between their limits, and between -3 and 3.
    """
    return st.builds(
        lambda place, turn, share: qpos_of(robot, place, turn, share),
        numbers(3, 2.0),
        numbers(3, 1.8),
        numbers(robot.nu, 1.0),
    )


def velocities(robot: pa.Robot) -> st.SearchStrategy[np.ndarray]:
    """Return a strategy for qvel with elements up to 4 (m/s, rad/s)."""
    return numbers(robot.nv, 4.0)


def random_state(robot: pa.Robot, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return qpos and qvel whose elements are all random."""
    random = np.random.default_rng(seed)
    qpos = qpos_of(robot, *(random.uniform(-0.9, 0.9, size) for size in (3, 3, robot.nu)))
    return qpos, random.uniform(-2, 2, robot.nv)
