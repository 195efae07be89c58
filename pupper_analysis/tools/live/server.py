"""Serves the page: each browser that opens it has a session of its own."""

from __future__ import annotations

import itertools
import threading
import time
import webbrowser
from collections.abc import Callable
from typing import Any, TypedDict, Unpack

from pupper_analysis.robot.joints import placed_joints
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.touching import touching
from pupper_analysis.tools.live import render
from pupper_analysis.tools.live.access import Access
from pupper_analysis.tools.live.model import StanceSolver
from pupper_analysis.tools.live.render import Language
from pupper_analysis.tools.live.session import Session
from pupper_analysis.tools.live.state import State, check_page_robot

DEFAULT_HOST = "127.0.0.1"

_FROM = (2.6, -2.3, 1.7)
"""Where it is looked from, in parts of the stand's height: from the front, on the right."""

_LEAVE = 1.0  # s that all sessions together have to end what they are at


class ServeOptions(TypedDict, total=False):
    """Where and how a page is served; see ``Served``."""

    language: str
    host: str
    port: int | None


class ServedPage:
    """A page that is served until it is closed: each browser that opens it has a session.

    Args:
        robot: The robot's name, which the page is called by.
        size: How large it is (m): where it is looked at from.
        session: Makes a browser's session of viser's handle of it, and the language.
        language: ``"en"`` or ``"zh"``.
        host: Where it can be reached: by default from this machine alone.
        port: Where; any free one by default.

    Attributes:
        address: What a browser opens.
        sessions: {browser: its session}.

    Raises:
        ConfigurationError: If it cannot be served there, or the language is neither.
        MissingPackageError: If viser is not installed.
    """

    def __init__(
        self,
        robot: str,
        size: float,
        session: Callable[[Any, Language], Any],
        *,
        language: str = "en",
        host: str = DEFAULT_HOST,
        port: int | None = None,
    ) -> None:
        self._language, self._session = Language(language), session
        self.sessions: dict[int, Any] = {}
        self._lock, self._closed = threading.Lock(), False
        access, free = Access(host), render.find_free_port(host, port)
        self._server = render.start_server(host, free, f"{robot}, live", access)
        self.address = render.make_address(self._server, host, access)
        camera = self._server.initial_camera
        camera.position = tuple(size * number for number in _FROM)
        camera.look_at = (0.0, 0.0, 0.4 * size)
        camera.near = 0.05 * size
        self._server.on_client_connect(self._opened)
        self._server.on_client_disconnect(self._left)

    def _opened(self, client: Any) -> None:
        if self._closed:  # it has waited in viser's queue until now, and would keep the process
            return
        session = self._session(client, self._language)
        with self._lock:
            self.sessions[client.client_id] = session
        if self._closed or client.client_id not in self._server.get_clients():  # or it left
            self._left(client)

    def _left(self, client: Any) -> None:
        with self._lock:
            session = self.sessions.pop(client.client_id, None)
        if session is not None:
            session.close()

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


class Page(ServedPage):
    """A page of stances.

    Args:
        robot: The robot.
        state: What it begins with.
        **where: See ``Served``.

    Raises:
        ConfigurationError: If it cannot be served there, the robot has no such state, or the
            language is neither.
        MissingPackageError: If viser is not installed.
    """

    def __init__(
        self, robot: Robot, state: State | None = None, **where: Unpack[ServeOptions]
    ) -> None:
        render.import_viser()  # before the work
        check_page_robot(robot)
        model, begin = StanceSolver(robot), state or State()
        check_state(model, begin)
        super().__init__(
            robot.name,
            robot.stand_height,
            lambda client, say: Session(client, model, begin, say),
            **where,
        )


def check_state(model: StanceSolver, state: State) -> None:
    """Checks that a state is one of a robot.

    Raises:
        PupperAnalysisError: If not: it has no such foot, or no such link for a payload.
    """
    robot = touching(model.load_robot(state), state.task().contacts)
    for field, value in state.requested_values():
        for foot in value if field.per == "foot" else ():
            robot.points_of(foot)
        if field.per == "joint":
            placed_joints(robot, value)


def serve(page: ServedPage, *, browser: bool, wait: Callable[[], object]) -> None:
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
