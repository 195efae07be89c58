"""Simulated robot with perturbed masses, servos and encoders, to try a plan without hardware.

`SimulatedRobot` is both the bridge and the operator of a recording. Masses, CoM positions, encoder
offsets and kp are drawn at random from a seed. Commands are simulated in MuJoCo, and positions are
rounded to the encoder step. To attach known masses, the model is built again.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.contact import find_acting_contacts, list_contact_bodies
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import model_with_servos, resolve_servo_gains
from pupper_analysis.robot.tool import with_payload
from pupper_analysis.tools.fit.parameters import list_bodies
from pupper_analysis.tools.fit.stands.equations import compute_level_base
from pupper_analysis.tools.fit.stands.plan import PlannedStand
from pupper_analysis.tools.study.parameters import scale_robot

MASS_LOG_STD, COM_STD, OFFSET_STD, KP_LOG_STD = 0.1, 0.006, math.radians(1.0), 0.07
"""Standard deviations of the perturbations of the simulated robot. In this order: logarithm of the
mass of each body, CoM components [m], encoder offsets [rad, m], logarithm of kp. The last value has
two uses: a factor on the kp of each servo, and a common factor on all kp. Chosen, not tuned.
"""

_ENCODER_STEP = 2 * math.pi / 2**14
"""Encoder step [rad, m] to which the simulated robot rounds joint positions: 14 bits per turn.
Chosen, not tuned."""

_DROP_HEIGHT = 0.01
"""Height [m] of the lowest contact point above the ground when the robot is set down. Chosen, not
tuned."""

_MAX_FOOT_FRICTION = (1e-3, 2e-4)
"""Upper bounds of the torsional and rolling friction [m] of all geoms in the simulation: values of
rubber feet. Chosen, not tuned."""

_MIN_LOAD_RATIO = 0.005
"""Lower bound of (normal force on a foot / weight of the robot) of a foot that carries load.
Chosen, not tuned.
"""


class SimulatedRobot:
    """Robot in MuJoCo with perturbed parameters: both the bridge and the operator of a recording.

    Args:
        robot: Robot, with the values of the files.
        seed: Seed of the perturbations.
        kp: Stated servo stiffness of all joints [N m/rad, N/m]; the values of the files by default.

    Attributes:
        robot: Robot with the true masses and CoM positions.
        total_mass: True mass [kg], without known masses.
        kp: True stiffness, shape (nu,) [N m/rad, N/m].
        offset: Encoder offsets, shape (nu,) [rad, m].
        sent: All commands that were sent, shape (nu,) [rad, m] each.
    """

    ramps = True

    def __init__(self, robot: Robot, seed: int = 0, kp: float | None = None) -> None:
        rng = np.random.default_rng(seed)
        factors = {}
        for link, _ in list_bodies(robot):
            factors[f"mass:{link}"] = math.exp(MASS_LOG_STD * rng.normal())
            factors |= {f"com_{axis}:{link}": COM_STD * rng.normal() for axis in "xyz"}
        common = rng.normal()
        gains = resolve_servo_gains(robot, kp, None)
        self.kp = gains.kp * np.exp(KP_LOG_STD * (common + rng.normal(size=robot.nu)))
        self.offset = OFFSET_STD * rng.normal(size=robot.nu)
        self.robot = scale_robot(robot, factors)
        self.total_mass = self.robot.total_mass
        self.sent: list[Array] = []
        self._kd = gains.kd
        self._time = self._simulated_time = 0.0
        self._attach_loads({})
        self.send(robot.nominal + self.offset)
        self._place_on_feet(())

    def _attach_loads(self, loads: Mapping[str, Array]) -> None:
        """Create the simulation of the robot with known masses on its links.

        ``loads`` is {link: mass [kg] and position in the link frame [m], shape (4,)}.
        """
        loaded = self.robot
        for link, (mass, *position) in loads.items():
            loaded = with_payload(loaded, float(mass), (link, *position))
        drive = model_with_servos(loaded, self.kp, self._kd)
        drive.model.opt.noslip_iterations = 20
        drive.model.geom_friction[:, 1:] = np.minimum(
            drive.model.geom_friction[:, 1:], _MAX_FOOT_FRICTION
        )
        self._loaded, self._drive, self._data = loaded, drive, mujoco.MjData(drive.model)

    def now(self) -> float:
        """Return the simulated time [s]."""
        return self._time

    def read(self) -> tuple[float, Array]:
        """Return the simulated time [s] and the encoder positions, shape (nu,) [rad, m].

        The positions contain the encoder offsets, and are rounded to `_ENCODER_STEP`.
        """
        index = self._loaded.mj_convention.qpos_index
        positions = self._data.qpos[index][7:] + self.offset
        return self._time, np.round(positions / _ENCODER_STEP) * _ENCODER_STEP

    def send(self, command: Array) -> None:
        """Store the joint command for ``wait``, shape (nu,) [rad, m], in actuator order."""
        self.sent.append(command.copy())

    def wait(self, seconds: float) -> None:
        """Simulate the robot in MuJoCo for a duration [s] with the last command.

        The sum of all durations is rounded to whole time steps, since the rounding errors of
        single durations would add up.
        """
        model, data = self._drive.model, self._data
        data.ctrl[:] = self._drive.command(self._loaded, self.sent[-1] - self.offset)
        self._time += seconds
        steps = round((self._time - self._simulated_time) / model.opt.timestep)
        if steps > 0:
            mujoco.mj_step(model, data, nstep=steps)
            self._simulated_time += steps * model.opt.timestep

    def close(self) -> None:
        """Do nothing: a simulation has no connection to close."""

    def prepare(
        self,
        stand: PlannedStand,
        loads: Mapping[str, Array],
        instructions: Sequence[str],  # noqa: ARG002 - follows the plan
    ) -> bool:
        """Attach known loads, and set the robot just above the ground in the commanded posture.

        The base is rotated such that a plane through the stance feet is level.

        Args:
            stand: Stand for which the robot is prepared.
            loads: {link: mass [kg] and position (x, y, z) [m] of a known load, shape (4,)}.
            instructions: Steps for an operator; ignored.

        Returns:
            True: the stand is not skipped.
        """
        self._attach_loads(loads)
        self._place_on_feet(stand.swing)
        return True

    def _place_on_feet(self, swing: Sequence[str]) -> None:
        """Reset the simulation to the commanded posture, at rest, slightly above the ground.

        The base is rotated such that a plane through the feet other than ``swing`` is level.
        """
        robot, joints = self._loaded, self.sent[-1] - self.offset
        contact_points = [
            point for foot, points in robot.feet.items() if foot not in swing for point in points
        ]
        qpos, base = robot.make_qpos(joints), compute_level_base(robot, joints, contact_points)
        qpos[2], qpos[3:7] = base[4], base[:4]
        all_points = robot.contact_points
        lowest = Configuration(robot, qpos).foot_centres(all_points)[:, 2]
        lowest = lowest - [robot.contact_radius[point] for point in all_points]
        qpos[2] += _DROP_HEIGHT - min(lowest)
        mujoco.mj_resetData(self._drive.model, self._data)
        self._data.qpos[robot.mj_convention.qpos_index] = qpos

    def feet_up(
        self,
        feet: Sequence[str],
        planned: Sequence[str],  # noqa: ARG002 - evaluates the contacts
    ) -> tuple[str, ...] | Diagnostic:
        """Return the names of the feet with hardly any normal force in the simulation.

        The result is a diagnostic if the stand cannot be used; for example, another part touches
        the ground, or a foot touches the robot.

        Args:
            feet: All feet of the robot.
            planned: Ignored.
        """
        model, data = self._drive.model, self._data
        carried, force = dict.fromkeys(feet, 0.0), np.zeros(6)
        bodies = list_contact_bodies(model, data)
        feet_of = self._loaded.foot_geoms
        for number in np.flatnonzero(find_acting_contacts(data)).tolist():
            geoms = data.contact[number].geom
            touching_feet = [feet_of[int(geom)] for geom in geoms if int(geom) in feet_of]
            is_on_ground = not bodies[number].all()  # the world has the id 0
            if not (touching_feet and is_on_ground):
                names = [model.body(body).name for body in bodies[number].tolist() if body]
                return diagnose("part-touches", link=names[0], other=next(iter(names[1:]), None))
            mujoco.mj_contactForce(model, data, number, force)
            carried[touching_feet[0]] += float(force[0])
        min_load = _MIN_LOAD_RATIO * self.total_mass * float(np.linalg.norm(self.robot.gravity))
        swing = tuple(foot for foot in feet if carried[foot] < min_load)
        if len(feet) - len(swing) >= 3:
            return swing
        carrying = tuple(foot for foot in feet if foot not in swing)
        return diagnose("stand-on-few-feet", feet=carrying)

    def stops(self) -> bool:
        """Return False: the simulated operator does not stop the recording."""
        return False


def open_simulated(robot: Robot, arguments: str) -> tuple[SimulatedRobot, SimulatedRobot]:
    """Create a simulated robot, which is both the bridge and the operator.

    Args:
        robot: Robot, with the values of the files.
        arguments: ``SEED`` or ``SEED;kp=60`` (seed of the perturbations, stated stiffness
            [N m/rad, N/m]); empty for seed 0.

    Returns:
        The simulated robot, twice: as the bridge and as the operator.

    Raises:
        ConfigurationError: If the seed or the stiffness is invalid, or the base is fixed.
        ModelError: If a joint has no position servo.
    """
    seed, _, stiffness = (arguments or "0").partition(";kp=")
    try:
        number, kp = int(seed), float(stiffness) if stiffness else None
        np.random.default_rng(number)  # refuses a negative seed
    except (OverflowError, ValueError) as error:
        raise ConfigurationError(
            "--bridge", diagnose("no-bridge-words", words=arguments)
        ) from error
    robot.check_floating()
    simulated = SimulatedRobot(robot, number, kp)
    return simulated, simulated
