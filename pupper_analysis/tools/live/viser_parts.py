"""viser, and the little of it that its public interface does not offer."""

from __future__ import annotations

import contextlib
import io
import logging
import socket
import warnings
from collections.abc import Iterator, Sequence
from functools import partial
from http import HTTPStatus
from importlib import import_module
from typing import Any
from urllib.parse import parse_qs, urlsplit

from pupper_analysis.base.diagnostics import LANGUAGES, diagnose
from pupper_analysis.base.errors import ConfigurationError, MissingPackageError
from pupper_analysis.tools.live.door import (
    HEADERS,
    MOST_BYTES,
    Door,
    problem_of,
)

FAREWELL = 0.3
"""s that browsers have to answer when the server ends; one that sleeps or is gone never does."""


def import_viser() -> Any:
    """Returns the package.

    Raises:
        MissingPackageError: If it is not installed.
    """
    try:
        return import_module("viser")
    except ImportError as error:
        raise MissingPackageError("viser", "live") from error


def free_port(host: str, port: int | None) -> int:
    """Returns the port to serve on: the one asked for if it is free, or any.

    viser takes the next one where a port is taken, and waits for ever where there is no such host.

    Raises:
        ConfigurationError: If the port is taken, or the host is none of this machine.
    """
    try:
        family = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)[0][0]
        with socket.socket(family, socket.SOCK_STREAM) as tried:
            # As servers do: a connection of one that has just ended is no reason to refuse.
            tried.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            tried.bind((host, port or 0))
            return int(tried.getsockname()[1])
    except OverflowError:
        raise ConfigurationError("--port", diagnose("no-port", port=port)) from None
    except (OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        where = f"{host}:{port}" if port else host
        told = diagnose("cannot-serve", address=where, reason=reason)
        raise ConfigurationError("--host, --port", told) from error


@contextlib.contextmanager
def silence_viser() -> Iterator[None]:
    """Keeps what viser prints about itself off the terminal."""
    with contextlib.redirect_stdout(io.StringIO()):
        yield


def start_server(host: str, port: int, label: str, door: Door | None = None) -> Any:
    """Returns a server of viser's, that nobody can open to the internet from the page.

    Args:
        host: Where it can be reached.
        port: A free one.
        label: What the page is called.
        door: Who may come in; by default who may be at this host.
    """
    # What knocks at the port and says nothing, or nonsense, is no error of this program.
    for name in ("websockets.server", "asyncio"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    # Nor is a browser that leaves while its page is made.
    warnings.filterwarnings("ignore", r"Queued a \w+ on a closed connection", UserWarning)
    with silence_viser(), _behind(door or Door(host)):
        server = import_viser().ViserServer(host=host, port=port, label=label, verbose=False)
    server.request_share_url = lambda *_, **__: None
    server._websock_server.on_client_connect(partial(_heed, server))
    server.gui.configure_theme(show_logo=False, show_share_button=False, brand_color=(51, 86, 122))
    return server


def address_of(server: Any, host: str, door: Door) -> str:
    """Returns what a browser opens.

    Args:
        server: viser's.
        host: Where it can be reached.
        door: Who may come in.
    """
    shown = "localhost" if host in ("0.0.0.0", "::") else host
    shown = f"[{shown}]" if ":" in shown else shown
    address = f"http://{shown}:{server.get_port()}/"
    return address + (f"?token={door.token}" if door.token else "")


@contextlib.contextmanager
def _behind(door: Door) -> Iterator[None]:
    """Lets a server that viser starts meanwhile answer only whom a door lets in."""
    websockets: Any = import_module("websockets.asyncio.server")
    serve = websockets.serve

    def guarded(handler: Any, *where: Any, **options: Any) -> Any:
        answer = options["process_request"]

        def answered(connection: Any, request: Any) -> Any:
            headers = {name: ", ".join(request.headers.get_all(name)) for name in HEADERS}
            if refusal := door.refusal(request.path, headers):
                told = "".join(f"{refusal.text(language)}\n" for language in LANGUAGES)
                return connection.respond(HTTPStatus.FORBIDDEN, told)
            response = answer(connection, request)
            if door.token and response is not None and urlsplit(request.path).path == "/":
                response.headers["Set-Cookie"] = door.cookie
            return response

        own = {"process_request": answered, "max_size": MOST_BYTES, "close_timeout": FAREWELL}
        return serve(handler, *where, **(options | own))

    websockets.serve = guarded
    try:
        yield
    finally:
        websockets.serve = serve


def _heed(server: Any, connection: Any) -> None:
    """Lets a browser that has connected move the controls of its page, and send no files."""
    messages = import_viser()._messages
    handlers = connection._incoming_handlers
    for kind in (messages.FileTransferStartUpload, messages.FileTransferPart):
        handlers.pop(kind, None)
    moves = handlers.get(messages.GuiUpdateMessage, [])

    async def moved(client_id: int, message: Any) -> None:
        client = server.get_clients().get(client_id)
        handle = (
            None if client is None else client.gui._gui_input_handle_from_uuid.get(message.uuid)
        )
        if client is None or handle is None:
            return
        if problem := problem_of(message.updates):
            client.add_notification("Not taken", problem, color="red")
            return
        for move in moves:
            await move(client_id, message)

    handlers[messages.GuiUpdateMessage] = [moved]


def stop_server(server: Any) -> None:
    """Stops a server."""
    with silence_viser():
        server.stop()


def asked_for(server: Any, client_id: int) -> tuple[str, str, str]:
    """Returns how a browser reaches the server, and which state and language it asks for.

    viser keeps the request to itself; where that is not found, both are empty.
    """
    try:
        request = server._websock_server._live_connections[client_id].request
        address = str(request.headers["Host"])
        given = parse_qs(urlsplit(request.path).query, separator="&")
    except (AttributeError, KeyError, TypeError, ValueError):
        return f"{server.get_host()}:{server.get_port()}", "", ""
    return address, given.get("state", [""])[0], given.get("language", [""])[0]


def browser_of(server: Any, client_id: int) -> tuple[str, str]:
    """Returns from where a browser has opened a connection, and which browser it says it is."""
    try:
        connection = server._websock_server._live_connections[client_id]
        return str(connection.remote_address[0]), str(connection.request.headers["User-Agent"])
    except (AttributeError, IndexError, KeyError, TypeError):
        return "", str(client_id)


def mark_slider(slider: Any, values: tuple[float, ...]) -> None:
    """Marks places of a slider's track; viser takes marks only when a slider is made."""
    with contextlib.suppress(AttributeError):
        kind = import_viser()._messages.GuiSliderMark
        slider._marks = tuple(kind(value=float(value), label="◆") for value in values) or None


def clear_but_tabs(gui: Any, tabs: Any) -> None:
    """Takes everything away but a group of tabs, which are left empty.

    viser's ``reset`` takes the tabs, too, and a browser then shows the first of the new ones.

    Args:
        gui: viser's handle of a browser's controls.
        tabs: That of the group.
    """
    for tab in tabs._tab_handles:
        for child in tuple(tab._children.values()):
            child.remove()
    for child in tuple(gui._container_handle_from_uuid["root"]._children.values()):
        if child is not tabs:
            child.remove()
    for panel in tuple(gui._panel_handle_from_uuid.values()):
        panel.remove()


def named_tabs(
    gui: Any, names: Sequence[str], last: Any, tabs: Any = None
) -> tuple[Any, list[Any]]:
    """Returns a group of tabs, and the tabs; if it is there already, they get these names.

    Args:
        gui: viser's handle of a browser's controls.
        names: Of the tabs.
        last: The control below which they are, the last of all.
        tabs: The group, if it is there already.
    """
    if tabs is None:
        tabs = gui.add_tab_group()
        return tabs, [tabs.add_tab(name) for name in names]
    for tab, name in zip(tabs._tab_handles, names, strict=True):
        tab._label = name
    tabs._rebuild_tab_props()
    tabs.order = last.order + 0.5  # viser counts in whole numbers
    return tabs, list(tabs._tab_handles)
