"""Routines of SciPy's LAPACK, without the import of ``scipy.linalg``.

The import of ``scipy.linalg`` takes 0.4 s of processor time, mostly for NumPy's f2py and for
docstrings. The extension module with the LAPACK routines takes 5 ms. Results equal those of
``scipy.linalg`` to the last bit, because both call the same routines with the same arguments.
"""

from __future__ import annotations

import sys
from importlib.machinery import PathFinder
from importlib.util import module_from_spec
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from pupper_analysis.base.array_types import Array, ComplexArray

_EXTENSION = "scipy.linalg._flapack"
"""Name of SciPy's extension module with the LAPACK routines. The module is private, so
``scipy.linalg.lapack`` is used if the module does not exist."""


def _load_lapack() -> Any:
    """Return a module with the LAPACK routines, if possible without importing ``scipy.linalg``."""
    if "scipy.linalg" not in sys.modules and _EXTENSION not in sys.modules:
        folders = [f"{folder}/linalg" for folder in scipy.__path__]
        spec = PathFinder.find_spec(_EXTENSION, folders)
        if spec is not None and spec.loader is not None:
            module = module_from_spec(spec)
            spec.loader.exec_module(module)
            sys.modules[_EXTENSION] = module  # an extension module must not be loaded twice
            return module
    if _EXTENSION in sys.modules:
        return sys.modules[_EXTENSION]
    from scipy.linalg import lapack

    return lapack


_routines = _load_lapack()
"""Module that contains the LAPACK routines below."""

dgels, dgesv, dggev = _routines.dgels, _routines.dgesv, _routines.dggev
dgglse, dtrcon = _routines.dgglse, _routines.dtrcon


def eig(matrix: Array) -> tuple[ComplexArray, NDArray[Any], NDArray[Any]]:
    """Compute eigenvalues and eigenvectors, as ``scipy.linalg.eig(matrix, left=True)``.

    Args:
        matrix: Real matrix, shape (n, n).

    Returns:
        Eigenvalues, shape (n,); left eigenvectors, shape (n, n); right eigenvectors, shape (n, n).
        Eigenvectors are columns of unit norm, and real if all eigenvalues are real.

    Raises:
        ValueError: If an element is not finite.
        LinAlgError: If the algorithm does not converge.
    """
    finite = np.asarray_chkfinite(matrix, dtype=float)
    size = len(finite)
    if not size:
        return np.empty(0, dtype=complex), np.empty((0, 0)), np.empty((0, 0))
    work = _routines.dgeev_lwork(size, compute_vl=1, compute_vr=1)[0]
    real, imaginary, left, right, failed = _routines.dgeev(finite, lwork=int(work))
    if failed:
        raise np.linalg.LinAlgError
    values = real + 1j * imaginary
    if imaginary.any():
        left, right = (_combine_pairs(imaginary, vectors) for vectors in (left, right))
    return values, left, right


def _combine_pairs(imaginary: Array, vectors: Array) -> ComplexArray:
    """Convert LAPACK's real columns ``vectors`` to complex eigenvectors, shape (n, n).

    LAPACK returns the real and the imaginary part of a complex pair as two columns. ``imaginary``
    (n,) contains the imaginary parts of the eigenvalues, positive first in each pair.
    """
    combined = np.array(vectors, dtype=complex, order="F")
    first = np.flatnonzero(imaginary > 0)
    combined.imag[:, first] = vectors[:, first + 1]
    combined[:, first + 1] = combined[:, first].conj()
    return combined


def _compute_svd(matrix: Array, *, full_matrices: bool) -> tuple[Array, Array, Array]:
    """Return left singular vectors (columns), singular values, and right singular vectors (rows).

    ``matrix`` is not empty. With ``full_matrices``, both sets of vectors are complete bases.

    Raises:
        LinAlgError: If the decomposition does not converge.
    """
    work = _routines.dgesdd_lwork(*matrix.shape, compute_uv=True, full_matrices=full_matrices)[0]
    along, singular, across, failed = _routines.dgesdd(
        matrix, full_matrices=full_matrices, lwork=int(work)
    )
    if failed:
        raise np.linalg.LinAlgError
    return along, singular, across


def null_space(matrix: Array, rcond: float | None = None) -> Array:
    """Return an orthonormal basis of the null space, as ``scipy.linalg.null_space``.

    Args:
        matrix: Shape (m, n).
        rcond: Singular values up to this fraction of the largest count as zero; by default machine
            precision times the larger dimension.

    Returns:
        Basis as columns, shape (n, k).

    Raises:
        ValueError: If an element is not finite.
        LinAlgError: If the singular value decomposition does not converge.
    """
    finite = np.asarray_chkfinite(matrix, dtype=float)
    num_rows, num_columns = finite.shape
    if not finite.size:
        return np.eye(num_columns)
    _, singular, across = _compute_svd(finite, full_matrices=True)
    fraction = np.finfo(float).eps * max(num_rows, num_columns) if rcond is None else rcond
    rank = int((singular > singular.max(initial=0.0) * fraction).sum())
    basis: Array = across[rank:].T
    return basis


def orth(matrix: Array) -> Array:
    """Return an orthonormal basis of the range, as ``scipy.linalg.orth``.

    Args:
        matrix: Shape (m, n).

    Returns:
        Basis as columns, shape (m, k).

    Raises:
        ValueError: If an element is not finite.
        LinAlgError: If the singular value decomposition does not converge.
    """
    finite = np.asarray_chkfinite(matrix, dtype=float)
    num_rows, num_columns = finite.shape
    if not finite.size:
        return np.empty((num_rows, 0))
    along, singular, _ = _compute_svd(finite, full_matrices=False)
    least = singular.max(initial=0.0) * np.finfo(float).eps * max(num_rows, num_columns)
    basis: Array = along[:, : int((singular > least).sum())]
    return basis


def pivoted_qr(matrix: Array) -> tuple[Array, NDArray[np.intp]]:
    """Compute the triangle R and the column order of a QR factorisation with pivoting.

    The results equal those of ``scipy.linalg.qr(matrix, mode="economic", pivoting=True)``.

    Args:
        matrix: Shape (m, n).

    Returns:
        Upper triangle, shape (min(m, n), n); indices of the columns in the order of the
        factorisation, shape (n,).

    Raises:
        ValueError: If an element is not finite.
    """
    finite = np.asarray_chkfinite(matrix, dtype=float)
    num_rows, num_columns = finite.shape
    if not finite.size:
        return np.zeros((min(finite.shape), num_columns)), np.arange(num_columns)
    work = _routines.dgeqp3(finite, lwork=-1)[-2][0]
    factored, order, *_ = _routines.dgeqp3(finite, lwork=int(work))
    return np.triu(factored[: min(num_rows, num_columns)]), order.astype(np.intp) - 1
