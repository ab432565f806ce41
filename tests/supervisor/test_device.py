"""The port's loss and its return are told once each, whichever sign comes first."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from failstop.shm import records
from failstop.supervisor.device import Device
from failstop.supervisor.events import Events

T0 = 10**12
S = 10**9
PATH = "/dev/ttyACM0"


class Told(Events):
    """Keeps the kinds and the times away."""

    def __init__(self) -> None:
        super().__init__("x")
        self.told: list[tuple[str, object]] = []
        self.texts: list[str] = []

    def tell(self, kind: str, text: str, fields: object = None, *, level: str = "") -> None:
        assert isinstance(fields, dict)
        self.told.append((kind, fields.get("away_s")))
        self.texts.append(text)
        assert fields["path"] == PATH


def entry(state: int, since_ns: int, generation: int = 1) -> tuple[int, int, bytes]:
    return (1, since_ns, records.pack_port(generation, since_ns, state, PATH))


Step = Callable[[Device], None]


def record(state: int, at_s: int) -> Step:
    return lambda device: device.follow(entry(state, T0 + at_s * S))


def hang_up(at_s: int) -> Step:
    return lambda device: device.lost(PATH, T0 + at_s * S)


def reopened(at_s: int) -> Step:
    return lambda device: device.back(PATH, T0 + at_s * S)


OPEN, LOST = records.PORT_OPEN, records.PORT_LOST


@pytest.mark.parametrize(
    ("steps", "told"),
    [
        ([lambda device: device.follow(None)], []),
        ([record(OPEN, 1), record(OPEN, 2)], []),
        ([record(LOST, 1), record(LOST, 1), record(OPEN, 4)], [("device_lost", None), ("device_back", 3.0)]),
        # The supervisor's own hang-up comes first, and the record is still of before.
        (
            [hang_up(1), record(OPEN, 0), record(LOST, 2), record(OPEN, 4)],
            [("device_lost", None), ("device_back", 3.0)],
        ),
        # Gone and back between two turns: its own hang-up tells of it.
        ([hang_up(1), record(OPEN, 2)], [("device_lost", None), ("device_back", 1.0)]),
        # Without a port owner the supervisor opens it; the record stays what it was.
        ([record(LOST, 1), reopened(4), record(LOST, 1)], [("device_lost", None), ("device_back", 3.0)]),
        # A port owner that is started anew while it is gone says so anew.
        ([record(LOST, 1), record(LOST, 2), record(OPEN, 3)], [("device_lost", None), ("device_back", 2.0)]),
        (
            [record(LOST, 1), record(OPEN, 2), hang_up(3), reopened(4)],
            [("device_lost", None), ("device_back", 1.0), ("device_lost", None), ("device_back", 1.0)],
        ),
    ],
)
def test_once_each(steps: list[Step], told: list[tuple[str, object]]) -> None:
    events = Told()
    device = Device(events, T0)
    for step in steps:
        step(device)
    assert events.told == told


def test_how_long_it_was_away_is_told_to_a_tenth_of_a_second_and_to_programs_in_ms() -> None:
    events = Told()
    device = Device(events, T0)
    device.lost(PATH, T0 + S)
    device.back(PATH, T0 + S + 1_234_500_001)
    assert events.told[1] == ("device_back", 1.235)
    assert events.texts == [
        f"{PATH} is gone; the stop is written the moment it is back; wheels that turn: POWER SWITCH",
        f"{PATH} is back after 1.2 s; the stop is written",
    ]


MS = 10**6
BEAT = T0 + S


@pytest.mark.parametrize(
    ("looks", "may"),
    [
        # (ms after its last beat, is the device there?): the last look counts.
        ([(100, True)], True),
        ([(10, False), (20, True), (150, True)], True),
        ([(20, False)], True),
        ([(21, False)], False),
        ([(21, False), (40, True), (150, True)], False),
        ([(500, False)], False),
    ],
)
def test_silence_that_may_be_the_opening_of_the_port(looks: list[tuple[int, bool]], may: bool) -> None:
    device = Device(Told(), T0)
    found = [device.may_be_opened(there, BEAT, BEAT + at_ms * MS) for at_ms, there in looks]
    assert found[-1] is may


def test_one_that_beats_again_may_be_opening_it_again() -> None:
    device = Device(Told(), T0)
    assert not device.may_be_opened(False, BEAT, BEAT + S)
    assert device.may_be_opened(True, BEAT + S, BEAT + S + 150 * MS)
