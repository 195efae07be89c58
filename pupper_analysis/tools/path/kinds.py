"""File type of a path table, and recognition by the header line."""

from __future__ import annotations

from typing import BinaryIO, Final

from pupper_analysis.base.kinds import NUM_HEAD_BYTES, OutputKind


def _is_path_table(file: BinaryIO) -> bool:
    """Return True if the first line of a CSV file is the header of a path table."""
    head, _, _ = file.read(NUM_HEAD_BYTES).partition(b"\n")
    columns = head.decode(errors="replace").split(",")
    return columns[0] == "time (s)" and all(
        column.startswith(("q ", "tau ")) for column in columns[1:]
    )  # fmt: skip


PATH_TABLE: Final = OutputKind("table of a path", _is_path_table)
"""File kind of the CSV that `StancePath.to_csv` writes and may replace."""
