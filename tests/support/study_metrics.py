"""Measures for the tests of studies: workers import them by name, as they do users' own."""

import ctypes
import os
import signal
import time
from pathlib import Path

import pupper_analysis as pa


def places(robot: pa.Robot, stand: pa.Stand) -> dict[str, float]:
    return {foot: float(place[0]) for foot, place in stand.contact_points.items()}


def wrong(robot: pa.Robot, stand: pa.Stand) -> str:
    return "much"


def fails(robot: pa.Robot, stand: pa.Stand) -> float:
    raise RuntimeError("on purpose")


def heavy(robot: pa.Robot) -> bool:
    return robot.total_mass > 4.0


def crashes(robot: pa.Robot, stand: pa.Stand) -> float:
    if heavy(robot):
        os.kill(os.getpid(), signal.SIGKILL)
    return 1.0


def hangs(robot: pa.Robot, stand: pa.Stand) -> float:
    """In C, with Python's lock held: no signal handler and no other thread would run."""
    if heavy(robot):
        ctypes.PyDLL(None).sleep(600)
    return 1.0


def crashes_once(robot: pa.Robot, stand: pa.Stand) -> float:
    marker = Path(os.environ["STUDY_MARKER"])
    if heavy(robot) and not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return 1.0


def process(robot: pa.Robot, stand: pa.Stand) -> float:
    return float(os.getpid())


def slow(robot: pa.Robot, stand: pa.Stand) -> float:
    time.sleep(0.05)
    return robot.total_mass
