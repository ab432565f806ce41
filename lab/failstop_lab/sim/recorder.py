"""The simulated board's record: one JSON line for every chunk received, every frame executed and every fault.

    {"kind": "chunk", "t_ns": ..., "hex": ...}
    {"kind": "frame", "index": ..., "arrival_ns": ..., "executed_ns": ..., "func": ..., "hex": ..., "speeds_rps": [...]}
    {"kind": "fault", "t_ns": ..., "request": {...}}

Chunks are as the host sent them, before any fault. Times are CLOCK_MONOTONIC. A frame follows the chunk it came in,
after its time on the wire. Speeds that are not finite are written NaN and Infinity, as Python's json reads them.
"""

from __future__ import annotations

import json
import sys
from typing import Any

from failstop_lab.sim.model import Frame
from failstop_lab.sim.pty_port import SimError

# Formatting and writing are put off to here, away from the reading that stamps the times.
BATCH_NS = 250_000_000


class Recorder:
    """Writes the record to a file, in batches; close() writes the rest. Raises SimError when it cannot be opened."""

    def __init__(self, path: str) -> None:
        self._path = path
        self._waiting: list[tuple[int, bytes] | Frame | dict[str, Any]] = []
        self._due_ns = 0
        try:
            # No buffer of its own: what write() returned from survives this process.
            self._file = open(path, "wb", buffering=0)  # noqa: SIM115
        except OSError as error:
            raise SimError(f"cannot write {path}: {error.strerror}: name another file with --record") from None

    def chunk(self, t_ns: int, data: bytes) -> None:
        """Bytes that were read at t_ns."""
        self._waiting.append((t_ns, data))

    def frame(self, frame: Frame) -> None:
        """A frame that was executed."""
        self._waiting.append(frame)

    def fault(self, t_ns: int, request: dict[str, Any]) -> None:
        """A request that changed the board."""
        self._waiting.append({"kind": "fault", "t_ns": t_ns, "request": request})

    def write_due(self, now_ns: int) -> None:
        """Write what is waiting if the last writing is long enough ago."""
        if self._waiting and now_ns >= self._due_ns:
            self._write()
            self._due_ns = now_ns + BATCH_NS

    def close(self) -> None:
        """Write the rest and close the file."""
        self._write()
        self._file.close()

    def _write(self) -> None:
        text = "".join(_line(entry) for entry in self._waiting)
        self._waiting.clear()
        try:
            self._file.write(text.encode())
        except OSError as error:
            # The board goes on: it judges by its events, the record is for afterwards.
            print(f"failstop sim: {self._path} is incomplete: {error.strerror}", file=sys.stderr)


def _line(entry: tuple[int, bytes] | Frame | dict[str, Any]) -> str:
    if isinstance(entry, tuple):
        return f'{{"kind": "chunk", "t_ns": {entry[0]}, "hex": "{entry[1].hex()}"}}\n'
    if isinstance(entry, dict):
        return json.dumps(entry) + "\n"
    fields: dict[str, Any] = {"kind": "frame", "index": entry.index, "arrival_ns": entry.arrival_ns}
    fields |= {"executed_ns": entry.executed_ns, "func": entry.func, "hex": entry.data.hex()}
    fields |= {"speeds_rps": entry.speeds}
    if entry.wild:
        fields["wild"] = entry.wild
    return json.dumps(fields) + "\n"
