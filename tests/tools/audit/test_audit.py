"""Audit rules: each rule finds its planted fault with its line, and no fault in correct models."""

from __future__ import annotations

import math
import re
import shutil
from collections.abc import Callable
from itertools import product
from math import pi
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
import pinocchio as pin
import pytest
import trimesh
from lxml import etree

import pupper_analysis as pa
from pupper_analysis.base.diagnostics import LANGUAGES, Diagnostic, Quantity, Source
from pupper_analysis.base.tools import formats
from pupper_analysis.models.stated.urdf import read_urdf_model
from pupper_analysis.models.urdf_file import read_urdf
from pupper_analysis.tools.audit.audit import (
    RULES,
    Audit,
    Finding,
    Rule,
    Severity,
    audit_model,
)
from pupper_analysis.tools.audit.registry import CHECKS, compute_hull_distance
from pupper_analysis.tools.audit.rules.joints import infer_axis_from_name
from tests.support.legged import fuse_trunk, quadruped, rewrite_file
from tests.support.repository import ROOT
from tests.support.slips import standing

OWN = {
    "urdf": ROOT / "urdf/pupper_skeleton.urdf",
    "mjcf": ROOT / "mjcf/pupper_skeleton.xml",
}
ROBOTS = sorted(ROOT.glob("urdf/*.urdf")) + [
    ROOT / "mjcf" / name for name in ("pupper_skeleton.xml", "pupper_v3.xml", "pupper_v3_fixed.xml")
]


class Edit(NamedTuple):
    """Replaces the first match of a pattern after a text."""

    after: str
    pattern: str
    new: str


class Case(NamedTuple):
    """One planted fault: rule, format, element, and the text on the reported line."""

    rule: str
    format: str
    element: str
    line: tuple[str, str]  # a text, and what follows it on the line meant
    edits: tuple[Edit, ...]


LEGS = ("FL", "FR", "RL", "RR")
FL_CALF, FR_CALF, FL_FOOT, FR_FOOT = (
    f'<link name="{leg}_{part}">' for part in ("calf", "foot") for leg in ("FL", "FR")
)
FL_HAA, FR_HFE = '<joint name="FL_HAA"', '<joint name="FR_HFE"'
OTHER = 'contype="2" conaffinity="2"'
# Volumes of the drawn shapes [m^3] in closed form. A capsule is a cylinder and two whole spheres.
SOLID_VOLUMES = {"base_link": 0.2 * 0.11 * 0.05} | {
    f"{leg}_{part}": volume
    for leg in LEGS
    for part, volume in (
        ("hip", 4 / 3 * pi * 0.026**3),
        ("thigh", pi * 0.013**2 * 0.08 + 2 * 4 / 3 * pi * 0.013**3),
        ("calf", pi * 0.011**2 * 0.11 + 2 * 4 / 3 * pi * 0.011**3),
        ("foot", 4 / 3 * pi * 0.018**3),
    )
}
KEY, FEET = '<key name="home"', '<default class="foot">'
FL_HFE = '<joint name="FL_HFE"'

# The rule; the format, tag and name of the element; what is on the line that is reported, behind
# the element's tag; a pattern that is replaced behind that tag and its replacement, or edits.
SLIPS: list[tuple[Any, ...]] = [
    ("mass-not-positive", "urdf link FL_calf", '<mass', 'value="0.05"', 'value="-0.05"'),
    ("moving-body-without-mass", "urdf link FL_thigh", '<mass', 'value="[^"]*"', 'value="1e-5"'),
    ("com-outside-shapes", "urdf link FL_calf", '<origin', '-0.055', '0.055'),
    ("mass-beyond-motors", "urdf link base_link", '', '1.506', '1506'),
    ("link-without-inertial", "urdf link body_imu_site", '', '(?s)<inertial>.*?</inertial>', ''),
    ("massless-link-collides", "urdf link body_imu_site", '',
     '</inertial>',
     '</inertial><collision><geometry><sphere radius="0.01"/></geometry></collision>'),
    ("density-implausible", "urdf link base_link", '<mass', '1.506', '90'),
    ("density-implausible", "urdf link base_link", '<mass', '1.506', '1.506e-3'),
    ("scale-unusual", "urdf link base_link", '', '0.2 0.11 0.05', '200 110 50'),
    ("scale-unusual", "urdf link base_link", '',
     '(?s)(<joint name="FL_HAA".*?<origin xyz=")0.075 0.0835 0', r'\g<1>75 83.5 0'),
    ("triangle-inequality", "urdf link FL_calf", '<inertia ',
     '<inertia [^>]*/>',
     '<inertia ixx="1e-5" ixy="1e-5" ixz="1e-5" iyy="1e-5" iyz="1e-5" izz="1e-5"/>'),
    ("inertia-not-positive-definite", "urdf link FL_calf", '<inertia ', 'izz="2.95', 'izz="-2.95'),
    ("triangle-inequality", "urdf link FL_calf", '<inertia ', 'izz="[^"]*"', 'izz="0.0002"'),
    ("inertia-implausible", "urdf link FL_calf", '<inertia ',
     '<inertia [^>]*>', '<inertia ixx="66.5" ixy="0" ixz="0" iyy="66.5" iyz="0" izz="2.95"/>'),
    ("inertia-implausible", "urdf link FL_calf", '<inertia ',
     '<inertia [^>]*>',
     '<inertia ixx="6.65e-8" ixy="0" ixz="0" iyy="6.65e-8" iyz="0" izz="2.95e-9"/>'),
    ("shape-off-link", "urdf link FL_thigh", '<collision',
     r'(?s)<collision>\s*<origin xyz="0 0 -0.04"/>',
     '<collision>\n      <origin xyz="0 0.03 -0.04"/>'),
    ("collision-off-visual", "urdf link FL_hip", '<collision',
     r'(?s)<collision>\s*<origin xyz="0 0 0"/>', '<collision>\n      <origin xyz="0.1 0 0"/>'),
    ("foot-sphere-off-frame", "mjcf site FL_foot", '', '-0.11', '-0.15'),
    ("foot-sphere-off-frame", "urdf link FL_foot", '',
     '(?s)<collision>(.*?)"0 0 0"/>', r'<collision>\1"0 0 .03"/>'),
    ("mirror-position", "urdf joint FR_HAA", '<origin', '-0.0835', '0.0835'),
    ("mirror-mass", "urdf link FR_calf", '<mass', 'value="0.05"', 'value="0.06"'),
    ("mirror-com", "urdf link FR_calf", '<origin', '"0 0 -0.055"', '"0.008 0 -0.055"'),
    ("mirror-inertia", "urdf link FR_calf", '<inertia ', 'ixy="0"', 'ixy="1.00e-5"'),
    ("mirror-axis", "urdf joint FR_HFE", '<axis', '"0 1 0"', '"0 0.995 0.0998"'),
    ("mirror-axis", "urdf joint RR_HAA", '<axis', '"1 0 0"', '"-1 0 0"'),
    ("mirror-axis", "urdf joint FL_HFE", '<axis', '"0 1 0"', '"0 -1 0"'),
    ("mirror-limits", "urdf joint FR_HFE", '<limit', 'lower="-1.8"', 'lower="-1.2"'),
    ("mirror-limits", "urdf joint FR_HAA", '<limit', 'effort="18"', 'effort="9"'),
    ("mirror-drive", "urdf joint FR_HFE", '<dynamics', 'damping="0.04"', 'damping="0.4"'),
    ("mirror-shapes", "urdf link FR_calf", '',
     '(?s)(<link name="FR_foot">.*?<collision>.*?<sphere radius=)"0.018"', r'\g<1>"0.021"'),
    ("mirror-contacts", "mjcf body FR_calf", '',
     r'<geom class="calf"/>(\s*)<geom name="FR_foot"',
     rf'<geom class="calf" {OTHER}/>\1<geom name="FR_foot" {OTHER}'),
    ("mirror-contacts", "mjcf body FR_calf", '',
     '<geom name="FR_foot"', '<geom name="FR_foot" contype="0" conaffinity="0"'),
    ("mirror-contacts", "mjcf body FR_calf", '',
     '<geom name="FR_foot"', '<geom name="FR_foot" friction="0.1" priority="1"'),
    ("mirror-contacts", "mjcf body FR_calf", '',
     '<geom name="FR_foot"', '<geom name="FR_foot" solref="0.1 1"'),
    ("mirror-contacts", "mjcf body FR_calf", '',
     '<geom name="FR_foot"', '<geom name="FR_foot" condim="6"'),
    ("mirror-contacts", "mjcf body FR_calf", '',
     '<geom name="FR_foot"', '<geom name="FR_foot" margin="0.004"'),
    ("axis-contradicts-name", "urdf joint FL_HAA", '<axis', '"1 0 0"', '"0 1 0"'),
    ("axis-zero", "urdf joint FL_HAA", '<axis', '"1 0 0"', '"0 0 0"'),
    ("axis-not-unit", "urdf joint FL_HAA", '<axis', '"1 0 0"', '"2 0 0"'),
    ("mimic-invalid", "urdf joint FL_HFE", '<mimic', '<limit', '<mimic joint="FL_HAB"/><limit'),
    ("mimic-invalid", "urdf joint FL_HFE", '<mimic', '<limit', '<mimic joint="FL_HFE"/><limit'),
    ("velocity-implausible", "urdf joint FL_HFE", '<limit', 'velocity="[^"]*"', 'velocity="1719"'),
    ("mirror-limits", "urdf joint FR_HFE", '<limit', 'velocity="[^"]*"', 'velocity="7"'),
    ("joint-name-odd", "urdf joint lf_knee", '',
     ("", '<joint name="FL_KFE"', '<joint name="lf_knee"')),
    ("mirror-type", "urdf joint FL_HFE", '', 'type="revolute"', 'type="fixed"'),
    ("friction-beyond-effort", "urdf joint FL_HFE", '', 'friction="[^"]*"', 'friction="18"'),
    ("gear-sign-odd", "mjcf general FL_HAA", '', '/>', ' gear="-1"/>'),
    ("actuator-of-another-joint", "mjcf general FL_HAA", '', 'joint="FL_HAA"', 'joint="FR_HAA"'),
    ("keyframe-incomplete", "mjcf key home", '', '(qpos="[^"]*) [^ "]+"', r'\1"'),
    ("keyframe-base-half-turn", "mjcf key home", '', '1 0 0 0', '0 0 0 1'),
    ("range-empty", "urdf joint FL_HFE", '<limit', 'upper="1.2"', 'upper="-1.8"'),
    ("limits-without-effect", "urdf joint FL_HFE", '<limit', 'revolute', 'continuous'),
    ("limits-without-effect", "mjcf joint FL_HAA", '',
     'class="HAA"', 'class="HAA" range="0 0" limited="auto"'),
    ("limits-without-effect", "mjcf general FL_HAA", '',
     'joint="FL_HAA"', 'joint="FL_HAA" ctrlrange="0 0" ctrllimited="auto"'),
    ("limits-in-wrong-unit", "urdf joint FL_HFE", '<limit',
     'lower="-1.8" upper="1.2"', 'lower="-103" upper="69"'),
    ("effort-or-velocity-zero", "urdf joint FL_HFE", '<limit', 'effort="18"', 'effort="0"'),
    ("effort-negative", "urdf joint FL_HFE", '<limit', 'effort="18"', 'effort="-1"'),
    ("effort-or-velocity-zero", "mjcf joint FL_HAA", '',
     'name="FL_HAA"', 'name="FL_HAA" actuatorfrcrange="0 0"'),
    ("effort-placeholder", "urdf joint FL_HFE", '<limit', 'effort="18"', 'effort="1000"'),
    ("value-impossible", "urdf link FL_calf", '<cylinder', '0.011', '-0.011'),
    ("value-impossible", "urdf link base_link", '<box', '0.2 0.11 0.05', '0.2 -0.11 0.05'),
    ("value-impossible", "urdf joint FL_HFE", '<dynamics', '"0.04"', '"-5"'),
    ("value-impossible", "mjcf joint FL_HAA", '', '/>', ' damping="-5"/>'),
    ("value-impossible", "mjcf joint FL_HAA", '', '/>', ' frictionloss="-1"/>'),
    ("value-impossible", "mjcf geom FL_foot", '', '/>', ' friction="-1"/>'),
    ("geometry-empty", "urdf link FL_calf", '<geometry',
     '<cylinder radius="0.011" length="0.11"/>', ''),
    ("option-out-of-range", "mjcf option", '', '0.004', '10'),
    ("option-out-of-range", "mjcf option", '', '0.004', '0'),
    ("option-out-of-range", "mjcf option", '', '0.004', '1e-9'),
    ("option-out-of-range", "mjcf option", '', 'impratio="50"', 'impratio="-1"'),
    ("option-out-of-range", "mjcf option", '', '/>', ' iterations="0"/>'),
    ("option-out-of-range", "mjcf option", '', '/>', ' tolerance="1e9"/>'),
    ("option-out-of-range", "mjcf option", '', '/>', ' density="-1"/>'),
    ("rpy-in-degrees", "urdf joint FL_HFE", '<origin', '"0 0 0"', '"0 0 0" rpy="0 90 0"'),
    ("mesh-missing", "urdf link FL_calf", '<mesh',
     '<cylinder radius="0.011" length="0.11"/>', '<mesh filename="package://nowhere/calf.stl"/>'),
    ("servo-drives-away", "mjcf general FL_HAA", '', '/>', ' gainprm="-60" biasprm="0 60 -1"/>'),
    ("servo-drives-away", "mjcf general FL_HAA", '', '/>', ' gainprm="-1" biasprm="0 0 1"/>'),
    ("drive-of-another-kind", "mjcf general FL_HAA", '', '/>', ' biastype="none"/>'),
    ("range-empty", "mjcf general FL_HAA", '', '/>', ' forcelimited="auto" forcerange="18 -18"/>'),
    ("range-empty", "mjcf general FL_HAA", '', '/>', ' ctrlrange="0.8 -0.8"/>'),
    ("actuator-without-effect", "mjcf general FL_HAA", '', '/>', ' gear="0"/>'),
    ("actuator-unlimited", "mjcf general FL_HAA", '', '/>', ' forcelimited="false"/>'),
    ("command-range-in-degrees", "mjcf general FL_HFE", '', '/>', ' ctrlrange="-103.1 68.75"/>'),
    ("foot-softer-than-its-size", "mjcf geom FL_foot", '', '/>', ' solimp="0.015 1 0.031"/>'),
    ("keyframe-feet-in-air", "mjcf key home", '', 'qpos="[^"]*"',
     'qpos="0 0 0.158 1 0 0 0' + 4 * ' 0 0.9014 1.5083' + '"'),
    ("keyframe-torques-are-angles", "mjcf key home", '',
     ("<general", 'biastype="affine" gainprm="60 0 0"', 'biastype="none" gainprm="1"')),
    ("start-outside-limits", "mjcf key home", '', '0.9014 -1.5083', '1.5 -1.5083'),
    ("keyframe-ctrl", "mjcf key home", '', 'ctrl="0 0.9014', 'ctrl="0 1.5'),
    ("start-in-floor", "mjcf key home", '', '0 0 0.158', '0 0 0.14'),
    ("gravity-compensated", "mjcf body base_link", '', '>', ' gravcomp="0.5">'),
    ("gravity-unusual", "mjcf option", '', '-9.81', '-1.62'),
    ("gravity-unusual", "mjcf option", '', '-9.81', '9.81'),
    ("gravity-unusual", "mjcf option", '', '-9.81', '0'),
    ("gravity-unusual", "mjcf option", '', '-9.81', '-9.75'),
    ("total-mass-replaced", "mjcf compiler", '', '<compiler', '<compiler settotalmass="0.01"'),
    ("moving-body-without-mass", "urdf link FL_calf", "",
     *((link, r"(?s)<inertial>.*?</inertial>", "") for link in (FL_CALF, FL_FOOT))),
    ("visual-adds-mass", "mjcf geom shell", "", ('<geom class="torso"/>', "\n",
     '\n<geom name="shell" type="box" size="0.1 0.05 0.02" conaffinity="0"/>\n')),
    ("shape-ends-off-joint", "urdf link RR_thigh", "<collision",
     *(('<link name="RR_thigh">', f"(?s)<collision>(.*?){old}", rf"<collision>\1{new}")
       for old, new in (('-0.04"/>', '-0.06"/>'), ('"0.08"/>', '"0.12"/>')))),
    ("moving-link-without-collision", "urdf link FL_thigh", "",
     *(('<link name="FL_thigh">', r"(?s)<collision>.*?</collision>", ""),) * 3),
    ("mirror-shapes", "urdf link FR_calf", "",
     *((after, r"(?s)<collision>.*?</collision>", "") for after in (FR_FOOT, *(FR_CALF,) * 3))),
    ("limits-in-wrong-unit", "mjcf joint FL_KFE", "", ("<compiler", "radian", "degree")),
    ("limits-away-from-stand", "urdf joint FL_KFE", "<limit",
     ('<joint name="FL_HFE"', 'upper="1.2"', 'upper="0.1"')),
    ("range-placeholder", "urdf joint FL_HAA", "<limit",
     *((f'<joint name="{leg}_{part}"', 'lower="[^"]*" upper="[^"]*"', 'lower="-3.14" upper="3.14"')
       for leg, part in product(LEGS, ("HAA", "HFE", "KFE")))),
    ("inertial-placeholder", "urdf link FL_calf", "<inertia ",
     *((link, "<inertia [^>]*>",
        '<inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/>')
       for link in (FL_CALF, FR_CALF))),
    ("inertial-placeholder", "urdf link FL_hip", "<mass",
     *((f'<link name="{leg}_{part}">', '<mass value="[^"]*"', '<mass value="1"')
       for leg, part in product(LEGS, ("hip", "thigh", "calf")))),
    ("one-density", "urdf link base_link", "<mass",
     *((f'<link name="{name}">', '<mass value="[^"]*"', f'<mass value="{7860 * volume}"')
       for name, volume in SOLID_VOLUMES.items())),
    ("moving-body-without-mass", "urdf link base_link", "",
     *((f'<link name="{name}">', r"(?s)<inertial>.*?</inertial>", "")
       for name in ("base_link", "body_imu_site"))),
    ("armature-implausible", "mjcf joint FL_HAA", "",
     ("<default>", 'armature="0.003"', 'armature="5"')),
    ("feet-without-contact", "mjcf body FL_calf", "<geom",
     (FEET, 'contype="1" conaffinity="1"', 'contype="0" conaffinity="0"')),
    ("servos-compete", "mjcf position two", "",
     ("", "</actuator>", '<position name="two" joint="FL_HAA" kp="60"/></actuator>')),
    ("forcerange-above-joint", "mjcf general FL_HAA", "",
     (FL_HAA, "/>", ' actuatorfrcrange="-3 3"/>')),
    ("keyframe-falls", "mjcf key home", "", ("<option", "0 0 -9.81", "0 0 9.81")),
    ("armature-zero", "mjcf joint FL_HAA", "", ("<default>", 'armature="0.003"', 'armature="0"')),
    ("foot-frictionless", "mjcf geom FL_foot", "",
     (FEET, 'friction="1.2', 'priority="1" friction="0')),
    ("ground-not-met", "mjcf body base_link", "",
     ('<geom name="floor"', 'contype="1" conaffinity="1"', 'contype="2" conaffinity="4"')),
]  # fmt: skip


def case_of(rule: str, target: str, mark: str, *edits: Any) -> Case:
    format, tag, name = (*target.split(), "")[:3]
    after = f'<{tag} name="{name}"' if name else f"<{tag}"
    kind = "actuator" if tag in ("general", "position") else tag
    element = f"{kind} {name!r}" if name else kind
    made = edits if isinstance(edits[0], tuple) else [(after, *edits)]
    return Case(rule, format, element, (after, mark), tuple(Edit(*edit) for edit in made))


CASES = [
    *(case_of(*slip) for slip in SLIPS),
    Case("mujoco-refuses", "mjcf", "mujoco", (FL_HFE, ""),
         (Edit(FL_HFE, "/>", ' range="1.2 -1.8"/>'),)),
]  # fmt: skip


def apply_edits(text: str, edits: tuple[Edit, ...]) -> str:
    for after, pattern, new in edits:
        start = text.index(after)
        head, tail = text[:start], text[start:]
        tail, count = re.subn(pattern, new, tail, count=1)
        assert count == 1, (after, pattern)
        text = head + tail
    return text


def line_of(text: str, after: str, mark: str) -> int:
    return text[: text.index(mark, text.index(after))].count("\n") + 1


def write_model(folder: Path, format: str, edits: tuple[Edit, ...]) -> Path:
    path = folder / OWN[format].name
    path.write_text(apply_edits(OWN[format].read_text(), edits))
    return path


def find_findings(result: Audit, rule: str, element: str = "") -> list[Finding]:
    return [f for f in result.findings if f.rule == rule and f.element.startswith(element)]


@pytest.fixture(scope="module")
def sound() -> dict[str, Audit]:
    return {format: audit_model(path) for format, path in OWN.items()}


# ------------------------------------------------------------------------------------- the rules


ESCALATED = {"limits-in-wrong-unit", "mass-beyond-motors", "limits-without-effect"}
"""Rules that report some findings with a higher severity than their own: WARNING rules, values
beyond ten times their limit as ERROR; limits-without-effect, ranges of an MJCF as WARNING."""


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.rule}-{case.format}")
def test_planted_fault_is_found_at_its_line(
    case: Case, tmp_path: Path, sound: dict[str, Audit]
) -> None:
    """Reference: the edited element and line; the correct file has no such finding.

    The severity is at most that of the rule, except for the rules in ESCALATED.
    """
    path = write_model(tmp_path, case.format, case.edits)
    findings = find_findings(audit_model(path), case.rule, case.element)
    assert findings, [str(finding) for finding in audit_model(path).findings]
    assert not find_findings(sound[case.format], case.rule, case.element)
    finding = findings[0]
    assert Path(finding.file) == path
    assert finding.line == line_of(path.read_text(), *case.line)
    rule = RULES[case.rule]
    assert (finding.why, finding.todo) == (rule.why, rule.todo)
    assert finding.severity.rank >= rule.severity.rank or case.rule in ESCALATED
    message = finding.diagnostic
    assert message.subject is not None
    assert f"{message.subject.kind} {message.subject.name!r}".removesuffix(" ''") == finding.element
    assert message.sources == (Source(str(path), finding.line),)
    assert message.text("zh")
    assert case.format in rule.formats


@pytest.mark.parametrize(
    ("wrong_links", "is_found"), [((), True), (("hip",), True), (("hip", "calf"), False)]
)
def test_one_density_is_found_in_four_of_five_links_and_through_closed_meshes(
    wrong_links: tuple[str, ...], is_found: bool, tmp_path: Path
) -> None:
    """Masses are volumes times 1001 kg/m^3; the hip is a closed mesh of 2 x 3 x 4 cm in mm.

    The four copies of each link count once: 5 links are compared, of which 4 are 80 %, 3 are 60 %.
    """
    trimesh.creation.box((20, 30, 40)).export(tmp_path / "hip.stl")
    tree = etree.fromstring(OWN["urdf"].read_bytes())
    for link in tree.iterfind("link"):
        name = str(link.get("name"))
        if name not in SOLID_VOLUMES:
            continue
        volume = SOLID_VOLUMES[name]
        if name.endswith("hip"):
            (geometry,) = link.iterfind("visual/geometry")
            geometry[:] = [etree.Element("mesh", filename="hip.stl", scale="0.001 0.001 0.001")]
            volume = 0.02 * 0.03 * 0.04
        is_wrong = name.split("_")[-1] in wrong_links
        link.find("inertial/mass").set("value", f"{(1.05 if is_wrong else 1.0) * 1001 * volume}")
    path = tmp_path / "dog.urdf"
    path.write_bytes(etree.tostring(tree))
    findings = find_findings(audit_model(path), "one-density")
    assert bool(findings) == is_found
    if findings:
        density = findings[0].diagnostic.values["density"]
        assert isinstance(density, Quantity)
        assert density.value == pytest.approx(1001, rel=1e-6)
        assert findings[0].diagnostic.values["compared"] == 5


@pytest.mark.parametrize("off_diagonal", ["0", "1.4e-20"])
def test_negative_moments_are_an_error_whatever_their_size(
    off_diagonal: str, tmp_path: Path
) -> None:
    """iCub's r_hip_2 states -5.42e-20 kg m^2 about two axes, at 0.526 kg."""
    tensor = (
        f'<inertia ixx="-5.4e-20" ixy="0" ixz="{off_diagonal}" iyy="-5.4e-20" iyz="0" izz="0"/>'
    )
    path = write_model(tmp_path, "urdf", (Edit(FL_CALF, "<inertia [^>]*>", tensor),))
    (finding,) = find_findings(audit_model(path), "inertia-not-positive-definite", "link 'FL_calf'")
    assert finding.severity is Severity.ERROR


@pytest.mark.parametrize(
    ("thigh_mass", "severity"), [("100", Severity.WARNING), ("1013", Severity.ERROR)]
)
def test_mass_beyond_motors_by_a_factor_of_ten_is_an_error(
    thigh_mass: str, severity: Severity, tmp_path: Path
) -> None:
    """Four thighs of 1013 kg, as in a published A1 without its decimal point, and of 100 kg.

    Twelve motors of 18 N m give 216 N m. At 80 mm, the longest lever between two joints, 402 kg
    need 315 N m, and 4054 kg need 3180 N m.
    """
    edits = (
        Edit(f'<link name="{leg}_thigh">', '<mass value="[^"]*"', f'<mass value="{thigh_mass}"')
        for leg in LEGS
    )
    path = write_model(tmp_path, "urdf", tuple(edits))
    (finding,) = find_findings(audit_model(path), "mass-beyond-motors")
    assert finding.severity is severity


@pytest.mark.parametrize(
    ("lower", "upper", "severity"),
    [
        ("-154.5", "-52.5", Severity.ERROR),  # an A1's calf in degrees
        ("-30", "20", Severity.WARNING),
        ("-100", "100", Severity.WARNING),  # may be meant as no limit
    ],
)
def test_limits_of_ten_turns_are_an_error_unless_they_are_symmetric(
    lower: str, upper: str, severity: Severity, tmp_path: Path
) -> None:
    limits = f'lower="{lower}" upper="{upper}"'
    edit = Edit('<joint name="FL_KFE"', 'lower="[^"]*" upper="[^"]*"', limits)
    path = write_model(tmp_path, "urdf", (edit,))
    (finding,) = find_findings(audit_model(path), "limits-in-wrong-unit")
    assert finding.severity is severity


@pytest.mark.parametrize(("angle", "limit", "is_found"), [("degree", 720, 0), ("radian", 13, 1)])
def test_two_turns_in_a_file_in_degrees_are_no_limit_in_degrees(
    angle: str, limit: float, is_found: int, tmp_path: Path
) -> None:
    """720 degrees are 12.6 rad, which would be degrees only in a file in radians."""
    path = tmp_path / "cable.xml"
    path.write_text(
        f"""<mujoco><compiler angle="{angle}"/><worldbody><body><geom size="0.1"/>
        <joint name="waist" range="{-limit} {limit}"/></body></worldbody></mujoco>"""
    )
    assert len(find_findings(audit_model(path), "limits-in-wrong-unit")) == is_found


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command_range", "is_found"),
    [
        ("-103.1 68.75", True),  # -1.8 to 1.2 rad in degrees
        ("-1.8 1.2", False),
        ("-100 100", False),  # may be meant as no limit
        ("-3.6 2.4", False),
        ("-103.1 10", False),  # one end only
    ],
)
def test_command_range_is_found_if_it_is_the_range_of_the_joint_in_degrees(
    command_range: str, is_found: bool, tmp_path: Path
) -> None:
    """Reference: -1.8 to 1.2 rad of the joint are -103.1 to 68.75 deg."""
    edit = Edit('<general name="FL_HFE"', "/>", f' ctrlrange="{command_range}"/>')
    result = audit_model(write_model(tmp_path, "mjcf", (edit,)))
    assert bool(find_findings(result, "command-range-in-degrees")) == is_found


@pytest.mark.parametrize(
    ("inertial", "total_mass", "severity"),
    [
        ("mass", 0.02, Severity.WARNING),  # the robot of 3 kg becomes 150 times lighter
        ("mass", 30.0, Severity.WARNING),
        ("mass", 3.3, Severity.NOTE),  # as after weighing
        ("mass", 3.001, None),
        ("mass", -1.0, None),
        ("geoms", 30.0, Severity.WARNING),
        ("density", 0.02, Severity.NOTE),  # the file states no mass
    ],
)
def test_total_mass_that_replaces_the_masses_in_the_file_is_stated(
    inertial: str, total_mass: float, severity: Severity | None, tmp_path: Path
) -> None:
    """Closed form: two bodies of 1 and 2 kg. Reference: the sum of bare MuJoCo's masses."""
    bodies = []
    for name, mass in (("a", 1.0), ("b", 2.0)):
        geom = f'<geom type="box" size="0.05 0.05 0.05" density="{1000 * mass}"/>'
        stated = f'<inertial pos="0 0 0" mass="{mass}" diaginertia="0.01 0.01 0.01"/>'
        if inertial == "geoms":
            geom = geom.replace("density", f'mass="{mass}" density')
        stated = stated if inertial == "mass" else ""
        bodies.append(f'<body><joint name="{name}"/>{stated}{geom}</body>')
    path = tmp_path / "robot.xml"
    path.write_text(
        f'<mujoco>\n<compiler settotalmass="{total_mass}"/>\n'
        f"<worldbody>{''.join(bodies)}</worldbody></mujoco>"
    )
    found = find_findings(audit_model(path), "total-mass-replaced")
    assert [finding.severity for finding in found] == ([severity] if severity else [])
    simulated = mujoco.MjModel.from_xml_path(str(path)).body_mass.sum()
    for finding in found:
        values = finding.diagnostic.values
        assert values["written"].value == pytest.approx(3.0)
        assert values["total"].value == pytest.approx(simulated, rel=1e-9)
        assert values["factor"].value == pytest.approx(total_mass / 3.0)
        assert finding.line == 2


def test_keyframe_with_knees_of_the_wrong_sign_names_the_knees(tmp_path: Path) -> None:
    """The keyframe of the file with knees of the other sign; a drop from 0.3 m is no finding."""
    knees = 4 * " 0 0.9014 1.5083"
    edit = Edit(KEY, 'qpos="[^"]*"', f'qpos="0 0 0.158 1 0 0 0{knees}"')
    (finding,) = find_findings(
        audit_model(write_model(tmp_path, "mjcf", (edit,))), "keyframe-feet-in-air"
    )
    assert finding.diagnostic.values["joints"] == tuple(f"{leg}_KFE" for leg in LEGS)
    raised = write_model(tmp_path, "mjcf", (Edit(KEY, "0 0 0.158", "0 0 0.3"),))
    assert not find_findings(audit_model(raised), "keyframe-feet-in-air")


def test_torques_that_are_no_angles_are_no_finding(tmp_path: Path) -> None:
    """Torque motors with the pose of the file and other commands: zeros, and half the angles."""
    motors = Edit("<general", 'biastype="affine" gainprm="60 0 0"', 'biastype="none" gainprm="1"')
    for torques in (4 * " 0 0 0", 4 * " 0 0.45 -0.754"):
        edit = Edit(KEY, 'ctrl="[^"]*"', f'ctrl="{torques.strip()}"')
        path = write_model(tmp_path, "mjcf", (motors, edit))
        assert not find_findings(audit_model(path), "keyframe-torques-are-angles")


@pytest.mark.parametrize(("length", "depth"), [(0.124, 0.0), (0.134, 0.006)])
def test_hull_of_a_shank_below_the_foot_is_found(
    length: float, depth: float, tmp_path: Path
) -> None:
    """The foot's sphere ends 128 mm below the knee, the box of the shank above or 6 mm below."""
    box = trimesh.creation.box((0.004, 0.004, length))
    box.apply_translation((0, 0, -length / 2))
    box.export(tmp_path / "shank.stl")
    asset = '<asset><mesh name="shank" file="shank.stl"/></asset>\n  <worldbody>'
    geom = '<geom type="mesh" mesh="shank" mass="0.001"/>'
    edits = (
        Edit("<worldbody", "<worldbody>", asset),
        Edit('<geom name="FL_foot"', '<geom name="FL_foot"', f'{geom}<geom name="FL_foot"'),
    )
    findings = find_findings(audit_model(write_model(tmp_path, "mjcf", edits)), "hull-below-foot")
    assert bool(findings) == bool(depth)
    if depth:
        value = findings[0].diagnostic.values["depth"]
        assert isinstance(value, Quantity)
        assert value.value == pytest.approx(depth, rel=0.02)
        assert findings[0].element == "geom 'FL_foot'"


@pytest.mark.parametrize(("wrong", "is_found"), [("ixy", True), ("ixy iyz", False), ("", False)])
def test_wrong_sign_of_one_small_product_of_inertia_is_found(
    wrong: str, is_found: bool, tmp_path: Path
) -> None:
    """Products of 3.75 %, 1.25 % and 2.5 % of the largest moment, below the tolerance of 10 %.

    A part that is mounted on the right turned by 180 degrees about x, not mirrored, has ixy and
    ixz of the other sign than the part on the left: beside the mirror image, iyz and ixz differ.
    """
    left = {"ixx": 5e-5, "iyy": 8e-5, "izz": 6e-5, "ixy": -3e-6, "ixz": 1e-6, "iyz": 2e-6}
    right = {**left, "ixy": 3e-6, "iyz": -2e-6}  # mirrored about y
    right |= {name: -right[name] for name in wrong.split()}
    edits = []
    for link, entries in ((FL_CALF, left), (FR_CALF, right)):
        words = " ".join(f'{name}="{value}"' for name, value in entries.items())
        edits.append(Edit(link, "<inertia [^>]*>", f"<inertia {words}/>"))
    result = audit_model(write_model(tmp_path, "urdf", tuple(edits)))
    assert bool(find_findings(result, "mirror-inertia")) == is_found


PLANAR_LEG = """<body name="thigh{0}" pos="0 0 -0.2"><joint name="hip{0}" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.04"/>
<body name="foot{0}" pos="0 0 -0.7"><joint name="knee{0}" axis="0 1 0" pos="0 0 0.3"/>
<geom type="capsule" fromto="0 0 0.3 0 0 -0.2" size="0.04" friction="{1}"/></body></body>"""


@pytest.mark.parametrize(("friction", "is_found"), [("1.9", True), ("0.9", False)])
def test_feet_of_a_planar_walker_are_partners(
    friction: str, is_found: bool, tmp_path: Path
) -> None:
    """Gymnasium's Walker2d had feet "foot" and "foot_left" with friction 0.9 and 1.9 (issue 477).

    The knees are at the anchors of the joints, where the thighs end, not at the frames of the feet.
    """
    legs = PLANAR_LEG.format("", "0.9") + PLANAR_LEG.format("_left", friction)
    path = tmp_path / "walker.xml"
    path.write_text(
        '<mujoco><worldbody><geom type="plane" size="9 9 9" friction="0.1"/>'
        '<body name="torso" pos="0 0 1.3"><joint name="x" type="slide" axis="1 0 0"/>'
        '<joint name="z" type="slide" axis="0 0 1"/><joint name="turn" axis="0 1 0"/>'
        f'<geom type="capsule" fromto="0 0 -0.2 0 0 0.2" size="0.04"/>{legs}</body>'
        "</worldbody></mujoco>"
    )
    result = audit_model(path)
    assert bool(find_findings(result, "mirror-contacts", "body 'foot_left'")) == is_found
    assert not find_findings(result, "shape-ends-off-joint")


BROKEN = {
    "cut.stl": (bytes(80) + (4).to_bytes(4, "little") + bytes(50 * 2), "mesh-without-triangle"),
    "text.stl": (b"root:x:0:0:root:/root:/bin/bash\n", "mesh-without-triangle"),
    "name.obj": (b"v zero 0 0\nf 1 1 1\n", "no-mesh"),
    "passwd": (b"root:x:0:0:root:/root:/bin/bash\n", "mesh-of-no-format"),
    "text.dae": (b"root:x:0:0:root:/root:/bin/bash\n", "mesh-no-collada"),
    "nan.obj": (b"v 0 0 0\nv 1 0 0\nv nan 1 0\nf 1 2 3\n", "mesh-vertex-not-finite"),
    "empty.obj": (b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", "mesh-without-triangle"),
    "beyond.obj": (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "no-mesh mesh-vertex-unknown"),
}


@pytest.mark.parametrize(("scale", "found"), [("0.001", True), ("1", False)])
def test_mesh_in_metres_with_the_scale_of_millimetres_is_found(
    scale: str, found: bool, tmp_path: Path
) -> None:
    """The calf's cylinder as a mesh in m; with a scale of 0.001 it is 0.11 mm long."""
    trimesh.creation.cylinder(0.011, 0.11).export(tmp_path / "calf.stl")
    mesh = f'<mesh filename="calf.stl" scale="{scale} {scale} {scale}"/>'
    edit = Edit(FL_CALF, r'<cylinder radius="0.011" length="0.11"/>', mesh)
    path = write_model(tmp_path, "urdf", (edit,))
    findings = find_findings(audit_model(path), "scale-unusual", "link 'FL_calf'")
    assert [finding.message for finding in findings] == [
        "a mesh is 0.11 mm long, and the joints of the robot extend over 0.167 m; "
        "a thousand times the length is 0.11 m"
    ] * found
    if found:
        assert findings[0].line == line_of(path.read_text(), FL_CALF, "<mesh")


@pytest.mark.slow
@pytest.mark.parametrize("name", BROKEN)
def test_unreadable_mesh_is_found_with_its_reason(name: str, tmp_path: Path) -> None:
    """Truncated, text and empty files, and invalid vertices; a valid mesh gives no finding."""
    content, code = BROKEN[name]
    (tmp_path / name).write_bytes(content)
    edit = Edit(FL_CALF, r'<cylinder radius="0.011" length="0.11"/>', f'<mesh filename="{name}"/>')
    path = write_model(tmp_path, "urdf", (edit,))
    (finding,) = find_findings(audit_model(path), "mesh-unreadable", "link 'FL_calf'")
    problem = finding.diagnostic.values["problem"]
    assert isinstance(problem, Diagnostic)
    assert problem.code in code.split()
    assert finding.line == line_of(path.read_text(), FL_CALF, "<mesh")
    tetrahedron = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 2 3 4\nf 1 3 4\n"
    (tmp_path / name).rename(tmp_path / "broken")
    valid = tmp_path / "whole.obj"
    valid.write_bytes(tetrahedron)
    path.write_text(path.read_text().replace(name, valid.name))
    assert not find_findings(audit_model(path), "mesh-unreadable")


@pytest.mark.parametrize("axis", [1, 2])
def test_collada_meshes_that_lie_across_are_one_finding(axis: int, tmp_path: Path) -> None:
    """Bars along z between the joints are right as RViz reads the file; bars along y lie across.

    Each file states Y_UP. The base has only a box, far from the next joint. The CoM at the middle
    of the way to the next joint is no second finding.
    """
    size, middle = np.full(3, 0.04), np.zeros(3)
    size[axis], middle[axis] = 0.24, 0.1
    bar = trimesh.creation.box(size, trimesh.transformations.translation_matrix(middle))
    (tmp_path / "bar.dae").write_bytes(trimesh.exchange.dae.export_collada(bar))
    shape = '<geometry><mesh filename="bar.dae"/></geometry>'
    links = (
        '<link name="base"><inertial><mass value="4"/>'
        '<inertia ixx="0.7" iyy="0.6" izz="0.5" ixy="0" ixz="0" iyz="0"/></inertial>'
        '<visual><geometry><box size="1 1 1"/></geometry></visual></link>'
    )
    links += "".join(
        f'<link name="link_{i}"><inertial><origin xyz="0 0 0.1"/><mass value="0.4"/>'
        '<inertia ixx="0.002" iyy="0.002" izz="0.0001" ixy="0" ixz="0" iyz="0"/></inertial>'
        f"<visual>{shape}</visual><collision>{shape}</collision></link>"
        for i in range(4)
    )
    joints = "".join(
        f'<joint name="joint_{i}" type="revolute"><parent link="link_{i - 1}"/>'
        f'<child link="link_{i}"/><origin xyz="0 0 0.2"/><axis xyz="0 1 0"/>'
        '<limit lower="-1" upper="1.5" effort="20" velocity="5"/></joint>'
        for i in range(1, 4)
    )
    joints += (
        '<joint name="turret" type="revolute"><parent link="base"/><child link="link_0"/>'
        '<origin xyz="0 0 0.8"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1.5" effort="20" velocity="5"/></joint>'
    )
    path = tmp_path / "arm.urdf"
    path.write_text(f'<robot name="arm">{links}{joints}</robot>')
    findings = audit_model(path).findings
    assert [finding.rule for finding in findings] == (["mesh-lies-across"] if axis == 1 else [])
    if axis == 1:
        message = findings[0].message
        assert message.startswith("shapes end 180 mm before the next joint with the COLLADA mesh")
        assert message.endswith("; 0 mm with the mesh rotated to z up (3 links by more than 30 mm)")


def test_meshes_of_one_package_or_folder_are_one_finding(tmp_path: Path) -> None:
    names = ("package://dog/a.stl", "package://dog/b.dae", "hips/a.stl", "hips/b.stl")
    tree = etree.fromstring(OWN["urdf"].read_bytes())
    for name, geometry in zip(names, tree.iterfind(".//collision/geometry"), strict=False):
        geometry[:] = [etree.Element("mesh", filename=name)]
    path = tmp_path / "robots" / "dog" / "dog.urdf"  # the folders of other tests are not searched
    path.parent.mkdir(parents=True)
    path.write_bytes(etree.tostring(tree))
    of_folder, of_package = find_findings(audit_model(path), "mesh-missing")
    assert (of_folder.severity, of_package.severity) == (Severity.ERROR, Severity.WARNING)
    assert of_folder.message == "files 'hips/a.stl', 'hips/b.stl' are missing"
    assert of_package.message == (
        "files 'package://dog/a.stl', 'package://dog/b.dae' are missing; "
        "--package dog=DIR specifies the folder of the package"
    )
    assert of_package.line == line_of(path.read_text(), "<robot", names[0])


def test_pointer_of_git_lfs_in_a_package_is_found(tmp_path: Path) -> None:
    """The package is found, so that the option --package is no advice."""
    tree = etree.fromstring(OWN["urdf"].read_bytes())
    geometry = next(tree.iterfind(".//collision/geometry"))
    geometry[:] = [etree.Element("mesh", filename="package://dog/meshes/a.stl")]
    path = tmp_path / "dog" / "urdf" / "dog.urdf"
    path.parent.mkdir(parents=True)
    path.write_bytes(etree.tostring(tree))
    mesh = tmp_path / "dog" / "meshes" / "a.stl"
    mesh.parent.mkdir()
    mesh.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n")
    (finding,) = find_findings(audit_model(path), "mesh-missing")
    assert "Git LFS" in finding.message
    assert "--package" not in finding.message


def test_plane_of_a_body_that_is_fixed_to_the_world_is_a_floor(tmp_path: Path) -> None:
    """Reference: a ball of 0.1 m whose centre is 0.06 m above the plane: 0.04 m deep."""
    path = tmp_path / "ball.xml"
    path.write_text(
        '<mujoco><worldbody><body name="room"><geom type="plane" size="1 1 1"/></body>'
        '<body name="ball" pos="0 0 0.06"><freejoint/><geom size="0.1"/></body></worldbody>'
        '<keyframe><key name="home" qpos="0 0 0.06 1 0 0 0"/></keyframe></mujoco>'
    )
    findings = find_findings(audit_model(path), "start-in-floor")
    assert any("'ball'" in finding.message and "40" in finding.message for finding in findings)


def test_a_mesh_that_is_mirrored_in_all_directions_is_found(tmp_path: Path) -> None:
    """Two mirrored directions are a rotation; a scale of 0 is another finding."""
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\n")
    edit = Edit(
        FL_CALF,
        r'<cylinder radius="0.011" length="0.11"/>',
        '<mesh filename="a.obj" scale="SCALE"/>',
    )
    path = write_model(tmp_path, "urdf", (edit,))
    text = path.read_text()
    for scale, rules in (("-1 -1 -1", {"mesh-mirrored"}), ("-1 -1 1", set()),
                         ("1 0 1", {"value-impossible"})):  # fmt: skip
        path.write_text(text.replace("SCALE", scale))
        findings = [
            finding.rule for finding in audit_model(path).findings if "FL_calf" in finding.element
        ]
        assert {"mesh-mirrored", "value-impossible"} & set(findings) == rules


def test_shape_off_its_link_states_the_displacements_across_and_along_the_link(
    tmp_path: Path,
) -> None:
    """The cylinder of a thigh of 80 mm is displaced by 30 mm across and by 40 mm along it."""
    edit = Edit(
        '<link name="FL_thigh">',
        r'(?s)<collision>\s*<origin xyz="0 0 -0.04"/>',
        '<collision>\n      <origin xyz="0 0.03 -0.08"/>',
    )
    (finding,) = find_findings(
        audit_model(write_model(tmp_path, "urdf", (edit,))), "shape-off-link"
    )
    values = finding.diagnostic.values
    for name, expected in (("aside", 0.03), ("ahead", 0.04), ("way", 0.08)):
        value = values[name]
        assert isinstance(value, Quantity)
        assert value.value == pytest.approx(expected)


def test_two_mirrored_meshes_are_one_finding_with_their_number(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\n")
    shape = r'<cylinder radius="0.011" length="0.11"/>'
    mesh = '<mesh filename="a.obj" scale="-1 -1 -1"/>'
    edits = tuple(Edit(calf, shape, mesh) for calf in (FL_CALF, FR_CALF))
    (finding,) = find_findings(audit_model(write_model(tmp_path, "urdf", edits)), "mesh-mirrored")
    assert finding.diagnostic.values["others"] == 1


@pytest.mark.parametrize("kind", ["continuous", "prismatic"])
def test_equal_ranges_of_all_hinges_are_found_beside_other_joints(
    kind: str, tmp_path: Path
) -> None:
    """Four hinges of +-3.14 rad; the fifth joint has no range, or a range in m."""
    limit = '<limit lower="{}" upper="{}" effort="9" velocity="9"/>'
    links = "".join(
        f'<link name="link{number}"><inertial><mass value="1"/><inertia ixx="0.01" iyy="0.01" '
        'izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        for number in range(6)
    )
    joints = "".join(
        f'<joint name="joint{number}" type="{kind if number == 4 else "revolute"}">'
        f'<parent link="link{number}"/><child link="link{number + 1}"/><axis xyz="0 1 0"/>'
        f"{limit.format(*((0, 0.1) if number == 4 else (-3.14, 3.14)))}</joint>"
        for number in range(5)
    )
    path = tmp_path / "robot.urdf"
    path.write_text(f'<robot name="robot">{links}{joints}</robot>')
    (finding,) = find_findings(audit_model(path), "range-placeholder")
    assert finding.diagnostic.values["count"] == 4


FLOOR = Edit("<worldbody", '<geom name="floor".*?/>', "")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rule", "edits"),
    [
        ("", ()),
        ("", (Edit(FEET, 'condim="3"', 'condim="1"'),)),  # the ground's 3 counts
        ("foot-frictionless", (Edit(FEET, 'condim="3"', 'condim="1" priority="1"'),)),
        ("foot-frictionless", (Edit(FEET, 'friction="1.2', 'friction="0'),)),
        ("ground-not-met", (Edit("<option", "/>", '><flag contact="disable"/></option>'),)),
        ("ground-not-met", (Edit("<option", "/>", '><flag constraint="disable"/></option>'),)),
        (
            "ground-not-met",
            (
                Edit(FEET, 'contype="1" conaffinity="1"', 'contype="2" conaffinity="2"'),
                Edit(
                    "<default>",
                    '<geom contype="0" conaffinity="1"',
                    '<geom contype="2" conaffinity="4"',
                ),
            ),
        ),
    ],
)
def test_file_without_ground_is_checked_on_a_default_ground(
    rule: str, edits: tuple[Edit, ...], tmp_path: Path
) -> None:
    """MuJoCo's rule: the larger condim and friction of foot and ground count, unless a priority is
    set.
    """
    result = audit_model(write_model(tmp_path, "mjcf", (FLOOR, *edits)))
    found = {finding.rule for finding in result.findings if finding.severity != Severity.NOTE}
    # Without contacts, the robot falls through each ground.
    falls = {"keyframe-falls"} if edits and edits[0].after == "<option" else set()
    assert found <= {rule} | falls
    assert falls <= found
    assert bool(find_findings(result, rule)) is bool(rule)


def test_motor_without_name_beside_a_joint_named_joint_is_no_finding(tmp_path: Path) -> None:
    file = tmp_path / "two.xml"
    shape = '<geom size="0.1" mass="1"/>'
    file.write_text(
        '<mujoco><worldbody><body><joint name="joint"/>' + shape + '<body pos="0 0 1">'
        '<joint name="knee"/>' + shape + "</body></body></worldbody>"
        '<actuator><motor joint="knee"/></actuator></mujoco>'
    )
    assert not find_findings(audit_model(file), "actuator-of-another-joint")


@pytest.mark.slow
@pytest.mark.parametrize(("factor", "named"), [(100.0, True), (0.01, True), (10.0, False)])
def test_individually_identified_motors_are_no_finding(
    factor: float, named: bool, tmp_path: Path
) -> None:
    """Armatures between 100 % and 160 % of 0.003 kg m^2; a factor of 100 in one motor is found, a
    factor of 10 is not.
    """
    text = OWN["mjcf"].read_text()
    for number, name in enumerate(re.findall('<joint name="(.._H.E|.._KFE|.._HAA)"', text)):
        value = 0.003 * (1.0 + 0.1 * (number % 7)) * (factor if name == "FR_KFE" else 1.0)
        joint = f'<joint name="{name}"'
        text = text.replace(joint, f'{joint} armature="{value:.6g}"')
    path = tmp_path / "own.xml"
    path.write_text(text)
    assert {finding.element for finding in find_findings(audit_model(path), "mirror-drive")} == (
        {"joint 'FR_KFE'"} if named else set()
    )


def test_armature_of_all_right_joints_that_differs_is_a_finding(tmp_path: Path) -> None:
    """All pairs are unequal, but with two values only: these motors were not identified."""
    text, names = OWN["mjcf"].read_text(), []
    for name in re.findall('<joint name="(.._H.E|.._KFE|.._HAA)"', text):
        value = 0.003 if name[1] == "L" else 0.006
        names += [f"joint {name!r}"] if name[1] == "R" else []
        text = text.replace(f'<joint name="{name}"', f'<joint name="{name}" armature="{value}"')
    path = tmp_path / "own.xml"
    path.write_text(text)
    findings = find_findings(audit_model(path), "mirror-drive")
    assert sorted(finding.element for finding in findings) == sorted(names)


def test_keyframe_without_commands_is_a_note(tmp_path: Path) -> None:
    """Missing commands are zeros: 8 of 12 joint positions of the keyframe differ from zero."""
    path = write_model(tmp_path, "mjcf", (Edit(KEY, r' ctrl="[^"]*"', ""),))
    (finding,) = find_findings(audit_model(path), "keyframe-ctrl")
    assert finding.severity is Severity.NOTE
    assert (finding.diagnostic.values["ahead"], finding.diagnostic.values["commands"]) == (8, 12)


def test_limits_of_a_continuous_joint_are_reported(tmp_path: Path) -> None:
    edit = Edit(FL_HAA, 'type="revolute"', 'type="continuous"')
    (finding,) = find_findings(
        audit_model(write_model(tmp_path, "urdf", (edit,))), "limits-without-effect"
    )
    assert finding.diagnostic.code == "limits-without-effect"
    assert finding.diagnostic.values["lower"] == Quantity(-0.8, "rad")
    assert finding.diagnostic.values["upper"] == Quantity(0.8, "rad")


def test_masses_a_thousandfold_too_small_are_reported_as_lighter_than_foam(tmp_path: Path) -> None:
    path = tmp_path / "light.urdf"
    text = OWN["urdf"].read_text()
    path.write_text(re.sub(r'<mass value="([^"]+)"', r'<mass value="\1e-3"', text))
    findings = find_findings(audit_model(path), "density-implausible")
    assert {finding.diagnostic.code for finding in findings} == {"lighter-than-foam"}


def test_each_rule_of_the_catalogue_has_a_function() -> None:
    theirs = {name for name, rule in RULES.items() if set(rule.formats) <= formats().keys()}
    assert set(CHECKS) == set(RULES) - theirs


@pytest.mark.parametrize("rule", RULES.values(), ids=lambda rule: rule.id)
def test_each_rule_has_chinese_texts(rule: Rule) -> None:
    assert rule.chinese.keys() == {"title", "why", "todo"}
    assert all(re.search("[\u4e00-\u9fff]", words) for words in rule.chinese.values())


def test_findings_are_sorted_and_become_json(tmp_path: Path) -> None:
    edits = (
        Edit(FL_HAA, '"1 0 0"', '"2 0 0"'),
        Edit(FR_CALF, 'value="0.05"', 'value="-0.05"'),
        Edit(FR_HFE, 'effort="18"', 'effort="0"'),
    )
    result = audit_model(write_model(tmp_path, "urdf", edits))
    keys = [(finding.severity.rank, finding.line) for finding in result.findings]
    assert keys == sorted(keys)
    assert result.format == "urdf"
    assert not result.passed
    assert result.to_dict()["counts"] == {
        str(severity): sum(f.severity == severity for f in result.findings) for severity in Severity
    }
    assert str(result.findings[0]).startswith("error pupper_skeleton.urdf:")


def test_every_rule_has_a_test() -> None:
    by_meshes = {"mesh-unreadable", "mesh-mirrored", "mesh-lies-across", "joint-off-links"}
    apart = {
        "base-fused",
        "hull-below-foot",
        "axis-sign-odd",
    } | by_meshes  # not by an edit of the own models
    assert {case.rule for case in CASES} | apart == set(CHECKS)


@pytest.mark.slow
@pytest.mark.parametrize("path", ROBOTS, ids=lambda path: path.name)
def test_models_of_this_package_have_no_error_or_warning(path: Path) -> None:
    result = audit_model(path)
    assert result.passed
    assert result.counts["warning"] == 0, [str(finding) for finding in result.findings]


@pytest.mark.slow
def test_derived_variants_have_no_error_or_warning(variant: str, tmp_path: Path) -> None:
    """Exception: the servos of v3-long-leg are too soft. In bare MuJoCo its base ends tilted by
    16 deg, and command ``stand`` fails it for the same reason."""
    written = pa.pupper.write_variant(variant, tmp_path)
    assert len(written) == 2
    for path in written:
        result = audit_model(path)
        expected = ["keyframe-falls"] * (variant == "v3-long-leg" and path.suffix == ".xml")
        serious = [found for found in result.findings if found.severity in ("error", "warning")]
        assert [found.rule for found in serious] == expected, list(map(str, result.findings))
        for found in serious:
            values = found.diagnostic.values
            model = mujoco.MjModel.from_xml_path(str(path))
            data = mujoco.MjData(model)
            mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
            mujoco.mj_step(model, data, nstep=round(5 / model.opt.timestep))
            lean = values["lean"]
            assert values["tilted"]
            assert isinstance(lean, Quantity)
            assert lean.value == pytest.approx(math.acos(data.xmat[1][8]), abs=0.02)
            (cause,) = values["causes"]  # type: ignore[misc]
            assert cause.code == "servos-too-soft"  # type: ignore[union-attr]


def test_the_tutorials_long_leg_is_found(tmp_path: Path) -> None:
    """The knee stays at 0.08 m while the thigh is drawn 0.12 m long."""
    edits = (
        Edit('<default class="thigh">', "0 0 -0.08", "0 0 -0.12"),
        Edit('<default class="calf">', "0 0 -0.11", "0 0 -0.165"),
        *(Edit(f'<site name="{leg}_foot"', "-0.11", "-0.165") for leg in LEGS),
        Edit('<default class="foot">', "-0.11", "-0.165"),
    )
    findings = find_findings(
        audit_model(write_model(tmp_path, "mjcf", edits)), "shape-ends-off-joint"
    )
    assert [re.findall(r"'(.*)'", f.element)[0] for f in findings] == [
        f"{leg}_thigh" for leg in ("FL", "FR", "RL", "RR")
    ]
    for finding in findings:
        values = finding.diagnostic.values
        assert values["beyond"] is True
        for name, expected in (("length", 0.12), ("way", 0.08), ("gap", 0.04)):
            assert values[name].value == pytest.approx(expected), name  # type: ignore[union-attr]


def test_refusal_by_mujoco_is_the_only_finding(tmp_path: Path) -> None:
    edits = (
        Edit('<default class="HFE">', "-1.8 1.2", "1.2 -1.8"),
        Edit(KEY, "0 0 0.158", "0 0 0.1"),
    )
    result = audit_model(write_model(tmp_path, "mjcf", edits))
    assert not result.passed
    assert [finding.rule for finding in result.findings] == ["mujoco-refuses"]


def test_reference_to_a_missing_body_is_found_at_its_line(tmp_path: Path) -> None:
    """A copy of the compiled spec lacks the wrong <exclude>, and would compile."""
    wrong = '<contact>\n<exclude body1="base_link" body2="nix"/></contact>\n</mujoco>'
    path = tmp_path / "model.xml"
    path.write_text(OWN["mjcf"].read_text().replace("</mujoco>", wrong))
    result = audit_model(path)
    assert not result.passed
    (finding,) = find_findings(result, "mujoco-refuses")
    assert "body 'nix' not found" in finding.message
    assert "<exclude" in path.read_text().splitlines()[int(finding.line or 0) - 1]


def test_stated_inertias_of_an_mjcf_are_as_written(tmp_path: Path) -> None:
    """An inertia that is a thousand times too large in an included file is reported with that
    file's line."""
    folder = shutil.copytree(ROOT / "mjcf", tmp_path / "mjcf")
    body = folder / "pupper_v3_body.xml"
    stated, slip = "4.05e-05 4.05e-05 7.7e-05 3.5e-05", "4.05e-02 4.05e-02 7.7e-02 3.5e-02"
    body.write_text(body.read_text().replace(stated, slip, 1))
    (finding,) = find_findings(audit_model(folder / "pupper_v3.xml"), "inertia-implausible")
    assert finding.severity == Severity.WARNING
    assert Path(finding.file).name == body.name
    assert finding.line == line_of(body.read_text(), slip, "")
    assert finding.element == "body 'leg_front_r_3'"
    moment = finding.diagnostic.values["moment"]
    assert isinstance(moment, Quantity)
    assert (moment.value, moment.unit) == (pytest.approx(0.077), "kg m^2")


@pytest.mark.parametrize("bits", ["", 'contype="0" conaffinity="0"'])
def test_a_missing_mesh_of_an_mjcf_is_an_error(bits: str, tmp_path: Path) -> None:
    """MuJoCo refuses the file, whether or not the mesh touches.

    If it touches, the missing contact with the ground follows from it, and is no finding.
    """
    path = tmp_path / "robot.xml"
    path.write_text(f"""<mujoco>
      <asset><mesh name="foot" file="gone.stl"/></asset>
      <worldbody><body name="base" pos="0 0 1"><freejoint/>
        <inertial pos="0 0 0" mass="2" diaginertia="0.01 0.01 0.01"/>
        <body name="leg"><joint name="hip" axis="0 1 0"/>
          <inertial pos="0 0 -0.1" mass="0.2" diaginertia="0.001 0.001 0.001"/>
          <geom type="mesh" mesh="foot" {bits}/></body></body></worldbody></mujoco>""")
    result = audit_model(path)
    (finding,) = find_findings(result, "mesh-missing", "mesh 'foot'")
    assert finding.severity == "error"
    assert bool(find_findings(result, "ground-not-met")) == bool(bits)


@pytest.mark.parametrize(
    ("part", "mesh", "loads"),
    [
        ("collision", "meshes\\a.stl", True),
        ("collision", "gone.stl", False),
        ("visual", "gone.stl", True),
    ],
)
def test_missing_mesh_of_a_urdf_is_refused_by_mujoco_as_the_rule_states(
    part: str, mesh: str, loads: bool, tmp_path: Path
) -> None:
    """Reference: bare MuJoCo, which refuses missing meshes of collision shapes alone, and reads
    backslashes as slashes.
    """
    (tmp_path / "meshes").mkdir()
    trimesh.creation.box((0.1, 0.1, 0.1)).export(tmp_path / "meshes" / "a.stl")
    path = tmp_path / "robot.urdf"
    path.write_text(
        '<robot name="r"><link name="b"><inertial><mass value="1"/><inertia ixx="0.002"'
        ' iyy="0.002" izz="0.002" ixy="0" ixz="0" iyz="0"/></inertial>'
        f'<{part}><geometry><mesh filename="{mesh}"/></geometry></{part}></link></robot>'
    )
    (finding,) = find_findings(audit_model(path), "mesh-missing")
    assert finding.severity == ("warning" if part == "visual" else "error")
    assert "refuses an MJCF, and a URDF if the shape collides" in RULES["mesh-missing"].why
    if loads:
        mujoco.MjModel.from_xml_path(str(path))
    else:
        with pytest.raises(ValueError, match=r"gone\.stl"):
            mujoco.MjModel.from_xml_path(str(path))


COM, INERTIA = ("0.03866 0.03585", "0.03866 -0.03585"), ("-3.5e-05", "3.5e-05")
LOST_SIGNS = [
    *((rule, f"{of} leg_front_l_3", *sign) for of in ("urdf link", "mjcf body")
      for rule, sign in (("mirror-com", COM), ("mirror-inertia", INERTIA))),
    ("mirror-limits", "urdf joint leg_front_l_1",
     'lower="-2.51" upper="1.22"', 'lower="-1.22" upper="2.51"'),
    ("mirror-limits", "mjcf joint leg_front_l_1", "-2.51 1.22", "-1.22 2.51"),
]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(("rule", "target", "old", "new"), LOST_SIGNS)
def test_lost_signs_between_links_with_rotated_frames(
    rule: str, target: str, old: str, new: str, tmp_path: Path
) -> None:
    """The frames of v3's left and right links are rotated against each other."""
    for folder in ("urdf", "mjcf"):
        shutil.copytree(ROOT / folder, tmp_path / folder)
    format, tag, name = target.split()
    path = part = tmp_path / "urdf/pupper_v3.urdf"
    if format == "mjcf":
        path, part = (tmp_path / "mjcf" / name for name in ("pupper_v3.xml", "pupper_v3_body.xml"))
    edit = Edit(f'<{tag} name="{name}"', re.escape(old), new)
    part.write_text(apply_edits(part.read_text(), (edit,)))
    (finding,) = find_findings(audit_model(path), rule)
    assert finding.element == f"{tag} {name!r}"
    assert Path(finding.file) == part


def test_rounded_inertias_are_sound(tmp_path: Path) -> None:
    """A rod whose moments were rounded to a few digits breaks the inequality by the rounding."""
    edits = (
        Edit(
            FL_CALF,
            "<inertia [^>]*>",
            '<inertia ixx="6.661e-05" ixy="0" ixz="0" iyy="6.361e-05" iyz="0" izz="2.9997e-06"/>',
        ),
    )
    assert not find_findings(
        audit_model(write_model(tmp_path, "urdf", edits)), "triangle-inequality"
    )


# ------------------------------------------------------------------------------------- others


def test_rules_accept_all_encodings_that_the_reader_accepts(tmp_path: Path) -> None:
    """A missing mesh and the gravity are found by line in a file with a declared encoding."""
    text = OWN["mjcf"].read_text()
    extra = '<asset><mesh name="k" file="no.obj"/></asset>\n<option gravity="0 0 -1"/>'
    text = '<?xml version="1.0" encoding="latin-1"?>\n' + text[text.index("<mujoco") :]
    text = text.replace("</mujoco>", f"{extra}\n</mujoco>")
    path = tmp_path / "model.xml"
    path.write_text(text)
    result = audit_model(path)
    (mesh,) = find_findings(result, "mesh-missing")
    (gravity,) = find_findings(result, "gravity-unusual")
    assert "no.obj" in text.splitlines()[int(mesh.line or 0) - 1]
    assert "gravity" in text.splitlines()[int(gravity.line or 0) - 1]


def test_urdf_inertia_is_rotated_by_its_origin(tmp_path: Path) -> None:
    """Reference: Pinocchio, R I R^T in the axes of the link.

    The rotation has no symmetry and all moments differ, so that R^T I R is another matrix.
    """
    path = tmp_path / "one.urdf"
    path.write_text(
        '<robot name="one"><link name="base"><inertial>'
        '<origin xyz="0.1 0.2 0.3" rpy="0.4 -0.7 1.1"/>'
        '<mass value="2"/><inertia ixx="0.01" iyy="0.02" izz="0.025" ixy="0.001" ixz="0.002" '
        'iyz="-0.003"/></inertial></link></robot>'
    )
    inertial = read_urdf_model(read_urdf(path)).links["base"].inertial
    assert inertial is not None
    theirs = pin.buildModelFromUrdf(str(path), pin.JointModelFreeFlyer()).inertias[1]
    np.testing.assert_allclose(inertial.inertia, theirs.inertia, atol=1e-15)
    np.testing.assert_allclose(inertial.com, theirs.lever, atol=1e-15)


def test_shapes_of_massless_links_are_one_finding(tmp_path: Path) -> None:
    shape = '</inertial><collision><geometry><sphere radius="0.03"/></geometry></collision>'
    links = [f'<link name="{name}">' for name in ("FL_foot", "body_imu_site")]
    empty = '<mass value="0"/><inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/>'
    edits = [Edit(link, "(?s)<mass.*?</inertial>", empty + shape) for link in links]
    (water,) = find_findings(
        audit_model(write_model(tmp_path, "urdf", (*edits,))), "massless-link-collides"
    )
    others = water.diagnostic.values["others"]
    assert {water.element, *others} == {"link 'body_imu_site'", "FL_foot"}


def test_links_without_inertial_are_one_finding(tmp_path: Path) -> None:
    """Reference: PyBullet 3.2.7 loads 8.17 kg for a Pupper v3 with five links without inertial."""
    text = (ROOT / "urdf/pupper_v3.urdf").read_text()
    for site in re.findall(r'<link name="(\w+_site)">', text):
        text = re.sub(rf'(<link name="{site}")>.*?</link>', r"\1/>", text)
    file = tmp_path / "bare.urdf"
    file.write_text(text)
    (bare,) = (
        finding for finding in audit_model(file).findings if finding.rule == "link-without-inertial"
    )
    assert "8.17 kg in PyBullet, instead of 3.17 kg" in bare.message
    assert len(bare.diagnostic.values["others"]) == 4  # type: ignore[arg-type]
    assert bare.element == "link 'body_imu_site'"
    rules = {finding.rule for finding in audit_model(ROOT / "urdf/pupper_v3.urdf").findings}
    assert not rules & {"link-without-inertial", "massless-link-collides"}


def test_com_outside_the_robot_is_found_for_a_link_without_shapes(tmp_path: Path) -> None:
    """A CoM at 5.73 m (as if typed in degrees), on a leg of 0.6 m."""
    pair = quadruped(tmp_path)
    thigh = '<inertial pos="0 0 -0.1" mass="0.5"'
    assert not any(
        finding.rule == "com-outside-shapes" for finding in pa.audit_model(pair.mjcf).findings
    )
    pair.mjcf.write_text(pair.mjcf.read_text().replace(thigh, thigh.replace("-0.1", "-5.73"), 1))
    (message,) = (
        finding
        for finding in pa.audit_model(pair.mjcf).findings
        if finding.rule == "com-outside-shapes"
    )
    assert message.severity == "warning"
    assert message.diagnostic.code == "com-far-from-joints"


ARM = """<robot name="arm"><link name="base"/><link name="upper">{shape}</link><link name="lower"/>
<joint name="one" type="revolute"><parent link="base"/><child link="upper"/>
<axis xyz="0 1 0"/><limit lower="0" upper="0" effort="1" velocity="1"/></joint>
<joint name="two" type="continuous"><parent link="upper"/><child link="lower"/>
<origin xyz="0.3 0 0"/><axis xyz="0 1 0"/></joint></robot>"""
BOX = '<collision><geometry><box size="{} 0.1 0.1"/></geometry></collision>'


def test_shape_much_larger_than_the_robot_is_found(tmp_path: Path) -> None:
    """Twenty times its joints' 0.3 m are 6 m: a box in millimetres."""
    for size, message in ((5.9, False), (6.1, True), (100.0, True)):
        (tmp_path / "arm.urdf").write_text(ARM.format(shape=BOX.format(size)))
        assert bool(find_findings(audit_model(tmp_path / "arm.urdf"), "scale-unusual")) == message


def test_legs_on_the_world_have_no_lever_to_their_base(tmp_path: Path) -> None:
    """If the base is fused with the world, no link is common to two legs."""
    leg = (
        "<body><joint name='hip{0}' axis='0 1 0'/><geom size='0.05'/>"
        "<body pos='0 0 -0.2'><joint name='knee{0}' axis='0 1 0'/><geom size='0.05'/></body></body>"
    )
    motors = "".join(
        f"<motor joint='{name}{side}' ctrllimited='true' ctrlrange='-{{0}} {{0}}'/>"
        for name in ("hip", "knee")
        for side in (0, 1)
    )
    bodies = leg.format(0) + leg.format(1)
    path = tmp_path / "fused.xml"
    for effort, found in ((9.0, False), (0.1, True)):
        path.write_text(
            f"<mujoco><worldbody>{bodies}</worldbody>"
            f"<actuator>{motors.format(effort)}</actuator></mujoco>"
        )
        rules = [finding.rule for finding in audit_model(path).findings]
        assert ("mass-beyond-motors" in rules) is found


def test_legs_on_the_world_are_reported_as_a_fused_base(tmp_path: Path) -> None:
    """As in MuJoCo's import of a URDF; two arms on a bench are not reported."""
    pair = quadruped(tmp_path)
    assert not find_findings(audit_model(pair.mjcf), "base-fused")
    (finding,) = find_findings(audit_model(fuse_trunk(pair).mjcf), "base-fused")
    text = pair.mjcf.read_text()
    assert finding.element.split("'")[1] in text.splitlines()[finding.line - 1]
    arms = re.sub("hip|thigh|knee|calf|foot|shank", lambda found: found[0][::-1], text)
    pair.mjcf.write_text(arms)
    assert not find_findings(audit_model(pair.mjcf), "base-fused")


@pytest.mark.parametrize(("height", "distance"), [(0.2, 0.2), (-0.2, 0.2), (0.0, 0.0)])
def test_distance_to_coplanar_points_is_the_distance_to_their_bounding_box(
    height: float, distance: float
) -> None:
    """A unit square has no hull with a volume; the point is above, below or in its plane."""
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
    assert compute_hull_distance(square, np.array([0.5, 0.5, height])) == pytest.approx(distance)


@pytest.mark.parametrize(
    ("gravity", "severity"), [("0 0 0", "warning"), ("0 0 9.81", "warning"), ("1 0 -9.7", "note")]
)
def test_gravity_of_zero_is_a_warning_and_a_slope_a_note(
    gravity: str, severity: str, tmp_path: Path
) -> None:
    """A tilted gravity simulates a slope; without gravity, no legged robot loads its feet."""
    path = tmp_path / "robot.xml"
    body = '<body><freejoint/><geom size="0.1" mass="1"/></body>'
    option = f'<option gravity="{gravity}"/>'
    path.write_text(f"<mujoco>{option}<worldbody>{body}</worldbody></mujoco>")
    (finding,) = find_findings(audit_model(path), "gravity-unusual")
    assert finding.severity == severity
    without = audit_model(path, disabled=["gravity-unusual"])
    assert without.disabled == ("gravity-unusual",)
    assert "gravity-unusual" not in without.rules_run
    assert find_findings(without, "gravity-unusual") == []


def test_foot_site_of_a_welded_body_is_compared_with_the_sphere_of_the_moving_body(
    tmp_path: Path,
) -> None:
    """The site is 50 mm beside the centre of a sphere of 20 mm."""
    path = tmp_path / "leg.xml"
    path.write_text(
        """<mujoco><worldbody><body name="trunk"><freejoint/><geom size=".05" mass="1"/>
        <body name="calf"><joint name="knee" axis="0 1 0" range="-1 1"/>
        <geom name="ball" size=".02" pos="0 0 -.2" mass=".1"/>
        <body name="tip" pos="0 0 -.15"><site name="foot"/></body></body></body></worldbody>
        </mujoco>"""
    )
    [finding] = find_findings(audit_model(path), "foot-sphere-off-frame")
    assert finding.element == "site 'foot'"


@pytest.mark.parametrize(
    ("tag", "name", "severity"),
    [
        ("collision", "gone.stl", "error"),
        ("visual", "gone.stl", "warning"),
        ("collision", "package://elsewhere/gone.stl", "warning"),
    ],
)
def test_missing_mesh_of_a_urdf_is_an_error_if_it_collides(
    tag: str, name: str, severity: str, tmp_path: Path
) -> None:
    """A package elsewhere may have the mesh."""
    pattern = rf'(?s)(<{tag}>.*?)<cylinder radius="0.011" length="0.11"/>'
    edit = Edit(FL_CALF, pattern, rf'\1<mesh filename="{name}"/>')
    result = audit_model(write_model(tmp_path, "urdf", (edit,)))
    (finding,) = find_findings(result, "mesh-missing", "link 'FL_calf'")
    assert finding.severity == severity


def test_missing_mesh_of_an_included_mjcf_is_reported_with_its_file(tmp_path: Path) -> None:
    """The left and the right calf have the same file, which is one finding."""
    folder = shutil.copytree(ROOT / "mjcf", tmp_path / "mjcf")
    (folder / "meshes/calf.stl").unlink()
    (finding,) = find_findings(audit_model(folder / "pupper_v3.xml"), "mesh-missing")
    assert finding.element == "mesh 'calf_r'"
    assert Path(finding.file).name == "pupper_v3_shared.xml"


def test_invalid_severities_rules_and_files_are_refused(tmp_path: Path) -> None:
    """The former name ``info`` of the severity ``note`` is accepted."""
    assert Severity("info") is Severity.NOTE
    with pytest.raises(ValueError, match="frightful"):
        Severity("frightful")
    unknown = "no rule 'typo'; available: mass-not-positive"
    with pytest.raises(pa.ConfigurationError, match=unknown):
        audit_model(OWN["urdf"], disabled=["typo"])
    with pytest.raises(pa.ModelError):
        audit_model(tmp_path / "none.urdf")


@pytest.mark.parametrize(
    ("name", "axis"),
    [
        ("FL_HAA", 0),
        ("left_hip_roll_joint", 0),
        ("fl.hx", 0),
        ("FL_thigh_joint", 1),
        ("RightKnee", None),
        ("right_knee", 1),
        ("left_hip_yaw", 2),
        ("leg_front_l_1", None),
        ("shoulder_pitch", None),
        ("hip", None),
    ],
)
def test_axis_is_inferred_from_the_name_of_a_joint(name: str, axis: int | None) -> None:
    assert infer_axis_from_name(name, {name}) == axis


def test_hip_is_the_abduction_if_thigh_and_calf_exist() -> None:
    names = {"FL_hip_joint", "FL_thigh_joint", "FL_calf_joint"}
    assert infer_axis_from_name("FL_hip_joint", names) == 0
    assert infer_axis_from_name("FL_hip_joint", {"FL_hip_joint", "FL_thigh_joint"}) is None


def test_joint_that_cannot_move_does_not_start_outside_its_limits(tmp_path: Path) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(
        """<robot name="arm"><link name="base"/><link name="upper"/><link name="lower"/>
        <joint name="one" type="revolute"><parent link="base"/><child link="upper"/>
        <axis xyz="0 1 0"/><limit lower="0.5" upper="0.5" effort="1" velocity="1"/></joint>
        <joint name="two" type="continuous"><parent link="upper"/><child link="lower"/>
        <origin xyz="0.3 0 0"/><axis xyz="0 1 0"/></joint></robot>"""
    )
    assert not find_findings(audit_model(path), "start-outside-limits")


def test_weight_beyond_the_motors_names_the_link_that_is_nearly_all_of_it(tmp_path: Path) -> None:
    """Reference: the masses of the edited file."""
    path = tmp_path / "robot.urdf"
    text = OWN["urdf"].read_text()
    start = text.index('<link name="RL_calf">')
    path.write_text(text[:start] + text[start:].replace('value="0.05"', 'value="900"', 1))
    (found,) = (f for f in audit_model(path).findings if f.rule == "mass-beyond-motors")
    assert found.element == "link 'RL_calf'"
    assert found.message.startswith("mass of the robot is ")
    assert "more than 90 % in this link" in found.message


def test_servos_of_slides_are_reported_in_newtons(tmp_path: Path) -> None:
    """Two servos of 10 N/m and a spring of the wrong sign on a slide: no N m, each unit once."""
    path = tmp_path / "slide.xml"
    path.write_text(
        '<mujoco><worldbody><body><joint name="s" type="slide" actuatorfrcrange="-2 2"/>'
        '<geom size="0.1"/></body></worldbody><actuator>'
        '<position name="a" joint="s" kp="10" forcerange="-5 5"/>'
        '<position name="b" joint="s" kp="10" forcerange="-5 5"/>'
        '<general name="c" joint="s" biastype="affine" gainprm="1" biasprm="0 5 3"'
        ' forcerange="-5 5"/></actuator></mujoco>'
    )
    found = [
        finding
        for finding in audit_model(path).findings
        if finding.rule in ("servos-compete", "servo-drives-away", "forcerange-above-joint")
    ]
    codes = {finding.diagnostic.code for finding in found}
    assert {"servos-compete", "servo-drives-away", "damping-drives"} < codes
    for finding in found:
        for language in LANGUAGES:
            text = finding.diagnostic.text(language)
            assert not re.search("N m|[(]or|（或", text), text
            assert " N" in text


def test_fall_from_a_keyframe_states_the_height_of_the_centre_of_mass(tmp_path: Path) -> None:
    """A motorless cart with its base frame 0.5 m above the CoM rolls away: 0.1 m is the CoM's."""
    path = tmp_path / "cart.xml"
    path.write_text(
        '<mujoco><option gravity="5 0 -9.81"/><worldbody><geom type="plane" size="9 9 1"/>'
        '<body name="cart" pos="0 0 0.6"><freejoint/><geom size="0.1" pos="0 0 -0.5"/>'
        '<body name="arm" pos="0 0 -0.5"><joint name="j" axis="0 0 1"/>'
        '<geom size="0.02" contype="0" conaffinity="0"/></body></body></worldbody>'
        '<actuator><position name="a" joint="j" kp="1" forcerange="-1 1"/></actuator>'
        '<keyframe><key name="home" qpos="0 0 0.6 1 0 0 0 0" ctrl="0"/></keyframe></mujoco>'
    )
    (finding,) = find_findings(audit_model(path), "keyframe-falls")
    start = finding.diagnostic.values["start"]
    assert isinstance(start, Quantity)
    assert start.value == pytest.approx(0.1, abs=1e-3)
    assert "has fallen or moved away: CoM height 0.1 m" in finding.message
    assert "质心" in finding.diagnostic.text("zh")


def test_a_keyframe_from_which_a_weld_lifts_the_robot_is_no_fall(tmp_path: Path) -> None:
    """By hand: the weld holds the base at 0.65 m, and the CoM is 46 mm below the base."""
    pair = standing(tmp_path)
    weld = '<equality><weld body1="trunk" relpose="0 0 -0.65 1 0 0 0"/></equality>'
    rewrite_file(pair.mjcf, ("</mujoco>", f"{weld}</mujoco>"))
    (finding,) = find_findings(audit_model(pair.mjcf), "keyframe-falls")
    end = finding.diagnostic.values["end"]
    assert isinstance(end, Quantity)
    assert end.value == pytest.approx(0.65 - 0.046, abs=0.01)
    for language, lifted, fallen in (("en", "is lifted", "fallen"), ("zh", "被提起", "倒下")):
        text = finding.diagnostic.text(language)
        assert lifted in text
        assert fallen not in text


def test_parallel_axes_beside_mirrored_axes_are_not_reported_as_opposite(tmp_path: Path) -> None:
    """Axes of three pairs: mirrored yaw and hip roll, parallel ankle roll."""
    legs = "".join(
        f'<body name="{side}_hip" pos="0 {y} 0"><joint name="{side}_hip_yaw" axis="0 0 {sign}"/>'
        f'<geom size="0.02"/><body name="{side}_thigh" pos="0 0 -0.1">'
        f'<joint name="{side}_hip_roll" axis="{sign} 0 0"/><geom size="0.02"/>'
        f'<body name="{side}_foot" pos="0 0 -0.2"><joint name="{side}_ankle_roll" axis="1 0 0"/>'
        '<geom size="0.02"/></body></body></body>'
        for side, y, sign in (("left", 0.1, 1), ("right", -0.1, -1))
    )
    path = tmp_path / "biped.xml"
    path.write_text(
        '<mujoco><worldbody><body name="trunk"><freejoint/><geom size="0.05"/>'
        f"{legs}</body></worldbody></mujoco>"
    )
    (finding,) = find_findings(audit_model(path), "mirror-axis")
    assert "ankle_roll" in finding.element
    assert finding.diagnostic.code == "mirror-axis-reversed"  # no claim about this axis alone


def test_excluded_contact_with_the_ground_is_named(tmp_path: Path) -> None:
    """All bits match, but the file excludes the contact of the only body with the world."""
    path = tmp_path / "excluded.xml"
    path.write_text(
        '<mujoco><worldbody><geom name="floor" type="plane" size="1 1 1"/>'
        '<body name="base" pos="0 0 1"><freejoint/><geom size="0.1"/></body></worldbody>'
        '<contact><exclude body1="world" body2="base"/></contact></mujoco>'
    )
    (finding,) = find_findings(audit_model(path), "ground-not-met")
    assert "excluded" in finding.message


def write_chain(folder: Path, origins: dict[int, str], shape: str) -> Path:
    """Write a chain of bars of 100 x 40 x 40 mm along x; hinges about y at the ends connect them.

    Args:
        folder: Folder of the file.
        origins: {number of a hinge from 1: other origin}.
        shape: Content of ``<geometry>`` of each bar.
    """
    inertial = '<inertial><mass value="0.1"/><inertia ixx="4e-5" iyy="1e-4" izz="1e-4" ixy="0" '
    links = "".join(
        f'<link name="l{n}">{inertial}ixz="0" iyz="0"/></inertial><visual><origin xyz="0.05 0 0"/>'
        f"<geometry>{shape}</geometry></visual></link>"
        for n in range(6)
    )
    joints = "".join(
        f'<joint name="j{n}" type="revolute"><origin xyz="{origins.get(n, "0.1 0 0")}"/>'
        f'<parent link="l{n - 1}"/><child link="l{n}"/><axis xyz="0 1 0"/>'
        '<limit lower="-1" upper="1" effort="2" velocity="9"/></joint>'
        for n in range(1, 6)
    )
    path = folder / "chain.urdf"
    path.write_text(f'<robot name="chain">{links}{joints}</robot>')
    return path


@pytest.mark.parametrize(
    ("origins", "message"),
    [
        ({}, None),
        ({3: "0.1 0 0.05"}, "axis passes the shapes of link 'l2' at a distance of 30 mm"),
        ({3: "0.1 0.1 0"}, "shapes of the links 'l2' and 'l3' are 60 mm apart at zero angles"),
        ({3: "0.1 0 0.05", 4: "0.1 0 0.05"}, None),  # of several, each may be simplified
    ],
)
def test_only_hinge_beside_its_links_is_found_by_meshes(
    origins: dict[int, str], message: str | None, tmp_path: Path
) -> None:
    """Reference: distances between the bars, and from the axis to the bars, in closed form."""
    trimesh.creation.box((0.1, 0.04, 0.04)).export(tmp_path / "bar.stl")
    path = write_chain(tmp_path, origins, '<mesh filename="bar.stl"/>')
    found = find_findings(audit_model(path), "joint-off-links")
    assert [(f.element, f.message) for f in found] == ([("joint 'j3'", message)] if message else [])
    path = write_chain(tmp_path, origins, '<box size="0.1 0.04 0.04"/>')
    assert not find_findings(audit_model(path), "joint-off-links")


def test_hinge_beside_its_links_is_found_in_an_mjcf_on_the_world(tmp_path: Path) -> None:
    """Reference: 30 mm, as for the URDF. The first of six hinges has no parent body."""
    trimesh.creation.box((0.1, 0.04, 0.04)).export(tmp_path / "bar.stl")
    bodies = ""
    for number in reversed(range(6)):
        place = f"{min(number, 1) / 10} 0 {0.05 if number == 3 else 0}"
        bodies = (
            f'<body name="l{number}" pos="{place}"><joint name="j{number}" axis="0 1 0"/>'
            '<geom type="mesh" mesh="bar" pos="0.05 0 0" contype="0" conaffinity="0" mass="0.1"/>'
            f"{bodies}</body>"
        )
    path = tmp_path / "chain.xml"
    asset = '<asset><mesh name="bar" file="bar.stl"/></asset>'
    path.write_text(f"<mujoco>{asset}<worldbody>{bodies}</worldbody></mujoco>")
    (found,) = find_findings(audit_model(path), "joint-off-links")
    assert found.element == "joint 'j3'"
    assert found.message == "axis passes the shapes of link 'l2' at a distance of 30 mm"


@pytest.mark.parametrize(
    ("bare", "place", "kind", "names"),
    [
        ((5,), 0.12, "revolute", ["l5"]),
        ((4, 5), 0.12, "revolute", []),
        ((), 0.12, "revolute", []),
        ((5,), 0.05, "revolute", []),  # the fixed link has the collision shape of the link
        ((5,), 0.12, "continuous", []),  # as the rotor of a lidar
    ],
)
def test_lost_shape_of_a_light_link_is_found_although_a_tool_has_shapes(
    bare: tuple[int, ...], place: float, kind: str, names: list[str], tmp_path: Path
) -> None:
    """As the last wrist link of UR5: 1 % of the mass, with a fixed tool that collides.

    ``place`` is the centre of the tool on the x axis of the link, which is drawn from 0 to 0.1 m.
    """
    shape = '<box size="0.1 0.04 0.04"/>'
    path = write_chain(tmp_path, {}, shape)
    visual, solid = "</visual></link>", f"<collision><geometry>{shape}</geometry></collision>"
    head, *links, tail = path.read_text().replace('"0.1"', '"9"', 5).split(visual)
    text = head + "".join(
        f"</visual>{'' if n in bare else solid}</link>{link}"
        for n, link in enumerate([*links, tail])
    )
    text = text.replace('"j5" type="revolute"', f'"j5" type="{kind}"')
    tool = f'<link name="tool">{solid}</link><joint name="fixed" type="fixed"><parent link="l5"/>'
    origin = f'<origin xyz="{place} 0 0"/><child link="tool"/></joint></robot>'
    path.write_text(text.replace("</robot>", f"{tool}{origin}"))
    found = find_findings(audit_model(path), "moving-link-without-collision")
    assert [finding.element for finding in found] == [f"link {name!r}" for name in names]


@pytest.mark.parametrize(("mass", "names"), [("0.2", []), ("0.9", ["l3"])])
def test_light_link_between_others_needs_no_collision_shape(
    mass: str, names: list[str], tmp_path: Path
) -> None:
    """As the cross of a waist: 0.4 % of the mass, and 2 % for comparison."""
    shape = '<box size="0.1 0.04 0.04"/>'
    path = write_chain(tmp_path, {}, shape)
    visual, solid = "</visual></link>", f"<collision><geometry>{shape}</geometry></collision>"
    head, *links = path.read_text().replace('"0.1"', '"9"').split(visual)
    text = head + "".join(
        f"</visual>{'' if number == 3 else solid}</link>{link}" for number, link in enumerate(links)
    )
    start = text.index('<link name="l3">')
    path.write_text(text[:start] + text[start:].replace('value="9"', f'value="{mass}"', 1))
    found = find_findings(audit_model(path), "moving-link-without-collision")
    assert [finding.element for finding in found] == [f"link {name!r}" for name in names]


@pytest.mark.parametrize(("names", "count"), [("knee", 0), ("hip_yaw", 1)])
def test_names_of_a_single_leg_are_no_evidence_in_another_base_frame(
    names: str, count: int, tmp_path: Path
) -> None:
    """All hinges of the chain turn about y. In a file of one leg, y may point forwards."""
    path = write_chain(tmp_path, {}, '<box size="0.1 0.04 0.04"/>')
    text = path.read_text().replace('<axis xyz="0 1 0"', '<axis xyz="0 0 1"')
    text = text.replace('<axis xyz="0 0 1"', '<axis xyz="0 0 1"').replace('"j2"', f'"{names}"')
    path.write_text(text if not count else text.replace("0 0 1", "0 1 0").replace('"j3"', '"knee"'))
    found = find_findings(audit_model(path), "axis-contradicts-name")
    assert [finding.element for finding in found] == ["joint 'hip_yaw'"] * count


@pytest.mark.parametrize(("place", "count"), [("0", 0), ("-0.1", 1)])
def test_displaced_leg_of_a_biped_is_found_although_no_pair_is_mirrored(
    place: str, count: int, tmp_path: Path
) -> None:
    """The left hip is 100 mm behind, and all links of the leg with it."""
    inertial = (
        '<inertial><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" '
        'iyz="0"/></inertial>'
    )
    text = f'<link name="base">{inertial}</link>'
    for side, y in (("left", 0.1), ("right", -0.1)):
        above = "base"
        for part in ("hip", "thigh", "shin", "foot"):
            origin = f"{place if side == 'left' else 0} {y} 0" if part == "hip" else "0.01 0 -0.2"
            text += (
                f'<link name="{side}_{part}">{inertial}</link><joint name="{side}_{part}" '
                f'type="revolute"><origin xyz="{origin}"/><parent link="{above}"/>'
                f'<child link="{side}_{part}"/><axis xyz="0 1 0"/>'
                '<limit lower="-1" upper="1" effort="50" velocity="9"/></joint>'
            )
            above = f"{side}_{part}"
    path = tmp_path / "biped.urdf"
    path.write_text(f'<robot name="biped">{text}</robot>')
    found = find_findings(audit_model(path), "mirror-position")
    assert [finding.element for finding in found] == ["joint 'right_hip'"] * count
    if count:
        assert found[0].diagnostic.values["gap"].value == pytest.approx(0.1)
        assert len(found[0].repairs) == 2  # nothing decides which of both is wrong


@pytest.mark.parametrize(("angle", "count"), [("3.14159265358979", 0), ("0", 1)])
def test_copy_of_a_part_that_is_mounted_turned_is_no_mirror_image(
    angle: str, count: int, tmp_path: Path
) -> None:
    """As the drives of ANYmal's knees: one part, turned by half a turn about z on the other side.

    Its products of inertia are those of the turned part, with the other sign of ixz and iyz. With
    the same orientation, the tensor should be mirrored.
    """
    trimesh.creation.box((0.1, 0.1, 0.1)).export(tmp_path / "drive.stl")
    links, joints = "", ""
    for side, y, turn in (("left", "0.2", "0"), ("right", "-0.2", angle)):
        links += (
            f'<link name="{side}_knee"><inertial><mass value="2"/><inertia ixx="0.004" '
            'iyy="0.005" izz="0.006" ixy="0.001" ixz="0.001" iyz="0.001"/></inertial><visual>'
            '<geometry><mesh filename="drive.stl"/></geometry></visual></link>'
        )
        joints += (
            f'<joint name="{side}_knee" type="revolute"><origin xyz="0 {y} 0" rpy="0 0 {turn}"/>'
            f'<parent link="base"/><child link="{side}_knee"/><axis xyz="0 1 0"/>'
            '<limit lower="-1" upper="1" effort="9" velocity="9"/></joint>'
        )
    base = (
        '<link name="base"><inertial><mass value="5"/><inertia ixx="0.1" iyy="0.1" izz="0.1" '
        'ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )
    path = tmp_path / "robot.urdf"
    path.write_text(f'<robot name="robot">{base}{links}{joints}</robot>')
    found = find_findings(audit_model(path), "mirror-inertia")
    assert [finding.element for finding in found] == ["link 'right_knee'"] * count


def test_only_opposite_axis_of_a_serial_chain_is_noted(tmp_path: Path) -> None:
    """With another opposite axis, a second hinge at a link or two arms, the sign may be a choice.

    The two arms have two and three hinges, and the second begins with a slide on a rail.
    """
    path = write_chain(tmp_path, {}, '<box size="0.1 0.04 0.04"/>')
    text = path.read_text()
    axes = {"j2": '<child link="l2"/><axis xyz="0 ', "j4": '<child link="l4"/><axis xyz="0 '}
    once = text.replace(f"{axes['j4']}1", f"{axes['j4']}-1")
    twice = once.replace(f"{axes['j2']}1", f"{axes['j2']}-1")
    branched = once.replace('<parent link="l4"/>', '<parent link="l3"/>')
    rail = '<link name="rail"/><joint name="slide" type="prismatic"><parent link="l0"/><child '
    limit = 'link="rail"/><limit lower="0" upper="1" effort="2" velocity="9"/></joint></robot>'
    arms = once.replace('<parent link="l2"/>', '<parent link="rail"/>')
    arms = arms.replace("</robot>", f"{rail}{limit}")
    messages = []
    for changed in (text, once, twice, branched, arms):
        path.write_text(changed)
        found = find_findings(audit_model(path), "axis-sign-odd")
        messages.append([(f.element, str(f.severity), f.message) for f in found])
    said = (
        "axis (0, -1, 0) in the joint frame is opposite to "
        "the axes of the 4 other joints of the chain"
    )
    assert messages == [[], [("joint 'j4'", "note", said)], [], [], []]


@pytest.mark.parametrize(
    ("legs", "height", "is_found"),
    [
        (LEGS, -0.06, False),
        (LEGS[1:], -0.06, False),
        (("FL",), -0.06, True),
        (LEGS, 0.0, True),  # the thigh draws the shape, but its joint is elsewhere
    ],
)
def test_shape_that_the_next_link_draws_is_accepted_if_several_legs_are_alike(
    legs: tuple[str, ...], height: float, is_found: bool, tmp_path: Path
) -> None:
    """As the hips of Go1, whose collision shapes are at the shoulders that the thighs draw.

    The ball of each hip moves 60 mm down, into the drawn thigh, which is 80 mm long. The joint of
    the thigh is there as well. If a hip has a defect, the shapes of the other hips remain accepted.
    """
    edits = [
        Edit(f'<link name="{leg}_hip">', r'(?s)(<collision>\s*)<origin xyz="0 0 0"/>',
             r'\g<1><origin xyz="0 0 -0.06"/>')
        for leg in legs
    ]  # fmt: skip
    edits += [
        Edit(f'<joint name="{leg}_HFE"', r'<origin xyz="0 0 0"/>', f'<origin xyz="0 0 {height}"/>')
        for leg in LEGS
    ]
    audit = audit_model(write_model(tmp_path, "urdf", tuple(edits)))
    names = {finding.element for finding in find_findings(audit, "collision-off-visual")}
    assert names == ({f"link '{leg}_hip'" for leg in legs} if is_found else set())


@pytest.mark.parametrize(("moved", "is_found"), [(("link", "joint"), False), ((), True)])
def test_frame_of_a_hinge_along_its_axis_is_no_difference_of_the_sides(
    moved: tuple[str, ...], is_found: bool, tmp_path: Path
) -> None:
    """The position along the axis is free if CoM, shapes and next joint stay where they are.

    The frame of a hip moves by 20 mm along y, and all that it contains by -20 mm.
    """
    tree = etree.fromstring(OWN["urdf"].read_bytes())
    places = [(tree.find("joint[@name='FR_HFE']/origin"), 0.02)]
    if "link" in moved:
        places += [(place, -0.02) for place in tree.iterfind("link[@name='FR_thigh']/*/origin")]
    if "joint" in moved:
        places += [(tree.find("joint[@name='FR_KFE']/origin"), -0.02)]
    for place, step in places:
        assert place is not None
        x, y, z = map(float, place.get("xyz", "0 0 0").split())
        place.set("xyz", f"{x} {y + step} {z}")
    path = tmp_path / "robot.urdf"
    path.write_bytes(etree.tostring(tree))
    found = [f.element for f in audit_model(path).findings if f.rule.startswith("mirror")]
    assert found == (["joint 'FR_HFE'"] if is_found else [])


def test_displacement_of_a_shank_along_its_axis_is_found(tmp_path: Path) -> None:
    """The shank and its CoM move by 2 mm with the joint: less than the tolerance of a CoM."""
    place = r'(<joint name="FR_KFE".*?<origin xyz="\S+ )(\S+)'
    text = OWN["urdf"].read_text()
    (found,) = re.findall(place, text, flags=re.DOTALL)
    moved = rf"\g<1>{float(found[1]) + 0.002}"
    path = tmp_path / "robot.urdf"
    path.write_text(re.sub(place, moved, text, flags=re.DOTALL))
    names = [f.element for f in find_findings(audit_model(path), "mirror-position")]
    assert names == ["joint 'FR_KFE'"]


SIDES = {"left": 1.0, "right": -1.0}


def write_two_arms(path: Path, side: Callable[[str, str], float]) -> Path:
    """Write a fixed robot with two arms of four links; lateral numbers have the sign of ``side``.

    Args:
        path: The file.
        side: Called with the name of a side and of a number; returns the sign of the number.
    """
    parts = ['<robot name="arms"><link name="base"/>']
    for name, sign in SIDES.items():
        parent, place = "base", f"0 {sign * 0.2} 0.4"
        for index in range(4):
            link, y = f"{name}_arm_{index}", 0.01 * (index + 2)
            com, product = (side(name, f"{of}{index}") for of in ("com", "product"))
            tensor = f'ixx="0.02000" iyy="0.02000" izz="0.01000" ixy="{product * 0.00412:.5f}"'
            parts.append(
                f'<link name="{link}"><inertial><origin xyz="0.01 {com * y} 0.05"/>'
                f'<mass value="2"/><inertia {tensor} ixz="0" iyz="0"/></inertial></link>'
                f'<joint name="{link}" type="revolute"><parent link="{parent}"/>'
                f'<child link="{link}"/><origin xyz="{place}"/><axis xyz="0 1 0"/>'
                '<limit lower="-1" upper="1" effort="50" velocity="5"/></joint>'
            )
            parent, place = link, f"0 {side(name, f'offset{index}') * 0.05 * (index == 0)} 0.2"
    path.write_text("\n".join([*parts, "</robot>"]))
    return path


def find_mirror_findings(path: Path) -> list[str]:
    """Return the rules about left and right that have a finding, once each."""
    return sorted({f.rule for f in audit_model(path).findings if f.rule.startswith("mirror")})


@pytest.mark.parametrize(
    ("lost", "expected"),
    [
        ("", []),
        ("com2", ["mirror-com"]),
        ("product2", ["mirror-inertia"]),
        ("offset0", ["mirror-position"]),
        ("com product", ["mirror-com", "mirror-inertia"]),
        ("com product offset", []),
    ],
)
def test_copied_limbs_are_no_mirror_images_and_lost_signs_are(
    lost: str, expected: list[str], tmp_path: Path
) -> None:
    """A limb whose numbers are all equal is a second copy of an arm, not a mirror image.

    Inertials that are equal on both sides of a mirrored offset between joints are a defect.
    """

    def choose_sign(name: str, number: str) -> float:
        return 1.0 if any(number.startswith(word) for word in lost.split()) else SIDES[name]

    path = write_two_arms(tmp_path / "robot.urdf", choose_sign)
    assert find_mirror_findings(path) == expected


def test_copied_limb_with_another_com_is_no_mirror_image(tmp_path: Path) -> None:
    """One number that differs between two equal arms does not make the arms mirror images."""

    def choose_sign(name: str, number: str) -> float:
        return SIDES[name] if number == "com2" else 1.0

    assert find_mirror_findings(write_two_arms(tmp_path / "robot.urdf", choose_sign)) == []


@pytest.mark.parametrize("mass", ["0.01", "0.02"])
def test_efforts_are_not_compared_with_placeholder_masses(mass: str, tmp_path: Path) -> None:
    """If the masses are the default of an exporter, the message names the masses alone."""
    path = write_two_arms(tmp_path / "robot.urdf", lambda side, _: SIDES[side])
    path.write_text(path.read_text().replace('mass value="2"', f'mass value="{mass}"'))
    rules = {finding.rule for finding in audit_model(path).findings}
    expected = "inertial-placeholder" if mass == "0.01" else "effort-placeholder"
    assert rules & {"inertial-placeholder", "effort-placeholder"} == {expected}


def test_visual_geoms_add_no_mass_if_inertias_are_not_computed_from_geoms(tmp_path: Path) -> None:
    """With inertiafromgeom="false" MuJoCo computes no mass from geoms."""
    path = tmp_path / "robot.xml"
    body = (
        '<body name="{name}" pos="0 {y} 1"><joint name="{name}"/>{inertial}'
        '<geom name="{name}_ball" size="0.05"/>'
        '<geom name="{name}_box" type="box" size="0.1 0.1 0.1" contype="0" conaffinity="0"/></body>'
    )
    inertial = '<inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>'
    bodies = body.format(name="a", y=0, inertial=inertial)
    for option, count in (("auto", 1), ("false", 0)):
        path.write_text(
            f'<mujoco><compiler inertiafromgeom="{option}" boundmass="1e-6"/><worldbody>{bodies}'
            f"{body.format(name='b', y=1, inertial='')}</worldbody></mujoco>"
        )
        audit = audit_model(path)
        findings = [item for item in audit.findings if item.rule == "visual-adds-mass"]
        found = [item.element for item in findings]
        assert found == ["geom 'b_box'"] * count, option


@pytest.mark.parametrize(
    ("head", "joint", "option", "severity"),
    [
        ('gravcomp="0.5"', "", "", "warning"),
        ('gravcomp="1.5"', "", "", "warning"),
        ('gravcomp="0.5"', 'actuatorgravcomp="true"', "", "note"),
        ('gravcomp="-0.5"', "", "", None),
        ('gravcomp="0.5"', "", '<flag gravity="disable"/>', None),
    ],
)
def test_weight_that_gravcomp_bears_is_that_of_mujoco(
    head: str, joint: str, option: str, severity: str | None, tmp_path: Path
) -> None:
    """Reference: MuJoCo's qfrc_gravcomp along gravity, of a slide with 2 kg below 3 kg."""
    path = tmp_path / "robot.xml"
    path.write_text(f"""<mujoco><option>{option}</option><worldbody><body><joint type="slide"
      axis="0 0 1" {joint}/><geom size="0.1" mass="3"/><body name="tip" {head}>
      <geom size="0.1" mass="2"/></body></body></worldbody></mujoco>""")
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    found = find_findings(audit_model(path), "gravity-compensated")
    assert [finding.severity for finding in found] == ([] if severity is None else [severity])
    for finding in found:
        assert finding.diagnostic.values["weight"].value == pytest.approx(data.qfrc_gravcomp[0])
        assert finding.diagnostic.values["share"] == pytest.approx(
            data.qfrc_gravcomp[0] / (5 * 9.81)
        )
        assert data.qfrc_actuator[0] == 0.0  # no motor bears this weight
    if severity is None:
        assert data.qfrc_gravcomp[0] == 0.0
