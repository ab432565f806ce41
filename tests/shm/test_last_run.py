"""The run of an instance that is published, and how the last one was started."""

from __future__ import annotations

import errno
from types import SimpleNamespace
from typing import Any

import pytest

from failstop.files import instance

from .simulated import USER, give, mode, open_fds, put, refusing


def test_paths_lie_in_the_runtime_dir_by_their_own_names() -> None:
    names = {"lock": instance.lock_path, "claims": instance.claims_path, "stop": instance.stop_path}
    names |= {"bell": instance.bell_path, "run": instance.run_path, "last": instance.last_path}
    assert {name: path("/run/x") for name, path in names.items()} == {name: f"/run/x/{name}" for name in names}


def test_the_run_that_is_published_is_the_one_that_is_read(on: SimpleNamespace, bases: list[str]) -> None:
    path, fds = on.instances.make_runtime_dir("robot"), []
    with pytest.raises(on.instance.NoService):
        on.instance.current_run(path)
    for incarnation in (7, 2**64 - 1, 0):
        fds.append(on.instance.publish_run(path, incarnation))
        assert on.instance.current_run(path) == (incarnation, USER)
        found = on.os.fstat(fds[-1])
        assert (found.st_nlink, found.st_mode & 0o7777) == (1, 0o644)
    assert on.os.fstat(fds[0]).st_nlink == 0
    on.instance.clear(path)
    assert on.os.listdir(path) == []


def test_a_run_that_can_not_be_published_leaves_the_one_before(on: SimpleNamespace, bases: list[str]) -> None:
    path = on.instances.make_runtime_dir("robot")
    on.instance.publish_run(path, 7)
    before = open_fds(on)
    with refusing(on, "pwrite", errno.EFBIG), pytest.raises(OSError, match="File too large"):
        on.instance.publish_run(path, 8)
    on.machine.shortened = True
    with pytest.raises(OSError, match="No space left on device") as full:
        on.instance.publish_run(path, 8)
    assert (full.value.errno, full.value.filename) == (errno.ENOSPC, on.instance.run_path(path))
    assert on.instance.current_run(path) == (7, USER)
    on.os.unlink(f"{on.instance.run_path(path)}.new")
    on.os.symlink(bases[0], f"{on.instance.run_path(path)}.new")
    with pytest.raises(on.place.Untrusted, match="is a link"):
        on.instance.publish_run(path, 8)
    assert open_fds(on) == before


def test_what_a_run_has_left_is_cleared_but_for_the_lock(on: SimpleNamespace, bases: list[str]) -> None:
    path = on.instances.make_runtime_dir("robot")
    for name in ("lock", "claims", "stop", "bell", "run", "run.new", "last.new", "kept"):
        put(on, f"{path}/{name}")
    before = open_fds(on)
    for _ in range(2):
        on.instance.clear(path)
        assert sorted(on.os.listdir(path)) == ["kept", "lock"]
    on.instance.clear(f"{path}-absent")
    assert open_fds(on) == before


def remembered(on: Any, name: str) -> tuple[str, str, tuple[int, ...], str]:
    found = on.instance.last(name)
    return found.device, found.command, found.servos, found.board


NO_RUN = ("", "", (), "")


def test_how_the_last_run_was_started_outlives_it(on: SimpleNamespace, bases: list[str]) -> None:
    for name in ("robot", "no/slash", ""):
        assert remembered(on, name) == NO_RUN
    path = on.instances.make_runtime_dir("robot")
    for servos in ((), (1, 2, 10)):
        words = ("/dev/my board", "failstop run --device '/dev/my board'", servos, "ugv")
        before = open_fds(on)
        on.instance.remember(path, on.instance.Last(*words))
        assert remembered(on, "robot") == words
        assert open_fds(on) == before
    on.instance.clear(path)
    assert remembered(on, "robot")[0] == "/dev/my board"
    assert on.os.listdir(path) == ["last"]
    assert mode(on, on.instance.last_path(path)) == 0o644
    assert remembered(on, "other") == NO_RUN
    with pytest.raises(on.instance.NoService, match=r"start it with `failstop run --device '/dev/my board'`$"):
        on.instance.find("robot")
    on.instance.remember(path, on.instance.Last("/dev/x", "failstop run --config '\x1b[2J'"))
    assert remembered(on, "robot") == ("/dev/x", "", (), ""), "what would write on the terminal is not shown"


@pytest.mark.parametrize("stop", ["", "ugv 115200 7b7d", "stop stop "])
def test_the_board_s_stop_and_whose_file_says_so_are_kept(on: SimpleNamespace, bases: list[str], stop: str) -> None:
    path = on.instances.make_runtime_dir("robot")
    usb = "1a86|55d4||1.0|1-1.2"
    on.instance.remember(path, on.instance.Last("/dev/x", "failstop run", (1, 2), "ugv", stop, usb, owner=7))
    found = on.instance.last("robot")
    assert (found.servos, found.board, found.stop, found.usb, found.owner) == ((1, 2), "ugv", stop, usb, USER)


@pytest.mark.parametrize("servos", [(), (4,)])
def test_a_file_without_a_stop_is_read(on: SimpleNamespace, bases: list[str], servos: tuple[int, ...]) -> None:
    words = ("/dev/x", "failstop run", "rrc", *map(str, servos))
    put(on, on.instance.last_path(on.instances.make_runtime_dir("robot")), "\0".join(words))
    found = on.instance.last("robot")
    assert (found.board, found.servos, found.stop, found.usb) == ("rrc", servos, "", "")


def test_of_two_places_the_newer_run_counts(on: SimpleNamespace, bases: list[str]) -> None:
    for base in (*bases, bases[0]):
        on.os.makedirs(f"{base}/robot")
        give(on, f"{base}/robot")
        on.instance.remember(f"{base}/robot", on.instance.Last(base, "failstop run"))
        assert remembered(on, "robot")[0] == base


@pytest.mark.parametrize("junk", [b"", b"\xff\xfe", b"/dev/x", b"/dev/x\0failstop run\0ugv\0one", b"\0" * 99])
def test_nonsense_is_no_run(on: SimpleNamespace, bases: list[str], junk: bytes) -> None:
    put(on, on.instance.last_path(on.instances.make_runtime_dir("robot")), junk)
    assert remembered(on, "robot") == NO_RUN


def test_what_somebody_has_planted_is_not_believed(on: SimpleNamespace, bases: list[str]) -> None:
    path = on.instances.make_runtime_dir("robot")
    put(on, "/tmp/planted", b"/dev/x\0failstop run")
    on.os.symlink("/tmp/planted", on.instance.last_path(path))
    assert remembered(on, "robot") == NO_RUN
    on.os.symlink("/tmp/planted", on.instance.run_path(path))
    with pytest.raises(on.instance.InstanceError, match="run is a link: remove it"):
        on.instance.current_run(path)


@pytest.mark.parametrize("junk", [b"", b"\xff\xfe\0", b"not a number", b"-"])
def test_a_run_that_can_not_be_read_is_no_service(on: SimpleNamespace, bases: list[str], junk: bytes) -> None:
    path = on.instances.make_runtime_dir("robot")
    put(on, on.instance.run_path(path), junk)
    before = open_fds(on)
    with pytest.raises(on.instance.NoService):
        on.instance.current_run(path)
    assert open_fds(on) == before
