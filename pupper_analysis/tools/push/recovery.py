"""Find the largest horizontal impulse, in each direction, from which a stand recovers.

`push_recovery` bisects the impulses by simulations of a `PushBench`; `tipping_impulses` is the
estimate for a rigid robot. `study_pushes` solves, judges and pushes several robots in the same
stance.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import ClassVar

import numpy as np
import shapely
from numpy.typing import ArrayLike

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.progress import report_progress
from pupper_analysis.base.results import Result, Tabular
from pupper_analysis.base.units import EFFORT_UNIT, round_down
from pupper_analysis.models.efforts import EffortCode
from pupper_analysis.models.motors.energy import MotorEnergy, compute_motor_energy
from pupper_analysis.models.motors.motor import Motor
from pupper_analysis.models.motors.region import compute_motor_utilisation
from pupper_analysis.prepare.judge import judge_simulation
from pupper_analysis.prepare.limits import list_driven_limits
from pupper_analysis.robot.configuration import UP, Configuration
from pupper_analysis.robot.joints import (
    find_footless_joints,
    list_force_units,
)
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.stability import HOLD_DURATION
from pupper_analysis.simulation.rollout import check_duration, with_stand_contacts
from pupper_analysis.simulation.verdict import Question, Verdict
from pupper_analysis.simulation.verify import StandVerification, verify_stand
from pupper_analysis.stance.soft_ground import solve_stand_as_simulated
from pupper_analysis.stance.stand import Stand, solve_stand, stand_statics
from pupper_analysis.stance.task import StandTask
from pupper_analysis.tools.push.bench import (
    MAX_IMPULSE,
    MotorSamples,
    PushBench,
    PushSettings,
    make_push_bench,
)


@dataclass(frozen=True, eq=False)
class PushedStance(Result):
    """Largest pushes from which a robot in a stance recovers, with the verdict without a push.

    Attributes:
        name: Name of the robot.
        joint_names: (nu,) joints, in actuator order.
        stand: Pushed stand, with the feet in MuJoCo's soft ground. The ground is rigid if this
            stand is out of reach or soft loops do not converge (``solve_stand_as_simulated``).
        recovery: Largest pushes in MuJoCo. If ``code`` is ``unknown``, motors without a stated
            torque limit are simulated with unlimited torque.
        impulse: Impulse in the weakest direction [N s]; not a number if ``code`` is ``unknown``.
        code: ``unknown`` if ``unknown_limits`` is not empty; else ``zero`` if a motor has no
            torque, else ``stated``.
        unknown_limits: Joints of motors without a stated torque limit that may bear load. These
            joints move a foot or hand, or belong to a closed loop or coupling.
        peak_torques: (nu,) largest |torque| of the motor at each joint during the weakest push of
            ``recovery`` [N m or N]. None if ``unknown_limits`` is empty, or if the robot does not
            stand without a push.
        torque_units: (nu,) unit of the torque of each motor: N m for a hinge, N for a slide.
        verdict: Verdict of the stance without a push, with feed-forward. A robot that stays on the
            feet is pushed even if the verdict fails.
        motors: {joint: name of the assigned motor}.
        region_peaks: (nu,) largest ratio of motor torque to the torque that the motor can exert at
            the present speed, during the weakest push of ``recovery``. Not a number for a joint
            without motor. None without motors, or if the robot does not stand without a push.
        beyond_times: (nu,) time during the weakest push in which the ratio exceeds 1: the motor is
            beyond the torque-speed region [s]. 0 for a joint without motor. None if
            ``region_peaks`` is None.
        energy: Electrical energy of the motors during the weakest push of ``recovery``. None
            without motors, or if the robot does not stand without a push.
    """

    _key_fields: ClassVar[tuple[str, ...]] = ("verdict", "recovery")

    name: str
    joint_names: tuple[str, ...]
    stand: Stand
    recovery: PushRecovery
    impulse: float = field(metadata={"unit": "N s"})
    code: EffortCode
    unknown_limits: tuple[str, ...]
    peak_torques: Array | None = field(metadata={"unit": EFFORT_UNIT})
    torque_units: tuple[str, ...]
    verdict: Verdict
    motors: dict[str, str] = field(default_factory=dict)
    region_peaks: Array | None = field(default=None, metadata={"unit": "1"})
    beyond_times: Array | None = field(default=None, metadata={"unit": "s"})
    energy: MotorEnergy | None = None

    @property
    def within_region(self) -> bool:
        """Whether no motor is beyond the torque-speed region for more than `MAX_BEYOND_TIME`."""
        return self.beyond_times is None or bool((self.beyond_times <= MAX_BEYOND_TIME).all())

    @property
    def passed(self) -> bool:
        """Whether the verdict without a push passes, and the motors exert the torques of the push.

        The sizes of survived pushes are not judged.
        """
        return self.verdict.passed and self.within_region


MAX_BEYOND_TIME = 0.01
"""Largest total time for which a motor may be beyond the torque-speed region during a push [s]. If
the time is longer, the motor cannot exert the torques of the push. The bound permits single time
steps of an impact. Chosen, not tuned.
"""


def study_pushes(
    robots: Sequence[Robot],
    task: StandTask,
    *,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
    directions: int = 12,
    resolution: float | None = None,
    motors: Mapping[str, Mapping[str, Motor]] | None = None,
) -> dict[str, PushedStance]:
    """Find the largest pushes from which robots in a stance recover.

    Args:
        robots: Robots with different names.
        task: Task of all stands.
        kp: Servo stiffness [N m/rad, N/m], a scalar or (nu,); the model's own by default.
        kd: Servo damping [N m s/rad, N s/m], a scalar or (nu,); the model's own by default.
        directions: Number of directions, evenly spaced, the first direction forward; 3 to 360.
        resolution: Resolution of the impulses [N s]; by default, as in `push_recovery`.
        motors: {name of the robot: {joint: motor}}. The torques of the weakest push are compared
            with the torque-speed regions of ``motors``. The simulation limits torques by the effort
            limits of the robots only.

    Returns:
        {name of the robot: result}.

    Raises:
        StanceUnreachableError: If the stance is out of reach.
        ConfigurationError: If the task or another argument is invalid for a robot, for example.
    """
    stands = [solve_stand(robot, task) for robot in robots]
    return {
        robot.name: _study_robot(
            robot,
            stand,
            (motors or {}).get(robot.name, {}),
            kp=kp,
            kd=kd,
            directions=directions,
            resolution=resolution,
        )
        for robot, stand in zip(robots, stands, strict=True)
    }


def _study_robot(
    robot: Robot,
    rigid_stand: Stand,
    motors: Mapping[str, Motor],
    *,
    kp: ArrayLike | None,
    kd: ArrayLike | None,
    directions: int,
    resolution: float | None,
) -> PushedStance:
    """Find the largest pushes from which a robot recovers, and the verdict without a push.

    ``motors`` is {joint: motor}; for the other arguments, see `study_pushes`.
    """
    stand = solve_stand_as_simulated(robot, rigid_stand)
    verification = verify_stand(robot, stand, kp=kp, kd=kd, duration=HOLD_DURATION)
    recovery = push_recovery(
        robot,
        stand,
        kp=kp,
        kd=kd,
        directions=directions,
        resolution=resolution,
        verification=verification,
    )
    statics = stand_statics(robot, stand)
    verdict = judge_simulation(
        robot, rigid_stand, verification, statics=statics, question=Question.LASTS, kp=kp, kd=kd
    )
    unknown_limits = list_unknown_push_limits(robot)
    peaks, region_peaks, beyond_times, energy = None, None, None, None
    if (unknown_limits or motors) and not recovery.failures_without_push:
        samples = _simulate_weakest_push(robot, stand, recovery, verification, kp, kd)
        if unknown_limits:
            peaks = np.abs(samples.torques).max(axis=0)
        if motors:
            region_peaks, beyond_times = _compare_with_regions(robot, samples, motors)
            series = samples.integrated, samples.speeds, samples.period
            energy = compute_motor_energy(motors, robot.joint_names, *series)
    return PushedStance(
        name=robot.name,
        joint_names=robot.joint_names,
        stand=stand,
        recovery=recovery,
        impulse=math.nan if unknown_limits else recovery.weakest_impulse,
        code=_find_effort_code(robot, unknown_limits),
        unknown_limits=unknown_limits,
        peak_torques=peaks,
        torque_units=robot.compute_once(list_force_units),
        verdict=verdict,
        motors={joint: motor.name for joint, motor in motors.items()},
        region_peaks=region_peaks,
        beyond_times=beyond_times,
        energy=energy,
    )


def _simulate_weakest_push(
    robot: Robot,
    stand: Stand,
    recovery: PushRecovery,
    verification: StandVerification,
    kp: ArrayLike | None,
    kd: ArrayLike | None,
) -> MotorSamples:
    """Simulate the largest survived push in the weakest direction; return motor torques."""
    bench = make_push_bench(
        robot,
        stand,
        np.array([recovery.weakest_direction]),
        duration=recovery.duration,
        kp=kp,
        kd=kd,
        feedforward=True,
        integrator=None,
        verification=verification,
    )
    return bench.simulate_motors(0, recovery.weakest_impulse)


def _find_effort_code(robot: Robot, unknown_limits: Sequence[str]) -> EffortCode:
    """Find whether the torque limits of a robot are stated, zero or unknown."""
    if unknown_limits:
        return EffortCode.UNKNOWN
    if any(limit.without_torque for limit in list_driven_limits(robot)):
        return EffortCode.ZERO
    return EffortCode.STATED


def _compare_with_regions(
    robot: Robot, samples: MotorSamples, motors: Mapping[str, Motor]
) -> tuple[Array, Array]:
    """Compare the torques of a push with the torque-speed regions of motors.

    Returns:
        Largest ratio of torque to the torque that the motor can exert at the joint speed, shape
        (nu,), NaN without motor. Time beyond the region, shape (nu,) [s], 0 without motor.
    """
    shares = compute_motor_utilisation(motors, robot.joint_names, samples.torques, samples.speeds)
    peaks: Array = shares.max(axis=0)
    times: Array = samples.period * (shares > 1 + _REGION_RTOL).sum(axis=0)
    return peaks, times


_REGION_RTOL = 1e-9
"""Relative tolerance of the edge of a torque-speed region. The tolerance covers rounding if the
simulation limits a torque to the largest torque of the motor. Chosen, not tuned.
"""


def list_unknown_push_limits(robot: Robot) -> tuple[str, ...]:
    """Return the driven joints that may bear load during a push and have an unknown torque limit.

    A joint may bear load if the joint moves a foot or hand, or belongs to a closed loop or
    coupling.
    """
    unloaded_joints = find_footless_joints(robot)
    unknown_joints = (
        limit.joint for limit in list_driven_limits(robot) if limit.code is EffortCode.UNKNOWN
    )
    return tuple(joint for joint in unknown_joints if joint not in unloaded_joints)


CHECKED_LEVELS = 8
"""Largest number of smaller pushes per direction that are simulated after the bisection, equally
spaced below the limit of the bisection. Chosen, not tuned.
"""


@dataclass(frozen=True, eq=False)
class PushRecovery(PushSettings, Tabular):
    """Largest push from which a stand recovers, in each of n horizontal directions.

    Attributes:
        directions: (n,) directions about the vertical [rad]: 0 is the base's forward, pi/2 the
            base's left.
        impulses: (n,) largest push from which the robot recovers [N s]. The robot also recovers
            from each smaller simulated push. A push that is larger by at most ``resolution`` fails.
        velocity_steps: (n,) changes of the robot's velocity: impulse / mass [m/s].
        failures: (n,) failure of the larger push, or of the stand without a push.
        bisected_impulses: (n,) result of the bisection [N s], before the check of smaller pushes.
            Larger than ``impulses`` if a smaller push failed, or if the push failed in the complete
            simulation.
        tipping_estimate: (n,) impulse that would tip over the robot as a rigid body [N s]; infinite
            if the feet span no polygon.
        weakest_direction: Direction with the smallest impulse [rad].
        weakest_impulse: Smallest impulse [N s].
        weakest_failure: Failure in the weakest direction.
        mass: Mass of the robot [kg].
        resolution: Resolution of the impulses [N s].
        rollouts: Number of simulated pushes, including a simulation without a push, if any.
        simulated: Total simulated time of the ``rollouts`` [s]. Less than ``rollouts * duration``
            if outcomes were decided earlier, more if simulations were prolonged.
        failures_without_push: Failures without a push, from ``verify_stand``; empty if the robot
            stays on the feet, even in another pose than predicted.
    """

    _key_fields: ClassVar[tuple[str, ...]] = (
        "weakest_impulse",
        "weakest_direction",
        "weakest_failure",
    )
    _units_of_columns: ClassVar[dict[str, str]] = {
        "direction": "rad",
        "impulse": "N s",
        "velocity_step": "m/s",
    }

    directions: Array = field(metadata={"unit": "rad"})
    impulses: Array = field(metadata={"unit": "N s"})
    velocity_steps: Array = field(metadata={"unit": "m/s"})
    failures: tuple[Diagnostic, ...]
    bisected_impulses: Array = field(metadata={"unit": "N s"})
    tipping_estimate: Array = field(metadata={"unit": "N s"})
    weakest_direction: float = field(metadata={"unit": "rad"})
    weakest_impulse: float = field(metadata={"unit": "N s"})
    weakest_failure: Diagnostic
    mass: float = field(metadata={"unit": "kg"})
    resolution: float = field(metadata={"unit": "N s"})
    rollouts: int
    simulated: float = field(metadata={"unit": "s"})
    failures_without_push: tuple[Diagnostic, ...]

    def _columns(self) -> dict[str, ArrayLike]:
        """Return the columns of a table of the survived pushes, a row per direction."""
        names = ("direction", "impulse", "velocity_step", "failure", "tipping_estimate")
        values = (
            self.directions,
            self.impulses,
            self.velocity_steps,
            [str(failure) for failure in self.failures],
            self.tipping_estimate,
        )
        return dict(zip(names, values, strict=True))


MIN_RESOLUTION = 1e-6
"""Smallest valid resolution of an impulse [N s]. Chosen, not tuned."""

DEFAULT_RESOLUTION = 0.02
"""Largest default resolution of the impulses [N s]. Chosen, not tuned."""
_RESOLUTION_RATIO = 0.05
"""Largest default resolution of the impulses, divided by the smallest tipping estimate [1]. Chosen,
not tuned. The reason for a relative bound: with 0.02 N s, all limits of a robot of 3 g are 0.
"""


def _choose_resolution(estimate: Array) -> float:
    """Choose the resolution of the impulses [N s] from the tipping estimates, shape (n,) [N s].

    The resolution is `DEFAULT_RESOLUTION`, or `_RESOLUTION_RATIO` times the smallest estimate,
    rounded down to one digit, if this is less and positive; at least `MIN_RESOLUTION`.
    """
    smallest = float(np.min(estimate, initial=np.inf))
    if not 0 < _RESOLUTION_RATIO * smallest < DEFAULT_RESOLUTION:
        return DEFAULT_RESOLUTION
    return max(round_down(_RESOLUTION_RATIO * smallest, 1), MIN_RESOLUTION)


@check_arguments
def push_recovery(
    robot: Robot,
    stand: Stand,
    *,
    directions: int = 12,
    duration: float = 6.0,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
    feedforward: bool = True,
    integrator: str | None = None,
    resolution: float | None = None,
    verification: StandVerification | None = None,
) -> PushRecovery:
    """Find the largest horizontal push, in each direction, from which a stand recovers.

    The push is a constant force at the CoM of the base body, from t = 0 on, for about 20 ms (whole
    time steps). Before the push the robot is at rest in balance. The servos hold the stand. Without
    feed-forward, the robot starts to sag during the push.

    All limits are 0 if the robot does not stay on the feet in ``verify_stand``, without a push.

    The robot recovers if only feet touch the ground in the whole simulation (contacts are searched
    every 4 ms), and these conditions are met at the end. The robot may slide or turn about the
    vertical.

    - The base tilts by at most 0.5 rad.
    - The point of the base at the initial CoM has at least half of the initial CoM height.
    - The base is slow: the speed in the last 0.5 s is at most 0.01 m/s more than without a push.
    - The base is at rest: 1.5 times its motion, extrapolated over the remaining time (at least
      `HOLD_DURATION`), is at most a tenth of the CoM height.
    - No mode of the linearised dynamics with dry friction grows within ten times ``duration``
      (`Mode.grows_within`). At the end of the longest simulation, modes are ignored if the base
      slows down or hardly moves.

    If the robot is upright at the end but not at rest, the simulation continues, up to ten times as
    long. Each returned limit above 0 was simulated to the end.

    Impulses are doubled until a push fails, and then bisected. Recovery need not be monotonic: a
    robot may fall after a push and survive a larger push, for example by sliding. Bisection then
    finds only a single boundary. Therefore up to 8 smaller, equally spaced pushes are simulated
    afterwards, if their spacing is larger than ``resolution``. If a smaller push fails, a boundary
    below this push is returned. A failure between the simulated pushes may remain undetected.

    Args:
        robot: The robot.
        stand: The stand.
        directions: Number of directions, evenly spaced, the first direction forward; 3 to 360.
        duration: Simulated time from the start of the push [s], 2 to 600, if the outcome is not
            decided earlier or later.
        kp: Servo stiffness [N m/rad, N/m], scalar or shape (nu,); the model's own by default.
        kd: Servo damping [N m s/rad, N s/m], scalar or shape (nu,); the model's own by default.
        feedforward: Command ctrl = q* + tau / kp instead of ctrl = q*.
        integrator: MuJoCo's integrator; the model's own by default.
        resolution: Resolution of the impulses [N s]; by default `DEFAULT_RESOLUTION`, or less for
            a small robot (`_choose_resolution`).
        verification: Result of ``verify_stand`` with the same gains, feed-forward and integrator;
            computed by default.

    Returns:
        The largest survived impulses [N s] with their failures. If the robot does not stand without
        a push, all impulses are 0, and ``failures_without_push`` contains the reasons.

    Raises:
        ConfigurationError: If an argument is out of range, the stand does not suit the robot, or a
            base is fixed, for example.
        ModelError: If a joint has no motor, if a joint has no position servo and kp and kd are not
            both given, or if the ground or a contact cannot be added, for example.
        StaticsInfeasibleError: If no contact forces balance the stand.
        UnknownNameError: If the robot lacks the foot or frame of a contact of the stand.
    """
    robot = with_stand_contacts(robot, stand)
    check_duration(duration)
    robot.check_not_welded("how hard it can be pushed")
    if not 3 <= directions <= 360:
        problem = diagnose("not-between", given=directions, low=3, high=360)
        raise ConfigurationError("directions", problem)
    if resolution is not None and not MIN_RESOLUTION <= resolution <= MAX_IMPULSE:
        high = Quantity(MAX_IMPULSE, "N s")
        problem = diagnose("not-between", given=f"{resolution} N s", low=MIN_RESOLUTION, high=high)
        raise ConfigurationError("resolution", problem)
    angles = 2 * math.pi * np.arange(directions) / directions
    bench = make_push_bench(
        robot,
        stand,
        angles,
        duration=duration,
        kp=kp,
        kd=kd,
        feedforward=feedforward,
        integrator=integrator,
        verification=verification,
    )
    config = Configuration(robot, stand.qpos)
    estimate = tipping_impulses(config, bench.find_push_point(), bench.axes, stand.stance_feet)
    if resolution is None:
        resolution = _choose_resolution(estimate)
    impulses, bisected, failures = _find_push_limits(bench, estimate, resolution)
    weakest = int(np.argmin(impulses))
    return PushRecovery(
        directions=angles,
        impulses=impulses,
        velocity_steps=impulses / robot.total_mass,
        failures=failures,
        bisected_impulses=bisected,
        tipping_estimate=estimate,
        weakest_direction=float(angles[weakest]),
        weakest_impulse=float(impulses[weakest]),
        weakest_failure=failures[weakest],
        mass=robot.total_mass,
        resolution=float(resolution),
        rollouts=bench.rollouts,
        simulated=bench.simulated,
        failures_without_push=bench.failures_without_push,
        **bench.list_settings(),
    )


def tipping_impulses(
    config: Configuration, point: Array, axes: Array, feet: Iterable[str] | None = None
) -> Array:
    """Compute the horizontal impulses [N s] that would tip over the robot as a rigid body.

    The robot rolls on two feet over an edge of the support polygon. The feet are spheres of radius
    r, the mean over all contact points of the robot. With the inertia I about the edge on the
    ground and the lever s of the push, an impulse p gives the energy (p s)^2 / (2 I). The centres
    of the feet keep the height. h is the height of the CoM above the foot centres, and d the
    horizontal distance of the CoM from the line between the two centres. While the robot tips, the
    CoM height increases from h to hypot(h, d):

        p = sqrt(2 I m g (hypot(h, d) - h)) / s, minimum over the edges in the push direction.

    The estimate neglects, for example, that legs fold, feet slide and contacts damp.

    Args:
        config: Configuration of the robot with a free base on level ground.
        point: Point of application in the world, shape (3,) [m].
        axes: Push directions: horizontal unit vectors in the world frame, shape (n, 2).
        feet: Stance feet; all feet by default.

    Returns:
        Impulses, shape (n,) [N s]; infinite if the feet span no polygon.
    """
    robot, com, mass_matrix = config.robot, config.center_of_mass(), config.mass_matrix()
    ground = np.array(list(config.contact_points(feet).values()))
    radius = float(np.mean(list(robot.contact_radius.values())))
    hull = shapely.MultiPoint(ground[:, :2]).convex_hull
    impulses = np.full(len(axes), np.inf)
    if hull.geom_type != "Polygon":
        return impulses
    corners = np.array(hull.exterior.coords)
    for corner, next_corner in pairwise(corners):
        pivot = np.append(corner, ground[:, 2].mean())
        hinge = np.append(next_corner - corner, 0.0) / np.linalg.norm(next_corner - corner)
        # A positive rotation about the hinge moves the CoM upwards and outwards.
        hinge *= math.copysign(1.0, np.cross(hinge, com - pivot) @ UP)
        lever = com - pivot - radius * UP
        rise = np.linalg.norm(np.cross(hinge, lever)) - lever[2]
        energy = robot.weight * rise
        twist = np.zeros(robot.nv)
        twist[:3] = np.cross(hinge, config.qpos[:3] - pivot)
        twist[3:6] = config.base_rotation().T @ hinge
        inertia = twist @ mass_matrix @ twist
        levers = axes @ np.cross(hinge, point - pivot)[:2]
        with np.errstate(divide="ignore"):
            tips = np.where(levers > 0, math.sqrt(2 * inertia * energy) / levers, np.inf)
        impulses = np.minimum(impulses, tips)
    return impulses


def _find_push_limits(
    bench: PushBench, estimate: Array, resolution: float
) -> tuple[Array, Array, tuple[Diagnostic, ...]]:
    """Find the largest survived impulse in each of n directions by bisection and checks.

    ``estimate`` contains initial impulses, shape (n,) [N s]; infinite values are allowed.

    Returns:
        Largest survived impulses, shape (n,) [N s]; limits of the bisection before the check, shape
        (n,) [N s]; failure above each limit, or without a push.
    """
    count = len(bench.axes)
    if bench.failures_without_push:
        failure_without_push = diagnose("without-a-push", failures=bench.failures_without_push)
        return np.zeros(count), np.zeros(count), (failure_without_push,) * count
    search = _LimitSearch(bench, np.zeros(count), np.full(count, np.inf), {})
    initial = np.where(np.isfinite(estimate), estimate, 1.0).clip(resolution)
    search.bisect_limits(initial, resolution)
    bisected = search.survived.copy()
    monotonic = np.ones(count, dtype=np.bool_)
    for level in range(1, CHECKED_LEVELS + 1):
        step = bisected / (CHECKED_LEVELS + 1)
        candidates = np.flatnonzero(monotonic & (step > resolution))
        for index, failure in zip(
            candidates,
            bench.simulate_until_decided(candidates, level * step[candidates]),
            strict=True,
        ):
            if failure is not None:
                monotonic[index] = False
                search.survived[index] = (level - 1) * step[index]
                search.failed[index] = level * step[index]
                search.failures[index] = failure
    search.bisect_limits(initial, resolution)
    search.confirm_limits(initial, resolution)
    return search.survived, bisected, tuple(search.failures[index] for index in range(count))


@dataclass(frozen=True, eq=False)
class _LimitSearch:
    """Search for the largest survived pushes in all directions, at the same time.

    Attributes:
        bench: Simulations of the stand.
        survived: Lower ends of the brackets, shape (n,) [N s]: a survived push, or 0; changed in
            place.
        failed: Upper ends of the brackets, shape (n,) [N s]: a failed push, or infinite; changed in
            place.
        failures: {index of the direction: failure of ``failed``}; changed in place.
    """

    bench: PushBench
    survived: Array
    failed: Array
    failures: dict[int, Diagnostic]

    def confirm_limits(self, initial: Array, resolution: float) -> None:
        """Simulate the survived pushes to the end; search again below each push that fails.

        ``initial`` impulses of the search: shape (n,) [N s]; ``resolution``: [N s].
        """
        unconfirmed = np.flatnonzero(self.survived > 0)
        while unconfirmed.size:
            outcomes = self.bench.simulate_fully(unconfirmed, self.survived[unconfirmed])
            unconfirmed = unconfirmed[[failure is not None for failure in outcomes]]
            for index, failure in zip(unconfirmed, filter(None, outcomes), strict=True):
                self.failed[index], self.failures[index] = self.survived[index], failure
                self.survived[index] = 0.0
            self.bisect_limits(initial, resolution)
            unconfirmed = unconfirmed[self.survived[unconfirmed] > 0]

    def bisect_limits(self, initial: Array, resolution: float) -> None:
        """Find the largest survived push of each direction to within ``resolution`` [N s].

        ``initial`` impulses, shape (n,) [N s], are doubled until a push fails.
        """
        rounds = 0
        while (wide := np.flatnonzero(self.failed - self.survived > resolution)).size:
            low, high = self.survived[wide], self.failed[wide]
            expected = np.where(np.isinf(high), np.maximum(2 * low, initial[wide]), high - low)
            rounds_left = math.ceil(math.log2(max(float(expected.max()) / resolution, 2.0)))
            report_progress("push limits", rounds, rounds + rounds_left)
            rounds += 1
            impulses = np.where(
                np.isinf(high), np.maximum(2 * low, initial[wide]), (low + high) / 2
            )
            outcomes = self.bench.simulate_until_decided(wide, impulses)
            for index, impulse, failure in zip(wide, impulses, outcomes, strict=True):
                if failure is None:
                    self.survived[index] = impulse
                else:
                    self.failed[index], self.failures[index] = impulse, failure
