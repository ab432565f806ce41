"""The stop test tells of a burst that was not written."""

from __future__ import annotations

import pytest

from failstop.board.stop_port import StopPort
from failstop.doctor import stop_path
from failstop.supervisor.port import OwnPort
from tests.support.ptys import new_pty


def test_a_duplicate_that_writes_nothing_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    with new_pty() as pty:
        own = OwnPort(pty.slave)
        assert stop_path.on_duplicate(own)
        monkeypatch.setattr(StopPort, "burst", lambda _: False)
        assert not stop_path.on_duplicate(own)
