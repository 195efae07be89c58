"""What a converted robot's base does: free or fixed, from `qpos0`, and on a slope."""

from __future__ import annotations

import math
from pathlib import Path

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from tests.support.robots import Part, Parts, urdf_text
from tests.tools.convert.test_model import _shape, compiled, converted, standing_urdf


def hand(folder: Path, count: int = 3) -> Path:
    """A palm with fingers that point up: as many limbs as a tripod has."""
    parts: Parts = {"palm": Part("palm", mass=0.5, com=(0.0, 0.0, 0.01))}
    for finger in range(count):
        turn = 2 * math.pi * finger / count
        at = (0.05 * math.cos(turn), 0.05 * math.sin(turn), 0.02)
        parts[f"one{finger}"] = Part(
            f"one{finger}", "palm", f"bend{finger}", position=at, axis=(0.0, 1.0, 0.0),
            mass=0.05, com=(0.0, 0.0, 0.02), lower=-0.3, upper=1.5,
        )  # fmt: skip
        parts[f"two{finger}"] = Part(
            f"two{finger}", f"one{finger}", f"curl{finger}", position=(0.0, 0.0, 0.05),
            axis=(0.0, 1.0, 0.0), mass=0.03, com=(0.0, 0.0, 0.02), lower=-0.3, upper=1.5,
        )  # fmt: skip
    ball = _shape("collision", '<sphere radius="0.01"/>', "0 0 0.04")
    path = folder / "hand.urdf"
    path.write_text(urdf_text(parts, ()).replace("</link>", f"{ball}</link>"))
    return path


def is_free(model: mujoco.MjModel) -> bool:
    return bool((model.jnt_type == mujoco.mjtJoint.mjJNT_FREE.value).any())


@pytest.fixture(scope="module")
def quad(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The MJCF of a quadruped."""
    mjcf, found = converted(standing_urdf(tmp_path_factory.mktemp("quad")), "quad.xml")
    assert found.passed, found.failures
    return mjcf


def test_a_hand_is_no_legged_robot(tmp_path: Path) -> None:
    """Its base stays as the URDF has it, unless it is asked to be free."""
    mjcf, found = converted(hand(tmp_path), "hand.xml")
    assert found.passed, found.failures
    assert not is_free(compiled(mjcf))
    mjcf, found = converted(hand(tmp_path), "free.xml", fixed_base=False)
    assert found.agree
    assert not found.passed
    assert is_free(compiled(mjcf))


def test_nothing_is_thrown_up_from_qpos0(quad: Path) -> None:
    """Simulations begin there, if nobody resets to the keyframe: the feet were 0.4 m in the ground.

    The legs are at zero then, beyond their limits, and straighten up.
    """
    model = compiled(quad)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert all(contact.dist > -1e-5 for contact in data.contact)
    assert model.qpos0[2] >= model.key_qpos[0, 2]
    highest = 0.0
    while data.time < 3.0:
        mujoco.mj_step(model, data)
        highest = max(highest, float(data.qpos[2]))
    assert highest < model.qpos0[2] + 0.1


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


def test_missing_meshes_are_the_cause_that_is_told(tmp_path: Path) -> None:
    """Feet were meshes that are not there: the robot is no hand for that."""
    text = standing_urdf(tmp_path).read_text()
    path = tmp_path / "lost.urdf"
    path.write_text(text.replace('<sphere radius="0.02"/>', '<mesh filename="package://x/f.stl"/>'))
    found = pa.convert_model(path, tmp_path / "lost.xml")
    assert not found.passed
    assert is_free(compiled(tmp_path / "lost.xml"))
    assert str(found.failures[0]).index("missing") < str(found.failures[0]).index("no feet")


def test_legs_whose_feet_have_no_shapes_are_no_hand(tmp_path: Path) -> None:
    text = standing_urdf(tmp_path).read_text()
    ball = _shape("collision", '<sphere radius="0.02"/>', "0 0 -0.2")
    assert text.count(ball) == 4
    path = tmp_path / "bare.urdf"
    path.write_text(text.replace(ball, ""))
    mjcf, found = converted(path, "bare.xml")
    assert not found.passed
    assert is_free(compiled(mjcf))


def test_what_has_no_joint_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    path = tmp_path / "box.urdf"
    path.write_text(urdf_text({"box": Part("box")}, ()))
    with pytest.raises(pa.ModelError, match="no joint that moves") as raised:
        pa.convert_model(path, tmp_path / "box.xml")
    assert raised.value.source == str(path)
    assert not (tmp_path / "box.xml").exists()


def test_two_robots_in_one_mjcf_are_named(tmp_path: Path) -> None:
    """As ALOHA's arms, each on a body of its own in the world."""
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
