"""Law of MuJoCo's soft ground (stiffness, impedance, viscosity), compared with MuJoCo's own
constraint terms and with a simulation.
"""

from collections.abc import Callable
from dataclasses import replace

import mujoco
import pytest

from pupper_analysis.robot import contact
from pupper_analysis.robot.compliance import GroundLaw
from tests.support.engines import change_model, evaluate_mujoco
from tests.support.variants import load, stand_of


def set_cone(kind: mujoco.mjtCone) -> Callable[[mujoco.MjModel], None]:
    """Return a function that sets the friction cone type of a model."""
    return lambda model: setattr(model.opt, "cone", kind.value)


def set_negative_solref(model: mujoco.MjModel) -> None:
    model.geom_solref[:] = -3000, -90


def set_short_solimp(model: mujoco.MjModel) -> None:
    model.geom_solref[:] = 0.001, 0.8
    model.geom_solimp[:] = 0.2, 0.9, 0.01, 0.3, 3


@pytest.mark.parametrize("change", [None, set_negative_solref, set_short_solimp, "pyramidal"])
@pytest.mark.parametrize("name", ["original", "v3"])
def test_ground_law_equals_the_contact_terms_of_mujoco(name: str, change: object) -> None:
    """References: `efc_diagA`, `efc_KBIP`, `efc_R` and `efc_aref` of MuJoCo's contacts, for feet
    lowered by 0.1 to 9 mm: impedance, stiffness, force [N] and viscosity [N s/m].
    """
    robot = load(name)
    if change == "pyramidal":
        robot = change_model(robot, set_cone(mujoco.mjtCone.mjCONE_PYRAMIDAL))
    elif callable(change):
        robot = change_model(robot, change)
    ground = contact.ground_geom(robot.mj_model)
    assert ground is not None
    robot = replace(
        robot,
        contacts={
            f: contact.combine_geoms(robot.mj_model, s, ground) for s, f in robot.foot_geoms.items()
        },
    )
    for drop in (1e-4, 2e-3, 5e-3, 9e-3):
        qpos = stand_of(name).qpos.copy()
        qpos[2] -= drop
        data = evaluate_mujoco(robot, qpos)
        touches = [
            touch for touch in data.contact if set(touch.geom) <= {ground, *robot.foot_geoms}
        ]
        assert len(touches) == 4
        for touch in touches:
            foot = robot.foot_geoms[max(touch.geom)]
            law = GroundLaw.of_contact(robot, foot)
            row = touch.efc_address
            r, aref = data.efc_R[row], data.efc_aref[row]
            depth = -touch.dist
            assert depth == pytest.approx(drop, abs=1e-9)
            if change == "pyramidal":
                edges, mu = 2 * (touch.dim - 1), touch.friction[0]
                assert law.force(depth) == pytest.approx(edges * aref / r, rel=1e-9)
                pair = 2 * mu**2 * data.efc_KBIP[row, 1] / r
                assert law.viscosity(depth) == pytest.approx(pair, rel=1e-9)
                continue
            d = law.impedance(depth)
            assert d == pytest.approx(data.efc_KBIP[row, 2], rel=1e-12)
            assert law.normal == pytest.approx(data.efc_diagA[row], rel=1e-12)
            assert law.stiffness == pytest.approx(data.efc_KBIP[row, 0], rel=1e-12)
            assert aref == pytest.approx(law.stiffness * d * depth, rel=1e-9)
            assert law.force(depth) == pytest.approx(aref / r, rel=1e-9)
            sliding = data.efc_KBIP[row + 1, 1] / data.efc_R[row + 1]
            assert law.viscosity(depth) == pytest.approx(sliding, rel=1e-9)
