"""Finding the board again after it was lost: by the path that the settings name, or else by what its USB device says of
itself.

A tty whose descriptor somebody holds over an unplug keeps its number, so that the board comes back as another one.
"""

from __future__ import annotations

import os

from failstop.board import port

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.board.wire import Port

SEARCH_EVERY_NS = 50_000_000
"""How often sysfs is looked through, which takes some 0.1 ms."""
USB_DEPTH = 6
"""A tty is so many directories below its USB device at most."""
SERIAL_NODES = ("ttyACM", "ttyUSB")

Identity = tuple[str, str, str]
"""Vendor, product and serial number (empty where the device has none), as sysfs has them."""


def identity(device: str) -> Identity | None:
    """Of the USB device above a tty's `device` in sysfs; None where there is none, as of a pty."""
    place = os.path.realpath(device)
    for _ in range(USB_DEPTH):
        vendor = _line(f"{place}/idVendor")
        if vendor:
            return vendor, _line(f"{place}/idProduct"), _line(f"{place}/serial")
        place = os.path.dirname(place)
    return None


def _line(path: str) -> str:
    try:
        with open(path, encoding="ascii", errors="replace") as file:
            return file.readline(256).strip()
    except OSError:
        return ""


class Finder:
    """Where to open the port of one board. `at` is the path that it was opened at last."""

    __slots__ = ("_identity", "_line", "_look_at_ns", "_path", "_sysfs", "at")

    def __init__(self, path: str, line: Port, sysfs: str = "/sys") -> None:
        """`path`: the board's, of the settings."""
        self._line = line
        self._path = path
        self._sysfs = sysfs
        self._identity: Identity | None = None
        self._look_at_ns = 0
        self.at = path

    def learn(self, descriptor: int) -> None:
        """Remember which device it is that is open."""
        self._identity = self._of_number(os.fstat(descriptor).st_rdev) or self._identity

    def open(self, now_ns: int) -> int:
        """Open it where it is, exclusively; -1 while it can't be had. Never raises."""
        path = self._path
        if not self._may_be_it(path):
            if now_ns < self._look_at_ns:
                return -1
            self._look_at_ns = now_ns + SEARCH_EVERY_NS
            path = self._elsewhere()
        descriptor = port.open_if_there(path, self._line) if path else -1
        if descriptor >= 0:
            self.at = path
            self.learn(descriptor)
        return descriptor

    def _of_number(self, number: int) -> Identity | None:
        return identity(f"{self._sysfs}/dev/char/{os.major(number)}:{os.minor(number)}/device")

    def _may_be_it(self, path: str) -> bool:
        """True when there is a device that is of this kind, for all that is known: another board may have been put in
        its place, a device of another kind may have got its number."""
        try:
            number = os.stat(path).st_rdev
        except OSError:
            return False
        found = self._identity and self._of_number(number)
        return self._identity is None or (found is not None and found[:2] == self._identity[:2])

    def _elsewhere(self) -> str:
        """The one tty of this very device; empty where there is none, or where two look the same."""
        if self._identity is None:
            return ""
        try:
            names = [name for name in os.listdir(f"{self._sysfs}/class/tty") if name.startswith(SERIAL_NODES)]
        except OSError:
            return ""
        same = [name for name in names if identity(f"{self._sysfs}/class/tty/{name}/device") == self._identity]
        return f"/dev/{same[0]}" if len(same) == 1 else ""
