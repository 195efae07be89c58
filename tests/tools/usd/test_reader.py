"""A USD compared with a URDF: each difference is located at its prim, and missing values are not
zero.
"""

from __future__ import annotations

import math
import os
import shutil
import subprocess
from pathlib import Path

import pytest

pytest.importorskip("pxr", reason="usd-core is not installed")

from pupper_analysis.base.errors import ModelError
from pupper_analysis.models.spec_tree import SpecTree
from pupper_analysis.tools.crosscheck.crosscheck import Comparison, compare_models
from pupper_analysis.tools.usd.file import read_usd
from pupper_analysis.tools.usd.model import read_usd_model
from pupper_analysis.tools.usd.reader import make_mjspec
from tests.support.repository import ROOT
from tests.tools.usd import written as usd

CONVERTERS = ROOT / "build" / "converters" / "bin"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("converter", "folder"), [("urdf_usd_converter", "urdf"), ("mujoco_usd_converter", "mjcf")]
)
def test_converted_usd_agrees_with_its_source(converter: str, folder: str, tmp_path: Path) -> None:
    """Reference: the URDF or MJCF from which an independent converter made the USD.

    Skipped if the converter is not installed.
    """
    command = shutil.which(converter, path=f"{CONVERTERS}{os.pathsep}{os.environ['PATH']}")
    if command is None:
        pytest.skip(f"{converter} is not installed")
    urdf, mjcf = ROOT / "urdf/pupper_v3.urdf", ROOT / "mjcf/pupper_v3.xml"
    source = urdf if folder == "urdf" else mjcf
    subprocess.run([command, str(source), str(tmp_path / "made")], check=True, capture_output=True)
    (made,) = (tmp_path / "made").glob("*.usd*")
    for pair in ((urdf, made), (made, mjcf)):
        found = compare_models(*pair, configurations=2)
        assert found.agree, [str(difference.diagnostic) for difference in found.differences]


def compare_with_usd(
    folder: Path, *changes: tuple[str, str], after: str = "", **options: bool
) -> Comparison:
    path = usd.write(folder, *changes, after=after)
    urdf = usd.write_urdf(folder)
    return compare_models(urdf, path, configurations=2, **options)  # type: ignore[arg-type]


def test_every_convention_agrees(tmp_path: Path) -> None:
    """Residuals below 1e-12, and deviations below 1e-7 because of single precision."""
    found = compare_with_usd(tmp_path)
    assert found.agree
    assert found.joints == ("hip", "knee", "spring")
    assert max(found.residual.values()) < 1e-12
    assert max(found.deviations.values()) < 1e-7  # 572.9578 degrees


HIP, KNEE, SPRING = (f"/leg/joints/{name}" for name in ("hip", "knee", "spring"))
BASE, THIGH = "/leg/base", "/leg/base/thigh"

SLIPS = {
    "mass": (("mass = 2000\n", "mass = 2100\n"), "base", BASE),
    "com": (("centerOfMass = (0, 0, -10)", "centerOfMass = (0, 1, -10)"), "hip", THIGH),
    "inertia": (("(30000, 26000, 5000)", "(26000, 30000, 5000)"), "hip", THIGH),
    "lower limit": (("lowerLimit = -120", "lowerLimit = -110"), "knee", KNEE),
    "upper limit": (("upperLimit = 3\n", "upperLimit = 4\n"), "spring", SPRING),
    "effort": (("maxForce = 90000000", "maxForce = 80000000"), "knee", KNEE),
    "damping": (("newton:damping = 2000", "newton:damping = 3000"), "spring", SPRING),
    "friction": (("frictionloss = 500000", "frictionloss = 600000"), "knee", KNEE),
    "position": (("localPos0 = (10, 20, 0)", "localPos0 = (10, 21, 0)"), "hip", THIGH),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", SLIPS)
def test_changed_usd_number_is_found_at_its_prim(kind: str, tmp_path: Path) -> None:
    change, element, prim = SLIPS[kind]
    found = compare_with_usd(tmp_path, change)
    assert not found.agree
    (difference,) = found.differences
    assert (difference.kind, difference.element) == (kind, element)
    assert difference.mjcf_place == f"{tmp_path / 'leg.usda'}:<{prim}>"
    assert difference.urdf_place is not None
    assert found.complete
    assert found.explained == pytest.approx(1.0)


def test_a_turned_axis_is_found(tmp_path: Path) -> None:
    turned = (
        ("localRot0 = (0.70710677, 0, 0, 0.70710677)", "localRot0 = (0.6427876, 0, 0, 0.7660444)"),
        ("localRot1 = (0.70710677, 0, 0, 0.70710677)", "localRot1 = (0.6427876, 0, 0, 0.7660444)"),
    )
    kinds = {found.kind for found in compare_with_usd(tmp_path, *turned, after='"hip"').differences}
    assert kinds == {"axis"}


def test_a_gain_per_radian_is_57_times_too_large(tmp_path: Path) -> None:
    """Closed form: 180 / pi, since USD's gains are per degree."""
    found = compare_with_usd(tmp_path, ("double mjc:damping", "float newton:damping"))
    (difference,) = found.differences
    assert difference.kind == "damping"
    assert difference.mjcf == pytest.approx(0.1 * 57.29577951)


@pytest.mark.parametrize(
    "change",
    [("float physics:mass = 2000\n", "\n"), ("physics:centerOfMass = (1", "physics:velocity = (1")],
)
def test_usd_body_with_mass_from_shapes_is_refused(tmp_path: Path, change: tuple[str, str]) -> None:
    """A converter omitted the mass of a link without <inertial>: 2 kg became 30 kg."""
    for pair in ((usd.write_urdf(tmp_path), usd.write(tmp_path, change)),
                 (usd.write(tmp_path, change), usd.write(tmp_path, name="old.usda"))):  # fmt: skip
        with pytest.raises(
            ModelError, match=r"leg\.usda:</leg/base>: the mass of base follows from the shapes"
        ):
            compare_models(*pair, configurations=2)


def test_unread_usd_actuators_give_a_note(tmp_path: Path) -> None:
    motor = 'def MjcActuator "motor"\n{\n}\ndef PhysicsFixedJoint "ankle"'
    found = compare_with_usd(tmp_path, ('def PhysicsFixedJoint "ankle"', motor))
    (note,) = (note for note in found.notes if note.code == "usd-actuators-not-read")
    assert note.values["count"] == 1


def test_values_missing_in_the_usd_are_no_difference(tmp_path: Path) -> None:
    """Missing numbers are not zero; they are a difference only with ``strict_names``."""
    changes = (
        ("float drive:angular:physics:maxForce = 120000000\n", ""),
        ("float newton:friction = 500000\n", ""),
        ("double mjc:damping = 1000000\n", ""),
    )
    found = compare_with_usd(tmp_path, *changes)
    assert found.agree
    values = {
        str(note.values["what"]): list(note.values["joints"])
        for note in found.notes
        if note.code == "unknown-taken-from-urdf"
    }
    assert values == {"effort": ["hip"], "damping": ["hip"], "friction": ["hip"]}
    strict = compare_with_usd(tmp_path, *changes, strict_names=True)
    assert {difference.kind for difference in strict.differences} == {
        "effort",
        "damping",
        "friction",
    }


def test_invalid_inertia_of_a_fixed_part_is_a_difference(tmp_path: Path) -> None:
    """The inertia of a part fixed to another body is invalid by itself; the sum of both parts is
    compared."""
    thin = "float3 physics:diagonalInertia = (0, 0, 200)"
    found = compare_with_usd(tmp_path, ("float3 physics:diagonalInertia = (200, 200, 200)", thin))
    assert {(difference.kind, difference.element) for difference in found.differences} == {
        ("inertia", "spring")
    }


def test_a_joint_that_closes_a_loop_is_a_difference(tmp_path: Path) -> None:
    loop = """def PhysicsSphericalJoint "rope"
        {
            rel physics:body0 = </leg/base>
            rel physics:body1 = </leg/base/thigh/shank>
            bool physics:excludeFromArticulation = 1
            point3f physics:localPos0 = (10, 20, -25)
            point3f physics:localPos1 = (0, 0, 0)
        }

        def PhysicsFixedJoint "ankle\""""
    found = compare_with_usd(tmp_path, ('def PhysicsFixedJoint "ankle"', loop))
    assert not found.agree
    assert {difference.kind for difference in found.differences} == {"equality"}


def test_a_joint_of_several_axes_is_refused(tmp_path: Path) -> None:
    free = ('def PhysicsFixedJoint "ankle"', 'def PhysicsJoint "ankle"')
    with pytest.raises(ModelError, match="ankle"):
        compare_with_usd(tmp_path, free)


def test_inertia_of_a_plate_in_single_precision_is_accepted(tmp_path: Path) -> None:
    urdf = usd.write_urdf(tmp_path, ('iyy="0.01" izz="0.025"', 'iyy="0.01" izz="0.03"'))
    path = usd.write(tmp_path, ("200000, 250000)", "200000, 300000.01)"))
    assert compare_models(urdf, path, configurations=2).agree


def test_invalid_usd_inertia_is_refused_at_its_prim(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"leg\.usda:</leg/base/thigh/shank>"):
        compare_with_usd(tmp_path, ("(20000, 19000, 2000)", "(20000, 10000, 2000)"))


def test_a_range_from_0_to_0_is_a_difference(tmp_path: Path) -> None:
    """A converter wrote 0 to 0, which locks the joint, for a URDF without a range."""
    zero = (("lowerLimit = -30", "lowerLimit = 0"), ("upperLimit = 60", "upperLimit = 0"))
    kinds = {difference.kind for difference in compare_with_usd(tmp_path, *zero).differences}
    assert kinds == {"lower limit", "upper limit"}


def test_usd_can_replace_urdf_or_mjcf_in_a_comparison(tmp_path: Path) -> None:
    """Two independent writers make the URDF and the MJCF of the USD."""
    old = usd.write(tmp_path, name="old.usda")
    assert compare_models(old, usd.write(tmp_path), configurations=2).agree
    change = ("centerOfMass = (0, 0, -10)", "centerOfMass = (0, 1, -10)")
    found = compare_models(old, usd.write(tmp_path, change), configurations=2)
    (difference,) = found.differences
    assert (difference.kind, difference.element) == ("com", "hip")
    assert difference.urdf_place == f"{old}:<{THIGH}>"
    assert difference.mjcf_place == f"{tmp_path / 'leg.usda'}:<{THIGH}>"
    assert difference.urdf == pytest.approx((0, 0, -0.1))
    assert "in the USD" in difference.message


def test_frames_of_urdf_links_are_at_their_joints(tmp_path: Path) -> None:
    """A joint may be anywhere on a body of a USD; in a URDF, it is the origin of the link."""
    moved = (
        ("localPos0 = (10, 20, 0)", "localPos0 = (10, 20, -3)"),
        ("localPos1 = (0, 0, 0)", "localPos1 = (0, 0, -3)"),
    )
    old = usd.write(tmp_path, *moved, name="old.usda", after='"hip"')
    found = compare_models(old, usd.write(tmp_path, *moved, after='"hip"'), configurations=2)
    assert found.agree
    assert max(found.deviations.values()) < 1e-9


def test_usd_base_on_a_prismatic_joint_keeps_the_joint(tmp_path: Path) -> None:
    """A cart on a rail: the world is the first link."""
    rail = """def PhysicsPrismaticJoint "rail"
        {
            rel physics:body1 = </leg/base>
            uniform token physics:axis = "X"
            point3f physics:localPos0 = (0, 40, 0)
            quatf physics:localRot0 = (0.70710677, -0.70710677, 0, 0)
            float physics:lowerLimit = -100
            float physics:upperLimit = 100
        }

        def PhysicsFixedJoint "ankle\""""
    cart = usd.write(tmp_path, ('def PhysicsFixedJoint "ankle"', rail), name="cart.usda")
    found = compare_models(cart, cart, configurations=2)
    assert found.agree
    assert found.joints == ("rail", "hip", "knee", "spring")


def mjcf_of(path: Path, kp: float, kd: float) -> Path:
    """Write the MJCF of a USD, with a servo at its hip."""
    spec = make_mjspec(read_usd_model(read_usd(path)))
    SpecTree(spec).add_position_servo("hip", kp, kd)
    spec.compile()
    file = path.with_suffix(".xml")
    file.write_text(spec.to_xml())
    return file


KP, KD = 0.5 * 180 / math.pi, 0.005 * 180 / math.pi
"""Gains of the USD [N m/rad, N m s/rad]; the file states them per degree, in g and cm."""


@pytest.mark.parametrize(
    ("kp", "kd", "kinds"),
    [
        (KP, KD, []),
        (1.1 * KP, KD, ["servo stiffness"]),
        (0.5, 0.005, ["servo stiffness", "servo damping"]),
    ],
)
def test_gains_of_a_drive_are_compared_per_radian(
    tmp_path: Path, kp: float, kd: float, kinds: list[str]
) -> None:
    made = usd.write(tmp_path)
    found = compare_models(made, mjcf_of(made, kp, kd), configurations=2)
    assert [difference.kind for difference in found.differences] == kinds
    assert found.agree == (not kinds)
    for one, stated in zip(found.differences, (KP, KD), strict=False):
        assert (one.element, one.urdf) == ("hip", pytest.approx(stated, rel=1e-6))
        assert one.urdf_place == f"{made}:<{HIP}>"
        assert one.mjcf_place is not None
        assert ".xml:" in one.mjcf_place
        assert ("degrees" in one.message) == (kp == 0.5)


def test_gains_of_two_usds_are_compared(tmp_path: Path) -> None:
    old = usd.write(tmp_path, name="old.usda")
    new = usd.write(tmp_path, ("stiffness = 5000000", "stiffness = 6000000"))
    (found,) = compare_models(old, new, configurations=2).differences
    assert (found.kind, found.element) == ("servo stiffness", "hip")
    assert found.mjcf == pytest.approx(1.2 * KP)
