"""MuJoCo's window, in real time: opened where there is a screen, and closed without a crash."""

from __future__ import annotations

import contextlib
import math
import os
import shlex
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from typing import Any

import mujoco

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import PupperAnalysisError

_FRAME = 1 / 60  # s between two pictures


class DisplayError(PupperAnalysisError):
    """The viewer cannot open a window here; the message says what to do instead."""


def check_display() -> None:
    """Makes sure that a window can be opened; without one GLFW ends the interpreter, or hangs.

    Raises:
        DisplayError: If not.
    """
    no_screen = not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
    if sys.platform.startswith("linux") and no_screen:
        raise DisplayError(diagnose("no-display"))
    try:
        from mujoco import viewer
    except (ImportError, RuntimeError) as error:
        raise DisplayError(diagnose("viewer-not-available", message=str(error))) from error
    if sys.platform == "darwin":
        if viewer._MJPYTHON is None:
            command = shlex.join(["mjpython", *sys.argv])
            raise DisplayError(diagnose("launcher-needed", command=command))
        return
    glfw = viewer.glfw
    with warnings.catch_warnings(record=True) as caught:  # how glfw reports errors
        warnings.simplefilter("always")
        window = None
        if glfw.init():
            glfw.window_hint(glfw.VISIBLE, glfw.FALSE)
            window = glfw.create_window(16, 16, "", None, None)
            glfw.default_window_hints()
    if not window:
        message = str(caught[-1].message) if caught else None
        raise DisplayError(diagnose("display-not-usable", message=message))
    glfw.destroy_window(window)


@contextlib.contextmanager
def open_window(model: mujoco.MjModel, data: mujoco.MjData) -> Iterator[Any]:
    """Opens MuJoCo's passive viewer, and sees it closed before it goes on."""
    check_display()
    from mujoco import viewer

    before = set(threading.enumerate())
    handle = viewer.launch_passive(model, data)
    with handle.lock():
        handle.cam.lookat[:] = data.site("body_imu_site").xpos * (0.0, 0.0, 0.5)
        handle.cam.distance, handle.cam.azimuth, handle.cam.elevation = 0.8, 130.0, -20.0
    try:
        yield handle
    finally:
        with _no_interrupt():  # if Python ended before the window's thread, it would crash
            handle.close()
            for thread in set(threading.enumerate()) - before:
                thread.join(timeout=5.0)


@contextlib.contextmanager
def _no_interrupt() -> Iterator[None]:
    """Ignores Ctrl-C; only the main thread gets it, and only there it can be ignored."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    previous = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, previous)


def show_window(
    model: mujoco.MjModel, data: mujoco.MjData, step: Callable[[], None], count: int
) -> None:
    """Opens a window and calls ``step`` in it, ``count`` times in real time, until it is closed."""
    with open_window(model, data) as handle:
        play_steps(handle, float(model.opt.timestep), step, count)


def play_steps(
    handle: Any, timestep: float, step: Callable[[], None], count: int | None = None
) -> None:
    """Calls ``step`` in real time, ``count`` times or without end, while the window is open."""
    done, start = 0, time.perf_counter()
    limit = math.inf if count is None else count
    while handle.is_running() and done < limit:
        now = time.perf_counter()
        due = int((now - start) / timestep)
        if (due - done) * timestep > 0.1:  # too slow, or woken from sleep: do not catch up
            due = done + max(1, round(_FRAME / timestep))
            start = now - due * timestep
        with handle.lock():
            while done < min(due, limit):
                step()
                done += 1
        handle.sync()
        time.sleep(max(0.0, _FRAME - (time.perf_counter() - now)))
