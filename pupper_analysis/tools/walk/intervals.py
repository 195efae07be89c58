"""How far a robot may change before a policy no longer tracks its command."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import mujoco
import numpy as np
import orjson
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import ConfigurationError, InputError, ModelError
from pupper_analysis.base.inputs import MAX_TEXT_BYTES, read_input
from pupper_analysis.base.results import Result
from pupper_analysis.prepare.judge import list_file_remarks
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.walk.gait import check_command, check_runs, evaluate_tracking
from pupper_analysis.tools.walk.policy import Policy
from pupper_analysis.tools.walk.runs import Case, Stage, prepare_stage, simulate_cases

Array = NDArray[np.float64]

DEFAULT_SECONDS, WARM_UP_SECONDS = 5.0, 1.5
"""Of each run (s): what falls, falls in the first three."""

NUM_HALVINGS = 5
"""Of the range between what is tracked and what is not: to 3 % of it."""

Change = Callable[[Stage, mujoco.MjModel, float], None]


@dataclass(frozen=True)
class Quantity:
    """What of a robot is changed.

    Attributes:
        unit: ``x`` of a factor.
        nominal: Its value where nothing is changed.
        range: (least, greatest) that is tried: beyond it, no robot of the kind is.
        apply: Changes a copy of the model; None of a delay or a push, which are none of it.
    """

    unit: str
    nominal: float
    range: tuple[float, float]
    apply: Change | None

    def between(self, one: float, other: float) -> float:
        """Returns the middle of two values: of factors, their geometric mean."""
        return math.sqrt(one * other) if self.unit == "x" else (one + other) / 2


def _base(stage: Stage, model: mujoco.MjModel) -> int:
    return int(model.body(stage.robot.mj_base).id)


def _mass(stage: Stage, model: mujoco.MjModel, value: float) -> None:
    model.body_mass[_base(stage, model)] *= value
    model.body_inertia[_base(stage, model)] *= value


def _payload(stage: Stage, model: mujoco.MjModel, value: float) -> None:
    """Puts a part of the robot's mass on to it as a point at the base's centre of mass."""
    model.body_mass[_base(stage, model)] += value * stage.robot.total_mass


def _com(stage: Stage, model: mujoco.MjModel, value: float) -> None:
    model.body_ipos[_base(stage, model), 0] += value


def _friction(_: Stage, model: mujoco.MjModel, value: float) -> None:
    model.geom_friction[:, 0] *= value
    model.pair_friction[:, :2] *= value


def _motors(stage: Stage) -> NDArray[np.int64]:
    motors = stage.robot.mj_convention.actuator_index
    return motors[motors >= 0]


def _kp(stage: Stage, model: mujoco.MjModel, value: float) -> None:
    model.actuator_gainprm[_motors(stage), 0] *= value
    model.actuator_biasprm[_motors(stage), 1] *= value


def _kd(stage: Stage, model: mujoco.MjModel, value: float) -> None:
    model.actuator_biasprm[_motors(stage), 2] *= value


def _strength(stage: Stage, model: mujoco.MjModel, value: float) -> None:
    model.actuator_forcerange[_motors(stage)] *= value


def _legs(stage: Stage, model: mujoco.MjModel, value: float) -> None:
    """Scales what is beyond the first joint of each limb with a foot; masses stay."""
    base, limbs = _base(stage, model), set()
    for body, _ in stage.robot.contact_places.values():
        chain = []
        while body not in (0, base):
            chain.append(body)
            body = int(model.body_parentid[body])
        limbs |= set(chain[:-1])
    beyond = sorted(limbs)
    model.body_pos[beyond] *= value
    model.body_ipos[beyond] *= value
    model.geom_pos[np.isin(model.geom_bodyid, beyond)] *= value
    model.site_pos[np.isin(model.site_bodyid, beyond)] *= value


QUANTITIES: Mapping[str, Quantity] = {
    "mass": Quantity("x", 1.0, (0.25, 4.0), _mass),
    "com": Quantity("m", 0.0, (-0.1, 0.1), _com),
    "friction": Quantity("x", 1.0, (0.05, 4.0), _friction),
    "kp": Quantity("x", 1.0, (0.1, 8.0), _kp),
    "kd": Quantity("x", 1.0, (0.05, 8.0), _kd),
    "delay": Quantity("s", 0.0, (0.0, 0.2), None),
    "strength": Quantity("x", 1.0, (0.05, 4.0), _strength),
    "legs": Quantity("x", 1.0, (0.5, 2.0), _legs),
    "payload": Quantity("1", 0.0, (0.0, 2.0), _payload),
    "push-forward": Quantity("m/s", 0.0, (-3.0, 3.0), None),
    "push-left": Quantity("m/s", 0.0, (-3.0, 3.0), None),
}
"""Mass and com (forward) are those of the base's body, friction that of all contacts, the legs'
length that beyond the first joint of each limb, at the same masses. A payload is in parts of the
robot's mass, at its base's com; a push, of one action, is its impulse over the robot's mass."""

_PUSHES = {"push-forward": (1.0, 0.0), "push-left": (0.0, 1.0)}


@dataclass(frozen=True, eq=False)
class TrackedInterval(Result):
    """Between which values of a quantity a policy still tracks its command.

    Attributes:
        quantity: Of ``QUANTITIES``.
        unit: ``x`` of a factor.
        nominal: Where nothing is changed.
        least: (seeds,) the least value found with which it tracks.
        most: (seeds,) the greatest.
        below: (seeds,) greatest value below ``least`` with which it does not; not a number where
            it tracks at the end of the range that was tried.
        above: (seeds,) least value above ``most`` with which it does not; likewise.
        measured: (2,) where the real robot's value is, with 95 %, by a fit; None without.
    """

    quantity: str
    unit: str
    nominal: float = field(metadata={"unit": "varies"})
    least: Array = field(metadata={"unit": "varies"})
    most: Array = field(metadata={"unit": "varies"})
    below: Array = field(metadata={"unit": "varies"})
    above: Array = field(metadata={"unit": "varies"})
    measured: tuple[float, float] | None = field(default=None, metadata={"unit": "varies"})
    _reported: ClassVar[tuple[str, ...]] = ("common", "inside")

    @property
    def common(self) -> tuple[float, float]:
        """Where the runs of all seeds track."""
        return float(self.least.max()), float(self.most.min())

    @property
    def inside(self) -> bool | None:
        """Whether all runs track wherever the real robot may be; None if it was not measured."""
        if self.measured is None:
            return None
        low, high = self.common
        return low <= self.measured[0] and self.measured[1] <= high


@dataclass(frozen=True, eq=False)
class TrackedIntervals(Result):
    """How far a robot may change before a policy no longer tracks its command.

    Attributes:
        name: The robot's name.
        mass: kg.
        policy: The name of the policy's file.
        command: (3,) speed forward and to the left (m/s), and turning to the left (rad/s).
        asked: How many starts were asked for.
        seeds: Those of them that track the unchanged robot; the others are left out.
        intervals: One for each quantity, the others unchanged.
        rollouts: How many runs were simulated.
        seconds: Simulated in each.
        remarks: Errors and assumptions of the robot's files that it rests on.
    """

    name: str
    mass: float = field(metadata={"unit": "kg"})
    policy: str
    command: Array = field(metadata={"unit": "m/s or rad/s"})
    asked: int
    seeds: tuple[int, ...]
    intervals: tuple[TrackedInterval, ...]
    rollouts: int
    seconds: float = field(metadata={"unit": "s"})
    remarks: tuple[Diagnostic, ...]
    _reported: ClassVar[tuple[str, ...]] = ("passed",)

    @property
    def passed(self) -> bool:
        """Whether it tracks the unchanged robot, and wherever a fit says that the real one is."""
        return len(self.seeds) == self.asked and all(
            one.inside is not False for one in self.intervals
        )


def make_changed_case(stage: Stage, name: str, value: float, command: Array, seed: int) -> Case:
    """Returns a run of a robot of which one quantity has another value."""
    quantity, latency = QUANTITIES[name], stage.policy.contract.latency
    if name in _PUSHES:
        impulse = value * stage.robot.total_mass
        push = (impulse * _PUSHES[name][0], impulse * _PUSHES[name][1])
        return Case(stage.model, command, latency, seed, push=push)
    if quantity.apply is None:
        return Case(stage.model, command, latency + value, seed)
    model = copy.copy(stage.model)
    quantity.apply(stage, model, value)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    lift = _lowest(stage, stage.model) - _lowest(stage, model) if name == "legs" else 0.0
    return Case(model, command, latency, seed, lift)


def _lowest(stage: Stage, model: mujoco.MjModel) -> float:
    """Returns the height of the lowest foot's geom in the default pose (m)."""
    data = mujoco.MjData(model)
    stage.robot.mj_convention.set_state(data, stage.default)
    mujoco.mj_kinematics(model, data)
    return float(data.geom_xpos[list(stage.robot.foot_geoms), 2].min())


@check_arguments
def tracked_intervals(
    robot: Robot,
    policy: Policy,
    command: ArrayLike = (0.5, 0.0, 0.0),
    *,
    seeds: int = 3,
    quantities: tuple[str, ...] = tuple(QUANTITIES),
    seconds: float = DEFAULT_SECONDS,
    measured: Mapping[str, tuple[float, float]] | None = None,
    workers: int | None = None,
) -> TrackedIntervals:
    """Finds between which values of each quantity a policy still tracks its command.

    Each quantity is changed alone, both ways, and its range halved five times between what is
    tracked and what is not; the same starts are used for all (paired seeds). What is tracked need
    not be an interval: one end of perhaps several is found. The same for any number of workers.

    Args:
        robot: The robot.
        policy: The policy.
        command: Speed forward and to the left (m/s), and turning to the left (rad/s).
        seeds: How many starts; the first is exactly the default pose.
        quantities: Of ``QUANTITIES``.
        seconds: Of each run, 3 to 600.
        measured: {quantity: where the real robot's value is}; see ``read_measured_intervals``.
        workers: Threads; by default one per core.

    Raises:
        ConfigurationError: If an argument is out of its range, or the base is fixed.
        ModelError: If the policy does not fit the robot.
    """
    wanted = check_command(command)
    check_runs(seeds, seconds, WARM_UP_SECONDS)
    for name in quantities:
        if name not in QUANTITIES:
            problem = diagnose("none-of", value=name, known=tuple(QUANTITIES))
            raise ConfigurationError("vary", problem)
    stage, count = prepare_stage(robot, policy), 0

    def track(asked: list[tuple[str, float, int]]) -> list[bool]:
        nonlocal count
        count += len(asked)
        cases = [make_changed_case(stage, name, value, wanted, seed) for name, value, seed in asked]
        runs = simulate_cases(stage, cases, seconds, WARM_UP_SECONDS, workers)
        return [evaluate_tracking(stage, run, WARM_UP_SECONDS).tracks for run in runs]

    tried = [("delay", 0.0, seed) for seed in range(seeds)]
    kept = tuple(seed for (_, _, seed), good in zip(tried, track(tried), strict=True) if good)
    limited = bool(stage.model.actuator_forcelimited[_motors(stage)].any())
    names = [name for name in quantities if name != "strength" or limited]
    ends: dict[tuple[str, int, int], list[float]] = {}  # [tracked, not tracked]
    for name in names:
        quantity = QUANTITIES[name]
        for side, end in enumerate(quantity.range):
            for seed in kept:
                missing = math.nan if end == quantity.nominal else end
                ends[name, side, seed] = [quantity.nominal, missing]
    going = [key for key, (_, end) in ends.items() if not math.isnan(end)]
    for (name, side, seed), good in zip(
        going, track([(key[0], ends[key][1], key[2]) for key in going]), strict=True
    ):
        if good:
            ends[name, side, seed] = [ends[name, side, seed][1], math.nan]
    for _ in range(NUM_HALVINGS):
        going = [key for key, (_, end) in ends.items() if not math.isnan(end)]
        middles = [QUANTITIES[key[0]].between(*ends[key]) for key in going]
        asked = [(key[0], value, key[2]) for key, value in zip(going, middles, strict=True)]
        for key, value, good in zip(going, middles, track(asked), strict=True):
            ends[key][0 if good else 1] = value
    found = []
    for name in names:
        least, most = (np.array([ends[name, side, seed] for seed in kept]) for side in (0, 1))
        if kept:
            quantity = QUANTITIES[name]
            values = (least[:, 0], most[:, 0], least[:, 1], most[:, 1])
            known = (measured or {}).get(name)
            found.append(TrackedInterval(name, quantity.unit, quantity.nominal, *values, known))
    return TrackedIntervals(
        name=robot.name,
        mass=robot.total_mass,
        policy=policy.name,
        command=wanted,
        asked=seeds,
        seeds=kept,
        intervals=tuple(found),
        rollouts=count,
        seconds=float(seconds),
        remarks=list_file_remarks(robot),
    )


QUANTITY_OF_FIT_KIND: Mapping[str, str] = {
    "mass": "mass",
    "com": "com",
    "kp": "kp",
    "kd": "kd",
    "delay": "delay",
}
"""{kind of a fit's parameters: the quantity}. A fit's friction is that of joints, not of ground."""


def read_measured_intervals(
    path: str | Path, robot: Robot, latency: float = 0.0
) -> dict[str, tuple[float, float]]:
    """Returns where a real robot's quantities are with 95 %, as ``fit`` found.

    Mass and centre of mass are the base's; of several joints' gains the widest interval counts, as
    a factor of what is stated; a delay is what there is more than the policy's latency.

    Args:
        path: A fit's JSON: ``fit.json``, or that of ``--json``.
        robot: The robot.
        latency: Of the policy (s).

    Raises:
        ModelError: If it is no fit's, or has nothing of what can be varied.
    """
    try:
        data = orjson.loads(read_input(Path(path), MAX_TEXT_BYTES))
    except InputError as error:
        raise ModelError(error.path, error.cause) from error
    except orjson.JSONDecodeError as error:
        raise ModelError(path, diagnose("policy-not-json", problem=str(error))) from error
    bases = {robot.mj_base, robot.base}
    found: dict[str, tuple[float, float]] = {}
    for one in _estimates(data):
        try:
            kind, subject, component = one["kind"], one["subject"], one["component"]
            stated, low, high = (float(one[name]) for name in ("stated", "low", "high"))
        except (KeyError, TypeError, ValueError) as error:
            raise ModelError(path, diagnose("no-fit")) from error
        if kind not in QUANTITY_OF_FIT_KIND or not all(map(math.isfinite, (stated, low, high))):
            continue
        if kind in ("mass", "com") and (subject not in bases or component not in ("", "x")):
            continue
        if kind == "delay":
            low, high = max(low - latency, 0.0), max(high - latency, 0.0)
        elif kind == "com":
            low, high = low - stated, high - stated
        elif stated > 0:
            low, high = low / stated, high / stated
        else:
            continue
        before = found.get(QUANTITY_OF_FIT_KIND[kind], (low, high))
        found[QUANTITY_OF_FIT_KIND[kind]] = (min(low, before[0]), max(high, before[1]))
    if not found:
        raise ModelError(path, diagnose("no-fit"))
    return found


def _estimates(data: Any) -> list[Any]:
    """Returns the rows of a fit's JSON, whichever of the two it is."""
    for key in ("estimates", "parameters"):
        rows = data.get(key) if isinstance(data, dict) else None
        if isinstance(rows, list):
            return rows
    return []
