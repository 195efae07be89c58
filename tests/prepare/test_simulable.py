"""Values with which no simulation is possible are refused with file and line; objects beside a
robot stay objects.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import pupper_analysis as pa
from pupper_analysis.prepare.self_check import compare_nominal_stand
from tests.support import legged
from tests.support.legged import rewrite_file
from tests.support.slips import standing

REFUSED = {
    "timestep 0": ("<option ", '<option timestep="0" ', '<option timestep="0">'),
    "timestep -0.002": ("<option ", '<option timestep="-0.002" ', 'timestep="-0.002"'),
    "timestep 1e-9": (
        "<option ",
        '<option timestep="1e-9" ',
        'timestep="1e-09">: out of range for a simulation',
    ),
    "timestep 1e-300": ("<option ", '<option timestep="1e-300" ', "at least 1e-05; at most 0.1"),
    "timestep 10": ("<option ", '<option timestep="10" ', 'timestep="10"'),
    "impratio -1": ("<option ", '<option impratio="-1" ', "at least 1e-09"),
    "iterations 0": ("<option ", '<option iterations="0" ', 'iterations="0">'),
    "tolerance 1e9": ("<option ", '<option tolerance="1e9" ', "at most 0.01"),
    "tolerance 0.02": ("<option ", '<option tolerance="0.02" ', "at most 0.01"),
    "armature -0.01": (
        'name="FL_knee"',
        'armature="-0.01" name="FL_knee"',
        "joint 'FL_knee' has armature",
    ),
    "a margin of 1e9": (
        'type="plane"',
        'name="f" margin="1e9" type="plane"',
        "geom 'f' has margin",
    ),
    "a joint 1e9 m away": ('name="FL_knee"', 'pos="0 0 1e9" name="FL_knee"', 'has pos="0 0 1e+09"'),
    "a motor's armature -1": (
        'kp="150"',
        'armature="-1" kp="150"',
        "actuator 'FL_roll' has armature",
    ),
    "gear 1e-300": ('kp="150"', 'gear="1e-300" kp="150"', "actuator 'FL_roll' has gear"),
    "gear 1e300": ('kp="150"', 'gear="1e300" kp="150"', "actuator 'FL_roll' has gear"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_model_that_cannot_be_simulated_is_refused_with_its_line(tmp_path: Path, case: str) -> None:
    old, new, message = REFUSED[case]
    pair = standing(tmp_path)
    text = rewrite_file(pair.mjcf, (old, new), count=1).read_text()
    line = next(n for n, row in enumerate(text.splitlines(), 1) if new.strip() in row)
    with pytest.raises(pa.ModelError, match=rf"robot\.xml:{line}: .*{re.escape(message)}"):
        pa.load_robot(*pair)


@pytest.mark.slow
@pytest.mark.parametrize("upper", ["-2.6", "-0.5"])
def test_lower_limit_above_the_upper_limit_is_refused(tmp_path: Path, upper: str) -> None:
    pair = standing(tmp_path)
    stated = ('lower="-2.6" upper="-0.4"', f'lower="-0.4" upper="{upper}"')
    rewrite_file(pair.urdf, stated, count=1)
    with pytest.raises(pa.ModelError, match=r"robot\.urdf:8: joint FL_knee: lower limit -0.4 rad"):
        pa.solve_stand(pa.load_robot(*pair))


@pytest.mark.parametrize("fixed_base", [False, True])
@pytest.mark.parametrize(("urdf_range", "is_disjoint"), [("0.6 0.8", True), ("0.0 0.8", False)])
def test_limits_without_a_common_position_are_refused(
    tmp_path: Path, urdf_range: str, is_disjoint: bool, fixed_base: bool
) -> None:
    """A posture within one file's limits would violate the other file's limits."""
    pair = legged.quadruped(tmp_path)
    lower, upper = urdf_range.split()
    joint = re.compile(r'(<joint name="FR_roll".*?<limit lower=")[^"]*(" upper=")[^"]*', re.DOTALL)
    pair.urdf.write_text(joint.sub(rf"\g<1>{lower}\g<2>{upper}", pair.urdf.read_text()))
    text, joint = pair.mjcf.read_text(), re.compile(r'(<joint name="FR_roll"[^>]*range=")[^"]*')
    pair.mjcf.write_text(joint.sub(r"\g<1>-0.8 0.5", text))
    if is_disjoint:
        with pytest.raises(pa.ModelError, match=r"'FR_roll'.*no position in common"):
            pa.load_robot(*pair, fixed_base=fixed_base)
        return
    robot = pa.load_robot(*pair, fixed_base=fixed_base)
    assert robot.floating is not fixed_base
    roll = robot.joint_names.index("FR_roll")
    assert robot.lower_limits[roll] == pytest.approx(0.0)
    assert robot.upper_limits[roll] == pytest.approx(0.5)


@pytest.mark.slow
@pytest.mark.parametrize("first", [True, False])
def test_keyframe_of_the_robot_alone_is_used_if_the_scene_has_a_free_ball(
    tmp_path: Path, first: bool
) -> None:
    """The keyframe states only the robot's coordinates, and MuJoCo appends zeros. If the ball comes
    first, the values of the base are those of the ball, and the verdict fails.
    """
    urdf, mjcf = pa.pupper.write_variant("heavy", tmp_path)
    ball = '<body name="ball" pos="2 0 0.1"><freejoint/><geom size="0.1"/></body>'
    begin, end = "<worldbody>", "</worldbody>"
    rewrite_file(mjcf, (begin, begin + ball) if first else (end, ball + end), count=1)
    feet = {foot: f"{foot}_foot" for foot in ("FL", "FR", "RL", "RR")}
    robot = pa.load_robot(urdf=urdf, mjcf=mjcf, feet=feet)
    verdict = pa.judge_stand(robot, pa.solve_stand(robot, pa.StandTask(height=0.15)))
    assert verdict.with_feedforward == "holds"
    assert verdict.passed is not first


def test_legs_that_a_file_holds_in_the_world_are_freed(tmp_path: Path) -> None:
    """The published model keeps its fixed base, which is the cause of the difference."""
    pair = legged.quadruped(tmp_path, free=False, keyframe="", actuators="position")
    robot = pa.load_robot(*pair)
    assert robot.floating
    published = compare_nominal_stand(robot)
    assert published is not None
    assert [cause.code for cause in published.causes] == ["base-held"]


def test_a_free_base_without_mass_is_refused_with_link_and_line(
    tmp_path: Path,
) -> None:
    """MuJoCo: "mass and inertia of moving bodies must be larger than mjMINVAL"."""
    urdf = legged.quadruped(tmp_path).urdf
    trunk = '<mass value="4.0"/><inertia ixx="0.02" iyy="0.05" izz="0.06"'
    massless = '<mass value="0"/><inertia ixx="0" iyy="0" izz="0"'
    rewrite_file(urdf, (trunk, massless))
    robot = pa.load_robot(urdf)
    with pytest.raises(pa.ModelError, match=r"robot.urdf:\d+: link 'trunk' .*no mass"):
        pa.solve_stand(robot)


def test_a_urdf_without_inertials_is_refused_beside_a_complete_mjcf(tmp_path: Path) -> None:
    """Rotor inertia of the MJCF keeps the mass matrix regular, and all torques would be zero."""
    pair = legged.quadruped(tmp_path)
    inertial = re.compile(r"<inertial>.*?</inertial>", re.DOTALL)
    pair.urdf.write_text(inertial.sub("", pair.urdf.read_text()))
    armature = pair.mjcf.read_text().replace(" axis=", ' armature="0.01" axis=')
    pair.mjcf.write_text(armature)
    with pytest.raises(pa.ModelError, match="the mass of all links is 0 kg"):
        pa.load_robot(*pair)


def test_massless_legs_below_a_heavy_base_are_refused_with_link_and_line(tmp_path: Path) -> None:
    """MuJoCo refuses each leg; the message does not contain a mass of the base."""
    urdf = legged.quadruped(tmp_path).urdf
    inertial = re.compile(r"<inertial>.*?</inertial>", re.DOTALL)
    first, *legs = inertial.split(urdf.read_text())
    base = inertial.search(urdf.read_text())
    assert base is not None
    urdf.write_text(first + base[0] + "".join(legs))
    with pytest.raises(pa.ModelError, match=r"robot.urdf:\d+: link .*can move and has no mass"):
        pa.load_robot(urdf)
