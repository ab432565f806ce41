"""Ask: asks a running service to stop the robot, and checks that the service does so.

The request needs only the stop pipe. The check also reads the service's state. The state can't be read if the service
has a different version, if only a part of it has started, or if a part of it is dead.
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
"""The longest wait for the service to latch a stop, in seconds. Normally the service needs only a few milliseconds."""
HEAR_S = 0.3
"""The longest wait for the board's answer to a latched stop, in seconds. After that, the stop is reported without the
answer."""
LOOK_S = 0.002


def stop(name: str, reason: str, who: str) -> tuple[str, str, bool]:
    """Ask a service to stop the robot, and wait at most LATCH_S until the stop is latched. Problems are returned as
    text, never raised.

    Returns (result, problem, doubt). `result`: a text that says what is known: the stop is latched, or the service has
    taken the request but this user can't see whether the stop was written. It is empty if neither is known. `problem`:
    a text that says what is wrong, or an empty text. `doubt`: True if there is a result, but the wheels may still turn.
    """
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
    """Wait until the service has taken the request and latched the stop. Returns the same values as stop(). Raises
    OSError.

    Either of two signs shows that the service has taken the request. One is an empty pipe, because the port owner reads
    the pipe just after it has tried to write the stop. But other programs may keep writing to the pipe. So the other
    sign is a higher epoch than at the beginning of this call. Neither shows that the stop was written, because the port
    may be gone. Only the service's state shows that.
    """
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
        text = f"the service {name!r} has taken the request, but this user can't see whether the stop was written"
        return text, f"{problem}; look at the wheels: if they turn, use the POWER SWITCH", True
    return "", problem or f"the service {name!r} has not latched it within {LATCH_S:g} s", False


def _why(cause: Cause | None) -> str:
    """The cause as text, without this program's name if this program asked for the stop."""
    own = cause and cause.named().get("pid") == os.getpid()
    return unsigned(cause) if cause and own else str(cause)


def port_of(name: str) -> str:
    """The path of the board's port, as the service reports it. Empty if it can't be read."""
    with contextlib.suppress(Exception), contextlib.closing(attach(name, layout.PORT_OWNER)) as found:
        if entry := found.latest_reader("port").read():
            return records.PORT.unpack(entry[2])[3]
    return ""


def owner_of(name: str) -> int | None:
    """The uid of the user that the service runs as. None if it can't be found out."""
    with contextlib.suppress(instance.NoService, instance.InstanceError):
        return instance.current_run(instance.find(name))[1]
    return None


def same(port: str, device: str) -> bool:
    """True if two paths lead to the same port. If a path does not exist, only the paths are compared."""
    with contextlib.suppress(OSError):
        return os.stat(port).st_rdev == os.stat(device).st_rdev != 0
    return os.path.realpath(port) == os.path.realpath(device)
