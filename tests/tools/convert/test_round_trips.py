"""Round trips between the formats: what is lost is told."""

from __future__ import annotations

from pathlib import Path

import pytest

import pupper_analysis as pa
from tests.support.repository import ROOT
from tests.support.round_trips import of_mjcf, of_urdf, round_trip, silent_losses


@pytest.mark.parametrize("file", ["urdf/pupper_v3.urdf", "mjcf/pupper_v3.xml"])
def test_v3_there_and_back_loses_nothing_silently(tmp_path: Path, file: str) -> None:
    lost, count, _ = round_trip(ROOT / file, tmp_path)
    assert count > 90
    assert not lost


def test_a_loss_that_nobody_tells_is_seen(tmp_path: Path) -> None:
    """The tables see what either format states, apart from the package's own readers."""
    text = (ROOT / "urdf/pupper_v3.urdf").read_text()
    (tmp_path / "a.urdf").write_text(text.replace('damping="0.01"', 'damping="0.02"', 1))
    found = silent_losses(of_urdf(ROOT / "urdf/pupper_v3.urdf"), of_urdf(tmp_path / "a.urdf"), "")
    assert found == {"damping": ["leg_front_r_1"]}
    done = pa.convert_model(ROOT / "mjcf/pupper_v3.xml", tmp_path / "b.urdf")
    back = pa.convert_model(tmp_path / "b.urdf", tmp_path / "b.xml")
    before, after = of_mjcf(ROOT / "mjcf/pupper_v3.xml"), of_mjcf(tmp_path / "b.xml")
    said = " ".join(map(str, (*done.not_converted, *back.notes))).lower()
    assert "condim" in silent_losses(before, after, said.replace("condim", ""))
    assert "condim" not in silent_losses(before, after, said)
