"""How fast a path through stances can be: until motors, friction or the ground bind."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from numbers import Real

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.arguments import check_arguments
from pupper_analysis.diagnostics import diagnose
from pupper_analysis.errors import ConfigurationError, StaticsInfeasibleError
from pupper_analysis.results import Result
from pupper_analysis.robot.compliance import GroundLaw
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.terrain import on_ground
from pupper_analysis.stance.path.effort import path_effort
from pupper_analysis.stance.path.geometry import Geometry, path_geometry
from pupper_analysis.stance.path.path_limits import PathLimits
from pupper_analysis.stance.path.segment_time import BindingLimit, SegmentTime
from pupper_analysis.stance.path.sinking import find_sunk_motion
from pupper_analysis.stance.path.stance_path import (
    MAX_SAMPLES,
    StancePath,
    Timing,
    checked_stances,
    timed_path,
)
from pupper_analysis.stance.task import StandTask

Array = NDArray[np.float64]

SAMPLES = 64
"""Samples per segment at which the limits are looked at: with twice as many the least times of
seven paths are shorter by 0.4 % at most, and the lower bounds by 0.2 %."""

RESERVE = 0.2
"""What is left unused by default: MuJoCo then confirms all least times of squat, sway and lift
of the six variants to 5 % of torque."""

RISE = 0.75
"""How long the acceleration takes to rise, in lags of the ground. With 0.6 one of those eighteen is
not confirmed (v3-heavy's lift, by 5.7 % of torque); with 1.25 it takes a tenth longer."""

KEPT = 0.5
"""Of the load that the reserve leaves a foot on rigid ground, what it keeps where it sinks: the
lighter its load, the more of it is taken by the leg that falls with it. Of 30 paths that MuJoCo
follows, B2's sway keeps least, 0.64; Spot's feet, which sink by 20 mm, would lose the ground in its
squat, slip, and be off by 9.7 % of torque."""

_SMOOTHER = 4.0
"""By which the rise is longer where feet do not keep that. After two of these steps it no longer
binds: the law is that of the least jerk."""

_TIME_TOLERANCE = 1e-3
"""Of the time: where a longer rise takes no more, it does not bind, and will not help."""

_SLOWDOWN_STEP, _SLOWEST = 1e-3, 1.1
"""By which a path is made slower, and how far at most, where a limit is exceeded after all."""


@dataclass(frozen=True, eq=False)
class FastestPath(Result):
    """The least time for a path through stances, at rest in each.

    Attributes:
        seconds: For the whole path (s).
        lower_bound: The least time of an acceleration that may jump (s): no motion along this way
            is faster within the same limits. Soft ground and servos do not follow such jumps.
        binding: What binds most of all.
        segment_seconds: (segments,) of each segment (s).
        segment_lower_bounds: (segments,) each one's lower bound (s).
        segment_bindings: What binds each; None where nothing moves.
        reserve: Share of every limit that is left unused.
        rise: How long the acceleration takes to rise from none to the greatest that it has at the
            lower bound, at least (s).
        path: The path. Its samples are not evenly spaced in time; its forces leave the reserve of
            friction.
    """

    seconds: float
    lower_bound: float
    binding: BindingLimit
    segment_seconds: Array
    segment_lower_bounds: Array
    segment_bindings: tuple[BindingLimit | None, ...]
    reserve: float
    rise: float
    path: StancePath


@check_arguments
def fastest_path(
    robot: Robot,
    stances: Sequence[StandTask],
    *,
    reserve: float = RESERVE,
    rise: float | None = None,
    rate: float = 50.0,
    rolling: bool = True,
) -> FastestPath:
    """Finds the least time for a path through stances, at rest in each of them.

    Where a path goes does not depend on its time, so its configurations and their derivatives are
    solved once. The speed along it, segment by segment, is that of the least time for which in each
    sample there are contact forces inside the friction cones, which nowhere pull, that balance M
    qacc + h + r, with the motors' torques and velocities within their limits, and the acceleration
    does not change faster than J (``rise``): a sequence of second-order cone programmes in squared
    speed and contact forces (``time_optimum``). Where motors bind, the forces are chosen so that
    they bear it; of all that are within the limits, the path has the minimum-tangential ones.

    The lower bound is the time of the same programme without J.

    Args:
        robot: A robot with a floating base and a ground.
        stances: The tasks, at least two; see ``stance_path``.
        reserve: Share of torque limits, velocity limits and friction coefficients to be left
            unused, and of its load at rest that each foot shall at least keep, if it carries before
            and after; from 0 to below 1. Without reserve a foot's load just comes to zero, and so
            does its grip: the path is at the limit, but no robot will follow it to a few percent.
            The default is one at which MuJoCo does (``RESERVE``); 0 is what the models allow.
        rise: How long the acceleration along a segment takes at least to rise from none to the
            greatest that it has at the lower bound (s). By default ``RISE`` times as long as the
            ground's depth is behind a load that grows evenly (``ground_lag``): faster than that,
            feet do not follow; and longer, as far as that helps, where feet would not keep ``KEPT``
            of their least loads as they sink and rise.
        rate: Least number of samples per second of the path that is returned (Hz).
        rolling: Whether the feet roll.

    Raises:
        ConfigurationError: As ``stance_path``; if an argument is out of its range; or if nothing
            moves.
        StanceUnreachableError: If a sample is out of reach; says where.
        StaticsInfeasibleError: If a sample cannot be held, however slowly; says where.
        NoEquilibriumError: If feet roll away.
        UnknownNameError: If a task names a foot that the robot does not have.
    """
    robot.check_tree("a path")
    left = _number("reserve", reserve, 0.0, 1.0)
    _number("rate", rate, 1e-9, math.inf)
    chosen = None if rise is None else _number("rise", rise, 1e-4, 10.0, "s")
    checked_stances(stances)
    geometry = path_geometry(robot, stances, SAMPLES, rolling=rolling)
    limits = PathLimits(robot, left)

    def finer(per_segment: int) -> Geometry:
        return path_geometry(robot, stances, per_segment, rolling=rolling)

    found, keeps = _find_at(chosen or RISE * ground_lag(robot), limits, geometry, rate, finer)
    while chosen is None and not keeps:
        before = found.seconds
        found, keeps = _find_at(_SMOOTHER * found.rise, limits, geometry, rate, finer)
        if found.seconds < (1 + _TIME_TOLERANCE) * before:
            break
    return found


def _find_at(
    rise: float,
    limits: PathLimits,
    geometry: Geometry,
    rate: float,
    finer: Callable[[int], Geometry],
) -> tuple[FastestPath, bool]:
    """Returns the path whose acceleration rises so, and whether its feet keep their loads.

    Args:
        rise: See ``FastestPath``.
        limits: What must not be exceeded.
        geometry: Where the path goes.
        rate: Least number of samples per second (Hz).
        finer: Returns the same with more samples per segment.
    """
    numbers = range(len(geometry.segments))
    segments = [SegmentTime(limits, geometry, number, rise) for number in numbers]
    bindings = [segment.binding for segment in segments]
    binding = max(filter(None, bindings), key=lambda found: found.price, default=None)
    if binding is None:
        raise ConfigurationError("stances", diagnose("stances-all-alike"))
    finest = max(segment.longest_step for segment in segments) * rate
    if finest > 1:
        per_segment = math.ceil(SAMPLES * finest)
        if per_segment * len(segments) > MAX_SAMPLES:
            raise ConfigurationError("rate", diagnose("too-many-samples", most=MAX_SAMPLES))
        geometry, limits = finer(per_segment), PathLimits(limits.robot, limits.reserve)
    path = _within_limits(limits, geometry, _timing(segments, geometry.per_segment))
    slower = float(path.time[-1]) / sum(segment.seconds for segment in segments)
    found = FastestPath(
        seconds=float(path.time[-1]),
        lower_bound=sum(segment.lower_bound for segment in segments),
        binding=binding,
        segment_seconds=slower * np.array([segment.seconds for segment in segments]),
        segment_lower_bounds=np.array([segment.lower_bound for segment in segments]),
        segment_bindings=tuple(bindings),
        reserve=limits.reserve,
        rise=rise,
        path=path,
    )
    return found, _keeps_loads(limits, geometry, path)


def _keeps_loads(limits: PathLimits, geometry: Geometry, path: StancePath) -> bool:
    """Returns whether feet keep ``KEPT`` of their least loads where they sink into the ground."""
    first = path.stances[0]
    robot = on_ground(limits.robot, first.task.ground, first.foot_targets)
    loads = find_sunk_motion(robot, path).forces @ first.task.ground.normal()
    for place, row in zip(geometry.places, loads, strict=True):
        feet = place.stand.stance_feet
        borne = row[[path.feet.index(foot) for foot in feet]]
        if not (borne >= KEPT * limits.bounds(place, feet).least).all():
            return False
    return True


def _number(name: str, value: object, low: float, high: float, unit: str = "") -> float:
    number = float(value) if isinstance(value, Real) else math.nan
    if isinstance(value, bool) or not low <= number < high:
        given = repr(value)
        if high == math.inf:
            raise ConfigurationError(name, diagnose("not-finite-above-0", value=given))
        told = diagnose("not-in-interval", value=given, low=low, high=high, unit=unit)
        raise ConfigurationError(name, told)
    return number


def ground_lag(robot: Robot) -> float:
    """Returns how long the ground's depth is behind a load that grows evenly (s).

    MuJoCo's contact gives R f = k d(r) r + b dr/dt + d2r/dt2; under a load that grows evenly the
    depth is behind by b / (k d), d the impedance under an even share of the weight. The longest of
    all feet.
    """
    share = robot.total_mass * float(np.linalg.norm(robot.gravity)) / len(robot.contact_points)
    lags = [1e-4]  # undamped, or as hard as a simulation's time step
    for foot in robot.contact_points:
        law = GroundLaw.of(robot, foot)
        lags.append(law.damping / (law.stiffness * law.impedance(law.depth(share))))
    return max(lags)


def _timing(segments: Sequence[SegmentTime], per_segment: int) -> Timing:
    """Returns when the samples of a path are reached, ``per_segment`` of each segment."""
    progress = np.arange(per_segment + 1) / per_segment
    time, rates, accelerations = [np.zeros(1)], [np.zeros(1)], [np.zeros(1)]
    for segment in segments:
        rate, acceleration = segment.rates(progress)
        time.append(time[-1][-1] + segment.moments(progress)[1:])
        rates.append(rate[1:])
        accelerations.append(acceleration[1:])
    return Timing(np.concatenate(time), np.concatenate(rates), np.concatenate(accelerations))


def _within_limits(limits: PathLimits, geometry: Geometry, timing: Timing) -> StancePath:
    """Returns the path at this speed, or a little slower, so that each sample is within the limits.

    Raises:
        StaticsInfeasibleError: If none of the slower ones is.
    """
    factor = 1.0
    for index, place in enumerate(geometry.places):
        bounds = limits.bounds(place, place.stand.stance_feet)
        while True:
            slower = timing.slower(factor)
            motion = float(slower.rates[index]), float(slower.accelerations[index])
            try:
                path_effort(limits.robot, place, *motion, friction=limits.friction, bounds=bounds)
                break
            except StaticsInfeasibleError as error:
                if factor > _SLOWEST:
                    raise error.at(geometry.where(index, float(slower.time[index]))) from None
                factor *= 1 + _SLOWDOWN_STEP
    return timed_path(
        limits.robot,
        geometry,
        timing.slower(factor),
        friction=limits.friction,
        bounds_of=lambda place: limits.bounds(place, place.stand.stance_feet),
    )
