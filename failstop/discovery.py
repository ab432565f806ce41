"""Which serial devices there are, the controller board's first: for error messages."""

from __future__ import annotations

from collections.abc import Iterator

# The board's USB serial chip (udev identity 1a86:55d4).
BOARD_VID = 0x1A86
BOARD_PID = 0x55D4
LINK = "/dev/failstop"
"""The board's name by the udev rule of the Debian package: a replug may change its number, and not this."""


def board_there() -> bool:
    """A controller board is plugged in."""
    return any(rank == BOARDS for rank, *_ in _ranked())


def candidates() -> list[tuple[str, str]]:
    """(path, description) of each serial device: controller boards first, then other USB devices, then the rest."""
    return [(path, description) for _, path, description in sorted(_ranked())]


BOARDS, OTHER_USB, NO_USB = range(3)


def _ranked() -> Iterator[tuple[int, str, str]]:
    # Imported here: listing is slow, and nothing on the stop path asks for it.
    from serial.tools import list_ports

    for port in list_ports.comports():
        if port.vid is None or port.pid is None:
            yield NO_USB, str(port.device), str(port.description)
            continue
        described = f"{port.description}, USB {port.vid:04x}:{port.pid:04x}"
        if (port.vid, port.pid) == (BOARD_VID, BOARD_PID):
            yield BOARDS, str(port.device), f"{described}: the board's"
        else:
            yield OTHER_USB, str(port.device), described
