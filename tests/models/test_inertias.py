"""Placeholder inertias, by hand, and in the bounds of servo gains."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.models.inertias import find_placeholder_inertias
from pupper_analysis.prepare.judge import list_file_remarks
from pupper_analysis.robot.build import report_placeholder_inertias
from tests.support.commands import answer
from tests.support.legged import edited_by, quadruped, rewrite_file
from tests.support.variants import load


def test_inertias_of_a_power_of_ten_at_two_links_are_placeholders() -> None:
    """By hand: one link, unequal moments and other numbers are no placeholders."""
    inertias = [("a", 1.0), ("b", 1.0), ("c", 0.01), ("d", 0.03), ("e", 0.03)]
    balls = [(name, moment * np.eye(3)) for name, moment in inertias]
    assert find_placeholder_inertias([*balls, ("f", np.diag([0.01, 0.01, 0.02]))]) == {
        1.0: ["a", "b"]
    }


@pytest.mark.parametrize("name", ["v3", "original"])
def test_real_inertias_are_not_reported(name: str) -> None:
    assert report_placeholder_inertias(load(name)) == ()


def write_placeholders(folder: Path) -> Path:
    """Write the MJCF of a quadruped with 1 kg m^2 at each calf instead of 8e-4."""
    mjcf = quadruped(folder, floor=True, actuators="position").mjcf
    return edited_by(mjcf, lambda text: re.sub('diaginertia="8e-4[^"]*"', INERTIA, text))


INERTIA = 'diaginertia="1 1 1"'


def test_placeholder_inertias_of_a_robot_are_remarks_of_its_verdicts(tmp_path: Path) -> None:
    robot = pa.load_robot(write_placeholders(tmp_path))
    (message,) = report_placeholder_inertias(robot)
    assert message.values["links"] == ("FL_calf", "FR_calf", "RL_calf", "RR_calf")
    assert message.values["moment"].value == 1.0
    assert message in list_file_remarks(robot)


@pytest.mark.slow
def test_gains_name_placeholder_inertias_beside_the_bound_of_kd(tmp_path: Path) -> None:
    """The bound of kd is 5.9 with the inertias of the robot."""
    mjcf = write_placeholders(tmp_path)
    printed = answer("gains", str(mjcf), folder=tmp_path).stdout
    assert "kd limit rests on placeholder inertias: FL_calf and 3 more (1 kg m^2)" in printed
    rewrite_file(mjcf, (INERTIA, 'diaginertia="8e-4 8e-4 5e-5"'))
    printed = answer("gains", str(mjcf), folder=tmp_path).stdout
    assert "(at most 5.8" in printed
    assert "placeholder inertias" not in printed
