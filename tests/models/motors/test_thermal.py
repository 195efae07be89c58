"""Temperatures of windings, against closed forms, an integrator and MuJoCo's ``dcmotor``."""

from __future__ import annotations

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pupper_analysis.base.errors import ModelError
from pupper_analysis.models.motors.dcmotor import (
    list_dcmotors,
    make_dcmotor_element,
    read_dcmotor,
)
from pupper_analysis.models.motors.motor import Motor
from pupper_analysis.models.motors.reading import find_motor
from pupper_analysis.models.motors.thermal import ThermalNetwork, compute_continuous_torque

MOTOR = Motor(
    *("test", "bench"),
    torque_constant=0.08,
    gear_ratio=6.0,
    gear_efficiency=1.0,
    resistance=0.2,
    resistance_temperature=25.0,
    resistance_rise=0.00393,
    winding_resistance=2.0,
    winding_capacity=30.0,
    ambient_temperature=20.0,
    limit_temperature=90.0,
    supply_voltage=24.0,
    rotor_inertia=1e-4,
)


TWO_NODES = replace(
    MOTOR,
    torque_constant=0.123,
    gear_ratio=1.0,
    resistance=0.365,
    winding_resistance=1.85,
    housing_resistance=1.3,
    winding_capacity=66.5,
    housing_capacity=815.0,
    limit_temperature=125.0,
)


def test_one_node_heats_exponentially() -> None:
    """Reference: T = T_a + P_a / s (1 - exp(-s t / C)) with s = 1 / R_th - i^2 R alpha."""
    network = ThermalNetwork.of_motor(MOTOR, 8.0)
    slope = 1 / 2.0 - 64 * 0.2 * 0.00393
    heat = 64 * 0.2 * (1 + 0.00393 * (20 - 25))
    times = np.array([0.0, 1.0, 50.0, 1000.0])
    expected = 20 + heat / slope * -np.expm1(-slope * times / 30)
    np.testing.assert_allclose(network.compute_temperatures(times)[:, 0], expected, rtol=1e-12)
    assert network.steady_temperature == pytest.approx(20 + heat / slope, rel=1e-12)
    limit = 20 + 0.5 * heat / slope
    assert network.find_time(limit) == pytest.approx(30 / slope * math.log(2), rel=1e-9)


def test_two_nodes_heat_as_two_exponentials() -> None:
    """Reference: the roots of the characteristic polynomial, and the coefficients that satisfy
    T(0) and dT/dt(0); Cramer's rule for the final temperatures."""
    motor = find_motor("dephy-actpack")
    current = 9.0
    network = ThermalNetwork.of_motor(motor, current)
    first, second = network.resistances
    winding, housing = network.capacities
    gain = current**2 * network.ohms * network.rise
    a, b = (gain - 1 / first) / winding, 1 / (first * winding)
    c, d = 1 / (first * housing), -(1 / first + 1 / second) / housing
    trace, determinant = a + d, a * d - b * c
    root = math.sqrt(trace**2 / 4 - determinant)
    fast, slow = trace / 2 - root, trace / 2 + root
    rate = network.compute_loss(21.0) / winding
    final = -rate * d / determinant
    weight = (rate + slow * final) / (fast - slow)  # of the fast exponential
    times = np.array([0.0, 3.0, 30.0, 300.0, 3000.0])
    expected = 21 + final + weight * np.exp(fast * times) - (final + weight) * np.exp(slow * times)
    temperatures = network.compute_temperatures(times)[:, 0]
    np.testing.assert_allclose(temperatures, expected, rtol=1e-9)
    assert network.steady_temperature == pytest.approx(21 + final, rel=1e-9)
    time = network.find_time(100.0)
    assert network.compute_temperatures([time])[0, 0] == pytest.approx(100.0, rel=1e-9)


def test_two_nodes_agree_with_an_integrator() -> None:
    """Reference: scipy's integrator of the differential equations of the module."""
    network = ThermalNetwork.of_motor(TWO_NODES, 12.0, ambient=30.0)

    def rates(_: float, state: np.ndarray) -> list[float]:
        flow = (state[0] - state[1]) / 1.85
        heat = 144 * 0.365 * (1 + 0.00393 * (state[0] - 25))
        return [(heat - flow) / 66.5, (flow - (state[1] - 30) / 1.3) / 815]

    times = np.linspace(0, 4000, 9)
    found = solve_ivp(
        rates, (0, 4000), [30.0, 30.0], t_eval=times, rtol=1e-11, atol=1e-10, method="LSODA"
    )
    np.testing.assert_allclose(network.compute_temperatures(times), found.y.T, rtol=1e-8)


def test_a_current_that_heats_faster_than_it_cools_has_no_final_temperature() -> None:
    """Reference: i^2 R alpha > 1 / R_th."""
    network = ThermalNetwork.of_motor(MOTOR, 26.0)
    assert math.isinf(network.steady_temperature)
    assert 0 < network.find_time(90.0) < 60


def test_continuous_torque_ends_at_the_limit() -> None:
    """Reference: the final temperature at that torque."""
    for motor in (MOTOR, find_motor("dephy-actpack"), TWO_NODES):
        torque = compute_continuous_torque(motor)
        network = ThermalNetwork.of_motor(motor, motor.compute_current(torque))
        assert network.steady_temperature == pytest.approx(motor.get("limit_temperature"))
    limited = replace(MOTOR, peak_torque=0.5)
    assert compute_continuous_torque(limited) == 0.5


def test_unknown_thermal_numbers_are_listed() -> None:
    with pytest.raises(ModelError, match="resistance_rise, ambient_temperature"):
        ThermalNetwork.of_motor(replace(MOTOR, resistance_rise=None, ambient_temperature=None), 1.0)
    with pytest.raises(ModelError, match="housing_capacity"):
        ThermalNetwork.of_motor(replace(MOTOR, housing_resistance=1.0), 1.0)
    with pytest.raises(ModelError, match="limit_temperature"):
        compute_continuous_torque(replace(MOTOR, limit_temperature=None))


def test_resistance_that_is_negative_in_cold_air_is_refused() -> None:
    """Reference: 1 + 0.05 (-20 - 25) < 0; the winding would cool by its loss."""
    motor = replace(MOTOR, resistance_rise=0.05)
    with pytest.raises(ModelError, match=r"not positive at the ambient temperature of -20 degC"):
        ThermalNetwork.of_motor(motor, 8.0, ambient=-20.0)
    with pytest.raises(ModelError, match="copper has"):
        compute_continuous_torque(motor, ambient=-20.0)
    assert ThermalNetwork.of_motor(motor, 1.0).compute_loss(20.0) > 0


def compile_motor(
    motor: Motor, joint: str, timestep: float, *, eulerdamp: str = "disable"
) -> mujoco.MjModel:
    """Compile a pendulum without gravity that the motor drives."""
    return mujoco.MjModel.from_xml_string(
        f"""<mujoco><option timestep="{timestep}" gravity="0 0 0">
        <flag eulerdamp="{eulerdamp}"/></option><worldbody><body>
        <joint name="hinge" axis="0 1 0" {joint}/><geom size=".05" mass="1" pos=".2 0 0"/>
        </body></worldbody><actuator>{make_dcmotor_element(motor, "hinge")}</actuator></mujoco>"""
    )


def test_written_motor_is_read_again() -> None:
    """Reference: the motor; MuJoCo compiles the element."""
    motor = replace(MOTOR, current_limit=30.0, limit_temperature=None)
    read = read_dcmotor(compile_motor(motor, "", 0.001), 0, "bench")
    assert read == replace(motor, name="hinge")
    spec = mujoco.MjSpec.from_string(
        '<mujoco><worldbody><body><joint name="a"/><geom size="1"/></body></worldbody>'
        '<actuator><motor name="m" joint="a"/></actuator></mujoco>'
    )
    with pytest.raises(ModelError, match="not a dcmotor"):
        read_dcmotor(spec.compile(), 0)


def test_final_temperature_agrees_with_mujoco() -> None:
    """Reference: MuJoCo's ``dcmotor`` at a constant current, simulated for 20 time constants."""
    model = compile_motor(MOTOR, 'damping="1e8"', 0.05, eulerdamp="enable")
    data = mujoco.MjData(model)
    network = ThermalNetwork.of_motor(MOTOR, 8.0)
    halfway = round(network.find_time(40.0) / 0.05)
    for step in range(25_000):
        # The voltage of a current source: the resistance of the warm winding times the current.
        data.ctrl[0] = 8.0 * 0.2 * (1 + 0.00393 * (20 + data.act[0] - 25))
        mujoco.mj_step(model, data)
        if step + 1 == halfway:
            assert 20 + data.act[0] == pytest.approx(40.0, rel=1e-3)
    assert data.actuator_force[0] == pytest.approx(0.08 * 8.0, rel=1e-6)
    assert 20 + data.act[0] == pytest.approx(network.steady_temperature, rel=1e-3)


def test_energy_of_a_simulated_motor_is_balanced() -> None:
    """Electrical energy = kinetic energy + copper loss + viscous friction, to 1e-6.

    Reference: MuJoCo's ``dcmotor``. Without implicit damping, a step changes the kinetic energy by
    force times mean velocity, so that the balance holds for each step.
    """
    model = compile_motor(MOTOR, 'damping="0.02"', 0.001)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    mass = np.zeros((1, 1))
    mujoco.mj_fullM(model, data, mass)
    drawn = electrical = copper = friction = 0.0
    for step in range(2000):
        voltage = 6.0 * math.sin(0.005 * step)
        data.ctrl[0] = voltage
        warm = 0.2 * (1 + 0.00393 * (20 + data.act[0] - 25))
        before = data.qvel[0]
        mujoco.mj_step(model, data)
        mean = (before + data.qvel[0]) / 2
        current = data.actuator_force[0] / 0.08
        assert current == pytest.approx((voltage - 0.08 * 6 * before) / warm, rel=1e-6, abs=1e-9)
        drawn += voltage * current * 0.001
        copper += current**2 * warm * 0.001
        friction += 0.02 * before * mean * 0.001
        # The back-EMF of the mean velocity: the power that becomes mechanical in this step.
        electrical += (current * warm + 0.08 * 6 * mean) * current * 0.001
    kinetic = mass[0, 0] * data.qvel[0] ** 2 / 2
    assert electrical == pytest.approx(kinetic + copper + friction, rel=1e-6)
    assert drawn == pytest.approx(electrical, rel=0.01)  # the voltage meets the earlier velocity
    assert copper > 0.1 * electrical


def test_gear_of_a_motor_after_an_actuator_with_several_outputs_is_its_own() -> None:
    """The array of gears has a row per output. Reference: the stated gear."""
    model = mujoco.MjModel.from_xml_string("""
    <mujoco><worldbody><body><joint name="j"/><geom size="0.1"/>
    <body><joint name="ball" type="ball"/><geom size="0.1"/></body></body></worldbody>
    <actuator>
    <general joint="ball" gaintype="so3" biastype="so3" gainprm="1" biasprm="0 -1 0"/>
    <dcmotor joint="j" motorconst="0.1" resistance="1" gear="7"/>
    </actuator></mujoco>""")
    assert list_dcmotors(model, "bench")["j"].gear_ratio == 7.0


@pytest.mark.parametrize(
    ("attributes", "numbers"),
    [
        ('gear="0"', {"gear_ratio": None}),
        ('gear="-7"', {"gear_ratio": 7.0}),
        ('ctrlrange="0 24"', {"supply_voltage": None}),
        ('ctrlrange="-6 24"', {"supply_voltage": 6.0}),
        ('saturation="0.4 0 0"', {"current_limit": 4.0}),
    ],
)
def test_one_sided_or_zero_limits_of_a_dcmotor_are_not_read_as_torque(
    attributes: str, numbers: dict[str, float | None]
) -> None:
    """Reference: the element. A motor that only pulls holds no load in the other direction."""
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body><joint name="j"/><geom size="0.1"/></body></worldbody><actuator>'
        f'<dcmotor joint="j" motorconst="0.1" resistance="2" {attributes}/></actuator></mujoco>'
    )
    motor = list_dcmotors(model, "bench")["j"]
    assert {name: getattr(motor, name) for name in numbers} == pytest.approx(numbers)
    if numbers.get("gear_ratio", 1) is None:
        with pytest.raises(ModelError, match="gear_ratio"):
            motor.compute_current(1.0)


def test_motors_with_several_controls_or_none_are_all_read() -> None:
    """Indices of actuators are no indices of controls. Reference: the stated motor constants."""
    inputs = {"pos vel": None, "none": None, "voltage": 12.0, "pos": None}
    bodies = "".join(
        f'<body pos="{number} 0 0"><joint name="j{number}"/><geom size="0.1"/></body>'
        for number in range(len(inputs))
    )
    motors = "".join(
        f'<dcmotor joint="j{number}" motorconst="{number + 1}" resistance="2" input="{kind}"'
        + (' ctrlrange="-12 12"/>' if kind in ("voltage", "pos") else "/>")
        for number, kind in enumerate(inputs)
    )
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><worldbody>{bodies}</worldbody><actuator>{motors}</actuator></mujoco>"
    )
    found = list_dcmotors(model, "bench")
    assert {name: motor.torque_constant for name, motor in found.items()} == {
        f"j{number}": number + 1.0 for number in range(len(inputs))
    }
    assert [motor.supply_voltage for motor in found.values()] == [*inputs.values()]
