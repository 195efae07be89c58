"""Find the best stance of a robot for an objective, and simulate the stance.

`best_stance` optimises the base pose and the foot positions. `study_best` also simulates the result
as ``stand`` does, and, unless a payload is sought, tries worse stances if the best stance fails.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import ClassVar

from numpy.typing import ArrayLike

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import (
    ConfigurationError,
    NoEquilibriumError,
    NotSettlingError,
    StaticsInfeasibleError,
)
from pupper_analysis.base.results import Result, Tabular
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.tool import FramePoint
from pupper_analysis.robot.touching import with_contacts
from pupper_analysis.stance.soft_ground import solve_stand_as_simulated
from pupper_analysis.stance.stand import Stand, solve_stand
from pupper_analysis.stance.task import StandTask
from pupper_analysis.stance.workspace import Interval, get_coordinate_unit
from pupper_analysis.tools.best.search import EvaluatedStance, Objective, StanceSearch
from pupper_analysis.tools.best.space import ActiveBound
from pupper_analysis.tools.payload.limit import PayloadLimit, payload_limit
from pupper_analysis.tools.stand.stance import Stance, simulate_stance, study_stance

MIN_IMPROVEMENT = 1e-3
"""Improvement of the objective by a search, relative to the initial value, above which the best
stance counts as better than the initial stance. Smaller improvements are not visible in the printed
numbers. Chosen, not tuned."""


@dataclass(frozen=True, eq=False)
class BestStance(Tabular):
    """Best stance of a search.

    Attributes:
        objective: Objective of the search.
        stand: Stand of the best stance, on rigid ground.
        value: Objective of ``stand``: peak torque / effort limit on MuJoCo's soft ground [1], CoM
            margin [m], or payload [kg].
        nominal_value: Objective of ``nominal``, with the meaning and unit of ``value``.
        nominal: Stand of the initial task (by default the nominal stand).
        payload: Payload limit of ``stand``; None for the other objectives.
        coordinates: Coordinates of the best stance [m or rad] in world axes: base height; x and y
            of the base from the centre of the displaced feet; roll, pitch, yaw; displacement
            (``FR x``, ``FR y`` ...) of each free foot from the position in the initial task.
        bounds: Lower and upper bound of each coordinate in the search [m or rad].
        evaluations: Number of stances that the search tried.
        active_bounds: Bounds of the search that the best stance reaches. They limit the objective,
            unless it is the payload, whose limit ``payload`` states.
    """

    _key_fields: ClassVar[tuple[str, ...]] = ("objective", "value", "nominal_value")

    objective: Objective
    stand: Stand
    value: float = field(metadata={"unit": "varies"})
    nominal_value: float = field(metadata={"unit": "varies"})
    nominal: Stand
    payload: PayloadLimit | None
    coordinates: dict[str, float] = field(metadata={"unit": "m or rad"})
    bounds: dict[str, Interval]
    evaluations: int
    active_bounds: tuple[ActiveBound, ...] = ()

    @property
    def improved(self) -> bool:
        """True if ``value`` is better than ``nominal_value`` by more than `MIN_IMPROVEMENT`."""
        gain = self.value - self.nominal_value
        if self.objective is Objective.UTILISATION:
            gain = -gain
        return gain > MIN_IMPROVEMENT * abs(self.nominal_value)

    @property
    def unit(self) -> str:
        """Unit of ``value`` and ``nominal_value``: 1 for the utilisation."""
        return _OBJECTIVE_UNITS[self.objective]

    def _field_units(self) -> dict[str, dict[str, str]]:
        """Return the unit of each coordinate."""
        units = {name: get_coordinate_unit(name) for name in self.coordinates}
        return {"coordinates": units, "bounds": units}

    def _columns(self) -> dict[str, list[object]]:
        """Return {column: values} of a table with a row per coordinate, and the unit of the row."""
        return {
            "coordinate": [*self.coordinates],
            "value": [*self.coordinates.values()],
            "low": [self.bounds[name].low for name in self.coordinates],
            "high": [self.bounds[name].high for name in self.coordinates],
            "unit": [get_coordinate_unit(name) for name in self.coordinates],
        }


_OBJECTIVE_UNITS = {Objective.UTILISATION: "1", Objective.MARGIN: "m", Objective.PAYLOAD: "kg"}
"""{objective: unit of the value}."""


@check_arguments
def best_stance(
    robot: Robot,
    objective: Objective | str = Objective.UTILISATION,
    *,
    task: StandTask | None = None,
    point: FramePoint = (0.0, 0.0, 0.0),
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
) -> BestStance:
    """Optimise the base pose and the foot positions of a stance.

    The task specifies all other requirements: ground, swing feet, margins and ``ik_seed``. Feet
    with a position in ``feet`` remain there. The base pose determines the CoM, which must keep the
    task's ``com_margin`` inside the support polygon.

    Bounds of the coordinates, widened to contain the initial task:

    - Base x, y and height: reachable interval around the initial stand; for the height without a
      fraction ``HEIGHT_RESERVE`` at either end.
    - Roll, pitch, yaw: within ``MAX_BASE_ROTATION`` of the initial task.
    - Feet: up to ``MAX_OUTWARD_STEP`` times the largest reachable height, along x and along y;
      inwards also up to ``MAX_INWARD_STEP`` times the smallest distance of a free foot from the
      centre of the feet along the same axis. If the feet are in line with this centre, as the feet
      of a biped along x, both directions are outward.

    The smallest singular value of the Jacobian of each contact point must be at least
    ``MIN_SINGULAR_VALUE_RATIO`` times the initial value, because stretched legs need little torque
    but buckle. Parts that are apart in the initial stand must not touch each other or the ground;
    contacts between feet, and of parts with a step of the ground, are not checked.

    Method: the objective is the maximum of smooth functions, so it has kinks, at which descent on
    the objective alone stalls. Therefore a common upper bound t of these functions is a variable of
    a smooth nonlinear program, solved by SLSQP from the initial task and from the best of Latin
    hypercube samples. The random seed is fixed.

    For a payload, the search uses the first-order limit of `SmallPayload`; then `payload_limit`
    computes the limit.

    Args:
        robot: Robot with a floating base, without loops, couplings, welds or grips.
        objective: Objective, or name, such as ``"margin"``.
        task: Initial task, with all requirements that the search keeps. Default: the nominal stand.
        point: Position of the payload: (x, y, z) [m] in the base frame, (frame, x, y, z) [m] in the
            frame of a link, site, body or geom, or a `Tool`.
        kp: Servo stiffness for the payload [N m/rad, N/m], scalar or shape (nu,). Default: the
            model's.
        kd: Servo damping for the payload [N m s/rad, N s/m], scalar or shape (nu,). Default: the
            model's.

    Returns:
        Best stance; the initial task if the search finds no better stance.

    Raises:
        ConfigurationError: If an argument is invalid, the robot cannot stand, or effort limits are
            missing or zero, for example.
        UnknownNameError: If the robot has no frame with the name in ``point``, or no foot, joint or
            contact that the task names.
        ModelError: If the objective is the payload, and the model has no position servos while kp
            and kd are not both given, for example.
        StanceUnreachableError: If the initial task is out of reach.
        StaticsInfeasibleError: If no contact forces balance the initial task.
        NotSettlingError: If the penetration depths of the feet do not converge.
        NoEquilibriumError: If the objective is the payload, and the servos do not hold the initial
            task.
    """
    search = _run_search(robot, objective, task, point, kp)
    return _make_best_stance(search, search.best, point, kp, kd)


def _run_search(
    robot: Robot,
    objective: Objective | str,
    task: StandTask | None,
    point: FramePoint,
    kp: ArrayLike | None,
) -> StanceSearch:
    """Run the search of `best_stance`, with its arguments, and return the finished search."""
    robot = with_contacts(robot, task.contacts) if task is not None else robot
    if not robot.fixed_parts:  # first: the error for an arm names hold, not the coupled fingers
        robot.check_floating()
    robot.check_tree("the best stance")
    search = StanceSearch(robot, _parse_objective(objective), task, point, kp)
    search.run()
    return search


def _make_best_stance(
    search: StanceSearch,
    best: EvaluatedStance,
    point: FramePoint,
    kp: ArrayLike | None,
    kd: ArrayLike | None,
) -> BestStance:
    """Create the result of `best_stance` from one evaluated stance of a search.

    For a payload, the result is the initial task if its payload limit is larger.
    """
    robot, space, payload = search.robot, search.space, None
    # Solve the task again without the search's initial guesses, which determine redundant joints.
    best = replace(best, stand=solve_stand(robot, best.stand.task))
    if search.objective is Objective.PAYLOAD:
        nominal, payload = (
            payload_limit(robot, stand, point, kp=kp, kd=kd)
            for stand in (space.nominal, best.stand)
        )
        if payload.mass < nominal.mass:  # the first-order limit was inaccurate
            best, payload = search.nominal, nominal
        value, nominal_value = payload.mass, nominal.mass
    else:
        value, nominal_value = (
            _compute_objective(search, stand) for stand in (best.stand, space.nominal)
        )
    return BestStance(
        objective=search.objective,
        stand=best.stand,
        value=value,
        nominal_value=nominal_value,
        nominal=space.nominal,
        payload=payload,
        coordinates=dict(zip(space.names, best.coordinates.tolist(), strict=True)),
        bounds={
            name: Interval(float(low), float(high))
            for name, low, high in zip(space.names, space.low, space.high, strict=True)
        },
        evaluations=search.evaluations,
        active_bounds=tuple(space.list_active_bounds(best.coordinates, best.stand)),
    )


def _compute_objective(search: StanceSearch, stand: Stand) -> float:
    """Compute the reported value of the objective: peak motor utilisation [1] or CoM margin [m].

    The utilisation is computed on MuJoCo's soft ground, as in the command ``stand``.
    """
    if search.objective is Objective.UTILISATION:
        stand = solve_stand_as_simulated(search.robot, stand)
    return search.compute_objective(stand)


def _parse_objective(value: str) -> Objective:
    """Convert a name to an objective, or raise a ConfigurationError."""
    try:
        return Objective(value)
    except ValueError as error:
        message = diagnose("none-of", value=str(value), known=Objective)
        raise ConfigurationError("objective", message) from error


@dataclass(frozen=True, eq=False)
class BestStudy(Result):
    """Best stance of a search, with a simulation.

    Attributes:
        best: Result of the search.
        stance: Torques, and verdict of the simulation.
    """

    best: BestStance
    stance: Stance

    @property
    def passed(self) -> bool:
        """True if the best stance holds in simulation.

        If the objective is the payload, the stance must also hold with the payload.
        """
        return self.stance.passed and (self.best.payload is None or self.best.payload.passed)


def study_best(
    robot: Robot,
    objective: Objective,
    task: StandTask,
    point: FramePoint = (0.0, 0.0, 0.0),
    *,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
) -> BestStudy:
    """Search for the best stance that holds in simulation.

    If the best stance fails in simulation, or has no equilibrium on soft ground, worse stances
    (`StanceSearch.list_next_best`) are simulated.

    Args:
        robot: Robot with a floating base, without loops, couplings, welds or grips.
        objective: Objective.
        task: Initial task, with all requirements that the search keeps.
        point: Position of the payload: (x, y, z) [m] in the base frame, (frame, x, y, z) [m] in the
            frame of a link, site, body or geom, or a `Tool`.
        kp: Servo stiffness [N m/rad, N/m], scalar or shape (nu,). Default: the model's.
        kd: Servo damping [N m s/rad, N s/m], scalar or shape (nu,). Default: the model's.

    Returns:
        First stance that holds; the best stance if none of the simulated stances holds.

    Raises:
        StanceUnreachableError: If the initial task is out of reach.
        StaticsInfeasibleError: If no contact forces balance the initial task.
    """
    search = _run_search(robot, objective, task, point, kp)
    first: BestStudy | None = None
    for stance in (search.best, *search.list_next_best()):
        try:
            if first is None:
                best = _make_best_stance(search, stance, point, kp, kd)
                study = BestStudy(best, study_stance(robot, best.stand, kp=kp, kd=kd))
            else:
                stand = solve_stand(robot, stance.stand.task)
                simulated = simulate_stance(robot, stand, kp=kp, kd=kd)
                if not simulated.passed:  # before the payload limit, which takes seconds
                    continue
                best = _make_best_stance(search, stance, point, kp, kd)
                study = BestStudy(best, simulated.complete())
        except (StaticsInfeasibleError, NotSettlingError, NoEquilibriumError):
            if first is None and stance is search.nominal:
                raise
            continue
        if study.passed:
            return study
        first = first or study
    assert first is not None
    return first
