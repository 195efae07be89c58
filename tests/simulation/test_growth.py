"""Growing modes in nudged simulations of models whose growth rates have closed forms."""

from __future__ import annotations

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from pupper_analysis.robot.stability import HOLD_DURATION, Mode, step_stability
from pupper_analysis.simulation.causes import describe_growth
from pupper_analysis.simulation.growth import (
    LONGEST_TRIAL,
    _doubling_time_of,
    _make_displacement,
    confirm_growth,
    simulate_growth,
)
from pupper_analysis.simulation.rollout import full_state
from pupper_analysis.simulation.stability import judge_stability

MOMENT, INERTIA = 6.0, 0.3
"""Weight of the rod times the distance of its CoM from the hinge (N m); armature (kg m^2)."""


def rod(kp: float, kd: float, joint: str = "", more: str = "", step: float = 0.002) -> str:
    """Return a rod that stands upright on a hinge with a position servo."""
    length = MOMENT / 9.81
    return f"""
      <mujoco><option timestep="{step}" integrator="implicitfast"/>
        <worldbody><body name="rod"><joint name="hinge" axis="0 1 0" armature="{INERTIA}" {joint}/>
          <inertial pos="0 0 {length}" mass="1" diaginertia="1e-9 1e-9 1e-9"/>{more}</body>
        </worldbody>
        <actuator><position joint="hinge" kp="{kp}" kv="{kd}"/></actuator></mujoco>"""


def judge_model(xml: str) -> tuple[object, object]:
    """Return the step stability of a model and the verdict on its modes."""
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return step_stability(model, data, settle=0.0), judge_stability(model, data, settle=0.0)


@pytest.mark.parametrize("kp", [5.8, 5.0, 2.0])
def test_the_doubling_time_of_a_confirmed_mode_is_that_of_the_pendulum(kp: float) -> None:
    """Closed form: I s^2 + kd s + kp - m g l = 0."""
    kd = 0.4
    inertia = INERTIA + (MOMENT / 9.81) ** 2
    rate = max(np.roots([inertia, kd, kp - MOMENT]).real)
    _, found = judge_model(rod(kp, kd))
    (mode,) = found.modes_growing_within()
    assert mode.doubling_time == pytest.approx(math.log(2) / rate, rel=2e-3)
    assert mode.nudge == pytest.approx(1e-4)
    assert not found.refuted_modes


def test_growing_mode_is_refuted_if_a_stop_ends_it() -> None:
    """The rod buckles until it touches soft stops at 20 um, which hold the rod."""
    stops = "".join(
        f'<geom type="box" size=".01 .1 .1" pos="{x} 0 .5"/>' for x in (-0.0200101, 0.0200101)
    )
    xml = rod(5.0, 0.4, more='<geom type="box" size=".01 .05 .05" pos="0 0 .5"/>')
    xml = xml.replace("<worldbody>", f"<worldbody>{stops}")
    spectrum, found = judge_model(xml)
    assert spectrum.modes_growing_within()
    assert not found.modes_growing_within()
    assert [mode.growth for mode in found.refuted_modes] == [
        mode.growth for mode in spectrum.modes_growing_within()
    ]


@pytest.mark.parametrize(
    ("stop", "until_left", "grows"), [(3e-3, True, False), (3e-3, False, True), (0.03, True, True)]
)
def test_growth_that_ends_before_the_stand_is_left_is_a_transient(
    stop: float, until_left: bool, grows: bool
) -> None:
    """Closed form: the rod doubles in 1.02 s from 0.1 mrad until it rests at its joint limits.

    At 3 mrad it has doubled 4.9 times. A displacement of 10 mrad leaves the stand.
    """
    limits = f'range="{-stop} {stop}" limited="true" solreflimit="0.02 1"'
    model = mujoco.MjModel.from_xml_string(rod(5.5, 0.4, joint=limits).replace(*RADIANS))
    data = mujoco.MjData(model)
    (mode,) = step_stability(model, data, settle=0.0).unstable
    start = full_state(model, data)
    trial = simulate_growth(model, start, data.ctrl, [mode], 1e-4, 0.1, until_left=until_left)
    if grows:
        assert trial.doubling_time == pytest.approx(mode.doubling_time, rel=0.1)
    else:
        assert trial.doubling_time is None


def test_growth_test_starts_anew_at_the_end_of_a_late_transient() -> None:
    """Closed form: the rod doubles in 6 s from 0.1 mrad until it rests at its limits of 1 mrad.

    Growth ends after 20 s. Two doubling times later, the trial starts anew, up to the longest time.
    """
    inertia = INERTIA + (MOMENT / 9.81) ** 2
    rate = math.log(2) / 6.0
    kp = MOMENT - 0.4 * rate - inertia * rate**2
    limits = 'range="-0.001 0.001" limited="true" solreflimit="0.02 1"'
    model = mujoco.MjModel.from_xml_string(rod(kp, 0.4, joint=limits).replace(*RADIANS))
    data = mujoco.MjData(model)
    (mode,) = step_stability(model, data, settle=0.0).unstable
    assert mode.doubling_time == pytest.approx(6.0, rel=0.02)
    start = full_state(model, data)
    trial = simulate_growth(model, start, data.ctrl, [mode], 1e-4, 0.1, until_left=True)
    assert trial.doubling_time is None
    assert trial.duration == pytest.approx(LONGEST_TRIAL, abs=2.0)


RADIANS = ("<mujoco>", '<mujoco><compiler angle="radian"/>')
"""Beginning of a model, and of one whose joint ranges are in radians."""


def test_a_fast_mode_leaves_the_displacement_along_a_slow_mode() -> None:
    """Closed form: each mode has its own largest displacement, 0.1 mrad and 0.1 rad/s.

    The fast mode grows at 1e5/s: at 0.1 rad/s it is displaced by 1 urad.
    """
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody>"
        + 2 * '<body><joint/><geom size=".1"/></body>'
        + "</worldbody></mujoco>"
    )
    fast, slow = (
        Mode(0.0, 0.0, -1.0, 1 / rate, math.log(2) / rate, (), _direction=direction)
        for rate, direction in (
            (1e5, np.array([1.0, 0.0, 1e5, 0.0])),
            (0.1, np.array([0.0, 1.0, 0.0, 0.1])),
        )
    )
    for modes in ([fast, slow], [slow, fast]):
        displacement = _make_displacement(model, modes, 1e-4, 0.1)
        np.testing.assert_allclose(displacement, [1e-6, 1e-4, 0.1, 1e-5], rtol=1e-12)


@pytest.mark.parametrize(("friction", "holds"), [(1e-3, False), (0.5, True)])
def test_dry_friction_hides_a_mode_from_the_nudge_that_it_holds(
    friction: float, holds: bool
) -> None:
    """At 10 mrad the rod's moment, (m g l - kp) x 0.01, is 0.01 N m: between both frictions."""
    spectrum, found = judge_model(rod(5.0, 0.4, joint=f'frictionloss="{friction}"'))
    assert all(mode.without_dry_friction for mode in spectrum.modes_growing_within())
    assert bool(spectrum.modes_growing_within())
    assert bool(found.modes_growing_within()) is not holds


def test_a_drift_at_constant_speed_does_not_double() -> None:
    """Reference: doubling times of closed forms: a line, 2^(t/7), and 2^(t/7) after a decay."""
    time = np.arange(200.0)
    assert _doubling_time_of(1.0 + time, 1.0, lost=False) is None
    doubling = _doubling_time_of(2.0 ** (time / 7.0), 1.0, lost=False)
    assert doubling == pytest.approx(7.0)
    assert doubling < HOLD_DURATION
    decaying = np.exp(-time / 5) + 1e-4 * 2.0 ** (time / 7.0)
    assert _doubling_time_of(decaying, 1.0, lost=False) == pytest.approx(7.0, rel=0.1)


@pytest.mark.parametrize(("kind", "expected"), [("slide", "mm"), ("hinge", "mrad")])
def test_nudge_of_a_growing_mode_has_the_unit_of_its_joint(kind: str, expected: str) -> None:
    """Reference: the type of the only joint; its spring has a stiffness of -1, so it grows."""
    mass = 'pos="1 0 0" mass="1" diaginertia="1e-3 1e-3 1e-3"'
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><option gravity="0 0 0"/><worldbody><body>'
        f'<inertial {mass}/><joint name="j" type="{kind}" axis="0 0 1"/></body></worldbody>'
        '<actuator><general joint="j" biastype="affine" gainprm="1" biasprm="0 1 0"/></actuator>'
        "</mujoco>"
    )
    (mode,) = judge_stability(model, mujoco.MjData(model)).unstable
    assert mode.nudge == pytest.approx(1e-4)
    assert f"a deviation of 0.1 {expected} doubles" in str(describe_growth(mode))


@pytest.mark.parametrize("repeated", [True, False])
def test_growth_message_states_only_a_deviation_of_position_that_was_applied(
    repeated: bool,
) -> None:
    """A mode of only one finite-difference step is tested by initial velocities."""
    model = mujoco.MjModel.from_xml_string(rod(5.0, 0.4))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    found = step_stability(model, data, settle=0.0)
    (mode,) = found.unstable
    found = replace(found, unstable=(replace(mode, repeated_at_second_step=repeated),))
    (confirmed,) = confirm_growth(found, model, data, data.ctrl).unstable
    assert confirmed.nudge == (pytest.approx(1e-4) if repeated else 0.0)
    assert ("a deviation of 0.1 mrad" in str(describe_growth(confirmed))) is repeated


def test_nudge_of_a_fast_mode_is_the_deviation_that_the_bound_of_speeds_leaves() -> None:
    """Closed form: a speed of at most 0.1 rad/s at a rate of 2000/s is 0.05 mrad."""
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><option gravity="0 0 0" timestep="1e-2"/><worldbody><body>'
        '<inertial pos="0 0 0" mass="1" diaginertia="1e-9 1e-9 1e-9"/>'
        '<joint name="j" axis="0 0 1" armature="1"/></body></worldbody></mujoco>'
    )
    mode = Mode(0.02, 0.0, -1.0, 5e-4, 5e-4 * math.log(2), ("j",))
    mode = replace(mode, _direction=np.array([1.0, 2000.0]))
    start = full_state(model, mujoco.MjData(model))
    trial = simulate_growth(model, start, np.zeros(0), [mode], 1e-4, 0.1)
    assert trial.nudge == pytest.approx(5e-5)


def test_divergence_within_the_first_window_is_growth() -> None:
    """The deviation doubled within the window of 0.5 s, as all later values are infinite."""
    assert _doubling_time_of(np.array([np.inf, np.inf]), 0.5, lost=True) == 0.5


@pytest.mark.parametrize(("friction", "sustained"), [(0.0, True), (0.5, False)])
def test_dry_friction_that_keeps_a_deviation_is_no_sustained_oscillation(
    friction: float, sustained: bool
) -> None:
    """Closed form: a hinge on a spring swings undamped with 0.3 Hz, or friction holds it.

    At 1 mrad the torque of the spring is 1 mN m. The period is longer than a window of 1 s.
    """
    frequency = 0.3
    inertia = 1.0 / (2 * math.pi * frequency) ** 2
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><option gravity="0 0 0" integrator="RK4"/><worldbody><body>'
        '<inertial pos="0 0 0" mass="1" diaginertia="1e-9 1e-9 1e-9"/>'
        f'<joint name="j" stiffness="1" armature="{inertia}" frictionloss="{friction}"/>'
        "</body></worldbody></mujoco>"
    )
    mode = Mode(0.0, frequency, 0.0, 1e6, None, ("j",), repeated_at_second_step=True)
    mode = replace(mode, _direction=np.array([1.0, 0.0]))
    assert mode.shakes
    start = full_state(model, mujoco.MjData(model))
    trial = simulate_growth(model, start, np.zeros(0), [mode], 1e-3, 1.0)
    assert trial.doubling_time is None
    assert trial.sustained is sustained


@pytest.mark.parametrize("shakes", [False, True])
def test_a_slow_deviation_that_grows_without_oscillation_does_not_shake(shakes: bool) -> None:
    """Closed form: a rod that buckles, or that swings with negative damping.

    Both double in about 14 s. In the spectrum of the rod that buckles, the frequency is set to 1
    Hz.
    """
    model = mujoco.MjModel.from_xml_string(rod(12.0, 0.0) if shakes else rod(5.98, 0.4))
    model.dof_damping[:] = -0.07 if shakes else 0.0
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    found = step_stability(model, data, settle=0.0)
    (mode,) = found.unstable
    assert mode.doubling_time is not None
    assert mode.doubling_time > HOLD_DURATION
    assert bool(mode.frequency) is shakes
    if not shakes:
        found = replace(found, unstable=(replace(mode, frequency=1.0),))
    assert found.unstable[0].shakes
    (confirmed,) = confirm_growth(found, model, data, data.ctrl).unstable
    assert confirmed.shakes is shakes
    assert confirmed.grows_within(HOLD_DURATION) is shakes
    assert confirmed.doubling_time == pytest.approx(mode.doubling_time, rel=0.1)


@pytest.mark.parametrize("damping", [250.0, 400.0, 1000.0])
def test_mode_that_makes_the_simulation_diverge_is_confirmed(damping: float) -> None:
    """Closed form: Euler's step multiplies the velocity of 1 kg by 1 - 0.01 s kd / (1 kg).

    MuJoCo resets both diverging simulations to the same state.
    """
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><option gravity="0 0 0" timestep="0.01" integrator="Euler"/><worldbody><body>'
        '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><joint name="j" type="slide"/>'
        f'</body></worldbody><actuator><position joint="j" kp="10" kv="{damping}"/></actuator>'
        "</mujoco>"
    )
    found = judge_stability(model, mujoco.MjData(model), settle=0.0)
    (mode,) = found.unstable
    assert not found.refuted_modes
    doubling_time = 0.01 * math.log(2) / math.log(0.01 * damping - 1)
    assert mode.doubling_time == pytest.approx(doubling_time, rel=0.3)


@pytest.mark.parametrize("maxima", [[1.0, 2.0, 4.0, math.inf, math.inf], [1.0, math.inf]])
def test_divergence_in_a_later_window_is_growth(maxima: list[float]) -> None:
    """Upper bound: 2 s to the divergence with 2 doublings, or 1 s without one."""
    assert _doubling_time_of(np.array(maxima), 0.5, lost=True) == pytest.approx(1.0)
