"""Several motors at a joint become one that gives the same torque, whatever their gears."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from pupper_analysis.prepare.joints import one_at_each_joint

TWO_SERVOS = """
<mujoco><worldbody><body><joint name="knee" axis="0 1 0"/>
<geom size="0.1" pos="0.2 0 0"/></body></worldbody>
<actuator>
  <position joint="knee" kp="7" gear="2"/>
  <general joint="knee" gear="3" gainprm="5 0 0" biastype="affine" biasprm="0 -5 -0.4"/>
</actuator></mujoco>
"""


def torque(model: mujoco.MjModel) -> float:
    """Of motors whose commands are zero, at a turned and moving joint (N m)."""
    data = mujoco.MjData(model)
    data.qpos[0], data.qvel[0] = 0.3, -1.7
    mujoco.mj_forward(model, data)
    return float(data.qfrc_actuator[0])


def test_one_servo_gives_what_two_behind_gears_gave() -> None:
    spec = mujoco.MjSpec.from_string(TWO_SERVOS)
    before = torque(spec.copy().compile())
    assert len(one_at_each_joint(spec, Path("two.xml"))) == 1
    after = spec.compile()
    assert after.nu == 1
    expected = -(7 * 2**2 + 5 * 3**2) * 0.3 + 0.4 * 3**2 * 1.7
    np.testing.assert_allclose([before, torque(after)], expected, rtol=1e-12)
    assert after.actuator_gainprm[0, 0] == pytest.approx(7 + 5 * 3**2 / 2**2)
