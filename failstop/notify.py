"""Notify: sends datagrams to the service manager (the sd_notify protocol) and to the journal, without ever waiting."""

from __future__ import annotations

import _socket
from collections.abc import MutableMapping

VARIABLES = ("NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID")
"""The environment variables by which the service manager speaks to the process that it has started. They are not meant
for that process's children."""
STATUS_CHARACTERS = 200


class Outbox:
    """Sends datagrams to a Unix socket that another program owns. It never waits."""

    def __init__(self, address: str | bytes) -> None:
        self._address = address
        self._socket: _socket.socket | None = None

    def send(self, data: bytes) -> bool:
        """Send one datagram. Returns False if no program listens, or if its queue is full."""
        try:
            if self._socket is None:
                kind = _socket.SOCK_DGRAM | _socket.SOCK_CLOEXEC | _socket.SOCK_NONBLOCK
                self._socket = _socket.socket(_socket.AF_UNIX, kind)
            # Look the address up each time, because a restarted program may have made a new socket there.
            self._socket.sendto(data, self._address)
        except (OSError, ValueError):
            return False
        return True

    def close(self) -> None:
        """Close the socket. The next send() opens another."""
        if self._socket:
            self._socket.close()
            self._socket = None


class Notify(Outbox):
    """Sends the service's state to the service manager. If no service manager has started this process, it sends
    nothing."""

    def __init__(self, address: str = "", watchdog_us: int = 0) -> None:
        """`address`: the path of the service manager's socket, or @NAME in the abstract namespace; empty to send
        nothing. `watchdog_us`: the timeout of its watchdog in microseconds; 0 if it has none."""
        self.active = bool(address)
        """True if there is a service manager to send to."""
        abstract = address.startswith("@")
        super().__init__(b"\0" * abstract + address[abstract:].encode("utf-8", "surrogateescape"))
        self.every_ns = watchdog_us * 1000 // 2
        """How often to tell the watchdog that the service is alive, in ns. It is half of the watchdog's timeout, so
        that one datagram may get lost."""
        self._beat_ns = 0
        self._said = ""
        self._notified_ready = False

    @classmethod
    def from_environment(cls, environ: MutableMapping[str, str], pid: int) -> Notify:
        """Make a Notify from the service manager's variables, and remove them from `environ`. So no child process can
        speak in this process's name. A watchdog for another pid is ignored."""
        address, timeout, wanted = (environ.pop(name, "") for name in VARIABLES)
        if address[:1] not in ("/", "@"):
            return cls()
        for_us = not wanted or wanted == str(pid)
        return cls(address, int(timeout) if for_us and timeout.isdecimal() else 0)

    def update(self, now_ns: int, status: str, *, ready: bool, healthy: bool) -> None:
        """Send what has changed since the last call. Also send the watchdog's keep-alive if it is due and `healthy` is
        True. `ready`: the service has been ready at least once. `healthy`: the supervisor does its job."""
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
        """Report to the service manager that the service is ending."""
        self.say(f"STOPPING=1\nSTATUS={_one_line(status)}")

    def say(self, lines: str) -> bool:
        """Send one datagram. Returns False if it could not be sent at once."""
        return self.active and self.send(lines.encode("utf-8", "replace"))


def _one_line(text: str) -> str:
    """The text on one line, with at most STATUS_CHARACTERS characters. A line break in a stop's reason could otherwise
    add a line such as READY=1 to the datagram."""
    return "".join(c if c.isprintable() else "?" for c in text)[:STATUS_CHARACTERS]
