"""Record observations and actions of a running policy as a trace, which ``walk --trace`` reads.

A `Listener` collects messages while the controller of the robot runs. `assemble_trace` creates a
row per action from these messages. `record_policy` writes the rows as npz.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import ConfigurationError, MeasurementError
from pupper_analysis.base.files import check_writable, write_atomically
from pupper_analysis.base.results import Result
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.fit.kinds import TRACE_KIND
from pupper_analysis.tools.fit.record.bridge import open_connection

Series = Mapping[str, Sequence[tuple[float, Array]]]
"""Received messages: {signal: [(time of reception [s], values), ...]}."""

SIGNALS = ("positions", "velocities", "targets", "commands", "angular_velocity", "quaternion")
"""Optional signals of a trace, as keys of `Series`. Units are those of
`pupper_analysis.tools.walk.trace`.
"""

MIN_ACTIONS = 20
"""Smallest number of observations, of actions, and of rows of a trace. Chosen, not tuned."""

LISTENERS_GROUP = "pupper_analysis.listeners"
"""Name of the entry point group with which other packages add listeners. An entry point is a
function that returns a `Listener`. The function has two arguments: the robot, and the text after
the colon in ``NAME:ARGUMENTS``.
"""

_BUILTIN_LISTENERS = {"ros2": "pupper_analysis.tools.fit.record.ros:open_ros_listener"}
"""{name of a listener of this package: ``module:function`` that opens the listener}."""


class Listener(Protocol):
    """Connection to a robot that receives messages of the running controller."""

    def listen(self, seconds: float) -> Series:
        """Receive messages for a duration [s], and return the values with the times of reception.

        The signals are ``observations``, ``actions``, and the following optional signals:

        - ``positions``, ``velocities`` and ``targets``: in actuator order [rad, m], [rad/s, m/s]
        - ``commands``: forward and left velocity [m/s], turning rate [rad/s]
        - ``angular_velocity``: in the base frame [rad/s]
        - ``quaternion``: (w, x, y, z)
        """


@dataclass(frozen=True)
class TraceRecording(Result):
    """Result of recording a running policy.

    Attributes:
        name: Robot name.
        file: Output file.
        samples: Number of recorded actions.
        period: Median time between successive rows of the trace.
        signals: Optional signals in the trace, for example positions or velocity commands.
        missing: Optional signals that were not received; `walk` does not check observation terms
            that need these signals.
        findings: Note on ignored actions, if any.
    """

    name: str
    file: str
    samples: int
    period: float = field(metadata={"unit": "s"})
    signals: tuple[str, ...]
    missing: tuple[str, ...]
    findings: tuple[Diagnostic, ...]

    @property
    def complete(self) -> bool:
        """Whether all optional signals were received."""
        return not self.missing


def record_policy(robot: Robot, bridge: str, seconds: float, output: str | Path) -> TraceRecording:
    """Record a running policy as a trace. Nothing is sent to the robot.

    Args:
        robot: Robot.
        bridge: ``NAME`` or ``NAME:ARGUMENTS`` of a listener.
        seconds: Duration [s].
        output: npz file.

    Raises:
        ConfigurationError: If the duration is not from 1 to 3600 s, there is no listener of this
            name, or the listener cannot be opened.
        MeasurementError: If fewer than `MIN_ACTIONS` observations or actions are received, or fewer
            actions can be recorded.
        OutputError: If the file cannot be written.
    """
    if not 1 <= seconds <= 3600:
        problem = diagnose("not-between", given=seconds, low=1, high=3600)
        raise ConfigurationError("--listen", problem)
    path = Path(output)
    check_writable(path, TRACE_KIND)
    arrays, left_out = assemble_trace(_open_listener(bridge, robot).listen(seconds), bridge)
    with write_atomically(path, TRACE_KIND) as file:
        content: dict[str, Any] = {**arrays, "joints": np.array(robot.joint_names)}
        np.savez(file, **content)
    return TraceRecording(
        name=robot.name,
        file=str(path),
        samples=len(arrays["time"]),
        period=float(np.median(np.diff(arrays["time"]))),
        signals=tuple(name for name in SIGNALS if name in arrays),
        missing=tuple(name for name in SIGNALS if name not in arrays),
        findings=(diagnose("actions-left-out", count=left_out),) if left_out else (),
    )


def _open_listener(name: str, robot: Robot) -> Listener:
    """Open a connection that receives messages; ``name`` is ``NAME`` or ``NAME:ARGUMENTS``."""
    listener: Listener = open_connection(name, robot, _BUILTIN_LISTENERS, LISTENERS_GROUP)
    return listener


def assemble_trace(series: Series, source: str) -> tuple[dict[str, Array], int]:
    """Assemble the arrays of a trace, with a row per action, from received messages.

    An action belongs to the observation that is nearest in time. A row contains the last message of
    each signal up to this observation. Actions without such a row are left out, for example before
    all signals have been received. Of several actions at an observation, the nearest is kept.

    Args:
        series: Messages.
        source: Name of the listener, for error messages.

    Returns:
        Arrays {name: array with a row per action}; number of omitted actions. The array ``time``
        [s] starts at 0.

    Raises:
        MeasurementError: If there are fewer than `MIN_ACTIONS` observations, actions or rows.
    """
    counts = [len(series.get(name, ())) for name in ("observations", "actions")]
    if min(counts) < MIN_ACTIONS:
        problem = diagnose("policy-is-silent", observed=counts[0], acted=counts[1])
        raise MeasurementError(source, problem)
    observed, acted = (
        np.array([time for time, _ in series[name]]) for name in ("observations", "actions")
    )
    nearest = np.abs(acted[:, None] - observed[None]).argmin(axis=1)
    distance = np.abs(acted - observed[nearest])
    present = [name for name in SIGNALS if series.get(name)]
    times = {name: np.array([time for time, _ in series[name]]) for name in present}
    begin = max([stamps[0] for stamps in times.values()], default=-np.inf)
    rows: dict[int, int] = {}
    for action, observation in enumerate(nearest.tolist()):
        previous = rows.get(observation)
        if observed[observation] >= begin and (
            previous is None or distance[action] < distance[previous]
        ):
            rows[observation] = action
    if len(rows) < MIN_ACTIONS:
        problem = diagnose("policy-is-silent", observed=len(rows), acted=len(rows))
        raise MeasurementError(source, problem)
    chosen = sorted(rows)
    moments = observed[chosen]
    arrays = {
        "observations": np.array([series["observations"][index][1] for index in chosen]),
        "actions": np.array([series["actions"][rows[index]][1] for index in chosen]),
        "time": moments - moments[0],
    }
    for name in present:
        last = np.searchsorted(times[name], moments, side="right") - 1
        arrays[name] = np.array([series[name][index][1] for index in last.tolist()])
    return arrays, len(acted) - len(chosen)
