"""Buttons and keys that are stop requests: on the first frame, once for as long as they are held."""

from __future__ import annotations

import pytest

from failstop.board.decoder import BUTTONS, KEY_EVENTS
from failstop.policy import causes
from failstop.procs.telemetry.trips import LOW_READINGS, Trips

MODE = 0x2000
STOPPING_EVENTS = {"pressed", "long", "long-repeat", "click", "double", "triple"}


@pytest.fixture
def trips() -> Trips:
    return Trips(MODE, 1)


@pytest.mark.parametrize("button", BUTTONS.values(), ids=BUTTONS.keys())
def test_every_button_stops_on_its_first_frame(trips: Trips, button: int) -> None:
    assert trips.pad(button) == causes.BUTTON(button)


def test_the_reason_as_people_read_it(trips: Trips) -> None:
    assert str(trips.pad(0x0100)) == "gamepad button 0x0100"


def test_only_mode_does_not_stop(trips: Trips) -> None:
    assert trips.pad(MODE) is None
    assert str(trips.pad(MODE | 0x0100)) == "gamepad button 0x0100"


@pytest.mark.parametrize("bit", range(16))
def test_a_bit_that_no_button_is_known_for_stops_too(trips: Trips, bit: int) -> None:
    assert bool(trips.pad(1 << bit)) is (1 << bit != MODE)


def test_mode_is_the_setting_s() -> None:
    trips = Trips(0x0008, 1)
    assert trips.pad(0x0008) is None
    assert str(trips.pad(0x2008)) == "gamepad button 0x2000"
    assert str(Trips(0, 1).pad(MODE)) == "gamepad button 0x2000"


def test_sticks_alone_do_not_stop(trips: Trips) -> None:
    assert trips.pad(0) is None


def test_a_held_button_is_one_request(trips: Trips) -> None:
    assert [bool(trips.pad(0x0100)) for _ in range(3)] == [True, False, False]


def test_each_tap_is_a_request(trips: Trips) -> None:
    assert [bool(trips.pad(buttons)) for buttons in (1, 0, 1, 0, 1)] == [True, False, True, False, True]


def test_another_button_while_one_is_held_is_a_request(trips: Trips) -> None:
    assert trips.pad(0x0100)
    assert str(trips.pad(0x0102)) == "gamepad button 0x0002"
    assert trips.pad(0x0002) is None


@pytest.mark.parametrize(("event", "name"), KEY_EVENTS.items(), ids=KEY_EVENTS.values())
def test_the_stop_key_s_presses_stop_and_its_releases_do_not(trips: Trips, event: int, name: str) -> None:
    assert trips.key(1, event) == (causes.KEY(1) if name in STOPPING_EVENTS else None)


@pytest.mark.parametrize("key", [0, 2, 255])
def test_other_keys_do_not_stop(trips: Trips, key: int) -> None:
    assert [trips.key(key, event) for event in KEY_EVENTS] == [None] * len(KEY_EVENTS)


def test_the_stop_key_is_the_setting_s() -> None:
    assert str(Trips(MODE, 2).key(2, 0x01)) == "key2"
    assert Trips(MODE, 2).key(1, 0x01) is None


def test_a_battery_that_stays_low_stops_once_until_it_was_charged() -> None:
    trips = Trips(MODE, 1, 10_500)
    readings = (
        [10_400] * (LOW_READINGS - 1) + [10_500] + [10_499] * (2 * LOW_READINGS) + [11_000] + [9_000] * LOW_READINGS
    )
    stops = [at for at, millivolts in enumerate(readings) if trips.battery(millivolts)]
    assert stops == [2 * LOW_READINGS - 1, len(readings) - 1]


def test_without_its_setting_no_battery_stops() -> None:
    trips = Trips(MODE, 1)
    assert [trips.battery(0) for _ in range(2 * LOW_READINGS)] == [None] * (2 * LOW_READINGS)
