"""Viewer: somebody who looks at the page, whatever connects them."""

from __future__ import annotations

from typing import Protocol

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.web.devices import Device


class Closing(Protocol):
    """A connection that the page may end."""

    def close(self, code: int | None = None, reason: str | None = None) -> None:
        """End it; `code`: of a websocket's end."""


class Viewer(Closing, Protocol):
    """A connection that shows the state."""

    def device(self) -> Device | None:
        """The paired device; None: somebody who sees and stops."""

    def who(self) -> str:
        """The name, for people."""

    def show(self, now_s: float, unix_s: float) -> None:
        """Send what is new at that time (CLOCK_MONOTONIC, Unix)."""
