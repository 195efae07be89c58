"""Simulation of logs: predicted encoder positions of a robot whose base is held.

`Simulator` predicts the positions of a `LogSegment` for parameter vectors. `MovingBodies` writes
masses and CoM positions into a MuJoCo model. `MomentCoordinates` replaces CoM positions by first
moments (mass times CoM), scaled to lengths.
"""

from __future__ import annotations

import copy
import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline
from scipy.signal import lfilter

from pupper_analysis.base.array_types import Array, IntArray
from pupper_analysis.base.progress import report_progress
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import Servos
from pupper_analysis.simulation.rollout import full_state, roll_out, settled_activations
from pupper_analysis.tools.fit.estimate import Posterior
from pupper_analysis.tools.fit.measurements.log import Log
from pupper_analysis.tools.fit.parameters import AXES, ParameterTable, find_moved_link

SERVOS_SUBJECT = "servos"
"""`Parameter.subject` of the delay and the lags, which are common to all servos."""

DELAY_PARAMETERS = (
    ("delay", SERVOS_SUBJECT, "", 0.0),
    *(("lag", SERVOS_SUBJECT, p, 0.0) for p in ("command", "position")),
)
"""Estimated delays, common to all servos: (kind, subject, component, stated value [s]) of each
`Parameter`. The stated value, 0 s, is the mean of the prior.

- ``delay``: delay of the commands [s], including the lag of the commands.
- ``lag``, ``command``: time constant [s] of a first-order lag of the commands.
- ``lag``, ``position``: time constant [s] of a first-order lag of the positions that the servo
  compares with the commands.
"""

BURN_IN_DURATION = 0.25
"""Time [s] at the start of each run in which positions are not compared. Runs shorter than four
times this time are left out. The initial velocity is only known from encoder readings. The error of
this velocity decays within some time constants kd / kp of the servos (for example 20 to 50 ms).
Chosen, not tuned.
"""

_MAX_STEP_RATE = 1.0
"""Upper bound of the product of time step [s] and fastest rate (kd + damping) / inertia [1/s]. The
time step is chosen to keep this bound, unless `_MAX_STEPS_PER_SAMPLE` prevents it. The Runge-Kutta
method is stable up to 2.8. Measured on a Panda arm (2 s, kd 3 to 30 N m s/rad): with this bound,
the standard deviations of the parameters differ from those of a quarter of the step by at most 1 %.
"""

_MAX_STEPS_PER_SAMPLE = 20
"""Upper bound of the default number of simulation steps per sample. Chosen, not tuned."""

_SOLVER_TOLERANCE = 1e-11
"""Tolerance of MuJoCo's CG solver (``mjOption.tolerance``, dimensionless). The tolerance is small
since the solver's error in dry friction would appear in finite differences. Chosen, not tuned.
"""

_MAX_BATCH_SIZE = 8
"""Largest number of simulations whose states are in memory at the same time. The bound limits the
memory. Chosen, not tuned.
"""

_NUM_START_SAMPLES = 9
"""Number of samples at the start of a run to which a parabola is fitted, for initial position and
velocity. Chosen, not tuned."""


@dataclass(frozen=True, eq=False)
class LogSegment:
    """Part of a log of joint motions without jumps of the clock.

    Attributes:
        time: Sample times from the start of the run, shape (n,) [s].
        position: Measured positions, shape (n, nu) [rad, m]; NaN if missing.
        command: Commands, shape (n, nu) [rad, m]; a command holds until the next sample. Joints
            without measurements in this part have a constant resting position.
        start: Encoder positions [rad, m] and velocities [rad/s, m/s] at the start, shape (2, nu).
        counts: True for positions that are fitted, shape (n, nu).
        held_out: True for positions that are only predicted, shape (n, nu).
    """

    time: Array
    position: Array
    command: Array
    start: Array
    counts: NDArray[np.bool_]
    held_out: NDArray[np.bool_]


def split_runs(log: Log, rest: Array, hold_out: float) -> Iterator[LogSegment]:
    """Split a log at clock jumps, and yield the parts (runs) of at least one second.

    Args:
        log: Log, joints in actuator order.
        rest: Positions, shape (nu,) [rad, m], at which joints without measurements are held.
        hold_out: Fraction (0 to 1) at the end of each run that is predicted, not fitted.
    """
    boundaries = [0, *(jump + 1 for jump in log.jumps), len(log.time)]
    for first, last in pairwise(boundaries):
        part = log.select_rows(slice(first, last))
        time = part.time - part.time[0]
        if time[-1] < 4 * BURN_IN_DURATION:
            continue
        not_in_log = ~np.isfinite(part.position).any(axis=0)
        command = np.where(not_in_log, rest, _fill_commands(part.command))
        measured = np.isfinite(part.position) & (time > BURN_IN_DURATION)[:, None]
        is_late = (time > (1 - hold_out) * time[-1])[:, None]
        initial_state = _fit_initial_state(
            time[:_NUM_START_SAMPLES], part.position[:_NUM_START_SAMPLES]
        )
        initial_state = np.where(
            np.isfinite(initial_state), initial_state, [command[0], 0.0 * command[0]]
        )
        yield LogSegment(
            time, part.position, command, initial_state, measured & ~is_late, measured & is_late
        )


def shorten_run(run: LogSegment, duration: float) -> LogSegment:
    """Return the start of a run in which all joints move about as much as in the whole run.

    The duration is doubled until the standard deviation of the positions of each joint is at least
    `_MIN_MOTION_FRACTION` times the standard deviation in the whole run.

    Args:
        run: Run with fitted positions.
        duration: Smallest duration [s].
    """

    def measure_motion(rows: slice) -> Array:
        counts = run.counts[rows]
        number = np.maximum(counts.sum(axis=0), 1)
        positions = np.where(counts, run.position[rows], 0.0)
        deviations = np.where(counts, positions - positions.sum(axis=0) / number, 0.0)
        return np.asarray(np.sqrt((deviations**2).sum(axis=0) / number))

    whole = measure_motion(slice(None))
    while duration < run.time[-1]:
        rows = slice(int(np.searchsorted(run.time, duration, side="right")))
        if (measure_motion(rows) >= _MIN_MOTION_FRACTION * whole).all():
            return replace(
                run,
                time=run.time[rows],
                position=run.position[rows],
                command=run.command[rows],
                counts=run.counts[rows],
                held_out=run.held_out[rows],
            )
        duration *= 2
    return run


_MIN_MOTION_FRACTION = 0.5
"""Smallest standard deviation of the positions of a joint in a shortened run, as a fraction of the
standard deviation in the whole run. Chosen, not tuned.
"""


def _fill_commands(command: Array) -> Array:
    """Return commands, shape (n, nu) [rad, m], with gaps (NaN) filled by the previous command.

    A gap at the start is filled by the next command; a joint without commands keeps NaN.
    """
    filled = command.copy()
    for column in filled.T:
        finite_rows = np.flatnonzero(np.isfinite(column))
        if finite_rows.size:
            previous = np.maximum(
                np.searchsorted(finite_rows, np.arange(len(column)), side="right") - 1, 0
            )
            column[:] = column[finite_rows[previous]]
    return filled


def _fit_initial_state(time: Array, position: Array) -> Array:
    """Fit initial positions [rad, m] and velocities [rad/s, m/s], shape (2, nu), by parabolas.

    ``time`` [s] has the shape (n,), ``position`` [rad, m] (n, nu). NaN for a joint with too few
    samples.
    """
    initial_state = np.full((2, position.shape[1]), np.nan)
    for joint, column in enumerate(position.T):
        is_finite = np.isfinite(column)
        if is_finite.sum() > 3:
            curve = (
                np.polynomial.Polynomial.fit(time[is_finite], column[is_finite], 2).convert().coef
            )
            initial_state[:, joint] = np.pad(curve, (0, 2))[:2]
    return initial_state


class Simulator:
    """Simulator that predicts the logged motion of a robot with a fixed base, for a fit.

    Servo law: tau = kp (command(t - delay) - encoder) - kd velocity. A command holds until the next
    sample. The encoder position is the joint position plus an offset. A part of the delay may be a
    first-order lag of the commands. A first-order lag of the encoder positions is replaced by its
    effect on damping and armature (`set_parameters`). Contacts, and the limits of joints with
    servos, are not simulated.

    Args:
        robot: Robot with a fixed base.
        drive: Servos.
        table: Parameters.
        interval: Sampling interval of the logs [s].
        steps: Simulation steps per sample; by default from the fastest rate (`_MAX_STEP_RATE`).
    """

    def __init__(
        self,
        robot: Robot,
        drive: Servos,
        table: ParameterTable,
        interval: float,
        steps: int | None = None,
    ) -> None:
        self.robot, self.drive, self.table = robot, drive, table
        self.bodies = MovingBodies(robot, drive.model)
        model = self.bodies.model
        model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4.value
        # Contacts do not occur in a hanging robot, sensors are not read, and islands of single
        # legs are too small to save time.
        disable = mujoco.mjtDisableBit
        for flag in (disable.mjDSBL_CONTACT, disable.mjDSBL_SENSOR, disable.mjDSBL_ISLAND):
            model.opt.disableflags |= flag.value
        if not model.neq:  # dry friction only: at most as many iterations as joints
            model.opt.solver = mujoco.mjtSolver.mjSOL_CG.value
            model.opt.tolerance = _SOLVER_TOLERANCE
        # A stop would let the interval of an offset end where the simulated joint touches the stop.
        joints = [model.joint(name).id for name in robot.joint_names]
        model.jnt_limited[np.array(joints)[drive.kp > 0]] = False
        self._dofs, actuators = robot.mj_convention.qvel_index, robot.mj_convention.actuator_index
        self._driven = actuators >= 0
        self._motors = actuators[self._driven]
        mass = self._compute_joint_inertia()
        damping = drive.kd + model.dof_damping[self._dofs]
        needed_steps = np.ceil((damping / mass).max(initial=0.0) * interval / _MAX_STEP_RATE)
        self.steps = steps or int(np.clip(needed_steps, 1, _MAX_STEPS_PER_SAMPLE))
        model.opt.timestep = interval / self.steps
        self._model = model
        self._workers = [mujoco.MjData(model) for _ in range(os.cpu_count() or 1)]
        self._models: list[mujoco.MjModel] = []
        self.groups = self.bodies.find_independent_groups(table)

    def _compute_joint_inertia(self) -> Array:
        """Return the inertia that each joint's motor alone accelerates, shape (nu,) [kg m^2, kg].

        The result is 1 / (M^-1)_jj, with the mass matrix M in the posture `Robot.home`.
        """
        model, data = self.bodies.model, mujoco.MjData(self.bodies.model)
        self.robot.mj_convention.set_state(data, self.robot.home)
        mujoco.mj_forward(model, data)
        mass = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, mass)
        return np.asarray(1 / np.diag(np.linalg.inv(mass))[self._dofs])

    def with_steps(self, steps: int) -> Simulator:
        """Create a simulator of the same robot with another number of steps per sample."""
        interval = self._model.opt.timestep * self.steps
        return Simulator(self.robot, self.drive, self.table, interval, steps)

    def predict_positions(self, run: LogSegment, vectors: Sequence[Array]) -> Array:
        """Predict the encoder positions of a run for several parameter vectors, by simulation.

        The result, joint positions plus encoder offsets, has the shape (k, n, nu) [rad, m] for k
        vectors and n samples.
        """
        batches = []
        for start in range(0, len(vectors), _MAX_BATCH_SIZE):
            report_progress("motions", start, len(vectors))
            batches.append(self._predict_batch(run, vectors[start : start + _MAX_BATCH_SIZE]))
        return np.concatenate(batches)

    def _predict_batch(self, run: LogSegment, vectors: Sequence[Array]) -> Array:
        """Predict the encoder positions of a run, shape (k, samples, nu) [rad, m]."""
        while len(self._models) < len(vectors):
            self._models.append(copy.copy(self._model))  # 20 ms, with the meshes
        models = self._models[: len(vectors)]
        for model, vector in zip(models, vectors, strict=True):
            self.set_parameters(model, vector)
        step = float(self._model.opt.timestep)
        count = int(np.ceil(run.time[-1] / step - 1e-9))
        commands = _average_commands(
            run.time, run.command, step * np.arange(count + 1, dtype=float)
        )
        offsets = [
            self._get_joint_values(vector, "offset", np.zeros(self.robot.nu)) for vector in vectors
        ]
        controls, starts = [], []
        data = self._workers[0]
        lags = [self._get_delay(vector, "command") for vector in vectors]
        delays = [self._get_delay(vector) - lag for vector, lag in zip(vectors, lags, strict=True)]
        for model, lag, offset in zip(models, lags, offsets, strict=True):
            targets = self.drive.gear * (_apply_lag(commands, lag / step) - offset)
            ctrl = np.zeros((len(targets), model.nu))
            ctrl[:, model.actuator_ctrladr[self._motors]] = targets[:, self._driven]
            self.robot.mj_convention.set_state(data, run.start[0] - offset, run.start[1])
            data.time = 0.0
            data.act[:] = settled_activations(model, ctrl[0])
            starts.append(full_state(model, data))
            controls.append(ctrl)
        states = roll_out(models, self._workers, np.array(starts), np.array(controls))
        states = np.concatenate([np.array(starts)[:, None], states], axis=1)
        # The commands are not delayed, so that steps start at their changes: the response is
        # shifted by the delay without the lag of commands.
        convention, steps = self.robot.mj_convention, step * np.arange(states.shape[1])
        q, v = (
            states[..., 1 + convention.qpos_index],
            states[..., 1 + self._model.nq + convention.qvel_index],
        )
        positions = [
            CubicHermiteSpline(steps, *series)(run.time - delay) + offset
            for *series, delay, offset in zip(q, v, delays, offsets, strict=True)
        ]
        return np.array(positions)

    def _get_joint_values(self, vector: Array, kind: str, stated: Array) -> Array:
        """Return the values of a parameter kind, shape (nu,); ``stated`` if not estimated."""
        return self.table.get_values(vector, kind, self.robot.joint_names, stated)

    def _get_delay(self, vector: Array, part: str = "") -> float:
        """Return the delay of commands [s]; with ``part``, a lag time constant of the servos [s].

        0 if the parameter is not estimated. ``part`` is ``command`` or ``position``.
        """
        return self.table.get_value(vector, "lag" if part else "delay", SERVOS_SUBJECT, part, 0.0)

    def replace_lag_derivatives(self, vector: Array, indices: IntArray, jacobians: Array) -> None:
        """Replace the derivative by the position lag by other derivatives, in place.

        To second order, a first-order lag of positions with time constant T is equivalent to a
        damping of -kp T and an armature of kp T^2. The derivative by T is the sum of -kp D + 2 kp T
        A over the joints, with the derivatives D by the damping and A by the armature of a joint.
        Nothing changes if a joint with parameters lacks damping or armature as a parameter.

        Args:
            vector: Parameters, shape (n,).
            indices: Indices of k parameters, shape (k,).
            jacobians: Derivatives by the k parameters, shape (samples, joints, k); changed in
                place.
        """
        kp, lag = (
            self._get_joint_values(vector, "kp", self.drive.kp),
            self._get_delay(vector, "position"),
        )
        joints = {parameter.subject for parameter in self.table} & {*self.robot.joint_names}
        for name in joints:
            if None in (self.table.find_index(kind, name) for kind in ("damping", "armature")):
                return
        coefficients = np.zeros(len(self.table))
        for kind, joint_rates in (("damping", -kp), ("armature", 2 * kp * lag)):
            for name, rate in zip(self.robot.joint_names, joint_rates.tolist(), strict=True):
                if (index := self.table.find_index(kind, name)) is not None:
                    coefficients[index] = rate
        if coefficients.any():
            lag_index = self.table.find_index("lag", SERVOS_SUBJECT, "position")
            jacobians[..., indices == lag_index] = (jacobians @ coefficients[indices])[..., None]

    def set_parameters(self, model: mujoco.MjModel, vector: Array) -> None:
        """Write a parameter vector into a model: servos, damping, friction, armature, masses, CoMs.

        Negative kp, dry friction and armature are replaced by 0. Damping may be negative, for
        finite differences about 0. A first-order lag of the measured positions with time constant T
        [s] is approximated by an armature kp T^2 and a damping -kp T.

        Args:
            model: Copy of the simulator's model; changed in place.
            vector: Parameters, shape (n,), each in its unit.
        """
        dofs, drive, stated = self._dofs, self.drive, self._model
        kp = np.maximum(self._get_joint_values(vector, "kp", drive.kp), 0.0)
        motors, driven, squared = self._motors, self._driven, drive.gear[self._driven] ** 2
        lag = self._get_delay(vector, "position")
        model.actuator_gainprm[motors, 0] = kp[driven] / squared
        model.actuator_biasprm[motors, 1] = -kp[driven] / squared
        model.actuator_biasprm[motors, 2] = (kp * lag - drive.kd)[driven] / squared
        for kind, values, stated_values in (
            ("damping", model.dof_damping, stated.dof_damping),
            ("friction", model.dof_frictionloss, stated.dof_frictionloss),
            ("armature", model.dof_armature, stated.dof_armature),
        ):
            lower_bound = -np.inf if kind == "damping" else 0.0
            values[dofs] = np.maximum(
                self._get_joint_values(vector, kind, stated_values[dofs]), lower_bound
            )
        model.dof_armature[dofs] += kp * lag**2
        self.bodies.set_parameters(model, self.table, vector)
        mujoco.mj_setConst(model, self._workers[-1])


def _average_commands(time: Array, command: Array, edges: Array) -> Array:
    """Return the mean commands between k times ``edges`` [s], shape (k - 1, nu) [rad, m].

    Each command, shape (n, nu), holds from its ``time``, shape (n,) [s], until the next.
    """
    boundaries = np.concatenate([[time[0] - 1.0], time, [time[-1] + 1.0]])
    steps = np.diff(boundaries)[:, None] * np.vstack([command[:1], command])
    sums = np.vstack([np.zeros(command.shape[1]), np.cumsum(steps, axis=0)])
    integrals = np.column_stack([np.interp(edges, boundaries, column) for column in sums.T])
    return np.asarray(np.diff(integrals, axis=0) / np.diff(edges)[:, None])


def _apply_lag(command: Array, lag: float) -> Array:
    """Return mean commands per time step after a first-order lag, shape (k, nu) [rad, m].

    The time constant ``lag`` is in time steps. A negative lag has the opposite effect, for finite
    differences about 0.
    """
    decay = math.exp(-1 / abs(lag)) if lag else 0.0
    deviations = command - command[0]
    filtered = lfilter([0.0, 1 - decay], [1.0, -decay], deviations, axis=0)
    return np.asarray(command + (filtered - deviations) * lag * (1 - decay))


# Moving bodies of a MuJoCo model, with their inertials as parameters.


class MovingBodies:
    """Bodies that a robot's joints move, each merged with the bodies fixed to it.

    The name of a body is the URDF link below the joint. The CoM is expressed in the frame of the
    Pinocchio joint, which is called link frame here. If a mass is changed, the rotational inertia
    about the CoM changes in proportion. The rotational inertia does not depend on the CoM position.

    Args:
        robot: Robot with a fixed base.
        model: MuJoCo model.

    Attributes:
        model: Copy of the model with merged inertials.
        links: Link of each joint (`find_moved_link`), shape (nu,).
        mass: Masses, shape (nu,) [kg].
        com: CoM positions in the link frames, shape (nu, 3) [m].
    """

    def __init__(self, robot: Robot, model: mujoco.MjModel) -> None:
        self.model = copy.copy(model)
        self._joints = [self.model.joint(name).id for name in robot.joint_names]
        self._bodies = self.model.jnt_bodyid[self._joints]
        self._names = robot.joint_names
        for body in dict.fromkeys(self._bodies.tolist()):
            self._merge_fixed_bodies(body)
            # MuJoCo must not treat a moved CoM as coincident with the body's origin.
            self.model.body_sameframe[body] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE.value
            self.model.body_simple[body] = 0
        self.model.dof_simplenum[:] = 0
        self._to_link = list(_compute_link_frames(robot, self.model, self._bodies))
        self.links = tuple(
            find_moved_link(robot.pin_model, robot.pin_model.getJointId(name))
            for name in robot.joint_names
        )
        self.mass = self.model.body_mass[self._bodies].copy()
        self._inertia = self.model.body_inertia[self._bodies].copy()
        self.com = np.array(
            [
                to_link.act(self.model.body_ipos[body])
                for to_link, body in zip(self._to_link, self._bodies, strict=True)
            ]
        )

    def _merge_fixed_bodies(self, body: int) -> None:
        """Move the masses and inertias of the bodies that are fixed to a body into this body."""
        model = self.model
        fixed = np.flatnonzero(model.body_weldid == body)
        if len(fixed) == 1:
            return
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        total_inertia = pin.Inertia.Zero()
        for fixed_body in fixed:
            rotation = data.ximat[fixed_body].reshape(3, 3)
            pose = pin.SE3(rotation, data.xipos[fixed_body])
            inertia = pin.Inertia(
                float(model.body_mass[fixed_body]),
                np.zeros(3),
                np.diag(model.body_inertia[fixed_body]),
            )
            total_inertia += pose.act(inertia)
        inertia = pin.SE3(data.xmat[body].reshape(3, 3), data.xpos[body]).actInv(total_inertia)
        values, axes = np.linalg.eigh(inertia.inertia)
        axes[:, 2] *= np.linalg.det(axes)
        model.body_mass[fixed], model.body_inertia[fixed] = 0.0, 0.0
        model.body_mass[body], model.body_ipos[body] = inertia.mass, inertia.lever
        model.body_inertia[body] = values
        mujoco.mju_mat2Quat(model.body_iquat[body], axes.ravel())

    def set_parameters(self, model: mujoco.MjModel, table: ParameterTable, vector: Array) -> None:
        """Write masses [kg] and CoM positions [m] of a parameter vector into a MuJoCo model.

        Values that are not estimated keep the values of the file. The rotational inertia is scaled
        with the mass, which is at least `MIN_MASS_FRACTION` of the stated mass.

        Args:
            model: Copy of the model with merged inertials; changed in place.
            table: Parameters.
            vector: Values of the parameters, shape (n,).
        """
        for joint, (link, body) in enumerate(zip(self.links, self._bodies, strict=True)):
            if self.mass[joint] <= 0:
                continue
            min_mass = MIN_MASS_FRACTION * self.mass[joint]
            mass = max(table.get_value(vector, "mass", link, "", self.mass[joint]), min_mass)
            com = table.get_com(vector, link, self.com[joint])
            model.body_mass[body] = mass
            model.body_inertia[body] = self._inertia[joint] * mass / self.mass[joint]
            model.body_ipos[body] = self._to_link[joint].actInv(com)

    def find_independent_groups(self, table: ParameterTable) -> list[tuple[list[int], list[int]]]:
        """Group the joints that affect each other, with the parameters of each group.

        Since the base is fixed, branches of the tree at the base are independent without equality
        constraints and tendons.

        Returns:
            For each group: indices of the joints, and indices of the parameters of the group's
                joints and links.
        """
        model = self.model
        roots = [_find_root_body(model, int(body)) for body in self._bodies]
        if model.neq or model.ntendon:
            roots = [0] * len(roots)
        groups = []
        for root in dict.fromkeys(roots):
            joints = [joint for joint, joint_root in enumerate(roots) if joint_root == root]
            subjects = {
                name
                for joint_index in joints
                for name in (self._names[joint_index], self.links[joint_index])
            }
            columns = [
                index for index, parameter in enumerate(table) if parameter.subject in subjects
            ]
            groups.append((joints, columns))
        return groups

    def find_common_parameters(self, table: ParameterTable) -> list[int]:
        """Return the indices of the parameters that belong to no joint or link.

        Such parameters affect the motion of all joints.
        """
        subjects = {*self._names, *self.links}
        return [index for index, parameter in enumerate(table) if parameter.subject not in subjects]


def _find_root_body(model: mujoco.MjModel, body: int) -> int:
    """Return the id of the first moving body on the path from the world to the body ``body``."""
    while model.body_weldid[model.body_parentid[body]] != 0:
        body = int(model.body_parentid[body])
    return int(model.body_weldid[body])


def _compute_link_frames(
    robot: Robot, model: mujoco.MjModel, bodies: NDArray[np.int64]
) -> Iterator[pin.SE3]:
    """Yield the pose [m] of the MuJoCo body of each joint in the frame of the Pinocchio joint.

    ``bodies`` are the ids of the bodies, shape (nu,), in actuator order.
    """
    data = mujoco.MjData(model)
    robot.mj_convention.set_state(data, robot.home)
    mujoco.mj_kinematics(model, data)
    by_pin = robot.pin_model.createData()
    pin.forwardKinematics(robot.pin_model, by_pin, robot.pin_convention.q(robot.home))
    world_offset = _compute_base_offset(robot, data, by_pin)
    for name, body in zip(robot.joint_names, bodies.tolist(), strict=True):
        body_pose = pin.SE3(data.xmat[body].reshape(3, 3), data.xpos[body])
        yield (world_offset * by_pin.oMi[robot.pin_model.getJointId(name)]).actInv(body_pose)


def _compute_base_offset(robot: Robot, data: mujoco.MjData, by_pin: pin.Data) -> pin.SE3:
    """Return the pose of Pinocchio's world in MuJoCo's world [m], if the two bases coincide.

    ``data`` and ``by_pin`` contain the kinematics of the engines at a configuration.
    """
    model = robot.pin_model
    frame = model.frames[model.getFrameId(robot.base, pin.FrameType.BODY)]
    base_pose = by_pin.oMi[frame.parentJoint] * frame.placement
    base = data.body(robot.mj_base)
    return pin.SE3(base.xmat.reshape(3, 3), base.xpos.copy()) * base_pose.inverse()


# Coordinates in which forces are linear: first moments.


MIN_MASS_FRACTION = 0.01
"""Lower bound of a mass in a simulation and in `MomentCoordinates`, as a fraction of the stated
mass. The CoM of a lighter body is hardly determined, and the simulation may be unstable. Chosen,
not tuned."""


class MomentCoordinates:
    """Coordinates in which gravity forces are linear: first moments instead of CoMs.

    These forces depend on the mass m and on the first moment m c, with the CoM c. A linear step in
    m and c has the error d(m c) - (m dc + c dm) = dm dc.

    A CoM c is replaced by c0 + (m / m0) (c - c0), with the stated values c0 and m0. This coordinate
    is a length, is equal to c at the stated mass, and is linear in moment and mass. The prior of
    the coordinate is the prior of c.

    If the delay and the lag of commands are both estimated, the delay is replaced by the delay
    minus the lag. The difference and the lag are not negative, and motions determine the sum of
    both.

    Args:
        table: Parameters.
    """

    def __init__(self, table: ParameterTable) -> None:
        pairs = []
        for index, parameter in enumerate(table):
            mass = table.find_index("mass", parameter.subject) if parameter.kind == "com" else None
            if mass is not None and parameter.component in AXES:
                pairs.append((index, mass))
        self._coms, self._masses = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
        self._stated_com, self._stated_mass = table.stated[self._coms], table.stated[self._masses]
        delay_pair = [
            table.find_index("delay", SERVOS_SUBJECT),
            table.find_index("lag", SERVOS_SUBJECT, "command"),
        ]
        self._delay_indices = (
            np.array(delay_pair if None not in delay_pair else [], dtype=np.int64).reshape(-1, 2).T
        )

    def _compute_mass_ratio(self, vector: Array) -> Array:
        """Return stated / current mass for each CoM coordinate whose body has an estimated mass.

        The current mass counts as at least `MIN_MASS_FRACTION` of the stated mass.
        """
        min_mass = MIN_MASS_FRACTION * self._stated_mass
        return np.asarray(self._stated_mass / np.maximum(vector[self._masses], min_mass))

    def to_parameters(self, moments: Array) -> Array:
        """Convert first-moment coordinates, shape (n,), to physical parameters, shape (n,).

        If the mass m of a body is estimated, a component of its CoM is

            c = c0 + (m0 / m) (coordinate - c0) [m],

        with the stated values c0 and m0, and m at least `MIN_MASS_FRACTION` m0. If delay and lag of
        the servo commands are both estimated [s], the delay is its coordinate plus the lag.
        """
        vector = moments.copy()
        deviation = moments[self._coms] - self._stated_com
        vector[self._coms] = self._stated_com + self._compute_mass_ratio(moments) * deviation
        vector[self._delay_indices[0]] += moments[self._delay_indices[1]]
        return vector

    def from_parameters(self, vector: Array) -> Array:
        """Convert physical parameters, shape (n,), to first-moment coordinates, shape (n,).

        A CoM component c [m] of a body with an estimated mass m [kg] becomes c0 + (m / m0) (c -
        c0), with the stated values c0 and m0, and m at least `MIN_MASS_FRACTION` m0. The delay [s]
        becomes the delay minus the time constant of the lag of commands, if both are estimated.
        """
        moments = vector.copy()
        deviation = vector[self._coms] - self._stated_com
        moments[self._coms] = self._stated_com + deviation / self._compute_mass_ratio(vector)
        moments[self._delay_indices[0]] -= vector[self._delay_indices[1]]
        return moments

    def differentiate_parameters(self, moments: Array) -> Array:
        """Compute the Jacobian of `to_parameters` at coordinates (n,), shape (n, n)."""
        derivative, mass_ratio = np.eye(len(moments)), self._compute_mass_ratio(moments)
        deviation = moments[self._coms] - self._stated_com
        derivative[self._coms, self._coms] = mass_ratio
        is_above = moments[self._masses] > MIN_MASS_FRACTION * self._stated_mass
        rates = -(mass_ratio**2) * deviation / self._stated_mass
        derivative[self._coms, self._masses] = np.where(is_above, rates, 0.0)
        derivative[self._delay_indices[0], self._delay_indices[1]] = 1.0
        return derivative

    def transform_posterior(self, posterior: Posterior, covariance: Array) -> Posterior:
        """Convert a distribution of first-moment coordinates to a distribution of the parameters.

        ``covariance`` is that of the coordinates, shape (n, n), in units of the prior widths. The
        conversion is linearised about the mean. ``Posterior.moved`` is not converted.
        """
        width = np.array([parameter.width for parameter in posterior.parameters])
        transform = self.differentiate_parameters(posterior.mean) * width / width[:, None]
        inverse = np.linalg.inv(transform)
        covariance = transform @ covariance @ transform.T
        return replace(
            posterior,
            mean=self.to_parameters(posterior.mean),
            covariance=width[:, None] * (covariance + covariance.T) / 2 * width,
            information=inverse.T @ posterior.information @ inverse,
            precision=inverse.T @ posterior.precision @ inverse,
        )
