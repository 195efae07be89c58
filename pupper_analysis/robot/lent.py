"""What is made of a robot, lent to one user at a time: no thread has it while another does."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Lock
from typing import Any, TypeVar

from pupper_analysis.robot.robot import Robot

T = TypeVar("T")

_MOST_SPARE = 8
"""Things made of robots that are kept for later, of those that were asked last."""

_spare: list[tuple[Robot, object, Any]] = []
"""(robot, what made it, the thing). No robot keeps its own: that would be a circle, in which
memory stays for long."""

_lock = Lock()


@contextmanager
def lend(robot: Robot, make: Callable[[Robot], T]) -> Iterator[T]:
    """Lends something that is made of a robot to one user at a time, in whatever thread.

    What was given back is lent again, as long as the robot is one of those that were asked last.

    Args:
        robot: The robot.
        make: Makes one more, where all are in use.
    """
    own = None
    with _lock:
        for number, (whose, maker, spare) in enumerate(_spare):
            if whose is robot and maker is make:
                own = spare
                del _spare[number]
                break
    if own is None:
        own = make(robot)
    try:
        yield own
    finally:
        with _lock:
            _spare.insert(0, (robot, make, own))
            del _spare[_MOST_SPARE:]
