"""Serial devices of this machine, the controller board's first: for error messages."""

from __future__ import annotations

from collections.abc import Iterator

# The board's USB serial chip (udev identity 1a86:55d4).
BOARD_VID = 0x1A86
BOARD_PID = 0x55D4
BOARD_USB = f"{BOARD_VID:04x}:{BOARD_PID:04x}"
LINK = "/dev/failstop"
"""The board's name by the udev rule of the Debian package: a replug may change its number, and not this."""


def usb_id(path: str) -> str:
    """vendor:product of a device in hexadecimal; empty: it is no serial port on USB."""
    return next((usb for device, _, usb in _ports() if device == path), "")


def candidates() -> list[tuple[str, str]]:
    """(path, description) of each serial device: controller boards first, then other USB devices, then the rest."""
    found = []
    for path, described, usb in _ports():
        whose = ": the board's" if usb == BOARD_USB else ""
        found.append((usb != BOARD_USB, not usb, path, f"{described}, USB {usb}{whose}" if usb else described))
    return [(path, described) for _, _, path, described in sorted(found)]


def _ports() -> Iterator[tuple[str, str, str]]:
    """(path, description, vendor:product if it is on USB) of each serial device."""
    # Imported here: listing is slow, and nothing on the stop path asks for it.
    from serial.tools import list_ports

    for port in list_ports.comports():
        usb = "" if port.vid is None or port.pid is None else f"{port.vid:04x}:{port.pid:04x}"
        yield str(port.device), str(port.description), usb
