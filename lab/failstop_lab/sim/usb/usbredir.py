"""usbredir as qemu's usb-redir device speaks it over a stream: bytes in, bytes out.

The board is then on an emulated host controller, which can sleep, and lives on when the guest reboots. The format:
usbredirproto.h of the protocol's own source. Little-endian; a message is type, length, number, and its body.
"""

from __future__ import annotations

import struct

from failstop_lab.sim.usb import descriptors
from failstop_lab.sim.usb.acm import Acm, Setup
from failstop_lab.sim.usb.descriptors import BULK_IN, BULK_OUT

HELLO, CONNECT, DISCONNECT, RESET, INTERFACES, ENDPOINTS = 0, 1, 2, 3, 4, 5
SET_CONFIGURATION, GET_CONFIGURATION, CONFIGURATION, SET_ALT, GET_ALT, ALT = 6, 7, 8, 9, 10, 11
START_INTERRUPT, STOP_INTERRUPT, INTERRUPT, CANCEL, CONTROL, BULK = 15, 16, 17, 21, 100, 101
OK, CANCELLED, STALLED = 0, 1, 4

CAPABILITIES = 1 << 1 | 1 << 4 | 1 << 5 | 1 << 6
"""The device's version, endpoints' packets, numbers of 64 bits, lengths of 32 bits: what qemu has and asks for."""
VERSION = b"failstop sim"
_SHORT_HEAD, _HEAD = struct.Struct("<III"), struct.Struct("<IIQ")
_HELLO = struct.Struct("<64sI")
_CONNECT = struct.Struct("<BBBBHHH")
_CONTROL = struct.Struct("<BBBBHHH")
_BULK = struct.Struct("<BBHIH")
_FULL_SPEED = 1
_UNUSED = 255
_SLOTS = 32
"""Endpoints and interfaces that the tables have room for; inward endpoints begin at 16."""


class UsbRedir:
    """One connection. `output` are the bytes for the host, to be taken by the caller. Tokens: (number, endpoint)."""

    def __init__(self, device: Acm, plugged: bool = True) -> None:
        self.output = bytearray(_SHORT_HEAD.pack(HELLO, _HELLO.size, 0) + _HELLO.pack(VERSION, CAPABILITIES))
        self._device = device
        self._plugged = plugged
        self._input = bytearray()
        self._head = _SHORT_HEAD
        """The greetings have short numbers."""
        device.power_on()

    def feed(self, data: bytes, now_ns: int) -> None:
        """Take in what the host has sent. Raises ValueError when it is one that this can't speak to."""
        self._input += data
        while len(self._input) >= self._head.size:
            kind, length, number = self._head.unpack_from(self._input)
            size = self._head.size + length
            if len(self._input) < size:
                break
            body = bytes(self._input[self._head.size : size])
            del self._input[:size]
            self._message(kind, number, body, now_ns)
        self.flush()

    def flush(self) -> None:
        """Put what the device has answered into the output."""
        for done in self._device.done:
            number, endpoint = done.token
            self._bulk(number, endpoint, OK, done.data, done.length)
        self._device.done.clear()

    def plug(self) -> None:
        """The plug goes in again."""
        self._plugged = True
        self._device.power_on()
        self._connect()

    def unplug(self) -> None:
        """The plug is pulled; the connection stays."""
        self._plugged = False
        self._send(DISCONNECT, 0)

    def _message(self, kind: int, number: int, body: bytes, now_ns: int) -> None:
        device = self._device
        if kind == HELLO:
            if _HELLO.unpack_from(body)[1] & CAPABILITIES != CAPABILITIES:
                raise ValueError("the other side's usbredir is too old")
            self._head = _HEAD
            if self._plugged:
                self._connect()
        elif kind == RESET:
            device.bus_reset()
        elif kind == SET_CONFIGURATION:
            device.control(Setup(0, 9, body[0], 0, 0))
            self._send(CONFIGURATION, number, bytes((OK, device.configuration)))
        elif kind == GET_CONFIGURATION:
            self._send(CONFIGURATION, number, bytes((OK, device.configuration)))
        elif kind in (SET_ALT, GET_ALT):
            self._send(ALT, number, bytes((OK, body[0], 0)))
        elif kind in (START_INTERRUPT, STOP_INTERRUPT):
            self._send(INTERRUPT, number, bytes((OK, body[0])))
        elif kind == CANCEL:
            self._cancel(number)
        elif kind == CONTROL:
            self._control(number, body)
        elif kind == BULK:
            endpoint, _, low, _, high = _BULK.unpack_from(body)
            if endpoint == BULK_IN:
                device.host_in((number, endpoint), high << 16 | low)
            else:
                device.host_out((number, endpoint), body[_BULK.size :], now_ns)

    def _connect(self) -> None:
        if self._head is _SHORT_HEAD:
            return  # not greeted yet
        interfaces = [bytes(row) + bytes(_SLOTS - len(row)) for row in zip(*descriptors.INTERFACES, strict=True)]
        numbers = bytes(range(len(descriptors.INTERFACES))) + bytes(_SLOTS - len(descriptors.INTERFACES))
        self._send(ENDPOINTS, 0, _endpoints())
        self._send(INTERFACES, 0, struct.pack("<I", len(descriptors.INTERFACES)) + numbers + b"".join(interfaces))
        what = (_FULL_SPEED, 2, 0, 0, descriptors.VENDOR, descriptors.PRODUCT, descriptors.RELEASE)
        self._send(CONNECT, 0, _CONNECT.pack(*what))

    def _cancel(self, number: int) -> None:
        for endpoint in (BULK_OUT, BULK_IN):
            if self._device.cancel((number, endpoint)):
                self._bulk(number, endpoint, CANCELLED, b"", 0)

    def _control(self, number: int, body: bytes) -> None:
        endpoint, request, kind, _, value, index, length = _CONTROL.unpack_from(body)
        answer = self._device.control(Setup(kind, request, value, index, length), body[_CONTROL.size :])
        data = answer or b"" if kind & 0x80 else b""
        status = STALLED if answer is None else OK
        taken = len(data) if kind & 0x80 else length
        self._send(CONTROL, number, _CONTROL.pack(endpoint, request, kind, status, value, index, taken) + data)

    def _bulk(self, number: int, endpoint: int, status: int, data: bytes, length: int) -> None:
        length = len(data) if endpoint & 0x80 else length
        self._send(BULK, number, _BULK.pack(endpoint, status, length & 0xFFFF, 0, length >> 16) + data)

    def _send(self, kind: int, number: int, body: bytes = b"") -> None:
        self.output += self._head.pack(kind, len(body), number) + body


def _endpoints() -> bytes:
    """The table of all that there could be: type, interval, interface, largest packet."""
    kinds, intervals, owners, packets = [_UNUSED] * _SLOTS, [0] * _SLOTS, [0] * _SLOTS, [0] * _SLOTS
    for at in (0, 16):
        kinds[at], packets[at] = 0, descriptors.PACKET
    for address, kind, interval, owner, packet in descriptors.ENDPOINTS:
        at = (address & 0x0F) + (16 if address & 0x80 else 0)
        kinds[at], intervals[at], owners[at], packets[at] = kind, interval, owner, packet
    return bytes(kinds + intervals + owners) + struct.pack("<32H", *packets)
