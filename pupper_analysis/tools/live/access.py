"""Who may open the page, and what may come in by it.

Any page in a browser can connect to a server on the same machine, and by a name of its own that it
lets point there (DNS rebinding). So a request must name the server as it is known here, and what
opens a connection must come from the server's own page. Where others can reach the server, they
must know a token, too.
"""

from __future__ import annotations

import hmac
import ipaddress
import re
import secrets
from collections.abc import Mapping
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs, urlsplit

from pupper_analysis.base.diagnostics import Diagnostic, diagnose

MAX_MESSAGE_BYTES = 1 << 20
"""Of a message from a browser: those of sliders and cameras have some hundred."""

CHECKED_HEADERS = ("Host", "Origin", "Upgrade", "Cookie")
"""What is looked at of a request's."""

TOKEN_COOKIE = "pupper_analysis_token"

_LOOPBACK = frozenset(("localhost", "127.0.0.1", "::1"))


def is_loopback(host: str) -> bool:
    """Tells whether an address can be reached from this machine alone."""
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


class Access:
    """Decides who may come in.

    Args:
        host: Where the server can be reached.

    Attributes:
        token: What others than this machine must know; empty if none can reach it.
    """

    def __init__(self, host: str) -> None:
        self._host = host
        self.token = "" if is_loopback(host) else secrets.token_urlsafe(16)

    def find_refusal(self, path: str, headers: Mapping[str, str]) -> Diagnostic | None:
        """Says why a request is refused; None if it is not.

        Args:
            path: What is asked for, with its query.
            headers: Of the request.
        """
        host = headers.get("Host", "")
        if not self.token and _name(host) not in {*_LOOPBACK, self._host}:
            return diagnose("server-called-otherwise")
        origin = headers.get("Origin", "")
        if origin and urlsplit(origin).netloc != host:
            return diagnose("another-page-asks")
        asset = headers.get("Upgrade", "").lower() != "websocket" and urlsplit(path).path != "/"
        if self.token and not asset and not self._knows(path, headers):
            return diagnose("token-missing")
        return None

    def _knows(self, path: str, headers: Mapping[str, str]) -> bool:
        given = parse_qs(urlsplit(path).query).get("token", [])
        try:
            cookie = SimpleCookie(headers.get("Cookie", "")).get(TOKEN_COOKIE)
        except CookieError:
            cookie = None
        given += [cookie.value] if cookie is not None else []
        return any(hmac.compare_digest(one.encode(), self.token.encode()) for one in given)

    @property
    def cookie_header(self) -> str:
        """The header by which a browser remembers the token."""
        return f"{TOKEN_COOKIE}={self.token}; Path=/; HttpOnly; SameSite=Strict"


def _name(host: str) -> str:
    """Returns the name in a Host header, without its port."""
    try:
        return urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return ""


def strip_folders(text: str) -> str:
    """Returns a text in which files are called by their names alone.

    An error tells of a file where the server has it: that is nothing for who looks at the page.
    """
    return _FOLDERS.sub("", text)


_FOLDERS = re.compile(r"(?<![\w.:/])(?:[A-Za-z]:)?(?:[/\\][^/\\:'\"\s]+)+[/\\](?=[^/\\\s])")
