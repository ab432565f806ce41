"""Viewer: somebody who looks at the page, by any kind of connection."""

from __future__ import annotations

from typing import Protocol

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.web.devices import Device


class Closing(Protocol):
    """A connection that the page may close."""

    def close(self, code: int | None = None, reason: str | None = None) -> None:
        """Close it. `code`: the code with which a websocket is closed."""


class Viewer(Closing, Protocol):
    """A connection that shows the state."""

    def device(self) -> Device | None:
        """The paired device; None for anyone who may only watch and stop."""

    def who(self) -> str:
        """The viewer's name, for people."""

    def show(self, now_s: float, unix_s: float) -> None:
        """Send what is new at that time (CLOCK_MONOTONIC and Unix time, s)."""
