"""Limits of a mutant on the machine that `make mutants` runs on."""

from __future__ import annotations

import os
import select
import signal
from collections.abc import Callable

import pytest

from tests.mutation.alone import BROKEN, alone, possible
from tests.support.children import DEADLINE_S, call

needs_namespaces = pytest.mark.skipif(not possible(), reason="this user may not make a PID namespace")


def _raise() -> int:
    raise RuntimeError("as a mutant may")


@needs_namespaces
@pytest.mark.parametrize(
    ("work", "code"),
    [(lambda: 0, 0), (lambda: 33, 33), (lambda: os.kill(os.getpid(), signal.SIGTERM) or 0, 143), (_raise, BROKEN)],
)
def test_the_verdict_comes_out(work: Callable[[], int], code: int) -> None:
    assert call(lambda: alone(work)) == code


@needs_namespaces
def test_who_is_signalled_is_none_of_the_machine() -> None:
    """The first process of the namespace is not ended from within; all others there are the mutant's own."""

    def work() -> int:
        seen = {int(entry) for entry in os.listdir("/proc") if entry.isdigit()}
        if seen != {1, os.getpid()} or os.getppid() != 1 or os.getpgrp() != 1:
            return 1
        for number in set(signal.Signals) - {signal.SIGSTOP}:
            os.kill(1, number)
        return 7

    assert call(lambda: alone(work)) == 7


def test_without_a_namespace_it_has_a_session_of_its_own() -> None:
    assert call(lambda: alone(lambda: 7 if os.getsid(0) == os.getpid() else 1, separate=False)) == 7


@needs_namespaces
def test_nothing_outlives_the_mutant() -> None:
    reading, writing = os.pipe()

    def work() -> int:
        if os.fork() == 0:
            os.setsid()
            signal.pause()
        with open("/dev/shm/failstop.left", "w"):
            return 0

    assert call(lambda: alone(work)) == 0
    os.close(writing)
    assert select.select([reading], [], [], DEADLINE_S)[0], "all copies of the other end are closed"
    os.close(reading)
    assert not os.path.exists("/dev/shm/failstop.left")
