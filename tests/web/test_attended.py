"""A robot that moves only while an operator is there: the board says when the wheels stood. Times are the robot's."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from failstop.api.errors import Refused
from failstop.api.robot import Robot
from failstop_lab.trial import Trial, judge, wait_for
from tests.web.driving_parts import enable_soon
from tests.web.parts import Web, driven
from tests.web.viewer import Viewer

LEASE_S = 1.0
SETTINGS = f'[attend]\nrequired = "on"\nlease_s = {LEASE_S}\n[web]\npairing = "on"\n'


@pytest.fixture(scope="module")
def pages(trial: Trial, settings: str) -> Iterator[list[Web]]:
    """Pages that run: one for all tests, and another after a test that ends it."""
    running: list[Web] = []
    yield running
    for page in running:
        page.close()


@pytest.fixture
def web(trial: Trial, settings: str, pages: list[Web]) -> Iterator[Web]:
    if not pages:
        pages.append(Web(trial.name, "--config", settings, state=trial.state))
    yield pages[0]
    if pages[0].process.poll() is None:
        pages[0].process.send_signal(signal.SIGCONT)
    else:
        pages.pop().close()


@pytest.fixture
def anna(web: Web, paired: dict[Web, dict[str, str]]) -> dict[str, str]:
    """The headers of a device that is paired with this page."""
    if web not in paired:
        paired[web] = web.pair()
    return paired[web]


@pytest.fixture(scope="module")
def paired() -> dict[Web, dict[str, str]]:
    """Devices by page: one pairs five of them at once, and no more."""
    return {}


def stopped(trial: Trial, since_ns: int, reason: str) -> float:
    """Seconds from a moment to the stop, by the board's word. test_gate_attendance.py has its exact time."""
    wait_for("the stop", lambda: trial.robot.state.estop)
    assert reason in str(trial.robot.state.estop)
    # It is latched before the board has its frame.
    trial.board.wait_for(lambda event: event.is_stop and event.arrival_ns >= since_ns, 10)
    seen = judge(trial.board.events(), since_ns, was_turning=True)
    assert seen.stop_ns is not None
    assert seen.motion_after == 0
    return seen.stop_ns / 1e9


def test_nobody_attends_and_nothing_is_enabled(trial: Trial) -> None:
    with pytest.raises(Refused, match="nobody attends"):
        trial.enable()
    assert trial.robot.state.attended_by == ()


def test_a_program_attends_and_leaves(trial: Trial) -> None:
    with driven(trial):
        trial.robot.attend("Anna")
        enable_soon(trial)
        for _ in range(10):
            trial.robot.attend("Anna")
            time.sleep(0.05)
        assert trial.turning()
        assert trial.robot.state.attended_by == ("Anna",)
        trial.board.events()
        left_ns = time.monotonic_ns()
        trial.robot.leave()
        stopped(trial, left_ns, "operator gone: Anna, left")


@pytest.mark.claim("ATTEND-1")
def test_a_program_that_stops_renewing(trial: Trial) -> None:
    with driven(trial), Robot(trial.name) as other:
        other.attend("Anna")
        enable_soon(trial)
        wait_for("motion", lambda: other.attend("Anna") or trial.turning())
        trial.board.events()
        last_ns = time.monotonic_ns()
        other.attend("Anna")
        assert stopped(trial, last_ns, "operator gone: Anna, was not heard for") > LEASE_S


def test_a_client_that_is_killed_has_left(trial: Trial) -> None:
    """The claim ends, and with it the attendance: the lease is not waited for."""
    reading, writing = os.pipe()
    pid = os.fork()
    if pid == 0:
        with Robot(trial.name, client="short") as robot:
            while True:
                robot.attend("Bert")
                os.write(writing, b".")
                time.sleep(0.05)
    os.read(reading, 1)
    with driven(trial):
        enable_soon(trial)
        wait_for("motion", trial.turning)
        trial.board.events()
        killed_ns = time.monotonic_ns()
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
        stopped(trial, killed_ns, "operator gone: Bert, left")
    os.close(reading)
    os.close(writing)


def moving(trial: Trial, viewer: Viewer) -> None:
    """The page's operator attends, and the robot drives."""
    viewer.attend()
    viewer.stay(0.2)
    enable_soon(trial)
    viewer.stay(0.4)
    assert trial.turning()
    trial.board.events()


Ends = Callable[[Web, Viewer], None]
SUDDEN: list[tuple[str, Ends]] = [
    ("leaves", lambda web, viewer: viewer.send(attend=False)),
    ("closes", lambda web, viewer: viewer.hang_up()),
    ("page-killed", lambda web, viewer: os.kill(web.process.pid, signal.SIGKILL)),
    ("page-ended", lambda web, viewer: os.kill(web.process.pid, signal.SIGTERM)),
]
SLOW: list[tuple[str, Ends]] = [
    ("silent", lambda web, viewer: None),
    ("page-hangs", lambda web, viewer: os.kill(web.process.pid, signal.SIGSTOP)),
]


@pytest.mark.page
@pytest.mark.parametrize(("name", "end"), SUDDEN, ids=[name for name, _ in SUDDEN])
def test_an_end_that_is_seen_counts_at_once(trial: Trial, web: Web, anna: dict[str, str], name: str, end: Ends) -> None:
    with driven(trial), Viewer(web, anna) as viewer:
        moving(trial, viewer)
        since_ns = time.monotonic_ns()
        end(web, viewer)
        with contextlib.suppress(ConnectionError):
            viewer.next()
        stopped(trial, since_ns, ", left")
    if name.startswith("page-"):
        web.process.wait(10)


@pytest.mark.parametrize(("name", "end"), SLOW, ids=[name for name, _ in SLOW])
def test_an_end_that_nobody_sees_counts_when_the_lease_ends(
    trial: Trial, web: Web, anna: dict[str, str], name: str, end: Ends
) -> None:
    with driven(trial), Viewer(web, anna) as viewer:
        moving(trial, viewer)
        since_ns = time.monotonic_ns()
        end(web, viewer)
        assert stopped(trial, since_ns, ", was not heard for") > LEASE_S - 0.3


@pytest.mark.page
def test_a_backlog_and_replays_renew_nothing(trial: Trial, web: Web, anna: dict[str, str]) -> None:
    """A network delivers at once, right and in order, what it held back, and once more what was taken before."""
    with Viewer(web, anna) as viewer:
        viewer.attend()
        wait_for("the operator", lambda: trial.robot.state.attended_by)
        held_back: list[str] = []
        while len(held_back) < 12:
            if nonce := viewer.next().get("nonce"):
                held_back.append(nonce)
        assert trial.robot.state.attended_by == (), "the lease is over"
        for _ in range(3):
            for nonce in held_back[:-3]:
                viewer.answer(nonce)
        viewer.next()
        viewer.next()
        assert trial.robot.state.attended_by == ()
        viewer.stay(0.15)
        wait_for("the operator", lambda: viewer.stay(0.05) or trial.robot.state.attended_by)


JUMPING = """
import itertools, runpy, time
now, jumps = time.time, itertools.cycle((0, 3600, -86400, 1e8))
time.time = lambda: now() + next(jumps)
runpy.run_module("failstop", run_name="__main__", alter_sys=True)
"""
"""The page, with a wall clock that is somewhere else each time it is read."""


@pytest.mark.page
def test_a_clock_that_jumps(trial: Trial, settings: str, tmp_path: Path) -> None:
    """The page's, to and fro by hours and years: who answers attends, who does not is gone in time, and STOP works."""
    program = ("-c", JUMPING)
    with Web(trial.name, "--config", settings, state=str(tmp_path), program=program) as web, driven(trial):
        with Viewer(web, web.pair()) as viewer:
            moving(trial, viewer)
            seen = {round(message["t"] / 3600) for message in viewer.seen}
            assert len(seen) > 2, "it does jump"
            since_ns = time.monotonic_ns()
            assert stopped(trial, since_ns, ", was not heard for") > LEASE_S - 0.3
        status, said = web.post("/api/stop")
        assert (status, said["written"]) == (200, True)


PUT_OUT = """
import ctypes, runpy, signal
madvise = ctypes.CDLL(None).madvise
def put_out(number, frame):
    with open("/proc/self/maps", encoding="utf-8") as file:
        maps = [(line, [int(end, 16) for end in line.split()[0].split("-")]) for line in file]
    for line, (start, end) in maps:
        madvise(ctypes.c_void_p(start), ctypes.c_size_t(end - start), 4 if " r-xp " in line and "/" in line else 21)
signal.signal(signal.SIGUSR1, put_out)
runpy.run_module("failstop", run_name="__main__", alter_sys=True)
"""
"""The page, which at a signal has the kernel take away its code (MADV_DONTNEED), and of the rest what there is room for
in the swap (MADV_PAGEOUT)."""


def faults(pid: int) -> int:
    """The number of times that the process has touched memory that was not there."""
    with open(f"/proc/{pid}/stat", encoding="utf-8") as file:
        fields = file.read().rpartition(")")[2].split()
    return int(fields[7]) + int(fields[9])


@pytest.mark.page
def test_a_page_whose_memory_is_swapped_out(trial: Trial, settings: str, tmp_path: Path) -> None:
    """Ten times a second: the operator stays, or on a slow machine is gone and nothing moves after it; STOP works."""
    with Web(trial.name, "--config", settings, state=str(tmp_path), program=("-c", PUT_OUT)) as web, driven(trial):
        with Viewer(web, web.pair()) as viewer:
            moving(trial, viewer)
            before, since_ns = faults(web.process.pid), time.monotonic_ns()
            for _ in range(10):
                os.kill(web.process.pid, signal.SIGUSR1)
                viewer.stay(0.1)
            assert faults(web.process.pid) - before > 500, "it was taken away"
            if trial.robot.state.estop:
                stopped(trial, since_ns, ", was not heard for")
            else:
                assert trial.turning()
        os.kill(web.process.pid, signal.SIGUSR1)
        status, said = web.post("/api/stop")
        assert (status, said["written"]) == (200, True)


def test_a_wrong_key_renews_nothing(trial: Trial, web: Web, anna: dict[str, str]) -> None:
    with Viewer(web, anna) as viewer:
        viewer.send(attend=True)
        for _ in range(10):
            if nonce := viewer.next().get("nonce"):
                viewer.answer(nonce, b"guess")
                viewer.send(nonce=nonce, answer=7)
                viewer.send(nonce=[nonce], answer=None)
        assert trial.robot.state.attended_by == ()


@pytest.mark.page
def test_two_operators_the_last_one_counts(trial: Trial, web: Web) -> None:
    with driven(trial), Viewer(web, web.pair("Bert")) as bert:
        with Viewer(web, web.pair("Anna")) as anna:
            anna.attend()
            moving(trial, bert)
            anna.stay(0.1)
        bert.stay(LEASE_S * 1.5)
        assert trial.turning()
        since_ns = time.monotonic_ns()
        bert.send(attend=False)
        stopped(trial, since_ns, "operator gone: Bert, left")


@pytest.mark.page
def test_of_two_operators_one_sleeps_and_the_other_leaves(trial: Trial, web: Web) -> None:
    """The leaving counts at once: a sleeping operator does not attend."""
    with driven(trial), Viewer(web, web.pair("Carla")) as carla, Viewer(web, web.pair("Emil")) as emil:
        emil.attend()
        moving(trial, carla)
        carla.stay(LEASE_S + 0.2)
        assert trial.turning()
        trial.board.events()
        since_ns = time.monotonic_ns()
        carla.send(attend=False)
        stopped(trial, since_ns, "operator gone: Carla, left")


@pytest.mark.page
def test_of_two_operators_one_leaves_and_the_other_is_there(trial: Trial, web: Web) -> None:
    with driven(trial), Viewer(web, web.pair("Fritz")) as fritz, Viewer(web, web.pair("Gerd")) as gerd:
        gerd.attend()
        moving(trial, fritz)
        until_s = time.monotonic() + 1.0
        while time.monotonic() < until_s:
            fritz.stay(0.05)
            gerd.stay(0.05)
        fritz.send(attend=False)
        gerd.stay(LEASE_S)
        assert trial.turning()
        assert trial.robot.state.attended_by == ("Gerd",)


@pytest.mark.page
def test_a_revoked_device_attends_no_more(trial: Trial, web: Web) -> None:
    with driven(trial), Viewer(web, web.pair("Dora")) as viewer:
        moving(trial, viewer)
        listed = web.command("devices").stdout.splitlines()
        identity = next(line.split()[0] for line in listed if line.endswith("Dora"))
        threading.Thread(target=web.command, args=("revoke", identity)).start()
        # The page may be told that it is not paired any more before the stop is latched.
        with contextlib.suppress(ConnectionError):
            until_s = time.monotonic() + 10
            while not trial.robot.state.estop and time.monotonic() < until_s:
                viewer.stay(0.1)
        wait_for("a stop", lambda: bool(trial.robot.state.estop))
        assert "operator gone: Dora" in str(trial.robot.state.estop)
