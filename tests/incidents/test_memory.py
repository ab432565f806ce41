"""Memory: real segments, whole ones and torn ones; what ended a run that nobody ended; how a stop was proven, of this
stop and not of a later one."""

from __future__ import annotations

import itertools
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import msgpack
import pytest

from failstop.board.rrc.board import BOARD
from failstop.incidents import left, memory
from failstop.incidents.memory import logged_stop
from failstop.messages import box, layout, records, segments
from failstop.policy import causes
from failstop.policy.causes import Cause
from failstop.policy.proofs import UNMOVED
from failstop.shm import segment
from failstop.shm.cell import cell_bytes

_numbers = itertools.count()
RUN = 0x1234567890
GATE_DIED = causes.DIED(layout.GATE)
SUPERVISOR_DIED = causes.DIED(layout.SUPERVISOR)
HANGS = causes.HANGS(layout.SUPERVISOR, 60)


@pytest.fixture
def name() -> Iterator[str]:
    instance = f"copy{os.getpid()}x{next(_numbers)}"
    for process in layout.PROCESS_NAMES:
        segments.create(instance, process, RUN).close()
    yield instance
    segments.unlink_all(instance)


@contextmanager
def opened(name: str) -> Iterator[dict[str, int]]:
    """The descriptors of a run's segments, for the length of a block."""
    fds = segments.open_all(name)
    yield fds
    for fd in fds.values():
        os.close(fd)


def copied(name: str) -> dict[str, dict[str, Any]]:
    with opened(name) as fds:
        assert list(fds) == list(layout.PROCESS_NAMES)
        run, found = memory.copy(fds, name)
    assert run == RUN
    return found


def owned(name: str, process: str) -> segment.Segment:
    return segments.attach(name, process, RUN, write=True)


def test_words_latest_and_rings_come_back_as_written(name: str) -> None:
    gate = owned(name, layout.GATE)
    gate.word("resets_asked").set(9)
    gate.latest_writer("state").write(b"old", 1)
    gate.latest_writer("state").write(b"new", 2)
    gate.latest_writer("reply.0").write(b"secret", 2)
    writer = gate.ring_writer("box")
    for number in range(box.GATE_CELLS + 5):
        writer.put(b"%d" % number, number)
    found = copied(name)[layout.GATE]
    assert found["words"]["resets_asked"] == 9
    assert found["latest"] == {"state": [2, 2, b"new"]}
    ring = found["rings"]["box"]
    assert [entry[0] for entry in ring] == list(range(6, box.GATE_CELLS + 6)), "in order, the oldest overwritten"
    assert ring[-1] == [box.GATE_CELLS + 5, box.GATE_CELLS + 4, b"%d" % (box.GATE_CELLS + 4)]


def test_a_torn_entry_is_left_out_and_nothing_else(name: str) -> None:
    gate = owned(name, layout.GATE)
    writer = gate.ring_writer("box")
    for number in range(10):
        writer.put(b"%d" % number, number)
    at = gate.spec.offsets["box"] + 5 * cell_bytes(box.TICK.most)
    assert gate.mapped is not None
    gate.mapped[at + 24] ^= 0xFF
    ring = copied(name)[layout.GATE]["rings"]["box"]
    assert [entry[0] for entry in ring] == [1, 2, 3, 4, 6, 7, 8, 9, 10]


def test_segments_that_were_unlinked_can_still_be_copied(name: str) -> None:
    owned(name, layout.SUPERVISOR).word("epoch").set(77)
    with opened(name) as fds:
        segments.unlink_all(name)
        run, data = segments.copy(fds[layout.SUPERVISOR], name, layout.SUPERVISOR)
    assert run == RUN
    assert memory.segment(layout.SUPERVISOR, run, data)["words"]["epoch"] == 77


def test_a_truncated_segment_is_refused_with_a_reason(name: str) -> None:
    os.truncate(f"/dev/shm/failstop.{name}.gate", 4096)
    with opened(name) as fds, pytest.raises(segments.AttachError, match="wrong size"):
        segments.copy(fds[layout.GATE], name, layout.GATE)


def dead_run(name: str, beats: dict[str, int], epoch: int = 3) -> None:
    for process, beat_ns in beats.items():
        owned(name, process).word("beat_ns").set(beat_ns)
    owned(name, layout.SUPERVISOR).word("epoch").set(epoch)


def test_the_port_owner_says_what_ended_the_run(name: str) -> None:
    dead_run(name, dict.fromkeys(layout.PROCESS_NAMES, 1_000_000_000))
    port_owner = owned(name, layout.PORT_OWNER)
    stops, wire = port_owner.ring_writer("stops"), port_owner.ring_writer("box")
    stops.put(records.STOPPED.pack(2, 5, 6, causes.PIPED("answered long ago").pack()))
    stops.put(records.STOPPED.pack(3, 1_000_500_000, 1_000_600_000, SUPERVISOR_DIED.pack()))
    stops.put(records.STOPPED.pack(3, 1_000_700_000, 1_000_700_000, GATE_DIED.pack()))
    wire.put(box.pack_wire(box.WIRE_BURST, BOARD.burst, len(BOARD.burst)), 900_000_000)
    wire.put(box.pack_wire(box.WIRE_BURST, BOARD.burst, len(BOARD.burst)), 1_000_620_000)
    found = copied(name)
    assert memory.left_cause(found) == (1_000_500_000, 3, SUPERVISOR_DIED)
    stop = memory.left_stop(found, 1_000_500_000)
    assert (stop["written_by"], stop["written_us"]) == ("port owner", 120.0)


@pytest.mark.parametrize(
    ("noticed", "wanted"),
    [
        ([(100, SUPERVISOR_DIED), (100, GATE_DIED)], (100, SUPERVISOR_DIED)),
        ([(100, HANGS), (2000, SUPERVISOR_DIED)], (100, HANGS)),
        ([(100, causes.KEY(1)), (101, GATE_DIED), (102, SUPERVISOR_DIED)], (100, causes.KEY(1))),
    ],
)
def test_the_first_cause_is_told(name: str, noticed: list[tuple[int, Cause]], wanted: tuple[int, Cause]) -> None:
    dead_run(name, dict.fromkeys(layout.PROCESS_NAMES, 90_000_000))
    stops = owned(name, layout.PORT_OWNER).ring_writer("stops")
    for ms, cause in noticed:
        stops.put(records.STOPPED.pack(3, ms * 1_000_000, 0, cause.pack()))
    cause_ns, _, found = memory.left_cause(copied(name))
    assert (cause_ns // 1_000_000, found) == wanted


def test_without_its_word_the_last_sign_of_life_counts(name: str) -> None:
    dead_run(name, {**dict.fromkeys(layout.PROCESS_NAMES, 1_000_000_000), layout.STOPPER: 1_150_000_000})
    owned(name, layout.STOPPER).word("written_ns").set(1_051_000_000)
    found = copied(name)
    assert memory.left_cause(found) == (1_000_000_000, 3, SUPERVISOR_DIED)
    stop = memory.left_stop(found, 1_000_000_000)
    assert (stop["written_by"], stop["written_us"]) == ("stopper", 51_000.0)


@pytest.mark.parametrize("off_s", [0.0, -90 * 86400.0, 3600.0], ids=["not set", "set forward", "set back"])
def test_the_end_of_a_run_is_dated_by_the_present_clock(off_s: float) -> None:
    """Somebody may have set the clock after the run's last event, or since its death."""
    instance = f"left{os.getpid()}x{next(_numbers)}"
    run = segments.memory(instance, RUN)
    now_ns, now_s = time.monotonic_ns(), time.time()
    try:
        for process in layout.PROCESS_NAMES:
            segments.create(run, process, RUN).close()
        dead_run(run, dict.fromkeys(layout.PROCESS_NAMES, now_ns - 60_000_000_000))
        told = {
            "t": now_s - 62 + off_s,
            "ns": now_ns - 62_000_000_000,
            "kind": "ready",
            "level": "info",
            "text": "ready",
        }
        owned(run, layout.SUPERVISOR).ring_writer("events").put(msgpack.packb({**told, "fields": {}}))
        found = left.left(instance)
    finally:
        segments.unlink_all(run)
    assert found is not None
    why, [event] = found
    assert why.since == pytest.approx(now_s - 60, abs=5)
    assert event.t == pytest.approx(now_s - 62, abs=5)
    assert "1 min ago" in why.what or "60 s ago" in why.what, why.what


def test_all_dead_at_once_and_nobody_wrote(name: str) -> None:
    dead_run(name, {**dict.fromkeys(layout.PROCESS_NAMES, 1_000_000_000), layout.TELEMETRY: 1_050_000_000})
    found = copied(name)
    assert memory.left_cause(found) == (1_050_000_000, 3, causes.ALL_DIED())
    assert memory.left_stop(found, 1_050_000_000) == {}
    assert memory.left_stop(found, 0) == {}, "a stopper that wrote none has 0 as its time"


DIED = causes.DIED("gate")
T = 1_000_000_000
LOST = causes.DEVICE_LOST()
RECORD = {"cause": DIED.pack(), "epoch": 7, "noticed_ns": T, "noticed_by": "port_owner", "written_by": "port owner"}
RECORD |= {"written_us": 82.0, "acknowledged_us": 4400.0, "observed_ms": 300.0}


def event(kind: str, **fields: Any) -> bytes:
    packed: bytes = msgpack.packb({"kind": kind, "fields": fields})
    return packed


def known(record: bytes | None, events: list[bytes], cause_ns: int) -> dict[str, Any] | None:
    latest = {} if record is None else {"stop": [1, 1, record]}
    supervisor = {"latest": latest, "rings": {"events": [[1, 1, event] for event in events]}}
    return logged_stop({"supervisor": supervisor}, cause_ns)


UNKNOWN = "whether the board answered: not known"


def proof(stop: dict[str, Any] | None) -> str:
    return memory.proven({"t": 100.0, "saved": 102.2, "stop": stop})


NAMED = {"reason": str(LOST), "cause": "device_lost", "noticed_ns": T}
TOLD = event("stop", **NAMED, epoch=7, noticed_by="port_owner", written_by="supervisor")
OUTCOME = event("stop_outcome", **NAMED, epoch=7, acknowledged_us=None, observed_ms=None, wheels="unstill")


def test_the_record_of_this_stop_and_of_no_other_is_its_proof() -> None:
    found = known(msgpack.packb(RECORD), [], T)
    assert proof(found) == "written after 82 us, acknowledged after 4.40 ms, still after about 0.3 s"
    assert [proven for _, proven in memory.proofs({"t": 100.0, "saved": 102.2, "stop": found})] == [True] * 3
    assert known(msgpack.packb(RECORD), [], T + 1) is None
    assert known(None, [TOLD, OUTCOME], T + 1) is None, "of another stop for the same cause"
    assert proof(None) == f"whether a stop was written: not known, {UNKNOWN}, whether the wheels stopped: not known"


LACKING = causes.REQUESTED(f"two drive: /nav, a node whose name is {causes.NOT_KNOWN}", "ros2", 77)
WHOLE = causes.REQUESTED("two drive: /nav, /joy", "ros2", 77)


@pytest.mark.parametrize(
    ("now", "found"), [(WHOLE, WHOLE), (LACKING, LACKING), (GATE_DIED, LACKING), (None, LACKING)], ids=str
)
def test_a_cause_that_was_completed_since_is_saved_whole(now: Cause | None, found: Cause) -> None:
    latest = {} if now is None else {"latch": [1, 1, records.LATCH.pack(2, 100, 160, now.pack())]}
    assert memory.known_better({"supervisor": {"latest": latest}}, LACKING) == found


def test_the_proofs_of_a_stop_whose_cause_was_completed() -> None:
    first = event("stop", reason=str(LACKING), noticed_ns=T, written_by="port_owner", latency_us=80.0)
    assert "written after 80 us" in proof(known(None, [first], T))


def test_wheels_that_were_not_seen_to_move_before_either_are_no_proof_that_the_stop_worked() -> None:
    stop = known(msgpack.packb({**RECORD, "observed_ms": 0.0}), [], T)
    assert memory.proofs({"t": 100.0, "saved": 102.2, "stop": stop})[2] == ("no shaking seen before or after", None)


def test_what_was_told_of_it_outlasts_the_record() -> None:
    found = known(msgpack.packb({**RECORD, "noticed_ns": T + 1}), [TOLD, OUTCOME], T)
    assert found is not None
    assert found["written_us"] is None
    assert proof(found) == f"NOT written within 2.2 s, {UNKNOWN}, wheels NOT seen still"


WRITTEN = {"written_us": 82.0, "acknowledged_by": "answer", "observed_by": "IMU"}
ACKNOWLEDGED = {"acknowledged_us": 4400.0}
NO_SENDER = "NOT sent: the board accepts no bytes"
STRANGER = "written after 82 us to a device that has not answered as the board does"


@pytest.mark.parametrize(
    ("stop", "level", "said"),
    [
        ({"sent": False}, 0, (NO_SENDER, False)),
        ({"sent": False, "believed": False}, 0, (NO_SENDER, False)),
        ({"believed": False}, 0, (STRANGER, False)),
        ({"sent": False, "believed": False} | ACKNOWLEDGED, 0, ("written after 82 us", True)),
        ({"sent": None, "believed": None}, 0, ("written after 82 us", True)),
        ({}, 1, (UNKNOWN, None)),
        ({"link": "deaf"}, 1, ("NOT acknowledged", False)),
        ({"link": "unasked"}, 1, (UNMOVED, None)),
        ({"link": "unasked", "observed_ms": 0.0, "observed_by": "wheels"}, 1, (UNMOVED, None)),
        ({"link": "unasked", "observed_ms": 600.0, "observed_by": "wheels"}, 1, ("NOT acknowledged", False)),
        ({"observed_ms": 6000.0, "observed_late": True}, 2, ("still after at most 6.0 s", True)),
        ({"link": "unasked", "acknowledged_by": ""}, 1, ("this board never acknowledges a stop", None)),
        ({"link": "alive"} | ACKNOWLEDGED, 1, ("acknowledged after 4.40 ms", True)),
        ({}, 2, ("whether the wheels stopped: not known", None)),
        ({"link": "alive"}, 2, ("wheels NOT seen still", False)),
        ({"link": "alive", "observed_by": ""}, 2, ("not observed: the robot has no IMU", None)),
    ],
)
def test_what_is_not_proven_is_not_shown_as_proven(stop: dict[str, Any], level: int, said: tuple[str, object]) -> None:
    """As why() says it of a stop (failstop/api/why.py)."""
    assert memory.proofs({"t": 100.0, "saved": 102.2, "stop": WRITTEN | stop})[level] == said


def test_a_stop_that_was_not_sent_is_saved_as_such() -> None:
    held = {**RECORD, "sent": False, "believed": True, "acknowledged_us": None, "observed_ms": None}
    assert proof(known(msgpack.packb(held), [], T)).startswith(NO_SENDER)
    stop = event("stop", **NAMED, noticed_by="port_owner", written_by="port_owner", latency_us=82.0)
    outcome = event("stop_outcome", **NAMED, sent=False, link="deaf", acknowledged_by="answer", wheels="unknown")
    assert proof(known(None, [stop, outcome], T)).startswith(f"{NO_SENDER}, NOT acknowledged, ")


@pytest.mark.parametrize("junk", [b"", b"\xc1", b"\x01", msgpack.packb({"kind": "stop", "fields": 3})])
def test_junk_is_no_proof(junk: bytes) -> None:
    assert known(junk, [junk], T) is None
