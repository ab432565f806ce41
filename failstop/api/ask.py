"""Ask: requests a stop from a running service, and observes what comes of it. The request needs only the stop pipe. The
service's port and state are read as far as possible, because the service may have another version, or be half started
or half dead.
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
"""For how long to wait until the request was latched, s. The service needs a few milliseconds."""
HEAR_S = 0.3
"""For how long to wait for the board's answer, s, before a latched stop is reported without it."""
LOOK_S = 0.002


def stop(name: str, reason: str, who: str) -> tuple[str, str, bool]:
    """Write a request into the stop pipe of a service, then wait until it is latched, for at most LATCH_S. Returns
    (result, problem, doubt): the result as a text, which is empty if no stop is known to be written; what is wrong, as
    a text; and True if the wheels may still turn. Raises nothing itself."""
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
    """Wait until the stop is written. The port owner reads the pipe after it has written the stop, so an empty pipe
    means that a stop is written. If a flood of other requests never leaves it empty, an epoch that is newer than the
    first one means the same. Raises OSError."""
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
    """The cause in words. If it is this program's own request, the words leave out who asked, because the reader
    knows."""
    own = cause and cause.named().get("pid") == os.getpid()
    return unsigned(cause) if cause and own else str(cause)


def port_of(name: str) -> str:
    """The port that a service reports; empty if it can't be read."""
    with contextlib.suppress(Exception), contextlib.closing(attach(name, layout.PORT_OWNER)) as found:
        if entry := found.latest_reader("port").read():
            return records.PORT.unpack(entry[2])[3]
    return ""


def owner_of(name: str) -> int | None:
    """The user of a service; None if that can't be known."""
    with contextlib.suppress(instance.NoService, instance.InstanceError):
        return instance.current_run(instance.find(name))[1]
    return None


def same(port: str, device: str) -> bool:
    """True if two paths lead to the same port. If the port is missing, the paths are compared as texts."""
    with contextlib.suppress(OSError):
        return os.stat(port).st_rdev == os.stat(device).st_rdev != 0
    return os.path.realpath(port) == os.path.realpath(device)
