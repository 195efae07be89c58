"""Arrays of numbers in an ``.npz``, within limits, and without pickles."""

from __future__ import annotations

import io
import math
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import InputError
from pupper_analysis.base.inputs import read_input

MOST_UNPACKED = 500_000_000
"""Bytes of all arrays: three numbers of twelve joints at 1 kHz for half an hour. Zeros are packed a
thousandfold: 3 MB of them are 3 GB."""

_HEADERS: dict[Any, Callable[[io.BytesIO], tuple[tuple[int, ...], bool, np.dtype[Any]]]] = {
    (1, 0): npy.read_array_header_1_0,
    (2, 0): npy.read_array_header_2_0,
}


def read_npz(path: Path) -> dict[str, NDArray[np.generic]]:
    """Returns the arrays of a file by their names.

    Raises:
        InputError: If it cannot be read, is damaged or too large, or holds anything else.
    """
    data = read_input(path, MOST_UNPACKED)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of headers that Python 2 wrote
            members = archive.infolist()
            if sum(one.file_size for one in members) > MOST_UNPACKED:
                raise InputError(path, diagnose("npz-too-large", most=MOST_UNPACKED / 1e6))
            return {one.filename.removesuffix(".npy"): _array(archive, one) for one in members}
    except InputError:
        raise
    except Exception as error:  # of damaged files zipfile, zlib and NumPy raise what they come upon
        told = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise InputError(path, diagnose("no-npz", problem=told)) from error


def _array(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> NDArray[np.generic]:
    """Returns an array of a member's bytes, which have to be as many as its header says."""
    with archive.open(member) as packed:
        # Asked for so many, and not for all: there may be more than the directory says.
        data = packed.read(member.file_size)
    file = io.BytesIO(data)
    shape, by_columns, dtype = _HEADERS[npy.read_magic(file)](file)  # type: ignore[no-untyped-call]
    if dtype.hasobject:
        raise ValueError("it holds objects of Python")
    values = data[file.tell() :]
    if math.prod(shape) * dtype.itemsize != len(values) or not dtype.itemsize:
        raise ValueError(f"{len(values)} bytes are no array of the shape {shape}")
    return np.frombuffer(values, dtype).reshape(shape, order="F" if by_columns else "C")
