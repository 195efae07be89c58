"""One slip is named in the first line, in place of twenty differences."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.robots import (
    Files,
    Parts,
    all_changed,
    changed,
    compared,
    found,
    headline,
    mjcf_text,
    quadruped,
    urdf_text,
    write,
)


def first_line(files: Files) -> str:
    comparison = compared(files)
    assert not comparison.agree
    assert comparison.complete
    return headline(comparison)


def pair(folder: Path, mjcf: Parts) -> Files:
    return write(folder, urdf_text(quadruped()), mjcf_text(mjcf))


def test_one_mass_ten_times_too_large(tmp_path: Path) -> None:
    line = first_line(pair(tmp_path, changed(quadruped(), "shank2", mass=2.2)))
    assert line.startswith("DISAGREE: link shank2: mass 0.22 kg in the URDF, 2.2 kg in the MJCF")
    assert "(ten times: a decimal point?)" in line


def test_products_of_inertia_that_are_dropped(tmp_path: Path) -> None:
    mjcf = {
        name: replace(part, inertia=(*part.inertia[:3], 0.0, 0.0, 0.0))
        for name, part in quadruped().items()
    }
    line = first_line(pair(tmp_path, mjcf))
    assert line.startswith("DISAGREE: all products of inertia are 0 in the MJCF, of 9 bodies")


def test_what_matters_most_is_said_first(tmp_path: Path) -> None:
    """A slip before a limit that differs as well, and after a base of nine times the mass."""
    thigh = quadruped()["thigh0"]
    tenfold = {"mass": 10 * thigh.mass, "inertia": tuple(10 * np.array(thigh.inertia))}
    limit = changed(changed(quadruped(), "thigh0", **tenfold), "shank3", lower=-2.51)
    heavy = changed(limit, "base", mass=9 * quadruped()["base"].mass)
    for mjcf, said in ((limit, "mass and inertia of thigh0"), (heavy, "link base: mass")):
        comparison = compared(pair(tmp_path, mjcf))
        assert len(comparison.causes) == 1
        assert len(comparison.unexplained) > 0
        assert headline(comparison).startswith(f"DISAGREE: {said}")


def test_the_base_of_another_robot(tmp_path: Path) -> None:
    other = {"mass": 11.0, "com": (0.03, 0.0, 0.01), "inertia": (0.1, 0.2, 0.25, 0.0, 0.0, 0.0)}
    comparison = compared(pair(tmp_path, changed(quadruped(), "base", **other)))
    assert set(found(comparison)) == {(kind, "base") for kind in ("mass", "com", "inertia")}
    (cause,) = comparison.causes
    assert cause.differences == (0, 1, 2)
    assert headline(comparison).startswith(
        "DISAGREE: the inertial of base differs in mass, com and inertia, and no single link"
    )


def test_masses_that_mujoco_takes_from_geoms_are_one_cause(tmp_path: Path) -> None:
    """As in an MJCF of B2: its base states none, and its shapes weigh as water does."""
    files = pair(tmp_path, quadruped())
    text, count = re.subn(
        r'(<body name="thigh[01]"[^>]*>(?:\s*<joint[^>]*/>)?)\s*<inertial[^>]*/>',
        r'\1<geom type="box" size="0.05 0.1 0.1" density="500"/>',
        files.mjcf.read_text(),
    )
    assert count == 2
    files.mjcf.write_text(text)
    comparison = compared(files)
    (cause,) = comparison.causes
    assert cause.kind == "geoms"
    assert set(cause.diagnostic.values["bodies"]) == {"thigh0", "thigh1"}
    assert cause.diagnostic.values["mjcf"].value == pytest.approx(2 * 500 * 0.1 * 0.2 * 0.2)
    assert len(cause.differences) == len(comparison.differences) == 6
    assert "states no <inertial> of thigh" in str(cause.diagnostic)


def test_inertials_that_the_compiler_overrules_are_said_to_be(tmp_path: Path) -> None:
    files = pair(tmp_path, quadruped())
    box = r'\1<geom type="box" size="0.05 0.1 0.1" density="500"/>'
    text = re.sub(
        r'(<body name="[^"]*"[^>]*>(?:\s*<(?:free)?joint[^>]*/>)?)', box, files.mjcf.read_text()
    )
    files.mjcf.write_text(re.sub(r"<compiler ", '<compiler inertiafromgeom="true" ', text))
    (cause,) = [one for one in compared(files).causes if one.kind == "geoms"]
    assert "overrules, by inertiafromgeom, the <inertial> of" in str(cause.diagnostic)


def test_loops_that_the_mjcf_closes_are_one_cause(tmp_path: Path) -> None:
    files = pair(tmp_path, quadruped())
    loops = "".join(
        f'<connect name="loop{leg}" body1="base" body2="shank{leg}" anchor="0 0 0"/>'
        for leg in range(3)
    )
    text = files.mjcf.read_text().replace("</mujoco>", f"<equality>{loops}</equality></mujoco>")
    files.mjcf.write_text(text)
    (cause,) = compared(files).causes
    assert cause.kind == "equalities"
    assert set(cause.diagnostic.values["names"]) == {"loop0", "loop1", "loop2"}


def test_no_pattern_where_there_is_none(tmp_path: Path) -> None:
    mjcf = changed(changed(quadruped(), "base", mass=6.1), "shank0", mass=0.25, upper=0.1)
    assert compared(pair(tmp_path, mjcf)).causes == ()
    assert compared(pair(tmp_path, all_changed(quadruped(), friction=0.3))).causes == ()


def geared(text: str, gears: tuple[float, ...]) -> str:
    """An MJCF whose motors have gears, and what the URDF says for a range before them."""
    names = [f"{kind}{leg}" for leg in range(4) for kind in ("hip", "knee")]
    for name, gear in zip(names, gears, strict=True):
        text = text.replace(f'joint="{name}" ctrlrange', f'joint="{name}" gear="{gear}" ctrlrange')
    return text


def test_efforts_before_the_gear_are_told_first(tmp_path: Path) -> None:
    """As Cassie's: 4.5 N m in the URDF and at ctrl, 112.5 N m at the joint."""
    mjcf = changed(quadruped(), "base", mass=7.0)  # a kilogram goes before efforts, but not first
    text = geared(mjcf_text(mjcf), (25, 16) * 4)
    comparison = compared(write(tmp_path, urdf_text(quadruped()), text))
    line = first_line(write(tmp_path, urdf_text(quadruped()), text))
    assert "the URDF's efforts of 8 joints are the motors', before their gears" in line
    assert "20 times 25 is 500 on hip0" in line
    assert [cause.kind for cause in comparison.causes] == ["gears"]
    assert {comparison.differences[n].kind for n in comparison.causes[0].differences} == {"effort"}


def test_efforts_that_no_gear_explains(tmp_path: Path) -> None:
    """The MJCF's forces are the joints' already: the URDF's are wrong, or another motor's."""
    mjcf = {
        name: replace(part, effort=1.7 * part.effort) if part.joint else part
        for name, part in quadruped().items()
    }
    comparison = compared(pair(tmp_path, mjcf))
    assert comparison.causes == ()
    other = geared(mjcf_text(mjcf), (25,) * 8)
    assert compared(write(tmp_path, urdf_text(quadruped()), other)).causes == ()


def test_an_effort_of_zero_is_no_difference_between_engines(tmp_path: Path) -> None:
    """Pinocchio reads 0 N m, MuJoCo none: the file states none."""
    urdf = urdf_text(changed(quadruped(), "shank2", effort=0.0))
    comparison = compared(write(tmp_path, urdf, mjcf_text(quadruped())))
    assert comparison.engines == ()
    assert found(comparison) == [("effort", "knee2")]
