"""Halted: "stopped" is said only for what was seen, and everything else says that a wheel may still be turning."""

from __future__ import annotations

from itertools import product

import pytest

from failstop.policy.halted import MAY_TURN, SENTENCES, Halted

EVERY = [
    Halted("/dev/x", written=written, there=there, why="busy", confirms=confirms, confirmed=confirmed, still=still)
    for (written, there, confirms, confirmed), still in product(product((True, False), repeat=4), (True, False, None))
]


@pytest.mark.parametrize(
    ("known", "sentence"),
    [
        ({"written": False, "there": False}, f"/dev/x is unplugged: {MAY_TURN}"),
        ({"written": False, "why": "it is busy"}, f"no stop could be written to /dev/x (it is busy): {MAY_TURN}"),
        (
            {"written": True, "confirms": True},
            f"a stop was written to /dev/x, but the board did not confirm it: {MAY_TURN}",
        ),
        (
            {"written": True, "confirms": True, "confirmed": True, "still": False},
            "a stop was written to /dev/x, but the board reports that a wheel still turns: switch off the power",
        ),
        (
            {"written": True, "confirms": True, "confirmed": True, "still": True},
            "the wheels are stopped, as the board reports",
        ),
        ({"written": True, "confirms": True, "confirmed": True}, "the board has confirmed the stop"),
        ({"written": True}, "a stop was written to /dev/x, but nothing can confirm it: check that no wheel turns"),
    ],
)
def test_each_row_has_its_sentence(known: dict[str, bool], sentence: str) -> None:
    assert Halted("/dev/x", **known).sentence() == sentence  # type: ignore[arg-type]


@pytest.mark.parametrize("known", EVERY)
def test_stopped_is_said_only_of_a_stop_that_went_out_and_was_seen(known: Halted) -> None:
    said = known.sentence()
    proved = known.written and known.still is True and (known.confirmed or not known.confirms)
    assert ("stopped" in said) == proved
    assert ("switch off the power" in said) == (not known.safe)
    assert known.safe <= known.written
    assert known.interrupted() == (130 if known.safe else 1)


def test_every_row_is_needed() -> None:
    assert {next(row for row in SENTENCES if row[0](known)) for known in EVERY} == {*SENTENCES}
