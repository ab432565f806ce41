"""The simulated board's port on USB: what pty_port.PtyPort is on a pty, with the descriptors of its transport."""

from __future__ import annotations

import contextlib
import select
import socket
import time
from typing import Any

from failstop_lab.sim.model import NEVER_NS
from failstop_lab.sim.pty_port import SimError
from failstop_lab.sim.usb import vhci
from failstop_lab.sim.usb.acm import Acm
from failstop_lab.sim.usb.usbip import UsbIp
from failstop_lab.sim.usb.usbredir import UsbRedir

VHCI = "vhci"
"""The place that is this machine's own virtual controller; every other is HOST:PORT of a usbredir host."""
_READ_SIZE = 65536
_RETRY_NS = 200_000_000


class UsbPort:
    """The board's USB chip, plugged into `place`. The kernel names the port; `link` is the control socket's place."""

    def __init__(self, epoll: select.epoll, link: str, place: str) -> None:
        self.link = link
        self.more = False
        self.device = Acm()
        self._epoll = epoll
        self._place = place
        self._plugged = False
        self._connection: socket.socket | None = None
        self._transport: UsbIp | UsbRedir | None = None
        self._controllers_port = -1
        self._retry_ns = NEVER_NS
        if place == VHCI:
            vhci.check_controller()

    @property
    def node(self) -> str:
        """The tty that this machine's kernel gave it; empty while it has none, and always with usbredir."""
        return vhci.node(self._controllers_port) if self._place == VHCI and self._connection else ""

    @property
    def plugged(self) -> bool:
        """Whether the plug is in."""
        return self._plugged

    @property
    def opened(self) -> bool:
        """Whether any process has the port open."""
        return self.device.asked

    @property
    def draining(self) -> bool:
        """Whether the chip takes bytes."""
        return not self.device.held

    @draining.setter
    def draining(self, on: bool) -> None:
        self.device.held = not on
        self.more = on

    @property
    def lost_up_bytes(self) -> int:
        """Bytes of the board that the host did not ask for in time."""
        return self.device.lost_up_bytes

    @property
    def next_ns(self) -> int:
        """When poll() is due though nothing has come."""
        return min(self.device.next_ns, self._retry_ns)

    def info(self) -> dict[str, Any]:
        """Acts of the host on the chip."""
        device = self.device
        return {
            "connected": self._connection is not None,
            "coding": list(device.coding),
            "codings": device.codings,
            "dtr": device.dtr,
            "rts": device.rts,
            "resets": device.resets,
            "bus_resets": device.bus_resets,
            "noise_bytes": device.noise_bytes,
            "unanswered": device.unanswered,
        }

    def plug(self, link: str | None = None) -> None:
        """The plug goes in. Raises SimError."""
        if self._plugged:
            raise SimError("the board is plugged in already: unplug it first")
        if link is not None:
            raise SimError("the kernel names a port on USB: plug it in without a link")
        self._plugged = True
        if isinstance(self._transport, UsbRedir):
            self._transport.plug()
            self._pass_on()
        else:
            self._connect()

    def unplug(self) -> None:
        """The plug is pulled: the host sees the device gone."""
        self._plugged = False
        if isinstance(self._transport, UsbRedir):
            self._transport.unplug()
            self._pass_on()
        elif self._connection is not None:
            self._drop()
        self.device.power_on()

    def close(self) -> None:
        """Take the board away for good."""
        if self._plugged:
            self.unplug()
        if self._connection is not None:
            self._drop()

    def owns(self, descriptor: int) -> bool:
        """Whether a descriptor that epoll reported is this port's."""
        return self._connection is not None and descriptor == self._connection.fileno()

    def reported(self, mask: int) -> None:
        """A pty's last close is reported; here the driver's requests tell."""

    def poll(self) -> list[tuple[int, bytes]]:
        """Serve the host; return what has come to the board: (time, bytes) each."""
        self.more = False
        if self._connection is None:
            if self._plugged and time.monotonic_ns() >= self._retry_ns:
                self._connect()
            return []
        with contextlib.suppress(BlockingIOError):
            self._receive(self._connection)
        if self._transport is not None:
            self.device.advance(time.monotonic_ns())
            self._transport.flush()
            self._pass_on()
        arrived, self.device.arrived = self.device.arrived, []
        return arrived

    def send(self, frame: bytes) -> None:
        """Send to whoever has the port open."""
        if self._transport is None or not self._plugged:
            return
        self.device.send(frame)
        self._transport.flush()
        self._pass_on()

    def _receive(self, connection: socket.socket) -> None:
        try:
            data = connection.recv(_READ_SIZE, socket.MSG_DONTWAIT)
        except ConnectionError:
            data = b""
        now_ns = time.monotonic_ns()
        if not data:
            self._gone()
        elif self._transport is not None:
            try:
                self._transport.feed(data, now_ns)
            except ValueError:
                self._gone()

    def _gone(self) -> None:
        """The host has gone; a usbredir host may come again."""
        self._drop()
        self.device.power_on()
        self._retry_ns = NEVER_NS if self._place == VHCI else time.monotonic_ns() + _RETRY_NS

    def _pass_on(self) -> None:
        if self._connection is None or self._transport is None or not self._transport.output:
            return
        data, self._transport.output = self._transport.output, bytearray()
        # Blocking, in short: the host's side is a thread of the kernel's, or qemu, which always reads.
        with contextlib.suppress(OSError):
            self._connection.sendall(data)

    def _connect(self) -> None:
        self._retry_ns = NEVER_NS
        if self._place == VHCI:
            ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
            with theirs:
                try:
                    self._controllers_port = vhci.plug_in(theirs)
                except SimError:
                    ours.close()
                    self._plugged = False
                    raise
            self._transport = UsbIp(self.device)
        else:
            try:
                ours = _dial(self._place)
            except OSError:
                self._retry_ns = time.monotonic_ns() + _RETRY_NS
                return
            self._transport = UsbRedir(self.device)
        self._connection = ours
        self._epoll.register(ours, select.EPOLLIN)
        self._pass_on()

    def _drop(self) -> None:
        assert self._connection is not None
        self._epoll.unregister(self._connection)
        self._connection.close()
        self._connection = self._transport = None


def _dial(place: str) -> socket.socket:
    if "/" in place:
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            connection.connect(place)
        except OSError:
            connection.close()
            raise
        return connection
    host, _, number = place.rpartition(":")
    connection = socket.create_connection((host, int(number)), timeout=1.0)
    connection.settimeout(None)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return connection
