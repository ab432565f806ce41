"""Turn: lets a callback wait while the executor does other work."""

from __future__ import annotations

from collections.abc import Generator


class Turn:
    """Await this in a callback: the executor does other work, and then continues the callback."""

    def __await__(self) -> Generator[None, None, None]:
        yield
