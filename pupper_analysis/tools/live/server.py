"""Server of a page; each browser that opens the page has a separate session.

`ServedPage` starts viser's server and creates a session for each browser from a given function.
`Page` serves stances of a robot, from a valid initial state.
"""

from __future__ import annotations

import itertools
import threading
import time
import webbrowser
from collections.abc import Callable
from typing import Any, TypedDict, Unpack

from pupper_analysis.robot.joints import resolve_posture
from pupper_analysis.robot.robot import Robot
from pupper_analysis.robot.touching import with_contacts
from pupper_analysis.tools.live import render
from pupper_analysis.tools.live.access import Access
from pupper_analysis.tools.live.model import PageSolver
from pupper_analysis.tools.live.render import Translator
from pupper_analysis.tools.live.session import Session
from pupper_analysis.tools.live.state import State, check_page_robot

DEFAULT_HOST = "127.0.0.1"
"""Default address of the page server, which only this machine can reach."""

_CAMERA_POSITION = (2.6, -2.3, 1.7)
"""Initial position of the camera in the world frame, divided by the size of the robot: in front, to
the right and above. Chosen, not tuned."""

_JOIN_TIMEOUT = 1.0
"""Time [s] that the threads of all sessions together have to finish when a page is closed. Chosen,
not tuned."""


class ServeOptions(TypedDict, total=False):
    """Options of the page server.

    Attributes:
        language: ``"en"`` or ``"zh"``.
        host: Address of the server; by default reachable from this machine only.
        port: Port; by default any free port.
    """

    language: str
    host: str
    port: int | None


class ServedPage:
    """Page that a server offers until it is closed; each browser has a separate session.

    Args:
        robot: Name of the robot, in the title of the page.
        size: Size of the robot [m], for the position of the camera.
        session: Function that creates the session of a browser from viser's client and the
            language.
        language: ``"en"`` or ``"zh"``.
        host: Address of the server; by default reachable from this machine only.
        port: Port; by default any free port.

    Attributes:
        address: Address that a browser opens.
        sessions: {client id: session}.

    Raises:
        ConfigurationError: If the server cannot use this address, or the language is unknown.
        MissingPackageError: If viser is not installed.
    """

    def __init__(
        self,
        robot: str,
        size: float,
        session: Callable[[Any, Translator], Any],
        *,
        language: str = "en",
        host: str = DEFAULT_HOST,
        port: int | None = None,
    ) -> None:
        self._language, self._make_session = Translator(language), session
        self.sessions: dict[int, Any] = {}
        self._lock, self._closed = threading.Lock(), False
        access, free_port = Access(host), render.find_free_port(host, port)
        self._server = render.start_server(host, free_port, f"{robot}, live", access)
        self.address = render.make_address(self._server, host, access)
        camera = self._server.initial_camera
        camera.position = tuple(size * number for number in _CAMERA_POSITION)
        camera.look_at = (0.0, 0.0, 0.4 * size)
        camera.near = 0.05 * size
        self._server.on_client_connect(self._on_connect)
        self._server.on_client_disconnect(self._on_disconnect)

    def _on_connect(self, client: Any) -> None:
        """Create the session of a browser that has opened the page."""
        if self._closed:  # a late connection from viser's queue would keep the process alive
            return
        session = self._make_session(client, self._language)
        with self._lock:
            self.sessions[client.client_id] = session
        if self._closed or client.client_id not in self._server.get_clients():  # or disconnected
            self._on_disconnect(client)

    def _on_disconnect(self, client: Any) -> None:
        """Close the session of a browser."""
        with self._lock:
            session = self.sessions.pop(client.client_id, None)
        if session is not None:
            session.close()

    def close(self) -> None:
        """Close the sessions of all browsers, and stop the server of the page."""
        with self._lock:
            self._closed = True
            sessions = [*self.sessions.values()]
            self.sessions.clear()
        for session in sessions:
            session.close()
        render.stop_server(self._server)
        end = time.monotonic() + _JOIN_TIMEOUT
        for thread in itertools.chain.from_iterable(session.threads for session in sessions):
            thread.join(max(0.0, end - time.monotonic()))


class Page(ServedPage):
    """Page on which users request stances of a robot with sliders; see `ServedPage`.

    Args:
        robot: Robot.
        state: Initial state.
        **server_options: See `ServedPage`.

    Raises:
        ConfigurationError: If the server cannot use this address, the base is fixed, the robot has
            no feet, or the language is unknown.
        PupperAnalysisError: If the state is not valid for the robot (`check_state`).
        MissingPackageError: If viser is not installed.
    """

    def __init__(
        self, robot: Robot, state: State | None = None, **server_options: Unpack[ServeOptions]
    ) -> None:
        render.import_viser()  # before time-consuming work
        check_page_robot(robot)
        model, initial_state = PageSolver(robot), state or State()
        check_state(model, initial_state)
        super().__init__(
            robot.name,
            robot.stand_height,
            lambda client, translator: Session(client, model, initial_state, translator),
            **server_options,
        )


def check_state(model: PageSolver, state: State) -> None:
    """Check that the state of a page is valid for its robot.

    Raises:
        PupperAnalysisError: If the robot lacks a foot, joint or link of the state, or if a value is
            out of bounds, for example.
    """
    robot = with_contacts(model.load_robot(state), state.task().contacts)
    for field, value in state.requested_values():
        for foot in value if field.per == "foot" else ():
            robot.points_of(foot)
        if field.per == "joint":
            resolve_posture(robot, value)


def serve(page: ServedPage, *, browser: bool, wait: Callable[[], object]) -> None:
    """Serve a page until ``wait`` returns or raises."""
    try:
        if browser:
            webbrowser.open(page.address)
        wait()
    finally:
        page.close()
