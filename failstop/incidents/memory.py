"""Memory: decodes the shared memory of a run, record by record. It also finds out which stop ended the run, which
process wrote it, and how it was proven.

Every record has its own checksum. So a copy can be made while a process writes, and lacks only what was being written
at that moment.
"""

from __future__ import annotations

import contextlib
import os
import struct
import time

import msgpack

from failstop.api.words import took
from failstop.messages import box, layout, records
from failstop.messages import segments as shared
from failstop.policy import causes
from failstop.policy.proofs import LINK_UNASKED, NO_IMU, NOT_SENT, TO_A_STRANGER, UNMOVED, heard_late, unmoved
from failstop.policy.proofs import still_or_unseen as seen_after
from failstop.shm import cell
from failstop.shm.cell import cell_bytes

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from failstop.policy.causes import Cause
    from failstop.shm.cell import Entry

    Segments = dict[str, dict[str, Any]]
    """The segments of a run by their names, each as segment() returns it. An incident's file holds the same."""

OUTLIVED_NS = 60_000_000
"""The longest time between two beats of a live process. If a process's last beat is later than the supervisor's last
beat by more than this, the process has outlived the supervisor."""
NOT_KNOWN = "not known"
_LATER = ("acknowledged_us", "acknowledged_by", "observed_ms", "observed_by", "observed_late")
PROOF_WORDS = ("noticed_by", "written_by", "written_us", "sent", "believed", *_LATER)
_WORD = struct.Struct("<Q")


def entries(name: str, record_name: str, incarnation: int, data: bytes) -> list[Entry]:
    """All intact entries of a record, the oldest first. A record of the kind `latest` has two cells, and a ring has
    many. `data` is a copy of the segment from messages.segments.copy()."""
    spec = layout.SEGMENT_BY_NAME[name]
    record = spec.records[record_name]
    size, offset = cell_bytes(record.capacity), spec.offsets[record_name]
    seed = cell.seed(f"{name}.{record_name}", incarnation)
    found = (cell.check(data[at : at + size], seed) for at in range(offset, offset + record.size(), size))
    return sorted(entry for entry in found if entry)


def segment(name: str, incarnation: int, data: bytes) -> dict[str, Any]:
    """Decode a copy of a segment into the form in which it is saved: words by name, each latest record as [seq, t_ns,
    payload], and each ring as a list of such entries."""
    spec = layout.SEGMENT_BY_NAME[name]
    found: dict[str, dict[str, Any]] = {"words": {}, "latest": {}, "rings": {}}
    for record in spec.records.values():
        if record.kind == "word":
            found["words"][record.name] = _WORD.unpack_from(data, spec.offsets[record.name])[0]
        # Answers to clients are left out, because only the client needs them.
        elif record.kind in ("latest", "ring") and not record.name.startswith("reply."):
            there = [list(entry) for entry in entries(name, record.name, incarnation, data)]
            if record.kind == "ring":
                found["rings"][record.name] = there
            elif there:
                found["latest"][record.name] = there[-1]
    return found


def word(fd: int, name: str, record_name: str) -> int:
    """Read a word (a single number) of a segment through its descriptor. 0 if the segment is too short. Raises
    OSError."""
    data = os.pread(fd, _WORD.size, layout.SEGMENT_BY_NAME[name].offsets[record_name])
    return int(_WORD.unpack(data)[0]) if len(data) == _WORD.size else 0


def copy(fds: dict[str, int], memory: str) -> tuple[int, Segments]:
    """Copy all segments of a run. Returns the run's number and its segments. Raises AttachError, OSError."""
    copies = {which: shared.copy(fd, memory, which) for which, fd in fds.items()}
    return copies[layout.SUPERVISOR][0], {which: segment(which, *copied) for which, copied in copies.items()}


def left_cause(segments: Segments) -> tuple[int, int, Cause]:
    """Why a run ended unexpectedly, as (cause_ns, epoch, cause). A cause that the port owner noticed and the supervisor
    did not handle comes first. Otherwise the last signs of life decide."""
    supervisor = segments[layout.SUPERVISOR]["words"]
    beat_ns, raised = supervisor["beat_ns"], supervisor["epoch"]
    owed = []
    for _, _, payload in segments[layout.PORT_OWNER]["rings"]["stops"]:
        with contextlib.suppress(ValueError):
            epoch, cause_ns, _, cause = records.STOPPED.unpack(payload)
            # A raised epoch shows that its causes were handled. Nobody handled the causes of the last epoch.
            if epoch >= raised:
                owed.append((cause_ns, epoch, causes.read(cause)))
    if owed:
        return min(owed, key=lambda noticed: noticed[:2])
    last_ns = max(found["words"]["beat_ns"] for found in segments.values())
    if last_ns > beat_ns + OUTLIVED_NS:
        return beat_ns, raised, causes.DIED(layout.SUPERVISOR)
    return last_ns, raised, causes.ALL_DIED()


def unix_offset_ns(segments: Segments) -> int:
    """The wall clock minus the monotonic clock at the run's newest event, which shows both times. Without an event, the
    offset is the present one. The two may differ, because the machine may have slept since the run ended."""
    for _, _, payload in reversed(segments[layout.SUPERVISOR]["rings"]["events"]):
        event = as_map(payload)
        if isinstance(t := event.get("t"), float) and isinstance(ns := event.get("ns"), int):
            return round(t * 1e9) - ns
    return time.time_ns() - time.monotonic_ns()


def known_better(segments: Segments, latched: Cause) -> Cause:
    """The cause of a latched stop, with details that became known after it was latched."""
    try:
        now = causes.read(records.LATCH.unpack(segments[layout.SUPERVISOR]["latest"]["latch"][2])[-1])
    except (KeyError, ValueError):
        return latched
    return now if causes.completed(latched, now) else latched


def left_stop(segments: Segments, cause_ns: int) -> dict[str, Any]:
    """Who wrote the first complete stop burst since the cause, the port owner or the stopper: `written_by`, and
    `written_us` after the cause. Empty if neither wrote one."""
    by_stopper = segments[layout.STOPPER]["words"]["written_ns"]
    written = {by_stopper: "stopper"} if by_stopper else {}  # 0: it has written none
    for _, ns, payload in segments[layout.PORT_OWNER]["rings"]["box"]:
        kind, length, taken, _ = box.WIRE.unpack(payload)
        if kind == box.WIRE_BURST and taken == length:
            written[ns] = "port owner"
    first_ns = min((ns for ns in written if ns >= cause_ns), default=None)
    if first_ns is None:
        return {}
    return {"written_by": written[first_ns], "written_us": (first_ns - cause_ns) / 1e3}


def logged_stop(segments: Segments, cause_ns: int) -> dict[str, Any] | None:
    """The supervisor's record of the stop whose cause was noticed at `cause_ns`: a map with PROOF_WORDS and `wheels`
    (still, unstill or unknown). If the outcome of the stop was logged, the map also has the `link` to the board at that
    time. None if nothing was recorded.

    The supervisor's record of the last stop (supervisor/proof.py) may be about a later stop. Its events `stop` and
    `stop_outcome` name their stop.
    """
    supervisor = segments[layout.SUPERVISOR]
    found: dict[str, Any] = {}
    last = as_map(supervisor["latest"].get("stop", (0, 0, b""))[2])
    if last.get("noticed_ns") == cause_ns:
        found = {level: last.get(level) for level in PROOF_WORDS}
    for event in (as_map(payload) for _, _, payload in supervisor["rings"]["events"]):
        fields = event.get("fields", {})
        if not isinstance(fields, dict) or fields.get("noticed_ns") != cause_ns:
            continue
        if event.get("kind") == "stop":
            told = {key: fields.get(key) for key in ("noticed_by", "written_by")}
            found = told | {"written_us": fields.get("latency_us")} | found
        elif event.get("kind") == "stop_outcome":
            found |= {key: fields[key] for key in (*_LATER, "sent", "wheels", "link") if key in fields}
    return dict.fromkeys(PROOF_WORDS) | {"wheels": "unknown"} | found if found else None


def as_map(payload: bytes) -> dict[str, Any]:
    """Unpack a msgpack map. Empty if the bytes are not one."""
    try:
        found = msgpack.unpackb(payload)
    except (ValueError, msgpack.UnpackException):
        return {}
    return found if isinstance(found, dict) else {}


def proofs(head: dict[str, Any]) -> list[tuple[str, bool | None]]:
    """The three levels of proof from an incident's head, each as (text, True if proven). The second value is None if
    this is not known, for example if the wheels were not seen moving before the stop."""
    stop: dict[str, Any] = head["stop"] or {}
    outcome = stop.get("link")
    written_us, heard_us, seen_ms = (stop.get(level) for level in ("written_us", "acknowledged_us", "observed_ms"))
    found: list[tuple[str, bool | None]] = [
        (f"whether a stop was written: {NOT_KNOWN}", None),
        (f"whether the board answered: {NOT_KNOWN}", None),
        (f"whether the wheels stopped: {NOT_KNOWN}", None),
    ]
    if written_us is not None:
        # Old files lack `sent` and `believed`. None or no value means that nothing speaks against the stop.
        sent, believed = (stop.get(level) is not False or heard_us is not None for level in ("sent", "believed"))
        written = f"written after {took(written_us / 1e6)}{'' if believed else f' {TO_A_STRANGER}'}"
        found[0] = written if sent else NOT_SENT, sent and believed
    elif stop:
        found[0] = f"NOT written within {took(max(0.0, head['saved'] - head['t']))}", False
    late = heard_late(head.get("cause", {}).get("process"))
    if heard_us is not None:
        found[1] = f"acknowledged after {took(heard_us / 1e6)}{late}", True
    elif stop.get("acknowledged_by") == "":
        found[1] = "this board never acknowledges a stop", None
    elif outcome and stop.get("acknowledged_by"):
        excused = outcome == LINK_UNASKED and unmoved(seen_ms, stop.get("observed_by") or "")
        found[1] = (UNMOVED, None) if excused else ("NOT acknowledged", False)
    if seen_ms is not None:
        # This must be short enough for a line of 80 columns.
        since = bool(stop.get("observed_late"))
        seen = seen_after(seen_ms / 1e3, by=stop.get("observed_by") or "IMU", late=since)
        found[2] = f"{seen}{late}" if seen_ms else seen, True if seen_ms else None
    elif stop.get("observed_by") == "":
        found[2] = NO_IMU, None
    elif stop.get("wheels") == "unstill" or (outcome and stop.get("observed_by")):
        found[2] = "wheels NOT seen still", False
    return found


def proven(head: dict[str, Any]) -> str:
    """The three levels of proof in one line."""
    return ", ".join(text for text, _ in proofs(head))
