"""Cut: a network between a browser and the page that can be cut, as Wi-Fi is: no byte passes, and no end is told."""

from __future__ import annotations

import contextlib
import select
import socket
import threading
from types import TracebackType


class Cut:
    """A context manager: forwards connections to a port until it is cut, and what came meanwhile once it is mended."""

    def __init__(self, port: int) -> None:
        self._to = port
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port = self._listening.getsockname()[1]
        self._passes = threading.Event()
        self._passes.set()
        self._ended = threading.Event()
        self._pairs: dict[socket.socket, socket.socket] = {}
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Cut:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._ended.set()
        self._passes.set()
        self._thread.join()
        for each in (self._listening, *self._pairs):
            each.close()

    def cut(self) -> None:
        """From now on nothing passes."""
        self._passes.clear()

    def mend(self) -> None:
        """Let pass what was held back."""
        self._passes.set()

    def _run(self) -> None:
        while not self._ended.is_set():
            self._passes.wait()
            for ready in select.select([self._listening, *self._pairs], (), (), 0.02)[0]:
                if self._passes.is_set():
                    self._forward(ready)

    def _forward(self, ready: socket.socket) -> None:
        if ready is self._listening:
            came, _ = self._listening.accept()
            went = socket.create_connection(("127.0.0.1", self._to))
            self._pairs[came], self._pairs[went] = went, came
            return
        other = self._pairs.get(ready)
        if other is None:
            return
        data = b""
        with contextlib.suppress(OSError):
            data = ready.recv(65536)
        with contextlib.suppress(OSError):
            if data:
                other.sendall(data)
                return
        for each in (ready, other):
            self._pairs.pop(each, None)
            each.close()
