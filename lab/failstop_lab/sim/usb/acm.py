"""The board's USB chip as a pure model: transfers and times in; answers, and the bytes that reach the board, out.

It is as strict as the chip. Bytes that come while the host has set another speed are noise: counted, and never handed
on. It takes CHIP_OUT bytes ahead of its serial wire and leaves further transfers unanswered (NAK), or all of them while
it is `held`. A reset of the bus makes it forget the speed, unless `keeps_speed` is set. A transport (usbip, usbredir)
hands it transfers under tokens of its own and takes the answers from `done`.
"""

from __future__ import annotations

import struct
from collections import deque
from typing import Any, NamedTuple

from failstop_lab.sim.model import NEVER_NS
from failstop_lab.sim.usb import descriptors

BAUD = 1_000_000
BYTE_NS = 10_000
CHIP_OUT = 1024
"""Bytes that the chip takes ahead of its wire."""
CHIP_IN = 4096
"""Bytes that it keeps for a host that does not ask; then it loses them."""

# Requests: the kind (direction, type) and the number.
_GET_STATUS, _GET_DESCRIPTOR, _GET_CONFIGURATION, _SET_CONFIGURATION, _GET_INTERFACE = 0, 6, 8, 9, 10
_TAKEN = frozenset({1, 3, 5, 11})
"""CLEAR_FEATURE, SET_FEATURE, SET_ADDRESS, SET_INTERFACE: nothing to be done for them."""
_SET_LINE_CODING, _GET_LINE_CODING, _SET_LINES, _SEND_BREAK = 0x20, 0x21, 0x22, 0x23
_CLASS = 0x20
_TYPE = 0x60
_IN = 0x80
_DTR, _RTS = 1, 2


class Coding(NamedTuple):
    """A line coding: bit/s; stop bits and parity as CDC numbers them; data bits."""

    baud: int = 9600
    stop: int = 0
    parity: int = 0
    bits: int = 8


BOARD_CODING = Coding(BAUD)
"""The line coding of the board's processor."""
_CODING = struct.Struct("<IBBB")

Token = Any


class Setup(NamedTuple):
    """The eight bytes of a control request."""

    kind: int
    request: int
    value: int
    where: int
    length: int


class Done(NamedTuple):
    """A transfer that is answered, with what came in by it."""

    token: Token
    data: bytes = b""
    length: int = 0
    """How many bytes the transfer carried to the device."""


class _Out(NamedTuple):
    token: Token
    data: bytes


class Acm:
    """The chip, as it is when it gets its power."""

    def __init__(self, serial: str = descriptors.SERIAL) -> None:
        self.serial = serial
        self.held = False
        self.keeps_speed = False
        self.resets = 0
        """How often DTR went off while RTS was on: the board's processor is reset."""
        self.noise_bytes = 0
        self.lost_up_bytes = 0
        self.codings = 0
        """How often the host has set the line coding."""
        self.bus_resets = 0
        self.done: list[Done] = []
        self.arrived: list[tuple[int, bytes]] = []
        self._wire_free_ns = 0
        self.power_on()

    def power_on(self) -> None:
        """The plug is in again: nothing of before is left."""
        self.coding = Coding()
        self._forget()

    def bus_reset(self) -> None:
        """The host has reset the bus, as it does after a sleep."""
        self.bus_resets += 1
        if not self.keeps_speed:
            self.coding = Coding()
        self._forget()

    def _forget(self) -> None:
        self.configuration = 0
        self.dtr = self.rts = False
        self._up = bytearray()
        self._in: deque[tuple[Token, int]] = deque()
        self._out: deque[_Out] = deque()
        self._notify: list[Token] = []
        self.done.clear()

    # Control.

    def control(self, setup: Setup, data: bytes = b"") -> bytes | None:
        """The answer, empty for a request that is taken; None refuses it (STALL)."""
        if setup.kind & _TYPE == _CLASS:
            return self._class_request(setup, data)
        if setup.request == _GET_DESCRIPTOR and setup.kind & _IN:
            found = descriptors.describe(setup.value >> 8, setup.value & 0xFF, self.serial)
            return found if found is None else found[: setup.length]
        if setup.request == _SET_CONFIGURATION:
            self.configuration = setup.value
            return b""
        answers = {_GET_STATUS: b"\0\0", _GET_CONFIGURATION: bytes((self.configuration,)), _GET_INTERFACE: b"\0"}
        if setup.kind & _IN:
            return answers.get(setup.request)
        return b"" if setup.request in _TAKEN else None

    def _class_request(self, setup: Setup, data: bytes) -> bytes | None:
        if setup.request == _SET_LINE_CODING and len(data) >= _CODING.size:
            self.coding = Coding(*_CODING.unpack_from(data))
            self.codings += 1
        elif setup.request == _GET_LINE_CODING:
            return _CODING.pack(*self.coding)
        elif setup.request == _SET_LINES:
            self.dtr, self.rts = bool(setup.value & _DTR), bool(setup.value & _RTS)
            self.resets += self.rts and not self.dtr
        elif setup.request != _SEND_BREAK:
            return None
        return b""

    # Transfers.

    def host_out(self, token: Token, data: bytes, now_ns: int) -> None:
        """Bytes for the board; answered when the chip has room for them."""
        self._out.append(_Out(token, data))
        self.advance(now_ns)

    def host_in(self, token: Token, length: int) -> None:
        """The host asks for bytes of the board; answered when there are any."""
        self._in.append((token, length))
        self._answer_in()

    def host_notify(self, token: Token) -> None:
        """The host asks for changes of the line's state; there is never one."""
        self._notify.append(token)

    def cancel(self, token: Token) -> bool:
        """Forget a transfer; False when it is not waiting, because it was answered."""
        for waiting in (self._out, self._in):
            for entry in waiting:
                if entry[0] == token:
                    waiting.remove(entry)  # type: ignore[arg-type]
                    return True
        if token in self._notify:
            self._notify.remove(token)
            return True
        return False

    @property
    def unanswered(self) -> int:
        """Transfers to the board that wait."""
        return len(self._out)

    @property
    def asked(self) -> bool:
        """Whether the host waits for bytes: the driver does so while somebody has the port open."""
        return bool(self._in)

    @property
    def next_ns(self) -> int:
        """When advance() is next due."""
        return self._due_ns() if self._out and not self.held else NEVER_NS

    def _due_ns(self) -> int:
        return self._wire_free_ns + (len(self._out[0].data) - CHIP_OUT) * BYTE_NS

    def advance(self, now_ns: int) -> None:
        """Take what there is room for by now."""
        while self._out and not self.held and self._due_ns() <= now_ns:
            token, data = self._out.popleft()
            self._wire_free_ns = max(self._wire_free_ns, now_ns) + len(data) * BYTE_NS
            if self.coding == BOARD_CODING:
                self.arrived.append((now_ns, data))
            else:
                self.noise_bytes += len(data)
            self.done.append(Done(token, length=len(data)))

    def send(self, data: bytes) -> None:
        """Bytes from the board's processor to the host. At another speed the host reads noise: zeros."""
        room = max(CHIP_IN - len(self._up), 0)
        self._up += data[:room] if self.coding == BOARD_CODING else bytes(len(data[:room]))
        self.lost_up_bytes += len(data) - len(data[:room])
        self._answer_in()

    def _answer_in(self) -> None:
        while self._up and self._in:
            token, length = self._in.popleft()
            data = bytes(self._up[:length])
            del self._up[: len(data)]
            self.done.append(Done(token, data))
