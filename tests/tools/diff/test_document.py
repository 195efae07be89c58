"""Document of a diff: effects of changes that are not evaluated."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

import pupper_analysis as pa
from pupper_analysis.present.document import FileFinding, Lines, Number, Table, Text, get_english
from pupper_analysis.tools.audit.audit import audit_model
from pupper_analysis.tools.audit.document import audit_document
from pupper_analysis.tools.diff.document import _format_percent, diff_document
from tests.support.robots import change_part, pendulum, quadruped, urdf_text

MODEL = """<mujoco><worldbody><body name="base"><freejoint/><geom size="0.1"/>
  <body name="leg" pos="0 0 1"><joint name="hip"/><geom size="0.1"/>
    <body name="foot" pos="0 0 1"><joint name="knee"/><geom size="0.1"/></body></body>
</body></worldbody></mujoco>"""
"""MJCF of a base with two joints."""


@pytest.mark.parametrize(
    ("removed", "kind"), [("<freejoint/>", "type"), ('<joint name="knee"/>', "joint")]
)
def test_structural_changes_do_not_claim_to_be_without_effect(
    tmp_path: Path, removed: str, kind: str
) -> None:
    """A removed degree of freedom changes the mass matrix; `diff` does not evaluate this effect."""
    old, new = tmp_path / "old.xml", tmp_path / "new.xml"
    old.write_text(MODEL)
    new.write_text(MODEL.replace(removed, ""))
    diff = pa.diff_models(old, new)
    place = next(place for place, change in enumerate(diff.changes) if change.kind == kind)
    findings = [block for block in diff_document(diff).blocks if isinstance(block, FileFinding)]
    notes = [get_english(note) for note in findings[place].notes]
    assert notes == ["effect on the dynamics not evaluated"]


def diff_urdfs(folder: Path, old: str, new: str) -> pa.analysis.ModelDiff:
    files = folder / "old.urdf", folder / "new.urdf"
    for file, content in zip(files, (old, new), strict=True):
        file.write_text(content)
    return pa.diff_models(*files)


def read_torque_lines(diff: pa.analysis.ModelDiff) -> list[str]:
    lines = [block for block in diff_document(diff).blocks if isinstance(block, Lines)]
    return list(map(get_english, lines[-1].lines))


def test_heavier_trunk_refers_to_stand_since_only_the_held_base_is_compared(tmp_path: Path) -> None:
    """A trunk of 12 kg instead of 6 kg loads no joint of a held base.

    The weight changes as the total mass of the robot.
    """
    parts = quadruped()
    diff = diff_urdfs(
        tmp_path,
        urdf_text(parts),
        urdf_text(change_part(parts, "base", mass=parts["base"].mass * 2)),
    )
    masses = [part.mass for part in parts.values()]
    percent = 100 * parts["base"].mass / sum(masses)
    assert read_torque_lines(diff) == [
        "with the base held, the joint torques against gravity are unchanged",
        f"standing is not compared: the weight changes by {percent:+.3g} %",
    ]
    step = diff_document(diff).next_step
    assert step is not None
    assert step.command == "stand"


def test_torques_are_printed_old_before_new(tmp_path: Path) -> None:
    """Closed form: the torque of a pendulum is proportional to m l, here 3 * 0.7 / (2 * 0.5)."""
    old, new = pendulum(), pendulum(mass=3.0, com=(0.0, 0.0, -0.7))
    diff = diff_urdfs(tmp_path, urdf_text(old, []), urdf_text(new, []))
    (line,) = read_torque_lines(diff)
    before, after = diff.torques["swing"]
    assert after > before
    assert line == (
        "with the base fixed to the world, the joint torques against gravity change by up to "
        f"+110 % (swing: {before:.4g} -> {after:.4g} N m)"
    )
    table = next(block for block in diff_document(diff).blocks if isinstance(block, Table))
    headers = [get_english(column.name) for column in table.columns]
    assert headers == ["joint", "old", "new", "change"]
    (row,) = table.rows
    values = [cell.value for cell in row[1:] if isinstance(cell, Number)]
    assert values == pytest.approx([before, after, 110.0], rel=1e-6)
    step = diff_document(diff).next_step
    assert step is not None
    assert step.command == "hold"


def test_headline_and_findings_show_the_old_value_first(tmp_path: Path) -> None:
    """The mass of the bob is 2 kg in the old file and 3 kg in the new file; the base has 1 kg."""
    diff = diff_urdfs(tmp_path, urdf_text(pendulum(), []), urdf_text(pendulum(mass=3.0), []))
    document = diff_document(diff)
    assert "3 kg in the old file, 4 kg in the new file (+33.3 %)" in get_english(
        document.findings[1]
    )
    finding = next(block for block in document.blocks if isinstance(block, FileFinding))
    shown = [(get_english(place.place), get_english(place.line)) for place in finding.columns]
    assert [name.split(":")[0] for name, _ in shown] == ["old.urdf", "new.urdf"]
    assert ['value="2' in shown[0][1], 'value="3' in shown[1][1]] == [True, True]


def test_values_without_a_line_are_shown_under_their_own_file(tmp_path: Path) -> None:
    """Numbers of scaled variants have no line: the columns then contain the values."""
    diff = diff_urdfs(tmp_path, urdf_text(pendulum(), []), urdf_text(pendulum(mass=3.0), []))
    (change,) = diff.changes
    diff = replace(diff, changes=(replace(change, old_place="", new_place=""),))
    finding = next(block for block in diff_document(diff).blocks if isinstance(block, FileFinding))
    assert [get_english(place.line) for place in finding.columns] == ["2 kg", "3 kg"]


def test_mass_that_moves_between_links_is_no_change_of_the_total(tmp_path: Path) -> None:
    """0.1 kg + 0.2 kg and 0.3 kg + 0 kg differ by rounding only."""
    old = change_part(pendulum(mass=0.1), "base", mass=0.2)
    new = change_part(pendulum(mass=0.3), "base", mass=1e-30)
    diff = diff_urdfs(tmp_path, urdf_text(old, []), urdf_text(new, []))
    assert diff.mass[0] != diff.mass[1]
    assert get_english(diff_document(diff).findings[1]).startswith("link ")


def test_one_edited_mass_is_the_answer_if_links_are_fixed_to_the_body(tmp_path: Path) -> None:
    """The thigh has 1 kg, with the cover 1.5 kg: the stated number has changed to 1.2 kg.

    CoM and inertia of both links together change, too: three changes from one number.
    """
    text = (
        '<robot name="r"><link name="base"/><link name="thigh"><inertial><origin xyz="0 0 -0.1"/>'
        '<mass value="1"/><inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/>'
        '</inertial></link><link name="cover"><inertial><mass value="0.5"/><inertia ixx="0.1" '
        'iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        '<joint name="hip" type="revolute"><parent link="base"/><child link="thigh"/>'
        '<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="9" velocity="9"/></joint>'
        '<joint name="weld" type="fixed"><parent link="thigh"/><child link="cover"/></joint>'
        "</robot>"
    )
    diff = diff_urdfs(tmp_path, text, text.replace('<mass value="1"/>', '<mass value="1.2"/>'))
    assert diff.edited_masses == {"thigh": (1.0, 1.2)}
    masses = next((change.old, change.new) for change in diff.changes if change.kind == "mass")
    assert masses == pytest.approx((1.5, 1.7))
    document = diff_document(diff)
    assert document.findings[0].short == "thigh mass 1 -> 1.2 kg (+20 %)"
    assert document.findings[0].short_zh == "thigh 质量 1 -> 1.2 kg（+20 %）"
    block = document.blocks[0]
    assert isinstance(block, FileFinding)
    stated = "sum of the link and its fixed links; stated: thigh 1 -> 1.2 kg"
    assert get_english(block.notes[0]) == stated
    # A second edited number of the inertials is not summarised.
    moved = text.replace('<mass value="1"/>', '<mass value="1.2"/>').replace("-0.1", "-0.2")
    assert diff_urdfs(tmp_path, text, moved).edited_masses == {}


def test_first_line_names_the_most_urgent_change(tmp_path: Path) -> None:
    diff = diff_urdfs(tmp_path, urdf_text(pendulum(), []), urdf_text(pendulum(mass=3.0), []))
    line = diff_document(diff).findings[0]
    assert get_english(line) == "1 change: mass of bob"
    assert isinstance(line, Text)
    old = pendulum()["bob"].mass
    edited = f"bob mass {old:.4g} -> 3 kg ({100 * (3 / old - 1):+.3g} %)"
    assert line.short == edited
    change = f"{100 * (3 / old - 1):+.3g} %"
    assert line.short_zh == f"bob 的质量 {old:.4g} -> 3 kg（{change}）"
    # A single further change is named: by its kind if it is of the same link.
    for element, ending in (("bob", "also inertia"), ("arm", "also arm inertia")):
        message = diff.changes[0].diagnostic
        assert message.subject is not None
        message = replace(message, subject=replace(message.subject, name=element))
        further = replace(diff.changes[0], kind="inertia", diagnostic=message)
        line = diff_document(
            replace(diff, changes=(*diff.changes, further), edited_masses={})
        ).findings[0]
        assert isinstance(line, Text)
        assert line.short == f"{edited}; {ending}"


def test_new_version_without_its_meshes_refers_to_the_audit(tmp_path: Path) -> None:
    """`stand` may find no feet without meshes; `audit` names the files and their package."""
    heavy = pendulum(mass=3.0)
    texts = [urdf_text(pendulum(), []), urdf_text(heavy, [])]
    shape = '<visual><geometry><mesh filename="package://lost/base.stl"/></geometry></visual>'
    lost = [text.replace("</link>", f"{shape}</link>", 1) for text in texts]
    for old, new in (texts, lost):
        diff = diff_urdfs(tmp_path, old, new)
        step = diff_document(replace(diff, floating=True)).next_step
        assert step is not None
        assert step.command == ("audit" if new in lost else "stand")
    path = tmp_path / "lost.urdf"
    path.write_text(lost[1])
    step = audit_document(replace(audit_model(path), floating=True, passed=True)).next_step
    assert step is not None
    assert (step.command, step.words) == ("audit", ("-v",))


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [(2.0, 3.0, "+50 %"), (2.0, 1.0, "-50 %"), (0.1, 1.5, "x 15"), (0.089, 90.089, "x 1010")],
)
def test_change_is_in_percent_or_a_factor_without_exponent(
    old: float, new: float, expected: str
) -> None:
    """Line 1 stated ``x 1.01e+03``."""
    assert _format_percent(old, new) == expected
