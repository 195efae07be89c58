"""Computations for a page: from a state to stand, statics, sag, verdict and simulations.

This module does not depend on viser.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import (
    PupperAnalysisError,
    StanceUnreachableError,
    StaticsInfeasibleError,
)
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import find_servos_used
from pupper_analysis.robot.tool import with_payload
from pupper_analysis.simulation.stability import stand_stability
from pupper_analysis.simulation.verdict import Verdict, predict_verdict
from pupper_analysis.stance.sag.steady_state import SteadyState, steady_state
from pupper_analysis.stance.soft_ground import solve_stand_as_simulated
from pupper_analysis.stance.stand import Stand, solve_stand, stand_statics
from pupper_analysis.stance.task import StandTask
from pupper_analysis.statics.equilibrium import GravityCompensation
from pupper_analysis.tools.live.state import State
from pupper_analysis.tools.push.bench import PushTrial, simulate_push
from pupper_analysis.tools.stand.stance import Stance, study_stance

PUSH_SECONDS = 4.0
"""Duration of the simulation of a push [s]. If the robot still moves at the end, the simulation
continues (``extend_until_rest``). Chosen, not tuned.
"""


@dataclass(frozen=True, eq=False)
class Answer:
    """Solved stance for a state of a page, or the reason why there is none.

    Attributes:
        state: Requested state.
        robot: Robot with the payload; None if the payload is not valid.
        task: Stand task; None if the state is not valid.
        stand: Stand, on MuJoCo's soft ground if reachable there; None if the state is not valid, or
            the stance is out of reach.
        statics: Static torques and forces; None without a stand in balance.
        refusal: Error, if a result is None. A ``StanceUnreachableError`` does not contain the
            nearest stance yet (`explain_unreachable`).
    """

    state: State
    robot: Robot | None
    task: StandTask | None
    stand: Stand | None
    statics: GravityCompensation | None
    refusal: PupperAnalysisError | None

    @property
    def unreachable(self) -> bool:
        """Whether the requested stance is out of reach."""
        return isinstance(self.refusal, StanceUnreachableError)


class PageSolver:
    """Solves the stances that a page requests. Several threads may call its methods.

    Args:
        robot: Robot.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._cached_robot: tuple[object, Robot] | None = None

    def load_robot(self, state: State) -> Robot:
        """Return the robot with the payload that the page's state requests; the last is cached.

        Raises:
            PupperAnalysisError: If the payload is not valid.
        """
        if not state.payload:
            return self._robot
        key = state.payload, state.payload_point()
        cached = self._cached_robot
        if cached is None or cached[0] != key:
            self._cached_robot = cached = key, with_payload(self._robot, *key)
        return cached[1]

    def solve_state(self, state: State) -> Answer:
        """Solve the stance of a state, and compute its static torques and contact forces.

        An error of this package is not raised, but becomes part of the result.
        """
        robot = task = stand = None
        try:
            robot = self.load_robot(state)
            task = state.task()
            stand = solve_stand(robot, task, explain=False)
            stand = solve_stand_as_simulated(robot, stand)
            statics = stand_statics(robot, stand)
        except PupperAnalysisError as error:
            return Answer(state, robot, task, stand, None, error)
        return Answer(state, robot, task, stand, statics, None)


def explain_unreachable(answer: Answer) -> StanceUnreachableError | None:
    """Return an error that explains why a stance is out of reach, with the nearest stance if found.

    None if the stance is reachable.
    """
    assert answer.robot is not None
    try:
        solve_stand(answer.robot, answer.task)
    except StanceUnreachableError as error:
        return error
    return None


def predict_sag(answer: Answer) -> SteadyState | Diagnostic:
    """Predict the equilibrium of a stance on its servos without feed-forward.

    The result is a diagnostic with the reason if there is no equilibrium, or if the equilibrium
    cannot be computed.
    """
    assert answer.robot is not None
    assert answer.stand is not None
    try:
        return steady_state(answer.robot, answer.stand, kp=answer.state.kp)
    except StaticsInfeasibleError:
        return diagnose("cannot-be-held")
    except PupperAnalysisError as error:
        return error.diagnostic


def predict_stance_verdict(answer: Answer, *, closely: bool) -> Verdict | None:
    """Predict the verdict of a stance without simulation; None without a stand in balance.

    ``closely`` includes the stability of the linearised dynamics, if the robot has servos.
    """
    if answer.robot is None or answer.statics is None:
        return None
    state, robot, stand = answer.state, answer.robot, answer.stand
    stability = None
    if closely and stand is not None:
        # Without servos there is no stability to compute.
        with contextlib.suppress(PupperAnalysisError):
            stability = stand_stability(robot, stand, kp=state.kp, kd=state.kd)
    return predict_verdict(answer.statics, find_servos_used(robot, state.kp, state.kd), stability)


def simulate_stance(answer: Answer) -> Stance:
    """Simulate and judge a stance in the same way as the command ``stand``.

    Raises:
        PupperAnalysisError: If the simulation is not possible.
    """
    assert answer.robot is not None
    assert answer.task is not None
    return study_stance(answer.robot, answer.task, kp=answer.state.kp, kd=answer.state.kd)


def push_stand(answer: Answer, impulse: float, direction: float) -> PushTrial:
    """Simulate a push of the robot in its stance, with position commands without feed-forward.

    ``impulse`` is in N s; ``direction`` is the horizontal angle from the base's forward axis [rad].

    Raises:
        PupperAnalysisError: If the simulation is not possible.
    """
    assert answer.robot is not None
    assert answer.stand is not None
    return simulate_push(
        answer.robot,
        answer.stand,
        impulse,
        direction,
        duration=PUSH_SECONDS,
        kp=answer.state.kp,
        kd=answer.state.kd,
        feedforward=False,
    )
