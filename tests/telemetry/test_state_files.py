"""Files under the state directory: where they are, whole or not at all, and never a crash."""

from __future__ import annotations

import os
import resource
from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop.procs.telemetry import state_files
from failstop.procs.telemetry.state_files import StateFiles, append_line, state_directory, write_whole
from failstop.shm import root
from tests.support.waiting import until

HEADER = "a,b\n"


@pytest.fixture
def files(tmp_path: Path) -> Iterator[StateFiles]:
    """Files in a directory that is not there yet."""
    made = StateFiles(str(tmp_path / "state"))
    yield made
    made.close()
    until(lambda: not made.running, "the end of the thread")


@pytest.fixture
def base(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """In place of /var/lib/failstop."""
    monkeypatch.setenv(root.VARIABLE, str(tmp_path))
    (tmp_path / "var" / "lib").mkdir(parents=True)
    return tmp_path / "var" / "lib" / "failstop"


def test_what_is_configured_comes_first(base: Path) -> None:
    assert state_directory("robot", {"STATE_DIRECTORY": "/given"}, "/chosen") == "/chosen"


def test_then_systemd_s_first_state_directory(base: Path) -> None:
    base.mkdir()
    assert state_directory("robot", {"STATE_DIRECTORY": "/given:/other"}) == "/given"


def test_then_the_system_s_when_it_is_writable(base: Path) -> None:
    base.mkdir()
    assert state_directory("robot", {"XDG_STATE_HOME": "/home/x"}) == str(base / "robot")
    (base / "robot").mkdir()
    assert state_directory("robot", {"XDG_STATE_HOME": "/home/x"}) == str(base / "robot")


def test_then_the_user_s(base: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "/home/x")
    assert state_directory("robot", {"XDG_STATE_HOME": "/elsewhere"}) == "/elsewhere/failstop/robot"
    assert state_directory("robot", {}) == "/home/x/.local/state/failstop/robot"


def test_a_new_file_starts_with_the_header(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "er" / "log.csv"
    append_line(str(path), HEADER, "1,2\n")
    append_line(str(path), HEADER, "3,4\n")
    assert path.read_text() == "a,b\n1,2\n3,4\n"


def test_a_line_that_a_power_cut_tore_spoils_no_other(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("a,b\n1,")
    append_line(str(path), HEADER, "3,4\n")
    assert path.read_text() == "a,b\n1,\n3,4\n"


def test_a_line_that_does_not_fit_is_not_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "log.csv"
    path.write_text("a,b\n1,2\n")
    write = os.write
    monkeypatch.setattr(os, "write", lambda fd, data: write(fd, data[:2]))
    with pytest.raises(OSError, match="No space left"):
        append_line(str(path), HEADER, "3,4\n")
    monkeypatch.undo()
    assert path.read_text() == "a,b\n1,2\n"


def test_a_full_disk_is_an_os_error(tmp_path: Path) -> None:
    """The kernel's own word for it: the file may not grow beyond two bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2, before[1]))
    try:
        with pytest.raises(OSError, match="No space left"):
            append_line(str(tmp_path / "log.csv"), HEADER, "3,4\n")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert (tmp_path / "log.csv").read_bytes() == b""


def test_a_planted_link_gets_no_line(tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    victim.write_text("precious\n")
    (tmp_path / "log.csv").symlink_to(victim)
    with pytest.raises(OSError, match="a link, not a regular file"):
        append_line(str(tmp_path / "log.csv"), HEADER, "3,4\n")
    assert victim.read_text() == "precious\n"


def test_replaced_whole(tmp_path: Path) -> None:
    path = tmp_path / "new" / "charger"
    write_whole(str(path), "plugged\n")
    write_whole(str(path), "unplugged\n")
    assert path.read_text() == "unplugged\n"
    assert os.listdir(path.parent) == ["charger"]


@pytest.mark.parametrize("step", ["fsync", "rename"])
def test_whatever_fails_the_old_content_is_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str) -> None:
    path = tmp_path / "charger"
    path.write_text("plugged\n")

    def fail(*_: object) -> int:
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(os, step, fail)
    with pytest.raises(OSError, match="Input/output error"):
        write_whole(str(path), "unplugged\n")
    monkeypatch.undo()
    assert path.read_text() == "plugged\n"
    assert os.listdir(tmp_path) == ["charger"]


def test_a_disk_that_is_full_within_a_file_leaves_the_old_one(tmp_path: Path) -> None:
    path = tmp_path / "charger"
    path.write_text("plugged\n")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4, before[1]))
    try:
        with pytest.raises(OSError, match="File too large"):
            write_whole(str(path), "unplugged\n")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert path.read_text() == "plugged\n"
    assert os.listdir(tmp_path) == ["charger"]


def test_it_is_on_the_disk_before_it_has_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[str] = []
    real_fsync, real_rename = os.fsync, os.rename

    def fsync(fd: int) -> None:
        done.append(os.readlink(f"/proc/self/fd/{fd}"))
        real_fsync(fd)

    def rename(old: str, new: str) -> None:
        done.append("rename")
        real_rename(old, new)

    monkeypatch.setattr(os, "fsync", fsync)
    monkeypatch.setattr(os, "rename", rename)
    write_whole(str(tmp_path / "charger"), "plugged\n")
    assert done == [str(tmp_path / "charger.new"), "rename", str(tmp_path)]


def test_the_thread_writes_in_order(files: StateFiles, tmp_path: Path) -> None:
    for i in range(20):
        files.append("log", "log.csv", HEADER, f"{i},0\n")
    files.replace("charger state", "charger", "plugged\n")
    until(lambda: (tmp_path / "state" / "charger").exists(), "the last job")
    assert (tmp_path / "state" / "log.csv").read_text() == HEADER + "".join(f"{i},0\n" for i in range(20))
    assert files.read("charger state", "charger") == "plugged\n"
    assert files.notes() == []


def test_a_missing_directory_is_a_note_once_and_its_return_another(files: StateFiles, tmp_path: Path) -> None:
    (tmp_path / "state").write_text("a file is in the way")
    notes: list[str] = []

    def said(count: int) -> bool:
        notes.extend(files.notes())
        return len(notes) >= count

    for _ in range(3):
        files.append("battery log", "log.csv", HEADER, "1,2\n")
    until(lambda: said(1) and files._jobs.empty(), "the note")
    os.unlink(tmp_path / "state")
    files.append("battery log", "log.csv", HEADER, "3,4\n")
    until(lambda: said(2), "the second note")
    assert len(notes) == 2
    assert notes[0].startswith("battery log can't be written: ")
    assert str(tmp_path / "state") in notes[0]
    assert notes[1] == "battery log is written again"


def test_a_file_that_is_not_there_is_empty_and_one_that_can_t_be_read_a_note(tmp_path: Path) -> None:
    files = StateFiles(str(tmp_path))
    assert files.read("charger state", "charger") == ""
    assert files.notes() == []
    (tmp_path / "charger").mkdir()
    assert files.read("charger state", "charger") == ""
    assert files.notes()[0].startswith("charger state can't be read: ")


@pytest.mark.timeout(20)
def test_a_pipe_in_a_file_s_place_is_not_waited_for(tmp_path: Path) -> None:
    files = StateFiles(str(tmp_path))
    os.mkfifo(tmp_path / "charger")
    assert files.read("charger state", "charger") == ""
    assert "a FIFO, not a regular file" in files.notes()[0]


def test_a_disk_that_hangs_holds_nothing_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The jobs that wait are bounded; what comes on top is dropped."""
    monkeypatch.setattr(StateFiles, "_work", lambda self: None)
    files = StateFiles(str(tmp_path))
    for _ in range(500):
        files.append("log", "log.csv", HEADER, "1,2\n")
    assert files._jobs.qsize() == state_files.MOST_WAITING


def test_closing_writes_what_waits_and_ends_the_thread(files: StateFiles, tmp_path: Path) -> None:
    files.close()
    states = [files.running]
    for _ in range(50):
        files.append("log", "log.csv", HEADER, "1,2\n")
        states.append(files.running)
    assert states == [False] + [True] * 50
    files.close()
    until(lambda: not files.running, "the end of the thread")
    assert (tmp_path / "state" / "log.csv").read_text().count("1,2\n") == 50


def test_no_thread_is_a_note(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> int:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr("_thread.start_new_thread", refuse)
    files = StateFiles(str(tmp_path))
    files.append("log", "log.csv", HEADER, "1,2\n")
    files.append("log", "log.csv", HEADER, "1,2\n")
    assert len(files.notes()) == 1
