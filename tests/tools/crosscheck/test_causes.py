"""Causes: one mistake that leads to many differences is named in the first line."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.support.robots import (
    Files,
    Part,
    Parts,
    all_changed,
    change_part,
    compare_files,
    format_headline,
    list_differences,
    mjcf_text,
    numbers,
    quadruped,
    urdf_text,
    write,
)


def get_headline(files: Files) -> str:
    """Return the first line of a comparison that must disagree with a complete explanation."""
    comparison = compare_files(files)
    assert not comparison.agree
    assert comparison.complete
    return format_headline(comparison)


def pair(folder: Path, mjcf: Parts) -> Files:
    return write(folder, urdf_text(quadruped()), mjcf_text(mjcf))


def with_euler(text: str, order: str, compiler: str) -> str:
    """Return an MJCF with Euler angles of a sequence in place of quaternions, and the given
    compiler attributes.
    """

    def euler(match: re.Match[str]) -> str:
        quaternion = [float(word) for word in match[1].split()]
        # Lower-case letters are rotating axes in MuJoCo, and fixed axes in SciPy.
        angles = Rotation.from_quat(quaternion, scalar_first=True).as_euler(order.swapcase())
        return f'euler="{numbers(angles)}"'

    text = re.sub(r'quat="([^"]*)"', euler, text)
    return text.replace('<compiler angle="radian"/>', f"<compiler {compiler}/>")


def test_euler_angles_with_their_stated_sequence_agree(tmp_path: Path) -> None:
    text = with_euler(mjcf_text(quadruped()), "XYZ", 'angle="radian" eulerseq="XYZ"')
    assert compare_files(write(tmp_path, urdf_text(quadruped()), text)).agree


@pytest.mark.slow
def test_euler_angles_of_another_sequence_are_one_cause(tmp_path: Path) -> None:
    text = with_euler(mjcf_text(quadruped()), "XYZ", 'angle="radian"')
    line = get_headline(write(tmp_path, urdf_text(quadruped()), text))
    assert 'with eulerseq="XYZ" instead of "xyz"' in line


@pytest.mark.slow
def test_euler_sequence_of_shanks_turned_twice_by_90_degrees_is_one_cause(tmp_path: Path) -> None:
    """About x, then about z: the sequence is the only difference of the files."""
    turn = Rotation.from_euler("xyz", [math.pi / 2, 0.0, math.pi / 2])
    quaternion = tuple(turn.as_quat(scalar_first=True))
    parts = {
        name: replace(part, quaternion=quaternion) if name.startswith("shank") else part
        for name, part in quadruped().items()
    }
    text = with_euler(mjcf_text(parts), "XYZ", 'angle="radian"')
    line = get_headline(write(tmp_path, urdf_text(parts), text))
    assert 'with eulerseq="XYZ" instead of "xyz"' in line


def test_degrees_for_radians_in_the_compiler_are_one_cause(tmp_path: Path) -> None:
    text = mjcf_text(quadruped()).replace('angle="radian"', 'angle="degree"')
    line = get_headline(write(tmp_path, urdf_text(quadruped()), text))
    assert 'with angle="radian" instead of "degree" in its <compiler>' in line


def test_exchanged_limbs_are_one_cause(tmp_path: Path) -> None:
    text = mjcf_text(quadruped())
    for kind in ("hip", "knee"):
        for first, second in (("0", "1"), ("2", "3")):
            text = text.replace(f'"{kind}{first}"', "@").replace(
                f'"{kind}{second}"', f'"{kind}{first}"'
            )
            text = text.replace("@", f'"{kind}{second}"')
    line = get_headline(write(tmp_path, urdf_text(quadruped()), text))
    assert "limbs are exchanged between the files: hip0 and hip1, hip2 and hip3;" in line


def scale_parts(
    parts: Parts, mass: float = 1.0, length: float = 1.0, inertia: float = 1.0
) -> Parts:
    return {
        name: replace(
            part,
            mass=mass * part.mass,
            position=tuple(length * np.array(part.position)),
            com=tuple(length * np.array(part.com)),
            inertia=tuple(inertia * np.array(part.inertia)),
        )
        for name, part in parts.items()
    }


@pytest.mark.slow
@pytest.mark.parametrize(
    ("factors", "words"),
    [
        (
            {"mass": 1e3},
            "all masses of the MJCF are 1000 times as large as in the URDF: g instead of kg",
        ),
        (
            {"mass": 0.1},
            "all masses of the MJCF are 0.1 times as large as in the URDF: a decimal point?",
        ),
        (
            {"length": 1e3},
            "all lengths of the MJCF are 1000 times as large as in the URDF: mm instead of m",
        ),
        (
            {"inertia": 1e6},
            "all inertias of the MJCF are 1000000 times as large as in the URDF: kg mm^2",
        ),
    ],
)
def test_a_ratio_of_a_unit_is_named(tmp_path: Path, factors: dict[str, float], words: str) -> None:
    """All masses, lengths or inertias scaled by one factor."""
    assert words in get_headline(pair(tmp_path, scale_parts(quadruped(), **factors)))


@pytest.mark.slow
@pytest.mark.parametrize("in_urdf", [False, True])
def test_another_com_is_not_explained_by_a_unit_of_lengths(tmp_path: Path, in_urdf: bool) -> None:
    """Reference: the only CoM that does not differ by the factor of the unit, mm for m."""
    moved = change_part(quadruped(), "shank2", com=(0.03, 0.02, -0.09))
    parts = [quadruped(), scale_parts(moved, length=1e3)]
    if in_urdf:
        parts = [scale_parts(quadruped(), length=1e3), moved]
    comparison = compare_files(write(tmp_path, urdf_text(parts[0]), mjcf_text(parts[1])))
    (cause,) = [cause for cause in comparison.causes if cause.kind == "units"]
    explained = [comparison.differences[number] for number in cause.differences]
    assert {difference.kind for difference in explained} >= {"position", "com"}
    assert ("com", "knee2") not in {
        (difference.kind, difference.element) for difference in explained
    }


def test_limits_in_degrees_are_one_cause(tmp_path: Path) -> None:
    urdf = {
        name: replace(part, lower=math.degrees(part.lower), upper=math.degrees(part.upper))
        for name, part in quadruped().items()
    }
    line = get_headline(write(tmp_path, urdf_text(urdf), mjcf_text(quadruped())))
    assert line.endswith(
        "0.0174533 times as large as in the URDF: degrees instead of radians in the URDF?"
    )


def test_limit_of_a_slide_is_not_explained_by_degrees(tmp_path: Path) -> None:
    """Reference: the limits of all hinges differ by a factor, and one limit of a slide by 5 mm."""
    slide = change_part(quadruped(), "shank2", kind="prismatic", lower=-0.1, upper=0.1)
    urdf = {
        name: part
        if part.kind == "prismatic"
        else replace(part, lower=math.degrees(part.lower), upper=math.degrees(part.upper))
        for name, part in change_part(slide, "shank2", upper=0.105).items()
    }
    comparison = compare_files(write(tmp_path, urdf_text(urdf), mjcf_text(slide)))
    (cause,) = [cause for cause in comparison.causes if cause.kind == "units"]
    elements = {comparison.differences[number].element for number in cause.differences}
    assert elements == {part.joint for part in slide.values() if part.joint} - {"knee2"}


def test_tenfold_mass_is_named_as_a_decimal_point_error(tmp_path: Path) -> None:
    line = get_headline(pair(tmp_path, change_part(quadruped(), "shank2", mass=2.2)))
    assert line.startswith("DISAGREE: link shank2: mass 0.22 kg in the URDF, 2.2 kg in the MJCF")
    assert "(ten times: a decimal point?)" in line


def test_causes_are_ordered_by_their_effect(tmp_path: Path) -> None:
    """A slip before a limit that differs as well, and after a base of nine times the mass."""
    thigh = quadruped()["thigh0"]
    tenfold = {"mass": 10 * thigh.mass, "inertia": tuple(10 * np.array(thigh.inertia))}
    limit = change_part(change_part(quadruped(), "thigh0", **tenfold), "shank3", lower=-2.51)
    heavy = change_part(limit, "base", mass=9 * quadruped()["base"].mass)
    for mjcf, first_cause in ((limit, "mass and inertia of thigh0"), (heavy, "link base: mass")):
        comparison = compare_files(pair(tmp_path, mjcf))
        assert len(comparison.causes) == 1
        assert len(comparison.unexplained_differences) > 0
        assert format_headline(comparison).startswith(f"DISAGREE: {first_cause}")


def test_base_of_another_robot_is_one_cause(tmp_path: Path) -> None:
    other = {"mass": 11.0, "com": (0.03, 0.0, 0.01), "inertia": (0.1, 0.2, 0.25, 0.0, 0.0, 0.0)}
    comparison = compare_files(pair(tmp_path, change_part(quadruped(), "base", **other)))
    assert set(list_differences(comparison)) == {
        (kind, "base") for kind in ("mass", "com", "inertia")
    }
    (cause,) = comparison.causes
    assert cause.differences == (0, 1, 2)
    assert format_headline(comparison).startswith(
        "DISAGREE: mass, com and inertia of base all differ, and no single link"
    )


def test_masses_derived_from_geoms_are_one_cause(tmp_path: Path) -> None:
    """As in an MJCF of B2: a body without inertial has the mass of its shapes."""
    files = pair(tmp_path, quadruped())
    text, count = re.subn(
        r'(<body name="thigh[01]"[^>]*>(?:\s*<joint[^>]*/>)?)\s*<inertial[^>]*/>',
        r'\1<geom type="box" size="0.05 0.1 0.1" density="500"/>',
        files.mjcf.read_text(),
    )
    assert count == 2
    files.mjcf.write_text(text)
    comparison = compare_files(files)
    (cause,) = comparison.causes
    assert cause.kind == "geoms"
    assert set(cause.diagnostic.values["bodies"]) == {"thigh0", "thigh1"}
    assert cause.diagnostic.values["mjcf"].value == pytest.approx(2 * 500 * 0.1 * 0.2 * 0.2)
    assert len(cause.differences) == len(comparison.differences) == 6
    assert "states no <inertial> of thigh" in str(cause.diagnostic)


def test_inertials_overridden_by_the_compiler_are_one_cause(tmp_path: Path) -> None:
    files = pair(tmp_path, quadruped())
    box = r'\1<geom type="box" size="0.05 0.1 0.1" density="500"/>'
    text = re.sub(
        r'(<body name="[^"]*"[^>]*>(?:\s*<(?:free)?joint[^>]*/>)?)', box, files.mjcf.read_text()
    )
    files.mjcf.write_text(re.sub(r"<compiler ", '<compiler inertiafromgeom="true" ', text))
    (cause,) = [cause for cause in compare_files(files).causes if cause.kind == "geoms"]
    assert "overrules, by inertiafromgeom, the <inertial> of" in str(cause.diagnostic)


def test_loops_closed_by_the_mjcf_are_one_cause(tmp_path: Path) -> None:
    files = pair(tmp_path, quadruped())
    loops = "".join(
        f'<connect name="loop{leg}" body1="base" body2="shank{leg}" anchor="0 0 0"/>'
        for leg in range(3)
    )
    text = files.mjcf.read_text().replace("</mujoco>", f"<equality>{loops}</equality></mujoco>")
    files.mjcf.write_text(text)
    (cause,) = compare_files(files).causes
    assert cause.kind == "equalities"
    assert set(cause.diagnostic.values["names"]) == {"loop0", "loop1", "loop2"}


def test_unrelated_differences_have_no_common_cause(tmp_path: Path) -> None:
    mjcf = change_part(change_part(quadruped(), "base", mass=6.1), "shank0", mass=0.25, upper=0.1)
    assert compare_files(pair(tmp_path, mjcf)).causes == ()
    assert compare_files(pair(tmp_path, all_changed(quadruped(), friction=0.3))).causes == ()


def offset_joint(text: str, joint: str, pos: str) -> str:
    """Return an MJCF in which a joint is not in its body's origin."""
    assert f'<joint name="{joint}"' in text
    return text.replace(f'<joint name="{joint}"', f'<joint pos="{pos}" name="{joint}"')


def test_displaced_joint_axis_is_the_cause_of_moved_coms(tmp_path: Path) -> None:
    """CoM and child are unmoved in the robot, but displaced in the frame of the moved joint."""
    text = offset_joint(mjcf_text(quadruped()), "hip1", "0 0 0.004")
    comparison = compare_files(write(tmp_path, urdf_text(quadruped()), text))
    assert {("position", "hip1"), ("position", "knee1"), ("com", "hip1")} <= set(
        list_differences(comparison)
    )
    line = get_headline(write(tmp_path, urdf_text(quadruped()), text))
    assert "joint hip1: the axis in the MJCF is displaced by 4 mm, but all" in line


def test_axis_rotated_about_another_point_has_no_offset(tmp_path: Path) -> None:
    """The axes intersect beside the origin of the URDF's joint, so only a rotation is reported."""
    text = mjcf_text(quadruped())
    axis = re.search(r'<joint name="hip1"[^>]*axis="([^"]*)"', text)
    assert axis is not None
    old = np.array([float(word) for word in axis[1].split()])
    across = np.cross(old, (0.3, 0.5, 0.8))
    new = Rotation.from_rotvec(0.2 * across / np.linalg.norm(across)).apply(old)
    turned = axis[0].replace(axis[1], numbers(new))
    text = offset_joint(text.replace(axis[0], turned), "hip1", numbers(0.1 * old))
    line = get_headline(write(tmp_path, urdf_text(quadruped()), text))
    assert "joint hip1: the axis in the MJCF is displaced, rotated by 11.46 deg, but all" in line


def test_moved_body_is_one_difference_with_its_axis(tmp_path: Path) -> None:
    part = quadruped()["thigh1"]
    place = tuple(np.add(part.position, (0.0, 0.0, 0.004)))
    comparison = compare_files(pair(tmp_path, change_part(quadruped(), "thigh1", position=place)))
    assert list_differences(comparison) == [("position", "hip1")]
    assert comparison.causes == ()


def add_gears(text: str, gears: tuple[float, ...]) -> str:
    """Return an MJCF whose motors have gears."""
    names = [f"{kind}{leg}" for leg in range(4) for kind in ("hip", "knee")]
    for name, gear in zip(names, gears, strict=True):
        text = text.replace(f'joint="{name}" ctrlrange', f'joint="{name}" gear="{gear}" ctrlrange')
    return text


def test_efforts_stated_before_the_gear_are_the_first_cause(tmp_path: Path) -> None:
    """As Cassie's: 4.5 N m in the URDF and at ctrl, 112.5 N m at the joint."""
    mjcf = change_part(
        quadruped(), "base", mass=7.0
    )  # one more difference, which is less than the cause
    text = add_gears(mjcf_text(mjcf), (25, 16) * 4)
    comparison = compare_files(write(tmp_path, urdf_text(quadruped()), text))
    line = get_headline(write(tmp_path, urdf_text(quadruped()), text))
    assert "the URDF's efforts of 8 joints are motor torques before the gears" in line
    assert "20 times 25 is 500 on hip0" in line
    assert [cause.kind for cause in comparison.causes] == ["gears"]
    assert {comparison.differences[n].kind for n in comparison.causes[0].differences} == {"effort"}


def test_efforts_that_no_gear_explains(tmp_path: Path) -> None:
    """All efforts differ by a factor of 1.7, without gears and with gears of 25."""
    mjcf = {
        name: replace(part, effort=1.7 * part.effort) if part.joint else part
        for name, part in quadruped().items()
    }
    comparison = compare_files(pair(tmp_path, mjcf))
    assert comparison.causes == ()
    other = add_gears(mjcf_text(mjcf), (25,) * 8)
    assert compare_files(write(tmp_path, urdf_text(quadruped()), other)).causes == ()


def test_an_effort_of_zero_is_no_difference_between_engines(tmp_path: Path) -> None:
    """Pinocchio reads 0 N m and MuJoCo no limit, because the MJCF states none: a difference between
    the files."""
    urdf = urdf_text(change_part(quadruped(), "shank2", effort=0.0))
    comparison = compare_files(write(tmp_path, urdf, mjcf_text(quadruped())))
    assert comparison.engines == ()
    assert list_differences(comparison) == [("effort", "knee2")]


def test_dropped_products_of_inertia_are_one_cause(tmp_path: Path) -> None:
    mjcf = {
        name: replace(part, inertia=(*part.inertia[:3], 0.0, 0.0, 0.0))
        for name, part in quadruped().items()
    }
    line = get_headline(pair(tmp_path, mjcf))
    assert line.startswith("DISAGREE: all products of inertia are 0 in the MJCF; 9 bodies have")


def test_dropped_products_of_one_link_are_no_common_cause(
    tmp_path: Path,
) -> None:
    """A cause explains several differences; one link alone is named itself."""
    mjcf = quadruped()
    name = "thigh2"
    mjcf[name] = replace(mjcf[name], inertia=(*mjcf[name].inertia[:3], 0.0, 0.0, 0.0))
    line = get_headline(pair(tmp_path, mjcf))
    assert "all products of inertia" not in line
    assert name in line


def tensor_of(part: Part) -> np.ndarray:
    xx, yy, zz, xy, xz, yz = part.inertia
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def with_tensor(part: Part, tensor: np.ndarray) -> Part:
    entries = (*np.diag(tensor), tensor[0, 1], tensor[0, 2], tensor[1, 2])
    return replace(part, inertia=tuple(float(entry) for entry in entries))


def state_about_origin(part: Part) -> Part:
    """Return a part whose tensor is about the origin of its link (Steiner) instead of the CoM."""
    com = np.array(part.com)
    shift = part.mass * (com @ com * np.eye(3) - np.outer(com, com))
    return with_tensor(part, tensor_of(part) + shift)


def invert_axes(part: Part) -> Part:
    """Return a part with the tensor E^T D E instead of E D E^T, in the axes of its link."""
    moments, axes = np.linalg.eigh(tensor_of(part))
    return with_tensor(part, axes.T @ np.diag(moments) @ axes)


@pytest.mark.slow
@pytest.mark.parametrize("file", ["URDF", "MJCF"])
def test_tensors_about_the_origin_of_the_link_are_one_cause(file: str, tmp_path: Path) -> None:
    """Steiner: the tensor about the origin exceeds that about the com by m (c.c E - c c^T)."""

    slips = {name: state_about_origin(part) for name, part in quadruped().items()}
    files = (slips, quadruped()) if file == "URDF" else (quadruped(), slips)
    comparison = compare_files(write(tmp_path, urdf_text(files[0]), mjcf_text(files[1])))
    (cause,) = comparison.causes
    assert cause.kind == "inertia origin"
    assert len(cause.differences) == len(comparison.differences)
    assert format_headline(comparison).startswith(
        f"DISAGREE: the {file} states the inertia tensors of"
    )


@pytest.mark.parametrize(
    ("kind", "make"), [("inertia origin", state_about_origin), ("inertia axes", invert_axes)]
)
@pytest.mark.parametrize("file", ["URDF", "MJCF"])
def test_mistaken_tensor_of_a_link_on_a_massless_link_is_found_in_its_own_frame(
    kind: str, make: Callable[[Part], Part], file: str, tmp_path: Path
) -> None:
    """The frame of the link with mass is shifted and rotated in the moving link without mass.
    Reference: Steiner's theorem and the eigenvectors of the tensor, in the axes of that link.
    """
    parts = quadruped()
    for leg in range(2):
        thigh = parts[f"thigh{leg}"]
        turn = tuple(Rotation.from_rotvec([0.4, -0.7, 0.9]).as_quat(scalar_first=True))
        name = f"shell{leg}"
        shell = replace(
            thigh, link=name, parent=thigh.link, joint=f"to_{name}", kind="fixed",
            position=(0.03, -0.02, 0.05), quaternion=turn,
        )  # fmt: skip
        parts |= {thigh.link: replace(thigh, mass=0.0), name: shell}
    slips = parts | {name: make(parts[name]) for name in ("shell0", "shell1")}
    urdf, mjcf = (slips, parts) if file == "URDF" else (parts, slips)
    comparison = compare_files(write(tmp_path, urdf_text(urdf), mjcf_text(mjcf)))
    (cause,) = comparison.causes
    assert cause.kind == kind
    assert len(cause.differences) == len(comparison.differences) == 2


@pytest.mark.slow
def test_tensors_with_axes_of_the_inverse_rotation_are_one_cause(tmp_path: Path) -> None:
    """I = E D E^T in the URDF is E^T D E in the MJCF, as with a conjugated quaternion."""
    mjcf = {name: invert_axes(part) for name, part in quadruped().items()}
    comparison = compare_files(pair(tmp_path, mjcf))
    (cause,) = comparison.causes
    assert cause.kind == "inertia axes"
    assert len(cause.differences) == len(comparison.differences)


@pytest.mark.slow
def test_other_tensors_with_equal_moments_have_no_such_cause(tmp_path: Path) -> None:
    """All inertias rotated by 0.3 rad about x, which none of the three known mistakes explains."""
    turn = Rotation.from_euler("x", 0.3).as_matrix()
    mjcf = {
        name: with_tensor(part, turn @ tensor_of(part) @ turn.T)
        for name, part in quadruped().items()
    }
    comparison = compare_files(pair(tmp_path, mjcf))
    assert "inertia" in {difference.kind for difference in comparison.differences}
    assert not [cause for cause in comparison.causes if "inertia" in cause.kind]


def test_lost_rotation_of_an_inertial_names_the_link(tmp_path: Path) -> None:
    """The MJCF has the six numbers of the URDF, whose <origin> has an rpy of 0.3 and 0.5 rad."""
    origin = f'<origin xyz="{numbers(quadruped()["thigh2"].com)}"/>'
    turned = origin.replace("/>", ' rpy="0.3 0.5 0"/>')
    urdf = urdf_text(quadruped()).replace(origin, turned)
    assert urdf.count(turned) == 1
    comparison = compare_files(write(tmp_path, urdf, mjcf_text(quadruped())))
    (cause,) = comparison.causes
    assert cause.kind == "inertia turn"
    assert cause.diagnostic.values["links"] == ("thigh2",)
    assert len(comparison.differences) == 1


@pytest.mark.parametrize(("factor", "lost"), [(None, 2), (-1, 0)])
def test_effort_of_a_motor_at_a_mimic_joint_is_not_explained(
    factor: float | None, lost: int, tmp_path: Path
) -> None:
    """The MJCF has motors without torque limit. A coupling with another factor is not lost."""
    urdf, mjcf = urdf_text(quadruped()), mjcf_text(quadruped())
    for leg in range(2):
        knee = f'<joint name="knee{leg}" type="revolute">'
        urdf = urdf.replace(knee, f'{knee}<mimic joint="hip{leg}"/>')
        coupling = f'<joint joint1="knee{leg}" joint2="hip{leg}" polycoef="0 {factor} 0 0 0"/>'
        equality = "" if factor is None else f"<equality>{coupling}</equality>"
        mjcf = mjcf.replace("</mujoco>", equality + "</mujoco>")
        limit = re.compile(rf'(<motor [^>]*joint="knee{leg}") ctrlrange="[^"]*"')
        mjcf = limit.sub(r"\1", mjcf)
    comparison = compare_files(write(tmp_path, urdf, mjcf))
    efforts, mimics = ({(kind, f"knee{leg}") for leg in (0, 1)} for kind in ("effort", "mimic"))
    assert efforts | mimics <= set(list_differences(comparison))
    explained = {
        (comparison.differences[index].kind, comparison.differences[index].element)
        for cause in comparison.causes
        for index in cause.differences
    }
    assert not efforts & explained
    assert len(mimics & explained) == lost


def test_lost_mimic_comes_before_the_missing_motor(tmp_path: Path) -> None:
    """A follower without motor in the MJCF has no torque limit there."""
    knee = '<joint name="knee0" type="revolute">'
    urdf = urdf_text(quadruped()).replace(knee, f'{knee}<mimic joint="hip0"/>')
    mjcf = mjcf_text(quadruped())
    limit = re.compile(r'(<joint name="knee0"[^>]*?) actuatorfrcrange="[^"]*"')
    mjcf = re.sub(r'<\w+ [^>]*joint="knee0"[^>]*/>', "", limit.sub(r"\1", mjcf))
    comparison = compare_files(write(tmp_path, urdf, mjcf))
    assert list_differences(comparison) == [("effort", "knee0"), ("mimic", "knee0")]
    assert format_headline(comparison).startswith(
        "DISAGREE: knee0 mimics another joint in the URDF"
    )
