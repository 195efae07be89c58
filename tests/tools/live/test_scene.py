"""What a page draws, where it is."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np

import pupper_analysis as pa
from pupper_analysis.tools.live.model import StanceSolver
from pupper_analysis.tools.live.scene import Scene
from pupper_analysis.tools.live.state import State
from tests.support.engines import evaluate_mujoco


class Drawn:
    """In place of viser's scene: keeps what is drawn, by its name."""

    def __init__(self) -> None:
        self.nodes: dict[str, Any] = {}

    def __getattr__(self, _: str) -> Callable[..., Any]:
        def add(name: str, *arguments: object, **options: object) -> Any:
            return self.nodes.setdefault(name, SimpleNamespace())

        return add


def test_payload_is_drawn_at_its_position_on_a_tilted_base() -> None:
    found = StanceSolver(pa.load_variant("v3")).solve_state(
        State(roll=12, pitch=-8, payload=0.3, payload_at=(60, 40, 90))
    )
    assert found.stand is not None
    assert found.robot is not None
    drawn = Drawn()
    Scene(drawn).show(found)
    data = evaluate_mujoco(found.robot, found.stand.qpos)
    base = found.robot.mj_model.body(found.robot.mj_base).id
    place = data.xpos[base] + data.xmat[base].reshape(3, 3) @ (0.06, 0.04, 0.09)
    np.testing.assert_allclose(drawn.nodes["/load"].position, place, atol=1e-6)
