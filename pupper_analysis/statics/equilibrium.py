"""What the motors hold: gravity compensation of a standing, or hanging, robot.

And what the ground does to each foot; or why no contact forces hold it: motors, friction, or feet
that would have to pull.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError, Infeasibility, StaticsInfeasibleError
from pupper_analysis.base.frozen import FrozenDict
from pupper_analysis.base.results import Result, Tabular
from pupper_analysis.robot.compliance import GroundLaw
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.statics.cone_program import BALANCE_TOLERANCE, Balance, TangentialMetric
from pupper_analysis.statics.contacts import Contacts, make_contacts

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FootLoad(Result):
    """What the ground does to one foot, over all its contact points.

    Attributes:
        force: (3,) in world axes (N).
        centre_of_pressure: (3,) where the normal forces act together, in the world (m).
        friction_utilisation: Tangential force / (friction coefficient x normal force).
    """

    force: Array = field(metadata={"unit": "N"})
    centre_of_pressure: Array = field(metadata={"unit": "m"})
    friction_utilisation: float = field(metadata={"unit": "1"})


def sliding_share(
    force: Sequence[float], normal: Sequence[float], friction: float, tiny: float
) -> float:
    """Returns tangential force / (friction x normal force), 0 where the former is ``tiny`` (N)."""
    (x, y, z), (a, b, c) = force, normal
    pressing = x * a + y * b + z * c
    tangential = math.hypot(x - pressing * a, y - pressing * b, z - pressing * c)
    return 0.0 if tangential < tiny else tangential / (friction * pressing)


class FootLoads(Mapping[str, FootLoad]):
    """{foot: its load}, added up when it is asked for: who looks for torques needs none.

    Args:
        feet: {foot: its contact points that carry}.
        normals: {contact point: (3,) out of the ground}.
        friction: {contact point: its coefficient}.
        forces: {contact point: (3,) of the ground, in world axes (N)}.
        points: {contact point: (3,) in the world (m)}.
        sliding: {contact point: see ``sliding_share``}.
        tiny: Tangential force that counts as none (N).
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
        own, forces, points = self._feet[foot], self._forces, self._points
        if len(own) == 1:
            return FootLoad(forces[own[0]], points[own[0]], self._sliding[own[0]])
        total: Array = np.sum([forces[point] for point in own], axis=0)
        normals = self._normals
        pressing = np.array([max(0.0, float(forces[point] @ normals[point])) for point in own])
        places = np.array([points[point] for point in own])
        weights = pressing / pressing.sum() if pressing.any() else np.full(len(own), 1 / len(own))
        least = min(self._friction[point] for point in own)
        share = sliding_share(total.tolist(), normals[own[0]].tolist(), least, self._tiny)
        return FootLoad(total, weights @ places, share)


_LIGHTEST = 1e-3
"""Share of the largest force below which a foot's viscosity is not looked at."""


_MAX_ITERATIONS = 50


class ForceDistribution(StrEnum):
    """Which of the feasible contact forces is meant, where balance leaves a choice.

    MIN_TANGENTIAL has the least tangential forces, and of those that remain the least sum of
    squared normal forces: how the feet share the load on ground that is equally soft under each.
    These are what MuJoCo holds for good, because its regularised friction lets feet creep against
    each other until no tangential force is left that they can get rid of: none on level ground and
    steps, and on a slope those with which all feet creep down it together. (The least sum of
    f_t^2 / c, with c the viscosity of ``GroundLaw``: its optimality condition is
    f_t = c (v + omega x r).) It is what to send to a robot or a simulator.
    Beside a weld, which bears whatever is left, no contact needs a tangential force, and none
    lasts: contacts press along their normals alone, with what costs the least sum of squared motor
    torques, or with the force that is stated.
    MIN_TORQUE has the least sum of squared motor torques, and so the least heat. It needs feet
    that press against each other for good, which a simulator's creeping friction does not bear.
    MIN_MAX_TORQUE has the least peak motor utilisation (peak torque, where no motor has an effort
    limit), and of those the least sum of squared utilisations: whether the motors can hold it at
    all.
    """

    MIN_TANGENTIAL = "minimum tangential"
    MIN_TORQUE = "minimum torque"
    MIN_MAX_TORQUE = "min-max torque"


@dataclass(frozen=True, eq=False)
class Equilibrium(Tabular):
    """What motors and ground hold together.

    Attributes:
        joint_names: Names of the joints, in actuator order.
        joint_torques: (nu,) what the motors hold (N m).
        motor_utilisation: (nu,) torque / effort limit, absolute.
        contact_forces: {foot: (3,)} force of the ground on the foot, in world axes (N).
        contact_points: {foot: (3,)} where it acts, in the world (m).
        friction_utilisation: {foot: tangential force / (friction coefficient x normal force)}.
        residual_force: Norm of what is left of the balance of forces (N).
        residual_torque: Norm of what is left of the balance of moments and joint torques (N m).
    """

    joint_names: tuple[str, ...]
    joint_torques: Array = field(metadata={"unit": "N m"})
    motor_utilisation: Array = field(metadata={"unit": "1"})
    contact_forces: dict[str, Array] = field(metadata={"unit": "N"})
    contact_points: dict[str, Array] = field(metadata={"unit": "m"})
    friction_utilisation: dict[str, float] = field(metadata={"unit": "1"})
    residual_force: float = field(metadata={"unit": "N"})
    residual_torque: float = field(metadata={"unit": "N m"})

    def _columns(self) -> dict[str, ArrayLike]:
        return {
            "joint": self.joint_names,
            "torque": self.joint_torques,
            "utilisation": self.motor_utilisation,
        }


@dataclass(frozen=True, eq=False)
class GravityCompensation(Equilibrium):
    """The static equilibrium of a robot: an ``Equilibrium``, and how it stands in it.

    Attributes:
        foot_loads: {foot: its load}; of a flat foot, the sum over its contact points.
        base_wrench: (6,) what holds the base from outside: force in world axes (N), torque in base
            axes (N m). Zero for a standing robot.
        weld_wrenches: {what is welded to the world: (6,)} force (N), and moment (N m) about the
            base's frame, a foot's centre or the welded point, both in world axes; of a grip no
            moment.
        center_of_mass: (3,) in the world (m).
        com_margin: Distance from the com's vertical projection to the edge of the support polygon
            (m), positive inside; None without contacts.
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
    """Computes motor torques and contact forces that hold a robot still.

    With S selecting the joints and J the Jacobians of the contact points, balance means
    g(q) = J^T f + S^T tau, with g less what springs and gravity compensation of the MJCF do
    (``Configuration.load``). Its six base rows fix the total wrench of the contact forces f; among
    the f inside the friction cones that give it, ``distribution`` chooses one. (Without contacts
    the base is held from outside, and tau is the joint part of g.)

    The problem is a second-order cone programme in the coordinates of the null space of the base
    rows, so that balance holds to rounding whatever the solver's tolerance.

    Args:
        config: Where the robot is. Its velocity does not matter.
        contacts: The feet that carry; all by default, none for a fixed base.
        friction: Friction coefficient, for all or per foot; by default that of MuJoCo's contact.
        normals: Per foot, the direction (3,) in the world out of the ground; up where not given.
        depths: Per foot, how deep it has sunk into the ground (m), 0 where not given. The force
            acts half way, as MuJoCo has it.
        distribution: Which of the feasible forces: by default those that last.

    Returns:
        The equilibrium.

    Raises:
        UnknownNameError: If a foot is unknown.
        ConfigurationError: If a friction coefficient, a normal or ``distribution`` is no such
            thing, or a robot with a fixed base is given contacts.
        StaticsInfeasibleError: If no forces do; it says why.
    """
    carrying = make_contacts(config.robot, contacts, friction, normals, depths)
    return balance_load(config, config.load(), carrying, distribution=distribution)


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
    """Balances any generalised force, as ``gravity_compensation`` balances gravity.

    With M qacc + h for g it is inverse dynamics (``pupper_analysis.tools.path.dynamics``).

    Args:
        config: Where the robot is.
        load: (nv,) what motors and contacts must add up to (N, N m).
        carrying: The contacts that carry.
        point: (3,) whose vertical projection must be inside the support polygon: the com, as at
            rest, if not given; the zero-moment point in motion (m). ``com_margin`` is this point's.
        distribution: As in ``gravity_compensation``.
        tipping: What it is called if ``point`` is outside the polygon.
        held: Let feet pull and slip, as if they were held to the ground: what the motion would
            need, feasible or not.

    Raises:
        UnknownNameError: As ``gravity_compensation``; so are the other two.
        ConfigurationError: Likewise.
        StaticsInfeasibleError: Likewise.
    """
    robot, wanted = config.robot, to_distribution(distribution)
    if not (carrying.feet or carrying.welds):
        check_loops(config, load)
        borne = config.by_motors(load)
        return _result(config, borne, borne, carrying, np.zeros(0))
    given, contacts = load, carrying.jacobian(config)
    load, transposed = config.by_motors(load), config.by_motors(contacts)
    problem = carrying.balance(transposed, load)
    limits = None if held else carrying.friction
    if wanted is ForceDistribution.MIN_MAX_TORQUE:
        forces = problem.min_max_torque(limits, robot.effort_limits)
    elif wanted is ForceDistribution.MIN_TORQUE:
        forces = problem.solve(limits, problem.joints, problem.torques)
    else:
        forces = _lasting(robot, problem, carrying, limits)
    if forces is None:
        point = config.center_of_mass() if point is None else point
        raise explain_infeasibility(config, point, problem, carrying, tipping)
    if robot.closure is not None:
        check_loops(config, given - contacts @ forces)
    left = load - transposed @ forces
    return _result(config, left, load, carrying, forces, point)


def hold_loads(config: Configuration, loads: Array, carrying: Contacts) -> tuple[Array, Array]:
    """Balances several generalised forces, as ``balance_load`` does, and tells no more than how.

    Args:
        config: Where the robot, a tree, is.
        loads: (k, nv) what motors and contacts must add up to (N, N m).
        carrying: The contacts that carry.

    Returns:
        The contact forces that last (k, n, 3) (N), in the world, and torques (k, nu) (N m).

    Raises:
        StaticsInfeasibleError: If no forces do; it says why.
    """
    transposed = config.by_motors(carrying.jacobian(config))
    forces, torques = [], []
    for load in map(config.by_motors, loads):
        problem = carrying.balance(transposed, load)
        found = _lasting(config.robot, problem, carrying, carrying.friction)
        if found is None:
            com, tipping = config.center_of_mass(), Infeasibility.COM_OUTSIDE
            raise explain_infeasibility(config, com, problem, carrying, tipping)
        forces.append(found[: carrying.normals.size].reshape(-1, 3))
        torques.append(problem.torques - problem.joints @ found)
    return np.array(forces), np.array(torques)


def check_loops(config: Configuration, left: Array) -> None:
    """Checks that closed loops and couplings of joints are closed, but for what they give way.

    Args:
        config: Where the robot is.
        left: (nv,) what contacts leave to motors and loops (N, N m).

    Raises:
        ConfigurationError: If they are open.
    """
    closure, robot = config.robot.closure, config.robot
    if closure is not None:
        closure.check(config.qpos, left[robot.nv - robot.nu :])


def to_distribution(value: str) -> ForceDistribution:
    """Returns the distribution of a name.

    Raises:
        ConfigurationError: If it is none.
    """
    try:
        return ForceDistribution(value)
    except ValueError as error:
        known = [kind.value for kind in ForceDistribution]
        problem = diagnose("not-one-of", given=str(value), known=known)
        raise ConfigurationError("distribution", problem) from error


def _lasting(
    robot: Robot,
    problem: Balance,
    carrying: Contacts,
    friction: Array | None,
) -> Array | None:
    """Finds the minimum-tangential forces (3 n,): those that last; see ``_creeping``."""
    if carrying.welds:
        pressing = problem.pressing()
        if pressing is not None or not carrying.grips.size:
            return pressing
        return problem.minimum_tangential(friction, carrying.metric)
    forces = problem.minimum_tangential(friction, carrying.metric)
    if forces is None or friction is None or not robot.contacts:
        return forces
    return _creeping(robot, problem, forces, carrying)


def _creeping(robot: Robot, problem: Balance, forces: Array, carrying: Contacts) -> Array | None:
    """Finds the minimum-tangential forces (3 n,) for the viscosities that they themselves give."""
    if carrying.level:
        return forces  # nothing creeps
    friction = carrying.friction
    scale = np.abs(forces).max()
    laws = [GroundLaw.of(robot, foot) for foot in carrying.feet]
    for _ in range(_MAX_ITERATIONS):
        loads = np.maximum(problem.normal_forces(forces), _LIGHTEST * scale)
        grip = np.array(
            [law.viscosity(law.depth(load)) for law, load in zip(laws, loads, strict=True)]
        )
        if not grip.all():
            return forces  # without friction there is no creep
        metric = TangentialMetric(carrying.normals, grip / grip.mean())
        found = problem.minimum_tangential(friction, metric)
        if found is None or np.abs(found - forces).max() < BALANCE_TOLERANCE * scale:
            return found
        forces = found
    return forces


def utilise(robot: Robot, torques: Array) -> Array:
    """Returns torques (..., nu) in parts of what each motor can give, absolute.

    Infinite where that is nothing, and not a number if nothing is asked of it.
    """
    limits, asked = robot.effort_limits, np.abs(torques)
    # As a rule none is nothing, and to keep NumPy silent takes longer than to divide.
    if robot.once(_all_are_strong):
        return asked / limits
    with np.errstate(divide="ignore", invalid="ignore"):
        return asked / limits


def _all_are_strong(robot: Robot) -> bool:
    return bool(robot.effort_limits.all())


_UNWELDED = FrozenDict[str, Array]()


def _result(
    config: Configuration,
    left: Array,
    load: Array,
    carrying: Contacts,
    forces: Array,
    point: Array | None = None,
) -> GravityCompensation:
    """Combines what the contacts' forces (3 n + 6 w,) leave of a load to the motors.

    Without contacts, what is left on the base is what holds it from outside.
    """
    robot, free = config.robot, carrying.free
    torques = left[free:].copy()
    held = not (carrying.feet or carrying.welds)
    base_wrench = load[:free] if held else np.zeros(free)
    unbalanced = [0.0] * free if held else left[:free].tolist()
    wrenches: Mapping[str, Array] = _UNWELDED
    if carrying.welds:
        borne = forces[carrying.normals.size :]
        fixed = borne[: borne.size - 3 * len(carrying.grips)].reshape(-1, 6)
        pulls = borne[fixed.size :].reshape(-1, 3)
        rows = np.vstack([fixed, np.hstack([pulls, 0.0 * pulls])])
        rows.setflags(write=False)
        wrenches = FrozenDict(zip(carrying.welds, rows, strict=True))
        forces = forces[: carrying.normals.size]
    forces = forces.reshape(-1, 3)
    utilisation = utilise(robot, torques)
    if robot.closure is not None:
        utilisation[robot.closure.following] = 0.0  # whatever the URDF says of their motors
    tiny = BALANCE_TOLERANCE * math.hypot(*load[:3].tolist())
    places = carrying.points(config)
    com = config.center_of_mass()
    for own in (torques, base_wrench, utilisation, com, forces, places):  # rows are shared
        own.setflags(write=False)
    per_foot = FrozenDict(zip(carrying.feet, forces, strict=True))
    points = FrozenDict(zip(carrying.feet, places, strict=True))
    contacts = forces.tolist(), carrying.normals.tolist(), carrying.friction.tolist()
    shares = [
        sliding_share(force, normal, grip, tiny)
        for force, normal, grip in zip(*contacts, strict=True)
    ]
    sliding = FrozenDict(zip(carrying.feet, shares, strict=True))
    over = com if point is None else point
    return GravityCompensation(
        joint_names=robot.joint_names,
        joint_torques=torques,
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
        com_margin=None if held else carrying.com_margin(over, config, places),
        residual_force=math.hypot(*unbalanced[:3]),
        residual_torque=math.hypot(*unbalanced[3:]),
    )


_NO_SLIDING = 1e4
"""A friction coefficient that stands for a foot that cannot slide."""


def explain_infeasibility(
    config: Configuration,
    point: Array,
    problem: Balance,
    carrying: Contacts,
    tipping: Infeasibility,
) -> StaticsInfeasibleError:
    """Finds out why no forces do; see ``balance_load``."""
    if (stated := _tell_stated(problem, carrying)) is not None:
        return stated
    if (weak := _tell_weak_grip(problem, carrying)) is not None:
        return weak
    feet, friction = carrying.feet, float(carrying.friction.min(initial=math.inf))
    margin = carrying.com_margin(point, config, carrying.points(config))
    even = carrying.metric
    if problem.minimum_tangential(np.full(len(feet), _NO_SLIDING), even) is not None:
        high = _least(
            lambda mu: problem.minimum_tangential(np.full(len(feet), mu), even) is not None
        )
        return StaticsInfeasibleError(
            Infeasibility.FRICTION,
            diagnose("friction-too-low", least=friction, needed=_up(high)),
            margin=margin,
            friction_needed=high,
            feet=feet,
        )
    bilateral = np.linalg.lstsq(problem.base, problem.weight, rcond=1e-12)[0]
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


def _least(holds: Callable[[float], bool]) -> float:
    """Returns from which number on something holds, which it does at ``_NO_SLIDING``."""
    low, high = 0.0, _NO_SLIDING
    while high - low > 1e-6 * high and high >= 1e-6:
        middle = (low * high) ** 0.5 if low > 0 else high / 2
        low, high = (low, middle) if holds(middle) else (middle, high)
    return high


def _up(least: float) -> float:
    """Returns what is stated of a least number: typed back, it is no less."""
    return math.ceil(1e3 * least) / 1e3


def _tell_weak_grip(problem: Balance, carrying: Contacts) -> StaticsInfeasibleError | None:
    """Returns that grips are too weak, all in the same proportion, if that is why."""

    def holds(times: float) -> bool:
        stronger = replace(problem, grips=times * problem.grips)
        return stronger.minimum_tangential(carrying.friction, carrying.metric) is not None

    if not carrying.grips.size or not holds(_NO_SLIDING):
        return None
    names, times = [*carrying.welds][-len(carrying.grips) :], _least(holds)
    needed = [
        diagnose("grip-needs", name=name, force=Quantity(_up(times * grip), "N"))
        for name, grip in zip(names, carrying.grips.tolist(), strict=True)
    ]
    detail = diagnose("grip-too-weak", grips=needed)
    return StaticsInfeasibleError(Infeasibility.GRIP, detail, margin=math.nan, feet=tuple(names))


def _tell_stated(problem: Balance, carrying: Contacts) -> StaticsInfeasibleError | None:
    """Returns that a force which is stated is out of reach, and which is not, if that is why."""
    if carrying.stated is None:
        return None
    free, size = carrying.free, carrying.normals.size
    loose = replace(problem, base=problem.base[:free], weight=problem.weight[:free])
    most = np.array([_HARDEST * carrying.weight])
    if loose.minimum_tangential(carrying.friction, carrying.metric) is None:
        return None
    for pressing, together, force in zip(
        problem.base[free:, :size], carrying.stated[0], problem.weight[free:], strict=True
    ):
        ends = [
            loose.farthest(way * pressing, carrying.friction, carrying.normals.reshape(1, -1), most)
            for way in (-1, 1)
        ]
        low, high = (math.nan if end is None else float(pressing @ end) for end in ends)
        if force > high or force < low:
            feet = tuple(foot for foot, own in zip(carrying.feet, together, strict=True) if own)
            detail = diagnose(
                "stated-force-out-of-reach",
                feet=feet,
                force=Quantity(force, "N"),
                least=Quantity(_up(max(low - 1e-6, 0.0)), "N"),  # rounding
                most=Quantity(-_up((_EDGE - 1) * high), "N"),
            )
            return StaticsInfeasibleError(Infeasibility.PULL, detail, margin=math.nan, feet=feet)
    return None


_EDGE = 1e-3
"""Share of a stated force that is left, as corners of where a com is in balance are so near."""

_HARDEST = 10.0
"""Weights with which contacts may press in all where a stated force is out of reach."""

IDLE = 1e-9
"""N m/kg: what bears less of a mass has no lever to it but rounding."""


def borne_by_motors(torques: Array, rates: Array, limits: Array) -> float:
    """Returns the greatest mass m with |torques + m rates| <= limits; 0 if none has (kg, N m)."""
    rates = np.where(np.abs(rates) > IDLE, rates, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        room = (np.copysign(limits, rates) - torques) / rates
    return float(np.min(np.where(np.isfinite(room), np.maximum(room, 0.0), math.inf)))
