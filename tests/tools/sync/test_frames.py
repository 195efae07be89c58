"""Synchronisation of files whose link frames, bases and joint zeros differ."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

import pupper_analysis as pa
from tests.support.robots import (
    Parts,
    arm,
    change_part,
    files_agree,
    mjcf_text,
    quadruped,
    turned_about,
    turned_frames,
    urdf_text,
    write,
)

ROBOT = quadruped()

CHANGES = [
    ("thigh1", {"mass": 1.3}),
    ("thigh1", {"com": (0.02, 0.01, -0.05)}),
    ("shank2", {"inertia": (0.0016, 0.0015, 4e-4, 2e-5, 1e-5, 3e-5)}),
    ("shank2", {"position": (0.01, 0.07, -0.19)}),
    ("thigh0", {"lower": -0.7, "upper": 1.1}),
    ("shank0", {"effort": 12.5}),
    ("shank0", {"damping": 0.25, "friction": 0.0}),
]


@pytest.mark.slow
@pytest.mark.parametrize("side", ["urdf", "mjcf"])
@pytest.mark.parametrize(("link", "values"), CHANGES, ids=[str(i) for i in range(len(CHANGES))])
def test_link_frames_that_are_turned(
    tmp_path: Path, link: str, values: dict[str, object], side: str
) -> None:
    """Every body of the MJCF has another frame, and keeps it."""
    files = write(tmp_path, urdf_text(change_part(ROBOT, link, **values)), turned_frames(ROBOT, 3))
    before = [file.read_text() for file in files]
    result = pa.sync_models(*files, take=side)
    assert result.agree
    assert files_agree(files)
    assert len(result.edits) <= 6
    other = files.urdf if side == "urdf" else files.mjcf
    assert other.read_text() == before[0 if side == "urdf" else 1]
    # After a reverted change, all other numbers of the URDF have the same digits.
    if side == "mjcf":
        words = re.findall(r'"([^"]*)"', urdf_text(ROBOT))
        after = re.findall(r'"([^"]*)"', files.urdf.read_text())
        for first, second in zip(words, after, strict=True):
            if first != second:
                numbers = [[float(word) for word in text.split()] for text in (first, second)]
                assert numbers[0] == pytest.approx(numbers[1], rel=1e-11, abs=1e-11)


@pytest.mark.slow
@pytest.mark.parametrize("side", ["urdf", "mjcf"])
@pytest.mark.parametrize(
    ("link", "values"),
    [
        ("boom", {"position": (0.06, 0.0, 0.25)}),
        ("rod", {"lower": -0.1, "effort": 7.0}),
        ("column", {"mass": 2.0, "com": (0.1, 0.0, 0.0)}),
    ],
)
def test_arm_on_a_displaced_base_is_synchronised(
    tmp_path: Path, link: str, values: dict[str, object], side: str
) -> None:
    mjcf = mjcf_text(arm(), free=False, base_position=(0.3, -0.2, 0.7))
    files = write(tmp_path, urdf_text(change_part(arm(), link, **values)), mjcf)
    result = pa.sync_models(*files, take=side)
    assert result.agree
    assert files_agree(files)
    if side == "mjcf":
        assert 1 <= len(result.edits) <= 2


def shift_knee_zero(**more: Any) -> Parts:
    """Return the robot with a knee's zero and limits shifted by 0.4 rad, and with further
    changes.
    """
    part = ROBOT["shank1"]
    turned = turned_about(part, part.axis, 0.4)
    limits = {"lower": part.lower - 0.4, "upper": part.upper - 0.4}
    return change_part(ROBOT, "shank1", quaternion=turned, **limits, **more)


@pytest.mark.slow
def test_difference_beside_a_joint_zero_is_written_in_the_own_convention(tmp_path: Path) -> None:
    part, moved = ROBOT["shank1"], shift_knee_zero(position=(0.01, 0.08, -0.2))
    for side in ("urdf", "mjcf"):
        files = write(tmp_path, urdf_text(ROBOT), mjcf_text(moved))
        result = pa.sync_models(*files, take=f"{side}:position")
        assert [left.difference for left in result.not_mended] == ["joint knee1: zero"]
        assert [edit.attribute for edit in result.edits] == ["pos" if side == "urdf" else "xyz"]
        (edit,) = result.edits
        there = part.position if side == "urdf" else (0.01, 0.08, -0.2)
        assert [float(word) for word in edit.new.split()] == pytest.approx(list(there), abs=1e-12)


@pytest.mark.slow
def test_different_base_frame_is_not_changed(tmp_path: Path) -> None:
    """Other differences are written in the base frame of each file."""
    x, y, z = ROBOT["base"].com
    parts = change_part(ROBOT, "base", com=(x, y, z + 0.05))
    for name, part in ROBOT.items():
        if part.parent == "base":
            x, y, z = part.position
            parts = change_part(parts, name, position=(x, y, z + 0.05))
    heavier = change_part(parts, "base", mass=7.0)
    for side in ("urdf", "mjcf"):
        files = write(tmp_path, urdf_text(ROBOT), mjcf_text(heavier))
        result = pa.sync_models(*files, take=side)
        assert [left.difference for left in result.not_mended] == ["base: base frame"]
        assert "a change would move all parts of the base" in str(result.not_mended[0].reason)
        assert [edit.attribute for edit in result.edits] == ["mass" if side == "urdf" else "value"]


@pytest.mark.slow
def test_positions_inside_a_frame_are_not_changed(tmp_path: Path) -> None:
    """Positions of bodies, joints and sites inside a <frame> are relative to the frame."""
    text = mjcf_text(ROBOT)
    leg = text[text.index('<body name="thigh2"') : text.index('<body name="thigh3"')]
    # The same leg, in a frame that is moved by (0.05, 0.02, 0) in the base.
    inside = leg.replace('pos="-0.2 -0.1 0.01"', 'pos="-0.25 -0.12 0.01"', 1)
    assert inside != leg
    framed = text.replace(leg, f'<frame pos="0.05 0.02 0">{inside}</frame>')
    files = write(tmp_path, urdf_text(ROBOT), framed)
    assert pa.sync_models(*files).agree
    other = change_part(ROBOT, "thigh2", position=(-0.21, -0.1, 0.01))
    files = write(tmp_path, urdf_text(other), framed)
    before = files.mjcf.read_bytes()
    result = pa.sync_models(*files, take="urdf")
    assert {left.reason.code for left in result.not_mended} >= {"place-in-a-frame"}
    assert result.withheld
    assert files.mjcf.read_bytes() == before
    assert pa.sync_models(*files, take="mjcf").agree
    assert files_agree(files)


@pytest.mark.slow
def test_body_of_an_offset_joint_is_not_changed(tmp_path: Path) -> None:
    """A change of the joint position would move the body relative to its shapes."""
    text = mjcf_text(ROBOT).replace('<joint name="hip2"', '<joint name="hip2" pos="0 0.01 -0.02"')
    files = write(tmp_path, urdf_text(ROBOT), text)
    result = pa.sync_models(*files, take="urdf")
    assert {left.reason.code for left in result.not_mended} >= {"joint-off-its-body"}
    assert result.withheld
    assert files.mjcf.read_text() == text
    assert pa.sync_models(*files, take="mjcf").agree
    assert files_agree(files)


def test_attached_copies_are_not_changed(tmp_path: Path) -> None:
    """An attached leg is in a file of its own, with names without the prefix."""
    parts = {name: part for name, part in ROBOT.items() if name in ("base", "thigh0", "shank0")}
    text = mjcf_text(parts)
    start, end = text.index('<body name="thigh0"'), text.rindex("</body>\n</worldbody>")
    leg, motors = text[start:end], re.findall(r"<motor .*/>\n", text)
    (tmp_path / "leg.xml").write_text(
        f'<mujoco model="leg"><compiler angle="radian"/><worldbody>{leg}</worldbody></mujoco>'
    )
    main = text.replace(leg, '<attach model="leg" body="thigh0" prefix="a_"/>')
    for motor in motors:
        main = main.replace(motor, "")
    main = main.replace(
        "<worldbody>", '<asset><model name="leg" file="leg.xml"/></asset><worldbody>'
    )
    files = write(tmp_path, urdf_text(change_part(parts, "thigh0", mass=2.0)), main)
    before = (tmp_path / "leg.xml").read_bytes()
    result = pa.sync_models(*files, take="urdf:mass")
    reasons = {left.difference: str(left.reason) for left in result.not_mended}
    (reason,) = [text for name, text in reasons.items() if name.endswith(": mass")]
    assert "the body is a copy of another" in reason
    assert (tmp_path / "leg.xml").read_bytes() == before
