"""The saver: a short-lived process of its own that copies the black box and writes one file.

`python -I -S saver.py key=value ...`, run by the supervisor (supervisor/blackbox.py), which hands its search path over.
It reads shared memory through descriptors that the supervisor hands it, so a run that ends meanwhile, or has ended
long ago, makes no difference. Whatever fails here is one line for the supervisor, and no stop waits for it.
"""

# ruff: noqa: E402 - a script of a search path and a priority of its own, which it needs before it imports.

from __future__ import annotations

import contextlib
import os
import select
import sys
import time
from unicodedata import normalize

NICE = 15

if __name__ == "__main__":
    # The imports take longer than the work.
    with contextlib.suppress(OSError):
        os.nice(NICE)
    sys.path[:] = os.environ["FAILSTOP_PATH"].split(os.pathsep)

from failstop.incidents import files, memory
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

    from failstop.policy.causes import Cause
    from failstop.shm.cell import Entry

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
    when the pipe `hurry` is closed; and for a run that still lives: cause_ns, epoch, cause.
    """
    with contextlib.suppress(OSError), open("/proc/self/oom_score_adj", "w", encoding="ascii") as adjust:
        adjust.write("500")  # of all processes here, the one to do without
    try:
        told, code = Saver(words).save(), 0
    except (OSError, segment.AttachError, files.IncidentError) as error:
        told, code = {"wrong": str(error)[:MOST_SAID]}, 1
    try:
        os.write(int(words["result"]), pack(told))
    except OSError:
        from failstop.supervisor.events import say

        said = told.get("wrong") or (f"incident {told['id']} saved" if told else "nothing to save")
        say(f"the supervisor is gone; its saver says: {said}")
    return code


class Saver:
    """Of one incident; `words` as of main()."""

    def __init__(self, words: dict[str, str]) -> None:
        self._words = words
        self._name = words["name"]
        self._fds = {which: int(fd) for which, _, fd in (pair.partition(":") for pair in words["fds"].split(","))}
        self._hurry, self._until_ns = int(words["hurry"]), int(words["until_ns"])
        self._live = "cause_ns" in words

    def save(self) -> dict[str, Any]:
        """Returns which: its id, when its cause was (Unix time, s), the cause's text, and of which run it is."""
        # The bytes of the last seconds before the stop: by the time of the copy they are overwritten.
        earlier = self._entries("received") if self._live else []
        hurried = self._wait(self._until_ns)
        if self._live and not hurried:
            self._wait_for_port(int(self._words["cause_ns"]))
        run, segments = memory.copy(self._fds, self._name)
        received = segments[layout.PORT_OWNER]["rings"]["received"]
        oldest = received[0][0] if received else None
        received[:0] = [list(entry) for entry in earlier if oldest is None or entry[0] < oldest]
        if self._live:
            packed = bytes.fromhex(self._words["cause"])
            cause = int(self._words["cause_ns"]), int(self._words["epoch"]), causes.read(packed)
        elif segments[layout.SUPERVISOR]["words"]["beat_state"] == STARTING:
            # It never was ready: why is in the journal, and a service that can't start must not fill the folder.
            return {}
        else:
            # What came before the end, if no other file has it, is what people look for.
            cause = memory.unsaved_cause(segments, START_NS) or memory.left_cause(segments)
        head = self._head(cause, run, segments)
        settings = os.environ.get("FAILSTOP_SETTINGS", "").splitlines()
        body = {
            "segments": segments,
            "settings": dict(line.split("=", 1) for line in settings),
            "machine": machine(),
        }
        folder = os.path.join(state_directory(self._name, os.environ), files.FOLDER)
        stamp = time.strftime("%Y%m%d-%H%M%S", time.localtime(head["t"]))
        path = files.write(folder, f"{stamp}-{slug(cause[2])}", files.build(head, body))
        files.prune(folder, self._name, int(self._words["keep"]), int(self._words["max_mb"]) * 1_000_000)
        which = "this" if self._live else "before"
        return {"id": files.identity(path), "at": round(head["t"], 3), "reason": head["reason"], "run": which}

    def _entries(self, record: str) -> list[Entry]:
        """Of the port owner, as of now."""
        copied = segment.copy(self._fds[layout.PORT_OWNER], self._name, layout.PORT_OWNER)
        return memory.entries(layout.PORT_OWNER, record, *copied)

    def _wait(self, until_ns: int) -> bool:
        """Until it is time; True when the supervisor ends before that."""
        left_s = (until_ns - time.monotonic_ns()) * 1e-9
        return left_s > 0 and bool(select.select((self._hurry,), (), (), left_s)[0])

    def _wait_for_port(self, cause_ns: int) -> None:
        """While the port is lost; once it is back, as long again as after any stop."""
        lost = False
        while (port := self._entries("port")) and records.PORT.unpack(port[-1][2])[2] == records.PORT_LOST:
            now_ns = time.monotonic_ns()
            if now_ns > cause_ns + RETURN_NS or self._wait(now_ns + LOOK_NS):
                return
            lost = True
        if lost:
            self._wait(time.monotonic_ns() + self._until_ns - cause_ns)

    def _head(self, cause: tuple[int, int, Cause], run: int, segments: memory.Segments) -> dict[str, Any]:
        """What a list of incidents shows, and a newer version can always read."""
        cause_ns, epoch, why = cause
        now_s, release = time.time(), os.uname()
        # One clock for all that is in the file; a wall clock that was set since the stop is off by as much.
        unix_minus_monotonic_ns = round(now_s * 1e9) - time.monotonic_ns()
        stop = memory.told_stop(segments, epoch, why)
        if (not stop or stop["written_us"] is None) and (seen := memory.left_stop(segments, cause_ns)):
            # It was written later than the supervisor knew.
            stop = stop | {key: seen[key] for key in ("written_by", "written_us")} if stop else seen
        return {
            "name": self._name,
            "t": (cause_ns + unix_minus_monotonic_ns) / 1e9,
            "saved": now_s,
            "reason": str(why),
            "cause": why.as_map(),
            "kind": "stop" if self._live else "left",
            "cause_ns": cause_ns,
            "epoch": epoch,
            "unix_minus_monotonic_ns": unix_minus_monotonic_ns,
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
    """A cause in a few whole words, as part of a file name: without who asked for it, and what the service itself says
    without the details after a colon."""
    text = memory.short(cause)
    if cause.kind not in (causes.REQUESTED, causes.FLEET, causes.PIPED):
        text = text.split(": ")[0]
    plain = normalize("NFKD", text.lower().replace("'", "")).encode("ascii", "ignore").decode()
    words = "".join(c if c.isalnum() else " " for c in plain).split()
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


if __name__ == "__main__":
    sys.exit(main(dict(word.split("=", 1) for word in sys.argv[1:])))
