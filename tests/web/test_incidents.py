"""Incidents as cards: what a card says, and which lines of a story it tells."""

from __future__ import annotations

import asyncio
import tempfile

import pytest

from failstop.web import incidents

HEAD = {"id": "20260101-120000-key1", "t": 1.0, "saved": 3.2, "reason": "key1", "clock_jump_s": 0.0}


def test_a_card_says_how_far_the_stop_was_proven() -> None:
    stop = {"written_us": 210.0, "acknowledged_us": 5310.0, "observed_ms": 312.0}
    card = incidents._card({**HEAD, "stop": stop})
    assert card["proof"] == "written after 0.21 ms, acknowledged after 5.31 ms, still after about 0.3 s"
    set_back = incidents._card({**HEAD, "stop": stop, "clock_jump_s": -7200.0})
    assert set_back["proof"] == f"{card['proof']}; before this incident the clock was set back by 2 h 0 min"


def test_the_story_is_of_the_seconds_around_the_cause() -> None:
    lines = [{"ms": float(ms), "what": "gate", "text": str(ms), "count": 1} for ms in range(-9000, 9000, 100)]
    found = [line["ms"] for line in incidents._near(lines)]
    assert len(found) == incidents.LINES
    assert found == sorted(found)
    assert max(map(abs, found)) <= incidents.NEAR_MS
    assert 0.0 in found


@pytest.mark.parametrize("late", ["show", "plot"])
def test_what_was_not_ready_in_time_is_made_again_and_is_not_called_impossible(late: str) -> None:
    """A picture that comes too late is no sign that this computer can't draw."""
    ran: list[str] = []

    async def command(what: str, *_words: str) -> bytes | None:
        ran.append(what)
        return None if what == late else b'{"story": []}'

    async def ask() -> None:
        made = incidents.Incidents("robot")
        made._command = command  # type: ignore[assignment,method-assign]
        for _ in range(2):
            assert made.picture("one") is None
            assert made._making
            await made._making
            await asyncio.sleep(0)  # its callback runs after it
        made.close()

    asyncio.run(ask())
    assert ran.count(late) == 2


def test_without_room_for_a_picture_there_is_a_story(monkeypatch: pytest.MonkeyPatch) -> None:
    """As on a full disk."""
    monkeypatch.setattr(tempfile, "tempdir", "/nowhere")

    async def command(*_words: str) -> bytes | None:
        return b'{"story": []}'

    async def ask() -> None:
        made = incidents.Incidents("robot")
        made._command = command  # type: ignore[assignment,method-assign]
        assert made.story("one") == (None, None)
        assert made._making
        await made._making
        assert made.story("one") == ([], False)
        made.close()

    asyncio.run(ask())
