"""Lifelines: a death is seen through the same poll as everything else, by its pidfd and by its futex."""

from __future__ import annotations

import _thread
import contextlib
import errno
import os
import select
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from failstop.api.held import HeldByThread
from failstop.shm import futex, segment
from failstop.shm.futex import BLOCKS, PER_BLOCK, Futex
from failstop.shm.lifeline import EarlyNews, Lifeline, pid_namespace
from failstop.shm.segment import Segment
from failstop.shm.words import LINE_BYTES
from tests.support.children import NOBODY, Child, become, needs_root, scheduled
from tests.support.waiting import until

Send = Callable[[object], None]
Wait = Callable[[], None]


def waiting(send: Send, wait: Wait) -> None:
    send("here")
    wait()


def realtime_nobody(send: Send, wait: Wait) -> None:
    os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(5))  # as procs/rights.py does
    become(NOBODY)
    send("here")
    wait()


@needs_root
def test_the_dying_are_demoted_without_any_capability() -> None:
    """As under the systemd unit: the rights come from a limit, and nobody has CAP_SYS_NICE."""
    with Child(realtime_nobody) as dying:
        assert dying.receive() == "here"

        def demote(send: Send, _wait: Wait) -> None:
            Lifeline(dying.pid).demote()
            send(os.sched_getscheduler(dying.pid) & ~os.SCHED_RESET_ON_FORK)

        with Child(demote, uid=NOBODY) as other:
            assert other.receive() == os.SCHED_OTHER


def test_a_thread_that_ends_first_leaves_no_other_one_its_rights(monkeypatch: pytest.MonkeyPatch) -> None:
    """Between the look at the threads and the call."""
    asked: list[int] = []

    def setscheduler(thread: int, policy: int, parameter: os.sched_param) -> None:
        asked.append(thread)
        if len(asked) == 1:
            raise ProcessLookupError(errno.ESRCH, os.strerror(errno.ESRCH))

    monkeypatch.setattr(os, "sched_setscheduler", setscheduler)
    over = threading.Event()
    others = [threading.Thread(target=over.wait) for _ in range(2)]
    for each in others:
        each.start()
    life = Lifeline(os.getpid())
    life.demote()
    over.set()
    for each in others:
        each.join()
    life.close()
    assert {threading.get_native_id(), *(each.native_id for each in others)} <= set(asked)


def test_sigkill_is_seen_through_epoll() -> None:
    slowest_s = 0.0
    for _ in range(20):
        with Child(waiting) as child:
            assert child.receive() == "here"
            life = Lifeline(child.pid)
            poll = select.epoll()
            poll.register(life.fd, select.EPOLLIN)
            assert poll.poll(0) == []
            assert not life.dead()
            before = time.monotonic()
            os.kill(child.pid, signal.SIGKILL)
            events = poll.poll(2)
            slowest_s = max(slowest_s, time.monotonic() - before)
            assert [fd for fd, _ in events] == [life.fd]
            assert life.dead()
            poll.close()
            life.close()
    assert slowest_s < 2


@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGTERM, signal.SIGSEGV, 0])
def test_every_kind_of_end_is_a_death(end: int) -> None:
    with Child(waiting) as child:
        assert child.receive() == "here"
        life = Lifeline(child.pid)
        assert not life.dead()
        if end:
            os.kill(child.pid, end)
        else:
            child.go()
        until(life.dead, "seen dead")
        child.wait()
        assert life.dead(), "still dead once it was reaped"
        life.close()


def test_to_ask_whether_it_has_died_waits_for_nothing() -> None:
    life = Lifeline(os.getpid())
    before = time.monotonic()
    assert not any(life.dead() for _ in range(5))
    assert time.monotonic() - before < 5
    life.close()


def test_an_end_is_waited_for_as_long_as_told() -> None:
    with Child(waiting) as child:
        assert child.receive() == "here"
        life = Lifeline(child.pid)
        before = time.monotonic()
        assert not life.wait(0.05)
        assert 0.05 <= time.monotonic() - before < 20
        life.kill()
        assert life.wait(20)
        assert child.wait() == -signal.SIGKILL
        life.kill()  # nobody is left, and nobody else is meant
        life.close()


def test_a_stopped_process_is_not_dead() -> None:
    with Child(waiting) as child:
        assert child.receive() == "here"
        life = Lifeline(child.pid)
        os.kill(child.pid, signal.SIGSTOP)
        os.waitid(os.P_PID, child.pid, os.WSTOPPED)
        assert not life.dead()
        os.kill(child.pid, signal.SIGKILL)
        until(life.dead, "seen dead")
        life.close()


def test_one_that_was_dead_before_and_not_reaped() -> None:
    with Child(lambda send, wait: None) as child:
        child.receive()
        os.waitid(os.P_PID, child.pid, os.WEXITED | os.WNOWAIT)
        life = Lifeline(child.pid)
        assert life.dead()
        life.close()


def test_one_whose_number_is_not_known_here_has_the_early_news_alone() -> None:
    life = Lifeline()
    assert life.pid == 0
    assert not os.get_inheritable(life.fd)
    assert not life.dead()
    life.marked = True
    assert life.dead()
    life.close()


def test_no_such_process() -> None:
    with Child(lambda send, wait: None) as child:
        child.result()
        with pytest.raises(ProcessLookupError):
            Lifeline(child.pid)


def test_it_watches_the_process_and_not_the_number() -> None:
    """Reaped, so that its pid may be given to another: the lifeline stays that of the dead one."""
    with Child(waiting) as child:
        assert child.receive() == "here"
        life = Lifeline(child.pid)
        child.kill()
        assert life.dead()
        with pytest.raises(ProcessLookupError):
            signal.pidfd_send_signal(life.fd, 0)
        life.close()


def namespace_told(*command: str) -> int:
    """What a Python that is started by this command finds."""
    code = "from failstop.shm.lifeline import pid_namespace; print(pid_namespace())"
    done = subprocess.run([*command, sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    if command and done.returncode:
        pytest.skip(f"{command[0]} can't: {done.stderr.strip()}")
    return int(done.stdout)


def test_processes_of_one_namespace_find_the_same() -> None:
    assert namespace_told() == pid_namespace() != 0


@pytest.mark.skipif(shutil.which("unshare") is None, reason="needs unshare")
def test_in_a_container_of_its_own_a_process_finds_another() -> None:
    assert namespace_told("unshare", "--pid", "--fork") not in (0, pid_namespace())


def test_without_proc_it_is_not_known(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(path: str) -> os.stat_result:
        raise FileNotFoundError(path)

    monkeypatch.setattr(os, "stat", missing)
    assert pid_namespace() == 0


def test_a_process_that_is_no_child_of_the_watcher() -> None:
    with Child(waiting) as watched:
        assert watched.receive() == "here"

        def work(send: Send, wait: Wait) -> bool:
            life = Lifeline(watched.pid)
            send(life.dead())
            return bool(select.select([life.fd], [], [], 20)[0]) and life.dead()

        with Child(work) as watcher:
            assert watcher.receive() is False
            watched.kill()
            assert watcher.result() is True


def test_a_forked_grandchild_does_not_hold_the_death_back() -> None:
    """As an inherited pipe end would."""

    def work(send: Send, wait: Wait) -> None:
        pid = os.fork()
        if pid:
            send(pid)
        wait()
        os._exit(0)

    with Child(work) as child:
        grandchild = child.receive()
        life = Lifeline(child.pid)
        other = Lifeline(grandchild)
        os.kill(child.pid, signal.SIGKILL)
        until(life.dead, "seen dead")
        assert not other.dead()
        os.kill(grandchild, signal.SIGKILL)
        until(other.dead, "grandchild gone")
        life.close()
        other.close()


def test_the_descriptor_is_not_inherited_and_close_is_idempotent() -> None:
    life = Lifeline(os.getpid())
    assert not os.get_inheritable(life.fd)
    assert not life.dead()
    fd = life.fd
    life.close()
    life.close()
    assert life.fd == -1
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(fd)


RUN = 9


def lifelines(instance: str) -> Segment:
    return segment.attach(instance, "lifelines", RUN, write=True)


def holding(instance: str, block: int) -> Child:
    """A process that holds its block for life, as every process of the service does."""

    def work(send: Send, wait: Wait) -> None:
        kept = lifelines(instance).futex("held", block * PER_BLOCK, write=True).hold(PER_BLOCK)
        send("held" if kept else "the kernel can't")
        wait()

    child = Child(work)
    assert child.receive() == "held"
    return child


def watching(instance: str, pid: int, block: int, watcher: int) -> Child:
    """A process that waits for a death by the futex alone; sends "armed", then what it learnt."""

    def work(send: Send, wait: Wait) -> tuple[bool, bool, bool]:
        life = Lifeline(pid)
        news = EarlyNews(lifelines(instance))
        news.arm(life, block, watcher)
        send("armed")
        rung = bool(select.select([news.bell.fd], [], [], 10)[0])
        return rung, life.marked, life.died({})

    child = Child(work)
    assert child.receive() == "armed"
    return child


@pytest.fixture
def held(name: str) -> Segment:
    """The lines of every block, as one of the service's processes sees them."""
    segment.create(name, "lifelines", RUN).close()
    return lifelines(name)


@pytest.mark.parametrize("block", [0, 1, BLOCKS - 1])
def test_every_watcher_gets_the_early_news(name: str, held: Segment, block: int) -> None:
    """Through the futex and the bell: the pidfd is not even polled. A block is used again, the last holder's mark in
    it."""
    for _ in range(5):
        with holding(name, block) as holder:
            watchers = [watching(name, holder.pid, block, index) for index in range(PER_BLOCK)]
            try:
                os.kill(holder.pid, signal.SIGKILL)
                assert [watcher.result() for watcher in watchers] == [(True, True, True)] * PER_BLOCK
            finally:
                for watcher in watchers:
                    watcher.close()


def threads() -> set[int]:
    """Those of this process."""
    return {int(thread) for thread in os.listdir("/proc/self/task")}


def test_the_news_comes_by_one_thread_for_each_lifeline(name: str, held: Segment) -> None:
    """In the process that holds the lifeline, as the port owner does, however often it is armed."""
    for index in range(PER_BLOCK):
        news = EarlyNews(held)
        before = threads()
        with holding(name, 2) as holder:
            life = Lifeline(holder.pid)
            for _ in range(3):
                news.arm(life, 2, index)
            assert len(threads() - before) == 1
            assert not life.died({})
            os.kill(holder.pid, signal.SIGKILL)
            assert select.select([news.bell.fd], [], [], 20)[0]
            assert life.marked
            assert life.died({})
            assert life.dead()
            life.close()
        os.close(news.bell.fd)


def test_who_asks_knows_of_a_death_that_its_thread_has_not_told_yet(name: str, held: Segment) -> None:
    with holding(name, 3) as holder:
        life = Lifeline()
        life.early = held.futex("held", 3 * PER_BLOCK)
        assert not life.dead()
        holder.kill()
        assert not life.marked
        assert life.dead()
        life.early.close()
        life.close()


def test_a_waiting_thread_takes_the_scheduling_of_before_and_not_that_of_its_starter(name: str, held: Segment) -> None:
    """A process that has real-time rights hands none of them on to a thread that it starts."""
    news = EarlyNews(held)
    with holding(name, 2) as holder:
        life = Lifeline(holder.pid)
        before = threads()
        with scheduled(os.SCHED_BATCH):
            news.arm(life, 2, 0)
        (thread,) = threads() - before
        until(lambda: os.sched_getscheduler(thread) == os.SCHED_OTHER, "its own scheduling")
        os.kill(holder.pid, signal.SIGKILL)
        assert select.select([news.bell.fd], [], [], 20)[0]
        life.close()
    os.close(news.bell.fd)


@needs_root
@pytest.mark.parametrize(
    ("own", "dying", "found"), [(5, 6, 7), (6, 6, 7), (7, 6, 7), (8, 6, 8), (1, 6, 7), (0, 6, 0), (5, 0, 5)]
)
def test_a_waiting_thread_runs_above_the_dying_where_its_process_has_such_rights(
    name: str, held: Segment, own: int, dying: int, found: int
) -> None:
    with scheduled(os.SCHED_FIFO if own else os.SCHED_OTHER, own):
        news = EarlyNews(held)
    with holding(name, 2) as holder:
        life = Lifeline(holder.pid)
        before = threads()
        news.arm(life, 2, 0, lambda: None, dying)
        (thread,) = threads() - before
        until(lambda: os.sched_getparam(thread).sched_priority == found, "its own priority")
        os.kill(holder.pid, signal.SIGKILL)
        assert select.select([news.bell.fd], [], [], 20)[0]
        life.close()
    os.close(news.bell.fd)


@needs_root
@pytest.mark.parametrize("of_a_service", [True, False])
def test_above_one_that_has_no_priority_no_thread_has_to_run(name: str, held: Segment, of_a_service: bool) -> None:
    with scheduled(os.SCHED_FIFO, 1):
        news = EarlyNews(held)
    found: list[int] = []

    def stop() -> None:
        found.append(os.sched_getparam(0).sched_priority)

    with holding(name, 2) as holder:
        life = Lifeline(holder.pid)
        if of_a_service:
            news.arm(life, 2, 0, stop)
        else:
            news.watch(life, held, 2 * PER_BLOCK, stop)
        os.kill(holder.pid, signal.SIGKILL)
        assert select.select([news.bell.fd], [], [], 20)[0]
        assert found == [1]
        life.close()
    os.close(news.bell.fd)


@needs_root
def test_real_time_rights_are_remembered_for_the_threads(held: Segment) -> None:
    with scheduled(os.SCHED_FIFO, 5):
        news = EarlyNews(held)
    assert news._policy == (os.SCHED_FIFO, os.sched_param(5))
    os.close(news.bell.fd)


def test_no_news_while_the_holder_lives(name: str, held: Segment) -> None:
    with holding(name, 3) as holder, watching(name, holder.pid, 3, 0) as watcher:
        other = Lifeline(watcher.pid)
        os.kill(holder.pid, signal.SIGSTOP)
        os.waitid(os.P_PID, holder.pid, os.WSTOPPED)
        assert not select.select([other.fd], [], [], 0.1)[0], "a stopped holder is no dead one"
        os.kill(holder.pid, signal.SIGKILL)
        assert watcher.result() == (True, True, True)
        other.close()


def test_what_nobody_holds_is_no_death(held: Segment) -> None:
    for line in range(PER_BLOCK):
        assert held.futex("held", line).wait_for_death() is False


def test_the_mark_stays_for_who_comes_late(name: str, held: Segment) -> None:
    with holding(name, 5) as holder:
        holder.kill()
        assert held.futex("held", 5 * PER_BLOCK).wait_for_death() is True
        assert held.futex("held", 5 * PER_BLOCK).wait_for_death() is True


def test_the_death_of_a_watcher_costs_the_next_one_nothing(name: str, held: Segment) -> None:
    with holding(name, 6) as holder:
        for _ in range(3):
            with watching(name, holder.pid, 6, 0) as first:
                first.kill()
        with watching(name, holder.pid, 6, 0) as last:
            os.kill(holder.pid, signal.SIGKILL)
            assert last.result() == (True, True, True)


def test_blocks_do_not_touch_each_other(name: str, held: Segment) -> None:
    with holding(name, 0), holding(name, 2), holding(name, 1) as holder:
        holder.kill()
        assert held.futex("held", PER_BLOCK).wait_for_death() is True
        with watching(name, os.getpid(), 0, 0) as watcher:
            other = Lifeline(watcher.pid)
            assert not select.select([other.fd], [], [], 0.05)[0]
            other.close()


@pytest.mark.parametrize("line", [-1, BLOCKS * PER_BLOCK])
def test_there_is_no_line_beyond_the_record(held: Segment, line: int) -> None:
    with pytest.raises(IndexError, match=rf"held has {BLOCKS * PER_BLOCK} lines, none is {line}$"):
        held.futex("held", line)


def test_the_pidfd_alone_is_enough(held: Segment) -> None:
    """The early news never comes where the futex was not held: the late word is there all the same."""
    news = EarlyNews(held)
    threads = _thread._count()
    with Child(waiting) as child:
        assert child.receive() == "here"
        life = Lifeline(child.pid)
        news.arm(life, 7, 0)
        os.kill(child.pid, signal.SIGKILL)
        ready = dict(select_poll(life.fd))
        until(lambda: _thread._count() == threads, "the waiting thread has given up")
        assert life.died(ready)
        assert not life.marked
        assert life.dead()
        life.close()
    os.close(news.bell.fd)


def test_a_lifeline_that_is_closed_keeps_no_thread(name: str, held: Segment) -> None:
    news = EarlyNews(held)
    threads = _thread._count()
    before = set(os.listdir("/proc/self/task"))
    with holding(name, 8) as holder:
        life = Lifeline(holder.pid)
        news.arm(life, 8, 0)
        until(lambda: waits_on_a_futex(set(os.listdir("/proc/self/task")) - before), "the thread waits")
        life.close()
        until(lambda: _thread._count() == threads, "the waiting thread has given up")
    assert not life.marked
    os.close(news.bell.fd)


def waits_on_a_futex(threads: set[str]) -> bool:
    """True once the one thread sleeps in futex(2)."""
    calls = [Path(f"/proc/self/task/{tid}/syscall").read_text().split()[0] for tid in threads]
    return calls == [str(futex._FUTEX)]


def test_a_thread_of_its_own_holds_and_lets_go(held: Segment) -> None:
    """Held by a thread that ends before the process does; and given back by another one than took it."""
    word = held.futex("held", 20)
    threads = _thread._count()
    one = HeldByThread(held.futex("held", 20, write=True))
    assert word.held()
    assert not held.futex("held", 21).held(), "one line alone"
    assert _thread._count() == threads + 1
    one.let_go()
    until(lambda: _thread._count() == threads, "its thread has ended")
    assert word.held(), "the word is the caller's to clear: the end of the thread is no death"


class Interrupted(Exception):
    """What a signal's handler of a program raises."""


@contextlib.contextmanager
def raising_at_alarm() -> Iterator[threading.Event]:
    """The handler of SIGALRM raises, the first time that it comes; the event is then set."""
    raised = threading.Event()

    def handler(*_: object) -> None:
        if not raised.is_set():
            raised.set()
            raise Interrupted

    before = signal.signal(signal.SIGALRM, handler)
    try:
        yield raised
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def test_an_exception_of_a_signal_s_handler_leaves_no_thread(held: Segment) -> None:
    """It comes while the thread has begun and does not hold the word yet; then the caller gives the file back."""
    threads, descriptors = _thread._count(), len(os.listdir("/proc/self/fd"))
    may_hold = threading.Event()
    with raising_at_alarm() as raised:

        class Slow(Futex):
            """One that takes its time."""

            def hold(self, lines: int = 1) -> object:
                while not raised.wait(0.001):  # a signal that comes just before a wait for a lock does not end that
                    os.kill(os.getpid(), signal.SIGALRM)
                assert may_hold.wait(20.0)
                return super().hold(lines)

        word = Slow(held.fileno(), held.spec.offsets["held"] + 40 * LINE_BYTES, write=True)
        with pytest.raises(Interrupted):
            HeldByThread(word)
    assert _thread._count() == threads + 1, "its thread has begun"
    held.close()
    with open(os.devnull) as other:  # the file that has the number now
        assert other.fileno() >= 0
        may_hold.set()
        until(lambda: _thread._count() == threads, "its thread has ended")
    assert len(os.listdir("/proc/self/fd")) == descriptors - 1, "the caller's"


def test_the_thread_of_what_nobody_refers_to_ends(held: Segment) -> None:
    """As where the exception comes when it is made, and nobody has it yet."""
    threads = _thread._count()
    one = HeldByThread(held.futex("held", 41, write=True))
    assert _thread._count() == threads + 1
    del one
    until(lambda: _thread._count() == threads, "its thread has ended")


def test_whatever_moment_the_exception_comes_at_no_thread_is_left(held: Segment) -> None:
    threads = _thread._count()
    interrupted = 0
    for number in range(200):
        word = held.futex("held", 42, write=True)
        with raising_at_alarm():
            try:
                signal.setitimer(signal.ITIMER_REAL, 5e-6 + number * 2e-6)
                HeldByThread(word).let_go()
                signal.setitimer(signal.ITIMER_REAL, 0.0)
            except Interrupted:
                interrupted += 1
    assert interrupted
    until(lambda: _thread._count() == threads, "every thread has ended")


@pytest.mark.parametrize("may", [True, False])
def test_that_thread_dies_first_where_the_process_may_have_it_so(
    held: Segment, monkeypatch: pytest.MonkeyPatch, may: bool
) -> None:
    asked: list[tuple[int, int, int]] = []

    def setscheduler(pid: int, policy: int, parameter: os.sched_param) -> None:
        asked.append((pid, policy, parameter.sched_priority))
        if not may:
            raise PermissionError(errno.EPERM, os.strerror(errno.EPERM))

    monkeypatch.setattr(os, "sched_setscheduler", setscheduler)
    word = held.futex("held", 25)
    one = HeldByThread(held.futex("held", 25, write=True))
    assert asked == [(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, 1)]
    assert word.held()
    one.let_go()


def test_the_end_of_a_thread_is_told_on_each_of_its_lines_and_on_no_other(held: Segment) -> None:
    first = (BLOCKS - 2) * PER_BLOCK  # not in the file's first page
    word = held.futex("held", first, write=True)
    kept: list[object] = []
    thread = threading.Thread(target=lambda: kept.append(word.hold(PER_BLOCK)))
    thread.start()
    thread.join()
    lines = [held.futex("held", line) for line in range(first - 1, first + PER_BLOCK + 1)]
    until(lambda: not any(line.held() for line in lines), "the kernel has marked them")
    assert [line.wait_for_death() for line in lines] == [False, *[True] * PER_BLOCK, False]
    assert kept != [None]


def test_a_futex_is_mapped_until_it_is_closed_and_for_writing_only_by_who_holds_it(name: str, held: Segment) -> None:
    def mapped() -> list[str]:
        maps = Path("/proc/self/maps").read_text().splitlines()
        return [line.split()[1] for line in maps if line.endswith(segment.path_of(name, "lifelines"))]

    watching, holding = held.futex("held"), held.futex("held", write=True)
    assert sorted(mapped()) == ["r--s", "rw-s"]
    holding.close()
    assert mapped() == ["r--s"]
    watching.close()
    assert mapped() == []


def test_what_can_not_be_mapped_is_an_error(name: str, held: Segment) -> None:
    with open(segment.path_of(name, "lifelines"), "rb") as file:
        Futex(file.fileno(), 0, write=False).close()
        with pytest.raises(PermissionError, match="a futex can't be mapped"):
            Futex(file.fileno(), 0, write=True)


def test_without_a_number_the_first_line_is_meant(held: Segment) -> None:
    one = HeldByThread(held.futex("held", 0, write=True))
    assert held.futex("held").held()
    one.let_go()


def test_a_file_that_was_closed_meanwhile_holds_nothing(held: Segment) -> None:
    one = HeldByThread(held.futex("held", 0, write=True))
    word = held.futex("held", 0)
    held.close()
    assert not word.held()
    assert word.wait_for_death() is False
    one.let_go()


class Meanwhile:
    """The kernel's part, before which something happens once."""

    def __init__(self, happens: Callable[[], object]) -> None:
        self.happens: Callable[[], object] | None = happens
        self.real = futex._libc

    def syscall(self, *arguments: object) -> int:
        happens, self.happens = self.happens, None
        if happens:
            happens()
        failed: int = self.real.syscall(*arguments)
        return failed


def test_a_death_between_the_look_and_the_wait_is_seen(held: Segment, monkeypatch: pytest.MonkeyPatch) -> None:
    one = HeldByThread(held.futex("held", 0, write=True))
    word = held.futex("held", 0)
    mark = (word._value() | futex._OWNER_DIED).to_bytes(4, "little")
    with monkeypatch.context() as patched:
        patched.setattr(futex, "_libc", Meanwhile(lambda: os.pwrite(held.fileno(), mark, word._offset)))
        assert word.wait_for_death() is True
    one.let_go()


def test_a_file_that_is_cut_before_the_wait_is_nobody_s_death(
    name: str, held: Segment, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = HeldByThread(held.futex("held", 0, write=True))
    word = held.futex("held", 0)
    with monkeypatch.context() as patched:
        patched.setattr(futex, "_libc", Meanwhile(lambda: os.truncate(segment.path_of(name, "lifelines"), 0)))
        assert word.wait_for_death() is False
    one.let_go()


class Waiter(threading.Thread):
    """One that waits for a death, as long as it is wanted."""

    def __init__(self, word: Futex) -> None:
        super().__init__(daemon=True)
        self.word = word
        self.wanted = True
        self.told: bool | None = None
        self.start()
        until(self.asleep, "its sleep")

    def run(self) -> None:
        self.told = self.word.wait_for_death(lambda: self.wanted)

    def asleep(self) -> bool:
        """In the kernel, at this word."""
        with open(f"/proc/self/task/{self.native_id}/syscall", encoding="ascii") as file:
            return f"{self.word._address:#x}" in file.read().split()


def test_one_that_has_missed_its_call_takes_the_news_from_nobody(name: str, held: Segment) -> None:
    """The kernel wakes one alone, who has waited for longest."""
    with holding(name, 5) as holder:
        left = Waiter(held.futex("held", 5 * PER_BLOCK))
        left.wanted = False
        other = Waiter(held.futex("held", 5 * PER_BLOCK))
        holder.kill()
        until(lambda: not other.is_alive(), "the news")
        assert other.told is True
        until(lambda: not left.is_alive(), "its end")
        assert left.told is False


def test_who_waits_sleeps(held: Segment) -> None:
    one = HeldByThread(held.futex("held", 0, write=True))
    word, until_ns = held.futex("held", 0), time.monotonic_ns() + 200_000_000
    thread = threading.Thread(target=word.wait_for_death, args=(lambda: time.monotonic_ns() < until_ns,))
    thread.start()
    clock = time.pthread_getcpuclockid(thread.ident)  # type: ignore[arg-type]
    before_s = time.clock_gettime(clock)
    until(lambda: time.monotonic_ns() >= until_ns, "the time to have passed")
    assert time.clock_gettime(clock) - before_s < 0.01
    until(lambda: word.wake() or not thread.is_alive(), "its end")
    thread.join()
    one.let_go()


def test_the_line_that_a_client_holds_is_the_first_where_none_is_named(name: str, held: Segment) -> None:
    """By one line alone; the pidfd is that of this process, which lives."""

    def work(send: Send, wait: Wait) -> None:
        kept = lifelines(name).futex("held", write=True).hold()
        send("held" if kept else "the kernel can't")
        wait()

    news = EarlyNews(held)
    with Child(work) as holder:
        assert holder.receive() == "held"
        life = Lifeline(os.getpid())
        news.watch(life, held)
        holder.kill()
        assert select.select([news.bell.fd], [], [], 20)[0]
        assert life.marked
        life.close()
    os.close(news.bell.fd)


@pytest.mark.parametrize("lacks", ["threads", "memory"])
def test_a_machine_that_is_out_of_something_still_has_the_late_news(
    held: Segment, monkeypatch: pytest.MonkeyPatch, lacks: str
) -> None:
    def no_thread(*_: object) -> int:
        raise RuntimeError("can't start new thread")

    def no_memory(*_: object) -> int:
        raise OSError(errno.ENOMEM, os.strerror(errno.ENOMEM))

    news = EarlyNews(held)
    with Child(waiting) as child:
        assert child.receive() == "here"
        life = Lifeline(child.pid)
        with monkeypatch.context() as patched:
            if lacks == "threads":
                patched.setattr(_thread, "start_new_thread", no_thread)
            else:
                patched.setattr(Segment, "futex", no_memory)
            news.arm(life, 7, 0)
        os.kill(child.pid, signal.SIGKILL)
        assert life.died(dict(select_poll(life.fd)))
        assert not life.marked
        life.close()
    os.close(news.bell.fd)


def test_a_large_process_is_known_to_be_dead_before_its_memory_is_gone(name: str, held: Segment) -> None:
    """Which the pidfd waits for. This process may be held up longer than that takes: then it tries again."""

    def large(send: Send, wait: Wait) -> None:
        memory = bytearray(os.urandom(1 << 20)) * 200
        one = HeldByThread(lifelines(name).futex("held", 30, write=True))
        send("here")
        wait()
        del one, memory

    first = False
    for _ in range(10):
        with Child(large) as child:
            assert child.receive() == "here"
            life = Lifeline(child.pid)
            word = held.futex("held", 30)
            os.kill(child.pid, signal.SIGKILL)
            assert word.wait_for_death()
            first = first or not life.dead()
            life.close()
        if first:
            return
    pytest.fail("the pidfd came first ten times")


def test_a_truncated_file_is_nobody_s_death(name: str, held: Segment) -> None:
    """And no SIGBUS: a client may cut its own slot."""
    word = held.futex("held", 40)
    with holding(name, 20):
        os.truncate(segment.path_of(name, "lifelines"), 0)
        assert word.wait_for_death() is False
        assert not word.held()


def test_where_the_kernel_can_t_nothing_is_held(held: Segment, monkeypatch: pytest.MonkeyPatch) -> None:
    """As under qemu's user mode, which has no robust lists."""
    monkeypatch.setattr(futex, "_SET_ROBUST_LIST", -1)
    word = held.futex("held", 50, write=True)
    assert word.hold() is None
    assert not word.held()


def test_this_kernel_is_proven() -> None:
    assert futex.proven()


def test_a_kernel_that_tells_of_the_end_a_while_later_is_proven_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """The thread ends only after the third look."""
    looks: list[bool] = []
    end = threading.Event()
    hold, told = futex._hold_until_the_end, Futex.told

    def late(word: Futex, kept: list[object]) -> None:
        hold(word, kept)
        end.wait()

    def look(word: Futex) -> bool:
        looks.append(told(word))
        if len(looks) == 3:
            end.set()
        return looks[-1]

    monkeypatch.setattr(futex, "_hold_until_the_end", late)
    monkeypatch.setattr(Futex, "told", look)
    monkeypatch.setattr(futex, "_PROOF_NS", 20_000_000_000)
    proven = futex.proven()
    end.set()
    assert proven
    assert looks[:3] == [False] * 3


def test_a_kernel_that_takes_the_list_and_marks_nothing_is_not(monkeypatch: pytest.MonkeyPatch) -> None:
    """As gVisor's. The thread's own list stays what it was."""
    monkeypatch.setattr(futex, "_set_robust_list", lambda kept: 0)
    monkeypatch.setattr(futex, "_PROOF_NS", 20_000_000)
    assert not futex.proven()


def test_a_machine_without_a_thread_to_spare_proves_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object) -> int:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(_thread, "start_new_thread", refused)
    before = os.listdir("/proc/self/fd")
    assert not futex.proven()
    assert os.listdir("/proc/self/fd") == before


def test_nor_one_that_refuses(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(futex, "_SET_ROBUST_LIST", -1)
    assert not futex.proven()


def test_the_proof_is_over_when_its_thread_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """However late that runs: it would write to a descriptor that is somebody else's by then."""
    ran: list[object] = []
    hold, run = Futex.hold, threading.Event()

    def late(word: Futex) -> object:
        run.wait()
        ran.append(hold(word))
        return ran[0]

    monkeypatch.setattr(Futex, "hold", late)
    monkeypatch.setattr(futex, "_PROOF_NS", 0)
    timer = threading.Timer(0.05, run.set)
    timer.start()
    futex.proven()
    assert ran
    timer.join()


@pytest.fixture
def refused(held: Segment, monkeypatch: pytest.MonkeyPatch) -> Segment:
    """Its words can be read, and not written."""

    def pwrite(*_args: object) -> int:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(os, "pwrite", pwrite)
    return held


@pytest.mark.timeout(20)
def test_a_word_that_can_t_be_written_keeps_nobody_waiting(refused: Segment) -> None:
    """Neither who joins, nor who starts: both have the late news."""
    word = refused.futex("held", 60, write=True)
    threads = _thread._count()
    one = HeldByThread(word)
    one.let_go()
    until(lambda: _thread._count() == threads, "its thread has ended")
    assert not word.held()
    assert not futex.proven()


def test_nor_is_it_looked_into_later(refused: Segment, monkeypatch: pytest.MonkeyPatch) -> None:
    """What the kernel was given to look into is taken back before its memory is."""
    given: list[object] = []
    monkeypatch.setattr(futex, "_set_robust_list", lambda kept: given.append(kept) or 0)
    with pytest.raises(OSError, match=r"Input/output"):
        refused.futex("held", 70, write=True).hold()
    assert len(given) == 2
    assert given[1] is futex._NOTHING


def select_poll(fd: int) -> list[tuple[int, int]]:
    poll = select.poll()
    poll.register(fd, select.POLLIN)
    return poll.poll(2_000)


def test_a_futex_needs_the_file(held: Segment) -> None:
    held.close()
    with pytest.raises(TypeError, match="needs the file"):
        held.futex("held")
