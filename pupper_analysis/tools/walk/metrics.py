"""Metrics of a walking policy for `study`: {name: arguments of the metric}."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import partial
from typing import Any

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError, NotStandingError
from pupper_analysis.base.units import EFFORT_UNIT


def _make_policy_metric(
    measure: Callable[[Any], float], text: str
) -> tuple[Callable[[Any], float], str]:
    """Return a metric of a design that walks with a policy, and a hash of policy and command.

    Args:
        measure: Function of the simulated gait (an element of ``gaits`` of `simulate_walk`) that
            returns the value of the metric.
        text: ``POLICY[@VX,VY,W]``: file of the policy, and the velocity command: forward [m/s],
            left [m/s], turning left [rad/s]. Without a command, 0.5 m/s forward.
    """
    from pupper_analysis.base.runs import register_input
    from pupper_analysis.tools.walk.gait import check_command, simulate_walk
    from pupper_analysis.tools.walk.policy import Policy

    file, separator, command_text = text.partition("@")
    try:
        command = check_command(
            [float(number) for number in command_text.split(",")] if separator else (0.5, 0.0, 0.0)
        )
    except ValueError as error:
        raise ConfigurationError("measure", diagnose("no-numbers", count=3)) from error
    policy, digest = Policy.load(file), hashlib.sha256(repr(command.tolist()).encode())
    for path in policy.files:
        register_input(path)
        digest.update(path.read_bytes())

    def walked(design: Any) -> float:
        return measure(simulate_walk(design.robot, policy, command, workers=1).gaits[0])

    return walked, digest.hexdigest()[:16]


def _read_largest_torque(gait: Any) -> float:
    """Return the largest rms torque of a motor [N m, N]; raise a NotStandingError after a fall.

    The torques before a fall are not torques of walking.
    """
    if gait.fall is not None:
        raise NotStandingError((gait.fall,))
    return float(gait.torque_rms.max())


_COMMON_ARGUMENTS = {
    "function": None,
    "simulates": True,
}
"""Arguments of `Metric` with the same value for all `METRICS`. ``function`` is None, because the
argument ``of_file`` creates the function from the file of the policy."""

METRICS: dict[str, dict[str, Any]] = {
    "walk_margin": {
        **_COMMON_ARGUMENTS,
        "of_file": partial(_make_policy_metric, lambda gait: gait.margin if gait.tracks else 0.0),
        "unit": "1",
        "fallen": 0.0,
    },
    "walk_torque": {
        **_COMMON_ARGUMENTS,
        "of_file": partial(_make_policy_metric, _read_largest_torque),
        "unit": EFFORT_UNIT,
    },
}
"""{metric of `study` that walks with a policy: arguments of `Metric`}."""
