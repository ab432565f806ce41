"""In the guest: runs the commands that come by a virtio port, one at a time, and passes on what they print.

Each message is a line of JSON. Down: {"id", "run": [words], "timeout_s"}. Up: {"hello": boot id} when it starts,
{"id", "line"} for each line that is printed, {"id", "code"} at the end. Needs the standard library alone.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from typing import Any

PORT = "/dev/virtio-ports/failstop.vm"


class Port:
    """The virtio port: a character device that is read and written a line at a time."""

    def __init__(self, path: str) -> None:
        self._fd = os.open(path, os.O_RDWR)
        self._waiting = b""
        self._lock = threading.Lock()

    def send(self, **message: Any) -> None:
        """Send one message."""
        data = json.dumps(message).encode() + b"\n"
        with self._lock:
            while data:
                data = data[os.write(self._fd, data) :]

    def receive(self) -> dict[str, Any]:
        """The next message. Raises EOFError when the machine's end has closed."""
        while b"\n" not in self._waiting:
            data = os.read(self._fd, 65536)
            if not data:
                raise EOFError
            self._waiting += data
        line, _, self._waiting = self._waiting.partition(b"\n")
        message: dict[str, Any] = json.loads(line)
        return message


def run(port: Port, number: int, words: list[str], timeout_s: float) -> None:
    """Run one command to its end, or kill it with its children when its time is over."""
    with subprocess.Popen(
        words, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True
    ) as process:
        timer = threading.Timer(timeout_s, os.killpg, (process.pid, signal.SIGKILL))
        timer.start()
        assert process.stdout is not None
        for line in process.stdout:
            port.send(id=number, line=line.decode(errors="replace").rstrip("\n"))
        code = process.wait()
        timer.cancel()
    port.send(id=number, code=code)


def main() -> None:
    """Serve until the machine's end closes."""
    port = Port(sys.argv[1] if len(sys.argv) > 1 else PORT)
    with open("/proc/sys/kernel/random/boot_id") as file:
        port.send(hello=file.read().strip())
    while True:
        message = port.receive()
        try:
            run(port, message["id"], message["run"], message["timeout_s"])
        except OSError as error:
            port.send(id=message["id"], line=str(error))
            port.send(id=message["id"], code=-1)


if __name__ == "__main__":
    main()
