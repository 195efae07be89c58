"""Paths on soft ground: the feet sink by what they carry, and creep where they are pushed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.robot.compliance import GroundLaw
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.path.creeping import integrate_creep
from pupper_analysis.stance.path.pyramid import contact_frame, is_pyramid, sink_in_pyramid
from pupper_analysis.stance.path.stance_path import StancePath
from pupper_analysis.statics.dynamics import joint_resistance, rolling_resistance

Array = NDArray[np.float64]

_STEPS = 2  # of Newton's iteration in each round, for legs that get longer by millimetres

AT_REST = ("clamped", "not-a-knot")
"""Ends of splines of what sinks: it begins at rest, but follows with a delay to the end."""

_FIXED_POINT_ITERATIONS = 2
"""Of depths, how far feet roll, how legs turn as they get longer, and what they then take of the
ground. Each makes the error smaller by about foot radius / leg length, a tenth; but more of them
bring out the kinks of the forces."""

_IN_PYRAMIDS = 3
"""The same where feet are in pyramidal cones, whose creep is that of the forces of the round
before: of sways of B2, Aliengo, A2 and Mini Cheetah, torques are off by 11, 8, 5 and 4 % after two,
and by 2.7, 1.7, 1.3 and 1.0 % after three."""


@dataclass(frozen=True, eq=False)
class SunkMotion:
    """A path on soft ground, at the path's samples.

    Attributes:
        qpos: (n, nq) the base where the path has it, the legs longer by what feet sink.
        qvel: (n, nv) its generalised velocities.
        qacc: (n, nv) its generalised accelerations.
        forces: (n, feet, 3) of the ground on each foot, in world axes (N).
        torques: (n, nu) of the motors (N m).
    """

    qpos: Array
    qvel: Array
    qacc: Array
    forces: Array
    torques: Array


def find_sunk_motion(robot: Robot, path: StancePath) -> SunkMotion:
    """Returns a path with the feet where soft ground has them: sunk, rolled and crept.

    The base stays, and legs get longer. (The com moves with them, by a hundredth of the depths.)
    The depths are those under the forces in motion, which the ground follows with a delay
    (``depths_of``; in a pyramidal cone ``sink_in_pyramid``). Feet sink and rise by millimetres
    within hundredths of a second: that moves legs as fast as the path does, so that inertia,
    dampers, dry friction, and how feet roll are
    those of both motions; and the ground does not bear what sinks with a foot (``_moved_masses``).
    MuJoCo has the contact half way down, so that a foot that rolls, rolls on a radius that is
    shorter by half its depth: by a tenth for v3. And a foot that is pushed as it rolls creeps
    (``integrate_creep``).

    Args:
        robot: The robot.
        path: Its path, which is for rigid ground.
    """
    normal = path.stances[0].task.ground.normal()
    laws = [GroundLaw.of(robot, foot) for foot in path.feet]
    masses = _moved_masses(robot, path, normal)
    stills = [Configuration(robot, qpos) for qpos in path.qpos]
    centres = np.array([config.foot_places(path.feet) for config in stills])
    carrying = path.stance_feet[1:] & path.stance_feet[:-1]
    radius = np.array([robot.contact_radius[foot] for foot in path.feet])
    rolled = _rolled(stills, path.feet, normal, carrying * radius)
    found = SunkMotion(path.qpos, path.qvel, path.qacc, path.forces, path.torques)
    own = path.forces @ normal
    borne, forces = own, path.forces
    rounds = (
        _IN_PYRAMIDS
        if any(is_pyramid(robot, foot) for foot in path.feet)
        else _FIXED_POINT_ITERATIONS
    )
    for _ in range(rounds):
        depths, sinking, crept = _sunk(robot, path, laws, found, forces, borne, masses)
        # A sole's corners do not roll.
        shorter = np.where(radius > 0, radius - (depths[1:] + depths[:-1]) / 4, 0.0)
        configs = [Configuration(robot, qpos) for qpos in found.qpos]
        goals = centres - depths[..., None] * normal + crept
        goals += _rolled(configs, path.feet, normal, carrying * shorter) - rolled
        rows = zip(found.qpos, goals, strict=True)
        qpos = np.array([_reaching(robot, row, path.feet, places) for row, places in rows])
        found = _balanced(robot, path, qpos, forces, depths)
        pressing = np.maximum(found.forces @ normal, 0.0)
        borne = pressing + masses * sinking
        # A foot that carries less than on rigid ground uses no more of its friction.
        share = np.divide(pressing, own, out=np.ones_like(own), where=own > 0)
        forces = share[..., None] * path.forces
    return found


def _sunk(
    robot: Robot,
    path: StancePath,
    laws: Sequence[GroundLaw],
    motion: SunkMotion,
    kept: Array,
    borne: Array,
    masses: Array,
) -> tuple[Array, Array, Array]:
    """Returns depths (n, feet) (m), their second derivatives, and creep (n, feet, 3) (m).

    Args:
        robot: The robot.
        path: Its path.
        laws: The ground under each foot.
        motion: Nearly what is sought: its velocities and forces count.
        kept: (n, feet, 3) forces of which feet in round cones use no more than on rigid ground (N).
        borne: (n, feet) what the robot takes of each along the normal if it does not sink (N).
        masses: (n, feet) what sinks with it (kg).
    """
    depths, sinking = np.zeros_like(borne), np.zeros_like(borne)
    forces, qvel = motion.forces, motion.qvel
    crept = integrate_creep(robot, path, qvel, kept)
    frame = contact_frame(path.stances[0].task.ground.normal())
    pyramids = [is_pyramid(robot, foot) for foot in path.feet]
    configs = [Configuration(robot, qpos) for qpos in path.qpos] if any(pyramids) else []
    for column, (foot, law) in enumerate(zip(path.feet, laws, strict=True)):
        if not pyramids[column]:
            loads = borne[:, column], masses[:, column]
            depths[:, column], sinking[:, column] = depths_of(law, path.time, *loads)
            continue
        name, rows = robot.contact_frames[foot], zip(configs, qvel, strict=True)
        turning = np.array([one.frame_jacobian(name)[3:] @ rates for one, rates in rows])
        given = np.column_stack([forces[:, column] @ frame.T, turning @ frame.T])
        given[:, 0] = borne[:, column]
        depths[:, column], sinking[:, column], along = sink_in_pyramid(
            law, robot.contacts[foot], path.time, given, masses[:, column]
        )
        crept[:, column] = along @ frame[1:]
    return depths, sinking, crept


def _balanced(
    robot: Robot, path: StancePath, qpos: Array, forces: Array, depths: Array
) -> SunkMotion:
    """Returns the motion through configurations (n, nq), and what ground and motors give for it.

    Args:
        robot: The robot.
        path: The path that it is of.
        qpos: (n, nq) the configurations.
        forces: (n, feet, 3) nearly those of the ground; each foot adds to it in proportion (N).
        depths: (n, feet) m.
    """
    from scipy.interpolate import CubicSpline  # slow to import

    joints, dofs = slice(robot.nq - robot.nu, None), slice(robot.nv - robot.nu, None)
    longer = CubicSpline(path.time, (qpos - path.qpos)[:, joints], bc_type=AT_REST)
    qvel, qacc = path.qvel.copy(), path.qacc.copy()
    qvel[:, dofs] += longer(path.time, 1)
    qacc[:, dofs] += longer(path.time, 2)
    normal = path.stances[0].task.ground.normal()
    radius = np.array([robot.contact_radius[foot] for foot in path.feet])
    given, torques = [], []
    for index, own in enumerate(forces):
        config = Configuration(robot, qpos[index], qvel[index])
        contacts = config.point_jacobians(
            path.feet, -(radius - depths[index] / 2)[:, None] * normal
        )
        load = config.mass_matrix() @ qacc[index] + config.bias_forces() - config.passive()
        load += joint_resistance(robot, qvel[index], qacc[index])
        rows = zip(path.feet, own, path.stance_feet[index], strict=True)
        pressed = {foot: force for foot, force, carries in rows if carries}
        load -= rolling_resistance(config, qacc[index], pressed, normal)
        load -= np.einsum("nij,ni->j", contacts, own)
        pressing = np.maximum(own @ normal, 0.0)[:, None]
        jacobian = (pressing[..., None] * contacts).reshape(-1, robot.nv)
        more = np.linalg.lstsq(jacobian[:, :6].T, load[:6], rcond=1e-9)[0]
        given.append(own + pressing * more.reshape(-1, 3))
        torques.append(config.by_motors(load - more @ jacobian)[dofs])
    return SunkMotion(qpos, qvel, qacc, np.array(given), np.array(torques))


def _reaching(robot: Robot, qpos: Array, feet: Sequence[str], places: Array) -> Array:
    """Returns a configuration (nq,) whose legs have the feet's centres at places (n, 3)."""
    found = qpos.copy()
    for _ in range(_STEPS):
        config = Configuration(robot, found)
        missing = (places - config.foot_places(feet)).ravel()
        jacobians = config.foot_jacobians()
        jacobian = np.concatenate([jacobians[foot][:, 6:] for foot in feet])
        found[7:] += np.linalg.lstsq(jacobian, missing, rcond=1e-6)[0]
    return found


def _rolled(
    configs: Sequence[Configuration], feet: Sequence[str], normal: Array, radius: Array
) -> Array:
    """Returns how far spheres roll without slipping (n, feet, 3) (m), on radii (n - 1, feet)."""
    from scipy.spatial.transform import Rotation  # slow to import

    rotations = np.array([config.foot_rotations(feet) for config in configs])
    turns = rotations[1:] @ np.swapaxes(rotations[:-1], -1, -2)
    turned = Rotation.from_matrix(turns.reshape(-1, 3, 3)).as_rotvec().reshape(*radius.shape, 3)
    steps = np.cross(turned, radius[..., None] * normal)
    return np.concatenate([np.zeros((1, *steps.shape[1:])), np.cumsum(steps, axis=0)])


def _moved_masses(robot: Robot, path: StancePath, normal: Array) -> Array:
    """Returns what moves of the robot's mass with each foot (n, feet) (kg).

    It is the robot's momentum along the normal if one foot moves along it at 1 m/s, while the base
    and the other feet stay: the ground need not bear what a leg takes that falls with its foot.
    """
    rows = []
    for qpos in path.qpos:
        config = Configuration(robot, qpos)
        jacobian = np.concatenate([config.foot_jacobians()[foot][:, 6:] for foot in path.feet])
        along = np.kron(np.eye(len(path.feet)), normal[:, None])
        rates = np.linalg.lstsq(jacobian, along, rcond=1e-6)[0]
        rows.append(normal @ config.mass_matrix()[:3, 6:] @ rates)
    return np.array(rows)


def depths_of(law: GroundLaw, time: Array, forces: Array, masses: Array) -> Array:
    """Returns how a foot sinks (2, n) under a normal force: depth (m), and acceleration (m/s^2).

    MuJoCo's contact gives R f = k d(r) r + b dr/dt + d2r/dt2, with R = (1 - d)/d A: critically
    damped as a rule, so that the depth lags behind the force, with a time constant of
    solref[0] (20 ms). It begins at rest. A foot that would have to pull is out of the ground.
    Of the force, the mass that sinks with the foot takes its part, f - m d2r/dt2.

    Args:
        law: The ground under it.
        time: (n,) s.
        forces: (n,) what the robot takes of the foot if it does not sink (N).
        masses: (n,) what sinks with it (kg).
    """
    from scipy.interpolate import CubicSpline  # slow to import

    # An eighth of the faster of the law's own times: the classical Runge-Kutta method's error is
    # then below 1e-5 of the depth.
    own = 1 / max(law.damping, math.sqrt(law.stiffness), 1e-3)
    counts = np.maximum(1, np.ceil(np.diff(time) / (own / 8))).astype(int)
    pressed = CubicSpline(time, np.maximum(forces, 0.0))

    def change(depth: float, rate: float, force: float) -> tuple[float, float]:
        d = law.impedance(depth)
        softness = (1 - d) / d * law.normal
        deep = depth + law.margin
        pushed = softness * force - law.damping * rate - law.stiffness * d * deep
        return rate, pushed / (1 + softness * mass)

    depth, rate = law.depth(max(0.0, float(forces[0]))), 0.0
    found = [(depth, 0.0)]
    for number, (start, end, count) in enumerate(zip(time[:-1], time[1:], counts, strict=True)):
        step = float(end - start) / count
        mass = float(masses[number])
        half_steps = np.maximum(pressed(np.linspace(start, end, 2 * count + 1)), 0.0).tolist()
        for index in range(count):
            one, two, three = half_steps[2 * index : 2 * index + 3]
            v1, a1 = change(depth, rate, one)
            v2, a2 = change(depth + step / 2 * v1, rate + step / 2 * a1, two)
            v3, a3 = change(depth + step / 2 * v2, rate + step / 2 * a2, two)
            v4, a4 = change(depth + step * v3, rate + step * a3, three)
            depth = depth + step / 6 * (v1 + 2 * v2 + 2 * v3 + v4)
            rate = rate + step / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
        found.append((depth, change(depth, rate, half_steps[-1])[1]))
    return np.array(found).T
