"""Access control of the page server.

Any web page can connect to a server on the same machine. Such a page can also use its own host name
if the DNS entry of the name points to this machine (DNS rebinding). If only this machine can reach
the server, a request must therefore contain a known host name. If other machines can reach the
server, any host name is accepted, but a request must contain a token. Assets of the page need no
token. In both cases an origin, if stated, must be the server's own page.
"""

from __future__ import annotations

import hmac
import ipaddress
import os
import re
import secrets
from collections.abc import Mapping
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs, urlsplit

from pupper_analysis.base.diagnostics import Diagnostic, diagnose
from pupper_analysis.base.inputs import is_folder

MAX_MESSAGE_BYTES = 1 << 20
"""Maximum size of a message from a browser [bytes]. Messages of sliders and cameras have some
hundred bytes. Chosen, not tuned."""

CHECKED_HEADERS = ("Host", "Origin", "Upgrade", "Cookie")
"""Headers of a browser's request from which `Access.find_refusal` decides whether to refuse the
request."""

TOKEN_COOKIE = "pupper_analysis_token"
"""Name of the cookie in which a browser stores the access token of the page."""

_LOOPBACK_NAMES = frozenset(("localhost", "127.0.0.1", "::1"))
"""Host names of a server that only this machine can reach. Without an access token, the server
refuses requests to any host except these names and its own host."""


def is_loopback(host: str) -> bool:
    """Return True for ``localhost`` and loopback addresses, which only this machine can reach."""
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


class Access:
    """Rules by which the page server allows or refuses requests of browsers.

    Args:
        host: Address of the server.

    Attributes:
        token: Token that requests must contain; empty if only this machine can reach the server.
    """

    def __init__(self, host: str) -> None:
        self._host = host
        self.token = "" if is_loopback(host) else secrets.token_urlsafe(16)

    def find_refusal(self, path: str, headers: Mapping[str, str]) -> Diagnostic | None:
        """Return the reason to refuse a request to the page server; None if it is allowed.

        A request is refused, for example, if it comes from a page of another server, or if a
        required token is missing. Assets of the page need no token. ``path`` contains the query.
        """
        host = headers.get("Host", "")
        if not self.token and _parse_host_name(host) not in {*_LOOPBACK_NAMES, self._host}:
            return diagnose("server-called-otherwise")
        origin = headers.get("Origin", "")
        if origin and urlsplit(origin).netloc != host:
            return diagnose("another-page-asks")
        asset = headers.get("Upgrade", "").lower() != "websocket" and urlsplit(path).path != "/"
        if self.token and not asset and not self._has_token(path, headers):
            return diagnose("token-missing")
        return None

    def _has_token(self, path: str, headers: Mapping[str, str]) -> bool:
        """Return True if the query or the cookie of a request contains the access token."""
        tokens = parse_qs(urlsplit(path).query).get("token", [])
        try:
            cookie = SimpleCookie(headers.get("Cookie", "")).get(TOKEN_COOKIE)
        except CookieError:
            cookie = None
        tokens += [cookie.value] if cookie is not None else []
        return any(hmac.compare_digest(token.encode(), self.token.encode()) for token in tokens)

    @property
    def cookie_header(self) -> str:
        """Value of the ``Set-Cookie`` header that stores the access token in the browser."""
        return f"{TOKEN_COOKIE}={self.token}; Path=/; HttpOnly; SameSite=Strict"


def _parse_host_name(host: str) -> str:
    """Return the host name of a Host header, without the port; empty if missing or invalid."""
    try:
        return urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return ""


def strip_folders(text: str) -> str:
    """Return a text without the folders of most absolute paths, so that the file names remain.

    Errors contain paths on the server, which the user of a page should not see. Folders that exist
    may contain spaces; other folders are recognised without spaces only.
    """
    parts, end = [], 0
    for start in _PATH_START.finditer(text):
        if start.start() < end:
            continue
        stop = _find_end_of_folders(text, start)
        if stop > start.end():
            parts.append(text[end : start.start()])
            end = stop
    return "".join((*parts, text[end:]))


def _find_end_of_folders(text: str, start: re.Match[str]) -> int:
    """Return the index in a text behind the folders of the path that begins at a match.

    If the path has no folder, the result is the end of the match.
    """
    end = start.end()
    for separator in re.finditer(r"[/\\]", text[start.end() :]):
        stop = start.end() + separator.start()
        if not is_folder(os.path.expanduser(text[start.start() : stop])):  # noqa: PTH111
            break
        end = stop + 1
    folders = _FOLDER_PATTERN.match(text, end)
    end = end if folders is None else folders.end()
    return end if text[end : end + 1].strip("/\\") else start.end()


_PATH_START = re.compile(r"(?<![\w.:/])(?:[A-Za-z]:|~)?[/\\]")
"""Pattern of the start of an absolute path."""

_FOLDER_PATTERN = re.compile(r"(?:[^/\\:'\"\s]+[/\\])+")
"""Pattern of folders in a path, without spaces in their names."""
