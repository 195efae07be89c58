"""Elapsed time, and the estimate of the remaining time of a stage."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from pupper_analysis.base.progress import ProgressClock, observe_progress, report_progress
from pupper_analysis.cli import shared
from pupper_analysis.cli.shared import format_progress
from pupper_analysis.robot.robot import Robot
from tests.support.commands import answer
from tests.support.repository import ROOT


class Time:
    """Clock that a test sets [s]."""

    now = 100.0

    def __call__(self) -> float:
        return self.now


def test_remaining_time_follows_from_the_mean_of_the_completed_parts() -> None:
    """Closed form: (total - done) times the mean duration, less the time since the last part."""
    time = Time()
    clock = ProgressClock(time)
    assert clock.remaining is None
    clock.update("search", 0, 10)
    assert clock.remaining is None
    time.now = 106.0
    clock.update("search", 3, 10)
    assert clock.remaining == pytest.approx(14.0)
    time.now = 110.0
    assert clock.remaining == pytest.approx(10.0)
    assert clock.elapsed == pytest.approx(10.0)
    time.now = 200.0
    assert clock.remaining == 0.0
    clock.update("search", 10, 10)
    assert clock.remaining is None


def test_displayed_text_begins_after_two_seconds() -> None:
    time = Time()
    clock = ProgressClock(time)
    clock.update("search", 0, 10)
    time.now = 101.9
    assert format_progress(clock) == ""
    time.now = 103.2
    assert format_progress(clock) == "3 s so far"
    clock.update("search", 2, 10)
    assert format_progress(clock) == "this step: 2 of 10, about 13 s remaining"
    time.now = 150.0
    assert format_progress(clock) == "this step: 2 of 10, about 1 s remaining"


def test_next_stage_has_its_own_estimate() -> None:
    """Three more descents of 1 s each; the sample of 50 s does not count."""
    time = Time()
    clock = ProgressClock(time)
    clock.update("samples", 0, 2)
    time.now = 150.0
    clock.update("samples", 1, 2)
    clock.update("descents", 0, 4)
    time.now = 151.0
    clock.update("descents", 1, 4)
    assert clock.remaining == pytest.approx(3.0)


def test_reports_reach_the_innermost_observer_alone() -> None:
    report_progress("search", 1, 2)
    with observe_progress() as outer, observe_progress() as inner:
        report_progress("search", 1, 2)
        assert (inner.done, inner.total) == (1, 2)
        assert (outer.done, outer.total) == (0, 0)
    with observe_progress() as later:
        assert later.total == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    "arguments",
    [
        ("audit", "{urdf}"),
        ("crosscheck", "{urdf}", "{mjcf}"),
        ("diff", "{urdf}", "{urdf}"),
        ("sync", "{urdf}", "{mjcf}"),
        ("check", "--config", "{config}"),
    ],
    ids=str,
)
def test_commands_about_files_show_progress(
    arguments: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each of these commands may read large meshes for more than two seconds."""
    shown: list[str] = []

    @contextmanager
    def record(what: str) -> Iterator[None]:
        shown.append(what)
        yield

    monkeypatch.setattr(shared, "show_progress", record)
    urdf, mjcf = ROOT / "urdf" / "pupper_v3.urdf", ROOT / "mjcf" / "pupper_v3.xml"
    config = tmp_path / "pupper-analysis.toml"
    shutil.copy(urdf, tmp_path / "robot.urdf")
    config.write_text('[[pair]]\nname = "robot"\nurdf = "robot.urdf"\n')
    files = {"urdf": urdf, "mjcf": mjcf, "config": config}
    result = answer(*(word.format(**files) for word in arguments), folder=tmp_path)
    assert result.returncode in (0, 1), result.stderr
    assert len(shown) == 1


@pytest.mark.slow
def test_stand_shows_progress_during_postponed_preparation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The servo tuning of a URDF without servos simulates for several seconds."""
    active: list[str] = []
    during: list[list[str]] = []
    complete = Robot.complete_stages

    @contextmanager
    def record(what: str) -> Iterator[None]:
        active.append(what)
        yield
        active.pop()

    def complete_stages(robot: Robot) -> None:
        if "_deferred_stages" in vars(robot):
            during.append([*active])
        complete(robot)

    monkeypatch.setattr(shared, "show_progress", record)
    monkeypatch.setattr(Robot, "complete_stages", complete_stages)
    shutil.copy(ROOT / "urdf" / "pupper_v3.urdf", tmp_path / "robot.urdf")
    answer("stand", "robot.urdf", folder=tmp_path)
    assert during
    assert all(during)
