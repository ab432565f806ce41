"""The supervisor's own descriptor: the first bytes of a run, and a burst that is whole or not said to be."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import termios
import threading
from collections.abc import Iterator

import pytest

from failstop.board import port
from failstop.board.rrc.board import BOARD
from failstop.board.rrc.burst import BURST
from failstop.board.wire import Port
from failstop.supervisor.port_handover import OwnPort
from tests.support.ptys import Pty, new_pty
from tests.support.stage import MS
from tests.support.supervisor_scene import DEVICE, Scene
from tests.support.unprivileged import unprivileged


def test_the_first_bytes_of_a_run_are_a_burst() -> None:
    with new_pty() as pty:
        own = OwnPort.open_and_stop(pty.link, BOARD)
        assert own.stopped
        assert pty.read() == BURST
        own.close()


def test_a_port_has_not_stopped_before_its_first_burst() -> None:
    assert not OwnPort(-1, BOARD).stopped


def opened_by_nobody(path: str, tried: int) -> str:
    """Open as nobody; `tried` is a pipe's end that is closed when it was refused for the first time."""
    real = port.open_port

    def watched(name: str, *, exclusive: bool, line: Port) -> int:
        try:
            return real(name, exclusive=exclusive, line=line)
        finally:
            os.write(tried, b".")

    port.open_port = watched  # type: ignore[assignment]
    try:
        OwnPort.open_and_stop(path, BOARD)
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
def test_a_run_waits_for_a_device_that_udev_is_still_to_give_away() -> None:
    with given_to(0, 0o600) as (pty, reader, tried):
        udev = threading.Thread(target=lambda: os.read(reader, 1) and os.chmod(pty.link, 0o666), daemon=True)
        udev.start()
        assert unprivileged(lambda: opened_by_nobody(pty.link, tried)) == "opened"
        udev.join()
        assert pty.read() == BURST


@pytest.mark.skipif(os.geteuid() != 0, reason="takes a device away from nobody: only root")
def test_a_device_that_udev_has_given_to_others_is_refused_at_the_first_try() -> None:
    with given_to(1, 0o660) as (pty, reader, tried):
        assert unprivileged(lambda: opened_by_nobody(pty.link, tried)) == "permission"
        assert os.read(reader, 100) == b"."


def open_and_stop(scene: Scene, told: list[int]) -> str:
    """Open the port that the supervisor has let go, and return how that ends. `told`: when its holder was looked at."""
    scene.port.close()
    module = scene.load("failstop.board.port")
    try:
        scene.load("failstop.supervisor.port_handover").OwnPort.open_and_stop(
            DEVICE, BOARD, lambda: told.append(scene.now_ns)
        )
    except module.PortError as error:
        return str(error.kind)
    return "opened"


@pytest.mark.parametrize(
    ("kind", "number", "device", "waited_s"),
    [
        ("busy", 0, (0, 0, 0o660), 1.0),
        ("permission", errno.EACCES, (0, 0, 0o600), 2.0),
        ("permission", errno.EACCES, (1, 0, 0o600), 0.0),
        ("permission", errno.EACCES, (0, 1, 0o600), 0.0),
        ("permission", errno.EACCES, (0, 0, 0o660), 0.0),
        ("absent", 0, None, 0.0),
        ("io", errno.EIO, (0, 0, 0o600), 0.0),
    ],
)
def test_a_refused_port_is_tried_again_for_a_while(
    scene: Scene, kind: str, number: int, device: tuple[int, int, int] | None, waited_s: float
) -> None:
    """A device is new as long as it is as the kernel made it: owner, group and mode."""
    tried: list[int] = []
    told: list[int] = []
    if device:
        node = scene.wire.port
        node.uid, node.gid, node.mode = device
    else:
        scene.wire.unplug()
    if kind == "busy":
        scene.system["fcntl"].flock(scene.os.open(DEVICE, os.O_RDWR), fcntl.LOCK_EX)

    def refused(path: str, *_: object) -> bool:
        tried.append(scene.now_ns)
        return number > 0

    scene.refuse("open" if device else "stat", OSError(number, os.strerror(number)), refused)
    began_ns = scene.now_ns
    assert open_and_stop(scene, told) == kind
    assert (scene.now_ns - began_ns) / 1e9 == pytest.approx(waited_s, abs=0.01)
    assert len(tried) >= 1 + waited_s / 0.02, "it is stopped soon after it is free"
    assert told == (tried[:-1] if kind == "busy" else []), "who holds it is looked at each time"


def test_a_device_where_one_may_not_look_is_refused_at_once(scene: Scene) -> None:
    """Nobody can see whether it is new."""
    scene.machine.root.folder("/dev").mode, scene.me.uid = 0o700, 7
    began_ns = scene.now_ns
    assert open_and_stop(scene, []) == "permission"
    assert scene.now_ns - began_ns < 10 * MS


def test_the_port_is_opened_at_its_board_s_speed() -> None:
    scene = Scene(settings={"board.kind": "hoverboard"})
    scene.port.close()
    scene.load("failstop.supervisor.port_handover").OwnPort.open_and_stop(DEVICE, scene.port.board)
    assert scene.wire.port.settings[4:6] == [termios.B115200] * 2


def test_each_port_of_a_run_has_a_number(scene: Scene) -> None:
    numbers = [scene.port.number]
    for fd in (-1, scene.os.dup(0), scene.os.dup(0)):
        scene.port.adopt(fd)
        numbers.append(scene.port.number)
    assert numbers == [1, 1, 2, 3], "one that is lost is still known by it"


def test_a_single_byte_that_the_kernel_has_not_passed_on_is_held(scene: Scene) -> None:
    assert not scene.port.holds()
    scene.wire.hold()
    assert scene.port.holds()


def test_a_port_that_can_not_say_what_it_holds_is_not_said_to_take_nothing(scene: Scene) -> None:
    scene.wire.hold()
    scene.refuse("ioctl", OSError(errno.ENOTTY, os.strerror(errno.ENOTTY)))
    assert not scene.port.holds()
