"""Open MuJoCo's viewer, and test beforehand if a window can be opened."""

from __future__ import annotations

import os
import sys
import warnings

import mujoco

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import PupperAnalysisError


class DisplayError(PupperAnalysisError):
    """No window can be opened, or no picture can be drawn."""


def check_display() -> None:
    """Check that a window can be opened, before MuJoCo's viewer starts.

    Without a display, the viewer would end the Python interpreter.

    Raises:
        DisplayError: If no window can be opened.
    """
    no_screen = not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
    if sys.platform.startswith("linux") and no_screen:
        raise DisplayError(diagnose("no-display"))
    try:
        from mujoco.viewer import glfw
    except (ImportError, RuntimeError) as error:
        raise DisplayError(diagnose("viewer-not-available", message=str(error))) from error
    with warnings.catch_warnings(record=True) as caught:  # how glfw reports errors
        warnings.simplefilter("always")
        window = None
        if glfw.init():
            glfw.window_hint(glfw.VISIBLE, glfw.FALSE)
            window = glfw.create_window(16, 16, "", None, None)
            glfw.default_window_hints()
    if not window:
        message = str(caught[-1].message) if caught else "no window with OpenGL"
        raise DisplayError(diagnose("viewer-not-available", message=message))
    glfw.destroy_window(window)


def show_window(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Simulate a model in a window of MuJoCo's viewer, in real time, until the window is closed.

    ``data`` contains the initial state.

    Raises:
        DisplayError: If no window can be opened.
    """
    check_display()
    from mujoco import viewer

    viewer.launch(model, data)


def in_notebook() -> bool:
    """Return True in a Jupyter kernel, which displays pictures below the cell.

    The criterion is IPython's shell ``ZMQInteractiveShell``.
    """
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    return type(shell).__name__ == "ZMQInteractiveShell"
