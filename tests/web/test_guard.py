"""Requests that are let in: each row of the table, and that nothing gets round it."""

from __future__ import annotations

import dataclasses
import string
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop.api.errors import FailstopError
from failstop.web import guard
from failstop.web.guard import PageRequest

KNOWN = guard.names("Robot-7.lan.example", "rover  kiosk.example")
OWN = PageRequest("GET", "http", "robot-7.local:8477")
POST = PageRequest("POST", "http", "robot-7.local:8477", "http://robot-7.local:8477", "1", "same-origin")
SOCKET = dataclasses.replace(OWN, origin="http://robot-7.local:8477", upgrade=True)


def refused(request: PageRequest, **changed: Any) -> int:
    """The status of a refusal; 0: it is let in."""
    found = guard.refusal(dataclasses.replace(request, **changed), KNOWN)
    return found[0] if found else 0


@pytest.mark.parametrize("request_", [OWN, POST, SOCKET])
def test_its_own_page_is_let_in(request_: PageRequest) -> None:
    assert refused(request_) == 0


def test_it_answers_to_its_own_names() -> None:
    assert {"localhost", "robot-7", "robot-7.local", "robot-7.lan.example", "rover", "kiosk.example"} == KNOWN


@pytest.mark.parametrize(
    "host",
    [
        "127.0.0.1",
        "127.0.0.1:8477",
        "[::1]:8477",
        "10.0.0.7:80",
        "localhost:8477",
        "ROVER",
        "kiosk.example.",
        "Robot-7.local",
    ],
)
def test_an_address_and_a_name_of_its_own(host: str) -> None:
    assert refused(OWN, host=host) == 0


@pytest.mark.parametrize(
    "host",
    ["", "evil.example", "evil.example:8477", "robot-7.local.evil.example", "127.0.0.1.evil.example",
     "localhost@evil.example",
     "evil.example#localhost", "localhost/evil", "localhost:http", "[::1", "127.0.0.1:99999", " ", "1.2.3.4.5"],
)  # fmt: skip
def test_rebinding(host: str) -> None:
    """A page of another site whose name points here still sends its own name."""
    assert refused(OWN, host=host) == 421
    assert refused(POST, host=host, origin=f"http://{host}") == 421


@pytest.mark.parametrize(
    "origin",
    ["http://evil.example", "null", "https://robot-7.local:8477", "http://robot-7.local", "http://robot-7.local:8478"],
)
def test_cross_site(origin: str) -> None:
    assert refused(POST, origin=origin) == 403
    assert refused(SOCKET, origin=origin) == 403
    assert refused(OWN, origin=origin) == 403


PROXIED = guard.origin_of("https://Robot.Example/")


@pytest.mark.parametrize("host", ["robot.example", "127.0.0.1:8477", "robot-7.local"])
def test_behind_a_proxy_the_origin_is_what_the_browser_sees(host: str) -> None:
    """The name that the proxy gives the robot does not matter."""
    known = guard.names("robot-7", "", PROXIED)
    for request in (POST, SOCKET):
        given = dataclasses.replace(request, host=host, origin="https://robot.example")
        assert guard.refusal(given, known, PROXIED) is None
        assert guard.refusal(given, known) is not None
        for origin in ("https://evil.example", "http://robot.example:81", "null", "https://robot.example.evil.example"):
            assert guard.refusal(dataclasses.replace(given, origin=origin), known, PROXIED) is not None


def test_a_socket_that_names_no_origin_is_refused_with_and_without_a_proxy() -> None:
    for proxied in ("", PROXIED):
        assert guard.refusal(dataclasses.replace(SOCKET, origin=""), KNOWN, proxied) is not None


@pytest.mark.parametrize("setting", ["robot.example", "ftp://robot.example", "https://", "https://a/b", "https://a b"])
def test_what_is_no_origin_is_said(setting: str) -> None:
    with pytest.raises(FailstopError, match=r"web\.origin"):
        guard.origin_of(setting)


@pytest.mark.parametrize("site", ["cross-site", "same-site", "anything"])
def test_a_browser_that_says_where_it_comes_from(site: str) -> None:
    assert refused(POST, site=site) == 403


LINK = dataclasses.replace(OWN, site="cross-site", path="/", mode="navigate", dest="document")


@pytest.mark.parametrize("site", ["cross-site", "same-site"])
def test_a_link_of_another_site_opens_the_page(site: str) -> None:
    assert refused(LINK, site=site) == 0


@pytest.mark.parametrize(
    ("changed", "status"),
    [
        ({"path": "/api/state"}, 403),
        ({"path": "/page.js"}, 403),
        ({"path": ""}, 403),
        ({"method": "HEAD"}, 403),
        ({"method": "POST", "header": "1"}, 403),
        ({"mode": "no-cors"}, 403),
        ({"mode": "cors"}, 403),
        ({"mode": ""}, 403),
        ({"dest": "iframe"}, 403),
        ({"dest": "empty"}, 403),
        ({"upgrade": True, "origin": "http://robot-7.local:8477"}, 403),
        ({"origin": "http://evil.example"}, 403),
        ({"host": "evil.example"}, 421),
    ],
)
def test_another_site_can_do_nothing_but_open_the_page(changed: dict[str, Any], status: int) -> None:
    assert refused(LINK, **changed) == status


def test_a_form_or_a_link_cannot_stop_or_drive() -> None:
    """A form and a link can set no header."""
    assert refused(POST, header="") == 403


def test_a_socket_needs_an_origin_and_a_program_does_not() -> None:
    assert refused(SOCKET, origin="") == 403
    assert refused(POST, origin="", site="") == 0


@pytest.mark.parametrize("method", ["PUT", "DELETE", "OPTIONS", "get", ""])
def test_no_other_method(method: str) -> None:
    assert refused(OWN, method=method) == 405


WORDS = st.text(string.ascii_letters + string.digits + ".-:@/#?[]% \t", max_size=40)


@given(WORDS, WORDS, WORDS)
def test_whoever_is_let_in_named_this_robot(host: str, origin: str, header: str) -> None:
    """Requests of any kind: a change comes under an own name or address, from an own page, with the header."""
    request = PageRequest("POST", "http", host, origin, header)
    if guard.refusal(request, KNOWN) is None:
        named = guard.host_of(host)
        assert named in KNOWN or guard.is_address(named)
        assert origin in ("", f"http://{host}".lower()) or origin.lower() == f"http://{host}".lower()
        assert header == "1"
