"""Where robots are pushed: simulations with a force on the base, and what comes of them."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arguments import check_arguments, check_finite
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.simulation import monitor
from pupper_analysis.simulation.monitor import SimulationSettings
from pupper_analysis.simulation.rollout import (
    FORCED_CONTROL_SPEC,
    StandStart,
    check_stand,
    make_forced_controls,
    make_stand_start,
    roll_out,
)
from pupper_analysis.simulation.stability import evaluate_stability
from pupper_analysis.simulation.verify import StandVerification, verify_stand
from pupper_analysis.stance.stand import Stand

Array = NDArray[np.float64]

PULSE_DURATION = 0.02
"""How long a push lasts (s), rounded to whole time steps: short against a fall of some 0.3 s."""

MAX_RESTING_SPEED = 0.01
"""A base that is faster than this in the last half second has not come to rest (m/s), where it
creeps by no more without a push."""

_REST = 0.5  # s

_PART = 0.5
"""After each such part of its time a simulation may end early (s). In half as long, v3-long-leg's
lulls on the way down pass for rest, and the proof of its limits has to begin anew."""

_LULL = 0.1
"""Time for which all must be slow before its spectrum is looked at (s)."""

_REST_SPEED = 0.02
"""What is faster in it, of all coordinates, is not at rest yet (m/s, rad/s). A robot that almost
tips is as slow for a while: its spectrum distinguishes it from one that stands."""

_SAMPLE_TIME = 0.004  # s between the states whose contacts are looked at
_BATCH = 2**25  # numbers (of 8 bytes) that a rollout may take


@dataclass(frozen=True, eq=False)
class PushSettings(SimulationSettings):
    """What a stand was pushed with, and simulated with.

    Attributes:
        point: (3,) where the push acts: the com of the base's body, in the stand (m).
        pulse: How long the push lasts (s).
    """

    point: Array = field(metadata={"unit": "m"})
    pulse: float = field(metadata={"unit": "s"})


@dataclass(eq=False)
class PushBench:
    """Where a robot is pushed; counts how often.

    Attributes:
        held: What stands there, just before the push.
        axes: (n, 2) the directions, unit vectors in the world.
        duration: Of a simulation (s).
        feedforward: Whether the command feeds the stand's torques forward.
        unpushed: Why it does not even stand without a push, as ``verify_stand`` finds; empty if it
            does, as predicted or not.
    """

    held: StandStart
    axes: Array
    duration: float
    feedforward: bool
    unpushed: tuple[Diagnostic, ...]
    rollouts: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        held = self.held
        self.robot, self.stand, self.drive = held.robot, held.stand, held.drive
        self.start, self.ctrl = held.start, held.ctrl
        model = self.drive.model
        self.upright = monitor.StandReference.of(
            self.robot, self.stand.qpos, self.stand.task.rotation()
        )
        self.timestep = float(model.opt.timestep)
        self.steps = round(self.duration / self.timestep)
        self.pulse_steps = max(1, round(PULSE_DURATION / self.timestep))
        self.watcher = monitor.ContactSampler(self.robot, model)
        self.workers = [mujoco.MjData(model) for _ in range(os.cpu_count() or 1)]

    @cached_property
    def creep(self) -> float:
        """How fast the base moves at the end without a push (m/s): on a slope friction creeps."""
        (states,) = self.simulate_pushes(np.zeros(1, dtype=np.int64), np.zeros(1))
        return self._last_speed(states)

    def simulate_fully(
        self, directions: NDArray[np.int64], impulses: Array
    ) -> list[Diagnostic | None]:
        """Simulates pushes to the end, and says of each how the robot fails, or None."""
        return [self.find_failure(run) for run in self.simulate_pushes(directions, impulses)]

    def simulate_until_decided(
        self, directions: NDArray[np.int64], impulses: Array
    ) -> list[Diagnostic | None]:
        """Says the same, but ends each simulation once its result is known.

        That is where something else than feet touches the ground, and where it is at rest with no
        mode that grows.
        """
        count = len(directions)
        found: list[Diagnostic | None] = [None] * count
        tails = [np.empty((0, len(self.start)))] * count
        going, starts = list(range(count)), np.tile(self.start, (count, 1))
        forces = self._forces(directions, impulses)
        part = max(self.pulse_steps, round(_PART / self.timestep))
        self.rollouts += count
        for begin in range(0, self.steps, part):
            steps = min(part, self.steps - begin)
            ended, last = [], begin + steps == self.steps
            runs = self._run(starts[going], forces[going], steps, pushed=begin == 0)
            for index, states in zip(list(going), runs, strict=True):
                starts[index] = states[-1]
                tails[index] = np.concatenate([tails[index], states])[-self._resting :]
                sure = self._broken(states)
                if sure is None and last:
                    sure = _combine(self._unsettled(tails[index]))
                    ended.append(index)
                elif sure is not None or self._rests(states):
                    ended.append(index)
                found[index] = sure
            going = [index for index in going if index not in ended]
            if not going:
                break
        return found

    def simulate_pushes(self, directions: NDArray[np.int64], impulses: Array) -> Iterator[Array]:
        """Simulates pushes and yields, of each, the states after each step (n, size).

        Args:
            directions: (n,) which of the axes.
            impulses: (n,) how hard (N s).
        """
        self.rollouts += len(directions)
        starts = np.tile(self.start, (len(directions), 1))
        yield from self._run(starts, self._forces(directions, impulses), self.steps, pushed=True)

    def _forces(self, directions: NDArray[np.int64], impulses: Array) -> Array:
        """Returns the forces (n, 2) of pushes (N)."""
        forces: Array = impulses[:, None] * self.axes[directions]
        return forces / (self.pulse_steps * self.timestep)

    def _run(self, starts: Array, forces: Array, steps: int, *, pushed: bool) -> Iterator[Array]:
        """Simulates some steps from states on (n, size), with forces in the first ones or not."""
        model = self.drive.model
        width = model.nu + 6 * model.nbody
        size = max(1, _BATCH // (steps * (width + len(self.start))))
        for begin in range(0, len(forces), size):
            batch = forces[begin : begin + size]
            control, force = make_forced_controls(self.robot, model, self.ctrl, len(batch), steps)
            if pushed:
                force[:, : self.pulse_steps, :2] = batch[:, None]
            workers = self.workers[: len(batch)]
            first = starts[begin : begin + size]
            yield from roll_out(model, workers, first, control, control_spec=FORCED_CONTROL_SPEC)

    def find_failure(self, states: Array) -> Diagnostic | None:
        """Returns why a run is no recovery, or None if it is one."""
        broken = self._broken(states)
        if broken is not None and monitor.has_diverged(states, self.timestep):
            return broken
        failures = [] if broken is None else [broken]
        return _combine(failures + self._unsettled(states))

    def _broken(self, states: Array) -> Diagnostic | None:
        """Says so if some states cannot be part of a recovery, whatever comes next."""
        if monitor.has_diverged(states, self.timestep):
            return monitor.describe_divergence(self.drive.integrator, self.timestep)
        for state in states[:: max(1, round(_SAMPLE_TIME / self.timestep))]:
            if touching := sorted(self.watcher.find_ground_bodies(state)):
                moment = Quantity(self.watcher.data.time, "s")
                return diagnose("body-touches-ground", subject=("body", touching[0]), time=moment)
        return None

    def _unsettled(self, states: Array) -> list[Diagnostic]:
        """Says how it does not stand at the end of some states, of half a second or more."""
        failures = []
        if self.upright.has_fallen(states[-1]):
            height = float(monitor.base_heights(self.robot, states[-1]))
            failures.append(monitor.describe_fall(self.upright.tilt(states[-1]), height))
        speed = self._last_speed(states)
        if speed > MAX_RESTING_SPEED and speed > MAX_RESTING_SPEED + self.creep:
            failures.append(diagnose("not-at-rest", speed=Quantity(speed, "m/s")))
        return failures

    @property
    def _resting(self) -> int:
        """In how many states at the end it must rest."""
        return round(_REST / self.timestep)

    def _last_speed(self, states: Array) -> float:
        """Returns the greatest speed of the base at the end: linear, plus angular x size (m/s)."""
        last = states[-self._resting :, 1 + self.drive.model.nq :]
        rates = last[:, self.robot.mj_convention.qvel_index[:6]]
        linear, angular = (np.linalg.norm(part, axis=1) for part in (rates[:, :3], rates[:, 3:]))
        return float((linear + self.upright.com_height * angular).max())

    def _rests(self, states: Array) -> bool:
        """Tells whether it has come to rest where it stands, and stays."""
        model = self.drive.model
        rates = states[-round(_LULL / self.timestep) :, 1 + model.nq :][:, : model.nv]
        if np.abs(rates).max(initial=0.0) > _REST_SPEED:
            return False
        end = states[-1]
        if self.upright.has_fallen(end):
            return False
        return evaluate_stability(self.drive, end, self.ctrl, 0.0).lasts()

    def peak_torques(self, direction: int, impulse: float) -> Array:
        """Return the largest |torque| of each motor during a push, shape (nu,) [N m].

        Args:
            direction: Index of the axis.
            impulse: N s.
        """
        (states,) = self.simulate_pushes(np.array([direction]), np.array([impulse]))
        dofs = self.robot.mj_convention.qvel_index[-self.robot.nu :]
        peaks = np.zeros(self.robot.nu)
        for state in states[:: max(1, round(_SAMPLE_TIME / self.timestep))]:
            self.watcher.sample(state, self.ctrl)
            peaks = np.maximum(peaks, np.abs(self.watcher.data.qfrc_actuator[dofs]))
        return peaks

    def point(self) -> Array:
        """Returns where MuJoCo applies the push (3,), at the com of the base's body (m)."""
        data = self.robot.placed(self.stand.qpos)
        return np.array(data.xipos[self.robot.mj_model.body(self.robot.mj_base).id])

    def settings(self) -> dict[str, Any]:
        """Returns the fields of ``PushSettings``."""
        return {
            "feedforward": self.feedforward,
            "integrator": self.drive.integrator,
            "timestep": self.timestep,
            "duration": self.steps * self.timestep,
            "kp": self.drive.kp,
            "kd": self.drive.kd,
            "point": self.point(),
            "pulse": self.pulse_steps * self.timestep,
        }


def _combine(failures: list[Diagnostic]) -> Diagnostic | None:
    """Returns failures of one push as one; None if there are none."""
    if len(failures) < 2:
        return failures[0] if failures else None
    return diagnose("failures-together", failures=failures)


def make_push_bench(
    robot: Robot,
    stand: Stand,
    angles: Array,
    *,
    duration: float,
    kp: ArrayLike | None,
    kd: ArrayLike | None,
    feedforward: bool,
    integrator: str | None,
    verification: StandVerification | None = None,
) -> PushBench:
    """Puts a robot where it can be pushed; see ``push_recovery``.

    Args:
        robot: The robot.
        stand: How it stands.
        angles: (n,) directions, about the vertical from the base's forward (rad).
        duration: Simulated time (s).
        kp: Servo stiffness (N m/rad); the model's own if None.
        kd: Servo damping (N m s/rad); the model's own if None.
        feedforward: Command ctrl = q* + tau / kp instead of ctrl = q*.
        integrator: MuJoCo's integrator; the model's own if None.
        verification: What ``verify_stand`` finds so; None: it is asked.

    Raises:
        ConfigurationError: If an argument is out of its range.
        ModelError: If the model has no servos and no gains are given.
        StaticsInfeasibleError: If no contact forces balance the stand.
    """
    forward = Configuration(robot, stand.qpos).base_rotation()[:2, 0]
    alone = verification or verify_stand(
        robot, stand, feedforward=feedforward, kp=kp, kd=kd, integrator=integrator
    )
    held = make_stand_start(
        robot, stand, feedforward=feedforward, kp=kp, kd=kd, integrator=integrator
    )
    in_world = angles + math.atan2(forward[1], forward[0])
    return PushBench(
        held=held,
        axes=np.column_stack([np.cos(in_world), np.sin(in_world)]),
        duration=duration,
        feedforward=feedforward,
        unpushed=() if alone.stays else alone.failures,
    )


_FRAME = 1 / 30
"""s between the configurations that are kept: a fall of 0.3 s has ten of them."""

MAX_IMPULSE = 1e6  # N s: of much more, numbers overflow


@dataclass(frozen=True, eq=False)
class PushTrial(PushSettings):
    """What one push makes of a stand, and how it was ``PushSettings``.

    Attributes:
        recovered: Whether it recovers, as ``push_recovery`` judges it.
        failure: If not, why; else None.
        impulse: N s.
        direction: Where to, about the vertical (rad): 0 is the base's forward, pi/2 its left.
        velocity_step: impulse / mass (m/s).
        motion_time: (m,) samples from the push on (s).
        motion: (m, nq) the configurations at these, to six digits: to be looked at.
    """

    recovered: bool
    failure: Diagnostic | None
    impulse: float = field(metadata={"unit": "N s"})
    direction: float = field(metadata={"unit": "rad"})
    velocity_step: float = field(metadata={"unit": "m/s"})
    motion_time: Array = field(metadata={"unit": "s"})
    motion: Array = field(metadata={"unit": "m, 1 (quaternion) and rad"})


@check_arguments
def simulate_push(
    robot: Robot,
    stand: Stand,
    impulse: float,
    direction: float = 0.0,
    *,
    duration: float = 6.0,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
    feedforward: bool = True,
    integrator: str | None = None,
) -> PushTrial:
    """Pushes a stand once; ``push_recovery`` finds the largest push from which it recovers.

    The push and what counts as recovery are those of ``push_recovery``; what does not stand without
    a push recovers from none.

    Args:
        robot: The robot.
        stand: How it stands.
        impulse: How hard it is pushed (N s).
        direction: Where to, about the vertical (rad): 0 is the base's forward, pi/2 its left.
        duration: Simulated time from the push on (s), at least 2.
        kp: Servo stiffness (N m/rad); the model's own by default.
        kd: Servo damping (N m s/rad); the model's own by default.
        feedforward: Command ctrl = q* + tau / kp instead of ctrl = q*.
        integrator: MuJoCo's integrator; the model's own by default.

    Returns:
        What comes of it, with the motion.

    Raises:
        ConfigurationError: If an argument is out of its range, or the base is fixed.
        ModelError: If the model has no servos and no gains are given.
        StaticsInfeasibleError: If no contact forces balance the stand.
    """
    robot = check_stand(robot, stand, duration)
    robot.check_not_welded("how hard it can be pushed")
    impulse, direction = check_finite("impulse", impulse), check_finite("direction", direction)
    if not 0 <= impulse <= MAX_IMPULSE:
        problem = diagnose("impulse-not-valid", given=Quantity(impulse, "N s"), most=MAX_IMPULSE)
        raise ConfigurationError("impulse", problem)
    if abs(direction) > 2 * math.pi:
        problem = diagnose("direction-not-valid", given=Quantity(direction, "rad"))
        raise ConfigurationError("direction", problem)
    bench = make_push_bench(
        robot,
        stand,
        np.array([direction]),
        duration=duration,
        kp=kp,
        kd=kd,
        feedforward=feedforward,
        integrator=integrator,
    )
    (states,) = bench.simulate_pushes(np.zeros(1, dtype=np.int64), np.array([impulse]))
    failure = bench.find_failure(states)
    if bench.unpushed:
        failure = diagnose("without-a-push", failures=bench.unpushed)
    # What a run was before it broke down can still be looked at.
    shown = states[:: max(1, round(_FRAME / bench.timestep))]
    shown = shown[np.isfinite(shown).all(axis=1)]
    return PushTrial(
        recovered=failure is None,
        failure=failure,
        impulse=impulse,
        direction=direction,
        velocity_step=impulse / robot.total_mass,
        motion_time=shown[:, 0].copy(),
        motion=np.round(shown[:, 1 + robot.mj_convention.qpos_index], 6),
        **bench.settings(),
    )
