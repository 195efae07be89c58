"""Variants: masses, centres of mass and feet in closed form, and refusals of invalid
specifications.
"""

import math
import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import pupper_analysis as pa
from pupper_analysis.base.runs import ensure_run
from pupper_analysis.pupper import variant_files
from pupper_analysis.pupper.variants import find_model_folder
from tests.support.engines import evaluate_mujoco
from tests.support.variants import NAMES


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
        with pytest.raises(pa.OutputError, match="which this run reads"):
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
