"""Slopes and steps in MuJoCo's model of a robot whose scene has several planes."""

from __future__ import annotations

import math
from pathlib import Path

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.robot.floor import merge_planes
from pupper_analysis.robot.terrain import build_on_ground
from tests.support.legged import quadruped

WALL = '<geom name="wall" type="plane" size="1 1 1" pos="3 0 0" quat="0.7071 0 -0.7071 0"/>'


def test_a_wall_still_collides_if_level_planes_are_merged() -> None:
    """Reference: contact bits of MuJoCo's compiled model. The wall has 2, the second floor 4."""
    second = '<geom name="second" type="plane" size="1 1 1" contype="4"/>'
    wall = WALL.replace("/>", ' contype="2"/>')
    floor = '<geom name="floor" type="plane" size="1 1 1"/>'
    spec = mujoco.MjSpec.from_string(
        f"<mujoco><worldbody>{floor}{second}{wall}</worldbody></mujoco>"
    )
    merge_planes(spec, spec.geom("floor"))
    model = spec.compile()
    bits = {name: int(model.geom(name).contype[0]) for name in ("floor", "second", "wall")}
    assert bits == {"floor": 5, "second": 0, "wall": 2}


@pytest.mark.parametrize("first", [WALL, '<geom name="second" type="plane" size="1 1 1"/>'])
def test_slope_is_the_only_ground_if_another_plane_precedes_the_floor(
    first: str, tmp_path: Path
) -> None:
    """Reference: the normal of the slope, and the contact forces on the scene without the plane."""
    slope, forces = 0.1, []
    for number, plane in enumerate(("", first)):
        (tmp_path / str(number)).mkdir()
        pair = quadruped(tmp_path / str(number), floor=True)
        text = pair.mjcf.read_text().replace("<worldbody>", f"<worldbody>{plane}", 1)
        pair.mjcf.write_text(text)
        robot = pa.load_robot(urdf=pair.urdf, mjcf=pair.mjcf)
        stand = pa.solve_stand(robot, pa.StandTask(ground=pa.Ground(slope=slope)))
        qpos = stand.qpos.copy()
        qpos[2] -= 0.002
        built = build_on_ground(stand.check(robot), stand.task.ground, stand.rigid_targets)
        data = mujoco.MjData(built.mj_model)
        built.mj_convention.set_state(data, qpos)
        mujoco.mj_forward(built.mj_model, data)
        normals = np.abs(data.contact.frame[:, :3])
        expected = np.tile((math.sin(slope), 0.0, math.cos(slope)), (len(robot.feet), 1))
        np.testing.assert_allclose(normals, expected, atol=1e-9)
        forces.append(data.qfrc_constraint.copy())
    np.testing.assert_allclose(forces[1], forces[0], rtol=1e-6, atol=1e-6)
