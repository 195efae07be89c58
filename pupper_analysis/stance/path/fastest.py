"""How fast a path through stances can be: until motors, friction or the ground bind."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from numbers import Real

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.arguments import checked
from pupper_analysis.errors import ConfigurationError, Infeasibility, StaticsInfeasibleError
from pupper_analysis.results import Result
from pupper_analysis.robot.robot import Robot
from pupper_analysis.stance.path.effort import path_effort
from pupper_analysis.stance.path.geometry import Place, minimum_jerk, path_geometry
from pupper_analysis.stance.path.stance_path import (
    StancePath,
    checked_stances,
    shares_of,
    timed_path,
)
from pupper_analysis.stance.task import StandTask

Array = NDArray[np.float64]

SAMPLES = 32
"""Samples per leg at which the limits are looked at. The peak of a minimum-jerk acceleration falls
between two of them by 0.5 % of its height at most."""

RESOLUTION = 1e-3
"""Relative error of a least time."""

SLOWEST = 60.0
"""Time of a leg that counts as slow (s): inertia is then a millionth of gravity."""

QUICKEST = 1e-2
"""Time of a leg below which nothing is looked for (s): a leg on which nothing moves takes none."""


class Limit(StrEnum):
    """What can bind the speed of a path."""

    TORQUE = "motor torque"
    VELOCITY = "motor velocity"
    FRICTION = "friction"
    TIPPING = "zero-moment point at the edge of the support polygon"
    LIFTING = "a foot that lifts"


@dataclass(frozen=True)
class Binding(Result):
    """What binds a leg of a path, just below its least time.

    Attributes:
        limit: Which limit.
        names: The joint, or the feet.
        leg: Of the path, from 1.
        progress: When, as a share of the leg's time.
        detail: How far beyond the limit it is then.
    """

    limit: Limit
    names: tuple[str, ...]
    leg: int
    progress: float
    detail: str

    def __str__(self) -> str:
        """Names limit, place and moment."""
        names = ", ".join(self.names)
        return f"{self.limit.value} ({names}) after {self.progress:.0%} of leg {self.leg}"


@dataclass(frozen=True, eq=False)
class FastestPath(Result):
    """The least time for a path through stances.

    Attributes:
        seconds: For the whole path, whose legs take the same time each (s).
        binding: What binds there.
        leg_seconds: (legs,) the least time of each leg alone (s). A path whose legs took these
            times, each its own, would be as feasible.
        leg_bindings: What binds each; None where nothing moves.
        reserve: Share of every limit that is left unused.
        path: The path at ``seconds``; its forces leave the reserve of friction.
    """

    seconds: float
    binding: Binding
    leg_seconds: Array
    leg_bindings: tuple[Binding | None, ...]
    reserve: float
    path: StancePath


RESERVE = 0.2
"""What is left unused by default. With it MuJoCo confirms 17 of 18 least times (squat, sway and
lift of the six variants) to 5 % of torque, v3's sway to 5.2 %, and all 18 are infeasible in 0.8 of
the time. With none most are off by more; with 0.25 all are confirmed, but five hold in 0.8 of it.
"""


@checked
def fastest_path(
    robot: Robot,
    stances: Sequence[StandTask],
    *,
    reserve: float = RESERVE,
    rate: float = 50.0,
    rolling: bool = True,
) -> FastestPath:
    """Finds the least time for a path through stances.

    Where a path goes does not depend on its time, so its configurations and their derivatives are
    solved once. With qvel as 1/T and qacc as 1/T^2, a time T of a leg is feasible if in each sample
    contact forces inside the friction cones, which nowhere pull, balance M qacc + h + r, and the
    motors' torques and velocities are within the limits of the URDF. Each sample's least T is found
    from the slow side, by halving and bisection; the leg's is the greatest, and feasible in every
    sample.

    The contact forces are the minimum-tangential ones. Others can need less of the motors,
    so where a motor's torque binds, the time is that of this choice. Where friction, tipping or
    lifting bind it is that of all choices, since these forces exist where any do; but for legs
    beside a swing foot, on which the load must pass to the others.

    Args:
        robot: A robot with a floating base and a ground.
        stances: The tasks, at least two; see ``stance_path``.
        reserve: Share of torque limits, velocity limits and friction coefficients to be left
            unused, and of its load at rest that each foot shall at least keep, if it carries before
            and after; from 0 to below 1. Without reserve a foot's load just comes to zero, and so
            does its grip: the path is at the limit, but no robot will follow it to a few percent.
            The default is one at which MuJoCo does (``RESERVE``); 0 is what the models allow.
        rate: Least number of samples per second of the path that is returned (Hz).
        rolling: Whether the feet roll.

    Raises:
        ConfigurationError: As ``stance_path``; if the reserve is out of its range; or if nothing
            moves.
        StanceUnreachableError: If a sample is out of reach; says where.
        StaticsInfeasibleError: If a sample cannot be held, however slowly; says where.
        NoEquilibriumError: If feet roll away.
        UnknownNameError: If a task names a foot that the robot does not have.
    """
    robot.check_tree("a path")
    value: object = reserve
    number = float(value) if isinstance(value, Real) else math.nan
    if isinstance(value, bool) or not 0 <= number < 1:
        raise ConfigurationError("reserve", f"{reserve!r} is not from 0 to below 1")
    checked_stances(stances)
    geometry = path_geometry(robot, stances, SAMPLES, rolling=rolling)
    limits = _Limits(robot, number)
    times, bindings = [], []
    for number in range(len(geometry.legs)):
        places = geometry.places[number * SAMPLES : (number + 1) * SAMPLES + 1]
        time, binding = _least_time(limits, places)
        times.append(time)
        bindings.append(binding)
    slowest = int(np.argmax(times))
    binding = bindings[slowest]
    if binding is None:
        raise ConfigurationError("stances", "nothing moves: they are all the same")
    seconds = times[slowest] * len(times)
    per_leg = max(SAMPLES, int(np.ceil(seconds * rate / len(times))))
    if per_leg > SAMPLES:
        geometry = path_geometry(robot, stances, per_leg, rolling=rolling)
    return FastestPath(
        seconds=seconds,
        binding=binding,
        leg_seconds=np.array(times),
        leg_bindings=tuple(bindings),
        reserve=float(reserve),
        path=timed_path(robot, geometry, seconds, friction=limits.friction),
    )


class _Limits:
    """What a robot must not exceed, a reserve left."""

    def __init__(self, robot: Robot, reserve: float) -> None:
        self.robot = robot
        self.share = 1.0 - reserve
        self._least: dict[tuple[int, float], dict[str, float]] = {}
        self.friction = {
            foot: self.share * contact.sliding_friction for foot, contact in robot.contacts.items()
        }

    def least_loads(self, place: Place) -> dict[str, float]:
        """Returns what the feet must press with at least (N), of those that carry all along."""
        key = (place.number, place.progress)
        if self.share == 1.0:
            return {}
        if key not in self._least:
            rest = path_effort(self.robot, place, math.inf)
            leg = place.leg
            self._least[key] = {
                foot: (1.0 - self.share) * float(force @ place.stand.normals[foot])
                for foot, force in rest.forces.items()
                if foot in leg.before and foot in leg.after
            }
        return self._least[key]

    def violated(self, place: Place, seconds: float) -> Binding | None:
        """Returns what a sample violates if its leg takes this time (s)."""
        robot = self.robot

        def binding(limit: Limit, names: Sequence[str], detail: str) -> Binding:
            return Binding(limit, tuple(names), place.number + 1, place.progress, detail)

        try:
            effort = path_effort(robot, place, seconds, friction=self.friction)
        except StaticsInfeasibleError as error:
            return binding(_LIMITS[error.reason], error.feet, str(error))
        for foot, least in self.least_loads(place).items():
            load = float(effort.forces[foot] @ place.stand.normals[foot])
            if load < least:
                return binding(Limit.LIFTING, [foot], f"{load:.2f} N of at least {least:.2f} N")
        torques = shares_of(effort.torques, self.share * robot.effort_limits)
        rates = effort.qvel[robot.nv - robot.nu :]
        speeds = shares_of(rates, self.share * robot.velocity_limits)
        for limit, shares, values, unit in (
            (Limit.TORQUE, torques, effort.torques, "N m"),
            (Limit.VELOCITY, speeds, rates, "rad/s"),
        ):
            worst = int(shares.argmax())
            if shares[worst] > 1:
                allowed = abs(values[worst]) / shares[worst]
                detail = f"{values[worst]:+.3f} {unit} of {allowed:.3f} {unit}"
                return binding(limit, [robot.joint_names[worst]], detail)
        return None


_LIMITS = {
    Infeasibility.FRICTION: Limit.FRICTION,
    Infeasibility.ZMP_OUTSIDE: Limit.TIPPING,
    Infeasibility.PULL: Limit.LIFTING,
}


def _least_time(limits: _Limits, places: Sequence[Place]) -> tuple[float, Binding | None]:
    """Returns the least time of a leg (s), and what is violated a little below it.

    The least time of the sample that binds is the leg's. So each sample that is violated at the
    time found so far gives a greater one, until none is.
    """
    # The largest accelerations, and so likely the least times, are at 21 % and 79 %.
    order = sorted(places, key=lambda place: -abs(minimum_jerk(place.progress)[2]))
    for place in order:
        binding = limits.violated(place, SLOWEST)
        if binding is not None:
            motor = binding.limit in (Limit.TORQUE, Limit.VELOCITY)
            raise StaticsInfeasibleError(
                Infeasibility.MOTOR if motor else Infeasibility.PULL,
                f"{binding}: {binding.detail}, however slow",
                margin=place.leg.start.margin(place.stand.stance_feet),
                feet=() if motor else binding.names,
            )
    time, binding, search = QUICKEST, None, True
    while search:
        search = False
        for place in order:
            violated = limits.violated(place, time)
            if violated is not None:
                time, binding = _least_time_at(limits, place, time, violated)
                search = True
    return time, binding


def _least_time_at(
    limits: _Limits, place: Place, infeasible: float, binding: Binding
) -> tuple[float, Binding]:
    """Returns the least time of a leg (s) by one sample, and what it violates a little below it.

    Args:
        limits: The limits.
        place: The sample.
        infeasible: A time at which it violates one (s).
        binding: Which.
    """
    feasible, found = SLOWEST, None
    while found is None and feasible / 2 > infeasible:
        found = limits.violated(place, feasible / 2)
        if found is None:
            feasible /= 2
        else:
            infeasible, binding = feasible / 2, found
    while feasible > (1 + RESOLUTION) * infeasible:
        time = (feasible * infeasible) ** 0.5
        found = limits.violated(place, time)
        if found is None:
            feasible = time
        else:
            infeasible, binding = time, found
    return feasible, binding
