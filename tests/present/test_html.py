"""HTML reports: one file with the numbers of the result in two languages; names contain no active
markup.
"""

from __future__ import annotations

import base64
import json
import math
import re
import subprocess
import sys
import tempfile
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest
from scipy.spatial import ConvexHull

import pupper_analysis as pa
from pupper_analysis.present import document, scene
from pupper_analysis.present.document import (
    Axis,
    Column,
    Document,
    LinePlot,
    Motion,
    Name,
    Report,
    SceneView,
    Series,
    StandScene,
    Table,
    Text,
    diagnostic_text,
    text,
)
from pupper_analysis.present.documents import registry, sources
from pupper_analysis.present.documents.loads import mass_text, torque_plot
from pupper_analysis.present.html import plots, write
from pupper_analysis.present.html.write import compute_extent, serialise_scene
from pupper_analysis.present.scene import collect_visible_shapes, describe_scene
from pupper_analysis.tools.stand.stance import study_stance
from tests.support.arm import arm
from tests.support.commands import answer
from tests.support.engines import evaluate_mujoco
from tests.support.html_page import Page, read_text
from tests.support.repository import ROOT
from tests.support.stubs import problem
from tests.support.variants import load, stand_of

EVIL = (
    "<script>alert(1)</script>",
    "--></script><img src=x onerror=alert(1)>",
    '" onload="x',
    "]]>",
)


@cache
def analysis() -> pa.analysis.Analysis:
    """Return the analysis of v3 with known torques [N m], which fails without feed-forward."""
    one = pa.analyze_variant(load("v3"))
    return replace(
        one,
        statics=replace(one.statics, joint_torques=-0.1 * np.arange(1, 13)),
        sagging=replace(one.sagging, failures=(problem("it sank <low>"),)),
    )


def drawn_of(what: StandScene) -> dict[str, Any]:
    found = serialise_scene(what)
    assert found is not None
    return found


@cache
def page_of(*results: object, robots: bool = True, language: str = "en") -> Page:
    return Page(write_page(list(results), robots=robots, language=language))


def write_page(results: object, *, robots: bool = True, language: str = "en") -> str:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "report.html"
        given = [load("v3")] if robots else []
        pa.report.write_report(results, path, robots=given, language=language)  # type: ignore[arg-type]
        return path.read_text(encoding="utf-8")


@cache
def comparison() -> pa.analysis.Comparison:
    """Return the comparison of a URDF with a heavier base and stronger knee than the MJCF."""
    with tempfile.TemporaryDirectory() as folder:
        urdf, mjcf = pa.pupper.write_variant(
            pa.pupper.VariantSpec(base="v3", leg_scale=1.1), folder
        )
        text = Path(urdf).read_text()
        mass = re.search(r'<mass value="(1\.5\d*)"', text)
        assert mass is not None
        Path(urdf).write_text(text.replace(mass[0], '<mass value="1.625"'))
        found = pa.compare_models(urdf, mjcf)
        page_of(found)  # while the files are there
        return found


# Structure of the page


@pytest.mark.slow
def test_page_is_well_formed_and_loads_no_resource() -> None:
    page = page_of(analysis())
    assert page.text.startswith("<!doctype html>")
    policy = next(a for tag, a in page.strict.tags if "http-equiv" in a)
    assert str(policy["content"]).startswith("default-src 'none'; script-src 'unsafe-inline';")
    for tag, attributes in page.strict.tags:
        assert tag not in ("link", "iframe", "object", "embed", "base", "form", "img"), tag
        assert "src" not in attributes, attributes
        assert str(attributes.get("href") or "#").startswith("#"), attributes
        assert not [name for name in attributes if name.startswith("on")], attributes
    style = page.root.findtext("head/style")
    assert not re.search(r"url\(|@import|http", style)


@pytest.mark.slow
def test_header_has_a_unit_if_the_column_has_numbers() -> None:
    """The unit of the column, or a column with the unit of each row."""
    count = 0
    for page in (page_of(analysis()), page_of(comparison()), page_of(stance())):
        for table in page.root.iter("table"):
            headers = table.findall(".//thead//th")
            by_row = any(read_text(header) == "unit" for header in headers)
            for index, header in enumerate(headers):
                assert header.get("scope") == "col"
                assert read_text(header)
                cells = [row[index] for row in table.findall("tbody/tr")]
                if any(cell.get("data-v") for cell in cells) and not by_row:
                    unit = header.find(".//span[@data-unit]")
                    assert unit is not None, read_text(header)
                    assert unit.get("data-unit"), read_text(header)
                    count += 1
            for row in table.findall("tbody/tr"):
                assert row[0].tag == "th"
                assert row[0].get("scope") == "row"
    assert count > 40


# Numbers and their sources


@cache
def stance() -> object:
    return study_stance(load("v3"), pa.StandTask(swing={"FL": 0.02}, com="inside"))


@pytest.mark.slow
def test_page_quotes_the_lines_of_both_files_side_by_side() -> None:
    page = page_of(comparison())
    first = page.root.find(".//div[@class='sides']")
    lines = [pre.text_content() for pre in first.iter("pre")]
    assert lines[0] == '<mass value="1.625"/>'
    assert lines[1].startswith("<inertial ")
    assert "1.625" in read_text(first.find("h3"))
    rows = page.tables()["All differences, the most important first"]
    assert (rows[0]["kind"], rows[0]["in the URDF"], rows[0]["unit"]) == ("mass", "1.625", "kg")
    assert "✗ DISAGREE" in page.shown()


def test_element_on_several_lines_is_quoted_completely(tmp_path: Path) -> None:
    (tmp_path / "part.xml").write_text('<a>\n  <body name="b"\n    pos="0 0 1"/>\n</a>\n')
    main = str(tmp_path / "main.xml")
    assert sources.quote_line("part.xml:3", main) == '<body name="b"\npos="0 0 1"/>'
    assert sources.quote_line("part.xml:1", main) == "<a>"
    for place in ("part.xml:9", "part.xml", "gone.xml:1", None, "part.xml:0"):
        assert sources.quote_line(place, main) == ""


def test_long_element_is_quoted_from_its_beginning(tmp_path: Path) -> None:
    """The line in the last of six rows names the attribute."""
    rows = ['<geom name="a"', *(f'  a{number}="1"' for number in range(4)), '  b="2"/>']
    (tmp_path / "part.xml").write_text("<x>\n" + "\n".join(rows))
    quoted = sources.quote_line("part.xml:7", str(tmp_path / "main.xml"))
    assert quoted == "\n".join(row.strip() for row in rows)


@cache
def audit() -> pa.analysis.Audit:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "bad.urdf"
        text = (ROOT / "urdf" / "pupper_v3.urdf").read_text()
        file.write_text(re.sub(r'<mass value="[\d.]+"', '<mass value="-1"', text, count=1))
        found = pa.audit_model(file)
        first = Page(write_page(found)).root.find(".//div[@class='sides']")
        assert first.find(".//pre").text_content() == '<mass value="-1"/>'
        return found


@pytest.mark.slow
def test_each_text_of_a_page_is_in_both_languages() -> None:
    """Each English element is followed by its Chinese one; labels have both languages, too."""
    count = 0
    for page in (page_of(analysis()), page_of(comparison()), page_of(audit()), page_of(stance())):
        texts = [e for e in page.root.iter() if "en" in (e.get("class") or "").split()]
        assert texts
        count += len(texts)
        for element in texts:
            other = element.getnext()
            assert other.get("class").split()[0] == "zh"
            assert other.get("lang") == "zh-Hans"
            assert read_text(other, "zh")
        for element in page.root.iter():
            if element.get("data-en") is not None:
                assert element.get("data-zh")
                assert element.get("aria-label") in (None, element.get("data-en"))
    assert count > 200


@pytest.mark.slow
def test_text_in_one_language_has_no_words_of_the_other() -> None:
    """Except names of the model and texts of results, which are removed here."""
    root = Page(write_page(analysis())).root.find("body")
    for element in [e for e in root.iter() if (e.get("class") or "") in ("name", "said")]:
        element.clear(keep_tail=True)
    button = root.find(".//button[@id='language']")
    assert button.text == "中文"
    button.text = ""
    assert not re.search(r"[\u4e00-\u9fff]", read_text(root, "en"))
    titles = [read_text(h, "zh") for tag in ("h1", "h3", "summary") for h in root.iter(tag)]
    assert sum(map(bool, titles)) > 5
    assert [title for title in titles if title and not re.search(r"[\u4e00-\u9fff]", title)] == []


@pytest.mark.slow
def test_failures_and_notes_are_in_the_summary() -> None:
    failed = replace(analysis(), verified=False, failures=(problem("knees: it fell"),))
    page = page_of(failed)
    summary = read_text(page.root.get_element_by_id("summary"))
    assert "v3 ✗ FAILED knees: it fell" in summary
    assert "Notes: 2" in summary
    assert "leg_*_1 rotates about y" in read_text(page.root.get_element_by_id("n1"))
    both = page_of(failed, replace(analysis(), name="other"))
    summary = read_text(both.root.get_element_by_id("summary"))
    assert summary.index("v3 ✗ FAILED") < summary.index("other ✓ VERIFIED")


def test_fields_of_a_result_without_a_page_are_written_out() -> None:
    """Reference: the fields of the stand and of its statics, with six digits."""
    stand = stand_of("v3")
    statics = pa.stance.stand_statics(load("v3"), stand)
    tables = page_of(stand, statics).tables()
    rows = {row["field"]: row for name in ("Stand", "GravityCompensation") for row in tables[name]}
    assert rows["stance_feet"]["value"] == "(FR, FL, RR, RL)"
    assert rows["task"]["value"].startswith("height 131.5 mm")
    place = ", ".join(f"{value:.6g}" for value in stand.foot_targets["FR"])
    assert rows["foot_targets"]["value"].startswith(f"FR: ({place}); FL: (")
    torques = ", ".join(f"{value:.6g}" for value in statics.joint_torques)
    assert rows["joint_torques"]["value"] == f"({torques})"
    assert rows["joint_torques"]["meaning and unit"] == (
        "Motor torques or forces, shape (nu,) (N m or N)."
    )
    assert rows["ground_clearance"]["value"].startswith("distance 0.0")
    assert registry.value_cell(np.zeros(25)) == Name("<array 25>")


# Names with markup


def evil_analysis() -> pa.analysis.Analysis:
    one = analysis()
    joints = tuple(
        replace(joint, name=EVIL[index % len(EVIL)]) for index, joint in enumerate(one.joints)
    )
    statics = replace(one.statics, joint_names=tuple(joint.name for joint in joints))
    return replace(
        one,
        name=EVIL[0],
        joints=joints,
        statics=statics,
        notes=tuple(map(problem, EVIL)),
        failures=tuple(map(problem, EVIL)),
    )


@pytest.mark.slow
def test_names_with_markup_are_escaped_in_the_page() -> None:
    """Joint and robot names with script, image and event attributes add no script, image or event
    attribute to the page.
    """
    tame, wild = page_of(analysis()), Page(write_page(evil_analysis(), robots=False))
    assert len(wild.strict.scripts) == 2  # the words of the scripts, and the page's own
    assert "img" not in {tag for tag, _ in wild.strict.tags}
    assert not [a for _, a in wild.strict.tags for name in a if name.startswith("on")]
    for name in EVIL:
        assert name in wild.shown()
    assert len(tame.strict.scripts) == 6


@dataclass
class Drawn:
    """A scene that is drawn already."""

    data: dict[str, Any]


@pytest.mark.slow
def test_names_with_a_script_end_are_escaped_in_a_view() -> None:
    robot = load("v3")
    drawn = drawn_of(StandScene(robot, stand_of("v3"), analysis().statics))
    for index, joint in enumerate(drawn["joints"]):
        joint["name"] = EVIL[index % len(EVIL)]
    drawn["bodies"][0]["name"] = EVIL[1]
    serialise_scene.register(Drawn, lambda one: one.data)
    view = SceneView(diagnostic_text(problem(EVIL[1])), Drawn(drawn))  # type: ignore[arg-type]
    document = Document(Name(""), Name(EVIL[0]), (view,))
    page = Page(write.render_page(Report(Text(EVIL[1], EVIL[1]), (document,))))
    data = next(json.loads(text) for text in page.strict.scripts if '"joints"' in text[:200000])
    assert [joint["name"] for joint in data["joints"][:2]] == list(EVIL[:2])
    assert len(page.strict.scripts) == 6
    assert not [a for _, a in page.strict.tags for name in a if name.startswith("on")]


def test_text_direction_characters_are_escaped_in_the_page() -> None:
    table = Table(Name("t"), (Column(Name("\u202etxt"), left=True),), ((Name("a\x1b[31m"),),))
    shown_text = Page(write_page(table)).shown()
    assert "\\u202etxt" in shown_text
    assert "a\\x1b[31m" in shown_text
    assert "\u202e" not in shown_text


# Three dimensions


def test_scene_bodies_equal_the_joint_poses_of_pinocchio() -> None:
    """Reference: Pinocchio with the URDF. The frames are of the MJCF, in 16-bit integers."""
    robot, stand = load("v3"), stand_of("v3")
    other = stand.qpos + np.concatenate([[0.01, 0.02, 0.03], np.zeros(4), np.full(12, 0.1)])
    moved = Motion(document.text("the-path"), np.array([0.5]), other[None])
    drawn = drawn_of(StandScene(robot, stand, None, [moved]))
    for qpos, motion in zip((stand.qpos, other), drawn["motions"], strict=True):
        numbers = np.frombuffer(base64.b64decode(motion["frames"]), "<i2") / 32767
        poses = numbers.reshape(-1, 7)
        assert len(poses) == len(drawn["bodies"])
        config = pa.Configuration(robot, qpos)
        for joint in drawn["joints"]:
            place = motion["reach"] * poses[joint["body"], :3]
            rotated = np.zeros(3)
            turn = poses[joint["body"], 3:]
            mujoco.mju_rotVecQuat(rotated, np.array(joint["anchor"]), turn / np.linalg.norm(turn))
            assert place + rotated == pytest.approx(config.joint_position(joint["name"]), abs=5e-5)
            mujoco.mju_rotVecQuat(rotated, np.array(joint["axis"]), turn / np.linalg.norm(turn))
            assert rotated == pytest.approx(config.joint_axis(joint["name"]), abs=2e-4)
    assert drawn["motions"][1]["time"] == [0.5]


def test_view_has_the_kind_of_each_joint() -> None:
    """The view prints mm and N for slides, rad and N m for hinges."""
    robot = arm()
    motion = Motion(document.text("the-path"), np.zeros(1), robot.home[None])
    drawn = serialise_scene(document.MotionScene(robot, [motion]))
    assert {joint["name"]: joint["slides"] for joint in drawn["joints"]} == {
        "elbow": False,
        "b_slide": True,
        "shoulder": False,
        "a_turn": False,
    }


def test_scene_positions_are_correct_on_a_slope_with_a_step_and_a_pit() -> None:
    """All lie on the ground or on its steps; the com's plumb line meets the polygon's plane."""
    robot = load("v3")
    ground = pa.Ground(slope=0.1, uphill=0.7, heights={"FR": 0.02, "RL": -0.01})
    stand = pa.solve_stand(robot, pa.StandTask(ground=ground))
    seen = describe_scene(robot, stand, None)
    assert not seen.contacts
    assert {foot: one.height for foot, one in seen.steps.items()} == dict(ground.heights)
    touched = np.array([stand.contact_points[foot] for foot in ("FL", "FR", "RL", "RR")])
    for corner in seen.polygon:
        assert np.linalg.norm(touched - corner, axis=1).min() < 1e-9
    assert seen.ground_centre @ ground.normal() == pytest.approx(0, abs=1e-12)
    assert seen.com == pytest.approx(pa.Configuration(robot, stand.qpos).center_of_mass())
    assert seen.com_projection[:2] == pytest.approx(seen.com[:2])
    around = touched[:, :2] - touched[:, :2].mean(axis=0)
    rise = np.linalg.pinv(around) @ (touched[:, 2] - touched[:, 2].mean())
    meets = touched[:, 2].mean() + rise @ (seen.com[:2] - touched[:, :2].mean(axis=0))
    assert seen.com_projection[2] == pytest.approx(meets, abs=1e-9)
    assert abs(meets) > 1e-4
    drawn = drawn_of(StandScene(robot, stand))
    assert [step["pit"] for step in drawn["steps"]] == [False, True]
    assert drawn["polygon"] == [pytest.approx(corner, abs=1e-5) for corner in seen.polygon]
    for joint in seen.joints:
        config = pa.Configuration(robot, stand.qpos)
        assert joint.world_anchor == pytest.approx(config.joint_position(joint.name))
        assert joint.torque is None


@pytest.mark.slow
def test_view_contains_forces_masses_com_and_support_polygon() -> None:
    """References: weight, mass, and statics of v3; the polygon is on the ground."""
    robot = load("v3")
    drawn = drawn_of(StandScene(robot, stand_of("v3"), analysis().statics))
    load_sum = sum(contact["force"][2] for contact in drawn["contacts"])
    assert load_sum == pytest.approx(9.81 * robot.total_mass, rel=1e-4)
    assert sum(body["mass"] for body in drawn["bodies"]) == pytest.approx(robot.total_mass)
    assert drawn["com"] == pytest.approx(analysis().statics.center_of_mass, abs=1e-5)
    without_statics = drawn_of(StandScene(robot, stand_of("v3"), None))
    data = evaluate_mujoco(robot, stand_of("v3").qpos)
    assert without_statics["com"] == pytest.approx(data.subtree_com[1], abs=2e-5)
    assert drawn["joints"][1]["torque"] == pytest.approx(-0.2)
    assert drawn["joints"][1]["motion"] == "roll"
    polygon = np.array(drawn["polygon"])
    points = np.array([contact["point"] for contact in drawn["contacts"]])
    assert polygon[:, :2].min(axis=0) == pytest.approx(points[:, :2].min(axis=0), abs=1e-5)
    assert not polygon[:, 2].any()
    assert "mesh" in {geom["shape"] for geom in drawn["geoms"]}  # visual shapes


@pytest.mark.slow
def test_page_of_six_variants_is_smaller_than_three_megabytes(tmp_path: Path) -> None:
    results = [replace(analysis(), name=name, stand=stand_of(name)) for name in pa.VARIANTS]
    path = tmp_path / "report.html"
    pa.report.write_report(results, path, robots=[load(name) for name in pa.VARIANTS])
    assert path.stat().st_size < 3e6
    assert path.read_text(encoding="utf-8").count('class="canvas"') == 6


@pytest.mark.slow
def test_template_engine_is_imported_only_for_a_report() -> None:
    """Reference: the modules of a new process."""
    code = (
        "import sys, pupper_analysis.cli, pupper_analysis.present.html.write, "
        "pupper_analysis.tools.analyze.document; print('jinja2' in sys.modules)"
    )
    command = [sys.executable, "-W", "ignore", "-c", code]
    run = subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT)
    assert run.stdout.strip() == "False"


def test_coarse_sphere_is_a_sphere() -> None:
    """Closed form: volume 4/3 pi, positive for faces that are turned outwards, within 5 %."""
    around, down = np.meshgrid(np.arange(64), np.arange(1, 40), indexing="ij")
    azimuth, polar = 2 * np.pi * around.ravel() / 64, np.pi * down.ravel() / 40
    places = np.column_stack(
        [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)]
    )
    triangles = ConvexHull(places).simplices
    a, b, c = (places[triangles[:, index]] for index in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), a) < 0
    triangles = np.where(inward[:, None], triangles[:, ::-1], triangles).astype(np.int64)
    coarse = scene.coarsen_mesh(scene.Mesh(places, triangles), 16)
    assert len(coarse.faces) < 0.6 * len(triangles)
    assert np.abs(np.linalg.norm(coarse.vertices, axis=1) - 1).max() < 0.03
    assert volume(coarse.vertices, coarse.faces) == pytest.approx(4 / 3 * np.pi, rel=0.05)


def test_extent_of_a_view_is_the_box_of_shapes_and_not_of_their_bounding_spheres() -> None:
    """Reference: corners by hand: a plate of 600 x 40 x 20 mm, turned by 90 deg about z.

    With bounding spheres, the box was 600 mm high, and the robot small in the view.
    """
    spec = mujoco.MjSpec.from_string(
        '<mujoco><worldbody><body name="a" pos="0 0 1" euler="0 0 90">'
        '<geom type="box" size=".3 .02 .01" pos=".1 0 0" mass="1"/></body></worldbody></mujoco>'
    )
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    low, high = compute_extent(model, data)
    np.testing.assert_allclose(low, (-0.02, -0.2, 0.99), atol=1e-9)
    np.testing.assert_allclose(high, (0.02, 0.4, 1.01), atol=1e-9)


def test_coarse_mesh_without_extent_is_a_point() -> None:
    """Three equal vertices."""
    coarse = scene.coarsen_mesh(scene.Mesh(np.full((3, 3), 0.5), np.array([[0, 1, 2]])), 16)
    assert coarse.vertices.tolist() == [[0.5, 0.5, 0.5]]
    assert coarse.faces.shape == (0, 3)


def decode_mesh(mesh: dict[str, object]) -> tuple[np.ndarray, np.ndarray]:  # type: ignore[type-arg]
    steps = np.frombuffer(base64.b64decode(str(mesh["vertices"])), "<u2").reshape(-1, 3)
    kind = "<u4" if mesh["wide"] else "<u2"
    faces = np.frombuffer(base64.b64decode(str(mesh["faces"])), kind).reshape(-1, 3)
    return np.array(mesh["low"]) + np.array(mesh["span"]) * steps / 65535, faces


def volume(vertices: np.ndarray, faces: np.ndarray) -> float:  # type: ignore[type-arg]
    a, b, c = (vertices[faces[:, index]] for index in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)


def test_robots_share_equal_meshes_in_one_page() -> None:
    """v3 and v3-heavy have equal meshes; each geom refers to the packed mesh of its file."""
    models = load("v3").mj_model, load("v3-heavy").mj_model
    (geoms, meshes), (_, others) = map(write.serialise_geoms, models)
    shapes, whole = collect_visible_shapes(models[0], write.MAX_FACES)
    assert len(meshes) > 3
    assert meshes.keys() == others.keys()
    for shape, geom in zip(shapes, geoms, strict=True):
        if shape.mesh is not None:
            assert meshes[geom["mesh"]] == write._pack_mesh(whole[shape.mesh])


def test_shapes_of_a_page_have_the_poses_of_mujoco_geoms() -> None:
    """The body index counts bodies without the world; the reference is ``geom_xpos``."""
    model = load("v3").mj_model
    data = mujoco.MjData(model)
    data.qpos[:7] = 0.1, 0.2, 0.3, 0.5, 0.5, 0.5, 0.5
    mujoco.mj_kinematics(model, data)
    geoms, _ = write.serialise_geoms(model)
    assert len(geoms) > 10
    for geom in geoms:
        body = 1 + geom["body"]
        place = data.xpos[body] + data.xmat[body].reshape(3, 3) @ np.array(geom["pos"])
        of_body = data.geom_xpos[model.geom_bodyid == body]
        assert np.abs(of_body - place).max(axis=1).min() < 1e-5


def test_coarsened_meshes_keep_their_size() -> None:
    """Reference: volume of the mesh in the file."""
    model = load("v3").mj_model
    shapes, whole_scene = collect_visible_shapes(model, int(model.mesh_facenum.sum()))
    coarse = collect_visible_shapes(
        model, int(0.3 * sum(len(mesh.faces) for mesh in whole_scene.values()))
    )[1]
    assert {shape.mesh for shape in shapes} - {None} == set(whole_scene)
    for mesh in whole_scene:
        first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        start, faces = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
        whole = volume(
            np.asarray(model.mesh_vert[first : first + count], float),
            model.mesh_face[start : start + faces],
        )
        vertices, triangles = decode_mesh(write._pack_mesh(whole_scene[mesh]))
        assert len(triangles) == faces
        assert volume(vertices, triangles) == pytest.approx(whole, rel=2e-3)
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        vertices, triangles = decode_mesh(write._pack_mesh(coarse[mesh]))
        assert 0.1 * faces < len(triangles) <= 0.3 * faces
        cell = float((high - low).max()) / 10
        assert vertices.min(axis=0) == pytest.approx(low, abs=cell)
        assert vertices.max(axis=0) == pytest.approx(high, abs=cell)


@pytest.mark.slow
def test_view_is_omitted_without_three_js(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(write, "_VIEWER_PACKAGE", "no_such_package")
    assert write.load_viewer_library() is None
    page = Page(write_page(analysis()))
    assert "three.js was not found" in page.shown()
    assert "application/json" in page.text
    assert len(page.text) < 400_000


@pytest.mark.slow
def test_page_contains_the_licences_of_three_js() -> None:
    found = write.load_viewer_library()
    assert found is not None
    assert not re.search(r"(?i)</script|<!--", found.script)
    for name in ("MeshCat", "three ", "Permission is hereby granted"):
        assert name in found.licence
    assert "Permission is hereby granted" in page_of(analysis()).shown()


# Drawings


def test_line_plot_points_are_at_their_values() -> None:
    """Points are at the ends of the axes, at the height of the grid lines of their values; NaN is
    left out.
    """
    axis = Axis(Name("x"), "s", ".1f"), Axis(Name("y"), "mm", ".1f")
    drawing = plots.draw_svg(
        LinePlot(Name("t"), *axis, [Series(Name("a"), [0, 5, 10], [1.0, np.nan, 3.0])])
    )
    line = next(mark for mark in drawing.marks if mark["tag"] == "polyline")
    assert line["labels"] == ["0.0 s, 1.0 mm", "10.0 s, 3.0 mm"]
    (x0, y0), (x1, y1) = line["points"]
    assert (x0, x1) == (plots.LEFT_MARGIN, plots.PLOT_WIDTH - plots.RIGHT_MARGIN)
    assert y0 > y1  # more is further up
    grid = {
        mark["words"].text: mark["y"]
        for mark in drawing.marks
        if mark["tag"] == "text" and mark["anchor"] == "end"
    }
    assert grid["1"] - 4 == pytest.approx(y0, abs=0.1)
    assert grid["3"] - 4 == pytest.approx(y1, abs=0.1)


@pytest.mark.parametrize("count", [5, 1000])
def test_line_plot_marks_its_point_beside_omitted_points(count: int) -> None:
    """Reference: the circle at the place of the label; omitted points had moved the marker."""
    axis = Axis(Name("x"), "s", ".0f"), Axis(Name("y"), "mm", ".0f")
    y = np.arange(count, dtype=float)
    y[1] = np.nan
    series = Series(Name("a"), np.arange(count), y, points=True, marked_index=3)
    marks = plots.draw_svg(LinePlot(Name("t"), *axis, [series])).marks
    line = next(mark for mark in marks if mark["tag"] == "polyline")
    place = line["points"][line["labels"].index("3 s, 3 mm")]
    large = [mark for mark in marks if mark.get("r") == plots.MARKED_DOT_RADIUS]
    assert [[mark["cx"], mark["cy"]] for mark in large] == [place]
    assert len(line["points"]) <= plots.MAX_LINE_POINTS + 1


def test_logarithmic_axis_has_equal_distances_for_equal_ratios() -> None:
    axes = (Axis(Name("x"), "1", "g", logarithmic=True), Axis(Name("y"), "1", "g", low=0.0))
    curve = Series(Name("a"), [1.0, 10.0, 100.0], [2.0, 3.0, 4.0])
    marks = plots.draw_svg(LinePlot(Name("t"), *axes, [curve])).marks
    (line,) = (mark for mark in marks if mark["tag"] == "polyline")
    (x0, _), (x1, _), (x2, _) = line["points"]
    assert x1 - x0 == pytest.approx(x2 - x1, abs=0.1)
    ticks = {
        mark["words"].text: mark for mark in marks if mark["tag"] == "text" and not mark["unit"]
    }
    assert {"1", "2", "5", "10", "20", "50", "100"} <= ticks.keys()
    bottom = plots.PLOT_HEIGHT - plots.BOTTOM_MARGIN
    assert ticks["0"]["y"] - 4 == pytest.approx(bottom)  # the axis begins at zero


@pytest.mark.parametrize("height", [0.5, 2.0, 30.0])
def test_square_is_a_square_with_equal_scales(height: float) -> None:
    """A further point makes the range of the vertical axis smaller or larger."""
    axis = Axis(Name("f"), "N", "g")
    square = Series(Name("a"), [0.0, 1.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 1.0, 0.0])
    point = Series(Name("b"), [0.0], [height], points=True)
    drawn = plots.draw_svg(LinePlot(Name("t"), axis, axis, [square, point], equal_scales=True))
    line = next(mark for mark in drawn.marks if mark["tag"] == "polyline")
    assert np.ptp(line["points"], axis=0)[0] == pytest.approx(
        np.ptp(line["points"], axis=0)[1], abs=0.11
    )
    inside = np.array(line["points"])
    assert (inside > 0).all()
    assert (inside < [drawn.width, drawn.height]).all()


def test_legend_of_a_page_has_the_symbols_of_the_plot() -> None:
    """Points of two series were circles, and their keys lines."""
    axis = Axis(Name("x"), "1", "g")
    series = [
        Series(Name("line"), [0.0, 1.0], [0.0, 1.0]),
        Series(Name("square"), [0.2], [0.5], points=True),
        Series(Name("triangle"), [0.8], [0.5], points=True),
        Series(Name("region"), [0.0, 1.0, 1.0], [0.0, 0.0, 1.0], shaded=True),
    ]
    shown = Document(text("report"), Name("v3"), (LinePlot(Name("t"), axis, axis, series),))
    page = Page(write.render_page(Report(text("report"), (shown,))))
    keys = {
        read_text(key).strip(): [
            (descendant.tag, descendant.get("class")) for descendant in key.iterdescendants()
        ][1]
        for key in page.root.xpath("//span[@class='key']")
    }
    assert keys == {
        "line": ("line", "series s0"),
        "square": ("polygon", "dot s1"),
        "triangle": ("polygon", "dot s2"),
        "region": ("rect", "area"),
    }
    (drawing,) = page.root.xpath("//figure[@class='plot']/svg")
    corners = {
        polygon.get("class"): len(polygon.get("points").split())
        for polygon in drawing.iter("polygon")
    }
    assert corners == {"dot s1": 4, "dot s2": 3, "area": 3}
    order = [polygon.get("class") for polygon in drawing.iter("polygon", "polyline")]
    assert order.index("area") < order.index("series s0")  # an area covers no line


# Files and commands


def test_write_report_raises_for_invalid_arguments(tmp_path: Path) -> None:
    with pytest.raises(pa.ConfigurationError, match="no result to report"):
        pa.report.write_report([], tmp_path / "r.html")
    with pytest.raises(pa.ConfigurationError, match="'en' nor 'zh'"):
        pa.report.write_report(audit(), tmp_path / "r.html", language="fr")
    with pytest.raises(pa.OutputError):
        pa.report.write_report(audit(), tmp_path)
    assert list(tmp_path.iterdir()) == []


def make_statics(torques: list[float], units: tuple[str, ...]) -> Any:
    """Return the fields of an equilibrium that a torque plot reads."""
    names = tuple(f"joint{index}" for index in range(len(torques)))
    return SimpleNamespace(joint_names=names, joint_torques=np.array(torques), torque_units=units)


def test_torque_plot_shows_the_utilisation_of_each_motor() -> None:
    """Torques of hinges and slides shared an axis, on which small motors were invisible."""
    statics = make_statics([-20.0, 0.5, 30.0], ("N m", "N m", "N"))
    plot = torque_plot(statics, [-21.0, 0.4, 30.0], [40.0, 1.0, 100.0], worst=[0.6, 1.5, 0.3])
    assert plot.axis.unit == "%"
    assert [bar.value for bar in plot.bars] == pytest.approx([50.0, 50.0, 30.0])
    assert [bar.marker for bar in plot.bars] == pytest.approx([52.5, 40.0, 30.0])
    assert [bar.point for bar in plot.bars] == pytest.approx([60.0, 150.0, 30.0])
    labels = [document.get_english(bar.label) for bar in plot.bars if bar.label]
    assert labels == ["50.0 % of 40 N m", "50.0 % of 1 N m", "30.0 % of 100 N"]
    drawn = plots.draw_svg(plot)
    dots = [mark["cx"] for mark in drawn.marks if mark["tag"] == "dot"]
    limits = {mark["x1"] for mark in drawn.marks if mark["class"] == "limit"}
    assert len(limits) == 1
    assert dots[0] < limits.pop() < dots[1] < drawn.width  # the largest point is in the plot
    assert [kind for _, kind in drawn.legend] == ["bar", "other", "limit", "dot s1"]


@pytest.mark.parametrize(
    ("limit", "label"), [(math.inf, "2 N m, limit unknown"), (0.0, "2 N m, limit 0")]
)
def test_motor_without_a_positive_limit_has_no_bar(limit: float, label: str) -> None:
    """A bar of zero length would look like a motor without load."""
    plot = torque_plot(make_statics([-2.0, 1.0], ("N m", "N m")), [-2.0, 1.0], [limit, 2.0])
    drawn = plots.draw_svg(plot)
    assert sum(mark["class"] == "bar" for mark in drawn.marks) == 1
    assert label in [
        document.get_english(mark["words"]) for mark in drawn.marks if mark["tag"] == "text"
    ]


def test_torque_plot_without_limits_shows_torques() -> None:
    plot = torque_plot(make_statics([-2.0, 1.0], ("N m", "N m")), [-2.0, 1.0], [math.inf] * 2)
    assert (plot.axis.unit, [bar.value for bar in plot.bars]) == ("N m", [-2.0, 1.0])
    assert len(plots.draw_svg(plot).legend) == 2


def test_small_utilisations_fill_the_plot() -> None:
    """With the limit at 100 %, bars of 1 to 6 % could not be compared."""
    plot = torque_plot(make_statics([0.1, 0.2], ("N m",) * 2), [0.1, 0.2], [10.0, 10.0])
    drawn = plots.draw_svg(plot)
    widths = [mark["width"] for mark in drawn.marks if mark["class"] == "bar"]
    assert widths[1] == pytest.approx(2 * widths[0])
    assert widths[1] > plots.PLOT_WIDTH / 3
    assert all(mark["class"] != "limit" for mark in drawn.marks)
    assert [kind for _, kind in drawn.legend] == ["bar", "other"]


def test_bar_plot_is_one_sided_if_negative_values_are_rounding() -> None:
    """A torque of -1e-17 N m, which another robot has as 0."""

    def limits(least: float) -> int:
        bars = [
            document.PlotBar(Name("hip"), least, limit=18.0),
            document.PlotBar(Name("knee"), 0.4),
        ]
        axis, names = Axis(Name("torque"), "N m", "+.3f"), (Name("held"), None, None)
        drawn = plots.draw_svg(document.BarPlot(Name("torques"), axis, bars, names))
        return sum(mark.get("class") == "limit" for mark in drawn.marks)

    assert (limits(0.0), limits(-1e-17), limits(-0.01)) == (1, 1, 2)


def test_report_is_written_to_standard_output() -> None:
    found = answer("audit", str(ROOT / "urdf" / "pupper_v3.urdf"), "--report", "-")
    assert Page(found.stdout).root.find(".//h1") is not None
    assert "OK" in found.stderr


def test_names_of_half_a_letter_and_of_a_template_are_shown_as_text() -> None:
    """No encoding has the letter U+D800; the template engine would evaluate ``{{ 7 * 7 }}``."""
    notes = problem("half \ud800 letter"), problem("{{ 7 * 7 }}")
    shown = Page(write_page(replace(audit(), notes=notes, file="bad\udcff.urdf"))).shown()
    assert "half \\ud800 letter" in shown
    assert "{{ 7 * 7 }}" in shown


def test_audit_with_warnings_is_not_marked_as_passed() -> None:
    counts = {"error": 0, "warning": 2, "note": 0}
    text = Page(write_page(replace(audit(), passed=True, counts=counts))).shown()
    assert "! WARNINGS" in text
    assert "✓" not in text


@pytest.mark.parametrize(
    ("passed", "warned", "expected"),
    [
        (True, False, "verdict good"),
        (False, False, "verdict bad"),
        (True, True, "verdict warn"),
        (None, False, "verdict "),
    ],
)
def test_colour_of_a_verdict_is_the_mark_of_the_document(
    passed: bool | None, warned: bool, expected: str
) -> None:
    """A verdict that is neither good nor bad has no colour and no sign."""
    shown = Document(
        text("report"), Name("v3"), (), passed=passed, warned=warned, verdict=Name("MEASURED")
    )
    badges = Page(write.render_page(Report(text("report"), (shown,)))).root.xpath(
        "//span[starts-with(@class, 'verdict')]"
    )
    assert {badge.get("class") for badge in badges} == {expected}
    signs = {"✓" in read_text(badge) or "✗" in read_text(badge) for badge in badges}
    assert signs == {passed is not None and not warned}


@pytest.mark.parametrize(
    ("value", "form", "expected"),
    [
        (-1e-9, "+.3f", "+0.000"),
        (None, ".1f", "-"),
        (0.1234, ".1%", "12.3 %"),
        (-1e-9, ".1%", "0.0 %"),
        (float("inf"), "g", "inf"),
    ],
)
def test_number_is_written_in_its_form(value: float | None, form: str, expected: str) -> None:
    assert document.number_cell(value, form).text == expected


@pytest.mark.parametrize("count", [1, 2, 3])
def test_polygon_of_points_in_a_line_is_the_line(count: int) -> None:
    points = np.array([[0.25, 0.5, 0.0], [0.5, 0.75, 0.01], [0.75, 1.0, 0.02]])[:count]
    corners = scene.compute_polygon_corners(points)
    assert corners[0] == pytest.approx(points[0])
    assert corners[-1] == pytest.approx(points[-1])
    assert len(corners) == min(count, 2)


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [
        (0, 10, [0, 2, 4, 6, 8, 10]),
        (-3, 3, [-2, 0, 2]),
        (0.11, 0.13, [0.11, 0.115, 0.12, 0.125, 0.13]),
    ],
)
def test_ticks_are_round_numbers(low: float, high: float, expected: list[float]) -> None:
    assert plots.round_ticks(low, high) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("form", "values", "expected"),
    [
        (".2f", [1.98, -0.4], ".2f"),
        (".2f", [0.1], ".2f"),
        (".2f", [0.00198], ".4f"),
        ("+.4f", [0.0, -0.00042], "+.5f"),
        ("+.4f", [0.0, math.nan, math.inf], "+.4f"),
        (".2f", [1e-30], ".9f"),
    ],
)
def test_small_torques_have_two_digits(form: str, values: list[float], expected: str) -> None:
    """By hand: 0.00198 N m is printed as 0.0020, not as 0.00."""
    assert document.widen_format(form, values) == expected


@pytest.mark.parametrize(
    ("mass", "expected"),
    [(0.0, "0.00 kg"), (0.00849, "0.0084 kg"), (0.0999, "0.099 kg"), (0.1, "0.10 kg")],
)
def test_small_payloads_have_two_digits_and_are_rounded_down(mass: float, expected: str) -> None:
    assert mass_text(mass) == document.Name(expected)
