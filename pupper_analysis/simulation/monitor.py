"""What a simulation's states say: has it fallen, what touches the ground, has it come to rest."""

from __future__ import annotations

import math
from collections.abc import Collection, Container, Iterable
from dataclasses import dataclass, field

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pupper_analysis.base.arrays import rotation_from_quaternion
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.results import Result
from pupper_analysis.robot import contact
from pupper_analysis.robot.as_published import MIN_POSTURE_DEVIATION
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.fall import (
    FALLEN_TILT,
    has_collapsed,
    horizontal_distance,
    tilt_between,
)
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.terrain import weld_forces
from pupper_analysis.simulation.rollout import STATE
from pupper_analysis.stance.stand import Stand

Array = NDArray[np.float64]

FALLEN_HEIGHT = 0.5
"""What has lost more than this share of the height of its centre of mass has fallen."""

MAX_STANDING_TILT = math.radians(10)
"""Largest tilt of the base of a robot that stands (rad). Chosen, not tuned: dropped variants that
stand tilt by up to 2.6 deg; v3-long-leg, which sits on its shanks, by 16 deg."""


@dataclass(frozen=True, eq=False)
class StandCheck(Result):
    """Result of the check whether a robot stands, from one simulated state.

    Attributes:
        tilt: Angle between the vertical axis of the base and that of the expected stand (rad).
        height: CoM height above the ground, with the CoM fixed in the base (m).
        expected_height: CoM height of the expected stand (m).
        touching: Bodies other than feet that touch the ground.
        collapses: Whether the robot has fallen over, sunk, been thrown up, or left its place; of a
            robot whose base is fixed, whether a joint has left the posture.
    """

    tilt: float = field(metadata={"unit": "rad"})
    height: float = field(metadata={"unit": "m"})
    expected_height: float = field(metadata={"unit": "m"})
    touching: tuple[str, ...]
    collapses: bool

    @property
    def stands(self) -> bool:
        """Whether the robot is upright and at the expected height, and only its feet touch."""
        return self.tilt <= MAX_STANDING_TILT and not self.touching and not self.collapses


@dataclass(frozen=True, eq=False)
class Upright:
    """How a robot is to stand, against which a fall is seen.

    What is watched is the point of its base at which its centre of mass is when it stands so; of
    one whose base is fixed, its joints.

    Attributes:
        robot: The robot.
        rotation: (3, 3) which its base is to have.
        place: (3,) where that point is to be (m).
        lever: (3,) where it is in the base's frame (m).
        size: Its height above the lowest of the feet's contacts (m).
        joints: (nu,) where they are to be (rad, m).
    """

    robot: Robot
    rotation: Array
    place: Array
    lever: Array
    size: float
    joints: Array

    @classmethod
    def of(cls, robot: Robot, qpos: Array, rotation: Array | None = None) -> Upright:
        """Looks at a robot as it is to stand.

        Args:
            robot: The robot.
            qpos: (nq,) its configuration.
            rotation: (3, 3) which its base is to have; that of ``qpos`` by default.
        """
        config, joints = Configuration(robot, qpos), qpos[robot.nq - robot.nu :]
        com = config.center_of_mass()
        if not robot.floating:
            return cls(robot, np.eye(3), com, np.zeros(3), 1.0, joints)
        turned = rotation_from_quaternion(qpos[3:7])
        feet = config.foot_positions()
        low = min((feet[foot][2] - robot.contact_radius[foot] for foot in feet), default=0.0)
        lever = turned.T @ (com - qpos[:3])
        size = float(com[2] - low)
        if robot.welds:  # it stands on what is bolted, which may be above it
            size = float(np.linalg.norm(com - qpos[:3])) + robot.stand_height
        return cls(robot, turned if rotation is None else rotation, com, lever, size, joints)

    def lean(self, state: Array) -> float:
        """Returns how far the base of a state leans (rad)."""
        return base_lean(self.robot, self.rotation, state)

    def _place(self, state: Array) -> Array:
        base = state[1 + self.robot.mj_convention.qpos_index[:7]]
        placed: Array = base[:3] + rotation_from_quaternion(base[3:]) @ self.lever
        return placed

    def check_stand(self, state: Array, touching: Collection[str]) -> StandCheck:
        """Check whether a robot stands: the one predicate for all commands.

        Args:
            state: State of a simulation (mjSTATE_FULLPHYSICS).
            touching: Bodies other than feet that touch the ground in that state.
        """
        lost = 0.0 if self.robot.bolted else float(self.place[2] - self._place(state)[2])
        return StandCheck(
            tilt=0.0 if self.robot.bolted else self.lean(state),
            height=self.size - lost,
            expected_height=self.size,
            touching=tuple(sorted(touching)),
            collapses=self.has_collapsed(state),
        )

    def has_fallen(self, state: Array) -> bool:
        """Tells whether a robot has fallen over in a state."""
        if self.robot.bolted:
            return False
        lost = self.place[2] - self._place(state)[2]
        return self.lean(state) > FALLEN_TILT or bool(lost > (1 - FALLEN_HEIGHT) * self.size)

    def has_collapsed(self, state: Array) -> bool:
        """Tells whether a robot no longer stands in a state, or has left its posture."""
        if self.robot.bolted:
            joints = state[1 + self.robot.mj_convention.qpos_index[-self.robot.nu :]]
            return not bool((np.abs(joints - self.joints) < MIN_POSTURE_DEVIATION).all())
        place = self._place(state)
        away = horizontal_distance(self.place, place)
        return has_collapsed(self.lean(state), float(self.place[2] - place[2]), away, self.size)


@dataclass(frozen=True, eq=False)
class Sight:
    """What is seen at one state.

    Attributes:
        time: s.
        forces: {foot that touches: (3,)} of the ground on it, in world axes (N).
        bodies: Names of the other bodies that touch the ground.
    """

    time: float
    forces: dict[str, Array]
    bodies: set[str]

    def idle(self, feet: Iterable[str]) -> list[str]:
        """Returns those of the feet that carry nothing."""
        return [foot for foot in feet if foot not in self.forces or not self.forces[foot].any()]


class Watcher:
    """Looks at single states of a robot's rollouts.

    Args:
        robot: The robot.
        model: What was simulated.

    Attributes:
        data: MuJoCo's, of the state last looked at.
    """

    def __init__(self, robot: Robot, model: mujoco.MjModel):
        self._robot, self._model = robot, model
        self.data = mujoco.MjData(model)

    def look(self, state: Array, ctrl: Array) -> Sight:
        """Looks at a state (mjSTATE_FULLPHYSICS) under a command, with all its forces."""
        mujoco.mj_setState(self._model, self.data, state, STATE)
        self.data.ctrl[:] = ctrl
        mujoco.mj_forward(self._model, self.data)
        forces, bodies = contact.ground_forces(self._model, self.data, self._robot.foot_geoms)
        return Sight(float(self.data.time), forces, bodies)

    def touching(self, state: Array) -> set[str]:
        """Returns the bodies that touch the ground, but for the feet: quicker than ``look``."""
        mujoco.mj_setState(self._model, self.data, state, STATE)
        mujoco.mj_kinematics(self._model, self.data)
        mujoco.mj_collision(self._model, self.data)
        return contact.bodies_on_ground(self._model, self.data, self._robot.foot_geoms)


def foot_centres(robot: Robot, data: mujoco.MjData) -> dict[str, Array]:
    """Returns {foot: (3,)} where MuJoCo has the centres of the feet (m)."""
    bodies = [body for body, _ in robot.contact_places.values()]
    places = np.array([place for _, place in robot.contact_places.values()]).reshape(-1, 3, 1)
    turned = data.xmat[bodies].reshape(-1, 3, 3) @ places
    return dict(zip(robot.contact_places, data.xpos[bodies] + turned[..., 0], strict=True))


def base_heights(robot: Robot, states: Array) -> Array:
    """Returns the base's height in every state of a rollout; 0 of one that its file fixes."""
    if not robot.floating:
        return np.zeros(states.shape[:-1])
    heights: Array = states[..., 1 + robot.mj_convention.qpos_index[2]]
    return heights


def turned_by(robot: Robot, rotation: Array, state: Array) -> float:
    """Returns the angle of the base's rotation against the given one (rad)."""
    if not robot.floating:
        return 0.0
    quaternion = state[1 + robot.mj_convention.qpos_index[3:7]]
    return float(np.linalg.norm(pin.log3(rotation.T @ rotation_from_quaternion(quaternion))))


def base_lean(robot: Robot, rotation: Array, state: Array) -> float:
    """Returns how far the base of a state leans off a rotation's vertical (rad); yaw is no lean."""
    quaternion = state[1 + robot.mj_convention.qpos_index[3:7]]
    return tilt_between(rotation, rotation_from_quaternion(quaternion))


def has_diverged(states: Array, timestep: float) -> bool:
    """Tells whether a rollout broke down: MuJoCo resets the state, and so the time, if it does."""
    times = states[..., 0]
    with np.errstate(invalid="ignore", over="ignore"):  # a sum of infinities is no number
        # Quicker than to look at each; where the sum overflows, each is looked at.
        finite = math.isfinite(states.sum()) or np.isfinite(states).all()
    return not bool(finite and (times[..., 1:] - times[..., :-1] > timestep / 2).all())


def tell_divergence(integrator: str, timestep: float) -> Diagnostic:
    """Says that a rollout broke down."""
    step = Quantity(timestep, "s")
    return diagnose("simulation-diverged", integrator=integrator, timestep=step)


def tell_fall(leaning: float, height: float) -> Diagnostic:
    """Says that a robot has fallen over."""
    tilt, left = Quantity(leaning, "rad"), Quantity(height, "m")
    return diagnose("fell-over", tilt=tilt, height=left, time=None)


@dataclass(frozen=True, eq=False)
class SimulationSettings(Result):
    """What a stand was simulated with.

    Attributes:
        feedforward: Whether ctrl = q* + tau / kp (otherwise ctrl = q*).
        integrator: MuJoCo's integrator.
        timestep: s.
        duration: s.
        kp: (nu,) N m/rad.
        kd: (nu,) N m s/rad.
    """

    feedforward: bool
    integrator: str
    timestep: float = field(metadata={"unit": "s"})
    duration: float = field(metadata={"unit": "s"})
    kp: Array = field(metadata={"unit": "N m/rad"})
    kd: Array = field(metadata={"unit": "N m s/rad"})


_SAMPLE_TIME = 0.02  # s between the states that are looked at

LIGHT_FOOT = 1e-3
"""Share of the weight; a foot that is predicted to carry less may leave the ground for a moment.
Minimum tangential forces leave two of four feet on unlike slopes with 5e-5 to 6e-4 of the weight, 4
to 20 mN, which every nudge exceeds."""

TOUCH = 1e-3
"""Parts that push on each other by less of the weight only just touch."""

LAST = 1.0
"""Time in which what a stand settles at is measured (s)."""


@dataclass(frozen=True, eq=False)
class Watch:
    """What a close look at some states of a rollout shows.

    Attributes:
        failures: What touches the ground, and should not; or should, and does not. Where nothing is
            to touch anything, what does.
        lifted: Light feet that left the ground, with the time when they first did (s).
        touching: Pairs of its bodies that push on each other, settled.
        torques: (nu,) of motors, settled (N m).
        forces: Of each foot (3,), and of what is welded or grips that of its constraint (N).
        feet_settled: Where each is (3,) (m).
    """

    failures: tuple[Diagnostic, ...]
    touching: tuple[tuple[str, str], ...]
    torques: Array
    forces: dict[str, Array]
    feet_settled: dict[str, Array]
    lifted: dict[str, float] = field(default_factory=dict)

    def drops(self, stand: Stand) -> dict[str, Array]:
        """Returns by what (3,) the stance feet ended below, or beside, where they should be (m)."""
        return {
            foot: stand.foot_targets[foot] - self.feet_settled[foot] for foot in stand.stance_feet
        }


def watch_contacts(
    robot: Robot,
    model: mujoco.MjModel,
    stand: Stand,
    states: Array,
    ctrl: Array,
    settling: int,
    loaded: Container[str],
) -> Watch:
    """Looks at contacts all along, and at torques and forces in the last second of settling.

    The feet in ``loaded`` must not leave the ground. Other feet are predicted to carry less than
    ``LIGHT_FOOT`` of the weight; they may.
    """
    watcher = Watcher(robot, model)
    step = max(1, round(_SAMPLE_TIME / model.opt.timestep))
    touched: dict[str, float] = {}
    lost: dict[str, float] = {}
    torques = np.zeros(robot.nu)
    total = {name: np.zeros(3) for name in (*robot.feet, *robot.welds)}
    carrying = robot.feet_with(stand.stance_feet)
    feet = {foot: np.zeros(3) for foot in robot.contact_points}
    count, touching, pressed = 0, set[tuple[str, str]](), set[tuple[str, str]]()
    alone = robot.bolted and not stand.stance_feet
    least = TOUCH * robot.usual_weight
    last_second = range(settling - round(LAST / model.opt.timestep), settling)
    # Backwards: the first moment stays. Both parts end with their last state.
    for index in (*range(len(states) - 1, settling - 1, -step), *range(settling - 1, -1, -step)):
        seen = watcher.look(states[index], ctrl)
        if alone:
            pressed |= pushing_bodies(model, watcher.data, least)
        else:
            touched |= dict.fromkeys(seen.bodies, seen.time)
            touched |= {foot: seen.time for foot in seen.forces if foot not in carrying}
        lost |= dict.fromkeys(seen.idle(carrying), seen.time)
        if index in last_second:
            count += 1
            pushing = pushing_bodies(model, watcher.data, least)
            touching |= {pair for pair in pushing if "world" not in pair}
            torques += watcher.data.qfrc_actuator[robot.mj_convention.qvel_index[-robot.nu :]]
            for name, force in (seen.forces | weld_forces(robot, model, watcher.data)).items():
                total[name] += force
            for foot, centre in foot_centres(robot, watcher.data).items():
                feet[foot] += centre
    failures = [
        diagnose("body-touches-ground", subject=("body", body), time=Quantity(moment, "s"))
        for body, moment in sorted(touched.items())
    ]
    failures += [
        diagnose("foot-idle", subject=("foot", foot), time=Quantity(moment, "s"))
        for foot, moment in sorted(lost.items())
        if foot in loaded
    ]
    failures += [diagnose("parts-touch", bodies=pair) for pair in sorted(pressed)]
    return Watch(
        failures=tuple(failures),
        touching=tuple(sorted(touching - pressed)),
        torques=torques / count,
        forces={foot: force / count for foot, force in total.items()},
        feet_settled={foot: position / count for foot, position in feet.items()},
        lifted={foot: moment for foot, moment in sorted(lost.items()) if foot not in loaded},
    )


def pushing_bodies(
    model: mujoco.MjModel, data: mujoco.MjData, least: float
) -> set[tuple[str, str]]:
    """Returns the pairs of bodies that push on each other by so much (N), or on the world's."""
    pairs, force = set(), np.zeros(6)
    for number, bodies in enumerate(model.geom_bodyid[data.contact.geom].tolist()):
        mujoco.mj_contactForce(model, data, number, force)
        if force[0] > least:
            first, second = sorted(model.body(body).name for body in bodies)
            pairs.add((first, second))
    return pairs
