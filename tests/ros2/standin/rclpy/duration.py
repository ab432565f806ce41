"""The stand-in's duration."""

from __future__ import annotations


class Duration:
    def __init__(self, *, seconds: float = 0) -> None:
        self.nanoseconds = round(seconds * 1e9)
