"""Root finding by SciPy's MINPACK, without the import of ``scipy.optimize``.

The import of ``scipy.optimize`` takes 0.3 s of processor time, mostly for packages that root
finding does not use. The extension module with MINPACK takes 1 ms. Results equal those of
``scipy.optimize.root`` to the last bit, because both call the same routine with the same arguments.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib.machinery import PathFinder
from importlib.util import module_from_spec
from typing import Any

import scipy

from pupper_analysis.base.array_types import Array

_EXTENSION = "scipy.optimize._minpack"
"""Name of SciPy's extension module with MINPACK. The module is private, so ``scipy.optimize`` is
used if the module cannot be loaded."""

_STEP_FACTOR = 100
"""Upper bound of the norm of the first step, as a multiple of the norm of an initial guess that is
not zero, in MINPACK's scaling of the variables. The value is the default of SciPy.
"""


def find_root(
    function: Callable[[Array], Array],
    start: Array,
    derivative: Callable[[Array], Array],
    *,
    xtol: float,
) -> Array:
    """Find a root by Powell's hybrid method, as ``scipy.optimize.root(method="hybr")``.

    The last iterate is returned, even if the method has not converged; the caller must check the
    residual.

    Args:
        function: Function from a point (n,) to the residual (n,).
        start: Initial guess, shape (n,).
        derivative: Function from a point (n,) to the Jacobian of the residual, shape (n, n).
        xtol: Tolerance of the relative change between two iterates, at which the method ends.
    """
    routines = _load_minpack()
    if routines is None:
        from scipy import optimize

        found: Array = optimize.root(function, start, jac=derivative, options={"xtol": xtol}).x
        return found
    max_evaluations = 100 * (len(start) + 1)  # the default of SciPy with a Jacobian
    root: Array = routines._hybrj(
        function, derivative, start.flatten(), (), 1, 0, xtol, max_evaluations, _STEP_FACTOR, None
    )[0]
    return root


def _load_minpack() -> Any:
    """Return the extension module with MINPACK; None if it is not usable without its package."""
    if _EXTENSION in sys.modules:
        return sys.modules[_EXTENSION]
    spec = PathFinder.find_spec(_EXTENSION, [f"{folder}/optimize" for folder in scipy.__path__])
    if spec is None or spec.loader is None:
        return None
    module = module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except ImportError:
        return None
    if not hasattr(module, "_hybrj"):
        return None
    sys.modules[_EXTENSION] = module  # an extension module must not be loaded twice
    return module
