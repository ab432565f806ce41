"""How a stop was proven: of this stop, and not of a later one."""

from __future__ import annotations

from typing import Any

import msgpack
import pytest

from failstop.incidents import report
from failstop.incidents.outcome import asked, known

RECORD = {
    "reason": "gate died",
    "epoch": 7,
    "noticed_by": "port_owner",
    "written_by": "port owner",
    "written_us": 82.0,
    "acknowledged_us": 4400.0,
    "observed_ms": 300.0,
}


def event(kind: str, **fields: Any) -> bytes:
    packed: bytes = msgpack.packb({"kind": kind, "fields": fields})
    return packed


HEAD = {"t": 100.0, "saved": 102.2}
TOLD = event("stop", reason="device lost", epoch=7, noticed_by="port_owner", written_by="supervisor")
OUTCOME = event("stop_outcome", reason="device lost", epoch=7, acknowledged_us=None, observed_ms=None, wheels="unstill")


def test_the_record_of_this_stop() -> None:
    found = known(msgpack.packb(RECORD), [], 7, "gate died")
    assert report.proof(found, HEAD) == ("written after 82 us, acknowledged after 4.4 ms, still after about 0.3 s")


@pytest.mark.parametrize(("epoch", "reason"), [(8, "gate died"), (7, "device lost")])
def test_a_record_of_another_stop_is_none_of_this(epoch: int, reason: str) -> None:
    assert known(msgpack.packb(RECORD), [], epoch, reason) is None


def test_what_was_told_of_it_outlasts_the_record() -> None:
    found = known(msgpack.packb(RECORD), [TOLD, OUTCOME], 7, "device lost")
    assert found is not None
    assert found["written_us"] is None
    assert report.proof(found, HEAD) == "NOT written within 2.2 s, wheels NOT seen still"


def test_events_of_an_earlier_stop_for_the_same_reason_do_not_count() -> None:
    assert known(None, [TOLD, OUTCOME], 9, "device lost") is None


@pytest.mark.parametrize("junk", [b"", b"\xc1", b"\x01", msgpack.packb({"kind": "stop", "fields": 3})])
def test_junk_is_no_proof(junk: bytes) -> None:
    assert known(junk, [junk], 1, "x") is None


@pytest.mark.parametrize(
    ("reason", "parts"),
    [
        ("stop request: too near (nav, pid 12)", ("stop request: too near", "nav", "12")),
        ("stop request (nav, pid 12)", ("stop request", "nav", "12")),
        ("stop request: a (b) c (my, node, pid 12)", ("stop request: a (b) c", "my, node", "12")),
        ("gate died", ("gate died", "", "")),
        ("command from nav (pid 77) is not finite", ("command from nav (pid 77) is not finite", "", "")),
        ("stop request: near (nav, pid x)", ("stop request: near (nav, pid x)", "", "")),
        ("stop request: near (nav, pid 12) twice", ("stop request: near (nav, pid 12) twice", "", "")),
    ],
)
def test_who_asked_for_a_stop(reason: str, parts: tuple[str, str, str]) -> None:
    assert asked(reason) == parts
