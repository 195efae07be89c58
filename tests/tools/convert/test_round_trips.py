"""Round trips between the formats: what is lost is told."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.repository import ROOT
from tests.support.round_trips import round_trip


@pytest.mark.parametrize("file", ["urdf/pupper_v3.urdf", "mjcf/pupper_v3.xml"])
def test_v3_there_and_back_loses_nothing_silently(tmp_path: Path, file: str) -> None:
    lost, count = round_trip(ROOT / file, tmp_path)
    assert count > 90
    assert not lost
