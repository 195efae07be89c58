"""What logs of motions tell, as numbers with intervals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from pupper_analysis.tools.fit.result import Fit


@dataclass(frozen=True, eq=False)
class MotionFit(Fit):
    """A robot's numbers as logs of its motions tell them.

    Attributes:
        seconds: How long the motions are.
        held_out: Root mean square of what is off in motions that were not fitted (rad); NaN if
            there are none.
        held_out_before: The same with the file's own numbers (rad).
        fitted: The same in motions that were fitted (rad).
        fitted_before: With the file's own numbers (rad).
        repeatability: How far the robot is from itself over runs of the same commands (rad); NaN
            if no two are the same.
        by_joint: {joint: what is off in motions that were not fitted, or in those that were (rad)}.
        encoder_noise: {joint: noise of its encoder (rad)}.
        steps: Of the simulation between two samples.
    """

    seconds: float
    held_out: float
    held_out_before: float
    fitted: float
    fitted_before: float
    repeatability: float
    by_joint: Mapping[str, float]
    encoder_noise: Mapping[str, float]
    steps: int
