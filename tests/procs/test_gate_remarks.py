"""Remarks on who enabled, disabled, reset or was refused: when it changed something, and never without end."""

from __future__ import annotations

import pytest

from failstop.messages import records
from failstop.messages.layout import NOTE_BYTES
from failstop.messages.packing import Note
from failstop.policy.causes import Cause, Reply
from failstop.procs.gate.remarks import EVERY_NS, MOST_AT_ONCE, Budget, of_request
from tests.support.why import why

WHO: dict[str, str | int] = {"who": "nav", "pid": 7}


@pytest.mark.parametrize(
    ("verb", "done", "enabled", "was", "kind", "text"),
    [
        (records.ENABLE, True, False, None, "enabled", "motion enabled by nav (pid 7)"),
        (records.ENABLE, True, True, None, "", ""),
        (records.ENABLE, False, False, why("key1"), "refused", "refused to enable, nav (pid 7): answer"),
        (records.DISABLE, True, True, None, "disabled", "motion disabled by nav (pid 7)"),
        (records.DISABLE, True, False, None, "", ""),
        (records.RESET, True, False, why("key1"), "reset", "nav (pid 7): answer"),
        (records.RESET, True, False, None, "", ""),
        (records.RESET, False, False, why("key1"), "refused", "refused to reset, nav (pid 7): answer"),
        (99, False, False, None, "refused", "refused to 99, nav (pid 7): answer"),
    ],
)
def test_a_request_is_told_of_when_it_changed_something_or_was_refused(
    verb: int, done: bool, enabled: bool, was: Cause | None, kind: str, text: str
) -> None:
    note = of_request(verb, "nav", 7, Reply(done, "answer", was), enabled=enabled)
    assert (note.kind if note else "", note.text if note else "") == (kind, text)
    assert note is None or WHO.items() <= note.fields.items()


def test_the_gamepad_has_no_pid() -> None:
    note = of_request(records.RESET, "gamepad", 0, Reply(True, "latched stop cleared", why("key1")), enabled=False)
    assert note is not None
    assert note.text == "gamepad: latched stop cleared"
    assert note.fields == {"who": "gamepad", "reason": "key1", "cause": "key"}


def test_a_flood_is_told_of_a_few_times_a_second_and_after_a_rest_everything_again() -> None:
    budget = Budget(0)
    told = [budget.spend(i * 1_000_000) for i in range(10_000)]
    assert all(told[:MOST_AT_ONCE])
    assert sum(told) <= MOST_AT_ONCE + 10_000_000_000 // EVERY_NS
    assert sum(told[-1000:]) == 1_000_000_000 // EVERY_NS
    assert budget.unsaid == 10_000 - sum(told)
    budget = Budget(0)
    while budget.spend(0):
        pass
    for later_ns in (MOST_AT_ONCE * EVERY_NS, 100 * MOST_AT_ONCE * EVERY_NS):
        assert [budget.spend(later_ns) for _ in range(MOST_AT_ONCE + 1)] == [*[True] * MOST_AT_ONCE, False]


@pytest.mark.parametrize("size", [0, 10, 300, 5_000])
def test_a_note_fits_its_slot_and_comes_back(size: int) -> None:
    note = Note("refused", "\u2713" * size, {"who": "\udcff" * size, "pid": 7}, level="warning", step="wait")
    data = note.pack()
    assert len(data) <= NOTE_BYTES
    found = Note.unpack(data)
    assert (found.kind, found.level, found.step) == ("refused", "warning", "wait")
    assert ("\u2713" * size).startswith(found.text)
    assert found.fields == {"who": "?" * (size if size < 64 else 64), "pid": 7}


def test_fields_that_just_fit_are_kept_and_others_cut_or_left_out() -> None:
    room = NOTE_BYTES - len(Note("note", "text", {"a": "x" * 275, "b": "x" * 260}).pack())
    for more, kept in ((room, True), (room + 1, False)):
        fields: dict[str, str | int | float] = {"a": "x" * 275, "b": "x" * (260 + more)}
        data = Note("note", "text", fields).pack()
        assert (len(data) == NOTE_BYTES) == (Note.unpack(data).fields == fields) == kept
    data = Note("note", "text", {f"field_{i}": "x" * 60 for i in range(50)}).pack()
    assert len(data) <= NOTE_BYTES
    assert Note.unpack(data).fields == {}


@pytest.mark.parametrize("payload", [b"", b"gyro bias", b"\x90", b"\x94\xa1a\xa1b\xa1c\xa1d", b"\xc1", b"\x94\xa1a"])
def test_a_payload_that_is_no_note_is_refused(payload: bytes) -> None:
    with pytest.raises(ValueError) as raised:  # noqa: PT011
        Note.unpack(payload)
    assert payload != b"\x90" or "a payload that is no note" in str(raised.value)
