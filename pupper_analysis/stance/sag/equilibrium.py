"""The equations of a servo-driven robot at rest on soft ground, and Newton's iteration on them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray
from scipy import linalg
from scipy.linalg import lapack

from pupper_analysis.base.arrays import cross_matrices
from pupper_analysis.robot.compliance import GroundLaw
from pupper_analysis.robot.configuration import UP, Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import command_ranges, resolve_servo_gains
from pupper_analysis.stance.problem import can_move_com, ground_normals
from pupper_analysis.stance.stand import Stand, stand_contacts


@dataclass(frozen=True, eq=False)
class Anchor:
    """Where a foot touched the ground first: if it is pinned, it has rolled from there.

    Attributes:
        position: (3,) of the sphere's centre (m).
        rotation: (3, 3) of the foot's frame.
    """

    position: Array
    rotation: Array


@dataclass(frozen=True, eq=False)
class Solution:
    """A solution of the equations.

    Attributes:
        qpos: (nq,).
        forces: {foot that touches: (3,)} in the ground's frame there, whose z is its normal (N).
        residual: The largest element left of them (N, N m, m).
    """

    qpos: Array
    forces: dict[str, Array]
    residual: float = math.inf

    def force(self, foot: str) -> Array:
        """Returns the force (3,) on a foot, zero if it does not touch (N)."""
        return self.forces.get(foot, np.zeros(3))


def integrate_step(qpos: Array, step: Array) -> Array:
    """Returns the qpos (nq,) after a step (nv,) in the directions of qvel."""
    if len(qpos) == len(step):  # the base is fixed
        return qpos + step
    moved = qpos.copy()
    moved[:3] += step[:3]
    moved[7:] += step[6:]
    turned = pin.Quaternion(*qpos[3:7].tolist()) * pin.Quaternion(pin.exp3(step[3:6]))
    moved[3:7] = turned.coeffs()[[3, 0, 1, 2]]
    return moved


class ContactKinematics:
    """The feet that touch, at a configuration.

    Args:
        config: The configuration.
        anchors: {foot that touches: where it did so first}.
        centres: (n, 3) where they are (m).
        frames: (n, 3, 3) rotations from the world to the frame of the ground under each, whose z is
            out of it.
        crosses: (n, 3, 3) what takes x to z x x, of these z in the world.
        depths: {foot: how deep it is in the ground (m)}, of those that do not touch as well.

    Attributes:
        config: The configuration.
        depths: As given.
        places: (n, 3) slips along the ground's two tangents, less what the sphere has rolled, and
            depths (m).
        jacobians: (n, 3, nv) of the material point at each contact, in the ground's frame.
        turning: (n, 3, nv) of each foot's rotation, in the world.
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
        # MuJoCo has the contact half way into the penetration.
        self._reach = (np.array([radius[foot] for foot in feet]) - deep / 2)[:, None]
        self._offsets = self._reach[:, None] * crosses  # arms from the contact to the centre
        self._twists = config.foot_twists(feet)
        self._centre, self.turning = self._twists[:, :3], self._twists[:, 3:]
        self.jacobians = frames @ (self._centre + self._offsets @ self.turning)
        before = np.array([anchor.rotation for anchor in held]).reshape(-1, 3, 3)
        self._turned = config.foot_rotations(feet) @ before.transpose(0, 2, 1)
        self._turns = np.array([pin.log3(turned) for turned in self._turned]).reshape(-1, 3)
        begun = np.array([anchor.position for anchor in held]).reshape(-1, 3)
        self._leant = crosses @ self._turns[:, :, None]  # normal x turn
        rolled = self._reach * self._leant[:, :, 0]
        self.places = (frames @ (centres - begun + rolled)[:, :, None])[:, :, 0]
        self.places[:, 2] = deep

    def place_rates(self) -> Array:
        """Returns the derivative (n, 3, nv) of ``places`` by a step in the directions of qvel."""
        deeper = self._deeper
        # What rotates a foot changes its rotation vector by the inverse of the left Jacobian.
        logs = np.array([pin.Jlog3(turned) for turned in self._turned]).reshape(-1, 3, 3)
        turns = logs.transpose(0, 2, 1) @ self.turning
        rates: Array = self._centre + self._offsets @ turns
        # The arm gets shorter by half of what the foot goes deeper.
        rates -= self._leant / 2 * deeper[:, None, :]
        rates = self._frames @ rates
        rates[:, 2] = deeper
        return rates

    @cached_property
    def _deeper(self) -> Array:
        """The derivative (n, nv) of the depths."""
        deeper: Array = -(self._normals[:, None] @ self._centre)[:, 0]
        return deeper

    def push(self, forces: Array) -> Array:
        """Returns the generalised force (nv,) of forces (n, 3), in the ground's frame."""
        pushed: Array = forces.ravel() @ self.jacobians.reshape(forces.size, self.config.robot.nv)
        return pushed

    def balance_rates(self, forces: Array, held: tuple[Array, Array] | None = None) -> Array:
        """Returns the derivative (nv, nv) of gravity less ``push`` by a step.

        Args:
            forces: (n, 3) in the ground's frame (N), which keep their direction.
            held: Jacobians (w, 6, nv) and wrenches (w, 6) of welds, which do so too.
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
        rates = self.config.pushed_rates(twists, wrenches)
        # As a foot goes deeper its contact comes nearer to the centre.
        moved = (across[:, None] @ self.turning)[:, 0]
        change: Array = rates + moved.T @ (self._deeper / 2)
        return change


Array = NDArray[np.float64]

_TRUST = 0.5, 4.0  # rad, heights: a longer Newton step has left the branch
_WEAK = 4e-6  # weights per height: holds a sliding robot in its place as creep does
_RHO = 4.0  # weights per height: weighs slip against force in telling which way a foot slips


@dataclass(frozen=True)
class EquilibriumScales:
    """A robot's weight, and the height at which it carries that.

    Attributes:
        weight: N.
        length: Of its com above the lowest foot that carries, in its stand (m); of one that is
            fixed a scale of it.
        moves: How many of its coordinates move its base along an axis: three, or none.
    """

    weight: float
    length: float
    moves: int = 3

    @staticmethod
    def of(robot: Robot, stand: Stand) -> EquilibriumScales:
        """Returns those of a robot in a stand."""
        weight = robot.usual_weight
        if robot.bolted or robot.welds:
            length = robot.stand_height or float(robot.mj_model.stat.extent)
            return EquilibriumScales(weight, length, 3 if robot.floating else 0)
        lowest = min(float(stand.foot_targets[foot][2]) for foot in stand.stance_feet)
        com = Configuration(robot, stand.qpos).center_of_mass()
        return EquilibriumScales(weight, float(com[2]) - lowest)

    @property
    def stiffness(self) -> float:
        """Of a servo that gives the weight at a lever of the height for a turn of 1 (N m/rad)."""
        return self.weight * self.length

    @property
    def slip_stiffness(self) -> float:
        """N/m: holds a sliding robot in its place."""
        return _WEAK * self.weight / self.length

    @property
    def friction_penalty(self) -> float:
        """N/m: weighs slip against force; any would do."""
        return _RHO * self.weight / self.length

    def max_residual(self, residual: Array, nv: int, forces: slice | list[int]) -> float:
        """Returns the largest element of a residual of the equations, in these units.

        Args:
            residual: nv of balance, and three of each foot that touches.
            nv: Of the robot.
            forces: The feet whose equations of slip are of forces.
        """
        units = np.full(len(residual), self.length)
        units[: self.moves], units[self.moves : nv] = self.weight, self.weight * self.length
        units[nv:].reshape(-1, 3)[forces, :2] = self.weight
        return float(np.abs(residual / units).max())

    def is_too_far(self, step: Array) -> bool:
        """Tells whether a step (nv,) leaves the branch that it begins on."""
        moved, turned = np.abs(step[: self.moves]), np.abs(step[self.moves :]).max()
        return not (turned < _TRUST[0] and moved.max(initial=0.0) < _TRUST[1] * self.length)


Feet = Literal["pinned", "sliding"]
RESIDUAL_TOLERANCE = 3e-12
"""What the equations of an equilibrium may leave over, in weights and in heights of the stand."""

_ROUNDING = 3e-16
"""What of that is no more than rounding."""

CONTACT_DEPTH_TOLERANCE = 1e-8
"""A foot this deep in the ground, or less, does not touch it yet (heights): 1e-6 N under v3."""

_SOFTER = (1e3, 1e2, 1e1, 1.0)
"""Parts of what a sole gives, by which it is solved where Newton's iteration fails at once."""

_MAX_ITERATIONS = 16
"""Of 5,148 solutions that were found all took 12 or fewer."""

_NOWHERE = np.zeros(2)  # m: where a foot sticks that has not crept


class SagEquilibrium:
    """The equations of the equilibrium, for a servo ``target`` (nu,) and the feet that touch.

        g(q) - S^T tau - sum J_i^T f_i = 0,  depth_i(q) = depth of f_i

    for the feet in ``anchors``, J_i the Jacobian of the material point at the contact. Pinned,
    that point has not slipped, but for what it crept,
    as long as |f_t| <= mu f_n; else it has slipped by s, and f_t = -mu f_n s / |s|. Both in one:
    f_t is f_t - rho s, for any rho > 0, cut to the length mu f_n (Alart and Curnier 1991).
    Sliding, f_t = 0. What is welded stays, and its wrenches are whatever that takes: of the balance
    only the part along motions that leave it is asked; see ``apply_welds``.
    """

    def __init__(
        self,
        robot: Robot,
        stand: Stand,
        kp: ArrayLike | None,
        feet: Feet,
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
        self.laws = {foot: GroundLaw.of(robot, foot) for foot in self._points}
        self._commands = command_ranges(robot).T
        self.command(stand.joint_positions(robot))
        self._sole = {point: sole for sole, points in robot.feet.items() for point in points}
        config = Configuration(robot, stand.qpos)
        frames = robot.contact_frames
        self.anchors = {
            foot: Anchor(stand.foot_targets[foot], config.frame_rotation(frames[foot]))
            for foot in stand.stance_feet
        }
        self.units = EquilibriumScales.of(robot, stand)
        self._in_newtons: slice | list[int] = []
        self._pliancy, self._give = contact_compliance(robot, self.units)
        self._giving, self._softer = any(self._give.values()), 1.0
        self._touch: tuple[object, Array, ContactKinematics] | None = None
        self._rigid: tuple[tuple[str, ...], Array | None] = (), None
        nothing = np.zeros((0, 3, 3))
        self._under: tuple[tuple[str, ...], list[int], Array, Array] = (), [], nothing, nothing
        self._sunk: tuple[tuple[tuple[str, float], ...], Array] = (), np.zeros(0)
        self._creeps = robot.mj_model.opt.noslip_iterations == 0  # with that solver feet stay
        self.crept: dict[str, Array] = {}  # m: where creep has taken a foot, by slip
        self.yielding: dict[str, float] = {}  # m/N: creep in this step per force
        self.sliding_friction = {
            foot: contact.sliding_friction for foot, contact in robot.contacts.items()
        }
        self._joints = np.arange(robot.nv - robot.nu, robot.nv)
        # Of a base alone that is welded the equations are left out.
        self._still = 6 if [*robot.welds.values()] == [None] else 0
        self._welds = Welds(robot, stand) if robot.welds and not self._still else None

    def depths(self, places: Array) -> dict[str, float]:
        """Returns how deep every foot is in the ground or its step; negative: above it (m).

        Args:
            places: (k, 3) the centres of all feet (m).
        """
        seen = zip(self.frames, self._planes, places.tolist(), strict=True)
        return {
            foot: radius - ((x - on[0]) * a + (y - on[1]) * b + (z - on[2]) * c)
            for foot, (radius, a, b, c, on), (x, y, z) in seen
        }

    def equilibrium_depths(self, forces: Array) -> Array:
        """Returns how deep the feet that touch sink (n,) under forces (n, 3)."""
        asked = tuple(zip(self.anchors, forces[:, 2].tolist(), strict=True))
        if asked != self._sunk[0]:
            # By the last step, or the last place, or another foot's, they are known nearly.
            known = {foot: depth for (foot, _), depth in zip(*self._sunk, strict=True)}
            depth, depths = None, []
            for foot, force in asked:
                depth = self.laws[foot].depth(force, known.get(foot, depth))
                depths.append(depth)
            self._sunk = asked, np.array(depths)
        return self._sunk[1].copy()

    def command(self, target: Array) -> None:
        """Commands the servos joint positions (nu,), which are cut off where the file has it so."""
        low, high = self._commands
        self.target: Array = np.minimum(np.maximum(target, low), high)

    def torques(self, qpos: Array) -> Array:
        """Returns the servos' torques (nu,)."""
        asked = self.kp * (self.target - qpos[-len(self.kp) :])
        torques: Array = np.minimum(np.maximum(asked, self.lower), self.upper)
        return torques

    def contacts_at(self, qpos: Array) -> ContactKinematics:
        """Looks at the feet that touch, or has looked at them just now."""
        anchors, seen = tuple(self.anchors.items()), self._touch
        if seen is None or seen[0] != anchors or not (seen[1] == qpos).all():
            config, feet = Configuration(self.robot, qpos), self._points
            places = config.foot_places(feet)
            if self._under[0] != (held := tuple(self.anchors)):
                frames = np.array([self.frames[foot] for foot in held]).reshape(-1, 3, 3)
                rows = [feet.index(foot) for foot in held]
                self._under = held, rows, frames, cross_matrices(frames[:, 2])
            _, rows, frames, crosses = self._under
            touch = ContactKinematics(
                config, self.anchors, places[rows], frames, crosses, self.depths(places)
            )
            seen = self._touch = anchors, qpos.copy(), touch
        return seen[2]

    def slips(self, qpos: Array, forces: Array) -> Array:
        """Returns slips from where feet stick, less what they give, and depths (n, 3)."""
        places: Array = self.contacts_at(qpos).places.copy()
        if self.feet == "pinned" and (self.crept or self.yielding or self._giving):
            begun = np.array([self.crept.get(foot, _NOWHERE) for foot in self.anchors])
            places[:, :2] = self.project_soles(places[:, :2] - begun.reshape(-1, 2))
            places[:, :2] += self._yields()[:, None] * forces[:, :2]
        return places

    def project_soles(self, slips: Array) -> Array:
        """Returns the slips (n, 2, ...) of the feet that touch, those of each sole as one body."""
        feet = tuple(self.anchors)
        if self._rigid[0] != feet:
            self._rigid = feet, rigid_slips(self.anchors, self._sole, self.frames)
        whole = self._rigid[1]
        return slips if whole is None else np.asarray(np.tensordot(whole, slips, 2), dtype=float)

    def residual(self, qpos: Array, forces: Array) -> Array:
        """Returns the equations (nv + 3 n,): balance, and per foot two of slip, one of depth."""
        touch, places = self.contacts_at(qpos), self.slips(qpos, forces)
        balance = touch.config.load() - touch.push(forces)
        balance[self._joints] -= self.torques(qpos)
        if self.robot.closure is not None:
            balance[self._joints] -= self.robot.closure.springs(qpos)
        if self.feet == "sliding":
            places[:, :2] = forces[:, :2] + self.units.slip_stiffness * places[:, :2]
        slipping = self.find_slipping_contacts(forces, places)
        self._in_newtons = slice(None) if self.feet == "sliding" else [one[0] for one in slipping]
        for row, mu, tried in slipping:
            along = tried / np.linalg.norm(tried)
            places[row, :2] = forces[row, :2] - mu * forces[row, 2] * along
        sole, depths = self.is_sole_point(), places[:, 2].copy()
        places[:, 2] -= self.equilibrium_depths(forces)
        if sole.any():
            away = self._pressed(depths)[:, 0] - forces[:, 2]
            places[sole, 2] = (away / self._scales())[sole]
        return np.concatenate([balance, places.ravel()])

    def is_sole_point(self) -> NDArray[np.bool_]:
        """Tells which of the points that touch (n,) belong to a flat foot."""
        return np.array([self._pliancy[point] > 0 for point in self.anchors], dtype=bool)

    def _pressed(self, depths: Array) -> Array:
        """Returns normal force (N) and stiffness (N/m), (n, 2), at depths (n,): no pull."""
        laws = [self.laws[point] for point in self.anchors]
        return np.array(
            [
                (law.force(depth), law.rate(depth)) if depth > -law.margin else (0.0, 0.0)
                for law, depth in zip(laws, depths, strict=True)
            ]
        ).reshape(-1, 2)

    def _scales(self) -> Array:
        """Returns the stiffness (n,) by which a force's equation becomes one of depth (N/m)."""
        return np.array([self.laws[point].rate(-self.laws[point].margin) for point in self.anchors])

    def derivative(self, qpos: Array, forces: Array) -> Array:
        """Returns the residual's derivative, in closed form."""
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
            by_qpos[first:n, first:] -= self.robot.closure.spring_rates(qpos)
        rates = by_qpos[n:].reshape(size, 3, n)  # a view
        rates[:] = touch.place_rates()
        if self.feet == "sliding":
            rates[:, :2] *= self.units.slip_stiffness
        else:
            rates[:, :2] = self.project_soles(rates[:, :2])
        diagonal = np.zeros((size, 3))
        diagonal[:, :2] = 1.0 if self.feet == "sliding" else self._yields()[:, None]
        diagonal[:, 2] = [
            -1 / self.laws[foot].rate(depth)
            for foot, depth in zip(
                self.anchors, self.equilibrium_depths(forces).tolist(), strict=True
            )
        ]
        if (sole := self.is_sole_point()).any():
            harder, scales = self._pressed(touch.places[:, 2])[:, 1], self._scales()
            rates[sole, 2] *= (harder / scales)[sole, None]
            diagonal[sole, 2] = -1 / scales[sole]
        whole.reshape(-1)[n * (len(whole) + 1) :: len(whole) + 1] = diagonal.ravel()
        for row, mu, tried in self.find_slipping_contacts(forces, self.slips(qpos, forces)):
            length = float(np.linalg.norm(tried))
            along, tangents = tried / length, slice(3 * row, 3 * row + 2)
            turn = mu * forces[row, 2] / length * (np.eye(2) - np.outer(along, along))
            rates[row, :2] = self.units.friction_penalty * turn @ rates[row, :2]
            kept = 1 - self.units.friction_penalty * diagonal[row, 0]
            by_force[tangents, tangents] = np.eye(2) - kept * turn
            by_force[tangents, 3 * row + 2] = -mu * along
        return whole

    def _yields(self) -> Array:
        return np.array(
            [
                self.yielding.get(foot, 0.0) + self._softer * self._give[foot]
                for foot in self.anchors
            ]
        )

    def find_slipping_contacts(
        self, forces: Array, places: Array
    ) -> list[tuple[int, float, Array]]:
        """Returns number, mu and f_t - rho s (2,) of the pinned feet that slip.

        Args:
            forces: (n, 3).
            places: (n, 3) with s in its first two columns.
        """
        if self.feet == "sliding":
            return []
        found = []
        rows = zip(self.anchors, forces.tolist(), places.tolist(), strict=True)
        for row, (foot, force, place) in enumerate(rows):
            (x, y, pressing), (slip_x, slip_y, _) = force, place
            tried = (
                x - self.units.friction_penalty * slip_x,
                y - self.units.friction_penalty * slip_y,
            )
            # Without friction where it pulls: so nothing jumps when it is let go of there.
            mu = self.sliding_friction[foot] if pressing > 0 else 0.0
            if math.hypot(*tried) > mu * pressing:
                found.append((row, mu, np.array(tried)))
        return found

    def solve(self, guess: Solution, *, exact: bool = True) -> Solution | None:
        """Solves the equations for the feet that touch; None if it fails.

        Args:
            guess: Where to begin.
            exact: To rounding, where that takes one step more; else to ``RESIDUAL_TOLERANCE``.
        """
        found = self._newton(guess, _ROUNDING if exact else RESIDUAL_TOLERANCE / 4)
        if found is None and self.is_sole_point().any() and self.feet == "pinned":
            found = self._by_softer_soles(guess)
        return found

    def _by_softer_soles(self, guess: Solution) -> Solution | None:
        """Solves with soles that give more than they do, and then less and less.

        Where all points of a sole slip, which way each does depends on the others', and Newton's
        iteration may go to and fro between two ways; on what gives they change little by little.
        """
        try:
            for self._softer in _SOFTER:
                found = self._newton(guess)
                if found is None:
                    return None
                guess = found
        finally:
            self._softer = 1.0
        return guess

    def stack_forces(self, solution: Solution) -> Array:
        """Returns the forces (n, 3) on the feet that touch."""
        return np.array([solution.force(foot) for foot in self.anchors]).reshape(-1, 3)

    def _newton(self, guess: Solution, left: float = _ROUNDING) -> Solution | None:
        """Returns where Newton's iteration ends; ``left`` is what a kept derivative may leave."""
        qpos, n = guess.qpos, self.robot.nv
        forces, derivative = self.stack_forces(guess), None
        left_over: list[float] = []  # the same in the robot's units
        for _ in range(_MAX_ITERATIONS):
            residual = self.apply_welds(qpos, self.residual(qpos, forces))
            left_over.append(self.units.max_residual(residual, n, self._in_newtons))
            if left_over[-1] < RESIDUAL_TOLERANCE:
                named = dict(zip(self.anchors, forces, strict=True))
                return Solution(qpos, named, float(np.abs(residual).max()))
            if derivative is None or left_over[-1] ** 2 > left * left_over[-2]:
                derivative = self.apply_welds(qpos, self.derivative(qpos, forces))
            # Otherwise the last one leaves no more: it errs by twice the share that its step left.
            *_, step, singular = lapack.dgesv(derivative, -residual)
            if singular or self.units.is_too_far(step[:n]):
                return None
            qpos, forces = integrate_step(qpos, step[:n]), forces + step[n:].reshape(-1, 3)
        return None

    def apply_welds(self, qpos: Array, equations: Array) -> Array:
        """Returns equations (nv + 3 n,), or their derivative, with those of welds among balance."""
        if self._welds is not None:
            return self._welds.insert(self.contacts_at(qpos).config, equations, self.units.weight)
        if self._still:
            equations = equations.copy()
            equations[: self._still] = 0.0
            if equations.ndim > 1:
                np.fill_diagonal(equations[: self._still], 1.0)
        return equations

    def weld_rows(self, qpos: Array) -> Array:
        """Returns the Jacobian (6 w, nv) of what is welded."""
        if self._welds is None:
            return np.eye(self._still, self.robot.nv)
        return self._welds.jacobian(self.contacts_at(qpos).config)

    def find_violations(self, solution: Solution) -> dict[str, float]:
        """Returns the feet that a solution has wrong, and by how much.

        They pull (N), or are in the ground without touching it (m).
        """
        feet = self.robot.bearing
        return {foot: amount for foot in feet if (amount := self.violation_of(foot, solution)) > 0}

    def violation_of(self, foot: str, solution: Solution) -> float:
        """Returns with how much a touching foot pulls (N), or how deep another one is (m)."""
        if foot in self.anchors:
            # A flat foot's points let go of the ground in their own equations.
            return 0.0 if self._pliancy[foot] else -float(solution.forces[foot][2])
        depth = self.contacts_at(solution.qpos).depths[foot]
        return depth + self.laws[foot].margin - CONTACT_DEPTH_TOLERANCE * self.units.length

    def switch(self, foot: str, solution: Solution) -> Solution:
        """Lets go of a foot that touches, or lets another one touch where it is.

        Returns:
            What to begin the next iteration with.
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
        for kept in (self.crept, self.yielding):
            kept.pop(foot, None)
        return Solution(solution.qpos, forces, solution.residual)

    def begin_creep(self, solution: Solution, seconds: float) -> None:
        """Begins a step of creep, with the viscosities of where it begins."""
        places = self.contacts_at(solution.qpos).places
        self.crept = dict(zip(self.anchors, places[:, :2], strict=True))
        self.yielding = {
            foot: seconds / self.viscosity(foot, depth)
            for foot, depth in zip(self.anchors, places[:, 2], strict=True)
        }

    def viscosity(self, foot: str, depth: float) -> float:
        """Returns tangential force per velocity (N s/m); infinite where a foot pulls or stays."""
        law = self.laws[foot]
        return law.viscosity(depth) if self._creeps and depth > -law.margin else math.inf


class Welds:
    """Weld constraints of a stand: welded bodies keep their pose, gripped points their position.

    Several welds may be redundant: of the 24 rows of four welded feet at most ``robot.nv`` are
    independent. The equilibrium uses a set of independent rows, which is selected at the stand.

    Args:
        robot: Robot.
        stand: Stand that defines the poses of the welds.
    """

    def __init__(self, robot: Robot, stand: Stand) -> None:
        self._contacts, config = stand_contacts(robot, stand), Configuration(robot, stand.qpos)
        frames = (
            robot.contact_frames.get(str(point), robot.base) for point in robot.welds.values()
        )
        self._poses = [
            (frame, config.frame_position(frame), config.frame_rotation(frame)) for frame in frames
        ]
        self._independent = independent_rows(self.jacobian(config))

    def jacobian(self, config: Configuration) -> Array:
        """Return the Jacobian of all welds, shape (6 w + 3 g, nv), in the world frame.

        Rows of a weld: linear and angular velocity. Rows of a grip: linear velocity.
        """
        return np.hstack([*self._contacts.weld_columns(config).values()]).T

    def wrenches(self, config: Configuration, balance: Array) -> tuple[Array, Array]:
        """Return the wrenches of the welds that balance a generalised force.

        Of redundant welds, the wrenches with the least norm (N and N m mixed).

        Args:
            config: Configuration of the robot.
            balance: Generalised force, shape (nv,) [N, N m].

        Returns:
            Jacobian of each weld, shape (w, 6, nv), and wrench of each weld, shape (w, 6) [N, N m].
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
        """Return the equilibrium equations, or their derivative, with the weld constraints.

        The first ``nv`` equations are the balance of generalised forces. Weld constraints, and the
        balance along the motions that the welds permit, replace the balance.

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
        changed[count:n] = linalg.null_space(rows).T @ equations[:n]
        return changed

    def _pose_errors(self, config: Configuration) -> Array:
        """Return the deviation of all welds from their poses, shape (6 w + 3 g,) [m, rad]."""
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
    """Return the indices, in ascending order, of a largest set of linearly independent rows."""
    _, triangle, order = linalg.qr(rows.T, mode="economic", pivoting=True)
    sizes = np.abs(np.diag(triangle))
    tolerance = max(rows.shape) * np.finfo(float).eps * sizes.max(initial=0.0)
    return np.sort(order[: np.count_nonzero(sizes > tolerance)])


_PLIANT = 2.5e-6
"""How far contact points, pinned, give under a tangential force of the robot's weight (heights): a
biped of 10 kg by some micrometre."""


def ground_points(robot: Robot, stand: Stand) -> dict[str, Array]:
    """Returns a point {contact point: (3,)} of the ground under each (m)."""
    ground, found = stand.task.ground, dict[str, Array]()
    for foot, points in robot.feet.items():
        if foot in ground.planes:
            own = np.array([stand.rigid_targets[point] for point in points])
            on = ground.middle(foot, own)[0]
        else:  # parallel to the plane through the origin
            on = np.array([0.0, 0.0, ground.heights.get(foot, 0.0)])
        found |= dict.fromkeys(points, on)
    return {point: found[point] for point in robot.contact_points}


def contact_compliance(
    robot: Robot, units: EquilibriumScales
) -> tuple[dict[str, float], dict[str, float]]:
    """Returns how far the points of soles give, and all contact points, {point: m/N}.

    A sole's move as one body: if none gave, the equations would say the same several times. A foot
    with one point gives nothing, but where legs cannot place feet in all directions: the two of a
    pair of legs that swing in planes keep their distance as the points of a sole do.

    Args:
        robot: The robot.
        units: Its weight, and its height.
    """
    give = _PLIANT * units.length / units.weight
    flat: dict[str, float] = {}
    for points in robot.feet.values():
        flat |= dict.fromkeys(points, give if len(points) > 1 else 0.0)
    return flat, flat if can_move_com(robot) else dict.fromkeys(robot.contact_points, give)


def rigid_slips(
    anchors: Mapping[str, Anchor], soles: Mapping[str, str], frames: Mapping[str, Array]
) -> Array | None:
    """Returns the projection (n, 2, n, 2) of slips on those of rigid soles; None without soles.

    A sole is rigid: its points slip along the ground by what moves and turns it. What is left of
    their slips, micrometres by which it tilts, would have them rub against each other as hard as
    friction lets them, which creeps away at once.

    Args:
        anchors: {point that touches: where it did so first}.
        soles: {point: the foot that has it}.
        frames: {point: (3, 3) rotation from the world to the frame of the ground under it}.
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
