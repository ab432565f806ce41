"""Finding the board again: which device is taken for it, wherever it and its look-alikes are plugged in."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop.board import finder as finder_module
from failstop.board import port
from failstop.board.finder import SEARCH_EVERY_NS, Device, Finder, identity
from failstop.board.rrc.board import RRC_PORT
from failstop.board.wire import Port

BOARD = ("1a86", "55d4", "5A2B001122")
LIDAR = ("1a86", "55d4", "5A2B007777")
SPARE = ("1a86", "55d4", "5A2B009999")
NAMELESS = ("1a86", "55d4", "")
GPS = ("1546", "01a8", "")
PLACE = "1-1.2"
"""The socket of the board."""


class Usb:
    """A machine's sysfs and its device nodes. The nodes are ptys: what their USB devices are, sysfs says."""

    def __init__(self, root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.sysfs = root / "sys"
        self.nodes = root / "dev"
        self.nodes.mkdir()
        (self.sysfs / "class" / "tty").mkdir(parents=True)
        (self.sysfs / "dev" / "char").mkdir(parents=True)
        self._masters: list[int] = []
        self._plugs = 0
        self._places: dict[str, Path] = {}
        real = port.open_if_there
        monkeypatch.setattr(port, "open_if_there", lambda path, line: real(self._here(path), line))

    def _here(self, path: str) -> str:
        return str(self.nodes / path.removeprefix("/dev/")) if path.startswith("/dev/") else path

    def finder(self, name: str = "ttyACM0") -> Finder:
        return Finder(str(self.nodes / name), RRC_PORT, str(self.sysfs))

    def plug(self, name: str, device: tuple[str, str, str], place: str = "", interface: str = "1.0") -> None:
        """Plug a device into the socket `place`; into one that was never used before, if none is named."""
        master, slave = os.openpty()
        self._masters.append(master)
        number = os.fstat(slave).st_rdev
        (self.nodes / name).symlink_to(os.ttyname(slave))
        os.close(slave)
        self._plugs += 1
        place = place or f"9-{self._plugs}"
        found = self._places[name] = self.sysfs / "devices" / place
        below = found / f"{place}:{interface}"
        below.mkdir(parents=True)
        for key, value in zip(("idVendor", "idProduct", "serial"), device, strict=True):
            if value:
                (found / key).write_text(f"{value}\n")
        tty = self.sysfs / "class" / "tty" / name
        tty.mkdir()
        for link in (tty / "device", self.sysfs / "dev" / "char" / f"{os.major(number)}:{os.minor(number)}" / "device"):
            link.parent.mkdir(exist_ok=True)
            link.unlink(missing_ok=True)
            link.symlink_to(below)

    def unplug(self, name: str) -> None:
        (self.nodes / name).unlink()
        tty = self.sysfs / "class" / "tty" / name
        (tty / "device").unlink()
        tty.rmdir()
        place = self._places.pop(name)
        if place not in self._places.values():
            shutil.rmtree(place)

    def close(self) -> None:
        for master in self._masters:
            os.close(master)


@pytest.fixture
def usb(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Usb]:
    made = Usb(tmp_path, monkeypatch)
    yield made
    made.close()


def opened(finder: Finder, now_ns: int = 10 * SEARCH_EVERY_NS) -> str:
    """The name of the node that it opens; empty for none."""
    descriptor = finder.open(now_ns)
    if descriptor < 0:
        return ""
    os.close(descriptor)
    return os.path.basename(finder.at)


@pytest.fixture
def lost(usb: Usb) -> Finder:
    """Of a board that was open, with a serial number, and is unplugged."""
    usb.plug("ttyACM0", BOARD, PLACE)
    finder = usb.finder()
    assert opened(finder) == "ttyACM0"
    usb.unplug("ttyACM0")
    assert opened(finder) == ""
    return finder


Plugged = tuple[str, tuple[str, str, str], str]
"""The number of a tty, what its device says of itself, and its socket."""
ARRANGEMENTS: dict[str, tuple[list[Plugged], list[Plugged], str, bool]] = {
    # at the start, the board first; after the reset; which is opened; whether it is the board for sure
    "the numbers are swapped": ([("0", BOARD, PLACE), ("1", LIDAR, "1-3")],
        [("0", LIDAR, "1-3"), ("1", BOARD, PLACE)], "1", True),
    "swapped, without serial numbers": ([("0", NAMELESS, PLACE), ("1", NAMELESS, "1-3")],
        [("0", NAMELESS, "1-3"), ("1", NAMELESS, PLACE)], "1", True),
    "swapped, with one serial number for both": ([("0", BOARD, PLACE), ("1", BOARD, "1-3")],
        [("0", BOARD, "1-3"), ("1", BOARD, PLACE)], "1", True),
    "the sockets are swapped too": ([("0", BOARD, PLACE), ("1", LIDAR, "1-3")],
        [("0", LIDAR, PLACE), ("1", BOARD, "1-3")], "1", True),
    "the look-alike is back first": ([("0", BOARD, PLACE), ("1", LIDAR, "1-3")],
        [("0", LIDAR, "1-3")], "", False),
    "back first, without serial numbers": ([("0", NAMELESS, PLACE), ("1", NAMELESS, "1-3")],
        [("0", NAMELESS, "1-3")], "", False),
    "the look-alike in the board's socket": ([("0", BOARD, PLACE), ("1", LIDAR, "1-3")],
        [("0", LIDAR, PLACE)], "", False),
    "one that came later is in another socket": ([("0", BOARD, PLACE)],
        [("0", LIDAR, "1-3")], "", False),
    "the board in another socket": ([("0", BOARD, PLACE), ("1", LIDAR, "1-3")],
        [("0", LIDAR, "1-3"), ("1", BOARD, "1-4")], "1", True),
    "in another, without serial numbers": ([("0", NAMELESS, PLACE), ("1", NAMELESS, "1-3")],
        [("0", NAMELESS, "1-3"), ("1", NAMELESS, "1-4")], "1", False),
    "alone, in another, without a serial number": ([("0", NAMELESS, PLACE)],
        [("1", NAMELESS, "1-4")], "1", False),
    "two without serial numbers in other sockets": ([("0", NAMELESS, PLACE)],
        [("0", NAMELESS, "1-4"), ("1", NAMELESS, "1-5")], "", False),
    "a spare in its socket": ([("0", BOARD, PLACE), ("1", LIDAR, "1-3")],
        [("0", SPARE, PLACE), ("1", LIDAR, "1-3")], "0", False),
    "a spare in its socket, and the board elsewhere": ([("0", BOARD, PLACE)],
        [("0", SPARE, PLACE), ("1", BOARD, "1-4")], "1", True),
    "a spare in its socket with another number": ([("0", BOARD, PLACE)],
        [("1", SPARE, PLACE)], "", False),
    "another kind of device in its socket": ([("0", BOARD, PLACE)],
        [("0", GPS, PLACE)], "", False),
}  # fmt: skip


@pytest.mark.parametrize("arrangement", ARRANGEMENTS)
def test_a_look_alike_at_the_path_is_not_the_board(usb: Usb, arrangement: str) -> None:
    before, after, name, sure = ARRANGEMENTS[arrangement]
    for number, device, place in before:
        usb.plug(f"ttyACM{number}", device, place)
    finder = usb.finder()
    assert opened(finder) == "ttyACM0"
    finder.look_around()
    for number, _, _ in before:
        usb.unplug(f"ttyACM{number}")
    assert opened(finder, 20 * SEARCH_EVERY_NS) == ""
    for number, device, place in after:
        usb.plug(f"ttyACM{number}", device, place)
    assert opened(finder, 30 * SEARCH_EVERY_NS) == (f"ttyACM{name}" if name else "")
    assert not name or finder.sure is sure


@pytest.mark.parametrize("name", ["ttyACM0", "ttyACM1"])
def test_it_comes_back_where_it_was_and_under_another_number(usb: Usb, lost: Finder, name: str) -> None:
    usb.plug(name, BOARD, PLACE)
    assert opened(lost, 20 * SEARCH_EVERY_NS) == name
    assert name == "ttyACM0" or lost.at == "/dev/ttyACM1"


def test_elsewhere_is_looked_for_now_and_then_only(usb: Usb, lost: Finder, monkeypatch: pytest.MonkeyPatch) -> None:
    looks = []
    real = os.listdir
    monkeypatch.setattr(finder_module.os, "listdir", lambda path: looks.append(path) or real(path))  # type: ignore[attr-defined]
    for now_ns in range(20 * SEARCH_EVERY_NS, 22 * SEARCH_EVERY_NS, SEARCH_EVERY_NS // 10):
        assert opened(lost, now_ns) == ""
    assert len(looks) == 2


def test_the_board_is_gone_to_when_it_turns_up_behind_a_device_that_was_taken_for_it(usb: Usb, lost: Finder) -> None:
    usb.plug("ttyACM0", SPARE, PLACE)
    assert opened(lost, 20 * SEARCH_EVERY_NS) == "ttyACM0"
    assert not lost.misplaced()
    usb.plug("ttyACM1", BOARD, "1-4")
    assert lost.misplaced()
    assert opened(lost, 30 * SEARCH_EVERY_NS) == "ttyACM1"
    assert (lost.sure, lost.misplaced()) == (True, False)


def test_a_device_that_has_answered_is_the_board_from_then_on(usb: Usb, lost: Finder) -> None:
    usb.plug("ttyACM0", SPARE, PLACE)
    assert opened(lost, 20 * SEARCH_EVERY_NS) == "ttyACM0"
    lost.believe()
    usb.plug("ttyACM1", BOARD, "1-4")
    assert not lost.misplaced()
    usb.unplug("ttyACM0")
    usb.plug("ttyACM0", BOARD, PLACE)
    usb.plug("ttyACM2", SPARE, "1-5")
    assert opened(lost, 30 * SEARCH_EVERY_NS) == "ttyACM2"


def test_the_other_port_of_the_same_device_is_not_the_board(usb: Usb) -> None:
    usb.plug("ttyACM0", BOARD, PLACE, "1.0")
    finder = usb.finder()
    assert opened(finder) == "ttyACM0"
    usb.unplug("ttyACM0")
    usb.plug("ttyACM0", BOARD, PLACE, "1.2")
    assert opened(finder, 20 * SEARCH_EVERY_NS) == ""


def test_a_look_alike_that_came_while_the_board_was_open_is_known_by_its_socket(usb: Usb) -> None:
    usb.plug("ttyACM0", NAMELESS, PLACE)
    finder = usb.finder()
    assert opened(finder) == "ttyACM0"
    usb.plug("ttyACM1", NAMELESS, "1-3")
    finder.look_around()
    usb.unplug("ttyACM0")
    usb.unplug("ttyACM1")
    finder.look_around()
    usb.plug("ttyACM0", NAMELESS, "1-3")
    assert opened(finder, 20 * SEARCH_EVERY_NS) == "", "what is seen after the loss says nothing of before"


def test_a_number_that_becomes_another_device_s_while_it_is_opened_is_let_go(
    usb: Usb, lost: Finder, monkeypatch: pytest.MonkeyPatch
) -> None:
    usb.plug("ttyACM0", BOARD, PLACE)
    real = port.open_if_there
    descriptors = []

    def late(path: str, line: Port) -> int:
        usb.unplug("ttyACM0")
        usb.plug("ttyACM0", LIDAR, "1-3")
        descriptors.append(real(path, line))
        return descriptors[0]

    monkeypatch.setattr(port, "open_if_there", late)
    assert opened(lost, 20 * SEARCH_EVERY_NS) == ""
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(descriptors[0])


def test_what_is_no_usb_device_is_looked_for_by_its_path_alone(usb: Usb) -> None:
    usb.plug("ttyACM0", ("", "", ""))
    finder = usb.finder()
    assert opened(finder) == "ttyACM0"
    usb.unplug("ttyACM0")
    usb.plug("ttyACM1", ("", "", ""))
    assert opened(finder, 20 * SEARCH_EVERY_NS) == ""
    assert identity(str(usb.nodes / "nothing")) is None


def test_the_ports_of_an_adapter_with_several_are_told_apart(tmp_path: Path) -> None:
    """usb-serial puts a folder of the tty's own below the interface, and the number of the port into it."""
    place = tmp_path / "devices" / "1-1.2"
    for number in range(2):
        tty = place / "1-1.2:1.0" / f"ttyUSB{number}"
        tty.mkdir(parents=True)
        (tty / "port_number").write_text(f"{number}\n")
    (place / "idVendor").write_text("0403\n")
    (place / "idProduct").write_text("6011\n")
    first, second = (identity(str(place / "1-1.2:1.0" / f"ttyUSB{number}")) for number in range(2))
    assert first == Device("0403", "6011", "", "1.0 0", "1-1.2")
    assert first != second
