"""Wheels: horizontal cylinders on legs that cannot turn them about the direction of travel."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.stance.problem import can_move_com
from tests.support.legged import Pair, quadruped

RADIUS = 0.06


URDF = """
<link name="{leg}_wheel"><inertial><mass value="0.3"/>
<inertia ixx="4e-4" iyy="6e-4" izz="4e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="{leg}_roll_on" type="continuous"><parent link="{leg}_calf"/><child link="{leg}_wheel"/>
<origin xyz="0 0 -0.2"/><axis xyz="0 1 0"/><limit effort="20" velocity="30"/></joint>"""
MJCF = f"""<body name="{{leg}}_wheel" pos="0 0 -0.2">
<inertial pos="0 0 0" mass="0.3" diaginertia="4e-4 6e-4 4e-4"/>
<joint name="{{leg}}_roll_on" axis="0 1 0"/>
<geom type="cylinder" size="{RADIUS} 0.02" quat="1 1 0 0"/></body>"""
MOTOR = '<motor joint="{leg}_roll_on" ctrlrange="-20 20"/>'


def add_wheels(folder: Path, *legs: str, aside: float = 0.0) -> Pair:
    """Put wheels on legs of a quadruped, and remove hind legs without wheels from both files.

    The trunk's CoM is ``aside`` [m] of its centre, so that no wheel is upright if the CoM is
    centred.
    """
    pair = quadruped(folder, foot="@", keyframe="")
    urdf, mjcf = pair.urdf.read_text(), pair.mjcf.read_text()
    if "RL" not in legs:
        urdf = re.sub(r'<(link|joint) name="R.*\n', "", urdf)
        mjcf = re.sub(r'(?s)<body name="RL_hip".*?(?=\s*</body></worldbody>)', "", mjcf)
        mjcf = re.sub(r'<motor joint="R[^>]*>', "", mjcf)
    for leg in legs:
        mjcf = mjcf.replace("@", MJCF.format(leg=leg), 1)
        mjcf = mjcf.replace("</actuator>", f"{MOTOR.format(leg=leg)}</actuator>")
        urdf = urdf.replace("</robot>", f"{URDF.format(leg=leg)}\n</robot>")
    pair.urdf.write_text(
        urdf.replace('<origin xyz="0.0 0.0 0.0"/>', f'<origin xyz="0 {aside} 0"/>', 1)
    )
    pair.mjcf.write_text(mjcf.replace('<inertial pos="0 0 0"', f'<inertial pos="0 {aside} 0"', 1))
    return pair


@pytest.mark.slow
def test_wheels_touch_below_their_axles(tmp_path: Path) -> None:
    """Reference: MuJoCo. The contact forces pass through the axles at any wheel angle, so wheel
    motors have no static torque.
    """
    files = add_wheels(tmp_path, "FL", "FR", "RL", "RR", aside=0.004)
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


@pytest.mark.slow
def test_stand_on_two_wheels_is_refused(tmp_path: Path) -> None:
    files = add_wheels(tmp_path, "FL", "FR")
    robot = pa.load_robot(urdf=files.urdf, mjcf=files.mjcf)
    with pytest.raises(pa.ConfigurationError, match="along a single line"):
        pa.solve_stand(robot)
