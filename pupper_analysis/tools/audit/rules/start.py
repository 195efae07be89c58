"""Rules about the poses in which a simulation starts: qpos0 and the keyframes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import mujoco
import numpy as np

from pupper_analysis.base.diagnostics import (
    Diagnostic,
    Quantity,
    Severity,
    diagnose,
)
from pupper_analysis.models.efforts import find_max_effort
from pupper_analysis.models.loading import CheckFinding
from pupper_analysis.models.mjcf import JointKind
from pupper_analysis.models.stated.mjcf import joint_name
from pupper_analysis.models.stated.model import Array, MjcfModel, RobotModel
from pupper_analysis.robot.contact import ground_geom
from pupper_analysis.robot.fall import simulate_keyframe
from pupper_analysis.tools.audit.registry import rule
from pupper_analysis.tools.audit.rules.actuators import list_drives

MAX_FLOOR_DEPTH = 5e-3
"""How deep a start may be in the floor (m): a standing robot sinks a few mm into soft contacts."""

MAX_KEYFRAMES = 100
"""How many keyframes are looked at."""

MAX_SAG = 0.5
"""How far a servo without a torque limit may be commanded ahead of its joint (rad, m)."""

_SHORTEST = 1e-4
"""s: of a time step with which that takes more than 20,000 steps nothing is simulated here."""


@dataclass(frozen=True, eq=False)
class StartPose:
    """A pose in which a simulation may start.

    Attributes:
        element: Tag and name for findings.
        message: What it is called.
        qpos: (nq,).
        severity: NOTE for qpos0 where keyframes exist: then nobody starts there.
    """

    element: tuple[str, str]
    message: Diagnostic
    qpos: Array
    severity: Severity


def _starts(robot: MjcfModel) -> Iterator[StartPose]:
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
    """Finds joints outside by more than 1 mrad (1 mm); NOTE for zero angles and qpos0."""
    for where, start, values in _angles(robot):
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


def _angles(robot: RobotModel) -> Iterator[tuple[tuple[str, str], Diagnostic, dict[str, float]]]:
    """Yields the element, the name and the joints' positions of each start."""
    if not isinstance(robot, MjcfModel):
        if robot.base:
            values = {joint.name: 0.0 for joint in robot.joints.values()}
            yield (robot.link_tag, robot.base), diagnose("start-zero"), values
        return
    model = robot.mj_model
    for start in _starts(robot):
        assert model is not None
        values = {
            joint_name(model, joint): float(start.qpos[model.jnt_qposadr[joint]])
            for joint in range(model.njnt)
        }
        yield start.element, start.message, values


@rule
def keyframe_ctrl(robot: MjcfModel) -> Iterator[CheckFinding]:
    """Finds commands of position servos that a keyframe's own pose does not answer to.

    A command may be ahead of its joint by the torque that holds it: at most by what the servo's
    limit gives, or by 0.5 rad (0.5 m), a sag that no standing robot has, where it has none.
    """
    model = robot.mj_model
    if model is None:
        return
    for key in range(min(model.nkey, MAX_KEYFRAMES)):
        ahead: dict[str, float] = {}
        for drive in list_drives(model):
            angle = float(model.key_qpos[key, model.jnt_qposadr[drive.joint]])
            if drive.stiffness <= 0 or drive.gear == 0:
                continue
            command = float(model.key_ctrl[key, drive.control]) * drive.gain / drive.stiffness
            limit = find_max_effort(model, drive.joint) / (drive.stiffness * drive.gear**2)
            off = command / drive.gear - angle
            if abs(off) > 1e-3 + (limit if math.isfinite(limit) else MAX_SAG):
                ahead[drive.joint_name] = off
        if ahead:
            worst = max(ahead, key=lambda name: abs(ahead[name]))
            name = model.key(key).name
            message = diagnose(
                "keyframe-ctrl",
                joint=worst,
                off=Quantity(ahead[worst], robot.joints[worst].unit),
                ahead=len(ahead),
                commands=model.nu,
            )
            said = len(robot.file.spec.keys[key].ctrl) > 0
            yield CheckFinding("key", name, message, severity=None if said else Severity.NOTE)


@rule
def keyframe_falls(robot: MjcfModel) -> Iterator[CheckFinding]:
    """Simulates the first keyframe (``home``, if there is one) with its own actuators and ctrl.

    For 5 s, nudged. Where the keyframe states no ctrl, position servos are commanded to hold its
    joints, if half of them have one; motors would need a controller.
    """
    model = robot.mj_model
    if model is None or robot.refusal is not None or not model.nkey or not robot.base:
        return
    base, step = robot.body_names.index(robot.base), float(model.opt.timestep)
    joint = int(model.body_jntadr[base])
    free = joint >= 0 and model.jnt_type[joint] == JointKind.FREE
    if not free or not step >= _SHORTEST:
        return
    names = [model.key(key).name for key in range(model.nkey)]
    key = names.index("home") if "home" in names else 0
    before = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, before, key)
    ground = ground_geom(model)
    stated = bool(model.key_ctrl[key].any()) or len(robot.file.spec.keys[key].ctrl) > 0
    if ground is None or not (stated or _held(robot, before)):
        return
    mujoco.mj_kinematics(model, before)
    floor = float(before.geom_xpos[ground][2])
    motion, _ = simulate_keyframe(model, before, base, floor, partial(_run, model))
    if motion.diverged:
        message = diagnose("keyframe-diverges")
    elif motion.collapses:
        message = diagnose(
            "keyframe-falls",
            time=Quantity(motion.duration, "s"),
            end=_rounded(motion.end_height, "m"),
            start=_rounded(motion.height, "m"),
            away=_rounded(motion.away, "m"),
            lean=_rounded(motion.lean, "rad"),
        )
    else:
        return
    yield CheckFinding("key", names[key], message)


def _held(robot: MjcfModel, data: mujoco.MjData) -> bool:
    """Commands position servos to a pose; tells whether they are at half of the joints or more."""
    assert robot.mj_model is not None
    holding = [drive for drive in list_drives(robot.mj_model) if drive.servo]
    for drive in holding:
        angle = float(data.qpos[robot.mj_model.jnt_qposadr[drive.joint]])
        data.ctrl[drive.control] = drive.gear * angle * drive.stiffness / (drive.gain or 1.0)
    return 2 * len(holding) >= max(1, sum(joint.moves for joint in robot.joints.values()))


def _run(model: mujoco.MjModel, data: mujoco.MjData, seconds: float) -> None:
    for _ in range(round(seconds / model.opt.timestep)):
        mujoco.mj_step(model, data)


@rule
def start_in_floor(robot: MjcfModel) -> Iterator[CheckFinding]:
    """Finds contacts with planes of the world deeper than 5 mm; the deepest of each start."""
    for start in _starts(robot):
        depths: dict[str, float] = {}
        for bodies, geoms, depth in _contacts(robot, start):
            assert robot.mj_model is not None
            planes = robot.mj_model.geom_type[list(geoms)] == mujoco.mjtGeom.mjGEOM_PLANE.value
            if planes.any() and 0 in bodies and depth > MAX_FLOOR_DEPTH:
                name = robot.body_names[max(bodies)]
                depths[name] = max(depth, depths.get(name, 0.0))
        if depths:
            deepest = max(depths, key=lambda name: depths[name])
            message = diagnose(
                "start-in-floor",
                start=start.message,
                body=deepest,
                depth=_rounded(depths[deepest], "m"),
                others=len(depths) - 1,
            )
            yield CheckFinding(*start.element, message, severity=start.severity)


def _rounded(value: float, unit: str) -> Quantity:
    """Returns what a simulation, or a search for contacts, ends in, to the digits that it has.

    The others are of the machine, and of MuJoCo's version: a baseline would not know it again.
    """
    return Quantity(float(f"{value:.3g}"), unit)


def _contacts(
    robot: MjcfModel, start: StartPose
) -> Iterator[tuple[tuple[int, int], tuple[int, int], float]]:
    """Yields bodies, geoms and depth (m) of each contact that MuJoCo finds in a pose."""
    model = robot.mj_model
    assert model is not None
    data = mujoco.MjData(model)
    data.qpos[:] = start.qpos
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    try:
        mujoco.mj_collision(model, data)
    except mujoco.FatalError:  # of shapes without directions, which are told
        return
    for number in range(data.ncon):
        one, other = (int(geom) for geom in data.contact.geom[number])
        if one < 0 or other < 0:
            continue
        bodies = (int(model.geom_bodyid[one]), int(model.geom_bodyid[other]))
        yield bodies, (one, other), -float(data.contact.dist[number])
