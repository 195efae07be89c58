"""The live page of a walking policy, with viser's server in place of a browser."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from pupper_analysis.tools.live.render import Translator
from pupper_analysis.tools.live.walking import WalkSession
from pupper_analysis.tools.walk.policy import Policy
from pupper_analysis.tools.walk.runs import (
    Lockstep,
    make_push_forces,
    prepare_stage,
    simulate_cases,
)
from tests.support.variants import load
from tests.tools.live.test_session import Browser, end, server, wait_for  # noqa: F401
from tests.tools.walk import made

pytest.importorskip("viser", reason="viser is not installed")


@pytest.fixture
def session(tmp_path: Path, server: Any) -> Iterator[WalkSession]:  # noqa: F811
    stage = prepare_stage(
        load("v3"), Policy.load(made.write_standing_policy(tmp_path / "still.json"))
    )
    one = WalkSession(Browser(server), stage, np.zeros(3), Translator("en"))
    yield one
    end(one)


@pytest.mark.slow
def test_walk_restarts_after_a_fall(session: WalkSession) -> None:
    def shown(words: str) -> bool:
        return words in session._numbers.content

    wait_for(lambda: shown("on its feet for"), "it does not walk")
    assert shown("leg_front_l_3")
    session.impulse.value = 3.0
    session.push(0.0, 1.0)
    wait_for(lambda: session.fall is not None, "it stands a push of 3 m/s")
    wait_for(lambda: shown("the robot fell over"), "the fall is not said")
    session.restart_walk()
    wait_for(lambda: session.fall is None and shown("on its feet for"), "it does not begin again")


def test_sliders_set_the_walk_command(session: WalkSession) -> None:
    session.sliders[0].value = 0.3
    wait_for(lambda: "of 0.30" in session._numbers.content, "the command is not shown")


def test_played_walk_equals_the_simulation_of_walk(tmp_path: Path) -> None:
    """The same start, command and push: equal to the last bit."""
    stage = prepare_stage(load("v3"), Policy.load(made.trot(tmp_path / "trot.json")))
    case = stage.make_case(np.array(made.TROT[0]), 3)
    played = Lockstep(stage, [case])
    states = np.concatenate([played.advance()[0][0] for _ in range(60)])
    [run] = simulate_cases(stage, [case], 3.0, 1.0, 1)
    assert np.array_equal(states, run.states[: len(states)])


def test_push_changes_the_momentum_by_its_impulse(tmp_path: Path) -> None:
    """Reference: momentum = impulse, in the air without horizontal forces."""
    stage = prepare_stage(
        load("v3"), Policy.load(made.write_standing_policy(tmp_path / "still.json"))
    )
    run = Lockstep(stage, [replace(stage.make_case(np.zeros(3)), lift=1.0)])
    run.advance(make_push_forces(stage, [(0.6, -0.2)]))
    data = mujoco.MjData(stage.model)
    mujoco.mj_setState(stage.model, data, run.current[0], mujoco.mjtState.mjSTATE_FULLPHYSICS)
    mujoco.mj_forward(stage.model, data)
    mujoco.mj_subtreeVel(stage.model, data)
    momentum = stage.robot.total_mass * data.subtree_linvel[0]
    # Legs swing meanwhile: the integrator keeps momentum to the first order of its step.
    assert momentum[:2] == pytest.approx([0.6, -0.2], rel=1e-3)
