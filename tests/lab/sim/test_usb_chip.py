"""The board's USB chip: descriptors that agree with each other, requests, the speed, the room it has."""

from __future__ import annotations

import struct

import pytest

from failstop_lab.sim.usb import acm, descriptors
from failstop_lab.sim.usb.acm import Acm, Setup

IN = 0x80


def chip(baud: int = acm.BAUD) -> Acm:
    """A chip that the host has opened at that speed."""
    device = Acm()
    set_speed(device, baud)
    return device


def set_speed(device: Acm, baud: int, stop: int = 0, parity: int = 0, bits: int = 8) -> None:
    assert device.control(Setup(0x21, 0x20, 0, 0, 7), struct.pack("<IBBB", baud, stop, parity, bits)) == b""


def lines(device: Acm, *, dtr: bool, rts: bool) -> None:
    assert device.control(Setup(0x21, 0x22, dtr | rts << 1, 0, 0)) == b""


def test_descriptors_have_the_lengths_that_they_say() -> None:
    found = descriptors.configuration()
    assert struct.unpack_from("<H", found, 2) == (len(found),)
    kinds, at = [], 0
    while at < len(found):
        kinds.append(found[at + 1])
        assert found[at] >= 2
        at += found[at]
    assert at == len(found)
    assert kinds.count(4) == found[4] == 2, "interfaces"
    assert kinds.count(5) == 3, "endpoints"
    assert len(descriptors.device()) == descriptors.device()[0] == 18


def test_the_device_is_the_one_of_the_udev_rule() -> None:
    vendor, product = struct.unpack_from("<HH", descriptors.device(), 8)
    assert (vendor, product) == (0x1A86, 0x55D4)


def test_strings_and_what_there_is_not() -> None:
    device = Acm("N0")
    assert device.control(Setup(IN, 6, 0x0300, 0, 255)) == bytes((4, 3, 9, 4))
    assert device.control(Setup(IN, 6, 0x0303, 0x409, 255)) == bytes((6, 3)) + "N0".encode("utf-16-le")
    assert device.control(Setup(IN, 6, 0x0304, 0x409, 255)) is None
    assert device.control(Setup(IN, 6, 0x0F00, 0, 255)) is None, "no BOS"


@pytest.mark.parametrize("length", [1, 8, 9, 18, 255])
def test_no_more_of_a_descriptor_than_is_asked_for(length: int) -> None:
    found = Acm().control(Setup(IN, 6, 0x0100, 0, length))
    assert found == descriptors.device()[:length]


def test_the_configuration_that_is_set_is_the_one_that_is_told() -> None:
    device = Acm()
    assert device.control(Setup(IN, 8, 0, 0, 1)) == b"\0"
    assert device.control(Setup(0, 9, 1, 0, 0)) == b""
    assert device.control(Setup(IN, 8, 0, 0, 1)) == b"\x01"
    assert device.control(Setup(0x40, 0x77, 0, 0, 0)) is None


@pytest.mark.parametrize("coding", [(9600,), (500_000,), (1_000_000, 2), (1_000_000, 0, 1), (1_000_000, 0, 0, 7)])
def test_bytes_at_another_speed_are_noise(coding: tuple[int, ...]) -> None:
    device = chip()
    set_speed(device, *coding)
    device.host_out("t", b"abc", 0)
    assert [done.token for done in device.done] == ["t"], "the host can't tell"
    assert device.arrived == []
    assert device.noise_bytes == 3
    set_speed(device, acm.BAUD)
    device.host_out("u", b"def", 10**9)
    assert device.arrived == [(10**9, b"def")]


def test_the_line_coding_is_told_as_it_was_set() -> None:
    device = Acm()
    assert device.control(Setup(0xA1, 0x21, 0, 0, 7)) == struct.pack("<IBBB", 9600, 0, 0, 8)
    set_speed(device, 500_000, 2, 1, 7)
    assert device.control(Setup(0xA1, 0x21, 0, 0, 7)) == struct.pack("<IBBB", 500_000, 2, 1, 7)
    assert device.codings == 1


def test_a_bus_reset_forgets_the_speed_unless_it_is_kept() -> None:
    device = chip()
    device.bus_reset()
    device.host_out("t", b"abc", 0)
    assert device.noise_bytes == 3
    device = chip()
    device.keeps_speed = True
    device.bus_reset()
    device.host_out("t", b"abc", 0)
    assert device.arrived == [(0, b"abc")]
    device.power_on()
    assert device.coding == acm.Coding(), "an unplug takes its power in any case"


def test_dtr_off_while_rts_is_on_resets_the_boards_processor() -> None:
    device = Acm()
    for dtr, rts, resets in ((1, 1, 0), (1, 0, 0), (0, 0, 0), (0, 1, 1), (1, 1, 1), (0, 1, 2)):
        lines(device, dtr=bool(dtr), rts=bool(rts))
        assert device.resets == resets


def test_it_takes_what_it_has_room_for_and_the_rest_when_the_wire_is_free() -> None:
    device = chip()
    device.host_out(1, bytes(acm.CHIP_OUT), 0)
    device.host_out(2, b"x" * 100, 0)
    assert [done.token for done in device.done] == [1]
    due_ns = 100 * acm.BYTE_NS
    assert device.next_ns == due_ns
    device.advance(due_ns - 1)
    assert device.unanswered == 1
    device.advance(due_ns)
    assert [done.token for done in device.done] == [1, 2]
    assert device.next_ns == acm.NEVER_NS  # type: ignore[attr-defined]


def test_while_held_it_takes_nothing_and_then_all_of_it_in_order() -> None:
    device = chip()
    device.held = True
    device.host_out(1, b"a", 0)
    device.host_out(2, b"b", 0)
    device.advance(10**9)
    assert (device.unanswered, device.arrived, device.next_ns) == (2, [], acm.NEVER_NS)  # type: ignore[attr-defined]
    device.held = False
    device.advance(10**9)
    assert device.arrived == [(10**9, b"a"), (10**9, b"b")]


def test_a_cancelled_transfer_never_arrives() -> None:
    device = chip()
    device.held = True
    device.host_out(1, b"a", 0)
    device.host_out(2, b"b", 0)
    device.host_in(3, 64)
    device.host_notify(4)
    assert all(device.cancel(token) for token in (1, 3, 4))
    assert not device.cancel(1)
    device.held = False
    device.advance(0)
    device.send(b"up")
    assert device.arrived == [(0, b"b")]
    assert [done.token for done in device.done] == [2]


def test_what_goes_up_waits_for_the_host_and_is_lost_beyond_the_room() -> None:
    device = chip()
    device.send(bytes(range(100)))
    assert not device.asked
    device.host_in(1, 64)
    device.host_in(2, 64)
    assert [(done.token, done.data) for done in device.done] == [(1, bytes(range(64))), (2, bytes(range(64, 100)))]
    device.host_in(3, 64)
    assert device.asked
    device.send(b"z")
    assert device.done[-1].data == b"z"
    device.send(bytes(acm.CHIP_IN + 10))
    assert device.lost_up_bytes == 10


def test_what_goes_up_at_another_speed_is_not_what_was_sent() -> None:
    device = chip(500_000)
    device.host_in(1, 64)
    device.send(b"hello")
    assert device.done[-1].data == bytes(5)
