"""OpenGL that is asked for and missing stops only what draws with it.

MuJoCo imports the OpenGL that the variable MUJOCO_GL names when it is itself imported, and
gets on without if that fails with an ImportError. PyOpenGL fails with others too.
"""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType

_MODULE = "mujoco.rendering.classic.gl_context"


class _Forgiving(Loader):
    """A loader whose every failure is an ImportError."""

    def __init__(self, loader: Loader) -> None:
        self._loader = loader

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        return self._loader.create_module(spec)

    def exec_module(self, module: ModuleType) -> None:
        try:
            self._loader.exec_module(module)
        except Exception as error:
            raise ImportError(f"MUJOCO_GL: {error}") from error


class _Finder(MetaPathFinder):
    """Finds MuJoCo's choice of OpenGL, which it leaves to the other finders but for its loader."""

    def find_spec(
        self, name: str, _path: Sequence[str] | None, _target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Returns how the module is loaded; None for all others."""
        if name != _MODULE:
            return None
        sys.meta_path.remove(self)
        try:
            spec = importlib.util.find_spec(name)
        finally:
            sys.meta_path.insert(0, self)
        if spec is not None and spec.loader is not None:
            spec.loader = _Forgiving(spec.loader)
        return spec


def forgive_drivers() -> None:
    """Lets MuJoCo be imported without the OpenGL that is asked for."""
    if not any(isinstance(finder, _Finder) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Finder())
