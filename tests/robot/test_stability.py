"""Eigenvalues of a simulation step, compared with closed forms and with nudged simulations."""

from __future__ import annotations

import copy
import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.robot.stability import (
    Mode,
    _evaluate_friction,
    remove_negligible_friction,
    step_derivative,
)
from pupper_analysis.simulation.causes import find_instability
from pupper_analysis.simulation.rollout import full_state, simulate_commands
from pupper_analysis.simulation.stability import Nudge, measure_response
from tests.support.repository import benchmark
from tests.support.variants import load, stand_of

INERTIA, MOMENT = 0.3, 6.0  # kg m^2 of the rotor; m g l of 1 kg (N m)


def pendulum(kp: float, kd: float, integrator: str = "Euler", timestep: float = 0.002) -> str:
    """Return a rod upside down, on a servo."""
    mass, length = 1.0, MOMENT / 9.81
    return f"""
      <mujoco><option timestep="{timestep}" integrator="{integrator}" gravity="0 0 -9.81"/>
        <worldbody><body name="rod"><joint name="hinge" axis="0 1 0" armature="{INERTIA}"/>
          <inertial pos="0 0 {length}" mass="{mass}" diaginertia="1e-9 1e-9 1e-9"/></body>
        </worldbody>
        <actuator><position joint="hinge" kp="{kp}" kv="{kd}"/></actuator></mujoco>"""


def make_stability(xml: str, settle: float = 0.0, off: float = 0.0) -> pa.robot.Stability:
    """Return the step stability of a model with the first coordinate displaced by `off`."""
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    data.qpos[0] = off
    return pa.robot.step_stability(model, data, settle=settle)


def compute_exponents(kp: float, kd: float) -> np.ndarray:
    """Of the pendulum in continuous time: I s^2 + kd s + kp - m g l = 0."""
    inertia = INERTIA + (MOMENT / 9.81) ** 2
    return np.roots([inertia, kd, kp - MOMENT])


def euler(kp: float, kd: float, step: float, implicit: bool) -> np.ndarray:
    """Eigenvalues of v' = v + h a, x' = x + h v', with kd explicit or implicit."""
    inertia = INERTIA + (MOMENT / 9.81) ** 2
    stiff, damp = (MOMENT - kp) / inertia, kd / inertia
    if implicit:
        scale = 1 / (1 + step * damp)
        rows = [[1 + step**2 * stiff * scale, step * scale], [step * stiff * scale, scale]]
    else:
        left = 1 - step * damp
        rows = [[1 + step**2 * stiff, step * left], [step * stiff, left]]
    return np.linalg.eigvals(np.array(rows))


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast", "RK4"])
def test_inverted_pendulum_diverges_at_the_rate_of_the_closed_form(integrator: str) -> None:
    """Closed form for Kp below m g l: one real mode grows."""
    kp, kd, step = 5.0, 0.4, 0.002
    found = make_stability(pendulum(kp, kd, integrator, step))
    (mode,) = found.unstable
    if integrator == "RK4":
        z = max(compute_exponents(kp, kd)) * step
        radius = float(sum(z**k / math.factorial(k) for k in range(5)))
    else:
        radius = float(max(abs(euler(kp, kd, step, integrator != "Euler"))))
    assert found.radius == pytest.approx(radius, abs=1e-9)
    assert mode.doubling_time == pytest.approx(math.log(2) * step / math.log(radius), rel=1e-5)
    assert mode.doubling_time == pytest.approx(
        math.log(2) / max(compute_exponents(kp, kd)), rel=2e-2
    )
    assert mode.frequency == 0
    assert not mode.shakes
    assert mode.joints == ("hinge",)


def test_damping_ratio_of_a_servo_equals_the_closed_form() -> None:
    """Closed form: kd / (2 I w), w = sqrt((kp - m g l) / I), and the damped frequency [Hz]."""
    kp, kd, step = 80.0, 1.2, 1e-4
    found = make_stability(pendulum(kp, kd, "implicitfast", step))
    inertia = INERTIA + (MOMENT / 9.81) ** 2
    natural = math.sqrt((kp - MOMENT) / inertia)
    ratio = kd / (2 * inertia * natural)
    assert found.stable
    assert found.doubling_time is None
    assert found.least_damped is not None
    assert found.least_damped.damping_ratio == pytest.approx(ratio, rel=1e-2)
    damped = natural * math.sqrt(1 - ratio**2) / (2 * math.pi)
    assert found.least_damped.frequency == pytest.approx(damped, rel=1e-3)


def test_oscillation_without_damping_neither_grows_nor_decays() -> None:
    """Closed form: Euler's semi-implicit step conserves the amplitude; the ratio is zero."""
    found = make_stability(pendulum(80.0, 0.0))
    assert found.stable
    assert found.least_damped is not None
    assert found.least_damped.damping_ratio == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize("kd", [0.0, 600.0])
@pytest.mark.parametrize("integrator", ["Euler", "implicitfast"])
def test_servo_beyond_its_discrete_stability_limit_shakes(kd: float, integrator: str) -> None:
    """Reference: eigenvalues of Euler's step in closed form; the unstable mode has half the
    sampling frequency."""
    step, kp = 0.02, 9000.0
    values = euler(kp, kd, step, integrator != "Euler")
    found = make_stability(pendulum(kp, kd, integrator, step), settle=0.5, off=1e-9)
    assert found.radius == pytest.approx(max(abs(values)), rel=1e-6)
    assert found.stable == (max(abs(values)) <= 1)
    if not found.stable:
        (mode,) = found.unstable
        assert mode.shakes
        assert mode.frequency == pytest.approx(1 / (2 * step))


def test_finite_difference_step_equals_mjd_transition_fd() -> None:
    """Used for RK4, which ``mjd_transitionFD`` does not support.

    Compared for another integrator.
    """
    from pupper_analysis.robot.stability import _difference_steps

    robot = load("v3")
    model = copy.copy(robot.mj_model)
    model.opt.tolerance = 1e-14
    data = mujoco.MjData(model)
    robot.mj_convention.set_state(data, stand_of("v3").qpos)
    mujoco.mj_step(model, data, 100)
    own = step_derivative(model, data)
    assert _difference_steps(model, data, np.zeros_like(own)) == pytest.approx(own, abs=1e-6)


def test_spectrum_of_a_robot_that_still_sinks_is_marked_as_not_at_rest() -> None:
    """On servos of 2.5 N m/rad, v3 sinks by centimetres and is half-way after 0.5 s."""
    from pupper_analysis.simulation.rollout import make_stand_start
    from pupper_analysis.simulation.stability import evaluate_stability

    robot, stand = load("v3"), stand_of("v3")
    held = make_stand_start(robot, stand, feedforward=False, kp=2.5, kd=0.4)
    found = evaluate_stability(held.drive, held.start, held.ctrl)
    assert not found.at_rest
    rest = pa.simulation.stand_stability(robot, stand, feedforward=False, kp=2.5, kd=0.4)
    assert rest.at_rest
    assert rest.is_stable_for()


def test_drift_of_a_base_on_level_ground_is_no_growth(variant: str) -> None:
    """Creep of soft contacts has eigenvalues near 1, which count as stable."""
    found = pa.simulation.stand_stability(load(variant), stand_of(variant))
    assert found.stable
    assert found.is_stable_for()
    assert found.speed < 1e-3


def test_freely_rolling_wheels_count_as_stable() -> None:
    wheels = "".join(
        f'<body pos="{x} {y} 0"><joint axis="0 1 0"/><geom type="sphere" size=".1"/></body>'
        for x in (-0.2, 0.2) for y in (-0.2, 0.2)
    )  # fmt: skip
    for integrator in ("Euler", "implicitfast"):
        xml = f"""<mujoco><option integrator="{integrator}"/><worldbody>
          <geom type="plane" size="5 5 .1"/><body pos="0 0 .1"><freejoint/>
          <geom type="box" size=".2 .1 .05" pos="0 0 .05"/>{wheels}</body></worldbody></mujoco>"""
        assert make_stability(xml, settle=1.0).stable


def test_dry_friction_hides_an_unstable_servo_until_a_push_overcomes_it() -> None:
    """A servo far beyond Euler's limit rests on a joint that rubs, and is thrown off by a push."""
    step, kp, kd = 0.02, 80.0, 100.0
    rubbing = pendulum(kp, kd, "Euler", step).replace("armature", 'frictionloss="0.5" armature')
    smooth = make_stability(pendulum(kp, kd, "Euler", step))
    found = make_stability(rubbing)
    (mode,) = found.unstable
    assert mode.without_dry_friction
    assert mode.shakes
    assert found.radius < 1
    assert mode.growth == pytest.approx(smooth.radius - 1, rel=1e-6)
    model = mujoco.MjModel.from_xml_string(rubbing)
    for speed, stays in ((1e-4, True), (1.0, False)):
        data = mujoco.MjData(model)
        data.qvel[0] = speed
        mujoco.mj_step(model, data, 10)
        assert bool(abs(data.qvel[0]) < speed) is stays
    np.testing.assert_array_equal(model.dof_frictionloss, 0.5)  # which is given back


def test_growing_mode_that_dry_friction_does_not_affect_is_listed_once() -> None:
    """Two inverted pendulums, one of which dry friction holds. By hand: the growth rate of a rod of
    1 m is sqrt(3 g / 2) = 3.836 1/s."""
    pole = (
        '<body pos="{x} 0 0"><joint name="{name}" axis="0 1 0" {more}/>'
        '<geom type="capsule" fromto="0 0 0 0 0 1" size="1e-3" mass="1"/></body>'
    )
    free = pole.format(x=0, name="free", more="")
    held = pole.format(x=1, name="held", more='frictionloss="0.5"')
    text = f'<mujoco><option timestep="1e-3"/><worldbody>{free}{held}</worldbody></mujoco>'
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    # MuJoCo's regularised friction creeps, which is a slow growth of the held pendulum.
    modes = [mode for mode in _evaluate_friction(model, data).unstable if mode.grows_within(12.0)]
    assert [(mode.joints, mode.without_dry_friction) for mode in modes] in (
        [(("free",), False), (("held",), True)],
        [(("held",), True), (("free",), False)],
    )
    for mode in modes:
        assert math.log1p(mode.growth) / 1e-3 == pytest.approx(3.836, rel=5e-3)


def test_stability_does_not_depend_on_the_tolerance_of_mujocos_solver() -> None:
    """With the default tolerance, the solver is inexact by 1e-5 in one state of a hundred, and a
    mode seems to grow. The tolerance of the model is restored."""
    robot, stand = load("v3"), stand_of("v3")
    model, data = robot.mj_model, mujoco.MjData(robot.mj_model)
    robot.mj_convention.set_state(
        data, pa.stance.solve_stand_on_soft_ground(robot, stand.task).qpos
    )
    data.ctrl[:] = stand.joint_positions(robot)
    tolerance = model.opt.tolerance
    mujoco.mj_step(model, data, 1000)
    for _ in range(20):
        mujoco.mj_step(model, data, 50)
        assert pa.robot.step_stability(model, data, settle=0).stable
    assert model.opt.tolerance == tolerance


@pytest.mark.slow
def test_servos_that_shake_are_named_with_frequency_and_joints() -> None:
    """v3 on servos of which the damping is too much for Euler at 2 ms."""
    robot, stand = load("v3"), stand_of("v3")
    found = pa.verify_stand(robot, stand, kp=40.0, kd=4.0)
    assert not found.passed
    mode = found.stability.modes_growing_within()[0]
    assert mode.shakes
    assert set(mode.joints) <= set(robot.joint_names)
    assert any("the robot shakes at 250 Hz" in str(reason) for reason in found.failures)
    finer = pa.verify_stand(robot, stand, kp=40.0, kd=4.0, integrator="implicitfast")
    assert finer.stability.is_stable_for()


@pytest.mark.slow
def test_stability_verdicts_of_random_stands_agree_with_simulation() -> None:
    """60 random stands with payloads and gains; the reference is a simulation after three nudges.

    Any random nudge excites a growing mode; ``benchmarks/stability.py`` tries more nudges.
    """
    module = benchmark("stability")
    module.NUM_NUDGES = 3
    message = set()
    for case in module.draw_cases(60):
        found, _ = module.judge_case(case)
        leaving = found.modes_growing_within() if found.at_rest else ()
        if not found.at_rest:
            continue
        message.add(not leaving)
        if not leaving:
            assert module.simulate_nudges(case, 12.0).word == "stays", case.name
            continue
        # Slow ones take longer than 12 s; what dry friction holds, a push beyond it sets free.
        seen = module.simulate_case(case, leaving)
        assert seen.word != "stays", (case.name, leaving[0])
    assert message == {True, False}


def test_transient_excursion_counts_as_leaving() -> None:
    """A damped swing is furthest at v/w exp(-z acos(z) / sqrt(1 - z^2)), and forgotten at last."""
    natural, damping, speed = 20.0, 0.3, 1.0
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option timestep="0.0005" gravity="0 0 0" integrator="RK4"/><worldbody><body>
        <joint name="swing" stiffness="{natural**2}" damping="{2 * damping * natural}"/>
        <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></worldbody></mujoco>"""
    )
    before = full_state(model, mujoco.MjData(model))
    start = before.copy()
    start[1 + model.nq] = speed
    found = measure_response(model, before, simulate_commands(model, start, np.zeros((8000, 0))))
    angle = math.acos(damping)
    way = speed / natural * math.exp(-damping * angle / math.sin(angle))
    assert found.farthest == pytest.approx(way, rel=1e-4)
    assert found.decayed
    assert found.moved < 1e-6
    assert not found.stays
    stability = pa.robot.step_stability(model, mujoco.MjData(model))
    (warning,) = find_instability(stability, found)
    assert "a joint moves 2 deg from its position, and returns" in str(warning)
    assert not find_instability(stability, replace(found, farthest=9e-3))
    slide = simulate_slide()
    (warning,) = find_instability(stability, slide)
    assert "a joint moves 20 mm from its position, and returns" in str(warning)


def simulate_slide() -> Nudge:
    """Return the response of the same swing along a line [m], for which mm are printed."""
    natural, damping = 20.0, 0.3
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option timestep="0.0005" gravity="0 0 0" integrator="RK4"/><worldbody><body>
        <joint type="slide" stiffness="{natural**2}" damping="{2 * damping * natural}"/>
        <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></worldbody></mujoco>"""
    )
    before = full_state(model, mujoco.MjData(model))
    start = before.copy()
    start[1 + model.nq] = 0.5
    return measure_response(model, before, simulate_commands(model, start, np.zeros((8000, 0))))


def test_frequency_at_a_joint_limit_is_that_of_the_servo() -> None:
    """Reference: sqrt(kp / I) / (2 pi), at the limit as well as off it.

    Finite differences across the limit would average servo and limit.
    """
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><option gravity="0 0 0" timestep="0.001"/><compiler angle="radian"/><worldbody>'
        '<body><joint name="j" axis="0 1 0" range="-1 0" limited="true" solreflimit="0.01 1"/>'
        '<inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/></body></worldbody>'
        '<actuator><position joint="j" kp="1" kv="0.002"/></actuator></mujoco>'
    )
    swings = []
    for place in (0.0, -0.1):
        data = mujoco.MjData(model)
        data.qpos[0] = data.ctrl[0] = place
        mujoco.mj_forward(model, data)
        least = pa.robot.step_stability(model, data, settle=0.0).least_damped
        assert least is not None
        swings.append(least.frequency)
    assert swings == pytest.approx([math.sqrt(1 / 0.01) / (2 * math.pi)] * 2, rel=1e-2)
    assert model.jnt_range[0].tolist() == [-1.0, 0.0]


@pytest.mark.parametrize(
    ("frequency", "time_constant", "shakes"),
    [(2.0, 1.0, True), (2.0, 0.05, False), (0.07, 100.0, False), (0.1, 100.0, True)],
)
def test_mode_shakes_if_it_oscillates_faster_than_it_grows(
    frequency: float, time_constant: float, shakes: bool
) -> None:
    """Bounds: one oscillation in 12 s, and a phase of 1 rad within the time constant."""
    mode = Mode(0.01, frequency, -0.1, time_constant, 0.7 * time_constant, ("knee",))
    assert mode.shakes == shakes
    assert mode.grows_within(12.0) == (shakes or time_constant < 1)


@pytest.mark.parametrize(("condim", "decays"), [(1, False), (3, True)])
def test_a_nudge_of_a_base_without_friction_does_not_decay(condim: int, decays: bool) -> None:
    """Without friction, no force acts along the ground: the speed after a nudge is kept."""
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><worldbody><geom type="plane" size="0 0 1" condim="{condim}" priority="1"/>
        <body pos="0 0 0.1"><freejoint/><geom type="box" size="0.2 0.2 0.1" mass="1"/></body>
        </worldbody></mujoco>"""
    )
    resting = simulate_commands(
        model, full_state(model, mujoco.MjData(model)), np.zeros((1000, 0))
    )[-500:]
    before = resting[-1]
    start = before.copy()
    start[1 + model.nq] += 1e-3
    states = simulate_commands(model, start, np.zeros((2000, 0)))
    found = measure_response(model, before, states, resting)
    assert found.decayed is decays
    if not decays:
        assert found.left == pytest.approx(1e-3, rel=1e-9)


@pytest.mark.parametrize(("rate", "grows"), [(5e-5, False), (2e-4, True)])
def test_mode_grows_if_its_rate_exceeds_one_ten_thousandth_per_second(
    rate: float, grows: bool
) -> None:
    """Reference: I s^2 + kd s + kp - m g l = 0, whose root is (m g l - kp) / kd for small rates."""
    kp, kd = MOMENT - rate, 1.0
    assert compute_exponents(kp, kd).max() == pytest.approx(rate, rel=1e-3)
    assert bool(make_stability(pendulum(kp, kd, "implicitfast")).unstable) is grows


def test_derivative_of_an_unstable_model_prints_no_warning(
    capfd: pytest.CaptureFixture[str],
) -> None:
    """Negative damping makes the effective mass of the implicit step singular in MuJoCo."""
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><option integrator="implicitfast"/><worldbody><body><joint damping="-1e9"/>'
        '<geom size=".1"/></body></worldbody></mujoco>'
    )
    step_derivative(model, mujoco.MjData(model), 1e-6)
    assert capfd.readouterr().err == ""


SLIPPERY_BLOCK = """<mujoco><option cone="elliptic" impratio="100"/><worldbody>
<geom type="plane" size="0 0 1" condim="{floor}" friction="{rough} 0.005 0.0001"/>
<body pos="0 0 0.0999"><freejoint/><geom type="box" size="0.2 0.2 0.1" mass="1" condim="{condim}"
 friction="0 0.005 0.0001"/></body></worldbody></mujoco>"""
"""Block on the ground: friction of the floor, ``condim`` of the floor and of the block."""


@pytest.mark.parametrize("condim", [3, 4, 6])
@pytest.mark.parametrize("difference", [1e-6, 1e-7])
def test_derivative_on_friction_of_zero_equals_that_of_a_frictionless_contact(
    condim: int, difference: float
) -> None:
    """MuJoCo replaces a friction of 0 by 1e-5, with which 1 kg sticks over nanometres only."""

    def derive(condim: int) -> np.ndarray:
        text = SLIPPERY_BLOCK.format(floor=1, rough=0, condim=condim)
        model = mujoco.MjModel.from_xml_string(text)
        data = mujoco.MjData(model)
        mujoco.mj_step(model, data, 1000)
        before = model.geom_condim.copy()
        found = step_derivative(model, data, difference)
        assert np.array_equal(model.geom_condim, before)
        return found

    expected = derive(1)
    assert expected[6:8, 6:8] == pytest.approx(np.eye(2), abs=1e-12)  # no force along the ground
    np.testing.assert_allclose(derive(condim), expected, atol=1e-5)


@pytest.mark.parametrize(
    ("floor", "rough", "condim", "dim"), [(1, 1, 3, 3), (3, 1, 3, 3), (3, 0, 3, 1), (1, 0, 6, 1)]
)
def test_negligible_friction_is_removed_from_slippery_contacts_only(
    floor: int, rough: int, condim: int, dim: int
) -> None:
    """MuJoCo combines the larger ``condim`` with the larger friction, also of different geoms."""
    text = SLIPPERY_BLOCK.format(floor=floor, rough=rough, condim=condim)
    model = mujoco.MjModel.from_xml_string(text)
    remove_negligible_friction(model)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert data.contact.dim.tolist() == [dim] * 4
