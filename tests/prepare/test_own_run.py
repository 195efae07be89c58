"""What a file does by itself: nothing that is asked of its robot is answered better than that."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

import pupper_analysis as pa
from pupper_analysis.models.transmission import Drive
from pupper_analysis.prepare.judge import judge_stand
from pupper_analysis.prepare.own_run import own_run
from pupper_analysis.present.verdict import in_words, verdict_clauses
from pupper_analysis.robot.as_published import OwnCommands
from pupper_analysis.simulation.verdict import Verdict, VerdictCode
from tests.support.slips import FALLS, by_itself, standing

Slip = Callable[[str], str]

_SERVO = r'<position joint="(\w+)" kp="150" kv="5"/>'
_CTRL = r' ctrl="[^"]*"(?=/></keyframe>)'


def _knee(other: str) -> Slip:
    return lambda text: re.sub(_SERVO.replace(r"(\w+)", "FL_knee"), other, text)


def _lying(text: str) -> str:
    """Stands on bent legs: with the zeros of a reset it is thrown on its back."""
    bent = text.replace(" ".join(["0 0.6 -1.2"] * 4), " ".join(["0 1.3 -2.5"] * 4))
    return bent.replace('qpos="0 0 0.35 ', 'qpos="0 0 0.15 ')


def _option(words: str) -> Slip:
    return lambda text: text.replace('<option integrator="implicitfast"/>', f"<option {words}")


_BIAS = r'<general joint="\1" gainprm="150" biastype="affine" biasprm="10 -150 -5"/>'

# What is wrong: the slip, and the code of its cause if one is to be named. What else is planted in
# this robot, with its cause: ``test_planted.py``.
SLIPS: dict[str, tuple[Slip, str | None]] = {
    "negative kp": (lambda text: text.replace('kp="150"', 'kp="-150"'), None),
    "one motor, and no ctrl": (
        lambda text: re.sub(_CTRL, "", _knee('<motor joint="FL_knee"/>')(text)),
        None,
    ),
    "a bias under actuatorfrcrange": (
        lambda text: re.sub(_SERVO, _BIAS, text).replace(
            '<joint name="FL_knee"', '<joint actuatorfrcrange="-30 30" name="FL_knee"'
        ),
        "servos-are-biased",
    ),
}
_CAUSES = {
    *("servos-are-biased", "gain-is-no-stiffness", "obstacles-touch", "servos-are-late"),
    *("timestep-too-long", "solver-too-rough", "files-differ", "actuatorfrcrange-cuts-off"),
}
"""Of which none may be told but the right one."""


def slipped(folder: Path, slip: Slip) -> pa.Robot:
    pair = standing(folder)
    text = pair.mjcf.read_text()
    changed = slip(text)
    assert changed != text
    pair.mjcf.write_text(changed)
    return pa.load_robot(urdf=pair.urdf, mjcf=pair.mjcf)


def judged(robot: pa.Robot) -> Verdict:
    return judge_stand(robot, pa.solve_stand(robot))


def codes(verdict: Verdict) -> list[str]:
    return [clause.message.code for clause in verdict_clauses(verdict)]


@pytest.mark.parametrize("name", SLIPS)
def test_a_slip_fails_and_its_own_cause_alone_is_told(tmp_path: Path, name: str) -> None:
    slip, cause = SLIPS[name]
    verdict = judged(slipped(tmp_path, slip))
    assert not verdict.passed, in_words(verdict)
    message = codes(verdict)
    assert {"own-run", "own-run-diverges"} & set(message)
    assert _CAUSES & set(message) == ({cause} if cause else set())


@pytest.mark.parametrize("stated", [True, False])
def test_zeros_that_are_stated_count_and_a_resets_are_told(tmp_path: Path, stated: bool) -> None:
    """From deep knees both throw it on to its back; nobody wrote the zeros of a reset."""
    zeros = f' ctrl="{" ".join(["0"] * 12)}"' if stated else ""

    def slip(text: str) -> str:
        return re.sub(_CTRL, zeros, _lying(text))

    robot = slipped(tmp_path, slip)
    assert by_itself(tmp_path / "robot.xml") > FALLS
    own = own_run(robot)
    assert own is not None
    assert own.falls
    assert own.commands is (OwnCommands.STATED if stated else OwnCommands.ABSENT)
    assert own.fails is stated
    if stated:
        assert own.held is None
    else:
        assert own.held is not None
        assert not own.held.falls


@pytest.mark.parametrize("kind", ["velocity", "motor"])
def test_a_joint_of_another_drive_stands_in_the_first_line(tmp_path: Path, kind: str) -> None:
    gain = ' kv="5"' if kind == "velocity" else ""
    verdict = judged(slipped(tmp_path, _knee(f'<{kind} joint="FL_knee"{gain}/>')))
    assert verdict.code is VerdictCode.OWN_DRIVES_FAIL
    drive = {"velocity": Drive.VELOCITY, "motor": Drive.MOTOR}[kind]
    assert verdict.own is not None
    assert verdict.own.unheld is not None
    assert (verdict.own.unheld.joint, verdict.own.unheld.drive) == ("FL_knee", drive)
    first = str(verdict_clauses(verdict)[0])
    assert "FL_knee" in first
    assert drive.value in first


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
