"""Files of measurements: columns of numbers with names and units, from CSV or npz."""

from __future__ import annotations

import csv
import io
import math
import re
import warnings
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from pupper_analysis.base.arguments import check_type
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import InputError, MeasurementError
from pupper_analysis.base.inputs import decode_input, read_input
from pupper_analysis.base.units import UNITS
from pupper_analysis.models.places import quote_short

Array = NDArray[np.float64]

_MISSING = ("", "nan", "na", "null", "none")
"""Cells that say that nothing was measured."""

MOST_CSV = 100_000_000
"""Bytes of a CSV file: an hour of twelve joints at 1 kHz is twice that, and belongs in an npz."""

_SEPARATORS = (",", ";", "\t")
"""The first line has most of the one that a file has."""

_COMMA = re.compile(r"^([-+]?\d*),(?=\d+([eE][-+]?\d+)?$)")

_NAME = re.compile(r"(?P<name>[^\[\]]+?)\s*(?:\[(?P<unit>[^\[\]]*)\])?")


@dataclass(frozen=True)
class Column:
    """A column that may be in a file of measurements.

    Attributes:
        pattern: Its name, as ``time`` or ``position.*``.
        quantity: What its numbers are: a key of the units; empty for words.
    """

    pattern: str
    quantity: str


@dataclass(frozen=True)
class Columns:
    """What stands in a file of measurements.

    Attributes:
        source: The file's path.
        numbers: {name: (n,) in SI units}; missing cells are NaN.
        words: {name: n texts}, of columns that hold words.
        lines: (n,) the file's line of each row; counted from 0 where it has no lines.
    """

    source: str
    numbers: Mapping[str, Array]
    words: Mapping[str, tuple[str, ...]]
    lines: tuple[int, ...]

    def of(self, prefix: str) -> dict[str, Array]:
        """Returns the columns of one prefix: {``FL_knee``: (n,)} for ``position``."""
        start = prefix + "."
        return {
            name[len(start) :]: values
            for name, values in self.numbers.items()
            if name.startswith(start)
        }


def read_columns(path: str | Path, known: Sequence[Column]) -> Columns:
    """Reads a file of measurements.

    A CSV file has its columns' names in its first line, with units in brackets where they are not
    SI: ``position.FL_knee [deg]``. It may have semicolons or tabs for commas; with semicolons,
    numbers may have decimal commas. A cell that is empty or says ``nan`` is missing. An ``.npz``
    has arrays of those names; those of several joints may be one, ``position`` (n, joints), whose
    names are in ``joints``.

    Args:
        path: The file.
        known: The columns that it may have.

    Raises:
        MeasurementError: If it cannot be read: a column that is not known, twice there or in no
            known unit, a cell that is no number.
    """
    check_type("path", path, str | Path)
    file = Path(path)
    try:
        if file.suffix == ".npz":
            return _from_arrays(str(path), read_npz(file), known)
        return _from_csv(str(path), decode_input(file, read_input(file, MOST_CSV)), known)
    except InputError as error:
        source = str(path) if error.line is None else f"{path}:{error.line}"
        raise MeasurementError(source, error.cause) from error


def _from_csv(source: str, text: str, known: Sequence[Column]) -> Columns:
    first = text.lstrip("\r\n").partition("\n")[0]
    separator = max(_SEPARATORS, key=first.count)
    try:
        lines = io.StringIO(text, newline="")
        rows = list(csv.reader(lines, strict=True, delimiter=separator))
    except csv.Error as error:
        raise MeasurementError(source, diagnose("no-csv", problem=str(error))) from error
    filled = [(line, row) for line, row in enumerate(rows, 1) if any(cell.strip() for cell in row)]
    if len(filled) < 2:
        raise MeasurementError(source, diagnose("no-rows"))
    header, body = [cell.strip() for cell in filled[0][1]], filled[1:]
    columns = list(_columns(source, header, known))
    for line, row in body:
        if len(row) != len(header):
            finding = diagnose("row-length", line=line, cells=len(row), columns=len(header))
            raise MeasurementError(source, finding)
    numbers, words = {}, {}
    for place, (name, column, factor) in enumerate(columns):
        cells = [row[place].strip() for _, row in body]
        if column.quantity and separator == ";":  # whose decimals have a comma, as a rule
            cells = [_COMMA.sub(r"\1.", cell) for cell in cells]
        if column.quantity:
            numbers[name] = factor * _numbers(source, header[place], cells, body)
        else:
            words[name] = tuple(cells)
    return Columns(source, numbers, words, tuple(line for line, _ in body))


def _numbers(
    source: str, name: str, cells: Sequence[str], body: Sequence[tuple[int, list[str]]]
) -> Array:
    try:  # quickly, where all are numbers
        found = np.array(cells, dtype=float)
    except ValueError:
        found = np.empty(len(cells))
        for row, cell in enumerate(cells):
            try:
                found[row] = math.nan if cell.lower() in _MISSING else float(cell)
            except ValueError:
                finding = diagnose("cell-no-number", column=name, line=body[row][0], cell=cell[:60])
                raise MeasurementError(source, finding) from None
    if np.isinf(found).any():
        row = int(np.flatnonzero(np.isinf(found))[0])
        finding = diagnose("cell-no-number", column=name, line=body[row][0], cell=cells[row][:60])
        raise MeasurementError(source, finding)
    return found


def _from_arrays(
    source: str, arrays: dict[str, NDArray[np.generic]], known: Sequence[Column]
) -> Columns:
    flat: dict[str, NDArray[np.generic]] = {}
    joints = [str(one) for one in np.atleast_1d(arrays.pop("joints", np.zeros(0)))]
    for name, values in arrays.items():
        match = _NAME.fullmatch(name)
        if values.ndim == 2 and values.shape[1] == len(joints) and match:
            unit = f" [{match['unit']}]" if match["unit"] else ""
            for joint, column in zip(joints, values.T, strict=True):
                flat[f"{match['name']}.{joint}{unit}"] = column
        elif values.ndim == 1:
            flat[name] = values
        else:
            finding = diagnose("array-no-column", name=name, shape=str(values.shape), joints=joints)
            raise MeasurementError(source, finding)
    sizes = {len(values) for values in flat.values()}
    if len(sizes) != 1 or 0 in sizes:
        raise MeasurementError(source, diagnose("arrays-of-sizes", sizes=sorted(sizes)))
    numbers, words = {}, {}
    header = list(flat)
    for name, (plain, column, factor) in zip(header, _columns(source, header, known), strict=True):
        if not column.quantity:
            words[plain] = tuple(str(one) for one in flat[name])
            continue
        if flat[name].dtype.kind not in "iuf":
            finding = diagnose("array-of-another-type", type=str(flat[name].dtype))
            raise MeasurementError(source, finding)
        values = factor * flat[name].astype(float)
        if np.isinf(values).any():
            row = int(np.flatnonzero(np.isinf(values))[0])
            finding = diagnose("cell-no-number", column=name, line=row, cell=str(values[row]))
            raise MeasurementError(source, finding)
        numbers[plain] = values
    return Columns(source, numbers, words, tuple(range(sizes.pop())))


def _columns(
    source: str, header: Iterable[str], known: Sequence[Column]
) -> Iterator[tuple[str, Column, float]]:
    """Yields name, kind and size of the unit of each column."""
    seen = set()
    for text in header:
        match = _NAME.fullmatch(text)
        name = match["name"].strip() if match else text
        column = next((one for one in known if fnmatchcase(name, one.pattern)), None)
        if match is None or column is None:
            patterns = tuple(one.pattern for one in known)
            raise MeasurementError(
                source, diagnose("measurement-unknown", column=quote_short(text), known=patterns)
            )
        if name in seen:
            raise MeasurementError(source, diagnose("column-twice", column=name))
        seen.add(name)
        units = UNITS.get(column.quantity, {})
        unit = (match["unit"] or "").strip()
        if unit and unit not in units:
            finding = diagnose("column-unit", column=name, unit=unit, known=tuple(units))
            raise MeasurementError(source, finding)
        yield name, column, units[unit] if unit else 1.0


# Arrays of numbers in an `.npz`, within limits, and without pickles.

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
        finding = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise InputError(path, diagnose("no-npz", problem=finding)) from error


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
