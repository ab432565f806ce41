"""Stand-ins: what takes the place of a module in the code under test."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from failstop.board import stop_port


class Time:
    """A stand-in for `time`: every look takes a microsecond, and a sleep no real time."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def monotonic(self) -> float:
        self.now_s += 1e-6
        return self.now_s

    def monotonic_ns(self) -> int:
        return round(self.monotonic() * 1e9)

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds


def before_write(monkeypatch: pytest.MonkeyPatch, takes: Callable[[int, bytes], int]) -> None:
    """`takes` stands before os.write for whoever bursts."""

    class Os:
        write = staticmethod(takes)

    monkeypatch.setattr(stop_port, "os", Os)
