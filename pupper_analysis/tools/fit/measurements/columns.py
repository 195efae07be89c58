"""Files of measurements: columns of numbers with names and units, from CSV."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.arguments import check_type
from pupper_analysis.base.csv_text import cell_text
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import InputError, MeasurementError
from pupper_analysis.base.inputs import decode_input, read_input
from pupper_analysis.base.units import UNIT_FACTORS
from pupper_analysis.models.places import quote_short

Array = NDArray[np.float64]

_MISSING = ("", "nan", "na", "null", "none")
"""Cells that say that nothing was measured."""

MAX_CSV_BYTES = 100_000_000
"""Bytes of a CSV file: half an hour of twelve joints at 1 kHz."""

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
        lines: (n,) the file's line of each row.
    """

    source: str
    numbers: Mapping[str, Array]
    words: Mapping[str, tuple[str, ...]]
    lines: tuple[int, ...]

    def get_columns(self, prefix: str) -> dict[str, Array]:
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
    numbers may have decimal commas. A cell that is empty or says ``nan`` is missing.

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
        return _from_csv(str(path), decode_input(file, read_input(file, MAX_CSV_BYTES)), known)
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
            words[name] = tuple(map(cell_text, cells))
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
        units = UNIT_FACTORS.get(column.quantity, {})
        unit = (match["unit"] or "").strip()
        if unit and unit not in units:
            finding = diagnose("column-unit", column=name, unit=unit, known=tuple(units))
            raise MeasurementError(source, finding)
        yield name, column, units[unit] if unit else 1.0
