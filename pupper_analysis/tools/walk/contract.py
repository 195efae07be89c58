"""Policy contract: the observation of a policy, and the meaning of the actions for a robot.

Inputs are statements {contract key: value} of the policy file, of a deployment and of a TOML file.
`make_contract` merges the statements, checks the sizes against the network, and returns a
`PolicyContract`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from pupper_analysis.base.arguments import real_array
from pupper_analysis.base.array_types import Array
from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.errors import ConfigurationError, ModelError
from pupper_analysis.tools.contract.deployment import Deployment
from pupper_analysis.tools.contract.facts import (
    OBSERVATION_ALIASES,
    JointSource,
    ObservedTerm,
    Origin,
)

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
    "command-velocity": 2,
    "command-turning": 1,
    "phase-sine": None,
    "phase-cosine": None,
    "second-last-action": None,
    "accelerometer": 3,
    "contacts": None,
}
"""{term of a policy's observation: number of elements}. None if the size depends on the number of
joints, phases or feet. The velocities of the base and the direction of gravity are expressed in the
base frame. Joint positions are relative to the default positions. The up-command is the commanded
vertical in the base frame. The phase contains the cosines of all phases, followed by the sines.
``phase-sine`` and ``phase-cosine`` are parts of the phase. ``command-velocity`` and
``command-turning`` are parts of the command. The accelerometer measures acceleration minus gravity
at the origin of the base, in the base frame. Contacts are 1 for each foot that touches anything,
otherwise 0, in the order of the robot's feet.
"""

_TERM_ALIASES = {
    "base_lin_vel": "linear-velocity",
    "base_ang_vel": "angular-velocity",
    "projected_gravity": "gravity",
    "commands": "command",
    "joint_pos": "joint-positions",
    "joint_vel": "joint-velocities",
    "actions": "last-action",
    "gait_phase": "phase",
    "command_lin_vel": "command-velocity",
    "command_ang_vel": "command-turning",
    "sin_phase": "phase-sine",
    "cos_phase": "phase-cosine",
    "dof_pos": "joint-positions",
    "dof_vel": "joint-velocities",
    "last_last_action": "second-last-action",
    "last_last_act": "second-last-action",
    "feet_contacts": "contacts",
}
"""{name of a term in training libraries, such as Isaac Lab, mjlab and Unitree's environments: term
of `TERM_SIZES`}.
"""


def find_term_name(name: str) -> str:
    """Return this package's name of an observation term, for example ``gravity``.

    Args:
        name: Name of the term in a training library, for example ``projected_gravity``. A name
            without an alias is returned unchanged.
    """
    common = OBSERVATION_ALIASES.get(name, name)
    return _TERM_ALIASES.get(common, name)


BY_FRAME, BY_TERM = "by-frame", "by-term"
"""Layouts of an observation with several frames (time steps). ``by-frame``: all terms of a frame,
then all terms of the next frame. ``by-term``: all frames of a term, then all frames of the next
term.
"""


@dataclass(frozen=True, eq=False)
class ObservationTerm:
    """Term of a policy's observation, such as joint positions, with scale, bounds and history.

    Attributes:
        name: A key of `TERM_SIZES`.
        scale: Factor on the elements: a scalar, or a factor per element.
        clip: Lower and upper bound of the elements before scaling.
        history: Number of frames (time steps) of the term; 0 selects `PolicyContract.history`.
    """

    name: str
    scale: Array | float = field(default=1.0, metadata={"unit": "1"})
    clip: tuple[float, float] = field(default=(-math.inf, math.inf), metadata={"unit": "varies"})
    history: int = 0


@dataclass(frozen=True, eq=False)
class PolicyContract:
    """Definition of a policy's observation and actions, for n commanded joints.

    Attributes:
        terms: Terms of a frame of the observation, in order.
        joints: Joint names in the order of the policy. Empty if the file states no names: the
            policy then uses the order of the robot's actuators.
        default: Reference of the observed joint positions, in the directions of the policy's joints
            (`signs`), shape (n,) [rad]. The reference is subtracted from the positions.
        offset: Joint positions for an action of zero, shape (n,) [rad]; None for ``default``.
        action_scale: Joint displacement for an action of 1, shape (n,) [rad].
        lower: Lower bounds of the commanded positions, in the policy's directions, shape (n,)
            [rad].
        upper: Upper bounds of the commanded positions, in the policy's directions, shape (n,)
            [rad].
        kp: Servo stiffness, shape (n,) [N m/rad]; None for the servos of the robot.
        kd: Servo damping, shape (n,) [N m s/rad]; None for the servos of the robot.
        effort: Torque limits at the joints, shape (n,) [N m]; None for the limits of the robot's
            files.
        rate: Number of actions per second [Hz].
        latency: Delay from an observation to the command at the servos [s].
        clip: Bound on the magnitude of each element of an observation.
        action_clip: Bound on the magnitude of each element of an action.
        history: Number of frames (time steps) of each term whose `ObservationTerm.history` is 0.
        newest_first: True if the newest frame is the first.
        layout: ``by-frame`` or ``by-term``.
        phase_rate: Frequency of the gait phase [Hz], if a phase is observed.
        phase_offsets: Phases at the start, shape (phases,) [rad], for example a phase per foot.
        signs: Direction of each joint of the policy relative to the robot's joint, 1 or -1, shape
            (n,).
        feet: Number of feet whose contacts are observed, from the size of the observation; 0
            without contacts.
        sources: Source of each key: {key: file, with the line if known; or framework, or
            ``--effort``}; "" if no source states the key.
        origins: Origin of each key: {key: ``stated``, ``default`` of a framework, ``derived``,
            ``assumed`` or ``unknown``}.
    """

    terms: tuple[ObservationTerm, ...]
    joints: tuple[str, ...]
    default: Array = field(metadata={"unit": "rad"})
    offset: Array | None = field(metadata={"unit": "rad"})
    action_scale: Array = field(metadata={"unit": "rad"})
    lower: Array = field(metadata={"unit": "rad"})
    upper: Array = field(metadata={"unit": "rad"})
    kp: Array | None = field(metadata={"unit": "N m/rad"})
    kd: Array | None = field(metadata={"unit": "N m s/rad"})
    effort: Array | None = field(metadata={"unit": "N m"})
    rate: float = field(metadata={"unit": "Hz"})
    latency: float = field(metadata={"unit": "s"})
    clip: float = field(metadata={"unit": "1"})
    action_clip: float = field(metadata={"unit": "1"})
    history: int
    newest_first: bool
    layout: str
    phase_rate: float = field(metadata={"unit": "Hz"})
    phase_offsets: Array = field(metadata={"unit": "rad"})
    signs: Array = field(metadata={"unit": "1"})
    feet: int
    sources: Mapping[str, str]
    origins: Mapping[str, str]

    @property
    def num_joints(self) -> int:
        """Number of joints that the policy commands."""
        return len(self.default)

    def term_size(self, term: ObservationTerm) -> int:
        """Return the number of elements of a term of the observation."""
        if term.name.startswith("phase"):
            return (2 if term.name == "phase" else 1) * len(self.phase_offsets)
        if term.name == "contacts":
            return self.feet
        return TERM_SIZES[term.name] or self.num_joints

    @property
    def frame_size(self) -> int:
        """Number of elements of the observation at a time step (frame)."""
        return sum(self.term_size(term) for term in self.terms)

    def count_frames(self, term: ObservationTerm) -> int:
        """Return the number of time steps (frames) of a term that an observation contains."""
        return term.history or self.history

    @property
    def max_history(self) -> int:
        """Largest number of frames (time steps) of a term in an observation."""
        return max(map(self.count_frames, self.terms))

    @property
    def has_one_history(self) -> bool:
        """Whether all terms have the same number of frames."""
        return len(set(map(self.count_frames, self.terms))) == 1

    @property
    def observation_size(self) -> int:
        """Number of elements of an observation with all frames of all terms."""
        return sum(self.term_size(term) * self.count_frames(term) for term in self.terms)

    def reorder_joints(self, order: Sequence[int]) -> PolicyContract:
        """Return a copy of the contract in which the outputs drive permuted robot joints.

        Output i of the policy drives the joint that output ``order[i]`` drove before. Default
        positions, scales, limits and gains are not permuted, since these values belong to the
        outputs of the policy. The result corresponds to a robot with exchanged cables. The contract
        must name the joints.
        """
        return replace(self, joints=tuple(self.joints[index] for index in order))


_KEY_OF_QUANTITY = {
    "default angle": "default",
    "action scale": "action-scale",
    "kp": "kp",
    "kd": "kd",
    "effort": "effort",
    "action clip": "action-clip",
    "observation clip": "clip",
    "lower limit": "lower",
    "upper limit": "upper",
    "latency": "latency",
}
"""{quantity in a policy file or other source: key in the TOML file of a policy contract}. The key
``rate`` [Hz] is not listed, since it is the reciprocal of the quantity ``policy step`` [s].
"""


def convert_source_statements(source: JointSource) -> dict[str, Any]:
    """Convert the statements of a source, such as a policy file, to entries of a policy contract.

    The result is {key: value}, with the keys and units of the contract's TOML file.
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
            term.name if term.scales is None else {"term": term.name, "scale": term.scale}
            for term in source.observations
        ]
    return values


def make_rtneural_values(values: Mapping[str, Any], inputs: int, outputs: int) -> dict[str, Any]:
    """Return the contract that Pupper's neural_controller implies for an RTNeural JSON.

    The observation follows ``neural_controller.cpp``: angular velocity, gravity, command, commanded
    up direction (not in frames of 9 + 2 ``outputs`` elements), joint positions, last action.

    Args:
        values: Content of the JSON. The result is empty if ``values`` has no
            ``observation_history``.
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
    "effort", "action-offset", "action-clip",
)  # fmt: skip
"""Valid keys of a policy contract, as in the TOML file beside the policy. Other keys are refused.
"""


@dataclass(frozen=True)
class _MergedValues:
    """Keys of a policy contract, merged from several files; each value is checked when read.

    Attributes:
        values: {key: value as in the file}.
        places: {key: file, with the line if known}.
        path: File of the policy.
        joints: Number of joints that the policy commands.
    """

    values: Mapping[str, Any]
    places: Mapping[str, str]
    path: Path
    joints: int

    def vector(self, key: str, fallback: float | None, size: int | None = None) -> Array | None:
        """Return the value of a contract key as a vector, shape (size,); None for a missing key.

        `fallback`, if any, replaces a missing key. The default of `size` is the number of joints.

        Raises:
            ModelError: If the value is neither a number nor a list of one or `size` numbers, for
                example.
        """
        value = self.values.get(key, fallback)
        if value is None:
            return None
        size = self.joints if size is None else size
        try:
            vector: Array = np.broadcast_to(real_array(key, value), (size,)).copy()
        except (ConfigurationError, ValueError) as error:
            raise self.make_error(key, diagnose("no-numbers", count=size)) from error
        may_be_infinite = key in ("lower", "upper", "effort")
        finite = np.isfinite(vector) | (np.isinf(vector) if may_be_infinite else False)
        if not finite.all():
            raise self.make_error(key, diagnose("no-numbers", count=size))
        return vector

    def number(self, key: str, fallback: float | None, low: float, high: float) -> float:
        """Return the value of a key of the policy's contract as a number from `low` to `high`.

        Raises:
            ModelError: If the key is missing and `fallback` is None, or the value is no number or
                out of range.
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
        return ModelError(self.places.get(key.partition(":")[0]) or str(self.path), problem)


@dataclass(frozen=True)
class Statements:
    """Contract keys and values that a source states, with the origin of each value.

    Attributes:
        file: Source file or files, as named in messages.
        values: {key: value}.
        places: {key: file and line}; ``file`` for keys that are not listed.
        origins: {key: origin}; ``stated`` for keys that are not listed.
    """

    file: str
    values: Mapping[str, Any]
    places: Mapping[str, str] = field(default_factory=dict)
    origins: Mapping[str, str] = field(default_factory=dict)


def make_contract(
    path: Path, statements: Sequence[Statements], inputs: int, outputs: int
) -> PolicyContract:
    """Merge the contract keys of several sources into a checked `PolicyContract`.

    The last source in ``statements`` has precedence. ``inputs`` and ``outputs`` are the sizes of
    the network.

    Raises:
        ModelError: If a key is unknown or missing, or a size does not fit the network, for example.
    """
    values, places, origins = _merge_statements(statements)
    merged = _MergedValues(values, places, path, outputs)
    terms = _read_terms(merged)
    joints = _read_joints(merged)
    layout = values.get("layout", BY_TERM)
    if layout not in (BY_FRAME, BY_TERM):
        problem = diagnose("contract-value", given=str(layout), known=(BY_FRAME, BY_TERM))
        raise merged.make_error("layout", problem)
    phases = values.get("phase-offsets", ())
    num_phases = len(phases) if isinstance(phases, list) else 1
    offsets = _require_vector(merged, "phase-offsets", 0.0, num_phases)
    scale = _require_vector(merged, "action-scale", None)
    default = _require_vector(merged, "default", None)
    lower = _require_vector(merged, "lower", -math.inf)
    upper = _require_vector(merged, "upper", math.inf)
    signs = _require_vector(merged, "signs", 1.0)
    offset = merged.vector("action-offset", None)
    effort = merged.vector("effort", None)
    for key in _CONTRACT_KEYS:
        if key not in places:
            places[key], origins[key] = "", str(_UNSTATED_ORIGINS.get(key, Origin.UNKNOWN))
    _check_ranges(merged, lower, upper, effort, signs)
    history, newest_first = _read_history(merged)
    contract = PolicyContract(
        terms=terms,
        joints=tuple(joints),
        default=default,
        offset=offset,
        action_scale=scale,
        lower=lower,
        upper=upper,
        kp=merged.vector("kp", None),
        kd=merged.vector("kd", None),
        effort=effort,
        rate=merged.number("rate", None, 1.0, 1000.0),
        latency=merged.number("latency", 0.0, 0.0, 1.0),
        clip=merged.number("clip", math.inf, 1e-3, math.inf),
        action_clip=merged.number("action-clip", math.inf, 1e-3, math.inf),
        history=history,
        newest_first=newest_first,
        layout=layout,
        phase_rate=merged.number("phase-rate", 0.0, 0.0, 20.0),
        phase_offsets=offsets,
        signs=signs,
        feet=0,
        sources=places,
        origins=origins,
    )
    contract = _set_number_of_feet(contract, inputs)
    _check_scales(merged, contract)
    _check_observation(merged, contract, inputs)
    return contract


def _merge_statements(
    statements: Sequence[Statements],
) -> tuple[dict[str, Any], dict[str, str], dict[str, str]]:
    """Merge the keys of several files, of which the last has precedence.

    Returns:
        {key: value}; {key: file, or file with the place of the value}; {key: origin of the value}.
    """
    values: dict[str, Any] = {}
    places: dict[str, str] = {}
    origins: dict[str, str] = {}
    for stated in statements:
        for key in stated.values:
            if key not in _CONTRACT_KEYS:
                problem = diagnose("contract-key-unknown", key=key, known=_CONTRACT_KEYS)
                raise ModelError(stated.file, problem)
            places[key] = stated.places.get(key, stated.file)
            origins[key] = stated.origins.get(key, str(Origin.STATED))
        values |= stated.values
    return values, places, origins


def _require_vector(
    merged: _MergedValues, key: str, default: float | None, size: int | None = None
) -> Array:
    """Return the vector of a contract key (`_MergedValues.vector`).

    A missing key without ``default`` is refused.
    """
    vector = merged.vector(key, default, size)
    if vector is None:
        raise merged.make_error(key, diagnose("contract-lacks", key=key))
    return vector


def _check_scales(merged: _MergedValues, contract: PolicyContract) -> None:
    """Raise a ModelError if the scale of a term has neither 1 element nor the size of the term."""
    for term in contract.terms:
        size = contract.term_size(term)
        if np.size(term.scale) not in (1, size):
            problem = diagnose("no-numbers", count=size)
            raise merged.make_error(f"observation: {term.name}", problem)


def _set_number_of_feet(contract: PolicyContract, inputs: int) -> PolicyContract:
    """Return a contract whose number of observed feet is derived from the network's ``inputs``."""
    contacts = [term for term in contract.terms if term.name == "contacts"]
    if not contacts:
        return contract
    rest = inputs - contract.observation_size
    return replace(contract, feet=max(1, rest // sum(map(contract.count_frames, contacts))))


def _check_observation(merged: _MergedValues, contract: PolicyContract, inputs: int) -> None:
    """Check the layout of the observation, and compare the size with the network's ``inputs``."""
    if contract.layout == BY_FRAME and not contract.has_one_history:
        found = sorted(set(map(contract.count_frames, contract.terms)))
        raise merged.make_error("layout", diagnose("histories-differ", found=found))
    if contract.observation_size != inputs:
        is_uniform = contract.has_one_history
        parts = ", ".join(
            f"{term.name} {contract.term_size(term)}"
            + ("" if is_uniform else f" x {contract.count_frames(term)}")
            for term in contract.terms
        )
        problem = diagnose(
            "observation-size",
            parts=parts,
            history=contract.max_history if is_uniform else None,
            total=contract.observation_size,
            inputs=inputs,
        )
        raise ModelError(merged.path, problem)


def _check_ranges(
    merged: _MergedValues, lower: Array, upper: Array, effort: Array | None, signs: Array
) -> None:
    """Check position limits, torque limits and signs of a policy contract, shape (n,) each."""
    if (crossed := np.flatnonzero(lower > upper)).size:
        low, high = float(lower[crossed[0]]), float(upper[crossed[0]])
        raise merged.make_error(
            "lower", diagnose("not-between", given=low, low=-math.inf, high=high)
        )
    if effort is not None and (effort <= 0).any():
        problem = diagnose("not-between", given=float(effort.min()), low=0.0, high=math.inf)
        raise merged.make_error("effort", problem)
    if (np.abs(signs) != 1).any():
        raise merged.make_error(
            "signs", diagnose("contract-value", given=str(signs), known=("-1", "1"))
        )


def _read_joints(merged: _MergedValues) -> tuple[str, ...]:
    """Return the joint names in the order of the policy; empty if no file states names."""
    joints = merged.values.get("joints", ())
    is_list = isinstance(joints, Sequence) and not isinstance(joints, str)
    if not is_list or not all(isinstance(joint, str) for joint in joints):
        raise merged.make_error(
            "joints", diagnose("contract-joints", count=merged.joints, given=str(joints))
        )
    if joints and (len(joints) != merged.joints or len(set(joints)) != merged.joints):
        problem = diagnose("contract-joints", count=merged.joints, given=len(set(joints)))
        raise merged.make_error("joints", problem)
    return tuple(joints)


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


def _read_terms(merged: _MergedValues) -> tuple[ObservationTerm, ...]:
    """Return the terms of an observation, from the contract key ``observation``."""
    entries = merged.values.get("observation")
    if not isinstance(entries, list) or not entries:
        raise merged.make_error("observation", diagnose("contract-lacks", key="observation"))
    terms = []
    for entry in entries:
        name = entry.get("term") if isinstance(entry, dict) else entry
        name = find_term_name(name) if isinstance(name, str) else str(name)
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
        bounds = entry.get("clip", [-math.inf, math.inf]) if isinstance(entry, dict) else []
        clip = _read_clip(merged, name, bounds) if bounds else (-math.inf, math.inf)
        history = entry.get("history", 1) if isinstance(entry, dict) else 1
        if isinstance(history, bool) or not isinstance(history, int) or not 1 <= history <= 1000:
            problem = diagnose("not-between", given=str(history), low=1, high=1000)
            raise merged.make_error(f"observation: {name}", problem)
        history = history if isinstance(entry, dict) and "history" in entry else 0
        terms.append(
            ObservationTerm(name, numbers if numbers.ndim else float(numbers), clip, history)
        )
    return tuple(terms)


def _read_clip(merged: _MergedValues, name: str, bounds: Any) -> tuple[float, float]:
    """Return the lower and upper bound of a term's elements before scaling."""
    try:
        numbers = real_array("clip", bounds)
    except ConfigurationError as error:
        problem = diagnose("no-numbers", count=2)
        raise merged.make_error(f"observation: {name}", problem) from error
    if numbers.shape != (2,) or not numbers[0] < numbers[1]:
        raise merged.make_error(f"observation: {name}", diagnose("no-numbers", count=2))
    return float(numbers[0]), float(numbers[1])


_UNSTATED_ORIGINS = dict.fromkeys(
    (
        *("latency", "clip", "action-clip", "history", "newest-first", "layout", "lower", "upper"),
        *("signs", "joints", "action-offset", "phase-rate", "phase-offsets"),
    ),
    Origin.ASSUMED,
)
"""{key: origin} of contract keys that no file states, and that then have a default value, such as a
latency of 0.
"""


def convert_deployment(deployment: Deployment, inputs: int, outputs: int) -> Statements:
    """Convert the facts of a deployment to statements of contract keys, for `make_contract`.

    Args:
        deployment: Gains, joint order, observation and settings that the files of a deployment
            state.
        inputs: Number of inputs of the network. If the files state no observation, `inputs` may
            select one of `KNOWN_LAYOUTS`.
        outputs: Number of outputs of the network.

    Returns:
        Values of the contract keys, with the place and the origin of each value.
    """
    values, places, origins = dict[str, Any](), dict[str, str](), dict[str, str]()

    def put(key: str, value: Any, place: str, origin: str = Origin.STATED) -> None:
        values[key], places[key], origins[key] = value, place, str(origin)

    joints = deployment.joints
    if joints and len(joints) == outputs:
        origin = Origin.ASSUMED if deployment.is_order_assumed else Origin.STATED
        put("joints", list(joints), deployment.order_place, origin)
    else:
        stated = [joint for quantity, joint in deployment.facts if quantity == "default angle"]
        joints = tuple(dict.fromkeys(stated)) if len(set(stated)) == outputs else ()
        if joints:
            put("joints", list(joints), deployment.facts["default angle", joints[0]].place,
                Origin.ASSUMED)  # fmt: skip
    for quantity, key in _KEYS_OF_DEPLOYMENT.items():
        facts = deployment.get_numbers(quantity, joints)
        if facts is not None:
            others = (fact.origin for fact in facts if fact.origin != Origin.STATED)
            origin = Origin(next(others, Origin.STATED))
            put(key, [fact.number for fact in facts], facts[0].place, origin)
    for quantity, key, unbounded in _BOUNDS_OF_DEPLOYMENT:
        bounds = {joint: deployment.facts.get((quantity, joint)) for joint in joints}
        known = [fact for fact in bounds.values() if fact is not None and fact.value is not None]
        if known:
            values_by_joint = [
                unbounded if fact is None or fact.value is None else fact.number
                for fact in bounds.values()
            ]
            put(key, values_by_joint, known[0].place, known[0].origin)
    for quantity, key in _SETTINGS_OF_DEPLOYMENT.items():
        fact = deployment.facts.get((quantity, ""))
        if fact is not None and fact.value is not None and fact.value > 0:
            is_rate = key == "rate"
            put(key, 1.0 / fact.value if is_rate else fact.value, fact.place, fact.origin)
    if deployment.observations:
        place = deployment.observations[0].place.path
        entries = [_convert_term(term) for term in deployment.observations]
        histories = [max(1, term.history) for term in deployment.observations]
        if len(set(histories)) > 1:
            entries = [entry | {"history": count}
                       for entry, count in zip(entries, histories, strict=True)]  # fmt: skip
        elif any(term.history for term in deployment.observations):
            put("history", histories[0], place)
        put("observation", entries, place)
        if order := deployment.observations[0].frame_order:
            put("layout", BY_FRAME, place)
            put("newest-first", order == "newest first", place)
    else:
        _put_known_layout(deployment, inputs, len(joints) or outputs, put)
    file = str(deployment.files[0]) if deployment.files else ""
    return Statements(file, values, places, origins)


_KEYS_OF_DEPLOYMENT = {
    "default angle": "default",
    "action scale": "action-scale",
    "action offset": "action-offset",
    "kp": "kp",
    "kd": "kd",
    "effort": "effort",
}
"""{quantity of joints in a deployment: contract key}."""

_BOUNDS_OF_DEPLOYMENT = (
    ("lowest target", "lower", -math.inf),
    ("highest target", "upper", math.inf),
)
"""(quantity of joints in a deployment, contract key, value of a joint without a bound)."""

_SETTINGS_OF_DEPLOYMENT = {
    "policy step": "rate",
    "latency": "latency",
    "observation clip": "clip",
    "action clip": "action-clip",
}
"""{setting of a deployment: contract key}; the rate is the reciprocal of the policy step."""


def _convert_term(term: ObservedTerm) -> dict[str, Any]:
    """Convert a term of a deployment to an entry of the contract key ``observation``.

    The entry is {"term": name, and optionally "scale": factor or list, "clip": [low, high]}.
    """
    entry: dict[str, Any] = {"term": find_term_name(term.name)}
    if term.scales is not None:
        entry["scale"] = term.scales[0] if len(set(term.scales)) == 1 else list(term.scales)
    if term.clip is not None:
        entry["clip"] = list(term.clip)
    return entry


_BASIC_TERMS = ("angular-velocity", "gravity", "command", "joint-positions", "joint-velocities",
                "last-action")  # fmt: skip
"""Terms that the observations of all `KNOWN_LAYOUTS` contain, in this order."""

KNOWN_LAYOUTS: Mapping[str, tuple[tuple[str, ...], float]] = {
    "legged_gym 1.0": (("linear-velocity", *_BASIC_TERMS), 0.0),
    "legged_gym 1.0 without linear velocity": (_BASIC_TERMS, 0.0),
    "unitree_rl_gym, deploy_mujoco.py": ((*_BASIC_TERMS, "phase-sine", "phase-cosine"), 1.25),
}
"""{framework: (terms of an observation, gait frequency [Hz])} for frameworks whose files do not
state the terms. The frequency is 0 without a gait phase. Sources: ``compute_observations`` in
``legged_robot.py``; ``deploy_mujoco.py``, period 0.8 s.
"""

_SCALES_OF_TERMS = {
    "linear-velocity": "lin_vel",
    "angular-velocity": "ang_vel",
    "joint-positions": "dof_pos",
    "joint-velocities": "dof_vel",
}
"""{term: name of the scale of the term in files of legged_gym}."""


def _put_known_layout(
    deployment: Deployment, inputs: int, joints: int, put: Callable[..., None]
) -> None:
    """Infer the observation from the network's number of ``inputs``: a known layout of this size.

    Nothing is inferred if the files state no scale of `_SCALES_OF_TERMS`. ``put`` is the function
    that states a key: value, place and origin.
    """
    scales = {
        term: deployment.facts[f"observation {name}", ""]
        for term, name in _SCALES_OF_TERMS.items()
        if (f"observation {name}", "") in deployment.facts
    }
    if not scales:
        return
    for framework, (terms, phase_rate) in KNOWN_LAYOUTS.items():
        sizes = [TERM_SIZES[term] or (1 if term.startswith("phase") else joints) for term in terms]
        if sum(sizes) != inputs:
            continue
        entries = list[dict[str, Any]]()
        for term in terms:
            scale: Any = scales[term].number if term in scales else 1.0
            if term == "command":
                names = ("commands x", "commands y", "commands turn")
                own = [deployment.facts.get((f"observation {name}", "")) for name in names]
                known = [fact.number for fact in own if fact is not None]
                velocity, turn = (scales.get(k) for k in ("linear-velocity", "angular-velocity"))
                if len(known) == 3:
                    scale = known
                elif velocity is not None and turn is not None:
                    scale = [velocity.number, velocity.number, turn.number]
            entries.append({"term": term, "scale": scale})
        put("observation", entries, framework, Origin.DEFAULT)
        if phase_rate:
            put("phase-rate", phase_rate, framework, Origin.DEFAULT)
        return
