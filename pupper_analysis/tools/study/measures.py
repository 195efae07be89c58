"""What is measured of a design: named metrics, and functions of (robot, stand)."""

from __future__ import annotations

import hashlib
import importlib
import inspect
import pickle
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError, NotStandingError, PupperAnalysisError
from pupper_analysis.base.tools import find_tool_modules
from pupper_analysis.prepare.judge import judge_stand
from pupper_analysis.prepare.own_run import own_run
from pupper_analysis.present.verdict import own_clauses
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import servo_gains
from pupper_analysis.robot.stability import Stability
from pupper_analysis.robot.tool import Place
from pupper_analysis.simulation.causes import describe_growth
from pupper_analysis.simulation.stability import rest_stability
from pupper_analysis.simulation.verdict import Verdict
from pupper_analysis.stance.sag.steady_state import SteadyState, minimum_stiffness, steady_state
from pupper_analysis.stance.soft_ground import solve_stand_as_simulated
from pupper_analysis.stance.stand import Stand, stand_statics
from pupper_analysis.stance.workspace import BaseWorkspace, base_workspace
from pupper_analysis.statics.equilibrium import GravityCompensation

MetricValue = float | bool
MetricFunction = Callable[[Robot, Stand], Any]


@dataclass(eq=False)
class Design:
    """A design that stands: what its metrics look at, each worked out once.

    Attributes:
        robot: The robot, with its payload and its servos' gains.
        stand: How it stands.
        own_servos: Whether these gains are its file's, and what that does by itself counts.
        point: Where a payload is, or is sought; see ``robot.tool.find_place``.
    """

    robot: Robot
    stand: Stand
    own_servos: bool = True
    point: Place = (0.0, 0.0, 0.0)

    @cached_property
    def gains(self) -> dict[str, Any]:
        """Its servos' kp and kd (nu,), as ``--kp`` and ``--kd`` give them; its own are not."""
        if self.own_servos:
            return {}
        gains = servo_gains(self.robot)
        return {"kp": gains.kp, "kd": gains.kd}

    @cached_property
    def statics(self) -> GravityCompensation:
        """What the motors hold, with the contact forces that last."""
        return stand_statics(self.robot, self.stand)

    @cached_property
    def _sought(self) -> SteadyState | PupperAnalysisError:
        """The equilibrium, or why there is none; also a search that fails is run once."""
        try:
            return steady_state(self.robot, self.stand)
        except PupperAnalysisError as error:
            return error

    @property
    def equilibrium(self) -> SteadyState:
        """Where its servos balance it without feed-forward, whether it stays there or not.

        Raises:
            PupperAnalysisError: As ``steady_state``.
        """
        if isinstance(self._sought, PupperAnalysisError):
            raise self._sought
        return self._sought

    @property
    def rest(self) -> SteadyState:
        """Where its servos let it come to rest, without feed-forward.

        Raises:
            NotStandingError: If it does not stay up there: then it rests elsewhere, if at all.
            PupperAnalysisError: As ``steady_state``.
        """
        if self.equilibrium.failures:
            raise NotStandingError(self.equilibrium.failures)
        return self.equilibrium

    @cached_property
    def stability(self) -> Stability:
        """Of where it comes to rest, by the spectrum of a step: what a simulation would show.

        Raises:
            PupperAnalysisError: As ``rest``.
        """
        return rest_stability(self.robot, self.stand, self.rest)

    @cached_property
    def workspace(self) -> BaseWorkspace:
        """How far the base can go."""
        return base_workspace(self.robot, self.stand.task)

    @cached_property
    def held(self) -> Stand:
        """The stand that is simulated, as everywhere: its feet sunk into MuJoCo's ground."""
        return solve_stand_as_simulated(self.robot, self.stand)

    @cached_property
    def verdict(self) -> Verdict:
        """What ``stand`` says of it."""
        return judge_stand(self.robot, self.stand, **self.gains)

    def per_joint(self, values: Iterable[float]) -> dict[str, float]:
        """Returns values by joint."""
        named = zip(self.robot.joint_names, values, strict=True)
        return {name: float(value) for name, value in named}

    def span(self, direction: str) -> float:
        """Returns how far apart the ends of one of the workspace's intervals are."""
        interval = self.workspace.intervals[direction]
        return interval.high - interval.low

    def utilisation_at_rest(self) -> float:
        """Returns the peak motor utilisation where the servos let it come to rest."""
        return float(np.max(np.abs(self.rest.joint_torques) / self.robot.effort_limits))


@dataclass(frozen=True)
class Metric:
    """A metric.

    Attributes:
        name: The column that it fills; with several values, ``NAME.KEY`` for each.
        function: Of a design; of one of a file, ``of_file`` makes it.
        unit: Its unit; ``1`` of a ratio, empty of one's own functions.
        simulates: Whether it takes a simulation, or some seconds.
        fallen: Its value of a design that cannot stand so; None where it has none.
        of_file: Of what is written after a colon, such as a policy's file: returns the function,
            and what tells that the file has changed; None where a metric is of a design alone.
        file: What is written there.
        content: What told so.
    """

    name: str
    function: Callable[[Design], MetricValue | Mapping[str, MetricValue]]
    unit: str
    simulates: bool = False
    fallen: float | None = None
    of_file: Callable[[str], tuple[Callable[[Design], MetricValue], str]] | None = None
    file: str = ""
    content: str = ""


def text_key(metric: str) -> str:
    """Return the catalogue key of a metric's meaning, which other packages may omit."""
    return f"metric-{metric.replace('_', '-')}"


def _stands(design: Design) -> bool:
    """Tells so, or says why not: it stays up, and neither shakes nor buckles within 12 s."""
    own = own_run(design.robot) if design.own_servos else None
    if own is not None and own.fails:
        raise NotStandingError(
            tuple(clause.message for clause in own_clauses(own) if not clause.good)
        )
    leaving = design.stability.leaving()
    if leaving:
        raise NotStandingError((describe_growth(leaving[0]),))
    return True


def _peak(values: NDArray[np.float64]) -> float:
    return float(np.abs(values).max())


def _friction_utilisation(design: Design) -> float:
    return max(design.statics.friction_utilisation.values())


def _minimum_stiffness(design: Design) -> float:
    return minimum_stiffness(design.robot, design.stand)


_ALL = (
    Metric("total_mass", lambda d: d.robot.total_mass, "kg"),
    Metric("peak_utilisation", lambda d: _peak(d.statics.motor_utilisation), "1"),
    Metric("peak_torque", lambda d: _peak(d.statics.joint_torques), "N m"),
    Metric("torque", lambda d: d.per_joint(d.statics.joint_torques), "N m"),
    Metric("utilisation", lambda d: d.per_joint(d.statics.motor_utilisation), "1"),
    Metric("friction_utilisation", _friction_utilisation, "1"),
    Metric("com_margin", lambda d: d.stand.com_margin, "m"),
    Metric("base_height", lambda d: d.rest.base_height, "m"),
    Metric("sag", lambda d: d.rest.height_loss, "m"),
    Metric("servo_sag", lambda d: d.rest.servo_sag, "m"),
    Metric("stiffness", lambda d: d.equilibrium.stiffness, "rad^2/s^2"),
    Metric("rest_utilisation", lambda d: d.utilisation_at_rest(), "1"),
    Metric("stands", _stands, "1", fallen=0.0),
    Metric("minimum_stiffness", _minimum_stiffness, "N m/rad", simulates=True),
    Metric("height_range", lambda d: d.span("height"), "m", simulates=True),
    Metric("roll_range", lambda d: d.span("roll"), "rad", simulates=True),
    Metric("pitch_range", lambda d: d.span("pitch"), "rad", simulates=True),
    Metric("verified", lambda d: d.verdict.passed, "1", simulates=True, fallen=0.0),
)


def _of_tools() -> Iterator[Metric]:
    """Yields what tools let studies measure: the ``METRICS`` of their ``metrics.py``."""
    for package in find_tool_modules("metrics").values():
        offered = importlib.import_module(f"{package}.metrics").METRICS
        yield from (Metric(name, **more) for name, more in offered.items())


METRICS_REVISION = 5
"""Of what metrics mean, raised when one changes: results of before are not taken for it."""

METRICS: Mapping[str, Metric] = {metric.name: metric for metric in (*_ALL, *_of_tools())}
"""The named metrics."""


def make_metric(given: str | MetricFunction) -> Metric:
    """Returns a named metric, or makes one of a function of (robot, stand).

    Args:
        given: A name of ``METRICS``, with ``:FILE`` where it is of one, or a function that other
            processes can import: it stands at the top of a module.

    Raises:
        ConfigurationError: If there is no such metric, or the function does not fit.
    """
    if isinstance(given, str):
        if (named := METRICS.get(given.partition(":")[0])) is not None:
            return _of_file(named, given)
        finding = diagnose("metric-unknown", name=given, known=METRICS)
        raise ConfigurationError("measure", finding)
    if not callable(given):
        raise ConfigurationError("measure", diagnose("metric-no-function", given=repr(given)))
    try:
        inspect.signature(given).bind(None, None)
    except (TypeError, ValueError) as error:
        problem = diagnose("metric-of-another-signature", given=repr(given), problem=str(error))
        raise ConfigurationError("measure", problem) from error
    try:
        pickle.dumps(given)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        problem = diagnose("metric-not-picklable", given=repr(given))
        raise ConfigurationError("measure", problem) from error
    name = getattr(given, "__name__", type(given).__name__)
    if name in METRICS:
        problem = diagnose("metric-name-taken", name=name)
        raise ConfigurationError("measure", problem)
    return Metric(name, UserFunction(given), "")


def _of_file(metric: Metric, given: str) -> Metric:
    """Returns a named metric, of the file after its colon if it is of one."""
    _, colon, file = given.partition(":")
    if metric.of_file is None:
        if colon:
            raise ConfigurationError("measure", diagnose("metric-of-no-file", name=metric.name))
        return metric
    if not file:
        raise ConfigurationError("measure", diagnose("metric-of-a-file", name=metric.name))
    function, content = metric.of_file(file)
    return replace(metric, function=function, file=file, content=content)


def resolve_metric_file(folder: Path, given: object) -> object:
    """Returns a metric of a study's file, with the file that it is of sought beside that."""
    name, _, file = given.partition(":") if isinstance(given, str) else ("", "", "")
    named = METRICS.get(name)
    return f"{name}:{folder / file}" if file and named and named.of_file else given


@dataclass(frozen=True)
class UserFunction:
    """A function of (robot, stand) as one of a design."""

    function: MetricFunction

    def __call__(self, design: Design) -> Any:
        """Calls it."""
        return self.function(design.robot, design.stand)

    @property
    def place(self) -> str:
        """Returns ``module:function``."""
        return f"{self.function.__module__}:{getattr(self.function, '__qualname__', '')}"

    def fingerprint(self) -> str:
        """Returns its name and a hash of its text, which tells that it has changed."""
        try:
            text = inspect.getsource(self.function)
        except (OSError, TypeError):
            text = ""
        return f"{self.place} {hashlib.sha256(text.encode()).hexdigest()[:16]}"


def format_metric(metric: Metric) -> str:
    """Returns how a study's file says a metric."""
    own = metric.function
    named = f"{metric.name}:{metric.file}" if metric.file else metric.name
    return own.place if isinstance(own, UserFunction) else named


def fingerprint_metric(metric: Metric) -> str:
    """Returns what tells that a metric is another one."""
    own = metric.function
    named = f"{metric.name} {metric.content}".rstrip()
    return own.fingerprint() if isinstance(own, UserFunction) else named
