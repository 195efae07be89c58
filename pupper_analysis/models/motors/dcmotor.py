"""MuJoCo's ``dcmotor``: reading of a motor from an actuator, and writing of a motor as an element.

A ``dcmotor`` has one thermal node: dT/dt = (R(T) i^2 - (T - T_ambient) / R_th) / C, with R(T) = R
(1 + alpha (T - T_0)). Its activation is the rise of the temperature above the ambient air.
"""

from __future__ import annotations

import math

import mujoco

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ModelError
from pupper_analysis.models.motors.motor import Motor
from pupper_analysis.models.transmission import actuator_gear


def read_dcmotor(model: mujoco.MjModel, actuator: int, source: str = "MJCF") -> Motor:
    """Read the motor of a ``dcmotor`` actuator of a MuJoCo model.

    The gear has no losses. The supply voltage is the largest voltage that the control range
    contains with both signs, if the control is a voltage. The current limit is the largest torque
    that the force range contains with both signs, divided by the torque constant. Numbers that the
    actuator does not state are unknown (None), for example an armature of zero.

    Raises:
        ModelError: If the actuator is no ``dcmotor``, or `Motor` rejects its numbers.
    """
    name = model.actuator(actuator).name
    if model.actuator_dyntype[actuator] != mujoco.mjtDyn.mjDYN_DCMOTOR.value:
        raise ModelError(source, diagnose("motor-no-dcmotor", name=name))
    gain, dynamics = model.actuator_gainprm[actuator], model.actuator_dynprm[actuator]
    heats = dynamics[2] > 0 and dynamics[3] > 0
    limited = bool(model.actuator_forcelimited[actuator])
    force = _find_symmetric_limit(model.actuator_forcerange[actuator]) if limited else None
    has_voltage = model.actuator_ctrlspec[actuator] == mujoco.mjtCtrlInput.mjINPUT_VOLTAGE.value
    control = int(model.actuator_ctrladr[actuator])
    return Motor(
        name=name,
        source=source,
        torque_constant=float(gain[1]),
        resistance=float(gain[0]),
        gear_ratio=float(abs(actuator_gear(model, actuator)[0])) or None,
        gear_efficiency=1.0,
        resistance_rise=float(gain[2]) if heats else None,
        resistance_temperature=float(gain[3]) if heats else None,
        winding_resistance=float(dynamics[2]) if heats else None,
        winding_capacity=float(dynamics[3]) if heats else None,
        ambient_temperature=float(dynamics[4]) if heats else None,
        rotor_inertia=float(model.actuator_armature[actuator]) or None,
        supply_voltage=_find_symmetric_limit(model.actuator_ctrlrange[control])
        if has_voltage and model.actuator_ctrllimited[control]
        else None,
        current_limit=None if force is None else float(force / gain[1]),
    )


def _find_symmetric_limit(ends: Array) -> float | None:
    """Return the largest value that a range (low, high) contains with both signs; None if zero."""
    return max(0.0, min(-float(ends[0]), float(ends[1]))) or None


def list_dcmotors(model: mujoco.MjModel, source: str) -> dict[str, Motor]:
    """Read the motors of all ``dcmotor`` actuators with transmission ``joint`` of a MuJoCo model.

    Returns:
        {name of the joint: motor}; the last motor in the file if several have the same key.

    Raises:
        ModelError: If `Motor` rejects the numbers of an actuator.
    """
    found = {}
    for actuator in range(model.nactuator):
        is_motor = model.actuator_dyntype[actuator] == mujoco.mjtDyn.mjDYN_DCMOTOR.value
        at_joint = model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT.value
        if is_motor and at_joint:
            joint = model.joint(int(model.actuator_trnid[actuator, 0])).name
            found[joint] = read_dcmotor(model, actuator, source)
    return found


def make_dcmotor_element(motor: Motor, joint: str, name: str = "") -> str:
    """Return the text of MuJoCo's ``dcmotor`` element for a motor at a joint.

    The element has at most one thermal node. The thermal resistances and the heat capacities of
    winding and housing are added: the final temperature is equal, but the winding heats up more
    slowly. Losses of the gear, friction, peak torque, limit temperature and unknown numbers are not
    written.

    Raises:
        ModelError: If a required number is unknown, for example the torque constant or the gear
            ratio.
    """
    constant = motor.get("torque_constant")
    words = {
        "name": name or joint,
        "joint": joint,
        "motorconst": f"{constant:.9g}",
        "resistance": f"{motor.winding_ohms:.9g}",
        "gear": f"{motor.get('gear_ratio'):.9g}",
    }
    if motor.rotor_inertia is not None:
        words["armature"] = f"{motor.rotor_inertia:.9g}"
    if motor.supply_voltage is not None:
        words["ctrlrange"] = f"-{motor.supply_voltage:.9g} {motor.supply_voltage:.9g}"
    if motor.current_limit is not None:
        words["saturation"] = f"{constant * motor.current_limit:.9g} 0 0"
    resistance, capacity = motor.winding_resistance, motor.winding_capacity
    if resistance is not None and capacity is not None:
        numbers = [
            resistance + (motor.housing_resistance or 0.0),
            capacity + (motor.housing_capacity or 0.0),
            0.0,
            motor.get("resistance_rise"),
            motor.get("resistance_temperature"),
            motor.get("ambient_temperature"),
        ]
        if not all(map(math.isfinite, numbers)):
            raise ModelError(motor.name, diagnose("motor-numbers-unknown", numbers=["thermal"]))
        words["thermal"] = " ".join(f"{number:.9g}" for number in numbers)
    return "<dcmotor " + " ".join(f'{key}="{value}"' for key, value in words.items()) + "/>"
