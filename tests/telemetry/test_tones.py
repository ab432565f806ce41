"""Buzzer tones on a trip and on mode changes; off by default."""

from __future__ import annotations

import struct

import pytest

from failstop.board.framing import BUZZER
from failstop.board.rrc.board import BOARD
from failstop.messages import records
from failstop.policy.settings import Settings
from failstop.procs.telemetry import pad
from failstop.procs.telemetry.pad import Tones


@pytest.fixture
def sounding() -> Tones:
    made = Tones(on=True)
    made.follow(False, pad.LOCKED)
    return made


def test_tones_are_off_by_default() -> None:
    assert not Settings().on("buzzer.tones")
    silent = Tones(on=False)
    seen = [silent.follow(latched, mode) for latched in (False, True, False) for mode in (pad.LOCKED, pad.DRIVING)]
    assert set(seen) == {None}


def test_each_trip_sounds_once(sounding: Tones) -> None:
    for _ in range(2):
        assert [sounding.follow(True, pad.LOCKED) for _ in range(3)] == [pad.LATCH_SOUND, None, None]
        assert sounding.follow(False, pad.LOCKED) is None


def test_each_mode_has_its_tone(sounding: Tones) -> None:
    assert sounding.follow(False, pad.DRIVING) == pad.MODE_SOUNDS[pad.DRIVING]
    assert sounding.follow(False, pad.DRIVING) is None
    assert sounding.follow(False, pad.LOCKED) == pad.MODE_SOUNDS[pad.LOCKED]
    assert len({pad.LATCH_SOUND, *pad.MODE_SOUNDS}) == 1 + len(records.PAD_MODES)


def test_a_trip_that_locks_the_pad_sounds_as_a_trip(sounding: Tones) -> None:
    sounding.follow(False, pad.DRIVING)
    assert sounding.follow(True, pad.LOCKED) == pad.LATCH_SOUND
    assert sounding.follow(False, pad.LOCKED) is None


def test_an_arm_that_is_about_to_tuck_is_heard_once(sounding: Tones) -> None:
    tucks = [False, True, True, False, False, True]
    heard = [sounding.follow(False, pad.LOCKED, tucks=each) for each in tucks]
    assert heard == [None, pad.TUCK_SOUND, None, None, None, pad.TUCK_SOUND]


def test_a_stop_of_before_the_start_is_not_heard_and_a_tuck_is() -> None:
    """The arm has yet to move."""
    assert Tones(on=True).follow(True, pad.LOCKED) is None
    assert Tones(on=True).follow(False, pad.LOCKED, tucks=True) == pad.TUCK_SOUND


@pytest.mark.parametrize("sound", [pad.LATCH_SOUND, *pad.MODE_SOUNDS, pad.TUCK_SOUND])
def test_every_tone_ends(sound: pad.Sound) -> None:
    """An off time of 0 left one sounding forever: 100 ms."""
    frame = BOARD.buzzer(*sound)
    assert frame[2] == BUZZER
    _, on_ms, off_ms, repeat = struct.unpack("<4H", frame[4:12])
    assert off_ms == 100
    assert (on_ms + off_ms) * repeat <= 1_000
