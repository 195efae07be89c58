"""Springs and gravity compensation of an MJCF: motors hold the remaining load, by closed forms and
MuJoCo.
"""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.robot.robot import Robot
from tests.support.legged import Pair, biped, quadruped

STIFFNESS, REST = 7.0, -0.3  # N m/rad, rad


def load(pair: Pair) -> Robot:
    return pa.load_robot(urdf=pair.urdf, mjcf=pair.mjcf)


def with_springs(pair: Pair, joint: str) -> Pair:
    """Add a spring to each joint whose name ends with `joint`."""
    text = pair.mjcf.read_text()
    spring = f'stiffness="{STIFFNESS}" springref="{REST}"'
    assert f'{joint}" axis=' in text
    pair.mjcf.write_text(text.replace(f'{joint}" axis=', f'{joint}" {spring} axis='))
    return pair


def compensate_gravity(pair: Pair, body: str, share: float) -> Pair:
    text = pair.mjcf.read_text()
    assert f'<body name="{body}"' in text
    pair.mjcf.write_text(
        text.replace(f'<body name="{body}"', f'<body name="{body}" gravcomp="{share}"')
    )
    return pair


def verify_stand_without_error(
    robot: Robot, stand: pa.Stand | None = None
) -> pa.simulation.StandVerification:
    found = pa.verify_stand(robot, stand or pa.stance.solve_stand_on_soft_ground(robot))
    assert found.passed, found.failures
    assert max(found.torque_error, found.force_error) < 1e-5
    return found


def torques_at(robot: Robot, qpos: np.ndarray) -> np.ndarray:
    return pa.gravity_compensation(pa.Configuration(robot, qpos)).joint_torques


@pytest.mark.slow
def test_knee_springs_reduce_the_motor_torques_as_in_closed_form(tmp_path: Path) -> None:
    """In closed form: tau' = tau + k (q - q_rest) at the knees, and nothing else changes."""
    plain = pa.load_variant("v3")
    spec = mujoco.MjSpec.from_file(str(plain.description.mjcf_source))
    for joint in spec.joints:
        if joint.name.endswith("_3"):
            joint.stiffness, joint.springref = [0.8, 0, 0], 0.4
    mjcf = Path(plain.description.mjcf_source).with_name("sprung.xml")
    path = tmp_path / mjcf.name
    spec.compile()
    path.write_text(spec.to_xml())
    sprung = pa.load_robot(
        urdf=plain.description.urdf_source, mjcf=path, feet=dict(plain.description.contact_points)
    )
    stand = pa.solve_stand(sprung)
    config, other = pa.Configuration(sprung, stand.qpos), pa.Configuration(plain, stand.qpos)
    first, second = pa.gravity_compensation(config), pa.gravity_compensation(other)
    knees = np.array([name.endswith("_3") for name in sprung.joint_names])
    spring = np.where(knees, 0.8 * (stand.qpos[7:] - 0.4), 0.0)
    np.testing.assert_allclose(first.joint_torques, second.joint_torques + spring, atol=1e-9)
    assert np.abs(spring).max() > 0.1
    for foot, force in second.contact_forces.items():
        np.testing.assert_allclose(first.contact_forces[foot], force, atol=1e-9)
    verify_stand_without_error(sprung)


@pytest.mark.slow
@pytest.mark.parametrize("joint", ["_knee", "_roll"])
def test_a_quadruped_with_springs_stands_as_predicted(joint: str, tmp_path: Path) -> None:
    """Reference: MuJoCo's simulation of the stand."""
    robot = load(with_springs(quadruped(tmp_path), joint))
    assert any(note.code == "springs-are-the-mjcfs" for note in robot.notes)
    verify_stand_without_error(robot)


@pytest.mark.slow
def test_a_biped_with_springs_stands_as_predicted(tmp_path: Path) -> None:
    """Reference: MuJoCo's simulation of the stand."""
    verify_stand_without_error(load(with_springs(biped(tmp_path), "_ankle")))


@pytest.mark.slow
def test_springs_of_tendons_count(tmp_path: Path) -> None:
    """A tendon of length a + 0.5 b pulls with k (rest - length): by 1 and 0.5 of that."""
    pair = quadruped(tmp_path)
    plain = load(pair)
    tendon = """<tendon><fixed name="t" stiffness="9" springlength="0.2">
      <joint joint="FL_pitch" coef="1"/><joint joint="FL_knee" coef="0.5"/></fixed></tendon>"""
    pair.mjcf.write_text(pair.mjcf.read_text().replace("<actuator>", f"{tendon}<actuator>"))
    robot = load(pair)
    qpos = pa.solve_stand(plain).qpos
    pitch, knee = (robot.joint_names.index(f"FL_{joint}") for joint in ("pitch", "knee"))
    pull = 9 * (0.2 - (qpos[7 + pitch] + 0.5 * qpos[7 + knee]))
    wanted = torques_at(plain, qpos).copy()
    wanted[[pitch, knee]] -= pull * np.array([1.0, 0.5])
    np.testing.assert_allclose(torques_at(robot, qpos), wanted, atol=1e-9)
    verify_stand_without_error(robot)


@pytest.mark.slow
@pytest.mark.parametrize("motors", [False, True])
def test_gravity_compensation_takes_weight_off_motors_and_feet(
    motors: bool, tmp_path: Path
) -> None:
    """Half of a trunk of 4 kg is carried by nothing: 8.4 kg weigh as 6.4."""
    pair = compensate_gravity(quadruped(tmp_path), "trunk", 0.5)
    pair = compensate_gravity(pair, "FL_calf", 1.0)
    if motors:
        text = pair.mjcf.read_text()
        pair.mjcf.write_text(text.replace('" axis=', '" actuatorgravcomp="true" axis='))
    robot = load(pair)
    assert any(note.code == "gravity-compensation-passive" for note in robot.notes) == motors
    stand = pa.stance.solve_stand_on_soft_ground(robot)
    statics = pa.stance.stand_statics(robot, stand)
    held = sum(float(force[2]) for force in statics.contact_forces.values())
    assert held == pytest.approx((8.4 - 2.0 - 0.2) * 9.81, rel=1e-9)
    verify_stand_without_error(robot, stand)


@pytest.mark.slow
def test_sag_of_a_quadruped_with_knee_springs_equals_the_simulation(tmp_path: Path) -> None:
    """Reference: height loss [m] in MuJoCo after 8 s, in which the feet creep until tangential
    forces vanish.
    """
    robot = load(with_springs(quadruped(tmp_path), "_knee"))
    stand = pa.solve_stand(robot)
    sag = pa.steady_state(robot, stand, feet="sliding")  # MuJoCo's feet creep to where none pushes
    assert not sag.failures
    seen = pa.verify_stand(robot, stand, feedforward=False, duration=8.0, nudged=0)
    assert sag.height_loss == pytest.approx(seen.height_loss, rel=1e-5)
    plain = pa.steady_state(load(quadruped(tmp_path)), stand, feet="sliding")
    assert abs(sag.height_loss - plain.height_loss) > 1e-4


@pytest.mark.slow
def test_torque_derivatives_equal_finite_differences(tmp_path: Path) -> None:
    """Reference: central differences of the static load, with gravity compensation and springs."""
    robot = load(with_springs(compensate_gravity(quadruped(tmp_path), "trunk", 0.3), "_knee"))
    random = np.random.default_rng(3)
    qpos = pa.solve_stand(robot).qpos
    config = pa.Configuration(robot, qpos)
    wrenches = {foot: random.normal(size=6) for foot in robot.contact_points}
    rates = config.static_load_derivative(wrenches)

    def left(joints: np.ndarray) -> np.ndarray:
        there = pa.Configuration(robot, np.concatenate([qpos[:7], joints]))
        load = there.static_load()
        for foot, wrench in wrenches.items():
            load = load - there.frame_jacobian(robot.contact_frames[foot]).T @ wrench
        return load

    step = 1e-5
    for joint in range(robot.nu):
        away = np.eye(robot.nu)[joint] * step
        numeric = (left(qpos[7:] + away) - left(qpos[7:] - away)) / (2 * step)
        np.testing.assert_allclose(rates[:, 6 + joint], numeric, atol=1e-5)


def test_inverse_dynamics_at_rest_is_the_balance(tmp_path: Path) -> None:
    """Reference: joint torques of the static balance, without velocity and acceleration."""
    robot = load(with_springs(quadruped(tmp_path), "_knee"))
    qpos = pa.solve_stand(robot).qpos
    found = pa.statics.inverse_dynamics(pa.Configuration(robot, qpos), np.zeros(robot.nv))
    np.testing.assert_allclose(found.joint_torques, torques_at(robot, qpos), atol=1e-8)
