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
from pupper_analysis.present.scene import DrawnForce
from pupper_analysis.tools.live.model import PageSolver
from pupper_analysis.tools.live.scene import (
    OUTSIDE_COLOUR,
    Scene,
    linearise,
    make_body_meshes,
    make_force_arrows,
)
from pupper_analysis.tools.live.state import State
from tests.prepare.convert.test_meshes import claim_vertices, nest_nodes
from tests.support.engines import evaluate_mujoco
from tests.support.robots import arm, urdf_text
from tests.support.variants import load


class Drawn:
    """Stub of viser's scene that keeps the drawn objects by name."""

    def __init__(self) -> None:
        self.nodes: dict[str, Any] = {}

    def __getattr__(self, _: str) -> Callable[..., Any]:
        def add(name: str, *arguments: object, **options: object) -> Any:
            return self.nodes.setdefault(name, SimpleNamespace(arguments=arguments))

        return add


def test_payload_is_drawn_at_its_position_on_a_tilted_base() -> None:
    """Reference: MuJoCo's pose of the base."""
    found = PageSolver(pa.load_variant("v3")).solve_state(
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


def test_forces_polygon_and_com_have_the_colours_of_the_figures() -> None:
    """Reference: colours of Okabe and Ito in the figure of a pose; red if the CoM is outside."""
    model = PageSolver(load("v3"))
    drawn, answer = Drawn(), model.solve_state(State())
    Scene(drawn).show(answer)
    assert drawn.nodes["/support"].color == (0, 114, 178) == tuple(bytes.fromhex("0072B2"))
    assert drawn.nodes["/com"].color == (0, 158, 115)
    assert drawn.nodes["/forces"].arguments[1] == linearise((213, 94, 0)) == (170, 29, 0)
    outside = model.solve_state(State("offset", offset=(40.0, 20.0), swing={"FL": 20.0}))
    assert outside.stand is not None
    assert outside.statics is None
    Scene(drawn).show(outside)
    assert drawn.nodes["/support"].color == drawn.nodes["/com"].color == OUTSIDE_COLOUR


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


def test_ghost_and_simulated_robot_are_drawn_beside_the_stand_and_hidden_again() -> None:
    """The simulated robot is 2.6 stand heights to the left; a new stance hides both figures."""
    model, drawn = PageSolver(load("v3")), Drawn()
    scene, robot = Scene(drawn), load("v3")
    stance, unreachable = (model.solve_state(State(roll=roll)) for roll in (3.0, 35.0))
    assert stance.stand is not None
    scene.show(stance)
    scene.draw_twin(robot, stance.stand.qpos, pa.Ground())
    stand, twin = drawn.nodes["/stand"], drawn.nodes["/twin"]
    assert stand.visible
    assert twin.visible
    np.testing.assert_allclose(twin.position, [0.0, 2.6 * robot.stand_height, 0.0])
    base = robot.mj_model.body(robot.mj_base).id
    np.testing.assert_array_equal(
        drawn.nodes[f"/twin/{base}"].position, drawn.nodes[f"/stand/{base}"].position
    )
    scene.show(unreachable)
    scene.draw_ghost(robot, stance.stand)
    ghost = drawn.nodes["/ghost"]
    assert (stand.visible, twin.visible, ghost.visible) == (False, False, True)
    scene.show(stance)
    assert (stand.visible, twin.visible, ghost.visible) == (True, False, False)


def test_the_arrow_of_a_weight_has_three_times_the_height_of_the_stand() -> None:
    """By hand: half of the weight, upward from the point of contact."""
    robot, point = load("v3"), np.array([0.1, 0.2, 0.0])
    force = np.array([0.0, 0.0, robot.weight / 2])
    ((start, end),) = make_force_arrows(robot, [DrawnForce("FL", point, force)])
    assert start == pytest.approx(point)
    assert end - start == pytest.approx([0.0, 0.0, 1.5 * robot.stand_height])


@pytest.mark.parametrize("num_corners", [1, 3, 24, 25, 60])
def test_drawn_support_polygon_has_all_corners(num_corners: int) -> None:
    """Reference: the area of a regular polygon, n / 2 sin(2 pi / n) r^2."""
    made: list[tuple[np.ndarray, np.ndarray]] = []

    def add_mesh_simple(_: str, vertices: np.ndarray, faces: np.ndarray, **__: object) -> Any:
        made.append((vertices, faces))
        return SimpleNamespace()

    scene = Scene(SimpleNamespace(add_mesh_simple=add_mesh_simple))
    angles = 2 * np.pi * np.arange(num_corners) / num_corners
    corners = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(num_corners)])
    scene._draw_support(SimpleNamespace(polygon=corners), held=True)  # type: ignore[arg-type]
    ((vertices, faces),) = made
    first, second, three = (vertices[faces[:, column]] for column in range(3))
    area = np.cross(second - first, three - first)[:, 2].sum() / 2
    assert area == pytest.approx(num_corners / 2 * np.sin(2 * np.pi / num_corners), abs=1e-12)
