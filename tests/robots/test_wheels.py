"""Wheels: cylinders that lie, on legs that cannot turn them about the direction of travel."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.stance.problem import can_move_com
from tests.support.legged import Pair, quadruped

RADIUS = 0.06


def wheeled(folder: Path, *legs: str, aside: float = 0.0) -> Pair:
    """Puts wheels on the legs of a quadruped; others are taken off, in both files.

    The trunk's com is ``aside`` (m), so that no wheel stands upright where the com is centred.
    """
    pair = quadruped(folder, foot="", keyframe="")
    urdf, mjcf = ElementTree.parse(pair.urdf).getroot(), ElementTree.parse(pair.mjcf).getroot()
    for leg in ("FL", "FR", "RL", "RR"):
        if leg not in legs:
            _take_off(urdf, mjcf, leg)
            continue
        link = ElementTree.SubElement(urdf, "link", name=f"{leg}_wheel")
        inertial = ElementTree.SubElement(link, "inertial")
        ElementTree.SubElement(inertial, "mass", value="0.3")
        numbers = {"ixx": "4e-4", "iyy": "6e-4", "izz": "4e-4", "ixy": "0", "ixz": "0", "iyz": "0"}
        ElementTree.SubElement(inertial, "inertia", numbers)
        joint = ElementTree.SubElement(urdf, "joint", name=f"{leg}_roll_on", type="continuous")
        ElementTree.SubElement(joint, "parent", link=f"{leg}_calf")
        ElementTree.SubElement(joint, "child", link=f"{leg}_wheel")
        ElementTree.SubElement(joint, "origin", xyz="0 0 -0.2")
        ElementTree.SubElement(joint, "axis", xyz="0 1 0")
        ElementTree.SubElement(joint, "limit", effort="20", velocity="30")
        calf = next(body for body in mjcf.iter("body") if body.get("name") == f"{leg}_calf")
        calf.append(
            ElementTree.fromstring(
                f'<body name="{leg}_wheel" pos="0 0 -0.2"><inertial pos="0 0 0" mass="0.3" '
                f'diaginertia="4e-4 6e-4 4e-4"/><joint name="{leg}_roll_on" axis="0 1 0"/>'
                f'<geom type="cylinder" size="{RADIUS} 0.02" quat="1 1 0 0"/></body>'
            )
        )
        actuators = mjcf.find("actuator")
        assert actuators is not None
        ElementTree.SubElement(actuators, "motor", joint=f"{leg}_roll_on", ctrlrange="-20 20")
    trunk = next(link for link in urdf.findall("link") if link.get("name") == "trunk")
    inertial = trunk.find("inertial")
    assert inertial is not None
    for origin in inertial.findall("origin"):
        inertial.remove(origin)
    ElementTree.SubElement(inertial, "origin", xyz=f"0 {aside} 0")
    next(mjcf.iter("inertial")).set("pos", f"0 {aside} 0")
    pair.urdf.write_text(ElementTree.tostring(urdf, encoding="unicode"))
    pair.mjcf.write_text(ElementTree.tostring(mjcf, encoding="unicode"))
    return pair


def _take_off(urdf: ElementTree.Element, mjcf: ElementTree.Element, leg: str) -> None:
    for element in list(urdf):
        if str(element.get("name")).startswith(leg):
            urdf.remove(element)
    for parent in list(mjcf.iter()):
        for child in list(parent):
            if str(child.get("name", child.get("joint", ""))).startswith(leg):
                parent.remove(child)


def test_wheels_touch_below_their_axles(tmp_path: Path) -> None:
    """Forces pass through the axles, wherever the wheels turned: they hold nothing."""
    files = wheeled(tmp_path, "FL", "FR", "RL", "RR", aside=0.004)
    robot = pa.load_robot(urdf=files.urdf, mjcf=files.mjcf)
    assert set(robot.contact_radius.values()) == {RADIUS}
    assert not can_move_com(robot)
    stand = pa.stance.solve_stand_on_soft_ground(robot)
    seen = pa.verify_stand(robot, stand)
    assert seen.passed, seen.failures
    wheels = [i for i, name in enumerate(robot.joint_names) if name.endswith("_roll_on")]
    assert len(wheels) == 4
    np.testing.assert_allclose(seen.joint_torques[wheels], 0.0, atol=0.02)
    assert seen.torque_error < 1e-3


def test_two_wheels_make_no_polygon(tmp_path: Path) -> None:
    files = wheeled(tmp_path, "FL", "FR")
    robot = pa.load_robot(urdf=files.urdf, mjcf=files.mjcf)
    with pytest.raises(pa.ConfigurationError, match="along a single line"):
        pa.solve_stand(robot)
