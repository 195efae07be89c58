"""A URDF of an MJCF: which couplings it can say, and what is said of the others."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import pytest

import pupper_analysis as pa

FINGERS = """
<mujoco><compiler angle="radian"/>
<default><joint axis="0 1 0" range="-1 1" actuatorfrcrange="-3 3"/></default>
<worldbody><body name="palm">
  <geom size="0.05"/>
  <body name="one" pos="0.1 0 0"><joint name="first"/>
    <geom size="0.02" pos="0.1 0 0"/></body>
  <body name="two" pos="-0.1 0 0"><joint name="second"/>
    <geom size="0.02" pos="-0.1 0 0"/></body>
</body></worldbody><equality>{}</equality></mujoco>
"""


def converted(folder: Path, equality: str) -> tuple[list[ElementTree.Element], list[str]]:
    """The joints that mimic others, and the codes of what is left."""
    source, out = folder / "fingers.xml", folder / "fingers.urdf"
    source.write_text(FINGERS.format(equality))
    result = pa.convert_model(source, out)
    joints = ElementTree.parse(out).getroot().iter("joint")
    return [joint for joint in joints if joint.find("mimic") is not None], [
        left.code for left in result.not_converted
    ]


def test_a_line_is_a_mimic(tmp_path: Path) -> None:
    (joint,), left = converted(
        tmp_path, '<joint joint1="second" joint2="first" polycoef="0.1 -2 0 0 0"/>'
    )
    assert left == []
    assert joint.get("name") == "second"
    mimic = joint.find("mimic")
    assert mimic is not None
    assert mimic.get("joint") == "first"
    assert float(mimic.get("multiplier", "1")) == -2
    assert float(mimic.get("offset", "0")) == pytest.approx(0.1)


@pytest.mark.parametrize(
    "equality",
    [
        '<joint joint1="second" joint2="first" polycoef="0 1 0 0 0.5"/>',
        '<joint joint1="second" polycoef="0.1 0 0 0 0"/>',
        '<joint joint1="second" joint2="first" active="false"/>',
        '<weld body1="one" body2="two" active="true"/>',
    ],
)
def test_what_is_no_line_is_left_and_told(tmp_path: Path, equality: str) -> None:
    mimics, left = converted(tmp_path, equality)
    assert mimics == []
    assert left == ["equality-not-in-urdf"]


def test_numbers_of_contacts_and_options_that_a_urdf_cannot_state_are_listed(
    tmp_path: Path,
) -> None:
    """Of what touches alone: a geom that is only seen has none."""
    text = FINGERS.format("").replace(
        "<default>",
        '<option impratio="7" integrator="RK4"/><default><geom friction="0.6 0.1 0.2" condim="6"/>',
    )
    seen = '<geom size="0.01" friction="0.1" contype="0" conaffinity="0"/></body>\n</body>'
    source, urdf = tmp_path / "r.xml", tmp_path / "r.urdf"
    source.write_text(text.replace("</body>\n</body>", seen, 1))
    listed = {
        str(left.values["what"]): left.values["values"]
        for left in pa.convert_model(source, urdf).not_converted
        if left.code in ("contact-number-not-in-urdf", "option-not-in-urdf")
    }
    assert listed == {
        "friction": ("0.6 0.1 0.2",),
        "condim": ("6",),
        "impratio": ("7",),
        "integrator": ("1",),
    }
    assert not any(word in urdf.read_text() for word in listed)
