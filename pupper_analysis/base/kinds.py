"""Kinds of output files, with the tests that recognise existing files of each kind.

Without ``force``, an existing non-empty file is replaced only in two cases: ``OutputKind.owns``
recognises the file, or the file already has the new content.
"""

from __future__ import annotations

import csv
import hashlib
import io
import os
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import BinaryIO, Final

GENERATOR_NAME: Final = "pupper-analysis"
"""Name of the command, which outputs such as JSON files contain as the generator."""

NUM_HEAD_BYTES: Final = 1 << 16
"""Number of bytes that are read from the start of a file (and from the end of an animation) to
recognise some kinds of output. Chosen: longer than the header of a table with a hundred joints."""

_MAX_PLAN_BYTES: Final = 1 << 24
"""Maximum number of bytes that are read to recognise a plan of stands (CSV, see `PLAN_KIND`): 16
MiB, enough for thousands of stands. Chosen, not tuned."""


def _match_none(_file: BinaryIO) -> bool:
    """Return False for the content of any existing output file."""
    return False


def _match_any(_file: BinaryIO) -> bool:
    """Return True for the content of any existing output file."""
    return True


@dataclass(frozen=True)
class OutputKind:
    """Kind of output file, with the rule for replacing existing files.

    Attributes:
        name: Name, a term of the catalogue.
        owns: Test of whether an existing file is of this kind and may be replaced. None if an
            existing file is replaced only with ``force`` or by the same content.
        keeps: Test of whether an existing file contains data that no run can compute again, for
            example measurements. An output of this kind never replaces such a file.
        edits: Whether the run edits an input file in place.
        suffixes: Suffixes of the file names of this kind, the usual suffix first. The command line
            rejects suffixes of other formats; for a figure or page, all other suffixes. Empty: no
            check.
    """

    name: str
    owns: Callable[[BinaryIO], bool] | None = None
    keeps: Callable[[BinaryIO], bool] = _match_none
    edits: bool = False
    suffixes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Folder:
    """Output folder, with the kinds of the files in the folder.

    Attributes:
        files: {name: kind} of the files in the folder whose names are known in advance.
    """

    files: Mapping[str, OutputKind]


def match_prefix(*marks: str) -> Callable[[BinaryIO], bool]:
    """Create a function that tests whether a file starts with one of several texts."""
    prefixes = tuple(mark.encode() for mark in marks)
    return lambda file: file.read(max(map(len, prefixes))).startswith(prefixes)


def _is_page(file: BinaryIO) -> bool:
    """Return True if a file is an HTML page that this package has written."""
    return b'<meta name="generator" content="pupper_analysis ' in file.read(NUM_HEAD_BYTES)


def _is_picture(file: BinaryIO) -> bool:
    """Return True if a file is a PNG figure that this package has written."""
    head = file.read(NUM_HEAD_BYTES)
    return head.startswith(b"\x89PNG") and f"tEXtSoftware\0{GENERATOR_NAME} ".encode() in head


def _is_animation(file: BinaryIO) -> bool:
    """Return True for a GIF or MP4 that contains the name of this package near its start or end.

    The comment of a GIF is near the start, the comment of an MP4 near the end.
    """
    head = file.read(NUM_HEAD_BYTES)
    file.seek(0, os.SEEK_END)
    file.seek(max(0, file.tell() - NUM_HEAD_BYTES))
    parts = head, file.read()
    known = head.startswith(b"GIF8") or head[4:8] == b"ftyp"
    return known and any(f"{GENERATOR_NAME} ".encode() in part for part in parts)


def _read_measured_cells(file: BinaryIO) -> list[str] | None:
    """Return the cells of a plan that a measurement has filled in; None if the file is no plan.

    A plan is a CSV file of ``fit --plan`` with a row per stand, and with columns for measurements.
    """
    try:
        rows = list(csv.reader(io.StringIO(file.read(_MAX_PLAN_BYTES).decode("utf-8-sig"))))
    except (ValueError, csv.Error):
        return None
    header = rows[0] if rows else []
    columns = [re.split(r"[.\[]", name)[0].strip() for name in header]
    if not {"command", "position"} <= set(columns):
        return None
    loads = ("added", "added_x", "added_y", "added_z")
    prefilled = ("stand", "swing", "from", "heading", "command", *loads)
    return [
        cell.strip()
        for row in rows[1:]
        for column, cell in enumerate(row)
        if cell.strip() and (column >= len(columns) or columns[column] not in prefilled)
    ]


def _is_empty_plan(file: BinaryIO) -> bool:
    """Return True if a file is a CSV plan of stands to be measured, without any measurement."""
    return _read_measured_cells(file) == []


def _has_measurements(file: BinaryIO) -> bool:
    """Return True if a file is a CSV plan of stands with at least one measurement."""
    return bool(_read_measured_cells(file))


RESULTS_KIND: Final = OutputKind(
    "JSON result", match_prefix(f'{{\n  "generator": "{GENERATOR_NAME} '), suffixes=(".json",)
)
"""JSON file with results, recognised by the generator in its first entry."""

PAGE_KIND: Final = OutputKind("report page", _is_page, suffixes=(".html", ".htm"))
"""HTML report of this package."""

PICTURE_KIND: Final = OutputKind("figure", _is_picture, suffixes=(".png",))
"""PNG figure of this package."""

ANIMATION_KIND: Final = OutputKind("animation", _is_animation, suffixes=(".gif", ".mp4"))
"""Animation of this package: GIF or MP4."""

STAND_TABLE: Final = OutputKind(
    "table of a stand",
    match_prefix(
        "joint,position (rad),torque (N m),", "joint,position (rad or m),torque (N m or N),"
    ),
    suffixes=(".csv",),
)
"""CSV file with positions and torques of the joints in a stand."""

PLAN_KIND: Final = OutputKind("plan of stands", _is_empty_plan, keeps=_has_measurements)
"""CSV file with a row per stand to be measured, written by ``fit --plan``. A new plan never
replaces a plan with measurements, not even with ``force``.
"""

RECORD_KIND: Final = OutputKind(
    "table of stands", lambda file: _read_measured_cells(file) is not None, edits=True
)
"""CSV file with a row per measured stand, to which ``fit --record`` appends rows. The columns are
those of a plan of stands (`PLAN_KIND`)."""

OFFSETS_KIND: Final = OutputKind("table of offsets", match_prefix("joint,offset_rad,offset_deg\n"))
"""CSV file with the fitted encoder offsets of joints."""

MODEL_KIND: Final = OutputKind("model")
"""Model file. Users edit models, so an existing file with another content is replaced only with
``force``."""


def hash_content(content: bytes) -> str:
    """Return the SHA-256 of a file content, to detect later changes by the user."""
    return hashlib.sha256(content).hexdigest()


def generated_model_kind(known: str | None) -> OutputKind:
    """Return the replacement rule of a model file that an earlier run has written.

    Without ``force``, a file of this kind is replaced only if the user has not edited it.

    Args:
        known: SHA-256 of the content as written. None if unknown; the result is then
            ``MODEL_KIND``.
    """
    if known is None:
        return MODEL_KIND
    return OutputKind(
        "model as a fit has written it", lambda file: hash_content(file.read()) == known
    )


OWN_KIND: Final = OutputKind("model", _match_any)
"""Kind of an output file that may replace any existing file except an input of the run, for example
because the name is a hash of the content."""

EDITED_KIND: Final = OutputKind("model", _match_any, edits=True)
"""Kind of a file that the run reads and then overwrites (edits in place), for example a model."""

SAMPLES_KIND: Final = OutputKind("table of samples", match_prefix("# Samples of a fitted robot."))
"""CSV file with the samples of a fitted robot, recognised by its first line."""

FIT_FOLDER: Final = Folder(
    {
        "fit.json": RESULTS_KIND,
        "offsets.csv": OFFSETS_KIND,
        "samples.csv": SAMPLES_KIND,
    }
)
"""Files that ``fit -o`` writes in addition to models."""
