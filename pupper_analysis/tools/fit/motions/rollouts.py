"""What a robot whose base is held would have done: simulations of a log's commands."""

from __future__ import annotations

import copy
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import Servos
from pupper_analysis.simulation.rollout import full_state, roll_out, settled_activations
from pupper_analysis.tools.fit.measurements.log import Log
from pupper_analysis.tools.fit.motions.bodies import MovingBodies
from pupper_analysis.tools.fit.parameters import ParameterTable

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

SERVOS = "servos"
"""Subject of the delay between commands and what servos do: one for all of them."""

BURN_IN = 0.25
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

    def until(self, moment: float) -> Run:
        """Returns its beginning, up to a moment (s)."""
        rows = slice(0, max(int(np.searchsorted(self.time, moment)), 2))
        return replace(
            self,
            time=self.time[rows],
            position=self.position[rows],
            command=self.command[rows],
            counts=self.counts[rows],
            held_out=self.held_out[rows],
        )


def split_runs(log: Log, jumps: Sequence[int], rest: Array, hold_out: float) -> Iterator[Run]:
    """Yields the runs of a log.

    Args:
        log: With the robot's joints in its order.
        jumps: After which samples the clock jumps.
        rest: (nu,) where joints that the log does not tell are held (rad).
        hold_out: Of each run's duration, at its end, what is not fitted.
    """
    ends = [0, *(jump + 1 for jump in jumps), len(log.time)]
    for first, last in pairwise(ends):
        part = log.part(slice(first, last))
        time = part.time - part.time[0]
        if time[-1] < 4 * BURN_IN:
            continue
        silent = ~np.isfinite(part.position).any(axis=0)
        command = np.where(silent, rest, _held(part.command))
        there = np.isfinite(part.position) & (time > BURN_IN)[:, None]
        late = (time > (1 - hold_out) * time[-1])[:, None]
        begin = _beginning(time[:_FIRST], part.position[:_FIRST])
        begin[0] = np.where(np.isfinite(begin[0]), begin[0], command[0])
        begin[1] = np.where(np.isfinite(begin[1]), begin[1], 0.0)
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
        self._dofs = robot.mj_convention.qvel_index
        self.steps = steps or self._steps_needed(interval)
        model.opt.timestep = interval / self.steps
        self._model = model
        self._workers = [mujoco.MjData(model) for _ in range(os.cpu_count() or 1)]
        self._models: list[mujoco.MjModel] = []
        self.groups = self.bodies.groups(table)

    def _steps_needed(self, interval: float) -> int:
        model, data = self.bodies.model, mujoco.MjData(self.bodies.model)
        self.robot.mj_convention.set_state(data, self.robot.home)
        mujoco.mj_forward(model, data)
        mass = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, mass)
        damping = self.drive.kd + model.dof_damping[self._dofs]
        # Diagonal of the inverse: how easily a joint alone is moved.
        fastest = (damping * np.diag(np.linalg.inv(mass))[self._dofs]).max(initial=0.0)
        return int(np.clip(np.ceil(fastest * interval / _STIFF), 1, _FINEST))

    def with_steps(self, steps: int) -> Simulator:
        """Returns the same with other steps between two samples."""
        interval = self._model.opt.timestep * self.steps
        return Simulator(self.robot, self.drive, self.table, interval, steps)

    def predict(self, run: Run, vectors: Sequence[Array] | Array) -> Array:
        """Returns the encoders' positions (vectors, n, nu) that parameters predict for a run."""
        while len(self._models) < len(vectors):
            self._models.append(copy.copy(self._model))  # meshes too: 20 ms
        models = self._models[: len(vectors)]
        for model, vector in zip(models, vectors, strict=True):
            self.put(model, vector)
        step = float(self._model.opt.timestep)
        count = int(np.ceil(run.time[-1] / step - 1e-9))
        commands = _Integral(run.time, run.command).means(step * np.arange(count + 1, dtype=float))
        offsets = [self._per_joint(vector, "offset", 0.0) for vector in vectors]
        controls, starts = [], []
        data = self._workers[0]
        for model, offset in zip(models, offsets, strict=True):
            ctrl = self._controls(commands - offset)
            self.robot.mj_convention.set_state(data, run.start[0] - offset, run.start[1])
            data.time = 0.0
            data.act[:] = settled_activations(model, ctrl[0])
            starts.append(full_state(model, data))
            controls.append(ctrl)
        states = roll_out(models, self._workers, np.array(starts), np.array(controls))
        states = np.concatenate([np.array(starts)[:, None], states], axis=1)
        # Commands that come later do the same later: steps begin where commands do.
        found = np.array(
            [
                self._at(whole, np.maximum(run.time - self._delay(vector), 0.0), step)
                for whole, vector in zip(states, vectors, strict=True)
            ]
        )
        return found + np.array(offsets)[:, None, :]

    def _at(self, states: Array, time: Array, step: float) -> Array:
        """Returns joint positions (n, nu) at some times, by Hermite's cubic between steps."""
        place = np.minimum((time / step + 1e-9).astype(int), len(states) - 2)
        share = (time / step - place)[:, None]
        position = 1 + self.robot.mj_convention.qpos_index
        velocity = 1 + self._model.nq + self._dofs
        before, after, back = states[place], states[place + 1], 1 - share
        p, q = before[:, position], after[:, position]
        v, w = step * before[:, velocity], step * after[:, velocity]
        found: Array = back**2 * ((1 + 2 * share) * p + share * v)
        found += share**2 * ((1 + 2 * back) * q - back * w)
        return found

    def _controls(self, command: Array) -> Array:
        """Returns ctrl (n, model.nu) of commanded joint positions (n, nu)."""
        actuators = self.robot.mj_convention.actuator_index
        driven = actuators >= 0
        ctrl = np.zeros((len(command), self._model.nu))
        columns = self._model.actuator_ctrladr[actuators[driven]]
        ctrl[:, columns] = (self.drive.gear * command)[:, driven]
        return ctrl

    def _delay(self, vector: Array) -> float:
        return max(self.table.value(vector, "delay", SERVOS, "", 0.0), 0.0)

    def _per_joint(self, vector: Array, kind: str, stated: Array | float) -> Array:
        own = np.broadcast_to(stated, (self.robot.nu,))
        return np.array(
            [
                self.table.value(vector, kind, name, "", value)
                for name, value in zip(self.robot.joint_names, own.tolist(), strict=True)
            ]
        )

    def put(self, model: mujoco.MjModel, vector: Array) -> None:
        """Gives a model all of a vector of parameters. What cannot be below zero is zero there."""
        dofs, drive, stated = self._dofs, self.drive, self._model
        kp = np.maximum(self._per_joint(vector, "kp", drive.kp), 0.0)
        kd = np.maximum(self._per_joint(vector, "kd", drive.kd), 0.0)
        actuators = self.robot.mj_convention.actuator_index
        driven = actuators >= 0
        at, squared = actuators[driven], drive.gear[driven] ** 2
        model.actuator_gainprm[at, 0] = kp[driven] / squared
        model.actuator_biasprm[at, 1] = -kp[driven] / squared
        model.actuator_biasprm[at, 2] = -kd[driven] / squared
        for kind, values, own in (
            ("damping", model.dof_damping, stated.dof_damping),
            ("friction", model.dof_frictionloss, stated.dof_frictionloss),
            ("armature", model.dof_armature, stated.dof_armature),
        ):
            values[dofs] = np.maximum(self._per_joint(vector, kind, own[dofs]), 0.0)
        self.bodies.put(model, self.table, vector)
        mujoco.mj_setConst(model, self._workers[-1])

    def predict_all(self, run: Run, vectors: Array) -> Array:
        """Returns predictions for many vectors, some at a time: states of all take much memory."""
        parts = range(0, len(vectors), _AT_ONCE)
        return np.concatenate([self.predict(run, vectors[at : at + _AT_ONCE]) for at in parts])


class _Integral:
    """The integral of commands that stay from sample to sample."""

    def __init__(self, time: Array, command: Array) -> None:
        self._time = np.concatenate([[time[0] - 1.0], time, [time[-1] + 1.0]])
        steps = np.diff(self._time)[:, None] * np.vstack([command[:1], command])
        self._sum = np.vstack([np.zeros(command.shape[1]), np.cumsum(steps, axis=0)])

    def means(self, edges: Array) -> Array:
        """Returns the mean commands (n - 1, nu) between times (n,)."""
        whole = np.column_stack([np.interp(edges, self._time, column) for column in self._sum.T])
        means: Array = np.diff(whole, axis=0) / np.diff(edges)[:, None]
        return means
