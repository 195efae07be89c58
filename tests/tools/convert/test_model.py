"""Conversions: source and new file have equal dynamics, each in its own engine, and the robot
stands.
"""

from __future__ import annotations

import json
import math
import os
import re
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pinocchio as pin
import pytest
import trimesh

import pupper_analysis as pa
from pupper_analysis.models.efforts import MIN_EFFORT
from pupper_analysis.tools.convert.document import conversion_document
from tests.support import features
from tests.support.commands import answer
from tests.support.conversions import (
    compare_dynamics,
    compile_file,
    convert_file,
    format_shape,
    write_standing_urdf,
)
from tests.support.repository import ROOT
from tests.support.robots import (
    NOTHING,
    Part,
    Parts,
    arm,
    change_part,
    mjcf_text,
    quadruped,
    urdf_text,
)
from tests.support.round_trips import of_mjcf, of_urdf, round_trip, silent_losses
from tests.support.variants import load

# ---------------------------------------------------------------------------- a URDF as an MJCF


@pytest.mark.slow
def test_a_urdf_becomes_an_mjcf_that_agrees_and_stands(tmp_path: Path) -> None:
    """References: dynamics of Pinocchio and MuJoCo (1e-9), 12 s of simulation, masses [kg] and
    efforts [N m] of the URDF.
    """
    urdf = write_standing_urdf(tmp_path)
    mjcf, found = convert_file(urdf, "quad.xml")
    assert found.passed, found.failures
    assert found.agree
    assert found.comparison.differences == ()
    assert all(text.startswith("velocity limits of ") for text in map(str, found.not_converted))
    assert found.verification is not None
    assert found.verification.duration == 12.0
    assert found.verification.torque_error < 1e-5
    assert compare_dynamics(urdf, mjcf) < 1e-9
    assert found.written == (str(mjcf),)
    model = compile_file(mjcf)
    assert model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE.value
    assert model.body_subtreemass[0] == pytest.approx(4 + 4 * 1.1)
    # The URDF's effort limits are the servos' (N m).
    np.testing.assert_allclose(model.actuator_forcerange, [[-80, 80]] * 12)
    sensors = {model.sensor(i).name for i in range(model.nsensor)}
    assert sensors == {"gyro", "accelerometer", "orientation"}


@pytest.mark.slow
def test_converted_random_robots_agree_with_their_source(tmp_path: Path) -> None:
    """Reference: dynamics of Pinocchio (URDF) and MuJoCo (MJCF) within 1e-9, there and back."""
    random = np.random.default_rng(5)
    for number in range(6):
        parts = _random_tree(random)
        urdf = tmp_path / f"tree{number}.urdf"
        urdf.write_text(urdf_text(parts, ()))
        mjcf, found = convert_file(urdf, f"tree{number}.xml", fixed_base=True)
        assert found.passed, found.failures
        assert compare_dynamics(urdf, mjcf) < 1e-9
        assert compile_file(mjcf).nbody == 1 + len(parts)
        back, again = convert_file(mjcf, f"back{number}.urdf")
        assert again.passed, again.failures
        assert compare_dynamics(back, mjcf) < 1e-9


def _random_tree(random: np.random.Generator) -> Parts:
    parts = {"base": Part("base", mass=2.0, com=tuple(random.normal(0, 0.05, 3)))}
    for index in range(7):
        turned = random.normal(size=4)
        box = random.uniform(0.02, 0.3, 3) ** 2
        moments = np.diag(box.sum() - box)
        axes = pin.exp3(random.normal(size=3))
        tensor = axes @ moments @ axes.T
        kind = str(random.choice(["revolute", "continuous", "prismatic", "fixed"]))
        name = f"part{index}"
        parts[name] = Part(
            name,
            str(random.choice(list(parts))),
            f"joint{index}",
            kind if index else "revolute",
            tuple(random.normal(0, 0.2, 3)),
            tuple(turned / np.linalg.norm(turned)),
            tuple(random.normal(size=3)),
            mass=float(random.uniform(0.1, 2)),
            com=tuple(random.normal(0, 0.05, 3)),
            inertia=tuple(tensor[at] for at in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))),
        )
    return parts


def test_effort_of_zero_is_converted_to_a_servo_without_torque(tmp_path: Path) -> None:
    """Reference: torque of the written servo in MuJoCo, far from its target."""
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(urdf_text(change_part(arm(), "rod", effort=0.0), ()))
    mjcf, found = convert_file(urdf, "arm.xml")
    assert found.passed, found.failures
    model = compile_file(mjcf)
    servo = int(np.argmin(model.actuator_forcerange[:, 1]))
    data = mujoco.MjData(model)
    data.ctrl[servo] = 1.0
    mujoco.mj_forward(model, data)
    assert abs(data.actuator_force[servo]) < MIN_EFFORT


def test_joints_beside_a_mimic_joint_have_their_common_values_in_the_default_class(
    tmp_path: Path,
) -> None:
    """The couplings are elements ``<joint>`` as well, without the attributes of a joint.

    Reference: dampings of MuJoCo's compiled model.
    """
    text = urdf_text(arm(), ())
    damping = '<dynamics damping="0.5"/>'
    mimic = '<mimic joint="lift" multiplier="-0.5" offset="0.1"/>'
    text = re.sub("</joint>", damping + "</joint>", re.sub(r"<dynamics[^>]*/>", "", text))
    place = text.index("</joint>", text.index('name="push"'))
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(text[:place] + mimic + text[place:])
    mjcf, found = convert_file(urdf, "arm.xml")
    assert found.passed, found.failures
    defaults = ElementTree.parse(mjcf).getroot().find("default/joint")
    assert defaults is not None
    assert float(defaults.attrib["damping"]) == 0.5
    assert (compile_file(mjcf).dof_damping == 0.5).all()


def test_mimic_joints_are_converted_to_couplings(tmp_path: Path) -> None:
    """Reference: multiplier and offset in MuJoCo's `eq_data`, and in the URDF after the conversion
    back.
    """
    urdf = tmp_path / "arm.urdf"
    text = urdf_text(change_part(arm(), "rod", effort=7.0), ())
    mimic = '<mimic joint="lift" multiplier="-0.5" offset="0.1"/></joint>'
    place = text.index("</joint>", text.index('name="push"'))
    urdf.write_text(text[:place] + mimic + text[place + len("</joint>") :])
    mjcf, found = convert_file(urdf, "arm.xml")
    assert found.passed, found.failures
    model = compile_file(mjcf)
    np.testing.assert_allclose(model.eq_data[0, :3], [0.1, -0.5, 0])
    coupled = model.joint("push").id, model.joint("lift").id
    assert (model.eq_obj1id[0], model.eq_obj2id[0]) == coupled
    assert [model.actuator(i).name for i in range(model.nu)] == ["turn", "lift"]
    back, again = convert_file(mjcf, "back.urdf")
    assert again.passed, again.failures
    written = ElementTree.parse(back).getroot().find("joint[@name='push']/mimic")
    assert written is not None
    assert written.attrib == {"joint": "lift", "multiplier": "-0.5", "offset": "0.1"}
    left = [loss.code for loss in again.not_converted]
    assert left == ["not-in-urdf", "not-in-urdf", "option-not-in-urdf"]  # servos; its integrator


@pytest.mark.filterwarnings("ignore:.*Scene.dump:DeprecationWarning")  # yourdfpy's
def test_shape_poses_equal_those_of_yourdfpy(tmp_path: Path) -> None:
    """Reference: yourdfpy's scene of the URDF, and of the URDF converted back from the MJCF."""
    import yourdfpy

    folder = tmp_path / "parts"
    folder.mkdir()
    solid = trimesh.creation.box((0.1, 0.06, 0.03))
    solid.apply_translation((0.03, -0.01, 0.02))
    solid.export(folder / "part.stl")
    solid.export(folder / "part.dae")
    shapes = {
        "base": format_shape(
            "visual", '<mesh filename="parts/part.stl" scale="1 -1 2"/>', "0.1 0 0.2"
        ),
        "column": format_shape("collision", '<box size="0.1 0.2 0.3"/>', "0 0.1 0", "0.3 0.2 -0.4"),
        "boom": format_shape("visual", '<mesh filename="parts/part.dae"/>', "0 0 0.1", "0 0 1")
        + format_shape("collision", '<cylinder radius="0.03" length="0.4"/>', "0.1 0 0", "0 1.2 0"),
        "rod": format_shape("collision", '<sphere radius="0.07"/>', "0.02 0.03 0.04"),
    }
    text = urdf_text(arm(), ())
    for link, shape in shapes.items():
        end = text.index("</link>", text.index(f'<link name="{link}">'))
        text = text[:end] + shape + text[end:]
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(text)
    mjcf, found = convert_file(urdf, "arm.xml")
    assert found.passed, found.failures
    assert all(text.startswith("velocity limits of ") for text in map(str, found.not_converted))
    assert (tmp_path / "arm_meshes" / "part.obj").is_file()
    assert found.written[-1] == str(mjcf)
    back, _ = convert_file(mjcf, "back.urdf")
    one, two = (
        yourdfpy.URDF.load(str(path), load_collision_meshes=True, build_collision_scene_graph=True)
        for path in (urdf, back)
    )
    for which in ("scene", "collision_scene"):
        first, second = getattr(one, which), getattr(two, which)
        assert len(first.geometry) == len(second.geometry) > 0
        np.testing.assert_allclose(first.bounds, second.bounds, atol=1e-6)
    model = compile_file(mjcf)
    groups = sorted(model.geom_group.tolist())
    assert groups == [2, 2, 3, 3, 3]
    np.testing.assert_allclose(model.geom("column_collision").size, [0.05, 0.1, 0.15])
    np.testing.assert_allclose(model.geom("boom_collision").size[:2], [0.03, 0.2])
    assert not model.geom_contype[model.geom_group == 2].any()


def test_missing_meshes_are_left_out_with_a_note(tmp_path: Path) -> None:
    pointer = tmp_path / "far.stl"
    pointer.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n")
    names = ("package://none/gone.stl", "far.stl")
    shapes = "".join(
        format_shape("visual", f'<mesh filename="{name}"/>', "0 0 0") for name in names
    )
    text = urdf_text(arm(), ()).replace("</link>", f"{shapes}</link>", 1)
    (tmp_path / "arm.urdf").write_text(text)
    _, found = convert_file(tmp_path / "arm.urdf", "arm.xml")
    assert found.passed
    meshes, *velocity_limits = map(str, found.not_converted)
    assert ", ".join(names) in meshes
    assert len(velocity_limits) == 1
    assert velocity_limits[0].startswith("velocity limits of 3 joints (10 rad/s; slides 10 m/s)")
    assert all("velocity limit" in message for message in velocity_limits)


def test_errors_of_the_source_file_are_reported(tmp_path: Path) -> None:
    """A negative damping of the source is in the converted file as well."""
    _, mjcf = features.write_files(tmp_path, features.FEATURES["damping -2"])
    notes = pa.convert_model(mjcf, tmp_path / "new.urdf").notes
    (message,) = [note for note in notes if note.code == "rests-on-made-up"]
    assert "negative damping" in str(message)


@pytest.mark.parametrize("feature", ["armature -0.01", "timestep 10"])
def test_model_that_cannot_be_simulated_is_not_written(feature: str, tmp_path: Path) -> None:
    _, mjcf = features.write_files(tmp_path, features.FEATURES[feature])
    with pytest.raises(pa.ModelError):
        pa.convert_model(mjcf, tmp_path / "new.urdf")
    assert not (tmp_path / "new.urdf").exists()


# ---------------------------------------------------------------------------- an MJCF as a URDF


@pytest.mark.slow
@pytest.mark.parametrize("name", ["pupper_v3", "pupper_skeleton"])
def test_mjcfs_of_this_package_convert_to_urdfs_that_agree(name: str, tmp_path: Path) -> None:
    """References: cross-check in both engines, and effort limits [N m] of the robot."""
    source = ROOT / "mjcf" / f"{name}.xml"
    output = tmp_path / f"{name}.urdf"
    found = pa.convert_model(source, output)
    assert found.passed, found.failures
    assert any(text.startswith("armature") for text in map(str, found.not_converted))
    robot = pa.load_robot(urdf=output, mjcf=source)
    assert pa.cross_check(robot).passed
    ours = pa.compare_models(ROOT / "urdf" / f"{name}.urdf", source)
    limits = ElementTree.parse(output).getroot().findall("joint/limit")
    assert {float(str(limit.get("effort"))) for limit in limits} == {
        float(value) for value in set(robot.effort_limits.tolist())
    }
    assert ours.joints == found.comparison.joints


def test_anchors_zeros_and_several_joints_of_a_body(tmp_path: Path) -> None:
    """Proven by Pinocchio reading the URDF alone, against MuJoCo reading the MJCF alone."""
    mjcf = tmp_path / "odd.xml"
    mjcf.write_text("""<mujoco model="odd"><compiler angle="radian" autolimits="true"/><worldbody>
      <body name="base" pos="0.1 0.2 0.3" euler="0.1 0.2 0.3">
        <inertial pos="0 0 0" mass="1" diaginertia="0.1 0.1 0.1"/>
        <body name="shoulder" pos="0 0.1 0" euler="0.3 0 0">
          <joint name="yaw" axis="0 0 1" pos="0.02 0.01 -0.03" ref="0.4" range="-1 1"/>
          <joint name="pitch" axis="0 1 0.2" pos="0.01 0 0"/>
          <inertial pos="0.1 0 0.05" mass="0.7" fullinertia="0.01 0.02 0.015 0.001 -0.002 0.0005"/>
          <geom name="rod" type="capsule" size="0.02 0.1" pos="0.1 0 0" euler="0 1 0"/>
          <body name="slider" pos="0.2 0 0">
            <joint name="push" type="slide" axis="1 0 0" ref="0.05" range="0 0.2"/>
            <inertial pos="0 0 0.02" mass="0.4" diaginertia="0.01 0.02 0.015"/>
            <geom type="ellipsoid" size="0.1 0.2 0.3" name="egg"/>
            <site name="tip" pos="0.1 0 0" euler="0 0 1"/>
          </body></body></body></worldbody></mujoco>""")
    urdf, found = convert_file(mjcf, "odd.urdf")
    assert found.passed, found.failures
    assert "geom 'egg': a URDF has no ellipsoid" in map(str, found.not_converted)
    assert "3 joints have no effort limit, which is written as 0 in a URDF" in map(
        str, found.not_converted
    )
    assert compare_dynamics(urdf, mjcf) < 1e-9
    model, reference = compile_file(mjcf), pin.buildModelFromUrdf(str(urdf))
    data, work = mujoco.MjData(model), reference.createData()
    angles = {"yaw": 0.3, "pitch": -0.6, "push": 0.11}
    q = pin.neutral(reference)
    for name, value in angles.items():
        data.qpos[model.jnt_qposadr[model.joint(name).id]] = value
        joint = reference.joints[reference.getJointId(name)]
        wide = joint.nq == 2
        q[joint.idx_q : joint.idx_q + joint.nq] = (
            (math.cos(value), math.sin(value)) if wide else value
        )
    mujoco.mj_kinematics(model, data)
    pin.framesForwardKinematics(reference, work, q)
    tip = work.oMf[reference.getFrameId("tip", pin.FrameType.BODY)]
    np.testing.assert_allclose(tip.translation, data.site("tip").xpos, atol=1e-9)
    np.testing.assert_allclose(tip.rotation, data.site("tip").xmat.reshape(3, 3), atol=1e-9)
    shapes = ElementTree.parse(urdf).getroot().findall(".//collision/geometry/*")
    assert [shape.tag for shape in shapes] == ["cylinder", "sphere", "sphere"]


@pytest.mark.slow
@pytest.mark.parametrize("file", ["urdf/pupper_v3.urdf", "mjcf/pupper_v3.xml"])
def test_round_trip_of_v3_reports_each_loss(tmp_path: Path, file: str) -> None:
    """Reference: all numbers of the file before and after; `lost` are the differences without a
    report.
    """
    lost, count = round_trip(ROOT / file, tmp_path)
    assert count > 90
    assert not lost


# ---------------------------------------------------------------------------- what is refused


def test_invalid_model_is_refused_before_any_file_is_written(tmp_path: Path) -> None:
    flat = change_part(arm(), "rod", inertia=(1.0, 0.1, 0.1, *NOTHING))
    cases = {
        "has no mass; MuJoCo refuses such bodies": urdf_text(change_part(arm(), "rod", mass=0.0)),
        "joint 'push' is planar": urdf_text(arm()).replace('"prismatic"', '"planar"'),
        "are physically impossible; correct the inertia": urdf_text(flat),
        "no moving joint": urdf_text({"box": Part("box")}),
        "body 'rod' has a ball joint": mjcf_text(arm(), free=False).replace('"slide"', '"ball"', 1),
    }
    for number, (problem, text) in enumerate(cases.items()):
        old, new = ("xml", "urdf") if "<mujoco" in text else ("urdf", "xml")
        source = tmp_path / f"bad{number}.{old}"
        source.write_text(text)
        with pytest.raises(pa.ModelError, match=problem) as caught:
            pa.convert_model(source, tmp_path / f"new.{new}")
        assert caught.value.source.startswith(str(source))
        assert not (tmp_path / f"new.{new}").exists()


def test_invalid_arguments_and_existing_files_are_refused(tmp_path: Path) -> None:
    urdf, output, mjcf = (tmp_path / name for name in ("arm.urdf", "arm.xml", "machine.xml"))
    urdf.write_text(urdf_text(arm(), ()))
    mjcf.write_text(mjcf_text(arm(), free=False))
    for name, value in (("fixed_base", True), ("feet", ["rod"]), ("xacro", True)):
        with pytest.raises(pa.ConfigurationError, match=f"{name}: .* is an MJCF"):
            pa.convert_model(mjcf, tmp_path / "new.urdf", **{name: value})  # type: ignore[arg-type]
    output.write_text("mine")
    with pytest.raises(pa.OutputError, match="the file exists"):
        pa.convert_model(urdf, output)
    assert output.read_text() == "mine"
    with pytest.raises(pa.OutputError, match="an input of this run"):
        pa.convert_model(urdf, urdf, force=True)


# ---------------------------------------------------------------------------- the command


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (("-o", "-"), "cannot write -: quad.urdf becomes an MJCF: use a name that ends in .xml"),
        (("-o", "a.urdf"), "a.urdf: quad.urdf becomes an MJCF: use a name that ends in .xml"),
        (("-o", "a.xml", "--armature", "x*=1"), "no joint matches 'x*'; available: FL_roll"),
        (("-o", "a.xml", "--armature", "-1"), "negative or not a number"),
        (("-o", "a.xml", "--armature", "*=much"), "armature: 'much' is not a number"),
        (("-o", "a.xml", "--foot", "nose"), "nose"),
    ],
)  # fmt: skip
def test_invalid_command_line_is_refused_in_one_line(
    arguments: tuple[str, ...], problem: str, tmp_path: Path
) -> None:
    write_standing_urdf(tmp_path)
    done = answer("convert", "quad.urdf", *arguments, folder=tmp_path)
    assert done.returncode == 2
    assert problem in done.stderr
    assert done.stderr.count("\n") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "quad.urdf", "robot.urdf", "robot.xml",
    ]  # fmt: skip


@pytest.mark.slow
def test_command_states_the_file_the_agreement_and_the_stand(tmp_path: Path) -> None:
    """References: MuJoCo's ``dof_armature`` of the written file, and the message of a second run
    without --force."""
    write_standing_urdf(tmp_path)
    feet = [word for leg in ("FL", "FR", "RL", "RR") for word in ("--foot", f"{leg}_calf")]
    done = answer(
        *("convert", "quad.urdf", "-o", "quad.xml", "--armature", "*_knee=0.01"),
        *("--json", "out.json", *feet),
        folder=tmp_path,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert "quad.xml" in done.stdout
    assert "STANDS 12 s at " in done.stdout
    assert "mm, servos added (kp " in done.stdout
    assert json.loads((tmp_path / "out.json").read_text())["passed"]
    model = compile_file(tmp_path / "quad.xml")
    assert model.dof_armature.tolist() == [0.0] * 6 + [0, 0, 0.01] * 4
    again = answer("convert", "quad.urdf", "-o", "quad.xml", folder=tmp_path)
    assert again.returncode == 2
    error, step = again.stderr.splitlines()
    assert error.startswith("error: cannot write quad.xml: the file exists; --force ")
    assert step == "  next: pupper-analysis convert quad.urdf -o quad.xml --force"


# ------------------ What a converted robot's base does: free or fixed, from `qpos0`, and on a slope


def write_hand(folder: Path, count: int = 3) -> Path:
    """Write a palm with fingers that point upwards, with as many limbs as a tripod."""
    parts: Parts = {"palm": Part("palm", mass=0.5, com=(0.0, 0.0, 0.01))}
    for finger in range(count):
        turn = 2 * math.pi * finger / count
        at = (0.05 * math.cos(turn), 0.05 * math.sin(turn), 0.02)
        for name, parent, joint, place, mass in (
            (f"one{finger}", "palm", f"bend{finger}", at, 0.05),
            (f"two{finger}", f"one{finger}", f"curl{finger}", (0.0, 0.0, 0.05), 0.03),
        ):
            parts[name] = Part(
                name, parent, joint, position=place, axis=(0.0, 1.0, 0.0),
                mass=mass, com=(0.0, 0.0, 0.02), lower=-0.3, upper=1.5,
            )  # fmt: skip
    ball = format_shape("collision", '<sphere radius="0.01"/>', "0 0 0.04")
    path = folder / "hand.urdf"
    path.write_text(urdf_text(parts, ()).replace("</link>", f"{ball}</link>"))
    return path


def is_free(model: mujoco.MjModel) -> bool:
    return bool((model.jnt_type == mujoco.mjtJoint.mjJNT_FREE.value).any())


@pytest.fixture(scope="module")
def quad(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the MJCF of a quadruped."""
    mjcf, found = convert_file(write_standing_urdf(tmp_path_factory.mktemp("quad")), "quad.xml")
    assert found.passed, found.failures
    return mjcf


def test_free_hand_that_cannot_stand_fails_and_names_fixed_base(tmp_path: Path) -> None:
    """A hand has as many limbs as a tripod; with fixed_base the conversion passes."""
    mjcf, found = convert_file(write_hand(tmp_path), "free.xml")
    assert found.agree
    assert not found.passed
    assert "--fixed-base" in str(found.failures[0])
    assert is_free(compile_file(mjcf))
    mjcf, found = convert_file(write_hand(tmp_path), "hand.xml", fixed_base=True)
    assert found.passed, found.failures
    assert not is_free(compile_file(mjcf))


@pytest.mark.slow
def test_feet_hold_on_a_slope(quad: Path) -> None:
    """On 17 degrees, with a friction of 1: by MuJoCo's default contacts they creep by 26 mm/s."""
    speeds = {}
    for name in ("written", "default"):
        spec = mujoco.MjSpec.from_file(str(quad))
        if name == "default":
            spec.option.cone, spec.option.impratio = mujoco.mjtCone.mjCONE_PYRAMIDAL, 1.0
        slope = math.radians(17.0)
        spec.option.gravity = 9.81 * np.array([math.sin(slope), 0.0, -math.cos(slope)])
        model = spec.compile()
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, 0)
        while data.time < 2.0:
            mujoco.mj_step(model, data)
        before = data.qpos[:3].copy()
        while data.time < 3.0:
            mujoco.mj_step(model, data)
        speeds[name] = float(np.linalg.norm(data.qpos[:3] - before))
    assert speeds["default"] > 5e-3
    assert speeds["written"] < 1e-3
    assert speeds["written"] < speeds["default"] / 30


def test_conversion_of_an_mjcf_fails_if_a_collision_mesh_is_missing(tmp_path: Path) -> None:
    """A missing visual mesh is left out; a missing collision mesh changes the robot."""
    for bits, passed in (('contype="0" conaffinity="0"', True), ("", False)):
        path = tmp_path / "robot.xml"
        path.write_text(f"""<mujoco>
          <asset><mesh name="hand" file="gone.stl"/></asset>
          <worldbody><body name="base">
            <inertial pos="0 0 0" mass="2" diaginertia="0.01 0.01 0.01"/>
            <body name="arm"><joint name="elbow" axis="0 1 0" range="-1 1"/>
              <inertial pos="0 0 -0.1" mass="0.2" diaginertia="0.001 0.001 0.001"/>
              <geom type="mesh" mesh="hand" {bits}/></body></body></worldbody></mujoco>""")
        found = pa.convert_model(path, tmp_path / f"{passed}.urdf")
        assert found.passed == passed
        if not passed:
            assert found.failures[-1].code == "collision-meshes-lost"
            assert "gone.stl" in str(found.failures[-1])


@pytest.mark.slow
@pytest.mark.parametrize("empty", [False, True])
def test_base_frame_below_the_feet_keeps_its_position(empty: bool, tmp_path: Path) -> None:
    """The keyframe has the base below the ground, as the URDF has; with and without an empty
    root link above the base."""
    path, lift = write_standing_urdf(tmp_path), 1.05
    tree = ElementTree.parse(path)
    root, new = tree.getroot(), ElementTree.SubElement
    raised = root.findall("link[@name='trunk']/*") + root.findall("joint/parent[@link='trunk']/..")
    if empty:
        new(root, "link", name="floor_frame")
        raised = [new(root, "joint", name="up", type="fixed")]
        for tag, link in (("parent", "floor_frame"), ("child", "trunk")):
            new(raised[0], tag, link=link)
    for element in raised:
        origin = element.find("origin")
        origin = new(element, "origin") if origin is None else origin
        x, y, z = map(float, origin.get("xyz", "0 0 0").split())
        origin.set("xyz", f"{x} {y} {z + lift}")
    tree.write(path)
    made = pa.convert_model(path, tmp_path / "low.xml")
    assert made.passed, made.failures
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "low.xml"))
    stood = pa.solve_stand(pa.load_robot(path)).qpos[2]
    assert model.key_qpos[0, 2] == pytest.approx(stood - lift, abs=1e-3)


@pytest.mark.slow
def test_new_urdf_of_a_robot_with_a_footless_leg_fails(tmp_path: Path) -> None:
    """The MJCF has a free base and four equal legs, of which one has no collision geom."""
    rod = '<geom type="capsule" fromto="0 0 0 0 0 -.1" size=".01" contype="0" conaffinity="0"/>'
    places = {"fl": (0.1, 0.05), "fr": (0.1, -0.05), "rl": (-0.1, 0.05), "rr": (-0.1, -0.05)}
    legs, servos = "", ""
    for name, (x, y) in places.items():
        ball = "" if name == "fl" else '<geom size=".015" pos="0 0 -.1"/>'
        legs += (
            f'<body name="{name}_a" pos="{x} {y} 0"><joint name="{name}_hip" axis="0 1 0" '
            f'range="-1 1"/>{rod}<body name="{name}_b" pos="0 0 -.1"><joint name="{name}_knee" '
            f'axis="0 1 0" range="-1 1"/>{rod}{ball}</body></body>'
        )
        servos += "".join(
            f'<position joint="{name}_{joint}" kp="20" kv="1"/>' for joint in ("hip", "knee")
        )
    source = tmp_path / "quad.xml"
    source.write_text(
        f"""<mujoco><worldbody><geom type="plane" size="1 1 .1"/><body name="trunk" pos="0 0 .22">
        <freejoint/><geom type="box" size=".1 .05 .02" mass="2"/>{legs}</body></worldbody>
        <actuator>{servos}</actuator></mujoco>"""
    )
    converted = pa.convert_model(source, tmp_path / "quad.urdf")
    assert [failure.code for failure in converted.failures] == ["limb-without-foot"]
    assert converted.agree


@pytest.mark.slow
def test_converted_robot_does_not_jump_from_qpos0(quad: Path) -> None:
    """Simulations without a reset to the keyframe start at ``qpos0``, where all joints are zero and
    beyond their limits; MuJoCo's feet must not be in the ground.
    """
    model = compile_file(quad)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert all(contact.dist > -1e-5 for contact in data.contact)
    assert model.qpos0[2] >= model.key_qpos[0, 2]
    highest = 0.0
    while data.time < 3.0:
        mujoco.mj_step(model, data)
        highest = max(highest, float(data.qpos[2]))
    assert highest < model.qpos0[2] + 0.1


@pytest.mark.slow
def test_requested_armature_is_written_at_the_named_joints(tmp_path: Path) -> None:
    """Reference: MuJoCo's ``dof_armature`` of the written file [kg m^2]."""
    urdf = write_standing_urdf(tmp_path)
    sizes = {"knee": 0.02, "roll": 0.01}
    legs = ("FL", "FR", "RL", "RR")
    requested = {f"{leg}_{name}": size for leg in legs for name, size in sizes.items()}
    mjcf, found = convert_file(urdf, "quad.xml", armature=requested)
    assert found.passed, found.failures
    model = compile_file(mjcf)
    armature = {model.joint(i).name: model.dof_armature[i + 5] for i in range(1, 13)}
    assert armature == {**dict.fromkeys(armature, 0.0), **requested}


@pytest.mark.slow
def test_spec_in_memory_is_converted_to_a_urdf(tmp_path: Path) -> None:
    """Reference: masses of Pinocchio's model of the written file [kg]."""
    spec = mujoco.MjSpec.from_file(str(ROOT / "mjcf" / "pupper_v3.xml"))
    spec.body("base_link").mass = 2.0
    urdf = tmp_path / "v3.urdf"
    found = pa.convert_model(spec, urdf)
    assert found.passed, found.failures
    assert found.source.endswith("<MjSpec pupper_v3>")
    model = pin.buildModelFromUrdf(str(urdf))
    assert sum(inertia.mass for inertia in model.inertias) == pytest.approx(
        spec.compile().body_mass.sum(), rel=1e-9
    )


@pytest.mark.slow
def test_armature_of_a_pinocchio_model_is_written_to_the_mjcf(tmp_path: Path) -> None:
    """Reference: MuJoCo's ``dof_armature`` of the written file [kg m^2]."""
    urdf = write_standing_urdf(tmp_path)
    model = pin.buildModelFromUrdf(str(urdf))
    model.armature[:] = np.linspace(0.01, 0.02, model.nv)
    found = pa.convert_model(model, tmp_path / "fixed.xml", fixed_base=True)
    assert found.passed, found.failures
    written = compile_file(tmp_path / "fixed.xml")
    for name, joint in list(zip(model.names, model.joints, strict=True))[1:]:
        armature = written.dof_armature[written.joint(name).dofadr[0]]
        assert armature == pytest.approx(model.armature[joint.idx_v])


@pytest.mark.slow
def test_losses_without_a_message_are_found(tmp_path: Path) -> None:
    """`silent_losses` finds a changed damping, and a lost condim if its message is missing."""
    source = ROOT / "urdf/pupper_v3.urdf"
    text = source.read_text().replace('damping="0.01"', 'damping="0.02"', 1)
    (tmp_path / "a.urdf").write_text(text)
    found = silent_losses(of_urdf(source), of_urdf(tmp_path / "a.urdf"), "")
    assert found == {"damping": ["leg_front_r_1"]}
    done = pa.convert_model(ROOT / "mjcf/pupper_v3.xml", tmp_path / "b.urdf")
    back = pa.convert_model(tmp_path / "b.urdf", tmp_path / "b.xml")
    before, after = of_mjcf(ROOT / "mjcf/pupper_v3.xml"), of_mjcf(tmp_path / "b.xml")
    messages = " ".join(map(str, (*done.not_converted, *back.notes))).lower()
    assert "condim" in silent_losses(before, after, messages.replace("condim", ""))
    assert "condim" not in silent_losses(before, after, messages)


@pytest.mark.slow
def test_servos_of_a_variant_that_are_not_converted_are_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """References: kp, kd and armature of MuJoCo's compiled models; the note is about variants only.

    With equal servos, the armature alone is named.

    The armature was not named: the largest stable kd of v3 is 2.6 with it, and 0.67 without.
    """
    done = pa.convert_model("v3", tmp_path / "new.xml")
    (note,) = [note for note in done.notes if note.code == "servos-of-variant-not-used"]
    document = conversion_document(done)
    assert document.verdict.en == "AGREE"
    assert document.title.en == "v3 and new.xml, except servos and armature"
    assert document.findings[0].short.endswith("; stands 12 s")
    assert document.next_step is not None
    assert document.next_step.words[1:] == ("--kp", "5", "--kd", "0.1")
    new, own = (compile_file(path) for path in (tmp_path / "new.xml", ROOT / "mjcf/pupper_v3.xml"))
    gains = [-model.actuator_biasprm[0, 1:3] for model in (new, own)]
    assert gains[0] != pytest.approx(gains[1])
    for kp, kd in gains:
        assert f"kp {kp:.3g} N m/rad, kd {kd:.3g} N m s/rad" in str(note)
    armatures = [model.dof_armature[-1] for model in (new, own)]
    assert armatures[0] == 0
    assert f"armature of {armatures[1]:.3g} kg m^2 (--armature)" in str(note)
    line = document.findings[1].short
    assert "armature 0; the MJCF has" in line
    assert line.endswith(f"kp 5, kd 0.1, armature {armatures[1]:.3g} kg m^2")
    same = pa.convert_model(
        "v3", tmp_path / "same.xml", armature=dict.fromkeys(load("v3").joint_names, armatures[1])
    )
    assert conversion_document(same).title.en == "v3 and same.xml, except the servos"
    monkeypatch.setattr(
        "pupper_analysis.tools.convert.model.list_position_servos", lambda _: {"all": (5, 0.1)}
    )
    lost = pa.convert_model("v3", tmp_path / "lost.xml")
    document = conversion_document(lost)
    assert document.title.en == "v3 and lost.xml, except the armature"
    assert document.findings[1].short.startswith("armature 0; the MJCF has an armature of 0.0016")
    file = pa.convert_model(ROOT / "urdf/pupper_v3.urdf", tmp_path / "file.xml")
    assert all(note.code != "servos-of-variant-not-used" for note in file.notes)


# ------------------------------------------------------------------------------------- details


def test_failed_conversion_writes_the_file_and_returns_exit_status_1(tmp_path: Path) -> None:
    """A robot without shapes has no feet; both files agree all the same."""
    urdf = tmp_path / "machine.urdf"
    urdf.write_text(urdf_text(quadruped(), ()))
    done = answer("convert", "machine.urdf", "-o", "machine.xml", folder=tmp_path)
    assert done.returncode == 1
    assert done.stdout.startswith("FAILED machine.urdf and machine.xml: the robot does not stand: ")
    assert (tmp_path / "machine.xml").is_file()
    mjcf, found = convert_file(urdf, "again.xml")
    assert (found.agree, found.passed, found.verification) == (True, False, None)
    assert "no feet were found" in str(found.failures[0])
    assert compare_dynamics(urdf, mjcf) < 1e-9


def test_mjcf_is_not_converted_to_a_file_named_xml(tmp_path: Path) -> None:
    source = tmp_path / "robot.xml"
    source.write_text(mjcf_text(arm()))
    with pytest.raises(pa.OutputError, match=r"becomes a URDF: use a name that ends in \.urdf"):
        pa.convert_model(source, tmp_path / "new.xml")
    assert [path.name for path in tmp_path.iterdir()] == ["robot.xml"]


def test_inertia_that_mujoco_refuses_is_added_to_the_parent_of_a_fixed_link(
    tmp_path: Path,
) -> None:
    """References: sum of the two masses [kg], and Pinocchio's dynamics of the URDF."""
    parts = arm()
    parts["tip"] = Part(
        "tip", "rod", "glue", "fixed", (0.1, 0.02, 0.0), mass=0.3, com=(0.05, 0.0, 0.0),
        inertia=(1e-5,) * 6,
    )  # fmt: skip
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(urdf_text(parts, ()))
    mjcf, found = convert_file(urdf, "arm.xml")
    assert found.passed, found.failures
    notes = [str(note) for note in found.notes]
    assert any("inertia of link 'tip'" in note and "'rod'" in note for note in notes)
    model = compile_file(mjcf)
    assert model.body("rod").mass[0] == pytest.approx(0.8)
    assert model.body("tip").mass[0] == 0
    assert compare_dynamics(urdf, mjcf) < 1e-9


def test_urdf_of_an_mjcf_equals_the_urdf_of_the_same_robot(tmp_path: Path) -> None:
    """Reference: Pinocchio's model of a URDF that is written from the same parts."""
    mjcf, original = tmp_path / "machine.xml", tmp_path / "original.urdf"
    mjcf.write_text(mjcf_text(quadruped()))
    original.write_text(urdf_text(quadruped()))
    urdf, found = convert_file(mjcf, "machine.urdf")
    assert found.passed, found.failures
    one, two = (pin.buildModelFromUrdf(str(path)) for path in (original, urdf))
    assert list(one.names) == list(two.names)
    for first, second in zip(one.inertias, two.inertias, strict=True):
        np.testing.assert_allclose(
            first.toDynamicParameters(), second.toDynamicParameters(), rtol=1e-9, atol=1e-12
        )
    for first, second in zip(one.jointPlacements, two.jointPlacements, strict=True):
        np.testing.assert_allclose(first.homogeneous, second.homogeneous, atol=1e-9)
    for values in ("lowerPositionLimit", "upperPositionLimit", "effortLimit"):
        np.testing.assert_allclose(getattr(one, values), getattr(two, values), rtol=1e-9)


@pytest.mark.slow
def test_massless_frames_of_a_new_urdf_state_their_mass(tmp_path: Path) -> None:
    """PyBullet gives each link without <inertial> 1 kg."""
    pa.convert_model(ROOT / "mjcf/pupper_v3.xml", tmp_path / "v3.urdf")
    found = {finding.rule for finding in pa.audit_model(tmp_path / "v3.urdf").findings}
    assert "link-without-inertial" not in found


@pytest.mark.slow
@pytest.mark.parametrize("foot", ["", '<mesh filename="package://x/f.stl"/>'])
def test_quadruped_without_feet_gets_a_free_base_and_fails(foot: str, tmp_path: Path) -> None:
    """Without shapes, or with missing meshes, which are then the first cause."""
    text = write_standing_urdf(tmp_path).read_text()
    ball = format_shape("collision", '<sphere radius="0.02"/>', "0 0 -0.2")
    assert text.count(ball) == 4
    new = ball.replace('<sphere radius="0.02"/>', foot) if foot else ""
    path = tmp_path / "bare.urdf"
    path.write_text(text.replace(ball, new))
    mjcf, found = convert_file(path, "bare.xml")
    assert not found.passed
    assert is_free(compile_file(mjcf))
    if foot:
        assert str(found.failures[0]).index("missing") < str(found.failures[0]).index("no feet")


def test_pipe_is_refused_as_output_also_with_force(tmp_path: Path) -> None:
    source, pipe = tmp_path / "robot.urdf", tmp_path / "new.xml"
    source.write_text(urdf_text(arm()))
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    try:
        with pytest.raises(pa.OutputError, match="not a regular file"):
            pa.convert_model(source, pipe, force=True)
        assert os.read(reader, 1) == b""
    finally:
        os.close(reader)
    assert pipe.is_fifo()


@pytest.mark.slow
def test_converted_robot_needs_no_defaults_and_rests_at_its_keyframe(quad: Path) -> None:
    """MuJoCo alone, 3 s: the servos carry the robot, which does not move."""
    notes = pa.load_robot(urdf=quad.with_suffix(".urdf"), mjcf=quad).notes
    codes = {note.code for note in notes}
    assert codes.isdisjoint({"servos-added", "ground-added"})
    assert "start-pose-is-keyframe" in codes
    model = compile_file(quad)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    start = data.qpos.copy()
    for _ in range(round(3 / model.opt.timestep)):
        mujoco.mj_step(model, data)
    assert np.abs(data.qvel).max() < 1e-4
    np.testing.assert_allclose(data.qpos[7:], start[7:], atol=1e-3)
    assert data.qpos[2] == pytest.approx(start[2], abs=1e-3)
    assert np.abs(data.actuator_force).max() > 1.0


def test_two_robots_in_one_mjcf_are_both_named(tmp_path: Path) -> None:
    inertial = '<inertial mass="1" pos="0 0 0.1" diaginertia="0.1 0.1 0.1"/>'
    arms = "".join(
        f'<body name="{side}/base"><body name="{side}/arm"><joint name="{side}/turn"/>{inertial}'
        "</body></body>"
        for side in ("left", "right")
    )
    path = tmp_path / "two.xml"
    path.write_text(f"<mujoco><worldbody>{arms}</worldbody></mujoco>")
    with pytest.raises(pa.ModelError, match=r"'left/base' with 1 .*'right/base' with 1 "):
        pa.convert_model(path, tmp_path / "two.urdf")


def test_only_stated_velocity_limits_are_lost(tmp_path: Path) -> None:
    """Reference: the text of the URDF, with and without ``velocity``."""
    text = urdf_text(arm(), ())
    assert text.count('velocity="') == 3
    bare = re.sub(r' velocity="[^"]*"', "", text)
    stated = bare.replace('upper="0.3"', 'upper="0.3" velocity="0.2"')
    assert stated != bare
    for name, source, expected in (("bare", bare, []), ("stated", stated, ["0.2 m/s"])):
        path = tmp_path / f"{name}.urdf"
        path.write_text(source)
        lost = map(str, convert_file(path, f"{name}.xml")[1].not_converted)
        limits = [line for line in lost if line.startswith("velocity limits")]
        assert [line.partition("(")[2].partition(")")[0] for line in limits] == expected


def test_joint_properties_of_a_urdf_are_kept(tmp_path: Path) -> None:
    """Reference: MuJoCo's compiled joints and motors."""
    urdf, motor = tmp_path / "arm.urdf", {"damping": 0.7, "friction": 0.3, "effort": 12.5}
    urdf.write_text(urdf_text(change_part(arm(), "boom", **motor), ()))
    mjcf, found = convert_file(urdf, "arm.xml")
    assert found.passed, found.failures
    assert found.verification is None
    model = compile_file(mjcf)
    assert [model.joint(i).name for i in range(3)] == ["turn", "lift", "push"]
    assert model.joint("turn").limited[0] == 0
    np.testing.assert_array_equal(model.joint("lift").range, [-1, 1])
    np.testing.assert_array_equal(model.joint("push").range, [0, 0.3])
    assert model.jnt_type[2] == mujoco.mjtJoint.mjJNT_SLIDE.value
    assert (model.dof_damping[1], model.dof_frictionloss[1]) == (0.7, 0.3)
    np.testing.assert_array_equal(model.actuator("lift").forcerange, [-12.5, 12.5])
