"""The stand-in's wire: a folder in which every process has a socket, and a file that says what it publishes and hears.

A process that was killed stays in the graph for a while, as in DDS; one that ends in order leaves it at once.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import pickle
import socket
import threading
import time

FOLDER = "FAILSTOP_STANDIN"
LEASE = "FAILSTOP_STANDIN_LEASE_S"
TOUCH_S = 0.1
MOST_BYTES = 1 << 20
SEND_S = 0.02
"""How long a process that does not read, such as a stopped one, holds a sender up."""
SERVICE_S = 5.0
"""What is asked and answered is not lost for want of room, as a message may be."""
_numbers = itertools.count()


class Wire:
    """One process's place in the folder."""

    def __init__(self) -> None:
        self.folder = os.environ[FOLDER]
        self.lease_s = float(os.environ.get(LEASE, "2"))
        self.name = f"{os.getpid()}-{next(_numbers)}"
        self.news = threading.Condition()
        self.publishers: list[dict] = []
        self.subscriptions: list[dict] = []
        self.services: list[dict] = []
        self.handlers: dict[int, object] = {}
        """What takes a packet, by the number of its subscription, service or client."""
        self._known: dict[str, tuple[tuple[int, int, int], dict]] = {}
        self._touched_s = 0.0
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._out = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._out.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, MOST_BYTES)
        self._out.settimeout(SEND_S)
        self._socket.bind(os.path.join(self.folder, f"{self.name}.sock"))
        self._thread = threading.Thread(target=self._receive, daemon=True)
        self.tell()
        self._thread.start()

    def tell(self) -> None:
        ends = {"pid": os.getpid(), "publishers": self.publishers, "subscriptions": self.subscriptions}
        path = os.path.join(self.folder, f"{self.name}.json")
        with open(f"{path}.new", "w") as file:
            json.dump({**ends, "services": self.services}, file)
        os.replace(f"{path}.new", path)

    def touch(self) -> None:
        if time.monotonic() - self._touched_s > TOUCH_S:
            self._touched_s = time.monotonic()
            with contextlib.suppress(FileNotFoundError):
                os.utime(os.path.join(self.folder, f"{self.name}.json"))

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)  # its thread ends
        for ending in ("json", "sock"):
            with contextlib.suppress(FileNotFoundError):
                os.unlink(os.path.join(self.folder, f"{self.name}.{ending}"))

    def graph(self) -> dict[str, dict]:
        found = {}
        for entry in os.scandir(self.folder):
            name, ending = os.path.splitext(entry.name)
            if ending != ".json":
                continue
            with contextlib.suppress(FileNotFoundError, ValueError):
                seen = entry.stat()
                key = (seen.st_ino, seen.st_size, seen.st_mtime_ns)
                if self._known.get(name, (None,))[0] != key:
                    with open(entry.path) as file:
                        self._known[name] = (key, json.load(file))
                ends = self._known[name][1]
                if time.time() - seen.st_mtime < self.lease_s or os.path.exists(f"/proc/{ends['pid']}"):
                    found[name] = ends
        return found

    def send(self, to: str, packet: tuple, within_s: float = 0.0) -> None:
        """To one process; one that is dead, or full for so long, gets nothing."""
        until_s = time.monotonic() + within_s
        with contextlib.suppress(OSError):
            while True:
                try:
                    self._out.sendto(pickle.dumps(packet), os.path.join(self.folder, f"{to}.sock"))
                    return
                except TimeoutError:
                    if time.monotonic() > until_s:
                        return

    def _receive(self) -> None:
        while True:
            try:
                number, packet = pickle.loads(self._socket.recv(MOST_BYTES))
            except (OSError, EOFError):
                return
            if handler := self.handlers.get(number):
                handler(packet)
                with self.news:
                    self.news.notify_all()
