"""What a policy's files state, and what is refused: one line, which names the key or the layer."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pupper_analysis.base.errors import ModelError
from pupper_analysis.tools.walk.policy import Policy
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


def onnx_policy(folder: Path, toml: str = TOML, metadata: dict[str, str] | None = None) -> Path:
    path = folder / "made.onnx"
    layers = [(np.ones((SIZE, 2)), np.zeros(2))]
    path.write_bytes(made.dense_onnx(layers, "Relu", metadata))
    (folder / "made.toml").write_text(toml, encoding="utf-8")
    return path


def refusal(path: Path) -> str:
    with pytest.raises(ModelError) as caught:
        Policy.load(path)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_metadata_and_what_a_toml_says_instead(tmp_path: Path) -> None:
    stated = {"joint_names": "left,right", "joint_stiffness": "40.0,41.0", "action_scale": "0.3"}
    toml = TOML.replace('joints = ["a", "b"]\n', "").replace("kp = [20, 30]\n", "")
    contract = Policy.load(onnx_policy(tmp_path, toml, stated)).contract
    assert contract.joints == ("left", "right")
    assert contract.kp is not None
    assert contract.kp.tolist() == [40, 41]
    assert contract.action_scale.tolist() == [0.5, 0.5]  # the TOML's


def test_rtneural_of_pupper(tmp_path: Path) -> None:
    contract = Policy.load(made.still(tmp_path / "p.json")).contract
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
        ("history = 2", "history = 3", "takes 24"),
        ("history = 2", "history = 2.5", "whole number"),
        ("history = 2", 'history = 2\nnewest-first = "no"', "none of true"),
        ("history = 2", "history = 2\nlower = 1\nupper = [2, -1]", "lower: 1"),
        ("history = 2", "historie = 2", "historie"),
        ('"phase"]', '"moon"]', "moon"),
        ("scale = 0.25", "scale = [1, 2]", "angular-velocity"),
        ("default = [0.1, -0.2]", "", "default"),
    ],
)
def test_a_contract_that_cannot_be(tmp_path: Path, old: str, new: str, text: str) -> None:
    assert old in TOML
    assert text in refusal(onnx_policy(tmp_path, TOML.replace(old, new)))
