"""Ask: a stop through a running service, and what can be observed of it. The stop itself needs only the stop pipe. The
service's port and state are read as far as possible, because the service may be of another version, half started or
half dead.
"""

from __future__ import annotations

import contextlib
import os
import time

from failstop.api.client import attach, send_stop, unread
from failstop.api.errors import FailstopError
from failstop.files import instance
from failstop.messages import layout, records
from failstop.policy.causes import unsigned

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.policy.causes import Cause

LATCH_S = 1.0
"""How long to wait until a request is seen latched; the service needs a few milliseconds."""
HEAR_S = 0.3
"""How long to wait for the board's answer before a latched stop is shown without it."""
LOOK_S = 0.002


def stop(name: str, reason: str, who: str) -> tuple[str, str, bool]:
    """Write a request into the stop pipe of a service, then wait until it is latched, LATCH_S at most. Returns (how it
    went, what is wrong, whether the wheels may still turn); the first is empty if no stop is known to be out. Raises
    nothing of its own."""
    try:
        send_stop(name, reason, who)
        _, pipe = instance.open_stop(name)
    except (FailstopError, instance.InstanceError, instance.NoService) as error:
        return "", str(error), False
    try:
        return _watch(name, pipe)
    except OSError as error:
        return "", f"the stop pipe of {name!r} can't be watched: {error.strerror}", False
    finally:
        os.close(pipe)


def _watch(name: str, pipe: int) -> tuple[str, str, bool]:
    """Wait until the stop is out. The port owner reads the pipe after it has written the stop, so an empty pipe means a
    stop is out. A flood of requests by others never leaves it empty; then a newer epoch than the first one seen means
    the same. Raises OSError."""
    from failstop.api import steps, verdict
    from failstop.api.state import StateReader

    until_s = time.monotonic() + LATCH_S
    reader, problem, taken, first_epoch, latched_s = None, "", False, -1, 0.0
    while time.monotonic() < until_s:
        taken = taken or not unread(pipe)
        try:
            reader = reader or StateReader(name)
            state = reader.read()
            first_epoch = state.epoch if first_epoch < 0 else first_epoch
            if state.estop and (taken or state.epoch > first_epoch):
                latched_s = latched_s or time.monotonic()
                doubt = verdict.doubt(state) or verdict.unproven(state)
                if not doubt or time.monotonic() - latched_s >= HEAR_S:
                    text = f"stop latched ({_why(state.cause)}) by the service {name!r}; next: {steps.line(state)}"
                    return text, f"{doubt}: use the POWER SWITCH" if doubt else "", bool(doubt)
        except Exception as error:  # the request is in the pipe, even if the shared memory is damaged
            problem = str(error)
        time.sleep(LOOK_S)
    if taken and not reader:
        return (
            f"the service {name!r} has written the stop, but this user can't see whether it is latched",
            problem,
            False,
        )
    return "", problem or f"the service {name!r} has not latched it within {LATCH_S:g} s", False


def _why(cause: Cause | None) -> str:
    """The cause in words. Of this program's own request it leaves out who asked, because the reader knows."""
    own = cause and cause.named().get("pid") == os.getpid()
    return unsigned(cause) if cause and own else str(cause)


def port_of(name: str) -> str:
    """The port that a service reports; empty if that can't be read."""
    with contextlib.suppress(Exception), contextlib.closing(attach(name, layout.PORT_OWNER)) as found:
        if entry := found.latest_reader("port").read():
            return records.PORT.unpack(entry[2])[3]
    return ""


def owner_of(name: str) -> int | None:
    """The user of a service; None when that can't be known."""
    with contextlib.suppress(instance.NoService, instance.InstanceError):
        return instance.current_run(instance.find(name))[1]
    return None


def same(port: str, device: str) -> bool:
    """True if two paths are the same port; compared by name only if the port is missing."""
    with contextlib.suppress(OSError):
        return os.stat(port).st_rdev == os.stat(device).st_rdev != 0
    return os.path.realpath(port) == os.path.realpath(device)
