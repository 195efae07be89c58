"""What a fit tells: numbers with intervals, and what cannot be distinguished."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import Diagnostic
from pupper_analysis.base.results import Result
from pupper_analysis.tools.fit.estimate import HALF_WIDTH_95, Posterior
from pupper_analysis.tools.fit.parameters import SURROUNDINGS_KINDS, Parameter

Array = NDArray[np.float64]


class Determined(StrEnum):
    """How much of an estimate is from measurements."""

    DATA = "data"
    """The interval is at most a third of what was known before."""
    PARTLY = "partly"
    """It is narrower than that, but the prior counts."""
    PRIOR = "prior"
    """The prior alone holds it: measurements tell nothing."""


_BY_DATA, _BY_PRIOR = 0.1, 0.9
"""Of the prior's variance that is left: a third, and 95 %, of its width."""


def classify_determination(share: float) -> Determined:
    """Returns how much is from measurements, by the share of the prior's variance that is left."""
    if share < _BY_DATA:
        return Determined.DATA
    return Determined.PARTLY if share < _BY_PRIOR else Determined.PRIOR


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
        determined: How much of it is from measurements: ``data``, ``partly``, ``prior``.
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
    """A robot's numbers as measurements tell them.

    Attributes:
        name: The robot's name.
        source: Where the measurements are from.
        estimates: Of all parameters, those of the surroundings last.
        failures: What the model does not explain.
        diagnostics: What else there is to say.
        kp_over_mass: By which factor all kp over the masses are others than stated: what positions
            determine, whatever is known of either; None if kp is known.
        posterior: What is known of all parameters together.
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
        """Whether the model explains the measurements."""
        return not self.failures

    @property
    def noise_inflation(self) -> float:
        """How many times what is left is what noise leaves; 1 at least."""
        return max(
            1.0, math.sqrt(self.posterior.chi2 / max(self.posterior.degrees_of_freedom, 1.0))
        )


def describe_parameters(posterior: Posterior) -> Iterator[Estimate]:
    """Yields what is known of each parameter, those of the surroundings last."""
    order = sorted(
        range(len(posterior.parameters)),
        key=lambda place: posterior.parameters[place].kind in SURROUNDINGS_KINDS,
    )
    for place in order:
        one = posterior.parameters[place]
        yield describe_parameter(
            one,
            float(posterior.mean[place]),
            float(posterior.std[place]),
            classify_determination(float(posterior.variance_ratios[place])),
        )


def describe_parameter(one: Parameter, mean: float, std: float, determined: Determined) -> Estimate:
    """Returns what is known of a parameter."""
    stated = {name: getattr(one, name) for name in PARAMETER_FIELDS}
    low, high = mean - HALF_WIDTH_95 * std, mean + HALF_WIDTH_95 * std
    return Estimate(**stated, mean=mean, std=std, low=low, high=high, determined=determined)


PARAMETER_FIELDS = ("name", "kind", "subject", "component", "unit", "stated")


def derive_estimate(posterior: Posterior, one: Parameter, mean: float, line: Array) -> Estimate:
    """Returns what is known of a number that changes by ``line`` (n,) with the parameters."""
    wide = line * np.array([own.width for own in posterior.parameters])
    std = math.sqrt(float(line @ posterior.covariance @ line))
    before = math.sqrt(float(wide @ np.linalg.inv(posterior.precision) @ wide))
    share = (std / before) ** 2 if before else 1.0
    return describe_parameter(replace(one, width=before), mean, std, classify_determination(share))


def estimate_kp_over_mass(posterior: Posterior, *, kp_only: bool = False) -> Estimate | None:
    """Returns by which factor servos are stiffer over all that they carry; None if kp is known.

    The geometric mean of kp's factors, over the factor of the masses' sum, with their load.

    Args:
        posterior: What is known of the parameters.
        kp_only: Whether it is of kp, and not over masses.
    """
    mean = posterior.mean
    stated = np.array([one.stated for one in posterior.parameters])
    servos, masses, loads = (posterior.kinds == kind for kind in ("kp", "mass", "load"))
    if not servos.any():
        return None
    factor = float(np.exp(np.log(mean[servos] / stated[servos]).mean()))
    line = np.zeros(len(mean))
    line[servos] = 1 / (servos.sum() * mean[servos])
    if masses.any() and not kp_only:
        factor *= float(stated[masses].sum() / mean[masses].sum())
        line[masses] = -1 / mean[masses].sum()
    if loads.any() and not kp_only:  # what no scale has shown is carried, too
        factor /= float(1 + mean[loads].sum())
        line[loads] = -1 / (1 + mean[loads].sum())
    whole = Parameter("kp", "servos", "", 1.0, 0.0)
    return replace(derive_estimate(posterior, whole, factor, factor * line), unit="1")


# What logs of motions tell, as numbers with intervals.


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
    """

    seconds: float = field(metadata={"unit": "s"})
    held_out: float = field(metadata={"unit": "rad"})
    held_out_before: float = field(metadata={"unit": "rad"})
    fitted: float = field(metadata={"unit": "rad"})
    fitted_before: float = field(metadata={"unit": "rad"})
    repeatability: float = field(metadata={"unit": "rad"})
    by_joint: Mapping[str, float] = field(metadata={"unit": "rad"})
    encoder_noise: Mapping[str, float] = field(metadata={"unit": "rad"})

    @property
    def noise_inflation(self) -> float:
        """How many times what is off in other motions is what it was fitted to; 1 at least."""
        return max(1.0, self.held_out / self.fitted) if self.held_out > 0 else 1.0
