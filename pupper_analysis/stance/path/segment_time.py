"""The least time of one segment of a path, and what binds it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.diagnostics import diagnose
from pupper_analysis.errors import Infeasibility, StaticsInfeasibleError
from pupper_analysis.results import Result
from pupper_analysis.stance.path.geometry import Geometry, PathPlace, minimum_jerk
from pupper_analysis.stance.path.path_limits import PathLimit, PathLimits
from pupper_analysis.stance.path.segment_motion import SegmentMotion
from pupper_analysis.stance.path.time_optimum import (
    Grid,
    Optimum,
    even_grid,
    free_grid,
    least_time,
    smooth_grid,
)

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline  # slow to import

Array = NDArray[np.float64]

_NARROWED = 1e-3
"""Of every limit, for the programme: its resistances are those of the iteration before, and what it
finds must be within the limits themselves."""

_SETTLED = 1e-3
"""Relative change of a segment's time at which the iterations end."""

_ITERATIONS = 12
"""At most; five do as a rule."""

_LEAST_TRAVEL = 1e-9
"""A segment along which nothing moves faster than that does not move (rad or m per way)."""

MINIMUM_JERK = 60.0
"""Largest third derivative of the minimum-jerk law from 0 to 1, at its ends."""

_FREE = 1e-3
"""Price of a limit that does not bind, relative to the time: the solver's own."""

_INTEGRATION_PARTS = 16
"""Parts of a sample's interval over which the time is integrated."""


@dataclass(frozen=True)
class BindingLimit(Result):
    """What binds a segment of a path most: the robot's limit that it would pay most to raise.

    Attributes:
        limit: Which limit.
        names: The joint, or the foot; none for the acceleration's rise.
        segment: Of the path, from 1.
        progress: Where it costs most, as a share of the segment's way.
        price: By how much the segment would be shorter per relative increase of this limit, as the
            programme's multiplier has it (s).
    """

    limit: PathLimit
    names: tuple[str, ...]
    segment: int
    progress: float
    price: float

    def __str__(self) -> str:
        """Names limit, place and moment."""
        names = f" ({', '.join(self.names)})" if self.names else ""
        return f"{self.limit.value}{names} after {self.progress:.0%} of segment {self.segment}"


class SegmentTime:
    """The least time of one segment.

    Attributes:
        seconds: s.
        lower_bound: s.
        binding: What binds it; None where nothing moves.
        square: (SAMPLES / 2 + 1,) squared rate of the progress at every other sample (1/s^2).
    """

    def __init__(self, limits: PathLimits, geometry: Geometry, number: int, rise: float) -> None:
        first = number * geometry.per_segment
        self._places = geometry.places[first : first + geometry.per_segment + 1]
        second, segment = self._places[1], geometry.segments[number]
        # The stance is the last sample of the segment before, too.
        start = replace(self._places[0], segment=segment, number=number, progress=0.0, share=0.0)
        self._places[0] = replace(start, tangent=second.tangent, curvature=second.curvature)
        self._limits = limits.narrowed(_NARROWED)
        self._number = number
        self.binding: BindingLimit | None = None
        self._progress = np.array([place.progress for place in self._places])
        self.square = np.full(len(self._places[::2]), 1 / rise**2)
        self.lower_bound = 0.0
        if max(float(np.abs(place.tangent).max()) for place in self._places) > _LEAST_TRAVEL:
            self._hold()
            greatest = self._free()
            self._smooth(greatest / rise)
        self.seconds = float(self.moments(self._progress)[-1])
        self.longest_step = float(np.diff(self.moments(self._progress)).max())

    def moments(self, progress: Array) -> Array:
        """Returns when the segment is at these values of its progress, from 0 on (s)."""
        from scipy.integrate import cumulative_simpson  # slow to import

        parts = np.linspace(progress[:-1], progress[1:], _INTEGRATION_PARTS, endpoint=False, axis=1)
        fine = np.append(parts.ravel(), progress[-1])
        slowness = 1 / np.sqrt(self._law()(fine))
        found: Array = cumulative_simpson(slowness, x=fine, initial=0.0)[::_INTEGRATION_PARTS]
        return found

    def rates(self, progress: Array) -> tuple[Array, Array]:
        """Returns rate (1/s) and acceleration (1/s^2) of the segment's share at its progress."""
        law = self._law()
        square, acceleration = law(progress), law(progress, 1) / 2
        _, first, second = np.array([minimum_jerk(x) for x in progress]).T
        return first * np.sqrt(square), second * square + first * acceleration

    def _law(self) -> CubicSpline:
        from scipy.interpolate import CubicSpline

        return CubicSpline(self._progress[::2], self.square)

    def _hold(self) -> None:
        """Checks that the segment can be held at rest, with the reserve.

        Raises:
            StaticsInfeasibleError: If it cannot.
        """
        for place in self._places:
            try:
                self._limits.check_rest(place)
            except StaticsInfeasibleError as error:
                raise StaticsInfeasibleError(
                    error.reason,
                    diagnose(
                        "not-held-however-slow",
                        problem=error.diagnostic,
                        share=place.share,
                        segment=place.number + 1,
                    ),
                    margin=place.segment.start.margin(place.stand.stance_feet),
                    friction_needed=error.friction_needed,
                    feet=error.feet,
                ) from None

    def _free(self) -> float:
        """Finds the lower bound; returns the greatest acceleration of its share (1/s^2)."""
        shares = np.array([place.share for place in self._places])
        grid = free_grid(shares)
        motion = SegmentMotion(
            self._limits, self._places[1::2], np.tile([1.0, 0.0], (len(grid.spans), 1))
        )
        _, rates, _ = np.array([minimum_jerk(x) for x in self._progress[::2]]).T
        best = self._solve(grid, motion, rates**2, None)
        self.lower_bound = best.seconds
        return float(np.abs(grid.acceleration @ best.square).max())

    def _smooth(self, jerk: float) -> None:
        """Finds the speed of the least time, its acceleration bounded in its change.

        But not in more than in the minimum-jerk law's own least time, which is never quicker so.
        """
        _, first, second = np.array([minimum_jerk(x) for x in self._progress]).T
        along = np.column_stack([first, second])
        grid = smooth_grid(self._progress, along)
        motion = SegmentMotion(self._limits, self._places, along)
        even = self._solve(even_grid(along), motion, np.array([self.lower_bound**-2 / 2]), None)
        jerk = max(jerk, MINIMUM_JERK * even.seconds**-3)
        # Between the lower bound and what the rise of the acceleration adds, as a rule.
        guess = np.full(len(self.square), (1.5 * self.lower_bound) ** -2)
        best = self._solve(grid, motion, guess, jerk)
        self.square = best.square
        self.binding = self._binding(best)

    def _solve(
        self, grid: Grid, motion: SegmentMotion, guess: Array, jerk: float | None
    ) -> Optimum:
        """Iterates tangents and resistances.

        Raises:
            StaticsInfeasibleError: If no speed does.
        """
        best, square, forces = None, guess, None
        for _ in range(_ITERATIONS):
            demands = motion.demands(grid.acceleration @ square, grid.speed @ square, forces)
            found = least_time(grid, demands, square, jerk=jerk)
            if found is None:
                break
            settled = best is not None and abs(found.seconds / best.seconds - 1) < _SETTLED
            best, square, forces = found, np.maximum(found.square, 0.0), found.forces
            if settled:
                break
        if best is None:
            detail = diagnose("no-speed-within-limits", segment=self._number + 1)
            segment = self._places[-1].segment
            margin = segment.start.margin(segment.stance_feet)
            raise StaticsInfeasibleError(Infeasibility.PULL, detail, margin=margin)
        return best

    def _binding(self, best: Optimum) -> BindingLimit:
        feet, robot = self._places[-1].segment.stance_feet, self._limits.robot
        torque = self._limits.torques
        rated = np.flatnonzero(np.isfinite(torque) & (torque > 0))
        names: dict[str, list[tuple[str, ...]]] = {
            "torque": [(robot.joint_names[index],) for index in rated],
            "velocity": [(self._quickest(place),) for place in self._places],
            "jerk": [()],
        }
        found = []
        for kind, table in best.prices.items():
            price = table.sum(axis=0)
            if not price.size:
                continue
            column = int(price.argmax())
            place = self._places[int(table[:, column].argmax())]
            known = names.get(kind, [(foot,) for foot in feet])
            index = self._places.index(place) if kind == "velocity" else column
            found.append((float(price[column]), _LIMITS[kind], known[index], place.share))
        # The rise is no limit of the robot's: it is named where nothing else costs anything.
        least = _FREE * best.seconds
        hard = [row for row in found if row[1] is not PathLimit.JERK and row[0] > least]
        price, limit, which, share = max(hard or found, key=lambda row: row[0])
        return BindingLimit(limit, which, self._number + 1, share, price)

    def _quickest(self, place: PathPlace) -> str:
        robot = self._limits.robot
        shares = np.abs(place.tangent[robot.nv - robot.nu :]) / self._limits.velocities
        return robot.joint_names[int(shares.argmax())]


_LIMITS = {
    "torque": PathLimit.TORQUE,
    "velocity": PathLimit.VELOCITY,
    "friction": PathLimit.FRICTION,
    "load": PathLimit.LIFTING,
    "passing": PathLimit.PASSING,
    "jerk": PathLimit.JERK,
}
