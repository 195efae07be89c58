"""Share MuJoCo's rollouts between commands of one process.

Most processor time of a command is spent in ``mujoco.rollout``, and commands about the same robot
simulate the same stand again. A rollout is determined by its arguments: the model, the initial
states, the controls and the warm starts. The package still computes all arguments and evaluates all
states, so that an error of the package changes the arguments, or the evaluation.
"""

from __future__ import annotations

import hashlib
import threading
from collections import OrderedDict, deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple
from unittest import mock

import mujoco
import mujoco.rollout
import numpy as np

MAX_BYTES = 200e6
"""Upper bound of the stored states [bytes] per process; the least recently used are dropped.
Chosen, not tuned: a tenth of the memory of a worker of CI."""

MIN_STEPS = 100
"""Number of steps of all runs below which a rollout is not stored. Derived: hashing the 3.5 MB of
Pupper v3 takes as long as 50 steps."""

_hashed_models: deque[tuple[bytearray, bytes]] = deque(maxlen=8)
"""(content, hash) of the models of the last rollouts. Comparing 3.5 MB takes a tenth of the time of
hashing them, and most rollouts have the model of an earlier one."""

INPUTS = int(mujoco.mjtState.mjSTATE_INTEGRATION.value)
"""Bit mask of all inputs of a time step."""

_simulate = mujoco.rollout.rollout


class Rollout(NamedTuple):
    """Result of a rollout.

    Attributes:
        states: States after each step, shape (runs, steps, size).
        sensors: Sensor data after each step, shape (runs, steps, model.nsensordata).
        inputs: Final state (mjSTATE_INTEGRATION) of each element of ``data``.
    """

    states: np.ndarray
    sensors: np.ndarray
    inputs: list[np.ndarray]


class RolloutCache:
    """Results of rollouts by the content of their arguments.

    Attributes:
        simulated: Number of rollouts that MuJoCo simulated.
        reused: Number of rollouts whose result was stored.
    """

    def __init__(self) -> None:
        self._stored: OrderedDict[bytes, Rollout] = OrderedDict()
        self._bytes, self._lock = 0, threading.Lock()
        self.simulated = self.reused = 0

    def roll_out(
        self,
        model: mujoco.MjModel | Sequence[mujoco.MjModel],
        data: mujoco.MjData | Sequence[mujoco.MjData],
        initial_state: np.ndarray,
        control: np.ndarray,
        **options: Any,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the result of ``mujoco.rollout.rollout``, and set the final state of ``data``.

        Of stored rollouts, the inputs of the next step are set in ``data``, but no derived values,
        such as contacts.
        """
        runs = 1 if np.ndim(initial_state) == 1 else len(initial_state)
        if max(runs, len(control)) * control.shape[1] < MIN_STEPS:
            return _simulate(model, data, initial_state, control, **options)  # type: ignore[no-any-return]
        models = [model] if isinstance(model, mujoco.MjModel) else list(model)
        workers = [data] if isinstance(data, mujoco.MjData) else list(data)
        key = hash_arguments(models, len(workers), initial_state, control, options)
        with self._lock:
            stored = self._stored.get(key)
            if stored is not None:
                self._stored.move_to_end(key)
                self.reused += 1
        if stored is None:
            states, sensors = _simulate(model, data, initial_state, control, **options)
            self._store_result(
                key, Rollout(states.copy(), sensors.copy(), _get_inputs(models, workers))
            )
            return states, sensors
        for worker, inputs in zip(workers, stored.inputs, strict=True):
            mujoco.mj_setState(models[0], worker, inputs, INPUTS)
        return stored.states.copy(), stored.sensors.copy()

    def _store_result(self, key: bytes, result: Rollout) -> None:
        """Store a result, and drop the least recently used results above ``MAX_BYTES``."""
        with self._lock:
            self.simulated += 1
            if key not in self._stored:  # by another thread
                self._stored[key] = result
                self._bytes += result.states.nbytes + result.sensors.nbytes
            while self._bytes > MAX_BYTES:
                _, dropped = self._stored.popitem(last=False)
                self._bytes -= dropped.states.nbytes + dropped.sensors.nbytes


def _get_inputs(models: list[mujoco.MjModel], workers: list[mujoco.MjData]) -> list[np.ndarray]:
    """Return the state (mjSTATE_INTEGRATION) of each of MuJoCo's data."""
    states = [np.empty(mujoco.mj_stateSize(models[0], INPUTS)) for _ in workers]
    for worker, state in zip(workers, states, strict=True):
        mujoco.mj_getState(models[0], worker, state, INPUTS)
    return states


def hash_model(model: mujoco.MjModel) -> bytes:
    """Return a hash of all numbers of a model."""
    content = bytearray(mujoco.mj_sizeModel(model))
    mujoco.mj_saveModel(model, None, np.frombuffer(content, np.uint8))
    for known, digest in tuple(_hashed_models):  # a copy, since other threads append
        if known == content:
            return digest
    digest = hashlib.sha256(content).digest()
    _hashed_models.append((content, digest))
    return digest


def hash_arguments(
    models: list[mujoco.MjModel],
    num_workers: int,
    initial_state: np.ndarray,
    control: np.ndarray,
    options: dict[str, Any],
) -> bytes:
    """Return a hash of all numbers that determine a rollout."""
    found = hashlib.sha256(f"{num_workers} {sorted(options)}".encode())
    for model in models:
        found.update(hash_model(model))
    for value in (initial_state, control, *(options[name] for name in sorted(options))):
        array = np.ascontiguousarray(np.nan if value is None else value)
        found.update(f"{array.shape} {array.dtype}".encode())
        found.update(array.data)
    return found.digest()


CACHE = RolloutCache()
"""The cache of this process."""


@contextmanager
def share_rollouts(cache: RolloutCache = CACHE) -> Iterator[None]:
    """Simulate rollouts with equal arguments once."""
    with mock.patch.object(mujoco.rollout, "rollout", cache.roll_out):
        yield
