"""Starved or hung: the verdict, and what the kernel says of real processes."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import time
from collections.abc import Callable, Iterable, Iterator

import pytest

from failstop.messages import layout, segments
from failstop.procs import starved
from failstop.shm.bell import EventBell
from failstop.shm.heartbeat import Heartbeat, HeartbeatReader
from failstop.shm.segment import Segment
from failstop_lab.faults.crowd import Helper, spin_for_ever
from failstop_lab.faults.starve import SHARP, Starved
from tests.support.stage import MS
from tests.support.waiting import until

pytestmark = pytest.mark.alone

DEADLINE_NS = 100 * MS


@pytest.mark.parametrize(("states", "least_ms"), [("RD", 50), (("S", "T", "t", "Z", "X", "I", "", "RD"), 0)])
def test_the_verdict_follows_the_state_and_the_time_run(states: Iterable[str], least_ms: float) -> None:
    """A process hangs that had a processor for half its deadline, or waits for something else than one."""
    for state in states:
        for ran_ms in (0, 1, 49.999, 50, 100):
            assert starved.starved(state, round(ran_ms * MS), DEADLINE_NS) is (ran_ms < least_ms), (state, ran_ms)


@pytest.fixture
def own() -> Iterator[Segment]:
    name = f"v{os.getpid()}"
    segments.create(name, layout.TELEMETRY, 7).close()
    yield segments.attach(name, layout.TELEMETRY, 7, write=True)
    segments.unlink_all(name)


@pytest.fixture
def end() -> Iterator[contextlib.ExitStack]:
    with contextlib.ExitStack() as stack:
        yield stack


def state(pid: int) -> str:
    with open(f"/proc/{pid}/stat", encoding="utf-8") as file:
        return file.read().rpartition(") ")[2][0]


def ran_ns(pid: int) -> int:
    with open(f"/proc/{pid}/schedstat", encoding="utf-8") as file:
        return int(file.read().split()[0])


def look(own: Segment, pid: int, *, beat_pid: int = 0, deadline_ns: int = DEADLINE_NS) -> tuple[bool, bool]:
    """The verdict, and whether it was rung for."""
    own.word("beat_pid").set(beat_pid or pid)
    bell = EventBell.create()
    try:
        found = starved.look(pid, HeartbeatReader(own), deadline_ns, bell)
        rung = bool(select.select([bell.fd], [], [], 0)[0])
    finally:
        os.close(bell.fd)
    return found, rung


def helper(end: contextlib.ExitStack, action: Callable[[], None], *keep: int) -> Helper:
    made = Helper(action, keep)
    end.callback(made.end)
    return made


def test_a_process_that_sleeps_is_rung_for_and_hangs(own: Segment, end: contextlib.ExitStack) -> None:
    process = helper(end, signal.pause)
    until(lambda: state(process.pid) == "S", "its sleep")
    assert look(own, process.pid) == (False, True)


def test_a_process_that_sleeps_until_it_is_rung_for_is_only_late(own: Segment, end: contextlib.ExitStack) -> None:
    """Its timer did not wake it; the bell makes it runnable, and it burns what little it needs."""
    waiting, wake = os.pipe()

    def wakes_at_the_bell() -> None:
        os.read(waiting, 1)
        spin_for_ever()

    process = helper(end, wakes_at_the_bell, waiting)
    until(lambda: state(process.pid) == "S", "its sleep")

    class Bell:
        fd = wake

        def ring(self) -> None:
            os.write(wake, b"x")

    own.word("beat_pid").set(process.pid)
    own.word("beat_cpu_ns").set(ran_ns(process.pid))
    assert starved.look(process.pid, HeartbeatReader(own), 10_000 * MS, Bell())  # type: ignore[arg-type]
    os.close(waiting), os.close(wake)


def test_a_process_that_is_stopped_hangs(own: Segment, end: contextlib.ExitStack) -> None:
    process = helper(end, spin_for_ever)
    process.signal(signal.SIGSTOP)
    until(lambda: state(process.pid) == "T", "its stop")
    assert look(own, process.pid, deadline_ns=10**15) == (False, False)


def test_an_endless_loop_hangs_once_it_has_run_for_half_its_deadline(own: Segment, end: contextlib.ExitStack) -> None:
    process = helper(end, spin_for_ever)
    until(lambda: ran_ns(process.pid) > DEADLINE_NS // 2, "its loop")
    assert look(own, process.pid)[0] is False


def test_a_process_that_others_keep_from_running_is_starved(own: Segment, end: contextlib.ExitStack) -> None:
    process = helper(end, lambda: (os.setsid(), spin_for_ever())[1])
    until(lambda: os.getsid(process.pid) == process.pid, "a session of its own")
    end.enter_context(Starved(process.pid, SHARP))
    own.word("beat_cpu_ns").set(ran_ns(process.pid) + 20 * MS)
    assert look(own, process.pid) == (True, False)


def test_the_time_before_its_beat_and_its_predecessor_s_do_not_count(own: Segment, end: contextlib.ExitStack) -> None:
    process = helper(end, spin_for_ever)
    until(lambda: ran_ns(process.pid) > 100 * MS, "its loop")
    own.word("beat_cpu_ns").set(ran_ns(process.pid))
    assert look(own, process.pid, deadline_ns=180 * MS)[0]
    assert not look(own, process.pid, beat_pid=1, deadline_ns=180 * MS)[0]


def test_of_a_process_that_is_gone_nothing_is_known(own: Segment) -> None:
    process = Helper(signal.pause)
    pid = process.pid
    process.end()
    assert look(own, pid) == (False, False)


def test_a_beat_tells_the_processor_time(own: Segment) -> None:
    heart = Heartbeat(own, os.getpid(), 0, 0)
    first_ns = own.word("beat_cpu_ns").get()
    assert first_ns > 0
    heart.beat(1)
    assert first_ns < own.word("beat_cpu_ns").get() <= time.clock_gettime_ns(time.CLOCK_PROCESS_CPUTIME_ID)
