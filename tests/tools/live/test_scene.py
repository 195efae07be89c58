"""Positions of the objects that a page draws."""

from __future__ import annotations

import resource
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import pupper_analysis as pa
from pupper_analysis.tools.live.model import StanceSolver
from pupper_analysis.tools.live.scene import Scene, make_body_meshes
from pupper_analysis.tools.live.state import State
from tests.prepare.convert.test_meshes import claim_vertices, nest_nodes
from tests.support.engines import evaluate_mujoco
from tests.support.robots import arm, urdf_text


class Drawn:
    """Stub of viser's scene that keeps the drawn objects by name."""

    def __init__(self) -> None:
        self.nodes: dict[str, Any] = {}

    def __getattr__(self, _: str) -> Callable[..., Any]:
        def add(name: str, *arguments: object, **options: object) -> Any:
            return self.nodes.setdefault(name, SimpleNamespace())

        return add


def test_payload_is_drawn_at_its_position_on_a_tilted_base() -> None:
    """Reference: MuJoCo's pose of the base."""
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


def test_small_files_with_large_meshes_are_not_drawn(tmp_path: Path) -> None:
    """A mesh of 12 GB of zeros and one of 2^30 boxes; a box of 8 corners is drawn beside them.

    The limit is 100 MB more memory.
    """
    pytest.importorskip("trimesh")
    (tmp_path / "claims.glb").write_bytes(claim_vertices(10**9))
    (tmp_path / "nested.dae").write_text(nest_nodes(30))
    (tmp_path / "box.dae").write_text(nest_nodes(0))
    shapes = "".join(
        f'<visual><geometry><mesh filename="{name}"/></geometry></visual>'
        for name in ("claims.glb", "nested.dae", "box.dae")
    )
    path = tmp_path / "arm.urdf"
    path.write_text(urdf_text(arm(), ()).replace("</link>", f"{shapes}</link>", 1))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    robot = pa.load_robot(path, visuals=True)
    (mesh,) = make_body_meshes(robot.mj_model).values()
    assert len(mesh.vertices) == 8
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # kB on Linux
