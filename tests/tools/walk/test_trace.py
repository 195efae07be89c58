"""Recorded traces: planted orders, signs, scales and delays of a contract are named."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pupper_analysis.base.errors import ModelError
from pupper_analysis.tools.walk.contract import ObservationTerm, PolicyContract
from pupper_analysis.tools.walk.policy import Policy
from pupper_analysis.tools.walk.trace import (
    TraceCheck,
    check_trace,
    read_trace,
    record_trace,
)
from tests.support.commands import run_command
from tests.support.variants import load
from tests.tools.contract.sources import ANGLES, JOINTS
from tests.tools.walk import made

NAMES = ("angular-velocity", "gravity", "command", "joint-positions", "joint-velocities",
         "last-action")  # fmt: skip
SIZES = (3, 3, 3, 12, 12, 12)
COMMANDS = [(0.1, 0, 0), (0, 0.1, 0), (0, 0, 0.4), (-0.1, 0.05, 0.2)]

TOML = f"""
observation = [
  {{term = "angular-velocity", scale = 0.25}}, "gravity",
  {{term = "command", scale = [2.0, 2.0, 0.25]}}, "joint-positions",
  {{term = "joint-velocities", scale = 0.05}}, "last-action",
]
joints = {JOINTS!r}
default = {ANGLES}
action-scale = 0.5
kp = 5.0
kd = 0.25
rate = 50
history = 2
"""


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Policy, dict[str, Any]]:
    """Return a random network that moves all joints, and the trace of its simulation."""
    folder = tmp_path_factory.mktemp("trace")
    draw = np.random.default_rng(3)
    layers = [(0.2 * draw.normal(size=(2 * sum(SIZES), 12)), 0.1 * draw.normal(size=12))]
    (folder / "policy.onnx").write_bytes(made.dense_onnx(layers, "Tanh"))
    (folder / "policy.toml").write_text(TOML)
    policy = Policy.load(folder / "policy.onnx")
    return policy, record_trace(load("v3"), policy, COMMANDS, seconds_per_command=0.6)


def check(policy: Policy, arrays: dict[str, Any], folder: Path) -> TraceCheck:
    np.savez(folder / "trace.npz", **arrays)
    return check_trace(load("v3"), policy, read_trace(folder / "trace.npz"))


def find_mistakes(found: TraceCheck) -> dict[str, tuple[str, str]]:
    return {
        check.term: (check.mistake, check.detail)
        for check in found.checks
        if check.mistake not in ("", "unchecked")
    }


def test_trace_of_the_stated_contract_agrees(
    recorded: tuple[Policy, dict[str, Any]], tmp_path: Path
) -> None:
    found = check(*recorded, tmp_path)
    assert find_mistakes(found) == {}
    assert found.passed
    assert [check.term for check in found.checks] == ["network", "rate", *NAMES, "targets"]
    assert found.period == pytest.approx(0.02)


def test_trace_that_begins_while_the_policy_runs_agrees(
    recorded: tuple[Policy, dict[str, Any]], tmp_path: Path
) -> None:
    """The first observed last action is the action before the trace, not zero."""
    policy, arrays = recorded
    late = {name: array if name == "joints" else array[30:] for name, array in arrays.items()}
    assert find_mistakes(check(policy, late, tmp_path)) == {}


def state_order(contract: PolicyContract, first: int, second: int) -> PolicyContract:
    order = list(range(12))
    order[first], order[second] = order[second], order[first]
    return contract.reorder_joints(order)


def state_sign(contract: PolicyContract, index: int) -> PolicyContract:
    return replace(contract, signs=np.where(np.arange(12) == index, -1.0, 1.0))


def state_scale(contract: PolicyContract, name: str, factor: float) -> PolicyContract:
    terms = tuple(
        replace(term, scale=np.asarray(term.scale) * factor) if term.name == name else term
        for term in contract.terms
    )
    return replace(contract, terms=terms)


@pytest.mark.slow
@pytest.mark.parametrize(("first", "second"), [(0, 1), (0, 3), (2, 5), (1, 10), (4, 7)])
def test_planted_order_is_named(
    recorded: tuple[Policy, dict[str, Any]], tmp_path: Path, first: int, second: int
) -> None:
    policy, arrays = recorded
    wrong = replace(policy, contract=state_order(policy.contract, first, second))
    mistakes = find_mistakes(check(wrong, arrays, tmp_path))
    assert set(mistakes) == {"joint-positions", "joint-velocities", "targets"}
    for mistake, detail in mistakes.values():
        assert mistake == "order"
        # The recorded element of the one is the other, as the wrong contract names them.
        assert f"{JOINTS[first]} has {JOINTS[second]}" in detail


@pytest.mark.slow
@pytest.mark.parametrize("index", [0, 2, 4, 8, 11])
def test_planted_sign_is_named(
    recorded: tuple[Policy, dict[str, Any]], tmp_path: Path, index: int
) -> None:
    policy, arrays = recorded
    wrong = replace(policy, contract=state_sign(policy.contract, index))
    mistakes = find_mistakes(check(wrong, arrays, tmp_path))
    assert {name: mistake for name, (mistake, _) in mistakes.items()} == dict.fromkeys(
        ("joint-positions", "joint-velocities", "targets"), "sign"
    )
    assert all(detail == JOINTS[index] for _, detail in mistakes.values())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "factor"),
    [
        ("angular-velocity", 4.0),
        ("command", 0.5),
        ("joint-positions", 2.0),
        ("joint-velocities", 20.0),
        ("last-action", 0.25),
    ],
)
def test_planted_scale_is_named(
    recorded: tuple[Policy, dict[str, Any]], tmp_path: Path, name: str, factor: float
) -> None:
    policy, arrays = recorded
    wrong = replace(policy, contract=state_scale(policy.contract, name, factor))
    mistakes = find_mistakes(check(wrong, arrays, tmp_path))
    assert mistakes == {name: ("scale", f"x {1 / factor:.4g}")}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "delay"),
    [("angular-velocity", 1), ("gravity", 2), ("joint-positions", 1), ("joint-velocities", 3),
     ("command", 2)],
)  # fmt: skip
def test_planted_delay_is_named(
    recorded: tuple[Policy, dict[str, Any]], tmp_path: Path, name: str, delay: int
) -> None:
    """The elements of a term are late in the recorded observations."""
    policy, arrays = recorded
    observations = arrays["observations"].copy()
    place, size = 2 * sum(SIZES[: NAMES.index(name)]), SIZES[NAMES.index(name)]
    block = slice(place, place + 2 * size)
    observations[delay:, block] = arrays["observations"][:-delay, block]
    mistakes = find_mistakes(check(policy, arrays | {"observations": observations}, tmp_path))
    assert mistakes.pop(name) == ("delay", f"{delay} samples ({20 * delay} ms)")
    assert set(mistakes) <= {"network"}  # its actions belong to the other observations


@pytest.mark.parametrize("stated", [100.0, 62.5, 40.0])
def test_planted_rate_is_named(
    recorded: tuple[Policy, dict[str, Any]], tmp_path: Path, stated: float
) -> None:
    """The trace has a sample per 20 ms. Clocks that differ by 4 % are no mistake."""
    policy, arrays = recorded
    found = check(policy.with_contract(rate=stated), arrays, tmp_path)
    assert find_mistakes(found) == {"rate": ("scale", f"x {50 / stated:.4g}")}
    assert not found.passed
    assert check(policy.with_contract(rate=48.0), arrays, tmp_path).passed


def test_terms_in_another_order_are_found_at_their_place(
    recorded: tuple[Policy, dict[str, Any]], tmp_path: Path
) -> None:
    policy, arrays = recorded
    gyro, gravity, *rest = policy.contract.terms
    wrong = policy.with_contract(terms=(gravity, gyro, *rest))
    mistakes = find_mistakes(check(wrong, arrays, tmp_path))
    assert mistakes["gravity"] == ("place", "elements 3-5")
    assert mistakes["angular-velocity"] == ("place", "elements 0-2")


def test_reversed_history_and_wrong_pose_are_named(
    recorded: tuple[Policy, dict[str, Any]], tmp_path: Path
) -> None:
    policy, arrays = recorded
    found = check(policy.with_contract(newest_first=True), arrays, tmp_path)
    assert find_mistakes(found)["joint-positions"][0] == "history"
    default = policy.contract.default + np.where(np.arange(12) == 2, 0.1, 0.0)
    mistakes = find_mistakes(check(policy.with_contract(default=default), arrays, tmp_path))
    assert mistakes["joint-positions"] == ("offset", f"{JOINTS[2]} +0.1")
    assert mistakes["targets"] == ("offset", f"{JOINTS[2]} -0.1")


@pytest.mark.slow
def test_other_network_is_found(recorded: tuple[Policy, dict[str, Any]], tmp_path: Path) -> None:
    policy, arrays = recorded
    actions = (
        arrays["actions"] * np.linspace(0.5, 1.5, 12)
        + 0.3 * np.sin(np.arange(len(arrays["time"])))[:, None]
    )
    found = check(policy, arrays | {"actions": actions}, tmp_path)
    assert find_mistakes(found)["network"][0] == "unexplained"
    assert not found.passed


def test_signals_that_are_not_recorded_are_unchecked(
    recorded: tuple[Policy, dict[str, Any]], tmp_path: Path
) -> None:
    """A trace without any signal of the robot proves the network and the last action only."""
    policy, arrays = recorded
    few = {name: arrays[name] for name in ("time", "observations", "actions")}
    found = check(policy, few, tmp_path)
    unchecked = [check.term for check in found.checks if check.mistake == "unchecked"]
    assert unchecked == list(NAMES[:-1])
    bare = policy.with_contract(terms=tuple(map(ObservationTerm, NAMES[:-1])), history=1)
    assert not replace(found, checks=found.checks[:-1]).passed, bare


def test_csv_and_npz_give_equal_results(
    recorded: tuple[Policy, dict[str, Any]], tmp_path: Path
) -> None:
    """Columns of joints in any order."""
    policy, arrays = recorded
    columns = {"time": arrays["time"]}
    for name, prefix in {"observations": "obs", "actions": "action", "commands": "command",
                         "quaternion": "quat", "angular_velocity": "gyro"}.items():  # fmt: skip
        columns |= {f"{prefix}_{k}": arrays[name][:, k] for k in range(arrays[name].shape[1])}
    names = list(load("v3").joint_names)
    for name, prefix in {"positions": "q", "velocities": "v", "targets": "target"}.items():
        for joint in reversed(names):
            columns[f"{prefix}_{joint}"] = arrays[name][:, names.index(joint)]
    rows = np.column_stack(list(columns.values()))
    path = tmp_path / "trace.csv"
    np.savetxt(path, rows, delimiter=",", header=",".join(columns), comments="", fmt="%.17g")
    found = check_trace(load("v3"), policy, read_trace(path))
    assert find_mistakes(found) == {}
    whole = check(policy, arrays, tmp_path)
    assert [check.error for check in found.checks] == pytest.approx(
        [check.error for check in whole.checks], abs=1e-9
    )


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"observations": None}, "lacks observations"),
        ({"time": np.zeros(120)}, "sample 1 is at 0 s after 0 s"),
        ({"time": np.array(math.nan)}, "column 0 of time is nan at sample 0"),
        ({"time": np.array(0.0)}, "has 1 samples, but at least 20"),
        ({"gravity": np.array(math.inf)}, "column 0 of gravity is inf at sample 0"),
        ({"time": np.zeros(3)}, "has 3 samples, but at least 20"),
        ({"actions": np.zeros((120, 11))}, "numbers in an observation"),
        ({"positions": np.full((120, 12), math.nan)}, "column 0 of positions is nan at sample 0"),
        ({"actions": np.full((120, 12), 1e200)}, r"column 0 of actions is 1e\+200 at sample 0"),
        ({"actions": np.zeros((120, 12), dtype=complex)}, "actions: complex numbers"),
        ({"joints": np.array(["a"] * 12)}, "no columns of leg_front_r_1, .* and 8 more"),
        ({"velocities": np.zeros((120, 6))}, "velocities of the trace must have 12 columns"),
        ({"commands": np.zeros((120, 2))}, "commands of the trace must have 3 columns"),
        ({"quaternion": np.zeros((120, 3))}, "must have 4 columns, but has 3"),
        ({"quaternion": np.zeros((120, 4))}, "has norm 0 instead of 1"),
        ({"gravity": np.ones((120, 2))}, "must have 3 columns"),
    ],
)
def test_invalid_trace_is_refused(
    recorded: tuple[Policy, dict[str, Any]],
    tmp_path: Path,
    changed: dict[str, Any],
    message: str,
) -> None:
    policy, arrays = recorded
    given = {name: array for name, array in (arrays | changed).items() if array is not None}
    with pytest.raises(ModelError, match=message):
        check(policy, given, tmp_path)


def test_file_that_is_no_trace_is_refused(tmp_path: Path) -> None:
    for name, data in (
        ("a.npz", b"PK\x03\x04"),
        ("a.csv", b"time,obs_0\n1,x\n"),
        ("b.csv", b""),
        ("c.csv", b"time,obs_0,gyro_x,gyro_y,gyro_z\n0,1,0,0,0\n"),
    ):
        (tmp_path / name).write_bytes(data)
        with pytest.raises(ModelError, match="trace"):
            read_trace(tmp_path / name)


CSV_COLUMNS = ("time", *(f"obs_{k}" for k in range(12)), "action_0", "q_a", "v_a")


@pytest.mark.parametrize(
    ("line", "old", "new", "message"),
    [
        (1, "time,", "t,", "the trace lacks time"),
        (1, "obs_1,", "obs_0,", "duplicate column obs_0"),
        (1, "q_a", "time", "duplicate column time"),
        (1, "obs_7,", "obs_12,", "lacks obs_7"),
        (1, "obs_7,", f"obs_{'9' * 5000},", "lacks obs_7"),
        (1, "v_a", "v_b", "lacks v_a"),
        (1, "q_a", "p_a", "lacks q_a"),
        (4, "2,", "nan,", "column 0 of time is nan at sample 2"),
        (4, ",7,", ",inf,", "column 7 of observations is inf at sample 2"),
        (4, ",7,", ",seven,", "'seven' in column obs_7 is not a number"),
        (4, ",7,", ",7,7,", "the line has 17 cells, but the header has 16; write one cell per"),
        (4, "2,", "1,", "sample 2 is at 1 s after 1 s"),
        (4, "2,", "-5,", "sample 2 is at -5 s after 1 s"),
    ],
)
def test_refusal_of_a_csv_file_names_the_line(
    tmp_path: Path, line: int, old: str, new: str, message: str
) -> None:
    lines = [",".join(CSV_COLUMNS), *(f"{k},{','.join(map(str, range(15)))}" for k in range(30))]
    path = tmp_path / "trace.csv"
    for separator in ",;\t":
        path.write_text("\n".join(lines).replace(",", separator))
        assert read_trace(path).arrays["observations"][0].tolist() == [*range(12)]
    lines[line - 1] = lines[line - 1].replace(old, new, 1)
    path.write_text("\n".join(lines))
    with pytest.raises(ModelError, match=message) as caught:
        read_trace(path)
    assert f"trace.csv:{line}: " in str(caught.value)


def test_comments_and_repeated_unused_columns_of_a_csv_file_are_left_out(tmp_path: Path) -> None:
    rows = [f"{sample},1,2,{sample},8,9" for sample in range(30)]
    rows.insert(3, " # second run, 3 samples")
    path = tmp_path / "trace.csv"
    path.write_text("\n".join(["time,obs_0,action_0,q_a,note,note", *rows, "# end"]))
    trace = read_trace(path)
    assert trace.arrays["positions"][:, 0].tolist() == [*range(30)]
    path.write_text(path.read_text().replace("5,1,2", "5,1,x"))
    with pytest.raises(ModelError, match=r"trace.csv:8: 'x' in column action_0"):
        read_trace(path)


def test_numbered_columns_of_joints_are_read_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    """Columns in any order: the value in column ``q_k`` is k."""
    names = ("time", "obs_0", "action_0", "q_10", "q_2", "v_2", "v_10")
    rows = [f"{sample},0,0,10,2,2,10" for sample in range(30)]
    path = tmp_path / "trace.csv"
    path.write_text("\n".join([",".join(names), *rows]))
    trace = read_trace(path)
    assert trace.joints == ()
    for signal in ("positions", "velocities"):
        assert trace.arrays[signal][0].tolist() == [2.0, 10.0]


def test_damaged_npz_file_is_refused(tmp_path: Path) -> None:
    """Each byte of a valid file is inverted in turn: the only error is the one of the package."""
    path = tmp_path / "trace.npz"
    np.savez_compressed(path, time=np.arange(30.0), observations=np.arange(60.0).reshape(30, 2))
    data, num_refused = path.read_bytes(), 0
    for index in range(0, len(data), 3):
        path.write_bytes(data[:index] + bytes([data[index] ^ 0xFF]) + data[index + 1 :])
        try:
            read_trace(path)
        except ModelError:
            num_refused += 1
    assert num_refused > len(data) / 6


@pytest.mark.slow
def test_command_states_the_level_of_evidence(
    recorded: tuple[Policy, dict[str, Any]], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    policy, arrays = recorded
    np.savez(tmp_path / "trace.npz", **arrays)
    onnx = str(policy.files[0])
    words = ("walk", "v3", "--policy", onnx, "--trace", str(tmp_path / "trace.npz"), "-v")
    _, out, err = run_command(capfd, *words, "--command", "0,0,0", "--seconds", "3")
    assert "matched to a recorded trace" in out, err
    toml = tmp_path / "wrong.toml"
    toml.write_text(TOML.replace("scale = 0.25}", "scale = 1.0}"))
    status, out, err = run_command(capfd, *words, "--contract", str(toml))
    assert status == 1, err
    assert out.startswith("DIFFERS FROM THE TRACE v3 by policy.onnx, trace.npz")
    assert "angular-velocity: wrong scale (x 0.25)" in out
