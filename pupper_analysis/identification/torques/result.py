"""What logs with measured torques tell, as numbers with intervals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from pupper_analysis.identification.result import Fit


@dataclass(frozen=True, eq=False)
class TorqueFit(Fit):
    """A robot's numbers as measured torques of its motions tell them.

    Attributes:
        seconds: How long the motions are.
        held_out: Root mean square of what is off in torques that were not fitted (N m); NaN if
            there are none.
        held_out_before: The same with the file's own numbers (N m).
        fitted: The same in torques that were fitted (N m).
        fitted_before: With the file's own numbers (N m).
        torque: Root mean square of the torques that were not fitted, or of those that were (N m).
        by_joint: {joint: what is off in torques that were not fitted, or in those that were (N m)}.
        by_joint_before: {joint: the same with the file's own numbers (N m)}.
        torque_noise: {joint: what no motion is of its torque, after averaging (N m)}.
        cutoff: {joint: up to where encoders' noise is little of accelerations (Hz)}.
        length: Of the times over which torques are averaged (s).
        equations: How many averages were fitted.
        directions: How many combinations of parameters are told better by them than before.
    """

    seconds: float
    held_out: float
    held_out_before: float
    fitted: float
    fitted_before: float
    torque: float
    by_joint: Mapping[str, float]
    by_joint_before: Mapping[str, float]
    torque_noise: Mapping[str, float]
    cutoff: Mapping[str, float]
    length: float
    equations: int
    directions: int
