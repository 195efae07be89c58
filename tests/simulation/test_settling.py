"""Settling of a robot: the short simulation agrees with the complete verification of a stand."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.robot.stability import Stability
from pupper_analysis.simulation import settling
from pupper_analysis.simulation.monitor import StandReference
from pupper_analysis.simulation.rollout import (
    make_stand_start,
    simulate_commands,
    simulate_in_intervals,
)
from pupper_analysis.simulation.settling import comes_to_rest
from pupper_analysis.simulation.shaking import ShakingRecord
from pupper_analysis.simulation.stability import nudge_state
from pupper_analysis.stance.stand import Stand
from tests.support.variants import load


@pytest.fixture(scope="module")
def standing() -> tuple[pa.Robot, Stand]:
    robot = load("v3")
    return robot, pa.stance.solve_stand_on_soft_ground(robot)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kp", "kd", "feedforward"),
    [(5.0, 0.1, True), (20.0, 0.5, False), (0.05, 0.001, False), (5e4, 0.0, True)],
)
def test_settling_agrees_with_the_verification(
    standing: tuple[pa.Robot, Stand], kp: float, kd: float, feedforward: bool
) -> None:
    """Reference: the complete verification of stands that hold, sag, fall and shake."""
    robot, stand = standing
    gains = {"kp": np.full(robot.nu, kp), "kd": np.full(robot.nu, kd)}
    seen = pa.verify_stand(robot, stand, feedforward=feedforward, **gains)
    assert comes_to_rest(robot, stand, feedforward=feedforward, **gains) == seen.stays
    assert seen.stays == (5.0 <= kp <= 20.0)


def test_settling_ends_as_soon_as_the_robot_is_at_rest(
    standing: tuple[pa.Robot, Stand], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reference: the simulated time, summed over all calls of the simulation."""
    robot, stand = standing
    simulated = []
    run = settling.simulate_commands
    step = float(robot.mj_model.opt.timestep)

    def counted(*arguments: object) -> object:
        simulated.append(len(arguments[2]) * step)  # type: ignore[arg-type]
        return run(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(settling, "simulate_commands", counted)
    assert comes_to_rest(robot, stand)
    assert sum(simulated) == pytest.approx(1.0)  # of 5 s in which a stand may settle
    simulated.clear()
    assert not comes_to_rest(robot, stand, feedforward=False, kp=0.05, kd=0.001)
    assert sum(simulated) < 5.0


def test_growing_modes_are_simulated_last_and_decide(
    standing: tuple[pa.Robot, Stand], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Modes are simulated for up to 48 s, and only if the robot returns from the nudge."""
    robot, stand = standing
    confirmed: list[bool] = []
    confirm = settling.confirm_growth

    def refuted(*arguments: Any) -> Stability:
        found = confirm(*arguments)
        confirmed.append(found.is_stable_for())
        assert found.least_damped is not None
        growing = replace(found.least_damped, doubling_time=1.0)
        return replace(found, unstable=(growing,))

    monkeypatch.setattr(settling, "confirm_growth", refuted)
    assert not comes_to_rest(robot, stand)
    assert confirmed == [True]
    has_left = settling._has_left_stand

    def has_left_after_nudge(*arguments: Any) -> bool:
        return has_left(*arguments) if len(arguments) > 2 else True

    monkeypatch.setattr(settling, "_has_left_stand", has_left_after_nudge)
    assert not comes_to_rest(robot, stand)
    assert confirmed == [True]


@pytest.mark.parametrize(
    ("doubling_time", "repeated", "simulated"),
    [(0.015, False, 0), (0.015, True, 1), (1.0, False, 1)],
)
def test_mode_of_one_difference_step_is_refuted_by_the_nudge(
    standing: tuple[pa.Robot, Stand],
    doubling_time: float,
    repeated: bool,
    simulated: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Atom 01 has a mode of 0.015 s with one step alone: dry friction is differentiated across its
    kink. Each simulation of such a mode took 2 s, for nine candidates of servo gains."""
    find, confirmed = settling.find_final_spectrum, []

    def with_mode(*arguments: Any) -> tuple[Stability, Any]:
        found, settled = find(*arguments)
        assert found.least_damped is not None
        mode = replace(
            found.least_damped,
            growth=found.timestep * math.log(2) / doubling_time,
            time_constant=doubling_time / math.log(2),
            doubling_time=doubling_time,
            repeated_at_second_step=repeated,
        )
        return replace(found, unstable=(mode,)), settled

    def confirm(spectrum: Stability, *_: Any) -> Stability:
        confirmed.append(spectrum)
        return replace(spectrum, unstable=())

    monkeypatch.setattr(settling, "find_final_spectrum", with_mode)
    monkeypatch.setattr(settling, "confirm_growth", confirm)
    assert comes_to_rest(*standing)
    assert len(confirmed) == simulated


def test_height_ratio_is_the_larger_share_of_its_two_bounds(
    standing: tuple[pa.Robot, Stand],
) -> None:
    """Reference: synthetic states with a known height deviation and drift."""
    held = make_stand_start(*standing)
    duration = 499 * held.drive.model.opt.timestep
    height = 1 + int(held.robot.mj_convention.qpos_index[2])
    for wave, drift, expected in (
        (0.0, 0.0, 0.0),
        (2 * settling.MAX_HEIGHT_DEVIATION, 0.0, 2.0),
        (0.0, -3e-4 / duration, 3e-4 / duration / settling.SETTLED_DRIFT),
    ):
        states = np.tile(held.start, (500, 1))
        states[:, height] += wave * np.tile([1, -1, -1, 1], 125)
        states[:, height] += drift * np.linspace(0.0, duration, 500)
        assert settling._compute_height_ratio(held, states) == pytest.approx(expected, abs=1e-9)


def test_norm_of_foot_displacements_is_horizontal() -> None:
    """Reference: the largest displacement by hand; a foot that sinks by 1 m does not count."""
    displacements = np.zeros((4, 3))
    displacements[2, 1], displacements[1, 2] = 0.015, 1.0
    assert settling._max_horizontal_norm(displacements) == pytest.approx(0.015)


@pytest.mark.parametrize(
    ("ratios", "remaining", "displaced"),
    [
        ([1.27] * 5, 2.0, True),
        ([1.27] * 4, 2.0, False),  # less than a second is known
        ([1.0] * 5, 2.0, False),  # at the bound
        ([1.4, 1.38, 1.36, 1.34, 1.31], 2.0, False),  # 1.31 - 2 * 0.09 * 2 = 0.95
        ([1.4, 1.38, 1.36, 1.34, 1.33], 2.0, True),  # 1.33 - 2 * 0.07 * 2 = 1.05
        ([1.2, 1.3, 1.4, 1.5, 1.6], 2.0, True),  # moves away
    ],
)
def test_foot_stays_displaced_if_its_return_is_too_slow(
    ratios: list[float], remaining: float, displaced: bool
) -> None:
    """Reference: the bound by hand, twice the rate of the last second for the remaining time."""
    assert settling._stays_displaced(ratios, remaining) == displaced


def test_states_of_intervals_equal_those_of_a_single_simulation(
    standing: tuple[pa.Robot, Stand],
) -> None:
    """Reference: the same steps in a single rollout, to the last bit."""
    held = make_stand_start(*standing, kp=2.0, kd=0.05)
    model, start = held.drive.model, nudge_state(held.drive.model, held.start)
    intervals = list(simulate_in_intervals(model, start, held.ctrl, 700, 125))
    assert [len(states) for states in intervals] == [125] * 5 + [75]
    single = simulate_commands(model, start, np.tile(held.ctrl, (700, 1)))
    np.testing.assert_array_equal(np.concatenate(intervals), single)


@pytest.mark.parametrize(
    ("change", "seconds"),
    [("shakes", 2.0), ("falls", 0.25), ("diverges", 0.25), ("rests", 1.5)],
)
def test_nudged_simulation_ends_once_the_robot_shakes_or_falls(
    standing: tuple[pa.Robot, Stand], monkeypatch: pytest.MonkeyPatch, change: str, seconds: float
) -> None:
    """Reference: 2 s of shaking after a second of it, a quarter of a second for the other failures,
    and 1.5 s for a robot that rests."""
    robot, stand = standing
    held = make_stand_start(robot, stand)
    model, simulated = held.drive.model, []
    base = 1 + robot.mj_convention.qpos_index

    def simulate(
        model: Any, start: np.ndarray, ctrl: np.ndarray, steps: int, interval: int
    ) -> Iterator[np.ndarray]:
        """Yield states at rest, with the change."""
        time = start[0] + model.opt.timestep * np.arange(1, steps + 1)
        states = np.tile(held.start, (steps, 1))
        states[:, 0] = time
        if change == "shakes":
            states[:, 1 + model.nq] = 0.05 * np.sin(20 * np.pi * time)
        elif change == "falls":
            states[:, base[3:7]] = np.cos(0.4), np.sin(0.4), 0.0, 0.0  # tilted by 0.8 rad
        elif change == "diverges":
            states[:, base[2]] = np.nan
        for begin in range(0, steps, interval):
            simulated.append(min(interval, steps - begin) * float(model.opt.timestep))
            yield states[begin : begin + interval]

    monkeypatch.setattr(settling, "simulate_in_intervals", simulate)
    shaking = ShakingRecord(model)
    if change == "shakes":
        shaking.add(_make_oscillation(model, 10.0, 0.05)[: round(1.0 / model.opt.timestep)])
    reference = StandReference.from_configuration(robot, stand.qpos, stand.task.rotation())
    duration = 7.0 if change == "shakes" else 1.5
    states = settling._simulate_nudge(held, reference, held.start, duration, shaking)
    assert (states is not None) == (change == "rests")
    assert sum(simulated) == pytest.approx(seconds)


def _make_oscillation(
    model: Any,
    frequency: float,
    speed: float,
    time_constant: float = math.inf,
    duration: float = 3.0,
) -> np.ndarray:
    """States in which the first velocity is a decaying sine; the others are zero."""
    time = np.arange(round(duration / model.opt.timestep)) * model.opt.timestep
    states = np.zeros((len(time), 1 + model.nq + model.nv + model.na))
    envelope = speed * np.exp(-time / time_constant)
    states[:, 1 + model.nq] = envelope * np.sin(2 * np.pi * frequency * time)
    return states


@pytest.mark.parametrize(
    ("frequency", "speed", "time_constant", "sustained"),
    [
        (10.0, 0.05, math.inf, True),
        (10.0, 0.05, 100.0, True),
        (10.0, 0.05, 15.0, False),  # the ratio over 2 s is 0.875
        (10.0, 0.05, -5.0, True),  # grows
        (10.0, 0.005, math.inf, False),  # slower than ten nudges
        (0.3, 0.05, math.inf, False),  # sways slowly
    ],
)
def test_shaking_is_sustained_if_fast_and_without_decay(
    standing: tuple[pa.Robot, Stand],
    frequency: float,
    speed: float,
    time_constant: float,
    sustained: bool,
) -> None:
    """Reference: closed form of the oscillation, ``v exp(-t / T) sin(2 pi f t)`` for 3 s."""
    model = standing[0].mj_model
    record = ShakingRecord(model)
    states = _make_oscillation(model, frequency, speed, time_constant)
    second = round(1.0 / model.opt.timestep)
    record.add(states[: 2 * second])
    assert not record.is_sustained  # too short
    record.add(states[2 * second :])
    assert record.is_sustained == sustained


@pytest.mark.parametrize(("time_constant", "sustained"), [(math.inf, True), (30.0, False)])
def test_longer_windows_recognise_a_slower_decay(
    standing: tuple[pa.Robot, Stand], time_constant: float, sustained: bool
) -> None:
    """Reference: closed form; the ratio exp(-t / T) is 0.935 in 2 s, and 0.82 in 6 s."""
    model = standing[0].mj_model
    record = ShakingRecord(model)
    record.add(_make_oscillation(model, 10.0, 0.05, time_constant, duration=9.0))
    assert record.is_sustained
    assert record.is_sustained_over(3) == sustained
    assert not record.is_sustained_over(4)  # too short
    assert (record.fastest_dof, record.speed > 0.03) == (0, True)


def test_settling_ends_early_if_the_robot_shakes_without_decay(
    standing: tuple[pa.Robot, Stand], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reference: 3 s, of 5 s in which a stand may settle and 1.5 to 7 s after a nudge."""
    robot, stand = standing
    step, simulated = float(robot.mj_model.opt.timestep), []

    def shake(model: Any, start: np.ndarray, ctrl: np.ndarray, *_: Any) -> np.ndarray:
        """Return a stand at rest whose first velocity oscillates at 10 Hz with 0.05 m/s."""
        begin = len(ctrl) * step * len(simulated)
        simulated.append(len(ctrl) * step)
        states = np.tile(start, (len(ctrl), 1))
        states[:, 0] = begin + step * np.arange(1, len(ctrl) + 1)
        states[:, 1 + model.nq] = 0.05 * np.sin(20 * np.pi * states[:, 0])
        # Above the bound of a robot at rest, so that the simulation continues.
        states[:, 1 + robot.mj_convention.qpos_index[2]] += 3e-4 * np.sign(
            np.sin(20 * np.pi * states[:, 0])
        )
        return states

    monkeypatch.setattr(settling, "simulate_commands", shake)
    assert not comes_to_rest(robot, stand)
    assert sum(simulated) == pytest.approx(3.0)


def test_settling_ends_early_if_the_robot_rests_with_displaced_feet(
    standing: tuple[pa.Robot, Stand], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reference: 2 s, after which the displacement of a second is known, instead of 5 s."""
    robot, stand = standing
    step, simulated = float(robot.mj_model.opt.timestep), []

    def shift(model: Any, start: np.ndarray, ctrl: np.ndarray, *_: Any) -> np.ndarray:
        """Return a stand at rest, shifted by 1.4 times the bound along x from the first call on."""
        states = np.tile(start, (len(ctrl), 1))
        states[:, 0] += step * np.arange(1, len(ctrl) + 1)
        if not simulated:
            column = 1 + robot.mj_convention.qpos_index[0]
            states[:, column] += 1.4 * settling.MAX_FOOT_DISPLACEMENT
        simulated.append(len(ctrl) * step)
        return states

    monkeypatch.setattr(settling, "simulate_commands", shift)
    assert not comes_to_rest(robot, stand)
    assert sum(simulated) == pytest.approx(2.0)
