"""The band in which dry friction holds a robot: against random friction, and simulations."""

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.stance.sag.band import SteadyStateBand, steady_state_band
from pupper_analysis.stance.sag.equilibrium import SagEquilibrium
from pupper_analysis.stance.sag.homotopy_path import HomotopyPath
from tests.support.repository import benchmark
from tests.support.variants import V3_NAMES, load, stand_of

sag = benchmark("sag")
STANDING_V3 = tuple(name for name in V3_NAMES if name != "v3-long-leg")


def heights(band: SteadyStateBand) -> tuple[float, float, float]:
    assert band.lowest is not None
    assert band.frictionless is not None
    return tuple(pose.base_height for pose in (band.lowest, band.frictionless, band.highest))


def without_rolling(model: object) -> None:
    sag.gripping(model)
    model.geom_condim[:] = 3  # type: ignore[attr-defined]


def without_joints(model: object) -> None:
    sag.gripping(model)
    model.dof_frictionloss[:] = 0  # type: ignore[attr-defined]


@pytest.mark.parametrize("name", ["original", "v3", "v3-heavy"])
def test_friction_of_any_kind_stays_inside(name: str) -> None:
    """Equilibria with random torques and moments in their sets are between the ends."""
    robot, stand, random = load(name), stand_of(name), np.random.default_rng(0)
    band = steady_state_band(robot, stand)
    low, middle, high = heights(band)
    assert low < middle < high
    assert band.friction == 1
    assert band.width == pytest.approx(high - low)
    reached = []
    for _ in range(12):
        way = HomotopyPath(SagEquilibrium(robot, stand, None, "pinned"))
        way.follow(1.0)
        system = way.system
        for _ in range(4):  # the moments' limits depend on the forces, and these on the moments
            system.joint_friction = system.friction.torques(random.standard_normal(robot.nu))
            along = random.standard_normal(3)
            for foot, force in way.solution.forces.items():
                system.moments[foot] = 0.98 * system.friction.moment(foot, force, along)
            found = system.solve(way.solution)
            assert found is not None
            way.solution = found
        reached.append(way.solution.qpos[2])
        assert low <= reached[-1] <= high
    assert max(reached) - min(reached) > 0.2 * (high - low)


@pytest.mark.parametrize("name", STANDING_V3)
def test_robots_on_gripping_ground_end_inside_and_near_the_ends(name: str) -> None:
    robot, stand = sag.changed(load(name), sag.gripping), stand_of(name)
    band = steady_state_band(robot, stand)
    low, middle, high = heights(band)
    assert not band.failures
    let_down = sag.led(robot, stand, (0.0, 1.0), 6.0)
    let_up = sag.led(robot, stand, (0.0, 1.7, 1.0), 6.0)
    let_go = pa.verify_stand(robot, stand, feedforward=False, duration=8, nudged=0).base_height
    assert low < let_up < middle < let_go < let_down < high
    assert let_down > high - 0.1 * (high - middle)
    assert let_up < middle - 0.5 * (middle - low)
    for pose in (band.highest, band.lowest):  # and they are equilibria
        assert pose is not None
        stays = sag.left(robot, stand, pose.qpos)
        assert stays == pytest.approx(pose.base_height, abs=0.06 * (high - low))


@pytest.mark.longest
@pytest.mark.parametrize("change", [without_rolling, without_joints])
def test_each_kind_of_friction_alone_makes_a_band(change: object) -> None:
    robot, stand = sag.changed(load("v3"), change), stand_of("v3")
    low, middle, high = heights(steady_state_band(robot, stand))
    # Slowly: on the way down each joint's friction opposes its own motion, which is nearly, not
    # exactly, what holds the base up most.
    let_down = sag.led(robot, stand, (0.0, 1.0), 20.0)
    let_up = sag.led(robot, stand, (0.0, 2.0, 1.0), 20.0)
    assert high - 0.3 * (high - middle) < let_down < high
    assert low < let_up < low + 0.4 * (middle - low)


def test_friction_carries_what_does_not_stand_without() -> None:
    robot, stand = sag.changed(load("v3-long-leg"), sag.gripping), stand_of("v3-long-leg")
    band = steady_state_band(robot, stand)
    assert band.frictionless is None
    assert band.lowest is None
    assert band.width is None
    assert "frictionless: no equilibrium" in map(str, band.failures)
    let_down = sag.led(robot, stand, (0.0, 1.0), 10.0)
    assert band.highest.base_height - 1e-3 < let_down < band.highest.base_height
    let_go = pa.verify_stand(robot, stand, feedforward=False, duration=8, nudged=0)
    assert let_go.passed
    assert let_go.base_height < band.highest.base_height


def test_without_friction_there_is_no_band() -> None:
    robot, stand = sag.changed(load("v3"), sag.without_dry_friction), stand_of("v3")
    band = steady_state_band(robot, stand)
    assert band.width == pytest.approx(0, abs=1e-9)
    assert band.highest.base_height == pytest.approx(pa.steady_state(robot, stand).base_height)


def test_feedforward_and_stiff_servos_narrow_it() -> None:
    robot, stand = load("v3"), stand_of("v3")
    soft, stiff = (steady_state_band(robot, stand, kp=kp).width for kp in (5.0, 20.0))
    assert soft > 3 * stiff > 0
    low, middle, high = heights(steady_state_band(robot, stand, feedforward=True))
    assert low < middle < high
    assert middle == pytest.approx(pa.steady_state(robot, stand, feedforward=True).base_height)


def test_a_friction_band_is_refused_where_nothing_holds() -> None:
    robot, stand = load("v3"), stand_of("v3")
    with pytest.raises(pa.NoEquilibriumError, match="not even with friction"):
        steady_state_band(robot, stand, kp=0.5)
    with pytest.raises(pa.ConfigurationError, match="kp"):
        steady_state_band(robot, stand, kp=-1.0)


def test_friction_that_goes_to_and_fro_comes_to_rest_half_way() -> None:
    """Turned so, v3's feet rub one way and the other by turns; between them is the whole of it."""
    robot = load("v3")
    stand = pa.solve_stand(robot, pa.StandTask(height=0.1315, roll=0.03, pitch=-0.064))
    band = steady_state_band(robot, stand)
    low, middle, high = heights(band)
    assert band.friction == 1
    assert low < middle < high


def test_result_is_json() -> None:
    result = steady_state_band(load("v3"), stand_of("v3")).to_dict()
    assert 0.0100 < result["highest"]["height_loss"] < 0.0101
    assert 0.0140 < result["lowest"]["height_loss"] < 0.0141
