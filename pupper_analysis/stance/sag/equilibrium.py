"""Equations of a robot at rest on position servos and soft ground, solved by Newton's method.

`SagEquilibrium` contains the balance of generalised forces, a slip law and a depth law per contact.
The unknowns are the configuration and the contact forces. The set of touching contacts is fixed in
a solve; `SagEquilibrium.switch_contact` changes it. `stance.sag.steady_state` follows a solution
while feed-forward is removed and feet creep.

The "contact frame" of a contact has two tangents of the ground as x and y axes. Its z axis is the
ground normal. "Height" as a unit means `EquilibriumScales.length`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base import lapack
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.arrays import cross_matrices
from pupper_analysis.robot.compliance import GroundLaw
from pupper_analysis.robot.configuration import UP, Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import command_ranges, resolve_servo_gains
from pupper_analysis.stance.problem import can_move_com, ground_normals
from pupper_analysis.stance.stand import Stand, stand_contacts
from pupper_analysis.statics.cone_program import split_force


@dataclass(frozen=True, eq=False)
class Anchor:
    """Pose of a foot at its first contact, from which slip and rolling of the foot are measured.

    Attributes:
        position: Centre of the contact sphere, shape (3,) [m], in the world frame.
        rotation: Orientation of the foot's frame, shape (3, 3).
    """

    position: Array
    rotation: Array


@dataclass(frozen=True, eq=False)
class Solution:
    """Solution of the equilibrium equations, or an initial guess.

    Attributes:
        qpos: Configuration, shape (nq,).
        forces: {touching contact: force of the ground, shape (3,) [N]}, in the contact frame.
        residual: Largest absolute element of the residual (N, N m and m mixed).
    """

    qpos: Array
    forces: dict[str, Array]
    residual: float = math.inf

    def force(self, foot: str) -> Array:
        """Return the ground force (3,) [N] on the contact point ``foot``, in the contact frame.

        The z axis of the contact frame is the ground normal. Zero if the point is not in contact.
        """
        return self.forces.get(foot, np.zeros(3))


def integrate_step(qpos: Array, step: Array) -> Array:
    """Add a displacement in the tangent space (nv,) to a configuration (nq,).

    Args:
        qpos: Initial configuration, shape (nq,).
        step: Displacement in the order of qvel, shape (nv,) [m, rad]. The linear part of the base
            is in the world frame, the angular part in the base frame.
    """
    if len(qpos) == len(step):  # the base is fixed
        return qpos + step
    moved = qpos.copy()
    moved[:3] += step[:3]
    moved[7:] += step[6:]
    turned = pin.Quaternion(*qpos[3:7].tolist()) * pin.Quaternion(pin.exp3(step[3:6]))
    moved[3:7] = turned.coeffs()[[3, 0, 1, 2]]
    return moved


class ContactKinematics:
    """Positions and Jacobians of the touching contacts at a configuration.

    Args:
        config: Configuration.
        anchors: {touching contact: pose at the first contact}.
        centres: Centres of the contact spheres, shape (n, 3) [m], in the world frame.
        frames: Rotations from the world to the contact frame of each contact, shape (n, 3, 3).
        crosses: Cross-product matrices of the ground normals, shape (n, 3, 3), in the world frame.
        depths: {contact: penetration [m]} of all contact points.

    Attributes:
        config: Configuration.
        depths: Penetrations as passed [m].
        places: Shape (n, 3) [m]; slips along the two ground tangents, and the penetration. Rolling
            of the sphere does not count as slip.
        jacobians: Jacobians of the material point at each contact, shape (n, 3, nv), in the contact
            frame.
        rotation_jacobians: Rotational Jacobians of the feet, shape (n, 3, nv), in the world frame.
    """

    def __init__(
        self,
        config: Configuration,
        anchors: Mapping[str, Anchor],
        centres: Array,
        frames: Array,
        crosses: Array,
        depths: Mapping[str, float],
    ) -> None:
        self.config, self._frames, self._normals = config, frames, frames[:, 2]
        self.depths, self._crosses = depths, crosses
        radius, feet, held = config.robot.contact_radius, tuple(anchors), anchors.values()
        deep = np.array([depths[foot] for foot in feet])
        # MuJoCo places the contact point at half the penetration.
        self._reach = (np.array([radius[foot] for foot in feet]) - deep / 2)[:, None]
        self._offsets = self._reach[:, None] * crosses  # arms from the contact to the centre
        self._twists = config.foot_twist_jacobians(feet)
        self._centre, self.rotation_jacobians = self._twists[:, :3], self._twists[:, 3:]
        self.jacobians = frames @ (self._centre + self._offsets @ self.rotation_jacobians)
        before = np.array([anchor.rotation for anchor in held]).reshape(-1, 3, 3)
        rotations = self._rotations_since = config.foot_rotations(feet) @ before.transpose(0, 2, 1)
        turns = np.array([pin.log3(rotation) for rotation in rotations])
        self._rotation_vectors = turns.reshape(-1, 3)
        begun = np.array([anchor.position for anchor in held]).reshape(-1, 3)
        self._normal_cross_turn = crosses @ self._rotation_vectors[:, :, None]  # normal x turn
        rolled = self._reach * self._normal_cross_turn[:, :, 0]
        self.places = (frames @ (centres - begun + rolled)[:, :, None])[:, :, 0]
        self.places[:, 2] = deep

    def place_rates(self) -> Array:
        """Compute the Jacobian by qvel of the contacts' slips and penetrations (``places``).

        Shape (n, 3, nv) [m/m, m/rad].
        """
        deeper = self._depth_rates
        # The rate of a rotation vector is the inverse of the left Jacobian x angular velocity.
        logs = np.array([pin.Jlog3(turned) for turned in self._rotations_since]).reshape(-1, 3, 3)
        turns = logs.transpose(0, 2, 1) @ self.rotation_jacobians
        rates: Array = self._centre + self._offsets @ turns
        # The lever arm shortens by half of the change in penetration.
        rates -= self._normal_cross_turn / 2 * deeper[:, None, :]
        rates = self._frames @ rates
        rates[:, 2] = deeper
        return rates

    @cached_property
    def _depth_rates(self) -> Array:
        """Jacobian by qvel of the penetrations of touching contacts, shape (n, nv) [m/rad, m/m]."""
        deeper: Array = -(self._normals[:, None] @ self._centre)[:, 0]
        return deeper

    def generalized_force(self, forces: Array) -> Array:
        """Compute the generalised force of contact forces on the robot, shape (nv,) [N, N m].

        The generalised force is dual to MuJoCo's qvel.

        Args:
            forces: Forces on the n touching contacts in their contact frames (two tangents, then
                the normal), shape (n, 3) [N].
        """
        pushed: Array = forces.ravel() @ self.jacobians.reshape(forces.size, self.config.robot.nv)
        return pushed

    def balance_rates(self, forces: Array, held: tuple[Array, Array] | None = None) -> Array:
        """Compute the Jacobian (nv, nv) by qvel of static load minus constant contact forces.

        Args:
            forces: Contact forces, shape (n, 3) [N], in the contact frame.
            held: Jacobians of w welds, shape (w, 6, nv), and their wrenches, shape (w, 6) [N, N m],
                which are subtracted as constant loads, too. None: no welds.
        """
        pushing = (forces[:, None] @ self._frames)[:, 0]
        wrenches = np.empty((len(forces), 6))
        wrenches[:, :3] = pushing
        across = (pushing[:, None] @ self._crosses)[:, 0]  # pushing x normal
        wrenches[:, 3:] = self._reach * across
        twists = self._twists
        if held is not None:
            twists, wrenches = (
                np.concatenate([twists, held[0]]),
                np.concatenate([wrenches, held[1]]),
            )
        rates = self.config.loaded_points_derivative(twists, wrenches)
        # The contact approaches the centre as the penetration increases.
        moved = (across[:, None] @ self.rotation_jacobians)[:, 0]
        change: Array = rates + moved.T @ (self._depth_rates / 2)
        return change


GROUND_NORMAL = (0.0, 0.0, 1.0)
"""Unit normal of the ground in the contact frame, whose z axis is the normal."""

_MAX_STEP_ANGLE, _MAX_STEP_LENGTH = 0.5, 4.0
"""Upper bounds of a Newton step: first value for the rotation of the base or the displacement of a
joint [rad, m]; second value for the displacement of the base, in units of
`EquilibriumScales.length`. With a longer step Newton's method fails, since the step may lead to
another solution. Chosen, not tuned."""

_SLIP_STIFFNESS_RATIO = 4e-6
"""Stiffness of a numerical spring along the ground at contacts without friction, in units of robot
weight / `EquilibriumScales.length`. Without the spring, the horizontal position and the yaw of the
robot might not be unique. Chosen, not tuned."""

_FRICTION_PENALTY_RATIO = 4.0
"""Penalty parameter rho of the slip law (`SagEquilibrium`), in units of robot weight /
`EquilibriumScales.length`. The parameter changes the iterations of Newton's method, but not the
solution. Chosen, not tuned."""


@dataclass(frozen=True)
class EquilibriumScales:
    """Weight and height of a robot, by which residuals and steps of the solver are divided.

    Attributes:
        weight: Weight [N].
        length: Height [m] of the CoM above the lowest sphere centre of a stance foot. For a robot
            with a fixed base, a weld or a grip, it is the stand height. If the stand height is
            zero, it is the extent of the model.
        num_base_translations: Number of coordinates that translate the base: 3, or 0 for a fixed
            base.
    """

    weight: float
    length: float
    num_base_translations: int = 3

    @staticmethod
    def from_stand(robot: Robot, stand: Stand) -> EquilibriumScales:
        """Return the scales of the equilibrium equations for a robot in a stand."""
        weight = robot.usual_weight
        if robot.is_base_fixed or robot.fixed_parts:
            length = robot.stand_height or float(robot.mj_model.stat.extent)
            return EquilibriumScales(weight, length, 3 if robot.floating else 0)
        lowest = min(float(stand.foot_targets[foot][2]) for foot in stand.stance_feet)
        com = Configuration(robot, stand.qpos).center_of_mass()
        return EquilibriumScales(weight, float(com[2]) - lowest)

    @property
    def stiffness(self) -> float:
        """Reference stiffness of this robot's servos [N m/rad], ``weight`` times ``length``."""
        return self.weight * self.length

    @property
    def slip_stiffness(self) -> float:
        """Stiffness [N/m] of a numerical spring on the slip of contacts without friction.

        Without friction, any horizontal position is an equilibrium; with friction at a single
        point, any yaw. The spring makes the solution unique.
        """
        return _SLIP_STIFFNESS_RATIO * self.weight / self.length

    @property
    def friction_penalty(self) -> float:
        """Penalty parameter rho [N/m] in the friction equation; without effect on the solution."""
        return _FRICTION_PENALTY_RATIO * self.weight / self.length

    def max_residual(self, residual: Array, nv: int, forces: slice | list[int]) -> float:
        """Return the largest absolute element [1] of the residual, after scaling to common units.

        Forces are divided by the weight, joint balances (N m, or N of a slide) and torques on the
        base by weight x height, and lengths by the height.

        Args:
            residual: Shape (nv + 3 n,); balance, then three equations per touching contact.
            nv: Number of velocity coordinates.
            forces: Indices of the contacts whose two slip equations have the unit N instead of m.
        """
        units = np.full(len(residual), self.length)
        units[: self.num_base_translations], units[self.num_base_translations : nv] = (
            self.weight,
            self.weight * self.length,
        )
        units[nv:].reshape(-1, 3)[forces, :2] = self.weight
        return float(np.abs(residual / units).max())

    def is_step_too_long(self, step: Array) -> bool:
        """Return True if a Newton step, shape (nv,) [m, rad], is too long or not finite."""
        moved, turned = (
            np.abs(step[: self.num_base_translations]),
            np.abs(step[self.num_base_translations :]).max(),
        )
        return not (
            turned < _MAX_STEP_ANGLE and moved.max(initial=0.0) < _MAX_STEP_LENGTH * self.length
        )


SlipLaw = Literal["pinned", "sliding"]
"""Law of tangential contact forces: ``pinned`` feet stick, up to the friction limit; ``sliding``
feet have no friction (final state of MuJoCo's creep)."""

RESIDUAL_TOLERANCE = 3e-12
"""Upper bound of the residual of an accepted equilibrium, in units of robot weight (forces), weight
x height (torques) and height (lengths). Chosen, not tuned."""

_ROUNDING_RESIDUAL = 3e-16
"""Predicted scaled residual e[k]^2 / e[k-1] [1] after a Newton step, up to which the step reuses
the previous Jacobian in an exact solve (`SagEquilibrium.solve`); e[k] is the scaled residual
(`EquilibriumScales.max_residual`) after k steps. Chosen as the size of rounding errors."""

CONTACT_DEPTH_TOLERANCE = 1e-8
"""Penetration plus MuJoCo's contact margin, in units of `EquilibriumScales.length`, above which a
point that is assumed to have no contact becomes a contact. Chosen, not tuned."""

_SOLE_COMPLIANCE_FACTORS = (1e3, 1e2, 1e1, 1.0)
"""Factors [1] on the tangential compliance of contact points (`contact_compliance`) in successive
solves of a robot with soles, for convergence of Newton's method. Chosen, not tuned."""

_MAX_ITERATIONS = 16
"""Upper bound of the number of Newton iterations of `SagEquilibrium.solve`. All of 5,148 measured
solutions took 12 or fewer."""

_ALTERNATION_RTOL = 1e-6
"""Relative difference up to which residuals of Newton's method count as equal, to detect an
alternation between two residuals. Measured on variants of Pupper without a solution: contacts
change between slip and stick in each iteration, and the residuals repeat to 1e-6 after 6 to 12
iterations, then to rounding."""

_ZERO_SLIP = np.zeros(2)
"""Slip [m] of a contact that has not crept."""


class SagEquilibrium:
    """Equilibrium equations of a robot on position servos, for a fixed set of touching contacts.

        g(q) - S^T tau - sum J_i^T f_i = 0,  depth_i(q) = depth of f_i

    for the contacts in ``anchors``. Closed loops add the torques of their constraints. J_i is the
    Jacobian of the material point at the contact, and tau = clip(kp (target - q), limits).

    The slip law depends on ``feet``. If ``feet`` is "pinned", the slip s is zero (apart from creep
    and compliance) for |f_t| <= mu f_n. Otherwise f_t = -mu f_n s / |s|. One equation contains both
    cases: f_t equals the projection of f_t - rho s onto the disc of radius mu f_n, for any rho > 0
    (Alart and Curnier 1991). If ``feet`` is "sliding" or mu = 0, f_t = 0, apart from a weak spring
    that makes the position unique.

    Welded bodies stay in place. The equations contain only the balance along motions that the welds
    permit (``apply_welds``). The weld wrenches follow from the remaining balance. Dry friction of
    joints is ignored.

    Args:
        robot: Robot.
        stand: Stand that defines contacts, ground and initial target.
        kp: Servo stiffness [N m/rad, N/m], scalar or shape (nu,). Default: the model's.
        feet: Slip law.

    Attributes:
        anchors: {touching contact: pose at the first contact}. `switch_contact` changes it.
        target: Joint positions that the servos are commanded to, shape (nu,) [rad, m], set by
            `set_command`.
        has_creep: Whether friction creeps in MuJoCo: its no-slip solver is inactive.
        creep_start_slips: {contact: slip [m] at the start of the creep step, shape (2,)}.
        creep_compliances: {contact: slip per tangential force [m/N] in the creep step}.
        scales: Weight and height, by which residuals and steps are divided.
    """

    def __init__(
        self,
        robot: Robot,
        stand: Stand,
        kp: ArrayLike | None,
        feet: SlipLaw,
    ) -> None:
        used = resolve_servo_gains(robot, kp, None if kp is None else 0.0)
        self.lower, self.upper = robot.effort_ranges.T
        self.robot, self.stand, self.feet, self.kp = robot, stand, feet, used.kp
        self._points = robot.contact_points if robot.floating else ()
        self.frames = {
            foot: pin.Quaternion.FromTwoVectors(normal, UP).matrix()
            for foot, normal in ground_normals(robot, stand.task.ground).items()
            if foot in self._points
        }
        under = ground_points(robot, stand)
        self._planes = [
            (robot.contact_radius[foot], *frame[2].tolist(), under[foot].tolist())
            for foot, frame in self.frames.items()
        ]
        self.laws = {foot: GroundLaw.of_contact(robot, foot) for foot in self._points}
        self._commands = command_ranges(robot).T
        self.set_command(stand.joint_positions(robot))
        self._sole = {point: sole for sole, points in robot.feet.items() for point in points}
        config = Configuration(robot, stand.qpos)
        frames = robot.contact_frames
        self.anchors = {
            foot: Anchor(stand.foot_targets[foot], config.frame_rotation(frames[foot]))
            for foot in stand.stance_feet
        }
        self.scales = EquilibriumScales.from_stand(robot, stand)
        self._force_rows: slice | list[int] = []
        self._sole_compliance, self._compliance = contact_compliance(robot, self.scales)
        self._is_compliant, self._compliance_factor = any(self._compliance.values()), 1.0
        self._contact_cache: tuple[object, Array, ContactKinematics] | None = None
        self._sole_projection_cache: tuple[tuple[str, ...], Array | None] = (), None
        no_frames = np.zeros((0, 3, 3))
        self._ground_frame_cache: tuple[tuple[str, ...], list[int], Array, Array]
        self._ground_frame_cache = (), [], no_frames, no_frames
        self._depth_cache: tuple[tuple[tuple[str, float], ...], Array] = (), np.zeros(0)
        self.has_creep = robot.mj_model.opt.noslip_iterations == 0
        self.creep_start_slips: dict[str, Array] = {}
        self.creep_compliances: dict[str, float] = {}
        self.sliding_friction = {
            foot: contact.sliding_friction for foot, contact in robot.contacts.items()
        }
        self._joints = np.arange(robot.nv - robot.nu, robot.nv)
        # If only the base is welded, its six equations are replaced by identities.
        self._num_welded_rows = 6 if [*robot.fixed_parts.values()] == [None] else 0
        self._welds = (
            Welds(robot, stand) if robot.fixed_parts and not self._num_welded_rows else None
        )

    def depths(self, places: Array) -> dict[str, float]:
        """Compute the penetration of each contact point: {point: [m]}; negative above the ground.

        Args:
            places: Centres of all contact spheres, shape (k, 3) [m], in the world frame.
        """
        contacts = zip(self.frames, self._planes, places.tolist(), strict=True)
        return {
            foot: radius - ((x - on[0]) * a + (y - on[1]) * b + (z - on[2]) * c)
            for foot, (radius, a, b, c, on), (x, y, z) in contacts
        }

    def equilibrium_depths(self, forces: Array) -> Array:
        """Compute the penetrations (n,) [m] at which the soft ground exerts given normal forces.

        Args:
            forces: Forces on the n touching contacts, shape (n, 3) [N], in the contact frames. Only
                the normal component is used.
        """
        normal_forces = tuple(zip(self.anchors, forces[:, 2].tolist(), strict=True))
        if normal_forces != self._depth_cache[0]:
            # Initial guesses: the previous depth of the contact, or the depth of another contact.
            known = {foot: depth for (foot, _), depth in zip(*self._depth_cache, strict=True)}
            depth, depths = None, []
            for foot, force in normal_forces:
                depth = self.laws[foot].depth(force, known.get(foot, depth))
                depths.append(depth)
            self._depth_cache = normal_forces, np.array(depths)
        return self._depth_cache[1].copy()

    def set_command(self, target: Array) -> None:
        """Set the target positions (nu,) [rad, m] of the servos, clipped to the command ranges."""
        low, high = self._commands
        self.target: Array = np.minimum(np.maximum(target, low), high)

    def torques(self, qpos: Array) -> Array:
        """Compute servo torques at a configuration, (nu,) [N m, N], clipped to effort limits."""
        unlimited = self.kp * (self.target - qpos[-len(self.kp) :])
        torques: Array = np.minimum(np.maximum(unlimited, self.lower), self.upper)
        return torques

    def contacts_at(self, qpos: Array) -> ContactKinematics:
        """Compute slips, penetrations and Jacobians of the touching contacts at a configuration.

        Args:
            qpos: Configuration, shape (nq,).
        """
        anchors, seen = tuple(self.anchors.items()), self._contact_cache
        if seen is None or seen[0] != anchors or not (seen[1] == qpos).all():
            config, feet = Configuration(self.robot, qpos), self._points
            places = config.foot_centres(feet)
            if self._ground_frame_cache[0] != (held := tuple(self.anchors)):
                frames = np.array([self.frames[foot] for foot in held]).reshape(-1, 3, 3)
                rows = [feet.index(foot) for foot in held]
                self._ground_frame_cache = held, rows, frames, cross_matrices(frames[:, 2])
            _, rows, frames, crosses = self._ground_frame_cache
            touch = ContactKinematics(
                config, self.anchors, places[rows], frames, crosses, self.depths(places)
            )
            seen = self._contact_cache = anchors, qpos.copy(), touch
        return seen[2]

    def slips(self, qpos: Array, forces: Array) -> Array:
        """Return slips (along two ground tangents) and penetration of each touching contact.

        A slip is the displacement along the ground since the first contact. With ``feet="pinned"``,
        the result is the quantity s of the slip law. s is the displacement since the start of the
        creep step, projected onto rigid motions of the soles, plus compliance times tangential
        force.

        Args:
            qpos: Configuration, shape (nq,).
            forces: Contact forces, shape (n, 3) [N], in the contact frames.

        Returns:
            Shape (n, 3) [m].
        """
        places: Array = self.contacts_at(qpos).places.copy()
        if self.feet == "pinned" and (
            self.creep_start_slips or self.creep_compliances or self._is_compliant
        ):
            begun = np.array(
                [self.creep_start_slips.get(foot, _ZERO_SLIP) for foot in self.anchors]
            )
            places[:, :2] = self.project_soles(places[:, :2] - begun.reshape(-1, 2))
            places[:, :2] += self._compute_slip_compliances()[:, None] * forces[:, :2]
        return places

    def project_soles(self, slips: Array) -> Array:
        """Replace the slips of a sole's contact points by the nearest rigid motion of the sole.

        A sole is a foot with several contact points.

        Args:
            slips: Slips of the n touching contacts, shape (n, 2, ...) [m], or derivatives.
        """
        feet = tuple(self.anchors)
        if self._sole_projection_cache[0] != feet:
            self._sole_projection_cache = (
                feet,
                compute_sole_projection(self.anchors, self._sole, self.frames),
            )
        whole = self._sole_projection_cache[1]
        return slips if whole is None else np.asarray(np.tensordot(whole, slips, 2), dtype=float)

    def residual(self, qpos: Array, forces: Array) -> Array:
        """Compute the residual of the equilibrium equations, shape (nv + 3 n,).

        The first nv elements are the balance of generalised forces [N, N m]; then two slip
        equations [m or N] and one depth equation [m] per touching contact.

        Args:
            qpos: Configuration, shape (nq,).
            forces: Forces on the n touching contacts, shape (n, 3) [N], in the contact frames.
        """
        touch, places = self.contacts_at(qpos), self.slips(qpos, forces)
        balance = touch.config.static_load() - touch.generalized_force(forces)
        balance[self._joints] -= self.torques(qpos)
        if self.robot.closure is not None:
            balance[self._joints] -= self.robot.closure.constraint_torques(qpos)
        if self.feet == "sliding":
            places[:, :2] = forces[:, :2] + self.scales.slip_stiffness * places[:, :2]
        slipping = self.find_slipping_contacts(forces, places)
        self._force_rows = (
            slice(None) if self.feet == "sliding" else [contact[0] for contact in slipping]
        )
        is_frictionless = self._is_frictionless()
        for row, mu, augmented in slipping:
            if is_frictionless[row]:
                places[row, :2] = forces[row, :2] + self.scales.slip_stiffness * places[row, :2]
                continue
            friction = mu * forces[row, 2] * augmented / np.linalg.norm(augmented)
            places[row, :2] = forces[row, :2] - friction
        sole, depths = self.is_sole_point(), places[:, 2].copy()
        places[:, 2] -= self.equilibrium_depths(forces)
        if sole.any():
            away = self._evaluate_ground_laws(depths)[:, 0] - forces[:, 2]
            places[sole, 2] = (away / self._compute_initial_stiffness())[sole]
        return np.concatenate([balance, places.ravel()])

    def _is_frictionless(self) -> NDArray[np.bool_]:
        """Return a mask (n,) of the touching contacts whose friction is zero."""
        return np.array([self.sliding_friction[foot] <= 0 for foot in self.anchors], dtype=bool)

    def is_sole_point(self) -> NDArray[np.bool_]:
        """Return a mask (n,) of the touching contacts that belong to a foot with several points."""
        return np.array([self._sole_compliance[point] > 0 for point in self.anchors], dtype=bool)

    def _evaluate_ground_laws(self, depths: Array) -> Array:
        """Return normal force [N] and normal stiffness [N/m] of the touching contacts, (n, 2).

        ``depths`` are the penetrations, shape (n,) [m].
        """
        laws = [self.laws[point] for point in self.anchors]
        return np.array(
            [
                (law.force(depth), law.normal_stiffness(depth))
                if depth > -law.margin
                else (0.0, 0.0)
                for law, depth in zip(laws, depths, strict=True)
            ]
        ).reshape(-1, 2)

    def _compute_initial_stiffness(self) -> Array:
        """Return the normal stiffness (n,) [N/m] of each touching contact at first contact."""
        return np.array(
            [self.laws[point].normal_stiffness(-self.laws[point].margin) for point in self.anchors]
        )

    def derivative(self, qpos: Array, forces: Array) -> Array:
        """Compute the Jacobian of the residual by qvel and by contact forces, (nv + 3 n, nv + 3 n).

        Wrenches of welded feet and hands enter the balance as constants.

        Args:
            qpos: Configuration, shape (nq,).
            forces: Forces on the n touching contacts, shape (n, 3) [N], in the contact frames.
        """
        n, touch, size = self.robot.nv, self.contacts_at(qpos), len(forces)
        whole = np.zeros((n + 3 * size, n + 3 * size))
        by_qpos, by_force = whole[:, :n], whole[n:, n:]
        whole[:n, n:] = -touch.jacobians.reshape(-1, n).T
        held = None
        if self._welds is not None:
            held = self._welds.wrenches(touch.config, self.residual(qpos, forces)[:n])
        by_qpos[:n] = touch.balance_rates(forces, held)
        servos = self.kp * (self.target - qpos[-len(self.kp) :])
        moving = (servos > self.lower) & (servos < self.upper)
        by_qpos[self._joints, self._joints] += np.where(moving, self.kp, 0.0)
        if self.robot.closure is not None:
            first = self._joints[0]
            by_qpos[first:n, first:] -= self.robot.closure.constraint_torque_jacobian(qpos)
        rates = by_qpos[n:].reshape(size, 3, n)  # a view
        rates[:] = touch.place_rates()
        if self.feet == "sliding":
            rates[:, :2] *= self.scales.slip_stiffness
        else:
            rates[:, :2] = self.project_soles(rates[:, :2])
        diagonal = np.zeros((size, 3))
        diagonal[:, :2] = (
            1.0 if self.feet == "sliding" else self._compute_slip_compliances()[:, None]
        )
        diagonal[:, 2] = [
            -1 / self.laws[foot].normal_stiffness(depth)
            for foot, depth in zip(
                self.anchors, self.equilibrium_depths(forces).tolist(), strict=True
            )
        ]
        if (sole := self.is_sole_point()).any():
            harder, scales = (
                self._evaluate_ground_laws(touch.places[:, 2])[:, 1],
                self._compute_initial_stiffness(),
            )
            rates[sole, 2] *= (harder / scales)[sole, None]
            diagonal[sole, 2] = -1 / scales[sole]
        whole.reshape(-1)[n * (len(whole) + 1) :: len(whole) + 1] = diagonal.ravel()
        is_frictionless = self._is_frictionless()
        for row, mu, augmented in self.find_slipping_contacts(forces, self.slips(qpos, forces)):
            tangents = slice(3 * row, 3 * row + 2)
            if is_frictionless[row]:
                rates[row, :2] *= self.scales.slip_stiffness
                compliance = 1 + self.scales.slip_stiffness * diagonal[row, 0]
                by_force[tangents, tangents] = compliance * np.eye(2)
                continue
            length = float(np.linalg.norm(augmented))
            along = augmented / length
            turn = mu * forces[row, 2] / length * (np.eye(2) - np.outer(along, along))
            rates[row, :2] = self.scales.friction_penalty * turn @ rates[row, :2]
            kept = 1 - self.scales.friction_penalty * diagonal[row, 0]
            by_force[tangents, tangents] = np.eye(2) - kept * turn
            by_force[tangents, 3 * row + 2] = -mu * along
        return whole

    def _compute_slip_compliances(self) -> Array:
        """Return slip per tangential force of the n touching contacts, shape (n,) [m/N]."""
        return np.array(
            [
                self.creep_compliances.get(foot, 0.0)
                + self._compliance_factor * self._compliance[foot]
                for foot in self.anchors
            ]
        )

    def find_slipping_contacts(
        self, forces: Array, places: Array
    ) -> list[tuple[int, float, Array]]:
        """Find the touching contacts that slip: |f_t - rho s| > mu f_n, or mu = 0.

        f_t - rho s is the augmented tangential force, with the slip s [m] and the
        ``friction_penalty`` rho [N/m]. Empty with ``feet="sliding"``.

        Args:
            forces: Forces on the n touching contacts in their contact frames, shape (n, 3) [N].
            places: Slips along the two tangents and penetration, shape (n, 3) [m], from `slips`.

        Returns:
            Index, friction coefficient (0 if the ground does not press), and augmented tangential
            force, shape (2,) [N], of each such contact.
        """
        if self.feet == "sliding":
            return []
        slipping = []
        rows = zip(self.anchors, forces.tolist(), places.tolist(), strict=True)
        for row, (foot, force, place) in enumerate(rows):
            (x, y, pressing), (slip_x, slip_y, _) = force, place
            augmented = (
                x - self.scales.friction_penalty * slip_x,
                y - self.scales.friction_penalty * slip_y,
            )
            # No friction under pull: the solution is continuous if the contact is released.
            mu = self.sliding_friction[foot] if pressing > 0 else 0.0
            _, tangential = split_force((*augmented, pressing), GROUND_NORMAL)
            if tangential > mu * pressing or self.sliding_friction[foot] <= 0:
                slipping.append((row, mu, np.array(augmented)))
        return slipping

    def solve(self, guess: Solution, *, exact: bool = True) -> Solution | None:
        """Solve the equilibrium equations for the touching contacts by Newton's method.

        Args:
            guess: Initial guess.
            exact: If False, steps reuse the previous Jacobian more often, which is faster. The
                residual may then be larger, but within `RESIDUAL_TOLERANCE`.

        Returns:
            The solution; None if Newton's method fails. With soles and pinned feet, the method is
            repeated with a larger compliance of the contact points before None is returned.
        """
        found = self._iterate_newton(guess, _ROUNDING_RESIDUAL if exact else RESIDUAL_TOLERANCE / 4)
        if found is None and self.is_sole_point().any() and self.feet == "pinned":
            found = self._solve_with_softer_soles(guess)
        return found

    def _solve_with_softer_soles(self, guess: Solution) -> Solution | None:
        """Solve with a large tangential compliance of contact points, then with smaller ones.

        With a small compliance, Newton's method may alternate between two slip directions of a
        sole. None if a solve fails.
        """
        try:
            for self._compliance_factor in _SOLE_COMPLIANCE_FACTORS:
                found = self._iterate_newton(guess)
                if found is None:
                    return None
                guess = found
        finally:
            self._compliance_factor = 1.0
        return guess

    def stack_forces(self, solution: Solution) -> Array:
        """Return the contact forces of a solution, shape (n, 3) [N], in contact frames."""
        return np.array([solution.force(foot) for foot in self.anchors]).reshape(-1, 3)

    def _iterate_newton(
        self, guess: Solution, max_predicted: float = _ROUNDING_RESIDUAL
    ) -> Solution | None:
        """Iterate Newton's method to a scaled residual below `RESIDUAL_TOLERANCE`; None on failure.

        Newton's method fails if residuals alternate, the Jacobian is singular, a step is too long,
        or after `_MAX_ITERATIONS`. The previous Jacobian is reused if the predicted residual
        e[k]^2 / e[k-1] is at most ``max_predicted``.
        """
        qpos, n = guess.qpos, self.robot.nv
        forces, derivative = self.stack_forces(guess), None
        residuals: list[float] = []  # scaled residual of each iteration
        for _ in range(_MAX_ITERATIONS):
            residual = self.apply_welds(qpos, self.residual(qpos, forces))
            residuals.append(self.scales.max_residual(residual, n, self._force_rows))
            if residuals[-1] < RESIDUAL_TOLERANCE:
                named = dict(zip(self.anchors, forces, strict=True))
                return Solution(qpos, named, float(np.abs(residual).max()))
            if _is_alternating(residuals):
                return None
            if derivative is None or residuals[-1] ** 2 > max_predicted * residuals[-2]:
                derivative = self.apply_welds(qpos, self.derivative(qpos, forces))
            # Otherwise the previous derivative suffices: its relative error is e[k] / e[k-1].
            *_, step, singular = lapack.dgesv(derivative, -residual)
            if singular or self.scales.is_step_too_long(step[:n]):
                return None
            qpos, forces = integrate_step(qpos, step[:n]), forces + step[n:].reshape(-1, 3)
        return None

    def apply_welds(self, qpos: Array, equations: Array) -> Array:
        """Insert weld constraints into the equilibrium equations, in place of the unknown wrenches.

        A grip counts as a weld of a point.

        Args:
            qpos: Configuration, shape (nq,).
            equations: Residual (nv + 3 n,) or derivative (nv + 3 n, nv + 3 n) of the equilibrium
                equations; not modified.
        """
        if self._welds is not None:
            return self._welds.insert(self.contacts_at(qpos).config, equations, self.scales.weight)
        if self._num_welded_rows:
            equations = equations.copy()
            equations[: self._num_welded_rows] = 0.0
            if equations.ndim > 1:
                np.fill_diagonal(equations[: self._num_welded_rows], 1.0)
        return equations

    def weld_rows(self, qpos: Array) -> Array:
        """Return the Jacobian (6 w + 3 g, nv) by qvel of w welded bodies and g gripped points.

        Rows are linear and angular velocities in world axes; components of qvel if only the base is
        welded.

        Args:
            qpos: Configuration, shape (nq,).
        """
        if self._welds is None:
            return np.eye(self._num_welded_rows, self.robot.nv)
        return self._welds.jacobian(self.contacts_at(qpos).config)

    def find_violations(self, solution: Solution) -> dict[str, float]:
        """Find the contact points whose assumed state (touching or not) contradicts a solution.

        Returns:
            {contact point: pulling force [N], or penetration beyond the tolerance [m]}.
        """
        feet = self.robot.bearing_points
        return {foot: amount for foot in feet if (amount := self.violation_of(foot, solution)) > 0}

    def violation_of(self, foot: str, solution: Solution) -> float:
        """Return how far a solution contradicts a point's assumed state (touching or not).

        A positive result is a contradiction. For a touching point, the result is the pull of the
        ground [N]; for another point, the penetration plus the contact margin, minus the tolerance
        [m]. 0 for a touching point of a sole, whose depth equation permits no pull.
        """
        if foot in self.anchors:
            return 0.0 if self._sole_compliance[foot] else -float(solution.forces[foot][2])
        depth = self.contacts_at(solution.qpos).depths[foot]
        return depth + self.laws[foot].margin - CONTACT_DEPTH_TOLERANCE * self.scales.length

    def switch_contact(self, foot: str, solution: Solution) -> Solution:
        """Release a touching contact point, or add a free point to the touching contacts.

        Returns:
            Initial guess of the next solve.
        """
        forces = dict(solution.forces)
        if foot in self.anchors:
            del self.anchors[foot], forces[foot]
        else:
            touch, frame = self.contacts_at(solution.qpos), self.robot.contact_frames[foot]
            config = touch.config
            self.anchors[foot] = Anchor(config.frame_position(frame), config.frame_rotation(frame))
            law = self.laws[foot]
            pressed = law.force(max(-law.margin, touch.depths[foot]))
            forces[foot] = np.array([0.0, 0.0, pressed])
        for kept in (self.creep_start_slips, self.creep_compliances):
            kept.pop(foot, None)
        return Solution(solution.qpos, forces, solution.residual)

    def begin_creep(self, solution: Solution, seconds: float) -> None:
        """Start a backward Euler step of creep, the slow slip of loaded contacts in MuJoCo.

        The ``viscosity`` of each contact is constant during the step.

        Args:
            solution: Equilibrium at the start of the step.
            seconds: Duration of the step [s].
        """
        places = self.contacts_at(solution.qpos).places
        self.creep_start_slips = dict(zip(self.anchors, places[:, :2], strict=True))
        self.creep_compliances = {
            foot: seconds / self.viscosity(foot, depth)
            for foot, depth in zip(self.anchors, places[:, 2], strict=True)
        }

    def viscosity(self, foot: str, depth: float) -> float:
        """Return the tangential force per slip velocity of a contact in MuJoCo's friction [N s/m].

        Infinite if the contact does not creep, or has no friction: its tangential force is zero.

        Args:
            foot: Contact point.
            depth: Penetration [m].
        """
        law = self.laws[foot]
        creeps = self.has_creep and depth > -law.margin and self.sliding_friction[foot] > 0
        return law.viscosity(depth) if creeps else math.inf


def _is_alternating(residuals: Sequence[float]) -> bool:
    """Return True if the last four residuals repeat with a period of two iterations."""
    if len(residuals) < 4:
        return False
    first, second, third, fourth = residuals[-4:]
    return (
        abs(third - first) <= _ALTERNATION_RTOL * third
        and abs(fourth - second) <= _ALTERNATION_RTOL * fourth
    )


class Welds:
    """Weld constraints of a stand: welded bodies keep the pose, gripped points keep the position.

    Several welds may be redundant: four welded feet have 24 rows, and at most ``robot.nv`` of these
    are independent. The equilibrium uses a set of rows that are independent in the stand.

    Args:
        robot: Robot.
        stand: Stand that defines the poses of the welds.
    """

    def __init__(self, robot: Robot, stand: Stand) -> None:
        self._contacts, config = stand_contacts(robot, stand), Configuration(robot, stand.qpos)
        frames = (
            robot.contact_frames.get(str(point), robot.base) for point in robot.fixed_parts.values()
        )
        self._poses = [
            (frame, config.frame_position(frame), config.frame_rotation(frame)) for frame in frames
        ]
        self._independent = independent_rows(self.jacobian(config))

    def jacobian(self, config: Configuration) -> Array:
        """Return the Jacobian (6 w + 3 g, nv) by qvel of w welded bodies and g gripped points.

        Rows are linear and angular velocities of bodies, then linear velocities of points, in world
        axes.
        """
        return np.hstack([*self._contacts.weld_columns(config).values()]).T

    def wrenches(self, config: Configuration, balance: Array) -> tuple[Array, Array]:
        """Compute the wrenches of w welds and grips that exert a generalised force.

        Least-squares solution with the smallest norm (N and N m mixed), if the wrenches are not
        determined.

        Args:
            config: Configuration of the robot.
            balance: Generalised force that the wrenches must exert, shape (nv,) [N, N m].

        Returns:
            Jacobian of each weld or grip, shape (w, 6, nv), and wrenches, shape (w, 6) [N, N m],
            both in world axes. The rotational rows and the moment of a grip are zero.
        """
        columns = self._contacts.weld_columns(config).values()
        solution = np.linalg.lstsq(np.hstack([*columns]), balance)[0]
        rows, wrenches = np.zeros((len(columns), 6, len(balance))), np.zeros((len(columns), 6))
        ends = np.cumsum([column.shape[1] for column in columns])
        for weld, (column, end) in enumerate(zip(columns, ends, strict=True)):
            size = column.shape[1]
            rows[weld, :size], wrenches[weld, :size] = column.T, solution[end - size : end]
        return rows, wrenches

    def insert(self, config: Configuration, equations: Array, scale: float) -> Array:
        """Return a copy of equilibrium equations (or their derivative) that contains the welds.

        The first nv equations, the balance of generalised forces, are replaced by the weld
        constraints and by the balance along the motions that the welds permit.

        Args:
            config: Configuration of the robot.
            equations: Residual, shape (m,), or derivative, shape (m, m).
            scale: Factor of the weld constraints [N/m].
        """
        rows, changed = self.jacobian(config)[self._independent], equations.copy()
        count, n = rows.shape
        if equations.ndim == 1:
            changed[:count] = scale * self._pose_errors(config)[self._independent]
        else:
            changed[:count], changed[:count, :n] = 0.0, scale * rows
        changed[count:n] = lapack.null_space(rows).T @ equations[:n]
        return changed

    def _pose_errors(self, config: Configuration) -> Array:
        """Return the deviations (6 w + 3 g,) [m, rad] of welds and grips from the stand's poses."""
        errors = np.ravel(
            [
                (
                    config.frame_position(frame) - position,
                    pin.log3(config.frame_rotation(frame) @ rotation.T),
                )
                for frame, position, rotation in self._poses
            ]
        )
        grips = len(self._contacts.grips)
        fixed = np.ones((len(self._poses), 6), dtype=bool)
        fixed[len(fixed) - grips :, 3:] = False  # a gripped point may rotate
        selected: Array = errors[fixed.ravel()]
        return selected


def independent_rows(rows: Array) -> NDArray[np.intp]:
    """Select a largest set of linearly independent rows of a matrix (m, n); ascending indices."""
    triangle, order = lapack.pivoted_qr(rows.T)
    sizes = np.abs(np.diag(triangle))
    tolerance = max(rows.shape) * np.finfo(float).eps * sizes.max(initial=0.0)
    return np.sort(order[: np.count_nonzero(sizes > tolerance)])


_TANGENTIAL_COMPLIANCE_RATIO = 2.5e-6
"""Slip of compliant contact points under a tangential force of one robot weight, in units of
`EquilibriumScales.length`: 1 um for a height of 0.4 m. Chosen, not tuned."""


def ground_points(robot: Robot, stand: Stand) -> dict[str, Array]:
    """Return {contact point: a point of its ground plane, shape (3,) [m], in the world frame}.

    The returned point is in general not vertically below the contact point.
    """
    ground, found = stand.task.ground, dict[str, Array]()
    for foot, points in robot.feet.items():
        if foot in ground.planes:
            own = np.array([stand.rigid_targets[point] for point in points])
            on = ground.foot_ground_point(foot, own)[0]
        else:  # parallel to the plane through the origin
            on = np.array([0.0, 0.0, ground.heights.get(foot, 0.0)])
        found |= dict.fromkeys(points, on)
    return {point: found[point] for point in robot.contact_points}


def contact_compliance(
    robot: Robot, units: EquilibriumScales
) -> tuple[dict[str, float], dict[str, float]]:
    """Return small tangential compliances [m/N] that keep slip equations independent.

    Without compliance, the slip equations of two points with a constant distance are linearly
    dependent.

    Args:
        robot: Robot.
        units: Weight and height of the robot.

    Returns:
        {contact point: compliance [m/N]}, positive only for the points of soles (feet with several
        points); {contact point: compliance [m/N]} for the slip equations: the same values, but
        positive for all points if the legs cannot move the CoM (`can_move_com`).
    """
    compliance = _TANGENTIAL_COMPLIANCE_RATIO * units.length / units.weight
    flat: dict[str, float] = {}
    for points in robot.feet.values():
        flat |= dict.fromkeys(points, compliance if len(points) > 1 else 0.0)
    return flat, flat if can_move_com(robot) else dict.fromkeys(robot.contact_points, compliance)


def compute_sole_projection(
    anchors: Mapping[str, Anchor], soles: Mapping[str, str], frames: Mapping[str, Array]
) -> Array | None:
    """Compute the matrix that projects slips of contact points onto rigid motions of the soles.

    A tilt of a flat foot (sole) adds micrometres of slip between its points, which would cause
    large tangential forces. The projection removes this part.

    Args:
        anchors: {touching contact point: pose at the first contact}.
        soles: {point: foot that has the point}.
        frames: {point: rotation from the world to the contact frame, shape (3, 3)}.

    Returns:
        Projection of the n slips along the two ground tangents, shape (n, 2, n, 2). None if no foot
        touches with several points.
    """
    rows: dict[str, list[int]] = {}
    for row, point in enumerate(anchors):
        rows.setdefault(soles[point], []).append(row)
    shared = [own for own in rows.values() if len(own) > 1]
    if not shared:
        return None
    size = len(anchors)
    whole: Array = np.eye(2 * size).reshape(size, 2, size, 2)
    places = np.array([frames[point] @ anchor.position for point, anchor in anchors.items()])
    for own in shared:
        x, y = (places[own, :2] - places[own, :2].mean(axis=0)).T
        directions = np.zeros((len(own), 2, 3))
        directions[:, 0, 0] = directions[:, 1, 1] = 1.0
        directions[:, 0, 2], directions[:, 1, 2] = -y, x
        flat = directions.reshape(-1, 3)
        part = (flat @ np.linalg.pinv(flat)).reshape(len(own), 2, len(own), 2)
        whole[np.ix_(own, range(2), own, range(2))] = part
    return whole
