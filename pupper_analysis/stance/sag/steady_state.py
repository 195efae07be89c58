"""Rest position of a standing robot on position servos and soft ground, without feed-forward.

`steady_state` follows a path of equilibria from the stand (`HomotopyPath`). Feed-forward is the
part of the servo commands that balances the load in advance; its removed fraction grows from 0 to 1
in steps. Then pinned feet creep for a given time. The result contains the height loss, torques,
contact forces, and the reasons why the robot does not stay in the equilibrium.
`stance.sag.stiffness` finds the smallest kp without such reasons.

An equilibrium is stable if its stiffness is positive in each motion that the feet permit.
"""

from __future__ import annotations

import contextlib
import math
from dataclasses import dataclass, field, replace
from typing import ClassVar

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from pupper_analysis.base import lapack
from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import (
    Diagnostic,
    Quantity,
    Term,
    diagnose,
)
from pupper_analysis.base.errors import ConfigurationError, NoEquilibriumError
from pupper_analysis.base.results import Result
from pupper_analysis.base.units import EFFORT_UNIT
from pupper_analysis.robot import contact
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.joints import joint_ranges
from pupper_analysis.robot.robot import Robot, borrow
from pupper_analysis.robot.servos import compute_command_lead
from pupper_analysis.robot.stability import HOLD_DURATION
from pupper_analysis.robot.terrain import build_on_ground, find_touched_surface
from pupper_analysis.robot.touching import with_contacts
from pupper_analysis.stance.posture import LIMIT_TOLERANCE
from pupper_analysis.stance.sag.equilibrium import (
    GROUND_NORMAL,
    Anchor,
    SagEquilibrium,
    SlipLaw,
    Solution,
)
from pupper_analysis.stance.stand import Stand, stand_statics
from pupper_analysis.statics.cone_program import split_force
from pupper_analysis.statics.equilibrium import ForceDistribution, GravityCompensation

MAX_PIVOT_RATIO = 0.01
"""Largest slip of a sole, in units of the robot's stand height, with which a sole with saturated
friction does not count as sliding. For a biped of 0.3 m this is 3 mm. Measured: soles in MuJoCo
pivoted by 0.1 to 0.4 mm."""


def find_sliding_feet(system: SagEquilibrium, solution: Solution) -> tuple[str, ...]:
    """Find the stance feet that slide: friction is saturated at all loaded points of the foot.

    A sole may pivot by a fraction of a millimetre, with all points at the friction limit, until its
    leg is no longer twisted. Such a sole does not count as sliding (`MAX_PIVOT_RATIO`). A point
    without friction always slips, and holds no tangential force that could be exceeded.
    """
    loose, names = set(find_slipping_points(system, solution)), tuple(system.anchors)
    if not loose:
        return ()
    small = MAX_PIVOT_RATIO * system.robot.stand_height
    slips = np.linalg.norm(measure_slips(system, solution), axis=1)
    sliding = []
    for foot in system.robot.feet_with(system.stand.stance_feet):
        points = [point for point in system.robot.feet[foot] if point in names]
        pressed = [point for point in points if solution.forces[point][2] > 0]
        if not pressed or not loose.issuperset(pressed):
            continue
        if not any(system.sliding_friction[point] > 0 for point in pressed):
            continue
        slip = max(float(slips[names.index(point)]) for point in pressed)
        if len(system.robot.feet[foot]) == 1 or slip > small:
            sliding.append(foot)
    return tuple(sliding)


def find_slipping_points(system: SagEquilibrium, solution: Solution) -> tuple[str, ...]:
    """Find the contact points that slip in an equilibrium: their friction is saturated."""
    forces, names = system.stack_forces(solution), tuple(system.anchors)
    places = system.slips(solution.qpos, forces)
    return tuple(names[row] for row, *_ in system.find_slipping_contacts(forces, places))


def measure_slips(system: SagEquilibrium, solution: Solution) -> Array:
    """Compute the slip of each touching contact point along the ground in an equilibrium.

    The slip is measured from the first contact, or from the start of the current creep step (slow
    slip during a short time). The slips of a sole's points are projected onto a rigid motion.

    Args:
        system: Equilibrium equations of the robot on its servos.
        solution: Solution of the equations.

    Returns:
        Slips, shape (n, 2) [m], along the two ground tangents of each contact.
    """
    begun = np.array([system.creep_start_slips.get(foot, np.zeros(2)) for foot in system.anchors])
    places = system.contacts_at(solution.qpos).places[:, :2]
    return system.project_soles(places - begun.reshape(-1, 2))


def compute_smallest_stiffness(
    system: SagEquilibrium, solution: Solution, derivative: Array
) -> float:
    """Compute the smallest eigenvalue [1/s^2] of the stiffness matrix relative to the mass matrix.

    The result decides the stability: an equilibrium is stable if the eigenvalue is positive.

    The stiffness matrix is the Hessian of the potential energy in the motions that the feet permit,
    plus the stiffness of saturated friction. The matrix may be unsymmetric if feet slip.

    Args:
        system: Equilibrium equations of the robot on its servos.
        solution: Solution of the equations.
        derivative: Derivative of the equations at the solution (`SagEquilibrium.derivative`).

    Returns:
        The smallest real part of an eigenvalue; infinite if feet and welds permit no motion.
    """
    n, feet, forces = system.robot.nv, tuple(system.anchors), system.stack_forces(solution)
    touch = system.contacts_at(solution.qpos)
    config, depths, jacobian = touch.config, touch.places[:, 2], touch.jacobians
    laws, normal = [system.laws[foot] for foot in feet], jacobian[:, 2]
    moving, slips = find_slipping_points(system, solution), measure_slips(system, solution)
    # Touching points of soles may be without load.
    idle = system.is_sole_point() & np.array(
        [depth <= -law.margin for law, depth in zip(laws, depths, strict=True)], dtype=bool
    )
    rates = np.array([law.normal_stiffness(depth) for law, depth in zip(laws, depths, strict=True)])
    rates[idle] = 0.0
    pushed = normal.copy()  # direction of a contact force, including saturated friction
    slipping = [row for row, foot in enumerate(feet) if foot in moving]
    for row in slipping:
        if not idle[row]:
            pushed[row] += forces[row, :2] / forces[row, 2] @ jacobian[row, :2]
    hessian = derivative[:n, :n] + pushed.T @ (rates[:, None] * normal)
    across = system.project_soles(jacobian[:, :2])
    # Saturated friction is f_t = -mu f_n s / |s|. A displacement perpendicular to the slip s turns
    # the force: stiffness mu f_n / |s|. Along s the stiffness is zero.
    for row in slipping:
        slip, pressing = float(np.linalg.norm(slips[row])), forces[row, 2]
        if slip > 0 and pressing > 0:
            along, mu = slips[row] / slip, system.sliding_friction[feet[row]]
            stiff = mu * pressing / slip * (np.eye(2) - np.outer(along, along))
            hessian += across[row].T @ stiff @ across[row]
    sticks = [row for row, foot in enumerate(feet) if foot not in moving and not idle[row]]
    held = across[sticks].reshape(-1, n)
    # Horizontal translations and yaw of the robot are ignored if no contact resists these motions.
    if system.feet == "sliding":
        held = np.vstack([np.eye(2, n), _make_yaw_row(config)])
    elif len(sticks) == 1 and _can_yaw_freely(system):
        held = np.vstack([held, _make_yaw_row(config)])
    if system.robot.fixed_parts:
        held = np.vstack([held, system.weld_rows(solution.qpos)])
    _, lengths, rows = np.linalg.svd(held)
    least = max(held.shape) * np.finfo(float).eps * lengths.max(initial=0.0)
    free = rows[np.count_nonzero(lengths > least) :].T  # basis of the permitted motions
    if not free.shape[1]:
        return math.inf
    both = (free.T @ matrix @ free for matrix in (hessian, config.mass_matrix()))
    real, _, scale, *_ = lapack.dggev(*both, compute_vl=0, compute_vr=0)
    values = np.divide(real, scale, out=np.full(len(real), np.inf), where=scale != 0)
    return float(values.min())


def _make_yaw_row(config: Configuration) -> Array:
    """Return the Jacobian (nv,) by qvel of the yaw rate of a free base."""
    row = np.zeros(config.robot.nv)
    row[3:6] = config.base_rotation()[2]
    return row


def _can_yaw_freely(system: SagEquilibrium) -> bool:
    """Return True if a robot can yaw about the only touching point that has friction.

    Conditions: the ground is level, gravity is vertical, and the robot has no welds or fixed base.
    Torsional friction is ignored, as in the equations.
    """
    robot, ground = system.robot, system.stand.task.ground
    rough = sum(system.sliding_friction[foot] > 0 for foot in system.anchors)
    is_level = not (ground.slope or ground.planes or robot.gravity[:2].any())
    return rough == 1 and is_level and not robot.fixed_parts and not robot.is_base_fixed


_MIN_SHARE_STEP = 1 / 64
"""Fraction of all feed-forward below which `HomotopyPath.follow` does not shorten its step: if no
equilibrium is found with a step of this size, the path of equilibria ends. Chosen, not tuned."""

_MAX_UNCHECKED_STEP = 1 / 64
"""Largest step of `HomotopyPath.follow`, as a fraction of all feed-forward, whose new equilibrium
is accepted without a stability check. A longer step may end at an unstable equilibrium of another
path. Chosen, not tuned."""

_SHARE_TOLERANCE = 1e-7
"""Tolerance [1] of a bisection for the removed fraction of the feed-forward (0 to 1) with which a
contact opens or closes. Chosen: corresponds to nanometres of motion."""

_MAX_EVENTS = 24
"""Upper bound of the number of contact changes (contacts that open or close) along a path of
equilibria of a robot with few contact points. With more changes, the same contacts probably open
and close in turn, and the path ends with an error. Chosen, not tuned."""

_FRICTION_SHARE_OF_SLIDING = 0.95
"""Fraction of the friction limit above which an error names a foot as about to slide. Chosen below
1, since the last computed equilibrium may be before the actual end of the path."""

CREEP_STEPS = 20
"""Number of intervals into which a creep duration is divided, with one or more backward Euler steps
each. Measured: with 20, a robot that falls after 15 s is predicted to fall after 14 s."""

_MIN_EULER_STEP = 1 / 4096
"""Fraction of the duration of `HomotopyPath.creep_step` below which a backward Euler step is not
shortened: the creep (slow slip) of feet ends with an error instead. For a duration of 0.6 s this is
0.15 ms. Chosen, not tuned."""


class HomotopyPath:
    """Path of equilibria from a stand to its rest position without feed-forward.

    First the feed-forward is removed, the part of the servo commands that balances the load in
    advance. Then feet creep (loaded feet slip slowly).

    Args:
        system: Equilibrium equations of the robot on its servos.
        end: Servo target at the end of the path, shape (nu,) [rad, m]. Default: the joint positions
            of the stand, without feed-forward.
        exact: Argument of `SagEquilibrium.solve` for the first equilibrium.

    Attributes:
        system: Equilibrium equations, with the touching contacts at the current point of the path.
        balance: Static equilibrium of the stand.
        share: Removed fraction of the feed-forward, 0 to 1.
        solution: Current equilibrium.
        creep_time: Simulated creep so far [s].

    Raises:
        StaticsInfeasibleError: If no contact forces balance the stand.
        NoEquilibriumError: If the stand has no equilibrium on soft ground.
    """

    def __init__(
        self, system: SagEquilibrium, end: Array | None = None, *, exact: bool = True
    ) -> None:
        self.system, stand = system, system.stand
        self._linearisation: tuple[Solution, Array, float] | None = None
        self.end: Array = stand.joint_positions(system.robot) if end is None else end
        self.balance: GravityCompensation = stand_statics(
            system.robot, stand, distribution=ForceDistribution.MIN_TANGENTIAL
        )
        self.share, self._events, self.creep_time = 0.0, 0, 0.0
        self._euler_step = math.inf
        forces = {f: system.frames[f] @ force for f, force in self.balance.contact_forces.items()}
        sunk = system.equilibrium_depths(np.array(list(forces.values())).reshape(-1, 3))
        qpos = stand.qpos.copy()
        if not (system.robot.is_base_fixed or system.robot.fixed_parts):
            qpos[2] -= np.mean(sunk) - np.mean(list(stand.depths.values()))
        self._set_command(0.0)
        when = diagnose("as-it-stands-fed")
        self.solution = self._solve_contacts(Solution(qpos, forces), when, exact)

    def follow(self, fraction: float) -> None:
        """Remove a fraction of the feed-forward in adaptive steps, and solve each equilibrium.

        Args:
            fraction: Fraction of the feed-forward to remove, 0 (none) to 1 (all).

        Raises:
            NoEquilibriumError: If no equilibrium continues the path before this fraction, or if
                contacts change too often.
        """
        step = 1.0
        while self.share < fraction:
            wanted = min(self.share + step, fraction)
            found = self._solve_at(wanted)
            if found is not None and step > _MAX_UNCHECKED_STEP and self.linearise(found)[1] <= 0:
                # A long step may end on another branch.
                found = None
            if found is not None:
                if not self.system.find_violations(found):
                    self.share, self.solution, step = wanted, found, 2 * step
                    continue
                if self._go_to_event(wanted, found):
                    continue
            step /= 2
            if step < _MIN_SHARE_STEP:
                raise NoEquilibriumError(
                    self.share,
                    diagnose(
                        "feed-forward-needed",
                        feet=Term(self.system.feet),
                        # Coupled joints have kp = 0.
                        kp=Quantity(self.system.kp[self.system.kp > 0].min(), "N m/rad"),
                        share=self.share,
                        sliding=self._find_feet_about_to_slide(),
                    ),
                )

    def linearise(self, solution: Solution) -> tuple[Array, float]:
        """Compute Jacobian and smallest stiffness of the equilibrium equations at a solution.

        Returns:
            Jacobian (`SagEquilibrium.derivative`), and smallest eigenvalue of stiffness relative to
            mass [1/s^2] (`compute_smallest_stiffness`).
        """
        system, seen = self.system, self._linearisation
        if seen is None or seen[0] is not solution:
            derivative = system.derivative(solution.qpos, system.stack_forces(solution))
            seen = self._linearisation = (
                solution,
                derivative,
                compute_smallest_stiffness(system, solution, derivative),
            )
        return seen[1:]

    def creep_step(self, seconds: float) -> None:
        """Let feet that stick by friction creep (slip slowly, as in MuJoCo) for a duration [s].

        Creep is integrated by backward Euler steps of adaptive size: twisted soles, for example,
        creep by a millimetre within hundredths of a second.

        Raises:
            NoEquilibriumError: If even a short step has no equilibrium; the path stays at the last
                equilibrium.
        """
        left = seconds
        while left > 0:
            step = min(self._euler_step, left)
            system, solution = self.system, self.solution
            before = (
                dict(system.anchors),
                dict(system.creep_start_slips),
                dict(system.creep_compliances),
            )
            system.begin_creep(solution, step)
            try:
                self.solution = self._solve_contacts(
                    self.solution, diagnose("after-creep", time=self.creep_time)
                )
            except NoEquilibriumError:
                self.solution = solution
                system.anchors, system.creep_start_slips, system.creep_compliances = before
                self._euler_step = step / 4
                if self._euler_step < _MIN_EULER_STEP * seconds:
                    raise
                continue
            self.creep_time += step
            left -= step
            self._euler_step = 2 * step

    def reset_creep(self, anchors: dict[str, Anchor]) -> None:
        """Set the touching contacts, with a creep (slow slip) of zero for all contacts.

        Args:
            anchors: {touching contact: pose at the first contact}.
        """
        system = self.system
        system.anchors, system.creep_start_slips, system.creep_compliances = dict(anchors), {}, {}
        self.creep_time, self._euler_step, self._events = 0.0, math.inf, 0

    def remove_feedforward(self) -> None:
        """Remove all feed-forward from the servo commands, without solving for an equilibrium."""
        self.share = 1.0
        self._set_command(1.0)

    def _find_feet_about_to_slide(self) -> list[str]:
        """Find the contact points whose tangential force is close to the friction limit.

        A point without friction is never close to its limit: its tangential force is zero.
        """
        if self.system.feet != "pinned":
            return []
        feet = []
        for foot, force in self.solution.forces.items():
            pressing, tangential = split_force(force.tolist(), GROUND_NORMAL)
            limit = self.system.sliding_friction[foot] * pressing
            has_friction = self.system.sliding_friction[foot] > 0
            if has_friction and tangential > _FRICTION_SHARE_OF_SLIDING * limit:
                feet.append(foot)
        return feet

    def _set_command(self, share: float) -> None:
        """Set the servo commands with the fraction 1 - ``share`` of the feed-forward."""
        system = self.system
        full = system.stand.joint_positions(system.robot) + compute_command_lead(
            self.balance.joint_torques, system.kp
        )
        system.set_command(full + share * (self.end - full))

    def _solve_at(self, share: float) -> Solution | None:
        """Solve the equilibrium with a fraction ``share`` of the feed-forward removed, or None."""
        self._set_command(share)
        return self.system.solve(self.solution)

    def _go_to_event(self, wanted: float, there: Solution) -> bool:
        """Move along the path to the next opening or closing of a contact, and switch it.

        Args:
            wanted: Removed fraction of the feed-forward at which contacts contradict the solution.
            there: Solution at this fraction.

        Returns:
            False if no equilibrium is found in between.
        """
        right = self.share
        while wanted - right > _SHARE_TOLERANCE:
            middle = (right + wanted) / 2
            found = self._solve_at(middle)
            if found is None:
                return False
            if self.system.find_violations(found):
                wanted, there = middle, found
            else:
                right = middle
        self._set_command(wanted)
        self.share = wanted
        self._switch_contact(next(iter(self.system.find_violations(there))), there)
        return True

    def _switch_contact(self, foot: str, found: Solution) -> None:
        """Release a contact point that touches in the solution ``found``, or else add it."""
        self._events += 1
        if self._events > max(_MAX_EVENTS, 4 * len(self.system.robot.contact_points)):
            raise NoEquilibriumError(
                self.share, diagnose("foot-neither-carries-nor-clears", subject=("foot", foot))
            )
        self.solution = self.system.switch_contact(foot, found)

    def _solve_contacts(self, guess: Solution, when: Diagnostic, exact: bool = True) -> Solution:
        """Solve the equilibrium; switch contacts until no contact contradicts the solution."""
        self.solution = guess
        while True:
            found = self.system.solve(self.solution, exact=exact)
            if found is None:
                closed = not any(self.system.stand.depths.values())
                robot = self.system.robot
                loops = robot.floating and robot.closure is not None and closed
                message = diagnose("equilibrium-ends", when=when, loops=loops)
                raise NoEquilibriumError(self.share, message)
            wrong = self.system.find_violations(found)
            if not wrong:
                return found
            self._switch_contact(next(iter(wrong)), found)


RELEASE_MARGIN = 0.06
"""Smallest friction reserve of the feet (`SteadyState.release_margin`), in robot weights, with
which the feet are expected to stay in place if the feed-forward is removed in one step. Chosen as
an allowance for contact effects that the first-order estimate of the overshoot neglects."""

MAX_CREEP_LOSS_RATIO = 0.002
"""Predicted height change by creep within ``HOLD_DURATION``, relative to the base height in the
stand, up to which creep is not simulated. Measured on a quadruped 2 % above its minimum stiffness:
creep ends the equilibrium after 5 s, with a ratio of 0.025."""


@dataclass(frozen=True, eq=False)
class SteadyState(Result):
    """Equilibrium of a servo-driven robot on its feet, or with a fixed base.

    Attributes:
        feet: Slip law of the feet: ``pinned`` or ``sliding``.
        qpos: Configuration, shape (nq,).
        base_height: Height of the base frame (m); 0 for a fixed base.
        height_loss: Height of the base in the stand minus ``base_height`` (m), the sum of
            ``servo_sag`` and ``contact_sag``; 0 for a fixed base.
        servo_sag: Height loss by deflection of the joints (m).
        contact_sag: Height loss by penetration of the feet (m).
        joint_torques: Motor torques or forces, shape (nu,) (N m or N).
        stance_feet: Contact points that touch the ground. Swing feet that came down are included.
            Stance feet that were released are not included.
        contact_forces: {contact point: force of the ground, shape (3,)} of all contact points, in
            world axes (N); zero without contact.
        foot_creep: {touching contact point: creep speed in MuJoCo's friction} (m/s); zero for
            sliding feet.
        rolling_feet: Touching contact points whose rolling friction MuJoCo's no-slip solver keeps:
            the prediction ignores this friction, and the robot may stay away from the equilibrium.
            Empty if this solver is inactive: rolling feet then creep, as sliding feet do.
        height_drift: Rate of the base height by creep (m/s). A simulated height stays within D of
            the predicted height for about D / |height_drift| seconds.
        residual: Largest absolute element of the residual of the equations (N or m).
        stiffness: Smallest eigenvalue of the energy's Hessian in the motions that the feet permit,
            relative to the mass matrix (rad^2/s^2). If it is positive, its square root is the
            lowest natural frequency without damping.
        stable: Whether ``stiffness`` is positive.
        release_margin: Smallest friction reserve of a contact point, in robot weights, in the
            overshoot after the feed-forward is removed in one step. The reserve of a point without
            friction is its normal force. To first order, the overshoot is twice as far from the
            stand as the equilibrium. Below ``RELEASE_MARGIN`` a foot may slip or lift, and the
            robot may come to rest up to millimetres away from the equilibrium. Infinite without
            contacts.
        lasts: Time until creep ends the equilibrium or leads to a failure (s). Infinite if this
            time is longer than ``HOLD_DURATION``, or is not computed.
        failures: Reasons why the robot does not stay in this equilibrium; empty if no reason was
            found.
    """

    _key_fields: ClassVar[tuple[str, ...]] = ("lasts", "stable", "failures")

    feet: SlipLaw
    qpos: Array = field(metadata={"unit": "m, 1 (quaternion) and rad"})
    base_height: float = field(metadata={"unit": "m"})
    height_loss: float = field(metadata={"unit": "m"})
    servo_sag: float = field(metadata={"unit": "m"})
    contact_sag: float = field(metadata={"unit": "m"})
    joint_torques: Array = field(metadata={"unit": EFFORT_UNIT})
    stance_feet: tuple[str, ...]
    contact_forces: dict[str, Array] = field(metadata={"unit": "N"})
    foot_creep: dict[str, float] = field(metadata={"unit": "m/s"})
    rolling_feet: tuple[str, ...]
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
    feet: SlipLaw = "pinned",
    seconds: float = 0.0,
) -> SteadyState:
    """Predict the rest position of a standing robot on position servos and soft ground.

    Solves for the equilibrium of gravity g, servo torques tau = clip(kp (ctrl - q), +- limit) and
    forces f_i of the soft ground on contact spheres with radius r_i and centre height z_i:

        g(q) - S^T tau - sum J_i(q)^T f_i = 0
        depth_i = r_i - z_i(q) = depth of f_i  if f_i > 0,   depth_i <= 0  if f_i = 0

    S selects the joints with motors. J_i is the Jacobian of the material point at the contact. If
    ``feet`` is "pinned", this point does not slip, up to the friction limit. If ``seconds`` is also
    positive, the point creeps at the velocity -f_t / c, as in MuJoCo's friction. If ``feet`` is
    "sliding", the tangential force f_t is zero. Dry friction of joints and of rolling feet is
    ignored.

    Newton's method starts at the stand with full feed-forward, and follows the equilibrium while
    feed-forward is removed and contacts open and close. Then backward Euler steps follow the creep.

    Args:
        robot: Robot.
        stand: Stand from which the robot sags.
        kp: Servo stiffness [N m/rad, N/m], scalar or shape (nu,). Default: the model's.
        feedforward: Whether ctrl = q* + tau / kp (joint positions plus static torques of the
            stand); otherwise ctrl = q*.
        feet: ``pinned``: the feet stick up to the friction limit (as in MuJoCo for some seconds).
            ``sliding``: no tangential forces, the final state of MuJoCo's creep.
        seconds: Creep time of pinned feet [s].

    Returns:
        The equilibrium. ``failures`` contains reasons why the robot does not stay there, for
        example that further creep would end the equilibrium within ``HOLD_DURATION`` (12 s).

    Raises:
        ConfigurationError: If an argument is invalid, or the robot cannot stand.
        UnknownNameError: If the stand has feet that the robot lacks.
        ModelError: If a joint has no motor, if it has no position servo and ``kp`` is None, or if
            the contacts or the ground cannot be added (``build_on_ground``), for example.
        StaticsInfeasibleError: If no contact forces balance the stand.
        NoEquilibriumError: If the stand has no equilibrium on soft ground, if the equilibrium is
            lost while feed-forward is removed, or if it ends by creep within ``seconds``.
    """
    robot = with_contacts(robot, stand.task.contacts)
    check_steady_state_request(robot, stand, feet, seconds)
    path = make_homotopy_path(robot, stand, kp, feet, exact=feedforward)
    pose = follow_to_end(path, feedforward=feedforward, seconds=seconds)
    if pose.failures or math.isinf(lasts := simulate_creep(path, pose)):
        return pose
    return replace(
        pose, lasts=lasts, failures=(diagnose("creep-ends-it", after=Quantity(lasts, "s")),)
    )


def make_homotopy_path(
    robot: Robot, stand: Stand, kp: ArrayLike | None, feet: SlipLaw, *, exact: bool = False
) -> HomotopyPath:
    """Create the path of equilibria of a stand, at the start of the path.

    The start is the equilibrium with feed-forward torques; along the path, these are removed.

    Args:
        robot: Robot, with the contacts of the stand.
        stand: Stand.
        kp: Stiffness [N m/rad, N/m], scalar or shape (nu,). Default: the model's.
        feet: Slip law: ``pinned`` feet hold tangential forces up to the limit of their friction,
            ``sliding`` feet hold none.
        exact: Argument of `SagEquilibrium.solve` for the first equilibrium.

    Raises:
        ModelError: If a joint has no position servo and ``kp`` is None, for example.
        StaticsInfeasibleError: If no contact forces balance the stand.
        NoEquilibriumError: If the stand has no equilibrium on soft ground.
    """
    robot = build_on_ground(robot, stand.task.ground, stand.rigid_targets)
    return HomotopyPath(SagEquilibrium(robot, stand, kp, feet), exact=exact)


def simulate_creep(path: HomotopyPath, pose: SteadyState) -> float:
    """Compute how long [s] an equilibrium lasts while its feet creep (slip slowly).

    Args:
        path: Path of equilibria that ends at ``pose``; the call extends the path.
        pose: Stable equilibrium.

    Returns:
        Time [s] until the equilibrium no longer exists or has a failure. Infinite if longer than
        ``HOLD_DURATION`` (12 s), or if creep is negligible (`MAX_CREEP_LOSS_RATIO`).
    """
    creeps = pose.feet != "sliding" and any(pose.foot_creep.values())
    if (
        not creeps
        or abs(pose.height_drift) * HOLD_DURATION
        <= MAX_CREEP_LOSS_RATIO * path.system.stand.qpos[2]
    ):
        return math.inf
    begun = path.creep_time
    with contextlib.suppress(NoEquilibriumError):
        for _ in range(CREEP_STEPS):
            path.creep_step(HOLD_DURATION / CREEP_STEPS)
            if _find_failures(path.system, path.solution, path.linearise(path.solution)[1]):
                break
        else:
            return math.inf
    return path.creep_time - begun


MAX_CREEP_DURATION = 1e9
"""Upper bound of the creep time of `steady_state` [s], thirty years. Chosen: with much larger
times, numbers may overflow."""


def check_steady_state_request(robot: Robot, stand: Stand, feet: str, seconds: float) -> None:
    """Raise an error if an argument of `steady_state` is invalid.

    Args:
        robot: Robot.
        stand: Stand.
        feet: ``"pinned"`` or ``"sliding"``.
        seconds: Creep time [s] from 0 to `MAX_CREEP_DURATION`; 0 if ``feet`` is ``"sliding"``.

    Raises:
        ConfigurationError: If the robot cannot stand, ``feet`` is ``"sliding"`` on a slope, or
            no pinned foot has friction, for example.
        UnknownNameError: If the stand has feet that the robot lacks.
    """
    stands = robot.is_base_fixed or robot.fixed_parts or (robot.floating and robot.contacts)
    if not stands or (stand.stance_feet and not robot.floating) or len(stand.qpos) != robot.nq:
        raise ConfigurationError("robot", diagnose("robot-cannot-stand", robot=robot.name))
    for foot in stand.foot_targets:
        robot.check_foot(foot)
    if not isinstance(feet, str) or feet not in ("pinned", "sliding"):
        raise ConfigurationError("feet", diagnose("feet-not-valid", given=str(feet)))
    if not 0 <= seconds <= MAX_CREEP_DURATION or (seconds and feet == "sliding"):
        problem = diagnose("creep-not-valid", given=f"{seconds} s")
        raise ConfigurationError("seconds", problem)
    if feet == "sliding" and (stand.task.ground.slope or stand.task.ground.planes):
        raise ConfigurationError("feet", diagnose("sliding-on-slope"))
    points = list(robot.bearing_points)
    has_friction = any(robot.contacts[point].sliding_friction > 0 for point in points)
    if feet == "pinned" and points and not has_friction:
        raise ConfigurationError("feet", diagnose("feet-without-friction", feet=points))


def follow_to_end(path: HomotopyPath, *, feedforward: bool, seconds: float = 0.0) -> SteadyState:
    """Compute the equilibrium of a stand after removal of the feed-forward and creep of the feet.

    Args:
        path: Path at its start, with the full feed-forward; modified.
        feedforward: Whether to keep the full feed-forward.
        seconds: Duration of the creep [s]; 0 for no creep.

    Raises:
        NoEquilibriumError: If the path of equilibria ends while feed-forward is removed, or during
            the creep.
    """
    path.follow(0.0 if feedforward else 1.0)
    margin = release_margin(path)
    for _ in range(CREEP_STEPS if seconds else 0):
        path.creep_step(seconds / CREEP_STEPS)
    return collect_steady_state(path, margin)


def release_margin(path: HomotopyPath) -> float:
    """Compute the smallest friction reserve [1] of a contact after removal of the feed-forward.

    The reserve is (friction coefficient x normal force - tangential force) / weight. It is
    evaluated in the overshoot after a removal in one step. The forces are then 2 f - f_0, with the
    forces f at the current equilibrium of the path and f_0 in the stand. A contact without friction
    can only lift: its reserve is the normal force / weight. Infinite without contacts.
    """
    held, now, robot = path.balance.contact_forces, path.solution.forces, path.system.robot
    feet, nothing = tuple(dict.fromkeys((*held, *now))), np.zeros(3)
    before = np.array([path.system.frames[foot] @ held.get(foot, nothing) for foot in feet])
    overshot = 2 * np.array([now.get(foot, nothing) for foot in feet]) - before
    margins = []
    for foot, force in zip(feet, overshot.tolist(), strict=True):
        pressing, tangential = split_force(force, GROUND_NORMAL)
        friction = robot.contacts[foot].sliding_friction
        margins.append(friction * pressing - tangential if friction > 0 else pressing)
    return float(min(margins, default=math.inf) / robot.usual_weight)


def find_sag_failure(
    robot: Robot, stand: Stand, *, kp: ArrayLike | None = None, feet: SlipLaw = "pinned"
) -> Diagnostic | None:
    """Predict if a robot stands without feed-forward; return the reason if not, else None.

    Args:
        robot: Robot, with the contacts of the stand (`with_contacts`).
        stand: Stand.
        kp: Stiffness [N m/rad, N/m], scalar or shape (nu,). Default: the model's.
        feet: Slip law: ``pinned`` feet hold tangential forces up to the limit of their friction,
            ``sliding`` feet hold none.

    Raises:
        ConfigurationError: If an argument is invalid, or the robot cannot stand.
        UnknownNameError: If the stand has feet that the robot lacks.
        ModelError: If a joint has no position servo and ``kp`` is None, for example.
        StaticsInfeasibleError: If no contact forces balance the stand.
    """
    try:
        pose = steady_state(robot, stand, kp=kp, feet=feet)
    except NoEquilibriumError as error:
        return error.diagnostic
    return describe_sag_failure(robot, stand, pose)


def describe_sag_failure(robot: Robot, stand: Stand, pose: SteadyState) -> Diagnostic | None:
    """Return the reason why an equilibrium does not count as standing; None if the robot stands.

    The reason is a failure of the equilibrium, or a base that sinks to half of its height or lower.

    Args:
        robot: Robot, with the contacts of the stand.
        stand: Stand.
        pose: Equilibrium without feed-forward.
    """
    if pose.base_height <= 0.5 * float(stand.qpos[2]) and not (
        robot.is_base_fixed or robot.fixed_parts
    ):
        return diagnose("base-sags", height=Quantity(pose.base_height, "m"))
    if len(pose.failures) > 1:
        return diagnose("failures-together", failures=pose.failures)
    return pose.failures[0] if pose.failures else None


def collect_steady_state(path: HomotopyPath, margin: float) -> SteadyState:
    """Create the `SteadyState` of an equilibrium: heights, torques, contact forces, failures.

    Args:
        path: Path of equilibria; its current solution is described.
        margin: `SteadyState.release_margin` [robot weights] to be stored in the result.
    """
    system, solution = path.system, path.solution
    robot, stand, qpos = system.robot, system.stand, solution.qpos
    forces = np.array(list(solution.forces.values())).reshape(-1, 3)
    derivative, stiffness = path.linearise(solution)
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
        rolling_feet=tuple(
            foot
            for foot in solution.forces
            if not system.has_creep and robot.contacts[foot].rolling_friction > 0
        ),
        height_drift=drift,
        residual=solution.residual,
        stiffness=stiffness,
        stable=stiffness > 0,
        release_margin=margin,
        lasts=math.inf,
        failures=_find_failures(system, solution, stiffness),
    )


def _make_rest_data(robot: Robot) -> mujoco.MjData:
    """Create MuJoCo data of the robot's model, for the cache of `_find_failures`."""
    return mujoco.MjData(robot.mj_model)


def _find_failures(
    system: SagEquilibrium, solution: Solution, stiffness: float
) -> tuple[Diagnostic, ...]:
    """List reasons why the robot does not stay in an equilibrium.

    ``stiffness`` [1/s^2] is the result of `compute_smallest_stiffness`.
    """
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
    with borrow(robot, _make_rest_data) as data:  # all evaluated quantities depend on qpos only
        robot.mj_convention.set_state(data, qpos)
        mujoco.mj_kinematics(robot.mj_model, data)
        mujoco.mj_comPos(robot.mj_model, data)
        mujoco.mj_collision(robot.mj_model, data)
        touching_bodies = contact.bodies_on_ground(robot.mj_model, data, robot.foot_geoms)
        surfaces = {
            body: find_touched_surface(robot.mj_model, data, body)
            for body in sorted(touching_bodies)
        }
    failures += [
        diagnose("body-touches-ground", subject=("body", body), surface=surface, time=None)
        for body, surface in surfaces.items()
    ]
    return tuple(failures)
