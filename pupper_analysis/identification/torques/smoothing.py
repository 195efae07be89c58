"""Velocities and accelerations of what encoders tell, without a lag."""

from __future__ import annotations

import math
from collections.abc import Sequence
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
    """In which frequencies a joint moves, and how loud its encoder is.

    Attributes:
        cutoff: Up to where the motion is louder than the noise (Hz).
        density: Of the encoder's noise there (rad^2/Hz, m^2/Hz).
    """

    cutoff: float
    density: float

    @property
    def velocity_noise(self) -> float:
        """Standard deviation of what the noise makes of a velocity (rad/s, m/s)."""
        # The integral of (2 pi f)^2 over the band.
        return math.sqrt(self.density * (2 * math.pi) ** 2 * self.cutoff**3 / 3)


def find_band(series: Sequence[tuple[Array, float]]) -> Band:
    """Returns the frequencies in which a joint moves.

    What a motor moves it accelerates less at higher frequencies, and noise of positions is
    acceleration that grows with the fourth power of the frequency: a filter ends in the trough
    between. Before it, leaving out loses more than it keeps out (Wiener), which a play of digits, a
    resonance of what is no rigid body or an encoder's eccentricity do not change. What is left out
    is at other frequencies than what is kept, so that it makes no inertia too small.

    Args:
        series: (n,) positions, evenly sampled, and the interval between samples, of each run
            (rad, m; s).
    """
    from scipy.signal import welch  # slow to import

    bands = []
    for values, interval in series:
        length = min(round(_SEGMENT / interval), len(values))
        frequency, power = welch(values, 1.0 / interval, nperseg=length, detrend="linear")
        highest = _FINEST / interval
        octaves = np.floor(_PER_OCTAVE * np.log2(np.maximum(frequency, _SLOWEST) / _SLOWEST))
        parts = [np.flatnonzero(octaves == one) for one in np.unique(octaves)]
        parts = [part for part in parts if frequency[part[0]] <= highest]
        loud = np.array([np.mean(frequency[part] ** 4 * power[part]) for part in parts])
        first = int(np.argmax(loud[: 1 + int(np.argmin(loud))]))
        trough = parts[first + int(np.argmin(loud[first:]))]
        cutoff = min(max(float(frequency[trough].mean()), _SLOWEST), highest)
        bands.append(Band(cutoff, float(power[trough].mean())))
    shares = np.array([len(values) * interval for values, interval in series])
    return Band(
        cutoff=float(np.average([band.cutoff for band in bands], weights=shares)),
        density=float(np.average([band.density for band in bands], weights=shares)),
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
