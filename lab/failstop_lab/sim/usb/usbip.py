"""USB/IP as the kernel's vhci_hcd speaks it over a stream, from the first URB on: bytes in, bytes out.

The format: Documentation/usb/usbip_protocol.rst of the kernel. Every message begins with 48 bytes, big-endian but for a
control request's own eight.
"""

from __future__ import annotations

import errno
import struct

from failstop_lab.sim.usb.acm import Acm, Done, Setup
from failstop_lab.sim.usb.descriptors import BULK_IN, BULK_OUT

DEVICE_ID = 0x00010002
SUBMIT, UNLINK, SUBMITTED, UNLINKED = 1, 2, 3, 4
SIZE = 48
_HEAD = struct.Struct(">5I")
_SUBMIT = struct.Struct(">IIIII")
_SUBMITTED = struct.Struct(">5IiIIII8x")
_UNLINKED = struct.Struct(">5Ii24x")
_SETUP = struct.Struct("<BBHHH")
_NO_ISO = 0xFFFFFFFF
_NUMBER = 0x0F


class UsbIp:
    """One connection. `output` are the bytes for the host, which the caller takes. Tokens: (number, inward)."""

    def __init__(self, device: Acm) -> None:
        self.output = bytearray()
        self._device = device
        self._input = bytearray()
        device.power_on()

    def feed(self, data: bytes, now_ns: int) -> None:
        """Take in what the host has sent."""
        self._input += data
        while (size := self._size()) and len(self._input) >= size:
            message = bytes(self._input[:size])
            del self._input[:size]
            self._message(message, now_ns)
        self.flush()

    def flush(self) -> None:
        """Put what the device has answered into the output."""
        for done in self._device.done:
            self._submitted(done)
        self._device.done.clear()

    def unplug(self) -> None:
        """The end of the connection is the end of the device."""

    def _size(self) -> int:
        """The size of the message at the beginning of the input, bytes. 0: not known yet."""
        if len(self._input) < SIZE:
            return 0
        command, _, _, inward, _ = _HEAD.unpack_from(self._input)
        length: int = _SUBMIT.unpack_from(self._input, _HEAD.size)[1]
        return SIZE + (length if command == SUBMIT and not inward else 0)

    def _message(self, message: bytes, now_ns: int) -> None:
        command, number, _, inward, endpoint = _HEAD.unpack_from(message)
        if command == UNLINK:
            (victim,) = struct.unpack_from(">I", message, _HEAD.size)
            waiting = self._device.cancel((victim, True)) or self._device.cancel((victim, False))
            # Answers made meanwhile come first, as the host expects.
            self.flush()
            self.output += _UNLINKED.pack(UNLINKED, number, 0, 0, 0, -errno.ECONNRESET if waiting else 0)
            return
        if command != SUBMIT:
            raise ValueError(f"USB/IP command {command}")
        token, data = (number, bool(inward)), message[SIZE:]
        if endpoint == 0:
            self._control(token, Setup(*_SETUP.unpack_from(message, SIZE - _SETUP.size)), data)
        elif endpoint == BULK_OUT & _NUMBER and not inward:
            self._device.host_out(token, data, now_ns)
        elif endpoint == BULK_IN & _NUMBER and inward:
            self._device.host_in(token, _SUBMIT.unpack_from(message, _HEAD.size)[1])
        else:
            self._device.host_notify(token)

    def _control(self, token: tuple[int, bool], setup: Setup, data: bytes) -> None:
        answer = self._device.control(setup, data)
        if answer is None:
            self._submitted(Done(token), -errno.EPIPE)
        else:
            self._submitted(Done(token, answer, len(data)))

    def _submitted(self, done: Done, status: int = 0) -> None:
        number, inward = done.token
        length = len(done.data) if inward else done.length
        self.output += _SUBMITTED.pack(SUBMITTED, number, 0, 0, 0, status, length, 0, _NO_ISO, 0)
        self.output += done.data if inward else b""
