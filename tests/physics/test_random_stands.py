"""Random stands of every variant: each verdict confirmed by `benchmarks/stances.py`'s checks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.simulation.verify import FORCE_TOLERANCE
from pupper_analysis.stance.stand import stand_statics
from tests.support.repository import benchmark
from tests.support.variants import BASES_FIRST, NAMES, load

stances = benchmark("stances")
stances.STARTS = 60  # the benchmark has 200


@pytest.mark.slow
@pytest.mark.parametrize("name", BASES_FIRST)
def test_verdicts_of_random_stands_are_confirmed(name: str) -> None:
    """References: checks of benchmarks/stances.py, which share no code with the solvers; MuJoCo."""
    robot = load(name)
    outcomes = stances.judge_random_tasks(robot, 8, seed=100 + NAMES.index(name))
    assert not [(str(outcome.task), outcome.wrong) for outcome in outcomes if outcome.wrong]
    held = [outcome for outcome in outcomes if outcome.verdict is stances.Verdict.HELD]
    assert len(held) >= 3
    assert any(outcome.verdict is not stances.Verdict.HELD for outcome in outcomes)
    for outcome in held:
        assert outcome.error < 1e-9
        try:
            sunk = pa.stance.solve_stand_on_soft_ground(robot, outcome.stand.task, explain=False)
        except pa.StanceUnreachableError:
            continue
        run = pa.verify_stand(robot, sunk)
        assert run.torque_error < FORCE_TOLERANCE, run.failures
        # Of the stands that PlaCo finds for v3-long-leg's soft servos, some buckle within a minute.
        assert run.passed or (name == "v3-long-leg" and not run.stability.is_stable_for()), (
            run.failures
        )
        sag = stances.compare_sag(robot, outcome.stand)
        if sag.error is not None and sag.stiffness > stances.MIN_PREDICTED_STIFFNESS:
            assert sag.rest < stances.SAG_TOLERANCE
        if sag.error is not None and sag.firm:
            assert sag.error < stances.SAG_TOLERANCE


FOUND_IN_REACH = {
    "original": pa.StandTask(
        height=0.1548087434150028,
        pitch=0.12771198189547067,
        foot_offsets={"FL": (-0.021765827005072277, -0.0026287802498440316)},
        ground=pa.Ground(heights={"FL": 0.019512544849077718}),
        com="inside",
        com_margin=0.013685753507960648,
    ),
    "long-leg": pa.StandTask(
        height=0.18932752021538282,
        ground=pa.Ground(slope=0.20617645781241425, uphill=-0.22736530069894823),
        com="inside",
        com_margin=0.01886604128889197,
    ),
    "v3-heavy": pa.StandTask(  # with the com over the centre a knee is in the ground
        height=0.10059852527161693,
        roll=0.2654308527724069,
        pitch=-0.033260793558457125,
        yaw=-0.25697321727251965,
        ground=pa.Ground(heights={"RR": 0.012218460793867661}),
        com="inside",
        com_margin=0.029562909548149587,
    ),
}
"""In reach by least squares."""


@pytest.mark.parametrize("name", FOUND_IN_REACH)
def test_stand_with_com_inside_is_found_with_a_joint_at_its_limit(name: str) -> None:
    """Reference: checks of benchmarks/stances.py, which share no code with the solvers."""
    outcome = stances.judge_task(load(name), FOUND_IN_REACH[name], np.random.default_rng(0))
    pa.solve_stand(load(name), FOUND_IN_REACH[name], explain=False)
    assert outcome.verdict is stances.Verdict.HELD
    assert not outcome.wrong


# ------------------------------------------------------------------------------------- the checks


@pytest.mark.slow
def test_checks_of_a_stand_detect_errors_of_1e_5_and_of_a_thousandth() -> None:
    """Coordinates are moved by 1e-5 (rad and m), and forces changed by 0.1 %."""
    robot = load("v3")
    for task in (
        pa.StandTask(roll=0.05, yaw=0.1, ground=pa.Ground(0.05, 1.0, {"FL": 0.01})),
        pa.StandTask(offset=(0.01, 0.01)),
        pa.StandTask(swing={"FL": 0.01}, com="inside", com_margin=0.01),
    ):
        stand, reference = pa.solve_stand(robot, task), stances.ReferenceTargets(robot, task)
        error, wrong = stances.check_reached(reference, stand)
        assert error < 1e-9
        assert not wrong
        for index in range(robot.nq):
            qpos = stand.qpos.copy()
            qpos[index] += 1e-5
            error, wrong = stances.check_reached(reference, replace(stand, qpos=qpos))
            if not 3 <= index < 4:  # the quaternion's real part has hardly an effect
                assert wrong, index
        reference.set_configuration(stand.qpos)
        statics = stand_statics(robot, stand)
        assert not stances.check_forces(reference, statics)
        pushed = {foot: 1.001 * force for foot, force in statics.contact_forces.items()}
        assert stances.check_forces(reference, replace(statics, contact_forces=pushed))


@pytest.mark.slow
def test_checks_reach_the_stands_that_the_solver_reaches() -> None:
    """Least squares find eight random stands of the solver; otherwise no refusal is confirmed."""
    robot, random = load("original"), np.random.default_rng(5)
    found = 0
    while found < 8:
        task = stances.random_task(robot, random)
        try:
            pa.solve_stand(robot, task, explain=False)
        except (pa.StanceUnreachableError, pa.ConfigurationError):
            continue
        found += 1
        error = stances.ReferenceTargets(robot, task).search_smallest_error(random)
        assert error < stances.REACHED_FOOT_ERROR, task


def test_checks_of_balance_equal_closed_forms() -> None:
    """CoM 74 mm and 76 mm from the centre of feet 75 mm ahead; slopes of 0.98 and 1.02 times the
    friction angle.
    """
    robot = load("v3")
    reference = stances.ReferenceTargets(robot, pa.StandTask())
    ahead = max(place[0] for place in reference.contacts.values()) - reference.centre[0]
    assert 0.074 < ahead < 0.076
    for shift, balanced in ((0.0, True), (0.074, True), (0.076, False), (0.2, False)):
        com = reference.centre + np.array([shift, 0.0, 0.12])
        assert reference.has_balancing_forces(com, inner=True) is balanced
        assert reference.has_balancing_forces(com, inner=False) is balanced
    friction = min(contact.sliding_friction for contact in robot.contacts.values())
    for factor, balanced in ((0.98, True), (1.02, False)):
        slope = float(np.arctan(factor * friction))
        reference = stances.ReferenceTargets(robot, pa.StandTask(ground=pa.Ground(slope, 0.4)))
        com = reference.centre + np.array([0.0, 0.0, 0.01])
        assert reference.has_balancing_forces(com, inner=True) is balanced
        assert reference.has_balancing_forces(com, inner=False) is balanced
