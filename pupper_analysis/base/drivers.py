"""Import of MuJoCo if the requested OpenGL is not available, MuJoCo's log file, BLAS threads.

MuJoCo imports the OpenGL backend named in the environment variable MUJOCO_GL during the import of
MuJoCo. MuJoCo ignores an ImportError of the backend, but PyOpenGL also raises other exceptions. The
functions here load MuJoCo without OpenGL in that case, so that only rendering fails.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from types import ModuleType
from typing import Any


class _MuJoCoLoader(SourceFileLoader):
    """Loader of ``mujoco`` that loads MuJoCo without OpenGL if the backend in MUJOCO_GL fails."""

    def exec_module(self, module: ModuleType) -> None:
        """Execute the module ``mujoco``; if its OpenGL backend fails, again without OpenGL.

        An ImportError is passed on. MuJoCo itself ignores an ImportError of the backend.
        """
        try:
            super().exec_module(module)
        except ImportError:
            raise
        except Exception:  # unknown backend names and drivers raise different exceptions
            with _disable_opengl():
                super().exec_module(module)


class _MuJoCoFinder(MetaPathFinder):
    """Finder that applies `_MuJoCoLoader` to the module ``mujoco``, and ignores other modules."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return the import specification of ``mujoco``, usually with the loader `_MuJoCoLoader`.

        None for other modules, and if MuJoCo is not found. The signature is that of
        ``importlib.abc.MetaPathFinder.find_spec``.
        """
        if fullname != "mujoco":
            return None
        found = PathFinder.find_spec(fullname, path, target)
        if found is None or not isinstance(found.loader, SourceFileLoader):
            return found
        found.loader = _MuJoCoLoader(found.loader.name, found.loader.path)
        return found


def guard_mujoco_import() -> None:
    """Let a later ``import mujoco`` succeed if the OpenGL backend named in MUJOCO_GL fails.

    MuJoCo is not imported here, so that ``--help`` stays fast. Without MUJOCO_GL, nothing is done.
    """
    guarded = any(isinstance(finder, _MuJoCoFinder) for finder in sys.meta_path)
    if os.environ.get("MUJOCO_GL") and "mujoco" not in sys.modules and not guarded:
        sys.meta_path.insert(0, _MuJoCoFinder())


def import_without_opengl() -> None:
    """Import MuJoCo without OpenGL, for commands that do not render.

    By default, MuJoCo loads GLFW, which starts a process while loading. MUJOCO_GL has the old value
    afterwards, because ``present.pictures`` starts a process that renders with this value.
    """
    with _disable_opengl():
        import_module("mujoco")


@contextmanager
def _disable_opengl() -> Iterator[None]:
    """Disable MuJoCo's OpenGL in a ``with`` block, by the environment variable MUJOCO_GL."""
    previous = os.environ.get("MUJOCO_GL")
    os.environ["MUJOCO_GL"] = "disable"
    try:
        yield
    finally:
        if previous is None:
            del os.environ["MUJOCO_GL"]
        else:
            os.environ["MUJOCO_GL"] = previous


_BLAS_THREADS = "OPENBLAS_NUM_THREADS"
"""Environment variable with the number of threads of the BLAS in the wheels of NumPy and SciPy."""

_BLAS_VARIABLES = (_BLAS_THREADS, "GOTO_NUM_THREADS", "OMP_NUM_THREADS")
"""Environment variables from which OpenBLAS reads the number of threads."""


def use_one_blas_thread() -> None:
    """Limit NumPy and SciPy, if imported later, to one BLAS thread, unless the user set a number.

    Several threads of OpenBLAS waste processor time, because they wait actively for each other.
    """
    if not any(os.environ.get(name) for name in _BLAS_VARIABLES):
        os.environ[_BLAS_THREADS] = "1"


@contextmanager
def no_mujoco_log() -> Iterator[None]:
    """Disable MuJoCo's log file MUJOCO_LOG.TXT in a ``with`` block, in the whole process.

    Commands use this function, because MuJoCo would write the file into the current folder.
    Warnings still go to standard error.
    """
    log: Any = import_module("mujoco").MjLogConfig
    before = log.get().logto_file
    _set_file_logging(log, enabled=False)
    try:
        yield
    finally:
        _set_file_logging(log, enabled=before)


def _set_file_logging(log: Any, *, enabled: bool) -> None:
    """Enable or disable MuJoCo's log file; ``log`` is the class ``mujoco.MjLogConfig``."""
    config = log.get()
    config.logto_file = enabled
    log.set(config)
