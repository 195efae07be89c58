"""Access to the live page: permitted hosts, origins and tokens, and bounds of messages."""

from __future__ import annotations

import asyncio
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import pytest

import pupper_analysis as pa
from pupper_analysis.base.diagnostics import Diagnostic
from pupper_analysis.tools.live.access import (
    TOKEN_COOKIE,
    Access,
    strip_folders,
)
from pupper_analysis.tools.live.render import Translator
from pupper_analysis.tools.live.server import Page
from tests.support.stubs import problem

viser = pytest.importorskip("viser", reason="viser is not installed")
websockets = pytest.importorskip("websockets.asyncio.client")

SOCKET = {"Upgrade": "websocket"}


@pytest.mark.parametrize(
    ("host", "headers", "may"),
    [
        ("127.0.0.1", {"Host": "localhost:8080"}, True),
        ("127.0.0.1", {"Host": "127.0.0.1:8080", "Origin": "http://127.0.0.1:8080"}, True),
        ("127.0.0.1", {"Host": "[::1]:8080"}, True),
        ("127.0.0.1", {"Host": "loc.example:8080"}, False),
        ("127.0.0.1", {"Host": "localhost.example:8080"}, False),
        # A name that its owner lets point here: Origin and Host are the same.
        ("127.0.0.1", {"Host": "evil.example:8080", "Origin": "http://evil.example:8080"}, False),
        ("127.0.0.1", {"Host": "127.0.0.1:8080", "Origin": "http://evil.example"}, False),
        ("127.0.0.1", {"Host": "127.0.0.1:8080", "Origin": "http://127.0.0.1:9090"}, False),
        ("127.0.0.1", {"Host": "127.0.0.1:8080", "Origin": "null"}, False),
        ("127.0.0.1", {}, False),
    ],
)
def test_access_depends_on_host_and_origin(host: str, headers: dict[str, str], may: bool) -> None:
    access = Access(host)
    assert not access.token
    for more in ({}, SOCKET):
        assert (access.find_refusal("/", headers | more) is None) == may


def get_code(message: Diagnostic | None) -> str:
    """Return the code of a diagnostic; empty for None."""
    return "" if message is None else message.code


def test_remote_access_requires_the_token() -> None:
    access, headers = Access("0.0.0.0"), {"Host": "robot.example:8080"}
    assert len(access.token) >= 16
    assert Access("0.0.0.0").token != access.token
    for more in ({}, SOCKET):
        assert get_code(access.find_refusal("/", headers | more)) == "token-missing"
        assert get_code(access.find_refusal("/?token=", headers | more)) == "token-missing"
        assert (
            get_code(access.find_refusal(f"/?token={access.token[:-1]}", headers | more))
            == "token-missing"
        )
        assert access.find_refusal(f"/?state=roll:1&token={access.token}", headers | more) is None
        assert (
            access.find_refusal("/", headers | more | {"Cookie": f"a=b; {access.cookie_header}"})
            is None
        )
        assert (
            get_code(access.find_refusal("/", headers | more | {"Cookie": f"{TOKEN_COOKIE}=x"}))
            == "token-missing"
        )
    assert access.find_refusal("/assets/index.js", headers) is None  # a public file of viser
    for name in ("websocket", "WebSocket"):  # RFC 6455, 4.2.1: compared without regard to case
        upgrade = headers | {"Upgrade": name}
        assert get_code(access.find_refusal("/assets/index.js", upgrade)) == "token-missing"
    flags = {part.strip().lower() for part in access.cookie_header.split(";")}
    assert {"httponly", "samesite=strict", "path=/"} <= flags
    evil = headers | SOCKET | {"Origin": "http://evil.example"}
    assert get_code(access.find_refusal(f"/?token={access.token}", evil)) == "another-page-asks"


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("/home/a/robots/v3.xml: body 'payload' is there", "v3.xml: body 'payload' is there"),
        ("/home/a/b.urdf:12: no limit", "b.urdf:12: no limit"),
        ("cannot read '/srv/x/y.stl' (gone)", "cannot read 'y.stl' (gone)"),
        ("C:\\robots\\v3.xml: odd", "v3.xml: odd"),
        ("~/robots/v3.xml: odd", "v3.xml: odd"),
        ("kp: 0 N m/rad is not positive", "kp: 0 N m/rad is not positive"),
        (
            "FL/1 and FL/2 touch; 1/2 of it, 3 N m s/rad",
            "FL/1 and FL/2 touch; 1/2 of it, 3 N m s/rad",
        ),
        ("see http://localhost:8080/a/b", "see http://localhost:8080/a/b"),
        ("geom 'a/b/c' of models/robot.xml", "geom 'a/b/c' of models/robot.xml"),
    ],
)
def test_page_shows_no_folders_of_the_server(text: str, shown: str) -> None:
    assert strip_folders(text) == shown
    assert Translator("en").format_diagnostic(problem(text)) == shown


def test_page_shows_no_folders_with_spaces(tmp_path: Path) -> None:
    """Existing folders are recognised up to the file, also if the file does not exist."""
    folder = tmp_path / "my robots" / "it's v3 and more"
    folder.mkdir(parents=True)
    assert strip_folders(f"{folder}/my v3.xml:12: no limit") == "my v3.xml:12: no limit"
    assert (
        strip_folders(f"cannot read '{folder}/gone/y.stl' (gone)") == "cannot read 'y.stl' (gone)"
    )
    both = f"{folder}/a.urdf and {folder}/a.xml differ by 1/2 N m s/rad"
    assert strip_folders(both) == "a.urdf and a.xml differ by 1/2 N m s/rad"
    assert strip_folders(f"{folder}: not a file") == "it's v3 and more: not a file"


@pytest.fixture(scope="module")
def page() -> Iterator[Page]:
    one = Page(pa.load_variant("v3"))
    yield one
    one.close()


def send_request(address: str, **headers: str) -> tuple[int, str]:
    try:
        with urllib.request.urlopen(urllib.request.Request(address, headers=headers)) as found:
            return found.status, str(found.headers.get("Set-Cookie", ""))
    except urllib.error.HTTPError as error:
        return error.code, error.read().decode()


def test_server_refuses_other_host_names(page: Page) -> None:
    assert send_request(page.address)[0] == 200
    status, body = send_request(page.address, Host="evil.example")
    assert status == 403
    assert "the address that the program printed" in body


def test_remote_page_requires_its_token() -> None:
    page = Page(pa.load_variant("v3"), host="0.0.0.0")
    try:
        (token,) = parse_qs(urlsplit(page.address).query)["token"]
        bare = page.address.partition("?")[0]
        assert send_request(bare)[0] == 403
        assert send_request(f"{bare}assets/index.js")[0] != 403
        assert send_request(f"{bare}assets/index.js", Upgrade="websocket")[0] == 403
        status, cookie = send_request(page.address)
        assert status == 200
        assert token in cookie
        assert send_request(bare, Cookie=cookie.partition(";")[0])[0] == 200
    finally:
        page.close()


async def _talk(address: str, *messages: Any, origin: str | None = None) -> list[bytes]:
    """Send messages as viser's page does, and return the messages received within 1 s."""
    where = address.replace("http", "ws")
    host = urlsplit(address).netloc
    async with websockets.connect(
        where,
        origin=origin or f"http://{host}",
        subprotocols=[f"viser-v{viser.__version__}"],
        max_size=None,
    ) as socket:
        findings: list[bytes] = []
        for message in messages:
            await socket.send(message)
            await asyncio.sleep(0.05)
        end = asyncio.get_running_loop().time() + 1.0
        while (left := end - asyncio.get_running_loop().time()) > 0:
            try:
                findings.append(await asyncio.wait_for(socket.recv(), left))
            except TimeoutError:
                break
        return findings


def test_a_connection_of_another_page_is_refused_at_once(page: Page) -> None:
    refused = pytest.importorskip("websockets").exceptions.InvalidStatus
    with pytest.raises(refused, match="403"):
        asyncio.run(_talk(page.address, origin="http://evil.example"))
    assert not page.sessions


@pytest.mark.parametrize(("mebibytes", "too_big"), [(2.0, True), (0.5, False)])
def test_a_message_of_more_than_a_mebibyte_ends_the_connection_as_too_big(
    page: Page, mebibytes: float, too_big: bool
) -> None:
    """RFC 6455, 7.4.1: code 1009. A shorter message that is not understood has another code."""
    closed = pytest.importorskip("websockets").exceptions.ConnectionClosed
    with pytest.raises(closed) as caught:
        asyncio.run(_talk(page.address, bytes(int(mebibytes * 2**20)), b"x"))
    assert (caught.value.rcvd.code == 1009) is too_big
    assert send_request(page.address)[0] == 200
