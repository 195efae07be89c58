"""One fault is planted in the file of a quadruped that stands: the first reported cause is this
fault, or none.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.models.mjcf import silence_mujoco
from pupper_analysis.models.transmission import Drive
from pupper_analysis.present.verdict import format_verdict, verdict_clauses
from pupper_analysis.simulation.verdict import Verdict
from tests.support import features
from tests.support.every_command import make_verdict_cell, simulate_truth
from tests.support.features import LEGS, Edit, make_replacement, make_section_edit
from tests.support.repository import ROOT
from tests.support.slips import standing

NEVER = {
    *("holds-in-mujoco", "fails-in-mujoco", "fails-alone"),
    *("collapses-as-published", "lifted-as-published"),
    *("off-as-published", "own-run", "own-run-diverges", "deviation-doubles", "in-balance"),
    *("stand-creeps", "mode-refuted"),
    *("on-servos-made-up", "on-balls-for-soles"),
    *("rests-on-placeholder-efforts", "rests-on-placeholder-inertias"),
    *("gravity-not-the-earths", "weight-is-compensated"),
}
"""Codes of observations, which are no causes."""

CONSEQUENCES = {
    *("motors-overloaded", "foot-buried", "foot-slid", "joint-held-by-nothing"),
    "solver-error-moves",
}
"""Codes of true consequences that may be reported beside the cause: overloaded motors, feet that
sink, feet that slide without feed-forward, joints without position control, motion that MuJoCo's
solver causes."""


def servos(words: str) -> Edit:
    return make_replacement('kp="150" kv="5"', words)


def make_general_servos(
    gain: float = 1.0, bias: float = 0.0, kind: str = "fixed", *, only: str = ""
) -> Edit:
    """Return the edit to general actuators with a factor of the gain, a bias [rad], and, if `kind`
    is "affine", a gain that depends on the length.
    """
    more = " 75 0" if kind == "affine" else ""
    law = f'gaintype="{kind}" gainprm="{150 * gain:g}{more}" biasprm="{150 * bias:g} -150 -5"'
    old = rf'<position joint="(\w*{only})" kp="150" kv="5"/>'
    return lambda text: re.sub(old, rf'<general joint="\1" {law} biastype="affine"/>', text)


def option(words: str, inside: str = "") -> Edit:
    usual = '<option integrator="implicitfast"'
    return make_replacement(f"{usual}/>", f"{usual} {words}>{inside}</option>")


def floor(words: str) -> Edit:
    return make_replacement('type="plane"', f'type="plane" priority="9" {words}')


def feet(words: str, count: int = -1) -> Edit:
    return make_replacement('size="0.02"', f'size="0.02" {words}', count)


def joints(which: str, words: str) -> Edit:
    return make_replacement(f'_{which}" axis', f'_{which}" {words} axis')


def add_block(words: str) -> Edit:
    """Return the edit that adds a box of 30 mm under the front left foot."""
    shape = '<geom type="box" size="0.6 0.6 0.015"/>'
    return make_replacement(
        "<worldbody>", f'<worldbody><body pos="0.6 0.6 0" {words}>{shape}</body>'
    )


def tendon(words: str, *names: str) -> Edit:
    parts = "".join(f'<joint joint="{name}" coef="1"/>' for name in names)
    return make_section_edit(f"<tendon><fixed {words}>{parts}</fixed></tendon>")


def combine_edits(*edits: Edit) -> Edit:
    def edit(text: str) -> str:
        for edit in edits:
            text = edit(text)
        return text

    return edit


ROLLS = [f"{leg}_roll" for leg in LEGS]
JET = '<general site="nozzle" gear="0 0 1 0 0 0" biastype="affine" gainprm="0" biasprm="16.5 0 0"/>'
UNEVEN = "gain-is-no-stiffness, own-run"
ELSEWHERE = "own-run, keyframe-commands-another-pose, keyframe-commands-elsewhere"

ODD: dict[str, tuple[str, ...]] = {
    "joint actuatorfrcrange": ("motors-overloaded", "actuatorfrcrange-cuts-off"),
    "welded to the world": ("weld-holds-it",),
    "connected to the world": ("connect-holds-it",),
    "an extra limb": ("files-differ", "own-run"),
    "a heavier trunk": ("files-differ",),
    "an exclude of a foot": ("excluded-from-touching",),
    "a tilted floor": ("ground-not-level-as-published",),
    "no actuation": ("support-disabled",),
    "no contacts": ("support-disabled",),
    "one iteration": ("solver-too-rough",),
    "a time step of 20 ms": ("timestep-too-long",),
    "contacts overridden": ("contacts-overridden",),
    "servos in a disabled group": ("actuators-disabled",),
    "timeconst 1e5": ("timeconst-too-long",),
    "gear -1": ("gear-is-negative", "own-run"),
    "gear -1 at a knee": ("gear-is-negative", "own-run"),
    "forcerange 2": ("forcerange-cuts-off",),
    "ctrlrange narrow": ("ctrlrange-cuts-off",),
    "kp -150 at a knee": ("own-servos-fail",),
    "kp 0 at a knee": ("own-servos-fail", "own-run"),
    "motors": ("own-run", "motors-commanded-angles"),
    "a keyframe's ctrl of zeros": ("own-run", "keyframe-commands-another-pose"),
}
"""{feature: codes of causes that may be reported}; ``own-run`` if the reported joint has this drive
or command.
"""

PLANTS: dict[str, tuple[Edit, str]] = {
    "a bias beside all servos": (make_general_servos(bias=0.07), "servos-are-biased"),
    "a bias beside one servo": (make_general_servos(bias=0.1, only="FL_knee"), "servos-are-biased"),
    "a gain 1.2 times the stiffness": (make_general_servos(1.2), "gain-is-no-stiffness"),
    "a gain of one, 1.4 times": (make_general_servos(1.4, only="FL_knee"), UNEVEN),
    "affine gains": (make_general_servos(kind="affine"), "own-run, servos-for-actuators"),
    "a tendon's spring": (
        tendon('stiffness="45" springlength="1"', "FL_pitch", "FL_knee"),
        "springs-pull",
    ),
    "springs": (joints("roll", 'stiffness="3" springref="25"'), "springs-pull"),
    "springs that stiffen": (
        joints("roll", 'stiffness="0 0 0.075" springref="10"'),
        "springs-pull",
    ),
    "a tendon that stiffens": (
        tendon('stiffness="0 0 0.075" springlength="10"', *ROLLS),
        "springs-pull",
    ),
    "a mocap obstacle": (add_block('mocap="true"'), "obstacles-touch"),
    "an obstacle": (add_block(""), "obstacles-touch"),
    "a delay": (servos('kp="150" kv="5" delay="0.1" nsample="101"'), "servos-are-late"),
    "a step of 10 ms": (option('timestep="0.01"'), "timestep-too-long"),
    "PGS, 3 iterations": (option('solver="PGS" iterations="3"'), "solver-too-rough"),
    "a weld of a foot": (
        make_section_edit('<equality><weld body1="FL_calf"/></equality>'),
        "weld-holds-it",
    ),
    "one velocity servo": (
        make_replacement(
            '<position joint="FL_knee" kp="150" kv="5"/>', '<velocity joint="FL_knee" kv="1"/>'
        ),
        "own-run, servos-for-actuators",
    ),
    "a base without weight": (
        make_replacement('name="trunk"', 'gravcomp="1" name="trunk"'),
        "files-differ",
    ),
    "a range that cuts the pose": (
        make_replacement('range="-2.6 -0.4"', 'range="-2.6 -1.5"', 1),
        "range-stops",
    ),
    "a margin of contacts": (feet('margin="0.02"'), "files-differ"),
    "condim 1": (floor('condim="1"'), "feet-without-friction"),
    "friction of 0.01": (floor('friction="0.01 0.005 0.0001"'), "contacts-slip"),
    "soft contacts": (floor('solref="0.3 1"'), "contacts-give-way"),
    "a thruster": (
        combine_edits(
            make_replacement("<freejoint/>", '<freejoint/><site name="nozzle"/>'),
            make_replacement("</actuator>", f"{JET}</actuator>"),
            make_replacement('-1.2"/>', '-1.2 0"/>'),
        ),
        "motors-elsewhere-push",
    ),
    "a fluid": (option('density="1000" viscosity="1"'), "fluid-drags"),
    "wind": (option('density="1.2" wind="30 0 0"'), "fluid-drags"),
    "damping below zero": (
        make_replacement(" axis=", ' damping="-0.5" axis='),
        "joints-damped-negatively, rests-on-made-up",
    ),
    "gravity aside": (option('gravity="4 0 -9"'), "gravity-aside, files-differ"),
    "a foot that does not touch": (feet('contype="0" conaffinity="0"', 1), "limb-without-foot"),
    "a command elsewhere": (make_replacement('ctrl="0 0.6 -1.2', 'ctrl="0 0.6 -0.6', 1), ELSEWHERE),
}
"""{fault: (edit that plants it, codes of causes that may be reported)}."""


def causes(verdict: Verdict) -> list[str]:
    """Return the codes of the causes in a verdict, the first cause first."""
    found = []
    for clause in verdict_clauses(verdict):
        code = clause.message.code
        own = verdict.keyframe_run if code == "own-run" else None
        joint = None if own is None else own.unheld or own.worst
        if code == "fails-in-mujoco":
            named = {
                "files-of-two-robots": "files-differ",
                "feet-without-friction": "feet-without-friction",
            }
            found += [named[failure.code] for failure in verdict.failures if failure.code in named]
        elif own is not None and own.fails and joint is not None:
            found += ["own-run"] if joint.drive is not Drive.SERVO or joint.commanded_away else []
        elif code not in NEVER:
            found.append(code)
    return found


def judge_files(urdf: Path, mjcf: Path) -> Verdict:
    loaded = pa.load_robot(urdf=urdf, mjcf=mjcf)
    return pa.judge_stand(loaded, pa.solve_stand(loaded))


@silence_mujoco()
def stands(mjcf: Path, seconds: float = 5.0) -> bool:
    """Return True if a file with a keyframe stays upright in bare MuJoCo."""
    model = mujoco.MjModel.from_xml_path(str(mjcf))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    base = int(model.jnt_bodyid[0])
    mujoco.mj_kinematics(model, data)
    up = data.xmat[base].reshape(3, 3)[2].copy()
    for _ in range(round(seconds / model.opt.timestep)):
        mujoco.mj_step(model, data)
    return bool(np.isfinite(data.qpos).all() and up @ data.xmat[base].reshape(3, 3)[2] > 0.8)


def is_cause_right(
    urdf: Path,
    mjcf: Path,
    allowed: tuple[str, ...],
    judged: Callable[[Path, Path], Verdict] = judge_files,
) -> bool | None:
    """Return True if the first reported cause is one of the permitted causes, and None if the fault
    does no harm. No other cause may be reported, except consequences of the fault.
    """
    try:
        verdict = judged(urdf, mjcf)
    except pa.PupperAnalysisError as error:
        stated = (error.diagnostic, *error.diagnostic.values.values())
        return bool({getattr(item, "code", "") for item in stated} & set(allowed))
    message = causes(verdict)
    assert set(message) <= {*allowed, *CONSEQUENCES}, (message, format_verdict(verdict))
    if verdict.passed and set(message) <= {"foot-slid"}:  # a warning of a stand that holds
        return None
    return bool(message) and message[0] in allowed


def plant_fault(folder: Path, plant: str) -> tuple[Path, Path]:
    """Return the URDF and the MJCF of a quadruped with a planted fault."""
    if plant in ODD:
        return features.write_files(folder, features.FEATURES[plant])
    pair = standing(folder)
    pair.mjcf.write_text(PLANTS[plant][0](pair.mjcf.read_text()))
    return pair.urdf, pair.mjcf


@pytest.mark.slow
def test_correct_files_have_no_cause_of_failure(tmp_path: Path) -> None:
    """Control of the planted faults: the same quadruped without a fault."""
    verdict = judge_files(*standing(tmp_path))
    assert verdict.passed, format_verdict(verdict)
    assert causes(verdict) == []


HARMLESS = {
    *("a tendon's spring", "a base without weight", "a margin of contacts"),
    *("a fluid", "a range that cuts the pose"),
}
"""Faults with which the robot stands in bare MuJoCo as well: no cause is reported."""


@pytest.mark.slow
@pytest.mark.parametrize("plant", [*PLANTS, *ODD])
def test_planted_fault_is_named_as_the_cause(tmp_path: Path, plant: str) -> None:
    """Reference: bare MuJoCo, in which the file falls if a cause is required (`stands`). For `ODD`,
    no verdict is better than the outcome in bare MuJoCo (`simulate_truth`).
    """
    urdf, mjcf = plant_fault(tmp_path, plant)
    allowed = ODD[plant] if plant in ODD else tuple(PLANTS[plant][1].split(", "))
    verdicts: list[Verdict] = []

    def judge(urdf: Path, mjcf: Path) -> Verdict:
        verdicts.append(judge_files(urdf, mjcf))
        return verdicts[-1]

    found = is_cause_right(urdf, mjcf, allowed, judge)
    assert found is (None if plant in HARMLESS else True)
    assert found or stands(mjcf)
    if plant == "joint actuatorfrcrange":  # the overloaded motors, then the range that limits them
        assert causes(verdicts[0])[:2] == list(allowed)
    if plant in ODD:
        (tmp_path / "plain").mkdir()
        truth = simulate_truth(mjcf, standing(tmp_path / "plain").mjcf)
        cells = map(make_verdict_cell, verdicts)
        assert not [wrong for cell in cells if (wrong := cell.find_objection(truth))]


@pytest.mark.slow
def test_horizontal_gravity_is_named_as_a_cause(tmp_path: Path) -> None:
    """Gravity of (4, 0, -9) m/s^2."""
    shutil.copytree(ROOT / "mjcf", tmp_path / "mjcf")
    shared = tmp_path / "mjcf/pupper_v3_shared.xml"
    shared.write_text(make_replacement("0 0 -9.81", "4 0 -9")(shared.read_text()))
    verdict = judge_files(ROOT / "urdf/pupper_v3.urdf", tmp_path / "mjcf/pupper_v3.xml")
    assert not verdict.passed
    assert "gravity-aside" in causes(verdict), format_verdict(verdict)
