"""Health: does the supervisor do its job, and what is there to say of the service in one line? Pure.

The service manager's watchdog is for a supervisor that no longer does its job, and for nothing else:

    hung                                    it sends no beat by itself
    a process that was killed and stays     whatever holds it in the kernel, a restart in here can't replace it
    a stop owed                             nobody answered it and nobody could write it, though the port is open

Everything else is healthy, however bad it looks: a process that is down until a reset, a port that is gone, a board
that is deaf. The wheels are told to stop then, the status is served, and a restart would only take both away.
"""

from __future__ import annotations

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

UNDYING_NS = 10_000_000_000
"""SIGKILL to gone takes milliseconds; a process that closes a port which does not drain, seconds."""
OWED_NS = 2_000_000_000
"""The supervisor's own burst goes out 5 ms after the cause and every 200 ms from then on."""


def fault(now_ns: int, killed_ns: dict[str, int], owed_since_ns: int, *, port_open: bool) -> str:
    """Why the supervisor does not do its job, in words; empty while it does. `killed_ns`: when the processes that were
    killed and are not gone were killed; `owed_since_ns`: since when a stop is neither answered nor written, 0 for no
    such stop; `port_open`: it has a descriptor to write to."""
    for name, since_ns in killed_ns.items():
        if now_ns - since_ns >= UNDYING_NS:
            return f"{name} was killed {(now_ns - since_ns) / 1e9:.0f} s ago and is not gone"
    if owed_since_ns and port_open and now_ns - owed_since_ns >= OWED_NS:
        return f"a stop could not be written for {(now_ns - owed_since_ns) / 1e9:.0f} s"
    return ""


def status_line(missing: str, down: str, latched: str, gate: dict[str, Any]) -> str:
    """The service in one line. `missing`: what motion waits for; `down`: the processes that died too often; `latched`:
    the reason of the latch; `gate`: its published state; each empty where there is none."""
    if latched:
        waits = f"; waiting for {missing}" if missing else ""
        return f"stop latched: {latched}{_stays(down) or waits}"
    if missing:
        return f"motion disabled, waiting for {missing}{_stays(down)}"
    if not gate.get("enabled"):
        return "ready, motion disabled"
    who = [f"{row['source']} drives: {row['who']}" for row in gate["sources"] if row["state"] == "drives"]
    blocked = f"blocked: {gate['blocked']}" if gate["blocked"] else ""
    return f"motion enabled; {blocked or ', '.join(who) or 'nobody drives'}"


def _stays(down: str) -> str:
    return f"; {down} died too often and is down until a reset" if down else ""
