"""Numbers of a motor with gear, and the quantities that follow from them.

Each number may be unknown (None). A function that needs an unknown number raises a ModelError with
the name of the number. Exceptions: `Motor.compute_available_torques` omits unknown friction and
limits, and `Motor.largest_torque` may use an upper bound of the torque per current.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, field, fields

import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError, ModelError
from pupper_analysis.models.motors.units import UNIT_KINDS, check_motor_number

MAX_STALL_RATIO = 1.1
"""Largest accepted ratio between a stated stall torque and torque per current x stall current, and
between a stated stall current and voltage / resistance (whose smallest accepted ratio is the
inverse). Losses in a gear only reduce the torque; 10 % permit rounded numbers. Chosen, not tuned.
"""

MIN_STALL_RATIO = 0.3
"""Smallest accepted ratio between most stated numbers of a motor, such as the stall torque, and
their values from other numbers. Below this ratio, friction and gear would lose more than 70 % of
the torque, which suggests other units. Chosen, not tuned.
"""

MAX_CONVENTION_RATIO = 2.0
"""Largest accepted ratio between a stated number of a motor, such as the peak torque, and its value
from other numbers; stall torque and stall current have the bound `MAX_STALL_RATIO`. Chosen, not
tuned: line and phase currents, and rms and peak values, differ by up to sqrt(3).
"""


def _multiply_known(first: float | None, second: float | None) -> float | None:
    """Return the product of two numbers; None if a number is unknown."""
    return None if first is None or second is None else first * second


def _number_field(kind: str) -> float | None:
    """Create a dataclass field for a motor number with the unit of its kind; by default None."""
    found: float | None = field(
        default=None, metadata={"kind": kind, "unit": UNIT_KINDS[kind].unit}
    )
    return found


@dataclass(frozen=True)
class Motor:
    """Motor with gear: electrical, mechanical and thermal numbers, None if unknown.

    Numbers are at the rotor, unless the text names the output of the gear.

    Attributes:
        name: Name.
        source: Source of the numbers, for example an address.
        sources: {number: source} of numbers from another source.
        torque_constant: Torque per current of the rotor [N m/A].
        resistance: Resistance of the winding for this current [ohm].
        resistance_temperature: Temperature at which the resistance was measured [degC].
        resistance_rise: Relative rise of the resistance per kelvin [1/K].
        gear_ratio: Turns of the rotor per turn of the output.
        gear_efficiency: Output power per rotor power of the gear, if the motor drives.
        output_torque_constant: Torque at the output per current [N m/A], with all losses.
        rotor_inertia: Inertia of the rotor [kg m^2].
        coulomb_friction: Dry friction at the output [N m].
        viscous_friction: Viscous friction at the output [N m s/rad].
        load_friction: Load-dependent dry friction, as a fraction of the torque.
        supply_voltage: Voltage of the supply [V].
        current_limit: Largest current [A].
        peak_torque: Largest torque at the output [N m], as limited by the drive.
        continuous_torque: Largest permanent torque at the output [N m] that the data sheet states
            (nominal or rated torque).
        stall_torque: Torque at the output, at rest with the supply voltage [N m].
        stall_current: Current at rest with the supply voltage [A].
        no_load_speed: Speed of the output without load [rad/s].
        winding_resistance: Thermal resistance from the winding to the housing, or to the ambient
            air if no number of the housing is known [K/W].
        housing_resistance: Thermal resistance from the housing to the ambient air [K/W].
        winding_capacity: Heat capacity of the winding [J/K].
        housing_capacity: Heat capacity of the housing [J/K].
        ambient_temperature: Temperature of the ambient air for the thermal resistances [degC].
        limit_temperature: Largest temperature of the winding [degC].
        kp: Stiffness of the position servo at the output [N m/rad].
        kd: Damping of the position servo at the output [N m s/rad].
        mass: Mass with gear [kg].
        price: Price [USD].
    """

    name: str
    source: str
    sources: dict[str, str] = field(default_factory=dict)
    torque_constant: float | None = _number_field("torque constant")
    resistance: float | None = _number_field("resistance")
    resistance_temperature: float | None = _number_field("temperature")
    resistance_rise: float | None = _number_field("relative rise")
    gear_ratio: float | None = _number_field("ratio")
    gear_efficiency: float | None = _number_field("efficiency")
    output_torque_constant: float | None = _number_field("torque constant")
    rotor_inertia: float | None = _number_field("inertia")
    coulomb_friction: float | None = _number_field("friction torque")
    viscous_friction: float | None = _number_field("viscous friction")
    load_friction: float | None = _number_field("fraction")
    supply_voltage: float | None = _number_field("voltage")
    current_limit: float | None = _number_field("current")
    peak_torque: float | None = _number_field("torque")
    continuous_torque: float | None = _number_field("torque")
    stall_torque: float | None = _number_field("torque")
    stall_current: float | None = _number_field("current")
    no_load_speed: float | None = _number_field("speed")
    winding_resistance: float | None = _number_field("thermal resistance")
    housing_resistance: float | None = _number_field("thermal resistance")
    winding_capacity: float | None = _number_field("heat capacity")
    housing_capacity: float | None = _number_field("heat capacity")
    ambient_temperature: float | None = _number_field("temperature")
    limit_temperature: float | None = _number_field("temperature")
    kp: float | None = _number_field("stiffness")
    kd: float | None = _number_field("viscous friction")
    mass: float | None = _number_field("mass")
    price: float | None = _number_field("price")

    def __post_init__(self) -> None:
        """Check that the numbers are in range, and do not contradict each other.

        Raises:
            ModelError: If a check fails, for example for a torque constant of zero.
        """
        for number in fields(self):
            value = getattr(self, number.name)
            if "kind" not in number.metadata or value is None:
                continue
            try:
                kind = UNIT_KINDS[number.metadata["kind"]]
                check_motor_number(number.name, value, kind, f"{value:g}")
            except ConfigurationError as error:
                problem = diagnose("motor-number", name=number.name, problem=error.problem)
                raise ModelError(self.name, problem) from error
        current = self.stall_current
        resistance, voltage = self.resistance, self.supply_voltage
        if current is not None and resistance is not None and voltage is not None:
            expected = voltage / resistance
            if not 1 / MAX_STALL_RATIO <= current / expected <= MAX_STALL_RATIO:
                raise ModelError(
                    self.name,
                    diagnose("motor-stall-current", stated=current, expected=expected),
                )
        self._check_conventions()
        permanent, peak = self.continuous_torque, self.peak_torque
        if permanent is not None and peak is not None and permanent > peak:
            raise ModelError(
                self.name,
                diagnose(
                    "motor-continuous-above-peak",
                    continuous=Quantity(permanent, "N m"),
                    peak=Quantity(peak, "N m"),
                ),
            )
        ambient, limit = self.ambient_temperature, self.limit_temperature
        if ambient is not None and limit is not None and limit <= ambient:
            raise ModelError(
                self.name, diagnose("motor-limit-below-ambient", limit=limit, ambient=ambient)
            )
        friction, largest = self.coulomb_friction, self.largest_torque
        if friction is not None and largest is not None and friction >= largest[0]:
            raise ModelError(
                self.name,
                diagnose(
                    "motor-friction-above-torque",
                    friction=Quantity(friction, "N m"),
                    largest=Quantity(largest[0], "N m"),
                ),
            )

    def _check_conventions(self) -> None:
        """Raise a ModelError if stated numbers contradict a product or quotient of other numbers.

        For example, the speed without load is compared with supply voltage / torque per current.
        Pairs with an unknown number are omitted.
        """
        constants: dict[str, float | None] = {
            "torque_constant x gear_ratio": _multiply_known(self.torque_constant, self.gear_ratio),
            "output_torque_constant": self.output_torque_constant,
        }
        voltage, resistance = self.supply_voltage, self.resistance
        currents = {
            "supply_voltage / resistance": _multiply_known(voltage, resistance and 1 / resistance),
            "stall_current": self.stall_current,
        }
        (first, expected), _ = constants.items()
        number = "output_torque_constant"
        self._check_ratio(number, expected, first, "N m/A", MAX_CONVENTION_RATIO)
        for name, constant in constants.items():
            free = _multiply_known(voltage, constant and 1 / constant)
            formula = f"supply_voltage / ({name})"
            self._check_ratio("no_load_speed", free, formula, "rad/s", MAX_CONVENTION_RATIO)
            for current_name, current in currents.items():
                formula = f"{name} x {current_name}"
                expected = _multiply_known(constant, current)
                self._check_ratio("stall_torque", expected, formula, "N m", MAX_STALL_RATIO)
            for current_name, current in {**currents, "current_limit": self.current_limit}.items():
                formula = f"{name} x {current_name}"
                expected = _multiply_known(constant, current)
                for number in ("peak_torque", "continuous_torque"):
                    self._check_ratio(number, expected, formula, "N m", MAX_CONVENTION_RATIO, 0.0)

    def _check_ratio(
        self,
        number: str,
        expected: float | None,
        formula: str,
        unit: str,
        most: float,
        least: float = MIN_STALL_RATIO,
    ) -> None:
        """Raise a ModelError if a number / its expected value is not in [``least``, ``most``].

        ``expected`` is the value [``unit``] of the ``formula``. Unknown values (None) are not
        checked.
        """
        stated: float | None = getattr(self, number)
        if stated is None or expected is None:
            return
        if not least <= stated / expected <= most:
            problem = diagnose(
                "motor-contradiction",
                number=number,
                stated=stated,
                expected=expected,
                unit=unit,
                formula=formula,
            )
            raise ModelError(self.name, problem)

    def get(self, number: str) -> float:
        """Return a value of this motor, such as the resistance; raise an error if it is unknown.

        Raises:
            ModelError: If the number is unknown.
        """
        value: float | None = getattr(self, number)
        if value is None:
            raise ModelError(self.name, diagnose("motor-numbers-unknown", numbers=[number]))
        return value

    def list_unknown(self, *numbers: str) -> tuple[str, ...]:
        """Return the given field names of this motor whose value is unknown (None).

        Args:
            numbers: Names of numeric fields, such as ``"stall_torque"``.
        """
        return tuple(number for number in numbers if getattr(self, number) is None)

    @property
    def output_torque_per_ampere(self) -> float:
        """Torque at the output per current, while the motor drives the load [N m/A].

        The first known of these numbers: the stated `output_torque_constant`; stall torque / stall
        current; torque constant x gear ratio x gear efficiency.

        Raises:
            ModelError: If these numbers are unknown.
        """
        if self.output_torque_constant is not None:
            return self.output_torque_constant
        if self.stall_torque is not None and self.stall_current is not None:
            return self.stall_torque / self.stall_current
        needed = ("torque_constant", "gear_ratio", "gear_efficiency")
        unknown = self.list_unknown(*needed)
        if unknown:
            raise ModelError(
                self.name,
                diagnose("motor-numbers-unknown", numbers=["output_torque_constant", *unknown]),
            )
        return self.get("torque_constant") * self.get("gear_ratio") * self.get("gear_efficiency")

    @property
    def winding_ohms(self) -> float:
        """Resistance of the winding [ohm]: the stated number, or supply voltage / stall current.

        Raises:
            ModelError: If these numbers are unknown.
        """
        if self.resistance is not None:
            return self.resistance
        if self.supply_voltage is not None and self.stall_current is not None:
            return self.supply_voltage / self.stall_current
        unknown = ["resistance", *self.list_unknown("supply_voltage", "stall_current")]
        raise ModelError(self.name, diagnose("motor-numbers-unknown", numbers=unknown))

    def compute_current(self, torque: float) -> float:
        """Return the current [A], at least 0, for a torque at the output of a motor at rest.

        Dry friction is not counted: it may help to hold a load, but is not reliable.

        Args:
            torque: Torque at the output [N m].

        Raises:
            ModelError: If the numbers of `output_torque_per_ampere` are unknown.
        """
        return abs(torque) / self.output_torque_per_ampere

    @property
    def reflected_inertia(self) -> float:
        """Inertia of the rotor at the output [kg m^2]: rotor inertia x gear ratio^2.

        Raises:
            ModelError: If rotor inertia or gear ratio are unknown.
        """
        return self.get("rotor_inertia") * self.get("gear_ratio") ** 2

    @property
    def largest_torque(self) -> tuple[float, str] | None:
        """Largest torque at the output at rest [N m], and the name of the field that limits it.

        The torque is the smallest known limit from peak torque, stall torque, current limit and
        supply voltage. The field is for example ``peak_torque``. None if no torque limit follows
        from the known numbers.
        """
        limits: list[tuple[float, str]] = []
        if self.peak_torque is not None:
            limits.append((self.peak_torque, "peak_torque"))
        if self.stall_torque is not None:
            limits.append((self.stall_torque, "stall_torque"))
        per_ampere = _multiply_known(self.torque_constant, self.gear_ratio) if limits else None
        with suppress(ModelError):
            per_ampere = self.output_torque_per_ampere
        if per_ampere is not None:
            if self.current_limit is not None:
                limits.append((self.current_limit * per_ampere, "current_limit"))
            with suppress(ModelError):
                current = self.get("supply_voltage") / self.winding_ohms
                limits.append((current * per_ampere, "supply_voltage"))
        return min(limits, default=None)

    def compute_available_torque(self, speed: float) -> float:
        """Return the largest torque [N m], at least 0, that the motor can exert at a speed.

        Args:
            speed: Speed of the output, in the direction of the torque [rad/s].

        Raises:
            ModelError: If a number is unknown (see `compute_available_torques`).
        """
        return float(self.compute_available_torques(np.array(speed)))

    def compute_available_torques(self, speeds: Array) -> Array:
        """Return the largest torques [N m], at least 0, that the motor can exert at output speeds.

        The torque at the output is tau = min(I_max, (V - Ke w) / R) K - T_f, and at most stall
        torque and peak torque. Symbols: speed w of the output, current limit I_max, supply voltage
        V, resistance R of the cold winding (`winding_ohms`), torque per current K at the output
        (`output_torque_per_ampere`). The back-EMF constant Ke is torque constant times gear ratio,
        or V / no-load speed; if both are known, the smaller torque is returned. The friction T_f is
        Coulomb friction + viscous friction x w, if known, for w > 0. With the no-load speed of a
        data sheet, which includes friction, T_f is 0.

        Args:
            speeds: Speeds of the output, in the direction of the torques [rad/s].

        Returns:
            Shape of `speeds`.

        Raises:
            ModelError: If supply voltage, resistance, torque per current or Ke are unknown.
        """
        voltage = self.get("supply_voltage")
        friction = np.where(
            speeds > 0,
            (self.coulomb_friction or 0.0) + (self.viscous_friction or 0.0) * speeds,
            0.0,
        )
        lines: list[tuple[float, Array]] = []  # back-EMF constant, friction
        if self.torque_constant is not None and self.gear_ratio is not None:
            lines.append((self.torque_constant * self.gear_ratio, friction))
        if self.no_load_speed is not None or not lines:
            lines.append((voltage / self.get("no_load_speed"), np.zeros_like(friction)))
        most = math.inf if self.current_limit is None else self.current_limit
        limits = [limit for limit in (self.peak_torque, self.stall_torque) if limit is not None]
        available = np.full(np.shape(speeds), min(limits, default=math.inf))
        for constant, lost in lines:
            currents = np.clip((voltage - constant * speeds) / self.winding_ohms, 0.0, most)
            torques = currents * self.output_torque_per_ampere - lost
            available = np.minimum(available, np.maximum(torques, 0.0))
        return available


def list_unknown_numbers(error: ModelError) -> tuple[str, ...]:
    """Return the names of the motor numbers that an error reports as unknown, if any."""
    numbers = error.cause.values.get("numbers", ())
    return tuple(map(str, numbers)) if isinstance(numbers, tuple | list) else ()


NUMBER_KINDS = {
    motor_field.name: motor_field.metadata["kind"]
    for motor_field in fields(Motor)
    if "kind" in motor_field.metadata
}
"""{field of `Motor` that contains a number: kind of quantity, a key of ``UNIT_KINDS``}."""
