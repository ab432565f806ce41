"""The saver: a short-lived process of its own that copies the black box and writes one file.

It reads shared memory through descriptors that the supervisor hands it, so a run that ends meanwhile, or has ended
long ago, makes no difference. Whatever fails here is one line for the supervisor, and no stop waits for it.
"""

from __future__ import annotations

import contextlib
import os
import select
import sys
import time

from failstop.incidents import copying, file, outcome
from failstop.incidents.prune import prune
from failstop.shm import layout, segment
from failstop.shm.heartbeat import STARTING
from failstop.supervisor.blackbox import NOTHING
from failstop.version import VERSION

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from failstop.incidents.copying import Copies

FOLDER = "incidents"
SLUG_CHARACTERS = frozenset("abcdefghijklmnopqrstuvwxyz0123456789")
PRESSURES = ("cpu", "memory", "io")


def main(words: dict[str, str]) -> int:
    """Save one incident; tells the result pipe `saved ID`, NOTHING, or why not. Returns the exit code.

    words: name; fds: SEGMENT:FD,...; keep, max_mb; result: a pipe's end to write to; until_ns: when to copy, or sooner,
    when the pipe `hurry` is closed; and for a run that still lives: cause_ns, epoch, reason.
    """
    with contextlib.suppress(OSError), open("/proc/self/oom_score_adj", "w", encoding="ascii") as adjust:
        adjust.write("500")  # of all processes here, the one to do without
    try:
        identity = _save(words)
        text, code = f"saved {identity}" if identity else NOTHING, 0
    except (OSError, segment.AttachError, file.IncidentError) as error:
        text, code = f"{error}", 1
    os.write(int(words["result"]), text.encode("utf-8", "replace")[:2000])
    return code


def _save(words: dict[str, str]) -> str:
    """Returns the incident's id; empty when a dead run is not worth one."""
    name = words["name"]
    fds = {which: int(fd) for which, _, fd in (pair.partition(":") for pair in words["fds"].split(","))}
    live = "cause_ns" in words
    earlier = []
    if live:
        # The bytes of the last seconds before the stop: by the time of the copy they are overwritten.
        incarnation, data = segment.copy(fds[layout.PORT_OWNER], name, layout.PORT_OWNER)
        earlier = copying.whole(layout.PORT_OWNER, "received", incarnation, data)
        del data
    _wait(int(words["until_ns"]), int(words["hurry"]))
    copies = {which: segment.copy(fd, name, which) for which, fd in fds.items()}
    segments = {which: copying.segment(which, run, data) for which, (run, data) in copies.items()}
    if earlier:
        received = segments[layout.PORT_OWNER]["rings"]
        received["received"] = copying.merge(received["received"], earlier)
    if not live and segments[layout.SUPERVISOR]["words"]["beat_state"] == STARTING:
        return ""  # it never was ready: why is in the journal, and a service that can't start must not fill the folder
    cause = (int(words["cause_ns"]), int(words["epoch"]), words["reason"]) if live else copying.left_cause(copies)
    folder = os.path.join(_state_directory(name), FOLDER)
    path = file.write(folder, *_contents(name, cause, live, copies, segments))
    prune(folder, name, int(words["keep"]), int(words["max_mb"]) * 1_000_000)
    return os.path.basename(path).removesuffix(file.SUFFIX)


def _wait(until_ns: int, hurry: int) -> None:
    """Until it is time, or the supervisor ends."""
    left_s = (until_ns - time.monotonic_ns()) * 1e-9
    if left_s > 0:
        select.select((hurry,), (), (), left_s)


def _state_directory(name: str) -> str:
    from failstop.procs.telemetry.state_files import state_directory

    return state_directory(name, os.environ)


def _contents(
    name: str, cause: tuple[int, int, str], live: bool, copies: Copies, segments: dict[str, Any]
) -> tuple[str, bytes]:
    """The file's name, without its suffix, and its bytes."""
    cause_ns, epoch, reason = cause
    now_s = time.time()
    # One clock for all that is in the file; a wall clock that was set since the stop is off by as much.
    unix_minus_monotonic_ns = round(now_s * 1e9) - time.monotonic_ns()
    at_s = (cause_ns + unix_minus_monotonic_ns) / 1e9
    release = os.uname()
    head = {
        "name": name,
        "t": at_s,
        "saved": now_s,
        "reason": reason,
        "kind": "stop" if live else "left",
        "cause_ns": cause_ns,
        "epoch": epoch,
        "unix_minus_monotonic_ns": unix_minus_monotonic_ns,
        "stop": _outcome(segments, epoch, reason) if live else copying.left_stop(copies, cause_ns),
        "layout": layout.LAYOUT_VERSION,
        "run": f"{copies[layout.SUPERVISOR][0]:016x}",
        "host": release.nodename,
        "versions": {
            "failstop": VERSION,
            "python": ".".join(map(str, sys.version_info[:3])),
            "kernel": release.release,
            "machine": release.machine,
        },
    }
    body = {
        "segments": segments,
        "settings": dict(line.split("=", 1) for line in os.environ.get("FAILSTOP_SETTINGS", "").splitlines()),
        "machine": machine(),
    }
    stamp = time.strftime("%Y%m%d-%H%M%S", time.localtime(at_s))
    return f"{stamp}-{slug(reason)}", file.build(head, body)


def _outcome(segments: dict[str, Any], epoch: int, reason: str) -> dict[str, Any] | None:
    supervisor = segments[layout.SUPERVISOR]
    record = supervisor["latest"].get("stop")
    events = [payload for _, _, payload in supervisor["rings"]["events"]]
    return outcome.known(record[2] if record else None, events, epoch, reason)


def slug(reason: str) -> str:
    """The beginning of a reason as part of a file name."""
    text = "".join(c if c in SLUG_CHARACTERS else "-" for c in reason.lower().split(" (")[0][:40])
    return "-".join(filter(None, text.split("-")))[:28].strip("-") or "stop"


def machine() -> dict[str, Any]:
    """How busy the machine was: load, memory, pressure (share of the last 10 s that something waited), uptime."""
    found: dict[str, Any] = {"cores": os.cpu_count()}
    # Under the unit's ProcSubset=pid, and with an older libc, it can't be had.
    with contextlib.suppress(OSError):
        found["load"] = [round(load, 2) for load in os.getloadavg()]
    for what, path in (("uptime_s", "/proc/uptime"), ("boot", "/proc/sys/kernel/random/boot_id")):
        with contextlib.suppress(OSError), open(path, encoding="ascii") as source:
            found[what] = source.read().split()[0]
    with contextlib.suppress(OSError), open("/proc/meminfo", encoding="ascii") as source:
        rows = dict(line.split(":", 1) for line in source)
        found["available_mb"] = int(rows["MemAvailable"].split()[0]) // 1024
    for what in PRESSURES:
        with contextlib.suppress(OSError, ValueError, IndexError), open(f"/proc/pressure/{what}") as source:
            found[f"pressure_{what}_percent"] = float(source.readline().split()[1].partition("=")[2])
    return found
