"""What a fall is, in bare MuJoCo."""

from __future__ import annotations

import mujoco
import pytest

from pupper_analysis.models.mjcf import silence_mujoco
from pupper_analysis.robot.fall import began_anew, held_motion, own_motion

SERVO = """<mujoco><option timestep="0.002"/><worldbody><geom type="plane" size="0 0 1"/>
<body pos="0 0 0.1"><freejoint/><geom type="box" size="0.1 0.1 0.1" mass="1"/>
<body><joint name="wheel" armature="0.1"/>
<geom size="0.01" mass="0.1" contype="0" conaffinity="0"/></body></body>
</worldbody><actuator><position joint="wheel" kp="10" kv="1"/></actuator></mujoco>"""


@pytest.mark.parametrize(("ctrl", "lost"), [(0.0, False), (1.0, False), (9e9, True)])
def test_what_is_lost_in_its_first_step_has_diverged(ctrl: float, lost: bool) -> None:
    """MuJoCo begins anew, commanded nothing, at the time at which it began: that looks calm."""
    model = mujoco.MjModel.from_xml_string(SERVO)
    start = mujoco.MjData(model)
    start.ctrl[:] = ctrl

    def advance(data: mujoco.MjData, seconds: float) -> None:
        mujoco.mj_step(model, data, round(seconds / model.opt.timestep))

    with silence_mujoco():
        motion, end = own_motion(model, start, 1, 0.0, advance)
        held, _ = held_motion(model, start, advance)
    assert end.time == pytest.approx(motion.duration, abs=2 * model.opt.timestep)
    assert began_anew(end) is motion.diverged is motion.collapses is held.diverged is lost
