"""Evaluate the states of simulations: falls, ground contacts, motor torques, contact forces.

`StandReference` compares a state with the expected stand, and decides if the robot has fallen or
left the stand. `ContactSampler` computes the ground contacts of a single state. `record_contacts`
computes the contacts of a rollout, with mean torques and forces. All states are MuJoCo's
mjSTATE_FULLPHYSICS.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Container, Iterable, Iterator, Mapping
from dataclasses import dataclass, field

import mujoco
import numpy as np
import pinocchio as pin

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.arrays import rotation_from_quaternion
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.results import Result
from pupper_analysis.base.units import DAMPING_UNIT, STIFFNESS_UNIT
from pupper_analysis.robot import contact
from pupper_analysis.robot.as_published import MAX_POSTURE_DEVIATION
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.fall import (
    FALLEN_TILT,
    has_collapsed,
    horizontal_distance,
    is_lifted,
    tilt_between,
)
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.terrain import find_touched_surface, weld_forces
from pupper_analysis.simulation.rollout import STATE_SPEC
from pupper_analysis.stance.stand import Stand

FALLEN_HEIGHT_RATIO = 0.5
"""Lower bound [1] of the height of the CoM above the feet, divided by the expected height. A robot
with a lower CoM has fallen. Chosen, not tuned.
"""

MAX_STANDING_TILT = math.radians(10)
"""Upper bound of the tilt of the base [rad] of a robot that stands (`StandCheck.stands`). Chosen
between two measured tilts: up to 2.6 deg for dropped robots that stand, and 16 deg for a robot that
sits on its shanks."""


@dataclass(frozen=True, eq=False)
class StandCheck(Result):
    """Result of the check whether a robot stands, from a simulated state.

    Attributes:
        tilt: Tilt of the base relative to the expected stand, regardless of heading (rad); 0 for a
            fixed or welded base.
        height: ``expected_height`` minus the height loss of the point of the base that coincides
            with the CoM in the expected stand (m); ``expected_height`` for a fixed or welded base.
        expected_height: CoM height of the expected stand (m), as ``StandReference.com_height``.
        touching: Bodies that touch the ground with a part other than a foot.
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
        """Whether the robot is upright, touches the ground with feet only, and has not collapsed.

        Upright means a tilt of at most `MAX_STANDING_TILT` (10 deg).
        """
        return self.tilt <= MAX_STANDING_TILT and not self.touching and not self.collapses


@dataclass(frozen=True, eq=False)
class StandReference:
    """Pose of the expected stand: reference for the check whether a simulated robot stands.

    For a free base, a reference point is fixed in the base. It coincides with the CoM in the
    expected stand. For a fixed base, the joint positions are compared instead.

    Attributes:
        robot: Robot.
        rotation: Expected orientation of the base, base to world, shape (3, 3).
        com_position: Expected position of the reference point in the world, shape (3,) [m].
        com_offset: Position of the reference point in the base frame, shape (3,) [m]; zero for a
            fixed base.
        com_height: Expected height of the reference point above the lowest point of all feet [m]
            (above z = 0 without feet); for a robot with welds or grips, distance between base and
            CoM plus the stand height; 1 for a fixed base.
        joints: Expected joint positions, shape (nu,) [rad, m].
    """

    robot: Robot
    rotation: Array
    com_position: Array
    com_offset: Array
    com_height: float
    joints: Array

    @classmethod
    def from_configuration(
        cls, robot: Robot, qpos: Array, rotation: Array | None = None
    ) -> StandReference:
        """Create the reference from a stand's configuration, for the check of simulated states.

        Args:
            robot: Robot.
            qpos: Configuration of the stand, shape (nq,).
            rotation: Expected orientation of the base, base to world, shape (3, 3); that of
                ``qpos`` by default. Ignored for a fixed base, whose orientation is the identity.
        """
        config, joints = Configuration(robot, qpos), qpos[robot.nq - robot.nu :]
        com = config.center_of_mass()
        if not robot.floating:
            return cls(robot, np.eye(3), com, np.zeros(3), 1.0, joints)
        base_rotation = rotation_from_quaternion(qpos[3:7])
        feet = config.foot_positions()
        low = min((feet[foot][2] - robot.contact_radius[foot] for foot in feet), default=0.0)
        com_offset = base_rotation.T @ (com - qpos[:3])
        com_height = float(com[2] - low)
        if robot.fixed_parts:  # the welded part may be above the base
            com_height = float(np.linalg.norm(com - qpos[:3])) + robot.stand_height
        return cls(
            robot,
            base_rotation if rotation is None else rotation,
            com,
            com_offset,
            com_height,
            joints,
        )

    def tilt(self, state: Array) -> float:
        """Compute the tilt [rad] of a free base from the expected orientation, regardless of yaw.

        ``state`` is an mjSTATE_FULLPHYSICS.
        """
        return base_tilt(self.robot, self.rotation, state)

    def _locate_com_point(self, state: Array) -> Array:
        """Return the world position (3,) [m] of the base point that represents the CoM."""
        base = state[1 + self.robot.mj_convention.qpos_index[:7]]
        position: Array = base[:3] + rotation_from_quaternion(base[3:]) @ self.com_offset
        return position

    def check_stand(self, state: Array, touching: Collection[str]) -> StandCheck:
        """Check if a robot stands in a simulated state, by tilt [rad], height [m] and contacts.

        Args:
            state: State of a simulation (mjSTATE_FULLPHYSICS).
            touching: Bodies that touch the ground in this state with a part other than a foot.
        """
        lost = (
            0.0
            if self.robot.is_base_fixed
            else float(self.com_position[2] - self._locate_com_point(state)[2])
        )
        return StandCheck(
            tilt=0.0 if self.robot.is_base_fixed else self.tilt(state),
            height=self.com_height - lost,
            expected_height=self.com_height,
            touching=tuple(sorted(touching)),
            collapses=self.has_collapsed(state),
        )

    def has_fallen(self, state: Array) -> bool:
        """Return True if the base is tilted by more than ``FALLEN_TILT``, or the CoM is too low.

        The CoM is represented by the point of the base that coincides with the CoM in the expected
        stand (`FALLEN_HEIGHT_RATIO`). A fixed base cannot fall. ``state`` is an
        mjSTATE_FULLPHYSICS.
        """
        if self.robot.is_base_fixed:
            return False
        lost = self.com_position[2] - self._locate_com_point(state)[2]
        return self.tilt(state) > FALLEN_TILT or bool(
            lost > (1 - FALLEN_HEIGHT_RATIO) * self.com_height
        )

    def has_collapsed(self, state: Array) -> bool:
        """Return True if a robot has fallen, sunk, been thrown up or travelled from its stand.

        `fall.has_collapsed` defines the limits of tilt, height and horizontal travel. With a fixed
        base, a joint that has left the posture counts (``MAX_POSTURE_DEVIATION``). ``state`` is an
        mjSTATE_FULLPHYSICS.
        """
        if self.robot.is_base_fixed:
            joints = state[1 + self.robot.mj_convention.qpos_index[-self.robot.nu :]]
            return not bool((np.abs(joints - self.joints) < MAX_POSTURE_DEVIATION).all())
        position = self._locate_com_point(state)
        distance = horizontal_distance(self.com_position, position)
        return has_collapsed(
            self.tilt(state), float(self.com_position[2] - position[2]), distance, self.com_height
        )

    def is_lifted(self, state: Array) -> bool:
        """Return True if a robot is upright and far above the expected stand (`fall.is_lifted`).

        The result is False for a fixed base. ``state`` is an mjSTATE_FULLPHYSICS.
        """
        if self.robot.is_base_fixed:
            return False
        lost = float(self.com_position[2] - self._locate_com_point(state)[2])
        return is_lifted(self.tilt(state), lost, self.com_height)


@dataclass(frozen=True, eq=False)
class ContactSample:
    """Contacts of a robot with the ground at a single state of a simulation.

    Attributes:
        time: Simulated time [s].
        forces: {foot that touches the ground: force of the ground on the foot, shape (3,) [N], in
            world axes}.
        bodies: Names of the bodies that touch the ground with a geom that belongs to no foot.
    """

    time: float
    forces: dict[str, Array]
    bodies: set[str]

    def presses_all(self, feet: Iterable[str], min_force: float) -> bool:
        """Return True if the ground exerts more than ``min_force`` [N] on each foot in ``feet``."""
        return all(
            foot in self.forces and math.hypot(*self.forces[foot]) > min_force for foot in feet
        )

    def unloaded_feet(self, feet: Iterable[str]) -> list[str]:
        """Return the names of the feet in ``feet`` on which the ground exerts no force."""
        return [foot for foot in feet if foot not in self.forces or not self.forces[foot].any()]


class ContactSampler:
    """Computes ground forces and touching bodies at single states of a simulation.

    Args:
        robot: Robot.
        model: MuJoCo model that was simulated.

    Attributes:
        data: MuJoCo data of the state evaluated last.
    """

    def __init__(self, robot: Robot, model: mujoco.MjModel):
        self._robot, self._model = robot, model
        self.data = mujoco.MjData(model)
        self._last: tuple[bytes, bytes, ContactSample] | None = None

    def sample(self, state: Array, ctrl: Array) -> ContactSample:
        """Compute the ground forces on the feet at a state, and find other bodies on the ground.

        If state and command equal those of the last sample, including the time, the last sample is
        returned. After a divergence, all states of a rollout are equal.

        Args:
            state: State of a simulation (mjSTATE_FULLPHYSICS).
            ctrl: Command of the actuators, shape (model.nu,).
        """
        arguments = state.tobytes(), ctrl.tobytes()
        if self._last is not None and self._last[:2] == arguments:
            return self._last[2]
        mujoco.mj_setState(self._model, self.data, state, STATE_SPEC)
        self.data.ctrl[:] = ctrl
        mujoco.mj_forward(self._model, self.data)
        forces, bodies = contact.ground_forces(self._model, self.data, self._robot.foot_geoms)
        sample = ContactSample(float(self.data.time), forces, bodies)
        self._last = *arguments, sample
        return sample

    def find_ground_bodies(self, state: Array) -> set[str]:
        """Return the names of bodies that touch the ground with geoms that belong to no foot.

        ``state`` is an mjSTATE_FULLPHYSICS.
        """
        self._last = None  # ``data`` is overwritten
        mujoco.mj_setState(self._model, self.data, state, STATE_SPEC)
        mujoco.mj_kinematics(self._model, self.data)
        mujoco.mj_collision(self._model, self.data)
        return contact.bodies_on_ground(self._model, self.data, self._robot.foot_geoms)

    def find_surface(self, body: str) -> Diagnostic | None:
        """Create the part of a message that names the step, plane or bar which a body touches.

        The contacts belong to the state that was evaluated last. None, for example, for the
        floor.
        """
        return find_touched_surface(self._model, self.data, body)


def foot_centres(robot: Robot, data: mujoco.MjData) -> dict[str, Array]:
    """Compute {contact point: centre of its sphere in the world frame, shape (3,) [m]}.

    ``data`` must contain the kinematics.
    """
    bodies = [body for body, _ in robot.contact_places.values()]
    offsets = np.array([place for _, place in robot.contact_places.values()]).reshape(-1, 3, 1)
    rotated_offsets = data.xmat[bodies].reshape(-1, 3, 3) @ offsets
    return dict(zip(robot.contact_places, data.xpos[bodies] + rotated_offsets[..., 0], strict=True))


def base_heights(robot: Robot, states: Array) -> Array:
    """Return the world height [m] of the base frame in ``states``; zeros for a fixed base.

    The states (mjSTATE_FULLPHYSICS) have the shape (..., size), the heights (...).
    """
    if not robot.floating:
        return np.zeros(states.shape[:-1])
    heights: Array = states[..., 1 + robot.mj_convention.qpos_index[2]]
    return heights


def rotation_angle(robot: Robot, rotation: Array, state: Array) -> float:
    """Compute the rotation angle [rad] of the base in a state from a reference orientation.

    Unlike `base_tilt`, the angle includes yaw. It is 0 for a fixed base.

    Args:
        robot: Robot.
        rotation: Reference orientation, base to world, shape (3, 3).
        state: State of a simulation (mjSTATE_FULLPHYSICS).
    """
    if not robot.floating:
        return 0.0
    quaternion = state[1 + robot.mj_convention.qpos_index[3:7]]
    return float(np.linalg.norm(pin.log3(rotation.T @ rotation_from_quaternion(quaternion))))


def base_tilt(robot: Robot, rotation: Array, state: Array) -> float:
    """Compute the tilt [rad] of the base in a state from a reference orientation, without yaw.

    Args:
        robot: Robot with a free base.
        rotation: Reference orientation, base to world, shape (3, 3).
        state: State of a simulation (mjSTATE_FULLPHYSICS).
    """
    quaternion = state[1 + robot.mj_convention.qpos_index[3:7]]
    return tilt_between(rotation, rotation_from_quaternion(quaternion))


def has_diverged(states: Array, timestep: float) -> bool:
    """Return True if a rollout diverged: a value is not finite, or the time did not advance.

    MuJoCo may reset the state, with the time, if the simulation diverges.

    Args:
        states: Successive states (mjSTATE_FULLPHYSICS), shape (..., n, size).
        timestep: Time between successive states [s].
    """
    times = states[..., 0]
    with np.errstate(invalid="ignore", over="ignore"):  # a sum of infinities is no number
        # The sum is faster than a test of each value. If the sum overflows, each value is tested.
        finite = math.isfinite(states.sum()) or np.isfinite(states).all()
    return not bool(finite and (times[..., 1:] - times[..., :-1] > timestep / 2).all())


def describe_divergence(integrator: str, timestep: float) -> Diagnostic:
    """Create the message that a simulation with time step ``timestep`` [s] diverged."""
    step = Quantity(timestep, "s")
    return diagnose("simulation-diverged", integrator=integrator, timestep=step)


def describe_fall(tilt_angle: float, height: float) -> Diagnostic:
    """Create the message that the robot fell over: tilt [rad] and height [m] of the base."""
    tilt, remaining_height = Quantity(tilt_angle, "rad"), Quantity(height, "m")
    return diagnose("fell-over", tilt=tilt, height=remaining_height, time=None)


@dataclass(frozen=True, eq=False)
class SimulationSettings(Result):
    """Settings with which a stand was simulated.

    Attributes:
        feedforward: Whether ctrl = q* + tau / kp (otherwise ctrl = q*).
        integrator: Name of MuJoCo's integrator.
        timestep: Time step (s).
        duration: Simulated time (s).
        kp: Servo stiffness, shape (nu,) (N m/rad or N/m).
        kd: Servo damping, shape (nu,) (N m s/rad or N s/m).
    """

    feedforward: bool
    integrator: str
    timestep: float = field(metadata={"unit": "s"})
    duration: float = field(metadata={"unit": "s"})
    kp: Array = field(metadata={"unit": STIFFNESS_UNIT})
    kd: Array = field(metadata={"unit": DAMPING_UNIT})


_SAMPLE_TIME = 0.02
"""Time between the states whose contacts ``record_contacts`` evaluates [s]. Chosen, not tuned."""


_EQUAL_POSITION_ATOL = 1e-6
"""Tolerance of positions [m, rad] and activations with which two states count as equal in
`record_contacts`. Chosen: if a foot of v3 moves by 1e-6 m into MuJoCo's soft ground, its force
changes by 3 mN, a tenth of `MIN_PUSH_RATIO` of the weight.
"""

_EQUAL_SPEED_ATOL = 1e-5
"""Tolerance of velocities [m/s, rad/s] with which two states count as equal in `record_contacts`.
Chosen: for v3, a vertical base velocity at the tolerance changes a contact force by 0.4 mN."""

LIGHT_FOOT_LOAD = 5e-3
"""Upper bound [1] of the ratio (load of a foot) / (load of all feet) with which the foot counts as
light (almost unloaded). A light foot may leave the ground without a failure. Measured on unequal
slopes: with minimum tangential forces, two of four feet carry 5e-5 to 1.05e-3 of the weight, and a
nudge lifts these feet.
"""

MIN_PUSH_RATIO = 1e-3
"""Lower bound of a contact force that is not negligible, divided by the robot's weight [1]; for
example, of bodies that are reported as touching. Chosen, not tuned.
"""

MEASURING_TIME = 1.0
"""Duration [s] of the interval in which torques, forces, heights and positions are averaged:
usually the interval before the nudge. Chosen, not tuned.
"""


@dataclass(frozen=True, eq=False)
class ContactRecord:
    """Contacts in a rollout of a stand, with mean forces and torques before the nudge.

    A nudge is a small velocity of all coordinates. "Settled" values are means over the last second
    before the nudge.

    Attributes:
        failures: Bodies and swing feet that touch the ground; stance feet that unload although they
            must not. For a fixed base without stance feet: all pairs of bodies that push on each
            other, instead of touching bodies.
        touching: Pairs of robot bodies that push on each other in the settled state and are not in
            ``failures``.
        torques: Settled motor torques, shape (nu,) [N m, N].
        forces: {foot: settled force of the ground; weld or grip: settled force of MuJoCo's
            constraint}, shape (3,) each [N], in world axes.
        feet_settled: {contact point: settled position of the centre in the world, shape (3,) [m]}.
        lifted: {light foot that left the ground: time at which it first left the ground [s]}.
        idle_late: Stance feet without load at any time after the start of the last second before
            the nudge.
    """

    failures: tuple[Diagnostic, ...]
    touching: tuple[tuple[str, str], ...]
    torques: Array
    forces: dict[str, Array]
    feet_settled: dict[str, Array]
    lifted: dict[str, float] = field(default_factory=dict)
    idle_late: frozenset[str] = frozenset()

    def compute_foot_drops(self, stand: Stand) -> dict[str, Array]:
        """Compute the target minus the mean position of each contact point, shape (3,) [m].

        The positions are in the world frame, and averaged over the last second before the nudge.
        Keys are the contact points of the stance feet.
        """
        return {
            foot: stand.foot_targets[foot] - self.feet_settled[foot] for foot in stand.stance_feet
        }


def record_contacts(
    robot: Robot,
    model: mujoco.MjModel,
    stand: Stand,
    states: Array,
    ctrl: Array,
    settling: int,
    loaded: Container[str],
    *,
    is_released: bool = False,
) -> ContactRecord:
    """Find contact failures in a rollout of a stand, and average torques and forces before a nudge.

    Torques [N m, N], forces [N] and foot positions [m] are means over the last second before the
    nudge. The states are sampled about every `_SAMPLE_TIME`.

    Args:
        robot: Robot.
        model: MuJoCo model that was simulated.
        stand: Stand.
        states: States after each step (mjSTATE_FULLPHYSICS), shape (n, size).
        ctrl: Actuator commands, shape (model.nu,).
        settling: Number of states before the nudge (a small velocity of all coordinates).
        loaded: Feet that must not leave the ground. Other feet may leave it, for example feet with
            a predicted load below `LIGHT_FOOT_LOAD`.
        is_released: Whether the servos start without the static torques, so that the robot drops by
            its sag and bounces. The feet ``loaded`` may then leave the ground until the last second
            before the nudge.
    """
    sampler = ContactSampler(robot, model)
    step = max(1, round(_SAMPLE_TIME / model.opt.timestep))
    touched: dict[str, float] = {}
    surfaces: dict[str, Diagnostic | None] = {}
    unloaded: dict[str, float] = {}
    idle_late: set[str] = set()
    means = _SettledMeans(robot, model)
    carrying = robot.feet_with(stand.stance_feet)
    touching, pressed = set[tuple[str, str]](), set[tuple[str, str]]()
    is_footless = robot.is_base_fixed and not stand.stance_feet
    min_force = MIN_PUSH_RATIO * robot.usual_weight
    last_second = range(settling - round(MEASURING_TIME / model.opt.timestep), settling)
    tolerances = np.full(states.shape[1] - 1, _EQUAL_POSITION_ATOL)
    tolerances[model.nq : model.nq + model.nv] = _EQUAL_SPEED_ATOL
    evaluated: Array | None = None  # state of the last sample, if equal states may reuse the sample
    # Backwards, so that the earliest time overwrites later ones. The samples include the last state
    # and the last state before the nudge.
    for index in (*range(len(states) - 1, settling - 1, -step), *range(settling - 1, -1, -step)):
        state, is_measured = states[index], index in last_second
        if (
            is_measured
            or evaluated is None
            or not (np.abs(state - evaluated)[1:] <= tolerances).all()
        ):
            sample = sampler.sample(state, ctrl)
            evaluated = state if sample.presses_all(carrying, min_force) else None
            idle_feet = sample.unloaded_feet(carrying)
            on_ground: set[str] = set()
            if is_footless:
                pressed |= find_pushing_bodies(model, sampler.data, min_force)
            else:
                on_ground = sample.bodies | (sample.forces.keys() - carrying)
                surfaces |= {body: sampler.find_surface(body) for body in sample.bodies}
        touched |= dict.fromkeys(on_ground, float(state[0]))
        has_bounced = is_released and index < last_second.start
        unloaded |= {
            foot: float(state[0]) for foot in idle_feet if foot not in loaded or not has_bounced
        }
        if index >= last_second.start:
            idle_late.update(idle_feet)
        if is_measured:
            means.add(sampler.data, sample.forces)
            pushing = find_pushing_bodies(model, sampler.data, min_force)
            touching |= {pair for pair in pushing if "world" not in pair}
    idle = {foot: moment for foot, moment in unloaded.items() if foot in loaded}
    return ContactRecord(
        failures=tuple(_list_contact_failures(touched, surfaces, idle, pressed)),
        touching=tuple(sorted(touching - pressed)),
        torques=means.torques / means.count,
        forces={foot: force / means.count for foot, force in means.forces.items()},
        feet_settled={foot: place / means.count for foot, place in means.positions.items()},
        lifted={foot: moment for foot, moment in sorted(unloaded.items()) if foot not in loaded},
        idle_late=frozenset(idle_late),
    )


class _SettledMeans:
    """Sums of torques, forces and positions over states before the nudge, to compute means.

    Attributes:
        count: Number of states.
        torques: Sum of the actuator forces of the joints, shape (nu,) [N m, N].
        forces: {foot, weld or grip: sum of the forces on this part, shape (3,) [N]}.
        positions: {contact point: sum of positions in the world, shape (3,) [m]}.
    """

    def __init__(self, robot: Robot, model: mujoco.MjModel) -> None:
        self._robot, self._model = robot, model
        self.count = 0
        self.torques = np.zeros(robot.nu)
        self.forces = {name: np.zeros(3) for name in (*robot.feet, *robot.fixed_parts)}
        self.positions = {foot: np.zeros(3) for foot in robot.contact_points}

    def add(self, data: mujoco.MjData, foot_forces: Mapping[str, Array]) -> None:
        """Add the joint torques, forces and positions of a simulated state to the sums.

        ``foot_forces`` is {foot: ground force, shape (3,) [N], in world axes}.
        """
        self.count += 1
        joints = self._robot.mj_convention.qvel_index[-self._robot.nu :]
        self.torques += data.qfrc_actuator[joints]
        welds = weld_forces(self._robot, self._model, data)
        for name, force in {**foot_forces, **welds}.items():
            self.forces[name] += force
        for foot, centre in foot_centres(self._robot, data).items():
            self.positions[foot] += centre


def _list_contact_failures(
    touched: Mapping[str, float],
    surfaces: Mapping[str, Diagnostic | None],
    idle: Mapping[str, float],
    pressed: Collection[tuple[str, str]],
) -> Iterator[Diagnostic]:
    """Yield messages about contact failures: bodies on the ground, unloaded feet, touching parts.

    ``touched`` and ``idle`` contain the first times [s], ``pressed`` pairs of bodies that push on
    each other.
    """
    for body, moment in sorted(touched.items()):
        yield diagnose(
            "body-touches-ground",
            subject=("body", body),
            surface=surfaces.get(body),
            time=Quantity(moment, "s"),
        )
    for foot, moment in sorted(idle.items()):
        yield diagnose("foot-idle", subject=("foot", foot), time=Quantity(moment, "s"))
    for pair in sorted(pressed):
        yield diagnose("parts-touch", bodies=pair)


def find_pushing_bodies(
    model: mujoco.MjModel, data: mujoco.MjData, min_force: float
) -> set[tuple[str, str]]:
    """Return the pairs of bodies with a contact whose normal force exceeds ``min_force`` [N].

    The names of a pair are in alphabetical order; the floor belongs to the body "world". ``data``
    must contain the contacts.
    """
    pairs, force = set(), np.zeros(6)
    for number, bodies in enumerate(contact.list_contact_bodies(model, data).tolist()):
        mujoco.mj_contactForce(model, data, number, force)
        if force[0] > min_force:
            first, second = sorted(model.body(body).name for body in bodies)
            pairs.add((first, second))
    return pairs


def find_light_bodies(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[int, ...]:
    """Return the ids of bodies on the ground with less than `LIGHT_FOOT_LOAD` of the total load.

    The load of a body is the sum of its normal forces [N] in contacts with the world or with bodies
    fixed to the world. ``data`` must contain the contacts.
    """
    loads: dict[int, float] = {}
    force = np.zeros(6)
    bodies = contact.list_contact_bodies(model, data)
    for number in np.flatnonzero(contact.find_acting_contacts(data)).tolist():
        moving = [body for body in bodies[number].tolist() if model.body_weldid[body]]
        if len(moving) == 1:
            mujoco.mj_contactForce(model, data, number, force)
            loads[moving[0]] = loads.get(moving[0], 0.0) + float(force[0])
    total = sum(loads.values())
    return tuple(body for body, load in sorted(loads.items()) if load < LIGHT_FOOT_LOAD * total)
