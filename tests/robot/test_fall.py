"""Heights at reset, against closed forms, and simulations that MuJoCo resets."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest

from pupper_analysis.models.mjcf import silence_mujoco
from pupper_analysis.robot.fall import (
    BodyMotion,
    initial_height,
    nudge_velocity,
    simulate_held_keyframe,
    simulate_keyframe,
    was_reset_by_mujoco,
)

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


def test_drop_counts_as_height_loss_only_if_the_robot_lies_at_the_end() -> None:
    """A drop of 0.1 m is a third of 0.3 m; ``MAX_HEIGHT_LOSS_RATIO`` is 0.3."""
    lands = BodyMotion(5.0, 0.2, 0.18, 0.0, 0.0, diverged=False, clearance=0.1, lies=False)
    lies = BodyMotion(5.0, 0.2, 0.18, 0.0, 0.0, diverged=False, clearance=0.1, lies=True)
    assert not lands.collapses
    assert lies.collapses


SERVO = """<mujoco><option timestep="0.002"/><worldbody><geom type="plane" size="0 0 1"/>
<body pos="0 0 0.1"><freejoint/><geom type="box" size="0.1 0.1 0.1" mass="1"/>
<body><joint name="wheel" armature="0.1"/>
<geom size="0.01" mass="0.1" contype="0" conaffinity="0"/></body></body>
</worldbody><actuator><position joint="wheel" kp="10" kv="1"/></actuator></mujoco>"""


@pytest.mark.parametrize(("ctrl", "lost"), [(0.0, False), (1.0, False), (9e9, True)])
def test_a_simulation_that_mujoco_resets_in_its_first_step_has_diverged(
    ctrl: float, lost: bool
) -> None:
    """Reference: a command of 9e9 N m overflows, 0 and 1 N m do not.

    MuJoCo resets a diverged state, its command and its time, so that it seems to be at rest.
    """
    model = mujoco.MjModel.from_xml_string(SERVO)
    start = mujoco.MjData(model)
    start.ctrl[:] = ctrl

    def advance(data: mujoco.MjData, seconds: float) -> None:
        mujoco.mj_step(model, data, round(seconds / model.opt.timestep))

    with silence_mujoco():
        motion, end = simulate_keyframe(model, start, 1, 0.0, advance)
        held, _ = simulate_held_keyframe(model, start, advance)
    assert end.time == pytest.approx(motion.duration, abs=2 * model.opt.timestep)
    assert was_reset_by_mujoco(end) is motion.diverged is motion.collapses is held.diverged is lost


BOX = """<mujoco><option timestep="0.002"/><worldbody><geom type="plane" size="0 0 1"/>
<body pos="0 0 0.5"><freejoint/><geom type="box" size="0.1 0.1 0.5" mass="1"/>
</body></worldbody></mujoco>"""


def test_runs_that_equal_the_first_run_end_halfway() -> None:
    """Reference: the time of MuJoCo's state of each run; a box at rest returns from each nudge."""
    model = mujoco.MjModel.from_xml_string(BOX)
    times: dict[int, float] = {}

    def advance(data: mujoco.MjData, seconds: float) -> None:
        mujoco.mj_step(model, data, round(seconds / model.opt.timestep))
        times[id(data)] = float(data.time)

    motion, end = simulate_keyframe(model, mujoco.MjData(model), 1, 0.0, advance)
    assert not motion.collapses
    assert end.time == pytest.approx(motion.duration)
    assert sum(times.values()) == pytest.approx((1.0 + 0.5 + 0.5) * motion.duration)


def test_a_robot_that_falls_only_after_the_opposite_nudge_is_still_found() -> None:
    """Reference: bare MuJoCo; a torque upsets a box that is nudged to one side.

    This run differs from the first run halfway, so that it is not cut short.
    """
    model = mujoco.MjModel.from_xml_string(BOX)
    side = float(np.sign(nudge_velocity(model)[0]))

    def advance(data: mujoco.MjData, seconds: float) -> None:
        if not data.time and data.qvel[0] * side < 0:
            data.qfrc_applied[4] = 2.0
        mujoco.mj_step(model, data, round(seconds / model.opt.timestep))

    motion, _ = simulate_keyframe(model, mujoco.MjData(model), 1, 0.0, advance)
    assert motion.collapses
