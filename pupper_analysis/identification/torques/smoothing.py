"""Velocities and accelerations of what encoders tell, without a lag."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_SEGMENT = 4.0
"""s: a spectrum's resolution is a quarter of a hertz, and half a minute gives some of them to
average."""

_PER_OCTAVE = 3
"""Parts of a spectrum that are looked at together: single frequencies are loud by chance."""

_FINEST = 0.2
"""Of the sampling frequency: with less than five samples in a period derivatives of what is between
them are guessed."""

_SLOWEST = 1.0
"""Hz: what moves a joint by hand is faster. Below, nothing is left of a log of some seconds."""

_NOISE = 1e-3
"""Of the power of accelerations up to a cut-off. Windows of two of its periods pass a thirtieth of
that: by no more does it make an inertia too small, were the encoder ten times as loud as it looks.
"""

_BEYOND = 2 * _PER_OCTAVE
"""Parts beyond a frequency, two octaves, in which its noise is looked for: where friction makes
joints jerk, their motion is louder than it for an octave. A driver's filter makes it quieter."""

_ORDER = 4
"""Of Butterworth's filter, which is run in both directions: flat to 0.4 % at half its cut-off."""


@dataclass(frozen=True, eq=False)
class Smoothed:
    """A joint's motion.

    Attributes:
        position: (m,) rad, m.
        velocity: (m,) rad/s, m/s.
        acceleration: (m,) rad/s^2, m/s^2.
    """

    position: Array
    velocity: Array
    acceleration: Array


@dataclass(frozen=True)
class Band:
    """Up to where encoders tell a joint's acceleration, and how loud their noise is.

    Attributes:
        cutoff: Up to where noise is none of it to speak of (Hz).
        density: Of the noise of positions there (rad^2/Hz, m^2/Hz).
    """

    cutoff: float
    density: float

    @property
    def told(self) -> bool:
        """Whether there is any such frequency: of what jumps there is none."""
        return self.cutoff > _SLOWEST

    def velocity_noise(self, highest: float) -> float:
        """Returns the standard deviation of a velocity up to a frequency in Hz (rad/s, m/s)."""
        # The integral of (2 pi f)^2 over the band.
        return math.sqrt(self.density * (2 * math.pi) ** 2 * highest**3 / 3)


def find_bands(position: Array, interval: float) -> tuple[Band, ...]:
    """Returns up to which frequency encoders tell joints' accelerations.

    Noise of positions is noise of accelerations that grows with the fourth power of the frequency.
    How much of it there is up to a frequency is known from above, as noise is in all that is told:
    no more than in the quietest part of the spectrum up to two octaves beyond. What accelerates one
    joint counts for all, by their mean: of one that hardly moves it is asked but to do so quietly.

    Args:
        position: (n, joints) evenly sampled (rad, m).
        interval: Between samples (s).
    """
    from scipy.signal import welch  # slow to import

    length = min(round(_SEGMENT / interval), len(position))
    frequency, power = welch(position, 1.0 / interval, nperseg=length, detrend="linear", axis=0)
    octaves = np.floor(_PER_OCTAVE * np.log2(np.maximum(frequency, _SLOWEST) / _SLOWEST))
    parts = [np.flatnonzero(octaves == one) for one in np.unique(octaves)]
    middle = np.array([frequency[part].mean() for part in parts])
    loud = (frequency[:, None] ** 4 * power).cumsum(axis=0) * frequency[1]
    motion = loud[[part[-1] for part in parts]].mean(axis=1, keepdims=True)
    floor = np.minimum.accumulate([power[part].mean(axis=0) for part in parts])
    floor = floor[np.minimum(np.arange(len(parts)) + _BEYOND, len(parts) - 1)]
    noise = floor * middle[:, None] ** 5 / 5
    told = (noise <= _NOISE * motion) & (middle[:, None] <= _FINEST / interval)
    last = [int(np.flatnonzero(one).max(initial=0)) for one in told.T]
    return tuple(
        Band(max(float(middle[part]), _SLOWEST), float(floor[part, joint]))
        for joint, part in enumerate(last)
    )


def smooth(position: Array, interval: float, cutoff: float, at: Array) -> Smoothed:
    """Returns a joint's motion up to a frequency, without a lag.

    Butterworth's filter of fourth order in both directions, and the derivatives of the spline of
    fifth degree through what it leaves: differences of samples would be too small, by 7 % at a
    tenth of the sampling frequency.

    Args:
        position: (n,) evenly sampled (rad, m).
        interval: Between samples (s).
        cutoff: Hz.
        at: (m,) when it is asked for, since the first sample (s).
    """
    from scipy.interpolate import make_interp_spline  # slow to import
    from scipy.signal import butter, sosfiltfilt

    sections = butter(_ORDER, cutoff, fs=1.0 / interval, output="sos")
    pad = min(len(position) - 1, round(3.0 / (cutoff * interval)))
    found = sosfiltfilt(sections, position, padlen=pad)
    spline = make_interp_spline(interval * np.arange(len(position)), found, k=5)
    return Smoothed(spline(at), spline(at, 1), spline(at, 2))
