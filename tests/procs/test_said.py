"""What clients say of themselves: passed on, told of when it changes, bounded, and of whoever holds the slot."""

from __future__ import annotations

import pytest

from failstop.messages import records
from failstop.procs.gate.remarks import MOST_AT_ONCE, Said

from .client_side import Service

S = 1_000_000_000


def test_words_are_told_once_when_they_change_and_when_their_client_goes() -> None:
    said = Said(0)
    assert said.follow([], 0) is None
    news = said.follow([(11, 0, "nav (pid 7)", 5, "all well", "")], S)
    assert news is not None
    assert [(note.text, note.level) for note in news] == [("nav (pid 7) says: all well", "")]
    assert said.follow([(11, 0, "nav (pid 7)", 5, "all well", "")], S) is None
    assert said.follow([(11, 0, "nav (pid 7)", 6, "all well", "")], S) == [], "only said again: a new time, no news"
    assert said.table() == [(0, 6, "all well", "")]
    news = said.follow([(11, 0, "nav (pid 7)", 7, "all well", "no map")], S)
    assert news is not None
    assert [(note.text, note.level) for note in news] == [("nav (pid 7) says: no map", "warning")]
    news = said.follow([(11, 0, "nav (pid 7)", 8, "all well", "")], S)
    assert news is not None
    assert [note.text for note in news] == ["nav (pid 7) says: all well"]
    news = said.follow([], S)
    assert news is not None
    assert [note.text for note in news] == ["nav (pid 7) has gone"]
    assert said.table() == []


def test_who_says_ever_new_things_is_told_of_now_and_then() -> None:
    said = Said(0)
    told = [said.follow([(11, 0, "nav", turn, str(turn), "")], 0) or [] for turn in range(200)]
    assert sum(map(len, told)) == MOST_AT_ONCE
    assert said.table() == [(0, 199, "199", "")]


@pytest.mark.parametrize(
    ("sees", "wrong", "read"),
    [
        ("all well", "", ("all well", "")),
        ("two\nlines", "also\ntwo", ("two lines", "also two")),
        ("\x1b[31mred", "", ("?[31mred", "")),
        ("ä" * 500, "", ("ä" * 95, "")),
    ],
)
def test_words_are_bounded_and_printable(service: Service, sees: str, wrong: str, read: tuple[str, str]) -> None:
    client = service.known()
    assert service.table.active[0].said() is None
    client.segment.latest_writer("said").write(records.SAID.pack(11, sees, wrong), 42)
    assert service.table.active[0].said() == (42, *read)


@pytest.mark.parametrize("payload", [b"", b"short", records.SAID.pack(12, "of another session", "")])
def test_damaged_words_and_those_of_another_session_count_as_none(service: Service, payload: bytes) -> None:
    client = service.known()
    client.segment.latest_writer("said").write(payload)
    assert service.table.active[0].said() is None
