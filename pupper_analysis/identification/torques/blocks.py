"""Logs with torques as equations: short means of them, in which joints turn one way."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.identification.measurements.log import Log
from pupper_analysis.identification.torques.smoothing import Band, find_band, smooth

Array = NDArray[np.float64]

_APART = 3.5
"""Median intervals: where more than two samples are missing, nothing is put between them."""

_UNEVEN = 0.01
"""Of an interval: clocks that are off by less are even, and are not sampled again."""

_LEAST_RUN = 1.0
"""s: less is no motion."""

_ENDS = 2.0
"""Periods of the cut-off in which a filter does not know what was before, or comes after."""

_POINTS = 8
"""In a block: of what changes once or less in it, a mean of eight is the integral to 1 %."""

_STILL_NOISE = 4.0
"""Standard deviations of a velocity: less may be either way."""

_STILL = 0.1
"""Of a joint's usual velocity: slower, friction is none of Coulomb's: joints creep and stick, and
the filter spreads over these times how they come loose."""


@dataclass(frozen=True, eq=False)
class Blocks:
    """Means of a run over short times, all of one length.

    Attributes:
        position: (blocks, points, nu) rad, m; joints that no log tells are where they rest.
        velocity: Likewise (rad/s, m/s).
        acceleration: Likewise (rad/s^2, m/s^2).
        torque: (blocks, nu) mean of what was measured (N m, N); NaN where there is nothing, or
            where the joint does not turn one way all the time.
        held_out: (blocks,) whether it is one to predict.
        slopes: (points,) what makes the slope of a line of numbers at the points (1/s).
        seconds: How long they are together.
    """

    position: Array
    velocity: Array
    acceleration: Array
    torque: Array
    held_out: NDArray[np.bool_]
    slopes: Array
    seconds: float


@dataclass(frozen=True, eq=False)
class MeasuredTorques:
    """All that logs with torques tell.

    Attributes:
        runs: Each without a gap.
        bands: {number of a joint: the frequencies in which it moves}.
        length: Of a block (s).
        lag: By how much later than positions torques are taken to be told (s).
    """

    runs: tuple[Blocks, ...]
    bands: Mapping[int, Band]
    length: float
    lag: float


@dataclass(frozen=True, eq=False)
class _Part:
    """A part of a log that lacks nothing, evenly sampled; NaN of joints that it does not tell."""

    position: Array
    torque: Array
    interval: float
    hold_out: float

    @property
    def fitted(self) -> Array:
        """(n, nu) its positions, but for those that are held out."""
        return self.position[: math.ceil((1 - self.hold_out) * len(self.position))]


def measure_torques(
    logs: Sequence[Log],
    hold_out: Sequence[float],
    rest: Array,
    couplings: Array | None = None,
    lag: float = 0.0,
) -> MeasuredTorques | None:
    """Returns the equations of some logs; None if no part of one is long enough.

    A mean of tau = Y pi over a short time holds as it does at a moment, as it is linear in pi: so
    noise is averaged, and nothing is lost but what is faster than encoders can tell.

    Args:
        logs: With the robot's joints in its order, and with torques.
        hold_out: Of each, the share at the end of each of its runs that is not fitted.
        rest: (nu,) where joints that no log tells are (rad, m).
        couplings: (couplings, nu) how far motors turn that turn with several joints: these are to
            turn one way, too.
        lag: By how much torques are told later than positions (s).
    """
    parts = [part for log, share in zip(logs, hold_out, strict=True) for part in _parts(log, share)]
    bands: dict[int, Band] = {}
    for joint in range(len(rest)):
        series = [(part.fitted[:, joint], part.interval) for part in parts]
        series = [one for one in series if len(one[0]) >= _POINTS and np.isfinite(one[0][0])]
        if series:
            bands[joint] = find_band(series)
    if not bands:
        return None
    # What is faster than a joint's cut-off its equation lacks; twice in a period is often enough.
    length = 1.0 / (2 * min(band.cutoff for band in bands.values()))
    runs = [run for part in parts for run in _blocks(part, bands, length, rest, lag)]
    if not runs:
        return None
    rates = np.concatenate([run.velocity[~run.held_out].reshape(-1, len(rest)) for run in runs])
    if not len(rates):
        return None
    noise = np.zeros(len(rest))
    for joint, band in bands.items():
        noise[joint] = band.velocity_noise
    drives = np.eye(len(rest)) if couplings is None else np.vstack([np.eye(len(rest)), couplings])
    least = np.maximum(
        _STILL * np.sqrt(np.mean((rates @ drives.T) ** 2, axis=0)),
        _STILL_NOISE * np.sqrt(drives**2 @ noise**2),
    )
    for run in runs:
        run.torque[(~one_way(run.velocity @ drives.T, least)) @ (drives != 0)] = np.nan
    return MeasuredTorques(tuple(runs), bands, length, lag)


def one_way(speed: Array, least: Array) -> NDArray[np.bool_]:
    """Returns in which blocks something turns one way, and fast enough for Coulomb's law.

    Args:
        speed: (blocks, points, n) of each (rad/s, m/s).
        least: (n,) the slowest that counts.

    Returns:
        (blocks, n).
    """
    slow = np.abs(speed).min(axis=1) <= least
    turns = speed.min(axis=1) * speed.max(axis=1) <= 0
    found: NDArray[np.bool_] = ~(slow | turns)
    return found


def _parts(log: Log, hold_out: float) -> Iterator[_Part]:
    """Yields the parts of a log that lack nothing, evenly sampled."""
    from scipy.interpolate import CubicSpline  # slow to import

    assert log.torque is not None  # logs without are refused before
    joints = np.isfinite(log.position).any(axis=0)
    rows, interval = np.flatnonzero(np.isfinite(log.position[:, joints]).all(axis=1)), log.interval
    ends = np.flatnonzero(np.diff(log.time[rows]) > _APART * interval) + 1
    for part in np.split(rows, ends):
        if len(part) < _POINTS or log.time[part[-1]] - log.time[part[0]] < _LEAST_RUN:
            continue
        clock = log.time[part] - log.time[part[0]]
        even = interval * np.arange(int(clock[-1] / interval + _UNEVEN) + 1)
        position, torque = log.position[part], log.torque[part]
        if len(even) != len(part) or np.abs(even - clock).max() > _UNEVEN * interval:
            position = np.full((len(even), position.shape[1]), np.nan)
            position[:, joints] = CubicSpline(clock, log.position[part][:, joints])(even)
            torque = np.column_stack([np.interp(even, clock, column) for column in torque.T])
        yield _Part(position, torque, interval, hold_out)


def _blocks(
    part: _Part, bands: Mapping[int, Band], length: float, rest: Array, lag: float
) -> Iterator[Blocks]:
    """Yields a part's blocks, if there are any."""
    size = max(round(length / part.interval), 1)
    ends = _ENDS / min(band.cutoff for band in bands.values()) + abs(lag)
    ends = math.ceil(ends / part.interval)
    count = (len(part.position) - 2 * ends) // size
    if count < 1:
        return
    first = ends + size * np.arange(count)
    points = (np.arange(_POINTS) + 0.5) / _POINTS * size - 0.5
    at = part.interval * (first[:, None] + points).ravel() - lag
    motion = np.zeros((3, len(at), len(rest)))
    motion[0] = rest
    for joint, band in bands.items():
        column = part.position[:, joint]
        if np.isfinite(column[0]):
            found = smooth(column, part.interval, band.cutoff, at)
            motion[:, :, joint] = found.position, found.velocity, found.acceleration
    torque = part.torque[ends : ends + size * count].reshape(count, size, -1).mean(axis=1)
    late = np.arange(count) >= math.ceil((1 - part.hold_out) * count)
    position, velocity, acceleration = motion.reshape(3, count, _POINTS, -1)
    slopes = (points - points.mean()) / ((points - points.mean()) ** 2).sum() / part.interval
    seconds = count * size * part.interval
    yield Blocks(position, velocity, acceleration, torque, late, slopes, seconds)
