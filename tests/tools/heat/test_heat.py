"""Heat of the motors of a stance, and the command ``heat``."""

from __future__ import annotations

import json
import math
import re
import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.cli.stance_options import parse_continuous_torques
from pupper_analysis.models.motors.dcmotor import make_dcmotor_element
from pupper_analysis.models.motors.motor import Motor
from pupper_analysis.models.motors.reading import find_motor
from pupper_analysis.models.motors.thermal import ThermalNetwork
from pupper_analysis.present.document import (
    MAX_ANSWER_WIDTH,
    BarPlot,
    LinePlot,
    Table,
    get_english,
)
from pupper_analysis.pupper.variant_files import write_variant
from pupper_analysis.tools.heat.document import heat_document, heat_plots
from pupper_analysis.tools.heat.heat import HeatStudy, MotorHeat, _refine_times, study_heat
from tests.base.test_results import assert_numbers_have_units
from tests.support import arm
from tests.support.commands import answer, run_command
from tests.support.legged import quadruped_with_slides
from tests.support.printing import printed
from tests.support.variants import load, stand_of, write_without_a_mass

WEAK = """name = "weak"
source = "bench"
output_torque_constant = "0.4 N m/A"
resistance = "2 ohm"
resistance_temperature = "25 degC"
resistance_rise = "0.00393 1/K"
winding_resistance = "30 K/W"
winding_capacity = "20 J/K"
ambient_temperature = "25 degC"
limit_temperature = "80 degC"
supply_voltage = "24 V"
"""


def motors_of(motor: Motor) -> dict[str, Motor]:
    return dict.fromkeys(load("v3").joint_names, motor)


@pytest.mark.slow
def test_losses_and_temperatures_follow_from_the_torques() -> None:
    """References: statics of the stand; i = tau / (Kt N), P = i^2 R; balance of the final heat."""
    motor = find_motor("dephy-actpack")
    robot = load("v3")
    study = study_heat(robot, stand_of("v3"), motors_of(motor), battery_energy=3600.0)
    statics = pa.stance.stand_statics(robot, study.stand)
    np.testing.assert_array_equal([motor.torque for motor in study.motors], statics.joint_torques)
    for motor_heat in study.motors:
        assert motor_heat.current == pytest.approx(abs(motor_heat.torque) / 0.1133)
        final = motor_heat.steady_temperature
        assert final is not None
        loss = motor_heat.current**2 * 0.376 * (1 + 0.00393 * (final - 65))
        assert motor_heat.steady_loss == pytest.approx(loss)
        assert final == pytest.approx(21 + loss * (1.0702867186480716 + 1.9406620046327363))
        assert motor_heat.time_to_limit == math.inf
    assert study.loss == pytest.approx(sum(motor.loss for motor in study.motors))
    assert study.battery_time == pytest.approx(3600 / study.loss)
    assert study.battery_current is None  # the voltage of this motor is unknown
    assert study.passed
    assert study.temperatures.shape == (len(study.times), 12)
    assert study.first.joint.endswith("_3")


@pytest.mark.slow
def test_the_first_hot_motor_is_named_with_its_minutes(tmp_path: Path) -> None:
    """Reference: R_th C ln(...) of one node in closed form, from the numbers of the result."""
    path = tmp_path / "weak.toml"
    path.write_text(WEAK)
    figure, page, data = tmp_path / "heat.png", tmp_path / "heat.html", tmp_path / "heat.json"
    done = answer(
        *("heat", "v3", "--motor", "dephy-actpack", "--motor", f"*_3={path}", "--battery", "10"),
        *("--figure", str(figure), "--json", str(data), "--report", str(page)),
    )
    assert done.returncode == 1, done.stderr
    result = json.loads(data.read_text())
    first = min(
        (motor for motor in result["motors"] if motor["motor"] == "weak"),
        key=lambda one: one["time_to_limit"],
    )
    heat = first["current"] ** 2 * 2.0
    slope = 1 / 30 - heat * 0.00393
    expected = -20 / slope * math.log1p(-55 * slope / heat)
    assert first["time_to_limit"] == pytest.approx(expected, rel=1e-9)
    line, second = done.stdout.splitlines()[:2]
    limiting = f"{first['joint']} limits: {abs(first['torque']):.2f} N m, "
    after = f"{expected / 60:.3g} min" if expected >= 60 else f"{expected:.2g} s"
    assert line == f"HOT v3: a winding reaches its limit of 80 °C after {after}"
    assert re.match(r"  copper loss of all motors [\d.]+ W; the battery lasts [\d.]+ min", second)
    assert limiting in " ".join(page.read_text().split())
    assert figure.stat().st_size > 10_000
    assert "heat" in page.read_text().lower()


@pytest.mark.slow
def test_unknown_numbers_are_named_and_do_not_pass() -> None:
    done = answer("heat", "v3", "--motor", "dynamixel-xm540-w270")
    assert done.returncode == 1
    first, second, *_ = done.stdout.splitlines()
    assert (
        first
        == "UNKNOWN v3: Dynamixel XM540-W270 lacks thermal data: winding_resistance and 4 more"
    )
    assert "  next: pupper-analysis heat --list-motors" in done.stdout.splitlines()
    assert "A at 12 V" in second
    lacking = answer("heat", "v3", "--motor", "mit-mini-cheetah").stdout
    first, second, *_ = lacking.splitlines()
    assert first.startswith("UNKNOWN v3: winding settles at 25.2 °C; no limit known for MIT Mini")
    assert second.startswith("  leg_back_r_3: 0.47 N m, 0.172 W, air at 25 °C; add --limit DEGC")
    assert "next: pupper-analysis heat v3 --motor mit-mini-cheetah --limit 100" in lacking
    few = answer("heat", "v3", "--motor", "*_1=dephy-actpack")
    assert few.returncode == 1
    assert "no motor assigned to leg_front_r_2" in few.stdout


def make_study(motor: Motor, **options: float) -> HeatStudy:
    return study_heat(load("v3"), stand_of("v3"), motors_of(motor), **options)


def test_temperature_without_a_limit_is_stated_with_the_hottest_joint() -> None:
    """Reference: final temperature and torque of the motor with the largest loss."""
    study = make_study(find_motor("mit-mini-cheetah"))
    hottest = max(study.motors, key=lambda motor: motor.cold_loss or 0.0)
    first, second, *_ = heat_document(study).failures
    assert f"settles at {hottest.steady_temperature:.3g} °C" in first.en
    assert second.en.startswith(f"{hottest.joint}: {abs(hottest.torque):.2f} N m")
    assert not any("limit_temperature" in line.en for line in (first, second))


@pytest.mark.slow
def test_motor_that_cannot_exert_the_torque_is_too_weak() -> None:
    """Reference: supply voltage / resistance x torque per current: 6 V / 6 ohm x 0.4 N m/A."""
    motor = Motor(
        *("weak", "bench"),
        output_torque_constant=0.4,
        resistance=6.0,
        resistance_temperature=25.0,
        resistance_rise=0.00393,
        winding_resistance=1e4,  # a current of 1 A would reach the limit within a second
        winding_capacity=0.01,
        ambient_temperature=25.0,
        limit_temperature=80.0,
        supply_voltage=6.0,
    )
    study = make_study(motor)
    assert {motor_heat.joint[-2:] for motor_heat in study.weak} == {"_3"}
    assert not study.passed
    assert study.first.largest_torque == pytest.approx(0.4)
    assert study.first.limiting_number == "supply_voltage"
    assert abs(study.first.torque) == max(abs(motor.torque) for motor in study.motors)
    assert (study.first.time_to_limit, study.first.steady_temperature) == (None, None)
    assert (study.loss, study.battery_current) == (None, None)
    document = heat_document(study)
    assert getattr(document.verdict, "en", "") == "TOO WEAK"
    line = document.failures[0].en
    assert line.startswith(f"{study.first.joint} must exert 0.47")
    assert line.endswith("weak exerts at most 0.4 N m (supply voltage / resistance)")
    assert not make_study(replace(motor, supply_voltage=12.0)).weak
    unlimited = make_study(replace(motor, supply_voltage=None))
    assert not unlimited.known
    assert "peak_torque" in unlimited.first.unknown


@pytest.mark.slow
def test_data_sheet_decides_if_thermal_numbers_are_unknown() -> None:
    """Reference: the continuous torque of the data sheet, compared with the statics."""
    motor = find_motor("lk-tech-mg4005-10")
    study = make_study(motor)
    assert study.passed
    assert study.first.time_to_limit == math.inf
    assert "0.47 N m of a continuous torque of 1 N m" in heat_document(study).findings[0].en
    small = make_study(replace(motor, continuous_torque=0.4))
    assert not small.passed
    assert small.overheats
    assert small.first.time_to_limit is None
    assert (
        "0.47 N m exceeds the continuous torque of 0.4 N m" in heat_document(small).failures[0].en
    )
    cause = f"{small.first.joint} limits: data sheet of {small.first.motor}, no thermal numbers"
    assert heat_document(small).failures[1].en == cause
    assert not make_study(motor, ambient=40.0).known  # the data sheet has another temperature


@pytest.mark.slow
def test_motor_without_resistance_is_unknown_or_too_weak() -> None:
    """Reference: the numbers of the maker, and the statics (0.47 N m): torque per current known.

    No source states the resistance of the motor: loss and temperature are unknown, the current and
    the largest torque are known.
    """
    motor = find_motor("unitree-go-m8010-6")
    study = make_study(motor)
    assert not study.passed
    assert not study.weak
    assert {"resistance", "winding_resistance"} <= set(study.first.unknown)
    assert (study.loss, study.battery_current, study.first.cold_loss) == (None, None, None)
    assert study.first.current == pytest.approx(abs(study.first.torque) / 0.63895)
    document = heat_document(study)
    assert getattr(document.verdict, "en", "") == "UNKNOWN"
    assert not any("cannot exert" in line.en for line in document.findings)
    weak = make_study(replace(motor, peak_torque=0.4))
    assert getattr(heat_document(weak).verdict, "en", "") == "TOO WEAK"
    unknown = make_study(replace(motor, output_torque_constant=None))
    assert unknown.first.current is None
    assert "output_torque_constant" in unknown.first.unknown


@pytest.mark.slow
def test_data_sheet_decides_if_only_the_limit_temperature_is_unknown() -> None:
    """Reference: the continuous torque of the data sheet, compared with the statics (0.47 N m)."""
    motor = Motor(
        *("rated", "bench"),
        output_torque_constant=0.4,
        resistance=2.0,
        resistance_temperature=25.0,
        resistance_rise=0.00393,
        winding_resistance=3.0,
        winding_capacity=20.0,
        ambient_temperature=25.0,
        supply_voltage=24.0,
        continuous_torque=0.4,
    )
    study = make_study(motor)
    assert study.first.steady_temperature is not None
    assert study.first.limit_temperature is None
    assert study.first.overheats
    assert not study.passed
    assert (
        "0.47 N m exceeds the continuous torque of 0.4 N m" in heat_document(study).failures[0].en
    )
    assert make_study(replace(motor, continuous_torque=1.0)).passed


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"ambient": 400.0}, "-60 and 300"),
        ({"ambient": 90.0, "limit": 80.0}, "not above the ambient"),
        ({"battery_energy": -1.0}, "finite positive"),
    ],
)
def test_invalid_requests_are_refused(options: dict[str, float], words: str) -> None:
    motor = find_motor("dephy-actpack")
    with pytest.raises(ConfigurationError, match=words):
        study_heat(load("v3"), pa.StandTask(), motors_of(motor), **options)


def test_misspelt_motor_of_a_continuous_torque_lists_the_known_motors() -> None:
    with pytest.raises(pa.UnknownNameError, match="dephy-actpack"):
        parse_continuous_torques(("*_3=dephy-actpak",), load("v3"))
    assert parse_continuous_torques(("*_1=1e-3",), load("v3"))[0]["leg_front_r_1"] == 1e-3


@pytest.mark.slow
def test_dcmotors_of_the_mjcf_are_the_motors_of_the_robot(tmp_path: Path) -> None:
    """Reference: the same numbers, given by --motor."""
    _, mjcf = write_variant("v3", tmp_path / "v3")
    motor = find_motor("mit-mini-cheetah")
    text = re.sub("<general forcelimited[^>]*/>", "", mjcf.read_text())
    for joint in load("v3").joint_names:
        element = make_dcmotor_element(motor, joint)
        text = text.replace(f'<general name="{joint}" joint="{joint}"/>', element)
    mjcf.write_text(text)
    given, read = tmp_path / "given.json", tmp_path / "read.json"
    # MuJoCo's gear has no losses: 0.42 N m/A.
    path = tmp_path / "motor.toml"
    path.write_text(WEAK.replace("0.4 N m/A", "0.42 N m/A").replace("2 ohm", "0.1575 ohm"))
    for words, data in (((), read), (("--motor", str(path)), given)):
        done = answer("heat", str(mjcf), "--limit", "80", *words, "--json", str(data))
        assert done.returncode == 0, done.stderr
    first, second = (json.loads(data.read_text())["motors"] for data in (read, given))
    assert [motor_row["current"] for motor_row in first] == pytest.approx(
        [one["current"] for one in second]
    )
    assert first[0]["motor"] == "leg_front_r_1"
    assert second[0]["motor"] == "weak"


@pytest.mark.slow
def test_bad_words_end_with_exit_status_2(tmp_path: Path) -> None:
    unknown = answer("heat", "v3", "--motor", "dephy-actpak")
    assert unknown.returncode == 2
    assert "dephy-actpack" in unknown.stderr
    listed = answer("heat", "--list-motors")
    assert listed.returncode == 0
    assert "https://emanual.robotis.com" in listed.stdout
    complete = {line.split()[0] for line in listed.stdout.splitlines() if "thermal data" in line}
    assert complete == {"dephy-actpack", "mit-mini-cheetah"}  # state all numbers of the network
    missing = answer("heat", "v3")
    assert missing.returncode == 2
    assert "--motor: heat needs a motor: a name of --list-motors, or a file;" in missing.stderr
    arm_path = tmp_path / "arm.urdf"
    arm_path.write_text(arm.URDF.replace(*_BASE))
    fixed = answer("heat", str(arm_path))
    assert fixed.returncode == 2
    assert "has a fixed base: heat needs --contact base=weld, --motor\n" in fixed.stderr
    path = tmp_path / "bad.toml"
    path.write_text(WEAK.replace("2 ohm", "2 rpm"))
    bad = answer("heat", "v3", "--motor", str(path))
    assert bad.returncode == 2
    assert "resistance: 2 rpm: rpm is not a valid unit" in bad.stderr


@pytest.mark.parametrize(
    ("typed", "fault", "proposed"),
    [
        ("heat v3 --motor unitree-go1", "with thermal data: dephy-actpack, mit-mini-cheetah",
         "heat v3 --motor mit-mini-cheetah --limit 100"),
        ("heat v3 --motor unitree-a2 --limit 80 --payload 1kg", "--motor: no motor 'unitree-a2'",
         "heat v3 --limit 80 --payload 1kg --motor mit-mini-cheetah"),
        ("heat v3 --motor *_3=unitree-go1 --motor dephy-actpack", "'unitree-go1'",
         "heat v3 --motor '*_3=mit-mini-cheetah' --motor dephy-actpack --limit 100"),
        ("heat v3 --motor dephy-actpak", "most similar: dephy-actpack",
         "heat v3 --motor dephy-actpack"),
        ("heat v3 --motor t-motor-ak80", "t-motor-ak80-6", "heat v3 --motor t-motor-ak80-6"),
        ("heat v3", "heat needs a motor", "heat v3 --motor steadywin-gim4305-10"),
    ],
)  # fmt: skip
def test_refusal_proposes_a_motor_with_thermal_data(typed: str, fault: str, proposed: str) -> None:
    """The proposed motor was the most similar name, for which the answer is UNKNOWN.

    Reference: the marks of ``heat --list-motors``. t-motor-ak80-6 and steadywin-gim4305-10 state a
    continuous torque.
    """
    done = answer(*shlex.split(typed))
    error, step = done.stderr.splitlines()
    assert done.returncode == 2
    assert fault in error
    assert len(error) <= MAX_ANSWER_WIDTH
    assert step == f"  next: pupper-analysis {proposed}"


@pytest.mark.parametrize(
    ("typed", "missing"),
    [
        ("--motor mit-mini-cheetah --limit 80", "motors of hinges only"),
        ("--motor a_turn=mit-mini-cheetah --limit 80", ""),
        ("--motor a_turn=mit-mini-cheetah", "--limit"),
        ("", "--motor"),
    ],
)
def test_refusal_of_a_fixed_base_names_missing_options_only(
    typed: str, missing: str, tmp_path: Path
) -> None:
    """The refusal required a limit that was typed. Reference: the words; the hand is a slide."""
    path = tmp_path / "arm.urdf"
    path.write_text(arm.URDF.replace(*_BASE))
    error, _ = answer("heat", str(path), *typed.split()).stderr.splitlines()
    required = ", ".join(filter(None, ("--contact base=weld", missing)))
    assert error == f"error: arm.urdf has a fixed base: heat needs {required}"


@pytest.mark.slow
def test_answer_without_thermal_data_states_the_torque() -> None:
    """The answer had a single line. Reference: the largest torque of `stand`, 0.47 N m."""
    done = answer("heat", "v3", "--motor", "unitree-a1")
    assert done.stdout.splitlines()[1] == (
        "  largest torque 0.47 N m (leg_back_r_3); motors with thermal data: dephy-actpack, "
        "mit-mini-cheetah"
    )


def test_motor_that_overheats_at_an_unknown_time_precedes_cool_motors() -> None:
    """Reference: equations of the thermal node; 1/R_th < i^2 R alpha gives no final temperature."""
    bare = {"continuous_torque": None, "unknown": (), "current": 1.0, "steady_loss": 1.0}
    bare |= {"largest_torque": None, "limiting_number": ""}
    cool = MotorHeat(
        joint="cool", motor="a", torque=1.0, cold_loss=1.0, steady_temperature=40.0,
        limit_temperature=80.0, time_to_limit=math.inf, **bare,
    )  # fmt: skip
    unknown = replace(
        cool, joint="unknown", cold_loss=9.0, steady_temperature=None, time_to_limit=None
    )
    hot = replace(
        cool, joint="hot", steady_temperature=math.inf, limit_temperature=None, time_to_limit=None
    )
    assert hot.overheats
    study = HeatStudy(
        name="robot", stand=stand_of("v3"), motors=(cool, unknown, hot), omitted=(), loss=11.0,
        supply_voltage=None, battery_current=None, battery_energy=None, battery_time=None,
        times=np.zeros(1), temperatures=np.zeros((1, 3)),
    )  # fmt: skip
    assert study.first is hot
    rated = replace(unknown, joint="rated", torque=2.0, continuous_torque=1.5)
    assert replace(study, motors=(cool, unknown, rated)).first is rated


def make_heat(joint: str, **changes: object) -> MotorHeat:
    """Return a motor whose winding settles at 40 degC, with other values if given."""
    values: dict[str, object] = {
        "joint": joint, "motor": "a", "torque": 1.0, "current": 1.0, "cold_loss": 1.0,
        "steady_loss": 1.0, "steady_temperature": 40.0, "limit_temperature": 80.0,
        "time_to_limit": math.inf, "continuous_torque": 2.0, "largest_torque": 3.0,
        "limiting_number": "", "unknown": (), **changes,
    }  # fmt: skip
    return MotorHeat(**values)  # type: ignore[arg-type]


def make_rising_study(
    motors: list[MotorHeat], final: list[float], minutes: float = 60.0
) -> HeatStudy:
    """Return a study whose temperatures rise linearly from 20 degC to ``final``."""
    times = np.linspace(0.0, 60.0 * minutes, 121)
    return HeatStudy(
        name="robot", stand=stand_of("v3"), motors=tuple(motors), omitted=(), loss=None,
        supply_voltage=None, battery_current=None, battery_energy=None, battery_time=None,
        times=times, temperatures=20 + np.outer(times / times[-1], np.array(final) - 20),
    )  # fmt: skip


def test_figure_of_weak_motors_shows_torques_instead_of_temperatures() -> None:
    """Temperatures of the other motors looked cool, and the motors that failed were missing."""
    weak = make_heat("calf", torque=-6.0, steady_temperature=None, time_to_limit=None)
    (plot,) = heat_plots(make_rising_study([make_heat("hip"), weak], [40.0, math.nan]))
    assert isinstance(plot, BarPlot)
    shares = {get_english(bar.name): (bar.value, bar.limit) for bar in plot.bars}
    assert shares == {"hip": pytest.approx((100 / 3, 100.0)), "calf": (200.0, 100.0)}


def test_curves_end_above_the_limit_and_the_first_time_is_marked() -> None:
    """Reference: the line from 20 degC at 0 to 620 degC at 60 min reaches 80 degC at 6 min."""
    hot = make_heat("knee", time_to_limit=360.0, steady_temperature=math.inf)
    (plot,) = heat_plots(make_rising_study([hot, make_heat("hip")], [620.0, 40.0]))
    assert isinstance(plot, LinePlot)
    knee, hip, limit, mark = plot.series
    assert np.max(knee.y) == pytest.approx(20 + 1.3 * (80 - 20))
    assert knee.x[-1] == pytest.approx(60 * 78 / 600)  # type: ignore[index]
    assert (np.max(hip.y), np.max(hip.x)) == (40.0, 60.0)
    assert set(limit.y) == {80.0}  # type: ignore[arg-type]
    assert (mark.x, mark.y, mark.points) == ([6.0], [80.0], True)
    assert "6 min" in get_english(mark.name)


def test_equal_curves_are_one_line_and_omitted_motors_are_stated() -> None:
    joints = [f"leg_{side}_{number}" for number in (1, 2, 3, 4) for side in "lr"]
    motors = [make_heat(joint) for joint in joints]
    unknown = make_heat("tail", steady_temperature=None, time_to_limit=None, motor="b")
    final = [*np.repeat([30.0, 32.0, 34.0, 36.0], 2), math.nan]
    (plot,) = heat_plots(make_rising_study([*motors, unknown], final))
    assert isinstance(plot, LinePlot)
    names = [get_english(series.name) for series in plot.series]
    assert names == ["leg_*_1", "leg_*_4", "leg_*_3", "limit"]  # the first motor, then the hottest
    assert plot.note is not None
    note = get_english(plot.note)
    assert note == "not drawn: 2 cooler motors; tail, temperature unknown"
    title = get_english(plot.title)
    assert title == "Temperature of the windings, a, b, air at 20 °C"


@pytest.mark.slow
def test_curves_last_twice_the_time_to_the_first_limit() -> None:
    """Curves of motors that run away reached 18 000 degC, beyond which no limit is visible."""
    robot, motor = load("v3"), find_motor("dephy-actpack")
    study = study_heat(robot, stand_of("v3"), motors_of(motor), limit=30.0)
    assert study.times[-1] == pytest.approx(2 * study.first.time_to_limit)
    at_limit = np.interp(study.first.time_to_limit, study.times, study.temperatures.max(axis=1))
    assert at_limit == pytest.approx(30.0, abs=0.1)


@pytest.mark.parametrize("limited", [False, True])
def test_straight_segments_follow_curves_that_rise_fast_at_first(limited: bool) -> None:
    """Reference: closed form of two nodes, whose time constants are 2 s and an hour.

    With 121 equal steps of 90 s, the first segment was 40 % of the range off.
    """
    network = ThermalNetwork(
        np.array([1.0, 2.0]), np.array([2.0, 1500.0]), 20.0, 3.0, 1.0, 0.0, 20.0
    )
    duration = 4.0 if limited else 3 * 3600.0

    def compute_curves(times: Array) -> Array:
        unknown = np.full((len(times), 1), np.nan)
        return np.hstack([network.compute_temperatures(times)[:, :1], unknown])

    times = _refine_times(duration, compute_curves)
    assert 25 <= len(times) <= 121
    assert (times[0], times[-1]) == (0.0, duration)
    exact_times = np.append(0.0, np.geomspace(1e-3, duration, 5000))
    exact = compute_curves(exact_times)[:, 0]
    drawn = np.interp(exact_times, times, compute_curves(times)[:, 0])
    assert np.abs(drawn - exact).max() < 2e-3 * np.ptp(exact)


@pytest.mark.slow
def test_rotary_motor_at_a_slide_is_refused(tmp_path: Path) -> None:
    """The knees are slides; no file states the lead of a screw."""
    robot = pa.load_robot(quadruped_with_slides(tmp_path))
    motor = find_motor("mit-mini-cheetah")
    with pytest.raises(pa.ConfigurationError, match=r"FL_knee.*RR_knee are slides"):
        study_heat(robot, pa.StandTask(), dict.fromkeys(robot.joint_names, motor))
    with pytest.raises(pa.ConfigurationError, match=r"FL_knee.* are slides"):
        parse_continuous_torques(("dephy-actpack",), robot)
    hips, motors = parse_continuous_torques(("*_pitch=dephy-actpack",), robot)
    assert sorted(hips) == sorted(motors) == ["FL_pitch", "FR_pitch", "RL_pitch", "RR_pitch"]


_BASE = ('<link name="base"/>', '<link name="base"><inertial><mass value="5"/><inertia ixx="1" '
         'iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>')  # fmt: skip
"""Massless base of the arm, and a base with mass, which MuJoCo can weld."""


@pytest.mark.parametrize("typed", ["", "--motor mit-mini-cheetah", "--contact base=weld --motor x"])
def test_proposed_motors_of_an_arm_drive_its_hinges_only(
    typed: str, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Reference: MuJoCo's joint types. The next command is accepted, and judges all hinges."""
    path = tmp_path / "arm.urdf"
    path.write_text(arm.URDF.replace(*_BASE))
    typed = typed.replace(" x", " mit-mini-cheetah")
    status, _, err = run_command(capfd, "heat", str(path), *typed.split())
    assert status == 2
    [step] = [line.partition("analysis ")[2] for line in err.splitlines() if "next:" in line]
    found = tmp_path / "heat.json"
    status, _, err = run_command(capfd, *shlex.split(step), "--json", str(found))
    assert status in (0, 1), err
    model = pa.load_robot(path).mj_model
    hinges = {model.joint(i).name for i in range(model.njnt) if model.jnt_type[i] == 3}
    assert {motor["joint"] for motor in json.loads(found.read_text())["motors"]} == hinges


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effort", "step"),
    [
        ("3", "heat v3 --effort 3 --motor steadywin-gim4305-10"),
        ("23.7", "heat v3 --effort 23.7 --motor mit-mini-cheetah --limit 100"),
        ("33", "heat v3 --effort 33 --motor mit-mini-cheetah --limit 100"),
        ("1000", "heat --list-motors"),
    ],
)
def test_proposed_motor_is_as_strong_as_the_motors_of_the_robot(
    effort: str, step: str, capfd: pytest.CaptureFixture[str]
) -> None:
    """References: largest torques of the data sheets: 3 and 18 N m (v3; Go2 and A1).

    The motors of Go2 and A1 are nearer, but `heat` answers UNKNOWN: their data sheets state neither
    thermal data nor a continuous torque.
    """
    status, _, err = run_command(capfd, "heat", "v3", "--effort", effort)
    assert status == 2
    assert err.splitlines()[-1] == f"  next: pupper-analysis {step}"


@pytest.mark.parametrize("typed", ["", "--contact base=weld"])
def test_base_that_cannot_be_welded_names_the_command_that_needs_no_weld(
    typed: str, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """MuJoCo refuses a moving body without mass: a next command with a weld would fail."""
    path = tmp_path / "arm.urdf"
    path.write_text(arm.URDF)
    words = ("--motor", "mit-mini-cheetah", *typed.split())
    status, _, err = run_command(capfd, "heat", str(path), *words)
    assert status == 2
    assert "the base of arm.urdf (base) has no mass" in err
    assert err.splitlines()[-1] == f"  next: pupper-analysis hold {path}"


def test_limit_below_the_ambient_temperature_of_the_motor_is_refused() -> None:
    """A winding at rest has the ambient temperature: the answer was HOT after 0 s."""
    motor = find_motor("mit-mini-cheetah")
    assert motor.ambient_temperature == 25.0
    with pytest.raises(pa.ConfigurationError, match="10 degC"):
        study_heat(load("v3"), stand_of("v3"), motors_of(motor), limit=10.0)


def test_duration_of_the_battery_is_in_the_second_line_if_a_battery_is_given() -> None:
    """Reference: energy / loss."""
    motor = find_motor("mit-mini-cheetah")
    study = study_heat(
        load("v3"), stand_of("v3"), motors_of(motor), limit=80.0, battery_energy=74 * 3600.0
    )
    assert study.loss is not None
    minutes = 74 * 60 / study.loss
    _, second, *_ = heat_document(study).findings
    assert f"the battery lasts {minutes:.0f} min" in get_english(second)


@pytest.mark.slow
def test_heat_of_a_robot_with_an_assumed_mass_does_not_pass(tmp_path: Path) -> None:
    """v3 passes with all masses stated; without, its torques are lower bounds."""
    stated, unstated = write_without_a_mass(tmp_path)
    motor = find_motor("t-motor-ak80-6")
    for path, passes in ((stated, True), (unstated, False)):
        robot = pa.load_robot(path)
        heat = study_heat(robot, pa.StandTask(), dict.fromkeys(robot.joint_names, motor))
        assert heat.passed is passes
        assert (heat.missing_masses is None) is passes
    assert printed(heat).startswith("UNKNOWN")


def test_each_column_of_the_table_has_its_number() -> None:
    """All numbers differ, so that an exchange of two columns is found; times in minutes."""
    motor = MotorHeat(
        joint="knee", motor="m", torque=1.5, continuous_torque=2.25, largest_torque=4.5,
        current=3.25, cold_loss=5.5, steady_loss=6.75, steady_temperature=47.5,
        limit_temperature=81.0, time_to_limit=600.0, limiting_number="", unknown=(),
    )  # fmt: skip
    weak = replace(motor, joint="hip", torque=9.0)
    study = HeatStudy(
        name="robot", stand=stand_of("v3"), motors=(motor, weak, weak), omitted=(), loss=13.5,
        supply_voltage=24.0, battery_current=0.5625, battery_energy=None, battery_time=None,
        times=np.zeros(1), temperatures=np.zeros((1, 3)),
    )  # fmt: skip
    [table] = [block for block in heat_document(study).blocks if isinstance(block, Table)]
    printed = {
        get_english(column.name): (get_english(cell), column.unit)
        for column, cell in zip(table.columns, table.rows[0], strict=True)
    }
    assert printed == {
        "joint": ("knee", ""), "motor": ("m", ""), "torque": ("+1.500", "N m"),
        "continuous": ("2.25", "N m"), "at most": ("4.5", "N m"), "current": ("3.25", "A"),
        "cold loss": ("5.5", "W"), "final loss": ("6.75", "W"),
        "final temperature": ("47.5", "°C"), "limit": ("81", "°C"),
        "time to limit": ("10.0", "min"),
    }  # fmt: skip
    assert [weak.too_weak for weak in study.motors] == [False, True, True]
    counts = [get_english(failure) for failure in heat_document(study).failures]
    assert any(line.startswith("2 of 3 motors cannot") for line in counts)
    cool = replace(study, motors=(motor,))
    losses = [get_english(finding) for finding in heat_document(cool).findings]
    assert "copper loss of all motors 13.5 W = 0.562 A at 24 V" in losses


def test_motor_of_an_unknown_joint_raises_with_similar_names() -> None:
    motors = motors_of(find_motor("dephy-actpack"))
    with pytest.raises(pa.UnknownNameError, match=r"no joint 'leg_front_r_4'.*leg_front_r_") as it:
        study_heat(load("v3"), stand_of("v3"), motors | {"leg_front_r_4": motors["leg_front_r_1"]})
    assert it.value.name == "leg_front_r_4"


@pytest.mark.parametrize("junk", [3, None])
def test_object_that_is_no_motor_raises(junk: object) -> None:
    with pytest.raises(pa.ConfigurationError, match=r"leg_front_r_1.* is not a Motor or a text"):
        study_heat(load("v3"), stand_of("v3"), {"leg_front_r_1": junk})  # type: ignore[dict-item]
    with pytest.raises(pa.ConfigurationError, match=r"name: .* is not a text"):
        find_motor(junk)  # type: ignore[arg-type]


def test_motor_by_name_equals_the_motor() -> None:
    robot, joint = load("v3"), "leg_front_r_1"
    named = study_heat(robot, stand_of("v3"), {joint: "dephy-actpack"})
    given = study_heat(robot, stand_of("v3"), {joint: find_motor("dephy-actpack")})
    assert named.motors == given.motors
    with pytest.raises(pa.UnknownNameError, match="dephy-actpack"):
        study_heat(robot, stand_of("v3"), {joint: "dephy-actpak"})


@pytest.mark.slow
def test_dataframe_contains_the_temperatures_with_their_unit() -> None:
    """Reference: the temperatures [degC] of the result."""
    robot = load("v3")
    motors = dict.fromkeys(robot.joint_names, find_motor("dephy-actpack"))
    heat = study_heat(robot, stand_of("v3"), motors)
    assert_numbers_have_units(heat)
    knee = robot.joint_names[2]
    frame = heat.to_dataframe()
    np.testing.assert_array_equal(frame[f"temperature {knee}"], heat.temperatures[:, 2])
    assert frame.attrs["units"][f"temperature {knee}"] == "degC"
