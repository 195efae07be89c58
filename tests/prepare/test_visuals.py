"""Visual geoms are left out while a robot is prepared, and are present in the loaded robot."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.models.mjcf_file import read_mjcf
from pupper_analysis.prepare.judge import list_file_remarks
from pupper_analysis.prepare.published_model import compile_published_model
from pupper_analysis.prepare.touching import discard_visuals
from pupper_analysis.robot.tool import find_place, measure_size
from tests.support.legged import quadruped, rewrite_file

SPEC = """<mujoco><worldbody><body name="a"><freejoint/>
  <geom name="seen" type="box" size=".1 .2 .3" contype="0" conaffinity="0" mass="2"/>
  <geom type="sphere" size=".1" pos="0 0 1"/>
  <geom name="last" type="sphere" size=".2" pos="0 0 -1"/></body></worldbody></mujoco>"""


def test_mass_and_inertia_do_not_change_without_visuals() -> None:
    """Reference: MuJoCo's compiled masses [kg] and inertias [kg m^2]; the visual geom has a mass of
    2 kg.
    """
    spec = mujoco.MjSpec.from_string(SPEC)
    original = spec.copy().compile()
    discard_visuals(spec)
    model = spec.copy().compile()
    assert (original.ngeom, model.ngeom) == (3, 2)
    np.testing.assert_allclose(model.body_mass, original.body_mass, rtol=1e-14)
    np.testing.assert_allclose(model.body_inertia, original.body_inertia, rtol=1e-12)
    assert len(spec.geoms) == 3  # a copy of the spec is compiled


def test_visuals_are_kept_in_a_fluid() -> None:
    """Drag depends on the shapes of all geoms."""
    spec = mujoco.MjSpec.from_string(SPEC)
    spec.option.viscosity = 1e-3
    discard_visuals(spec)
    assert spec.copy().compile().ngeom == 3


@pytest.mark.slow
def test_loaded_robot_has_its_visuals(tmp_path: Path) -> None:
    """A visual box before the other geoms; the foot geoms are still the spheres."""
    pair = quadruped(tmp_path)
    seen = '<geom name="hat" type="box" size=".1 .1 .1" contype="0" conaffinity="0" mass="0"/>'
    rewrite_file(pair.mjcf, ("<freejoint/>", f"<freejoint/>{seen}"))
    robot = pa.load_robot(*pair)
    assert robot.mj_model.geom("hat").contype[0] == 0
    assert not robot.description.mjcf.compiler.discardvisual
    assert set(robot.foot_geoms.values()) == set(robot.feet)
    for geom in robot.foot_geoms:
        assert robot.mj_model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_SPHERE.value


@pytest.mark.slow
def test_published_model_has_geoms_in_the_order_of_the_robot(tmp_path: Path) -> None:
    """Geoms without collisions are found by their index among the geoms of the body."""
    pair = quadruped(tmp_path)
    seen = '<geom type="box" size=".1 .1 .1" contype="0" conaffinity="0" mass="0"/>'
    text = re.sub(r"<geom[^>]*type=\"plane\"[^>]*/>", "", pair.mjcf.read_text())
    pair.mjcf.write_text(text.replace("<freejoint/>", f"<freejoint/>{seen}", 1))
    robot = pa.load_robot(*pair)
    assert "ground-added" in {note.code for note in robot.notes}
    model = compile_published_model(read_mjcf(pair.mjcf), robot)
    assert model is not None
    for body in range(1, model.nbody):
        same = robot.mj_model.body(model.body(body).name)
        assert same.geomnum[0] == model.body_geomnum[body]
        first, there = int(model.body_geomadr[body]), int(same.geomadr[0])
        for index in range(int(model.body_geomnum[body])):
            kinds = model.geom_type[first + index], robot.mj_model.geom_type[there + index]
            assert kinds[0] == kinds[1]


def test_robot_that_is_not_drawn_has_no_visuals_and_equal_remarks(tmp_path: Path) -> None:
    """Reference: the same MJCF with its visual geoms.

    A hip of 12 kg has only a visual geom: without this shape, its density is unknown. The payload
    is at the frame of this geom.
    """
    pair = quadruped(tmp_path)
    seen = '<geom name="hat" size=".01" pos=".01 0 0" contype="0" conaffinity="0" mass="0"/>'
    hip = '<inertial pos="0 0 0" mass="0.4" diaginertia="4e-4 4e-4 4e-4"/>'
    rewrite_file(pair.mjcf, (hip, hip.replace("0.4", "12") + seen), count=1)
    drawn, undrawn = (pa.load_robot(pair.mjcf, visuals=visuals) for visuals in (True, False))
    assert undrawn.mj_model.ngeom == drawn.mj_model.ngeom - 1
    assert "mass-beyond-metal" in {remark.code for remark in list_file_remarks(undrawn)}
    assert list_file_remarks(undrawn) == list_file_remarks(drawn)
    assert measure_size(undrawn) == measure_size(drawn)
    tools = [find_place(robot, ("hat", 0.0, 0.0, 0.1)) for robot in (drawn, undrawn)]
    assert tools[0].link == tools[1].link
    np.testing.assert_array_equal(tools[0].offset, tools[1].offset)
    for field in ("body_mass", "body_inertia", "actuator_gainprm", "key_qpos"):
        expected = getattr(drawn.mj_model, field)
        np.testing.assert_array_equal(getattr(undrawn.mj_model, field), expected)


def test_fixed_base_of_a_file_with_an_unnamed_joint_is_fixed_in_the_published_model(
    tmp_path: Path,
) -> None:
    """The model keeps the two hinges, and loses the free joint."""
    shape = '<geom type="capsule" size="0.02" fromto="0 0 0 0 0 -0.2" mass="0.3"/>'
    file = tmp_path / "leg.xml"
    file.write_text(
        '<mujoco><worldbody><body name="base" pos="0 0 1"><freejoint/>'
        '<geom type="box" size="0.1 0.1 0.05" mass="2"/>'
        f'<body name="thigh"><joint axis="0 1 0" range="-90 90"/>{shape}'
        f'<body name="calf" pos="0 0 -0.2"><joint name="knee" axis="0 1 0" range="-90 90"/>{shape}'
        "</body></body></body></worldbody></mujoco>"
    )
    robot = pa.load_robot(file, fixed_base=True)
    model = compile_published_model(read_mjcf(file), robot)
    assert model is not None
    assert (model.nq, model.njnt) == (2, 2)
