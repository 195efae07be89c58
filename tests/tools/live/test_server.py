"""A closed page ends at once, whatever its browsers do."""

from __future__ import annotations

import asyncio
import gc
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from typing import Any
from urllib.parse import urlsplit

import pytest

import pupper_analysis as pa
from pupper_analysis.cli import GC_THRESHOLDS
from pupper_analysis.tools.live import server
from pupper_analysis.tools.live.command import PYTHON_THRESHOLDS, _serve_page
from pupper_analysis.tools.live.server import Page
from pupper_analysis.tools.live.state import State
from tests.support.patience import PATIENCE

viser = pytest.importorskip("viser", reason="viser is not installed")
websockets = pytest.importorskip("websockets.asyncio.client")


@pytest.fixture
def page() -> Iterator[Page]:
    one = Page(pa.load_variant("v3"))
    yield one
    one.close()


def test_unresponsive_browser_does_not_delay_closing(page: Page) -> None:
    """viser would wait for 6 s and leave its thread; a sleeping browser needs 10 s and more."""
    server = page._server._websock_server._server_thread

    async def sleep_while_it_closes() -> None:
        async with websockets.connect(
            page.address.replace("http", "ws"),
            origin=f"http://{urlsplit(page.address).netloc}",
            subprotocols=[f"viser-v{viser.__version__}"],
            max_size=None,
        ):
            await asyncio.sleep(0.05)
            assert server.is_alive()
            page.close()  # the browser's loop is blocked meanwhile, so that it sends no close frame
            assert not server.is_alive()

    asyncio.run(sleep_while_it_closes())


def test_connection_after_closing_gets_no_session(
    page: Page, monkeypatch: pytest.MonkeyPatch
) -> None:
    """viser queues connections, which Python processes at exit."""
    made: list[Any] = []
    monkeypatch.setattr(page, "_make_session", lambda *arguments: made.append(arguments))
    page.close()
    page._on_connect(object())
    assert made == []
    assert page.sessions == {}


CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": [1.0, 0.0, 0.0, 0.0],
    "position": [1.0, 1.0, 1.0],
    "fov": 1.0,
    "near": 0.01,
    "far": 100.0,
    "image_height": 600,
    "image_width": 800,
    "look_at": [0.0, 0.0, 0.0],
    "up_direction": [0.0, 0.0, 1.0],
}
"""First message of viser's page."""


def test_browsers_have_separate_sessions(page: Page) -> None:
    """A slider of one browser changes the other's state neither before nor after the end of that
    browser, whose threads end."""
    pack = pytest.importorskip("msgspec").msgpack.encode

    async def wait_for(condition: Callable[[], object]) -> None:
        for _ in range(6000):
            if condition():
                return
            await asyncio.sleep(0.02)
        raise AssertionError("nothing changes")

    def connect() -> Any:
        return websockets.connect(
            page.address.replace("http", "ws"),
            origin=f"http://{urlsplit(page.address).netloc}",
            subprotocols=[f"viser-v{viser.__version__}"],
            max_size=None,
        )

    async def open_session(socket: Any) -> Any:
        known = set(page.sessions)
        await socket.send(pack(CAMERA))
        await wait_for(lambda: set(page.sessions) - known)
        return page.sessions[(set(page.sessions) - known).pop()]

    async def type_value(socket: Any, session: Any, slider: str, value: float) -> None:
        uuid = session._panels.controls.sliders[slider]._impl.uuid
        update = {"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": value}}
        await socket.send(pack(update))

    async def use_two_browsers() -> None:
        async with connect() as one:
            first = await open_session(one)
            async with connect() as two:
                second = await open_session(two)
                await type_value(two, second, "pitch", 6)
                await type_value(one, first, "roll", 4)
                await wait_for(lambda: second._panels.controls.state == State(pitch=6.0))
                await wait_for(lambda: first._panels.controls.state == State(roll=4.0))
                assert second._panels.controls.state == State(pitch=6.0)
            await wait_for(lambda: second not in page.sessions.values())
            await wait_for(lambda: not any(thread.is_alive() for thread in second.threads))
            await type_value(one, first, "roll", 5)
            await wait_for(lambda: first._panels.controls.state == State(roll=5.0))
            assert all(thread.is_alive() for thread in first.threads)

    asyncio.run(use_two_browsers())


@pytest.mark.slow
def test_a_page_retains_no_objects_of_earlier_actions(page: Page) -> None:
    """An answer has some hundred objects, each with arrays; actions retained 60 kB in the past.

    The objects of Python's garbage collector are counted after 12 and after 24 actions.
    """
    pack = pytest.importorskip("msgspec").msgpack.encode

    async def count_objects() -> list[int]:
        async with websockets.connect(
            page.address.replace("http", "ws"),
            origin=f"http://{urlsplit(page.address).netloc}",
            subprotocols=[f"viser-v{viser.__version__}"],
            max_size=None,
        ) as socket:
            await socket.send(pack(CAMERA))
            while not page.sessions:
                await asyncio.sleep(0.02)
            (session,) = page.sessions.values()
            slider, counts = session._panels.controls.sliders["pitch"]._impl.uuid, []
            for action in range(1, 25):
                pitch = 1.0 + action % 7
                update = {"type": "GuiUpdateMessage", "uuid": slider, "updates": {"value": pitch}}
                await socket.send(pack(update))
                answer, sag = None, None
                while answer is None or answer.state.pitch != pitch or sag is None:
                    await asyncio.sleep(0.01)
                    answer, sag = session.get_shown_stance()
                if action % 12 == 0:
                    gc.collect()
                    counts.append(len(gc.get_objects()))
            return counts

    first, second = asyncio.run(asyncio.wait_for(count_objects(), PATIENCE))
    assert second - first < 12 * 20  # fewer than 20 objects per action


@pytest.mark.slow
def test_a_termination_signal_ends_a_page_that_computes_for_a_browser() -> None:
    """The first stance is analysed when the signal arrives."""
    pack = pytest.importorskip("msgspec").msgpack.encode
    process = subprocess.Popen(
        [sys.executable, "-m", "pupper_analysis", "live", "v3", "--no-browser"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    address = process.stdout.readline().split()[1]

    async def terminate() -> None:
        async with websockets.connect(
            address.replace("http", "ws"),
            origin=f"http://{urlsplit(address).netloc}",
            subprotocols=[f"viser-v{viser.__version__}"],
            max_size=None,
        ) as socket:
            await socket.send(pack(CAMERA))
            await socket.recv()
            process.send_signal(signal.SIGTERM)
            while process.poll() is None:
                await asyncio.sleep(0.02)

    asyncio.run(asyncio.wait_for(terminate(), PATIENCE))
    _, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == 128 + signal.SIGTERM
    assert err == "terminated\n"


@pytest.mark.slow
def test_serving_uses_the_default_garbage_collection(
    page: Page, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Commands postpone garbage collection, which would leave 60 kB of cycles per browser
    action."""
    found: list[tuple[int, int, int]] = []
    monkeypatch.setattr(server, "serve", lambda *_, **__: found.append(gc.get_threshold()))
    before = gc.get_threshold()
    gc.set_threshold(*GC_THRESHOLDS)
    try:
        _serve_page(page, "127.0.0.1", browser=False)
        assert gc.get_freeze_count() > 0
    finally:
        gc.unfreeze()
        gc.set_threshold(*before)
    assert found == [PYTHON_THRESHOLDS]
