"""Serves the page: each browser that opens it has a session of its own."""

from __future__ import annotations

import ctypes
import gc
import itertools
import sys
import threading
import time
import webbrowser
from collections.abc import Callable, Hashable
from typing import Any

from pupper_analysis.base.errors import PupperAnalysisError
from pupper_analysis.robot.joints import placed_joints
from pupper_analysis.tools.live import render
from pupper_analysis.tools.live.access import Access
from pupper_analysis.tools.live.model import Model
from pupper_analysis.tools.live.render import NAMES, Language
from pupper_analysis.tools.live.session import Session
from pupper_analysis.tools.live.state import LiveSource, State, parse_state

LOOPBACK = "127.0.0.1"

_FROM = (2.6, -2.3, 1.7)
"""Where it is looked from, in parts of the stand's height: from the front, on the right."""

RELOADED = 10.0
"""s within which a browser that left and comes back, asking for the same, goes on where it was: it
has loaded the page again, or lost its connection for a moment."""

_LEAVE = 1.0  # s that all sessions together have to end what they are at


class Served:
    """A page that is served until it is closed: each browser that opens it has a session.

    Args:
        robot: The robot's name, which the page is called by.
        size: How large it is (m): where it is looked at from.
        language: In which it opens, ``"en"`` or ``"zh"``, if its address says nothing else.
        host: Where it can be reached: by default from this machine alone.
        port: Where; any free one by default.

    Attributes:
        address: What a browser opens.
        sessions: {browser: its session}.

    Raises:
        ConfigurationError: If it cannot be served there, or the language is neither.
        MissingPackageError: If viser is not installed.
    """

    def __init__(self, robot: str, size: float, language: str, host: str, port: int | None) -> None:
        self._language = Language(language)
        self.sessions: dict[int, Any] = {}
        self._lock, self._closed = threading.Lock(), False
        access, free = Access(host), render.free_port(host, port)
        self._server = render.start_server(host, free, f"{robot}, live", access)
        self.address = render.address_of(self._server, host, access)
        self._size = size
        camera = self._server.initial_camera
        camera.position = tuple(size * number for number in _FROM)
        camera.look_at = self._target = (0.0, 0.0, 0.4 * size)
        camera.near = 0.05 * size
        self._server.on_client_connect(self._opened)
        self._server.on_client_disconnect(self._left)

    def _session(self, client: Any, address: str, words: str, say: Language) -> Any:
        """Returns a browser's session.

        Args:
            client: viser's handle of the browser.
            address: Host and port, as it reaches the server.
            words: The state that it asks for.
            say: The language that it asks for.
        """
        raise NotImplementedError

    def _opened(self, client: Any) -> None:
        if self._closed:  # it has waited in viser's queue until now, and would keep the process
            return
        address, words, language = render.asked_for(self._server, client.client_id)
        say = Language(language) if language in NAMES else self._language
        camera = client.camera
        if camera.image_width < camera.image_height:  # a phone, upright: its sheet leaves 45 %
            away = max(1.0, 1.3 * 0.45 * camera.image_height / camera.image_width)
            camera.position = tuple(away * self._size * number for number in _FROM)
            camera.look_at = self._target
        session = self._session(client, address, words, say)
        with self._lock:
            self.sessions[client.client_id] = session
        if self._closed or client.client_id not in self._server.get_clients():  # or it left
            self._left(client)

    def _left(self, client: Any) -> None:
        with self._lock:
            session = self.sessions.pop(client.client_id, None)
        if session is not None:
            session.close()
            give_back_later()

    def close(self) -> None:
        """Ends all sessions, and serves no more."""
        with self._lock:
            self._closed = True
            sessions = [*self.sessions.values()]
            self.sessions.clear()
        for session in sessions:
            session.close()
        render.stop_server(self._server)
        end = time.monotonic() + _LEAVE
        for thread in itertools.chain.from_iterable(session.threads for session in sessions):
            thread.join(max(0.0, end - time.monotonic()))


class Page(Served):
    """A page of stances.

    Args:
        source: Which robot it is about.
        state: What it begins with.
        language: See ``Served``, as host and port.
        host: Where it can be reached.
        port: Where.

    Raises:
        PupperAnalysisError: If there is no such robot.
        ConfigurationError: If it cannot be served there, the robot has no such state, or the
            language is neither.
        MissingPackageError: If viser is not installed.
    """

    def __init__(
        self,
        source: LiveSource,
        state: State | None = None,
        *,
        language: str = "en",
        host: str = LOOPBACK,
        port: int | None = None,
    ) -> None:
        render.import_viser()  # before the work
        self._model, self._state = Model(source), state or State()
        robot = self._model.robot(self._state)
        self._model.robot(State())
        check_state(self._model, self._state)
        self._came: dict[int, Hashable] = {}
        self._gone: dict[Hashable, tuple[float, State, Language]] = {}
        super().__init__(robot.name, robot.stand_height, language, host, port)

    def _session(self, client: Any, address: str, words: str, say: Language) -> Session:
        state, problem = self._state, None
        if words:
            try:
                state = parse_state(words)
                check_state(self._model, state)
            except PupperAnalysisError as error:
                state, problem = self._state, error.diagnostic
        came = (*render.browser_of(self._server, client.client_id), words)
        state, say = self._gone_on(came) or (state, say)
        with self._lock:
            self._came[client.client_id] = came
        return Session(client, self._model, state, address, problem, say)

    def _left(self, client: Any) -> None:
        with self._lock:
            session = self.sessions.get(client.client_id)
            came = self._came.pop(client.client_id, None)
            if session is not None and came is not None:
                self._gone[came] = (time.monotonic(), *session.asked)
        super()._left(client)

    def _gone_on(self, came: Hashable) -> tuple[State, Language] | None:
        """Returns what a browser had when it left just now; None if it did not."""
        now = time.monotonic()
        with self._lock:
            self._gone = {key: one for key, one in self._gone.items() if now - one[0] < RELOADED}
            left = self._gone.pop(came, None)
        return None if left is None else left[1:]


def check_state(model: Model, state: State) -> None:
    """Checks that a state is one of a robot.

    Raises:
        PupperAnalysisError: If not: it has no such foot, or cannot be scaled so.
    """
    robot = model.robot(state)
    state.task()
    for field, value in state.asked():
        for foot in value if field.per == "foot" else ():
            robot.points_of(foot)
        if field.per == "joint":
            placed_joints(robot, value)


def serve(page: Served, *, browser: bool, wait: Callable[[], object]) -> None:
    """Opens a browser, and serves until ``wait`` is over.

    Args:
        page: The page.
        browser: Whether to open a browser.
        wait: Returns, or raises, when it is time to end.
    """
    try:
        if browser:
            webbrowser.open(page.address)
        wait()
    finally:
        page.close()


# Memory that a session leaves, given back to the system.

_LATER = 1.0
"""s after which what a session leaves is given back: its threads have ended, its browser is let go
of, and of several that leave together it is done once."""

_lock = threading.Lock()
_waiting: list[threading.Timer] = []


def give_back_later() -> None:
    """Gives memory back in a moment; whoever asks again meanwhile is served as well."""
    with _lock:
        if not _waiting:
            timer = threading.Timer(_LATER, _in_time)
            timer.daemon = True
            _waiting.append(timer)
            timer.start()


def _in_time() -> None:
    with _lock:
        _waiting.clear()
    give_back()


def give_back() -> None:
    """Gives back what nobody uses, where the C library can (glibc).

    Each session has two threads, and glibc gives threads arenas of their own, whose free memory it
    keeps: of 60 sessions, five at a time, 85 MB of which nothing was in use.
    """
    gc.collect()
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim is not None:
            trim(0)
