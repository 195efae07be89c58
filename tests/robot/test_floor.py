"""Grounds of scenes: planes of bodies, tilted or higher, boxes, stairs, contact pairs.

MuJoCo's contacts and the stands on a level plane are the references.
"""

from __future__ import annotations

import copy
import math
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.base.diagnostics import Severity
from pupper_analysis.robot.floor import level_ground
from pupper_analysis.robot.robot import Robot
from tests.support.legged import Pair, quadruped

PLANE = '<geom name="ground" type="plane" size="0 0 1" friction="0.9 0.01 0.001"'

FOOT = '<geom name="foot" type="sphere" size="0.02" pos="0 0 -0.2"/>'

LEVEL, OTHERS, PAIRS = "floor-laid-level", "scenery-left-out", "pairs-became-geoms"
TILTED = "tilted-floor-laid-level"


def write_scene(folder: Path, floor: str, contacts: str = "") -> Pair:
    """Write a quadruped with a floor of its own; the geoms of its feet are ``foot0`` to
    ``foot3``.
    """
    pair = quadruped(folder, floor=True, foot=FOOT)
    text = pair.mjcf.read_text().replace('<geom type="plane" size="0 0 1"/>', floor)
    for number in range(4):
        text = text.replace('"foot"', f'"foot{number}"', 1)
    text = text.replace("</worldbody>", f"</worldbody><contact>{contacts}</contact>")
    pair.mjcf.write_text(text)
    return pair


def load_pair(pair: Pair) -> Robot:
    return pa.load_robot(*pair)


def verify_stand_on_scene(robot: Robot, **task: Any) -> pa.simulation.StandVerification:
    """Return the verification of a stand on the ground of a scene; assert that MuJoCo holds the
    stand.
    """
    stand = pa.stance.solve_stand_on_soft_ground(robot, pa.StandTask(**task))
    found = pa.verify_stand(robot, stand)
    assert found.passed, found.failures
    return found


def test_a_plane_at_zero_is_not_changed(tmp_path: Path) -> None:
    spec = mujoco.MjSpec.from_file(str(write_scene(tmp_path, PLANE + "/>").mjcf))
    before = spec.to_xml()
    assert level_ground(spec) == []
    assert spec.to_xml() == before


def test_a_levelled_plane_is_at_zero_if_the_default_class_raises_geoms() -> None:
    """Reference: the plane of an MJCF without default class, after it is levelled."""
    plane = PLANE + ' pos="0 0 0.2" euler="0 0 0"/>'
    default = '<default><geom pos="0 0 0.5" euler="90 0 0"/></default>'
    planes = []
    for text in ("", default):
        spec = mujoco.MjSpec.from_string(f"<mujoco>{text}<worldbody>{plane}</worldbody></mujoco>")
        assert [note.code for note in level_ground(spec)] == [LEVEL]
        planes.append(spec.compile().geom("ground"))
    for plane in planes:
        assert (plane.pos.tolist(), plane.quat.tolist()) == ([0, 0, 0], [1, 0, 0, 0])


def test_a_table_is_not_part_of_the_centre_of_mass(tmp_path: Path) -> None:
    """The URDF has no table; with its 5 kg, the MJCF's centre of mass was another one."""
    table = '<body name="table" pos="1 0 0.1"><geom type="box" size="1 1 0.01" mass="5"/></body>'
    comparison = pa.compare_models(*write_scene(tmp_path, PLANE + "/>" + table))
    assert not [difference for difference in comparison.differences if difference.kind != "effort"]
    assert comparison.deviations["com"] < 1e-9
    assert not [note for note in comparison.notes if "engines differ" in str(note)]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("floor", "reported"),
    [
        (f'<body name="ground">{PLANE}/></body>', None),
        (f'<body pos="0 0 0.3" euler="0 1.5707963267948966 0">{PLANE}/></body>', "tilted by 90"),
        (f'{PLANE} pos="0.2 0 0.05"/>', "at z = 50 mm"),
        (f'{PLANE} euler="0 0.1 0"/>', "tilted by 5.73 deg"),
        (f'{PLANE} euler="0 0 1.5"/>', None),
        (f'<frame euler="0 0 0.5">{PLANE}/></frame>', None),
    ],
)
def test_stands_on_a_floor_anywhere_are_those_on_a_level_floor_at_zero(
    tmp_path: Path, floor: str, reported: str | None
) -> None:
    """Reference: the stands on the plane at z = 0. A note names tilt and height that differ."""
    robot, plain = (load_pair(write_scene(tmp_path, text)) for text in (floor, PLANE + "/>"))
    notes = [note for note in robot.notes if note.code in (LEVEL, TILTED)]
    assert bool(notes) == (reported is not None)
    assert all((reported or "") in str(note) for note in notes)
    # From a tilted floor the file itself may fall: the short answer prints warnings.
    is_tilted = "tilted" in (reported or "")
    assert any(note.severity is Severity.WARNING for note in notes) is is_tilted
    assert not [note for note in robot.notes if note.code == OTHERS]
    for task in ({}, {"ground": pa.Ground(slope=0.05, uphill=0.7)}):
        seen, known = (verify_stand_on_scene(scene, **task) for scene in (robot, plain))
        assert seen.joint_torques == pytest.approx(known.joint_torques, abs=1e-6)
        assert robot.contacts == plain.contacts


def test_the_level_plane_is_the_floor_if_a_wall_comes_first(tmp_path: Path) -> None:
    """The friction of the feet is that of the plane at z = 50 mm, not that of the wall."""
    wall = '<geom type="plane" size="0 0 1" pos="-2 0 0" euler="0 1.57 0" friction="2.5"/>'
    robot = load_pair(write_scene(tmp_path, wall + f'{PLANE} pos="0.2 0 0.05"/>'))
    (message,) = [str(note) for note in robot.notes if note.code in (LEVEL, TILTED)]
    assert "at z = 50 mm" in message
    assert "tilted" not in message
    # The larger value counts: 1 of the feet, 0.01 m (torsional) of the plane.
    assert {foot.friction[::2][:2] for foot in robot.contacts.values()} == {(1, 0.01)}


def test_contact_pairs_of_objects_in_the_scene_are_left_out(tmp_path: Path) -> None:
    """Reference: MuJoCo's contacts with a foot in the stair, before and after."""
    stair = '<geom name="stair" type="box" size="1 1 0.1" pos="0 0 0"/>'
    contacts = "".join(f'<pair geom1="stair" geom2="foot{leg}"/>' for leg in range(4))
    spec = mujoco.MjSpec.from_file(str(write_scene(tmp_path, PLANE + "/>" + stair, contacts).mjcf))
    names = []
    for change in (lambda _: [], level_ground):
        change(spec)
        model = spec.compile()
        data = mujoco.MjData(model)
        data.qpos[2] = 0.45
        mujoco.mj_forward(model, data)
        names.append({model.geom(geom).name for geom in data.contact.geom.ravel()})
    assert names[0] > {"stair", "foot0"}
    assert "stair" not in names[1]


def write_frictions(folder: Path, friction: str) -> Pair:
    """Write a quadruped without floor; ``friction`` is the attribute of the geoms of its feet."""
    return quadruped(folder, foot=f'<geom friction="{friction}" size="0.02" pos="0 0 -0.2"/>')


@pytest.mark.parametrize(
    ("friction", "expected"),
    [
        ("0", (0.0, 0.005, 0.0001)),
        ("0.6", (0.6, 0.005, 0.0001)),
        ("1.5", (1.5, 0.005, 0.0001)),
        ("0.3 0.001 0.00002", (0.3, 0.001, 0.00002)),
    ],
)
def test_an_added_floor_leaves_the_friction_of_the_feet(
    tmp_path: Path, friction: str, expected: tuple[float, float, float]
) -> None:
    """Reference: the attribute, with MuJoCo's defaults 0.005 and 0.0001.

    MuJoCo replaces coefficients of a contact below 1e-5 by 1e-5.
    """
    robot = load_pair(write_frictions(tmp_path, friction))
    data = mujoco.MjData(robot.mj_model)
    mujoco.mj_resetDataKeyframe(robot.mj_model, data, 0)
    data.qpos[2] -= 0.01
    mujoco.mj_forward(robot.mj_model, data)
    feet = [contact for contact in data.contact if set(contact.geom) & robot.foot_geoms.keys()]
    assert len(feet) == 4
    for contact in feet:
        np.testing.assert_allclose(contact.friction[[0, 2, 3]], np.maximum(expected, 1e-5))
    for combined in robot.contacts.values():
        assert combined.sliding_friction == pytest.approx(expected[0])


@pytest.mark.parametrize(("slope", "holds"), [(0.18, True), (0.22, False)])
def test_feet_on_an_added_floor_slip_on_slopes_steeper_than_their_friction(
    tmp_path: Path, slope: float, holds: bool
) -> None:
    """Reference: Coulomb's law, tan(slope) = 0.2 at 0.197 rad."""
    robot = load_pair(write_frictions(tmp_path, "0.2"))
    task = pa.StandTask(ground=pa.Ground(slope=slope))
    stand = pa.solve_stand(robot, task)
    if holds:
        used = pa.stance.stand_statics(robot, stand).friction_utilisation
        assert math.tan(slope) / 0.2 <= max(used.values()) <= 1
    else:
        with pytest.raises(pa.StaticsInfeasibleError):
            pa.stance.stand_statics(robot, stand)


@pytest.mark.slow
def test_objects_of_the_scene_are_left_out_with_a_note(tmp_path: Path) -> None:
    """A box as ground, stairs under the robot, and a table that no joint moves."""
    stairs = '<geom name="stair" type="box" size="1 1 0.03" pos="0.5 0 0.03"/>'
    table = '<body name="table"><geom type="box" size="1 1 0.01"/></body>'
    robot = load_pair(write_scene(tmp_path, PLANE + "/>" + stairs + table))
    assert any("(stair)" in str(note) for note in robot.notes if note.code == OTHERS)
    assert any("'table' is not part of the robot" in str(note) for note in robot.notes)
    verify_stand_on_scene(robot)
    box = '<geom name="floor" type="box" size="5 5 0.05" pos="0 0 -0.05"/>'
    robot = load_pair(write_scene(tmp_path, box))
    assert any(note.code == "ground-added" for note in robot.notes)
    verify_stand_on_scene(robot)


@pytest.mark.slow
def test_contact_parameters_of_pairs_equal_the_unmodified_file(tmp_path: Path) -> None:
    """Reference: MuJoCo's contacts of the published file."""
    values = 'friction="0.37 0.37 0.02 0.003 0.003" solref="0.03 1.2" solimp="0.9 0.95 0.002 0.5 2"'
    names = (("foot0", "ground"), ("ground", "foot1"), ("foot2", "ground"), ("ground", "foot3"))
    pairs = "".join(
        f'<pair geom1="{first}" geom2="{second}" condim="4" {values}/>' for first, second in names
    )
    files = write_scene(tmp_path, PLANE + "/>", pairs)
    robot = load_pair(files)
    assert any(note.code == PAIRS for note in robot.notes)
    verify_stand_on_scene(robot)
    data = []
    for model in (mujoco.MjModel.from_xml_path(str(files.mjcf)), robot.mj_model):
        state = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, state, 0)
        state.qpos[:7] = (0, 0, robot.stand_height - 2e-3, 1, 0, 0, 0)
        state.qpos[7:] = robot.mj_model.key_qpos[0][7:]
        mujoco.mj_forward(model, state)
        assert state.ncon == 4
        data.append(state)
    for word in ("friction", "solref", "solimp", "dim"):
        first, second = (np.array(getattr(state.contact, word), dtype=float) for state in data)
        np.testing.assert_allclose(np.sort(first, axis=0), np.sort(second, axis=0), atol=1e-12)
    assert np.unique(np.array(data[0].contact.friction)[:, 0]).tolist() == [0.37]
    assert {contact.friction[0] for contact in robot.contacts.values()} == {0.37}
    # A robot slides on slopes steeper than arctan(0.37) = 0.354 rad.
    steep = pa.solve_stand(robot, pa.StandTask(height=0.28, ground=pa.Ground(slope=0.45)))
    with pytest.raises(pa.StaticsInfeasibleError, match=r"is 0\.370, but balance needs 0\.48"):
        pa.stance.stand_statics(robot, steep)
    flat = pa.solve_stand(robot, pa.StandTask(height=0.28, ground=pa.Ground(slope=0.34)))
    for used in pa.stance.stand_statics(robot, flat).friction_utilisation.values():
        assert used == pytest.approx(math.tan(0.34) / 0.37, rel=1e-6)


@pytest.mark.slow
def test_motion_on_converted_pairs_equals_that_of_the_unmodified_file(tmp_path: Path) -> None:
    """Reference: MuJoCo on the published file. The robot falls and random torques move it."""
    values = 'friction="0.6 0.6 0.01 0.001 0.001" solref="0.02 1" condim="3"'
    pairs = "".join(f'<pair geom1="ground" geom2="foot{leg}" {values}/>' for leg in range(4))
    files = write_scene(tmp_path, PLANE + "/>", pairs)
    robot = load_pair(files)
    models = (mujoco.MjModel.from_xml_path(str(files.mjcf)), copy.copy(robot.mj_model))
    for model in models:  # the robot has servos, and time steps that suit them
        model.opt.timestep, model.opt.integrator = 0.002, mujoco.mjtIntegrator.mjINT_EULER
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
    draw, touched = np.random.default_rng(3), 0
    data = [mujoco.MjData(model) for model in models]
    for state in data:
        state.qpos[2], state.qpos[3] = robot.stand_height + 0.02, 1.0
        state.qpos[7:] = robot.mj_model.key_qpos[0][7:]
    for _ in range(800):
        forces = 0.5 * draw.normal(size=robot.nv - 6)
        for model, state in zip(models, data, strict=True):
            state.qfrc_applied[6:] = forces
            mujoco.mj_step(model, state)
        touched += data[0].ncon
        np.testing.assert_allclose(data[0].qpos, data[1].qpos, atol=1e-9)
    assert touched > 400


@pytest.mark.slow
def test_smaller_friction_of_an_anisotropic_pair_is_used(tmp_path: Path) -> None:
    """The smaller friction holds in any direction."""
    pairs = "".join(
        f'<pair geom1="ground" geom2="foot{leg}" friction="{values}"/>'
        for leg, values in enumerate(("0.9 0.3 .02 .004 .003", "0.3 0.9 .02 .003 .004") * 2)
    )
    robot = load_pair(write_scene(tmp_path, PLANE + "/>", pairs))
    assert any(note.code == "friction-sideways-dropped" for note in robot.notes)
    assert {contact.friction[0] for contact in robot.contacts.values()} == {0.3}


def test_dropped_friction_softness_of_a_pair_gives_a_note(tmp_path: Path) -> None:
    pairs = '<pair geom1="ground" geom2="foot0" solreffriction="0.05 1"/>'
    notes = load_pair(write_scene(tmp_path, PLANE + "/>", pairs)).notes
    assert any(note.code == "friction-softness-dropped" for note in notes)


def test_fixed_base_does_not_collide_with_a_plane_of_another_body(tmp_path: Path) -> None:
    """A robot with a fixed base may intersect the ground of the file with a free base."""
    pair = write_scene(tmp_path, f'<body name="hall">{PLANE}/></body>')
    model = pa.load_robot(*pair, fixed_base=True).mj_model
    ground = model.geom("ground").id
    assert model.geom_contype[ground] == model.geom_conaffinity[ground] == 0
