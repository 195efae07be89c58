"""Intervals of robot parameters within which a policy tracks the command.

`tracked_intervals` changes each quantity alone, from the nominal value to the ends of a range. The
range between a tracked and an untracked value is bisected. The output is, for each quantity and
seed, the range of values with which the policy tracks the command.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import mujoco
import numpy as np
import orjson
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import ConfigurationError, InputError, ModelError
from pupper_analysis.base.inputs import MAX_TEXT_BYTES, read_input
from pupper_analysis.base.results import Result
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.walk.gait import (
    Tracking,
    check_command,
    check_runs,
    evaluate_tracking,
    has_unknown_masses,
    list_walk_remarks,
)
from pupper_analysis.tools.walk.policy import Policy
from pupper_analysis.tools.walk.runs import Case, Stage, prepare_stage, simulate_cases

DEFAULT_SECONDS, WARM_UP_SECONDS = 5.0, 1.5
"""Duration of a run [s], and of the warm-up [s], which is not evaluated. Chosen, not tuned."""

DEFAULT_SEEDS = 5
"""Number of initial states per value. Chosen, not tuned."""

NUM_HALVINGS = 5
"""Number of bisections between a value with which the policy follows the velocity command, and a
value with which it does not. Derived: five bisections locate the end of the interval to 1/32 of the
distance from the nominal value to the bound of the range (in the logarithm for a factor).
"""

QuantitySetter = Callable[[Stage, mujoco.MjModel, float], None]
"""Function (stage, model, value) that sets a varied quantity in a copy of the MuJoCo model."""


@dataclass(frozen=True)
class VariedQuantity:
    """Parameter of the robot or of the simulation that a search for intervals varies.

    Attributes:
        unit: Unit; ``x`` for a factor.
        nominal: Value of the unchanged robot.
        range: Smallest and largest simulated value. Chosen, not tuned.
        apply: Function that changes a copy of the model; None for a delay or a push.
    """

    unit: str
    nominal: float
    range: tuple[float, float]
    apply: QuantitySetter | None

    def compute_midpoint(self, first: float, second: float) -> float:
        """Return the midpoint of two values: geometric mean for a factor, else arithmetic mean."""
        return math.sqrt(first * second) if self.unit == "x" else (first + second) / 2


def _get_base_id(stage: Stage, model: mujoco.MjModel) -> int:
    """Return the body id of the robot's base in a MuJoCo model."""
    return int(model.body(stage.robot.mj_base).id)


def _scale_base_mass(stage: Stage, model: mujoco.MjModel, value: float) -> None:
    """Multiply mass and inertia of the base body by ``value``, in ``model``; the CoM is kept."""
    model.body_mass[_get_base_id(stage, model)] *= value
    model.body_inertia[_get_base_id(stage, model)] *= value


def _add_payload(stage: Stage, model: mujoco.MjModel, value: float) -> None:
    """Add a point mass at the CoM of the base: ``value`` times the mass of the robot."""
    model.body_mass[_get_base_id(stage, model)] += value * stage.robot.total_mass


def _shift_base_com(stage: Stage, model: mujoco.MjModel, value: float) -> None:
    """Shift the CoM of the base body forward by ``value`` [m], in ``model``."""
    model.body_ipos[_get_base_id(stage, model), 0] += value


def _scale_friction(_: Stage, model: mujoco.MjModel, value: float) -> None:
    """Multiply the sliding friction of all geoms and pairs by ``value``, in ``model``."""
    model.geom_friction[:, 0] *= value
    model.pair_friction[:, :2] *= value


def _find_motors(stage: Stage) -> NDArray[np.int64]:
    """Return the MuJoCo ids of the robot's actuators, without joints that have no actuator."""
    motors = stage.robot.mj_convention.actuator_index
    return motors[motors >= 0]


def _scale_kp(stage: Stage, model: mujoco.MjModel, value: float) -> None:
    """Multiply the stiffness of all servos of ``stage.robot`` by ``value``, in ``model``."""
    model.actuator_gainprm[_find_motors(stage), 0] *= value
    model.actuator_biasprm[_find_motors(stage), 1] *= value


def _scale_kd(stage: Stage, model: mujoco.MjModel, value: float) -> None:
    """Multiply the damping of all servos of ``stage.robot`` by ``value``, in ``model``."""
    model.actuator_biasprm[_find_motors(stage), 2] *= value


def _scale_strength(stage: Stage, model: mujoco.MjModel, value: float) -> None:
    """Multiply the force range of all actuators of the robot by ``value``, in ``model``."""
    model.actuator_forcerange[_find_motors(stage)] *= value


def _scale_legs(stage: Stage, model: mujoco.MjModel, value: float) -> None:
    """Multiply the lengths of the legs beyond their first body by ``value``, in ``model``.

    Sizes and masses are unchanged.
    """
    base, bodies_beyond = _get_base_id(stage, model), set()
    for body, _ in stage.robot.contact_places.values():
        chain = []
        while body not in (0, base):
            chain.append(body)
            body = int(model.body_parentid[body])
        bodies_beyond |= set(chain[:-1])
    leg_bodies = sorted(bodies_beyond)
    model.body_pos[leg_bodies] *= value
    model.body_ipos[leg_bodies] *= value
    model.geom_pos[np.isin(model.geom_bodyid, leg_bodies)] *= value
    model.site_pos[np.isin(model.site_bodyid, leg_bodies)] *= value


VARIED_QUANTITIES: Mapping[str, VariedQuantity] = {
    "mass": VariedQuantity("x", 1.0, (0.25, 4.0), _scale_base_mass),
    "com": VariedQuantity("m", 0.0, (-0.1, 0.1), _shift_base_com),
    "friction": VariedQuantity("x", 1.0, (0.05, 4.0), _scale_friction),
    "kp": VariedQuantity("x", 1.0, (0.1, 8.0), _scale_kp),
    "kd": VariedQuantity("x", 1.0, (0.05, 8.0), _scale_kd),
    "delay": VariedQuantity("s", 0.0, (0.0, 0.2), None),
    "strength": VariedQuantity("x", 1.0, (0.05, 4.0), _scale_strength),
    "legs": VariedQuantity("x", 1.0, (0.5, 2.0), _scale_legs),
    "payload": VariedQuantity("1", 0.0, (0.0, 2.0), _add_payload),
    "push-forward": VariedQuantity("m/s", 0.0, (-3.0, 3.0), None),
    "push-left": VariedQuantity("m/s", 0.0, (-3.0, 3.0), None),
}
"""{name: varied quantity}. ``mass`` and ``com`` (forward) belong to the base body. ``friction`` is
the sliding friction of all contacts. ``delay`` is added to the latency of the policy. ``legs`` is a
factor on the lengths beyond the first body of each limb with a foot, at constant mass. ``payload``
is a fraction of the robot's mass, at the CoM of the base. A push lasts for a single action; the
value is impulse / mass of the robot.
"""

_PUSH_DIRECTIONS = {"push-forward": (1.0, 0.0), "push-left": (0.0, 1.0)}
"""{name of a push: unit vector (x, y) in the world frame}."""


@dataclass(frozen=True, eq=False)
class TrackedInterval(Result):
    """Interval of a varied quantity within which a policy tracks the command, for each seed.

    Attributes:
        quantity: A key of `VARIED_QUANTITIES`.
        unit: Unit; ``x`` for a factor.
        nominal: Value of the unchanged robot.
        least: Smallest tracked value found, shape (seeds,).
        most: Largest tracked value found, shape (seeds,).
        below: Largest untracked value found below ``least``, shape (seeds,). NaN if the policy
            tracks at the lower bound of the range, or if this bound is the nominal value.
        above: Smallest untracked value found above ``most``, shape (seeds,). NaN if the policy
            tracks at the upper bound of the range, or if this bound is the nominal value.
        ended_below: Criterion that is violated at ``below``, for each seed: ``falls``, ``speed`` or
            ``turning``; empty if ``below`` is NaN.
        ended_above: Criterion that is violated at ``above``, for each seed: ``falls``, ``speed`` or
            ``turning``; empty if ``above`` is NaN.
        upright_least: Smallest value found without a fall, shape (seeds,).
        upright_most: Largest value found without a fall, shape (seeds,).
        measured: 95 % interval of the real robot's value, from a fit; None if unknown.
    """

    quantity: str
    unit: str
    nominal: float = field(metadata={"unit": "varies"})
    least: Array = field(metadata={"unit": "varies"})
    most: Array = field(metadata={"unit": "varies"})
    below: Array = field(metadata={"unit": "varies"})
    above: Array = field(metadata={"unit": "varies"})
    ended_below: tuple[str, ...]
    ended_above: tuple[str, ...]
    upright_least: Array = field(metadata={"unit": "varies"})
    upright_most: Array = field(metadata={"unit": "varies"})
    measured: tuple[float, float] | None = field(default=None, metadata={"unit": "varies"})
    _reported: ClassVar[tuple[str, ...]] = ("common", "upright", "inside")

    @property
    def common(self) -> tuple[float, float]:
        """Interval in which the policy tracks the command with all seeds: (lower, upper) end."""
        return float(self.least.max()), float(self.most.min())

    @property
    def upright(self) -> tuple[float, float]:
        """Interval in which the robot falls with no seed: (lower, upper) end."""
        return float(self.upright_least.max()), float(self.upright_most.min())

    @property
    def inside(self) -> bool | None:
        """Whether all seeds track the command in the complete measured interval.

        None without a measured interval.
        """
        if self.measured is None:
            return None
        low, high = self.common
        return low <= self.measured[0] and self.measured[1] <= high


@dataclass(frozen=True, eq=False)
class TrackedIntervals(Result):
    """Intervals of all varied quantities within which a policy tracks the command.

    Attributes:
        name: Name of the robot.
        mass: Mass of the robot.
        policy: File name of the policy.
        command: Commanded forward speed, speed to the left (m/s) and turning rate to the left
            (rad/s), shape (3,).
        requested_seeds: Number of requested seeds.
        seeds: Seeds with which the unchanged robot tracks the command. Intervals are searched with
            these seeds only.
        speed_margins: 1 - speed error / tolerance of the unchanged robot for each requested seed,
            shape (requested_seeds,).
        turning_margins: 1 - error of the turning rate / tolerance, shape (requested_seeds,).
        intervals: An interval per quantity, with all other quantities unchanged. Empty if `seeds`
            is empty.
        rollouts: Number of simulated runs.
        seconds: Duration of each run.
        remarks: Errors and assumptions of the robot's files and the deployment behind the result.
    """

    _key_fields: ClassVar[tuple[str, ...]] = ("passed", "narrow")

    name: str
    mass: float = field(metadata={"unit": "kg"})
    policy: str
    command: Array = field(metadata={"unit": "m/s or rad/s"})
    requested_seeds: int
    seeds: tuple[int, ...]
    speed_margins: Array = field(metadata={"unit": "1"})
    turning_margins: Array = field(metadata={"unit": "1"})
    intervals: tuple[TrackedInterval, ...]
    rollouts: int
    seconds: float = field(metadata={"unit": "s"})
    remarks: tuple[Diagnostic, ...]
    _reported: ClassVar[tuple[str, ...]] = ("passed", "narrow")

    @property
    def narrow(self) -> tuple[str, ...]:
        """Criteria (``speed``, ``turning``) with a margin smaller than the spread over the seeds.

        The margin is the smallest margin of the unchanged robot over ``seeds``; the spread is the
        largest minus the smallest margin. Another initial state may violate a criterion with a
        narrow margin.
        """
        margins = {"speed": self.speed_margins, "turning": self.turning_margins}
        return tuple(
            name
            for name, values in margins.items()
            if len(self.seeds) > 1
            and 0 <= float(values[list(self.seeds)].min()) < float(np.ptp(values[list(self.seeds)]))
        )

    @property
    def passed(self) -> bool:
        """Whether the policy tracks the command on the robot, and within all measured intervals.

        The unchanged robot must track the command with all seeds. The measured interval of each
        quantity in ``intervals``, if any, must be within the interval that all seeds track. No link
        mass may be unknown.
        """
        tracked = len(self.seeds) == self.requested_seeds
        inside = all(interval.inside is not False for interval in self.intervals)
        return tracked and inside and not has_unknown_masses(self.remarks)


def make_changed_case(stage: Stage, name: str, value: float, command: Array, seed: int) -> Case:
    """Create the case (model, command, seed) of a simulated run with a changed quantity.

    Args:
        stage: Robot, policy and model of the simulation.
        name: Key of `VARIED_QUANTITIES`, such as ``"mass"`` or ``"push-left"``.
        value: Value in the unit of the quantity (`VARIED_QUANTITIES`). For a push, this is the
            velocity change of the robot [m/s].
        command: Command, shape (3,) [m/s, m/s, rad/s].
        seed: Seed of the case.
    """
    quantity, latency = VARIED_QUANTITIES[name], stage.policy.contract.latency
    if name in _PUSH_DIRECTIONS:
        impulse = value * stage.robot.total_mass
        push = (impulse * _PUSH_DIRECTIONS[name][0], impulse * _PUSH_DIRECTIONS[name][1])
        return Case(stage.model, command, latency, seed, push=push)
    if quantity.apply is None:
        return Case(stage.model, command, latency + value, seed)
    model = copy.copy(stage.model)
    quantity.apply(stage, model, value)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    lift = (
        _find_lowest_foot_height(stage, stage.model) - _find_lowest_foot_height(stage, model)
        if name == "legs"
        else 0.0
    )
    return Case(model, command, latency, seed, lift)


def _find_lowest_foot_height(stage: Stage, model: mujoco.MjModel) -> float:
    """Return the height of the lowest foot geom's centre in the default pose [m]."""
    data = mujoco.MjData(model)
    stage.robot.mj_convention.set_state(data, stage.default)
    mujoco.mj_kinematics(model, data)
    return float(data.geom_xpos[list(stage.robot.foot_geoms), 2].min())


def _check_quantities(
    quantities: tuple[str, ...], measured: Mapping[str, tuple[float, float]] | None
) -> None:
    """Raise a ConfigurationError if a quantity is unknown, or measured intervals are not valid."""
    for name in quantities:
        if name not in VARIED_QUANTITIES:
            problem = diagnose("none-of", value=name, known=tuple(VARIED_QUANTITIES))
            raise ConfigurationError("vary", problem)
    if measured is not None and not any(name in measured for name in quantities):
        problem = diagnose("fit-of-other-quantities", measured=tuple(measured))
        raise ConfigurationError("vary", problem)
    for name, (low, high) in (measured or {}).items():
        if low > high:
            problem = diagnose("interval-ends", name=name, low=low, high=high)
            raise ConfigurationError("measured", problem)


_CRITERIA: Mapping[str, Callable[[Tracking], bool]] = {
    "tracks": lambda outcome: outcome.tracks,
    "upright": lambda outcome: outcome.failure != "falls",
}
"""{criterion of an interval: function that evaluates the outcome of a run}."""

_Trial = tuple[str, float, int]
"""Name of a quantity, value of the quantity, and seed of a simulation."""

_BracketKey = tuple[str, int, int, str]
"""Quantity, side (0: below, 1: above the nominal value), seed and criterion of a bracket."""


def _make_interval(
    name: str,
    seeds: tuple[int, ...],
    brackets: Mapping[_BracketKey, list[float]],
    outcomes: Mapping[_Trial, Tracking],
    measured: tuple[float, float] | None,
) -> TrackedInterval:
    """Create the result of a quantity from the brackets and outcomes of all seeds.

    ``brackets`` contain a satisfied and a violated value, between which an end is located.
    """

    def collect(side: int, criterion: str, end: int) -> Array:
        """Return the bracketing values of an interval's end for all seeds, shape (seeds,).

        Args:
            side: Side of the interval.
            criterion: Criterion that ends the interval, a key of `_CRITERIA`.
            end: 0 for the values that satisfy the criterion, 1 for the values that violate it (NaN
                if there is none).
        """
        return np.array([brackets[name, side, seed, criterion][end] for seed in seeds])

    def find_failures(side: int) -> tuple[str, ...]:
        """Return the failure of each seed at the violated value; empty without a failure."""
        values = {seed: brackets[name, side, seed, "tracks"][1] for seed in seeds}
        return tuple(
            "" if math.isnan(value) else outcomes[name, value, seed].failure
            for seed, value in values.items()
        )

    quantity = VARIED_QUANTITIES[name]
    return TrackedInterval(
        name,
        quantity.unit,
        quantity.nominal,
        least=collect(0, "tracks", 0),
        most=collect(1, "tracks", 0),
        below=collect(0, "tracks", 1),
        above=collect(1, "tracks", 1),
        ended_below=find_failures(0),
        ended_above=find_failures(1),
        upright_least=collect(0, "upright", 0),
        upright_most=collect(1, "upright", 0),
        measured=measured,
    )


def _make_brackets(names: Iterable[str], seeds: Iterable[int]) -> dict[_BracketKey, list[float]]:
    """Return the initial bracket [satisfied, violated] of each quantity, side, seed and criterion.

    The values are the nominal value and the bound of the range; NaN instead of an equal bound.
    """
    brackets: dict[_BracketKey, list[float]] = {}
    for name in names:
        quantity = VARIED_QUANTITIES[name]
        for side, bound in enumerate(quantity.range):
            for seed in seeds:
                violated = math.nan if bound == quantity.nominal else bound
                for criterion in _CRITERIA:
                    brackets[name, side, seed, criterion] = [quantity.nominal, violated]
    return brackets


def _bisect_brackets(
    brackets: dict[_BracketKey, list[float]],
    outcomes: Mapping[_Trial, Tracking],
    simulate: Callable[[list[_Trial]], None],
) -> None:
    """Simulate the bounds of the ranges, then bisect the brackets, in place.

    If the bound of a range satisfies the criterion, the bracket is [bound, NaN]. The other brackets
    are halved `NUM_HALVINGS` times. ``simulate`` adds the outcomes of trials to ``outcomes``.
    """
    for halving in range(1 + NUM_HALVINGS):
        values = _select_trial_values(brackets, halve=halving > 0)
        simulate([(name, value, seed) for (name, _, seed, _), value in values.items()])
        for key, value in values.items():
            satisfied = _CRITERIA[key[3]](outcomes[key[0], value, key[2]])
            if halving:
                brackets[key][0 if satisfied else 1] = value
            elif satisfied:
                brackets[key] = [value, math.nan]


def _select_trial_values(
    brackets: Mapping[_BracketKey, list[float]], *, halve: bool
) -> dict[_BracketKey, float]:
    """Return, for each unfinished bracket, the value of the quantity to simulate next.

    The value is the midpoint of the bracket if ``halve``, else its violated end.
    """
    return {
        key: VARIED_QUANTITIES[key[0]].compute_midpoint(satisfied, violated) if halve else violated
        for key, (satisfied, violated) in brackets.items()
        if not math.isnan(violated)
    }


@check_arguments
def tracked_intervals(
    robot: Robot,
    policy: Policy,
    command: ArrayLike = (0.5, 0.0, 0.0),
    *,
    seeds: int = DEFAULT_SEEDS,
    quantities: tuple[str, ...] = tuple(VARIED_QUANTITIES),
    seconds: float = DEFAULT_SECONDS,
    measured: Mapping[str, tuple[float, float]] | None = None,
    workers: int | None = None,
) -> TrackedIntervals:
    """Find the interval of each quantity within which a policy tracks the command.

    A simulation tracks the command if the robot does not fall, and if the errors of the mean
    velocity and turning rate are within the tolerances (`evaluate_tracking`). Each quantity is
    changed alone, for each seed that tracks without changes: in both directions, but delay and
    payload upwards only. At first the bound of the quantity's range is simulated. If the command is
    not tracked at the bound, the range between a tracked and an untracked value is bisected
    `NUM_HALVINGS` times. The range between a value without and a value with a fall is bisected in
    the same way.

    Args:
        robot: Robot.
        policy: Policy.
        command: Forward speed, speed to the left [m/s], and turning rate to the left [rad/s].
        seeds: Number of initial states per value: seed 0 is the default pose at rest, the other
            seeds are random states.
        quantities: Names of `VARIED_QUANTITIES`. ``strength`` is left out if no motor has a force
            limit.
        seconds: Duration of each run [s], 3 to 600.
        measured: {quantity: interval of the real robot, (lower, upper)}, as from
            `read_measured_intervals`.
        workers: Number of threads; by default the number of cores.

    Raises:
        ConfigurationError: If an argument is out of range, the base is fixed, or the robot has no
            feet, for example.
        ModelError: If the policy does not fit the robot.
    """
    checked_command = check_command(command)
    check_runs(seeds, seconds, WARM_UP_SECONDS)
    _check_quantities(quantities, measured)
    stage = prepare_stage(robot, policy)
    outcomes: dict[_Trial, Tracking] = {}

    def simulate(trials: list[_Trial]) -> None:
        """Simulate all trials without an entry in ``outcomes``, and add the entries."""
        new = [trial for trial in dict.fromkeys(trials) if trial not in outcomes]
        cases = [
            make_changed_case(stage, name, value, checked_command, seed)
            for name, value, seed in new
        ]
        runs = simulate_cases(stage, cases, seconds, WARM_UP_SECONDS, workers)
        for trial, run in zip(new, runs, strict=True):
            outcomes[trial] = evaluate_tracking(stage, run, WARM_UP_SECONDS)

    unchanged = [("delay", 0.0, seed) for seed in range(seeds)]
    simulate(unchanged)
    own = [outcomes.pop(trial) for trial in unchanged]
    tracking_seeds = tuple(seed for seed, outcome in enumerate(own) if outcome.tracks)
    limited = bool(stage.model.actuator_forcelimited[_find_motors(stage)].any())
    names = [name for name in quantities if name != "strength" or limited]
    brackets = _make_brackets(names, tracking_seeds)
    _bisect_brackets(brackets, outcomes, simulate)
    intervals = [
        _make_interval(name, tracking_seeds, brackets, outcomes, (measured or {}).get(name))
        for name in names
        if tracking_seeds
    ]
    count = len(outcomes) + len(own)
    return TrackedIntervals(
        name=robot.name,
        mass=robot.total_mass,
        policy=policy.name,
        command=checked_command,
        requested_seeds=seeds,
        seeds=tracking_seeds,
        speed_margins=np.array([outcome.speed_margin for outcome in own]),
        turning_margins=np.array([outcome.turning_margin for outcome in own]),
        intervals=tuple(intervals),
        rollouts=count,
        seconds=float(seconds),
        remarks=(*list_walk_remarks(stage.robot), *policy.notes),
    )


QUANTITY_OF_FIT_KIND: Mapping[str, str] = {
    "mass": "mass",
    "com": "com",
    "kp": "kp",
    "kd": "kd",
    "delay": "delay",
}
"""{kind of an estimate in the JSON of a fit: quantity that ``walk`` varies}. Friction is not
listed, since ``fit`` estimates the friction of joints, and ``walk`` varies the sliding friction of
contacts.
"""


def read_measured_intervals(
    path: str | Path, robot: Robot, latency: float = 0.0
) -> dict[str, tuple[float, float]]:
    """Read the 95 % intervals of a fit of the real robot, as values of `VARIED_QUANTITIES`.

    - ``mass`` is a factor on the stated mass of the base.
    - ``com`` is the forward displacement of the base's CoM [m].
    - ``kp`` and ``kd`` are factors on the stated gains. The interval contains the intervals of the
      joints with a positive gain.
    - ``delay`` [s] is the fitted delay minus the latency of the policy, at least 0.

    Args:
        path: JSON of a fit: ``fit.json``, or the output of ``--json``.
        robot: Robot.
        latency: Latency of the policy [s].

    Returns:
        {quantity: (lower end, upper end)}, not empty.

    Raises:
        ModelError: If the file cannot be read, contains no quantity that can be varied, or contains
            an interval whose lower end is above the upper end, for example.
    """
    try:
        data = orjson.loads(read_input(Path(path), MAX_TEXT_BYTES))
    except InputError as error:
        raise ModelError(error.path, error.cause) from error
    except orjson.JSONDecodeError as error:
        raise ModelError(path, diagnose("policy-not-json", problem=str(error))) from error
    bases = {robot.mj_base, robot.base}
    intervals: dict[str, tuple[float, float]] = {}
    for estimate in _find_estimates(data):
        try:
            kind, subject, component = estimate["kind"], estimate["subject"], estimate["component"]
            nominal, low, high = (float(estimate[name]) for name in ("stated", "low", "high"))
        except (KeyError, TypeError, ValueError) as error:
            raise ModelError(path, diagnose("no-fit")) from error
        if not all(isinstance(text, str) for text in (kind, subject, component)):
            raise ModelError(path, diagnose("no-fit"))
        if low > high:
            raise ModelError(path, diagnose("interval-ends", name=kind, low=low, high=high))
        if kind not in QUANTITY_OF_FIT_KIND or not all(map(math.isfinite, (nominal, low, high))):
            continue
        if kind in ("mass", "com") and (subject not in bases or component not in ("", "x")):
            continue
        if kind == "delay":
            low, high = max(low - latency, 0.0), max(high - latency, 0.0)
        elif kind == "com":
            low, high = low - nominal, high - nominal
        elif nominal > 0:
            low, high = low / nominal, high / nominal
        else:
            continue
        before = intervals.get(QUANTITY_OF_FIT_KIND[kind], (low, high))
        intervals[QUANTITY_OF_FIT_KIND[kind]] = (min(low, before[0]), max(high, before[1]))
    if not intervals:
        raise ModelError(path, diagnose("no-fit"))
    return intervals


def _find_estimates(data: Any) -> list[Any]:
    """Return the estimates in the JSON of a fit, unchecked; empty without a list of estimates."""
    for key in ("estimates", "parameters"):
        rows = data.get(key) if isinstance(data, dict) else None
        if isinstance(rows, list):
            return rows
    return []
