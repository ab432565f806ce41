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
from unicodedata import normalize

from failstop.incidents import copying, file, outcome
from failstop.incidents.store import FOLDER, prune
from failstop.policy import causes
from failstop.procs.telemetry.state_files import state_directory
from failstop.shm import layout, records, segment
from failstop.shm.heartbeat import STARTING
from failstop.shm.packing import pack
from failstop.supervisor.blackbox import START_NS
from failstop.version import VERSION

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from failstop.incidents.copying import Copies
    from failstop.policy.causes import Cause

SLUG_CHARACTERS = frozenset("abcdefghijklmnopqrstuvwxyz0123456789")
SLUG_LENGTH = 32
RETURN_NS = 12_000_000_000
"""A lost port is waited for: no stop can be written before it is back, and a USB drop lasts 3 to 8 s."""
LOOK_NS = 250_000_000
PRESSURES = ("cpu", "memory", "io")
MOST_SAID = 500


def main(words: dict[str, str]) -> int:
    """Save one incident; tells the result pipe which (empty: a dead run is not worth one), or what is `wrong`. Returns
    the exit code.

    words: name; fds: SEGMENT:FD,...; keep, max_mb; result: a pipe's end to write to; until_ns: when to copy, or sooner,
    when the pipe `hurry` is closed; and for a run that still lives: cause_ns, epoch, reason.
    """
    with contextlib.suppress(OSError), open("/proc/self/oom_score_adj", "w", encoding="ascii") as adjust:
        adjust.write("500")  # of all processes here, the one to do without
    try:
        told, code = _save(words), 0
    except (OSError, segment.AttachError, file.IncidentError) as error:
        told, code = {"wrong": str(error)[:MOST_SAID]}, 1
    try:
        os.write(int(words["result"]), pack(told))
    except OSError:
        from failstop.supervisor.events import say

        said = told.get("wrong") or (f"incident {told['id']} saved" if told else "nothing to save")
        say(f"the supervisor is gone; its saver says: {said}")
    return code


def _save(words: dict[str, str]) -> dict[str, Any]:
    """Returns which: its id, when its cause was (Unix time, s), the cause's text, and of which run it is."""
    name = words["name"]
    fds = {which: int(fd) for which, _, fd in (pair.partition(":") for pair in words["fds"].split(","))}
    live = "cause_ns" in words
    earlier = []
    if live:
        # The bytes of the last seconds before the stop: by the time of the copy they are overwritten.
        incarnation, data = segment.copy(fds[layout.PORT_OWNER], name, layout.PORT_OWNER)
        earlier = copying.whole(layout.PORT_OWNER, "received", incarnation, data)
        del data
    hurry, until_ns = int(words["hurry"]), int(words["until_ns"])
    hurried = _wait(until_ns, hurry)
    if live and not hurried:
        _wait_for_port(name, fds[layout.PORT_OWNER], int(words["cause_ns"]), until_ns, hurry)
    copies = {which: segment.copy(fd, name, which) for which, fd in fds.items()}
    segments = {which: copying.segment(which, run, data) for which, (run, data) in copies.items()}
    if earlier:
        received = segments[layout.PORT_OWNER]["rings"]
        received["received"] = copying.merge(received["received"], earlier)
    if not live and segments[layout.SUPERVISOR]["words"]["beat_state"] == STARTING:
        return {}  # it never was ready: why is in the journal, and a service that can't start must not fill the folder
    if live:
        cause = int(words["cause_ns"]), int(words["epoch"]), causes.read(bytes.fromhex(words["cause"]))
    else:
        # What came before the end, if no other file has it, is what people look for.
        cause = copying.unsaved_cause(copies, START_NS) or copying.left_cause(copies)
    folder = os.path.join(state_directory(name, os.environ), FOLDER)
    head, body = _head(name, cause, live, copies, segments), _body(segments)
    stamp = time.strftime("%Y%m%d-%H%M%S", time.localtime(head["t"]))
    path = file.write(folder, f"{stamp}-{slug(cause[2])}", file.build(head, body))
    prune(folder, name, int(words["keep"]), int(words["max_mb"]) * 1_000_000)
    identity = os.path.basename(path).removesuffix(file.SUFFIX)
    return {"id": identity, "at": round(head["t"], 3), "reason": head["reason"], "run": "this" if live else "before"}


def _wait(until_ns: int, hurry: int) -> bool:
    """Until it is time; True when the supervisor ends before that."""
    left_s = (until_ns - time.monotonic_ns()) * 1e-9
    return left_s > 0 and bool(select.select((hurry,), (), (), left_s)[0])


def _wait_for_port(name: str, fd: int, cause_ns: int, until_ns: int, hurry: int) -> None:
    """While the port is lost; once it is back, as long again as after any stop."""
    lost = False
    while (now_ns := time.monotonic_ns()) < cause_ns + RETURN_NS:
        if not _port_lost(name, fd):
            if lost:
                _wait(now_ns + until_ns - cause_ns, hurry)
            return
        lost = True
        if _wait(now_ns + LOOK_NS, hurry):
            return


def _port_lost(name: str, fd: int) -> bool:
    incarnation, data = segment.copy(fd, name, layout.PORT_OWNER)
    found = copying.whole(layout.PORT_OWNER, "port", incarnation, data)
    return bool(found) and records.PORT.unpack(found[-1][2])[2] == records.PORT_LOST


def _head(
    name: str, cause: tuple[int, int, Cause], live: bool, copies: Copies, segments: dict[str, Any]
) -> dict[str, Any]:
    """What a list of incidents shows, and a newer version can always read."""
    cause_ns, epoch, why = cause
    now_s, release = time.time(), os.uname()
    # One clock for all that is in the file; a wall clock that was set since the stop is off by as much.
    unix_minus_monotonic_ns = round(now_s * 1e9) - time.monotonic_ns()
    at_s = (cause_ns + unix_minus_monotonic_ns) / 1e9
    versions = {"failstop": VERSION, "python": ".".join(map(str, sys.version_info[:3]))}
    return {
        "name": name,
        "t": at_s,
        "saved": now_s,
        "reason": str(why),
        "cause": why.as_map(),
        "kind": "stop" if live else "left",
        "cause_ns": cause_ns,
        "epoch": epoch,
        "unix_minus_monotonic_ns": unix_minus_monotonic_ns,
        "stop": _outcome(copies, segments, cause),
        "layout": layout.LAYOUT_VERSION,
        "run": f"{copies[layout.SUPERVISOR][0]:016x}",
        "host": release.nodename,
        "versions": {**versions, "kernel": release.release, "machine": release.machine},
    }


def _body(segments: dict[str, Any]) -> dict[str, Any]:
    return {
        "segments": segments,
        "settings": dict(line.split("=", 1) for line in os.environ.get("FAILSTOP_SETTINGS", "").splitlines()),
        "machine": machine(),
    }


def _outcome(copies: Copies, segments: dict[str, Any], cause: tuple[int, int, Cause]) -> dict[str, Any] | None:
    """What the supervisor has told; of a stop that was written later than it knew, what the rings hold."""
    cause_ns, epoch, why = cause
    supervisor = segments[layout.SUPERVISOR]
    record = supervisor["latest"].get("stop")
    events = [payload for _, _, payload in supervisor["rings"]["events"]]
    told = outcome.known(record[2] if record else None, events, epoch, why)
    if told and told["written_us"] is not None:
        return told
    seen = copying.left_stop(copies, cause_ns)
    if told and seen:
        return told | {"written_by": seen["written_by"], "written_us": seen["written_us"]}
    return told or seen


def slug(cause: Cause) -> str:
    """A cause in a few whole words, as part of a file name: without who asked for it, and what the service itself says
    without the details after a colon."""
    text = outcome.short(cause)
    if not outcome.asked(cause):
        text = text.split(": ")[0]
    plain = normalize("NFKD", text.lower()).replace("'", "")
    words = "".join(c if c in SLUG_CHARACTERS else " " for c in plain if ord(c) < 0x300 or ord(c) > 0x36F).split()
    kept = words[:1]
    for word in words[1:]:
        if len("-".join((*kept, word))) > SLUG_LENGTH:
            # "hand near the wheel and a": what it leads to is not there.
            while len(kept) > 1 and len(kept[-1]) <= 3:
                kept.pop()
            break
        kept.append(word)
    return "-".join(kept)[:SLUG_LENGTH] or "stop"


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
