"""Loop: what is ready, hang-ups alone, and time-outs finer than a millisecond."""

from __future__ import annotations

import os
import pty
import resource
import time
import tty

import pytest

from failstop.procs.loop import EDGE, GONE, HANGUP, NEVER, READ, WRITE, Loop, Timer
from tests.support.stage import PortMachine

LATER_NS = 20_000_000_000


def test_a_wait_returns_ready_descriptors_with_their_events(pipe: tuple[int, int]) -> None:
    loop = Loop()
    loop.watch(pipe[0], READ)
    assert loop.wait(0) == loop.wait(-LATER_NS) == {}
    os.write(pipe[1], b"x")
    assert loop.wait(LATER_NS) == {pipe[0]: READ}
    assert loop.wait(0) == {pipe[0]: READ}, "it stays ready until it is read"
    os.read(pipe[0], 1)
    until_ns = time.monotonic_ns() + 2_000_000
    assert loop.wait(2_000_000) == {}
    assert time.monotonic_ns() >= until_ns


def test_time_outs_are_finer_than_a_millisecond() -> None:
    loop = Loop()
    shortest_ns = LATER_NS
    for _ in range(200):
        start_ns = time.monotonic_ns()
        loop.wait(100_000)
        shortest_ns = min(shortest_ns, time.monotonic_ns() - start_ns)
    assert 100_000 <= shortest_ns < 1_000_000


def test_watching_again_changes_the_events_and_forgotten_descriptors_stay_out(pipe: tuple[int, int]) -> None:
    loop = Loop()
    for events, found in ((READ, {}), (READ | WRITE, {pipe[1]: WRITE}), (READ, {})):
        loop.watch(pipe[1], events)
        assert loop.wait(0) == found
    os.write(pipe[1], b"x")
    for _ in range(2):
        loop.watch(pipe[0], READ)
        assert loop.wait(0) == {pipe[0]: READ}
        loop.forget(pipe[0])
        assert loop.wait(0) == {}


def test_at_the_edge_a_wait_tells_of_new_bytes_alone(pipe: tuple[int, int]) -> None:
    loop = Loop()
    os.write(pipe[1], b"x")
    loop.watch(pipe[0], READ | EDGE)
    assert loop.wait(0) == {pipe[0]: READ}, "what was there before counts as new"
    assert loop.wait(0) == {}, "though it was not read"
    os.write(pipe[1], b"y")
    assert loop.wait(LATER_NS) == {pipe[0]: READ}


@pytest.mark.parametrize("longest_ns", [2_000_000, 20_000_000], ids=["a timer's", "the longest"])
def test_a_wait_clears_the_bells_that_it_returns_and_no_other_descriptor(longest_ns: int) -> None:
    machine = PortMachine()
    loop, create = machine.load("failstop.procs.loop").Loop(), machine.load("failstop.shm.bell").EventBell.create
    rung, silent, other = (create() for _ in range(3))
    loop.listen(rung, silent)
    loop.watch(other.fd, READ)
    rung.ring()
    other.ring()
    machine.at_next("read", lambda: [bell.ring() for bell in (rung, silent)])
    assert loop.wait(longest_ns) == {rung.fd: READ, other.fd: READ}
    assert loop.wait(longest_ns) == {silent.fd: READ, other.fd: READ}, "it has rung since"
    assert loop.wait(longest_ns) == {other.fd: READ}


@pytest.mark.parametrize("longest_ns", [2_000_000, 20_000_000])
def test_a_wait_is_one_sleep(longest_ns: int) -> None:
    loop = Loop()
    loop.timer().set(NEVER)
    before = resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw
    assert loop.wait(longest_ns) == {}
    assert resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw - before == 1


def test_hang_up_alone_ignores_bytes_but_not_the_end() -> None:
    master, slave = pty.openpty()
    tty.setraw(slave)
    loop = Loop()
    loop.watch(slave, HANGUP)
    os.write(master, b"telemetry")
    assert loop.wait(5_000_000) == {}
    os.close(master)
    assert loop.wait(LATER_NS)[slave] & GONE
    loop.forget(slave)
    os.close(slave)


@pytest.mark.parametrize(("timers", "waited_ns"), [((), 5), ((3, 4), 3), ((NEVER, 6), 5), ((0,), 0), ((-1,), 0)])
def test_the_loop_waits_for_the_first_timer_or_the_longest_time(timers: tuple[int, ...], waited_ns: int) -> None:
    machine = PortMachine()
    loop, begun_ns = machine.load("failstop.procs.loop").Loop(), machine.clock()
    due_ns = [min(NEVER, begun_ns + ns) for ns in timers]
    for ns in due_ns:
        loop.timer().set(ns)
    assert loop.wait(5) == {}
    assert machine.clock() - begun_ns == waited_ns
    assert loop.due_ns() == min(due_ns, default=NEVER)


def test_a_timer_is_due_from_its_time_on_and_takes_one_time_after_the_other() -> None:
    timer = Timer()
    assert (timer.ns, timer.due(NEVER - 1)) == (NEVER, False)
    timer.set(10)
    assert [timer.due(ns) for ns in (9, 10, 11)] == [False, True, True]
    assert [timer.pop(ns) for ns in (9, 10, 10)] == [False, True, False]
    assert timer.ns == NEVER
    timer.set(10, 20, 30)
    assert [timer.pop(ns) for ns in (10, 19, 35, 35, 35)] == [True, False, True, True, False]
    timer.set(10, 20)
    timer.set(15)
    assert timer.pop(15)
    assert timer.ns == NEVER, "what was set before is forgotten"
