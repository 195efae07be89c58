"""Impedance of equality constraints and their opening at rest, compared with MuJoCo."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from pupper_analysis.robot.impedance import (
    EqualityCompliance,
    _solve_violation,
    clip_solimp,
    effective_solref,
    solimp_impedance,
)

KINDS = {
    "joint": '<joint joint1="a" joint2="b" {words}/>',
    "connect": '<connect body1="A" body2="B" anchor="0 0 0" {words}/>',
    "weld": '<weld body1="A" body2="B" {words}/>',
}
BODY = """<body name="{name}" pos="{x} 0 0"><joint name="{low}" axis="0 1 0" springref="{ref}"
    stiffness="{k}" damping="2"/><joint type="slide" axis="1 0 0" stiffness="{k}" damping="9"
    springref="{ref}"/><geom size=".1" mass="1" contype="0"/></body>"""


def random_words(seed: int) -> str:
    rng = np.random.default_rng(seed)
    low, high = rng.uniform(0.5, 0.9), rng.uniform(0.9, 0.999)
    low, high = (low, high) if rng.random() < 0.8 else (high, low)
    return (
        f'solref="{rng.uniform(0.005, 0.03)} {rng.uniform(0.7, 2)}" solimp="{low} {high} '
        f'{10 ** rng.uniform(-3, -1)} {rng.uniform(0.2, 0.8)} {rng.integers(1, 4)}"'
    )


def make_tied_bodies(kind: str, seed: int) -> mujoco.MjModel:
    """Return a model of two bodies with springs, tied by an equality constraint with random
    parameters.
    """
    stiffness = 10 ** np.random.default_rng(seed).uniform(1, 3)
    bodies = "".join(
        BODY.format(name=name, low=name.lower(), x=x, k=stiffness, ref=ref)
        for name, x, ref in (("A", 0.0, 0.1), ("B", 0.3, -0.2))
    )
    tie = KINDS[kind].format(words=random_words(seed))
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><option integrator="implicitfast" gravity="0 0 0" tolerance="0"/>'
        f"<worldbody>{bodies}</worldbody><equality>{tie}</equality></mujoco>"
    )


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(8))
def test_predicted_constraint_opening_equals_the_simulation_at_rest(kind: str, seed: int) -> None:
    """Reference: ``efc_pos`` of MuJoCo at rest, predicted from ``efc_force`` alone."""
    model = make_tied_bodies(kind, seed)
    data = mujoco.MjData(model)
    for _ in range(20000):
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    assert np.abs(data.qvel).max() < 1e-8
    soft = EqualityCompliance(model, data)
    moved = np.abs(data.efc_pos) > 1e-6
    assert moved.any()
    opened = -soft.solve_violations(data.efc_force)
    np.testing.assert_allclose(opened[moved], data.efc_pos[moved], rtol=1e-4)
    np.testing.assert_allclose(-soft.current_compliance() * data.efc_force, data.efc_pos, atol=1e-9)
    assert (soft.max_compliance() >= soft.current_compliance() * (1 - 1e-12)).all()


@pytest.mark.parametrize("kind", KINDS)
def test_constraint_compliance_does_not_depend_on_the_configuration(kind: str) -> None:
    """The opening [rad, m] under a constraint force of 2 is equal at four configurations."""
    model = make_tied_bodies(kind, 3)
    data = mujoco.MjData(model)
    found = []
    for distance in (0.0, 1e-4, 1e-2, 0.1):
        data.qpos[:] = 0, distance, 0, 0
        if kind == "joint":
            data.qpos[:] = distance, 0, 0, 0
        mujoco.mj_forward(model, data)
        found.append(EqualityCompliance(model, data).solve_violations(np.full(data.nefc, 2.0)))
    # A weld's and a connect's A depend on the configuration; along this way they stay.
    for impedance in found[1:]:
        np.testing.assert_allclose(impedance, found[0], rtol=1e-9)


@pytest.mark.parametrize("seed", range(8))
def test_impedance_and_its_slope_equal_mujoco_and_a_finite_difference(seed: int) -> None:
    """References: MuJoCo's `efc_KBIP`, and a central difference over the opening."""
    model = make_tied_bodies("joint", seed)
    data, solimp = mujoco.MjData(model), clip_solimp(model.eq_solimp[0])
    for opened in np.random.default_rng(seed).uniform(0, 1.5 * solimp[2], 20):
        data.qpos[0] = opened
        mujoco.mj_forward(model, data)
        d, slope = solimp_impedance(solimp, opened)
        assert d == pytest.approx(data.efc_KBIP[0, 2], rel=1e-12)
        step = 1e-6 * solimp[2]
        ends = [solimp_impedance(solimp, opened + way)[0] for way in (step, -step)]
        assert slope == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=1e-4, abs=1e-6)


@pytest.mark.parametrize("force", [1e-4, 1e-3, 5e-3])
def test_opening_satisfies_the_equation_of_its_impedance(force: float) -> None:
    """Reference: x = F (1 - d(x)) / d(x)^2, with x within the width over which the impedance d
    rises."""
    solimp = clip_solimp((0.6, 0.95, 0.01, 0.5, 2))
    opened = _solve_violation(solimp, force)
    d, _ = solimp_impedance(solimp, opened)
    assert 0 < opened < solimp[2]
    assert opened == pytest.approx(force * (1 - d) / d**2, rel=1e-12)


def measure_rest_height(solref: str) -> float:
    """Height [m] at which MuJoCo's ball of 0.1 m rests on its floor."""
    geom = f'<geom size="0.1" mass="1" solref="{solref}"/>'
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><worldbody><geom type="plane" size="1 1 1" solref="{solref}"/>'
        f'<body pos="0 0 0.1"><freejoint/>{geom}</body></worldbody></mujoco>'
    )
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 1000)
    return float(data.qpos[2])


@pytest.mark.parametrize("solref", [(0.0, 1.0), (0.02, -1.0), (-100.0, 1.0), (0.05, 0.0)])
def test_solref_of_mixed_formats_is_mujocos_default(solref: tuple[float, float]) -> None:
    """Reference: rest height of MuJoCo's ball."""
    assert effective_solref(solref) == (0.02, 1.0)
    height = measure_rest_height(f"{solref[0]} {solref[1]}")
    assert height == pytest.approx(measure_rest_height("0.02 1"), abs=1e-12)


@pytest.mark.parametrize("solref", [(0.05, 0.5), (-100.0, -10.0), (0.0, 0.0)])
def test_solref_of_one_format_is_unchanged(solref: tuple[float, float]) -> None:
    """Reference: MuJoCo's ball rests 0.1 mm or more from its height with the default."""
    assert effective_solref(solref) == solref
    height = measure_rest_height(f"{solref[0]} {solref[1]}")
    assert abs(height - measure_rest_height("0.02 1")) > 1e-4
