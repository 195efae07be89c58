"""One oddity is planted in a sound robot's MJCF: what is told of it first is that, or nothing."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.models.mjcf import silence_mujoco
from pupper_analysis.models.transmission import Drive
from pupper_analysis.present.verdict import in_words, verdict_clauses
from pupper_analysis.simulation.verdict import Verdict
from tests.support.planted import PLANTS, ROBOTS, planted

NEVER = {
    *("holds-in-mujoco", "fails-in-mujoco", "fails-alone", "collapses-as-published"),
    *("off-as-published", "own-run", "own-run-diverges", "deviation-doubles", "in-balance"),
    *("on-servos-made-up", "rests-on-placeholder-efforts", "on-balls-for-soles"),
    *("gravity-not-the-earths",),
}
"""Codes of what is seen, and is no cause."""

CONSEQUENCES = {"motors-overloaded", "limbs-unlike", "foot-buried"}
"""Of what is too weak, or loads it; of one joint whose range is no longer its like's; of feet that
sink: told beside the cause, and true."""


def causes(verdict: Verdict) -> list[str]:
    """Returns what is told of a verdict's causes, the first first."""
    found = []
    for clause in verdict_clauses(verdict):
        code = clause.message.code
        own = verdict.own if code == "own-run" else None
        joint = None if own is None else own.unheld or own.worst
        if code == "fails-in-mujoco":
            found += [
                "files-differ" for one in verdict.failures if one.code == "files-of-two-robots"
            ]
        elif own is not None and own.fails and joint is not None:
            found += ["own-run"] if joint.drive is not Drive.SERVO or joint.commanded_away else []
        elif code not in NEVER:
            found.append(code)
    return found


def judged(urdf: Path, mjcf: Path) -> Verdict:
    loaded = pa.load_robot(urdf=urdf, mjcf=mjcf)
    return pa.judge_stand(loaded, pa.solve_stand(loaded))


@silence_mujoco()
def stands(mjcf: Path, seconds: float = 5.0) -> bool:
    """Tells whether a file with a keyframe stays upright by itself, in bare MuJoCo."""
    model = mujoco.MjModel.from_xml_path(str(mjcf))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    base = int(model.jnt_bodyid[0])
    mujoco.mj_kinematics(model, data)
    up = data.xmat[base].reshape(3, 3)[2].copy()
    for _ in range(round(seconds / model.opt.timestep)):
        mujoco.mj_step(model, data)
    return bool(np.isfinite(data.qpos).all() and up @ data.xmat[base].reshape(3, 3)[2] > 0.8)


def right(
    folder: Path, robot: str, plant: str, judged: Callable[[Path, Path], Verdict] = judged
) -> bool | None:
    """Tells whether what is told of a plant first is right; None if it does no harm.

    Nothing else may be told of it, first or last, and no verdict is better than bare MuJoCo.
    """
    urdf, mjcf = planted(folder, robot, plant)
    allowed = PLANTS[plant][1]
    try:
        verdict = judged(urdf, mjcf)
    except pa.PupperAnalysisError as error:
        stated = (error.diagnostic, *error.diagnostic.values.values())
        return bool({getattr(one, "code", "") for one in stated} & set(allowed))
    message = causes(verdict)
    assert set(message) <= {*allowed, *CONSEQUENCES}, (robot, plant, message, in_words(verdict))
    if verdict.passed and not message:
        assert robot == "arm" or stands(mjcf), (robot, plant, in_words(verdict))
        return None
    return bool(message) and message[0] in allowed


STANDING = tuple(robot for robot in ROBOTS if robot != "arm")  # hold's tests have the arm

PAIRS = [(robot, plant) for robot in STANDING for plant in PLANTS]


@pytest.mark.parametrize("robot", STANDING)
def test_of_what_is_sound_nothing_is_told(tmp_path: Path, robot: str) -> None:
    verdict = judged(*planted(tmp_path, robot, None))
    assert verdict.passed, in_words(verdict)
    assert causes(verdict) == []


SAMPLE = [PAIRS[int(number)] for number in np.random.default_rng(43).choice(len(PAIRS), 8)]


@pytest.mark.parametrize(("robot", "plant"), SAMPLE)
def test_of_a_sample_the_right_one_is_told(tmp_path: Path, robot: str, plant: str) -> None:
    assert right(tmp_path, robot, plant) is not False


@pytest.mark.parametrize(
    ("robot", "plant", "cause"),
    [
        ("quad", "springs", "springs-pull"),
        ("quad", "springs that stiffen", "springs-pull"),
        ("quad", "a tendon that stiffens", "springs-pull"),
        ("pupper", "gravity aside", "gravity-aside"),
        ("quad", "affine gains", "gain-is-not-fixed"),
        ("ring", "soft contacts", "contacts-give-way"),
        ("ring", "a pair's friction", "contacts-slip"),
        ("ring", "a foot that does not touch", "limb-without-foot"),
    ],
)
def test_what_nothing_else_explains_is_told(
    tmp_path: Path, robot: str, plant: str, cause: str
) -> None:
    verdict = judged(*planted(tmp_path, robot, plant))
    assert not verdict.passed
    assert cause in causes(verdict), in_words(verdict)


@pytest.mark.longest
@pytest.mark.parametrize("robot", STANDING)
def test_the_right_one_is_told_of_nine_in_ten(tmp_path: Path, robot: str) -> None:
    found = {plant: right(tmp_path, robot, plant) for one, plant in PAIRS if one == robot}
    harmful = [plant for plant, message in found.items() if message is not None]
    missed = [plant for plant in harmful if not found[plant]]
    assert len(harmful) >= len(found) // 2
    assert len(missed) <= 0.1 * len(harmful), missed
