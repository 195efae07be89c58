"""Configurations of Isaac Lab and mjlab: objects of Python files, and the tables ``env.yaml``."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest

from pupper_analysis.base.errors import ModelError
from pupper_analysis.tools.contract import Contract, read_contract
from pupper_analysis.tools.contract.deployment import read_deployment
from pupper_analysis.tools.contract.facts import Request, Role
from pupper_analysis.tools.contract.orders import matches_name
from pupper_analysis.tools.contract.readers import python, tables
from pupper_analysis.tools.walk.contract import convert_deployment
from tests.support.variants import load
from tests.tools.contract.planted import KINDS, robot_of, write

TABLES = ["Isaac Lab's env.yaml", "mjlab's env.yaml"]


@pytest.mark.parametrize("kind", TABLES)
def test_table_states_the_numbers_of_the_robot(tmp_path: Path, kind: str) -> None:
    """Reference: the numbers from which the table was written.

    The offsets of actions are the default angles, not the ``offset`` of 0 beside
    ``use_default_offset``. The joint names of an event are no joint order.
    """
    robot = robot_of("v3", tmp_path)
    path, lines = write(robot, kind, tmp_path)
    found = read_contract(robot.urdf, path, stand=False)
    facts = {
        (fact.quantity, fact.joint): (fact.value, fact.place)
        for fact in found.facts
        if fact.source == "env.yaml"
    }
    for quantity in ("default angle", "action scale", "kp", "kd", "effort"):
        for joint in robot.order:
            place = f"{path}:{lines[quantity, joint]}"
            assert facts[quantity, joint] == (robot.numbers[quantity][joint], place)
    for joint in robot.order:
        assert facts["action offset", joint][0] == robot.numbers["default angle"][joint]
    assert facts["policy step", ""][0] == pytest.approx(0.02)
    assert facts["observation base_ang_vel", ""][0] == 0.25
    (source,) = tables.read(Request(path))
    assert (source.role, source.order) == (Role.TRAINER, ())
    assert source.breadth_first == (kind == TABLES[0])
    assert [term.name for term in source.observations] == ["base_ang_vel"]


def test_table_and_python_file_of_mjlab_give_equal_statements(tmp_path: Path) -> None:
    """Reference: the same configuration as a Python file."""
    robot = robot_of("v3", tmp_path)
    contents = []
    for kind, read in (("mjlab's env.yaml", tables.read), ("mjlab", python.read)):
        path = tmp_path / KINDS[kind][0]
        write(robot, kind, tmp_path)
        (source,) = [
            source
            for source in read(Request(path))
            if "walking" in source.name or path.suffix == ".yaml"
        ]
        shared = ("default angle", "action scale", "action offset", "kp", "kd", "effort")
        contents.append(
            sorted(
                (statement.quantity, statement.joint, str(statement.value), statement.origin)
                for statement in source.statements
                if statement.quantity in shared
            )
        )
    assert contents[0] == contents[1]


@pytest.mark.parametrize(
    "pattern",
    ["F[LR]|RL", "FL.*|RR", "FL|RR.*", "FL_hip$|RR", "FL_hip|RR$", "(?i)fl|rr", "FL", "FL_hip$"],
)
@pytest.mark.parametrize("framework", ["EntityCfg", "ArticulationCfg"])
def test_pattern_of_default_angles_selects_the_joints_of_the_framework(
    tmp_path: Path, framework: str, pattern: str
) -> None:
    """Reference: ``re.match`` in mjlab's ``resolve_expr``, ``re.fullmatch`` in Isaac Lab."""
    path = tmp_path / "robot.py"
    path.write_text(
        f"from library import {framework}, ActuatorCfg\n"
        f'START = {framework}.InitialStateCfg(joint_pos={{"{pattern}": 0.3}})\n'
        'LEGS = ActuatorCfg(joint_names_expr=(".*",), stiffness=5.0)\n'
        f"ROBOT = {framework}(init_state=START, actuators=(LEGS,))\n"
    )
    (source,) = (source for source in python.read(Request(path)) if source.name.endswith("ROBOT"))
    patterns = [
        statement.joint
        for statement in source.statements
        if statement.quantity == "default angle" and statement.value == 0.3
    ]
    names = [f"{leg}_{part}" for leg in ("FL", "FR", "RL", "RR") for part in ("hip", "calf")]
    selects = re.match if framework == "EntityCfg" else re.fullmatch
    selected = [name for name in names if any(matches_name(pattern, name) for pattern in patterns)]
    assert selected == [name for name in names if selects(pattern, name)]


@pytest.mark.parametrize("kind", TABLES)
@pytest.mark.parametrize("names", ["stated", "pattern"])
def test_action_that_keeps_its_order_states_the_joint_order(
    tmp_path: Path, kind: str, names: str
) -> None:
    """Isaac Lab sorts actions by depth in the tree, unless ``preserve_order`` is true."""
    robot = robot_of("v3", tmp_path)
    path, _ = write(robot, kind, tmp_path)
    reverse = robot.order[::-1] if names == "stated" else [".*"]
    listed = "".join(f"    - {joint}\n" for joint in reverse)
    text = path.read_text().replace("    - .*\n", listed)
    path.write_text(
        text.replace("    offset: 0.0\n", "    offset: 0.0\n    preserve_order: true\n")
    )
    model = load("v3")
    found = read_deployment(model, [path])
    if names == "stated":
        assert found.joints == robot.order[::-1]
        assert not found.is_order_assumed
    else:
        assert found.is_order_assumed
        assert set(found.joints) == set(robot.order)


def _compare_gym(
    folder: Path, *, changes: dict[str, str], scales: str = "[2.0, 2.0, 0.25]"
) -> Contract:
    """Compare a trainer of legged_gym, with changed lines, with a YAML of unitree_rl_gym."""
    robot = robot_of("quadruped", folder)
    trainer, _ = write(robot, "legged_gym", folder)
    text = trainer.read_text()
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new, 1)
    text += "    class normalization:\n        class obs_scales:\n"
    trainer.write_text(text + "            lin_vel = 2.0\n            ang_vel = 0.25\n")
    deployment = folder / "quadruped.yaml"
    rows = {"default_angles": "default angle", "kps": "kp", "kds": "kd"}
    body = "".join(
        f"{word}: {[robot.numbers[quantity][joint] for joint in robot.order]}\n"
        for word, quantity in rows.items()
    )
    body += f"action_scale: {robot.numbers['action scale'][robot.order[0]]}\n"
    deployment.write_text(f"{body}cmd_scale: {scales}\n")
    return read_contract(robot.urdf, trainer, deployment, stand=False)


def test_scales_of_commands_follow_from_the_observation_scales_of_legged_gym(
    tmp_path: Path,
) -> None:
    """Reference: ``commands_scale`` of legged_gym is (lin_vel, lin_vel, ang_vel)."""
    assert _compare_gym(tmp_path, changes={}).passed
    found = _compare_gym(tmp_path, changes={}, scales="[1.0, 2.0, 1.0]")
    assert [
        (finding.kind, finding.values, str(finding.severity)) for finding in found.findings
    ] == [
        ("observation commands x", (2.0, 1.0), "error"),
        ("observation commands turn", (0.25, 1.0), "error"),
    ]
    for place, text in zip(found.findings[0].places, ("lin_vel", "cmd_scale"), strict=True):
        file, _, line = place.rpartition(":")
        assert Path(file).read_text().splitlines()[int(line) - 1].strip().startswith(text)


def test_joint_without_a_number_is_a_warning_if_the_opposite_joint_has_one(
    tmp_path: Path,
) -> None:
    """Without the warning, the remaining eleven joints agree."""
    row = "            'RR_pitch': 0.6,\n"
    found = _compare_gym(tmp_path, changes={row: ""})
    assert found.findings == ()
    assert not found.passed
    (warning,) = found.unread
    assert warning.code == "contract-side-missing"
    assert warning.values["joints"] == ("RR_pitch",)
    assert warning.values["mirrors"] == ("RL_pitch",)


def test_numbers_of_a_single_side_are_no_missing_numbers(tmp_path: Path) -> None:
    """A source may belong to the legs of one side."""
    rows = {
        f"            '{leg}_{part}': {angle},\n": ""
        for leg in ("FR", "RR")
        for part, angle in (("roll", -0.1), ("pitch", 0.6), ("knee", -1.2))
    }
    assert _compare_gym(tmp_path, changes=rows).passed


@pytest.mark.parametrize("slip", [False, True])
def test_gains_per_motor_are_read_if_the_robot_lacks_a_motor(tmp_path: Path, slip: bool) -> None:
    """unitree_rl_lab's G1 with 23 joints: an absent motor has an empty name, and gains of 0.

    Gains are in the order of the motors, default angles in the order of the policy.
    """
    robot = robot_of("v3", tmp_path)
    trainer, _ = write(robot, TABLES[0], tmp_path)
    motors = [*robot.order[::-1][:5], "", *robot.order[::-1][5:]]
    listed = "".join(f"    - {name or repr(name)}\n" for name in motors)
    text = trainer.read_text().replace(
        "    actuators:\n", f"    joint_sdk_names:\n{listed}    actuators:\n"
    )
    stiffness = [20.0 + number for number in range(12)]
    for joint, number in zip(robot.order, stiffness, strict=True):
        head, _, tail = text.partition(f"drive_{joint}:")
        text = f"{head}drive_{joint}:{tail.replace('stiffness: 5.0', f'stiffness: {number}', 1)}"
    trainer.write_text(text)
    by_motor = [stiffness[robot.order.index(name)] if name else 0.0 for name in motors]
    by_motor[7] += slip
    angles = [robot.numbers["default angle"][joint] for joint in robot.order]
    deployment = tmp_path / "deploy.yaml"
    deployment.write_text(
        f"joint_ids_map: {[motors.index(joint) for joint in robot.order]}\n"
        f"stiffness: {by_motor}\ndefault_joint_pos: {angles}\n"
    )
    found = read_contract(robot.urdf, trainer, deployment, stand=False)
    assert found.unread == ()
    assert sum(fact.quantity == "kp" and fact.source == "deploy.yaml" for fact in found.facts) == 12
    wrong = [
        (finding.kind, finding.joints)
        for finding in found.findings
        if finding.probable_mistake != "mirror"
    ]
    assert wrong == ([("kp", (motors[7],))] if slip else [])


@pytest.mark.parametrize("bound", [1.0, 0.9])
def test_bounds_of_commanded_positions_are_compared_and_limit_the_walk(
    tmp_path: Path, bound: float
) -> None:
    """Isaac Lab and unitree_rl_lab clip an action after scale and offset: positions in rad."""
    robot = robot_of("v3", tmp_path)
    trainer, _ = write(robot, TABLES[0], tmp_path)
    pattern = "    clip:\n      .*_1: !!python/tuple\n      - -0.5\n      - 1.0\n"
    text = trainer.read_text().replace("    offset: 0.0\n", f"    offset: 0.0\n{pattern}")
    trainer.write_text(text)
    pairs = [[-0.5, bound] if joint.endswith("_1") else None for joint in robot.order]
    rows = "".join(f"    - {pair or 'null'}\n" for pair in pairs)
    deployment = tmp_path / "deploy.yaml"
    deployment.write_text(
        f"joint_names: [{', '.join(robot.order)}]\n"
        f"actions:\n  JointPositionAction:\n    scale: 0.75\n    clip:\n{rows}"
    )
    found = read_contract(robot.urdf, trainer, deployment, stand=False)
    hips = tuple(joint for joint in robot.order if joint.endswith("_1"))
    assert [(finding.kind, finding.joints, finding.values) for finding in found.findings] == (
        [] if bound == 1.0 else [("highest target", hips, (1.0, bound))]
    )
    read = read_deployment(load("v3"), [trainer, deployment])
    values = convert_deployment(read, 36, 12).values
    upper = dict(zip(read.joints, values["upper"], strict=True))
    lower = dict(zip(read.joints, values["lower"], strict=True))
    for joint in robot.order:
        expected = (-0.5, bound) if joint in hips else (-math.inf, math.inf)
        assert (lower[joint], upper[joint]) == expected


@pytest.mark.parametrize("kind", TABLES)
@pytest.mark.parametrize(
    ("old", "new", "quantity"),
    [
        ("stiffness: 5.0", "stiffness: '5.0'", "kp"),
        (": -0.52\n", ": -0.52 rad\n", "default angle"),
        (": 0.75\n", ": 0.75x\n", "action scale"),
    ],
)
def test_text_in_place_of_a_number_is_a_warning_with_its_line(
    tmp_path: Path, kind: str, old: str, new: str, quantity: str
) -> None:
    robot = robot_of("v3", tmp_path)
    path, _ = write(robot, kind, tmp_path)
    other, _ = write(robot, "deploy", tmp_path)
    assert read_contract(robot.urdf, path, other, stand=False).passed
    text = path.read_text()
    path.write_text(text.replace(old, new, 1))
    line = text[: text.index(old)].count("\n") + 1
    found = read_contract(robot.urdf, path, other, stand=False)
    (warning,) = found.unread
    assert (warning.code, warning.values["what"]) == ("contract-value-unread", quantity)
    assert warning.values["file"] == f"{path.name}:{line}"
    assert not found.passed
    with pytest.raises(ModelError, match=f":{line}: "):
        read_deployment(load("v3"), [path])
