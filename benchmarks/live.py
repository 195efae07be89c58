"""How often a second the live page can answer a slider: solve, forces, scene and words.

    python benchmarks/live.py [--variant v3] [--moves 300]
    python benchmarks/live.py --browser chromium

Each move is one step of a slider on its way to and fro; what is sent to browsers is made, as for
one of them, and put into viser's queue, but no browser is there to draw it. Times are those of the
thread's own work: on a machine that others use, too, the clock says more.

With --browser a hand drags a slider in a real page, for some seconds by the clock: how often the
page tells of it, and how many stances are solved and shown. The page draws once in 1.5 s meanwhile:
where a processor draws in a graphics card's place, that is all it could do.
"""

from __future__ import annotations

import math
import shutil
import statistics
import time
from collections.abc import Callable
from typing import Any
from unittest import mock

import click
import numpy as np

import pupper_analysis as pa
from pupper_analysis.tools.live import render
from pupper_analysis.tools.live.documents import stance_document
from pupper_analysis.tools.live.model import Answer, Model, predict_sag
from pupper_analysis.tools.live.scene import Scene
from pupper_analysis.tools.live.server import LOOPBACK, Page
from pupper_analysis.tools.live.session import Panels
from pupper_analysis.tools.live.state import LiveVariants, State


class Still:
    """Buttons that nobody presses."""

    def __getattr__(self, name: str) -> Callable[..., None]:
        return lambda *_: None


def measure(variant: str, moves: int) -> dict[str, list[float]]:
    """Returns the times (s) of the parts of each move."""
    model = Model(LiveVariants(pa.VARIANTS[variant]))
    port = render.free_port(LOOPBACK, None)
    server = render.start_server(LOOPBACK, port, "benchmark")
    taken: dict[str, list[float]] = {name: [] for name in ("solve and forces", "scene", "words")}
    wall = taken["all, by the clock"] = []
    try:
        scene = Scene(server.scene)
        panels = Panels(server, model, f"{LOOPBACK}:{port}", Still())
        for angle in np.sin(np.linspace(0.0, 12.0, moves)):
            begun, since = time.perf_counter(), time.thread_time()
            answer = model.answer(State(roll=float(12 * angle), height=130.0))
            assert answer.refusal is None, answer.refusal
            solved = time.thread_time()
            with server.atomic():
                scene.show(answer)
                shown = time.thread_time()
                panels.status(stance_document(answer, None, None))
                panels.answered(answer)
            done = time.thread_time()
            wall.append(time.perf_counter() - begun)
            for name, took in zip(
                taken, (solved - since, shown - solved, done - shown), strict=False
            ):
                taken[name].append(took)
        since = time.thread_time()
        predict_sag(answer)
        taken["sag, once it is still"] = [time.thread_time() - since]
    finally:
        render.stop_server(server)
    return taken


def dragged(variant: str, executable: str, seconds: float = 6.0) -> tuple[float, float]:
    """Returns how often a second a page tells of a slider, and how many stances are shown then."""
    from playwright.sync_api import sync_playwright

    messages: list[float] = []
    shown: list[float] = []
    show = Scene.show

    def counted(scene: Scene, answer: Answer) -> None:
        show(scene, answer)
        shown.append(time.monotonic())

    def sent(frame: bytes | str) -> None:
        if isinstance(frame, bytes) and b"GuiUpdate" in frame:
            messages.append(time.monotonic())

    def listen(socket: Any) -> None:
        socket.on("framesent", sent)

    page = Page(LiveVariants(pa.VARIANTS[variant]))
    with sync_playwright() as driver, mock.patch.object(Scene, "show", counted):
        arguments = ["--no-sandbox", "--use-gl=swiftshader", "--enable-unsafe-swiftshader"]
        browser = driver.chromium.launch(executable_path=executable, args=arguments)
        tab = browser.new_page(viewport={"width": 720, "height": 400})
        tab.on("websocket", listen)
        rarely = "window.requestAnimationFrame = f => setTimeout(() => f(performance.now()), 1500)"
        tab.add_init_script(rarely)
        tab.goto(page.address)
        tab.locator(".pa").first.wait_for()
        row = tab.get_by_text("roll (°)").first.locator("xpath=ancestor::*[.//input][1]")
        track = row.locator(".mantine-Slider-track").first
        time.sleep(5.0)  # s, until the meshes are there
        box = track.bounding_box()
        assert box is not None
        middle, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        tab.mouse.move(middle, y)
        tab.mouse.down()
        begun = time.monotonic()
        while (now := time.monotonic() - begun) < seconds:
            tab.mouse.move(middle + 0.15 * box["width"] * math.sin(2 * now), y)
            time.sleep(0.008)  # as often as a mouse tells
        browser.close()
    page.close()
    rates = (sum(0 < at - begun < seconds for at in times) / seconds for times in (messages, shown))
    return next(rates), next(rates)


@click.command()
@click.option("--variant", default="v3", show_default=True)
@click.option("--moves", default=300, show_default=True)
@click.option("--browser", metavar="FILE", help="A chromium: drag a slider in a real page.")
def main(variant: str, moves: int, browser: str | None) -> None:
    """Prints medians, and how many moves a second that makes."""
    if browser is not None:
        message, shown = dragged(variant, shutil.which(browser) or browser)
        print(f"a second: {message:.1f} moves that the page tells of, {shown:.1f} stances shown")
        return
    taken = measure(variant, moves)
    for name, times in taken.items():
        print(f"{name:24} {1e3 * statistics.median(times):7.2f} ms")
    work = sum(statistics.median(taken[name]) for name in ("solve and forces", "scene", "words"))
    clock = statistics.median(taken["all, by the clock"])
    print(f"moves a second           {1 / work:7.0f} of work, {1 / clock:.0f} by the clock")


if __name__ == "__main__":
    main()
