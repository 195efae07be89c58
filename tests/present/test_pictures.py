"""``show`` and ``animate``: pixels of MuJoCo's renderer, written files, and results that cannot be
drawn.
"""

from __future__ import annotations

import pickle
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import pupper_analysis as pa
from pupper_analysis.base.errors import MissingPackageError, OutputError
from pupper_analysis.present import display, pictures
from tests.support.variants import load, stand_of

pytestmark = pytest.mark.usefixtures("without_window")


@pytest.fixture
def without_window(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("sys.platform", "linux")


def find_robot(pixels: np.ndarray) -> np.ndarray:
    """Return rows and columns of v3's yellow pixels: red and green, little blue."""
    red, green, blue = (pixels[..., index].astype(int) for index in range(3))
    return np.argwhere((red > 100) & (red - blue > 60) & (green > blue))


@pytest.mark.slow
def test_picture_of_a_stand_shows_the_whole_robot_in_the_middle() -> None:
    """Reference: the yellow pixels of v3's torso."""
    stand = stand_of("v3")
    picture = stand.show(size=(200, 150))
    assert isinstance(picture, Image.Image)
    assert picture.size == (200, 150)
    places = find_robot(np.asarray(picture))
    assert len(places) > 200
    assert (places.min(axis=0) > 5).all()
    assert (places.max(axis=0) < [145, 195]).all()
    assert np.abs(places.mean(axis=0) - [75, 100]).max() < 25


@pytest.mark.slow
def test_picture_of_a_slope_contains_the_slope() -> None:
    """More than 20 % of the pixels differ from the level ground."""
    robot = load("v3")
    task = pa.StandTask(contacts={"FR": pa.Contact(pa.Slope(0.3))})
    level, tilted = stand_of("v3"), pa.solve_stand(robot, task)
    first = np.asarray(level.show(size=(160, 120), elevation=0.0))
    second = np.asarray(tilted.show(size=(160, 120), elevation=0.0))
    assert (first != second).any(axis=2).mean() > 0.2


@pytest.mark.slow
def test_animation_of_a_verification_is_a_gif_with_its_time(tmp_path: Path) -> None:
    """The frame durations sum to the simulated time within 2 %."""
    report = pa.verify_stand(load("v3"), stand_of("v3"), duration=2.0)
    movie = report.animate(size=(80, 60))
    assert movie.frames.shape == (len(report.motion), 60, 80, 3)
    file = movie.save(tmp_path / "stand.gif")
    with Image.open(file) as read:
        assert read.n_frames >= 2  # equal frames are joined
        durations = []
        for index in range(read.n_frames):
            read.seek(index)
            durations.append(read.info["duration"])
        assert sum(durations) == pytest.approx(100 * len(report.motion), rel=0.02)
    movie.save(file)  # replaces its own file
    other = tmp_path / "other.gif"
    other.write_bytes(b"GIF89a of somebody else")
    with pytest.raises(OutputError):
        movie.save(other)
    assert "data:image/gif;base64," in movie._repr_html_()


@pytest.mark.slow
def test_animation_of_a_posture_turns_the_camera_once() -> None:
    """The frame after half a turn differs more from the first frame than the second frame does."""
    movie = pa.Configuration(load("v3"), stand_of("v3").qpos).animate(size=(64, 48))
    assert len(movie.frames) == 40
    changes = [np.abs(frame.astype(int) - movie.frames[0]).mean() for frame in movie.frames]
    assert changes[0] == 0
    assert changes[20] > changes[1] > 0


@pytest.mark.slow
def test_show_without_opengl_names_the_package_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", "nonsense")
    with pytest.raises(display.DisplayError, match=r"libegl1.*plot\(\)") as caught:
        stand_of("v3").show()
    assert "\n" not in str(caught.value)


def test_picture_of_a_result_without_view_is_refused(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    stand = stand_of("v3")
    with pytest.raises(pa.ConfigurationError, match=r"result\.show\(robot\)"):
        pickle.loads(pickle.dumps(stand)).show()
    for size in (
        (0, 10),
        (-1, 9),
        (9,),
        (1, 2, 3),
        3,
        "ab",
        (1.5, 2),
        (True, 2),
        (9, 8193),
        np.array(3),
    ):
        for draw in (stand.show, stand.animate):
            with pytest.raises(pa.ConfigurationError, match="two whole numbers from 1 to 8192"):
                draw(size=size)
    with pytest.raises(pa.ConfigurationError, match="at most 7500000 pixels per frame"):
        stand.animate(size=(8192, 8192))
    for option in ({"azimuth": np.nan}, {"elevation": np.inf}, {"width": 640}):
        with pytest.raises(pa.ConfigurationError, match=rf"{next(iter(option))}: .*(finite|size=)"):
            stand.show(**option)
    with pytest.raises(pa.ConfigurationError, match="contains no configuration"):
        pictures.show_result(pa.gravity_compensation(pa.Configuration(load("v3"), stand.qpos)))
    movie = pictures.Animation(np.zeros((2, 4, 4, 3), np.uint8), 10.0)
    with pytest.raises(pa.ConfigurationError, match=r"'\.avi' is unknown; valid:"):
        movie.save(tmp_path / "a.avi")
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(MissingPackageError, match="pip install"):
        movie.save(tmp_path / "a.mp4")
    assert not [*tmp_path.iterdir()]


def test_window_opens_with_the_stand_if_there_is_a_display(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Reference: qpos in MuJoCo's data."""
    shown = []
    monkeypatch.setattr(pictures, "check_display", lambda: None)
    monkeypatch.setattr(pictures, "show_window", lambda model, data: shown.append(data.qpos.copy()))
    robot, stand = load("v3"), stand_of("v3")
    assert stand.show() is None
    assert np.abs(shown[0][robot.mj_convention.qpos_index] - stand.qpos).max() < 1e-15


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # of imageio_ffmpeg
def test_animation_is_written_as_mp4_with_its_frames(tmp_path: Path) -> None:
    """The package imageio reads the file."""
    pytest.importorskip("imageio_ffmpeg")
    from imageio import v2 as imageio

    bright = np.arange(12, dtype=np.uint8)[:, None, None, None] * 20
    movie = pictures.Animation(np.broadcast_to(bright, (12, 32, 48, 3)).copy(), 10.0)
    file = movie.save(tmp_path / "grey.mp4")
    with imageio.get_reader(file) as reader:
        read = [frame.mean() for frame in reader]
        assert reader.get_meta_data()["fps"] == pytest.approx(10.0)
    np.testing.assert_allclose(read, bright.ravel(), atol=4)
    movie.save(file)  # replaces its own file
