"""Constraints of an MJCF: stands keep them, or it is said on loading that they do not."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.robot.tendons import BONDS, tell_bonds_not_kept, tendon_ranges
from pupper_analysis.stance.workspace import reachable_heights
from tests.support.legged import Pair, quadruped, rewritten

ENDING = "</mujoco>"
TOLD = ("mjEQ_FLEX", "mjEQ_FLEXVERT", "mjEQ_FLEXSTRAIN")
GONE = "mjEQ_DISTANCE"  # MuJoCo refuses it since 2.2.2
SUM = {"FR_pitch": 1.0, "FR_knee": 0.1}


def with_tendon(folder: Path, terms: dict[str, float], range_: str) -> Pair:
    pair = quadruped(folder)
    joints = "".join(f'<joint joint="{name}" coef="{size}"/>' for name, size in terms.items())
    cord = f'<fixed name="cord" limited="true" range="{range_}">{joints}</fixed>'
    rewritten(pair.mjcf, (ENDING, f"<tendon>{cord}</tendon>{ENDING}"))
    return pair


def length(robot: pa.Robot, stand: pa.Stand, terms: dict[str, float]) -> float:
    joints = dict(zip(robot.joint_names, stand.joint_positions(robot).tolist(), strict=True))
    return sum(size * joints[name] for name, size in terms.items())


@pytest.mark.parametrize(
    ("terms", "range_", "least"), [({"FR_knee": -1.0}, "-1 1.3", 0.33763), (SUM, "-1 0.65", 0.3224)]
)
def test_heights_end_where_a_tendon_does(
    terms: dict[str, float], range_: str, least: float, tmp_path: Path
) -> None:
    """Without it, this robot's legs let it down to 0.121 m. MuJoCo says how long it is."""
    robot = pa.load_robot(*with_tendon(tmp_path, terms, range_))
    most = float(range_.split()[1])
    assert all(note.code != "tendon-ranges-not-kept" for note in robot.notes)
    heights = reachable_heights(robot)
    assert heights.low == pytest.approx(least, abs=1e-4)
    stand = pa.solve_stand(robot, pa.StandTask(height=heights.low))
    assert most - 2e-3 < length(robot, stand, terms) <= most + 1e-6
    data = mujoco.MjData(robot.mj_model)
    robot.mj_convention.set_state(data, stand.qpos)
    mujoco.mj_fwdPosition(robot.mj_model, data)
    assert data.ten_length[0] == pytest.approx(length(robot, stand, terms), abs=1e-12)

    lower = pa.StandTask(height=heights.low - 0.01)
    with pytest.raises(pa.StanceUnreachableError, match="tendon cord is at the end") as refusal:
        pa.solve_stand(robot, lower)
    assert refusal.value.limits["height"]["height"] == pytest.approx(heights.low, abs=1e-3)
    inside = pa.solve_stand(robot, pa.StandTask(height=heights.low - 0.01, com="inside"))
    assert inside.solved
    assert length(robot, inside, terms) <= most + 1e-6


def test_a_range_that_is_not_kept_is_told(tmp_path: Path) -> None:
    """A tendon through space."""
    pair = with_tendon(tmp_path, {"FR_knee": -1.0}, "-1 1.3")
    for held in (False, True):
        notes = pa.load_robot(*pair, fixed_base=held).notes
        assert all(note.code != "tendon-ranges-not-kept" for note in notes)
    text = pair.mjcf.read_text()
    begin, end = text.index("<fixed"), text.index("</fixed>") + len("</fixed>")
    spatial = '<spatial name="rope" limited="true" range="0 1"><site site="a"/><site site="b"/>'
    sites = '<site name="a"/><site name="b" pos="0 0 0.1"/><body name="FR_hip"'
    pair.mjcf.write_text(
        (text[:begin] + spatial + "</spatial>" + text[end:]).replace('<body name="FR_hip"', sites)
    )
    robot = pa.load_robot(*pair)
    assert not tendon_ranges(robot).names
    [message] = [note for note in robot.notes if note.code == "tendon-ranges-not-kept"]
    assert "rope (0 to 1)" in str(message)
    # Where MuJoCo does not keep it either, there is nothing to tell.
    off = '<option><flag limit="disable"/></option></mujoco>'
    rewritten(pair.mjcf, (ENDING, off))
    assert all(note.code != message.code for note in pa.load_robot(*pair).notes)


def test_every_kind_of_equality_is_kept_told_or_gone() -> None:
    """By MuJoCo's own list: a kind that a new version brings is to be looked at."""
    known = {kind.name for kind in BONDS} | {*TOLD, GONE}
    assert {name for name in dir(mujoco.mjtEq) if name.startswith("mjEQ_")} == known
    scene = """<mujoco><worldbody><body pos="0 0 1"><geom size="0.1"/></body>
      <flexcomp name="cloth" type="grid" count="3 3 1" spacing="0.1 0.1 0.1" mass="1" radius="0.01">
        <edge equality="true"/></flexcomp></worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(scene)
    [message] = tell_bonds_not_kept(model)
    assert "(flex)" in str(message)
    model.eq_active0[:] = 0
    assert not tell_bonds_not_kept(model)
    for kind in np.array([kind.value for kind in BONDS]):
        model.eq_active0[:], model.eq_type[:] = 1, kind
        assert not tell_bonds_not_kept(model)
