"""``Result.plot``: axes of new figures, and results that have none."""

from __future__ import annotations

import pickle
from collections.abc import Iterator

import matplotlib.pyplot as plt
import numpy as np
import pytest

import pupper_analysis as pa
from tests.support.repository import ROOT
from tests.support.variants import load, stand_of


@pytest.fixture(autouse=True)
def headless(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    plt.switch_backend("agg")
    yield
    plt.close("all")


def test_plot_of_a_stand_has_the_two_views_of_its_figure() -> None:
    robot, stand = load("v3"), stand_of("v3")
    axes = stand.plot(robot)
    assert [panel.get_title(loc="left") for panel in axes] == ["from the front", "from above"]
    assert axes[0].figure.number in plt.get_fignums()  # notebooks show figures of pyplot
    com = pa.Configuration(robot, stand.qpos).center_of_mass()
    # From above, +x is up and +y is left.
    places = np.array([line.get_xydata() for line in axes[1].lines if len(line.get_xydata()) == 1])
    assert np.linalg.norm(places[:, 0] - [-com[1], com[0]], axis=1).min() < 1e-9


def test_plot_of_a_comparison_contains_each_deviation() -> None:
    files = [
        ROOT / folder / f"pupper_v3.{kind}" for folder, kind in (("urdf", "urdf"), ("mjcf", "xml"))
    ]
    comparison = pa.compare_models(*files, configurations=2)
    (axes,) = comparison.plot()
    drawn = {value for line in axes.lines for value in np.asarray(line.get_xdata()) if value > 0}
    expected = {
        value
        for quantity in comparison.check.quantities
        for value in quantity.edge_deviations.values()
    }
    assert drawn == {*filter(None, expected), comparison.check.tolerance}
    assert axes.get_xscale() == "log"


@pytest.mark.slow
def test_plot_of_a_verification_shows_the_height() -> None:
    report = pa.verify_stand(load("v3"), stand_of("v3"))
    (axes,) = report.plot()
    assert axes.lines


def test_missing_robot_and_result_without_plot_are_refused() -> None:
    robot, stand = load("v3"), stand_of("v3")
    assert len(stand.plot()) == 2  # a solved stand references its robot
    plt.close("all")
    with pytest.raises(pa.ConfigurationError, match=r"result\.plot\(robot\)"):
        pickle.loads(pickle.dumps(stand)).plot()
    with pytest.raises(pa.ConfigurationError):
        stand.plot(load("original"))
    statics = pa.gravity_compensation(pa.Configuration(robot, stand.qpos))
    with pytest.raises(pa.ConfigurationError, match="GravityCompensation has no plot"):
        statics.plot()
    assert not plt.get_fignums()
