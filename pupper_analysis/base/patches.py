"""Patches: changes of text files in the format of ``diff -u``, for ``git apply`` and ``patch -p1``.

Input is the content of a file before and after the changes. The patch applies in the working
folder, or in the folder of the file if the file is elsewhere.
"""

from __future__ import annotations

import difflib
import io
import os
from pathlib import Path


def make_patch(path: Path, before: bytes, after: bytes) -> str:
    r"""Return the changes of a UTF-8 file as a patch; empty without changes.

    A line ends at a line feed, as for ``git`` and ``patch``; a carriage return belongs to the line.

    Args:
        path: The file. The patch names it relative to the working folder. A file that is not below
            the working folder is named without its folder.
        before: Present content of the file.
        after: New content of the file.
    """
    old_lines, new_lines = (
        [*io.StringIO(text.decode("utf-8"), newline="\n")] for text in (before, after)
    )
    name = _relative_name(path)
    lines = difflib.unified_diff(old_lines, new_lines, f"a/{name}", f"b/{name}")
    return "".join(line if line.endswith("\n") else line + _NO_LINE_END for line in lines)


_NO_LINE_END = "\n\\ No newline at end of file\n"
"""Text of a patch after a line without line end: the last line of a file."""


def _relative_name(path: Path) -> str:
    """Return the name of a file in a patch, relative to the working folder if below it.

    A tab follows a name with a space, so that ``patch`` finds the end of the name.
    """
    absolute, here = (Path(os.path.normpath(place.absolute())) for place in (path, Path()))
    relative = absolute.relative_to(here) if absolute.is_relative_to(here) else Path(path.name)
    name = relative.as_posix()
    return f"{name}\t" if " " in name else name
