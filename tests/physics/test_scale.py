"""A robot scaled in mass from 20 g to 2.8 t is the same robot: no tolerance is in its way."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.models.xml import parse_text, to_text
from pupper_analysis.robot.build import rebuilt
from tests.support.random_legged import drawn, written
from tests.support.variants import load


def scaled(robot: pa.Robot, factor: float) -> pa.Robot:
    """The robot with masses, inertias, armatures, friction, gains and efforts times a factor."""
    spec, root = robot.description.mjcf.copy(), parse_text(robot.description.urdf)
    for body in spec.bodies:
        body.mass *= factor
        body.inertia = np.array(body.inertia) * factor
        body.fullinertia = np.array(body.fullinertia) * factor
    for geom in spec.geoms:
        geom.density *= factor
        if np.isfinite(geom.mass):
            geom.mass *= factor
    for joint in spec.joints:
        joint.armature *= factor
        joint.frictionloss *= factor
        joint.damping = np.array(joint.damping) * factor
    for actuator in spec.actuators:
        for name in ("gainprm", "biasprm", "forcerange"):
            setattr(actuator, name, np.array(getattr(actuator, name)) * factor)
    for tag, words in (("mass", ("value",)), ("inertia", None), ("limit", ("effort",))):
        for element in root.iter(tag):
            for word in words or tuple(str(key) for key in element.keys()):  # noqa: SIM118
                element.set(word, repr(float(str(element.get(word))) * factor))
    return rebuilt(robot, urdf=to_text(root), mjcf=spec)


def numbers(factor: float) -> dict[str, float]:
    """What is asked of a stand, per mass where it is one."""
    robot = scaled(load("v3"), factor)
    stand = pa.solve_stand(robot, pa.StandTask(pitch=0.05, roll=0.04))
    found: dict[str, float] = {"mass": robot.total_mass / factor}
    for feet in ("pinned", "sliding"):
        pose = pa.steady_state(robot, stand, feet=feet)  # type: ignore[arg-type]
        assert pose.failures == ()
        found |= {f"loss {feet}": pose.height_loss, f"stiffness {feet}": pose.stiffness}
    found["least kp"] = pa.minimum_stiffness(robot, stand, tolerance=1e-4) / factor
    found["payload"] = pa.payload_limit(robot, stand, (0, 0, 0.05)).mass / factor
    return found


@pytest.mark.longest
@pytest.mark.parametrize("mass", [0.02, 1.0, 2800.0])
def test_a_scaled_robot_has_the_same_numbers(mass: float) -> None:
    one, other = numbers(1.0), numbers(mass / load("v3").total_mass)
    assert other == pytest.approx(one, rel=1e-6)


@pytest.mark.slow
def test_a_robot_of_20_grams_slides_to_where_it_does_at_3_kilograms() -> None:
    """With 1e-3 N/m to hold it in its place it came to rest 0.6 um higher."""
    losses = []
    for factor in (1.0, 0.02 / load("v3").total_mass):
        robot = scaled(load("v3"), factor)
        stand = pa.solve_stand(robot, pa.StandTask(pitch=0.05, roll=0.04))
        losses.append(pa.steady_state(robot, stand, feet="sliding").height_loss)
    assert losses[1] == pytest.approx(losses[0], rel=1e-9)


@pytest.mark.longest
def test_verdicts_about_the_least_stiffness_do_not_jump(tmp_path: Path) -> None:
    """From below it falls, from there on it stands; once it was stands, unstable, stands."""
    drawn_one = drawn(14)
    drawn_one.motors, drawn_one.base = "position", "free"
    drawn_one.links = [link for link in drawn_one.links if link.name != "tail"]
    pair = written(drawn_one, tmp_path)
    robot = pa.load_robot(urdf=pair.urdf, mjcf=pair.mjcf)
    stand = pa.solve_stand(robot, pa.StandTask(pitch=0.05, roll=0.04))
    least = pa.minimum_stiffness(robot, stand, tolerance=1e-3)
    stands = []
    for share in np.linspace(0.97, 1.03, 25):
        try:
            stands.append(not pa.steady_state(robot, stand, kp=share * least).failures)
        except pa.NoEquilibriumError:
            stands.append(False)
    assert stands == sorted(stands)
    assert stands[13]
    assert not stands[10]
