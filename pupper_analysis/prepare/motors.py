"""One motor at each joint where an MJCF has several: a position and a velocity servo, say."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.models.mjcf import compile_spec
from pupper_analysis.models.transmission import actuator_gear, is_at_one_joint, law_of


def one_at_each_joint(spec: mujoco.MjSpec, source: Path) -> list[Diagnostic]:
    """Takes the motors at a joint together, in place.

    A stand has one command per joint, from which all of them would have to be determined: MuJoCo
    adds up what position and velocity servos do, and so are their gains added. Motors beside a
    servo, and all but one of several, are left out: they are not commanded.

    Args:
        spec: The MJCF's; it has no keyframes.
        source: Its file.

    Returns:
        What was done.
    """
    joint = mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT
    driven = [actuator.target for actuator in spec.actuators if actuator.trntype in joint]
    if len(driven) == len(set(driven)):
        return []
    model = compile_spec(spec.copy(), source)
    joints = joints_of_several_motors(model)
    if not joints:
        return []
    actuators = list(spec.actuators)
    gone = set[int]()
    for drives in joints.values():
        kept = _kept(model, drives)
        _take_gains(model, actuators[kept], kept, [drive for drive in drives if drive != kept])
        gone |= set(drives) - {kept}
    for index in sorted(gone, reverse=True):
        _delete(spec, actuators[index])
    names = [str(model.joint(joint).name) for joint in joints]
    return [diagnose("motors-taken-together", joints=names)]


def joints_of_several_motors(model: mujoco.MjModel) -> dict[int, list[int]]:
    """Returns {hinge or slide: its motors} of those that have several."""
    found: dict[int, list[int]] = {}
    for motor in range(model.nactuator):
        if is_at_one_joint(model, motor):
            found.setdefault(int(model.actuator_trnid[motor, 0]), []).append(motor)
    return {joint: motors for joint, motors in found.items() if len(motors) > 1}


def _kept(model: mujoco.MjModel, drives: list[int]) -> int:
    """Returns the motor that stays: a position servo, else a plain motor, else the first."""

    def rank(motor: int) -> int:
        law = law_of(model, motor)
        if law.at_joint[0] > 0:
            return 0
        plain = model.actuator_gaintype[motor] == mujoco.mjtGain.mjGAIN_FIXED.value
        return 1 if plain and not law.at_joint[1] else 2

    return min(drives, key=rank)


def _take_gains(
    model: mujoco.MjModel, servo: mujoco.MjsActuator, kept: int, others: list[int]
) -> None:
    """Adds other servos' gains, and their limits, to a servo."""
    law = law_of(model, kept)
    gear = law.gear
    if not (law.at_joint[0] > 0 and gear):
        return
    given = [law_of(model, motor).at_joint for motor in others]
    more = sum(each[0] for each in given) / gear**2
    bias = np.array(servo.biasprm)
    bias[1] -= more
    bias[2] -= sum(each[1] for each in given) / gear**2
    servo.biasprm = bias
    if more:
        gain = np.array(servo.gainprm)
        gain[0] += more
        servo.gainprm = gain
    acting = [m for m, each in zip(others, given, strict=True) if each[0] or each[1]]
    if not acting:
        return
    if model.actuator_forcelimited[[kept, *acting]].all():
        gears = [abs(float(actuator_gear(model, motor)[0]) / gear) for motor in acting]
        limits = np.array(servo.forcerange)
        for motor, ratio in zip(acting, gears, strict=True):
            most = float(np.abs(model.actuator_forcerange[motor]).max()) * ratio
            limits += (-most, most)
        servo.forcerange = limits
    else:
        servo.forcelimited = mujoco.mjtLimited.mjLIMITED_FALSE


def _delete(spec: mujoco.MjSpec, actuator: mujoco.MjsActuator) -> None:
    for sensor in list(spec.sensors):
        if sensor.objtype == mujoco.mjtObj.mjOBJ_ACTUATOR and sensor.objname == actuator.name:
            spec.delete(sensor)
    spec.delete(actuator)
