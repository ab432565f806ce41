"""Serial devices for error messages: the board's first."""

from __future__ import annotations

import os
import stat
from types import SimpleNamespace

import pytest
from serial.tools import list_ports

from failstop.doctor.system import System


def test_listing_puts_the_board_first(monkeypatch: pytest.MonkeyPatch) -> None:
    ports = [
        SimpleNamespace(device="/dev/ttyS0", description="n/a", vid=None, pid=None),
        SimpleNamespace(device="/dev/ttyUSB0", description="USB Serial", vid=0x1A86, pid=0x7523),
        SimpleNamespace(device="/dev/ttyACM1", description="Board B", vid=0x1A86, pid=0x55D4),
        SimpleNamespace(device="/dev/ttyACM0", description="Board A", vid=0x1A86, pid=0x55D4),
    ]
    monkeypatch.setattr(list_ports, "comports", lambda: ports)
    listed = [path.removeprefix("/dev/tty") for path, _ in System().ports(["1a86:55d4"])]
    assert listed == ["ACM0", "ACM1", "USB0", "S0"]
    assert dict(System().ports(["1a86:55d4"]))["/dev/ttyUSB0"] == "USB Serial, USB 1a86:7523"
    assert "the board's" in dict(System().ports(["1a86:55d4"]))["/dev/ttyACM0"]
    assert "the board's" not in " ".join(what for _, what in System().ports([]))


def test_listing_really_lists() -> None:
    for path, description in System().ports(()):
        assert stat.S_ISCHR(os.stat(path).st_mode), description
