"""Robots of objects in memory (MjSpec, MjModel, URDF text, pin.Model), compared with the robot of
the file.
"""

from __future__ import annotations

import ast
from collections.abc import Callable
from pathlib import Path

import matplotlib.pyplot as plt
import mujoco
import numpy as np
import pinocchio as pin
import pytest
import trimesh
import yourdfpy

import pupper_analysis as pa
from pupper_analysis.models.mjcf import to_xml
from pupper_analysis.robot.joints import default_positions, joint_ranges
from tests.robots.test_real_robots import LAB, file
from tests.support.repository import ROOT
from tests.support.states import random_state

V3_MJCF = ROOT / "mjcf" / "pupper_v3.xml"
V3_URDF = ROOT / "urdf" / "pupper_v3.urdf"

ARM_MJCF = """
<mujoco model="arm">
  <worldbody>
    <body name="base">
      <geom type="box" size="0.1 0.1 0.05" mass="1"/>
      <body name="upper" pos="0 0 0.1">
        <joint name="shoulder" axis="0 1 0" range="-90 90"/>
        <geom type="capsule" fromto="0 0 0 0 0 0.3" size="0.03" mass="0.5"/>
        {more}
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def assert_equal_robots(robot: pa.Robot, expected: pa.Robot, *, atol: float = 1e-12) -> None:
    """Compare total mass, limits, and Pinocchio's mass matrices and gravity torques."""
    order = [robot.joint_names.index(name) for name in expected.joint_names]
    base = list(range(robot.nv - robot.nu))
    dofs = [*base, *(len(base) + index for index in order)]
    assert robot.total_mass == pytest.approx(expected.total_mass, abs=atol)
    np.testing.assert_allclose(robot.lower_limits[order], expected.lower_limits, atol=atol)
    np.testing.assert_allclose(robot.effort_limits[order], expected.effort_limits, atol=atol)
    np.testing.assert_allclose(robot.velocity_limits[order], expected.velocity_limits, atol=atol)
    for seed in range(3):
        qpos, _ = random_state(expected, seed)
        own = qpos.copy()
        own[robot.nq - robot.nu + np.array(order)] = qpos[robot.nq - robot.nu :]
        first, second = pa.Configuration(robot, own), pa.Configuration(expected, qpos)
        masses = first.mass_matrix()[np.ix_(dofs, dofs)], second.mass_matrix()
        np.testing.assert_allclose(*masses, atol=atol)
        np.testing.assert_allclose(first.bias_forces()[dofs], second.bias_forces(), atol=10 * atol)


def read_spec() -> mujoco.MjSpec:
    return mujoco.MjSpec.from_file(str(V3_MJCF))


@pytest.fixture(scope="module")
def from_mjcf() -> pa.Robot:
    return pa.load_robot(V3_MJCF)


@pytest.fixture(scope="module")
def from_urdf() -> pa.Robot:
    return pa.load_robot(V3_URDF)


def spec_with_assets() -> mujoco.MjSpec:
    """Return the spec of v3 with its meshes in memory, and without a folder."""
    spec = read_spec()
    folder = V3_MJCF.parent / spec.meshdir
    text, names = to_xml(spec), {mesh.file for mesh in spec.meshes}
    assets = {name: (folder / name).read_bytes() for name in names}
    return mujoco.MjSpec.from_string(text, assets=assets)


def compiled_spec() -> mujoco.MjSpec:
    spec = read_spec()
    spec.compile()
    return spec


@pytest.mark.slow
@pytest.mark.parametrize(
    "make",
    [
        read_spec,
        spec_with_assets,
        compiled_spec,
        lambda: mujoco.MjModel.from_xml_path(str(V3_MJCF)),
        lambda: mujoco.MjSpec.from_file(str(V3_MJCF)).compile(),
    ],
    ids=["spec", "spec with assets", "compiled spec", "model", "model of spec"],
)
def test_robot_of_mujoco_object_equals_robot_of_file(
    make: Callable[[], object], from_mjcf: pa.Robot
) -> None:
    """Total mass, limits, mass matrices and gravity torques in Pinocchio, and the nominal stand
    within 1e-6.
    """
    robot = pa.load_robot(make())
    assert_equal_robots(robot, from_mjcf)
    assert tuple(robot.feet) == tuple(from_mjcf.feet)
    expected = pa.solve_stand(from_mjcf)
    np.testing.assert_allclose(pa.solve_stand(robot).qpos, expected.qpos, atol=1e-6)
    [note] = [note for note in robot.notes if note.code == "model-in-memory"]
    assert "pupper_v3" in str(note)


@pytest.mark.slow
@pytest.mark.parametrize(
    "make",
    [
        V3_URDF.read_text,
        lambda: yourdfpy.URDF.load(str(V3_URDF), load_meshes=False, build_scene_graph=False),
    ],
    ids=["text", "yourdfpy"],
)
def test_robot_of_urdf_in_memory_equals_robot_of_file(
    make: Callable[[], object], from_urdf: pa.Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Total mass, limits, mass matrices and gravity torques in Pinocchio."""
    monkeypatch.chdir(ROOT / "urdf")
    robot = pa.load_robot(make())
    assert_equal_robots(robot, from_urdf)
    assert tuple(robot.feet) == tuple(from_urdf.feet)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["free flyer", "no free flyer", "wrapper"])
def test_robot_of_pinocchio_model_equals_robot_of_file(kind: str, from_urdf: pa.Robot) -> None:
    """Legs make the base free, as for a URDF, which has no free flyer either."""
    base = () if kind == "no free flyer" else (pin.JointModelFreeFlyer(),)
    model = pin.buildModelFromUrdf(str(V3_URDF), *base)
    shapes = pin.buildGeomFromUrdf(model, str(V3_URDF), pin.GeometryType.COLLISION)
    wrapper = pin.RobotWrapper(model, collision_model=shapes)
    robot = pa.load_robot(wrapper) if kind == "wrapper" else pa.load_robot(model, shapes)
    assert_equal_robots(robot, from_urdf)
    assert robot.floating
    assert len(robot.feet) == 4
    height = pa.solve_stand(from_urdf).qpos[2]
    assert pa.solve_stand(robot).qpos[2] == pytest.approx(height, abs=1e-6)


def test_armature_and_gravity_of_pinocchio_model_are_kept() -> None:
    """Reference: Pinocchio's ``rnea`` of the given model at five random states."""
    model = pin.buildSampleModelManipulator()
    model.armature = np.linspace(0.01, 0.06, model.nv)
    model.gravity.linear = np.array([0.5, 0.0, -3.0])
    robot = pa.load_robot(model)
    random = np.random.default_rng(0)
    for _ in range(5):
        qpos, qvel, qacc = random.uniform(-1, 1, (3, model.nv))
        q, v = robot.to_pinocchio(qpos, qvel)
        # The joints of the given model are in the order of the robot's Pinocchio model.
        assert list(robot.pin_model.names)[1:] == list(model.names)[1:]
        names = [robot.joint_names.index(name) for name in list(model.names)[1:]]
        expected = pin.rnea(model, model.createData(), qpos[names], qvel[names], qacc[names])
        own = robot.pin_model.copy()
        own.gravity = pin.Motion(robot.gravity, np.zeros(3))
        a = robot.accelerations_to_pinocchio(qpos, qvel, qacc)
        np.testing.assert_allclose(pin.rnea(own, own.createData(), q, v, a), expected, atol=1e-10)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("missing", [np.inf, 1.7976931348623157e308])
def test_a_single_limit_of_a_hinge_in_a_pinocchio_model_is_kept(missing: float, sign: int) -> None:
    """The limits of the given model are -0.5 rad and none, or none and 0.5 rad. The default
    position is zero: the middle of a range with one limit does not exist.
    """
    ends = sorted((-0.5 * sign, missing * sign))
    model = with_joint(pin.JointModelRY())
    model.lowerPositionLimit[:], model.upperPositionLimit[:] = ends
    robot = pa.load_robot(model)
    expected = np.array(sorted((-0.5 * sign, np.inf * sign)))[None]
    assert (robot.lower_limits, robot.upper_limits) == tuple(expected.T)
    np.testing.assert_array_equal(joint_ranges(robot), expected)
    assert default_positions(robot)[0] == 0.0
    limited = robot.mj_model.jnt_range[robot.mj_model.joint("odd").id]
    assert limited[(1 - sign) // 2] == -0.5 * sign
    assert not [note for note in robot.notes if note.code == "narrower-limits-kept"]


def make_box_shapes(model: pin.Model) -> pin.GeometryModel:
    """Return one shape of each kind, all on the last joint."""
    import coal

    shapes, frame = pin.GeometryModel(), model.nframes - 1
    mesh = coal.BVHModelOBBRSS()
    mesh.beginModel(4, 4)
    corners = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]], dtype=float)
    for face in ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)):
        mesh.addTriangle(*corners[list(face)])
    mesh.endModel()
    mesh.buildConvexHull(True, "Qt")
    for index, solid in enumerate(
        (
            coal.Sphere(0.1),
            coal.Box(0.1, 0.2, 0.3),
            coal.Capsule(0.1, 0.2),
            coal.Cylinder(0.1, 0.2),
            coal.Ellipsoid(0.1, 0.2, 0.3),
            mesh,
            mesh.convex,
        )
    ):
        parent = model.frames[frame].parentJoint
        place = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.01 * index]))
        shapes.addGeometryObject(pin.GeometryObject(f"s{index}", parent, frame, place, solid))
    return shapes


def test_each_kind_of_pinocchio_shape_is_loaded() -> None:
    """Geom types of MuJoCo's model: sphere, box, capsule, cylinder, and meshes for the remaining
    three.
    """
    model = pin.buildSampleModelManipulator()
    robot = pa.load_robot(model, make_box_shapes(model))
    kinds = [int(robot.mj_model.geom_type[shape.geom]) for shape in robot.shapes]
    types = mujoco.mjtGeom
    expected = [types.mjGEOM_SPHERE, types.mjGEOM_BOX, types.mjGEOM_CAPSULE]
    expected += [types.mjGEOM_CYLINDER, types.mjGEOM_MESH, types.mjGEOM_MESH, types.mjGEOM_MESH]
    assert sorted(kinds) == sorted(int(kind) for kind in expected)


@pytest.mark.slow
def test_objects_are_not_modified() -> None:
    """XML of the spec, masses of the model and Pinocchio's model are equal before and after
    loading.
    """
    spec, model = read_spec(), mujoco.MjModel.from_xml_path(str(V3_MJCF))
    pin_model = pin.buildSampleModelManipulator()
    text, masses, before = to_xml(spec), model.body_mass.copy(), pin_model.copy()
    for item in (spec, model, pin_model):
        pa.load_robot(item)
    assert to_xml(spec) == text
    np.testing.assert_array_equal(model.body_mass, masses)
    assert pin_model == before
    spec.compile()


def test_change_of_spec_after_loading_does_not_change_robot() -> None:
    spec = mujoco.MjSpec.from_string(ARM_MJCF.format(more=""))
    robot = pa.load_robot(spec)
    spec.bodies[2].add_geom(size=[0.1, 0, 0], mass=5.0)
    assert robot.mj_spec().compile().body_mass.sum() == pytest.approx(1.5)


def test_urdf_and_spec_of_one_robot_are_a_pair() -> None:
    robot = pa.load_robot(V3_URDF, read_spec())
    assert robot.description.converted == ""
    assert robot.description.urdf_source == V3_URDF


def test_xml_text_of_mjcf_is_loaded_with_fixed_base() -> None:
    robot = pa.load_robot("\n  " + ARM_MJCF.format(more=""))
    assert robot.joint_names == ("shoulder",)
    assert not robot.floating


@pytest.mark.slow
def test_spec_with_other_compiler_settings_attached_is_read_from_its_model() -> None:
    """MuJoCo cannot write such a spec. Reference: mass and mass matrix of MuJoCo's model."""
    spec = read_spec()
    arm = mujoco.MjSpec.from_string(ARM_MJCF.format(more=""))
    arm.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    spec.attach(arm, prefix="arm_", frame=spec.body("base_link").add_frame(pos=[0, 0, 0.1]))
    with pytest.raises(mujoco.FatalError):
        to_xml(spec)
    robot, model = pa.load_robot(spec), spec.copy().compile()
    assert robot.joint_names[-1] == "arm_shoulder"
    assert robot.total_mass == pytest.approx(model.body_mass.sum(), rel=1e-12)
    [note] = [note for note in robot.notes if note.code == "spec-read-compiled"]
    assert "inertiafromgeom" in str(note)
    broken = read_spec()
    broken.joints[1].range = (2.0, 1.0)
    with pytest.raises(pa.ModelError, match="range"):
        pa.load_robot(broken)


@pytest.mark.parametrize("mass", ['mass="0.4"', 'density="400"'])
def test_meshes_of_a_robot_that_is_attached_to_a_scene_are_read(mass: str, tmp_path: Path) -> None:
    """A scene, as of mjlab: MuJoCo's API does not return the folder of the attached meshes.

    Reference: MuJoCo's mass, and size of its mesh [m].
    """
    (tmp_path / "parts").mkdir()
    trimesh.creation.box((0.1, 0.2, 0.05)).export(tmp_path / "parts" / "box.stl")
    robot_file = tmp_path / "robot.xml"
    robot_file.write_text(f"""<mujoco><compiler meshdir="parts"/><asset><mesh name="box"
        file="box.stl"/></asset><worldbody><body name="base"><geom size="0.1" mass="1"/>
        <body name="arm"><joint name="turn" range="-90 90"/><geom type="mesh" mesh="box" {mass}/>
        </body></body></worldbody></mujoco>""")
    scene = mujoco.MjSpec()
    child = mujoco.MjSpec.from_file(str(robot_file))
    scene.attach(child, prefix="robot/", frame=scene.worldbody.add_frame())
    robot, model = pa.load_robot(scene, fixed_base=True), scene.copy().compile()
    assert robot.joint_names == ("robot/turn",)
    moving = robot.pin_model.inertias[1].mass
    assert moving == pytest.approx(model.body("robot/arm").mass[0], rel=1e-9)
    assert robot.mj_model.nmesh == 1
    np.testing.assert_allclose(np.ptp(robot.mj_model.mesh_vert, axis=0).max(), 0.2, atol=1e-6)
    (tmp_path / "parts" / "box.stl").unlink()
    with pytest.raises(pa.ModelError, match=r"box\.stl"):
        pa.load_robot(scene, fixed_base=True)


def test_unset_force_range_of_an_attached_servo_is_no_motor_without_torque() -> None:
    """MuJoCo writes the range as "0 0", since the default class of v3 limits the force, and applies
    no limit: ``actuator_forcelimited`` is False.
    """
    spec = read_spec()
    arm = mujoco.MjSpec.from_string(ARM_MJCF.format(more=""))
    arm.add_actuator(name="servo", target="shoulder", trntype=mujoco.mjtTrn.mjTRN_JOINT)
    arm.actuators[0].set_to_position(kp=10.0, kv=0.3)
    spec.attach(arm, prefix="arm_", frame=spec.body("base_link").add_frame(pos=[0, 0, 0.1]))
    assert 'forcerange="0 0"' in to_xml(spec)
    robot = pa.load_robot(spec)
    assert not robot.mj_model.actuator("arm_servo").forcelimited
    assert robot.effort_limits[robot.joint_names.index("arm_shoulder")] == np.inf
    assert robot.effort_limits[0] == pytest.approx(3.0)


def run_get_spec(package: Path) -> mujoco.MjSpec:
    """Run mjlab's own ``get_spec`` without importing mjlab, which needs torch."""
    [constants] = package.glob("*_constants.py")
    tree = ast.parse(constants.read_text())
    functions = [node for node in tree.body if isinstance(node, ast.FunctionDef)]
    body = [node for node in functions if node.name in ("get_spec", "get_assets")]
    names = {name.id for node in ast.walk(tree) if isinstance(name := node, ast.Name)}
    [xml] = [path for path in (package / "xmls").glob("*.xml") if path.stem in constants.stem]
    scope = {"mujoco": mujoco, **{name: xml for name in names if name.endswith("_XML")}}
    exec(compile(ast.Module(body, []), str(constants), "exec"), scope)
    spec: mujoco.MjSpec = scope["get_spec"]()
    return spec


@pytest.mark.slow
@pytest.mark.parametrize(("robot", "feet"), [("unitree_go1", 4), ("unitree_g1", 2)])
def test_mjlab_spec_is_solved_to_stand(robot: str, feet: int) -> None:
    """Reference: mass and number of degrees of freedom of MuJoCo's model of the same spec."""
    spec = run_get_spec(file(LAB, robot))
    loaded = pa.load_robot(spec)
    stand = pa.solve_stand(loaded)
    model = spec.copy().compile()
    assert loaded.total_mass == pytest.approx(model.body_mass.sum(), rel=1e-12)
    assert loaded.nv == model.nv
    assert len(loaded.feet) == feet
    assert stand.foot_error < 1e-9
    assert len(stand.ctrl) == loaded.mj_model.nu
    plt.switch_backend("agg")
    assert stand.plot()[0].get_title(loc="left").startswith("from the front, forces up to")
    plt.close("all")
    copy = pa.load_robot(model)
    np.testing.assert_allclose(pa.solve_stand(copy).qpos, stand.qpos, atol=1e-6)


def two_flyers() -> pin.Model:
    model = pin.Model()
    for name in ("first", "second"):
        joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), name)
        model.appendBodyToJoint(joint, pin.Inertia.Random(), pin.SE3.Identity())
    return model


def with_joint(kind: pin.JointModel) -> pin.Model:
    model = pin.Model()
    model.appendBodyToJoint(0, pin.Inertia.Random(), pin.SE3.Identity())
    joint = model.addJoint(0, kind, pin.SE3.Identity(), "odd")
    model.appendBodyToJoint(joint, pin.Inertia.Random(), pin.SE3.Identity())
    return model


def shapes_of_other_model() -> tuple[pin.Model, pin.GeometryModel]:
    model = pin.buildModelFromUrdf(str(V3_URDF))
    free = pin.buildModelFromUrdf(str(V3_URDF), pin.JointModelFreeFlyer())
    return model, pin.buildGeomFromUrdf(free, str(V3_URDF), pin.GeometryType.COLLISION)


@pytest.mark.parametrize("feet", [None, []])
def test_free_flyer_without_shapes_stays_free(feet: list[str] | None) -> None:
    """Without shapes there are no feet. Reference: Pinocchio's model of the same URDF: number of
    degrees of freedom, mass [kg] and gravity torques [N m] in the neutral configuration.
    """
    model = pin.buildModelFromUrdf(str(V3_URDF), pin.JointModelFreeFlyer())
    robot = pa.load_robot(model, feet=feet)
    assert robot.floating
    assert not robot.feet
    assert robot.pin_model.nv == robot.mj_model.nv == model.nv
    assert robot.total_mass == pytest.approx(pin.computeTotalMass(model), rel=1e-12)
    expected = pin.computeGeneralizedGravity(model, model.createData(), pin.neutral(model))
    found = pin.computeGeneralizedGravity(
        robot.pin_model, robot.pin_data(), pin.neutral(robot.pin_model)
    )
    np.testing.assert_allclose(found, expected, atol=1e-12)
    codes = [note.code for note in robot.notes]
    assert "base-kept-in-the-world" not in codes
    assert ("base-free-without-feet" in codes) == (feet is None)


def build_free_limbs(count: int) -> pin.Model:
    """Return a free base with limbs of two hinges, without shapes."""
    inertial = (
        '<inertial><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0"'
        ' iyz="0"/></inertial>'
    )
    parts = [f'<link name="base">{inertial}</link>']
    for limb in range(count):
        parent = "base"
        for number in range(2):
            name = f"limb{limb}_{number}"
            parts.append(
                f'<link name="{name}">{inertial}</link><joint name="{name}_joint" type="revolute">'
                f'<parent link="{parent}"/><child link="{name}"/><axis xyz="0 1 0"/>'
                f'<origin xyz="0.1 {0.1 * limb} -0.1"/>'
                '<limit lower="-1" upper="1" effort="50" velocity="9"/></joint>'
            )
            parent = name
    text = f'<robot name="limbs">{"".join(parts)}</robot>'
    return pin.buildModelFromXML(text, pin.JointModelFreeFlyer())


def test_free_flyer_of_a_serial_chain_stays_free() -> None:
    """Reference: Pinocchio's model of two hinges on a free flyer, with 6 + 2 degrees of freedom."""
    robot = pa.load_robot(build_free_limbs(1))
    assert robot.floating
    assert robot.pin_model.nv == robot.mj_model.nv == 8
    assert "base-free-without-feet" in [note.code for note in robot.notes]


def test_free_base_without_feet_holds_on_a_weld_with_added_servos() -> None:
    """Without weld, the refusal states why there are no feet, and what computes motor torques."""
    robot = pa.load_robot(build_free_limbs(2))
    task = pa.StandTask(contacts={"base": pa.Weld()})
    assert pa.verify_stand(robot, pa.solve_stand(robot, task)).passed
    with pytest.raises(pa.ConfigurationError, match=r"cannot stand: .*pa\.hold_posture"):
        pa.solve_stand(robot)


TWO_ROBOTS = ARM_MJCF.replace(
    "</worldbody>",
    """<body name="other"><body name="lower"><joint name="elbow"/><geom size="0.1"/></body></body>
    </worldbody>""",
)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: (3,), "is not a robot"),
        (lambda: (mujoco.MjSpec,), "is not a robot"),
        (lambda: (mujoco.MjSpec(),), "joint"),
        (lambda: ("<foo/>",), "<foo>"),
        (lambda: ("<mujoco><worldbody></mujoco>",), "XML"),
        (lambda: ("<mujoco><nonsense/></mujoco>",), "nonsense"),
        (lambda: (mujoco.MjSpec.from_string(TWO_ROBOTS.format(more="")),), "lower|other"),
        (lambda: (read_spec(), read_spec()), "one file"),
        (lambda: (pin.Model(),), "joint"),
        (lambda: (pin.RobotWrapper(pin.Model()),), "joint"),
        (lambda: (two_flyers(),), "first, second"),
        (lambda: (with_joint(pin.JointModelSpherical()),), "odd.*Spherical"),
        (lambda: (with_joint(pin.JointModelPlanar()),), "odd.*Planar"),
        (lambda: (with_joint(pin.JointModelPX()),), "odd.*limits"),
        (lambda: (pin.GeometryModel(),), "pin.Model"),
        (shapes_of_other_model, "another pin.Model"),
    ],
    ids=[
        *("number", "class", "empty spec", "root", "not closed", "unknown element", "two robots"),
        *(
            "two specs",
            "empty model",
            "empty wrapper",
            "two free flyers",
            "ball",
            "planar",
            "slide",
            "shapes alone",
        ),
        "shapes of another model",
    ],
)
def test_object_that_is_no_robot_is_refused_in_one_line(
    make: Callable[[], tuple[object, ...]], words: str
) -> None:
    with pytest.raises(pa.PupperAnalysisError, match=words) as error:
        pa.load_robot(*make())
    assert "\n" not in str(error.value)
