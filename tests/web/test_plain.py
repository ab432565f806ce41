"""HTTP on the port of HTTPS, and the addresses that are printed: somebody who types what they see gets to the page."""

from __future__ import annotations

import contextlib
import http.client
import os
import socket
import ssl
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from failstop.web import addresses, plain
from tests.web.parts import Web

pytestmark = pytest.mark.page
KNOWN = frozenset(("rover", "rover.local"))


@pytest.fixture(scope="module")
def secure(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Web]:
    """A page over HTTPS, of no service."""
    folder = tmp_path_factory.mktemp("plain")
    with Web(f"plain-{os.getpid()}", "--listen", "0.0.0.0", state=str(folder)) as running:
        yield running


def ask(port: int, host: str, method: str = "GET", path: str = "/") -> tuple[int, str, str]:
    """Status, Location and text of a plain request."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    connection.request(method, path, headers={"Host": host, "X-Failstop": "1"})
    answer = connection.getresponse()
    found = answer.status, answer.getheader("Location", ""), answer.read().decode()
    connection.close()
    return found


def test_http_is_shown_the_way_to_https(secure: Web) -> None:
    host = f"127.0.0.1:{secure.port}"
    status, where, said = ask(secure.port, host)
    assert (status, where) == (307, f"https://{host}/")
    assert "https://" in said
    assert secure.ask("GET", "/")[0] == 200


def test_another_ones_name_is_no_way(secure: Web) -> None:
    for host in ("evil.example", "evil.example/x", "user@127.0.0.1"):
        status, where, said = ask(secure.port, host)
        assert (status, where) == (400, "")
        assert "https://" in said


def test_what_is_neither_is_closed_and_serves_on(secure: Web) -> None:
    for given in (b"\0" * 600, b"SSH-2.0-x\r\n", b"GET"):
        with socket.create_connection(("127.0.0.1", secure.port), timeout=10) as connection:
            connection.sendall(given)
            with contextlib.suppress(OSError):  # the server may have closed it by then
                connection.shutdown(socket.SHUT_WR)
            with contextlib.suppress(ConnectionResetError):
                assert not connection.recv(4096).startswith(b"HTTP/1.1 2")
    assert secure.ask("GET", "/")[0] == 200


@pytest.mark.parametrize(
    ("request_", "status", "where"),
    [
        (b"/ HTTP/1.1\r\nHost: rover:8477\r\n\r\n", b"307", b"https://rover:8477/"),
        (b"/ HTTP/1.1\r\nhost:\trover.local\r\n\r\n", b"307", b"https://rover.local/"),
        (b"/ HTTP/1.1\r\nHost: [fd00::1]:8477\r\n\r\n", b"307", b"https://[fd00::1]:8477/"),
        (b"/ HTTP/1.1\r\nHost: rover\r\nX: \r\nHost: evil\r\n\r\n", b"307", b"https://rover/"),
        (b"/ HTTP/1.1\r\nHost: evil\r\n\r\n", b"400", b""),
        (b"/ HTTP/1.1\r\n\r\n", b"400", b""),
        (b"", b"400", b""),
    ],
)
def test_the_way_is_by_an_own_name(request_: bytes, status: bytes, where: bytes) -> None:
    said = plain.answer(request_, KNOWN)
    assert said.startswith(b"HTTP/1.1 " + status)
    assert (b"Location: " + where + b"\r\n" in said) if where else b"Location" not in said


def test_the_printed_address_can_be_typed(secure: Web, tmp_path: Path) -> None:
    """The first line is one of this machine's addresses, and the page answers there."""
    found = urlsplit(secure.url)
    assert found.hostname in (*addresses.own_addresses(), f"{socket.gethostname().partition('.')[0]}.local")
    assert found.hostname not in addresses.EVERYWHERE
    if found.hostname in addresses.own_addresses():
        context = ssl._create_unverified_context()
        connection = http.client.HTTPSConnection(found.hostname, secure.port, timeout=10, context=context)
        connection.request("GET", "/")
        assert connection.getresponse().status == 200
        connection.close()
