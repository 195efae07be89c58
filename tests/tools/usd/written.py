"""A leg on a base, as a URDF and as a USD in all conventions that a USD may have.

The USD is in centimetres and grams, with y up, its hip about a rotated x axis, its knee from the
shank to the thigh, and its angles in degrees; all numbers are written by hand, and equal those of
the URDF.
"""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("pxr", reason="usd-core is not installed")

USD, URDF = ((Path(__file__).parent / f"leg.{end}").read_text() for end in ("usda", "urdf"))


def write(folder: Path, *changes: tuple[str, str], name: str = "leg.usda", after: str = "") -> Path:
    """Write the USD with replaced texts, each once, after the text `after`."""
    return _write_changed(folder / name, USD, changes, after)


def write_urdf(folder: Path, *changes: tuple[str, str]) -> Path:
    """Write the URDF with replaced texts, each once."""
    return _write_changed(folder / "leg.urdf", URDF, changes)


def _write_changed(
    file: Path, text: str, changes: tuple[tuple[str, str], ...], after: str = ""
) -> Path:
    head, mark, rest = text.partition(after) if after else ("", "", text)
    assert mark == after
    for old, new in changes:
        assert old in rest
        rest = rest.replace(old, new, 1)
    file.write_text(head + mark + rest)
    return file
