"""The model files of Pupper: their values, and equality of the files."""

from collections.abc import Callable

import mujoco
import numpy as np
import pytest
from hypothesis import given
from scipy.spatial.transform import Rotation

import pupper_analysis as pa
from tests.support.engines import evaluate_mujoco
from tests.support.repository import ROOT
from tests.support.states import numbers
from tests.support.variants import BASES, load

MJCF = ROOT / "mjcf"


@pytest.fixture(scope="module", params=BASES)
def base(request: pytest.FixtureRequest) -> str:
    """The unscaled variant of each pair of files."""
    return str(request.param)


def compile_model(file: str) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(MJCF / file))


# ------------------------------------------------------------------------------------- numbers


def test_feet_and_com_of_v3_at_zero_angles() -> None:
    """The skeleton's are closed forms: ``test_variants.py``."""
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
    one, two = pa.Configuration(free, qpos), pa.Configuration(fixed, qpos[7:])
    np.testing.assert_allclose(two.mass_matrix(), one.mass_matrix()[6:, 6:], atol=1e-15)
    np.testing.assert_allclose(two.gravity(), one.gravity()[6:], atol=1e-15)
    np.testing.assert_allclose(two.center_of_mass(), one.center_of_mass(), atol=1e-15)
