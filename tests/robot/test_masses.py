"""Masses that the files of a robot do not state."""

from __future__ import annotations

from pathlib import Path

import pytest

import pupper_analysis as pa
from pupper_analysis.robot.masses import describe_missing_masses
from tests.support.legged import quadruped, rewrite_file


@pytest.mark.parametrize("part", ["trunk", "FL_calf"])
def test_payload_at_a_body_without_mass_does_not_state_the_mass_of_the_body(
    part: str, tmp_path: Path
) -> None:
    """`workspace` with a payload on the trunk answered RANGE. Reference: the robot as loaded."""
    mjcf = quadruped(tmp_path).mjcf
    text = mjcf.read_text()
    body = text[text.index(f'<body name="{part}"') :]
    inertial = body[body.index("<inertial") : body.index("/>", body.index("<inertial")) + 2]
    mjcf.write_text(text.replace(body, body.replace(inertial, "", 1)))
    compiler = '<compiler boundmass="0.001" boundinertia="1e-7" inertiafromgeom="false"'
    rewrite_file(mjcf, ("<compiler", compiler))
    robot = pa.load_robot(mjcf=mjcf)
    loaded = pa.robot.with_payload(robot, 1.0, (part, 0.0, 0.0, 0.0))
    for message in map(describe_missing_masses, (robot, loaded)):
        assert message is not None
        assert message.values["bounded"] == (part,)
