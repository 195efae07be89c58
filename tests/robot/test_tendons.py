"""Constraints of an MJCF that stands do not satisfy give notes on loading."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.robot.tendons import SUPPORTED_EQUALITIES, report_ignored_equalities
from tests.support.legged import quadruped, rewrite_file

ENDING = "</mujoco>"
REPORTED = ("mjEQ_FLEX", "mjEQ_FLEXVERT", "mjEQ_FLEXSTRAIN")
REMOVED = "mjEQ_DISTANCE"  # MuJoCo refuses it since 2.2.2
CORD = '<fixed name="cord" limited="true" range="-1 1.3"><joint joint="FR_knee" coef="-1"/></fixed>'
ROPE = '<spatial limited="true" range="0 1"><site site="a"/><site site="b"/></spatial>'


@pytest.mark.slow
def test_dropped_tendon_range_gives_a_note(tmp_path: Path) -> None:
    """A fixed and a spatial tendon."""
    pair = quadruped(tmp_path)
    assert all(note.code != "tendon-ranges-not-kept" for note in pa.load_robot(*pair).notes)
    sites = '<site name="a"/><site name="b" pos="0 0 0.1"/><body name="FR_hip"'
    tendons = f"<tendon>{CORD}{ROPE}</tendon>{ENDING}"
    rewrite_file(pair.mjcf, ('<body name="FR_hip"', sites), (ENDING, tendons))
    for held in (False, True):
        notes = pa.load_robot(*pair, fixed_base=held).notes
        [message] = [note for note in notes if note.code == "tendon-ranges-not-kept"]
        assert "cord (-1 to 1.3); #1 (0 to 1)" in str(message)
    # If MuJoCo ignores the range as well, there is no note.
    off = '<option><flag limit="disable"/></option></mujoco>'
    rewrite_file(pair.mjcf, (ENDING, off))
    assert all(note.code != message.code for note in pa.load_robot(*pair).notes)


def test_each_equality_type_of_mujoco_is_supported_reported_or_removed() -> None:
    """Reference: ``mujoco.mjtEq``, so that a type of a new version fails this test."""
    known = {kind.name for kind in SUPPORTED_EQUALITIES} | {*REPORTED, REMOVED}
    assert {name for name in dir(mujoco.mjtEq) if name.startswith("mjEQ_")} == known
    scene = """<mujoco><worldbody><body pos="0 0 1"><geom size="0.1"/></body>
      <flexcomp name="cloth" type="grid" count="3 3 1" spacing="0.1 0.1 0.1" mass="1" radius="0.01">
        <edge equality="true"/></flexcomp></worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(scene)
    [message] = report_ignored_equalities(model)
    assert "(flex)" in str(message)
    model.eq_active0[:] = 0
    assert not report_ignored_equalities(model)
    for kind in np.array([kind.value for kind in SUPPORTED_EQUALITIES]):
        model.eq_active0[:], model.eq_type[:] = 1, kind
        assert not report_ignored_equalities(model)
