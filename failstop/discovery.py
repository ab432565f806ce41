"""Serial devices of this machine, the board's first: for error messages."""

from __future__ import annotations

from collections.abc import Collection, Iterator

ADAPTERS = {
    "0403:6001": "FT232",
    "0403:6015": "FT231X",
    "067b:2303": "PL2303",
    "10c4:ea60": "CP210x",
    "1a86:55d3": "CH343",
    "1a86:55d4": "CH9102",
    "1a86:7523": "CH340",
}
"""Chips with a serial port and their makers' identity, in devices of any kind."""
LINK = "/dev/failstop"
"""The board's name by the udev rule of the Debian package: a replug may change its number, and not this."""


def usb_id(path: str) -> str:
    """vendor:product of a device in hexadecimal; empty: it is no serial port on USB."""
    return next((usb for device, _, usb in _ports() if device == path), "")


def candidates(own: Collection[str]) -> list[tuple[str, str]]:
    """(path, description) of each serial device: those with one of the board's identities, vendor:product, first, then
    other USB devices, then the rest."""
    found = []
    for path, described, usb in _ports():
        whose = ": the board's" if usb in own else ""
        found.append((usb not in own, not usb, path, f"{described}, USB {usb}{whose}" if usb else described))
    return [(path, described) for _, _, path, described in sorted(found)]


def _ports() -> Iterator[tuple[str, str, str]]:
    """(path, description, vendor:product if it is on USB) of each serial device."""
    # Imported here: listing is slow, and nothing on the stop path asks for it.
    from serial.tools import list_ports

    for port in list_ports.comports():
        usb = "" if port.vid is None or port.pid is None else f"{port.vid:04x}:{port.pid:04x}"
        yield str(port.device), str(port.description), usb
