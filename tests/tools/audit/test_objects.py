"""Audits of robots in memory: the rules of the file, and findings without lines."""

from __future__ import annotations

import mujoco
import pytest

import pupper_analysis as pa
from pupper_analysis.base.errors import ModelError
from tests.support.repository import ROOT

URDF, MJCF = ROOT / "urdf" / "pupper_v3.urdf", ROOT / "mjcf" / "pupper_v3.xml"


@pytest.mark.slow
def test_spec_is_audited_by_all_rules_of_its_file_without_lines() -> None:
    """A negative damping in the spec is found."""
    spec = mujoco.MjSpec.from_file(str(MJCF))
    spec.joint("leg_front_r_1").damping = [-1.0, 0.0, 0.0]
    audit = pa.audit_model(spec)
    assert audit.rules_run == pa.audit_model(MJCF).rules_run
    assert not audit.passed
    assert "MjSpec" in audit.file
    assert {finding.line for finding in audit.findings} == {None}
    assert any("leg_front_r_1" in str(finding.message) for finding in audit.findings)


def test_text_of_a_urdf_is_audited_without_lines() -> None:
    """The meshes of a text without folder are missing."""
    audit = pa.audit_model(URDF.read_text())
    assert [finding.rule for finding in audit.findings] == ["mesh-missing"]
    assert audit.findings[0].line is None


@pytest.mark.slow
def test_robots_in_memory_are_compared_like_their_files() -> None:
    """A mass that is 10 % larger in the spec is a difference."""
    spec = mujoco.MjSpec.from_file(str(MJCF))
    assert pa.compare_models(URDF.read_text(), spec, configurations=2).agree
    spec.body("leg_front_r_3").mass *= 1.1
    comparison = pa.compare_models(URDF, spec, configurations=2)
    assert not comparison.agree
    assert any("leg_front_r_3" in str(found.message) for found in comparison.differences)


@pytest.mark.parametrize(("urdf", "mjcf"), [(MJCF, MJCF), (URDF, URDF)])
def test_object_of_the_other_format_is_refused(urdf: object, mjcf: object) -> None:
    first = mujoco.MjSpec.from_file(str(MJCF)) if urdf is MJCF else URDF
    second = URDF.read_text() if mjcf is URDF else MJCF
    with pytest.raises(ModelError, match="this robot in memory is not of format") as caught:
        pa.compare_models(first, second)
    assert "\n" not in str(caught.value)


def test_other_objects_are_refused_with_the_accepted_types() -> None:
    with pytest.raises(pa.ConfigurationError, match="MjSpec"):
        pa.audit_model(3)  # type: ignore[arg-type]
