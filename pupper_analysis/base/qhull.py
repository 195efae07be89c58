"""Convex hulls of SciPy, without the import of ``scipy.spatial``.

The import of ``scipy.spatial`` takes 0.24 s of processor time, mostly for ``scipy.linalg``, which
the convex hulls do not use. The extension module with the convex hulls takes 12 ms. The class
`ConvexHull` and the error `QhullError` are those of ``scipy.spatial``.
"""

from __future__ import annotations

import sys
from importlib.machinery import PathFinder
from importlib.util import module_from_spec
from types import ModuleType
from typing import Any

import scipy

_EXTENSION = "scipy.spatial._qhull"
"""Name of SciPy's extension module with the convex hulls. The module is private and may be renamed;
``scipy.spatial`` then replaces it.
"""

_PACKAGE, _LAPACK = "scipy.linalg", "scipy.linalg.cython_lapack"
"""SciPy package that the extension module imports, and the only module of this package that the
extension module uses. `_load_without_packages` replaces the package by an empty one."""


def _load_extension() -> Any:
    """Return a module with the convex hulls, if possible without importing ``scipy.spatial``."""
    loaded = sys.modules.get(_EXTENSION)
    if loaded is None and "scipy.spatial" not in sys.modules:
        loaded = _load_without_packages()
    if loaded is not None:
        return loaded
    from scipy import spatial

    return spatial


def _load_without_packages() -> ModuleType | None:
    """Load the extension module without SciPy's packages; None if impossible.

    An empty package replaces ``scipy.linalg`` during the call, in which no other thread may import
    ``scipy.linalg``.
    """
    spec = PathFinder.find_spec(_EXTENSION, [f"{folder}/spatial" for folder in scipy.__path__])
    if spec is None or spec.loader is None:
        return None
    replaces = _PACKAGE not in sys.modules
    if replaces:
        sys.modules[_PACKAGE] = ModuleType(_PACKAGE)
        sys.modules[_PACKAGE].__path__ = [f"{folder}/linalg" for folder in scipy.__path__]
    try:
        module = module_from_spec(spec)
        spec.loader.exec_module(module)
    except (ImportError, AttributeError):
        return None
    finally:
        if replaces:
            del sys.modules[_PACKAGE]
            # Its next import makes the module an attribute of the package.
            sys.modules.pop(_LAPACK, None)
    sys.modules[_EXTENSION] = module  # an extension module must not be loaded twice
    return module


_extension = _load_extension()
"""Module that contains ``ConvexHull`` and ``QhullError``."""

ConvexHull, QhullError = _extension.ConvexHull, _extension.QhullError
