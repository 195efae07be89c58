"""What is made of a study's table: fronts, figures, sensitivities."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import to_rgb
from matplotlib.image import imread
from scipy import stats

import pupper_analysis as pa
from pupper_analysis.base.diagnostics import Phrase, Quantity, Source, Term, Vector, diagnose
from pupper_analysis.present.figures import drawing
from pupper_analysis.present.figures.drawing import write_plots
from pupper_analysis.tools.study.design import from_record, to_record
from pupper_analysis.tools.study.outcome import (
    main_effects,
    mean_map,
    pareto_front,
    split_panels,
)
from pupper_analysis.tools.study.plots import front_plot, mean_plots, study_plots
from pupper_analysis.tools.study.write import write_randomisation

# ----------------------------------------------------------------------------- fronts


def test_nobody_beats_the_front_and_the_front_beats_all_others() -> None:
    random = np.random.default_rng(0)
    table = pd.DataFrame(random.integers(0, 12, (300, 3)).astype(float), columns=["a", "b", "c"])
    table.loc[5, "b"] = np.nan
    senses = {"a": "min", "b": "max", "c": "min"}
    front = pareto_front(table, senses)
    signs = np.array([1.0, -1.0, 1.0])

    def beats(one: np.ndarray, other: np.ndarray) -> bool:
        return bool((signs * one <= signs * other).all() and (one != other).any())

    whole = table.dropna().to_numpy()
    expected = [row for row in whole if not any(beats(other, row) for other in whole)]
    assert sorted(map(tuple, front.to_numpy())) == sorted(map(tuple, expected))
    assert list(front["a"]) == sorted(front["a"])
    assert 3 < len(front) < 100
    with pytest.raises(pa.ConfigurationError, match="'d': 'min' is not a column"):
        pareto_front(table, {"d": "min"})
    with pytest.raises(pa.ConfigurationError, match="'least'"):
        pareto_front(table, {"a": "least"})
    for odd in (["x", "y", "z"], [object()] * 3, [10**400] * 3):
        with pytest.raises(pa.ConfigurationError, match="column 'o'"):
            pareto_front(pd.DataFrame({"o": odd}), {"o": "min"})


# ----------------------------------------------------------------------------- figures


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    """y fails above 2, metric grows with x."""
    places = [(x, y) for x in (1.0, 2.0, 3.0, 4.0) for y in (1.0, 2.0, 3.0)]
    frame = pd.DataFrame(places, columns=["x", "y"])
    frame["m"] = np.where(frame["y"] > 2, np.nan, frame["x"])
    frame["failure"] = np.where(frame["y"] > 2, "unreachable", None)
    return frame.assign(reason=None)


def colours(path: Path, share: tuple[float, float]) -> tuple[float, float, float]:
    """The colour at a place of a picture, in shares of its width and height from below."""
    image = imread(path)
    height, width, _ = image.shape
    red, green, blue = image[int((1 - share[1]) * height), int(share[0] * width), :3]
    return float(red), float(green), float(blue)


def test_main_effects_are_kelleys_of_fishers_ratio() -> None:
    """With F = (between / (k - 1)) / (within / (n - k)), by scipy: a fraction of the variance."""
    random = np.random.default_rng(2)
    x, other = np.repeat([1.0, 2.0, 4.0], 5), np.tile([0.0, 1.0, 2.0, 3.0, 4.0], 3)
    made = pd.DataFrame({"x": x, "y": other, "m": 0.3 * x + random.normal(size=15)})
    found = main_effects(made, ["x", "y"], "m")
    for name, groups in (("x", 3), ("y", 5)):
        ratio = stats.f_oneway(*(part["m"] for _, part in made.groupby(name))).statistic
        between = groups - 1
        share = between * (ratio - 1) / (between * ratio + len(made) - groups)
        assert found[name] == pytest.approx(max(0.0, share), abs=1e-12)
    assert 0 < found["x"] < 1


def test_maps_have_their_cells_where_they_are(table: pd.DataFrame, tmp_path: Path) -> None:
    """Viridis: dark blue is little, yellow is much; grey is not known."""
    shown = study_plots(table, ("x", "y"), ("x", "y"))
    assert list(shown) == ["map_m"]
    up, senses = table.dropna(subset="m"), {"x": "max", "m": "min"}
    shown["front"] = [front_plot(up, pareto_front(up, senses), senses)]
    for name, plots in shown.items():
        write_plots(plots, tmp_path / f"{name}.png")
        assert np.ptp(imread(tmp_path / f"{name}.png")[..., :3], axis=(0, 1)).min() > 0.5
    little, much = (colours(tmp_path / "map_m.png", (at, 0.35)) for at in (0.2, 0.75))
    assert little[2] > little[0] + 0.05
    assert much[0] > much[2] + 0.3
    unknown = colours(tmp_path / "map_m.png", (0.3, 0.8))
    assert unknown == pytest.approx((0.93, 0.93, 0.93), abs=0.01)


def test_a_panel_for_each_value_of_another_variable_and_crossed_means_of_more(
    table: pd.DataFrame, tmp_path: Path
) -> None:
    """Where z = 2 all of y > 1 fail: beside the panel of z = 1; or in a mean, which is crossed."""
    other = table.assign(z=2.0, m=np.where(table["y"] > 1, np.nan, table["m"]))
    both = pd.concat([table.assign(z=1.0), other], ignore_index=True)
    shown = split_panels(both[::-1], ["x", "y", "z"], "x", "y")  # in whichever order they are done
    assert [panel.fixed for panel in shown] == [{"z": 1.0}, {"z": 2.0}]
    assert not any(mean_map(one.table, "x", "y", "m").partial.any() for one in shown)
    many = both.assign(z=np.arange(len(both), dtype=float))
    (whole,) = split_panels(many, ["x", "y", "z"], "x", "y")
    assert whole.averaged == ("z",)
    found = mean_map(whole.table, "x", "y", "m")
    assert found.partial.tolist() == [[False] * 4, [True] * 4, [False] * 4]
    assert (found.counts[1] / found.designs[1]).tolist() == [0.5] * 4
    for name, given in (("panels", both), ("mean", many), ("plain", table)):
        plots = mean_plots(given, "x", "y", "m", ["x", "y", "z"])
        write_plots(plots, tmp_path / f"{name}.png")
    panels, mean, plain = (imread(tmp_path / f"{n}.png") for n in ("panels", "mean", "plain"))
    assert panels.shape[1] >= plain.shape[1]
    grey = to_rgb(drawing.GREY)
    lines = [int((np.abs(one[..., :3] - grey).max(axis=2) < 0.02).sum()) for one in (mean, plain)]
    assert lines[0] > lines[1] + 100  # across the cells
    with pytest.raises(pa.ConfigurationError, match="no 'z'; there are x, y, m"):
        mean_plots(table, "x", "z", "m")
    with pytest.raises(pa.ConfigurationError, match="it is empty"):
        mean_plots(table.iloc[:0], "x", "y", "m")


def test_randomisation_as_yaml(tmp_path: Path) -> None:
    yaml = pytest.importorskip("yaml")
    vary = {
        "mass:leg_*_3": pa.study.normal(1.0, 0.05),
        "effort:each": pa.study.uniform(0.9, 1.1),
        "com_y:base_link": pa.study.uniform(-0.01, 0.1 + 0.2),  # 0.30000000000000004
        "kp": pa.study.uniform(4, 6),
        "leg_scale": [0.9, 1.1],
        "payload": pa.study.linspace(0, 1, 3),
    }
    study = pa.Study("v3", vary, ["sag"], samples=4)
    write_randomisation(study.spreads, tmp_path / "random.yaml")
    read = yaml.safe_load((tmp_path / "random.yaml").read_text())
    assert read == [
        {"name": "mass:leg_*_3", "operation": "scale", "drawn": "once", "distribution": "normal",
         "mean": 1.0, "std": 0.05},
        {"name": "effort:each", "operation": "scale", "drawn": "for each",
         "distribution": "uniform", "low": 0.9, "high": 1.1},
        {"name": "com_y:base_link", "operation": "add", "drawn": "once", "distribution": "uniform",
         "low": -0.01, "high": 0.3},
        {"name": "kp", "operation": "absolute", "distribution": "uniform", "low": 4.0, "high": 6.0},
        {"name": "leg_scale", "operation": "scale", "distribution": "values", "values": [0.9, 1.1]},
        {"name": "payload", "operation": "absolute", "distribution": "linspace", "low": 0.0,
         "high": 1.0, "count": 3.0},
    ]  # fmt: skip


def test_what_is_recorded_can_be_said_again_in_any_language() -> None:
    missed = diagnose(
        "foot-misses-target",
        subject=("foot", "FL"),
        gap=Quantity(0.002, "m"),
        sources=Source("a.urdf", 7, "joint/limit", "effort"),
    )
    within = diagnose(
        "name-unknown", kind=Term("joint"), unknown="joint", known=("a", "term: joint")
    )
    one = diagnose(
        "com-moved-otherwise",
        body="base",
        moved=Vector((0.0, 1.5, 0.0), "m"),
        asked=Vector((0.0, 0.0, 0.0), "m"),
    )
    said = diagnose("problem", problem=Phrase("height 1 m", "高度 1 m"))
    whole = diagnose("argument-not-valid", field="f", problem=within)
    for kept in (missed, within, one, said, whole):
        again = from_record(json.loads(json.dumps(to_record(kept))))
        assert again == kept
        assert (again.text("en"), again.text("zh")) == (kept.text("en"), kept.text("zh"))
