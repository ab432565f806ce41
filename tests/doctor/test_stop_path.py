"""The stop test tells of a burst that was not written."""

from __future__ import annotations

import os

from failstop.board.rrc.board import BOARD
from failstop.doctor import stop_path
from failstop.doctor.look import FAIL
from tests.support.ptys import new_pty, open_fds


def test_a_burst_that_is_not_written_is_told() -> None:
    with new_pty() as pty:
        pty.fill()
        before = open_fds()
        told, [found] = stop_path.by_hand(os.ttyname(pty.slave), {"rrc": BOARD}, "failstop doctor")
        assert open_fds() == before
    assert told == []
    assert (found.level, found.fix) == (FAIL, "failstop doctor")
    assert found.text.startswith("no stop was written: /dev/pts/")
    assert "POWER SWITCH" in found.advice
