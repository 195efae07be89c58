"""How far a standing robot sags: the equilibrium of its servos on soft ground, not simulated."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray
from scipy import linalg

from pupper_analysis import contact
from pupper_analysis.configuration import UP, Configuration
from pupper_analysis.errors import ConfigurationError, NoEquilibriumError
from pupper_analysis.ground import GroundLaw
from pupper_analysis.results import Result
from pupper_analysis.robot import Robot, on_ground
from pupper_analysis.simulation import drop_at, servos
from pupper_analysis.stand import Stand, stand_statics
from pupper_analysis.statics import LoadSharing

Array = NDArray[np.float64]
Feet = Literal["pinned", "sliding"]

RESIDUAL_TOLERANCE = 1e-10
"""What the equations of an equilibrium may leave over (N, N m, m)."""

RELEASE_MARGIN = 0.06
"""A ``release_margin`` that keeps the feet in place: what contacts add to the first order."""

_MAX_ITERATIONS = 15
_TRUST = 0.5  # rad, m: a longer Newton step has left the branch
_LEAST_SHARE = 1 / 64  # of the feed-forward that is taken away in one step
_STEP = 1e-6  # rad, m: of the numeric derivatives
_CREEP_STEPS = 20
_WEAK = 1e-3  # N/m: holds a sliding robot in its place as creep does, with 1e-5 N


@dataclass(frozen=True, eq=False)
class SettledPose(Result):
    """The static equilibrium of a servo-driven robot on its feet.

    Attributes:
        feet: What the feet do: ``pinned`` or ``sliding``.
        qpos: (nq,) the configuration.
        base_height: m.
        height_loss: Stand's height less this one (m); the sum of the next two.
        servo_sag: The part lost in the joints (m).
        contact_sag: The part lost in the softness of feet and ground (m).
        joint_torques: (nu,) of the motors (N m).
        saturated: The joints whose servo is at its force limit.
        contact_forces: {foot: (3,)} of the ground on the foot, in world axes (N).
        foot_creep: {foot: speed} at which MuJoCo's friction lets a pinned foot creep (m/s).
        height_drift: The rate of the base's height that comes of it (m/s). A simulated height is
            the predicted one within D for about D / |height_drift| seconds.
        iterations: Newton steps, on all of the way from the stand.
        residual: The largest element left of the equations (N, N m, m).
        residuals: The same after each step of the last Newton iteration.
        stiffness: The least eigenvalue of the energy's Hessian on the null space of what the feet
            hold, relative to the mass matrix (rad^2/s^2): the square of the lowest natural
            frequency without damping.
        stable: Whether it is positive.
        release_margin: What friction has left, at the foot that has the least, in parts of the
            weight, as the robot overshoots when its feed-forward is taken away at once: it is then
            twice as far from the stand as the equilibrium, to first order. Below
            ``RELEASE_MARGIN`` a foot may slip or lift in that fall, and the robot comes to rest
            elsewhere, by up to millimetres; let down slowly it does not.
        failures: Why the robot will not stand so; empty if it will.
    """

    feet: Feet
    qpos: Array
    base_height: float
    height_loss: float
    servo_sag: float
    contact_sag: float
    joint_torques: Array
    saturated: tuple[str, ...]
    contact_forces: dict[str, Array]
    foot_creep: dict[str, float]
    height_drift: float
    iterations: int
    residual: float
    residuals: tuple[float, ...]
    stiffness: float
    stable: bool
    release_margin: float
    failures: tuple[str, ...]


def settled_pose(
    robot: Robot,
    stand: Stand,
    *,
    kp: ArrayLike | None = None,
    feedforward: bool = False,
    feet: Feet = "pinned",
    seconds: float = 0.0,
) -> SettledPose:
    """Predicts where position servos let a standing robot sag to.

    The equilibrium of tau = clip(kp (ctrl - q), +- limit), gravity, and feet on the soft ground:

        g(q) - S^T tau - sum J_i(q)^T f_i = 0,  depth_i(f_i) = r_i - z_i(q)

    J_i is the Jacobian of the material point at the contact. Pinned, that point stays (the foot
    rolls on it), or creeps with -f_t / c as MuJoCo's friction has it, if ``seconds`` are given;
    sliding, its tangential force is zero. Newton's iteration follows the equilibrium from the stand
    itself, which full feed-forward holds, while feed-forward is taken away; then backward Euler
    steps follow the creep.

    Args:
        robot: The robot.
        stand: How it shall stand.
        kp: Servo stiffness (N m/rad), one or (nu,); the model's own by default.
        feedforward: Command ctrl = q* + tau / kp instead of ctrl = q*.
        feet: ``pinned``: friction holds, as rubber's does for good and MuJoCo's for seconds.
            ``sliding``: no tangential force is left, where MuJoCo's creeping feet end.
        seconds: How long pinned feet have crept (s).

    Returns:
        The equilibrium; ``failures`` says why the robot will not stand so.

    Raises:
        ConfigurationError: If an argument is out of its range, or the robot cannot stand.
        ModelError: If the model has no servos and no kp is given.
        StaticsInfeasibleError: If no contact forces balance the stand itself.
        NoEquilibriumError: If there is no equilibrium that continues the stand.
    """
    if not robot.floating or not robot.contacts or stand.qpos.shape != (robot.nq,):
        raise ConfigurationError("robot", f"{robot.name} cannot stand on its feet like that")
    if feet not in ("pinned", "sliding"):
        raise ConfigurationError("feet", f"{feet!r} is neither 'pinned' nor 'sliding'")
    if not 0 <= seconds < math.inf or (seconds and feet == "sliding"):
        raise ConfigurationError("seconds", f"{seconds} s: feet that are pinned creep for >= 0 s")
    if feet == "sliding" and stand.task.ground.slope:
        raise ConfigurationError("feet", "on a slope only friction holds a robot: they are pinned")
    robot = on_ground(robot, stand.task.ground, stand.foot_targets)
    balance = stand_statics(robot, stand, sharing=LoadSharing.EVEN)
    system = _Equilibrium(robot, stand, kp, feet)
    forces = np.array(
        [
            turn @ balance.contact_forces[foot]
            for foot, turn in zip(stand.carrying, system.frames, strict=True)
        ]
    )
    held, qpos = forces, stand.qpos.copy()
    qpos[2] -= np.mean(system.depths(forces)) - np.mean(list(stand.depths.values()))
    share, step, goal, iterations = 0.0, 1.0, 0.0 if feedforward else 1.0, 0
    while True:
        wanted = min(share + step, goal)
        system.target = stand.qpos[7:] + (1 - wanted) * balance.joint_torques / system.kp
        solution = system.solve(qpos, forces)
        if solution is not None:
            qpos, forces, residuals = solution
            iterations += len(residuals) - 1
            share = wanted
            if share == goal:
                break
        elif step > _LEAST_SHARE and goal > 0:
            step /= 2
        else:
            raise NoEquilibriumError(
                share,
                f"with {feet} feet and kp = {system.kp.min():.3g} N m/rad it ends where "
                f"{share:.0%} of the feed-forward is taken away",
            )
    margin = system.friction_left(held + 2 * (forces - held))
    for number in range(_CREEP_STEPS if seconds else 0):
        system.creep(qpos, forces, seconds / _CREEP_STEPS)
        solution = system.solve(qpos, forces)
        if solution is None:
            after = number * seconds / _CREEP_STEPS
            raise NoEquilibriumError(1.0, f"after {after:.1f} s of creep it ends")
        qpos, forces, residuals = solution
        iterations += len(residuals) - 1
    return system.result(qpos, forces, residuals, iterations, margin)


def least_kp(
    robot: Robot, stand: Stand, *, feet: Feet = "pinned", tolerance: float = 0.01
) -> float:
    """Finds the least uniform kp with which a robot stands without feed-forward, by bisection.

    It stands if ``settled_pose`` has no failures and keeps half of the stand's height.

    Args:
        robot: The robot.
        stand: How it shall stand.
        feet: What the feet do, as in ``settled_pose``.
        tolerance: Relative, of the result.

    Returns:
        kp (N m/rad), rounded up: with it the robot does stand.

    Raises:
        NoEquilibriumError: If it does not stand with any kp up to 1e4 N m/rad.
    """

    def stands(kp: float) -> bool:
        try:
            pose = settled_pose(robot, stand, kp=kp, feet=feet)
        except NoEquilibriumError:
            return False
        return not pose.failures and pose.base_height > 0.5 * float(stand.qpos[2])

    low, high = 0.0, 1.0
    while not stands(high):
        low, high = high, 2 * high
        if high > 1e4:
            raise NoEquilibriumError(0.0, f"{robot.name} does not stand with any kp")
    while high - low > tolerance * high:
        middle = (low + high) / 2
        low, high = (low, middle) if stands(middle) else (middle, high)
    return high


class _Equilibrium:
    """The equations of the equilibrium, in (qpos, forces (n, 3)), for a servo ``target`` (nu,).

    Forces, slips and depths are in the frame of each contact, whose z is the ground's normal.
    """

    def __init__(self, robot: Robot, stand: Stand, kp: ArrayLike | None, feet: Feet) -> None:
        drive = servos(robot, kp, None if kp is None else 0.0)
        actuators = robot.mj_convention.actuator_index
        limited = drive.model.actuator_forcelimited[actuators].astype(bool)
        limits = drive.model.actuator_forcerange[actuators] * drive.gear[:, None]
        self.lower = np.where(limited, limits.min(axis=1), -np.inf)
        self.upper = np.where(limited, limits.max(axis=1), np.inf)
        self.robot, self.stand, self.feet, self.kp = robot, stand, feet, drive.kp
        self.target = stand.qpos[7:]
        self.crept = np.zeros((len(stand.carrying), 2))
        self.yielding = np.zeros(len(stand.carrying))  # m/N: creep in this step per force
        self.laws = [GroundLaw.of(robot, foot) for foot in stand.carrying]
        config = Configuration(robot, stand.qpos)
        self.turned = [config.frame_rotation(robot.foot_frames[foot]) for foot in stand.carrying]
        self.frames = [
            pin.Quaternion.FromTwoVectors(stand.normals[foot], UP).matrix()
            for foot in stand.carrying
        ]

    def depths(self, forces: Array) -> Array:
        """Returns how deep the feet sink (n,) under forces (n, 3)."""
        return np.array([law.depth(f) for law, f in zip(self.laws, forces[:, 2], strict=True)])

    def torques(self, qpos: Array) -> Array:
        """Returns the servos' torques (nu,)."""
        return np.clip(self.kp * (self.target - qpos[7:]), self.lower, self.upper)

    def terms(self, qpos: Array, forces: Array) -> tuple[Array, Array, Array]:
        """Returns the balance (nv,), the feet's slip and depth (n, 3), the Jacobian (3 n, nv)."""
        config = Configuration(self.robot, qpos)
        places, jacobians = [], []
        stand = self.stand
        for foot, turned, local in zip(stand.carrying, self.turned, self.frames, strict=True):
            frame, radius = self.robot.foot_frames[foot], self.robot.foot_radius[foot]
            moved = config.frame_position(frame) - stand.foot_targets[foot]
            depth = stand.depths[foot] - float(stand.normals[foot] @ moved)
            # MuJoCo has the contact half way into the penetration.
            arm = (radius - depth / 2) * stand.normals[foot]
            jacobians.append(local @ config.frame_jacobian(frame, -arm)[:3])
            turn = pin.log3(config.frame_rotation(frame) @ turned.T)
            slip = local @ (moved - pin.skew(turn) @ arm)  # less what the sphere has rolled
            places.append((slip[0], slip[1], depth))
        jacobian = np.concatenate(jacobians)
        balance = config.gravity() - jacobian.T @ forces.ravel()
        balance[6:] -= self.torques(qpos)
        return balance, np.array(places), jacobian

    def residual(self, qpos: Array, forces: Array) -> Array:
        """Returns the equations (nv + 3 n,): balance, and per foot two of slip, one of depth."""
        balance, places, _ = self.terms(qpos, forces)
        if self.feet == "sliding":
            places[:, :2] = forces[:, :2] + _WEAK * places[:, :2]
        else:
            places[:, :2] += self.yielding[:, None] * forces[:, :2] - self.crept
        places[:, 2] -= self.depths(forces)
        return np.concatenate([balance, places.ravel()])

    def derivative(self, qpos: Array, forces: Array) -> Array:
        """Returns the residual's derivative: by qpos numeric, by forces in closed form."""
        n = self.robot.nv
        by_qpos = np.zeros((n + forces.size, n))
        for column in range(n):
            step = np.zeros(n)
            step[column] = _STEP
            ahead, behind = (self.terms(move(qpos, way), forces) for way in (step, -step))
            by_qpos[:n, column] = (ahead[0] - behind[0]) / (2 * _STEP)
            by_qpos[n:, column] = (ahead[1] - behind[1]).ravel() / (2 * _STEP)
        if self.feet == "sliding":
            by_qpos[n:].reshape(-1, 3, n)[:, :2] *= _WEAK
        *_, jacobian = self.terms(qpos, forces)
        by_force = np.zeros((len(forces), 3))
        by_force[:, :2] = 1.0 if self.feet == "sliding" else self.yielding[:, None]
        depths = self.depths(forces)
        by_force[:, 2] = [-1 / law.rate(d) for law, d in zip(self.laws, depths, strict=True)]
        return np.hstack([by_qpos, np.vstack([-jacobian.T, np.diag(by_force.ravel())])])

    def solve(self, qpos: Array, forces: Array) -> tuple[Array, Array, tuple[float, ...]] | None:
        """Newton's iteration: the solution and the residuals on the way, or None if it fails."""
        residuals: list[float] = []
        for _ in range(_MAX_ITERATIONS):
            residual = self.residual(qpos, forces)
            residuals.append(float(np.abs(residual).max()))
            if residuals[-1] < RESIDUAL_TOLERANCE:
                return qpos, forces, tuple(residuals)
            try:
                step = np.array(np.linalg.solve(self.derivative(qpos, forces), -residual), float)
            except np.linalg.LinAlgError:
                return None
            n = self.robot.nv
            if not np.abs(step[:n]).max() < _TRUST:
                return None
            qpos, forces = move(qpos, step[:n]), forces + step[n:].reshape(-1, 3)
        return None

    def creep(self, qpos: Array, forces: Array, seconds: float) -> None:
        """Begins a step of creep, with the viscosities of where it begins."""
        _, places, _ = self.terms(qpos, forces)
        self.crept = places[:, :2]
        self.yielding = seconds / self.viscosities(places[:, 2])

    def viscosities(self, depths: Array) -> Array:
        """Returns tangential force per velocity (n,) (N s/m); infinite where a foot pulls."""
        return np.array(
            [
                law.viscosity(depth) if depth > 0 else math.inf
                for law, depth in zip(self.laws, depths, strict=True)
            ]
        )

    def friction_left(self, forces: Array) -> float:
        """Returns the least of mu f_n - |f_t|, in parts of the weight."""
        contacts = self.robot.contacts
        friction = [contacts[foot].sliding_friction for foot in self.stand.carrying]
        left = friction * forces[:, 2] - np.linalg.norm(forces[:, :2], axis=1)
        return float(left.min() / (self.robot.total_mass * np.linalg.norm(self.robot.gravity)))

    def stiffness(self, qpos: Array, forces: Array, derivative: Array) -> float:
        """Returns the least eigenvalue of the Hessian where the feet allow it to move."""
        config, n = Configuration(self.robot, qpos), self.robot.nv
        _, places, jacobian = self.terms(qpos, forces)
        normal = jacobian[2::3]
        rates = np.array([law.rate(d) for law, d in zip(self.laws, places[:, 2], strict=True)])
        hessian = derivative[:n, :n] + normal.T @ (rates[:, None] * normal)
        held = np.delete(jacobian, np.s_[2::3], axis=0)
        if self.feet == "sliding":  # as a whole it may be anywhere, turned anyhow about z
            held = np.eye(3, n)
            held[2] = np.concatenate([np.zeros(3), config.base_rotation()[2], np.zeros(n - 6)])
        free = linalg.null_space(held)
        reduced = free.T @ hessian @ free, free.T @ config.mass_matrix() @ free
        return float(linalg.eigvals(*reduced).real.min())

    def result(
        self,
        qpos: Array,
        forces: Array,
        residuals: tuple[float, ...],
        iterations: int,
        margin: float,
    ) -> SettledPose:
        """Looks at a solution from all sides."""
        robot, stand = self.robot, self.stand
        _, places, _ = self.terms(qpos, forces)
        derivative = self.derivative(qpos, forces)
        stiffness = self.stiffness(qpos, forces, derivative)
        creep, flow = np.zeros((len(forces), 2)), np.zeros(len(derivative))
        if self.feet == "pinned":
            with np.errstate(divide="ignore"):
                creep = -forces[:, :2] / self.viscosities(places[:, 2])[:, None]
            flow[robot.nv :].reshape(-1, 3)[:, :2] = creep
        targets = np.array([stand.foot_targets[foot] for foot in stand.carrying])
        centres = Configuration(robot, qpos).foot_positions()
        reached = np.array([centres[foot] for foot in stand.carrying])
        loss = float(stand.qpos[2] - qpos[2])
        contact_sag = drop_at(stand.qpos[:2], targets, (targets - reached)[:, 2])
        torques = self.torques(qpos)
        names = np.array(robot.joint_names)
        per_foot = dict(zip(stand.carrying, forces, strict=True))
        return SettledPose(
            feet=self.feet,
            qpos=qpos,
            base_height=float(qpos[2]),
            height_loss=loss,
            servo_sag=loss - contact_sag,
            contact_sag=contact_sag,
            joint_torques=torques,
            saturated=tuple(names[(torques <= self.lower) | (torques >= self.upper)].tolist()),
            contact_forces={
                foot: turn.T @ force
                for (foot, force), turn in zip(per_foot.items(), self.frames, strict=True)
            },
            foot_creep=dict(
                zip(stand.carrying, np.linalg.norm(creep, axis=1).tolist(), strict=True)
            ),
            height_drift=float(np.linalg.solve(derivative, flow)[2]),
            iterations=iterations,
            residual=residuals[-1],
            residuals=residuals,
            stiffness=stiffness,
            stable=stiffness > 0,
            release_margin=margin,
            failures=_failures(robot, qpos, per_foot, stiffness),
        )


def _failures(
    robot: Robot, qpos: Array, forces: dict[str, Array], stiffness: float
) -> tuple[str, ...]:
    failures = [] if stiffness > 0 else [f"the equilibrium is not stable ({stiffness:.3g} 1/s^2)"]
    for foot, force in forces.items():
        if force[2] <= 0:
            failures.append(f"foot {foot} would have to pull with {-force[2]:.2f} N")
        elif np.linalg.norm(force[:2]) > robot.contacts[foot].sliding_friction * force[2]:
            failures.append(f"foot {foot} slides")
    beyond = (qpos[7:] < robot.lower_limits) | (qpos[7:] > robot.upper_limits)
    failures += [f"joint {robot.joint_names[i]} is at its limit" for i in np.flatnonzero(beyond)]
    data = mujoco.MjData(robot.mj_model)
    robot.mj_convention.set_state(data, qpos)
    mujoco.mj_forward(robot.mj_model, data)
    _, others = contact.ground_forces(robot.mj_model, data, robot.soles)
    return (*failures, *(f"{body} touches the ground" for body in sorted(others)))


def move(qpos: Array, step: Array) -> Array:
    """Returns the qpos (nq,) after a step (nv,) in the directions of qvel."""
    w, x, y, z = qpos[3:7]
    x, y, z, w = (pin.Quaternion(w, x, y, z) * pin.Quaternion(pin.exp3(step[3:6]))).coeffs()
    moved: Array = np.concatenate([qpos[:3] + step[:3], (w, x, y, z), qpos[7:] + step[6:]])
    return moved
