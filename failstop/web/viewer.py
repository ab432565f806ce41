"""Viewer: what the page's server needs from the connection of a browser that shows the page."""

from __future__ import annotations

from typing import Protocol

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.web.devices import Device


class Closing(Protocol):
    """A connection that the page may close."""

    def close(self, code: int | None = None, reason: str | None = None) -> None:
        """Close the connection. `code`: the code that closes a websocket (RFC 6455)."""


class Viewer(Closing, Protocol):
    """A connection to somebody who watches the robot's state."""

    def device(self) -> Device | None:
        """Return the paired device that this viewer uses. None if the viewer may only watch and stop."""

    def who(self) -> str:
        """Return the viewer's name, to show to people."""

    def show(self, now_s: float, unix_s: float) -> None:
        """Send the newest values. `now_s`: CLOCK_MONOTONIC, s. `unix_s`: Unix time, s."""
