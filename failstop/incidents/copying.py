"""Copying: the segments of a run, taken apart record by record from private copies. Pure.

Every record stands on its own checksum, so a copy of a segment that is being written misses what was just being
written, and nothing else.
"""

from __future__ import annotations

import contextlib
import struct

from failstop.policy import causes
from failstop.shm import box, cell, layout, records
from failstop.shm.cell import cell_bytes

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from failstop.policy.causes import Cause
    from failstop.shm.cell import Entry

    Copies = dict[str, tuple[int, bytes]]

LEFT_OUT = "reply."
"""Answers to clients: of no use to anybody else."""
SUPERVISOR_DIED = causes.DIED(layout.SUPERVISOR)
OUTLIVED_NS = 60_000_000
"""Between two beats of whoever lives; who has beaten so long after the supervisor has outlived it."""
_WORD = struct.Struct("<Q")


def words(name: str, data: bytes) -> dict[str, int]:
    """Every word of a segment."""
    spec = layout.BY_NAME[name]
    return {
        record.name: _WORD.unpack_from(data, spec.offsets[record.name])[0]
        for record in spec.records.values()
        if record.kind == "word"
    }


def whole(name: str, record_name: str, incarnation: int, data: bytes) -> list[Entry]:
    """Every whole entry of a record (a latest has two cells, a ring many), the oldest first."""
    spec = layout.BY_NAME[name]
    record = spec.records[record_name]
    size, offset = cell_bytes(record.capacity), spec.offsets[record_name]
    seed = cell.seed(f"{name}.{record_name}", incarnation)
    found = (cell.check(data[at : at + size], seed) for at in range(offset, offset + record.size(), size))
    return sorted(entry for entry in found if entry)


def segment(name: str, incarnation: int, data: bytes) -> dict[str, Any]:
    """A segment as it is saved: words by name, latest as [seq, t_ns, payload], rings as lists of these."""
    latest, rings = {}, {}
    for record in layout.BY_NAME[name].records.values():
        if record.kind not in ("latest", "ring") or record.name.startswith(LEFT_OUT):
            continue
        entries = [list(entry) for entry in whole(name, record.name, incarnation, data)]
        if record.kind == "ring":
            rings[record.name] = entries
        elif entries:
            latest[record.name] = entries[-1]
    return {"words": words(name, data), "latest": latest, "rings": rings}


def merge(entries: list[list[Any]], earlier: list[Entry]) -> list[list[Any]]:
    """A ring, with the entries of an earlier copy of it that have been overwritten since."""
    oldest = entries[0][0] if entries else None
    return [list(entry) for entry in earlier if oldest is None or entry[0] < oldest] + entries


def unsaved_cause(copies: Copies, start_ns: int) -> tuple[int, int, Cause] | None:
    """The stop that was latched when the run ended: (cause_ns, epoch, cause). None when nothing was, or when the
    supervisor lived on for `start_ns`, from a stop to its saver's start."""
    found = whole(layout.SUPERVISOR, "latch", *copies[layout.SUPERVISOR])
    if not found:
        return None
    try:
        epoch, cause_ns, _, packed = records.LATCH.unpack(found[-1][2])
    except ValueError:
        return None
    beat_ns = words(layout.SUPERVISOR, copies[layout.SUPERVISOR][1])["beat_ns"]
    return (cause_ns, epoch, causes.read(packed)) if epoch and beat_ns < cause_ns + start_ns else None


def left_cause(copies: Copies) -> tuple[int, int, Cause]:
    """What ended a run that was not ended in order: (cause_ns, epoch, cause), by the port owner's word where it has
    outlived the supervisor, else by the last sign of life."""
    beats = {name: words(name, data)["beat_ns"] for name, (_, data) in copies.items()}
    supervisor = words(layout.SUPERVISOR, copies[layout.SUPERVISOR][1])
    # An epoch that was raised answered its causes: those of the last one had nobody to answer them.
    owed = [(ns, epoch, cause) for ns, epoch, cause in _causes(copies) if epoch >= supervisor["epoch"]]
    if owed:
        return owed[0]
    outlived = any(beat_ns > supervisor["beat_ns"] + OUTLIVED_NS for beat_ns in beats.values())
    if outlived:
        return supervisor["beat_ns"], supervisor["epoch"], SUPERVISOR_DIED
    return max(beats.values()), supervisor["epoch"], causes.ALL_DIED()


def _rows(copies: Copies, record: str) -> list[Entry]:
    """What the port owner has left in a ring of its own; nothing where it left no segment."""
    there = layout.PORT_OWNER in copies
    return whole(layout.PORT_OWNER, record, *copies[layout.PORT_OWNER]) if there else []


def _causes(copies: Copies) -> list[tuple[int, int, Cause]]:
    """What the port owner noticed: (cause_ns, epoch, cause), in order."""
    found = []
    for _, _, payload in _rows(copies, "stops"):
        with contextlib.suppress(ValueError):
            epoch, cause_ns, _, cause = records.STOPPED.unpack(payload)
            found.append((cause_ns, epoch, causes.read(cause)))
    return sorted(found, key=lambda noticed: noticed[:2])


def left_stop(copies: Copies, cause_ns: int) -> dict[str, Any] | None:
    """What is known of the stop that ended such a run, as supervisor/stops.py has it; None: nobody wrote one."""
    written: dict[int, str] = {}
    for _, ns, payload in _rows(copies, "box"):
        kind, length, taken, _ = box.WIRE.unpack(payload)
        if kind == box.BURST and taken == length:
            written.setdefault(ns, "port owner")
    if layout.STOPPER in copies:
        written.setdefault(words(layout.STOPPER, copies[layout.STOPPER][1])["written_ns"], "stopper")
    if not (after := [ns for ns in written if ns >= cause_ns]):
        return None
    stop = {"written_by": written[min(after)], "written_us": (min(after) - cause_ns) / 1e3}
    return stop | {"noticed_by": None, "acknowledged_us": None, "observed_ms": None}
