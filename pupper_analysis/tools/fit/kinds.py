"""File type of a trace of a policy, and recognition of its content."""

from __future__ import annotations

from typing import BinaryIO, Final

from pupper_analysis.base.kinds import NUM_HEAD_BYTES, OutputKind


def _is_trace(file: BinaryIO) -> bool:
    """Return True if a file is a policy trace: a zip archive that contains ``observations.npy``.

    The name must occur in the first `NUM_HEAD_BYTES` bytes.
    """
    head = file.read(NUM_HEAD_BYTES)
    return head.startswith(b"PK") and b"observations.npy" in head


TRACE_KIND: Final = OutputKind("trace", _is_trace, suffixes=(".npz",))
"""npz file with the arrays of a trace, which ``walk --trace`` reads. A new trace may replace a file
of this kind.
"""
