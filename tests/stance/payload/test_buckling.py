"""Stiffness under a load by another route, through settled poses."""

from __future__ import annotations

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.robot.payload import with_payload
from pupper_analysis.robot.servos import model_with_servos
from pupper_analysis.stance.payload.buckling import find_buckling_modes
from pupper_analysis.stance.soft_ground import solve_loaded_stand
from tests.support.variants import NAMES, load, stand_of

EVEN = pa.statics.ForceDistribution.MIN_TANGENTIAL


@pytest.mark.parametrize("name", NAMES)
def test_where_it_buckles_the_settled_pose_is_not_stable_any_more(name: str) -> None:
    """Substituted twice, as the depths under the load change the configuration."""
    robot, stand = load(name), stand_of(name)
    kp, mass, sunk = model_with_servos(robot).kp, 0.3, stand
    for _ in range(4):
        loaded = with_payload(robot, mass)
        sunk = solve_loaded_stand(loaded, stand)
        empty, laden = (
            pa.stance.stand_statics(one, sunk, distribution=EVEN) for one in (robot, loaded)
        )
        modes = find_buckling_modes(robot, loaded, sunk, kp, empty, laden)
        assert modes is not None
        mass = float(1 / modes[0])
    signs = []
    for share in (0.98, 1.02):
        heavy = with_payload(robot, share * mass)
        pose = pa.steady_state(heavy, solve_loaded_stand(heavy, stand), feedforward=True)
        signs.append(np.sign(pose.stiffness))
    assert signs == [1, -1]


def test_servos_too_soft_without_any_payload() -> None:
    robot, stand = load("v3"), stand_of("v3")
    loaded = with_payload(robot, 0.3)
    empty, laden = (
        pa.stance.stand_statics(one, stand, distribution=EVEN) for one in (robot, loaded)
    )
    assert find_buckling_modes(robot, loaded, stand, np.full(12, 0.5), empty, laden) is None
