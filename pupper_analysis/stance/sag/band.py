"""Between which heights a standing robot may come to rest, for its dry friction."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass

from numpy.typing import ArrayLike

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.diagnostics import Diagnostic, Term, diagnose
from pupper_analysis.base.errors import NoEquilibriumError
from pupper_analysis.base.results import Result
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.terrain import on_ground
from pupper_analysis.stance.sag.equilibrium import SagEquilibrium
from pupper_analysis.stance.sag.homotopy_path import HomotopyPath
from pupper_analysis.stance.sag.steady_state import (
    SteadyState,
    check_request,
    describe_pose,
    release_margin,
)
from pupper_analysis.stance.stand import Stand

_SHARES = (0.25, 0.5, 1.0)  # of friction, that may carry a robot that does not stand without


@dataclass(frozen=True, eq=False)
class SteadyStateBand(Result):
    """The equilibria of a servo-driven robot whose joints and rolling feet have dry friction.

    Attributes:
        highest: Friction holds the base up as far as it can: where a robot that is let down slowly
            from its stand comes to rest.
        friction: The share of friction with which ``highest`` was found: 1, unless the equilibrium
            ended before; then the robot may come to rest higher.
        frictionless: What ``steady_state`` says; None if without friction it does not stand.
        lowest: Friction holds the base down as far as it can: where a robot that was pushed down,
            and is let go slowly, comes to rest. None if it then goes on sinking: the band has no
            lower end at which the robot stands.
    """

    highest: SteadyState
    friction: float
    frictionless: SteadyState | None
    lowest: SteadyState | None

    @property
    def width(self) -> float | None:
        """Between which heights the base may come to rest (m); None without a lower end."""
        return None if self.lowest is None else self.highest.base_height - self.lowest.base_height

    @property
    def failures(self) -> tuple[Diagnostic, ...]:
        """What is wrong somewhere in the band; empty if the robot stands in all of it."""
        places = {"highest": self.highest, "frictionless": self.frictionless, "lowest": self.lowest}
        found = []
        for place, pose in places.items():
            none = diagnose("no-equilibrium-there")
            problems = (none,) if pose is None else pose.failures
            found += [diagnose("in-band", place=Term(place), what=one) for one in problems]
        if self.friction < 1:
            found.append(diagnose("highest-with-less-friction", share=self.friction))
        return tuple(found)


@check_arguments
def steady_state_band(
    robot: Robot, stand: Stand, *, kp: ArrayLike | None = None, feedforward: bool = False
) -> SteadyStateBand:
    """Predicts between which heights a standing robot may come to rest.

    Where ``steady_state`` leaves dry friction out, here each joint may hold any torque up to its
    ``frictionloss``, and each foot any moment in the cone of torsional and rolling friction
    (``condim`` 4 and 6). All equilibria with such friction are where a robot may come to rest; the
    band's ends are those with the base highest and lowest. Feet are pinned, on ground that grips:
    rubber does, MuJoCo with ``noslip_iterations``. Without these its friction creeps, in joints
    within seconds, in rolling feet within seconds with an ``impratio`` of 100 and minutes with 1e4,
    and a robot leaves the band's ends towards the middle.

    Args:
        robot: The robot.
        stand: How it shall stand.
        kp: Servo stiffness (N m/rad), one or (nu,); the model's own by default.
        feedforward: Command ctrl = q* + tau / kp instead of ctrl = q*.

    Returns:
        The band.

    Raises:
        ConfigurationError: If an argument is out of its range, or the robot cannot stand.
        UnknownNameError: If the stand is another robot's, with other feet.
        ModelError: If a joint has no motor, or the model has no servos and no kp is given.
        StaticsInfeasibleError: If no contact forces balance the stand itself.
        NoEquilibriumError: If no stable equilibrium continues the stand, even with friction.
    """
    check_request(robot, stand, "pinned", 0.0)
    robot = on_ground(robot, stand.task.ground, stand.foot_targets)

    def begin(lift: float) -> HomotopyPath | None:
        way = HomotopyPath(SagEquilibrium(robot, stand, kp, "pinned"))
        way.rub(lift)
        with contextlib.suppress(NoEquilibriumError):
            way.follow(0.0 if feedforward else 1.0)
            return way if way.look(way.solution)[1] > 0 else None
        return None

    way, frictionless, lowest = begin(0.0), None, None
    if way is not None:
        frictionless = describe_pose(way, release_margin(way))
        down = begin(0.0)
        if down is not None and down.rub(-1.0) == -1.0:
            lowest = describe_pose(down, release_margin(down))
    for share in _SHARES:
        way = way or begin(share)
    if way is None:
        raise NoEquilibriumError(None, diagnose("no-stable-equilibrium"))
    share = way.rub(1.0)
    return SteadyStateBand(describe_pose(way, release_margin(way)), share, frictionless, lowest)
