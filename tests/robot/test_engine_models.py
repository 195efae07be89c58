"""Models for other programs, and conversions, against Pinocchio's and MuJoCo's own results."""

from __future__ import annotations

import pickle
import warnings
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest
import trimesh

import pupper_analysis as pa
from pupper_analysis.stance.clearance import ClearanceShapes
from tests.support.engines import evaluate_mujoco
from tests.support.states import random_state
from tests.support.tiny import Files
from tests.support.variants import load, stand_of

# Joint order unlike Pinocchio's, slides, an offset base, an unlimited hinge, and two hinges of one
# body; the base is free or fixed.
ODD_MJCF = """
<mujoco model="odd">
  <worldbody>
    {floor}
    <body name="trunk" pos="0 0 1" quat="0.9 0.1 0.3 0.2">
      {free}
      <inertial pos="0.02 -0.01 0.03" mass="3" fullinertia="0.02 0.03 0.04 0.001 0.002 0.003"/>
      <body name="z_arm" pos="0.1 0 0">
        <joint name="z_slide" type="slide" axis="1 1 0" range="-0.2 0.3" armature="0.05"/>
        <inertial pos="0 0 0.1" mass="0.7" diaginertia="0.002 0.003 0.004"/>
        <body name="z_hand" pos="0 0.1 0.2" quat="1 0.5 0 0">
          <joint name="z_spin" axis="0 1 1"/>
          <inertial pos="0.03 0 0" mass="0.2" diaginertia="0.001 0.001 0.001"/>
          <geom type="capsule" size="0.02 0.05"/>
        </body>
      </body>
      <body name="a_leg" pos="-0.1 0.05 0">
        <joint name="a_hip" axis="1 0 0" pos="0 0 0.02" range="-57 57" armature="0.01"/>
        <joint name="a_yaw" axis="0 0 1" range="-57 57"/>
        <inertial pos="0 0 -0.1" mass="0.5" diaginertia="0.002 0.002 0.001"/>
        <body name="a_foot" pos="0 0 -0.3">
          <joint name="a_knee" type="slide" axis="0 0 1" range="-0.1 0.1"/>
          <inertial pos="0 0 0.05" mass="0.3" diaginertia="0.001 0.002 0.001"/>
          <geom name="ball" size="0.03"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor joint="a_knee"/><motor joint="z_spin"/><motor joint="a_hip"/><motor joint="z_slide"/>
    <motor joint="a_yaw"/>
  </actuator>
</mujoco>
"""

NAMES = ("v3", "long-leg", "v3 fixed", "tiny", "odd free", "odd fixed")


@cache
def load_odd(name: str, folder: Path) -> pa.Robot:
    free = name == "odd free"
    file = folder / f"{name}.xml".replace(" ", "_")
    file.write_text(
        ODD_MJCF.format(
            floor='<geom type="plane" size="1 1 1"/>' if free else "",
            free="<freejoint/>" if free else "",
        )
    )
    return pa.load_robot(file, fixed_base=not free)


@pytest.fixture(scope="module")
def odd_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("odd")


@pytest.fixture(params=NAMES)
def robot(request: pytest.FixtureRequest, tiny: pa.Robot, odd_folder: Path) -> pa.Robot:
    """Robots with sliding, unlimited and fixed joints, and with joints in another order."""
    name = str(request.param)
    if name == "tiny":
        return tiny
    if name.startswith("odd"):
        return load_odd(name, odd_folder)
    return load(name.split()[0], fixed_base="fixed" in name)


def states(robot: pa.Robot) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    return (random_state(robot, seed) for seed in range(10))


def check_close(actual: np.ndarray, expected: np.ndarray) -> None:
    scale = max(1.0, float(np.abs(expected).max()))
    np.testing.assert_allclose(actual, expected, rtol=0, atol=1e-12 * scale)


@pytest.mark.slow
def test_state_returns_after_conversion_to_pinocchio_and_back(robot: pa.Robot) -> None:
    for qpos, qvel in states(robot):
        q, v = robot.to_pinocchio(qpos, qvel)
        check_close(robot.to_pinocchio(qpos), q)
        back_qpos, back_qvel = robot.to_mujoco(q, v)
        check_close(back_qpos, qpos)
        check_close(back_qvel, qvel)
        check_close(robot.to_mujoco(q), qpos)


@pytest.mark.slow
def test_link_velocities_agree_after_conversion(robot: pa.Robot) -> None:
    """MuJoCo's ``mj_objectVelocity`` and Pinocchio's ``getFrameVelocity`` of each moving body."""
    for qpos, qvel in states(robot):
        data = evaluate_mujoco(robot, qpos, qvel)
        q, v = robot.to_pinocchio(qpos, qvel)
        pin_data = robot.pin_data()
        pin.forwardKinematics(robot.pin_model, pin_data, q, v)
        pin.updateFramePlacements(robot.pin_model, pin_data)
        for body in range(1, robot.mj_model.nbody):
            name = robot.mj_model.body(body).name
            if not robot.pin_model.existFrame(name, pin.FrameType.BODY):
                continue
            frame = robot.pin_model.getFrameId(name, pin.FrameType.BODY)
            check_close(pin_data.oMf[frame].translation, data.xpos[body])
            velocity, expected = np.zeros(6), np.zeros(6)
            mujoco.mj_objectVelocity(
                robot.mj_model, data, mujoco.mjtObj.mjOBJ_XBODY.value, body, velocity, 0
            )
            expected[:] = pin.getFrameVelocity(
                robot.pin_model, pin_data, frame, pin.LOCAL_WORLD_ALIGNED
            )
            check_close(velocity, np.concatenate([expected[3:], expected[:3]]))


def test_inverse_dynamics_agree_after_conversion(robot: pa.Robot) -> None:
    """MuJoCo's M qacc + bias, and Pinocchio's ``rnea`` plus armature, at random accelerations."""
    index = robot.mj_convention.qvel_index
    for seed, (qpos, qvel) in enumerate(states(robot)):
        qacc = np.random.default_rng(seed).uniform(-3, 3, robot.nv)
        data = evaluate_mujoco(robot, qpos, qvel)
        mass = np.zeros((robot.mj_model.nv, robot.mj_model.nv))
        mujoco.mj_fullM(robot.mj_model, data, mass)
        forces = mass[np.ix_(index, index)] @ qacc + data.qfrc_bias[index]
        q, v = robot.to_pinocchio(qpos, qvel)
        a = robot.accelerations_to_pinocchio(qpos, qvel, qacc)
        model = robot.pin_model.copy()
        model.gravity = pin.Motion(robot.gravity, np.zeros(3))
        # Pinocchio adds the armature in `rnea` since version 3.
        tau = pin.rnea(model, model.createData(), q, v, a)
        check_close(robot.forces_to_mujoco(qpos, tau), forces)
        check_close(robot.forces_to_pinocchio(qpos, forces), tau)
        check_close(robot.accelerations_to_mujoco(qpos, qvel, a), qacc)


def test_jacobians_agree_after_conversion(robot: pa.Robot) -> None:
    """MuJoCo's ``mj_jacBody`` and Pinocchio's ``computeFrameJacobian`` of the last body."""
    body = robot.mj_model.nbody - 1
    name = robot.mj_model.body(body).name
    frame = robot.pin_model.getFrameId(name, pin.FrameType.BODY)
    for qpos, _ in states(robot):
        data = evaluate_mujoco(robot, qpos)
        linear, angular = np.zeros((2, 3, robot.mj_model.nv))
        mujoco.mj_jacBody(robot.mj_model, data, linear, angular, body)
        expected = np.vstack([linear, angular])[:, robot.mj_convention.qvel_index]
        jacobian = pin.computeFrameJacobian(
            robot.pin_model,
            robot.pin_data(),
            robot.to_pinocchio(qpos),
            frame,
            pin.LOCAL_WORLD_ALIGNED,
        )
        check_close(robot.jacobian_to_mujoco(qpos, jacobian), expected)
        check_close(robot.jacobian_to_pinocchio(qpos, expected), jacobian)


def test_mass_matrix_agrees_by_velocity_map(robot: pa.Robot) -> None:
    """MuJoCo's ``mj_fullM`` and T^T ``crba`` T."""
    index = robot.mj_convention.qvel_index
    for qpos, _ in states(robot):
        mass = np.zeros((robot.mj_model.nv, robot.mj_model.nv))
        mujoco.mj_fullM(robot.mj_model, evaluate_mujoco(robot, qpos), mass)
        upper = pin.crba(robot.pin_model, robot.pin_data(), robot.to_pinocchio(qpos))
        pin_mass = np.triu(upper) + np.triu(upper, 1).T
        velocity_map = robot.velocity_map(qpos)
        check_close(velocity_map.T @ pin_mass @ velocity_map, mass[np.ix_(index, index)])


def test_read_state_returns_the_state_of_set_state(robot: pa.Robot) -> None:
    data = mujoco.MjData(robot.mj_model)
    for qpos, qvel in states(robot):
        robot.mj_convention.set_state(data, qpos, qvel)
        read_qpos, read_qvel = robot.mj_convention.read_state(data)
        np.testing.assert_array_equal(read_qpos, qpos)
        np.testing.assert_array_equal(read_qvel, qvel)


@pytest.mark.parametrize(
    ("method", "arguments", "argument"),
    [
        ("to_pinocchio", ([0.0],), "qpos"),
        ("to_pinocchio", (np.zeros(19),), "qpos"),  # the quaternion is zero
        ("to_mujoco", ([0.0],), "q"),
        ("to_mujoco", (np.zeros(19),), "qpos"),
        ("forces_to_mujoco", (None, [0.0]), "tau"),
        ("forces_to_pinocchio", (None, [np.nan] * 18), "forces"),
        ("jacobian_to_mujoco", (None, np.zeros((3, 17))), "jacobian"),
        ("jacobian_to_pinocchio", (None, np.full((3, 18), np.inf)), "jacobian"),
    ],
)
def test_conversion_refuses_arrays_of_wrong_shape_or_value(
    method: str, arguments: tuple[object, ...], argument: str
) -> None:
    """The message begins with the name of the argument."""
    robot = load("v3")
    filled = [robot.home if value is None else value for value in arguments]
    with pytest.raises(pa.ConfigurationError) as error:
        getattr(robot, method)(*filled)
    assert str(error.value).startswith(argument)


def test_spec_compiles_to_the_model_of_the_robot(robot: pa.Robot) -> None:
    """Masses, ranges, sizes, gains, armature and MuJoCo's model signature are equal to the last
    bit.
    """
    spec = robot.mj_spec()
    model = spec.compile()
    for field in ("body_mass", "jnt_range", "geom_size", "actuator_gainprm", "dof_armature"):
        np.testing.assert_array_equal(getattr(model, field), getattr(robot.mj_model, field))
    assert model.signature == robot.mj_model.signature


@pytest.mark.filterwarnings("ignore:(?s).*Attach conflict")  # the integrators differ
def test_spec_of_urdf_with_meshes_is_attached_to_another_spec(tmp_path: Path) -> None:
    """MuJoCo prefixes the mesh files of a spec with assets. Reference: mass of both robots."""
    trimesh.creation.box((0.1, 0.1, 0.1)).export(tmp_path / "box.stl")
    trimesh.creation.box((0.2, 0.1, 0.1)).export(tmp_path / "seen.glb")
    meshes = {"collision": "box.stl", "visual": "seen.glb"}
    shapes = "".join(
        f'<{kind}><geometry><mesh filename="{file}"/></geometry></{kind}>'
        for kind, file in meshes.items()
    )
    inertia = '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    link = f'<inertial><mass value="2"/>{inertia}</inertial>{shapes}'
    urdf = tmp_path / "tool.urdf"
    urdf.write_text(f"""<robot name="tool"><link name="base"/><link name="arm">{link}</link>
        <joint name="turn" type="revolute"><parent link="base"/><child link="arm"/>
        <limit lower="-1" upper="1" effort="9" velocity="1"/><axis xyz="0 0 1"/></joint></robot>""")
    tool = pa.load_robot(urdf, fixed_base=True).mj_spec()
    parent = load("v3").mj_spec()
    parent.attach(tool, prefix="tool_", frame=parent.body("base_link").add_frame())
    model = parent.compile()
    assert model.body("tool_arm").mass == pytest.approx(2.0)
    assert model.nmesh == load("v3").mj_model.nmesh + 2


def test_change_of_spec_does_not_change_robot() -> None:
    robot = load("v3")
    spec = robot.mj_spec()
    spec.worldbody.add_site(name="mark")
    spec.joints[1].armature = 0.5
    assert "mark" not in [site.name for site in robot.mj_spec().sites]
    assert robot.mj_spec().joints[1].armature != 0.5


def test_collision_distances_agree_with_mujoco(robot: pa.Robot) -> None:
    """Reference: ``mj_geomDistance`` of each pair of geoms that can collide, if separate."""
    geometry = robot.collision_model
    shapes = robot.shapes
    assert geometry.ngeoms == len(shapes)
    geometry_data = geometry.createData()
    for qpos, _ in list(states(robot))[:3]:
        data = evaluate_mujoco(robot, qpos)
        q = robot.to_pinocchio(qpos)
        pin.computeDistances(robot.pin_model, robot.pin_data(), geometry, geometry_data, q)
        for pair, result in zip(
            geometry.collisionPairs, geometry_data.distanceResults, strict=True
        ):
            geoms = shapes[pair.first].geom, shapes[pair.second].geom
            expected = mujoco.mj_geomDistance(robot.mj_model, data, *geoms, 10.0, None)
            if expected > 1e-3:  # MuJoCo and coal differ in the depth of overlaps
                assert result.min_distance == pytest.approx(expected, abs=1e-5)


def test_collision_pairs_are_those_that_mujoco_checks() -> None:
    """Reference: MuJoCo's contacts at random positions, each among the pairs of Pinocchio."""
    robot = load("original")
    geometry, shapes = robot.collision_model, robot.shapes
    pairs = {
        frozenset((shapes[pair.first].geom, shapes[pair.second].geom))
        for pair in geometry.collisionPairs
    }
    found = set()
    for seed in range(60):
        qpos, _ = random_state(robot, seed)
        qpos[2] += 5.0
        data = evaluate_mujoco(robot, qpos)
        found |= {frozenset(contact.geom.tolist()) for contact in data.contact}
    assert found
    assert found <= pairs


@pytest.mark.parametrize("has_base_body", [True, False])
def test_shapes_of_a_fixed_base_count_in_distances_without_the_floor(has_base_body: bool) -> None:
    """Reference: ``mj_geomDistance`` of the plate and the outer link; the inner one is adjacent."""
    plate = '<geom name="plate" type="box" size=".2 .2 .05" pos="0 0 .1" mass="1"/>'
    tube = '<geom name="{}" type="capsule" fromto="0 0 .05 0 0 .25" size=".03"/>'
    links = (
        f'{plate}<body name="in" pos="0 0 .3"><joint name="one" axis="0 1 0" range="-3 3"/>'
        f'{tube.format("inner")}<body name="out" pos="0 0 .3">'
        f'<joint name="two" axis="0 1 0" range="-3 3"/>{tube.format("outer")}</body></body>'
    )
    body = f'<body name="base">{links}</body>' if has_base_body else links
    robot = pa.load_robot(
        f"""<mujoco><worldbody><geom type="plane" size="1 1 .1"/>{body}</worldbody><actuator>
        <position joint="one" kp="50"/><position joint="two" kp="50"/></actuator></mujoco>"""
    )
    model = robot.mj_model
    assert [model.geom(shape.geom).name for shape in robot.shapes] == ["plate", "inner", "outer"]
    assert [shape.on_ground for shape in robot.shapes] == [False, True, True]
    qpos = np.array([1.2, 2.9])
    geoms = model.geom("plate").id, model.geom("outer").id
    gap = mujoco.mj_geomDistance(model, evaluate_mujoco(robot, qpos), *geoms, 1.0, None)
    found = ClearanceShapes(robot).find_closest_links(qpos)
    assert found is not None
    assert found.distance == pytest.approx(gap, abs=1e-6)
    assert found.links == (robot.base, "out")
    pairs = {(pair.first, pair.second) for pair in robot.collision_model.collisionPairs}
    assert pairs == {(0, 1), (0, 2)}  # MuJoCo checks links against a parent that is fixed


def test_collision_model_is_kept_by_pickling() -> None:
    robot = load("v3")
    assert robot.collision_model.ngeoms
    copy = pickle.loads(pickle.dumps(robot))
    assert copy.collision_model.ngeoms == robot.collision_model.ngeoms


def test_tiny_robot_has_continuous_joint_in_q(tiny: pa.Robot, tiny_files: Files) -> None:
    """Closed form: Pinocchio's q holds (cos 0.3, sin 0.3) for the continuous joint."""
    del tiny_files
    qpos = tiny.neutral()
    qpos[-1] = 0.3
    q = tiny.to_pinocchio(qpos)
    address = tiny.pin_model.joints[tiny.pin_model.getJointId("turn")].idx_q
    np.testing.assert_allclose(q[address : address + 2], [np.cos(0.3), np.sin(0.3)])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["v3", "original"])
def test_commands_of_stand_hold_it_in_mujoco(name: str) -> None:
    """Five seconds of MuJoCo from the stand with constant ``stand.ctrl``."""
    robot = load(name)
    stand = pa.solve_stand_as_simulated(robot, pa.StandTask(pitch=0.05))
    model = robot.mj_spec().compile()
    data = mujoco.MjData(model)
    robot.mj_convention.set_state(data, stand.qpos)
    data.ctrl[:] = stand.ctrl
    mujoco.mj_step(model, data, nstep=round(5 / model.opt.timestep))
    qpos, _ = robot.mj_convention.read_state(data)
    np.testing.assert_allclose(qpos[7:], stand.qpos[7:], atol=1e-3)
    assert qpos[2] == pytest.approx(stand.qpos[2], abs=2e-4)


def test_commands_are_position_plus_torque_over_stiffness() -> None:
    """The formula ctrl = q* + tau / kp with kp read from MuJoCo's model."""
    robot = load("v3")
    stand = pa.solve_stand(robot)
    torques = pa.stance.stand_statics(robot, stand).joint_torques
    actuators = robot.mj_convention.actuator_index
    kp = robot.mj_model.actuator_gainprm[actuators, 0]
    np.testing.assert_allclose(stand.ctrl[actuators], stand.qpos[7:] + torques / kp, atol=1e-14)
    np.testing.assert_array_equal(stand.q_pin, robot.to_pinocchio(stand.qpos))


def test_pickled_stand_has_commands_only_with_its_robot() -> None:
    robot = load("v3")
    stand = pa.solve_stand(robot)
    copy = pickle.loads(pickle.dumps(stand))
    for name in ("ctrl", "q_pin"):
        with pytest.raises(pa.ConfigurationError, match="with_robot"):
            getattr(copy, name)
    np.testing.assert_array_equal(copy.with_robot(robot).ctrl, stand.ctrl)
    with pytest.raises(pa.ConfigurationError, match="stand"):
        copy.with_robot(load("original"))


def test_q_pin_and_qpos_of_each_stand_have_equal_foot_positions() -> None:
    """Compare Pinocchio's foot centres [m] at ``q_pin`` with MuJoCo's at ``qpos``."""
    robot = load("v3")
    tasks = [pa.StandTask(height=height, roll=0.1, yaw=0.2) for height in (0.12, 0.125)]
    data = robot.pin_model.createData()
    for stand in pa.solve_stands(robot, tasks):
        pin.framesForwardKinematics(robot.pin_model, data, stand.q_pin)
        mj = evaluate_mujoco(robot, stand.qpos)
        for geom, foot in robot.foot_geoms.items():
            frame = robot.pin_model.getFrameId(robot.contact_frames[foot])
            place = data.oMf[frame].translation
            np.testing.assert_allclose(place, mj.geom_xpos[geom], rtol=0, atol=1e-12)


def test_ctrl_of_a_simulated_stand_has_one_entry_per_actuator() -> None:
    robot = load("v3")
    assert len(pa.solve_stand_as_simulated(robot).ctrl) == robot.mj_model.nu


@pytest.mark.slow
def test_visualizer_of_pinocchio_shows_both_models_at_q_pin() -> None:
    """Reference: position of MuJoCo's geom for each shape."""
    pytest.importorskip("viser")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of MeshCat's packages, which this import loads
        from pinocchio.visualize import ViserVisualizer

    robot, stand = load("v3"), stand_of("v3")
    shown = ViserVisualizer(robot.pin_model, robot.collision_model, robot.collision_model)
    shown.initViewer(open=False, loadModel=True)
    try:
        shown.display(stand.q_pin)
        data = robot.compute_kinematics(stand.qpos)
        found = {
            name.rpartition("/")[2]: np.array(frame.position)
            for name, frame in shown.frames.items()
            if "/visual/" in name
        }
        shapes = [item.name for item in robot.collision_model.geometryObjects]
        assert set(shapes) <= set(found)
        for shape in shapes:
            apart = np.linalg.norm(data.geom_xpos - found[shape], axis=1)
            assert apart.min() < 1e-6
    finally:
        shown.viewer.stop()
