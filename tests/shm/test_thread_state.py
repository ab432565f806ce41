"""The kernel's state of the thread that beats."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from failstop.shm.thread_state import state_of
from tests.support.children import Child
from tests.support.waiting import until


def test_a_process_is_seen_as_it_is_whatever_its_name() -> None:
    def work(send: Callable[[object], None], wait: Callable[[], None]) -> None:
        Path("/proc/self/comm").write_text("a) R (\u00e4) Z 1")
        send("named")
        wait()

    with Child(work) as child:
        assert child.receive() == "named"
        until(lambda: state_of(child.pid) == "S", "it waits")
        child.go()
        until(lambda: state_of(child.pid) == "Z", "it has ended")
        child.wait()
        with pytest.raises(OSError, match="No such"):
            state_of(child.pid)


def test_a_thread_that_looks_at_itself_runs() -> None:
    assert state_of(os.getpid()) == "R"
