"""Lifelines: a death is seen through the same poll as everything else, whatever the process's end."""

from __future__ import annotations

import errno
import os
import shutil
import signal
import subprocess
import sys
from types import SimpleNamespace

import pytest

from failstop.shm.lifeline import Lifeline, pid_namespace
from tests.support.children import NOBODY, Child, become, needs_root
from tests.support.waiting import until

from .dying import Send, Wait, alive, waiting
from .simulated import refusing


def realtime_nobody(send: Send, wait: Wait) -> None:
    os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(5))  # as procs/rights.py does
    become(NOBODY)
    waiting(send, wait)


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


def test_a_thread_that_ends_first_leaves_no_other_one_its_rights(on: SimpleNamespace) -> None:
    dying = on.machine.process("dying", lambda process: on.machine.block())
    others = [on.machine.thread(dying, on.machine.block) for _ in range(2)]
    life = on.lifeline.Lifeline(dying.pid)
    with refusing(on, "sched_setscheduler", ProcessLookupError(errno.ESRCH, "no such thread"), of=dying.pid) as asked:
        life.demote()
    demoted = (os.SCHED_OTHER | os.SCHED_RESET_ON_FORK, 0)
    assert asked == [(dying.pid, *demoted)]
    assert [thread.scheduling for thread in others] == [demoted] * 2
    life.demote()
    assert dying.threads[0].scheduling == demoted
    on.machine.die(dying, -9)
    on.machine.run(lambda: dying.code is not None, 10**9)
    life.demote()  # nothing of it is left


@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGTERM, signal.SIGSEGV, 0])
def test_every_kind_of_end_is_a_death_and_a_stop_is_none(end: int) -> None:
    with alive() as (child, life):
        assert not life.dead()
        if end == signal.SIGKILL:
            os.kill(child.pid, signal.SIGSTOP)
            os.waitid(os.P_PID, child.pid, os.WSTOPPED)
            assert not life.dead()
        if end:
            os.kill(child.pid, end)
        else:
            child.go()
        until(life.dead, "seen dead")
        late = Lifeline(child.pid)
        assert late.dead(), "dead before it was watched, and not reaped"
        late.close()
        child.wait()
        assert life.dead(), "its pid may be given to another: the lifeline stays that of the dead one"
        for ask in (lambda: Lifeline(child.pid), lambda: signal.pidfd_send_signal(life.fd, 0)):
            with pytest.raises(ProcessLookupError):
                ask()


def test_to_ask_for_a_death_waits_for_nothing_and_a_wait_lasts_as_long_as_told(on: SimpleNamespace) -> None:
    machine = on.machine
    process = machine.process("waits", lambda process: machine.block())
    life, began_ns = on.lifeline.Lifeline(process.pid), machine.now_ns
    assert not life.dead()
    assert machine.now_ns == began_ns
    assert not life.wait(0.05)
    assert machine.now_ns == began_ns + 50_000_000
    life.kill()
    assert life.wait(20)
    assert machine.now_ns - began_ns < 60_000_000
    assert process.code == -signal.SIGKILL
    life.kill()  # nobody is left, and nobody else is meant


def test_one_whose_number_is_not_known_here_has_the_early_news_alone() -> None:
    life = Lifeline()
    assert life.pid == 0
    assert not os.get_inheritable(life.fd)
    assert not life.dead()
    life.marked = True
    assert life.dead()
    life.close()


def namespace_told(*command: str) -> int:
    """The namespace that a Python finds which is started by this command."""
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


def test_without_proc_it_is_not_known(on: SimpleNamespace) -> None:
    assert on.lifeline.pid_namespace() == 0


def test_the_descriptor_is_not_inherited_and_close_is_idempotent() -> None:
    life = Lifeline(os.getpid())
    assert not os.get_inheritable(life.fd)
    fd = life.fd
    for _ in range(2):
        life.close()
        assert life.fd == -1
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(fd)
