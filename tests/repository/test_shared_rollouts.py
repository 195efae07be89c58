"""Shared rollouts equal those of MuJoCo (reference: ``mujoco.rollout`` without the cache), and
shared variants are those of each command.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any
from unittest import mock

import mujoco
import mujoco.rollout
import numpy as np
import pytest

from pupper_analysis.pupper import variant_files
from tests.support.commands import answer
from tests.support.shared_rollouts import INPUTS, RolloutCache, share_rollouts
from tests.support.variants import share_variants

BALL = """<mujoco><option integrator="implicitfast"/><worldbody><geom type="plane" size="1 1 1"/>
<body pos="0 0 0.1"><freejoint/><geom name="ball" size="0.1" mass="1"/></body></worldbody>
</mujoco>"""
STEPS = 200


def simulate(model: mujoco.MjModel, speed: float) -> tuple[np.ndarray, np.ndarray]:
    """Simulate the ball from the floor; return its states and the final inputs of a step."""
    data = mujoco.MjData(model)
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    start = np.empty(mujoco.mj_stateSize(model, kind))
    data.qvel[0] = speed
    mujoco.mj_getState(model, data, start, kind)
    force = np.zeros((1, STEPS, 6 * model.nbody))
    spec = int(mujoco.mjtState.mjSTATE_XFRC_APPLIED)
    states, _ = mujoco.rollout.rollout(model, data, start, force, control_spec=spec)
    inputs = np.empty(mujoco.mj_stateSize(model, INPUTS))
    mujoco.mj_getState(model, data, inputs, INPUTS)
    return states, inputs


def test_equal_rollouts_are_simulated_once_with_equal_results() -> None:
    model, cache = mujoco.MjModel.from_xml_string(BALL), RolloutCache()
    reference = simulate(model, 1.0)
    with share_rollouts(cache):
        for _ in range(2):
            states, inputs = simulate(model, 1.0)
            np.testing.assert_array_equal(states, reference[0])
            np.testing.assert_array_equal(inputs, reference[1])
            states[:] = 0.0  # the caller owns the states
    assert (cache.simulated, cache.reused) == (1, 1)


def change(model: mujoco.MjModel, name: str) -> None:
    """Change one number of a compiled model in the last digits."""
    value: Any = getattr(model, name)
    value.flat[-1] *= 1 + 1e-12


@pytest.mark.parametrize("name", ["body_mass", "geom_friction", "dof_damping", "opt", "speed"])
def test_rollout_with_another_number_is_simulated_again(name: str) -> None:
    model, cache, speed = mujoco.MjModel.from_xml_string(BALL), RolloutCache(), 1.0
    model.dof_damping[:] = 1e-3
    with share_rollouts(cache):
        simulate(model, speed)
        if name == "opt":
            model.opt.timestep *= 1 + 1e-12
        elif name == "speed":
            speed += 1e-12
        else:
            change(model, name)
        states, _ = simulate(model, speed)
    assert (cache.simulated, cache.reused) == (2, 0)
    np.testing.assert_array_equal(states, simulate(model, speed)[0])


def test_a_shared_variant_is_built_once_and_its_files_are_inputs_of_each_command(
    tmp_path: Path,
) -> None:
    """Reference: the first command, which builds the variant."""
    contents = []
    with (
        share_variants(),
        mock.patch.object(variant_files, "build_robot", wraps=variant_files.build_robot) as build,
    ):
        for name in ("first.json", "second.json"):
            done = answer("stand", "v3", "--json", str(tmp_path / name))
            assert done.returncode == 0, done.stderr
            contents.append(json.loads((tmp_path / name).read_text()))
    assert build.call_count == 1
    first, second = (
        {Path(file).resolve(): digest for file, digest in content["provenance"]["files"].items()}
        for content in contents
    )
    assert {file.name for file in first} >= {"pupper_v3.urdf", "pupper_v3.xml"}
    assert second == first
