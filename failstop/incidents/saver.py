"""The saver: a short-lived process that copies the black box and writes one incident file.

The supervisor (supervisor/blackbox.py) runs it as `python -I -S saver.py key=value ...`, and passes its own search
path. The saver reads the shared memory through descriptors from the supervisor, so it also works if the run has ended.
If the saver fails, the supervisor logs one line. No stop waits for the saver.
"""

# ruff: noqa: E402 - this script must set its search path and its priority before it imports anything.

from __future__ import annotations

import contextlib
import os
import select
import sys
import time

NICE = 15

if __name__ == "__main__":
    # Lower the priority before the imports, because they take longer than the work.
    with contextlib.suppress(OSError):
        os.nice(NICE)
    sys.path[:] = os.environ["FAILSTOP_PATH"].split(os.pathsep)

from failstop.files.root import state_directory
from failstop.incidents import files, memory
from failstop.messages import layout, records, segments
from failstop.messages.packing import pack
from failstop.policy import causes
from failstop.shm.heartbeat import BEAT_STARTING
from failstop.version import VERSION

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from failstop.policy.causes import Cause

RETURN_NS = 12_000_000_000
"""How long to wait for a port that was unplugged. A USB drop lasts 3 to 8 s, and no stop can be written before the port
is back."""
SAVER_LOOK_NS = 250_000_000
MOST_SAID = 500
MOST_ENDED = 120


def main(words: dict[str, str]) -> int:
    """Save one incident, and return the exit code. Writes the map from save() to the result pipe, or a map with the
    error as `wrong` and, for a dead run, the reason of its end as `ended`.

    `words` has these keys:

    - `name`: the service
    - `fds`: the descriptors of the segments, as SEGMENT:FD,...
    - `keep`, `max_mb`: how many incidents and how much data may stay in the folder
    - `result`: the write end of the result pipe
    - `until_ns`: when to copy
    - `hurry`: a pipe that is closed if the copy must be made at once
    - `cause_ns`, `epoch`, `cause`: the stop, if the run is still alive
    - `offset_ns`: the wall clock minus the monotonic clock at that stop
    """
    with contextlib.suppress(OSError), open("/proc/self/oom_score_adj", "w", encoding="ascii") as adjust:
        adjust.write("500")  # if memory runs out, the kernel must kill this process first
    try:
        told, code = save(words), 0
    except (OSError, segments.AttachError, files.IncidentError) as error:
        told, code = {"wrong": str(error)[:MOST_SAID], **_ended(words)}, 1
    try:
        os.write(int(words["result"]), pack(told))
    except OSError:
        said = told.get("wrong") or (f"incident {told['id']} saved" if told else "nothing to save")
        with contextlib.suppress(OSError):
            os.write(2, f"failstop: the supervisor is gone; its saver says: {said}\n".encode("utf-8", "replace"))
    return code


def _ended(words: dict[str, str]) -> dict[str, str]:
    """Why a dead run ended, as `ended`, for the report that its incident could not be saved. Empty if the run is alive,
    or if that can't be read."""
    if "cause_ns" in words:
        return {}
    try:
        return {"ended": str(memory.left_cause(memory.copy(_fds(words), words["name"])[1])[2])[:MOST_ENDED]}
    except (OSError, segments.AttachError, KeyError, ValueError):
        return {}


def _fds(words: dict[str, str]) -> dict[str, int]:
    return {which: int(fd) for which, _, fd in (pair.partition(":") for pair in words["fds"].split(","))}


def save(words: dict[str, str]) -> dict[str, Any]:
    """Save one incident. Returns its `id`, the time of its cause `at` (Unix time, s), its `reason` and its `run` (this
    or before). Returns an empty map if a dead run was never ready. Raises OSError, AttachError, IncidentError."""
    name, live = words["name"], "cause_ns" in words
    fds = _fds(words)
    state = memory.word(fds[layout.SUPERVISOR], layout.SUPERVISOR, "beat_state")
    if not live and state in (0, BEAT_STARTING):
        # This run was never ready. The state is 0 if it was killed before its first heartbeat. The journal says why,
        # and a service that can't start must not fill the folder.
        return {}
    folder = os.path.join(state_directory(name, os.environ), files.FOLDER)
    # Take the number before waiting. Otherwise a later stop that waits less could get the smaller number.
    draft = files.begin(folder)
    try:
        if not _wait(words, int(words["until_ns"])) and live:
            _wait_for_port(words, fds[layout.PORT_OWNER])
        run, segments = memory.copy(fds, name)
        if live:
            latched = causes.read(bytes.fromhex(words["cause"]))
            cause = int(words["cause_ns"]), int(words["epoch"]), memory.known_better(segments, latched)
        else:
            cause = memory.left_cause(segments)
        offset_ns = int(words["offset_ns"]) if live else memory.unix_offset_ns(segments)
        head = _head(name, "stop" if live else "left", cause, run, segments, offset_ns)
        settings = dict(line.split("=", 1) for line in os.environ.get("FAILSTOP_SETTINGS", "").splitlines())
        made = files.build(head, {"segments": segments, "settings": settings, "machine": machine()})
    except BaseException:
        draft.drop()
        raise
    stamp = time.strftime("%Y%m%d-%H%M%S", time.localtime(head["t"]))
    path = draft.write(f"{stamp}-{slug(cause[2])}", made)
    files.prune(folder, name, int(words["keep"]), int(words["max_mb"]) * 1_000_000)
    told = {"id": files.identity(path), "at": round(head["t"], 3), "reason": head["reason"]}
    return told | {"run": "this" if live else "before"}


def _wait(words: dict[str, str], until_ns: int) -> bool:
    """Wait until this time. Returns True at once if the copy must be made now, because the pipe `hurry` is closed."""
    left_s = (until_ns - time.monotonic_ns()) * 1e-9
    return left_s > 0 and bool(select.select((int(words["hurry"]),), (), (), left_s)[0])


def _wait_for_port(words: dict[str, str], fd: int) -> None:
    """If the port is lost, wait at most until RETURN_NS after the cause for its return. Once the port is back, wait as
    long as after any other stop."""
    cause_ns, lost = int(words["cause_ns"]), False
    while _is_lost(words["name"], fd):
        now_ns = time.monotonic_ns()
        if now_ns > cause_ns + RETURN_NS or _wait(words, now_ns + SAVER_LOOK_NS):
            return
        lost = True
    if lost:
        _wait(words, time.monotonic_ns() + int(words["until_ns"]) - cause_ns)


def _is_lost(name: str, fd: int) -> bool:
    told = memory.entries(layout.PORT_OWNER, "port", *segments.copy(fd, name, layout.PORT_OWNER))
    return bool(told) and records.PORT.unpack(told[-1][2])[2] == records.PORT_LOST


def _head(
    name: str, kind: str, cause: tuple[int, int, Cause], run: int, segments: memory.Segments, offset_ns: int
) -> dict[str, Any]:
    """The head of the file: everything that a list of incidents shows. Every newer version of failstop can read it.
    `offset_ns`: the wall clock minus the monotonic clock at the time of the stop. All times in the file use it."""
    cause_ns, epoch, why = cause
    now_s, release = time.time(), os.uname()
    stop = memory.logged_stop(segments, cause_ns)
    if not stop or stop["written_us"] is None:
        # The stop may have been written after the supervisor's record.
        stop = (stop or {}) | memory.left_stop(segments, cause_ns) or None
    return {
        "name": name,
        "t": (cause_ns + offset_ns) / 1e9,
        "saved": now_s,
        "reason": str(why),
        "cause": why.as_map(),
        "kind": kind,
        "cause_ns": cause_ns,
        "epoch": epoch,
        "unix_minus_monotonic_ns": offset_ns,
        "stop": stop,
        "layout": layout.LAYOUT_VERSION,
        "run": f"{run:016x}",
        "host": release.nodename,
        "versions": {
            "failstop": VERSION,
            "python": ".".join(map(str, sys.version_info[:3])),
            "kernel": release.release,
            "machine": release.machine,
        },
    }


def slug(cause: Cause) -> str:
    """The cause as a part of a file name. If the cause is about a process, the process's name comes first."""
    process = cause.named().get("process")
    about = f"{process}-" if process in layout.PROCESS_NAMES else ""
    return f"{about}{cause.kind.name}".replace("_", "-")


def machine() -> dict[str, Any]:
    """How busy the computer is. The unit's ProcSubset=pid may hide a part of this."""
    found: dict[str, Any] = {"cores": os.cpu_count()}
    with contextlib.suppress(OSError):
        found["load"] = " ".join(f"{load:.2f}" for load in os.getloadavg())
    return found


if __name__ == "__main__":
    sys.exit(main(dict(word.split("=", 1) for word in sys.argv[1:])))
