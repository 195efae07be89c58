"""How fits of logs begin: a base that is held, and which part of each log is predicted."""

from __future__ import annotations

from collections.abc import Sequence

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.robot.build import build_robot
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.fit.measurements.log import Log

HOLD_OUT = 0.2
"""Of each log, at its end: what is predicted, and not fitted."""


def hold_base(robot: Robot) -> Robot:
    """Returns a robot whose base is held where its MJCF has it."""
    return build_robot(robot.description, fixed_base=True) if robot.floating else robot


def share_out(
    logs: Sequence[Log], hold_out: float | Sequence[Log]
) -> tuple[tuple[Log, float], ...]:
    """Returns logs, each with the share at its end that is predicted: 1 of those held out whole.

    Args:
        logs: To be fitted.
        hold_out: A share of each, or logs beside them that are not fitted.

    Raises:
        ConfigurationError: If it is no share.
    """
    if not isinstance(hold_out, int | float):
        return (*((log, 0.0) for log in logs), *((log, 1.0) for log in hold_out))
    if not 0 <= hold_out < 1:
        raise ConfigurationError("hold_out", diagnose("not-between", given=hold_out, low=0, high=1))
    return tuple((log, float(hold_out)) for log in logs)
