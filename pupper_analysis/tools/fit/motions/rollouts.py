"""What a robot whose base is held would have done: simulations of a log's commands."""

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

from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import Servos
from pupper_analysis.simulation.rollout import full_state, roll_out, settled_activations
from pupper_analysis.tools.fit.estimate import Posterior
from pupper_analysis.tools.fit.measurements.log import Log
from pupper_analysis.tools.fit.parameters import AXES, ParameterTable, find_moved_link

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

SERVOS_SUBJECT = "servos"
"""Subject of the delay between commands and what servos do: one for all of them."""

DELAY_PARAMETERS = (
    ("delay", SERVOS_SUBJECT, "", 0.0),
    *(("lag", SERVOS_SUBJECT, p, 0.0) for p in ("command", "position")),
)
"""What a torque may follow late: commands by a delay, part of which smooths them as a lag does; and
by itself a position: a slow motor lags in both, a bus delays commands alone."""

BURN_IN_DURATION = 0.25
"""s: where a run begins, its velocity is not known to better than encoders tell: what that does
has decayed after some time constants kd / kp of servos (20 to 50 ms)."""

_STIFF = 0.5
"""Of a step times the fastest rate (kd + damping) / inertia: Runge-Kutta's error is 1e-4 of it."""

_FINEST = 20
"""Steps of the simulation between two samples, at most."""

_EXACT = 1e-11
"""Of the solver: what is not solved of dry friction is in derivatives by differences."""

_AT_ONCE = 8
"""Simulations of a run whose states are kept: 25 MB each for a minute of twelve joints."""

_FIRST = 9
"""Samples at a run's beginning through which a parabola gives where it begins, and how fast."""


@dataclass(frozen=True, eq=False)
class Run:
    """A part of a log that the clock does not jump in.

    Attributes:
        time: (n,) of the samples from its beginning on (s).
        position: (n, nu) measured (rad); NaN where missing.
        command: (n, nu) from a sample on (rad); of joints that are in no log, what holds them.
        start: (2, nu) joint positions and velocities at its beginning.
        counts: (n, nu) whether a position is one to fit.
        held_out: (n, nu) whether it is one to predict.
    """

    time: Array
    position: Array
    command: Array
    start: Array
    counts: NDArray[np.bool_]
    held_out: NDArray[np.bool_]


def split_runs(log: Log, rest: Array, hold_out: float) -> Iterator[Run]:
    """Yields the runs of a log.

    Args:
        log: With the robot's joints in its order.
        rest: (nu,) where joints that the log does not tell are held (rad).
        hold_out: Of each run's duration, at its end, what is not fitted.
    """
    ends = [0, *(jump + 1 for jump in log.jumps), len(log.time)]
    for first, last in pairwise(ends):
        part = log.select_rows(slice(first, last))
        time = part.time - part.time[0]
        if time[-1] < 4 * BURN_IN_DURATION:
            continue
        silent = ~np.isfinite(part.position).any(axis=0)
        command = np.where(silent, rest, _held(part.command))
        there = np.isfinite(part.position) & (time > BURN_IN_DURATION)[:, None]
        late = (time > (1 - hold_out) * time[-1])[:, None]
        begin = _beginning(time[:_FIRST], part.position[:_FIRST])
        begin = np.where(np.isfinite(begin), begin, [command[0], 0.0 * command[0]])
        yield Run(time, part.position, command, begin, there & ~late, there & late)


def _held(command: Array) -> Array:
    """Returns commands in which one that is missing is that before, or else the first."""
    filled = command.copy()
    for column in filled.T:
        known = np.flatnonzero(np.isfinite(column))
        if known.size:
            before = np.maximum(np.searchsorted(known, np.arange(len(column)), side="right") - 1, 0)
            column[:] = column[known[before]]
    return filled


def _beginning(time: Array, position: Array) -> Array:
    """Returns where joints (n, nu) begin, and how fast (2, nu), by a parabola; NaN if not known."""
    found = np.full((2, position.shape[1]), np.nan)
    for joint, column in enumerate(position.T):
        known = np.isfinite(column)
        if known.sum() > 3:
            curve = np.polynomial.Polynomial.fit(time[known], column[known], 2).convert().coef
            found[:, joint] = np.pad(curve, (0, 2))[:2]
    return found


class Simulator:
    """Simulates runs of a robot whose base is held, for vectors of parameters.

    Servos are tau = kp (command(t - delay) - encoder) - kd velocity, each command from its sample
    to the next; an encoder tells the joint's position and its offset.

    Args:
        robot: The robot.
        drive: Its servos.
        table: The parameters.
        interval: Between samples of the logs (s).
        steps: Of the simulation between two samples; by default what the stiffest joint needs.
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
        # Legs in the air do not touch; a log in which they did is told of. Nobody reads sensors,
        # and islands of one leg each are too small to be worth it.
        disable = mujoco.mjtDisableBit
        for needless in (disable.mjDSBL_CONTACT, disable.mjDSBL_SENSOR, disable.mjDSBL_ISLAND):
            model.opt.disableflags |= needless.value
        if not model.neq:  # dry friction alone: as many steps as there are joints at most
            model.opt.solver = mujoco.mjtSolver.mjSOL_CG.value
            model.opt.tolerance = _EXACT
        self._dofs, actuators = robot.mj_convention.qvel_index, robot.mj_convention.actuator_index
        self._driven = actuators >= 0
        self._motors = actuators[self._driven]
        mass = self._inertia()
        damping = drive.kd + model.dof_damping[self._dofs]
        needed = np.ceil((damping / mass).max(initial=0.0) * interval / _STIFF)
        self.steps = steps or int(np.clip(needed, 1, _FINEST))
        model.opt.timestep = interval / self.steps
        self._model = model
        self._workers = [mujoco.MjData(model) for _ in range(os.cpu_count() or 1)]
        self._models: list[mujoco.MjModel] = []
        self.groups = self.bodies.find_independent_groups(table)

    def _inertia(self) -> Array:
        """Returns what each joint alone moves (nu,), at home: of the mass matrix' inverse."""
        model, data = self.bodies.model, mujoco.MjData(self.bodies.model)
        self.robot.mj_convention.set_state(data, self.robot.home)
        mujoco.mj_forward(model, data)
        mass = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, mass)
        return np.asarray(1 / np.diag(np.linalg.inv(mass))[self._dofs])

    def with_steps(self, steps: int) -> Simulator:
        """Returns the same with other steps between two samples."""
        interval = self._model.opt.timestep * self.steps
        return Simulator(self.robot, self.drive, self.table, interval, steps)

    def predict_positions(self, run: Run, vectors: Sequence[Array]) -> Array:
        """Returns the encoders' positions (vectors, n, nu) that parameters predict for a run.

        Some at a time: states of all take much memory.
        """
        parts = range(0, len(vectors), _AT_ONCE)
        return np.concatenate([self._predict(run, vectors[at : at + _AT_ONCE]) for at in parts])

    def _predict(self, run: Run, vectors: Sequence[Array]) -> Array:
        while len(self._models) < len(vectors):
            self._models.append(copy.copy(self._model))  # meshes too: 20 ms
        models = self._models[: len(vectors)]
        for model, vector in zip(models, vectors, strict=True):
            self.set_parameters(model, vector)
        step = float(self._model.opt.timestep)
        count = int(np.ceil(run.time[-1] / step - 1e-9))
        commands = _mean_commands(run.time, run.command, step * np.arange(count + 1, dtype=float))
        offsets = [self._per_joint(vector, "offset", np.zeros(self.robot.nu)) for vector in vectors]
        controls, starts = [], []
        data = self._workers[0]
        lags = [self._late(vector, "command") for vector in vectors]
        waits = [self._late(vector) - lag for vector, lag in zip(vectors, lags, strict=True)]
        for model, lag, offset in zip(models, lags, offsets, strict=True):
            asked = self.drive.gear * (_smoothed(commands, lag / step) - offset)
            ctrl = np.zeros((len(asked), model.nu))
            ctrl[:, model.actuator_ctrladr[self._motors]] = asked[:, self._driven]
            self.robot.mj_convention.set_state(data, run.start[0] - offset, run.start[1])
            data.time = 0.0
            data.act[:] = settled_activations(model, ctrl[0])
            starts.append(full_state(model, data))
            controls.append(ctrl)
        states = roll_out(models, self._workers, np.array(starts), np.array(controls))
        states = np.concatenate([np.array(starts)[:, None], states], axis=1)
        # Commands that come later do the same later: steps begin where commands do.
        at, steps = self.robot.mj_convention, step * np.arange(states.shape[1])
        q, v = states[..., 1 + at.qpos_index], states[..., 1 + self._model.nq + at.qvel_index]
        found = [
            CubicHermiteSpline(steps, *own)(run.time - wait) + offset
            for *own, wait, offset in zip(q, v, waits, offsets, strict=True)
        ]
        return np.array(found)

    def _per_joint(self, vector: Array, kind: str, stated: Array) -> Array:
        return self.table.get_values(vector, kind, self.robot.joint_names, stated)

    def _late(self, vector: Array, part: str = "") -> float:
        return self.table.get_value(vector, "lag" if part else "delay", SERVOS_SUBJECT, part, 0.0)

    def replace_lag_derivatives(self, vector: Array, places: IntArray, jacobians: Array) -> None:
        """Makes derivatives by the positions' lag those by the damping and armature it amounts to.

        Nothing distinguishes them, and no error of differences must seem to.
        """
        kp, late = self._per_joint(vector, "kp", self.drive.kp), self._late(vector, "position")
        rates = np.zeros(len(self.table))
        for kind, own in (("damping", -kp), ("armature", 2 * kp * late)):
            for name, rate in zip(self.robot.joint_names, own.tolist(), strict=True):
                if (place := self.table.find_index(kind, name)) is not None:
                    rates[place] = rate
        if rates.any():
            lag = self.table.find_index("lag", SERVOS_SUBJECT, "position")
            jacobians[..., places == lag] = (jacobians @ rates[places])[..., None]

    def set_parameters(self, model: mujoco.MjModel, vector: Array) -> None:
        """Gives a model all of a vector of parameters.

        Dry friction and armature are not below zero; damping may be, where derivatives are made.
        """
        dofs, drive, stated = self._dofs, self.drive, self._model
        kp = np.maximum(self._per_joint(vector, "kp", drive.kp), 0.0)
        at, driven, squared = self._motors, self._driven, drive.gear[self._driven] ** 2
        late = self._late(vector, "position")
        model.actuator_gainprm[at, 0] = kp[driven] / squared
        model.actuator_biasprm[at, 1] = -kp[driven] / squared
        model.actuator_biasprm[at, 2] = (kp * late - drive.kd)[driven] / squared
        for kind, values, own in (
            ("damping", model.dof_damping, stated.dof_damping),
            ("friction", model.dof_frictionloss, stated.dof_frictionloss),
            ("armature", model.dof_armature, stated.dof_armature),
        ):
            least = -np.inf if kind == "damping" else 0.0
            values[dofs] = np.maximum(self._per_joint(vector, kind, own[dofs]), least)
        model.dof_armature[dofs] += kp * late**2
        self.bodies.set_parameters(model, self.table, vector)
        mujoco.mj_setConst(model, self._workers[-1])


def _mean_commands(time: Array, command: Array, edges: Array) -> Array:
    """Returns the means (k - 1, nu) between times (k,) of commands that stay until the next."""
    there = np.concatenate([[time[0] - 1.0], time, [time[-1] + 1.0]])
    steps = np.diff(there)[:, None] * np.vstack([command[:1], command])
    sums = np.vstack([np.zeros(command.shape[1]), np.cumsum(steps, axis=0)])
    whole = np.column_stack([np.interp(edges, there, column) for column in sums.T])
    return np.asarray(np.diff(whole, axis=0) / np.diff(edges)[:, None])


def _smoothed(command: Array, lag: float) -> Array:
    """Returns means (k, nu) of commands that are followed with a lag, in parts of a step.

    Of a lag below zero, what it is as much above: derivatives are made on both sides.
    """
    kept = math.exp(-1 / abs(lag)) if lag else 0.0
    off = command - command[0]
    begins = lfilter([0.0, 1 - kept], [1.0, -kept], off, axis=0)
    return np.asarray(command + (begins - off) * lag * (1 - kept))


# The moving bodies of a MuJoCo model: their inertials as parameters, and which feel each other.


class MovingBodies:
    """The bodies that a robot's joints move, each with those that are fixed to it.

    Masses and coms are those of all that a joint moves up to the next joint; they are named by
    the joint's link of the URDF, and coms are in its frame, that of Pinocchio's joint. With a mass
    its rotational inertia about the com is in proportion; a com that moves leaves it.

    Args:
        robot: A robot whose base is held.
        model: Its MuJoCo model.

    Attributes:
        model: A copy of the model, in which each body's inertial is that of all fixed to it.
        links: (nu,) the link of each joint.
        mass: (nu,) kg.
        com: (nu, 3) in the link's frame (m).
    """

    def __init__(self, robot: Robot, model: mujoco.MjModel) -> None:
        self.model = copy.copy(model)
        self._joints = [self.model.joint(name).id for name in robot.joint_names]
        self._bodies = self.model.jnt_bodyid[self._joints]
        self._names = robot.joint_names
        for body in dict.fromkeys(self._bodies.tolist()):
            self._gather(body)
            # Coms that move are nowhere that MuJoCo could take them for their body's origin.
            self.model.body_sameframe[body] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE.value
            self.model.body_simple[body] = 0
        self.model.dof_simplenum[:] = 0
        self._to_link = list(_link_frames(robot, self.model, self._bodies))
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

    def _gather(self, body: int) -> None:
        """Gives a body the inertial of all that is fixed to it."""
        model = self.model
        fixed = np.flatnonzero(model.body_weldid == body)
        if len(fixed) == 1:
            return
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        whole = pin.Inertia.Zero()
        for other in fixed:
            turned = data.ximat[other].reshape(3, 3)
            place = pin.SE3(turned, data.xipos[other])
            own = pin.Inertia(
                float(model.body_mass[other]), np.zeros(3), np.diag(model.body_inertia[other])
            )
            whole += place.act(own)
        own = pin.SE3(data.xmat[body].reshape(3, 3), data.xpos[body]).actInv(whole)
        values, axes = np.linalg.eigh(own.inertia)
        axes[:, 2] *= np.linalg.det(axes)
        model.body_mass[fixed], model.body_inertia[fixed] = 0.0, 0.0
        model.body_mass[body], model.body_ipos[body] = own.mass, own.lever
        model.body_inertia[body] = values
        mujoco.mju_mat2Quat(model.body_iquat[body], axes.ravel())

    def set_parameters(self, model: mujoco.MjModel, table: ParameterTable, vector: Array) -> None:
        """Writes masses and coms of a vector of parameters into a copy of ``model``."""
        for number, (link, body) in enumerate(zip(self.links, self._bodies, strict=True)):
            if self.mass[number] <= 0:
                continue
            least = MIN_MASS_FRACTION * self.mass[number]
            mass = max(table.get_value(vector, "mass", link, "", self.mass[number]), least)
            com = table.get_com(vector, link, self.com[number])
            model.body_mass[body] = mass
            model.body_inertia[body] = self._inertia[number] * mass / self.mass[number]
            model.body_ipos[body] = self._to_link[number].actInv(com)

    def find_independent_groups(self, table: ParameterTable) -> list[tuple[list[int], list[int]]]:
        """Returns groups of joints that do not feel each other, with the parameters of each.

        The base is held, so those are one that have a moving body in common; all are where loops,
        couplings or tendons are.
        """
        model = self.model
        roots = [_root(model, int(body)) for body in self._bodies]
        if model.neq or model.ntendon:
            roots = [0] * len(roots)
        found = []
        for root in dict.fromkeys(roots):
            joints = [number for number, own in enumerate(roots) if own == root]
            subjects = {name for at in joints for name in (self._names[at], self.links[at])}
            columns = [place for place, one in enumerate(table) if one.subject in subjects]
            found.append((joints, columns))
        return found

    def find_common_parameters(self, table: ParameterTable) -> list[int]:
        """Returns the parameters of no joint or link: those that act on all."""
        own = {*self._names, *self.links}
        return [place for place, one in enumerate(table) if one.subject not in own]


def _root(model: mujoco.MjModel, body: int) -> int:
    """Returns the first moving body on the way from the world to a body."""
    while model.body_weldid[model.body_parentid[body]] != 0:
        body = int(model.body_parentid[body])
    return int(model.body_weldid[body])


def _link_frames(
    robot: Robot, model: mujoco.MjModel, bodies: NDArray[np.int64]
) -> Iterator[pin.SE3]:
    """Yields how each joint's body frame of MuJoCo is placed in Pinocchio's frame of the joint."""
    data = mujoco.MjData(model)
    robot.mj_convention.set_state(data, robot.home)
    mujoco.mj_kinematics(model, data)
    by_pin = robot.pin_model.createData()
    pin.forwardKinematics(robot.pin_model, by_pin, robot.pin_convention.q(robot.home))
    base = _base_offset(robot, data, by_pin)
    for name, body in zip(robot.joint_names, bodies.tolist(), strict=True):
        there = pin.SE3(data.xmat[body].reshape(3, 3), data.xpos[body])
        yield (base * by_pin.oMi[robot.pin_model.getJointId(name)]).actInv(there)


def _base_offset(robot: Robot, data: mujoco.MjData, by_pin: pin.Data) -> pin.SE3:
    """Returns where Pinocchio's world is in MuJoCo's: the base is fixed where the MJCF has it."""
    model = robot.pin_model
    frame = model.frames[model.getFrameId(robot.base, pin.FrameType.BODY)]
    there = by_pin.oMi[frame.parentJoint] * frame.placement
    base = data.body(robot.mj_base)
    return pin.SE3(base.xmat.reshape(3, 3), base.xpos.copy()) * there.inverse()


# Coordinates of parameters in which forces are linear: first moments in place of coms.


MIN_MASS_FRACTION = 0.01
"""Of the stated mass: a lighter body's com is anywhere, and no simulation is of use."""


class MomentCoordinates:
    """A vector of parameters by first moments, and back.

    Gravity and inertia act by m and m c. A step that is good in them is none in m and c, as
    d(m c) = m dc + c dm + dm dc: where mass and com of a link are determined by their product
    alone, and each to no better than the prior, the last term was 20 standard deviations of what
    was measured.

    In place of a com c there stands c0 + (m / m0) (c - c0), c0 and m0 being the stated ones: a
    length, the com itself at the stated mass, and linear in the moment and the mass. Its prior is
    the com's. In place of a delay there stands what of it is no lag of commands: both are positive,
    and their sum is what is known.

    Args:
        table: The parameters.
    """

    def __init__(self, table: ParameterTable) -> None:
        pairs = []
        for place, one in enumerate(table):
            mass = table.find_index("mass", one.subject) if one.kind == "com" else None
            if mass is not None and one.component in AXES:
                pairs.append((place, mass))
        self._coms, self._masses = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
        self._stated_com, self._stated_mass = table.stated[self._coms], table.stated[self._masses]
        late = [
            table.find_index("delay", SERVOS_SUBJECT),
            table.find_index("lag", SERVOS_SUBJECT, "command"),
        ]
        self._late = np.array(late if None not in late else [], dtype=np.int64).reshape(-1, 2).T

    def _lightness(self, vector: Array) -> Array:
        """Returns m0 / m of each com."""
        least = MIN_MASS_FRACTION * self._stated_mass
        return np.asarray(self._stated_mass / np.maximum(vector[self._masses], least))

    def to_parameters(self, moments: Array) -> Array:
        """Returns parameters (n,) of moments (n,)."""
        found = moments.copy()
        off = moments[self._coms] - self._stated_com
        found[self._coms] = self._stated_com + self._lightness(moments) * off
        found[self._late[0]] += moments[self._late[1]]
        return found

    def from_parameters(self, vector: Array) -> Array:
        """Returns moments (n,) of parameters (n,)."""
        found = vector.copy()
        off = vector[self._coms] - self._stated_com
        found[self._coms] = self._stated_com + off / self._lightness(vector)
        found[self._late[0]] -= vector[self._late[1]]
        return found

    def differentiate_parameters(self, moments: Array) -> Array:
        """Returns how parameters change with moments (n, n)."""
        found, lightness = np.eye(len(moments)), self._lightness(moments)
        off = moments[self._coms] - self._stated_com
        found[self._coms, self._coms] = lightness
        found[self._coms, self._masses] = -(lightness**2) * off / self._stated_mass
        found[self._late[0], self._late[1]] = 1.0
        return found

    def transform_posterior(self, posterior: Posterior, covariance: Array) -> Posterior:
        """Returns what is known of parameters, of what is known of moments, linear about the best.

        Args:
            posterior: Of moments.
            covariance: (n, n) of them, in the priors' widths.
        """
        width = np.array([one.width for one in posterior.parameters])
        turn = self.differentiate_parameters(posterior.mean) * width / width[:, None]
        back = np.linalg.inv(turn)
        covariance = turn @ covariance @ turn.T
        return replace(
            posterior,
            mean=self.to_parameters(posterior.mean),
            covariance=width[:, None] * (covariance + covariance.T) / 2 * width,
            information=back.T @ posterior.information @ back,
            precision=back.T @ posterior.precision @ back,
        )
