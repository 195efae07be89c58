"""Motors as data: units, unknown numbers, contradictions, files of this package and of others."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest

from pupper_analysis.base.errors import ConfigurationError, ModelError, UnknownNameError
from pupper_analysis.models.motors.motor import NUMBER_KINDS, Motor
from pupper_analysis.models.motors.reading import (
    find_motor,
    list_motors,
    read_bam_parameters,
    read_motor,
)
from pupper_analysis.models.motors.units import UNIT_KINDS, parse_motor_quantity

TEXT = """name = "test"
source = "bench"
torque_constant = "0.1 N m/A"
resistance = "0.5 ohm"
gear_ratio = 6
supply_voltage = "24 V"
"""


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "motor.toml"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("kind", "text", "value"),
    [
        ("torque constant", "80 mN m/A", 0.08),
        ("torque constant", "1 kgf cm/A", 0.0980665),
        ("torque", "20 kgf cm", 1.96133),
        ("torque", "3Nm", 3.0),
        ("speed", "60 rpm", 2 * math.pi),
        ("speed", "180 deg/s", math.pi),
        ("temperature", "300 K", 26.85),
        ("inertia", "1340 g cm^2", 1.34e-4),
        ("fraction", "85 %", 0.85),
        ("ratio", 6, 6.0),
    ],
)
def test_numbers_are_converted_from_their_unit(kind: str, text: object, value: float) -> None:
    """Reference: definitions of the units (a kgf is 9.80665 N)."""
    assert parse_motor_quantity("number", text, UNIT_KINDS[kind]) == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize(
    ("kind", "text", "words"),
    [
        ("torque constant", "0.08", "no unit; write one of N m/A"),
        ("torque constant", "0.08 rpm", "rpm is not a valid unit"),
        ("torque", "3 mNm/A", "mN m/A is not a valid unit"),
        ("speed", 400, "no unit"),
        ("resistance", "-0.2 ohm", "out of range"),
        ("resistance", "0 ohm", "out of range"),
        ("mass", "heavy", "not a number"),
        ("ratio", True, "not a number"),
        ("fraction", "120 %", "at most 1"),
        ("efficiency", "0 %", "out of range"),
        ("mass", "-1 kg", r"out of range: more than 0 kg$"),
        ("fraction", "-0.1", r"out of range: at least 0, at most 1$"),
        ("temperature", "-274 degC", r"out of range: at least -273.15 degC$"),
        ("mass", "1e999 kg", "not a number with one of the units kg, g"),
        ("ratio", math.inf, "not a number"),
        ("efficiency", math.nan, "not a number"),
        ("temperature", "-300 degC", "out of range"),
        ("current", "inf A", "not a number"),
    ],
)
def test_numbers_with_another_unit_or_range_are_refused(
    kind: str, text: object, words: str
) -> None:
    with pytest.raises(ConfigurationError, match=words):
        parse_motor_quantity("number", text, UNIT_KINDS[kind])


def test_a_file_contains_numbers_with_units(tmp_path: Path) -> None:
    """Reference: the text."""
    motor = read_motor(write(tmp_path, TEXT + 'mass = "140 g"\nlimit_temperature = "85 degC"\n'))
    assert (motor.name, motor.source) == ("test", "bench")
    assert (motor.torque_constant, motor.gear_ratio, motor.mass) == (0.1, 6.0, 0.14)
    assert motor.limit_temperature == 85.0
    assert motor.price is None


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (
            'stall_torque = "288 N m"',
            r"gear_ratio x supply_voltage / resistance = 28\.8 N m: check",
        ),
        ('stall_torque = "0.3 N m"', "check the units"),
        ('stall_current = "5 A"', r"contradicts supply voltage / resistance = 48 A"),
        ('ambient_temperature = "90 degC"\nlimit_temperature = "85 degC"', "not above the ambient"),
        ("torque_constnt = 1", "torque_constant"),
        (
            'output_torque_constant = "600 N m/A"',
            r"contradicts torque_constant x gear_ratio = 0\.6 N m/A",
        ),
        (
            'no_load_speed = "400 rad/s"',
            r"400 rad/s contradicts .*\(torque_constant x gear_ratio\) = 40 rad/s",
        ),
        ('peak_torque = "1 N m"\ncontinuous_torque = "2 N m"', "2 N m is above the peak torque"),
        ('kp = "5 N m"', "N m is not a valid unit"),
        ("gear_efficiency = 0", "gear_efficiency: 0 is out of range"),
        ("mass = 3", "no unit"),
        ('peak_torque = "2 N m"\ncoulomb_friction = "3 N m"', "3 N m is not below the largest"),
        (
            'gear_efficiency = 1\ncoulomb_friction = "28.9 N m"',
            "not below the largest torque of 28.8 N m",
        ),
        ("[sources]\nresistance = 3", "sources is a table"),
        ("[sources]\nrezistance = 'x'", "resistance, "),
    ],
)
def test_contradictions_are_named(tmp_path: Path, more: str, words: str) -> None:
    with pytest.raises(ModelError, match=rf"motor\.toml: .*{words}"):
        read_motor(write(tmp_path, f"{TEXT}{more}\n"))


@pytest.mark.parametrize(
    ("numbers", "words"),
    [
        ({"peak_torque": 20.0, "current_limit": 15.0}, r"x current_limit = 7\.5 N m"),
        ({"continuous_torque": 20.0, "current_limit": 15.0}, r"x current_limit = 7\.5 N m"),
        ({"peak_torque": 20.0, "supply_voltage": 5.0, "resistance": 1.0}, r"resistance = 2\.5 N m"),
        ({"stall_torque": 28.0, "stall_current": 40.0}, r"stall_current = 20 N m"),
        ({"stall_torque": 28.0, "supply_voltage": 24.0, "resistance": 0.6}, r"resistance = 20 N m"),
        ({"no_load_speed": 200.0, "supply_voltage": 24.0}, r"output_torque_constant\) = 48 rad/s"),
    ],
)
def test_output_torque_constant_contradicts_other_numbers(
    numbers: dict[str, float], words: str
) -> None:
    """Reference: 0.5 N m/A x 40 A = 20 N m, and 24 V / 0.5 V s/rad = 48 rad/s."""
    with pytest.raises(ModelError, match=words):
        Motor("test", "bench", output_torque_constant=0.5, **numbers)  # type: ignore[arg-type]


def test_a_file_without_source_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="no source"):
        read_motor(write(tmp_path, TEXT.replace('source = "bench"\n', "")))


@pytest.mark.parametrize(
    ("number", "value"),
    [
        *(
            (number, 0.0)
            for number, kind in NUMBER_KINDS.items()
            if not (UNIT_KINDS[kind].zero or UNIT_KINDS[kind].signed)
        ),
        ("output_torque_constant", -0.1),
        ("resistance", math.nan),
        ("peak_torque", math.inf),
        ("gear_efficiency", 1.2),
    ],
)
def test_a_motor_in_memory_with_a_number_out_of_range_is_refused(number: str, value: float) -> None:
    """Zero would divide by zero in a current, or be read as a motor without losses."""
    with pytest.raises(ModelError, match=f"{number}: .*out of range"):
        Motor("test", "bench", **{number: value})  # type: ignore[arg-type]


def test_calculation_with_an_unknown_motor_number_is_refused_by_its_name() -> None:
    motor = Motor("test", "bench", torque_constant=0.1, gear_ratio=6.0)
    with pytest.raises(ModelError, match="output_torque_constant, gear_efficiency"):
        _ = motor.output_torque_per_ampere
    with pytest.raises(ModelError, match="resistance, supply_voltage, stall_current"):
        _ = motor.winding_ohms
    with pytest.raises(ModelError, match="supply_voltage"):
        motor.compute_available_torque(1.0)


def test_torque_falls_with_speed_between_the_limits() -> None:
    """Reference: tau = Kt N eta (V - Kt N w) / R, cut off by current limit and peak torque."""
    motor = Motor(
        *("test", "bench"),
        torque_constant=0.1,
        gear_ratio=6.0,
        gear_efficiency=0.9,
        resistance=0.5,
        supply_voltage=24.0,
        current_limit=30.0,
        peak_torque=15.0,
    )
    assert motor.compute_available_torque(0.0) == 15.0
    assert motor.compute_available_torque(20.0) == pytest.approx(0.54 * (24 - 12) / 0.5)
    assert motor.compute_available_torque(40.0) == 0.0
    assert motor.compute_available_torque(50.0) == 0.0
    assert motor.compute_current(-2.7) == pytest.approx(5.0)


def test_largest_torque_is_the_smallest_known_limit() -> None:
    """Reference: peak torque; current limit x Kt N eta; V / R x Kt N eta."""
    bare = Motor("test", "bench", torque_constant=0.1, gear_ratio=6.0, gear_efficiency=0.5)
    assert bare.largest_torque is None
    limited = replace(bare, current_limit=30.0)
    assert limited.largest_torque == (pytest.approx(9.0), "current_limit")
    driven = replace(limited, supply_voltage=24.0, resistance=1.2)
    assert driven.largest_torque == (pytest.approx(6.0), "supply_voltage")
    assert replace(driven, peak_torque=4.0).largest_torque == (4.0, "peak_torque")
    assert replace(driven, rotor_inertia=1e-4).reflected_inertia == pytest.approx(36e-4)


def test_largest_torque_without_efficiency_is_at_most_that_of_a_gear_without_losses() -> None:
    """Reference: 0.1 N m/A x 6 x 30 A = 18 N m. A bound alone is no torque of a motor."""
    bare = Motor("test", "bench", torque_constant=0.1, gear_ratio=6.0, current_limit=30.0)
    assert bare.largest_torque is None
    assert replace(bare, peak_torque=30.0).largest_torque == (
        pytest.approx(18.0),
        "current_limit",
    )
    assert replace(bare, peak_torque=10.0).largest_torque == (10.0, "peak_torque")


def test_a_name_that_is_too_long_for_a_file_is_an_unknown_motor() -> None:
    with pytest.raises(UnknownNameError, match="no motor 'aaa"):
        find_motor("a" * 300)
    with pytest.raises(ModelError, match="too long"):
        find_motor("a" * 300 + ".toml")


def test_ten_motors_have_a_source_and_numbers_without_contradiction() -> None:
    motors = [find_motor(name) for name in list_motors()]
    assert len(motors) >= 10
    for motor in motors:
        assert motor.source.startswith("http")
        assert set(motor.sources) <= set(NUMBER_KINDS)
        assert all(getattr(motor, number) is not None for number in motor.sources)
        assert "pastebin" not in motor.source
    servo = find_motor("dynamixel-xm540-w270")
    assert servo.output_torque_per_ampere == pytest.approx(2.409, abs=1e-3)  # as the manual states


def test_an_unknown_name_lists_the_known_ones() -> None:
    for name in ("dephy-actpak", ""):
        with pytest.raises(UnknownNameError, match="dephy-actpack"):
            find_motor(name)


def test_a_file_that_is_no_motor_is_refused_by_its_name(tmp_path: Path) -> None:
    """Bytes that are not UTF-8, a folder, no file, an empty file, an empty name."""
    path = tmp_path / "motor.toml"
    for content, words in (
        (TEXT.encode() + b"# \xff\n", "UTF-8"),
        (b"", "no source"),
        (TEXT.replace('"test"', '""').encode(), "name and source"),
        (b"mass = = 3\n", "not a TOML file"),
    ):
        path.write_bytes(content)
        with pytest.raises(ModelError, match=rf"motor\.toml: .*{words}"):
            find_motor(str(path))
    for name, words in ((tmp_path, "the path is a folder"), (tmp_path / "no.toml", "no such file")):
        with pytest.raises(ModelError, match=words):
            find_motor(str(name))


BAM = {
    "kt": 1.6,
    "R": 2.3,
    "armature": 0.012,
    "friction_base": 0.06,
    "friction_viscous": 0.025,
    "actuator": "mx64",
}


@pytest.mark.parametrize("model", ["m1", "m2", "m3", "m4", "m5", "m6"])
def test_servo_models_are_read(tmp_path: Path, model: str) -> None:
    """Reference: the equations of the models. m1 and m2 have no load-dependent friction."""
    loads = {"m3": "base", "m4": "base", "m5": "motor", "m6": "motor"}
    more = {f"load_friction_{loads[model]}": 0.3} if model in loads else {}
    path = tmp_path / "m.json"
    path.write_text(json.dumps({**BAM, **more, "model": model}))
    motor = read_bam_parameters(path)
    assert motor.name == f"mx64 ({model})"
    assert (motor.resistance, motor.viscous_friction, motor.coulomb_friction) == (2.3, 0.025, 0.06)
    assert motor.rotor_inertia == 0.012
    if model in loads:
        assert motor.output_torque_per_ampere == pytest.approx(1.6 * 0.7)
        assert find_motor(str(path)) == motor
    else:
        assert motor.gear_efficiency is None


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"model": "m7"}, "m1, m2, m3"),
        ({"model": "m5"}, "load_friction_motor"),
        ({"model": "m1", "R": -2.0}, "resistance: "),
        ({"model": "m1", "kt": None}, "torque_constant"),
        ({"model": "m3", "load_friction_base": "high"}, "load_friction"),
        ({"model": ["m1"]}, "m1, m2, m3"),
        ({"model": "m1", "R": math.nan}, "resistance: nan ohm is not a number"),
    ],
)
def test_invalid_servo_models_are_refused(tmp_path: Path, change: dict, words: str) -> None:
    path = tmp_path / "m.json"
    path.write_text(json.dumps({**BAM, **change}))
    with pytest.raises(ModelError, match=words):
        read_bam_parameters(path)
    for text in ("{", "[" * 100_000):
        path.write_text(text)
        with pytest.raises(ModelError, match="not valid JSON"):
            read_bam_parameters(path)
