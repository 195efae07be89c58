"""Repairs of findings: planted faults are replaced by the original number, and all other bytes are
unchanged.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import mujoco
import pytest
import trimesh
from click.testing import CliRunner

from pupper_analysis.cli import group
from pupper_analysis.models.urdf_file import read_urdf
from pupper_analysis.tools.audit.audit import Audit, audit_model
from pupper_analysis.tools.audit.document import describe_repair
from pupper_analysis.tools.audit.fix import apply_repairs, list_estimates, write_documents
from pupper_analysis.tools.audit.registry import ValueRepair
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
        dict(repair.new)
        for finding in audit.findings
        if finding.rule == rule
        for repair in finding.repairs
    ]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("after", "old", "new", "rule"),
    [
        ('<link name="FR_calf">', 'value="0.05"', 'value="0.5"', "mirror-mass"),
        ('<link name="FL_calf">', 'value="0.05"', 'value="0.0005"', "mirror-mass"),
        ('<link name="FL_calf">', 'value="0.05"', 'value="0"', "mass-not-positive"),
        ('<link name="RR_calf">', '"0 0 -0.055"', '"0 0 0.4"', "com-outside-shapes"),
        ('<link name="RR_calf">', '"0 0 -0.055"', '"0 0.007 -0.055"', "mirror-com"),
        ('<link name="RR_calf">', '"0 0 -0.055"', '"0 0 -55"', "com-outside-shapes"),
        ('<link name="FR_calf">', 'izz="2.9538', 'izz="18.9538', "mirror-inertia"),
        ('<joint name="FL_HFE"', '"0 1 0"', '"0 3 0"', "axis-not-unit"),
        ('<joint name="FL_HFE"', 'type="revolute"', 'type="fixed"', "mirror-type"),
        ('<joint name="RL_KFE"', '"0 1 0"', '"0 0 0"', "axis-zero"),
        ('<joint name="RR_HAA"', '"1 0 0"', '"-1 0 0"', "mirror-axis"),
        ('<joint name="RR_KFE"', '"0 0 -0.08"', '"0 0 -0.03"', "mirror-position"),
        (
            '<joint name="FR_HFE"',
            'lower="-1.8" upper="1.2"',
            'lower="1.2" upper="-1.8"',
            "range-empty",
        ),
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


def test_repair_is_written_over_numbers_with_several_spaces(tmp_path: Path) -> None:
    """As in HyQ: rpy="0 -1.57079632679  0". Reference: the original numbers."""
    path = plant_text(tmp_path, '<link name="RR_calf">', '"0 0 -0.055"', '" 0   0  0.4"')
    audit = audit_model(path)
    documents, count = apply_repairs([audit])
    assert count == 1
    write_documents(documents)
    assert path.read_bytes() == read_original()


@pytest.mark.parametrize("wrong", ["FL", "FR", "RL", "RR"])
def test_reversed_axis_of_mirrored_hips_is_named_by_their_ranges(
    wrong: str, tmp_path: Path
) -> None:
    """As in HyQ: hips of the left legs turn about -x, those of the right legs about +x.

    With one axis reversed, one pair contradicts mirrored axes, and the other pair parallel axes.
    Ranges from -70 to 25 degrees fit mirrored axes only. Reference: the original axis.
    """
    text = URDF.read_text()
    for leg in ("FL", "FR", "RL", "RR"):
        start = text.index(f'<joint name="{leg}_HAA"')
        end = text.index("</joint>", start)
        is_left = (leg[1] == "L") is not (leg == wrong)
        joint = text[start:end].replace('"1 0 0"', '"-1 0 0"' if is_left else '"1 0 0"')
        joint = re.sub('lower="[^"]*" upper="[^"]*"', 'lower="-1.2" upper="0.4"', joint)
        text = text[:start] + joint + text[end:]
    path = tmp_path / URDF.name
    path.write_text(text)
    audit = audit_model(path)
    (found,) = (finding for finding in audit.findings if finding.rule == "mirror-axis")
    assert found.element == f"joint '{wrong}_HAA'"
    assert repairs_of(audit, "mirror-axis") == [{"xyz": "-1 0 0" if wrong[1] == "L" else "1 0 0"}]


@pytest.mark.parametrize("angles", ["0.3 0 0", "0 0.3 0"])
def test_turned_joint_is_repaired_if_its_child_is_displaced(angles: str, tmp_path: Path) -> None:
    """A turn of the knee by 0.3 rad displaces the foot, whose own origin is right."""
    path = plant_text(tmp_path, '<joint name="FR_KFE"', 'xyz="', f'rpy="{angles}" xyz="')
    audit = audit_model(path)
    assert repairs_of(audit, "mirror-position") == [{"rpy": "0 0 0"}]
    documents, count = apply_repairs([audit])
    assert count == 1
    write_documents(documents)
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


def test_patch_of_a_machine_format_is_on_standard_error(tmp_path: Path) -> None:
    """Standard output is a SARIF document; the last message counts the findings that are left."""
    path = write_arm(tmp_path, '<mass value="0.06"/>' + TENSOR_OF_ZEROS, SPHERE)
    typed = ["audit", str(path), "--fix", "--yes", "--format", "sarif"]
    shown = CliRunner().invoke(group, typed)
    assert json.loads(shown.stdout)["runs"]
    assert "+++ b/arm.urdf\n@@ " in shown.stderr
    assert shown.stderr.endswith("1 repair written; remaining: 0 errors, 2 warnings, 0 notes\n")


@pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")
def test_only_force_writes_a_file_with_uncommitted_changes(tmp_path: Path) -> None:
    path = write_arm(tmp_path, '<mass value="0.06"/>' + TENSOR_OF_ZEROS, SPHERE)
    for words in (["init", "--quiet"], ["add", path.name]):  # added, but not committed
        subprocess.run(["git", *words], cwd=tmp_path, check=True)
    before, typed = path.read_bytes(), ["audit", str(path), "--fix", "--yes"]
    refused = CliRunner().invoke(group, typed)
    assert "commit the changes, or add --force" in str(refused.exception)
    assert path.read_bytes() == before
    CliRunner().invoke(group, [*typed, "--force"])
    assert audit_model(path).passed


def test_repair_of_a_value_from_a_xacro_macro_is_named_and_not_written(tmp_path: Path) -> None:
    """Two joints have limits in degrees; a macro states one, the file itself the other."""
    path = write_arm(tmp_path, '<mass value="0.06"/>' + TENSOR_OF_ZEROS, SPHERE)
    begin, end = path.read_text().split('<joint name="turn"')
    joint = f'<joint name="turn"{end}'.replace('lower="-1"', 'lower="-90"').removesuffix("</robot>")
    macro = joint.replace('"turn"', '"${name}"').replace('"rod"', '"${name}rod"')
    begin = begin.replace("<robot", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"')
    path = tmp_path / "arm.urdf.xacro"
    path.write_text(
        f'{begin}<link name="arod"/><xacro:macro name="part" params="name">{macro}</xacro:macro>'
        f'<xacro:part name="a"/>{joint}</robot>'
    )
    shown = CliRunner().invoke(group, ["audit", str(path), "--xacro", "--fix", "-v"])
    change = "joint 'a': limit lower -90 -> -1.5708, upper 1 -> 0.0174533 (degrees to radians)"
    assert f"repair: {change}; --fix does not write it" in shown.stdout
    assert f"repair: {change}; --fix does not write it" in shown.stderr
    added = [line for line in shown.stdout.splitlines() if line.startswith("+<")]
    assert added
    assert all(line.count('lower="-1.5708"') == line.count('lower="-90"') == 1 for line in added)
    fixed = CliRunner().invoke(group, ["audit", str(path), "--xacro", "--fix", "--yes"])
    assert " written; remaining: " in fixed.stderr


def test_sarif_contains_the_bytes_of_the_repair(tmp_path: Path) -> None:
    """Reference: the original file, after replacing the byte region of SARIF."""
    path = plant_text(tmp_path, '<link name="FR_calf">', 'value="0.05"', 'value="0.5"')
    shown = CliRunner().invoke(group, ["audit", str(path), "--format", "sarif"])
    (run,) = json.loads(shown.stdout)["runs"]
    ((fix,),) = [result["fixes"] for result in run["results"] if "fixes" in result]
    ((replacement,),) = [change["replacements"] for change in fix["artifactChanges"]]
    region, data = replacement["deletedRegion"], path.read_bytes()
    start, end = region["byteOffset"], region["byteOffset"] + region["byteLength"]
    mended = data[:start] + replacement["insertedContent"]["text"].encode() + data[end:]
    assert mended == read_original()


def find_first(audit: Audit) -> tuple[str, str, list[ValueRepair]]:
    """Return severity, rule and repairs of the first finding."""
    first = audit.findings[0]
    return str(first.severity), first.rule, list(first.repairs)


@pytest.mark.slow
def test_mass_and_inertia_in_grams_are_one_error_with_one_repair(tmp_path: Path) -> None:
    """Reference: the original file. The difference of the sides is a consequence."""
    text = URDF.read_text()
    start = text.index('<link name="FL_calf">')
    end = text.index("</inertial>", start)

    def enlarge(match: re.Match[str]) -> str:
        return f'{match[1]}="{1000 * float(match[2]):.17g}"'

    part = re.sub(r'(value|i[xyz]{2})="([^"]*)"', enlarge, text[start:end])
    path = tmp_path / "robot.urdf"
    path.write_text(text[:start] + part + text[end:])
    audit = audit_model(path)
    severity, rule, repairs = find_first(audit)
    assert (severity, rule, len(repairs)) == ("error", "density-implausible", 1)
    assert "mirror-mass" in {finding.rule for finding in audit.findings}
    write_documents(apply_repairs([audit])[0])
    repaired, original = (read_urdf(file).tree.links["FL_calf"].inertia for file in (path, URDF))
    assert repaired is not None
    assert original is not None
    assert repaired.isApprox(original, 1e-5)


@pytest.mark.slow
def test_lost_inertial_is_copied_from_the_mirrored_link(tmp_path: Path) -> None:
    """Reference: Pinocchio's inertia of the original link."""
    text = URDF.read_text()
    start = text.index("<inertial>", text.index('<link name="RR_thigh">'))
    end = text.index("</inertial>", start) + len("</inertial>")
    path = tmp_path / "robot.urdf"
    path.write_text(text[:start] + text[end:])
    audit = audit_model(path)
    assert find_first(audit)[1] == "moving-body-without-mass"
    write_documents(apply_repairs([audit])[0])
    repaired, original = (read_urdf(file).tree.links["RR_thigh"].inertia for file in (path, URDF))
    assert repaired is not None
    assert original is not None
    assert repaired.isApprox(original, 1e-5)
    assert audit_model(path).counts == audit_model(URDF).counts


@pytest.mark.parametrize("wrong", ["FL", "FR", "RL", "RR"])
def test_lost_shape_is_named_on_the_leg_that_deviates(wrong: str, tmp_path: Path) -> None:
    """The calf keeps the sphere of its foot. Three equal legs show which calf deviates."""
    text = URDF.read_text()
    start = text.index(f'<link name="{wrong}_calf">')
    calf = text[start : text.index("</link>", start)]
    path = tmp_path / URDF.name
    path.write_text(text.replace(calf, re.sub("(?s)<collision>.*?</collision>", "", calf)))
    found = [finding for finding in audit_model(path).findings if finding.rule == "mirror-shapes"]
    assert [finding.element for finding in found] == [f"link '{wrong}_calf'"]


def test_number_that_the_other_legs_share_is_copied_and_not_mirrored(tmp_path: Path) -> None:
    """Four equal calves with a CoM 1.4 mm aside, as in Unitree's Go1: the original numbers."""
    text = URDF.read_text()
    for leg in ("FL", "FR", "RL", "RR"):
        start = text.index(f'<link name="{leg}_calf">')
        text = text[:start] + text[start:].replace('"0 0 -0.055"', '"0 0.0014 -0.055"', 1)
    path = tmp_path / URDF.name
    start = text.index('<link name="FL_calf">')
    inertial = text[text.index("<inertial>", start) : text.index("</inertial>", start)]
    displaced = inertial.replace('"0 0.0014 -0.055"', '"0 0.0014 0.4"')
    path.write_text(text[:start] + text[start:].replace(inertial, displaced, 1))
    audit = audit_model(path)
    assert repairs_of(audit, "com-outside-shapes") == [{"xyz": "0 0.0014 -0.055"}]
    path.write_text(text[:start] + text[start:].replace(f"{inertial}</inertial>", "", 1))
    (repair,) = next(
        finding.repairs
        for finding in audit_model(path).findings
        if finding.rule == "link-without-inertial"
    )
    numbers = [dict(part.new) for part in (repair, *repair.further)]
    assert numbers[0]["xyz"] == "0 0.0014 -0.055"
    assert [part["value"] for part in numbers if "value" in part] == ["0.05"]


def test_com_repair_keeps_the_coordinates_that_agree_with_the_other_side(tmp_path: Path) -> None:
    """The CoMs of both front calves are 0.7 mm to the left, within the tolerance of a mirror image.

    Only the height of one CoM is wrong. Reference: the original numbers. The arms of TALOS are
    published with such CoMs.
    """
    text = URDF.read_text()
    for leg, height in (("FL", "-0.055"), ("FR", "0.4")):
        start = text.index(f'<link name="{leg}_calf">')
        com = f'"0 0.0007 {height}"'
        text = text[:start] + text[start:].replace('"0 0 -0.055"', com, 1)
    path = tmp_path / URDF.name
    path.write_text(text)
    assert repairs_of(audit_model(path), "com-outside-shapes") == [{"xyz": "0 0.0007 -0.055"}]


@pytest.mark.slow
def test_displaced_or_lost_collision_shape_is_that_of_another_limb(tmp_path: Path) -> None:
    """Reference: the numbers of the original collision shape."""
    text = URDF.read_text()
    start = text.index("<collision>", text.index('<link name="RL_hip">'))
    end = text.index("</collision>", start) + len("</collision>")
    moved = text[start:end].replace('"0 0 0"', '"0.1 0 0"')
    path = tmp_path / "robot.urdf"
    for changed in (text[:start] + moved + text[end:], text[:start] + text[end:]):
        path.write_text(changed)
        audit = audit_model(path)
        assert find_first(audit)[1] in ("collision-off-visual", "moving-link-without-collision")
        write_documents(apply_repairs([audit])[0])
        (shape,) = read_urdf(path).tree.links["RL_hip"].element.findall("collision")
        assert shape.find("geometry/sphere").get("radius") == "0.026"
        assert shape.find("origin").get("xyz") == "0 0 0"


def test_broken_mesh_path_becomes_the_existing_file(tmp_path: Path) -> None:
    """The suffix of the path, or its capitals, are wrong."""
    mesh = trimesh.creation.box((0.1, 0.1, 0.1))
    mesh.export(tmp_path / "Body.stl")
    path = tmp_path / "robot.urdf"
    for name in ("Body.stl.missing", "body.STL"):
        path.write_text(
            '<robot name="r"><link name="b"><inertial><mass value="1"/><inertia ixx="0.002"'
            ' iyy="0.002" izz="0.002" ixy="0" ixz="0" iyz="0"/></inertial><collision><geometry>'
            f'<mesh filename="{name}"/></geometry></collision></link></robot>'
        )
        if (tmp_path / name).exists():  # a file system without capitals
            continue
        assert repairs_of(audit_model(path), "mesh-missing") == [{"filename": "Body.stl"}]


def test_backslashes_in_mesh_paths_become_slashes(tmp_path: Path) -> None:
    """In an MJCF MuJoCo accepts backslashes."""
    (tmp_path / "meshes").mkdir()
    for name in ("a", "b"):
        trimesh.creation.box((0.1, 0.1, 0.1)).export(tmp_path / "meshes" / f"{name}.stl")
    shapes = "".join(
        f'<collision><geometry><mesh filename="meshes\\{name}.stl"/></geometry></collision>'
        for name in ("a", "b")
    )
    urdf, mjcf = tmp_path / "robot.urdf", tmp_path / "robot.xml"
    urdf.write_text(f'<robot name="r"><link name="b">{shapes}</link></robot>')
    (finding,) = [
        finding for finding in audit_model(urdf).findings if finding.rule == "mesh-missing"
    ]
    (repair,) = finding.repairs
    changes = [change.new["filename"] for change in (repair, *repair.further)]
    assert changes == ["meshes/a.stl", "meshes/b.stl"]
    mjcf.write_text(
        '<mujoco><asset><mesh file="meshes\\a.stl"/></asset><worldbody><body><joint/>'
        '<geom type="mesh" mesh="a"/></body></worldbody></mujoco>'
    )
    assert mujoco.MjModel.from_xml_path(str(mjcf)).nmesh == 1
    assert not audit_model(mjcf).findings


@pytest.mark.slow
@pytest.mark.parametrize(("factor", "repair"), [(1000.0, 0.001), (0.001, 1000.0)])
def test_all_lengths_in_a_wrong_unit_are_the_first_error(
    factor: float, repair: float, tmp_path: Path
) -> None:
    def scale(match: re.Match[str]) -> str:
        values = " ".join(repr(factor * float(part)) for part in match[2].split())
        return f'{match[1]}="{values}"'

    path = tmp_path / "robot.urdf"
    path.write_text(re.sub(r'(xyz|size|radius|length)="([^"]*)"', scale, URDF.read_text()))
    first = audit_model(path).findings[0]
    assert first.diagnostic.code == "joints-out-of-scale"
    assert first.diagnostic.values["factor"] == repair


@pytest.mark.slow
def test_limits_in_degrees_of_a_wide_range_are_found_by_the_other_limbs(tmp_path: Path) -> None:
    """A range of 10 rad is 573 degrees, which alone may mean no limit."""
    text = URDF.read_text().replace('lower="-1.8" upper="1.2"', 'lower="-10" upper="10"')
    start = text.index('<joint name="FL_HFE"')
    changed = text[start:].replace('lower="-10" upper="10"', 'lower="-573" upper="573"', 1)
    path = tmp_path / "robot.urdf"
    path.write_text(text[:start] + changed)
    first = audit_model(path).findings[0]
    assert first.rule == "limits-in-wrong-unit"
    assert [dict(repair.new) for repair in first.repairs] == [
        {"lower": "-10.0007", "upper": "10.0007"}
    ]


def write_dense_arm(path: Path, dense_mass: float) -> None:
    """Write a URDF of four cylinders, of which the link `b` has the given mass [kg]."""
    links, joints = "", ""
    sizes = {"base": (2.0, 0.08, 0.1), "a": (4.0, 0.06, 0.16), "b": (dense_mass, 0.055, 0.36)}
    previous = ""
    for name, (mass, radius, length) in {**sizes, "c": (2.4, 0.045, 0.3)}.items():
        moment = mass * length**2 / 12 if mass < 9 else 0.55
        links += (
            f'<link name="{name}"><inertial><mass value="{mass}"/><inertia ixx="{moment}"'
            f' iyy="{moment}" izz="{moment / 2}" ixy="0" ixz="0" iyz="0"/></inertial><collision>'
            f'<geometry><cylinder radius="{radius}" length="{length}"/></geometry></collision>'
            "</link>"
        )
        if previous:
            joints += (
                f'<joint name="to_{name}" type="revolute"><parent link="{previous}"/>'
                f'<child link="{name}"/><axis xyz="0 1 0"/>'
                '<limit lower="-2" upper="2" effort="150" velocity="3"/></joint>'
            )
        previous = name
    path.write_text(f'<robot name="arm">{links}{joints}</robot>')


def test_mass_from_the_density_of_other_links_is_named_and_not_written(tmp_path: Path) -> None:
    """The density is 31 times the median of the other links: no power of ten makes it plausible.
    The estimate is the volume times the median density, that of the link `c`.
    """
    path = tmp_path / "arm.urdf"
    write_dense_arm(path, 133.0)
    audit = audit_model(path)
    (found,) = (f for f in audit.findings if f.rule == "density-implausible")
    (repair,) = found.repairs
    volumes = [radius**2 * length for radius, length in ((0.055, 0.36), (0.045, 0.3))]
    assert float(repair.new["value"]) == pytest.approx(2.4 * volumes[0] / volumes[1], rel=1e-3)
    assert apply_repairs([audit]) == ([], 0)
    assert repair.is_estimate
    assert list_estimates([audit]) == [repair]
    assert describe_repair(repair).en.startswith("estimate: link 'b': mass value 133.0")


def test_link_denser_than_steel_and_the_other_links_gets_candidates(tmp_path: Path) -> None:
    """The numbers are those of a published arm: 42.872 kg in a tube of 110 x 360 mm."""
    path = tmp_path / "arm.urdf"
    write_dense_arm(path, 42.872)
    (found,) = (f for f in audit_model(path).findings if f.rule == "density-implausible")
    assert found.diagnostic.code == "denser-than-others"
    assert found.element == "link 'b'"
    assert len(found.repairs) == 2  # a decimal point, and the density of the other links
    assert found.repairs[0].new == {"value": "4.2872"}


def test_broken_path_of_the_second_visual_mesh_is_repaired_in_place(tmp_path: Path) -> None:
    """Reference: the original bytes."""
    trimesh.creation.box((0.1, 0.1, 0.1)).export(tmp_path / "body.stl")
    shape = '<visual><geometry><mesh filename="body.stl"/></geometry></visual>'
    text = (
        '<robot name="r"><link name="b"><inertial><mass value="1"/><inertia ixx="0.002"'
        ' iyy="0.002" izz="0.002" ixy="0" ixz="0" iyz="0"/></inertial>'
        f"{shape}{shape}</link></robot>"
    )
    path = tmp_path / "robot.urdf"
    path.write_text('body.stl.bak"'.join(text.rsplit('body.stl"', 1)))
    documents, count = apply_repairs([audit_model(path)])
    assert count == 1
    write_documents(documents)
    assert path.read_text() == text


@pytest.mark.slow
def test_link_without_shapes_is_no_exception_if_another_link_loses_its_mass(tmp_path: Path) -> None:
    """Two links without collision shapes are a choice, whatever their masses are."""
    text = URDF.read_text()
    for name in ("FL_hip", "RL_hip"):
        start = text.index("<collision>", text.index(f'<link name="{name}">'))
        end = text.index("</collision>", start) + len("</collision>")
        text = text[:start] + text[end:]
    start = text.index("<inertial>", text.index('<link name="RL_hip">'))
    end = text.index("</inertial>", start) + len("</inertial>")
    path = tmp_path / "robot.urdf"
    for changed in (text, text[:start] + text[end:]):
        path.write_text(changed)
        rules = {finding.rule for finding in audit_model(path).findings}
        assert "moving-link-without-collision" not in rules


def write_arm(folder: Path, inertial: str, shape: str) -> Path:
    """Write a URDF with a fixed base and a moving link with an inertial and a collision shape."""
    path = folder / "arm.urdf"
    path.write_text(
        '<robot name="arm"><link name="base"/><link name="rod">'
        f"<inertial>{inertial}</inertial><collision>{shape}</collision></link>"
        '<joint name="turn" type="revolute"><parent link="base"/><child link="rod"/>'
        '<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="9" velocity="9"/></joint></robot>'
    )
    return path


SPHERE = '<geometry><sphere radius="0.036"/></geometry>'
BALL = '<inertia ixx="5e-4" ixy="0" ixz="0" iyy="5e-4" iyz="0" izz="5e-4"/>'
TENSOR_OF_ZEROS = '<inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/>'


def test_moments_of_a_rod_about_wrong_axes_are_reordered(tmp_path: Path) -> None:
    """A rod of 0.4 m along x, with radius 0.01 m: m L^2 / 12 about y and z. All mass within the
    radius has at most m r^2 about x, 133 times less than stated."""
    moment = 0.3 * 0.4**2 / 12
    inertial = (
        f'<origin xyz="0.2 0 0"/><mass value="0.3"/><inertia ixx="{moment}" iyy="{moment}" '
        'izz="1.5e-05" ixy="0" ixz="0" iyz="0"/>'
    )
    shape = '<origin xyz="0.2 0 0"/><geometry><box size="0.4 0.02 0.02"/></geometry>'
    audit = audit_model(write_arm(tmp_path, inertial, shape))
    (found,) = (f for f in audit.findings if f.rule == "inertia-implausible")
    assert found.diagnostic.code == "inertia-about-wrong-axis"
    most = found.diagnostic.values["most"]
    assert most.value == pytest.approx(0.3 * 2 * 0.01**2)  # a corner of the box
    (repair,) = found.repairs
    assert repair.new == {"ixx": "1.5e-05", "iyy": str(moment), "izz": str(moment)}


@pytest.mark.parametrize(("place", "is_repaired"), [("0.2 0 0", True), ("0.2 0 -0.7", False)])
def test_com_is_not_moved_to_a_shape_in_another_frame(
    place: str, is_repaired: bool, tmp_path: Path
) -> None:
    """As in Draco 3: the mesh of a knee is 0.5 m from its joints, and its CoM is at the joints.

    Reference: the solid box of 0.4 m, whose centre is the CoM only if the box is at the joint.
    """
    inertial = f'<origin xyz="0.2 0 0.1"/><mass value="0.3"/>{TENSOR_OF_ZEROS}'
    shape = f'<origin xyz="{place}"/><geometry><box size="0.4 0.02 0.02"/></geometry>'
    audit = audit_model(write_arm(tmp_path, inertial, shape))
    repairs = repairs_of(audit, "inertia-not-positive-definite")
    assert repairs == ([{"xyz": place, "rpy": "0 0 0"}] if is_repaired else [])


def test_moments_of_a_link_whose_only_shape_is_its_tip_are_no_finding(tmp_path: Path) -> None:
    """A tube of 20 mm radius has m r^2 about its axis, 9 times the limit of a foot of 7 mm."""
    inertial = (
        '<origin xyz="0.1 0 0"/><mass value="0.3"/><inertia ixx="1.2e-4" iyy="1.1e-3" '
        'izz="1.1e-3" ixy="0" ixz="0" iyz="0"/>'
    )
    shape = '<origin xyz="0.2 0 0"/><geometry><sphere radius="0.007"/></geometry>'
    rules = {found.rule for found in audit_model(write_arm(tmp_path, inertial, shape)).findings}
    assert "inertia-implausible" not in rules


@pytest.mark.parametrize(("mass", "found"), [(0.03, True), (0.14, False)])
def test_moments_of_a_cross_with_one_drawn_pin_are_no_finding(
    mass: float, found: bool, tmp_path: Path
) -> None:
    """The cross of a universal joint has two pins; one pin of 2.5 cm^3 is drawn, as for H2's waist.

    At 0.14 kg, the drawn pin has 56,000 kg/m^3, three times tungsten: it is not the whole link. At
    0.03 kg (12,000 kg/m^3) it may be, and no mass inside has more than m r^2 about its axis.
    """
    inertial = (
        f'<mass value="{mass}"/><inertia ixx="{1.2e-4 * mass}" iyy="{1.1e-4 * mass}" '
        f'izz="{1.66e-4 * mass}" ixy="0" ixz="0" iyz="0"/>'
    )
    shape = (
        '<origin rpy="0 1.5707963267948966 0"/>'
        '<geometry><cylinder length="0.05" radius="0.004"/></geometry>'
    )
    rules = {finding.rule for finding in audit_model(write_arm(tmp_path, inertial, shape)).findings}
    assert ("inertia-implausible" in rules) is found


@pytest.mark.parametrize("leader", ["turnn", "elsewhere"])
def test_mimic_of_a_missing_joint_is_repaired_if_a_name_is_similar(
    leader: str, tmp_path: Path
) -> None:
    path = write_arm(tmp_path, '<mass value="1"/>' + BALL, SPHERE)
    text = path.read_text().replace(
        "</robot>",
        '<link name="tip"/><joint name="follow" type="continuous"><parent link="rod"/>'
        f'<child link="tip"/><mimic joint="{leader}"/></joint></robot>',
    )
    path.write_text(text)
    found = repairs_of(audit_model(path), "mimic-invalid")
    assert found == ([{"joint": "turn"}] if leader == "turnn" else [])


def test_tensor_of_zeros_becomes_that_of_the_solid_sphere(tmp_path: Path) -> None:
    """Reference: 2/5 m r^2. The public patch of DeepRobotics' X30 has this number, 3.1104e-05."""
    inertial = f'<mass value="0.06"/>{TENSOR_OF_ZEROS}'
    path = write_arm(tmp_path, inertial, '<geometry><sphere radius="0.036"/></geometry>')
    (repair,) = repairs_of(audit_model(path), "inertia-not-positive-definite")
    assert float(repair["ixx"]) == pytest.approx(0.4 * 0.06 * 0.036**2, rel=1e-5)
    assert {repair[word] for word in ("ixx", "iyy", "izz")} == {repair["ixx"]}
    assert set(repair) == {"ixx", "iyy", "izz"}  # the products are zero already


@pytest.mark.parametrize(("mesh", "faces"), [("b.stl", 12), ("b.stl", 11), ("b.dae", 12)])
def test_impossible_tensor_becomes_that_of_the_solid_mesh(
    tmp_path: Path, mesh: str, faces: int
) -> None:
    """Reference: closed form of a box in mm, turned about z by its origin; a face may be open.

    The CoM, which is 1 m outside, becomes the middle of the box.
    """
    box = trimesh.creation.box((40.0, 60.0, 200.0))
    trimesh.Trimesh(box.vertices, box.faces[:faces], process=False).export(tmp_path / mesh)
    if mesh.endswith(".dae"):
        text = (tmp_path / mesh).read_text()
        (tmp_path / mesh).write_text(text.replace("Y_UP", "Z_UP"))
    inertial = (
        '<origin xyz="0 0 1" rpy="0 0 0.3"/><mass value="0.5"/>'
        '<inertia ixx="-0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/>'
    )
    shape = (
        '<origin xyz="0 0 0.1" rpy="0 0 1.5707963267948966"/>'
        f'<geometry><mesh filename="{mesh}" scale="0.001 0.001 0.001"/></geometry>'
    )
    audit = audit_model(write_arm(tmp_path, inertial, shape))
    _, _, (repair,) = find_first(audit)
    origin, tensor = repair.list_changes()
    assert origin.new["rpy"] == "0 0 0"
    assert [float(text) for text in origin.new["xyz"].split()] == pytest.approx([0, 0, 0.1])
    x, y, z = 0.06, 0.04, 0.2  # turned by 90 degrees
    moments = [0.5 / 12 * (y**2 + z**2), 0.5 / 12 * (x**2 + z**2), 0.5 / 12 * (x**2 + y**2)]
    assert [float(tensor.new[word]) for word in ("ixx", "iyy", "izz")] == pytest.approx(
        moments, rel=1e-5
    )
    documents, _ = apply_repairs([audit])
    write_documents(documents)
    assert not audit_model(tmp_path / "arm.urdf").counts["error"]


def test_implausible_tensor_of_a_link_with_a_stated_frame_becomes_that_of_its_box(
    tmp_path: Path,
) -> None:
    """Reference: closed form in the axes of the inertial, which exchange x and z."""
    inertial = (
        '<origin xyz="0 0 0.1" rpy="0 1.5707963267948966 0"/><mass value="0.5"/>'
        '<inertia ixx="1000" ixy="0" ixz="0" iyy="1000" iyz="0" izz="1000"/>'
    )
    shape = '<origin xyz="0 0 0.1"/><geometry><box size="0.04 0.06 0.2"/></geometry>'
    audit = audit_model(write_arm(tmp_path, inertial, shape))
    (new,) = repairs_of(audit, "inertia-implausible")
    moments = [0.5 / 12 * (a**2 + b**2) for a, b in ((0.04, 0.06), (0.04, 0.2), (0.06, 0.2))]
    assert [float(new[word]) for word in ("ixx", "iyy", "izz")] == pytest.approx(moments, rel=1e-5)
    assert "xyz" not in new


def test_repairs_of_one_tensor_do_not_contradict_each_other(tmp_path: Path) -> None:
    """As in RealMan's RX75: a lost decimal point is impossible and implausible; one repair."""
    inertial = (
        '<origin xyz="0 0 0.1"/><mass value="1.559"/><inertia ixx="2661.9E-6" ixy="0" ixz="0" '
        'iyy="2302.5E-6" iyz="0" izz="1676359E-6"/>'
    )
    shape = '<origin xyz="0 0 0.1"/><geometry><box size="0.1 0.1 0.2"/></geometry>'
    audit = audit_model(write_arm(tmp_path, inertial, shape))
    assert repairs_of(audit, "triangle-inequality") == [{"izz": "0.001676359"}]
    assert {finding.rule for finding in audit.findings} >= {"inertia-implausible"}
    assert repairs_of(audit, "inertia-implausible") == []


@pytest.mark.parametrize(
    ("place", "shapes", "number"), [("0.1002 0 0", "0.05 0 0.2", 0), ("0.1 0 0.2", "0.05 0 0", 2)]
)
def test_origin_of_a_joint_beside_its_links_is_repaired_if_the_sides_differ(
    place: str, shapes: str, number: int, tmp_path: Path
) -> None:
    """Two arms of three bars of 0.1 m: the shapes or the origin of a wrist are 0.2 m too high."""
    trimesh.creation.box((0.1, 0.04, 0.04)).export(tmp_path / "bar.stl")
    inertia = '<inertia ixx="4e-5" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/>'
    link = (
        f'<link name="{{}}"><inertial><mass value="0.1"/>{inertia}</inertial><visual>'
        '<origin xyz="{}"/><geometry><mesh filename="bar.stl"/></geometry></visual></link>'
    )
    parts = [link.format("torso", "0 0 0")]
    for side, shoulder in (("left", "0.04 0.03 0"), ("right", "0.04 -0.03 0")):
        names = ["torso", *(f"{side}_{part}" for part in ("shoulder", "elbow", "wrist"))]
        is_wrong = side == "left"
        origins = [shoulder, "0.1 0 0", place if is_wrong else "0.1 0 0"]
        for parent, name, origin in zip(names, names[1:], origins, strict=False):
            moved = is_wrong and name.endswith("wrist")
            parts.append(link.format(name, shapes if moved else "0.05 0 0"))
            parts.append(
                f'<joint name="{name}_joint" type="revolute"><origin xyz="{origin}"/>'
                f'<parent link="{parent}"/><child link="{name}"/><axis xyz="0 1 0"/>'
                '<limit lower="-1" upper="1" effort="2" velocity="9"/></joint>'
            )
    path = tmp_path / "arms.urdf"
    path.write_text(f'<robot name="arms">{"".join(parts)}</robot>')
    (found,) = (f for f in audit_model(path).findings if f.rule == "joint-off-links")
    assert (found.element, len(found.repairs)) == ("joint 'left_wrist_joint'", number)
