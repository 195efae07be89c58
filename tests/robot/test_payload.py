"""Payloads: force, changed stand and contact softness, compared with finite differences, closed
forms and MuJoCo.
"""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.robot.compliance import GroundLaw
from pupper_analysis.robot.tool import measure_size, with_payload
from pupper_analysis.stance.sag.equilibrium import integrate_step
from pupper_analysis.stance.soft_ground import solve_loaded_stand
from tests.support.arm import URDF, arm, load_arm
from tests.support.engines import evaluate_mujoco
from tests.support.legged import quadruped
from tests.support.states import random_state
from tests.support.variants import load

POINT = (0.05, -0.02, 0.08)


@pytest.mark.parametrize("name", ["original", "v3"])
def test_payload_force_is_the_gradient_of_its_potential_energy(name: str) -> None:
    """m g dz/dq, by finite differences of where the point is on a tilted base."""
    robot, mass = load(name), 3.0
    qpos, _ = random_state(robot, 2)

    def energy(at: np.ndarray) -> float:
        config = pa.Configuration(robot, at)
        place = at[:3] + config.base_rotation() @ POINT
        return mass * 9.81 * float(place[2])

    steps = 1e-6 * np.eye(robot.nv)
    slope = [
        (energy(integrate_step(qpos, s)) - energy(integrate_step(qpos, -s))) / 2e-6 for s in steps
    ]
    more = pa.Configuration(with_payload(robot, mass, POINT), qpos).gravity()
    less = pa.Configuration(robot, qpos).gravity()
    np.testing.assert_allclose(more - less, slope, atol=1e-7)


@pytest.mark.parametrize("name", ["original", "v3"])
def test_size_of_a_robot_bounds_its_frames(name: str) -> None:
    """Reference: distances of Pinocchio's frames from the base."""
    robot = load(name)
    config = pa.Configuration(robot, robot.neutral())
    base = config.frame_position(robot.base)
    distances = [
        np.linalg.norm(config.frame_position(link) - base) for link in robot.structure.links
    ]
    assert max(distances) <= measure_size(robot) < 3 * max(distances)


@pytest.mark.parametrize("frame", [(), ("leg_front_r_3",)])
def test_point_in_millimetres_is_refused(frame: tuple[str, ...]) -> None:
    """80 m is farther than ten sizes of a robot of 0.24 m; 80 mm is accepted."""
    robot = load("v3")
    for call in (
        lambda point: pa.payload_limit(robot, point=point),
        lambda point: with_payload(robot, 1.0, point),
    ):
        with pytest.raises(pa.ConfigurationError, match=r"point: 80 m from .* lengths are in m"):
            call((*frame, 0, 0, 80))
    assert with_payload(robot, 1.0, (*frame, 0, 0, 0.08)).total_mass > robot.total_mass


def test_payload_in_grams_adds_a_note() -> None:
    """500 kg is more than 20 times the mass of v3; 3 kg is not."""
    robot = load("v3")
    assert with_payload(robot, 3.0).notes == robot.notes
    (note,) = set(with_payload(robot, 500.0).notes) - set(robot.notes)
    assert note.code == "payload-heavy"
    assert "masses are in kg" in str(note)


@pytest.mark.slow
def test_a_loaded_stand_moves_the_base_and_sinks_the_feet() -> None:
    """The CoM with payload is above the centre of the contacts, the contact forces sum to (M + 2
    kg) g [N], and the front feet are deeper if the base keeps its place. MuJoCo holds the stand.
    """
    robot, point, task = load("v3"), (0.08, 0.0, 0.05), pa.StandTask(pitch=0.1, roll=-0.05)
    loaded, sunk = solve_loaded_stand(robot, task, 2.0, point)
    feet = np.mean(list(sunk.contact_points.values()), axis=0)
    com = pa.Configuration(loaded, sunk.qpos).center_of_mass()
    np.testing.assert_allclose(com[:2], feet[:2], atol=1e-9)
    assert sunk.qpos[2] == pytest.approx(robot.stand_height, abs=1e-9)
    statics = pa.stance.stand_statics(loaded, sunk)
    assert sum(f[2] for f in statics.contact_forces.values()) == pytest.approx(
        9.81 * (robot.total_mass + 2.0)
    )
    _, ahead = solve_loaded_stand(robot, pa.StandTask(offset=(0.0, 0.0)), 2.0, point)
    assert ahead.depths["FR"] > ahead.depths["RR"] + 1e-4  # the base stays, the load is in front
    report = pa.verify_stand(loaded, sunk)
    assert report.passed, report.failures


@pytest.mark.parametrize("mass", [-1.0, np.nan, np.inf, "much", True])
def test_a_payload_with_an_invalid_mass_is_refused(mass: object) -> None:
    with pytest.raises(pa.ConfigurationError, match="mass"):
        with_payload(load("v3"), mass)  # type: ignore[arg-type]


def test_contact_softness_under_a_payload_equals_that_of_mujoco() -> None:
    """Reference: `efc_diagA` of MuJoCo; the payload changes the inverse weight of the foot."""
    robot, loaded = load("v3"), with_payload(load("v3"), 5.0)
    foot = robot.contact_places["FR"][0]
    light, heavy = (float(model.mj_model.body_invweight0[foot, 0]) for model in (robot, loaded))
    assert heavy < light
    _, stand = solve_loaded_stand(robot, pa.StandTask(), 5.0, (0.0, 0.0, 0.0))
    data = evaluate_mujoco(loaded, stand.qpos)
    assert data.ncon == 4
    for touch in data.contact:
        law = GroundLaw.of_contact(loaded, loaded.foot_geoms[max(touch.geom)])
        assert law.normal == pytest.approx(data.efc_diagA[touch.efc_address], rel=1e-12)


def test_third_payload_at_a_place_is_not_compiled_and_equals_the_compiled_model(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Reference: the model that MuJoCo compiles for the first payload of another robot."""
    robot, compiled = (
        pa.load_variant("v3"),
        with_payload(pa.load_variant("v3"), 2.5, (0.01, 0.0, 0.08)),
    )
    for mass in (1.0, 4.0):
        with_payload(robot, mass, (0.01, 0.0, 0.08))
    monkeypatch.setattr("pupper_analysis.robot.tool.rebuild_robot", None)
    changed = with_payload(robot, 2.5, (0.01, 0.0, 0.08))
    assert _serialize_model(changed.mj_model) == _serialize_model(compiled.mj_model)
    assert changed.description.urdf == compiled.description.urdf
    assert changed.description.mjcf.to_xml() == compiled.description.mjcf.to_xml()
    assert changed.pin_model == compiled.pin_model
    assert changed.published is not None


def test_payload_is_compiled_if_the_damping_of_a_servo_depends_on_the_mass(tmp_path: Path) -> None:
    """MuJoCo's compiler computes kv of ``dampratio`` from the inertia of the loaded robot."""
    pair = quadruped(tmp_path, actuators="position")
    text = pair.mjcf.read_text()
    assert 'kv="' in text
    pair.mjcf.write_text(re.sub(r'kv="[^"]*"', 'dampratio="1"', text))
    robot, reference = pa.load_robot(*pair), pa.load_robot(*pair)
    compiled = with_payload(reference, 2.5)
    for mass in (1.0, 4.0, 2.5):
        loaded = with_payload(robot, mass)
    assert _serialize_model(loaded.mj_model) == _serialize_model(compiled.mj_model)


def _serialize_model(model: mujoco.MjModel) -> bytes:
    """Return the bytes that MuJoCo writes to a file."""
    content = np.empty(mujoco.mj_sizeModel(model), dtype=np.uint8)
    mujoco.mj_saveModel(model, None, content)
    return content.tobytes()


def test_payload_that_no_joint_carries_is_refused_on_a_fixed_base(tmp_path: Path) -> None:
    """Its weight loads no motor: on the base itself, and on a link that is fixed to the base."""
    camera = (
        '<link name="camera"/><joint name="mount" type="fixed"><parent link="base"/>'
        '<child link="camera"/><origin xyz="0 0 0.2"/></joint></robot>'
    )
    robot = load_arm(tmp_path, urdf=URDF.replace("</robot>", camera))
    for link in ("base", "camera"):
        with pytest.raises(pa.ConfigurationError, match="fixed base"):
            with_payload(robot, 1.0, (link, 0.0, 0.0, 0.0))
    assert with_payload(arm(), 1.0, ("tip", 0.0, 0.0, 0.0)).total_mass > arm().total_mass
