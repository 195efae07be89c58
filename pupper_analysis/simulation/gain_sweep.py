"""How steady a stand is under a disturbance, for a grid of servo gains."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import mujoco.rollout
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.arguments import checked
from pupper_analysis.errors import ConfigurationError
from pupper_analysis.results import Tabular
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import servos
from pupper_analysis.robot.terrain import on_ground
from pupper_analysis.simulation import monitor
from pupper_analysis.simulation.rollout import (
    FORCED,
    check_stand,
    forced_commands,
    place_on_ground,
)
from pupper_analysis.stance.stand import Stand, stand_statics
from pupper_analysis.statics.equilibrium import ForceDistribution

Array = NDArray[np.float64]

KP_GRID = (10.0, 30.0, 60.0, 120.0)


KD_GRID = (0.5, 1.0, 2.0, 5.0)


@dataclass(frozen=True, eq=False)
class GainSweep(Tabular):
    """How steady a stand is under a vertical disturbance, for a grid of servo gains.

    Attributes:
        kp: (n,) N m/rad.
        kd: (m,) N m s/rad.
        height_deviation: (n, m) standard deviation of the base's height in the last second (m);
            infinite where the robot fell or the simulation diverged.
        fell: (n, m) whether it did.
        best_kp: Of the cell with the least deviation; None if the robot fell in all.
        best_kd: Likewise.
        best_deviation: Likewise (m).
        amplitude: Of the disturbance on the base (N).
        frequency: Of the disturbance (Hz).
        duration: s.
        integrator: MuJoCo's integrator.
    """

    kp: Array
    kd: Array
    height_deviation: Array
    fell: NDArray[np.bool_]
    best_kp: float | None
    best_kd: float | None
    best_deviation: float | None
    amplitude: float
    frequency: float
    duration: float
    integrator: str

    def _columns(self) -> dict[str, ArrayLike]:
        kp, kd = np.meshgrid(self.kp, self.kd, indexing="ij")
        return {
            "kp": kp.ravel(),
            "kd": kd.ravel(),
            "height_deviation": self.height_deviation.ravel(),
            "fell": self.fell.ravel(),
        }


@checked
def sweep_gains(
    robot: Robot,
    stand: Stand,
    *,
    kp: Sequence[float] = KP_GRID,
    kd: Sequence[float] = KD_GRID,
    amplitude: float = 2.0,
    frequency: float = 1.2,
    duration: float = 4.0,
    integrator: str = "implicitfast",
    progress: bool = False,
) -> GainSweep:
    """Simulates a stand under a vertical force on its base, for each kp and kd.

    The servos are commanded the stand's joint positions, without feed-forward; the force is
    amplitude sin(2 pi frequency t), from the first step. All cells run in parallel, on all cores.
    The default integrator takes kd implicitly: with Euler, high kd jitters.

    Args:
        robot: The robot.
        stand: How it stands.
        kp: Stiffnesses (N m/rad).
        kd: Dampings (N m s/rad).
        amplitude: N.
        frequency: Hz.
        duration: Simulated time (s), at least 2.
        integrator: MuJoCo's integrator.
        progress: Show a progress bar if it takes longer than a second.

    Returns:
        The grid of last-second height deviations.

    Raises:
        ConfigurationError: If an argument is out of its range, or the base is fixed.
    """
    check_stand(robot, stand, duration)
    robot = on_ground(robot, stand.task.ground, stand.foot_targets)
    if not (math.isfinite(amplitude) and math.isfinite(frequency)):
        raise ConfigurationError("amplitude, frequency", "they must be finite")
    if not len(kp) or not len(kd):
        raise ConfigurationError("kp, kd", "give at least one value of each")
    cells = [(stiffness, damping) for stiffness in kp for damping in kd]
    drives = [servos(robot, *cell, integrator) for cell in cells]
    timestep = float(robot.mj_model.opt.timestep)
    steps = round(duration / timestep)
    model = drives[0].model
    ctrl = drives[0].command(robot, stand.joint_positions(robot))
    control, force = forced_commands(robot, model, ctrl, 1, steps)
    force[0, :, 2] = amplitude * np.sin(2 * math.pi * frequency * timestep * np.arange(steps))
    balance = stand_statics(robot, stand, distribution=ForceDistribution.MIN_TANGENTIAL)
    starts = np.array(
        [place_on_ground(robot, drive, stand, balance.joint_torques) for drive in drives]
    )
    states = _rollout_in_chunks([drive.model for drive in drives], starts, control, progress)

    deviations = monitor.base_heights(robot, states)[:, -round(1.0 / timestep) :].std(axis=1)
    for index, (drive, rows) in enumerate(zip(drives, states, strict=True)):
        if monitor.diverged(rows, timestep) or _lies(robot, drive.model, stand, rows[-1], ctrl):
            deviations[index] = np.inf
    grid = deviations.reshape(len(kp), len(kd))
    row, column = divmod(int(np.argmin(grid)), len(kd))
    stands = bool(np.isfinite(grid).any())
    return GainSweep(
        kp=np.array(kp, dtype=float),
        kd=np.array(kd, dtype=float),
        height_deviation=grid,
        fell=~np.isfinite(grid),
        best_kp=float(kp[row]) if stands else None,
        best_kd=float(kd[column]) if stands else None,
        best_deviation=float(grid[row, column]) if stands else None,
        amplitude=amplitude,
        frequency=frequency,
        duration=steps * timestep,
        integrator=drives[0].integrator,
    )


def _lies(robot: Robot, model: mujoco.MjModel, stand: Stand, state: Array, ctrl: Array) -> bool:
    """Tells whether a robot has fallen over, or rests on something else than its feet."""
    seen = monitor.Watcher(robot, model).look(state, ctrl)
    leaning = monitor.lean(robot, stand.task.rotation(), state)
    return bool(seen.bodies) or leaning > monitor.FALLEN_TILT


def _rollout_in_chunks(
    models: list[mujoco.MjModel], starts: Array, control: Array, progress: bool
) -> Array:
    """Runs one rollout per model, on all cores; a bar appears after the first second."""
    from rich.progress import Progress

    workers = min(len(models), os.cpu_count() or 1)
    datas = [mujoco.MjData(models[0]) for _ in range(workers)]
    chunk = 2 * workers
    states = []
    began = time.monotonic()
    with (
        mujoco.rollout.Rollout(nthread=workers) as pool,
        Progress(transient=True, disable=not progress, auto_refresh=False) as bar,
    ):
        task = bar.add_task("gain sweep", total=len(models), visible=False)
        for first in range(0, len(models), chunk):
            batch = models[first : first + chunk]
            rows, _ = pool.rollout(
                batch, datas, starts[first : first + chunk], control, control_spec=FORCED
            )
            states.append(rows)
            bar.update(task, advance=len(batch), visible=time.monotonic() - began > 1.0)
            bar.refresh()
    return np.concatenate(states)
