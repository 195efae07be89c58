"""Repairs of findings: planted faults are replaced by the original number, and all other bytes are
unchanged.
"""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from click.testing import CliRunner

from pupper_analysis.cli import group
from pupper_analysis.tools.audit.audit import Audit, audit_model
from pupper_analysis.tools.audit.fix import apply_repairs, write_documents
from tests.support.repository import ROOT

URDF = ROOT / "urdf/pupper_skeleton.urdf"
MJCF = ROOT / "mjcf/pupper_skeleton.xml"


def plant_text(folder: Path, after: str, old: str, new: str, model: Path = URDF) -> Path:
    """Write the model with one text replaced after another text, and with DOS line endings."""
    text = model.read_text()
    start = text.index(after)
    assert old in text[start:]
    path = folder / model.name
    changed = text[:start] + text[start:].replace(old, new, 1)
    path.write_bytes(changed.replace("\n", "\r\n").encode())
    return path


def read_original(model: Path = URDF) -> bytes:
    return model.read_text().replace("\n", "\r\n").encode()


def repairs_of(audit: Audit, rule: str) -> list[dict[str, str]]:
    return [
        dict(repair.new) for one in audit.findings if one.rule == rule for repair in one.repairs
    ]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("after", "old", "new", "rule"),
    [
        ('<link name="FR_calf">', 'value="0.05"', 'value="0.5"', "mirror-mass"),
        ('<link name="FL_calf">', 'value="0.05"', 'value="0.0005"', "mirror-mass"),
        ('<joint name="FL_HFE"', 'effort="18"', 'effort="0"', "effort-or-velocity-zero"),
        ('<joint name="FL_HFE"', 'effort="18"', 'effort="-1"', "effort-negative"),
        ('<joint name="RR_KFE"', 'effort="18"', 'effort="9"', "mirror-limits"),
        (
            '<joint name="FL_HFE"',
            'lower="-1.8" upper="1.2"',
            'lower="-103.13240312" upper="68.754935416"',
            "limits-in-wrong-unit",
        ),
    ],
)
def test_planted_number_is_repaired_to_the_original_bytes(
    after: str, old: str, new: str, rule: str, tmp_path: Path
) -> None:
    path = plant_text(tmp_path, after, old, new)
    audit = audit_model(path)
    assert repairs_of(audit, rule)
    documents, count = apply_repairs([audit])
    assert count == 1
    write_documents(documents)
    assert path.read_bytes() == read_original()
    assert audit_model(path).counts == audit_model(URDF).counts


def test_command_range_in_degrees_becomes_the_range_of_the_joint(tmp_path: Path) -> None:
    name = '<general name="FL_HFE"'
    path = plant_text(tmp_path, name, "/>", ' ctrlrange="-103.1 68.75"/>', MJCF)
    documents, _ = apply_repairs([audit_model(path)])
    write_documents(documents)
    expected = f'{name} joint="FL_HFE" ctrlrange="-1.8 1.2"/>'.encode()
    assert expected in path.read_bytes()


def test_command_range_in_degrees_of_a_geared_servo_has_no_repair(tmp_path: Path) -> None:
    """The command of a servo with gear 2 is twice the joint position."""
    extra = ' gear="2" ctrlrange="-206.2 137.5"/>'
    path = plant_text(tmp_path, '<general name="FL_HFE"', "/>", extra, MJCF)
    audit = audit_model(path)
    assert any(finding.rule == "command-range-in-degrees" for finding in audit.findings)
    assert apply_repairs([audit])[1] == 0


def test_decimal_point_of_a_moment_is_confirmed_by_the_mirrored_link(tmp_path: Path) -> None:
    """Without the mirrored link, other powers of ten and other moments are candidates too."""
    moment = re.search(r'FL_calf">.*?ixx="([^"]*)"', URDF.read_text(), re.DOTALL)
    assert moment is not None
    value = float(moment[1])
    path = plant_text(tmp_path, '<link name="FL_calf">', moment[1], repr(value * 1000))
    ((repair),) = repairs_of(audit_model(path), "triangle-inequality")
    assert repair.keys() == {"ixx"}
    assert float(repair["ixx"]) == pytest.approx(value, rel=1e-5)


def test_masses_of_a_biped_are_candidates_and_not_written(tmp_path: Path) -> None:
    """Without further legs, nothing decides which of two partners is wrong."""
    leg = """<link name="{0}_leg"><inertial><mass value="{1}"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
    <joint name="{0}_hip" type="revolute"><parent link="base"/><child link="{0}_leg"/>
    <origin xyz="0 {2} 0"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="9" velocity="9"/></joint>"""
    path = tmp_path / "biped.urdf"
    legs = leg.format("left", 1.0, 0.1) + leg.format("right", 2.0, -0.1)
    path.write_text(f'<robot name="biped"><link name="base"/>{legs}</robot>')
    audit = audit_model(path)
    assert repairs_of(audit, "mirror-mass") == [{"value": "1.0"}, {"value": "2.0"}]
    assert apply_repairs([audit]) == ([], 0)


@pytest.mark.slow
def test_nothing_is_written_without_a_confirmation(tmp_path: Path) -> None:
    path = plant_text(tmp_path, '<link name="FR_calf">', 'value="0.05"', 'value="0.5"')
    before = path.read_bytes()
    shown = CliRunner().invoke(group, ["audit", str(path), "--fix"])
    assert '-      <mass value="0.5"/>' in shown.output
    assert '+      <mass value="0.05"/>' in shown.output
    assert path.read_bytes() == before
    CliRunner().invoke(group, ["audit", str(path), "--fix", "--yes"])
    assert path.read_bytes() == read_original()
    assert CliRunner().invoke(group, ["audit", str(path), "--yes"]).exit_code != 0
    assert CliRunner().invoke(group, ["audit", "v3", "--fix"]).exit_code != 0


def test_sarif_contains_the_bytes_of_the_repair(tmp_path: Path) -> None:
    """Reference: the original file, after replacing the byte region of SARIF."""
    path = plant_text(tmp_path, '<link name="FR_calf">', 'value="0.05"', 'value="0.5"')
    shown = CliRunner().invoke(group, ["audit", str(path), "--format", "sarif"])
    (run,) = json.loads(shown.stdout)["runs"]
    ((fix,),) = [one["fixes"] for one in run["results"] if "fixes" in one]
    ((replacement,),) = [change["replacements"] for change in fix["artifactChanges"]]
    region, data = replacement["deletedRegion"], path.read_bytes()
    start, end = region["byteOffset"], region["byteOffset"] + region["byteLength"]
    mended = data[:start] + replacement["insertedContent"]["text"].encode() + data[end:]
    assert mended == read_original()
