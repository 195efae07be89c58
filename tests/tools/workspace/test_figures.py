"""The workspace's figure: what it draws, looked at through matplotlib's own objects."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from matplotlib.figure import Figure

import pupper_analysis as pa
from pupper_analysis.present.figures import drawing
from pupper_analysis.tools.workspace import figures as workspace_figure
from tests.support.variants import load


def test_every_direction_has_its_panel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[Figure] = []
    save = drawing.save_figure

    def keep(figure: Figure, path: Path) -> None:
        drawn.append(figure)
        save(figure, path)

    monkeypatch.setattr(drawing, "save_figure", keep)
    robot = load("v3")
    workspace = pa.stance.base_workspace(robot, pa.StandTask(ground=pa.Ground(0.1), pitch=-0.1))
    workspace_figure.workspace_figure(robot, workspace, tmp_path / "workspace.png")
    assert (tmp_path / "workspace.png").stat().st_size > 50_000
    panels = {axes.get_title(loc="left").split(":")[0]: axes for axes in drawn[0].axes}
    assert list(panels) == ["height", "roll", "pitch", "yaw", "x", "y"]
    roll = workspace.intervals["roll"]
    title = panels["roll"].get_title(loc="left")
    assert f"{math.degrees(roll.low):+.1f}°" in title
    assert f"{math.degrees(roll.high):+.1f}°" in title
    for name, axes in panels.items():
        assert "(mm)" in axes.get_xlabel()
        assert "(mm)" in axes.get_ylabel()
        assert bool(axes.xaxis_inverted()) is (name in ("roll", "y", "yaw"))  # left is left
    # The ground rises forward: 0.1 rad from the right, level from behind.
    ends = panels["height"].lines[-1].get_xydata()
    assert (ends[1, 1] - ends[0, 1]) / (ends[1, 0] - ends[0, 0]) == pytest.approx(math.tan(0.1))
    ends = panels["roll"].lines[-1].get_xydata()
    assert ends[0, 1] == ends[1, 1]
