"""Comparison of a policy's contract with a recorded trace, open loop.

A `Trace` contains observations and actions of a policy that ran on a robot, and the recorded
signals of the robot. `check_trace` evaluates the network for the recorded observations, and
compares each term of the observations with the recorded signals: order, sign, scale, offset and
delay.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar
from zipfile import BadZipFile

import numpy as np

from pupper_analysis.base.array_types import Array
from pupper_analysis.base.arrays import rotations_from_quaternions
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import InputError, ModelError
from pupper_analysis.base.inputs import MAX_FILE_BYTES, decode_input, read_input
from pupper_analysis.base.results import Result
from pupper_analysis.models.places import Place, make_file_error, make_input_error, quote_short
from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.walk.contract import BY_FRAME, PolicyContract
from pupper_analysis.tools.walk.policy import Policy
from pupper_analysis.tools.walk.runs import (
    Lockstep,
    find_joint_indices,
    prepare_stage,
)

MIN_SAMPLES = 20
"""Smallest number of samples of a trace. A file with fewer samples is refused. Chosen, not tuned.
"""

MAX_DELAY_SAMPLES = 10
"""Largest delay that is searched, in samples. Chosen: 0.2 s at 50 Hz."""

MATCH_RTOL, MATCH_ATOL = 0.02, 1e-4
"""Relative and absolute tolerance of a column of a signal; the absolute tolerance is in the unit of
the signal. A column agrees if rms difference <= `MATCH_RTOL` * (rms of the expected signal about
the mean) + `MATCH_ATOL`. Chosen, not tuned: above the rounding of float32 logs.
"""

MAX_RATE_DEVIATION = 0.1
"""Largest accepted difference of the rate of a trace from the rate of the contract, relative to the
rate of the contract. Chosen: controllers may round the period to whole time steps."""

_DAMAGE_ERRORS = (
    ValueError,
    OSError,
    KeyError,
    TypeError,
    EOFError,
    OverflowError,
    BadZipFile,
    zlib.error,
    struct.error,
    RuntimeError,
)
"""Errors of numpy and ``zipfile`` for a damaged npz file. ``RuntimeError`` is the error for an
encrypted member or an unknown compression method."""

_SIGNALS = {
    "positions": "q",
    "velocities": "v",
    "targets": "target",
    "commands": "command",
    "angular_velocity": "gyro",
    "gravity": "gravity",
    "quaternion": "quat",
    "observations": "obs",
    "actions": "action",
}
"""{array of a trace in an npz file: prefix of its columns in a CSV file}."""


_NUM_COLUMNS = {"angular_velocity": 3, "gravity": 3, "quaternion": 4, "commands": 3}
"""{array of a trace: number of columns}, for arrays whose size does not depend on the robot."""

_NUM_UNKNOWN_SAMPLES = {"last-action": 1, "second-last-action": 2}
"""{term: number of samples at the start of a trace that are not compared}, since the term contains
unknown actions before the trace.
"""

_MAX_MAGNITUDE = 1e30
"""Largest magnitude of a number of a trace, in the unit of the array. A larger number is refused,
like one that is not finite. Chosen, not tuned.
"""

MAX_NORM_DEVIATION = 0.05
"""Largest accepted difference of the norm of a recorded quaternion from 1. If the difference is
larger, the trace is refused. Chosen: logs with two decimals have 0.01; a row of zeros has 1.
"""


@dataclass(frozen=True, eq=False)
class Trace:
    """Record of a policy that ran on a robot: observations, actions and signals of n samples.

    Attributes:
        path: File.
        time: Times of the samples, shape (n,) [s]. A sample per action of the policy.
        arrays: {name of the signal, for example ``observations`` or ``positions``: values, shape
            (n, size)}. Positions, velocities and targets have a column per joint, in the order of
            ``joints``.
        joints: Names of the robot's joints in the order of the columns; empty for the order of the
            robot's actuators.
    """

    path: Path
    time: Array
    arrays: Mapping[str, Array]
    joints: tuple[str, ...]

    @property
    def period(self) -> float:
        """Median time between samples [s]."""
        return float(np.median(np.diff(self.time)))


def read_trace(path: str | Path) -> Trace:
    """Read the record of a policy that ran on a robot, from a CSV or npz file.

    A CSV file has the columns ``time``, ``obs_0`` ..., ``action_0`` .... Optional columns are
    ``q_JOINT``, ``v_JOINT``, ``target_JOINT``, ``command_0`` to 2, ``gyro_0`` to 2, ``gravity_0``
    to 2 and ``quat_0`` to 3 (w, x, y, z). ``v_JOINT`` and ``target_JOINT`` require ``q_JOINT``. An
    npz file has the arrays ``time``, ``observations`` and ``actions``. Optional arrays are
    ``positions``, ``velocities``, ``targets``, ``joints`` (names), ``commands``,
    ``angular_velocity``, ``gravity`` and ``quaternion``.

    Raises:
        ModelError: If the file cannot be read, lacks a required array, or contains invalid numbers,
            for example. An error in a line of a CSV file contains the line.
    """
    path, lines = Path(path), list[int]()
    try:
        data = read_input(path, MAX_FILE_BYTES)
        if path.suffix == ".npz":
            arrays, joints = _read_npz(path, data)
        else:
            arrays, joints, lines = _read_csv(path, data)
    except InputError as error:
        raise make_input_error(path, error) from error

    def make_error(row: int, problem: Diagnostic) -> ModelError:
        """Return the error for a sample, with the line of a CSV file."""
        return make_file_error(Place(path, lines[row] if lines else None), problem)

    for name in ("time", "observations", "actions"):
        if name not in arrays:
            raise ModelError(path, diagnose("trace-lacks", name=name))
    for name, array in arrays.items():
        array = np.atleast_1d(array)
        bad = np.argwhere(~(np.abs(array) <= _MAX_MAGNITUDE))
        if len(bad):
            sample, column = int(bad[0][0]), int(bad[0][1]) if array.ndim == 2 else 0
            number = float(array[tuple(bad[0])])
            problem = diagnose(
                "trace-number", name=name, sample=sample, column=column, number=number
            )
            raise make_error(sample, problem)
    time = arrays.pop("time").ravel()
    if len(time) < MIN_SAMPLES:
        raise ModelError(path, diagnose("trace-short", count=len(time), least=MIN_SAMPLES))
    for row in np.flatnonzero(np.diff(time) <= 0)[:1] + 1:
        before, after = float(time[row - 1]), float(time[row])
        problem = diagnose("trace-times", sample=int(row), before=before, after=after)
        raise make_error(int(row), problem)
    for name, array in arrays.items():
        if array.ndim != 2 or len(array) != len(time):
            raise ModelError(path, diagnose("trace-array", name=name, count=len(time)))
        size = _NUM_COLUMNS.get(name, array.shape[1])
        if array.shape[1] != size:
            found = array.shape[1]
            raise ModelError(path, diagnose("trace-columns", name=name, found=found, wanted=size))
    norms = np.linalg.norm(arrays.get("quaternion", np.ones((1, 1))), axis=1)
    worst = int(np.argmax(abs(norms - 1)))
    if abs(norms[worst] - 1) > MAX_NORM_DEVIATION:
        problem = diagnose("trace-quaternion", time=float(time[worst]), norm=float(norms[worst]))
        raise make_error(worst, problem)
    return Trace(path, time, arrays, joints)


def _read_npz(path: Path, data: bytes) -> tuple[dict[str, Array], tuple[str, ...]]:
    """Read the known arrays of an npz file, {array: values}, and the joint names, if stated.

    Nothing is unpickled.
    """
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as file:
            stated = {name: file[name] for name in file.files}
        joints = tuple(str(name) for name in stated.pop("joints", np.array([], dtype=str)))
        known = {name: array for name, array in stated.items() if name in ("time", *_SIGNALS)}
        for name, array in known.items():
            if np.iscomplexobj(array):
                raise TypeError(f"{name}: complex numbers")
        return {name: np.asarray(array, dtype=np.float64) for name, array in known.items()}, joints
    except _DAMAGE_ERRORS as error:
        raise ModelError(path, diagnose("trace-unreadable", problem=str(error))) from error


def _read_csv(path: Path, data: bytes) -> tuple[dict[str, Array], tuple[str, ...], list[int]]:
    """Read a CSV file: {array: values}, the joint names, and the line number of each sample.

    The joint names are taken from the columns ``q_JOINT``; empty if the columns are numbered.
    """
    lines = [
        (line, text)
        for line, text in enumerate(decode_input(path, data).splitlines(), 1)
        if text.strip()
    ]
    lines = lines[:1] + [(line, text) for line, text in lines[1:] if text.strip()[0] != "#"]
    if len(lines) < 2:
        raise ModelError(path, diagnose("trace-unreadable", problem="no numbers"))
    header, separator = Place(path, lines[0][0]), max(",;\t", key=lines[0][1].count)
    (_, names), *samples = (
        (line, [cell.strip().strip('"') for cell in text.split(separator)]) for line, text in lines
    )
    if "time" not in names:
        raise make_file_error(header, diagnose("trace-lacks", name="time"))
    prefixes = tuple(f"{prefix}_" for prefix in _SIGNALS.values())
    for name in names:
        if names.count(name) > 1 and (name == "time" or name.startswith(prefixes)):
            raise make_file_error(header, diagnose("trace-column-twice", name=name))
    table = np.array([_parse_numbers(Place(path, line), names, cells) for line, cells in samples])
    arrays = {"time": table[:, names.index("time")]}
    joints = tuple(name[2:] for name in names if name.startswith("q_"))
    is_numbered = all(map(_is_number, joints))
    if is_numbered:
        joints = tuple(sorted(joints, key=int))
    for signal, prefix in _SIGNALS.items():
        columns = {name[len(prefix) + 1 :]: index for index, name in enumerate(names)
                   if name.startswith(f"{prefix}_")}  # fmt: skip
        if not columns:
            continue
        if prefix in ("q", "v", "target"):
            order, absent = (
                joints,
                [f"{prefix}_{joint}" for joint in joints if joint not in columns],
            )
            absent += [f"q_{key}" for key in columns if key not in joints]
        else:
            order = tuple(sorted(filter(_is_number, columns), key=int))
            first = int(order[0]) if order else 0
            numbers = set(map(int, order))
            absent = [
                f"{prefix}_{first + k}" for k in range(len(columns)) if first + k not in numbers
            ]
        if absent:
            raise make_file_error(header, diagnose("trace-lacks", name=absent[0]))
        arrays[signal] = table[:, [columns[key] for key in order]]
    return arrays, () if is_numbered else joints, [line for line, _ in samples]


def _is_number(name: str) -> bool:
    """Return True if a text is a number of up to nine digits, such as 12 in ``obs_12``."""
    return name.isdecimal() and len(name) <= 9


def _parse_numbers(place: Place, names: Sequence[str], cells: Sequence[str]) -> list[float]:
    """Return the numbers of a line of a CSV file."""
    if len(cells) != len(names):
        problem = diagnose("trace-cells", cells=len(cells), columns=len(names))
        raise make_file_error(place, problem)
    numbers = list[float]()
    for name, cell in zip(names, cells, strict=True):
        try:
            numbers.append(float(cell))
        except ValueError:
            problem = diagnose("trace-cell", name=name, cell=quote_short(cell))
            raise make_file_error(place, problem) from None
    return numbers


@dataclass(frozen=True, eq=False)
class TermCheck(Result):
    """Comparison of a term of the observations, or of the targets, with recorded signals.

    Attributes:
        term: Term, ``network``, ``rate`` or ``targets``.
        first: Index of the first element in a frame of the observation; -1 for network, rate and
            targets.
        size: Number of elements.
        error: Root mean square of the difference, relative to the spread of the expected signal;
            relative error of the rate for ``rate``; None if not checked.
        mistake: ``order``, ``sign``, ``scale``, ``offset``, ``delay``, ``place`` (the term is
            elsewhere in the observation), ``history`` (frames reversed), ``unexplained``,
            ``unchecked`` (no recorded signal), or empty if the term agrees.
        detail: Elements, factors, offsets, place or delay of the mistake; may be empty.
    """

    term: str
    first: int
    size: int
    error: float | None = field(metadata={"unit": "1"})
    mistake: str
    detail: str


@dataclass(frozen=True, eq=False)
class TraceCheck(Result):
    """Comparison of a policy's contract with a recorded trace of the policy.

    Attributes:
        name: Name of the robot.
        policy: File name of the policy.
        trace: File name of the trace.
        samples: Number of samples.
        period: Median time between samples.
        checks: Network, rate, terms of the observation, and targets.
    """

    _key_fields: ClassVar[tuple[str, ...]] = ("passed", "name")

    name: str
    policy: str
    trace: str
    samples: int
    period: float = field(metadata={"unit": "s"})
    checks: tuple[TermCheck, ...]
    _reported: ClassVar[tuple[str, ...]] = ("passed",)

    @property
    def signal_checks(self) -> tuple[TermCheck, ...]:
        """Checks of the terms of the observation, and of the targets."""
        return tuple(check for check in self.checks if check.term not in ("network", "rate"))

    @property
    def passed(self) -> bool:
        """Whether network and rate agree, a term or the targets agree, and nothing disagrees."""
        mistakes = [check.mistake for check in self.checks]
        checked = [check for check in self.signal_checks if check.mistake == ""]
        return bool(checked) and all(mistake in ("", "unchecked") for mistake in mistakes)


def check_trace(robot: Robot, policy: Policy, trace: Trace) -> TraceCheck:
    """Compare a policy's contract with a recorded trace, to find wrong orders, signs or scales.

    The actions of the network, and each term of the observation and the joint targets for which the
    trace contains a signal, are compared with the recorded signals. The rate of the contract is
    compared with the median time between samples.

    Raises:
        ModelError: If the trace does not fit the policy or the robot, for example.
        UnknownNameError: If the policy names a joint that the robot does not have.
    """
    contract, observations = policy.contract, trace.arrays["observations"]
    sizes = (policy.network.inputs, policy.network.outputs)
    if (observations.shape[1], trace.arrays["actions"].shape[1]) != sizes:
        found = f"{observations.shape[1]}, {trace.arrays['actions'].shape[1]}"
        raise ModelError(trace.path, diagnose("trace-sizes", found=found, wanted=str(sizes)))
    signals = _make_signals(robot, policy, trace)
    labels = contract.joints or tuple(robot.joint_names)
    checks = [_check_network(policy, trace), _check_rate(contract, trace)]
    firsts = np.cumsum([0, *(contract.term_size(term) for term in contract.terms)])
    for number, term in enumerate(contract.terms):
        size, first = contract.term_size(term), int(firsts[number])
        signal = signals.get(term.name)
        if signal is None:
            checks.append(TermCheck(term.name, first, size, None, "unchecked", ""))
            continue
        expected = np.clip(signal, *term.clip) * term.scale
        expected = np.clip(expected, -contract.clip, contract.clip)
        start = _NUM_UNKNOWN_SAMPLES.get(term.name, 0)
        expected, compared = expected[start:], observations[start:]
        seen = _extract_frame(contract, compared, newest=True)
        names = labels if size == len(labels) else tuple(map(str, range(size)))
        error, mistake, detail = _explain_difference(seen[:, first : first + size], expected, names)
        if mistake:
            error, mistake, detail = _search_elsewhere(
                contract, compared, expected, first, (error, mistake, detail)
            )
        detail = _describe_delay(detail, trace.period) if mistake == "delay" else detail
        checks.append(TermCheck(term.name, first, size, error, mistake, detail))
    if "targets" in signals:
        clipped = np.clip(trace.arrays["actions"], -contract.action_clip, contract.action_clip)
        offset = contract.default if contract.offset is None else contract.offset
        expected = np.clip(offset + contract.action_scale * clipped, contract.lower, contract.upper)
        error, mistake, detail = _explain_difference(signals["targets"], expected, labels)
        detail = _describe_delay(detail, trace.period) if mistake == "delay" else detail
        checks.append(TermCheck("targets", -1, len(labels), error, mistake, detail))
    return TraceCheck(
        robot.name, policy.name, trace.path.name, len(trace.time), trace.period, tuple(checks)
    )


def _describe_delay(detail: str, period: float) -> str:
    """Append the duration of a delay [ms] to ``detail``, a text such as "3 samples".

    ``period`` is the time between samples [s].
    """
    return f"{detail} ({1e3 * float(detail.split()[0]) * period:.3g} ms)"


def _check_network(policy: Policy, trace: Trace) -> TermCheck:
    """Compare the network's actions for the recorded observations with the recorded actions."""
    network, memory = policy.network, policy.network.initial_memory(1)
    actions = []
    for row in trace.arrays["observations"]:
        action, memory = network.forward(row[None], memory)
        actions.append(action[0])
    names = policy.contract.joints or tuple(map(str, range(network.outputs)))
    error, mistake, detail = _explain_difference(trace.arrays["actions"], np.array(actions), names)
    detail = _describe_delay(detail, trace.period) if mistake == "delay" else detail
    return TermCheck("network", -1, network.outputs, error, mistake, detail)


def _check_rate(contract: PolicyContract, trace: Trace) -> TermCheck:
    """Compare the rate of the contract with the rate of the samples."""
    ratio = 1 / (trace.period * contract.rate)
    is_wrong = abs(ratio - 1) > MAX_RATE_DEVIATION
    mistake, detail = ("scale", f"x {ratio:.4g}") if is_wrong else ("", "")
    return TermCheck("rate", -1, 1, abs(ratio - 1), mistake, detail)


def _make_signals(robot: Robot, policy: Policy, trace: Trace) -> dict[str, Array]:
    """Convert recorded signals to units and order of the contract: {term or ``targets``: signal}.

    A signal has the shape (n, size), before clip and scale of the term. Unknown actions before the
    trace are replaced by zeros.
    """
    contract, arrays = policy.contract, trace.arrays
    columns = list(trace.joints or robot.joint_names)
    wanted = [robot.joint_names[index] for index in find_joint_indices(robot, policy)]
    signals: dict[str, Array] = {}
    for name in ("positions", "velocities", "targets"):
        if name not in arrays:
            continue
        if missing := tuple(joint for joint in wanted if joint not in columns):
            raise ModelError(trace.path, diagnose("trace-joints", names=missing))
        if (found := arrays[name].shape[1]) != len(columns):
            wanted_count = len(columns)
            problem = diagnose("trace-columns", name=name, found=found, wanted=wanted_count)
            raise ModelError(trace.path, problem)
        values = contract.signs * arrays[name][:, [columns.index(joint) for joint in wanted]]
        if name == "positions":
            signals["joint-positions"] = values - contract.default
        else:
            signals["joint-velocities" if name == "velocities" else "targets"] = values
    if "commands" in arrays and arrays["commands"].shape[1] == 3:
        signals["command"] = arrays["commands"]
        signals["command-velocity"] = arrays["commands"][:, :2]
        signals["command-turning"] = arrays["commands"][:, 2:]
    if "angular_velocity" in arrays:
        signals["angular-velocity"] = arrays["angular_velocity"]
    if "gravity" in arrays:
        signals["gravity"] = arrays["gravity"]
    elif "quaternion" in arrays:
        signals["gravity"] = -rotations_from_quaternions(arrays["quaternion"])[:, 2]
    actions = arrays["actions"]
    zeros = np.zeros_like(actions[:1])
    signals["last-action"] = np.concatenate([zeros, actions[:-1]])
    signals["second-last-action"] = np.concatenate([zeros, zeros, actions[:-2]])
    return signals


def _extract_frame(contract: PolicyContract, observations: Array, *, newest: bool) -> Array:
    """Return the newest or oldest frame of each of n observations, shape (n, frame size)."""
    size = contract.frame_size
    is_first = contract.newest_first is newest
    if contract.layout == BY_FRAME or contract.max_history == 1:
        start = 0 if is_first else (contract.max_history - 1) * size
        return observations[:, start : start + size]
    parts, start = [], 0
    for term in contract.terms:
        width, history = contract.term_size(term), contract.count_frames(term)
        place = start + (0 if is_first else (history - 1) * width)
        parts.append(observations[:, place : place + width])
        start += history * width
    return np.concatenate(parts, axis=1)


def _measure_difference(seen: Array, expected: Array) -> float:
    """Return the rms difference of two signals (n, size), relative to the expected signal [1].

    The divisor is the rms of ``expected`` about the mean, plus `MATCH_ATOL` / `MATCH_RTOL`.
    """
    difference = float(np.sqrt(np.mean((seen - expected) ** 2)))
    size = float(np.sqrt(np.mean((expected - expected.mean(axis=0)) ** 2)))
    return difference / (size + MATCH_ATOL / MATCH_RTOL)


def _signals_agree(seen: Array, expected: Array) -> bool:
    """Return True if each column of two signals (n, size) agrees within the tolerances."""
    return all(
        _measure_difference(seen[:, [column]], expected[:, [column]]) <= MATCH_RTOL
        for column in range(seen.shape[1])
    )


def _list_delays(seen: Array, expected: Array) -> Iterator[tuple[int, Array, Array]]:
    """Yield delays from -2 to `MAX_DELAY_SAMPLES`, the shortest first, with shifted signals.

    A delay is positive if ``seen`` is later than ``expected``.
    """
    for delay in sorted(range(-2, MAX_DELAY_SAMPLES + 1), key=abs):
        count = len(seen) - abs(delay)
        if delay >= 0:
            yield delay, seen[delay:], expected[:count]
        else:
            yield delay, seen[:count], expected[-delay:]


def _explain_difference(
    seen: Array, expected: Array, names: Sequence[str]
) -> tuple[float, str, str]:
    """Return relative error, mistake and detail of the difference of two signals, (n, size) each.

    The mistake is "" if both signals agree, and "unexplained" if no known mistake explains the
    difference. ``names`` are the names of the elements.
    """
    error = _measure_difference(seen, expected)
    if _signals_agree(seen, expected):
        return error, "", ""
    # Without offsets first: a wrong sign or order of joints changes the offset by the default pose.
    for is_centred in (False, True):
        for delay, late, early in _list_delays(seen, expected):
            suffix = f", delay {delay} samples" if delay else ""
            if is_centred:
                late, early = late - late.mean(axis=0), early - early.mean(axis=0)
                if _signals_agree(late, early):
                    return error, "offset", _list_offsets(seen, expected, names) + suffix
            elif delay and _signals_agree(late, early):
                return error, "delay", f"{delay} samples"
            for search in (_find_signs, _find_scales, _find_permutation):
                found = search(late, early, names)
                if found is not None:
                    return error, found[0], found[1] + suffix
    return error, "unexplained", ""


def _find_signs(seen: Array, expected: Array, names: Sequence[str]) -> tuple[str, str] | None:
    """Test whether inverted signs of elements explain a difference: ("sign", names), or None."""
    signs = np.where(np.sum(seen * expected, axis=0) < 0, -1.0, 1.0)
    if (signs > 0).all() or not _signals_agree(seen, signs * expected):
        return None
    turned = [name for name, sign in zip(names, signs, strict=True) if sign < 0]
    return "sign", ", ".join(turned)


def _find_scales(seen: Array, expected: Array, names: Sequence[str]) -> tuple[str, str] | None:
    """Test whether factors of elements explain a difference: ("scale", factor text), or None."""
    squares = np.sum(expected**2, axis=0)
    factors = np.sum(seen * expected, axis=0) / np.where(squares > 0, squares, 1.0)
    factors = np.where(squares > len(seen) * MATCH_ATOL**2, factors, 1.0)
    if (np.abs(factors) < 1e-3).any() or not _signals_agree(seen, factors * expected):
        return None
    changed = np.flatnonzero(np.abs(factors - 1) > MATCH_RTOL)
    if not changed.size:
        return None
    if np.ptp(factors[changed]) <= MATCH_RTOL * abs(factors[changed[0]]) and (
        len(changed) == len(factors)
    ):
        return "scale", f"x {factors.mean():.4g}"
    return "scale", ", ".join(f"{names[index]} x {factors[index]:.4g}" for index in changed)


def _find_permutation(seen: Array, expected: Array, names: Sequence[str]) -> tuple[str, str] | None:
    """Test whether a permutation of elements explains a difference: ("order", moved), or None."""
    from scipy.optimize import linear_sum_assignment

    costs = np.array(
        [
            [_measure_difference(seen[:, [i]], expected[:, [j]]) for j in range(len(names))]
            for i in range(len(names))
        ]
    )
    # Elements with equal signals stay where they are.
    costs -= 1e-9 * np.eye(len(names))
    _, order = linear_sum_assignment(np.minimum(costs, 1e3))
    if (order == np.arange(len(names))).all() or not _signals_agree(seen, expected[:, order]):
        return None
    moved = [f"{names[i]} has {names[j]}" for i, j in enumerate(order.tolist()) if i != j]
    return "order", ", ".join(moved[:6])


def _list_offsets(seen: Array, expected: Array, names: Sequence[str]) -> str:
    """Return elements with |mean(seen - expected)| above `MATCH_ATOL`, as text (six at most)."""
    offsets = (seen - expected).mean(axis=0)
    changed = np.flatnonzero(np.abs(offsets) > MATCH_ATOL)
    return ", ".join(f"{names[index]} {offsets[index]:+.4g}" for index in changed[:6])


def _search_elsewhere(
    contract: PolicyContract,
    observations: Array,
    expected: Array,
    first: int,
    found: tuple[float, str, str],
) -> tuple[float, str, str]:
    """Explain a difference by another place of the term in the observation, or reversed frames.

    ``expected`` (n, size) are the elements of the term; ``first`` is the stated index of the first
    element. Without such an explanation the result is ``found``: error, mistake and detail.
    """
    size = expected.shape[1]
    if float(np.ptp(expected, axis=0).max(initial=0.0)) <= 2 * MATCH_ATOL:
        return found  # a constant may occur anywhere
    if contract.max_history > 1:
        oldest = _extract_frame(contract, observations, newest=False)[:, first : first + size]
        if _signals_agree(oldest, expected):
            return found[0], "history", "newest frame in the place of the oldest"
    frame = _extract_frame(contract, observations, newest=True)
    for place in range(frame.shape[1] - size + 1):
        if place != first and _signals_agree(frame[:, place : place + size], expected):
            return found[0], "place", f"elements {place}-{place + size - 1}"
    return found


def record_trace(
    robot: Robot,
    policy: Policy,
    commands: Sequence[Sequence[float]],
    *,
    seconds_per_command: float = 1.0,
    seed: int = 1,
) -> dict[str, Any]:
    """Simulate a policy, and return the arrays of a trace for ``np.savez`` and `read_trace`.

    The arrays, except ``joints``, have a row per action. `read_trace` reads the same names from an
    npz file.

    Args:
        robot: Robot.
        policy: Policy.
        commands: At least one command: forward [m/s], left [m/s], turning [rad/s]. The commands are
            simulated one after another, in a single run.
        seconds_per_command: Duration of each command [s].
        seed: Seed of the initial state.

    Raises:
        ConfigurationError: If the base is fixed, the robot has no feet, or the policy acts more
            than once per time step, for example.
        ModelError: If the policy does not fit the robot (`prepare_stage`).
    """
    stage = prepare_stage(robot, policy)
    lockstep = Lockstep(stage, [stage.make_case(np.array(commands[0], dtype=float), seed)])
    convention, model = robot.mj_convention, stage.model
    period = stage.substeps * stage.timestep
    rows: dict[str, list[Array]] = {name: [] for name in ("time", *_SIGNALS) if name != "gravity"}
    for command in commands:
        lockstep.commands[:] = command
        for _ in range(max(1, round(seconds_per_command / period))):
            state = lockstep.current[0]
            qpos, qvel = (
                state[1 + convention.qpos_index],
                state[1 + model.nq + convention.qvel_index],
            )
            rows["time"].append(np.array(lockstep.tick * period))
            rows["positions"].append(qpos[7:].copy())
            rows["velocities"].append(qvel[6:].copy())
            rows["quaternion"].append(qpos[3:7].copy())
            rows["angular_velocity"].append(qvel[3:6].copy())
            rows["commands"].append(lockstep.commands[0].copy())
            lockstep.advance()
            rows["observations"].append(lockstep.observed[0].copy())
            rows["actions"].append(lockstep.last_actions[0].copy())
            contract, joints = policy.contract, stage.joints
            clipped = np.clip(rows["actions"][-1], -contract.action_clip, contract.action_clip)
            offset = contract.default if contract.offset is None else contract.offset
            targets = qpos[7:].copy()
            targets[joints] = contract.signs * np.clip(
                offset + contract.action_scale * clipped, contract.lower, contract.upper
            )
            rows["targets"].append(targets)
    arrays: dict[str, Any] = {name: np.array(values) for name, values in rows.items()}
    return {**arrays, "joints": np.array(robot.joint_names)}
