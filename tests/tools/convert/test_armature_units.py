"""Unit of the armature: kg m^2 of a hinge, kg of a slide."""

from __future__ import annotations

from pathlib import Path

import pytest

import pupper_analysis as pa
from pupper_analysis.tools.convert.command import _assign_by_pattern

_CART = """<mujoco model="cart"><compiler angle="radian"/><worldbody><body name="base">
<geom type="box" size=".1 .1 .1" mass="1"/><body name="cart" pos="0 0 0.2">
<joint name="rail" type="slide" axis="1 0 0" range="-1 1" armature="0.5" damping="2"/>
<geom type="box" size=".05 .05 .05" mass="1"/><body name="pole" pos="0 0 0.1">
<joint name="pivot" axis="0 1 0" range="-1 1" armature="0.01" damping="3"/>
<geom type="capsule" fromto="0 0 0 0 0 0.3" size=".01" mass="0.2"/></body></body></body></worldbody>
<actuator><motor joint="rail"/><motor joint="pivot"/></actuator></mujoco>"""


@pytest.mark.slow
def test_armature_of_slides_and_hinges_is_reported_in_units_of_its_own(tmp_path: Path) -> None:
    """Reference: the numbers of the MJCF."""
    source = tmp_path / "cart.xml"
    source.write_text(_CART)
    conversion = pa.convert_model(source, tmp_path / "cart.urdf")
    lost = [str(loss) for loss in conversion.not_converted if loss.code == "armature-not-in-urdf"]
    assert [loss.partition(":")[0] for loss in lost] == [
        "armature (0.01 kg m^2)",
        "armature (0.5 kg)",
    ]
    copied = [
        str(note)
        for note in pa.compare_models(tmp_path / "cart.urdf", source).notes
        if note.code == "armature-of-the-mjcf-alone"
    ]
    assert [note.partition(" is only in")[0] for note in copied] == [
        "armature (0.01 kg m^2 on 1 joint)",
        "armature (0.5 kg on 1 joint)",
    ]
    urdf = tmp_path / "cart.urdf"
    for joint, unit in (("rail", "-1 kg,"), ("pivot", "-1 kg m^2,")):
        with pytest.raises(pa.ConfigurationError, match=unit.replace("^", r"\^")):
            pa.convert_model(urdf, tmp_path / "new.xml", armature={joint: -1.0})


def test_armature_of_a_joint_with_brackets_is_assigned_by_its_name() -> None:
    assigned = _assign_by_pattern(("arm0=0.1", "arm[0]=0.2"), ["arm0", "arm[0]"])
    assert assigned == {"arm0": 0.1, "arm[0]": 0.2}
