"""An open port from outside of the service: an answer counts for the question that it belongs to, and a reset loses
what was asked before it."""

from __future__ import annotations

import contextlib
import os
import pty
import socket
import threading
import time
import tty
from collections.abc import Iterator

import pytest

from failstop.board import asking
from failstop.board.arduino import codec
from failstop.board.kinds import board_of
from failstop.board.tap import Tap

LOST = 2
ANSWERS = {codec.BAUD_RATE: b"57600\r\n", codec.POSITIONS: b"0 0\r\n"}


@pytest.fixture
def fd() -> Iterator[int]:
    """A port whose board hears nothing until it has started, which is after LOST questions, and answers all others."""
    board, port = pty.openpty()
    os.set_blocking(port, False)

    def answer() -> None:
        kept, asked = b"", 0
        while data := os.read(board, 64):
            kept += data.replace(b"\n", b"\r")
            while b"\r" in kept:
                question, _, kept = kept.partition(b"\r")
                asked += 1
                if asked > LOST:
                    os.write(board, ANSWERS[question + b"\r"])

    def answers_until_the_end() -> None:
        try:
            answer()
        except OSError:
            return

    tty.setraw(port)
    thread = threading.Thread(target=answers_until_the_end, daemon=True)
    thread.start()
    yield port
    os.close(port)
    thread.join(5)
    os.close(board)


def test_an_answer_behind_a_reset_is_to_a_question_behind_it(fd: int) -> None:
    tap = Tap(fd, board_of("arduino", 0.08, 0.0))
    assert [tap.answered_ms(0.05) for _ in range(LOST)] == [None] * LOST
    tap.lost()
    assert tap.answered_ms(5.0) is not None


def test_a_port_that_takes_no_bytes_has_not_gone() -> None:
    """A board that answers nothing, and not a device that was unplugged."""
    board, port = socket.socketpair()  # a terminal would make room now and then
    with board, port:
        port.setblocking(False)
        for size in (4096, 1):
            with contextlib.suppress(BlockingIOError):
                while True:
                    port.send(bytes(size))
        arduino = board_of("arduino", 0.08, 0.0)
        tap = Tap(port.fileno(), arduino)
        begun_s = time.monotonic()
        assert tap.answered_ms(0.05) is None
        assert time.monotonic() - begun_s >= 0.05, "who asks again and again waits in between"
        with pytest.raises(BlockingIOError):
            tap.ping()
        assert asking.ask(tap, arduino, stop=True) is None
        board.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            while board.recv(4096):
                pass
        assert tap.ping()[0] == 0, "the question that was not written is the next one"
        board.close()
        with pytest.raises(OSError, match="Broken pipe"):
            tap.answered_ms(0.05)


def test_without_a_reset_it_may_be_to_the_older_one(fd: int) -> None:
    tap = Tap(fd, board_of("arduino", 0.08, 0.0))
    assert [tap.answered_ms(0.05) for _ in range(LOST + 1)] == [None] * (LOST + 1)
