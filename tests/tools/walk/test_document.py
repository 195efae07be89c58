"""Documents of walks and of orders of joints."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.present.document import NextStep, text
from pupper_analysis.tools.walk import document
from pupper_analysis.tools.walk.document import _format_range, _max_over_runs, orders_document
from pupper_analysis.tools.walk.orders import Candidate, Orders
from tests.support.printing import printed


def test_motor_table_contains_the_largest_value_of_all_runs_per_motor() -> None:
    runs = [SimpleNamespace(torque_peak=np.array(peak)) for peak in ([1.0, 5.0], [3.0, 2.0])]
    walk: Any = SimpleNamespace(gaits=runs, joints=("hip",))
    np.testing.assert_array_equal(_max_over_runs(walk, "torque_peak"), [3.0, 5.0])


@pytest.mark.parametrize(
    ("units", "torque", "speed"),
    [
        (("N m", "N m"), "N m", "rad/s"),
        (("N", "N"), "N", "m/s"),
        (("N m", "N"), "N m or N", "rad/s or m/s"),
    ],
)
def test_units_of_the_motor_table_are_those_of_hinges_and_slides(
    monkeypatch: pytest.MonkeyPatch, units: tuple[str, str], torque: str, speed: str
) -> None:
    """The units of the columns and of the torque plot follow from the kinds of the joints."""
    values = np.array([1.0, 2.0])
    names = ("torque_rms", "torque_peak", "at_limit", "speed_peak", "static", "torque_time")
    gait = SimpleNamespace(**dict.fromkeys(names, values), torques=np.ones((2, 2)))
    joints = ("hip", "lift")
    walk: Any = SimpleNamespace(gaits=[gait], joints=joints, limits=values, torque_units=units)
    monkeypatch.setattr(document, "_describe_simulation", lambda _: text("walk-own-gains"))
    table = document._make_motor_table(walk)
    expected = ["", *[torque] * 4, "%", speed]
    assert [column.unit for column in table.columns] == expected
    assert document.walk_torque_plot(walk).y.unit == torque


def test_velocity_line_states_the_commands_that_are_not_zero() -> None:
    """Reference: velocities and commands [m/s, rad/s]; a long line had 117 characters."""

    def format_velocities(command: tuple[float, float, float]) -> str:
        gait = SimpleNamespace(
            velocity=(0.304, -0.001), turning=0.2, command=command, power=1.0, transport=None,
            margin=1.0, duty={}, torque_rms=np.ones(1), torque_peak=np.ones(1), at_limit=np.ones(1),
        )  # fmt: skip
        walk: Any = SimpleNamespace(
            gaits=[gait], joints=("hip",), limits=np.ones(1), torque_units=("N m",)
        )
        return next(iter(document._list_figures(walk))).short

    assert format_velocities((0.5, 0.0, 0.0)) == "forward 0.3 of 0.5, left 0 m/s, turning 0.2 rad/s"
    expected = "forward 0.3 of 0, left 0 of 0.1 m/s, turning 0.2 of -1 rad/s"
    assert format_velocities((0.0, 0.1, -1.0)) == expected


def test_unknown_limit_of_a_slide_has_a_force_in_newtons() -> None:
    gait = SimpleNamespace(torque_peak=np.array([3.0, 40.0]))
    walk: Any = SimpleNamespace(
        gaits=[gait],
        joints=("hip", "lift"),
        limits=np.array([np.inf, np.inf]),
        torque_units=("N m", "N"),
    )
    (line,) = document._list_limit_warnings(walk)
    assert "40.00 N (lift)" in str(line)


def make_orders(tracked: tuple[int, int]) -> Orders:
    """Return two interpretations; the second is the stated one, with a cost of 1.05 of the first.

    Args:
        tracked: Number of tracked commands of each interpretation.
    """
    candidates = tuple(
        Candidate(change, "", ("hip", "knee"), flipped, count, 0, 2.0, 0.0, cost)
        for change, flipped, count, cost in (
            ("sign", ("knee",), tracked[0], 2.0),
            ("stated", (), tracked[1], 2.1),
        )
    )
    lead = 1.05 if tracked[0] == tracked[1] else None
    return Orders("v3", "still.json", np.zeros((3, 3)), candidates, 1, lead, 3.0)


@pytest.mark.parametrize(
    ("tracked", "word", "passed", "following"),
    [
        ((0, 0), "NONE WALKS", False, ("audit", ())),
        ((3, 1), "ANOTHER INTERPRETATION WALKS BETTER", False, ("walk", ("--init",))),
        ((3, 3), "NOT DETERMINED", True, ("walk", ("--response",))),
    ],
)
def test_verdict_of_orders_depends_on_the_tracked_commands(
    tracked: tuple[int, int], word: str, passed: bool, following: tuple[str, tuple[str, ...]]
) -> None:
    """No interpretation walks; another one tracks more commands; both walk equally well."""
    orders = make_orders(tracked)
    assert (orders.passed, orders.determined) == (passed, tracked == (3, 1))
    assert printed(orders).startswith(f"{word} v3")
    step = orders_document(orders).next_step
    assert step is not None
    assert (step.command, step.words) == following


def test_orders_of_a_robot_with_an_assumed_mass_do_not_pass() -> None:
    """The ranking is that of another robot: the torques depend on the mass."""
    remark = diagnose(
        "link-masses-unknown",
        links=["calf"],
        count=1,
        bounded=[],
        bound=None,
        before_bounded=False,
        both=False,
        negative=[],
    )
    orders = replace(make_orders((3, 3)), remarks=(remark,))
    assert orders.stated in orders.alike
    assert not orders.passed
    assert printed(orders).startswith("UNKNOWN v3")
    assert "calf" in printed(orders)
    assert orders_document(orders).next_step == NextStep("audit")


def test_range_of_values_with_equal_digits_is_a_single_number() -> None:
    assert _format_range(np.array([5.0, 5.0 + 1e-9])) == "5"
    assert _format_range(np.array([2.0, 5.0, 3.0])) == "2..5"
    assert _format_range(np.array([-0.52, 0.52])) == "-0.52..0.52"


@pytest.mark.parametrize(
    ("tracks", "duty", "count"),
    [
        (False, ({"FL": 1.0, "FR": 1.0}, {"FL": 1.0, "FR": 1.0}), 1),
        (False, ({"FL": 1.0, "FR": 1.0}, {"FL": 1.0, "FR": 0.99}), 0),
        (True, ({"FL": 1.0, "FR": 1.0}, {"FL": 1.0, "FR": 1.0}), 0),
        (False, ({}, {}), 0),
    ],
)
def test_missing_steps_are_reported_if_no_foot_leaves_the_ground_in_any_run(
    tracks: bool, duty: tuple[dict[str, float], ...], count: int
) -> None:
    runs = [SimpleNamespace(tracks=tracks, duty=share, largest_action=0.5) for share in duty]
    walk: Any = SimpleNamespace(gaits=runs, joints=("hip",))
    assert len(list(document._describe_missing_steps(walk))) == count
