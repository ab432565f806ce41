"""Late: a network that delivers everything, in order, but late. It can also be away."""

from __future__ import annotations

import contextlib
import queue
import socket
import threading
import time
from types import TracebackType

AT_ONCE = 65536


class Late:
    """A context manager: passes connections on to a port of this machine."""

    def __init__(self, to: int) -> None:
        self.to = to
        self.down_s = self.up_s = 0.0
        """How late bytes reach the browser, and the robot."""
        self._open: set[socket.socket] = set()
        self._listening = socket.create_server(("127.0.0.1", 0), backlog=64)

    @property
    def url(self) -> str:
        """As the browser has it."""
        return f"http://localhost:{self._listening.getsockname()[1]}/"

    def __enter__(self) -> Late:
        threading.Thread(target=self._accept, daemon=True).start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        with contextlib.suppress(OSError):
            self._listening.shutdown(socket.SHUT_RDWR)
        self._listening.close()
        self.cut()
        for each in self._open:
            each.close()

    def cut(self) -> None:
        """End every connection that is open now."""
        for each in tuple(self._open):
            with contextlib.suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)

    def _accept(self) -> None:
        while True:
            try:
                near, _ = self._listening.accept()
            except OSError:
                return
            try:
                far = socket.create_connection(("127.0.0.1", self.to))
            except OSError:  # the network is away
                near.close()
                continue
            self._open |= {near, far}
            for source, end, way in ((near, far, "up_s"), (far, near, "down_s")):
                data: queue.Queue[tuple[float, bytes]] = queue.Queue()
                threading.Thread(target=self._read, args=(source, data), daemon=True).start()
                threading.Thread(target=self._write, args=(end, data, way), daemon=True).start()

    def _read(self, source: socket.socket, data: queue.Queue[tuple[float, bytes]]) -> None:
        with contextlib.suppress(OSError):
            while found := source.recv(AT_ONCE):
                data.put((time.monotonic(), found))
        data.put((time.monotonic(), b""))

    def _write(self, end: socket.socket, data: queue.Queue[tuple[float, bytes]], way: str) -> None:
        with contextlib.suppress(OSError):
            while True:
                came_s, found = data.get()
                time.sleep(max(0.0, came_s + float(getattr(self, way)) - time.monotonic()))
                if not found:
                    end.shutdown(socket.SHUT_WR)
                    return
                end.sendall(found)
