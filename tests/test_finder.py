"""Finding the board again: by its path, by its identity, and never somebody else's."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop.board import finder as finder_module
from failstop.board import port
from failstop.board.finder import SEARCH_EVERY_NS, Finder, identity

BOARD = ("1a86", "55d4", "5A2B001122")
SPARE = ("1a86", "55d4", "5A2B009999")
NAMELESS = ("1a86", "55d4", "")
GPS = ("1546", "01a8", "")


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
        real = port.open_if_there
        monkeypatch.setattr(port, "open_if_there", lambda path, line: real(self._here(path), line))

    def _here(self, path: str) -> str:
        return str(self.nodes / path.removeprefix("/dev/")) if path.startswith("/dev/") else path

    def finder(self, name: str = "ttyACM0") -> Finder:
        return Finder(str(self.nodes / name), port.ROSORIN_PORT, str(self.sysfs))

    def plug(self, name: str, device: tuple[str, str, str]) -> None:
        master, slave = os.openpty()
        self._masters.append(master)
        number = os.fstat(slave).st_rdev
        (self.nodes / name).symlink_to(os.ttyname(slave))
        os.close(slave)
        self._plugs += 1
        place = self.sysfs / "devices" / f"1-{self._plugs}"
        (place / "interface").mkdir(parents=True)
        for key, value in zip(("idVendor", "idProduct", "serial"), device, strict=True):
            if value:
                (place / key).write_text(f"{value}\n")
        tty = self.sysfs / "class" / "tty" / name
        tty.mkdir()
        for link in (tty / "device", self.sysfs / "dev" / "char" / f"{os.major(number)}:{os.minor(number)}" / "device"):
            link.parent.mkdir(exist_ok=True)
            link.unlink(missing_ok=True)
            link.symlink_to(place / "interface")

    def unplug(self, name: str) -> None:
        (self.nodes / name).unlink()
        tty = self.sysfs / "class" / "tty" / name
        (tty / "device").unlink()
        tty.rmdir()

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
    usb.plug("ttyACM0", BOARD)
    finder = usb.finder()
    assert opened(finder) == "ttyACM0"
    usb.unplug("ttyACM0")
    assert opened(finder) == ""
    return finder


@pytest.mark.parametrize("name", ["ttyACM0", "ttyACM1"])
def test_it_comes_back_where_it_was_and_under_another_number(usb: Usb, lost: Finder, name: str) -> None:
    usb.plug(name, BOARD)
    assert opened(lost, 20 * SEARCH_EVERY_NS) == name
    assert name == "ttyACM0" or lost.at == "/dev/ttyACM1"


def test_elsewhere_is_looked_for_now_and_then_only(usb: Usb, lost: Finder, monkeypatch: pytest.MonkeyPatch) -> None:
    looks = []
    real = os.listdir
    monkeypatch.setattr(finder_module.os, "listdir", lambda path: looks.append(path) or real(path))  # type: ignore[attr-defined]
    for now_ns in range(20 * SEARCH_EVERY_NS, 22 * SEARCH_EVERY_NS, SEARCH_EVERY_NS // 10):
        assert opened(lost, now_ns) == ""
    assert len(looks) == 2


def test_another_kind_of_device_that_got_its_number_is_not_opened(usb: Usb, lost: Finder) -> None:
    usb.plug("ttyACM0", GPS)
    assert opened(lost) == ""
    usb.plug("ttyACM1", BOARD)
    assert opened(lost, 20 * SEARCH_EVERY_NS) == "ttyACM1"


def test_a_spare_board_in_its_place_is_taken_and_elsewhere_it_is_not(usb: Usb, lost: Finder) -> None:
    usb.plug("ttyACM1", SPARE)
    assert opened(lost, 20 * SEARCH_EVERY_NS) == ""
    usb.plug("ttyACM0", SPARE)
    assert opened(lost, 30 * SEARCH_EVERY_NS) == "ttyACM0"


def test_of_two_that_look_the_same_neither_is_taken(usb: Usb) -> None:
    usb.plug("ttyACM0", NAMELESS)
    finder = usb.finder()
    assert opened(finder) == "ttyACM0"
    usb.unplug("ttyACM0")
    usb.plug("ttyACM1", NAMELESS)
    usb.plug("ttyACM2", NAMELESS)
    assert opened(finder, 20 * SEARCH_EVERY_NS) == ""
    usb.unplug("ttyACM2")
    assert opened(finder, 30 * SEARCH_EVERY_NS) == "ttyACM1"


def test_what_is_no_usb_device_is_looked_for_by_its_path_alone(usb: Usb) -> None:
    usb.plug("ttyACM0", ("", "", ""))
    finder = usb.finder()
    assert opened(finder) == "ttyACM0"
    usb.unplug("ttyACM0")
    usb.plug("ttyACM1", ("", "", ""))
    assert opened(finder, 20 * SEARCH_EVERY_NS) == ""
    assert identity(str(usb.nodes / "nothing")) is None
