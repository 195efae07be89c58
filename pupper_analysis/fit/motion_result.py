"""What logs of motions tell, as numbers with intervals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

from pupper_analysis.diagnostics import Diagnostic
from pupper_analysis.fit.estimate import Posterior
from pupper_analysis.fit.log import Log
from pupper_analysis.fit.motion import MotionFit
from pupper_analysis.fit.result import Estimate, describe_parameters
from pupper_analysis.fit.told import Together, find_together
from pupper_analysis.results import Result

_UNEXPLAINED = "motion-not-explained"


@dataclass(frozen=True, eq=False)
class FittedMotion(Result):
    """A robot's numbers as logs of its motions tell them.

    Attributes:
        name: The robot's name.
        source: Where the measurements are from.
        seconds: How long the motions are.
        held_out: Root mean square of what is off in motions that were not fitted (rad).
        held_out_before: The same with the file's own numbers (rad).
        fitted: The same in motions that were fitted (rad).
        repeatability: How far the robot is from itself over runs of the same commands (rad); NaN if
            no two are the same.
        by_joint: {joint: root mean square of what is off (rad)}.
        encoder_noise: {joint: noise of its encoder (rad)}.
        estimates: Of all parameters.
        together: What cannot be told apart.
        failures: What the model does not explain.
        diagnostics: What else there is to say.
        posterior: What is known of all parameters together.
    """

    name: str
    source: str
    seconds: float
    held_out: float
    held_out_before: float
    fitted: float
    repeatability: float
    by_joint: Mapping[str, float]
    encoder_noise: Mapping[str, float]
    estimates: tuple[Estimate, ...]
    together: tuple[Together, ...]
    failures: tuple[Diagnostic, ...]
    diagnostics: tuple[Diagnostic, ...]
    posterior: Posterior
    _told: ClassVar[tuple[str, ...]] = ("explained",)

    @property
    def explained(self) -> bool:
        """Whether the model explains the measurements."""
        return not self.failures


def describe_motion(fit: MotionFit, logs: Sequence[Log]) -> FittedMotion:
    """Returns what logs tell, in numbers with intervals.

    Args:
        fit: The fit.
        logs: To which it was made.
    """
    names = fit.robot.joint_names
    return FittedMotion(
        name=fit.robot.name,
        source=", ".join(log.source for log in logs),
        seconds=sum(log.duration for log in logs),
        held_out=fit.held_out,
        held_out_before=fit.held_out_before,
        fitted=fit.fitted,
        repeatability=fit.repeatability,
        by_joint=dict(zip(names, fit.by_joint.tolist(), strict=True)),
        encoder_noise=dict(zip(names, fit.encoder_noise.tolist(), strict=True)),
        estimates=tuple(describe_parameters(fit.posterior)),
        together=find_together(fit.posterior),
        failures=tuple(one for one in fit.diagnostics if one.code == _UNEXPLAINED),
        diagnostics=tuple(one for one in fit.diagnostics if one.code != _UNEXPLAINED),
        posterior=fit.posterior,
    )
