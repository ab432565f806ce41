"""A server that does nothing: a page with one button, and when what it sends arrives. What a browser takes by itself.

`python -m tests.web.bare`: says its port, then the ns of CLOCK_MONOTONIC at each message of the websocket.
"""

from __future__ import annotations

import base64
import hashlib
import socket
import subprocess
import sys
import threading
import time
from types import TracebackType

PAGE = b"""<!doctype html><meta name="viewport" content="width=device-width"><title>bare</title><h1>WORD</h1>
<button id="stop" style="width: 100%; height: 22vh; touch-action: none">STOP</button>
<script>
const socket = new WebSocket(`ws://${location.host}/`);
socket.onopen = () => { window.ready = true; };
document.getElementById("stop").addEventListener("pointerdown", (event) => {
  event.preventDefault();
  window.touched = event.timeStamp;
  socket.send("stop");
});
</script>
"""
OPCODE, TEXT = 0x0F, 1
"""Of a frame's first byte (RFC 6455)."""
MAGIC = b"258EAFA5-E914-47DA-95CA-C5AB0DC85B11"
HEADERS = b"HTTP/1.1 200 OK\r\nContent-Type: text/html\r\nConnection: close\r\nContent-Length: %d\r\n\r\n"
UPGRADE = (
    b"HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Accept: %s\r\n\r\n"
)


class Bare:
    """A context manager: that server, in a process of its own."""

    def __enter__(self) -> Bare:
        command = [sys.executable, "-m", "tests.web.bare"]
        self._process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True)
        self.url = f"http://127.0.0.1:{self._said()}/"
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        assert self._process.stdout is not None
        self._process.kill()
        self._process.wait()
        self._process.stdout.close()

    def _said(self) -> int:
        assert self._process.stdout is not None
        return int(self._process.stdout.readline())

    def came_ns(self) -> int:
        """When the next message came; waits for it."""
        return self._said()


def serve(connection: socket.socket) -> None:
    """One connection: the page, or a websocket whose messages are small enough to come in one piece."""
    with connection:
        head = b""
        while b"\r\n\r\n" not in head:
            if not (more := connection.recv(1 << 16)):
                return
            head += more
        fields = dict(line.split(b": ", 1) for line in head.split(b"\r\n")[1:] if b": " in line)
        key = {name.lower(): value for name, value in fields.items()}.get(b"sec-websocket-key")
        if key is None:
            connection.sendall(HEADERS % len(PAGE) + PAGE)
            return
        accept = base64.b64encode(hashlib.sha1(key + MAGIC, usedforsecurity=False).digest())
        connection.sendall(UPGRADE % accept)
        while frame := connection.recv(1 << 16):
            if frame[0] & OPCODE == TEXT:  # the end of the connection is none
                print(time.monotonic_ns(), flush=True)


def main() -> None:
    """Serve until it is killed."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        print(listening.getsockname()[1], flush=True)
        while True:
            threading.Thread(target=serve, args=(listening.accept()[0],), daemon=True).start()


if __name__ == "__main__":
    main()
