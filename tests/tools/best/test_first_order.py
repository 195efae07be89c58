"""Linearised payload limits: the stiffness of settled stands, compared with the buckling load."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.robot.servos import model_with_servos
from pupper_analysis.robot.tool import find_place, find_tool
from pupper_analysis.stance.soft_ground import solve_loaded_stand
from pupper_analysis.tools.best import first_order
from pupper_analysis.tools.best.first_order import SmallPayload, largest_feasible_mass
from tests.support.legged import biped
from tests.support.variants import NAMES, load, stand_of


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "task", "link", "point"),
    [
        *((name, pa.StandTask(), None, (0.0, 0.0, 0.0)) for name in NAMES),
        ("v3", pa.StandTask(roll=0.05, pitch=0.1, yaw=0.2), None, (0.05, 0.02, 0.1)),
        ("v3", pa.StandTask(roll=0.05, pitch=0.1), "leg_front_l_1", (0.02, 0.01, 0.1)),
    ],
)
def test_settled_pose_is_unstable_at_the_buckling_load(
    name: str,
    task: pa.StandTask,
    link: str | None,
    point: tuple[float, float, float],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Reference: sign of the stiffness of the steady state at 98 % and 102 % of the limit.

    The limit is substituted four times, since the depths under load change the configuration.
    """
    robot = load(name)
    stand = pa.solve_stand(robot, task)
    feet = np.mean(list(stand.contact_points.values()), axis=0)
    x, y = (stand.qpos[:2] - feet[:2]).tolist()
    task = replace(task, offset=(x, y))  # the base stays, as in the search for the best stance
    place = find_tool(robot, link).translated(point) if link else find_place(robot, point)
    kp, mass, sunk = model_with_servos(robot).kp, 0.3, stand
    for _ in range(4):
        _, sunk = solve_loaded_stand(robot, task, mass, place)
        monkeypatch.setattr(
            first_order, "SMALL_PAYLOAD_RATIO", mass / robot.total_mass
        )  # stiffness under the payload
        rows = SmallPayload(robot, place, kp).compute_rows(sunk)
        assert rows is not None
        mass = largest_feasible_mass(rows[:1])
    signs = []
    for share in (0.98, 1.02):
        heavy, held = solve_loaded_stand(robot, task, share * mass, place)
        try:
            signs.append(np.sign(pa.steady_state(heavy, held, feedforward=True).stiffness))
        except pa.NoEquilibriumError:  # no equilibrium: beyond the buckling load
            signs.append(-1.0)
    assert signs == [1, -1]


def test_servos_too_soft_without_payload_give_no_rows() -> None:
    """Servos of 0.5 N m/rad hold v3 in no pose: the stand buckles without payload."""
    robot, stand = load("v3"), stand_of("v3")
    place = find_place(robot, (0.0, 0.0, 0.0))
    assert SmallPayload(robot, place, np.full(12, 0.5)).compute_rows(stand) is None
    assert SmallPayload(robot, place, np.full(12, 5.0)).compute_rows(stand) is not None


def test_sole_may_tilt_although_its_points_sink_by_different_depths(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reference: the same stand with equal depths of all points of the soles.

    With depths that differ by up to 0.1 um, soles that tilted counted as sliding. The ankles did
    not buckle, and ``best payload`` of H1 ended with an error, because neighbouring stances had
    different numbers of rows.
    """
    pair = biped(tmp_path)
    robot = pa.load_robot(urdf=pair.urdf, mjcf=pair.mjcf)
    stand = pa.solve_stand(robot)
    kp = np.full(robot.nu, 3 * robot.weight * robot.stand_height)
    small = SmallPayload(robot, find_place(robot, (0.0, 0.0, 0.1)), kp)
    compute_modes: Any = first_order._compute_buckling_modes

    found = []
    for difference in (0.0, 1e-7):

        def compute_with_depths(*arguments: Any, difference: float = difference) -> Any:
            *others, depths = arguments
            steps = difference * np.arange(len(depths)) / len(depths)
            return compute_modes(*others, depths.mean() + steps)

        monkeypatch.setattr(first_order, "_compute_buckling_modes", compute_with_depths)
        found.append(small.compute_rows(stand))
    assert found[0] is not None
    assert found[1] is not None
    assert found[0].shape == found[1].shape
    np.testing.assert_allclose(found[0], found[1], rtol=1e-3, atol=1e-9)
