"""Bags are unpacked within limits: rosbags unpacks each chunk, message or file as a whole."""

from __future__ import annotations

import bz2
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import IO, Any, Final

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import MeasurementError

MOST_CHUNK: Final = 500_000_000
"""Bytes of a chunk or a message, unpacked. Writers make chunks of some MB; 500 kB of zeros, packed,
are 2 GB."""

MOST_FILE: Final = 2_000_000_000
"""Bytes of a file of a bag, packed or unpacked: larger ones have cameras' topics, which can be left
out."""


@contextmanager
def bounded_unpacking() -> Iterator[None]:
    """Has rosbags refuse, while the block runs, what is larger than the limits when unpacked.

    Raises:
        MeasurementError: If something is.
    """
    from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
    from rosbags.rosbag1 import reader as ros1
    from rosbags.rosbag2 import reader
    from rosbags.rosbag2 import storage_mcap as mcap

    ros2: Any = reader

    zstd = ros2.zstd  # of Python, or its backport
    lz4, bzip = _bounded(LZ4FrameDecompressor), _bounded(bz2.BZ2Decompressor)
    standard = _bounded(zstd.ZstdDecompressor)

    class Zstd:
        """What is used of zstd, bounded."""

        decompress = staticmethod(standard)

        @staticmethod
        @contextmanager
        def open(file: IO[bytes], mode: str) -> Iterator[_Counted]:
            with zstd.open(file, mode) as unpacked:
                yield _Counted(unpacked)

    tables: tuple[dict[str, Any], ...] = (ros1.decompressors, mcap.DECOMPRESSORS)
    before = [dict(table) for table in tables]
    tables[0].update({"bz2": bzip, "lz4": lz4})
    tables[1].update({"lz4": lambda data, _: lz4(data), "zstd": lambda data, _: standard(data)})
    ros2.zstd = Zstd
    try:
        yield
    finally:
        for table, own in zip(tables, before, strict=True):
            table.update(own)
        ros2.zstd = zstd


def check_size(size: int, most: int) -> None:
    """Refuses what is larger.

    Raises:
        MeasurementError: If it is.
    """
    if size > most:
        raise MeasurementError("", diagnose("bag-too-large", most=most / 1e6))


def _bounded(decompressor: Callable[[], Any]) -> Callable[[bytes], bytes]:
    """Returns what unpacks a chunk, frame by frame, and no more of it than the limit."""

    def unpack(data: bytes) -> bytes:
        parts, size = [], 0
        while data:
            frame = decompressor()
            part = frame.decompress(data, MOST_CHUNK + 1 - size)
            size += len(part)
            check_size(size, MOST_CHUNK)
            if not frame.eof:
                raise ValueError("a chunk ends in the midst of a frame")
            parts.append(part)
            data = frame.unused_data or b""
        return b"".join(parts)

    return unpack


class _Counted:
    """A file that is read up to the limit."""

    def __init__(self, file: Any) -> None:
        self._file, self._size = file, 0

    def read(self, size: int) -> bytes:
        """Returns the next bytes."""
        data: bytes = self._file.read(size)
        self._size += len(data)
        check_size(self._size, MOST_FILE)
        return data
