"""USB: the serial devices of the simulated machine as its sysfs describes them, and a look-alike of the board."""

from __future__ import annotations

import dataclasses
import os
from typing import TYPE_CHECKING

from failstop_lab.machine.files import Directory, Regular
from failstop_lab.machine.port import Port
from failstop_lab.machine.users import SymbolicLink

if TYPE_CHECKING:
    from failstop_lab.machine.kernel import Machine


@dataclasses.dataclass(frozen=True)
class Plug:
    """A device's identity, and the socket that it is in. Without a serial number `serial` is empty."""

    serial: str
    place: str
    vendor: str = "1a86"
    product: str = "55d4"


class LookAlike:
    """A device that is not the board, such as a lidar with the same chip: it swallows bytes and says nothing."""

    def __init__(self, says: bytes = b"") -> None:
        """`says`: what it sends whenever bytes come."""
        self.says = says
        self.heard = bytearray()
        self.port: Port | None = None

    def receive(self, data: bytes) -> None:
        """Bytes of the port."""
        self.heard += data
        if self.port and self.says:
            self.port.send(self.says)


class Usb:
    """The folders of sysfs that tell which device a tty is."""

    def __init__(self, machine: Machine) -> None:
        self._root = machine.root
        for path in ("/sys/class/tty", "/sys/dev/char"):
            self._root.folder(path)

    def add(self, name: str, port: Port, plug: Plug) -> None:
        """A port has come, under this name of a tty."""
        below = f"/sys/devices/{plug.place}/{plug.place}:1.0"
        self._root.folder(below)
        above = self._root.folder(f"/sys/devices/{plug.place}")
        for key, value in (("idVendor", plug.vendor), ("idProduct", plug.product), ("serial", plug.serial)):
            if value:
                file = Regular(0o444)
                file.put(f"{value}\n".encode(), 0)
                _put(above, key, file)
        for path in (f"/sys/class/tty/{name}", f"/sys/dev/char/{os.major(port.device)}:{os.minor(port.device)}"):
            _put(self._root.folder(path), "device", SymbolicLink(below))

    def remove(self, name: str, port: Port, plug: Plug) -> None:
        """It has gone."""
        self._root.folder("/sys/class/tty").drop(name)
        self._root.folder("/sys/dev/char").drop(f"{os.major(port.device)}:{os.minor(port.device)}")
        self._root.folder("/sys/devices").drop(plug.place)


def _put(folder: Directory, name: str, node: Regular | SymbolicLink) -> None:
    if name in folder.names:
        folder.drop(name)
    folder.put(name, node)
