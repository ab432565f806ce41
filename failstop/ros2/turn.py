"""Turn: what a callback awaits that has to wait."""

from __future__ import annotations

from collections.abc import Generator


class Turn:
    """Awaited: the executor goes on with other work, and comes back."""

    def __await__(self) -> Generator[None, None, None]:
        yield
