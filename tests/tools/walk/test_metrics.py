"""Metrics of policies in studies equal the results of `walk`."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest

import pupper_analysis as pa
from pupper_analysis.base.errors import NotStandingError, PupperAnalysisError
from pupper_analysis.tools.study.measures import format_metric, make_metric
from pupper_analysis.tools.walk.gait import simulate_walk
from pupper_analysis.tools.walk.policy import Policy
from tests.support.variants import load
from tests.tools.walk import made


@pytest.mark.slow
def test_walk_metrics_equal_walk(tmp_path: Path) -> None:
    path, design = (
        made.write_standing_policy(tmp_path / "still.json"),
        SimpleNamespace(robot=load("v3")),
    )
    [gait] = simulate_walk(load("v3"), Policy.load(path), (0, 0, 0)).gaits
    margin = make_metric(f"walk_margin:{path}@0,0,0")
    assert margin.function(design) == gait.margin  # type: ignore[arg-type]
    assert gait.margin > 0.5
    torque = make_metric(f"walk_torque:{path}@0,0,0")
    assert torque.function(design) == max(gait.torque_rms)  # type: ignore[arg-type]
    forward = make_metric(f"walk_margin:{path}")  # 0.5 m/s: a stand does not track it
    assert forward.function(design) == 0.0  # type: ignore[arg-type]
    assert format_metric(margin) == f"walk_margin:{path}@0,0,0"


def test_walk_torque_of_a_fall_is_unknown(tmp_path: Path) -> None:
    """The default pose of the policy cannot stand: the torques until the fall are no result."""
    pose = [0.26, 1.2, -0.52, -0.26, 1.2, 0.52] * 2
    path = made.write_standing_policy(tmp_path / "still.json", default_joint_pos=pose)
    torque = make_metric(f"walk_torque:{path}@0,0,0")
    with pytest.raises(NotStandingError):
        torque.function(SimpleNamespace(robot=load("v3")))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("given", "named"),
    [
        ("walk_margin", "after a colon"),
        ("walk_margin:none.json", "none.json"),
        ("servo_sag:still.json", "accepts no file"),
        ("walk_margin:still.json@fast", "number"),
        ("walk_margin:still.json@0,0", "nor 3 numbers"),
    ],
)
def test_invalid_walk_metrics_are_refused(
    given: str, named: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made.write_standing_policy(tmp_path / "still.json")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(PupperAnalysisError, match=named):
        make_metric(given)


@pytest.mark.slow
def test_policy_path_of_a_study_is_relative_to_its_file(tmp_path: Path) -> None:
    """A design with a torso mass of 12 times has motors too weak to stand, and the margin 0."""
    made.write_standing_policy(tmp_path / "still.json")
    (tmp_path / "study.toml").write_text(
        'robot = "v3"\nmeasure = ["walk_margin:still.json@0,0,0"]\n'
        "[vary]\ntorso_mass_scale = { values = [1.0, 12.0] }\n"
    )
    table = pa.Study.read(tmp_path / "study.toml").run(tmp_path / "out", workers=1)
    light, heavy = table["walk_margin"]
    assert light > 0.5
    assert heavy == 0.0


def test_results_of_another_policy_contract_or_command_are_not_reused(tmp_path: Path) -> None:
    """`content` identifies the results of a study; the name of the policy file is the same."""
    path = made.write_standing_policy(tmp_path / "still.json")
    contents = [make_metric(f"walk_margin:{path}").content]
    contents.append(make_metric(f"walk_margin:{path}@0.3,0,0").content)
    path.with_suffix(".toml").write_text("latency = 0.01")
    contents.append(make_metric(f"walk_margin:{path}").content)
    made.write_standing_policy(path, kp=6.0)
    contents.append(make_metric(f"walk_margin:{path}").content)
    assert len(set(contents)) == 4
