"""Logs with torques as equations: means over windows, in which joints turn one way."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.identification.measurements.log import Log
from pupper_analysis.identification.torques.smoothing import Band, find_bands, smooth

Array = NDArray[np.float64]

_APART = 3.5
"""Median intervals: where more than two samples are missing, nothing is put between them."""

_UNEVEN = 0.01
"""Of an interval: clocks that are off by less are even, and are not sampled again."""

_LEAST_RUN = 1.0
"""s: less is no motion."""

_WINDOW = 2.0
"""Periods of the lowest cut-off: Hann's window of this length passes nothing of that frequency, and
3 % at most of any higher."""

_APART_WINDOWS = 0.75
"""Of its length, from one window to the next: these share a hundredth of the samples' noise, so
that what is left has a memory of its own alone. With a half more is told, and a sixth is shared."""

_PASSED = 2.0
"""Times the lowest cut-off: what is less a window passes, and no filter is to change."""

_NYQUIST = 0.8
"""Of half the sampling frequency: the highest that a filter may have."""

_ENDS = 2.0
"""Periods of a filter in which it does not know what was before, or comes after."""

_POINTS = 16
"""In a window: one in an eighth of a cut-off's period, and its weights are a sine's there."""

_STILL_NOISE = 4.0
"""Standard deviations of a velocity: less may be either way."""

_STILL = 0.1
"""Of a joint's usual velocity: slower, friction is none of Coulomb's: joints creep and stick, and
the filter spreads over these times how they come loose."""


@dataclass(frozen=True, eq=False)
class Blocks:
    """Means of a run over windows, all of one length.

    Attributes:
        position: (blocks, points, nu) rad, m; joints that no log tells are where they rest.
        velocity: Likewise (rad/s, m/s).
        acceleration: Likewise (rad/s^2, m/s^2).
        torque: (blocks, nu) mean of what was measured (N m, N); NaN where there is nothing, or
            where the joint does not turn one way all the time.
        held_out: (blocks,) whether it is one to predict.
        weights: (2, points) what makes the mean of numbers at the points, and how that changes
            where the window is later (1/s).
        seconds: How long they are together.
    """

    position: Array
    velocity: Array
    acceleration: Array
    torque: Array
    held_out: NDArray[np.bool_]
    weights: Array
    seconds: float


@dataclass(frozen=True, eq=False)
class MeasuredTorques:
    """All that logs with torques tell.

    Attributes:
        runs: Each without a gap.
        bands: {number of a joint: up to where its acceleration is told}.
        length: Of a window (s).
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
    """Returns the equations of some logs; None if no part of one that is fitted is long enough.

    A mean of tau = Y pi over a window holds as it does at a moment, as it is linear in pi. Where a
    joint turns its friction makes acceleration jump; a filter against encoders' noise blurs that,
    and not the torque. So both sides are seen through one window that passes less than the filter,
    and a window counts in which a joint turns one way all the time.

    Args:
        logs: With the robot's joints in its order, and with torques.
        hold_out: Of each, the share at the end of each of its runs that is not fitted.
        rest: (nu,) where joints that no log tells are (rad, m).
        couplings: (couplings, nu) how far motors turn that turn with several joints: these are to
            turn one way, too.
        lag: By how much torques are told later than positions (s).
    """
    parts = [part for log, share in zip(logs, hold_out, strict=True) for part in _parts(log, share)]
    bands = _bands(parts)
    if not bands:
        return None
    cutoff = min(band.cutoff for band in bands.values())
    runs = [run for part in parts for run in _blocks(part, list(bands), cutoff, rest, lag)]
    rates = np.concatenate(
        [np.zeros((0, len(rest)))]
        + [run.velocity[~run.held_out].reshape(-1, len(rest)) for run in runs]
    )
    noise = np.zeros(len(rest))
    for joint, band in bands.items():
        noise[joint] = band.velocity_noise(_PASSED * cutoff)
    drives = np.eye(len(rest)) if couplings is None else np.vstack([np.eye(len(rest)), couplings])
    least = np.maximum(
        _STILL * np.sqrt(((rates @ drives.T) ** 2).sum(axis=0) / max(len(rates), 1)),
        _STILL_NOISE * np.sqrt(drives**2 @ noise**2),
    )
    for run in runs:
        run.torque[(~one_way(run.velocity @ drives.T, least)) @ (drives != 0)] = np.nan
    return MeasuredTorques(tuple(runs), bands, _WINDOW / cutoff, lag)


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


def _bands(parts: Sequence[_Part]) -> dict[int, Band]:
    """Returns up to where joints' accelerations are told, on average over parts of logs."""
    found: dict[int, list[tuple[Band, float]]] = {}
    for part in parts:
        fitted = part.fitted
        if len(fitted) >= _POINTS:
            joints = np.flatnonzero(np.isfinite(fitted[0])).tolist()
            bands = find_bands(fitted[:, joints], part.interval)
            for joint, band in zip(joints, bands, strict=True):
                found.setdefault(joint, []).append((band, len(fitted) * part.interval))
    return {
        joint: Band(
            *np.average(
                [(band.cutoff, band.density) for band, _ in own],
                axis=0,
                weights=[seconds for _, seconds in own],
            ).tolist()
        )
        for joint, own in sorted(found.items())
    }


def _blocks(
    part: _Part, joints: Sequence[int], cutoff: float, rest: Array, lag: float
) -> Iterator[Blocks]:
    """Yields a part's blocks, if there are any."""
    passed = min(_PASSED * cutoff, _NYQUIST / (2 * part.interval))
    size = max(round(_WINDOW / cutoff / part.interval), 1)
    step = math.ceil(_APART_WINDOWS * size)
    ends = math.ceil((_ENDS / passed + abs(lag)) / part.interval)
    last = len(part.position) - ends
    count = (last - ends - size) // step + 1
    if count < 1:
        return
    first = ends + step * np.arange(count)
    points = (np.arange(_POINTS) + 0.5) / _POINTS
    at = part.interval * ((first[:, None] + size * points - 0.5).ravel() - lag / part.interval)
    motion = np.zeros((3, len(at), len(rest)))
    motion[0] = rest
    for joint in joints:
        column = part.position[:, joint]
        if np.isfinite(column[0]):
            found = smooth(column, part.interval, passed, at)
            motion[:, :, joint] = found.position, found.velocity, found.acceleration
    window = _hann((np.arange(size) + 0.5) / size)
    torque = np.array([window @ part.torque[one : one + size] for one in first])
    begin = last - part.hold_out * (last - ends)
    torque[(first < begin) & (first + size > begin)] = np.nan  # of both
    position, velocity, acceleration = motion.reshape(3, count, _POINTS, -1)
    # The mean of a slope is that of numbers by the window's slope, backwards.
    slope = -2 * np.pi * np.sin(2 * np.pi * points) / (_POINTS * size * part.interval)
    yield Blocks(
        position,
        velocity,
        acceleration,
        torque,
        first >= begin,
        np.array([_hann(points), slope]),
        count * step * part.interval,
    )


def _hann(shares: Array) -> Array:
    """Returns Hann's weights, which add to one, of shares of a window's length."""
    weights: Array = (1 - np.cos(2 * np.pi * shares)) / len(shares)
    return weights
