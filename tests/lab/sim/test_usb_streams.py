"""USB/IP and usbredir, as the kernel and qemu speak them: whatever the pieces, the same answers."""

from __future__ import annotations

import errno
import struct

import pytest

from failstop_lab.sim.pty_port import SimError
from failstop_lab.sim.usb import acm, descriptors, usbredir, vhci
from failstop_lab.sim.usb.acm import Acm
from failstop_lab.sim.usb.port import VHCI, UsbPort
from failstop_lab.sim.usb.usbip import SUBMITTED, UNLINKED, UsbIp
from failstop_lab.sim.usb.usbredir import UsbRedir

CODING = struct.pack("<IBBB", acm.BAUD, 0, 0, 8)


# USB/IP.


def submit(
    number: int, endpoint: int, *, inward: bool = False, data: bytes = b"", length: int = 0, setup: bytes = b""
) -> bytes:
    length = length or len(data)
    head = struct.pack(">5I", 1, number, 0x10002, int(inward), endpoint)
    return head + struct.pack(">IIIII", 0, length, 0, 0, 0) + setup.ljust(8, b"\0") + data


def unlink(number: int, victim: int) -> bytes:
    return struct.pack(">5II", 2, number, 0x10002, 0, 0, victim).ljust(48, b"\0")


def usbip_answers(output: bytearray, inward: frozenset[int] = frozenset()) -> list[tuple[int, int, int, bytes]]:
    """(command, number, status, data) of each."""
    found, at = [], 0
    while at < len(output):
        command, number, *_, status, length = struct.unpack_from(">5IiI", output, at)
        at += 48
        data = b""
        if command == SUBMITTED and number in inward:
            data = bytes(output[at : at + length])
            at += length
        found.append((command, number, status, data))
    assert at == len(output)
    return found


SETUP_CODING = struct.pack("<BBHHH", 0x21, 0x20, 0, 0, 7)
SETUP_DEVICE = struct.pack("<BBHHH", 0x80, 6, 0x0100, 0, 64)
SETUP_BOS = struct.pack("<BBHHH", 0x80, 6, 0x0F00, 0, 5)
SESSION = [
    submit(1, 0, inward=True, length=64, setup=SETUP_DEVICE),
    submit(2, 0, inward=True, length=5, setup=SETUP_BOS),
    submit(3, 0, data=CODING, setup=SETUP_CODING),
    submit(4, 2, inward=True, length=128),
    submit(5, 3, inward=True, length=16),
    submit(6, 2, data=b"stop"),
]


@pytest.mark.parametrize("piece", [1, 7, 48, 10_000])
def test_a_session_of_usbip_in_pieces(piece: int) -> None:
    device = Acm()
    stream = UsbIp(device)
    sent = b"".join(SESSION)
    for at in range(0, len(sent), piece):
        stream.feed(sent[at : at + piece], 5)
    device.send(b"imu")
    stream.flush()
    assert device.arrived == [(5, b"stop")]
    assert usbip_answers(stream.output, frozenset({1, 4})) == [
        (SUBMITTED, 1, 0, descriptors.device()),
        (SUBMITTED, 2, -errno.EPIPE, b""),
        (SUBMITTED, 3, 0, b""),
        (SUBMITTED, 6, 0, b""),
        (SUBMITTED, 4, 0, b"imu"),
    ]


def test_an_unlinked_transfer_is_answered_once() -> None:
    device = Acm()
    stream = UsbIp(device)
    device.held = True
    stream.feed(submit(1, 2, data=b"old") + unlink(2, 1) + unlink(3, 1), 0)
    device.held = False
    device.advance(0)
    stream.flush()
    assert usbip_answers(stream.output) == [(UNLINKED, 2, -errno.ECONNRESET, b""), (UNLINKED, 3, 0, b"")]


def test_the_length_that_went_out_is_told() -> None:
    device = Acm()
    stream = UsbIp(device)
    stream.feed(submit(9, 2, data=bytes(77)), 0)
    assert struct.unpack_from(">5IiI", stream.output)[6] == 77


def test_what_is_no_usbip_is_refused() -> None:
    with pytest.raises(ValueError, match="command 9"):
        UsbIp(Acm()).feed(struct.pack(">5I", 9, 1, 0, 1, 0).ljust(48, b"\0"), 0)


# usbredir.

HELLO = struct.pack("<III64sI", usbredir.HELLO, 68, 0, b"qemu", 0xFF)


def message(kind: int, number: int, body: bytes = b"") -> bytes:
    return struct.pack("<IIQ", kind, len(body), number) + body


def bulk(number: int, endpoint: int, length: int, data: bytes = b"") -> bytes:
    return message(usbredir.BULK, number, struct.pack("<BBHIH", endpoint, 0, length & 0xFFFF, 0, length >> 16) + data)


def control(number: int, kind: int, request: int, value: int, length: int, data: bytes = b"") -> bytes:
    body = struct.pack("<BBBBHHH", kind & 0x80, request, kind, 0, value, 0, length)
    return message(usbredir.CONTROL, number, body + data)


def redir_answers(output: bytearray) -> list[tuple[int, int, bytes]]:
    """(kind, number, body) of each after the greeting."""
    kind, length, _ = struct.unpack_from("<III", output)
    assert (kind, length) == (usbredir.HELLO, 68)
    found, at = [], 12 + length
    while at < len(output):
        kind, length, number = struct.unpack_from("<IIQ", output, at)
        at += 16
        found.append((kind, number, bytes(output[at : at + length])))
        at += length
    assert at == len(output)
    return found


@pytest.mark.parametrize("piece", [1, 16, 10_000])
def test_a_session_of_usbredir_in_pieces(piece: int) -> None:
    device = Acm()
    stream = UsbRedir(device)
    sent = HELLO + control(1, 0x80, 6, 0x0100, 64) + control(2, 0x21, 0x20, 0, 7, CODING)
    sent += bulk(3, descriptors.BULK_IN, 70_000) + bulk(4, descriptors.BULK_OUT, 4, b"stop")
    sent += message(usbredir.SET_CONFIGURATION, 5, b"\x01") + message(usbredir.START_INTERRUPT, 6, b"\x83")
    for at in range(0, len(sent), piece):
        stream.feed(sent[at : at + piece], 5)
    device.send(b"imu")
    stream.flush()
    assert device.arrived == [(5, b"stop")]
    answers = redir_answers(stream.output)
    connect = [usbredir.ENDPOINTS, usbredir.INTERFACES, usbredir.CONNECT]
    assert [kind for kind, *_ in answers][:3] == connect
    assert struct.unpack("<BBBBHHH", answers[2][2])[4:] == (0x1A86, 0x55D4, descriptors.RELEASE)
    by_number = {number: (kind, body) for kind, number, body in answers[3:]}
    assert sorted(by_number) == [1, 2, 3, 4, 5, 6]
    assert by_number[1][1][10:] == descriptors.device()
    assert by_number[1][1][3] == by_number[2][1][3] == usbredir.OK
    assert by_number[3] == (usbredir.BULK, struct.pack("<BBHIH", descriptors.BULK_IN, 0, 3, 0, 0) + b"imu")
    assert by_number[4] == (usbredir.BULK, struct.pack("<BBHIH", descriptors.BULK_OUT, 0, 4, 0, 0))
    assert by_number[5] == (usbredir.CONFIGURATION, b"\0\x01")


def test_an_unplug_keeps_the_connection_and_a_plug_tells_the_device_again() -> None:
    device = Acm()
    stream = UsbRedir(device)
    stream.feed(HELLO, 0)
    stream.unplug()
    stream.plug()
    kinds = [kind for kind, *_ in redir_answers(stream.output)]
    assert kinds == [5, 4, usbredir.CONNECT, usbredir.DISCONNECT, 5, 4, usbredir.CONNECT]


def test_a_board_that_is_away_is_not_told_to_a_new_host() -> None:
    stream = UsbRedir(Acm(), plugged=False)
    stream.feed(HELLO, 0)
    assert redir_answers(stream.output) == []


def test_a_reset_and_a_cancel() -> None:
    device = Acm()
    stream = UsbRedir(device)
    device.held = True
    stream.feed(HELLO + bulk(1, descriptors.BULK_OUT, 1, b"x") + message(usbredir.CANCEL, 1), 0)
    assert redir_answers(stream.output)[-1] == (usbredir.BULK, 1, struct.pack("<BBHIH", 2, usbredir.CANCELLED, 0, 0, 0))
    stream.feed(message(usbredir.RESET, 0), 0)
    assert device.bus_resets == 1


def test_a_host_without_what_is_needed_is_refused() -> None:
    with pytest.raises(ValueError, match="too old"):
        UsbRedir(Acm()).feed(struct.pack("<III64sI", usbredir.HELLO, 68, 0, b"old", 0), 0)


# vhci_hcd.

STATUS = """\
hub port sta spd dev      sockfd local_busid
hs  0000 006 002 00010002 000003 1-1
hs  0001 004 000 00000000 000000 0-0
ss  0008 004 000 00000000 000000 0-0
"""


def test_ports_of_the_virtual_controller() -> None:
    assert vhci.free_port(STATUS) == 1
    assert vhci.free_port(STATUS.replace("0001 004", "0001 006")) is None
    assert vhci.bus_id(STATUS, 0) == "1-1"
    assert vhci.bus_id(STATUS, 1) == ""


def test_without_the_controller_the_remedy_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(vhci, "CONTROLLER", "/nonexistent")
    with pytest.raises(SimError, match="modprobe vhci-hcd"):
        UsbPort(None, "/tmp/none", VHCI)  # type: ignore[arg-type]
