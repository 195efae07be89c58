"""Motion near rest, predicted by the linearised step, beside MuJoCo's simulation."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.simulation.linear import LinearStep
from pupper_analysis.simulation.rollout import full_state, simulate_commands
from pupper_analysis.simulation.trial import simulate_nudges
from tests.support.variants import load

_OSCILLATOR = """
<mujoco>
  <option timestep="0.002" gravity="0 0 0" integrator="implicitfast"/>
  <worldbody>
    <body><joint name="slide" type="slide" axis="1 0 0" stiffness="40" damping="0.5"
        range="-0.002 1" limited="{limited}"/><geom size="0.1" mass="1"/></body>
    <body pos="0 1 0"><joint name="hinge" axis="0 1 0" stiffness="3" damping="0.1"/>
      <geom type="capsule" size="0.02 0.2" mass="1"/></body>
  </worldbody>
</mujoco>
"""


def _simulate_oscillator(limited: bool, seconds: float) -> tuple[mujoco.MjModel, np.ndarray]:
    """Return the oscillator, and the states after each step from a displacement of 0.01 m."""
    model = mujoco.MjModel.from_xml_string(_OSCILLATOR.format(limited=str(limited).lower()))
    data = mujoco.MjData(model)
    data.qpos[:] = 0.01, -0.02
    steps = round(seconds / model.opt.timestep)
    return model, simulate_commands(model, full_state(model, data), np.zeros((steps, 0)))


def _linearise_step(model: mujoco.MjModel, state: np.ndarray) -> LinearStep:
    """Return the linearised step at a state."""
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    mujoco.mj_forward(model, data)
    return LinearStep(model, data)


def test_predicted_displacement_equals_simulated_displacement() -> None:
    """Reference: MuJoCo's simulation. Slide and hinge oscillate with 6.3 and 7 rad/s."""
    model, states = _simulate_oscillator(limited=False, seconds=4.0)
    linear, first = _linearise_step(model, states[99]), states[99]
    assert linear.reproduces(states[:600])
    predicted = linear.predict(states[98], first, 3.0)
    stride = 16  # 0.032 s: the largest power of two of the time step up to 0.05 s
    later = states[99 + stride :: stride][: len(predicted)]
    simulated = (later - first)[:, 1 : 1 + model.nq + model.nv]
    assert len(later) > 80
    np.testing.assert_allclose(predicted[: len(later)], simulated, atol=2e-5)


def test_prediction_is_rejected_if_a_stop_ends_the_motion() -> None:
    """The linearised step contains no stop: the slide reaches its limit 0.28 s after the start."""
    model, states = _simulate_oscillator(limited=True, seconds=0.6)
    linear = _linearise_step(model, states[10])
    assert linear.reproduces(states[10:120])
    assert not linear.reproduces(states[10:290])


@pytest.mark.slow
@pytest.mark.parametrize("kp", [None, 10.0])
def test_nudged_simulations_end_earlier_with_the_same_outcome_if_the_motion_is_predicted(
    kp: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reference: the same nudges, simulated until the bound of the speeds decides."""
    robot = load("v3")
    stand = pa.solve_stand_as_simulated(robot, pa.solve_stand(robot))
    kd = None if kp is None else kp / 100
    predicted = simulate_nudges(robot, stand, kp=kp, kd=kd)
    monkeypatch.setattr(LinearStep, "reproduces", lambda *_: False)
    bounded = simulate_nudges(robot, stand, kp=kp, kd=kd)
    assert predicted.survived
    assert bounded.survived
    assert predicted.simulated < 0.75 * bounded.simulated
