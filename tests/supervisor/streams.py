"""Standard error, given away for a while."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator


@contextlib.contextmanager
def stderr_is(fd: int) -> Iterator[None]:
    """Another descriptor in the place of descriptor 2; inside the test, since the test runner moves it about too."""
    saved = os.dup(2)
    os.dup2(fd, 2)
    try:
        yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)
