"""The page over real HTTP, beside a real service on a simulated board: the board decides whether a STOP came."""

from __future__ import annotations

import json
import os
import signal
import socket
import time
from pathlib import Path

import pytest

from failstop.web import assets, guard
from failstop_lab.trial import Trial, judge, wait_for
from tests.support.commands import failstop
from tests.web.parts import HEADERS, Web
from tests.web.viewer import Viewer

IMU_HZ = 110.0
"""The robot is seen still by the samples of a real board."""
MOST_BYTES = 150_000


def test_a_stop_on_the_page_stops_the_wheels(trial: Trial, web: Web) -> None:
    trial.enable()
    trial.drive(0.3)
    assert web.get("/api/state")["view"]["word"] == "MOVING"
    trial.board.events()
    moving, asked_ns = trial.turning(), time.monotonic_ns()
    status, said = web.post("/api/stop")
    assert (status, said["written"], moving) == (200, True, True)
    trial.drive(0.2)
    seen = judge(trial.board.events(), asked_ns, moving)
    assert seen.stop_ns is not None
    assert seen.motion_after == 0
    assert not trial.turning()
    found = web.until("STOPPED")
    assert found["latched"]
    assert 'asked for a stop: "STOP on the page"' in found["why"]
    assert found["stop"]["written"]
    assert found["stop"]["t"] == pytest.approx(said["asked"], abs=0.5)


def test_stopped_again_while_it_is_stopped(trial: Trial, web: Web) -> None:
    trial.robot.estop("somebody else")
    wait_for("the latch", lambda: trial.robot.state.estop)
    status, said = web.post("/api/stop")
    assert (status, said["written"]) == (200, True)


def test_while_the_board_is_unplugged_no_stop_is_said_to_be_written(trial: Trial, web: Web) -> None:
    """The wheels may turn: who has touched STOP must hear of the power switch."""
    trial.enable()
    trial.drive(0.3)
    told = trial.service.written()
    trial.board.unplug()
    wait_for("the loss", lambda: "is gone" in trial.service.said(told))
    status, said = web.post("/api/stop")
    assert (status, said["written"]) == (200, False)
    trial.board.replug()
    wait_for("the port", lambda: "is back" in trial.service.said(told))
    status, said = web.post("/api/stop")
    assert (status, said["written"]) == (200, True)


def test_everything_that_is_answered_carries_the_headers(web: Web) -> None:
    for method, path in (("GET", "/"), ("GET", "/page.js"), ("GET", "/nowhere"), ("PUT", "/"), ("POST", "/api/stop/x")):
        _, headers, _ = web.ask(method, path)
        for name, value in guard.HEADERS.items():
            if name == "Content-Security-Policy":
                for part in (
                    "default-src 'none'",
                    "frame-ancestors 'none'",
                    "form-action 'none'",
                    "connect-src 'self'",
                ):
                    assert part in headers[name.lower()], path
                assert "unsafe" not in headers[name.lower()]
            else:
                assert headers[name.lower()] == value, path
        assert "server" not in headers
        assert "access-control-allow-origin" not in headers


def test_the_page_names_its_own_script_and_style(web: Web) -> None:
    _, headers, content = web.ask("GET", "/")
    assert headers["content-security-policy"].count("'sha256-") == len(assets.WITHIN)
    assert not [name for name in assets.WITHIN if f"/*{name}*/".encode() in content]
    assert b"http" not in content.replace(b"http://www.w3.org", b""), "nothing is fetched from elsewhere"


def test_it_is_small(web: Web) -> None:
    sizes = {path: len(web.ask("GET", path)[2]) for path in assets.load()}
    assert all(sizes.values())
    assert sum(sizes.values()) < MOST_BYTES


@pytest.mark.parametrize(
    ("method", "path", "headers", "status"),
    [
        ("GET", "/api/state", {"Host": "evil.example"}, 421),
        ("POST", "/api/stop", {**HEADERS, "Host": "evil.example:8477"}, 421),
        ("POST", "/api/stop", {**HEADERS, "Origin": "http://evil.example"}, 403),
        ("POST", "/api/stop", {**HEADERS, "Sec-Fetch-Site": "cross-site"}, 403),
        ("POST", "/api/stop", {}, 403),
        ("GET", "/api/live", {"Upgrade": "websocket", "Connection": "Upgrade", "Origin": "http://evil.example"}, 403),
        ("GET", "/api/stop", {}, 405),
        ("GET", "/../page.html", {}, 404),
        ("GET", "/%2e%2e/pyproject.toml", {}, 404),
        ("DELETE", "/api/state", {}, 405),
        ("POST", "/api/stop", {**HEADERS, "Content-Length": "100000"}, 400),
    ],
)
def test_what_the_guard_refuses(
    trial: Trial, web: Web, method: str, path: str, headers: dict[str, str], status: int
) -> None:
    """No refused request comes to the service."""
    before = trial.robot.state.epoch
    assert web.ask(method, path, headers=headers)[0] == status
    assert trial.robot.state.epoch == before


def test_a_link_of_another_site_opens_the_page_and_nothing_else(web: Web) -> None:
    link = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate", "Sec-Fetch-Dest": "document"}
    assert [web.ask("GET", path, headers=link)[0] for path in ("/", "/api/state")] == [200, 403]


def test_garbage_is_answered_with_nothing_of_the_inside(web: Web) -> None:
    for given in (b"\x16\x03\x01\x02\x00", b"GET / HTTP/9.9\r\n\r\n", b"\0" * 2000, b"POST /api/stop HTTP/1.1\r\n\r\n"):
        with socket.create_connection(("127.0.0.1", web.port), timeout=5) as connection:
            connection.sendall(given)
            connection.shutdown(socket.SHUT_WR)
            said = connection.makefile("rb").read()
        assert b"Traceback" not in said
    assert web.until("STOPPED")


def test_without_a_service_it_says_so_and_a_stop_is_not_written() -> None:
    with Web("web-nobody") as alone:
        assert alone.get("/api/state")["view"]["word"] == "NO SERVICE"
        status, said = alone.post("/api/stop")
        assert status == 503
        assert "no service" in said["error"]
        with Viewer(alone, path="/api/stop/live") as stopping:
            stopping.send(stop="a")
            assert "no service" in stopping.next()["error"]


NO_TEMPORARY_FILES = """
import sys, tempfile
from failstop.cli.main import main
tempfile.tempdir = "/nowhere"
sys.exit(main(sys.argv[1:]))
"""
"""A program as on a full disk, where no folder for temporary files can be made."""


def test_without_room_for_temporary_files_the_page_starts_and_stops(trial: Trial, tmp_path: Path) -> None:
    trial.robot.reset()
    with Web(trial.name, state=str(tmp_path), program=("-c", NO_TEMPORARY_FILES)) as page:
        status, said = page.post("/api/stop")
        assert (status, said["written"]) == (200, True)
        assert page.close() == 0
    wait_for("the latch", lambda: trial.robot.state.estop)


def test_a_page_that_cannot_listen_says_where(web: Web) -> None:
    done = failstop("web", "--name", "web-taken", "--port", str(web.port))
    assert (done.returncode, done.stdout) == (1, "")
    said = " ".join(done.stderr.split())
    assert f"the page can't listen at 127.0.0.1, port {web.port}: Address already in use" in said


def test_without_pairing_nobody_may(web: Web) -> None:
    assert web.post("/api/pair", {"code": "0000-0000"})[0] == 403
    assert web.post("/api/disable", headers=HEADERS)[0] == 401
    assert "pairing is switched off" in web.command("pair").stderr
    assert json.loads(web.ask("GET", "/api/state")[2])["live"]


def test_a_page_that_is_killed_or_hangs_leaves_the_robot_alone(trial: Trial) -> None:
    """The page is no part of the stop path, nor of any driving."""
    with Web(trial.name) as other:
        trial.enable()
        trial.drive(0.3)
        os.kill(other.process.pid, signal.SIGSTOP)
        trial.drive(0.3)
        assert trial.turning()
        os.kill(other.process.pid, signal.SIGKILL)
        trial.drive(0.3)
        assert trial.turning()
        assert trial.robot.state.estop is None
    trial.robot.disable()
