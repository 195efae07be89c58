"""Mistakes that a seed plants into eight kinds of sources of two robots are found; harmless edits
give no finding.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from pupper_analysis.tools.contract import read_contract
from tests.tools.contract.planted import (
    CASES,
    COMPARED_KINDS,
    KINDS,
    TWICE_LIMITED_KINDS,
    limit_line,
    place_of,
    plant,
    robot_of,
    write,
)

LOOKS = {"order": "order", "sign": "sign", "unit": "unit"}
"""{planted mistake: name of the probable mistake}; also for an order of names alone."""


@pytest.mark.slow
@pytest.mark.parametrize(("name", "kind", "slip"), CASES)
def test_planted_mistake_is_found_with_both_lines(
    tmp_path: Path, name: str, kind: str, slip: str
) -> None:
    """Reference: quantity, joint and line of the planted mistake."""
    robot = robot_of(name, tmp_path)
    seed = CASES.index((name, kind, slip))
    slipped, quantity, joint = plant(robot, kind, slip, seed)
    path, lines = write(slipped, kind, tmp_path)
    other, its_lines = write(robot, COMPARED_KINDS[kind], tmp_path)
    found = read_contract(robot.urdf, path, other, stand=False)
    messages = [
        (finding.kind, finding.probable_mistake, finding.places, finding.message)
        for finding in found.findings
    ]
    hits = [
        finding
        for finding in found.findings
        if finding.kind == quantity
        and finding.probable_mistake != "mirror"
        and (joint in finding.joints or not joint)
    ]
    if slip == "limit" and kind in TWICE_LIMITED_KINDS:  # the deployment's is the URDF's
        assert {hit.sources[1] for hit in hits} == {robot.urdf.name, other.name}
        hits = [hit for hit in hits if hit.sources[1] == other.name]
    assert len(hits) == 1, messages
    assert hits[0].probable_mistake == LOOKS.get(slip, "")
    first = joint and hits[0].joints[0]  # joints with the same two numbers are one finding
    places = {place_of(path, lines, quantity, first)}
    if slip == "limit" and kind not in TWICE_LIMITED_KINDS:
        places.add(f"{robot.urdf}:{limit_line(robot.urdf, first)}")
    else:
        places.add(place_of(other, its_lines, quantity, first))
    assert set(hits[0].places) == places
    assert not found.passed
    # Legs whose names are exchanged have each other's angles, too.
    more = {"default angle"} if slip == "order" else set()
    assert {finding.kind for finding in found.findings} <= {quantity, "action offset"} | more, (
        messages
    )


def _add_alias(text: str) -> str:
    head, _, rest = text.partition("default_joint_pos:\n")
    return f"{head}default_joint_pos: &home\n{rest}action_offset_too: *home\n"


SOUND: dict[str, tuple[str, Callable[[str], str]]] = {
    **{f"{kind} as it is": (kind, str) for kind in KINDS},
    "whole numbers": ("deploy", lambda text: text.replace("5.0\n", "5\n").replace("60.0", "60")),
    "exponents": ("deploy", lambda text: text.replace("0.25\n", "2.5e-1\n")),
    "plus signs": ("ros2", lambda text: text.replace("- 0.26", "- +0.26").replace("- 0.6", "- .6")),
    "an alias": ("deploy", _add_alias),
    "windows' ends of lines": ("ros2", lambda text: text.replace("\n", "\r\n")),
    "comments": ("mjlab", lambda text: text.replace(",\n", ",  # deg, 99\n")),
    "names with a prefix": ("ros2", lambda text: text.replace("leg_", "robot_leg_")),
    "fractions": ("mjlab", lambda text: text.replace("0.75,", "3 / 4,").replace("0.25,", "1 / 4,")),
    "worked out": ("legged_gym", lambda text: text.replace("0.26", "0.13 * 2")),
    "more digits": ("RTNeural", lambda text: text.replace("-0.52,", "-0.5200000,")),
    "what is of no joint": ("RTNeural", lambda text: text.replace("{", '{"made": 1,')),
    "a function more": ("mjlab", lambda text: text + "\ndef unused(x):\n    return x.kp * 9\n"),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", ["v3", "quadruped"])
@pytest.mark.parametrize("sound", SOUND)
def test_harmless_edit_gives_no_finding(tmp_path: Path, name: str, sound: str) -> None:
    """At least three quantities of each joint are read, so the file is not merely ignored."""
    kind, change = SOUND[sound]
    robot = robot_of(name, tmp_path)
    path, _ = write(robot, kind, tmp_path)
    if path.suffix != ".onnx":
        path.write_bytes(change(path.read_text()).encode())
    other, _ = write(robot, COMPARED_KINDS[kind], tmp_path)
    found = read_contract(robot.urdf, path, other, stand=False)
    assert [finding.message for finding in found.findings] == []
    for source in {fact.source for fact in found.facts}:
        stated = [fact for fact in found.facts if fact.source == source]
        assert len(stated) >= 3 * len(robot.order), source  # silent, as it was read


def test_lists_in_another_order_with_joint_names_agree(tmp_path: Path) -> None:
    robot = robot_of("v3", tmp_path)
    path, _ = write(replace(robot, order=robot.order[::-1]), "ros2", tmp_path)
    other, _ = write(robot, "legged_gym", tmp_path)
    found = read_contract(robot.urdf, path, other, stand=False)
    assert found.findings == ()
    assert len([fact for fact in found.facts if fact.quantity == "kp"]) == 24


def test_at_least_sixty_mistakes_are_planted() -> None:
    assert len(CASES) >= 60
