"""Comparison results: line numbers of differences, the file or engine that deviates, and the
notes.
"""

from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.base.errors import ConfigurationError, ModelError
from pupper_analysis.robot.compare.differences import Difference
from pupper_analysis.robot.matching.tolerances import Tolerances
from pupper_analysis.tools.crosscheck import crosscheck
from pupper_analysis.tools.crosscheck.crosscheck import Comparison
from tests.support.robots import (
    FEET,
    Files,
    Part,
    all_changed,
    arm,
    change_part,
    compare_files,
    line_at,
    list_differences,
    mjcf_text,
    quadruped,
    urdf_text,
    without_base,
    write,
    write_parts,
)


def first_of(comparison: Comparison, kind: str) -> Difference:
    return next(difference for difference in comparison.differences if difference.kind == kind)


def lines_of(difference: Difference, files: Files) -> tuple[str, str]:
    places = {"robot.urdf": files.urdf, "robot.xml": files.mjcf}
    return line_at(difference.urdf_place, places), line_at(difference.mjcf_place, places)


SITE, FREE = '<site name="foot1" pos="0.002 0.0 -0.2"/>', '<joint type="free" damping="0.5"/>'
LOWER_FOOT = [f._replace(position=(0, 0, -0.25)) if f.name == "foot1" else f for f in FEET]
URDF, MJCF = urdf_text(quadruped()), mjcf_text(quadruped())
NAMELESS = mjcf_text(change_part(quadruped(), "shank2", damping=0.5)).replace(
    '<joint name="knee2" ', "<joint "
)
PLACES = {
    "a base": ("mass", URDF, mjcf_text(change_part(quadruped(), "base", mass=7.0)),
               '<mass value="6.0"/>', 'mass="7.0"'),
    "a free joint": ("damping", URDF, MJCF.replace("<freejoint/>", FREE),
                     '<link name="base">', FREE),
    "a frame": ("frame", urdf_text(quadruped(), LOWER_FOOT), MJCF,
                '<origin xyz="0.0 0.0 -0.25"/>', '<site name="foot1"'),
    "a body": ("frame", URDF, MJCF.replace(SITE, '<body name="foot1" pos="0 0 -0.3"/>'),
               "<origin", '<body name="foot1" pos="0 0 -0.3"/>'),
    "a joint without a name": ("damping", URDF, NAMELESS.replace('joint="knee2"', 'joint="knee1"'),
                               "<dynamics", 'damping="0.5"'),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("what", PLACES)
def test_differences_point_at_the_lines_of_both_files(what: str, tmp_path: Path) -> None:
    kind, urdf, mjcf, *expected = PLACES[what]
    files = write(tmp_path, urdf, mjcf)
    shown = lines_of(first_of(compare_files(files), kind), files)
    assert all(text in line for text, line in zip(expected, shown, strict=True))


CHANGES: dict[str, tuple[dict[str, Any], str, str]] = {
    "mass": ({"mass": 0.33}, '<mass value="0.22', '<inertial pos="0.0'),
    "com": ({"com": (0.0, 0.0, -0.13)}, '<origin xyz="0.004 0.001', '<inertial pos="0.0'),
    "inertia": (
        {"inertia": (0.003, 0.003, 3e-4, 0, 0, 0)},
        '<inertia ixx="0.0015"',
        'fullinertia="0.003 ',
    ),
    "position": ({"position": (0, 0.08, -0.21)}, '<origin xyz="0.0 0.08 -0.2"', '"shank2" pos="0.'),
    "lower limit": ({"lower": -2.0}, '<limit lower="-2.5"', '<joint name="knee2"'),
    "upper limit": ({"upper": -0.6}, '<limit lower="-2.5"', '<joint name="knee2"'),
    "effort": ({"effort": 30.0}, '<limit lower="-2.5"', '<motor name="m_knee2"'),
    "damping": ({"damping": 0.3}, '<dynamics damping="0.1"', '<joint name="knee2"'),
    "friction": ({"friction": 0.3}, '<dynamics damping="0.1"', '<joint name="knee2"'),
}
"""{kind of difference: (change of the third leg's shank in the MJCF, part of the line in the URDF,
part of the line in the MJCF)}."""


def test_each_changed_number_points_at_its_line_of_the_right_leg(tmp_path: Path) -> None:
    """Reference: the lines that the test writes; four legs have lines with the same text."""
    values = {key: value for change, *_ in CHANGES.values() for key, value in change.items()}
    parts = change_part(quadruped(), "shank2", **values)
    files = write_parts(tmp_path, quadruped(), parts)
    comparison = compare_files(files)
    text = files.urdf.read_text().splitlines()
    link = text.index('<link name="shank2">') + 1
    for kind, (_, *expected) in CHANGES.items():
        difference = first_of(comparison, kind)
        shown = lines_of(difference, files)
        assert all(part in line for part, line in zip(expected, shown, strict=True)), (kind, shown)
        line = int(str(difference.urdf_place).rpartition(":")[2])
        assert link < line < link + 15, kind


def test_the_place_of_an_effort_without_a_motor(tmp_path: Path) -> None:
    """The joint's actuatorfrcrange limits it; there is no actuator to point at."""
    text = mjcf_text(quadruped())
    motors = text[text.index("<actuator>") : text.index("</actuator>")]
    text = text.replace(motors, "<actuator>\n")
    text = text.replace('<joint name="knee1"', '<joint name="knee1" actuatorfrcrange="-9 9"')
    files = write(tmp_path, urdf_text(quadruped()), text)
    difference = next(d for d in compare_files(files).differences if d.element == "knee1")
    assert difference.mjcf == 9.0
    assert '<joint name="knee1"' in lines_of(difference, files)[1]


def test_line_of_a_default_is_that_of_the_innermost_class_with_the_attribute(
    tmp_path: Path,
) -> None:
    """A value that no class states is located at the joint."""
    text = mjcf_text(quadruped())
    for part in quadruped().values():
        text = text.replace(f'range="{part.lower!r} {part.upper!r}" damping="0.1" ', "", 1)
    classes = (
        '<default>\n<joint damping="0.3"/>\n<default class="leg">\n<joint range="-1 1"/>\n'
        "</default>\n</default>\n<worldbody>"
    )
    text = text.replace("<worldbody>", classes)
    text = text.replace('<body name="thigh0"', '<body childclass="leg" name="thigh0"')
    files = write(tmp_path, urdf_text(quadruped()), text)
    differences = {(d.kind, d.element): d for d in compare_files(files).differences}
    assert lines_of(differences["damping", "knee0"], files)[1] == '<joint damping="0.3"/>'
    assert lines_of(differences["damping", "knee1"], files)[1] == '<joint damping="0.3"/>'
    assert lines_of(differences["upper limit", "knee0"], files)[1] == '<joint range="-1 1"/>'
    assert 'name="knee1"' in lines_of(differences["upper limit", "knee1"], files)[1]


def test_line_of_an_included_element_is_that_of_the_included_file(tmp_path: Path) -> None:
    text = mjcf_text(change_part(quadruped(), "base", mass=7.0))
    start, end = text.index('<body name="base"'), text.index("</worldbody>")
    (tmp_path / "body.xml").write_text(f"<mujocoinclude>\n{text[start:end]}</mujocoinclude>")
    text = f'{text[:start]}<include file="body.xml"/>\n{text[end:]}'
    place = first_of(
        compare_files(write(tmp_path, urdf_text(quadruped()), text)), "mass"
    ).mjcf_place
    assert 'mass="7.0"' in line_at(place, {"body.xml": tmp_path / "body.xml"})


def test_lines_of_a_mapped_joint_are_those_of_its_name_in_each_file(tmp_path: Path) -> None:
    urdf = change_part(quadruped(), "shank2", joint="lh_kfe", damping=0.4)
    files = write_parts(tmp_path, urdf, quadruped())
    difference = first_of(compare_files(files, names={"lh_kfe": "knee2"}), "damping")
    in_urdf, in_mjcf = lines_of(difference, files)
    assert in_urdf.startswith('<dynamics damping="0.4"')
    assert '<joint name="knee2"' in in_mjcf


def test_empty_range_of_one_file_is_a_difference(tmp_path: Path) -> None:
    """An upper limit in degrees below the lower limit, as by a slip."""
    files = write_parts(tmp_path, change_part(quadruped(), "shank0", upper=-28.6), quadruped())
    assert list_differences(compare_files(files)) == [("upper limit", "knee0")]


# ------------------------------------------------------------------------------------- verdict


def test_explained_share_and_deviation_of_a_mass_have_their_closed_form(tmp_path: Path) -> None:
    """Closed form: 0.6 kg of the robot's 11.16 kg."""
    comparison = compare_files(
        write_parts(tmp_path, quadruped(), change_part(quadruped(), "base", mass=6.6))
    )
    assert not comparison.agree
    assert comparison.complete
    assert comparison.explained == pytest.approx(1.0, abs=1e-12)
    assert comparison.deviations["gravity"] == pytest.approx(0.6 / 11.16, rel=1e-9)
    assert comparison.residual["gravity"] < 1e-12


def test_fixed_base_is_compared_in_both_engines(tmp_path: Path) -> None:
    comparison = compare_files(
        write_parts(tmp_path, arm(), arm(), free=False, base_position=(0.1, -0.2, 0.4))
    )
    assert comparison.agree
    assert all(len(quantity.edge_deviations) >= 4 for quantity in comparison.check.quantities)
    assert comparison.check.passed


@pytest.mark.parametrize(("mass", "agree"), [(0.0, True), (1.0, False)])
def test_com_of_a_fixed_base_without_mass_is_not_compared(
    mass: float, agree: bool, tmp_path: Path
) -> None:
    """The CoM of a body without mass is undefined: `convert` refused its own file, "com apart"."""
    inertia = 'ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"'
    urdf, mjcf = tmp_path / "robot.urdf", tmp_path / "robot.xml"
    plate = f'<inertial><mass value="{mass}"/><inertia {inertia}/></inertial>' if mass else ""
    urdf.write_text(
        f"""<robot name="robot"><link name="stand"/><link name="plate">{plate}</link>
        <joint name="mount" type="fixed"><parent link="stand"/><child link="plate"/>
          <origin xyz="0 0 0.7"/></joint>
        <link name="arm"><inertial><origin xyz="0 0 0.1"/><mass value="1"/><inertia {inertia}/>
        </inertial></link>
        <joint name="hinge" type="revolute"><parent link="plate"/><child link="arm"/>
          <axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="20" velocity="3"/></joint>
        </robot>"""
    )
    # The body of the MJCF is 0.2 m above the CoM of the plate; 0 would be its CoM without a mass.
    plate = f'<inertial pos="0 0 0.2" mass="{mass}" diaginertia="0.01 0.01 0.01"/>' if mass else ""
    mjcf.write_text(
        f"""<mujoco model="robot"><compiler angle="radian"/><worldbody>
        <body name="stand"><body name="plate" pos="0 0 0.7">{plate}<body name="arm">
          <joint name="hinge" axis="0 1 0" range="-1 1"/>
          <inertial pos="0 0 0.1" mass="1" diaginertia="0.01 0.01 0.01"/></body></body></body>
        </worldbody>
        <actuator><position joint="hinge" kp="50" forcerange="-20 20"/></actuator></mujoco>"""
    )
    comparison = compare_files(Files(urdf, mjcf))
    assert comparison.agree is agree
    (coms,) = [one for one in comparison.check.quantities if one.name == "body coms"]
    assert (coms.relative < 1e-12) is agree
    assert {difference.kind for difference in comparison.differences} == (
        set() if agree else {"com"}
    )


@pytest.mark.slow
@pytest.mark.parametrize("case", ["equal", "different", "unlimited"])
def test_json_of_a_comparison_has_all_fields_and_no_infinite_number(
    tmp_path: Path, case: str
) -> None:
    """Reference: the fields of the result."""
    urdf, mjcf = quadruped(), quadruped()
    if case == "different":
        mjcf = all_changed(change_part(mjcf, "shank1", mass=0.5), damping=0.3)
    elif case == "unlimited":
        urdf = change_part(urdf, "thigh0", kind="continuous")
    comparison = compare_files(write_parts(tmp_path, urdf, mjcf))
    strict = {"parse_constant": lambda word: pytest.fail(f"{word} is not JSON")}
    content = json.loads(comparison.to_json(), **strict)
    assert set(content) >= {field.name for field in fields(Comparison)}
    assert content["agree"] == comparison.agree
    assert len(content["differences"]) == len(comparison.differences)
    for written, difference in zip(content["differences"], comparison.differences, strict=True):
        assert written["kind"] == difference.kind
        assert written["diagnostic"]["code"] == difference.diagnostic.code
        assert written["urdf_place"] == difference.urdf_place
        for name, effect in difference.effects.items():
            assert written["effects"][name]["deviation"] == effect.deviation
    if case == "unlimited":
        assert content["differences"][0]["urdf"] is None


def test_engine_disagreement_is_distinguished_from_model_difference(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """MuJoCo is made to weigh the URDF's base wrongly: no number in the files is to blame."""
    files = write_parts(tmp_path, quadruped(), quadruped())
    original = crosscheck.import_urdf_to_mujoco

    def heavier(*arguments: Any, **named: Any) -> Any:
        model = original(*arguments, **named)
        model.body("base").mass[0] *= 1.01
        return model

    monkeypatch.setattr(crosscheck, "import_urdf_to_mujoco", heavier)
    comparison = compare_files(files)
    assert comparison.differences == ()
    assert any(line.subject.name == "mass matrix" for line in comparison.engines)
    assert all(line.values["edge"] == "engines (URDF)" for line in comparison.engines)
    assert not comparison.check.passed
    edges = {q.name: q.edge_deviations for q in comparison.check.quantities}["mass matrix"]
    assert edges["models (Pinocchio)"] < 1e-12
    assert edges["engines (MJCF)"] < 1e-12
    assert edges["engines (URDF)"] > 1e-3


@pytest.mark.parametrize(
    ("names", "agree"), [(("left_hip", "right_hip"), False), (("thumb", "index"), True)]
)
def test_files_without_base_mass_disagree_for_legs_and_agree_for_a_hand(
    names: tuple[str, str], agree: bool, tmp_path: Path
) -> None:
    """The MJCF has no base body: the missing mass matters for a legged robot, not for a fixed
    hand.
    """
    parts = {"base": Part("base", mass=16.0)}
    for name, x in zip(names, (0.1, -0.1), strict=True):
        parts[f"{name}_link"] = Part(f"{name}_link", "base", name, position=(x, 0.0, 0.0))
    fused = without_base(mjcf_text(parts, (), free=False))
    comparison = compare_files(write(tmp_path, urdf_text(parts, ()), fused))
    assert "mass-of-base-left-out" in {note.code for note in comparison.notes}
    assert comparison.agree == agree, [*comparison.objections, *comparison.differences]


@pytest.mark.parametrize(("mass", "tier"), [(1.011, 1), (1.009, 3), (0.0, 1)])
def test_mass_difference_of_one_percent_is_listed_before_limits(mass: float, tier: int) -> None:
    """Relative to the larger mass: 1.1 % is urgent, 0.9 % is not, and a missing mass is."""
    diagnostic = diagnose("no-mesh", problem="")
    for urdf, mjcf in ((1.0, mass), (mass, 1.0)):
        assert Difference("mass", "torso", urdf, mjcf, "kg", diagnostic, {}).tier == tier


@pytest.mark.parametrize("limited_file", ["urdf", "mjcf"])
def test_position_limit_of_one_file_alone_is_an_infinite_deviation(
    tmp_path: Path, limited_file: str
) -> None:
    limited, free = quadruped(), change_part(quadruped(), "thigh0", kind="continuous")
    files = (limited, free) if limited_file == "urdf" else (free, limited)
    comparison = compare_files(write_parts(tmp_path, *files))
    quantities = {q.name: q for q in comparison.check.quantities}
    for name in ("lower joint limits", "upper joint limits"):
        assert quantities[name].relative == float("inf")
        assert quantities[name].location == "hip0"
    assert {(difference.kind, difference.element) for difference in comparison.differences} == {
        ("lower limit", "hip0"),
        ("upper limit", "hip0"),
    }


def test_differences_within_the_tolerances_agree(tmp_path: Path) -> None:
    files = write_parts(tmp_path, quadruped(), change_part(quadruped(), "base", mass=6.0002))
    assert compare_files(files).agree
    assert not compare_files(files, tolerances=Tolerances.strict()).agree
    assert not compare_files(files, tolerances=Tolerances().with_values({"mass": 1e-5})).agree


def test_number_of_configurations_and_seed_are_used(tmp_path: Path) -> None:
    files = write_parts(tmp_path, quadruped(), quadruped())
    check = compare_files(files, configurations=3, seed=7).check
    assert (check.configurations, check.seed) == (3, 7)


@pytest.mark.parametrize("seed", [-1, 1.5, True, "1"])
def test_invalid_seed_is_refused(tmp_path: Path, seed: Any) -> None:
    files = write_parts(tmp_path, quadruped(), quadruped())
    with pytest.raises(ConfigurationError, match=r"seed: .* is not a whole number"):
        compare_files(files, seed=seed)


def test_other_name_is_a_difference_with_strict_names(tmp_path: Path) -> None:
    """A mapping states that the names mean the same joint."""
    parts = change_part(quadruped(), "shank2", joint="lh_kfe")
    files = write_parts(tmp_path, parts, quadruped())
    assert compare_files(files).agree
    strict = compare_files(files, strict_names=True)
    assert not strict.agree
    assert strict.complete
    assert list_differences(strict) == [("name", "knee2")]
    difference = strict.differences[0]
    assert (difference.urdf, difference.mjcf) == ("lh_kfe", "knee2")
    in_urdf, in_mjcf = lines_of(difference, files)
    assert '<joint name="lh_kfe"' in in_urdf
    assert '<joint name="knee2"' in in_mjcf
    assert compare_files(files, strict_names=True, names={"lh_kfe": "knee2"}).agree


def test_urdf_without_any_mass_is_refused(tmp_path: Path) -> None:
    files = write_parts(tmp_path, all_changed(quadruped(), mass=0.0), quadruped())
    with pytest.raises(
        ModelError, match="the mass of all links is 0 kg; give the links <inertial>s"
    ):
        compare_files(files)


def test_mjcf_that_mujoco_refuses_is_refused_with_its_line(tmp_path: Path) -> None:
    """A copy without the sensor would agree."""
    text = mjcf_text(quadruped(), extra='<sensor>\n<gyro site="nix"/>\n</sensor>')
    lines = text.splitlines()
    line = next(number for number, one in enumerate(lines, 1) if "<gyro" in one)
    with pytest.raises(ModelError, match=rf"robot.xml:{line}: .* unrecognized name 'nix'"):
        compare_files(write(tmp_path, urdf_text(quadruped()), text))
