"""Documents as panels of a page: small, in one language, and no name becomes part of the HTML."""

from __future__ import annotations

import contextlib
import io
import logging
import socket
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from functools import singledispatch
from html import escape
from http import HTTPStatus
from importlib import import_module
from typing import Any
from urllib.parse import urlsplit

from pupper_analysis.base.diagnostics import LANGUAGES, Diagnostic, diagnose
from pupper_analysis.base.errors import ConfigurationError, MissingPackageError
from pupper_analysis.present.document import (
    Cell,
    Column,
    Document,
    Lines,
    Number,
    Table,
    Text,
    Words,
    text,
)
from pupper_analysis.present.formats import escape_control
from pupper_analysis.tools.live.access import (
    CHECKED_HEADERS,
    MAX_MESSAGE_BYTES,
    Access,
    strip_folders,
)
from pupper_analysis.tools.live.scene import choose_utilisation_colour, to_css

CLOSE_TIMEOUT = 0.3
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


def find_free_port(host: str, port: int | None) -> int:
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
        message = diagnose("cannot-serve", address=where, reason=reason)
        raise ConfigurationError("--host, --port", message) from error


def start_server(host: str, port: int, label: str, access: Access | None = None) -> Any:
    """Returns a server of viser's, that nobody can open to the internet from the page.

    Args:
        host: Where it can be reached.
        port: A free one.
        label: What the page is called.
        access: Who may come in; by default who may be at this host.
    """
    # What knocks at the port and says nothing, or nonsense, is no error of this program.
    for name in ("websockets.server", "asyncio"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    # Nor is a browser that leaves while its page is made.
    warnings.filterwarnings("ignore", r"Queued a \w+ on a closed connection", UserWarning)
    with contextlib.redirect_stdout(io.StringIO()), _behind(access or Access(host)):
        server = import_viser().ViserServer(host=host, port=port, label=label, verbose=False)
    server.request_share_url = lambda *_, **__: None
    server.gui.configure_theme(show_logo=False, show_share_button=False, brand_color=(70, 112, 155))
    return server


def make_address(server: Any, host: str, access: Access) -> str:
    """Returns what a browser opens.

    Args:
        server: viser's.
        host: Where it can be reached.
        access: Who may come in.
    """
    shown = "localhost" if host in ("0.0.0.0", "::") else f"[{host}]" if ":" in host else host
    asked = f"?token={access.token}" if access.token else ""
    return f"http://{shown}:{server.get_port()}/{asked}"


@contextlib.contextmanager
def _behind(access: Access) -> Iterator[None]:
    """Lets a server that viser starts meanwhile answer only whom a door lets in."""
    websockets: Any = import_module("websockets.asyncio.server")
    serve = websockets.serve

    def guarded(handler: Any, *where: Any, **options: Any) -> Any:
        answer = options["process_request"]

        def answered(connection: Any, request: Any) -> Any:
            headers = {name: ", ".join(request.headers.get_all(name)) for name in CHECKED_HEADERS}
            if refusal := access.find_refusal(request.path, headers):
                message = "".join(f"{refusal.text(language)}\n" for language in LANGUAGES)
                return connection.respond(HTTPStatus.FORBIDDEN, message)
            response = answer(connection, request)
            if response is not None and access.token and urlsplit(request.path).path == "/":
                response.headers["Set-Cookie"] = access.cookie_header
            return response

        own = {
            "process_request": answered,
            "max_size": MAX_MESSAGE_BYTES,
            "close_timeout": CLOSE_TIMEOUT,
        }
        return serve(handler, *where, **(options | own))

    websockets.serve = guarded
    try:
        yield
    finally:
        websockets.serve = serve


def stop_server(server: Any) -> None:
    """Stops a server."""
    with contextlib.redirect_stdout(io.StringIO()):
        server.stop()


class NumberPanel:
    """A panel of numbers at the left of the controls; on a phone, folded above them."""

    def __init__(self, gui: Any, say: Language, waiting: str, width: int = 380) -> None:
        left, self._title = gui.add_panel(), say("what-it-takes")
        with left.add_tab(self._title):
            self._wide = gui.add_html("")
        left.dock_left()
        left.set_width(width)
        gui.main_panel.dock_right()
        gui.main_panel.set_width(360)
        self._narrow = gui.add_html("")
        self.content = render_waiting(text(waiting), say)

    @property
    def content(self) -> str:
        """What it shows."""
        return str(self._wide.content)

    @content.setter
    def content(self, html: str) -> None:
        self._wide.content = html
        summary = f"<summary>{escape(self._title)}</summary>"
        self._narrow.content = f'{_PHONE}<details class="pa-phone">{summary}{html}</details>'


_PHONE = "<style>.pa-phone{display:none}@media (max-width:36em){.pa-phone{display:block}}</style>"


# The language of a page: its texts are those of the report's catalogue, and so is its Chinese.


@dataclass(frozen=True)
class Language:
    """Says texts in one language.

    Attributes:
        code: ``"en"`` or ``"zh"``.
    """

    code: str = "en"

    def __post_init__(self) -> None:
        if self.code not in LANGUAGES:
            raise ConfigurationError("language", diagnose("language-unknown", language=self.code))

    def __call__(self, key: str, **values: object) -> str:
        """Returns a text of the page.

        Args:
            key: The catalogue's.
            **values: What stands in its braces.

        Raises:
            KeyError: If the catalogue lacks it.
        """
        return self._of(text(key, **values))

    def format_diagnostic(self, message: Diagnostic) -> str:
        """Returns what a diagnostic says."""
        return message.with_names(strip_folders).text(self.code)

    def translate(self, words: Words) -> str:
        """Returns words of a document."""
        return strip_folders(self._of(words) if isinstance(words, Text) else words.text)

    def _of(self, words: Text) -> str:
        return words.zh if self.code == "zh" else words.en


PANEL_STYLE = """<style>
.pa{font:13px/1.45 system-ui,sans-serif;padding:0 .9em .6em;overflow-wrap:anywhere}
.pa table{border-collapse:collapse;width:100%;margin:.35em 0 .7em}
.pa td,.pa th{overflow-wrap:break-word;padding:.1em .35em .1em 0;text-align:left}
.pa td,.pa th{font-weight:400;vertical-align:top}
.pa th{opacity:.72}
.pa th.n{text-align:right}
.pa td:not(:first-child){white-space:nowrap}
.pa td.n{text-align:right;font-variant-numeric:tabular-nums;white-space:nowrap}
.pa h4{margin:.7em 0 .1em;font-size:13px;font-weight:650}
.pa .good,.pa .bad,.pa .wait{border-left:4px solid;padding:.25em .6em;margin:.4em 0}
.pa .good{border-color:#1e8c46}.pa .bad{border-color:#c81e28}.pa .wait{border-color:#e0a020}
.pa .bar{display:inline-block;height:.62em;border-radius:2px;vertical-align:baseline}
</style>"""

_BOXES = {"good": "good", "bad": "bad", "warn": "wait"}
"""{emphasis: the class of a box}."""


def render_panel(document: Document, say: Language) -> str:
    """Returns a document: whose it is, its verdict and the reasons, and its blocks."""
    parts = [_headed(document.title, say), render_verdict(document, say)]
    parts += [_block(block, say) for block in document.blocks]
    return join_parts(*parts)


def render_verdict(document: Document, say: Language) -> str:
    """Returns a document's verdict with its reasons, in one remark; nothing where it has none."""
    if document.passed is None:
        return ""
    verdict = () if document.verdict is None else (document.verdict,)
    messages = (*verdict, *document.failures, *document.findings, *document.details)
    return _box(document.mark, "; ".join(say.translate(one) for one in messages))


def join_parts(*parts: str) -> str:
    """Returns parts as one piece of a page."""
    return f'{PANEL_STYLE}<div class="pa">{"".join(parts)}</div>'


def render_waiting(words: Words, say: Language) -> str:
    """Returns that something is under way."""
    return join_parts(_box("warn", say.translate(words)))


def render_hint(words: Words, say: Language) -> str:
    """Returns a hint where there is no result."""
    return join_parts(f"<div>{_said(say.translate(words))}</div>")


def _headed(words: Words, say: Language) -> str:
    message = say.translate(words)
    return f"<h4>{_said(message)}</h4>" if message else ""


def _said(text: str) -> str:
    """Returns a text as it is shown: nothing in it acts."""
    return escape(escape_control(text))


def _box(mark: str, text: str) -> str:
    return f'<div class="{_BOXES[mark]}">{_said(text)}</div>'


@singledispatch
def _block(_: object, __: Language) -> str:
    """Returns a block; plots and views are left out, as they are drawn beside the panels."""
    return ""


@_block.register
def _lines(block: Lines, say: Language) -> str:
    title = "" if block.title is None else _headed(block.title, say)
    messages = [say.translate(one) for one in block.lines]
    if block.mark:
        return title + "".join(_box(block.mark, one) for one in messages)
    return title + "".join(f"<div>{_said(one)}</div>" for one in messages)


@_block.register
def _table(block: Table, say: Language) -> str:
    """Returns a table; its header is shown where it tells units."""
    rows = []
    if any(column.unit for column in block.columns):
        heads = [say.translate(one.name) + _unit(one) for one in block.columns]
        kinds = ["" if one.left else ' class="n"' for one in block.columns]
        cells = (f"<th{kind}>{_said(head)}</th>" for kind, head in zip(kinds, heads, strict=True))
        rows.append(f"<tr>{''.join(cells)}</tr>")
    rows += [f"<tr>{''.join(_cell(one, say) for one in row)}</tr>" for row in block.rows]
    barred = any(isinstance(cell, Number) and cell.bar_fraction is not None
                 for row in block.rows for cell in row)  # fmt: skip
    kind = ' class="barred"' if barred else ""
    return f"{_headed(block.title, say)}<table{kind}>{''.join(rows)}</table>"


def _unit(column: Column) -> str:
    """Returns a column's unit in parentheses, in one piece; nothing where it has none."""
    unit = column.unit.replace(" ", "\N{NO-BREAK SPACE}")
    return f" ({unit})" if unit not in ("", "1") else ""


def _cell(cell: Cell, say: Language) -> str:
    if not isinstance(cell, Number):
        return f"<td>{_said(say.translate(cell))}</td>"
    number = f'<td class="n">{_said(cell.text)}</td>'
    if cell.bar_fraction is None:
        return number
    width, colour = (
        3.0 * cell.bar_fraction,
        to_css(choose_utilisation_colour(cell.value / 100)),
    )  # a share is in percent
    bar = f'<span class="bar" style="width:{width:.2f}em;background:{colour}"></span>'
    return f'{number}<td style="width:3.1em">{bar}</td>'
