"""Height deviation of a disturbed stand, for a grid of servo gains.

Inputs are a robot, a stand, and values of kp and kd. Each pair of gains is simulated in MuJoCo
under a sinusoidal vertical force on the base. The outputs for each pair are the standard deviation
of the base height in the last second, and whether the robot stays at rest without the force.
"""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError, PupperAnalysisError
from pupper_analysis.base.results import Tabular
from pupper_analysis.base.units import DAMPING_UNIT, STIFFNESS_UNIT
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import Servos, model_with_servos, resolve_servo_gains
from pupper_analysis.robot.stability import HOLD_DURATION
from pupper_analysis.robot.terrain import build_on_ground
from pupper_analysis.simulation import monitor
from pupper_analysis.simulation.rollout import (
    FORCED_CONTROL_SPEC,
    check_duration,
    make_forced_controls,
    place_on_ground,
    rest_state,
    roll_out,
    with_stand_contacts,
)
from pupper_analysis.simulation.stability import (
    CONTACT_SETTLING_TIME,
    MAX_RESTING_SPEED,
    evaluate_stability,
)
from pupper_analysis.stance.sag.steady_state import steady_state
from pupper_analysis.stance.stand import Stand, stand_statics
from pupper_analysis.statics.equilibrium import ForceDistribution

GainPair = tuple[float, float]
"""Gains of all servos in a simulation: kp [N m/rad, N/m] and kd [N m s/rad, N s/m]."""

GAIN_FACTORS = (0.25, 0.5, 1.0, 2.0, 4.0)
"""Factors on the median kp or kd of the model [1], which give the default gains of a sweep. Chosen,
not tuned.
"""


@dataclass(frozen=True, eq=False)
class GainSweep(Tabular):
    """Height deviation of a stand under a vertical force, for a grid of servo gains.

    Attributes:
        kp: Stiffnesses, shape (n,) (N m/rad or N/m).
        kd: Dampings, shape (m,) (N m s/rad or N s/m).
        height_deviation: Standard deviation of the base height in the last second, shape (n, m)
            (m); infinite if the robot does not stand at the end.
        fell: True if the robot does not stand at the end, shape (n, m): for example, the base is
            tilted by more than 10 degrees, a body other than a foot touches the ground, or the
            simulation diverged.
        lasts: True if the undisturbed robot comes to rest and remains at rest, shape (n, m).
        amplitude: Amplitude of the force on the base (N).
        frequency: Frequency of the force (Hz).
        duration: Simulated time (s).
        integrator: MuJoCo's integrator.
    """

    kp: Array = field(metadata={"unit": STIFFNESS_UNIT})
    kd: Array = field(metadata={"unit": DAMPING_UNIT})
    height_deviation: Array = field(metadata={"unit": "m"})
    fell: NDArray[np.bool_]
    lasts: NDArray[np.bool_]
    amplitude: float = field(metadata={"unit": "N"})
    frequency: float = field(metadata={"unit": "Hz"})
    duration: float = field(metadata={"unit": "s"})
    integrator: str

    def _columns(self) -> dict[str, ArrayLike]:
        """Return {column: values} of a table with a row per pair of kp and kd.

        The columns are kp [N m/rad, N/m], kd [N m s/rad, N s/m], height deviation [m], and the
        truth values ``fell`` and ``lasts``, shape (n m,) each.
        """
        kp, kd = np.meshgrid(self.kp, self.kd, indexing="ij")
        return {
            "kp": kp.ravel(),
            "kd": kd.ravel(),
            "height_deviation": self.height_deviation.ravel(),
            "fell": self.fell.ravel(),
            "lasts": self.lasts.ravel(),
        }


@check_arguments
def sweep_gains(
    robot: Robot,
    stand: Stand,
    *,
    kp: Sequence[float] | None = None,
    kd: Sequence[float] | None = None,
    amplitude: float = 2.0,
    frequency: float = 1.2,
    duration: float = 4.0,
    integrator: str = "implicitfast",
    progress: bool = False,
) -> GainSweep:
    """Simulate a stand under a vertical force on the base, for each pair of kp and kd.

    The servos are commanded to the joint positions of the stand, without feed-forward. The force is
    amplitude sin(2 pi frequency t).

    Args:
        robot: Robot.
        stand: Stand.
        kp: Stiffnesses [N m/rad, N/m]. Default: `GAIN_FACTORS` times the median kp of the model.
        kd: Dampings [N m s/rad, N s/m]. Default: `GAIN_FACTORS` times the median kd of the model.
        amplitude: Amplitude of the force [N].
        frequency: Frequency of the force [Hz].
        duration: Simulated time [s], 2 to 600.
        integrator: MuJoCo's integrator: ``Euler``, ``implicitfast``, ``implicit`` or ``RK4``.
        progress: Show a progress bar during the sweep.

    Returns:
        For each pair the standard deviation of the base height in the last second [m], whether the
        robot no longer stands at the end, and whether it stays at rest without the force.

    Raises:
        ConfigurationError: If an argument is out of range, the base is fixed, or the stand belongs
            to another robot.
        ModelError: If a joint has no motor, or no position servo while kp and kd are not both
            passed, or if the ground cannot be added, for example.
    """
    robot = with_stand_contacts(robot, stand)
    check_duration(duration)
    if not (math.isfinite(amplitude) and math.isfinite(frequency)):
        raise ConfigurationError("amplitude, frequency", diagnose("must-be-finite"))
    own = None if kp is not None and kd is not None else model_with_servos(robot)
    axes = [
        _choose_values(given, None if own is None else getattr(own, name))
        for name, given in (("kp", kp), ("kd", kd))
    ]
    if not all(axes):
        raise ConfigurationError("kp, kd", diagnose("gain-values-missing"))
    trial = _SweepTrial(robot, stand, integrator, duration)
    cells = list(dict.fromkeys(itertools.product(axes[0], axes[1])))
    outcomes = trial.run(cells, amplitude, frequency, progress=progress)
    pairs = [[outcomes[kp, kd] for kd in axes[1]] for kp in axes[0]]
    deviations = np.array([[deviation for deviation, _ in row] for row in pairs])
    return GainSweep(
        kp=np.array(axes[0]),
        kd=np.array(axes[1]),
        height_deviation=deviations,
        fell=~np.isfinite(deviations),
        lasts=np.array([[lasts for _, lasts in row] for row in pairs]),
        amplitude=amplitude,
        frequency=frequency,
        duration=trial.steps * trial.timestep,
        integrator=integrator,
    )


def _choose_values(given: Sequence[float] | None, own: Array | None) -> list[float]:
    """Return the values of a gain (kp or kd) with which a sweep simulates the stand.

    Default: `GAIN_FACTORS` times the median of ``own``, the gains of the model's servos, shape
    (nu,).
    """
    if given is not None:
        return [float(value) for value in given]
    assert own is not None
    middle = float(np.median(own))
    return [factor * middle for factor in GAIN_FACTORS]


class _SweepTrial:
    """Simulations of a stand with pairs of servo gains, under a vertical force on the base."""

    def __init__(self, robot: Robot, stand: Stand, integrator: str, duration: float) -> None:
        self.plain, self.stand, self.integrator = robot, stand, integrator
        self.robot = robot = build_on_ground(robot, stand.task.ground, stand.rigid_targets)
        self.timestep = float(robot.mj_model.opt.timestep)
        self.steps = round(duration / self.timestep)
        balance = stand_statics(robot, stand, distribution=ForceDistribution.MIN_TANGENTIAL)
        self.torques = balance.joint_torques

    def run(
        self, cells: Sequence[GainPair], amplitude: float, frequency: float, *, progress: bool
    ) -> dict[GainPair, tuple[float, bool]]:
        """Simulate a stand with pairs of gains, and evaluate its stability at rest.

        Args:
            cells: Pairs (kp [N m/rad, N/m], kd [N m s/rad, N s/m]).
            amplitude: Amplitude of the vertical force on the base [N].
            frequency: Frequency of the force [Hz].
            progress: Show a progress bar.

        Returns:
            {pair: (height deviation [m], rest)}. The deviation is the standard deviation of the
            base height in the last second, infinite if the robot does not stand at the end.
            ``rest`` is True if the robot without the force comes to rest and remains at rest (see
            `GainSweep.lasts`).
        """
        from rich.progress import track

        robot, stand = self.robot, self.stand
        starts: dict[float, Array] = {}
        rests: dict[float, Array | None] = {}
        # Raises for invalid gains before the first simulation.
        for cell in cells:
            resolve_servo_gains(robot, *cell)
        first = model_with_servos(robot, *cells[0], self.integrator)
        ctrl = first.command(robot, stand.joint_positions(robot))
        control, force = make_forced_controls(robot, first.model, ctrl, 1, self.steps)
        phase = 2 * math.pi * frequency * self.timestep * np.arange(self.steps)
        force[0, :, 2] = amplitude * np.sin(phase)

        def place(kp: float) -> None:
            """Store the initial state and the state of rest for a stiffness kp [N m/rad, N/m]."""
            # The start is a static pose, so that kd has no effect on it.
            drive = model_with_servos(robot, kp, 0.0, self.integrator)
            starts[kp] = place_on_ground(robot, drive, stand, self.torques)
            with suppress(PupperAnalysisError):
                pose = steady_state(self.plain, stand, kp=kp)
                start = rest_state(robot, drive, pose.qpos, ctrl)
                rests[kp] = None if pose.failures else start

        def simulate(cell: GainPair) -> tuple[float, bool]:
            """Return height deviation [m] and rest of a pair of gains, as `run` returns them."""
            drive, start = model_with_servos(robot, *cell, self.integrator), starts[cell[0]]
            watcher = monitor.ContactSampler(robot, drive.model)
            states = roll_out(
                drive.model, watcher.data, start, control, control_spec=FORCED_CONTROL_SPEC
            )[0]
            deviation = self._compute_deviation(watcher, states)
            if cell[0] not in rests and math.isfinite(deviation):
                return deviation, self._stays_at_rest(drive, watcher, start, ctrl)
            rest = rests.get(cell[0])
            return deviation, rest is not None and evaluate_stability(
                drive, rest, ctrl, CONTACT_SETTLING_TIME
            ).is_stable_for()

        with ThreadPoolExecutor(min(len(cells), os.cpu_count() or 1)) as pool:
            list(pool.map(place, dict.fromkeys(kp for kp, _ in cells)))
            outcomes = track(
                pool.map(simulate, cells),
                "gain sweep",
                len(cells),
                disable=not progress,
                transient=True,
            )
            return dict(zip(cells, outcomes, strict=True))

    def _stays_at_rest(
        self, drive: Servos, watcher: monitor.ContactSampler, start: Array, ctrl: Array
    ) -> bool:
        """Return True if the robot, without the force, comes to rest on the feet and stays at rest.

        ``start`` is the initial MuJoCo state, ``ctrl`` the constant servo commands.
        """
        steps = round(HOLD_DURATION / self.timestep)
        states = roll_out(drive.model, watcher.data, start, np.tile(ctrl, (1, steps, 1)))[0]
        if not self._is_standing(watcher, states):
            return False
        stability = evaluate_stability(drive, states[-1], ctrl, 0.0)
        return stability.speed <= MAX_RESTING_SPEED and stability.is_stable_for()

    def _compute_deviation(self, watcher: monitor.ContactSampler, states: Array) -> float:
        """Compute the standard deviation of the base height in the last second [m].

        Infinite if the robot does not stand at the end. ``states`` are MuJoCo states, a row per
        time step.
        """
        if not self._is_standing(watcher, states):
            return math.inf
        last = round(1.0 / self.timestep)
        return float(monitor.base_heights(self.robot, states)[-last:].std())

    def _is_standing(self, watcher: monitor.ContactSampler, states: Array) -> bool:
        """Return True if the robot stands in the last of ``states``, MuJoCo states of a rollout.

        The criterion is `StandCheck.stands`, without divergence.
        """
        if monitor.has_diverged(states, self.timestep):
            return False
        upright = monitor.StandReference.from_configuration(
            self.robot, self.stand.qpos, self.stand.task.rotation()
        )
        return upright.check_stand(states[-1], watcher.find_ground_bodies(states[-1])).stands
