"""Metrics of study tests in an importable module: worker processes import them by name."""

import ctypes
import os
import signal
import time
from pathlib import Path
from typing import Any

import mujoco

import pupper_analysis as pa


def places(robot: pa.Robot, stand: pa.Stand) -> dict[str, float]:
    """Return the x coordinate [m] of each contact point."""
    return {foot: float(place[0]) for foot, place in stand.contact_points.items()}


def wrong(robot: pa.Robot, stand: pa.Stand) -> str:
    """Return a text, which is not a valid value of a metric."""
    return "much"


def fails(robot: pa.Robot, stand: pa.Stand) -> float:
    """Raise an error."""
    raise RuntimeError("on purpose")


def writes_log(_robot: pa.Robot, _stand: pa.Stand) -> float:
    """Return whether MuJoCo writes its log file MUJOCO_LOG.TXT in this process."""
    log: Any = mujoco
    return float(log.MjLogConfig.get().logto_file)


def heavy(robot: pa.Robot) -> bool:
    """Return whether the robot has more than 4 kg."""
    return robot.total_mass > 4.0


def crashes(robot: pa.Robot, stand: pa.Stand) -> float:
    """Kill the worker process for a heavy robot."""
    if heavy(robot):
        os.kill(os.getpid(), signal.SIGKILL)
    return 1.0


def hangs(robot: pa.Robot, stand: pa.Stand) -> float:
    """Sleep in C for a heavy robot, with Python's lock held: no signal handler can run."""
    if heavy(robot):
        ctypes.PyDLL(None).sleep(600)
    return 1.0


def crashes_once(robot: pa.Robot, stand: pa.Stand) -> float:
    """Kill the worker process for a heavy robot, once."""
    marker = Path(os.environ["STUDY_MARKER"])
    if heavy(robot) and not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return 1.0


def process(robot: pa.Robot, stand: pa.Stand) -> float:
    """Return the process number of the worker."""
    return float(os.getpid())


def slow(robot: pa.Robot, stand: pa.Stand) -> float:
    """Return the mass [kg] after 50 ms."""
    time.sleep(0.05)
    return robot.total_mass
