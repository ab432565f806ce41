"""Finder: finds the board's serial port again after the board was unplugged or reset.

The path in the settings is not enough. After a reset of a USB hub it may lead to another device of the same type. So
the board is recognised by what its USB device reports and, if that is not enough, by its socket. CHOICES has the rules.

If a process keeps a tty open while the board is unplugged, the tty's number stays in use, so the board comes back with
another number.
"""

from __future__ import annotations

import os

from failstop.board import port

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from failstop.board.interface import Board
    from failstop.board.wire import Port

SEARCH_EVERY_NS = 10_000_000
"""How often sysfs is searched, in ns. A search takes about 0.1 ms."""
USB_DEPTH = 6
"""In sysfs, a tty is at most this many directories below its USB device."""
SERIAL_NODES = ("ttyACM", "ttyUSB")


class Device:
    """A serial port on USB, as sysfs describes it. Two objects are equal if they are the same device in the same
    socket."""

    __slots__ = ("part", "place", "product", "serial", "vendor")

    def __init__(self, vendor: str, product: str, serial: str, part: str, place: str) -> None:
        self.vendor = vendor
        self.product = product
        self.serial = serial
        """The device's serial number. It is empty for many adapters, which have none. Some makers give all their
        devices the same number."""
        self.part = part
        """The USB interface, and the number of the port in this interface. Together they distinguish this port from
        other ports of the same device."""
        self.place = place
        """The socket where the device is plugged in: the bus, and the number of the port on each hub, for example
        1-1.2."""

    @property
    def what(self) -> tuple[str, ...]:
        """The device's own description, which is the same in every socket."""
        return self.vendor, self.product, self.serial, self.part

    @property
    def kind(self) -> tuple[str, ...]:
        """The part of the description that all devices with the same chip share."""
        return self.vendor, self.product, self.part

    @property
    def text(self) -> str:
        """The device and its socket as one line of text. Equal devices have equal texts."""
        return "|".join((*self.what, self.place))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Device) and (self.what, self.place) == (other.what, other.place)

    def __hash__(self) -> int:
        return hash((self.what, self.place))

    def __repr__(self) -> str:
        return f"{self.vendor}:{self.product} {self.serial or 'without a serial number'} at {self.place}"


def identity(device: str, like: Device | None = None) -> Device | None:
    """Return the USB device of a tty. `device`: the tty's `device` link in sysfs. None if the tty belongs to no USB
    device, for example a pty or a serial pin. Also None if the vendor or product differs from that of `like`."""
    folder = whole = os.path.realpath(device)
    for _ in range(USB_DEPTH):
        if vendor := _line(f"{folder}/idVendor"):
            product = _line(f"{folder}/idProduct")
            if like and (vendor, product) != (like.vendor, like.product):
                return None
            interface = whole[len(folder) + 1 :].partition("/")[0].partition(":")[2]
            part = f"{interface} {_line(f'{whole}/port_number')}".rstrip()
            # The kernel reads this under the device's lock, so it may take long while the device is being reset.
            return Device(vendor, product, _line(f"{folder}/serial"), part, os.path.basename(folder))
        folder = os.path.dirname(folder)
    return None


def of_number(number: int, sysfs: str = "/sys") -> Device | None:
    """Return the USB device to which the tty with this device number belongs. None if it belongs to no USB device."""
    return identity(f"{sysfs}/dev/char/{os.major(number)}:{os.minor(number)}/device")


def usb_text(number: int, sysfs: str = "/sys") -> str:
    """Return Device.text of the USB device to which the tty with this device number belongs. Empty if it belongs to no
    USB device."""
    found = of_number(number, sysfs)
    return found.text if found else ""


def is_still(now: str, before: str) -> bool | None:
    """Compare two texts of usb_text(): the device at a port now, and the board that was there. Returns True if they are
    the same device in the same socket, and False if no row of CHOICES would take the device for the board. Otherwise
    None, also if one of them is not known."""
    if now == before:
        return True
    if not (now and before):
        return None
    (what, _, place), (its_what, _, its_place) = now.rpartition("|"), before.rpartition("|")
    spare = place == its_place and what.split("|")[:2] == its_what.split("|")[:2]
    return None if what == its_what or spare else False


def refuse_stranger(path: str, board: Board, sysfs: str = "/sys") -> None:
    """Raise port.PortError if the device at this path certainly is not the board, by its USB id. Call this before a
    port is opened that nobody has named: it may belong to another program."""
    try:
        found = of_number(os.stat(path).st_rdev, sysfs)
    except OSError:
        return
    usb = f"{found.vendor}:{found.product}" if found else ""
    if board.usb_alone and usb and usb not in board.usb:
        step = "set device.path and board.kind, or run `failstop setup`"
        raise port.PortError("absent", f"{path} is USB {usb}, not the board, so it was not opened: {step}")


def usb_ports(like: Device | None, sysfs: str = "/sys") -> dict[str, Device]:
    """Return every serial port on USB, by its path. With `like`, return only ports with its vendor and product."""
    try:
        names = os.listdir(f"{sysfs}/class/tty")
    except OSError:
        return {}
    ports = ((name, f"{sysfs}/class/tty/{name}/device") for name in sorted(names) if name.startswith(SERIAL_NODES))
    return {f"/dev/{name}": device for name, link in ports if (device := identity(link, like))}


def look_alikes(own: Device | None, sysfs: str = "/sys") -> tuple[dict[str, Device], bool]:
    """Return (others, ambiguous). `others`: the other serial ports with the same vendor and product, by path.
    `ambiguous`: True if `own` and one of these ports have the same serial number, or both have none, so failstop can't
    distinguish them."""
    others = {path: device for path, device in usb_ports(own, sysfs).items() if own and device != own}
    return others, any(own and device.what == own.what for device in others.values())


def _line(path: str) -> str:
    try:
        with open(path, encoding="ascii", errors="replace") as file:
            return file.readline(256).strip()
    except OSError:
        return ""


class Search:
    """The facts that CHOICES decides on: the board as it was last known, and the devices that are present."""

    __slots__ = ("at_path", "board", "devices", "neighbours")

    def __init__(
        self, board: Device, neighbours: Iterable[Device], devices: Iterable[Device], at_path: Device | None
    ) -> None:
        """`neighbours`: the devices that were present while the board was. `at_path`: the device at the path in the
        settings."""
        self.board = board
        self.neighbours = frozenset(neighbours)
        self.devices = frozenset(devices)
        self.at_path = at_path

    def in_place(self) -> list[Device]:
        return [device for device in self.devices if device == self.board]

    def with_its_serial(self) -> list[Device]:
        return self._moved() if self.board.serial else []

    def without_serial(self) -> list[Device]:
        return [] if self.board.serial else self._moved()

    def _moved(self) -> list[Device]:
        """Return the devices that have the same description as the board (vendor, product, serial number), except
        neighbours that are still in their own sockets."""
        return [device for device in self.devices - self.neighbours if device.what == self.board.what]

    def in_its_stead(self) -> list[Device]:
        spare = self.at_path
        if spare is None or (spare.kind, spare.place) != (self.board.kind, self.board.place):
            return []
        return [] if spare.what in [each.what for each in self.neighbours] else [spare]


CHOICES: tuple[tuple[Callable[[Search], list[Device]], bool], ...] = (
    # the devices that the row finds                               True if such a device is certainly the board
    (Search.in_place, True),  # the same device, in the socket where it was
    (Search.with_its_serial, True),  # its serial number, in another socket
    (Search.without_serial, False),  # no serial numbers: one like it, in another socket
    (Search.in_its_stead, False),  # a spare: one of the same kind at the path, in the socket where the board was
)
"""The rules that choose the device that is the board, as (rule, certain). The first rule that finds a device decides.
If it finds several devices, none of them is chosen. If `certain` is False, failstop accepts the device as the board
only after the device has answered as the board does."""


def pick(search: Search) -> tuple[Device | None, bool]:
    """Return (device, certain) by the rules of CHOICES. `device`: most likely the board, or None. `certain`: True if it
    certainly is the board. Pure."""
    for choice, sure in CHOICES:
        if found := choice(search):
            return (found[0], sure) if len(found) == 1 else (None, False)
    return None, False


class Finder:
    """Finds the port of one board. `at` is the path where the board was last opened."""

    __slots__ = ("_board", "_held", "_line", "_look_at_ns", "_neighbours", "_path", "_sysfs", "at", "sure")

    def __init__(self, path: str, line: Port, sysfs: str = "/sys") -> None:
        """`path` is the board's path in the settings."""
        self._line = line
        self._path = path
        self._sysfs = sysfs
        self._board: Device | None = None
        """The board as it was last known."""
        self._held: Device | None = None
        """The device that was opened last."""
        self._neighbours: frozenset[Device] = frozenset()
        self._look_at_ns = 0
        self.at = path
        self.sure = True
        """True if the open device is certainly the board. False if it is only the best guess."""

    def learn(self, descriptor: int) -> None:
        """Remember the open device as the board, for example at the start of a run."""
        self._board = self._held = self._of_number(os.fstat(descriptor).st_rdev)

    @property
    def settled(self) -> bool:
        """True if the device that was opened last is the known board. Also True if no board is known yet."""
        return self._held == self._board

    @property
    def usb(self) -> str:
        """Device.text of the device that was opened last. Empty if it is not a USB device."""
        return self._held.text if self._held else ""

    def believe(self) -> None:
        """Record that the open device is the board, because it has answered as the board does."""
        self.sure, self._board, self._neighbours = True, self._held, frozenset()

    def look_around(self) -> None:
        """Remember which other devices are present together with the board. If the board is lost, a device that stays
        in its socket is not taken for the board."""
        if self.settled and self._board and self._board in (there := frozenset(self._devices().values())):
            self._neighbours = there - {self._board}

    def open(self, now_ns: int) -> int:
        """Open the board's port exclusively, wherever it is. Returns its descriptor, or -1 if that fails. Never
        raises."""
        if self._board is None:  # only the board's path is known
            return self._open(self._path, None, sure=True)
        at_path = self._at_path()
        if at_path == self._board:
            return self._open(self._path, at_path, sure=True)
        if now_ns < self._look_at_ns:
            return -1
        self._look_at_ns = now_ns + SEARCH_EVERY_NS
        devices = self._devices()
        device, sure = pick(Search(self._board, self._neighbours, devices.values(), at_path))
        path = next((path for path, each in devices.items() if each == device), "")
        return self._open(path, device, sure=sure) if path else -1

    def misplaced(self) -> bool:
        """True if the board is certainly present, but another device is open."""
        if self.settled or self._board is None:
            return False
        device, sure = pick(Search(self._board, self._neighbours, self._devices().values(), self._at_path()))
        return sure and device != self._held

    def _open(self, path: str, device: Device | None, *, sure: bool) -> int:
        descriptor = port.open_if_there(path, self._line)
        if descriptor < 0:
            return -1
        self._held = self._of_number(os.fstat(descriptor).st_rdev)
        if device and self._held != device:  # another device has got this number in the meantime
            port.close_port(descriptor)
            return -1
        self.at, self.sure = path, sure
        self._board = self._board or self._held
        return descriptor

    def _of_number(self, number: int) -> Device | None:
        return of_number(number, self._sysfs)

    def _at_path(self) -> Device | None:
        try:
            return self._of_number(os.stat(self._path).st_rdev)
        except OSError:
            return None

    def _devices(self) -> dict[str, Device]:
        """Return the devices with the board's vendor and product, by path. The device at the path in the settings is
        always included."""
        at_path = self._at_path()
        return ({self._path: at_path} if at_path else {}) | usb_ports(self._board, self._sysfs)
