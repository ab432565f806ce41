"""The rest of this process's control group: killed, and waited for, before the stop tool opens the port.

At `systemctl stop`, at a restart and when its watchdog bites, systemd runs ExecStopPost beside workers that still live:
they hold the port (TIOCEXCL), and what they write could follow the stop. Found by reading /proc, not the control
group's own files: their place depends on how the machine mounts its hierarchies.
"""

from __future__ import annotations

# The C module under `signal`, which costs an import of enum.
import _signal
import contextlib
import os
import select
import time

_SIGKILL = 9


def kill(timeout_s: float, proc: str = "/proc") -> tuple[int, int]:
    """SIGKILL every other process of this one's control group until none is left, or `timeout_s` is over; returns how
    many were killed, and how many of these have not ended. `proc`: where to find processes. Raises OSError when this
    process's own control group can't be read."""
    group = _group(proc, "self")
    until_s = time.monotonic() + timeout_s
    killed: set[int] = set()
    while True:
        # More than once: one of them may just have started another.
        found = _others(proc, group)
        if not found:
            return len(killed), 0
        try:
            for fd in found.values():
                # Of another user's: it is waited for in vain, and told of.
                with contextlib.suppress(OSError):
                    _signal.pidfd_send_signal(fd, _SIGKILL)
            killed.update(found)
            left = _wait(list(found.values()), until_s)
        finally:
            for fd in found.values():
                os.close(fd)
        if left:
            return len(killed), left


def of_a_service(proc: str = "/proc") -> bool:
    """True when this process's control group is that of a systemd service, and not of a login, say. Raises OSError."""
    return any(line.endswith(b".service") for line in _group(proc, "self"))


def _others(proc: str, group: list[bytes]) -> dict[int, int]:
    """The pidfd of each other process of the group that has not ended, by its pid."""
    found: dict[int, int] = {}
    for word in os.listdir(proc):
        if not word.isdecimal() or int(word) == os.getpid():
            continue
        pid = int(word)
        try:
            if _group(proc, word) != group:
                continue
            fd = os.pidfd_open(pid)
        except OSError:
            continue  # it has just ended
        # Looked at again behind the descriptor: the pid may have been another process's a moment ago.
        try:
            same = _group(proc, word) == group and bool(_wait([fd], 0.0))
        except OSError:
            same = False
        if same:
            found[pid] = fd
        else:
            os.close(fd)
    return found


def _group(proc: str, pid: str) -> list[bytes]:
    """A process's control group in the hierarchies that systemd keeps services apart in, one or both; people may have
    chosen others, for single processes. Raises OSError."""
    with open(f"{proc}/{pid}/cgroup", "rb") as file:
        return [line for line in file.read().splitlines() if line.split(b":", 2)[1] in (b"", b"name=systemd")]


def _wait(fds: list[int], until_s: float) -> int:
    """Wait until all of these processes have ended; returns how many have not by then."""
    poll = select.poll()
    for fd in fds:
        poll.register(fd, select.POLLIN)
    left = set(fds)
    while left:
        ready = poll.poll(max(0.0, until_s - time.monotonic()) * 1000)
        for fd, _ in ready:
            left.discard(fd)
            poll.unregister(fd)
        if not ready:
            break
    return len(left)
