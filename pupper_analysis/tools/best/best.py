"""The best stance: how high, how wide and how far forward a robot stands best; and if it holds."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from numpy.typing import ArrayLike

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.results import Result
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.tool import Place
from pupper_analysis.robot.touching import touching
from pupper_analysis.stance.soft_ground import solve_stand_as_simulated
from pupper_analysis.stance.stand import Stand, solve_stand
from pupper_analysis.stance.task import StandTask
from pupper_analysis.stance.workspace import Interval
from pupper_analysis.tools.best.search import EvaluatedStance, Objective, StanceSearch
from pupper_analysis.tools.payload.limit import PayloadLimit, payload_limit
from pupper_analysis.tools.stand.stance import Stance, study_stance


@dataclass(frozen=True, eq=False)
class BestStance(Result):
    """The best stance found.

    Attributes:
        objective: What it is the best in.
        stand: How the robot stands in it.
        value: The objective's value there: peak torque / effort limit on the simulated ground,
            margin (m), or payload (kg).
        nominal_value: That of the task as it was given (by default the nominal stand).
        nominal: The stand of the task as it was given.
        payload: Of ``stand``, with what binds it, if that is the objective.
        coordinates: {``height`` of the base (m); ``x``, ``y`` of the base from the centre of the
            feet (m); ``roll``, ``pitch``, ``yaw`` (rad); ``FR x``, ``FR y`` ...: each foot's way
            from where the task has it (m)} of the best stance, in world axes.
        bounds: Between which values of each coordinate it was sought.
        evaluations: Stances tried.
    """

    objective: Objective
    stand: Stand
    value: float = field(metadata={"unit": "m or kg"})
    nominal_value: float = field(metadata={"unit": "m or kg"})
    nominal: Stand
    payload: PayloadLimit | None
    coordinates: dict[str, float] = field(metadata={"unit": "m or rad"})
    bounds: dict[str, Interval]
    evaluations: int


@check_arguments
def best_stance(
    robot: Robot,
    objective: Objective | str = Objective.UTILISATION,
    *,
    task: StandTask | None = None,
    point: Place = (0.0, 0.0, 0.0),
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
) -> BestStance:
    """Searches for the best stance: the base's height, place and turn, and where each foot is.

    All else is the task's: its ground, swing feet, margins and ik_seed; ``feet`` that it places
    stay there. The com is where the base takes it, inside the support polygon with at least
    ``com_margin``.

    The bounds are: of the height, the reachable ones less ``HEIGHT_RESERVE`` at either end; of the
    base's other coordinates, how far it can go from the task with the feet planted and the legs
    bent as they are, turns by at most ``MAX_BASE_ROTATION``; of each foot, ``MAX_OUTWARD_STEP`` of
    the greatest height outwards and no more than ``MAX_INWARD_STEP`` of the least distance from
    the middle inwards. Legs keep ``MIN_SINGULAR_VALUE_RATIO``: stretched ones would win, needing
    no torque. A stance is also refused if it has parts touching each other or the ground (not: its
    steps) that do not in the task's.

    The best of a stance is the least of the greatest of many smooth functions: a kink, at which
    descents that see one number get stuck. So the common bound of all these functions is itself
    a variable, and they, and what may not be used up, are constraints of a smooth programme
    (SLSQP). It starts at the nominal stand and at the best of Latin samples, with the feet moving
    together (and, if nothing in the task tells left from right, without y, roll and yaw); from each
    of the best of these ends it goes on with all coordinates free. It is the same every time, and
    never worse than the nominal stand.

    Payload: the search goes by first order (``SmallPayload``): the least of the masses at which a
    motor saturates, a foot lets go, the servos buckle, and feet have sunk so deep that another part
    touches the ground, all in closed form. The stance found and the task's own then have their true
    limit found (``payload_limit``), and the better one is returned. Legs that are almost stretched
    need little torque, and buckle: for v3 the stance that the motors like best bears 3.7 kg, the
    nominal one 6.1.

    Args:
        robot: A robot with a floating base.
        objective: What shall be best; or its name, such as ``"margin"``.
        task: Where the search begins, and all that is not searched over; the nominal stand by
            default.
        point: Where the payload is, as in ``with_payload``.
        kp: Servo stiffness for the payload (N m/rad), one or (nu,); the model's own by default.
        kd: Servo damping for the payload (N m s/rad), likewise.

    Returns:
        The best stance found.

    Raises:
        ConfigurationError: If an argument is out of its range, or the robot cannot stand, or no
            motor has an effort limit that it could use, or one has a limit of zero.
        ModelError: If the payload is sought, the model has no position servos, and kp and kd are
            not both given.
        StanceUnreachableError: If the task itself is out of reach.
        StaticsInfeasibleError: If the task itself cannot be held.
        NoEquilibriumError: If the payload is sought, and servos do not hold the task itself.
    """
    search = _search(robot, objective, task, point, kp)
    return _describe(search, search.best, point, kp, kd)


def _search(
    robot: Robot,
    objective: Objective | str,
    task: StandTask | None,
    point: Place,
    kp: ArrayLike | None,
) -> StanceSearch:
    """Run the search of ``best_stance``."""
    robot = touching(robot, task.contacts) if task is not None else robot
    robot.check_tree("the best stance")
    search = StanceSearch(robot, _objective(objective), task, point, kp)
    search.run()
    return search


def _describe(
    search: StanceSearch,
    best: EvaluatedStance,
    point: Place,
    kp: ArrayLike | None,
    kd: ArrayLike | None,
) -> BestStance:
    """Return the result for one of the stances of a search."""
    robot, space, payload = search.robot, search.space, None
    # As whoever types it has it: where joints are to spare, a search has them from what was near.
    best = replace(best, stand=solve_stand(robot, best.stand.task))
    if search.objective is Objective.PAYLOAD:
        nominal, payload = (
            payload_limit(robot, stand, point, kp=kp, kd=kd)
            for stand in (space.nominal, best.stand)
        )
        if payload.mass < nominal.mass:  # first order was wrong about it
            best, payload = search.nominal, nominal
        value, nominal_value = payload.mass, nominal.mass
    else:
        value, nominal_value = (_value(search, stand) for stand in (best.stand, space.nominal))
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
    )


def _value(search: StanceSearch, stand: Stand) -> float:
    """Return the objective of a stand; the utilisation on the simulated ground, as by ``stand``."""
    if search.objective is Objective.UTILISATION:
        stand = solve_stand_as_simulated(search.robot, stand)
    return search.value(stand)


def _objective(value: str) -> Objective:
    try:
        return Objective(value)
    except ValueError as error:
        message = diagnose("none-of", value=str(value), known=Objective)
        raise ConfigurationError("objective", message) from error


@dataclass(frozen=True, eq=False)
class BestStudy(Result):
    """The best stance that a search finds, and what is found out about it.

    Attributes:
        best: How it was found.
        stance: What it costs, and whether it holds.
    """

    best: BestStance
    stance: Stance

    @property
    def passed(self) -> bool:
        """Whether it holds, with its payload too if that is the objective."""
        return self.stance.passed and (self.best.payload is None or self.best.payload.passed)


def study_best(
    robot: Robot,
    objective: Objective,
    task: StandTask,
    point: Place = (0.0, 0.0, 0.0),
    *,
    kp: ArrayLike | None = None,
    kd: ArrayLike | None = None,
) -> BestStudy:
    """Search for the best stance that holds in simulation.

    If the best stance does not hold, next best stances are simulated, the given task last. If none
    holds, the best one is returned. A payload is limited by its own simulation.

    Args:
        robot: The robot.
        objective: What shall be best; or its name, such as ``"margin"``.
        task: Where the search begins, and all that is not searched over.
        point: Where the payload is, as in ``with_payload``.
        kp: Servo stiffness (N m/rad), one or (nu,); the model's own by default.
        kd: Servo damping (N m s/rad), one or (nu,); the model's own by default.

    Raises:
        StanceUnreachableError: If the task itself is out of reach.
        StaticsInfeasibleError: If the task itself slides or tips.
        ConfigurationError: If the task, or another argument, makes no sense for the robot.
        ModelError: If the robot has no position servos, and kp and kd are not both given.
        NoEquilibriumError: If the payload is sought, and servos do not hold the task itself.
    """
    search = _search(robot, objective, task, point, kp)
    best = _describe(search, search.best, point, kp, kd)
    study = BestStudy(best, study_stance(robot, best.stand, kp=kp, kd=kd))
    if study.passed or search.objective is Objective.PAYLOAD:  # a payload is simulated itself
        return study
    for stance in search.next_best():
        best = _describe(search, stance, point, kp, kd)
        following = BestStudy(best, study_stance(robot, best.stand, kp=kp, kd=kd))
        if following.passed:
            return following
    return study
