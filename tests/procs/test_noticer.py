"""Buttons and keys that are stop requests: on the first frame, once for as long as they are held."""

from __future__ import annotations

import pytest

from failstop.board.decoder import BUTTONS, KEY_EVENTS
from failstop.policy import causes
from failstop.procs.telemetry.noticer import LOW_READINGS, Noticer

MODE = 0x2000
STOPPING_EVENTS = {"pressed", "long", "long-repeat", "click", "double", "triple"}


@pytest.fixture
def noticer() -> Noticer:
    return Noticer(MODE, 1)


@pytest.mark.parametrize("button", BUTTONS.values(), ids=BUTTONS.keys())
def test_every_button_stops_on_its_first_frame(noticer: Noticer, button: int) -> None:
    assert noticer.pad(button) == causes.BUTTON(button)


def test_the_reason_as_people_read_it(noticer: Noticer) -> None:
    assert str(noticer.pad(0x0100)) == "gamepad button 0x0100"


def test_only_mode_does_not_stop(noticer: Noticer) -> None:
    assert noticer.pad(MODE) is None
    assert str(noticer.pad(MODE | 0x0100)) == "gamepad button 0x0100"


@pytest.mark.parametrize("bit", range(16))
def test_a_bit_that_no_button_is_known_for_stops_too(noticer: Noticer, bit: int) -> None:
    assert bool(noticer.pad(1 << bit)) is (1 << bit != MODE)


def test_mode_is_the_setting_s() -> None:
    noticer = Noticer(0x0008, 1)
    assert noticer.pad(0x0008) is None
    assert str(noticer.pad(0x2008)) == "gamepad button 0x2000"
    assert str(Noticer(0, 1).pad(MODE)) == "gamepad button 0x2000"


def test_sticks_alone_do_not_stop(noticer: Noticer) -> None:
    assert noticer.pad(0) is None


def test_a_held_button_is_one_request(noticer: Noticer) -> None:
    assert [bool(noticer.pad(0x0100)) for _ in range(3)] == [True, False, False]


def test_each_tap_is_a_request(noticer: Noticer) -> None:
    assert [bool(noticer.pad(buttons)) for buttons in (1, 0, 1, 0, 1)] == [True, False, True, False, True]


def test_another_button_while_one_is_held_is_a_request(noticer: Noticer) -> None:
    assert noticer.pad(0x0100)
    assert str(noticer.pad(0x0102)) == "gamepad button 0x0002"
    assert noticer.pad(0x0002) is None


@pytest.mark.parametrize(("event", "name"), KEY_EVENTS.items(), ids=KEY_EVENTS.values())
def test_the_stop_key_s_presses_stop_and_its_releases_do_not(noticer: Noticer, event: int, name: str) -> None:
    assert noticer.key(1, event) == (causes.KEY(1) if name in STOPPING_EVENTS else None)


@pytest.mark.parametrize("key", [0, 2, 255])
def test_other_keys_do_not_stop(noticer: Noticer, key: int) -> None:
    assert [noticer.key(key, event) for event in KEY_EVENTS] == [None] * len(KEY_EVENTS)


def test_the_stop_key_is_the_setting_s() -> None:
    assert str(Noticer(MODE, 2).key(2, 0x01)) == "key2"
    assert Noticer(MODE, 2).key(1, 0x01) is None


def test_a_battery_that_stays_low_stops_once_until_it_was_charged() -> None:
    noticer = Noticer(MODE, 1, 10_500)
    readings = (
        [10_400] * (LOW_READINGS - 1) + [10_500] + [10_499] * (2 * LOW_READINGS) + [11_000] + [9_000] * LOW_READINGS
    )
    stops = [at for at, millivolts in enumerate(readings) if noticer.battery(millivolts)]
    assert stops == [2 * LOW_READINGS - 1, len(readings) - 1]


def test_without_its_setting_no_battery_stops() -> None:
    noticer = Noticer(MODE, 1)
    assert [noticer.battery(0) for _ in range(2 * LOW_READINGS)] == [None] * (2 * LOW_READINGS)
