"""Floods, slow clients and crowds: whatever they do, a STOP of somebody else comes through."""

from __future__ import annotations

import asyncio
import os
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress

import pytest

from failstop.web import connections, sockets
from failstop_lab.trial import Trial, wait_for
from tests.web.parts import Web
from tests.web.viewer import Viewer

pytestmark = pytest.mark.page

CROWD = 50
FLOOD = 1000
SOON_S = 2.0


@pytest.fixture
def flood(web: Web) -> Iterator[list[socket.socket]]:
    """A thousand connections that say nothing."""
    with ExitStack() as stack:
        opened = []
        for _ in range(FLOOD):
            with suppress(OSError):
                opened.append(stack.enter_context(socket.create_connection(("127.0.0.1", web.port), timeout=5)))
        yield opened


def _drain(viewer: Viewer) -> None:
    """Read until it is closed."""
    while True:
        viewer.next()


def stops(trial: Trial, web: Web) -> float:
    """Seconds that a STOP took, from the request to the answer that it is written."""
    since_s = time.monotonic()
    status, said = web.post("/api/stop")
    assert (status, said["written"]) == (200, True)
    assert trial.robot.state.estop
    return time.monotonic() - since_s


def test_a_thousand_connections_keep_no_stop_out(trial: Trial, web: Web, flood: list[socket.socket]) -> None:
    assert len(flood) > connections.MOST
    assert stops(trial, web) < SOON_S
    assert len(os.listdir(f"/proc/{web.process.pid}/fd")) < connections.MOST + 100


def test_slow_clients_are_let_go(trial: Trial, web: Web) -> None:
    with socket.create_connection(("127.0.0.1", web.port), timeout=2 * connections.IDLE_S) as slow:
        slow.sendall(b"POST /api/stop HTTP/1.1\r\nHost: localhost\r\nX-Failstop: 1\r\nContent-Length: 4000\r\n\r\n{")
        assert stops(trial, web) < SOON_S
        said = b""
        with suppress(ConnectionError):
            said = slow.makefile("rb").read()
        assert b"200" not in said


def test_fifty_viewers_see_it_ten_times_a_second(trial: Trial, web: Web) -> None:
    with ExitStack() as stack:
        viewers = [stack.enter_context(Viewer(web)) for _ in range(CROWD)]
        for viewer in viewers:
            assert viewer.next()["view"]["name"] == trial.name
        first = viewers[0].next()["t"]
        for _ in range(10):
            last = viewers[0].next()["t"]
        assert last - first < 5.0
        assert stops(trial, web) < SOON_S


def test_too_many_viewers_are_refused_and_can_stop(trial: Trial, web: Web) -> None:
    with ExitStack() as stack:
        for _ in range(sockets.MOST_VIEWERS):
            stack.enter_context(Viewer(web))
        with pytest.raises(Exception, match="503"), Viewer(web):
            pass
        assert web.get("/api/state")["view"]["name"] == trial.name
        assert stops(trial, web) < SOON_S


def test_a_viewer_that_takes_nothing_holds_up_nobody(trial: Trial, web: Web) -> None:
    with Viewer(web) as lazy, Viewer(web) as keen:
        assert lazy.next()
        since_s = time.monotonic()
        while time.monotonic() - since_s < 1.0:
            keen.next()
        assert stops(trial, web) < SOON_S


def test_what_viewers_say_means_nothing(trial: Trial, web: Web) -> None:
    with Viewer(web) as rude:
        for message in ("", "{", "[]", "7", "null", '{"attend": 1}', '{"nonce": {}}', "x" * 4000):

            async def say(text: str = message) -> None:
                await rude.connection.write_message(text)

            rude.loop.run_until_complete(say())
        assert rude.next()
    with Viewer(web) as long:

        async def flood() -> None:
            await long.connection.write_message("x" * 100_000)

        long.loop.run_until_complete(flood())
        with pytest.raises((ConnectionError, asyncio.TimeoutError)):
            _drain(long)
    assert stops(trial, web) < SOON_S


def test_a_flood_of_stops_is_one_stop(trial: Trial, web: Web) -> None:
    """The service lives through it."""
    ended = threading.Event()

    def flood() -> None:
        while not ended.is_set():
            web.post("/api/stop")

    threads = [threading.Thread(target=flood) for _ in range(4)]
    for thread in threads:
        thread.start()
    try:
        wait_for("the latch", lambda: trial.robot.state.estop)
        assert stops(trial, web) < SOON_S
    finally:
        ended.set()
        for thread in threads:
            thread.join()
    wait_for("all well", lambda: not [p for p in trial.robot.state.processes.values() if p.state != "running"])
