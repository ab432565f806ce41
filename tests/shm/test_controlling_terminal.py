"""A terminal that a process opens may become the one whose hang-up ends it: this never happens to the service."""

from __future__ import annotations

import errno
import os

import pytest

from failstop.files import durable
from tests.support.children import call


def test_a_terminal_planted_after_the_look_does_not_end_the_service_by_its_hangup(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    master, slave = os.openpty()
    path = os.ttyname(slave)
    regular, look = os.stat(__file__), os.stat
    monkeypatch.setattr(os, "stat", lambda at, **how: regular if at == path else look(at, **how))

    def refused() -> None:
        with pytest.raises(OSError, match="a device, not a regular file"):
            durable.open_regular(path)

    def attempt() -> None:
        os.setsid()  # as a service that systemd starts: the first terminal that it opens may become its own
        refused()
        with pytest.raises(OSError, match=os.strerror(errno.ENXIO)):
            os.open("/dev/tty", os.O_RDONLY | os.O_NOCTTY)

    try:
        refused()
        call(attempt)
    finally:
        os.close(master)
        os.close(slave)
