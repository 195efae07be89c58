"""State the origin of a report's numbers: lines of model files, and pages of the documentation.

Inputs are a robot, or a place ``file:line`` that a result contains. Outputs are sentences and the
quoted lines of the file.
"""

from __future__ import annotations

from pathlib import Path

from pupper_analysis.base.errors import InputError
from pupper_analysis.base.inputs import read_content
from pupper_analysis.models.xml import MAX_BYTES
from pupper_analysis.present.document import Name, Text, text
from pupper_analysis.robot.robot import Robot

MAX_QUOTED_CHARACTERS, MAX_QUOTED_LINES = 400, 8
"""Limits of the text that is quoted from a model file: characters, and lines of an element.
Chosen, not tuned."""


def cite_page(name: str, heading: str) -> Text:
    """Create the text that refers to a section of the documentation, as source of numbers.

    ``name`` is the page, such as ``explanation/statics.md``.
    """
    return text("source-docs", page=name, heading=Name(heading))


def files_text(robot: Robot | None) -> Text:
    """Create the sentence that names the model files from which results were computed."""
    if robot is None:
        return text("source-own-files")
    description = robot.description
    names = {
        "urdf": Name(description.urdf_source.name),
        "mjcf": Name(description.mjcf_source.name),
    }
    if description.converted:
        return text("source-one-file", file=names["mjcf"], made=Name(description.converted.upper()))
    if is_urdf_changed(robot):
        return text("source-changed-files", **names)
    return text("source-files", **names)


def is_urdf_changed(robot: Robot) -> bool:
    """Return True if the text of a robot's URDF differs from the file, or the file is unreadable.

    False for a URDF that was converted from an MJCF, which has no file.
    """
    if robot.description.converted == "urdf":
        return False
    return robot.description.urdf != _read_source_file(robot.description.urdf_source)


def quote_line(place: str | None, *paths: str) -> str:
    """Quote the XML tag at a place in a model file: the line, with earlier lines of the tag.

    ``place`` is ``file:line``; ``paths`` are candidate files, relative to which included files are
    searched.

    Returns:
        Lines, joined by newlines, without indentation; empty if the line is not found or blank.
    """
    file, _, line = (place or "").rpartition(":")
    if not file or not line.isdigit() or int(line) < 1:
        return ""
    candidates = [Path(file)]
    for path in map(Path, paths):
        candidates += [path] if path.name == Path(file).name else []
        candidates.append(path.parent / file)
    for candidate in candidates:
        rows = _read_source_file(candidate).split("\n")[: int(line)]
        if len(rows) == int(line) and rows[-1].strip():
            return _join_element_lines(rows)
    return ""


def _join_element_lines(rows: list[str]) -> str:
    """Join the lines of the XML tag that ends on the last of ``rows``, the lines of a file.

    A long tag is shortened (`MAX_QUOTED_LINES`, `MAX_QUOTED_CHARACTERS`).
    """
    begin = len(rows) - 1
    while begin > max(0, len(rows) - MAX_QUOTED_LINES) and not rows[begin].lstrip().startswith("<"):
        begin -= 1
    if not rows[begin].lstrip().startswith("<"):
        begin = len(rows) - 1
    shown = "\n".join(row.strip() for row in rows[begin:])
    return shown if len(shown) <= MAX_QUOTED_CHARACTERS else f"{shown[:MAX_QUOTED_CHARACTERS]}…"


def _read_source_file(path: Path) -> str:
    """Return the content of a file; empty if the file cannot be read."""
    try:
        return read_content(path, MAX_BYTES).decode("utf-8", errors="replace")
    except InputError:
        return ""
