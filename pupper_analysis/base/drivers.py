"""OpenGL that is asked for and missing stops only what draws with it.

MuJoCo imports the OpenGL that the variable MUJOCO_GL names when it is itself imported, and
gets on without if that fails with an ImportError. PyOpenGL fails with others too.
"""

from __future__ import annotations

import os
import sys
from importlib import import_module


def import_mujoco() -> None:
    """Imports MuJoCo without OpenGL if MUJOCO_GL asks for one that cannot be had.

    Nothing is imported if the variable is not set: by itself MuJoCo takes what is there. Nor if
    MuJoCo is there already, or is not installed, which whoever needs it will say.
    """
    if not os.environ.get("MUJOCO_GL") or "mujoco" in sys.modules:
        return
    try:
        import_module("mujoco")
    except ImportError:
        return
    except Exception:  # a name that MuJoCo does not know, or a driver, each fails in its own way
        import_without_opengl()


def import_without_opengl() -> None:
    """Imports MuJoCo without OpenGL, unless it is there already: GLFW starts a process to load.

    What draws asks for its own afterwards (tools/analyze/render.py), by the variable as it is set.
    """
    wanted = os.environ.get("MUJOCO_GL")
    os.environ["MUJOCO_GL"] = "disable"
    try:
        import_module("mujoco")
    finally:
        if wanted is None:
            del os.environ["MUJOCO_GL"]
        else:
            os.environ["MUJOCO_GL"] = wanted
