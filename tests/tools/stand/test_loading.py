"""How two files become a robot, as ``stand --explain`` shows it."""

from __future__ import annotations

from pathlib import Path

import pytest

from pupper_analysis.models.mjcf_file import read_mjcf
from pupper_analysis.models.urdf_file import read_urdf
from pupper_analysis.prepare.passes import Request, prepare_robot
from pupper_analysis.tools.stand.stance import explain_loading
from tests.support.legged import quadruped


def test_what_is_told_is_what_the_robot_has(tmp_path: Path) -> None:
    pair = quadruped(tmp_path)
    files = read_urdf(pair.urdf), read_mjcf(pair.mjcf)
    explained, robot = explain_loading(*files, Request())
    assert explained.feet == tuple(robot.feet)
    assert explained.mass == pytest.approx(float(robot.mj_model.body_mass.sum()))
    _, runs = prepare_robot(*files, Request())
    assert [one.name for one in explained.passes] == [one.name for one in runs]
