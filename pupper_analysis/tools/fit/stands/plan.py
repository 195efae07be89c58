"""Which stands to take: those that tell most of a robot's numbers, in reach and in balance."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError, MeasurementError, PupperAnalysisError
from pupper_analysis.base.files import write_atomically
from pupper_analysis.base.kinds import PLAN_KIND
from pupper_analysis.base.results import Result
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import compute_command_lead
from pupper_analysis.robot.tool import Place, Tool, find_place, with_payload
from pupper_analysis.stance.judge import Stand
from pupper_analysis.stance.sag.steady_state import SteadyState, steady_state
from pupper_analysis.stance.stand import solve_stand
from pupper_analysis.stance.task import StandTask
from pupper_analysis.tools.fit.estimate import Posterior
from pupper_analysis.tools.fit.measurements.stands import MeasuredStands, format_stands
from pupper_analysis.tools.fit.parameters import ParameterTable, Prior, apply_priors, parse_priors
from pupper_analysis.tools.fit.result import Estimate, classify_determination, describe_parameter
from pupper_analysis.tools.fit.stands.equations import StandEquations
from pupper_analysis.tools.fit.stands.fit import (
    KNOWN_MASS_FRACTION,
    LIMIT_MARGIN_STDS,
    MIN_STANDS,
    estimate_com,
    get_stated_stiffness,
    list_inertials,
    list_parameters,
    predict_noise,
)

Array = NDArray[np.float64]

_MOST_STANDS = 1000
"""A day's work, and more."""

_CANDIDATES = 6
"""Per stand that is wanted: among so many the best are found that a hundred more hardly better."""


@dataclass(frozen=True)
class PlannedStand(Result):
    """A stand to be taken.

    Attributes:
        name: Its name.
        swing: The feet in the air.
        command: {joint: command of its servo (rad)}.
        utilisation: Of the motor that gives most of what it can; None if none has a limit.
        heading: How the robot is to be turned about the vertical (rad): the slope of the ground
            changes with it, and a com does not.
        added: Known mass that is to be put on (kg).
    """

    name: str
    swing: tuple[str, ...]
    command: Mapping[str, float] = field(metadata={"unit": "rad"})
    utilisation: float | None = field(metadata={"unit": "1"})
    heading: float = field(default=0.0, metadata={"unit": "rad"})
    added: float = field(default=0.0, metadata={"unit": "kg"})


@dataclass(frozen=True, eq=False)
class StandPlan(Result):
    """Stands that tell most of a robot's numbers, and what they will tell.

    Attributes:
        name: The robot's name.
        stands: The stands.
        expected: Each parameter as the file has it, with the interval that these stands leave.
        candidates: Among how many they were chosen.
        place: Where a known mass is to be put on; None if no stand has one.
    """

    name: str
    stands: tuple[PlannedStand, ...]
    expected: tuple[Estimate, ...]
    candidates: int
    place: Tool | None = None


@check_arguments
def plan_stands(
    robot: Robot,
    count: int,
    *,
    priors: Sequence[Prior | str] = (),
    kp: ArrayLike | None = None,
    added: float | None = None,
    added_at: Place | None = None,
    seed: int = 0,
) -> StandPlan:
    """Chooses the stands whose measurement tells most of a robot's numbers.

    D-optimal: of random stands that the robot can hold, those are taken, one after the other, that
    make the determinant of what is known largest, and each is then exchanged as long as that
    betters it. They are in reach and balance, clear of themselves, within 60 % of the motors'
    limits, and their servos hold them with the feed-forward of the file's own masses. At most a
    third is on three feet, half of the candidates is turned by 180 degrees, and half has the known
    mass on, if there is one.

    Args:
        robot: The robot, with a free base and feet.
        count: How many stands.
        priors: What is known before; as for ``fit_stands``.
        kp: Stiffness of the servos (N m/rad); the model's own by default.
        added: Known mass to be put on for some of the stands (kg); by default 15 % of the robot's,
            to two digits.
        added_at: Where, in the base's frame or in that of a link (m); by default on top of it.
        seed: Of the random stands.

    Raises:
        ConfigurationError: If the count is none, or the base is fixed.
        MeasurementError: If the robot's servos hold too few stands.
    """
    robot.check_floating()
    robot.check_tree("fit")
    if not MIN_STANDS <= count <= _MOST_STANDS:
        raise ConfigurationError("count", diagnose("no-count", count=count, least=MIN_STANDS))
    if seed < 0:
        raise ConfigurationError("seed", diagnose("no-seed", seed=seed))
    stiffness = get_stated_stiffness(robot, robot.name, np.ones(robot.nu, dtype=bool), kp)
    rng = np.random.default_rng(seed)
    known = parse_priors(priors)
    if added is None:
        added = float(f"{KNOWN_MASS_FRACTION * robot.total_mass:.2g}")
    place = find_place(robot, (0.0, 0.0, _top(robot)) if added_at is None else added_at)
    loaded = with_payload(robot, added, (place.link, *place.offset))
    found: list[_Candidate] = []
    for one in [robot] if loaded is robot else [robot, loaded]:
        candidates = RandomStands(one, rng, kp, known)
        share = _CANDIDATES * count if loaded is robot else -(-_CANDIDATES * count // 2)
        drawn = candidates.draw_stands(share)
        mass = 0.0 if one is robot else added
        found += [
            _candidate(robot, stand, sagged, stiffness, math.pi * (at % 2), mass)
            for at, (stand, sagged) in enumerate(drawn)
        ]
        if len(drawn) < min(count, share):
            raise MeasurementError(robot.name, candidates.explain_shortage(count))
    stands = _as_measured(robot.name, [one.planned for one in found], place)
    stands = replace(stands, position=np.array([one.position for one in found]))
    table = ParameterTable(apply_priors(list_parameters(robot, stands, stiffness), known))
    noise, friction = predict_noise(robot, stands, None)
    equations = StandEquations(robot, stands, table, stiffness, friction, noise)
    each = equations.compute_informations(table.stated)
    lifted = [bool(one.planned.swing) for one in found]
    chosen = choose_stands(each, table.precision, count, lifted, count // _ON_THREE_AT_MOST)
    whole = table.precision + np.sum([each[place] for place in chosen], axis=0)
    deviation = np.sqrt(np.diag(np.linalg.inv(whole)))
    return StandPlan(
        name=robot.name,
        stands=tuple(
            replace(one.planned, name=f"s{number:02d}")
            for number, one in enumerate(
                sorted((found[at] for at in chosen), key=lambda one: one.effort), 1
            )
        ),
        expected=tuple(
            describe_parameter(
                one, one.stated, one.width * float(after), classify_determination(float(after) ** 2)
            )
            for one, after in zip(table.parameters, deviation, strict=True)
        ),
        candidates=len(found),
        place=place if loaded is not robot else None,
    )


def _top(robot: Robot) -> float:
    """Returns how high shapes of the base reach above its frame's origin (m)."""
    model, config = robot.mj_model, Configuration(robot, robot.home)
    data = mujoco.MjData(model)
    robot.mj_convention.set_state(data, config.qpos)
    mujoco.mj_kinematics(model, data)
    geoms = np.flatnonzero(model.geom_bodyid == model.body(robot.mj_base).id)
    turns = data.geom_xmat[geoms].reshape(-1, 3, 3)
    middle, half = model.geom_aabb[geoms, :3], model.geom_aabb[geoms, 3:]
    up = config.frame_rotation(robot.base)[:, 2]
    along = np.einsum("gji,j->gi", turns, up)
    high = data.geom_xpos[geoms] @ up + (along * middle + np.abs(along) * half).sum(axis=1)
    return float((high - config.frame_position(robot.base) @ up).max(initial=0.0))


_ON_THREE_AT_MOST = 3
"""One in so many stands is on three feet: which foot carries then, a person must see."""


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A stand that may be taken, where its joints are then (nu,), and how high the base (m)."""

    planned: PlannedStand
    position: Array
    height: float

    @property
    def effort(self) -> tuple[float, int, float, float]:
        """With least to do between two of them: stands with the same mass and feet, in height."""
        one = self.planned
        return one.added, len(one.swing), one.heading, self.height


def _candidate(
    robot: Robot, stand: Stand, sagged: SteadyState, kp: Array, heading: float, added: float
) -> _Candidate:
    """Returns a stand with what servos are commanded to hold it where it is clear of itself."""
    torque, position = sagged.joint_torques, sagged.qpos[7:]
    share = float((np.abs(torque) / robot.effort_limits).max())
    command = (position + compute_command_lead(torque, kp)).tolist()
    planned = PlannedStand(
        name="",
        swing=tuple(stand.task.swing),
        command=dict(zip(robot.joint_names, command, strict=True)),
        utilisation=share if np.isfinite(robot.effort_limits).any() else None,
        heading=heading,
        added=added,
    )
    return _Candidate(planned, position, float(stand.qpos[2]))


def choose_stands(
    each: Sequence[Array],
    before: Array,
    count: int,
    rare: Sequence[bool] = (),
    most: int = 0,
) -> tuple[int, ...]:
    """Returns which of some measurements make the determinant of all information largest.

    Taken greedily, then exchanged one by one: Fedorov's algorithm, which ends where no exchange
    betters it. (V. V. Fedorov, Theory of Optimal Experiments, 1972.)

    Args:
        each: Information (n, n) of each.
        before: (n, n) what is known without them.
        count: How many are taken.
        rare: Of each, whether no more than ``most`` are taken, as long as there are others.
        most: How many.
    """
    chosen: list[int] = []
    scarce = set(np.flatnonzero(rare).tolist())

    def open_ones(had: Sequence[int]) -> list[int]:
        left = [place for place in range(len(each)) if place not in had]
        full = len(scarce & set(had)) >= most
        return [place for place in left if not full or place not in scarce] or left

    whole = before.copy()
    for _ in range(count):
        best = max(open_ones(chosen), key=lambda place: _volume(whole + each[place]))
        chosen.append(best)
        whole = whole + each[best]
    for _ in range(_EXCHANGES):
        had = list(chosen)
        for slot, place in enumerate(had):
            without = whole - each[place]
            others = [*chosen[:slot], *chosen[slot + 1 :]]
            allowed = dict.fromkeys([*open_ones(others), place])
            best = max(allowed, key=lambda one: _volume(without + each[one]))
            chosen[slot], whole = best, without + each[best]
        if chosen == had:
            break
    return tuple(sorted(chosen))


_EXCHANGES = 5
"""Rounds of exchanges; two or three are enough."""


def _volume(information: Array) -> float:
    return float(np.linalg.slogdet(information)[1])


def _as_measured(
    source: str, planned: Sequence[PlannedStand], place: Tool | None
) -> MeasuredStands:
    """Returns planned stands as they are measured, positions to be filled in."""
    command = np.array([list(one.command.values()) for one in planned])
    loads = {}
    if place is not None and any(one.added for one in planned):
        on = [[one.added, *place.offset] if one.added else [0.0] * 4 for one in planned]
        loads = {place.link: np.array(on)}
    return MeasuredStands(
        source=source,
        names=tuple(one.name for one in planned),
        joints=tuple(planned[0].command),
        command=command,
        position=np.full(command.shape, np.nan),
        swing=tuple(one.swing for one in planned),
        heading=np.array([one.heading for one in planned]),
        added=loads,
    )


@check_arguments
def write_plan(plan: StandPlan, path: str | Path, *, force: bool = False) -> None:
    """Writes stands as a CSV file that ``read_stands`` reads, once positions are filled in.

    Args:
        plan: The stands.
        path: The file.
        force: Replace what is no plan, too; but never a plan with readings, which no computer can
            make again.

    Raises:
        OutputError: If it cannot be written, or what is there must not be replaced.
    """
    with write_atomically(Path(path), PLAN_KIND, force=force) as file:
        text = format_stands(_as_measured(plan.name, plan.stands, plan.place))
        file.write(text.encode())


# Random stands that a robot's servos hold, with numbers that are not known yet.

_TRIES = 8
"""Per stand: one in two to four is in reach, in balance and lasts."""

_IN_VAIN = 24
"""Tries, of which none is a stand: even the nominal one, nearly, was tried then."""

_NARROWER, _WIDER = 0.85, 1.2
"""After a stand that the robot does not come to, the next one is drawn nearer to the nominal one,
after one that it holds further away: one in two is held, from robots with much reach and little."""

_UTILISED = 0.6
"""Of a motor's limit, at most: what is measured is a robot that stands for minutes."""

_LOWEST, _HIGHEST = 0.75, 1.1
"""Of the nominal stand's height."""

_TILT = 0.25
"""rad: roll and pitch, either way."""

_STEP = 0.15
"""Of the height: how far a foot stands from its nominal place, either way."""

_LIFTED = 0.15
"""Of the height: how high a foot is swung, at least."""

_ON_THREE = 0.4
"""Share of candidates with a foot in the air, of robots with four feet and more."""

_CLEAR = 0.005
"""m: between links, in a stand that a robot comes to: by so much knees of v3 are off with encoders
that are by 3 deg."""

_PASSES = 0.5
"""Of what is between links in the nominal stand, where that is little: thighs pass by bodies."""

_MARGIN = 0.05
"""Of the height: how far the com is from the polygon's edge, at least."""


class RandomStands:
    """Draws stands within 60 % of the motors' limits, in reach, in balance, clear of themselves.

    Joints keep off their limits: one whose encoder is off may be at a stop that nobody sees. The
    com keeps off the polygon's edge by as much as it may be aside, where that leaves it any place.

    Args:
        robot: The robot, with a free base and feet.
        rng: Of the stands.
        kp: Stiffness of the servos (N m/rad); the model's own by default.
        priors: What is known of the robot before.
    """

    def __init__(
        self,
        robot: Robot,
        rng: np.random.Generator,
        kp: ArrayLike | None,
        priors: Sequence[Prior] = (),
    ) -> None:
        self._robot, self._rng, self._kp = robot, rng, kp
        self._off_limits = LIMIT_MARGIN_STDS * _offset_width(robot, priors)
        self._off_edge = compute_com_std(robot, priors)
        self._clear = _clearance(robot)
        # A foot stays in the air though servos give way, and zeros of encoders are off.
        lowered = _sag(robot, kp) + self._off_limits * robot.stand_height
        self._lifted = max(_LIFTED * robot.stand_height, lowered)
        self._far, self._found = 1.0, 0
        self._refused: Counter[str] = Counter()

    def draw_stands(self, count: int) -> list[tuple[Stand, SteadyState]]:
        """Returns stands, and where the servos let them sag to; fewer if there are too few."""
        found: list[tuple[Stand, SteadyState]] = []
        for tries in range(_TRIES * count):
            if len(found) == count or (tries == _IN_VAIN and not found):
                break
            stand = self._held(self._task())
            self._far = min(1.0, self._far * (_NARROWER if stand is None else _WIDER))
            found += [] if stand is None else [stand]
        self._found = len(found)
        return found

    def explain_shortage(self, wanted: int) -> Diagnostic:
        """Returns why there are fewer than that: what most stands failed in."""
        code = max(self._refused, key=lambda one: self._refused[one])
        if code == "too-few-in-reach":
            off = Quantity(self._off_limits, "rad")
            return diagnose("too-few-in-reach", found=self._found, wanted=wanted, off=off)
        if code == "too-few-within-limits":
            return diagnose("too-few-within-limits", found=self._found, wanted=wanted)
        return diagnose("too-few-are-held", found=self._found, wanted=wanted)

    def _task(self) -> StandTask:
        rng, size, feet = self._rng, self._robot.stand_height, list(self._robot.feet)
        swing = {}
        if len(feet) > 3 and rng.random() < _ON_THREE:
            swing = {feet[rng.integers(len(feet))]: self._lifted}

        def either(most: float) -> tuple[float, float]:
            one, two = self._far * rng.uniform(-most, most, 2)
            return float(one), float(two)

        higher = rng.uniform(_LOWEST - 1, _HIGHEST - 1)
        roll, pitch = either(_TILT)
        return StandTask(
            height=size * (1 + self._far * higher),
            roll=roll,
            pitch=pitch,
            swing=swing,
            foot_offsets={foot: either(_STEP * size) for foot in feet},
            com="inside",
            com_margin=max(self._off_edge, _MARGIN * size),
            self_clearance=self._clear,
            joint_margin=self._off_limits,
        )

    def _held(self, task: StandTask) -> tuple[Stand, SteadyState] | None:
        """Returns the stand and where it sags to; None, and counts why, if it is not held."""
        robot, nearer = self._robot, _MARGIN * self._robot.stand_height
        try:
            try:
                stand = solve_stand(robot, task, explain=False)
            except PupperAnalysisError:
                stand = solve_stand(robot, replace(task, com_margin=nearer), explain=False)
        except PupperAnalysisError:
            self._refused["too-few-in-reach"] += 1
            return None
        try:
            sagged = steady_state(robot, stand, kp=self._kp, feedforward=True)
        except PupperAnalysisError:
            self._refused["too-few-are-held"] += 1
            return None
        carries = set(sagged.stance_feet) == set(stand.stance_feet)
        if sagged.failures or not carries:
            self._refused["too-few-are-held"] += 1
            return None
        if (np.abs(sagged.joint_torques) > _UTILISED * robot.effort_limits).any():
            self._refused["too-few-within-limits"] += 1
            return None
        return stand, sagged


def _sag(robot: Robot, kp: ArrayLike | None) -> float:
    """Returns by how much servos alone let the nominal stand sink (m); 0 where they hold none."""
    try:
        stand = solve_stand(robot, explain=False)
        return float(max(0.0, stand.qpos[2] - steady_state(robot, stand, kp=kp).qpos[2]))
    except PupperAnalysisError:
        return 0.0


def _clearance(robot: Robot) -> float | None:
    """Returns how far links are to be from each other (m); None if they touch as it is."""
    try:
        near = solve_stand(robot, StandTask(self_clearance=0.0), explain=False).self_clearance
    except PupperAnalysisError:  # of its shapes none are apart
        return None
    return None if near is None else min(_CLEAR, _PASSES * near.distance)


def _offset_width(robot: Robot, priors: Sequence[Prior]) -> float:
    """Returns how far an encoder's zero may be off (rad), as a standard deviation."""
    offsets = [("offset", name, "", 0.0) for name in robot.joint_names]
    named = [prior for prior in priors if prior.kind == "offset"]
    return max((one.width for one in apply_priors(offsets, named)), default=0.0)


def compute_com_std(robot: Robot, priors: Sequence[Prior]) -> float:
    """Returns how far aside the com of the whole robot may be (m), as a standard deviation.

    In the nominal stand, along the worse of x and y, by what is known of masses and coms.
    """
    given = [one for one in priors if one.kind in ("mass", "com")]
    before = Posterior.from_prior(ParameterTable(apply_priors(list_inertials(robot), given)))
    return max(one.std for one in list(estimate_com(robot, before))[:2])
