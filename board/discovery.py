"""Which serial devices there are, the controller board's first: for error messages."""

from __future__ import annotations

# The board's USB serial chip (udev identity 1a86:55d4).
BOARD_VID = 0x1A86
BOARD_PID = 0x55D4
LINK = "/dev/failstop"
"""The board's name by the udev rule that `failstop install` brings: a replug may change its number, and not this."""


def board_there() -> bool:
    """A controller board is plugged in."""
    from serial.tools import list_ports

    return any((port.vid, port.pid) == (BOARD_VID, BOARD_PID) for port in list_ports.comports())


def candidates() -> list[tuple[str, str]]:
    """(path, description) of each serial device: controller boards first, then other USB devices, then the rest."""
    # Imported here: listing is slow, and nothing on the stop path asks for it.
    from serial.tools import list_ports

    found: list[tuple[int, str, str]] = []
    for port in list_ports.comports():
        if port.vid is None or port.pid is None:
            found.append((2, str(port.device), str(port.description)))
        elif (port.vid, port.pid) == (BOARD_VID, BOARD_PID):
            found.append((0, str(port.device), f"{port.description}, USB {port.vid:04x}:{port.pid:04x}: the board's"))
        else:
            found.append((1, str(port.device), f"{port.description}, USB {port.vid:04x}:{port.pid:04x}"))
    return [(path, description) for _, path, description in sorted(found)]
