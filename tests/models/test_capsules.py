"""Capsules of a URDF: Pinocchio's and PlaCo's reader does not know them, and leaves them out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from pupper_analysis.models.urdf_file import read_urdf
from pupper_analysis.models.xml import parse_text


def test_engines_get_the_same_points(tmp_path: Path) -> None:
    """Rays from all around meet MuJoCo's capsule where they meet the three shapes."""
    path = tmp_path / "robot.urdf"
    path.write_text(
        '<robot name="r"><link name="base"><collision name="c">'
        '<origin xyz="0.1 -0.05 0.2" rpy="0.4 -0.7 1.1"/>'
        '<geometry><capsule radius="0.05" length="0.2"/></geometry></collision></link></robot>'
    )
    file = read_urdf(path)
    given, made = file.root.findall("link/collision"), parse_text(file.text)
    assert [shape.find("geometry")[0].tag for shape in given] == ["capsule"]
    parts = made.findall("link/collision")
    assert [shape.find("geometry")[0].tag for shape in parts] == ["cylinder", "sphere", "sphere"]
    assert len({shape.get("name") for shape in parts}) == 3
    one, two = _model(given), _model(parts)
    met = 0
    for way in np.random.default_rng(1).normal(size=(200, 3)):
        way /= np.linalg.norm(way)
        start = np.array([0.12, -0.03, 0.17]) - way
        distances = [_meets(model, start, way) for model in (one, two)]
        assert distances[0] == pytest.approx(distances[1], abs=1e-9)
        met += distances[0] > 0
    assert met > 150


def _model(shapes: list[Any]) -> mujoco.MjModel:
    spec = mujoco.MjSpec()
    for shape in shapes:
        origin, geometry = shape.find("origin"), shape.find("geometry")[0]
        xyz, rpy = (np.array(origin.get(name).split(), dtype=float) for name in ("xyz", "rpy"))
        quaternion = np.zeros(4)
        mujoco.mju_euler2Quat(quaternion, rpy, "XYZ")
        size = [float(geometry.get("radius")), float(geometry.get("length", 0)) / 2, 0]
        kind = getattr(mujoco.mjtGeom, f"mjGEOM_{geometry.tag.upper()}")
        spec.worldbody.add_geom(type=kind, size=size, pos=xyz, quat=quaternion)
    return spec.compile()


def _meets(model: mujoco.MjModel, start: np.ndarray, way: np.ndarray) -> float:
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return float(mujoco.mj_ray(model, data, start, way, None, 1, -1, np.zeros(1, np.int32), None))
