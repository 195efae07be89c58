"""Simulate stands with a force on the base, and judge whether the robot recovers.

`PushBench` simulates pushes in MuJoCo, to the end or until the outcome is decided. `simulate_push`
simulates a single push, and returns the outcome with the motion.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arguments import check_arguments, check_finite
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import integrate_servo_damping, read_torque_ranges
from pupper_analysis.robot.stability import HOLD_DURATION, Stability
from pupper_analysis.simulation import monitor
from pupper_analysis.simulation.clearance import ClearanceBounds
from pupper_analysis.simulation.monitor import SimulationSettings
from pupper_analysis.simulation.rollout import (
    FORCED_CONTROL_SPEC,
    StandStart,
    check_duration,
    make_forced_controls,
    make_stand_start,
    roll_out,
    with_stand_contacts,
)
from pupper_analysis.simulation.stability import evaluate_spectrum
from pupper_analysis.simulation.verify import StandVerification, verify_stand
from pupper_analysis.stance.stand import Stand

PULSE_DURATION = 0.02
"""Duration of a push [s], rounded to a positive number of time steps. Chosen, not tuned: short
compared with a fall.
"""

MAX_RESTING_SPEED = 0.01
"""Largest speed of the base at the end of a simulation, above the creep speed without a push, with
which a robot has recovered [m/s]. Chosen, not tuned.
"""

_REST_DURATION = 0.5
"""Time at the end of a simulation in which the base must be at rest [s]. Chosen, not tuned."""

_MIN_CHECK_INTERVAL = 0.5
"""Simulated time between two tests whether a simulation can end early [s]. Measured on v3-long-leg:
with half of this time, slow phases of a fall are mistaken for rest, and the limits must be searched
again.
"""

_SLOW_DURATION = 0.1
"""Length [s] of the last part of a simulated interval. A simulation does not end early if a
velocity in this part exceeds `_MAX_SLOW_SPEED`. Chosen, not tuned.
"""

_MAX_SLOW_SPEED = 0.02
"""Largest velocity [m/s, rad/s] of a degree of freedom with which a pushed robot may count as at
rest before the end of the simulation. Chosen, not tuned.
"""

_SAMPLE_TIME = 0.004
"""Time between the states whose ground contacts are evaluated [s]. Chosen, not tuned."""

_NUM_SAMPLES_NEAR_GROUND = 25
"""Number of successive samples whose contacts are searched after a part was found near the ground.
Then the distance to the ground is computed again. Chosen, not tuned.
"""

MAX_DURATION_RATIO = 10.0
"""Upper bound of the simulated time of a push, as a multiple of the requested time: 60 s by
default. Chosen, not tuned.
"""

_MAX_REMAINING_RATIO = 0.1
"""Largest predicted motion of the base (with `_SPEED_FACTOR`), relative to the CoM height, with
which a pushed robot counts as at rest. Measured on v3-long-leg: the robot returns from 0.03, and
falls slowly from 0.07.
"""

_SPEED_FACTOR = 1.5
"""Safety factor on the predicted motion of the base in the remaining time, since the speed may be
small for a while during an oscillation. Chosen, not tuned.
"""

_STILL_RATIO = 0.01
"""Fraction of `_MAX_REMAINING_RATIO` up to which the predicted motion counts as rest at the end of
the longest simulation, without a test of growing modes. Chosen, not tuned.
"""

_MAX_BATCH_VALUES = 2**25
"""Largest number of 8-byte values (states and controls) in a batch of simulated pushes, to bound
the memory. A batch with a single push may have more. Chosen, not tuned.
"""


@dataclass(frozen=True, eq=False)
class PushSettings(SimulationSettings):
    """Settings of the pushes and of the simulation.

    Attributes:
        point: (3,) point of application in the world: CoM of the base body in the stand [m].
        pulse: Duration of the push [s].
    """

    point: Array = field(metadata={"unit": "m"})
    pulse: float = field(metadata={"unit": "s"})


class MotorSamples(NamedTuple):
    """Motor torques and joint speeds in a simulated push.

    Attributes:
        torques: Motor torques at the joints, shape (n, nu) [N m; N of a slide].
        speeds: Speeds of the joints, shape (n, nu) [rad/s; m/s of a slide].
        integrated: Torques with which MuJoCo integrates the n - 1 steps between the samples
            (`integrate_servo_damping`), shape (n - 1, nu) [N m; N of a slide].
        period: Time between two samples [s].
    """

    torques: Array
    speeds: Array
    integrated: Array
    period: float


@dataclass(eq=False)
class PushBench:
    """Simulator of pushes on the base of a standing robot, with the counts of simulated pushes.

    Attributes:
        held: Initial state at rest, with the servo commands.
        axes: Push directions, horizontal unit vectors in the world, shape (n, 2).
        duration: Simulated time of a push [s], unless the outcome is decided earlier or later.
        feedforward: True for the servo command ctrl = q* + tau / kp, False for ctrl = q*.
        failures_without_push: Failures without a push, from ``verify_stand``; empty if the robot
            stays on the feet.
        rollouts: Number of simulated pushes so far, including a simulation without a push, if any.
        simulated: Total simulated time of the ``rollouts`` [s].
    """

    held: StandStart
    axes: Array
    duration: float
    feedforward: bool
    failures_without_push: tuple[Diagnostic, ...]
    rollouts: int = field(default=0, init=False)
    simulated: float = field(default=0.0, init=False)

    def __post_init__(self) -> None:
        held = self.held
        self.robot, self.stand, self.drive = held.robot, held.stand, held.drive
        self.start, self.ctrl = held.start, held.ctrl
        model = self.drive.model
        self.upright = monitor.StandReference.from_configuration(
            self.robot, self.stand.qpos, self.stand.task.rotation()
        )
        self.timestep = float(model.opt.timestep)
        self.steps = round(self.duration / self.timestep)
        self.longest_duration = MAX_DURATION_RATIO * self.steps * self.timestep
        self.pulse_steps = max(1, round(PULSE_DURATION / self.timestep))
        self.watcher = monitor.ContactSampler(self.robot, model)
        self.clearance = ClearanceBounds(self.robot, model)
        self.workers = [mujoco.MjData(model) for _ in range(os.cpu_count() or 1)]

    @cached_property
    def creep_speed(self) -> float:
        """Largest speed of the base at the end of a run without a push [m/s].

        Feet creep with MuJoCo's regularised friction.
        """
        (states,) = self.simulate_pushes(np.zeros(1, dtype=np.int64), np.zeros(1))
        return self._measure_final_speed(states)

    def simulate_fully(
        self, directions: NDArray[np.int64], impulses: Array
    ) -> list[Diagnostic | None]:
        """Simulate pushes without an early end at rest, and return the failure of each push.

        Unless the push fails earlier, a simulation lasts for ``duration``, or longer if the robot
        still moves, for at most ``MAX_DURATION_RATIO`` times the duration.

        Args:
            directions: Index of each push's direction in ``axes``, shape (n,).
            impulses: Impulses along ``directions``, shape (n,) [N s].

        Returns:
            Failure of each push; None if the robot recovers.
        """
        return self._simulate_intervals(directions, impulses, may_rest=False)

    def simulate_until_decided(
        self, directions: NDArray[np.int64], impulses: Array
    ) -> list[Diagnostic | None]:
        """Simulate pushes until each outcome is decided, and return the failure of each push.

        As `simulate_fully`, but a simulation also ends early if the robot is at rest.

        Args:
            directions: Index of each push's direction in ``axes``, shape (n,).
            impulses: Impulses along ``directions``, shape (n,) [N s].

        Returns:
            Failure of each push; None if the robot recovers.
        """
        return self._simulate_intervals(directions, impulses, may_rest=True)

    def _simulate_intervals(
        self, directions: NDArray[np.int64], impulses: Array, *, may_rest: bool
    ) -> list[Diagnostic | None]:
        """Simulate n pushes until each outcome is decided; return failures, None after a recovery.

        ``directions`` (n,) are indices of ``axes``, ``impulses`` (n,) are in N s. With
        ``may_rest``, a simulation also ends once the robot is at rest.
        """
        count = len(directions)
        failures: list[Diagnostic | None] = [None] * count
        tails = [np.empty((0, len(self.start)))] * count
        running, starts = list(range(count)), np.tile(self.start, (count, 1))
        forces = self._compute_push_forces(directions, impulses)
        interval = max(self.pulse_steps, round(_MIN_CHECK_INTERVAL / self.timestep))
        self.rollouts += count
        begin, longest = 0, round(MAX_DURATION_RATIO * self.steps)
        while running and begin < longest:
            end = self.steps if begin < self.steps else longest
            steps = min(interval, end - begin)
            ended = []
            rollouts = self._roll_out_batches(
                starts[running], forces[running], steps, pushed=begin == 0
            )
            begin += steps
            for index, states in zip(list(running), rollouts, strict=True):
                starts[index] = states[-1]
                tails[index] = np.concatenate([tails[index], states])[-self._num_rest_states :]
                failure = self._find_early_failure(states)
                is_decided = failure is not None
                if not is_decided and begin >= self.steps:
                    end_failures = self._find_end_failures(tails[index])
                    is_decided = begin == longest or not _is_only_motion(end_failures)
                    failure = _combine_failures(end_failures) if is_decided else None
                elif not is_decided and may_rest:
                    is_decided = self._is_at_rest(states)
                if is_decided:
                    ended.append(index)
                failures[index] = failure
            running = [index for index in running if index not in ended]
        return failures

    def simulate_pushes(self, directions: NDArray[np.int64], impulses: Array) -> Iterator[Array]:
        """Simulate n pushes for the full duration, and yield the states of each push.

        Args:
            directions: Index of each push's direction in ``axes``, shape (n,).
            impulses: Impulses, shape (n,) [N s].

        Yields:
            Full physics states of MuJoCo, shape (steps, size): time, qpos, qvel, ...
        """
        self.rollouts += len(directions)
        starts = np.tile(self.start, (len(directions), 1))
        yield from self._roll_out_batches(
            starts, self._compute_push_forces(directions, impulses), self.steps, pushed=True
        )

    def _compute_push_forces(self, directions: NDArray[np.int64], impulses: Array) -> Array:
        """Compute the horizontal forces of n pushes, shape (n, 2) [N]: impulse / duration.

        ``directions`` (n,) are indices of ``axes``, ``impulses`` (n,) are in N s.
        """
        forces: Array = impulses[:, None] * self.axes[directions]
        return forces / (self.pulse_steps * self.timestep)

    def _roll_out_batches(
        self, starts: Array, forces: Array, steps: int, *, pushed: bool
    ) -> Iterator[Array]:
        """Simulate ``steps`` steps from n states (n, size); yield states (steps, size) of each.

        If ``pushed``, the forces (n, 2) [N] act on the base during the first ``pulse_steps``.
        """
        model = self.drive.model
        self.simulated += len(forces) * steps * self.timestep
        width = model.nu + 6 * model.nbody
        size = max(1, _MAX_BATCH_VALUES // (steps * (width + len(self.start))))
        for begin in range(0, len(forces), size):
            batch = forces[begin : begin + size]
            control, force = make_forced_controls(self.robot, model, self.ctrl, len(batch), steps)
            if pushed:
                force[:, : self.pulse_steps, :2] = batch[:, None]
            workers = self.workers[: len(batch)]
            first = starts[begin : begin + size]
            yield from roll_out(model, workers, first, control, control_spec=FORCED_CONTROL_SPEC)

    def find_failure(self, states: Array) -> Diagnostic | None:
        """Find the failure of a push in the states of the complete simulation.

        Args:
            states: Full physics states of MuJoCo, shape (n, size): time, qpos, qvel, ...

        Returns:
            Failure, possibly a combination of several failures. None if the robot recovers.
        """
        early_failure = self._find_early_failure(states)
        if early_failure is not None and monitor.has_diverged(states, self.timestep):
            return early_failure
        failures = [] if early_failure is None else [early_failure]
        return _combine_failures(failures + self._find_end_failures(states))

    def extend_until_rest(self, states: Array) -> Array:
        """Continue a simulation in which the robot still moves at the end, until rest or a fall.

        The total time is at most ``MAX_DURATION_RATIO`` times the duration.

        Args:
            states: Full physics states of a simulation of ``duration``, shape (n, size).

        Returns:
            ``states`` followed by the states of the continuation, shape (m, size).
        """
        interval = max(self._num_rest_states, 1)
        longest = round(MAX_DURATION_RATIO * self.steps)
        last = states
        while (
            len(states) < longest
            and self._find_early_failure(last) is None
            and _is_only_motion(self._find_end_failures(states))
        ):
            steps = min(interval, longest - len(states))
            (last,) = self._roll_out_batches(states[-1:], np.zeros((1, 2)), steps, pushed=False)
            states = np.concatenate([states, last])
        return states

    def _find_early_failure(self, states: Array) -> Diagnostic | None:
        """Return the failure that ends a simulation (divergence, a body on the ground), or None."""
        if monitor.has_diverged(states, self.timestep):
            return monitor.describe_divergence(self.drive.integrator, self.timestep)
        samples = states[:: max(1, round(_SAMPLE_TIME / self.timestep))]
        index, next_bound = 0, 0
        while index < len(samples):
            if index >= next_bound:
                distance = self.clearance.distance(samples[index])
                if distance > 0.0:
                    later = self.clearance.displacements(samples[index + 1 :], samples[index])
                    near = np.flatnonzero(later >= distance)
                    index += 1 + (int(near[0]) if len(near) else len(later))
                    continue
                next_bound = index + _NUM_SAMPLES_NEAR_GROUND
            if touching := sorted(self.watcher.find_ground_bodies(samples[index])):
                moment = Quantity(self.watcher.data.time, "s")
                body = touching[0]
                surface = self.watcher.find_surface(body)
                return diagnose(
                    "body-touches-ground", subject=("body", body), surface=surface, time=moment
                )
            index += 1
        return None

    def _find_end_failures(self, states: Array) -> list[Diagnostic]:
        """Return the failures at the end of a simulation: a fall, a base in motion.

        ``states`` (n, size) are the last states, for at least ``_REST_DURATION``.
        """
        failures = []
        if self.upright.has_fallen(states[-1]):
            height = float(monitor.base_heights(self.robot, states[-1]))
            failures.append(monitor.describe_fall(self.upright.tilt(states[-1]), height))
        speed = self._measure_final_speed(states)
        is_fast = speed > MAX_RESTING_SPEED and speed > MAX_RESTING_SPEED + self.creep_speed
        if is_fast or not (failures or self._will_rest(states)):
            failures.append(diagnose("not-at-rest", speed=Quantity(speed, "m/s")))
        return failures

    @property
    def _num_rest_states(self) -> int:
        """Number of final states in which the robot must be at rest."""
        return round(_REST_DURATION / self.timestep)

    def _measure_final_speed(self, states: Array) -> float:
        """Return the largest speed [m/s] of the base in the last ``_REST_DURATION`` of the states.

        The speed is the linear speed plus the angular speed times the CoM height. ``states``: (n,
        size).
        """
        last = states[-self._num_rest_states :, 1 + self.drive.model.nq :]
        rates = last[:, self.robot.mj_convention.qvel_index[:6]]
        linear, angular = (np.linalg.norm(part, axis=1) for part in (rates[:, :3], rates[:, 3:]))
        return float((linear + self.upright.com_height * angular).max())

    def _will_rest(self, states: Array, spectrum: Stability | None = None) -> bool:
        """Return True if the base of a slow robot is expected to move little until the end.

        The predicted motion is ``_SPEED_FACTOR`` v min(T, 1 / d), with the speed v, the relative
        rate d at which v decreases, and the remaining time T (at least `HOLD_DURATION`). Growing
        modes are tested, since a robot almost stops near a saddle point before the fall. ``states``
        (n, size) are the last states, for at least ``_REST_DURATION``.
        """
        most = _MAX_REMAINING_RATIO * self.upright.com_height / _SPEED_FACTOR
        left = self.longest_duration - float(states[-1, 0])
        remaining = max(left, HOLD_DURATION)
        halves = np.array_split(states[-self._num_rest_states :], 2)
        before, speed = (self._measure_final_speed(half) for half in halves)
        decay = math.log(before / speed) / (_REST_DURATION / 2) if speed < before and speed else 0.0
        time = remaining if decay * remaining < 1 else 1 / decay
        if speed * time > most:
            speed = max(speed - self.creep_speed, 0.0)
            if speed * time > most:
                return False
        at_end = left < self.timestep
        if at_end and (speed < before or speed * time <= _STILL_RATIO * most):
            return True
        if spectrum is None:
            spectrum = evaluate_spectrum(self.drive, states[-1], self.ctrl, settle=0.0)
        growing = spectrum.modes_growing_within(self.longest_duration)
        return not any(
            mode.repeated_at_second_step and not mode.without_dry_friction for mode in growing
        )

    def _is_at_rest(self, states: Array) -> bool:
        """Return True if a pushed robot is upright and at rest, without a mode that grows soon.

        ``states`` are MuJoCo's full states of the last steps, shape (n, size): time, qpos, qvel,
        ...
        """
        model = self.drive.model
        rates = states[-round(_SLOW_DURATION / self.timestep) :, 1 + model.nq :][:, : model.nv]
        if np.abs(rates).max(initial=0.0) > _MAX_SLOW_SPEED:
            return False
        end = states[-1]
        if self.upright.has_fallen(end):
            return False
        spectrum = evaluate_spectrum(self.drive, end, self.ctrl, settle=0.0)
        return spectrum.is_stable_for() and self._will_rest(states, spectrum)

    def simulate_motors(self, direction: int, impulse: float) -> MotorSamples:
        """Simulate a push for ``duration``, and return torques and speeds of the joints.

        The result has a sample at the start, and after each time step.

        Args:
            direction: Index of the push direction in ``axes``.
            impulse: Impulse [N s].
        """
        (states,) = self.simulate_pushes(np.array([direction]), np.array([impulse]))
        dofs = self.robot.mj_convention.qvel_index[-self.robot.nu :]
        torques, speeds = [], []
        for state in (self.start, *states):
            self.watcher.sample(state, self.ctrl)
            torques.append(self.watcher.data.qfrc_actuator[dofs])
            speeds.append(self.watcher.data.qvel[dofs])
        drive, actuators = self.drive, self.robot.mj_convention.actuator_index
        integrated = integrate_servo_damping(
            drive.model,
            drive.kd,
            np.array(torques[:-1]),
            np.array(speeds),
            read_torque_ranges(drive.model, actuators),
        )
        return MotorSamples(np.array(torques), np.array(speeds), integrated, self.timestep)

    def find_push_point(self) -> Array:
        """Return the push point, the CoM of the base body in the world frame, shape (3,) [m]."""
        data = self.robot.compute_kinematics(self.stand.qpos)
        return np.array(data.xipos[self.robot.mj_model.body(self.robot.mj_base).id])

    def list_settings(self) -> dict[str, Any]:
        """Return the settings of the simulations and pushes: {field of ``PushSettings``: value}."""
        return {
            "feedforward": self.feedforward,
            "integrator": self.drive.integrator,
            "timestep": self.timestep,
            "duration": self.steps * self.timestep,
            "kp": self.drive.kp,
            "kd": self.drive.kd,
            "point": self.find_push_point(),
            "pulse": self.pulse_steps * self.timestep,
        }


def _is_only_motion(failures: list[Diagnostic]) -> bool:
    """Return True if the only failure of a pushed robot is that the base still moves at the end."""
    return [failure.code for failure in failures] == ["not-at-rest"]


def _combine_failures(failures: list[Diagnostic]) -> Diagnostic | None:
    """Return a single diagnostic that states all failures of a push; None without a failure."""
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
    """Create the simulator of a stand with pushes in given directions, for ``push_recovery``.

    Args:
        robot: The robot.
        stand: The stand.
        angles: Push directions about the vertical, from the base's forward axis, shape (n,) [rad].
        duration: Simulated time of each push [s].
        kp: Servo stiffness [N m/rad, N/m], scalar or shape (nu,); the model's own if None.
        kd: Servo damping [N m s/rad, N s/m], scalar or shape (nu,); the model's own if None.
        feedforward: Command ctrl = q* + tau / kp instead of ctrl = q*.
        integrator: MuJoCo's integrator; the model's own if None.
        verification: Result of ``verify_stand`` with the same arguments; computed if None.

    Raises:
        ConfigurationError: If an argument is out of range, for example.
        ModelError: If the gains of a joint are unknown, for example.
    """
    forward = Configuration(robot, stand.qpos).base_rotation()[:2, 0]
    run_without_push = verification or verify_stand(
        robot, stand, feedforward=feedforward, kp=kp, kd=kd, integrator=integrator
    )
    start = make_stand_start(
        robot, stand, feedforward=feedforward, kp=kp, kd=kd, integrator=integrator
    )
    world_angles = angles + math.atan2(forward[1], forward[0])
    return PushBench(
        held=start,
        axes=np.column_stack([np.cos(world_angles), np.sin(world_angles)]),
        duration=duration,
        feedforward=feedforward,
        failures_without_push=() if run_without_push.stays else run_without_push.failures,
    )


_FRAME_TIME = 1 / 30
"""Approximate time between two configurations of ``PushTrial.motion`` [s]. Chosen, not tuned."""

MAX_IMPULSE = 1e6
"""Largest valid impulse, and largest valid resolution of an impulse [N s]. Chosen, not tuned."""


@dataclass(frozen=True, eq=False)
class PushTrial(PushSettings):
    """Outcome and motion of a stand after a simulated push.

    Attributes:
        recovered: Whether the robot recovers, by the criteria of ``push_recovery``.
        failure: Failure of the robot; None after a recovery.
        impulse: Impulse of the push [N s].
        direction: Direction of the push about the vertical [rad]: 0 is the base's forward, pi/2 the
            base's left.
        velocity_step: Change of the robot's velocity: impulse / mass [m/s].
        motion_time: (m,) times of the configurations from the start of the push [s].
        motion: (m, nq) configurations at ``motion_time``, rounded to six decimals.
    """

    _key_fields: ClassVar[tuple[str, ...]] = ("recovered", "failure")

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
    """Simulate a horizontal push on a standing robot, and return the outcome with the motion.

    The push is a constant force for about 20 ms at the CoM of the base body. ``push_recovery``
    defines recovery, and finds the largest push with a recovery. A robot that does not stay on the
    feet without a push does not recover.

    Args:
        robot: The robot.
        stand: The stand.
        impulse: Impulse of the push [N s].
        direction: Direction about the vertical [rad], -2 pi to 2 pi: 0 is the base's forward, pi/2
            the base's left.
        duration: Simulated time from the start of the push [s], 2 to 600. If the robot is not at
            rest after this time, the simulation continues until the robot rests or falls, up to
            ``MAX_DURATION_RATIO`` times as long.
        kp: Servo stiffness [N m/rad, N/m], scalar or shape (nu,); the model's own by default.
        kd: Servo damping [N m s/rad, N s/m], scalar or shape (nu,); the model's own by default.
        feedforward: Command ctrl = q* + tau / kp instead of ctrl = q*.
        integrator: MuJoCo integrator. Default: the model's.

    Returns:
        The outcome, with the motion. If the simulation diverges, only finite states are included.

    Raises:
        ConfigurationError: If an argument is out of range, the stand belongs to another robot,
            contains a weld or grip, or has contacts that the robot cannot make, or the base is
            fixed and the stand has feet.
        ModelError: If a joint has no motor, if a joint has no position servo and kp and kd are not
            both given, or if the ground or a contact cannot be added.
    """
    robot = with_stand_contacts(robot, stand)
    check_duration(duration)
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
    states = bench.extend_until_rest(states)
    failure = bench.find_failure(states)
    if bench.failures_without_push:
        failure = diagnose("without-a-push", failures=bench.failures_without_push)
    frames = states[:: max(1, round(_FRAME_TIME / bench.timestep))]
    frames = frames[np.isfinite(frames).all(axis=1)]  # also after a divergence
    return PushTrial(
        recovered=failure is None,
        failure=failure,
        impulse=impulse,
        direction=direction,
        velocity_step=impulse / robot.total_mass,
        motion_time=frames[:, 0].copy(),
        motion=np.round(frames[:, 1 + robot.mj_convention.qpos_index], 6),
        **bench.list_settings(),
    )
