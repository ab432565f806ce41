"""Closing the port: at once, even where the kernel would wait for bytes that nobody takes."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import struct
import threading
import time

import pytest

from failstop.board import port
from failstop.board.port import open_port


def stuck_socket() -> tuple[int, socket.socket]:
    """A descriptor whose close waits, as a port's that does not drain: TCP with a full buffer, an hour of linger and a
    peer that does not read; and the peer."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        sender = socket.create_connection(server.getsockname())
        peer, _ = server.accept()
    sender.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 3600))
    sender.setblocking(False)
    with contextlib.suppress(BlockingIOError):
        while True:
            sender.send(bytes(65536))
    sender.setblocking(True)
    return sender.detach(), peer


def test_a_close_that_would_wait_for_an_hour_is_cut_short_and_gives_the_timer_back() -> None:
    handler = signal.getsignal(signal.SIGALRM)
    descriptor, peer = stuck_socket()
    others = signal.setitimer(signal.ITIMER_REAL, 1000.0, 7.0)
    started_s = time.monotonic()
    port.close_port(descriptor)
    took_s = time.monotonic() - started_s
    left_s, every_s = signal.setitimer(signal.ITIMER_REAL, *others)
    assert took_s < 5.0
    assert 900.0 < left_s <= 1000.0
    assert every_s == 7.0
    assert signal.getsignal(signal.SIGALRM) == handler
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(descriptor)
    peer.close()


def test_closing_what_is_closed_already_is_fine() -> None:
    reader, writer = os.pipe()
    os.close(writer)
    port.close_port(reader)
    port.close_port(reader)


def test_closing_in_another_thread_closes() -> None:
    master, slave = os.openpty()
    descriptor = open_port(os.ttyname(slave), exclusive=True)
    thread = threading.Thread(target=port.close_port, args=(descriptor,))
    thread.start()
    thread.join(10.0)
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(descriptor)
    os.close(slave)
    os.close(master)
