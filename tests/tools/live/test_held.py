"""The page of an arm, with viser's server in the place of a browser."""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.prepare.convert.files import RobotFiles
from pupper_analysis.pupper.variants import model_folder
from pupper_analysis.tools.live.held import HeldPage, HeldSession
from pupper_analysis.tools.live.render import Language
from pupper_analysis.tools.live.state import LiveSource, source_of_files
from tests.tools.live.test_session import Browser, end, server, wait_for  # noqa: F401

pytest.importorskip("viser", reason="viser is not installed")

LENGTH, MASS = 0.2, 2.0
ARM = f"""<robot name="arm"><link name="base"/>
  <link name="upper"><inertial><origin xyz="0 0 {LENGTH}"/><mass value="{MASS}"/>
    <inertia ixx="0.02" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="pad"><inertial><mass value="0.1"/>
    <inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
    <axis xyz="0 1 0"/><limit lower="-1.004" upper="1.5" effort="9" velocity="3"/></joint>
  <joint name="grip" type="prismatic"><parent link="upper"/><child link="pad"/>
    <axis xyz="0 1 0"/><limit lower="0" upper="0.05" effort="20" velocity="1"/></joint>
</robot>"""


@pytest.fixture
def source(tmp_path: Path) -> LiveSource:
    file = tmp_path / "arm.urdf"
    file.write_text(ARM)
    return source_of_files(RobotFiles.of(str(file)))


@pytest.fixture
def session(source: LiveSource, server: Any) -> Iterator[HeldSession]:  # noqa: F811
    one = HeldSession(Browser(server), source, Language("en"))
    yield one
    end(one)


def torque_of(session: HeldSession, joint: str) -> float:
    row = re.search(rf"{joint}</td><td[^>]*>([-+.0-9]+)", session._numbers.content)
    return math.nan if row is None else float(row[1])


def test_a_slider_moves_a_joint_and_its_torque_is_that_of_the_weight(session: HeldSession) -> None:
    """A weight of 2 kg, 0.2 m from the axis, and a pad at the axis."""
    slider = session.joints.sliders["shoulder"]
    assert (slider.min, slider.max) == (-57.5, 85.5)  # deg, inside the joint's range
    for angle in (30.0, -45.0):
        slider.value = angle
        session._asked.set()
        torque = -MASS * 9.81 * LENGTH * math.sin(math.radians(angle))
        wait_for(lambda t=torque: abs(torque_of(session, "shoulder") - t) < 1e-4, "not shown")  # type: ignore[misc]
    words = shlex.split(session._command.value)
    assert words[:2] == ["pupper-analysis", "hold"]
    assert words[-1].startswith("--joints=shoulder=")
    assert float(words[-1].rpartition("=")[2]) == pytest.approx(math.radians(-45), abs=1e-5)


def test_a_slide_is_told_in_millimetres(session: HeldSession) -> None:
    session.joints.sliders["grip"].value = 30.0
    assert session.joints.changed() == {"grip": pytest.approx(0.03)}


def test_a_page_is_served_and_ends(source: LiveSource) -> None:
    page = HeldPage(source)
    assert re.fullmatch(r"http://127\.0\.0\.1:\d+/", page.address)
    page.close()
    with pytest.raises(ConfigurationError, match="has a free base"):
        HeldPage(source_of_files(RobotFiles.of(str(model_folder("mjcf") / "pupper_v3.xml"))))
