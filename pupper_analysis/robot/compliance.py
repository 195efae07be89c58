"""How soft the ground under a foot is in MuJoCo, at rest and creeping."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import mujoco

from pupper_analysis.robot.impedance import clip_solimp, solimp_impedance
from pupper_analysis.robot.robot import Robot

_MAX_ITERATIONS = 200  # in search of a depth: 5 do, but for laws that no Newton step fits

_FREELY = 4  # Newton steps from a depth that is not far off; two do

_QUADRATIC = 1e-9  # of a depth: a Newton step as short as that leaves the square of it

_ROUNDING = 4e-16  # of a depth


@dataclass(frozen=True)
class GroundLaw:
    """The ground under one foot, as MuJoCo has it at rest.

    With r the penetration, and the contact's margin, d(r) the impedance of ``solimp`` and A the
    ``diagApprox`` of the contact, R = (1 - d)/d A; a constraint at rest has the force aref / R,
    aref = k d r - b v. So

        normal force:      f = k d(r)^2 r / ((1 - d(r)) A)
        tangential force:  f = -c v, c = b d / ((1 - d) A_t), A_t = A / impratio  (a creeping foot)

    with k = 1/(dmax timeconst dampratio)^2 and b = 2/(dmax timeconst), or -solref/(dmax^2, dmax).

    Source: MuJoCo documentation, "Computation: Solver parameters"; engine_core_constraint.c.

    Attributes:
        stiffness: k (1/s^2).
        damping: b (1/s).
        solimp: dmin, dmax, width (m), midpoint, power; within MuJoCo's bounds.
        normal: A (1/kg).
        tangential: A_t (1/kg); infinite without friction.
        margin: Height above the ground from which on the contact pushes (m). Depths are those of
            the shapes: they begin at -margin.
    """

    stiffness: float
    damping: float
    solimp: tuple[float, ...]
    normal: float
    tangential: float
    margin: float = 0.0

    @staticmethod
    def of(robot: Robot, foot: str) -> GroundLaw:
        """Returns the law of one foot's contact with the ground, cone elliptic or pyramidal."""
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
        # Bounded as MuJoCo bounds it (mj_makeImpedance): an impratio may be infinite.
        ratio, mu = max(mujoco.mjMINVAL, float(model.opt.impratio)), parameters.sliding_friction
        tangential = max(mujoco.mjMINVAL, normal / ratio)
        if mu > 0 and model.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL.value:
            tangential *= 1 + mu**2
            normal = tangential * mu**2 / (parameters.condim - 1)  # of its 2 (condim - 1) edges
        return GroundLaw(
            stiffness=float(stiffness),
            damping=float(damping),
            solimp=solimp,
            normal=normal,
            tangential=tangential if mu > 0 else math.inf,
            margin=parameters.margin,
        )

    def impedance(self, depth: float) -> float:
        """Returns d at a penetration (m): from dmin at none to dmax at ``width``."""
        return float(self._impeded(depth)[0])

    def _impeded(self, depth: float) -> tuple[float, float]:
        """Returns ``impedance`` and its derivative (1/m)."""
        return solimp_impedance(self.solimp, depth + self.margin)

    def force(self, depth: float) -> float:
        """Returns the normal force (N) at a penetration (m) at rest."""
        d, _ = self._impeded(depth)
        return self.stiffness * d**2 * (depth + self.margin) / ((1 - d) * self.normal)

    def rate(self, depth: float) -> float:
        """Returns the normal stiffness (N/m) at a penetration (m)."""
        start = -self.margin
        low, high = max(depth - 1e-8, start), max(depth, start) + 1e-8
        return (self.force(high) - self.force(low)) / (high - low)

    @cached_property
    def _first_rate(self) -> float:
        """The normal stiffness (N/m) where the contact begins."""
        return self.rate(-self.margin)

    def depth(self, force: float, near: float | None = None) -> float:
        """Returns the penetration (m) under a normal force (N); linear where the foot pulls.

        Args:
            force: The force.
            near: A penetration that is not far from it (m), to begin with.
        """
        start = -self.margin
        if not self._first_rate:  # a solref of zeros: nothing pushes back
            return math.inf if force > 0 else start
        linear = force / self._first_rate
        if force <= 0:
            return start + linear
        if near is not None:  # where Newton's iteration converges, as a rule: bounds cost as much
            x = near - start
            for _ in range(_FREELY):
                if not x > 0:
                    break
                found, slope = self._pressed(start + x)
                if not slope > 0:
                    break
                last, x = x, x - (found - force) / slope
                if abs(x - last) <= _QUADRATIC * last:
                    return start + x
        high = 2 * linear
        while self.force(start + high) < force:  # on ground that gets softer as a foot sinks
            high *= 2
        # Newton's iteration, held between bounds that close in on x, how deep beyond the margin.
        low, x, last = 0.0, linear, math.inf
        for _ in range(_MAX_ITERATIONS):
            found, slope = self._pressed(start + x)
            left = found - force
            low, high = (x, high) if left < 0 else (low, x)
            tried = x - left / slope if slope > 0 else math.inf
            if abs(tried - x) <= _QUADRATIC * x:
                return start + tried
            if not low < tried < high or abs(left) > last / 2:
                tried = math.sqrt(low * high) or high / 2
            if high - low <= _ROUNDING * x:
                return start + tried
            x, last = tried, abs(left)
        return start + x

    def _pressed(self, depth: float) -> tuple[float, float]:
        """Returns ``force`` (N) and its derivative (N/m)."""
        d, steeper = self._impeded(depth)
        deep = depth + self.margin
        changing = steeper * (2 - d) * d / (1 - d) ** 2 * deep
        force = self.stiffness * d**2 * deep / ((1 - d) * self.normal)
        return force, self.stiffness * (changing + d**2 / (1 - d)) / self.normal

    def viscosity(self, depth: float) -> float:
        """Returns c (N s/m), tangential force per creep velocity, at a penetration (m)."""
        d = self.impedance(depth)
        return self.damping * d / ((1 - d) * self.tangential)
