"""The model files of Pupper: their values, and equality of the files."""

from collections.abc import Callable
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
from hypothesis import given
from scipy.spatial.transform import Rotation

import pupper_analysis as pa
from tests.support.bodies import BODIES
from tests.support.engines import evaluate_mujoco
from tests.support.repository import ROOT
from tests.support.states import numbers, random_state
from tests.support.variants import BASES, load

MJCF = ROOT / "mjcf"


@pytest.fixture(scope="module", params=BASES)
def base(request: pytest.FixtureRequest) -> str:
    """Return the name of an unscaled variant; the tests run with each pair of files."""
    return str(request.param)


def compile_model(file: str) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(MJCF / file))


# ------------------------------------------------------------------------------------- numbers


def test_feet_and_com_of_v3_at_zero_angles() -> None:
    """Reference: stated positions [m], in both engines. For the skeleton, ``test_variants.py`` has
    closed forms.
    """
    feet = {
        "FR": (0.06881, -0.1015, -0.11156),
        "FL": (0.06881, 0.1015, -0.11156),
        "RR": (-0.08119, -0.0905, -0.11156),
        "RL": (-0.08119, 0.0905, -0.11156),
    }
    com = (-0.00272409, 0, -0.00609136)
    robot = load("v3")
    assert robot.contact_points == tuple(feet)
    config = pa.Configuration(robot, robot.neutral())
    mj = evaluate_mujoco(robot, robot.neutral())
    for foot, place in feet.items():
        np.testing.assert_allclose(config.foot_positions()[foot], place, atol=1e-9)
        np.testing.assert_allclose(mj.site(robot.contact_frames[foot]).xpos, place, atol=1e-9)
    np.testing.assert_allclose(config.center_of_mass(), com, atol=1e-8)
    np.testing.assert_allclose(mj.body("base_link").subtree_com, com, atol=1e-8)


V3_AXES = {
    "r": [(0, -1, 0), (-1, 0, 0), (0, -1, 0)],
    "l": [(0, 1, 0), (-1, 0, 0), (0, 1, 0)],
}
"""{side: world axes of the three joints of a leg at zero angles}, read in v3's files."""


@pytest.mark.parametrize("side", V3_AXES)
@pytest.mark.parametrize("end", ["front", "back"])
def test_v3_joint_axes_at_zero_angles_in_both_engines(end: str, side: str) -> None:
    """_1 and _3 turn about y (pitch) and _2 about x (roll): ``V3_AXES``."""
    robot = load("v3")
    data = evaluate_mujoco(robot, robot.neutral())
    config = pa.Configuration(robot, robot.neutral())
    for number, expected in enumerate(V3_AXES[side], start=1):
        name = f"leg_{end}_{side}_{number}"
        np.testing.assert_allclose(data.joint(name).xaxis, expected, atol=1e-15)
        jacobian = config.frame_jacobian(name)
        urdf = jacobian[3:, 6 + robot.joint_names.index(name)]
        np.testing.assert_allclose(urdf, expected, atol=1e-15)


def test_actuators_have_the_documented_order() -> None:
    """Front before rear, right before left, hip before knee; the joints of the robot have the order
    of the actuators.
    """
    v3 = [f"leg_{end}_{side}_{i}" for end in ("front", "back") for side in "rl" for i in (1, 2, 3)]
    skeleton = [
        f"{leg}_{joint}" for leg in ("FL", "FR", "RL", "RR") for joint in ("HAA", "HFE", "KFE")
    ]
    for base, expected in (("v3", v3), ("original", skeleton)):
        model = compile_model(f"{BASES[base]}.xml")
        assert [model.actuator(index).name for index in range(model.nu)] == expected
        driven = [model.joint(int(model.actuator_trnid[i, 0])).name for i in range(model.nu)]
        assert driven == expected
        assert load(base).joint_names == tuple(expected)


# ------------------------------------------------------------------------------------- sensors


@pytest.mark.parametrize(("base", "arm"), [("v3", (0.09, 0, 0.032)), ("original", (0.08, 0, 0.03))])
@given(place=numbers(3, 1.0), turn=numbers(3, 1.8), qvel=numbers(6, 3.0))
def test_named_sensors_measure_the_rigid_body_motion(
    base: str, arm: tuple[float, ...], place: np.ndarray, turn: np.ndarray, qvel: np.ndarray
) -> None:
    """Closed forms of gyro, angular and linear velocity [rad/s, m/s] and position [m] of the IMU on
    its lever arm.
    """
    robot = load(base)
    rotation = Rotation.from_rotvec(turn)
    quat = rotation.as_quat(scalar_first=True)
    qpos = np.concatenate([place, quat, np.zeros(12)])
    mj = evaluate_mujoco(robot, qpos, np.concatenate([qvel, np.zeros(12)]))
    omega = rotation.apply(qvel[3:])
    lever = rotation.apply(arm)
    for name, expected in {
        "body_gyro": qvel[3:],
        "global_angvel": omega,
        "global_position": place + lever,
        "global_linvel": qvel[:3] + np.cross(omega, lever),
    }.items():
        np.testing.assert_allclose(mj.sensor(name).data, expected, atol=1e-12, err_msg=name)
    assert abs(mj.sensor("body_quat").data @ quat) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize(
    ("base", "radius", "solimp", "friction"),
    [
        ("v3", 0.01995, (0.015, 1, 0.015), (0.8, 0.02, 0.01)),
        ("original", 0.018, None, (1.2, 0.04, 0.01)),
    ],
)
def test_feet_are_spheres_of_the_robots_radius(
    base: str, radius: float, solimp: tuple[float, ...] | None, friction: tuple[float, ...]
) -> None:
    """Reference: radius [m], solimp and friction of the tutorial's foot."""
    robot = load(base)
    model = robot.mj_model
    assert len(robot.contact_frames) == 4
    for frame in robot.contact_frames.values():
        site = model.site(frame)
        touching = [
            geom
            for geom in range(model.ngeom)
            if model.geom_bodyid[geom] == site.bodyid[0]
            and model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_SPHERE.value
            and (model.geom_contype[geom] or model.geom_conaffinity[geom])
        ]
        assert len(touching) == 1
        geom = touching[0]
        np.testing.assert_allclose(model.geom_pos[geom], site.pos, atol=1e-15)
        assert model.geom_size[geom, 0] == radius
        np.testing.assert_allclose(model.geom_friction[geom], friction)
        if solimp:
            np.testing.assert_allclose(model.geom_solimp[geom, :3], solimp)


@pytest.mark.parametrize(
    ("file", "sizes", "mass", "timestep", "impratio"),
    [
        ("pupper_v3.xml", (19, 18, 12), 3.170, 0.002, 100),
        ("pupper_v3_fixed.xml", (12, 12, 12), 3.170, 0.002, 100),
        ("pupper_skeleton.xml", (19, 18, 12), 2.710, 0.004, 50),
    ],
)
def test_files_have_the_sizes_mass_and_options_of_the_robot(
    file: str, sizes: tuple[int, ...], mass: float, timestep: float, impratio: float
) -> None:
    """References by hand: total mass [kg], time step [s] and impratio."""
    model = compile_model(file)
    assert (model.nq, model.nv, model.nu) == sizes
    assert model.body_mass.sum() == pytest.approx(mass, abs=1e-12)
    assert (model.opt.timestep, model.opt.impratio) == (timestep, impratio)
    assert model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC.value
    np.testing.assert_allclose(model.opt.gravity, [0, 0, -9.81])


@pytest.mark.parametrize(
    ("file", "qpos", "ctrl"),
    [
        ("pupper_v3.xml", [0, 0, 0.28, 1, 0, 0, 0, *[0] * 12], [0] * 12),
        ("pupper_v3_fixed.xml", [0] * 12, [0] * 12),
        (
            "pupper_skeleton.xml",
            [0, 0, 0.158, 1, 0, 0, 0, *[0, 0.9014, -1.5083] * 4],
            [0, 0.9014, -1.5083] * 4,
        ),
    ],
)
def test_home_keyframe_is_the_pose_of_the_robot(
    file: str, qpos: list[float], ctrl: list[float]
) -> None:
    """References: v3 at zero angles, 0.28 m high; the skeleton's standing pose [rad]."""
    key = compile_model(file).key("home")
    np.testing.assert_allclose(key.qpos, qpos)
    np.testing.assert_allclose(key.ctrl, ctrl)


@pytest.mark.parametrize(
    ("base", "armature", "damping", "friction"),
    [("v3", 0.0016, 0.01, 0.01), ("original", 0.003, 0.04, 0.002)],
)
def test_joints_have_the_constants_of_the_robot(
    base: str, armature: float, damping: float, friction: float
) -> None:
    """References by hand: armature [kg m^2], damping [N m s/rad] and friction [N m]."""
    model = compile_model(f"{BASES[base]}.xml")
    np.testing.assert_allclose(model.dof_armature, [0] * 6 + [armature] * 12)
    np.testing.assert_allclose(np.ravel(model.dof_frictionloss), [0] * 6 + [friction] * 12)
    np.testing.assert_allclose(model.dof_damping.reshape(18, -1)[:, 0], [0] * 6 + [damping] * 12)


@pytest.mark.parametrize(
    ("leg", "limits"),
    [
        ("leg_front_r_", [(-1.22, 2.51), (-0.42, 3.14), (-2.79, 0.71)]),
        ("leg_back_r_", [(-1.22, 2.51), (-0.42, 3.14), (-2.79, 0.71)]),
        ("leg_front_l_", [(-2.51, 1.22), (-3.14, 0.42), (-0.71, 2.79)]),
        ("leg_back_l_", [(-2.51, 1.22), (-3.14, 0.42), (-0.71, 2.79)]),
    ],
)
def test_v3_joints_have_the_limits_of_the_robot(
    leg: str, limits: list[tuple[float, float]]
) -> None:
    """References by hand: position limits [rad], mirrored between left and right."""
    model = compile_model("pupper_v3.xml")
    for number, expected in enumerate(limits, start=1):
        np.testing.assert_allclose(model.joint(f"{leg}{number}").range, expected)


def read_urdf_of(base: str) -> ElementTree.Element:
    """Return the root element of the URDF of a base model."""
    return ElementTree.parse(ROOT / "urdf" / f"{BASES[base]}.urdf").getroot()


def read_number(element: ElementTree.Element, path: str, name: str) -> float:
    """Return an attribute of a child element."""
    child = element.find(path)
    assert child is not None
    return float(child.attrib[name])


def test_limits_damping_and_friction_of_both_files_are_equal(base: str) -> None:
    """Reference: MuJoCo's compiled model; the URDF states 100 rad/s."""
    model = compile_model(f"{BASES[base]}.xml")
    joints = [
        joint for joint in read_urdf_of(base).iter("joint") if joint.attrib["type"] == "revolute"
    ]
    assert len(joints) == 12
    for node in joints:
        joint, actuator = (kind(node.attrib["name"]) for kind in (model.joint, model.actuator))
        dof = int(joint.dofadr[0])
        assert joint.limited[0]
        assert actuator.forcelimited[0]
        for path, name, value in (
            ("limit", "lower", joint.range[0]),
            ("limit", "upper", joint.range[1]),
            ("limit", "effort", actuator.forcerange[1]),
            ("limit", "effort", -actuator.forcerange[0]),
            ("limit", "velocity", 100.0),
            ("dynamics", "damping", float(np.ravel(model.dof_damping[dof])[0])),
            ("dynamics", "friction", float(np.ravel(model.dof_frictionloss[dof])[0])),
        ):
            assert read_number(node, path, name) == pytest.approx(value, rel=1e-12), name


@pytest.mark.parametrize(
    ("base", "kp", "kd", "limit"), [("v3", 5.0, 0.1, 3.0), ("original", 60.0, 1.0, 18.0)]
)
def test_servos_have_the_gains_of_the_robot(base: str, kp: float, kd: float, limit: float) -> None:
    """Closed form: kp (ctrl - q) - kd dq/dt, limited to the torque limit [N m]."""
    robot, random = load(base), np.random.default_rng(3)
    qpos, qvel = random_state(robot)
    data = evaluate_mujoco(robot, qpos, qvel)
    data.ctrl[:] = random.uniform(-2.0, 2.0, robot.nu)
    mujoco.mj_forward(robot.mj_model, data)
    torques = np.clip(kp * (data.ctrl - qpos[7:]) - kd * qvel[6:], -limit, limit)
    assert 0 < (np.abs(torques) == limit).sum() < robot.nu
    np.testing.assert_allclose(data.actuator_force, torques, atol=1e-12)
    np.testing.assert_allclose(data.qfrc_actuator, [*[0] * 6, *torques], atol=1e-12)


def test_sites_and_bodies_of_the_mjcf_are_the_links_of_the_urdf(base: str) -> None:
    robot = load(base)
    sites = {robot.mj_model.site(index).name for index in range(robot.mj_model.nsite)}
    bodies = {robot.mj_model.body(index).name for index in range(1, robot.mj_model.nbody)}
    assert len(sites) == 5
    assert "body_imu_site" in sites
    assert sites | bodies == {link.attrib["name"] for link in read_urdf_of(base).iter("link")}


def test_inertias_of_the_skeleton_are_those_that_mujoco_integrates_from_its_shapes() -> None:
    """The MJCF states no inertia, and the URDF states each of them."""
    spec = mujoco.MjSpec.from_file(str(MJCF / "pupper_skeleton.xml"))
    assert not any(body.explicitinertial for body in spec.bodies)
    model, count = spec.compile(), 0
    for link in read_urdf_of("original").iter("link"):
        inertial = link.find("inertial")
        if not link.attrib["name"].endswith(("_hip", "_thigh")) or inertial is None:
            continue
        body, count = model.body(link.attrib["name"]), count + 1
        assert body.mass[0] == pytest.approx(read_number(inertial, "mass", "value"), rel=1e-12)
        stated = [read_number(inertial, "inertia", axis) for axis in ("ixx", "iyy", "izz")]
        np.testing.assert_allclose(sorted(stated), sorted(body.inertia), rtol=1e-12)
    assert count == 8


@pytest.mark.parametrize("name", ["pupper_v3", "pupper_skeleton"])
def test_materials_have_one_colour_in_both_files(name: str) -> None:
    root = ElementTree.parse(ROOT / "urdf" / f"{name}.urdf").getroot()
    defined = {
        material.get("name"): material.find("color").get("rgba").split()  # type: ignore[union-attr]
        for material in root.findall("material")
    }
    assert {material.get("name") for material in root.iter("material")} == set(defined)
    model = compile_model(f"{name}.xml")
    for material, colour in defined.items():
        np.testing.assert_allclose(
            model.mat(material).rgba, np.array(colour, dtype=float), atol=1e-6
        )


def test_meshes_of_v3_do_not_collide() -> None:
    """Reference: 13 visual meshes: the torso, and three per leg."""
    model = compile_model("pupper_v3.xml")
    meshes = model.geom_type == mujoco.mjtGeom.mjGEOM_MESH.value
    assert meshes.sum() == 13
    assert not model.geom_contype[meshes].any()
    assert not model.geom_conaffinity[meshes].any()


def test_robot_touches_only_the_ground_with_its_four_feet(robot: pa.Robot, stand: pa.Stand) -> None:
    """Reference: MuJoCo's contacts with the stand 1 mm lower."""
    data = evaluate_mujoco(robot, stand.qpos - np.eye(robot.nq)[2] * 1e-3)
    assert data.ncon == 4
    assert all(robot.mj_model.geom_bodyid[pair].min() == 0 for pair in data.contact.geom)


MIRROR = np.diag([1.0, -1.0, 1.0])
MIRRORED = (("FR", "FL"), ("RR", "RL"))


def make_mirror_matrix(robot: pa.Robot) -> np.ndarray:
    """Return L (nv, nv): the velocity of the mirror image, with right and left exchanged, is
    L qvel.

    Velocities are mirrored like vectors; angular velocities and axes with the opposite sign.
    """
    matrix, config = np.zeros((robot.nv, robot.nv)), pa.Configuration(robot, robot.neutral())
    matrix[:3, :3], matrix[3:6, 3:6] = MIRROR, -MIRROR
    for right, left in MIRRORED:
        names = [[name for name in robot.joint_names if foot in list_feet(robot, name)]
                 for foot in (right, left)]  # fmt: skip
        for pair in zip(*names, strict=True):
            columns = [6 + robot.joint_names.index(name) for name in pair]
            first, second = (config.joint_axis(name) for name in pair)
            sign = second @ (-MIRROR @ first)
            assert abs(sign) == pytest.approx(1.0, abs=1e-12)
            matrix[columns, columns[::-1]] = sign
    return matrix


def list_feet(robot: pa.Robot, joint: str) -> list[str]:
    """Return the feet that a joint moves, in Pinocchio's kinematics."""
    jacobians = pa.Configuration(robot, random_state(robot)[0]).foot_jacobians()
    column = 6 + robot.joint_names.index(joint)
    return [foot for foot, jacobian in jacobians.items() if np.abs(jacobian[:, column]).max() > 0]


def test_robot_equals_its_mirror_image(robot: pa.Robot) -> None:
    """Reference: mirror symmetry, for mass matrix, gravity torques, CoM, foot positions and limits
    at a random configuration.
    """
    mirror, qpos = make_mirror_matrix(robot), random_state(robot)[0]
    rotation = Rotation.from_quat(qpos[3:7], scalar_first=True).as_rotvec()
    image = np.concatenate(
        [
            MIRROR @ qpos[:3],
            Rotation.from_rotvec(-MIRROR @ rotation).as_quat(scalar_first=True),
            mirror[6:, 6:] @ qpos[7:],
        ]
    )
    first, second = pa.Configuration(robot, qpos), pa.Configuration(robot, image)
    np.testing.assert_allclose(second.center_of_mass(), MIRROR @ first.center_of_mass(), atol=1e-12)
    for right, left in MIRRORED:
        np.testing.assert_allclose(
            second.foot_positions()[left], MIRROR @ first.foot_positions()[right], atol=1e-12
        )
    inertia = mirror @ first.mass_matrix() @ mirror.T
    np.testing.assert_allclose(second.mass_matrix(), inertia, atol=1e-12)
    np.testing.assert_allclose(second.gravity(), mirror @ first.gravity(), atol=1e-12)
    flipped = mirror[6:, 6:].sum(axis=1) < 0
    for limits, others in (
        (robot.lower_limits, robot.upper_limits),
        (robot.upper_limits, robot.lower_limits),
    ):
        images = mirror[6:, 6:] @ limits
        np.testing.assert_allclose(images, np.where(flipped, others, limits), atol=1e-15)


@pytest.mark.parametrize("source", BODIES)
def test_front_and_rear_legs_have_equal_bodies(robot: pa.Robot, source: str) -> None:
    """Masses [kg], CoMs from the hip [m] and inertias, in both engines."""
    bodies = BODIES[source](robot)
    for front, rear in (("FR", "RR"), ("FL", "RL")):
        legs = [[name for name in robot.joint_names if foot in list_feet(robot, name)]
                for foot in (front, rear)]  # fmt: skip
        assert len(legs[0]) == 3
        hips = [bodies[leg[0]].position for leg in legs]
        for first, second in zip(*([bodies[name] for name in leg] for leg in legs), strict=True):
            assert second.mass == pytest.approx(first.mass, rel=1e-12)
            np.testing.assert_allclose(second.com - hips[1], first.com - hips[0], atol=1e-12)
            np.testing.assert_allclose(second.inertia, first.inertia, atol=1e-15)


# ------------------------------------------------------------------------------------- fixed base


def arrays(model: mujoco.MjModel) -> dict[str, np.ndarray]:
    names = (name for name in dir(model) if not name.startswith("_"))
    values = ((name, getattr(model, name)) for name in names)
    return {name: value.copy() for name, value in values if isinstance(value, np.ndarray)}


def compile_without(spec: mujoco.MjSpec, unwanted: Callable[[str], bool]) -> mujoco.MjModel:
    """Return the compiled model without those of free joint, floor and keyframe that are
    unwanted.
    """
    for kind, elements in (
        ("freejoint", [j for j in spec.joints if j.type == mujoco.mjtJoint.mjJNT_FREE]),
        ("floor", [g for g in spec.worldbody.geoms if g.type == mujoco.mjtGeom.mjGEOM_PLANE]),
        ("keyframe", list(spec.keys)),
    ):
        if unwanted(kind):
            assert len(elements) == 1, kind
            spec.delete(elements[0])
    spec.modelname = "same"
    return spec.compile()


def test_v3_files_differ_by_freejoint_floor_and_keyframe_alone() -> None:
    """Reference: all arrays of both compiled models without these elements."""
    free = mujoco.MjSpec.from_file(str(MJCF / "pupper_v3.xml"))
    fixed = mujoco.MjSpec.from_file(str(MJCF / "pupper_v3_fixed.xml"))
    assert {joint.name for joint in free.joints} - {joint.name for joint in fixed.joints} == {
        "world_to_body"
    }
    one = arrays(compile_without(free, lambda kind: True))
    two = arrays(compile_without(fixed, lambda kind: kind == "keyframe"))
    assert len(one) > 300
    assert one.keys() == two.keys()
    for name, value in one.items():
        np.testing.assert_array_equal(two[name], value, err_msg=name)


def test_fixed_base_has_the_joint_rows_of_the_free_robot() -> None:
    """Mass matrix and gravity of the free robot without the base rows."""
    free, fixed = load("v3"), load("v3", fixed_base=True)
    qpos = free.neutral()
    qpos[2], qpos[7:] = 0.13, np.linspace(-0.4, 0.4, 12)
    first, second = pa.Configuration(free, qpos), pa.Configuration(fixed, qpos[7:])
    np.testing.assert_allclose(second.mass_matrix(), first.mass_matrix()[6:, 6:], atol=1e-15)
    np.testing.assert_allclose(second.gravity(), first.gravity()[6:], atol=1e-15)
    np.testing.assert_allclose(second.center_of_mass(), first.center_of_mass(), atol=1e-15)
