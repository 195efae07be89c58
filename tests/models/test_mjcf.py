"""MJCF specs are written without loss, and numbers that no computation can use are refused by
name.
"""

from __future__ import annotations

import math
import re
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.base.errors import ModelError
from pupper_analysis.models.mjcf import (
    add_geom,
    add_plane,
    add_site,
    compile_spec,
    find_invalid_number,
    silence_mujoco,
    to_xml,
)
from pupper_analysis.models.mjcf_file import read_mjcf
from pupper_analysis.models.spec_tree import SpecTree
from pupper_analysis.prepare.convert.load import load_robot
from pupper_analysis.tools.audit.audit import audit_model
from pupper_analysis.tools.convert.model import convert_model
from pupper_analysis.tools.crosscheck.crosscheck import compare_models
from pupper_analysis.tools.diff.compare import diff_models
from tests.support.robots import mjcf_text, quadruped, urdf_text, write

FRAMES = """<mujoco><worldbody>
<geom size="0.111111111"/>
<frame name="f" pos="0.123456789 0 0">
  <geom name="in f" size="0.222222222" pos="1.23456789 0 0"/>
  <frame><geom name="in nothing" size="0.333333333"/></frame>
  <body name="a" pos="0 0.987654321 0"><freejoint/>
    <frame pos="0 0 0.123456781"><geom name="deep" size="0.444444444"/><site name="s"/></frame>
    <geom name="plain" size="0.555555555"/>
    <body name="b"><joint name="hinge" pos="0.777777777 0 0" axis="0 1 0"/>
      <frame pos="1 2 3.333333333"><geom size="0.1"/></frame></body>
  </body>
  <geom name="after" size="0.666666666"/>
</frame>
<replicate count="2" offset="1.111111111 0 0"><geom name="r" size="0.888888888"/></replicate>
<body name="c" pos="0.999999999 5 0"><joint/><geom size="0.123123123"/></body>
</worldbody></mujoco>"""


def test_frames_are_written_with_all_digits() -> None:
    """MuJoCo's own writer rounds to six; a body's elements may be in frames of frames."""
    spec = mujoco.MjSpec.from_string(FRAMES)
    one = spec.copy().compile()
    two = mujoco.MjModel.from_xml_string(to_xml(spec))
    rounded = mujoco.MjModel.from_xml_string(spec.to_xml())
    assert np.abs(one.geom_pos - rounded.geom_pos).max() > 1e-8
    for name in ("geom_pos", "geom_size", "body_pos", "jnt_pos", "site_pos", "body_mass"):
        np.testing.assert_allclose(getattr(two, name), getattr(one, name), rtol=1e-12, atol=1e-15)


WORLD, TOO_MUCH = "<worldbody>", ("0 0 1e300", "1e300 0 -9.81", "0 nan -9.81")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('pos="0.0 0.08 -0.2"', 'pos="0.0 nan -0.2"', "body 'shank0': pos contains nan"),
        ('axis="0.0 1.0 0.0"', 'axis="0.0 inf 0.0"', "joint 'knee0': axis contains"),
        ('axis="0.0 1.0 0.0"', 'axis="0 -1e308 0"', "joint 'knee0': the axis has no direction"),
        ('damping="0.1"', 'damping="nan"', "joint 'hip0': damping contains nan"),
        (
            'frictionloss="0.2"',
            'frictionloss="1e300"',
            "joint 'hip0': frictionloss contains 1e+300",
        ),
        ('mass="1.0"', 'mass="1e200"', "body 'thigh0': mass contains 1e+200"),
        ('<site name="foot0" pos="0.002', '<site name="foot0" pos="nan', "site 'foot0': pos"),
        ('range="-1.0 0.9"', 'range="nan 0.9"', "value of jnt_range is nan"),
        *((WORLD, f'<option gravity="{number}"/>{WORLD}', "gravity") for number in TOO_MUCH),
    ],
)
def test_invalid_numbers_are_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    """NaN, infinite and huge numbers in reading, comparing and compiling; `audit` reports the same
    text as reading. Files with NaN are refused by their text, which has line numbers.
    """
    text = mjcf_text(quadruped())
    assert old in text
    files = write(tmp_path, urdf_text(quadruped()), text.replace(old, new, 1))
    in_file = "'nan' is not a finite number" if "nan" in new else message
    for read, expected in (
        (lambda: read_mjcf(files.mjcf), in_file),
        (lambda: compare_models(*files), in_file),
        (lambda: compile_spec(mujoco.MjSpec.from_file(str(files.mjcf)), files.mjcf), message),
    ):
        with pytest.raises(ModelError) as refusal:
            read()
        assert expected in str(refusal.value)
    audit = audit_model(files.mjcf)
    assert any(in_file in finding.message for finding in audit.findings)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('pos="0.01 0.002 -0.005"', 'pos="nan 0 0"', "body 'base': <inertial pos='nan 0 0'>"),
        (WORLD, f'{WORLD}<geom name="a" size="1" mass="NaN"/>', "geom 'a': <geom mass='NaN'>"),
        (WORLD, f'<option impratio="nan"/>{WORLD}', ": <option impratio='nan'>"),
        (WORLD, f'<compiler settotalmass="nan"/>{WORLD}', ": <compiler settotalmass='nan'>"),
    ],
)
def test_nan_that_mujoco_reads_as_unspecified_is_refused_with_its_line(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    """MuJoCo compiles each file: with another CoM, another mass or other options."""
    text = mjcf_text(quadruped())
    assert old in text
    text = text.replace(old, new, 1)
    with silence_mujoco():
        mujoco.MjModel.from_xml_string(text)
    path = tmp_path / "robot.xml"
    path.write_text(text)
    with pytest.raises(ModelError) as refusal:
        read_mjcf(path)
    assert message in str(refusal.value)
    line = text[: text.index(new)].count("\n") + 1
    assert f"robot.xml:{line}: " in str(refusal.value)


def test_word_nan_in_a_text_is_no_number(tmp_path: Path) -> None:
    """MuJoCo compiles the file."""
    note = '<custom><text name="note" data="no value is nan"/></custom>'
    text = mjcf_text(quadruped()).replace(WORLD, f"{note}{WORLD}", 1)
    text = re.sub('<mujoco( model="[^"]*")?', '<mujoco model="robot nan"', text, count=1)
    with silence_mujoco():
        mujoco.MjModel.from_xml_string(text)
    path = tmp_path / "robot.xml"
    path.write_text(text)
    assert read_mjcf(path).model.nbody > 1


@pytest.mark.slow
@pytest.mark.parametrize("function", ["crosscheck", "diff", "sync", "convert", "load"])
def test_joint_far_away_gives_no_warning_of_mujoco(
    function: str, tmp_path: Path, mujoco_log: Path
) -> None:
    """Reference: MuJoCo warns that an inertia is almost singular. Warnings are errors in tests."""
    far = mjcf_text(quadruped()).replace('pos="0.0 0.08 -0.2"', 'pos="1e21 0.08 -0.2"', 1)
    files = write(tmp_path, urdf_text(quadruped()), far)
    with pytest.warns(UserWarning, match="too close to singular"):
        mujoco.MjSpec.from_string(far).compile()
    mujoco_log.unlink(missing_ok=True)
    if function == "crosscheck":
        assert "1e+24 mm apart" in compare_models(*files).differences[0].message
    elif function == "diff":
        assert not diff_models(files.mjcf, files.mjcf).changes
    elif function == "sync":
        assert pa.sync_models(*files, take="urdf").not_mended
    elif function == "convert":
        with pytest.raises(ModelError, match="at most 10000"):
            convert_model(files.mjcf, tmp_path / "other.urdf")
    else:
        with pytest.raises(ModelError, match="at most 10000"):
            load_robot(urdf=files.urdf, mjcf=files.mjcf)
    assert not mujoco_log.exists()


@pytest.mark.parametrize("word", ["%s%n", "a%20s", "%-5.3ls"])
def test_names_that_are_formats_are_refused(tmp_path: Path, word: str) -> None:
    """MuJoCo uses the name of a class as a format string, and crashes on `%s`."""
    file = tmp_path / "robot.xml"
    file.write_text(
        mjcf_text(quadruped()).replace('<site name="foot0"', f'<geom class="{word}"/><site name=""')
    )
    with pytest.raises(ModelError, match="interprets % as a format"):
        read_mjcf(file)


@pytest.mark.parametrize("word", ["100 % of it", "50%", "%d", "%%"])
def test_other_percent_signs_in_names_are_accepted(tmp_path: Path, word: str) -> None:
    file = tmp_path / "robot.xml"
    file.write_text(mjcf_text(quadruped()).replace("foot0", word))
    assert read_mjcf(file).refusal is None


def test_limits_of_1e300_are_accepted() -> None:
    """Public files have such limits for continuous joints."""
    text = mjcf_text(quadruped()).replace('range="-1.0 0.9"', 'range="-1e300 1e300"', 1)
    assert find_invalid_number(mujoco.MjModel.from_xml_string(text)) is None


def test_mujoco_crashes_on_a_format_string_in_a_class_name(tmp_path: Path) -> None:
    """Reason for the refusal of such files.

    If this test fails, MuJoCo is repaired, and the refusal can be removed.
    """
    file = tmp_path / "robot.xml"
    file.write_text('<mujoco><worldbody><geom class="%s%n"/></worldbody></mujoco>')
    code = f"import mujoco; mujoco.MjModel.from_xml_path({str(file)!r})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=False)
    assert done.returncode < 0


@pytest.mark.parametrize("tag", ["geom", "body", "inertial"])
def test_rotation_without_an_axis_is_refused(tag: str, tmp_path: Path) -> None:
    """MuJoCo compiles a quaternion of almost zero norm, and crashes at the first contact."""
    turn = {tag: 'quat="1e-9 1e-9 1e-9 1e-9"'}
    path = tmp_path / "robot.xml"
    path.write_text(
        '<mujoco><worldbody><geom name="floor" type="plane" size="0 0 1"/>'
        f'<body name="base" pos="0 0 0.1" {turn.get("body", "")}><freejoint/>'
        f'<inertial pos="0 0 0" mass="1" diaginertia="1 1 1" {turn.get("inertial", "")}/>'
        f'<geom type="box" size="0.1 0.1 0.1" {turn.get("geom", "")}/></body></worldbody>'
        '<keyframe><key name="home" qpos="0 0 0.09 1 0 0 0"/></keyframe></mujoco>'
    )
    with pytest.raises(ModelError) as caught:
        read_mjcf(path)
    assert caught.value.cause.code == "quaternion-without-direction"
    assert audit_model(path).counts["error"]


_STICKY = """<mujoco><default><geom adhesion="3" surfacevel="0.5 0 0 0 0 0"/></default><worldbody>
<geom name="belt" type="plane" size="1 1 1"/><body name="foot"><freejoint/>
<geom name="sole" type="box" size=".1 .1 .1" adhesion="2"/></body></worldbody></mujoco>"""


def test_added_plane_has_no_contact_parameters_of_the_default_class() -> None:
    """References: MuJoCo's defaults of adhesion [N] and surface velocity [m/s, rad/s]."""
    spec = mujoco.MjSpec.from_string(_STICKY)
    add_plane(spec.worldbody, "floor")
    model = compile_spec(spec, Path("sticky.xml"))
    floor = model.geom("floor").id
    assert model.geom_adhesion[floor] == 0.0
    assert not model.geom_surfacevel[floor].any()


@pytest.mark.parametrize(
    "default", ['pos="0 0 0.5" quat="0 1 0 0"', 'euler="90 0 0"', 'type="mesh" mesh="block"']
)
def test_added_elements_do_not_inherit_pose_and_shape(default: str) -> None:
    """Reference: the requested pose, also after the spec is written and read again."""
    site = "" if "mesh" in default else f"<site {default}/>"
    spec = mujoco.MjSpec.from_string(
        '<mujoco><asset><mesh name="block" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/></asset><default>'
        f'<geom {default}/>{site}</default><worldbody><body name="trunk"><freejoint/><geom '
        'type="mesh" mesh="block"/></body></worldbody></mujoco>'
    )
    add_plane(spec.worldbody, "floor")
    box, turn = mujoco.mjtGeom.mjGEOM_BOX, (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))
    add_geom(spec.worldbody, name="step", type=box, size=(1, 2, 3), pos=(0, 0, 2), quat=turn)
    add_site(spec.body("trunk"), name="imu")
    models = [compile_spec(spec.copy(), Path("default.xml"))]
    if site:  # in an MJCF, a geom cannot be without the mesh of its class
        models.append(mujoco.MjModel.from_xml_string(to_xml(spec)))
    for model in models:
        floor, step, imu = model.geom("floor"), model.geom("step"), model.site("imu")
        assert floor.type == mujoco.mjtGeom.mjGEOM_PLANE
        assert (floor.pos.tolist(), floor.quat.tolist()) == ([0, 0, 0], [1, 0, 0, 0])
        assert (imu.pos.tolist(), imu.quat.tolist()) == ([0, 0, 0], [1, 0, 0, 0])
        assert (step.pos.tolist(), step.size.tolist()) == ([0, 0, 2], [1, 2, 3])
        np.testing.assert_allclose(step.quat, turn, atol=1e-15)


def test_added_ball_has_the_adhesion_of_its_model_geom() -> None:
    spec = mujoco.MjSpec.from_string(_STICKY)
    SpecTree(spec).add_ball("ball", "foot", 0.1, (0.0, 0.0, 0.0), like="sole")
    model = compile_spec(spec, Path("sticky.xml"))
    assert model.geom_adhesion[model.geom("ball").id] == 2.0
