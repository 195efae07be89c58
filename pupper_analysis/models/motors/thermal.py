"""Temperature of the winding of a motor over time, at a constant current.

Copper losses heat the winding. Heat flows from the winding to the housing, and from the housing to
the ambient air:

    C_w dT_w/dt = i^2 R (1 + alpha (T_w - T_0)) - (T_w - T_h) / R_wh
    C_h dT_h/dt = (T_w - T_h) / R_wh - (T_h - T_a) / R_ha

The equations are linear in the temperatures, so that the temperatures are sums of exponentials.
Without numbers of a housing, the network has one node. R (1 + alpha (T - T_0)) is the resistance of
copper. Iron losses are zero at rest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.models.motors.motor import Motor
from pupper_analysis.models.motors.reading import find_motor, list_motors

THERMAL_NUMBERS = (
    "winding_resistance",
    "winding_capacity",
    "resistance_rise",
    "resistance_temperature",
)
"""Fields of `Motor` that the thermal network requires, besides the electrical resistance and the
ambient temperature. Both fields of the housing may be unknown: the network then has one node, the
winding.
"""

_TIME_TOLERANCE = 1e-12
"""Relative tolerance of the time at which a temperature is reached. Chosen, not tuned."""


@dataclass(frozen=True, eq=False)
class ThermalNetwork:
    """Thermal network of a motor at a constant current: winding and, if known, housing.

    Attributes:
        resistances: Thermal resistances from each node to the next, the last to the ambient air,
            shape (n,) [K/W]. The winding is the first node.
        capacities: Heat capacities of the nodes, shape (n,) [J/K].
        ambient: Temperature of the ambient air [degC].
        current: Current [A].
        ohms: Resistance of the winding at ``reference`` [ohm].
        rise: Relative rise of this resistance per kelvin [1/K].
        reference: Temperature of ``ohms`` [degC].
    """

    resistances: Array
    capacities: Array
    ambient: float
    current: float
    ohms: float
    rise: float
    reference: float

    @classmethod
    def of_motor(cls, motor: Motor, current: float, ambient: float | None = None) -> ThermalNetwork:
        """Create the thermal network of a motor at a constant current.

        Args:
            motor: Motor.
            current: Current [A].
            ambient: Temperature of the ambient air [degC]; by default the temperature in ``motor``.

        Raises:
            ModelError: If a required number is unknown, or the electrical resistance is not
                positive at the ambient temperature.
        """
        unknown = list_unknown_thermal_numbers(motor, ambient)
        if unknown:
            raise ModelError(motor.name, diagnose("motor-numbers-unknown", numbers=[*unknown]))
        names = ("winding",) if motor.housing_resistance is None else ("winding", "housing")
        air = motor.get("ambient_temperature") if ambient is None else ambient
        rise, reference = motor.get("resistance_rise"), motor.get("resistance_temperature")
        if 1 + rise * (air - reference) <= 0:
            problem = diagnose(
                "motor-resistance-negative", rise=rise, reference=reference, ambient=air
            )
            raise ModelError(motor.name, problem)
        return cls(
            resistances=np.array([motor.get(f"{name}_resistance") for name in names]),
            capacities=np.array([motor.get(f"{name}_capacity") for name in names]),
            ambient=air,
            current=current,
            ohms=motor.winding_ohms,
            rise=rise,
            reference=reference,
        )

    def compute_loss(self, temperature: float) -> float:
        """Return the copper loss i^2 R [W] at a temperature of the winding.

        Args:
            temperature: Temperature of the winding [degC].
        """
        ohms = self.ohms * (1 + self.rise * (temperature - self.reference))
        return self.current**2 * ohms

    def _compute_matrices(self) -> tuple[Array, Array]:
        """Return the matrices A (n, n) [1/s] and b (n,) [K/s] of the equations dx/dt = A x + b.

        x contains T - T_ambient [K] of the n nodes.
        """
        size = len(self.resistances)
        flows = np.zeros((size, size))  # heat flow into each node per temperature [W/K]
        for node, resistance in enumerate(self.resistances.tolist()):
            flows[node, node] -= 1 / resistance
            if node + 1 < size:
                flows[node, node + 1] += 1 / resistance
                flows[node + 1, node] += 1 / resistance
                flows[node + 1, node + 1] -= 1 / resistance
        flows[0, 0] += self.current**2 * self.ohms * self.rise
        heat = np.zeros(size)
        heat[0] = self.compute_loss(self.ambient)
        return flows / self.capacities[:, None], heat / self.capacities

    @property
    def steady_temperature(self) -> float:
        """Final temperature of the winding [degC]; infinite in a thermal runaway.

        In a runaway, the loss grows at least as fast with the temperature as the heat flow to the
        ambient air.
        """
        total = float(self.resistances.sum())
        slope = 1 / total - self.current**2 * self.ohms * self.rise
        if slope <= 0:
            return math.inf
        return self.ambient + self.compute_loss(self.ambient) / slope

    def compute_temperatures(self, times: ArrayLike) -> Array:
        """Return the temperatures of the n nodes over time, starting at the ambient temperature.

        Args:
            times: Times since the current was switched on, shape (m,) [s].

        Returns:
            Shape (m, n) [degC]; the winding is the first node.
        """
        matrix, rate = self._compute_matrices()
        # Symmetric in the scaled coordinates sqrt(C) x, so that the eigenvalues are real.
        scale = np.sqrt(self.capacities)
        values, vectors = np.linalg.eigh(matrix * scale[:, None] / scale)
        along = vectors.T @ (scale * rate)
        spans = np.asarray(times, dtype=float)[:, None]
        growth = np.where(
            values == 0, spans, np.expm1(values * spans) / np.where(values == 0, 1.0, values)
        )
        temperatures: Array = self.ambient + (growth * along) @ vectors.T / scale
        return temperatures

    def find_time(self, limit: float) -> float:
        """Return the time [s] until the winding reaches a temperature; infinite if it never does.

        The winding starts at the ambient temperature. The time is 0 for a limit up to the ambient
        temperature.

        Args:
            limit: Temperature [degC].
        """
        if limit <= self.ambient:
            return 0.0
        if self.steady_temperature <= limit or self.current == 0:
            return math.inf
        low, high = 0.0, float(self.capacities.sum() * self.resistances.sum())
        while self.compute_temperatures([high])[0, 0] < limit:
            low, high = high, 2 * high
        while high - low > _TIME_TOLERANCE * high:
            middle = (low + high) / 2
            if middle in (low, high):
                break
            if self.compute_temperatures([middle])[0, 0] < limit:
                low = middle
            else:
                high = middle
        return high


def list_unknown_thermal_numbers(motor: Motor, ambient: float | None = None) -> tuple[str, ...]:
    """Return the fields of `Motor` that the thermal network requires but that are unknown.

    The electrical resistance of the winding is not checked.

    Args:
        motor: Motor.
        ambient: Temperature of the ambient air [degC]. If None, the temperature in ``motor`` is
            needed.
    """
    unknown = motor.list_unknown(*THERMAL_NUMBERS)
    if ambient is None:
        unknown += motor.list_unknown("ambient_temperature")
    housing = motor.list_unknown("housing_resistance", "housing_capacity")
    return unknown + (housing if len(housing) == 1 else ())


@cache
def list_thermal_motors() -> tuple[str, ...]:
    """Return the names of the motors of this package with complete thermal data.

    The limit temperature may be unknown.
    """
    return tuple(
        name for name in list_motors() if not list_unknown_thermal_numbers(find_motor(name))
    )


def compute_continuous_torque(
    motor: Motor, ambient: float | None = None, limit: float | None = None
) -> float:
    """Return the largest torque at the output that a motor exerts permanently at rest [N m].

    With this torque, the winding finally reaches its limit temperature: i^2 R (1 + alpha (T_limit -
    T_0)) = (T_limit - T_a) / R_th. If thermal numbers are unknown, the result (without ``ambient``
    and ``limit``) is the continuous torque of the data sheet, which is valid only for the
    temperatures of the data sheet. The largest torque of the motor at rest, if known, bounds the
    result.

    Args:
        motor: Motor.
        ambient: Temperature of the ambient air [degC]; by default the temperature in ``motor``.
        limit: Largest temperature of the winding [degC]; by default the temperature in ``motor``.

    Raises:
        ModelError: If a required number is unknown, for example.
    """
    unknown = list_unknown_thermal_numbers(motor, ambient)
    if limit is None:
        unknown += motor.list_unknown("limit_temperature")
    if not unknown:
        highest = motor.get("limit_temperature") if limit is None else limit
        network = ThermalNetwork.of_motor(motor, 1.0, ambient)
        heat = (highest - network.ambient) / float(network.resistances.sum())
        current = math.sqrt(max(heat, 0.0) / network.compute_loss(highest))
        torque = current * motor.output_torque_per_ampere
    elif motor.continuous_torque is not None and ambient is None and limit is None:
        torque = motor.continuous_torque
    else:
        stated = motor.list_unknown("continuous_torque")
        raise ModelError(motor.name, diagnose("motor-numbers-unknown", numbers=[*unknown, *stated]))
    largest = motor.largest_torque
    return torque if largest is None else min(torque, largest[0])
