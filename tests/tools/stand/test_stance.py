"""Stance of a robot with sliding knees: positions in m, motor forces in N, tables in mm and N."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

import pupper_analysis as pa
from pupper_analysis.present.document import Table, get_english
from pupper_analysis.present.documents.standing import simulated_table
from pupper_analysis.tools.stand.document import stance_document
from pupper_analysis.tools.stand.stance import study_stance
from tests.support.legged import quadruped, rewrite_file
from tests.support.slips import standing

STIFFNESS = 6000.0
"""Stiffness of the servos of the knees [N/m]."""


def telescopic(folder: Path) -> pa.Robot:
    """Return a quadruped whose knees are slides along the legs, with stiff servos."""
    text = quadruped(folder, floor=True, actuators="position", keyframe="").mjcf.read_text()
    slide = r'\1 type="slide" axis="0 0 1" range="-0.1 0.1"'
    text = re.sub(r'(name="\w+_knee") axis="0 1 0" range="-2.6 -0.4"', slide, text)
    servo = rf'\1 kp="{STIFFNESS}" kv="200"'
    text = re.sub(r'(joint="\w+_knee") kp="150" kv="5"', servo, text)
    return pa.load_robot(text.replace('kp="150" kv="5"', 'kp="600" kv="5"'))


def cell_text(cell: Any) -> str:
    """Return the English text of a cell, title or note."""
    return str(getattr(cell, "en", None) or getattr(cell, "text", cell))


@pytest.mark.slow
def test_stance_on_telescopic_legs_is_in_metres_and_newtons(tmp_path: Path) -> None:
    """Closed form: each knee carries a quarter of the weight above it, and sags by force / kp."""
    robot = telescopic(tmp_path)
    stance = study_stance(robot, pa.StandTask())
    knees = [name.endswith("knee") for name in robot.joint_names]
    units = tuple("N" if knee else "N m" for knee in knees)
    assert stance.statics.torque_units == stance.verification.torque_units == units
    assert tuple(limit.unit for limit in robot.efforts) == units

    calf = robot.mj_model.body("FL_calf").mass[0]
    force = (robot.total_mass / 4 - calf) * 9.81
    sag = force / STIFFNESS
    assert stance.sagging.joint_error_unit == "m"
    assert stance.sagging.joint_error == pytest.approx(sag, rel=0.01)
    rows = {cell_text(row[0]): row for row in simulated_table(stance.sagging).rows}
    assert [cell_text(cell) for cell in rows["joint error"][1:]] == [f"{1e3 * sag:.2g}", "mm"]

    tables = [block for block in stance_document(stance).blocks if isinstance(block, Table)]
    torques = next(table for table in tables if cell_text(table.title) == "Motor torques")
    (knee,) = [row for row in torques.rows if cell_text(row[0]) == "FL_knee"]
    position = 1e3 * stance.joint_positions[knees.index(True)]
    assert float(cell_text(knee[-1])) == pytest.approx(position, abs=5e-3)

    stance.to_csv(tmp_path / "joints.csv")
    header = (tmp_path / "joints.csv").read_text().splitlines()[0]
    assert header.startswith("joint,position (rad or m),torque (N m or N),limit (N m or N)")


def test_efforts_of_a_slide_are_stated_in_newtons(tmp_path: Path) -> None:
    robot = telescopic(tmp_path)
    with pytest.raises(pa.ConfigurationError, match="-30 N at FL_knee"):
        pa.robot.with_efforts(robot, {"FL_knee": -30.0})
    notes = " ".join(str(note) for note in pa.robot.with_efforts(robot, {"FL_knee": 30.0}).notes)
    assert "FL_knee 30 N" in notes
    assert "30 N m" not in notes


@pytest.mark.slow
def test_refusal_of_the_file_by_mujoco_is_among_the_first_findings(tmp_path: Path) -> None:
    """MuJoCo refuses the file, since a mesh is missing; the package leaves the mesh out.

    The second line on the terminal starts with the first finding after the number.
    """
    pair = standing(tmp_path)
    mesh = '<asset><mesh file="gone.stl"/></asset><worldbody>'
    geom = '<geom type="mesh" mesh="gone" contype="0" conaffinity="0"/>'
    rewrite_file(pair.mjcf, ("<worldbody>", mesh), ("<inertial", f"{geom}<inertial"), count=1)
    robot = pa.load_robot(*pair)
    document = stance_document(study_stance(robot, pa.StandTask()), robot)
    findings = [get_english(words) for words in document.findings]
    assert "MuJoCo refuses the file: gone.stl missing" in findings[:2]
