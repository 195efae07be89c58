"""Residual equations of measured stands at rest, as functions of the parameters.

`StandEquations` contains the equations of all stands. Base tilt, base height and contact forces are
further unknowns, which differ in each stand. These own unknowns of a stand are eliminated. The
result is `LinearisedResiduals`: sums over the whitened residuals and the derivatives by the
parameters.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from pupper_analysis.base.array_types import Array, IntArray
from pupper_analysis.base.arrays import cross_matrices
from pupper_analysis.robot.compliance import GroundLaw
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.joints import leg_joints
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.fit.estimate import LinearisedResiduals, Posterior
from pupper_analysis.tools.fit.measurements.stands import MeasuredStands
from pupper_analysis.tools.fit.parameters import AXES, PARAMETER_KINDS, ParameterTable, list_bodies

_TILT_HEIGHT_INDICES = [3, 4, 2]
"""Indices in qvel of the base unknowns of a stand: rotations about the base x and y axes, and
height. The measurements do not depend on the other base coordinates (horizontal position, yaw).
"""

_LAST_MOTION_FRACTION = 0.75
"""Standard deviation of the common part of the moments on all feet, as a fraction of
`StandNoise.moment`. The common part has six terms, one per translation or rotation of the base
before rest. The other part, about half of the variance, is independent for each foot. Measured on
v3 set down in MuJoCo: with this value the whitened residuals of robots with exact parameters have
unit variance.
"""

_RANK_RTOL = 1e-6
"""Relative tolerance of the singular values of the Jacobian of the contact points by the joints. A
singular value counts as 0 if its ratio to the largest singular value is below the tolerance. The
corresponding joint motions do not move the feet. Chosen, not tuned.
"""

_VELOCITY_ATOL = 1e-9
"""Lower bound of a divisor [rad/m, rad/rad]. Foot rotations per unit motion of the base are divided
by the largest rotation. The bound prevents a division by zero. Chosen, not tuned.
"""

_BALANCE_STD_RATIO = 1e-5
"""Standard deviation of the balance equations of the base, as a fraction of the weight for forces,
and of weight times height for moments. The value is small, because a robot at rest obeys statics.
The value is not 0, because the weighted least squares divide by the standard deviation. Chosen, not
tuned.
"""

_TORQUE_STD_RATIO = 1e-4
"""Assumed standard deviation of the difference between servo torque and kp times servo error, as a
fraction of robot weight times `Robot.stand_height`. Chosen, not tuned.
"""

_UNKNOWN_TORQUE_STD_RATIO = 1e3
"""Standard deviation of the torque of a joint without a usable command, as a fraction of weight
times height. The value is so large that this torque has no effect on the fit. Chosen, not tuned.
"""

_MIN_SIGN_BAND = 1e-3
"""Lower bound of the sign band b [rad, m], the servo error at which the smooth sign of the friction
is 0.7 (`_SIGN_BAND_RATIO`). With a band of 0, derivatives would not exist. Chosen, not tuned.
"""

_SIGN_BAND_RATIO = 0.7
"""Ratio [1] of the sign band b to the dead band. With the servo error e, the modelled sign of the
friction is e / sqrt(e^2 + b^2). The function is smooth, because dry friction may have any value up
to its limit at a small servo error. Simulations of Go1 and MEVIUS show this. Chosen; the confidence
intervals of fits with this value were verified on simulated robots (``docs/explanation/fit.md``).
"""

_HELD_FRICTION_STD = 0.45
"""Standard deviation of the friction torque of a joint that dry friction holds, as a fraction of
dead band times kp, at a servo error of 0. A large error determines the sign of the friction.
Derived from joints of Go1 and MEVIUS, whose friction has any value up to the limit.
"""


@dataclass(frozen=True)
class StandNoise:
    """Noise levels in a stand at rest: encoders, contact moments, ground and friction.

    Attributes:
        encoder: Standard deviation of the encoder noise of a joint position [rad, m].
        moment: Standard deviation of (moment about an axis / normal force) at a contact point [m].
            The moment is due to friction of a foot that turned or rolled on the ground.
        flatness: Standard deviation of the height of the ground under a contact point [m],
            including the effect of errors of the link lengths.
        friction: Bound of the random dry friction of a joint, as a factor on the stated friction.
            The random friction has a uniform distribution.
    """

    encoder: float
    moment: float = PARAMETER_KINDS["moment"].width
    flatness: float = 3e-4
    friction: float = 1.0


@dataclass(frozen=True, eq=False)
class StandReading:
    """Measurements of one stand at rest; see ``MeasuredStands`` for all stands.

    Attributes:
        command: Commanded joint positions, shape (nu,) [rad, m]; NaN if unknown.
        position: Measured joint positions, shape (nu,) [rad, m].
        points: Names of the contact points of the feet that carry load.
        heading: Rotation of the robot about the vertical [rad].
        added: {link: known mass on the link [kg] and position in the link frame [m], shape (4,)};
            only links with a mass.
    """

    command: Array
    position: Array
    points: tuple[str, ...]
    heading: float = 0.0
    added: Mapping[str, Array] = field(default_factory=dict)


def make_readings(robot: Robot, stands: MeasuredStands) -> Iterator[StandReading]:
    """Yield the measurements of each stand, in the order of the rows of ``stands``.

    The joints must be in actuator order. All contact points of a foot carry load, unless the foot
    is in ``stands.swing``.
    """
    for row in range(len(stands)):
        yield StandReading(
            command=stands.command[row],
            position=stands.position[row],
            points=tuple(
                point
                for foot, points in robot.feet.items()
                if foot not in stands.swing[row]
                for point in points
            ),
            heading=float(stands.heading[row]),
            added={link: load[row] for link, load in stands.added.items() if load[row, 0]},
        )


_MIN_FORCE_SIGNAL = 1.0
"""Lower bound of (singular value [1/N] times robot weight [N]) in the elimination of the own
unknowns of a stand: contact forces, base tilt and base height. Combinations of the unknowns below
the bound are not eliminated, for example distributions of the force within a sole. Chosen, not
tuned.
"""

_MIN_READING_INFORMATION = 1e-4
"""Lower bound of the information (1 / variance) that all other readings provide about the error of
a joint reading, relative to 1 / (encoder noise)^2. The bound prevents a division by zero in
`StandRows.estimate_position_errors`. Chosen, not tuned.
"""


class _Elimination(NamedTuple):
    """Decomposition that whitens residuals and eliminates the own unknowns of a stand.

    Attributes:
        factor: Cholesky factor of the noise covariance of the residuals, shape (m, m).
        left_vectors: Left singular vectors of the whitened derivative by the own unknowns, shape
            (m, m).
        singular_values: Singular values above the bound, shape (rank,).
        right_vectors: Right singular vectors of these values, shape (rank, 3 + 3 p).
        log_noise: Log determinant of the noise covariance of the projected residuals.
    """

    factor: Array
    left_vectors: Array
    singular_values: Array
    right_vectors: Array
    log_noise: float


class StandRows:
    """Residuals of a stand and derivatives, for given parameters, base pose and contact forces.

    The own unknowns of a stand are the rotations of the base about its x and y axes, the base
    height, and three force components per contact point (p points). Forces are in the axes of the
    ground.

    Args:
        table: Parameters.
        values: Values of the robot and the surroundings for the parameters.
        reading: Measurements.
        laws: {contact point: law of the penetration under a normal force}.
        base: Base quaternion (w, x, y, z) and height [m], shape (5,).
        forces: Forces on the contact points in the axes of the ground, shape (p, 3) [N].
        noise: Noise of the measurements.
        regressor: Regressor of gravity.

    Attributes:
        config: Configuration of the robot.
        jacobians: Jacobians of the contact points, shape (p, 3, nv).
        kp: Servo stiffness, shape (nu,) [N m/rad, N/m].
        residual: Residuals, shape (m,), m = nv + p: nv equations of balance [N, N m], then the
            height equation of each contact point [m].
        by_own: Derivative of the residuals by the own unknowns, shape (m, 3 + 3 p).
        by_noise: Derivative of the residuals by noise that acts on several rows, shape (m, nu + 3 p
            + 6). The columns are nu encoder errors, 3 p moments at the contact points, and 6 base
            motions before rest.
        deviation: Standard deviations of the noise that acts on single rows, shape (m,).
    """

    def __init__(
        self,
        table: ParameterTable,
        values: StandValues,
        reading: StandReading,
        laws: dict[str, GroundLaw],
        base: Array,
        forces: Array,
        noise: StandNoise,
        regressor: GravityRegressor,
    ) -> None:
        self._table, self._values, self._reading = table, values, reading
        self._forces, self._regressor = forces, regressor
        robot, points = values.robot, reading.points
        self.kp = values.kp
        self._robot, self._names = robot, robot.joint_names
        qpos = robot.make_qpos(reading.position - values.offset)
        qpos[2], qpos[3:7] = base[4], base[:4]
        self.config = Configuration(robot, qpos)
        self._feet = [robot.foot_of(point) for point in points]
        self._set_penetration(laws)
        self._softness = np.array([values.softness[foot] for foot in self._feet])
        self._radius = np.array([robot.contact_radius[point] for point in points])
        self._arms = np.zeros((len(points), 3))
        # MuJoCo places a contact at half of the penetration.
        self._arms[:, 2] = self._softness * self._depths / 2 - self._radius
        self._twists = self.config.foot_twist_jacobians(points)
        rotations = self.config.foot_rotations(points)
        self._last_links = np.array(
            [t @ values.last_links[p] for t, p in zip(rotations, points, strict=True)]
        )
        linear, angular = self._twists[:, :3], self._twists[:, 3:]
        self.jacobians = linear - cross_matrices(self._arms) @ angular
        self._set_servo_errors()
        self._weight = robot.weight
        num_unknowns, num_sources = 3 + 3 * len(points), robot.nu + 3 * len(points) + 6
        rows = robot.nv + len(points)
        self.residual = np.zeros(rows)
        self.by_own, self.by_noise = (
            np.zeros((rows, size)) for size in (num_unknowns, num_sources)
        )
        self._fill_balance()
        self._fill_contact()
        self.set_noise(noise)

    def _set_penetration(self, laws: dict[str, GroundLaw]) -> None:
        """Set stiffness of the ground [N/m] and penetration [m] at each contact point, (p,) each.

        The penetration of a sole's points is linearised about the penetration for their mean force.
        With the law at each point's force, points would lift off and return in alternating steps.
        """
        points, normal_forces = self._reading.points, self._forces[:, 2]
        foot_of_point = np.array(self._feet)
        mean_forces = np.array(
            [normal_forces[foot_of_point == foot].mean() for foot in foot_of_point]
        )
        mean_depths = [laws[p].depth(f) for p, f in zip(points, mean_forces.tolist(), strict=True)]
        self._ground_stiffness = np.array(
            [laws[p].normal_stiffness(d) for p, d in zip(points, mean_depths, strict=True)]
        )
        self._depths = (
            np.array(mean_depths) + (normal_forces - mean_forces) / self._ground_stiffness
        )

    def _set_servo_errors(self) -> None:
        """Set the servo errors (command minus position) reduced by the deadband, (nu,) [rad, m].

        Also set the derivative of the reduction by the deadband [1], and the standard deviation
        [N m, N] of the torque of friction that holds a joint. All are 0 without a command.
        """
        values, reading = self._values, self._reading
        commanded = np.isfinite(reading.command)
        servo_errors = np.where(commanded, reading.command - reading.position, 0.0)
        deadband, sign_band = values.deadband, _compute_sign_band(values.noise_deadband)
        self._signs = servo_errors / (size := np.hypot(servo_errors, _compute_sign_band(deadband)))
        self._servo_errors = servo_errors - deadband * self._signs
        self._by_deadband = (
            self._signs - (_SIGN_BAND_RATIO * deadband) ** 2 * servo_errors / size**3
        )
        self._noise_kp = np.where(commanded, values.noise_kp, 0.0)
        self._held_torque_std = (
            _HELD_FRICTION_STD
            * values.noise_deadband
            * self._noise_kp
            * sign_band
            / np.hypot(servo_errors, sign_band)
        )
        self._commanded = commanded

    def set_noise(self, noise: StandNoise) -> None:
        """Set the noise levels, which affect the covariance of the residuals, not the values."""
        normal_forces, height = np.maximum(self._forces[:, 2], 0.0), self._robot.stand_height
        moment_std = math.sqrt(0.5) * noise.moment * np.repeat(normal_forces, 3)
        last_std = np.full(6, _LAST_MOTION_FRACTION * noise.moment)
        self._sources = np.concatenate(
            [np.full(self._robot.nu, noise.encoder), moment_std, last_std]
        )
        # Variance of a uniform distribution in the friction band, independent for each joint. The
        # most likely share of a part that is common to the joints is 0: measured on 271 simulated
        # stands of v3, Go1 and a third robot.
        friction = noise.friction * self._values.friction
        torque = np.hypot(_TORQUE_STD_RATIO * self._weight * height, friction / math.sqrt(3.0))
        torque = np.hypot(torque, self._held_torque_std)
        torque = np.where(
            self._commanded, torque, _UNKNOWN_TORQUE_STD_RATIO * self._weight * height
        )
        base = _BALANCE_STD_RATIO * self._weight * np.array([1.0, 1.0, 1.0, height, height, height])
        flatness = np.full(len(normal_forces), noise.flatness)
        self.deviation: Array = np.concatenate([base, torque, flatness])
        self.__dict__.pop("_elimination", None)

    def _compute_covariance(self) -> Array:
        """Return the noise covariance of the residuals, shape (m, m), in their units squared."""
        covariance: Array = self._sources**2 * self.by_noise @ self.by_noise.T
        return covariance + np.diag(self.deviation**2)

    def compute_cost(self, residual: Array) -> float:
        """Compute the sum of squares of a residual, shape (m,), whitened by this stand's noise."""
        whitened = np.linalg.solve(self._elimination.factor, residual)
        return float(whitened @ whitened)

    def compute_unknowns_step(self) -> tuple[float, Array]:
        """Compute a Gauss-Newton step of base tilt, base height and contact forces.

        Returns:
            Sum of squares of the projected residuals, and the step, both as in
            `eliminate_own_unknowns`. No derivatives by the parameters are computed.
        """
        projected, _, step = self._project_out_unknowns(self.residual[:, None])
        return float(projected[:, 0] @ projected[:, 0]), step

    def eliminate_own_unknowns(self) -> tuple[LinearisedResiduals, Array]:
        """Eliminate base tilt, base height and contact forces from the equations of a stand.

        The residuals are whitened, and projected onto combinations that these unknowns do not
        affect.

        Returns:
            1. Sums (`LinearisedResiduals`) over the projected residuals, linearised by the
               parameters.
            2. Gauss-Newton step of the eliminated unknowns, shape (3 + 3 p,), for p contact points:
               rotations about the base x and y axes [rad], base height [m], forces [N].
        """
        projected, log_noise, step = self._project_out_unknowns(
            np.column_stack([self.residual, self.by_x])
        )
        return LinearisedResiduals.from_residuals(
            projected[:, 0], projected[:, 1:], log_noise
        ), step

    def _project_out_unknowns(self, columns: Array) -> tuple[Array, float, Array]:
        """Whiten columns, shape (m, n), by the noise, and project out the stand's own unknowns.

        The first column contains the residuals. With covariance C, projection P and the derivative
        B by the own unknowns, det(P' C P) = det(C) det(B' C^-1 B) / det(B' B). The log determinant
        leaves out the last factor, which does not depend on the noise.

        Returns:
            Projected columns; log determinant of the noise covariance of the projected residuals;
            Gauss-Newton step of the own unknowns, shape (3 + 3 p,).
        """
        factor, left_vectors, singular_values, right_vectors, log_noise = self._elimination
        rank, whitened = len(singular_values), np.linalg.solve(factor, columns)
        step = right_vectors.T @ (left_vectors[:, :rank].T @ -whitened[:, 0] / singular_values)
        return left_vectors[:, rank:].T @ whitened, log_noise, step

    @cached_property
    def _elimination(self) -> _Elimination:
        """Decomposition of the noise covariance and of the derivative by the own unknowns."""
        factor = np.linalg.cholesky(self._compute_covariance()).astype(float, copy=False)
        left_vectors, singular_values, right_vectors = np.linalg.svd(
            np.linalg.solve(factor, self.by_own), full_matrices=True
        )
        rank = int(np.count_nonzero(singular_values > _MIN_FORCE_SIGNAL / self._weight))
        singular_values = singular_values[:rank]
        log_noise = 2 * float(np.log(np.diag(factor)).sum() + np.log(singular_values).sum())
        return _Elimination(factor, left_vectors, singular_values, right_vectors[:rank], log_noise)

    def estimate_position_errors(self, covariance: Array) -> tuple[Array, Array]:
        """Estimate the error (measured minus true) of each joint position in this stand.

        The error of a position is estimated from the other readings:

            error = -d^T r / w,    standard deviation = 1 / sqrt(w),
            w = d^T d - d^T A C A^T d, at least `_MIN_READING_INFORMATION` / (encoder noise)^2

        with the whitened and projected residuals r (`eliminate_own_unknowns`), their derivative d
        by the error of the position, and their Jacobian A by the parameters.

        Args:
            covariance: Covariance C of the parameters, shape (n, n).

        Returns:
            Errors and their standard deviations, shape (nu,) [rad, m] each.
        """
        columns = [self.residual, self.by_x, self.by_noise[:, : self._robot.nu]]
        projected = self._project_out_unknowns(np.column_stack(columns))[0]
        by_x, by_reading = np.split(projected[:, 1:], [self.by_x.shape[1]], axis=1)
        by_both = by_x.T @ by_reading
        information = (by_reading * by_reading).sum(axis=0) - (
            by_both * (covariance @ by_both)
        ).sum(axis=0)
        information = np.maximum(information, _MIN_READING_INFORMATION / self._sources[0] ** 2)
        return -(by_reading.T @ projected[:, 0]) / information, 1 / np.sqrt(information)

    def _add_derivatives(
        self,
        rows: Array,
        derivatives: Array,
        kind: str,
        subjects: Sequence[str],
        components: Sequence[str] = ("",),
    ) -> None:
        """Add derivatives of residuals by the parameters of a kind to ``rows``, shape (k, n).

        ``derivatives`` has a column for each component of each subject (joint, foot or link).
        """
        positions, columns = self._table.find_columns(kind, subjects, components)
        if positions:
            np.add.at(rows.T, columns, derivatives.T[positions])

    @cached_property
    def by_x(self) -> Array:
        """Derivative of the residuals by the n parameters, shape (m, n)."""
        nv = self._robot.nv
        by_x = np.zeros((len(self.residual), len(self._table)))
        self._add_balance_derivatives(by_x[:nv])
        self._add_contact_derivatives(by_x[nv:])
        return by_x

    def _fill_balance(self) -> None:
        """Fill in the residual of the static balance and the derivatives.

            S tau - g + passive + sum J_p^T w_p - load = 0

        with the torques tau of servos and one-sided friction (S maps them to generalised forces),
        gravity forces g, passive joint forces, Jacobians J_p and wrenches w_p of the contacts, and
        the vertical load on the base that the scale did not show. The equations are scaled
        (`_scale_balance`).
        """
        values, nv, nu, forces = self._values, self._robot.nv, self._robot.nu, self._forces
        num_points = len(forces)
        moments = np.array([values.moment[foot] for foot in self._feet])
        moment_forces = forces[:, 2:] * moments
        wrenches = np.hstack([forces, np.cross(self._arms, forces) + moment_forces])
        self._stiffness = self.config.loaded_points_derivative(self._twists, wrenches)
        angular = self._twists[:, 3:]
        residual = self.config.passive_forces() - self._regressor.compute_forces(
            self.config, values
        )
        residual[2] -= values.unweighed_load * values.mass * values.gravity_norm
        residual += forces.ravel() @ self.jacobians.reshape(-1, nv)
        residual[6:] += values.kp * self._servo_errors
        residual += moment_forces.ravel() @ angular.reshape(-1, nv)
        by_own, by_noise = (matrix[:nv] for matrix in (self.by_own, self.by_noise))
        by_own[:, :3] = -self._stiffness[:, _TILT_HEIGHT_INDICES]
        by_own[:, 3:] = self.jacobians.reshape(-1, nv).T
        # Penetration moves the contact towards the centre of the foot by half of its amount.
        contact_moments = np.zeros((num_points, 3))
        contact_moments[:, 0], contact_moments[:, 1] = -forces[:, 1] / 2, forces[:, 0] / 2
        self._contact_torques = (contact_moments[:, None] @ angular)[:, 0]
        by_own[:, 5::3] += (
            self._softness / self._ground_stiffness * self._contact_torques.T
            + (moments[:, None] @ angular)[:, 0].T
        )
        # True position = measured position - offset - noise. The servo error is the command minus
        # the measured position without noise: both contain the offset.
        by_noise[6:, :nu] += np.diag(self.kp * self._commanded)
        by_noise[:, :nu] += self._stiffness[:, 6:]
        for link in self._reading.added:
            residual[6:] += values.settling[link] * values.friction * self._signs
        by_noise[:, nu:-6] = angular.reshape(-1, nv).T
        feet = self._compute_foot_rotation_rates()
        normal_forces = np.maximum(forces[:, 2], 0.0)
        by_noise[:, -6:] = np.einsum("p,pij,pik->jk", normal_forces, angular, feet)
        self._scale_balance(residual, by_own, by_noise)

    def _add_balance_derivatives(self, by_x: Array) -> None:
        """Add the derivatives of the static balance by the parameters, ``by_x``, shape (nv, n)."""
        values, nv, forces = self._values, self._robot.nv, self._forces
        angular = self._twists[:, 3:]
        by_softness = (self._depths[:, None] * self._contact_torques).T
        self._add_derivatives(by_x, by_softness, "softness", self._feet)
        lever_torques = (np.cross(self._last_links, forces)[:, None] @ angular)[:, 0]
        self._add_derivatives(by_x, lever_torques.T, "length", self._feet)
        pressed = forces[:, 2, None, None] * angular
        self._add_derivatives(by_x, pressed.reshape(-1, nv).T, "moment", self._feet, AXES)
        yielded_friction = values.friction * self._signs
        for link in self._reading.added:
            self._add_derivatives(by_x[6:], yielded_friction[:, None], "settling", [link])
        self._add_derivatives(by_x, self._stiffness[:, 6:], "offset", self._names)
        self._add_derivatives(by_x[6:], np.diag(self._servo_errors), "kp", self._names)
        by_deadband = -(values.kp * self._by_deadband)[:, None]
        self._add_derivatives(by_x[6:], by_deadband, "deadband", ["servos"])
        self._add_gravity_derivatives(by_x)
        self._scale_balance_derivatives(by_x)

    def _compute_foot_rotation_rates(self) -> Array:
        """Compute relative rotation rates [1] of the feet in base motions, shape (p, 3, 6).

        In each of the six base motions, the joints keep the p contact points in place as well as
        possible. The rates of a motion are divided by the largest. Friction on a foot at rest acts
        against the last motion before rest, a combination of the six motions.
        """
        nv, twists = self._robot.nv, self._twists
        contact_jacobian = self.jacobians.reshape(-1, nv)
        joints, *_ = np.linalg.lstsq(
            contact_jacobian[:, 6:], -contact_jacobian[:, :6], rcond=_RANK_RTOL
        )
        feet = twists[:, 3:, :6] + twists[:, 3:, 6:] @ joints
        rates: Array = feet / np.maximum(np.abs(feet).max(axis=(0, 1)), _VELOCITY_ATOL)
        return rates

    def _add_gravity_derivatives(self, by_x: Array) -> None:
        """Add the derivatives of the balance by bodies, known masses, slope and load.

        ``by_x`` has the shape (nv, n), and is changed in place.
        """
        values, nv = self._values, self._robot.nv
        by_mass, by_com, by_slope = self._regressor.evaluate_derivatives(self.config, values)
        links = [link for link, *_ in values.bodies]
        b = len(links)
        by_body = -by_mass[:, :b]
        by_body[2] -= values.unweighed_load * values.gravity_norm
        self._add_derivatives(by_x, by_body, "mass", links)
        self._add_derivatives(by_x, -by_com[:, :b].reshape(nv, -1), "com", links, AXES)
        for number, load in enumerate(values.loads, b):
            self._add_derivatives(
                by_x, -load.stated * by_mass[:, number, None], "added", [load.link]
            )
            self._add_derivatives(
                by_x, -by_com[:, number] @ load.rotation, "place", [load.link], AXES
            )
        self._add_derivatives(by_x, -by_slope, "slope", ["floor"], "xy")
        by_load = np.full((1, 1), -values.mass * values.gravity_norm)
        self._add_derivatives(by_x[2:3], by_load, "load", ["scale"])

    def _scale_balance(self, residual: Array, by_own: Array, by_noise: Array) -> None:
        """Scale the balance equations in place, so that small kp and mass have no advantage.

        The factors are (noise kp) / kp for joints, and (noise mass) / mass for the base. Without
        the factors, small estimates would decrease the residuals, but not the noise.
        """
        values, nv = self._values, self._robot.nv
        driven = self._commanded & (values.kp > 0)
        kp = np.where(driven, values.kp, 1.0)
        self._factors = np.full(nv, values.noise_mass / values.mass)
        self._factors[6:] = np.where(driven, self._noise_kp / kp, 1.0)
        # Logarithmic derivatives of the factors by kp and by each mass, times the residual.
        self._factors_by_kp = np.where(driven, -residual[6:] / kp, 0.0)
        self._factors_by_mass = -residual[:6] / values.mass
        for rows in (by_own.T, by_noise.T):
            rows *= self._factors
        self.residual[:nv] = residual * self._factors

    def _scale_balance_derivatives(self, by_x: Array) -> None:
        """Scale the derivatives of the balance, shape (nv, n), as in `_scale_balance`, in place.

        The derivatives of the factors by kp and masses are added.
        """
        self._add_derivatives(by_x[6:], np.diag(self._factors_by_kp), "kp", self._names)
        links = [link for link, *_ in self._values.bodies]
        by_body = np.tile(self._factors_by_mass[:, None], len(links))
        self._add_derivatives(by_x[:6], by_body, "mass", links)
        by_x *= self._factors[:, None]

    def _fill_contact(self) -> None:
        """Fill in the contact equation z_p - r_p + softness depth(f_p) = 0 and the derivatives.

        z_p and r_p are height and radius of the contact sphere, depth(f_p) the penetration [m]
        under the force f_p.
        """
        points = self._reading.points
        heights = self._twists[:, 2]
        nv = self._robot.nv
        by_own, by_noise = (matrix[nv:] for matrix in (self.by_own, self.by_noise))
        self.residual[nv:] = self.config.foot_centres(points)[:, 2] - self._radius
        self.residual[nv:] += self._softness * self._depths
        by_own[:, :3] = heights[:, _TILT_HEIGHT_INDICES]
        by_noise[:, : self._robot.nu] -= heights[:, 6:]
        point = np.arange(len(points))
        by_own[point, 5 + 3 * point] += self._softness / self._ground_stiffness

    def _add_contact_derivatives(self, by_x: Array) -> None:
        """Add the derivatives of the contact equation by the parameters, ``by_x``, shape (p, n)."""
        self._add_derivatives(by_x, -self._twists[:, 2, 6:], "offset", self._names)
        self._add_derivatives(by_x, np.diag(self._depths), "softness", self._feet)
        self._add_derivatives(by_x, np.diag(self._last_links[:, 2]), "length", self._feet)


def _compute_sign_band(deadband: float) -> float:
    """Compute the sign band [rad, m] of the friction (`_SIGN_BAND_RATIO`).

    ``deadband`` is the servo error [rad, m] at which the servo torque equals the dry friction.
    """
    return math.hypot(_MIN_SIGN_BAND, _SIGN_BAND_RATIO * deadband)


# Values of the parameters, and the regressor of gravity.


@dataclass(frozen=True, eq=False)
class KnownMass:
    """Known mass that was attached to a link during a stand.

    Attributes:
        link: Name of the link.
        joint: Index of the joint that moves the link, in the model of the robot's ``structure``.
        stated: Stated mass [kg].
        mass: Estimated mass [kg].
        position: Estimated position in the joint frame, shape (3,) [m].
        rotation: Rotation matrix from the link frame to the joint frame, shape (3, 3).
    """

    link: str
    joint: int
    stated: float
    mass: float
    position: Array
    rotation: Array


@dataclass(frozen=True, eq=False)
class StandValues:
    """Values of the robot and the surroundings for a parameter vector.

    Attributes:
        vector: Parameters, shape (n,).
        robot: Robot whose Pinocchio model has the masses, CoMs and leg lengths of the parameters.
        bodies: Link, joint index in ``structure.model``, mass [kg] and CoM in the joint frame,
            shape (3,) [m], of each body.
        kp: Servo stiffness, shape (nu,) [N m/rad, N/m].
        offset: Encoder offsets, shape (nu,) [rad, m].
        softness: {foot: factor on the penetration}.
        moment: {foot: contact moment / normal force, shape (3,) [m]}.
        last_links: {contact point: vector from the axis of the leg's last joint to the point, shape
            (3,) [m], in the frame of the contact}.
        gravity: Gravity in the axes of the ground, shape (3,) [m/s^2].
        gravity_by_slope: Derivatives of ``gravity`` by the slope of the ground along x and y, shape
            (2, 3) [m/s^2]. The slope is the sine of its angle.
        deadband: Servo error below which a servo gives no torque [rad, m]; negative for friction
            against the load.
        settling: {link with a known mass: one-sided friction as a fraction of ``friction``}.
        unweighed_load: Load on the feet in excess of the weight of the masses, as a fraction of the
            weight of ``mass``.
        gravity_norm: Norm of gravity [m/s^2].
        mass: Mass of the whole robot, without known masses [kg].
        noise_mass: Robot mass that scales the noise, constant during a minimisation [kg].
        noise_kp: Servo stiffness that scales the noise, constant during a minimisation, shape (nu,)
            [N m/rad, N/m].
        noise_deadband: Servo error [rad, m] up to which dry friction may hold a joint with a random
            torque.
        friction: Stated or default dry friction, shape (nu,) [N m, N].
        loads: Known masses that are attached.
    """

    vector: Array
    robot: Robot
    bodies: tuple[tuple[str, int, float, Array], ...]
    kp: Array
    offset: Array
    softness: dict[str, float]
    moment: dict[str, Array]
    last_links: Mapping[str, Array]
    gravity: Array
    gravity_by_slope: Array
    deadband: float
    settling: Mapping[str, float]
    unweighed_load: float
    gravity_norm: float
    mass: float
    noise_mass: float
    noise_kp: Array
    noise_deadband: float
    friction: Array
    loads: tuple[KnownMass, ...] = ()

    def for_reading(self, reading: StandReading, table: ParameterTable) -> StandValues:
        """Return these values with the attached masses and the heading of one stand.

        Gravity is expressed in axes that are rotated about z by the heading of the stand.

        Args:
            reading: Measurements of the stand.
            table: Parameters, for corrections of the attached masses and mass positions.
        """
        if not reading.added and not reading.heading:
            return self
        robot, loads = self.robot, []
        if reading.added:
            robot = replace(robot, pin_model=robot.pin_model.copy())
        structure_model = self.robot.structure.model  # joint indices of the regressor
        for link, (stated, *place) in reading.added.items():
            frame = structure_model.frames[structure_model.getFrameId(link, pin.FrameType.BODY)]
            mass = stated * table.get_value(self.vector, "added", link, "", 1.0)
            shift = [table.get_value(self.vector, "place", link, axis, 0.0) for axis in AXES]
            position = frame.placement.act(np.array(place) + shift)
            rotation = frame.placement.rotation
            loads.append(
                KnownMass(link, frame.parentJoint, float(stated), mass, position, rotation)
            )
            model = robot.pin_model
            joint = model.frames[model.getFrameId(link, pin.FrameType.BODY)].parentJoint
            model.inertias[joint] += pin.Inertia(mass, position, np.zeros((3, 3)))
        rotation_back = pin.utils.rotate("z", -reading.heading)
        return replace(
            self,
            robot=robot,
            gravity=rotation_back @ self.gravity,
            gravity_by_slope=self.gravity_by_slope @ rotation_back.T,
            loads=tuple(loads),
        )


def _compute_last_link(robot: Robot, point: str) -> Array:
    """Return the vector, shape (3,) [m], from the axis of a leg's last joint to a contact point.

    The vector is perpendicular to the axis, expressed in the frame of the contact, and zero without
    a joint.
    """
    config, joints = Configuration(robot, robot.neutral()), leg_joints(robot, point)
    if not joints:
        return np.zeros(3)
    axis = config.joint_axis(joints[-1])
    vector = config.foot_centres([point])[0] - config.joint_position(joints[-1])
    vector -= (vector @ axis) * axis
    in_contact_frame: Array = config.foot_rotations([point])[0].T @ vector
    return in_contact_frame


def compute_level_base(robot: Robot, joints: Array, points: Sequence[str]) -> Array:
    """Compute the base pose at which the feet are on the ground: orientation and height.

    A plane z = a x + b y + c is fitted to the contact points by least squares. The base pose makes
    this plane level, at height 0. A contact point is here the centre of the contact sphere, lowered
    by the radius along the base z axis.

    Args:
        robot: Robot.
        joints: Joint positions, shape (nu,) [rad, m].
        points: Names of the contact points that carry load.

    Returns:
        Quaternion (w, x, y, z) and height [m] of the base in the world frame, shape (5,).
    """
    positions = Configuration(robot, robot.make_qpos(joints)).foot_centres(points)
    positions[:, 2] -= [robot.contact_radius[point] for point in points]
    plane = np.column_stack([positions[:, :2], np.ones(len(points))])
    (a, b, c), *_ = np.linalg.lstsq(plane, positions[:, 2])
    normal = np.array([-a, -b, 1.0]) / math.sqrt(1 + a * a + b * b)
    rotation = pin.Quaternion.FromTwoVectors(normal, np.array([0.0, 0.0, 1.0]))
    height = -(rotation.matrix() @ np.array([0.0, 0.0, c]))[2]
    return np.array([rotation.w, rotation.x, rotation.y, rotation.z, height])


class GravityRegressor:
    """Regressor of gravity: generalised forces as a linear function of masses and first moments.

    A first moment is mass times CoM.

    Args:
        robot: Robot.
    """

    def __init__(self, robot: Robot) -> None:
        self._structure = robot.structure
        self._model = robot.structure.model.copy()
        self._data, self._rest = self._model.createData(), np.zeros(self._model.nv)

    def compute_forces(self, config: Configuration, values: StandValues) -> Array:
        """Compute the generalised forces g(q) that balance gravity, shape (nv,) [N, N m].

        Args:
            config: Configuration of the robot.
            values: Masses, CoM positions, known masses and gravity.
        """
        forces: Array = self._multiply_rows(
            self._compute_rows(config, values, values.gravity), values
        )
        return forces

    def evaluate_derivatives(
        self, config: Configuration, values: StandValues
    ) -> tuple[Array, Array, Array]:
        """Compute the derivatives of the generalised forces g(q) that balance gravity.

        Args:
            config: Configuration of the robot.
            values: Masses, CoM positions, known masses and gravity.

        Returns:
            1. Derivatives of g by the masses of the b bodies of ``values.bodies``, then of the k
               known masses ``values.loads``, shape (nv, b + k) [N/kg, N m/kg].
            2. Derivatives of g by the CoMs of the same bodies in the joint frame, shape (nv, b + k,
               3) [N/m, N].
            3. Derivatives of g by the sine of the ground's slope along x and along y, shape (nv, 2)
               [N, N m].
        """
        _, mass, com = self._stack_bodies(values)
        rows = self._compute_rows(config, values, values.gravity)
        by_moment = rows[..., 1:]
        by_mass = rows[..., 0] + np.einsum("vbi,bi->vb", by_moment, com)
        by_com = mass[:, None] * by_moment
        by_slope = [
            self._multiply_rows(self._compute_rows(config, values, gravity), values)
            for gravity in values.gravity_by_slope
        ]
        return by_mass, by_com, np.column_stack(by_slope)

    def _stack_bodies(self, values: StandValues) -> tuple[IntArray, Array, Array]:
        """Return joint indices, masses [kg] and CoMs [m] of the bodies, then of known masses."""
        bodies = [(number, mass, com) for _, number, mass, com in values.bodies]
        bodies += [(load.joint, load.mass, load.position) for load in values.loads]
        joints, mass, com = (np.array(column) for column in zip(*bodies, strict=True))
        return joints, mass, com

    def _compute_rows(self, config: Configuration, values: StandValues, gravity: Array) -> Array:
        """Compute the regressor by mass and first moment of each body, shape (nv, b + k, 4).

        ``gravity`` [m/s^2] has the shape (3,).
        """
        self._model.gravity.linear = gravity
        q = self._structure.convention.unit_q(config.qpos)
        rows = pin.computeJointTorqueRegressor(self._model, self._data, q, self._rest, self._rest)
        rows = self._structure.sort_columns(rows.T).T
        selected: Array = rows.reshape(len(rows), -1, 10)[:, self._stack_bodies(values)[0] - 1, :4]
        return selected

    def _multiply_rows(self, rows: Array, values: StandValues) -> Array:
        """Multiply regressor rows, shape (nv, b + k, 4), by masses and first moments."""
        _, mass, com = self._stack_bodies(values)
        forces: Array = np.einsum("vbm,bm->v", rows, np.column_stack([mass, mass[:, None] * com]))
        return forces


_MAX_UNKNOWN_STEPS = 20
"""Upper bound of the Newton steps for a stand's own unknowns (base tilt and height, contact forces)
in an evaluation. Chosen, not tuned."""

_UNKNOWN_CHI2_TOLERANCE = 1e-4
"""Upper bound of the change of chi2 between two Newton steps for the own unknowns of a stand, at
which the unknowns are solved. The value is a twentieth of the predicted decrease of the cost at
which a fit has converged (2e-3)."""


_MAX_HALVINGS = 10
"""Upper bound of the number of halvings of a Gauss-Newton step for the own unknowns of a stand.
Chosen, not tuned."""

_MIN_DECREASE_RATIO = 0.1
"""Required ratio of actual to predicted decrease of the cost, with which a step for the own
unknowns of a stand is accepted. Chosen, not tuned."""

_COST_RTOL = 1e-6
"""Tolerance of the required decrease of the cost by a step of the base pose and contact forces of a
stand, relative to the cost. At a cost of 1e6, rounding exceeds predicted decreases of 0.01. Chosen,
not tuned."""


class StandEquations:
    """Equations of balance and contact of all stands, for the estimation of the parameters.

    The parameters are common to all stands. Each stand also has own unknowns: base tilt (2), base
    height (1), and forces on the contact points (3 each). The equations of a stand are

        S tau - g(q; masses, CoM) + passive + sum J_p^T w_p - load = 0    (nv)
        z_p(q) - r_p + softness depth(f_p) = 0                            (1 per contact point)

    - q: measured position - offset
    - tau: servo torque, kp (command - position - dead band). The dead band has the smoothed sign of
      the servo error. If a known mass is attached, the one-sided friction ``settling`` is added.
    - S: matrix that maps joint torques to generalised forces
    - w_p: force f_p and moment at contact point p
    - load: force on the feet in excess of the weight of the masses
    - z_p, r_p: height and radius of the contact sphere; depth: penetration [m]

    Encoder noise acts on q and on tau. The own unknowns of each stand are eliminated: the remaining
    combinations of the equations depend on no contact force and no motion of the base.

    Args:
        robot: Robot, with the values of the files.
        stands: Measurements, joints in actuator order.
        table: Parameters; may be replaced.
        kp: Stated servo stiffness, shape (nu,) [N m/rad, N/m]; 0 without a servo.
        friction: Dry friction of the joints, shape (nu,) [N m, N].
        noise: Noise of the measurements; may be replaced.

    Attributes:
        noise_deadband: Servo error [rad, m] up to which dry friction may hold a joint with a random
            torque; 0 at first.
    """

    def __init__(
        self,
        robot: Robot,
        stands: MeasuredStands,
        table: ParameterTable,
        kp: Array,
        friction: Array,
        noise: StandNoise,
    ) -> None:
        self.robot, self.table, self.noise = robot, table, noise
        self._kp, self._friction, self._noise_kp = kp, friction, kp
        self._noise_mass = robot.total_mass
        self.noise_deadband = 0.0
        model = robot.structure.model
        self._bodies = [(link, at, model.inertias[at].copy()) for link, at in list_bodies(robot)]
        self._laws = {point: GroundLaw.of_contact(robot, point) for point in robot.contact_points}
        self._regressor = GravityRegressor(robot)
        self._last_links = {
            point: _compute_last_link(robot, point) for point in robot.contact_points
        }
        self._readings = list(make_readings(robot, stands))
        self._unknowns = [self._make_initial_unknowns(reading) for reading in self._readings]

    def linearise(self, x: Array, noise_point: Array) -> LinearisedResiduals:
        """Linearise the whitened residuals of all stands, for ``estimate_parameters``.

        The own unknowns of each stand (base tilt, base height, contact forces) are solved for and
        eliminated.

        Args:
            x: Parameters, shape (n,), each in its unit.
            noise_point: The same array object as ``x``, to store the solved unknowns as the next
                initial guess. With any other array, the previous unknowns are restored at the end.

        Returns:
            Sums over the residuals. ``chi2`` is infinite if the equations of a stand cannot be
            evaluated.
        """
        total, previous_unknowns = LinearisedResiduals.empty(len(x)), list(self._unknowns)
        try:
            values = self._make_values(x)
            for stand in range(len(self._readings)):
                total += self.linearise_stand(stand, values)
        except (np.linalg.LinAlgError, ArithmeticError):  # no stand exists near these parameters
            total = replace(total, chi2=math.inf)
        if x is not noise_point:
            self._unknowns = previous_unknowns
        return total

    def set_noise_point(self, x: Array) -> None:
        """Set the stiffness, mass and dead band that scale the noise, from parameters x, (n,).

        These values are constant during a minimisation, which would otherwise prefer parameters
        with large noise.
        """
        names = self.robot.joint_names
        self._noise_kp = self.table.get_values(x, "kp", names, self._kp)
        self._noise_mass = self._sum_masses(x)
        self.noise_deadband = abs(self.table.get_value(x, "deadband", "servos", "", 0.0))

    def linearise_stand(self, stand: int, values: StandValues) -> LinearisedResiduals:
        """Linearise the whitened residuals of a stand with respect to the parameters.

        Base tilt, base height and contact forces of the stand are computed by Gauss-Newton steps,
        stored, and eliminated. A step is halved, at most `_MAX_HALVINGS` times, until

            cost(u) - cost(u + t step) >= 0.1 t (2 - t) (cost(u) - chi2) - tolerance

        with the unknowns u, the fraction t of the step, the sums of squares of the whitened (cost)
        and of the projected residuals (chi2), and the tolerance `_UNKNOWN_CHI2_TOLERANCE` +
        `_COST_RTOL` cost(u). Without halving the steps may alternate: the stiffness of soft ground
        changes much near a force of zero. The steps end if chi2 changes by at most
        `_UNKNOWN_CHI2_TOLERANCE` after a full step, or after `_MAX_UNKNOWN_STEPS`. The returned
        sums are evaluated at the start of the last step.

        Args:
            stand: Index of the stand.
            values: Values of the robot for a parameter vector.
        """
        values = values.for_reading(self._readings[stand], self.table)
        rows, previous_chi2, fraction = self._make_rows(stand, values), math.inf, 1.0
        for _ in range(_MAX_UNKNOWN_STEPS):
            last_rows = rows
            chi2, step = rows.compute_unknowns_step()
            change = abs(chi2 - previous_chi2)
            previous_chi2, start = chi2, self._unknowns[stand]
            if fraction == 1.0 and change <= _UNKNOWN_CHI2_TOLERANCE:
                self._apply_step(stand, step)
                break
            cost = rows.compute_cost(rows.residual)
            for halvings in range(_MAX_HALVINGS + 1):
                fraction = 0.5**halvings
                self._unknowns[stand] = start
                self._apply_step(stand, fraction * step)
                trial = self._make_rows(stand, values)
                required = _MIN_DECREASE_RATIO * fraction * (2 - fraction) * (cost - previous_chi2)
                decrease = cost - rows.compute_cost(trial.residual)
                if decrease >= required - _UNKNOWN_CHI2_TOLERANCE - _COST_RTOL * cost:
                    break
            rows = trial
        return last_rows.eliminate_own_unknowns()[0]

    def evaluate_rows(self, x: Array) -> list[StandRows]:
        """Evaluate the residuals of every stand, with derivatives, at parameters x, shape (n,).

        Base tilt, base height and contact forces of a stand keep their stored values.
        """
        values = self._make_values(x)
        return [self._evaluate_stand(stand, values) for stand in range(len(self._readings))]

    def _evaluate_stand(self, stand: int, values: StandValues) -> StandRows:
        """Evaluate the residuals of a stand, at the stored base pose and contact forces."""
        return self._make_rows(stand, values.for_reading(self._readings[stand], self.table))

    def _make_rows(self, stand: int, values: StandValues) -> StandRows:
        """Evaluate the residuals of a stand, with ``values`` of `StandValues.for_reading`."""
        base, forces = self._unknowns[stand]
        return StandRows(
            self.table,
            values,
            self._readings[stand],
            self._laws,
            base,
            forces,
            self.noise,
            self._regressor,
        )

    def _make_values(self, x: Array) -> StandValues:
        """Return the values of robot and surroundings for parameters ``x``, shape (n,).

        Raises:
            LinAlgError: If the slope of the ground is 90 deg or more.
        """
        robot, table = self.robot, self.table
        model, bodies = robot.pin_model.copy(), []
        for link, number, stated in self._bodies:
            mass, com = table.get_inertial(x, link, stated)
            bodies.append((link, number, mass, com))
            index = model.frames[model.getFrameId(link, pin.FrameType.BODY)].parentJoint
            # Rotational inertia has no effect at rest.
            model.inertias[index] = pin.Inertia(mass, com, stated.inertia)
        for point, last_link in self._last_links.items():
            extension = table.get_value(x, "length", robot.foot_of(point), "", 1.0) - 1.0
            if extension:
                index = model.getFrameId(robot.contact_frames[point], pin.FrameType.BODY)
                model.frames[index].placement *= pin.SE3(np.eye(3), extension * last_link)
        gravity_norm = float(np.linalg.norm(robot.gravity))
        slope_x, slope_y = (table.get_value(x, "slope", "floor", axis, 0.0) for axis in "xy")
        if (squared := 1 - slope_x * slope_x - slope_y * slope_y) <= 0:
            raise np.linalg.LinAlgError("on a wall")
        upright = math.sqrt(squared)
        return StandValues(
            vector=x,
            robot=replace(robot, pin_model=model),
            bodies=tuple(bodies),
            kp=table.get_values(x, "kp", robot.joint_names, self._kp),
            offset=table.get_values(x, "offset", robot.joint_names, np.zeros(robot.nu)),
            softness={foot: table.get_value(x, "softness", foot, "", 1.0) for foot in robot.feet},
            moment={
                foot: np.array([table.get_value(x, "moment", foot, axis, 0.0) for axis in AXES])
                for foot in robot.feet
            },
            last_links=self._last_links,
            gravity=gravity_norm * np.array([slope_x, slope_y, -upright]),
            gravity_by_slope=gravity_norm
            * np.array([[1.0, 0.0, slope_x / upright], [0.0, 1.0, slope_y / upright]]),
            deadband=table.get_value(x, "deadband", "servos", "", 0.0),
            settling={
                link: table.get_value(x, "settling", link, "", 0.0)
                for link in dict.fromkeys(
                    link for reading in self._readings for link in reading.added
                )
            },
            unweighed_load=table.get_value(x, "load", "scale", "", 0.0),
            gravity_norm=gravity_norm,
            mass=self._sum_masses(x),
            noise_mass=self._noise_mass,
            noise_kp=self._noise_kp,
            noise_deadband=self.noise_deadband,
            friction=self._friction,
        )

    def _sum_masses(self, x: Array) -> float:
        """Return the robot's mass [kg], without known masses, for parameters ``x``, shape (n,)."""
        masses = [index for index, parameter in enumerate(self.table) if parameter.kind == "mass"]
        return self.robot.total_mass + float((x - self.table.stated)[masses].sum())

    def _make_initial_unknowns(self, reading: StandReading) -> tuple[Array, Array]:
        """Return an initial base pose, shape (5,), and contact forces, shape (p, 3) [N]."""
        robot, points = self.robot, reading.points
        forces = np.zeros((len(points), 3))
        forces[:, 2] = robot.weight / len(points)
        return compute_level_base(robot, reading.position, points), forces

    def compute_informations(self, x: Array) -> list[Array]:
        """Compute the Fisher information about the parameters ``x``, (n,), of each stand.

        The matrices, shape (n, n), are in units of the prior widths. The stored base poses and
        contact forces of the stands are updated.
        """
        values, width = self._make_values(x), self.table.width
        informations = [
            self.linearise_stand(stand, values).information for stand in range(len(self._readings))
        ]
        return [width[:, None] * information * width for information in informations]

    def sum_normal_forces(self, stand: int) -> dict[str, float]:
        """Sum the stored normal forces of each carrying foot in a stand: {foot: force [N]}."""
        forces = dict(zip(self._readings[stand].points, self._unknowns[stand][1], strict=True))
        return {
            foot: float(sum(forces[point][2] for point in points if point in forces))
            for foot, points in self.robot.feet.items()
            if any(point in forces for point in points)
        }

    def compute_swing_heights(
        self, stand: int, x: Array, offsets: Array
    ) -> dict[str, tuple[float, float]]:
        """Return the height of the lowest contact point of each foot in the air.

        Args:
            stand: Index of the measured stand.
            x: Parameters, shape (n,), each in its unit.
            offsets: Standard deviation of each joint's encoder offset, shape (nu,) [rad, m].

        Returns:
            {foot: height above the ground and standard deviation [m]}. The standard deviation
            contains the encoder offsets and the unevenness of the ground (``StandNoise.flatness``),
            not the errors of the base pose.
        """
        carrying, config = (
            self._readings[stand].points,
            self._evaluate_stand(stand, self._make_values(x)).config,
        )
        robot, heights_by_foot = self.robot, {}
        for foot, points in robot.feet.items():
            if not set(points) & set(carrying):
                radius = [robot.contact_radius[point] for point in points]
                heights = config.foot_centres(points)[:, 2] - radius
                lowest = int(heights.argmin())
                gradient = config.foot_twist_jacobians(points)[lowest, 2, 6:]
                std = math.hypot(float(np.linalg.norm(gradient * offsets)), self.noise.flatness)
                heights_by_foot[foot] = float(heights[lowest]), std
        return heights_by_foot

    def compute_rms_residuals(self, x: Array) -> list[float]:
        """Return the root mean square of the whitened residuals of each stand.

        ``x`` are the parameters, shape (n,). Base tilt, base height and contact forces of each
        stand are updated, and eliminated from the residuals.
        """
        values = self._make_values(x)
        linearised = [self.linearise_stand(stand, values) for stand in range(len(self._readings))]
        return [math.sqrt(stand_sums.chi2 / max(stand_sums.rows, 1)) for stand_sums in linearised]

    def estimate_position_errors(self, posterior: Posterior) -> tuple[Array, Array]:
        """Estimate the error of each joint's measured position in each stand.

        The error is the measured position minus the position that the other measurements predict,
        given the distribution of the parameters.

        Returns:
            Errors and standard deviations of the errors, shape (stands, nu) [rad, m] each.
        """
        contradictions = [
            rows.estimate_position_errors(posterior.covariance)
            for rows in self.evaluate_rows(posterior.mean)
        ]
        errors, stds = np.moveaxis(np.array(contradictions), 1, 0)
        return errors, stds

    def _apply_step(self, stand: int, step: Array) -> None:
        """Add a step, shape (3 + 3 p,), to the stored base pose and contact forces of a stand.

        The step contains base tilt about x and y [rad], base height [m], and forces at p contact
        points [N].
        """
        base, forces = self._unknowns[stand]
        half_x, half_y = step[:2] / 2
        rotation = pin.Quaternion(*base[:4]) * pin.Quaternion(1.0, half_x, half_y, 0.0)
        rotation.normalize()
        moved = np.array([rotation.w, rotation.x, rotation.y, rotation.z, base[4] + step[2]])
        self._unknowns[stand] = moved, forces + step[3:].reshape(-1, 3)
