"""Does a payload really stay up: MuJoCo with the mass on the robot, nudged from all sides."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.results import Result
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.stability import LASTING, free_of_friction
from pupper_analysis.robot.tool import Place
from pupper_analysis.simulation import monitor
from pupper_analysis.simulation.rollout import begin_stand, check_stand, roll_out
from pupper_analysis.stance.soft_ground import solve_loaded_stand
from pupper_analysis.stance.stand import Stand
from pupper_analysis.stance.task import StandTask

Array = NDArray[np.float64]

NUDGE = 0.01
"""Speed with which the base begins, in each of the directions tried (m/s; at the height of the base
for a turn). An equilibrium that is not stable needs a reason to be left; one that is, even by a few
percent, survives this."""

_AROUND = 8
"""Nudges along the ground, evenly round about; the first points elsewhere in every trial."""

_BETWEEN = 1 / math.cos(math.pi / _AROUND)
"""Nudges along the ground are so many times ``NUDGE``: their octagon has the circle of that inside.
What is unstable is left once its mode is moved beyond a limit, so who survives two neighbours
survives what lies between them, whichever way the first one points."""

LEFT = 0.1
"""A joint that is further from where it began has left it (rad): robots that buckle go on to 0.3
and more."""

SLIPPED = 5e-3
"""A foot that is further from its place has slid (m); in 12 s creep and rolling give 1 mm."""

LIFTED = 2e-3
"""A foot that is off the ground and this much higher than it began has lifted (m); one that carries
little hops by less when it is nudged."""

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
class PayloadTrial(Result):
    """A simulation of a loaded stand.

    Attributes:
        mass: Of the payload (kg).
        turn: Of the first nudge along the ground, from x towards y (rad).
        held: Whether it stood to the end, whichever way it was nudged.
        failure: What happened first if it did not.
        where: The motors, joints, feet or bodies concerned.
        time: When (s).
        fell: How many of the nudges ended in a failure.
        nudges: How many there were.
        joint_error: The largest distance of a joint from the stand at the end (rad).
        duration: s.
        dry_friction: Whether joints and rolling feet had the dry friction of the model.
    """

    mass: float
    turn: float
    held: bool
    failure: Failure | None
    where: tuple[str, ...]
    time: float | None
    fell: int
    nudges: int
    joint_error: float
    duration: float
    dry_friction: bool


@check_arguments
def simulate_payload(
    robot: Robot,
    stance: StandTask | Stand,
    mass: float,
    point: Place = (0.0, 0.0, 0.0),
    *,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
    duration: float = LASTING,
    dry_friction: bool = False,
) -> PayloadTrial:
    """Simulates a stance with a mass on the robot.

    It begins in the stand that ``stand --payload`` judges (``solve_loaded_stand``), with
    feed-forward for the load, and the base moving at ``NUDGE``: up, down, turning one way or the
    other about z, or along the ground in one of eight directions, by as much more as covers all
    those between them. In which direction the eight begin depends on the mass, so that trials of
    several masses try more of them.

    By default the joints have no friction loss, and the feet no torsional and rolling friction:
    dry friction holds up what is not stable, for as long as nothing moves it, and so proves
    nothing. v3 stays up with 15 kg so, and falls at the first touch.

    Args:
        robot: The robot.
        stance: The stance; of a stand, its task.
        mass: Of the payload (kg).
        point: Where it is, as in ``with_payload``.
        kp: Servo stiffness (N m/rad); the model's own by default.
        kd: Servo damping (N m s/rad); the model's own by default.
        duration: Simulated time (s), at least 2.
        dry_friction: Keep the model's dry friction.

    Returns:
        What happened.

    Raises:
        ConfigurationError: If an argument is out of its range, or the robot cannot stand.
        ModelError: If the model has no position servos, and kp and kd are not both given.
        StanceUnreachableError: If the stance is out of reach with that load.
        StaticsInfeasibleError: If no contact forces balance it.
    """
    loaded, stand = solve_loaded_stand(robot, stance, mass, point)
    check_stand(loaded, stand, duration)
    held = begin_stand(loaded, stand, kp=kp, kd=kd)
    loaded, model, ctrl = held.robot, held.drive.model, held.ctrl
    if not dry_friction:
        free_of_friction(model)
    turn = float(np.random.default_rng(np.float64(mass).view(np.uint64)).uniform(0, 2 * np.pi))
    starts = np.tile(held.start, (_AROUND + 4, 1))
    columns = 1 + model.nq + loaded.mj_convention.qvel_index
    starts[:, columns] = nudge_velocities(loaded, stand, turn)
    steps = max(2, round(duration / float(model.opt.timestep)))
    workers = [mujoco.MjData(model) for _ in range(2)]
    states = roll_out(model, workers, starts, np.tile(ctrl, (1, steps, 1)))
    events = [_first_event(loaded, model, stand, rows, ctrl) for rows in states]
    failed = [event for event in events if event is not None]
    time, failure, where = min(failed, key=lambda event: event[0]) if failed else (None, None, ())
    joints = states[:, -1, 1 + loaded.mj_convention.qpos_index[7:]]
    return PayloadTrial(
        mass=float(mass),
        turn=turn,
        held=not failed,
        failure=failure,
        where=where,
        time=time,
        fell=len(failed),
        nudges=len(states),
        joint_error=float(np.abs(joints - stand.qpos[7:]).max()),
        duration=duration,
        dry_friction=dry_friction,
    )


def nudge_velocities(robot: Robot, stand: Stand, turn: float) -> Array:
    """Returns the velocities (12, nv) that nudge a base.

    Args:
        robot: The robot.
        stand: How it stands.
        turn: Of the first one along the ground, from x towards y (rad).
    """
    speeds = np.zeros((_AROUND + 4, robot.nv))
    angles = turn + 2 * np.pi * np.arange(_AROUND) / _AROUND
    speeds[:_AROUND, :2] = _BETWEEN * NUDGE * np.column_stack([np.cos(angles), np.sin(angles)])
    speeds[_AROUND : _AROUND + 2, 2] = NUDGE, -NUDGE
    # The base's frame may lie on the ground; the com does not.
    com = Configuration(robot, stand.qpos).center_of_mass()
    height = float(com[2] - np.mean(list(stand.contact_points.values()), axis=0)[2])
    speeds[_AROUND + 2 :, 5] = NUDGE / height, -NUDGE / height
    return speeds


def _first_event(
    robot: Robot, model: mujoco.MjModel, stand: Stand, states: Array, ctrl: Array
) -> tuple[float, Failure, tuple[str, ...]] | None:
    """Returns when, what and where something happened that shall not, if it did.

    A motor may saturate for a moment, in the swing of a nudge, if the robot then stands.
    """
    timestep = float(model.opt.timestep)
    if monitor.has_diverged(states, timestep):
        return 0.0, Failure.BUCKLING, ()
    watcher = monitor.Watcher(robot, model)
    data = watcher.data
    most, names = robot.effort_ranges * (1 - 1e-9), np.array(robot.joint_names)
    saturated: tuple[float, Failure, tuple[str, ...]] | None = None
    recovered = True
    lower, upper = robot.lower_limits, robot.upper_limits
    places: dict[str, Array] = {}
    carrying = set(robot.feet_with(stand.stance_feet))
    for state in states[:: max(1, round(_SAMPLE_TIME / timestep))]:
        seen = watcher.look(state, ctrl)
        angles = data.qpos[robot.mj_convention.qpos_index[7:]]
        torques = data.qfrc_actuator[robot.mj_convention.qvel_index[6:]]
        weak = names[(torques < most[:, 0]) | (torques > most[:, 1])].tolist()
        recovered = not weak
        if weak and saturated is None:
            saturated = seen.time, Failure.MOTOR, tuple(weak)
        feet = watcher.foot_centres()
        places = places or feet
        moved = {
            foot: np.linalg.norm((feet[foot] - places[foot])[:2]) for foot in stand.stance_feet
        }
        found = {
            Failure.GROUND: sorted(seen.bodies | (set(seen.forces) - carrying)),
            Failure.JOINT: names[(angles < lower) | (angles > upper)].tolist(),
            Failure.TIPPING: [
                foot
                for foot in stand.stance_feet
                if robot.foot_of(foot) not in seen.forces
                and (feet[foot] - places[foot])[2] > LIFTED
            ],
            Failure.SLIDING: [foot for foot, way in moved.items() if way > SLIPPED],
            Failure.BUCKLING: names[np.abs(angles - stand.qpos[7:]) > LEFT].tolist(),
        }
        for failure, where in found.items():
            if where:
                return saturated or (seen.time, failure, tuple(where))
    return None if recovered else saturated
