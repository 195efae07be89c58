"""How far a standing robot sags: where its servos let it come to rest on soft ground.

A homotopy leads there: the feed-forward is taken away, then feet creep. The equilibrium at its end
lasts where it is stiff in every motion that the feet leave.
"""

from __future__ import annotations

import contextlib
import math
from dataclasses import dataclass, field, replace

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import lapack

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.diagnostics import (
    Diagnostic,
    Quantity,
    Term,
    diagnose,
)
from pupper_analysis.base.errors import ConfigurationError, NoEquilibriumError, NoStiffnessError
from pupper_analysis.base.results import Result
from pupper_analysis.robot import contact
from pupper_analysis.robot.joints import joint_ranges
from pupper_analysis.robot.robot import Robot, lend
from pupper_analysis.robot.servos import compute_command_lead
from pupper_analysis.robot.stability import HOLD_DURATION
from pupper_analysis.robot.terrain import build_on_ground
from pupper_analysis.robot.touching import touching
from pupper_analysis.stance.posture import LIMIT_TOLERANCE
from pupper_analysis.stance.sag.equilibrium import EquilibriumScales, Feet, SagEquilibrium, Solution
from pupper_analysis.stance.stand import Stand, stand_statics
from pupper_analysis.statics.equilibrium import ForceDistribution, GravityCompensation

Array = NDArray[np.float64]

MAX_PIVOT_RATIO = 0.01
"""A sole that has slipped by less, in parts of the height at which the robot stands, rests where it
has come to: some 3 mm of a biped of 0.3 m. MuJoCo's pivoted by 0.1 to 0.4 mm."""


def find_sliding_feet(system: SagEquilibrium, solution: Solution) -> tuple[str, ...]:
    """Returns the pinned feet that slide: what presses of them slips, and it is no small way.

    A foot of one point slides where that point slips. A sole may pivot by a fraction of a
    millimetre, all its points at their friction, until its leg is no longer twisted: where
    there is an equilibrium so near, the sole rests in it.
    """
    loose, names = set(find_slipping_feet(system, solution)), tuple(system.anchors)
    if not loose:
        return ()
    small = MAX_PIVOT_RATIO * system.robot.stand_height
    slips = np.linalg.norm(measure_slips(system, solution), axis=1)
    found = []
    for foot in system.robot.feet_with(system.stand.stance_feet):
        points = [point for point in system.robot.feet[foot] if point in names]
        pressed = [point for point in points if solution.forces[point][2] > 0]
        if not pressed or not loose.issuperset(pressed):
            continue
        way = max(float(slips[names.index(point)]) for point in pressed)
        if len(system.robot.feet[foot]) == 1 or way > small:
            found.append(foot)
    return tuple(found)


def find_slipping_feet(system: SagEquilibrium, solution: Solution) -> tuple[str, ...]:
    """Returns the pinned feet that slip."""
    forces, names = system.stack_forces(solution), tuple(system.anchors)
    places = system.slips(solution.qpos, forces)
    return tuple(names[row] for row, *_ in system.find_slipping_contacts(forces, places))


def measure_slips(system: SagEquilibrium, solution: Solution) -> Array:
    """Returns how far the pinned feet that touch have slipped (n, 2), soles as one body (m)."""
    begun = np.array([system.crept.get(foot, np.zeros(2)) for foot in system.anchors])
    places = system.contacts_at(solution.qpos).places[:, :2]
    return system.project_soles(places - begun.reshape(-1, 2))


def stiffness_at(system: SagEquilibrium, solution: Solution, derivative: Array) -> float:
    """Returns the least eigenvalue of the energy's Hessian, relative to the mass matrix (1/s^2).

    Of motions that the feet allow; the Hessian is not symmetric where feet slip.

    Args:
        system: The equations.
        solution: The solution.
        derivative: Of the equations there; see ``Equilibrium.derivative``.
    """
    n, feet, forces = system.robot.nv, tuple(system.anchors), system.stack_forces(solution)
    touch = system.contacts_at(solution.qpos)
    config, depths, jacobian = touch.config, touch.places[:, 2], touch.jacobians
    laws, normal = [system.laws[foot] for foot in feet], jacobian[:, 2]
    moving, slips = find_slipping_feet(system, solution), measure_slips(system, solution)
    # Points of soles that touch may not be pressed.
    idle = system.is_sole_point() & np.array(
        [depth <= -law.margin for law, depth in zip(laws, depths, strict=True)], dtype=bool
    )
    rates = np.array([law.rate(depth) for law, depth in zip(laws, depths, strict=True)])
    rates[idle] = 0.0
    pushed = normal.copy()  # where a foot's normal force acts, with the friction it brings
    slipping = [row for row, foot in enumerate(feet) if foot in moving]
    for row in slipping:
        if not idle[row]:
            pushed[row] += forces[row, :2] / forces[row, 2] @ jacobian[row, :2]
    hessian = derivative[:n, :n] + pushed.T @ (rates[:, None] * normal)
    across = system.project_soles(jacobian[:, :2])
    # Friction is against the slip s: f_t = -mu f_n s / |s|. Moved across, s turns, and with it the
    # force, by mu f_n / |s| to the side; along s nothing holds it.
    for row in slipping:
        way, pressing = float(np.linalg.norm(slips[row])), forces[row, 2]
        if way > 0 and pressing > 0:
            along, mu = slips[row] / way, system.sliding_friction[feet[row]]
            stiff = mu * pressing / way * (np.eye(2) - np.outer(along, along))
            hessian += across[row].T @ stiff @ across[row]
    sticks = [row for row, foot in enumerate(feet) if foot not in moving and not idle[row]]
    held = across[sticks].reshape(-1, n)
    if system.feet == "sliding":  # as a whole it may be anywhere, turned anyhow about z
        held = np.eye(3, n)
        held[2] = np.concatenate([np.zeros(3), config.base_rotation()[2], np.zeros(n - 6)])
    if system.robot.welds:
        held = np.vstack([held, system.weld_rows(solution.qpos)])
    _, lengths, rows = np.linalg.svd(held)
    least = max(held.shape) * np.finfo(float).eps * lengths.max(initial=0.0)
    free = rows[np.count_nonzero(lengths > least) :].T  # what nothing of it is held of
    if not free.shape[1]:
        return math.inf
    both = (free.T @ one @ free for one in (hessian, config.mass_matrix()))
    real, _, scale, *_ = lapack.dggev(*both, compute_vl=0, compute_vr=0)
    values = np.divide(real, scale, out=np.full(len(real), np.inf), where=scale != 0)
    return float(values.min())


_LEAST_STEP = 1 / 64  # of the feed-forward, in one step
_CAREFUL = 1 / 64  # likewise: an unstable equilibrium is one only if such small steps lead to it
_SHARE_TOLERANCE = 1e-7  # of the feed-forward: when a foot touches or lets go, to nanometres
_MAX_EVENTS = 24  # feet that touch or let go on the way: more is chatter
_FRICTION_SHARE_OF_SLIDING = 0.95
"""Share of the friction limit above which a foot is reported as about to slide where no equilibrium
follows. Chosen: the last equilibrium is up to `_LEAST_STEP` of the feed-forward before the end."""
CREEP_STEPS = 20
"""Backward Euler steps in which feet creep: with 20 a robot that falls after 15 s does after 14."""

_LEAST_EULER = 1 / 4096
"""Part of such a step that is tried at least: 0.1 ms of 12 s, in which contacts move less than what
they give."""


class HomotopyPath:
    """The way of an equilibrium from the stand: feed-forward is taken away, then the feet creep.

    Args:
        system: The equations.
        end: (nu,) what the servos are commanded at its end (rad); by default the stand's joint
            positions, without any feed-forward.
        exact: Whether its beginning is to be so to rounding; where it is only gone on from, not.

    Attributes:
        system: The equations; their feet touch as they do where the way has come to.
        balance: What holds the stand itself.
        share: Of the feed-forward, how much is taken away.
        solution: The equilibrium there.
        crept: For how long feet have crept (s).

    Raises:
        StaticsInfeasibleError: If no contact forces balance the stand itself.
        NoEquilibriumError: If it is no equilibrium on soft ground.
    """

    def __init__(
        self, system: SagEquilibrium, end: Array | None = None, *, exact: bool = True
    ) -> None:
        self.system, stand = system, system.stand
        self._looked_at: tuple[Solution, Array, float] | None = None
        self.end: Array = stand.joint_positions(system.robot) if end is None else end
        self.balance: GravityCompensation = stand_statics(
            system.robot, stand, distribution=ForceDistribution.MIN_TANGENTIAL
        )
        self.share, self._events, self.crept = 0.0, 0, 0.0
        self._euler = math.inf
        forces = {f: system.frames[f] @ force for f, force in self.balance.contact_forces.items()}
        sunk = system.equilibrium_depths(np.array(list(forces.values())).reshape(-1, 3))
        qpos = stand.qpos.copy()
        if not (system.robot.bolted or system.robot.welds):
            qpos[2] -= np.mean(sunk) - np.mean(list(stand.depths.values()))
        self._command(0.0)
        self.solution = self._settled(Solution(qpos, forces), diagnose("as-it-stands-fed"), exact)

    def follow(self, goal: float) -> None:
        """Takes away the share ``goal`` of the feed-forward, in one step or in smaller ones.

        Raises:
            NoEquilibriumError: If the equilibrium ends before.
        """
        step = 1.0
        while self.share < goal:
            wanted = min(self.share + step, goal)
            found = self._at(wanted)
            if found is not None and step > _CAREFUL and self.linearise(found)[1] <= 0:
                # A long step may end on another branch, beyond where this one is stable.
                found = None
            if found is not None:
                if not self.system.find_violations(found):
                    self.share, self.solution, step = wanted, found, 2 * step
                    continue
                if self._event(wanted, found):
                    continue
            step /= 2
            if step < _LEAST_STEP:
                raise NoEquilibriumError(
                    self.share,
                    diagnose(
                        "feed-forward-needed",
                        feet=Term(self.system.feet),
                        # Joints that follow others have none.
                        kp=Quantity(self.system.kp[self.system.kp > 0].min(), "N m/rad"),
                        share=self.share,
                        sliding=self._feet_about_to_slide(),
                    ),
                )

    def linearise(self, solution: Solution) -> tuple[Array, float]:
        """Returns derivative and stiffness at a solution: the way and its end ask for the same."""
        system, seen = self.system, self._looked_at
        if seen is None or seen[0] is not solution:
            derivative = system.derivative(solution.qpos, system.stack_forces(solution))
            seen = self._looked_at = (
                solution,
                derivative,
                stiffness_at(system, solution, derivative),
            )
        return seen[1:]

    def creep_step(self, seconds: float) -> None:
        """Lets pinned feet creep, by one backward Euler step, or where it must by smaller ones.

        Soles that are twisted creep by a millimetre within hundredths of a second, and then rest.

        Raises:
            NoEquilibriumError: If the equilibrium ends before.
        """
        left = seconds
        while left > 0:
            step = min(self._euler, left)
            system, solution = self.system, self.solution
            before = dict(system.anchors), dict(system.crept), dict(system.yielding)
            system.begin_creep(solution, step)
            try:
                self.solution = self._settled(
                    self.solution, diagnose("after-creep", time=self.crept)
                )
            except NoEquilibriumError:
                self.solution = solution
                system.anchors, system.crept, system.yielding = before
                self._euler = step / 4
                if self._euler < _LEAST_EULER * seconds:
                    raise
                continue
            self.crept += step
            left -= step
            self._euler = 2 * step

    def _feet_about_to_slide(self) -> list[str]:
        """Return the pinned feet whose tangential force is close to the limit of their friction."""
        if self.system.feet != "pinned":
            return []
        friction = self.system.sliding_friction
        return [
            foot
            for foot, force in self.solution.forces.items()
            if np.linalg.norm(force[:2]) > _FRICTION_SHARE_OF_SLIDING * friction[foot] * force[2]
        ]

    def _command(self, share: float) -> None:
        system = self.system
        full = system.stand.joint_positions(system.robot) + compute_command_lead(
            self.balance.joint_torques, system.kp
        )
        system.command(full + share * (self.end - full))

    def _at(self, share: float) -> Solution | None:
        """Returns the equilibrium at a share, the feet touching as they do; None if none."""
        self._command(share)
        return self.system.solve(self.solution)

    def _event(self, wanted: float, there: Solution) -> bool:
        """Goes on to where, before ``wanted``, the first foot touches or lets go.

        Args:
            wanted: A share at which feet are wrong.
            there: The equilibrium there.

        Returns:
            Whether that place was found.
        """
        right = self.share
        while wanted - right > _SHARE_TOLERANCE:
            middle = (right + wanted) / 2
            found = self._at(middle)
            if found is None:
                return False
            if self.system.find_violations(found):
                wanted, there = middle, found
            else:
                right = middle
        self._command(wanted)
        self.share = wanted
        self._switch(next(iter(self.system.find_violations(there))), there)
        return True

    def _switch(self, foot: str, found: Solution) -> None:
        self._events += 1
        if self._events > max(_MAX_EVENTS, 4 * len(self.system.robot.contact_points)):
            raise NoEquilibriumError(
                self.share, diagnose("foot-neither-carries-nor-clears", subject=("foot", foot))
            )
        self.solution = self.system.switch(foot, found)

    def _settled(self, guess: Solution, when: Diagnostic, exact: bool = True) -> Solution:
        """Returns the equilibrium with the feet that touch in it, beginning with those that do."""
        self.solution = guess
        while True:
            found = self.system.solve(self.solution, exact=exact)
            if found is None:
                closed = not any(self.system.stand.depths.values())
                loops = self.system.robot.closure is not None and closed
                message = diagnose("equilibrium-ends", when=when, loops=loops)
                raise NoEquilibriumError(self.share, message)
            wrong = self.system.find_violations(found)
            if not wrong:
                return found
            self._switch(next(iter(wrong)), found)


RELEASE_MARGIN = 0.06
"""A ``release_margin`` that keeps the feet in place: what contacts add to the first order."""

MAX_CREEP_LOSS_RATIO = 0.002
"""Share of the stand's height: where creep goes on to take less of it within ``HOLD_DURATION``, it
does not end the equilibrium. original's, 2 % above its least kp, ends after 5 s, and begins at
0.025."""

HIGHEST_KP = 2500.0
"""The stiffest servos that ``minimum_stiffness`` tries, in weights times heights of the stand per
radian: 2000 times v3's."""


@dataclass(frozen=True, eq=False)
class SteadyState(Result):
    """An equilibrium of a servo-driven robot on its feet, or by its base that is fixed.

    Attributes:
        feet: What the feet do: ``pinned`` or ``sliding``.
        qpos: (nq,) the configuration.
        base_height: m; of one that its file fixes, this and what it loses is 0.
        height_loss: Stand's height less this one (m); the sum of the next two.
        servo_sag: The part lost in the joints (m).
        contact_sag: The part lost in the softness of feet and ground (m).
        joint_torques: (nu,) of the motors (N m).
        stance_feet: The feet that carry: swing feet that came down to the ground too, and without
            those of the stand that the ground would have to pull.
        contact_forces: {foot: (3,)} of the ground on every foot, in world axes (N); zero for those
            that do not touch.
        foot_creep: {foot that carries: speed} at which MuJoCo's friction lets it creep, if pinned
            (m/s).
        height_drift: The rate of the base's height that comes of it (m/s). A simulated height is
            the predicted one within D for about D / |height_drift| seconds.
        residual: The largest element left of the equations (N, N m, m).
        stiffness: The least eigenvalue of the energy's Hessian on the null space of what the feet
            hold, relative to the mass matrix (rad^2/s^2): the square of the lowest natural
            frequency without damping.
        stable: Whether it is positive.
        release_margin: What friction has left, at the foot that has the least, in parts of the
            weight, as the robot overshoots when its feed-forward is taken away at once: it is then
            twice as far from the stand as the equilibrium, to first order. Below
            ``RELEASE_MARGIN`` a foot may slip or lift in that fall, and the robot comes to rest
            elsewhere, by up to millimetres. Let down slowly they stay; but then dry friction, which
            is left out, holds the robot above the equilibrium: v3 by 1.8 mm.
        lasts: How long it stands until creep ends the equilibrium, or brings another part to the
            ground (s); infinite if that is longer than ``HOLD_DURATION``, or was not looked at.
        failures: Why the robot will not stand so; empty if it will.
    """

    feet: Feet
    qpos: Array = field(metadata={"unit": "m, 1 (quaternion) and rad"})
    base_height: float = field(metadata={"unit": "m"})
    height_loss: float = field(metadata={"unit": "m"})
    servo_sag: float = field(metadata={"unit": "m"})
    contact_sag: float = field(metadata={"unit": "m"})
    joint_torques: Array = field(metadata={"unit": "N m"})
    stance_feet: tuple[str, ...]
    contact_forces: dict[str, Array] = field(metadata={"unit": "N"})
    foot_creep: dict[str, float] = field(metadata={"unit": "m/s"})
    height_drift: float = field(metadata={"unit": "m/s"})
    residual: float = field(metadata={"unit": "N or m"})
    stiffness: float = field(metadata={"unit": "rad^2/s^2"})
    stable: bool
    release_margin: float = field(metadata={"unit": "1"})
    lasts: float = field(metadata={"unit": "s"})
    failures: tuple[Diagnostic, ...]


@check_arguments
def steady_state(
    robot: Robot,
    stand: Stand,
    *,
    kp: ArrayLike | None = None,
    feedforward: bool = False,
    feet: Feet = "pinned",
    seconds: float = 0.0,
) -> SteadyState:
    """Predicts where position servos let a standing robot sag to.

    The equilibrium of tau = clip(kp (ctrl - q), +- limit), gravity, and feet on the soft ground:

        g(q) - S^T tau - sum J_i(q)^T f_i = 0
        depth_i = r_i - z_i(q) = depth of f_i  if f_i > 0,   depth_i <= 0  if f_i = 0

    J_i is the Jacobian of the material point at the contact. Pinned, that point stays (the foot
    rolls on it), or creeps with -f_t / c as MuJoCo's friction has it, if ``seconds`` are given;
    sliding, its tangential force is zero. Newton's iteration follows the equilibrium from the stand
    itself, which full feed-forward holds, while feed-forward is taken away. Where on that way a
    swing foot touches the ground it is pinned there and carries from then on; where a foot would
    have to pull it lets go. Then backward Euler steps follow the creep. Where that goes on to take
    the robot down within ``HOLD_DURATION`` (12 s) it does not stand: just above the least stiffness
    an equilibrium is there, and a millimetre of creep ends it.

    Dry friction, of joints and of rolling feet, is left out.

    Args:
        robot: The robot.
        stand: How it shall stand.
        kp: Servo stiffness (N m/rad), one or (nu,); the model's own by default.
        feedforward: Command ctrl = q* + tau / kp instead of ctrl = q*.
        feet: ``pinned``: friction holds, as rubber's does for good and MuJoCo's for seconds.
            ``sliding``: no tangential force is left, where MuJoCo's creeping feet end.
        seconds: How long pinned feet have crept (s).

    Returns:
        The equilibrium; ``failures`` says why the robot will not stand so.

    Raises:
        ConfigurationError: If an argument is out of its range, or the robot cannot stand.
        UnknownNameError: If the stand is another robot's, with other feet.
        ModelError: If a joint has no motor, or the model has no servos and no kp is given.
        StaticsInfeasibleError: If no contact forces balance the stand itself.
        NoEquilibriumError: If there is no equilibrium that continues the stand.
    """
    robot = touching(robot, stand.task.contacts)
    check_steady_state_request(robot, stand, feet, seconds)
    robot = build_on_ground(robot, stand.task.ground, stand.rigid_targets)
    way = HomotopyPath(SagEquilibrium(robot, stand, kp, feet), exact=feedforward)
    pose = follow_to_end(way, feedforward=feedforward, seconds=seconds)
    if pose.failures or math.isinf(lasts := simulate_creep(way, pose)):
        return pose
    return replace(
        pose, lasts=lasts, failures=(diagnose("creep-ends-it", after=Quantity(lasts, "s")),)
    )


def simulate_creep(way: HomotopyPath, pose: SteadyState) -> float:
    """Lets pinned feet creep for ``HOLD_DURATION`` more, if that moves the base.

    Args:
        way: Whose end is ``pose``; it goes on.
        pose: An equilibrium that is stable.

    Returns:
        How long the robot stands (s); infinite if longer.
    """
    creeps = pose.feet != "sliding" and any(pose.foot_creep.values())
    if (
        not creeps
        or abs(pose.height_drift) * HOLD_DURATION <= MAX_CREEP_LOSS_RATIO * way.system.stand.qpos[2]
    ):
        return math.inf
    begun = way.crept
    with contextlib.suppress(NoEquilibriumError):
        for _ in range(CREEP_STEPS):
            way.creep_step(HOLD_DURATION / CREEP_STEPS)
            if _failures(way.system, way.solution, way.linearise(way.solution)[1]):
                break
        else:
            return math.inf
    return way.crept - begun


MAX_CREEP_DURATION = 1e9
"""s, some thirty years: of much more creep, numbers overflow."""


def check_steady_state_request(robot: Robot, stand: Stand, feet: str, seconds: float) -> None:
    """Checks what a prediction is asked for.

    Raises:
        ConfigurationError: If an argument is out of its range, or the robot cannot stand.
        UnknownNameError: If the stand is another robot's, with other feet.
    """
    stands = robot.bolted or robot.welds or (robot.floating and robot.contacts)
    if not stands or (stand.stance_feet and not robot.floating) or len(stand.qpos) != robot.nq:
        raise ConfigurationError("robot", diagnose("robot-cannot-stand", robot=robot.name))
    for foot in stand.foot_targets:
        robot.check_foot(foot)
    if feet not in ("pinned", "sliding"):
        raise ConfigurationError("feet", diagnose("feet-not-valid", given=str(feet)))
    if not 0 <= seconds <= MAX_CREEP_DURATION or (seconds and feet == "sliding"):
        problem = diagnose("creep-not-valid", given=f"{seconds} s")
        raise ConfigurationError("seconds", problem)
    if feet == "sliding" and (stand.task.ground.slope or stand.task.ground.planes):
        raise ConfigurationError("feet", diagnose("sliding-on-slope"))
    slippery = [foot for foot in robot.bearing if robot.contacts[foot].sliding_friction <= 0]
    if feet == "pinned" and slippery:
        raise ConfigurationError("feet", diagnose("feet-without-friction", feet=slippery))


def follow_to_end(way: HomotopyPath, *, feedforward: bool, seconds: float = 0.0) -> SteadyState:
    """Goes a way to its end; see ``steady_state``.

    Args:
        way: The way, at its beginning.
        feedforward: Keep the feed-forward.
        seconds: How long pinned feet creep then (s).

    Raises:
        NoEquilibriumError: If there is no equilibrium that continues the stand.
    """
    way.follow(0.0 if feedforward else 1.0)
    margin = release_margin(way)
    for _ in range(CREEP_STEPS if seconds else 0):
        way.creep_step(seconds / CREEP_STEPS)
    return describe_pose(way, margin)


def release_margin(way: HomotopyPath) -> float:
    """Returns the ``release_margin`` of a ``SteadyState`` at the end of a way."""
    held, now, robot = way.balance.contact_forces, way.solution.forces, way.system.robot
    feet, nothing = tuple(dict.fromkeys((*held, *now))), np.zeros(3)
    before = np.array([way.system.frames[foot] @ held.get(foot, nothing) for foot in feet])
    overshot = 2 * np.array([now.get(foot, nothing) for foot in feet]) - before
    left = [
        robot.contacts[foot].sliding_friction * z - math.hypot(x, y)
        for foot, (x, y, z) in zip(feet, overshot.tolist(), strict=True)
    ]
    return float(min(left, default=math.inf) / robot.usual_weight)


@check_arguments
def minimum_stiffness(
    robot: Robot, stand: Stand, *, feet: Feet = "pinned", tolerance: float = 0.01
) -> float:
    """Finds the least uniform kp with which a robot stands without feed-forward, by bisection.

    It stands if ``steady_state`` has no failures (so a swing foot that comes down to the ground
    is none of its standing, and creep does not take it down within 12 s) and keeps half of the
    stand's height.

    Args:
        robot: The robot.
        stand: How it shall stand.
        feet: What the feet do, as in ``steady_state``.
        tolerance: Relative, of the result.

    Returns:
        kp (N m/rad), rounded up: with it the robot does stand.

    Raises:
        ConfigurationError: If an argument is out of its range, or the robot cannot stand.
        UnknownNameError: If the stand is another robot's, with other feet.
        ModelError: If a joint has no motor.
        StaticsInfeasibleError: If no contact forces balance the stand itself.
        NoStiffnessError: If it does not stand with any kp up to ``HIGHEST_KP``; says why.
    """
    if not 0 < tolerance < 1:
        refused = diagnose("not-between", given=tolerance, low=0, high=1)
        raise ConfigurationError("tolerance", refused)
    robot = touching(robot, stand.task.contacts)
    check_steady_state_request(robot, stand, feet, 0.0)

    def obstacle(kp: float) -> Diagnostic | None:
        try:
            pose = steady_state(robot, stand, kp=kp, feet=feet)
        except NoEquilibriumError as error:
            return error.diagnostic
        if pose.base_height <= 0.5 * float(stand.qpos[2]) and not (robot.bolted or robot.welds):
            return diagnose("base-sags", height=Quantity(pose.base_height, "m"))
        if len(pose.failures) > 1:
            return diagnose("failures-together", failures=pose.failures)
        return pose.failures[0] if pose.failures else None

    unit = EquilibriumScales.of(robot, stand).stiffness
    low, high = 0.0, unit / 4
    while (problem := obstacle(high)) is not None:
        low, high = high, 2 * high
        if high > HIGHEST_KP * unit:
            raise NoStiffnessError(robot.name, low, problem)
    while high - low > tolerance * high:
        middle = (low + high) / 2
        low, high = (middle, high) if obstacle(middle) else (low, middle)
    return high


def describe_pose(way: HomotopyPath, margin: float) -> SteadyState:
    """Looks at where a way has come to, from all sides; ``margin`` is its release margin."""
    system, solution = way.system, way.solution
    robot, stand, qpos = system.robot, system.stand, solution.qpos
    forces = np.array(list(solution.forces.values())).reshape(-1, 3)
    derivative, stiffness = way.linearise(solution)
    touch = system.contacts_at(qpos)
    creep, flow = np.zeros((len(forces), 2)), np.zeros(len(derivative))
    if system.feet == "pinned":
        viscosities = [system.viscosity(foot, touch.depths[foot]) for foot in system.anchors]
        creep = -forces[:, :2] / np.array(viscosities)[:, None]
    flow[robot.nv :].reshape(-1, 3)[:, :2] = creep
    reached = touch.config.foot_positions()
    drops = {foot: stand.foot_targets[foot] - reached[foot] for foot in stand.stance_feet}
    height, drift = float(qpos[2]) if robot.floating else 0.0, 0.0
    loss = float(stand.qpos[2]) - height if robot.floating else 0.0
    if creep.any():
        drift = float(np.linalg.solve(system.apply_welds(qpos, derivative), flow)[2])
    contact_sag = stand.base_drop(robot, drops)
    return SteadyState(
        feet=system.feet,
        qpos=qpos,
        base_height=height,
        height_loss=loss,
        servo_sag=loss - contact_sag,
        contact_sag=contact_sag,
        joint_torques=system.torques(qpos),
        stance_feet=tuple(foot for foot in robot.contact_points if foot in solution.forces),
        contact_forces={
            foot: frame.T @ solution.force(foot) for foot, frame in system.frames.items()
        },
        foot_creep=dict(zip(system.anchors, np.linalg.norm(creep, axis=1).tolist(), strict=True)),
        height_drift=drift,
        residual=solution.residual,
        stiffness=stiffness,
        stable=stiffness > 0,
        release_margin=margin,
        lasts=math.inf,
        failures=_failures(system, solution, stiffness),
    )


def _data_of(robot: Robot) -> mujoco.MjData:
    return mujoco.MjData(robot.mj_model)


def _failures(
    system: SagEquilibrium, solution: Solution, stiffness: float
) -> tuple[Diagnostic, ...]:
    robot, stand = system.robot, system.stand
    failures = []
    if not stiffness > 0:
        failures.append(diagnose("equilibrium-not-stable", stiffness=Quantity(stiffness, "1/s^2")))
    for foot, force in solution.forces.items():
        if foot not in stand.stance_feet:
            force_up = Quantity(force[2], "N")
            message = diagnose("lifted-foot-presses", subject=("foot", foot), force=force_up)
            failures.append(message)
    touching = {foot for foot, force in solution.forces.items() if force[2] > 0}
    failures += [
        diagnose("foot-slides", subject=("foot", foot))
        for foot in find_sliding_feet(system, solution)
    ]
    idle = [f for f in robot.feet_with(stand.stance_feet) if touching.isdisjoint(robot.feet[f])]
    failures += [diagnose("foot-idle", subject=("foot", foot), time=None) for foot in idle]
    qpos, (low, high) = solution.qpos, joint_ranges(robot).T
    joints = qpos[-robot.nu :]
    failures += [
        diagnose("joint-beyond-limit", subject=("joint", robot.joint_names[i]))
        for i in np.flatnonzero(
            (joints < low - LIMIT_TOLERANCE) | (joints > high + LIMIT_TOLERANCE)
        )
    ]
    with lend(robot, _data_of) as data:  # what is asked of them depends on qpos alone
        robot.mj_convention.set_state(data, qpos)
        mujoco.mj_kinematics(robot.mj_model, data)
        mujoco.mj_comPos(robot.mj_model, data)
        mujoco.mj_collision(robot.mj_model, data)
        others = contact.bodies_on_ground(robot.mj_model, data, robot.foot_geoms)
    failures += [
        diagnose("body-touches-ground", subject=("body", body), time=None)
        for body in sorted(others)
    ]
    return tuple(failures)
