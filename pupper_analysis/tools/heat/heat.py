"""Heat of the motors that hold a stance: losses, temperatures, minutes until hot, battery.

`study_heat` computes the torques of a stand at rest. Each torque determines a current, the current
a copper loss, and the loss the temperature of the winding (``models/motors/thermal.py``).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from pupper_analysis.base.arguments import check_arguments, check_type
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic, contains_error, diagnose
from pupper_analysis.base.errors import ConfigurationError, ModelError, UnknownNameError
from pupper_analysis.base.results import Result, Tabular
from pupper_analysis.models.motors.motor import Motor, list_unknown_numbers
from pupper_analysis.models.motors.reading import find_motor
from pupper_analysis.models.motors.thermal import (
    ThermalNetwork,
    compute_continuous_torque,
    list_unknown_thermal_numbers,
)
from pupper_analysis.prepare.judge import describe_ties
from pupper_analysis.robot.joints import check_motor_joints
from pupper_analysis.robot.masses import describe_missing_masses
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.soft_ground import solve_stand_as_simulated
from pupper_analysis.stance.stand import Stand, resolve_stance, stand_statics
from pupper_analysis.stance.task import StandTask

_MAX_NUM_TIMES, _NUM_EQUAL_STEPS = 121, 24
"""Largest number of times of the curves of temperature, and number of equal time steps of which
those with a large chord error are halved. Chosen, not tuned.
"""

_MAX_CHORD_ERROR = 1e-3
"""Largest distance between a curve and its straight segments, in the middle of a time step, divided
by the range of the curve [1]; less than the width of a drawn line. Chosen, not tuned.
"""

_OVERHEATING_DURATION = 2.0
"""Duration of the curves, divided by the time in which the first motor reaches its temperature
limit [1]. The prediction is of no use after the first motor has failed. Chosen, not tuned.
"""

_MAX_DURATION = 86400.0
"""Largest duration of the curves [s]: a day. Chosen, not tuned."""

_SETTLED_FRACTION = 0.95
"""Fraction [1] of the final temperature rise that determines the end time of the temperature curve
of a motor that is not known to reach its limit. Chosen, not tuned.
"""

TEMPERATURE_RANGE = (-60.0, 300.0)
"""Lowest and highest accepted temperature [degC] of the ambient air and of the winding's limit.
Chosen, not tuned.
"""


@dataclass(frozen=True)
class MotorHeat(Result):
    """Temperature, losses and torque limits of a motor that holds a stance at rest.

    A motor is too weak if ``torque`` exceeds ``largest_torque`` (`too_weak`).

    Attributes:
        joint: Joint.
        motor: Name of the motor.
        torque: Torque of the stance (N m).
        current: Current of this torque (A); None if unknown.
        cold_loss: Copper loss in the winding (W) at ambient temperature. If thermal numbers of the
            motor are unknown, the loss at the temperature of the stated resistance. None if the
            current or the resistance is unknown, or if the motor is too weak.
        steady_loss: Copper loss at the final temperature (W). Infinite if the temperature grows
            without bound. None if unknown, or if the motor is too weak.
        steady_temperature: Final temperature of the winding (degC). Infinite if the temperature
            grows without bound. None if unknown, or if the motor is too weak.
        limit_temperature: Largest permitted temperature of the winding (degC); None if unknown.
        time_to_limit: Time until the winding reaches ``limit_temperature`` (s). Infinite if the
            winding never reaches the limit. None if unknown, or if the motor is too weak.
        continuous_torque: Largest permanent torque (N m), at most ``largest_torque``. Computed from
            the thermal numbers if known. Otherwise read from the data sheet, unless a temperature
            (ambient or limit) is requested. None if unknown.
        largest_torque: Largest torque of the motor at rest (N m); None if unknown.
        limiting_number: Name of the motor data that limits the largest torque; empty if unknown.
        unknown: Names of the missing motor data without which the motor cannot be judged. If
            ``continuous_torque`` is known, only ``peak_torque`` may be missing. Empty if the motor
            is too weak.
    """

    _key_fields: ClassVar[tuple[str, ...]] = ("joint", "steady_temperature")

    joint: str
    motor: str
    torque: float = field(metadata={"unit": "N m"})
    current: float | None = field(metadata={"unit": "A"})
    cold_loss: float | None = field(metadata={"unit": "W"})
    steady_loss: float | None = field(metadata={"unit": "W"})
    steady_temperature: float | None = field(metadata={"unit": "degC"})
    limit_temperature: float | None = field(metadata={"unit": "degC"})
    time_to_limit: float | None = field(metadata={"unit": "s"})
    continuous_torque: float | None = field(metadata={"unit": "N m"})
    largest_torque: float | None = field(metadata={"unit": "N m"})
    limiting_number: str
    unknown: tuple[str, ...]

    @property
    def loss(self) -> float | None:
        """Copper loss [W]: ``steady_loss``; ``cold_loss`` if the former is None or infinite.

        None if the loss is unknown, or if the motor cannot exert the torque.
        """
        if self.steady_loss is None or math.isinf(self.steady_loss):
            return self.cold_loss
        return self.steady_loss

    @property
    def too_weak(self) -> bool:
        """Whether the magnitude of the torque exceeds the largest torque of the motor at rest."""
        return self.largest_torque is not None and abs(self.torque) > self.largest_torque

    @property
    def overheats(self) -> bool:
        """Whether the winding reaches the temperature limit, or grows hotter without bound.

        A torque magnitude above the continuous torque also counts if ``time_to_limit`` is unknown.
        False for a motor that cannot exert the torque.
        """
        if self.too_weak:
            return False
        if self.time_to_limit is None:
            permanent = self.continuous_torque
            if permanent is not None and abs(self.torque) > permanent:
                return True
        reached = self.time_to_limit is not None and math.isfinite(self.time_to_limit)
        final = self.steady_temperature
        return reached or (final is not None and math.isinf(final))


@dataclass(frozen=True, eq=False)
class HeatStudy(Tabular):
    """Heat of the motors that hold a stance at rest, and consumption of the battery.

    Attributes:
        name: Name of the robot.
        stand: Stand on MuJoCo's soft ground if possible, otherwise on rigid ground.
        motors: Heat of each assigned motor, in actuator order.
        omitted: Joints with an actuator but without an assigned motor.
        loss: Copper loss of all assigned motors (W), at the final temperatures as far as known.
            None if a motor cannot exert the torque of the stance, or if its loss is unknown.
        supply_voltage: Voltage of the battery (V); None if unknown, or if motors differ.
        battery_current: Current of the battery (A); None if the voltage or the loss is unknown.
        battery_energy: Energy of the battery (J); None if not given.
        battery_time: Time until the battery is empty (s). Infinite without loss. None if the
            battery energy or the loss is unknown.
        times: (n,) times of the temperatures (s).
        temperatures: (n, motors) temperatures of the windings (degC); NaN if unknown.
        missing_masses: Message about links with assumed masses; None if the files state all.
        ties: Messages about constraints of the file that tie the robot to the world.
    """

    _key_fields: ClassVar[tuple[str, ...]] = ("passed", "overheats", "known", "first")
    _units_of_columns: ClassVar[dict[str, str]] = {"time": "s", "temperature *": "degC"}

    name: str
    stand: Stand
    motors: tuple[MotorHeat, ...]
    omitted: tuple[str, ...]
    loss: float | None = field(metadata={"unit": "W"})
    supply_voltage: float | None = field(metadata={"unit": "V"})
    battery_current: float | None = field(metadata={"unit": "A"})
    battery_energy: float | None = field(metadata={"unit": "J"})
    battery_time: float | None = field(metadata={"unit": "s"})
    times: Array = field(metadata={"unit": "s"})
    temperatures: Array = field(metadata={"unit": "degC"})
    missing_masses: Diagnostic | None = None
    ties: tuple[Diagnostic, ...] = ()

    def _columns(self) -> dict[str, Array]:
        """Return {column: values, shape (n,)}: time, and the temperature of each motor."""
        joints = [motor.joint for motor in self.motors]
        temperatures = dict(zip(joints, self.temperatures.T, strict=True))
        return {
            "time": self.times,
            **{f"temperature {joint}": values for joint, values in temperatures.items()},
        }

    @property
    def first(self) -> MotorHeat:
        """Motor that limits the stance: too weak, first to overheat, or closest to its limit."""

        def rank(motor: MotorHeat) -> tuple[float, float, float, float]:
            """Return a sort key of a motor: smallest for the motor that limits the stance."""
            if motor.too_weak:
                return -abs(motor.torque) / (motor.largest_torque or 1.0), 0.0, 0.0, 0.0
            group = 0.0 if motor.overheats else 1.0
            time = math.inf if motor.time_to_limit is None else motor.time_to_limit
            final, limit = motor.steady_temperature, motor.limit_temperature
            margin = math.inf if final is None or limit is None else limit - final
            if final is not None and math.isinf(final):  # also if the limit is unknown
                margin = -math.inf
            return group, time, margin, -(motor.cold_loss or 0.0)

        return min(self.motors, key=rank)

    @property
    def weak(self) -> tuple[MotorHeat, ...]:
        """Motors that cannot exert the torque of the stance, in actuator order."""
        return tuple(motor for motor in self.motors if motor.too_weak)

    @property
    def overheats(self) -> bool:
        """Whether `MotorHeat.overheats` holds for a motor; False for motors that are too weak."""
        return any(motor.overheats for motor in self.motors)

    @property
    def known(self) -> bool:
        """Whether all data are known: of each loaded motor, of each driven joint, and all masses.

        A driven joint without motor, a loaded motor with ``unknown`` numbers, and an assumed mass
        give False.
        """
        judged = all(not motor.unknown or motor.torque == 0.0 for motor in self.motors)
        return judged and not self.omitted and self.missing_masses is None

    @property
    def passed(self) -> bool:
        """Whether each motor is known to exert its torque in the stance without overheating.

        False also if `ties` contains an error.
        """
        return self.known and not self.overheats and not self.weak and not contains_error(self.ties)


@check_arguments
def study_heat(
    robot: Robot,
    stance: StandTask | Stand,
    motors: Mapping[str, Motor | str],
    *,
    ambient: float | None = None,
    limit: float | None = None,
    battery_energy: float | None = None,
) -> HeatStudy:
    """Predict the heat of the motors that hold a stance at rest.

    Args:
        robot: Robot.
        stance: Stand task, or a stand that satisfies a task on rigid ground.
        motors: {joint: motor}; each motor also as a name or file (`find_motor`).
        ambient: Temperature of the ambient air [degC]. Default: the value in each motor's data.
        limit: Largest temperature of the windings [degC]. Default: the value in each motor's data.
        battery_energy: Energy of the battery [J].

    Raises:
        StanceUnreachableError: If the stance is out of reach.
        UnknownNameError: If the robot has no such joint, or a name of a motor is unknown.
        ModelError: If the file of a motor cannot be read, or is not valid, for example.
        ConfigurationError: If an argument is not valid, no joint of the robot has a motor, or a
            slide has a motor. Also if the limit is not above the ambient temperature.
    """
    _check_conditions(ambient, limit, battery_energy)
    motors = _find_motors(robot, motors)
    robot, stand = resolve_stance(robot, stance)
    held = solve_stand_as_simulated(robot, stand)
    torques = stand_statics(robot, held).joint_torques
    driven = robot.mj_convention.actuator_index >= 0
    names = [name for name, has in zip(robot.joint_names, driven, strict=True) if has]
    assigned = [name for name in names if name in motors]
    if not assigned:
        raise ConfigurationError("motors", diagnose("no-motor-assigned"))
    check_motor_joints(robot, assigned, "motors")
    loads = dict(zip(robot.joint_names, torques.tolist(), strict=True))
    heats = tuple(
        _compute_motor_heat(name, motors[name], float(loads[name]), ambient, limit)
        for name in assigned
    )
    losses = [heat.loss for heat in heats if heat.loss is not None]
    loss = sum(losses) if len(losses) == len(heats) else None
    voltages = {motors[name].supply_voltage for name in assigned}
    voltage = voltages.pop() if len(voltages) == 1 else None
    duration = _choose_duration(heats, [motors[name] for name in assigned], ambient)

    def compute_curves(times: Array) -> Array:
        """Return the temperatures of all windings at ``times`` [s], shape (n, motors) [degC]."""
        curves = [_compute_curve(heat, motors[heat.joint], times, ambient) for heat in heats]
        return np.stack(curves, axis=1)

    times = _refine_times(duration, compute_curves)
    return HeatStudy(
        name=robot.name,
        stand=held,
        motors=heats,
        omitted=tuple(name for name in names if name not in motors),
        loss=loss,
        supply_voltage=voltage,
        battery_current=None if voltage is None or loss is None else loss / voltage,
        battery_energy=battery_energy,
        battery_time=None
        if battery_energy is None or loss is None
        else (battery_energy / loss if loss else math.inf),
        times=times,
        temperatures=compute_curves(times),
        missing_masses=describe_missing_masses(robot),
        ties=describe_ties(robot, stand),
    )


def _find_motors(robot: Robot, motors: Mapping[str, Motor | str]) -> dict[str, Motor]:
    """Return {joint: motor}, with motors instead of names; an unknown joint raises an error."""
    found = dict[str, Motor]()
    for joint, motor in motors.items():
        if joint not in robot.joint_names:
            raise UnknownNameError(robot.name, "joint", joint, robot.joint_names)
        check_type(f"motors[{joint}]", motor, Motor | str)
        found[joint] = find_motor(motor) if isinstance(motor, str) else motor
    return found


def _check_conditions(
    ambient: float | None, limit: float | None, battery_energy: float | None
) -> None:
    """Raise a ConfigurationError if a temperature [degC] or the battery [J] is out of range.

    The limit must be above the ambient temperature.
    """
    low, high = TEMPERATURE_RANGE
    for name, value in (("ambient", ambient), ("limit", limit)):
        if value is not None and not low <= value <= high:
            problem = diagnose("temperature-out-of-range", given=value, low=low, high=high)
            raise ConfigurationError(name, problem)
    if ambient is not None and limit is not None and limit <= ambient:
        raise ConfigurationError(
            "limit", diagnose("motor-limit-below-ambient", limit=limit, ambient=ambient)
        )
    if battery_energy is not None and not 0 < battery_energy < math.inf:
        raise ConfigurationError("battery", diagnose("battery-not-valid"))


def _compute_motor_heat(
    joint: str, motor: Motor, torque: float, ambient: float | None, limit: float | None
) -> MotorHeat:
    """Compute the heating of a motor with a constant torque [N m].

    ``ambient`` and ``limit`` [degC] replace the temperatures of the motor, unless None.
    """
    largest, limiting = motor.largest_torque or (None, "")
    unknown = [*list_unknown_thermal_numbers(motor, ambient)]
    current = ohms = network = None
    try:
        current = motor.compute_current(torque)
    except ModelError as error:
        unknown.extend(list_unknown_numbers(error))
    try:
        ohms = motor.winding_ohms
    except ModelError as error:
        unknown.extend(list_unknown_numbers(error))
    if current is not None and not unknown:
        network = ThermalNetwork.of_motor(motor, current, ambient)
    highest = motor.limit_temperature if limit is None else limit
    air = motor.ambient_temperature if ambient is None else ambient
    if limit is not None and air is not None and limit <= air:
        raise ConfigurationError(
            "limit", diagnose("motor-limit-below-ambient", limit=limit, ambient=air)
        )
    if highest is None:
        unknown.append("limit_temperature")
    try:
        continuous = compute_continuous_torque(motor, ambient, limit)
    except ModelError:
        continuous = None
    steady = None if network is None else network.steady_temperature
    too_weak = largest is not None and abs(torque) > largest
    time = None
    if network is not None and highest is not None and not too_weak:
        time = network.find_time(highest)
    if continuous is not None:  # the data sheet states a torque that the motor exerts permanently
        unknown = []
        if time is None and abs(torque) <= continuous:
            time = math.inf
    if largest is None:
        unknown.append("peak_torque")
    heat = MotorHeat(
        joint=joint,
        motor=motor.name,
        torque=torque,
        current=current,
        cold_loss=_compute_cold_loss(network, current, ohms),
        steady_loss=None
        if network is None or steady is None
        else (network.compute_loss(steady) if math.isfinite(steady) else math.inf),
        steady_temperature=steady,
        limit_temperature=highest,
        time_to_limit=time,
        continuous_torque=continuous,
        largest_torque=largest,
        limiting_number=limiting,
        unknown=tuple(dict.fromkeys(unknown)),
    )
    if not heat.too_weak:
        return heat
    # A current that does not flow heats nothing.
    return replace(
        heat,
        cold_loss=None,
        steady_loss=None,
        steady_temperature=None,
        time_to_limit=None,
        unknown=(),
    )


def _compute_cold_loss(
    network: ThermalNetwork | None, current: float | None, ohms: float | None
) -> float | None:
    """Return the copper loss before the motor warms up [W]; see `MotorHeat.cold_loss`."""
    if network is not None:
        return network.compute_loss(network.ambient)
    return None if current is None or ohms is None else current**2 * ohms


def _refine_times(duration: float, compute_curves: Callable[[Array], Array]) -> Array:
    """Return times from 0 to ``duration`` [s], shape (n,), denser where a curve bends.

    Equal steps are halved, those with the largest chord errors first, until each chord error is at
    most `_MAX_CHORD_ERROR`, or the number of times is `_MAX_NUM_TIMES`. A winding with a small heat
    capacity warms up within seconds, and the housing within an hour.

    Args:
        duration: Last time [s].
        compute_curves: Function that returns temperatures, shape (n, motors), at times (n,) [s].
            NaN is a curve that is not drawn.
    """
    times = np.linspace(0.0, duration, _NUM_EQUAL_STEPS + 1)
    while duration > 0 and len(times) < _MAX_NUM_TIMES:
        curves, middles = compute_curves(times), (times[:-1] + times[1:]) / 2
        bends = np.abs(compute_curves(middles) - (curves[:-1] + curves[1:]) / 2)
        ranges = np.ptp(curves, axis=0)
        errors = np.where(ranges > 0, bends / np.where(ranges > 0, ranges, 1.0), 0.0)
        largest = np.nan_to_num(errors).max(axis=1)
        order = np.argsort(-largest)[: _MAX_NUM_TIMES - len(times)]
        halved = order[largest[order] > max(_MAX_CHORD_ERROR, largest.max() / 2)]
        if not len(halved):
            break
        times = np.union1d(times, middles[halved])
    return times


def _choose_duration(
    heats: tuple[MotorHeat, ...], motors: list[Motor], ambient: float | None
) -> float:
    """Return the duration of the temperature curves [s].

    If a motor reaches its temperature limit after some time, the duration is
    `_OVERHEATING_DURATION` times the first such time. Otherwise, it is the longest time in which a
    winding settles. For a winding that heats up without limit, this time is the sum of the thermal
    capacities times the sum of the resistances. The duration is at most `_MAX_DURATION`.
    """
    longest = 0.0
    hot = [heat.time_to_limit for heat in heats if heat.time_to_limit is not None]
    first = min(hot, default=math.inf)
    if 0 < first < math.inf:
        return min(_OVERHEATING_DURATION * first, _MAX_DURATION)
    for heat, motor in zip(heats, motors, strict=True):
        if heat.steady_temperature is None or not heat.current:
            continue
        network = ThermalNetwork.of_motor(motor, heat.current, ambient)
        end = heat.steady_temperature
        if heat.time_to_limit is not None and math.isfinite(heat.time_to_limit):
            time = heat.time_to_limit
        elif math.isfinite(end):
            time = network.find_time(network.ambient + _SETTLED_FRACTION * (end - network.ambient))
        else:
            time = float(network.capacities.sum() * network.resistances.sum())
        longest = max(longest, time)
    return min(longest, _MAX_DURATION)


def _compute_curve(heat: MotorHeat, motor: Motor, times: Array, ambient: float | None) -> Array:
    """Return the temperatures of a winding at ``times`` [s], shape (n,) [degC]; NaN if unknown.

    ``ambient`` is the temperature of the air [degC]. None selects the value in the motor's data.
    """
    if heat.steady_temperature is None or heat.current is None:
        return np.full(len(times), np.nan)
    network = ThermalNetwork.of_motor(motor, heat.current, ambient)
    curve: Array = network.compute_temperatures(times)[:, 0]
    return curve
