"""From a state to what there is to show: the Python interface, called for a page.

Nothing here knows of a browser. Every number is that of the public function which its field names.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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

Array = NDArray[np.float64]

PUSH_SECONDS = 4.0
"""s after a push: a robot that recovers has by then come to rest."""


@dataclass(frozen=True, eq=False)
class Answer:
    """What a state comes to, at once.

    Attributes:
        state: What was asked.
        robot: The robot, with its payload; None if there is none.
        task: The stand task; None if it is none.
        stand: ``solve_stand_as_simulated``'s: on MuJoCo's soft ground, if that is in reach; None if
            it is out of reach.
        statics: ``stand_statics``'s of it; None if it cannot be held.
        refusal: Why one of these is None; a ``StanceUnreachableError`` here is not yet explained.
    """

    state: State
    robot: Robot | None
    task: StandTask | None
    stand: Stand | None
    statics: GravityCompensation | None
    refusal: PupperAnalysisError | None

    @property
    def unreachable(self) -> bool:
        """Whether it is out of reach, so that there is more to be said of it."""
        return isinstance(self.refusal, StanceUnreachableError)


class StanceSolver:
    """Answers for one robot's states; several threads may ask.

    Args:
        robot: The robot.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._loaded: tuple[object, Robot] | None = None

    def load_robot(self, state: State) -> Robot:
        """Returns a state's robot, with its payload.

        Raises:
            PupperAnalysisError: If there is none.
        """
        if not state.payload:
            return self._robot
        key = state.payload, state.payload_point()
        last = self._loaded
        if last is None or last[0] != key:
            self._loaded = last = key, with_payload(self._robot, *key)
        return last[1]

    def solve_state(self, state: State) -> Answer:
        """Solves a state; what is wrong with it is in the answer."""
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
    """Returns why a stance is out of reach, and how far it can go (a second, or some).

    None if it is in reach after all.
    """
    assert answer.robot is not None
    try:
        solve_stand(answer.robot, answer.task)
    except StanceUnreachableError as error:
        return error
    return None


def predict_sag(answer: Answer) -> SteadyState | Diagnostic:
    """Predicts where the stand settles without feed-forward; or says why nothing is predicted."""
    assert answer.robot is not None
    assert answer.stand is not None
    try:
        return steady_state(answer.robot, answer.stand, kp=answer.state.kp)
    except StaticsInfeasibleError:
        return diagnose("cannot-be-held")
    except PupperAnalysisError as error:
        return error.diagnostic


def predict_stance_verdict(answer: Answer, *, closely: bool) -> Verdict | None:
    """Returns the verdict of a stance that is not simulated; None of one without balance.

    Args:
        answer: How it stands.
        closely: Also look whether it is stable, which takes some milliseconds.
    """
    if answer.robot is None or answer.statics is None:
        return None
    state, robot, stand = answer.state, answer.robot, answer.stand
    stability = None
    if closely and stand is not None:
        # Without servos there is nothing to look at: simulations say so.
        with contextlib.suppress(PupperAnalysisError):
            stability = stand_stability(robot, stand, kp=state.kp, kd=state.kd)
    return predict_verdict(answer.statics, find_servos_used(robot, state.kp, state.kd), stability)


def simulate_stance(answer: Answer) -> Stance:
    """Simulates the stance, as ``pupper-analysis stand`` does, and judges it.

    Args:
        answer: How it stands.

    Raises:
        PupperAnalysisError: If it cannot be.
    """
    assert answer.robot is not None
    assert answer.task is not None
    return study_stance(answer.robot, answer.task, kp=answer.state.kp, kd=answer.state.kd)


def push_stand(answer: Answer, impulse: float, direction: float) -> PushTrial:
    """Pushes the stand, on position commands alone.

    Args:
        answer: How it stands.
        impulse: N s.
        direction: From the base's forward (rad).

    Raises:
        PupperAnalysisError: If it cannot be.
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
