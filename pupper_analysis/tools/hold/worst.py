"""Find the posture with the largest static torque of each motor.

`worst_postures` returns a torque and a posture for each motor of a robot with a fixed base, a tool
and a payload. The method is a coordinate search from several postures (`TorqueSearch`). Along a
single hinge, the torque is a sinusoid plus a linear term; its maximum has a closed form. Along
slides that move in proportion, the torque is linear. Along other coupled joints the torque is
sampled. The torque is also sampled if there are other forces at rest, for example tendon springs.
The largest torque found is not proven to be the global maximum.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pupper_analysis.base.arguments import check_arguments
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import ConfigurationError
from pupper_analysis.base.progress import report_progress
from pupper_analysis.base.results import Tabular
from pupper_analysis.base.units import EFFORT_UNIT
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.robot.joints import joint_ranges
from pupper_analysis.robot.robot import Robot, acts_at_rest
from pupper_analysis.robot.tool import Tool
from pupper_analysis.stance.posture import Posture
from pupper_analysis.statics.equilibrium import compute_utilisation
from pupper_analysis.tools.hold.motions import JointMotions

_NUM_AGREEING_SEARCHES = 3
"""Number of searches that end at the same largest torque of a motor in a direction, after which no
search starts from a further posture. Chosen, not tuned.
"""

_SAME_TORQUE_RTOL = 1e-9
"""Relative difference of the torques of two searches at or below which both have found the same
maximum. Chosen, not tuned."""

_MAX_SWEEPS = 30
"""Maximum number of sweeps of a search; in a sweep, one joint after another is moved to the largest
torque. Chosen, not tuned."""

_TORQUE_GAIN_RTOL = 1e-10
"""Relative increase of the torque in a sweep over all joints [1], at or below which a search for
the largest torque stops. At or below the same relative range of sampled torques, no maximum is
searched between the samples. Chosen, not tuned.
"""

_PEAK_POSITION_ATOL = 1e-6
"""Tolerance [rad, m] of the joint position at which a motor torque has a maximum between two
samples, or ceases to be defined. Derived: the torque of a hinge is A cos(x) near the maximum, so
that an error of x changes it by 1e-12 A / 2.
"""

_UNDEFINED_TORQUE = 1e300
"""Value larger than any torque [N m, N]. In a search, its negative replaces the torque in a posture
in which a loop cannot be closed, or is singular, so that the search avoids the posture."""

_MIN_LOAD_FRACTION = 1e-12
"""Smallest motor torque per load of a joint [1, m or 1/m] with which the motor bears the load. A
smaller value is a rounding error. Chosen, not tuned.
"""


class TorqueSearch:
    """Coordinate search for the posture with the largest static torque of a motor.

    Args:
        robot: Robot with a fixed base.
        motions: Motions of the joints.
        tool: Point with the payload.
        payload: Point mass at the tool [kg].

    Attributes:
        stiffness: Linear spring stiffness of the joints in MuJoCo, shape (nu,) [N m/rad, N/m].
    """

    def __init__(self, robot: Robot, motions: JointMotions, tool: Tool, payload: float) -> None:
        self._robot, self._motions, self._tool, self._payload = robot, motions, tool, payload
        model, stiffness = robot.structure.model, robot.mj_model.jnt_stiffness
        indices = [robot.structure.joints[name] for name in robot.joint_names]
        carried = np.array(
            [[support in model.supports[joint] for support in indices] for joint in indices]
        )
        self.stiffness = stiffness[[robot.mj_model.joint(name).id for name in robot.joint_names]]
        # The torques of gravity (also if compensated) and of joint springs are a sinusoid plus a
        # linear term in each joint position. Other forces at rest have no such form.
        plain = copy.copy(robot.mj_model)
        plain.jnt_stiffness[:] = plain.body_gravcomp[:] = 0.0
        self._is_sinusoidal = not acts_at_rest(plain)
        # (nu, nu): whether the load of joint i may depend on the position of joint j.
        self._load_depends = carried | carried.T | (not self._is_sinusoidal)

    def find_highest_torque(
        self, joint: int, sign: float, starts: list[Array]
    ) -> tuple[float, Array]:
        """Find the posture with the largest static torque of a motor, by several searches.

        ``sign`` (1 or -1) is the direction of maximisation; ``starts`` are postures, shape (nu,).

        Returns:
            ``sign`` times the torque [N m, N], or -`_UNDEFINED_TORQUE` if no tried posture has a
            defined torque; posture, shape (nu,) [rad, m].
        """
        ends: list[tuple[float, Array]] = []
        for start in starts:
            ends.append(self.find_local_maximum(joint, sign, start))
            best = max(ends, key=lambda end: end[0])
            agreeing = sum(end[0] >= best[0] - _SAME_TORQUE_RTOL * abs(best[0]) for end in ends)
            if agreeing >= _NUM_AGREEING_SEARCHES:
                break
        return (
            self.find_local_maximum(joint, sign, best[1], fine=True)
            if self._motions.nonlinear.any()
            else best
        )

    def find_local_maximum(
        self, joint: int, sign: float, qpos: Array, *, fine: bool = False
    ) -> tuple[float, Array]:
        """Find a local maximum of a motor torque over the postures, one joint motion at a time.

        The search starts at ``qpos``, shape (nu,) [rad, m], in the direction ``sign`` (1 or -1).
        ``fine`` also searches between the samples of a motion whose closed loops are solved
        numerically.

        Returns:
            ``sign`` times the torque [N m, N], or -`_UNDEFINED_TORQUE` if no examined posture has a
            defined torque; posture, shape (nu,) [rad, m].
        """
        best = self._evaluate_torque(joint, sign, qpos)
        borne = np.abs(self._motions.shares[joint]) > _MIN_LOAD_FRACTION
        relevant = self._load_depends[borne].any(axis=0)
        chosen = [
            motion for motion, moved in enumerate(self._motions.moved) if relevant[moved].any()
        ]
        for _ in range(_MAX_SWEEPS):
            before = best
            for motion in chosen:
                length = self._find_peak(joint, sign, qpos, motion, best, fine=fine)
                moved = self._motions.move_along(qpos, motion, length)
                torque = -math.inf if moved is None else self._evaluate_torque(joint, sign, moved)
                if moved is not None and torque > best:
                    best, qpos = torque, moved
            if best - before <= _TORQUE_GAIN_RTOL * abs(best):
                break
        return best, qpos

    def compute_torques(self, qpos: Array) -> Array:
        """Compute the static motor torques in a posture ``qpos``, shape (nu,) [N m or N].

        Zeros if the loops are singular.
        """
        config = Configuration(self._robot, qpos)
        try:
            return config.transfer_to_motors(self._compute_load(config))
        except ConfigurationError:
            return np.zeros(len(qpos))

    def _find_peak(
        self, joint: int, sign: float, qpos: Array, motion: int, current: float, *, fine: bool
    ) -> float:
        """Find the displacement [rad, m] along a motion at which a signed joint torque is largest.

        ``qpos``, shape (nu,), is the posture at zero displacement, and ``current`` the signed
        torque there [N m, N]. ``fine`` also searches between the samples of a motion whose closed
        loops are solved numerically.
        """
        motions = self._motions
        low, high = motions.find_range(qpos, motion)

        def evaluate(length: float) -> float:
            """Return the signed torque [N m, N] at ``length`` [rad, m] along the motion."""
            moved = motions.move_along(qpos, motion, length)
            return (
                -_UNDEFINED_TORQUE if moved is None else self._evaluate_torque(joint, sign, moved)
            )

        moved = motions.moved[motion]
        if self._is_sinusoidal and not motions.nonlinear[motion] and motions.slides[moved].all():
            return max((low, high), key=evaluate)
        if len(moved) > 1 or not self._is_sinusoidal:
            samples = np.linspace(low, high, motions.count_samples(motion))
            nonlinear = bool(motions.nonlinear[motion])
            return _maximize_sampled(
                evaluate, samples, fine=fine or not nonlinear, everywhere=nonlinear
            )
        spring = sign * float(motions.shares[joint, moved[0]] * self.stiffness[moved[0]])
        third = 2 * math.pi / 3
        ahead = evaluate(third) - spring * third
        behind = evaluate(-third) + spring * third
        mean = (current + ahead + behind) / 3
        sine, cosine = (ahead - behind) / math.sqrt(3), current - mean
        return _maximize_sinusoid(cosine, sine, spring, low, high)

    def _compute_load(self, config: Configuration) -> Array:
        """Return the static load of the joints with the payload, shape (nu,) [N m, N]."""
        load = config.static_load()
        return load + self._payload * self._tool.load_per_mass(config) if self._payload else load

    def _evaluate_torque(self, joint: int, sign: float, qpos: Array) -> float:
        """Return `sign` times a motor torque [N m, N]; `-_UNDEFINED_TORQUE` at a singularity."""
        config = Configuration(self._robot, qpos)
        load = self._compute_load(config)
        if self._motions.constant[joint]:
            return sign * float(self._motions.shares[joint] @ load)
        try:
            return sign * float(config.transfer_to_motors(load)[joint])
        except ConfigurationError:  # singular: nothing holds the loop
            return -_UNDEFINED_TORQUE


def _maximize_sinusoid(cosine: float, sine: float, rate: float, low: float, high: float) -> float:
    """Return the x [rad] in [low, high] that maximises cosine cos x + sine sin x + rate x."""
    candidates, amplitude = [low, high], math.hypot(cosine, sine)
    if abs(rate) <= amplitude and amplitude > 0:
        # Stationary points: b cos x - a sin x + r = 0; one of the two per turn is a maximum.
        base = math.atan2(sine, cosine) + math.asin(rate / amplitude)
        turns = range(
            math.floor((low - base) / (2 * math.pi)) + 1,
            math.floor((high - base) / (2 * math.pi)) + 1,
        )
        candidates += [base + 2 * math.pi * turn for turn in turns]
    return max(candidates, key=lambda x: cosine * math.cos(x) + sine * math.sin(x) + rate * x)


def _maximize_sampled(
    function: Callable[[float], float], samples: Array, *, fine: bool, everywhere: bool
) -> float:
    """Find the argument [rad, m] at which a function is largest on the interval of ``samples``.

    With ``everywhere``, each local maximum of the samples is refined: for a closed loop, the global
    maximum may not be next to the largest sample. Without ``fine``, the best sample is returned.
    """
    from scipy import optimize  # slow to import

    values = np.array([function(sample) for sample in samples])
    top = int(np.argmax(values))
    if not fine or np.ptp(values) <= _TORQUE_GAIN_RTOL * abs(values[top]):
        return float(samples[top])
    padded = np.concatenate([[-math.inf], values, [-math.inf]])
    peaks = (values > -_UNDEFINED_TORQUE) & (values >= np.maximum(padded[:-2], padded[2:]))
    candidates = [float(samples[top])]
    for peak in np.flatnonzero(peaks).tolist() if everywhere else [top]:
        ends = samples[max(peak - 1, 0)], samples[min(peak + 1, len(samples) - 1)]
        low, high = (_find_last_defined(function, float(samples[peak]), float(end)) for end in ends)
        if high - low > _PEAK_POSITION_ATOL:
            best = optimize.minimize_scalar(
                lambda length: -function(length),
                bounds=(low, high),
                method="bounded",
                options={"xatol": _PEAK_POSITION_ATOL},
            )
            candidates += [low, best.x, high]
    return float(max(candidates, key=function))


def _find_last_defined(function: Callable[[float], float], start: float, end: float) -> float:
    """Return the last position [rad, m] from ``start`` to ``end`` with a defined function.

    Found by bisection. The function must be defined (above -`_UNDEFINED_TORQUE`) at ``start``.
    """
    if function(end) > -_UNDEFINED_TORQUE:
        return end
    while abs(end - start) > _PEAK_POSITION_ATOL:
        middle = (start + end) / 2
        start, end = (middle, end) if function(middle) > -_UNDEFINED_TORQUE else (start, middle)
    return start


_NUM_RANDOM_STARTS = 12
"""Largest number of random start postures of the searches of a motor in a direction, in addition to
the `_NUM_POOL_STARTS` selected postures. Chosen, not tuned."""

_NUM_POOL_POSTURES = 500
"""Number of random postures from which start postures are selected, if a robot has nonlinear loops
(joints that do not move in proportion). In such loops, torques have many local maxima. Chosen, not
tuned.
"""

_NUM_POOL_STARTS = 3
"""Number of start postures that are selected from the `_NUM_POOL_POSTURES` random postures for each
motor and direction: those with the largest torques. Chosen, not tuned.
"""

_MIN_TORQUE_PER_WEIGHT = 1e-14
"""Torque divided by the robot's weight [N m/N] at or below which the torque is set to 0. For
example, the torque of a hinge with a vertical axis is only a rounding error. Chosen, not tuned.
"""


@dataclass(frozen=True, eq=False)
class WorstPostures(Tabular):
    """Posture with the largest static torque of each motor, as found by search.

    Attributes:
        joint_names: Names of the joints, in actuator order.
        joint_torques: (nu,) torques of largest magnitude found, with sign (N m or N).
        postures: (nu, nu) posture of each torque, a row per motor (rad or m).
        limits: (nu,) effort limits (N m or N); infinite if the limit is unknown.
        utilisation: (nu,) |torque| / limit. 0 without torque. If there is a torque, NaN for an
            unknown limit; infinite for a limit of zero if the torque is above rounding.
        endless: Reason why torques may be unbounded; None without such a reason.
    """

    _units_of_columns: ClassVar[dict[str, str]] = {"torque": EFFORT_UNIT}

    joint_names: tuple[str, ...]
    joint_torques: Array = field(metadata={"unit": "N m or N"})
    postures: Array = field(metadata={"unit": "rad or m"})
    limits: Array = field(metadata={"unit": "N m or N"})
    utilisation: Array = field(metadata={"unit": "1"})
    endless: Diagnostic | None

    def _columns(self) -> dict[str, ArrayLike]:
        """Return {column: values} of a table with a row per joint.

        The columns are joint name, largest torque [N m or N] and utilisation [1].
        """
        return {
            "joint": self.joint_names,
            "torque": self.joint_torques,
            "utilisation": self.utilisation,
        }


@check_arguments
def worst_postures(
    robot: Robot,
    posture: Posture,
    tool: Tool,
    *,
    payload: float = 0.0,
    near: WorstPostures | None = None,
    bearing: NDArray[np.bool_] | None = None,
) -> WorstPostures:
    """Search for the posture with the largest static torque of each motor of a fixed-base robot.

    A search maximises the torque over one joint after another. Searches start from ``posture`` and
    from random postures.

    The result is not proven to be the global maximum.

    Args:
        robot: Robot with a fixed base.
        posture: Posture in which all kinematic loops are closed; it is one of the start postures.
        tool: Point with the payload.
        payload: Point mass at the tool [kg].
        near: Worst postures for another payload, from which searches start first.
        bearing: Whether each motor may carry a part of the payload, shape (nu,). The results of
            other motors are copied from ``near``; ignored without ``near``.

    Raises:
        ConfigurationError: If a closed loop is singular in ``posture``.
    """
    motions = JointMotions(robot, posture)
    starts = motions.draw_postures(_NUM_RANDOM_STARTS)
    searched = np.ones(robot.nu, dtype=bool) if near is None or bearing is None else bearing
    search = TorqueSearch(robot, motions, tool, payload)
    torques, postures = np.zeros(robot.nu), np.tile(posture.qpos, (robot.nu, 1))
    if near is not None:
        torques[~searched] = near.joint_torques[~searched]
        postures[~searched] = near.postures[~searched]
    pool = (
        motions.draw_postures(_NUM_POOL_POSTURES)
        if motions.nonlinear.any() and near is None
        else []
    )
    sampled = np.array([search.compute_torques(qpos) for qpos in pool])
    for count, joint in enumerate(np.flatnonzero(searched).tolist()):
        report_progress("worst postures", count, int(searched.sum()))
        first_starts = [posture.qpos, *starts]
        if near is not None:
            first_starts.insert(0, near.postures[joint])
        for sign in (1.0, -1.0):
            largest = np.argsort(-sign * sampled[:, joint])[:_NUM_POOL_STARTS] if pool else ()
            pool_starts = [pool[index] for index in largest]
            torque, qpos = search.find_highest_torque(
                joint, sign, [*first_starts[:1], *pool_starts, *first_starts[1:]]
            )
            if torque > abs(torques[joint]):
                torques[joint], postures[joint] = sign * torque, qpos
    torques[np.abs(torques) <= _MIN_TORQUE_PER_WEIGHT * robot.weight] = 0.0
    return WorstPostures(
        joint_names=robot.joint_names,
        joint_torques=torques,
        postures=postures,
        limits=robot.effort_limits,
        utilisation=np.where(torques != 0, compute_utilisation(robot, torques), 0.0),
        endless=_explain_unbounded_torque(robot, motions, search.stiffness),
    )


def _explain_unbounded_torque(
    robot: Robot, motions: JointMotions, stiffness: Array
) -> Diagnostic | None:
    """Return a reason why torques may be unbounded; None without such a reason.

    ``stiffness`` is the spring stiffness of each joint, shape (nu,) [N m/rad, N/m].
    """
    if motions.endless:
        return diagnose("slide-not-limited")
    unlimited = ~np.isfinite(joint_ranges(robot)).all(axis=1)
    return diagnose("springs-turn-freely") if (unlimited & (stiffness != 0)).any() else None
