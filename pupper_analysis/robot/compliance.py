"""Static stiffness and viscosity of MuJoCo's contact between a foot and the ground.

MuJoCo's contacts are soft. Input: the contact parameters of a foot. Output: `GroundLaw`, with the
penetration under a normal force (solved by Newton's method), the normal stiffness, and the
viscosity. MuJoCo's regularised friction lets a foot creep (slip slowly), with a speed proportional
to the tangential force. The viscosity is the ratio of force to speed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import mujoco

from pupper_analysis.robot.impedance import clip_solimp, solimp_impedance
from pupper_analysis.robot.robot import Robot

_MAX_ITERATIONS = 200
"""Maximum number of iterations of `GroundLaw.depth` between a lower and an upper bound of the
penetration. Chosen, not tuned."""

_NUM_UNBOUNDED_STEPS = 4
"""Maximum number of Newton steps of `GroundLaw.depth` from the caller's initial guess. Chosen, not
tuned."""

_STEP_RTOL = 1e-9
"""Length of a Newton step, relative to the penetration plus the contact margin [1], at or below
which `GroundLaw.depth` ends. Chosen, not tuned."""

_DEPTH_RTOL = 4e-16
"""Tolerance of the iteration of `GroundLaw.depth`, relative to the penetration plus the contact
margin [1]. The iteration ends if upper and lower bound of the penetration differ by at most this
value. The value is about two roundings of double precision (2.2e-16 each)."""


@dataclass(frozen=True)
class GroundLaw:
    """Force law of MuJoCo's soft ground under a contact point at rest.

    r is the penetration plus the contact margin, and d(r) the impedance of ``solimp``. A is
    MuJoCo's ``diagApprox`` of the contact (approximate inverse inertia), and R = (1 - d)/d A. A
    constraint at rest has the force aref / R, with aref = k d r - b v. Therefore

        normal force:      f = k d(r)^2 r / ((1 - d(r)) A)
        tangential force:  f = -c v, c = b d / ((1 - d) A_t), A_t = A / impratio

    with the creep velocity v, for the elliptic friction cone. For the pyramidal cone see
    `of_contact`. If ``solref`` is positive, k = 1/(dmax timeconst dampratio)^2 and b = 2/(dmax
    timeconst); ``timeconst`` is at least two time steps, unless the MJCF disables ``refsafe``. If
    ``solref`` is not positive, k = -solref[0]/dmax^2 and b = -solref[1]/dmax.

    Source: MuJoCo documentation, "Computation: Solver parameters"; ``engine_core_constraint.c``.

    Attributes:
        stiffness: k [1/s^2].
        damping: b [1/s].
        solimp: dmin, dmax, width [m], midpoint, power; from `clip_solimp`.
        normal: A [1/kg].
        tangential: A_t [1/kg]; infinite without friction.
        margin: Height [m] above the ground at which the contact begins. The penetration at this
            height is -margin.
    """

    stiffness: float
    damping: float
    solimp: tuple[float, ...]
    normal: float
    tangential: float
    margin: float = 0.0

    @staticmethod
    def of_contact(robot: Robot, foot: str) -> GroundLaw:
        """Return MuJoCo's force law between a contact point and the ground.

        The contact parameters are those in ``robot.contacts``.

        The result contains two inverse masses [1/kg], ``normal`` and ``tangential``. A [1/kg] is
        the inverse mass of the body that carries the contact point, as MuJoCo approximates it
        (``body_invweight0``). mu [1] is the sliding friction, ``condim`` [1] the dimension of the
        contact, and ``impratio`` [1] MuJoCo's option.

        - Elliptic friction cone: ``normal`` = A, ``tangential`` = A / impratio.
        - Pyramidal friction cone: ``tangential`` = (1 + mu^2) A / impratio, ``normal`` =
          ``tangential`` mu^2 / (condim - 1). The normal force is the sum of the forces of
          2 (condim - 1) edges.
        - Without friction (mu = 0): ``normal`` = A, ``tangential`` is infinite.

        Args:
            robot: Robot whose MuJoCo model has a ground.
            foot: Name of the contact point.
        """
        model, parameters = robot.mj_model, robot.contacts[foot]
        solimp = clip_solimp(parameters.solimp)
        dmax = solimp[1]
        first, second = parameters.solref
        if first > 0:
            if not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_REFSAFE.value:
                first = max(first, 2 * float(model.opt.timestep))
            stiffness, damping = (dmax * first * second) ** -2, 2 / (dmax * first)
        else:
            stiffness, damping = -first / dmax**2, -second / dmax
        normal = float(model.body_invweight0[robot.contact_places[foot][0], 0])
        # Same bounds as in MuJoCo (mj_makeImpedance), because impratio may be infinite.
        ratio, mu = max(mujoco.mjMINVAL, float(model.opt.impratio)), parameters.sliding_friction
        tangential = max(mujoco.mjMINVAL, normal / ratio)
        if mu > 0 and model.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL.value:
            tangential *= 1 + mu**2
            normal = tangential * mu**2 / (parameters.condim - 1)  # 2 (condim - 1) edges
        return GroundLaw(
            stiffness=float(stiffness),
            damping=float(damping),
            solimp=solimp,
            normal=normal,
            tangential=tangential if mu > 0 else math.inf,
            margin=parameters.margin,
        )

    def impedance(self, depth: float) -> float:
        """Return MuJoCo's impedance d of the contact, from 0 to 1, as defined by ``solimp``.

        Args:
            depth: Penetration [m].
        """
        return float(self._impedance_and_slope(depth)[0])

    def _impedance_and_slope(self, depth: float) -> tuple[float, float]:
        """Return MuJoCo's impedance d, and its derivative [1/m], at a penetration [m]."""
        return solimp_impedance(self.solimp, depth + self.margin)

    def force(self, depth: float) -> float:
        """Return the normal force [N] on a contact point at rest.

        Args:
            depth: Penetration [m]. Below -``margin``, the result is an extrapolation; the force in
                MuJoCo is then zero.
        """
        d, _ = self._impedance_and_slope(depth)
        return self.stiffness * d**2 * (depth + self.margin) / ((1 - d) * self.normal)

    def normal_stiffness(self, depth: float) -> float:
        """Return the normal stiffness of the contact [N/m], by finite differences of ``force``.

        Args:
            depth: Penetration [m].
        """
        start = -self.margin
        low, high = max(depth - 1e-8, start), max(depth, start) + 1e-8
        return (self.force(high) - self.force(low)) / (high - low)

    @cached_property
    def _initial_stiffness(self) -> float:
        """Normal stiffness [N/m] at the start of the contact, at the penetration -``margin``."""
        return self.normal_stiffness(-self.margin)

    def depth(self, force: float, near: float | None = None) -> float:
        """Return the penetration [m] at rest under a normal force.

        Method for positive forces: Newton steps within a lower and an upper bound of the
        penetration. The geometric mean of the bounds (half of the upper bound if the lower bound is
        0) replaces some steps: a step that leaves the bounds, and a step after a step that did not
        halve the residual. With ``near``, up to four Newton steps without bounds are tried first.

        The iteration ends if the relative step is at most 1e-9 (`_STEP_RTOL`), if the relative
        distance of the bounds is at most 4e-16 (`_DEPTH_RTOL`), or after 200 iterations.

        Args:
            force: Normal force [N].
            near: Initial guess of the penetration [m], close to the solution; None if there is
                none.

        Returns:
            Penetration [m]; at most -margin (linear extrapolation) without a positive force.
            Infinite for a positive force on ground without contact force (``solref`` of zero).
        """
        start = -self.margin
        if not self._initial_stiffness:  # solref is zero: no contact force
            return math.inf if force > 0 else start
        linear = force / self._initial_stiffness
        if force <= 0:
            return start + linear
        if near is not None:  # computing bounds would take as long as Newton's method
            x = near - start
            for _ in range(_NUM_UNBOUNDED_STEPS):
                if not x > 0:
                    break
                pressed_force, slope = self._force_and_stiffness(start + x)
                if not slope > 0:
                    break
                previous, x = x, x - (pressed_force - force) / slope
                if abs(x - previous) <= _STEP_RTOL * previous:
                    return start + x
        high = 2 * linear
        while self.force(start + high) < force:  # the stiffness may fall with the penetration
            high *= 2
        # x is the penetration plus the margin.
        low, x, previous = 0.0, linear, math.inf
        for _ in range(_MAX_ITERATIONS):
            pressed_force, slope = self._force_and_stiffness(start + x)
            residual = pressed_force - force
            low, high = (x, high) if residual < 0 else (low, x)
            candidate = x - residual / slope if slope > 0 else math.inf
            if abs(candidate - x) <= _STEP_RTOL * x:
                return start + candidate
            if not low < candidate < high or abs(residual) > previous / 2:
                candidate = math.sqrt(low * high) or high / 2
            if high - low <= _DEPTH_RTOL * x:
                return start + candidate
            x, previous = candidate, abs(residual)
        return start + x

    def _force_and_stiffness(self, depth: float) -> tuple[float, float]:
        """Return the normal force [N] and the normal stiffness [N/m] at a penetration [m]."""
        d, impedance_slope = self._impedance_and_slope(depth)
        penetration = depth + self.margin
        slope_term = impedance_slope * (2 - d) * d / (1 - d) ** 2 * penetration
        force = self.stiffness * d**2 * penetration / ((1 - d) * self.normal)
        return force, self.stiffness * (slope_term + d**2 / (1 - d)) / self.normal

    def viscosity(self, depth: float) -> float:
        """Return the viscosity c [N s/m] of the contact at a penetration ``depth`` [m].

        c is the tangential force divided by the creep velocity: the slow slip that MuJoCo's
        regularised friction permits inside the friction cone.
        """
        d = self.impedance(depth)
        return self.damping * d / ((1 - d) * self.tangential)
