"""Gravity compensation: motor torques and contact forces of a robot in static equilibrium.

`gravity_compensation` solves g(q) = J^T f + S^T tau for contact forces f in friction cones and
motor torques tau. If no such forces exist, the raised `StaticsInfeasibleError` states the reason.
Possible reasons are: friction is too low, a foot would have to pull, the centre of mass is outside
the support region, a grip is too weak, or a prescribed contact force is out of reach.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.arrays import cross_matrices
from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError, Infeasibility, StaticsInfeasibleError
from pupper_analysis.base.frozen import FrozenDict
from pupper_analysis.base.results import Result, Tabular
from pupper_analysis.base.units import EARTH_GRAVITY, EFFORT_UNIT
from pupper_analysis.robot.compliance import GroundLaw
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.joints import list_force_units
from pupper_analysis.robot.robot import Robot
from pupper_analysis.statics.cone_program import (
    BALANCE_TOLERANCE,
    MAX_TOTAL_NORMAL_FORCE,
    Balance,
    TangentialMetric,
    split_force,
)
from pupper_analysis.statics.contacts import Contacts, make_contacts_in


@dataclass(frozen=True, eq=False)
class FootLoad(Result):
    """Load of a foot: force of the ground, summed over the contact points of the foot.

    Attributes:
        force: Force of the ground in world axes, shape (3,) (N).
        centre_of_pressure: Mean of the contact points, weighted by the normal forces, in the
            world frame, shape (3,) (m). Unweighted if no contact point presses.
        friction_utilisation: Tangential force / (friction coefficient x normal force), with the
            smallest coefficient of the contact points.
    """

    force: Array = field(metadata={"unit": "N"})
    centre_of_pressure: Array = field(metadata={"unit": "m"})
    friction_utilisation: float = field(metadata={"unit": "1"})


def friction_utilisation_of(
    force: Sequence[float], normal: Sequence[float], friction: float, tiny: float
) -> float:
    """Compute the friction utilisation of a contact: tangential force / (friction x normal force).

    Args:
        force: Three components [N].
        normal: Unit vector out of the ground, in the same frame.
        friction: Friction coefficient.
        tiny: Tangential force [N] below which the utilisation is 0.

    Returns:
        Utilisation [1]. For a tangential force of ``tiny`` or more: infinite if the normal force or
        the friction coefficient is zero, otherwise negative if the contact pulls.
    """
    pressing, tangential = split_force(force, normal)
    if tangential < tiny:
        return 0.0
    largest = friction * pressing
    return tangential / largest if largest else math.inf


class FootLoads(Mapping[str, FootLoad]):
    """Mapping {foot: load}, in which each load is summed over the foot's contact points at access.

    Args:
        feet: Contact points of each foot that carry load.
        normals: Unit normal of each contact point, shape (3,), out of the ground.
        friction: Friction coefficient of each contact point.
        forces: Force of the ground on each contact point, shape (3,) [N], in world axes.
        points: Position of each contact point, shape (3,) [m], in the world frame.
        sliding: Friction utilisation of each contact point [1].
        tiny: Tangential force [N] below which the friction utilisation of a foot is 0.
    """

    def __init__(
        self,
        feet: Mapping[str, Sequence[str]],
        normals: Mapping[str, Array],
        friction: Mapping[str, float],
        forces: Mapping[str, Array],
        points: Mapping[str, Array],
        sliding: Mapping[str, float],
        tiny: float,
    ) -> None:
        self._feet, self._normals, self._friction = feet, normals, friction
        self._forces, self._points, self._sliding, self._tiny = forces, points, sliding, tiny

    def __iter__(self) -> Iterator[str]:
        return iter(self._feet)

    def __len__(self) -> int:
        return len(self._feet)

    def __getitem__(self, foot: str) -> FootLoad:
        names, forces, points = self._feet[foot], self._forces, self._points
        if len(names) == 1:
            return FootLoad(forces[names[0]], points[names[0]], self._sliding[names[0]])
        total: Array = np.sum([forces[point] for point in names], axis=0)
        normals = self._normals
        pressing = np.array([max(0.0, float(forces[point] @ normals[point])) for point in names])
        positions = np.array([points[point] for point in names])
        count = len(names)
        weights = pressing / pressing.sum() if pressing.any() else np.full(count, 1 / count)
        friction = min(self._friction[point] for point in names)
        utilisation = friction_utilisation_of(
            total.tolist(), normals[names[0]].tolist(), friction, self._tiny
        )
        return FootLoad(total, weights @ positions, utilisation)


_MIN_LOAD_RATIO = 1e-3
"""Lower bound of the normal force that enters the viscosity of a contact (`GroundLaw.viscosity`),
relative to the largest force component. The viscosity of an unloaded contact could be zero. Chosen,
not tuned."""


_MAX_VISCOSITY_ITERATIONS = 50
"""Upper bound of the iterations of ``_iterate_viscosities``. Chosen, not tuned."""


class ForceDistribution(StrEnum):
    """Criterion that selects contact forces if balance does not determine the forces.

    MIN_TANGENTIAL minimises the tangential forces, and with a much smaller weight the normal
    forces. MuJoCo's regularised friction lets feet creep until tangential forces that act against
    each other have vanished. On level ground and steps, gravity requires no tangential force, so
    that feet do not creep. The criterion is the minimum of sum f_t^2 / c, with the tangential force
    f_t and the viscosity c of each contact (`GroundLaw.viscosity`). On level ground, for example in
    a motion, all viscosities count as equal. Use these torques for a robot or a simulator.

    If a part is welded, contacts have no tangential force: the weld carries the rest of the load.
    The normal forces then minimise the sum of squared motor torques, or equal the prescribed
    forces. If parts grip and no part is welded, contacts have tangential forces only if balance
    requires tangential forces.

    MIN_TORQUE minimises the sum of squared motor torques (for equal motors, the copper losses). A
    simulator with creeping friction does not sustain the tangential forces.

    MIN_MAX_TORQUE minimises the largest motor utilisation (the largest torque if no motor has an
    effort limit), then the sum of squared utilisations. This criterion determines whether the
    motors can hold the configuration at all.
    """

    MIN_TANGENTIAL = "minimum tangential"
    MIN_TORQUE = "minimum torque"
    MIN_MAX_TORQUE = "min-max torque"


@dataclass(frozen=True, eq=False)
class Equilibrium(Tabular):
    """Static equilibrium of a robot: joint torques and contact forces that balance the load.

    Attributes:
        joint_names: Names of the joints, in actuator order.
        joint_torques: Motor torques or forces, shape (nu,) (N m or N).
        torque_units: Unit of each element of ``joint_torques``: N m for a hinge, N for a slide.
        motor_utilisation: |torque| / effort limit, shape (nu,): NaN if the limit is unknown,
            infinite for a loaded motor with a limit of zero. For dependent joints of loops: 0, or
            NaN if the limits of all motors are unknown.
        contact_forces: {contact point: (3,)} force of the ground on the contact point, in world
            axes (N).
        contact_points: {contact point: (3,)} point of application, in the world (m).
        friction_utilisation: {contact point: tangential force / (friction coefficient x normal
            force)}.
        residual_force: Norm of the residual of the force balance of the base (N).
        residual_torque: Norm of the residual of the moment balance of the base (N m).
    """

    _units_of_columns: ClassVar[dict[str, str]] = {"torque": EFFORT_UNIT, "utilisation": "1"}

    joint_names: tuple[str, ...]
    joint_torques: Array = field(metadata={"unit": EFFORT_UNIT})
    torque_units: tuple[str, ...]
    motor_utilisation: Array = field(metadata={"unit": "1"})
    contact_forces: dict[str, Array] = field(metadata={"unit": "N"})
    contact_points: dict[str, Array] = field(metadata={"unit": "m"})
    friction_utilisation: dict[str, float] = field(metadata={"unit": "1"})
    residual_force: float = field(metadata={"unit": "N"})
    residual_torque: float = field(metadata={"unit": "N m"})

    def _columns(self) -> dict[str, ArrayLike]:
        """Return {column: values} of the table of joints, torques and utilisations."""
        return {
            "joint": self.joint_names,
            "torque": self.joint_torques,
            "utilisation": self.motor_utilisation,
        }


@dataclass(frozen=True, eq=False)
class GravityCompensation(Equilibrium):
    """Static equilibrium of a robot, with the loads of feet, base and welds and the CoM margin.

    Attributes:
        foot_loads: {foot: load}. The load of a flat foot is the sum over its contact points.
        base_wrench: External wrench that holds the base, shape (6,): force in world axes (N),
            torque in base axes (N m). Zero with contacts, welds or grips; empty for a fixed base.
        weld_wrenches: {welded or gripping part: (6,)} force (N) and moment (N m), both in world
            axes. The moment is about the origin of the base's frame if the base is welded,
            otherwise about the sphere centre of the part's first contact point. The moment of a
            grip is zero.
        center_of_mass: (3,) position in the world (m).
        com_margin: Distance from the vertical projection of the CoM, or of the zero-moment point of
            a motion, to the edge of the support region (m), positive inside. Infinite with a weld;
            None without contacts, welds and grips.
    """

    foot_loads: FootLoads
    base_wrench: Array = field(metadata={"unit": "N or N m"})
    weld_wrenches: Mapping[str, Array] = field(metadata={"unit": "N or N m"})
    center_of_mass: Array = field(metadata={"unit": "m"})
    com_margin: float | None = field(metadata={"unit": "m"})


@check_arguments
def gravity_compensation(
    config: Configuration,
    contacts: Iterable[str] | None = None,
    *,
    friction: float | Mapping[str, float] | None = None,
    normals: Mapping[str, ArrayLike] | None = None,
    depths: Mapping[str, float] | None = None,
    distribution: ForceDistribution | str = ForceDistribution.MIN_TANGENTIAL,
) -> GravityCompensation:
    """Compute motor torques and contact forces in static equilibrium.

    Solves g(q) = J^T f + S^T tau. S selects the joints. J is the Jacobian of the contact points. f
    are contact forces in world axes [N]. tau are motor torques [N m, N]. g(q), shape (nv,), is the
    generalised force of gravity minus the passive forces of the MJCF, such as springs
    (`Configuration.static_load`). The six base rows determine the total wrench of f;
    ``distribution`` selects a force vector f in the friction cones. Without contacts, welds and
    grips, an external wrench holds the base, and tau is the joint part of g.

    In closed loops and couplings, joints without a motor have no torque: the constraints transfer
    the load of such joints to the motors (`Configuration.transfer_to_motors`). Passive joints
    (`Description.passive_joints`) have torques only if balance is impossible without these.

    A configuration does not contain the ground, the swing feet and the contacts of a stand:
    `stand_statics` computes the statics of a stand.

    Args:
        config: State of the robot. The velocity is ignored.
        contacts: Contact points that carry load. Default: all except points of welded or gripping
            parts, on level ground; none for a fixed base.
        friction: Friction coefficient, for all contact points or per contact point. Default:
            MuJoCo's contact.
        normals: Per contact point, a direction out of the ground, shape (3,), in the world frame.
            Default: upward.
        depths: Per contact point, penetration into the ground [m]. Default: 0. As in MuJoCo, the
            force acts at half the depth.
        distribution: Criterion that selects the contact forces among the feasible forces.

    Returns:
        Motor torques, contact forces, utilisations and residuals.

    Raises:
        UnknownNameError: If a contact point is unknown.
        ConfigurationError: If a friction coefficient, a normal, a depth or ``distribution`` is
            invalid, for example. Also if a closed loop is open, or if contact points that carry
            load by default are not on level ground (`MAX_DEFAULT_INCLINATION`).
        StaticsInfeasibleError: If no feasible forces exist. The error states the reason.
    """
    carrying = make_contacts_in(config, contacts, friction, normals, depths)
    return balance_load(config, config.static_load(), carrying, distribution=distribution)


def balance_load(
    config: Configuration,
    load: Array,
    carrying: Contacts,
    *,
    point: Array | None = None,
    distribution: ForceDistribution | str = ForceDistribution.MIN_TANGENTIAL,
    tipping: Infeasibility = Infeasibility.COM_OUTSIDE,
    held: bool = False,
) -> GravityCompensation:
    """Compute the motor torques and contact forces that produce a required generalised force.

    With ``load`` = M qacc + h this is inverse dynamics (`pupper_analysis.tools.path.dynamics`).

    Args:
        config: State of the robot.
        load: Shape (nv,) [N, N m]; generalised force that motors and contacts must produce.
        carrying: Contacts that carry load.
        point: Shape (3,) [m]; zero-moment point of a motion, in the world frame. ``com_margin`` of
            the result refers to this point. Default: the centre of mass, which is the zero-moment
            point at rest.
        distribution: Criterion that selects the contact forces among the feasible forces.
        tipping: Reason that the error states for a ``point`` outside the support region.
        held: If True, friction cones, unilateral limits and grip limits do not apply, as if the
            feet were glued to the ground. With welds or grips, some of these limits still apply.

    Raises:
        ConfigurationError: If ``distribution`` is unknown, or a closed loop is open or singular.
        StaticsInfeasibleError: If no feasible forces exist. The error states the reason.
    """
    robot, criterion = config.robot, to_distribution(distribution)
    if not (carrying.feet or carrying.fixed_parts):
        check_loops(config, load)
        motor_load = config.transfer_to_motors(load)
        return _make_statics_result(config, motor_load, motor_load, carrying, np.zeros(0))
    full_load, contacts = load, carrying.transposed_jacobian(config)
    load, transposed = config.transfer_to_motors(load), config.transfer_to_motors(contacts)
    problem = carrying.balance(transposed, load)
    friction = None if held else carrying.friction

    def distribute(problem: Balance) -> Array | None:
        """Compute contact forces (size,) [N, N m] by ``distribution``; None if infeasible."""
        if criterion is ForceDistribution.MIN_MAX_TORQUE:
            return problem.min_max_torque(friction, robot.effort_limits)
        if criterion is ForceDistribution.MIN_TORQUE:
            return problem.solve(friction, problem.joint_rows, problem.joint_load)
        return _solve_minimum_tangential(robot, problem, carrying, friction)

    forces = _distribute_with_passive_joints(robot, problem, distribute)
    if forces is None:
        point = config.center_of_mass() if point is None else point
        raise explain_infeasibility(config, point, problem, carrying, tipping)
    if robot.closure is not None:
        check_loops(config, full_load - contacts @ forces)
    remainder = load - transposed @ forces
    return _make_statics_result(config, remainder, load, carrying, forces, point)


def _distribute_with_passive_joints(
    robot: Robot, problem: Balance, distribute: Callable[[Balance], Array | None]
) -> Array | None:
    """Compute balancing contact forces, if possible without torques of passive joints.

    None if infeasible.
    """
    if robot.passive_joints:
        passive = [robot.joint_names.index(name) for name in robot.passive_joints]
        relieved = replace(
            problem,
            base_rows=np.vstack([problem.base_rows, problem.joint_rows[passive]]),
            base_load=np.concatenate([problem.base_load, problem.joint_load[passive]]),
        )
        forces = distribute(relieved)
        if forces is not None:
            return forces
    return distribute(problem)


def distribute_loads(
    config: Configuration, loads: Array, carrying: Contacts
) -> tuple[Array, Array]:
    """Compute contact forces with minimum tangential forces, and torques, for several loads.

    Args:
        config: State of a robot without closed loops.
        loads: Shape (k, nv) [N, N m]; generalised forces that motors and contacts must produce.
        carrying: Contacts that carry load.

    Returns:
        Contact forces, shape (k, n, 3) [N], in world axes; torques, shape (k, nu) [N m or N].

    Raises:
        StaticsInfeasibleError: If no feasible forces exist. The error states the reason.
    """
    transposed = config.transfer_to_motors(carrying.transposed_jacobian(config))
    forces, torques = [], []

    def distribute(problem: Balance) -> Array | None:
        """Compute forces (size,) [N, N m] by minimum tangential forces; None if infeasible."""
        return _solve_minimum_tangential(config.robot, problem, carrying, carrying.friction)

    for load in map(config.transfer_to_motors, loads):
        problem = carrying.balance(transposed, load)
        found = _distribute_with_passive_joints(config.robot, problem, distribute)
        if found is None:
            com, tipping = config.center_of_mass(), Infeasibility.COM_OUTSIDE
            raise explain_infeasibility(config, com, problem, carrying, tipping)
        forces.append(found[: carrying.normals.size].reshape(-1, 3))
        torques.append(problem.joint_load - problem.joint_rows @ found)
    return np.array(forces), np.array(torques)


_EQUAL_FORCES_RTOL = 1e-6
"""Bound of the largest difference between given contact forces and the minimum-norm forces of the
balance equations, relative to the largest component of the given forces. Beyond this bound, the
forces depend on more than the balance, for example on a friction cone. Chosen, not tuned."""


def differentiate_torques(
    config: Configuration, carrying: Contacts, forces: Array, motions: Array
) -> Array | None:
    """Compute the derivatives of the joint torques of a stand by motions of the robot.

    The contact forces have minimum tangential components.

    The contact forces f minimise |W f| subject to A f = b. W contains the weights of
    `TangentialMetric`, A is the base part of the transposed contact Jacobian J^T, and b is the base
    part of the static load l. With Lagrange multipliers m, the differential of the optimality
    conditions W^T W f = A^T m and A f = b is

        W^T W df = dA^T m + A^T dm,    A df = db - dA f.

    The derivative of the torques is the joint part of dl - dJ^T f - J^T df.

    Args:
        config: State of a robot with a free base and without closed loops, welds and grips.
        carrying: Contacts that carry load.
        forces: Contact forces of `ForceDistribution.MIN_TANGENTIAL`, shape (n, 3) [N].
        motions: Shape (nv, k). Each column is a velocity of the robot in the order of ``qvel``.
            Normals and penetrations of the contacts must be constant in these motions.

    Returns:
        Derivatives of the motor torques, shape (nu, k) [N m or N, per unit of the motion]. None if
        ``forces`` are not the unique minimum-norm forces of the balance equations, for example at
        an active friction cone.
    """
    free, metric = carrying.free, carrying.metric
    transposed = carrying.transposed_jacobian(config)
    rows = transposed[:free]
    weighted = metric.apply_inverse(metric.apply_inverse(rows.T))  # (W^T W)^-1 A^T
    try:
        inverse = np.linalg.inv(rows @ weighted)
    except np.linalg.LinAlgError:
        return None
    multipliers = inverse @ config.static_load()[:free]
    difference = np.abs(weighted @ multipliers - forces.ravel()).max()
    if not difference < _EQUAL_FORCES_RTOL * np.abs(forces).max():
        return None
    twists = config.foot_twist_jacobians(carrying.feet)
    wrenches = np.hstack([forces, np.cross(carrying.offsets, forces)])
    load_rates = config.loaded_points_derivative(twists, wrenches) @ motions  # dl - dJ^T f
    # A^T m are the velocities of the contact points if the base moves with the twist m. Motions of
    # the base change dA^T m by other twists of the base only, which dm compensates.
    spin = config.base_rotation() @ multipliers[3:]
    velocity_rates = cross_matrices(spin) @ (twists[:, :3] @ motions)
    flat_rates = velocity_rates.reshape(forces.size, -1)  # dA^T m, up to twists of the base
    multiplier_rates = inverse @ (load_rates[:free] - weighted.T @ flat_rates)
    force_rates = metric.apply_inverse(metric.apply_inverse(flat_rates))
    force_rates += weighted @ multiplier_rates
    result: Array = load_rates[free:] - transposed[free:] @ force_rates
    return result


def check_loops(config: Configuration, left: Array) -> None:
    """Check that loop and coupling constraints are satisfied, except for static deflection.

    Args:
        config: State of the robot.
        left: Generalised force that motors and loop constraints must exert together, shape (nv,)
            [N, N m]: static load minus the generalised contact forces.

    Raises:
        ConfigurationError: If a constraint violation is too large, for example (`Closure.check`).
    """
    closure, robot = config.robot.closure, config.robot
    if closure is not None:
        closure.check(config.qpos, left[robot.nv - robot.nu :])


def to_distribution(value: str) -> ForceDistribution:
    """Convert a name, for example "minimum torque", to the criterion that selects contact forces.

    Raises:
        ConfigurationError: If the name is unknown.
    """
    try:
        return ForceDistribution(value)
    except ValueError as error:
        known = [kind.value for kind in ForceDistribution]
        problem = diagnose("not-one-of", given=str(value), known=known)
        raise ConfigurationError("distribution", problem) from error


def _solve_minimum_tangential(
    robot: Robot,
    problem: Balance,
    carrying: Contacts,
    friction: Array | None,
) -> Array | None:
    """Compute the contact forces of `ForceDistribution.MIN_TANGENTIAL`, in the order of `Balance`.

    None if infeasible. With ``friction`` None, friction cones do not apply.
    """
    if carrying.fixed_parts:
        normal_only = problem.solve_normal_only()
        if normal_only is not None or not carrying.grips.size:
            return normal_only
        return problem.minimum_tangential(friction, carrying.metric)
    forces = problem.minimum_tangential(friction, carrying.metric)
    if forces is None or friction is None or not robot.contacts:
        return forces
    return _iterate_viscosities(robot, problem, forces, carrying)


def _iterate_viscosities(
    robot: Robot, problem: Balance, forces: Array, carrying: Contacts
) -> Array | None:
    """Compute contact forces with minimum tangential forces, weighted by the contacts' viscosities.

    The viscosity (tangential force / creep velocity) depends on the normal force. None if
    infeasible.
    """
    if carrying.is_level:
        return forces
    friction = carrying.friction
    scale = np.abs(forces).max()
    laws = [GroundLaw.of_contact(robot, foot) for foot in carrying.feet]
    for _ in range(_MAX_VISCOSITY_ITERATIONS):
        loads = np.maximum(problem.normal_forces(forces), _MIN_LOAD_RATIO * scale)
        viscosities = np.array(
            [law.viscosity(law.depth(load)) for law, load in zip(laws, loads, strict=True)]
        )
        if not viscosities.all():
            return forces
        metric = TangentialMetric(carrying.normals, viscosities / viscosities.mean())
        found = problem.minimum_tangential(friction, metric)
        if found is None or np.abs(found - forces).max() < BALANCE_TOLERANCE * scale:
            return found
        forces = found
    return forces


def compute_utilisation(robot: Robot, torques: Array) -> Array:
    """Compute the utilisation of each motor: |torque| / effort limit.

    Args:
        robot: Robot with effort limits, shape (nu,) [N m or N].
        torques: Shape (..., nu) [N m or N].

    Returns:
        Shape (..., nu). NaN for an unknown (infinite) limit. For a limit of zero: infinite if the
        motor is loaded, else zero.
    """
    limits, magnitudes = robot.effort_limits, np.abs(torques)
    # `errstate` takes longer than the division, and is needed only for zero and unknown limits.
    if robot.compute_once(_has_only_positive_limits):
        return magnitudes / limits
    loaded = magnitudes > MIN_TORQUE_PER_MASS * robot.total_mass
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = np.where(limits > 0, magnitudes / limits, np.where(loaded, np.inf, 0.0))
    return np.where(np.isinf(limits), np.nan, shares)


def _has_only_positive_limits(robot: Robot) -> bool:
    """Return True if all effort limits are finite and positive."""
    return bool(((robot.effort_limits > 0) & np.isfinite(robot.effort_limits)).all())


def peak_utilisation(shares: Array) -> float:
    """Return the largest known motor utilisation (|torque| / limit); NaN if all are unknown.

    Args:
        shares: Utilisations of the motors, any shape; NaN if the limit is unknown.
    """
    known = shares[~np.isnan(shares)]
    return float(known.max()) if known.size else math.nan


def find_hardest_motor(statics: Equilibrium) -> int:
    """Return the index of the motor that is loaded most, relative to its effort limit.

    The index refers to ``joint_names``. A loaded motor with a limit of zero counts as loaded most.
    Motors with an unknown limit are compared by torque.
    """
    shares, torques = statics.motor_utilisation, np.abs(statics.joint_torques)
    is_powerless, is_unknown = np.isinf(shares), np.isnan(shares)
    if is_powerless.any():
        return int(np.argmax(np.where(is_powerless, torques, -1.0)))
    hardest = int(np.argmax(np.where(is_unknown, -1.0, shares)))
    unknown_torques = np.where(is_unknown, torques, -1.0)
    if unknown_torques.max() > torques[hardest] or is_unknown[hardest]:
        return int(np.argmax(unknown_torques))
    return hardest


_NO_WELDS = FrozenDict[str, Array]()
"""Weld wrenches {part: wrench} of a robot without welds and grips; shared by all results."""


def _make_statics_result(
    config: Configuration,
    remainder: Array,
    load: Array,
    carrying: Contacts,
    forces: Array,
    point: Array | None = None,
) -> GravityCompensation:
    """Create the result of a static equilibrium from the load and the solved contact forces.

    ``remainder`` (nv,) [N, N m] is ``load`` minus the generalised force of ``forces``.
    """
    robot, free = config.robot, carrying.free
    torques = remainder[free:].copy()
    is_hanging = not (carrying.feet or carrying.fixed_parts)
    base_wrench = load[:free] if is_hanging else np.zeros(free)
    unbalanced = [0.0] * free if is_hanging else remainder[:free].tolist()
    wrenches = _read_weld_wrenches(carrying, forces[carrying.normals.size :])
    forces = forces[: carrying.normals.size].reshape(-1, 3)
    utilisation = compute_utilisation(robot, torques)
    if robot.closure is not None:  # dependent joints have no motor of their own
        dependent = np.isin(np.arange(robot.nu), robot.closure.dependent_joints)
        is_any_known = not np.isnan(utilisation[~dependent]).all()
        utilisation[dependent] = 0.0 if is_any_known else math.nan
    tiny = BALANCE_TOLERANCE * math.hypot(*load[:3].tolist())
    positions = carrying.points(config)
    com = config.center_of_mass()
    for array in (torques, base_wrench, utilisation, com, forces, positions):  # results share rows
        array.setflags(write=False)
    per_foot = FrozenDict(zip(carrying.feet, forces, strict=True))
    points = FrozenDict(zip(carrying.feet, positions, strict=True))
    contacts = forces.tolist(), carrying.normals.tolist(), carrying.friction.tolist()
    ratios = [
        friction_utilisation_of(force, normal, friction, tiny)
        for force, normal, friction in zip(*contacts, strict=True)
    ]
    sliding = FrozenDict(zip(carrying.feet, ratios, strict=True))
    zero_moment_point = com if point is None else point
    return GravityCompensation(
        joint_names=robot.joint_names,
        joint_torques=torques,
        torque_units=robot.compute_once(list_force_units),
        motor_utilisation=utilisation,
        contact_forces=per_foot,
        contact_points=points,
        friction_utilisation=sliding,
        foot_loads=FootLoads(
            carrying.soles,
            carrying.directions,
            carrying.coefficients,
            per_foot,
            points,
            sliding,
            tiny,
        ),
        base_wrench=base_wrench,
        weld_wrenches=wrenches,
        center_of_mass=com,
        com_margin=None
        if is_hanging
        else carrying.com_margin(zero_moment_point, config, positions),
        residual_force=math.hypot(*unbalanced[:3]),
        residual_torque=math.hypot(*unbalanced[3:]),
    )


def _read_weld_wrenches(carrying: Contacts, solution: Array) -> Mapping[str, Array]:
    """Return {fixed part: wrench, shape (6,) [N, N m]} from solved forces of welds and grips.

    ``solution`` contains six numbers for each weld, then three forces for each grip, whose moments
    are zero.
    """
    if not carrying.fixed_parts:
        return _NO_WELDS
    welds = solution[: solution.size - 3 * len(carrying.grips)].reshape(-1, 6)
    grips = solution[welds.size :].reshape(-1, 3)
    rows = np.vstack([welds, np.hstack([grips, 0.0 * grips])])
    rows.setflags(write=False)
    return FrozenDict(zip(carrying.fixed_parts, rows, strict=True))


_UNLIMITED_FRICTION = 1e4
"""Friction coefficient with which a contact practically cannot slide, and factor on grip limits
with which a grip practically cannot fail. Upper bound of the search for the smallest sufficient
value (`_find_threshold`). Chosen, not tuned."""


def explain_infeasibility(
    config: Configuration,
    point: Array,
    problem: Balance,
    carrying: Contacts,
    tipping: Infeasibility,
) -> StaticsInfeasibleError:
    """Create the error that states why no contact forces can balance the robot.

    Args:
        config: State of the robot.
        point: Shape (3,) [m]; centre of mass or zero-moment point.
        problem: Equations of balance.
        carrying: Contacts that carry load.
        tipping: Reason that the error states for a ``point`` outside the support region.
    """
    if (error := _explain_stated_force(problem, carrying)) is not None:
        return error
    if (error := _explain_weak_grip(problem, carrying)) is not None:
        return error
    feet, friction = carrying.feet, float(carrying.friction.min(initial=math.inf))
    margin = carrying.com_margin(point, config, carrying.points(config))
    metric = carrying.metric
    if problem.minimum_tangential(np.full(len(feet), _UNLIMITED_FRICTION), metric) is not None:
        needed = _find_threshold(
            lambda mu: problem.minimum_tangential(np.full(len(feet), mu), metric) is not None
        )
        return StaticsInfeasibleError(
            Infeasibility.FRICTION,
            diagnose("friction-too-low", least=friction, needed=_round_up(needed)),
            margin=margin,
            friction_needed=needed,
            feet=feet,
        )
    bilateral = np.linalg.lstsq(problem.base_rows, problem.base_load, rcond=1e-12)[0]
    bilateral = bilateral[: carrying.normals.size].reshape(-1, 3)
    pulls = {
        foot: float(force @ normal)
        for foot, force, normal in zip(feet, bilateral, problem.normals, strict=True)
        if force @ normal < 0
    }
    pulling = [
        diagnose("foot-pulls", subject=("foot", foot), force=Quantity(-force, "N"))
        for foot, force in pulls.items()
    ]
    if -math.inf < margin < 0:
        outside = Quantity(-margin, "m")
        detail = diagnose("com-outside-polygon", outside=outside, feet=feet, pulls=pulling)
        return StaticsInfeasibleError(tipping, detail, margin=margin, feet=pulls or feet)
    detail = diagnose("feet-would-pull", feet=pulling or feet)
    return StaticsInfeasibleError(Infeasibility.PULL, detail, margin=margin, feet=pulls or feet)


def _find_threshold(holds: Callable[[float], bool]) -> float:
    """Find the smallest number up to `_UNLIMITED_FRICTION` for which a monotone condition holds.

    The relative tolerance is 1e-6; numbers below 1e-6 are not resolved.
    """
    low, high = 0.0, _UNLIMITED_FRICTION
    while high - low > 1e-6 * high and high >= 1e-6:
        middle = (low * high) ** 0.5 if low > 0 else high / 2
        low, high = (low, middle) if holds(middle) else (middle, high)
    return high


def _round_up(minimum: float) -> float:
    """Round a number up to three decimals, so that a user may enter the printed minimum."""
    return math.ceil(1e3 * minimum) / 1e3


def _explain_weak_grip(problem: Balance, carrying: Contacts) -> StaticsInfeasibleError | None:
    """Create the error that grips are too weak; None if larger grip limits do not help."""

    def holds(factor: float) -> bool:
        """Return True if contact forces balance the robot with ``factor`` times the grip limits."""
        stronger = replace(problem, grips=factor * problem.grips)
        return stronger.minimum_tangential(carrying.friction, carrying.metric) is not None

    if not carrying.grips.size or not holds(_UNLIMITED_FRICTION):
        return None
    names, factor = [*carrying.fixed_parts][-len(carrying.grips) :], _find_threshold(holds)
    needed = [
        diagnose("grip-needs", name=name, force=Quantity(_round_up(factor * grip), "N"))
        for name, grip in zip(names, carrying.grips.tolist(), strict=True)
    ]
    detail = diagnose("grip-too-weak", grips=needed)
    return StaticsInfeasibleError(Infeasibility.GRIP, detail, margin=math.nan, feet=tuple(names))


def _explain_stated_force(problem: Balance, carrying: Contacts) -> StaticsInfeasibleError | None:
    """Create the error that a prescribed contact force is infeasible, with the feasible range [N].

    None if no prescribed force is found to be out of range.
    """
    if carrying.stated is None:
        return None
    free, size = carrying.free, carrying.normals.size
    unstated = replace(
        problem, base_rows=problem.base_rows[:free], base_load=problem.base_load[:free]
    )
    upper = np.array([MAX_TOTAL_NORMAL_FORCE * carrying.weight])
    if unstated.minimum_tangential(carrying.friction, carrying.metric) is None:
        return None
    total_normal = carrying.normals.reshape(1, -1)
    for row, group, force in zip(
        problem.base_rows[free:, :size],
        carrying.stated[0],
        problem.base_load[free:],
        strict=True,
    ):
        extremes = [
            unstated.maximize(sign * row, carrying.friction, total_normal, upper)
            for sign in (-1, 1)
        ]
        low, high = (math.nan if end is None else float(row @ end) for end in extremes)
        if force > high or force < low:
            feet = tuple(foot for foot, member in zip(carrying.feet, group, strict=True) if member)
            detail = diagnose(
                "stated-force-out-of-reach",
                feet=feet,
                force=Quantity(force, "N"),
                least=Quantity(_round_up(max(low - 1e-6, 0.0)), "N"),  # rounding
                most=Quantity(-_round_up((_REPORTED_FORCE_MARGIN - 1) * high), "N"),
            )
            return StaticsInfeasibleError(Infeasibility.PULL, detail, margin=math.nan, feet=feet)
    return None


_REPORTED_FORCE_MARGIN = 1e-3
"""Relative reduction of the largest feasible force in an error message, so that the printed force
is accepted if a user enters it. Chosen, not tuned."""

UNLIMITED_MASS_RATIO = 1e4
"""Ratio of payload mass to `compute_reference_mass` above which a payload counts as unlimited. The
lever arm of a motor that limits such a payload may be a rounding error. Chosen, not tuned."""


def compute_reference_mass(robot: Robot) -> float:
    """Compute the mass [kg] to which payloads are compared.

    The larger of the robot's mass and the mass that the strongest motor with a known limit holds at
    a lever arm of 1 m. The second mass matters for placeholder masses: a robot of 1e-9 kg with
    motors of 150 N m has a payload of some kilograms.
    """
    limits = robot.effort_limits[np.isfinite(robot.effort_limits)]
    return max(robot.total_mass, float(limits.max(initial=0.0)) / EARTH_GRAVITY)


MIN_TORQUE_PER_MASS = 1e-9
"""Torque per mass of robot or payload [N m/kg] up to which a motor or passive joint counts as not
loaded, since the lever arm is a rounding error. Chosen, not tuned."""


def find_mass_limit(torques: Array, rates: Array, limits: Array) -> float:
    """Compute the payload mass m at which the first motor reaches its effort limit.

    The torques are torques + m rates, and the limits +-``limits``. For each motor, the limit with
    the sign of the rate is evaluated; motors whose torque does not depend on the mass are ignored.

    Args:
        torques: Shape (nu,) [N m or N]; motor torques or forces without payload.
        rates: Shape (nu,) [N m/kg or N/kg]; torque or force per payload mass. Values up to
            `MIN_TORQUE_PER_MASS` in magnitude count as zero.
        limits: Shape (nu,) [N m or N]; effort limits; infinite if unknown.

    Returns:
        Mass [kg]; 0 if a motor reaches the evaluated limit without payload, infinite if no motor
        limits the mass.
    """
    rates = np.where(np.abs(rates) > MIN_TORQUE_PER_MASS, rates, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        slack = (np.copysign(limits, rates) - torques) / rates
    return float(np.min(np.where(np.isfinite(slack), np.maximum(slack, 0.0), math.inf)))
