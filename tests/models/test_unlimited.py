"""Joint ranges that a URDF does not state, and efforts that only the URDF states."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.models.urdf_file import read_urdf
from pupper_analysis.tools.stand.stance import study_stance
from tests.support.conversions import compile_file, convert_file, write_standing_urdf
from tests.support.legged import biped, quadruped


def edited(path: Path, *changes: tuple[str, str]) -> Path:
    text = path.read_text()
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    path.write_text(text)
    return path


KNEE = 'lower="-2.6" upper="-0.4" effort="80"'


@pytest.mark.parametrize(
    ("limit", "free"),
    [
        ('effort="80"', True),
        ('lower="0" upper="0" effort="0"', True),
        ('lower="0.0" upper="-0" effort="0e0"', True),
        ('lower="0" upper="0" effort="80"', False),  # who gives it an effort may have locked it
        ('upper="0" effort="80"', False),
        ('lower="-1" effort="0"', False),
    ],
)
def test_a_hinge_is_unlimited_if_its_limit_element_states_no_range(
    limit: str, free: bool, tmp_path: Path
) -> None:
    """All knees; `audit` still reports the range of the file as empty."""
    urdf = edited(quadruped(tmp_path).urdf, (KNEE, limit))
    notes = [note for note in read_urdf(urdf).notes if note.code == "range-unstated"]
    assert bool(notes) is free
    if free:
        assert notes[0].values["names"] == ("FL_knee", "FR_knee", "RL_knee", "RR_knee")
    # What the audit says of the file as it is written stays.
    found = [one for one in pa.audit_model(urdf).findings if one.rule == "range-empty"]
    assert bool(found) is ('lower="-1"' not in limit)


def test_a_slide_without_a_range_stays_locked(tmp_path: Path) -> None:
    urdf = edited(
        quadruped(tmp_path).urdf,
        (KNEE, 'effort="80"'),
        ('_knee" type="revolute"', '_knee" type="prismatic"'),
    )
    assert read_urdf(urdf).notes == ()


@pytest.mark.slow
def test_the_range_of_the_mjcf_counts_if_the_urdf_states_none(tmp_path: Path) -> None:
    """Reference: -2.6 to -0.4 rad of the MJCF.

    The comparison reports the limits unless the MJCF has none either.
    """
    pair = quadruped(tmp_path)
    edited(pair.urdf, (KNEE, 'effort="80"'))
    robot = pa.load_robot(urdf=pair.urdf, mjcf=pair.mjcf)
    knees = [robot.joint_names.index(f"{leg}_knee") for leg in ("FL", "FR", "RL", "RR")]
    np.testing.assert_allclose(robot.lower_limits[knees], -2.6)
    np.testing.assert_allclose(robot.upper_limits[knees], -0.4)
    found = pa.verify_stand(robot, pa.solve_stand(robot))
    assert found.passed, found.failures
    differing = pa.compare_models(pair.urdf, pair.mjcf).differences
    assert {one.kind for one in differing} == {"lower limit", "upper limit", "effort"}
    # And where neither has one, they agree.
    edited(pair.mjcf, (' range="-2.6 -0.4"', ""), ('ctrlrange="-30 30"', 'ctrlrange="-80 80"'))
    assert pa.compare_models(pair.urdf, pair.mjcf).agree


@pytest.mark.slow
def test_a_converted_hinge_is_unlimited_if_the_urdf_states_no_range(tmp_path: Path) -> None:
    """Reference: `jnt_limited` of MuJoCo's compiled model."""
    urdf = edited(write_standing_urdf(tmp_path), ('lower="-0.8" upper="0.8" effort', "effort"))
    mjcf, found = convert_file(urdf, "quad.xml")
    assert found.passed, found.failures
    assert not any(left.code == "empty-range-left" for left in found.not_converted)
    model = compile_file(mjcf)
    assert not model.jnt_limited[model.joint("FL_roll").id]


@pytest.mark.slow
def test_a_stand_fails_if_the_efforts_of_the_urdf_are_too_small(tmp_path: Path) -> None:
    """The MJCF has no force limit, so servos get the effort of the URDF, 1 N m."""
    pair = biped(tmp_path)
    edited(pair.urdf, ('effort="80"', 'effort="1"'))
    edited(pair.mjcf, (' ctrlrange="-80 80"', ' kp="800" kv="40"'), ("<motor ", "<position "))
    robot = pa.load_robot(urdf=pair.urdf, mjcf=pair.mjcf)
    result = study_stance(robot, pa.StandTask())
    assert not result.verification.passed
    assert np.abs(result.verification.joint_torques).max() < 1 + 1e-9
    assert result.overloaded_motors
    assert not result.passed
