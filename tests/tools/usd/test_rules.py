"""Audit rules of USD: each fault is located at its prim."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("pxr", reason="usd-core is not installed")

from pxr import Usd, UsdGeom, UsdPhysics

import pupper_analysis as pa
from pupper_analysis.base.errors import ModelError
from pupper_analysis.tools.audit.audit import RULES, audit_model
from pupper_analysis.tools.usd.reader import CHECKS
from tests.support.commands import answer
from tests.tools.usd import written as usd

THIGH, SHANK, HIP, BASE = "/leg/base/thigh", "/leg/base/thigh/shank", "/leg/joints/hip", "/leg/base"

SLIPS = {
    "mass-of-water": (("float physics:mass = 2000\n", "\n"), BASE),
    "mass-unstated": (("float physics:mass = 500\n", "\n"), THIGH),
    "mass-not-positive": (("float physics:mass = 500\n", "float physics:mass = -500\n"), THIGH),
    "inertia-unstated": (("float3 physics:diagonalInertia = (20000, 19000, 2000)", ""), SHANK),
    "triangle-inequality": (("(30000, 26000, 5000)", "(30000, 2600, 5000)"), THIGH),
    "joint-numbers-contradict": (
        ("double mjc:damping = 1000000", "double mjc:damping = 1000000\n"
         "float newton:damping = 1000000"), HIP),
    "range-empty": (("lowerLimit = -30", "lowerLimit = 70"), HIP),
    "value-impossible": (("double mjc:damping = 1000000", "double mjc:damping = -1000000"), HIP),
}  # fmt: skip


@pytest.mark.parametrize("rule", SLIPS)
def test_usd_fault_is_found_at_its_prim(rule: str, tmp_path: Path) -> None:
    change, prim = SLIPS[rule]
    path = usd.write(tmp_path, change)
    found = [finding for finding in audit_model(path).findings if finding.rule == rule]
    assert [finding.prim for finding in found] == [prim]
    assert found[0].file == str(path)
    assert found[0].line is None


def test_an_unstated_com_is_not_at_the_origin(tmp_path: Path) -> None:
    """A converter left out a com of (0, 0, 0): then it is the shapes'."""
    path = usd.write(tmp_path, ("point3f physics:centerOfMass = (1, 2, 3)\n", "\n"))
    (found,) = (
        finding for finding in audit_model(path).findings if finding.rule == "inertia-unstated"
    )
    assert (found.prim, str(found.severity)) == (BASE, "warning")
    assert "missing: com" in str(found.diagnostic)


def test_missing_inertia_without_shapes_is_a_default_of_the_engine(tmp_path: Path) -> None:
    """Reference: UsdPhysics computes 2/5 m r^2 with r = 0.1 m for the same body."""
    path = usd.write(tmp_path, ("float3 physics:diagonalInertia = (30000, 26000, 5000)\n", "\n"))
    (found,) = (
        finding for finding in audit_model(path).findings if finding.rule == "inertia-unstated"
    )
    assert (found.prim, str(found.severity)) == (THIGH, "warning")
    message = str(found.diagnostic)
    assert "missing: inertia; there is no collision shape" in message
    assert "a ball of radius 10 cm" in message
    with pytest.raises(ModelError, match="there are no collision shapes"):
        pa.compare_models(usd.write_urdf(tmp_path), path, configurations=2)
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    body = stage.DefinePrim("/body", "Xform")
    UsdPhysics.MassAPI.Apply(body).CreateMassAttr(0.5)
    _, moments, com, _ = UsdPhysics.RigidBodyAPI.Apply(body).ComputeMassProperties(
        lambda _: UsdPhysics.RigidBodyAPI.MassInformation()
    )
    assert list(moments) == pytest.approx([0.4 * 0.5 * 0.1**2] * 3)
    assert list(com) == [0.0, 0.0, 0.0]


def test_every_rule_of_usd_has_a_test() -> None:
    usd_rules = {name for name, rule in RULES.items() if rule.formats == ("usd",)}
    assert usd_rules <= set(CHECKS)
    assert usd_rules <= set(SLIPS)


def test_radians_among_degrees_are_found(tmp_path: Path) -> None:
    path = usd.write(
        tmp_path,
        ("lowerLimit = -30", "lowerLimit = -0.5236"),
        ("upperLimit = 60", "upperLimit = 1.0472"),
        ("lowerLimit = -120", "lowerLimit = -2.0944"),
        ("upperLimit = -30", "upperLimit = -0.5236"),
        ("def PhysicsPrismaticJoint", "def PhysicsRevoluteJoint"),
    )
    assert "limits-in-wrong-unit" in {found.rule for found in audit_model(path).findings}


def test_the_command_shows_the_prim(tmp_path: Path) -> None:
    path = usd.write(tmp_path, SLIPS["mass-not-positive"][0])
    result = answer("audit", str(path))
    assert result.returncode == 1
    assert "leg.usda:</leg/base/thigh>" in result.stdout
    annotated = answer("audit", str(path), "--format", "github").stdout
    assert f"file={path}" in annotated
    assert "line=" not in annotated


def test_sound_usd_file_has_no_finding_of_usd_rules(tmp_path: Path) -> None:
    audit = audit_model(usd.write(tmp_path))
    assert audit.format == "usd"
    assert audit.passed
    assert not {found.rule for found in audit.findings} & set(SLIPS)


def test_xacro_arguments_of_a_usd_file_are_refused(tmp_path: Path) -> None:
    for options in ({}, {"xacro": True}):
        with pytest.raises(pa.ConfigurationError, match="xacro"):
            pa.audit_model(usd.write(tmp_path), xacro_args={"a": "b"}, **options)
