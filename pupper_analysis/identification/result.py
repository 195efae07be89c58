"""What a fit tells: numbers with intervals, what cannot be told apart, what is not explained."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.identification.correlation import Correlation, find_correlations
from pupper_analysis.identification.estimate import NORMAL_95, Posterior
from pupper_analysis.identification.parameters import OF_SURROUNDINGS, Parameter
from pupper_analysis.identification.remedies import further_measurements
from pupper_analysis.identification.stand_equations import StandEquations
from pupper_analysis.identification.stand_rows import StandNoise
from pupper_analysis.identification.stands import MeasuredStands
from pupper_analysis.identification.surroundings import doubt_surroundings
from pupper_analysis.identification.told import Together, Told, find_together, told_by
from pupper_analysis.results import Result
from pupper_analysis.robot.robot import Robot

Array = NDArray[np.float64]

_NOISY = 5.0
"""Times what was expected: noise of which there is so much hides a cause."""


@dataclass(frozen=True)
class Estimate(Result):
    """What is known of a parameter after measurements.

    Attributes:
        name: Of the parameter.
        kind: Of number.
        subject: The link, joint or foot; ``floor`` or ``imu``.
        component: ``x``, ``y``, ``z``, ``roll``, ``pitch``, or empty.
        unit: Of the following numbers.
        stated: The model's value.
        mean: The most probable value.
        std: Standard deviation.
        low: Lower end of the interval that holds it with 95 %.
        high: Upper end.
        told: How much of it is from measurements: ``data``, ``partly``, ``prior``.
    """

    name: str
    kind: str
    subject: str
    component: str
    unit: str
    stated: float
    mean: float
    std: float
    low: float
    high: float
    told: Told


@dataclass(frozen=True)
class Expected(Result):
    """What measurements will tell of a parameter.

    Attributes:
        name: Of the parameter.
        unit: Of the following numbers.
        stated: The model's value.
        before: Half of the interval that holds it with 95 %, before.
        after: The same after the measurements.
        told: How much of it will be from them.
    """

    name: str
    unit: str
    stated: float
    before: float
    after: float
    told: Told


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
class Fit(Result):
    """A robot's numbers as measurements tell them.

    Attributes:
        name: The robot's name.
        source: Where the measurements are from.
        estimates: Of all parameters, those of the surroundings last.
        together: What cannot be told apart.
        failures: What the model does not explain.
        diagnostics: What else there is to say.
        posterior: What is known of all parameters together.
    """

    name: str
    source: str
    estimates: tuple[Estimate, ...]
    together: tuple[Together, ...]
    failures: tuple[Diagnostic, ...]
    diagnostics: tuple[Diagnostic, ...]
    posterior: Posterior
    _told: ClassVar[tuple[str, ...]] = ("explained", "correlations")

    @property
    def explained(self) -> bool:
        """Whether the model explains the measurements."""
        return not self.failures

    @property
    def correlations(self) -> tuple[Correlation, ...]:
        """Parameters that are off together, the strongest before."""
        return find_correlations(self.posterior)


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


def describe_fit(
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
        failures=tuple(_unexplained(posterior, equations.noise, expected)),
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


def describe_parameters(posterior: Posterior) -> Iterator[Estimate]:
    """Yields what is known of each parameter, those of the surroundings last."""
    order = sorted(
        range(len(posterior.parameters)),
        key=lambda place: posterior.parameters[place].kind in OF_SURROUNDINGS,
    )
    for place in order:
        one = posterior.parameters[place]
        yield _estimate(
            one,
            float(posterior.mean[place]),
            float(posterior.std[place]),
            told_by(float(posterior.shares[place])),
        )


def _estimate(one: Parameter, mean: float, std: float, told: Told) -> Estimate:
    return Estimate(
        name=one.name,
        kind=one.kind,
        subject=one.subject,
        component=one.component,
        unit=one.unit,
        stated=one.stated,
        mean=mean,
        std=std,
        low=mean - NORMAL_95 * std,
        high=mean + NORMAL_95 * std,
        told=told,
    )


def _total_mass(robot: Robot, posterior: Posterior) -> Estimate:
    line = np.array([float(one.kind == "mass") for one in posterior.parameters])
    widths = np.array([one.width for one in posterior.parameters])
    stated = np.array([one.stated for one in posterior.parameters])
    std = math.sqrt(float(line @ posterior.covariance @ line))
    before = np.linalg.inv(posterior.precision)
    width = math.sqrt(float((line * widths) @ before @ (line * widths)))
    whole = Parameter("mass", robot.name, "", robot.total_mass, width)
    mean = robot.total_mass + float(line @ (posterior.mean - stated))
    return _estimate(whole, mean, std, told_by((std / width) ** 2 if width else 1.0))


def _unexplained(
    posterior: Posterior, found: StandNoise, expected: StandNoise
) -> Iterator[Diagnostic]:
    """Yields what the model does not explain of the measurements."""
    from scipy import stats  # slow to import

    if stats.chi2.sf(posterior.chi2, max(posterior.freedom, 1.0)) < _CHANCE:
        ratio = posterior.chi2 / max(posterior.freedom, 1.0)
        yield diagnose("residuals-too-large", times=math.sqrt(ratio))
    if found.flatness > _NOISY * expected.flatness:
        yield diagnose("feet-off-the-plane", off=Quantity(found.flatness, "m"))
    if found.friction > _NOISY * expected.friction:
        yield diagnose("torques-off", times=found.friction / expected.friction)
    own = [place for place, one in enumerate(posterior.parameters) if _is_own(one)]
    moved = {
        place: (posterior.mean[place] - posterior.parameters[place].stated)
        / _surprise(posterior, place)
        for place in own
    }
    far = [
        place
        for place in own
        if abs(moved[place]) > _FAR
        or (
            (posterior.parameters[place].kind in _NEVER_NOTHING and moved[place] < 0)
            and posterior.mean[place] < _NOTHING * posterior.parameters[place].stated
        )
    ]
    if far:
        worst = max(far, key=lambda place: abs(moved[place]))
        names = [posterior.parameters[place].name for place in far]
        yield diagnose("far-from-the-file", names=names, widths=abs(float(moved[worst])))
    yield from doubt_surroundings(posterior)


def _surprise(posterior: Posterior, place: int) -> float:
    """Returns the standard deviation of an estimate, if the parameter is as it was said to be.

    What is known before and after differ in variance by it: an estimate by poor measurements stays
    near the stated value, and tells as much by a smaller step.
    """
    width = posterior.parameters[place].width
    told = max(width**2 - float(posterior.covariance[place, place]), _LEAST_TOLD * width**2)
    return math.sqrt(told)


_LEAST_TOLD = 0.02
"""Of a prior's variance: a parameter of which no more is told speaks against nothing."""


def _is_own(one: Parameter) -> bool:
    return one.kind not in OF_SURROUNDINGS


_FAR = 4.5
"""Standard deviations: of a hundred numbers that are as was said, none is so far off."""

_NEVER_NOTHING, _NOTHING = ("mass", "kp"), 0.01
"""Kinds of numbers that no robot has none of, and what is none, in parts of the stated value."""

_CHANCE = 1e-3
"""Probability of residuals that are larger by chance."""
