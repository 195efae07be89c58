"""Does a stand stay up, whichever way its base is nudged?"""

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
from pupper_analysis.simulation.causes import CREEPING, creep_speeds
from pupper_analysis.simulation.rollout import Standing, begin_stand, check_stand, roll_out
from pupper_analysis.stance.stand import Stand
from pupper_analysis.statics.equilibrium import GravityCompensation

Array = NDArray[np.float64]

NUDGE = 0.01
"""Speed with which the base begins, in each of the directions tried (m/s; at the height of the base
for a turn). An equilibrium that is not stable needs a reason to be left; one that is, even by a few
percent, survives this."""

_AROUND = 8
"""Nudges along the ground, evenly round about; the first ahead."""

_BETWEEN = 1 / math.cos(math.pi / _AROUND)
"""Nudges along the ground are so many times ``NUDGE``: their octagon has the circle of that inside.
What is unstable is left once its mode is moved beyond a limit, so who survives two neighbours
survives what lies between them."""

LEFT = 0.1
"""A joint that is further from where it began has left it (rad): robots that buckle go on to 0.3
and more."""

SLIPPED = 5e-3
"""A foot that is further from its place than it creeps has slid (m); rolling gives 1 mm. Deep in
soft ground, where MuJoCo's friction is viscous, feet creep as far in 12 s with a tenth of it used.
"""

LIFTED = 2e-3
"""A foot that is off the ground and this much higher than it began has lifted (m); one that carries
little hops by less when it is nudged."""

_FALLS, _NEARLY, _NEAR = 5.0, 0.9, 0.02
"""What is near a limit: so many of the ways that a nudge moves the com, such a part of a torque or
a friction, so much of a joint (rad, m). Of 80 random robots with 50 to 97 % of their payloads,
those that a nudge upset had a com within 3 of its ways."""

_LIGHT = 0.02
"""A foot that bears less of its share of the weight may lift when a nudge comes: least tangential
forces may leave two of four feet on unlike slopes with a ten thousandth of the weight."""

_AT_LIMIT = 1e-6
"""How near (rad, m) a joint is to a limit that it rests against: what a pose is rounded to."""

_SAMPLE_TIME = 0.05  # s between the states that are looked at closely


class Failure(StrEnum):
    """What gives way first when a payload grows."""

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
    """Simulations of a stand that is nudged from all sides.

    Attributes:
        held: Whether it stood to the end, whichever way it was nudged.
        failure: What happened first if it did not.
        where: The motors, joints, feet or bodies concerned.
        time: When (s).
        fell: How many of the nudges ended in a failure.
        nudges: How many there were.
        duration: s.
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
    """Simulates a stand that begins with its base moving, in each of twelve directions.

    It moves at ``NUDGE``: up, down, turning one way or the other about z, or along the ground in
    one of eight directions, by as much more as covers all those between them.

    The model is simulated as it is, with the dry friction of joints and contacts. A stand that only
    dry friction holds is found by the spectrum and a larger nudge (``growth.confirm_growth``).

    A foot that is predicted to carry less than ``LIGHT_FOOT`` of the weight may lift, if it is back
    on the ground at the end.

    Args:
        robot: The robot, with what it carries.
        stand: How it stands on the ground that is simulated.
        kp: Servo stiffness (N m/rad); the model's own by default.
        kd: Servo damping (N m s/rad); the model's own by default.
        duration: Simulated time (s), at least 2.

    Raises:
        ConfigurationError: If an argument is out of its range, or the robot cannot stand.
        ModelError: If the model has no position servos, and kp and kd are not both given.
        StaticsInfeasibleError: If no contact forces balance it.
    """
    robot = check_stand(robot, stand, duration)
    held = begin_stand(robot, stand, kp=kp, kd=kd)
    robot, model, ctrl = held.robot, held.drive.model, held.ctrl
    starts = np.tile(held.start, (_AROUND + 4, 1))
    columns = 1 + model.nq + robot.mj_convention.qvel_index
    starts[:, columns] = nudge_velocities(robot, stand)
    steps = max(2, round(duration / float(model.opt.timestep)))
    workers = [mujoco.MjData(model) for _ in range(2)]
    states = roll_out(model, workers, starts, np.tile(ctrl, (1, steps, 1)))
    creeps = creep_speeds(robot, stand, held.prediction)
    events = [_first_event(held, stand, rows, creeps) for rows in states]
    failed = [event for event in events if event is not None]
    time, failure, where = min(failed, key=lambda event: event[0]) if failed else (None, None, ())
    return NudgeTrial(
        held=not failed,
        failure=failure,
        where=where,
        time=time,
        fell=len(failed),
        nudges=len(states),
        duration=duration,
    )


def may_be_upset(robot: Robot, stand: Stand, statics: GravityCompensation) -> bool:
    """Tells whether a nudge may take a stand that is stable to where it is not.

    A nudge of v moves a com at height h by some v sqrt(h/g), and torques and forces by a percent
    or so: what is further from the edge of its support, its motors' limits, its friction cones, its
    joints' limits and lifting a foot stays where its linearisation is true, and that is known to be
    stable.

    Args:
        robot: The robot, with what it carries.
        stand: How it stands on the ground that is simulated.
        statics: What its motors hold there.
    """
    if statics.com_margin is None or robot.bolted:  # a base that no nudge moves
        return False
    fall = NUDGE * math.sqrt(height_of_com(robot, stand) / float(np.linalg.norm(robot.gravity)))
    (lower, upper), angles = _limits(robot, stand), stand.qpos[7:]
    room = np.minimum(angles - lower, upper - angles)
    loads = [
        float(load.force @ stand.normals[robot.feet[foot][0]])
        for foot, load in statics.foot_loads.items()
    ]
    return bool(
        statics.com_margin < _FALLS * fall
        or (not robot.welds and min(loads) < _LIGHT * sum(loads) / len(loads))
        or bool((statics.motor_utilisation > _NEARLY).any())
        or max(statics.friction_utilisation.values(), default=0.0) > _NEARLY
        or min(room, default=math.inf) < _NEAR
    )


def _limits(robot: Robot, stand: Stand) -> tuple[Array, Array]:
    """Returns the joint limits (nu,), none of a gripper that is shut: it stays so.

    That is of joints that carry no foot and are at a limit in the stand.
    """
    angles, free = stand.qpos[7:], np.isin(robot.joint_names, free_joints(robot))
    low = free & (angles < robot.lower_limits + _AT_LIMIT)
    high = free & (angles > robot.upper_limits - _AT_LIMIT)
    return np.where(low, -np.inf, robot.lower_limits), np.where(high, np.inf, robot.upper_limits)


def height_of_com(robot: Robot, stand: Stand) -> float:
    """Returns the height of the com above the contacts (m); of what is welded a scale of it."""
    if robot.welds:
        return robot.stand_height
    com = Configuration(robot, stand.qpos).center_of_mass()
    return float(com[2] - np.mean(list(stand.contact_points.values()), axis=0)[2])


def nudge_velocities(robot: Robot, stand: Stand) -> Array:
    """Returns the velocities (12, nv) that nudge a base.

    Args:
        robot: The robot.
        stand: How it stands.
    """
    speeds = np.zeros((_AROUND + 4, robot.nv))
    angles = 2 * np.pi * np.arange(_AROUND) / _AROUND
    speeds[:_AROUND, :2] = _BETWEEN * NUDGE * np.column_stack([np.cos(angles), np.sin(angles)])
    speeds[_AROUND : _AROUND + 2, 2] = NUDGE, -NUDGE
    # The base's frame may lie on the ground; the com does not.
    height = height_of_com(robot, stand)
    speeds[_AROUND + 2 :, 5] = NUDGE / height, -NUDGE / height
    return speeds


def _first_event(
    held: Standing, stand: Stand, states: Array, creeps: dict[str, float]
) -> tuple[float, Failure, tuple[str, ...]] | None:
    """Returns when, what and where something happened that shall not, if it did.

    A motor may saturate for a moment, in the swing of a nudge, if the robot then stands.
    """
    robot, model, ctrl = held.robot, held.drive.model, held.ctrl
    timestep = float(model.opt.timestep)
    if monitor.has_diverged(states, timestep):
        return 0.0, Failure.BUCKLING, ()
    watcher = monitor.Watcher(robot, model)
    data = watcher.data
    most, names = robot.effort_ranges * (1 - 1e-9), np.array(robot.joint_names)
    saturated: tuple[float, Failure, tuple[str, ...]] | None = None
    recovered = True
    lower, upper = _limits(robot, stand)
    places: dict[str, Array] = {}
    out = stand.lift_directions(robot)
    carrying = set(robot.feet_with(stand.stance_feet))
    forces = {
        foot: float(held.prediction.contact_forces[foot] @ out[foot]) for foot in stand.stance_feet
    }
    least = monitor.LIGHT_FOOT * sum(forces.values())
    light = {foot for foot, force in forces.items() if force < least}
    lifted: tuple[float, Failure, tuple[str, ...]] | None = None
    for state in states[:: max(1, round(_SAMPLE_TIME / timestep))]:
        seen = watcher.look(state, ctrl)
        angles = data.qpos[robot.mj_convention.qpos_index[7:]]
        torques = data.qfrc_actuator[robot.mj_convention.qvel_index[6:]]
        weak = names[(torques < most[:, 0]) | (torques > most[:, 1])].tolist()
        recovered = not weak
        if weak and saturated is None:
            saturated = seen.time, Failure.MOTOR, tuple(weak)
        feet = monitor.foot_centres(robot, watcher.data)
        places = places or feet
        moved = {
            foot: np.linalg.norm(project_perpendicular(feet[foot] - places[foot], out[foot]))
            - min(creeps[foot], CREEPING) * seen.time
            for foot in stand.stance_feet
        }
        raised = [
            foot
            for foot in (() if robot.welds else stand.stance_feet)
            if robot.foot_of(foot) not in seen.forces
            and (feet[foot] - places[foot]) @ out[foot] > LIFTED
        ]
        # A light foot may lift for a moment; it must be back at the end.
        lifted = (seen.time, Failure.TIPPING, tuple(raised)) if raised else None
        found = {
            Failure.GROUND: sorted(seen.bodies | (set(seen.forces) - carrying)),
            Failure.JOINT: names[(angles < lower) | (angles > upper)].tolist(),
            Failure.TIPPING: [foot for foot in raised if foot not in light],
            Failure.SLIDING: [foot for foot, way in moved.items() if way > SLIPPED],
            Failure.BUCKLING: names[np.abs(angles - stand.qpos[7:]) > LEFT].tolist(),
        }
        for failure, where in found.items():
            if where:
                return saturated or (seen.time, failure, tuple(where))
    return lifted if recovered else saturated
