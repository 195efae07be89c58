"""Kinds of results, and how a file of each is recognised: only such a file is replaced unasked."""

from __future__ import annotations

import csv
import hashlib
import io
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import BinaryIO, Final

GENERATOR: Final = "pupper-analysis"
"""What results are marked with, before the version: JSON, pages and figures."""

HEAD: Final = 1 << 16
"""Bytes at a file's beginning that are looked at: the columns of a hundred joints."""

_MOST: Final = 1 << 24
"""Bytes of a plan that are looked at; ten thousand stands of a hundred joints are fewer."""


def _none(_file: BinaryIO) -> bool:
    return False


def _any(_file: BinaryIO) -> bool:
    return True


@dataclass(frozen=True)
class Kind:
    """A kind of result.

    Attributes:
        name: What it is called, in the catalogue's terms.
        owns: Whether a file is such a result, and may be replaced by another; None: that is asked
            for alone.
        keeps: Whether a file holds what no run can make again: nothing replaces it.
        edits: Whether it is read and written in place, on purpose.
    """

    name: str
    owns: Callable[[BinaryIO], bool] | None = None
    keeps: Callable[[BinaryIO], bool] = _none
    edits: bool = False


@dataclass(frozen=True)
class Folder:
    """A folder of results.

    Attributes:
        files: {name: kind} of what it gets, as far as that is known before.
    """

    files: Mapping[str, Kind]


def begins(*marks: str) -> Callable[[BinaryIO], bool]:
    """Returns what knows a file by what it begins with."""
    known = tuple(mark.encode() for mark in marks)
    return lambda file: file.read(max(map(len, known))).startswith(known)


def _is_page(file: BinaryIO) -> bool:
    return b'<meta name="generator" content="pupper_analysis ' in file.read(HEAD)


def _is_picture(file: BinaryIO) -> bool:
    head = file.read(HEAD)
    return head.startswith(b"\x89PNG") and f"tEXtSoftware\0{GENERATOR} ".encode() in head


def _plan_cells(file: BinaryIO) -> list[str] | None:
    """Returns all that stands in a plan beside what it was written with; None of no plan."""
    try:
        rows = list(csv.reader(io.StringIO(file.read(_MOST).decode("utf-8-sig"))))
    except (ValueError, csv.Error):
        return None
    head = rows[0] if rows else []
    kinds = [re.split(r"[.\[]", name)[0].strip() for name in head]
    if not {"command", "position"} <= set(kinds):
        return None
    loads = ("added", "added_x", "added_y", "added_z")
    written = ("stand", "swing", "from", "heading", "command", *loads)
    return [
        cell.strip()
        for row in rows[1:]
        for place, cell in enumerate(row)
        if cell.strip() and (place >= len(kinds) or kinds[place] not in written)
    ]


def _is_plan(file: BinaryIO) -> bool:
    return _plan_cells(file) == []


def _is_filled_in(file: BinaryIO) -> bool:
    return bool(_plan_cells(file))


RESULTS: Final = Kind("JSON result", begins(f'{{\n  "generator": "{GENERATOR} '))
PAGE: Final = Kind("report page", _is_page)
PICTURE: Final = Kind("figure", _is_picture)
STAND_TABLE: Final = Kind("table of a stand", begins("joint,position (rad),torque (N m),"))
PLAN: Final = Kind("plan of stands", _is_plan, keeps=_is_filled_in)
RECORD: Final = Kind("table of stands", lambda file: _plan_cells(file) is not None, edits=True)
OFFSETS: Final = Kind("table of offsets", begins("joint,offset_rad,offset_deg\n"))
MODEL: Final = Kind("model")
"""A model: people go on with it, so that it is replaced when it is asked for alone."""


def hash_of(content: bytes) -> str:
    """Returns what a file that was written is known by while nobody has edited it."""
    return hashlib.sha256(content).hexdigest()


def made_model(known: str | None) -> Kind:
    """Returns the kind of a model that has that hash if nobody has edited it; None: of any."""
    if known is None:
        return MODEL
    return Kind("model as a fit has written it", lambda file: hash_of(file.read()) == known)


OWN: Final = Kind("model", _any)
"""A file whose name follows from its content."""
EDITED: Final = Kind("model", _any, edits=True)
"""A file that was read, known for what it is, and is written in place."""

SAMPLES: Final = Kind("table of samples", begins("# Samples of a fitted robot."))
FIT_FOLDER: Final = Folder(
    {
        "fit.json": RESULTS,
        "offsets.csv": OFFSETS,
        "samples.csv": SAMPLES,
    }
)
"""What ``fit -o`` writes beside models."""
