"""Inverse dynamics of a robot on its feet: motor torques and contact forces of a motion.

`inverse_dynamics` adds inertia, joint friction and the ground's resistance to rolling feet to the
load of static equilibrium, and solves for contact forces in friction cones as
`statics.equilibrium.gravity_compensation` does.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from pupper_analysis.base.arguments import check_arguments, check_vector
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError, Infeasibility
from pupper_analysis.robot.compliance import GroundLaw
from pupper_analysis.robot.configuration import UP, Configuration
from pupper_analysis.robot.impedance import effective_solref
from pupper_analysis.robot.robot import Robot
from pupper_analysis.statics.contacts import make_contacts_in
from pupper_analysis.statics.equilibrium import Equilibrium, ForceDistribution, balance_load

MAX_ACCELERATION = 1e9
"""Upper bound of each generalised acceleration [m/s^2, rad/s^2]. Larger accelerations are refused.
Chosen, not tuned."""

_MOMENT_ITERATIONS = 2
"""Number of fixed-point iterations between the normal forces of the contacts and the rolling
moments, which are proportional to these forces. Each iteration multiplies the error by about
(rolling friction / distance between feet). Chosen, not tuned."""


@dataclass(frozen=True, eq=False)
class InverseDynamics(Equilibrium):
    """Motor torques and contact forces of a motion at one instant, including inertial forces.

    Attributes:
        contact_moments: Moment of the ground on each foot about the contact point, shape (3,), in
            world axes: resistance to rolling and spinning.
        zero_moment_point: Shape (3,), in the world frame: point on the ground about which the
            contact forces, without ``contact_moments``, have no tangential moment. NaN for a fixed
            base, or if the ground would have to pull.
        zmp_margin: Distance from the projected zero-moment point to the edge of the support region,
            positive inside. None without contacts; minus infinity if the point is NaN.
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
    """Compute motor torques and contact forces of a motion.

    Solves M qacc + h + r = J^T f + Jw^T m + S^T tau. M includes the armature. h contains Coriolis,
    centrifugal and gravity forces, minus the passive forces of the MJCF at zero velocity, such as
    springs (``Configuration.passive_forces``). r is damping and dry friction of the joints
    (``joint_resistance``). m are the moments with which the ground resists rolling feet
    (``rolling_levers``). The forces f solve the second-order cone program of
    ``gravity_compensation``, with M qacc + h + r in place of g. At rest both results are equal.
    Damping of tendons and fluid drag are not included.

    Args:
        config: State of the robot, with ``qvel``.
        qacc: Shape (nv,); generalised acceleration, the time derivative of ``qvel`` [m/s^2 in the
            world frame; rad/s^2 in the frame of the base, and of the joints].
        contacts: Feet that carry load. Default: `Robot.bearing_points`; none for a fixed base.
        friction: Friction coefficient, for all feet or per foot. Default: MuJoCo's contact.
        normals: Per foot, a direction out of the ground, shape (3,), in the world frame. Default:
            upward.
        depths: Per foot, penetration into the ground [m]. Default: 0.
        distribution: Selection among feasible forces. Default: minimum tangential forces.
        resistance: True to include the resistance r and the moments m, as specified in the MJCF.
        held: True to omit friction cones and unilateral limits, as if feet were glued to the
            ground.

    Raises:
        ConfigurationError: If an argument is invalid, the robot has loops, couplings, welds or
            grips, or a robot with a fixed base has contacts. Also if contact points that carry load
            by default are not on level ground.
        StaticsInfeasibleError: If no feasible forces exist. The error states the reason.
    """
    robot = config.robot
    robot.check_tree("inverse dynamics")
    acceleration = check_vector("qacc", qacc, robot.nv)
    if (np.abs(acceleration) > MAX_ACCELERATION).any():
        raise ConfigurationError("qacc", diagnose("acceleration-too-fast", most=MAX_ACCELERATION))
    carrying = make_contacts_in(config, contacts, friction, normals, depths)
    feet, ground = carrying.feet, dict(zip(carrying.feet, carrying.normals, strict=True))
    load = config.mass_matrix() @ acceleration + config.bias_forces() - config.passive_forces()
    levers: dict[str, Array] = {}
    if resistance:
        load += joint_resistance(robot, config.qvel, acceleration)
        levers = rolling_levers(config, acceleration, ground)
    remaining = dict.fromkeys(levers, 1.0)
    origin, normal = _mean_ground_point(config, ground)
    pressed = {foot: max(0.0, float(load[:3] @ normal)) / len(feet) for foot in feet}
    for _ in range(_MOMENT_ITERATIONS if levers else 1):
        moments = {foot: np.zeros(3) for foot in feet}
        moments |= {foot: pressed[foot] * remaining[foot] * lever for foot, lever in levers.items()}
        reduced_load = load.copy()
        for foot, moment in moments.items():
            reduced_load -= config.frame_jacobian(robot.contact_frames[foot])[3:].T @ moment
        point = zero_moment_point(config, reduced_load, origin, normal)
        found = balance_load(
            config,
            reduced_load,
            carrying,
            point=point,
            distribution=distribution,
            tipping=Infeasibility.ZMP_OUTSIDE,
            held=held,
        )
        forces = found.contact_forces
        pressed = {foot: max(0.0, float(forces[foot] @ ground[foot])) for foot in feet}
        remaining = {
            foot: remaining_moment_fraction(
                robot, foot, forces[foot], pressed[foot] * lever, ground[foot]
            )
            for foot, lever in levers.items()
        }
    return InverseDynamics(
        **{field.name: getattr(found, field.name) for field in fields(Equilibrium)},
        contact_moments=moments,
        zero_moment_point=point,
        zmp_margin=found.com_margin,
    )


def _mean_ground_point(config: Configuration, normals: Mapping[str, Array]) -> tuple[Array, Array]:
    """Return the mean contact position, (3,) [m], and mean unit normal, (3,), in the world frame.

    Without contact points: the origin and the unit vector upwards.
    """
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
    """Compute the zero-moment point: origin + normal x M / (F . normal).

    F is the total contact force and M the moment about ``origin``, both from the six base rows of
    the load. The robot tips if the point leaves the support region. (Vukobratovic and Borovac 2004,
    "Zero-moment point - thirty five years of its life".)

    Args:
        config: State of the robot.
        load: Shape (nv,) [N, N m]; generalised force that motors and contacts must produce.
        origin: Shape (3,) [m]; a point on the ground in the world frame.
        normal: Shape (3,); unit vector out of the ground.

    Returns:
        Shape (3,) [m], in the world frame. NaN for a fixed base, or if F . normal is not positive.
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
    """Compute the torques of joint damping and dry friction that the motors must overcome.

    Damping is the linear ``damping`` of joints. Dry friction is MuJoCo's ``frictionloss``
    constraint: (qacc + b qvel) / R, limited to +-frictionloss, with R = (1 - d) / d A, d the
    impedance of ``solimpfriction``, A the inverse inertia ``dof_invweight0``, and b the damping of
    ``solreffriction``. At speeds well above |qacc| / b and R frictionloss / b, this is Coulomb
    friction. (MuJoCo documentation, "Computation: Friction loss"; engine_core_constraint.c.)

    Args:
        robot: Robot.
        qvel: Shape (nv,); generalised velocity [m/s, rad/s].
        qacc: Shape (nv,); generalised acceleration [m/s^2, rad/s^2].

    Returns:
        Shape (nv,) [N, N m]; zero for degrees of freedom without damping and dry friction.
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
    unlimited = (qacc + damping * qvel)[dry] / softness[dry]
    resistance[dry] += np.clip(unlimited, -loss[dry], loss[dry])
    return np.asarray(resistance, dtype=float)


def rolling_levers(
    config: Configuration, qacc: Array, normals: Mapping[str, Array]
) -> dict[str, Array]:
    """Compute the moment per normal force with which the ground resists the rotation of each foot.

    MuJoCo's contacts with ``condim`` 4 or 6 resist spinning about the normal, with ``condim`` 6
    also rolling. The moment is at most mu_j f_n: the coefficient mu_j [m] of the contact times the
    normal force. The limit is reached at a low angular velocity. Below, the moment is

        mu_j^2 / mu_1^2 (alpha + b omega) / R

    against the rotation, with the coefficient mu_1 of sliding friction, the angular acceleration
    alpha and velocity omega of the foot, and b and the tangential R of `GroundLaw`. In this
    formula, all loaded feet are assumed to carry equal parts of the weight.

    Args:
        config: State of the robot, with ``qvel``.
        qacc: Shape (nv,); generalised acceleration [m/s^2, rad/s^2].
        normals: {loaded foot: unit normal of the ground in the world frame, shape (3,)}.

    Returns:
        {foot: moment / normal force in the world frame, shape (3,) [m]}, for each loaded foot whose
        contact has ``condim`` 4 or 6 and a sliding friction above 0.
    """
    robot, found = config.robot, {}
    mean_load = robot.weight / max(1, len(normals))
    accelerations = config.foot_accelerations(qacc)
    for foot, normal in normals.items():
        parameters = robot.contacts.get(foot)
        if parameters is None or parameters.condim < 4 or not parameters.sliding_friction:
            continue
        law = GroundLaw.of_contact(robot, foot)
        impedance = law.impedance(law.depth(mean_load))
        softness = (1 - impedance) / impedance * law.tangential
        turning = config.frame_jacobian(robot.contact_frames[foot])[3:] @ config.qvel
        reference = accelerations[foot][3:] + law.damping * turning
        projector = np.outer(normal, normal)
        slide, _, spin, roll, _ = parameters.friction
        limits = spin * projector  # (3, 3): the coefficient of each direction
        if parameters.condim == 6:
            limits = limits + roll * (np.eye(3) - projector)
        # In units of the normal force the friction cone is the unit ball.
        scaled = limits @ reference / (softness * slide**2) / mean_load
        found[foot] = -limits @ scaled / max(1.0, float(np.linalg.norm(scaled)))
    return found


def remaining_moment_fraction(
    robot: Robot, foot: str, force: Array, moment: Array, normal: Array
) -> float:
    """Compute how much of the resisting moment on a foot is possible besides the contact force.

    The tangential force f_t, the spinning moment m_n about the normal, and the rolling moment m_r
    across the normal share a friction cone (f_n: normal force):

        |f_t|^2 / mu^2 + m_n^2 / mu_n^2 + |m_r|^2 / mu_r^2 <= f_n^2

    The coefficients are mu [1] of sliding, mu_n [m] of torsional and mu_r [m] of rolling friction.

    Args:
        robot: Robot.
        foot: Foot whose contact resists rotation (``rolling_levers``).
        force: Shape (3,) [N]; force of the ground on the foot.
        moment: Shape (3,) [N m]; resisting moment of the ground if the force had no tangential
            component.
        normal: Shape (3,); unit vector out of the ground.

    Returns:
        Largest factor from 0 to 1 on a nonzero ``moment`` that satisfies the inequality; 0 if
        ``force`` alone violates it.
    """
    slide, _, spin, roll, _ = robot.contacts[foot].friction
    pressing, spinning = float(force @ normal), float(moment @ normal)
    if pressing <= 0.0:
        return 0.0
    tangential = float(np.linalg.norm(force - pressing * normal)) / (slide * pressing)
    rolling = float(np.linalg.norm(moment - spinning * normal))
    ratios = [abs(size) / limit for size, limit in ((spinning, spin), (rolling, roll)) if limit > 0]
    needed = math.hypot(*ratios) / pressing
    available = math.sqrt(max(0.0, 1.0 - tangential**2))
    return min(1.0, available / needed) if needed > 0 else 1.0
