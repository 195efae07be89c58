"""Robots that cannot be: refused by name, by all that would stand on them."""

from __future__ import annotations

from pathlib import Path

import pytest

import pupper_analysis as pa
from tests.support.commands import run_command
from tests.support.tiny import TINY_MJCF, TINY_URDF


def tiny_with(tmp_path: Path, old: str, new: str) -> tuple[Path, Path]:
    assert old in TINY_URDF
    urdf, mjcf = tmp_path / "tiny.urdf", tmp_path / "tiny.xml"
    urdf.write_text(TINY_URDF.replace(old, new, 1))
    mjcf.write_text(TINY_MJCF)
    return urdf, mjcf


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('mass value="0.5"', 'mass value="-0.5"', "what joint 'turn' moves has a mass of -0.5 kg"),
        ('mass value="2"', 'mass value="-2"', "the base has a mass of -2 kg"),
        (
            'ixx="0.02"',
            'ixx="-0.02"',
            "a mass of 2 kg and moments of inertia from -0.02",
        ),
        ('ixx="0.001"', 'ixx="-1"', "what joint 'bend' moves"),
    ],
)
def test_negative_masses_and_inertias_are_refused_where_it_would_stand(
    old: str, new: str, message: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    urdf, mjcf = tiny_with(tmp_path, old, new)
    robot = pa.load_robot(urdf=urdf, mjcf=mjcf, feet=["foot"])
    with pytest.raises(pa.ModelError) as caught:
        pa.solve_stand(robot)
    assert message in str(caught.value)
    # The comparison is there to find it.
    status, _, err = run_command(capfd, "crosscheck", str(urdf), str(mjcf))
    assert status in (1, 2)
    assert "unforeseen" not in err


@pytest.mark.parametrize("kind", ["planar", "floating"])
def test_joints_of_more_coordinates_are_refused_or_fixed(
    kind: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    urdf, mjcf = tiny_with(tmp_path, 'name="push" type="prismatic"', f'name="push" type="{kind}"')
    arguments = ("stand", "--urdf", str(urdf), "--mjcf", str(mjcf), "--foot", "foot")
    status, _, err = run_command(capfd, *arguments)
    assert status in (0, 1, 2)
    assert "unforeseen" not in err


def test_a_colour_with_commas_is_one_line(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "colour.xml"
    file.write_text(TINY_MJCF.replace('type="sphere"', 'type="sphere" rgba="1,0,0,1"'))
    status, _, err = run_command(capfd, "audit", str(file))
    assert status == 2
    assert "rgba" in err
    assert len(err.splitlines()) == 1
