"""The limit of stability of servos: closed forms, and MuJoCo itself on both sides of it."""

import math

import mujoco
import numpy as np
import pytest

from pupper_analysis.robot.servo_stability import servo_stability

INERTIA, DAMPING = 0.01, 0.02  # kg m^2, N m s/rad of the joint itself


def wheel(kp: float, kd: float, integrator: str, timestep: float) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(f"""
      <mujoco><option timestep="{timestep}" integrator="{integrator}" gravity="0 0 0"/>
        <worldbody><body><joint name="j" axis="0 0 1" damping="{DAMPING}"/>
          <inertial pos="0 0 0" mass="1" diaginertia="{INERTIA} {INERTIA} {INERTIA}"/></body>
        </worldbody>
        <actuator><position joint="j" kp="{kp}" kv="{kd}"/></actuator></mujoco>""")


def limit(kp: float, kd: float, integrator: str, timestep: float) -> float:
    model = wheel(kp, kd, integrator, timestep)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    gains = (np.array([value]) for value in (kp, kd, DAMPING))
    found = servo_stability(model, data, *gains)
    assert found is not None
    return found.timestep


def grows(kp: float, kd: float, integrator: str, timestep: float) -> bool:
    model = wheel(kp, kd, integrator, timestep)
    data = mujoco.MjData(model)
    data.qpos[0] = 1e-6
    for _ in range(4000):
        mujoco.mj_step(model, data)
        if abs(data.qpos[0]) > 1e-3:
            return True
    return False


def test_the_closed_form_of_one_joint() -> None:
    """Euler: h kd + h^2 kp / 2 = 2 I + h d; implicit: h^2 kp / 2 = 2 I + h (d + kd)."""
    kp, kd = 50.0, 3.0
    for integrator, linear in (("Euler", kd - DAMPING), ("implicitfast", -(kd + DAMPING))):
        step = (-linear + math.sqrt(linear**2 + 4 * INERTIA * kp)) / kp
        assert limit(kp, kd, integrator, 0.5) == pytest.approx(step, rel=1e-9)


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast", "implicit"])
@pytest.mark.parametrize(("kp", "kd"), [(50.0, 3.0), (300.0, 0.1), (5.0, 1.0)])
def test_mujoco_diverges_beyond_it_and_not_before(kp: float, kd: float, integrator: str) -> None:
    step = limit(kp, kd, integrator, 0.5)
    assert not grows(kp, kd, integrator, 0.99 * step)
    assert grows(kp, kd, integrator, 1.01 * step)


def test_a_stable_time_step_is_kept() -> None:
    assert limit(5.0, 0.1, "Euler", 0.001) == 0.001
