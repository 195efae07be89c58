"""One push: does a stand recover from it, and how does it move?"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arguments import check_arguments, check_finite
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.robot.robot import Robot
from pupper_analysis.simulation.rollout import check_stand
from pupper_analysis.stance.stand import Stand
from pupper_analysis.tools.push.bench import Pushed, bench_of

Array = NDArray[np.float64]

_FRAME = 1 / 30
"""s between the configurations that are kept: a fall of 0.3 s has ten of them."""

_HARDEST = 1e6  # N s: of much more, numbers overflow


@dataclass(frozen=True, eq=False)
class PushTrial(Pushed):
    """What one push makes of a stand, and how it was ``Pushed``.

    Attributes:
        recovered: Whether it recovers, as ``push_recovery`` judges it.
        failure: If not, why; else None.
        impulse: N s.
        direction: Where to, about the vertical (rad): 0 is the base's forward, pi/2 its left.
        velocity_step: impulse / mass (m/s).
        motion_time: (m,) samples from the push on (s).
        motion: (m, nq) the configurations at these, to six digits: to be looked at.
    """

    recovered: bool
    failure: Diagnostic | None
    impulse: float
    direction: float
    velocity_step: float
    motion_time: Array
    motion: Array


@check_arguments
def simulate_push(
    robot: Robot,
    stand: Stand,
    impulse: float,
    direction: float = 0.0,
    *,
    duration: float = 6.0,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
    feedforward: bool = True,
    integrator: str | None = None,
) -> PushTrial:
    """Pushes a stand once; ``push_recovery`` finds the largest push from which it recovers.

    The push and what counts as recovery are those of ``push_recovery``; what does not stand without
    a push recovers from none.

    Args:
        robot: The robot.
        stand: How it stands.
        impulse: How hard it is pushed (N s).
        direction: Where to, about the vertical (rad): 0 is the base's forward, pi/2 its left.
        duration: Simulated time from the push on (s), at least 2.
        kp: Servo stiffness (N m/rad); the model's own by default.
        kd: Servo damping (N m s/rad); the model's own by default.
        feedforward: Command ctrl = q* + tau / kp instead of ctrl = q*.
        integrator: MuJoCo's integrator; the model's own by default.

    Returns:
        What comes of it, with the motion.

    Raises:
        ConfigurationError: If an argument is out of its range, or the base is fixed.
        ModelError: If the model has no servos and no gains are given.
        StaticsInfeasibleError: If no contact forces balance the stand.
    """
    check_stand(robot, stand, duration)
    impulse, direction = check_finite("impulse", impulse), check_finite("direction", direction)
    if not 0 <= impulse <= _HARDEST:
        problem = diagnose("impulse-not-valid", given=Quantity(impulse, "N s"), most=_HARDEST)
        raise ConfigurationError("impulse", problem)
    if abs(direction) > 2 * math.pi:
        problem = diagnose("direction-not-valid", given=Quantity(direction, "rad"))
        raise ConfigurationError("direction", problem)
    bench = bench_of(
        robot,
        stand,
        np.array([direction]),
        duration=duration,
        kp=kp,
        kd=kd,
        feedforward=feedforward,
        integrator=integrator,
    )
    (states,) = bench.simulate(np.zeros(1, dtype=np.int64), np.array([impulse]))
    failure = bench.failure(states)
    if bench.unpushed:
        failure = diagnose("without-a-push", failures=bench.unpushed)
    # What a run was before it broke down can still be looked at.
    shown = states[:: max(1, round(_FRAME / bench.timestep))]
    shown = shown[np.isfinite(shown).all(axis=1)]
    return PushTrial(
        recovered=failure is None,
        failure=failure,
        impulse=impulse,
        direction=direction,
        velocity_step=impulse / robot.total_mass,
        motion_time=shown[:, 0].copy(),
        motion=np.round(shown[:, 1 + robot.mj_convention.qpos_index], 6),
        **bench.fields(),
    )
