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


def test_contact_of_overlapping_bodies_is_the_cause_of_a_deviation(tmp_path: Path) -> None:
    """Spheres 100 mm below parallel hinges push each other: a torque that the statics lack.

    Reference: with ``<exclude>`` in the file, MuJoCo agrees with the statics.
    """
    pushing = ARMS.replace('axis="0 1 0"', 'axis="1 0 0"').replace(
        'size="0.05"', 'size="0.05" pos="0 0 -0.1"'
    )
    pushing = pushing.replace('kp="50"', 'kp="50" kv="2"')
    path = tmp_path / "arms.xml"
    path.write_text(pushing)
    published = pa.hold_posture(pa.load_robot(path)).verdict.published
    assert published is not None
    assert published.differs
    (cause,) = published.causes
    assert (cause.code, cause.elements) == ("overlaps", ("left/right 10 mm",))
    exclude = '<contact><exclude body1="left" body2="right"/></contact>'
    path.write_text(pushing.replace("<actuator>", exclude + "<actuator>"))
    published = pa.hold_posture(pa.load_robot(path)).verdict.published
    assert published is not None
    assert not published.differs
