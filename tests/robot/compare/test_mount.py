"""A fixed base that is tilted in one file: other torques against gravity, said and chosen."""

from __future__ import annotations

import math
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

from tests.support.robots import (
    Files,
    arm,
    compared,
    headline,
    mjcf_text,
    pendulum,
    urdf_text,
    write,
)

GRAVITY = 9.81  # m/s^2


def mounted(text: str, turn: Rotation) -> str:
    """The MJCF with its base turned in the world."""
    quaternion = " ".join(repr(float(value)) for value in turn.as_quat(scalar_first=True))
    before = '<body name="base" pos="0.0 0.0 0.0" quat="1.0 0.0 0.0 0.0">'
    assert before in text
    return text.replace(before, f'<body name="base" quat="{quaternion}">')


def on_a_root(text: str, turn: Rotation) -> str:
    """The URDF on a root link without mass, turned on it."""
    angles = " ".join(repr(float(value)) for value in turn.as_euler("xyz"))
    root = (
        f'<link name="table"/><joint name="mount" type="fixed"><origin rpy="{angles}"/>'
        '<parent link="table"/><child link="base"/></joint></robot>'
    )
    return text.replace("</robot>", root)


def test_a_pendulum_on_its_side(tmp_path: Path) -> None:
    """2 kg on 0.5 m: nothing as it hangs, m g l as it lies; turned about gravity, nothing still."""
    urdf, mjcf = urdf_text(pendulum(), ()), mjcf_text(pendulum(), (), free=False)
    lying = Rotation.from_euler("y", 90, degrees=True)
    comparison = compared(write(tmp_path, urdf, mounted(mjcf, lying)))
    assert comparison.agree
    assert comparison.mount is not None
    said = comparison.mount.values
    assert said["tilt"].value == pytest.approx(math.pi / 2)
    torques = [said[file].value for file in ("urdf", "mjcf")]
    assert torques == pytest.approx((0.0, 2.0 * GRAVITY * 0.5), abs=1e-9)
    assert (
        "AGREE: no difference within the tolerances; but the base is tilted by 90 deg"
        in headline(comparison)
    )
    assert not compared(write(tmp_path, urdf, mounted(mjcf, lying)), strict_names=True).agree
    about = Rotation.from_euler("z", 40, degrees=True)
    assert compared(write(tmp_path, urdf, mounted(mjcf, about)), strict_names=True).mount is None


def as_they_are(files: Files) -> dict[str, tuple[float, float]]:
    """What both engines say of the files, each as it is, at zero angles."""
    model = pin.buildModelFromUrdf(str(files.urdf))
    one = pin.computeGeneralizedGravity(model, model.createData(), pin.neutral(model))
    other = mujoco.MjModel.from_xml_path(str(files.mjcf))
    data = mujoco.MjData(other)
    mujoco.mj_forward(other, data)
    return {
        name: (
            float(one[model.joints[model.getJointId(name)].idx_v]),
            float(data.qfrc_bias[other.joint(name).dofadr[0]]),
        )
        for name in ("turn", "lift", "push")
    }


@pytest.mark.parametrize("seed", [1, 2])
def test_the_torque_that_differs_most_is_that_of_both_engines(seed: int, tmp_path: Path) -> None:
    """With a root link, turned as well, whose place is lost when it is left out."""
    turns = Rotation.random(2, rng=np.random.default_rng(seed))
    urdf = on_a_root(urdf_text(arm(), ()), turns[0])
    files = write(tmp_path, urdf, mounted(mjcf_text(arm(), (), free=False), turns[1]))
    comparison = compared(files)
    assert comparison.mount is not None
    expected = as_they_are(files)
    worst = max(expected, key=lambda name: abs(expected[name][1] - expected[name][0]))
    assert comparison.mount.subject is not None
    assert comparison.mount.subject.name == worst
    torques = [comparison.mount.values[file].value for file in ("urdf", "mjcf")]
    assert torques == pytest.approx(expected[worst], abs=1e-9)


def test_a_root_that_is_turned_alike_is_no_tilt(tmp_path: Path) -> None:
    turn = Rotation.from_euler("xyz", [0.4, -0.3, 1.0])
    urdf = on_a_root(urdf_text(arm(), ()), turn)
    files = write(tmp_path, urdf, mounted(mjcf_text(arm(), (), free=False), turn))
    comparison = compared(files, strict_names=True)
    assert comparison.mount is None
    assert comparison.agree
