"""Smallest stiffness of the servos with which a robot stands without feed-forward.

`minimum_stiffness` bisects the stiffness. From a known equilibrium, one Newton solve usually finds
the equilibrium of a similar stiffness (continuation, Allgower and Georg 1990). Therefore only a few
stiffnesses, for example the first stiffness, need the path with gradual removal of the feed-forward
(`HomotopyPath`).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from pupper_analysis.base.arguments import check_arguments, real_array
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic, Quantity, diagnose
from pupper_analysis.base.errors import ConfigurationError, NoEquilibriumError, NoStiffnessError
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import MIN_STIFFNESS
from pupper_analysis.robot.stability import HOLD_DURATION
from pupper_analysis.robot.touching import with_contacts
from pupper_analysis.stance.sag.equilibrium import Anchor, EquilibriumScales, SlipLaw, Solution
from pupper_analysis.stance.sag.steady_state import (
    CREEP_STEPS,
    HomotopyPath,
    SteadyState,
    check_steady_state_request,
    collect_steady_state,
    describe_sag_failure,
    find_sag_failure,
    make_homotopy_path,
    simulate_creep,
)
from pupper_analysis.stance.stand import Stand

HIGHEST_KP = 2500.0
"""Upper bound of the servo stiffness kp up to which `minimum_stiffness` searches a bracket, in
units of `EquilibriumScales.stiffness` (robot weight x height). For Pupper v3 the bound is 1,600
times the kp of its servos (5 N m/rad). Chosen, not tuned."""

_FIRST_KP = 4.0
"""First servo stiffness kp that `minimum_stiffness` tests, in units of
`EquilibriumScales.stiffness` (robot weight x height). Measured: v3, Go2 and T1 need 0.5 to 2.1
units. Smaller values take longer, since the feed-forward is then removed in many steps."""

_LEAST_KP = 1 / 4096
"""Lower bound of the servo stiffness kp down to which `minimum_stiffness` searches a bracket, in
units of `EquilibriumScales.stiffness` (robot weight x height). Chosen, not tuned."""

_LEAST_STEP = 0.1
"""Smallest step of ln(kp) with which an equilibrium is continued to another kp: if a step of about
this length fails, the equilibrium counts as lost. Chosen, not tuned."""

_FIRST_CREEP_RATIO = 0.04
"""Relative excess over the largest kp without a static equilibrium, at which creep is simulated
first. Measured: creep raises the least kp by 4 to 8 % (original, Go2, v3)."""

_MAX_PREDICTIONS = 4
"""Upper bound of the number of creep simulations after which `_bisect_stiffness` halves the bracket
instead of predicting kp. Chosen, not tuned.
"""

_MAX_PREDICTED_RATIO = 1.1
"""Upper bound of a predicted least kp, relative to the kp whose creep was simulated, up to which
`estimate_minimum_stiffness` uses the prediction. Measured: for Aliengo the ratio is 1.7, and the
prediction 30 % above `minimum_stiffness`."""

_ESTIMATE_TOLERANCE = 0.02
"""Relative width to which `estimate_minimum_stiffness` brackets the least kp of the static
equilibrium. Chosen for results with two digits."""

_MIN_DURATION = HOLD_DURATION / CREEP_STEPS
"""Lower bound of the time [s] by which `_predict_stiffness` divides: the longest backward Euler
step in `simulate_creep`."""


@check_arguments
def minimum_stiffness(
    robot: Robot,
    stand: Stand,
    *,
    feet: SlipLaw = "pinned",
    tolerance: float = 0.01,
    ratios: ArrayLike | None = None,
) -> float:
    """Find the smallest servo stiffness kp for a stand without feed-forward, by bisection.

    The robot stands if the result of `steady_state` has no failures, and a free base without welds
    or grips keeps more than half of the stand's height. Examples of failures are a swing foot on
    the ground, and creep that ends the equilibrium within 12 s.

    Args:
        robot: Robot.
        stand: Stand.
        feet: Slip law: ``pinned`` feet hold tangential forces up to the limit of their friction,
            ``sliding`` feet hold none.
        tolerance: Relative tolerance of the result, in (0, 1).
        ratios: Stiffness of each joint relative to the result, shape (nu,), not negative and not
            all zero. Default: 1, the same kp at all joints.

    Returns:
        kp [N m/rad] with which the robot stands: the upper end of the bracket. If the robot stands
        with all tested kp, the smallest tested kp.

    Raises:
        ConfigurationError: If an argument is invalid, or the robot cannot stand.
        UnknownNameError: If the stand has feet that the robot lacks.
        ModelError: If a joint has no motor, for example.
        StaticsInfeasibleError: If no contact forces balance the stand.
        NoStiffnessError: If the robot does not stand with any tested kp up to `HIGHEST_KP` times
            ``EquilibriumScales.stiffness``; contains the reason.
    """
    if not 0 < tolerance < 1:
        refused = diagnose("not-between", given=tolerance, low=0, high=1)
        raise ConfigurationError("tolerance", refused)
    search, low, high = _bracket_stiffness(robot, stand, feet, ratios)
    while not search.stands(high):
        low, high = high, 2 * high
    while low > 0:
        found, high = _bisect_stiffness(search, low, high, tolerance)
        if found not in search.lost or not search.follow(found):
            break
        high = found  # continuation has missed the equilibrium that removed feed-forward reaches
        while low == high or search.stands(low):  # continuation may have missed it there, too
            low, high = low / 2, low
            if low < MIN_STIFFNESS:
                return high
    return high


def estimate_minimum_stiffness(
    robot: Robot, stand: Stand, *, ratios: ArrayLike | None = None
) -> float:
    """Estimate the smallest servo stiffness kp [N m/rad] for a stand without feed-forward.

    A prediction within `_MAX_PREDICTED_RATIO` replaces the bisection of `minimum_stiffness` with
    creep. Measured: 0 to 5 % above `minimum_stiffness` for T1, G1, v3-long-leg, and v3 with 3.2 kg;
    within 2 % for v3, original, Go2, ANYmal C, HyQ, Laikago and Solo12.

    Args:
        robot: Robot.
        stand: Stand.
        ratios: Stiffness of each joint relative to the result, shape (nu,), not negative and not
            all zero. Default: 1, the same kp at all joints.

    Raises:
        ConfigurationError: If ``ratios`` is invalid, or the robot cannot stand.
        UnknownNameError: If the stand has feet that the robot lacks.
        ModelError: If a joint has no motor, for example.
        StaticsInfeasibleError: If no contact forces balance the stand.
        NoStiffnessError: If the robot does not stand with any tested kp up to `HIGHEST_KP` times
            ``EquilibriumScales.stiffness``; contains the reason.
    """
    search, low, high = _bracket_stiffness(robot, stand, "pinned", ratios)
    if low == 0.0:
        return high
    grid = _Grid(low, high, _ESTIMATE_TOLERANCE)
    start = grid[_find_static_end(search, grid)]
    tried = min((1 + _FIRST_CREEP_RATIO) * start, high)
    lasts = search.measure_duration(tried)
    if math.isinf(lasts):
        return tried
    predicted = _predict_stiffness(start, tried, lasts)
    is_near = predicted <= _MAX_PREDICTED_RATIO * tried
    return predicted if is_near else minimum_stiffness(robot, stand, ratios=ratios)


def _bracket_stiffness(
    robot: Robot, stand: Stand, feet: SlipLaw, ratios: ArrayLike | None
) -> tuple[_StiffnessSearch, float, float]:
    """Bracket the smallest servo stiffness kp [N m/rad] of a stand, by steps of a factor 2.

    Returns:
        Tuple (search, low, high) with high = 2 low. The robot does not stand with kp = low, but
        with kp = high before creep. If the robot stands with all tested kp, low is 0.
    """
    robot = with_contacts(robot, stand.task.contacts)
    check_steady_state_request(robot, stand, feet, 0.0)
    search = _StiffnessSearch(robot, stand, _check_ratios(robot, ratios), feet)
    unit = EquilibriumScales.from_stand(robot, stand).stiffness
    low, high = 0.0, _FIRST_KP * unit
    while not search.stands(high):
        low, high = high, 2 * high
        if high > HIGHEST_KP * unit and search.problem is not None:
            raise NoStiffnessError(robot.name, low, search.problem)
    while low == 0.0:
        if high / 2 < max(_LEAST_KP * unit, MIN_STIFFNESS):
            return search, low, high
        if search.stands_at_first(high / 2):
            high /= 2
        else:
            low = high / 2
    return search, low, high


class _Grid:
    """Division of a stiffness bracket into 2^n equal cells with a bounded width.

    Args:
        low: Lower end of the bracket [N m/rad].
        high: Upper end of the bracket [N m/rad].
        tolerance: Largest width of a cell, relative to ``low``.

    Attributes:
        count: Number of cells.
    """

    def __init__(self, low: float, high: float, tolerance: float) -> None:
        self._low, self._high = low, high
        power = max(0, math.ceil(math.log2((high - low) / (tolerance * low))))
        self.count: int = 1 << power

    def __getitem__(self, index: int) -> float:
        """Return the grid value [N m/rad] of an index, 0 (lower end) to ``count`` (upper end)."""
        return self._low + (self._high - self._low) * index / self.count

    def find_index(self, value: float) -> int:
        """Return the index of the smallest grid value that is at least ``value`` [N m/rad].

        The index may be out of range.
        """
        return math.ceil((value - self._low) / (self._high - self._low) * self.count)


def _find_static_end(search: _StiffnessSearch, grid: _Grid) -> int:
    """Bisect for the largest grid kp with which a robot does not stand even before creep.

    Returns:
        Index of this kp; 0 if the robot stands with all tested kp.
    """
    first, last = 0, grid.count
    while last - first > 1:
        middle = (first + last) // 2
        stands = search.stands_at_first(grid[middle])
        first, last = (first, middle) if stands else (middle, last)
    return first


def _predict_stiffness(start: float, tried: float, lasts: float) -> float:
    """Predict the servo stiffness kp [N m/rad] with which a stand lasts for `HOLD_DURATION`.

    The time for which an equilibrium lasts grows nearly linearly with kp, from zero at the least kp
    of the statics (measured on v3, original and Go2).

    Args:
        start: kp [N m/rad] just below the least kp of the static equilibrium.
        tried: kp with which creep was simulated [N m/rad].
        lasts: Time for which the equilibrium lasts with this kp [s].
    """
    return start + (tried - start) * HOLD_DURATION / max(lasts, _MIN_DURATION)


def _bisect_stiffness(
    search: _StiffnessSearch, low: float, high: float, tolerance: float
) -> tuple[float, float]:
    """Narrow a bracket (low, high) of the smallest kp [N m/rad] with which the robot stands.

    A simulation of creep takes longer than statics. Therefore statics bound kp first, and
    predictions (`_predict_stiffness`) replace midpoints. ``tolerance`` is relative to the upper
    end.
    """
    grid = _Grid(low, high, tolerance)
    static = first = _find_static_end(search, grid)
    last, num_predictions = grid.count, 0
    place = (1 + _FIRST_CREEP_RATIO) * grid[static]
    while last - first > 1:
        if num_predictions >= _MAX_PREDICTIONS:
            place = (grid[first] + grid[last]) / 2
        tried = min(max(grid.find_index(place), first + 1), last - 1)
        lasts = search.measure_duration(grid[tried])
        num_predictions += 1
        if math.isinf(lasts):
            last = tried
        else:
            first = tried
            place = _predict_stiffness(grid[static], grid[tried], lasts)
    # A plain bisection would end with the widest cell that meets the tolerance.
    width = 1
    while 2 * width <= grid.count:
        wider = -(-last // (2 * width)) * 2 * width
        if grid[wider] - grid[wider - 2 * width] > tolerance * grid[wider]:
            break
        first, last, width = wider - 2 * width, wider, 2 * width
    return grid[first], grid[last]


def _check_ratios(robot: Robot, ratios: ArrayLike | None) -> Array:
    """Check the given ratios of joint stiffness, and return an array (nu,); ones for None."""
    if ratios is None:
        return np.ones(robot.nu)
    values = real_array("ratios", ratios)
    if values.shape != (robot.nu,) or not (np.isfinite(values) & (values >= 0)).all():
        raise ConfigurationError("ratios", diagnose("stiffness-ratios", count=robot.nu))
    if not values.any():
        raise ConfigurationError("ratios", diagnose("stiffness-ratios", count=robot.nu))
    return values


class _StiffnessSearch:
    """Test of servo stiffnesses: does the robot stand? A test starts at a known equilibrium.

    Args:
        robot: Robot, with the contacts of the stand.
        stand: Stand.
        ratios: Stiffness of each joint relative to the tested value, shape (nu,).
        feet: Slip law.

    Attributes:
        problem: Reason why the robot does not stand with the value that `follow` tested last; None
            if it stands.
        lost: Values [N m/rad] for which continuation has found no stable equilibrium, since
            `follow` last found that the robot stands.
    """

    def __init__(self, robot: Robot, stand: Stand, ratios: Array, feet: SlipLaw) -> None:
        self._robot, self._stand, self._ratios, self._feet = robot, stand, ratios, feet
        self._path: HomotopyPath | None = None
        self._anchors: dict[str, Anchor] = {}
        self._poses: dict[float, tuple[Solution, SteadyState]] = {}
        self._durations: dict[float, float] = {}
        self.problem: Diagnostic | None = None
        self.lost: set[float] = set()

    def stands(self, value: float) -> bool:
        """Return True if the robot stands without feed-forward, with kp = ``value`` [N m/rad]."""
        return math.isinf(self.measure_duration(value))

    def measure_duration(self, value: float) -> float:
        """Return the time [s] until creep of the feet ends the equilibrium, with kp = ``value``.

        0 if the robot does not stand even before the creep; infinite if the robot stands. Until the
        search has found a kp with which the robot stands, the result is 0 or infinite.
        """
        if self._path is None:
            return math.inf if self.follow(value) else 0.0
        if not self.stands_at_first(value):
            return 0.0
        if value not in self._durations:
            solution, pose = self._poses[value]
            self._set_stiffness(self._path, value, solution)
            self._durations[value] = simulate_creep(self._path, pose)
        return self._durations[value]

    def follow(self, value: float) -> bool:
        """Test kp = ``value`` [N m/rad] from the stand: remove feed-forward, then simulate creep.

        Returns:
            True if the robot stands. The equilibrium is then the initial guess of the next tests.
            False otherwise, with the reason in ``problem``.
        """
        try:
            path = make_homotopy_path(self._robot, self._stand, value * self._ratios, self._feet)
            path.follow(1.0)
        except NoEquilibriumError as error:
            self.problem = error.diagnostic
            return False
        anchors, solution = dict(path.system.anchors), path.solution
        pose = collect_steady_state(path, math.inf)
        self.problem = describe_sag_failure(self._robot, self._stand, pose)
        if self.problem is None and math.isfinite(lasts := simulate_creep(path, pose)):
            self.problem = diagnose("creep-ends-it", after=Quantity(lasts, "s"))
        if self.problem is None:
            self._path, self._anchors = path, anchors
            self._poses, self._durations = {value: (solution, pose)}, {value: math.inf}
            self.lost.clear()
        return self.problem is None

    def stands_at_first(self, value: float) -> bool:
        """Return True if the robot stands with kp = ``value`` [N m/rad], before the feet creep.

        In some cases creep is simulated as well, for example if no equilibrium is known yet.
        """
        if self._path is None:
            return self.follow(value)
        if value in self._poses or value in self._durations:
            return True
        solution = self._follow_path(self._path, value)
        if solution is None:
            self.lost.add(value)
            return False
        if self._path.system.find_violations(solution):  # a contact opens or closes
            kp = value * self._ratios
            if find_sag_failure(self._robot, self._stand, kp=kp, feet=self._feet) is not None:
                return False
            self._durations[value] = math.inf
            return True
        self._path.solution = solution
        pose = collect_steady_state(self._path, math.inf)
        if describe_sag_failure(self._robot, self._stand, pose) is not None:
            return False
        self._poses[value] = solution, pose
        return True

    def _set_stiffness(self, path: HomotopyPath, value: float, solution: Solution) -> None:
        """Set the positive kp to ``value`` [N m/rad] times ratios; restart at ``solution``.

        The creep is reset, and the feed-forward torques are removed.
        """
        path.reset_creep(self._anchors)
        path.system.kp = np.where(path.system.kp > 0, value * self._ratios, 0.0)
        path.solution = solution
        path.remove_feedforward()

    def _follow_path(self, path: HomotopyPath, value: float) -> Solution | None:
        """Find the stable equilibrium with kp = ``value`` [N m/rad] from a known equilibrium.

        The touching contacts stay unchanged. None if steps of ln(kp) become shorter than
        `_LEAST_STEP`.
        """
        at = min(self._poses, key=lambda known: abs(math.log(known / value)))
        solution = self._poses[at][0]
        step = math.log(value / at)
        while at != value:
            last = abs(math.log(value / at)) <= abs(step)
            target = value if last else at * math.exp(step)
            self._set_stiffness(path, target, solution)
            found = path.system.solve(solution, exact=False)
            if found is not None and path.linearise(found)[1] > 0:
                at, solution, step = target, found, 2 * step
            elif abs(step := step / 2) < _LEAST_STEP:
                return None
        return solution
