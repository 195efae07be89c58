"""Comparison of large robots: quantities evaluated in MuJoCo, compared with Pinocchio, and growth
of the work. Time and memory are measured by `benchmarks/size.py`; here operations are counted.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import FrameType

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.models.conversion import MujocoTree
from pupper_analysis.models.multibody import MultibodyTree
from pupper_analysis.robot.compare.behaviour import (
    Behaviour,
    States,
    count_affordable_states,
    random_states,
)
from pupper_analysis.robot.coordinates import PinocchioConvention
from pupper_analysis.robot.matching.trees import kinematic_trees
from pupper_analysis.robot.structure import Structure
from pupper_analysis.tools.crosscheck.crosscheck import URDF_MUJOCO, list_size_notes
from tests.support.engines import to_pinocchio
from tests.support.repository import benchmark
from tests.support.variants import load

size = benchmark("size")

Written = Callable[..., tuple[Path, Path]]


@pytest.fixture
def written(tmp_path: Path) -> Written:
    def write(legs: int, joints: int, heavier: int = 0) -> tuple[Path, Path]:
        files = tmp_path / f"{legs}x{joints}.urdf", tmp_path / f"{legs}x{joints}.xml"
        for file, text in zip(files, size.make_pair(legs, joints, heavier), strict=True):
            file.write_text(text)
        return files

    return write


@pytest.fixture
def workspaces(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Return the degrees of freedom of each set of Pinocchio's data that is made."""
    made: list[int] = []
    workspace = Structure.acquire_workspace

    def counted(self: Structure) -> object:
        if not self._spare_data:
            made.append(self.model.nv)
        return workspace(self)

    monkeypatch.setattr(Structure, "acquire_workspace", counted)
    return made


def in_pinocchio(robot: pa.Robot, values: MultibodyTree, states: States) -> dict[str, np.ndarray]:
    """Return the quantities of `Behaviour`, computed by Pinocchio."""
    model, base = to_pinocchio(values), robot.nv - robot.nu
    convention = PinocchioConvention.from_model(model, robot.joint_names)
    own = replace(robot, pin_model=model, pin_convention=convention, contact_frames={})
    damping = np.full(robot.nv, values.base_damping)
    damping[base:] = [values.joints[name].damping for name in robot.joint_names]
    rows = []
    for qpos, qvel, torques in zip(states.qpos, states.qvel, states.torques, strict=True):
        config = pa.Configuration(own, qpos, qvel)
        force = -damping * qvel + np.concatenate([np.zeros(base), torques])
        rows.append(
            {
                "mass matrix": config.mass_matrix(),
                "gravity": config.gravity(),
                "bias forces": config.bias_forces(),
                "com": config.center_of_mass(),
                "forward dynamics": config.forward_dynamics(force),
                "joint positions": [config.joint_position(name) for name in robot.joint_names],
                "foot positions": [config.frame_position(name) for name in values.frames],
            }
        )
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


@pytest.mark.parametrize("name", ["v3", "original"])
@pytest.mark.parametrize("fixed", [False, True], ids=["free", "fixed"])
def test_behaviour_of_a_tree_in_mujoco_equals_pinocchio(name: str, fixed: bool) -> None:
    """Differences are judged by MuJoCo alone; Pinocchio is the independent reference here."""
    robot = load(name, fixed_base=fixed)
    tree, states = kinematic_trees(robot)[0], random_states(robot, 5, seed=1)
    behaviour = Behaviour(robot, states)
    joint = robot.joint_names[4]
    other = replace(
        tree,
        gravity=np.array([0.3, -0.2, -9.0]),
        bodies={**tree.bodies, joint: replace(tree.bodies[joint], mass=0.7, com=np.ones(3) * 0.03)},
        joints={**tree.joints, joint: replace(tree.joints[joint], damping=0.4, armature=0.02)},
    )
    for values in (tree, other, tree):  # what was changed in place is changed back
        first, second = in_pinocchio(robot, values, states), behaviour(values)
        assert set(first) == set(second)
        for quantity, expected in first.items():
            scale = np.abs(expected).max()
            np.testing.assert_allclose(
                second[quantity], expected, rtol=0, atol=1e-10 * scale, err_msg=quantity
            )


def test_mujoco_tree_keeps_limits_efforts_and_damping() -> None:
    """Reference: joints of v3's URDF tree; ranges [rad], efforts [N m] and damping [N m s/rad] of
    MuJoCo's model.
    """
    tree = kinematic_trees(load("v3"))[0]
    model = MujocoTree(tree).model
    assert len(tree.joints) == 12
    for name, joint in tree.joints.items():
        found = model.joint(name)
        effort = model.jnt_actfrcrange[found.id, 1]
        np.testing.assert_array_equal(found.range, [joint.lower, joint.upper])
        assert effort == joint.effort
        assert found.damping == joint.damping


@pytest.mark.slow
def test_a_large_robot_is_compared_without_pinocchios_data(
    written: Written, workspaces: list[int]
) -> None:
    """246 degrees of freedom, three links heavier in the MJCF: all three are found with both masses
    [kg], and no Pinocchio data is created.
    """
    result = pa.compare_models(*written(60, 4, heavier=3))
    assert workspaces == []
    masses = [d for d in result.differences if d.kind == "mass"]
    assert len(masses) == len(result.differences)
    assert {d.element for d in masses} == {"j0_0", "j0_1", "j0_2"}
    assert all((d.urdf, d.mjcf) == (0.1, 0.11) for d in masses)
    assert result.complete
    assert not result.engines
    notes = " ".join(map(str, result.check.notes))
    assert "Pinocchio's dynamics of 246 degrees of freedom" in notes
    edges = result.check.quantities[0].edge_deviations
    assert set(edges) == {"models (MuJoCo)", "extras (MJCF)"}


@pytest.mark.slow
def test_a_large_robot_agrees_until_one_com_is_moved(written: Written) -> None:
    """A CoM displaced by 1 mm in the URDF is then the only difference."""
    urdf, mjcf = written(60, 4)
    result = pa.compare_models(urdf, mjcf)
    assert result.agree
    assert result.check.passed
    # Control: one link differs in one file, which both engines evaluate.
    text = urdf.read_text().replace('xyz="0 0 -.02"', 'xyz="0 0.001 -.02"', 1)
    urdf.write_text(text)
    worse = pa.compare_models(urdf, mjcf)
    assert [(d.kind, d.element) for d in worse.differences] == [("com", "j0_0")]
    assert set(worse.check.quantities[1].evaluations) == {URDF_MUJOCO, "MJCF in MuJoCo"}


def test_compared_trees_of_one_structure_share_pinocchios_data(
    written: Written, workspaces: list[int]
) -> None:
    """Eight differing masses: at most one set of data per file, and one for the changed trees."""
    result = pa.compare_models(*written(10, 4, heavier=8))
    assert len(result.differences) == 8
    assert result.complete
    assert len(workspaces) <= 3


def test_fewer_states_are_compared_for_a_very_large_robot_with_a_note() -> None:
    """2,006 degrees of freedom: 2 of 20 states; v3 keeps all requested states."""
    robot = load("v3")

    class Large:
        nv = 2006

    large = Large()
    assert (count_affordable_states(robot, 10**5), list(list_size_notes(robot, 20))) == (10**5, [])
    assert [count_affordable_states(large, count) for count in (20, 1)] == [2, 1]  # type: ignore[arg-type]
    notes = list(map(str, list_size_notes(large, 20)))  # type: ignore[arg-type]
    assert "2 of 20 states" in notes[0]


def _count_calls(work: Callable[[], object]) -> int:
    """Return the number of calls of Python functions in some work."""
    count = 0

    def hook(_frame: FrameType, event: str, _argument: object) -> None:
        nonlocal count
        count += event == "call"

    before = sys.getprofile()
    sys.setprofile(hook)
    try:
        work()
    finally:
        sys.setprofile(before)
    return count


@pytest.mark.slow
@pytest.mark.parametrize("heavier", [5, 0])
def test_twice_the_robot_is_twice_the_work(written: Written, heavier: int) -> None:
    """Count of Python calls: at most 2.2 times for twice as many legs (linear growth plus 10 %)."""
    first, second = written(52, 4, heavier), written(104, 4, heavier)
    pa.compare_models(*written(3, 4, heavier))  # imports
    small, large = (
        _count_calls(lambda files=files: pa.compare_models(*files)) for files in (first, second)
    )
    assert large < 2.2 * small


@pytest.mark.slow
def test_twice_the_bodies_are_twice_the_audit(tmp_path: Path) -> None:
    """Count of Python calls: at most 2.2 times for twice as many free bodies."""
    calls = []
    for number in (10, 100, 200):  # the first call imports
        file = tmp_path / f"{number}.xml"
        file.write_text(size.make_free_bodies(number))
        calls.append(_count_calls(lambda file=file: pa.audit_model(file)))
    assert calls[2] < 2.2 * calls[1]
