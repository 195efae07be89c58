"""A robot in MuJoCo's viewer, or as text: sensor readings, and the result of a drop.

The robot starts in the start pose (``Robot.home``), with the servos commanded to the joint
positions of this pose. A drop is simulated from above the ground, and messages state what in the
robot's file contradicts a stable drop.
"""

from __future__ import annotations

import contextlib
import copy
import math
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic
from pupper_analysis.base.errors import ModelError, PupperAnalysisError
from pupper_analysis.cli.next_step import print_next_step
from pupper_analysis.models.transmission import MadeServo
from pupper_analysis.prepare.judge import describe_frictionless_feet
from pupper_analysis.prepare.limits import (
    describe_zero_torque_limits,
    loads_motor_without_torque,
    springs_replace_motors,
)
from pupper_analysis.prepare.own_run import find_posture_keyframe
from pupper_analysis.prepare.self_check import (
    compare_nominal_stand,
    explain_own_run,
    list_ball_joints,
)
from pupper_analysis.present import display
from pupper_analysis.present.document import NextStep
from pupper_analysis.present.documents.servos import exceeds_explicit_damping
from pupper_analysis.present.verdict import (
    make_keyframe_run_clauses,
    make_published_clauses,
    make_replaced_clauses,
)
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.fall import was_reset_by_mujoco
from pupper_analysis.robot.masses import describe_missing_masses
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import (
    find_servos_used,
    make_position_commands,
    model_with_servos,
)
from pupper_analysis.simulation.monitor import ContactSampler, StandCheck, StandReference
from pupper_analysis.simulation.rollout import full_state, settled_activations
from pupper_analysis.simulation.servo_bounds import bound_explicit_damping
from pupper_analysis.simulation.verify import STABLE_DEVIATION
from pupper_analysis.stance.soft_ground import solve_stand_as_simulated
from pupper_analysis.stance.stand import solve_stand, stand_statics

DROP_SECONDS = 6.0
"""Duration of a simulated drop [s]. Chosen, not tuned."""

DROP_HEIGHT = 0.15
"""Height [m] of the lowest foot above the ground at which a drop starts, if the lowest foot in the
start pose is below half of this height. Chosen, not tuned."""


@dataclass(frozen=True, eq=False)
class Drop:
    """Simulated drop with the servos at the home pose.

    Attributes:
        time: Times, shape (n,) [s].
        height: Height of the base, shape (n,) [m].
        height_deviation: Standard deviation of the height in the last second [m].
        end: Comparison of the final state with the home pose on the ground.
        keyframe: Name of the keyframe of the file whose joint positions the servos hold; "" if
            loading has found another start pose (``Robot.home``).
        largest_kd_factor: Largest factor on the damping with which an explicit PD controller is
            stable in the default stand (`ServoBounds`); None without a bound, and if not stable.
        stable: True if ``height_deviation`` is below ``STABLE_DEVIATION``, the robot stands, and
            the simulation has not diverged.
    """

    time: Array
    height: Array
    height_deviation: float
    end: StandCheck
    keyframe: str
    largest_kd_factor: float | None
    stable: bool


def simulate_drop(robot: Robot) -> Drop:
    """Simulate a drop with the servos at the joint positions of the start pose (``Robot.home``).

    The simulation lasts `DROP_SECONDS`, and starts in the state of `make_home_data`.
    """
    data = make_home_data(robot)
    model = robot.mj_model
    with contextlib.suppress(ModelError):  # torque motors have no servo, and keep their ranges
        model = model_with_servos(robot).model
    servos_at_home = data.ctrl.copy()
    timestep = float(model.opt.timestep)
    base_height = int(robot.mj_convention.qpos_index[2])
    height = np.full(round(DROP_SECONDS / timestep) + 1, data.qpos[base_height])
    for step in range(1, len(height)):
        data.ctrl[:] = servos_at_home
        mujoco.mj_step(model, data)
        height[step] = data.qpos[base_height]
    deviation = float(height[-round(1 / timestep) :].std())
    time = timestep * np.arange(len(height), dtype=np.float64)
    end = _check_landing(robot, data)
    stable = deviation < STABLE_DEVIATION and end.stands and not was_reset_by_mujoco(data)
    keyframe = find_posture_keyframe(robot, robot.home[robot.nq - robot.nu :])
    name = "" if keyframe is None else keyframe.name
    factor = None
    if stable:
        with contextlib.suppress(PupperAnalysisError):  # for example, without a default stand
            factor = bound_explicit_damping(robot, solve_stand_as_simulated(robot))
    return Drop(time, height, deviation, end, name, factor, stable)


def _check_landing(robot: Robot, data: mujoco.MjData) -> StandCheck:
    """Compare the final state of a simulated drop with the home pose on the ground.

    The home pose is shifted vertically, so that the lowest foot touches the ground.
    """
    qpos = robot.home.copy()
    if robot.floating and robot.contact_points:
        qpos[2] -= _foot_clearance(robot, qpos)
    state = full_state(robot.mj_model, data)
    touching = ContactSampler(robot, robot.mj_model).find_ground_bodies(state)
    return StandReference.from_configuration(robot, qpos).check_stand(state, touching)


def _foot_clearance(robot: Robot, qpos: Array) -> float:
    """Return the height [m] of the lowest foot above the plane z = 0 in a configuration (nq,)."""
    feet = Configuration(robot, qpos).foot_positions()
    return min(float(place[2]) - robot.contact_radius[foot] for foot, place in feet.items())


def make_home_data(robot: Robot) -> mujoco.MjData:
    """Return MuJoCo's data with joints and servo commands at the home pose.

    A free base with feet close to the ground is raised (`DROP_HEIGHT`).
    """
    data = mujoco.MjData(robot.mj_model)
    qpos = robot.home.copy()
    if robot.floating and robot.contact_points:
        clearance = _foot_clearance(robot, qpos)
        qpos[2] += DROP_HEIGHT - clearance if clearance < DROP_HEIGHT / 2 else 0.0
    robot.mj_convention.set_state(data, qpos)
    data.ctrl[:] = make_position_commands(robot, qpos[robot.nq - robot.nu :])
    data.act[:] = settled_activations(robot.mj_model, data.ctrl)
    mujoco.mj_forward(robot.mj_model, data)
    return data


def view_robot(robot: Robot, *, headless: bool) -> None:
    """Show a robot in the start pose (``Robot.home``) until the window is closed.

    The sliders "Control" of the viewer command the servos. A robot with a fixed base is shown
    without gravity. If ``headless``, mass, start pose and sensor readings are printed instead.

    Raises:
        DisplayError: If no window can be opened.
    """
    if not headless:
        display.check_display()
    data, model = make_home_data(robot), robot.mj_model
    if headless:
        print(
            f"READY {robot.name}: MuJoCo model with nq={model.nq}, nv={model.nv}, nu={model.nu}, "
            f"{float(mujoco.mj_getTotalmass(model)):.3f} kg"
        )
        print(f"  {_describe_home(robot, data)}; {_format_sensor_count(model.nsensor)}")
        print_next_step(NextStep("stand" if robot.floating else "hold"))
        if model.nsensor:
            print()
        for sensor in map(model.sensor, range(model.nsensor)):
            reading = " ".join(
                f"{round(value, 3) + 0.0:+.3f}" for value in data.sensor(sensor.id).data
            )
            print(f'data.sensor("{sensor.name}").data  {reading}')
        return
    print(f"{robot.name}: nq={model.nq}, nv={model.nv}, nu={model.nu}", flush=True)
    if not robot.floating:
        model = copy.copy(model)  # the robot's own is not changed
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_GRAVITY
    display.show_window(model, data)


def _describe_home(robot: Robot, data: mujoco.MjData) -> str:
    """Return the text about the start pose, with heights of base and lowest foot [mm] if known."""
    if not robot.floating:
        return "base fixed in the home pose, servos commanded to its joint positions"
    qpos, _ = robot.mj_convention.read_state(data)
    text = f"home pose: base height {1e3 * float(qpos[2]):.1f} mm"
    if not robot.contact_points:
        return f"{text}, no feet"
    return f"{text}, lowest foot {1e3 * _foot_clearance(robot, qpos):.1f} mm above the ground"


def _format_sensor_count(count: int) -> str:
    """Return the text "N sensors, read below", or that the file has no sensors if N is 0."""
    if not count:
        return "the file has no sensors"
    return f"{count} sensor{'' if count == 1 else 's'}, read below"


def drop_and_report(robot: Robot, *, headless: bool) -> bool:
    """Drop a robot in simulation, and print whether the robot stands at the end.

    If not ``headless``, a window opens first; actions in the window do not change the result.

    Returns:
        True if the robot stands stably, the files state the masses of all links, and
        `list_contradictions` is empty.

    Raises:
        ConfigurationError: If the base is fixed.
        DisplayError: If no window can be opened.
    """
    robot.check_floating("drop-of-fixed-base")
    if not headless:
        display.show_window(robot.mj_model, make_home_data(robot))
    result = simulate_drop(robot)
    masses, contradictions = describe_missing_masses(robot), list_contradictions(robot)
    fails = not result.stable or bool(contradictions)
    word = "FAILS" if fails else "STABLE" if masses is None else "UNKNOWN"
    rest, contacts = format_drop(result)
    ideal = word == "STABLE" and exceeds_explicit_damping(result)
    print(f"{word}{' (ideal servos)' if ideal else ''} {robot.name}: {rest}")
    for message in (*contradictions, *(() if masses is None else (masses,)), contacts):
        print(f"  {message}")
    print_next_step(NextStep("gains" if ideal else "stand"))
    return word == "STABLE"


def list_contradictions(robot: Robot) -> tuple[str, ...]:
    """Return reasons why the user's own MJCF may fall although the prepared robot lands stably.

    The drop is simulated with the prepared robot, in which, for example, bad servos are replaced.
    """
    replaced: tuple[MadeServo, ...] = ()
    with contextlib.suppress(ModelError):  # torque motors have no servo
        replaced = find_servos_used(robot).replacement_servos
    own = explain_own_run(robot)
    balls = list_ball_joints(robot)
    published = compare_nominal_stand(robot) if balls else None
    if published is not None:
        published = replace(published, causes=balls) if published.differs else None
    clauses = (
        *make_keyframe_run_clauses(own if own is not None and own.fails else None),
        *make_published_clauses(published),
        *make_replaced_clauses(replaced),
    )
    slippery = describe_frictionless_feet(robot, robot.contact_points) if robot.floating else None
    messages = [str(clause) for clause in clauses if not clause.good]
    others = (_describe_loaded_zero_motors(robot), slippery)
    return (*messages, *(str(message) for message in others if message is not None))


def _describe_loaded_zero_motors(robot: Robot) -> Diagnostic | None:
    """Create the message about motors without torque that may bear a load in the nominal stand.

    Damping and friction may hold the joints of such motors for longer than a drop is simulated.
    None without such a motor.
    """
    message = describe_zero_torque_limits(robot)
    if message is None:
        return None
    with contextlib.suppress(PupperAnalysisError):
        statics = stand_statics(robot, solve_stand(robot, explain=False))
        if not loads_motor_without_torque(robot, statics) or springs_replace_motors(robot, statics):
            return None
    return message


def format_drop(result: Drop) -> tuple[str, str]:
    """Return two texts about a dropped robot.

    The first contains the base height and its deviation. The second contains tilt, contacts, and
    the pose that the servos hold; the command `stand` solves another pose.
    """
    still = result.height_deviation < STABLE_DEVIATION
    end = result.end
    ending = "" if still else ": NOT stable"
    rest = (
        f"base height {1e3 * result.height[-1]:.0f} mm, standard deviation in the last second "
        f"{1e3 * result.height_deviation:.2f} mm (limit {1e3 * STABLE_DEVIATION:g} mm){ending}"
    )
    words = [f"tilt {math.degrees(end.tilt):.1f} deg"]
    if result.stable:
        words.append("only the feet touch the ground")
    elif end.touching:
        words.append(f"touching the ground: {', '.join(end.touching)}")
    if not result.stable and end.collapses:
        height, expected = 1e3 * end.height, 1e3 * end.expected_height
        words.append(f"CoM {height:.0f} mm high instead of {expected:.0f} mm")
    landing = ", ".join(words) + ("" if result.stable or not still else ": NOT stable")
    pose = f"keyframe {result.keyframe}" if result.keyframe else "the start pose"
    return rest, f"{landing}; servos hold {pose}, not the solved stand"
