"""Gains, time steps and integrators that the caller requests, or that the file does not specify."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import mujoco
import pytest

import pupper_analysis as pa
from pupper_analysis.cli.stance_options import parse_gain
from pupper_analysis.models.transmission import Drive
from pupper_analysis.prepare.judge import judge_stand
from pupper_analysis.prepare.own_run import get_published_model, own_run
from pupper_analysis.prepare.published_model import (
    PublishedModel,
    has_few_servos,
    with_unstated_options,
)
from tests.prepare.test_own_run import load_slip
from tests.prepare.test_self_check import write_slip
from tests.support.every_command import Truth, simulate_truth
from tests.support.legged import quadruped, rewrite_file

_GAINS = r'kp="[^"]*"( kv="[^"]*")?'


def _height_after(mjcf: Path, seconds: float = 5.0) -> float:
    """Return the height of the base [m] that bare MuJoCo reaches from the keyframe."""
    model = mujoco.MjModel.from_xml_path(str(mjcf))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_step(model, data, nstep=round(seconds / model.opt.timestep))
    return float(data.qpos[2])


@pytest.mark.slow
def test_requested_gains_decide_if_the_file_has_weak_servos(tmp_path: Path) -> None:
    """With the requested gains in the file, bare MuJoCo stands; with the file's own it falls."""

    def with_gains(kp: float, kd: float) -> pa.Robot:
        return load_slip(tmp_path, lambda text: re.sub(_GAINS, f'kp="{kp:g}" kv="{kd:g}"', text))

    with_gains(80, 4)
    assert _height_after(tmp_path / "robot.xml") > 0.3
    robot = with_gains(2, 0.1)
    assert _height_after(tmp_path / "robot.xml") < 0.2
    stand = pa.solve_stand(robot)
    assert not judge_stand(robot, stand).passed
    verdict = judge_stand(robot, stand, kp=80, kd=4)
    assert verdict.passed
    assert verdict.keyframe_run is not None
    assert verdict.keyframe_run.falls  # the run of the unmodified file is still reported
    assert verdict.published is not None
    assert not verdict.published.differs


@pytest.mark.slow
def test_requested_gains_that_are_too_low_fail(tmp_path: Path) -> None:
    """The unmodified file stands in MuJoCo, but the verdict is about the requested gains."""
    robot = load_slip(tmp_path, lambda text: text + "\n")
    assert _height_after(tmp_path / "robot.xml") > 0.3
    stand = pa.solve_stand(robot)
    assert judge_stand(robot, stand).passed
    assert not judge_stand(robot, stand, kp=2, kd=0.1).passed


@pytest.mark.slow
@pytest.mark.parametrize(
    ("option", "timestep", "integrator"),
    [
        ("", 0.001, mujoco.mjtIntegrator.mjINT_IMPLICITFAST),
        ('<option timestep="0.004"/>', 0.004, mujoco.mjtIntegrator.mjINT_IMPLICITFAST),
        ('<option integrator="RK4"/>', 0.001, mujoco.mjtIntegrator.mjINT_RK4),
    ],
)
def test_added_servos_bring_the_options_that_the_file_does_not_state(
    tmp_path: Path, option: str, timestep: float, integrator: mujoco.mjtIntegrator
) -> None:
    """Reference: time step and integrator of the XML, or else of the prepared robot."""
    pair = quadruped(tmp_path, floor=True)
    rewrite_file(pair.mjcf, ("<worldbody>", f"{option}<worldbody>"), count=1)
    robot = pa.load_robot(*pair)
    robot.mj_model.opt.timestep = 0.001
    model = get_published_model(robot)
    assert model is not None
    changed = with_unstated_options(PublishedModel.from_model(model, robot), robot).model
    assert changed.opt.timestep == timestep
    assert changed.opt.integrator == integrator.value
    assert model.opt.timestep == (0.004 if "0.004" in option else 0.002)  # the file is unchanged


def test_options_of_a_file_with_servos_are_kept(tmp_path: Path) -> None:
    """MuJoCo's defaults belong to the file if its own servos were made for them."""
    robot = load_slip(
        tmp_path, lambda text: text.replace('<option integrator="implicitfast"/>', "")
    )
    model = get_published_model(robot)
    assert model is not None
    bare = PublishedModel.from_model(model, robot)
    assert with_unstated_options(bare, robot) is bare


@pytest.mark.slow
@pytest.mark.parametrize(
    ("drive", "few"),
    [
        (Drive.SERVO, False),
        (Drive.MOTOR, True),
        (Drive.NONE, True),
        (Drive.VELOCITY, True),
        (Drive.NO_STIFFNESS, False),
        (Drive.WRONG_SIGN, False),
    ],
)
def test_velocity_servos_hold_no_position(tmp_path: Path, drive: Drive, few: bool) -> None:
    """A servo with zero or negative stiffness is meant to hold, so its file is not excused."""
    robot = load_slip(tmp_path, lambda text: text + "\n")
    model = get_published_model(robot)
    assert model is not None
    bare = PublishedModel.from_model(model, robot)
    joints = len(bare.drives)
    most = (drive,) * 7 + (Drive.SERVO if few else Drive.MOTOR,) * (joints - 7)
    assert has_few_servos(replace(bare, drives=most)) is few


@pytest.mark.slow
def test_velocity_servos_without_commands_do_not_count_as_a_fall(tmp_path: Path) -> None:
    """In bare MuJoCo the file sinks on its velocity servos, whose commands are speeds.

    The keyframe has no ctrl, so servos are added as for torque motors, and the verdict passes.
    """

    def with_velocity_servos(text: str) -> str:
        text = re.sub(r' ctrl="[^"]*"(?=/></keyframe>)', "", text)
        return re.sub(r'<position (joint="[^"]*")[^>]*/>', r'<velocity \g<1> kv="2"/>', text)

    robot = load_slip(tmp_path, with_velocity_servos)
    own = own_run(robot)
    assert own is not None
    assert own.limp
    assert not own.fails
    assert own.held is None


@pytest.mark.slow
def test_damping_alone_does_not_excuse_servos_that_push_away_from_the_command(
    tmp_path: Path,
) -> None:
    """In bare MuJoCo the unmodified file does not stand: a servo's stiffness has the wrong sign.

    With ``--kd`` alone, or a ``--kp`` for other joints, the stiffness of the added servo was used,
    and the stand passed. With a stiffness for each joint, the verdict is about these gains.
    """
    pair = write_slip(tmp_path, "kp of one has the wrong sign", seed=3)
    assert simulate_truth(pair.mjcf, pair.mjcf) is not Truth.STANDS
    robot = pa.load_robot(*pair)
    (made,) = robot.description.made_servos
    stand = pa.solve_stand(robot)
    verdict = judge_stand(robot, stand, kd=4)
    assert not verdict.passed
    assert verdict.servos.replacement_servos == (made,)
    assert judge_stand(robot, stand, kp=80, kd=4).passed
    other = next(name for name in robot.joint_names if name != made.joint)
    with pytest.raises(pa.ModelError, match=f"the servo of joint '{made.joint}' has an invalid"):
        parse_gain("kp", (f"{other}=80",), robot)
    assert parse_gain("kp", (f"{made.joint}=80",), robot) is not None
