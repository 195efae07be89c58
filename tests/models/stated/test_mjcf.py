"""The body of an MJCF that is the robot's base, in scenes with other bodies."""

from __future__ import annotations

from pathlib import Path

import pytest

from pupper_analysis.models.mjcf_file import read_mjcf
from pupper_analysis.models.stated.mjcf import (
    find_element_place,
    place_of_geom,
    read_mjcf_model,
)

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


GEOMS = """<mujoco><compiler {compiler}/>
<asset><mesh name="gone" file="gone.obj"/>{model}</asset>
<default><default class="small"><geom size="0.07"/></default></default>
<worldbody>
<frame><geom size="0.01"/></frame>
<geom size="0.02"/>
<body name="b"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><freejoint/>
<geom type="mesh" mesh="gone" contype="0" conaffinity="0"/>
<frame>
<geom size="0.03"/>
</frame>
<replicate count="2" offset="0 0 1">
<geom size="0.04"/>
<geom name="named" size="0.05"/>
</replicate>
<geom size="0.06" contype="0" conaffinity="0"/>
<geom class="small"/>
<geom size="0.08"/>
{more}
</body>
</worldbody>
</mujoco>"""
ATTACHED = """<mujoco model="other"><worldbody>
<frame name="frame"><geom size="0.09"/></frame>
<body name="part">
<geom size="0.11"/>
</body>
</worldbody></mujoco>"""


@pytest.mark.parametrize(("compiler", "discarded"), [("", 0), ('discardvisual="true"', 1)])
def test_place_of_an_unnamed_geom_is_its_own_line(
    tmp_path: Path, compiler: str, discarded: int
) -> None:
    """Each geom of the compiled model has another size, which its line contains."""
    file = tmp_path / "r.xml"
    file.write_text(GEOMS.format(compiler=compiler, model="", more=""))
    lines, mjcf = file.read_text().splitlines(), read_mjcf(file)
    unnamed = [geom for geom in range(mjcf.model.ngeom) if not mjcf.model.geom(geom).name]
    assert len(unnamed) == 8 - discarded
    for geom in unnamed:
        line = place_of_geom(mjcf, geom, "shape").line
        assert line is not None
        assert f'size="{mjcf.model.geom_size[geom, 0]:g}"' in lines[line - 1]


def test_place_of_an_unnamed_geom_is_the_body_if_its_element_is_unknown(tmp_path: Path) -> None:
    """Geoms of attached models, and of fused bodies, have no line among those of the body."""
    (tmp_path / "other.xml").write_text(ATTACHED)
    model = '<model name="other" file="other.xml"/>'
    more = '<attach model="other" frame="frame" prefix="x_"/>'
    fused = '<body name="c"><geom size="0.12"/></body>'
    file = tmp_path / "r.xml"
    for compiler, content in (("", more), ('fusestatic="true"', fused)):
        file.write_text(GEOMS.format(compiler=compiler, model=model, more=content))
        mjcf = read_mjcf(file)
        body = mjcf.place("body", "b")
        geoms = [
            geom
            for geom in range(mjcf.model.ngeom)
            if mjcf.model.geom_bodyid[geom] and not mjcf.model.geom(geom).name
        ]
        assert len(geoms) == 7
        assert {place_of_geom(mjcf, geom, "") for geom in geoms} == {body}


def test_line_of_an_attached_element_is_not_given_for_the_main_file(tmp_path: Path) -> None:
    """MuJoCo records the line in the attached file, without the name of that file."""
    (tmp_path / "other.xml").write_text(ATTACHED)
    file = tmp_path / "r.xml"
    model = '<model name="other" file="other.xml"/>'
    more = '<attach model="other" body="part" prefix="x_"/>'
    file.write_text(GEOMS.format(compiler="", model=model, more=more))
    mjcf = read_mjcf(file)
    [geom] = [geom for geom in mjcf.spec.geoms if geom.parent.name == "x_part"]
    assert "line 4" in geom.info
    assert find_element_place(mjcf, geom, "x_part").line is None
    assert find_element_place(mjcf, mjcf.spec.body("b").geoms[0], "b") == mjcf.place("body", "b")
