"""Metrics of a study: named metrics of a design, and functions of (robot, stand).

A metric is a function of a `Design` (robot with a solved stand) that returns a number or {name:
number}, in SI units. Modules ``metrics`` of other tools define further metrics, such as the payload
limit.
"""

from __future__ import annotations

import difflib
import hashlib
import importlib
import inspect
import pickle
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError, NotStandingError, PupperAnalysisError
from pupper_analysis.base.tools import find_tool_modules
from pupper_analysis.base.units import EFFORT_UNIT, STIFFNESS_UNIT
from pupper_analysis.models.motors.motor import Motor
from pupper_analysis.prepare.judge import judge_stand
from pupper_analysis.prepare.own_run import own_run
from pupper_analysis.present.verdict import make_keyframe_run_clauses
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import resolve_servo_gains
from pupper_analysis.robot.stability import Stability, has_converged_solver
from pupper_analysis.robot.tool import FramePoint
from pupper_analysis.simulation.causes import describe_growth
from pupper_analysis.simulation.monitor import StandReference, has_diverged
from pupper_analysis.simulation.rollout import make_stand_start, roll_out
from pupper_analysis.simulation.stability import rest_stability
from pupper_analysis.simulation.verdict import Verdict
from pupper_analysis.stance.sag.steady_state import SteadyState, steady_state
from pupper_analysis.stance.sag.stiffness import minimum_stiffness
from pupper_analysis.stance.soft_ground import solve_stand_as_simulated
from pupper_analysis.stance.stand import Stand, stand_statics
from pupper_analysis.stance.workspace import BaseWorkspace, base_workspace
from pupper_analysis.statics.equilibrium import GravityCompensation, compute_utilisation

T = TypeVar("T")
"""Type of the result of a function that `Design.compute_once` calls."""

MetricValue = float | bool
"""Value of a metric: a number, or True if a condition holds."""
MetricFunction = Callable[[Robot, Stand], Any]
"""Function of the user: (robot, stand) to a value, or to a mapping of values."""


@dataclass(eq=False)
class Design:
    """Robot of a study with a solved stand, the argument of each metric.

    Quantities that several metrics need are computed on first use.

    Attributes:
        robot: Robot with payload and servo gains.
        stand: Solved stand.
        own_servos: True if the design has no gain variable and no motor variable. The metric
            ``stands`` then also evaluates the simulation of the published file.
        point: Position at which a payload is attached: (x, y, z) [m] in the base frame, or (frame,
            x, y, z).
        motors: {joint: motor} of the motor variables of the study; empty without motor variables.
    """

    robot: Robot
    stand: Stand
    own_servos: bool = True
    point: FramePoint = (0.0, 0.0, 0.0)
    motors: Mapping[str, Motor] = field(default_factory=dict)
    _results: dict[Any, Any] = field(default_factory=dict, repr=False)

    def compute_once(self, function: Callable[[Design], T]) -> T:
        """Return ``function(self)``, evaluated at the first call and then cached.

        Metrics of other tools can share a result in this way. ``function`` is the key of the cache.
        """
        if function not in self._results:
            self._results[function] = function(self)
        found: T = self._results[function]
        return found

    @cached_property
    def gains(self) -> dict[str, Any]:
        """Servo gains of this design, as keyword arguments ``kp`` and ``kd``.

        Each array has the shape (nu,): ``kp`` [N m/rad, N/m], ``kd`` [N m s/rad, N s/m]. Empty if
        `own_servos` is True.
        """
        if self.own_servos:
            return {}
        gains = resolve_servo_gains(self.robot)
        return {"kp": gains.kp, "kd": gains.kd}

    @cached_property
    def statics(self) -> GravityCompensation:
        """Motor torques and contact forces in `simulated_stand`, as in the command ``stand``.

        The contact forces have minimum tangential components.
        """
        return stand_statics(self.robot, self.simulated_stand)

    @cached_property
    def _equilibrium_or_error(self) -> SteadyState | PupperAnalysisError:
        """Steady state without feed-forward, as in the command ``stand``, or the error.

        The error is stored, so that a failed computation is not repeated.
        """
        try:
            return steady_state(self.robot, self.simulated_stand)
        except PupperAnalysisError as error:
            return error

    @property
    def equilibrium(self) -> SteadyState:
        """Predicted equilibrium of the servo-driven robot without feed-forward, stable or not.

        Raises:
            PupperAnalysisError: If `steady_state` fails, for example without an equilibrium.
        """
        if isinstance(self._equilibrium_or_error, PupperAnalysisError):
            raise self._equilibrium_or_error
        return self._equilibrium_or_error

    @property
    def standing_equilibrium(self) -> SteadyState:
        """Predicted equilibrium without feed-forward in which the servo-driven robot stays up.

        Raises:
            NotStandingError: If the robot does not stay up (``failures`` of the equilibrium).
            PupperAnalysisError: If `steady_state` fails, for example without an equilibrium.
        """
        if self.equilibrium.failures:
            raise NotStandingError(self.equilibrium.failures)
        return self.equilibrium

    @cached_property
    def stability(self) -> Stability:
        """Stability of `standing_equilibrium`, from the eigenvalues of a simulation step.

        Raises:
            NotStandingError: If the robot does not stay up.
            PupperAnalysisError: If `steady_state` fails, for example without an equilibrium.
        """
        return rest_stability(self.robot, self.simulated_stand, self.standing_equilibrium)

    @cached_property
    def workspace(self) -> BaseWorkspace:
        """Reachable range of the base in height, roll, pitch, yaw, x and y, from the stance."""
        return base_workspace(self.robot, self.stand.task)

    @cached_property
    def simulated_stand(self) -> Stand:
        """Stand on MuJoCo's soft ground, the initial state of simulations.

        The stand is on rigid ground if the soft-ground stand is out of reach, or if the depths of
        soft loops do not converge. ``solve_stand_as_simulated`` documents the errors.
        """
        return solve_stand_as_simulated(self.robot, self.stand)

    @cached_property
    def verdict(self) -> Verdict:
        """Verdict on the design's stand (`judge_stand`)."""
        return judge_stand(self.robot, self.stand, **self.gains)

    def map_to_joints(self, values: Iterable[float]) -> dict[str, float]:
        """Assign values in actuator order to the joint names: {joint: value}."""
        pairs = zip(self.robot.joint_names, values, strict=True)
        return {name: float(value) for name, value in pairs}

    def compute_base_range(self, direction: str) -> float:
        """Return the length of the reachable range of the base in a direction [m or rad].

        Args:
            direction: ``height``, ``roll``, ``pitch``, ``yaw``, ``x`` or ``y``.
        """
        interval = self.workspace.intervals[direction]
        return interval.high - interval.low

    def utilisation_at_rest(self) -> float:
        """Return the largest ratio |motor torque| / effort limit at `standing_equilibrium` [1].

        NaN if the ratio of a joint is unknown.
        """
        return _find_peak(compute_utilisation(self.robot, self.standing_equilibrium.joint_torques))


@dataclass(frozen=True)
class Metric:
    """Quantity that a study measures for each design: a named function with a unit.

    Attributes:
        name: Column of the table. If the function returns a mapping, the columns are ``NAME.KEY``.
        function: Function of a design. If the metric needs a file, `of_file` creates this function.
        unit: Unit; ``1`` for a ratio, empty for a function of the user.
        simulates: True if the metric needs a simulation, or some seconds.
        fallen: Value of the metric for a design that cannot stand; None if this value is unknown.
        of_file: Function that creates ``function`` for a file; None if the metric needs no file.
            The argument is the text after the colon, for example the path of a policy. The results
            are the function of a design, and a hash of the file content.
        file: Text after the colon in ``NAME:FILE``.
        content: Hash that `of_file` returned.
        is_truth: Whether the metric is a truth value; stored as 1 or 0.
    """

    name: str
    function: Callable[[Design], MetricValue | Mapping[str, MetricValue]]
    unit: str
    simulates: bool = False
    fallen: float | None = None
    of_file: Callable[[str], tuple[Callable[[Design], MetricValue], str]] | None = None
    file: str = ""
    content: str = ""
    is_truth: bool = False


def text_key(metric: str) -> str:
    """Return the catalogue key of the text that explains a metric; the entry may be missing."""
    return f"metric-{metric.replace('_', '-')}"


def _check_stand(design: Design) -> bool:
    """Return True if the robot stays up without feed-forward, else raise an error.

    No deviation may grow within 12 s. If simulations refuted a growing mode, or the modes are not
    modes of the file's solver (`has_converged_solver`), the verdict must pass. If
    `Design.own_servos` is True, the simulation of the unmodified MJCF from the keyframe must not
    fail either.
    """
    published_run = own_run(design.robot) if design.own_servos else None
    if published_run is not None and published_run.fails:
        raise NotStandingError(
            tuple(
                clause.message
                for clause in make_keyframe_run_clauses(published_run)
                if not clause.good
            )
        )
    growing = design.stability.modes_growing_within()
    if growing:
        raise NotStandingError((describe_growth(growing[0]),))
    is_uncertain = bool(design.stability.refuted_modes) or not has_converged_solver(
        design.robot.mj_model
    )
    if is_uncertain and not design.verdict.passed:
        raise NotStandingError(tuple(design.verdict.failures))
    return True


SET_DOWN_HEIGHT = 0.002
"""Height [m] by which the metric ``set_down`` raises the standing robot before the simulation: a
disturbance that a stand must survive. Chosen, not tuned."""

SET_DOWN_DURATION = 5.0
"""Duration of the simulation of ``set_down`` [s]. Chosen, not tuned."""


def survives_set_down(design: Design) -> bool:
    """Return True if the robot stands after a drop from the height `SET_DOWN_HEIGHT`.

    The servos hold the positions of the stand, without feed-forward, for `SET_DOWN_DURATION`. The
    robot must not fall (`StandReference.has_fallen`), or be collapsed at the end
    (`StandReference.has_collapsed`).

    Raises:
        NotStandingError: If the robot does not stay up in the predicted equilibrium.
        PupperAnalysisError: If `steady_state` fails, for example without an equilibrium.
    """
    assert design.standing_equilibrium is not None  # raises, if the robot does not stay up
    held = make_stand_start(design.robot, design.simulated_stand, feedforward=False, **design.gains)
    model, robot = held.drive.model, held.robot
    start = held.start.copy()
    start[1 + robot.mj_convention.qpos_index[2]] += SET_DOWN_HEIGHT
    steps = round(SET_DOWN_DURATION / model.opt.timestep)
    controls = np.tile(held.ctrl, (1, steps, 1))
    states = roll_out(model, mujoco.MjData(model), start, controls)[0]
    if has_diverged(states, float(model.opt.timestep)):
        return False
    reference = StandReference.from_configuration(robot, held.stand.qpos)
    checked = states[:: max(1, steps // _NUM_SET_DOWN_CHECKS)]
    falls = any(reference.has_fallen(state) for state in checked)
    return not falls and not reference.has_collapsed(states[-1])


_NUM_SET_DOWN_CHECKS = 50
"""Smallest number of simulated states that `survives_set_down` checks for a fall, if there are so
many. Chosen, not tuned.
"""


def _find_peak(values: NDArray[np.float64]) -> float:
    """Return the largest magnitude in an array that is not empty; NaN if an element is NaN."""
    return float(np.abs(values).max())


def _max_friction_utilisation(design: Design) -> float:
    """Return the largest ratio tangential force / (friction coefficient x normal force) of feet."""
    return max(design.statics.friction_utilisation.values())


def _compute_minimum_stiffness(design: Design) -> float:
    """Return the smallest uniform kp [N m/rad, N/m] that holds the robot without feed-forward."""
    return minimum_stiffness(design.robot, design.stand)


_METRICS_OF_DESIGNS = (
    Metric("total_mass", lambda d: d.robot.total_mass, "kg"),
    Metric("peak_utilisation", lambda d: _find_peak(d.statics.motor_utilisation), "1"),
    Metric("peak_torque", lambda d: _find_peak(d.statics.joint_torques), EFFORT_UNIT),
    Metric("torque", lambda d: d.map_to_joints(d.statics.joint_torques), EFFORT_UNIT),
    Metric("utilisation", lambda d: d.map_to_joints(d.statics.motor_utilisation), "1"),
    Metric("friction_utilisation", _max_friction_utilisation, "1"),
    Metric("com_margin", lambda d: d.stand.com_margin, "m"),
    Metric("base_height", lambda d: d.standing_equilibrium.base_height, "m"),
    Metric("sag", lambda d: d.standing_equilibrium.height_loss, "m"),
    Metric("servo_sag", lambda d: d.standing_equilibrium.servo_sag, "m"),
    Metric("stiffness", lambda d: d.equilibrium.stiffness, "rad^2/s^2"),
    Metric("rest_utilisation", lambda d: d.utilisation_at_rest(), "1"),
    Metric("stands", _check_stand, "1", fallen=0.0, is_truth=True),
    Metric("set_down", survives_set_down, "1", simulates=True, fallen=0.0, is_truth=True),
    Metric("minimum_stiffness", _compute_minimum_stiffness, STIFFNESS_UNIT, simulates=True),
    Metric("height_range", lambda d: d.compute_base_range("height"), "m", simulates=True),
    Metric("roll_range", lambda d: d.compute_base_range("roll"), "rad", simulates=True),
    Metric("pitch_range", lambda d: d.compute_base_range("pitch"), "rad", simulates=True),
    Metric("verified", lambda d: d.verdict.passed, "1", simulates=True, fallen=0.0, is_truth=True),
)
"""Metrics that are defined in this module; other tools define further metrics."""


def _load_tool_metrics() -> Iterator[Metric]:
    """Yield the metrics of other tools: ``METRICS`` of each tool's module ``metrics``."""
    for package in find_tool_modules("metrics").values():
        metrics_of_tool = importlib.import_module(f"{package}.metrics").METRICS
        yield from (Metric(name, **arguments) for name, arguments in metrics_of_tool.items())


METRICS_REVISION = 7
"""Revision of the meanings of the metrics, a part of `Study.digest`. Increased if a meaning
changes, so that results of earlier revisions are not reused."""

METRICS: Mapping[str, Metric] = {
    metric.name: metric for metric in (*_METRICS_OF_DESIGNS, *_load_tool_metrics())
}
"""Named metrics: {name: metric}."""


def make_metric(requested: str | MetricFunction) -> Metric:
    """Return the metric that a study requests by name or as a function of (robot, stand).

    Args:
        requested: Name of `METRICS`, followed by ``:FILE`` if the metric needs a file; or a
            function. Other processes import the function, so that the top level of a module must
            define the function.

    Raises:
        ConfigurationError: If the name is unknown, or the function cannot be pickled, for example.
        ModelError: If the file cannot be used.
    """
    if isinstance(requested, str):
        if (metric := METRICS.get(requested.partition(":")[0])) is not None:
            return _bind_file(metric, requested)
        alike = difflib.get_close_matches(requested, METRICS)
        finding = diagnose("metric-unknown", name=requested, alike=alike, known=METRICS)
        raise ConfigurationError("measure", finding)
    if not callable(requested):
        raise ConfigurationError("measure", diagnose("metric-no-function", given=repr(requested)))
    try:
        inspect.signature(requested).bind(None, None)
    except (TypeError, ValueError) as error:
        problem = diagnose("metric-of-another-signature", given=repr(requested), problem=str(error))
        raise ConfigurationError("measure", problem) from error
    try:
        pickle.dumps(requested)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        problem = diagnose("metric-not-picklable", given=repr(requested))
        raise ConfigurationError("measure", problem) from error
    name = getattr(requested, "__name__", type(requested).__name__)
    if name in METRICS:
        problem = diagnose("metric-name-taken", name=name)
        raise ConfigurationError("measure", problem)
    return Metric(name, UserFunction(requested), "")


def _bind_file(metric: Metric, requested: str) -> Metric:
    """Return a metric that uses the file in ``requested``, ``NAME`` or ``NAME:FILE``."""
    _, colon, file = requested.partition(":")
    if metric.of_file is None:
        if colon:
            raise ConfigurationError("measure", diagnose("metric-of-no-file", name=metric.name))
        return metric
    if not file:
        raise ConfigurationError("measure", diagnose("metric-of-a-file", name=metric.name))
    function, content = metric.of_file(file)
    return replace(metric, function=function, file=file, content=content)


def resolve_metric_file(folder: Path, requested: object) -> object:
    """Prepend a folder to the relative file of a requested metric ``METRIC:FILE``.

    Args:
        folder: Folder to which the path is relative.
        requested: Metric as requested in a study file; returned unchanged if it names no file.
    """
    name, _, file = requested.partition(":") if isinstance(requested, str) else ("", "", "")
    metric = METRICS.get(name)
    return f"{name}:{folder / file}" if file and metric and metric.of_file else requested


@dataclass(frozen=True)
class UserFunction:
    """Adapter from a user's function of (robot, stand) to a function of a design.

    Attributes:
        function: Function of (robot, stand).
    """

    function: MetricFunction

    def __call__(self, design: Design) -> Any:
        """Evaluate the function for a design."""
        return self.function(design.robot, design.stand)

    @property
    def import_path(self) -> str:
        """Import path of the user's function, as ``module:function``."""
        return f"{self.function.__module__}:{getattr(self.function, '__qualname__', '')}"

    def fingerprint(self) -> str:
        """Return a text that identifies the user's function: import path and hash of the source.

        The fingerprint changes with the source text, so that old results are not reused. If no
        source text is available, for example for a built-in function, the hash is constant.
        """
        try:
            text = inspect.getsource(self.function)
        except (OSError, TypeError):
            text = ""
        return f"{self.import_path} {hashlib.sha256(text.encode()).hexdigest()[:16]}"


def format_metric(metric: Metric) -> str:
    """Format a metric as the text that requests the metric in a study file.

    The text is ``NAME``, ``NAME:FILE``, or ``module:function`` for a function of the user.
    """
    function = metric.function
    metric_name = f"{metric.name}:{metric.file}" if metric.file else metric.name
    return function.import_path if isinstance(function, UserFunction) else metric_name


def fingerprint_metric(metric: Metric) -> str:
    """Return a text that identifies a metric in the hash of a study.

    The text depends on the source of a user's function, and on the content of a file that the
    metric uses. If the meaning of a named metric changes, `METRICS_REVISION` is increased instead.
    """
    function = metric.function
    metric_name = f"{metric.name} {metric.content}".rstrip()
    return function.fingerprint() if isinstance(function, UserFunction) else metric_name
