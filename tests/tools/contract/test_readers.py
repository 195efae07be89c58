"""Readers of policy files, which `walk` uses too: metadata and sizes of the network."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from pupper_analysis.base.errors import ModelError
from pupper_analysis.tools.contract import facts, read_contract
from pupper_analysis.tools.contract.facts import Request, read_yaml_nodes
from pupper_analysis.tools.contract.readers import (
    decode_integers,
    gather_fields,
    get_text,
    python,
    read_onnx,
    tables,
)
from tests.tools.contract.sources import URDF, field, onnx, value, write_all


def test_metadata_inputs_and_outputs_of_an_onnx_file_are_read(tmp_path: Path) -> None:
    path = tmp_path / "policy.onnx"
    graph = field(5, field(8, b"weights")) + field(11, value("obs", 0, 45))
    graph += field(11, value("weights", 45, 12)) + field(12, value("actions", 0, 12))
    path.write_bytes(field(7, graph) + onnx(joint_names="a,b"))
    file = read_onnx(path)
    assert file.metadata == {"joint_names": "a,b"}
    assert file.inputs == {"obs": [0, 45]}  # the batch is symbolic
    assert file.outputs == {"actions": [0, 12]}
    assert get_text(gather_fields(file.graph[12][0]), 1) == "actions"


def test_onnx_file_of_metadata_alone_is_read(tmp_path: Path) -> None:
    path = tmp_path / "policy.onnx"
    path.write_bytes(onnx(joint_names="a,b"))
    file = read_onnx(path)
    assert file.metadata == {"joint_names": "a,b"}
    assert (file.graph, file.inputs, file.outputs) == ({}, {}, {})


def test_packed_and_single_integers_are_decoded() -> None:
    """Protocol Buffers: 0xac 0x02 is 300, and 2^64 - 1 is -1."""
    assert decode_integers([3, memoryview(b"\x01\xac\x02"), (1 << 64) - 1]) == [3, 1, 300, -1]


@pytest.mark.parametrize("data", [b"\x80" * 20, b"\x0f", b"\x72\x7f", b"\x72\x02\x0a\x09", b"\x38"])
def test_invalid_onnx_file_is_refused(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "a.onnx").write_bytes(data)
    with pytest.raises(ModelError, match="not a readable ONNX"):
        read_onnx(tmp_path / "a.onnx")


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("env_cfg = {table}\nother = {{'a': 1}}\n", "env_cfg"),
        ("def get_cfg():\n    return {table}\n", "get_cfg"),
        ("def get_cfgs():\n    return {table}, {{'a': 1}}\n", "get_cfgs[0]"),
    ],
)
def test_tables_of_a_python_file_are_read(text: str, name: str, tmp_path: Path) -> None:
    """The numbers are those of the table, if the file has no configuration class."""
    table = "{'kp': 20.0, 'kd': 0.5, 'default_joint_angles': {'hip': 0.26, 'knee': -0.52}}"
    path = tmp_path / "train.py"
    path.write_text(text.format(table=table))
    [source] = python.read(Request(path))
    assert source.name == f"train.py:{name}"
    found = [(statement.quantity, statement.value) for statement in source.statements]
    angles = [("default angle", -0.52), ("default angle", 0.26)]
    assert sorted(found) == [*angles, ("kd", 0.5), ("kp", 20.0)]


@pytest.mark.parametrize("key", ["control", "actions"])
def test_numbers_as_keys_of_a_python_table_are_accepted(key: str, tmp_path: Path) -> None:
    path = tmp_path / "train.py"
    table = f"{{'{key}': {{0: {{'scale': 0.25}}}}, 'kp': 20.0, 'joint_names': ['hip']}}"
    path.write_text(f"CFG = {table}\n")
    [source] = python.read(Request(path))
    values = {statement.quantity: statement.value for statement in source.statements}
    assert values["kp"] == 20.0
    assert source.order == ("hip",)


@pytest.mark.parametrize("name", ["mjlab_cfg.py", "isaac_cfg.py"])
@pytest.mark.parametrize("key", ["3", "1.5", "'[[1,2].*'"])
def test_keys_of_default_angles_that_are_no_joint_names_apply_to_no_joint(
    name: str, key: str, tmp_path: Path, recwarn: pytest.WarningsRecorder
) -> None:
    """Numbers as keys ended in a traceback, a nested set of characters in Python's warning."""
    path = write_all(tmp_path)[name]
    path.write_text(path.read_text().replace('"leg_.*_r_1"', key))
    found = read_contract(URDF, path, stand=False)
    assert not recwarn.list
    angles = {fact.joint: fact.value for fact in found.facts if fact.quantity == "default angle"}
    assert {angles[f"leg_front_{side}_1"] for side in "rl"} == {0.0, -0.26}


@pytest.mark.parametrize("name", ["Go2", "go2", ""])
def test_configuration_of_a_table_is_found_as_its_key_is_written(name: str, tmp_path: Path) -> None:
    """Keys are compared in lower case; ``FILE:Go2`` was unknown."""
    path = tmp_path / "robots.yaml"
    path.write_text("Go2:\n  kp: 20.0\n  joint_names: [hip]\n")
    [source] = tables.read(Request(path, name))
    assert source.name == "robots.yaml:go2"


def test_rtneural_file_gives_layer_sizes_and_no_weights(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The file has 600 weights, more values than are read of a source."""
    monkeypatch.setattr(facts, "MAX_VALUES", 100)
    path = tmp_path / "policy.json"
    weights = [[[0.5] * 30] * 20]
    layers = [
        {"type": "dense", "shape": [None, 8], "weights": weights},
        {"type": "dense", "shape": [None, 12]},
    ]
    path.write_text(json.dumps({"in_shape": [None, 36], "layers": layers, "kp": 5.0}))
    (source,) = tables.read(Request(path))
    statements = {statement.quantity: statement.value for statement in source.statements}
    assert source.role == "policy"
    assert statements == {"actions": 12, "observed numbers": 36, "kp": 5.0}


@pytest.mark.parametrize(
    ("text", "value"),
    [("1e999", "1e999"), ("-1e999", "-1e999"), ("1e300", 1e300), (".inf", math.inf)],
)
def test_a_number_beyond_a_double_is_no_infinite_limit(text: str, value: object) -> None:
    """A limit that is stated as infinite is none; 1e999 is an error of the file."""
    (node,) = read_yaml_nodes(Path("x.yaml"), f"kp: {text}")
    assert node.get("kp").value == value
