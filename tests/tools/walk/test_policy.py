"""Contents of policy files, and refusals in one line with the key or the layer."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pupper_analysis.base.errors import ModelError
from pupper_analysis.tools.contract.facts import JointSource, ObservedTerm, Place, Role
from pupper_analysis.tools.walk.contract import convert_source_statements
from pupper_analysis.tools.walk.policy import Policy, _read_tensor
from tests.tools.contract.sources import field, varint
from tests.tools.walk import made

TOML = """
joints = ["a", "b"]
default = [0.1, -0.2]
action-scale = 0.5
kp = [20, 30]
kd = 1
rate = 50
latency = 0.01
history = 2
phase-rate = 1.5
phase-offsets = [0.0, 3.14159]
observation = [{term = "angular-velocity", scale = 0.25}, "command", "joint-positions", "phase"]
"""
SIZE = 2 * (3 + 3 + 2 + 4)
FRAME = 36


def onnx_policy(folder: Path, toml: str = TOML, metadata: dict[str, str] | None = None) -> Path:
    path = folder / "made.onnx"
    layers = [(np.ones((SIZE, 2)), np.zeros(2))]
    path.write_bytes(made.dense_onnx(layers, "Relu", metadata))
    (folder / "made.toml").write_text(toml, encoding="utf-8")
    return path


def get_refusal(path: Path) -> str:
    """Return the message of the error that loading a policy raises; it must be one line."""
    with pytest.raises(ModelError) as caught:
        Policy.load(path)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_contract_is_read_from_a_toml_beside_the_policy(tmp_path: Path) -> None:
    contract = Policy.load(onnx_policy(tmp_path)).contract
    assert contract.joints == ("a", "b")
    assert contract.kp is not None
    assert contract.kp.tolist() == [20, 30]
    assert contract.kd is not None
    assert contract.kd.tolist() == [1, 1]
    assert [term.name for term in contract.terms] == [
        *("angular-velocity", "command", "joint-positions", "phase")
    ]
    assert (contract.terms[0].scale, contract.history) == (0.25, 2)
    assert contract.latency == 0.01
    assert contract.sources["kp"].endswith("made.toml:5")


def test_toml_takes_precedence_over_onnx_metadata(tmp_path: Path) -> None:
    stated = {"joint_names": "left,right", "joint_stiffness": "40.0,41.0", "action_scale": "0.3"}
    toml = TOML.replace('joints = ["a", "b"]\n', "").replace("kp = [20, 30]\n", "")
    contract = Policy.load(onnx_policy(tmp_path, toml, stated)).contract
    assert contract.joints == ("left", "right")
    assert contract.kp is not None
    assert contract.kp.tolist() == [40, 41]
    assert contract.action_scale.tolist() == [0.5, 0.5]  # the TOML's


def test_rtneural_file_of_pupper_has_its_observations_and_rate(tmp_path: Path) -> None:
    contract = Policy.load(made.write_standing_policy(tmp_path / "p.json")).contract
    names = [term.name for term in contract.terms]
    assert names == [
        "angular-velocity", "gravity", "command", "up-command", "joint-positions", "last-action",
    ]  # fmt: skip
    assert (contract.rate, contract.newest_first, contract.clip) == (50, True, 100)


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("rate = 50", "", "rate"),
        ("rate = 50", "rate = 0", "rate"),
        ("rate = 50", "rate = nan", "rate"),
        ("kp = [20, 30]", "kp = [20, 30, 40]", "kp"),
        ("kp = [20, 30]", "kp = inf", "kp"),
        ("kd = 1", 'kd = "stiff"', "kd"),
        ('["a", "b"]', '["a", "a"]', "joints"),
        ('["a", "b"]', '["a"]', "joints"),
        ("history = 2", "history = 3", "requires 24"),
        ("history = 2", "history = 2.5", "whole number"),
        ("history = 2", 'history = 2\nnewest-first = "no"', "use one of true"),
        ("history = 2", "history = 2\nlower = 1\nupper = [2, -1]", "lower: 1"),
        ("history = 2", "historie = 2", "historie"),
        ('"phase"]', '"moon"]', "moon"),
        ("scale = 0.25", "scale = [1, 2]", "angular-velocity"),
        ("default = [0.1, -0.2]", "", "default"),
    ],
)
def test_impossible_contract_is_refused(tmp_path: Path, old: str, new: str, text: str) -> None:
    assert old in TOML
    assert text in get_refusal(onnx_policy(tmp_path, TOML.replace(old, new)))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("rate = 50", f"rate = {'9' * 400}"),
        ("kd = 1", f"kd = {'9' * 400}"),
        ("kd = 1", 'kd = "1"'),
        ("kd = 1", "kd = true"),
        ("scale = 0.25", 'scale = "0.25"'),
        ("scale = 0.25", f"scale = {'9' * 400}"),
    ],
)
def test_contract_refuses_values_that_are_not_finite_numbers(
    tmp_path: Path, old: str, new: str
) -> None:
    assert old in TOML
    assert "made.toml" in get_refusal(onnx_policy(tmp_path, TOML.replace(old, new)))


WRONG: tuple[Any, ...] = (
    None, True, 0, -1, 1e308, 2**62, "x", "dense", [], [[]], [None], ["1"], {}, {"type": []},
    [[1.0, [2.0]]], [[1.0] * 5] * 2,
)  # fmt: skip
"""Values of every type that JSON has, in place of each value of a policy."""

GATES = [[0.1] * 6] * FRAME, [[0.1] * 6] * 2, [[0.0] * 6] * 2
RECURRENT = [
    {"type": "gru", "activation": "", "weights": list(GATES)},
    {"type": "lstm", "activation": "", "weights": [[[0.1] * 8] * 2, [[0.1] * 8] * 2, [0.0] * 8]},
    {"type": "dense", "activation": "tanh", "weights": [[[0.1] * 12] * 2, [0.0] * 12]},
    {"type": "activation", "activation": "relu"},
]


def places_in(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the path of each value in JSON; of numbers in a list the first one's only."""
    if path:
        yield path
    if isinstance(value, dict):
        for key in value:
            yield from places_in(value[key], (*path, key))
    if isinstance(value, list):
        same = value and all(isinstance(entry, float) for entry in value)
        for index in range(1 if same else len(value)) if len(value) < 20 else (0, len(value) - 1):
            yield from places_in(value[index], (*path, index))


def replace_value(value: Any, path: tuple[Any, ...], new: Any) -> Any:
    """Return JSON with another value at a path."""
    found = copy.copy(value)
    found[path[0]] = replace_value(value[path[0]], path[1:], new) if path[1:] else new
    return found


def check_read_or_refused(path: Path) -> None:
    """Check that a policy is read, or refused as a model in one line."""
    message = path.stem
    try:
        Policy.load(path)
    except ModelError as error:
        message = str(error)
    assert "\n" not in message
    assert path.stem in message


@pytest.mark.slow
def test_rtneural_of_wrong_types_is_read_or_refused(tmp_path: Path) -> None:
    """Each value of a policy is replaced by a value of each JSON type; no other exception is
    raised."""
    sound = json.loads(made.write_standing_policy(tmp_path / "p.json").read_text()) | {
        "layers": RECURRENT
    }
    Policy.load(made.write_standing_policy(tmp_path / "p.json", layers=RECURRENT))
    cases = [(place, new) for place in places_in(sound) for new in WRONG]
    assert len(cases) > 500
    for place, new in cases:
        (tmp_path / "p.json").write_text(json.dumps(replace_value(sound, place, new)))
        check_read_or_refused(tmp_path / "p.json")


@pytest.mark.parametrize(
    ("layer", "text"),
    [
        ({"type": []}, "layer 1 ([])"),
        ({"type": {"a": 1}}, "layer 1 ({'a': 1})"),
        ({}, "layer 1 (None)"),
        ("dense", "layer 1 (dense)"),
        ({**RECURRENT[2], "activation": ["tanh"]}, "layer 1 (dense) (['tanh'])"),
        ({**RECURRENT[2], "activation": []}, "layer 1 (dense) ([])"),
        ({**RECURRENT[2], "activation": False}, "layer 1 (dense) (False)"),
        ({**RECURRENT[2], "weights": [[["1"] * 12] * 2, [0.0] * 12]}, "layer 1 (dense) requires"),
        ({**RECURRENT[2], "weights": [[[True] * 12] * 2, [0.0] * 12]}, "layer 1 (dense) requires"),
        ({"type": "activation", "activation": "relu"}, "observation: sizes do not fit: 0"),
    ],
)
def test_rtneural_layer_of_a_wrong_type_is_named(tmp_path: Path, layer: Any, text: str) -> None:
    assert text in get_refusal(made.write_standing_policy(tmp_path / "p.json", layers=[layer]))


@pytest.mark.slow
def test_onnx_of_wrong_fields_is_read_or_refused(tmp_path: Path) -> None:
    """Each byte of the structure of the graph is changed, or the file is truncated at the byte;
    no other exception is raised."""
    path = onnx_policy(tmp_path)
    sound = path.read_bytes()
    for at in range(len(sound)):
        for new in (sound[:at], sound[:at] + bytes([sound[at] ^ 0x41]) + sound[at + 1 :]):
            path.write_bytes(new)
            check_read_or_refused(path)


def test_onnx_states_of_huge_size_are_refused(tmp_path: Path) -> None:
    """A state of 10^12 numbers is refused before zeros are allocated."""
    nodes = [made.node("Tanh", ("obs",), ("act",)), made.node("Tanh", ("h",), ("hn",))]
    inputs = [made.value("obs", 1, 4), made.value("h", 1, 10**12)]
    outputs = [made.value("act", 1, 4), made.value("hn", 1, 10**12)]
    path = tmp_path / "made.onnx"
    path.write_bytes(made.onnx(nodes, [], inputs, outputs))
    assert "h: sizes do not fit" in get_refusal(path)


def test_onnx_values_that_grow_without_end_are_refused(tmp_path: Path) -> None:
    """Each of forty layers doubles the length of its input."""
    nodes = [made.node("Concat", (f"x{n}", f"x{n}"), (f"x{n + 1}",), axis=1) for n in range(40)]
    data = made.onnx(nodes, [], [made.value("x0", 1, 4)], [made.value("x40", 1, 4)])
    path = tmp_path / "made.onnx"
    path.write_bytes(data)
    assert "sizes do not fit" in get_refusal(path)


def test_half_precision_weights_stored_as_integers_keep_their_values(tmp_path: Path) -> None:
    """ONNX stores float16 in ``int32_data`` as the same 16 bits (onnx.proto3): NumPy's view."""
    numbers = np.array([0.5, -2.0, 65504.0, 6e-8], dtype="<f2")
    packed = b"".join(varint(bits) for bits in numbers.view("<u2").tolist())
    tensor = field(1, 4) + field(2, 10) + field(8, "w") + field(5, packed)
    name, read = _read_tensor(tmp_path / "made.onnx", memoryview(tensor))
    assert name == "w"
    assert read.tolist() == numbers.astype(float).tolist()


def test_scales_of_observations_in_a_policy_file_reach_the_contract() -> None:
    """A term without a stated scale remains a name, for which the contract's default holds."""
    place = Place(Path("policy.json"), 1)
    observations = (
        ObservedTerm("angular-velocity", (0.25,), place),
        ObservedTerm("command", None, place),
    )
    source = JointSource("policy.json", place.path, Role.POLICY, (), observations=observations)
    assert convert_source_statements(source)["observation"] == [
        {"term": "angular-velocity", "scale": 0.25},
        "command",
    ]


def test_files_that_are_no_policy_are_refused(tmp_path: Path) -> None:
    assert "no such file" in get_refusal(tmp_path / "none.onnx")
    bad = tmp_path / "bad.json"
    bad.write_text('{"layers": [', encoding="utf-8")
    assert "JSON" in get_refusal(bad)
    bad.write_text('{"kp":\n nothing}', encoding="utf-8")
    assert "bad.json:2: invalid JSON" in get_refusal(bad)
    bad.write_text('{"layers": 3}', encoding="utf-8")
    assert "no list of layers" in get_refusal(bad)
    bad.write_text('{"layers": [1]}', encoding="utf-8")
    assert "layer 1" in get_refusal(bad)
    (tmp_path / "bad.onnx").write_bytes(b"\x80\x04\x95pickle")
    assert "not a readable ONNX model" in get_refusal(tmp_path / "bad.onnx")


def test_network_of_another_size_than_the_contract_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "p.json"
    made.write_standing_policy(path, observation_history=2)
    assert "requires 36" in get_refusal(path)
    made.write_standing_policy(path, default_joint_pos=[0.0] * 11)
    assert "default" in get_refusal(path)
    values = json.loads(made.write_standing_policy(path).read_text())
    values["layers"][0]["weights"][0][3][4] = None
    path.write_text(json.dumps(values))
    assert "layer 1 (dense)" in get_refusal(path)
