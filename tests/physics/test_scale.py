"""Dimensionless results of robots from 20 g to 2.8 t: no absolute tolerance affects them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.models.xml import parse_text, to_text
from pupper_analysis.robot import stability
from pupper_analysis.robot.build import rebuild_robot
from pupper_analysis.simulation import growth
from pupper_analysis.stance.sag import steady_state
from tests.support.random_legged import draw_robot, write_robot
from tests.support.variants import load


def resize_robot(robot: pa.Robot, size: float, density: float = 1.0) -> pa.Robot:
    """Scale the lengths of a robot by ``size`` and the density by ``density``.

    Times scale with the square root of ``size``, masses with size^3, torques with size^4, and
    inertias with size^5.
    """
    time, mass, torque = size**0.5, density * size**3, density * size**4
    spec, root = robot.description.mjcf.copy(), parse_text(robot.description.urdf)
    spec.option.timestep *= time
    for body in spec.bodies:
        body.pos, body.ipos = size * np.array(body.pos), size * np.array(body.ipos)
        body.mass *= mass
        body.inertia = np.array(body.inertia) * mass * size**2
        body.fullinertia = np.array(body.fullinertia) * mass * size**2
    for frame in (*spec.sites, *spec.cameras, *spec.lights):
        frame.pos = size * np.array(frame.pos)
    for geom in spec.geoms:
        for name in ("pos", "size", "fromto"):
            setattr(geom, name, size * np.array(getattr(geom, name)))
        geom.margin, geom.gap = size * geom.margin, size * geom.gap
        geom.density *= density
        if np.isfinite(geom.mass):
            geom.mass *= mass
        geom.friction = np.array(geom.friction) * (1.0, size, size)
        geom.solref, geom.solimp = (
            _scale_solref(geom.solref, time),
            _scale_solimp(geom.solimp, size),
        )
    for mesh in spec.meshes:
        mesh.scale = size * np.array(mesh.scale)
    for joint in spec.joints:
        joint.pos = size * np.array(joint.pos)
        joint.armature *= mass * size**2
        joint.frictionloss *= torque
        joint.damping = np.array(joint.damping) * torque * time
        joint.solref_limit = _scale_solref(joint.solref_limit, time)
        joint.solref_friction = _scale_solref(joint.solref_friction, time)
    for actuator in spec.actuators:
        rates = np.ones(10) * torque
        rates[2] *= time  # kv
        actuator.gainprm = np.array(actuator.gainprm) * torque
        actuator.biasprm = np.array(actuator.biasprm) * rates
        actuator.forcerange = np.array(actuator.forcerange) * torque
    for key in spec.keys:
        qpos = np.array(key.qpos)
        qpos[:3] *= size
        key.qpos = qpos
    factors = {
        "origin": {"xyz": size},
        "mass": {"value": mass},
        "inertia": dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), mass * size**2),
        "limit": {"effort": torque, "velocity": 1 / time},
        "dynamics": {"damping": torque * time, "friction": torque},
        "box": {"size": size},
        "sphere": {"radius": size},
        "cylinder": {"radius": size, "length": size},
    }
    for tag, words in factors.items():
        for element in root.iter(tag):
            for word, factor in words.items():
                given = str(element.get(word) or "").split()
                if given:
                    element.set(word, " ".join(repr(float(value) * factor) for value in given))
    for mesh in root.iter("mesh"):
        scale = [float(value) for value in str(mesh.get("scale", "1 1 1")).split()]
        mesh.set("scale", " ".join(repr(value * size) for value in scale))
    built = rebuild_robot(robot, urdf=to_text(root), mjcf=spec)
    return replace(built, stand_height=size * robot.stand_height)


def _scale_solref(given: np.ndarray, time: float) -> np.ndarray:
    first, second = given
    return np.array([first * time, second] if first > 0 else [first / time**2, second / time])


def _scale_solimp(given: np.ndarray, size: float) -> np.ndarray:
    return np.array(given) * (1.0, 1.0, size, 1.0, 1.0)


def numbers(robot: pa.Robot, mass: float, size: float = 1.0) -> dict[str, float]:
    """Return dimensionless results of stands: quantities divided by powers of the mass and size
    factors.
    """
    stand = pa.solve_stand(robot, pa.StandTask(pitch=0.05, roll=0.04))
    found: dict[str, float] = {"mass": robot.total_mass / mass, "height": stand.qpos[2] / size}
    for feet in ("pinned", "sliding"):
        pose = pa.steady_state(robot, stand, feet=feet)  # type: ignore[arg-type]
        assert pose.failures == ()
        found[f"loss {feet}"] = pose.height_loss / size
        found[f"stiffness {feet}"] = pose.stiffness * size
    found["least kp"] = pa.stance.minimum_stiffness(robot, stand, tolerance=1e-4) / (mass * size)
    found["payload"] = pa.payload_limit(robot, stand, (0, 0, 0.05 * size)).mass / mass
    return found


@cache
def published_numbers() -> dict[str, float]:
    """Return the numbers of v3 with its published mass and size."""
    return numbers(load("v3"), 1.0)


@pytest.mark.slow
@pytest.mark.parametrize("mass", [0.02, 1.0, 2800.0])
def test_dimensionless_results_do_not_depend_on_mass(mass: float) -> None:
    """Reference: results of the published robot; all masses, torques and gains are scaled alike."""
    robot, factor = load("v3"), mass / load("v3").total_mass
    found = numbers(resize_robot(robot, 1.0, factor), factor)
    assert found == pytest.approx(published_numbers(), rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("mass", [0.02, 2800.0])
def test_dimensionless_results_do_not_depend_on_size(
    mass: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Except for the 12 s in which creep and growth are simulated.

    In its own time unit, a small robot is simulated for longer, and the smallest stiffness is 8 %
    higher, that of 2.8 t 5 % lower; payloads are 6 % smaller and 4 % larger. Payloads limited by
    simulations have a resolution of 2 %.
    """
    robot, factor = load("v3"), mass / load("v3").total_mass
    one, size = dict(published_numbers()), factor ** (1 / 3)
    lasting = steady_state.HOLD_DURATION * size**0.5
    monkeypatch.setattr(steady_state, "HOLD_DURATION", lasting)
    monkeypatch.setattr(stability, "HOLD_DURATION", lasting)
    monkeypatch.setattr(stability.Stability.modes_growing_within, "__defaults__", (lasting,))
    for name in ("HOLD_DURATION", "LONGEST_TRIAL", "_CHUNK_DURATION", "_HALF_TIME", "_MAX_WINDOW"):
        monkeypatch.setattr(growth, name, getattr(growth, name) * size**0.5)
    for name in ("MODE_NUDGE_SPEED", "FREEING_SPEED"):
        monkeypatch.setattr(growth, name, getattr(growth, name) / size**0.5)
    two = numbers(resize_robot(robot, size), factor, size)
    assert two.pop("payload") == pytest.approx(one.pop("payload"), rel=0.02)
    assert two == pytest.approx(one, rel=1e-6)


def test_sliding_rest_position_does_not_depend_on_mass() -> None:
    """Reference: scaling law of statics. A penalty of 1e-3 N/m changed the height by 0.6 um."""
    losses = []
    for factor in (1.0, 0.02 / load("v3").total_mass):
        robot = resize_robot(load("v3"), 1.0, factor)
        stand = pa.solve_stand(robot, pa.StandTask(pitch=0.05, roll=0.04))
        losses.append(pa.steady_state(robot, stand, feet="sliding").height_loss)
    assert losses[1] == pytest.approx(losses[0], rel=1e-9)


@pytest.mark.slow
def test_verdict_changes_once_around_the_minimum_stiffness(tmp_path: Path) -> None:
    """The robot falls below the minimum and stands above; a verdict must not alternate."""
    drawn_one = draw_robot(14)
    drawn_one.motors, drawn_one.base = "position", "free"
    drawn_one.links = [link for link in drawn_one.links if link.name != "tail"]
    pair = write_robot(drawn_one, tmp_path)
    robot = pa.load_robot(urdf=pair.urdf, mjcf=pair.mjcf)
    stand = pa.solve_stand(robot, pa.StandTask(pitch=0.05, roll=0.04))
    least = pa.stance.minimum_stiffness(robot, stand, tolerance=1e-3)
    stands = []
    for share in np.linspace(0.97, 1.03, 25):
        try:
            stands.append(not pa.steady_state(robot, stand, kp=share * least).failures)
        except pa.NoEquilibriumError:
            stands.append(False)
    assert stands == sorted(stands)
    assert stands[13]
    assert not stands[10]
