"""Types of NumPy arrays in annotations, by the type of the elements."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
"""Array of double-precision numbers."""

IntArray = NDArray[np.int64]
"""Array of 64-bit integers, such as indices."""

BoolArray = NDArray[np.bool_]
"""Array of Booleans, such as a mask."""

ComplexArray = NDArray[np.complex128]
"""Array of complex numbers in double precision, such as eigenvalues."""

Pixels = NDArray[np.uint8]
"""Array of 8-bit colour values, 0 to 255."""
