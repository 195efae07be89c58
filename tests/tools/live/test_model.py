"""The live page without a browser: its numbers equal those of the Python functions."""

from __future__ import annotations

import json
import re
import socket
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.cli.shared import parse_place
from pupper_analysis.models.shapes import Pose, Shape
from pupper_analysis.present.scene import DrawnForce
from pupper_analysis.simulation.verdict import VerdictCode
from pupper_analysis.stance.sag.steady_state import SteadyState
from pupper_analysis.tools.live import render
from pupper_analysis.tools.live.command import read_stance
from pupper_analysis.tools.live.documents import (
    failure_document,
    live_stance_document,
    refusal_document,
)
from pupper_analysis.tools.live.model import (
    Answer,
    PageSolver,
    explain_unreachable,
    predict_sag,
    predict_stance_verdict,
    push_stand,
    simulate_stance,
)
from pupper_analysis.tools.live.render import Translator, render_panel
from pupper_analysis.tools.live.scene import (
    NO_LIMIT_COLOUR,
    OVERLOAD_COLOUR,
    UTILISATION_COLOURS,
    choose_utilisation_colour,
    make_body_meshes,
    make_force_arrows,
    to_css,
    triangulate_shape,
)
from pupper_analysis.tools.live.state import State, parse_length, write_stance_file
from tests.cli.test_stance_fields import parse_options
from tests.support.commands import answer as run_command
from tests.support.robots import arm, urdf_text
from tests.support.variants import load

RICH = State(
    height=125.5,
    roll=3.3,
    pitch=-2.0,
    yaw=4.1,
    place="inside",
    com_margin=5.0,
    foot_offsets={"FR": (10.0, -5.5)},
    joint_margin=2.0,
    ground_clearance=20.0,
    self_clearance=1.0,
    swing={"RL": 15.0},
    heights={"FL": 6.0, "RR": -3.5},
    slope=4.0,
    uphill=-30.0,
    payload=0.3,
    payload_at=(10.0, 0.0, 50.0),
    kp=20.0,
    kd=0.5,
)


ENGLISH = Translator("en")


def model_of(name: str = "v3") -> PageSolver:
    return PageSolver(load(name))


def test_answer_of_a_page_equals_the_python_functions() -> None:
    """Reference: stand, statics and steady state of the task in m and rad, with payload and kp."""
    found = model_of().solve_state(RICH)
    robot = pa.robot.with_payload(load("v3"), 0.3, (0.01, 0.0, 0.05))
    task = pa.StandTask(
        height=0.1255,
        roll=np.radians(3.3),
        pitch=np.radians(-2.0),
        yaw=np.radians(4.1),
        com="inside",
        com_margin=0.005,
        foot_offsets={"FR": (0.01, -0.0055)},
        joint_margin=np.radians(2.0),
        ground_clearance=0.02,
        self_clearance=0.001,
        swing={"RL": 0.015},
        ground=pa.Ground(
            slope=np.radians(4.0), uphill=np.radians(-30.0), heights={"FL": 0.006, "RR": -0.0035}
        ),
    )
    assert found.refusal is None
    assert found.task == task
    assert found.robot is not None
    assert found.stand is not None
    assert found.statics is not None
    stand = pa.stance.solve_stand_on_soft_ground(robot, task)
    statics = pa.stance.stand_statics(robot, stand)
    assert found.stand.qpos == pytest.approx(stand.qpos, abs=1e-12)
    assert found.statics.joint_torques == pytest.approx(statics.joint_torques, abs=1e-9)
    settled = predict_sag(found)
    same = pa.steady_state(robot, stand, kp=20.0)
    assert isinstance(settled, SteadyState)
    assert settled.height_loss == pytest.approx(same.height_loss, abs=1e-9)


def test_panel_shows_the_numbers_of_the_stance() -> None:
    """Reference: stand, statics and steady state of the answer, in mm, N m and %; the bars are as
    long as the utilisation."""
    found = model_of().solve_state(State(height=120.0))
    assert found.stand is not None
    assert found.statics is not None
    settled = predict_sag(found)
    assert isinstance(settled, SteadyState)
    verdict = predict_stance_verdict(found, closely=True)
    html = render_panel(live_stance_document(found, settled, verdict), ENGLISH)
    assert ">120.0</td><td>mm<" in html
    assert f">{1e3 * found.stand.com_margin:.1f}</td><td>mm<" in html
    assert f">{1e3 * settled.height_loss:.3f}</td><td>mm<" in html
    for torque in found.statics.joint_torques:
        assert f">{torque:+.4f}<" in html
    for share in found.statics.motor_utilisation:
        colour = to_css(choose_utilisation_colour(share))
        assert f"width:{3 * share:.2f}em;background:{colour}" in html
    assert "computing …" not in html


@pytest.mark.slow
@pytest.mark.parametrize(
    ("state", "name"), [(State(height=250.0), "height"), (State(roll=35.0), "roll")]
)
def test_panel_of_a_refusal_states_the_limit_in_mm_or_degrees(state: State, name: str) -> None:
    """Reference: limits [m, rad] of the error that explains the refusal."""
    found = model_of().solve_state(state)
    error = explain_unreachable(found)
    assert error is not None
    (limit,) = error.limits[name].values()
    unit, factor = ("mm", 1e3) if name == "height" else ("deg", np.degrees(1.0))
    html = render_panel(refusal_document(found, error, pending=False), ENGLISH)
    assert f"Possible with all else unchanged: {name} {factor * limit:.1f} {unit}." in html


@pytest.mark.parametrize("length", [0.1, 131.51, 120.0, 1e-7, -33.3, 1e20])
def test_length_in_millimetres_is_the_nearest_number_in_metres(length: float) -> None:
    """2.1 / 1000 is 0.0021000000000000003 in floating point, and the typed length is 0.0021."""
    assert parse_length(length) == pytest.approx(length / 1000, rel=1e-15)
    assert parse_length(2.1) == 0.0021 != 2.1 / 1000


def test_robot_of_the_last_payload_is_reused() -> None:
    model = model_of()
    loaded = model.load_robot(State(payload=0.3))
    assert model.load_robot(State(payload=0.3, roll=3.0)) is loaded
    assert model.load_robot(State(roll=3.0)) is load("v3")
    assert model.load_robot(State(payload=0.4)) is not loaded
    assert model.load_robot(State(payload=0.3)) is not loaded  # one loaded robot is kept


def test_offset_of_the_page_is_that_of_the_base_from_the_feet() -> None:
    """Closed form: base position less the mean of the contact points is (10, -5) mm."""
    found = model_of("original").solve_state(State(place="offset", offset=(10.0, -5.0)))
    assert found.stand is not None
    centre = np.mean(list(found.stand.contact_points.values()), axis=0)
    assert found.stand.qpos[:2] - centre[:2] == pytest.approx([0.01, -0.005], abs=1e-9)


@pytest.mark.slow
def test_simulations_of_a_page_equal_the_python_functions() -> None:
    """References: `verify_stand` and `simulate_push` with the same gains."""
    found = model_of("original").solve_state(State(pitch=3.0, kp=40.0, kd=0.6))
    robot = load("original")
    assert found.robot is not None
    held = pa.stance.solve_stand_on_soft_ground(robot, pa.StandTask(pitch=np.radians(3.0)))
    assert found.stand is not None
    assert found.stand.qpos == pytest.approx(held.qpos, abs=1e-12)
    report = simulate_stance(found).verification
    again = pa.verify_stand(robot, held, kp=40.0, kd=0.6)
    assert report.passed
    assert report.base_height == pytest.approx(again.base_height, abs=1e-9)
    assert report.kp == pytest.approx(40.0)
    trial = push_stand(found, 0.5, 1.0)
    same = pa.simulation.simulate_push(
        robot, held, 0.5, 1.0, duration=4.0, kp=40.0, kd=0.6, feedforward=False
    )
    assert trial.motion == pytest.approx(same.motion, abs=1e-6)


@pytest.mark.slow
def test_out_of_reach_is_explained_and_the_nearest_is_in_reach() -> None:
    """Reference: limits of the error that `solve_stand` raises; each limit and the nearest stand
    are solved.
    """
    model = model_of()
    found = model.solve_state(State(height=200.0, roll=30.0))
    assert found.unreachable
    assert found.stand is None
    error = explain_unreachable(found)
    assert error is not None
    with pytest.raises(pa.StanceUnreachableError) as same:
        pa.solve_stand(load("v3"), pa.StandTask(height=0.2, roll=np.radians(30.0)))
    assert error.limits == same.value.limits
    nearest = found.state.with_task(error.nearest.task)
    assert model.solve_state(nearest).refusal is None
    for fields in error.limits.values():
        task = replace(found.state.task(), **fields)
        assert model.solve_state(found.state.with_task(task)).refusal is None


@pytest.mark.parametrize(
    ("state", "kind"),
    [
        (State(swing={"tail": 20.0}), pa.UnknownNameError),
        (State(payload=-1.0), pa.ConfigurationError),
        (State(place="offset", offset=(90.0, 0.0), height=90.0), pa.PupperAnalysisError),
        (State(slope=44.0, pitch=0.0), pa.PupperAnalysisError),
        (State(com_margin=500.0), pa.ConfigurationError),
    ],
)
def test_refusal_is_part_of_the_answer(state: State, kind: type[Exception]) -> None:
    found = model_of().solve_state(state)
    assert isinstance(found.refusal, kind)
    assert found.statics is None
    assert render_panel(live_stance_document(found, None, None), ENGLISH)


def outcome(found: Answer) -> tuple[np.ndarray, np.ndarray]:  # type: ignore[type-arg]
    assert found.stand is not None
    assert found.statics is not None
    return found.stand.qpos, found.statics.joint_torques


@pytest.mark.slow
def test_saved_stance_file_gives_the_same_stand(tmp_path: Path) -> None:
    """Reference: qpos that the command `stand` computes from the saved file."""
    qpos, _ = outcome(model_of().solve_state(RICH))
    (tmp_path / "stance.toml").write_text(write_stance_file(RICH))
    words = ("stand", "v3", "--stance", "stance.toml", "--json", "stance.json")
    done = run_command(*words, folder=tmp_path)
    assert done.returncode in (0, 1), done.stderr
    saved = json.loads((tmp_path / "stance.json").read_text())
    assert saved["stand"]["qpos"] == pytest.approx(qpos, abs=1e-12)


@pytest.mark.parametrize(
    "values",
    [
        {"height": 120.0, "roll": 5.0, "swing": {"FL": 20.0}},
        {"place": "inside", "heights": {"RR": 4.0}, "slope": 3.0, "uphill": 90.0},
        {"place": "offset", "offset": (4.0, -3.0), "payload": 1.5, "payload_at": (0.0, 0.0, 80.0)},
        {"kp": 20.0, "kd": 0.5},
        {
            "posture": {"*elbow*": -0.5, "neck": 0.0},
            "payload": 1.0,
            "payload_at": ("hand", 0, 0, 5),
        },
    ],
)
def test_commands_read_the_saved_stance_file_as_the_page(
    tmp_path: Path, values: dict[str, Any]
) -> None:
    """Reference: task, payload [kg] and gains of the page's state."""
    state, file = State(**values), tmp_path / "page.toml"
    file.write_text(write_stance_file(state))
    found = parse_options("--stance", str(file))
    assert found.task() == state.task()
    assert found.payload == state.payload
    if state.payload:
        assert parse_place("payload-at", found.payload_at or "") == state.payload_point()
    gains = ((), ()) if state.kp is None else (("20.0",), ("0.5",))
    assert (found.kp, found.kd) == gains


def test_page_starts_with_a_stance_file(tmp_path: Path) -> None:
    """A file saved by the page is read again; a requirement without a slider is refused."""
    file = tmp_path / "stance.toml"
    file.write_text(write_stance_file(RICH))
    loaded = read_stance(file)
    assert loaded.task() == RICH.task()
    assert loaded.place == RICH.place
    file.write_text("payload = 0.5\npayload-at = '0,0,5cm'\nkp = 20\nheight = '12cm'\n")
    stated: dict[str, Any] = {"payload": 0.5, "payload_at": (0.0, 0.0, 50.0), "kp": 20.0}
    assert read_stance(file) == State(height=120.0, **stated)
    file.write_text("com = '1cm,0'\n")
    with pytest.raises(pa.ConfigurationError, match="com"):
        read_stance(file)


def test_markup_in_names_is_escaped() -> None:
    found = model_of().solve_state(State())
    assert found.robot is not None
    assert found.statics is not None
    evil = "<img src=x onerror=alert(1)>\u202e"
    names = (evil, *found.statics.joint_names[1:])
    worse = replace(
        found,
        robot=replace(found.robot, name=evil),
        statics=replace(found.statics, joint_names=names),
        refusal=pa.ConfigurationError(evil, evil),
    )
    for html in (
        render_panel(
            live_stance_document(worse, None, predict_stance_verdict(worse, closely=False)), ENGLISH
        ),
        render_panel(failure_document(worse.refusal or pa.ModelError("", "")), ENGLISH),
    ):
        assert "<img" not in html
        assert "\u202e" not in html
        assert "&lt;img" in html


def test_overloaded_motors_give_no_passing_verdict() -> None:
    """Reference: motor utilisation above 1.

    The panel shows no passing verdict, even if the forces balance.
    """
    found = model_of().solve_state(State(payload=30.0))
    assert found.statics is not None
    over = [n for n, share in zip(found.statics.joint_names, found.statics.motor_utilisation,
                                  strict=True) if share > 1]  # fmt: skip
    assert over
    judged = predict_stance_verdict(found, closely=False)
    assert judged is not None
    assert (judged.code, judged.passed) == (VerdictCode.OVERLOADED, False)
    assert judged.overloaded_motors == tuple(over)
    panel = render_panel(live_stance_document(found, None, judged), ENGLISH)
    assert 'class="good"' not in panel
    assert "OVERLOADED" in panel
    assert all(name in panel for name in over)
    usual = model_of().solve_state(State())
    sound = predict_stance_verdict(usual, closely=True)
    assert sound is not None
    assert sound.code is VerdictCode.IN_BALANCE
    assert 'class="good"' in render_panel(live_stance_document(usual, None, sound), ENGLISH)
    # Servos too soft: a deviation doubles in 2.5 s, which is found without a simulation.
    soft = model_of().solve_state(State(kp=0.3, kd=0.05))
    shaky = predict_stance_verdict(soft, closely=True)
    assert shaky is not None
    assert shaky.code is VerdictCode.UNSTABLE
    assert 'class="good"' not in render_panel(live_stance_document(soft, None, shaky), ENGLISH)


@pytest.mark.parametrize(
    ("state", "said"),
    [
        (State(self_clearance=-50.0), "self_clearance: -50 mm is less than 0 mm"),
        (State(slope=200.0), "slope: 200° is more than 89.9°"),
        (State(roll=-200.0), "roll: -200° is less than -180°"),
        (State(height=-3.0), "height: -3 mm is not above the ground"),
        (State(swing={"FL": -1.0}), "lift FL: -1 mm is not above the ground"),
    ],
)
def test_errors_are_in_the_units_of_the_page(state: State, said: str) -> None:
    found = model_of().solve_state(state)
    assert said in str(found.refusal)
    assert re.search(
        "[\u4e00-\u9fff]", Translator("zh").format_diagnostic(found.refusal.diagnostic)
    )


def test_colour_depends_on_motor_utilisation() -> None:
    assert choose_utilisation_colour(0.0) == UTILISATION_COLOURS[0][1]
    assert choose_utilisation_colour(1.0) == UTILISATION_COLOURS[-1][1]
    assert choose_utilisation_colour(1.01) == OVERLOAD_COLOUR
    assert choose_utilisation_colour(None) == NO_LIMIT_COLOUR
    assert choose_utilisation_colour(float("nan")) == NO_LIMIT_COLOUR
    assert choose_utilisation_colour(0.125) == tuple(
        round((a + b) / 2)
        for a, b in zip(UTILISATION_COLOURS[0][1], UTILISATION_COLOURS[1][1], strict=True)
    )


def volume(vertices: np.ndarray, faces: np.ndarray) -> float:  # type: ignore[type-arg]
    first, second, three = (vertices[faces[:, corner]] for corner in range(3))
    return float(np.einsum("ij,ij->i", first, np.cross(second, three)).sum() / 6)


@pytest.mark.parametrize(
    ("name", "size", "expected"),
    [
        ("box", (1.0, 2.0, 3.0), 48.0),
        ("sphere", (1.0,), 4 / 3 * np.pi),
        ("ellipsoid", (1.0, 2.0, 3.0), 8 * np.pi),
        ("cylinder", (1.0, 2.0), 4 * np.pi),
        ("capsule", (1.0, 2.0), 4 * np.pi + 4 / 3 * np.pi),
    ],
)
def test_shapes_have_their_volumes(name: str, size: tuple[float, ...], expected: float) -> None:
    """Closed forms of the volumes [m^3], within 6 % for the triangulation of round shapes."""
    pytest.importorskip("trimesh")
    mesh = triangulate_shape(Shape("", name, Pose(), size, collides=True))
    assert volume(mesh.vertices, mesh.faces) == pytest.approx(expected, rel=0.06)
    assert mesh.vertices.mean(axis=0) == pytest.approx(np.zeros(3), abs=1e-6)


def test_drawn_shapes_equal_those_of_mujoco() -> None:
    """References: bodies with visible geoms, and a vertex of MuJoCo's mesh in its body's frame."""
    pytest.importorskip("trimesh")
    model = load("v3").mj_model
    parts = make_body_meshes(model)
    assert {body for body, _ in parts} == {
        int(body) for body, group in zip(model.geom_bodyid, model.geom_group, strict=True)
        if body and group < 3
    }  # fmt: skip
    # A vertex of MuJoCo's own mesh, in its geom's frame, is one of the body's part's.
    geom = next(g for g in range(model.ngeom) if model.geom_dataid[g] >= 0)
    first = model.mesh_vertadr[model.geom_dataid[geom]]
    turn = np.zeros(9)
    __import__("mujoco").mju_quat2Mat(turn, model.geom_quat[geom])
    place = turn.reshape(3, 3) @ model.mesh_vert[first] + model.geom_pos[geom]
    near = [np.linalg.norm(mesh.vertices - place, axis=1).min() for (body, _), mesh in parts.items()
            if body == model.geom_bodyid[geom]]  # fmt: skip
    assert min(near) < 1e-6


def test_missing_viser_is_refused_with_the_install_command(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(pa.MissingPackageError, match=r"pip install viser.*\[live\]"):
        render.import_viser()
    done = run_command("live", "v3", "--no-browser", folder=Path.cwd())
    assert done.returncode == 2
    assert "pupper-analysis[live]" in done.stderr


def test_ports_and_hosts_that_cannot_be_served_are_refused() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(pa.ConfigurationError, match=f"cannot serve on 127.0.0.1:{port}"):
            render.find_free_port("127.0.0.1", port)
    assert render.find_free_port("127.0.0.1", port) == port
    assert 1024 <= render.find_free_port("127.0.0.1", None) <= 65535
    for host, wrong in (("203.0.113.7", None), ("no such host", None), ("127.0.0.1", 70000)):
        with pytest.raises(pa.ConfigurationError, match=r"--port|cannot serve"):
            render.find_free_port(host, wrong)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nobody"], "name 'nobody' is not valid; known: original,"),
        (["v3", "--stance", "nonsense.toml"], "nonsense.toml: there is no such file"),
        (["v3", "--stance", "tail.toml"], "v3: no foot 'tail'; there are: FR,"),
        (["v3", "--stance", "payload.toml"], "mass: -1.0 kg is not a finite number >= 0"),
        (["v3", "--port", "99999"], "--port: port 99999 is not between 0 and 65535"),
        (["v3", "--host", "203.0.113.7"], "--host, --port: cannot serve on 203.0.113.7"),
        (
            ["arm.urdf"],
            "arm.urdf has a fixed base and cannot stand; hold computes torques and payload",
        ),
    ],
)
def test_invalid_input_is_refused_in_one_line(
    arguments: list[str], message: str, tmp_path: Path
) -> None:
    pytest.importorskip("viser")
    (tmp_path / "arm.urdf").write_text(urdf_text(arm()))
    (tmp_path / "tail.toml").write_text("swing.tail = '2cm'\n")
    (tmp_path / "payload.toml").write_text("payload = -1\n")
    done = run_command("live", *arguments, "--no-browser", folder=tmp_path)
    assert done.returncode == 2
    assert done.stderr.startswith(f"error: {message}")
    lines = [line for line in done.stderr.splitlines() if not line.startswith("  next: ")]
    assert len(lines) == 1


def test_force_arrows_start_at_the_contact_along_the_force() -> None:
    """Reference: contact point [m] and force [N] of the input."""
    point, force = np.array([0.1, 0.2, 0.0]), np.array([1.0, -2.0, 8.0])
    ((begin, end),) = make_force_arrows(load("v3"), [DrawnForce("FL", point, force)])
    np.testing.assert_array_equal(begin, point)
    along = end - begin
    np.testing.assert_allclose(np.cross(along, force), 0.0, atol=1e-15)
    assert along @ force > 0
