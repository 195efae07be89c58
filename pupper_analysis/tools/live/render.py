"""Rendering of documents as HTML panels in a single language, and the viser server of a page.

`start_server` starts viser's web server with an access control, and without its log output. The
``render_...`` functions turn the parts of a `Document` into HTML with a `Translator`, which selects
the language and deletes folder names. Plots and views are left out.
"""

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
    Words,
    text,
    translate,
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
"""Time [s] that browsers have to confirm the end of a connection. Chosen, not tuned."""


def import_viser() -> Any:
    """Import and return viser.

    Raises:
        MissingPackageError: If viser is not installed.
    """
    try:
        return import_module("viser")
    except ImportError as error:
        raise MissingPackageError("viser", "live") from error


def find_free_port(host: str, port: int | None) -> int:
    """Return a port on which a server can listen: ``port``, or any free port for None and 0.

    The check is necessary, because viser would use another port if the port is taken.

    Raises:
        ConfigurationError: If the port is taken or not valid, or the host is not an address of this
            machine.
    """
    try:
        family = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)[0][0]
        with socket.socket(family, socket.SOCK_STREAM) as probe:
            # As servers do: a closed connection in TIME_WAIT does not block the port.
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((host, port or 0))
            return int(probe.getsockname()[1])
    except OverflowError:
        raise ConfigurationError("--port", diagnose("no-port", port=port)) from None
    except (OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        address = f"{host}:{port}" if port else host
        message = diagnose("cannot-serve", address=address, reason=reason)
        raise ConfigurationError("--host, --port", message) from error


def start_server(host: str, port: int, label: str, access: Access | None = None) -> Any:
    """Start a viser server that cannot be shared on the internet from the page.

    ``port`` must be free; ``label`` is the title of the page. Default of ``access``: the access
    control of the host.
    """
    for name in ("websockets.server", "asyncio"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    # A browser that disconnects while its page is created is no error either.
    warnings.filterwarnings("ignore", r"Queued a \w+ on a closed connection", UserWarning)
    with contextlib.redirect_stdout(io.StringIO()), _guard_requests(access or Access(host)):
        server = import_viser().ViserServer(host=host, port=port, label=label, verbose=False)
    server.request_share_url = lambda *_, **__: None
    server.gui.configure_theme(show_logo=False, show_share_button=False, brand_color=(70, 112, 155))
    return server


def make_address(server: Any, host: str, access: Access) -> str:
    """Return the address (URL) that a browser opens to show a page, with the access token."""
    shown = "localhost" if host in ("0.0.0.0", "::") else f"[{host}]" if ":" in host else host
    query = f"?token={access.token}" if access.token else ""
    return f"http://{shown}:{server.get_port()}/{query}"


@contextlib.contextmanager
def _guard_requests(access: Access) -> Iterator[None]:
    """Add access control to the servers that viser starts within this context."""
    websockets: Any = import_module("websockets.asyncio.server")
    serve = websockets.serve

    def serve_guarded(handler: Any, *where: Any, **options: Any) -> Any:
        process_request = options["process_request"]

        def check_request(connection: Any, request: Any) -> Any:
            headers = {name: ", ".join(request.headers.get_all(name)) for name in CHECKED_HEADERS}
            if refusal := access.find_refusal(request.path, headers):
                message = "".join(f"{refusal.text(language)}\n" for language in LANGUAGES)
                return connection.respond(HTTPStatus.FORBIDDEN, message)
            response = process_request(connection, request)
            if response is not None and access.token and urlsplit(request.path).path == "/":
                response.headers["Set-Cookie"] = access.cookie_header
            return response

        overrides = {
            "process_request": check_request,
            "max_size": MAX_MESSAGE_BYTES,
            "close_timeout": CLOSE_TIMEOUT,
        }
        return serve(handler, *where, **(options | overrides))

    websockets.serve = serve_guarded
    try:
        yield
    finally:
        websockets.serve = serve


def stop_server(server: Any) -> None:
    """Stop a viser server without its output on the terminal."""
    with contextlib.redirect_stdout(io.StringIO()):
        server.stop()


class NumberPanel:
    """Panel at the left of the page that shows numbers of a stance or a walk.

    On a phone, the panel is a folded section above the controls.
    """

    def __init__(self, gui: Any, translator: Translator, waiting: str, width: int = 380) -> None:
        left, self._title = gui.add_panel(), translator("what-it-takes")
        with left.add_tab(self._title):
            self._panel_html = gui.add_html("")
        left.dock_left()
        left.set_width(width)
        gui.main_panel.dock_right()
        gui.main_panel.set_width(360)
        self._phone_html = gui.add_html("")
        self.content = render_waiting(text(waiting), translator)

    @property
    def content(self) -> str:
        """HTML text that the number panel shows."""
        return str(self._panel_html.content)

    @content.setter
    def content(self, html: str) -> None:
        """Show an HTML text in the number panel and in the folded section for phones."""
        self._panel_html.content = html
        summary = f"<summary>{escape(self._title)}</summary>"
        self._phone_html.content = (
            f'{_PHONE_STYLE}<details class="pa-phone">{summary}{html}</details>'
        )


_PHONE_STYLE = (
    "<style>.pa-phone{display:none}@media (max-width:36em){.pa-phone{display:block}}</style>"
)
"""Style that shows elements of the class ``pa-phone`` on narrow screens only."""


# Translator for a page. The texts are those of the catalogues, as in reports.


@dataclass(frozen=True)
class Translator:
    """Translates texts of the catalogue and of documents into the language of a page.

    Attributes:
        code: ``"en"`` or ``"zh"``.
    """

    code: str = "en"

    def __post_init__(self) -> None:
        if self.code not in LANGUAGES:
            raise ConfigurationError("language", diagnose("language-unknown", language=self.code))

    def __call__(self, key: str, **values: object) -> str:
        """Return a text of the catalogue in the language of the page.

        ``values`` fill the placeholders.

        Raises:
            KeyError: If the catalogue lacks the key, or non-empty ``values`` lack a placeholder.
        """
        return translate(text(key, **values), self.code)

    def format_diagnostic(self, message: Diagnostic) -> str:
        """Return a diagnostic in the language of the page, without folders (`strip_folders`)."""
        return message.with_names(strip_folders).text(self.code)

    def translate(self, words: Words) -> str:
        """Return a text in the page's language, with folders removed (`strip_folders`)."""
        return strip_folders(translate(words, self.code))


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
"""HTML element with the CSS style sheet of the panels (class ``pa``) on the web page."""

_BOX_CLASSES = {"good": "good", "bad": "bad", "warn": "wait"}
"""{emphasis of a text (`Document.mark`): CSS class of the box around the text}."""


def render_panel(document: Document, translator: Translator) -> str:
    """Render a document as HTML: title, verdict with reasons, and blocks."""
    parts = [_render_heading(document.title, translator), render_verdict(document, translator)]
    parts += [_render_block(block, translator) for block in document.blocks]
    return join_parts(*parts)


def render_verdict(document: Document, translator: Translator) -> str:
    """Render the verdict of a document, with reasons and details, as an HTML box.

    The result is empty if the document has no verdict (`Document.passed` is None).
    """
    if document.passed is None:
        return ""
    verdict = () if document.verdict is None else (document.verdict,)
    messages = (*verdict, *document.failures, *document.findings, *document.details)
    return _render_box(document.mark, "; ".join(translator.translate(words) for words in messages))


def join_parts(*parts: str) -> str:
    """Join rendered HTML parts to a panel, with the style sheet."""
    return f'{PANEL_STYLE}<div class="pa">{"".join(parts)}</div>'


def render_waiting(words: Words, translator: Translator) -> str:
    """Render a message about work in progress as an HTML panel, a box with the emphasis "warn"."""
    return join_parts(_render_box("warn", translator.translate(words)))


def render_hint(words: Words, translator: Translator) -> str:
    """Render a hint, which is shown in place of a result, as an HTML panel without a box."""
    return join_parts(f"<div>{_escape_html(translator.translate(words))}</div>")


def _render_heading(words: Words, translator: Translator) -> str:
    """Render a heading as HTML; the result is empty for an empty text."""
    message = translator.translate(words)
    return f"<h4>{_escape_html(message)}</h4>" if message else ""


def _escape_html(text: str) -> str:
    """Escape a text for HTML, including control characters."""
    return escape(escape_control(text))


def _render_box(mark: str, text: str) -> str:
    """Render a text in an HTML box; its colour shows the emphasis ``mark``, such as "good"."""
    return f'<div class="{_BOX_CLASSES[mark]}">{_escape_html(text)}</div>'


@singledispatch
def _render_block(_: object, __: Translator) -> str:
    """Render a block of a document as HTML; empty for types without a registered renderer."""
    return ""


@_render_block.register
def _render_lines(block: Lines, translator: Translator) -> str:
    """Render lines of text as HTML, in boxes if the block has an emphasis."""
    title = "" if block.title is None else _render_heading(block.title, translator)
    messages = [translator.translate(words) for words in block.lines]
    if block.mark:
        return title + "".join(_render_box(block.mark, message) for message in messages)
    return title + "".join(f"<div>{_escape_html(message)}</div>" for message in messages)


@_render_block.register
def _render_table(block: Table, translator: Translator) -> str:
    """Render a table as HTML; the header is shown if a column has a unit."""
    rows = []
    if any(column.unit for column in block.columns):
        heads = [
            translator.translate(column.name) + _format_unit(column) for column in block.columns
        ]
        classes = ["" if column.left else ' class="n"' for column in block.columns]
        cells = (
            f"<th{table_class}>{_escape_html(head)}</th>"
            for table_class, head in zip(classes, heads, strict=True)
        )
        rows.append(f"<tr>{''.join(cells)}</tr>")
    rows += [
        f"<tr>{''.join(_render_cell(cell, translator) for cell in row)}</tr>" for row in block.rows
    ]
    has_bars = any(isinstance(cell, Number) and cell.bar_fraction is not None
                 for row in block.rows for cell in row)  # fmt: skip
    table_class = ' class="barred"' if has_bars else ""
    return f"{_render_heading(block.title, translator)}<table{table_class}>{''.join(rows)}</table>"


def _format_unit(column: Column) -> str:
    """Return the unit of a column in parentheses; empty without unit, or with the unit 1."""
    unit = column.unit.replace(" ", "\N{NO-BREAK SPACE}")
    return f" ({unit})" if unit not in ("", "1") else ""


def _render_cell(cell: Cell, translator: Translator) -> str:
    """Render a table cell as HTML; a number with a ``bar_fraction`` gets a bar."""
    if not isinstance(cell, Number):
        return f"<td>{_escape_html(translator.translate(cell))}</td>"
    number = f'<td class="n">{_escape_html(cell.text)}</td>'
    if cell.bar_fraction is None:
        return number
    width, colour = (
        3.0 * cell.bar_fraction,
        to_css(choose_utilisation_colour(cell.value / 100)),
    )  # a share is in percent
    bar = f'<span class="bar" style="width:{width:.2f}em;background:{colour}"></span>'
    return f'{number}<td style="width:3.1em">{bar}</td>'
