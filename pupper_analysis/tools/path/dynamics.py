"""What motors and contacts must give in motion: inverse dynamics of a robot on its feet."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arguments import check_arguments, check_vector
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError, Infeasibility
from pupper_analysis.robot.compliance import GroundLaw
from pupper_analysis.robot.configuration import UP, Configuration
from pupper_analysis.robot.impedance import effective_solref
from pupper_analysis.robot.robot import Robot
from pupper_analysis.statics.contacts import make_contacts
from pupper_analysis.statics.equilibrium import Equilibrium, ForceDistribution, balance_load

Array = NDArray[np.float64]

FASTEST = 1e9
"""m/s^2, rad/s^2: beyond, squares of forces overflow long before an answer would mean anything."""

_FIXED_POINT_ITERATIONS = 2
"""Of normal forces and the moments in proportion to them. Each makes the error smaller by about
rolling friction / distance of the feet, a tenth; the balance is exact after any."""


@dataclass(frozen=True, eq=False)
class InverseDynamics(Equilibrium):
    """What a motion of a robot on its feet takes, at one moment: an ``Equilibrium`` in motion.

    Attributes:
        contact_moments: {foot: (3,)} moment of the ground on the foot about the contact point, in
            world axes (N m): resistance to rolling and spinning.
        zero_moment_point: (3,) on the ground, in the world (m): where the contact forces have no
            tangential moment (``contact_moments`` apart). Not a number for a fixed base, or where
            the ground would have to pull.
        zmp_margin: Distance of its vertical projection from the edge of the support polygon (m),
            positive inside; None without contacts, minus infinity where it is not a number.
    """

    contact_moments: dict[str, Array] = field(metadata={"unit": "N m"})
    zero_moment_point: Array = field(metadata={"unit": "m"})
    zmp_margin: float | None = field(metadata={"unit": "m"})


@check_arguments
def inverse_dynamics(
    config: Configuration,
    qacc: ArrayLike,
    contacts: Iterable[str] | None = None,
    *,
    friction: float | Mapping[str, float] | None = None,
    normals: Mapping[str, ArrayLike] | None = None,
    depths: Mapping[str, float] | None = None,
    distribution: ForceDistribution = ForceDistribution.MIN_TANGENTIAL,
    resistance: bool = True,
    held: bool = False,
) -> InverseDynamics:
    """Computes motor torques and contact forces of a motion.

    Balance means M qacc + h + r = J^T f + Jw^T m + S^T tau, with the armature in M, h the Coriolis,
    centrifugal and gravity forces, r the joints' damping and dry friction (``joint_resistance``),
    and m the moments with which the ground resists feet that roll (``rolling_levers``). It is the
    second-order cone programme of ``gravity_compensation``, with M qacc + h + r for g, and at rest
    it is the same. (Springs, tendons and fluid of the MJCF are left out, there as here.)

    Args:
        config: Where the robot is, and its qvel.
        qacc: (nv,) generalised acceleration, the derivative of qvel: m/s^2 in the world, rad/s^2 in
            the base's frame and of the joints.
        contacts: The feet that carry; all by default, none for a fixed base.
        friction: Friction coefficient, for all or per foot; by default that of MuJoCo's contact.
        normals: Per foot, the direction (3,) in the world out of the ground; up where not given.
        depths: Per foot, how deep it has sunk into the ground (m), 0 where not given.
        distribution: Which of the feasible forces; by default those that last in a simulator.
        resistance: Whether joints and rolling feet resist as the MJCF says; otherwise r, m are 0.
        held: Let feet pull and slip, as if they were held to the ground: what the motion would
            need, feasible or not.

    Raises:
        UnknownNameError: If a foot is unknown.
        ConfigurationError: If an argument is no such thing, or a robot with a fixed base is given
            contacts.
        StaticsInfeasibleError: If no forces do; it says why.
    """
    robot = config.robot
    robot.check_tree("inverse dynamics")
    acceleration = check_vector("qacc", qacc, robot.nv)
    if (np.abs(acceleration) > FASTEST).any():
        raise ConfigurationError("qacc", diagnose("acceleration-too-fast", most=FASTEST))
    carrying = make_contacts(robot, contacts, friction, normals, depths)
    feet, ground = carrying.feet, dict(zip(carrying.feet, carrying.normals, strict=True))
    load = config.mass_matrix() @ acceleration + config.bias_forces() - config.passive()
    levers: dict[str, Array] = {}
    if resistance:
        load += joint_resistance(robot, config.qvel, acceleration)
        levers = rolling_levers(config, acceleration, ground)
    left = dict.fromkeys(levers, 1.0)
    origin, normal = _ground_under(config, ground)
    pressed = {foot: max(0.0, float(load[:3] @ normal)) / len(feet) for foot in feet}
    for _ in range(_FIXED_POINT_ITERATIONS if levers else 1):
        moments = {foot: np.zeros(3) for foot in feet}
        moments |= {foot: pressed[foot] * left[foot] * lever for foot, lever in levers.items()}
        rest = load.copy()
        for foot, moment in moments.items():
            rest -= config.frame_jacobian(robot.contact_frames[foot])[3:].T @ moment
        point = zero_moment_point(config, rest, origin, normal)
        found = balance_load(
            config,
            rest,
            carrying,
            point=point,
            distribution=distribution,
            tipping=Infeasibility.ZMP_OUTSIDE,
            held=held,
        )
        forces = found.contact_forces
        pressed = {foot: max(0.0, float(forces[foot] @ ground[foot])) for foot in feet}
        left = {
            foot: share_left_to_turn(robot, foot, forces[foot], pressed[foot] * lever, ground[foot])
            for foot, lever in levers.items()
        }
    return InverseDynamics(
        **{field.name: getattr(found, field.name) for field in fields(Equilibrium)},
        contact_moments=moments,
        zero_moment_point=point,
        zmp_margin=found.com_margin,
    )


def _ground_under(config: Configuration, normals: Mapping[str, Array]) -> tuple[Array, Array]:
    """Returns the mean of the points that touch the ground (3,), and its normal there (3,)."""
    robot = config.robot
    points = [
        config.frame_position(robot.contact_frames[foot]) - robot.contact_radius[foot] * normal
        for foot, normal in normals.items()
    ]
    if not points:
        return np.zeros(3), UP
    normal: Array = np.mean(list(normals.values()), axis=0)
    return np.mean(points, axis=0), normal / np.linalg.norm(normal)


def zero_moment_point(config: Configuration, load: Array, origin: Array, normal: Array) -> Array:
    """Returns where on the ground the contact forces have no tangential moment, (3,) (m).

    A robot tips where it leaves the support polygon. With F the total contact force and M its
    moment about ``origin``, both from the six base rows of the load, it is
    origin + normal x M / (F . normal). At rest it is under the com.

    Source: Vukobratovic and Borovac, "Zero-moment point - thirty five years of its life" (2004).

    Args:
        config: Where the robot is.
        load: (nv,) what motors and contact forces must add up to.
        origin: (3,) a point of the ground (m).
        normal: (3,) out of the ground.

    Returns:
        The point; not a number where the ground would have to pull, or to give nothing.
    """
    if not config.robot.floating:
        return np.full(3, math.nan)
    force, moment = load[:3], config.base_rotation() @ load[3:6]
    pressing = float(force @ normal)
    if pressing <= 0:
        return np.full(3, math.nan)
    about = moment + np.cross(config.qpos[:3] - origin, force)
    point: Array = origin + np.cross(normal, about) / pressing
    return point


def joint_resistance(robot: Robot, qvel: Array, qacc: Array) -> Array:
    """Returns what dampers and dry friction take (nv,), to be overcome by the motors (N m).

    Dampers are the linear ones of joints (``damping``). Dry friction is MuJoCo's constraint
    (``frictionloss``): with
    R = (1 - d)/d A, d the impedance of ``solimpfriction`` and b the damping of ``solreffriction``,
    it takes (qacc + b qvel)/R, and at most the friction loss. So it is the Coulomb friction of the
    direction of motion but for the first and last millimetres per second.

    Source: MuJoCo documentation, "Computation: Friction loss"; engine_core_constraint.c.

    Args:
        robot: The robot.
        qvel: (nv,) generalised velocity.
        qacc: (nv,) generalised acceleration.
    """
    model, index = robot.mj_model, robot.mj_convention.qvel_index
    resistance = model.dof_damping[index] * qvel
    loss = model.dof_frictionloss[index]
    dry = np.flatnonzero(loss)
    low, high = np.clip(model.dof_solimp[index, :2].T, mujoco.mjMINIMP, mujoco.mjMAXIMP)
    first, second = np.array([effective_solref(solref) for solref in model.dof_solref[index]]).T
    if not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_REFSAFE.value:
        first = np.where(first > 0, np.maximum(first, 2 * model.opt.timestep), first)
    damping = np.where(first > 0, 2 / (high * first), -second / high)
    softness = (1 - low) / low * model.dof_invweight0[index]
    asked = (qacc + damping * qvel)[dry] / softness[dry]
    resistance[dry] += np.clip(asked, -loss[dry], loss[dry])
    return np.asarray(resistance, dtype=float)


def rolling_levers(
    config: Configuration, qacc: Array, normals: Mapping[str, Array]
) -> dict[str, Array]:
    """Returns the moment with which the ground resists each foot's turning, per normal force (m).

    MuJoCo's contacts of ``condim`` 4 and 6 resist spinning about the normal, and rolling, by at
    most mu_j f_n, with mu_j (m) the coefficients of the contact. Like all of its friction they are
    regularised: below the limit the moment is mu_j^2/mu_1^2 (alpha + b omega)/R. The limit is
    reached at about 0.1 rad/s; here it is the one of a foot that carries its even share.

    Args:
        config: Where the robot is, and its qvel.
        qacc: (nv,) generalised acceleration.
        normals: {foot that carries: (3,) direction out of the ground}.

    Returns:
        {foot: (3,) in world axes, against its turning}, of those that the ground resists.
    """
    robot, found = config.robot, {}
    share = robot.weight / max(1, len(normals))
    accelerations = config.foot_accelerations(qacc)
    for foot, normal in normals.items():
        parameters = robot.contacts.get(foot)
        if parameters is None or parameters.condim < 4 or not parameters.sliding_friction:
            continue
        law = GroundLaw.of(robot, foot)
        impedance = law.impedance(law.depth(share))
        softness = (1 - impedance) / impedance * law.tangential
        turning = config.frame_jacobian(robot.contact_frames[foot])[3:] @ config.qvel
        asked = accelerations[foot][3:] + law.damping * turning
        along = np.outer(normal, normal)
        slide, _, spin, roll, _ = parameters.friction
        limits = spin * along  # (3, 3): the coefficient of each direction
        if parameters.condim == 6:
            limits = limits + roll * (np.eye(3) - along)
        # In units of the normal force, so that the friction cone is the unit ball.
        pressed = limits @ asked / (softness * slide**2) / share
        found[foot] = -limits @ pressed / max(1.0, float(np.linalg.norm(pressed)))
    return found


def share_left_to_turn(
    robot: Robot, foot: str, force: Array, moment: Array, normal: Array
) -> float:
    """Returns what share of a moment against turning the tangential force of a foot leaves.

    The two share one cone: |f_t|^2/mu^2 + m_n^2/mu_n^2 + |m_r|^2/mu_r^2 <= f_n^2.

    Args:
        robot: The robot.
        foot: A foot that the ground resists (``rolling_levers``).
        force: (3,) of the ground on it (N).
        moment: (3,) that it would be without tangential force (N m).
        normal: (3,) direction out of the ground.
    """
    slide, _, spin, roll, _ = robot.contacts[foot].friction
    pressing, about = float(force @ normal), float(moment @ normal)
    if pressing <= 0.0:
        return 0.0
    tangential = float(np.linalg.norm(force - pressing * normal)) / (slide * pressing)
    over = float(np.linalg.norm(moment - about * normal))
    parts = [abs(size) / limit for size, limit in ((about, spin), (over, roll)) if limit > 0]
    taken = math.hypot(*parts) / pressing
    room = math.sqrt(max(0.0, 1.0 - tangential**2))
    return min(1.0, room / taken) if taken > 0 else 1.0
