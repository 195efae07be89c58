"""How much a standing robot can carry, and what gives way first: motors, servos or contacts."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.arguments import check_arguments
from pupper_analysis.diagnostics import diagnose
from pupper_analysis.errors import ConfigurationError, StaticsInfeasibleError
from pupper_analysis.results import Result
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.payload import with_payload
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.tool import Place, Tool, find_place
from pupper_analysis.stance.payload.first_order import Loads
from pupper_analysis.stance.payload.servo_limit import (
    RESOLUTION,
    Bound,
    Failure,
    PayloadCommand,
    find_first_failing,
    servo_limit,
)
from pupper_analysis.stance.payload.sharing import Sharing, share_load
from pupper_analysis.stance.stand import Stand, stand_statics
from pupper_analysis.statics.contacts import make_contacts
from pupper_analysis.statics.equilibrium import ForceDistribution, GravityCompensation

Array = NDArray[np.float64]

UNLIMITED = 1e4
"""A payload above this many times the robot's mass is as good as unlimited."""

_NOTHING = 1e-4
"""A foot that carries less may carry nothing: in weights. The cone programme leaves 1e-5."""

AT_LIMIT = 1e-9
"""How far above its limit a torque counts as at it, in parts of the torque of the robot's weight on
a lever as long as the stand is high: rounding."""


@dataclass(frozen=True, eq=False)
class PayloadLimit(Result):
    """The greatest mass that a stand can carry at a point.

    Attributes:
        mass: kg; the least of the three that follow.
        binding: Which of them it is: ``motors``, ``servos`` or ``contacts``.
        motors: What the motors' effort limits allow, with the contact forces that last
            (``ForceDistribution.MIN_TANGENTIAL``); infinite if no motor that bears has one.
        servos: What position servos of finite stiffness hold on soft ground: the equilibrium under
            the load is there, is stable, and nothing slips, lifts, saturates, comes to a joint's
            limit or to the ground.
        contacts: What friction and unilateral contact allow, whatever the motors do.
        point: (3,) where the mass is attached, in the frame of ``link`` (m).
        link: Of the URDF, that carries it.
        shared: What the motors would allow if the legs shared the load as these can, and were
            commanded so: more than ``motors`` on more than three feet, whose shares there are the
            ground's. None on a slope.
        command: What the servos are commanded.
        unlimited: The motors without an effort limit: they say nothing about a payload.
        joint_torques: (nu,) at ``mass``, with the contact forces that last (N m).
        contact_forces: {foot: (3,)} of these, in world axes (N).
    """

    mass: float
    binding: str
    motors: Bound
    servos: Bound
    contacts: Bound
    shared: Sharing | None
    point: Array
    link: str
    command: PayloadCommand
    unlimited: tuple[str, ...]
    joint_torques: Array
    contact_forces: dict[str, Array]

    @property
    def bound(self) -> Bound:
        """The bound that binds."""
        bounds = {"motors": self.motors, "servos": self.servos, "contacts": self.contacts}
        return bounds[self.binding]

    @property
    def failure(self) -> Failure:
        """What gives way first."""
        return self.bound.failure

    @property
    def where(self) -> tuple[str, ...]:
        """The motors, joints, feet or bodies concerned."""
        return self.bound.where


@check_arguments
def payload_limit(
    robot: Robot,
    stand: Stand,
    point: Place = (0.0, 0.0, 0.0),
    *,
    command: PayloadCommand = PayloadCommand.LOADED,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
) -> PayloadLimit:
    """Finds the greatest point mass that a robot can carry in a stand.

    Three numbers, of which the least is the limit: what the motors give, what the servos' stiffness
    holds up, and what the contacts bear. The first and the last are of the stand as it is, on
    ground as soft as its ``depths`` say; the second is of MuJoCo's soft ground, into which feet
    sink deeper under the load.

    The default command is the pose with the feed-forward torques of the *loaded* robot: "how much
    can it carry" asks for what the robot bears, standing as asked, and not for how well a
    controller guesses. With ``PayloadCommand.UNLOADED`` the mass is a surprise, and servos give way
    to it.

    Args:
        robot: The robot.
        stand: How it stands, without payload.
        point: Where the mass is, as in ``with_payload``.
        command: What the servos are commanded.
        kp: Servo stiffness (N m/rad), one or (nu,); the model's own by default.
        kd: Servo damping (N m s/rad), one or (nu,); the model's own by default, none where its
            motors are no servos. It takes part of what a nudge asks of them.

    Returns:
        The limit. ``simulate_payload`` simulates it.

    Raises:
        ConfigurationError: If an argument is out of its range, or the robot cannot stand.
        ModelError: If the model has no position servos, and no kp is given.
        StaticsInfeasibleError: If the stand cannot be held without payload.
    """
    robot.check_tree("a payload")
    place = find_place(robot, point)
    try:
        command = PayloadCommand(command)
    except ValueError as error:
        told = diagnose("none-of", value=command, known=PayloadCommand)
        raise ConfigurationError("command", told) from error
    stand_statics(robot, stand, distribution=ForceDistribution.MIN_TANGENTIAL)
    contacts = contact_limit(robot, stand, place)
    motors = motor_limit(robot, stand, place, most=contacts.mass)
    most = min(motors.mass, contacts.mass)
    servos = servo_limit(robot, stand, place, command=command, kp=kp, kd=kd, most=most)
    bounds = {"motors": motors, "servos": servos, "contacts": contacts}
    binding = min(bounds, key=lambda name: bounds[name].mass)
    mass = bounds[binding].mass
    # At the edge of what the contacts bear rounding may leave no forces: just inside there are.
    finite = mass if math.isfinite(mass) else 0.0
    held = _even(robot, stand, place, finite) or _even(robot, stand, place, (1 - 1e-6) * finite)
    assert held is not None
    return PayloadLimit(
        mass=mass,
        binding=binding,
        motors=motors,
        servos=servos,
        contacts=contacts,
        shared=share_load(robot, stand, place),
        point=place.offset,
        link=place.link,
        command=command,
        unlimited=tuple(
            name
            for name, limit in zip(robot.joint_names, robot.effort_limits, strict=True)
            if not math.isfinite(limit)
        ),
        joint_torques=held.joint_torques,
        contact_forces=held.contact_forces,
    )


def motor_limit(robot: Robot, stand: Stand, point: Place, *, most: float = math.inf) -> Bound:
    """Finds the greatest payload that the motors hold with the contact forces that last.

    On level ground these forces are linear in the mass for as long as every stance foot goes on
    carrying, and so are the torques: two equilibria give the limit in closed form. Where a foot
    unloads, or on a slope, where the forces depend on the feet's viscosities, the first mass at
    which a motor saturates is bracketed and then bisected.

    Args:
        robot: The robot.
        stand: How it stands, without payload.
        point: Where the mass is, as in ``with_payload``.
        most: What the contacts bear (kg); nothing above is looked at.

    Returns:
        The limit: infinite if the motors that bear have no effort limits, or hold all up to
        ``most``.

    Raises:
        StaticsInfeasibleError: If the stand cannot be held without payload.
    """
    robot.check_tree("a payload")
    limits = robot.effort_limits
    if not np.isfinite(limits).any():
        return Bound(math.inf, Failure.NOTHING, ())
    weight = robot.total_mass * float(np.linalg.norm(robot.gravity))
    slack = AT_LIMIT * weight * float(stand.task.height or robot.stand_height)

    def excess(held: GravityCompensation | None) -> Array:
        """Returns torque above the limit (nu,), not divided by it: a limit may be zero."""
        assert held is not None
        over: Array = np.abs(held.joint_torques) - limits - slack
        return over

    def at(mass: float) -> Array | None:
        held = _even(robot, stand, point, mass)
        return None if held is None else excess(held)

    empty = stand_statics(robot, stand, distribution=ForceDistribution.MIN_TANGENTIAL)
    over = excess(empty)
    if (over > 0).any():
        return Bound(0.0, Failure.MOTOR, _names(robot, over > 0))
    ceiling = min(most, UNLIMITED * robot.total_mass)
    mass = _by_line(robot, stand, find_place(robot, point))
    if mass is None:
        mass = find_first_failing(
            lambda tried: (found := at(tried)) is not None and bool((found > 0).any()),
            robot.total_mass,
            ceiling,
        )
    if mass >= ceiling:
        return Bound(math.inf, Failure.NOTHING, ())
    over = excess(_even(robot, stand, point, mass))
    with np.errstate(invalid="ignore"):
        near = np.isfinite(limits) & (over > -1e-3 * limits - 2 * slack)
    if not near.any():  # found by bisection, a little below
        above = at(mass * (1 + 2 * RESOLUTION))
        near = np.isfinite(limits) & (over == over.max() if above is None else above > 0)
    return Bound(mass, Failure.MOTOR, _names(robot, near))


def _by_line(robot: Robot, stand: Stand, point: Tool) -> float | None:
    """Returns what motors hold by the line through two equilibria; None where there is no line."""
    weight = robot.total_mass * float(np.linalg.norm(robot.gravity))
    if stand.task.ground.slope:
        return None
    try:
        loads = Loads.of(Configuration(robot, stand.qpos), stand, point, robot.total_mass)
    except StaticsInfeasibleError:
        return None
    mass = loads.motor_limit(robot.effort_limits)
    # A foot that carries nothing at one end of the line lets go, or begins to carry, on it.
    least = np.minimum(loads.normals, loads.normals + robot.total_mass * loads.normal_rates)
    lets_go = least.min() < _NOTHING * weight or loads.contact_limit() < mass
    return None if lets_go else mass


def _even(robot: Robot, stand: Stand, point: Place, mass: float) -> GravityCompensation | None:
    """Returns what lasts with a payload; None if no contact forces balance it."""
    try:
        loaded = with_payload(robot, mass, point)
        return stand_statics(loaded, stand, distribution=ForceDistribution.MIN_TANGENTIAL)
    except StaticsInfeasibleError:
        return None


def _names(robot: Robot, chosen: NDArray[np.bool_]) -> tuple[str, ...]:
    return tuple(robot.joint_names[index] for index in np.flatnonzero(chosen))


def contact_limit(robot: Robot, stand: Stand, point: Place) -> Bound:
    """Finds the greatest payload that friction and unilateral contact bear.

    With the mass m at a point whose Jacobian is J_p, balance of the base means, in its six rows,
    g + m |g| J_p^T e_z = J^T f. The greatest m for which some contact forces inside the friction
    cones give it is a second-order cone programme in (f, m). Where a foot that presses is at its
    friction's limit it slides first; otherwise a foot would have to pull, and the robot tips.

    Args:
        robot: The robot.
        stand: How it stands, without payload. Forces act half way into its ``depths``.
        point: Where the mass is, as in ``with_payload``.

    Returns:
        The limit; infinite if all is borne that is looked at (``UNLIMITED``).
    """
    robot.check_tree("a payload")
    config, most = Configuration(robot, stand.qpos), UNLIMITED * robot.total_mass
    carrying = make_contacts(robot, stand.stance_feet, None, stand.normals, stand.depths)
    problem = carrying.balance(carrying.jacobian(config), config.load())
    load = find_place(robot, point).load_per_mass(config)[:6]
    best, forces = problem.greatest_load(load, carrying.friction, most)
    if best >= 0.999 * most:
        return Bound(math.inf, Failure.NOTHING, ())
    for failure in (Failure.SLIDING, Failure.TIPPING):
        if feet := _feet(robot, stand, forces.reshape(-1, 3), failure):
            break
    return Bound(best, failure, feet)


def _feet(robot: Robot, stand: Stand, forces: Array, failure: Failure) -> tuple[str, ...]:
    """Returns the feet that slide, or that would have to pull next."""
    weight = float(np.linalg.norm(forces, axis=1).max())
    feet = []
    for foot, force in zip(stand.stance_feet, forces, strict=True):
        normal = float(force @ stand.normals[foot])
        tangential = float(np.linalg.norm(force - normal * stand.normals[foot]))
        grip = robot.contacts[foot].sliding_friction * normal
        light = normal < 1e-3 * weight
        if light if failure is Failure.TIPPING else not light and tangential > 0.999 * grip:
            feet.append(foot)
    return tuple(feet)
