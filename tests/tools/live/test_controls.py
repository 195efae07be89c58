"""Sliders of the page: their ranges."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from pupper_analysis.robot.robot import Robot
from pupper_analysis.tools.live import controls


class Gui:
    """Page that records its sliders instead of drawing them."""

    def add_slider(self, name: str, low: float, high: float, step: float, value: float) -> Any:
        return SimpleNamespace(
            name=name, min=low, max=high, step=step, value=value, on_update=lambda _: None
        )


@pytest.mark.parametrize(
    ("limits", "bounds"),
    [((0.1, 0.3), (0.1, 0.3)), ((0.4, 0.6), (0.4, 0.6)), ((-1.2, 3.4), (-1, 3))],
)
def test_slider_of_a_short_range_does_not_exceed_the_limits_of_the_joint(
    limits: tuple[float, float], bounds: tuple[float, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reference: the limits [deg]; the step of other sliders is 0.5 deg."""
    monkeypatch.setattr(controls, "joint_ranges", lambda _: np.radians([limits]))
    monkeypatch.setattr(controls, "list_position_units", lambda _: ["rad"])
    robot = cast(Robot, SimpleNamespace(joint_names=("knee",)))
    start = np.radians([limits[0]])
    sliders = controls.JointSliders(Gui(), robot, ["knee"], start, lambda *_: None)
    slider = sliders.sliders["knee"]
    assert (slider.min, slider.max) == pytest.approx(bounds)
    assert slider.min <= slider.value <= slider.max
