"""Which body of an MJCF is the robot's base: not what lies about in its scene."""

from __future__ import annotations

from pathlib import Path

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
