"""Loading pairs of files: values taken from each file, computed once, and refusals with their
messages.
"""

import pickle
from dataclasses import FrozenInstanceError, replace
from pathlib import Path

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.robot import contact
from pupper_analysis.robot.terrain import build_on_ground
from tests.support.arm import arm
from tests.support.bodies import assert_same_bodies, mujoco_bodies, pinocchio_bodies
from tests.support.engines import evaluate_mujoco
from tests.support.tiny import TINY_MJCF, TINY_URDF, Files
from tests.support.variants import load


def write(folder: Path, urdf: str = TINY_URDF, mjcf: str = TINY_MJCF) -> Files:
    files = Files(folder / "robot.urdf", folder / "robot.xml")
    files.urdf.write_text(urdf)
    files.mjcf.write_text(mjcf)
    return files


def load_files(files: Files, feet: object = ("foot",), **more: object) -> pa.Robot:
    return pa.load_robot(*files, feet=feet, **more)  # type: ignore[arg-type]


def replace_text(text: str, old: str, new: str) -> str:
    assert old in text
    return text.replace(old, new)


# ------------------------------------------------------------------------------------- right


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["body", "geom"])
def test_contact_radius_of_a_foot_that_is_a_body_or_a_geom(tmp_path: Path, kind: str) -> None:
    site = '<site name="foot" pos="0 0 -0.1"/>'
    sphere = '<geom type="sphere" size="0.02" pos="0 0 -0.1"/>'
    mjcf = replace_text(TINY_MJCF, site, "")
    if kind == "geom":
        mjcf = replace_text(mjcf, sphere, sphere.replace("<geom", '<geom name="foot"'))
    else:
        body = (
            '<body name="foot" pos="0 0 -0.1"><geom type="sphere" size="0.02" mass="1e-9"/></body>'
        )
        mjcf = replace_text(mjcf, sphere, body)
    robot = load_files(write(tmp_path, mjcf=mjcf))
    assert robot.contact_radius["foot"] == 0.02


@pytest.mark.slow
def test_feet_are_named_by_a_list_or_a_mapping(tmp_path: Path) -> None:
    files = write(tmp_path)
    listed = load_files(files, feet=["foot"])
    assert listed.contact_points == ("foot",)
    renamed = load_files(files, feet={"left": "foot"}, name="other")
    assert renamed.contact_points == ("left",)
    assert dict(renamed.contact_radius) == {"left": 0.02}
    assert renamed.name == "other"


def test_variants_have_the_feet_efforts_and_home_of_their_files(
    robot: pa.Robot, variant: str
) -> None:
    """Reference: radii [m] and torque limits [N m] in the files of v3 and of the skeleton."""
    assert robot.name == variant
    assert robot.imu == "body_imu_site"
    assert robot.floating
    radius, effort = (0.01995, 3.0) if variant.startswith("v3") else (0.018, 18.0)
    assert set(robot.contact_radius.values()) == {radius}
    np.testing.assert_array_equal(robot.effort_limits, [effort] * 12)
    home = robot.home[7:]
    assert ((robot.lower_limits <= home) & (home <= robot.upper_limits)).all()


# ------------------------------------------------------------------------------------- wrong


TOE = 'size="0.02" pos="0 0'


@pytest.mark.parametrize(
    ("mjcf", "message"),
    [
        ("<mujoco/>", "robot.xml: .*joint"),
        (TINY_MJCF.replace('mass="0.5"', 'mass="-2"'), r"robot.xml:\d+: MuJoCo cannot compile"),
        (
            TINY_MJCF.replace(TOE, f'contype="0" conaffinity="0" {TOE}'),
            "no collision sphere|(can|cannot) touch the (ground|floor)",
        ),
    ],
)
@pytest.mark.parametrize("fixed_base", [False, True])
def test_unusable_files_are_refused(
    tmp_path: Path, mjcf: str, message: str, fixed_base: bool
) -> None:
    with pytest.raises(pa.ModelError, match=message) as caught:
        load_files(write(tmp_path, mjcf=mjcf), fixed_base=fixed_base)
    assert "\n" not in str(caught.value)
    assert str(tmp_path) in caught.value.source


@pytest.mark.slow
@pytest.mark.parametrize(("urdf_foot", "mjcf_foot"), [("toe_tip", "foot"), ("foot", "toe_tip")])
def test_foot_that_one_file_names_is_sufficient(
    tmp_path: Path, urdf_foot: str, mjcf_foot: str
) -> None:
    """Reference: the foot position [m] of the pair in which both files name the foot."""
    whole = load_files(write(tmp_path, TINY_URDF, TINY_MJCF))
    urdf = TINY_URDF.replace('link name="foot"', f'link name="{urdf_foot}"')
    urdf = urdf.replace('child link="foot"', f'child link="{urdf_foot}"')
    mjcf = TINY_MJCF.replace('site name="foot"', f'site name="{mjcf_foot}"')
    robot = load_files(write(tmp_path, urdf, mjcf))
    qpos = np.concatenate([[0.1, 0.2, 0.3, 1, 0, 0, 0], [0.1, -0.2, 0.3]])
    places = [pa.Configuration(model, qpos).foot_positions()["foot"] for model in (whole, robot)]
    np.testing.assert_allclose(*places, atol=1e-9)


# ------------------------------------------------------------------------------------- ground


def test_a_foot_on_a_low_step_touches_the_step_alone() -> None:
    """Without this, the foot would sink through the step onto the floor and be carried by both."""
    robot = load("v3")
    stand = pa.solve_stand(robot, pa.StandTask(ground=pa.Ground(heights={"RR": 0.001})))
    on_step = build_on_ground(robot, stand.task.ground, stand.foot_targets)
    qpos = stand.qpos.copy()
    qpos[2] -= 0.003
    data = evaluate_mujoco(on_step, qpos)
    touched = {
        on_step.foot_geoms[int(sole)]: on_step.mj_model.geom(int(other)).name
        for pair in data.contact.geom
        for sole, other in (pair, pair[::-1])
        if int(sole) in on_step.foot_geoms
    }
    assert len(data.contact.geom) == 4
    floor = robot.mj_model.geom(contact.ground_geom(robot.mj_model)).name
    assert touched == {"FR": floor, "FL": floor, "RR": "step_RR", "RL": floor}
    qpos[2] -= 0.12  # other parts still touch the floor
    bodies = contact.bodies_on_ground(
        on_step.mj_model, evaluate_mujoco(on_step, qpos), on_step.foot_geoms
    )
    assert "base_link" in bodies


def test_derived_values_are_computed_once_per_robot() -> None:
    """Reference: the number of calls. A changed copy and a pickled robot do not share the cache."""
    made = []

    def mass_and(robot: pa.Robot, more: float) -> float:
        made.append(robot)
        return robot.total_mass + more

    robot = pa.load_variant("v3")
    assert (
        robot.compute_once(mass_and, 1.0)
        == robot.compute_once(mass_and, 1.0)
        == robot.total_mass + 1.0
    )
    assert robot.compute_once(mass_and, 2.0) == robot.total_mass + 2.0
    assert made == [robot, robot]
    other = replace(robot, name="other")
    assert other.compute_once(mass_and, 1.0) == robot.total_mass + 1.0
    assert made == [robot, robot, other]
    assert not vars(pickle.loads(pickle.dumps(robot))).keys() & {"_cache"}


def test_fixed_base_has_no_default_height() -> None:
    """The home configuration of a fixed-base robot contains joint positions only."""
    assert replace(arm(), home=np.ones(4)).base_height == 0.0


@pytest.mark.parametrize("first", ["bend", "push"])
def test_fixed_base_is_at_the_pose_in_the_mjcf_for_either_joint_order(
    tmp_path: Path, first: str
) -> None:
    """Reference: positions and bias forces of MuJoCo. Joint ``bend`` is not at the base."""
    turned = replace_text(TINY_MJCF, 'pos="0 0 0.5"', 'pos="0.1 0.2 0.5" euler="0.3 -0.2 0.4"')
    if first == "push":
        motors = '<motor joint="push"/><motor joint="bend"/>'
        turned = replace_text(turned, '<motor joint="bend"/><motor joint="push"/>', motors)
    robot = load_files(write(tmp_path, mjcf=turned), fixed_base=True)
    assert robot.joint_names[0] == first
    joints = np.array([0.3, 0.1, -0.7])
    data = evaluate_mujoco(robot, joints)
    config = pa.Configuration(robot, joints)
    np.testing.assert_allclose(config.frame_position("foot"), data.site("foot").xpos, atol=1e-14)
    np.testing.assert_allclose(config.center_of_mass(), data.body("base").subtree_com, atol=1e-14)
    np.testing.assert_allclose(config.frame_position("base"), [0.1, 0.2, 0.5], atol=1e-15)
    gravity = data.qfrc_bias[robot.mj_convention.qvel_index]
    np.testing.assert_allclose(config.gravity(), gravity, atol=1e-13)


@pytest.mark.slow
def test_lowest_foot_touches_the_ground_at_the_stand_height(tiny: pa.Robot) -> None:
    qpos = tiny.neutral()
    qpos[2] = tiny.stand_height
    lowest = pa.Configuration(tiny, qpos).contact_points()["foot"]
    assert lowest[2] == pytest.approx(0, abs=1e-12)


# ------------------------------------------------------------------------------------- one robot


def test_sizes_and_mass_count_the_base_if_it_is_free(tiny: pa.Robot, tiny_files: Files) -> None:
    """By hand: three joints, a free joint with 7 positions and 6 velocities, and 3.2 kg in all."""
    assert (tiny.nq, tiny.nv, tiny.nu, tiny.floating) == (10, 9, 3, True)
    fixed = load_files(tiny_files, fixed_base=True)
    assert (fixed.nq, fixed.nv, fixed.nu, fixed.floating) == (3, 3, 3, False)
    assert fixed.total_mass == tiny.total_mass == pytest.approx(3.2)


@pytest.mark.slow
def test_base_without_free_joint_in_the_mjcf_is_fixed(tmp_path: Path) -> None:
    """By hand: three joint positions remain, and the note names the option that keeps the base.

    On a foot that the user names, the base stays free.
    """
    files = write(tmp_path, mjcf=replace_text(TINY_MJCF, "<freejoint/>", ""))
    robot = pa.load_robot(*files)
    assert not robot.floating
    assert robot.nq == 3
    assert any("the base stays fixed" in str(note) for note in robot.notes)
    assert load_files(files).floating


def test_bodies_of_both_engines_agree_if_joint_orders_differ(tiny: pa.Robot) -> None:
    """Pinocchio from the URDF against MuJoCo from the MJCF: masses [kg], CoMs [m], inertias
    [kg m^2] and frames.
    """
    assert_same_bodies(pinocchio_bodies(tiny), mujoco_bodies(tiny), 1e-12)


def test_mass_matrix_contains_the_armature_of_the_mjcf(tiny_files: Files) -> None:
    """References: 0.02 kg m^2 of joint ``bend`` and the default of 0.01 in the MJCF."""
    robots = [load_files(tiny_files, fixed_base=True) for _ in range(2)]
    robots[1].pin_model.armature = np.zeros(3)
    given, without = (pa.Configuration(robot, robot.neutral()).mass_matrix() for robot in robots)
    assert robots[0].joint_names == ("bend", "push", "turn")
    np.testing.assert_allclose(given - without, np.diag([0.02, 0.01, 0.01]), atol=1e-14)
    assert any("armature is taken from the MJCF" in str(note) for note in robots[0].notes)


def test_gravity_of_the_mjcf_is_that_of_the_robot(tmp_path: Path) -> None:
    """By hand: weight [N] of 0.4 kg on the vertical slide; torque [N m] of 0.1 m/s^2 on 0.3 kg,
    which hang 0.05 m below the hinge.
    """
    moon = replace_text(TINY_MJCF, "<default>", '<option gravity="0.1 0 -1.62"/><default>')
    robot = load_files(write(tmp_path, mjcf=moon), fixed_base=True)
    np.testing.assert_allclose(robot.gravity, [0.1, 0, -1.62])
    gravity = pa.Configuration(robot, robot.neutral()).gravity()
    np.testing.assert_allclose(gravity[:2], [0.3 * 0.1 * 0.05, 0.4 * 1.62], atol=1e-14)


@pytest.mark.slow
def test_ground_is_added_for_a_free_base_only(tmp_path: Path) -> None:
    """Reference: MuJoCo's default sliding friction, 1."""
    bare = replace_text(TINY_MJCF, '<geom type="plane" size="1 1 1"/>', "")
    robot = load_files(write(tmp_path, mjcf=bare), as_is=True)
    assert any("a plane with MuJoCo's default contact" in str(note) for note in robot.notes)
    assert robot.contacts["foot"].sliding_friction == 1.0
    fixed = load_files(write(tmp_path, mjcf=bare), fixed_base=True)
    assert fixed.contacts == {}
    assert not any("plane" in str(note) for note in fixed.notes)


PUSH = '<joint name="push" type="slide" axis="0 0 1" range="-0.3 0.4"/>'


@pytest.mark.parametrize(
    ("urdf", "mjcf", "expected"),
    [
        (
            TINY_URDF,
            replace_text(TINY_MJCF, PUSH, "").replace('<motor joint="push"/>', ""),
            "joints of the URDF alone are held at zero: push",
        ),
        (
            replace_text(TINY_URDF, '"push" type="prismatic"', '"push" type="fixed"'),
            TINY_MJCF,
            "joints of the MJCF alone are held at zero: push",
        ),
        (
            replace_text(TINY_URDF, 'name="push"', 'name="pull"'),
            TINY_MJCF,
            "joints with other names in the URDF: pull = push",
        ),
    ],
)
def test_joint_that_differs_between_the_files_is_in_a_note(
    tmp_path: Path, urdf: str, mjcf: str, expected: str
) -> None:
    """References: texts written by hand."""
    robot = load_files(write(tmp_path, urdf, mjcf), fixed_base=True)
    assert expected in [str(note) for note in robot.notes]


def test_robot_and_its_mappings_are_immutable() -> None:
    """Functions share derived values of a robot, which a change would falsify."""
    robot = load("v3")
    with pytest.raises(FrozenInstanceError):
        robot.name = "other"  # type: ignore[misc]
    with pytest.raises(TypeError):
        robot.contact_radius["FR"] = 1.0  # type: ignore[index]
    assert robot.check_foot("FR") == "FR"


def test_paths_of_both_files_may_be_strings(tiny_files: Files) -> None:
    urdf, mjcf = (str(path) for path in tiny_files)
    assert pa.load_robot(urdf=urdf, mjcf=mjcf, feet=["foot"], fixed_base=True).nu == 3


def test_missing_file_folder_and_binary_file_are_refused_by_path(
    tiny_files: Files, tmp_path: Path
) -> None:
    """Either file of a pair; the refusal begins with the path of the unusable file."""
    binary = tmp_path / "binary.urdf"
    binary.write_bytes(b"\xff\xfe\x00\x81")
    for wrong, reason in (
        (tmp_path / "none", "there is no such file"),
        (tmp_path, "the path is a folder"),
        (binary, "the file is encoded in UTF-16"),
    ):
        for files in (Files(wrong, tiny_files.mjcf), Files(tiny_files.urdf, wrong)):
            with pytest.raises(pa.ModelError) as caught:
                load_files(files)
            assert str(caught.value).startswith(f"{wrong}: {reason}")


def test_unknown_foot_is_refused_with_the_names_of_both_files(tmp_path: Path) -> None:
    """``toe_tip`` is a link of the URDF, and ``hoof`` a site of the MJCF."""
    urdf = replace_text(TINY_URDF, 'link name="foot"', 'link name="toe_tip"')
    urdf = replace_text(urdf, 'child link="foot"', 'child link="toe_tip"')
    mjcf = replace_text(TINY_MJCF, 'site name="foot"', 'site name="hoof"')
    with pytest.raises(pa.UnknownNameError, match=r"toe_tip.*hoof") as caught:
        load_files(write(tmp_path, urdf, mjcf))
    assert caught.value.name == "foot"
    assert isinstance(caught.value, pa.ModelError)
    with pytest.raises(pa.UnknownNameError, match="FR, FL, RR, RL") as other:
        load("v3").check_foot("left")
    assert (other.value.kind, other.value.name) == ("foot", "left")


@pytest.mark.parametrize("pickled", [False, True])
def test_shared_arrays_of_a_robot_are_read_only(pickled: bool) -> None:
    """`load_robot` shares robots: a change of `nominal` changed all later stands."""
    robot = load("v3")
    if pickled:
        robot = pickle.loads(pickle.dumps(robot))
    shared = {
        "home": robot.home,
        "nominal": robot.nominal,
        "position of a shape": robot.shapes[0].form.pose.position,
        "rotation of a shape": robot.shapes[0].form.pose.rotation,
        **vars(robot.mj_convention),
        **vars(robot.pin_convention),
    }
    arrays = {
        name: value
        for name, value in shared.items()
        if isinstance(value, np.ndarray) and not name.startswith("_")
    }
    assert {"home", "q_index", "qpos_index"} <= arrays.keys()
    for name, array in arrays.items():
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0
        assert not array.flags.writeable, name


def test_change_of_the_nominal_joints_does_not_change_later_stands() -> None:
    robot = load("v3")
    before = pa.solve_stand(robot).qpos
    with pytest.raises(ValueError, match="read-only"):
        robot.nominal[:] = 1.0
    np.testing.assert_array_equal(pa.solve_stand(robot).qpos, before)


@pytest.mark.parametrize("limit", ["5", "1e9", "1.7e308"])
def test_pinocchio_model_is_equal_after_pickling(tmp_path: Path, limit: str) -> None:
    """Pinocchio cannot read infinite numbers that it writes. Reference: `pin.Model.__eq__`."""
    text = replace_text(TINY_URDF, '<limit effort="5" velocity="9"/>', f'<limit effort="{limit}"/>')
    text = replace_text(text, f'effort="{limit}"', f'effort="{limit}" velocity="{limit}"')
    robot = load_files(write(tmp_path, text))
    model = robot.pin_model
    assert pickle.loads(pickle.dumps(model)) == model
    is_unknown = limit != "5"
    assert np.isinf(robot.velocity_limits).any() == is_unknown


def test_pinocchio_model_with_free_base_is_equal_after_pickling() -> None:
    model = load("v3").pin_model
    assert pickle.loads(pickle.dumps(model)) == model
    assert (model.effortLimit[:6] > 1e300).all()
