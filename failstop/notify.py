"""Notify: datagrams for the service manager (the sd_notify protocol) and for the journal, never waited for."""

from __future__ import annotations

import _socket
from collections.abc import MutableMapping

VARIABLES = ("NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID")
"""Variables of the service manager, for the process alone that it has started."""
STATUS_CHARACTERS = 200


class Outbox:
    """Datagrams for a Unix socket that somebody else keeps, never waited for."""

    def __init__(self, address: str | bytes) -> None:
        self._address = address
        self._socket: _socket.socket | None = None

    def send(self, data: bytes) -> bool:
        """Send one datagram; False when it could not be handed over at once: nobody is there, or the queue is full."""
        try:
            if self._socket is None:
                kind = _socket.SOCK_DGRAM | _socket.SOCK_CLOEXEC | _socket.SOCK_NONBLOCK
                self._socket = _socket.socket(_socket.AF_UNIX, kind)
            # By its address each time: whoever was restarted may have another socket there.
            self._socket.sendto(data, self._address)
        except (OSError, ValueError):
            return False
        return True

    def close(self) -> None:
        """Let the socket go."""
        if self._socket:
            self._socket.close()
            self._socket = None


class Notify(Outbox):
    """The socket of the service manager; without one, nothing is sent."""

    def __init__(self, address: str = "", watchdog_us: int = 0) -> None:
        """`address`: a path, or @name for the abstract namespace; `watchdog_us`: the watchdog's timeout, 0 for none."""
        self.active = bool(address)
        """True when somebody listens."""
        abstract = address.startswith("@")
        super().__init__(b"\0" * abstract + address[abstract:].encode("utf-8", "surrogateescape"))
        self.every_ns = watchdog_us * 1000 // 2
        """Half of the timeout: one datagram may get lost."""
        self._beat_ns = 0
        self._said = ""
        self._notified_ready = False

    @classmethod
    def from_environment(cls, environ: MutableMapping[str, str], pid: int) -> Notify:
        """Read the variables and remove them from `environ`, because nothing that this process starts may speak for
        it. A watchdog for another pid is none."""
        address, timeout, wanted = (environ.pop(name, "") for name in VARIABLES)
        if address[:1] not in ("/", "@"):
            return cls()
        for_us = not wanted or wanted == str(pid)
        return cls(address, int(timeout) if for_us and timeout.isdecimal() else 0)

    def update(self, now_ns: int, status: str, *, ready: bool, healthy: bool) -> None:
        """Send the service manager what has changed, and the watchdog's beat when it is due and the supervisor does its
        job. `ready`: the service has been ready once."""
        lines = ["READY=1"] if ready and not self._notified_ready else []
        if status != self._said:
            lines.append(f"STATUS={_one_line(status)}")
        beats = healthy and self.every_ns > 0 and now_ns - self._beat_ns >= self.every_ns
        if beats:
            lines.append("WATCHDOG=1")
        if lines and self.say("\n".join(lines)):
            self._notified_ready = ready
            self._said = status
            if beats:
                self._beat_ns = now_ns

    def stopping(self, status: str) -> None:
        """The service ends now."""
        self.say(f"STOPPING=1\nSTATUS={_one_line(status)}")

    def say(self, lines: str) -> bool:
        """Send one datagram; False when it could not be handed over at once."""
        return self.active and self.send(lines.encode("utf-8", "replace"))


def _one_line(text: str) -> str:
    """A line break would begin another assignment: a reason is not to say that a service is ready."""
    return "".join(c if c.isprintable() else "?" for c in text)[:STATUS_CHARACTERS]
