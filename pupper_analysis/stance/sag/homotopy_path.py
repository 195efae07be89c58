"""The way of a robot from its stand to where it comes to rest."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import (
    Diagnostic,
    Quantity,
    Term,
    diagnose,
)
from pupper_analysis.base.errors import NoEquilibriumError
from pupper_analysis.robot.servos import command_lead
from pupper_analysis.stance.sag.contact_kinematics import Solution
from pupper_analysis.stance.sag.equilibrium import SagEquilibrium
from pupper_analysis.stance.sag.stiffness import stiffness_at
from pupper_analysis.stance.stand import stand_statics
from pupper_analysis.statics.equilibrium import ForceDistribution, GravityCompensation

Array = NDArray[np.float64]

_LEAST_STEP = 1 / 64  # of the feed-forward, in one step
_CAREFUL = 1 / 64  # likewise: an unstable equilibrium is one only if such small steps lead to it
_SHARE_TOLERANCE = 1e-7  # of the feed-forward: when a foot touches or lets go, to nanometres
_MAX_EVENTS = 24  # feet that touch or let go on the way: more is chatter
_NEARLY = 0.95  # of its friction: a foot that is about to slide, as far as a step can tell
CREEP_STEPS = 20
"""Backward Euler steps in which feet creep: with 20 a robot that falls after 15 s does after 14."""

_LEAST_EULER = 1 / 4096
"""Part of such a step that is tried at least: 0.1 ms of 12 s, in which contacts move less than what
they give."""


class HomotopyPath:
    """The way of an equilibrium from the stand: feed-forward is taken away, then the feet creep.

    Args:
        system: The equations.
        end: (nu,) what the servos are commanded at its end (rad); by default the stand's joint
            positions, without any feed-forward.
        exact: Whether its beginning is to be so to rounding; where it is only gone on from, not.

    Attributes:
        system: The equations; their feet touch as they do where the way has come to.
        balance: What holds the stand itself.
        share: Of the feed-forward, how much is taken away.
        solution: The equilibrium there.
        iterations: Newton steps so far.
        crept: For how long feet have crept (s).

    Raises:
        StaticsInfeasibleError: If no contact forces balance the stand itself.
        NoEquilibriumError: If it is no equilibrium on soft ground.
    """

    def __init__(
        self, system: SagEquilibrium, end: Array | None = None, *, exact: bool = True
    ) -> None:
        self.system, stand = system, system.stand
        self._looked_at: tuple[Solution, Array, float] | None = None
        self.end: Array = stand.qpos[7:] if end is None else end
        self.balance: GravityCompensation = stand_statics(
            system.robot, stand, distribution=ForceDistribution.MIN_TANGENTIAL
        )
        self.share, self.iterations, self._events, self.crept = 0.0, 0, 0, 0.0
        self._euler = math.inf
        forces = {f: system.frame @ force for f, force in self.balance.contact_forces.items()}
        sunk = system.sunk(np.array(list(forces.values())))
        qpos = stand.qpos.copy()
        qpos[2] -= np.mean(sunk) - np.mean(list(stand.depths.values()))
        self._command(0.0)
        self.solution = self._settled(Solution(qpos, forces), diagnose("as-it-stands-fed"), exact)

    def follow(self, goal: float) -> None:
        """Takes away the share ``goal`` of the feed-forward, in one step or in smaller ones.

        Raises:
            NoEquilibriumError: If the equilibrium ends before.
        """
        step = 1.0
        while self.share < goal:
            wanted = min(self.share + step, goal)
            found = self._at(wanted)
            if found is not None and step > _CAREFUL and self.look(found)[1] <= 0:
                # A long step may end on another branch, beyond where this one is stable.
                found = None
            if found is not None:
                wrong = self.system.against(found)
                if not wrong:
                    self.share, self.solution, step = wanted, found, 2 * step
                    continue
                if self._event(list(wrong), wanted, found):
                    continue
            step /= 2
            if step < _LEAST_STEP:
                raise NoEquilibriumError(
                    self.share,
                    diagnose(
                        "feed-forward-needed",
                        feet=Term(self.system.feet),
                        kp=Quantity(self._softest(), "N m/rad"),
                        share=self.share,
                        sliding=self._about_to_slide(),
                    ),
                )

    def look(self, solution: Solution) -> tuple[Array, float]:
        """Returns derivative and stiffness at a solution: the way and its end ask for the same."""
        system, seen = self.system, self._looked_at
        if seen is None or seen[0] is not solution:
            derivative = system.derivative(solution.qpos, system.stacked(solution))
            seen = self._looked_at = (
                solution,
                derivative,
                stiffness_at(system, solution, derivative),
            )
        return seen[1:]

    def creep(self, seconds: float) -> None:
        """Lets pinned feet creep.

        Raises:
            NoEquilibriumError: If the equilibrium ends before.
        """
        for _ in range(CREEP_STEPS):
            self.creep_step(seconds / CREEP_STEPS)

    def creep_step(self, seconds: float) -> None:
        """Lets pinned feet creep, by one backward Euler step, or where it must by smaller ones.

        Soles that are twisted creep by a millimetre within hundredths of a second, and then rest.

        Raises:
            NoEquilibriumError: If the equilibrium ends before.
        """
        left = seconds
        while left > 0:
            step = min(self._euler, left)
            before = self.solution, dict(self.system.anchors), self.system.creeping()
            self.system.begin_creep(self.solution, step)
            try:
                self.solution = self._settled(
                    self.solution, diagnose("after-creep", time=self.crept)
                )
            except NoEquilibriumError:
                self.solution, self.system.anchors, creeping = before
                self.system.crept, self.system.yielding = creeping
                self._euler = step / 4
                if self._euler < _LEAST_EULER * seconds:
                    raise
                continue
            self.crept += step
            left -= step
            self._euler = 2 * step

    def _softest(self) -> float:
        """Returns the least stiffness of a servo (N m/rad); joints that follow others have none."""
        kp = self.system.kp
        return float(kp[kp > 0].min(initial=np.inf))

    def _about_to_slide(self) -> list[str]:
        mu = self.system.sliding_friction
        feet = [
            foot
            for foot, force in self.solution.forces.items()
            if np.linalg.norm(force[:2]) > _NEARLY * mu[foot] * force[2]
        ]
        pinned = self.system.feet == "pinned"
        return feet if pinned else []

    def _command(self, share: float) -> None:
        system = self.system
        full = system.stand.qpos[7:] + command_lead(self.balance.joint_torques, system.kp)
        system.command(full + share * (self.end - full))

    def _at(self, share: float) -> Solution | None:
        """Returns the equilibrium at a share, the feet touching as they do; None if none."""
        self._command(share)
        found = self.system.solve(self.solution)
        self.iterations += 0 if found is None else len(found.residuals) - 1
        return found

    def _event(self, feet: list[str], wanted: float, there: Solution) -> bool:
        """Goes on to where, before ``wanted``, the first of some feet touches or lets go.

        Args:
            feet: What is wrong at ``wanted``.
            wanted: The share there.
            there: The equilibrium there.

        Returns:
            Whether that place was found.
        """
        from scipy import optimize  # slow to import

        known: dict[float, Solution | None] = {wanted: there}  # feet ask for the same places

        def at(share: float) -> Solution | None:
            if share not in known:
                known[share] = self._at(share)
            return known[share]

        def amount(share: float, foot: str) -> float:
            found = at(share)
            if found is None:
                raise ArithmeticError
            return self.system.wrong(foot, found)

        first, place = "", math.inf
        for foot in feet:
            try:
                if amount(self.share, foot) >= 0:  # it just touched, and would let go at once
                    share = self.share
                else:
                    share = optimize.brentq(
                        amount, self.share, wanted, (foot,), xtol=_SHARE_TOLERANCE
                    )
            except ArithmeticError:
                return False
            if share < place:
                first, place = foot, share
        found = at(place)
        if found is None:
            return False
        self._command(place)
        self.share = place
        self._switch(first, found)
        return True

    def _switch(self, foot: str, found: Solution) -> None:
        self._events += 1
        if self._events > max(_MAX_EVENTS, 4 * len(self.system.robot.contact_points)):
            raise NoEquilibriumError(
                self.share, diagnose("foot-neither-carries-nor-clears", subject=("foot", foot))
            )
        self.solution = self.system.switch(foot, found)

    def _settled(self, guess: Solution, when: Diagnostic, exact: bool = True) -> Solution:
        """Returns the equilibrium with the feet that touch in it, beginning with those that do."""
        self.solution = guess
        while True:
            found = self.system.solve(self.solution, exact=exact)
            if found is None:
                told = diagnose("equilibrium-ends", when=when, loops=self._begun_closed())
                raise NoEquilibriumError(self.share, told)
            self.iterations += len(found.residuals) - 1
            wrong = self.system.against(found)
            if not wrong:
                return found
            self._switch(next(iter(wrong)), found)

    def _begun_closed(self) -> bool:
        """Tells whether loops begin closed, and far softer than they are when they have opened."""
        stand, closure = self.system.stand, self.system.robot.closure
        return closure is not None and not any(stand.depths.values())
