"""Fit of a log of a bar on a servo, which the test integrates itself: planted errors are found, and
undetermined parameters are reported as such.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

from pupper_analysis.base.errors import ConfigurationError, MeasurementError, UnknownNameError
from pupper_analysis.prepare.convert.load import load_robot
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.servos import model_with_servos
from pupper_analysis.tools.fit.motions.fit import (
    MotionResiduals,
    _report_stall,
    fit_motion,
    measure_repeatability,
    measure_replay,
)
from pupper_analysis.tools.fit.motions.rollouts import LogSegment, Simulator, split_runs
from pupper_analysis.tools.fit.parameters import Parameter, ParameterTable
from pupper_analysis.tools.fit.result import Determined, MotionFit, classify_determination
from tests.support.bar import MJCF, OFFSET, QUANTUM, TRUE, URDF, bar, log

PRIORS = ("mass=0", "com=0")


@cache
def fit_bar_motion() -> MotionFit:
    """Return the fit of the bar's log with fixed mass and CoM."""
    return fit_motion(bar(), [log()], priors=PRIORS)


@pytest.mark.slow
def test_planted_errors_are_found_within_their_intervals() -> None:
    """Reference: the planted values, within 4 standard deviations plus 1 % (the numerical
    integration), and within 25 %.
    """
    posterior = fit_bar_motion().posterior
    found = {one.kind: place for place, one in enumerate(posterior.parameters)}
    for kind, true in {**TRUE, "offset": OFFSET}.items():
        place = found[kind]
        off = posterior.mean[place] - true
        assert abs(off) < 4 * posterior.std[place] + 0.01 * abs(true), kind
        assert classify_determination(float(posterior.variance_ratios[place])) is Determined.DATA, (
            kind
        )
        assert abs(off) < 0.25 * abs(true), kind


@pytest.mark.slow
def test_standard_deviations_are_at_most_those_of_the_priors() -> None:
    """Data reduces the variance of a Gaussian prior, even if it hardly determines a parameter."""
    posterior = fit_bar_motion().posterior
    ratios = posterior.std / [parameter.width for parameter in posterior.parameters]
    assert ratios.max() <= 1
    assert ratios.max() > 0.9  # the second lag is determined by its prior


@pytest.mark.slow
def test_held_out_motion_is_predicted_within_encoder_noise() -> None:
    """Reference: quantum times sqrt(0.3^2 + 1/12), the noise of the simulated encoder."""
    noise = QUANTUM * math.hypot(0.3, 1 / math.sqrt(12))
    # While the bar is still, quanta hide a part of it.
    assert fit_bar_motion().encoder_noise["turn"] == pytest.approx(noise, rel=0.3)
    # MuJoCo's dry friction is soft, and Coulomb's is not.
    assert noise / 1.1 < fit_bar_motion().held_out < 1.6 * noise
    assert fit_bar_motion().held_out_before > 10 * fit_bar_motion().held_out
    assert math.isnan(fit_bar_motion().repeatability)
    assert fit_bar_motion().diagnostics == ()


@pytest.mark.slow
def test_error_of_kd_does_not_shift_other_parameters_out_of_their_intervals() -> None:
    """Reference: planted values. The servo damps 1.3 times as much as its kd states."""
    kd = 2.0
    found = fit_motion(bar(), [log(TRUE["damping"] + 1.3 * kd)], priors=["com=0"], kd=kd)
    planted = {**TRUE, "damping": TRUE["damping"] + 0.3 * kd, "mass": 0.5}
    intervals = {one.kind: (one.low, one.high) for one in found.estimates}
    for kind, true in planted.items():
        assert intervals[kind][0] < true < intervals[kind][1], kind


@pytest.mark.slow
def test_only_ratios_are_determined_if_the_mass_is_unknown() -> None:
    """Reference: planted kp / mass inside an interval of less than 5 % standard deviation."""
    found = fit_motion(bar(), [log()], priors=["com=0"])
    assert {
        estimate.determined for estimate in found.estimates if estimate.kind in ("kp", "mass")
    } != {"data"}
    ratio = found.kp_over_mass
    assert ratio.determined is Determined.DATA
    assert ratio.low < TRUE["kp"] / 5 < ratio.high
    assert ratio.std < 0.05


@pytest.mark.slow
def test_unexplained_motion_is_reported() -> None:
    """An oscillation of 17 rad/s is added to the positions, which no parameter explains."""
    odd = log().position + 0.02 * np.sin(17 * log().time)[:, None]
    found = fit_motion(bar(), [replace(log(), position=odd)], priors=PRIORS)
    assert "motion-not-explained" in {failure.code for failure in found.failures}
    assert not found.explained


@pytest.mark.slow
def test_stalled_fit_is_not_explained() -> None:
    """A step of two standard deviations is left; a converged fit of the same log has no failure."""
    stalled = replace(fit_bar_motion().posterior, unrealised_decrease=4.0)  # above 1.96^2
    assert [failure.code for failure in _report_stall(stalled)] == ["motion-fit-not-converged"]
    assert fit_bar_motion().posterior.unrealised_decrease <= 1
    assert fit_bar_motion().explained


def test_scatter_about_the_stated_values_does_not_favour_small_factors() -> None:
    """All passive parameters are a standard deviation off, so that the squared deviations add up to
    their number. Closed form: the derivative of the prior cost by the logarithm of a common factor,
    2 sum_i z_i x_i, keeps the part 2 sum_i z_i m_i of the stated values m_i.
    """
    robot, name = bar(), bar().joint_names[0]
    half = {kind: TRUE[kind] / 2 for kind in ("kp", "friction", "damping", "armature")}
    table = ParameterTable([Parameter(kind, name, "", own, own) for kind, own in half.items()])
    simulator = Simulator(robot, model_with_servos(robot), table, log().interval)
    motion = MotionResiduals(simulator, [*split_runs(log(), robot.home, 0.0)])
    point = table.stated + table.width
    motion.linearise(point, point)
    number = len(table)
    other = point.copy()
    other[0] *= 2  # kp
    extra = [motion.linearise(x, table.stated).extra_cost for x in (point, other)]
    assert extra[1] - extra[0] == pytest.approx(-2 * number * math.log(2), rel=0.05)


def load_two_bars() -> Robot:
    """Load the bar, and a second bar with the joint ``still`` on the same base."""
    link = URDF[URDF.index('<link name="bar">') : URDF.index("</robot>")]
    body = MJCF[MJCF.index('<body name="bar">') : MJCF.index("</body></body>")] + "</body>"
    servo = '<position name="turn" joint="turn" kp="5"/>'
    second = [
        text.replace('"bar"', '"second"').replace('"turn"', '"still"')
        for text in (link, body, servo)
    ]
    urdf = URDF.replace("</robot>", second[0] + "</robot>")
    mjcf = MJCF.replace("</body></body>", f"</body>{second[1]}</body>").replace(
        "</actuator>", second[2] + "</actuator>"
    )
    with TemporaryDirectory() as folder:
        files = Path(folder) / "bars.urdf", Path(folder) / "bars.xml"
        for file, text in zip(files, (urdf, mjcf), strict=True):
            file.write_text(text, encoding="utf-8")
        return load_robot(*files)


@pytest.mark.slow
def test_joint_that_rests_does_not_fail_the_fit() -> None:
    """The readings of the joint ``still`` are constant: 0.35 rad, near the equilibrium of
    5 (0.4 - q) = 0.736 sin q. Reference: the fit of the moving joint alone.
    """
    moving = log().select_rows(slice(0, 600))
    rows = np.ones((len(moving.time), 1))
    both = replace(
        moving,
        joints=("turn", "still"),
        position=np.hstack([moving.position, QUANTUM * round(0.3495 / QUANTUM) * rows]),
        command=np.hstack([moving.command, 0.4 * rows]),
    )
    found = fit_motion(load_two_bars(), [both], priors=PRIORS, hold_out=0.0)
    alone = fit_motion(bar(), [moving], priors=PRIORS, hold_out=0.0)
    assert found.encoder_noise["still"] == 0
    assert found.failures == alone.failures == ()
    assert found.by_joint["turn"] == pytest.approx(alone.by_joint["turn"], rel=0.1)


def test_replay_is_recognised_by_its_commands() -> None:
    rng, time = np.random.default_rng(0), 0.01 * np.arange(800)
    phases = rng.uniform(0, 6, (2, 4, 3))
    first, second = (
        sum(np.sin((2 + k) * time[:, None] + phase) for k, phase in enumerate(own))
        for own in phases
    )

    def run(command: np.ndarray, *, out: bool) -> LogSegment:
        full = np.full(command.shape, True)
        there = time[: len(command)]
        return LogSegment(there, command, command, command[:2], full & (not out), full & out)

    recorded, noise = run(first, out=False), 0.01 * rng.normal(size=first[:600].shape)
    assert measure_replay([recorded, run(first[37:637] + noise, out=True)]) > 0.99
    assert measure_replay([recorded, run(second[:600], out=True)]) < 0.9
    assert measure_replay([recorded]) == 0.0
    # Resting commands repeat nothing: their deviation from the mean is rounding.
    assert measure_replay([recorded, run(np.full((180, 3), 0.6), out=True)]) == 0.0
    # A repetition that begins 37.4 samples later is 3 mrad from itself, and another motion none.
    late = np.column_stack([np.interp(np.arange(600) + 37.4, np.arange(800), c) for c in first.T])
    again = replace(run(late, out=False), position=late + 3e-3 * rng.normal(size=late.shape))
    assert measure_repeatability([recorded, again]) == pytest.approx(3e-3 / np.sqrt(2), rel=0.05)
    assert math.isnan(measure_repeatability([recorded, run(second[:600], out=False)]))


def test_a_log_of_another_robot_or_without_commands_is_refused() -> None:
    with pytest.raises(UnknownNameError):
        fit_motion(bar(), [replace(log(), joints=("knee",))])
    measured = replace(log(), command=np.full((len(log().time), 1), np.nan))
    with pytest.raises(MeasurementError) as refused:
        fit_motion(bar(), [measured])
    assert refused.value.cause.code == "joint-without-servo"
    after_jump = np.arange(len(log().time)) >= 600  # a run of its own, without commands
    measured = replace(
        log(),
        time=log().time + 2.0 * after_jump,
        command=np.where(after_jump[:, None], np.nan, log().command),
    )
    with pytest.raises(MeasurementError) as refused:
        fit_motion(bar(), [measured])
    assert refused.value.cause.code == "joint-without-servo"
    with pytest.raises(MeasurementError) as refused:
        fit_motion(bar(), [log().select_rows(slice(0, 150))])
    assert refused.value.cause.code == "nothing-to-fit"
    with pytest.raises(MeasurementError) as refused:  # begun later, it is the same motion
        fit_motion(
            bar(), [log()], hold_out=[replace(log(), source="again").select_rows(slice(30, None))]
        )
    assert (refused.value.cause.code, refused.value.source) == ("held-out-was-fitted", "again")
    for share in (1.0, -0.1, math.nan):
        with pytest.raises(ConfigurationError):
            fit_motion(bar(), [log()], hold_out=share)


def test_log_of_a_torque_motor_is_refused_without_both_gains() -> None:
    with TemporaryDirectory() as folder:
        files = Path(folder) / "bar.urdf", Path(folder) / "bar.xml"
        motor = MJCF.replace("position name", "motor name").replace(' kp="5"', "")
        for file, text in zip(files, (URDF, motor), strict=True):
            file.write_text(text, encoding="utf-8")
        robot = load_robot(*files)
    assert robot.description.made_servos  # so that it stands; they are no one's
    for given in ({}, {"kp": 6.0}, {"kd": 0.0}):
        with pytest.raises(MeasurementError) as refused:
            fit_motion(robot, [log()], **given)
        assert refused.value.cause.code == "command-without-gains"
