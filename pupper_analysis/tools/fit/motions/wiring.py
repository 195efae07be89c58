"""Search for exchanged joints and wrong signs in a log, by the torques of the servos.

Columns that are named after another joint, for commands and positions, cannot be recognised by
comparing commands with positions. The load of the servos reveals them: a servo that carries a link
against gravity lags its command. `find_log_wiring` compares the lag with the inverse dynamics, for
the given columns and for columns with one error. This takes seconds, the fit minutes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import Servos
from pupper_analysis.tools.fit.motions.rollouts import LogSegment
from pupper_analysis.tools.fit.parameters import PARAMETER_KINDS
from pupper_analysis.tools.fit.stands.wiring import generate_wirings

_NUM_POSTURES = 100
"""Number of postures of all runs in which torques are compared. Chosen, not tuned."""

_SMOOTHING_DURATION = 0.1
"""Duration [s] of the windows in which cubic polynomials give velocities and accelerations. Chosen,
not tuned.
"""

_LAG_NOISE = 5e-4
"""Standard deviation [rad, m] of the lag of a servo (command - position) that the model does not
explain, for example because of stiction. Chosen, not tuned.
"""

_FRICTION_RATE = 0.02
"""Velocity [rad/s, m/s] above which dry friction counts as saturated. Chosen, not tuned."""

_MIN_COST_RATIO = 9.0
"""Ratio of two costs above which a wiring is reported: of the columns as given, and of the columns
with one error. The RMS residual decreases to a third. Chosen, not tuned.
"""


def find_log_wiring(robot: Robot, servos: Servos, runs: Sequence[LogSegment]) -> Diagnostic | None:
    """Find the exchanged joints, or the joint with the wrong sign, that explains the servo lags.

    For each wiring with at most one error (`generate_wirings`), the lags (command - position) are
    compared with the inverse dynamics at the measured motion:

        kp lag - kd v = Y(q, v, a) p + damping v + friction sign(v) + armature a + offset

    The inertial parameters p and kp have the default priors of a fit. The passive terms and offsets
    have wide priors. The cost is the sum of squared residuals, in standard deviations `_LAG_NOISE`,
    plus the prior. The wiring with the smallest cost is reported if it decreases the cost enough
    (`_MIN_COST_RATIO`).

    Args:
        robot: Robot with a fixed base.
        servos: Servos.
        runs: Runs of the logs, joints in actuator order.

    Returns:
        Message about the most probable wiring; None, for example, if the columns as given explain
        the lags as well, or if measured joints belong to closed loops.
    """
    counts = [np.isfinite(run.position).any(axis=0).tolist() for run in runs]
    is_measured = np.array([all(column) for column in zip(*counts, strict=True)], dtype=bool)
    compared = is_measured & (servos.kp > 0)
    closure = robot.closure
    coupled = [] if closure is None else [*closure.dependent_joints, *closure.driving_joints]
    samples = _sample_motion(robot, runs)
    if samples is None or not compared.any() or is_measured[coupled].any():
        return None
    cost = _LagCost(robot, servos, compared)
    stated_cost = cost.evaluate(*samples)
    if stated_cost <= _MIN_COST_RATIO * compared.sum() * len(samples[0]):
        return None
    smallest, best = stated_cost / _MIN_COST_RATIO, None
    for wiring in generate_wirings(robot):
        order, signs = list(wiring.order), np.array(wiring.signs)
        is_changed = (np.array(order) != np.arange(robot.nu)) | (signs < 0)
        if is_measured[is_changed].all():
            wired_cost = cost.evaluate(*(signs * series[:, order] for series in samples))
            if wired_cost < smallest:
                smallest, best = wired_cost, wiring
    if best is None:
        return None
    ratio = math.sqrt(stated_cost / smallest)
    values = best.found.values
    if "joint" in values:
        return diagnose("log-joint-turns-the-other-way", joint=values["joint"], ratio=ratio)
    return diagnose(
        "log-joints-exchanged", joints=values["joints"], others=values["others"], ratio=ratio
    )


def _sample_motion(
    robot: Robot, runs: Sequence[LogSegment]
) -> tuple[Array, Array, Array, Array] | None:
    """Return positions, velocities, accelerations and servo lags, each of shape (k, nu).

    The k postures are evenly distributed over the runs. None without complete samples.
    """
    parts = [*_differentiate_runs(robot, runs)]
    if not parts:
        return None
    series = [np.concatenate(values) for values in zip(*parts, strict=True)]
    rows = np.flatnonzero(np.isfinite(np.hstack(series)).all(axis=1))
    if len(rows) < _NUM_POSTURES:
        return None
    rows = rows[np.linspace(0, len(rows) - 1, _NUM_POSTURES).astype(int)]
    position, velocity, acceleration, lag = (values[rows] for values in series)
    return position, velocity, acceleration, lag


def _differentiate_runs(
    robot: Robot, runs: Sequence[LogSegment]
) -> Iterator[tuple[Array, Array, Array, Array]]:
    """Yield smoothed positions, velocities, accelerations and lags of each run, shape (n, nu)."""
    for run in runs:
        interval = float(np.median(np.diff(run.time)))
        window = 2 * max(2, round(_SMOOTHING_DURATION / interval / 2)) + 1
        if len(run.time) < 2 * window:
            continue
        is_logged = np.isfinite(run.position).any(axis=0)
        position = np.where(is_logged, run.position, robot.home)
        smooth = [
            savgol_filter(position, window, 3, deriv=order, delta=interval, axis=0)
            for order in range(3)
        ]
        lag = np.where(is_logged, run.command - position, 0.0)
        inner = slice(window, len(run.time) - window)
        yield smooth[0][inner], smooth[1][inner], smooth[2][inner], lag[inner]


class _LagCost:
    """Cost of the servo lags of a motion: squared residuals plus the prior of the parameters.

    Args:
        robot: Robot with a fixed base.
        servos: Servos.
        compared: Mask of the joints whose lags are compared, shape (nu,).
    """

    def __init__(self, robot: Robot, servos: Servos, compared: NDArray[np.bool_]) -> None:
        self._robot, self._kp, self._kd = robot, servos.kp, servos.kd
        self._joints = np.flatnonzero(compared)
        model = robot.pin_model
        self._data = model.createData()
        self._inertias = np.array([body.toDynamicParameters() for body in model.inertias[1:]])

    def evaluate(self, position: Array, velocity: Array, acceleration: Array, lag: Array) -> float:
        """Return the smallest cost [1] of a motion, whose series have the shape (k, nu)."""
        robot, joints = self._robot, self._joints
        convention = robot.pin_convention
        k, n = len(position), len(joints)
        regressor = np.empty((k, robot.nu, len(self._inertias), 10))
        v, a = np.zeros((2, robot.pin_model.nv))
        for row in range(k):
            v[convention.v_index], a[convention.v_index] = velocity[row], acceleration[row]
            rows = pin.computeJointTorqueRegressor(
                robot.pin_model, self._data, convention.q(position[row]), v, a
            )
            regressor[row] = rows.reshape(robot.nu, -1, 10)[convention.v_index]
        regressor = regressor[:, joints]
        mass, com = PARAMETER_KINDS["mass"], PARAMETER_KINDS["com"]
        by_body = np.einsum("kjbp,bp->kjb", regressor, self._inertias)
        stated = by_body.sum(axis=2)
        first = regressor[..., 1:4] * (com.width * self._inertias[:, :1])
        columns = [mass.share * by_body, first.reshape(k, n, -1)]
        # Passive terms may explain any part of the lag: their priors are wide.
        largest = self._kp[joints] * np.abs(lag[:, joints]).max(axis=0)
        friction = np.tanh(velocity / _FRICTION_RATE)
        for values in (velocity, friction, acceleration, np.ones_like(lag)):
            own = values[:, joints]
            scaled = own * largest / np.maximum(np.abs(own).max(axis=0), 1e-9)
            columns.append(scaled[:, :, None] * np.eye(n))
        columns.append(PARAMETER_KINDS["kp"].share * stated[:, :, None] * np.eye(n))
        unit = self._kp[joints] * _LAG_NOISE
        design = np.concatenate(columns, axis=2) / unit[:, None]
        target = ((self._kp * lag - self._kd * velocity)[:, joints] - stated) / unit
        design, target = design.reshape(k * n, -1), target.reshape(-1)
        gram = design.T @ design + np.eye(design.shape[1])
        descent = design.T @ target
        return float(target @ target - descent @ np.linalg.solve(gram, descent))
