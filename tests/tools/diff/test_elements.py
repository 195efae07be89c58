"""Changes of contacts, options and keyframes: each with its line, and its effect in bare MuJoCo."""

from __future__ import annotations

import shutil
from pathlib import Path

import mujoco
import pytest

import pupper_analysis as pa
from pupper_analysis.models import attributes
from pupper_analysis.models.stated import mjcf as elements
from pupper_analysis.tools.diff.elements import MIN_FELT_MOTION, _choose_ground_height
from tests.support.one_place_edits import FALLS, FELT, HARMLESS, Edit, copy_mjcf
from tests.support.random_edits import measure_difference, rollout
from tests.support.repository import ROOT


def write_edited(folder: Path, edit: Edit) -> Path:
    """Return v3's MJCF with one edit."""
    place = copy_mjcf(folder)
    edit.written(place)
    return place / "pupper_v3.xml"


def rest_height(file: Path) -> float:
    """Return the height of the base after 2 s of bare MuJoCo from the keyframe."""
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_step(model, data, nstep=round(2.0 / model.opt.timestep))
    return float(data.qpos[2])


@pytest.mark.slow
@pytest.mark.parametrize("name", [*FELT, *HARMLESS])
def test_edit_is_reported_at_its_line_with_its_effect_in_mujoco(tmp_path: Path, name: str) -> None:
    """Reference: change of the base height [m] after 2 s of bare MuJoCo."""
    edit = (FELT | HARMLESS)[name]
    before, after = ROOT / "mjcf/pupper_v3.xml", write_edited(tmp_path, edit)
    diff = pa.diff_models(before, after)
    assert not diff.same
    assert any(change.new_place.endswith(f"{edit.file}:{edit.line}") for change in diff.changes)
    messages = [consequence for change in diff.changes for consequence in change.consequences] + [
        *diff.combined
    ]
    codes = {message.code for message in messages}
    assert ("simulation-changes" in codes) is (name in FELT)
    assert (codes == {"simulation-unchanged"}) is (name in HARMLESS)
    # Reference of the common effect of all changes: the height in bare MuJoCo.
    combined = [
        message for message in diff.combined or messages if message.code == "simulation-changes"
    ]
    for effect_message in combined:
        stated = [
            effect_message.values["higher"],
            effect_message.values["lower"],
            effect_message.values["falls"],
        ]
        (height,) = [value.value for value in stated if value is not None] or [0.0]
        rise = rest_height(after) - rest_height(before)
        assert height == pytest.approx(abs(rise), rel=0.01, abs=MIN_FELT_MOTION)
        assert (effect_message.values["falls"] is not None) is (name in FALLS)


@pytest.mark.slow
def test_heavier_torso_lowers_the_base(tmp_path: Path) -> None:
    """The message stated a CoM that ends 1.96 mm higher, since a heavier torso raises the CoM.

    Reference: height of the base after 2 s of bare MuJoCo.
    """
    _, heavy = pa.pupper.write_variant("v3-heavy", tmp_path)
    light = ROOT / "mjcf/pupper_v3.xml"
    (message,) = [
        message
        for message in pa.diff_models(light, heavy).combined
        if message.code == "simulation-changes"
    ]
    lower = message.values["lower"].value
    assert lower == pytest.approx(rest_height(light) - rest_height(heavy), rel=1e-3)
    assert "the base ends 5.24 mm lower" in str(message)


def test_several_changes_have_a_common_effect(tmp_path: Path) -> None:
    """A friction of 0.01 acts only if the floor has the higher priority: each change alone has
    no effect."""
    after = write_edited(tmp_path, FELT["floor's friction"])
    diff = pa.diff_models(ROOT / "mjcf/pupper_v3.xml", after)
    assert {str(change.diagnostic.values["what"]) for change in diff.changes} == {
        "friction", "priority",
    }  # fmt: skip
    (slope,) = [message for message in diff.combined if message.code == "slides-from"]
    assert slope.values["two"].value == pytest.approx(0.01, rel=1e-3)
    assert slope.values["one"].value == pytest.approx(0.7854, rel=1e-3)


def test_models_are_not_equal_if_no_change_explains_the_simulation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever the table of elements lacks, both files are simulated."""
    table = [row for row in attributes.ELEMENT_ATTRIBUTES if row.word != "impratio"]
    monkeypatch.setattr(elements, "ELEMENT_ATTRIBUTES", table)
    diff = pa.diff_models(ROOT / "mjcf/pupper_v3.xml", write_edited(tmp_path, FELT["impratio"]))
    assert not diff.changes
    assert not diff.same
    assert [message.code for message in diff.combined] == ["simulation-changes"]


def test_shapes_of_a_urdf_that_touch_are_compared(tmp_path: Path) -> None:
    """Closed form: four feet with a radius of 90 mm in place of 19.95 mm."""
    text = (ROOT / "urdf/pupper_v3.urdf").read_text()
    folder = tmp_path / "urdf"
    shutil.copytree(ROOT / "urdf", folder)
    shutil.copytree(ROOT / "mjcf/meshes", tmp_path / "mjcf/meshes")
    assert 'radius="0.01995"' in text
    (folder / "pupper_v3.urdf").write_text(text.replace('radius="0.01995"', 'radius="0.09"'))
    diff = pa.diff_models(ROOT / "urdf/pupper_v3.urdf", folder / "pupper_v3.urdf")
    feet = [
        name
        for change in diff.changes
        for name in (change.element, *change.diagnostic.values["others"])
    ]
    assert len(feet) == 4
    moved = [message for change in diff.changes for message in change.consequences]
    assert all(
        message.values["distance"].value == pytest.approx(0.09 - 0.01995) for message in moved
    )


FLOOR = (
    '    <geom name="floor" type="plane" size="0 0 0.05" material="ground" condim="3" contype="1" '
    'conaffinity="1"/>\n'
)


def in_a_scene(file: Path) -> Path:
    """Return a scene that includes a robot, with a plane at z = 0."""
    scene = file.with_name("scene.xml")
    scene.write_text(
        "<mujoco><worldbody><geom type='plane' size='0 0 1' condim='3' friction='1 0.005 0.0001' "
        "solimp='0.9 0.95 0.001' contype='1' conaffinity='1'/></worldbody>"
        f"<include file='{file.name}'/></mujoco>"
    )
    return scene


@pytest.mark.slow
@pytest.mark.parametrize("name", ["conaffinity", "shape", "solref", "condim", "contacts off"])
def test_robots_without_ground_are_compared_on_a_plane(tmp_path: Path, name: str) -> None:
    """In the air, the contact parameters of the feet would have no effect."""
    folders = [copy_mjcf(tmp_path / version) for version in ("before", "after")]
    for folder in folders:
        scene = folder / "pupper_v3.xml"
        assert FLOOR in scene.read_text()
        scene.write_text(scene.read_text().replace(FLOOR, ""))
    FELT[name].written(folders[1])
    before, after = (folder / "pupper_v3.xml" for folder in folders)
    (change,) = pa.diff_models(before, after).changes
    (message,) = (
        consequence
        for consequence in change.consequences
        if consequence.code == "simulation-changes"
    )
    assert message.values["laid"]
    stated = [message.values[which] for which in ("higher", "lower", "falls")]
    (height,) = [value.value for value in stated if value is not None] or [0.0]
    rise = rest_height(in_a_scene(after)) - rest_height(in_a_scene(before))
    assert height == pytest.approx(abs(rise), rel=0.01, abs=1e-3)


FOOT = '<geom class="collision" type="sphere" size="0.01995"'
DRAWN = '<geom class="visual" type="sphere" material="rubber" size="0.01995"'


@pytest.mark.slow
def test_renumbered_geoms_without_name_are_no_change(tmp_path: Path) -> None:
    """Visual geoms before the foot are removed, which changes the numbers of geoms without a
    name."""
    file = copy_mjcf(tmp_path) / "pupper_v3_body.xml"
    text = file.read_text()
    lines = [line for line in text.splitlines(keepends=True) if DRAWN not in line]
    assert len(lines) == len(text.splitlines()) - 4
    file.write_text("".join(lines))
    sound, after = ROOT / "mjcf/pupper_v3.xml", file.with_name("pupper_v3.xml")
    assert pa.diff_models(sound, after).same
    assert pa.diff_models(after, sound).same
    place = "".join(lines).find(FOOT)
    file.write_text("".join(lines).replace(FOOT, FOOT.replace("0.01995", "0.025"), 1))
    (change,) = pa.diff_models(sound, after).changes
    assert change.new_place.endswith(f"{file.name}:{1 + ''.join(lines)[:place].count(chr(10))}")
    assert (change.old[:2], change.new[:2]) == (["sphere", 0.01995], ["sphere", 0.025])
    more = '<geom class="collision" type="box" size="0.01 0.01 0.01"/>\n'
    file.write_text("".join(lines).replace(FOOT, more + FOOT, 1))
    (change,) = pa.diff_models(sound, after).changes
    assert (change.old, change.new[:2]) == (None, ["box", 0.01])


def test_friction_of_a_foot_without_friction_cone_is_reported(tmp_path: Path) -> None:
    """A foot of condim 1 slides on a ground of condim 3 with a friction: the greater counts."""
    text = (
        "<mujoco><option gravity='4 0 -9'/><worldbody><geom type='plane' size='0 0 1'/>"
        "<body pos='0 0 0.1'><freejoint/><geom type='box' size='0.1 0.1 0.1' condim='1' "
        "friction='1'/></body></worldbody></mujoco>"
    )
    before, after = tmp_path / "before.xml", tmp_path / "after.xml"
    before.write_text(text.replace("type='plane'", "type='plane' friction='0.1'"))
    after.write_text(before.read_text().replace("friction='1'", "friction='0.2'"))
    (change,) = pa.diff_models(before, after).changes
    assert (change.old, change.new) == (1.0, 0.2)
    assert "simulation-changes" in {consequence.code for consequence in change.consequences}


@pytest.mark.parametrize(
    "flag", ['angle="degree"', 'settotalmass="9"', 'eulerseq="zyx"', 'boundmass="0.3"']
)
def test_a_flag_of_the_compiler_is_the_first_change(tmp_path: Path, flag: str) -> None:
    """The line of the flag is reported first; lines with a changed meaning have equal text."""
    old, new = tmp_path / "old.xml", tmp_path / "new.xml"
    text = """<mujoco>
      <compiler angle="radian"/>
      <worldbody>
        <body name="base" pos="0 0 1" euler="0.1 0.2 0.3"><freejoint/><geom size="0.1" mass="2"/>
          <body name="leg" euler="0.1 0.5 -0.3"><joint name="hip" axis="0 1 0" range="-1 1"/>
            <geom size="0.03" pos="0.1 0.02 -0.2" mass="0.2"/></body></body>
      </worldbody></mujoco>"""
    old.write_text(text)
    word = flag.partition("=")[0]
    stated = 'angle="radian"' if word == "angle" else 'angle="radian"/'
    changed = flag if word == "angle" else f'angle="radian" {flag}/'
    new.write_text(text.replace(stated, changed))
    first, *others = pa.diff_models(old, new).changes
    assert (first.kind, first.element) == ("compiler", word)
    assert first.new_place.endswith("new.xml:2")
    assert others


def test_fused_links_keep_their_position(tmp_path: Path) -> None:
    """Fusing changes contacts, which are softer on the heavier body; visual changes alone are
    none.
    """
    old, new = tmp_path / "old.xml", tmp_path / "new.xml"
    text = """<mujoco>
      <compiler angle="radian"/>
      <worldbody>
        <body name="base" pos="0 0 1"><freejoint/><geom size="0.1" mass="2"/>
          <body name="leg"><joint name="hip" axis="0 1 0"/><geom size="0.05" mass="0.4"/>
            <body name="foot" pos="0 0 -0.3"><geom name="ball" size="0.02" mass="0.1"/></body>
          </body></body>
      </worldbody></mujoco>"""
    old.write_text(text)
    fused = text.replace('"radian"', '"radian" fusestatic="true"')
    new.write_text(fused)
    assert measure_difference(rollout(old), rollout(new)) > 1e-4
    for pair in ((old, new), (new, old)):
        diff = pa.diff_models(*pair)
        (change,) = diff.changes
        assert (change.kind, change.element) == ("compiler", "fusestatic")
        assert [message.code for message in diff.combined] == ["simulation-changes"]
        assert (change.old_place or change.new_place).endswith("new.xml:2")
    new.write_text(fused.replace('size="0.02"', 'size="0.03"'))
    (shape,) = [change for change in pa.diff_models(old, new).changes if change.kind == "geom"]
    assert (shape.element, shape.old[1], shape.new[1]) == ("ball", 0.02, 0.03)
    for path, content in ((old, text), (new, fused)):
        path.write_text(content.replace('name="ball"', 'name="ball" contype="0" conaffinity="0"'))
    assert measure_difference(rollout(old), rollout(new)) < 1e-9
    assert pa.diff_models(old, new).same


def test_added_ground_is_at_the_lowest_vertex_of_a_robot_that_begins_deep() -> None:
    """Reference: vertices of a pyramid, whose bounding box has another centre than the geom."""
    corners = "0.1 0.05 0 -0.1 0.05 0 -0.1 -0.05 0 0.1 -0.05 0 0 0 0.3"
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><asset><mesh name="pyramid" vertex="{corners}"/></asset><worldbody>'
        '<body pos="0 0 -0.5"><freejoint/><geom type="mesh" mesh="pyramid"/></body>'
        "</worldbody></mujoco>"
    )
    assert _choose_ground_height(model) == pytest.approx(-0.5, abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name, edit in FELT.items() if edit.urdf])
def test_edit_that_a_urdf_can_state_is_a_difference_to_the_urdf(tmp_path: Path, name: str) -> None:
    """The comparison with the URDF reports the kind of the edit, at its line."""
    edit = FELT[name]
    comparison = pa.compare_models(ROOT / "urdf/pupper_v3.urdf", write_edited(tmp_path, edit))
    assert not comparison.agree
    assert {difference.kind for difference in comparison.differences} == {edit.urdf}
    line = f"{edit.file}:{edit.line}"
    assert any(str(difference.mjcf_place).endswith(line) for difference in comparison.differences)


@pytest.mark.parametrize("word", ["contype", "conaffinity"])
def test_visual_shape_that_begins_to_collide_moves_the_robot(tmp_path: Path, word: str) -> None:
    """By hand: a sphere that reaches 0.15 m deeper lifts the robot by as much. MuJoCo's bounding
    trees omit visual geoms.
    """
    before, after = tmp_path / "before.xml", tmp_path / "after.xml"
    before.write_text(
        "<mujoco><worldbody><geom type='plane' size='0 0 1'/><body pos='0 0 0.3'><freejoint/>"
        "<geom size='0.1'/><geom size='0.05' pos='0 0 -0.2' contype='0' conaffinity='0'/>"
        "</body></worldbody></mujoco>"
    )
    after.write_text(before.read_text().replace(f"{word}='0'", f"{word}='1'"))
    (change,) = pa.diff_models(before, after).changes
    (message,) = change.consequences
    assert message.code == "simulation-changes"
    assert message.values["higher"].value == pytest.approx(0.15, abs=0.01)


def test_flags_that_change_equally_are_separate_changes(tmp_path: Path) -> None:
    """Reference: the attributes of ``<flag>``. Of two disabled flags, only the first was listed."""
    old, new = tmp_path / "old.xml", tmp_path / "new.xml"
    text = """<mujoco>
      <worldbody>
        <body name="base"><freejoint/><geom size="0.1"/>
          <body name="leg" pos="0 0 1"><joint name="hip"/><geom size="0.1"/></body></body>
      </worldbody></mujoco>"""
    old.write_text(text)
    flags = '<mujoco><option><flag limit="disable" contact="disable"/></option>'
    new.write_text(text.replace("<mujoco>", flags))
    changes = pa.diff_models(old, new).changes
    assert {(change.kind, change.element) for change in changes} == {
        ("flag", "limit"),
        ("flag", "contact"),
    }
