"""A closed page ends at once, whatever its browsers do."""

from __future__ import annotations

import asyncio
import gc
from collections.abc import Iterator
from typing import Any
from urllib.parse import urlsplit

import pytest

import pupper_analysis as pa
from pupper_analysis.cli import GC_THRESHOLDS
from pupper_analysis.tools.live import server
from pupper_analysis.tools.live.command import PYTHON_THRESHOLDS, _serve
from pupper_analysis.tools.live.server import Page

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
            page.close()  # the browser's loop stands still meanwhile: it does not say goodbye
            assert not server.is_alive()

    asyncio.run(sleep_while_it_closes())


def test_connection_after_closing_gets_no_session(
    page: Page, monkeypatch: pytest.MonkeyPatch
) -> None:
    """viser queues connections, which Python processes at exit."""
    made: list[Any] = []
    monkeypatch.setattr(page, "_make_session", lambda *asked: made.append(asked))
    page.close()
    page._on_connect(object())
    assert made == []
    assert page.sessions == {}


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
        _serve(page, "127.0.0.1", browser=False)
        assert gc.get_freeze_count() > 0
    finally:
        gc.unfreeze()
        gc.set_threshold(*before)
    assert found == [PYTHON_THRESHOLDS]
