"""Synchronisation of two files: selected differences, written values in the units of each file, and
remaining differences.
"""

from __future__ import annotations

import errno
import math
import os
import random
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import pupper_analysis as pa
from pupper_analysis.base.errors import ModelError, OutputError
from pupper_analysis.models.git import refuse_uncommitted
from pupper_analysis.models.urdf_file import read_urdf
from pupper_analysis.models.xml_bytes import read_xml_bytes
from pupper_analysis.tools.sync import models
from pupper_analysis.tools.sync.digits import format_numbers, format_shortest
from pupper_analysis.tools.sync.document import sync_document
from pupper_analysis.tools.sync.frames import is_same_body
from pupper_analysis.tools.sync.plan import UnwrittenCause, list_urdf_files
from tests.support.hidden_files import leave_hidden_file
from tests.support.robots import (
    Files,
    Parts,
    change_part,
    files_agree,
    mjcf_text,
    quadruped,
    urdf_text,
    write,
    write_parts,
)

ROBOT = quadruped()


def pair(folder: Path, mjcf: Parts = ROBOT, urdf: Parts = ROBOT) -> Files:
    return write_parts(folder, urdf, mjcf)


def sync(files: Files, take: Any = (), **options: Any) -> pa.sync.Sync:
    return pa.sync_models(files.urdf, files.mjcf, take=take, **options)


def edits(result: pa.sync.Sync) -> list[tuple[str, str, str | None, str]]:
    return [(edit.element, edit.attribute, edit.old, edit.new) for edit in result.edits]


def replace_text(file: Path, old: str, new: str, count: int = 1) -> None:
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, count))


# ------------------------------------------------------------------------------------- choices


DIFFERENT = change_part(change_part(ROBOT, "base", mass=7.0), "thigh1", effort=25.0, damping=0.3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("take", "expected"),
    [
        (["mjcf"], {"mass": "mjcf", "effort": "mjcf", "damping": "mjcf"}),
        (["mjcf:link base: mass"], {"mass": "mjcf"}),
        (["urdf:base"], {"mass": "urdf"}),
        (["urdf:link base"], {"mass": "urdf"}),
        (["urdf:mass", "mjcf:hip1"], {"mass": "urdf", "effort": "mjcf", "damping": "mjcf"}),
        (["mjcf:joint hip1: effort"], {"effort": "mjcf"}),
        (["mjcf:1"], {"mass": "mjcf"}),
        (["mjcf:2-3", "urdf:1"], {"mass": "urdf", "effort": "mjcf", "damping": "mjcf"}),
        # The more specific choice has precedence in both orders.
        (["urdf:effort", "mjcf"], {"mass": "mjcf", "effort": "urdf", "damping": "mjcf"}),
        (["urdf:3", "mjcf:hip1"], {"effort": "urdf", "damping": "mjcf"}),
    ],
)
def test_choices_are_a_side_a_kind_or_a_number(
    tmp_path: Path, take: list[str], expected: dict[str, str]
) -> None:
    files = pair(tmp_path, DIFFERENT)
    result = sync(files, take, dry_run=True)
    assert {label.rpartition(": ")[2]: side for label, side in result.taken.items()} == expected
    assert len(result.edits) == len(expected)
    assert result.agree == (len(expected) == 3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("take", "said"),
    [
        ("both", "'both' does not have the form urdf, mjcf, urdf:WHICH or mjcf:WHICH"),
        ("urdf:", "'urdf:' does not have the form"),
        ("urdf:tail", "no difference 'tail'; the differences are: link base: mass; joint hip1"),
        ("urdf:4", "'4': the differences are numbered from 1 to 3"),
        ("urdf:0", "'0': the differences are numbered from 1 to 3"),
        ("urdf:2-1", "'2-1': the differences are numbered from 1 to 3"),
    ],
)
def test_invalid_choices_are_refused(tmp_path: Path, take: str, said: str) -> None:
    with pytest.raises(pa.ConfigurationError, match=re.escape(said)):
        sync(pair(tmp_path, DIFFERENT), take)


# ------------------------------------------------------------------------------------- forms


def test_degrees_of_the_file_are_kept(tmp_path: Path) -> None:
    files = pair(tmp_path)
    text = files.mjcf.read_text().replace('angle="radian"', 'angle="degree"')
    text = re.sub(
        r'(?<!l)range="(\S+) (\S+)"',
        lambda m: f'range="{math.degrees(float(m[1]))!r} {math.degrees(float(m[2]))!r}"',
        text,
    )
    files.mjcf.write_text(text)
    replace_text(files.urdf, 'lower="-1.0" upper="0.9"', 'lower="-0.5" upper="0.9"')
    (limit,) = sync(files, "urdf").edits
    assert files_agree(files)
    assert float(limit.new.split()[0]) == pytest.approx(math.degrees(-0.5), rel=1e-15)


@pytest.mark.slow
def test_directional_attributes_are_not_changed(tmp_path: Path) -> None:
    """Rotations and axes stay; a mass, which has no direction, is written if selected."""
    files = pair(tmp_path, change_part(ROBOT, "base", mass=7.0))
    text = files.mjcf.read_text()
    files.mjcf.write_text(
        re.sub(r'(body name="thigh1"[^>]*) quat="[^"]*"', r'\1 zaxis="0 1 1"', text)
    )
    replace_text(files.urdf, '<axis xyz="1.0 0.0 0.0"/>', '<axis xyz="-1.0 0.0 0.0"/>')
    for side in ("urdf", "mjcf"):
        result = sync(files, side, dry_run=True)
        kinds = {left.difference.rpartition(": ")[2] for left in result.not_mended}
        assert kinds == {"rotation", "axis"}
        assert {left.reason.code for left in result.not_mended} == {"direction-unwritten"}
        assert not result.agree
    assert [edit.attribute for edit in sync(files, "urdf:mass").edits] == ["mass"]


@pytest.mark.parametrize("quaternion", ["0.9 0.1 -0.2 0.3", ""])
def test_inertia_is_written_as_moments_and_quaternion_if_the_file_has_these(
    tmp_path: Path, quaternion: str
) -> None:
    tensor = (0.002, 0.003, 0.004, 1e-4, -2e-4, 3e-4)
    files = pair(tmp_path, urdf=change_part(ROBOT, "base", inertia=tensor))
    moments = 'diaginertia="0.002 0.003 0.004"' + (f' quat="{quaternion}"' if quaternion else "")
    text = re.sub('fullinertia="[^"]*"', moments, files.mjcf.read_text(), count=1)
    files.mjcf.write_text(text)
    result = sync(files, "urdf")
    assert [edit.attribute for edit in result.edits] == ["diaginertia", "quat"]
    assert files_agree(files)


def test_urdf_inertia_is_written_in_the_turned_axes_of_its_origin(tmp_path: Path) -> None:
    """The two files agree afterwards only if the tensor is turned in the right direction."""
    files = pair(tmp_path)
    replace_text(files.urdf, '<origin xyz="0.01 0.002 -0.005"/>',
             '<origin xyz="0.01 0.002 -0.005" rpy="0.3 -0.4 0.9"/>')  # fmt: skip
    result = sync(files, "mjcf")
    assert {edit.element for edit in result.edits} == {"link base > inertial > inertia"}
    assert files_agree(files)


def test_other_inertia_orientations_are_not_changed(tmp_path: Path) -> None:
    files = pair(tmp_path, change_part(ROBOT, "base", mass=7.0))
    moments = 'diaginertia="0.002 0.003 0.004" euler="0.1 0.2 0.3"'
    text = re.sub('fullinertia="[^"]*"', moments, files.mjcf.read_text(), count=1)
    files.mjcf.write_text(text)
    result = sync(files, "urdf")
    assert result.withheld
    assert {left.reason.code for left in result.not_mended} == {"no-body-to-change"}
    assert files.mjcf.read_text() == text


def test_includes_are_changed_in_place(tmp_path: Path) -> None:
    files = pair(tmp_path, change_part(ROBOT, "shank3", mass=0.5))
    lines = files.mjcf.read_text().split("\n")
    first = next(i for i, line in enumerate(lines) if 'name="thigh3"' in line)
    last = max(i for i, line in enumerate(lines) if line == "</body>")  # of the base
    part = ["<mujocoinclude>", "<!-- a leg -->", *lines[first:last], "</mujocoinclude>"]
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "leg.xml").write_text("\r\n".join(part))
    files.mjcf.write_text(
        "\n".join([*lines[:first], '<include file="parts/leg.xml"/>', *lines[last:]])
    )
    before = files.mjcf.read_bytes()
    leg = (tmp_path / "parts" / "leg.xml").read_bytes()
    result = sync(files, "urdf")
    assert files_agree(files)
    assert result.written == (str(tmp_path / "parts" / "leg.xml"),)
    assert files.mjcf.read_bytes() == before
    after = (tmp_path / "parts" / "leg.xml").read_bytes()
    (mass,) = result.edits
    assert float(mass.new) == pytest.approx(ROBOT["shank3"].mass, rel=1e-15)
    assert after == leg.replace(b'mass="0.5"', f'mass="{mass.new}"'.encode())
    assert len(list(tmp_path.rglob("*.xml"))) == 2


def test_text_around_a_changed_number_is_kept(tmp_path: Path) -> None:
    """A byte order mark, a declaration, comments, white space, quotes, line ends, letters."""
    files = pair(tmp_path)
    text = files.urdf.read_text().replace("\n", "\r\n")
    text = text.replace('<mass value="6.0"/>', "<mass\tvalue = '6.5' /><!-- Gewölbe: value='6' -->")
    data = b"\xef\xbb\xbf" + f"<?xml version='1.0'?>\r\n<!-- <mass> -->{text}".encode()
    files.urdf.write_bytes(data)
    result = sync(files, "mjcf")
    assert result.agree
    assert files.urdf.read_bytes() == data.replace(b"value = '6.5'", b"value = '6'")


def test_missing_element_is_inserted(tmp_path: Path) -> None:
    files = pair(tmp_path)
    text = files.urdf.read_text()
    inertial = text[text.index("<inertial>") : text.index("</inertial>") + len("</inertial>")]
    origin = re.search(r"<origin xyz=\"0.2 -0.1[^>]*>\n", text) or re.search(
        r"<origin xyz=\"0.2 [^>]*>\n", text
    )
    assert origin is not None
    text = text.replace(f"{inertial}\n", "", 1).replace(
        origin[0], re.sub(' xyz="[^"]*"', "", origin[0]), 1
    )
    text = text.replace('<dynamics damping="0.1" friction="0.2"/>\n', "", 1)
    files.urdf.write_text(text)
    result = sync(files, "mjcf")
    assert result.agree
    assert files_agree(files)
    assert {edit.old for edit in result.edits} == {None}
    assert '<mass value="6"/>' in files.urdf.read_text()


@pytest.mark.slow
def test_missing_limits_are_inserted(tmp_path: Path) -> None:
    endless = change_part(ROBOT, "thigh2", kind="continuous")
    files = pair(tmp_path, urdf=endless)
    assert sync(files, "mjcf").agree
    assert files_agree(files)
    assert files.urdf.read_text().count('type="continuous"') == 0
    files = pair(tmp_path, endless)
    assert edits(sync(files, "urdf")) == [("joint hip2", "range", None, "-1.02 0.9")]
    assert files_agree(files)


@pytest.mark.slow
def test_unstated_values_overwrite_nothing(tmp_path: Path) -> None:
    """An effort of 0 is no limit, and a missing <dynamics> or attribute is not 0."""
    heavy = change_part(ROBOT, "base", mass=7.0)
    stated = re.sub('effort="[^"]*"', 'effort="0"', urdf_text(heavy))
    files = write(tmp_path, re.sub("<dynamics [^>]*/>", "", stated), mjcf_text(ROBOT))
    result = sync(files, "urdf")
    assert [(e, a) for e, a, *_ in edits(result)] == [("body base > inertial", "mass")]
    assert {left.cause for left in result.not_mended} == {UnwrittenCause.NOT_STATED}
    assert len([left for left in result.not_mended if left.difference.endswith("effort")]) == 8
    values = [left.reason.values for left in result.not_mended]
    assert {(message["lacking"], message["stating"]) for message in values} == {("URDF", "MJCF")}
    assert not result.withheld
    assert 'mass="7' in files.mjcf.read_text()
    assert "limited" not in files.mjcf.read_text()
    bare = re.sub(r' (damping|frictionloss)="[^"]*"', "", mjcf_text(ROBOT))
    files = write(tmp_path, urdf_text(heavy), bare)
    before = files.urdf.read_text()
    result = sync(files, "mjcf")
    assert edits(result) == [("link base > inertial > mass", "value", "7.0", "6")]
    assert {left.cause for left in result.not_mended} == {UnwrittenCause.NOT_STATED}
    values = [left.reason.values for left in result.not_mended]
    assert {(message["lacking"], message["stating"]) for message in values} == {("MJCF", "URDF")}
    assert files.urdf.read_text().count("damping") == before.count("damping") > 0


@pytest.mark.slow
def test_all_chosen_changes_are_written_or_none(tmp_path: Path) -> None:
    """A body that cannot be changed would leave files that describe a mixture of two robots."""
    parts = {**ROBOT, "pad": type(ROBOT["base"])("pad", "shank0", "to_pad", "fixed")}
    parts = change_part(change_part(parts, "shank0", mass=1.0), "thigh1", mass=2.0)
    files = write(tmp_path, urdf_text(parts), mjcf_text(ROBOT))
    before = files.urdf.read_bytes(), files.mjcf.read_bytes()
    for dry in (True, False):
        result = sync(files, "mjcf", dry_run=dry)
        assert result.withheld
        assert result.written == ()
        assert [edit[0] for edit in edits(result)] == ["link thigh1 > inertial > mass"]
        assert {left.cause for left in result.not_mended} == {UnwrittenCause.NOT_MENDED}
        assert {left.difference for left in result.not_mended} == {
            f"link shank0: {kind}" for kind in ("mass", "com", "inertia")
        }
        assert {left.reason.code for left in result.not_mended} == {"no-link-to-change"}
        step = sync_document(result, dry_run=dry).next_step  # the same choice writes nothing
        assert step is not None
        assert step.command != "sync"
        assert (files.urdf.read_bytes(), files.mjcf.read_bytes()) == before
    for choice, options in (("mjcf", {"partial": True}), ("mjcf:link thigh1", {})):
        files = write(tmp_path, urdf_text(parts), mjcf_text(ROBOT))
        result = sync(files, choice, **options)
        assert not result.withheld
        assert result.written == (str(files.urdf),)


# ------------------------------------------------------------------------------------- bodies


def test_merged_link_with_the_fewest_changes_is_edited(tmp_path: Path) -> None:
    """A foot on a fixed joint weighs 0.1 kg in the URDF, 0.12 kg in the MJCF's one body."""
    foot = ROBOT["shank0"]
    parts = {**ROBOT, "pad": type(foot)("pad", "shank0", "to_pad", "fixed", (0, 0, -0.2), mass=0.1)}
    heavy = change_part(parts, "pad", mass=0.12)
    files = write(tmp_path, urdf_text(parts), mjcf_text(heavy))
    result = sync(files, "mjcf")
    assert edits(result) == [("link pad > inertial > mass", "value", "0.1", "0.12")]
    assert files_agree(files)
    # Of the mass alone, the sum can be made right as well, by the shank.
    files = write(tmp_path, urdf_text(parts), mjcf_text(heavy))
    result = sync(files, "mjcf:mass")
    assert not result.agree
    assert {left.reason.code for left in result.not_mended} == {"nothing-chosen"}
    assert len(result.edits) >= 1


def test_body_with_mass_from_shapes_gets_an_inertial(tmp_path: Path) -> None:
    files = pair(tmp_path)
    text = re.sub(
        r"<inertial [^>]*/>", '<geom size="0.1" mass="6"/>', files.mjcf.read_text(), count=1
    )
    files.mjcf.write_text(text)
    result = sync(files, "urdf")
    assert files_agree(files)
    assert {edit.attribute for edit in result.edits} == {"pos", "mass", "fullinertia"}
    files.mjcf.write_text(text.replace("<compiler", '<compiler inertiafromgeom="true"'))
    result = sync(files, "urdf:base")
    assert result.edits == ()
    assert not result.agree


# ------------------------------------------------------------------------------------- left


def test_values_that_a_urdf_cannot_state_are_reported(tmp_path: Path) -> None:
    sprung = mjcf_text(change_part(ROBOT, "base", mass=7.0)).replace(
        '<joint name="knee1"', '<joint name="knee1" stiffness="3"'
    )
    sprung = sprung.replace('<joint name="hip1"', '<joint name="hip1" springref="0.1"')
    files = write(tmp_path, urdf_text(ROBOT), sprung)
    for side, said in (
        ("mjcf", "not expressible in a URDF"),
        ("urdf", "only in the MJCF: delete the element there by hand"),
    ):
        result = sync(files, side, dry_run=True)
        assert [
            (remaining.difference, str(remaining.reason)) for remaining in result.not_mended
        ] == [("joint knee1: spring", said)]
        assert [edit.attribute for edit in result.edits] == ["value" if side == "mjcf" else "mass"]
        assert not result.agree


def test_joint_of_one_file_alone_is_not_changed(tmp_path: Path) -> None:
    fixed = change_part(ROBOT, "shank2", kind="fixed")
    files = pair(tmp_path, urdf=fixed)
    result = sync(files, "urdf")
    assert ("joint knee2", "only the MJCF contains this element, not the URDF") in [
        (left.difference, str(left.reason)) for left in result.not_mended
    ]
    assert not result.agree


# ------------------------------------------------------------------------------------- writing


def test_files_that_agree_are_not_changed(tmp_path: Path) -> None:
    files = pair(tmp_path)
    before = [file.read_bytes() for file in files]
    result = sync(files, "urdf")
    assert result.agree
    assert (result.edits, result.not_mended, result.written, result.diff) == ((), (), (), "")
    assert [file.read_bytes() for file in files] == before


def test_written_numbers_have_the_fewest_digits_of_their_value() -> None:
    """Rounding errors of 1e-16 are no digits; unchanged numbers keep their text."""
    assert format_shortest(0.12345678901230004, 1.0) == "0.1234567890123"
    assert format_shortest(-0.0025, 1.0) == "-0.0025"
    assert format_shortest(0.30000000000000004, 1.0) == "0.3"
    assert float(format_shortest(1 / 3, 1.0)) == pytest.approx(1 / 3, abs=1e-15)
    assert format_shortest(1e-17, 1.0) == "0"
    assert format_shortest(3.0, 1.0) == "3"
    assert format_numbers(["1.50", "0"], [1.5, 2.0]) == "1.50 2"
    assert format_numbers(["1.50", "2"], [1.5, 2.0]) is None


def test_dry_run_shows_the_changes_without_writing(tmp_path: Path) -> None:
    """Reference: the program `patch` with the printed difference."""
    files = pair(tmp_path, DIFFERENT)
    before = files.mjcf.read_text()
    result = sync(files, "urdf", dry_run=True)
    assert result.agree
    assert result.written == ()
    assert files.mjcf.read_text() == before
    (tmp_path / "the.patch").write_text(result.diff)
    patch = ["patch", "--quiet", str(files.mjcf), "the.patch"]
    try:
        subprocess.run(patch, cwd=tmp_path, check=True)
    except FileNotFoundError:
        pytest.skip("patch is not installed")
    patched = files.mjcf.read_text()
    files.mjcf.write_text(before)
    sync(files, "urdf")
    assert files.mjcf.read_text() == patched


def test_backups_modes_and_links_are_kept(tmp_path: Path) -> None:
    files = pair(tmp_path, DIFFERENT)
    before = files.mjcf.read_bytes()
    files.mjcf.chmod(0o640)
    (tmp_path / "link.xml").symlink_to(files.mjcf.name)
    linked = Files(files.urdf, tmp_path / "link.xml")
    (tmp_path / "robot.xml.bak").write_text("mine")
    result = sync(linked, "urdf", backup=True)
    assert result.backups == (str(tmp_path / "robot.xml.bak2"),)
    assert (tmp_path / "robot.xml.bak2").read_bytes() == before
    assert (tmp_path / "robot.xml.bak").read_text() == "mine"
    assert linked.mjcf.is_symlink()
    assert files.mjcf.stat().st_mode & 0o777 == 0o640
    assert files_agree(files)


def git(folder: Path, *arguments: str) -> None:
    named = ["-c", "user.name=n", "-c", "user.email=e@example.org", "-c", "commit.gpgsign=false"]
    subprocess.run(["git", *named, *arguments], cwd=folder, check=True, capture_output=True)


@pytest.mark.slow
def test_changes_that_are_not_committed_are_not_written_over(tmp_path: Path) -> None:
    files = pair(tmp_path)
    try:
        git(tmp_path, "init")
    except FileNotFoundError:
        pytest.skip("git is not installed")
    replace_text(files.mjcf, 'mass="6.0"', 'mass="7.0"')
    assert sync(files, "urdf").agree  # not under version control
    git(tmp_path, "add", "robot.urdf", "robot.xml")
    git(tmp_path, "commit", "-m", "robot")
    replace_text(files.mjcf, 'mass="6"', 'mass="7"')
    before = files.mjcf.read_bytes()
    with pytest.raises(pa.OutputError, match="uncommitted changes; commit the changes, or add"):
        sync(files, "urdf")
    assert files.mjcf.read_bytes() == before
    assert sync(files, "urdf", dry_run=True).agree
    assert sync(files, "mjcf", dry_run=True).agree
    assert sync(files, "mjcf").agree  # the URDF has no changes
    git(tmp_path, "checkout", "robot.urdf")
    assert sync(files, "urdf", force=True).agree
    assert files_agree(files)


@pytest.fixture
def urdf(tmp_path: Path) -> Path:
    """Write a committed URDF in a repository whose configuration lets git execute commands."""
    git(tmp_path, "init")
    file = tmp_path / "robot.urdf"
    file.write_text(urdf_text(ROBOT))
    git(tmp_path, "add", "robot.urdf")
    git(tmp_path, "commit", "-m", "robot")
    for key in ("filter.x.clean", "core.fsmonitor"):
        git(tmp_path, "config", key, f"sh -c 'touch {tmp_path / 'run'}; cat'")
    (tmp_path / ".git" / "info" / "attributes").write_text("* filter=x\n")
    return file


def test_a_file_with_uncommitted_changes_is_refused(urdf: Path) -> None:
    text = urdf.read_bytes()
    urdf.write_bytes(text.replace(b"\n", b"\r\n"))  # as a checkout on Windows has it
    refuse_uncommitted(urdf)
    urdf.write_bytes(text + b"\n")
    with pytest.raises(pa.OutputError, match="uncommitted"):
        refuse_uncommitted(urdf)
    new = urdf.with_name("new.urdf")
    new.write_bytes(text)  # not in git
    refuse_uncommitted(new)
    assert not urdf.with_name("run").exists()
    git(urdf.parent, "add", "robot.urdf", "new.urdf")  # staged is not committed
    assert urdf.with_name("run").exists(), "git itself runs none of them"
    for file in (urdf, new):
        with pytest.raises(pa.OutputError):
            refuse_uncommitted(file)


LOOP = """
import sys
from pathlib import Path
from pupper_analysis.base.files import Writing, write_all
from pupper_analysis.base.kinds import EDITED_KIND
path, one, two = Path(sys.argv[1]), b"1" * 4_000_000, b"2" * 4_000_001
print("begun", flush=True)
while True:
    write_all([Writing(path, two, EDITED_KIND, before=one)])
    write_all([Writing(path, one, EDITED_KIND, before=two)])
"""


@pytest.mark.slow
def test_file_of_a_killed_process_is_the_old_or_the_new_one(tmp_path: Path) -> None:
    file = tmp_path / "robot.xml"
    contents = {b"1" * 4_000_000, b"2" * 4_000_001}
    choose = random.Random(0)
    for _ in range(6):
        file.write_bytes(b"1" * 4_000_000)
        process = subprocess.Popen(
            [sys.executable, "-c", LOOP, str(file)], stdout=subprocess.PIPE, text=True
        )
        assert process.stdout is not None
        assert process.stdout.readline() == "begun\n"
        time.sleep(choose.uniform(0.0, 0.1))
        process.send_signal(signal.SIGKILL)
        process.wait()
        process.stdout.close()
        assert file.read_bytes() in contents


@pytest.mark.slow
@pytest.mark.parametrize("done", [False, True], ids=["to do", "nothing to do"])
def test_leftovers_of_a_killed_sync_are_removed(tmp_path: Path, done: bool) -> None:
    """The process is killed between rename and clean-up; a second run writes nothing."""
    (tmp_path / "part").mkdir()
    files = pair(tmp_path, ROBOT if done else DIFFERENT)
    main = files.mjcf.read_text()
    (tmp_path / "part" / "robot.xml").write_text(main)
    files.mjcf.write_text('<mujoco><include file="part/robot.xml"/></mujoco>')
    left = [leave_hidden_file(folder) for folder in (tmp_path, tmp_path / "part")]
    result = sync(files, "mjcf", dry_run=True)
    assert bool(result.edits) is not done
    assert [path.exists() for path in left] == [True, True]
    sync(files, "mjcf")
    assert [path.exists() for path in left] == [False, False]


# ------------------------------------------------------------------------------------- its parts


def test_copy_contains_files_at_relative_paths_only(tmp_path: Path) -> None:
    """A path with ``file://`` is relative as well, unless a slash follows."""
    (tmp_path / "meshes").mkdir()
    names = ["plain.stl", "scheme.stl", "whole.stl"]
    for name in names:
        (tmp_path / "meshes" / name).write_bytes(bytes(84))
    paths = ["meshes/plain.stl", "file://meshes/scheme.stl", f"file://{tmp_path}/meshes/whole.stl"]
    meshes = "".join(
        f'<visual><geometry><mesh filename="{path}"/></geometry></visual>' for path in paths
    )
    file = tmp_path / "robot.urdf"
    file.write_text(f'<robot name="robot"><link name="base">{meshes}</link></robot>')
    layout = list_urdf_files(read_urdf(file))
    assert layout.files == (file, *(tmp_path / "meshes" / name for name in names[:2]))


def test_copied_placeholder_effort_gives_a_note(tmp_path: Path) -> None:
    joint = ROBOT["thigh0"].joint
    files = pair(tmp_path, urdf=change_part(ROBOT, "thigh0", effort=5000.0))
    result = sync(files, "urdf")
    assert [edit.new for edit in result.edits if "5000" in edit.new]
    (note,) = result.notes.values()
    assert note.code == "effort-taken-is-placeholder"
    assert list(result.notes) == [f"joint {joint}: effort"]
    assert sync(files, "mjcf").notes == {}


def test_a_sum_of_inertias_that_no_body_can_have_is_not_written(tmp_path: Path) -> None:
    """Pad and shank weigh 1 kg each in the URDF; in the MJCF, together less than either."""
    parts = {**ROBOT, "pad": type(ROBOT["base"])("pad", "shank0", "to_pad", "fixed")}
    parts = change_part(parts, "shank0", mass=1.0)
    files = write(tmp_path, urdf_text(parts), mjcf_text(ROBOT))
    before = files.urdf.read_bytes()
    result = sync(files, "mjcf")
    assert {left.difference for left in result.not_mended} == {
        f"link shank0: {kind}" for kind in ("mass", "com", "inertia")
    }
    (reason,) = {str(left.reason) for left in result.not_mended}
    assert "no change of a single link gives the correct sum" in reason
    assert not result.agree
    assert result.edits == ()
    assert files.urdf.read_bytes() == before


def test_inertia_that_mujoco_refuses_is_not_written(tmp_path: Path) -> None:
    """Reference: MuJoCo requires A + B >= C of the principal moments."""
    files = pair(tmp_path)
    replace_text(files.urdf, 'ixx="0.005" iyy="0.005"', 'ixx="0.5" iyy="0.005"')
    before = files.mjcf.read_bytes()
    (left,) = sync(files, "urdf").not_mended
    assert left.reason.code == "file-refused-with-it"
    assert "inertia must satisfy A + B >= C" in str(left.reason)
    assert files.mjcf.read_bytes() == before


def test_reason_of_a_refused_copy_names_no_temporary_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The engine refuses the copy in the temporary folder; the user knows the original only."""
    files = pair(tmp_path, change_part(ROBOT, "base", mass=7.0))
    compare = models._compare_files

    def refuse_copies(copies: Any, tolerances: Any) -> Any:
        if copies.mjcf == files.mjcf:
            return compare(copies, tolerances)
        raise ModelError(str(copies.mjcf), f"{copies.mjcf}:3: no such body")

    monkeypatch.setattr(models, "_compare_files", refuse_copies)
    (left,) = sync(files, "urdf").not_mended
    assert str(left.reason).endswith(f" {files.mjcf.name}:3: no such body")


def test_full_temporary_folder_is_an_output_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = pair(tmp_path, change_part(ROBOT, "base", mass=7.0))

    def fail(path: Path, data: bytes) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", fail)
    with pytest.raises(OutputError, match="No space left on device"):
        sync(files, "urdf", dry_run=True)


@pytest.mark.parametrize("problem", ["read-only", "full"])
def test_both_files_are_written_or_none(
    problem: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The URDF would be replaced first, and the MJCF cannot be."""
    files = pair(tmp_path, change_part(change_part(ROBOT, "base", mass=7.0), "thigh1", damping=0.3))
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    access, replace_file = os.access, Path.replace

    def deny_mjcf(path: Any, mode: int) -> bool:
        return Path(path) != files.mjcf.resolve() and access(path, mode)

    def fail_once(source: Path, target: Path) -> Path:
        if Path(target).name == files.mjcf.name and source.name.endswith(".tmp"):
            monkeypatch.setattr(Path, "replace", replace_file)
            raise OSError(errno.ENOSPC, "No space left on device")
        return replace_file(source, target)

    if problem == "read-only":
        monkeypatch.setattr(os, "access", deny_mjcf)
    else:
        monkeypatch.setattr(Path, "replace", fail_once)
    with pytest.raises(OutputError) as raised:
        sync(files, ["mjcf:link base: mass", "urdf:damping"])
    assert str(files.mjcf) in str(raised.value)
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_without_a_choice_no_file_is_changed(tmp_path: Path) -> None:
    files = pair(tmp_path, change_part(ROBOT, "base", mass=7.0))
    before = [file.read_bytes() for file in files]
    result = sync(files)
    assert result.taken == {}
    assert result.edits == ()
    assert [(left.difference, str(left.reason)) for left in result.not_mended] == [
        ("link base: mass", "no file was chosen for this difference")
    ]
    assert not result.agree
    assert [file.read_bytes() for file in files] == before
    assert len(list(tmp_path.iterdir())) == 2


def test_values_are_written_in_both_directions_at_once(tmp_path: Path) -> None:
    files = pair(tmp_path, DIFFERENT)
    result = sync(files, ["urdf", "mjcf:mass"])
    assert files_agree(files)
    assert result.written == (str(files.urdf), str(files.mjcf))
    assert edits(result) == [
        ("link base > inertial > mass", "value", "6.0", "7"),
        ("joint hip1", "damping", "0.3", "0.1"),
        ("motor m_hip1", "ctrlrange", "-25.0 25.0", "-21 21"),
    ]


@pytest.mark.parametrize(("factor", "alike"), [(1e-15, True), (1e-9, False), (1e-4, False)])
def test_inertias_that_differ_by_more_than_rounding_are_different(
    factor: float, *, alike: bool
) -> None:
    """Relative differences of mass and inertia, and m of the centre of mass."""
    mass, com, tensor = 2.0, np.array([0.1, 0.0, 0.0]), np.diag([1e-4, 2e-4, 2.5e-4])
    one = pin.Inertia(mass, com, tensor)
    others = (
        pin.Inertia(mass * (1 + factor), com, tensor),
        pin.Inertia(mass, com + factor, tensor),
        pin.Inertia(mass, com, tensor * (1 + factor)),
    )
    assert [is_same_body(one, other) for other in others] == [alike] * 3


def test_changed_tags_keep_the_other_bytes_of_the_file(tmp_path: Path) -> None:
    """Quotes, white space and empty elements; new elements are indented."""
    file = tmp_path / "a.xml"
    data = b"<a>\n\t<b x='1>2' y=\"3\"\n\t   z = '4'/>\n\t<c/><d></d><e>text</e>\n</a>\n"
    file.write_bytes(data)
    document = read_xml_bytes(file)
    assert document.render() == data
    b, c, d, e = document.root.children
    b.set("z", "5")
    b.set("new", "<&'\">")
    c.ensure("in").set("x", "1")
    d.ensure("in").set("x", "2")
    e.ensure("in")  # it has no attribute, and is not written
    document.root.ensure("first").ensure("second").set("x", "3")
    assert document.render() == (
        b'<a>\n\t<first>\n\t  <second x="3"/>\n\t</first>\n'
        b"\t<b x='1>2' y=\"3\"\n\t   z = '5' new='&lt;&amp;&apos;&quot;&gt;'/>\n"
        b'\t<c><in x="1"/></c><d><in x="2"/></d><e>text</e>\n</a>\n'
    )
