"""Simulate a stand with the base nudged in twelve directions, and report the first failure."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import StrEnum

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arrays import project_perpendicular
from pupper_analysis.base.results import Result
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.joints import free_joints
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.stability import HOLD_DURATION
from pupper_analysis.simulation import monitor
from pupper_analysis.simulation.causes import MAX_CREEP_SPEED, creep_speeds
from pupper_analysis.simulation.rollout import StandStart, check_stand, make_stand_start, roll_out
from pupper_analysis.stance.stand import Stand
from pupper_analysis.statics.equilibrium import GravityCompensation

Array = NDArray[np.float64]

BASE_NUDGE_SPEED = 0.01
"""Initial speed of the base in each direction [m/s]; for a rotation, at the height of the CoM. An
unstable equilibrium is left only after a perturbation; a stand that is stable by a few percent
survives this speed. Chosen, not tuned."""

_HORIZONTAL_NUDGES = 8
"""Number of horizontal nudges, at equal angles; the first is along world x. Chosen, not tuned."""

_HORIZONTAL_FACTOR = 1 / math.cos(math.pi / _HORIZONTAL_NUDGES)
"""Factor of the horizontal speeds, so that the octagon of nudges contains the circle with radius
``BASE_NUDGE_SPEED``. An unstable stand is left once the mode exceeds a limit, so a stand that
survives two neighbouring nudges survives the nudges between."""

MAX_JOINT_DEVIATION = 0.1
"""Largest deviation of a joint from the stand [rad, m] before the stand has buckled. Robots that
buckle go on to 0.3 rad and more."""

MAX_FOOT_SLIP = 5e-3
"""Largest displacement of a foot along the ground, beyond the creep, before the foot has slid [m].
Rolling gives 1 mm. Deep in soft ground, where MuJoCo's friction is viscous, feet creep as far in
12 s with a tenth of the friction used."""

MAX_FOOT_LIFT = 2e-3
"""Largest rise of a foot without ground contact before the foot has lifted [m]. A foot with little
load rises by less after a nudge."""

_MIN_MARGIN_RATIO, _MAX_UTILISATION, _MIN_LIMIT_DISTANCE = 5.0, 0.9, 0.02
"""Bounds of ``is_near_limit``: CoM margin relative to the CoM displacement by a nudge; utilisation
of motors and friction; distance of a joint from the limits [rad, m]. Measured: of 80 random robots
with 50 to 97 % of their payloads, those that a nudge upset had a CoM margin below 3
displacements."""

_MIN_LOAD_RATIO = 0.02
"""Smallest load of a foot, relative to the mean load, of a foot that a nudge does not lift. Minimum
tangential forces may leave two of four feet on unequal slopes with 1/10,000 of the weight."""

_LIMIT_ATOL = 1e-6
"""Largest distance between a joint and a limit on which the joint rests [rad, m]: the rounding of
poses."""

_SAMPLE_TIME = 0.05
"""Time between the states that are evaluated [s]. Chosen, not tuned."""


class Failure(StrEnum):
    """First cause of failure of a nudged stand, or of a stand whose payload grows."""

    MOTOR = "a motor saturates"
    SLIDING = "a foot slides"
    TIPPING = "the robot tips"
    BUCKLING = "loses static stability: servo stiffness too low"
    SHAKING = "shakes on its servos"
    JOINT = "a joint comes to its limit"
    GROUND = "another part comes to the ground"
    COMMAND = "a servo cannot be commanded so far"
    REACH = "the loaded stance is out of reach"
    SIMULATED = "does not hold in the simulation"
    UNLOADED = "does not hold without payload either"
    NOTHING = "nothing that was looked at"


@dataclass(frozen=True, eq=False)
class NudgeTrial(Result):
    """Simulations of a stand that is nudged in twelve directions.

    Attributes:
        held: Whether the stand survived all nudges.
        failure: Earliest failure; None if there was none.
        where: Motors, joints, feet or bodies of the failure.
        time: Simulated time of the failure (s); None without a failure.
        fell: Number of nudges that ended in a failure.
        nudges: Number of nudges.
        duration: Simulated time of each nudge (s).
    """

    held: bool
    failure: Failure | None
    where: tuple[str, ...]
    time: float | None = field(metadata={"unit": "s"})
    fell: int
    nudges: int
    duration: float = field(metadata={"unit": "s"})


def simulate_nudges(
    robot: Robot,
    stand: Stand,
    *,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
    duration: float = HOLD_DURATION,
) -> NudgeTrial:
    """Simulate a stand whose base starts with a velocity, in each of twelve directions.

    The velocity is ``BASE_NUDGE_SPEED`` up or down, or as a rotation about z in both senses, or
    along the ground in each of eight directions, with a larger speed that covers the directions
    between.

    The model is simulated unmodified, with the dry friction of joints and contacts. A stand that
    only dry friction holds is detected by the spectrum and a larger nudge
    (``growth.confirm_growth``).

    A foot that is predicted to carry less than ``monitor.LIGHT_FOOT_LOAD`` of the weight may lift
    if the foot is back on the ground at the end.

    Args:
        robot: The robot, with the payload.
        stand: The stand, solved for the simulated ground.
        kp: Servo stiffness [N m/rad]; the model's own by default.
        kd: Servo damping [N m s/rad]; the model's own by default.
        duration: Simulated time [s], 2 to 600.

    Raises:
        ConfigurationError: If an argument is out of range, or the robot cannot stand.
        ModelError: If a joint has no motor, if a joint has no position servo and kp and kd are not
            both given, or if the ground cannot be added (``build_on_ground``).
        StaticsInfeasibleError: If no contact forces balance the stand.
    """
    robot = check_stand(robot, stand, duration)
    held = make_stand_start(robot, stand, kp=kp, kd=kd)
    robot, model, ctrl = held.robot, held.drive.model, held.ctrl
    starts = np.tile(held.start, (_HORIZONTAL_NUDGES + 4, 1))
    columns = 1 + model.nq + robot.mj_convention.qvel_index
    starts[:, columns] = make_nudge_velocities(robot, stand)
    steps = max(2, round(duration / float(model.opt.timestep)))
    workers = [mujoco.MjData(model) for _ in range(2)]
    states = roll_out(model, workers, starts, np.tile(ctrl, (1, steps, 1)))
    creeps = creep_speeds(robot, stand, held.prediction)
    outcomes = [_find_first_failure(held, stand, rows, creeps) for rows in states]
    failures = [outcome for outcome in outcomes if outcome is not None]
    time, failure, where = (
        min(failures, key=lambda event: event[0]) if failures else (None, None, ())
    )
    return NudgeTrial(
        held=not failures,
        failure=failure,
        where=where,
        time=time,
        fell=len(failures),
        nudges=len(states),
        duration=duration,
    )


def is_near_limit(robot: Robot, stand: Stand, statics: GravityCompensation) -> bool:
    """Return True if a nudge may move a stable stand to where the linearisation does not hold.

    A nudge with speed v moves a CoM at height h by about v sqrt(h/g), and torques and forces by
    about one percent. A stand is far from the limits if the CoM is far from the edge of the support
    polygon, motors and friction have reserves, joints are far from the limits, and each foot
    carries load. False if the statics have no CoM margin, or if the base is fixed or welded.

    Args:
        robot: The robot, with the payload.
        stand: The stand, solved for the simulated ground.
        statics: Statics of the stand.
    """
    if statics.com_margin is None or robot.bolted:  # a base that no nudge moves
        return False
    com_displacement = BASE_NUDGE_SPEED * math.sqrt(
        com_height_above_contacts(robot, stand) / float(np.linalg.norm(robot.gravity))
    )
    (lower, upper), angles = _free_joint_limits(robot, stand), stand.qpos[7:]
    limit_distances = np.minimum(angles - lower, upper - angles)
    loads = [
        float(load.force @ stand.normals[robot.feet[foot][0]])
        for foot, load in statics.foot_loads.items()
    ]
    return bool(
        statics.com_margin < _MIN_MARGIN_RATIO * com_displacement
        or (not robot.welds and min(loads) < _MIN_LOAD_RATIO * sum(loads) / len(loads))
        or bool((statics.motor_utilisation > _MAX_UTILISATION).any())
        or max(statics.friction_utilisation.values(), default=0.0) > _MAX_UTILISATION
        or min(limit_distances, default=math.inf) < _MIN_LIMIT_DISTANCE
    )


def _free_joint_limits(robot: Robot, stand: Stand) -> tuple[Array, Array]:
    """Return lower and upper joint limits, (nu,) each; infinite for a closed gripper's joints.

    The result is the joints that carry no foot and rest on a limit in the stand.
    """
    angles, free = stand.qpos[7:], np.isin(robot.joint_names, free_joints(robot))
    at_lower = free & (angles < robot.lower_limits + _LIMIT_ATOL)
    at_upper = free & (angles > robot.upper_limits - _LIMIT_ATOL)
    return np.where(at_lower, -np.inf, robot.lower_limits), np.where(
        at_upper, np.inf, robot.upper_limits
    )


def com_height_above_contacts(robot: Robot, stand: Stand) -> float:
    """Return the CoM height above the mean contact point [m]; the stand height if welded."""
    if robot.welds:
        return robot.stand_height
    com = Configuration(robot, stand.qpos).center_of_mass()
    return float(com[2] - np.mean(list(stand.contact_points.values()), axis=0)[2])


def make_nudge_velocities(robot: Robot, stand: Stand) -> Array:
    """Make the base velocities of the twelve nudges, shape (12, nv) [m/s, rad/s].

    Args:
        robot: The robot.
        stand: The stand.
    """
    speeds = np.zeros((_HORIZONTAL_NUDGES + 4, robot.nv))
    angles = 2 * np.pi * np.arange(_HORIZONTAL_NUDGES) / _HORIZONTAL_NUDGES
    speeds[:_HORIZONTAL_NUDGES, :2] = (
        _HORIZONTAL_FACTOR * BASE_NUDGE_SPEED * np.column_stack([np.cos(angles), np.sin(angles)])
    )
    speeds[_HORIZONTAL_NUDGES : _HORIZONTAL_NUDGES + 2, 2] = BASE_NUDGE_SPEED, -BASE_NUDGE_SPEED
    # The base frame may be at ground height; the CoM is above.
    height = com_height_above_contacts(robot, stand)
    speeds[_HORIZONTAL_NUDGES + 2 :, 5] = BASE_NUDGE_SPEED / height, -BASE_NUDGE_SPEED / height
    return speeds


def _find_first_failure(
    held: StandStart, stand: Stand, states: Array, creeps: dict[str, float]
) -> tuple[float, Failure, tuple[str, ...]] | None:
    """Return time [s], kind and elements of the first failure in a rollout; None without a failure.

    A motor may saturate for a moment after the nudge if the robot is not saturated at the end.
    """
    robot, model, ctrl = held.robot, held.drive.model, held.ctrl
    timestep = float(model.opt.timestep)
    if monitor.has_diverged(states, timestep):
        return 0.0, Failure.BUCKLING, ()
    sampler = monitor.ContactSampler(robot, model)
    data = sampler.data
    effort_bounds, names = robot.effort_ranges * (1 - 1e-9), np.array(robot.joint_names)
    saturated: tuple[float, Failure, tuple[str, ...]] | None = None
    recovered = True
    lower, upper = _free_joint_limits(robot, stand)
    initial_positions: dict[str, Array] = {}
    normals = stand.lift_directions(robot)
    carrying = set(robot.feet_with(stand.stance_feet))
    forces = {
        foot: float(held.prediction.contact_forces[foot] @ normals[foot])
        for foot in stand.stance_feet
    }
    min_force = monitor.LIGHT_FOOT_LOAD * sum(forces.values())
    light = {foot for foot, force in forces.items() if force < min_force}
    lifted: tuple[float, Failure, tuple[str, ...]] | None = None
    for state in states[:: max(1, round(_SAMPLE_TIME / timestep))]:
        sample = sampler.sample(state, ctrl)
        angles = data.qpos[robot.mj_convention.qpos_index[7:]]
        torques = data.qfrc_actuator[robot.mj_convention.qvel_index[6:]]
        saturated_joints = names[
            (torques < effort_bounds[:, 0]) | (torques > effort_bounds[:, 1])
        ].tolist()
        recovered = not saturated_joints
        if saturated_joints and saturated is None:
            saturated = sample.time, Failure.MOTOR, tuple(saturated_joints)
        positions = monitor.foot_centres(robot, sampler.data)
        initial_positions = initial_positions or positions
        slips = {
            foot: np.linalg.norm(
                project_perpendicular(positions[foot] - initial_positions[foot], normals[foot])
            )
            - min(creeps[foot], MAX_CREEP_SPEED) * sample.time
            for foot in stand.stance_feet
        }
        raised = [
            foot
            for foot in (() if robot.welds else stand.stance_feet)
            if robot.foot_of(foot) not in sample.forces
            and (positions[foot] - initial_positions[foot]) @ normals[foot] > MAX_FOOT_LIFT
        ]
        # A light foot may lift for a moment; it must be back at the end.
        lifted = (sample.time, Failure.TIPPING, tuple(raised)) if raised else None
        failures = {
            Failure.GROUND: sorted(sample.bodies | (set(sample.forces) - carrying)),
            Failure.JOINT: names[(angles < lower) | (angles > upper)].tolist(),
            Failure.TIPPING: [foot for foot in raised if foot not in light],
            Failure.SLIDING: [foot for foot, slip in slips.items() if slip > MAX_FOOT_SLIP],
            Failure.BUCKLING: names[np.abs(angles - stand.qpos[7:]) > MAX_JOINT_DEVIATION].tolist(),
        }
        for failure, where in failures.items():
            if where:
                return saturated or (sample.time, failure, tuple(where))
    return lifted if recovered else saturated
