"""Runs: which lives, which has died, and what a dead one has left."""

from __future__ import annotations

import errno
import fcntl
import os
import struct
from types import SimpleNamespace

import pytest

from failstop.messages import segments
from failstop.messages.layout import PROCESS_NAMES
from tests.support.children import NOBODY

from .segments import NAMES, RUN, create_all, path_of
from .simulated import kill, living, open_fds, put, refusing, user


def test_a_dead_run_is_one_s_own(on: SimpleNamespace) -> None:
    """Of what others have put there nothing is read, and nothing removed."""
    mine, other = on.segments.memory("r", RUN), on.segments.memory("r", RUN + 1)
    for run in (mine, other):
        for of in NAMES:
            on.segments.create(run, of, RUN).close()
    assert on.segments.dead_runs("r") == [mine, other]
    for of in NAMES:
        on.os.chown(path_of(other, of), NOBODY, -1)
    assert on.segments.dead_runs("r") == [mine]
    assert on.segments.open_all(other) == {}


def test_dead_runs_are_found_by_whatever_they_have_left_the_newest_last(on: SimpleNamespace) -> None:
    older, newer = on.segments.memory("r", RUN + 1), on.segments.memory("r", RUN)
    gone = path_of("r.gone", "gate")
    for strange in ("r.gate", "failstop.r.gate", "failstop.r.1234.unknown"):
        put(on, f"/dev/shm/{strange}")
    assert on.segments.dead_runs("r") == []
    put(on, gone)
    for run, client in ((older, 3), (newer, 0), (older, 1), (newer, 2)):
        on.segments.create(run, f"client.{client}", RUN).close()
    with refusing(on, "stat", FileNotFoundError(errno.ENOENT, "gone"), of=gone) as asked:
        assert on.segments.dead_runs("r") == [older, newer]
    assert asked


def test_what_is_left_of_a_run_is_opened_whatever_is_missing(on: SimpleNamespace) -> None:
    for of in PROCESS_NAMES[1:2] + PROCESS_NAMES[3:]:
        on.segments.create("r", of, RUN)
    assert list(on.segments.open_all("r")) == [PROCESS_NAMES[1], *PROCESS_NAMES[3:]]


def test_a_lock_that_can_not_be_asked_for_is_nobody_s(on: SimpleNamespace) -> None:
    on.segments.create("r", "supervisor", RUN)
    assert on.segments.living("r")
    before = open_fds(on)
    with refusing(on, "fcntl", errno.ENOLCK):
        assert not on.segments.living("r")
    assert open_fds(on) == before


def test_a_run_lives_as_long_as_its_supervisor(on: SimpleNamespace) -> None:
    run = on.segments.memory("r", RUN)
    assert not on.segments.living(run)
    supervisor = living(on, lambda: [on.segments.create(run, of, RUN) for of in NAMES])
    assert on.segments.living(run)
    assert on.segments.dead_runs("r") == []
    kill(on, supervisor)
    assert not on.segments.living(run)
    assert on.segments.dead_runs("r") == [run]


def test_every_user_can_ask_again_and_again_whether_an_owner_s_run_lives(on: SimpleNamespace) -> None:
    supervisor = living(on, lambda: on.segments.create("r", "supervisor", RUN))
    with user(on, NOBODY):
        with pytest.raises(on.segments.AttachError, match="is not the service's: "):
            on.segments.open_life("r", 1)
        life = on.segments.open_life("r", 0)
        for _ in range(2):
            assert on.segments.lives(life)
        kill(on, supervisor)
        assert not on.segments.lives(life)


def test_it_is_the_supervisor_s_segment_that_tells_so(on: SimpleNamespace) -> None:
    """Each is made and held by this process; its copies for other names are not asked."""
    made = {of: on.segments.create("r", of, RUN) for of in ("gate", "supervisor")}
    assert on.segments.living("r")
    made["supervisor"].close()
    assert not on.segments.living("r")
    on.os.rename(path_of("r", "gate"), path_of("r", "supervisor"))
    assert not on.segments.living("r"), "the gate's is not locked"


def test_who_may_only_read_it_can_not_make_a_dead_run_look_alive(name: str) -> None:
    """Everyone may read the supervisor's segment, and lock what they may read, for reading."""
    create_all(name)
    with open(path_of(name, "supervisor"), "rb") as file:
        fcntl.fcntl(file.fileno(), fcntl.F_OFD_SETLK, struct.pack("hhqqi4x", fcntl.F_RDLCK, os.SEEK_SET, 0, 0, 0))
        assert not segments.living(name)
