"""Descriptors of the board's USB chip: one configuration, one CDC-ACM function (1a86:55d4, as the CH9102)."""

from __future__ import annotations

import struct

VENDOR, PRODUCT, RELEASE = 0x1A86, 0x55D4, 0x0443
SERIAL = "5A7B012345"
CONFIGURATION = 1
NOTIFY, BULK_OUT, BULK_IN = 0x83, 0x02, 0x82
"""Endpoints: line state changes, bytes to the board, bytes from it."""
PACKET = 64
NOTIFY_PACKET, NOTIFY_INTERVAL_MS = 16, 10
SPEED = 2
"""Full, in the numbers of USB/IP (usb_device_speed)."""

DEVICE, CONFIG, STRING = 1, 2, 3
"""Descriptor types of chapter 9 of the USB specification."""
_INTERFACE, _ENDPOINT, _ASSOCIATION, _FUNCTIONAL = 4, 5, 0x0B, 0x24
_COMMUNICATIONS, _ACM, _DATA = 2, 2, 10
_MANUFACTURER, _PRODUCT = "wch.cn", "USB Single Serial"
_INTERRUPT, _BULK = 3, 2
_REMOTE_WAKEUP = 0xA0
_TWO_MILLIAMPERE_UNITS = 67

INTERFACES = ((_COMMUNICATIONS, _ACM, 1), (_DATA, 0, 0))
"""Class, subclass and protocol of each."""
ENDPOINTS = (
    (NOTIFY, _INTERRUPT, NOTIFY_INTERVAL_MS, 0, NOTIFY_PACKET),
    (BULK_OUT, _BULK, 0, 1, PACKET),
    (BULK_IN, _BULK, 0, 1, PACKET),
)
"""Address, type, interval, interface and largest packet of each."""


def device() -> bytes:
    """The device descriptor."""
    return struct.pack(
        *("<BBHBBBBHHHBBBB", 18, DEVICE, 0x0200, _COMMUNICATIONS, 0, 0, PACKET),
        *(VENDOR, PRODUCT, RELEASE, 1, 2, 3, 1),
    )


def configuration() -> bytes:
    """The configuration descriptor, with all that belongs to it."""
    body = bytes((8, _ASSOCIATION, 0, 2, *INTERFACES[0], 0))
    for number, kind in enumerate(INTERFACES):
        endpoints = [endpoint for endpoint in ENDPOINTS if endpoint[3] == number]
        body += bytes((9, _INTERFACE, number, 0, len(endpoints), *kind, 0))
        body += _functional() if number == 0 else b""
        for address, transfer, interval, _, packet in endpoints:
            body += struct.pack("<BBBBHB", 7, _ENDPOINT, address, transfer, packet, interval)
    head = (9, CONFIG, 9 + len(body), len(INTERFACES), CONFIGURATION, 0, _REMOTE_WAKEUP, _TWO_MILLIAMPERE_UNITS)
    return struct.pack("<BBHBBBBB", *head) + body


def _functional() -> bytes:
    """Header (CDC 1.10), call management by nobody, line coding and state, and which interface has the data."""
    parts = ((0, 0x10, 0x01), (1, 0, 1), (2, 2), (6, 0, 1))
    return b"".join(bytes((2 + len(part), _FUNCTIONAL, *part)) for part in parts)


def string(index: int, serial: str) -> bytes | None:
    """A string descriptor; None for one that there is not."""
    if index == 0:
        return struct.pack("<BBH", 4, STRING, 0x0409)
    texts = (_MANUFACTURER, _PRODUCT, serial)
    if index > len(texts):
        return None
    data = texts[index - 1].encode("utf-16-le")
    return bytes((2 + len(data), STRING)) + data


def describe(kind: int, index: int, serial: str) -> bytes | None:
    """The descriptor that is asked for, or None."""
    if kind == DEVICE:
        return device()
    if kind == CONFIG:
        return configuration()
    return string(index, serial) if kind == STRING else None
