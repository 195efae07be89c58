"""Torques of two links in a plane, in closed form, tell planted errors, and what they cannot."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest

from pupper_analysis.arrays import inertia_of, inertia_tensor
from pupper_analysis.convert.load import load_robot
from pupper_analysis.errors import ConfigurationError, MeasurementError, UnknownNameError
from pupper_analysis.identification.fit import fit
from pupper_analysis.identification.measurements.log import Log
from pupper_analysis.identification.motions.result import MotionFit
from pupper_analysis.identification.noise import SeriesNoise
from pupper_analysis.identification.parameters import ParameterTable, give_widths, parse_prior
from pupper_analysis.identification.told import Told
from pupper_analysis.identification.torques.blocks import (
    Blocks,
    MeasuredTorques,
    measure_torques,
    one_way,
)
from pupper_analysis.identification.torques.couplings import Coupling, parse_coupling
from pupper_analysis.identification.torques.doubts import repeats
from pupper_analysis.identification.torques.equations import ENTRIES, OF_JOINTS, TorqueEquations
from pupper_analysis.identification.torques.estimate import Torques, innovations_together
from pupper_analysis.identification.torques.fit import fit_torques
from pupper_analysis.identification.torques.moments import SecondMoments
from pupper_analysis.identification.torques.result import TorqueFit
from pupper_analysis.identification.torques.smoothing import find_bands, smooth
from pupper_analysis.identification.write import fit_files
from tests.support.arm import arm
from tests.support.leg import (
    FILE_LEVER,
    FILE_TURNS,
    JOINTS,
    MASS,
    MJCF,
    NOISE,
    RATE,
    TRUE,
    URDF,
    G,
    Truth,
    leg,
    measured,
    motion,
    sensed,
    torques,
)


@cache
def log(seconds: float = 30.0, gravity: float = G) -> Log:
    return measured(seconds, gravity)


PRIORS = ("mass=0",)


@cache
def fitted() -> TorqueFit:
    return fit_torques(leg(), [log()], priors=PRIORS)


@pytest.mark.parametrize(
    ("kind", "subject", "component", "true"),
    [
        ("com", "shank", "z", -TRUE.lever[1]),
        ("com", "shank", "x", 0.0),
        ("inertia", "shank", "yy", TRUE.turns[1]),
        ("armature", "knee", "", TRUE.armature[1]),
        *(("friction", name, "", value) for name, value in zip(JOINTS, TRUE.friction, strict=True)),
        *(("damping", name, "", value) for name, value in zip(JOINTS, TRUE.damping, strict=True)),
        *(("bias", name, "", value) for name, value in zip(JOINTS, TRUE.bias, strict=True)),
    ],
)
def test_planted_numbers_are_found_within_their_intervals(
    kind: str, subject: str, component: str, true: float
) -> None:
    (found,) = (
        one
        for one in fitted().estimates
        if (one.kind, one.subject, one.component) == (kind, subject, component)
    )
    assert abs(found.mean - true) < 4 * found.std
    assert found.told is Told.DATA
    assert found.std < 0.12 * abs(true) + 2e-3  # of the com's x, a length


@pytest.mark.slow
def test_intervals_hold_what_is_planted_as_often_as_they_say() -> None:
    """Levers and moments are planted as the priors say, and the rest anyhow: data tell it."""
    held = []
    for seed in range(40):
        random = np.random.default_rng(seed)
        true = Truth(
            lever=tuple(random.normal(FILE_LEVER, 0.01)),
            turns=tuple(random.normal(FILE_TURNS, np.hypot(0.5 * np.array(FILE_TURNS),
                                                           9e-4 * np.array(MASS)))),
            friction=tuple(random.uniform(0.1, 0.8, 2)),
            damping=tuple(random.uniform(0.05, 0.4, 2)),
            armature=tuple(random.uniform(0.01, 0.08, 2)),
            bias=tuple(random.normal(0, 0.2, 2)),
        )  # fmt: skip
        planted = {
            ("com", "z"): [-one for one in true.lever],
            ("inertia", "yy"): true.turns,
            **{(kind, ""): getattr(true, kind)
               for kind in ("friction", "damping", "armature", "bias")},
        }  # fmt: skip
        subjects = dict(zip((*JOINTS, "thigh", "shank"), (0, 1, 0, 1), strict=True))
        for one in fit_torques(
            leg(), [measured(true=true, seed=seed)], priors=["mass=0", "com=10mm"]
        ).estimates:
            if (one.kind, one.component) in planted:
                value = planted[one.kind, one.component][subjects[one.subject]]
                held.append(one.low <= value <= one.high)
    assert len(held) == 40 * 12
    assert 0.93 <= np.mean(held) <= 0.97


def served(seed: int) -> Log:
    """A log of the two links with what is planted, moved by servos in MuJoCo, where they stick."""
    robot, step = leg(), 5e-4
    model = copy.copy(robot.mj_model)
    dofs, qpos = robot.mj_convention.qvel_index, robot.mj_convention.qpos_index
    for at, name in enumerate(("thigh", "shank")):
        body = model.body(name).id
        model.body_ipos[body, 2], model.body_inertia[body] = -TRUE.lever[at], TRUE.turns[at]
    model.dof_frictionloss[dofs], model.dof_damping[dofs] = TRUE.friction, TRUE.damping
    model.dof_armature[dofs] = TRUE.armature
    model.opt.timestep = step
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ACTUATION.value
    data = mujoco.MjData(model)
    mujoco.mj_setConst(model, data)  # without it friction is made for the file's inertias
    time = np.arange(0, 30, step)
    wanted, each = motion(time + 40 * seed)[0], round(1 / RATE / step)
    robot.mj_convention.set_state(data, wanted[0], np.zeros(2))
    position, torque = [], []
    for row, angle in enumerate(wanted):
        now = data.qpos[qpos].copy()
        data.qfrc_applied[dofs] = [200, 60] * (angle - now) - [8, 2] * data.qvel[dofs]
        if row % each == 0:
            position.append(now)
            torque.append(data.qfrc_applied[dofs].copy())
        mujoco.mj_step(model, data)
    return sensed(time[::each], np.array(position), np.array(torque) + TRUE.bias, seed)


@pytest.mark.slow
def test_joints_that_stick_as_servos_move_them_in_mujoco_are_told_within_intervals() -> None:
    off = []
    for seed in range(6):
        for one in fit_torques(leg(), [served(seed)], priors=PRIORS).estimates:
            if one.kind in OF_JOINTS:
                true = getattr(TRUE, one.kind)[JOINTS.index(one.subject)]
                off.append((one.mean - true) / one.std)
    assert len(off) == 6 * 8
    assert np.mean(np.abs(off) < 1.96) > 0.9
    assert math.sqrt(np.mean(np.square(off))) < 1.2


def test_what_turns_about_one_axis_is_told_as_a_sum() -> None:
    """The hip's armature and its link's moments are one number; about other axes nothing turns."""
    told = {one.name: one for one in fitted().estimates}
    whole = told["inertia.yy thigh"].mean + told["armature hip"].mean
    whole += MASS[0] * (told["com.z thigh"].mean ** 2 + told["com.x thigh"].mean ** 2)
    assert whole == pytest.approx(
        TRUE.turns[0] + TRUE.armature[0] + MASS[0] * TRUE.lever[0] ** 2, rel=0.05
    )
    assert told["armature hip"].std > 5 * told["armature knee"].std
    for name in ("inertia.yy thigh", "inertia.xx thigh", "inertia.xz shank", "com.y shank"):
        assert told[name].told is Told.PRIOR
    # Friction, damping and bias of both joints, what gravity pulls at in two directions of each
    # link, what turns about each joint, and the knee's armature.
    assert fitted().directions <= 6 + 4 + 2 + 1 + 1  # and when torques are told


def test_torques_that_were_not_fitted_are_predicted_to_their_noise() -> None:
    found = fitted()
    samples = round(found.length * RATE)
    for name, noise in zip(JOINTS, NOISE, strict=True):
        # What is left of noise after Hann's window, and what quanta do to accelerations.
        assert found.by_joint[name] < 2 * noise * math.sqrt(1.5 / samples)
        assert found.by_joint[name] > 0.7 * noise * math.sqrt(1.5 / samples)
        assert found.torque_noise[name] == pytest.approx(found.by_joint[name], rel=0.3)
        assert found.by_joint_before[name] > 5 * found.by_joint[name]
    assert found.held_out_before > 10 * found.held_out
    assert found.held_out == pytest.approx(found.fitted, rel=0.3)
    assert found.explained
    assert found.diagnostics == ()
    assert found.directions < len(found.estimates)


def test_gravity_is_where_the_mjcf_holds_the_base() -> None:
    """A base that is tilted about the joints' axis turns all that hangs from it."""
    tilted = leg('euler="0 0.6 0"')
    log_of = measured(tilt=0.6)
    found = fit_torques(tilted, [log_of], priors=PRIORS)
    assert found.held_out == pytest.approx(fitted().held_out, rel=0.2)
    # Coms that are elsewhere make up for some of it.
    assert fit_torques(leg(), [log_of], priors=PRIORS).held_out > 3 * found.held_out


@pytest.mark.parametrize("sign", [(-1, -1), (1, -1)])
def test_a_torque_of_the_other_sign_is_told(sign: tuple[int, int]) -> None:
    torque = log().torque
    assert torque is not None
    found = fit_torques(leg(), [replace(log(), torque=torque * np.array(sign))])
    codes = {one.code for one in found.diagnostics}
    assert "torque-against-the-model" in codes
    told = next(one for one in found.diagnostics if one.code == "torque-against-the-model")
    wrong = [name for name, one in zip(JOINTS, sign, strict=True) if one < 0]
    assert list(told.values["joints"]) == wrong
    assert found.held_out > 3 * fitted().held_out


@pytest.mark.parametrize("gain", [1.15, 0.85])
def test_a_torque_whose_gain_is_another_is_told_by_the_links_it_carries_with_others(
    gain: float,
) -> None:
    """Of two joints it is told that one is so large beside the other, and not which is right."""
    torque = log().torque
    assert torque is not None
    found = fit_torques(leg(), [replace(log(), torque=torque * [1.0, gain])], priors=PRIORS)
    (told,) = (one for one in found.diagnostics if one.code == "torque-gain-differs")
    ratio = gain if told.values["joint"] == "knee" else 1 / gain
    assert float(str(told.values["gain"])) == pytest.approx(ratio, abs=0.04)


def test_swapped_joints_are_not_explained() -> None:
    torque = log().torque
    assert torque is not None
    found = fit_torques(leg(), [replace(log(), torque=torque[:, ::-1])], priors=PRIORS)
    assert "torques-not-explained" in {one.code for one in found.failures}


def test_a_log_that_is_held_out_is_predicted_and_not_fitted() -> None:
    late = log().part(slice(3000, None))
    found = fit_torques(leg(), [log().part(slice(0, 3000))], priors=PRIORS, hold_out=[late])
    alone = fit_torques(leg(), [log().part(slice(0, 3000))], priors=PRIORS, hold_out=0.0)
    assert found.posterior.mean == pytest.approx(alone.posterior.mean, rel=1e-9, abs=1e-12)
    assert math.isnan(alone.held_out)
    assert found.held_out < 2 * fitted().held_out


def test_a_motor_that_turns_with_both_joints_is_told_apart(tmp_path: Path) -> None:
    """Its friction, damping and armature act on both, by the sum of their motions."""
    whole = measured()
    assert whole.torque is not None
    _, velocity, acceleration = motion(whole.time)
    true = {"friction": 0.4, "damping": 0.15, "armature": 0.03}
    turn = velocity @ [1.0, -0.5]
    gives = true["friction"] * np.sign(turn) + true["damping"] * turn
    gives += true["armature"] * acceleration @ [1.0, -0.5]
    coupled = replace(whole, torque=whole.torque + gives[:, None] * [1.0, -0.5])
    found = fit(leg(), coupled, priors=PRIORS, couplings=["belt=hip+-0.5*knee"])
    assert isinstance(found, TorqueFit)
    told = {one.name: one for one in found.estimates}
    for kind, value in true.items():
        own = told[f"{kind} belt"]
        assert abs(own.mean - value) < 4 * own.std, kind
        assert own.std < 0.25 * value, kind  # an armature is told apart from moments alone
    files = tmp_path / "leg.urdf", tmp_path / "leg.xml"
    for file, text in zip(files, (URDF, MJCF), strict=True):
        file.write_text(text, encoding="utf-8")
    made = fit_files(leg(), found.posterior, files=files)
    left = [one for one in made.diagnostics if one.code == "not-in-the-files"]
    assert {str(one.values["parameter"]) for one in left} == {f"{kind} belt" for kind in true}
    assert found.held_out < 1.3 * fitted().held_out
    assert fit_torques(leg(), [coupled], priors=PRIORS).held_out > 2 * found.held_out


@pytest.mark.parametrize(
    ("text", "factors"),
    [
        ("motor_6=joint_5+joint_6", {"joint_5": 1.0, "joint_6": 1.0}),
        (" belt = l-hip + -0.5*l-knee ", {"l-hip": 1.0, "l-knee": -0.5}),
        ("m=2*a+-b+.25 * c", {"a": 2.0, "b": -1.0, "c": 0.25}),
    ],
)
def test_couplings_are_read(text: str, factors: dict[str, float]) -> None:
    assert parse_coupling(text) == Coupling(text.split("=")[0].strip(), factors)


@pytest.mark.parametrize("text", ["", "hip", "m=hip", "=hip+knee", "m=hip+", "m=hip+hip", "m=2*+a"])
def test_what_is_no_coupling_is_refused(text: str) -> None:
    with pytest.raises(ConfigurationError):
        parse_coupling(text)


def test_a_coupling_is_of_joints_in_the_log_and_has_its_own_name() -> None:
    with pytest.raises(UnknownNameError):
        fit_torques(leg(), [log()], couplings=["belt=hip+toe"])
    with pytest.raises(ConfigurationError):
        fit_torques(leg(), [log()], couplings=["knee=hip+knee"])
    with pytest.raises(ConfigurationError):
        fit(leg(), replace(log(), command=log().position), couplings=["belt=hip+knee"])


@pytest.mark.parametrize("late", [0.03, -0.012])
def test_torques_that_are_told_late_are_put_where_they_belong(late: float) -> None:
    """Without that gravity that is told late would look as friction does."""
    time = log().time
    shifted = measured(true=TRUE)
    random = np.random.default_rng(5)
    torque = torques(*motion(time - late)) + np.array(NOISE) * random.normal(size=(len(time), 2))
    found = fit_torques(leg(), [replace(shifted, torque=torque)], priors=PRIORS)
    told = {one.name: one for one in found.estimates}
    lag = told["lag torques"]
    assert abs(lag.mean - late) < 4 * lag.std
    assert lag.std < 1e-3
    for name, damping in zip(JOINTS, TRUE.damping, strict=True):
        own = told[f"damping {name}"]
        assert abs(own.mean - damping) < 4 * own.std
    assert found.held_out == pytest.approx(fitted().held_out, rel=0.3)
    known = fit_torques(leg(), [replace(shifted, torque=torque)], priors=[*PRIORS, "lag=0"])
    assert "lag torques" not in {one.name for one in known.estimates}
    assert known.held_out > 1.5 * found.held_out


def test_numbers_of_bodies_are_those_of_pinocchio_and_their_derivatives_theirs() -> None:
    robot, random = arm(), np.random.default_rng(0)
    equations = TorqueEquations(robot, list(range(robot.nu)))
    wanted = [
        *(("mass", link, "", mass) for link, mass in equations.mass.items()),
        *(("com", link, axis, value) for link, com in equations.com.items()
          for axis, value in zip("xyz", com.tolist(), strict=True)),
        *(("inertia", link, entry, 0.01) for link in equations.inertia for entry in ENTRIES),
        *((kind, name, "", 0.1) for name in robot.joint_names for kind in OF_JOINTS),
    ]  # fmt: skip
    table = ParameterTable(give_widths(wanted))
    x = table.stated + 0.3 * table.width * random.normal(size=len(table))
    numbers, slopes = equations.numbers(table, x)
    for place, link in enumerate(equations.links.values()):
        mass, *com = (
            table.value(x, kind, link, axis, 0.0)
            for kind, axis in (("mass", ""), *(("com", axis) for axis in "xyz"))
        )
        about = inertia_tensor(table.value(x, "inertia", link, entry, 0.0) for entry in ENTRIES)
        whole = inertia_of(mass, np.array(com), about).toDynamicParameters()
        assert numbers[10 * place : 10 * place + 10] == pytest.approx(whole)
    for place, step in enumerate(1e-4 * table.width):
        moved = x + step * np.eye(len(table))[place]
        change = (equations.numbers(table, moved)[0] - numbers) / step
        assert slopes[:, place] == pytest.approx(change, abs=1e-3 + 1e-3 * np.abs(change).max())


@pytest.mark.parametrize("known", [[], ["mass=0"], ["com=0"]])
def test_torques_are_linear_in_second_moments(known: list[str]) -> None:
    """What a body's ten numbers are at a mean of two vectors is the mean of what they are there."""
    robot, random = arm(), np.random.default_rng(3)
    equations = TorqueEquations(robot, list(range(robot.nu)))
    links = equations.mass
    wanted = [
        *(("mass", link, "", mass) for link, mass in links.items()),
        *(("com", link, axis, value) for link, com in equations.com.items()
          for axis, value in zip("xyz", com.tolist(), strict=True)),
        *(("inertia", link, entry, 0.01) for link in links for entry in ENTRIES),
    ]  # fmt: skip
    table = ParameterTable(give_widths(wanted, [parse_prior(one) for one in known]))
    moments = SecondMoments(table, links)
    ends = table.stated + table.width * random.uniform(-1.5, 1.5, (2, len(table)))
    middle = ends.mean(axis=0)

    def numbers(y: np.ndarray) -> np.ndarray:
        return equations.numbers(table, moments.to_parameters(y))[0]

    one, other = (numbers(end) for end in ends)
    assert numbers(middle) == pytest.approx((one + other) / 2, rel=1e-9, abs=1e-12)
    for end in ends:
        assert moments.of_parameters(moments.to_parameters(end)) == pytest.approx(end)
    assert moments.to_parameters(table.stated) == pytest.approx(table.stated)
    for place, step in enumerate(1e-6 * table.width):
        sides = [middle + sign * step * np.eye(len(table))[place] for sign in (1, -1)]
        above, below = (moments.to_parameters(side) for side in sides)
        change = (above - below) / (2 * step)
        found = moments.derivative(middle)[:, place]
        assert found == pytest.approx(change, abs=1e-6 * (1 + np.abs(change).max()))


def test_a_com_is_as_uncertain_as_the_mass_that_its_moment_is_divided_by() -> None:
    """Of a shank that nobody weighed gravity tells m c alone, and by priors c is (m c) / m."""
    share, width = 0.3, 0.03
    more = ["com:thigh=10", "inertia=10"]  # neither what the hip carries nor moments tell of it
    found = fit_torques(leg(), [log()], priors=[f"mass={share}", f"com={width}", *more])
    told = {one.name: one for one in found.estimates}
    com, mass = told["com.z shank"], told["mass shank"]
    # With m = m0 s and e = (m c) / m0 - c0 s, priors are s = 1 +- share and e = 0 +- width.
    share /= MASS[1]
    file, moment = FILE_LEVER[1], TRUE.lever[1]
    variance = 1 / (1 / share**2 + file**2 / width**2)
    mean = variance * (1 / share**2 + file * moment / width**2)
    assert mass.mean == pytest.approx(MASS[1] * mean, rel=0.02)
    assert mass.std == pytest.approx(MASS[1] * math.sqrt(variance), rel=0.05)
    assert com.mean == pytest.approx(-moment / mean, rel=0.02)
    coms = moment / np.random.default_rng(0).normal(mean, math.sqrt(variance), 99999)
    assert com.std == pytest.approx(np.std(coms), rel=0.1)


def test_torques_of_the_files_numbers_are_those_of_mujoco() -> None:
    """Of a turntable, two elbows and a slide, with its damping."""
    robot, random = arm(), np.random.default_rng(1)
    state = random.uniform(0.1, 1.0, (3, 5, 1, robot.nu))
    told = np.zeros((5, robot.nu))
    blocks = Blocks(*state, told, np.zeros(5, dtype=bool), np.array([[1.0], [0.0]]), 1.0)
    equations = TorqueEquations(robot, list(range(robot.nu)))
    table = ParameterTable(())
    numbers, _ = equations.numbers(table, np.zeros(0))
    found = equations.regressor(blocks)[0] @ numbers
    model = copy.copy(robot.mj_model)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT.value
    data = mujoco.MjData(model)
    dofs = robot.mj_convention.qvel_index
    for row, (position, velocity, acceleration) in enumerate(zip(*state[:, :, 0], strict=True)):
        robot.mj_convention.set_state(data, position, velocity)
        data.qacc[dofs] = acceleration
        mujoco.mj_inverse(model, data)
        assert found[row] == pytest.approx(data.qfrc_inverse[dofs], rel=1e-6, abs=1e-6)


def test_of_friction_no_more_is_known_than_the_whole_torque() -> None:
    whole = log()
    assert whole.torque is not None
    _, velocity, acceleration = motion(whole.time)
    widths = {one.name: one.width for one in fitted().posterior.parameters}
    for at, name in enumerate(JOINTS):
        torque, speed, gain = (
            np.sqrt(np.mean(one[:, at] ** 2)) for one in (whole.torque, velocity, acceleration)
        )
        assert widths[f"friction {name}"] == pytest.approx(torque, rel=0.2)
        assert widths[f"bias {name}"] == pytest.approx(torque, rel=0.2)
        assert widths[f"damping {name}"] == pytest.approx(torque / speed, rel=0.2)
        assert widths[f"armature {name}"] == pytest.approx(torque / gain, rel=0.2)


def test_noise_of_several_joints_belongs_together() -> None:
    """What an encoder's noise does is in the torques of all joints before its own."""
    random = np.random.default_rng(0)
    common, own = random.normal(size=(2, 4000))
    off = np.column_stack([common, 0.6 * common + 0.8 * own])
    off[1:] += 0.5 * off[:-1]  # and is remembered
    noise = [SeriesNoise.of([column]) for column in off.T]
    found = innovations_together(noise, [off])
    assert found == pytest.approx(np.array([[1, 0.6], [0.6, 1]]), abs=0.05)


def test_noise_that_is_common_is_less_in_what_tells_a_difference() -> None:
    """Noise of correlation c makes a sum's variance 1 + c, and a difference's 1 - c, times."""
    count, common = 4000, 0.8
    random = np.random.default_rng(2)
    shared, own = random.normal(size=(2, count))
    noise = np.column_stack([shared, common * shared + math.sqrt(1 - common**2) * own])
    equations = TorqueEquations(leg(), [0, 1])
    table = ParameterTable(
        give_widths([("bias", name, "", 0.0) for name in JOINTS], [parse_prior("bias=100")])
    )
    still, told = np.zeros((3, count, 1, 2)), np.zeros(count, dtype=bool)
    run = Blocks(*still, noise, told, np.array([[1.0], [0.0]]), 1.0)
    known = equations.regressor(run)
    numbers, _ = equations.numbers(table, table.stated)
    torque = noise + known[0] @ numbers
    measured_torques = MeasuredTorques((replace(run, torque=torque),), {}, 0.02, 0.0)
    torques_of = Torques(equations, measured_torques, (known[0],), (known[1],), (torque,))
    covariance = torques_of.fit(table).covariance
    assert covariance * count == pytest.approx(np.array([[1, common], [common, 1]]), rel=0.1)
    for signs, variance in (((1, 1), 2 + 2 * common), ((1, -1), 2 - 2 * common)):
        assert count * np.array(signs) @ covariance @ signs == pytest.approx(variance, rel=0.15)


def test_what_turns_within_a_block_goes_no_one_way() -> None:
    """It may turn between points, at each of which it is fast."""
    speed = np.array([[1.0, 2, 1], [-1, -2, -1], [1, 1, -1], [1, -1, 1], [1, 0.05, 1], [1, 0, -1]])
    least = np.array([0.1])
    assert one_way(speed[:, :, None], least)[:, 0].tolist() == [True, True, *[False] * 4]
    both = np.stack([speed, np.ones_like(speed)], axis=2)
    assert one_way(both, np.array([0.1, 0.1]))[:, 1].all()


def test_motion_is_smoothed_without_a_lag() -> None:
    interval, rate = 0.004, 2 * np.pi * 1.5
    time = interval * np.arange(5000)
    random = np.random.default_rng(1)
    position = np.sin(rate * time) + 1e-4 * random.normal(size=len(time))
    (band,) = find_bands(position[:, None], interval)
    assert 0.7 < band.density / (2 * interval * 1e-8) < 1.1
    # Where noise is so little of accelerations: 8e-11 (2 pi)^4 f^5 / 5 = 1e-3 rate^4 / 2: 44 Hz.
    assert 33 < band.cutoff < 50
    at = time[500:-500] + 0.3 * interval
    found = smooth(position, interval, 12.0, at)
    assert found.velocity == pytest.approx(rate * np.cos(rate * at), abs=0.01 * rate)
    assert found.acceleration == pytest.approx(-(rate**2) * np.sin(rate * at), abs=0.02 * rate**2)
    left = found.velocity - rate * np.cos(rate * at)
    assert band.velocity_noise(12.0) / 2 < left.std() < 1.2 * band.velocity_noise(12.0)


def test_encoders_tell_accelerations_up_to_where_noise_is_little_of_their_power() -> None:
    """Whatever the motion's spectrum: that of joints which stick and jerk has no trough."""
    interval, noise = 0.004, 4e-5
    time = interval * np.arange(10000)
    random = np.random.default_rng(3)
    jerks = np.sign(np.sin(2 * np.pi * 0.7 * time)) * 5.0  # of acceleration
    position = np.cumsum(np.cumsum(jerks - jerks.mean())) * interval**2
    still = np.zeros_like(position)
    noisy = np.column_stack([position, still]) + noise * random.normal(size=(len(time), 2))
    bands = find_bands(noisy, interval)
    # 2 x 0.004 x 1.6e-9 (2 pi)^4 f^5 / 5 = 1e-3 of 12.5, what both do on average: 20 Hz.
    for band in bands:
        assert 15 < band.cutoff < 25
    loud = find_bands(noisy + 30 * noise * random.normal(size=noisy.shape), interval)
    assert loud[0].cutoff < bands[0].cutoff / 3  # goes with the fifth root of the square


def test_nothing_is_put_between_what_is_far_apart() -> None:
    rows = np.r_[0:2000, 2200:4000]
    whole = log()
    assert whole.torque is not None
    gap = replace(whole, time=whole.time[rows], command=whole.command[rows],
                  position=whole.position[rows], torque=whole.torque[rows])  # fmt: skip
    found = measure_torques([gap.of(leg())], [0.0], leg().home)
    assert found is not None
    assert len(found.runs) == 2
    seconds = [run.seconds for run in found.runs]
    assert seconds == pytest.approx([8.0, 7.2], abs=1.0)
    some = whole.position.copy()
    some[100:102, 1] = np.nan  # two samples alone
    found = measure_torques([replace(whole, position=some).of(leg())], [0.0], leg().home)
    assert found is not None
    assert len(found.runs) == 1


def test_joints_that_stand_still_say_nothing_of_friction() -> None:
    found = measure_torques([log().of(leg())], [0.0], leg().home)
    assert found is not None
    (run,) = found.runs
    told = np.isfinite(run.torque)
    one_way = (np.sign(run.velocity) == np.sign(run.velocity[:, :1])).all(axis=1)
    assert (told <= one_way).all()
    assert 0.6 < told.mean() < 1.0


def test_logs_choose_how_they_are_fitted() -> None:
    """Commands by simulation, torques alone by equations; of both by what is asked for."""
    assert isinstance(fit(leg(), log(), priors=PRIORS), TorqueFit)
    both = replace(log(4.0), command=log(4.0).position + 0.01)
    assert isinstance(fit(leg(), both, priors=PRIORS, by="torque"), TorqueFit)
    with pytest.raises(ConfigurationError):
        fit(leg(), both, by="force")
    with pytest.raises(ConfigurationError):
        fit(leg(), both, by="torque", kp=3.0)


@pytest.mark.longest
def test_logs_of_both_are_fitted_by_their_commands() -> None:
    both = replace(log(4.0), command=log(4.0).position + 0.01)
    assert isinstance(fit(leg(), both, priors=PRIORS), MotionFit)


def test_logs_without_torques_or_motion_are_refused() -> None:
    commanded = replace(log(), command=log().position, torque=None)
    with pytest.raises(MeasurementError) as refused:
        fit_torques(leg(), [commanded])
    assert refused.value.cause.code == "joint-without-torque"
    with pytest.raises(MeasurementError) as refused:
        fit_torques(leg(), [log().part(slice(0, 150))])
    assert refused.value.cause.code == "nothing-to-fit"
    still = replace(log(), position=np.zeros_like(log().position))
    with pytest.raises(MeasurementError) as refused:
        fit_torques(leg(), [still])
    assert refused.value.cause.code == "log-without-motion"


def held_for(count: int) -> np.ndarray:
    """Which row each sample has where positions are told anew at every so many."""
    return np.arange(len(log().time)) // count * count


@pytest.mark.parametrize(
    ("position", "code", "values"),
    [
        (lambda: log().position[held_for(5)], "positions-repeated", {"count": 5}),
        (
            lambda: np.random.default_rng(0).uniform(-1, 1, log().position.shape),
            "positions-jump",
            {"joints": list(JOINTS)},
        ),
        (
            lambda: 0.02 * np.sin(2 * np.pi * 12 * log().time)[:, None] * [1.0, 0.7],
            "joints-turn-too-soon",
            {},
        ),
    ],
)
def test_what_ails_positions_is_said(
    position: Callable[[], np.ndarray], code: str, values: dict[str, object]
) -> None:
    with pytest.raises(MeasurementError) as refused:
        fit_torques(leg(), [replace(log(), position=position())])
    assert refused.value.cause.code == code
    for name, value in values.items():
        found = refused.value.cause.values[name]
        assert (list(found) if isinstance(value, list) else found) == value


def test_an_encoder_of_few_steps_that_turns_slowly_repeats_nothing() -> None:
    time = np.arange(0, 10, 0.001)
    angle = 0.3 * np.sin(time)
    coarse = 1e-3 * np.round(angle / 1e-3)
    assert (np.diff(coarse) == 0).mean() > 0.5
    assert repeats(coarse) == 1
    assert repeats(angle) == 1
    assert repeats(coarse[np.arange(len(time)) // 20 * 20]) == 20
    assert repeats(np.r_[angle, np.full(30000, angle[-1])]) == 1  # it rests
    assert repeats(np.zeros(100)) == 1


def test_joints_that_are_bound_to_each_other_are_left_out_by_name(tmp_path: Path) -> None:
    file = tmp_path / "bound.xml"
    bound = '</actuator><equality><joint joint1="knee" joint2="hip"/></equality>'
    file.write_text(MJCF.replace("</actuator>", bound), encoding="utf-8")
    with pytest.raises(ConfigurationError) as refused:
        fit_torques(load_robot(file), [log()])
    assert "leave their columns out" in str(refused.value)
    assert all(name in str(refused.value) for name in JOINTS)
