"""Plan of stands: choose the stands whose measurements determine the parameters best.

Candidates are random stands that are reachable, balanced and held by the servos (`RandomStands`).
`choose_stands` selects a subset that is approximately D-optimal: the determinant of the information
is large.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError, MeasurementError, PupperAnalysisError
from pupper_analysis.base.files import write_atomically
from pupper_analysis.base.kinds import PLAN_KIND
from pupper_analysis.base.progress import report_progress
from pupper_analysis.base.results import Result
from pupper_analysis.base.units import POSITION_UNIT
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.joints import is_slide
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import compute_command_lead
from pupper_analysis.robot.tool import FramePoint, Tool, find_place, with_payload
from pupper_analysis.stance.judge import Stand
from pupper_analysis.stance.sag.steady_state import SteadyState, steady_state
from pupper_analysis.stance.stand import solve_stand
from pupper_analysis.stance.task import StandTask
from pupper_analysis.statics.equilibrium import compute_utilisation, peak_utilisation
from pupper_analysis.tools.fit.estimate import Posterior
from pupper_analysis.tools.fit.measurements.stands import MIN_STANDS, MeasuredStands, format_stands
from pupper_analysis.tools.fit.parameters import ParameterTable, Prior, apply_priors, parse_priors
from pupper_analysis.tools.fit.result import (
    Determined,
    Estimate,
    classify_determination,
    describe_parameter,
)
from pupper_analysis.tools.fit.stands.equations import StandEquations
from pupper_analysis.tools.fit.stands.fit import (
    KNOWN_MASS_FRACTION,
    LIMIT_MARGIN_STDS,
    estimate_com,
    get_stated_stiffness,
    list_inertials,
    list_parameters,
    predict_noise,
)

_MAX_STANDS = 1000
"""Upper bound of the number of planned stands. Chosen, not tuned: more than a day of work."""

_CANDIDATES_PER_STAND = 6
"""Requested number of random candidates per planned stand. Chosen, not tuned.
"""


MIN_GAIN = 2
"""Lower bound of (parameters that the measurements of all candidates determine / parameters that
the planned stands determine) with which more stands are proposed. Chosen, not tuned."""


@dataclass(frozen=True)
class PlannedStand(Result):
    """Stand that a plan of measurements requests: joint commands, feet in the air, added mass.

    Attributes:
        name: Stand name.
        swing: Names of the feet in the air.
        command: Command of each joint's servo.
        utilisation: Largest ratio of motor torque to torque limit; None if no motor has a limit.
        heading: Rotation of the robot about the vertical. The heading changes the effect of the
            ground's slope, but not the effect of the CoM, so that both can be estimated.
        added: Known mass that is attached; 0 for none.
    """

    name: str
    swing: tuple[str, ...]
    command: Mapping[str, float] = field(metadata={"unit": POSITION_UNIT})
    utilisation: float | None = field(metadata={"unit": "1"})
    heading: float = field(default=0.0, metadata={"unit": "rad"})
    added: float = field(default=0.0, metadata={"unit": "kg"})


@dataclass(frozen=True, eq=False)
class StandPlan(Result):
    """Planned stands, and the intervals of the parameters that are expected after the measurement.

    Attributes:
        name: Robot name.
        stands: Stands.
        expected: Parameters with the stated values and the expected intervals.
        candidates: Number of random stands from which the stands were chosen.
        place: Link and position of the known mass; None if there is none.
        slides: Names of the joints that are slides.
        determined_by_all: {parameter kind: number of parameters that the measurements would
            determine if all candidates were measured}. Further stands determine about these
            parameters; kinds without such a parameter need a known value (a prior).
    """

    name: str
    stands: tuple[PlannedStand, ...]
    expected: tuple[Estimate, ...]
    candidates: int
    place: Tool | None = None
    slides: tuple[str, ...] = ()
    determined_by_all: Mapping[str, int] = field(default_factory=dict)

    @property
    def determined(self) -> Counter[str]:
        """{parameter kind: number of parameters that the measurements of the stands determine}."""
        return _count_determined(self.expected)

    @property
    def more_stands_help(self) -> bool:
        """True if all candidates determine `MIN_GAIN` times as many parameters as the stands."""
        of_all = sum(self.determined_by_all.values())
        return of_all >= max(1, MIN_GAIN * self.determined.total())


@check_arguments
def plan_stands(
    robot: Robot,
    count: int,
    *,
    priors: Sequence[Prior | str] = (),
    kp: ArrayLike | None = None,
    added: float | None = None,
    added_at: FramePoint | None = None,
    seed: int = 0,
) -> StandPlan:
    """Choose the stands whose measurement determines the parameters of a robot best.

    The design is approximately D-optimal: ``choose_stands`` searches for a large determinant of the
    information. The candidates are random stands that are balanced, and that the servos hold within
    60 % of the known torque limits (`RandomStands`). Candidates may have a foot in the air, carry
    the known mass, or have a heading of 180 deg.

    Args:
        robot: Robot with a free base and feet.
        count: Number of stands.
        priors: Prior standard deviations: ``mass=50%``, ``com:base=5mm``, ``kp=0`` (kp is exact).
        kp: Servo stiffness [N m/rad, N/m], scalar or shape (nu,); the model's by default.
        added: Known mass [kg], 0 for none. Default: 15 % of the robot's mass, rounded to two
            significant digits.
        added_at: Position of the known mass in the frame of the base, or of a link, site, body or
            geom [m]. Default: above the origin of the base, on top of the boxes around the
            geoms of the base.
        seed: Seed of the random stands.

    Raises:
        ConfigurationError: If an argument is invalid, the base is fixed, or the robot has closed
            loops, couplings, welds or grips.
        MeasurementError: If a joint has no stated kp and ``kp`` is None, or too few random stands
            are in reach, held by the servos and within the torque limits.
        ModelError: If ``kp`` is passed and a joint has no motor, or the model with the known mass
            cannot be built.
        UnknownNameError: If the robot has no frame with the name in ``added_at``.
    """
    robot.check_floating()
    robot.check_tree("fit")
    if not MIN_STANDS <= count <= _MAX_STANDS:
        raise ConfigurationError("count", diagnose("no-count", count=count, least=MIN_STANDS))
    if seed < 0:
        raise ConfigurationError("seed", diagnose("no-seed", seed=seed))
    stiffness = get_stated_stiffness(robot, robot.name, np.ones(robot.nu, dtype=bool), kp)
    rng = np.random.default_rng(seed)
    prior_list = parse_priors(priors)
    if added is None:
        added = float(f"{KNOWN_MASS_FRACTION * robot.total_mass:.2g}")
    place = find_place(
        robot, (0.0, 0.0, _compute_base_top(robot)) if added_at is None else added_at
    )
    loaded_robot = with_payload(robot, added, (place.link, *place.offset))
    candidates = _draw_candidates(robot, loaded_robot, added, count, stiffness, kp, rng, prior_list)
    stands = _make_measured_stands(
        robot.name, [candidate.planned for candidate in candidates], place
    )
    stands = replace(stands, position=np.array([candidate.position for candidate in candidates]))
    table = ParameterTable(apply_priors(list_parameters(robot, stands, stiffness), prior_list))
    noise, friction = predict_noise(robot, stands, None)
    equations = StandEquations(robot, stands, table, stiffness, friction, noise)
    informations = equations.compute_informations(table.stated)
    lifted = [bool(candidate.planned.swing) for candidate in candidates]
    chosen = choose_stands(
        informations, table.precision, count, lifted, count // _STANDS_PER_LIFTED_FOOT
    )
    information = table.precision + np.sum([informations[index] for index in chosen], axis=0)
    information_of_all = table.precision + np.sum(informations, axis=0)
    return StandPlan(
        name=robot.name,
        slides=tuple(joint for joint in robot.joint_names if is_slide(robot, joint)),
        stands=_number_stands([candidates[index] for index in chosen]),
        expected=_expect_estimates(table, information),
        candidates=len(candidates),
        determined_by_all=dict(_count_determined(_expect_estimates(table, information_of_all))),
        place=place if loaded_robot is not robot else None,
    )


def _draw_candidates(
    robot: Robot,
    loaded_robot: Robot,
    added: float,
    count: int,
    stiffness: Array,
    kp: ArrayLike | None,
    rng: np.random.Generator,
    priors: Sequence[Prior],
) -> list[_Candidate]:
    """Draw random stands, the candidates for the stands of a plan.

    ``loaded_robot`` is the robot with the known mass ``added`` [kg], or ``robot`` itself if there
    is no known mass.

    Raises:
        MeasurementError: If too few random stands are possible.
    """
    variants = [robot] if loaded_robot is robot else [robot, loaded_robot]
    num_draws = -(-_CANDIDATES_PER_STAND * count // len(variants))  # rounded up
    candidates: list[_Candidate] = []
    for variant in variants:
        generator = RandomStands(variant, rng, kp, priors)
        draws = generator.draw_stands(num_draws)
        added_mass = 0.0 if variant is robot else added
        candidates += [
            _make_candidate(robot, stand, sagged, stiffness, math.pi * (index % 2), added_mass)
            for index, (stand, sagged) in enumerate(draws)
        ]
        if len(draws) < min(count, num_draws):
            raise MeasurementError(robot.name, generator.explain_shortage(count))
    return candidates


def _number_stands(candidates: Sequence[_Candidate]) -> tuple[PlannedStand, ...]:
    """Sort chosen candidates into the order of measurement, and name the stands s01, s02 ..."""
    ordered = sorted(candidates, key=lambda candidate: candidate.sort_key)
    return tuple(
        replace(candidate.planned, name=f"s{number:02d}")
        for number, candidate in enumerate(ordered, 1)
    )


def _expect_estimates(table: ParameterTable, information: Array) -> tuple[Estimate, ...]:
    """Predict the interval of each parameter after the planned stands, around the stated value.

    ``information`` has the shape (n, n), includes the priors, and is in units of the parameters'
    widths.
    """
    deviation = np.sqrt(np.diag(np.linalg.inv(information)))
    return tuple(
        describe_parameter(
            parameter,
            parameter.stated,
            parameter.width * float(ratio),
            classify_determination(float(ratio) ** 2),
        )
        for parameter, ratio in zip(table.parameters, deviation, strict=True)
    )


def _count_determined(estimates: Sequence[Estimate]) -> Counter[str]:
    """Count the parameters of each kind that the measurements determine."""
    return Counter(
        estimate.kind for estimate in estimates if estimate.determined is Determined.DATA
    )


def _compute_base_top(robot: Robot) -> float:
    """Return the height [m] of the boxes around the base's geoms above the base origin, at least 0.

    The height is along the z axis of the base.
    """
    model, config = robot.mj_model, Configuration(robot, robot.home)
    data = mujoco.MjData(model)
    robot.mj_convention.set_state(data, config.qpos)
    mujoco.mj_kinematics(model, data)
    geoms = np.flatnonzero(model.geom_bodyid == model.body(robot.mj_base).id)
    rotations = data.geom_xmat[geoms].reshape(-1, 3, 3)
    middle, half = model.geom_aabb[geoms, :3], model.geom_aabb[geoms, 3:]
    normal = config.frame_rotation(robot.base)[:, 2]
    projections = np.einsum("gji,j->gi", rotations, normal)
    heights = data.geom_xpos[geoms] @ normal + (
        projections * middle + np.abs(projections) * half
    ).sum(axis=1)
    return float((heights - config.frame_position(robot.base) @ normal).max(initial=0.0))


_STANDS_PER_LIFTED_FOOT = 3
"""Lower bound of (number of planned stands / number of stands with a foot in the air), as long as
other candidates are available. A person must watch the feet in stands with a foot in the air.
Chosen, not tuned.
"""


@dataclass(frozen=True, eq=False)
class _Candidate:
    """Random stand that a plan may contain.

    Attributes:
        planned: Stand as it would be planned, without a name.
        position: Predicted joint positions in the steady state, shape (nu,) [rad, m].
        height: Base height [m] before the static deflection.
    """

    planned: PlannedStand
    position: Array
    height: float

    @property
    def sort_key(self) -> tuple[float, int, float, float]:
        """Known mass [kg], number of swing feet, heading [rad] and base height [m] of a stand.

        In this order, the operator seldom changes the known mass, the swing feet and the heading.
        """
        stand = self.planned
        return stand.added, len(stand.swing), stand.heading, self.height


def _make_candidate(
    robot: Robot, stand: Stand, sagged: SteadyState, kp: Array, heading: float, added: float
) -> _Candidate:
    """Create a candidate from a stand in the steady state on the servos, with the servo commands.

    Args:
        robot: Robot.
        stand: Stand before the static deflection of servos and ground.
        sagged: Steady state of this stand, after the deflection.
        kp: Servo stiffness, shape (nu,) [N m/rad, N/m].
        heading: Rotation of the robot about the vertical [rad].
        added: Known mass on the robot [kg].
    """
    torque, position = sagged.joint_torques, sagged.qpos[7:]
    utilisation = peak_utilisation(compute_utilisation(robot, torque))
    command = (position + compute_command_lead(torque, kp)).tolist()
    planned = PlannedStand(
        name="",
        swing=tuple(stand.task.swing),
        command=dict(zip(robot.joint_names, command, strict=True)),
        utilisation=None if math.isnan(utilisation) else utilisation,
        heading=heading,
        added=added,
    )
    return _Candidate(planned, position, float(stand.qpos[2]))


def choose_stands(
    informations: Sequence[Array],
    prior_information: Array,
    count: int,
    is_rare: Sequence[bool] = (),
    max_rare: int = 0,
) -> tuple[int, ...]:
    """Choose stands whose total information has a large determinant (D-optimal design).

    A greedy selection is improved by single exchanges (V. V. Fedorov, Theory of Optimal
    Experiments, 1972).

    Args:
        informations: Information of each measurement, shape (n, n); at least ``count`` matrices.
        prior_information: Information without measurements, shape (n, n).
        count: Number of measurements to choose.
        is_rare: Whether a measurement counts towards ``max_rare``.
        max_rare: Largest number of rare measurements, as long as other measurements are available.

    Returns:
        Indices of the chosen measurements, in ascending order.
    """
    chosen: list[int] = []
    rare_indices = set(np.flatnonzero(is_rare).tolist())

    def list_available(chosen_indices: Sequence[int]) -> list[int]:
        """Return the indices of the measurements that may be chosen next."""
        candidates = [index for index in range(len(informations)) if index not in chosen_indices]
        full = len(rare_indices & set(chosen_indices)) >= max_rare
        return [
            index for index in candidates if not full or index not in rare_indices
        ] or candidates

    information = prior_information.copy()
    for _ in range(count):
        best_index = max(
            list_available(chosen),
            key=lambda index: _log_determinant(information + informations[index]),
        )
        chosen.append(best_index)
        information = information + informations[best_index]
    for _ in range(_MAX_EXCHANGE_ROUNDS):
        chosen_indices = list(chosen)
        for slot, index in enumerate(chosen_indices):
            information_without = information - informations[index]
            other_indices = [*chosen[:slot], *chosen[slot + 1 :]]
            allowed = dict.fromkeys([*list_available(other_indices), index])
            best_index = max(
                allowed,
                key=lambda candidate: _log_determinant(
                    information_without + informations[candidate]
                ),
            )
            chosen[slot], information = best_index, information_without + informations[best_index]
        if chosen == chosen_indices:
            break
    return tuple(sorted(chosen))


_MAX_EXCHANGE_ROUNDS = 5
"""Upper bound of the rounds in which each chosen stand may be exchanged for a more informative
candidate. Chosen, not tuned."""


def _log_determinant(information: Array) -> float:
    """Return the logarithm (base e) of the absolute determinant of an (n, n) matrix."""
    return float(np.linalg.slogdet(information)[1])


def _make_measured_stands(
    source: str, planned: Sequence[PlannedStand], tool: Tool | None
) -> MeasuredStands:
    """Return planned stands as measured stands, with NaN as the measured joint positions [rad, m].

    Added masses are attached at ``tool``; None leaves them out.
    """
    command = np.array([list(stand.command.values()) for stand in planned])
    loads = {}
    if tool is not None and any(stand.added for stand in planned):
        load_rows = [[stand.added, *tool.offset] if stand.added else [0.0] * 4 for stand in planned]
        loads = {tool.link: np.array(load_rows)}
    return MeasuredStands(
        source=source,
        names=tuple(stand.name for stand in planned),
        joints=tuple(planned[0].command),
        command=command,
        position=np.full(command.shape, np.nan),
        swing=tuple(stand.swing for stand in planned),
        heading=np.array([stand.heading for stand in planned]),
        added=loads,
    )


@check_arguments
def write_plan(plan: StandPlan, path: str | Path, *, force: bool = False) -> None:
    """Write a plan as a CSV file for ``read_stands``. The measured positions are empty.

    Args:
        plan: Plan.
        path: Output file.
        force: Whether to replace a file that is not a plan. Plans with measurements are never
            replaced.

    Raises:
        OutputError: If the file cannot be written or must not be replaced.
    """
    with write_atomically(Path(path), PLAN_KIND, force=force) as file:
        content = format_stands(_make_measured_stands(plan.name, plan.stands, plan.place))
        file.write(content.encode())


# Random stands that the servos hold in spite of uncertain parameters.

_TRIES_PER_STAND = 8
"""Upper bound of random stand tasks per requested stand. Chosen, not tuned."""

_MAX_FAILED_TRIES = 24
"""Number of random stand tasks after which the search ends if none of the tasks gave a stand. Each
failure shrinks the range of the random values (`_SHRINK_FACTOR`). After this number of failures,
the range is 2 %: nearly the default stand. Chosen, not tuned.
"""

_SHRINK_FACTOR, _GROW_FACTOR = 0.85, 1.2
"""Factors on the range of the random values, after a refused and after an accepted stand. The range
is at most 1. The range stays about constant if 47 % of the stands are accepted. Chosen, not tuned.
"""

_MAX_UTILISATION = 0.6
"""Largest accepted ratio of motor torque to torque limit in a planned stand. Random stands with a
larger ratio are refused, since a stand lasts minutes. Chosen, not tuned.
"""

_MIN_HEIGHT_RATIO, _MAX_HEIGHT_RATIO = 0.75, 1.1
"""Bounds of the base height, as fractions of the base height in the default stand. Chosen, not
tuned."""

_MAX_TILT = 0.25
"""Largest absolute roll and pitch [rad] of the base in a proposed stand. Chosen, not tuned."""

_MAX_HINGE_TRAVEL = math.pi / 2
"""Largest accepted difference [rad] of a hinge from the start pose (`Robot.home`) in a stand.
A stand in another IK branch cannot be commanded after a stand in the first branch while the feet
are on the ground. Measured on 46 random stands of ANYmal C: at most 0.63 rad in the branch of the
start pose, at least 2.4 rad in other branches; on 36 stands of Pupper v3: at most 1.1 rad.
"""

_MAX_STEP_RATIO = 0.15
"""Upper bound of the absolute random displacement of a foot from its default position, along x and
along y, as a fraction of the base height in the default stand. Chosen, not tuned."""

_MIN_LIFT_RATIO = 0.15
"""Lower bound of a swing foot's height, as a fraction of the base height in the default stand.
Chosen, not tuned."""

_LIFTED_PROBABILITY = 0.4
"""Probability that a random stand task has a foot in the air, for robots with at least four feet.
Chosen, not tuned."""

_MAX_REQUIRED_CLEARANCE = 0.005
"""Upper bound of the clearance [m] between links that planned stands require. Chosen, not tuned.
"""

_CLEARANCE_FRACTION = 0.5
"""Clearance between links that planned stands require, as a fraction of the clearance in the
nominal stand. It applies if the product is less than `_MAX_REQUIRED_CLEARANCE`: thighs may be close
to the body. Chosen, not tuned.
"""

_COM_MARGIN_RATIO = 0.05
"""Lower bound of the CoM margin that planned stands require, as a fraction of the base height in
the default stand. Chosen, not tuned."""


class RandomStands:
    """Generator of random stands that the servos hold, as candidates for a plan of measurements.

    The stands have these properties:

    - reachable, balanced, and within 60 % of the known torque limits
    - each hinge within `_MAX_HINGE_TRAVEL` of the start pose: no change of the IK branch
    - free of self-collision, if the nominal stand is free of self-collision
    - distance of each joint from the limits at least three standard deviations of an encoder
      offset, because a joint at a stop cannot be detected
    - CoM margin at least one standard deviation of the horizontal CoM position, and at least 5 % of
      the base height in the default stand. If this margin is not reachable, 5 % of the height is
      sufficient.

    Args:
        robot: Robot with a free base and feet.
        rng: Random generator.
        kp: Servo stiffness [N m/rad, N/m], scalar or shape (nu,); the model's by default.
        priors: Priors of the robot's parameters.

    Raises:
        ConfigurationError: If a prior of an encoder offset, mass or CoM matches no parameter.
    """

    def __init__(
        self,
        robot: Robot,
        rng: np.random.Generator,
        kp: ArrayLike | None,
        priors: Sequence[Prior] = (),
    ) -> None:
        self._robot, self._rng, self._kp = robot, rng, kp
        self._is_hinge = np.array([not is_slide(robot, joint) for joint in robot.joint_names])
        self._joint_margin = LIMIT_MARGIN_STDS * _get_offset_std(robot, priors)
        self._com_margin = compute_com_std(robot, priors)
        self._clearance = _compute_clearance(robot)
        # A swing foot must stay in the air in spite of servo sag and encoder offsets.
        lowered = _compute_sag(robot, kp) + self._joint_margin * robot.stand_height
        self._swing_height = max(_MIN_LIFT_RATIO * robot.stand_height, lowered)
        self._range_scale, self._num_found = 1.0, 0
        self._refusal_counts: Counter[str] = Counter()

    def draw_stands(self, count: int) -> list[tuple[Stand, SteadyState]]:
        """Draw up to ``count`` random stands that the servos hold, with the steady states.

        Fewer stands are returned if too many random tasks have no stand.
        """
        stands: list[tuple[Stand, SteadyState]] = []
        for num_tries in range(_TRIES_PER_STAND * count):
            if len(stands) == count or (num_tries == _MAX_FAILED_TRIES and not stands):
                break
            report_progress("stands", len(stands), count)
            stand = self._solve_task(self._draw_task())
            self._range_scale = min(
                1.0, self._range_scale * (_SHRINK_FACTOR if stand is None else _GROW_FACTOR)
            )
            stands += [] if stand is None else [stand]
        self._num_found = len(stands)
        return stands

    def explain_shortage(self, requested: int) -> Diagnostic:
        """Return the most frequent reason for which random stand tasks were refused.

        ``requested`` is the number of stands that were requested, for the message.
        """
        code = max(self._refusal_counts, key=lambda code_name: self._refusal_counts[code_name])
        if code == "too-few-in-reach":
            offset_margin = Quantity(self._joint_margin, "rad")
            return diagnose(
                "too-few-in-reach", found=self._num_found, wanted=requested, off=offset_margin
            )
        if code == "too-few-within-limits":
            return diagnose("too-few-within-limits", found=self._num_found, wanted=requested)
        if code == "too-few-in-one-branch":
            return diagnose("too-few-in-one-branch", found=self._num_found, wanted=requested)
        return diagnose("too-few-are-held", found=self._num_found, wanted=requested)

    def _draw_task(self) -> StandTask:
        """Draw a stand task with random height, tilt and foot positions, and maybe a swing foot."""
        rng, height, feet = self._rng, self._robot.stand_height, list(self._robot.feet)
        swing = {}
        if len(feet) > 3 and rng.random() < _LIFTED_PROBABILITY:
            swing = {feet[rng.integers(len(feet))]: self._swing_height}

        def draw_pair(limit: float) -> tuple[float, float]:
            """Draw two numbers, each uniform within the scaled range +-``limit``."""
            first, second = self._range_scale * rng.uniform(-limit, limit, 2)
            return float(first), float(second)

        height_change = rng.uniform(_MIN_HEIGHT_RATIO - 1, _MAX_HEIGHT_RATIO - 1)
        roll, pitch = draw_pair(_MAX_TILT)
        return StandTask(
            height=height * (1 + self._range_scale * height_change),
            roll=roll,
            pitch=pitch,
            swing=swing,
            foot_offsets={foot: draw_pair(_MAX_STEP_RATIO * height) for foot in feet},
            com="inside",
            com_margin=max(self._com_margin, _COM_MARGIN_RATIO * height),
            self_clearance=self._clearance,
            joint_margin=self._joint_margin,
        )

    def _solve_task(self, task: StandTask) -> tuple[Stand, SteadyState] | None:
        """Return the stand of a task and the steady state with feed-forward torques.

        None, and the reason is counted, if the stand is not suited.
        """
        robot, smaller_margin = self._robot, _COM_MARGIN_RATIO * self._robot.stand_height
        try:
            try:
                stand = solve_stand(robot, task, explain=False)
            except PupperAnalysisError:
                stand = solve_stand(robot, replace(task, com_margin=smaller_margin), explain=False)
        except PupperAnalysisError:
            self._refusal_counts["too-few-in-reach"] += 1
            return None
        if (np.abs(stand.qpos[7:] - robot.home[7:])[self._is_hinge] > _MAX_HINGE_TRAVEL).any():
            self._refusal_counts["too-few-in-one-branch"] += 1
            return None
        try:
            sagged = steady_state(robot, stand, kp=self._kp, feedforward=True)
        except PupperAnalysisError:
            self._refusal_counts["too-few-are-held"] += 1
            return None
        same_feet = set(sagged.stance_feet) == set(stand.stance_feet)
        if sagged.failures or not same_feet:
            self._refusal_counts["too-few-are-held"] += 1
            return None
        if (np.abs(sagged.joint_torques) > _MAX_UTILISATION * robot.effort_limits).any():
            self._refusal_counts["too-few-within-limits"] += 1
            return None
        return stand, sagged


def _compute_sag(robot: Robot, kp: ArrayLike | None) -> float:
    """Return the height [m] that the base loses on its servos in the default stand, at least 0.

    The servos have no feed-forward. The result is 0 if no equilibrium is found.
    """
    try:
        stand = solve_stand(robot, explain=False)
        return float(max(0.0, stand.qpos[2] - steady_state(robot, stand, kp=kp).qpos[2]))
    except PupperAnalysisError:
        return 0.0


def _compute_clearance(robot: Robot) -> float | None:
    """Return the clearance [m] between links that all stands of a plan must keep.

    None, for example, if links overlap in the nominal stand.
    """
    try:
        clearance = solve_stand(robot, StandTask(self_clearance=0.0), explain=False).self_clearance
    except PupperAnalysisError:  # overlapping shapes
        return None
    return (
        None
        if clearance is None
        else min(_MAX_REQUIRED_CLEARANCE, _CLEARANCE_FRACTION * clearance.distance)
    )


def _get_offset_std(robot: Robot, priors: Sequence[Prior]) -> float:
    """Return the largest prior standard deviation of an encoder offset [rad, m]; 0 if known."""
    offsets = [("offset", name, "", 0.0) for name in robot.joint_names]
    offset_priors = [prior for prior in priors if prior.kind == "offset"]
    return max((parameter.width for parameter in apply_priors(offsets, offset_priors)), default=0.0)


def compute_com_std(robot: Robot, priors: Sequence[Prior]) -> float:
    """Compute the standard deviation [m] of the robot's CoM position before any measurement.

    The result is the larger of the standard deviations of x and y in the base frame, at the nominal
    joint positions. Bodies without a prior of mass or CoM in ``priors`` have the default prior.

    Raises:
        ConfigurationError: If a prior of a mass or CoM position matches no link.
    """
    inertial_priors = [prior for prior in priors if prior.kind in ("mass", "com")]
    prior_posterior = Posterior.from_prior(
        ParameterTable(apply_priors(list_inertials(robot), inertial_priors))
    )
    return max(estimate.std for estimate in list(estimate_com(robot, prior_posterior))[:2])
