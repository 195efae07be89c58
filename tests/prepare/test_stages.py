"""Servos and visual meshes are made when they are first needed, and equal those made at once."""

from __future__ import annotations

import copy
import pickle
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.models.mjcf_file import read_mjcf
from pupper_analysis.models.urdf_file import read_urdf
from pupper_analysis.prepare import passes
from pupper_analysis.prepare.passes import LoadRequest, prepare_robot
from tests.support.legged import quadruped

EARLY_NAMES = ("name", "floating", "base", "mj_base", "joint_names", "contact_points", "feet")


@pytest.fixture
def runs(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the deferred passes that were applied, in order."""
    applied: list[str] = []
    run_passes = passes._run_passes

    def recorded(given: tuple[passes.Pass, ...], draft: passes.Draft) -> passes.Draft:
        applied.extend(step.name for step in given if step.deferred and step.applies(draft))
        return run_passes(given, draft)

    monkeypatch.setattr(passes, "_run_passes", recorded)
    return applied


def test_servos_are_not_made_for_pinocchio_model_and_joints(
    tmp_path: Path, runs: list[str]
) -> None:
    robot = pa.load_robot(*quadruped(tmp_path))
    assert robot.pin_model.nv == robot.nv == 18
    assert robot.total_mass > 0
    assert len(robot.feet) == 4
    assert "4 feet" in repr(robot)
    assert len(robot.lower_limits) == robot.nu
    assert not runs
    assert robot.mj_model.nu == robot.nu
    assert "add-servos" in runs
    count = len(runs)
    assert robot.notes
    assert robot.description.made_servos
    assert len(runs) == count


def test_deferred_stages_keep_the_fields_that_were_read_before(tmp_path: Path) -> None:
    """Reference: the robot of which all passes are applied at once."""
    pair = quadruped(tmp_path)
    robot = pa.load_robot(*pair)
    early = {name: getattr(robot, name) for name in EARLY_NAMES}
    pin_model, nominal = robot.pin_model, robot.nominal
    whole, _ = prepare_robot(read_urdf(pair.urdf), read_mjcf(pair.mjcf), LoadRequest())
    assert early == {name: getattr(whole, name) for name in EARLY_NAMES}
    assert pin_model == whole.pin_model
    np.testing.assert_array_equal(pin_model.armature, whole.pin_model.armature)
    np.testing.assert_array_equal(nominal, whole.nominal)
    assert robot.stand_height == whole.stand_height
    assert robot.fingerprint == whole.fingerprint
    assert robot.notes == whole.notes
    assert robot.foot_geoms == whole.foot_geoms
    np.testing.assert_array_equal(robot.home, whole.home)
    assert robot.pin_model is pin_model


def test_pickled_and_copied_robots_are_complete(tmp_path: Path) -> None:
    pair = quadruped(tmp_path)
    whole = pa.load_robot(*pair)
    for robot in (
        pickle.loads(pickle.dumps(pa.load_robot(*pair))),
        copy.copy(pa.load_robot(*pair)),
    ):
        assert robot.notes == whole.notes
        assert robot.mj_model.nu == whole.mj_model.nu
        assert robot.pin_model == whole.pin_model


def test_threads_read_one_model_of_a_robot(tmp_path: Path) -> None:
    robot = pa.load_robot(*quadruped(tmp_path))
    with ThreadPoolExecutor(4) as pool:
        models = list(pool.map(lambda _: robot.mj_model, range(4)))
    assert all(model is robot.mj_model for model in models)


def test_unknown_attribute_raises_without_further_stages(tmp_path: Path, runs: list[str]) -> None:
    robot = pa.load_robot(*quadruped(tmp_path))
    with pytest.raises(AttributeError, match="no attribute 'mjmodel'"):
        _ = robot.mjmodel  # type: ignore[attr-defined]
    assert not runs
