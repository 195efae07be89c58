"""What a posture of a robot whose base is held costs, whether it holds, and what its tool carries.

In that posture, in every posture, and over the reach of the tool.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import linalg

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.diagnostics import Diagnostic
from pupper_analysis.base.errors import NoEquilibriumError
from pupper_analysis.base.results import Result, Tabular
from pupper_analysis.models.efforts import EffortCode, EffortStatement
from pupper_analysis.models.mjcf import has_free_joint
from pupper_analysis.prepare.judge import judge_simulation
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import command_ranges, compute_command_lead, resolve_servo_gains
from pupper_analysis.robot.tool import Tool, find_tool, with_payload
from pupper_analysis.simulation.verdict import Verdict
from pupper_analysis.simulation.verify import StandVerification, verify_stand
from pupper_analysis.stance.posture import (
    Posture,
    find_posture,
    held_stand,
    joint_units,
)
from pupper_analysis.stance.sag.steady_state import SteadyState, steady_state
from pupper_analysis.stance.soft_ground import solve_stand_as_simulated
from pupper_analysis.statics.equilibrium import (
    MIN_TORQUE_PER_MASS,
    GravityCompensation,
    borne_by_motors,
    gravity_compensation,
    peak_utilisation,
    utilise,
)
from pupper_analysis.tools.hold.force import ToolForce, tool_force
from pupper_analysis.tools.hold.motions import JointMotions, group_coupled_joints
from pupper_analysis.tools.hold.worst import WorstPostures, worst_postures

Array = NDArray[np.float64]

_POSTURES = 600
"""Random postures: a section of an arm's reach is seen in some hundred points."""


@dataclass(frozen=True, eq=False)
class ReachLoad(Tabular):
    """What motors hold in random postures, by where the tool is.

    Attributes:
        distances: (n,) of the tool from the vertical through the chain's first joint (m).
        heights: (n,) of the tool in the world (m).
        utilisation: (n,) of the motor that is nearest to its limit; infinite if a motor without
            torque has to hold something, not a number if no motor has a stated limit.
    """

    distances: Array = field(metadata={"unit": "m"})
    heights: Array = field(metadata={"unit": "m"})
    utilisation: Array = field(metadata={"unit": "1"})

    def _columns(self) -> dict[str, ArrayLike]:
        return {
            "distance": self.distances,
            "height": self.heights,
            "utilisation": self.utilisation,
        }


@check_arguments
def reach_load(robot: Robot, posture: Posture, tool: Tool) -> ReachLoad:
    """Compute the motor utilisation at rest in random postures, over the reach of a tool.

    Args:
        robot: Robot with a fixed base.
        posture: Posture of the robot, with closed loops.
        tool: Tool whose position is recorded.

    Returns:
        Tool position and largest motor utilisation (torque / limit) of each posture.
    """
    found = []
    for qpos in JointMotions(robot, posture).random(_POSTURES):
        config = Configuration(robot, qpos)
        place = tool.position(config)
        middle = config.joint_position(tool.chain[0]) if tool.chain else np.zeros(3)
        most = peak_utilisation(utilise(robot, config.by_motors(config.load())))
        found.append((float(np.hypot(*(place - middle)[:2])), float(place[2]), most))
    distances, heights, utilisation = np.array(found).T
    return ReachLoad(distances, heights, utilisation)


UNLIMITED_MASS_RATIO = 1e4
"""A payload above this many times the robot's mass is as good as unlimited."""

_ROUNDS = 6
"""Worst postures for lesser and lesser payloads: two or three mostly suffice."""

_SETTLED = 1e-4
"""A search ends where a payload changes by less of itself."""

_SOFTENS = 1e-6
"""Less of the servos' stiffness that the robot's mass would take, at the tool, is rounding."""


@dataclass(frozen=True, eq=False)
class ToolPayload(Result):
    """The greatest point masses that the motors hold at a tool.

    Attributes:
        mass: Largest mass in the posture (kg). 0 if a motor exceeds its limit without the mass, or
            a motor that may bear the mass has no torque. Otherwise not a number if a motor that
            bears the mass has an unknown limit, and infinite if no motor bears the mass.
        joint: Whose motor then is at its limit; "" if none is.
        servos: The greatest that its servos hold in the posture (kg), whatever the motors do: with
            more, gravity turns it over against their stiffness, or one is commanded beyond its
            ``ctrlrange``. Infinite if no mass is too much.
        servo: Whose command that is; "" if gravity turns it over.
        somewhere: With more than this, a posture was found that is not held (kg); not a number if a
            motor that may bear it has an unknown limit.
        weakest: The joint whose motor is beyond its limit there; "" if none is.
        posture: (nu,) that posture (rad, m).
        code: ``unknown`` if a motor that may bear the mass has an unknown limit, ``zero`` if one
            has no torque, else ``stated``.
        unknown: Joints that may bear the mass and whose torque limit no file states.
    """

    mass: float = field(metadata={"unit": "kg"})
    joint: str
    servos: float = field(metadata={"unit": "kg"})
    servo: str
    somewhere: float = field(metadata={"unit": "kg"})
    weakest: str
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
    """Compute the largest point masses that the motors hold at a tool, at rest.

    In one posture, torques are linear in the mass, so the limit has a closed form. Over all
    postures, an upper bound of the mass is lowered: the worst postures for a mass M are searched,
    and M is reduced to the largest mass that the motors hold there.

    Args:
        robot: Robot with a fixed base.
        posture: Posture.
        tool: Point at which the mass is attached.
        worst: Worst postures without the mass.
        kp: Servo stiffness [N m/rad], scalar or shape (nu,). Default: the model's.

    Raises:
        ModelError: If the model has no position servos and no kp is given.
    """
    mass, joint = posture_payload(robot, posture.qpos, tool)
    servos, servo = servo_payload(robot, posture, tool, kp)
    bears = _bearing(robot, posture, tool)
    names = np.array(robot.joint_names)
    unknown = tuple(names[bears & np.isinf(robot.effort_limits)].tolist())
    null = names[bears & [limit.without_torque for limit in robot.efforts]].tolist()
    known: dict[str, Any] = {
        "servos": servos,
        "servo": servo,
        "posture": posture.qpos,
        "unknown": unknown,
    }
    if null:
        code, first = EffortCode.ZERO, null[0]
        return ToolPayload(mass=0.0, joint=first, somewhere=0.0, weakest=first, code=code, **known)
    if unknown:
        code = EffortCode.UNKNOWN
        return ToolPayload(
            mass=mass, joint=joint, somewhere=math.nan, weakest="", code=code, **known
        )
    most, weakest, place = _least(robot, tool, [posture.qpos, *worst.postures])
    most = min(most, UNLIMITED_MASS_RATIO * robot.total_mass)
    loaded = worst
    for _ in range(_ROUNDS if most > 0 else 0):
        loaded = worst_postures(robot, posture, tool, payload=most, near=loaded, bearing=bears)
        lower, name, at = _least(robot, tool, list(loaded.postures))
        before = most
        if lower < most:
            most, weakest, place = lower, name, at
        if lower > (1 - _SETTLED) * before:
            break
    return ToolPayload(
        mass=mass,
        joint=joint,
        servos=servos,
        servo=servo,
        somewhere=most if weakest else math.inf,
        weakest=weakest,
        posture=place,
        code=EffortCode.STATED,
        unknown=(),
    )


def posture_payload(robot: Robot, qpos: Array, tool: Tool) -> tuple[float, str]:
    """Compute the largest mass that the motors hold at a tool, at rest in one posture.

    Args:
        robot: Robot with a fixed base.
        qpos: Posture, shape (nu,) [rad, m].
        tool: Point at which the mass is attached.

    Returns:
        Mass [kg] and the joint whose effort limit is reached first. The mass is

        - 0 if a motor exceeds its limit without the mass; the joint is the one with the largest
          excess;
        - otherwise NaN, with "" for the joint, if a motor that bears the mass has an unknown limit;
        - infinite, with "" for the joint, above `UNLIMITED_MASS_RATIO` times the robot's mass.
    """
    config, limits = Configuration(robot, qpos), robot.effort_limits
    empty = config.by_motors(config.load())
    rates = config.by_motors(tool.load_per_mass(config))
    over = np.abs(empty) > limits
    if over.any():
        return 0.0, robot.joint_names[int(np.argmax(np.abs(empty) - limits))]
    mass = borne_by_motors(empty, rates, limits)
    if (np.abs(rates)[np.isinf(limits)] > MIN_TORQUE_PER_MASS).any():
        return math.nan, ""
    if not mass <= UNLIMITED_MASS_RATIO * robot.total_mass:  # a lever that is all but none
        return math.inf, ""
    left = np.where(np.isfinite(limits), limits - np.abs(empty + mass * rates), math.inf)
    return mass, robot.joint_names[int(np.argmin(left))]


def servo_payload(
    robot: Robot, posture: Posture, tool: Tool, kp: ArrayLike | None = None
) -> tuple[float, str]:
    """Compute the largest mass [kg] at a tool that servos hold in a posture.

    The stiffness of servos and gravity together, in the velocities W that couplings allow, is
    W^T (K + G_0 + m G_1) W, linear in the mass; it loses definiteness at the least m > 0 of a
    generalised eigenvalue problem. The command with feed-forward, q + tau / kp, is linear in the
    mass, too. Effort limits are ignored.

    Returns:
        Mass, and the joint whose command is at the end of its range; "" if the stiffness limits the
        mass, or nothing does (infinite mass). The mass is 0 if the stiffness is too low without it.
    """
    config, closure = Configuration(robot, posture.qpos), robot.closure
    basis = np.eye(robot.nu) if closure is None else closure.null_space(posture.qpos)
    gains = resolve_servo_gains(robot, kp, None if kp is None else 0.0).kp
    empty, hung = config.static_rates({}), np.append(robot.gravity, np.zeros(3))
    loaded = config.pushed_rates(tool.twist_jacobian(config)[None], hung[None])
    held = basis.T @ (empty + np.diag(gains)) @ basis
    added = basis.T @ (loaded - empty) @ basis
    held, added = (held + held.T) / 2, (added + added.T) / 2
    if linalg.eigvalsh(held)[0] <= 0:
        return 0.0, ""
    softening = float(linalg.eigh(-added, held, eigvals_only=True)[-1])
    # What is left of a mass that stiffens it everywhere is rounding.
    stable = 1 / softening if softening > _SOFTENS / robot.total_mass else math.inf
    lead = compute_command_lead(config.by_motors(config.load()), gains)
    borne = config.by_motors(tool.load_per_mass(config))
    rates = compute_command_lead(np.where(np.abs(borne) > MIN_TORQUE_PER_MASS, borne, 0.0), gains)
    low, high = command_ranges(robot).T - posture.qpos
    with np.errstate(divide="ignore", invalid="ignore"):
        room = (np.where(rates > 0, high, low) - lead) / rates
    room = np.where(np.isfinite(room), np.maximum(room, 0.0), math.inf)
    first = int(np.argmin(room))
    return (float(room[first]), robot.joint_names[first]) if room[first] < stable else (stable, "")


def _least(robot: Robot, tool: Tool, postures: list[Array]) -> tuple[float, str, Array]:
    """Returns the least that is carried in some postures, whose motor binds there, and where."""
    found = [(*posture_payload(robot, qpos, tool), qpos) for qpos in postures]
    return min(found, key=lambda one: one[0])


def _bearing(robot: Robot, posture: Posture, tool: Tool) -> NDArray[np.bool_]:
    """Tells which motors (nu,) may bear a payload: those that move it, or what moves with them."""
    bears = np.isin(robot.joint_names, tool.chain)
    closure = robot.closure
    for joints in [] if closure is None else group_coupled_joints(closure, posture.qpos):
        bears[joints] |= bears[joints].any()
    if closure is not None:
        bears[closure.following] = False
    return bears


VERIFIED_FRACTION = 0.95
"""Part of the payload that is simulated, the lesser of what motors and servos hold: at the
limit rounding decides whether it holds."""


@dataclass(frozen=True, eq=False)
class Hold(Tabular):
    """A posture of a robot whose base is held, what it costs, and whether it holds.

    Attributes:
        name: The robot's name.
        hangs: Whether its base, which is held, is free in the MJCF; the ground touches nothing.
        posture: Where it is commanded to be.
        units: (nu,) of the joints' positions: rad, or m of one that slides; of its motor, N for
            N m.
        tool: Where it carries, and is pushed.
        tool_position: (3,) in the world (m).
        limits: (nu,) of the motors' torques, the least that both files state (N m).
        limit_origins: (nu,) which statement of which file each is; None without a limit.
        statics: What the motors hold.
        verification: The simulation, with feed-forward.
        sagging: The simulation without.
        settled: Where servos let it come to rest without; None where that is not predicted.
        unsettled: Why ``settled`` is None; None where it is not.
        tool_sag: (3,) how far the tool then is from where the posture has it (m); likewise.
        simulated_tool_sag: (3,) the same, simulated; not a number if that diverged.
        verdict: Whether it holds, and what that rests on.
        worst: The worst posture of each motor.
        carried: Mass at the tool, which all is of (kg).
        payload: What the motors hold at the tool besides.
        payload_trial: The simulation, with feed-forward, of ``VERIFIED_FRACTION`` of it in the
            posture; None where nothing is carried, or nothing limits it.
        force: How hard the tool can be pushed.
        reach: What the motors hold over the tool's reach.
    """

    name: str
    hangs: bool
    posture: Posture
    units: tuple[str, ...]
    tool: Tool
    tool_position: Array = field(metadata={"unit": "m"})
    limits: Array = field(metadata={"unit": "N m"})
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
    force: ToolForce
    reach: ReachLoad

    @property
    def passed(self) -> bool:
        """Whether the verdict on the held posture is positive."""
        return self.verdict.passed

    def _columns(self) -> dict[str, ArrayLike]:
        return {
            "joint": self.statics.joint_names,
            "position": self.posture.qpos,
            "torque": self.statics.joint_torques,
            "utilisation": self.statics.motor_utilisation,
        }


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
) -> Hold:
    """Analyse a static posture of a robot with a fixed base, and simulate whether it holds.

    The result contains motor torques, sag on the servos, worst postures, and the payload and push
    force that the tool can bear.

    Args:
        robot: Robot with a fixed base: an arm, a hand, or a robot that was loaded with
            ``fixed_base=True``.
        joints: {joint, or a pattern such as ``*elbow*``: position [rad, m]}.
        keyframe: Keyframe of the MJCF for the other joints. Default: ``home``, or the first
            keyframe; without keyframes, the middle of the joint ranges.
        tool: Link of the URDF, or site, body or geom of the MJCF. Default: the end of the longest
            chain of joints.
        payload: Mass [kg] that is attached to the tool in the whole analysis.
        kp: Servo stiffness [N m/rad], scalar or shape (nu,). Default: the model's.
        kd: Servo damping [N m s/rad], scalar or shape (nu,). Default: the model's.

    Raises:
        ConfigurationError: If the base is free, or an argument is invalid for the robot.
        UnknownNameError: If there is no such joint, keyframe or tool.
        ModelError: If the robot has no position servos, and kp and kd are not both given.
    """
    posture, point = find_posture(robot, joints, keyframe=keyframe), find_tool(robot, tool)
    robot = with_payload(robot, payload, point)
    config, stand = Configuration(robot, posture.qpos), held_stand(robot, posture)
    statics = gravity_compensation(config, contacts=[])
    held = solve_stand_as_simulated(robot, stand)
    settled, unsettled, sag = None, None, None
    try:
        settled = steady_state(robot, held, kp=kp)
        sag = point.position(Configuration(robot, settled.qpos)) - point.position(config)
    except NoEquilibriumError as error:
        unsettled = error.diagnostic
    fed = verify_stand(robot, held, kp=kp, kd=kd)
    alone = verify_stand(robot, held, feedforward=False, kp=kp, kd=kd, settled=settled)
    rest, simulated = alone.joint_positions, np.full(3, np.nan)
    if np.isfinite(rest).all():
        simulated = point.position(Configuration(robot, rest)) - point.position(config)
    worst = worst_postures(robot, posture, point)
    more = tool_payload(robot, posture, point, worst, kp=kp)
    trial, most = None, min(more.mass, more.servos)
    if 0 < most < math.inf:
        loaded = with_payload(robot, VERIFIED_FRACTION * most, point)
        stood = solve_stand_as_simulated(loaded, held_stand(loaded, posture))
        trial = verify_stand(loaded, stood, kp=kp, kd=kd)
    return Hold(
        name=robot.name,
        hangs=has_free_joint(robot.description.mjcf),
        posture=posture,
        units=joint_units(robot),
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
        verdict=judge_simulation(robot, stand, fed, alone, statics=statics, kp=kp, kd=kd),
        worst=worst,
        payload=more,
        carried=float(payload),
        payload_trial=trial,
        force=tool_force(robot, posture, point),
        reach=reach_load(robot, posture, point),
    )
