"""Contacts between shapes that overlap in the initial pose."""

from __future__ import annotations

from pathlib import Path

import pytest

import pupper_analysis as pa
from pupper_analysis.base.diagnostics import Diagnostic, Quantity

ARMS = """<mujoco><worldbody><body name="base">
  <geom size="0.01" mass="1"/>
  <body name="left" pos="0 0.045 0.3"><joint name="left" axis="0 1 0" range="-1 1"/>
    <geom size="0.05" mass="1"/></body>
  <body name="right" pos="0 -0.045 0.3"><joint name="right" axis="0 1 0" range="-1 1"/>
    <geom size="0.05" mass="1"/></body>
  </body></worldbody><actuator><position joint="left" kp="50"/><position joint="right" kp="50"/>
</actuator></mujoco>"""
"""Two spheres of 50 mm, whose centres are 90 mm apart."""


def test_note_on_overlapping_bodies_states_the_depth(tmp_path: Path) -> None:
    """Reference: two radii minus the distance of the centres."""
    path = tmp_path / "arms.xml"
    path.write_text(ARMS)
    notes = pa.load_robot(path).notes
    (note,) = (note for note in notes if note.code == "overlapping-bodies-do-not-touch")
    pairs = note.values["pairs"]
    assert isinstance(pairs, tuple)
    (pair,) = pairs
    assert isinstance(pair, Diagnostic)
    assert (pair.values["one"], pair.values["two"]) == ("left", "right")
    depth = pair.values["depth"]
    assert isinstance(depth, Quantity)
    assert depth.value == pytest.approx(0.01)
