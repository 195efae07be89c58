"""Evaluate a posture of a robot with a fixed base: torques, sag, verdict, and tool limits.

`hold_posture` computes the motor torques in the posture, predicts the static deflection of the
position servos without feed-forward, and verifies both in MuJoCo. It also computes the forces on
the tool that the motors withstand. `tool_payload` computes the largest payload at the tool, in the
posture and over all postures of a search. `reach_load` computes the motor utilisation over the
reach.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import linalg

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic
from pupper_analysis.base.errors import ConfigurationError, NoEquilibriumError
from pupper_analysis.base.progress import report_progress
from pupper_analysis.base.results import Result, Tabular
from pupper_analysis.base.units import EFFORT_UNIT, POSITION_UNIT
from pupper_analysis.models.efforts import EffortCode, EffortStatement
from pupper_analysis.models.mjcf import has_free_joint
from pupper_analysis.models.urdf_tree import UrdfTree
from pupper_analysis.prepare.convert.from_urdf import has_limbs
from pupper_analysis.prepare.judge import describe_violated_keyframe, judge_simulation
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.joints import list_position_units
from pupper_analysis.robot.robot import Robot, get_loaded_robot
from pupper_analysis.robot.servos import command_ranges, compute_command_lead, resolve_servo_gains
from pupper_analysis.robot.tool import Tool, find_tool, with_payload
from pupper_analysis.simulation.alone import find_mass_by_commands_alone
from pupper_analysis.simulation.mass_bound import find_holding_mass
from pupper_analysis.simulation.verdict import Ending, Verdict
from pupper_analysis.simulation.verify import StandVerification, verify_stand
from pupper_analysis.stance.posture import (
    Posture,
    find_posture,
    held_stand,
)
from pupper_analysis.stance.sag.steady_state import SteadyState, steady_state
from pupper_analysis.stance.soft_ground import solve_stand_as_simulated
from pupper_analysis.stance.stand import Stand
from pupper_analysis.statics.equilibrium import (
    MIN_TORQUE_PER_MASS,
    UNLIMITED_MASS_RATIO,
    GravityCompensation,
    compute_reference_mass,
    compute_utilisation,
    find_mass_limit,
    gravity_compensation,
    peak_utilisation,
)
from pupper_analysis.tools.hold.force import ToolForce, tool_force
from pupper_analysis.tools.hold.motions import JointMotions, group_coupled_joints
from pupper_analysis.tools.hold.worst import WorstPostures, worst_postures

_NUM_REACH_POSTURES = 600
"""Number of random postures of `reach_load`. Chosen, not tuned: enough for a plot over distance."""


@dataclass(frozen=True, eq=False)
class ReachLoad(Tabular):
    """Motor utilisation and tool position in random postures.

    Attributes:
        distances: (n,) horizontal distances of the tool from the first joint of the kinematic chain
            (m); from the world's z axis if no joint moves the tool.
        heights: (n,) heights of the tool in the world (m).
        utilisation: (n,) largest motor utilisation; infinite if a motor with a limit of zero must
            exert a torque, NaN if no motor has a stated limit.
    """

    _units_of_columns: ClassVar[dict[str, str]] = {"distance": "m", "height": "m"}

    distances: Array = field(metadata={"unit": "m"})
    heights: Array = field(metadata={"unit": "m"})
    utilisation: Array = field(metadata={"unit": "1"})

    def _columns(self) -> dict[str, ArrayLike]:
        """Return {column: values} of a table with a row per random posture.

        The columns are distance and height of the tool [m], and utilisation [1], (n,) each.
        """
        return {
            "distance": self.distances,
            "height": self.heights,
            "utilisation": self.utilisation,
        }


@check_arguments
def reach_load(robot: Robot, posture: Posture, tool: Tool) -> ReachLoad:
    """Compute reach of the tool and largest motor utilisation in each of 600 random postures.

    The reach is the horizontal distance of the tool from the first joint of its chain, and the
    height in the world frame [m]. The utilisation is static torque / limit [1].

    Args:
        robot: Robot with a fixed base.
        posture: Posture of the robot, with closed loops; the random postures keep the assembly mode
            of the loops in this posture.
        tool: Tool.

    Raises:
        ConfigurationError: If a closed loop is singular in ``posture`` or in a random posture.
    """
    samples = []
    for qpos in JointMotions(robot, posture).draw_postures(_NUM_REACH_POSTURES):
        config = Configuration(robot, qpos)
        position = tool.position(config)
        centre = config.joint_position(tool.chain[0]) if tool.chain else np.zeros(3)
        peak = peak_utilisation(
            compute_utilisation(robot, config.transfer_to_motors(config.static_load()))
        )
        samples.append((float(np.hypot(*(position - centre)[:2])), float(position[2]), peak))
    distances, heights, utilisation = np.array(samples).T
    return ReachLoad(distances, heights, utilisation)


_MAX_PAYLOAD_ROUNDS = 6
"""Maximum number of iterations of the payload limit over all postures. Each iteration searches the
worst postures with a smaller payload. The number bounds the computing time. Chosen, not tuned.
"""

_PAYLOAD_RTOL = 1e-4
"""Relative change of the payload limit below which the iteration over worst postures ends. Chosen,
not tuned."""

_MIN_SOFTENING = 1e-6
"""Smallest softening [1] with which the servo stiffness limits the payload. The softening is the
largest fraction of a motion's stiffness that a payload of `compute_reference_mass` removes (a
generalised eigenvalue). A smaller softening is a rounding error. Chosen, not tuned.
"""


@dataclass(frozen=True, eq=False)
class ToolPayload(Result):
    """Largest point masses at a tool that motors and servos hold.

    A motor may bear the mass if the joint moves the tool, or is coupled to such a joint.

    Attributes:
        mass: Largest mass that the motors hold in the posture (kg). 0 if the static load alone
            exceeds a limit, or if a motor that may bear the mass has a limit of zero. Otherwise,
            NaN if a motor that bears the mass has an unknown limit. Infinite, for example, if no
            motor bears the mass.
        joint: Joint of the motor that limits the mass in the posture; "" if this mass is infinite
            or NaN.
        servos: Largest mass that the servos hold in the posture if effort limits are ignored (kg).
            With a larger mass, gravity exceeds the servo stiffness, or a command exceeds its
            ``ctrlrange``. Infinite if no mass is too large.
        servo: Joint whose command limits the mass that the servos hold. "" if the stiffness limits
            this mass, or if nothing limits it.
        worst_posture_mass: Smallest limit of all postures in a search (kg): with a larger mass, a
            posture was found that the motors do not hold. 0 if a motor that may bear the mass has a
            limit of zero; otherwise, NaN if such a motor has an unknown limit. Infinite if no
            posture has a limit.
        worst_posture_joint: Joint of the motor that limits the mass in all postures; "" if this
            mass is infinite or NaN.
        posture: (nu,) posture with the smallest limit (rad or m); the given posture if ``code`` is
            not ``stated``.
        code: ``zero`` if a motor that may bear the mass has a limit of zero; else ``unknown`` if
            such a motor has an unknown limit; else ``stated``.
        unknown: Joints that may bear the mass, and whose effort limit is unknown.
    """

    mass: float = field(metadata={"unit": "kg"})
    joint: str
    servos: float = field(metadata={"unit": "kg"})
    servo: str
    worst_posture_mass: float = field(metadata={"unit": "kg"})
    worst_posture_joint: str
    posture: Array = field(metadata={"unit": "rad or m"})
    code: EffortCode
    unknown: tuple[str, ...]


@check_arguments
def tool_payload(
    robot: Robot,
    posture: Posture,
    tool: Tool,
    worst: WorstPostures,
    *,
    kp: ArrayLike | None = None,
) -> ToolPayload:
    """Compute the largest point masses [kg] at a tool that motors and servos hold.

    In a single posture, torques are linear in the mass, so the limit has a closed form. The limit
    over all postures is found by iteration (`_find_payload_of_all_postures`).

    Args:
        robot: Robot with a fixed base.
        posture: Posture of the robot.
        tool: Point with the mass.
        worst: Worst postures without the mass.
        kp: Servo stiffness [N m/rad, N/m], scalar or shape (nu,); default: values of the model.

    Raises:
        ConfigurationError: If kp is invalid, or a closed loop is singular in a posture.
        ModelError: If a joint has no motor; or, without ``kp``, no position servo.
    """
    mass, joint = posture_payload(robot, posture.qpos, tool)
    servos, servo = servo_payload(robot, posture, tool, kp)
    may_bear = _find_bearing_motors(robot, posture, tool)
    names = np.array(robot.joint_names)
    unknown = tuple(names[may_bear & np.isinf(robot.effort_limits)].tolist())
    null = names[may_bear & [limit.without_torque for limit in robot.efforts]].tolist()
    known: dict[str, Any] = {
        "servos": servos,
        "servo": servo,
        "posture": posture.qpos,
        "unknown": unknown,
    }
    if null:
        code, first = EffortCode.ZERO, null[0]
        return ToolPayload(
            mass=0.0,
            joint=first,
            worst_posture_mass=0.0,
            worst_posture_joint=first,
            code=code,
            **known,
        )
    if unknown:
        code = EffortCode.UNKNOWN
        return ToolPayload(
            mass=mass,
            joint=joint,
            worst_posture_mass=math.nan,
            worst_posture_joint="",
            code=code,
            **known,
        )
    worst_mass, worst_joint, qpos = _find_payload_of_all_postures(
        robot, posture, tool, worst, may_bear
    )
    return ToolPayload(
        mass=mass,
        joint=joint,
        servos=servos,
        servo=servo,
        worst_posture_mass=worst_mass,
        worst_posture_joint=worst_joint,
        posture=qpos,
        code=EffortCode.STATED,
        unknown=(),
    )


def posture_payload(robot: Robot, qpos: Array, tool: Tool) -> tuple[float, str]:
    """Compute the largest mass that the motors hold at a tool, at rest in a single posture.

    Args:
        robot: Robot with a fixed base.
        qpos: Posture, shape (nu,) [rad, m].
        tool: Attachment point of the mass.

    Returns:
        Mass [kg], which may be 0, infinite or NaN (unknown); the joint that limits the mass, or "".

    Raises:
        ConfigurationError: If a closed loop is singular in the posture.
    """
    config, limits = Configuration(robot, qpos), robot.effort_limits
    empty = config.transfer_to_motors(config.static_load())
    rates = config.transfer_to_motors(tool.load_per_mass(config))
    if (np.abs(empty) > limits).any():
        return 0.0, robot.joint_names[int(np.argmax(np.abs(empty) - limits))]
    mass = find_mass_limit(empty, rates, limits)
    if (np.abs(rates)[np.isinf(limits)] > MIN_TORQUE_PER_MASS).any():
        return math.nan, ""
    if not mass <= UNLIMITED_MASS_RATIO * compute_reference_mass(robot):  # the lever is rounding
        return math.inf, ""
    margins = np.where(np.isfinite(limits), limits - np.abs(empty + mass * rates), math.inf)
    return mass, robot.joint_names[int(np.argmin(margins))]


def servo_payload(
    robot: Robot, posture: Posture, tool: Tool, kp: ArrayLike | None = None
) -> tuple[float, str]:
    """Compute the largest mass at a tool that position servos hold in a posture.

    The stiffness of the robot with a mass m is W^T (K + G_0 + m G_1) W. K is the servo stiffness.
    G_0 and m G_1 are the derivatives of the static loads of robot and mass. W is a basis of the
    joint velocities that loops and couplings permit. The limit is the smallest m at which this
    matrix is singular, or at which a command with feed-forward, q + tau(m) / kp, reaches the end of
    its range. The limit is 0 if the servos do not hold the robot without payload. Effort limits are
    ignored.

    Args:
        robot: Robot with a fixed base.
        posture: Posture of the robot.
        tool: Point with the mass.
        kp: Servo stiffness [N m/rad, N/m], scalar or shape (nu,); default: values of the model.

    Returns:
        (mass, joint). The mass [kg] is infinite without a limit. ``joint`` is the joint whose
        command reaches the end of its range first; "" if no command limits the mass.

    Raises:
        ConfigurationError: If kp is invalid, or a closed loop is singular in the posture.
        ModelError: If a joint has no motor; or, without ``kp``, no position servo.
    """
    config, closure = Configuration(robot, posture.qpos), robot.closure
    basis = np.eye(robot.nu) if closure is None else closure.null_space(posture.qpos)
    gains = resolve_servo_gains(robot, kp, None if kp is None else 0.0).kp
    empty, wrench_per_mass = (
        config.static_load_derivative({}),
        np.append(robot.gravity, np.zeros(3)),
    )
    loaded = config.loaded_points_derivative(
        tool.twist_jacobian(config)[None], wrench_per_mass[None]
    )
    stiffness = basis.T @ (empty + np.diag(gains)) @ basis
    added = basis.T @ (loaded - empty) @ basis
    stiffness, added = (stiffness + stiffness.T) / 2, (added + added.T) / 2
    softening = 0.0  # if loops and couplings permit no motion
    if len(stiffness):
        if linalg.eigvalsh(stiffness)[0] <= 0:
            return 0.0, ""
        # Largest softening per mass [1/kg]; rounding if the mass stiffens all motions.
        softening = float(linalg.eigh(-added, stiffness, eigvals_only=True)[-1])
    stable = (
        1 / softening if softening > _MIN_SOFTENING / compute_reference_mass(robot) else math.inf
    )
    lead = compute_command_lead(config.transfer_to_motors(config.static_load()), gains)
    borne = config.transfer_to_motors(tool.load_per_mass(config))
    rates = compute_command_lead(np.where(np.abs(borne) > MIN_TORQUE_PER_MASS, borne, 0.0), gains)
    low, high = command_ranges(robot).T - posture.qpos
    with np.errstate(divide="ignore", invalid="ignore"):
        masses = (np.where(rates > 0, high, low) - lead) / rates
    masses = np.where(np.isfinite(masses), np.maximum(masses, 0.0), math.inf)
    first = int(np.argmin(masses))
    if masses[first] < stable:
        return float(masses[first]), robot.joint_names[first]
    return stable, ""


def _find_payload_of_all_postures(
    robot: Robot, posture: Posture, tool: Tool, worst: WorstPostures, may_bear: NDArray[np.bool_]
) -> tuple[float, str, Array]:
    """Find the largest mass at a tool that the motors hold in all postures of the searches.

    Each iteration searches the worst postures with the present limit as payload, and reduces the
    limit. It ends if the limit decreases by less than `_PAYLOAD_RTOL`, or after
    `_MAX_PAYLOAD_ROUNDS`.

    Args:
        robot: Robot with a fixed base.
        posture: Posture of the robot.
        tool: Point with the mass.
        worst: Worst postures without the mass.
        may_bear: Mask (nu,) of the motors that may bear the mass.

    Returns:
        Mass [kg], infinite without a limit; joint with the limit, or ""; posture (nu,) [rad, m].
    """
    smallest, weakest, qpos = _find_smallest_payload(robot, tool, [posture.qpos, *worst.postures])
    smallest = min(smallest, UNLIMITED_MASS_RATIO * compute_reference_mass(robot))
    loaded = worst
    for _ in range(_MAX_PAYLOAD_ROUNDS if smallest > 0 else 0):
        loaded = worst_postures(
            robot, posture, tool, payload=smallest, near=loaded, bearing=may_bear
        )
        lower, lower_joint, lower_qpos = _find_smallest_payload(robot, tool, list(loaded.postures))
        before = smallest
        if lower < smallest:
            smallest, weakest, qpos = lower, lower_joint, lower_qpos
        if lower > (1 - _PAYLOAD_RTOL) * before:
            break
    return smallest if weakest else math.inf, weakest, qpos


def _find_smallest_payload(
    robot: Robot, tool: Tool, postures: list[Array]
) -> tuple[float, str, Array]:
    """Return the smallest limit of the motors over postures: mass [kg], joint, posture (nu,)."""
    limits = [(*posture_payload(robot, qpos, tool), qpos) for qpos in postures]
    return min(limits, key=lambda limit: limit[0])


def _find_bearing_motors(robot: Robot, posture: Posture, tool: Tool) -> NDArray[np.bool_]:
    """Return a mask (nu,) of the motors that may bear a mass at a tool.

    These are motors of the tool's chain, and those coupled to the chain by loops or joint
    couplings, without dependent joints.
    """
    may_bear = np.isin(robot.joint_names, tool.chain)
    closure = robot.closure
    for joints in [] if closure is None else group_coupled_joints(closure, posture.qpos):
        may_bear[joints] |= may_bear[joints].any()
    if closure is not None:
        may_bear[closure.dependent_joints] = False
    return may_bear


COMMANDS_ALONE_RTOL = 0.02
"""Relative tolerance [1] of ``Hold.mass_by_commands_alone``. Chosen, not tuned."""


@dataclass(frozen=True, eq=False)
class Hold(Tabular):
    """Posture of a robot with a fixed base: statics, simulation, verdict, and tool limits.

    Attributes:
        name: Name of the robot.
        hangs: True if the base is free in the MJCF, or by default for the URDF, but fixed in this
            posture.
        posture: Commanded posture.
        units: (nu,) units of the joint positions: rad, or m for a slide, whose motor force is in N
            in place of N m.
        tool: Point that carries payloads and external forces.
        tool_position: (3,) position of the tool in the posture, in the world (m).
        limits: (nu,) effort limits, from the files or requested (N m, or N for a slide); infinite
            without a limit.
        limit_origins: (nu,) origin of each limit: statement in a file, or request; None without a
            limit.
        statics: Motor torques in the posture.
        verification: Simulation with feed-forward.
        sagging: Simulation without feed-forward.
        settled: Predicted equilibrium of the servos without feed-forward; None if there is no
            equilibrium.
        unsettled: Reason why ``settled`` is None; None if there is an equilibrium.
        tool_sag: (3,) displacement of the tool from the posture to ``settled``, in world axes (m);
            None without ``settled``.
        simulated_tool_sag: (3,) displacement of the tool in the simulation without feed-forward, in
            world axes (m); NaN if the simulation diverged.
        verdict: Verdict on the posture, with the assumptions of the verdict.
        worst: Worst posture of each motor, with ``carried``.
        carried: Payload at the tool that all results include (kg).
        payload: Largest masses at the tool in addition to ``carried``.
        payload_trial: Simulation, with feed-forward, of the posture with ``carried`` and the
            smaller of ``payload.mass`` and ``payload.servos``. If it fails: the simulation of the
            smallest simulated mass that fails. None if the posture fails without further mass, or
            this mass is 0, infinite or NaN.
        simulated_mass: Largest mass at the tool, in addition to ``carried``, with which the posture
            holds in simulation with feed-forward [kg]: the smaller of ``payload.mass`` and
            ``payload.servos`` if it holds, otherwise bisected to 1 %. NaN if ``payload_trial`` is
            None.
        force: External forces on the tool that the motors withstand.
        reach: Motor utilisation over the reach of the tool.
        weak_motors: Motors named by the caller that cannot exert the torques of ``statics``, not
            even for a short time.
        mass_by_commands_alone: Largest mass at the tool, in addition to ``carried``, with which the
            posture holds in simulation with position commands alone, without feed-forward torques
            [kg]. NaN if not requested, or if the posture holds with ``largest_mass`` without
            feed-forward, for example.
    """

    _key_fields: ClassVar[tuple[str, ...]] = ("verdict", "weak_motors")
    _units_of_columns: ClassVar[dict[str, str]] = {
        "position": POSITION_UNIT,
        "torque": EFFORT_UNIT,
        "utilisation": "1",
    }

    name: str
    hangs: bool
    posture: Posture
    units: tuple[str, ...]
    tool: Tool
    tool_position: Array = field(metadata={"unit": "m"})
    limits: Array = field(metadata={"unit": EFFORT_UNIT})
    limit_origins: tuple[EffortStatement | None, ...]
    statics: GravityCompensation
    verification: StandVerification
    sagging: StandVerification
    settled: SteadyState | None
    unsettled: Diagnostic | None
    tool_sag: Array | None = field(metadata={"unit": "m"})
    simulated_tool_sag: Array = field(metadata={"unit": "m"})
    verdict: Verdict
    worst: WorstPostures
    carried: float = field(metadata={"unit": "kg"})
    payload: ToolPayload
    payload_trial: StandVerification | None
    simulated_mass: float = field(metadata={"unit": "kg"})
    force: ToolForce
    reach: ReachLoad
    weak_motors: tuple[Diagnostic, ...] = ()
    mass_by_commands_alone: float = field(default=math.nan, metadata={"unit": "kg"})

    @property
    def passed(self) -> bool:
        """Whether the verdict of the simulation of the posture passes."""
        return self.verdict.passed

    @property
    def largest_mass(self) -> float:
        """Largest further mass at the tool that the motors hold in all postures found [kg].

        At most the mass that this posture holds in simulation. NaN if unknown.
        """
        worst, simulated = self.payload.worst_posture_mass, self.simulated_mass
        return simulated if simulated < worst else worst

    @property
    def largest_mass_here(self) -> float:
        """Largest further mass at the tool in this posture [kg]: ``simulated_mass`` if known.

        Otherwise ``payload.mass``, which considers the motors but not the servos. NaN if unknown.
        """
        simulated = self.simulated_mass
        return self.payload.mass if math.isnan(simulated) else simulated

    def _columns(self) -> dict[str, ArrayLike]:
        """Return {column: values} of a table with a row per joint.

        The columns are name, position [rad, m], torque [N m, N] and utilisation [1], (nu,) each.
        """
        return {
            "joint": self.statics.joint_names,
            "position": self.posture.qpos,
            "torque": self.statics.joint_torques,
            "utilisation": self.statics.motor_utilisation,
        }


_NUM_SIMULATIONS = 2
"""Number of simulations in `hold_posture`, with and without feed-forward, for reports of progress.
The simulation of the payload limit is not counted."""


@check_arguments
def hold_posture(
    robot: Robot,
    joints: Mapping[str, float] | None = None,
    *,
    keyframe: str | None = None,
    tool: str | None = None,
    payload: float = 0.0,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
    commands_alone: bool = False,
) -> Hold:
    """Evaluate and simulate a posture of a robot with a fixed base.

    The result contains motor torques, static deflection of the servos, payload and force limits at
    the tool, and the verdict of the simulations with and without feed-forward.

    Args:
        robot: Robot with a fixed base: an arm, a hand, or a robot that is loaded with
            ``fixed_base=True``.
        joints: {joint, or a pattern such as ``*elbow*``: position [rad, m]}; see `find_posture`.
        keyframe: Keyframe of the MJCF for other joints; see `find_posture` for the default.
        tool: Link of the URDF, or site, body or geom of the MJCF; see `find_tool` for the default.
        payload: Point mass at the tool [kg] that all results include.
        kp: Servo stiffness [N m/rad, N/m], scalar or shape (nu,); default: values of the model.
        kd: Servo damping [N m s/rad, N s/m], scalar or shape (nu,); default: values of the model.
        commands_alone: Whether to compute also ``mass_by_commands_alone``. Requires further
            simulations.

    Raises:
        ConfigurationError: If the base is free, an argument is not valid for the robot, or a closed
            loop is open or singular.
        UnknownNameError: If the robot has no such joint, keyframe or tool.
        ModelError: If a joint has no motor, or no position servo while kp and kd are not both
            given, or if the mass or inertia of a body is invalid.
    """
    posture, point = find_posture(robot, joints, keyframe=keyframe), find_tool(robot, tool)
    robot = with_payload(robot, payload, point)
    config, stand = Configuration(robot, posture.qpos), held_stand(robot, posture)
    statics = gravity_compensation(config, contacts=[])
    held = solve_stand_as_simulated(robot, stand)
    settled, unsettled = _find_equilibrium(robot, held, kp)
    sag = None
    if settled is not None:
        sag = point.position(Configuration(robot, settled.qpos)) - point.position(config)
    report_progress("simulations", 0, _NUM_SIMULATIONS)
    fed = verify_stand(robot, held, kp=kp, kd=kd)
    report_progress("simulations", 1, _NUM_SIMULATIONS)
    alone = verify_stand(robot, held, feedforward=False, kp=kp, kd=kd, settled=settled)
    end_qpos, simulated = alone.joint_positions, np.full(3, np.nan)
    if np.isfinite(end_qpos).all():
        simulated = point.position(Configuration(robot, end_qpos)) - point.position(config)
    worst = worst_postures(robot, posture, point)
    limits = tool_payload(robot, posture, point, worst, kp=kp)
    max_mass, trial, simulated_mass = min(limits.mass, limits.servos), None, math.nan
    if fed.passed and 0 < max_mass < math.inf:
        simulated_mass, trial = _simulate_payload(robot, posture, point, max_mass, kp, kd)
    judged = fed
    if (violated := _describe_violated_keyframe(robot, posture)) is not None:
        judged = replace(fed, passed=False, failures=(violated, *fed.failures))
    verdict = judge_simulation(robot, stand, judged, alone, statics=statics, kp=kp, kd=kd)
    hangs = _is_base_free(robot)
    verdict = replace(verdict, servos=replace(verdict.servos, hangs=hangs))
    mass_alone = math.nan
    if commands_alone and verdict.passed and verdict.commands_alone is Ending.HOLDS:
        worst_mass = limits.worst_posture_mass
        largest = simulated_mass if simulated_mass < worst_mass else worst_mass
        mass_alone = _find_mass_by_commands_alone(robot, posture, point, largest, kp, kd)
    return Hold(
        name=robot.name,
        hangs=hangs,
        posture=posture,
        units=list_position_units(robot),
        tool=point,
        tool_position=point.position(config),
        limits=robot.effort_limits,
        limit_origins=tuple(limit.origin for limit in robot.efforts),
        statics=statics,
        verification=fed,
        sagging=alone,
        settled=settled,
        unsettled=unsettled,
        tool_sag=sag,
        simulated_tool_sag=simulated,
        verdict=verdict,
        worst=worst,
        payload=limits,
        carried=float(payload),
        payload_trial=trial,
        simulated_mass=simulated_mass,
        force=tool_force(robot, posture, point),
        reach=reach_load(robot, posture, point),
        mass_by_commands_alone=mass_alone,
    )


def _simulate_payload(
    robot: Robot,
    posture: Posture,
    tool: Tool,
    limit: float,
    kp: ArrayLike | None,
    kd: ArrayLike | None,
) -> tuple[float, StandVerification]:
    """Find the largest further mass [kg], at most ``limit``, that a posture holds in simulation.

    Returns:
        Mass [kg]; simulation of ``limit`` if it holds, otherwise of the smallest simulated mass
        that fails.
    """

    def simulate(mass: float) -> StandVerification:
        """Simulate the posture, with feed-forward, with a further mass [kg]."""
        loaded = with_payload(robot, mass, tool)
        stand = solve_stand_as_simulated(loaded, held_stand(loaded, posture))
        return verify_stand(loaded, stand, kp=kp, kd=kd, until_failure=True)

    def find_failing_run(mass: float) -> StandVerification | None:
        """Return the simulation with a mass [kg] if it fails, otherwise None."""
        run = simulate(mass)
        return None if run.passed else run

    run = simulate(limit)
    return (limit, run) if run.passed else find_holding_mass(find_failing_run, limit, run)


def _describe_violated_keyframe(robot: Robot, posture: Posture) -> Diagnostic | None:
    """Create the message that constraints move joints of a keyframe that were not requested.

    None for a posture without a keyframe or without requested joints: in the second case,
    `judge_simulation` creates the message.
    """
    if robot.closure is None or not (posture.keyframe and posture.requested_joints):
        return None
    loaded = get_loaded_robot(robot)
    # The loops of the keyframe may close within the joint ranges only with the requested joints.
    with contextlib.suppress(ConfigurationError):
        joints = find_posture(loaded, keyframe=posture.keyframe).qpos
        return describe_violated_keyframe(loaded, joints, posture.requested_joints)
    return None


def _is_base_free(robot: Robot) -> bool:
    """Return True if the base is free in the MJCF; without MJCF, by default (`has_limbs`)."""
    description = robot.description
    if description.converted == "mjcf":
        return has_limbs(UrdfTree.of(description.urdf), is_floating=False)
    return has_free_joint(description.mjcf)


def _find_equilibrium(
    robot: Robot, held: Stand, kp: ArrayLike | None
) -> tuple[SteadyState | None, Diagnostic | None]:
    """Find the equilibrium without feed-forward; None and the reason if there is none."""
    try:
        return steady_state(robot, held, kp=kp), None
    except NoEquilibriumError as error:
        return None, error.diagnostic


def _find_mass_by_commands_alone(
    robot: Robot,
    posture: Posture,
    tool: Tool,
    motor_limit: float,
    kp: ArrayLike | None,
    kd: ArrayLike | None,
) -> float:
    """Find the largest mass [kg] at a tool with which a posture holds without feed-forward.

    NaN if the posture holds with ``motor_limit`` [kg], or if this limit is 0, infinite or NaN.
    """

    def simulate(mass: float) -> StandVerification:
        """Simulate the posture with a mass [kg] at the tool, without feed-forward."""
        loaded = with_payload(robot, mass, tool)
        held = solve_stand_as_simulated(loaded, held_stand(loaded, posture))
        settled, _ = _find_equilibrium(loaded, held, kp)
        return verify_stand(
            loaded, held, feedforward=False, kp=kp, kd=kd, settled=settled, until_failure=True
        )

    if not 0 < motor_limit < math.inf or simulate(motor_limit).passed:
        return math.nan
    tolerance = COMMANDS_ALONE_RTOL**2 * motor_limit
    return find_mass_by_commands_alone(simulate, motor_limit, tolerance, COMMANDS_ALONE_RTOL)
