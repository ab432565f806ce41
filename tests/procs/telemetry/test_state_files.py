"""Files under the state directory: whole lines or none, and never a crash."""

from __future__ import annotations

import os
import resource
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from failstop.messages import layout
from failstop.procs.telemetry.state_files import MOST_JOBS, append_line
from tests.support.stage import Stage
from tests.support.telemetry_scene import FOLDER, S

HEADER = "a,b\n"
LOG = f"{FOLDER}/log.csv"


@pytest.fixture
def stage() -> Stage:
    return Stage(layout.TELEMETRY, open_port=False)


@pytest.fixture
def module(stage: Stage) -> Any:
    """state_files as a process of the machine has it."""
    return stage.load("failstop.procs.telemetry.state_files")


@pytest.fixture
def files(module: Any) -> Any:
    """Files in a directory that is not there yet."""
    return module.StateFiles(FOLDER)


@contextmanager
def longest(size: int) -> Iterator[None]:
    """No file may grow beyond that: how this machine's kernel itself refuses a write."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def refused(wanted: str, error: Exception) -> Callable[..., None]:
    """For a machine's at_seam: each call of this name raises."""

    def refuse(thread: object, call: str, about: object) -> None:
        if call == wanted:
            raise error

    return refuse


def test_a_new_file_starts_with_the_header_and_a_torn_line_spoils_no_other(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "er" / "log.csv"
    append_line(str(path), HEADER, "1,2\n")
    append_line(str(path), HEADER, "3,4\n")
    assert path.read_text() == "a,b\n1,2\n3,4\n"
    path.write_text("a,b\n1,")
    append_line(str(path), HEADER, "3,4\n")
    assert path.read_text() == "a,b\n1,\n3,4\n"


def test_a_line_that_the_disk_has_no_room_for_is_not_written(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    for before in (b"", b"a,b\n1,2\n"):
        with longest(len(before) + 2), pytest.raises(OSError, match="No space left"):
            append_line(str(path), HEADER, "3,4\n")
        assert path.read_bytes() == before
        append_line(str(path), HEADER, "1,2\n")


def test_a_planted_link_gets_no_line(tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    victim.write_text("precious\n")
    (tmp_path / "log.csv").symlink_to(victim)
    with pytest.raises(OSError, match="a link, not a regular file"):
        append_line(str(tmp_path / "log.csv"), HEADER, "3,4\n")
    assert victim.read_text() == "precious\n"


@pytest.mark.timeout(20)
def test_a_pipe_in_the_place_of_a_file_holds_nothing_up(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "log.csv")
    with pytest.raises(OSError, match="a FIFO, not a regular file"):
        append_line(str(tmp_path / "log.csv"), HEADER, "3,4\n")


def test_the_thread_writes_in_order(stage: Stage, files: Any) -> None:
    for i in range(20):
        files.append("log", "log.csv", HEADER, f"{i},0\n")
    stage.clock.now_ns += 1
    assert stage.read_text(LOG) == HEADER + "".join(f"{i},0\n" for i in range(20))
    assert files.notes() == []


def test_a_missing_directory_is_a_note_once_and_its_return_another(stage: Stage, files: Any) -> None:
    stage.write_text(FOLDER, "a file is in the way")
    for _ in range(3):
        files.append("battery log", "log.csv", HEADER, "1,2\n")
    stage.clock.now_ns += 1
    ((note, step),) = files.notes()
    assert note.startswith("battery log can't be written: ")
    assert step == f"look at the disk and at {FOLDER}"
    stage.os.unlink(FOLDER)
    for _ in range(2):
        files.append("battery log", "log.csv", HEADER, "3,4\n")
    stage.clock.now_ns += 1
    assert files.notes() == [("battery log is written again", "")]


def test_a_thread_that_can_t_start_is_a_note(stage: Stage, files: Any) -> None:
    stage.machine.at_seam = refused("thread", RuntimeError("can't start new thread"))
    for _ in range(2):
        files.append("log", "log.csv", HEADER, "1,2\n")
    assert len(files.notes()) == 1


def test_a_disk_that_hangs_holds_nothing_up(stage: Stage, files: Any) -> None:
    loop = stage.machine.current

    def hang(thread: object, call: str, about: object) -> None:
        if thread is not loop:
            stage.machine.block(stage.clock() + S)

    stage.machine.at_seam = hang
    files.append("log", "log.csv", HEADER, "the first\n")
    stage.clock.now_ns += 1
    began_ns = stage.clock()
    for _ in range(500):
        files.append("log", "log.csv", HEADER, "1,2\n")
    assert stage.clock() == began_ns
    stage.machine.at_seam = None
    stage.clock.now_ns += S
    assert stage.read_text(LOG) == HEADER + "the first\n" + "1,2\n" * MOST_JOBS
