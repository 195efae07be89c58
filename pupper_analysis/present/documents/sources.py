"""Where a report's numbers come from: files and their lines, pages of the documentation, proofs."""

from __future__ import annotations

from pathlib import Path

from pupper_analysis.base.errors import InputError
from pupper_analysis.base.inputs import read_content
from pupper_analysis.models.xml import MAX_BYTES
from pupper_analysis.present.document import Name, Text, text
from pupper_analysis.robot.robot import Robot

MAX_QUOTED_CHARACTERS, MAX_QUOTED_LINES = 400, 8
"""Of an element of a file that is quoted: what stands on some lines of the page."""


def cite_page(name: str, heading: str) -> Text:
    """Returns where the documentation says how something is computed."""
    return text("source-docs", page=name, heading=Name(heading))


def files_text(robot: Robot | None) -> Text:
    """Returns which files a robot is from."""
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
    """Whether a robot's URDF is not word by word what stands in its file, if it has one."""
    if robot.description.converted == "urdf":
        return False
    return robot.description.urdf != _text(robot.description.urdf_source)


def quote_line(place: str | None, *paths: str) -> str:
    """Returns what stands at a place in a file, or nothing if there is none.

    Args:
        place: ``file:line``; the file's name, or its path.
        *paths: The files that may be meant; included ones stand beside them, or below.

    Returns:
        The line; and those before it, back to where its element begins, as an XML reader tells the
        line on which a tag ends.
    """
    file, _, line = (place or "").rpartition(":")
    if not file or not line.isdigit() or int(line) < 1:
        return ""
    candidates = [Path(file)]
    for path in map(Path, paths):
        candidates += [path] if path.name == Path(file).name else []
        candidates.append(path.parent / file)
    for candidate in candidates:
        rows = _text(candidate).split("\n")[: int(line)]
        if len(rows) == int(line) and rows[-1].strip():
            return _element(rows)
    return ""


def _element(rows: list[str]) -> str:
    """Returns the last of some lines, and those before it that belong to the same tag."""
    begin = len(rows) - 1
    while begin > max(0, len(rows) - MAX_QUOTED_LINES) and not rows[begin].lstrip().startswith("<"):
        begin -= 1
    if not rows[begin].lstrip().startswith("<"):
        begin = len(rows) - 1
    shown = "\n".join(row.strip() for row in rows[begin:])
    return shown if len(shown) <= MAX_QUOTED_CHARACTERS else f"{shown[:MAX_QUOTED_CHARACTERS]}…"


def _text(path: Path) -> str:
    try:
        return read_content(path, MAX_BYTES).decode("utf-8", errors="replace")
    except InputError:
        return ""
