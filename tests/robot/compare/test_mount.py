"""Tilt of a fixed base in one file: reported, and a difference if requested."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.support.robots import (
    arm,
    compare_files,
    format_headline,
    mjcf_text,
    pendulum,
    urdf_text,
    write,
)


def turn_base(text: str, turn: Rotation) -> str:
    """Return the MJCF with its base turned in the world."""
    quaternion = " ".join(repr(float(value)) for value in turn.as_quat(scalar_first=True))
    before = '<body name="base" pos="0.0 0.0 0.0" quat="1.0 0.0 0.0 0.0">'
    assert before in text
    return text.replace(before, f'<body name="base" quat="{quaternion}">')


def on_a_root(text: str, turn: Rotation) -> str:
    """Return the URDF on a root link without mass, turned on it."""
    angles = " ".join(repr(float(value)) for value in turn.as_euler("xyz"))
    root = (
        f'<link name="table"/><joint name="mount" type="fixed"><origin rpy="{angles}"/>'
        '<parent link="table"/><child link="base"/></joint></robot>'
    )
    return text.replace("</robot>", root)


def test_mount_tilt_is_reported_for_a_pendulum_on_its_side(tmp_path: Path) -> None:
    """A rotation by 90 deg about y is a tilt; a rotation about gravity is none."""
    urdf, mjcf = urdf_text(pendulum(), ()), mjcf_text(pendulum(), (), free=False)
    lying = Rotation.from_euler("y", 90, degrees=True)
    comparison = compare_files(write(tmp_path, urdf, turn_base(mjcf, lying)))
    assert comparison.agree
    assert comparison.mount is not None
    assert comparison.mount.values["tilt"].value == pytest.approx(math.pi / 2)
    assert (
        "AGREE: no difference within the tolerances; but the base is tilted by 90 deg"
        in format_headline(comparison)
    )
    assert not compare_files(write(tmp_path, urdf, turn_base(mjcf, lying)), strict_names=True).agree
    about = Rotation.from_euler("z", 40, degrees=True)
    assert (
        compare_files(write(tmp_path, urdf, turn_base(mjcf, about)), strict_names=True).mount
        is None
    )


@pytest.mark.parametrize("seed", [1, 2])
def test_mount_tilt_is_the_angle_between_the_gravity_of_both_files(
    seed: int, tmp_path: Path
) -> None:
    """Reference: the angle between the gravity directions in both base frames.

    The URDF has a rotated root link, which matching leaves out.
    """
    turns = Rotation.random(2, rng=np.random.default_rng(seed))
    urdf = on_a_root(urdf_text(arm(), ()), turns[0])
    files = write(tmp_path, urdf, turn_base(mjcf_text(arm(), (), free=False), turns[1]))
    comparison = compare_files(files)
    assert comparison.mount is not None
    first, second = (turn.inv().apply([0.0, 0.0, -1.0]) for turn in turns)
    tilt = math.acos(float(first @ second))
    assert comparison.mount.values["tilt"].value == pytest.approx(tilt, abs=1e-9)


def test_equal_rotation_of_root_link_and_base_is_no_tilt(tmp_path: Path) -> None:
    """The URDF turns its base on a massless root as the MJCF does in the world."""
    turn = Rotation.from_euler("xyz", [0.4, -0.3, 1.0])
    urdf = on_a_root(urdf_text(arm(), ()), turn)
    files = write(tmp_path, urdf, turn_base(mjcf_text(arm(), (), free=False), turn))
    comparison = compare_files(files, strict_names=True)
    assert comparison.mount is None
    assert comparison.agree
