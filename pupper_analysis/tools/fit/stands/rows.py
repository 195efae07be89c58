"""Equations of one stand at rest, linearised: balance, contact with the ground, what was read."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.base.arrays import cross_matrices
from pupper_analysis.robot.compliance import GroundLaw
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.fit.measurements.stands import MeasuredStands
from pupper_analysis.tools.fit.parameters import AXES, KINDS, ParameterTable

Array = NDArray[np.float64]

_TURNS_AND_HEIGHT = [3, 4, 2]
"""Of qvel: turns about the base's own x and y, and how high it is. What a stand at rest leaves of
the base's motion: where it stands, and where it looks to, nothing of it shows."""

_BALANCE = 1e-5
"""Of the weight, and of the weight times the height: standard deviation of what balances the base.
A robot at rest obeys statics; the number is so small that it hides nothing, and lets the base's
rows, which no measurement's noise reaches, be weighed."""

_LINEAR = 1e-4
"""Of a weight times a height: standard deviation of a servo's torque from kp times its error. A
joint of a leg carries a tenth of that product: it is a thousandth of what it carries."""

_UNKNOWN = 1e3
"""Likewise, of the torque of a motor whose command is not known: what it says is nothing."""

_MOBILISED = 0.35
"""Of dry friction: standard deviation of how much of it holds a joint that came slowly from a known
side: 0.3 to 0.4, simulated in MuJoCo of v3 and Go2. (One that came from nowhere: 0.58.)"""


@dataclass(frozen=True)
class StandNoise:
    """What measurements of a stand are off by, as standard deviations.

    Attributes:
        encoder: Of a joint position (rad).
        moment: Of the moment on a contact point, about each axis, in parts of the force on it (m):
            a foot that turns on the ground, or rolls, keeps some of what stopped it.
        flatness: Of the ground's height under a foot, and of the links' lengths (m).
        friction: Factor on the stated dry friction of joints, of which nobody knows where in its
            band a joint came to rest.
        torque: Of a measured torque, in parts of the motor's limit.
        force: Of a force under a foot (N).
        tilt: Of an IMU's roll and pitch (rad).
    """

    encoder: float
    moment: float = KINDS["moment"].width
    flatness: float = 3e-4
    friction: float = 1.0
    torque: float = 0.02
    force: float = 0.1
    tilt: float = math.radians(0.2)


@dataclass(frozen=True, eq=False)
class Reading:
    """What was measured of one stand; NaN is not measured. See ``MeasuredStands``.

    Attributes:
        command: (nu,) rad.
        position: (nu,) rad.
        torque: (nu,) N m.
        force: {foot: N}.
        tilt: (2,) rad.
        points: The contact points that carry.
        sides: (nu,) how much of its dry friction holds each joint, on average: 0 if nobody knows.
    """

    command: Array
    position: Array
    torque: Array
    force: dict[str, float]
    tilt: Array
    points: tuple[str, ...]
    sides: Array


def readings_of(robot: Robot, stands: MeasuredStands) -> Iterator[Reading]:
    """Yields what was measured of each stand."""
    for row in range(len(stands)):
        yield Reading(
            command=stands.command[row],
            position=stands.position[row],
            torque=stands.torque[row],
            force={foot: float(weighed[row]) for foot, weighed in stands.force.items()},
            tilt=stands.tilt[row],
            points=tuple(
                point
                for foot, points in robot.feet.items()
                if foot not in stands.swing[row]
                for point in points
            ),
            sides=np.zeros(robot.nu),
        )


@dataclass(eq=False)
class Rows:
    """Residuals r, their derivatives by parameters x and own unknowns y, and by sources of noise.

    Attributes:
        sizes: How many parameters and own unknowns there are.
        sources: Standard deviations of noise that acts on several rows: of encoders (nu,), then of
            the moments on contact points (three each).
        parts: (r, by x, by y, by noise, other standard deviations) of groups of rows.
    """

    sizes: tuple[int, int]
    sources: Array
    parts: list[tuple[Array, ...]] = field(default_factory=list)

    def add(self, residual: Array, deviation: Array) -> tuple[Array, Array, Array]:
        """Adds rows (k,); returns their derivatives (k, ...), zero, to be filled in."""
        by_x, by_own, by_noise = (
            np.zeros((len(residual), size)) for size in (*self.sizes, len(self.sources))
        )
        self.parts.append((residual, by_x, by_own, by_noise, deviation))
        return by_x, by_own, by_noise

    def whiten(self) -> tuple[Array, Array, Array, float]:
        """Returns r, and its derivatives by x and y, of combinations with noise of variance 1.

        And the logarithm of the determinant of the noise's covariance.
        """
        residual, by_x, by_own, by_noise, deviation = (
            np.concatenate(part) for part in zip(*self.parts, strict=True)
        )
        covariance = self.sources**2 * by_noise @ by_noise.T + np.diag(deviation**2)
        factor = np.linalg.cholesky(covariance)
        white = np.linalg.solve(factor, np.column_stack([residual, by_x, by_own]))
        n = by_x.shape[1]
        log_noise = 2 * float(np.log(np.diag(factor)).sum())
        return white[:, 0], white[:, 1 : 1 + n], white[:, 1 + n :], log_noise

    def left(self, rows: slice) -> tuple[Array, Array]:
        """Returns residuals of some rows at the best own unknowns, and what noise makes of them.

        As standard deviations: of the noise less the part of it that own unknowns take up.
        """
        residual, _, by_own, by_noise, deviation = (
            np.concatenate(part) for part in zip(*self.parts, strict=True)
        )
        covariance = self.sources**2 * by_noise @ by_noise.T + np.diag(deviation**2)
        weighted = np.linalg.solve(covariance, by_own)
        taken = by_own @ np.linalg.pinv(by_own.T @ weighted, rcond=_RANK, hermitian=True) @ by_own.T
        return residual[rows], np.sqrt(np.maximum(np.diag(covariance - taken)[rows], 0.0))


_RANK = 1e-12
"""Of the largest eigenvalue: directions of own unknowns that no row tells of."""


class StandRows:
    """The rows of one stand, at parameters and at own unknowns.

    Own unknowns are the turns of the base about its own x and y, its height, and three components
    of the force on each contact point, in the ground's axes.

    Args:
        table: The parameters.
        numbers: What they say.
        reading: What was measured.
        laws: {contact point: how far it sinks}.
        base: (5,) the base's quaternion (w, x, y, z) and height (m).
        forces: (p, 3) on the contact points (N).
        noise: Of the measurements.
        regressor: For gravity.

    Attributes:
        config: The configuration.
        jacobians: (p, 3, nv) of the contact points.
        kp: (nu,) of the servos (N m/rad).
        rows: The rows.
        tilt: (2,) roll and pitch, as the IMU should show them (rad).
    """

    def __init__(
        self,
        table: ParameterTable,
        numbers: Numbers,
        reading: Reading,
        laws: dict[str, GroundLaw],
        base: Array,
        forces: Array,
        noise: StandNoise,
        regressor: GravityRegressor,
    ) -> None:
        self._table, self._numbers, self._reading = table, numbers, reading
        self._forces, self._noise, self._regressor = forces, noise, regressor
        robot, points = numbers.robot, reading.points
        self.kp = numbers.kp
        self._robot, self._names = robot, robot.joint_names
        qpos = robot.posed(reading.position - numbers.offset)
        qpos[2], qpos[3:7] = base[4], base[:4]
        self.config = Configuration(robot, qpos)
        self._feet = [robot.foot_of(point) for point in points]
        # Points of a sole sink as on average, and linearly about that: each by its own law they
        # would leave the ground and come back from step to step, and no fit would end.
        feet = np.array(self._feet)
        mean = np.array([forces[feet == foot, 2].mean() for foot in feet])
        level = [laws[p].depth(f) for p, f in zip(points, mean.tolist(), strict=True)]
        self._rates = np.array([laws[p].rate(d) for p, d in zip(points, level, strict=True)])
        self._deep = np.array(level) + (forces[:, 2] - mean) / self._rates
        self._softness = np.array([numbers.softness[foot] for foot in self._feet])
        self._radius = np.array([robot.contact_radius[point] for point in points])
        self._arms = np.zeros((len(points), 3))
        # MuJoCo has a contact half way into what the foot sinks.
        self._arms[:, 2] = self._softness * self._deep / 2 - self._radius
        self._twists = self.config.foot_twists(points)
        linear, turning = self._twists[:, :3], self._twists[:, 3:]
        self.jacobians = linear - cross_matrices(self._arms) @ turning
        known = np.isfinite(reading.command)
        self._lead = np.where(known, reading.command - reading.position, 0.0)
        self._stiff = np.where(known, numbers.stiff, 0.0)
        self._known = known
        self._measured = np.isfinite(reading.torque)
        self._scale = robot.total_mass * float(np.linalg.norm(robot.gravity))
        limits = robot.effort_limits
        full = np.where(np.isfinite(limits), limits, self._scale * robot.stand_height)
        self._sensor = noise.torque * full
        pressed = np.maximum(forces[:, 2], 0.0)
        sources = np.append([noise.encoder] * robot.nu, noise.moment * np.repeat(pressed, 3))
        self.rows = Rows((len(table), 3 + 3 * len(points)), sources)
        self._balance()
        self._contact()
        self._torques()
        self._weighed()
        self._tilt()

    def _at(self, kind: str, subject: str, component: str = "") -> list[int]:
        place = self._table.place(kind, subject, component)
        return [] if place is None else [place]

    def _balance(self) -> None:
        """S tau - g + passive + sum J_p^T f_p = 0."""
        numbers, nv = self._numbers, self._robot.nv
        moments = np.array([numbers.moment[foot] for foot in self._feet])
        kept = self._forces[:, 2:] * moments
        wrenches = np.hstack([self._forces, np.cross(self._arms, self._forces) + kept])
        stiffness = self.config.pushed_rates(self._twists, wrenches)
        gravity, by_mass, by_com, by_slope = self._regressor.at(self.config, numbers)
        sides = self._reading.sides
        by_sensor = self._measured & ~self._known
        torque = numbers.kp * self._lead + np.where(by_sensor, self._reading.torque, 0.0)
        residual = self.config.passive() - gravity
        residual += np.einsum("pij,pi->j", self.jacobians, self._forces)
        residual[6:] += torque + sides * numbers.friction
        residual += np.einsum("pij,pi->j", self._twists[:, 3:], kept)
        by_x, by_own, by_noise = self.rows.add(residual, self._unsure(sides, by_sensor))
        by_own[:, :3] = -stiffness[:, _TURNS_AND_HEIGHT]
        by_own[:, 3:] = self.jacobians.reshape(-1, nv).T
        # What a foot sinks further brings its contact nearer to its centre by half of that.
        nearer = np.cross([0.0, 0.0, 0.5], self._forces)
        moved = np.einsum("pij,pi->pj", self._twists[:, 3:], nearer)
        for point, foot in enumerate(self._feet):
            by_own[:, 3 + 3 * point + 2] += (
                self._softness[point] / self._rates[point] * moved[point]
            )
            for at in self._at("softness", foot):
                by_x[:, at] += self._deep[point] * moved[point]
            for axis, name in enumerate(AXES):
                for at in self._at("moment", foot, name):
                    by_x[:, at] += self._forces[point, 2] * self._twists[point, 3 + axis]
            by_own[:, 3 + 3 * point + 2] += moments[point] @ self._twists[point, 3:]
        # A true position is the measured one less offset and noise; a servo's torque follows the
        # true one.
        nu = self._robot.nu
        by_noise[6:, :nu] += np.diag(self.kp * self._known)
        by_noise[:, :nu] += stiffness[:, 6:]
        by_noise[:, nu:] = self._twists[:, 3:].reshape(-1, nv).T
        for joint, name in enumerate(self._names):
            row = 6 + joint
            for at in self._at("offset", name):
                by_x[:, at] += stiffness[:, row]
            for at in self._at("kp", name):
                by_x[row, at] += self._lead[joint]
            for at in self._at("friction", name):
                by_x[row, at] += sides[joint]
        for body, (link, *_) in enumerate(numbers.bodies):
            for at in self._at("mass", link):
                by_x[:, at] -= by_mass[body]
            for axis, name in enumerate(AXES):
                for at in self._at("com", link, name):
                    by_x[:, at] -= by_com[body][:, axis]
        for name, pull in zip("xy", by_slope, strict=True):
            for at in self._at("slope", "floor", name):
                by_x[:, at] -= pull
        self._in_positions(residual, by_x, by_own, by_noise)

    def _in_positions(self, residual: Array, by_x: Array, by_own: Array, by_noise: Array) -> None:
        """Takes motors' rows to what a position is off by, times the kp at which noise is taken.

        And the base's likewise to parts of the robot's weight. It is positions that are measured.
        By torques and forces, masses and kp that are all too small would fit best: what is off
        would be small with them, and noise is not.
        """
        numbers = self._numbers
        driven = self._known & (numbers.kp > 0)
        kp = np.where(driven, numbers.kp, 1.0)
        share = np.full(len(residual), numbers.heaviness / numbers.mass)
        share[6:] = np.where(driven, self._stiff / kp, 1.0)
        for joint, name in enumerate(self._names):
            for at in self._at("kp", name) if driven[joint] else []:
                by_x[6 + joint, at] -= residual[6 + joint] / kp[joint]
        for link, *_ in numbers.bodies:
            for at in self._at("mass", link):
                by_x[:6, at] -= residual[:6] / numbers.mass
        for rows in (residual, by_x.T, by_own.T, by_noise.T):
            rows *= share

    def _unsure(self, sides: Array, by_sensor: NDArray[np.bool_]) -> Array:
        """Returns the standard deviations (nv,) of balance, but for what encoders' noise does."""
        robot = self._robot
        length, rubbing = robot.stand_height, self._noise.friction * self._numbers.rubbing
        spread = np.where(sides == 0, rubbing / math.sqrt(3.0), _MOBILISED * rubbing)
        sensor = np.where(by_sensor, self._sensor, 0.0)
        torque = np.sqrt((_LINEAR * self._scale * length) ** 2 + spread**2 + sensor**2)
        known = self._known | by_sensor
        torque = np.where(known, torque, _UNKNOWN * self._scale * length)
        base = _BALANCE * self._scale * np.array([1.0, 1.0, 1.0, length, length, length])
        return np.concatenate([base, torque])

    def _contact(self) -> None:
        """z_p - r_p + softness depth(f_p) = 0."""
        points = self._reading.points
        heights = self._twists[:, 2]
        residual = self.config.foot_places(points)[:, 2] - self._radius
        residual += self._softness * self._deep
        flatness = np.full(len(points), self._noise.flatness)
        by_x, by_own, by_noise = self.rows.add(residual, flatness)
        by_own[:, :3] = heights[:, _TURNS_AND_HEIGHT]
        by_noise[:, : self._robot.nu] -= heights[:, 6:]
        for joint, name in enumerate(self._names):
            for at in self._at("offset", name):
                by_x[:, at] -= heights[:, 6 + joint]
        for point, foot in enumerate(self._feet):
            by_own[point, 3 + 3 * point + 2] += self._softness[point] / self._rates[point]
            for at in self._at("softness", foot):
                by_x[point, at] += self._deep[point]

    def _torques(self) -> None:
        """Tau = measured torque, of motors whose command is known as well."""
        chosen = np.flatnonzero(self._measured & self._known)
        if not chosen.size:
            return
        off = (self._numbers.kp * self._lead - self._reading.torque)[chosen]
        by_x, _, by_noise = self.rows.add(off, self._sensor[chosen])
        by_noise[:, chosen] = np.diag(self._stiff[chosen])
        for row, joint in enumerate(chosen):
            for at in self._at("kp", self._names[joint]):
                by_x[row, at] = self._lead[joint]

    def _weighed(self) -> None:
        """Sum of f_z of a foot's points = what the scale under it shows."""
        for foot, weighed in self._reading.force.items():
            if math.isfinite(weighed):
                on = [point for point, own in enumerate(self._feet) if own == foot]
                residual = np.array([self._forces[on, 2].sum() - weighed])
                _, by_own, _ = self.rows.add(residual, np.array([self._noise.force]))
                by_own[0, [3 + 3 * point + 2 for point in on]] = 1.0

    def _tilt(self) -> None:
        """Roll and pitch against the vertical, plus the IMU's own = what it shows.

        The vertical u in the base's axes has roll = atan2(u_y, u_z), pitch = -asin(u_x).
        """
        numbers = self._numbers
        rotation, size = self.config.base_rotation(), float(np.linalg.norm(numbers.down))
        up = rotation.T @ (-numbers.down / size)
        self.tilt = np.array([math.atan2(up[1], up[2]), -math.asin(up[0])]) + numbers.imu
        if not np.isfinite(self._reading.tilt).all():
            return
        across = up[1] ** 2 + up[2] ** 2
        rates = np.array(
            [[0.0, up[2] / across, -up[1] / across], [-1 / math.sqrt(across), 0.0, 0.0]]
        )
        off = self.tilt - self._reading.tilt
        by_x, by_own, _ = self.rows.add(off, np.full(2, self._noise.tilt))
        by_own[:, :2] = rates @ -np.cross(np.eye(3)[:2], up).T  # a turn w changes u by -w x u
        for row, name in enumerate(("roll", "pitch")):
            for at in self._at("imu", "imu", name):
                by_x[row, at] = 1.0
        for pull, axis in zip(numbers.tilts, "xy", strict=True):
            for at in self._at("slope", "floor", axis):
                by_x[:, at] = rates @ (rotation.T @ (-pull / size))


# What parameters say of a robot and its surroundings, and how gravity pulls on it.


@dataclass(frozen=True, eq=False)
class Numbers:
    """What a vector of parameters says of a robot and its surroundings.

    Attributes:
        robot: The robot, with these masses in Pinocchio's model.
        bodies: (link, number of its joint, mass (kg), com (3,) in its frame (m)) of each.
        kp: (nu,) N m/rad.
        friction: (nu,) N m.
        offset: (nu,) rad.
        softness: {foot: factor on how far it sinks}.
        moment: {foot: (3,) moment on it, in parts of the force on it (m)}.
        down: (3,) gravity in the ground's axes (m/s^2).
        tilts: (2, 3) its derivatives by the slope.
        imu: (2,) roll and pitch of the IMU in the base (rad).
        mass: Of the whole robot (kg).
        heaviness: The mass at which noise is taken (kg), as ``stiff`` is the kp.
        stiff: (nu,) kp, by which an encoder's noise becomes torque.
        rubbing: (nu,) friction, that nobody knows the place in.
    """

    robot: Robot
    bodies: tuple[tuple[str, int, float, Array], ...]
    kp: Array
    friction: Array
    offset: Array
    softness: dict[str, float]
    moment: dict[str, Array]
    down: Array
    tilts: Array
    imu: Array
    mass: float
    heaviness: float
    stiff: Array
    rubbing: Array


class GravityRegressor:
    """Generalised forces of gravity, linear in masses and first moments, whichever way it pulls.

    Args:
        robot: The robot.
    """

    def __init__(self, robot: Robot) -> None:
        self._structure = robot.structure
        self._model = robot.structure.model.copy()
        self._data, self._rest = self._model.createData(), np.zeros(self._model.nv)

    def at(
        self, config: Configuration, numbers: Numbers
    ) -> tuple[Array, list[Array], list[Array], list[Array]]:
        """Returns gravity's forces (nv,), and their derivatives.

        By each body's mass (nv,), by its com (nv, 3), and by the slope along x and y (nv,).
        """
        q, found = self._structure.convention.unit_q(config.qpos), []
        for pull in (numbers.down, *numbers.tilts):
            self._model.gravity.linear = pull
            rows = pin.computeJointTorqueRegressor(
                self._model, self._data, q, self._rest, self._rest
            )
            found.append(self._structure.columns(rows.T).T)
        columns = [10 * (number - 1) + np.arange(4) for _, number, *_ in numbers.bodies]
        moments = [np.array([m, *(m * com)]) for *_, m, com in numbers.bodies]
        forces = [
            np.sum([rows[:, at] @ own for at, own in zip(columns, moments, strict=True)], axis=0)
            for rows in found
        ]
        level = [found[0][:, at] for at in columns]
        by_mass = [
            rows[:, 0] + rows[:, 1:] @ com
            for rows, (*_, com) in zip(level, numbers.bodies, strict=True)
        ]
        by_com = [
            mass * rows[:, 1:] for rows, (*_, mass, _) in zip(level, numbers.bodies, strict=True)
        ]
        return forces[0], by_mass, by_com, forces[1:]
