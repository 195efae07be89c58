"""Printed and annotated comparisons: the first cause first, equal differences in groups."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import pytest

from pupper_analysis.base.diagnostics import Quantity, diagnose
from pupper_analysis.present.document import FileFinding, Number, Table, get_english
from pupper_analysis.present.documents.registry import make_document
from pupper_analysis.present.formats import write_github, write_junit
from pupper_analysis.robot.compare import mjcf_only as extras
from pupper_analysis.robot.matching.tolerances import Tolerances
from pupper_analysis.tools.crosscheck.crosscheck import Comparison
from pupper_analysis.tools.crosscheck.document import (
    make_comparison_annotations,
)
from tests.support.printing import printed
from tests.support.robots import (
    FEET,
    Files,
    all_changed,
    change_part,
    compare_files,
    mjcf_text,
    quadruped,
    urdf_text,
    write,
    write_parts,
)


def test_annotations_name_unmatched_and_guessed_joints(tmp_path: Path) -> None:
    urdf = change_part(change_part(quadruped(), "shank3", kind="fixed"), "thigh0", joint="lf_haa")
    comparison = compare_files(write_parts(tmp_path, urdf, quadruped()))
    found = {remark.title: remark for remark in make_comparison_annotations(comparison)}
    assert found["joint knee3"].level == "error"
    assert found["joint knee3"].message == f"joint knee3 is not in {comparison.urdf}"
    assert found["joint knee3"].place == comparison.mjcf
    assert found["guessed joints"].level == "warning"
    assert "lf_haa=hip0" in found["guessed joints"].message


def test_unexplained_deviation_is_the_verdict(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without a difference to name, neither the verdict nor the annotations are AGREE."""
    monkeypatch.setattr(extras, "of_joints", lambda _: iter(()))
    text = mjcf_text(quadruped())
    text = text.replace('<joint name="hip0"', '<joint name="hip0" stiffness="20"')
    comparison = compare_files(write(tmp_path, urdf_text(quadruped()), text))
    first = printed(comparison).replace(" robot.urdf and robot.xml: ", ": ", 1)
    assert re.match(r"DISAGREE: \S+ of forward dynamics is not explained by the differences", first)
    (remark,) = (r for r in make_comparison_annotations(comparison) if r.title == "agreement")
    assert remark.level == "error"
    assert "is not explained by the differences" in remark.message


def test_printed_verdict_is_the_largest_difference_and_groups_equal_differences(
    tmp_path: Path,
) -> None:
    mjcf = change_part(all_changed(quadruped(), damping=0.3), "base", mass=7.5)
    text = printed(compare_files(write_parts(tmp_path, quadruped(), mjcf)))
    first = text.replace(" robot.urdf and robot.xml: ", ": ", 1).splitlines()[0]
    assert first == "DISAGREE: link base: mass 6 kg in the URDF, 7.5 kg in the MJCF (+25 %)"
    lines = text.splitlines()
    group = next(index for index, line in enumerate(lines) if line.startswith("2."))
    assert "damping 0.1 N m s/rad in the URDF, 0.3 N m s/rad in the MJCF" in lines[group]
    assert [line for line in lines[group:] if line.startswith("   likewise on 7 more: ")]
    assert not any(line.startswith("3.") for line in lines)


def test_annotations_have_the_given_path_and_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """GitHub shows an annotation only at a path from the repository's root."""
    (tmp_path / "models").mkdir()
    mjcf = change_part(quadruped(), "base", mass=7.5)
    write_parts(tmp_path / "models", quadruped(), mjcf)
    monkeypatch.chdir(tmp_path)
    files = Files(Path("models/robot.urdf"), Path("models/robot.xml"))
    (annotation,) = make_comparison_annotations(compare_files(files))
    assert (annotation.level, annotation.title) == ("error", "mass of base")
    assert annotation.place == "models/robot.urdf:5"
    assert "robot.xml:7" in annotation.message


@pytest.mark.parametrize("kind", ["mass", "limit"])
def test_no_error_is_annotated_within_the_tolerance(tmp_path: Path, kind: str) -> None:
    """A mass of 6.3 kg instead of 6 kg, with a tolerance of 10 %; or a limit that is 0.9 mrad off.

    JUnit has no failure, as the exit status is 0.
    """
    narrow = all_changed(quadruped(), lower=-0.4, upper=0.4)
    if kind == "mass":
        mjcf, changed = change_part(narrow, "base", mass=6.3), {"mass": 0.1}
    else:
        mjcf, changed = change_part(narrow, "shank0", lower=-0.4009), {}
    tolerances = Tolerances().with_values(changed)
    files = write(tmp_path, urdf_text(narrow, FEET), mjcf_text(mjcf, FEET))
    comparison = compare_files(files, tolerances=tolerances)
    found = list(make_comparison_annotations(comparison))
    assert comparison.agree
    assert not [note for note in found if note.level == "error"]
    assert ' failures="0"' in write_junit(found)


def test_springs_of_the_mjcf_alone_are_printed_with_their_effect(tmp_path: Path) -> None:
    """Reference: stiffness of 20 N m/rad at the hips of two legs; all of the deviation."""
    text = mjcf_text(quadruped())
    for leg in (0, 2):
        text = text.replace(f'<joint name="hip{leg}"', f'<joint name="hip{leg}" stiffness="20"')
    out = printed(compare_files(write(tmp_path, urdf_text(quadruped()), text)))
    spring = "only in the MJCF: stiffness 20, springref 0"
    assert out.startswith("DISAGREE robot.urdf and robot.xml: joint hip")
    assert f": {spring}\n" in out
    assert "   likewise on 1 more: hip" in out
    assert "explained: 100 % of the deviation" in out
    assert "engines differ" not in out


def test_each_difference_has_an_annotation_and_equal_files_have_none(tmp_path: Path) -> None:
    """Reference: a mass, and the damping of eight joints."""
    mjcf = change_part(all_changed(quadruped(), damping=0.3), "base", mass=7.5)
    comparison = compare_files(write_parts(tmp_path, quadruped(), mjcf))
    found = list(make_comparison_annotations(comparison))
    assert len(found) == len(comparison.differences) == 9
    assert found[0].message.startswith(comparison.differences[0].message)
    line = write_github(found).splitlines()[0]
    assert line.endswith(" [mass-differs]")
    equal = compare_files(write_parts(tmp_path, quadruped(), quadruped()))
    assert list(make_comparison_annotations(equal)) == []


def test_joint_of_one_file_alone_is_the_printed_cause(tmp_path: Path) -> None:
    still = change_part(quadruped(), "shank3", kind="fixed")
    comparison = compare_files(write_parts(tmp_path, still, quadruped()))
    text = printed(comparison)
    assert text.startswith("DISAGREE robot.urdf and robot.xml: the files have different joints\n")
    assert f"only in {comparison.mjcf}, fixed at zero to compare the rest: knee3" in text


def test_link_of_another_robot_is_the_first_word_of_the_verdict() -> None:
    """A line with long names of files is cut at its end, which contained the link."""
    masses = {"one": Quantity(3.3, "kg"), "two": Quantity(6.921, "kg")}
    change = Quantity(6.921 / 3.3 - 1, "1")
    found = diagnose("inertials-of-another-robot", bodies=("base",), change=change, **masses)
    assert found.short == "base: mass +110 % (3.3, 6.921 kg), com, inertia"


def read_findings(comparison: Comparison) -> list[str]:
    """Return the findings of the document in the short form, which the terminal shows."""
    findings = make_document(comparison).findings
    return [getattr(finding, "short", "") or get_english(finding) for finding in findings]


def test_second_line_has_the_largest_deviation_of_the_table(tmp_path: Path) -> None:
    """The reference is the table of `-v`: its rows of the dynamics, in the columns of the models.

    Body masses and inertias, whose deviations are larger, are parameters and no effects.
    """
    mjcf = change_part(quadruped(), "shank1", mass=1.2, com=(0.02, 0.0, -0.12))
    comparison = compare_files(write_parts(tmp_path, quadruped(), mjcf))
    table = [block for block in make_document(comparison).blocks if isinstance(block, Table)][-1]
    headers = [get_english(column.name) for column in table.columns]
    columns = [number for number, name in enumerate(headers) if name.startswith("models")]
    assert len(columns) == 2
    deviations = {
        get_english(row[0]): max(
            cell.value for cell in (row[column] for column in columns) if isinstance(cell, Number)
        )
        for row in table.rows
    }
    assert deviations["body masses"] > max(deviations["mass matrix"], deviations["com"])
    effects = {
        name: value
        for name, value in deviations.items()
        if not name.startswith(("body ", "joint ", "armature"))
    }
    worst = max(effects, key=effects.__getitem__)
    assert (
        read_findings(comparison)[1]
        == f"2 differences; {worst} of URDF and MJCF ≤{100 * effects[worst]:.2g} % apart"
    )


def test_differences_of_limits_alone_leave_the_equations_of_motion_equal(tmp_path: Path) -> None:
    mjcf = change_part(quadruped(), "shank1", effort=25.0)
    comparison = compare_files(write_parts(tmp_path, quadruped(), mjcf))
    assert read_findings(comparison)[1] == "1 difference, but none in the equations of motion"


def test_quantities_of_the_table_belong_to_their_columns(tmp_path: Path) -> None:
    """Each cell of the table of deviations is the deviation of its quantity and its column."""
    mjcf = change_part(quadruped(), "shank1", mass=1.2)
    comparison = compare_files(write_parts(tmp_path, quadruped(), mjcf))
    table = [block for block in make_document(comparison).blocks if isinstance(block, Table)][-1]
    headers = [get_english(column.name) for column in table.columns]
    for row, quantity in zip(table.rows, comparison.check.quantities, strict=True):
        assert get_english(row[0]) == quantity.name
        for header, cell in zip(headers, row, strict=True):
            if isinstance(cell, Number) and header in quantity.edge_deviations:
                assert cell.value == quantity.edge_deviations[header]
    worst_at = {get_english(row[0]): get_english(row[-1]) for row in table.rows}
    assert worst_at["body masses"] == "knee1"


def test_differences_show_the_urdf_before_the_mjcf(tmp_path: Path) -> None:
    """The mass of the base is 6 kg in the URDF and 7.5 kg in the MJCF.

    Damping changes accelerations only: its largest effect is not zero.
    """
    mjcf = change_part(change_part(quadruped(), "base", mass=7.5), "thigh0", damping=0.3)
    comparison = compare_files(write_parts(tmp_path, quadruped(), mjcf))
    document = make_document(comparison)
    tables = [block for block in document.blocks if isinstance(block, Table)]
    headers = [get_english(column.name) for column in tables[0].columns]
    column = headers.index("greatest effect relative to the URDF")
    effects = [row[column].value for row in tables[0].rows]
    assert effects == [
        100 * max(effect.relative for effect in difference.effects.values())
        for difference in comparison.differences
    ]
    cells = dict(zip(headers, tables[0].rows[0], strict=True))
    assert [cells[name].value for name in ("in the URDF", "in the MJCF")] == [6.0, 7.5]
    places = [get_english(cells[f"line of the {name}"]) for name in ("URDF", "MJCF")]
    assert [place.partition(":")[0] for place in places] == ["robot.urdf", "robot.xml"]
    finding = next(block for block in document.blocks if isinstance(block, FileFinding))
    shown = [(get_english(column.place), get_english(column.line)) for column in finding.columns]
    assert [place.partition(":")[0] for place, _ in shown] == ["robot.urdf", "robot.xml"]
    assert ["6" in shown[0][1], "7.5" in shown[1][1]] == [True, True]


def test_an_mjcf_that_mujoco_refuses_is_not_recommended_for_a_stand(tmp_path: Path) -> None:
    """Both files agree in all numbers; MuJoCo refuses the MJCF, since a mesh file is missing."""
    text = mjcf_text(quadruped()).replace(
        "<worldbody>", '<asset><mesh name="shell" file="shell.obj"/></asset><worldbody>', 1
    )
    body = text.index("<body")
    end = text.index(">", body) + 1
    geom = '<geom type="mesh" mesh="shell" contype="0" conaffinity="0" group="2"/>'
    files = write(tmp_path, urdf_text(quadruped()), text[:end] + geom + text[end:])
    with pytest.raises(ValueError, match=r"shell\.obj"):
        mujoco.MjModel.from_xml_path(str(files.mjcf))
    comparison = compare_files(files)
    assert comparison.agree
    document = make_document(comparison)
    assert read_findings(comparison)[1] == "MuJoCo refuses robot.xml: 1 file missing (shell.obj)"
    assert document.warned
    step = document.next_step
    assert step is not None
    assert (step.command, step.words) == ("audit", (comparison.mjcf,))
