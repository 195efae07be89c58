"""A robot in MuJoCo whose masses, servos and encoders are off: to try a plan before a robot is."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import model_with_servos, resolve_servo_gains
from pupper_analysis.robot.tool import with_payload
from pupper_analysis.tools.fit.parameters import list_bodies
from pupper_analysis.tools.fit.stands.equations import compute_level_base
from pupper_analysis.tools.fit.stands.plan import PlannedStand
from pupper_analysis.tools.study.parameters import scale_robot

Array = NDArray[np.float64]

MASS, COM, OFFSET, KP = 0.1, 0.006, math.radians(1.0), 0.07
"""What it is off by, as standard deviations: in parts, m, rad, in parts (and as much in common)."""

_STEP = 2 * math.pi / 2**14
"""rad of its encoders."""

_SET_DOWN = 0.01
"""m: from so high it is put on its feet."""

_TURNS = (1e-3, 2e-4)
"""m: torsional and rolling friction of rubber feet, at most."""

_CARRIES = 0.005
"""Of the weight: a foot with less is in the air, as far as a person sees."""


class SimulatedRobot:
    """A robot in MuJoCo, and who stands beside it.

    Args:
        robot: The robot, as its files have it.
        seed: Of what is off.
        kp: Stiffness that is stated of its servos (N m/rad); the files' by default.

    Attributes:
        total_mass: What it weighs (kg).
        kp: (nu,) N m/rad.
        offset: (nu,) zeros of its encoders (rad).
        sent: All commands (nu,), as they were sent (rad).
    """

    ramps = True

    def __init__(self, robot: Robot, seed: int = 0, kp: float | None = None) -> None:
        rng = np.random.default_rng(seed)
        factors = {}
        for link, _ in list_bodies(robot):
            factors[f"mass:{link}"] = math.exp(MASS * rng.normal())
            factors |= {f"com_{axis}:{link}": COM * rng.normal() for axis in "xyz"}
        common = rng.normal()
        gains = resolve_servo_gains(robot, kp, None)
        self.kp = gains.kp * np.exp(KP * (common + rng.normal(size=robot.nu)))
        self.offset = OFFSET * rng.normal(size=robot.nu)
        self.robot = scale_robot(robot, factors)
        self.total_mass = self.robot.total_mass
        self.sent: list[Array] = []
        self._kd = gains.kd
        self._time = 0.0
        self._put_on({})
        self.send(robot.nominal + self.offset)
        self._set_down(())

    def _put_on(self, loads: Mapping[str, Array]) -> None:
        loaded = self.robot
        for link, (mass, *place) in loads.items():
            loaded = with_payload(loaded, float(mass), (link, *place))
        drive = model_with_servos(loaded, self.kp, self._kd)
        drive.model.opt.noslip_iterations = 20
        drive.model.geom_friction[:, 1:] = np.minimum(drive.model.geom_friction[:, 1:], _TURNS)
        self._loaded, self._drive, self._data = loaded, drive, mujoco.MjData(drive.model)

    def now(self) -> float:
        """See ``Bridge``."""
        return self._time

    def read(self) -> tuple[float, Array]:
        """See ``Bridge``."""
        index = self._loaded.mj_convention.qpos_index
        shown = self._data.qpos[index][7:] + self.offset
        return self._time, np.round(shown / _STEP) * _STEP

    def send(self, command: Array) -> None:
        """See ``Bridge``."""
        self.sent.append(command.copy())

    def wait(self, seconds: float) -> None:
        """See ``Bridge``."""
        model, data = self._drive.model, self._data
        data.ctrl[:] = self._drive.command(self._loaded, self.sent[-1] - self.offset)
        for _ in range(max(1, round(seconds / model.opt.timestep))):
            mujoco.mj_step(model, data)
        self._time += seconds

    def close(self) -> None:
        """See ``Bridge``."""

    def prepare(
        self,
        stand: PlannedStand,
        loads: Mapping[str, Array],
        todo: Sequence[str],  # noqa: ARG002 - it does what is planned
    ) -> bool:
        """See ``Operator``: lifts it, puts the mass on, and sets it down as it was commanded."""
        self._put_on(loads)
        self._set_down(stand.swing)
        return True

    def _set_down(self, swing: Sequence[str]) -> None:
        robot, joints = self._loaded, self.sent[-1] - self.offset
        on = [point for foot, own in robot.feet.items() if foot not in swing for point in own]
        qpos, base = robot.posed(joints), compute_level_base(robot, joints, on)
        qpos[2], qpos[3:7] = base[4], base[:4]
        every = robot.contact_points
        lowest = Configuration(robot, qpos).foot_places(every)[:, 2]
        lowest = lowest - [robot.contact_radius[point] for point in every]
        qpos[2] += _SET_DOWN - min(lowest)
        mujoco.mj_resetData(self._drive.model, self._data)
        self._data.qpos[robot.mj_convention.qpos_index] = qpos

    def feet_up(
        self,
        feet: Sequence[str],
        planned: Sequence[str],  # noqa: ARG002 - it sees
    ) -> tuple[str, ...] | None:
        """See ``Operator``: as it is; None if it lies on something else, or on two feet."""
        carried, force = dict.fromkeys(feet, 0.0), np.zeros(6)
        for number, contact in enumerate(self._data.contact[: self._data.ncon]):
            mujoco.mj_contactForce(self._drive.model, self._data, number, force)
            feet_of = self._loaded.foot_geoms
            on = [feet_of[int(geom)] for geom in contact.geom if int(geom) in feet_of]
            if not on:
                return None
            carried[on[0]] += float(force[0])
        least = _CARRIES * self.total_mass * float(np.linalg.norm(self.robot.gravity))
        up = tuple(foot for foot in feet if carried[foot] < least)
        return up if len(feet) - len(up) >= 3 else None

    def stops(self) -> bool:
        """See ``Operator``."""
        return False


def open_simulated(robot: Robot, words: str) -> tuple[SimulatedRobot, SimulatedRobot]:
    """Returns the bridge, of ``mujoco:SEED`` or ``mujoco:SEED;kp=60``.

    Raises:
        ConfigurationError: If that is no seed, or no stiffness.
    """
    seed, _, stiffness = (words or "0").partition(";kp=")
    try:
        made = SimulatedRobot(robot, int(seed), float(stiffness) if stiffness else None)
    except (OverflowError, ValueError) as error:
        raise ConfigurationError("--bridge", diagnose("no-bridge-words", words=words)) from error
    return made, made
