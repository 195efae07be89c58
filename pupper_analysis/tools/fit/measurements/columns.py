"""CSV files of measurements: columns of numbers with names and units.

`read_columns` reads a file into arrays in SI units, and texts. Each column must match one of the
columns that the caller accepts. The header may state a unit in brackets, which must belong to the
physical quantity of the column. Missing numbers are NaN. Errors of a row contain the number of the
line.
"""

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

from pupper_analysis.base.arguments import check_type
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.csv_text import cell_text
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import InputError, MeasurementError
from pupper_analysis.base.inputs import decode_input, read_input
from pupper_analysis.base.units import UNIT_FACTORS
from pupper_analysis.models.places import quote_short

_MISSING_CELLS = ("", "nan", "na", "null", "none")
"""Contents of cells without a measurement, in lower case."""

MAX_CSV_BYTES = 100_000_000
"""Largest accepted size of a CSV file [bytes]. About 7 minutes of commands and positions of twelve
joints at 1 kHz, with 9 characters per number, have this size. Chosen, not tuned.
"""

_CELL_SEPARATORS = (",", ";", "\t")
"""Possible separators of cells; the most frequent in the header is used."""

_DECIMAL_COMMA = re.compile(r"^([-+]?\d*),(?=\d+([eE][-+]?\d+)?$)")
"""Start of a number with a decimal comma, up to the comma; the group is the integer part."""

_HEADER_PATTERN = re.compile(r"(?P<name>[^\[\]]+?)\s*(?:\[(?P<unit>[^\[\]]*)\])?")
"""Header of a column: a name, and optionally the unit in brackets."""


@dataclass(frozen=True)
class MeasurementColumn:
    """Column that a file of measurements may contain.

    Attributes:
        pattern: Column name, for example ``time``, or a pattern (``position.*``).
        quantity: Physical quantity, a key of ``UNIT_FACTORS``; empty for texts.
    """

    pattern: str
    quantity: str


@dataclass(frozen=True)
class Columns:
    """Content of a CSV file of measurements, in SI units.

    Attributes:
        source: Path of the file.
        numbers: {name: values in SI units, shape (n,)}; NaN for missing cells.
        words: {name: n texts} of columns that contain texts.
        lines: Line number of each row in the file, shape (n,), counted from 1 at the first line. A
            cell that contains a line end counts as a single line.
    """

    source: str
    numbers: Mapping[str, Array]
    words: Mapping[str, tuple[str, ...]]
    lines: tuple[int, ...]

    def get_columns(self, prefix: str) -> dict[str, Array]:
        """Select the numeric columns ``<prefix>.<name>`` as {name: values}.

        With the prefix ``position``, the column ``position.FL_knee`` has the key ``FL_knee``.

        Returns:
            {name: values, shape (n,), in SI units; NaN for missing cells}.
        """
        start = prefix + "."
        return {
            name[len(start) :]: values
            for name, values in self.numbers.items()
            if name.startswith(start)
        }


def read_columns(path: str | Path, known: Sequence[MeasurementColumn]) -> Columns:
    """Read a CSV file of measurements into arrays in SI units.

    The first row with a filled cell contains the names of the columns. A unit other than the SI
    unit is stated in brackets: ``position.FL_knee [deg]``. Separators are commas, semicolons or
    tabs. If semicolons separate the cells, numbers may have decimal commas. Missing values are
    empty cells, and words such as ``nan`` (`_MISSING_CELLS`).

    Args:
        path: CSV file.
        known: Columns that the file may contain.

    Raises:
        MeasurementError: If the file cannot be read; for example, if a column is unknown, is
            repeated or has an unknown unit, or if a cell is not a number.
    """
    check_type("path", path, str | Path)
    file = Path(path)
    try:
        return _parse_csv(str(path), decode_input(file, read_input(file, MAX_CSV_BYTES)), known)
    except InputError as error:
        source = str(path) if error.line is None else f"{path}:{error.line}"
        raise MeasurementError(source, error.cause) from error


def _parse_csv(source: str, text: str, known: Sequence[MeasurementColumn]) -> Columns:
    """Parse the text of a CSV file with the columns ``known``; ``source`` is the path."""
    empty = "".join(_CELL_SEPARATORS) + " "
    header_line = next((line for line in text.splitlines() if line.strip(empty)), "")
    separator = max(_CELL_SEPARATORS, key=header_line.count)
    try:
        lines = io.StringIO(text, newline="")
        rows = list(csv.reader(lines, strict=True, delimiter=separator))
    except csv.Error as error:
        raise MeasurementError(source, diagnose("no-csv", problem=str(error))) from error
    filled = [(line, row) for line, row in enumerate(rows, 1) if any(cell.strip() for cell in row)]
    if len(filled) < 2:
        raise MeasurementError(source, diagnose("no-rows"))
    header, body = [cell.strip() for cell in filled[0][1]], filled[1:]
    columns = list(_match_columns(source, header, known))
    for line, row in body:
        if len(row) != len(header):
            finding = diagnose("row-length", line=line, cells=len(row), columns=len(header))
            raise MeasurementError(source, finding)
    numbers, words = {}, {}
    for place, (name, column, factor) in enumerate(columns):
        cells = [row[place].strip() for _, row in body]
        # Files with semicolons usually have decimal commas.
        if column.quantity and separator == ";":
            cells = [_DECIMAL_COMMA.sub(r"\1.", cell) for cell in cells]
        if column.quantity:
            numbers[name] = factor * _parse_numbers(source, header[place], cells, body)
        else:
            words[name] = tuple(map(cell_text, cells))
    return Columns(source, numbers, words, tuple(line for line, _ in body))


def _parse_numbers(
    source: str, name: str, cells: Sequence[str], body: Sequence[tuple[int, list[str]]]
) -> Array:
    """Return the numbers of a column's cells, shape (n,), in the file's unit; NaN if missing.

    ``body`` contains (line number, cells) of each row, for error messages.
    """
    try:  # fast path: all cells are numbers
        values = np.array(cells, dtype=float)
    except ValueError:
        values = np.empty(len(cells))
        for row, cell in enumerate(cells):
            try:
                values[row] = math.nan if cell.lower() in _MISSING_CELLS else float(cell)
            except ValueError:
                error = diagnose("cell-no-number", column=name, line=body[row][0], cell=cell[:60])
                raise MeasurementError(source, error) from None
    if np.isinf(values).any():
        row = int(np.flatnonzero(np.isinf(values))[0])
        error = diagnose("cell-no-number", column=name, line=body[row][0], cell=cells[row][:60])
        raise MeasurementError(source, error)
    return values


def _match_columns(
    source: str, header: Iterable[str], known: Sequence[MeasurementColumn]
) -> Iterator[tuple[str, MeasurementColumn, float]]:
    """Match the header of each column of a file with the known columns.

    Yields:
        Name without the unit; definition of the column; factor from the unit of the file to the SI
        unit.
    """
    names = set()
    for text in header:
        match = _HEADER_PATTERN.fullmatch(text)
        name = match["name"].strip() if match else text
        column = next(
            (candidate for candidate in known if fnmatchcase(name, candidate.pattern)), None
        )
        if match is None or column is None:
            patterns = tuple(candidate.pattern for candidate in known)
            raise MeasurementError(
                source, diagnose("measurement-unknown", column=quote_short(text), known=patterns)
            )
        if name in names:
            raise MeasurementError(source, diagnose("column-twice", column=name))
        names.add(name)
        units = UNIT_FACTORS.get(column.quantity, {})
        unit = (match["unit"] or "").strip()
        if unit and unit not in units:
            error = diagnose("column-unit", column=name, unit=unit, known=tuple(units))
            raise MeasurementError(source, error)
        yield name, column, units[unit] if unit else 1.0
