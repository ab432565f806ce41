"""The supervisor's own descriptor: the first bytes of a run, and a burst that is whole or not said to be."""

from __future__ import annotations

import contextlib
import errno
import os
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop.board import port
from failstop.board.burst import BURST
from failstop.supervisor import port as own_port
from failstop.supervisor.port import OwnPort
from tests.support.ptys import Pty, new_pty
from tests.support.stand_ins import Time
from tests.support.unprivileged import unprivileged


def test_the_first_bytes_of_a_run_are_a_burst() -> None:
    with new_pty() as pty:
        own = OwnPort.open_and_stop(pty.link)
        assert own.stopped
        assert pty.read() == BURST
        own.close()


def test_before_its_first_burst_it_has_not_stopped() -> None:
    assert not OwnPort(-1).stopped


def opened_by_nobody(path: str, tried: int) -> str:
    """Open as nobody; `tried` is a pipe's end that is closed when it was refused for the first time."""
    real = port.open_port

    def watched(name: str, *, exclusive: bool) -> int:
        try:
            return real(name, exclusive=exclusive)
        finally:
            os.write(tried, b".")

    port.open_port = watched  # type: ignore[assignment]
    try:
        OwnPort.open_and_stop(path)
    except port.PortError as error:
        return error.kind
    return "opened"


@contextlib.contextmanager
def given_to(group: int, mode: int) -> Iterator[tuple[Pty, int, int]]:
    """A port of root's with this group and mode, and a pipe for opened_by_nobody(): what is read, what is written."""
    with new_pty() as pty:
        os.chown(pty.link, 0, group)
        os.chmod(pty.link, mode)
        reader, tried = os.pipe()
        yield pty, reader, tried
        os.close(reader)
        os.close(tried)


@pytest.mark.skipif(os.geteuid() != 0, reason="gives a device away as udev does: only root")
def test_at_boot_a_device_that_udev_is_still_to_give_away_is_waited_for() -> None:
    with given_to(0, 0o600) as (pty, reader, tried):
        udev = threading.Thread(target=lambda: os.read(reader, 1) and os.chmod(pty.link, 0o666))
        udev.start()
        assert unprivileged(lambda: opened_by_nobody(pty.link, tried)) == "opened"
        udev.join()
        assert pty.read() == BURST


@pytest.mark.skipif(os.geteuid() != 0, reason="takes a device away from nobody: only root")
def test_a_device_that_udev_has_given_to_others_is_refused_at_the_first_try() -> None:
    with given_to(1, 0o660) as (pty, reader, tried):
        assert unprivileged(lambda: opened_by_nobody(pty.link, tried)) == "permission"
        assert os.read(reader, 100) == b"."


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Time:
    made = Time()
    monkeypatch.setattr(own_port, "time", made)
    return made


@pytest.mark.parametrize(
    ("kind", "is_new", "waited_s"),
    [
        ("busy", False, 1.0),
        ("permission", True, 2.0),
        ("permission", False, 0.0),
        ("absent", True, 0.0),
        ("io", True, 0.0),
    ],
)
def test_how_long_a_port_that_is_refused_is_tried_again(
    clock: Time,
    monkeypatch: pytest.MonkeyPatch,
    kind: port.Kind,
    is_new: bool,
    waited_s: float,
) -> None:
    tried: list[bool] = []
    told: list[float] = []

    def refuse(_path: str, *, exclusive: bool) -> int:
        tried.append(exclusive)
        raise port.PortError(kind, "refused")

    monkeypatch.setattr(port, "open_port", refuse)
    monkeypatch.setattr(own_port, "_is_new", lambda _: is_new)
    began_s = clock.now_s
    with pytest.raises(port.PortError, match="refused"):
        OwnPort.open_and_stop("/dev/board", lambda: told.append(clock.now_s))
    assert clock.now_s - began_s == pytest.approx(waited_s, abs=0.01)
    assert len(tried) >= 1 + waited_s / 0.02, "it is stopped soon after it is free"
    assert all(tried), "no unprivileged process opens it from then on"
    assert len(told) == (len(tried) - 1 if kind == "busy" else 0), "who holds it is looked at each time"


@pytest.mark.skipif(os.geteuid() != 0, reason="gives files to others: only root")
@pytest.mark.parametrize(
    ("owner", "group", "mode", "is_new"),
    [(0, 0, 0o600, True), (1, 0, 0o600, False), (0, 1, 0o600, False), (0, 0, 0o660, False)],
)
def test_a_device_is_new_as_long_as_it_is_as_the_kernel_made_it(
    tmp_path: Path, owner: int, group: int, mode: int, is_new: bool
) -> None:
    device = tmp_path / "board"
    device.touch()
    os.chown(device, owner, group)
    device.chmod(mode)
    assert own_port._is_new(str(device)) is is_new


def test_a_device_that_is_not_there_is_not_new(tmp_path: Path) -> None:
    assert not own_port._is_new(str(tmp_path / "board"))


def test_each_port_of_a_run_has_a_number() -> None:
    with new_pty() as pty:
        own = OwnPort(os.dup(pty.slave))
        numbers = [own.number]
        for fd in (-1, os.dup(pty.slave), os.dup(pty.slave)):
            own.adopt(fd)
            numbers.append(own.number)
        assert numbers == [1, 1, 2, 3], "one that is lost is still known by it"
        own.close()


@pytest.mark.parametrize(("unsent", "holds"), [(0, False), (1, True)])
def test_a_single_byte_that_the_kernel_has_not_passed_on_is_held(unsent: int, holds: bool) -> None:
    with new_pty() as pty:
        assert OwnPort(pty.slave, unsent_bytes=lambda _: unsent).holds() is holds


def test_of_a_port_that_can_not_say_what_it_holds_nobody_says_that_it_takes_nothing() -> None:
    def refused(_fd: int) -> int:
        raise OSError(errno.ENOTTY, os.strerror(errno.ENOTTY))

    with new_pty() as pty:
        assert not OwnPort(pty.slave, unsent_bytes=refused).holds()
