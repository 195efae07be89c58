"""Contacts of flexible bodies (``flex``), for which MuJoCo stores -1 as the id of the geom."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.robot.contact import (
    find_ground_contacts,
    ground_forces,
    list_contact_bodies,
)
from tests.support.slips import standing

SOFT_BOX = (
    '<flexcomp name="soft" type="grid" count="3 3 2" spacing="0.1 0.1 0.05" radius="0.01" {options}'
    ' dim="3" mass="1"><contact selfcollide="none"/><edge equality="true"/></flexcomp>'
)
"""Elastic box of 18 vertices."""


@pytest.mark.parametrize("options", ['dof="full"', 'dof="trilinear"'])
def test_a_contact_of_a_flex_belongs_to_its_bodies(options: str) -> None:
    """Reference: names of the bodies of the flex; they start with the name of the flex.

    The last geom, which NumPy returns for the index -1, belongs to another body.
    """
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><geom type="plane" size="0 0 1"/>'
        + SOFT_BOX.format(options=f'pos="0 0 0.034" {options}')
        + '<body name="ball" pos="1 0 0.019"><freejoint/><geom name="ball" size="0.02"/></body>'
        "</worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    bodies = list_contact_bodies(model, data)
    flexible = (data.contact.geom < 0).any(axis=1)
    assert flexible.sum() > 1
    assert (~flexible).sum() == 1
    for pair, is_flex in zip(bodies.tolist(), flexible.tolist(), strict=True):
        world, other = sorted(pair)
        assert world == 0
        assert model.body(other).name.startswith("soft" if is_flex else "ball")
    feet = {model.geom("ball").id: "foot"}
    forces, others = ground_forces(model, data, feet)
    assert set(forces) == {"foot"}
    assert others
    assert find_ground_contacts(model, data, feet) == ({"foot"}, others)
    assert all(name.startswith("soft") for name in others)


def test_a_robot_with_a_flex_is_refused_but_audited(tmp_path: Path) -> None:
    """A soft pad on the trunk: its vertices have joints, which are no limbs of the robot."""
    pair = standing(tmp_path)
    trunk = '<body name="trunk" pos="0 0 0.35"><freejoint/>'
    text, pad = pair.mjcf.read_text(), SOFT_BOX.format(options='pos="0 0 0.15"')
    assert trunk in text
    pad = pad.replace("</flexcomp>", '<pin id="0 2 4 6"/></flexcomp>')
    pair.mjcf.write_text(text.replace(trunk, trunk + pad))
    assert pa.audit_model(pair.mjcf).findings
    for files in ((pair.mjcf,), (pair.urdf, pair.mjcf)):
        with pytest.raises(pa.ModelError, match="flex soft") as caught:
            pa.load_robot(*files)
        assert caught.value.cause.code == "flex-in-robot"


@pytest.mark.slow
def test_a_flex_beside_a_robot_touches_no_part_of_it(tmp_path: Path) -> None:
    """Reference: the same file without the flex; the robot stands 2 m beside the soft box."""
    pair = standing(tmp_path)
    text = pair.mjcf.read_text()
    box = SOFT_BOX.format(options='pos="2 0 0.1"')
    runs = []
    for content in (text, text.replace("</worldbody>", box + "</worldbody>")):
        pair.mjcf.write_text(content)
        robot = pa.load_robot(pair.urdf, pair.mjcf)
        run = pa.judge_stand(robot, pa.solve_stand(robot)).keyframe_run
        assert run is not None
        runs.append(run)
    assert not runs[1].fails
    assert runs[1].height == pytest.approx(runs[0].height, abs=1e-6)
    assert np.isclose(runs[1].end_height, runs[0].end_height, atol=1e-4)
