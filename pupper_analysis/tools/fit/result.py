"""Results of a fit: estimates with 95 % intervals, classified by the effect of the measurements.

Input is the posterior distribution of the parameters. Output is an estimate of each parameter, with
mean and 95 % interval in the parameter's unit. The estimate is classified by the ratio of posterior
to prior variance. A small ratio means that the data determine the estimate, a ratio near 1 that the
prior does.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import ClassVar

import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic
from pupper_analysis.base.results import Result
from pupper_analysis.base.units import POSITION_UNIT
from pupper_analysis.tools.fit.estimate import HALF_WIDTH_95, Posterior
from pupper_analysis.tools.fit.parameters import SURROUNDINGS_KINDS, Parameter


class Determined(StrEnum):
    """Classification of an estimate by the ratio of posterior to prior variance."""

    DATA = "data"
    """Ratio below 0.1: the interval is less than a third as wide as the interval of the prior."""
    PARTLY = "partly"
    """Ratio from 0.1 to less than 0.9: both measurements and prior affect the estimate."""
    PRIOR = "prior"
    """Ratio of at least 0.9: the measurements hardly narrow the prior."""


_MAX_DATA_RATIO = 0.1
"""Upper bound (exclusive) of posterior variance / prior variance of an estimate that the data
determine. The interval of such an estimate is narrower than sqrt(0.1), about a third, of the
interval of the prior. Chosen, not tuned.
"""

_MIN_PRIOR_RATIO = 0.9
"""Lower bound (inclusive) of posterior variance / prior variance of an estimate that the prior
determines. The interval of such an estimate has at least sqrt(0.9), about 95 %, of the width of the
prior's interval. Chosen, not tuned.
"""


def classify_determination(variance_ratio: float) -> Determined:
    """Classify whether the data, the prior or both determine an estimate.

    ``variance_ratio`` is posterior variance / prior variance.
    """
    if variance_ratio < _MAX_DATA_RATIO:
        return Determined.DATA
    return Determined.PARTLY if variance_ratio < _MIN_PRIOR_RATIO else Determined.PRIOR


@dataclass(frozen=True)
class Estimate(Result):
    """Estimate of a parameter, or of a quantity that depends on parameters, after measurements.

    Attributes:
        name: Parameter name.
        kind: Parameter kind.
        subject: Link, joint or foot; ``floor``, ``servos`` (value of all servos) or
            ``scale``; robot name for the whole robot.
        component: ``x``, ``y`` or ``z``; ``command`` or ``position`` of a lag; empty for a scalar.
        unit: Unit of ``stated``, ``mean``, ``std``, ``low`` and ``high``.
        stated: Mean of the prior: the value of the model files, or the assumed value of the
            surroundings.
        mean: Most probable value.
        std: Standard deviation.
        low: Lower end of the 95 % interval.
        high: Upper end of the 95 % interval.
        determined: Whether the measurements (``data``), the prior (``prior``) or both (``partly``)
            determine the estimate.
    """

    name: str
    kind: str
    subject: str
    component: str
    unit: str
    stated: float = field(metadata={"unit": "varies"})
    mean: float = field(metadata={"unit": "varies"})
    std: float = field(metadata={"unit": "varies"})
    low: float = field(metadata={"unit": "varies"})
    high: float = field(metadata={"unit": "varies"})
    determined: Determined


@dataclass(frozen=True, eq=False)
class Fit(Result):
    """Parameters of a robot, estimated from measurements.

    Attributes:
        name: Robot name.
        source: Files of the measurements.
        estimates: Estimates of all parameters, parameters of the surroundings last.
        failures: Reasons for which the fit is not valid, for example measurements that contradict
            the model.
        diagnostics: Notes.
        kp_over_mass: Ratio of (mean estimated kp / stated kp) to (estimated carried mass / stated
            mass). Measured positions determine the ratio. None if kp is not estimated.
        posterior: Joint distribution of all parameters.
    """

    name: str
    source: str
    estimates: tuple[Estimate, ...]
    failures: tuple[Diagnostic, ...]
    diagnostics: tuple[Diagnostic, ...]
    kp_over_mass: Estimate | None
    posterior: Posterior
    _reported: ClassVar[tuple[str, ...]] = ("explained",)

    @property
    def explained(self) -> bool:
        """Whether the fitted model explains the measurements, so that ``failures`` is empty."""
        return not self.failures

    @property
    def noise_inflation(self) -> float:
        """Ratio of residuals to assumed noise, sqrt(chi2 / degrees of freedom), at least 1.

        The degrees of freedom are at least 1.
        """
        return max(
            1.0, math.sqrt(self.posterior.chi2 / max(self.posterior.degrees_of_freedom, 1.0))
        )


def describe_parameters(posterior: Posterior) -> Iterator[Estimate]:
    """Yield the estimate of each parameter of a fit.

    Parameters of the surroundings (`SURROUNDINGS_KINDS`) are last.
    """
    order = sorted(
        range(len(posterior.parameters)),
        key=lambda index: posterior.parameters[index].kind in SURROUNDINGS_KINDS,
    )
    for index in order:
        parameter = posterior.parameters[index]
        yield describe_parameter(
            parameter,
            float(posterior.mean[index]),
            float(posterior.std[index]),
            classify_determination(float(posterior.variance_ratios[index])),
        )


def describe_parameter(
    parameter: Parameter, mean: float, std: float, determined: Determined
) -> Estimate:
    """Create the estimate of a parameter, with a 95 % interval.

    ``mean`` and standard deviation ``std`` are in the parameter's unit.
    """
    stated = {name: getattr(parameter, name) for name in PARAMETER_FIELDS}
    low, high = mean - HALF_WIDTH_95 * std, mean + HALF_WIDTH_95 * std
    return Estimate(**stated, mean=mean, std=std, low=low, high=high, determined=determined)


PARAMETER_FIELDS = ("name", "kind", "subject", "component", "unit", "stated")
"""Fields and properties of a `Parameter` that an `Estimate` has as well."""


def derive_estimate(
    posterior: Posterior, parameter: Parameter, mean: float, gradient: Array
) -> Estimate:
    """Create the estimate of a quantity that depends on the parameters, with a 95 % interval.

    The variance is g^T C g, with the gradient g of the quantity and the covariance C of the
    parameters.

    Args:
        posterior: Distribution of the parameters.
        parameter: Name, unit and stated value of the quantity; the width is ignored.
        mean: Most probable value of the quantity, in the unit of the quantity.
        gradient: Derivative g of the quantity by the parameters, shape (n,).
    """
    scaled_gradient = gradient * np.array([estimated.width for estimated in posterior.parameters])
    std = math.sqrt(float(gradient @ posterior.covariance @ gradient))
    prior_std = math.sqrt(
        float(scaled_gradient @ np.linalg.inv(posterior.precision) @ scaled_gradient)
    )
    variance_ratio = (std / prior_std) ** 2 if prior_std else 1.0
    return describe_parameter(
        replace(parameter, width=prior_std), mean, std, classify_determination(variance_ratio)
    )


def estimate_kp_over_mass(posterior: Posterior, *, kp_only: bool = False) -> Estimate | None:
    """Estimate the ratio (mean factor on kp) / (factor on the carried mass), dimensionless.

    Measured joint positions determine this ratio.

    - Factor on kp: geometric mean of estimated kp / stated kp over the joints.
    - Factor on the carried mass: (1 + load) (sum of estimated masses) / (sum of their stated
      values). The load is the force on the feet in excess of the weight of the masses, as a
      fraction of the weight.

    Args:
        posterior: Distribution of the parameters.
        kp_only: Whether to estimate the factor on kp alone, without the factor on the mass.

    Returns:
        Estimate with a 95 % interval; None if no kp is estimated.
    """
    mean = posterior.mean
    stated = np.array([parameter.stated for parameter in posterior.parameters])
    servos, masses, loads = (posterior.kinds == kind for kind in ("kp", "mass", "load"))
    if not servos.any():
        return None
    factor = float(np.exp(np.log(mean[servos] / stated[servos]).mean()))
    gradient = np.zeros(len(mean))
    gradient[servos] = 1 / (servos.sum() * mean[servos])
    if masses.any() and not kp_only:
        factor *= float(stated[masses].sum() / mean[masses].sum())
        gradient[masses] = -1 / mean[masses].sum()
    if loads.any() and not kp_only:  # the feet carry this load as well
        factor /= float(1 + mean[loads].sum())
        gradient[loads] = -1 / (1 + mean[loads].sum())
    quantity = Parameter("kp", "servos", "", 1.0, 0.0)
    return replace(derive_estimate(posterior, quantity, factor, factor * gradient), unit="1")


@dataclass(frozen=True, eq=False)
class MotionFit(Fit):
    """Parameters of a robot, estimated from logs of motions.

    RMS position errors over several joints count 1 m of a slide as 1 rad.

    Attributes:
        seconds: Total duration of the logs, without logs that are only predicted, not fitted.
        held_out: RMS position error in samples that were not fitted; NaN if there are none.
        held_out_before: RMS position error in the same samples, with the stated parameters.
        fitted: RMS position error in samples that were fitted.
        fitted_before: RMS position error in the same samples, with the stated parameters.
        repeatability: RMS difference between runs of the same commands, divided by sqrt(2); NaN if
            no two runs have the same commands.
        by_joint: RMS position error of each joint in samples that were not fitted. If there are
            none, in samples that were fitted. NaN without samples.
        encoder_noise: Standard deviation of each joint's encoder noise; 0 for constant readings,
            NaN without samples.
        slides: Names of the joints that are slides (prismatic).
    """

    seconds: float = field(metadata={"unit": "s"})
    held_out: float = field(metadata={"unit": "rad"})
    held_out_before: float = field(metadata={"unit": "rad"})
    fitted: float = field(metadata={"unit": "rad"})
    fitted_before: float = field(metadata={"unit": "rad"})
    repeatability: float = field(metadata={"unit": "rad"})
    by_joint: Mapping[str, float] = field(metadata={"unit": POSITION_UNIT})
    encoder_noise: Mapping[str, float] = field(metadata={"unit": POSITION_UNIT})
    slides: tuple[str, ...] = ()

    @property
    def noise_inflation(self) -> float:
        """Ratio of RMS position errors in held-out samples and in fitted samples, at least 1.

        Held-out samples are samples that were not fitted. Without such samples, the ratio is 1.
        """
        return max(1.0, self.held_out / self.fitted) if self.held_out > 0 else 1.0
