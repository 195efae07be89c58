"""The live page in a browser: sliders move robots, and closed pages leave no threads."""

from __future__ import annotations

import io
import re
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import pupper_analysis as pa
from pupper_analysis.tools.live.server import Page
from tests.present.test_html_browser import browser  # noqa: F401 - the fixture
from tests.repository.test_readme import commands
from tests.support.patience import PATIENCE
from tests.support.repository import ROOT
from tests.support.variants import load

pytest.importorskip("viser", reason="viser is not installed")

pytestmark = pytest.mark.slow

KNOWN = ("GPU stall", "THREE.Clock", "WebGL")
"""Parts of messages that chromium and viser print about software rendering."""


def wait_for(condition: Callable[[], object], what: str) -> None:
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end, what
        time.sleep(0.05)


def threads() -> list[str]:
    return [thread.name for thread in threading.enumerate() if thread.name.startswith("live-")]


@pytest.fixture(scope="module")
def served() -> Iterator[Page]:
    page = Page(pa.load_variant("v3"))
    yield page
    page.close()
    wait_for(lambda: not threads(), "threads are left")


class Opened:
    """Live page in a browser, with the recorded error messages."""

    def __init__(self, browser: Any, address: str) -> None:  # noqa: F811
        # Small and coarse: every pixel is drawn by the processor.
        address += ("&" if "?" in address else "?") + "fixedDpr=0.5"
        self.context = browser.new_context(viewport={"width": 960, "height": 560})
        self.page = self.context.new_page()
        self.page.set_default_timeout(1e3 * PATIENCE)
        self.complaints: list[str] = []
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("console", self._hear)
        self.page.goto(address)
        self.page.locator(".pa").first.wait_for(state="attached")
        # A box of viser in front of the scene reports software rendering.
        self.page.add_style_tag(content=".mantine-Notification-root {visibility: hidden}")

    def _hear(self, message: Any) -> None:
        if message.type in ("error", "warning") and not any(k in message.text for k in KNOWN):
            self.complaints.append(message.text)

    def close(self) -> None:
        self.context.close()

    def pixels(self) -> np.ndarray:  # type: ignore[type-arg]
        """Return the pixels of the canvas between the panels, with the robot in the middle."""
        shot = self.page.locator("canvas").first.screenshot()
        return np.asarray(Image.open(io.BytesIO(shot)).convert("RGB")).astype(int)

    def press(self, element: Any) -> None:
        """Clicks in the middle: viser's tabs and buttons listen to the mouse."""
        element.wait_for()
        element.scroll_into_view_if_needed()
        box = element.bounding_box()
        self.page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)

    def button(self, name: str) -> None:
        self.press(self.page.get_by_role("button", name=name, exact=True).first)

    def row(self, label: str) -> Any:
        text = self.page.get_by_text(label).first
        return text.locator("xpath=ancestor::*[.//input or .//textarea][1]")

    def set(self, label: str, value: object) -> None:
        box = self.row(label).locator("input[type=text]").first
        box.fill(str(value))
        box.press("Enter")

    def words(self) -> str:
        return str(self.page.locator(".pa:visible").first.inner_text())

    def says(self, what: str) -> None:
        wait_for(lambda: what in " ".join(self.all_words()), f"{what!r} is not said")

    def all_words(self) -> list[str]:
        return [str(text) for text in self.page.locator(".pa:visible").all_inner_texts()]

    def torques(self) -> list[float]:
        cells = self.page.locator("table.barred:visible td:nth-child(2)").all_inner_texts()
        return [float(text) for text in cells]

    def takes(self, stand: pa.Stand) -> None:
        """Wait until the torques on the page equal those of a stand, by the Python functions."""
        expected = pa.stance.stand_statics(load("v3"), stand).joint_torques

        def same() -> bool:
            shown = self.torques()
            return len(shown) == len(expected) and bool(np.allclose(shown, expected, atol=6e-5))

        wait_for(same, f"{self.torques()} are not {expected}")


@pytest.fixture
def opened(browser: Any, served: Page) -> Iterator[Opened]:  # noqa: F811
    one = Opened(browser, served.address)
    one.takes(pa.stance.solve_stand_on_soft_ground(load("v3")))
    yield one
    one.close()
    wait_for(lambda: not served.sessions, "a session is left")
    assert one.complaints == []


def measure_difference(one: np.ndarray, other: np.ndarray) -> float:  # type: ignore[type-arg]
    return float((np.abs(one - other).max(axis=-1) > 25).mean())


def drag_slider(opened: Opened, label: str, fraction: float) -> None:
    """Drag a slider with the mouse, from its middle by a fraction of its length."""
    track = opened.row(label).locator(".mantine-Slider-track").first
    track.scroll_into_view_if_needed()
    box = track.bounding_box()
    y = box["y"] + box["height"] / 2
    opened.page.mouse.move(box["x"] + box["width"] / 2, y)
    opened.page.mouse.down()
    for share in np.linspace(0.0, fraction, 12)[1:]:
        opened.page.mouse.move(box["x"] + box["width"] * (0.5 + share), y)
    opened.page.mouse.up()


def test_a_slider_moves_the_robot_and_the_torques(opened: Opened, served: Page) -> None:
    """Reference: torques and height loss of the Python functions for the same task; the slider is
    typed, and dragged."""
    before = opened.pixels()
    yellow = (before[..., 0] > 150) & (before[..., 2] < 110)  # the torso
    assert yellow.mean() > 0.005
    settled = pa.steady_state(load("v3"), pa.stance.solve_stand_on_soft_ground(load("v3")))
    opened.says(f"{1e3 * settled.height_loss:.3f}\tmm")

    opened.set("roll (°)", 8)
    opened.takes(
        pa.stance.solve_stand_on_soft_ground(load("v3"), pa.StandTask(roll=np.radians(8.0)))
    )
    wait_for(lambda: measure_difference(opened.pixels(), before) > 0.005, "the robot does not move")

    opened.set("height (mm)", 120)
    task = pa.StandTask(roll=np.radians(8.0), height=0.12)
    opened.takes(pa.stance.solve_stand_on_soft_ground(load("v3"), task))
    assert "120.0\tmm" in opened.words()
    opened.button("Reset all")
    opened.takes(pa.stance.solve_stand_on_soft_ground(load("v3")))

    drag_slider(opened, "pitch (°)", 0.11)
    (session,) = served.sessions.values()
    controls = session._panels.controls
    wait_for(lambda: controls.state.pitch > 8.0, "the dragged slider has no effect")
    time.sleep(0.2)  # viser holds messages back for some milliseconds
    state = controls.state
    assert 8.0 < state.pitch < 12.0
    opened.takes(pa.stance.solve_stand_on_soft_ground(load("v3"), state.task()))


GUIDE = ROOT / "docs" / "how-to" / "live.md"
PAGES = [
    command for command in commands(GUIDE.read_text()) if command.split()[1:] == ["live", "v3"]
]


@pytest.mark.parametrize("command", PAGES)
def test_a_command_serves_until_it_is_interrupted(command: str, tmp_path: Path) -> None:
    arguments = [sys.executable, "-m", "pupper_analysis", *command.split()[1:], "--no-browser"]
    process = subprocess.Popen(
        arguments,
        cwd=tmp_path,
        env={"PYTHONPATH": str(ROOT), "PATH": ""},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # A parent in the background of a shell ignores SIGINT, and its children would, too.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    assert process.stdout is not None
    said = process.stdout.readline()
    found = re.match(r"SERVING (http://127\.0\.0\.1:\d+/) until Ctrl-C$", said)
    assert found is not None, said
    assert process.stdout.readline().startswith("  only this machine can open the page")
    port = int(found[1].split(":")[2].rstrip("/"))
    for nonsense in (b"", b"\x00\xff\r\n\r\n", b"GET /../../etc HTTP/1.1\r\n\r\n"):
        with socket.create_connection(("127.0.0.1", port), timeout=PATIENCE) as knocks:
            knocks.sendall(nonsense)
    time.sleep(0.5)  # before viser suppresses messages about such connections
    with urllib.request.urlopen(found[1], timeout=PATIENCE) as answered:
        assert b"<title>" in answered.read()
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == 130
    assert out == ""
    assert err == "interrupted\n"
