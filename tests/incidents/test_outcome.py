"""How a stop was proven: of this stop, and not of a later one."""

from __future__ import annotations

from typing import Any

import msgpack
import pytest

from failstop.incidents import memory
from failstop.incidents.memory import short, told_stop
from failstop.policy import causes
from failstop.policy.causes import Cause

DIED = causes.DIED("gate")
LOST = causes.DEVICE_LOST()
RECORD = {
    "cause": DIED.pack(),
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


def known(record: bytes | None, events: list[bytes], epoch: int, cause: Cause) -> dict[str, Any] | None:
    latest = {} if record is None else {"stop": [1, 1, record]}
    supervisor = {"latest": latest, "rings": {"events": [[1, 1, event] for event in events]}}
    return told_stop({"supervisor": supervisor}, epoch, cause)


HEAD = {"t": 100.0, "saved": 102.2}
NAMED = {"reason": str(LOST), "cause": "device_lost"}
TOLD = event("stop", **NAMED, epoch=7, noticed_by="port_owner", written_by="supervisor")
OUTCOME = event("stop_outcome", **NAMED, epoch=7, acknowledged_us=None, observed_ms=None, wheels="unstill")


def test_the_record_of_this_stop() -> None:
    found = known(msgpack.packb(RECORD), [], 7, DIED)
    assert memory.proof(found, HEAD) == ("written after 82 us, acknowledged after 4.40 ms, still after about 0.3 s")


def test_a_stop_that_nobody_told_of() -> None:
    assert memory.proof(None, HEAD) == "not known whether a stop was written"


@pytest.mark.parametrize(("epoch", "cause"), [(8, DIED), (7, LOST), (7, causes.DIED("telemetry"))])
def test_a_record_of_another_stop_is_none_of_this(epoch: int, cause: Cause) -> None:
    assert known(msgpack.packb(RECORD), [], epoch, cause) is None


def test_what_was_told_of_it_outlasts_the_record() -> None:
    found = known(msgpack.packb(RECORD), [TOLD, OUTCOME], 7, LOST)
    assert found is not None
    assert found["written_us"] is None
    assert memory.proof(found, HEAD) == "NOT written within 2.2 s, wheels NOT seen still"


def test_events_of_an_earlier_stop_for_the_same_reason_do_not_count() -> None:
    assert known(None, [TOLD, OUTCOME], 9, LOST) is None


def test_events_of_another_stop_of_the_same_kind_do_not_count() -> None:
    told = event("stop", reason="telemetry died", cause="died", epoch=8, noticed_by="port_owner")
    assert known(None, [told], 7, DIED) is None
    assert known(None, [told], 7, causes.DIED("telemetry")) is not None
    posed = event("stop", reason="stop request: gate died", cause="piped", epoch=8, noticed_by="port_owner")
    assert known(None, [posed], 7, DIED) is None


@pytest.mark.parametrize("length", [280, 100])
def test_a_reason_that_was_cut_is_still_that_of_its_stop(length: int) -> None:
    cause = causes.REQUESTED("w" * 180, "nav", 12)
    told = event("stop", reason=str(cause)[:length], cause="requested", epoch=7, noticed_by="port_owner")
    assert known(None, [told], 7, cause) is not None


@pytest.mark.parametrize("junk", [b"", b"\xc1", b"\x01", msgpack.packb({"kind": "stop", "fields": 3})])
def test_junk_is_no_proof(junk: bytes) -> None:
    assert known(junk, [junk], 1, DIED) is None


@pytest.mark.parametrize(
    ("cause", "text"),
    [
        (causes.REQUESTED("too near", "nav", 12), "stop request: too near"),
        (causes.REQUESTED("", "nav", 12), "stop request"),
        (causes.REQUESTED("a (b) c", "my, node", 12), "stop request: a (b) c"),
        (causes.PIPED("near (nav, pid 12)"), "stop request: near (nav, pid 12)"),
        (causes.PIPED(""), "stop request"),
        (causes.FLEET("smoke in hall 2", "ann"), "fleet stop: smoke in hall 2"),
        (DIED, "gate died"),
        (causes.NOT_FINITE("nav (pid 77)"), "command from nav (pid 77) is not finite"),
    ],
    ids=repr,
)
def test_a_cause_without_who_asked_for_it(cause: Cause, text: str) -> None:
    assert short(cause) == text
