"""How much a stand carries: closed forms, and MuJoCo with the mass on its back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import NAMES, load, stand_of

import pupper_analysis as pa
from pupper_analysis.payload import Failure, PayloadLimit, payload_limit
from pupper_analysis.robot import build_robot


def loaded(robot: pa.Robot, mass: float, point: tuple[float, float, float]) -> pa.Robot:
    """The robot with a small heavy body fixed to its base, in both files."""
    spec = robot.description.mjcf.copy()
    body = spec.body(robot.mj_base).add_body(name="payload", pos=point)
    body.mass, body.inertia, body.ipos = mass, (1e-9,) * 3, (0.0, 0.0, 0.0)
    body.explicitinertial = True
    x, y, z = point
    link = (
        f'<link name="payload"><inertial><mass value="{mass!r}"/>'
        '<inertia ixx="1e-9" iyy="1e-9" izz="1e-9" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        f'<joint name="payload_joint" type="fixed"><origin xyz="{x} {y} {z}"/>'
        f'<parent link="{robot.base}"/><child link="payload"/></joint></robot>'
    )
    urdf = robot.description.urdf.replace("</robot>", link)
    return build_robot(replace(robot.description, mjcf=spec, urdf=urdf))


def holds(robot: pa.Robot, stand: pa.Stand, mass: float, point: tuple[float, float, float]) -> bool:
    """Whether the loaded robot stays on its feet in MuJoCo, commanded its own balance.

    How exactly it agrees with the prediction does not matter here.
    """
    heavier = loaded(robot, mass, point)
    try:
        report = pa.verify_stand(heavier, stand, duration=3.0)
    except pa.StaticsInfeasibleError:
        return False
    falls = ("fell", "touches", "carries nothing", "diverged")
    return not any(word in failure for failure in report.failures for word in falls)


@pytest.mark.parametrize("name", NAMES)
def test_tipping_is_the_balance_about_the_edge(name: str) -> None:
    """Ahead of the front feet: m (a - d) = M d, with d and a from the com to edge and mass."""
    robot, stand = load(name), stand_of(name)
    point = (0.2, 0.0, 0.05)
    com = pa.Configuration(robot, stand.qpos).center_of_mass()[0]
    edge = max(place[0] for place in stand.contact_points.values()) - com
    arm = stand.qpos[0] + point[0] - com
    limit = payload_limit(robot, stand, point)
    assert limit.failure is Failure.TIPPING
    assert limit.mass == pytest.approx(robot.total_mass * edge / (arm - edge), rel=1e-5)
    front = {foot for foot, place in stand.contact_points.items() if place[0] > com}
    assert set(limit.where) == set(robot.feet) - front
    assert limit.by[Failure.MOTOR.value] > limit.mass


@pytest.mark.parametrize("name", NAMES)
def test_at_the_limit_the_robot_balances_and_a_motor_is_at_its_end(name: str) -> None:
    robot, stand = load(name), stand_of(name)
    limit = payload_limit(robot, stand, (0.0, 0.0, 0.05))
    assert limit.failure is Failure.MOTOR
    use = np.abs(limit.joint_torques) / robot.effort_limits
    assert use.max() == pytest.approx(1.0, abs=1e-5)
    assert all(joint.endswith(("_3", "KFE")) for joint in limit.where)
    heavier = loaded(robot, limit.mass, (0.0, 0.0, 0.05))
    config = pa.Configuration(heavier, stand.qpos)
    remainder = config.gravity()
    for foot, force in limit.contact_forces.items():
        remainder -= config.contact_jacobians([foot])[foot].T @ force
    remainder[6:] -= limit.joint_torques
    assert np.abs(remainder).max() < 1e-5 * np.abs(config.gravity()).max()


def test_more_torque_carries_more_in_proportion() -> None:
    """The knees' limit doubled carries twice the total weight, but for the legs' own."""
    robot, stand = load("v3"), stand_of("v3")
    model = robot.pin_model.copy()
    model.effortLimit[6:] *= 2
    one = payload_limit(robot, stand).mass
    two = payload_limit(replace(robot, pin_model=model), stand).mass
    assert (two + robot.total_mass) / (one + robot.total_mass) == pytest.approx(2.0, rel=0.03)


@pytest.mark.parametrize("name", ["original", "v3"])
def test_mujoco_agrees_on_the_tipping_limit(name: str) -> None:
    robot, stand, point = load(name), stand_of(name), (0.2, 0.0, 0.05)
    limit = payload_limit(robot, stand, point).mass
    assert not holds(robot, stand, 1.02 * limit, point)
    assert holds(robot, stand, 0.7 * limit, point)  # it tilts a little into the soft ground


def test_a_slope_makes_the_feet_slide_first() -> None:
    """Just inside the friction cone, the mass does not matter: but on a foot of less grip it does.

    A load high above a slope takes load off the uphill feet; all carry the same friction
    coefficient, so on a plane the whole robot slides at one angle, whatever it carries.
    """
    robot = load("v3")
    steep = pa.StandTask(ground=pa.Ground(slope=0.7), pitch=-0.6)
    stand = pa.solve_stand(robot, steep)
    limit = payload_limit(robot, stand)
    assert limit.by[Failure.SLIDING.value] == pytest.approx(limit.by[Failure.TIPPING.value])


def test_an_unlimited_robot() -> None:
    robot, stand = load("v3"), stand_of("v3")
    model = robot.pin_model.copy()
    model.effortLimit = np.full(model.nv, np.inf)
    limit = payload_limit(replace(robot, pin_model=model), stand)
    assert limit.failure is Failure.NOTHING
    assert limit.by[Failure.MOTOR.value] == np.inf
    assert isinstance(limit, PayloadLimit)


@pytest.mark.parametrize("point", [(0, 0), (0, 0, np.nan), "top"])
def test_bad_points(point: object) -> None:
    with pytest.raises(pa.ConfigurationError, match="point"):
        payload_limit(load("v3"), stand_of("v3"), point)  # type: ignore[arg-type]


def test_motors_too_weak_for_the_robot_itself() -> None:
    """No payload; torques and forces are those of the stand, of least torque."""
    robot = pa.load_variant(pa.VariantSpec(base="v3", torso_mass_scale=12.0))
    stand = pa.solve_stand(robot)
    limit, held = pa.payload_limit(robot, stand), pa.stand_statics(robot, stand)
    assert limit.mass == 0.0
    assert limit.failure is Failure.MOTOR
    assert set(limit.where) == {name for name in robot.joint_names if name.endswith("_3")}
    np.testing.assert_array_equal(limit.joint_torques, held.joint_torques)
    assert limit.by["a motor saturates"] == 0.0
