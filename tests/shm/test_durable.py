"""Files of the service: each is a regular file of its own, whatever somebody has put in its place."""

from __future__ import annotations

import errno
import os
import resource
import socket
import stat
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from failstop.files import durable
from failstop_lab.machine.files import Fifo, Null
from tests.support.children import needs_root
from tests.support.unprivileged import unprivileged

from .simulated import content, open_fds, put

NOBODY = 65534
FLAGS = {"read": os.O_RDONLY, "append": os.O_RDWR | os.O_APPEND | os.O_CREAT, "write": os.O_WRONLY | os.O_CREAT}
pytestmark = pytest.mark.timeout(20)


def a_socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(os.path.relpath(path))


PLANTED: dict[str, Callable[[Path], object]] = {
    "a link": lambda path: path.symlink_to(path.with_name("victim")),
    "a FIFO": os.mkfifo,
    "a directory": Path.mkdir,
    "a socket": a_socket,
}


@pytest.fixture
def victim(tmp_path: Path) -> Path:
    path = tmp_path / "victim"
    path.write_text("precious\n")
    return path


@pytest.mark.parametrize("how", FLAGS)
@pytest.mark.parametrize("what", PLANTED)
def test_what_is_planted_is_told_and_left_alone(what: str, how: str, victim: Path) -> None:
    path = victim.with_name("file")
    PLANTED[what](path)
    with pytest.raises(OSError, match=f"{what}, not a regular file") as refused:
        durable.open_own(str(path), FLAGS[how])
    told = refused.value
    assert (told.errno, told.strerror, told.filename) == (errno.EINVAL, f"{what}, not a regular file", str(path))
    assert victim.read_text() == "precious\n"


def test_a_device_is_not_even_opened(on: SimpleNamespace) -> None:
    calls = []
    on.machine.root.names["dev"].put("zero", Null())
    on.machine.at_seam = lambda thread, call, about: calls.append(call)
    with pytest.raises(OSError, match="a device, not a regular file"):
        on.durable.open_regular("/dev/zero")
    assert calls == ["stat"]


def test_what_is_planted_after_the_look_is_seen_all_the_same(on: SimpleNamespace) -> None:
    def plant(thread: object, call: str, about: tuple[Any, ...]) -> None:
        if call == "open":
            on.machine.root.names["tmp"].put("file", Fifo(0o666))
            assert about[1] & os.O_NOCTTY, "a terminal must not become the one whose hang-up ends the service"

    put(on, "/tmp/file")
    before, on.machine.at_seam = open_fds(on), plant
    with pytest.raises(OSError, match="a FIFO, not a regular file"):
        on.durable.open_regular("/tmp/file")
    assert open_fds(on) == before


@pytest.mark.parametrize("how", FLAGS)
def test_a_second_name_of_somebody_s_file_is_refused_and_the_file_told(how: str, victim: Path) -> None:
    path = victim.with_name("file")
    path.hardlink_to(victim)
    with pytest.raises(PermissionError, match=f"with another name: move it away: '{path}'$"):
        durable.open_own(str(path), FLAGS[how])


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root to give a file away")
def test_whose_file_it_may_be(tmp_path: Path) -> None:
    """In a folder that is everybody's, a stranger's file is a trap; in the stranger's own folder it is the rule."""
    path = tmp_path / "file"
    path.touch()
    os.chown(path, NOBODY, -1)
    with pytest.raises(PermissionError, match="somebody else's"):
        durable.open_own(str(path))
    os.chown(tmp_path, NOBODY, -1)
    os.close(durable.open_own(str(path)))


def test_a_new_file_is_made_for_all_to_read(tmp_path: Path) -> None:
    path = tmp_path / "file"
    os.close(durable.open_own(str(path), FLAGS["append"]))
    assert stat.S_IMODE(path.stat().st_mode) == 0o644
    fd = durable.open_own(str(path))
    assert not os.get_inheritable(fd)
    os.close(fd)


def test_through_links_where_people_may_use_them(victim: Path) -> None:
    path = victim.with_name("file")
    path.symlink_to(victim)
    fd = durable.open_regular(str(path))
    assert os.read(fd, 100) == b"precious\n"
    os.close(fd)


def test_a_draft_takes_the_place_of_an_old_one_for_all_to_read_whatever_the_umask(tmp_path: Path) -> None:
    draft = tmp_path / "draft"
    draft.write_text("longer, and of a dead writer")
    draft.chmod(0o600)
    mask = os.umask(0)
    try:
        durable.write_draft(str(draft), b"whole")
    finally:
        os.umask(mask)
    assert draft.read_bytes() == b"whole"
    assert stat.S_IMODE(draft.stat().st_mode) == 0o644


@pytest.mark.parametrize(("before", "after"), [(None, 0o644), (0o640, 0o640), (0o664, 0o664)])
def test_a_draft_that_is_to_resemble_a_file_can_be_read_by_the_same_people_whatever_the_umask(
    tmp_path: Path, before: int | None, after: int
) -> None:
    path = tmp_path / "file"
    if before:
        path.touch()
        path.chmod(before)
    mask = os.umask(0o077)
    try:
        durable.write_draft(str(tmp_path / "draft"), b"whole", str(path))
    finally:
        os.umask(mask)
    assert stat.S_IMODE((tmp_path / "draft").stat().st_mode) == after


@needs_root
def test_a_draft_that_is_to_resemble_a_file_has_its_owner_and_group(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.touch()
    os.chown(path, 1, 2)
    durable.write_draft(str(tmp_path / "draft"), b"whole", str(path))
    found = (tmp_path / "draft").stat()
    assert (found.st_uid, found.st_gid) == (1, 2)


def test_a_draft_that_does_not_fit_is_not_left(tmp_path: Path) -> None:
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2, before[1]))
    try:
        with pytest.raises(OSError, match="File too large"):
            durable.write_draft(str(tmp_path / "draft"), b"whole")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("folder", ["/tmp", ""])
def test_a_draft_and_then_its_folder_are_on_the_disk(on: SimpleNamespace, folder: str) -> None:
    """A power cut loses what was not synced: the content of the file, or its name. A bare name is of the folder that
    the process is in."""
    synced = []
    here = on.machine.root.names["tmp"] if folder else on.machine.root

    def seen(thread: object, call: str, about: tuple[Any, ...]) -> None:
        if call == "fsync":
            node = on.own.files[about[0]].node
            synced.append((node is here, node is here.names.get("draft"), node.size()))

    place = f"{folder}/" if folder else ""
    put(on, f"{place}file", "old")
    before, names = open_fds(on), len(here.names)
    on.machine.at_seam = seen
    on.durable.write_draft(f"{place}draft", b"whole")
    on.durable.publish(f"{place}draft", f"{place}file")
    assert synced == [(False, True, 5), (True, False, 0)]
    assert len(here.names) == names
    assert content(on, f"{place}file") == b"whole"
    assert open_fds(on) == before


def test_a_draft_that_can_not_get_its_name_is_not_left(tmp_path: Path) -> None:
    (tmp_path / "file").mkdir()
    durable.write_draft(str(tmp_path / "draft"), b"whole")
    with pytest.raises(IsADirectoryError):
        durable.publish(str(tmp_path / "draft"), str(tmp_path / "file"))
    assert os.listdir(tmp_path) == ["file"]
    with pytest.raises(FileNotFoundError):
        durable.publish(str(tmp_path / "draft"), str(tmp_path / "other"))


def test_what_is_written_in_parts_is_written_whole_and_then_synced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, calls = tmp_path / "file", []
    write, fsync = os.write, os.fsync
    monkeypatch.setattr(os, "write", lambda fd, data: calls.append(bytes(data)) or write(fd, data[:3]))
    monkeypatch.setattr(os, "fsync", lambda fd: calls.append(fd) or fsync(fd))
    with path.open("wb") as file:
        durable.write_all(file.fileno(), b"a whole one")
        assert calls == [b"a whole one", b"hole one", b"e one", b"ne", file.fileno()]
    assert path.read_bytes() == b"a whole one"


ROOM = {"f_bavail": 1000, "f_frsize": 1000, "f_flag": os.ST_NOSUID, "f_files": 9, "f_favail": 1}
"""As little as is enough: durable.LEAST_ROOM."""


@pytest.mark.parametrize(
    ("disk", "told"),
    [
        ({}, ""),
        ({"f_flag": os.ST_NOSUID | os.ST_RDONLY}, "the disk of {} is read-only"),
        ({"f_bavail": 999}, "the disk of {} is full (999 kB free)"),
        ({"f_bavail": 1999, "f_frsize": 500}, "the disk of {} is full (999 kB free)"),
        ({"f_bavail": 1}, "the disk of {} is full (1 kB free)"),
        ({"f_favail": 0}, "the disk of {} has no room for another file"),
        ({"f_files": 0, "f_favail": 0}, ""),
    ],
)
def test_a_disk_that_takes_no_file_is_told_for_a_folder_that_is_still_to_be_made(
    disk: dict[str, int], told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert ROOM["f_bavail"] * ROOM["f_frsize"] == durable.LEAST_ROOM
    asked = []
    monkeypatch.setattr(os, "statvfs", lambda path: asked.append(path) or SimpleNamespace(**ROOM | disk))
    for path in (tmp_path, tmp_path / "not" / "yet"):
        assert durable.no_room(str(path)) == told.format(tmp_path)
    assert asked == [str(tmp_path)] * 2


def test_a_disk_that_says_nothing_keeps_no_file_out(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(path: str) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO), path)

    monkeypatch.setattr(os, "statvfs", refused)
    assert durable.no_room("/") == ""


def test_what_replaces_a_file_touches_no_other_file(tmp_path: Path) -> None:
    path, other = tmp_path / "report.txt", tmp_path / "report.txt.part"
    path.write_text("old")
    other.write_text("somebody else's")
    durable.replace(str(path), b"new")
    assert path.read_text() == "new"
    assert other.read_text() == "somebody else's"
    assert sorted(each.name for each in tmp_path.iterdir()) == ["report.txt", "report.txt.part"]


def test_a_file_that_a_closed_folder_hides_is_not_called_missing(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "lost").symlink_to("nothing")
    for name, found in (
        ("file", False),
        (".", False),
        ("nothing", True),
        ("file/x", True),
        ("lost", True),
        ("\0", True),
    ):
        assert durable.missing(f"{tmp_path}/{name}") == found, name
    tmp_path.chmod(0)
    try:
        assert unprivileged(lambda: str(durable.missing(f"{tmp_path}/nothing"))) == "False"
    finally:
        tmp_path.chmod(0o700)
