"""What a fit tells: numbers with intervals, and what cannot be told apart."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

from pupper_analysis.base.diagnostics import Diagnostic
from pupper_analysis.base.results import Result
from pupper_analysis.tools.fit.correlation import Correlation, find_correlations
from pupper_analysis.tools.fit.estimate import NORMAL_95, Posterior
from pupper_analysis.tools.fit.parameters import OF_SURROUNDINGS, Parameter
from pupper_analysis.tools.fit.told import Together, Told, told_by


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


def describe_parameters(posterior: Posterior) -> Iterator[Estimate]:
    """Yields what is known of each parameter, those of the surroundings last."""
    order = sorted(
        range(len(posterior.parameters)),
        key=lambda place: posterior.parameters[place].kind in OF_SURROUNDINGS,
    )
    for place in order:
        one = posterior.parameters[place]
        yield describe_parameter(
            one,
            float(posterior.mean[place]),
            float(posterior.std[place]),
            told_by(float(posterior.shares[place])),
        )


def describe_parameter(one: Parameter, mean: float, std: float, told: Told) -> Estimate:
    """Returns what is known of a parameter."""
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
