"""The best stance: better than the nominal stand and its neighbours, and held in MuJoCo."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial import ConvexHull

import pupper_analysis as pa
from pupper_analysis.base.diagnostics import diagnose
from pupper_analysis.robot.servos import model_with_servos
from pupper_analysis.robot.tool import find_place
from pupper_analysis.stance.soft_ground import solve_stand_as_simulated
from pupper_analysis.stance.stand import stand_statics
from pupper_analysis.tools.best import best, search
from pupper_analysis.tools.best.best import best_stance
from pupper_analysis.tools.best.first_order import SmallPayload, largest_feasible_mass
from pupper_analysis.tools.best.search import Objective, StanceSearch, Subspace
from pupper_analysis.tools.best.space import BASE_COORDINATES, MIN_SINGULAR_VALUE_RATIO, StanceSpace
from tests.support.engines import evaluate_mujoco, with_efforts
from tests.support.legged import biped
from tests.support.random_legged import draw_robot, write_robot
from tests.support.variants import load

EVEN = pa.statics.ForceDistribution.MIN_TANGENTIAL


@pytest.fixture
def few_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    """Shorten the search in tests that do not check how good the best stance is."""
    monkeypatch.setattr(search, "_SAMPLE_COUNT", 8)
    monkeypatch.setattr(search, "_START_COUNT", 1)


def utilisation(robot: pa.Robot, stand: pa.Stand) -> float:
    return float(stand_statics(robot, stand, distribution=EVEN).motor_utilisation.max())


def com_margin(robot: pa.Robot, stand: pa.Stand) -> float:
    margin = stand_statics(robot, stand, distribution=EVEN).com_margin
    assert margin is not None
    return margin


def compute_leg_singular_values(robot: pa.Robot, stand: pa.Stand) -> np.ndarray:
    """Return the least singular value of each leg's Jacobian."""
    values = []
    for jacobian in pa.Configuration(robot, stand.qpos).foot_jacobians().values():
        columns = jacobian[:, 6:]
        values.append(np.sqrt(max(0.0, np.linalg.eigvalsh(columns @ columns.T)[0])))
    return np.array(values)


def neighbours(robot: pa.Robot, found: pa.analysis.BestStance, count: int) -> list[pa.Stand]:
    """Stands near the best one, in all coordinates, that the search may take."""
    space, random = StanceSpace(robot, found.nominal.task), np.random.default_rng(3)
    at = np.array(list(found.coordinates.values()))
    low = np.array([interval.low for interval in found.bounds.values()])
    high = np.array([interval.high for interval in found.bounds.values()])
    stands = []
    for scale in np.geomspace(1e-3, 0.2, count):
        step = scale * (high - low) * random.standard_normal(len(at))
        task = space.make_task(np.clip(at + step * (random.random(len(at)) < 0.4), low, high))
        try:
            stand = pa.solve_stand(robot, task, explain=False)
        except pa.StanceUnreachableError:
            continue
        if (
            compute_leg_singular_values(robot, stand)
            >= MIN_SINGULAR_VALUE_RATIO * compute_leg_singular_values(robot, found.nominal)
        ).all():
            stands.append(stand)
    return stands


def check_kept(robot: pa.Robot, found: pa.analysis.BestStance) -> None:
    """Assert that the stance is in reach, inside all bounds, and balanced."""
    assert found.stand.foot_error < 1e-9
    joints = found.stand.joint_positions(robot)
    assert (joints >= robot.lower_limits - 1e-9).all()
    assert (joints <= robot.upper_limits + 1e-9).all()
    for name, interval in found.bounds.items():
        assert interval.low - 1e-12 <= found.coordinates[name] <= interval.high + 1e-12
    least = MIN_SINGULAR_VALUE_RATIO * compute_leg_singular_values(robot, found.nominal)
    assert (compute_leg_singular_values(robot, found.stand) >= least * (1 - 1e-9)).all()
    statics = stand_statics(robot, found.stand, distribution=EVEN)
    assert statics.residual_force < 1e-9
    assert com_margin(robot, found.stand) > 0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["original", "v3"])
def test_best_stance_has_the_least_utilisation(name: str) -> None:
    """References: random neighbours in all coordinates (0.5 % for their sampling), and MuJoCo's
    motor torques at rest.
    """
    robot, found = load(name), best_stance(load(name))
    check_kept(robot, found)
    held, nominal = (
        solve_stand_as_simulated(robot, stand) for stand in (found.stand, pa.solve_stand(robot))
    )
    assert found.value == pytest.approx(utilisation(robot, held), rel=1e-9)
    assert found.nominal_value == pytest.approx(utilisation(robot, nominal))
    least = utilisation(robot, found.stand)
    assert found.value < 0.5 * found.nominal_value
    near = neighbours(robot, found, 60)
    assert len(near) > 5
    for stand in near:
        assert utilisation(robot, stand) > 0.995 * least
    assert found.payload is None
    report = pa.verify_stand(robot, pa.stance.solve_stand_on_soft_ground(robot, found.stand.task))
    peak = np.abs(report.joint_torques / robot.effort_limits).max()
    assert peak == pytest.approx(found.value, rel=1e-3)


@pytest.mark.slow
def test_best_stance_has_the_largest_margin() -> None:
    """Reference: half of the support length, with the CoM equally far from the nearest edges,
    and the feet at the largest offsets."""
    robot, found = load("v3"), best_stance(load("v3"), "margin")
    check_kept(robot, found)
    assert found.value == pytest.approx(com_margin(robot, found.stand), rel=1e-9)
    half = np.ptp([place[0] for place in found.stand.contact_points.values()]) / 2
    assert found.value == pytest.approx(half, rel=1e-4)
    for foot in robot.contact_points:
        assert abs(found.coordinates[f"{foot} x"]) > 0.04


@pytest.mark.slow
@pytest.mark.usefixtures("few_samples")
def test_redundant_joints_of_the_best_stance_equal_its_task(tmp_path: Path) -> None:
    """Reference: ``solve_stand`` of the returned task, bit by bit.

    Legs of four joints have a free joint, which a search from a near stand leaves 4e-8 rad away.
    """
    pair = write_robot(draw_robot(91004), tmp_path)
    robot = pa.load_robot(pair.urdf, pair.mjcf)
    found = best_stance(robot, Objective.MARGIN)
    typed = pa.solve_stand(robot, found.stand.task)
    np.testing.assert_array_equal(found.stand.qpos, typed.qpos)
    assert found.value > found.nominal_value


@pytest.mark.slow
@pytest.mark.usefixtures("shared_rollouts")
@pytest.mark.parametrize("name", ["original", "v3"])
def test_largest_payload_holds_in_mujoco(name: str) -> None:
    """The trial with the payload survives nudges; with 5 % more the verdict fails."""
    robot, found = load(name), best_stance(load(name), Objective.PAYLOAD)
    check_kept(robot, found)
    assert found.payload is not None
    assert found.value == found.payload.mass
    nominal = pa.payload_limit(robot, pa.solve_stand(robot)).mass
    assert found.nominal_value == pytest.approx(nominal, rel=1e-9)
    # The nominal stand moves its base under the load, and original's hips bear most there already:
    # both payloads are found to 2 %, where simulation limits them.
    assert found.value > (3 if name == "v3" else 0.98) * nominal
    below = found.payload.trial
    assert below is not None
    assert below.survived, (below.failure, below.failing_parts)
    more = pa.robot.with_payload(robot, 1.05 * found.value)
    assert not pa.judge_stand(more, pa.solve_stand(more, found.stand.task)).passed


@pytest.mark.slow
@pytest.mark.usefixtures("few_samples")
def test_best_stance_for_an_offset_payload_carries_more_than_its_neighbours() -> None:
    """Random neighbours carry at most 0.5 % more, and the nominal stand less than half."""
    robot, point = load("v3"), (0.05, 0.0, 0.05)
    found = StanceSearch(robot, Objective.PAYLOAD, point=point)
    found.run()
    small = SmallPayload(robot, find_place(robot, point), model_with_servos(robot).kp)

    def find_payload(stand: pa.Stand) -> float:
        rows = small.compute_rows(stand)
        return 0.0 if rows is None else largest_feasible_mass(rows)

    best = find_payload(found.best.stand)
    assert best > 2 * find_payload(found.space.nominal)
    shares, random = Subspace(found.space, found.best.coordinates, np.eye(14)), None
    random, allowed = np.random.default_rng(4), 0
    for scale in np.geomspace(1e-3, 0.1, 30):
        place = shares.compute_coordinates(
            np.clip(shares.start + scale * random.standard_normal(14), 0, 1)
        )
        stance = found.evaluate(place)
        if stance is not None and stance.allowed:
            assert find_payload(stance.stand) < 1.005 * best
            allowed += 1
    assert allowed >= 5


@pytest.mark.slow
@pytest.mark.parametrize("objective", list(Objective))
def test_unit_of_scaled_objectives_fits_the_objective_if_its_initial_value_is_zero(
    objective: Objective, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reference: utilisation has no unit; scales of margin [m] and payload [kg] of v3."""
    zero = SimpleNamespace(scaled_objective=0.0)
    monkeypatch.setattr(StanceSearch, "evaluate_stand", lambda *_: zero)
    robot = load("v3")
    unit = StanceSearch(robot, objective).scale
    expected = {"utilisation": 1.0, "margin": robot.stand_height, "payload": robot.total_mass}
    assert unit == expected[objective.value]


@pytest.mark.slow
@pytest.mark.usefixtures("few_samples")
def test_asymmetric_stance_is_optimised_over_all_free_parameters() -> None:
    """On three legs, the CoM must move sideways into the support triangle."""
    robot = load("v3")
    task = pa.StandTask(swing={"FL": 0.02}, com="inside", com_margin=0.01)
    found = best_stance(robot, task=task)
    assert not StanceSpace(robot, task).is_symmetric
    assert StanceSpace(robot, pa.StandTask()).is_symmetric
    assert found.stand.stance_feet == tuple(foot for foot in robot.contact_points if foot != "FL")
    # Search from one start; the complete search reaches 0.49 of the nominal value.
    assert found.value < 0.85 * found.nominal_value
    assert found.coordinates["y"] < -0.005
    assert com_margin(robot, found.stand) >= 0.01


@pytest.mark.slow
@pytest.mark.usefixtures("few_samples")
def test_best_stance_keeps_the_fixed_part_of_the_task() -> None:
    """Slope, position of one foot, joint margin of 0.1 rad and CoM margin of 40 mm."""
    robot = load("v3")
    ground = pa.Ground(slope=0.1, uphill=1.0)
    task = pa.StandTask(
        roll=0.05, ground=ground, feet={"FL": (0.07, 0.10)}, joint_margin=0.1, com_margin=0.04
    )
    found = best_stance(robot, task=task)
    assert found.value < found.nominal_value
    assert found.stand.task.com == "centre"  # the default
    free = {"com": None, "height": None, "roll": 0.05, "pitch": 0.0, "yaw": 0.0, "offset": None}
    assert replace(found.stand.task, foot_offsets={}, **free) == task
    np.testing.assert_allclose(found.stand.foot_targets["FL"][:2], (0.07, 0.10))
    assert "FL x" not in found.coordinates
    assert set(BASE_COORDINATES) < set(found.coordinates)
    joints = found.stand.joint_positions(robot)
    assert (joints >= robot.lower_limits + 0.1 - 1e-9).all()
    assert (joints <= robot.upper_limits - 0.1 + 1e-9).all()
    assert com_margin(robot, found.stand) >= 0.04


def test_best_stance_refuses_wrong_requests() -> None:
    """Invalid arguments, an unreachable task, and servos too soft for an equilibrium."""
    robot = load("v3")
    with pytest.raises(pa.ConfigurationError, match="objective"):
        best_stance(robot, "speed")
    with pytest.raises(pa.ConfigurationError, match="point"):
        best_stance(robot, Objective.PAYLOAD, point=(0.0, 0.0))  # type: ignore[arg-type]
    with pytest.raises(pa.StanceUnreachableError):
        best_stance(robot, task=pa.StandTask(height=0.5))
    with pytest.raises(pa.ConfigurationError, match="robot"):
        best_stance(load("v3", fixed_base=True))
    with pytest.raises(pa.NoEquilibriumError) as caught:
        best_stance(robot, Objective.PAYLOAD, kp=0.5, kd=0.1)
    assert caught.value.share is None  # no feed-forward was taken away


@pytest.mark.parametrize(("limit", "words"), [(0.0, "leg_front_r_1"), (np.inf, "no motor")])
def test_motors_with_zero_or_unknown_limit_are_refused(limit: float, words: str) -> None:
    robot = with_efforts(load("v3"), limit)
    for objective in (Objective.UTILISATION, Objective.PAYLOAD):
        with pytest.raises(pa.ConfigurationError, match=words):
            best_stance(robot, objective)


@pytest.mark.slow
def test_next_best_stance_is_returned_if_the_best_does_not_hold(
    monkeypatch: pytest.MonkeyPatch, few_samples: None
) -> None:
    """Three stances are simulated, with increasing motor utilisation; the third holds."""
    utilisations: list[float] = []

    def fail_twice(robot: pa.Robot, stand: pa.Stand, **_: object) -> SimpleNamespace:
        statics = stand_statics(robot, solve_stand_as_simulated(robot, stand))
        utilisations.append(float(statics.motor_utilisation.max()))
        passed = len(utilisations) == 3
        return SimpleNamespace(passed=passed, complete=lambda: SimpleNamespace(passed=passed))

    monkeypatch.setattr(best, "study_stance", fail_twice)
    monkeypatch.setattr(best, "simulate_stance", fail_twice)
    study = best.study_best(load("v3"), Objective.UTILISATION, pa.StandTask())
    assert study.passed
    assert len(utilisations) == 3
    assert utilisations == sorted(utilisations)
    assert study.best.value == pytest.approx(utilisations[2])
    assert utilisations[0] < study.best.value


@pytest.mark.slow
@pytest.mark.parametrize("is_refused", [False, True])
def test_next_stance_for_a_payload_is_returned_if_the_best_does_not_hold(
    monkeypatch: pytest.MonkeyPatch, few_samples: None, is_refused: bool
) -> None:
    """The best stance falls, or has no equilibrium on soft ground. Reference: the payload limit of
    the returned stance."""
    fallen: list[pa.Stand] = []
    complete_limit = best.payload_limit

    def fall(robot: pa.Robot, stand: pa.Stand, **_: object) -> SimpleNamespace:
        fallen.append(stand)
        return SimpleNamespace(passed=False)

    def refuse_best(robot: pa.Robot, stand: pa.Stand, *more: object, **named: object) -> object:
        if is_refused and stand.task.height != pytest.approx(nominal.task.height) and not fallen:
            fallen.append(stand)
            raise pa.NoEquilibriumError(None, diagnose("servos-too-soft-unloaded"))
        return complete_limit(robot, stand, *more, **named)

    robot = load("v3")
    nominal = pa.solve_stand(robot)
    monkeypatch.setattr(best, "payload_limit", refuse_best)
    if not is_refused:
        monkeypatch.setattr(best, "study_stance", fall)
    study = best.study_best(robot, Objective.PAYLOAD, pa.StandTask())
    assert len(fallen) == 1
    assert study.passed
    limit = pa.payload_limit(robot, study.best.stand)
    assert study.best.value == pytest.approx(limit.mass, rel=1e-6)
    assert study.best.stand.task != fallen[0].task


def load_biped(folder: Path) -> pa.Robot:
    pair = biped(folder)
    return pa.load_robot(urdf=pair.urdf, mjcf=pair.mjcf)


def test_feet_of_a_biped_may_move_forward_and_back_and_sideways(tmp_path: Path) -> None:
    """The feet stand side by side, so that both directions of x are outward. Reference: the bounds
    of mirrored feet are mirror images."""
    space = StanceSpace(load_biped(tmp_path), pa.StandTask())
    low, high = (ends[len(BASE_COORDINATES) :].reshape(2, 2) for ends in (space.low, space.high))
    assert low[:, 0] == pytest.approx(-high[:, 0])
    assert high[:, 0].min() > 0.1
    assert low[:, 1] == pytest.approx(-high[::-1, 1])
    together = space.coupled_directions()[len(BASE_COORDINATES) :]
    moves = {tuple(column) for column in together.T if column.any()}
    side = np.sign(space._compute_foot_offset(space.free[0])[1])
    assert moves == {(0.0, side, 0.0, -side), (side, 0.0, -side, 0.0)}


@pytest.mark.slow
def test_best_stance_of_a_biped_has_a_larger_margin(tmp_path: Path) -> None:
    """Staggered feet move the nearest edges of the support polygon outwards. Reference: the
    distance of the CoM from the hull of the soles."""
    robot = load_biped(tmp_path)
    found = best_stance(robot, "margin")
    com = pa.Configuration(robot, found.stand.qpos).center_of_mass()[:2]
    hull = ConvexHull(found.stand.corners(robot)[:, :2])
    distance = float((-hull.equations[:, :2] @ com - hull.equations[:, 2]).min())
    assert found.value == pytest.approx(distance, abs=1e-6)
    assert found.value > 1.02 * found.nominal_value


def test_com_of_the_best_stance_keeps_a_distance_from_the_edges(tmp_path: Path) -> None:
    """A payload above the base balances a CoM on an edge, on which the robot without payload tips.
    Reference: the distance of the CoM from SciPy's hull of the soles."""
    robot = load_biped(tmp_path)
    space = StanceSpace(robot, pa.StandTask())
    stands = [space.find_stand(space.start + shift * np.eye(len(space.start))[1])
              for shift in (0.0, 0.02)]  # fmt: skip
    distances = []
    for stand in stands:
        assert stand is not None
        com = evaluate_mujoco(robot, stand.qpos).body(robot.mj_base).subtree_com
        sides = ConvexHull(stand.corners(robot)[:, :2]).equations
        distances.append(-float((sides @ [*com[:2], 1.0]).max()))
        found = space.compute_slack(stand).edges.min()
        assert found == pytest.approx(distances[-1] - space.edge_reserve, abs=1e-9)
    assert distances[0] != pytest.approx(distances[1], abs=1e-3)
    assert 0.04 * distances[0] < space.edge_reserve < 0.06 * distances[0]


@pytest.mark.slow
def test_best_stance_is_deterministic() -> None:
    robot = load("original")
    assert best_stance(robot).to_json() == best_stance(robot).to_json()


def test_stance_space_solves_stands_below_the_required_com_margin() -> None:
    """The slack of the CoM margin is negative there; references: MuJoCo's CoM and SciPy's convex
    hull.
    """
    robot = load("original")
    space = StanceSpace(robot, pa.StandTask(com_margin=0.06))
    shifted = space.start.copy()
    shifted[space.names.index("x")] += 0.04
    stand = space.find_stand(shifted)
    assert stand is not None
    assert stand.task.com_margin == 0.06
    com = evaluate_mujoco(robot, stand.qpos).body(robot.mj_base).subtree_com
    sides = ConvexHull([point[:2] for point in stand.contact_points.values()]).equations
    margin = -float((sides @ [*com[:2], 1.0]).max())
    found = space.compute_slack(stand).edges.min()
    assert found == pytest.approx(margin - 0.06 - space.edge_reserve, abs=1e-9)
    assert found < 0
