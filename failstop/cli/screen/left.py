"""Left: what a service that died has left in shared memory - how it ended, whether a stop was written, what it told."""

from __future__ import annotations

import os
import time

from failstop.api import host, words
from failstop.api.errors import NoService
from failstop.api.events import Event, unpack
from failstop.api.why import Why
from failstop.incidents import memory
from failstop.shm import layout, records, segment

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from failstop.incidents.memory import Segments


class Left:
    """A run that was not ended in order. Its memory is there until the service is started again, or the machine is."""

    __slots__ = ("cause", "device", "events", "name", "pid", "stop", "t")

    def __init__(self, name: str, segments: Segments, now_s: float, now_ns: int) -> None:
        """`now_s`, `now_ns`: Unix time and CLOCK_MONOTONIC of one moment."""
        cause_ns, _, self.cause = memory.left_cause(segments)
        self.name = name
        self.t = now_s - (now_ns - cause_ns) / 1e9
        """Unix time of the end."""
        self.pid = segments[layout.SUPERVISOR]["words"]["beat_pid"]
        self.stop: dict[str, Any] | None = memory.left_stop(segments, cause_ns)
        """As of supervisor/stops.py; None: no stop is known to have been written."""
        self.device = _device(segments)
        told = segments[layout.SUPERVISOR]["rings"]["events"]
        self.events: list[Event] = [event for seq, _, payload in told if (event := unpack(seq, payload))]

    def start(self) -> str:
        """The command that starts it again."""
        return host.start(self.name, self.device)

    def steps(self) -> list[str]:
        """What to do, in order; commands in backquotes."""
        first = [] if self.stop else [f"{host.stop(self.device)} if the wheels turn"]
        show = words.named("`failstop incident show last`", self.name)
        return [*first, self.start(), f"{show}, for what came before it"]

    def why(self, now_s: float) -> Why:
        """The answer to "why do the wheels stand?"."""
        what = f"no service named {self.name!r} runs: {self.cause} (pid {self.pid}; {words.ago(self.t, now_s)})"
        doubt = "" if self.stop else "THE WHEELS MAY TURN; if they do, use the POWER SWITCH: "
        also = ["its black box is in memory, and is saved as an incident when it is started again"]
        if self.by_hand():
            also.append("a configuration file that it had is not known here: name it with --config")
        return Why(doubt + what, self.written(), tuple(self.steps()), tuple(also), None, None, self.t)

    def by_hand(self) -> bool:
        """True where a person starts it, and not systemd."""
        return not host.unit(self.name)

    def written(self) -> str:
        """Whether a stop was written, as a clause."""
        if self.stop is None:
            return "no stop is known to have been written"
        by = str(self.stop["written_by"])
        return f"the {by} wrote the stop {words.took(self.stop['written_us'] / 1e6)} later"


def find(name: str) -> Left | None:
    """What is left of a service of this name that no longer runs, and was this user's; None when nothing is."""
    dead = segment.dead_runs(name)
    fds = segment.open_all(dead[-1]) if dead else {}
    try:
        if len(fds) < len(layout.PROCESSES):
            return None
        return Left(name, memory.copy(fds, name)[1], time.time(), time.monotonic_ns())
    except (segment.AttachError, OSError):
        return None
    finally:
        for fd in fds.values():
            os.close(fd)


def _device(segments: Segments) -> str | None:
    port = segments[layout.PORT_OWNER]["latest"].get("port")
    return records.PORT.unpack(port[2])[3] if port else None


def refusal(name: str, error: NoService) -> NoService:
    """What to tell whoever asks for a service that does not run, if it is more than the error says."""
    if found := find(name):
        return NoService(line(found, time.time()))
    if host.unit(name):
        told = f"what it told is in {host.journal(name)}"
        return NoService(f"no service named {name!r} is running: start it with {host.start(name)}; {told}")
    return error


def line(found: Left, now_s: float) -> str:
    """What happened and what to do, in one line."""
    what = f"{found.cause} ({words.ago(found.t, now_s)}); {found.written()}"
    return f"no service named {found.name!r} is running: {what}; next: {', then '.join(found.steps()[:-1])}"
