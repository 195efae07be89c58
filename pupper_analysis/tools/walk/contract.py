"""What a policy and its robot agree on: what it observes, and what its actions mean."""

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
"""{term: its size; None where that is the number of joints, or of phases twice}.

Velocities and the direction of gravity are those of the base in its own frame,
joint positions are less the default ones, the up-command is where the vertical is to be in the
base's frame, the phase cosines and then sines of the feet's phases.
"""

_ALIKE = {
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
"""What Isaac Lab, mjlab and Unitree's environments call them."""

BY_FRAME, BY_TERM = "by-frame", "by-term"
"""How a history is laid out: frame after frame, or the frames of a term together."""


@dataclass(frozen=True, eq=False)
class Term:
    """A part of an observation.

    Attributes:
        name: Of ``TERMS``.
        scale: By what it is multiplied: one number, or one for each of its elements.
    """

    name: str
    scale: Array | float = field(default=1.0, metadata={"unit": "1"})


@dataclass(frozen=True, eq=False)
class Contract:
    """What a policy observes, and what its actions mean.

    Attributes:
        terms: Of one frame of the observation, in their order.
        joints: In the policy's order; empty where its file names none: the robot's actuators then.
        default: (n,) joint positions that an action of zero commands (rad).
        action_scale: (n,) rad for an action of 1.
        lower: (n,) least commanded position (rad).
        upper: (n,) greatest commanded position (rad).
        kp: (n,) the servos' stiffness (N m/rad); None: the robot's own servos.
        kd: (n,) the servos' damping (N m s/rad); likewise.
        rate: How often it is asked (Hz).
        latency: From an observation to its command at the servos (s).
        clip: Each element of an observation is cut off at this.
        history: How many frames an observation has.
        newest_first: Whether the newest of these is the first.
        layout: ``by-frame`` or ``by-term``.
        phase_rate: Of the gait's phase (Hz), where one is observed.
        phase_offsets: Of the feet (rad).
        signs: (n,) -1 where a joint of the policy turns the other way than the robot's.
        sources: Where each of these is from: {field: what stated it}.
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
        """How many joints it commands."""
        return len(self.default)

    def term_size(self, term: Term) -> int:
        """Returns how many numbers a term has."""
        if term.name == "phase":
            return 2 * len(self.phase_offsets)
        return TERM_SIZES[term.name] or self.num_joints

    @property
    def frame_size(self) -> int:
        """How many numbers a frame has."""
        return sum(self.term_size(term) for term in self.terms)

    def reorder_joints(self, order: Sequence[int]) -> Contract:
        """Returns the contract of a policy whose joint i is taken for that joint ``order[i]`` is.

        Defaults, scales, limits and gains stay with the policy's outputs, as they do on a robot
        that is wired so.
        """
        return replace(self, joints=tuple(self.joints[index] for index in order))


_STATED = {
    "default angle": "default",
    "action scale": "action-scale",
    "kp": "kp",
    "kd": "kd",
    "lower limit": "lower",
    "upper limit": "upper",
    "latency": "latency",
}
"""{quantity of a source's statements: the key}; a policy's step is ``rate``."""


def convert_source_statements(source: Source) -> dict[str, Any]:
    """Returns what a policy's file states, as a TOML would: what ``contract`` compares."""
    found: dict[str, Any] = {}
    for one in source.statements:
        value = math.nan if one.value is None else one.value  # which is refused by its key
        if one.quantity == "policy step":
            found["rate"] = 1.0 / value if value > 0 else math.nan
        elif (key := _STATED.get(one.quantity)) and (one.index is None or one.count == 1):
            found[key] = value
        elif key:
            found.setdefault(key, []).append(value)
    if source.order:
        found["joints"] = list(source.order)
    if source.observations:
        found["observation"] = [name.strip() for name, _, _ in source.observations]
    return found


def make_rtneural_values(values: Mapping[str, Any], inputs: int, outputs: int) -> dict[str, Any]:
    """Returns what Pupper's neural_controller makes of an RTNeural JSON's observations.

    Its frame of 36 (33 without a commanded orientation) is that of
    ``neural_controller.cpp``: angular velocity, gravity, command, the commanded vertical, joint
    positions, last action; the newest frame first; clipped at 100; one action each 20 ms.
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


_KEYS = (
    "observation", "joints", "default", "action-scale", "lower", "upper", "kp", "kd", "rate",
    "latency", "clip", "history", "newest-first", "layout", "phase-rate", "phase-offsets", "signs",
)  # fmt: skip


@dataclass(frozen=True)
class _Stated:
    """What files state together; each key is checked as it is read."""

    values: Mapping[str, Any]
    homes: Mapping[str, str]
    path: Path
    joints: int

    def vector(self, key: str, fallback: float | None, size: int | None = None) -> Array | None:
        """Returns (size,) numbers, of one or as many; None where nothing states them."""
        value = self.values.get(key, fallback)
        if value is None:
            return None
        size = self.joints if size is None else size
        try:
            found: Array = np.broadcast_to(real_array(key, value), (size,)).copy()
        except (ConfigurationError, ValueError) as error:
            raise self.refuse(key, diagnose("no-numbers", count=size)) from error
        finite = np.isfinite(found) | (np.isinf(found) if key in ("lower", "upper") else False)
        if not finite.all():
            raise self.refuse(key, diagnose("no-numbers", count=size))
        return found

    def number(self, key: str, fallback: float | None, low: float, high: float) -> float:
        """Returns a number within bounds, the lower one excluded where it is zero by name."""
        value = self.values.get(key, fallback)
        if value is None:
            raise self.refuse(key, diagnose("contract-lacks", key=key))
        good = isinstance(value, int | float) and not isinstance(value, bool)
        if not good or not low <= value <= high:
            raise self.refuse(key, diagnose("not-between", given=str(value), low=low, high=high))
        return float(value)

    def refuse(self, key: str, problem: Diagnostic) -> ModelError:
        """Returns the error that names a key, and the file that states it."""
        problem = diagnose("contract-key", key=key, problem=problem)
        return ModelError(self.homes.get(key.partition(":")[0], str(self.path)), problem)


def make_contract(
    path: Path, stated: Sequence[tuple[str, Mapping[str, Any]]], inputs: int, outputs: int
) -> Contract:
    """Returns the contract that some files state together.

    Args:
        path: The policy's file.
        stated: (name, what it states) of each, the last of which counts.
        inputs: The network's.
        outputs: The network's.

    Raises:
        ModelError: If something is missing, of another size than the network, or no key.
    """
    values: dict[str, Any] = {}
    homes: dict[str, str] = {}
    for home, own in stated:
        for key in own:
            if key not in _KEYS:
                problem = diagnose("contract-key-unknown", key=key, known=_KEYS)
                raise ModelError(home, problem)
            homes[key] = home
        values |= own
    given = _Stated(values, homes, path, outputs)
    terms = _terms(given)
    joints = values.get("joints", ())
    named = isinstance(joints, Sequence) and not isinstance(joints, str)
    if not named or not all(isinstance(one, str) for one in joints):
        raise given.refuse("joints", diagnose("contract-joints", count=outputs, given=str(joints)))
    if joints and (len(joints) != outputs or len(set(joints)) != outputs):
        problem = diagnose("contract-joints", count=outputs, given=len(set(joints)))
        raise given.refuse("joints", problem)
    layout = values.get("layout", BY_TERM)
    if layout not in (BY_FRAME, BY_TERM):
        problem = diagnose("contract-value", given=str(layout), known=(BY_FRAME, BY_TERM))
        raise given.refuse("layout", problem)
    phases = values.get("phase-offsets", ())
    offsets = given.vector("phase-offsets", 0.0, len(phases) if isinstance(phases, list) else 1)
    scale = given.vector("action-scale", None)
    default = given.vector("default", None)
    if scale is None or default is None:
        key = "action-scale" if scale is None else "default"
        raise given.refuse(key, diagnose("contract-lacks", key=key))
    lower, upper = given.vector("lower", -math.inf), given.vector("upper", math.inf)
    signs = given.vector("signs", 1.0)
    assert lower is not None
    assert upper is not None
    assert signs is not None
    assert offsets is not None
    if (crossed := np.flatnonzero(lower > upper)).size:
        low, high = float(lower[crossed[0]]), float(upper[crossed[0]])
        raise given.refuse("lower", diagnose("not-between", given=low, low=-math.inf, high=high))
    history, newest = _memory(given)
    if (np.abs(signs) != 1).any():
        raise given.refuse("signs", diagnose("contract-value", given=str(signs), known=("-1", "1")))
    found = Contract(
        terms=terms,
        joints=tuple(joints),
        default=default,
        action_scale=scale,
        lower=lower,
        upper=upper,
        kp=given.vector("kp", None),
        kd=given.vector("kd", None),
        rate=given.number("rate", None, 1.0, 1000.0),
        latency=given.number("latency", 0.0, 0.0, 1.0),
        clip=given.number("clip", math.inf, 1e-3, math.inf),
        history=history,
        newest_first=newest,
        layout=layout,
        phase_rate=given.number("phase-rate", 0.0, 0.0, 20.0),
        phase_offsets=offsets,
        signs=signs,
        sources=homes,
    )
    for term in terms:
        size = np.size(term.scale)
        if size not in (1, found.term_size(term)):
            problem = diagnose("no-numbers", count=found.term_size(term))
            raise given.refuse(f"observation: {term.name}", problem)
    if found.frame_size * found.history != inputs:
        parts = ", ".join(f"{term.name} {found.term_size(term)}" for term in terms)
        problem = diagnose(
            "observation-size",
            parts=parts,
            history=found.history,
            total=found.frame_size * found.history,
            inputs=inputs,
        )
        raise ModelError(path, problem)
    return found


def _memory(given: _Stated) -> tuple[int, bool]:
    """Returns how many frames an observation has, and whether the newest is the first."""
    history = given.number("history", 1, 1, 1000)
    if history % 1:
        raise given.refuse("history", diagnose("whole-number-needed", given=str(history)))
    newest = given.values.get("newest-first", False)
    if not isinstance(newest, bool):
        problem = diagnose("contract-value", given=str(newest), known=("true", "false"))
        raise given.refuse("newest-first", problem)
    return int(history), newest


def _terms(given: _Stated) -> tuple[Term, ...]:
    """Returns the terms of an observation, each a name, or a table of its name and scale."""
    listed = given.values.get("observation")
    if not isinstance(listed, list) or not listed:
        raise given.refuse("observation", diagnose("contract-lacks", key="observation"))
    terms = []
    for one in listed:
        name = one.get("term") if isinstance(one, dict) else one
        name = _ALIKE.get(name, name) if isinstance(name, str) else str(name)
        if name not in TERM_SIZES:
            problem = diagnose("contract-value", given=name, known=tuple(TERM_SIZES))
            raise given.refuse("observation", problem)
        scale = one.get("scale", 1.0) if isinstance(one, dict) else 1.0
        try:
            numbers = real_array("scale", scale)
        except ConfigurationError as error:
            raise given.refuse(f"observation: {name}", diagnose("no-numbers", count=1)) from error
        if numbers.ndim > 1 or not np.isfinite(numbers).all():
            raise given.refuse(f"observation: {name}", diagnose("no-numbers", count=1))
        terms.append(Term(name, numbers if numbers.ndim else float(numbers)))
    return tuple(terms)
