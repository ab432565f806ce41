"""Notify: what the service manager is told (the sd_notify protocol): ready, a status line, the watchdog, the end.

Datagrams, never waited for. What could not be sent is sent again at a later turn, and is no
reason to do anything else.
"""

from __future__ import annotations

from collections.abc import MutableMapping

from failstop.supervisor.events import Outbox

VARIABLES = ("NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID")
"""What the service manager hands over; for the supervisor alone."""
STATUS_CHARACTERS = 200


class Notify:
    """The socket of the service manager; without one, nothing is sent."""

    __slots__ = ("_beat_ns", "_outbox", "_said", "_told_ready", "active", "every_ns")

    def __init__(self, address: str = "", watchdog_us: int = 0) -> None:
        """`address`: a path, or @name for the abstract namespace; `watchdog_us`: the watchdog's timeout, 0 for none."""
        self.active = bool(address)
        """True when somebody listens."""
        abstract = address.startswith("@")
        self._outbox = Outbox(b"\0" * abstract + address[abstract:].encode("utf-8", "surrogateescape"))
        self.every_ns = watchdog_us * 1000 // 2
        """Half of the timeout: one datagram may get lost."""
        self._beat_ns = 0
        self._said = ""
        self._told_ready = False

    @classmethod
    def taken_from(cls, environ: MutableMapping[str, str], pid: int) -> Notify:
        """As `environ` says, from which the variables are taken away: nothing that this process starts may speak for
        it. A watchdog for another pid is none."""
        address, timeout, wanted = (environ.pop(name, "") for name in VARIABLES)
        if address[:1] not in ("/", "@"):
            return cls()
        for_us = not wanted or wanted == str(pid)
        return cls(address, int(timeout) if for_us and timeout.isdecimal() else 0)

    def follow(self, now_ns: int, status: str, *, ready: bool, healthy: bool) -> None:
        """Once a turn: what is new, and the watchdog's beat when it is due and the supervisor does its job. `ready`:
        the service has been, once."""
        lines = ["READY=1"] if ready and not self._told_ready else []
        if status != self._said:
            lines.append(f"STATUS={_one_line(status)}")
        beats = healthy and self.every_ns > 0 and now_ns - self._beat_ns >= self.every_ns
        if beats:
            lines.append("WATCHDOG=1")
        if lines and self.send("\n".join(lines)):
            self._told_ready = ready
            self._said = status
            if beats:
                self._beat_ns = now_ns

    def stopping(self, status: str) -> None:
        """The service ends now."""
        self.send(f"STOPPING=1\nSTATUS={_one_line(status)}")

    def send(self, lines: str) -> bool:
        """Send one datagram; False when it could not be handed over at once."""
        return self.active and self._outbox.send(lines.encode("utf-8", "replace"))

    def close(self) -> None:
        """Let the socket go."""
        self._outbox.close()


def _one_line(text: str) -> str:
    """A line break would begin another assignment: a reason is not to say that a service is ready."""
    return "".join(c if c.isprintable() else "?" for c in text)[:STATUS_CHARACTERS]
