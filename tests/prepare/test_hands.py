"""Hands of many fingers that follow one joint, on robots that stand."""

from __future__ import annotations

from pathlib import Path

import pytest

import pupper_analysis as pa
from pupper_analysis.pupper.variants import model_folder

FINGERS = 12


@pytest.mark.longest
def test_a_servo_that_leads_many_light_fingers_lets_the_robot_rest(tmp_path: Path) -> None:
    """Romeo's, whose hands shook at 18 Hz: a servo's damping acts on its own joint first."""
    parts = []
    for number in range(FINGERS):
        parent = f"tip{number - 1}" if number % 3 else "base_link"
        away = 0.02 if number % 3 else 0.1
        mimic = '<mimic joint="finger0"/>' if number else ""
        parts.append(
            f"""<link name="tip{number}"><inertial><origin xyz="0.001 0 0"/><mass value="0.002"/>
            <inertia ixx="1e-6" iyy="1e-6" izz="1e-6" ixy="0" ixz="0" iyz="0"/></inertial></link>
            <joint name="finger{number}" type="revolute"><parent link="{parent}"/>
            <child link="tip{number}"/><origin xyz="{away} 0 0"/><axis xyz="0 1 0"/>
            <limit lower="-1" upper="1" effort="1" velocity="1"/>{mimic}</joint>"""
        )
    file = tmp_path / "robot.urdf"
    text = (model_folder("urdf") / "pupper_v3.urdf").read_text()
    file.write_text(text.replace("</robot>", f"{''.join(parts)}</robot>"))
    robot = pa.load_robot(file)
    assert robot.closure is not None
    assert not {note.code for note in robot.notes} & {
        "no-servos-bring-it-to-rest",
        "rests-with-feed-forward-alone",
    }
    seen = pa.verify_stand(robot, pa.stance.solve_stand_on_soft_ground(robot), nudged=0.0)
    assert seen.passed, seen.failures
