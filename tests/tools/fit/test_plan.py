"""Planned stands: selection by the determinant of the information matrix, and reasons why none can
be planned.
"""

from __future__ import annotations

import math
import re
from itertools import combinations
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from pupper_analysis import load_robot
from pupper_analysis.base.errors import MeasurementError
from pupper_analysis.pupper.variant_files import load_variant
from pupper_analysis.robot.configuration import Configuration
from pupper_analysis.tools.fit.measurements.stands import read_stands
from pupper_analysis.tools.fit.parameters import list_bodies, parse_prior
from pupper_analysis.tools.fit.stands import plan
from pupper_analysis.tools.fit.stands.plan import (
    RandomStands,
    choose_stands,
    plan_stands,
    write_plan,
)
from pupper_analysis.tools.study.parameters import scale_robot
from tests.support.repository import ROOT


def test_the_chosen_make_the_determinant_largest() -> None:
    """Reference: largest log-determinant of all choices of 4 from 12 measurements, within 2 %."""
    rng = np.random.default_rng(3)
    rows = rng.normal(size=(12, 2, 5)) * rng.uniform(0.2, 2, size=(12, 1, 5))
    each = [row.T @ row for row in rows]
    before = np.diag([1.0, 0.5, 2.0, 0.1, 1.0])

    def determinant(places: tuple[int, ...]) -> float:
        return float(np.linalg.slogdet(before + sum(each[place] for place in places))[1])

    best = max(combinations(range(12), 4), key=determinant)
    found = choose_stands(each, before, 4)
    # The search exchanges single measurements, and may end in another local maximum.
    assert determinant(found) == pytest.approx(determinant(best), rel=0.02)
    assert len(set(found)) == 4


def test_number_of_rare_stands_is_bounded() -> None:
    """Rare measurements with ten times the signal: without the bound more than four are chosen,
    with it two.
    """
    rng = np.random.default_rng(3)
    rows = rng.normal(size=(12, 2, 5))
    rows[:6] *= 10  # the most informative
    each, rare = [row.T @ row for row in rows], [True] * 6 + [False] * 6
    assert sum(place < 6 for place in choose_stands(each, np.eye(5), 6)) > 4
    assert sum(place < 6 for place in choose_stands(each, np.eye(5), 6, rare, 2)) == 2
    assert len(set(choose_stands(each, np.eye(5), 9, rare, 2))) == 9  # there are no others


@pytest.mark.slow
def test_plan_has_known_masses_rotations_and_few_three_leg_stands(tmp_path: Path) -> None:
    """The expected standard deviations shrink for kp and not for the known mass."""
    robot = load_variant("v3")
    at = (0.01, 0.0, 0.05)
    plan = plan_stands(robot, 6, added=0.2, added_at=at)
    loaded = [stand.added for stand in plan.stands]
    assert 0 < sum(map(bool, loaded)) < 6
    assert loaded == sorted(loaded)  # it is put on once
    assert sum(bool(stand.swing) for stand in plan.stands) <= 2
    assert {round(math.degrees(stand.heading)) for stand in plan.stands} == {0, 180}
    path = tmp_path / "plan.csv"
    write_plan(plan, path)
    write_plan(plan, path)  # a plan without readings is replaced
    read = read_stands(path)
    np.testing.assert_allclose(read.heading, [stand.heading for stand in plan.stands], atol=1e-6)
    masses = [[stand.added, *(at if stand.added else (0, 0, 0))] for stand in plan.stands]
    np.testing.assert_allclose(read.added["base_link"], masses)
    narrowed = {estimate.name: estimate.std for estimate in plan.expected}
    assert narrowed["kp leg_front_r_3"] < 0.5 * 1.5  # without a known mass, and no scale: 0.72
    assert narrowed["added base_link"] > 0.9 * 0.005
    assert plan.more_stands_help  # a plan of 12 stands determines every kp
    assert plan.determined["kp"] < plan.determined_by_all["kp"] == robot.nu


@pytest.mark.slow
def test_servos_that_are_too_soft_hold_no_stand() -> None:
    with pytest.raises(MeasurementError, match="only 0 of 3"):
        plan_stands(load_variant("v3"), 3, kp=0.3)


# --------- Random stands: margins of CoM and joints by their uncertainty, and refusals


@pytest.mark.slow
@pytest.mark.parametrize(
    "priors", [("mass=20%", "com=2mm"), ("mass=0", "com=0", "com:base_link=4mm")]
)
def test_com_uncertainty_equals_that_of_robots_drawn_from_the_priors(
    priors: tuple[str, ...],
) -> None:
    """Reference: 2000 robots with masses and CoMs drawn from the priors.

    The base CoM is far forward, so a larger base mass moves the CoM of the robot as well. The CoMs
    are sums over bodies; for the first few draws, robots are created and compared.
    """
    robot = scale_robot(load_variant("original"), {"com_x:base_link": 0.08})
    rng = np.random.default_rng(4)
    known = [parse_prior(prior) for prior in priors]
    mass = next(prior.share for prior in known if prior.kind == "mass" and prior.subject == "*")
    links, numbers = zip(*list_bodies(robot), strict=True)
    model = robot.structure.model
    data = model.createData()
    pin.forwardKinematics(
        model, data, robot.structure.convention.unit_q(robot.make_qpos(robot.nominal))
    )
    masses = np.array([model.inertias[at].mass for at in numbers])
    coms = np.array([data.oMi[at].act(model.inertias[at].lever) for at in numbers])
    axes = np.array([data.oMi[at].rotation for at in numbers])
    com = [
        [prior.width for prior in known if prior.kind == "com" and prior.subject in ("*", link)][-1]
        for link in links
    ]
    share = 0.0 if np.isnan(mass) else mass
    factors = 1 + share * rng.normal(size=(2000, len(links)))
    offsets = np.array(com)[:, None] * rng.normal(size=(2000, len(links), 3))
    weights = factors * masses
    places = coms + np.einsum("bij,nbj->nbi", axes, offsets)
    found = np.einsum("nb,nbi->ni", weights, places) / weights.sum(axis=1)[:, None]
    for row in range(3):
        requested = {f"mass:{link}": factors[row, at] for at, link in enumerate(links)}
        for at, link in enumerate(links):
            requested |= {f"com_{axis}:{link}": offsets[row, at, i] for i, axis in enumerate("xyz")}
        drawn = Configuration(scale_robot(robot, requested), robot.make_qpos(robot.nominal))
        assert found[row] == pytest.approx(drawn.center_of_mass(), abs=1e-12)
    aside = np.std(found, axis=0)[:2].max()
    # A twentieth: what 2000 draws leave, and that heavier robots' coms are not linear in masses.
    assert plan.compute_com_std(robot, known) == pytest.approx(aside, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("variant", ["original", "long-leg"])
def test_plan_keeps_margins_from_limits_and_other_links(
    variant: str,
) -> None:
    """Joints keep three standard deviations of the encoder offset from their limits; links are more
    than 1 mm apart.
    """
    robot = load_variant(variant)
    priors = [parse_prior("offset=2deg"), parse_prior("com=5mm")]
    found = RandomStands(robot, np.random.default_rng(0), None, priors).draw_stands(6)
    assert len(found) == 6
    off = 3 * np.radians(2.0)
    for stand, sagged in found:
        assert (stand.qpos[7:] > robot.lower_limits + off - 1e-9).all()
        assert (stand.qpos[7:] < robot.upper_limits - off + 1e-9).all()
        assert stand.self_clearance.distance > 0.001
        assert set(sagged.stance_feet) == set(stand.stance_feet)


def test_random_stands_stay_in_the_branch_of_the_start_pose(tmp_path: Path) -> None:
    """With wide limits, the solver finds stands with a leg turned over: 2.76 rad from the start.

    A servo cannot move there from another stand. No stand of such a plan was recorded.
    """
    text = (ROOT / "urdf" / "pupper_v3.urdf").read_text().replace("../mjcf/", f"{ROOT}/mjcf/")
    path = tmp_path / "wide.urdf"
    path.write_text(re.sub(r'lower="[^"]+" upper="[^"]+"', 'lower="-9.4" upper="9.4"', text))
    robot = load_robot(path)
    generator = RandomStands(robot, np.random.default_rng(1), None)
    found = generator.draw_stands(3)
    assert len(found) == 3
    travels = [np.abs(stand.qpos[7:] - robot.home[7:]).max() for stand, _ in found]
    assert max(travels) < math.pi / 2


def test_cause_is_named_if_no_stand_can_be_planned() -> None:
    robot, rng = load_variant("original"), np.random.default_rng(0)
    unsure = RandomStands(robot, rng, None, [parse_prior("offset=20deg")])
    assert unsure.draw_stands(3) == []
    assert unsure.explain_shortage(3).code == "too-few-in-reach"
