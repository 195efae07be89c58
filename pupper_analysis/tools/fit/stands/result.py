"""What stands at rest tell, as numbers with intervals."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import Diagnostic
from pupper_analysis.base.results import Result
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.fit.estimate import Posterior
from pupper_analysis.tools.fit.measurements.stands import MeasuredStands
from pupper_analysis.tools.fit.parameters import Parameter
from pupper_analysis.tools.fit.result import (
    Estimate,
    Fit,
    describe_parameter,
    describe_parameters,
)
from pupper_analysis.tools.fit.stands.doubts import doubt_stands
from pupper_analysis.tools.fit.stands.equations import StandEquations
from pupper_analysis.tools.fit.stands.remedies import further_measurements
from pupper_analysis.tools.fit.stands.rows import StandNoise
from pupper_analysis.tools.fit.told import find_together, told_by

Array = NDArray[np.float64]


@dataclass(frozen=True)
class JointResidual(Result):
    """What is left at one joint in one stand.

    Attributes:
        stand: The stand.
        joint: The joint.
        off: Measured position less predicted one (rad).
        deviations: The same in standard deviations of what noise makes.
    """

    stand: str
    joint: str
    off: float
    deviations: float


@dataclass(frozen=True, eq=False)
class StandFit(Fit):
    """A robot's numbers as stands at rest tell them.

    Attributes:
        stands: How many there are.
        total_mass: Of the whole robot (kg).
        residuals: {stand: root mean square of its residuals, in standard deviations}.
        joint_residuals: Of each joint in each stand, the most surprising before.
        chi2: Sum of all squared residuals, in standard deviations.
        freedom: What that is on average, if the model is right.
        noise: Standard deviations of measurements, as they were taken to be or were found.
    """

    stands: int
    total_mass: Estimate
    residuals: Mapping[str, float]
    joint_residuals: tuple[JointResidual, ...]
    chi2: float
    freedom: float
    noise: Mapping[str, float]


def describe_stands(
    robot: Robot,
    stands: MeasuredStands,
    equations: StandEquations,
    posterior: Posterior,
    expected: StandNoise,
    notes: Sequence[Diagnostic],
    weighed: bool,
) -> StandFit:
    """Returns what measurements tell, in numbers with intervals.

    Args:
        robot: The robot.
        stands: Its stands.
        equations: Of these, with the noise that was found.
        posterior: What is known of the parameters.
        expected: The noise that was expected.
        notes: What was found before.
        weighed: Whether the whole robot was put on a scale.
    """
    found = tuple(describe_parameters(posterior))
    more = dict(further_measurements(equations, posterior, weighed=weighed))
    return StandFit(
        name=robot.name,
        source=stands.source,
        stands=len(stands),
        estimates=found,
        total_mass=_total_mass(robot, posterior),
        together=find_together(posterior, more),
        residuals=dict(zip(stands.names, equations.residuals(posterior.mean), strict=True)),
        joint_residuals=_joint_residuals(stands, equations, posterior.mean),
        chi2=posterior.chi2,
        freedom=posterior.freedom,
        noise={
            "encoder": equations.noise.encoder,
            "moment": equations.noise.moment,
            "flatness": equations.noise.flatness,
            "friction": equations.noise.friction,
        },
        failures=tuple(doubt_stands(posterior, equations.noise, expected)),
        diagnostics=tuple(notes),
        posterior=posterior,
    )


def _joint_residuals(
    stands: MeasuredStands, equations: StandEquations, x: Array
) -> tuple[JointResidual, ...]:
    off, noise = equations.joint_residuals(x)
    found = [
        JointResidual(
            stand, joint, float(off[row, column]), float(off[row, column] / noise[row, column])
        )
        for row, stand in enumerate(stands.names)
        for column, joint in enumerate(stands.joints)
        if noise[row, column] > 0
    ]
    return tuple(sorted(found, key=lambda one: -abs(one.deviations)))


def _total_mass(robot: Robot, posterior: Posterior) -> Estimate:
    line = np.array([float(one.kind == "mass") for one in posterior.parameters])
    widths = np.array([one.width for one in posterior.parameters])
    stated = np.array([one.stated for one in posterior.parameters])
    std = math.sqrt(float(line @ posterior.covariance @ line))
    before = np.linalg.inv(posterior.precision)
    width = math.sqrt(float((line * widths) @ before @ (line * widths)))
    whole = Parameter("mass", robot.name, "", robot.total_mass, width)
    mean = robot.total_mass + float(line @ (posterior.mean - stated))
    return describe_parameter(whole, mean, std, told_by((std / width) ** 2 if width else 1.0))
