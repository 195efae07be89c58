"""Which body of an MJCF is the robot's base: not what lies about in its scene."""

from __future__ import annotations

from pathlib import Path

import pytest

from pupper_analysis.models.mjcf_file import read_mjcf
from pupper_analysis.models.stated.mjcf import read_mjcf_model

ROBOT = """<body name="{name}" pos="0 0 1">{free}<geom size="0.1" mass="{mass}"/>
<body><joint name="{name}_hinge"/><geom size="0.1" pos="0.3 0 0" mass="0.1"/></body></body>"""
CRATE = '<body name="crate" pos="3 0 1"><freejoint/><geom size="0.5" mass="100"/></body>'


def base_of(folder: Path, *bodies: str) -> str:
    file = folder / "scene.xml"
    file.write_text(f"<mujoco><worldbody>{''.join(bodies)}</worldbody></mujoco>")
    return read_mjcf_model(read_mjcf(file)).base


def test_the_base_is_the_heaviest_that_is_free_and_moves_by_itself(tmp_path: Path) -> None:
    light = ROBOT.format(name="light", mass=1, free="<freejoint/>")
    heavy = ROBOT.format(name="heavy", mass=2, free="<freejoint/>")
    held = ROBOT.format(name="held", mass=50, free="")
    assert base_of(tmp_path, light, heavy, CRATE) == "heavy"
    assert base_of(tmp_path, CRATE, heavy, light) == "heavy"
    assert base_of(tmp_path, held, light) == "light"
    assert base_of(tmp_path, held) == "held"
    assert base_of(tmp_path, CRATE) == "crate"


def test_a_mesh_that_is_missing_is_a_shape_of_unknown_extent(tmp_path: Path) -> None:
    """As of a URDF: what is known of the link is not all of it."""
    file = tmp_path / "robot.xml"
    file.write_text("""<mujoco><asset><mesh name="shell" file="gone.stl"/></asset><worldbody>
      <body name="base"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><geom size="0.1"/>
        <body name="arm"><joint/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
          <geom size="0.02"/><geom type="mesh" mesh="shell"/></body></body>
      </worldbody></mujoco>""")
    links = read_mjcf_model(read_mjcf(file)).links
    assert [shape.kind for shape in links["base"].shapes] == ["sphere"]
    assert [shape.kind for shape in links["arm"].shapes] == ["sphere", "mesh"]
    assert links["arm"].shapes[1].points is None


def test_links_that_a_file_has_fused_are_kept_apart(tmp_path: Path) -> None:
    """As of a URDF: where each stands, what it weighs and which shapes it has."""
    file = tmp_path / "robot.xml"
    for fused in ("false", "true"):
        file.write_text(f"""<mujoco><compiler fusestatic="{fused}"/><worldbody>
          <body name="base" pos="0 0 1"><freejoint/><geom size="0.1" mass="2"/>
            <body name="leg"><joint name="hip"/><geom size="0.05" mass="0.4"/>
              <body name="foot" pos="0 0 -0.3"><geom name="ball" size="0.02" mass="0.1"/></body>
            </body></body></worldbody></mujoco>""")
        links = read_mjcf_model(read_mjcf(file)).links
        assert [*links] == ["base", "leg", "foot"]
        assert links["foot"].mass == 0.1
        assert links["foot"].pose.position == pytest.approx([0.0, 0.0, -0.3], abs=1e-12)
        assert [shape.name for shape in links["foot"].shapes] == ["ball"]
