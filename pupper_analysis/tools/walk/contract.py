"""Contract of a policy and a robot: the observation, and the meaning of the actions.

Inputs are statements {contract key: value} of the policy file and of a TOML file. `make_contract`
merges these statements, checks them against the sizes of the network, and returns a `Contract`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pupper_analysis.base.arguments import real_array
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import ConfigurationError, ModelError
from pupper_analysis.tools.contract.facts import Source

Array = NDArray[np.float64]

TERM_SIZES = {
    "linear-velocity": 3,
    "angular-velocity": 3,
    "gravity": 3,
    "command": 3,
    "up-command": 3,
    "joint-positions": None,
    "joint-velocities": None,
    "last-action": None,
    "phase": None,
}
"""Number of elements of each term; None if the number follows from the joints or the phases.

Velocities and gravity refer to the base, in the base frame. Joint positions
are relative to the default positions. The up-command is the commanded vertical in the base frame.
The phase contains the cosines and then the sines of all phases."""

_TERM_ALIASES = {
    "base_lin_vel": "linear-velocity",
    "base_ang_vel": "angular-velocity",
    "projected_gravity": "gravity",
    "velocity_commands": "command",
    "joint_pos": "joint-positions",
    "joint_pos_rel": "joint-positions",
    "joint_vel": "joint-velocities",
    "joint_vel_rel": "joint-velocities",
    "actions": "last-action",
    "last_action": "last-action",
    "gait_phase": "phase",
}
"""Names of terms in Isaac Lab, mjlab and Unitree's environments: {name: term}."""

BY_FRAME, BY_TERM = "by-frame", "by-term"
"""Layouts of a history: frame after frame, or all frames of a term after each other."""


@dataclass(frozen=True, eq=False)
class Term:
    """Term of a policy's observation, such as joint positions, with a scale.

    Attributes:
        name: A key of `TERM_SIZES`.
        scale: Factor: a number, or a number per element.
    """

    name: str
    scale: Array | float = field(default=1.0, metadata={"unit": "1"})


@dataclass(frozen=True, eq=False)
class Contract:
    """Observation of a policy, and meaning of the actions, for n joints.

    Attributes:
        terms: Terms of a frame of the observation, in order.
        joints: Joint names in the order of the policy; empty if the file states none. The order is
            then that of the robot's actuators.
        default: Joint positions for an action of zero, in the directions of the policy's joints
            (`signs`), shape (n,) [rad].
        action_scale: Joint displacement for an action of 1, shape (n,) [rad].
        lower: Lower bounds of the commanded positions, in the policy's directions, shape (n,)
            [rad].
        upper: Upper bounds of the commanded positions, in the policy's directions, shape (n,)
            [rad].
        kp: Servo stiffness, shape (n,) [N m/rad]; None for the servos of the robot.
        kd: Servo damping, shape (n,) [N m s/rad]; None for the servos of the robot.
        rate: Number of actions per second [Hz].
        latency: Delay from an observation to the command at the servos [s].
        clip: Bound on the magnitude of each element of an observation.
        history: Number of frames in an observation.
        newest_first: True if the newest frame is the first.
        layout: ``by-frame`` or ``by-term``.
        phase_rate: Frequency of the gait phase [Hz], if a phase is observed.
        phase_offsets: Phase of each foot at the start [rad].
        signs: Shape (n,); -1 if the joint of the policy turns in the opposite direction.
        sources: Origin of each stated key: {key: file}.
    """

    terms: tuple[Term, ...]
    joints: tuple[str, ...]
    default: Array = field(metadata={"unit": "rad"})
    action_scale: Array = field(metadata={"unit": "rad"})
    lower: Array = field(metadata={"unit": "rad"})
    upper: Array = field(metadata={"unit": "rad"})
    kp: Array | None = field(metadata={"unit": "N m/rad"})
    kd: Array | None = field(metadata={"unit": "N m s/rad"})
    rate: float = field(metadata={"unit": "Hz"})
    latency: float = field(metadata={"unit": "s"})
    clip: float = field(metadata={"unit": "1"})
    history: int
    newest_first: bool
    layout: str
    phase_rate: float = field(metadata={"unit": "Hz"})
    phase_offsets: Array = field(metadata={"unit": "rad"})
    signs: Array = field(metadata={"unit": "1"})
    sources: Mapping[str, str]

    @property
    def num_joints(self) -> int:
        """Number of joints that the policy commands."""
        return len(self.default)

    def term_size(self, term: Term) -> int:
        """Return the number of elements of a term of the observation."""
        if term.name == "phase":
            return 2 * len(self.phase_offsets)
        return TERM_SIZES[term.name] or self.num_joints

    @property
    def frame_size(self) -> int:
        """Number of elements of the observation at a time step (frame)."""
        return sum(self.term_size(term) for term in self.terms)

    def reorder_joints(self, order: Sequence[int]) -> Contract:
        """Return a contract (definition of observation and action) with permuted robot joints.

        Output i of the policy then drives the joint that output ``order[i]`` has driven. Default
        positions, scales, limits and gains remain with the outputs of the policy, as on a robot
        with exchanged cables.
        """
        return replace(self, joints=tuple(self.joints[index] for index in order))


_KEY_OF_QUANTITY = {
    "default angle": "default",
    "action scale": "action-scale",
    "kp": "kp",
    "kd": "kd",
    "lower limit": "lower",
    "upper limit": "upper",
    "latency": "latency",
}
"""{quantity that a source, such as a policy file, states: key of the contract}. ``rate`` is not
listed: it is the reciprocal of the stated policy step."""


def convert_source_statements(source: Source) -> dict[str, Any]:
    """Convert the statements of a source, such as a policy file, to entries of a policy contract.

    A policy contract defines the observation and the action of a policy: joint order, gains, scales
    and rates. The result is {key: value}, with the keys and units of the contract's TOML file.
    """
    values: dict[str, Any] = {}
    for statement in source.statements:
        value = (
            math.nan if statement.value is None else statement.value
        )  # NaN is refused later, with its key
        if statement.quantity == "policy step":
            values["rate"] = 1.0 / value if value > 0 else math.nan
        elif (key := _KEY_OF_QUANTITY.get(statement.quantity)) and (
            statement.index is None or statement.count == 1
        ):
            values[key] = value
        elif key:
            values.setdefault(key, []).append(value)
    if source.order:
        values["joints"] = list(source.order)
    if source.observations:
        values["observation"] = [
            name.strip() if scale is None else {"term": name.strip(), "scale": scale}
            for name, scale, _ in source.observations
        ]
    return values


def make_rtneural_values(values: Mapping[str, Any], inputs: int, outputs: int) -> dict[str, Any]:
    """Return {contract key: value} that Pupper's neural_controller implies for an RTNeural JSON.

    The observation of a time step (frame) is that of ``neural_controller.cpp``: angular velocity,
    gravity, command, commanded up direction in the base frame, joint positions, last action. With
    twelve joints these are 36 elements, or 33 without the up direction. The newest frame is the
    first; elements are clipped at 100; there is an action every 20 ms.

    Args:
        values: Content of the JSON. The result is empty if it has no ``observation_history``.
        inputs: Number of inputs of the network.
        outputs: Number of outputs of the network.
    """
    if "observation_history" not in values:
        return {}
    history = values["observation_history"]
    frame = inputs // history if isinstance(history, int) and history > 0 else 0
    terms = ["angular-velocity", "gravity", "command", "up-command"]
    if frame == 9 + 2 * outputs:
        terms.pop()
    observation = [*terms, "joint-positions", "last-action"]
    layout = {"newest-first": True, "layout": BY_FRAME, "clip": 100.0, "rate": 50.0}
    return {"history": history, "observation": observation, **layout}


_CONTRACT_KEYS = (
    "observation", "joints", "default", "action-scale", "lower", "upper", "kp", "kd", "rate",
    "latency", "clip", "history", "newest-first", "layout", "phase-rate", "phase-offsets", "signs",
)  # fmt: skip
"""Valid contract keys."""


@dataclass(frozen=True)
class _MergedValues:
    """Contract keys of several files, merged; each value is checked when read."""

    values: Mapping[str, Any]
    origins: Mapping[str, str]
    path: Path
    joints: int

    def vector(self, key: str, fallback: float | None, size: int | None = None) -> Array | None:
        """Return the vector of a contract key, shape (size,), from one number or `size` numbers.

        None if the key is missing and `fallback` is None.

        Raises:
            ModelError: If the value is no such number or list, or an element is not finite (limits
                may be infinite).
        """
        value = self.values.get(key, fallback)
        if value is None:
            return None
        size = self.joints if size is None else size
        try:
            vector: Array = np.broadcast_to(real_array(key, value), (size,)).copy()
        except (ConfigurationError, ValueError) as error:
            raise self.make_error(key, diagnose("no-numbers", count=size)) from error
        finite = np.isfinite(vector) | (np.isinf(vector) if key in ("lower", "upper") else False)
        if not finite.all():
            raise self.make_error(key, diagnose("no-numbers", count=size))
        return vector

    def number(self, key: str, fallback: float | None, low: float, high: float) -> float:
        """Return the value of a key of the policy's contract as a number from `low` to `high`.

        `fallback` replaces a missing key.

        Raises:
            ModelError: If the key is missing and `fallback` is None, or the value is not valid.
        """
        value = self.values.get(key, fallback)
        if value is None:
            raise self.make_error(key, diagnose("contract-lacks", key=key))
        good = isinstance(value, int | float) and not isinstance(value, bool)
        if not good or not low <= value <= high:
            raise self.make_error(
                key, diagnose("not-between", given=str(value), low=low, high=high)
            )
        return float(value)

    def make_error(self, key: str, problem: Diagnostic) -> ModelError:
        """Return the error for a contract key, with the file that states it, or the policy file."""
        problem = diagnose("contract-key", key=key, problem=problem)
        return ModelError(self.origins.get(key.partition(":")[0], str(self.path)), problem)


def make_contract(
    path: Path, statements: Sequence[tuple[str, Mapping[str, Any]]], inputs: int, outputs: int
) -> Contract:
    """Merge the statements of several files into a contract.

    Args:
        path: File of the policy.
        statements: (file, contract keys) of each file; the last file has precedence.
        inputs: Number of inputs of the network.
        outputs: Number of outputs of the network.

    Raises:
        ModelError: If a key is unknown, missing or not valid, or a size does not fit the network.
    """
    values: dict[str, Any] = {}
    origins: dict[str, str] = {}
    for origin, values_of_origin in statements:
        for key in values_of_origin:
            if key not in _CONTRACT_KEYS:
                problem = diagnose("contract-key-unknown", key=key, known=_CONTRACT_KEYS)
                raise ModelError(origin, problem)
            origins[key] = origin
        values |= values_of_origin
    merged = _MergedValues(values, origins, path, outputs)
    terms = _read_terms(merged)
    joints = values.get("joints", ())
    is_list = isinstance(joints, Sequence) and not isinstance(joints, str)
    if not is_list or not all(isinstance(joint, str) for joint in joints):
        raise merged.make_error(
            "joints", diagnose("contract-joints", count=outputs, given=str(joints))
        )
    if joints and (len(joints) != outputs or len(set(joints)) != outputs):
        problem = diagnose("contract-joints", count=outputs, given=len(set(joints)))
        raise merged.make_error("joints", problem)
    layout = values.get("layout", BY_TERM)
    if layout not in (BY_FRAME, BY_TERM):
        problem = diagnose("contract-value", given=str(layout), known=(BY_FRAME, BY_TERM))
        raise merged.make_error("layout", problem)
    phases = values.get("phase-offsets", ())
    offsets = merged.vector("phase-offsets", 0.0, len(phases) if isinstance(phases, list) else 1)
    scale = merged.vector("action-scale", None)
    default = merged.vector("default", None)
    if scale is None or default is None:
        key = "action-scale" if scale is None else "default"
        raise merged.make_error(key, diagnose("contract-lacks", key=key))
    lower, upper = merged.vector("lower", -math.inf), merged.vector("upper", math.inf)
    signs = merged.vector("signs", 1.0)
    assert lower is not None
    assert upper is not None
    assert signs is not None
    assert offsets is not None
    if (crossed := np.flatnonzero(lower > upper)).size:
        low, high = float(lower[crossed[0]]), float(upper[crossed[0]])
        raise merged.make_error(
            "lower", diagnose("not-between", given=low, low=-math.inf, high=high)
        )
    history, newest_first = _read_history(merged)
    if (np.abs(signs) != 1).any():
        raise merged.make_error(
            "signs", diagnose("contract-value", given=str(signs), known=("-1", "1"))
        )
    contract = Contract(
        terms=terms,
        joints=tuple(joints),
        default=default,
        action_scale=scale,
        lower=lower,
        upper=upper,
        kp=merged.vector("kp", None),
        kd=merged.vector("kd", None),
        rate=merged.number("rate", None, 1.0, 1000.0),
        latency=merged.number("latency", 0.0, 0.0, 1.0),
        clip=merged.number("clip", math.inf, 1e-3, math.inf),
        history=history,
        newest_first=newest_first,
        layout=layout,
        phase_rate=merged.number("phase-rate", 0.0, 0.0, 20.0),
        phase_offsets=offsets,
        signs=signs,
        sources=origins,
    )
    for term in terms:
        size = np.size(term.scale)
        if size not in (1, contract.term_size(term)):
            problem = diagnose("no-numbers", count=contract.term_size(term))
            raise merged.make_error(f"observation: {term.name}", problem)
    if contract.frame_size * contract.history != inputs:
        parts = ", ".join(f"{term.name} {contract.term_size(term)}" for term in terms)
        problem = diagnose(
            "observation-size",
            parts=parts,
            history=contract.history,
            total=contract.frame_size * contract.history,
            inputs=inputs,
        )
        raise ModelError(path, problem)
    return contract


def _read_history(merged: _MergedValues) -> tuple[int, bool]:
    """Return the number of frames of an observation, and True if the newest frame is the first."""
    history = merged.number("history", 1, 1, 1000)
    if history % 1:
        raise merged.make_error("history", diagnose("whole-number-needed", given=str(history)))
    newest_first = merged.values.get("newest-first", False)
    if not isinstance(newest_first, bool):
        problem = diagnose("contract-value", given=str(newest_first), known=("true", "false"))
        raise merged.make_error("newest-first", problem)
    return int(history), newest_first


def _read_terms(merged: _MergedValues) -> tuple[Term, ...]:
    """Return the terms of an observation; each entry is a name, or a table of name and scale."""
    entries = merged.values.get("observation")
    if not isinstance(entries, list) or not entries:
        raise merged.make_error("observation", diagnose("contract-lacks", key="observation"))
    terms = []
    for entry in entries:
        name = entry.get("term") if isinstance(entry, dict) else entry
        name = _TERM_ALIASES.get(name, name) if isinstance(name, str) else str(name)
        if name not in TERM_SIZES:
            problem = diagnose("contract-value", given=name, known=tuple(TERM_SIZES))
            raise merged.make_error("observation", problem)
        scale = entry.get("scale", 1.0) if isinstance(entry, dict) else 1.0
        try:
            numbers = real_array("scale", scale)
        except ConfigurationError as error:
            raise merged.make_error(
                f"observation: {name}", diagnose("no-numbers", count=1)
            ) from error
        if numbers.ndim > 1 or not np.isfinite(numbers).all():
            raise merged.make_error(f"observation: {name}", diagnose("no-numbers", count=1))
        terms.append(Term(name, numbers if numbers.ndim else float(numbers)))
    return tuple(terms)
