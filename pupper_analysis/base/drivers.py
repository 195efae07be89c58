"""Import of MuJoCo if the requested OpenGL is not available, and MuJoCo's log file.

MuJoCo imports the OpenGL backend named in the environment variable MUJOCO_GL during the import of
MuJoCo. MuJoCo ignores an ImportError of the backend, but PyOpenGL also raises other exceptions. The
functions here import MuJoCo without OpenGL in that case, so that only rendering fails.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any


def import_mujoco() -> None:
    """Import MuJoCo if MUJOCO_GL is set; without OpenGL if the backend in MUJOCO_GL fails.

    Nothing is imported if MUJOCO_GL is not set, because MuJoCo then selects an available backend,
    or if MuJoCo is already imported. If MuJoCo is not installed, the first module that needs MuJoCo
    reports the error.
    """
    if not os.environ.get("MUJOCO_GL") or "mujoco" in sys.modules:
        return
    try:
        import_module("mujoco")
    except ImportError:
        return
    except Exception:  # unknown backend names and drivers raise different exceptions
        import_without_opengl()


def import_without_opengl() -> None:
    """Import MuJoCo without OpenGL, because GLFW starts a process while loading.

    MUJOCO_GL has the old value afterwards; ``tools/analyze/render.py`` uses this value to load
    OpenGL.
    """
    previous = os.environ.get("MUJOCO_GL")
    os.environ["MUJOCO_GL"] = "disable"
    try:
        import_module("mujoco")
    finally:
        if previous is None:
            del os.environ["MUJOCO_GL"]
        else:
            os.environ["MUJOCO_GL"] = previous


@contextmanager
def no_mujoco_log() -> Iterator[None]:
    """Keep MuJoCo from writing MUJOCO_LOG.TXT into the current folder, in the whole process.

    For commands, whose process does nothing else. Warnings still go to standard error.
    """
    log: Any = import_module("mujoco").MjLogConfig
    before = log.get().logto_file
    _write_log(log, enabled=False)
    try:
        yield
    finally:
        _write_log(log, enabled=before)


def _write_log(log: Any, *, enabled: bool) -> None:
    config = log.get()
    config.logto_file = enabled
    log.set(config)
