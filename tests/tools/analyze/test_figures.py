"""The rendered picture of robots, and the line drawing that replaces it without OpenGL."""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread

import pupper_analysis as pa
from pupper_analysis.base.errors import ConfigurationError, OutputError
from pupper_analysis.tools.analyze import figures as render
from pupper_analysis.tools.analyze.figures import lay_out_tiles
from tests.support.legged import quadruped, rewrite_file, with_arm
from tests.support.patience import PATIENCE
from tests.support.variants import load, stand_of

WIDTH = 420
BACKGROUND = np.array([0xEE, 0xF1, 0xF5]) / 255


def pixels(path: Path) -> np.ndarray:
    """Return the colours, shape (height, width, 3), of a PNG that is not of one colour."""
    assert path.read_bytes().startswith(b"\x89PNG")
    image = np.asarray(imread(path))[..., :3]
    assert (np.abs(image - image[0, 0]).max(axis=-1) > 0.05).mean() > 0.02
    return image


def is_background(image: np.ndarray) -> np.ndarray:
    return np.asarray((np.abs(image - BACKGROUND) < 0.01).all(axis=-1))


def pairs(*names: str) -> list[tuple[pa.Robot, pa.Stand]]:
    return [(load(name), stand_of(name)) for name in names]


@pytest.fixture
def no_opengl(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", "disable")


def render_with_opengl(*arguments: Any, **options: Any) -> render.Picture:
    picture = render.render_variants(*arguments, **options)
    if picture.method == "lines":
        pytest.skip(f"this computer has {picture.note}")
    assert picture.note is None
    return picture


# ------------------------------------------------------------------------------------- OpenGL


@pytest.mark.slow
def test_robots_are_rendered_side_by_side(tmp_path: Path) -> None:
    """Pixels: each third shows a robot with yellow parts and an empty border."""
    picture = render_with_opengl(
        pairs("original", "v3", "v3-heavy"), tmp_path / "a.png", width=WIDTH
    )
    image = pixels(picture.path)
    assert image.shape[1] == WIDTH
    for tile in np.split(image, 3, axis=1):
        # A robot with a yellow shell in the middle, and background at the edges of the tile.
        share = 1 - is_background(tile).mean()
        assert 0.2 < share < 0.8
        yellow = (tile[..., 0] > 0.6) & (tile[..., 2] < 0.4)
        assert yellow.mean() > 0.02
        edges = (tile[0], tile[-1], tile[:, 0], tile[:, -1])
        assert all(is_background(edge).all() for edge in edges)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["original", "v3"])
def test_line_drawing_has_the_projection_of_the_rendered_picture(name: str, tmp_path: Path) -> None:
    """Reference: the rendered picture, whose feet are black, at the feet of the line drawing."""
    picture = render_with_opengl(pairs(name), tmp_path / "a.png", width=WIDTH)
    image = pixels(picture.path)
    robot, stand = load(name), stand_of(name)
    (tile,) = lay_out_tiles([(robot, stand.qpos)], WIDTH, 1)
    for foot, leg in tile.lines.legs.items():
        x, y = tile.pixels(leg[-1:])[0].astype(int)
        if foot != "RL":  # which others hide in part
            assert image[y - 3 : y + 3, x - 3 : x + 3].max() < 0.35, foot


@pytest.mark.slow
def test_heavier_torso_is_marked_by_a_dark_block(tmp_path: Path) -> None:
    """The top 30 % of the heavy variant's tile has dark pixels, that of the original has none."""
    picture = render_with_opengl(pairs("original", "heavy"), tmp_path / "a.png", width=2 * WIDTH)
    original, heavy = np.split(pixels(picture.path), 2, axis=1)
    top = len(original) * 3 // 10  # above the hips' motors
    assert (original[:top].max(axis=-1) < 0.2).mean() == 0
    assert (heavy[:top].max(axis=-1) < 0.2).mean() > 0.01


@pytest.mark.slow
@pytest.mark.parametrize("opengl", [True, False])
def test_ground_and_scale_bar_are_drawn_at_the_scale_of_the_robots(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, opengl: bool
) -> None:
    """The bar is as long as 100 mm are in the projection; the ground lies below all feet."""
    if opengl:
        picture = render_with_opengl(pairs("v3"), tmp_path / "a.png", width=WIDTH)
    else:
        monkeypatch.setenv("MUJOCO_GL", "disable")
        picture = render.render_variants(pairs("v3"), tmp_path / "a.png", width=WIDTH)
    image = pixels(picture.path)
    (tile,) = lay_out_tiles([(load("v3"), stand_of("v3").qpos)], WIDTH, 1)
    (start, _), (end, _) = tile.pixels(np.array([[0.0, 0, 0], 0.1 * render.IMAGE_RIGHT]))
    dark = (image[tile.height :].max(axis=-1) < 0.4).sum(axis=1).max()
    assert dark == pytest.approx(end - start, abs=2)
    for corner in tile.ground:
        inside = 0.97 * corner + 0.03 * tile.ground.mean(axis=0)
        x, y = tile.pixels(inside[None])[0].astype(int)
        assert not is_background(image[y : y + 1, x : x + 1]).any()
    feet = np.array([leg[-1] for leg in tile.lines.legs.values()])
    assert (tile.ground.min(axis=0)[:2] < feet[:, :2].min(axis=0)).all()
    assert (tile.ground.max(axis=0)[:2] > feet[:, :2].max(axis=0)).all()


# ------------------------------------------------------------------------------------- no OpenGL


@pytest.mark.parametrize(
    ("lengths", "label"),
    [
        ((0.08, 0.11), "legs 190 mm, mass 3.17 kg"),
        ((None, 0.11), "mass 3.17 kg"),
        ((None, None), "mass 3.17 kg"),
    ],
)
def test_label_omits_an_unknown_leg_length(
    lengths: tuple[float | None, float | None], label: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot, stand = load("v3"), stand_of("v3")
    (tile,) = lay_out_tiles([(robot, stand.qpos)], WIDTH, 1)
    monkeypatch.setattr(render, "measure_leg_lengths", lambda robot: lengths)
    canvas = Figure().add_subplot()
    render._write_label(canvas, tile)
    assert [text.get_text() for text in canvas.texts] == ["v3", label]


def test_long_name_of_a_robot_fits_the_tile() -> None:
    """Reference: bounding box. Long names of robots side by side overlapped."""
    robot, stand = load("v3"), stand_of("v3")
    tile = lay_out_tiles([(robot, stand.qpos)] * 3, WIDTH, 3)[1]
    tile = replace(tile, robot=SimpleNamespace(name="W" * 60, total_mass=0.00317))
    figure = Figure(figsize=(WIDTH / 100, 4), dpi=100)
    canvas = figure.add_axes((0, 0, 1, 1), xlim=(0, WIDTH), ylim=(400, 0))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(render, "measure_leg_lengths", lambda robot: (None, None))
        render._write_label(canvas, tile)
    name, numbers = canvas.texts
    assert numbers.get_text() == "mass 0.0032 kg"
    box = name.get_window_extent()
    assert tile.left <= box.x0 < box.x1 <= tile.left + tile.width


@pytest.mark.usefixtures("no_opengl")
def test_line_drawing_without_opengl(tmp_path: Path) -> None:
    picture = render.render_variants(pairs("original", "v3"), tmp_path / "a.png", width=WIDTH)
    assert picture.method == "lines"
    assert picture.note is not None
    assert "MUJOCO_GL" in picture.note
    assert "line drawing" in picture.note
    for tile in np.split(pixels(picture.path), 2, axis=1):
        assert 0.2 < 1 - is_background(tile).mean() < 0.8


@pytest.mark.slow
@pytest.mark.parametrize(
    ("variables", "methods"),
    [
        ({}, ("egl", "osmesa", "glfw", "cgl", "lines")),
        ({"MUJOCO_GL": "disable"}, ("lines",)),
        ({"MUJOCO_GL": "egl", "__EGL_VENDOR_LIBRARY_FILENAMES": "/nowhere"}, ("lines",)),
        ({"MUJOCO_GL": "glfw"}, ("lines",)),
    ],
    ids=["unset", "disabled", "no driver", "no display"],
)
@pytest.mark.skipif(sys.platform != "linux", reason="the variables are those of Linux")
def test_a_fresh_process_is_quiet(
    variables: dict[str, str], methods: tuple[str, ...], tmp_path: Path
) -> None:
    """Renders twice, in a process without a display: MuJoCo may not survive a second failure."""
    code = (
        "import sys, pupper_analysis as pa\n"
        "from pupper_analysis.tools.analyze.figures import render_variants\n"
        "robot = pa.load_variant('original')\n"
        "pair = robot, pa.solve_stand(robot)\n"
        "for _ in range(2):\n"
        "    picture = render_variants([pair], sys.argv[1], width=300)\n"
        "print(picture.method, bool(picture.note))\n"
    )
    hidden = ("MUJOCO_GL", "DISPLAY", "WAYLAND_DISPLAY", "PYOPENGL_PLATFORM")
    environment = {key: value for key, value in os.environ.items() if key not in hidden}
    command = [sys.executable, "-W", "ignore::DeprecationWarning", "-c", code]
    done = subprocess.run(
        [*command, str(tmp_path / "a.png")],
        env={**environment, **variables},
        capture_output=True,
        text=True,
        timeout=PATIENCE,
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    method, noted = done.stdout.split()
    assert method in methods
    assert noted == str(method == "lines")
    pixels(tmp_path / "a.png")


@pytest.mark.parametrize(
    ("variables", "system", "expected"),
    [
        ({}, "Linux", ("egl", "osmesa")),
        ({"DISPLAY": ":0"}, "Linux", ("egl", "osmesa", "glfw")),
        ({"MUJOCO_GL": " EGL "}, "Linux", ("egl",)),
        ({"MUJOCO_GL": "osmesa", "DISPLAY": ":0"}, "Linux", ("osmesa",)),
        ({"MUJOCO_GL": "off"}, "Linux", ()),
        ({}, "Darwin", ("cgl", "glfw")),
        ({}, "Windows", ("glfw",)),
    ],
)
def test_rendering_backends_follow_from_system_and_environment(
    variables: dict[str, str],
    system: str,
    expected: tuple[str, ...],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name in ("MUJOCO_GL", "DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(render.platform, "system", lambda: system)
    assert render._list_backends() == expected


def test_osmesa_is_tried_after_egl_and_lines_are_drawn_at_last(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Both backends fail as PyOpenGL does without its libraries; environment variables are
    restored.
    """
    backends = []

    def fail(backend: str, tiles: Any) -> Any:
        backends.append(backend)
        os.environ["PYOPENGL_PLATFORM"] = backend
        raise AttributeError("'NoneType' object has no attribute 'glGetError'")

    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.delenv("PYOPENGL_PLATFORM", raising=False)
    monkeypatch.setattr(render.platform, "system", lambda: "Linux")
    monkeypatch.setattr(render, "_render_with", fail)
    picture = render.render_variants(pairs("original"), tmp_path / "a.png", width=WIDTH)
    assert backends == ["egl", "osmesa"]
    assert picture.method == "lines"
    assert picture.note is not None
    assert "glGetError" in picture.note
    assert "PYOPENGL_PLATFORM" not in os.environ


# ------------------------------------------------------------------------------------- errors


def test_no_robot_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="no robot"):
        render.render_variants([], tmp_path / "a.png")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("no_opengl")
def test_path_below_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("no folder")
    with pytest.raises(OutputError):
        render.render_variants(pairs("original"), tmp_path / "file" / "a.png", width=WIDTH)


def test_tiles_of_robots_of_different_size_have_one_scale() -> None:
    """Reference: the pixels of a vector of 0.1 m in each tile."""
    poses = [(load(name), stand_of(name).qpos) for name in ("original", "long-leg")]
    ends = np.array([[0.0, 0, 0], 0.1 * render.IMAGE_RIGHT])
    lengths = [np.ptp(tile.pixels(ends)[:, 0]) for tile in lay_out_tiles(poses, WIDTH, 2)]
    assert lengths[0] == pytest.approx(lengths[1])


def mast_on_arm(folder: Path) -> tuple[pa.Robot, pa.Stand]:
    """Return a quadruped with an arm that carries a visual mast, 1.2 m high and 0.8 m wide."""
    pair = with_arm(quadruped(folder, floor=True, actuators="position"))
    mast = '<geom name="mast" type="box" size="0.02 0.4 0.6" contype="0" conaffinity="0"/>'
    rewrite_file(pair.mjcf, ('<geom name="hand"', f'{mast}<geom name="hand"'))
    robot = pa.load_robot(*pair)
    return robot, pa.solve_stand(robot)


def test_tile_contains_the_corners_of_a_geom_on_an_arm(tmp_path: Path) -> None:
    """Reference: MuJoCo's pose of the geom, and the half sizes in the MJCF [m]."""
    robot, stand = mast_on_arm(tmp_path)
    tiles = lay_out_tiles([(robot, stand.qpos)] * 2, WIDTH, 2)
    data = robot.compute_kinematics(stand.qpos)
    mast = data.geom("mast")
    corners = np.array(list(itertools.product((-0.02, 0.02), (-0.4, 0.4), (-0.6, 0.6))))
    for tile in tiles:
        x, y = tile.pixels(mast.xpos + corners @ mast.xmat.reshape(3, 3).T).T
        assert tile.left < x.min() < x.max() < tile.left + tile.width
        label = render.LABEL_HEIGHT * tile.width
        assert tile.top < y.min() < y.max() < tile.top + tile.height - label
        assert tile.height <= 1.5 * tile.width + 1


def test_single_tile_of_a_high_robot_is_not_higher_than_wide(tmp_path: Path) -> None:
    robot, stand = mast_on_arm(tmp_path)
    (tile,) = lay_out_tiles([(robot, stand.qpos)], WIDTH, 1)
    assert tile.height <= tile.width + 1


@pytest.mark.slow
def test_geom_on_an_arm_does_not_touch_the_edge_of_the_rendered_picture(tmp_path: Path) -> None:
    picture = render_with_opengl([mast_on_arm(tmp_path)], tmp_path / "a.png", width=WIDTH)
    image = pixels(picture.path)
    for edge in (image[0], image[-1], image[:, 0], image[:, -1]):
        assert is_background(edge).all()


@pytest.mark.slow
def test_rendering_keeps_the_environment(tmp_path: Path) -> None:
    before = dict(os.environ)
    render.render_variants(pairs("original"), tmp_path / "a.png", width=WIDTH)
    assert dict(os.environ) == before
