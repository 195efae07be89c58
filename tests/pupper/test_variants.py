"""Variants: masses, centres of mass and feet in closed form, and refusals of invalid
specifications.
"""

import math
import re
import shutil
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import pupper_analysis as pa
from pupper_analysis.base.runs import ensure_run
from pupper_analysis.pupper import variant_files
from pupper_analysis.pupper.variants import find_model_folder
from tests.support.bodies import BODIES
from tests.support.engines import evaluate_mujoco
from tests.support.variants import NAMES, load


@pytest.mark.slow
@settings(max_examples=15)
@given(s=st.floats(0.3, 3), t=st.floats(0.2, 5))
def test_skeleton_mass_com_and_feet_in_closed_form(s: float, t: float) -> None:
    """Point masses of torso, hips, thighs, calves and feet; the CoM [m] in both engines."""
    robot = pa.load_variant(pa.pupper.VariantSpec("skeleton", s, t))
    config = pa.Configuration(robot, robot.neutral())
    torso, hips, thighs, calves, feet = 1.506 * t, 4 * 0.045, 4 * 0.186 * s, 4 * 0.05 * s, 4 * 0.02
    total = torso + hips + thighs + calves + feet
    drop = thighs * 0.04 * s + calves * (0.08 + 0.055) * s + feet * 0.19 * s
    com = [torso * 0.01 / total, 0, (torso * 0.02 - drop) / total]
    assert robot.total_mass == pytest.approx(total, rel=1e-12)
    np.testing.assert_allclose(config.center_of_mass(), com, atol=1e-12)
    np.testing.assert_allclose(
        evaluate_mujoco(robot, robot.neutral()).body("base_link").subtree_com, com, atol=1e-12
    )
    np.testing.assert_allclose(
        config.foot_positions()["FL"], [0.075, 0.0835, -0.19 * s], atol=1e-12
    )


@pytest.mark.slow
@settings(max_examples=15)
@given(s=st.floats(0.3, 3), t=st.floats(0.2, 5))
def test_v3_mass_com_and_feet_in_closed_form(s: float, t: float) -> None:
    """Thigh and calf are stretched in the plane of the leg; the sideways offset stays."""
    robot = pa.load_variant(pa.pupper.VariantSpec("v3", s, t))
    config = pa.Configuration(robot, robot.neutral())
    total = 1.506 * t + 4 * (0.18 + (0.186 + 0.05) * s)
    assert robot.total_mass == pytest.approx(total, rel=1e-12)
    hip = np.array([0.075, -0.0835, 0])
    foot = np.array([0.06881, -0.1015, -0.11156]) - hip
    expected = hip + foot * [s, 1, s]  # the leg is in a plane of constant y, 0.018 m outside
    np.testing.assert_allclose(config.foot_positions()["FR"], expected, atol=1e-9)
    site = evaluate_mujoco(robot, robot.neutral()).site("leg_front_r_3_foot_site")
    np.testing.assert_allclose(site.xpos, expected, atol=1e-9)


# ------------------------------------------------------------------------------------- refused


@pytest.mark.parametrize("name", [None, 3, 1.5, ["v3"], {"v3": 1}])
def test_name_of_another_type_is_refused_with_the_valid_names(name: object) -> None:
    with pytest.raises(pa.VariantError, match="known variants"):
        pa.load_variant(name)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["", "Original", "long_leg", "v4"])
def test_unknown_variant_is_refused_with_the_valid_names(name: str) -> None:
    with pytest.raises(pa.VariantError) as caught:
        pa.load_variant(name)
    assert repr(name) in str(caught.value)
    assert all(known in str(caught.value) for known in NAMES)
    assert (caught.value.field, caught.value.value) == ("name", name)


@pytest.mark.parametrize("field", ["leg_scale", "torso_mass_scale"])
@pytest.mark.parametrize(
    "value", [math.nan, math.inf, -math.inf, 0, 0.0, -1.5, "1.5", True, None, [1.5], 1j]
)
def test_invalid_scale_is_refused_by_field(field: str, value: object) -> None:
    with pytest.raises(pa.VariantError, match=r"finite number greater than 0") as caught:
        pa.pupper.VariantSpec("v3", **{field: value})  # type: ignore[arg-type]
    assert field in str(caught.value)
    assert repr(value) in str(caught.value)
    assert caught.value.field == field
    assert isinstance(caught.value, pa.PupperAnalysisError)


@pytest.mark.parametrize("base", ["", "original", "pupper", None, 3, ["v3"]])
def test_unknown_base_is_refused_with_the_valid_names(base: object) -> None:
    with pytest.raises(pa.VariantError, match="skeleton, v3") as caught:
        pa.pupper.VariantSpec(base)  # type: ignore[arg-type]
    assert repr(base) in str(caught.value)
    assert caught.value.field == "base"


def test_variant_without_name_is_named_after_its_values() -> None:
    assert pa.pupper.VariantSpec("v3", 1.2, 2.0).name == "v3-leg1.2-torso2"
    assert pa.pupper.VariantSpec("v3", 1.2, name="mine").name == "mine"
    assert pa.load_variant(pa.pupper.VariantSpec("v3", 1.2, name="mine")).name == "mine"


# ------------------------------------------------------------------------------------- specs


def test_files_read_for_a_variant_are_recorded_in_each_run() -> None:
    """Also in the second run, which uses the cached base model.

    No output may replace such a file.
    """
    for _ in range(2):
        with ensure_run() as run:
            pa.load_variant("v3-heavy")
        meshes = {f"{name}.stl" for name in ("calf", "hip", "thigh", "torso")}
        parts = {"pupper_v3.xml", "pupper_v3_body.xml", "pupper_v3_shared.xml"}
        names = {Path(name).name for name in run.inputs.values()}
        assert names == {"pupper_v3.urdf", *parts, *meshes}
        with pytest.raises(pa.OutputError, match="an input of this run"):
            run.register_output(find_model_folder("mjcf") / "pupper_v3_body.xml")


def test_missing_base_urdf_of_a_variant_is_a_model_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for kind in ("urdf", "mjcf"):
        shutil.copytree(find_model_folder(kind), tmp_path / kind)
    monkeypatch.setattr(variant_files, "find_model_folder", lambda kind: tmp_path / kind)
    (tmp_path / "urdf" / "pupper_v3.urdf").unlink()
    with pytest.raises(pa.ModelError, match=r"pupper_v3\.urdf: there is no such file"):
        pa.load_variant("v3-heavy")


@pytest.mark.parametrize(
    ("kind", "file", "pattern", "new", "told"),
    [
        ("urdf", "pupper_v3.urdf", "(?s).*", "", "the file is empty"),
        ("urdf", "pupper_v3.urdf", "(?s)(.{3000}).*", r"\1", "not well-formed XML"),
        ("urdf", "pupper_v3.urdf", 'value="0.05"', 'value="nan"', "not a finite number"),
        ("urdf", "pupper_v3.urdf", "<limit[^>]*/>", "", "revolute without a <limit>"),
        ("urdf", "pupper_v3.urdf", "leg_back_r_3_foot_site", "x", "no link .for a foot."),
        ("urdf", "pupper_v3.urdf", "(?s)<inertial>.*?</inertial>", "", "no variant can be derived"),
        ("mjcf", "pupper_v3_body.xml", "leg_back_r_3_foot_site", "x", "no site .for a foot."),
        ("mjcf", "pupper_v3_body.xml", "(?s)(.{1500}).*", r"\1", "not well-formed XML"),
    ],
)
def test_damaged_base_file_of_a_variant_is_a_model_error_with_the_file(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    kind: str,
    file: str,
    pattern: str,
    new: str,
    told: str,
) -> None:
    for folder in ("urdf", "mjcf"):
        shutil.copytree(find_model_folder(folder), tmp_path / folder)
    monkeypatch.setattr(variant_files, "find_model_folder", lambda folder: tmp_path / folder)
    damaged = tmp_path / kind / file
    damaged.write_text(re.sub(pattern, new, damaged.read_text(), count=0))
    with pytest.raises(pa.ModelError, match=told) as raised:
        pa.load_variant("v3-heavy")
    assert str(tmp_path / kind) in str(raised.value)


@pytest.mark.parametrize("as_folder", [False, True])
def test_missing_mesh_of_a_variant_is_an_error_and_nothing_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, as_folder: bool
) -> None:
    for kind in ("urdf", "mjcf"):
        shutil.copytree(find_model_folder(kind), tmp_path / kind)
    monkeypatch.setattr(variant_files, "find_model_folder", lambda kind: tmp_path / kind)
    mesh = tmp_path / "mjcf" / "meshes" / "calf.stl"
    mesh.unlink()
    if as_folder:
        mesh.mkdir()
    output = tmp_path / "output"
    with pytest.raises(pa.ModelError, match=r"calf\.stl: "):
        pa.pupper.write_variant("v3-heavy", output)
    assert not output.exists()


def test_xml_name_that_is_too_long_is_a_model_error() -> None:
    with pytest.raises(pa.ModelError, match="cannot be read"):
        pa.load_robot(f"{'a' * 300}.xml")
    words = [f"{'a' * 300}.xml"]
    assert variant_files.parse_robot_words(words) == [tuple(words)]


@pytest.mark.parametrize(
    ("words", "robots"),
    [
        ("a.urdf b.urdf a.urdf a.xml", [("a.urdf",), ("b.urdf",), ("a.urdf", "a.xml")]),
        ("a.urdf v3 a.urdf a.xml", [("a.urdf",), "v3", ("a.urdf", "a.xml")]),
        ("a.urdf a.urdf a.xml a.xml", [("a.urdf", "a.xml")]),
        ("a.urdf a.xml a.urdf a.xml", [("a.urdf", "a.xml")]),
        ("a.xml a.urdf a.urdf", [("a.xml", "a.urdf")]),
        ("v3 a.urdf v3 b.xml", ["v3", ("a.urdf",), ("b.xml",)]),
    ],
)
def test_mjcf_belongs_to_the_urdf_before_it_if_files_are_repeated(
    words: str, robots: list[str | tuple[str, ...]]
) -> None:
    assert variant_files.parse_robot_words(words.split()) == robots


# ------------------------------------------------------------------------------------- named

MASSES = {
    "original": 2.710,
    "long-leg": 3.182,
    "heavy": 4.216,
    "v3": 3.170,
    "v3-long-leg": 3.642,
    "v3-heavy": 4.676,
}
"""{variant: total mass [kg]}."""


def test_named_variants_have_their_masses_and_sizes() -> None:
    """References by hand: ``MASSES``; a free base with 12 joints."""
    assert tuple(MASSES) == NAMES
    for name, mass in MASSES.items():
        spec, robot = pa.VARIANTS[name], load(name)
        assert spec.name == name
        assert spec == pa.pupper.VariantSpec(spec.base, spec.leg_scale, spec.torso_mass_scale)
        assert robot.total_mass == pytest.approx(mass, abs=1e-12)
        assert (robot.nq, robot.nv, robot.nu) == (19, 18, 12)
        assert (robot.mj_model.nq, robot.mj_model.nv, robot.mj_model.nu) == (19, 18, 12)
        assert (robot.pin_model.nq, robot.pin_model.nv) == (19, 18)


def test_named_variants_cannot_be_changed() -> None:
    with pytest.raises(TypeError):
        pa.VARIANTS["v3"] = pa.VARIANTS["original"]  # type: ignore[index]
    with pytest.raises(AttributeError):
        pa.VARIANTS["v3"].leg_scale = 2.0  # type: ignore[misc]


@pytest.mark.parametrize("number", [np.float64(1.5), np.float32(1.5), np.int64(2), 2])
def test_numbers_of_numpy_are_accepted_as_scales(number: float) -> None:
    """Closed form: legs of 0.944 kg at scale 1."""
    spec = pa.pupper.VariantSpec("skeleton", leg_scale=number)
    assert pa.load_variant(spec).total_mass == pytest.approx(2.710 + (number - 1) * 0.944)


KNEES = {"original": ("FL_HFE", "FL_KFE"), "v3": ("leg_front_l_2", "leg_front_l_3")}


@pytest.mark.parametrize("source", BODIES)
@pytest.mark.parametrize("base", KNEES)
def test_thigh_of_long_legs_is_1_5_times_as_long(base: str, source: str) -> None:
    """Distance from the hip to the knee, in both engines."""
    lengths = []
    for name in (base, "long-leg" if base == "original" else "v3-long-leg"):
        bodies = BODIES[source](load(name))
        hip, knee = (bodies[joint].position for joint in KNEES[base])
        lengths.append(float(np.linalg.norm(knee - hip)))
    assert lengths[1] / lengths[0] == pytest.approx(1.5, abs=1e-12)


def test_thigh_capsules_end_at_the_knee() -> None:
    """References: 0.08 m and 0.12 m, and the position of the calf in the thigh's frame."""
    lengths = []
    for name in ("original", "long-leg"):
        model = load(name).mj_model
        for leg in ("FL", "FR", "RL", "RR"):
            geom = int(model.body(f"{leg}_thigh").geomadr[0])
            assert model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CAPSULE.value
            lengths.append(2 * model.geom_size[geom, 1])
            knee = np.linalg.norm(model.body(f"{leg}_calf").pos)
            assert lengths[-1] == pytest.approx(knee, rel=1e-12)
    np.testing.assert_allclose(lengths, [0.08] * 4 + [0.12] * 4, rtol=1e-12)
