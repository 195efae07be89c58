"""Heights at reset, against closed forms."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest

from pupper_analysis.robot.fall import BodyMotion, initial_height

TETRAHEDRON = '<mesh name="tetrahedron" vertex="0 0 0 .1 0 0 0 .1 0 0 0 .1"/>'
FLOOR = '<geom type="plane" size="1 1 1" pos="0 0 {height}"/>'
STAIR = '<geom type="box" size=".2 .2 .05" pos="0 0 .25"/>'
WALL = '<geom type="box" size=".01 2 2" pos="-.12 0 0"/>'


def heights(geom: str, pos: str, world: str, euler: str = "0 0 0") -> tuple[float, float, float]:
    """Return CoM height, clearance and ground height (m) of a single free body."""
    xml = f"""<mujoco><asset>{TETRAHEDRON}</asset><worldbody>{world}
      <body pos="{pos}" euler="{euler}"><freejoint/>{geom}
      <body pos="0 0 .02"><joint/><geom size=".01"/></body></body></worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    margin = model.opt.o_margin
    found = initial_height(model, data, 1, -7.0)
    assert (model.opt.o_margin, model.opt.enableflags) == (margin, 0)
    np.testing.assert_array_equal(data.qpos, model.qpos0)
    mujoco.mj_forward(model, data)
    assert found.com == pytest.approx(data.subtree_com[1][2])
    return found.com, found.clearance, found.ground


@pytest.mark.parametrize(
    ("geom", "pos", "world", "euler", "clearance", "ground"),
    [
        ('<geom size=".1"/>', "0 0 1", FLOOR, "0 0 0", 0.9 - 0.2, 0.2),
        ('<geom size=".1"/>', "0 0 .3", FLOOR, "0 0 0", 0.0, 0.2),
        ('<geom size=".1"/>', "0 0 .29", FLOOR, "0 0 0", -0.01, 0.2),
        ('<geom type="box" size=".1 .1 .1"/>', "0 0 1", FLOOR, "45 0 0", 0.8 - 0.1 * 2**0.5, 0.2),
        ('<geom type="mesh" mesh="tetrahedron"/>', "0 0 1", FLOOR, "180 0 0", 0.7, 0.2),
        ('<geom size=".1"/>', "0 0 1", FLOOR + STAIR, "0 0 0", 0.9 - 0.3, 0.3),
        ('<geom size=".1"/>', "0 0 1", FLOOR + WALL, "0 0 0", 0.9 - 0.2, 0.2),
        ('<geom size=".1"/>', "0 0 1", "", "0 0 0", 0.0, -7.0),
    ],
)
def test_the_clearance_at_reset_is_that_of_the_lowest_point(
    geom: str, pos: str, world: str, euler: str, clearance: float, ground: float
) -> None:
    """Closed forms of the lowest point of a sphere, a box and a tetrahedron."""
    _, found, height = heights(geom, pos, world.format(height=0.2), euler)
    assert found == pytest.approx(clearance, abs=2e-6)
    assert height == pytest.approx(ground, abs=2e-6)


def test_the_clearance_above_a_sphere_is_vertical() -> None:
    """Two spheres of 0.1 m, 0.1 m apart sideways, touch at a vertical distance of sqrt(0.03) m."""
    world = '<geom size=".1" pos="0 0 0"/>'
    _, clearance, _ = heights('<geom size=".1"/>', "0.1 0 0.5", world)
    assert clearance == pytest.approx(0.5 - math.sqrt(0.04 - 0.01), abs=1e-5)


def test_a_drop_counts_as_lost_height_only_if_the_robot_lies_at_the_end() -> None:
    """A drop of 0.1 m is a third of 0.3 m; ``SUNKEN`` is 0.3."""
    lands = BodyMotion(5.0, 0.2, 0.18, 0.0, 0.0, diverged=False, clearance=0.1, lies=False)
    lies = BodyMotion(5.0, 0.2, 0.18, 0.0, 0.0, diverged=False, clearance=0.1, lies=True)
    assert not lands.collapses
    assert lies.collapses
