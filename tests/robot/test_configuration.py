"""Kinematics and dynamics: finite differences, conservation laws, and MuJoCo as second engine."""

import re
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

import pupper_analysis as pa
from pupper_analysis.robot.structure import Kinematics
from tests.support.arm import MJCF, URDF, load_arm
from tests.support.engines import (
    addresses,
    differentiate_along,
    evaluate_mujoco,
    make_free_mechanism,
)
from tests.support.states import positions, random_state, velocities
from tests.support.variants import NAMES, load, stand_of

GRAVITY = 9.81  # [m/s^2]


def check_close(actual: np.ndarray, expected: np.ndarray, tolerance: float) -> None:
    """Compare relative to the largest element."""
    size = max(1e-3, float(np.abs(expected).max()))
    np.testing.assert_allclose(actual, expected, rtol=0, atol=tolerance * size)


# ------------------------------------------------------------------------------------- kinematics


@pytest.mark.slow
@given(data=st.data())
def test_frame_poses_equal_mujoco(any_robot: pa.Robot, data: st.DataObject) -> None:
    """Positions [m] and rotation matrices of all bodies and sites in the world frame."""
    qpos = data.draw(positions(any_robot))
    config, mj = pa.Configuration(any_robot, qpos), evaluate_mujoco(any_robot, qpos)
    model = any_robot.mj_model
    for body in range(1, model.nbody):
        name = model.body(body).name
        np.testing.assert_allclose(config.frame_position(name), mj.xpos[body], atol=1e-12)
        np.testing.assert_allclose(
            config.frame_rotation(name), mj.xmat[body].reshape(3, 3), atol=1e-12
        )
    for site in range(model.nsite):
        place = config.frame_position(model.site(site).name)
        np.testing.assert_allclose(place, mj.site_xpos[site], atol=1e-12)
    base = mj.body(any_robot.mj_base).xmat.reshape(3, 3)
    np.testing.assert_allclose(config.base_rotation(), base, atol=1e-12)


@pytest.mark.slow
@given(data=st.data())
def test_joint_axes_and_anchors_equal_mujoco(any_robot: pa.Robot, data: st.DataObject) -> None:
    qpos = data.draw(positions(any_robot))
    config, mj = pa.Configuration(any_robot, qpos), evaluate_mujoco(any_robot, qpos)
    for name in any_robot.joint_names:
        joint = mj.joint(name)
        np.testing.assert_allclose(config.joint_axis(name), joint.xaxis, atol=1e-12)
        # A slide's anchor moves with it in Pinocchio, and not in MuJoCo: compare across it.
        gap = config.joint_position(name) - joint.xanchor
        if any_robot.mj_model.joint(name).type[0] == mujoco.mjtJoint.mjJNT_SLIDE.value:
            gap = np.cross(gap, joint.xaxis)
        np.testing.assert_allclose(gap, 0, atol=1e-12)
    with pytest.raises(pa.UnknownNameError, match=any_robot.joint_names[0]):
        config.joint_position("tail")
    with pytest.raises(pa.UnknownNameError):
        config.joint_axis("tail")


@pytest.mark.slow
@given(data=st.data())
def test_jacobians_equal_the_derivatives_along_a_velocity(
    any_robot: pa.Robot, data: st.DataObject
) -> None:
    """Reference: finite differences of foot positions, CoM [m] and frame rotation along a random
    qvel.
    """
    qpos, qvel = data.draw(positions(any_robot)), data.draw(velocities(any_robot))
    config = pa.Configuration(any_robot, qpos)

    def rate(function: Callable[[pa.Configuration], np.ndarray]) -> np.ndarray:
        return differentiate_along(
            any_robot, lambda at: function(pa.Configuration(any_robot, at)), qpos, qvel
        )

    for foot, jacobian in config.foot_jacobians().items():
        velocity = rate(lambda at, foot=foot: at.foot_positions()[foot])
        np.testing.assert_allclose(jacobian @ qvel, velocity, atol=1e-7)
    np.testing.assert_allclose(
        config.com_jacobian() @ qvel, rate(lambda at: at.center_of_mass()), atol=1e-7
    )
    frame = next(iter(any_robot.contact_frames.values()))
    spin = rate(lambda at: at.frame_rotation(frame)) @ config.frame_rotation(frame).T
    omega = config.frame_jacobian(frame)[3:] @ qvel
    np.testing.assert_allclose([spin[2, 1], spin[0, 2], spin[1, 0]], omega, atol=1e-7)


@pytest.mark.slow
@given(data=st.data())
def test_contact_jacobian_follows_the_material_point(
    any_robot: pa.Robot, data: st.DataObject
) -> None:
    """The lowest point of the sphere, carried along by the link (not the point of contact)."""
    qpos, qvel = data.draw(positions(any_robot)), data.draw(velocities(any_robot))
    config = pa.Configuration(any_robot, qpos)
    points, centres = config.contact_points(), config.foot_positions()
    assert any_robot.contact_frames
    for foot, frame in any_robot.contact_frames.items():
        down = points[foot] - centres[foot]
        (jacobian,) = config.point_jacobians([foot], down[None])
        np.testing.assert_allclose(down, [0, 0, -any_robot.contact_radius[foot]], atol=1e-15)
        marked = config.frame_rotation(frame).T @ down

        def material(at: np.ndarray, frame: str = frame, mark: np.ndarray = marked) -> np.ndarray:
            moved = pa.Configuration(any_robot, at)
            return moved.frame_position(frame) + moved.frame_rotation(frame) @ mark

        velocity = differentiate_along(any_robot, material, qpos, qvel)
        np.testing.assert_allclose(jacobian @ qvel, velocity, atol=1e-7)


# ------------------------------------------------------------------------------------- dynamics


@pytest.mark.slow
@given(data=st.data())
def test_mass_matrix_equals_mujoco_and_is_positive_definite(
    any_robot: pa.Robot, data: st.DataObject
) -> None:
    """Reference: `mj_fullM`."""
    qpos = data.draw(positions(any_robot))
    model, mj = any_robot.mj_model, evaluate_mujoco(any_robot, qpos)
    theirs = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, mj, theirs)
    _, v = addresses(any_robot)
    matrix = pa.Configuration(any_robot, qpos).mass_matrix()
    np.testing.assert_allclose(matrix, matrix.T, rtol=0, atol=1e-15)
    assert np.linalg.eigvalsh(matrix).min() > 0
    np.testing.assert_allclose(matrix, theirs[np.ix_(v, v)], atol=1e-12)


@pytest.mark.slow
@given(data=st.data())
def test_bias_and_gravity_forces_equal_mujoco(any_robot: pa.Robot, data: st.DataObject) -> None:
    """Reference: `qfrc_bias`, with and without velocity."""
    qpos, qvel = data.draw(positions(any_robot)), data.draw(velocities(any_robot))
    _, v = addresses(any_robot)
    config = pa.Configuration(any_robot, qpos, qvel)
    check_close(config.bias_forces(), evaluate_mujoco(any_robot, qpos, qvel).qfrc_bias[v], 1e-11)
    check_close(config.gravity(), evaluate_mujoco(any_robot, qpos).qfrc_bias[v], 1e-11)


def test_forward_dynamics_equals_mujoco(robot: pa.Robot) -> None:
    """Reference: `qacc` [m/s^2, rad/s^2] of the mechanism without contacts and motors, under random
    forces.
    """
    qpos, qvel = random_state(robot)
    force = np.random.default_rng(1).uniform(-1, 1, robot.nv)
    model = make_free_mechanism(robot)
    mj = evaluate_mujoco(robot, qpos, qvel, model)
    _, v = addresses(robot)
    mj.qfrc_applied[v] = force
    mujoco.mj_forward(model, mj)
    check_close(pa.Configuration(robot, qpos, qvel).forward_dynamics(force), mj.qacc[v], 1e-9)


# ------------------------------------------------------------------------------------- imu


@given(data=st.data())
def test_imu_equals_the_sensors_of_mujoco(data: st.DataObject) -> None:
    """References: gyro [rad/s] and accelerometer [m/s^2] of the MJCF."""
    robot = load(data.draw(st.sampled_from(NAMES)))
    qpos, qvel = data.draw(positions(robot)), data.draw(velocities(robot))
    mj = evaluate_mujoco(robot, qpos, qvel)
    _, v = addresses(robot)
    gyro, acceleration = pa.Configuration(robot, qpos, qvel).imu(mj.qacc[v])
    np.testing.assert_allclose(gyro, mj.sensor("body_gyro").data, atol=1e-11)
    check_close(acceleration, mj.sensor("body_acc").data, 1e-11)


def test_imu_of_a_robot_without_imu_requires_a_frame(tiny: pa.Robot) -> None:
    """At rest the acceleration in a named frame is gravity, R^T (0, 0, g)."""
    assert tiny.imu is None
    config = pa.Configuration(tiny, tiny.neutral())
    with pytest.raises(pa.ConfigurationError, match="no IMU"):
        config.imu(np.zeros(tiny.nv))
    assert config.imu(np.zeros(tiny.nv), "hand")[1] == pytest.approx(
        config.frame_rotation("hand").T @ [0, 0, GRAVITY]
    )


# ------------------------------------------------------------------------------------- bad input


@pytest.mark.parametrize(
    ("qpos", "qvel", "field"),
    [
        (np.zeros(18), None, "qpos"),
        (np.zeros((1, 19)), None, "qpos"),
        ([0.0] * 12, None, "qpos"),
        ("nineteen", None, "qpos"),
        ([[1.0], [1.0, 2.0]], None, "qpos"),
        (np.full(19, np.nan), None, "qpos"),
        (np.array([np.inf, *np.ones(18)]), None, "qpos"),
        (np.zeros(19), None, "qpos"),  # zero quaternion
        (np.ones(19), np.zeros(19), "qvel"),
        (np.ones(19), np.full(18, np.inf), "qvel"),
    ],
)
def test_invalid_state_is_refused_by_field(qpos: object, qvel: object, field: str) -> None:
    """Wrong shapes, NaN, infinite values and a zero quaternion."""
    with pytest.raises(pa.ConfigurationError, match=field) as caught:
        pa.Configuration(load("v3"), qpos, qvel)  # type: ignore[arg-type]
    assert caught.value.field == field


def test_unknown_frame_and_foot_are_refused_with_the_valid_names() -> None:
    config = pa.Configuration(load("v3"), load("v3").neutral())
    with pytest.raises(
        pa.UnknownNameError, match=r"no link 'tail'; the most similar .* 13 more"
    ) as link:
        config.frame_position("tail")
    assert (link.value.kind, link.value.name) == ("link", "tail")
    assert {"base_link", "leg_back_l_3_foot_site"} <= set(link.value.known)
    with pytest.raises(pa.UnknownNameError) as foot:
        config.contact_points(["FR", "tail"])
    assert foot.value.known == ("FR", "FL", "RR", "RL")
    with pytest.raises(pa.UnknownNameError):
        config.imu(np.zeros(18), "tail")


@pytest.mark.parametrize(
    "name", [None, 3, 1.5, object(), [], ["FR"], np.ones(2)], ids=lambda value: type(value).__name__
)
def test_names_that_are_no_texts_are_refused_as_unknown(name: object) -> None:
    """They ended in AttributeError, KeyError, StopIteration or an unhashable type."""
    robot = load("v3")
    config = pa.Configuration(robot, robot.neutral())
    calls: tuple[Callable[[object], object], ...] = (
        config.frame_position,  # type: ignore[assignment]
        config.joint_axis,
        robot.check_foot,
        robot.points_of,
        lambda name: config.foot_centres([name]),  # type: ignore[list-item]
        lambda name: config.foot_rotations([name]),  # type: ignore[list-item]
        lambda name: config.foot_twist_jacobians([name]),  # type: ignore[list-item]
        lambda name: config.contact_points([name]),  # type: ignore[list-item]
    )
    for call in calls:
        with pytest.raises(pa.UnknownNameError) as refusal:
            call(name)
        assert refusal.value.name is name
        assert refusal.value.known


@pytest.mark.parametrize(
    "method", ["contact_points", "foot_centres", "foot_rotations", "foot_twist_jacobians"]
)
@pytest.mark.parametrize("feet", [5, "FL", np.array(1.0)])
def test_feet_that_are_no_iterable_are_refused(method: str, feet: object) -> None:
    with pytest.raises(pa.ConfigurationError, match="feet"):
        getattr(pa.Configuration(load("v3"), stand_of("v3").qpos), method)(feet)


@pytest.mark.parametrize("points", [5, "FL"])
def test_points_that_are_no_iterable_of_names_are_refused(points: object) -> None:
    with pytest.raises(pa.ConfigurationError, match="points"):
        load("v3").feet_with(points)  # type: ignore[arg-type]


@pytest.mark.parametrize("forces", [np.zeros(12), np.zeros((12, 18)), np.zeros((18, 1, 1)), "18"])
def test_forces_of_another_shape_are_not_transferred(forces: object) -> None:
    config = pa.Configuration(load("v3"), stand_of("v3").qpos)
    with pytest.raises(pa.ConfigurationError, match="forces"):
        config.transfer_to_motors(forces)  # type: ignore[arg-type]
    load_per_joint = np.arange(18.0)
    np.testing.assert_array_equal(config.transfer_to_motors(load_per_joint), load_per_joint)


def test_unknown_contact_points_are_refused_by_all_methods() -> None:
    robot = load("v3")
    config = pa.Configuration(robot, robot.neutral())
    for call in (config.foot_centres, config.foot_rotations, config.foot_twist_jacobians):
        with pytest.raises(pa.UnknownNameError, match="FR, FL, RR, RL"):
            call(["FR", "tail"])
    with pytest.raises(pa.UnknownNameError, match="FR, FL, RR, RL"):
        robot.foot_of("tail")
    with pytest.raises(pa.UnknownNameError, match="FR, FL, RR, RL"):
        config.static_load_derivative({"tail": np.zeros(6)})
    with pytest.raises(pa.UnknownNameError):
        config.imu(np.zeros(18), "")  # an empty name is not the default


@pytest.mark.parametrize("constant", [pin.LOCAL, pin.WORLD, pin.LOCAL_WORLD_ALIGNED])
def test_reference_is_a_name_or_the_constant_of_pinocchio(constant: pin.ReferenceFrame) -> None:
    """The names are those of Pinocchio, in lower case."""
    robot = load("v3")
    config = pa.Configuration(robot, robot.neutral(), 0.1 * np.ones(robot.nv))
    name, offset = constant.name.lower(), (0.1, 0.0, 0.0)
    for jacobian in (config.frame_jacobian, config.frame_jacobian_time_variation):
        np.testing.assert_array_equal(
            jacobian("leg_front_r_3", offset, reference=constant),
            jacobian("leg_front_r_3", offset, reference=name),
        )


def test_vectors_of_methods_are_checked() -> None:
    """Each was broadcast, or returned numbers that are not finite."""
    robot = load("v3")
    config = pa.Configuration(robot, robot.neutral())
    wrong = (np.nan, [1.0, 2.0], [np.nan] * 3, "point", None, np.ones((2, 2)))
    calls: dict[str, Callable[[object], object]] = {
        "point": lambda value: config.point_jacobian("base_link", value),  # type: ignore[arg-type]
        "offset": lambda value: config.frame_jacobian(
            "base_link",
            [] if value is None else value,  # type: ignore[arg-type]
        ),
        "joints": robot.make_qpos,  # type: ignore[dict-item]
        "qpos": lambda value: robot.compute_kinematics([] if value is None else value),  # type: ignore[arg-type]
        "wrenches": lambda value: config.static_load_derivative({"FR": value}),  # type: ignore[dict-item]
    }
    for field, call in calls.items():
        for value in wrong:
            with pytest.raises(pa.ConfigurationError, match=field):
                call(value)
    with pytest.raises(pa.ConfigurationError, match="wrenches"):
        config.static_load_derivative([1.0])  # type: ignore[arg-type]
    for value in wrong[:-2]:  # without None, the default
        for reference in ("local", "local_world_aligned"):
            with pytest.raises(pa.ConfigurationError, match="offset"):
                config.frame_jacobian_time_variation("base_link", value, reference=reference)  # type: ignore[arg-type]
    for choice in ([], {}, np.ones((2, 2)), 1.0):
        with pytest.raises(pa.ConfigurationError, match="reference"):
            config.frame_jacobian("base_link", reference=choice)  # type: ignore[arg-type]
        with pytest.raises(pa.ConfigurationError, match="motion"):
            config.manipulability("base_link", motion=choice)  # type: ignore[arg-type]


def test_configuration_copies_and_normalises_its_state() -> None:
    """Results are copies, too: a changed result does not change the next one."""
    robot = load("v3")
    qpos = robot.neutral()
    qpos[3:7] = 2.0
    config = pa.Configuration(robot, qpos)
    np.testing.assert_allclose(config.qpos[3:7], 0.5)
    qpos[0] = 9.0
    assert config.qpos[0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        config.qpos[0] = 1.0
    gravity = config.gravity()
    gravity[:] = 0.0
    assert config.gravity()[2] == pytest.approx(3.17 * GRAVITY)


def test_point_at_an_offset_moves_with_its_frame() -> None:
    """Reference: finite difference of the position of a point that is fixed to the foot."""
    robot, offset = load("v3"), np.array([0.03, -0.05, 0.07])
    frame, (qpos, qvel) = next(iter(robot.contact_frames.values())), random_state(robot, 5)
    config = pa.Configuration(robot, qpos)
    fixed = config.frame_rotation(frame).T @ offset

    def place(at: np.ndarray) -> np.ndarray:
        moved = pa.Configuration(robot, at)
        return moved.frame_position(frame) + moved.frame_rotation(frame) @ fixed

    velocity = config.frame_jacobian(frame, offset)[:3] @ qvel
    np.testing.assert_allclose(velocity, differentiate_along(robot, place, qpos, qvel), atol=1e-7)


def test_centre_of_mass_is_the_mean_of_mujocos_bodies(any_robot: pa.Robot) -> None:
    qpos, _ = random_state(any_robot, 4)
    masses, centres = any_robot.mj_model.body_mass, evaluate_mujoco(any_robot, qpos).xipos
    com = pa.Configuration(any_robot, qpos).center_of_mass()
    np.testing.assert_allclose(com, masses @ centres / masses.sum(), atol=1e-12)


def test_free_flight_of_mujoco_keeps_the_energy_and_the_parabola_of_the_com(
    robot: pa.Robot,
) -> None:
    """MuJoCo integrates the MJCF without contacts and losses; the energy is that of the URDF."""
    model, steps = make_free_mechanism(robot), 200
    qpos, qvel = random_state(robot)
    mj = evaluate_mujoco(robot, qpos, qvel, model)
    mujoco.mj_step(model, mj, steps)
    q, v = addresses(robot)
    start, end = (
        pa.Configuration(robot, qpos, qvel),
        pa.Configuration(robot, mj.qpos[q], mj.qvel[v]),
    )

    def energy(config: pa.Configuration) -> float:
        kinetic = config.qvel @ config.mass_matrix() @ config.qvel / 2
        return float(kinetic + robot.total_mass * GRAVITY * config.center_of_mass()[2])

    time, fall = steps * model.opt.timestep, np.array([0, 0, -GRAVITY])
    velocity = start.com_jacobian() @ start.qvel
    expected = start.center_of_mass() + velocity * time + fall * time**2 / 2
    assert abs(start.center_of_mass()[2] - expected[2]) > 0.05
    assert energy(end) == pytest.approx(energy(start), rel=1e-7)
    np.testing.assert_allclose(end.center_of_mass(), expected, atol=1e-7)
    np.testing.assert_allclose(end.com_jacobian() @ end.qvel, velocity + fall * time, atol=1e-6)


def test_forces_and_accelerations_of_a_wrong_size_or_not_finite_are_refused() -> None:
    config = pa.Configuration(load("v3"), load("v3").neutral())
    with pytest.raises(pa.ConfigurationError, match="force"):
        config.forward_dynamics(np.zeros(12))
    with pytest.raises(pa.ConfigurationError, match=r"qacc.*element 3"):
        config.imu(np.where(np.arange(18) == 3, np.nan, 0.0))


def test_com_of_a_fixed_base_with_massless_links_is_that_of_the_base(tmp_path: Path) -> None:
    """Closed form: the base has the only mass, 3 kg at (0.1, 0, 0) m, and does not move."""
    inertia = '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    base = f'<inertial><origin xyz="0.1 0 0"/><mass value="3"/>{inertia}</inertial>'
    urdf = re.sub(r"<inertial>.*?</inertial>", "", URDF)
    urdf = urdf.replace('<link name="base"/>', f'<link name="base">{base}</link>')
    mjcf = MJCF.replace('damping="2"', 'damping="2" armature="0.1"')
    robot = load_arm(tmp_path, urdf=urdf, mjcf=mjcf)
    config = pa.Configuration(robot, robot.home, np.ones(robot.nv))
    np.testing.assert_allclose(config.center_of_mass(), (0.1, 0.0, 0.0), atol=1e-15)
    assert not config.com_jacobian().any()
    assert not config.com_acceleration(np.ones(robot.nv)).any()
    kinematics = Kinematics(robot.structure)
    kinematics.update(robot.home)
    np.testing.assert_allclose(kinematics.com, (0.1, 0.0, 0.0), atol=1e-15)


def test_centroidal_map_of_massless_links_is_the_rotational_inertia(tmp_path: Path) -> None:
    """References: links of 1e-6 kg with the same tensors (Pinocchio), and finite differences.

    The moving links have tensors, but no mass.
    """
    tensor = '<inertia ixx="0.3" iyy="0.2" izz="0.4" ixy="0.05" ixz="0.02" iyz="-0.03"/>'
    heavy = f'<inertial><origin xyz="0.1 0 0"/><mass value="3"/>{tensor}</inertial>'

    def load(mass: str, folder: Path) -> pa.Robot:
        moving = f'<inertial><mass value="{mass}"/>{tensor}</inertial>'
        urdf = re.sub(r"<inertial>.*?</inertial>", moving, URDF)
        urdf = urdf.replace('<link name="base"/>', f'<link name="base">{heavy}</link>')
        folder.mkdir()
        mjcf = MJCF.replace('damping="2"', 'damping="2" armature="0.1"')
        return load_arm(folder, urdf=urdf, mjcf=mjcf)

    massless, light = load("0", tmp_path / "massless"), load("1e-6", tmp_path / "light")
    qpos, qvel = massless.home + 0.3, np.linspace(0.5, 1.5, massless.nv)
    config = pa.Configuration(massless, qpos, qvel)
    momentum, variation = config.centroidal_map(), config.centroidal_map_time_variation()
    reference = pa.Configuration(light, qpos, qvel)
    assert momentum[3:].any()
    np.testing.assert_allclose(momentum, reference.centroidal_map(), atol=1e-5)
    np.testing.assert_allclose(variation, reference.centroidal_map_time_variation(), atol=1e-5)
    before, after = (
        pa.Configuration(massless, qpos + step * qvel).centroidal_map() for step in (-1e-5, 1e-5)
    )
    np.testing.assert_allclose(variation, (after - before) / 2e-5, atol=1e-8)


def test_error_about_a_foot_lists_its_frame_first() -> None:
    """`frame_jacobian` accepts links, not feet: the position on a foot would be ambiguous."""
    robot = load("v3")
    config = pa.Configuration(robot, robot.neutral())
    for compute in (config.frame_jacobian, config.frame_position):
        for foot, frame in robot.contact_frames.items():
            with pytest.raises(pa.UnknownNameError, match=f"no link '{foot}'; .*: {frame}, "):
                compute(foot)
