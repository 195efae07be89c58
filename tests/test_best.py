"""The best stance: better than the nominal one, locally the best, and one that holds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import SKELETON_NAMES, load

import pupper_analysis as pa
from pupper_analysis.best import LEAST_MOBILITY, BestStance, Objective, best_stance
from pupper_analysis.payload import payload_limit
from pupper_analysis.stand import stand_statics

SIGN = {Objective.UTILISATION: -1, Objective.MARGIN: 1, Objective.PAYLOAD: 1}
CASES = [
    *((name, Objective.UTILISATION) for name in ("original", "v3-long-leg")),
    *((name, kind) for name in ("v3",) for kind in list(Objective)[1:]),
]


def value(robot: pa.Robot, stand: pa.Stand, objective: Objective) -> float:
    if objective is Objective.PAYLOAD:
        return payload_limit(robot, stand).mass
    statics = stand_statics(robot, stand, sharing=pa.LoadSharing.EVEN)
    if objective is Objective.UTILISATION:
        return float(statics.motor_utilisation.max())
    assert statics.com_margin is not None
    return statics.com_margin


def mobility(robot: pa.Robot, stand: pa.Stand) -> np.ndarray:
    """The least singular value of each leg's Jacobian."""
    legs = pa.Configuration(robot, stand.qpos).foot_jacobians().values()
    values = []
    for jacobian in legs:
        columns = jacobian[:, 6:]
        values.append(np.sqrt(max(0.0, np.linalg.eigvalsh(columns @ columns.T)[0])))
    return np.array(values)


def neighbour(robot: pa.Robot, found: BestStance, change: dict[str, float]) -> pa.Stand | None:
    """The stance with other coordinates, if it is one that the search may take."""
    at = {name: found.coordinates[name] + step for name, step in change.items()}
    for name, interval in found.bounds.items():
        at[name] = min(max(at[name], interval.low), interval.high)
    nominal = found.nominal
    centre = np.mean(list(nominal.contact_points.values()), axis=0)
    offsets = {}
    for foot, target in nominal.foot_targets.items():
        forward, left = np.sign(target[:2] - centre[:2])
        offsets[foot] = (forward * at["length"], left * at["width"])
    task = pa.StandTask(
        height=at["height"],
        pitch=at["pitch"],
        offset=(at["x"], float(nominal.qpos[1] - centre[1])),
        foot_offsets=offsets,
    )
    try:
        stand = pa.solve_stand(robot, task, explain=False)
    except pa.StanceUnreachableError:
        return None
    free = (mobility(robot, stand) >= LEAST_MOBILITY * mobility(robot, nominal)).all()
    return stand if free else None


@pytest.mark.parametrize(("name", "objective"), CASES)
def test_better_than_the_nominal_stand_and_than_its_neighbours(
    name: str, objective: Objective
) -> None:
    robot, found = load(name), best_stance(load(name), objective)
    if name == "original":
        assert best_stance(robot, objective).to_json() == found.to_json()
    assert found.value == pytest.approx(value(robot, found.stand, objective), rel=1e-6)
    nominal = value(robot, pa.solve_stand(robot), objective)
    assert found.nominal_value == pytest.approx(nominal, rel=1e-6)
    ratio = (found.value / found.nominal_value) ** SIGN[objective]
    assert ratio > 1.3
    assert found.evaluations < 700
    random, tried = np.random.default_rng(3), 0
    for scale in np.geomspace(0.003, 0.2, 60):
        change = {
            name: scale * (bound.high - bound.low) * random.standard_normal()
            for name, bound in found.bounds.items()
        }
        stand = neighbour(robot, found, change)
        if stand is None:
            continue
        try:
            other = value(robot, stand, objective)
        except pa.StaticsInfeasibleError:
            continue
        tried += 1
        assert (found.value / other) ** SIGN[objective] > 0.98, change
    assert tried > 5
    assert_symmetric_and_held(name, found)
    if objective is Objective.MARGIN:
        assert "length high" in found.active
        high = found.bounds["length"].high
        assert found.coordinates["length"] == pytest.approx(high, rel=1e-3)
    else:
        assert any("stretched" in what for what in found.active)


def assert_symmetric_and_held(name: str, found: BestStance) -> None:
    robot = load(name)
    stand = found.stand
    assert stand.foot_error < 1e-9
    joints = stand.joint_positions(robot)
    assert (joints >= robot.lower_limits - 1e-9).all()
    assert (joints <= robot.upper_limits + 1e-9).all()
    for coordinate, interval in found.bounds.items():
        assert interval.low - 1e-12 <= found.coordinates[coordinate] <= interval.high + 1e-12
    statics = stand_statics(robot, stand)
    assert statics.residual_force < 1e-9
    assert statics.residual_torque < 1e-9
    assert statics.com_margin is not None
    assert statics.com_margin > 0
    assert max(statics.friction_utilisation.values()) <= 1 + 1e-6
    places = pa.Configuration(robot, stand.qpos).foot_positions()
    for left, right in (("FL", "FR"), ("RL", "RR")):
        np.testing.assert_allclose(places[left] * (1, -1, 1), places[right], atol=1e-8)
        torques = [
            np.abs(statics.joint_torques[[i for i, j in enumerate(robot.joint_names) if foot in j]])
            for foot in ((left, right) if name in SKELETON_NAMES else ())
        ]
        if torques:
            np.testing.assert_allclose(*torques, atol=1e-5)
    report = pa.verify_stand(robot, stand)
    assert not any("touches the ground" in failure for failure in report.failures)


def test_the_rest_of_the_task_stays() -> None:
    robot = load("v3")
    ground = pa.Ground(slope=0.1, uphill=1.0)
    task = pa.StandTask(
        roll=0.05, ground=ground, feet={"FL": (0.07, 0.10)}, joint_margin=0.1, com_margin=0.04
    )
    found = best_stance(robot, task=task)
    assert found.value < found.nominal_value
    kept = replace(
        found.stand.task,
        height=None,
        pitch=0.0,
        offset=None,
        foot_offsets={},
    )
    assert kept == task
    np.testing.assert_allclose(found.stand.foot_targets["FL"][:2], (0.07, 0.10))
    joints = found.stand.joint_positions(robot)
    assert (joints >= robot.lower_limits + 0.1 - 1e-9).all()
    assert (joints <= robot.upper_limits - 0.1 + 1e-9).all()
    margin = stand_statics(robot, found.stand).com_margin
    assert margin is not None
    assert margin >= 0.04


def test_the_simulation_confirms_it() -> None:
    """But for soft ground, which tilts a robot whose feet bear unequal loads."""
    robot = load("v3")
    found = best_stance(robot)
    report = pa.verify_stand(robot, found.stand)
    peak = np.abs(report.joint_torques / robot.effort_limits).max()
    assert peak == pytest.approx(found.value, rel=0.1)
    assert found.value < 0.6 * found.nominal_value


def test_least_torque() -> None:
    robot = load("v3")
    found = best_stance(robot, sharing=pa.LoadSharing.LEAST_TORQUE)
    statics = stand_statics(robot, found.stand, sharing=pa.LoadSharing.LEAST_TORQUE)
    assert found.value == pytest.approx(statics.motor_utilisation.max(), rel=1e-6)
    assert found.value < 0.6 * found.nominal_value


def test_a_payload_elsewhere_is_carried_better() -> None:
    robot, point = load("v3"), (0.05, 0.0, 0.05)
    found = best_stance(robot, Objective.PAYLOAD, point=point)
    assert found.value == pytest.approx(payload_limit(robot, found.stand, point).mass, rel=1e-6)
    assert found.value > 2 * payload_limit(robot, pa.solve_stand(robot), point).mass


def test_wrong_requests() -> None:
    robot = load("v3")
    with pytest.raises(pa.ConfigurationError, match="objective"):
        best_stance(robot, "speed")  # type: ignore[arg-type]
    with pytest.raises(pa.ConfigurationError, match="point"):
        best_stance(robot, Objective.PAYLOAD, point=(0.0, 0.0))  # type: ignore[arg-type]
    with pytest.raises(pa.StanceUnreachableError):
        best_stance(robot, task=pa.StandTask(height=0.5))
    with pytest.raises(pa.ConfigurationError, match="robot"):
        best_stance(load("v3", fixed_base=True))
