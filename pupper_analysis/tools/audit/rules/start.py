"""Rules about the initial configurations of a simulation: qpos0 and the keyframes.

Input is the model of a file; a URDF starts at zero angles. The rules compare joint positions with
the limits and with the commands of keyframes, evaluate heights and penetrations with MuJoCo, and
simulate a single keyframe.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations

import mujoco
import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import (
    Diagnostic,
    Quantity,
    Severity,
    diagnose,
)
from pupper_analysis.base.errors import PupperAnalysisError
from pupper_analysis.models.efforts import resolve_effort_limit
from pupper_analysis.models.loading import CheckFinding
from pupper_analysis.models.mjcf import JointKind, has_free_joint
from pupper_analysis.models.shapes import read_shape
from pupper_analysis.models.stated.mjcf import joint_name
from pupper_analysis.models.stated.model import MjcfModel, RobotModel
from pupper_analysis.robot.as_published import OwnCommands, OwnRun
from pupper_analysis.robot.contact import ground_geom
from pupper_analysis.robot.fall import BodyMotion, simulate_keyframe
from pupper_analysis.robot.servos import find_servos_used
from pupper_analysis.robot.shapes import may_touch
from pupper_analysis.tools.audit.registry import rule
from pupper_analysis.tools.audit.rules.actuators import list_drives
from pupper_analysis.tools.audit.rules.simulation import list_foot_geoms

MAX_FLOOR_DEPTH = 5e-3
"""Penetration of the floor in an initial configuration [m] above which the contact is reported. A
standing robot sinks a few mm into soft contacts. Chosen, not tuned."""

MAX_KEYFRAMES = 100
"""Largest number of keyframes of a file that a rule checks. Chosen, to bound the time."""

MAX_SAG = 0.5
"""Difference between a servo command and the joint position in a keyframe [rad, m], for a servo
without torque limit, above which (plus 1 mrad or 1 mm) the keyframe is reported. Chosen, not tuned.
"""

_MIN_TIMESTEP = 1e-4
"""Time step [s] below which a file is not simulated: each run would need more than 20,000 steps.
Chosen, not tuned."""


@dataclass(frozen=True, eq=False)
class StartPose:
    """Initial configuration of a simulation that the rules check: qpos0 or a keyframe.

    Attributes:
        element: Tag and name for findings.
        message: Name of the configuration for texts: ``qpos0``, or name and index of the keyframe.
        qpos: Configuration, shape (nq,).
        severity: NOTE for qpos0 if keyframes exist, since simulations then start at a keyframe;
            otherwise WARNING.
    """

    element: tuple[str, str]
    message: Diagnostic
    qpos: Array
    severity: Severity


def _list_start_poses(robot: MjcfModel) -> Iterator[StartPose]:
    """Yield qpos0 and up to `MAX_KEYFRAMES` keyframes; nothing without a compiled model."""
    model = robot.mj_model
    if model is None or not robot.links:
        return
    least = Severity.NOTE if model.nkey else Severity.WARNING
    yield StartPose(("body", robot.base), diagnose("start-qpos0"), np.array(model.qpos0), least)
    for key in range(min(model.nkey, MAX_KEYFRAMES)):
        name = model.key(key).name
        message = diagnose("start-keyframe", keyframe=name, number=key)
        yield StartPose(("key", name), message, np.array(model.key_qpos[key]), Severity.WARNING)


@rule
def start_outside_limits(robot: RobotModel) -> Iterator[CheckFinding]:
    """Find initial configurations with joints more than 1 mrad (1 mm) outside the limits.

    The severity is NOTE for ``qpos0`` of an MJCF and the zero angles of other formats.
    """
    for where, start, values in _list_start_angles(robot):
        excess = {
            joint.name: max(joint.lower - values[joint.name], values[joint.name] - joint.upper)
            for joint in robot.joints.values()
            if joint.moves and joint.lower < joint.upper and joint.name in values
        }
        outside = [name for name, by in excess.items() if by > 1e-3]
        if outside:
            worst = robot.joints[max(outside, key=lambda name: excess[name])]
            message = diagnose(
                "start-outside-limits",
                start=start,
                joint=worst.name,
                value=Quantity(values[worst.name], worst.unit),
                lower=Quantity(worst.lower, worst.unit),
                upper=Quantity(worst.upper, worst.unit),
                outside=len(outside),
                joints=len(excess),
            )
            yield CheckFinding(
                *where, message, severity=None if where[0] == "key" else Severity.NOTE
            )


def _list_start_angles(
    robot: RobotModel,
) -> Iterator[tuple[tuple[str, str], Diagnostic, dict[str, float]]]:
    """Yield initial configurations: element (tag, name), title, {joint: first entry in qpos}.

    The entry is the position [rad, m] of a hinge or slide.
    """
    if not isinstance(robot, MjcfModel):
        if robot.base:
            values = {joint.name: 0.0 for joint in robot.joints.values()}
            yield (robot.link_tag, robot.base), diagnose("start-zero"), values
        return
    model = robot.mj_model
    for start in _list_start_poses(robot):
        assert model is not None
        values = {
            joint_name(model, joint): float(start.qpos[model.jnt_qposadr[joint]])
            for joint in range(model.njnt)
        }
        yield start.element, start.message, values


@rule
def keyframe_ctrl(robot: MjcfModel) -> Iterator[CheckFinding]:
    """Find keyframes with servo commands that are far from the joint positions.

    The accepted difference of command and position is about the effort limit divided by the
    stiffness, or `MAX_SAG` without effort limit. The severity is NOTE if the keyframe has no ctrl.
    """
    model = robot.mj_model
    if model is None:
        return
    for key in range(min(model.nkey, MAX_KEYFRAMES)):
        offsets: dict[str, float] = {}
        for drive in list_drives(model):
            angle = float(model.key_qpos[key, model.jnt_qposadr[drive.joint]])
            if drive.stiffness <= 0 or drive.gear == 0:
                continue
            command = float(model.key_ctrl[key, drive.control]) * drive.gain / drive.stiffness
            effort = resolve_effort_limit(model, drive.joint)
            limit = max(-effort.lower, effort.upper) / (drive.stiffness * drive.gear**2)
            offset = command / drive.gear - angle
            if abs(offset) > 1e-3 + (limit if math.isfinite(limit) else MAX_SAG):
                offsets[drive.joint_name] = offset
        if offsets:
            worst = max(offsets, key=lambda name: abs(offsets[name]))
            name = model.key(key).name
            message = diagnose(
                "keyframe-ctrl",
                joint=worst,
                off=Quantity(offsets[worst], robot.joints[worst].unit),
                ahead=len(offsets),
                commands=model.nu,
            )
            has_ctrl = len(robot.file.spec.keys[key].ctrl) > 0
            yield CheckFinding("key", name, message, severity=None if has_ctrl else Severity.NOTE)


@rule
def keyframe_incomplete(robot: MjcfModel) -> Iterator[CheckFinding]:
    """Find keyframes whose qpos or ctrl has fewer numbers than the model; MuJoCo fills the rest."""
    model = robot.mj_model
    if model is None or robot.refusal is not None:
        return
    for attributes, place in list(robot.file.elements("key"))[:MAX_KEYFRAMES]:
        for word, size in (("qpos", model.nq), ("ctrl", model.nu)):
            count = len(attributes.get(word, "").split())
            if 0 < count < size:
                message = diagnose("keyframe-incomplete", what=word, count=count, size=size)
                yield CheckFinding("key", attributes.get("name", ""), message, place=place)


@rule
def keyframe_base_half_turn(robot: MjcfModel) -> Iterator[CheckFinding]:
    """Find keyframes with the base quaternion (0, 0, 0, 1): the identity in the order x, y, z, w.

    In MuJoCo's order w, x, y, z, this is half a turn about z. Only models with a single free joint
    are checked.
    """
    model = robot.mj_model
    if model is None or robot.refusal is not None or not model.njnt:
        return
    free = np.flatnonzero(model.jnt_type == JointKind.FREE)
    if len(free) != 1:
        return
    address = int(model.jnt_qposadr[free[0]])
    for key in range(min(model.nkey, MAX_KEYFRAMES)):
        if np.array_equal(model.key_qpos[key, address + 3 : address + 7], (0.0, 0.0, 0.0, 1.0)):
            yield CheckFinding("key", model.key(key).name, diagnose("keyframe-base-half-turn"))


MIN_EQUAL_COMMANDS = 3
"""Smallest number of joint angles above 1 mrad in magnitude from which a keyframe is reported whose
torque commands all equal the joint angles. Chosen: torques do not equal angles by chance.
"""


@rule
def keyframe_torques_are_angles(robot: MjcfModel) -> Iterator[CheckFinding]:
    """Find keyframes whose commands to torque motors are the joint angles [rad].

    The commands of all motors of hinges must equal the angles within 1 % plus 1 mrad.
    """
    model = robot.mj_model
    if model is None:
        return
    hinge = mujoco.mjtJoint.mjJNT_HINGE.value
    motors = [
        drive
        for drive in list_drives(model)
        if not drive.is_servo and drive.gain and model.jnt_type[drive.joint] == hinge
    ]
    controls = [drive.control for drive in motors]
    addresses = [int(model.jnt_qposadr[drive.joint]) for drive in motors]
    for key in range(min(model.nkey, MAX_KEYFRAMES)):
        commands, angles = model.key_ctrl[key, controls], model.key_qpos[key, addresses]
        bent = np.abs(angles) > 1e-3
        if bent.sum() >= MIN_EQUAL_COMMANDS and np.allclose(commands, angles, 1e-2, 1e-3):
            first = motors[int(np.argmax(np.abs(angles)))]
            message = diagnose(
                "keyframe-torques-are-angles",
                motors=len(motors),
                joint=first.joint_name,
                command=Quantity(float(np.abs(commands).max()), "N m"),
            )
            yield CheckFinding("key", model.key(key).name, message)


MIN_FOOT_CLEARANCE = 0.05
"""Height of the feet above the lowest other shape of the robot [m]: a keyframe is reported if all
feet are at least this height above. In `_find_opposite_signs`, also a bound of the distance between
feet and ground. Chosen, not tuned.
"""


@rule
def keyframe_feet_in_air(robot: MjcfModel) -> Iterator[CheckFinding]:
    """Find a keyframe ``home``, or first keyframe, in which the feet are above other shapes.

    All feet are at least `MIN_FOOT_CLEARANCE` above the lowest other shape that can touch the
    ground, and no such shape penetrates the ground. If the opposite sign of some joint angles, in
    all legs, puts the feet at the ground, the message names the joints.
    """
    model = robot.mj_model
    key = None if model is None or robot.refusal is not None else _choose_keyframe(model)
    if model is None or key is None or not has_free_joint(model):
        return
    ground = ground_geom(model)
    feet = [geom for geom in list_foot_geoms(robot) if may_touch(model, geom, ground)]
    checked_geoms = [
        geom
        for geom in range(model.ngeom)
        if geom not in feet
        and model.body_weldid[model.geom_bodyid[geom]]
        and may_touch(model, geom, ground)
    ]
    if len(feet) < MIN_FEET or not checked_geoms:
        return
    data = mujoco.MjData(model)
    heights = partial(_compute_heights, model, data, ground)
    qpos = np.array(model.key_qpos[key])
    foot_heights, other_heights = heights(qpos, feet), heights(qpos, checked_geoms)
    lowest = float(other_heights.min())
    if lowest < 0 or foot_heights.min() < MIN_FOOT_CLEARANCE + lowest:
        return
    remedy = _find_opposite_signs(robot, qpos, feet, checked_geoms, heights)
    message = diagnose(
        "keyframe-feet-in-air",
        lowest=_round_quantity(float(foot_heights.min()), "m"),
        highest=_round_quantity(float(foot_heights.max()), "m"),
        body=robot.body_names[int(model.geom_bodyid[checked_geoms[int(other_heights.argmin())]])],
        height=_round_quantity(lowest, "m"),
        joints=() if remedy is None else remedy[0],
        then=None if remedy is None else _round_quantity(remedy[1], "m"),
    )
    yield CheckFinding("key", model.key(key).name, message)


MIN_FEET = 2
"""Smallest number of foot geoms with which a keyframe is checked for feet in the air. Chosen, not
tuned."""

MAX_LEG_JOINTS = 4
"""Largest number of hinges of a leg for which combinations of opposite signs of the joint angles
are tried. Chosen, to bound the time.
"""


def _find_opposite_signs(
    robot: MjcfModel,
    qpos: Array,
    feet: Sequence[int],
    others: Sequence[int],
    heights: Callable[[Array, Sequence[int]], Array],
) -> tuple[tuple[str, ...], float] | None:
    """Find the leg joints whose angles need the opposite sign to make the feet the lowest shapes.

    The angles of these joints are negated in all legs alike: for example, those of the second joint
    of each leg. ``feet`` and ``others`` are ids of geoms; ``heights`` returns the height [m] of the
    lowest point of each geom, from qpos and ids.

    Returns:
        Names of the joints, and the largest distance of a foot from the ground [m]. None if there
        is no unique solution.
    """
    model = robot.mj_model
    assert model is not None
    chains = [_list_hinges_above(model, int(model.geom_bodyid[foot])) for foot in feet]
    length = len(chains[0])
    if any(len(chain) != length for chain in chains) or not 0 < length <= MAX_LEG_JOINTS:
        return None
    hinges = np.unique(np.array(chains))
    low, high = np.where(
        model.jnt_limited[hinges], model.jnt_range[hinges].T, [[-np.inf], [np.inf]]
    )
    for size in range(1, length + 1):
        remedies = []
        for places in combinations(range(length), size):
            joints = [chain[place] for chain in chains for place in places]
            turned = np.array(qpos)
            turned[model.jnt_qposadr[joints]] *= -1.0
            angles, foot_heights = turned[model.jnt_qposadr[hinges]], heights(turned, feet)
            gap = float(np.abs(foot_heights).max())
            is_lowest = foot_heights.max() < heights(turned, others).min()
            is_inside = ((angles >= low) & (angles <= high)).all()
            changes = np.abs(qpos[model.jnt_qposadr[joints]]).all()
            if is_lowest and is_inside and changes and gap < MIN_FOOT_CLEARANCE:
                remedies.append((tuple(joint_name(model, joint) for joint in joints), gap))
        if remedies:
            return remedies[0] if len(remedies) == 1 else None
    return None


_WORLD_POSE = (np.eye(3), np.zeros(3))
"""Rotation and position of the world frame, in which shapes are expressed."""


def _list_hinges_above(model: mujoco.MjModel, body: int) -> list[int]:
    """Return the ids of the hinges on the path from the world to a body, including the body's."""
    hinges: list[int] = []
    while body:
        first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        own = [j for j in range(first, first + count) if model.jnt_type[j] == JointKind.HINGE]
        hinges = own + hinges
        body = int(model.body_parentid[body])
    return hinges


def _compute_heights(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    ground: int | None,
    qpos: Array,
    geoms: Sequence[int],
) -> Array:
    """Return the height above the ground of the lowest point of each geom, shape (n,) [m].

    ``ground`` is the id of the ground plane's geom; None for the plane z = 0. ``qpos``, shape
    (nq,), is the configuration; ``data`` is changed in place.
    """
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    normal, floor = np.array([0.0, 0.0, 1.0]), 0.0
    if ground is not None:
        normal = data.geom_xmat[ground].reshape(3, 3)[:, 2]
        floor = float(normal @ data.geom_xpos[ground])
    lowest = []
    for geom in geoms:
        shape = read_shape(model, geom, data)
        lowest.append(float(shape.find_lowest_point(_WORLD_POSE, normal) @ normal) - floor)
    return np.array(lowest)


_SOLVER_PACKAGES = ("clarabel", "placo")
"""Packages of the stance solver. An installation that only checks files does not have them."""


@rule
def keyframe_falls(robot: MjcfModel) -> Iterator[CheckFinding]:
    """Find a keyframe from which the robot does not stand in a simulation of the unmodified file.

    The simulation is the run of the unmodified file that the command ``stand`` also evaluates
    (`OwnRun`). If no legged robot can be loaded from the file, for example without feet, a simpler
    criterion applies.
    """
    model = robot.mj_model
    if model is None or robot.refusal is not None or not model.nkey or not robot.base:
        return
    base, step = robot.body_names.index(robot.base), float(model.opt.timestep)
    joint = int(model.body_jntadr[base])
    free = joint >= 0 and model.jnt_type[joint] == JointKind.FREE
    if not free or not step >= _MIN_TIMESTEP:
        return
    try:
        # Imported late: these modules import the stance solver.
        from pupper_analysis.prepare.convert.load import load_mjcf_robot
        from pupper_analysis.prepare.self_check import explain_own_run, name_remaining_cause

        loaded = load_mjcf_robot(robot.file)
        run = explain_own_run(loaded)
    except PupperAnalysisError:  # the commands that simulate robots report this error
        run = None
    except ModuleNotFoundError as error:
        if error.name not in _SOLVER_PACKAGES:
            raise
        run = None
    if run is None or not run.keyframe:
        yield from _find_collapse(robot, base)
        return
    if not run.fails:
        return
    if not (run.causes or find_servos_used(loaded, None, None).replacement_servos):
        run = name_remaining_cause(loaded, run, None)[0] or run
    names = {model.key(key).name for key in range(model.nkey)}
    name = run.keyframe if run.keyframe in names else ""  # a keyframe without a name
    yield CheckFinding("key", name, _describe_fall(run, run))


def _find_collapse(robot: MjcfModel, base: int) -> Iterator[CheckFinding]:
    """Find a keyframe from which a robot falls, rises or moves away, or the simulation diverges.

    If the keyframe has no ctrl, position servos are commanded to the pose. ``base`` is the body id
    of the base, which has a free joint.
    """
    model = robot.mj_model
    key = None if model is None else _choose_keyframe(model)
    if model is None or key is None:
        return
    before = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, before, key)
    ground = ground_geom(model)
    stated = bool(model.key_ctrl[key].any()) or len(robot.file.spec.keys[key].ctrl) > 0
    if ground is None or not (stated or _command_servos(robot, before)):
        return
    mujoco.mj_kinematics(model, before)
    floor = float(before.geom_xpos[ground][2])
    motion, _ = simulate_keyframe(model, before, base, floor, partial(_run_simulation, model))
    if motion.collapses:
        yield CheckFinding("key", model.key(key).name, _describe_fall(motion))


def _describe_fall(motion: BodyMotion, run: OwnRun | None = None) -> Diagnostic:
    """Create the message about a simulation from a keyframe that does not end in the stance.

    ``run`` is the same simulation with the joints of the robot and the causes; None if unknown.
    """
    causes: tuple[Diagnostic, ...] = ()
    if run is not None:
        from pupper_analysis.present.verdict import describe_cause  # imports the stance solver

        causes = tuple(map(describe_cause, run.causes))
    if motion.diverged:
        return diagnose("keyframe-diverges", causes=causes)
    stands = run is not None and not motion.collapses
    loose = run.unheld if run is not None and stands else None
    leg = run.lifted_leg if run is not None and stands and loose is None else None
    tilted = run is not None and stands and loose is None and leg is None and run.is_tilted
    return diagnose(
        "keyframe-falls",
        lifted=motion.is_lifted,
        collapses=motion.collapses and not motion.is_lifted,
        tilted=tilted,
        loose=None if loose is None else loose.joint,
        leg=None if leg is None else leg.joint,
        moved=stands and loose is None and leg is None and not tilted,
        absent=run is not None and run.commands is OwnCommands.ABSENT,
        time=Quantity(motion.duration, "s"),
        end=_round_quantity(motion.end_height, "m"),
        start=_round_quantity(motion.height, "m"),
        away=_round_quantity(motion.away, "m"),
        lean=_round_quantity(motion.lean, "rad"),
        causes=causes,
    )


def _choose_keyframe(model: mujoco.MjModel) -> int | None:
    """Return the index of the keyframe ``home``, or else 0; None without keyframes."""
    names = [model.key(key).name for key in range(model.nkey)]
    return names.index("home") if "home" in names else next(iter(range(model.nkey)), None)


def _command_servos(robot: MjcfModel, data: mujoco.MjData) -> bool:
    """Command the position servos to hold ``data.qpos``; return True if they are enough.

    ``data.ctrl`` is changed in place. Enough are at least half as many servos as moving joints.
    """
    assert robot.mj_model is not None
    holding = [drive for drive in list_drives(robot.mj_model) if drive.is_servo]
    for drive in holding:
        angle = float(data.qpos[robot.mj_model.jnt_qposadr[drive.joint]])
        data.ctrl[drive.control] = drive.gear * angle * drive.stiffness / (drive.gain or 1.0)
    return 2 * len(holding) >= max(1, sum(joint.moves for joint in robot.joints.values()))


def _run_simulation(model: mujoco.MjModel, data: mujoco.MjData, seconds: float) -> None:
    """Simulate for ``seconds`` [s], rounded to whole time steps; ``data`` is changed in place."""
    mujoco.mj_step(model, data, nstep=round(seconds / model.opt.timestep))


@rule
def start_in_floor(robot: MjcfModel) -> Iterator[CheckFinding]:
    """Find initial configurations with a body deeper than `MAX_FLOOR_DEPTH` in a world plane.

    World planes are planes of the world body and of bodies that are fixed to the world.
    """
    for start in _list_start_poses(robot):
        depths: dict[str, float] = {}
        for bodies, geoms, depth in _list_penetrations(robot, start):
            assert robot.mj_model is not None
            planes = robot.mj_model.geom_type[list(geoms)] == mujoco.mjtGeom.mjGEOM_PLANE.value
            fixed = robot.mj_model.body_weldid[list(bodies)] == 0
            if (planes & fixed).any() and depth > MAX_FLOOR_DEPTH:
                name = robot.body_names[bodies[int(fixed.argmin())]]
                depths[name] = max(depth, depths.get(name, 0.0))
        if depths:
            deepest = max(depths, key=lambda name: depths[name])
            message = diagnose(
                "start-in-floor",
                start=start.message,
                body=deepest,
                depth=_round_quantity(depths[deepest], "m"),
                others=len(depths) - 1,
            )
            yield CheckFinding(*start.element, message, severity=start.severity)


def _round_quantity(value: float, unit: str) -> Quantity:
    """Round a value that MuJoCo computes to three significant digits.

    Further digits may depend on the machine and the version of MuJoCo, so that baselines would not
    match.
    """
    return Quantity(float(f"{value:.3g}"), unit)


def _list_penetrations(
    robot: MjcfModel, start: StartPose
) -> Iterator[tuple[tuple[int, int], tuple[int, int], float]]:
    """Yield MuJoCo's contacts in a start pose: ids of both bodies and geoms, and penetration [m].

    The penetration is negative if the geoms are apart, within the contact margin.
    """
    model = robot.mj_model
    assert model is not None
    data = mujoco.MjData(model)
    data.qpos[:] = start.qpos
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    try:
        mujoco.mj_collision(model, data)
    except mujoco.FatalError:  # shapes without valid orientation, reported by another rule
        return
    for number in range(data.ncon):
        first, second = (int(geom) for geom in data.contact.geom[number])
        if first < 0 or second < 0:
            continue
        bodies = (int(model.geom_bodyid[first]), int(model.geom_bodyid[second]))
        yield bodies, (first, second), -float(data.contact.dist[number])
