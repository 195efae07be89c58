"""The body of an MJCF that is the robot's base, in scenes with other bodies."""

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


def test_base_is_the_heaviest_free_body_with_joints(tmp_path: Path) -> None:
    """A crate of 100 kg has no joints, and a held robot of 50 kg is not free; each is the base only
    if no other body qualifies.
    """
    light = ROBOT.format(name="light", mass=1, free="<freejoint/>")
    heavy = ROBOT.format(name="heavy", mass=2, free="<freejoint/>")
    held = ROBOT.format(name="held", mass=50, free="")
    assert base_of(tmp_path, light, heavy, CRATE) == "heavy"
    assert base_of(tmp_path, CRATE, heavy, light) == "heavy"
    assert base_of(tmp_path, held, light) == "light"
    assert base_of(tmp_path, held) == "held"
    assert base_of(tmp_path, CRATE) == "crate"


def test_unnamed_joints_of_a_body_are_different_joints(tmp_path: Path) -> None:
    """The parameters of each joint are those of its own line."""
    file = tmp_path / "r.xml"
    file.write_text(
        '<mujoco><worldbody><body name="b"><geom size="0.1"/><joint axis="1 0 0" damping="0"/>'
        '<joint name="k" axis="0 1 0"/><joint axis="0 0 1" damping="3"/><joint type="slide"/>'
        "</body></worldbody></mujoco>"
    )
    joints = read_mjcf_model(read_mjcf(file)).joints
    stated = {name: joint.stated.get("damping") for name, joint in joints.items()}
    assert stated == {"(b)": 0.0, "k": None, "(b #2)": 3.0, "(b #3)": None}
    assert joints["(b #3)"].kind == "slide"
