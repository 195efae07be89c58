"""What a file does by itself: nothing that is asked of its robot is answered better than that."""

from __future__ import annotations

import re
from collections.abc import Callable
from copy import copy
from pathlib import Path

import pytest

import pupper_analysis as pa
from pupper_analysis.prepare.judge import judge_stand
from pupper_analysis.prepare.own_run import own_run, rests_by_itself
from pupper_analysis.present.verdict import verdict_clauses
from pupper_analysis.robot.as_published import OwnCommands
from pupper_analysis.simulation.verdict import Verdict, VerdictCode
from tests.prepare.test_planted import stands
from tests.support.legged import edited_by
from tests.support.slips import standing

Slip = Callable[[str], str]

_CTRL = r' ctrl="[^"]*"(?=/></keyframe>)'


def _lying(text: str) -> str:
    """Stands on bent legs: with the zeros of a reset it is thrown on its back."""
    bent = text.replace(" ".join(["0 0.6 -1.2"] * 4), " ".join(["0 1.3 -2.5"] * 4))
    return bent.replace('qpos="0 0 0.35 ', 'qpos="0 0 0.15 ')


def _option(words: str) -> Slip:
    return lambda text: text.replace('<option integrator="implicitfast"/>', f"<option {words}")


def slipped(folder: Path, slip: Slip) -> pa.Robot:
    pair = standing(folder)
    edited_by(pair.mjcf, slip)
    return pa.load_robot(*pair)


def judged(robot: pa.Robot) -> Verdict:
    return judge_stand(robot, pa.solve_stand(robot))


def codes(verdict: Verdict) -> list[str]:
    return [clause.message.code for clause in verdict_clauses(verdict)]


@pytest.mark.slow
def test_a_file_rests_by_itself_only_if_the_motion_after_a_nudge_ends(tmp_path: Path) -> None:
    """Reference: m dv/dt = c v, without gravity and contacts, grows by exp(c t / m), 100 in 2 s.

    Such a robot stays at rest for ever if it is not nudged.
    """
    robot = pa.load_robot(*standing(tmp_path))
    model = copy(robot.mj_model)
    assert rests_by_itself(model, robot, robot.home)
    model.opt.gravity[:] = 0.0
    model.geom_contype[:] = model.geom_conaffinity[:] = 0
    model.dof_damping[:3] = -2.4 * robot.total_mass
    assert not rests_by_itself(model, robot, robot.home)


@pytest.mark.parametrize("stated", [True, False])
def test_zeros_that_are_stated_count_and_a_resets_are_told(tmp_path: Path, stated: bool) -> None:
    """From deep knees both throw it on to its back; nobody wrote the zeros of a reset."""
    zeros = f' ctrl="{" ".join(["0"] * 12)}"' if stated else ""

    def slip(text: str) -> str:
        return re.sub(_CTRL, zeros, _lying(text))

    robot = slipped(tmp_path, slip)
    assert not stands(tmp_path / "robot.xml")
    own = own_run(robot)
    assert own is not None
    assert own.falls
    assert own.commands is (OwnCommands.STATED if stated else OwnCommands.ABSENT)
    assert own.fails is stated
    assert (own.held is None) is stated
    assert own.held is None or not own.held.falls


@pytest.mark.parametrize("below", [0.0, 0.6])
def test_a_base_frame_below_the_ground_is_no_fall(tmp_path: Path, below: float) -> None:
    """The base's body is where it was; its frame, which nothing rests on, is elsewhere."""
    pair = standing(tmp_path)
    text = pair.mjcf.read_text()
    text = re.sub(r'(<body name="\w+_hip" pos="\S+ \S+) \S+"', rf'\g<1> {below}"', text)
    text = text.replace('<inertial pos="0 0 0" mass="4"', f'<inertial pos="0 0 {below}" mass="4"')
    text = text.replace('size="0.2 0.1 0.04"', f'size="0.2 0.1 0.04" pos="0 0 {below}"')
    text = text.replace('qpos="0 0 0.35 ', f'qpos="0 0 {0.35 - below} ')
    pair.mjcf.write_text(text)
    own = own_run(pa.load_robot(pair.mjcf))
    assert own is not None
    assert not own.falls
    assert own.height == pytest.approx(0.305, abs=0.01)
    assert own.end_height == pytest.approx(0.304, abs=0.01)


def test_what_sleeps_is_judged(tmp_path: Path) -> None:
    """MuJoCo does not differentiate a step of what may sleep."""
    asleep = _option('integrator="implicitfast"><flag sleep="enable"/></option>')
    robot = slipped(tmp_path, asleep)
    assert judged(robot).code is VerdictCode.HOLDS
    assert "sleep-not-differentiated" in {note.code for note in robot.notes}


@pytest.mark.slow
def test_what_the_file_does_is_no_matter_of_what_a_task_welds(tmp_path: Path) -> None:
    """A foot that is welded carries nothing; in the file it carries as the others do."""

    def with_motors(text: str) -> str:
        text = re.sub(_CTRL, "", text)
        motor = r'<motor \g<1> ctrlrange="-90 90" ctrllimited="true"/>'
        return re.sub(r'<position (joint="[^"]*")[^>]*/>', motor, text)

    robot = slipped(tmp_path, with_motors)
    for contacts in ({}, {next(iter(robot.feet)): pa.Weld()}):
        stand = pa.solve_stand_as_simulated(robot, pa.StandTask(contacts=contacts))
        verdict = judge_stand(robot, stand)
        assert verdict.passed, codes(verdict)
        assert "on-servos-made-up" in codes(verdict)
